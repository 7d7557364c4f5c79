"""Crossings of a surface by many motions.

Between nodes of the kernel the function of the surface is nearly a cubic with the values and slopes at the nodes. If a cubic has
several zeros, or nearly touches 0, the extremum becomes a node as well. Newton's method improves each zero to the accuracy of the
integration, with runs of the kernel that start at the node before the zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ...kernel.ensemble import Ensemble
from ...kernel.stepsize import StepSizes
from ...scene.expressions import Expression
from ...systems.base import Array, Mask
from .surface import Surface, quantities

Counts = NDArray[np.int64]
NODE_RADIANS = 0.8  # largest distance of two nodes times the frequency bound, in rad
# Allowed numbers of steps between two nodes. The list is short, so that many motions share a block of the kernel.
STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24])
NODES, LONGEST = 2**15, 2048  # largest numbers of nodes in memory, of all motions and of one motion
# A cubic nearly touches 0 if |extremum| is below a limit. In the middle of an interval the limit is TOUCHING times the larger |value| at
# the ends. Like the error of a cubic, the limit falls to 0 at the ends. The error is at most a third of the limit for functions that
# oscillate at up to twice the frequency bound.
TOUCHING, SPLITS = 0.2, 6
ATTEMPTS = 60
# Newton's method stops when a step is below LAST_STEP times the interval, or LAST_SHARE times the distance to the nearer end.
LAST_STEP, LAST_SHARE = 1e-7, 1e-4
# A motion lies on the surface if |function| stays below STAYS times the derivative along a generic change of the states.
STAYS = 1e-9
START = 1e-9  # A crossing within this fraction of the first interval is the start itself.


@np.errstate(all="ignore")
def crossings(
    surface: Surface, kept: Sequence[Expression], kernel: ModuleType, ensemble: Ensemble, sizes: StepSizes,
    duration: Array, count: int,
) -> tuple[Array, Counts, Mask]:  # fmt: skip
    """Return kept quantities and times of at most `count` crossings, the number of crossings, and whether states stay finite."""
    table = np.full((len(kept) + 1, ensemble.size, count), np.nan)
    have, done = np.zeros((2, ensemble.size), np.int64)
    state, finite = ensemble.state.copy(), np.ones(ensemble.size, bool)
    radians = np.maximum(ensemble.frequency_bound * sizes.step_size, 1e-300)
    longest = np.clip(NODE_RADIANS / radians, 1, sizes.steps)
    steps = STEPS[np.searchsorted(STEPS, longest, side="right") - 1]
    nodes = np.ceil(duration / (sizes.step_size * steps)).astype(np.int64)
    spacing = duration / nodes
    names, shares = {name for each in kept for name in each.names}, np.cos(np.arange(len(state)))[:, None]
    active = np.arange(ensemble.size)
    while active.size:
        length = int(min(np.clip(NODES // active.size, 16, LONGEST), (nodes - done)[active].max()))
        part, unit = replace(ensemble, state=state).subset(active), spacing[active]
        states, slopes = part.nodes(kernel, steps[active], unit / steps[active], length + 1)
        state[:, active] = states[:, -1]
        in_run = done[active] + np.arange(length)[:, None] < nodes[active]
        finite[active] = (np.isfinite(states[:, 1:]).all(0) | ~in_run).all(0)
        value, slope = surface.with_slope(states, slopes * unit, part.constants[:, None])
        f0, s0, f1, s1 = ends = np.array([value[:-1], slope[:-1], value[1:], slope[1:]])
        point, node = np.nonzero((in_run & ((f0 * f1 <= 0) | ((f0 * s0 <= 0) & (f1 * s1 >= 0)))).T)
        motions = replace(part.subset(point), state=states[:, node, point])
        at = partial(_at, surface, kernel, motions, steps[active[point]], unit[point])
        place, share = _zeros(at, ends[:, node, point], surface.direction)
        state_there, slopes, left, slope = at(place, share)
        step, constants, point = -left / slope, motions.constants[:, place], point[place]
        state_there, passed = state_there + slopes * step, done[active[point]] + node[place] + share + step
        # `largest` is the surface function's derivative if each state grows by a factor of its own. Equal factors turn no unit vector.
        _, largest = surface.with_slope(state_there, state_there * shares, constants)
        stays = np.fmax.reduce(np.abs(value))[point] <= STAYS * np.abs(largest)
        counted = surface.contains(state_there, constants) & ~stays & (passed > START)
        values = quantities(surface.system, names, state_there, constants)
        quantity = [np.broadcast_to(np.real(each.value(values)), point.shape) for each in kept]
        rows, point = np.array([*quantity, passed * unit[point]])[:, counted], point[counted]
        number = have[active[point]] + np.arange(point.size) - np.searchsorted(point, point)
        fits = number < count
        table[:, active[point[fits]], number[fits]] = rows[:, fits]
        have[active] += np.bincount(point, minlength=active.size)
        done[active] += length
        active = active[finite[active] & (done[active] < nodes[active]) & (have[active] < count)]
    return table, np.minimum(have, count), finite


def _at(
    surface: Surface, kernel: ModuleType, motions: Ensemble, steps: Counts, spacing: Array, place: Counts, share: Array
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Return the state and the surface's function, each with its derivative by `share`, at the fraction `share` between two nodes."""
    part, steps, unit = motions.subset(place), steps[place], spacing[place]
    states, slopes = part.nodes(kernel, steps, np.maximum(share, 1e-15) * unit / steps, 2)
    state, slopes = states[:, 1], slopes[:, 1] * unit
    return state, slopes, *surface.with_slope(state, slopes, part.constants)


