"""Relative equilibria against a parameter: all of them at each value, joined to branches that meet at bifurcations.

Branches are not followed one by one: `equilibria_of_bodies` lists all solutions at each value, and those of neighbouring values
are joined where the tangents of both predict one another far better than any other solution. An interval in which a solution is
not joined so, or changes its index, is divided until each of its bifurcations follows from Newton's method on

    gradient of W = 0,    kappa = 0,    kappa the eigenvalue of the Hessian that is nearest to 0 at a solution.

Directions in which every solution may be turned (about the vertical where nothing acts along alpha, about an axis of symmetry of
the body) are left out: the projector onto them is added to the Hessian, and distances are those of what a turn leaves as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...flags import BifurcationKind, Completeness
from ..base import Array, Mask, Points
from .body import across, length
from .equilibria import frames_of, rotated

if TYPE_CHECKING:
    from .system import Gyrostat

Places = NDArray[np.int64]
# Solutions are joined if the sum of both errors of prediction is below the first, and below the second times that of any other.
_JOINED, _DISTINCT = 0.3, 0.25
_MAX_TURN = 0.5  # of a prediction and of a step of Newton's method, rad
_ROUNDS, _GOLDEN = 30, 0.618034  # divisions of an interval, at fractions that meet no special value
_DIFFERENCE = 1e-5  # step of central differences, in rad and in units of the ranges of the parameters
_ITERATIONS, _DAMPING = 15, 1e-7
_CONVERGED = 1e-9  # last step of Newton's method, in units of the range
_SETTLED = 1e-6  # the same with its rotation: from beside a pitchfork steps only halve
_BLOCK = 512  # intervals joined together
_CANDIDATES = 4  # solutions that may merge
_SAME = 1e-3  # distance of points that are one
# Relative sizes: of an eigenvalue at a solution that is degenerate, of the derivative along the null vector at a fold.
_DEGENERATE = _TRANSVERSAL = 1e-6


class Family(NamedTuple):
    """Bodies that depend on parameters."""

    system: Gyrostat
    points: Callable[[Array], Points]  # every parameter of bodies from the values (bodies, parameters)
    limits: Array  # lowest and highest values of the parameters, (2, parameters)
    upright: bool  # every solution may be turned about the vertical
    axis: int  # and about this axis of the body; -1: none

    @classmethod
    def of(cls, system: Gyrostat, points: Callable[[Array], Points], values: Array) -> Family:
        """The family on the range of some values, (bodies, parameters), with the symmetries that most of them have."""
        body = system.body_at_rest(points(values))
        symmetric = [i for i in range(3) if 2 * body.symmetric_about(i).sum() > len(values)]
        upright = 2 * body.acts_along(body.alpha).sum() < len(values)
        limits, axis = np.array([values.min(0), values.max(0)]), symmetric[0] if len(symmetric) == 1 else -1
        return cls(system, points, limits, bool(upright), axis)

    @property
    def span(self) -> Array:
        """Ranges of the parameters, their units."""
        return np.asarray(self.limits[1] - self.limits[0])

    def place(self, frames: Array) -> Array:
        """What no turn about a cyclic direction changes, (..., components)."""
        alpha, gamma, axis = frames[..., 0, :], frames[..., 2, :], frames[..., self.axis]
        if self.axis < 0:
            return gamma if self.upright else np.concatenate([alpha, gamma], -1)
        return np.stack([np.hypot(axis[..., 0], axis[..., 1]), axis[..., 2]], -1) if self.upright else axis

    def linear(
        self, values: Array, frames: Array, unit: Array | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Gradient and Hessian of W over their size, the latter plus the projector onto the cyclic directions; it, and the size."""
        body = self.system.body_at_rest(self.points(values))
        if unit is None:
            unit = body.steepness()
            unit = np.where(unit > 0, unit, 1.0)
        gradient, _ = body.gradient(frames[:, 0], frames[:, 2])
        hessian = body.hessian(frames[:, 0], frames[:, 2]) / unit[:, None, None]
        gamma, projector = frames[:, 2] * self.upright, np.zeros_like(hessian)
        axis = np.eye(3)[self.axis] * (self.axis >= 0)
        axis = axis - (gamma @ axis)[:, None] * gamma
        size = length(axis)[:, None]
        for d in (gamma, np.where(size > 1e-9, axis / np.where(size > 0, size, 1.0), 0.0)):
            projector += d[:, :, None] * d[:, None, :]
        return gradient / unit[:, None], hessian + projector, projector, unit

    def singular(
        self, values: Array, frames: Array, number: Places, varied: Mask
    ) -> tuple[Array, Array, Array, Array, Mask]:
        """Where eigenvalues of these numbers vanish: values, frames, null vectors, last steps of the values, which are folds.

        varied: the one parameter that changes from each start, (N, parameters).
        Steps are damped least squares: at a pitchfork the derivatives along the null vector vanish, as the equations do.
        """
        count, units = len(values), self.span * varied
        steps = _DIFFERENCE * np.concatenate([np.zeros((1, 4)), np.eye(4), -np.eye(4)])
        steps = np.broadcast_to(steps[:, None], (9, count, 4))
        for _ in range(_ITERATIONS):
            projector, unit = self.linear(values, frames)[2:]
            changed = (values + units * steps[..., 3:]).reshape(-1, values.shape[1])
            turned = rotated(frames, steps[..., :3]).reshape(-1, 3, 3)
            gradient, hessian, *_ = self.linear(changed, turned, np.tile(unit, 9))
            gradient = gradient.reshape(-1, count, 3) + np.einsum("nij,snj->sni", projector, steps[..., :3])
            eigenvalues, vectors = np.linalg.eigh(hessian)
            kappa = np.take_along_axis(eigenvalues.reshape(-1, count, 3), number[None, :, None], 2)
            residual = np.concatenate([gradient, kappa], -1)
            slopes = (residual[1:5] - residual[5:]) / (2 * _DIFFERENCE)
            left, sizes, right = np.linalg.svd(np.moveaxis(slopes, 0, -1), full_matrices=False)
            inverse = sizes / (sizes**2 + (_DAMPING * sizes[:, :1]) ** 2)
            step = -np.einsum("nji,nj,nkj,nk->ni", right, inverse, left, residual[0])
            step /= np.maximum(1.0, length(step) / _MAX_TURN)[:, None]
            frames = rotated(frames, step[:, :3])
            values = np.clip(values + units * step[:, 3:], *self.limits)  # beyond may be no body
        null, slope = vectors[np.arange(count), :, number], slopes[3, :, :3]
        across = np.abs((slope * null).sum(-1)) > _TRANSVERSAL * np.abs(slope).max(-1)
        error = np.where(length(step) < _SETTLED, np.abs(step[:, 3]), np.inf)
        return values, frames, null, error, across


