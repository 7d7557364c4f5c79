"""The command `atlas section`."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from ...cli import options as cli
from ...cli.atlases import file_of_scene, write_or_draw
from ...errors import BadInput, allowed_text, say

MAX_POINTS = 4096


@cli.command(
    "section",
    cli.SCENE,
    cli.argument("--on", required=True, metavar="SURFACE", help='such as "psi_dot = 0 rising"'),
    cli.assignment_option("--at", "AXIS=VALUE", "values of axes, one or several (default: all of the scene)"),
    cli.argument("--keep", nargs="+", metavar="NAME", help="what to keep; the first two are drawn"),
    cli.option_with_default("--count", "N", 500, "crossings of each point", lowest=1),
    *cli.out_options("OUT", ".png, .pdf, .svg or .nc (default: NAME_section.png)"),
)
def draw_section(options: argparse.Namespace) -> None:
    """Draw or write a Poincaré section of the motions of a scene."""
    from ...scene import grid
    from .section import section

    out, scene = file_of_scene(options, "section"), cli.read_scene(options.scene)
    for name, value in cli.axis_values("--at", options.at).items():
        if name not in scene.axes:
            raise BadInput(f"--at {name}: no axis of the scene; {allowed_text(name, [*scene.axes])}")
        axis = replace(scene.axes[name], values=np.array([value]))
        scene = replace(scene, axes={**scene.axes, name: axis})
    if scene.size > MAX_POINTS:
        raise BadInput(
            f"{scene.size} points; a section of a scene has at most {MAX_POINTS}: choose some by --at"
        )
    points = grid.check(scene)
    given = {name: v for name, v in points.subset(points.exists).points.items() if not np.isnan(v).all()}
    ds = section(scene.system.name, given, at=options.on, keep=options.keep, count=options.count)
    write_or_draw(ds, out, "section_map")
    say(f"{ds.sizes['point']} points, {int(ds['crossings'].sum())} crossings; wrote {out}")
