"""Crossings of a surface by motions that run side by side.

The kernel gives states at nodes, between which the function of the surface is nearly the cubic with its values and slopes there.
Where a cubic has several zeros, or nearly touches 0, its extremum becomes a node as well. Each zero is improved by Newton's method,
with runs of the kernel from the node before, so that it has the accuracy of the integration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ...kernel.ensemble import Ensemble
from ...kernel.stepsize import StepSizes
from ...scene.expressions import Expression
from ...systems.base import Array, Mask
from .surface import Surface, quantities

Counts = NDArray[np.int64]
NODE_RADIANS = 0.8  # largest distance of two nodes, in rad of the frequency bound
NODES, LONGEST = 2**15, 512  # of all motions in memory together, and of one
# A cubic nearly touches 0 where a middle extremum is below this share of its ends, and less near the ends, where it is as exact as
# they are. Of a motion twice as fast as the bound its error is a third of it.
TOUCHING, SPLITS = 0.2, 6
ATTEMPTS = 60
CONVERGED = 1e-7  # largest last step of Newton's method, in distances of nodes: its square is rounding
# A motion on which the function stays below this share of what its states could make of it stays on the surface.
STAYS = 1e-9
START = 1e-9  # a crossing so near to the start, in distances of nodes, is the start itself


@np.errstate(all="ignore")
def crossings(
    surface: Surface, kept: Sequence[Expression], kernel: ModuleType, ensemble: Ensemble, sizes: StepSizes,
    duration: Array, count: int,
) -> tuple[Array, Counts, Mask]:  # fmt: skip
    """Kept quantities and, last, times of at most `count` crossings, (rows, points, count); their numbers; finite motions."""
    table = np.full((len(kept) + 1, ensemble.size, count), np.nan)
    have, done = np.zeros((2, ensemble.size), np.int64)
    state, finite = ensemble.state.copy(), np.ones(ensemble.size, bool)
    radians = np.maximum(ensemble.frequency_bound * sizes.step_size, 1e-300)
    steps = np.clip(NODE_RADIANS / radians, 1, sizes.steps).astype(np.int64)
    nodes = np.ceil(duration / (sizes.step_size * steps)).astype(np.int64)
    spacing = duration / nodes
    names = {name for each in kept for name in each.names}
    active = np.arange(ensemble.size)
    while active.size:
        length = int(min(np.clip(NODES // active.size, 16, LONGEST), (nodes - done)[active].max()))
        part, unit = replace(ensemble, state=state).subset(active), spacing[active]
        step_sizes = np.broadcast_to(unit / steps[active], (length, active.size))
        threads = 0 if done.any() else None  # the first call may compile the kernel
        after = part.states_at_samples(kernel, steps[active], step_sizes, threads=threads)
        states = np.concatenate([part.state[:, None], after], axis=1)
        state[:, active] = after[:, -1]
        in_run = done[active] + np.arange(length)[:, None] < nodes[active]
        finite[active] = (np.isfinite(after).all(0) | ~in_run).all(0)
        value, slope, _ = surface.with_slope(states, part.constants[:, None])
        f0, s0, f1, s1 = ends = np.array([value[:-1], slope[:-1] * unit, value[1:], slope[1:] * unit])
        near = in_run & ((f0 * f1 <= 0) | ((f0 * s0 <= 0) & (f1 * s1 >= 0)))
        point, node = np.nonzero(near.T)
        at_nodes = replace(part.subset(point), state=states[:, node, point])
        intervals = _Intervals(surface, kernel, at_nodes, steps[active][point], unit[point])
        place, share, side, state_there = intervals.zeros(*ends[:, node, point])
        point, constants = point[place], at_nodes.constants[:, place]
        passed = done[active[point]] + node[place] + share
        stays = np.fmax.reduce(np.abs(value))[point] <= STAYS * surface.size(state_there, constants)
        counted = surface.contains(state_there, constants) & ~stays & (passed > START)
        counted &= (surface.direction == 0) | (side == -surface.direction)
        values = quantities(surface.system, names, state_there, constants)
        quantity = [np.broadcast_to(each.value(values), point.shape) for each in kept]
        rows, point = np.array([*quantity, passed * unit[point]])[:, counted], point[counted]
        number = have[active[point]] + np.arange(point.size) - np.searchsorted(point, point)
        fits = number < count
        table[:, active[point[fits]], number[fits]] = rows[:, fits]
        have[active] += np.bincount(point, minlength=active.size)
        done[active] += length
        active = active[finite[active] & (done[active] < nodes[active]) & (have[active] < count)]
    return table, np.minimum(have, count), finite


@dataclass(frozen=True)
class _Intervals:
    """Intervals between two nodes of motions, each an ensemble of its own."""

    surface: Surface
    kernel: ModuleType
    ensemble: Ensemble  # states at the first nodes
    steps: Counts
    spacing: Array

    def at(self, place: Counts, share: Array) -> tuple[Array, Array, Array, Array]:
        """State at shares of intervals, its slope by the share, and the function with its slope."""
        part, steps, unit = self.ensemble.subset(place), self.steps[place], self.spacing[place]
        state = part.final_states(self.kernel, steps, np.maximum(share, 1e-15) * unit / steps, threads=0)
        value, slope, slopes = self.surface.with_slope(state, part.constants)
        return state, slopes * unit, value, slope * unit

    def zeros(self, f0: Array, s0: Array, f1: Array, s1: Array) -> tuple[Counts, Array, Array, Array]:
        """Interval, share, sign before, and state of each zero, from values and slopes at the ends of the intervals.

        Pieces of intervals are cut where their cubics touch 0, or else cross it, until Newton's method has found the zero.
        """
        size, zeros = np.maximum(np.abs(f0), np.abs(f1)), [np.empty((3 + len(self.ensemble.state), 0))]
        pieces = np.array([np.arange(f0.size), 0 * f0, f0, s0, 0 * f0 + 1, f1, s1])
        for attempt in range(ATTEMPTS):
            _, low, f0, s0, high, f1, s1 = pieces
            side = np.sign(f0)
            extremum, touches, zero = _extremum_and_zero(f0, s0 * (high - low), f1, s1 * (high - low))
            touches &= attempt < SPLITS
            crosses = ~touches & (side * np.sign(f1) <= 0) & (side != 0)
            share = low + np.where(touches, extremum, 0.5 if attempt % 4 == 3 else zero) * (high - low)
            next_ones = touches | crosses
            pieces, share, side, crosses = (each[..., next_ones] for each in (pieces, share, side, crosses))
            if not share.size:
                break
            place = pieces[0].astype(np.int64)
            state, slopes, value, slope = self.at(place, share)
            change = -value / slope
            ends = crosses & (np.abs(change) <= CONVERGED)
            is_zero = ends & (np.abs(value) <= size[place])  # and no pole
            zeros.append(np.array([place, share + change, side, *(state + slopes * change)])[:, is_zero])
            halves = np.array([pieces, pieces])
            halves[0, 4:] = halves[1, 1:4] = share, value, slope
            pieces = np.concatenate([*halves[:, :, ~ends]], axis=1)
        every = np.concatenate(zeros, axis=1)
        every = every[:, np.lexsort(every[1::-1])]
        return every[0].astype(np.int64), every[1], every[2], every[3:]


def _extremum_and_zero(f0: Array, s0: Array, f1: Array, s1: Array) -> tuple[Array, Mask, Array]:
    """Of cubics by values and slopes at 0 and 1: the extremum next to 0, whether it decides on zeros, and about a zero."""
    a, b = 2 * (f0 - f1) + s0 + s1, 3 * (f1 - f0) - 2 * s0 - s1
    root = -b - np.copysign(np.sqrt(b * b - 3 * a * s0), b)
    x = np.array([root / (3 * a), s0 / root])
    x = np.sort(np.where((x > 0) & (x < 1), x, 1.0), axis=0)
    height = np.where(x < 1, f0 + x * (s0 + x * (b + x * a)), f1)
    depth = np.abs(height) / (16 * (x * (1 - x)) ** 2 * np.maximum(np.abs(f0), np.abs(f1)))
    depth = np.where(x < 1, depth, np.inf)
    signs = np.sign([f0, *height, f1])
    decides = (depth.min(0) < TOUCHING) | ((signs[1:] != signs[:-1]).sum(0) > 1)
    zero = np.zeros_like(f0)
    for digit in 0.5 ** np.arange(1, 25):
        at = zero + digit
        zero = np.where(f0 * (f0 + at * (s0 + at * (b + at * a))) > 0, at, zero)
    return np.take_along_axis(x, depth.argmin(0)[None], 0)[0], decides, zero
