"""Families of periodic motions from a steady motion to their end, and the bifurcations on the way.

With rho = mu + 1/mu of the pairs of multipliers, one is 1 where the product of 2 - rho vanishes, -1 where that of 2 + rho does, and
pairs meet where two rho are equal. The energy and the period have folds where their slopes along the family vanish. Where both
vanish at one orbit the family comes back on itself and has ended: at a steady motion, where the amplitude is 0, on an orbit that is
run through several times, y(T/k) = R y(0), or else on its own mirror image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import toms748

from ...flags import FamilyEnd, Flag, PeriodicEvent
from ...systems.base import Array
from .flow import SIZE
from .orbits import Family, Orbit

NODES, MOST_NODES = 5, 40
# Longest part between two nodes, in periods of the birth, and its largest expansion.
SEGMENT, EXPANSION = 0.3, 60.0
# Steps by arc length: the first ones, of which the slope at the birth is extrapolated, the longest, the shortest, and their number.
FIRST, BIRTHS, LONGEST, SHORTEST, MOST_STEPS = 0.01, 4, 0.15, 1e-6, 1500
# Largest change of the angles and of the logarithms of multipliers, and least cosine between tangents, in a step.
ANGLE, GROWTH, COSINE = 0.35, 1.5, 0.9
FAR = 0.35  # largest distance of an orbit from its guess, over the step
FAST = 12.0  # rates that grow without bound, in rates of the birth
SLOW = 1.5e-3  # least speed over the largest one at which a long period may be due to a steady motion
COMPLETE = 3.0  # periods of the birth up to which every step is halved in search of events
LATER = 3.0  # times so much may multipliers change in a step beyond
SAME = 0.02  # of a step: slopes that vanish together
SHARES = (0.1, 0.23, 0.36, 0.5, 0.64, 0.77, 0.9)  # of a step, where functions are fitted
TESTS = {
    "energy_slope": PeriodicEvent.FOLD, "period_slope": PeriodicEvent.PERIOD_FOLD, "plus": PeriodicEvent.BRANCH,
    "minus": PeriodicEvent.DOUBLING, "krein": PeriodicEvent.KREIN,
}  # fmt: skip


class Found(NamedTuple):
    """An event or an end."""

    kind: Flag
    period: float
    energy: float


@dataclass(frozen=True)
class Member:
    """An orbit of a family, with what decides on events and steps."""

    orbit: Orbit
    arc: float
    energy: float
    multipliers: Array
    angles: Array  # of the multipliers, and logarithms of their magnitudes, (2, pairs)
    tests: dict[str, float]  # functions that change their signs at events
    closing: float
    expansion: float  # of a segment

    def far_from(self, other: Member) -> float:
        """Change of the multipliers, 1 at the limit."""
        if self.angles.shape != other.angles.shape or not self.angles.size:
            return 0.0
        orders = ([0, 1], [1, 0]) if self.angles.shape[1] == 2 else ([0],)
        limits = np.array([[ANGLE], [GROWTH]])
        return float(min((np.abs(self.angles - other.angles[:, order]) / limits).max() for order in orders))


def member(family: Family, orbit: Orbit, arc: float) -> Member:
    """A member of an orbit, whose tangent points as the given one does."""
    orbit = replace(orbit, bound=family.flow.bound(orbit.states[0]))
    residual, jacobian, matrices = family.equations(orbit)
    orbit = family.with_tangent(orbit, jacobian)
    mu = family.multipliers(orbit, matrices)
    rho = mu[::2] + mu[1::2]
    half, size = np.arccos(rho / 2 + 0j), float(np.prod(np.maximum(1.0, np.abs(rho))))
    tests = {
        "energy_slope": float(family.energy_row(orbit) @ orbit.tangent),
        "period_slope": float(orbit.tangent[-2] * family.unit),
        "plus": float(np.prod(2 - rho).real / size), "minus": float(np.prod(2 + rho).real / size),
        "krein": float(((rho[0] - rho[-1]) ** 2).real / size) if rho.size > 1 else 1.0,
    }  # fmt: skip
    closing = float(np.abs(residual[: SIZE * len(orbit.states)]).max())
    angles, expansion = (
        np.array([half.real, np.abs(half.imag)]),
        np.linalg.norm(matrices, 2, axis=(1, 2)).max(),
    )
    return Member(orbit, arc, family.energy(orbit), mu, angles, tests, closing, float(expansion))


def motion_of(family: Family, orbit: Orbit) -> tuple[Array, float, float, float]:
    """The slowest state, the least and the largest speed up to turns about the axis, and the largest rate."""
    flow, states = family.flow, family.flow.nodes(orbit.states, orbit.period / len(orbit.states), orbit.bound)
    states = states.reshape(-1, states.shape[-1])[:: max(1, states.shape[0] * states.shape[1] // 400)]
    slopes, along = flow.slopes(states), flow.symmetry(states)
    slopes -= ((slopes * along).sum(1) / np.maximum((along * along).sum(1), 1e-12))[:, None] * along
    speed = np.linalg.norm(slopes, axis=1)
    return (
        states[np.argmin(speed)],
        float(speed.min()),
        float(speed.max()),
        float(np.abs(states[:, :3]).max()),
    )


class Path:
    """Members of a family in their order, and its end."""

    end: Found

    def __init__(self, family: Family) -> None:
        self.family = family
        self.birth = Member(
            family.born(NODES), 0.0, family.birth_energy, np.empty(0), np.empty((2, 0)), {}, 0.0, 1.0
        )
        self.members: list[Member] = []
        # From where the step to each of them began, with the same number of states.
        self.starts: list[Member] = []
        self.fastest = 0.0

    def follow(self, max_period: float) -> Path:
        """The path with its members up to a period in periods of the birth, and its end."""
        self.longest = max_period * self.family.unit
        self.end = self._follow()
        return self

    def beside(self, start: Member, step: float) -> tuple[Member, int, float] | None:
        """The member after a step along the tangent, Newton's steps, and the distance from the guess over the step; None if lost."""
        found = self.family.corrected(self.family.moved(start.orbit, step * start.orbit.tangent))
        if found is None:
            return None
        new = member(self.family, found[0], start.arc + step)
        return (new, found[1], found[2] / abs(step)) if np.isfinite(new.orbit.tangent).all() else None

    def _follow(self) -> Found:
        before, step, failures = self.birth, FIRST, 0
        while len(self.members) < MOST_STEPS and step > SHORTEST and failures < 40:
            weight = 1.0 if before.orbit.period < COMPLETE * self.family.unit else 1 / LATER
            found = self.beside(before, step)
            bad = found is None or found[1] > 7 or found[2] > FAR
            if found is None or bad or found[0].orbit.tangent @ before.orbit.tangent < COSINE:
                failures += 1
                # At a singular orbit shorter steps fail as well: a longer one may lead across it.
                step = step / 2 if failures % 5 else min(step * 40.0, LONGEST)
                continue
            new, count, distance = found
            change = weight * before.far_from(new)
            if change > 1.5:
                step /= 2
                continue
            self.members.append(new)
            self.starts.append(before)
            if end := self._ended():
                return end
            if len(self.members) >= BIRTHS and count < 5 and distance < 0.1 and change < 0.6:
                step = min(step * 1.5, LONGEST)
            m, failures = len(new.orbit.states), max(failures - 1, 0)
            long = new.expansion > EXPANSION or new.orbit.period > SEGMENT * m * self.family.unit
            if long and m < MOST_NODES:
                new = replace(new, orbit=self.family.meshed(new.orbit, min(-(-m * 3 // 2), MOST_NODES)))
            before = new
        if not self.members:
            return Found(FamilyEnd.LOST, self.birth.orbit.period, self.birth.energy)
        kind = FamilyEnd.STEP_LIMIT if len(self.members) == MOST_STEPS else FamilyEnd.LOST
        return self._at_steady_motion(1e-3) or self._left(kind)

    def _left(self, kind: Flag) -> Found:
        return Found(kind, self.members[-1].orbit.period, self.members[-1].energy)

    def _ended(self) -> Found | None:
        """The end of the family, if it is at the last member."""
        new, unit = self.members[-1], self.family.unit
        _, slowest, fastest, rate = motion_of(self.family, new.orbit)
        self.fastest = max(self.fastest, fastest)
        if rate > FAST * self.family.flow.rate:
            return self._left(FamilyEnd.UNBOUNDED)
        if len(self.members) > BIRTHS:
            before = self.members[-2].tests
            both = all(before[name] * new.tests[name] < 0 for name in ("energy_slope", "period_slope"))
            if both and (end := self._turned_back()):
                return end
        if new.orbit.period > self.longest:
            return self._at_steady_motion(1e-3) or self._left(FamilyEnd.PERIOD_LIMIT)
        long = slowest < SLOW * fastest and new.orbit.period > 1.5 * unit
        return self._at_steady_motion(1e-4) if long else None

    def _at_steady_motion(self, tolerance: float) -> Found | None:
        """The end at infinite period, if the slowest state is near a steady motion whose energy is the limit."""
        family, flow, new = self.family, self.family.flow, self.members[-1]
        state, slowest, fastest, _ = motion_of(family, new.orbit)
        y, q = state[None], new.orbit.chi / new.orbit.period
        for _ in range(20):
            sides = [
                np.concatenate([flow.moved(y, x[None]) for x in 1e-5 * sign * np.eye(SIZE)])
                for sign in (1, -1)
            ]
            ahead, behind, here = (flow.slopes(each) - q * flow.symmetry(each) for each in (*sides, y))
            matrix = np.zeros((SIZE + len(flow.held), SIZE + 1))
            matrix[:SIZE, :SIZE], matrix[:SIZE, SIZE] = (ahead - behind).T / 2e-5, -flow.symmetry(y)[0]
            matrix[SIZE:, :SIZE] = flow.gradients(flow.held, y[0])
            held = np.subtract([flow.value(name, y[0]) for name in flow.held], family.level)
            step = np.linalg.lstsq(matrix, -np.append(here[0], held), rcond=1e-10)[0]
            y, q = flow.moved(y, step[None, :SIZE]), q + step[SIZE]
            if np.abs(step).max() < 1e-11:
                break
        else:
            return None
        energy, energies = flow.value(flow.energy, y[0]), np.array([each.energy for each in self.members])
        near = np.abs(energy - energies[-1]) < tolerance * np.ptp(energies) and slowest < 0.2 * fastest
        near = near and np.ptp(energies[-3:]) < 0.01 * np.ptp(energies)
        return Found(FamilyEnd.ASYMPTOTIC, np.inf, energy) if near else None

    def _turned_back(self) -> Found | None:
        """The end on the last step, None where energy and period have folds beside each other."""
        start, new = self.starts[-1], self.members[-1]
        fits = self._fits(start, start, new)
        roots = [_roots(fits(_test(name))) for name in ("energy_slope", "period_slope")]
        gaps = np.abs(np.subtract.outer(*roots))
        if not gaps.size or gaps.min() > SAME:
            return None
        at = roots[0][np.argmin(gaps.min(1))]
        period, energy = (float(fits(value)(at)) for value in (_period, _energy))
        shifts = (at, at + 0.01, at - 0.01)
        found = (self.beside(start, share * (new.arc - start.arc)) for share in shifts)
        nearest = next((each[0] for each in found if each is not None), new).orbit
        return Found(self._kind_of_return(nearest), period, energy)

    def _kind_of_return(self, orbit: Orbit) -> Flag:
        """Where a family comes back on itself."""
        flow, first, m = self.family.flow, orbit.states[:1], len(orbit.states)
        if motion_of(self.family, orbit)[2] < 0.05 * self.fastest:
            return FamilyEnd.STEADY_MOTION
        others = np.concatenate(
            [flow.turned(y[None], -orbit.chi * i / m) for i, y in enumerate(orbit.states)]
        )
        size = np.linalg.norm(flow.difference(others, first), axis=1).max()
        for k in range(2, 9):
            later = flow.run(first, orbit.period / k, orbit.bound)[0]
            for j in range(k if flow.symmetric else 1):
                back = flow.turned(later, -(orbit.chi + 2 * np.pi * j) / k)
                # The difference vanishes at half a turn as well.
                near = (flow.vectors(back)[:, 1:] * flow.vectors(first)[:, 1:]).sum(-1).min() > 0
                if near and np.linalg.norm(flow.difference(back, first)) < 0.03 * size:
                    return FamilyEnd.MULTIPLE
        return FamilyEnd.MIRROR

    def _fits(self, start: Member, a: Member, b: Member) -> Callable[..., np.polynomial.Polynomial]:
        """Polynomials of functions of members between two of a step, over shares of their distance."""
        length = b.arc - a.arc
        found = [self.beside(start, a.arc + share * length - start.arc) for share in SHARES]
        samples = [a, *(each[0] for each in found if each is not None and each[2] < FAR), b]
        share = np.array([(each.arc - a.arc) / length for each in samples])
        degree = min(6, len(samples) - 2)
        return lambda value: np.polynomial.Polynomial.fit(
            share, [value(each) for each in samples], max(degree, 1)
        )

    def events(self) -> tuple[list[tuple[float, Found]], bool]:
        """Arc lengths and events in their order, and whether steps of half the length find no others."""
        result, complete = list[tuple[float, Found]](), True
        steps = list(zip(self.starts, self.members, strict=True))[1:]
        if self.end.kind in (FamilyEnd.STEADY_MOTION, FamilyEnd.MULTIPLE, FamilyEnd.MIRROR):
            steps.pop()
        for start, new in steps:
            pieces = [(start, new)]
            while pieces:
                a, b = pieces.pop()
                middle = None
                if b.orbit.period < COMPLETE * self.family.unit and b.arc - a.arc > 0.05 * (
                    new.arc - start.arc
                ):
                    middle = self.beside(start, 0.5 * (a.arc + b.arc) - start.arc)
                    complete &= middle is not None
                hidden = middle and any(
                    a.tests[n] * b.tests[n] > 0 > a.tests[n] * middle[0].tests[n] for n in TESTS
                )
                if middle and hidden:
                    pieces += [(middle[0], b), (a, middle[0])]
                else:
                    result += self._events_between(start, a, b)
        return sorted(result, key=lambda pair: pair[0]), complete

    def _events_between(self, start: Member, a: Member, b: Member) -> Iterator[tuple[float, Found]]:
        """Events between two members of a step, with their arc lengths."""
        fold = np.inf
        for name, kind in TESTS.items():
            if a.tests[name] * b.tests[name] < 0:
                at = self._root(start, a, b, _test(name))
                if isinstance(at, Member):
                    place, period, energy = at.arc, at.orbit.period, at.energy
                else:  # at a branch the equations are singular
                    fits = self._fits(start, a, b)
                    share = [*_roots(fits(_test(name))), 0.5][0]
                    place = a.arc + share * (b.arc - a.arc)
                    period, energy = (float(fits(value)(share)) for value in (_period, _energy))
                if name == "energy_slope":
                    fold = place
                # At a fold of the energy a multiplier is 1 as well.
                if name != "plus" or abs(place - fold) > 0.02 * (b.arc - a.arc):
                    yield place, Found(kind, period, energy)

    def _root(
        self, start: Member, a: Member, b: Member, function: Callable[[Member], float]
    ) -> Member | None:
        """The member between two of a step at which a function vanishes; None where the equations are singular there."""
        known = list[Member]()

        def value(arc: float) -> float:
            found = self.beside(start, arc - start.arc)
            if found is None or found[2] > 1.0:
                raise ArithmeticError
            known.append(found[0])
            return function(found[0])

        try:
            at = toms748(value, a.arc + 1e-9 * (b.arc - a.arc), b.arc, xtol=1e-9, maxiter=30)
        except (ArithmeticError, ValueError):
            return None
        return min(known, key=lambda each: abs(each.arc - at))

    def at_energy(self, value: float) -> list[Member]:
        """Every member of an energy, in the order of the family."""
        result = []
        for start, new in zip(self.starts, self.members, strict=True):
            ends = [start, new]
            if start.tests and start.tests["energy_slope"] * new.tests["energy_slope"] < 0:
                fold = self._root(start, start, new, _test("energy_slope"))
                ends[1:1] = [fold] if fold else []
            for a, b in pairwise(ends):
                if (a.energy - value) * (b.energy - value) < 0:
                    near = self._root(start, a, b, lambda each: each.energy - value)
                    exact = self.family.corrected(near.orbit, value) if near else None
                    if near and exact:
                        result.append(member(self.family, exact[0], near.arc))
        return result


def _test(name: str) -> Callable[[Member], float]:
    return lambda each: each.tests[name]


def _period(each: Member) -> float:
    return each.orbit.period


def _energy(each: Member) -> float:
    return each.energy


def _roots(fit: np.polynomial.Polynomial) -> Array:
    """Zeros between 0 and 1."""
    roots = fit.roots()
    real = roots[np.abs(roots.imag) < 1e-6].real
    return np.sort(real[(real > -0.01) & (real < 1.01)])
