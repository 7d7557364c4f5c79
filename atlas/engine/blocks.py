"""Blocks of points for the kernel: SIMD over the lanes of a block, threads over blocks.

A block holds WIDTH points with one number of steps; each has its own step size, so that the result of a point depends
on that point alone and never on its neighbours, its block or the thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from .circle import Axis, Sum
from .generated import WIDTH
from .kernel import MOTION
from .sampling import quadrature
from .statistics import Row
from .stepsize import StepSizes

# A call of the kernel takes at most about this many point-steps (some 0.1 s): Ctrl-C and the progress line wait for it.
CHUNK = 20_000_000


@dataclass(frozen=True)
class BlockSchedule:
    """Blocks of points with equal numbers of steps and nodes."""

    # Indices of the points of each block; an incomplete block repeats its last point, (blocks, WIDTH)
    points: NDArray[np.int64]
    steps: NDArray[np.int64]  # as in StepSizes, (blocks,)
    steps_per_sample: NDArray[np.int64]  # as in StepSizes, (blocks,)

    @property
    def point_steps(self) -> int:
        """Steps of all points together, the repeated ones included."""
        return int(self.steps.sum()) * WIDTH

    @property
    def nodes(self) -> NDArray[np.int64]:
        """Nodes of a whole run, (blocks,)."""
        return self.steps // self.steps_per_sample + 1


def pack_blocks(steps: NDArray[np.int64], steps_per_sample: NDArray[np.int64]) -> BlockSchedule:
    """Gather points of equal steps and nodes into blocks, the longest first, so that threads end together.

    Both arguments have the shape (points,).
    """
    key = np.stack([steps, steps_per_sample])
    order = np.lexsort((key[1], -key[0]))
    key = key[:, order]
    new = np.r_[True, (key[:, 1:] != key[:, :-1]).any(0)][: steps.size]
    starts = np.flatnonzero(new)
    points, rows = [np.empty((0, WIDTH), np.int64)], [np.empty((2, 0), np.int64)]
    for first, last in zip(starts, np.r_[starts[1:], steps.size], strict=True):
        group = order[first:last]
        points.append(_in_blocks(group))
        rows.append(np.repeat(key[:, [first]], len(points[-1]), axis=1))
    return BlockSchedule(np.concatenate(points), *np.ascontiguousarray(np.concatenate(rows, axis=1)))


def sorted_blocks(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points (points,) in blocks (blocks, WIDTH), those of the most steps first."""
    return _in_blocks(np.argsort(-steps, kind="stable"))


