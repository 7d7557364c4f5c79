"""Branches of relative equilibria against a parameter, and the bifurcations at which branches meet.

Branches are not followed one by one. `equilibria_of_bodies` lists all solutions at each value of the parameter. Two solutions at
neighbouring values match if the tangent of each predicts the other. The sum of both prediction errors must be far smaller than if one of
the two solutions is paired with a third solution. An interval in which a solution has no match, or changes its index, is divided until
Newton's method finds each bifurcation in the interval. The equations are

    gradient of W = 0,    kappa = 0,

where W is the amended potential, and kappa is the eigenvalue of the Hessian of W that is nearest to 0. An interval is also divided
if two complex solutions at an end of the interval may become real inside. Newton's method then starts from their real part.

If nothing acts along the frame's axis alpha, solutions may be turned about the vertical. If the body has an axis of symmetry,
solutions may be turned about this axis. The projector onto these cyclic directions is added to the Hessian. Distances ignore such turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...flags import BifurcationKind, Completeness
from ...systems.base import Array, Mask, Points
from ...systems.gyrostat.body import length, transverse_axes
from ..equilibria.algebra import body_at_rest, frames_of, rotated

if TYPE_CHECKING:
    from ...systems.gyrostat.system import Gyrostat

Places = NDArray[np.int64]
# Two solutions match if the sum of their errors in predicting each other is below _CLOSE. The sum must also be below _DISTINCT times the
# corresponding sum of each pair that contains one of the two and a third solution.
_CLOSE, _DISTINCT = 0.3, 0.25
_MAX_TURN = 0.5  # largest turn by a prediction or by a step of Newton's method, rad
# Largest number of rounds in which intervals are divided. The golden ratio spreads the fractions at which an interval is divided.
_ROUNDS, _GOLDEN = 30, 0.618034
_DIFFERENCE = 1e-5  # step of central differences, in rad or in units of the ranges of the parameters
_ITERATIONS, _DAMPING = 15, 1e-7
_EXACT = 1e-13  # Newton's method stops when a step is shorter than this
_CONVERGED = 1e-9  # largest error of the parameter at a bifurcation, in units of the range of the parameter
_SETTLED = 1e-6  # largest last step of Newton's method, in rad or parameter ranges; near a pitchfork a step only halves the error
_BLOCK = 512  # number of intervals whose solutions are matched at once
_SAME = 1e-3  # bifurcations at a smaller distance in the coordinates of `BodyFamily.place` are the same
# A solution is degenerate if the scaled Hessian has an absolute eigenvalue below this. At a fold, a derivative of the gradient by a
# parameter has a component along the null vector that is larger than this fraction of the derivative.
_DEGENERATE = _TRANSVERSAL = 1e-6


class Singular(NamedTuple):
    """Points at which the Hessian of a solution has an eigenvalue 0, as found by Newton's method."""

    values: Array  # (N, parameters)
    frames: Array
    null: Array  # eigenvector of the Hessian for the eigenvalue 0, (N, 3)
    slopes: Array  # derivatives of W's gradient and of this eigenvalue by rotation and parameters, (N, 4, 3 + parameters)
    step: Array  # last step of Newton's method, (N, 3 + parameters)

    @property
    def error(self) -> Array:
        """Error of the parameters in units of their ranges, infinite where Newton's method does not converge."""
        return np.where(length(self.step) < _SETTLED, np.abs(self.step[:, 3:]).max(-1), np.inf)

    @property
    def is_fold(self) -> Mask:
        """Whether a change of the parameters lets solutions merge and vanish."""
        by_parameters = self.slopes[:, :3, 3:]
        along = np.abs(np.einsum("ni,nij->nj", self.null, by_parameters))
        rounding = 1e-3 * np.abs(self.slopes).max((1, 2))  # lower limit of `size`, above rounding errors
        size = np.maximum(np.abs(by_parameters).max(1), rounding[:, None])
        return np.asarray((along > _TRANSVERSAL * size).any(1))


