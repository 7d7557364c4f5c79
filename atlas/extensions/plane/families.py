"""Librations and rotations in the plane of the orbit, of an asymmetric body whose third axis stays on the normal.

These motions are not steady, because the rate about the normal varies. The theory is in `motions`, where x is the pitch
chi = phi + psi cos theta0. In the attitude with x = 0 the axis of the smaller of A and B is along the radius.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...systems.base import Array, Condition, Family, Flags, Points, System
from ...systems.gyrostat.motions import Equation, each
from ...systems.satellite import SATELLITE
from ...systems.satellite import conditions as the
from ...systems.satellite.families import nearest_pole
from ...systems.satellite.initial import directions
from ...systems.vectors import ratio

if TYPE_CHECKING:
    from .motions import PlaneMotions


def motions(points: Points) -> PlaneMotions:
    """Return the motions in the plane from the starts of points."""
    from .motions import PlaneMotions  # Scenes need this only where a start may be on a family.

    return PlaneMotions.of(SATELLITE.body(points), *SATELLITE.start(points))


def stability(points: Points, rough: bool = False) -> tuple[Flags, Array]:
    """Stability out of the plane, by Floquet multipliers; unknown where the period is too long, near the separatrix. In the plane
    neighbouring motions have other periods, and their distance grows like t.
    """
    return motions(points).stability(rough)


def _excess(p: Points) -> Array:
    """Return (T - V) / (T + V), where T is the kinetic energy, and V the height of the barrier above the potential at the start."""
    alpha, rate = directions(p)[0], p["n"] * the.tilt(p)[1] + p["m"]
    barrier = 3 * p["Omega"] ** 2 * np.abs(p["B"] - p["A"]) * np.where(p["A"] < p["B"], *alpha[:2] ** 2)
    kinetic = p["C"] * rate**2
    return ratio(kinetic - barrier, kinetic + barrier)


def _bottom(p: Points) -> Array:
    """Return the psi nearest to psi0 at which the axis of the smaller of A and B lies along the radius."""
    bottom = np.sign(the.tilt(p)[1]) * (np.where(p["A"] < p["B"], 0.0, np.pi / 2) - p["phi0"])
    return bottom + np.pi * np.round((p["psi0"] - bottom) / np.pi)


_family = partial(
    Family,
    stability=stability,
    rough_stability=partial(stability, rough=True),
    rate_std=lambda points, duration: motions(points).rate_std(duration),
    labels="drifting; permanent rotation in both frames where the rate varies by no more than rate_tolerance",
    several={"theta0": "0", "psi0": "that nearest to 0"},
    free=("C", "k3", "h3"),
)
CONDITIONS = (
    the.STEADY_TILT, the.UPRIGHT, the.AXIAL_ROTOR, the.AXIAL_MAGNET, the.NO_RADIAL_TORQUE, the.NO_DRAG,
    Equation("damping = 0", lambda p: p["damping"], the.momentum_scale),
    Condition("Omega > 0", lambda p: np.where(p["Omega"] > 0, 0.0, 1.0)),
    Condition("A != B", lambda p: np.where(p["A"] == p["B"], 1.0, 0.0)),
)  # fmt: skip
_ENERGY = "C (n cos theta0 + m)^2 {} 3 Omega^2 |B - A| cos^2 chi"
_LIBRATES = Condition(_ENERGY.format("<"), lambda p: np.where(_excess(p) < 0, 0.0, 1 + _excess(p)))
_ROTATES = Condition(_ENERGY.format(">"), lambda p: np.where(_excess(p) > 0, 0.0, 1 - _excess(p)))
_SOLVE = {**each(nearest_pole, "theta0"), "psi0": _bottom}
_BOTTOM = "psi0 is solved for the bottom, where n and m are the largest rate"
FAMILIES = {
    family.name: family
    for family in (
        _family(
            name="plane_libration",
            equations="references [4], [6], [7]; with rotor and magnet derived from (1)-(3)",
            conditions=(*CONDITIONS, _LIBRATES),
            solve={**_SOLVE, "m": lambda p: -p["n"] * the.tilt(p)[1]},
            exists=f"{_BOTTOM}; m for rest, where the pitch is the amplitude",
        ),
        _family(
            name="plane_rotation",
            equations="references [6], [7]; with rotor and magnet derived from (1)-(3)",
            conditions=(*CONDITIONS, _ROTATES),
            solve=_SOLVE,
            exists=_BOTTOM,
        ),
    )
}


def families(system: System) -> dict[str, Family]:
    """Return the families of the satellite itself. A system derived from the satellite may have other equations."""
    return FAMILIES if system is SATELLITE else {}
