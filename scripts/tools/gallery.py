"""Make all figures of the gallery from their scenes; with --docs also the pictures and the page in docs/.

    python scripts/tools/gallery.py [--out FOLDER] [--only NAME ...] [--force] [--docs [DOCS]] [--count N]

Atlases, and figures as PNG and PDF, are written to FOLDER, by default out/gallery of the repository. An atlas in FOLDER is
used again if it is of the same scene; --force computes all atlases anew. --docs writes docs/gallery/*.png, the pages of some
atlases in the same folder, docs/gallery.md and the figures of docs/fixed_point_checks.md. All scenes take about five minutes
on two cores.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from make_docs import with_formulas
from matplotlib import rc_context
from matplotlib.figure import Figure

import atlas
from atlas.cli.scenes import figure_options
from atlas.extensions.page.page import atlas_page
from atlas.flags import Agreement
from atlas.label import theory
from atlas.plotting import maps, style
from atlas.scene.read import scene_from
from atlas.systems import System

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAPER_FIGURES = (1, 4, 11)  # of Amer et al. (2013), shown in docs/fixed_point_checks.md
DPI = 300  # of the pictures in docs
# Scenes whose pages are in the repository, with at most PAGE_POINTS points each; scripts/docs.sh makes the other pages.
PAGES = (
    "stability_cylindrical",
    "gravity_gradient",
    "sleeping_top_spin",
    "conical_precession_spin",
    "chaos_tumbling",
)
PAGE_POINTS = 1600


# The diagrams of docs/branches.md: file, system, body, parameter and its values, variable.
BRANCHES = (
    ("branches", "satellite", {"A": 1.0, "B": 1.3, "C": 1.7, "k2": 0.02, "k3": 0.05}, "k1", np.linspace(0.01, 3, 300), "theta0"),
    (
        "branches_arcs", "fixed_point", {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5},
        "n", np.tan(np.linspace(-1.5, 1.5, 301)), "gamma",
    ),
)  # fmt: skip
# Borders in docs/branches.md: file, system, body, ranges, and spacing of the grid of points that is drawn too (0: no grid).
BORDERS = (
    ("borders_island", "satellite", {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}, {"k1": (0.83, 1.27), "k2": (-0.17, 0.17)}, 0.1),
    ("borders_cusps", "satellite", {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}, {"k1": (-2.6, 2.6), "k2": (-1.5, 1.5)}, 0.0),
    (
        "borders_staude", "fixed_point", {"A": 1.0, "B": 1.3, "C": 1.7, "Mg": 1.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l2": 0.2},
        {"n": (-3.0, 3.0), "l1": (-1.5, 1.5)}, 0.0,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """The map of one scene, as `atlas map` draws it."""

    scene: str  # file in the folder without suffix
    caption: str
    # Flag, and its variable, of which the map shows the probability over the axis `draw`; empty: the map of the atlas
    probable: str = ""
    variable: str = "label"
    folder: str = "configs"  # of the scene; that of an example has a system that is not installed

    @property
    def file(self) -> Path:
        """File of the scene."""
        return ROOT / self.folder / f"{self.scene}.toml"

    @property
    def options(self) -> str:
        """Options of `atlas map` for the figure."""
        return figure_options(self.file.read_text("utf-8"))


SATELLITE = "Yehia and El-kenani (2021)"
TOP = "Amer et al. (2013)"
AT_REST = (
    "Seen in the orbital frame n = 0, and the label is permanent rotation; seen from inertial space the axis turns with"
    " the orbit, and `label_inertial` is regular precession."
)
CHAOS = " Pale motions are regular for as long as the runs last, dark ones chaotic, the darker the faster neighbours separate."
HYPERBOLIC = " Pale motions are regular for as long as the runs last; the neighbours of dark ones, which are hyperbolic, leave exponentially."
PICTURES = (
    Picture(
        "stability_cylindrical",
        "Cylindrical motion: the third axis is along the orbit normal (theta0 = 0), and the body turns about it at the"
        f" rate m relative to the orbital frame; (14), (22), (44) of {SATELLITE} with mu = 0. Started with theta0 and psi0"
        " changed by 1e-4. This is the classical diagram of Thomson and Likins.",
    ),
    Picture(
        "cylindrical_nonlinear",
        "The same motion without magnet by theory alone, over the momentum of the axis. Dark: the energy has a minimum. Pale:"
        " gyroscopic terms alone stabilise, and the normal form of degree 4 proves that the motion is stable in the full"
        " equations (Arnold, Moser), but on the curve D = 0, where higher terms decide. The resonance 2:1 is harmless; on that of"
        " 3:1 the motion is stable by the criterion of Markeev but for two short arcs about the points where it meets D = 0.",
    ),
    Picture(
        "stability_perp_radius",
        "The third axis at rest in the orbital frame, perpendicular to the radius and at theta0 to the orbit normal;"
        f" (17) of {SATELLITE}, who call it conical motion. {AT_REST} The motion is stable for C > A. At small tilts near"
        " C = A it is unstable, but grows too slowly to be seen in 20 orbits.",
    ),
    Picture(
        "stability_perp_velocity",
        f"The third axis at rest perpendicular to the velocity; (24) of {SATELLITE}, who call it hyperboloidal motion. For"
        " 1 < C/A < 4/3 the growth rate is proportional to sin theta0, and at small tilts too small to be seen in 20"
        " orbits, least of all near C/A = 1.14, where this change of the start contains nothing of the growing mode."
        " Just right of C/A = 4/3 the motion is stable, but the change of the start alters the momentum of the"
        " spin too, and with it the steady motion: the start is $4 (C/A - 1)/(3 C/A - 4)$ times 1e-4 rad away from it, and the"
        " oscillation is above the tolerance.",
    ),
    Picture(
        "gravity_gradient",
        "A body with three different moments, without rotor and magnet, at rest in the orbital frame, its first axis along"
        " the radius and its third along the orbit normal; the start changed by 1e-4. It survives in Lagrange's triangle"
        " (C > B > A, right) and in the region of DeBra and Delp (C < A < B, left), where it is stable by gyroscopic"
        " terms.",
    ),
    Picture(
        "gravity_gradient_energy",
        "The same motions by theory alone. In Lagrange's triangle the energy has a minimum, and small dissipation leaves them"
        " stable; in the region of DeBra and Delp only gyroscopic terms make them stable, and dissipation destroys it. On the"
        " coloured lines two of the three frequencies of small oscillations are in resonance.",
    ),
    Picture(
        "gravity_gradient_damped",
        "The stability diagram of the gravity gradient with viscous damping, a torque of -0.3 B Omega times the angular velocity relative to the"
        " orbit. Motions in Lagrange's triangle return to rest. Motions in the region of DeBra and Delp drift, except at 10 of 962"
        " points next to K1 = K3 = 0, a sphere. There, and where A is small, deviations grow too slowly to be seen in 50 orbits."
        " On the line K1 = K3 > 0 the body is symmetric (A = B): a turn about its axis neither grows nor decays.",
    ),
    Picture(
        "gravity_gradient_uncertain",
        "The probability that a satellite in the region of DeBra and Delp survives 20 orbits if its moments of inertia are"
        " known to one per cent each, from 50 draws for each cell; the interval of Wilson is at most 0.27 wide. Next to"
        " K1 = 0, where C = A, the label of the nominal body means little.",
        probable="permanent_rotation",
    ),
    Picture(
        "capture",
        "In which of four attitudes the gravity gradient captures a damped satellite, by the rates at the start about the"
        " normal and about the third axis. In 0 and 2 the satellite is upside down. Every end is proved by the energy.",
    ),
    Picture(
        "capture_damping",
        "How often a symmetric satellite that is released upright and tumbles ends upside down, against its damping, from 200"
        " starts for each damping; the interval of Wilson is at most 0.11 wide. Every end is proved by the energy.",
        probable="equilibrium_0",
        variable="end_equilibrium",
    ),
    Picture(
        "conditions_k3",
        f"The condition (24) of {SATELLITE} on the rotor momentum k3, with an axial magnet, is a curve and no region: the"
        " rms of theta' over 10 orbits is zero on the line in the middle only, where k3 is exact. On the left of"
        " theta0 = 0.45 the exact motion is unstable, and the smallest deviation grows (for theta0 < 0.13 even rounding"
        " errors do); on the right deviations stay in proportion to those of the start. No curve of theory is drawn, because it would cover this line.",
    ),
    Picture(
        "equilibrium_count",
        "How many orientations of an asymmetric body ($A : B : C = 1 : 1.3 : 1.7$, k3 = 0.1) can rest in the orbital frame,"
        " over the other two components of its rotor: from 24, the number without a rotor, to 8. Near k1 = 1.1,"
        " k2 < 0.05 a small region has 16, between two curves on each of which two pairs of equilibria appear. On every line"
        " equilibria appear or vanish.",
    ),
    Picture(
        "asymmetric_tilt",
        "A body of any three moments with its axis at 60 degrees to the orbit normal and m = -Omega, axial magnet and"
        f" rotor; (19) of {SATELLITE} with its misprint in k3 corrected. The start changed by 1e-4. The body turns"
        " in the orbital frame, so that its linear equations have periodic coefficients; the narrow"
        " tongues of instability are their parametric resonances.",
    ),
    Picture(
        "oblique",
        f"Motions that {SATELLITE} do not give: the axis at rest in the orbital frame, perpendicular neither to the radius"
        f" nor to the velocity, held by a magnet. {AT_REST} They exist for |h1 mu3| <= 3 Omega^2 |A - C| sin theta0; outside"
        " there is no such motion, and nothing is computed. On this border they become the motion perpendicular to the"
        " velocity, at h1 = 0 the one perpendicular to the radius. All of them survive.",
    ),
    Picture(
        "sleeping_top_spin",
        f"A top with a rotor upright over its fixed point, in the Newtonian field of {TOP}, tilted by 1e-4 at the start:"
        " stable where (C r0 + l3)^2 > 4 A [N (C - A) + Mg |z0|]. The rotor can replace the spin.",
    ),
    Picture(
        "sleeping_top_field",
        f"The sleeping top over rotor momentum l3 and gradient N of the field of {TOP}: as this body is slender (C < A), a strong"
        " field holds it upright without any spin.",
    ),
    Picture(
        "conical_precession_spin",
        "Regular precession of a symmetric gyrostat about the vertical (Lagrange's case with a Newtonian field), each point"
        " with the spin m that the exact condition requires, the start changed by 1e-6. It exists for every rate"
        " n but 0, and is unstable inside the border, where the field is strong. Where"
        " (C - A)(n^2 - N) cos theta0 + l3 n + Mg z0 = 0 the required spin is 0, and the motion a permanent rotation (dotted): a line"
        " without width, which the grid meets in single points only.",
    ),
    Picture(
        "grioli",
        "A heavy body with a rotor that precesses regularly about an axis inclined to the vertical, after Grioli (1947) and"
        " Kharlamova (1970): two moments are 1 - d and 1 + d, the third is 1, rotor and centre of mass are on a normal of"
        " a circular section of the ellipsoid of inertia. Every exact start is measured as regular about its two axes"
        " (`label_any_axis`), and drifts about the third axis and the vertical. The growth rate follows from Floquet"
        " multipliers; the tongues are parametric resonances, which become narrower than the grid for small d.",
    ),
    Picture(
        "grioli_nudged",
        "Grioli's precession without a rotor: bodies of every shape, B = 1 the middle moment, the start changed by 1e-4."
        " It is stable but in two tongues. Below the upper tongue, and in places above it, stable motions read as drifting:"
        " near the border the oscillation that the change excites is more than 20 times as large as the change, by the"
        " same factor for a change by 1e-8. At the ends of the tongues the growth is too slow for 400 time units.",
    ),
    Picture(
        "first_order_error",
        f"The error of gamma in the first-order solution (33) of {TOP}, as it follows from the equations of motion, over"
        " the two turns of their figures: of second order in eps and the rotor l/(A r0) together. The form as printed"
        " (`first_order_error_printed`) is wrong by the order of the rotor.",
    ),
    Picture(
        "periodic_solution",
        f"The exact periodic solution of which (33) of {TOP} is the first order, upright, over eps and the body, with the rotor"
        " l1 = l2 = l3 = A r0 / 10. The band below C/A = 0.9, where Omega = 0, is unstable however fast the spin; the tongue from"
        " C/A = 0.4, where Omega = -1/2, is a parametric resonance; for slow spins the path from eps = 0 ends in a fold. As"
        " printed the solution exists and is stable wherever omega'^2 > 0.",
    ),
    Picture(
        "chaos_tumbling",
        "An asymmetric body ($A : B : C = 1 : 1.3 : 1.6$) without rotor and magnet, turned by psi0 about the orbit normal and"
        " tilted by 0.1 from it, rotating at m relative to the orbit. Small librations and fast rotations are regular."
        + CHAOS,
    ),
    Picture(
        "drag_arrow",
        "An arrow-shaped satellite in SI units, released at rest in the orbital frame at a pitch, its centre of pressure 6 cm behind the"
        " centre of mass. Low down drag turns it nose forward, high up the gravity gradient upright, at 90 degrees of pitch. Between, and"
        " from steeper pitches, it tumbles. Nose forward, at pitch 0, it is stable up to 473 km, where the torque of drag falls below"
        " that of the gravity gradient." + CHAOS,
    ),
    Picture(
        "planar_oscillations",
        "A symmetric body whose axis swings in the orbital plane like a pendulum. Each motion is periodic; in the tongues,"
        " resonances with the motion out of the plane, its neighbours leave exponentially. The lines are theory, by Floquet"
        " multipliers." + HYPERBOLIC,
    ),
    Picture(
        "plane_libration_rotor",
        "An asymmetric body ($A : B : C = 1 : 1.3 : 1.6$) that librates in the plane of the orbit, with a rotor along the normal."
        " The rotor does not change the libration, but its stability: lines as above. Unstable strips that read as regular"
        " grow too slowly to be seen in 150 orbits." + HYPERBOLIC,
    ),
    Picture(
        "plane_rotation_rotor",
        "The same body rotating in the plane of the orbit, over the rate at which its first axis passes the radius. In the"
        " white strip it cannot pass the velocity, and librates." + HYPERBOLIC,
    ),
    Picture(
        "chaos_unstable",
        f"The motion perpendicular to the velocity, (24) of {SATELLITE}, started as in stability_perp_velocity and followed"
        " for 80 orbits: what it becomes where it is unstable." + CHAOS,
    ),
    Picture(
        "elliptic_orbit",
        "Pitch of a satellite on an elliptic orbit, Beletsky's equation: the odd solutions of the period of the orbit, followed"
        " from a sphere, K = 0 (left), and from a circular orbit, e = 0 (right), and their stability by Floquet multipliers. On"
        " the right those from K > 1/3 end in a fold; there is no solution in the white region. Started 1e-4 away and seen once an"
        " orbit, for 50 orbits (`label`), the 1766 stable ones are steady; of 1993 unstable ones 30 grow too slowly to be seen, and"
        " where chaos follows the label of 645 depends on the step: unresolved.",
        folder="docs/examples/elliptic_orbit",
    ),
    Picture(
        "two_field_top",
        "A gyrostat about a fixed point in two uniform fields, its weight and a magnetic one across it: rotation at m about its axis,"
        " which rests against the fields' resultant at theta0 to the vertical, the start changed by 1e-4. It is stable where"
        " (C m + l3)^2 > 4 A F, with the resultant F = |mu3|/sin theta0. Theory comes from `atlas.systems.gyrostat` and two"
        " directions.",
        folder="docs/examples/two_field_top",
    ),
)


def write_picture(figure: Figure, path: Path) -> None:
    """Write a figure for a page as PNG."""
    with rc_context(style.STYLE):
        figure.savefig(path, format="png", dpi=DPI, pil_kwargs={"optimize": True})


def agreement_with_theory(ds: xr.Dataset) -> str:
    """The share of the compared points at which measured and predicted labels agree, in words."""
    if "predicted" not in ds:
        return "nothing to compare"
    label, predicted = ds["label"], ds["predicted"]
    if "predicted_any_axis" in ds:
        label, predicted = ds["label_any_axis"], ds["predicted_any_axis"]
    agreement = theory.agreement(label.values, predicted.values)
    compared = int((agreement != Agreement.NOT_COMPARED).sum())
    if not compared:
        return "nothing to compare"
    share = 100 * (agreement == Agreement.AGREE).sum() / compared
    return f"{share:.2f} % of {compared} compared points agree with theory"


def section(picture: Picture, ds: xr.Dataset) -> list[str]:
    """The lines of the page about one scene."""
    return [
        f"## {ds.attrs['title']}", "", f"![{picture.scene}](gallery/{picture.scene}.png)", "",
        with_formulas(picture.caption), "",
        f"`{picture.folder}/{picture.scene}.toml`: {ds['label'].size} points, {agreement_with_theory(ds)}.", "",
        *commands(picture), "",
        *([] if is_example(picture) else [f'<a href="{picture.scene}_page.html">The same as a page to point at</a>', ""]),
    ]  # fmt: skip


def is_example(picture: Picture) -> bool:
    """Whether the scene is one of an example system."""
    return picture.folder != "configs"


def register_example(picture: Picture) -> None:
    """Register the system of an example, which the `__init__` of its package defines."""
    sys.path.insert(0, str(picture.file.parent))
    for kind in vars(importlib.import_module(picture.file.parent.name)).values():
        if isinstance(kind, type) and issubclass(kind, System) and getattr(kind, "name", "") == picture.scene:
            atlas.register(kind)


def commands(picture: Picture) -> list[str]:
    """Two blocks of Markdown: the commands that make the figure, and the same in Python."""
    name = picture.scene
    run = [f"atlas new {name}", f"atlas run {name}.toml"]
    scene = f'atlas.example("{name}")'
    if is_example(picture):
        file = f"{picture.folder}/{name}.toml"
        run = [f"pip install ./{picture.folder}", f"atlas run {file} -o {name}.nc"]
        scene = f'"{file}"'
    python, shown = ["import atlas", "", f"ds = atlas.run({scene})"], "ds"
    if picture.probable:
        python.append(f'shares = ds.atlas.probability("{picture.variable}", over="draw")')
        shown = f'shares.sel({picture.variable}="{picture.probable}")'
    else:
        run.append(f"atlas map {name}.nc{picture.options}")
    options = ", ".join(
        f"{option.removeprefix('--no-')}=False" if option.startswith("--no-") else f"{option[2:]}=True"
        for option in picture.options.split()
    )
    python.append(f'{shown}.atlas.map({options}).savefig("{name}.png")')
    return ["```bash", *run, "```", "", "```py", *python, "```"]


def is_current(file: Path, scene: atlas.Scene) -> bool:
    """Whether the file is an atlas of this scene."""
    if not file.exists():
        return False
    with atlas.open_atlas(file) as ds:
        return bool(ds.attrs.get("atlas_scene") == scene.toml())


def draw(picture: Picture, out: Path, force: bool, docs: Path | None, count: int | None) -> list[str]:
    """Compute the atlas of a picture if need be, and draw it; returns its section of the page."""
    file = out / f"{picture.scene}.nc"
    if is_example(picture):  # in a folder apart from the atlases whose pages scripts/docs.sh makes
        register_example(picture)
        (out / "examples").mkdir(exist_ok=True)
        file = out / "examples" / file.name
    table = tomllib.loads(picture.file.read_text())
    if count:
        table["axes"] = {name: axis | {"count": count} for name, axis in table["axes"].items()}
    scene = scene_from(table, picture.scene)
    if force or not is_current(file, scene):
        atlas.run(scene, file, force=True)
    with atlas.open_atlas(file) as ds:
        shown = ds
        if picture.probable:
            shares = ds.atlas.probability(picture.variable, over="draw")
            shown = shares.sel({picture.variable: picture.probable})
        figure = maps.atlas_map(shown, boundary="--no-boundary" not in picture.options)
        for suffix in (".png", ".pdf"):
            style.save(figure, file.with_suffix(suffix))
        if docs:
            write_picture(figure, docs / "gallery" / f"{picture.scene}.png")
            if picture.scene in PAGES:
                page = atlas_page(ds, max_points=PAGE_POINTS)
                page.save(docs / "gallery" / f"{picture.scene}_page.html", force=True)
        return section(picture, ds)


def border_figure(
    system: str, body: dict[str, float], ranges: dict[str, tuple[float, float]], spacing: float
) -> Figure:
    """The borders of bodies, and a grid of points, none of which is in the regions between the borders."""
    figure = atlas.borders(system, body, ranges).atlas.diagram()
    (ax,) = figure.axes
    for set_limits, limits in zip((ax.set_xlim, ax.set_ylim), ranges.values(), strict=True):
        set_limits(*limits)
    if spacing:
        sides = [spacing * (0.5 + np.arange(-20, 20)) for _ in ranges]
        ax.plot(*(side.ravel() for side in np.meshgrid(*sides)), "+", color="0.5", markersize=5, zorder=1)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [picture.scene for picture in PICTURES]
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gallery", help="default: %(default)s")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, default=names)
    parser.add_argument("--force", action="store_true", help="compute every atlas anew")
    parser.add_argument("--count", type=int, help="points of each axis (default: those of the scene)")
    parser.add_argument(
        "--docs", nargs="?", type=Path, const=DOCS, help="rewrite the pictures and the page in docs/"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    lines = [
        "# Gallery",
        "",
        "Each figure is made from a scene in `configs/` by `python scripts/tools/gallery.py`, which writes it as PNG and"
        ' PDF, and the atlas behind it, to `out/gallery/`. "Changed" starts are those of the scene\'s `[nudge]`.',
        "",
        "On the site of these pages a link below each figure leads to its [page to point at](page.md), with the motion of every"
        f" point. Five of them are in the repository, with at most {PAGE_POINTS} points each; `sh scripts/docs.sh` makes those of"
        " the atlases in `out/gallery/`.",
        "",
        "Below each figure stand the commands that make it, and the same in Python; `atlas.example` takes changes of the scene,"
        ' such as `axes={"sigma": {"count": 40}}`.',
        "",
    ]
    chosen = [picture for picture in PICTURES if picture.scene in options.only]
    for i, picture in enumerate(chosen, 1):
        print(f"{i} of {len(chosen)}: {picture.scene}", flush=True)
        lines += draw(picture, options.out, options.force, options.docs, options.count)
    if options.docs:
        from amer2013_figures import figures  # make_docs puts its folder on the path

        for number in PAPER_FIGURES:
            write_picture(figures.draw(number), options.docs / f"fixed_point_figure_{number:02d}.png")
        for name, system, body, along, values, variable in BRANCHES:
            branches = atlas.branches(system, body, along={along: values})
            write_picture(branches.atlas.diagram(variable), options.docs / f"{name}.png")
        for name, system, body, ranges, spacing in BORDERS:
            write_picture(border_figure(system, body, ranges, spacing), options.docs / f"{name}.png")
        if len(chosen) == len(PICTURES):
            (options.docs / "gallery.md").write_text("\n".join(lines).rstrip() + "\n")
    print(f"wrote {options.out}" + (f" and {options.docs}" if options.docs else ""))


if __name__ == "__main__":
    main()