class Nodes(NamedTuple):
    """All solutions at some values of the parameter, each body's in the first places."""

    values: Array  # (nodes,)
    frames: Array  # rows alpha, beta, gamma in body axes; nan where unused, (nodes, places, 3, 3)
    morse: NDArray[Any]  # Morse index, -1 where unused, (nodes, places)
    number: Places  # of the eigenvalue of the Hessian nearest to 0, (nodes, places)
    turn: Array  # rotation per unit of the parameter along the branch, (nodes, places, 3)
    usable: Mask  # all listed, none degenerate, and the sum of (-1)^index is right, (nodes,)


Solution = tuple[int, int]  # node and place


class Bifurcation(NamedTuple):
    """A point at which branches meet."""

    value: float
    frame: Array
    direction: Array  # rotation vector in body axes along which the solutions separate
    kind: BifurcationKind
    error: float  # of the value: last step of Newton's method, or half of an interval
    solutions: list[Solution]  # one of each branch


def solutions_at(family: Family, values: Array, given: bool = False) -> tuple[Nodes, dict[str, NDArray[Any]]]:
    """All solutions at some values, (nodes,), and what `equilibria_of_bodies` says of them; given: by the caller, in order."""
    listed, frames, (eigenvalues, vectors), unit = _listed(family, values[:, None], given)
    used, step = listed["index"] >= 0, _DIFFERENCE * family.span
    node, some = np.nonzero(used)[0], frames[used]
    below, above = (family.linear(values[node, None] + shift, some, unit)[0] for shift in (-step, step))
    index, number, turn = listed["index"].copy(), np.zeros(used.shape, int), np.zeros((*used.shape, 3))
    rates = np.einsum("nji,nj->ni", vectors, (below - above) / (2 * step)) * eigenvalues
    turn[used] = np.einsum("nij,nj->ni", vectors, rates / (eigenvalues**2 + _DAMPING**2))
    index[used], number[used] = (eigenvalues < 0).sum(1), np.abs(eigenvalues).argmin(1)
    potential = np.full(used.shape, np.nan)
    body = family.system.body_at_rest(family.points(values[node, None]))
    potential[used] = body.potential(some[:, 0], some[:, 2])
    allowed = [Completeness.COMPLETE, Completeness.NEAR_BIFURCATION]
    allowed += [Completeness.NOT_ISOLATED] if family.axis >= 0 else []
    usable = np.isin(listed["completeness"], allowed)
    usable[node[np.abs(eigenvalues).min(1) < _DEGENERATE]] = False
    if not (family.upright and family.axis >= 0):  # there circles count 0, and only poles are isolated
        characteristic = 2 if family.upright or family.axis >= 0 else 0
        usable &= np.where(used, (-1.0) ** index, 0.0).sum(1) == characteristic
    return Nodes(values, frames, index, number, turn, usable), {"potential": potential} | listed | {
        "index": index
    }


