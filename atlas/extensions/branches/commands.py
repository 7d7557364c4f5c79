"""The command `atlas branches`."""

from __future__ import annotations

import argparse

from ...cli.atlases import write_or_draw
from ...cli.options import (
    DEGREES,
    SCENE,
    argument,
    command,
    default_name,
    input_files,
    option_with_default,
    out_options,
    read_scene,
)
from ...errors import say
from ...files import FIGURES, atomic_write, writable


@command(
    "branches",
    SCENE,
    *out_options("OUT", ".png, .pdf, .svg, .nc, or of borders .csv (default: NAME_branches.png)"),
    option_with_default("--variable", "NAME", "theta0", "what to draw; gamma: the arcs on the sphere"),
    argument("--borders", action="store_true", help="the borders over both axes of the scene as curves"),
    DEGREES,
)
def draw_branches(options: argparse.Namespace) -> None:
    """Draw the branches of equilibria of the bodies of a scene along its only axis, or the borders of equilibria over two axes."""
    from .borders import borders_of_scene, table
    from .branches import branches_of_scene

    what = "borders" if options.borders else "branches"
    suffixes = (".nc", *FIGURES, *[".csv"] * options.borders)
    name = options.out or f"{default_name(options.scene)}_{what}.png"
    out = writable(name, suffixes, force=options.force, inputs=input_files(options.scene))
    scene = read_scene(options.scene)
    ds = borders_of_scene(scene) if options.borders else branches_of_scene(scene)
    if out.suffix.lower() == ".csv":
        with atomic_write(out) as temporary:
            table(ds).to_csv(temporary, index=False, lineterminator="\n")
    else:
        write_or_draw(ds, out, "diagram", options.variable, degrees=bool(options.degrees))
    if options.borders:
        curves = ds["curve"].values[-1] + 1 if ds.sizes["vertex"] else 0
        say(f"{curves} borders, {ds.sizes['special']} special points; wrote {out}")
    else:
        say(
            f"{ds.sizes['branch']} branches, {ds.sizes['fold']} points at which they meet or change; wrote {out}"
        )
