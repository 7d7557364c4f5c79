"""The command `atlas branches`."""

from __future__ import annotations

import argparse

from ...cli.atlases import write_or_draw
from ...cli.options import (
    FIGURES,
    SCENE,
    command,
    default_name,
    input_files,
    option_with_default,
    out_options,
    read_scene,
)
from ...errors import say


@command(
    "branches",
    SCENE,
    *out_options("OUT", ".png, .pdf, .svg or .nc (default: NAME_branches.png)"),
    option_with_default("--variable", "NAME", "theta0", "what to draw; gamma: the arcs on the sphere"),
)
def draw_branches(options: argparse.Namespace) -> None:
    """Draw the branches of equilibria of the bodies of a scene along its only axis."""
    from ...store import netcdf
    from .branches import branches_of_scene

    name = options.out or f"{default_name(options.scene)}_branches.png"
    out = netcdf.writable(name, (".nc", *FIGURES), force=options.force, inputs=input_files(options.scene))
    ds = branches_of_scene(read_scene(options.scene))
    write_or_draw(ds, out, "diagram", options.variable)
    say(f"{ds.sizes['branch']} branches, {ds.sizes['fold']} points at which they meet or change; wrote {out}")
