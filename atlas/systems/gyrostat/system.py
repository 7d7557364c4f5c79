"""Compute linear stability, small oscillations and stability by the energy for all gyrostats."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import EnergyStability, Stability, StabilityKind
from ..base import Array, DerivedVariable, Flags, Mask, Points, System, shape_of, shared, subset, unsteady
from .body import Body, length, transverse_axes
from .oscillations import Equilibria, energy_minima

FREQUENCIES = ("frequency_1", "frequency_2", "frequency_3")
_CHUNK = 2048  # number of points whose exponents are computed together
# If the logarithm of the growth over a run is at most this number, the growth is a change of amplitude and no instability.
_AMPLITUDE_GROWTH = 10.0


class Gyrostat(System):
    """Gyrostat in a frame that turns uniformly about its vertical. The theory follows from `body`.

    The states are the angular velocity in space (`rate_states`) and the ``FRAME_VECTORS`` of the equations. These vectors are
    the vertical gamma, or alpha and gamma, as in `Body`.
    """

    moments_of_inertia = ("A", "B", "C")
    frequency_comment = "nan for exponents that are 0 or have a real part, and off every family"
    """Comment of the variables of frequencies: where they are nan."""
    axial_rotor: str = ""
    """Parameter of the rotor along the third axis; empty: there is none."""
    energy_comment = "on the level of what dissipation inside the body keeps"
    """Comment of the variables of stability by the energy: which momenta are fixed."""

    def __init__(self) -> None:
        self.derived = {**type(self).derived, **oscillation_variables(self)}

    def remarks(self, points: Mapping[str, Any]) -> list[str]:
        if not {"A", "B", "C"} <= points.keys():
            return []
        A, B, C = points["A"], points["B"], points["C"]
        if not ((A != B) & ((B == C) | (A == C))).any():
            return []
        return [
            "at some points A != B but B = C or A = C: label describes the motion of the third axis, so that a"
            " steady motion about the axis of symmetry of the body is labelled as drifting; label_any_axis, a variable"
            " for [outputs], describes motions about any axis"
        ]

    @abstractmethod
    def body(self, points: Points) -> Body:
        """Return the gyrostat at each point as a `Body`, with vectors of shape (points, 3)."""

    def frequency_bound(self, points: Points) -> Array:
        """Return Body.frequency_bound, which follows from the energy."""
        w, alpha, gamma = self.start(points)
        return self.body(points).frequency_bound(w, alpha, gamma)

    @shared
    def natural_rate(self, points: Points) -> Array:
        """Return the frame's rate, or in a frame at rest the fields' frequency. If this is negligible, return the free body's rate."""
        with np.errstate(all="ignore"):
            return self.body(points).natural_rate(self._triples(self.initial_state(points))[0])

    def start(self, points: Points) -> tuple[Array, Array, Array]:
        """Return w, alpha and gamma at the start, each (points, 3) in body axes."""
        return self.vectors(self.initial_state(points))

    def vectors(self, states: Array) -> tuple[Array, Array, Array]:
        """Return w, alpha and gamma of states, each (points, 3). Without alpha, any vector normal to gamma is returned."""
        w, *others, gamma = self._triples(states)
        return w, others[0] if others else transverse_axes(gamma)[..., 0, :], gamma

    def _triples(self, states: Array) -> list[Array]:
        """Return the angular velocity and the directions at rest in the frame, each (points, 3), of states (states, points)."""
        state = dict(zip(self.equations.STATE, states, strict=True))
        names = self.rate_states, *self.equations.FRAME_VECTORS
        # Components are contiguous in memory, which makes sums over components several times as fast.
        return [np.moveaxis(np.array([state[name] for name in triple]), 0, -1) for triple in names]

    @shared
    def oscillation_families(self, points: Points) -> Flags:
        """Return flags of the families for which frequencies and stability by the energy are computed."""
        return self.identify_family(points)[0]

    def squared_unit(self, points: Points) -> Array:
        """Return the squared unit of rates in `condition_residual`, (points,). The default is the squared frequency bound."""
        return self.frequency_bound(points) ** 2

    def linear_stability(self, points: Points, flags: Flags) -> tuple[Flags, Array]:
        """Return the stability from the formula of the family, or from the linear equations if the family has none."""
        stable, growth = super().linear_stability(points, flags)
        remaining = np.flatnonzero((flags > 0) & ~unsteady(self, flags) & (stable == Stability.UNKNOWN))
        if remaining.size:
            part = points if remaining.size == flags.size else subset(points, remaining)
            stable[remaining], growth[remaining] = self.stability(part)
        return stable, growth

    def stability(self, points: Points) -> tuple[Flags, Array]:
        """Return stability and growth rate of the steady motions, (points,), from eigenvalues or multipliers alone."""
        body, start = self.body(points), self.start(points)
        stable, growth = np.zeros(body.turn.size, np.int8), np.full(body.turn.size, np.nan)
        for first in range(0, body.turn.size, _CHUNK):
            part = slice(first, first + _CHUNK)
            w, alpha, gamma = (vector[part] for vector in start)
            stable[part], growth[part] = self._stability(body.subset(part), (w, alpha, gamma))
        return stable, growth

    def _stability(self, body: Body, start: tuple[Array, Array, Array]) -> tuple[Flags, Array]:
        stable, growth = np.zeros(body.turn.size, np.int8), np.full(body.turn.size, np.nan)
        rest = Equilibria.of(body, *start)
        stable[rest.points], growth[rest.points] = rest.stability()
        moving = _turning_motions(rest, body, start)
        if moving.size:
            from . import floquet  # imported here, because equilibria need no multipliers

            part = (vector[moving] for vector in start)
            stable[moving], growth[moving] = floquet.stability(body.subset(moving), *part)
        return stable, growth

    def with_defaults(self, body: Mapping[str, float]) -> Points:
        """Return every parameter of one body as an array (1,). A missing parameter takes its default."""
        return {k: np.full(1, float(body.get(k, p.default))) for k, p in self.parameters.items()}

    def frequencies(self, points: Points, flags: Flags) -> Array:
        """Return frequencies of small oscillations about steady motions, rad per time unit, the largest first, (points, 3).

        A frequency is nan if the exponent is 0 or has a real part. All are nan where `flags` is 0 and where the linear equations
        are periodic.
        """
        result, members = np.full((flags.size, 3), np.nan), np.flatnonzero(flags > 0)
        with np.errstate(all="ignore"):
            part = subset(points, members)
            rest = Equilibria.of(self.body(part), *self.start(part))
            result[members[rest.points]] = rest.frequencies()
        return result

    def energy_stability(self, points: Points, flags: Flags) -> Flags:
        """Return whether steady motions minimise the energy at the momenta that internal dissipation conserves."""
        result, members = np.zeros(flags.shape, np.int8), np.flatnonzero(flags > 0)
        part = subset(points, members)
        body, start = self.body(part), self.start(part)
        known = Equilibria.of(body, *start, from_space=False).points
        result[members[known]] = energy_minima(body.subset(known), *(vector[known] for vector in start))
        return result

    def conservative_stability(self, points: Points, flags: Flags) -> tuple[Flags, Mask]:
        """Return EnergyStability at fixed momenta, and a mask that is true where the value is YES and the body has an axis of symmetry."""
        result, members = np.zeros(flags.shape, np.int8), np.flatnonzero(flags > 0)
        symmetric, part = np.zeros(flags.shape, bool), subset(points, members)
        rest = Equilibria.of(self.body(part), *self.start(part), from_space=False)
        result[members[rest.points]], symmetric[members[rest.points]] = (
            rest.energy_stability(),
            rest.symmetric(),
        )
        return result, symmetric & (result == EnergyStability.YES)

    def conserves_axial_momentum(self, points: Points) -> Mask:
        """Return where C w3 + rotor is constant. Spin and rotor then affect the motion of the third axis only through this sum."""
        return np.zeros(shape_of(points), bool)

    def despun(self, points: Points) -> tuple[Points, Array]:
        """Return points with the same motion of the third axis, if possible with a lower frequency bound, and the increase of phi'.

        Where C w3 + rotor is constant, spin replaces the rotor if this lowers the frequency bound. Such points are cheaper to
        integrate accurately.
        """
        if not (rotor := self.axial_rotor):
            return points, np.zeros(shape_of(points))
        conserved = self.conserves_axial_momentum(points) & np.isfinite(points[rotor])
        excess = np.where(conserved, points[rotor] / points["C"], 0.0)
        despun = {**points, rotor: np.where(conserved, 0.0, points[rotor]), "m": points["m"] + excess}
        with np.errstate(all="ignore"):
            slower = self.frequency_bound(despun) < self.frequency_bound(points)
        despun = {name: np.where(slower, despun[name], points[name]) for name in points}
        return despun, np.where(slower, excess, 0.0)


