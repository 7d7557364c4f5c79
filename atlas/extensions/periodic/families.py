"""Families of periodic motions from a steady motion to their end, and the bifurcations on the way.

Each pair of multipliers mu, 1/mu has the sum rho = mu + 1/mu. A multiplier is 1 where the product of all 2 - rho vanishes, and -1
where the product of all 2 + rho vanishes; two pairs meet where their rho are equal. The energy or the period has a fold where its
slope along the family vanishes. Where both slopes vanish at one orbit, the family comes back on itself and ends. This orbit is a
steady motion (amplitude 0), an orbit of another family that is run through several times, or an orbit that is its own mirror image.
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
# Nodes are added if changes grow by a factor above EXPANSION in a segment, or if the mean segment exceeds SEGMENT * (period at birth).
SEGMENT, EXPANSION = 0.3, 60.0
# Length and number of the first steps, which give d period / d energy at the birth; longest and shortest step; largest number of steps.
FIRST, BIRTHS, LONGEST, SHORTEST, MOST_STEPS = 0.01, 4, 0.15, 1e-6, 1500
# The largest changes of a multiplier's angle and of log |multiplier| in a step; the least cosine between the tangents at a step's ends.
ANGLE, GROWTH, COSINE = 0.35, 1.5, 0.9
FAR = 0.35  # largest distance of an orbit from its guess, as a fraction of the step
FAST = 12.0  # a family is unbounded if a rate exceeds this multiple of `Flow.rate`
SLOW = 1.5e-3  # a steady motion is looked for if the least speed on an orbit is below this fraction of the largest speed on the orbit
COMPLETE = 3.0  # pairs of events within a step are looked for while the period is below this multiple of the period at the birth
LATER = 3.0  # ANGLE and GROWTH are multiplied by this factor while the period is above COMPLETE times the period at the birth
# A function may have a pair of zeros if the polynomial through known values falls below DIP times the least of these values. Then up to
# PAIRED members are computed at minima of the polynomial. A value below TOUCHING counts as 0 and ends this search.
DIP, PAIRED, TOUCHING = 0.5, 5, 1e-9
SAME = 0.02  # events at a distance below this fraction of a step are the same
RETURNED = 0.01  # states at a distance below this fraction of the size of the orbit are the same
# A polynomial through KNOWN members locates a function's zero between two members A and B. The zero is accepted if the nearest member
# is within NEAR times the section's length, and |function| at this member is below SMALL times the larger |function| at A and B.
KNOWN, NEAR, SMALL = 6, 1e-5, 1e-3
SHARES = (0.1, 0.23, 0.36, 0.5, 0.64, 0.77, 0.9)  # members are added at these fractions of an interval


class Event(NamedTuple):
    """An event along a family, or the end of the family."""

    kind: Flag
    period: float
    energy: float
    arc: float


@dataclass(frozen=True)
class Member:
    """An orbit of a family, with the values that decide on events and steps."""

    orbit: Orbit
    arc: float
    energy: float
    multipliers: Array
    angles: Array  # angles of the multipliers and logarithms of their magnitudes, (2, pairs)
    tests: dict[PeriodicEvent, float]  # values of functions that change sign at events
    solution: Solution

    def far_from(self, other: Member) -> float:
        """Return the largest change of the multipliers from `other`. Angles are divided by ANGLE, logarithms of magnitudes by GROWTH."""
        if self.angles.shape != other.angles.shape or not self.angles.size:
            return 0.0
        orders = ([0, 1], [1, 0]) if self.angles.shape[1] == 2 else ([0],)
        limits = np.array([[ANGLE], [GROWTH]])
        return float(min((np.abs(self.angles - other.angles[:, order]) / limits).max() for order in orders))


def member(family: Family, solution: Solution, arc: float) -> Member:
    """Return the member of `family` that has the orbit of `solution` and the arc length `arc`."""
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
    """Return the function that vanishes at events of `kind`. The function's argument is a member."""
    return lambda each: each.tests[kind]