class BodyFamily(NamedTuple):
    """Bodies that depend on parameters."""

    system: Gyrostat
    # This function returns all parameters of bodies for given values of the varied parameters, (bodies, varied parameters).
    points: Callable[[Array], Points]
    limits: Array  # lowest and highest values of the varied parameters, (2, varied parameters)
    upright: bool  # whether every solution may be turned about the vertical
    axis: int  # axis of the body about which every solution may be turned, -1 if there is none

    @classmethod
    def of(cls, system: Gyrostat, points: Callable[[Array], Points], values: Array) -> BodyFamily:
        """Return the family with the symmetries of most bodies. The limits are the extremes of `values`, (bodies, varied parameters)."""
        body = body_at_rest(system, points(values))
        symmetric = [i for i in range(3) if 2 * body.symmetric_about(i).sum() > len(values)]
        upright = 2 * body.acts_across().sum() < len(values)
        limits, axis = np.array([values.min(0), values.max(0)]), symmetric[0] if len(symmetric) == 1 else -1
        return cls(system, points, limits, bool(upright), axis)

    @property
    def span(self) -> Array:
        """Ranges of the parameters, which are used as their units."""
        return np.asarray(self.limits[1] - self.limits[0])

    def place(self, frames: Array) -> Array:
        """Return coordinates of attitudes, (..., components), that the symmetries of the bodies leave unchanged."""
        alpha, gamma, axis = frames[..., 0, :], frames[..., 2, :], frames[..., self.axis]
        if self.axis < 0:
            return gamma if self.upright else np.concatenate([alpha, gamma], -1)
        return np.stack([np.hypot(axis[..., 0], axis[..., 1]), axis[..., 2]], -1) if self.upright else axis

    def linear(self, values: Array, frames: Array) -> tuple[Array, Array, Array]:
        """Return the scaled gradient and Hessian of the potential, and a projector onto cyclic directions, which the Hessian includes."""
        body = body_at_rest(self.system, self.points(values))
        unit = body.steepness()
        unit = np.where(unit > 0, unit, 1.0)[:, None]
        gradient, _ = body.gradient(frames[:, 0], frames[:, 2])
        hessian = body.hessian(frames[:, 0], frames[:, 2]) / unit[..., None]
        gamma, projector = frames[:, 2] * self.upright, np.zeros_like(hessian)
        axis = np.eye(3)[self.axis] * (self.axis >= 0)
        axis = axis - (gamma @ axis)[:, None] * gamma
        size = length(axis)[:, None]
        for d in (gamma, np.where(size > 1e-9, axis / np.where(size > 0, size, 1.0), 0.0)):
            projector += d[:, :, None] * d[:, None, :]
        return gradient / unit, hessian + projector, projector

    def singular(self, values: Array, frames: Array) -> Singular:
        """Find points at which an eigenvalue of the Hessian is 0. The eigenvalue that is nearest to 0 at the given points is used.

        Steps solve damped least squares, because the Jacobian is singular at a pitchfork, where derivatives along the null vector vanish.
        """
        count, size = len(values), 3 + values.shape[1]
        steps = _DIFFERENCE * np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
        steps = np.broadcast_to(steps[:, None], (len(steps), count, size))
        for iteration in range(_ITERATIONS):
            changed = (values + self.span * steps[..., 3:]).reshape(-1, size - 3)
            gradient, hessian, projector = self.linear(
                changed, rotated(frames, steps[..., :3]).reshape(-1, 3, 3)
            )
            eigenvalues, vectors = np.linalg.eigh(hessian)
            if iteration == 0:
                number = np.abs(eigenvalues[:count]).argmin(1)
            kappa = np.take_along_axis(eigenvalues.reshape(len(steps), count, 3), number[None, :, None], 2)
            residual = np.concatenate([gradient.reshape(len(steps), count, 3), kappa], -1)
            slopes = np.moveaxis(residual[1 : size + 1] - residual[size + 1 :], 0, -1) / (2 * _DIFFERENCE)
            slopes[:, :3, :3] += projector[:count]
            left, sizes, right = np.linalg.svd(slopes, full_matrices=False)
            inverse = sizes / (sizes**2 + (_DAMPING * sizes[:, :1]) ** 2)
            step = -np.einsum("nji,nj,nkj,nk->ni", right, inverse, left, residual[0])
            step /= np.maximum(1.0, length(step) / _MAX_TURN)[:, None]
            frames = rotated(frames, step[:, :3])
            values = np.clip(values + self.span * step[:, 3:], *self.limits)  # no bodies beyond the limits
            if (length(step) < _EXACT).all():
                break
        return Singular(values, frames, vectors[np.arange(count), :, number], slopes, step)


class Nodes(NamedTuple):
    """All solutions at some values of the parameter."""

    values: Array  # values of the parameter, (nodes,)
    frames: Array  # rows alpha, beta, gamma in body axes, nan in unused places, (nodes, places, 3, 3)
    morse: NDArray[Any]  # Morse index, -1 in unused places and for complex solutions, (nodes, places)
    turn: Array  # rotation along the branch per unit of the parameter, (nodes, places, 3)
    distance: Array  # estimated change of the parameter, with sign, after which the solution may merge, (nodes, places)
    usable: Mask  # whether all solutions are listed and regular, and the sum of (-1)^index is the Euler characteristic, (nodes,)


