"""Blocks of WIDTH points with equal numbers of steps. The points of a block run in SIMD lanes, and blocks run in threads.

Each point has its own step size, so that the result of a point depends on no neighbour, block or thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .generated import WIDTH
from .sampling import EndWeights, Quadrature
from .stepsize import StepSizes

# A call of the kernel takes about this many point-steps (0.1 s) at most, because Ctrl-C and the progress line wait for the call.
CHUNK = 20_000_000
# Up to this many point-steps, about 1 ms, starting threads takes longer than it saves.
FEW = 100_000
Array = NDArray[np.float64]
Counts = NDArray[np.int64]


class BlockSchedule(NamedTuple):
    """Blocks of points with equal numbers of steps and nodes."""

    points: Counts  # indices of points, (blocks, WIDTH); the last point fills an incomplete block
    steps: Counts  # `StepSizes.steps` of the points of each block, (blocks,)
    steps_per_sample: Counts  # `StepSizes.steps_per_sample` of the points of each block, (blocks,)

    @property
    def point_steps(self) -> int:
        """Number of steps of all points, including repeated points."""
        return int(self.steps.sum()) * WIDTH

    @property
    def nodes(self) -> NDArray[np.int64]:
        return self.steps // self.steps_per_sample + 1


def pack_blocks(steps: NDArray[np.int64], steps_per_sample: NDArray[np.int64]) -> BlockSchedule:
    """Return blocks of points with equal numbers of steps and nodes. Long blocks come first, so that threads end together."""
    key = np.stack([steps, steps_per_sample])
    order = np.lexsort((key[1], -key[0]))
    key = key[:, order]
    new = np.append(True, (key[:, 1:] != key[:, :-1]).any(0))[: steps.size]
    starts = np.flatnonzero(new)
    points, rows = [np.empty((0, WIDTH), np.int64)], [np.empty((2, 0), np.int64)]
    for first, last in zip(starts, np.append(starts[1:], steps.size), strict=True):
        group = order[first:last]
        points.append(np.append(group, np.full(-group.size % WIDTH, group[-1])).reshape(-1, WIDTH))
        rows.append(np.repeat(key[:, [first]], len(points[-1]), axis=1))
    return BlockSchedule(np.concatenate(points), *np.ascontiguousarray(np.concatenate(rows, axis=1)))


def schedule_of(step_sizes: StepSizes, where: NDArray[np.int64] | None = None) -> BlockSchedule:
    """Return the blocks of an ensemble, or of the points with the indices `where`."""
    if where is None:
        return pack_blocks(step_sizes.steps, step_sizes.steps_per_sample)
    packed = pack_blocks(step_sizes.steps[where], step_sizes.steps_per_sample[where])
    return packed._replace(points=where[packed.points])


def available_threads() -> int:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("NUMBA_NUM_THREADS", "")
    return min(count, max(int(limit), 1)) if limit.isdecimal() else count


class Arrays(NamedTuple):
    """Data of points that a kernel reads and writes. Between two calls for parts of a run, `state` is in the kernel's units."""

    step_size: Array  # in time units
    state: Array  # state at the start (see `start_state`), which a call replaces by the state at the end, (kernel.STATES, points)
    constants: Array  # constants of the equations, (constants, points)
    scales: Array  # reciprocals of the sizes of first integrals, (integrals, points)
    given: Array  # constants of the plugged instruments, (kernel.PLUGGED_GIVEN, points)
    rule: Quadrature | EndWeights
    cylinder_squared: float  # square of the radius of the cylinder, rad^2
    resume: Array  # kept between calls: last four nodes, and first integrals at the start, (rows, points)
    sums: Array  # output of the kernel, (kernel.SUMS, points)


def start_state(kernel: ModuleType, state: Array) -> Array:
    """Return a state of the equations, (states, points), with zeros added for the losses of first integrals."""
    return np.concatenate([state, np.zeros((kernel.STATES - len(state), state.shape[1]))])


