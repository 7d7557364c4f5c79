"""The dry run, which estimates time, memory and disk space of a scene by measuring one tile."""

from __future__ import annotations

import math
import os
import resource
import shutil
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..kernel import blocks
from ..kernel.blocks import Threads
from ..label.pipeline import evaluate
from ..label.theory import predict_runs
from ..scene import grid
from ..scene.model import Scene
from ..store import finished
from ..store.progress import clock
from ..store.tile import encode
from ..store.tiling import bytes_per_point, surely_fits, tile_types
from ..systems.base import derived_values, derived_variables
from .plan import LONG, ScenePlan
from .refine import expected_points

# Number of steps, summed over points, that each thread computes in the measurement. They take about half a second.
CALIBRATION_STEPS = 1e8
# The time saved by early ends of runs is measured on at least LEAST_POINTS points, in about LABEL_STEPS steps (at most 0.2 s).
LABEL_STEPS, LEAST_POINTS = 2e7, 16
HEADER_BYTES = 1000  # size of the header of a tile
# Size of a run folder without tiles, and size of the attributes and format tables of a variable in a file, without the values.
FOLDER_BYTES, VARIABLE_BYTES = 6000, 2300
START_MINUTES = 5  # time of imports and compilation at the start of a job


@dataclass(frozen=True)
class _Measurement:
    """Measured cost of a tile, or of shortened runs if the tile takes long."""

    seconds_per_step: float  # wall-clock time of a step of one point if all threads work
    theory_seconds: float  # wall-clock time of the predictions of one point
    compile_seconds: float
    memory: float  # peak memory of the process, bytes
    bytes_per_tile: float  # memory of a tile during the computation, bytes
    stored_bytes_per_point: float  # size of measured variables and parameters after compression


@dataclass(frozen=True)
class _Cost:
    """Expected cost of a scene."""

    points: float  # number of points to integrate
    proved: float  # number of proved points, which are not integrated
    tile: _Measurement
    seconds: float
    theory_seconds: float  # time of theory, which `seconds` includes


def _cost(plan: ScenePlan, processors: int) -> _Cost:
    """Measure time and memory of one tile on this number of processors, and return the expected cost of the scene."""
    scene, exists = plan.scene, plan.sample.exists
    existing = scene.size * exists.mean()
    points = existing if scene.refine is None else expected_points(plan)
    tile = _measure(plan, processors)
    # The time of derived variables is a mean over points. More points are taken until the measurement takes 0.2 s.
    has_derived = not derived_variables(scene.system).keys().isdisjoint(scene.outputs)
    existing_points, derived_seconds, count = np.flatnonzero(exists), 0.0, 0
    while has_derived and derived_seconds < 0.2 and count < existing_points.size:
        count = min(max(4 * count, 6), existing_points.size)
        places = np.linspace(0, existing_points.size - 1, count).astype(np.int64)
        part = plan.sample.subset(existing_points[places])
        started = time.perf_counter()
        derived_values(scene.system, scene.outputs, part.base, part.duration, lambda: None)
        derived_seconds = time.perf_counter() - started
    derived_seconds /= max(count, 1)
    # A refined atlas has predictions at every point.
    theory_seconds = existing * tile.theory_seconds + points * derived_seconds
    proved = 0.0
    if scene.settings.prove:
        from ..label.proved import proved_points

        proved = points * float(proved_points(plan.runs, plan.sample.subset(exists))[0].mean())
    work = plan.mean_work + plan.growth_work
    seconds = (points - proved) * work * tile.seconds_per_step + theory_seconds
    return _Cost(points - proved, proved, tile, seconds, theory_seconds)


def long_run(plan: ScenePlan, processors: int, share: float, unit: str) -> str:
    """Return a sentence about the expected time of a fraction of a scene, or an empty text if the time is below LONG."""
    seconds = share * _cost(plan, processors).seconds
    if seconds < LONG:
        return ""
    return (
        f"this run takes about {seconds / 3600:.3g} h on {processors} {unit} for {share * plan.scene.size:.3g} points;"
        " atlas run SCENE --dry-run shows size, memory and error"
    )


