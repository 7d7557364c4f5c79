"""Blocks of points side by side: SIMD over the lanes of a block, threads over blocks.

A block holds WIDTH points with one number of steps; each has its own step length, so that what a
point does depends on itself alone and never on its neighbours, its block or the thread.
"""

from __future__ import annotations

import os
import string
import threading
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from . import jit, measure
from .runge_kutta import METHODS, step_source
from .specialise import specialise

WIDTH = 32
# First integrals are looked at once in so many samples, and at the end: they change slowly.
DRIFT_EVERY = 4
# About this many point-steps a call keeps Ctrl-C and the progress line alive (some 0.1 s).
CHUNK = 20_000_000
# Points that end early free their lanes: longer calls keep the lanes full to their end.
LABEL_CHUNK = 200_000_000


def source(
    equations: ModuleType, method: str, zero: Collection[str] = (), same: Mapping[str, str] = {}
) -> str:
    """Text of the kernel module for a system's equations and a method of runge_kutta.METHODS.

    zero: constants that vanish; same: constants that equal another one (both for every point to come).
    """
    text = {name: specialise(body, zero, same) for name, body in jit.functions(equations).items()}
    text.setdefault("axis_in_frame", "def axis_in_frame(state, constants):\n    return 0.0, 0.0")
    text["sample"] = jit.functions(measure)["sample"]
    states, constants = len(equations.STATE), len(equations.CONSTANTS)
    ones = (1.0,) * states, (1.0,) * constants
    integrals = []
    for i, name in enumerate(equations.INTEGRALS):
        terms = [f"t{j}" for j in range(len(getattr(equations, name)(*ones)))]
        integrals += [
            f"{', '.join(terms)}, = {name}(state, constants)",
            f"total = {' + '.join(terms)}",
            f"start = total if first else E[{i}, l]",
            f"E[{i}, l] = start",
            f"change = abs(total - start) * D[{i}, l]",
            "drift = change if change > drift else drift",
        ]
    blocks = {
        "FUNCTIONS": "\n\n\n".join(f"{jit.INLINE}\n{body}" for body in text.values()),
        "KERNEL": jit.KERNEL,
        "LOAD": "\n".join(f"y{i} = Y[{i}, l]" for i in range(states)),
        "STEP": step_source(METHODS[method], states),
        "STORE": "\n".join(f"Y[{i}, l] = y{i}" for i in range(states)),
        "CONSTANTS": "constants = (" + ", ".join(f"c[{i}, l]" for i in range(constants)) + ",)",
        "STATE": "state = (" + ", ".join(f"Y[{i}, l]" for i in range(states)) + ",)",
        "INTEGRALS": "\n".join(integrals),
    }
    numbers = {
        "WIDTH": WIDTH, "STATES": states, "CONSTS": constants, "INTS": len(equations.INTEGRALS),
        "ROWS": len(measure.OUTPUTS), "FULL": measure.LEAST_INTERVALS, "DRIFT_EVERY": DRIFT_EVERY, "ENDS": len(measure.GREGORY),
    }  # fmt: skip
    numbers |= {name: row for row, name in enumerate(measure.OUTPUTS)}
    parts = {"TAKE": TAKE, "SAMPLE": SAMPLE, "DRIFT": DRIFT}
    blocks |= {name: fill(part, blocks, numbers) for name, part in parts.items()}
    return jit.HEADER + fill(KERNEL + LABEL_KERNEL, blocks, numbers)


def fill(template: str, blocks: dict[str, str], numbers: dict[str, int]) -> str:
    """The template with $NAME alone on a line replaced by a block at its indent, elsewhere by a number."""
    lines = []
    for line in template.splitlines():
        name = line.strip().removeprefix("$")
        if line.strip().startswith("$") and name in blocks:
            indent = line[: len(line) - len(line.lstrip())]
            lines += [indent + part if part else "" for part in blocks[name].splitlines()]
        else:
            lines.append(string.Template(line).substitute(numbers))
    return "\n".join(lines) + "\n"


TAKE = """
for j in range($STATES):
    Y[j, l] = state0[j, p]
for j in range($CONSTS):
    c[j, l] = constants0[j, p]
for j in range($INTS):
    D[j, l] = scales[j, p]
for j in range($ROWS):
    S[j, l] = 0.0
"""
SAMPLE = """
$CONSTANTS
$STATE
theta_dot, psi_dot, phi_dot, normal_rate, s2, tilt, outside = sample(frame_motion(state, constants), cylinder)
axis_1, axis_2 = axis_in_frame(state, constants)
psi_0, phi_0, normal_0 = S[$psi_dot_reference, l], S[$phi_dot_reference, l], S[$normal_rate_reference, l]
low, high, wide = S[$tilt_min, l], S[$tilt_max, l], S[$sine_squared_max, l]
psi_0 = psi_dot if first else psi_0
phi_0 = phi_dot if first else phi_0
normal_0 = normal_rate if first else normal_0
low = tilt if first else low
S[$psi_dot_reference, l] = psi_0
S[$phi_dot_reference, l] = phi_0
S[$normal_rate_reference, l] = normal_0
psi_dot = (psi_dot - psi_0) * outside
phi_dot = (phi_dot - phi_0) * outside
normal_rate = normal_rate - normal_0
S[$theta_dot, l] += weight * theta_dot
S[$theta_dot_squared, l] += weight * theta_dot * theta_dot
S[$outside, l] += weight * outside
S[$psi_dot, l] += weight * psi_dot
S[$psi_dot_squared, l] += weight * psi_dot * psi_dot
S[$phi_dot, l] += weight * phi_dot
S[$phi_dot_squared, l] += weight * phi_dot * phi_dot
S[$normal_rate, l] += weight * normal_rate
S[$normal_rate_squared, l] += weight * normal_rate * normal_rate
S[$axis_1, l] += weight * axis_1
S[$axis_2, l] += weight * axis_2
S[$tilt_min, l] = tilt if tilt < low else low
S[$tilt_max, l] = tilt if tilt > high else high
S[$sine_squared_max, l] = s2 if s2 > wide else wide
"""
DRIFT = """
$CONSTANTS
$STATE
drift = S[$drift, l]
$INTEGRALS
S[$drift, l] = drift
"""

