"""The command `atlas section`."""

from __future__ import annotations

import argparse

import numpy as np

from ...cli import options as cli
from ...cli.atlases import write_or_draw
from ...errors import BadInput, allowed_text, say
from ...files import FIGURES, writable

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
    from ...scene.grid import Reason, points_at, sentence
    from .section import section

    name = options.out or f"{cli.default_name(options.scene)}_section.png"
    out = writable(name, (".nc", *FIGURES), force=options.force, inputs=cli.input_files(options.scene))
    scene, at = cli.read_scene(options.scene), cli.axis_values("--at", options.at)
    for axis in at.keys() - scene.axes.keys():
        raise BadInput(f"--at {axis}: no axis of the scene; {allowed_text(axis, [*scene.axes])}")
    values = [[at[axis.name]] if axis.name in at else axis.values for axis in scene.axes.values()]
    if (size := int(np.prod([len(each) for each in values], dtype=object))) > MAX_POINTS:
        raise BadInput(f"{size} points; a section of a scene has at most {MAX_POINTS}: choose some by --at")
    places = np.meshgrid(*values, indexing="ij")
    tile = points_at(scene, dict(zip(scene.axes, (each.ravel() for each in places), strict=True)))
    if not tile.exists.any():
        reason = sentence(Reason(tile.reason.max()), scene.system, scene.family, scene.duration)
        raise BadInput(f"no motion: {reason}")
    points = {
        name: values for name, values in tile.subset(tile.exists).points.items() if not np.isnan(values).all()
    }
    ds = section(scene.system.name, points, at=options.on, keep=options.keep, count=options.count)
    write_or_draw(ds, out, "section_map")
    say(f"{ds.sizes['point']} points, {int(ds['crossings'].sum())} crossings; wrote {out}")