Solution = tuple[int, int]  # index of a node, and place in the node's list of solutions


class Bifurcation(NamedTuple):
    """A point at which branches meet."""

    value: float
    frame: Array
    direction: Array  # axis, in body axes, of the rotation by which the solutions separate
    kind: BifurcationKind
    error: float  # error of the value, which is the last step of Newton's method or half of an interval
    solutions: list[Solution]  # one solution of each branch that meets here


def solutions_at(
    family: BodyFamily, values: Array, stability: bool = False
) -> tuple[Nodes, dict[str, NDArray[Any]]]:
    """Return all solutions at `values`, (nodes,), and the variables of `equilibria_of_bodies`, which include STABILITY if `stability`."""
    points = family.points(values[:, None])
    listed = family.system.equilibria_of_bodies(points, stability=stability, ordered=True)
    gamma, used = listed["gamma"], listed["index"] >= 0
    alpha = listed["alpha"] if "alpha" in listed else transverse_axes(gamma)[..., 0, :]
    frames, known = frames_of(alpha, gamma), ~np.isnan(gamma[..., 0])
    left, _, right = np.linalg.svd(frames[known & ~used])
    frames[known & ~used] = left @ right
    node, some, is_used = np.nonzero(known)[0], frames[known], used[known]
    index, turn, distance = listed["index"].copy(), np.zeros((*used.shape, 3)), np.full(used.shape, np.nan)
    step, own = _DIFFERENCE * family.span, values[node, None]
    gradient, hessian, _ = family.linear(own, some)
    eigenvalues, vectors = np.linalg.eigh(hessian)
    changes = (family.linear(own + step, some)[0] - gradient) / step
    slopes, rates = (np.einsum("nji,nj->ni", vectors, each) for each in (gradient, changes))
    turns = -np.einsum("nij,nj->ni", vectors, rates * eigenvalues / (eigenvalues**2 + _DAMPING**2))
    shifted = np.linalg.eigvalsh(family.linear(own + step, rotated(some, turns * step))[1])
    # If the parameter changes by -root, to first order an eigenvalue of a real solution becomes 0, or the solutions of a complex pair meet.
    with np.errstate(all="ignore"):
        roots = np.where(is_used[:, None], eigenvalues * step / (shifted - eigenvalues), slopes / rates)
    turn[known], nearest = turns, np.abs(eigenvalues).argmin(1)[:, None]
    distance[known] = -np.take_along_axis(roots, nearest, 1)[:, 0]
    index[used] = (eigenvalues[is_used] < 0).sum(1)
    potential = np.full(used.shape, np.nan)
    body = body_at_rest(family.system, family.points(values[node, None]))
    potential[known] = body.potential(some[:, 0], some[:, 2])
    allowed = [Completeness.COMPLETE] + [Completeness.NOT_ISOLATED] * (family.axis >= 0)
    usable = np.isin(listed["completeness"], allowed)
    usable[node[is_used & (np.abs(eigenvalues).min(1) < _DEGENERATE)]] = False
    # A family with both symmetries is not tested. To the sum below circles would add 0, and the two solutions with a vertical axis 1 each.
    if not (family.upright and family.axis >= 0):
        characteristic = 2 if family.upright or family.axis >= 0 else 0
        usable &= np.where(used, (-1.0) ** index, 0.0).sum(1) == characteristic
    listed = {"potential": potential, **listed, "index": index}
    return Nodes(values, frames, index, turn, distance, usable), listed


def prediction_errors(family: BodyFamily, nodes: Nodes, start: Places, end: Places) -> Array:
    """Continue solutions along tangents from nodes `start` to `end`. Return distances to the solutions at `end`, (N, places, places)."""
    turn = nodes.turn[start] * (nodes.values[end] - nodes.values[start])[:, None, None]
    turn = turn / np.maximum(1.0, length(turn) / _MAX_TURN)[..., None]
    predicted = family.place(rotated(nodes.frames[start], turn))
    errors = length(predicted[:, :, None] - family.place(nodes.frames[end])[:, None])
    real = (nodes.morse[start] >= 0)[:, :, None] & (nodes.morse[end] >= 0)[:, None]
    return np.where(real, errors, np.inf)


