"""The dry run: an estimate of the time, memory and disk space that a scene needs."""

from __future__ import annotations

import math
import resource
import shutil
import sys
import time
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import blocks
from ..errors import BadInput
from ..io import netcdf, zarr_store
from ..io.progress import clock
from ..label.pipeline import evaluate
from ..label.theory import predict_runs
from ..scene import grid
from ..scene.model import Scene
from ..systems.base import derived_values
from .plan import ScenePlan
from .refine import expected_points
from .tiles import MIN_COMPRESSED_POINTS, SIDECAR_BYTES, TABLE_BYTES, tile_types

# Points that are integrated for the measurement, in runs of neighbours, which compress as tiles do, and the steps of all
# lanes for each thread: some tenths of a second.
CALIBRATION_POINTS, CALIBRATION_RUNS, CALIBRATION_STEPS = 4096, 16, 2e7
PROCESSORS = (1, 16, 256, 4096)  # for which times are printed
# Bytes that `atlas join` takes before it reads a tile, and copies of a block of points that it holds.
JOIN_BYTES, JOIN_COPIES = 175e6, 4


@dataclass(frozen=True)
class _Measurement:
    """Measured cost of some points of a scene, integrated for a part of their duration."""

    seconds_per_step: float  # wall-clock time of a step of one point, by all threads together
    theory_seconds: float  # wall-clock time of what theory predicts of one point
    compile_seconds: float
    bytes_per_point: float  # peak memory of a tile
    stored_bytes_per_point: float  # compressed, of the variables that are measured and of parameters


def dry_run(scene: Scene, out: str = "", *, threads: int | None = None, workers: int | None = None) -> str:
    """Estimate what running a scene into a file, folder or store takes, from a short run of some points, as text; BadInput as `run`."""
    plan, is_store = ScenePlan.of(scene), zarr_store.is_store(out)
    tiles, exists = plan.shards if is_store and scene.refine is None else plan.tiling, plan.sample.exists
    processors = workers or threads or blocks.available_threads()
    existing = scene.size * exists.mean()
    points = existing if scene.refine is None else expected_points(plan)
    cost = _measure(plan, processors)
    # The derived variables of one point, from as many points as take a few tenths of a second.
    has_derived = not scene.system.derived.keys().isdisjoint(scene.outputs)
    existing_points, derived_seconds, count = np.flatnonzero(exists), 0.0, 0
    while has_derived and derived_seconds < 0.2 and count < existing_points.size:
        count = min(max(4 * count, 6), existing_points.size)
        places = np.linspace(0, existing_points.size - 1, count).astype(np.int64)
        chosen = plan.sample.subset(existing_points[places])
        started = time.perf_counter()
        derived_values(scene.system, scene.outputs, chosen.base, chosen.duration, lambda: None)
        derived_seconds = time.perf_counter() - started
    derived_seconds /= max(count, 1)
    # A refined atlas has predictions at every point.
    theory_seconds = existing * cost.theory_seconds + points * derived_seconds
    seconds = points * plan.mean_work * cost.seconds_per_step + theory_seconds
    hours = {scene.settings.method: seconds * processors / 3600}
    hours |= {name: ratio * hours[scene.settings.method] for name, ratio in plan.relative_costs().items()}
    night = "processor time: " + ", ".join(f"{each:.3g} h by {name}" for name, each in hours.items())
    tile_bytes = cost.bytes_per_point * math.prod(tiles.tile)
    unit = 1 if sys.platform == "darwin" else 1024
    resident_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit  # the largest so far
    if workers:
        memory, processors_text = workers * (resident_bytes + tile_bytes), f"{workers} processes"
    else:
        in_flight = plan.tiles_in_flight(processors)
        memory, processors_text = resident_bytes + in_flight * tile_bytes, f"{processors} threads"
    phase_error = plan.step_sizes.dispersion_error[exists].max()
    division, files, objects, joining = "near the borders that theory predicts", "", "", ""
    if scene.refine is None:
        division = f"{tiles.count} tiles of at most {math.prod(tiles.tile)}"
        files = f"{2 * tiles.count + 3} files, "
        names = len(tile_types(scene)) + len(scene.axes) + len(scene.system.parameters)  # metadata of each
        objects = f"{tiles.count * (len(tile_types(scene)) + 1) + 2 * names} objects, "
        box = min(scene.size, grid.MAX_POINTS_PER_TILE)
        raw = box * sum(np.dtype(dtype).itemsize for dtype in tile_types(scene).values())
        joining = f"; joining takes about {(JOIN_BYTES + JOIN_COPIES * raw) / 1e6:.0f} MB of memory"
        clocks = [
            f"{clock(seconds * processors / tiles.count * math.ceil(tiles.count / n))} on {n}"
            for n in PROCESSORS
            if n <= tiles.count
        ]
        night += f"; time with so many processors: {', '.join(clocks)}"
    lines = [
        f"{scene.size} points, about {points:.0f} to integrate, {division}",
        *grid.not_computed(scene, plan.sample),
        f"store: {objects}about {_stored_bytes(plan, cost, points) / 1e6:.3g} MB"
        if is_store
        else f"file: about {_stored_bytes(plan, cost, points) / 1e6:.3g} MB; run folder: {files}about"
        f" {_stored_bytes(plan, cost, points, tiled=True) / 1e6:.3g} MB{joining}",
        night,
        f"time: about {clock(seconds)} on {processors_text} ({plan.mean_steps:.4g} steps a point,"
        f" {1e9 * cost.seconds_per_step * processors:.3g} ns a step and processor), of which theory"
        f" {clock(theory_seconds)}",
        *plan.method_lines(),
        f"first call of the kernel: {cost.compile_seconds:.1f} s (compiling, if it was not in the cache)",
        f"memory: about {memory / 1e6:.0f} MB",
        f"expected phase error of the fastest frequency: at most {phase_error:.2g} rad",
    ]
    return "\n".join([*lines, *plan.step_warnings()])