def resumable(kernel: ModuleType, arrays: Arrays) -> Arrays:
    """Return the arrays with memory in `resume`. Runs that take several calls need this memory."""
    rows = 4 * kernel.NODE_ROWS + len(arrays.scales)
    return arrays._replace(resume=np.empty((rows, arrays.state.shape[1])))


@dataclass(frozen=True)
class Threads:
    """Threads that integrate. `progress` is called with the work done since the last call, and may raise an exception."""

    count: int | None = None  # None stands for one thread per processor, 0 for the calling thread
    progress: Callable[[float], None] = lambda work: None

    def scaled(self, factor: float) -> Threads:
        """Return the same threads, which report `factor` times the work to `progress`."""
        return Threads(self.count, lambda work: self.progress(factor * work))


ALL_THREADS = Threads()


def integrate(
    kernel: ModuleType,
    schedule: BlockSchedule,
    arrays: Arrays,
    *,
    segment: tuple[Counts, Counts] | None = None,
    threads: Threads = ALL_THREADS,
) -> None:
    """Integrate every point of a schedule, and write states and sums into `arrays`.

    `segment` is the range of nodes of each block, by default the whole run. `threads.progress` counts point-steps. If threads.count
    is None, the calling thread does work of at most FEW point-steps itself. After a KeyboardInterrupt, running calls end first.
    """
    assert len(arrays.state) == kernel.STATES  # the compiled kernel checks no bounds
    assert len(arrays.given) == kernel.PLUGGED_GIVEN
    first, last = segment or (np.zeros_like(schedule.nodes), schedule.nodes)
    steps = np.minimum((last - first) * schedule.steps_per_sample, schedule.steps) * WIDTH
    if not arrays.resume.size and (steps > CHUNK).any():
        arrays = resumable(kernel, arrays)
    # The calling thread does small work itself. The first call, which may compile, runs in another thread, so that Ctrl-C need not wait.
    if threads.count is None and steps.sum() <= FEW and getattr(kernel.integrate, "signatures", True):
        threads = Threads(0, threads.progress)
    call_by_parts(partial(kernel.integrate, schedule, arrays), steps, first, last, threads)


def call_by_parts(
    call: Callable[[int, int, Counts, Counts], None],
    point_steps: Counts,
    first_node: Counts,
    last_node: Counts,
    threads: Threads,
) -> None:
    """Call a kernel for all blocks in threads. A long block takes several calls."""
    # Successive blocks form chunks, about four or more for each thread. A chunk of several blocks has at most CHUNK point-steps.
    total, stop = np.cumsum(point_steps), threading.Event()
    least_chunks = 1 if threads.count == 0 else 4 * (threads.count or available_threads())
    max_cost = min(CHUNK, -(-int(total[-1]) // least_chunks)) if total.size else CHUNK
    bounds = [0]
    while bounds[-1] < len(total):
        done = total[bounds[-1] - 1] if bounds[-1] else 0
        bounds.append(max(bounds[-1] + 1, int(np.searchsorted(total, done + max_cost))))

    def chunk(first: int, last: int) -> None:
        nodes, steps = int(last_node[first] - first_node[first]), int(point_steps[first:last].sum())
        calls = max(min(-(-steps // CHUNK), nodes), 1) if last == first + 1 else 1
        begin, end = (first_node, last_node) if calls == 1 else (first_node.copy(), last_node.copy())
        for i in range(calls):
            if stop.is_set():
                return
            if calls > 1:
                begin[first] = first_node[first] + nodes * i // calls
                end[first] = first_node[first] + nodes * (i + 1) // calls
            call(first, last, begin, end)
            threads.progress(steps * (i + 1) // calls - steps * i // calls)

    if threads.count == 0:
        for first, last in pairwise(bounds):
            chunk(first, last)
        return
    with ThreadPoolExecutor(threads.count or available_threads()) as pool:
        jobs = [pool.submit(chunk, first, last) for first, last in pairwise(bounds)]
        try:
            for job in jobs:
                job.result()
        finally:
            stop.set()
