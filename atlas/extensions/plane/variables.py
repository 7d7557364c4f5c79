"""Period and multipliers of motions in the plane as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...systems.base import Array, DerivedVariable, Points, System, subset, unsteady

_CHUNK = 4096  # number of points whose multipliers are computed between two pauses


def variables(system: System) -> dict[str, DerivedVariable]:
    """Return variables for the period and the multipliers of a satellite's motions in the plane of the orbit. Other motions have nan."""
    if system.name != "satellite":
        return {}
    from ...systems.satellite import SATELLITE  # only the satellite needs this

    names = ("plane_period", "plane_trace", "plane_second")

    def group(_: Any, points: Points, __: Array, pause: Callable[[], None]) -> dict[str, NDArray[Any]]:
        from .motions import PlaneMotions

        with np.errstate(all="ignore"):  # Products of parameters may overflow.
            flags = system.identify_family(points)[0]
        columns, members = np.full((3, flags.size), np.nan), np.flatnonzero(unsteady(system, flags))
        for first in range(0, members.size, _CHUNK):
            pause()
            some = members[first : first + _CHUNK]
            part = subset(points, some)
            with np.errstate(all="ignore"):
                motions = PlaneMotions.of(SATELLITE.body(part), *SATELLITE.start(part))
                columns[:, some] = motions.period(), *motions.multipliers()
        return dict(zip(names, columns, strict=True))

    equation = "of rho^2 - t rho + s - 2 = 0, rho = multiplier + 1/multiplier, over the period; nan where that is too long"
    rows = (
        (names[0], "s", "period of the libration in the plane, or of a whole turn", ""),
        (names[1], "1", "sum of the multipliers out of the plane, t", equation),
        (names[2], "1", "sum of the products of two multipliers out of the plane, s", equation),
    )
    return {row[0]: DerivedVariable.of_group(group, *row) for row in rows}
