"""The `atlas` command: reads options, calls the package, prints. It knows no physics."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from . import __version__
from .systems.system import BadInput

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
        "-o", "--out", metavar="OUT.nc", help="atlas to write (default: the scene's name with .nc)"
    )
    sub.add_argument("--threads", type=int, metavar="N", help="processors to use (default: all)")
    sub.add_argument("--force", action="store_true", help="replace an existing atlas")
    sub.add_argument("--quiet", action="store_true", help="print no progress")

    sub = command("check", _check, "check a scene without running it")
    sub.add_argument("scene", metavar="SCENE", help="scene file (TOML)")

    sub = command("compare", _compare, "print an atlas beside theory: confusion table, worst disagreements")
    sub.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc)")
    sub.add_argument("--worst", type=int, default=5, metavar="N", help="disagreements to name (default: 5)")

    sub = command("map", _map, "draw a map of an atlas")
    sub.add_argument("atlas", metavar="ATLAS", help="atlas file (.nc)")
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

    sub = command("conditions", _conditions, "print the families of steady motions and their conditions")
    sub.add_argument("system", metavar="SYSTEM", nargs="?", default="satellite", help="default: satellite")
    sub.add_argument("--family", metavar="NAME", help="one family in detail")

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
        print("atlas: interrupted; nothing was left half written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FAILED
    except (OSError, MemoryError) as error:
        print(f"atlas: failed: {error or type(error).__name__}", file=sys.stderr)
        return FAILED


def _run(options: argparse.Namespace) -> int:
    from .scene import load_scene

    if options.threads is not None and options.threads < 1:
        raise BadInput(f"--threads {options.threads}: must be at least 1")
    scene = load_scene(options.scene)
    out = Path(options.out) if options.out else Path(Path(options.scene).stem + ".nc")
    from .runner import run, summary

    ds = run(scene, out, threads=options.threads, progress=not options.quiet, force=options.force)
    print(summary(ds))
    print(f"wrote {out}")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from . import grid
    from .scene import load_scene

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


def _compare(options: argparse.Namespace) -> int:
    from .compare import report
    from .store import open_atlas

    with open_atlas(options.atlas) as ds:
        for name in ("label", "predicted"):
            if name not in ds:
                raise BadInput(
                    f"{options.atlas}: has no variable {name!r}; put it into [outputs] variables of its scene"
                )
        print(report(ds, worst=options.worst))
    return DONE


def _map(options: argparse.Namespace) -> int:
    from . import maps
    from .store import open_atlas

    stem = Path(options.atlas).with_suffix("")
    figures = [Path(options.out)] if options.out else [stem.with_suffix(".png"), stem.with_suffix(".pdf")]
    for figure in figures:
        if figure.exists() and not options.force:
            raise BadInput(f"{figure}: this file exists; --force replaces it")
    select = {}
    for text in options.select:
        name, sign, value = text.partition("=")
        try:
            select[name] = float(value)
        except ValueError:
            raise BadInput(f"--select {text}: must be AXIS=VALUE with a number") from None
    with open_atlas(options.atlas) as ds:
        drawn = maps.atlas_map(
            ds, options.variable, x=options.x, y=options.y, select=select or None, width=options.width
        )
        if options.caption:
            print(maps.caption(ds))
    for figure in figures:
        maps.save(drawn, figure)
        print(f"wrote {figure}")
    return DONE


def _conditions(options: argparse.Namespace) -> int:
    from . import systems

    system = systems.get(options.system)
    if options.family is not None:
        if options.family not in system.families:
            raise BadInput(f"--family {options.family}: unknown; allowed: {', '.join(system.families)}")
        family = system.families[options.family]
        print(f"{family.name} ({family.equations}): {family.title}")
        print(
            f"geometry: {family.geometry}"
            + (f"; in the paper: {family.paper_wording}" if family.paper_wording else "")
        )
        print("conditions:")
        for condition in family.conditions:
            print(f"  {condition.text}")
        print(f"can be solved for: {', '.join(family.solve) or 'nothing'}")
        return DONE
    rows = [("family", "equations", "geometry", "solves for", "motion")]
    rows += [
        (f.name, f.equations, f.geometry, " ".join(f.solve) or "-", f.title) for f in system.families.values()
    ]
    print(table(rows))
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
