"""Commands for single points: points, trajectory."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..files import writable
from .options import (
    DONE,
    FIGURES,
    Commands,
    add_command,
    axis_values,
    check_positive,
    force_option,
    option_with_default,
    out_option,
    quiet_option,
    scene_option,
    threads_option,
)


def add_points(commands: Commands) -> None:
    from ..scene.model import DEFAULTS, Duration

    command = add_command(commands, "points", _points, "label points of a file, which names their parameters")
    command.add_argument("system", metavar="SYSTEM", help="satellite or fixed_point")
    command.add_argument("points", metavar="POINTS", help=".csv with names in its first line, or .nc")
    out_option(command, "FILE", ".nc, or .csv", required=True)
    option_with_default(command, "--duration", "T", Duration().amount, "time units")
    option_with_default(command, "--method", "NAME", DEFAULTS.method, "rk4 or rk8")
    size = command.add_mutually_exclusive_group()
    option_with_default(size, "--tolerance", "E", DEFAULTS.tolerance, "as in a scene")
    size.add_argument("--step", type=float, metavar="H", help="time units")
    option_with_default(command, "--rate-tolerance", "R", DEFAULTS.rate_tolerance, "rad per time unit")
    threads_option(command)
    force_option(command, "an existing file")
    quiet_option(command)


def _points(options: argparse.Namespace) -> int:
    from .. import systems
    from ..io import csv as csv_file
    from ..io import netcdf
    from ..scene import tables

    check_positive("--threads", options.threads)
    out = writable(options.out, tables.FORMATS, force=options.force)
    system = systems.get(options.system)
    columns = tables.read(options.points, system.parameters)
    from ..analysis.summary import summary
    from ..label.points import label_points

    ds = label_points(
        system.name,
        columns,
        duration=options.duration,
        step=options.step,
        tolerance=options.tolerance,
        method=options.method,
        rate_tolerance=options.rate_tolerance,
        threads=options.threads,
        progress=not options.quiet,
    )
    (csv_file if out.suffix.lower() == ".csv" else netcdf).write(ds, out)
    print(summary(ds))
    print(f"wrote {out}")
    return DONE


def add_trajectory(commands: Commands) -> None:
    command = add_command(
        commands, "trajectory", _trajectory, "integrate one point of a scene and draw its motion"
    )
    scene_option(command)
    command.add_argument(
        "--at", nargs="+", default=[], metavar="AXIS=VALUE", help="place of the point, a value for every axis"
    )
    out_option(command, "OUT", ".png, .pdf, .svg or .nc (default: SCENE_trajectory.png)")
    option_with_default(command, "--samples", "N", 1001, "instants to keep")
    force_option(command, "an existing file")


def _trajectory(options: argparse.Namespace) -> int:
    from ..io import netcdf
    from ..scene.read import load_scene

    scene = load_scene(options.scene)
    name = options.out or Path(options.scene).stem + "_trajectory.png"
    out = writable(name, (".nc", *FIGURES), force=options.force)
    from ..label.trajectory import trajectory_of_scene

    tr = trajectory_of_scene(scene, axis_values("--at", options.at), samples=options.samples)
    if out.suffix.lower() == ".nc":
        netcdf.write(tr, out)
    else:
        from ..plotting import style, trajectory

        style.save(trajectory.trajectory_figure(tr), out)
    low, high = float(tr["theta"].min()), float(tr["theta"].max())
    print(f"theta from {low:.9g} to {high:.9g} rad in {float(tr['time'][-1]):.9g} time units; wrote {out}")
    return DONE