def _in_blocks(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points in blocks, (blocks, WIDTH), in this order; an incomplete block repeats its last."""
    return np.r_[points, np.full(-points.size % WIDTH, points[-1])].reshape(-1, WIDTH)


def schedule_of(step_sizes: StepSizes, where: NDArray[np.int64] | None = None) -> BlockSchedule:
    """The blocks of an ensemble, or of some of its points by their indices."""
    if where is None:
        return pack_blocks(step_sizes.steps, step_sizes.steps_per_sample)
    packed = pack_blocks(step_sizes.steps[where], step_sizes.steps_per_sample[where])
    return replace(packed, points=where[packed.points])


def available_threads() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Segment:
    """Part of the runs of a schedule; see the arguments of `kernel.integrate` of the same names."""

    first_node: NDArray[np.int64]  # (blocks,)
    last_node: NDArray[np.int64]  # (blocks,)
    resume: NDArray[np.float64]
    out: NDArray[np.float64]  # (len(Row), points)


def resume_array(integrals: int, points: int) -> NDArray[np.float64]:
    """What the kernel keeps of runs in segments beside states and sums, uninitialised."""
    return np.empty((8 * MOTION + integrals, points))


def start_state(kernel: ModuleType, state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Copy of a state of the equations, (states, points), followed by the states that only the kernel has, which are 0."""
    more = np.zeros((kernel.STATES - len(state), state.shape[1]))
    return np.concatenate([state, more])


def integrate(
    kernel: ModuleType,
    schedule: BlockSchedule,
    step_size: NDArray[np.float64],
    state: NDArray[np.float64],
    constants: NDArray[np.float64],
    scales: NDArray[np.float64],
    cylinder: float,
    *,
    axes: NDArray[np.float64] | None = None,
    segment: Segment | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Integrate every point of a schedule.

    kernel: as `assemble.source` makes it, loaded; step_size: in time units; state: at the start, see
    `start_state`, and afterwards at the end, (kernel.STATES, points); constants: (constants, points). scales:
    reciprocals of the sizes with which changes of the first integrals are compared; 0: not conserved,
    (integrals, points). cylinder: radius of the cylinder, rad; axes: from `circle.circle_axes`, for kernels
    that measure circles, (frames * len(Axis), points). segment: part of the runs, default: all of them.
    threads: default: all processors. progress: called from worker threads with the point-steps done since the
    last call. Returns the sums, for `statistics.finish` and `circle.circle_statistics`, (len(Row) + frames *
    len(Sum), points).

    On KeyboardInterrupt the calls of the kernel in flight end first (a fraction of a second), then it is
    raised again.
    """
    assert len(state) == kernel.STATES  # the compiled kernel checks no bounds
    if axes is not None:
        constants = np.concatenate([constants, axes])
    if segment is None:
        nodes = schedule.nodes
        frames = 0 if axes is None else len(axes) // len(Axis)
        out = np.empty((len(Row) + frames * len(Sum), state.shape[1]))
        segment = Segment(np.zeros_like(nodes), nodes, np.empty((0, 0)), out)
    rules = quadrature()
    nodes = segment.last_node - segment.first_node
    steps = np.minimum(nodes * schedule.steps_per_sample, schedule.steps) * WIDTH
    resume = segment.resume
    if not resume.size and (steps > CHUNK).any():
        resume = resume_array(len(scales), state.shape[1])

    def call(first: int, last: int, first_node: NDArray[np.int64], last_node: NDArray[np.int64]) -> None:
        kernel.integrate(
            first, last, schedule.points, schedule.steps, schedule.steps_per_sample, first_node, last_node,
            step_size, state, constants, scales, rules.node_weights, rules.first_sample, rules.samples,
            cylinder * cylinder, resume, segment.out,
        )  # fmt: skip

    call_by_parts(call, steps, segment.first_node, segment.last_node, threads, progress)
    return segment.out


def call_by_parts(
    call: Callable[[int, int, NDArray[np.int64], NDArray[np.int64]], None],
    point_steps: NDArray[np.int64],
    first_node: NDArray[np.int64],
    last_node: NDArray[np.int64],
    threads: int | None,
    progress: Callable[[int], None] | None,
) -> None:
    """Make the calls of a kernel for all blocks, in threads; a block of more than CHUNK point-steps takes several.

    call: takes a range of blocks, and for every block the first and the last node; point_steps: steps of the
    blocks between these nodes, times WIDTH, (blocks,); first_node, last_node: (blocks,); threads, progress:
    see `integrate`.
    """

    def work(first: int, last: int) -> Iterator[int]:
        nodes, steps = int(last_node[first] - first_node[first]), int(point_steps[first])
        calls = min(-(-steps // CHUNK), nodes)
        if last > first + 1 or calls <= 1:
            call(first, last, first_node, last_node)
            yield int(point_steps[first:last].sum())
            return
        begin, end = first_node.copy(), last_node.copy()
        for i in range(calls):
            end[first] = first_node[first] + nodes * (i + 1) // calls
            call(first, last, begin, end)
            begin[first] = end[first]
            yield steps * (i + 1) // calls - steps * i // calls

    run_in_threads(
        work, chunk_bounds(point_steps, CHUNK, 4 * (threads or available_threads())), threads, progress
    )


def chunk_bounds(cost: NDArray[np.int64], max_cost: int, min_chunks: int) -> list[int]:
    """Bounds of chunks of a row of jobs: at least about min_chunks, of at most about max_cost each."""
    total = np.cumsum(cost)
    max_cost = min(max_cost, -(-int(total[-1]) // min_chunks)) if total.size else max_cost
    bounds = [0]
    while bounds[-1] < len(total):
        done = total[bounds[-1] - 1] if bounds[-1] else 0
        bounds.append(max(bounds[-1] + 1, int(np.searchsorted(total, done + max_cost))))
    return bounds


def run_in_threads(
    work: Callable[[int, int], Iterable[int]],
    bounds: list[int],
    threads: int | None,
    progress: Callable[[int], None] | None,
) -> None:
    """Do work(first, last) for every chunk; after an exception what has not begun is left out.

    work is done in parts: an iterable of the amounts done. threads = 0: in the thread of the caller, for work that takes
    less time than starting a thread.
    """
    if threads == 0:
        for first, last in pairwise(bounds):
            for done in work(first, last):
                if progress is not None:
                    progress(done)
        return
    stop = threading.Event()

    def chunk(first: int, last: int) -> None:
        parts = iter(work(first, last))
        while not stop.is_set():
            done = next(parts, None)
            if done is None:
                return
            if progress is not None:
                progress(done)

    with ThreadPoolExecutor(threads or available_threads()) as pool:
        jobs = [pool.submit(chunk, first, last) for first, last in pairwise(bounds)]
        try:
            for job in jobs:
                job.result()
        finally:
            stop.set()
