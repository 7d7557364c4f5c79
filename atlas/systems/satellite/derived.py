"""Quantities from theory that a scene of the satellite may ask for."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...flags import Completeness, Stability
from ..base import Array, DerivedVariable, Mask, Points
from .equilibria import equilibria_of_bodies
from .initial import PARAMETERS

_BODY = tuple(name for name, parameter in PARAMETERS.items() if not parameter.start)


def count_equilibria(
    points: Points, duration: Array, pause: Callable[[], None] = lambda: None, which: str = "all"
) -> Array:
    """Number of relative equilibria of each body, (points,); nan where some form circles or surfaces.

    which: "all"; "stable", only the linearly stable ones; "energy_stable", only the minima of the amended potential.
    pause: see DerivedVariable. Points that differ in their start alone share one search.
    """
    rows, inverse = np.unique(np.stack([points[name] for name in _BODY], -1), axis=0, return_inverse=True)
    bodies = dict(zip(_BODY, rows.T, strict=True))
    countable = ~_symmetric(bodies)
    counts = np.full(len(rows), np.nan)
    part = {name: values[countable] for name, values in bodies.items()}
    result = equilibria_of_bodies(part, pause, stability=which == "stable")
    counted = {
        "all": result["index"] >= 0,
        "stable": result.get("stable", result["index"]) == Stability.STABLE,
        "energy_stable": (result["index"] == 0) & ~result["degenerate"],
    }[which]
    isolated = np.isin(result["completeness"], (Completeness.COMPLETE, Completeness.NEAR_BIFURCATION))
    counts[countable] = np.where(isolated, counted.sum(1), np.nan)
    return counts[inverse]


def _symmetric(p: Points) -> Mask:
    """Bodies with an axis of symmetry about which every equilibrium can be turned: there is no need to search."""
    result = np.zeros(p["A"].shape, bool)
    no_field = (p["h1"] == 0) & (p["h3"] == 0)
    for i, (a, b) in enumerate((("B", "C"), ("A", "C"), ("A", "B"))):
        others = [j + 1 for j in range(3) if j != i]
        across = [(p[f"k{j}"] == 0) & ((p[f"mu{j}"] == 0) | no_field) for j in others]
        result |= (p[a] == p[b]) & np.all(across, axis=0)
    return result


_COMMENT = "nan where some are not isolated; depends on body, rotor and fields alone"
DERIVED = {
    name: DerivedVariable(name, "1", long_name, partial(count_equilibria, which=which), _COMMENT)
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
