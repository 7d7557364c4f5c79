"""Make every figure of the gallery from its scene, and the page docs/gallery.md with times and agreement.

    python scripts/gallery.py [--out out/gallery] [--only NAME ...] [--force]

A scene that has been run is not run again without --force. Whole gallery: some ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

from PIL import Image

import atlas
from atlas.label import theory
from atlas.plotting import maps, style
from atlas.runs import open

ROOT = Path(__file__).parent.parent
# Scene, variable of its map, and what a reader should see in it.
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
        "The condition on k3 is a curve: the unsteadiness falls to zero on it alone.",
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
        "Oblique motions, missed by the paper: they join its conical to its hyperboloidal ones.",
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


def shrink(figure: object) -> bytes:
    """A figure as a small PNG for the page; the full one is in the output folder."""
    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=300)  # type: ignore[attr-defined]
    picture = Image.open(raw).convert("RGB")
    picture = picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS)
    small = io.BytesIO()
    picture.quantize(96).save(small, "PNG", optimize=True)
    return small.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gallery")
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--force", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    pictures = ROOT / "docs" / "gallery"
    pictures.mkdir(exist_ok=True)
    rows = [
        "# Gallery",
        "",
        "Made by `python scripts/gallery.py` from the scenes in `configs/`, on one machine.",
    ]
    rows += ["Times are those of the runs; the full figures are PNG and PDF in `out/gallery/`.", ""]
    for name, variable, words in FIGURES:
        file = options.out / f"{name}.nc"
        if options.only is not None and name not in options.only:
            continue
        if options.force or not file.exists():
            print(f"{name}: running", flush=True)
            atlas.run(atlas.load_scene(ROOT / "configs" / f"{name}.toml"), file, force=True)
        with open.open_atlas(file) as ds:
            figure = maps.atlas_map(ds, variable)
            for suffix in (".png", ".pdf"):
                style.save(figure, file.with_suffix(suffix))
            (pictures / f"{name}.png").write_bytes(shrink(figure))
            words_of_theory = "nothing to compare"
            if "predicted" in ds:
                agree = theory.agreement(ds["label"].values, ds["predicted"].values)
                if compared := (agree > 0).sum():
                    share = 100 * (agree == 1).sum() / compared
                    words_of_theory = f"{share:.2f} % of {compared} compared points agree with theory"
            rows += [
                f"## {ds.attrs['title']}", "", f"![{name}](gallery/{name}.png)", "", words, "",
                f"`configs/{name}.toml`: {ds['label'].size} points, {ds.attrs['atlas_seconds']:.0f} s,"
                f" {words_of_theory}.", "",
            ]  # fmt: skip
        print(f"{name}: drawn", flush=True)
    if options.only is None:
        (ROOT / "docs" / "gallery.md").write_text("\n".join(rows))


if __name__ == "__main__":
    main()
