"""Frequencies of small oscillations and stability by the energy as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..flags import EnergyStability, Stability, StabilityKind
from .base import Array, DerivedVariable, Flags, Mask, Points

FREQUENCIES = ("frequency_1", "frequency_2", "frequency_3")
# Frequencies that differ by less than this, relative to the largest, coincide: a double root has the square root of rounding
# as its error.
_DOUBLE = 1e-6


def oscillation_variables(
    family: Callable[[Points], Flags],
    linear: Callable[[Points, Flags], tuple[Flags, Array]],
    frequencies: Callable[[Points, Flags], Array],
    energy: Callable[[Points, Flags], tuple[Flags, Mask]],
    frequency_comment: str,
    energy_comment: str,
) -> dict[str, DerivedVariable]:
    """The variables frequency_1, frequency_2 and frequency_3, the largest first, energy_stable and stability_kind.

    family: points -> flags of their families (points,); linear: system.linear_stability. frequencies: points,
    flags -> array (points, 3), the largest first, nan where there is none; rad per time unit. energy: points,
    flags -> values of flags.EnergyStability (points,), and where these are unknown because the second
    variation is degenerate, bool (points,); frequency_comment: where there is no frequency; energy_comment:
    on which level of which integrals the energy decides.
    """

    def together(
        names: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        has_kind = "stability_kind" in names
        pause()
        with np.errstate(all="ignore"):
            flags = family(points)
            if has_kind or not set(FREQUENCIES).isdisjoint(names):
                pause()
                each = frequencies(points, flags)
                columns |= dict(zip(FREQUENCIES, each.T, strict=True))
            if has_kind or "energy_stable" in names:
                pause()
                columns["energy_stable"], degenerate = energy(points, flags)
            if has_kind:
                pause()
                stable = linear(points, flags)[0]
                columns["stability_kind"] = stability_kind(stable, columns["energy_stable"], degenerate, each)
        return columns

    variables = [
        DerivedVariable.of_group(
            together,
            name,
            "rad s-1",
            f"{order} frequency of small oscillations about the steady motion",
            frequency_comment,
        )
        for name, order in zip(FREQUENCIES, ("largest", "second", "third"), strict=True)
    ]
    variables += [
        DerivedVariable.of_group(together, name, "1", long_name, energy_comment, flags=flags.meanings())
        for name, long_name, flags in (
            ("energy_stable", "stability of the steady motion by the energy, from theory", EnergyStability),
            ("stability_kind", "linear stability and stability by the energy, from theory", StabilityKind),
        )
    ]
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
