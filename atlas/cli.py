"""The `atlas` command: reads options, calls the package, prints. It knows no physics."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from ._version import __version__
from .errors import BadInput

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The command line, complete with help; builds without importing the compiler."""
    top = _Parser(
        prog="atlas",
        description="Where in parameter space a gyrostat precesses regularly, rotates permanently or drifts.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.",
    )
    top.add_argument("--version", action="version", version=f"atlas {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, act: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        made.set_defaults(act=act)
        return made

    sub = command("run", _run, "integrate a scene and write its labelled atlas")
    sub.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    sub.add_argument(
        "-o", "--out", metavar="OUT", help="NAME.nc, or NAME/ for a run folder, which the same command"
        " continues (default: the scene's name with .nc)"
    )  # fmt: skip
    sub.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")
    sub.add_argument("--shard", metavar="I/N", help="compute the I-th of N parts of a run folder, from 1")
    where = sub.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of a dask scheduler")
    where.add_argument("--workers", type=int, metavar="N", help="compute in so many processes of one thread")
    sub.add_argument("--dry-run", action="store_true", help="print size, time, memory and error to expect")
    sub.add_argument("--force", action="store_true", help="replace an existing atlas")
    sub.add_argument("--quiet", action="store_true", help="print no progress")

    sub = command("status", _status, "tell how far a run folder is")
    sub.add_argument("folder", metavar="RUN", help="run folder")

    sub = command("join", _join, "write a finished run folder as one file")
    sub.add_argument("folder", metavar="RUN", help="run folder")
    sub.add_argument("-o", "--out", metavar="FILE", required=True, help="atlas to write (.nc)")
    sub.add_argument("--force", action="store_true", help="replace an existing file")

    sub = command("check", _check, "check a scene without running it")
    sub.add_argument("scene", metavar="SCENE", help="scene file (TOML)")

    sub = command("points", _points, "label points of a file, which names their parameters")
    sub.add_argument("system", metavar="SYSTEM", help="satellite or fixed_point")
    sub.add_argument("points", metavar="POINTS", help=".csv with names in its first line, or .nc")
    sub.add_argument("-o", "--out", metavar="FILE", required=True, help=".nc, or .csv")
    sub.add_argument("--duration", type=float, default=60.0, metavar="T", help="time units (default: 60)")
    sub.add_argument("--method", default="rk4", metavar="NAME", help="rk4 or rk8 (default: rk4)")
    size = sub.add_mutually_exclusive_group()
    size.add_argument(
        "--tolerance", type=float, default=1e-8, metavar="E", help="as in a scene (default: 1e-8)"
    )
    size.add_argument("--step", type=float, metavar="H", help="time units")
    sub.add_argument(
        "--rate-tolerance", type=float, default=1e-5, metavar="R", help="rad per time unit (default: 1e-5)"
    )
    sub.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")
    sub.add_argument("--force", action="store_true", help="replace an existing file")
    sub.add_argument("--quiet", action="store_true", help="print no progress")

    sub = command("compare", _compare, "print an atlas beside theory: confusion table, worst disagreements")
    sub.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc) or run folder")
    sub.add_argument("--worst", type=int, default=5, metavar="N", help="disagreements to name (default: 5)")

    sub = command("map", _map, "draw a map of an atlas")
    sub.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc) or run folder")
    sub.add_argument(
        "-o", "--out", metavar="FIGURE", help=".png, .pdf or .svg (default: ATLAS.png and ATLAS.pdf)"
    )
    sub.add_argument("--variable", default=None, metavar="NAME", help="what to map (default: label)")
    sub.add_argument("--x", metavar="AXIS", help="horizontal axis (default: the first)")
    sub.add_argument("--y", metavar="AXIS", help="vertical axis (default: the second)")
    sub.add_argument(
        "--select", action="append", default=[], metavar="AXIS=VALUE", help="place on another axis"
    )
    sub.add_argument("--width", choices=("column", "page"), default="column", help="journal width")
    sub.add_argument("--caption", action="store_true", help="print a caption for the figure")
    sub.add_argument("--force", action="store_true", help="replace existing figures")

    sub = command("trajectory", _trajectory, "follow one point of a scene in time")
    sub.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    sub.add_argument(
        "--at", nargs="+", default=[], metavar="AXIS=VALUE", help="place of the point, a value for every axis"
    )
    sub.add_argument(
        "-o", "--out", metavar="OUT", help=".png, .pdf, .svg or .nc (default: SCENE_trajectory.png)"
    )
    sub.add_argument(
        "--samples", type=int, default=1001, metavar="N", help="instants to keep (default: 1001)"
    )
    sub.add_argument("--force", action="store_true", help="replace an existing file")

    sub = command("accuracy", _accuracy, "show error against run time for some points of a scene")
    sub.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    sub.add_argument(
        "-o", "--out", action="append", default=[], metavar="OUT",
        help=".nc for every number, .csv for the table, .png, .pdf or .svg for the figure; may be repeated",
    )  # fmt: skip
    sub.add_argument("--points", type=int, default=64, metavar="N", help="points to try (default: 64)")
    sub.add_argument("--force", action="store_true", help="replace existing files")

    sub = command("conditions", _conditions, "print the families of steady motions and their conditions")
    sub.add_argument("system", metavar="SYSTEM", nargs="?", default="satellite", help="default: satellite")
    sub.add_argument("--family", metavar="NAME", help="one family in detail")
    sub.add_argument("--errata", action="store_true", help="the paper's equations that differ from the truth")
    form = sub.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="comma-separated values, one row for each")
    form.add_argument("--json", action="store_true", help="JSON, with every printed equation")

    sub = command("stress", _stress, "run stiff and extreme cases and hold every label against the truth")
    sub.add_argument("system", metavar="SYSTEM", nargs="?", help="one system (default: all)")
    sub.add_argument("-o", "--out", metavar="FOLDER", help="write SYSTEM.nc and SYSTEM.png there")
    sub.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")
    sub.add_argument("--force", action="store_true", help="replace existing files")

    sub = command("figures", _figures, "draw figures 1-20 of Amer et al., as printed and as true")
    sub.add_argument("-o", "--out", default="figures", metavar="FOLDER", help="where to (default: figures)")
    sub.add_argument("--only", type=int, nargs="+", metavar="N", help="which figures (default: all)")
    sub.add_argument(
        "--format", choices=("png", "pdf", "svg"), nargs="+", default=["png", "pdf"], help="default: png pdf"
    )
    sub.add_argument(
        "--table", action="store_true", help="print amplitudes, periods and the paper's claims; draw nothing"
    )
    sub.add_argument("--force", action="store_true", help="replace existing figures")

    sub = command("cache", _cache, "list the compiled kernels")
    sub.add_argument("--clear", action="store_true", help="remove them")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        options = parser().parse_args(arguments)
        return int(options.act(options))
    except BadInput as complaint:
        print(f"atlas: {complaint}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("atlas: interrupted; what is finished is kept, nothing is half written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FAILED
    except (OSError, MemoryError) as error:
        print(f"atlas: failed: {error or type(error).__name__}", file=sys.stderr)
        return FAILED


def _run(options: argparse.Namespace) -> int:
    from .scene.read import load_scene

    for name in ("threads", "workers"):
        if (number := getattr(options, name)) is not None and number < 1:
            raise BadInput(f"--{name} {number}: must be at least 1")
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
        scene, out, threads=options.threads, progress=not options.quiet, force=options.force,
        shard=shard, scheduler=options.scheduler, workers=options.workers,
    )  # fmt: skip
    if shard is None:
        print(summary(ds))
        print(f"wrote {out}")
    else:
        print(f"shard {options.shard} is done; {out} holds {ds.attrs['atlas_run']}")
    return DONE


