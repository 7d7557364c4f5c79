"""The gyrostat about a fixed point in a central Newtonian field (Amer, Abo Essa, Ibrahim & Amer 2013)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..base import Array, Flags, System, stability_by_family
from . import equations, families, initial
from .equilibria import equilibria as permanent_rotations
from .paper import errors, published

GEOMETRIES = {
    "none": "drifting or unresolved",
    "sleeping": "the third axis stays on the vertical",
    "conical": "the body turns about its third axis, which precesses about the vertical or is at rest",
    "staude": "the body turns about the vertical alone (phi' = 0) or is at rest",
}


def geometry(
    measured: dict[str, Array],
    steady: NDArray[np.bool_],
    cylinder: NDArray[np.bool_],
    rate_tolerance: float,
    angle_tolerance: float,
) -> Flags:
    """Geometry of the measured motion, int8 flags of GEOMETRIES; steady and cylinder are bool."""
    without_spin = np.abs(measured["phi_dot_mean"]) <= rate_tolerance
    kind = np.where(cylinder, 1, np.where(without_spin, 3, 2))
    return np.where(steady, kind, 0).astype(np.int8)


def equilibria_of_body(body: Mapping[str, float]) -> dict[str, NDArray]:
    """All permanent rotations of one body about the vertical at the rate n; see equilibria.equilibria."""
    points = {name: np.full(1, float(body.get(name, p.default))) for name, p in initial.PARAMETERS.items()}
    found = permanent_rotations(points, float(points["n"][0]))
    gamma = np.stack([found.pop(name) for name in ("g1", "g2", "g3")], -1)
    angles = {"theta0": found.pop("theta"), "phi0": found.pop("phi")}
    return {**angles, "gamma": gamma, **found, "circle": found["dimension"] == 1}


FIXED_POINT = System(
    name="fixed_point",
    title="gyrostat about a fixed point in a central Newtonian field",
    frame="space",
    reference=(
        "T. S. Amer, Y. M. Abo Essa, I. A. Ibrahim, W. S. Amer, Int. J. Engineering Research and Applications"
        " 3(5) (2013) 655-671"
    ),
    doi="",
    equations=equations,
    parameters=initial.PARAMETERS,
    constants=initial.constants,
    initial_state=initial.initial_state,
    check=initial.check,
    integral_scales=initial.integral_scales,
    frequency_bound=initial.frequency_bound,
    steady_rates=families.steady_rates,
    families=families.FAMILIES,
    identify_family=families.identify_family,
    condition_residual=families.condition_residual,
    linear_stability=partial(stability_by_family, families.FAMILIES),
    geometries=GEOMETRIES,
    geometry=geometry,
    complete=lambda points: np.ones(points["A"].shape, bool),
    warnings=initial.warnings,
    specialization=initial.specialization,
    as_euler_angles=initial.as_euler_angles,
    derived=errors.DERIVED,
    published=lambda: published.PUBLISHED,
    equilibria=equilibria_of_body,
)
