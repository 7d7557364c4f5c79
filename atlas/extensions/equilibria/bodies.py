"""`System.equilibria` and `System.equilibria_of_bodies` for gyrostats that do not define these methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...systems.base import Array, Points, System
from ...systems.fixed_point.initial import VECTORS
from ...systems.fixed_point.system import FixedPoint
from ...systems.gyrostat import Gyrostat
from . import algebra, rotations


def equilibria(system: System, body: Mapping[str, float]) -> dict[str, NDArray[Any]] | None:
    """Return all relative equilibria of one body or, about a fixed point, all permanent rotations at the rate n."""
    if not isinstance(system, Gyrostat):
        return None
    points = system.with_defaults(body)
    if not isinstance(system, FixedPoint):
        return algebra.equilibria(system, points)
    solutions = rotations.rotations(system, _without_vectors(points))
    if solutions.pop("flat").any():
        raise BadInput(algebra.NOT_CERTAIN)
    return {name: values for name, values in solutions.items() if name != "row"}


def equilibria_of_bodies(
    system: System,
    points: Points,
    pause: Callable[[], None] = lambda: None,
    stability: bool = True,
    ordered: bool = False,
) -> dict[str, NDArray[Any]] | None:
    """Return equilibria of many bodies as `algebra.equilibria_of_bodies` does. For `FixedPoint`, `pause` and `stability` have no effect."""
    if isinstance(system, FixedPoint):
        return rotations.rotations_of_bodies(system, _without_vectors(points), ordered)
    if isinstance(system, Gyrostat):
        return algebra.equilibria_of_bodies(system, points, pause, stability, ordered)
    return None


def bodies_of(system: System, points: Points) -> tuple[Points, NDArray[np.int64]]:
    """Return the parameters of the distinct bodies of points, and the index of each point's body. Start parameters have their defaults."""
    names = [name for name, p in system.parameters.items() if not p.start]
    columns = np.stack([points[name] for name in names], -1)
    key = np.where(np.isnan(columns), -np.inf, columns)  # because nan is not equal to nan
    varying = (key != key[:1]).any(0)
    _, first, row = np.unique(key[:, varying], axis=0, return_index=True, return_inverse=True)
    bodies = {name: np.full(first.size, p.default) for name, p in system.parameters.items()}
    return bodies | dict(zip(names, columns[first].T, strict=True)), row.ravel()


def _without_vectors(points: Points) -> dict[str, Array]:
    """Return the points with nan for p0 .. gamma30, which means that angles give the start."""
    return {**points, **{name: np.full_like(points["A"], np.nan) for name in VECTORS}}
