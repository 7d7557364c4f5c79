"""Start points for curves of degenerate critical points. The points solve a secular equation, or are found near equilibria."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...analysis.tracer import contours
from ...flags import Completeness, Flag
from ...systems.base import Array, Points
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.secular import SecularEquation
from .continuation import Curve, Segments, curves, with_turns, with_zeros
from .singular import BorderKind, Degenerate, Potential

# `_LINES` inner lines along each axis, and lines near the sides of the box, have `_SAMPLES` samples each. Lines on which a component
# of the potential's linear term c is 0 are traced on a grid of `_CONTOUR`^2 points.
_LINES, _SAMPLES, _CONTOUR = 3, 121, 81
_ZERO = 1e-20  # replaces zeros of c, because a fold with c_i = 0 is the limit of folds with small c_i
_ON_SPHERE = 8  # steps of Newton's method to the nearest point of a curve
_ANY = np.array([0.31, 0.55, 0.77])  # an arbitrary direction
CELLS = 13  # cells of the coarse grid along each axis; odd, because bodies in the middle are often symmetric
_RIM = 0.004  # distance of lines from the sides of the box, because bodies on the sides are often symmetric
# One more grid line is at this distance from the middle of an axis. Without this line, changes of counts across mirrored curves cancel.
_BESIDE_MIDDLE = 5e-4
REACH = 2.0  # Curves are sought from an equilibrium up to this distance, in cells.
# If curves do not explain the counts of equilibria at two nodes, `_BETWEEN` points between the nodes are tried in up to `_SEARCHES` rounds.
_SEARCHES, _BETWEEN, _DIVISIONS = 2, 8, 4  # `_DIVISIONS` chords replace a curve segment.


class Cell(Flag):
    """Whether curves explain how the numbers of equilibria differ between the corners of a cell of the coarse grid."""

    COUNTED = (
        0,
        "the numbers of equilibria, and with limits of stability of stable ones, at its corners differ as the curves between them say",
    )
    NOT_CERTAIN = 1, "the number of equilibria at a corner is not certain, or they are not isolated"
    UNEXPLAINED = (
        2,
        "the numbers at its corners differ otherwise, or a curve is lost in it: not all are known",
    )


def on_sphere(potential: Potential) -> Degenerate:
    """Return points of all curves in the box, for x on a sphere or circle.

    For the potential x.diag(d) x / 2 + b.x, a multiplier L with F(L) = sum b_i^2 / (d_i - L)^2 = 1 gives the solution x = -b / (d - L).
    At a fold the minimum of F between two poles with b_i != 0 is 1. If a parameter moves only one component of b, or scales d, each
    curve of folds leaves the box or meets a line b_i = 0. If b_i = 0 in the whole box, the other terms of F(d_i) sum to 1 at a pitchfork.
    """
    n, sides, steps = potential.size, np.linspace(0, 1, _SAMPLES), np.linspace(0, 1, _CONTOUR)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1)
    everywhere = potential.at(grid.reshape(-1, 2))[0, 1].reshape(*grid.shape[:2], n)
    absent = np.flatnonzero(~everywhere.any((0, 1)))
    across = [0.0, _RIM, *(np.arange(_LINES) + 0.38) / _LINES, 1 - _RIM, 1.0]
    lines = [(np.stack([np.full(_SAMPLES, at), sides][::way], -1), -1) for at in across for way in (1, -1)]
    for i in set(range(n)) - set(absent.tolist()):
        lines += [(line / (_CONTOUR - 1), i) for line in contours(everywhere[..., i], 0.0)]
    owner = np.repeat(np.arange(len(lines)), [len(line) for line, _ in lines])
    position, zero = np.concatenate([line for line, _ in lines]), np.array([i for _, i in lines])[owner]

    def levels(position: Array, zero: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
        """Return log F(L), L, d and b of `on_sphere`. A row of L has minima of F between two poles, or poles d_i if b_i is always 0."""
        d, b = np.moveaxis(potential.at(position)[0], -1, 1)
        b = np.where((zero == np.arange(n)[:, None]) | (np.abs(b) < _ZERO), _ZERO, b)
        b[absent] = 0.0
        equation = SecularEquation(d, b)
        gaps = [(low, high - low, equation.minimum(low, high)) for low, high in pairwise(equation.poles)]
        F = [np.where(width > 0, equation.sum(shift, low), np.inf) for low, width, shift in gaps]
        F += [equation.sum(0 * d[i], d[i]) for i in absent]
        return np.log(F), np.array([*(low + shift for low, _, shift in gaps), *d[absent]]), d, b

    with np.errstate(all="ignore"):
        level, *_ = levels(position, zero)
        which, k = np.nonzero((level[:, :-1] * level[:, 1:] <= 0) & (owner[:-1] == owner[1:]))
        share = level[which, k] / (level[which, k] - level[which, k + 1])
        position, zero = position[k] + share[:, None] * (position[k + 1] - position[k]), zero[k]
        _, L, d, b = levels(position, zero)
        L, forks = L[which, range(k.size)], which >= n - 1
        x = np.where(b == 0, 0.0, -b / (d - L))
        v = np.where(b == 0, 0.0, x / (d - L))
        v[:, forks] = np.eye(n)[:, absent[which[forks] - (n - 1)]]
        x, v = (each / np.sqrt((each**2).sum(0)) for each in (x, v))
        m = -np.where(forks, 0.0, ((d - L) * v * x).sum(0))
    unknowns = np.stack([*x, -L, *v, m, *position.T, 0 * L], -1)
    usable = np.isfinite(unknowns).all(1)
    kind = np.where(forks, BorderKind.PITCHFORK, BorderKind.FOLD).astype(np.int8)
    return Degenerate(potential, unknowns[usable], kind[usable]).nearest(_ON_SPHERE)[0]


def near_solutions(
    system: Gyrostat,
    potential: Potential,
    points: Callable[[Array], Points],
    positions: Array,
    reach: float,
    stability: bool,
) -> tuple[Degenerate, Degenerate, Array]:
    """Return start values for degenerate solutions, start values for limits of stability, and numbers of solutions.

    There are start values only where, to first order, a degenerate solution or a limit is within `reach` of a position. Those for
    degenerate solutions come from solutions or from attitudes near complex solutions. Row 0 of the numbers, (2, bodies), counts all
    solutions. Row 1 counts stable solutions. Numbers that are not certain are nan.
    """
    listed = system.equilibria_of_bodies(points(positions), stability=False, ordered=True)
    alpha = listed["alpha"] if "alpha" in listed else np.zeros_like(listed["gamma"])
    x, solves = potential.from_attitudes(alpha, listed["gamma"]), listed["index"] >= 0
    certain = [Completeness.COMPLETE] + [Completeness.NOT_ISOLATED] * (potential.axis >= 0)
    # If x has two components, x is in a plane that every circle of equilibria meets twice.
    weight = 1 + (listed["circle"] & (potential.size == 2))
    known = ~np.isnan(x[..., -1])
    if potential.mirrored:
        known &= x[..., :3] @ _ANY > 0
    row, place = np.nonzero(known)
    near = Degenerate.near(potential, x[row, place], positions[row], solves[row, place], reach)
    row, place = np.nonzero(known & solves)
    weight, limits, stable = (
        weight[row, place] * (1 + potential.mirrored),
        potential.none(),
        np.zeros(row.size, bool),
    )
    if stability:
        limits = Degenerate.near_limits(potential, x[row, place], positions[row], reach)
        coefficients, _ = potential.characteristic(x[row, place], positions[row])
        stable = np.asarray((potential.stability_margins(coefficients) > 0).all(1))
    numbers = np.array([np.bincount(row, weight * chosen, len(positions)) for chosen in (1, stable)])
    numbers[:, ~np.isin(listed["completeness"], certain)] = np.nan
    return near, limits, numbers


def all_curves(
    system: Gyrostat, potential: Potential, points: Callable[[Array], Points], stability: bool
) -> tuple[list[Curve], Array, NDArray[np.int8]]:
    """Return curves of degenerate solutions over two parameters, the axis of a coarse grid, and a value of `Cell` for each grid cell.

    Limits of stability are found only with `stability`. The numbers of equilibria and of stable equilibria may differ between two
    neighbouring corners of the grid. If the curves do not explain a difference, more curves are sought from points between the corners.
    """
    axis, reach = _RIM + (1 - 2 * _RIM) * np.arange(CELLS + 1) / CELLS, REACH / CELLS
    nodes = np.insert(axis, CELLS // 2 + 1, 0.5 + _BESIDE_MIDDLE) if stability else axis
    i, j = np.divmod(np.arange(nodes.size**2), nodes.size)
    j = np.where(i % 2, nodes.size - 1 - j, j)  # The path is a serpentine: successive bodies are similar.
    numbers = np.empty((2, nodes.size, nodes.size))
    positions = nodes[np.stack([i, j], -1)]
    near, limits, numbers[:, i, j] = near_solutions(system, potential, points, positions, reach, stability)
    jumps = [np.diff(numbers, axis=along) for along in (1, 2)]
    seeds = near.settled(2 * reach) if potential.size >= 6 else on_sphere(potential)
    seeds = Degenerate.joined([seeds, limits.settled(2 * reach)])
    # Where one of these functions is 0 on a curve, the side with more solutions, or with more stable solutions, may change.
    tests: list[Callable[[Degenerate], Array]] = [
        lambda points: points.character()[1][1],
        lambda points: np.where(points.pitchfork, 1.0, points.character()[1][0]),
    ]
    if stability:
        tests += map(_margin, range(4))
        tests.append(_crossing)
    unsure = [np.isnan(each[0]) for each in jumps]
    searched = unsure
    for attempt in range(_SEARCHES + 1):
        lines = curves(*seeds.take(~seeds.limit).regular())
        if stability:
            # Curves of extremal momentum are sought near every second vertex of a curve and near pitchforks at which `stable_change` jumps.
            lines, ends = with_zeros(
                lines,
                lambda points: np.where(points.pitchfork, np.abs(points.stable_change() - 1.0) - 1.0, 1.0),
            )
            beside = [
                line.points.take(end | (np.arange(end.size) % 2 == 0)).extremal_momenta().settled(reach)
                for line, end in zip(lines, ends, strict=True)
                if potential.cyclic
            ]
            lines += curves(*Degenerate.joined([seeds.take(seeds.limit), *beside]).regular())
        for test in tests:
            lines, _ = with_zeros(lines, test)
        lines = with_turns(lines)
        expected = expected_differences(lines, nodes)
        differs = [f[: 1 + stability] != e[: 1 + stability] for f, e in zip(jumps, expected, strict=True)]
        wrong = [each.any(0) & ~nan for each, nan in zip(differs, unsure, strict=True)]
        fresh = [each & ~old for each, old in zip(wrong, searched, strict=True)]
        searched = [old | each for old, each in zip(searched, wrong, strict=True)]
        edges = [np.argwhere(each) for each in fresh]
        if attempt == _SEARCHES or not any(map(len, edges)):
            break
        share = (np.arange(_BETWEEN)[:, None] + 0.5) / _BETWEEN
        between = [
            nodes[each][:, None] + share * (nodes[each + side] - nodes[each])[:, None]
            for each, side in zip(edges, np.eye(2, dtype=int), strict=True)
        ]
        positions = np.concatenate(between).reshape(-1, 2)
        near, limits, _ = near_solutions(system, potential, points, positions, reach, stability)
        seeds = Degenerate.joined([seeds, near.settled(reach), limits.settled(reach)])
    corners = np.isin(nodes, axis)
    unknown = np.isnan(numbers[0])[np.ix_(corners, corners)]
    uncertain = unknown[1:, 1:] | unknown[1:, :-1] | unknown[:-1, 1:] | unknown[:-1, :-1]
    missed = wrong[0][:, 1:] | wrong[0][:, :-1] | wrong[1][1:] | wrong[1][:-1]
    for along in (0, 1):
        missed = np.logical_or.reduceat(missed, np.flatnonzero(corners)[:-1], along)
    for line in lines:
        if line.lost:
            missed[cells_of(line.points.parts[4][[0, -1]], axis)] = True
    cells = np.select([uncertain, missed], [Cell.NOT_CERTAIN, Cell.UNEXPLAINED], Cell.COUNTED)
    return lines, axis, cells.astype(np.int8)


def _margin(condition: int) -> Callable[[Degenerate], Array]:
    return lambda points: points.margins()[:, condition]


def _crossing(points: Degenerate) -> Array:
    """Return values that are 0 at a cusp of a limit of stability, and where two limits cross. The covector is 0 at such a crossing."""
    _, (bend, _), covector = points.character()
    return np.where(points.limit, bend * (covector @ _ANY[:2]), 1.0)


def cells_of(positions: Array, axis: Array) -> tuple[NDArray[np.int64], ...]:
    """Return the indices of the grid cells that contain the positions (N, 2). Positions outside the grid have the nearest cell."""
    return tuple(np.clip(np.searchsorted(axis, positions) - 1, 0, axis.size - 2).T)


def sides(parts: Segments) -> tuple[NDArray[np.int64], Array]:
    """Return how many eigenvalues stay negative across a segment, and how many more solutions are on the left than on the right.

    Row 0 of the differences, (2, segments), counts all solutions, and row 1 counts stable solutions.
    """
    middle = parts.cubic(np.full(parts.curve.size, 0.5))
    # Pitchforks are moved onto the curve. At points beside the curve, the wrong side may be found to have more solutions.
    fork = middle.pitchfork
    middle.unknowns[fork] = middle.take(fork).nearest(1)[0].unknowns
    index, _, covector = middle.character()
    chord = parts.end.parts[4] - parts.start.parts[4]
    (along, across) = (1.5 * chord - 0.25 * (parts.slopes[0] + parts.slopes[1])[:, -3:-1]).T
    sign = np.sign(covector[:, 1] * along - covector[:, 0] * across)
    stable = np.where((middle.margins() > 0).all(1), middle.stable_change(), 0)
    change = np.stack([np.where(middle.limit, 0, 2), stable])
    return index, (1 + middle.potential.mirrored) * sign * change


def expected_differences(lines: Sequence[Curve], axis: Array) -> tuple[Array, Array]:
    """Predict from curves how the numbers of all and of stable equilibria change between grid nodes. Return an array for each axis."""
    result = np.zeros((2, axis.size - 1, axis.size)), np.zeros((2, axis.size, axis.size - 1))
    if not lines:
        return result
    parts = Segments.of(lines)
    _, left = sides(parts)
    shares = np.arange(_DIVISIONS + 1) / _DIVISIONS
    for start, end in pairwise(parts.cubic(np.full(parts.curve.size, share)).parts[4] for share in shares):
        for along in (0, 1):  # axis along which the nodes are neighbours
            low, high = start[:, 1 - along], end[:, 1 - along]
            part, line = np.nonzero((low[:, None] > axis) != (high[:, None] > axis))
            share = (axis[line] - low[part]) / (high - low)[part]
            place = start[part, along] + share * (end - start)[part, along]
            interval = np.searchsorted(axis, place) - 1
            inside = (interval >= 0) & (interval < axis.size - 1)
            where = (interval, line) if along == 0 else (line, interval)
            change = np.sign(high - low)[part] * left[:, part] * (2 * along - 1)
            np.add.at(result[along], (slice(None), *(each[inside] for each in where)), change[:, inside])
    return result
