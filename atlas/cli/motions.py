"""Commands for single points: points, trajectory."""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import say
from .options import (
    DONE,
    FIGURES,
    FILES,
    STANDARD_INPUT,
    Commands,
    add_command,
    assignment_option,
    axis_values,
    check_at_least,
    default_name,
    force_option,
    input_files,
    option_with_default,
    out_option,
    quiet_option,
    read_input,
    read_scene,
    threads_option,
)

if TYPE_CHECKING:
    from xarray import Dataset


def add_points(commands: Commands) -> None:
    """Add the command `points`."""
    from ..scene.model import DEFAULTS, Duration

    command = add_command(commands, "points", _points, "label points of a file, which names their parameters")
    command.add_argument("system", metavar="SYSTEM", help="satellite, fixed_point, or a system of your own")
    command.add_argument(
        "points",
        metavar="POINTS",
        help=".csv with names in its first line, or .nc; - for CSV on standard input",
    )
    out_option(command, "FILE", ".nc, or .csv", required=True)
    option_with_default(
        command, "--duration", "T", str(Duration()), 'time units, or as in a scene: "20 orbits", "50 turns"'
    )
    option_with_default(command, "--method", "NAME", DEFAULTS.method, "rk4 or rk8")
    size = command.add_mutually_exclusive_group()
    option_with_default(size, "--tolerance", "E", DEFAULTS.tolerance, "as in a scene")
    size.add_argument("--step", type=float, metavar="H", help="time units")
    option_with_default(command, "--rate-tolerance", "R", DEFAULTS.rate_tolerance, "rad per time unit")
    command.add_several(
        "--keep", belongs=_is_column, default=[], metavar="NAME",
        help="columns that are no parameters, to be kept; those of text, id, index, name, number and point always are",
    )  # fmt: skip
    threads_option(command)
    force_option(command, "an existing file")
    quiet_option(command)


def _is_column(word: str) -> bool:
    """Whether a word after --keep is a column: neither a file nor a system."""
    from .. import systems

    return word != STANDARD_INPUT and not word.lower().endswith(FILES) and word not in systems.names()


def _points(options: argparse.Namespace) -> int:
    """Run the command `points`; returns its exit code."""
    from .. import systems
    from ..io import netcdf
    from ..scene import tables

    check_at_least("--threads", options.threads, 1)
    from_input = options.points == STANDARD_INPUT
    inputs = [] if from_input else [options.points]
    out = netcdf.writable(options.out, tables.FORMATS, force=options.force, inputs=inputs)
    system = systems.get(options.system)
    numeric = {*system.parameters, *options.keep}
    columns: dict[str, Any]
    if from_input:
        columns = tables.read_csv(io.StringIO(read_input()), "standard input", numeric)
    else:
        columns = tables.read(options.points, numeric)
    from ..analysis.summary import summary
    from ..label.points import label_points

    ds = label_points(
        system.name,
        columns,
        duration=_number_or_text(options.duration),
        step=options.step,
        tolerance=options.tolerance,
        method=options.method,
        rate_tolerance=options.rate_tolerance,
        threads=options.threads,
        progress=not options.quiet,
        keep=options.keep,
    )
    (netcdf.write_csv if out.suffix.lower() == ".csv" else netcdf.write)(ds, out)
    say(*summary(ds).split("\n"), f"wrote {out}")
    return DONE


def _number_or_text(text: str) -> float | str:
    """The number of a text, or else the text."""
    try:
        return float(text)
    except ValueError:
        return text


def add_trajectory(commands: Commands) -> None:
    """Add the command `trajectory`."""
    command = add_command(
        commands, "trajectory", _trajectory, "integrate one point of a scene and draw its motion"
    )
    command.add_argument(
        "scene", metavar="SCENE", help="scene file, atlas or run folder, - for standard input"
    )
    assignment_option(command, "--at", "AXIS=VALUE", "the point, by a value for every axis")
    out_option(command, "OUT", ".png, .pdf, .svg or .nc (default: NAME_trajectory.png)")
    option_with_default(command, "--samples", "N", 1001, "instants to keep")
    force_option(command, "an existing file")


def _trajectory(options: argparse.Namespace) -> int:
    """Run the command `trajectory`; returns its exit code."""
    from ..analysis.metadata import system_of
    from ..io import netcdf

    name = options.out or f"{default_name(options.scene)}_trajectory.png"
    out = netcdf.writable(name, (".nc", *FIGURES), force=options.force, inputs=input_files(options.scene))
    check_at_least("--samples", options.samples, 2)
    coordinates = axis_values("--at", options.at)
    tr = _motion(options.scene, coordinates, options.samples)
    if out.suffix.lower() == ".nc":
        netcdf.write(tr, out)
    else:
        from ..plotting import style, trajectory

        style.save(trajectory.trajectory_figure(tr), out)
    observables = system_of(tr).observables
    variable = observables[0].name if observables else "theta"
    low, high, unit = float(tr[variable].min()), float(tr[variable].max()), tr[variable].attrs["units"]
    duration = f"{float(tr['time'][-1]):.9g} time units"
    say(
        f"{variable} from {low:.9g} to {high:.9g}{'' if unit == '1' else ' ' + unit} in {duration}; wrote {out}"
    )
    return DONE


def _motion(name: str, coordinates: dict[str, float], samples: int) -> Dataset:
    """The trajectory at some coordinates of a scene or of the scene of an atlas, or of an atlas' nearest single point."""
    if Path(name).suffix.lower() != ".nc" and not Path(name).is_dir():
        scene = read_scene(name)
    else:
        from ..analysis.metadata import scene_of
        from ..analysis.select import nearest_trajectory
        from ..runs.backend import open_atlas

        with open_atlas(name) as ds:
            scene_of_atlas = scene_of(ds)
            if scene_of_atlas is None:
                return nearest_trajectory(ds, coordinates, samples)
        scene = scene_of_atlas
    from ..label.trajectory import trajectory_of_scene

    return trajectory_of_scene(scene, coordinates, samples=samples)