def match_solutions(family: BodyFamily, nodes: Nodes, low: Places, high: Places) -> Places:
    """Return for each solution at the lower end of an interval the place of its continuation at the upper end, or -1."""
    followers = []
    for first in range(0, low.size, _BLOCK):
        a, b = low[first : first + _BLOCK], high[first : first + _BLOCK]
        backward = np.swapaxes(prediction_errors(family, nodes, b, a), 1, 2)
        followers.append(unambiguous_matches(prediction_errors(family, nodes, a, b) + backward))
    return np.concatenate(followers)


def unambiguous_matches(errors: Array) -> Places:
    """Return the column of each row's least error, or -1 unless this error is small and far below all others in its row and column."""
    choice, least = errors.argmin(2), errors.min(2)
    in_row, in_column = (np.partition(errors, 1, axis).take(1, axis) for axis in (2, 1))
    rival = np.minimum(in_row, np.take_along_axis(in_column, choice, 1))
    return np.where(least < np.minimum(_CLOSE, _DISTINCT * rival), choice, -1)


def bifurcations_between(
    family: BodyFamily,
    nodes: Nodes,
    starts: list[Solution],
    kinds: list[Mask],
    singular: Singular,
    limits: Array,
) -> tuple[list[Bifurcation], bool]:
    """Return the bifurcations between two nodes, and whether they explain every branch that ends or changes its index there.

    `singular` is the result of Newton's method from `starts`. The masks `kinds` mark starts whose branch ends or whose index changes.
    """
    points: list[Bifurcation] = []
    values, places, (ends, changes) = singular.values[:, 0], family.place(singular.frames), kinds
    real, errors, is_fold = ends | changes, singular.error, singular.is_fold
    inside = (values > limits[0]) & (values < limits[1]) & (errors < _CONVERGED)
    for i in np.flatnonzero(inside).tolist():
        if all(length(places[i] - family.place(point.frame)) > _SAME for point in points):
            kind = BifurcationKind.FOLD if is_fold[i] else BifurcationKind.EXCHANGE
            error = float(errors[i] * family.span[0])
            points.append(
                Bifurcation(float(values[i]), singular.frames[i], singular.null[i], kind, error, [])
            )
    if not points:
        return points, not real.any()
    own = family.place(np.array([nodes.frames[start] for start in starts]))
    distances = length(own[:, None] - family.place(np.array([point.frame for point in points])))
    nearest, result = np.where(real, distances.argmin(1), -1), []
    is_explained = bool((distances.min(1) < _CLOSE)[real].all())
    for i, point in enumerate(points):
        meeting = np.flatnonzero(nearest == i).tolist()
        merging, sides = ends[meeting].sum(), {starts[j][0] for j in meeting if ends[j]}
        if point.kind == BifurcationKind.FOLD:
            is_explained &= len(meeting) == merging == 2 and len(sides) == 1
        elif meeting:
            is_explained &= merging < len(meeting) and merging <= 2
            point = point._replace(kind=BifurcationKind.PITCHFORK if merging else point.kind)
        else:  # Here no branch ends or changes its index. Another bifurcation must then be at the same value of the parameter.
            met = [points[j].value for j in set(nearest[real]) if points[j].kind != BifurcationKind.FOLD]
            is_explained &= any(abs(value - point.value) < _SETTLED * family.span[0] for value in met)
        if meeting:
            result.append(point._replace(solutions=[starts[j] for j in meeting]))
    return result, is_explained


class Branches(NamedTuple):
    """All branches of solutions over some values of the parameter."""

    listed: dict[str, NDArray[Any]]  # variables of `equilibria_of_bodies` at each value
    branch: Places  # number of the branch of each solution, -1 if there is none, (values, places)
    points: list[Bifurcation]  # bifurcations in the order of their values
    meeting: list[list[int]]  # numbers of the branches that meet at each point
    total: int  # number of all branches, including branches that have no solution at any given value