def _listed(family: Family, values: Array, given: bool) -> tuple[dict[str, NDArray[Any]], Array, Any, Array]:
    """All solutions at values (bodies, parameters) and their frames (bodies, places, 3, 3); of those in use, (N,), the
    eigenvalues and eigenvectors of the Hessian, and its size.
    """
    points = family.points(values)
    listed = family.system.equilibria_of_bodies(points, lambda: None, stability=given, ordered=given)
    gamma, used = listed["gamma"], listed["index"] >= 0
    alpha = listed["alpha"] if "alpha" in listed else across(gamma)[..., 0, :]
    frames = frames_of(alpha, gamma)
    _, hessian, _, unit = family.linear(values[np.nonzero(used)[0]], frames[used])
    return listed, frames, np.linalg.eigh(hessian), unit


def on_bifurcations(family: Family, low: Array, high: Array, reach: Array) -> Array:
    """Points at which solutions merge, exact but for rounding, between near bodies with different numbers of them.

    Newton's method starts from the solutions nearest to a bifurcation, _CANDIDATES of the body that has more; of its ends the
    nearest counts. low, high: parameters of both, one of which differs, (N, parameters). The middle where none is within reach, (N, parameters).
    """
    middle, values = 0.5 * (low + high), np.concatenate([low, high])
    listed, frames, (eigenvalues, _), _ = _listed(family, values, False)
    used = listed["index"] >= 0
    size, number = np.full(used.shape, np.inf), np.zeros(used.shape, int)
    size[used], number[used] = np.abs(eigenvalues).min(1), np.abs(eigenvalues).argmin(1)
    first, second = used.sum(1).reshape(2, -1)
    body = np.arange(len(low)) + len(low) * (second > first)
    place = np.argsort(size[body], axis=1)[:, :_CANDIDATES].ravel()
    body = np.repeat(body, _CANDIDATES)
    points, _, _, step, _ = family.singular(
        values[body], frames[body, place], number[body, place], np.repeat(low != high, _CANDIDATES, 0)
    )
    points = points.reshape(len(low), _CANDIDATES, -1)
    distance = length((points - middle[:, None]) / reach[:, None])
    distance = np.where(step.reshape(distance.shape) < _CONVERGED, distance, np.inf)
    nearest = np.take_along_axis(points, distance.argmin(1)[:, None, None], 1)[:, 0]
    return np.where((distance.min(1) < 1)[:, None], nearest, middle)


def prediction_errors(family: Family, nodes: Nodes, start: Places, end: Places) -> Array:
    """Distances of the solutions at some nodes, continued along their tangents, from those at others, (N, places, places)."""
    turn = nodes.turn[start] * (nodes.values[end] - nodes.values[start])[:, None, None]
    turn = turn / np.maximum(1.0, length(turn) / _MAX_TURN)[..., None]
    predicted = family.place(rotated(nodes.frames[start], turn))
    errors = length(predicted[:, :, None] - family.place(nodes.frames[end])[:, None])
    return np.where(np.isnan(errors), np.inf, errors)