class Section:
    """The part of a family between two successive members of a path, with all members computed there."""

    def __init__(self, path: Path, start: Member, end: Member) -> None:
        self.path, self.start, self.end = path, start, end
        self.length, self.members = end.arc - start.arc, [start, end]

    def at(self, arc: float) -> Member | None:
        """Return the member at the arc length `arc`, or None if Newton's method fails or finds a wrong tangent."""
        near = self.nearest(arc)[0]
        if abs(near.arc - arc) < 1e-3 * NEAR * self.length:
            return near
        new = self.path.beside(self.start, arc - self.start.arc)
        if new is None or self.turn(new) > 2 * self.turn(self.end) + 1e-9:
            return None
        self.members = sorted([*self.members, new], key=lambda each: each.arc)
        return new

    def turn(self, other: Member) -> float:
        """Return 1 - cosine between the tangents at the start and at `other`. Near a singular orbit, tangents may be wrong."""
        return 1.0 - float(self.start.orbit.tangent @ other.orbit.tangent)

    def nearest(self, arc: float) -> list[Member]:
        return sorted(self.members, key=lambda each: abs(each.arc - arc))[:KNOWN]

    def coefficients(self, value: Value, arc: float, others: Sequence[Member] = ()) -> tuple[Array, float]:
        """Fit a polynomial in (arc length - `arc`) / unit to `value` at the members near `arc`. Return the coefficients and the unit."""
        near = [*self.nearest(arc), *others]
        distances = np.array([each.arc - arc for each in near])
        unit = np.abs(distances).max()
        matrix = np.vander(distances / unit, increasing=True)
        return np.linalg.lstsq(matrix, [value(each) for each in near], rcond=1e-14)[0], unit

    def polynomial(self, value: Value, arc: float, others: Sequence[Member] = ()) -> Polynomial:
        coefficients, unit = self.coefficients(value, arc, others)
        return Polynomial(coefficients, domain=[-unit, unit])

    def estimate(self, value: Value, low: Member, high: Member) -> float:
        """Return the arc length of the first zero of the polynomial of `value` from `low` to `high`. Without a zero, return the middle."""
        middle, width = 0.5 * (low.arc + high.arc), 0.5 * (high.arc - low.arc)
        roots = _real(self.polynomial(value, middle).roots(), width)
        return middle + (roots[0] if roots.size else 0.0)

    def zero(self, value: Value, low: Member, high: Member) -> float:
        """Return the arc length of a zero of `value` between `low` and `high`. `value` has opposite signs at `low` and `high`."""
        size = SMALL * max(abs(value(low)), abs(value(high)))
        for i in range(60):
            arc = self.estimate(value, low, high)
            near = self.nearest(arc)[0]
            if abs(near.arc - arc) < NEAR * self.length and abs(value(near)) < size:
                return arc
            # The polynomials may approach a zero of a steep function too slowly, so that every fourth step is a bisection.
            if (new := self.at(arc if i % 4 < 3 else 0.5 * (low.arc + high.arc))) is None:
                break
            low, high = (low, new) if value(new) * value(low) < 0 else (new, high)
        self.add_members(low, high)  # Newton's method fails near a singular orbit
        return self.estimate(value, low, high)

    def add_members(self, low: Member, high: Member) -> None:
        for share in SHARES:
            self.at(low.arc + share * (high.arc - low.arc))

    def replace_near(self, arc: float) -> None:
        """Add members to the section, and drop those near the singular orbit at `arc`, which have few correct digits."""
        self.add_members(self.start, self.end)
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
        """Compute members where `value` may have two zeros. Return False if two zeros may be missed. `others` lie in nearby sections."""
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
    """Return the real roots from -`width` to `width`, in increasing order."""
    return np.sort(roots[(np.abs(roots.imag) < 1e-9 * width) & (np.abs(roots.real) <= width)].real)