def follow(family: BodyFamily, values: Array, part: Places, stability: bool = False) -> Branches:
    """Return the branches of all solutions over increasing `values`. No branch joins values whose numbers in `part` differ."""
    nodes, listed = solutions_at(family, values, stability)
    usable = np.flatnonzero(nodes.usable)
    pending = np.stack([usable[:-1], usable[1:]], 1)
    pending = pending[part[pending[:, 0]] == part[pending[:, 1]]]
    intervals, links, points = [pending[:0]], [np.zeros((0, 2, 2), int)], []
    for attempt in range(_ROUNDS):
        if not len(pending):
            break
        limits, follower = nodes.values[pending], match_solutions(family, nodes, *pending.T)
        interval, place = np.nonzero(follower >= 0)
        joins, ends = links_of(pending, follower), nodes.morse[pending] >= 0
        ends[interval, 0, place] = ends[interval, 1, joins[:, 1, 1]] = False
        changes, (before, after) = np.zeros_like(ends), nodes.morse[(*np.moveaxis(joins, -1, 0),)].T
        changes[interval, 0, place] = before != after
        ahead = nodes.distance[pending] * [[1], [-1]]
        near = (ahead > 0) & (ahead < np.diff(limits)[..., None])
        which, side, place = np.nonzero(ends | changes | near)
        node = pending[which, side]
        singular = family.singular(nodes.values[node, None], nodes.frames[node, place])
        done = np.ones(len(pending), bool)
        for i in np.unique(which):
            own = np.flatnonzero(which == i)
            starts = list(zip(node[own].tolist(), place[own].tolist(), strict=True))
            kinds = [each[i, side[own], place[own]] for each in (ends, changes)]
            some = Singular._make(each[own] for each in singular)
            inside, done[i] = bifurcations_between(family, nodes, starts, kinds, some, limits[i])
            real = [start for start, *kind in zip(starts, *kinds, strict=True) if any(kind)]
            narrow = np.ptp(limits[i]) < _SETTLED * family.span[0] and not real
            if not done[i] and (attempt == _ROUNDS - 1 or narrow):
                done[i] = True
                where, frame = float(limits[i].mean()), nodes.frames[starts[0]]
                kind, error = BifurcationKind.UNRESOLVED, 0.5 * float(np.ptp(limits[i]))
                inside = [Bifurcation(where, frame, np.full(3, np.nan), kind, error, real)] if real else []
            points += inside if done[i] else []
        intervals.append(pending[done])
        links.append(joins[done[interval]])
        pending = pending[~done]
        if len(pending):
            fraction = 0.3 + 0.4 * (_GOLDEN * (attempt + 1) % 1)
            added, _ = solutions_at(family, nodes.values[pending] @ [1 - fraction, fraction])
            new = nodes.values.size + np.arange(len(pending))
            nodes = Nodes(*(np.concatenate(pair) for pair in zip(nodes, added, strict=True)))
            halves = np.concatenate([np.stack([pending[:, 0], new], 1), np.stack([new, pending[:, 1]], 1)])
            pending = np.concatenate([pending[~added.usable], halves[np.tile(added.usable, 2)]])
    # No interval ends at a given value that is a bifurcation. Solutions there are predicted from both ends of the interval around it.
    every, degenerate = np.concatenate(intervals), np.flatnonzero(~nodes.usable[: values.size])
    low, high = nodes.values[every].T
    which, i = np.nonzero((low < values[degenerate, None]) & (values[degenerate, None] < high))
    pairs = np.stack([every[i].ravel(), np.repeat(degenerate[which], 2)], 1)
    links.append(links_of(pairs, unambiguous_matches(2 * prediction_errors(family, nodes, *pairs.T))))
    branch, total = number_branches(nodes, np.concatenate(links))
    points.sort(key=lambda point: point.value)
    meeting = [sorted({int(branch[each]) for each in point.solutions}) for point in points]
    return Branches(listed, branch[: values.size], points, meeting, total)


def links_of(pairs: Places, follower: Places) -> Places:
    """Return node and place of each solution and of its follower, (links, 2, 2). `pairs` are pairs of nodes, (pairs, 2)."""
    pair, place = np.nonzero(follower >= 0)
    return np.stack([pairs[pair], np.stack([place, follower[pair, place]], 1)], -1)


def number_branches(nodes: Nodes, links: Places) -> tuple[Places, int]:
    """Number branches by the lowest parameter on each. Return the branch of each solution (-1 if none) and the number of branches."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    shape = nodes.morse.shape
    first, second = np.ravel_multi_index(tuple(np.moveaxis(links, -1, 0)), shape).T
    graph = coo_array((np.ones(len(links)), (first, second)), shape=2 * (nodes.morse.size,))
    label = connected_components(graph, directed=False)[1]
    belongs = np.repeat(nodes.usable, shape[1])
    belongs[np.concatenate([first, second])] = True
    own = np.flatnonzero((nodes.morse.ravel() >= 0) & belongs)
    own = own[np.argsort(nodes.values[own // shape[1]], kind="stable")]
    _, where, inverse = np.unique(label[own], return_index=True, return_inverse=True)
    branch = np.full(nodes.morse.size, -1)
    branch[own] = np.argsort(np.argsort(where))[inverse]
    return branch.reshape(shape), where.size
