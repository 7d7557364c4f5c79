"""Numbers of relative equilibria as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...systems.base import Array, DerivedVariable, Points, System, subset
from . import COUNTS


def count_variables(system: System) -> dict[str, DerivedVariable]:
    """Return variables that count relative equilibria of satellites. Counts are nan where equilibria are not isolated or not certain."""
    if system.frame_rate is None:
        return {}
    from ...systems.satellite import Satellite

    if not isinstance(system, Satellite):
        return {}

    def group(_: Any, points: Points, __: Array, pause: Callable[[], None]) -> dict[str, NDArray[Any]]:
        """Return the numbers of equilibria at points. Points that differ only in their start share one search."""
        from ..equilibria.algebra import numbers
        from ..equilibria.bodies import bodies_of

        bodies, row = bodies_of(system, points)
        # With an axis of symmetry no equilibrium is isolated, and no count exists.
        symmetric = np.any([system.body(bodies).symmetric_about(i) for i in range(3)], axis=0)
        countable, counts = np.flatnonzero(~symmetric), np.full((len(COUNTS), symmetric.size), np.nan)
        if countable.size:
            every = numbers(system.equilibria_of_bodies(subset(bodies, countable), pause))
            counts[:, countable] = [every[name] for name in COUNTS]
        return dict(zip(COUNTS, counts[:, row], strict=True))

    texts = (
        "number of relative equilibria",
        "number of linearly stable relative equilibria",
        "number of relative equilibria that are minima of the amended potential",
    )
    comment = "nan where some are not isolated or not certain; depends on body, rotor and fields alone"
    return {
        name: DerivedVariable.of_group(group, name, "1", text, comment)
        for name, text in zip(COUNTS, texts, strict=True)
    }
