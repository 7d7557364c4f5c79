"""The command `atlas branches`."""

from __future__ import annotations

import argparse

from ...cli.atlases import file_of_scene, write_or_draw
from ...cli.options import SCENE, command, option_with_default, out_options, read_scene
from ...errors import say


@command(
    "branches",
    SCENE,
    *out_options("OUT", ".png, .pdf, .svg or .nc (default: NAME_branches.png)"),
    option_with_default("--variable", "NAME", "theta0", "what to draw; gamma: the arcs on the sphere"),
)
def draw_branches(options: argparse.Namespace) -> None:
    """Draw the branches of equilibria of the bodies of a scene along its only axis."""
    from .branches import branches_of_scene

    out = file_of_scene(options, "branches")
    ds = branches_of_scene(read_scene(options.scene))
    write_or_draw(ds, out, "diagram", options.variable)
    say(f"{ds.sizes['branch']} branches, {ds.sizes['fold']} points at which they meet or change; wrote {out}")
