"""Small oscillations and stability by the energy as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...flags import EnergyStability, Stability, StabilityKind
from ..base import Array, DerivedVariable, Flags, Mask, Points, shared, unsteady

if TYPE_CHECKING:
    from .system import Gyrostat

FREQUENCIES = ("frequency_1", "frequency_2", "frequency_3")


@shared
def steady_families(system: Gyrostat, points: Points) -> Flags:
    """Families of the steady motions of which frequencies and stability by the energy are given."""
    flags = system.oscillation_families(points)
    return np.where(unsteady(system, flags), 0, flags)


@shared
def energy_stable(system: Gyrostat, points: Points) -> Flags:
    """Values of flags.EnergyStability."""
    return system.energy_stability(points, steady_families(system, points))


@shared
def conservative(system: Gyrostat, points: Points) -> tuple[Flags, Mask]:
    """See `Gyrostat.conservative_stability`."""
    return system.conservative_stability(points, steady_families(system, points))


@shared
def kinds_of_stability(system: Gyrostat, points: Points) -> Flags:
    """Values of flags.StabilityKind."""
    stable, growth = system.linear_stability(points, system.oscillation_families(points))
    return stability_kind(stable, growth, energy_stable(system, points), conservative(system, points)[1])


def oscillation_variables(system: Gyrostat) -> dict[str, DerivedVariable]:
    """Frequencies, the largest first, stability by the energy, and its kind."""

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
    """Values of flags.StabilityKind, (points,), from linear stability, growth rate and stability by the energy.

    axial: where the energy decides with the momentum about an axis of symmetry.
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
