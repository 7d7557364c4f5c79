"""Numbers of relative equilibria as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import Completeness, Stability
from ...systems.base import Array, DerivedVariable, Points, System, subset
from ...systems.satellite import Satellite


def count_variables(system: System) -> dict[str, DerivedVariable]:
    """Numbers of relative equilibria of satellites; nan where some form circles or surfaces, or are not certain."""
    if not isinstance(system, Satellite):
        return {}

    def together(_: Any, points: Points, __: Array, pause: Callable[[], None]) -> dict[str, NDArray[Any]]:
        """Points that differ in their start alone share one search."""
        bodies, row = system.bodies_of(points)
        # About an axis of symmetry every equilibrium can be turned: there is no need to search.
        symmetric = np.any([system.body(bodies).symmetric_about(i) for i in range(3)], axis=0)
        countable, counts = np.flatnonzero(~symmetric), np.full((len(rows), symmetric.size), np.nan)
        if countable.size:
            equilibria = system.equilibria_of_bodies(subset(bodies, countable), pause)
            whole, index = equilibria["completeness"] == Completeness.COMPLETE, equilibria["index"]
            stable = equilibria["stable"] == Stability.STABLE
            for count, counted in zip(counts, (index >= 0, stable, index == 0), strict=True):
                count[countable] = np.where(whole, counted.sum(1), np.nan)
        return {name: values[row] for (name, *_), values in zip(rows, counts, strict=True)}

    comment = "nan where some are not isolated or not certain; depends on body, rotor and fields alone"
    rows = (
        ("equilibrium_count", "number of relative equilibria"),
        ("equilibrium_stable_count", "number of linearly stable relative equilibria"),
        ("equilibrium_energy_stable_count",
         "number of relative equilibria that are minima of the amended potential"),
    )  # fmt: skip
    return {name: DerivedVariable.of_group(together, name, "1", text, comment) for name, text in rows}
