"""Families of periodic motions from a steady motion to their end, and the bifurcations on the way.

With rho = mu + 1/mu of the pairs of multipliers, one is 1 where the product of 2 - rho vanishes, -1 where that of 2 + rho does, and
pairs meet where two rho are equal. The energy and the period have folds where their slopes along the family vanish. Where both
vanish at one orbit the family comes back on itself and has ended: at a steady motion, where the amplitude is 0, on an orbit that is
run through several times, y(T/k) = R y(0), or else on its own mirror image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from ...flags import FamilyEnd, Flag, PeriodicEvent
from ...systems.base import Array
from .flow import SIZE
from .orbits import Family, Orbit, Solution

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
COMPLETE = 3.0  # periods of the birth up to which pairs of events within a step are looked for
LATER = 3.0  # times so much may multipliers change in a step beyond
# A function below this part of its values may have a pair of zeros; orbits that are looked at for it; it touches zero by rounding.
DIP, PAIRED, TOUCHING = 0.5, 5, 1e-9
SAME = 0.02  # of a step: events that are one
RETURNED = (
    0.01  # distance of a state from an earlier one, over the size of the orbit, below which they are the same
)
# A zero is on the polynomial of so many members if one is as near, of a step, and the function there as small, of its values.
KNOWN, NEAR, SMALL = 6, 1e-5, 1e-3
SHARES = (0.1, 0.23, 0.36, 0.5, 0.64, 0.77, 0.9)  # of a distance, where members beside a singular orbit are


class Event(NamedTuple):
    """An event of a family, or its end."""

    kind: Flag
    period: float
    energy: float
    arc: float


@dataclass(frozen=True)
class Member:
    """An orbit of a family, with what decides on events and steps."""

    orbit: Orbit
    arc: float
    energy: float
    multipliers: Array
    angles: Array  # of the multipliers, and logarithms of their magnitudes, (2, pairs)
    tests: dict[PeriodicEvent, float]  # functions that change their signs at events
    solution: Solution

    def far_from(self, other: Member) -> float:
        """Change of the multipliers, 1 at the limit."""
        if self.angles.shape != other.angles.shape or not self.angles.size:
            return 0.0
        orders = ([0, 1], [1, 0]) if self.angles.shape[1] == 2 else ([0],)
        limits = np.array([[ANGLE], [GROWTH]])
        return float(min((np.abs(self.angles - other.angles[:, order]) / limits).max() for order in orders))


def member(family: Family, solution: Solution, arc: float) -> Member:
    """A member of an orbit."""
    orbit = solution.orbit
    mu = family.multipliers(orbit, solution.matrices)
    rho = mu[::2] + mu[1::2]
    half, size = np.arccos(rho / 2 + 0j), np.sqrt(1 + rho.sum().real ** 2 + rho.prod().real ** 2)
    tests = {
        PeriodicEvent.FOLD: float(family.energy_row(orbit) @ orbit.tangent),
        PeriodicEvent.PERIOD_FOLD: float(orbit.tangent[-2] * family.unit),
        PeriodicEvent.BRANCH: float((2 - rho).prod().real / size),
        PeriodicEvent.DOUBLING: float((2 + rho).prod().real / size),
        PeriodicEvent.KREIN: float(((rho[0] - rho[1]) ** 2).real / size**2) if rho.size > 1 else 1.0,
    }
    angles = np.array([half.real, np.abs(half.imag)])
    return Member(orbit, arc, family.energy(orbit), mu, angles, tests, solution)


Value = Callable[[Member], Any]


def test(kind: PeriodicEvent) -> Value:
    """The function of members that vanishes at events of a kind."""
    return lambda each: each.tests[kind]


class Section:
    """The part of a family between two members of a path, and the members known of it."""

    def __init__(self, path: Path, start: Member, end: Member) -> None:
        self.path, self.start, self.end = path, start, end
        self.length, self.members = end.arc - start.arc, [start, end]

    def at(self, arc: float) -> Member | None:
        """The member at an arc length; None if Newton's method fails."""
        near = self.nearest(arc)[0]
        if abs(near.arc - arc) < 1e-3 * NEAR * self.length:
            return near
        new = self.path.beside(self.start, arc - self.start.arc)
        if new is None or self.turn(new) > 2 * self.turn(self.end) + 1e-9:
            return None
        self.members = sorted([*self.members, new], key=lambda each: each.arc)
        return new

    def turn(self, other: Member) -> float:
        """How far the tangent has turned from the start: beside a singular orbit it is not that of the family."""
        return 1.0 - float(self.start.orbit.tangent @ other.orbit.tangent)

    def nearest(self, arc: float) -> list[Member]:
        return sorted(self.members, key=lambda each: abs(each.arc - arc))[:KNOWN]

    def coefficients(self, value: Value, arc: float, others: Sequence[Member] = ()) -> tuple[Array, float]:
        """Of a polynomial through members near an arc length, in the distance from there over the unit that follows."""
        near = [*self.nearest(arc), *others]
        distances = np.array([each.arc - arc for each in near])
        unit = np.abs(distances).max()
        matrix = np.vander(distances / unit, increasing=True)
        return np.linalg.lstsq(matrix, [value(each) for each in near], rcond=1e-14)[0], unit

    def polynomial(self, value: Value, arc: float, others: Sequence[Member] = ()) -> Polynomial:
        coefficients, unit = self.coefficients(value, arc, others)
        return Polynomial(coefficients, domain=[-unit, unit])

    def estimate(self, value: Value, low: Member, high: Member) -> float:
        """Arc length between two members at which the polynomial of a function vanishes."""
        middle, width = 0.5 * (low.arc + high.arc), 0.5 * (high.arc - low.arc)
        roots = _real(self.polynomial(value, middle).roots(), width)
        return middle + (roots[0] if roots.size else 0.0)

    def zero(self, value: Value, low: Member, high: Member) -> float:
        """Arc length at which a function vanishes that has other signs at two members."""
        size = SMALL * max(abs(value(low)), abs(value(high)))
        for i in range(60):
            arc = self.estimate(value, low, high)
            near = self.nearest(arc)[0]
            if abs(near.arc - arc) < NEAR * self.length and abs(value(near)) < size:
                return arc
            # A polynomial may approach a zero of a steep function too slowly.
            if (new := self.at(arc if i % 4 < 3 else 0.5 * (low.arc + high.arc))) is None:
                break
            low, high = (low, new) if value(new) * value(low) < 0 else (new, high)
        for share in SHARES:  # beside a singular orbit
            self.at(low.arc + share * (high.arc - low.arc))
        return self.estimate(value, low, high)

    def leave(self, arc: float) -> None:
        """Keep members at some distance of a singular orbit, beside which they have few digits."""
        for share in SHARES:
            self.at(self.start.arc + share * self.length)
        inner = [each for each in self.members[1:-1] if abs(each.arc - arc) > SAME * self.length]
        self.members = [self.start, *inner, self.end]

    def event(self, kind: Flag, arc: float) -> Event:
        period, energy = (
            self.coefficients(attrgetter(name), arc)[0][0] for name in ("orbit.period", "energy")
        )
        return Event(kind, float(period), float(energy), arc)

    def zeros(self, value: Value) -> list[float]:
        return [self.zero(value, a, b) for a, b in pairwise(self.members) if value(a) * value(b) < 0]

    def hides_no_pair(self, value: Value, others: Sequence[Member]) -> bool:
        """Whether it is sure, with the help of members beside, that no pair of zeros is left between two members."""
        middle, sign = self.start.arc + 0.5 * self.length, np.sign(value(self.start))
        for _ in range(PAIRED):
            values = [sign * value(each) for each in self.members]
            fit = self.polynomial(value, middle, others if len(values) < 4 else ()) * sign
            lowest = min(_real(fit.deriv().roots(), 0.5 * self.length), key=fit, default=0.0)
            arc = middle + lowest
            ended = arc > self.path.end.arc - SAME * self.length
            if ended or min(values) < TOUCHING or fit(lowest) > DIP * min(values):
                return True
            if self.at(arc) is None:
                return False
        return True


