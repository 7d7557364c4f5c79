"""The `atlas` command: parses options, calls the package, prints. It contains no physics."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from ._version import __version__
from .errors import MAX_MESSAGE, MAX_TEXT, BadInput, printable
from .files import writable
from .interruption import INTERRUPTED, MESSAGE, exit_process, signals_as_interrupt

DONE, FAILED, BAD_INPUT = 0, 1, 2
FIGURES = (".png", ".pdf", ".svg")


Handler = Callable[[argparse.Namespace], int]
Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Name of the command and its options; by default those of the process.

    Returns
    -------
    int
        Exit code: 0 done, 1 failed, 2 bad input, 130 interrupted.
    """
    try:
        with signals_as_interrupt():
            options = parser().parse_args(arguments)
            return int(options.handler(options))
    except BadInput as error:
        print(f"atlas: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(MESSAGE, file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FAILED
    except (OSError, MemoryError) as error:
        message = printable(str(error) or type(error).__name__, MAX_MESSAGE)
        print(f"atlas: failed: {message}", file=sys.stderr)
        return FAILED


def command() -> NoReturn:
    """Run the command of this process."""
    try:
        code = main()
    except SystemExit as end:  # of the parser of options
        code = int(end.code or DONE)
    exit_process(code)


def parser() -> argparse.ArgumentParser:
    """The command line with its help; building it imports no compiler."""
    top = _Parser(
        prog="atlas",
        description="Where in parameter space a gyrostat precesses regularly, rotates permanently or drifts.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.",
    )
    top.add_argument("--version", action="version", version=f"atlas {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)
    for add in (
        _add_run,
        _add_status,
        _add_join,
        _add_check,
        _add_points,
        _add_compare,
        _add_map,
        _add_trajectory,
        _add_accuracy,
        _add_conditions,
        _add_stress,
        _add_figures,
        _add_cache,
    ):
        add(commands)
    return top


def _command(commands: Commands, name: str, handler: Handler, text: str) -> argparse.ArgumentParser:
    """A new command; text: what it does, in one line."""
    command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    command.set_defaults(handler=handler)
    return command


def _add_run(commands: Commands) -> None:
    command = _command(commands, "run", _run, "integrate a scene and write its labelled atlas")
    _scene_option(command)
    _out_option(
        command,
        "OUT",
        "NAME.nc, or NAME/ for a run folder, which the same command continues (default: the scene's name with .nc)",
    )
    _threads_option(command)
    command.add_argument("--shard", metavar="I/N", help="compute part I of N of a run folder, counted from 1")
    where = command.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of this dask scheduler")
    where.add_argument("--workers", type=int, metavar="N", help="compute in N processes of one thread each")
    command.add_argument(
        "--dry-run", action="store_true", help="print the expected size, time, memory and error"
    )
    _force_option(command, "an existing atlas")
    _quiet_option(command)


def _run(options: argparse.Namespace) -> int:
    from .scene.read import load_scene

    _check_positive("--threads", options.threads)
    _check_positive("--workers", options.workers)
    shard = _shard(options.shard)
    scene = load_scene(options.scene)
    out = options.out or Path(options.scene).stem + ".nc"
    from .analysis.summary import summary
    from .runs.estimate import dry_run
    from .runs.runner import run

    if options.dry_run:
        print(dry_run(scene, threads=options.threads, workers=options.workers))
        return DONE
    ds = run(
        scene,
        out,
        threads=options.threads,
        progress=not options.quiet,
        force=options.force,
        shard=shard,
        scheduler=options.scheduler,
        workers=options.workers,
    )
    if shard is None:
        print(summary(ds))
        print(f"wrote {out}")
    else:
        print(f"shard {options.shard} is done; {out} holds {ds.attrs['atlas_run']}")
    return DONE


def _shard(text: str | None) -> tuple[int, int] | None:
    """Number of the shard, from 1, and how many there are."""
    if text is None:
        return None
    shard, slash, count = text.partition("/")
    if not (slash and shard.isdecimal() and count.isdecimal() and 1 <= int(shard) <= int(count)):
        raise BadInput(f"--shard {text}: must be I/N with whole numbers, 1 <= I <= N")
    return int(shard), int(count)


def _add_status(commands: Commands) -> None:
    command = _command(commands, "status", _status, "print the progress of a run folder")
    command.add_argument("folder", metavar="RUN", help="run folder")


def _status(options: argparse.Namespace) -> int:
    from .runs.folder import RunFolder

    print(RunFolder.open(options.folder).status())
    return DONE


def _add_join(commands: Commands) -> None:
    command = _command(commands, "join", _join, "write a finished run folder as one file")
    command.add_argument("folder", metavar="RUN", help="run folder")
    _out_option(command, "FILE", "atlas to write (.nc)", required=True)
    _force_option(command, "an existing file")


def _join(options: argparse.Namespace) -> int:
    from .runs.folder import RunFolder

    folder = RunFolder.open(options.folder)
    folder.join(writable(options.out, (".nc",), force=options.force))
    print(f"wrote {options.out}")
    return DONE


def _add_check(commands: Commands) -> None:
    _scene_option(_command(commands, "check", _check, "check a scene without running it"))


def _check(options: argparse.Namespace) -> int:
    from .runs.method_costs import method_lines
    from .scene import grid
    from .scene.read import load_scene

    scene = load_scene(options.scene)
    points = grid.check(scene)
    shape = " x ".join(f"{name} {count}" for name, count in zip(scene.axes, scene.shape, strict=True))
    print(
        f"{printable(scene.title, MAX_TEXT)}\nsystem {scene.system.name}: {shape} = {scene.size} points, duration {scene.duration}"
    )
    if not points.exists.all():
        print(f"the family {scene.family} exists at {100 * points.exists.mean():.1f} % of them")
    for line in method_lines(scene, points):
        print(line)
    for warning in scene.system.warnings(points.base):
        print(f"warning: {printable(warning, MAX_MESSAGE)}")
    return DONE


def _add_points(commands: Commands) -> None:
    from .scene.model import DEFAULTS, Duration

    command = _command(commands, "points", _points, "label points of a file, which names their parameters")
    command.add_argument("system", metavar="SYSTEM", help="satellite or fixed_point")
    command.add_argument("points", metavar="POINTS", help=".csv with names in its first line, or .nc")
    _out_option(command, "FILE", ".nc, or .csv", required=True)
    _option(command, "--duration", "T", Duration().amount, "time units")
    _option(command, "--method", "NAME", DEFAULTS.method, "rk4 or rk8")
    size = command.add_mutually_exclusive_group()
    _option(size, "--tolerance", "E", DEFAULTS.tolerance, "as in a scene")
    size.add_argument("--step", type=float, metavar="H", help="time units")
    _option(command, "--rate-tolerance", "R", DEFAULTS.rate_tolerance, "rad per time unit")
    _threads_option(command)
    _force_option(command, "an existing file")
    _quiet_option(command)


def _points(options: argparse.Namespace) -> int:
    from . import systems
    from .io import csv as csv_file
    from .io import netcdf
    from .scene import tables

    _check_positive("--threads", options.threads)
    out = writable(options.out, tables.FORMATS, force=options.force)
    system = systems.get(options.system)
    columns = tables.read(options.points, system.parameters)
    from .analysis.summary import summary
    from .label.points import label_points

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


def _add_compare(commands: Commands) -> None:
    command = _command(
        commands, "compare", _compare, "print an atlas beside theory: confusion table, worst disagreements"
    )
    _atlas_option(command)
    _option(command, "--worst", "N", 5, "disagreements to list")


def _compare(options: argparse.Namespace) -> int:
    from .analysis.compare import report
    from .runs.open import open_atlas

    with open_atlas(options.atlas) as ds:
        print(report(ds, worst=options.worst))
    return DONE


def _add_map(commands: Commands) -> None:
    command = _command(commands, "map", _map, "draw a map of an atlas")
    _atlas_option(command)
    _out_option(command, "FIGURE", ".png, .pdf or .svg (default: ATLAS.png and ATLAS.pdf)")
    command.add_argument("--variable", metavar="NAME", help="what to map (default: label)")
    command.add_argument("--x", metavar="AXIS", help="horizontal axis (default: the first)")
    command.add_argument("--y", metavar="AXIS", help="vertical axis (default: the second)")
    command.add_argument(
        "--select", action="append", default=[], metavar="AXIS=VALUE", help="place on another axis"
    )
    command.add_argument("--width", choices=("column", "page"), default="column", help="journal width")
    command.add_argument("--caption", action="store_true", help="print a caption for the figure")
    _force_option(command, "existing figures")


def _map(options: argparse.Namespace) -> int:
    from .plotting import maps, style, text
    from .runs.open import open_atlas

    stem = Path(options.atlas).with_suffix("")
    names = [options.out] if options.out else [stem.with_suffix(".png"), stem.with_suffix(".pdf")]
    paths = [writable(name, FIGURES, force=options.force) for name in names]
    select = _axis_values("--select", options.select)
    with open_atlas(options.atlas) as ds:
        figure = maps.atlas_map(
            ds, options.variable, x=options.x, y=options.y, select=select or None, width=options.width
        )
        if options.caption:
            print(text.caption(ds))
    for path in paths:
        style.save(figure, path)
        print(f"wrote {path}")
    return DONE


def _axis_values(option: str, texts: Sequence[str]) -> dict[str, float]:
    """AXIS=VALUE options as numbers by axis."""
    values = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise BadInput(f"{option} {text}: must be AXIS=VALUE with a number") from None
    return values


def _add_trajectory(commands: Commands) -> None:
    command = _command(
        commands, "trajectory", _trajectory, "integrate one point of a scene and draw its motion"
    )
    _scene_option(command)
    command.add_argument(
        "--at", nargs="+", default=[], metavar="AXIS=VALUE", help="place of the point, a value for every axis"
    )
    _out_option(command, "OUT", ".png, .pdf, .svg or .nc (default: SCENE_trajectory.png)")
    _option(command, "--samples", "N", 1001, "instants to keep")
    _force_option(command, "an existing file")


def _trajectory(options: argparse.Namespace) -> int:
    from .io import netcdf
    from .scene.read import load_scene

    scene = load_scene(options.scene)
    name = options.out or Path(options.scene).stem + "_trajectory.png"
    out = writable(name, (".nc", *FIGURES), force=options.force)
    from .label.trajectory import trajectory_of_scene

    tr = trajectory_of_scene(scene, _axis_values("--at", options.at), samples=options.samples)
    if out.suffix.lower() == ".nc":
        netcdf.write(tr, out)
    else:
        from .plotting import style, trajectory

        style.save(trajectory.trajectory_figure(tr), out)
    low, high = float(tr["theta"].min()), float(tr["theta"].max())
    print(f"theta from {low:.9g} to {high:.9g} rad in {float(tr['time'][-1]):.9g} time units; wrote {out}")
    return DONE


def _add_accuracy(commands: Commands) -> None:
    command = _command(
        commands, "accuracy", _accuracy, "measure error against run time at some points of a scene"
    )
    _scene_option(command)
    kinds = ".nc for every number, .csv for the table, .png, .pdf or .svg for the figure; may be repeated"
    _out_option(command, "OUT", kinds, action="append", default=[])
    _option(command, "--points", "N", 64, "points to integrate")
    _force_option(command, "existing files")


def _accuracy(options: argparse.Namespace) -> int:
    from .scene.read import load_scene

    outs = [writable(out, (".nc", ".csv", *FIGURES), force=options.force) for out in options.out]
    scene = load_scene(options.scene)
    from .io import netcdf
    from .plotting import style
    from .plotting.work_precision import figure
    from .validation import work_precision, work_precision_report

    ds = work_precision.work_precision(scene, options.points, progress=True)
    print(work_precision_report.report(ds))
    for out in outs:
        if out.suffix.lower() == ".nc":
            netcdf.write(ds, out)
        elif out.suffix.lower() == ".csv":
            out.write_text(work_precision_report.table(ds))
        else:
            style.save(figure(ds), out)
        print(f"wrote {out}")
    return DONE


def _add_conditions(commands: Commands) -> None:
    command = _command(
        commands, "conditions", _conditions, "print the families of steady motions and their conditions"
    )
    command.add_argument(
        "system", metavar="SYSTEM", nargs="?", default="satellite", help="default: satellite"
    )
    command.add_argument("--family", metavar="NAME", help="one family in detail")
    command.add_argument("--errata", action="store_true", help="only the paper's equations that are wrong")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="comma-separated values, one row for each")
    form.add_argument("--json", action="store_true", help="JSON, with every printed equation")


def _conditions(options: argparse.Namespace) -> int:
    from . import systems
    from .analysis import catalogue

    system = systems.get(options.system)
    families = catalogue.families(system, options.family)
    if options.json:
        content: dict[str, object] = {"system": system.name, "reference": system.reference, "doi": system.doi}
        if not options.errata:
            content["families"] = families
        content["printed"] = catalogue.published(system, options.family, options.errata)
        print(json.dumps(content, indent=1, ensure_ascii=False))
        return DONE
    rows = catalogue.published(system, options.family, errata=True) if options.errata else families
    if options.csv:
        _print_csv(rows)
    elif options.errata:
        _print_errata(rows)
        print(f"{len(rows)} equations differ; {system.reference}")
    elif options.family is not None:
        _print_family(rows[0])
    else:
        _print_catalogue(families, catalogue.published(system), system.reference)
    return DONE


def _print_csv(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows as comma-separated values, lists joined by semicolons."""
    writer = csv.DictWriter(sys.stdout, rows[0] if rows else ["equation"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: "; ".join(value) if isinstance(value, list) else value for key, value in row.items()}
        for row in rows
    )


def _print_errata(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the equations whose printed reading is not the true one."""
    for row in rows:
        print(f"{row['equation']}  {row['family']}".rstrip() + f": {row['verdict']}")
        print(f"  printed: {row['printed']}\n  true:    {row['true']}")
        if row["measure"]:
            printed, true = _residual(row["residual_printed"]), _residual(row["residual_true"])
            print(f"  residual as printed {printed}, as true {true}: {row['measure']}")
        if row["effect"]:
            print(f"  {row['effect']}")


def _print_family(row: Mapping[str, Any]) -> None:
    """Print every field of one family."""
    for key, value in row.items():
        text = _residual(value) if key.startswith("residual") else value
        lines = text if isinstance(text, list) else textwrap.wrap(text, 100)
        print(key.replace("_", " "), *(lines or ["-"]), sep="\n    ")


def _print_catalogue(
    families: Sequence[Mapping[str, Any]], published: Sequence[Mapping[str, Any]], reference: str
) -> None:
    """Print all families and all published equations as two tables."""

    def residuals(row: Mapping[str, Any]) -> tuple[str, str]:
        return _residual(row["residual_printed"]), _residual(row["residual_true"])

    rows: list[tuple[str, ...]] = [("family", "equations", "solves for", "as printed", "as true", "motion")]
    for row in families:
        solves_for = " ".join(row["solves_for"]) or "-"
        rows.append((row["family"], row["equations"], solves_for, *residuals(row), row["motion"]))
    print(table(rows))
    rows = [("equation", "family", "as printed", "as true", "verdict")]
    rows += [(row["equation"], row["family"] or "-", *residuals(row), row["verdict"]) for row in published]
    print(f"\n{reference}:\n{table(rows)}")
    print(
        "as printed, as true: residual of the two readings at random parameters (of a family: the largest of its"
        " equations);\n--errata lists what differs, --family NAME gives conditions and formulas"
    )


def _residual(value: float | None) -> str:
    """A residual to two digits; a dash where there is nothing to measure."""
    return "-" if value is None else f"{value:.1e}"


def _add_stress(commands: Commands) -> None:
    command = _command(
        commands, "stress", _stress, "run stiff and extreme cases and compare every label with the true one"
    )
    command.add_argument("system", metavar="SYSTEM", nargs="?", help="one system (default: all)")
    _out_option(command, "FOLDER", "write SYSTEM.nc and SYSTEM.png there")
    _threads_option(command)
    _force_option(command, "existing files")


def _stress(options: argparse.Namespace) -> int:
    from . import systems

    _check_positive("--threads", options.threads)
    with_cases = [name for name, system in systems.SYSTEMS.items() if system.stress_cases()]
    names = [systems.get(options.system).name] if options.system else with_cases
    files = [f"{name}{suffix}" for name in names for suffix in (".nc", ".png")]
    folder = output_folder(options.out, files, force=options.force) if options.out else None
    from .io import netcdf
    from .plotting.stress import figure
    from .plotting.style import save
    from .validation import limits, stress

    wrong, failed = 0, False
    for name in names:
        ds = stress.stress(name, threads=options.threads)
        print(f"{name}\n{stress.report(ds)}\n")
        wrong += int(stress.mislabelled(ds).sum())
        failed |= stress.estimate_fails(ds)
        if folder is not None:
            netcdf.write(ds, folder / f"{name}.nc")
            save(figure(ds), folder / f"{name}.png")
            print(f"wrote {folder / name}.nc and .png\n")
    print(table(limits.limits()))
    print(f"labels that are not true: {wrong}")
    return FAILED if wrong or failed else DONE


def _add_figures(commands: Commands) -> None:
    command = _command(
        commands, "figures", _figures, "draw figures 1-20 of Amer et al., as printed and as true"
    )
    _out_option(command, "FOLDER", "folder of the figures (default: figures)", default="figures")
    command.add_argument("--only", type=int, nargs="+", metavar="N", help="which figures (default: all)")
    command.add_argument(
        "--format", choices=("png", "pdf", "svg"), nargs="+", default=["png", "pdf"], help="default: png pdf"
    )
    command.add_argument(
        "--table", action="store_true", help="print amplitudes, periods and the paper's claims; draw nothing"
    )
    _force_option(command, "existing figures")


def _figures(options: argparse.Namespace) -> int:
    from .plotting import amer2013
    from .plotting.style import save

    if options.table:
        rows, claims = amer2013.amplitudes_and_claims()
        print("\n\n".join([table(rows), *claims]))
        return DONE
    figures = [amer2013.paper_figure(number) for number in options.only or amer2013.NUMBERS]
    files = [f"figure_{figure.number:02d}.{kind}" for figure in figures for kind in options.format]
    folder = output_folder(options.out, files, force=options.force)
    for figure in figures:
        drawn = amer2013.draw(figure.number)
        paths = [folder / f"figure_{figure.number:02d}.{kind}" for kind in options.format]
        for path in paths:
            save(drawn, path)
        print(f"wrote {' and '.join(map(str, paths))}: {figure.caption}")
    return DONE


def _add_cache(commands: Commands) -> None:
    command = _command(commands, "cache", _cache, "list the compiled kernels")
    command.add_argument("--clear", action="store_true", help="remove them")


def _cache(options: argparse.Namespace) -> int:
    from .engine import jit

    if options.clear:
        print(f"removed {jit.clear()} kernels from {jit.cache_folder()}")
        return DONE
    kernels = jit.cached()
    print(f"{jit.cache_folder()}: {len(kernels)} kernels, {sum(size for _, size, _ in kernels) / 1e6:.1f} MB")
    for name, size, _ in kernels:
        print(f"  {name}  {size / 1e6:.1f} MB")
    return DONE


def _scene_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")


def _atlas_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc) or run folder")


def _out_option(command: argparse.ArgumentParser, metavar: str, text: str, **more: Any) -> None:
    command.add_argument("-o", "--out", metavar=metavar, help=text, **more)


def _option(
    command: argparse._ActionsContainer, name: str, metavar: str, default: float | str, text: str
) -> None:
    """An option whose default its help shows."""
    command.add_argument(
        name, type=type(default), default=default, metavar=metavar, help=f"{text} (default: {default})"
    )


def _threads_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")


def _force_option(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument("--force", action="store_true", help=f"replace {what}")


def _quiet_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="print no progress")


def output_folder(name: str, files: Sequence[str], *, force: bool) -> Path:
    """Create the folder of some files, and check each of them as `writable`."""
    folder = Path(name)
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: not a folder")
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        writable(folder / file, (Path(file).suffix,), force=force)
    return folder


def _check_positive(option: str, value: int | None) -> None:
    """Raise BadInput for a number of threads or processes below 1."""
    if value is not None and value < 1:
        raise BadInput(f"{option} {value}: must be at least 1")


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text, the first one the heading, as columns of equal width."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join(lines)
