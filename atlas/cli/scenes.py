"""The commands run, extend, status, join, check, cache, schema and new."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import shutil
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

import atlas

from .. import extension, systems
from ..errors import MAX_MESSAGE, MAX_TEXT, BadInput, allowed_text, attribute_text, printable, say, text_table
from ..files import atomic_write, cache_folder, check_not_input, either, writable
from ..interruption import called_as, signals_as_stop
from ..kernel.compiling import Stopwatch
from ..scene.examples import examples
from ..store.finished import FILE, FORMATS, STORE, format_of, suffixes
from ..systems.base import families_of
from .options import (
    QUIET,
    RUN_FOLDER,
    SCENE,
    THREADS,
    VERBOSE,
    argument,
    command,
    default_name,
    input_files,
    out_options,
    read_scene,
)


def out_text() -> str:
    """Return the help text for the output of a run."""
    text = f"NAME{FILE}; or NAME/ for a run folder or NAME{STORE} for a store (also s3://...), which the same command continues"
    others = [
        f"; or NAME{suffix} {atlases}" for suffix, atlases in suffixes().items() if suffix not in FORMATS
    ]
    return "".join([text, *others])


EXECUTION = (
    THREADS,
    argument("--shard", metavar="I/N", help="compute part I of N of a run folder, counted from 1"),
    [
        argument("--scheduler", metavar="ADDRESS", help="compute on the workers of this dask scheduler"),
        argument(
            "--workers", type=int, metavar="N", lowest=1, help="compute in N processes of one thread each"
        ),
    ],
    argument("--stop-after", metavar="TIME", help="begin no tile after this time, such as 2h or 1h30m"),
    QUIET,
    VERBOSE,
)
SECONDS = {"d": 86400, "h": 3600, "m": 60, "s": 1}


@command(
    "run",
    SCENE,
    *out_options(
        "OUT", lambda: f"{out_text()} (default: the scene's name with {FILE})", replaces="an existing atlas"
    ),
    argument("--dry-run", action="store_true", help="print the expected size, time, memory and error"),
    argument(
        "--jobs",
        metavar="JxP",
        help="with --dry-run: also time, memory and SLURM lines of each of J jobs of P processors",
    ),
    *EXECUTION,
)
def run_scene(options: argparse.Namespace) -> None:
    """Integrate a scene and write its labelled atlas."""
    jobs = None
    if options.jobs is not None:
        match = re.fullmatch("([1-9][0-9]{0,5})x([1-9][0-9]{0,3})", options.jobs)
        if match is None or not options.dry_run:
            raise BadInput(
                f"--jobs {options.jobs}: must be JxP, J jobs of P processors such as 200x16, with --dry-run"
            )
        jobs = int(match[1]), int(match[2])
    if options.dry_run:
        from ..runs.estimate import dry_run

        out, cost = options.out or "", {"threads": options.threads, "workers": options.workers}
        say(*dry_run(read_scene(options.scene), out, jobs=jobs, **cost).split("\n"))
    else:
        _run(options, options.out or default_name(options.scene) + FILE, ())


@command(
    "extend",
    argument("atlases", metavar="ATLAS", nargs="+", help="earlier atlases, also unfinished run folders"),
    SCENE,
    *out_options("OUT", out_text, replaces="an existing atlas", required=True),
    *EXECUTION,
)
def extend_atlases(options: argparse.Namespace) -> None:
    """Run a scene, and copy the points that earlier atlases have already."""
    for each in options.atlases:
        check_not_input(Path(options.out), [each])
    _run(options, options.out, options.atlases)


@signals_as_stop()
def _run(options: argparse.Namespace, out: str, reuse: Sequence[str]) -> None:
    """Run the scene that the options name, and write its atlas."""
    shard = None
    if options.shard is not None:
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", options.shard)
        number, count = map(int, match.groups()) if match else (0, 0)
        if not 1 <= number <= count:
            raise BadInput(f"--shard {options.shard}: must be I/N with whole numbers, 1 <= I <= N < 10^9")
        shard = number, count
    stop_after = None
    if options.stop_after is not None:
        if not re.fullmatch("([0-9]{1,9}[dhms])+", options.stop_after):
            raise BadInput(
                f"--stop-after {options.stop_after}: must be a time such as 90s, 30m, 2h, 1h30m or 1d"
            )
        parts = re.findall("([0-9]+)([dhms])", options.stop_after)
        stop_after = float(sum(int(number) * SECONDS[unit] for number, unit in parts))
    scene = read_scene(options.scene)
    check_not_input(Path(out), input_files(options.scene))
    from ..analysis.summary import summary
    from ..runs.run import TALLY
    from ..store.dataset import HISTORY

    arguments = {name: getattr(options, name) for name in ("threads", "force", "scheduler", "workers")}
    ds = atlas.run(
        scene, out, progress=not options.quiet, shard=shard, stop_after=stop_after, reuse=reuse, **arguments
    )
    if HISTORY in ds.attrs:
        say(*(printable(line, MAX_MESSAGE) for line in str(ds.attrs[HISTORY]).split("\n")))
    if shard is None:
        say(*summary(ds, ds.encoding.get(TALLY), verbose=options.verbose).split("\n"), f"wrote {out}")
    else:
        say(
            f"shard {options.shard} is done; {out} holds {attribute_text(ds.attrs, 'atlas_run', limit=MAX_MESSAGE)}"
        )


@command(
    "status",
    RUN_FOLDER,
    argument(
        "--verify",
        action="store_true",
        help=lambda: f"read all of it, also of a finished atlas ({', '.join(suffixes())})",
    ),
)
def print_status(options: argparse.Namespace) -> None:
    """Print the progress of a run folder, or verify an atlas."""
    from ..runs.status import status

    say(*status(options.folder, verify=options.verify).split("\n"))


@command(
    "join", RUN_FOLDER, *out_options("FILE", lambda: f"atlas to write ({either(suffixes())})", required=True)
)
def join_folder(options: argparse.Namespace) -> None:
    """Write a finished run folder as one file."""
    from ..runs.run import RunFolder
    from ..store.place import ADDRESS, located

    folder = RunFolder.open(options.folder)
    out = located(options.out) if ADDRESS.match(options.out) else Path(options.out)
    folder.join(format_of(out).writable(out, force=options.force, inputs=[f"{folder.place}/tiles"]))
    say(f"wrote {options.out}")


@command("check", SCENE)
def check_scene(options: argparse.Namespace) -> None:
    """Check a scene without running it."""
    from ..runs.plan import ScenePlan
    from ..scene import grid
    from ..systems.steady import polynomial_degree

    scene = read_scene(options.scene)
    plan = ScenePlan.of(scene)
    shape = " x ".join(f"{name} {count}" for name, count in zip(scene.axes, scene.shape, strict=True))
    say(
        printable(scene.title, MAX_TEXT),
        f"system {scene.system.name}: {shape} = {scene.size} points, duration {scene.duration}"
        + f" after a transient of {scene.transient}" * bool(scene.transient.amount),
        *([f"frame: {printable(scene.system.frame_text, MAX_MESSAGE)}"] if scene.system.frame_text else []),
        *grid.settings_lines(scene, plan.sample),
        *plan.method_lines(),
        *plan.statistics_lines(),
        *plan.proof_lines(),
    )
    reason = polynomial_degree(scene.system)
    if isinstance(reason, str) and not scene.system.observables:
        starts = "starts on no family" if families_of(scene.system) else "any start"
        say(f"predicted: not of {starts}: {printable(reason, MAX_MESSAGE)}")
    for warning in [*grid.warnings(scene, plan.sample), *plan.step_warnings(), *plan.chaos_warnings()]:
        say(f"warning: {printable(warning, MAX_MESSAGE)}")


@command(
    "cache",
    argument("--clear", action="store_true", help="remove them, and the lines of theory of earlier maps"),
    argument(
        "--warm", nargs="*", metavar="SCENE", help="compile those of these scenes (default: of every example)"
    ),
)
def list_kernels(options: argparse.Namespace) -> None:
    """List the compiled kernels."""
    from ..kernel import machine_code

    if options.warm is not None:
        import numpy as np

        from ..label.pipeline import evaluate
        from ..label.plan import Plan
        from ..scene import grid

        scenes = {name: read_scene(name) for name in options.warm}
        if not scenes:
            for name in examples():
                table = atlas.example(name)
                missing = [each for each in table.get("extensions", []) if each not in extension.extensions()]
                if missing:
                    say(
                        f"{name}: skipped: the extension {', '.join(missing)} is not installed{extension.not_loaded()}"
                    )
                else:
                    scenes[name] = atlas.load_scene(table)
        for name, scene in scenes.items():
            sample, watch, began = grid.check(scene), Stopwatch(), time.perf_counter()
            evaluate(Plan.of(scene), sample.subset(np.flatnonzero(sample.exists)[:1]))
            seconds = time.perf_counter() - began - watch.seconds()
            say(f"{name}: " + (f"compiled in {seconds:.1f} s" if seconds > 0.01 else "nothing to compile"))
    if options.clear:
        from ..analysis.tracer import LINES_FOLDER

        shutil.rmtree(cache_folder() / LINES_FOLDER, ignore_errors=True)
        say(f"removed {machine_code.clear()} kernels from {cache_folder()}")
        return
    files = machine_code.cached()
    kernels = {name: size for name, size in files.items() if machine_code.is_kernel(name)}
    say(
        f"{cache_folder()}: {len(kernels)} kernels, {len(files) - len(kernels)} functions that they share,"
        f" {sum(files.values()) / 1e6:.1f} MB"
    )
    for name, size in kernels.items():
        say(f"  {name}  {size / 1e6:.1f} MB")


@command("schema", *out_options("FILE", "write it to this file (.json)"))
def print_schema(options: argparse.Namespace) -> None:
    """Print the JSON Schema of scenes, with which editors complete and check them."""
    from ..scene.schema import scene_schema

    text = json.dumps(scene_schema(), indent=2)
    if options.out is None:
        say(*text.split("\n"))
    else:
        path: Path = writable(options.out, (".json",), force=options.force)
        path.write_text(text + "\n", encoding="utf-8")
        say(f"wrote {path}")


@command(
    "new",
    argument("name", metavar="NAME", nargs="?", help="which example (default: list them)"),
    argument("--list", action="store_true", help="list the examples"),
    argument("-o", "--out", metavar="SCENE", help="name of the copy (default: NAME.toml)"),
)
def copy_example(options: argparse.Namespace) -> None:
    """Copy an example scene, to run it or to change it."""
    scenes = examples()
    if options.name is None or options.list:
        rows = [("example", "what it shows", "words of the paper")]
        for name, scene in scenes.items():
            table = tomllib.loads(scene.read_text("utf-8"))
            family = families_of(systems.get(table["system"])).get(table.get("family", {}).get("name"))
            rows.append((name, table["title"], "" if family is None else family.paper_wording))
        say(*text_table(rows).split("\n"))
        say(f"{called_as()} new NAME copies one of them")
        return
    name = options.name.removesuffix(".toml")
    if name not in scenes:
        raise BadInput(f"{options.name}: no such example; {allowed_text(name, scenes)}")
    out = writable(options.out or f"{name}.toml", (".toml",), force=True)
    if out.exists():
        raise BadInput(f"{out}: this file exists; -o gives the copy another name")
    with atomic_write(out) as temporary:
        temporary.write_bytes(scenes[name].read_bytes())
    figure = figure_options(scenes[name].read_text("utf-8"))
    result, command = shlex.quote(f"{default_name(str(out))}{FILE}"), called_as()
    say(f"wrote {out}; next: {command} run {shlex.quote(str(out))}, then {command} map {result}{figure}")


def figure_options(scene: str) -> str:
    """Return the options of `atlas map` in an example's comment "Figure: --option". The text begins with a blank, or is empty."""
    match = re.search(r"^# Figure:((?: --[\w-]+)+)", scene, re.MULTILINE)
    return match[1] if match else ""