def log_growth(system: System, points: Points, flags: Flags, growth_rate: Array, duration: Array) -> Array:
    """Return the logarithm of the growth of a small distance from the steady motions over runs, (points,), or nan.

    In general the logarithm is `growth_rate` x `duration`. A gyrostat's run may be shorter than the period of the linear system and
    contain only unstable phases. If the logarithm over such a run exceeds _AMPLITUDE_GROWTH, the larger of both is returned.
    """
    result = growth_rate * duration
    if not isinstance(system, Gyrostat):
        return result
    w, *_, gamma = system._triples(system.initial_state(points))
    turn = system.body(points).turn
    short = length(w - turn[:, None] * gamma) * duration < 2 * np.pi
    where = np.flatnonzero((flags > 0) & ~unsteady(system, flags) & short)
    for first in range(0, where.size, _CHUNK):
        chunk = where[first : first + _CHUNK]
        part = subset(points, chunk)
        body, start = system.body(part), system.start(part)
        moving = _turning_motions(Equilibria.of(body, *start), body, start)
        if not moving.size:
            continue
        from . import floquet

        members = chunk[moving]
        w, alpha, gamma = (vector[moving] for vector in start)
        phases = floquet.log_growth(body.subset(moving), w, alpha, gamma, duration[members])
        result[members] = np.where(
            phases > _AMPLITUDE_GROWTH, np.fmax(result[members], phases), result[members]
        )
    return result