def _real(roots: np.ndarray, width: float) -> Array:
    """Real roots that are within a distance of 0."""
    return np.sort(roots[(np.abs(roots.imag) < 1e-9 * width) & (np.abs(roots.real) <= width)].real)


class Path:
    """Members of a family in their order, and its end."""

    end: Event

    def __init__(self, family: Family) -> None:
        self.family = family
        orbit, energy = family.born(NODES), family.birth_energy
        solution = Solution(orbit, np.empty((0, SIZE, SIZE)), 0.0, 0, 0.0)
        self.birth = Member(orbit, 0.0, energy, np.empty(0), np.empty((2, 0)), {}, solution)
        self.sections: list[Section] = []  # from the birth on
        self.members: list[Member] = []
        self.fastest = 0.0

    def follow(self, max_period: float) -> Path:
        """The path with its members up to a period in periods of the birth, and its end."""
        self.longest = max_period * self.family.unit
        self.end = self._follow()
        return self

    def beside(self, start: Member, step: float) -> Member | None:
        """The member after a step along the tangent; None if Newton's method fails or leads to another family."""
        solution = self.family.corrected(self.family.moved(start.orbit, step * start.orbit.tangent))
        if solution is None or solution.distance > FAR * abs(step):
            return None
        is_same = solution.orbit.tangent @ start.orbit.tangent >= COSINE
        return member(self.family, solution, start.arc + step) if is_same else None

    def _follow(self) -> Event:
        before, step, failures = self.birth, FIRST, 0
        while len(self.members) < MOST_STEPS and step > SHORTEST and failures < 40:
            new = self.beside(before, step)
            if new is None:
                failures += 1
                # At a singular orbit shorter steps fail as well: a longer one may lead across it.
                step = step / 2 if failures % 5 else min(step * 40.0, LONGEST)
                continue
            change = before.far_from(new)
            change /= 1.0 if before.orbit.period < COMPLETE * self.family.unit else LATER
            if change > 1.5:
                step /= 2
                continue
            self.sections.append(Section(self, before, new))
            self.members.append(new)
            if end := self._ended():
                return end
            easy = new.solution.iterations < 5 and new.solution.distance < 0.1 * step
            if len(self.members) >= BIRTHS and easy and change < 0.6:
                step = min(step * 1.5, LONGEST)
            before, failures = self._with_nodes(new), max(failures - 1, 0)
        if not self.members:
            return Event(FamilyEnd.LOST, self.family.unit, self.family.birth_energy, 0.0)
        kind = FamilyEnd.STEP_LIMIT if len(self.members) == MOST_STEPS else FamilyEnd.LOST
        return self._at_steady_motion(1e-3) or self._left(kind)

    def _with_nodes(self, new: Member) -> Member:
        """The member with as many nodes as the next step needs."""
        family, orbit, m = self.family, new.orbit, len(new.orbit.states)
        orbit = replace(orbit, bound=family.flow.bound(orbit.states[0]))
        expansion = np.linalg.norm(new.solution.matrices, 2, axis=(1, 2)).max()
        if m < MOST_NODES and (expansion > EXPANSION or orbit.period > SEGMENT * m * family.unit):
            orbit = family.meshed(orbit, min(-(-m * 3 // 2), MOST_NODES))
        return replace(new, orbit=orbit)

    def _left(self, kind: Flag) -> Event:
        last = self.members[-1]
        return Event(kind, last.orbit.period, last.energy, last.arc)

    def _ended(self) -> Event | None:
        """The end of the family, if it is at the last member."""
        new, unit, section = self.members[-1], self.family.unit, self.sections[-1]
        speeds = self.family.flow.speeds(new.orbit.states)
        self.fastest = max(self.fastest, speeds.max())
        if np.abs(new.orbit.states[:, :3]).max() > FAST * self.family.flow.rate:
            return self._left(FamilyEnd.UNBOUNDED)
        both = [test(kind) for kind in (PeriodicEvent.FOLD, PeriodicEvent.PERIOD_FOLD)]
        if len(self.members) > BIRTHS and all(value(section.start) * value(new) < 0 for value in both):
            places = [section.zeros(value) for value in both]
            gaps = np.abs(np.subtract.outer(*places))
            if gaps.min() < SAME * section.length:
                place = places[0][int(np.argmin(gaps.min(1)))]
                section.leave(place)
                return section.event(self._kind_of_return(section, place), place)
        if new.orbit.period > self.longest:
            return self._at_steady_motion(1e-3) or self._left(FamilyEnd.PERIOD_LIMIT)
        long = speeds.min() < SLOW * speeds.max() and new.orbit.period > 1.5 * unit
        return self._at_steady_motion(1e-4) if long else None

    def _at_steady_motion(self, tolerance: float) -> Event | None:
        """The end at infinite period, if the slowest state is near a steady motion whose energy is the limit."""
        flow, new = self.family.flow, self.members[-1]
        speeds = flow.speeds(new.orbit.states)
        state = self.family.steady_state(new.orbit, int(np.argmin(speeds)))
        if state is None:
            return None
        energy, energies = flow.value(flow.energy, state), np.array([each.energy for each in self.members])
        near = np.abs(energy - energies[-1]) < tolerance * np.ptp(energies)
        near = near and speeds.min() < 0.2 * speeds.max() and np.ptp(energies[-3:]) < 0.01 * np.ptp(energies)
        return Event(FamilyEnd.ASYMPTOTIC, np.inf, energy, new.arc) if near else None

    def _kind_of_return(self, section: Section, arc: float) -> Flag:
        """Where a family comes back on itself."""
        flow, orbit = self.family.flow, section.nearest(arc)[0].orbit
        if flow.speeds(orbit.states).max() < 0.05 * self.fastest:
            return FamilyEnd.STEADY_MOTION
        times = orbit.chi * np.arange(len(orbit.states)) / len(orbit.states)
        others = np.concatenate(
            [flow.turned(y[None], -chi) for y, chi in zip(orbit.states, times, strict=True)]
        )
        size = np.linalg.norm(flow.difference(others, orbit.states[:1]), axis=1).max()

        def after(parts: int, turns: int, each: Member) -> Array:
            """The state after a part of the period, turned back."""
            orbit = each.orbit
            later = flow.run(orbit.states[:1], orbit.period / parts, orbit.bound)[0]
            return flow.turned(later, -(orbit.chi + 2 * np.pi * turns) / parts)[0]

        for parts, turns in ((k, j) for k in range(2, 9) for j in range(k if flow.symmetric else 1)):
            values = partial(after, parts, turns), lambda each: each.orbit.states[0]
            later, first = (section.coefficients(value, arc)[0][:1] for value in values)
            # The difference vanishes at half a turn as well.
            near = (flow.vectors(later)[:, 1:] * flow.vectors(first)[:, 1:]).sum(-1).min() > 0
            if near and np.linalg.norm(flow.difference(later, first)) < RETURNED * size:
                return FamilyEnd.MULTIPLE
        return FamilyEnd.MIRROR

    def events(self) -> tuple[list[Event], bool]:
        """Events in their order, and whether no pair of them within a step was missed."""
        result, complete = list[Event](), self.end.kind not in (FamilyEnd.LOST, FamilyEnd.STEP_LIMIT)
        for i, section in enumerate(self.sections[1:], 1):
            start, others = section.start, self.members[max(i - 2, 0) : i + 2]
            others = [each for each in others if each.arc not in (start.arc, self.members[i].arc)]
            if start.orbit.period < COMPLETE * self.family.unit:
                complete &= all([section.hides_no_pair(test(kind), others) for kind in start.tests])
            places = {kind: section.zeros(test(kind)) for kind in start.tests}
            # At a fold of the energy a multiplier is 1 as well.
            folds, same = places[PeriodicEvent.FOLD], SAME * section.length
            for kind, arcs in places.items():
                for arc in arcs:
                    fold = kind == PeriodicEvent.BRANCH and any(abs(arc - each) < same for each in folds)
                    if arc < self.end.arc - same and not fold:
                        result.append(section.event(kind, arc))
        return sorted(result, key=lambda event: event.arc), complete

    def at_energy(self, energy: float) -> list[Member]:
        """Every member of an energy, in the order of the family."""
        result = []
        for section in self.sections:
            if section.start.tests:
                for arc in section.zeros(test(PeriodicEvent.FOLD)):
                    section.at(arc)
            for arc in section.zeros(lambda each: each.energy - energy):
                near = section.nearest(arc)[0]
                if (exact := self.family.corrected(near.orbit, energy)) is not None:
                    result.append(member(self.family, exact, arc))
        return result
