"""The catalogue of a system as tables: families, published equations, equilibria of a body."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput
from ..flags import Stability
from ..scene.tables import point_columns
from ..systems.base import Family, PublishedEquation, System

N_SAMPLES = 5  # random parameters behind each residual, from the seeds 0, 1, ...
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
    """Families of exact steady motions.

    Parameters
    ----------
    system : System
        The system that has the families.
    name : str, optional
        Only this one.

    Returns
    -------
    list of dict
        One row for each family: texts, lists of texts and numbers. residual_printed and residual_true
        are the largest of the published equations that belong to the family, None if there is none.

    Raises
    ------
    BadInput
        If the system has no family of this name.
    """
    if name is not None and name not in system.families:
        raise BadInput(f"family {name}: unknown; allowed: {', '.join(system.families)}")
    return [_family(system, family) for family in system.families.values() if name in (None, family.name)]


def _family(system: System, family: Family) -> dict[str, Any]:
    """The row of a family."""
    stability = (
        "No closed form: eigenvalues of the linear equations at an equilibrium, else Floquet multipliers over"
        " the period of the rotation."
    )
    if family.stability is not None:
        stability = " ".join((inspect.getdoc(family.stability) or "").split())
    description = {
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
    return description | _max_residuals([row for row in system.published() if row.family == family.name])


def published(system: System, family: str | None = None, errata: bool = False) -> list[dict[str, Any]]:
    """Published equations of the system's paper, as printed and as true.

    Parameters
    ----------
    system : System
        The system of the paper.
    family : str, optional
        Only those that belong to this family.
    errata : bool, optional
        Only those whose verdict is not "true".

    Returns
    -------
    list of dict
        One row for each equation: texts and numbers. The residuals are the largest at N_SAMPLES random
        parameters, the same in every call; None where nothing is measured.
    """
    return [
        {
            "equation": row.number,
            "family": row.family,
            "verdict": row.verdict,
            "printed": row.printed,
            "true": row.true,
            "measure": row.measure,
            **_max_residuals([row]),
            "effect": row.effect,
        }
        for row in system.published()
        if family in (None, row.family) and not (errata and row.verdict == "true")
    ]


def _max_residuals(rows: Iterable[PublishedEquation]) -> dict[str, float | None]:
    """Largest residuals of some equations as printed and as true, None where nothing is measured."""
    maxima = {}
    for key in ("residual_printed", "residual_true"):
        residuals = [residual for row in rows if (residual := getattr(row, key)) is not None]
        seeds = range(N_SAMPLES)
        maxima[key] = max((f(np.random.default_rng(seed)) for f in residuals for seed in seeds), default=None)
    return maxima


def equilibria(system: str, body: Mapping[str, float]) -> xr.Dataset:
    """All relative equilibria of a satellite, or permanent rotations of a heavy gyrostat about the vertical.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float
        Parameter -> number; those left out take their defaults. Start values have no effect, except n
        of the fixed_point, the rate of rotation in rad per time unit (default 0: rest).

    Returns
    -------
    Dataset
        Dimension "equilibrium"; a circle of equilibria is there once, by one of its members. Variables:
        theta0, phi0 and, for the satellite, psi0 (rad), gamma (equilibrium, body_axis), index, circle,
        stable (flags), growth_rate (rad per time unit). For the satellite also alpha, axis, degenerate,
        potential, in the order of the potential; for the fixed_point dimension, in the order of theta0.

    Raises
    ------
    BadInput
        For bodies that cannot exist, and where every orientation is an equilibrium.
    """
    description = systems.get(system)
    if description.equilibria is None:
        raise BadInput(f"equilibria: the system {system} has no function that computes them")
    columns, size = point_columns(description, body)
    if size != 1:
        raise BadInput(f"body: {size} bodies given; equilibria are those of one")
    description.check(columns)
    description.check_possible(columns)
    title = f"equilibria of one body: {description.title}"
    ds = xr.Dataset(attrs={"title": title, "references": description.reference})
    for name, values in description.equilibria({k: float(v[0]) for k, v in columns.items()}).items():
        ds[name] = (("equilibrium", "body_axis")[: values.ndim], values, _attributes(name))
    for name, column in columns.items():
        parameter = description.parameters[name]
        if not parameter.start:
            attributes = {"units": parameter.unit, "long_name": parameter.meaning}
            ds = ds.assign_coords({name: ((), column[0], attributes)})
    return ds


def _attributes(name: str) -> dict[str, Any]:
    """CF attributes of a variable of `equilibria`."""
    if name == "stable":
        return {
            "long_name": "linear stability",
            "flag_meanings": " ".join(Stability.meanings()),
            "flag_values": np.arange(len(Stability), dtype="int8"),
        }
    return dict(zip(("units", "long_name"), _UNITS.get(name, ("1", name)), strict=True))
