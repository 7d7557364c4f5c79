"""Frequencies of small oscillations and stability by the energy as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..flags import EnergyStability, Stability, StabilityKind
from .base import Array, DerivedVariable, Flags, Mask, Points

FREQUENCIES = ("frequency_1", "frequency_2", "frequency_3")


def frequency_variables(
    family: Callable[[Points], Flags], frequencies: Callable[[Points, Flags], Array], comment: str
) -> dict[str, DerivedVariable]:
    """The variables frequency_1, frequency_2 and frequency_3, the largest first.

    Parameters
    ----------
    family : callable
        points -> flags of their families (points,).
    frequencies : callable
        points, flags -> array (points, 3), the largest first, nan where there is none; rad per time unit.
    comment : str
        Where there is none.
    """

    def variable(i: int) -> DerivedVariable:
        def values(points: Points, duration: Array, pause: Callable[[], None]) -> Array:
            pause()
            with np.errstate(all="ignore"):
                return frequencies(points, family(points))[:, i]

        order = ("largest", "second", "third")[i]
        return DerivedVariable(
            FREQUENCIES[i],
            "rad s-1",
            f"{order} frequency of small oscillations about the steady motion",
            values,
            comment,
        )

    return {FREQUENCIES[i]: variable(i) for i in range(len(FREQUENCIES))}


# Frequencies that differ by less than this, relative to the largest, coincide: a double root has the square root of rounding
# as its error.
_DOUBLE = 1e-6


def stability_variables(
    family: Callable[[Points], Flags],
    linear: Callable[[Points, Flags], tuple[Flags, Array]],
    frequencies: Callable[[Points, Flags], Array],
    energy: Callable[[Points, Flags], tuple[Flags, Mask]],
    comment: str,
) -> dict[str, DerivedVariable]:
    """The variables energy_stable and stability_kind.

    Parameters
    ----------
    family, frequencies : callable
        As of `frequency_variables`.
    linear : callable
        System.linear_stability.
    energy : callable
        points, flags -> values of flags.EnergyStability (points,), and where these are unknown because the second variation
        is degenerate, bool (points,).
    comment : str
        On which level of which integrals.
    """

    def energy_stable(points: Points, duration: Array, pause: Callable[[], None]) -> Flags:
        pause()
        with np.errstate(all="ignore"):
            return energy(points, family(points))[0]

    def kind(points: Points, duration: Array, pause: Callable[[], None]) -> Flags:
        pause()
        with np.errstate(all="ignore"):
            flags = family(points)
            return stability_kind(
                linear(points, flags)[0], *energy(points, flags), frequencies(points, flags)
            )

    variables = (
        DerivedVariable(
            "energy_stable", "1", "stability of the steady motion by the energy, from theory", energy_stable, comment,
            flags=EnergyStability.meanings(),
        ),
        DerivedVariable(
            "stability_kind", "1", "linear stability and stability by the energy, from theory", kind, comment,
            flags=StabilityKind.meanings(),
        ),
    )  # fmt: skip
    return {variable.name: variable for variable in variables}


def stability_kind(linear: Flags, energy: Flags, degenerate: Mask, frequencies: Array) -> Flags:
    """Values of flags.StabilityKind, (points,), from those of Stability, of EnergyStability and the frequencies."""
    gaps = -np.diff(frequencies, axis=1)
    with np.errstate(invalid="ignore"):
        double = (gaps <= _DOUBLE * frequencies[:, :1]).any(1)
    stable = linear == Stability.STABLE
    conditions = [
        linear == Stability.UNSTABLE,
        stable & (energy == EnergyStability.YES),
        stable & (degenerate | ((energy == EnergyStability.NO) & double)),
        stable & (energy == EnergyStability.NO),
        stable,
    ]
    kinds = [
        StabilityKind.UNSTABLE,
        StabilityKind.ENERGY_STABLE,
        StabilityKind.MARGINAL,
        StabilityKind.GYROSCOPIC,
        StabilityKind.LINEARLY_STABLE,
    ]
    return np.select(conditions, kinds, StabilityKind.UNKNOWN).astype(np.int8)