def joined(family: Family, nodes: Nodes, low: Places, high: Places) -> Places:
    """Which solution at the upper ends of intervals follows each one at the lower ends, -1: none, (intervals, places)."""
    followers = []
    for first in range(0, low.size, _BLOCK):
        a, b = low[first : first + _BLOCK], high[first : first + _BLOCK]
        backward = np.swapaxes(prediction_errors(family, nodes, b, a), 1, 2)
        followers.append(clear_choices(prediction_errors(family, nodes, a, b) + backward))
    return np.concatenate(followers)


def clear_choices(errors: Array) -> Places:
    """Column of the least error in each row, (N, rows); -1 where it is not small or not far the least of row and column."""
    choice, row = errors.argmin(2), errors.argmin(1)
    least = errors.min(2)
    rivals = []
    for axis, chosen in ((2, choice[..., None]), (1, row[:, None])):
        others = errors.copy()
        np.put_along_axis(others, chosen, np.inf, axis)
        rivals.append(others.min(axis))
    rival = np.minimum(rivals[0], np.take_along_axis(rivals[1], choice, 1))
    clear = np.take_along_axis(row, choice, 1) == np.arange(errors.shape[1])
    return np.where(clear & (least < np.minimum(_JOINED, _DISTINCT * rival)), choice, -1)


class Interval(NamedTuple):
    """An interval between neighbouring nodes."""

    low: int
    high: int
    follower: Places  # place at the upper node of each solution at the lower one, -1: none
    ends: list[Solution]  # solutions at either node that do not go on
    changes: list[Solution]  # solutions at the lower node that go on with another index

    @classmethod
    def of(cls, nodes: Nodes, low: int, high: int, follower: Places) -> Interval:
        going = np.flatnonzero(follower >= 0)
        ends = [
            (node, place)
            for node, joined in ((low, going), (high, follower[going]))
            for place in np.setdiff1d(np.flatnonzero(nodes.morse[node] >= 0), joined).tolist()
        ]
        changed = going[nodes.morse[low, going] != nodes.morse[high, follower[going]]]
        return cls(low, high, follower, ends, [(low, place) for place in changed.tolist()])


def bifurcations(family: Family, nodes: Nodes, intervals: list[Interval]) -> list[list[Bifurcation] | None]:
    """The bifurcations in each of some intervals; None where they do not explain all ends and changes of index."""
    starts = [start for each in intervals for start in (*each.changes, *each.ends)]
    which = tuple(np.array(starts).reshape(-1, 2).T)
    values = nodes.values[which[0], None]
    varied = np.ones(values.shape, bool)
    singular = family.singular(values, nodes.frames[which], nodes.number[which], varied)
    rows = iter(zip(*singular, strict=True))
    result: list[list[Bifurcation] | None] = []
    for each in intervals:
        own = [*each.changes, *each.ends]
        places = family.place(np.array([nodes.frames[start] for start in own]))
        points: list[Bifurcation] = []
        for value, frame, null, step, is_fold in (next(rows) for _ in own):
            inside = nodes.values[each.low] < value[0] < nodes.values[each.high] and step < _CONVERGED
            place = family.place(frame)
            if inside and all(length(place - family.place(point.frame)) > _SAME for point in points):
                kind = BifurcationKind.FOLD if is_fold else BifurcationKind.EXCHANGE
                points.append(Bifurcation(float(value[0]), frame, null, kind, step * family.span[0], []))
        if not points:
            result.append(None)
            continue
        distances = length(places[:, None] - family.place(np.array([point.frame for point in points])))
        for start, nearest in zip(own, distances.argmin(1), strict=True):
            points[nearest].solutions.append(start)
        explained = bool((distances.min(1) < _JOINED).all())
        for i, point in enumerate(points):
            changes = [start for start in point.solutions if start in each.changes]
            ends = [start for start in point.solutions if start in each.ends]
            if point.kind == BifurcationKind.FOLD:
                explained &= not changes and len(ends) == 2 and ends[0][0] == ends[1][0]
            else:
                explained &= len(changes) >= 1 and len(ends) <= 2
                points[i] = point._replace(kind=BifurcationKind.PITCHFORK if ends else point.kind)
        result.append(points if explained else None)
    return result


