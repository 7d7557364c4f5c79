"""The magnetised satellite-gyrostat on a circular orbit (Yehia & El-kenani 2021)."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from ...errors import BadInput
from ..base import Array, DerivedVariable, Flags, Mask, Points, PublishedEquation, System, check_inertia
from . import equations, equilibria, families, initial, stability

GEOMETRIES = {
    "none": "drifting or unresolved",
    "cylindrical": "the third axis stays on the orbit normal",
    "perp_radius": "the third axis is at rest in the orbital frame, perpendicular to the radius",
    "perp_velocity": "the third axis is at rest in the orbital frame, perpendicular to the velocity",
    "oblique": "the third axis is at rest in the orbital frame in another direction",
    "general": "the third axis precesses in the orbital frame",
}


def geometry(
    measured: dict[str, Array], steady: Mask, cylinder: Mask, rate_tolerance: float, angle_tolerance: float
) -> Flags:
    """Geometry of the measured motion, int8 flags of GEOMETRIES; steady and cylinder are bool.

    The direction of the third axis is its mean over the run; angle_tolerance in rad.
    """
    kinds = [
        ~steady,
        cylinder,
        np.abs(measured["psi_dot_mean"]) > rate_tolerance,
        np.abs(measured["axis_1"]) <= angle_tolerance,
        np.abs(measured["axis_2"]) <= angle_tolerance,
    ]
    values = [0, 1, 5, 2, 3]
    return np.asarray(np.select(kinds, values, 4)).astype(np.int8)


def warn(points: Points) -> list[str]:
    """Remarks on a set of points that a user should see; labels speak of the third axis alone."""
    A, B, C = points["A"], points["B"], points["C"]
    other = (A != B) & ((B == C) | (A == C))
    if not other.any():
        return []
    return [
        f"{other.sum()} points have A != B but B = C or A = C: labels speak of the third axis, so a steady"
        " motion about the body's axis of symmetry reads as drifting"
    ]


@lru_cache(maxsize=1 << 16)
def _counts(names: tuple[str, ...], values: tuple[float, ...]) -> tuple[float, float]:
    try:
        found = equilibria.equilibria(dict(zip(names, values, strict=True)))
    except (BadInput, RuntimeError):
        return np.nan, np.nan
    if found["circle"].any():
        return np.nan, np.nan
    return float(found["circle"].size), float((found["stable"] == 1).sum())


def count_equilibria(points: Points, duration: Array, stable: bool = False) -> Array:
    """Number of relative equilibria of each body, float64; nan where some come as circles or surfaces.

    stable: only the linearly stable ones. About 70 ms for each body; points that differ in their start
    alone share one search.
    """
    body = [name for name, parameter in initial.PARAMETERS.items() if not parameter.start]
    rows = np.array([points[name] for name in body]).T.tolist()
    return np.array([_counts(tuple(body), tuple(row))[int(stable)] for row in rows])


_COUNTED = "nan where some are not isolated; depends on body, rotor and fields alone"
LAYERS = {
    layer.name: layer
    for layer in (
        DerivedVariable("equilibrium_count", "1", "number of relative equilibria", count_equilibria, _COUNTED),
        DerivedVariable(
            "equilibrium_stable_count", "1", "number of linearly stable relative equilibria",
            partial(count_equilibria, stable=True), _COUNTED,
        ),
    )
}  # fmt: skip


def printed() -> tuple[PublishedEquation, ...]:
    """The equations of the paper; see `printed.PRINTED`."""
    from .paper.published import PUBLISHED

    return PUBLISHED


SATELLITE = System(
    name="satellite",
    title="magnetised satellite-gyrostat on a circular orbit",
    frame="orbital",
    reference="H. M. Yehia, H. N. El-kenani, J. Appl. Comput. Mech. 7(4) (2021) 2120-2128",
    doi="10.22055/JACM.2021.37913.3113",
    equations=equations,
    parameters=initial.PARAMETERS,
    constants=initial.constants,
    initial_state=initial.initial_state,
    check=check_inertia,
    integral_scales=initial.integral_scales,
    frequency_bound=initial.frequency_bound,
    steady_rates=initial.steady_rates,
    families=families.FAMILIES,
    identify_family=families.identify_family,
    condition_residual=families.condition_residual,
    linear_stability=stability.linear_stability,
    geometries=GEOMETRIES,
    geometry=geometry,
    frame_rate=lambda points: points["Omega"],
    complete=lambda points: points["Omega"] > 0,
    warnings=warn,
    specialization=initial.specialization,
    derived=LAYERS,
    published=printed,
    equilibria=equilibria.equilibria,
)