def _stored_bytes(plan: ScenePlan, cost: _Measurement, points: float, *, tiled: bool = False) -> float:
    """Bytes on the disk of so many integrated points in the tiles of a run folder, or in one file."""
    types = tile_types(plan.scene)
    sizes = {name: np.dtype(dtype).itemsize for name, dtype in types.items()}
    of_theory = sum(sizes[name] for name in plan.scene.system.derived.keys() & types)  # not measured
    stored, size = points * (cost.stored_bytes_per_point + of_theory), math.prod(plan.tiling.tile)
    if not tiled:
        return stored
    compressed = size >= MIN_COMPRESSED_POINTS
    tables = math.ceil(points / size) * (SIDECAR_BYTES + compressed * TABLE_BYTES * len(types))
    return tables + (stored if compressed else points * sum(sizes.values()))


def check_disk(plan: ScenePlan, folder: Path, missing: int, *, is_joined: bool) -> None:
    """Raise BadInput if so many missing points of a run, and the file if it is joined there, do not fit onto a disk."""
    scene, free = plan.scene, shutil.disk_usage(folder).free
    if 2 * scene.size * sum(np.dtype(dtype).itemsize for dtype in tile_types(scene).values()) < free:
        return  # also without compression
    cost, share = _measure(plan, 1), float(plan.sample.exists.mean())
    needed = _stored_bytes(plan, cost, share * missing, tiled=True)
    if is_joined:
        needed += _stored_bytes(plan, cost, share * scene.size)
    if needed > free:
        raise BadInput(
            f"{folder}: the run needs about {needed / 1e9:.3g} GB more, and {free / 1e9:.3g} GB are free on this disk"
        )


def _measure(plan: ScenePlan, threads: int) -> _Measurement:
    """Integrate some points three times: to compile, to time, and to trace memory."""
    # A short measurement: without slow variables, with a small duration and few steps.
    outputs = tuple(name for name in plan.scene.outputs if name not in plan.scene.system.derived)
    scene, length = plan.scene, CALIBRATION_POINTS // CALIBRATION_RUNS
    first = np.linspace(0, max(scene.size - length, 0), CALIBRATION_RUNS).astype(np.int64)
    indices = np.unique(np.minimum(first[:, None] + np.arange(length), scene.size - 1))
    sample = grid.points_at_indices(scene, indices)
    if sample.exists.sum() < length:
        sample = plan.sample
    exists = np.flatnonzero(sample.exists)
    chosen = exists[np.linspace(0, exists.size - 1, min(exists.size, CALIBRATION_POINTS)).astype(np.int64)]
    plan = ScenePlan(replace(scene, outputs=outputs), sample.subset(chosen))
    while True:
        schedule = blocks.schedule_of(plan.step_sizes.without_unresolved())
        work = plan.mean_work / plan.mean_steps * schedule.point_steps
        fraction = CALIBRATION_STEPS * min(threads, len(schedule.points)) / work
        if fraction > 0.8:  # counts of steps are rounded
            break
        # Both, because a limited number of steps does not depend on the duration.
        settings = plan.limited(max(round(plan.scene.settings.max_steps * fraction), 1))
        sample = replace(plan.sample, duration=plan.sample.duration * fraction)
        plan = ScenePlan(replace(plan.scene, settings=settings), sample)
    points = plan.sample
    started = time.perf_counter()
    evaluate(plan.points, points, threads=threads)
    compiled = time.perf_counter()

    def processor_seconds(call: Callable[..., Any]) -> float:
        """Time of a call on each of the processors, which other programs at work do not lengthen."""
        began = time.process_time()
        call(plan.points, points, threads=threads)
        return (time.process_time() - began) / threads

    theory_seconds, seconds = processor_seconds(predict_runs), processor_seconds(evaluate)
    tracemalloc.start()
    columns = evaluate(plan.points, points, threads=threads) | points.base
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    stored = 0
    for name, dtype in tile_types(plan.scene).items():
        shuffled = columns[name].astype(dtype).view(np.uint8).reshape(points.exists.size, -1).T
        stored += len(zlib.compress(shuffled.tobytes(), netcdf.COMPRESSION["complevel"]))
    return _Measurement(
        seconds_per_step=max(seconds - theory_seconds, 0.1 * seconds) / (points.exists.size * plan.mean_work),
        theory_seconds=theory_seconds / points.exists.size,
        compile_seconds=max(compiled - started - seconds, 0.0),
        bytes_per_point=peak_bytes / points.exists.size,
        stored_bytes_per_point=stored / points.exists.size,
    )
