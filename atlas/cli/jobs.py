"""Commands that run scenes: check, run, status, join, cache."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from ..errors import MAX_MESSAGE, MAX_TEXT, BadInput, attribute_text, printable, say
from ..files import check_not_input
from .options import (
    DONE,
    Commands,
    add_command,
    check_at_least,
    default_name,
    force_option,
    input_files,
    out_option,
    quiet_option,
    read_scene,
    scene_option,
    threads_option,
)


def add_run(commands: Commands) -> None:
    """Add the command `run`."""
    command = add_command(commands, "run", _run, "integrate a scene and write its labelled atlas")
    scene_option(command)
    out_option(
        command,
        "OUT",
        "NAME.nc, or NAME/ for a run folder, which the same command continues (default: the scene's name with .nc)",
    )
    threads_option(command)
    command.add_argument("--shard", metavar="I/N", help="compute part I of N of a run folder, counted from 1")
    where = command.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of this dask scheduler")
    where.add_argument("--workers", type=int, metavar="N", help="compute in N processes of one thread each")
    command.add_argument(
        "--dry-run", action="store_true", help="print the expected size, time, memory and error"
    )
    force_option(command, "an existing atlas")
    quiet_option(command)


def _run(options: argparse.Namespace) -> int:
    """Run the command `run`; returns its exit code."""
    check_at_least("--threads", options.threads, 1)
    check_at_least("--workers", options.workers, 1)
    shard = _shard(options.shard)
    scene = read_scene(options.scene)
    out = options.out or default_name(options.scene) + ".nc"
    check_not_input(Path(out), input_files(options.scene))
    from ..analysis.summary import summary
    from ..runs.estimate import dry_run
    from ..runs.folder import TALLY
    from ..runs.runner import run

    if options.dry_run:
        say(*dry_run(scene, threads=options.threads, workers=options.workers).split("\n"))
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
        say(*summary(ds, ds.encoding.get(TALLY)).split("\n"), f"wrote {out}")
    else:
        say(
            f"shard {options.shard} is done; {out} holds {attribute_text(ds.attrs, 'atlas_run', limit=MAX_MESSAGE)}"
        )
    return DONE


def _shard(text: str | None) -> tuple[int, int] | None:
    """Number of the shard, from 1, and how many there are."""
    if text is None:
        return None
    match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
    shard, count = map(int, match.groups()) if match else (0, 0)
    if not 1 <= shard <= count:
        raise BadInput(f"--shard {text}: must be I/N with whole numbers, 1 <= I <= N < 10^9")
    return shard, count


def add_status(commands: Commands) -> None:
    """Add the command `status`."""
    command = add_command(commands, "status", _status, "print the progress of a run folder")
    command.add_argument("folder", metavar="RUN", help="run folder")


def _status(options: argparse.Namespace) -> int:
    """Run the command `status`; returns its exit code."""
    from ..runs.folder import RunFolder

    say(*RunFolder.open(options.folder).status().split("\n"))
    return DONE


def add_join(commands: Commands) -> None:
    """Add the command `join`."""
    command = add_command(commands, "join", _join, "write a finished run folder as one file")
    command.add_argument("folder", metavar="RUN", help="run folder")
    out_option(command, "FILE", "atlas to write (.nc or .zarr)", required=True)
    force_option(command, "an existing file")


def _join(options: argparse.Namespace) -> int:
    """Run the command `join`; returns its exit code."""
    from ..io import netcdf
    from ..runs.folder import RunFolder

    folder = RunFolder.open(options.folder)
    folder.join(
        netcdf.writable(options.out, (".nc", ".zarr"), force=options.force, inputs=[folder.tiles.folder])
    )
    say(f"wrote {options.out}")
    return DONE


def add_check(commands: Commands) -> None:
    """Add the command `check`."""
    scene_option(add_command(commands, "check", _check, "check a scene without running it"))


def _check(options: argparse.Namespace) -> int:
    """Run the command `check`; returns its exit code."""
    from ..runs.plan import ScenePlan
    from ..scene import grid

    scene = read_scene(options.scene)
    plan = ScenePlan.of(scene)
    shape = " x ".join(f"{name} {count}" for name, count in zip(scene.axes, scene.shape, strict=True))
    say(
        printable(scene.title, MAX_TEXT),
        f"system {scene.system.name}: {shape} = {scene.size} points, duration {scene.duration}",
        *plan.method_lines(),
    )
    for warning in [
        *grid.warnings(scene, plan.sample),
        *plan.step_warnings(),
        *plan.chaos_warnings(),
    ]:
        say(f"warning: {printable(warning, MAX_MESSAGE)}")
    return DONE


def add_cache(commands: Commands) -> None:
    """Add the command `cache`."""
    command = add_command(commands, "cache", _cache, "list the compiled kernels")
    command.add_argument("--clear", action="store_true", help="remove them")


def _cache(options: argparse.Namespace) -> int:
    """Run the command `cache`; returns its exit code."""
    from ..engine import jit

    if options.clear:
        say(f"removed {jit.clear()} kernels from {jit.cache_folder()}")
        return DONE
    files = jit.cached()
    kernels = [(name, size) for name, size, _ in files if jit.is_kernel(name)]
    say(
        f"{jit.cache_folder()}: {len(kernels)} kernels, {len(files) - len(kernels)} functions that they share,"
        f" {sum(size for _, size, _ in files) / 1e6:.1f} MB"
    )
    for name, size in kernels:
        say(f"  {name}  {size / 1e6:.1f} MB")
    return DONE
