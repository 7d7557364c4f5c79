"""Blocks of points side by side: SIMD over the lanes of a block, threads over blocks.

A block holds WIDTH points with one number of steps; each has its own step length, so that what a
point does depends on itself alone and never on its neighbours, its block or the thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from . import measure
from .template import WIDTH

# About this many point-steps a call keeps Ctrl-C and the progress line alive (some 0.1 s).
CHUNK = 20_000_000
# Points that end early free their lanes: longer calls keep the lanes full to their end.
LABEL_CHUNK = 200_000_000


@dataclass(frozen=True)
class BlockSchedule:
    """Blocks of a set of points: which points, and their steps, strides and parts as in steps.Steps."""

    points: NDArray[np.int64]  # (blocks, WIDTH); a last block is filled up with its own last point
    steps: NDArray[np.int64]  # (blocks,)
    strides: NDArray[np.int64]  # (blocks,)
    parts: NDArray[np.int64]  # (blocks,)

    @property
    def point_steps(self) -> int:
        return int(self.steps.sum()) * WIDTH


def pack_blocks(
    steps: NDArray[np.int64], strides: NDArray[np.int64], parts: NDArray[np.int64] | None = None
) -> BlockSchedule:
    """Gather points of equal steps into blocks, the longest first (threads then end together).

    steps, strides, parts: (points,), as in steps.Steps; without parts only whole strides are sampled.
    """
    key = np.stack([steps, strides, np.ones_like(steps) if parts is None else parts])
    order = np.lexsort((key[2], key[1], -key[0]))
    key = key[:, order]
    new = np.r_[True, (key[:, 1:] != key[:, :-1]).any(0)][: steps.size]
    starts = np.flatnonzero(new)
    blocks, rows = [np.empty((0, WIDTH), np.int64)], [np.empty((3, 0), np.int64)]
    for first, last in zip(starts, np.r_[starts[1:], steps.size], strict=True):
        group = order[first:last]
        blocks.append(np.r_[group, np.full(-len(group) % WIDTH, group[-1])].reshape(-1, WIDTH))
        rows.append(np.repeat(key[:, [first]], len(blocks[-1]), axis=1))
    return BlockSchedule(np.concatenate(blocks), *np.ascontiguousarray(np.concatenate(rows, axis=1)))


def available_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def integrate(
    kernel: ModuleType,
    blocks: BlockSchedule,
    length: NDArray[np.float64],
    state: NDArray[np.float64],
    constants: NDArray[np.float64],
    scales: NDArray[np.float64],
    cylinder: float,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> NDArray[np.float64]:
    """Integrate every point; returns (len(measure.OUTPUTS), points) and leaves the final state in `state`.

    length: (points,) step of each point, time units; state: (states, points), C order, overwritten;
    constants: (constants, points); scales: (integrals, points), the reciprocal of what a change of
    that integral is held against, 0 where it is not conserved; cylinder: radius of the cylinder, rad.
    progress is called with the point-steps done since the last call, from worker threads. On
    KeyboardInterrupt the calls in flight end first (a fraction of a second), then it is raised again.
    """
    out = np.empty((len(measure.OUTPUTS), state.shape[1]))
    ends, between = measure.WEIGHTS, measure.between(kernel.PARTS)

    def work(first: int, last: int) -> int:
        kernel.integrate(
            first, last, blocks.points, blocks.steps, blocks.strides, blocks.parts, length, state, constants, scales,
            ends, between, cylinder * cylinder, out,
        )  # fmt: skip
        return int(blocks.steps[first:last].sum()) * WIDTH

    _in_threads(
        work,
        _chunk_bounds(blocks.steps * WIDTH, CHUNK, 4 * (threads or available_threads())),
        threads,
        progress,
    )
    return out


def integrate_labels(
    kernel: ModuleType,
    steps: NDArray[np.int64],
    strides: NDArray[np.int64],
    parts: NDArray[np.int64],
    length: NDArray[np.float64],
    state: NDArray[np.float64],
    constants: NDArray[np.float64],
    scales: NDArray[np.float64],
    cylinder: float,
    tolerance: NDArray[np.float64],
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The same as `integrate` until a point is certain to drift: returns its output and the looks done.

    steps, strides, parts: (points,), as in steps.Steps; tolerance: (points,) rate above which a point is
    certain to drift, rad per time unit.
    A point whose looks done are fewer than steps // strides drifts, whatever comes.
    """
    out = np.empty((len(measure.OUTPUTS), state.shape[1]))
    done = np.zeros(steps.shape, np.int64)
    ends, between = measure.WEIGHTS, measure.between(kernel.PARTS)
    looks = steps // strides
    for stride, part in np.unique(np.stack([strides, parts]), axis=1).T:
        queue = np.flatnonzero((strides == stride) & (parts == part))
        queue = queue[np.argsort(-steps[queue], kind="stable")]

        def work(first: int, last: int, queue=queue, stride: int = int(stride), part: int = int(part)) -> int:
            kernel.integrate_labels(
                first, last, queue, stride, part, looks, length, state, constants, scales, ends, between,
                cylinder * cylinder, tolerance, out, done,
            )  # fmt: skip
            return int(steps[queue[first:last]].sum())

        _in_threads(
            work, _chunk_bounds(steps[queue], LABEL_CHUNK, threads or available_threads()), threads, progress
        )
    return out, done


def _chunk_bounds(cost: NDArray[np.int64], most: int, pieces: int) -> list[int]:
    """Where to cut a row of jobs: about so many pieces at least, that cost at most about `most` each."""
    total = np.cumsum(cost)
    most = min(most, -(-int(total[-1]) // pieces)) if total.size else most
    cuts = [0]
    while cuts[-1] < len(total):
        done = total[cuts[-1] - 1] if cuts[-1] else 0
        cuts.append(max(cuts[-1] + 1, int(np.searchsorted(total, done + most))))
    return cuts


def _in_threads(
    work: Callable[[int, int], int],
    cuts: list[int],
    threads: int | None,
    progress: Callable[[int], None] | None,
) -> None:
    """Call work(first, last) for every piece; after an exception the pieces not begun are left out."""
    stop = threading.Event()

    def piece(first: int, last: int) -> None:
        if not stop.is_set():
            done = work(first, last)
            if progress is not None:
                progress(done)

    with ThreadPoolExecutor(threads or available_threads()) as pool:
        jobs = [pool.submit(piece, first, last) for first, last in pairwise(cuts)]
        try:
            for job in jobs:
                job.result()
        finally:
            stop.set()
