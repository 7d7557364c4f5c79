"""The commands points, trajectory, compare and map."""

from __future__ import annotations

import argparse
from contextlib import ExitStack, suppress
from dataclasses import Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import atlas

from .. import systems
from ..errors import MAX_MESSAGE, BadInput, attribute_text, say
from ..files import FIGURES, atomic_write, without_suffix, writable
from ..plotting.options import MapOptions
from ..scene.model import DEFAULTS, Duration
from ..scene.text import open_text
from ..store.finished import suffixes
from .options import (
    ATLAS,
    DEGREES,
    FILES,
    QUIET,
    STANDARD_INPUT,
    THREADS,
    VERBOSE,
    Argument,
    argument,
    assignment_option,
    assignments,
    axis_values,
    command,
    default_name,
    input_files,
    option_with_default,
    out_options,
    read_scene,
)

if TYPE_CHECKING:
    from xarray import Dataset


@command(
    "points",
    argument("system", metavar="SYSTEM", help="satellite, fixed_point, or a system of your own"),
    argument(
        "points",
        metavar="POINTS",
        help=".csv with names in its first line, or .nc; - for CSV on standard input",
    ),
    *out_options("FILE", ".nc, or .csv", required=True),
    option_with_default(
        "--duration", "T", str(Duration()), 'time units, or as in a scene: "20 orbits", "50 turns", "60 / Omega"'
    ),
    option_with_default("--transient", "T", "0", "time before statistics and labels begin, likewise"),
    option_with_default("--method", "NAME", DEFAULTS.method, "rk4 or rk8"),
    [
        option_with_default("--tolerance", "E", DEFAULTS.tolerance, "as in a scene"),
        argument("--step", type=float, metavar="H", help="time units"),
    ],
    option_with_default("--rate-tolerance", "R", DEFAULTS.rate_tolerance, "rad per time unit, or arithmetic"),
    argument(
        "--keep", default=[], metavar="NAME",
        belongs=lambda word: word not in (STANDARD_INPUT, *systems.names()) and not word.lower().endswith(FILES),
        help="columns that are no parameters, to be kept; those of text, id, index, name, number and point always are",
    ),
    THREADS,
    QUIET,
    VERBOSE,
)  # fmt: skip
def label_points_of_file(options: argparse.Namespace) -> None:
    """Label points of a file, which names their parameters."""
    from ..scene import tables
    from ..store import netcdf

    from_input = options.points == STANDARD_INPUT
    inputs = [] if from_input else [options.points]
    out = writable(options.out, tables.FORMATS, force=options.force, inputs=inputs)
    system = systems.get(options.system)
    columns: dict[str, Any]
    if from_input:
        with open_text(None) as file:
            columns = tables.read_csv(file, "standard input", system.parameters)
    else:
        columns = tables.read(options.points, system.parameters, options.keep)
    from ..analysis.summary import summary

    duration: float | str = options.duration
    with suppress(ValueError):  # a text such as "20 orbits" stays a text
        duration = float(options.duration)
    same = ("transient", "step", "tolerance", "method", "rate_tolerance", "threads", "keep")
    arguments = {name: getattr(options, name) for name in same}
    ds = atlas.label_points(system.name, columns, duration=duration, progress=not options.quiet, **arguments)
    (_write_csv if out.suffix.lower() == ".csv" else netcdf.write)(ds, out)
    say(*summary(ds, verbose=options.verbose).split("\n"), f"wrote {out}")


def _write_csv(ds: Dataset, path: Path) -> None:
    """Write coordinates and variables of labelled points to a CSV file. The file is complete or is not written at all."""
    import numpy as np
    import pandas as pd

    columns: dict[str, list[Any]] = {}
    for name, array in [*ds.coords.items(), *ds.data_vars.items()]:
        if set(array.dims) <= {"point"}:
            flags = attribute_text(array.attrs, "flag_meanings", limit=MAX_MESSAGE).split()
            values = np.broadcast_to(array.values, ds.sizes["point"]).tolist()
            columns[str(name)] = [flags[value] for value in values] if flags else values
    with atomic_write(path) as temporary:
        pd.DataFrame(columns).to_csv(temporary, index=False, na_rep="nan", lineterminator="\n")


@command(
    "trajectory",
    argument("scene", metavar="SCENE", help="scene file, atlas or run folder, - for standard input"),
    assignment_option("--at", "AXIS=VALUE", "the point, by a value for every axis"),
    *out_options("OUT", ".png, .pdf, .svg or .nc (default: NAME_trajectory.png)"),
    option_with_default("--samples", "N", 1001, "instants to keep", lowest=2),
    DEGREES,
)
def draw_trajectory(options: argparse.Namespace) -> None:
    """Integrate one point of a scene and draw its motion."""
    from ..analysis.metadata import system_of

    out = file_of_scene(options, "trajectory")
    coordinates = axis_values("--at", options.at)
    tr = _motion(options.scene, coordinates, options.samples)
    write_or_draw(tr, out, "plot", degrees=bool(options.degrees))
    observables = system_of(tr).observables
    variable = observables[0].name if observables else "theta"
    values, unit = tr[variable].values, attribute_text(tr[variable].attrs, "units")
    span = f"{values.min():.9g} to {values.max():.9g}{'' if unit == '1' else ' ' + unit}"
    say(f"{variable} from {span} in {float(tr['time'][-1]):.9g} time units; wrote {out}")