def _shard(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    part, sign, parts = text.partition("/")
    if not (sign and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise BadInput(f"--shard {text}: must be I/N with whole numbers, 1 <= I <= N")
    return int(part), int(parts)


def _status(options: argparse.Namespace) -> int:
    from .runs.folder import RunFolder

    print(RunFolder.open(options.folder).status())
    return DONE


def _join(options: argparse.Namespace) -> int:
    from .io import netcdf
    from .runs.folder import RunFolder

    folder = RunFolder.open(options.folder)
    folder.join(netcdf.writable(options.out, force=options.force))
    print(f"wrote {options.out}")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from .scene import grid
    from .scene.read import load_scene

    scene = load_scene(options.scene)
    checked = grid.check(scene)
    shape = " x ".join(f"{name} {count}" for name, count in zip(scene.axes, scene.shape, strict=True))
    print(
        f"{scene.title}\nsystem {scene.system.name}: {shape} = {scene.size} points, duration {scene.duration}"
    )
    if not checked.there.all():
        print(f"the family {scene.family} exists at {100 * checked.there.mean():.1f} % of them")
    for remark in scene.system.warnings(checked.base):
        print(f"warning: {remark}")
    return DONE


def _points(options: argparse.Namespace) -> int:
    from . import files, systems
    from .io import netcdf
    from .scene import tables

    out = Path(options.out)
    if options.threads is not None and options.threads < 1:
        raise BadInput(f"--threads {options.threads}: must be at least 1")
    if out.suffix not in tables.FORMATS:
        raise BadInput(f"{out}: the name must end in {' or '.join(tables.FORMATS)}")
    files.check_folder(out)
    if out.exists() and not options.force:
        raise BadInput(f"{out}: this file exists; --force replaces it")
    system = systems.get(options.system)
    columns = tables.read(options.points, system.parameters)
    from .analysis.summary import summary
    from .label.points import label_points

    ds = label_points(
        system.name, columns, duration=options.duration, step=options.step, tolerance=options.tolerance,
        method=options.method, rate_tolerance=options.rate_tolerance, threads=options.threads,
        progress=not options.quiet,
    )  # fmt: skip
    (tables.write_csv if out.suffix == ".csv" else netcdf.write)(ds, out)
    print(summary(ds))
    print(f"wrote {out}")
    return DONE


def _compare(options: argparse.Namespace) -> int:
    from .analysis.compare import report
    from .runs.open import open_atlas

    with open_atlas(options.atlas) as ds:
        for name in ("label", "predicted"):
            if name not in ds:
                raise BadInput(
                    f"{options.atlas}: has no variable {name!r}; put it into [outputs] variables of its scene"
                )
        print(report(ds, worst=options.worst))
    return DONE


def _map(options: argparse.Namespace) -> int:
    from .plotting import maps, style
    from .runs.open import open_atlas

    stem = Path(options.atlas).with_suffix("")
    amer2013 = [Path(options.out)] if options.out else [stem.with_suffix(".png"), stem.with_suffix(".pdf")]
    for figure in amer2013:
        if figure.exists() and not options.force:
            raise BadInput(f"{figure}: this file exists; --force replaces it")
    select = _places("--select", options.select)
    with open_atlas(options.atlas) as ds:
        drawn = maps.atlas_map(
            ds, options.variable, x=options.x, y=options.y, select=select or None, width=options.width
        )
        if options.caption:
            print(maps.caption(ds))
    for figure in amer2013:
        style.save(drawn, figure)
        print(f"wrote {figure}")
    return DONE


def _places(option: str, texts: Sequence[str]) -> dict[str, float]:
    """AXIS=VALUE options as numbers by axis."""
    places = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            places[name] = float(value)
        except ValueError:
            raise BadInput(f"{option} {text}: must be AXIS=VALUE with a number") from None
    return places


def _trajectory(options: argparse.Namespace) -> int:
    from . import files
    from .io import netcdf
    from .scene.read import load_scene

    scene = load_scene(options.scene)
    out = Path(options.out or Path(options.scene).stem + "_trajectory.png")
    if out.suffix not in (".nc", ".png", ".pdf", ".svg"):
        raise BadInput(f"{out}: the name must end in .nc, .png, .pdf or .svg")
    files.check_folder(out)
    if out.exists() and not options.force:
        raise BadInput(f"{out}: this file exists; --force replaces it")
    from .label.trajectory import trajectory_of_scene

    tr = trajectory_of_scene(scene, _places("--at", options.at), samples=options.samples)
    if out.suffix == ".nc":
        netcdf.write(tr, out)
    else:
        from .plotting import style, trajectory

        style.save(trajectory.trajectory_figure(tr), out)
    low, high = float(tr["theta"].min()), float(tr["theta"].max())
    print(f"theta from {low:.9g} to {high:.9g} rad in {float(tr['time'][-1]):.9g} time units; wrote {out}")
    return DONE


def _accuracy(options: argparse.Namespace) -> int:
    from . import files
    from .io import netcdf
    from .plotting.work_precision import figure
    from .scene.read import load_scene
    from .validation import work_precision

    outs = [Path(out) for out in options.out]
    for out in outs:
        if out.suffix not in (".nc", ".csv", ".png", ".pdf", ".svg"):
            raise BadInput(f"{out}: the name must end in .nc, .csv, .png, .pdf or .svg")
        files.check_folder(out)
        if out.exists() and not options.force:
            raise BadInput(f"{out}: this file exists; --force replaces it")
    ds = work_precision.work_precision(load_scene(options.scene), options.points, progress=True)
    print(work_precision.report(ds))
    for out in outs:
        if out.suffix == ".nc":
            netcdf.write(ds, out)
        elif out.suffix == ".csv":
            out.write_text(work_precision.table(ds))
        else:
            from .plotting import style

            style.save(figure(ds), out)
        print(f"wrote {out}")
    return DONE


def _conditions(options: argparse.Namespace) -> int:
    from . import systems
    from .analysis import catalogue

    system = systems.get(options.system)
    families = catalogue.families(system, options.family)
    if options.json:
        found: dict[str, object] = {"system": system.name, "reference": system.reference, "doi": system.doi}
        found |= {} if options.errata else {"families": families}
        found["printed"] = catalogue.published(system, options.family, options.errata)
        print(json.dumps(found, indent=1, ensure_ascii=False))
        return DONE
    rows = catalogue.published(system, options.family, errata=True) if options.errata else families
    if options.csv:
        writer = csv.DictWriter(sys.stdout, rows[0] if rows else ["equation"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: "; ".join(value) if isinstance(value, list) else value for key, value in row.items()}
            for row in rows
        )
        return DONE
    if options.errata:
        for row in rows:
            print(f"{row['equation']}  {row['family']}".rstrip() + f": {row['verdict']}")
            print(f"  printed: {row['printed']}\n  true:    {row['true']}")
            if row["measure"]:
                print(f"  residual as printed {_residual(row['residual_printed'])}, as true {_residual(row['residual_true'])}:"
                      f" {row['measure']}")  # fmt: skip
            if row["effect"]:
                print(f"  {row['effect']}")
        print(f"{len(rows)} equations differ; {system.reference}")
        return DONE
    if options.family is not None:
        for key, value in rows[0].items():
            text = _residual(value) if key.startswith("residual") else value
            lines = text if isinstance(text, list) else textwrap.wrap(text, 100)
            print(key.replace("_", " "), *(lines or ["-"]), sep="\n    ")
        return DONE
    columns = [("family", "equations", "solves for", "as printed", "as true", "motion")]
    columns += [
        (
            row["family"], row["equations"], " ".join(row["solves_for"]) or "-",
            _residual(row["residual_printed"]), _residual(row["residual_true"]), row["motion"],
        )
        for row in rows
    ]  # fmt: skip
    print(table(columns))
    equations = [("equation", "family", "as printed", "as true", "verdict")]
    equations += [
        (
            row["equation"], row["family"] or "-",
            _residual(row["residual_printed"]), _residual(row["residual_true"]), row["verdict"],
        )
        for row in catalogue.published(system)
    ]  # fmt: skip
    print(f"\n{system.reference}:\n{table(equations)}")
    print(
        "as printed, as true: residual of the two readings at random parameters (of a family: the largest of its"
        " equations);\n--errata says what differs, --family NAME gives conditions and formulas"
    )
    return DONE


def _residual(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def _stress(options: argparse.Namespace) -> int:
    from . import systems
    from .io import netcdf
    from .plotting.stress import figure
    from .plotting.style import save
    from .validation import limits, stress, stress_cases

    if options.threads is not None and options.threads < 1:
        raise BadInput(f"--threads {options.threads}: must be at least 1")
    names = [systems.get(options.system).name] if options.system else list(stress_cases.STRESS_CASES)
    folder = Path(options.out) if options.out else None
    if folder is not None:
        for path in (folder / f"{name}{suffix}" for name in names for suffix in (".nc", ".png")):
            if path.exists() and not options.force:
                raise BadInput(f"{path}: this file exists; --force replaces it")
        if folder.exists() and not folder.is_dir():
            raise BadInput(f"{folder}: not a folder")
        folder.mkdir(parents=True, exist_ok=True)
    wrong = 0
    for name in names:
        ds = stress.stress(name, threads=options.threads)
        print(f"{name}\n{stress.report(ds)}\n")
        wrong += int(stress.mislabelled(ds).sum())
        if folder is not None:
            netcdf.write(ds, folder / f"{name}.nc")
            save(figure(ds), folder / f"{name}.png")
            print(f"wrote {folder / name}.nc and .png\n")
    print(table(limits.limits()))
    print(f"labels that are not true: {wrong}")
    return FAILED if wrong else DONE


def _figures(options: argparse.Namespace) -> int:
    from .plotting import amer2013
    from .plotting.style import save
    from .systems.fixed_point.paper import fast_spin

    if options.table:
        rows = fast_spin.figure_table()
        print(table(amer2013.amplitude_table(rows)))
        for claim in fast_spin.claims(rows):
            print(f"\n{'holds' if claim.holds else 'does not hold'}: {claim.text}\n  {claim.measured}")
        return DONE
    wanted = [amer2013.paper_figure(number) for number in options.only or amer2013.NUMBERS]
    folder = Path(options.out)
    paths = [[folder / f"figure_{figure.number:02d}.{kind}" for kind in options.format] for figure in wanted]
    for path in (path for row in paths for path in row):
        if path.exists() and not options.force:
            raise BadInput(f"{path}: this file exists; --force replaces it")
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: not a folder")
    folder.mkdir(parents=True, exist_ok=True)
    for figure, row in zip(wanted, paths, strict=True):
        drawn = amer2013.draw(figure.number)
        for path in row:
            save(drawn, path)
        print(f"wrote {' and '.join(str(path) for path in row)}: {figure.caption}")
    return DONE


def _cache(options: argparse.Namespace) -> int:
    from .engine import jit

    if options.clear:
        print(f"removed {jit.clear()} kernels from {jit.cache_folder()}")
        return DONE
    found = jit.cached()
    print(f"{jit.cache_folder()}: {len(found)} kernels, {sum(size for _, size, _ in found) / 1e6:.1f} MB")
    for name, size, _ in found:
        print(f"  {name}  {size / 1e6:.1f} MB")
    return DONE


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text, the first one the heading, as columns of equal width."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join(lines)
