"""The catalogue of a system for tables and queries: families, printed equations, equilibria of a body."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput
from ..flags import Stability
from ..systems.base import Family, PublishedEquation, System

DRAWS = 5  # random parameters behind each residual, from the seeds 0, 1, ...
_UNITS = {
    "theta0": ("rad", "angle from the vertical to the third body axis"),
    "psi0": ("rad", "precession angle; 0 where only its sum or difference with phi0 is defined"),
    "phi0": ("rad", "angle of proper rotation"),
    "alpha": ("1", "unit vector along the radius, in body axes"),
    "gamma": ("1", "unit vector along the vertical, in body axes"),
    "potential": ("J", "amended potential"),
    "index": ("1", "Morse index: number of directions in which the amended potential falls"),
    "circle": ("1", "does the solution stand for a circle of them?"),
    "axis": ("1", "unit axis in the body about which the body may be turned; nan where isolated"),
    "degenerate": ("1", "isolated, with a zero eigenvalue: on the bifurcation set"),
    "dimension": ("1", "dimension of the set of solutions: 0 isolated, 1 a circle, 2 every direction"),
    "growth_rate": ("rad s-1", "largest real part of the characteristic exponents"),
}


def families(system: System, name: str | None = None) -> list[dict[str, Any]]:
    """One row for each family of steady motions, or for the named one; texts, lists of texts and numbers.

    residual_printed and residual_true: the largest of the printed equations that belong to the family
    (see `printed`), None if there is none. Raises BadInput for an unknown name.
    """
    if name is not None and name not in system.families:
        raise BadInput(f"family {name}: unknown; allowed: {', '.join(system.families)}")
    rows = []
    for family in system.families.values():
        if name in (None, family.name):
            measured = [_max_residuals(row) for row in system.published() if row.family == family.name]
            row = _family(family)
            for i, key in enumerate(_RESIDUALS):
                row[key] = max((one for pair in measured if (one := pair[i]) is not None), default=None)
            rows.append(row)
    return rows


def _family(family: Family) -> dict[str, Any]:
    stability = (
        "No closed form: eigenvalues of the linear equations at an equilibrium, else Floquet multipliers over"
        " the period of the rotation."
    )
    if family.stability is not None:
        stability = " ".join((inspect.getdoc(family.stability) or "").split())
    return {
        "family": family.name,
        "equations": family.equations,
        "motion": family.title,
        "conditions": [condition.text for condition in family.conditions],
        "exists": family.exists,
        "solves_for": list(family.solve),
        "leaves_free": list(family.free),
        "geometry": family.geometry or "depends on the point",
        "labels": family.labels,
        "paper_wording": family.paper_wording,
        "stability": stability,
    }


_RESIDUALS = ("residual_printed", "residual_true")


def published(system: System, family: str | None = None, errata: bool = False) -> list[dict[str, Any]]:
    """One row for each printed equation of the system's paper as printed and as true; texts and numbers.

    family: only those that belong to it; errata: only those whose verdict is not "true". The residuals
    are the largest of DRAWS random parameters, the same in every call; None where nothing is measured.
    """
    return [
        {
            "equation": row.number,
            "family": row.family,
            "verdict": row.verdict,
            "printed": row.printed,
            "true": row.true,
            "measure": row.measure,
            **dict(zip(_RESIDUALS, _max_residuals(row), strict=True)),
            "effect": row.effect,
        }
        for row in system.published()
        if family in (None, row.family) and not (errata and row.verdict == "true")
    ]


def _max_residuals(row: PublishedEquation) -> tuple[float | None, float | None]:
    """Largest residual of both readings."""
    both = (row.residual_printed, row.residual_true)
    one, other = (None if f is None else max(f(np.random.default_rng(i)) for i in range(DRAWS)) for f in both)
    return one, other


def equilibria(system: str, body: Mapping[str, float]) -> xr.Dataset:
    """All relative equilibria of a satellite, or permanent rotations about the vertical of a gyrostat.

    system: "satellite" or "fixed_point". body: parameter -> number, those left out take their defaults;
    start values have no say but n of the fixed_point, the rate of rotation (default 0: rest). Returns a
    Dataset with the dimension "equilibrium": theta0, phi0 and, for the satellite, psi0 (rad), gamma
    (equilibrium, body_axis), index, circle, stable (flags), growth_rate (rad per time unit); for the
    satellite also alpha, axis, degenerate, potential, in the order of the potential; for the fixed_point
    dimension, in the order of theta0. What comes as a circle is there once, by one of its members.

    Raises BadInput for bodies that cannot be, and where every orientation is an equilibrium.
    """
    from ..scene.tables import point_columns

    kind = systems.get(system)
    assert kind.equilibria is not None
    columns, size = point_columns(kind, body)
    if size != 1:
        raise BadInput(f"body: {size} bodies given; equilibria are those of one")
    kind.check(columns)
    ds = xr.Dataset(attrs={"title": f"equilibria of one body: {kind.title}", "references": kind.reference})
    for name, values in kind.equilibria({k: float(v[0]) for k, v in columns.items()}).items():
        dims = ("equilibrium", "body_axis")[: values.ndim]
        if name == "stable":
            meanings = " ".join(Stability.meanings())
            attributes: dict[str, Any] = {"long_name": "linear stability", "flag_meanings": meanings}
            attributes["flag_values"] = np.arange(len(Stability), dtype="int8")
        else:
            attributes = dict(zip(("units", "long_name"), _UNITS[name], strict=True))
        ds[name] = (dims, values, attributes)
    for name, column in columns.items():
        parameter = kind.parameters[name]
        if not parameter.start:
            ds = ds.assign_coords(
                {name: ((), column[0], {"units": parameter.unit, "long_name": parameter.meaning})}
            )
    return ds