class Branches(NamedTuple):
    """All branches over some values."""

    listed: dict[str, NDArray[Any]]  # at each value, as `equilibria_of_bodies`
    branch: Places  # number of the branch of each solution, -1: none, (values, places)
    points: list[Bifurcation]  # in the order of their values
    meeting: list[list[int]]  # branches that meet at each
    total: int  # of the branches, also of those that exist between two values alone


def follow(family: Family, values: Array, part: Places) -> Branches:
    """Branches of all solutions over increasing values, (values,); none goes on from one part of them to another."""
    nodes, listed = solutions_at(family, values, given=True)
    usable = np.flatnonzero(nodes.usable).tolist()
    pending = [(a, b) for a, b in pairwise(usable) if part[a] == part[b]]
    finished, points = [], []
    for attempt in range(_ROUNDS):
        if not pending:
            break
        low, high = np.array(pending).T
        follower = joined(family, nodes, low, high)
        going, used = follower >= 0, nodes.morse >= 0
        same = nodes.morse[low] == np.take_along_axis(nodes.morse[high], np.maximum(follower, 0), 1)
        clear = (going == used[low]).all(1) & (going.sum(1) == used[high].sum(1)) & (same | ~going).all(1)
        rows = list(zip(low.tolist(), high.tolist(), follower, strict=True))
        finished += [Interval(*rows[i], [], []) for i in np.flatnonzero(clear)]
        unclear = [Interval.of(nodes, *rows[i]) for i in np.flatnonzero(~clear)]
        pending, divided = [], []
        for each, inside in zip(
            unclear, bifurcations(family, nodes, unclear) if unclear else (), strict=True
        ):
            if inside is None and attempt < _ROUNDS - 1:
                divided.append((each.low, each.high))
                continue
            finished.append(each)
            a, b = nodes.values[[each.low, each.high]]
            starts, unknown = [*each.changes, *each.ends], np.full(3, np.nan)
            points += inside or [
                Bifurcation(
                    0.5 * (a + b),
                    nodes.frames[starts[0]],
                    unknown,
                    BifurcationKind.UNRESOLVED,
                    0.5 * (b - a),
                    starts,
                )
            ]
        if divided:
            fraction = 0.3 + 0.4 * (_GOLDEN * (attempt + 1) % 1)
            between = nodes.values[np.array(divided)] @ [1 - fraction, fraction]
            added = solutions_at(family, between)[0]
            for new, ((a, b), is_node) in enumerate(
                zip(divided, added.usable, strict=True), nodes.values.size
            ):
                pending += [(a, new), (new, b)] if is_node else [(a, b)]
            nodes = Nodes(*(np.concatenate(pair) for pair in zip(nodes, added, strict=True)))
    branch = numbered(family, nodes, finished, values.size)
    points.sort(key=lambda point: point.value)
    meeting = [sorted({int(branch[each]) for each in point.solutions}) for point in points]
    return Branches(listed, branch[: values.size], points, meeting, int(branch.max(initial=-1)) + 1)


def numbered(family: Family, nodes: Nodes, intervals: list[Interval], count: int) -> Places:
    """Number of the branch of each solution, -1: none; branches are in the order of their lowest values."""
    branch, total = np.full(nodes.morse.shape, -1), 0
    from_below = {each.high: each for each in intervals}
    order = np.flatnonzero(nodes.usable)[np.argsort(nodes.values[nodes.usable], kind="stable")]
    for node in order.tolist():
        if node in from_below:
            going = np.flatnonzero(from_below[node].follower >= 0)
            branch[node, from_below[node].follower[going]] = branch[from_below[node].low, going]
        new = np.flatnonzero((nodes.morse[node] >= 0) & (branch[node] < 0))
        branch[node, new] = total + np.arange(new.size)
        total += new.size
    # The values given that are no nodes, at bifurcations: solutions that the nodes on both sides predict.
    for value in np.flatnonzero(~nodes.usable[:count]):
        after = int(np.searchsorted(nodes.values[order], nodes.values[value]))
        if 0 < after < order.size and order[after] in from_below:
            for node in order[[after - 1, after]]:
                errors = prediction_errors(family, nodes, np.array([node]), np.array([value]))
                choice = clear_choices(2 * errors)[0]
                branch[value, choice[choice >= 0]] = branch[node, choice >= 0]
    return branch