def file_of_scene(options: argparse.Namespace, what: str) -> Path:
    """Return the path for a dataset computed from a scene, or for its figure. Raise BadInput if the path must not be written."""

    name = options.out or f"{default_name(options.scene)}_{what}.png"
    return writable(name, (".nc", *FIGURES), force=options.force, inputs=input_files(options.scene))


def write_or_draw(ds: Dataset, out: Path, figure: str, *arguments: str, **options: Any) -> None:
    """Write a dataset to a .nc file, or draw the dataset by the method of `ds.atlas` with the name `figure`."""
    from .. import registration  # noqa: F401  (registers ds.atlas with xarray)

    if out.suffix.lower() == ".nc":
        from ..store import netcdf

        netcdf.write(ds, out)
    else:
        from ..plotting import style

        style.save(getattr(ds.atlas, figure)(*arguments, **options), out)


def _motion(name: str, coordinates: dict[str, float], samples: int) -> Dataset:
    """Return the motion at values of the axes of a scene or atlas. For an atlas without a scene, return the motion of the nearest point."""
    from ..analysis.metadata import resolved_scene
    from ..analysis.select import nearest_trajectory
    from ..label.trajectory import trajectory_of_scene

    if Path(name).suffix.lower() in suffixes() or Path(name).is_dir():
        with atlas.open_atlas(name) as ds:
            scene = resolved_scene(ds, ds)
            if scene is None:
                return nearest_trajectory(ds, coordinates, samples)
    else:
        scene = read_scene(name)
    return trajectory_of_scene(scene, coordinates, samples=samples)


@command(
    "compare",
    ATLAS,
    argument("other", metavar="OTHER", nargs="?", help="another atlas on the same grid, instead of theory"),
    option_with_default("--worst", "N", 5, "disagreements, or changes of each label, to list", lowest=0),
    DEGREES,
    *out_options(
        "FILE", "of two atlases: .png, .pdf or .svg for a map of changed labels, .nc for all differences"
    ),
)
def print_comparison(options: argparse.Namespace) -> None:
    """Print an atlas beside theory, or beside another atlas."""

    if options.out and not options.other:
        raise BadInput(
            "-o: only of two atlases; atlas map --variable agreement draws the comparison with theory"
        )
    inputs = [name for name in (options.atlas, options.other) if name]
    out = options.out and writable(options.out, (".nc", *FIGURES), force=options.force, inputs=inputs)
    with ExitStack() as stack:
        ds, *other = (stack.enter_context(atlas.open_atlas(name)) for name in inputs)
        say(*ds.atlas.compare(*other, worst=options.worst, degrees=options.degrees).split("\n"))
        if out:
            write_or_draw(ds.atlas.differences(*other), out, "map", degrees=options.degrees)
            say(f"wrote {out}")


def map_option(option: Field[Any]) -> Argument:
    """Return the option of the command `map` for a field of `MapOptions`. A Boolean gives a switch, and a mapping gives NAME=VALUE."""
    name, settings = f"--{option.name}", dict[str, Any]({"default": option.default} | option.metadata)
    if option.default is True:
        return argument(f"--no-{option.name}", dest=option.name, action="store_false", help=settings["help"])
    if option.default is False:
        return argument(name, action="store_true", help=settings["help"])
    if "=" in settings.get("metavar", ""):
        return assignment_option(name, settings["metavar"], settings["help"])
    return argument(name, **settings)


@command(
    "map",
    ATLAS,
    *out_options(
        "FIGURE", ".png, .pdf or .svg (default: ATLAS.png and ATLAS.pdf)", replaces="existing figures"
    ),
    argument("--variable", metavar="NAME", help="what to map (default: what the scene is about)"),
    *(map_option(each) for each in fields(MapOptions) if each.metadata),
)
def draw_map(options: argparse.Namespace) -> None:
    """Draw a map of an atlas."""
    from ..plotting import maps, style

    stem = without_suffix(options.atlas, *suffixes())
    names = [options.out] if options.out else [f"{stem}.png", f"{stem}.pdf"]
    paths = [writable(name, FIGURES, force=options.force, inputs=[options.atlas]) for name in names]
    given = {each.name: getattr(options, each.name) for each in fields(MapOptions) if each.metadata}
    for name in ("colors", "labels"):
        given[name] = assignments(f"--{name}", given[name], "NAME=TEXT")
    given["select"] = axis_values("--select", options.select)
    given["dpi"], given["caption"] = 600 if options.dpi is None else options.dpi, False
    if options.size is not None:
        try:
            width, height = map(float, options.size.lower().split("x"))
        except ValueError:
            raise BadInput(f"--size {options.size}: must be WIDTHxHEIGHT in mm, such as 120x90") from None
        given["size"] = width, height
    with atlas.open_atlas(options.atlas) as ds:
        figure = maps.atlas_map(ds, options.variable, **given)
        if options.caption:
            say(style.caption(ds))
    for path in paths:
        style.save(figure, path, options.dpi)
        say(f"wrote {path}")
