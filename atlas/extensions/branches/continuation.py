"""Curves of degenerate critical points by pseudo-arclength continuation from many points at once.

The curve through each point is followed to the next point, so that no part is followed twice. The parts are then joined. Lengths
are measured in the unknowns x, position and s (`Degenerate.place`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...systems.base import Array, Mask
from ...systems.gyrostat.body import length
from .singular import Degenerate

# Lengths of the first, the longest and the shortest step, and largest number of steps.
_FIRST, _LARGEST, _SMALLEST, _STEPS = 0.01, 0.06, 1e-7, 4000
# Only steps shorter than `_CROSSING` may pass a crossing of two curves. On limits of stability `_CROSSING_OF_LIMITS` counts instead.
_CROSSING, _CROSSING_OF_LIMITS = 1e-5, 0.05
_BEND = 0.15  # desired angle between the tangents at both ends of a step, rad
_SINGULAR = 1e8  # condition number above which the tangent is uncertain, because another curve crosses
_NONE = 1e-10  # a value counts as 0 below this fraction of the largest value
# The bracketed secant method ends after `_ILLINOIS` steps, or when each zero moves by less than the fraction `_NO_SHARE` of its segment.
_ILLINOIS, _NO_SHARE = 14, 1e-15
_ITERATIONS = 10  # number of iterations of least squares where the equations are singular
_MISSED = 3e-5  # if a vertex is within this distance of its prediction, the cubic that ends at the vertex errs by less than 1e-6
_ON_CURVE = 1e-6  # a point within this distance of a vertex counts as the vertex
_SETTLED = 1e-6  # largest allowed last step of Newton's method; the error is about the square of the step
# The next point is sought among the _NEIGHBOURS points nearest to a vertex. These points are chosen anew after the length _LOOK.
_NEIGHBOURS, _LOOK = 32, 0.2
_ASTRAY = 0.1  # a point is on another curve if its distance from the cubic exceeds this fraction of the chord
# Points are on different curves if the scalar product of their unit null vectors is below this. Such curves may be close to each other.
_SAME_VECTOR = 0.3
_BACK = 1e-6  # a curve turns back between two vertices with the parameter derivatives a and b if -a.b > _BACK (a.a + b.b)
# A limit of stability that extends over less than this fraction of the range of each parameter is dropped. A vertex of a limit is dropped
# if an end or another vertex is nearer than this. Near an end the equations of limits are nearly singular.
_SAME_END = 2e-5
_OBLIQUE = 0.3  # largest distance of the next point from the tangent, over its distance along the tangent


class Piece(NamedTuple):
    """Part of a curve between two ends. Each start point of the continuation has an end ahead and an end behind."""

    length: float
    first: int  # number of the first end; start point i has the end 2 i ahead and the end 2 i + 1 behind
    last: int  # number of the last end; -1 is a side of the box, and -2 means that the curve is lost
    mirrored: bool  # whether the piece ends at the mirror image of the start point to which `last` belongs
    unknowns: Array  # unknowns of the vertices, (vertices, unknowns)
    tangents: Array


class Curve(NamedTuple):
    """Vertices of a curve and unit tangents at the vertices. A closed curve ends where it begins."""

    points: Degenerate
    tangents: Array
    closed: bool
    lost: bool  # whether the curve ends inside the box

    def sound(self) -> Mask:
        """Whether each vertex is on the curve. A `flat` vertex is not, unless a neighbour is not `flat`."""
        flat = np.r_[True, self.points.flat(), True]
        return self.points.solves() & ~(flat[:-2] & flat[1:-1] & flat[2:])

    def runs(self, kept: Mask) -> list[Curve]:
        """Return the parts of the curve that have two or more successive vertices in `kept`."""
        if kept.all():
            return [self]
        cuts = np.flatnonzero(np.diff(kept)) + 1
        groups = [own for own in np.split(np.arange(kept.size), cuts) if kept[own[0]] and own.size > 1]
        return [Curve(self.points.take(own), self.tangents[own], False, self.lost) for own in groups]

    def inserted(self, after: NDArray[np.int64], points: Degenerate, tangents: Array) -> Curve:
        """Return the curve with one more vertex after each of the vertices `after`."""
        unknowns = np.insert(self.points.unknowns, after + 1, points.unknowns, 0)
        kind = np.full(len(unknowns), self.points.kind[0])
        every = np.insert(self.tangents, after + 1, tangents, 0)
        return self._replace(points=points._replace(unknowns=unknowns, kind=kind), tangents=every)


def curves(points: Degenerate, tangents: Array) -> list[Curve]:
    """Return the curves through `points` with these tangents."""
    kept = _apart(points, tangents)
    points, tangents = points.take(kept), tangents[kept]
    if not kept.size:
        return []
    pieces = list(_pieces(points, tangents, 2 * np.arange(kept.size)))
    reached = {piece.last for piece in pieces}
    others = np.array([end for end in 2 * np.arange(kept.size) + 1 if end not in reached], int)
    pieces += _pieces(points, tangents, others)
    of_end: dict[int, Piece] = {}
    for piece in sorted(pieces, key=lambda piece: piece.length):
        if piece.first not in of_end and piece.last not in of_end:
            of_end[piece.first] = piece
            if piece.last >= 0:
                of_end[piece.last] = piece
    return list(_joined(points, of_end))


def _apart(points: Degenerate, tangents: Array) -> NDArray[np.int64]:
    """Return the indices of points. Of points that are a short way apart along the same curve, only the first is kept."""
    count, place, along = len(tangents), points.place, _of_place(points, tangents)
    targets, _ = _with_images(points, tangents)
    near = _nearest(place, targets)
    ahead, across = _along_and_across(targets[near] - place[:, None], along)
    ahead = np.abs(ahead)
    same = (ahead < _FIRST) & (across < np.maximum(_BEND * ahead, _ON_CURVE) ** 2)
    same &= _alike(points, points, near)
    kept = np.ones(count, bool)
    for i, k in np.argwhere(same):
        if kept[i] and near[i, k] % count > i:
            kept[near[i, k] % count] = False
    return np.flatnonzero(kept)


def _alike(points: Degenerate, seeds: Degenerate, near: NDArray[np.int64]) -> Mask:
    """Whether seeds `near[i]` have the kind and null vector of point i. Limits have no null vector. Mirror images are numbered last."""
    count, signs = len(seeds.kind), seeds._replace(unknowns=seeds.potential.mirror()[None]).parts[2]
    vectors = np.concatenate([seeds.parts[2], signs * seeds.parts[2]])
    same = np.abs(np.einsum("nki,ni->nk", vectors[near], points.parts[2])) > _SAME_VECTOR
    return (seeds.kind[near % count] == points.kind[:, None]) & (same | points.limit[:, None])


def _along_and_across(gap: Array, along: Array) -> tuple[Array, Array]:
    """Return the components of vectors along unit tangents, and the squared lengths of the components normal to the tangents."""
    ahead = np.einsum("nki,ni->nk", gap, along)
    return ahead, (gap**2).sum(-1) - ahead**2


def _nearest(place: Array, targets: Array) -> NDArray[np.int64]:
    """Return for each place the indices of the nearest targets, at most _NEIGHBOURS of them."""
    distance = (targets**2).sum(1) - 2 * place @ targets.T
    return np.argpartition(distance, min(_NEIGHBOURS, len(targets)) - 1, axis=1)[:, :_NEIGHBOURS]


def _of_place(points: Degenerate, rows: Array) -> Array:
    """Return the components of the vectors `rows`, (N, unknowns), along the unknowns x, position and s."""
    return np.concatenate([rows[:, : points.potential.size], rows[:, -3:]], 1)


def _with_images(points: Degenerate, tangents: Array) -> tuple[Array, Array]:
    """Return the vectors `place` of points, and the tangents in the same components. Mirror images, if any, follow after all points."""
    place, along = points.place, _of_place(points, tangents)
    if not points.potential.mirrored:
        return place, along
    signs = _of_place(points, points.potential.mirror()[None])
    return np.concatenate([place, place * signs]), np.concatenate([along, along * signs])


def _in_unknowns(points: Degenerate, rows: Array) -> Array:
    """Return vectors (N, unknowns). `rows` are the components along the unknowns x, position and s, and all other components are 0."""
    n, result = points.potential.size, np.zeros((len(rows), points.unknowns.shape[1]))
    result[:, :n], result[:, -3:] = rows[:, :n], rows[:, n:]
    return result


def _pieces(seeds: Degenerate, seed_tangents: Array, ends: NDArray[np.int64]) -> Iterator[Piece]:
    """Yield the parts of curves that begin at `ends` of the seeds. Ends are numbered as in `Piece`."""
    targets, target_along = _with_images(seeds, seed_tangents)
    points = seeds.take(ends // 2)
    tangents = seed_tangents[ends // 2] * (1 - 2 * (ends % 2))[:, None]
    *_, orientation = points.corrected(_in_unknowns(points, _of_place(points, tangents)), 1)
    bend, step, active = np.zeros_like(tangents), np.full(ends.size, _FIRST), np.arange(ends.size)
    around, search_arc = (
        np.zeros((ends.size, min(_NEIGHBOURS, len(targets))), int),
        np.full(ends.size, -np.inf),
    )
    steps = [(active, points.unknowns.copy(), tangents.copy())]
    last, total, mirrored = np.full(ends.size, -2), np.zeros(ends.size), np.zeros(ends.size, bool)
    for _ in range(_STEPS):
        if not active.size:
            break
        now, t = points.take(active), tangents[active]
        along, place = _of_place(now, t), now.place
        with np.errstate(all="ignore"):  # distance to the side of the box along the tangent, for each axis
            gaps = np.maximum(np.where(along > 0, 1 - place, -place) / along, 0)[:, -3:-1]
        gaps[along[:, -3:-1] == 0] = np.inf
        side, arc = gaps.argmin(1), step[active]
        far = active[total[active] - search_arc[active] > _LOOK]
        around[far], search_arc[far] = _nearest(points.take(far).place, targets), total[far]
        near = around[active]
        ahead, across = _along_and_across(targets[near] - place[:, None], along)
        is_ahead = (ahead > _ON_CURVE) & (ahead < 1.5 * _LARGEST) & (across < (_OBLIQUE * ahead) ** 2)
        ahead = np.where(is_ahead & _alike(now, seeds, near), ahead, np.inf)
        choice = ahead.argmin(1)
        target, to_target = near[range(active.size), choice], ahead[range(active.size), choice]
        to_side = gaps.min(1)
        leaves = (to_side <= arc) & (to_side < to_target - _ON_CURVE)  # false if a target is on the boundary
        meets = (to_target <= 1.2 * arc) & ~leaves  # no step ends just before a target
        arc = np.where(leaves, to_side, np.where(meets, to_target, arc))
        start = now.moved(arc[:, None] * t + 0.5 * arc[:, None] ** 2 * bend[active])
        row = _in_unknowns(now, along)
        for i in (0, 1):
            own = leaves & (side == i)
            start.unknowns[own, i - 3] = np.where(along[own, i - 3] > 0, 1.0, 0.0)
            row[own] = np.eye(row.shape[1])[i - 3] * np.sign(along[own, i - 3])[:, None]
        new, error, ahead_t, sign = start.corrected(row, 2)
        new_along, moved = _of_place(now, ahead_t), new.place - place
        cosine = np.clip((new_along * along).sum(1), -1, 1)
        size = np.sqrt((moved**2).sum(1))
        with np.errstate(invalid="ignore"):
            accepted = (error < _SETTLED) & (cosine > np.cos(1.5 * _BEND)) & (size < 1.2 * arc + _ON_CURVE)
        accepted &= (new.excess < _ON_CURVE) & new.inside()
        accepted &= (sign == orientation[active]) | (
            arc < np.where(now.limit, _CROSSING_OF_LIMITS, _CROSSING)
        )
        first = ~bend[active].any(1)  # on the first step of a piece the prediction is of lower order
        missed = np.where(first, 0.0, length(new.place - start.place))
        accepted &= missed < 3 * _MISSED
        angle = np.arccos(cosine)
        hit = accepted & meets & (np.abs(new.place - targets[target]).max(1) < _ON_CURVE)
        hit &= _alike(new, seeds, target[:, None])[:, 0]
        chosen = active[accepted]
        points.unknowns[chosen], total[chosen] = new.unknowns[accepted], total[chosen] + size[accepted]
        bend[chosen] = (ahead_t - t)[accepted] / np.maximum(arc, _SMALLEST)[accepted, None]
        bend[chosen] -= (_of_place(now, bend[active])[accepted] * new_along[accepted]).sum(1)[
            :, None
        ] * ahead_t[accepted]
        tangents[chosen], orientation[chosen] = ahead_t[accepted], sign[accepted]
        growth = np.minimum(_BEND / np.maximum(angle, 1e-9), np.cbrt(_MISSED / np.maximum(missed, 1e-12)))
        growth = np.clip(growth, 0.5, 1.6)
        step[active] = np.where(
            accepted, np.minimum(np.where(leaves | meets, step[active], arc) * growth, _LARGEST), 0.5 * arc
        )
        steps.append((chosen, new.unknowns[accepted], ahead_t[accepted]))
        same_way = (new_along * target_along[target]).sum(1) > 0
        last[active[hit]] = (2 * (target % len(seeds.unknowns)) + same_way)[hit]
        mirrored[active[hit]] = target[hit] >= len(seeds.unknowns)
        last[active[accepted & leaves]] = -1
        active = active[~hit & ~(accepted & leaves) & (step[active] > _SMALLEST)]
    owner, unknowns, rows = (np.concatenate(each) for each in zip(*steps, strict=True))
    order = np.argsort(owner, kind="stable")
    cuts = np.cumsum(np.bincount(owner, minlength=ends.size))[:-1]
    for i, (vertices, own) in enumerate(
        zip(np.split(unknowns[order], cuts), np.split(rows[order], cuts), strict=True)
    ):
        yield Piece(float(total[i]), int(ends[i]), int(last[i]), bool(mirrored[i]), vertices, own)


def _joined(seeds: Degenerate, of_end: dict[int, Piece]) -> Iterator[Curve]:
    """Yield the curves that consist of pieces. `of_end` maps both ends of each piece to the piece."""
    flip, left = seeds.potential.mirror(), set(of_end)
    for seed in sorted({end // 2 for end in of_end}):
        if not left & {2 * seed, 2 * seed + 1}:
            continue
        ahead, end, lost = _walk(2 * seed, of_end, left, flip)
        closed = bool(ahead) and end == 2 * seed
        behind, _, also = ([], None, False) if closed else _walk(2 * seed + 1, of_end, left, flip)
        parts = [(y[::-1], -t[::-1]) for y, t in reversed(behind)] + ahead
        unknowns, tangents = (np.concatenate(each) for each in zip(*parts, strict=True))
        points = Degenerate(seeds.potential, unknowns, np.full(len(unknowns), seeds.kind[seed]))
        fresh = np.r_[True, np.abs(np.diff(points.place, axis=0)).max(1) > _ON_CURVE]
        points, tangents = points.take(fresh), tangents[fresh]
        v = points.parts[2]
        same = np.cumprod(np.r_[1.0, np.where((v[1:] * v[:-1]).sum(1) < 0, -1.0, 1.0)])
        for each in (points.unknowns, tangents):
            each[:, flip.size // 2 - 1 : -3] *= same[:, None]
        # Equilibria that all belong to one body, at one position in the box, do not count as a curve.
        if len(tangents) > 1 and np.ptp(points.parts[4], axis=0).max() > _ON_CURVE:
            yield Curve(points, tangents, closed, lost or also)


def _walk(
    begin: int, of_end: dict[int, Piece], left: set[int], flip: Array
) -> tuple[list[tuple[Array, Array]], int | None, bool]:
    """Return vertices and tangents of the pieces from `begin` on, the end at which they stop, and whether the curve is lost at this end."""
    signs, parts, end = np.ones(flip.size), [], begin
    while end in left:
        piece = of_end[end]
        left -= {piece.first, piece.last}
        forward = piece.first == end
        after = signs * flip if piece.mirrored else signs
        y, t = (each * (signs if forward else after) for each in (piece.unknowns, piece.tangents))
        parts.append((y, t) if forward else (y[::-1], -t[::-1]))
        signs = after
        if piece.last < 0 and forward:
            return parts, None, piece.last == -2
        end = (piece.last if forward else piece.first) ^ 1
    return parts, end, end != begin


class Segments(NamedTuple):
    """Parts of curves between two vertices."""

    curve: NDArray[np.int64]  # number of the curve
    vertex: NDArray[np.int64]  # number of the vertex at which the segment begins
    start: Degenerate
    end: Degenerate
    slopes: tuple[Array, Array]  # derivatives of the unknowns, at start and end, by a variable from 0 to 1

    @classmethod
    def of(cls, lines: Sequence[Curve], chosen: Sequence[Mask] | None = None) -> Segments:
        """Return the segments that begin at chosen vertices of each curve, by default at all vertices except the last."""
        chosen = chosen or [np.ones(len(line.tangents) - 1, bool) for line in lines]
        where = [np.flatnonzero(mask) for mask in chosen]
        number = np.repeat(np.arange(len(lines)), [k.size for k in where])
        start = Degenerate.joined([line.points.take(k) for line, k in zip(lines, where, strict=True)])
        end = Degenerate.joined([line.points.take(k + 1) for line, k in zip(lines, where, strict=True)])
        rows = [
            np.concatenate([line.tangents[k + i] for line, k in zip(lines, where, strict=True)])
            for i in (0, 1)
        ]
        size = arcs(start.place, end.place, *(_of_place(start, row) for row in rows))[:, None]
        return cls(number, np.concatenate(where), start, end, (size * rows[0], size * rows[1]))

    def cubic(self, share: Array) -> Degenerate:
        """Return points of cubics at the fractions `share` of the segments. A cubic has the end points and end tangents of a segment."""
        w, (first, last) = share[:, None], self.slopes
        unknowns = (1 + 2 * w) * (1 - w) ** 2 * self.start.unknowns + w * (1 - w) ** 2 * first
        return self.start._replace(
            unknowns=unknowns + w**2 * ((3 - 2 * w) * self.end.unknowns - (1 - w) * last)
        )

    def at(self, share: Array) -> tuple[Degenerate, Array]:
        """Return points and unit tangents at fractions `share` of the segments. Points are on curves, or on cubics if no curve is near."""
        guess, chord = self.cubic(share), self.end.place - self.start.place
        reach, directions = _ASTRAY * length(chord), self._directions(share)
        points, step, tangents, _ = guess.corrected(_in_unknowns(guess, chord), 3)
        with np.errstate(all="ignore"):  # Newton's method may diverge, and tangents fail at crossings
            near = (step < _SETTLED) & (length(points.place - guess.place) < reach)
            turn = _of_place(guess, tangents - directions)
        astray = np.flatnonzero(~(near & (length(turn) < _BEND)))
        if astray.size:
            others = guess.take(astray)
            beside, step = others.nearest(_ITERATIONS)
            near = (step < _SETTLED) & (length(beside.place - others.place) < reach[astray])
            points.unknowns[astray] = np.where(near[:, None], beside.unknowns, others.unknowns)
            tangents[astray] = directions[astray]
        return points, tangents

    def inserted(self, lines: Sequence[Curve], share: Array) -> list[Curve]:
        """Return the curves with one more vertex on each segment, at the fraction `share` of the segment."""
        points, tangents = self.at(share)
        uncertain = ~(points.condition(tangents) < _SINGULAR)
        tangents[uncertain] = self._directions(share)[uncertain]
        owns = [self.curve == i for i in range(len(lines))]
        return [
            line.inserted(self.vertex[own], points.take(own), tangents[own])
            for line, own in zip(lines, owns, strict=True)
        ]

    def _directions(self, share: Array) -> Array:
        """Return the unit tangents of the cubics at the fractions `share` of the segments."""
        w, (first, last) = share[:, None], self.slopes
        rows = 6 * w * (1 - w) * (self.end.unknowns - self.start.unknowns)
        rows += (1 - w) * (1 - 3 * w) * first + w * (3 * w - 2) * last
        return rows / length(_of_place(self.start, rows))[:, None]


def lengths(line: Curve) -> Array:
    """Return the length of a curve from its first vertex to each vertex, (vertices,)."""
    place, along = line.points.place, _of_place(line.points, line.tangents)
    return np.r_[0.0, np.cumsum(arcs(place[:-1], place[1:], along[:-1], along[1:]))]


def arcs(start: Array, end: Array, first: Array, last: Array) -> Array:
    """Return the lengths of arcs from `start` to `end` with the unit tangents `first` and `last`, each (N, components)."""
    bend = 0.5 * np.arccos(np.clip((first * last).sum(1), -1, 1))
    return length(end - start) / np.sinc(bend / np.pi)


def with_zeros(
    lines: Sequence[Curve], function: Callable[[Degenerate], Array]
) -> tuple[list[Curve], list[Mask]]:
    """Return the curves with vertices added where a function changes its sign, and masks of the vertices at which the function is 0."""
    if not lines:
        return [], []
    values = [function(line.points) for line in lines]
    values = [np.where(np.abs(each) < _NONE * np.abs(each).max(), 0.0, each) for each in values]
    parts = Segments.of(lines, [each[:-1] * each[1:] < 0 for each in values])
    at_low = np.concatenate([each[:-1][each[:-1] * each[1:] < 0] for each in values])
    at_high = np.concatenate([each[1:][each[:-1] * each[1:] < 0] for each in values])
    low, high = np.zeros(at_low.size), np.ones(at_low.size)
    share = 0.5 * (low + high)
    for iteration in range(_ILLINOIS if share.size else 0):
        before, share = share, high - at_high * (high - low) / (at_high - at_low)
        if iteration and (np.abs(share - before) < _NO_SHARE).all():
            break  # the first iteration never ends the loop, because the secant may give the initial `share` 0.5 by chance
        value = function(parts.at(share)[0])
        crossed = value * at_high < 0
        low, at_low = np.where(crossed, high, low), np.where(crossed, at_high, 0.5 * at_low)
        high, at_high = share, np.where(value == 0, 1e-300 * np.sign(at_high), value)
    where = [np.insert(each == 0, parts.vertex[parts.curve == i] + 1, True) for i, each in enumerate(values)]
    return parts.inserted(lines, share), where


def with_turns(lines: Sequence[Curve]) -> list[Curve]:
    """Return curves with a vertex wherever a limit of stability turns back. A turn at a pitchfork leads to the limit's mirror image."""
    if not lines:
        return []
    every = Segments.of(lines)
    first, last = (each[:, -3:-1] for each in every.slopes)
    # A segment from or to a cusp does not count as a turn, because `first` or `last` is 0 there.
    turns = (first * last).sum(1) < -_BACK * (first**2 + last**2).sum(1)
    turns &= every.start.limit
    chosen = np.split(turns, np.cumsum([len(line.tangents) - 1 for line in lines])[:-1])
    back = (first - last)[turns]
    parts = Segments.of(lines, chosen)
    chord = (parts.end.unknowns - parts.start.unknowns)[:, -3:-1]
    a, b, c = ((each * back).sum(1) for each in (first[turns], last[turns], chord))
    middle = 2 * a + b - 3 * c  # at `share` the derivative of the parameters is normal to `back`
    share = a / (middle + np.sqrt(middle**2 - 3 * a * (a + b - 2 * c)))
    return parts.inserted(lines, share)


def without_repeats(lines: Sequence[Curve]) -> list[Curve]:
    """Return the curves without limits of stability shorter than _SAME_END. On longer limits, vertices too close to others are left out."""
    result = []
    for line in lines:
        if line.points.limit[0]:
            if np.ptp(line.points.parts[4], axis=0).max() < _SAME_END:
                continue
            arc, tangents = lengths(line), line.tangents.copy()
            after, before = np.searchsorted(arc, [_SAME_END, arc[-1] - _SAME_END])
            tangents[[0, -1]] = tangents[[after - 1, before]]  # tangents at the ends are least certain
            kept = np.r_[True, np.diff(arc) > _SAME_END]
            kept[:after] = kept[before:] = False
            kept[[0, -1]] = True
            line = line._replace(points=line.points.take(kept), tangents=tangents[kept])
        result.append(line)
    return result