KERNEL = """

$FUNCTIONS


$KERNEL
def integrate(first, last, points, steps, strides, length, state0, constants0, scales, weights, cylinder, out):
    Y = np.empty(($STATES, $WIDTH))
    c = np.empty(($CONSTS, $WIDTH))
    H = np.empty($WIDTH)
    D = np.empty(($INTS, $WIDTH))
    E = np.empty(($INTS, $WIDTH))
    S = np.empty(($ROWS, $WIDTH))
    for block in range(first, last):
        for l in range($WIDTH):
            p = points[block, l]
            H[l] = length[p]
            $TAKE
        stride = strides[block]
        intervals = steps[block] // stride
        for i in range(intervals + 1):
            if i > 0:
                for s in range(stride):
                    for l in range($WIDTH):
                        h = H[l]
                        $CONSTANTS
                        $LOAD
                        $STEP
                        $STORE
            weight = 1.0
            if intervals < $FULL:
                if i == 0 or i == intervals:
                    weight = 0.5
            elif i < $ENDS:
                weight = weights[i]
            elif intervals - i < $ENDS:
                weight = weights[intervals - i]
            first = i == 0
            for l in range($WIDTH):
                $SAMPLE
            if i % $DRIFT_EVERY == 0 or i == intervals:
                for l in range($WIDTH):
                    $DRIFT
        for l in range($WIDTH):
            p = points[block, l]
            for j in range($STATES):
                state0[j, p] = Y[j, l]
            for j in range($ROWS):
                out[j, p] = S[j, l]
"""

# For scenes that ask for labels only: a lane is freed as soon as its point is certain to drift and takes
# the next one. All weights are positive, so sums of squares (about the mean, too) only grow: once they
# pass the tolerance of the whole run outside the cylinder, no later motion can bring the label back.
# A new point first makes strides of length 0, so that its sample at t = 0 is taken like all the others.
LABEL_KERNEL = """


$KERNEL
def integrate_labels(
    first_point, last_point, queue, stride, intervals, length, state0, constants0, scales, weights, cylinder,
    tolerance, out, samples,
):
    Y = np.zeros(($STATES, $WIDTH))
    c = np.zeros(($CONSTS, $WIDTH))
    H = np.zeros($WIDTH)
    D = np.zeros(($INTS, $WIDTH))
    E = np.zeros(($INTS, $WIDTH))
    S = np.zeros(($ROWS, $WIDTH))
    G = np.zeros($WIDTH)
    limit = np.zeros($WIDTH)
    over = np.zeros($WIDTH)
    at = np.zeros($WIDTH, np.int64)
    total_of = np.full($WIDTH, 9223372036854775807)
    point_of = np.full($WIDTH, -1)
    following = first_point
    active = 0
    free = True
    least_wide = cylinder * (1.0 + 1e-9)
    while True:
        if free:
            free = False
            for l in range($WIDTH):
                if point_of[l] < 0 and following < last_point:
                    p = queue[following]
                    following += 1
                    active += 1
                    point_of[l] = p
                    at[l] = -1
                    total_of[l] = intervals[p]
                    limit[l] = tolerance[p] * tolerance[p] * intervals[p] * (1.0 + 1e-6)
                    H[l] = 0.0
                    $TAKE
            if active == 0:
                break
        for s in range(stride):
            for l in range($WIDTH):
                h = H[l]
                $CONSTANTS
                $LOAD
                $STEP
                $STORE
        for l in range($WIDTH):
            at[l] += 1
            i = at[l]
            left = total_of[l] - i
            G[l] = 1.0
            if i < $ENDS or left < $ENDS:
                if total_of[l] < $FULL:
                    if i == 0 or left == 0:
                        G[l] = 0.5
                elif i < $ENDS:
                    G[l] = weights[i]
                elif left >= 0:
                    G[l] = weights[left]
        for l in range($WIDTH):
            weight = G[l]
            first = at[l] == 0
            $SAMPLE
        for l in range($WIDTH):
            first = at[l] == 0
            $DRIFT
        any_over = 0.0
        for l in range($WIDTH):
            seen = S[$outside, l]
            seen = seen if seen > 0.0 else 1.0
            psi = S[$psi_dot_squared, l] * (1.0 - 1e-12) - S[$psi_dot, l] * S[$psi_dot, l] / seen
            phi = S[$phi_dot_squared, l] * (1.0 - 1e-12) - S[$phi_dot, l] * S[$phi_dot, l] / seen
            most = S[$theta_dot_squared, l]
            most = psi if psi > most else most
            most = phi if phi > most else most
            certain = 1.0 if most > limit[l] else 0.0
            certain = certain if S[$sine_squared_max, l] > least_wide else 0.0
            ended = 1.0 if at[l] >= total_of[l] else certain
            over[l] = ended
            any_over += ended
        if any_over > 0.0:
            for l in range($WIDTH):
                if over[l] > 0.0 and point_of[l] >= 0:
                    p = point_of[l]
                    for j in range($STATES):
                        state0[j, p] = Y[j, l]
                        Y[j, l] = 0.0
                    for j in range($ROWS):
                        out[j, p] = S[j, l]
                        S[j, l] = 0.0
                    samples[p] = at[l]
                    point_of[l] = -1
                    H[l] = 0.0
                    at[l] = 0
                    total_of[l] = 9223372036854775807
                    active -= 1
                    free = True
        for l in range($WIDTH):
            if point_of[l] >= 0:
                H[l] = length[point_of[l]]
"""


