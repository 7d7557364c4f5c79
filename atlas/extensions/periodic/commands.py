"""The command `atlas periodic`."""

from __future__ import annotations

import argparse

import numpy as np

from ...cli import options as cli
from ...cli.atlases import file_of_scene, write_or_draw
from ...errors import say


@cli.command(
    "periodic",
    cli.SCENE,
    cli.assignment_option("--at", "AXIS=VALUE", "a value of every axis of the scene"),
    cli.argument(
        "--frequency", metavar="N", type=int, help="position of a frequency, 1 the largest (default: all)"
    ),
    cli.option_with_default("--orbits", "N", 60, "most orbits of a family", lowest=1),
    cli.option_with_default("--variable", "NAME", "period", "what to draw: period, amplitude or energy"),
    *cli.out_options("OUT", ".png, .pdf, .svg or .nc (default: NAME_periodic.png)"),
)
def draw_families(options: argparse.Namespace) -> None:
    """Draw or write the families of periodic motions that are born from a steady motion of a scene."""
    from ...scene import grid
    from .periodic import periodic

    out, scene = file_of_scene(options, "periodic"), cli.read_scene(options.scene)
    located = grid.point_at(scene, cli.axis_values("--at", options.at), "a family")
    point = {name: float(values[0]) for name, values in located.base.items() if not np.isnan(values[0])}
    ds = periodic(scene.system.name, point, frequency=options.frequency or "all", orbits=options.orbits)
    write_or_draw(ds, out, "periodic_diagram", options.variable)
    say(f"families: {ds.sizes['family']}, of at most {ds.sizes['orbit']} orbits; wrote {out}")