def _zeros(
    at: Callable[[Counts, Array], tuple[Array, Array, Array, Array]], ends: Array, direction: int
) -> tuple[Counts, Array]:
    """Return in order, for each zero that a function passes in `direction`, the interval and the fraction of the interval before the zero.

    `ends` are values and slopes at both ends of the intervals. An interval is cut where a cubic with these values and slopes
    nearly touches 0, else where the cubic crosses 0. The pieces are cut likewise, until Newton's step from a crossing is short.
    """
    f0, s0, f1, s1 = ends
    size, zeros = np.maximum(np.abs(f0), np.abs(f1)), [np.empty((2, 0))]
    pieces = np.array([np.arange(f0.size), 0 * f0, f0, s0, 0 * f0 + 1, f1, s1])
    for attempt in range(ATTEMPTS):
        _, low, f0, s0, high, f1, s1 = pieces
        extremum, touches, zero = _extremum_and_zero(f0, s0 * (high - low), f1, s1 * (high - low))
        touches &= attempt < SPLITS
        crosses = ~touches & (f0 * f1 <= 0) & (f0 != 0) & (np.sign(f0) != direction)
        share = low + np.where(touches, extremum, 0.5 if attempt % 6 == 5 else zero) * (high - low)
        next_ones = touches | crosses
        pieces, share, crosses = pieces[:, next_ones], share[next_ones], crosses[next_ones]
        if not share.size:
            break
        place = pieces[0].astype(np.int64)
        *_, value, slope = at(place, share)
        change = -value / slope
        margin = np.minimum(share - pieces[1], pieces[4] - share)
        found = crosses & (np.abs(change) <= np.maximum(LAST_STEP, LAST_SHARE * margin))
        is_zero = found & (np.abs(value) <= size[place])  # |value| is large at poles, where signs change too
        zeros.append(np.array([place, share + change])[:, is_zero])
        halves = np.array([pieces, pieces])
        halves[0, 4:] = halves[1, 1:4] = share, value, slope
        pieces = np.concatenate([*halves[:, :, ~found]], axis=1)
    every = np.concatenate(zeros, axis=1)
    place, share = every[:, np.lexsort(every[::-1])]
    return place.astype(np.int64), share


def _extremum_and_zero(f0: Array, s0: Array, f1: Array, s1: Array) -> tuple[Array, Mask, Array]:
    """For cubics on [0, 1], return the place of the extremum of least |value|, whether to cut [0, 1] there, and an approximate zero."""
    a, b = 2 * (f0 - f1) + s0 + s1, 3 * (f1 - f0) - 2 * s0 - s1
    root = -b - np.copysign(np.sqrt(b * b - 3 * a * s0), b)
    x = np.array([root / (3 * a), s0 / root])
    x = np.sort(np.where((x > 0) & (x < 1), x, 1.0), axis=0)
    height = np.where(x < 1, f0 + x * (s0 + x * (b + x * a)), f1)
    depth = np.abs(height) / (16 * (x * (1 - x)) ** 2 * np.maximum(np.abs(f0), np.abs(f1)))
    depth = np.where(x < 1, depth, np.inf)
    signs = np.sign([f0, *height, f1])
    decides = (depth.min(0) < TOUCHING) | ((signs[1:] != signs[:-1]).sum(0) > 1)
    # The inverse interpolation is a cubic x(f). At the ends x(f) has the values and slopes of the inverse function of the cubic f(x).
    t, rise = f0 / (f0 - f1), f1 - f0
    zero = t * t * (3 - 2 * t) + t * (1 - t) * ((1 - t) * rise / s0 - t * rise / s1)
    zero = np.where((zero > 0) & (zero < 1), zero, 0.5)
    return np.take_along_axis(x, depth.argmin(0)[None], 0)[0], decides, zero
