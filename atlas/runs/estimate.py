"""The dry run: an estimate of the time, memory and disk space that a scene needs."""

from __future__ import annotations

import math
import resource
import sys
import time
import tracemalloc
from dataclasses import dataclass, replace

import numpy as np

from ..engine import blocks
from ..io.progress import clock
from ..label.pipeline import evaluate_tile
from ..scene import grid
from ..scene.model import Scene
from .concurrency import tiles_in_flight
from .method_costs import method_lines
from .tiles import tile_types
from .tiling import mean_steps, step_sizes, tiling

# Points that are integrated for the measurement, and their steps in all for each thread: under a second.
CALIBRATION_POINTS, CALIBRATION_STEPS = 4096, 5e7


@dataclass(frozen=True)
class _Measurement:
    """Cost of some points of a scene, integrated for a part of their duration."""

    seconds_per_step: float  # wall-clock time of a step of one point, by all threads together
    compile_seconds: float
    bytes_per_point: float  # peak memory of a tile


def dry_run(scene: Scene, *, threads: int | None = None, workers: int | None = None) -> str:
    """Estimate what running a scene takes, from a short run of some of its points.

    Parameters
    ----------
    scene : Scene
    threads, workers : int, optional
        As for `run`.

    Returns
    -------
    str
        Lines of text: points and tiles, size of the file, time, what the other method would cost, memory,
        expected phase error, and the share of points that `max_steps` gives fewer steps than the tolerance
        asks for, if any.

    Raises
    ------
    BadInput
        As `run` does.
    """
    sample = grid.check(scene)
    cut, exists = tiling(scene, sample), sample.exists
    processors = workers or threads or blocks.available_threads()
    points, steps_per_point = scene.size * exists.mean(), mean_steps(scene, sample)
    cost = _measure(scene, sample, processors)
    file_bytes = scene.size * sum(np.dtype(dtype).itemsize for dtype in tile_types(scene).values())
    seconds = points * steps_per_point * cost.seconds_per_step
    tile_bytes = cost.bytes_per_point * math.prod(cut.tile)
    if workers:
        memory, processors_text = workers * (_resident_bytes() + tile_bytes), f"{workers} processes"
    else:
        in_flight = tiles_in_flight(scene, sample, cut, processors)
        memory, processors_text = _resident_bytes() + in_flight * tile_bytes, f"{processors} threads"
    phase_error = step_sizes(scene, sample).dispersion_error[exists].max()
    lines = [
        f"{scene.size} points, about {points:.0f} to integrate, {cut.count} tiles of at most {math.prod(cut.tile)}",
        f"file: at most {file_bytes / 1e6:.4g} MB before compression",
        f"time: about {clock(seconds)} on {processors_text} ({steps_per_point:.4g} steps a point,"
        f" {1e9 * cost.seconds_per_step * processors:.3g} ns a step and processor)",
        *method_lines(scene, sample),
        f"first call of the kernel: {cost.compile_seconds:.1f} s (compiling, if it was not in the cache)",
        f"memory: about {memory / 1e6:.0f} MB",
        f"expected phase error of the fastest frequency: at most {phase_error:.2g} rad",
    ]
    limited = _share_limited_by_max_steps(scene, sample)
    if limited > 0:
        lines.append(f"max_steps = {scene.settings.max_steps} cuts short {100 * limited:.3g} % of the points")
    return "\n".join(lines)


def _measure(scene: Scene, sample: grid.Grid, threads: int) -> _Measurement:
    """Integrate some points of the sample three times: to compile, to time, and to trace memory."""
    points = _calibration_points(scene, sample, threads)

    def seconds() -> float:
        started = time.perf_counter()
        evaluate_tile(scene, points, threads=threads)
        return time.perf_counter() - started

    first, second = seconds(), seconds()
    tracemalloc.start()
    evaluate_tile(scene, points, threads=threads)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return _Measurement(
        seconds_per_step=second / step_sizes(scene, points).steps.sum(),
        compile_seconds=max(first - second, 0.0),
        bytes_per_point=peak_bytes / points.exists.size,
    )


def _calibration_points(scene: Scene, sample: grid.Grid, threads: int) -> grid.Grid:
    """Points of the sample where the family exists, with durations short enough for a measurement."""
    exists = np.flatnonzero(sample.exists)
    chosen = exists[np.linspace(0, exists.size - 1, min(exists.size, CALIBRATION_POINTS)).astype(np.int64)]
    fraction = min(1.0, CALIBRATION_STEPS * threads / (chosen.size * mean_steps(scene, sample)))
    points = sample.subset(chosen)
    return replace(points, duration=points.duration * fraction)


def _resident_bytes() -> int:
    """Largest memory of this process so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _share_limited_by_max_steps(scene: Scene, sample: grid.Grid) -> float:
    """Share of the points that would get more steps without max_steps."""
    unlimited = replace(scene, settings=replace(scene.settings, max_steps=2**50))
    limited = step_sizes(scene, sample).steps < step_sizes(unlimited, sample).steps
    return float(limited[sample.exists].mean())