@dataclass(frozen=True)
class Plan:
    """Blocks of a set of points: which points, how many steps, how many steps between two samples."""

    points: NDArray[np.int64]  # (blocks, WIDTH); a last block is filled up with its own last point
    steps: NDArray[np.int64]  # (blocks,)
    strides: NDArray[np.int64]  # (blocks,)

    @property
    def point_steps(self) -> int:
        return int(self.steps.sum()) * WIDTH


def plan(steps: NDArray[np.int64], strides: NDArray[np.int64]) -> Plan:
    """Gather points of equal steps and stride into blocks, the longest first (threads then end together)."""
    order = np.lexsort((strides, -steps))
    key = np.stack([steps[order], strides[order]])
    starts = (
        np.flatnonzero(np.r_[True, (key[:, 1:] != key[:, :-1]).any(0)]) if steps.size else np.array([], int)
    )
    blocks, counts, pace = [], [], []
    for first, last in zip(starts, np.r_[starts[1:], steps.size], strict=True):
        group = order[first:last]
        padded = np.r_[group, np.full(-len(group) % WIDTH, group[-1])].reshape(-1, WIDTH)
        blocks.append(padded)
        counts.append(np.full(len(padded), key[0, first]))
        pace.append(np.full(len(padded), key[1, first]))
    if not blocks:
        return Plan(np.empty((0, WIDTH), np.int64), np.empty(0, np.int64), np.empty(0, np.int64))
    return Plan(np.concatenate(blocks), np.concatenate(counts), np.concatenate(pace))


def available_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def integrate(
    kernel: ModuleType,
    blocks: Plan,
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
    ends = np.ascontiguousarray(measure.GREGORY)

    def work(first: int, last: int) -> int:
        kernel.integrate(
            first, last, blocks.points, blocks.steps, blocks.strides, length, state, constants, scales,
            ends, cylinder * cylinder, out,
        )  # fmt: skip
        return int(blocks.steps[first:last].sum()) * WIDTH

    cost, workers = blocks.steps * WIDTH, threads or available_threads()
    _in_threads(work, _cuts(cost, min(CHUNK, int(cost.sum()) // (4 * workers))), threads, progress)
    return out


def integrate_labels(
    kernel: ModuleType,
    steps: NDArray[np.int64],
    strides: NDArray[np.int64],
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
    """The same as `integrate` until a point is certain to drift: returns its output and the intervals done.

    steps, strides: (points,), as in steps.Steps; tolerance: (points,) rate above which a point is certain to
    drift, rad per time unit.
    A point whose intervals done are fewer than steps // strides drifts, whatever comes.
    """
    out = np.empty((len(measure.OUTPUTS), state.shape[1]))
    samples = np.zeros(steps.shape, np.int64)
    ends = np.ascontiguousarray(measure.GREGORY)
    intervals = steps // strides
    for stride in np.unique(strides):
        queue = np.flatnonzero(strides == stride)
        queue = queue[np.argsort(-steps[queue], kind="stable")]

        def work(first: int, last: int, queue: NDArray[np.int64] = queue, stride: int = int(stride)) -> int:
            kernel.integrate_labels(
                first, last, queue, stride, intervals, length, state, constants, scales, ends,
                cylinder * cylinder, tolerance, out, samples,
            )  # fmt: skip
            return int(steps[queue[first:last]].sum())

        _in_threads(work, _cuts(steps[queue], LABEL_CHUNK), threads, progress)
    return out, samples


def _cuts(cost: NDArray[np.int64], most: int) -> list[int]:
    """Where to cut a row of jobs so that each piece costs about `most`."""
    total = np.cumsum(cost)
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