def _turning_motions(rest: Equilibria, body: Body, start: tuple[Array, Array, Array]) -> NDArray[np.int64]:
    """Return the indices of motions that turn steadily and are no equilibria."""
    moving = np.delete(np.arange(body.turn.size), rest.points)
    if not moving.size:
        return moving
    return moving[body.subset(moving).turns_steadily(*(vector[moving] for vector in start))]


@shared
def steady_families(system: Gyrostat, points: Points) -> Flags:
    """Return the flags of `oscillation_families`, with 0 for motions at a varying rate."""
    flags = system.oscillation_families(points)
    return np.where(unsteady(system, flags), 0, flags)


@shared
def energy_stable(system: Gyrostat, points: Points) -> Flags:
    """Return values of flags.EnergyStability for steady motions."""
    return system.energy_stability(points, steady_families(system, points))


@shared
def conservative(system: Gyrostat, points: Points) -> tuple[Flags, Mask]:
    """Return `Gyrostat.conservative_stability` of steady motions."""
    return system.conservative_stability(points, steady_families(system, points))


@shared
def kinds_of_stability(system: Gyrostat, points: Points) -> Flags:
    stable, growth = system.linear_stability(points, system.oscillation_families(points))
    return stability_kind(stable, growth, energy_stable(system, points), conservative(system, points)[1])


def oscillation_variables(system: Gyrostat) -> dict[str, DerivedVariable]:
    """Return derived variables for three frequencies, stability by the energy, and the kind of stability."""

    def group_values(
        names: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        pause()
        with np.errstate(all="ignore"):
            steady = steady_families(system, points)
            if not set(FREQUENCIES).isdisjoint(names):
                pause()
                columns |= dict(zip(FREQUENCIES, system.frequencies(points, steady).T, strict=True))
            for name, values in of_energy.items():
                if name in names:
                    pause()
                    columns[name] = values(system, points)
        return columns

    of_energy = {"energy_stable": energy_stable, "stability_kind": kinds_of_stability}
    flags = {"energy_stable": EnergyStability.meanings(), "stability_kind": StabilityKind.meanings()}
    energy = system.energy_comment
    rows = (
        *((name, "rad s-1", f"{order} frequency of small oscillations about the steady motion", system.frequency_comment)
          for name, order in zip(FREQUENCIES, ("largest", "second", "third"), strict=True)),
        ("energy_stable", "1", "stability of the steady motion by the energy, from theory", energy),
        ("stability_kind", "1", "linear stability and stability by the energy, from theory", energy),
    )  # fmt: skip
    return {row[0]: DerivedVariable.of_group(group_values, *row, flags=flags.get(row[0])) for row in rows}


def stability_kind(linear: Flags, growth: Array, energy: Flags, axial: Mask | bool = False) -> Flags:
    """Return values of flags.StabilityKind, (points,), from linear stability, growth rate and stability by the energy.

    The mask `axial` is true where the energy proves stability at a fixed momentum about an axis of symmetry.
    """
    stable = linear == Stability.STABLE
    kinds = {
        StabilityKind.UNSTABLE: linear == Stability.UNSTABLE,
        StabilityKind.ENERGY_STABLE: stable & (energy == EnergyStability.YES),
        StabilityKind.MARGINAL: (linear == Stability.UNKNOWN) & (growth == 0),
        StabilityKind.ENERGY_STABLE_AXIAL: stable & axial,
        StabilityKind.GYROSCOPIC: stable & (energy == EnergyStability.NO),
        StabilityKind.LINEARLY_STABLE: stable,
    }
    return np.select(list(kinds.values()), list(kinds), StabilityKind.UNKNOWN).astype(np.int8)
