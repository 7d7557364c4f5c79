"""Crossings of a surface by motions that run side by side.

The kernel gives states at nodes, between which the function of the surface is nearly the cubic with its values and slopes there.
Each zero of the cubic is improved by Newton's method, with Runge-Kutta steps from the node, so that it has the accuracy of the
integration. Where the cubic nearly touches 0 its extremum becomes a node, which decides between two crossings and none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...kernel.ensemble import Ensemble
from ...kernel.stepsize import StepSizes
from ...kernel.tableaux import Method
from ...scene.expressions import Expression
from ...systems.base import Array, Mask
from .surface import Quantities, Surface

Counts = NDArray[np.int64]
NODE_RADIANS = 0.8  # largest distance of two nodes, in rad of the frequency bound
NODES, LONGEST = 2**18, 512  # of all motions in memory together, and of one
PARTS = 64  # of a transient, so that an interruption need not wait for its end
# A cubic nearly touches 0 where an extremum is below this share of its ends; twice as fast as the bound its error is a third of it.
TOUCHING, SPLITS = 0.2, 4
# Newton's method ends where a step is this share of the distance of two nodes; near a touch rounding allows the other share only.
NEWTON, CONVERGED, ACCEPTED = 60, 1e-14, 1e-8
# A motion on which the function stays below this share of what its states could make of it stays on the surface.
STAYS = 1e-9
START = 1e-9  # a crossing so near to the start, in distances of nodes, is the start itself


def crossings(
    surface: Surface, kept: Sequence[Expression], kernel: ModuleType, method: Method, ensemble: Ensemble,
    sizes: StepSizes, transient: Array, duration: Array, count: int,
) -> tuple[Array, Counts, Mask]:  # fmt: skip
    """Kept quantities and, last, times of at most `count` crossings, (rows, points, count); their numbers; finite motions."""
    table = np.full((len(kept) + 1, ensemble.size, count), np.nan)
    have, done = np.zeros((2, ensemble.size), np.int64)
    ensemble = replace(ensemble, state=ensemble.state.copy())
    state, step, finite = ensemble.state, sizes.step_size, np.ones(ensemble.size, bool)
    if transient.any():
        steps = np.maximum(np.ceil(transient / (PARTS * step)), 1).astype(np.int64)
        equal = np.broadcast_to(transient / (PARTS * steps), (PARTS, ensemble.size))
        state[:] = ensemble.states_at_samples(kernel, steps, equal)[:, -1]
    radians = np.maximum(ensemble.frequency_bound * step, 1e-300)
    steps = np.clip(NODE_RADIANS / radians, 1, sizes.steps).astype(np.int64)
    nodes = np.ceil(duration / (step * steps)).astype(np.int64)
    spacing, step = duration / nodes, duration / (nodes * steps)
    active = np.arange(ensemble.size)
    while active.size:
        length = int(min(np.clip(NODES // active.size, 16, LONGEST), (nodes - done)[active].max()))
        part = ensemble.subset(active)
        threads = 0 if done.any() else None  # the first call may compile the kernel
        equal = np.broadcast_to(step[active], (length, active.size))
        after = part.states_at_samples(kernel, steps[active], equal, threads=threads)
        states = np.concatenate([part.state[:, None], after], axis=1)
        state[:, active] = after[:, -1]
        in_run = (done[active] + np.arange(length)[:, None] < nodes[active]).T
        finite[active] = (np.isfinite(after).all(0).T | ~in_run).all(1)
        value, slope = (each.T for each in surface.with_slope(states, part.constants[:, None]))
        slope = slope * spacing[active][:, None]

        def start(
            place: Counts, length: int = length, active: Counts = active, states: Array = states
        ) -> Any:
            """State, constants and step before the nodes at places in (points, length)."""
            point, node = np.divmod(place, length)
            here = active[point]
            return states[:, node, point], ensemble.constants[:, here], step[here], spacing[here]

        def at(place: Counts, share: Array, start: Callable[[Counts], Any] = start) -> tuple[Array, Array]:
            """The function and its slope at shares of intervals."""
            before, constants, length, unit = start(place)
            f, s = surface.with_slope(
                _moved(surface, method, before, constants, share * unit, length), constants
            )
            return f, s * unit

        ends = np.array([value[:, :-1], value[:, 1:], slope[:, :-1], slope[:, 1:]]).reshape(4, -1)
        with np.errstate(all="ignore"):
            f0, f1, s0, s1 = ends
            near = (np.sign(f0) != np.sign(f1)) | ((f0 * s0 <= 0) & (f1 * s1 >= 0))
            near_at = np.flatnonzero(in_run.ravel() & near)
            whole = [near_at, 0 * near_at, 0 * near_at + 1, *ends[:, near_at]]
            brackets = _brackets(at, SPLITS, np.array(whole, float))
        place, low, high, share, side, size = brackets[:, np.lexsort(brackets[[3, 0]])]
        place = place.astype(np.int64)
        point, node = np.divmod(place, length)
        before, constants, own_step, unit = start(place)
        time, at_root, f, converged = _roots(
            surface, method, before, constants, own_step, low * unit, high * unit, share * unit, side, unit
        )
        quantities = Quantities(surface.system, at_root, constants)
        with np.errstate(all="ignore"):
            counted = converged & (np.abs(f) <= size) & surface.contains(quantities)
            counted &= np.nanmax(np.abs(value), axis=1)[point] > STAYS * surface.size(at_root, constants)
            counted &= (time > START * unit) | (done[active[point]] + node > 0)
            counted &= (surface.direction == 0) | (side == -surface.direction)
            time = transient[active[point]] + (done[active[point]] + node) * unit + time
            rows = np.array([np.broadcast_to(each.value(quantities), time.shape) for each in kept] + [time])
        point, rows = point[counted], rows[:, counted]
        number = have[active[point]] + np.arange(point.size) - np.searchsorted(point, point)
        fits = number < count
        table[:, active[point[fits]], number[fits]] = rows[:, fits]
        have[active] += np.bincount(point, minlength=active.size)
        done[active] += length
        active = active[finite[active] & (done[active] < nodes[active]) & (have[active] < count)]
    return table, np.minimum(have, count), finite


def _moved(surface: Surface, method: Method, state: Array, constants: Array, time: Array, step: Array) -> Any:
    """States a time later, by steps that are no longer than `step`."""

    def slope(state: Array) -> Array:
        return np.array(np.broadcast_arrays(*surface.system.equations.rhs(state, constants)))

    count = max(int(np.ceil(np.max(np.abs(time) / step, initial=0.0) - 1e-9)), 1)
    for _ in range(count):
        state = method.step(slope, state, time / count)
    return state


def _brackets(at: Callable[[Counts, Array], tuple[Array, Array]], splits: int, pieces: Array) -> Array:
    """Shares of intervals that hold one zero each: place, two ends, about the zero, sign at the first end, largest value at both.

    pieces: place, two ends as shares of the interval, the values and the slopes by this share at both ends.
    """
    place, low, high, f0, f1, s0, s1 = pieces
    width = high - low
    first, last = s0 * width, s1 * width
    a, b = 2 * (f0 - f1) + first + last, 3 * (f1 - f0) - 2 * first - last
    root = -b - np.copysign(np.sqrt(np.maximum(b * b - 3 * a * first, 0.0)), b)
    extrema = np.array([root / (3 * a), first / root])
    inside = (extrema > 0) & (extrema < 1) & (b * b > 3 * a * first)
    edges = np.array([0 * f0, *np.sort(np.where(inside, extrema, 1.0), axis=0), 0 * f0 + 1])

    def cubic(x: Array) -> Array:
        return np.asarray(f0 + x * (first + x * (b + x * a)))

    heights = np.where(edges == 1.0, f1, cubic(edges))
    depth = np.where((edges > 0) & (edges < 1), np.abs(heights), np.inf)
    lowest = depth.argmin(0), np.arange(place.size)
    split = depth[lowest] < TOUCHING * np.maximum(np.abs(f0), np.abs(f1))
    if splits and split.any():
        middle = (low + edges[lowest] * width)[split]
        halves = pieces[:, split], pieces[:, split]
        for half, end in zip(halves, (1, 0), strict=True):
            half[[1 + end, 3 + end, 5 + end]] = middle, *at(place[split].astype(np.int64), middle)
        rest = _brackets(at, 0, pieces[:, ~split])
        return np.concatenate([rest, _brackets(at, splits - 1, np.concatenate(halves, axis=1))], axis=1)
    brackets = [np.empty((6, 0))]
    for (x0, x1), (h0, h1) in zip(pairwise(edges), pairwise(heights), strict=True):
        has = (x0 < x1) & (np.sign(h0) != np.sign(h1)) & (h0 != 0)
        lower, upper = x0.copy(), x1.copy()
        for _ in range(30):
            middle = 0.5 * (lower + upper)
            left = np.sign(cubic(middle)) == np.sign(h0)
            lower, upper = np.where(left, middle, lower), np.where(left, upper, middle)
        rows = (
            place,
            low + x0 * width,
            low + x1 * width,
            low + lower * width,
            np.sign(h0),
            np.maximum(np.abs(h0), np.abs(h1)),
        )
        brackets.append(np.array(rows)[:, has])
    return np.concatenate(brackets, axis=1)


def _roots(
    surface: Surface, method: Method, state: Array, constants: Array, step: Array,
    low: Array, high: Array, time: Array, side: Array, unit: Array,
) -> tuple[Array, Array, Array, Mask]:  # fmt: skip
    """Times of the zeros, states and values there, and whether Newton's method converged; outside its bracket it bisects."""
    state, value = _moved(surface, method, state, constants, time, step), np.zeros(time.size)
    change, left = np.full(time.size, np.inf), np.arange(time.size)
    for _ in range(NEWTON):
        t, f, slope = time[left], *surface.with_slope(state[:, left], constants[:, left])
        value[left], before = f, np.sign(f) == side[left]
        low[left], high[left] = np.where(before, t, low[left]), np.where(before, high[left], t)
        with np.errstate(all="ignore"):
            new = np.where(f == 0, t, t - f / slope)
        new = np.where((new >= low[left]) & (new <= high[left]), new, 0.5 * (low[left] + high[left]))
        change[left] = np.abs(new - t) / unit[left]
        left, before = left[moving := change[left] > CONVERGED], time[left][moving]
        if not left.size:
            break
        time[left] = new[moving]
        state[:, left] = _moved(
            surface, method, state[:, left], constants[:, left], time[left] - before, step[left]
        )
    return time, state, value, change < ACCEPTED