def dry_run(
    scene: Scene,
    out: str = "",
    *,
    threads: int | None = None,
    workers: int | None = None,
    jobs: tuple[int, int] | None = None,
) -> str:
    """Return a text about the expected cost of a scene. If `jobs` is (jobs, processors of a job), add the cost of a job."""
    plan = ScenePlan.of(scene)
    tiles, exists = plan.tiling, plan.sample.exists
    processors = workers or threads or blocks.available_threads()
    expected = _cost(plan, processors)
    points, cost, seconds = expected.points, expected.tile, expected.seconds
    hours = {scene.settings.method: seconds * processors / 3600}
    hours |= {name: ratio * hours[scene.settings.method] for name, ratio in plan.relative_costs.items()}
    memory = (workers or 1) * _memory(plan, cost, 1 if workers else processors)
    statistics = _statistics_lines(plan, threads)
    phase_error = plan.step_sizes.dispersion_error[exists].max()
    division, contents = "near the borders that theory predicts", ""
    if scene.refine is None:
        division = f"{tiles.count} tiles of at most {math.prod(tiles.tile)}"
        contents = f"{tiles.count + 3} files, "
    names = {*tile_types(scene), *scene.system.parameters, *scene.axes}
    stored = VARIABLE_BYTES * len(names) + _stored_bytes(plan, cost, points + expected.proved)
    is_joined = "://" not in out and not out.endswith("/") and Path(out).suffix in finished.suffixes()
    folder = _folder_bytes(plan, cost, points + expected.proved, scene.size, is_joined=is_joined)
    lines = [
        f"{scene.size} points, about {points:.0f} to integrate, {division}",
        *[f"about {expected.proved:.0f} points are proved and not integrated"] * scene.settings.prove,
        *grid.not_computed(scene, plan.sample),
        f"{'store' if finished.is_store(out) else 'file'}: about {stored / 1e6:.3g} MB; run folder: {contents}about"
        f" {(folder + FOLDER_BYTES) / 1e6:.3g} MB",
        "processor time: " + ", ".join(f"{each:.3g} h by {name}" for name, each in hours.items()),
        f"time: about {clock(seconds)} on {processors} {'processes' if workers else 'threads'}"
        f" ({plan.mean_steps:.4g} steps a point, {1e9 * cost.seconds_per_step * processors:.3g} ns a step and"
        f" processor), of which theory {clock(expected.theory_seconds)}",
        *plan.method_lines(),
        *statistics,
        *plan.proof_lines(),
        f"first call of the kernel: {cost.compile_seconds:.1f} s (compiling, if it was not in the cache)",
        f"memory: about {memory / 1e6:.0f} MB",
        f"expected phase error of the fastest frequency: at most {phase_error:.2g} rad",
        *plan.step_warnings(),
        *(_job_lines(plan, expected, processors, *jobs) if jobs else []),
    ]
    return "\n".join(lines)


def _memory(plan: ScenePlan, cost: _Measurement, threads: int) -> float:
    """Return the memory in bytes of a process with this number of threads."""
    return cost.memory + (plan.tiles_in_flight(threads) - 1) * cost.bytes_per_tile


def _job_lines(plan: ScenePlan, expected: _Cost, measured: int, jobs: int, processors: int) -> list[str]:
    """Return time and memory of the largest job, and SLURM options for twice as much. `expected` is the cost on `measured` processors."""
    tiles, text, share = plan.tiling.count, "", 1 / jobs  # the jobs of a refined scene share each level
    if plan.scene.refine is None:
        most = math.ceil(tiles / jobs)
        text, share = f"at most {most} of {tiles} tiles each, ", most / tiles
    integration = (expected.seconds - expected.theory_seconds) * measured / processors
    seconds = share * (integration + expected.theory_seconds)
    memory = _memory(plan, expected.tile, processors)
    hours, minutes = divmod(math.ceil(2 * seconds / 60) + START_MINUTES, 60)
    return [
        f"{jobs} jobs of {processors} processors: {text}about {seconds / 3600:.3g} h and {memory / 1e6:.0f} MB a job",
        f"#SBATCH --array=1-{jobs}",
        f"#SBATCH --cpus-per-task={processors}",
        f"#SBATCH --time={hours}:{minutes:02}:00",
        f"#SBATCH --mem={2 * memory / 1e6:.0f}M",
    ]


def _statistics_lines(plan: ScenePlan, threads: int | None) -> list[str]:
    """Return a sentence on the fraction of the integration that labels alone need, or none if the measurement would take long."""
    labels = plan.runs.without_statistics
    if labels is None:
        return []
    exists, steps = np.flatnonzero(plan.sample.exists), plan.step_sizes.without_unresolved().steps
    count = int(min(LABEL_STEPS / plan.mean_steps, exists.size))
    chosen = exists[np.linspace(0, exists.size - 1, count).astype(np.int64)]
    if count < LEAST_POINTS or steps[chosen].sum() > 2 * LABEL_STEPS:
        return []
    part = plan.sample.subset(chosen)
    ended = evaluate(replace(labels, outputs=[*labels.names, "end_time"]), part, threads=Threads(threads))[
        "end_time"
    ]
    share = np.minimum(np.nan_to_num(ended) / part.until, 1.0)
    left = (share * steps[chosen]).sum() / steps[chosen].sum()
    return [f"statistics: they need whole runs; without them about {left:.2g} of the integration"]


