"""The dry run: points, steps, time and memory of a scene before it is run."""

from __future__ import annotations

import math
import resource
import sys
import time
import tracemalloc
from dataclasses import replace

import numpy as np

from ..engine import blocks
from ..io.progress import clock
from ..label.pipeline import evaluate_tile
from ..scene import grid
from ..scene.model import Scene
from .concurrency import tiles_in_flight
from .folder import tile_types
from .tiling import mean_steps, step_sizes, tiling

# A dry run times so many points over so many steps for each thread, a fraction of a second.
CALIBRATION_POINTS, CALIBRATION_STEPS = 4096, 5e7


def dry_run(scene: Scene, *, threads: int | None = None, workers: int | None = None) -> str:
    """What running a scene will take, as text; some of its points are run for a short while to tell.

    threads, workers: as for `run`. Raises BadInput as `run` does.
    """
    checked = grid.check(scene)
    cut, plan = tiling(scene, checked), step_sizes(scene, checked)
    threads = workers or threads or blocks.available_threads()
    there = np.flatnonzero(checked.there)
    points = scene.size * there.size / checked.there.size
    mean, point_bytes = (
        mean_steps(scene, checked),
        sum(np.dtype(t).itemsize for t in tile_types(scene).values()),
    )
    some = there[np.linspace(0, there.size - 1, min(there.size, CALIBRATION_POINTS)).astype(np.int64)]
    short = min(1.0, CALIBRATION_STEPS * threads / (some.size * mean))
    part = grid.Grid(
        {name: values[some] for name, values in checked.base.items()},
        {name: values[some] for name, values in checked.points.items()},
        checked.there[some],
        checked.duration[some] * short,
    )
    began = time.perf_counter()
    evaluate_tile(scene, part, threads=threads)
    first = time.perf_counter() - began
    began = time.perf_counter()
    evaluate_tile(scene, part, threads=threads)
    second = time.perf_counter() - began
    tracemalloc.start()
    evaluate_tile(scene, part, threads=threads)
    peak = tracemalloc.get_traced_memory()[1] / some.size
    tracemalloc.stop()
    per_step = second / step_sizes(scene, part).count.sum()
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    if workers:
        memory, who = workers * (resident + peak * math.prod(cut.tile)), f"{workers} processes"
    else:
        tiles = tiles_in_flight(scene, checked, cut, threads)
        memory, who = resident + tiles * peak * math.prod(cut.tile), f"{threads} threads"
    free = replace(scene, settings=replace(scene.settings, max_steps=2**50))
    capped = (plan.count < step_sizes(free, checked).count)[there].mean()
    lines = [
        f"{scene.size} points, about {points:.0f} to integrate, {cut.count} tiles of at most {math.prod(cut.tile)}",
        f"file: at most {scene.size * point_bytes / 1e6:.4g} MB before compression",
        f"time: about {clock(points * mean * per_step)} on {who} ({mean:.4g} steps a point,"
        f" {1e9 * per_step * threads:.3g} ns a step and processor)",
        f"first call of the kernel: {max(first - second, 0.0):.1f} s (compiling, if it was not in the cache)",
        f"memory: about {memory / 1e6:.0f} MB",
        f"expected phase error of the fastest frequency: at most {plan.phase_error[there].max():.2g} rad",
    ]
    if capped > 0:
        lines.append(f"max_steps = {scene.settings.max_steps} cuts short {100 * capped:.3g} % of the points")
    return "\n".join(lines)