class Path:
    """The members of a family, in order from the birth, and the end of the family."""

    end: Event

    def __init__(self, family: Family) -> None:
        self.family = family
        orbit, energy = family.born(NODES), family.birth_energy
        solution = Solution(orbit, np.empty((0, SIZE, SIZE)), 0.0, 0, 0.0)
        self.birth = Member(orbit, 0.0, energy, np.empty(0), np.empty((2, 0)), {}, solution)
        self.sections: list[Section] = []  # the first section starts at the birth of the family
        self.members: list[Member] = []
        self.fastest = 0.0

    def follow(self, max_period: float) -> Path:
        """Follow the family to its end, or until its period is `max_period` times that of the birth. Return the path."""
        self.longest = max_period * self.family.unit
        self.end = self._follow()
        return self

    def beside(self, start: Member, step: float) -> Member | None:
        """Return the member after `step` along the tangent at `start`; None if Newton's method fails or leads to another family."""
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
                # At a singular orbit shorter steps fail as well, but a longer step may lead across this orbit.
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
        """Return `new` with the frequency bound of its first state, and with more nodes if its segments are too long."""
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
        """Return the end of the family if the last member has reached it."""
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
                section.replace_near(place)
                return section.event(self._kind_of_return(section, place), place)
        if new.orbit.period > self.longest:
            return self._at_steady_motion(1e-3) or self._left(FamilyEnd.PERIOD_LIMIT)
        long = speeds.min() < SLOW * speeds.max() and new.orbit.period > 1.5 * unit
        return self._at_steady_motion(1e-4) if long else None

    def _at_steady_motion(self, tolerance: float) -> Event | None:
        """Return an end at infinite period if the slowest state is near a steady motion whose energy the family approaches."""
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
        """Return the kind of end of a family that comes back on itself at `arc`."""
        flow, orbit = self.family.flow, section.nearest(arc)[0].orbit
        if flow.speeds(orbit.states).max() < 0.05 * self.fastest:
            return FamilyEnd.STEADY_MOTION
        times = orbit.chi * np.arange(len(orbit.states)) / len(orbit.states)
        others = np.concatenate(
            [flow.turned(y[None], -chi) for y, chi in zip(orbit.states, times, strict=True)]
        )
        size = np.linalg.norm(flow.difference(others, orbit.states[:1]), axis=1).max()

        def after(parts: int, turns: int, each: Member) -> Array:
            """Return the state after 1/`parts` of the period, turned back by (chi + 2 pi `turns`) / `parts`."""
            orbit = each.orbit
            later = flow.run(orbit.states[:1], orbit.period / parts, orbit.bound)[0]
            return flow.turned(later, -(orbit.chi + 2 * np.pi * turns) / parts)[0]

        for parts, turns in ((k, j) for k in range(2, 9) for j in range(k if flow.symmetric else 1)):
            values = partial(after, parts, turns), lambda each: each.orbit.states[0]
            later, first = (section.coefficients(value, arc)[0][:1] for value in values)
            # `Flow.difference` may also vanish between attitudes that are half a turn apart.
            near = (flow.vectors(later)[:, 1:] * flow.vectors(first)[:, 1:]).sum(-1).min() > 0
            if near and np.linalg.norm(flow.difference(later, first)) < RETURNED * size:
                return FamilyEnd.MULTIPLE
        return FamilyEnd.MIRROR

    def events(self) -> tuple[list[Event], bool]:
        """Return the events in order along the family, and whether the list is complete up to COMPLETE times the period at the birth."""
        result, complete = list[Event](), self.end.kind not in (FamilyEnd.LOST, FamilyEnd.STEP_LIMIT)
        for i, section in enumerate(self.sections[1:], 1):
            start, others = section.start, self.members[max(i - 2, 0) : i + 2]
            others = [each for each in others if each.arc not in (start.arc, self.members[i].arc)]
            if start.orbit.period < COMPLETE * self.family.unit:
                complete &= all([section.hides_no_pair(test(kind), others) for kind in start.tests])
            places = {kind: section.zeros(test(kind)) for kind in start.tests}
            # A multiplier is also 1 at a fold of the energy, where no other family crosses.
            folds, same = places[PeriodicEvent.FOLD], SAME * section.length
            for kind, arcs in places.items():
                for arc in arcs:
                    fold = kind == PeriodicEvent.BRANCH and any(abs(arc - each) < same for each in folds)
                    if arc < self.end.arc - same and not fold:
                        result.append(section.event(kind, arc))
        return sorted(result, key=lambda event: event.arc), complete

    def at_energy(self, energy: float) -> list[Member]:
        """Return all members that have `energy`, in order along the family."""
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