def check_memory(scene: Scene) -> None:
    """Raise BadInput for an atlas that is larger than the memory of this machine."""
    needed = scene.size * sum(np.dtype(dtype).itemsize for dtype in tile_types(scene).values())
    present = math.inf
    with suppress(AttributeError, ValueError, OSError):  # not every operating system has these names
        present = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > present:
        raise BadInput(
            f"{scene.size:.3g} points: the atlas has {needed / 1e9:.3g} GB, this machine {present / 1e9:.3g} GB of memory; name a"
            " file or folder by out, or ask for fewer points"
        )


def _stored_bytes(plan: ScenePlan, cost: _Measurement, points: float) -> float:
    """Return the bytes that a number of points with values take on the disk after compression."""
    # `cost` was measured without derived variables.
    types, derived = tile_types(plan.scene), derived_variables(plan.scene.system)
    others = sum(np.dtype(types[name]).itemsize for name in derived.keys() & types)
    return points * (cost.stored_bytes_per_point + others)


def _folder_bytes(
    plan: ScenePlan, cost: _Measurement, integrated: float, points: int, *, is_joined: bool
) -> float:
    """Return the bytes of tiles on the disk. Only `integrated` of the `points` have values. Tiles to be joined are not compressed."""
    stored = points * bytes_per_point(plan.scene) if is_joined else _stored_bytes(plan, cost, integrated)
    return stored + HEADER_BYTES * math.ceil(points / math.prod(plan.tiling.tile))


def check_disk(plan: ScenePlan, folder: Path, missing: int, *, is_joined: bool) -> None:
    """Raise BadInput if the missing points of a run, and the joined file if `is_joined` is true, do not fit onto the disk."""
    if surely_fits(plan.scene, folder):
        return
    free = shutil.disk_usage(folder).free
    cost, share = _measure(plan, 1), float(plan.sample.exists.mean())
    needed = _folder_bytes(plan, cost, share * missing, missing, is_joined=is_joined)
    if is_joined:
        needed += _stored_bytes(plan, cost, share * plan.scene.size)
    if needed > free:
        raise BadInput(
            f"{folder}: the run needs about {needed / 1e9:.3g} GB more, and {free / 1e9:.3g} GB are free on this disk"
        )


def _short_tile(plan: ScenePlan, threads: int) -> ScenePlan:
    """Return the plan of a tile from the middle of the grid, with runs that are shortened to about CALIBRATION_STEPS per thread."""
    outputs = tuple(name for name in plan.scene.outputs if name not in derived_variables(plan.scene.system))
    settings = replace(plan.scene.settings, prove=False)
    scene, tile = replace(plan.scene, outputs=outputs, settings=settings), plan.tiling.count // 2
    sample = grid.points_at_indices(scene, plan.tiling.indices(tile))
    sample = sample if sample.exists.any() else plan.sample
    plan = ScenePlan(scene, sample.subset(np.flatnonzero(sample.exists)))
    while True:
        schedule = blocks.schedule_of(plan.step_sizes.without_unresolved())
        work = plan.mean_work / plan.mean_steps * schedule.point_steps
        fraction = CALIBRATION_STEPS * min(threads, len(schedule.points)) / work
        if fraction > 0.8:  # The fraction 1 may never be reached, because numbers of steps are rounded.
            return plan
        # Both duration and max_steps are shortened, because a number of steps that max_steps limits does not depend on the duration.
        settings = plan.limited(max(round(plan.scene.settings.max_steps * fraction), 1))
        duration, transient = fraction * plan.sample.duration, fraction * plan.sample.transient
        sample = replace(plan.sample, duration=duration, transient=transient)
        plan = ScenePlan(replace(plan.scene, settings=settings), sample)


def _measure(plan: ScenePlan, threads: int) -> _Measurement:
    """Compile the kernel by integrating one point, and then measure time, memory and size of a tile from the middle of the grid."""

    def most_memory() -> float:
        """Return the peak memory of this process so far in bytes."""
        unit = 1 if sys.platform == "darwin" else 1024
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)

    plan = _short_tile(plan, threads)
    points, started = plan.sample, time.perf_counter()
    evaluate(plan.runs, points.subset(np.zeros(1, np.int64)), threads=Threads(1))
    compile_seconds, memory = time.perf_counter() - started, most_memory()
    began = time.process_time()  # other programs do not change process time
    predict_runs(plan.runs, points)
    theory_seconds = time.process_time() - began
    columns = evaluate(plan.runs, points, threads=Threads(threads)) | points.base
    seconds = time.process_time() - began - theory_seconds
    size, most = points.exists.size, most_memory()
    content = encode({}, {name: columns[name].astype(kind) for name, kind in tile_types(plan.scene).items()})
    return _Measurement(
        seconds_per_step=max(seconds - theory_seconds, 0.1 * seconds) / (threads * size * plan.mean_work),
        theory_seconds=theory_seconds / size,
        compile_seconds=compile_seconds,
        memory=most,
        bytes_per_tile=most - memory,
        stored_bytes_per_point=len(content) / size,
    )
