"""Make every figure of the gallery from its scene, and the page docs/gallery.md with times and agreement.

    python scripts/tools/gallery.py [--out out/gallery] [--only NAME ...] [--force]

A scene whose atlas exists is not run again without --force. The whole gallery takes about ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import xarray as xr
from matplotlib.figure import Figure
from PIL import Image

import atlas
from atlas.flags import Agreement
from atlas.label import theory
from atlas.plotting import maps, style

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "gallery"
# Scene, variable of its map, and caption.
FIGURES = [
    (
        "stability_cylindrical",
        "label",
        "Cylindrical rotation over C/A and spin: the classical diagram of stability.",
    ),
    (
        "stability_perp_radius",
        "label",
        "Axis perpendicular to the radius (the paper's conical motion): stable for C > A.",
    ),
    (
        "stability_perp_velocity",
        "label",
        "Axis perpendicular to the velocity (the paper's hyperboloidal motion).",
    ),
    (
        "gravity_gradient",
        "label",
        "Asymmetric body at rest in the orbital frame: Lagrange and DeBra-Delp regions.",
    ),
    (
        "conditions_k3",
        "theta_dot_rms",
        "The condition on k3 is a curve: the rms of theta' is zero on that curve only.",
    ),
    (
        "equilibrium_count",
        "equilibrium_count",
        "How many relative equilibria a body has, over the rotor components.",
    ),
    ("asymmetric_tilt", "label", "The 60 degree motion of an asymmetric body, (19)."),
    (
        "oblique",
        "label",
        "Oblique motions, which the paper does not give: they connect its conical and hyperboloidal ones.",
    ),
    ("sleeping_top_spin", "label", "Sleeping gyrostat: stability over spin and rotor."),
    ("sleeping_top_field", "label", "Sleeping gyrostat: stability over rotor and Newtonian field."),
    (
        "conical_precession_spin",
        "label",
        "Regular precession about the vertical: where it exists and survives.",
    ),
    ("first_order_error", "first_order_error", "Error of the first-order fast-spin solution."),
]
WIDTH = 700  # pixels of the pictures in docs


def small_png(figure: Figure) -> bytes:
    """A figure as a small PNG for the page; the large one is in the output folder."""
    large = io.BytesIO()
    figure.savefig(large, format="png", dpi=300)
    picture = Image.open(large).convert("RGB")
    picture = picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS)
    small = io.BytesIO()
    picture.save(small, "PNG", optimize=True)
    return small.getvalue()


def agreement_with_theory(ds: xr.Dataset) -> str:
    """The share of the compared points at which measured and predicted labels agree, in words."""
    if "predicted" not in ds:
        return "nothing to compare"
    agreement = theory.agreement(ds["label"].values, ds["predicted"].values)
    compared = int((agreement != Agreement.NOT_COMPARED).sum())
    if not compared:
        return "nothing to compare"
    share = 100 * (agreement == Agreement.AGREE).sum() / compared
    return f"{share:.2f} % of {compared} compared points agree with theory"


def section(name: str, caption: str, ds: xr.Dataset) -> list[str]:
    """The lines of the page about one scene."""
    return [
        f"## {ds.attrs['title']}", "", f"![{name}](gallery/{name}.png)", "", caption, "",
        f"`configs/{name}.toml`: {ds['label'].size} points, {ds.attrs['atlas_seconds']:.0f} s,"
        f" {agreement_with_theory(ds)}.", "",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gallery")
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--force", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    PICTURES.mkdir(exist_ok=True)
    lines = [
        "# Gallery",
        "",
        "Made by `python scripts/tools/gallery.py` from the scenes in `configs/`, on one machine.",
        "Times are those of the runs; the large figures are PNG and PDF in `out/gallery/`.",
        "",
    ]
    for name, variable, caption in FIGURES:
        if options.only is not None and name not in options.only:
            continue
        file = options.out / f"{name}.nc"
        if options.force or not file.exists():
            print(f"{name}: running", flush=True)
            atlas.run(atlas.load_scene(ROOT / "configs" / f"{name}.toml"), file, force=True)
        with atlas.open_atlas(file) as ds:
            figure = maps.atlas_map(ds, variable)
            for suffix in (".png", ".pdf"):
                style.save(figure, file.with_suffix(suffix))
            (PICTURES / f"{name}.png").write_bytes(small_png(figure))
            lines += section(name, caption, ds)
        print(f"{name}: drawn", flush=True)
    if options.only is None:
        (ROOT / "docs" / "gallery.md").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
