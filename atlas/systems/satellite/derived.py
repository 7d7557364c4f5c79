"""Quantities from theory that a scene of the satellite may ask for."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from ...errors import BadInput
from ...flags import Stability
from ..base import Array, DerivedVariable, Points
from .equilibria import equilibria
from .initial import PARAMETERS


@lru_cache(maxsize=1 << 16)
def _counts(names: tuple[str, ...], values: tuple[float, ...]) -> tuple[float, float]:
    """Number of relative equilibria of one body and of the linearly stable ones; nan if any are not isolated."""
    try:
        solutions = equilibria(dict(zip(names, values, strict=True)))
    except (BadInput, RuntimeError):
        return np.nan, np.nan
    if solutions["circle"].any():
        return np.nan, np.nan
    return float(solutions["circle"].size), float((solutions["stable"] == Stability.STABLE).sum())


def count_equilibria(
    points: Points, duration: Array, pause: Callable[[], None] = lambda: None, stable: bool = False
) -> Array:
    """Number of relative equilibria of each body, (points,); nan where some form circles or surfaces.

    stable: only the linearly stable ones. pause: see DerivedVariable. About 70 ms for each body; points that differ in their start
    alone share one search.
    """
    names = tuple(name for name, parameter in PARAMETERS.items() if not parameter.start)
    rows = np.array([points[name] for name in names]).T.tolist()
    counts = np.empty(len(rows))
    for i, row in enumerate(rows):
        pause()
        counts[i] = _counts(names, tuple(row))[int(stable)]
    return counts


_COMMENT = "nan where some are not isolated; depends on body, rotor and fields alone"
DERIVED = {
    "equilibrium_count": DerivedVariable(
        "equilibrium_count", "1", "number of relative equilibria", count_equilibria, _COMMENT
    ),
    "equilibrium_stable_count": DerivedVariable(
        "equilibrium_stable_count",
        "1",
        "number of linearly stable relative equilibria",
        partial(count_equilibria, stable=True),
        _COMMENT,
    ),
}
