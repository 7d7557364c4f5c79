"""Quantities from theory that a scene of the satellite may ask for."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...flags import Completeness, Stability
from ..base import Array, DerivedVariable, Flags, Mask, Points, subset
from ..oscillations import oscillation_variables
from .equilibria import equilibria_of_bodies
from .initial import PARAMETERS
from .oscillations import energy_stability, frequencies

_BODY = tuple(name for name, parameter in PARAMETERS.items() if not parameter.start)


def count_equilibria(
    points: Points, duration: Array, pause: Callable[[], None] = lambda: None, which: str = "all"
) -> Array:
    """Number of relative equilibria of each body, (points,); nan where some form circles or surfaces.

    which: "all"; "stable", only the linearly stable ones; "energy_stable", only the minima of the amended potential.
    pause: see DerivedVariable. Points that differ in their start alone share one search.
    """
    rows, inverse = np.unique(np.stack([points[name] for name in _BODY], -1), axis=0, return_inverse=True)
    key = rows.tobytes()
    counts = _LAST.get(key)
    if counts is None:
        counts = _counts(dict(zip(_BODY, rows.T, strict=True)), pause)
        _LAST.clear()
        _LAST[key] = counts
    return counts[which][inverse]


# Counts of the bodies that were computed last: a scene asks for several counts of the same bodies.
_LAST: dict[bytes, dict[str, Array]] = {}


def _counts(bodies: Points, pause: Callable[[], None]) -> dict[str, Array]:
    """Numbers of equilibria of bodies (bodies,), by the argument `which` of count_equilibria."""
    countable = np.flatnonzero(~_symmetric(bodies))
    equilibria = equilibria_of_bodies(subset(bodies, countable), pause)
    isolated = np.isin(equilibria["completeness"], (Completeness.COMPLETE, Completeness.NEAR_BIFURCATION))
    counted = {
        "all": equilibria["index"] >= 0,
        "stable": equilibria["stable"] == Stability.STABLE,
        "energy_stable": (equilibria["index"] == 0) & ~equilibria["degenerate"],
    }
    result = {which: np.full(bodies["A"].size, np.nan) for which in counted}
    for which, where in counted.items():
        result[which][countable] = np.where(isolated, where.sum(1), np.nan)
    return result


def _symmetric(p: Points) -> Mask:
    """Bodies with an axis of symmetry about which every equilibrium can be turned: there is no need to search."""
    result = np.zeros(p["A"].shape, bool)
    no_field = (p["h1"] == 0) & (p["h3"] == 0)
    for i, (a, b) in enumerate((("B", "C"), ("A", "C"), ("A", "B"))):
        others = [j + 1 for j in range(3) if j != i]
        across = [(p[f"k{j}"] == 0) & ((p[f"mu{j}"] == 0) | no_field) for j in others]
        result |= (p[a] == p[b]) & np.all(across, axis=0)
    return result


def _family(points: Points) -> Flags:
    """Families of the steady motions that the points start."""
    from .system import SATELLITE  # which needs this module

    return SATELLITE.identify_family(points)[0]


def _linear_stability(points: Points, flags: Flags) -> tuple[Flags, Array]:
    """Linear stability of the steady motions that the points start."""
    from .system import SATELLITE  # which needs this module

    return SATELLITE.linear_stability(points, flags)


_COMMENT = "nan where some are not isolated; depends on body, rotor and fields alone"
_COUNTS = {
    name: DerivedVariable(
        name, "1", long_name, partial(count_equilibria, which=which), _COMMENT, is_count=True
    )
    for name, which, long_name in (
        ("equilibrium_count", "all", "number of relative equilibria"),
        ("equilibrium_stable_count", "stable", "number of linearly stable relative equilibria"),
        (
            "equilibrium_energy_stable_count",
            "energy_stable",
            "number of relative equilibria that are minima of the amended potential",
        ),
    )
}
DERIVED = _COUNTS | oscillation_variables(
    _family,
    _linear_stability,
    frequencies,
    energy_stability,
    "without damping; nan for exponents that are 0 or have a real part, off every family, and where the linear equations are"
    " periodic",
    "on the level of the momentum about an axis of symmetry, where there is one; unknown where the linear equations are"
    " periodic",
)
