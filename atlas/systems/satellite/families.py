"""The families of exact steady motions theta = theta0, psi' = n, phi' = m of the satellite.

Together they are all of them for Omega > 0. They follow from the equations of motion of (1)-(3) of
Yehia & El-kenani 2021 (doi 10.22055/JACM.2021.37913.3113) by asking that w' = n gamma + m e3 be a
solution for all t; `tests/systems/test_satellite_families.py` proves each from those equations. Short names:
c, s = cos, sin theta0; H = (h1 cos psi0, h3 s - h1 c sin psi0, h3 c + h1 s sin psi0) is the field in
the axes of the node, where e3 is the third; w3 = (n + Omega) c + m; K = k1 + i k2, U = mu1 + i mu2;
a = (A + B) / 2. With n = 0 and A = B the motion is steady if and only if (m not zero)

    w3 K = H3 U,   Omega s K = (H2 + i H1) U,   cos psi0 (3 Omega^2 s sin psi0 (a - C) - h1 mu3) = 0,
    Omega s (k3 + C m) = Omega^2 s c (a - C) (1 + 3 sin^2 psi0) + mu3 H2.                       (*)

Their conditions are in `conditions`, the formulas that solve these for one parameter in `solutions`, the closed
forms of their stability in `closed_stability`. The families overlap; a point belongs to the first that holds, in
the order of FAMILIES. Residuals are divided by natural scales: largest inertia J, rate
w = Omega + |n| + |m| + |theta_dot0|, momentum J w + |k|, torque w (J w + |k|) + |mu| |h|. With Omega = 0 every
family below is still exact, but a free or heavy body has more steady motions than these. With damping a steady
motion keeps its Jacobi integral only at rest in the orbital frame, w' = 0: these motions alone remain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base import Array, Family, Points
from ..vectors import length
from .closed_stability import stability_about_normal, stability_spherical, stability_tilted
from .conditions import (
    ASYMMETRIC_TILT_ANGLE,
    ASYMMETRIC_TILT_SPIN,
    AXIAL_MAGNET,
    AXIAL_ROTOR,
    DESPUN,
    DESPUN_BALANCE,
    EQUAL_B_AND_C,
    FIELD_ACROSS,
    NO_AXIAL_RADIAL_TORQUE,
    NO_DISSIPATION,
    NO_PRECESSION,
    NO_RADIAL_TORQUE,
    NO_ROTATION,
    NO_SPIN,
    NO_TORQUE_ABOUT_NORMAL,
    NO_TORQUE_ACROSS_NORMAL,
    NO_TRANSVERSE_TORQUE,
    NODE_ON_RADIUS,
    NODE_ON_VELOCITY,
    NODE_PAIR,
    NORMAL_ROTOR,
    OBLIQUE_BALANCE,
    SPHERICAL_BALANCE,
    SPINNING_PAIR,
    STEADY_TILT,
    SYMMETRIC,
    SYMMETRY_ABOUT_NORMAL,
    TILT_BALANCE,
    UPRIGHT,
)
from .equations import rhs
from .initial import constants, initial_state
from .quantities import magnetic_moment, relative_to
from .solutions import (
    formulas,
    solve_cylindrical,
    solve_despun,
    solve_h1,
    solve_h1_equilibrium,
    solve_h1_tilt,
    solve_h3,
    solve_k3,
    solve_k_equilibrium,
    solve_k_other_axis,
    solve_m,
    solve_m_equilibrium,
    solve_mu3_despun,
    solve_node_pair,
    solve_oblique,
    solve_psi_oblique,
    solve_psi_on_radius,
    solve_psi_on_velocity,
    solve_spherical,
    solve_theta,
    solve_theta_tilt,
    solve_theta_upright,
    solve_transverse,
)


def steady_motion(points: Points, t: Array) -> Array:
    """State of the steady motion theta = theta0, psi = n t + psi0, phi = m t + phi0.

    Shape (9, *t.shape, *points.shape), in the order of equations.STATE; theta_dot0 is taken as 0. It
    solves the equations of motion where the point is on a family.
    """
    t = np.asarray(t, float)
    times = t.reshape(t.shape + (1,) * np.ndim(points["A"]))
    moved = {name: np.broadcast_to(value, np.broadcast_shapes(times.shape, np.shape(value)))
             for name, value in points.items()}  # fmt: skip
    return initial_state(
        {
            **moved,
            "psi0": points["psi0"] + points["n"] * times,
            "phi0": points["phi0"] + points["m"] * times,
            "theta_dot0": np.zeros_like(moved["theta_dot0"]),
        }
    )


_SYMMETRIC_TILT = (STEADY_TILT, NO_PRECESSION, SYMMETRIC, AXIAL_ROTOR, AXIAL_MAGNET)
_TILT_LABELS = (
    "permanent rotation about the third axis in the orbital frame; in space regular precession (Omega, m),"
    " permanent rotation where m = 0"
)
_TABLE = (
    Family(
        name="cylindrical",
        flag=1,
        title="third axis along the orbit's normal, symmetric body turning about it at n +- m",
        equations="(14)-(16), (21)-(23), (29)-(31), (44), (45)",
        conditions=(STEADY_TILT, UPRIGHT, SYMMETRIC, NO_RADIAL_TORQUE, SPINNING_PAIR),
        solve={"theta0": solve_theta_upright, **formulas(solve_cylindrical, "mu1", "mu2", "k1", "k2")},
        stability=stability_about_normal,
        geometry="cylindrical",
        paper_wording="n = 0: cylindrical permanent rotation (orbital), cylindrical regular precession "
        "(inertial); n != 0: cylindrical regular precession in both",
        labels="permanent rotation in both frames, about the normal at n +- m and in space at n + Omega +- m",
        exists="w3 = 0 only with H3 mu1 = H3 mu2 = 0; k1 and k2 are then free",
        free=("C", "k3", "psi0", "phi0"),
    ),
    Family(
        name="equilibrium",
        flag=2,
        title="any body at rest in the orbital frame",
        equations="(27), (28) at theta0 = pi; otherwise derived from (1)-(3)",
        conditions=(
            STEADY_TILT,
            NO_ROTATION,
            NO_TORQUE_ABOUT_NORMAL,
            NO_TORQUE_ACROSS_NORMAL,
        ),
        solve={
            "m": solve_m_equilibrium,
            "h1": solve_h1_equilibrium,
            **formulas(solve_k_equilibrium, "k3", "k1", "k2"),
        },
        paper_wording="equilibrium position (orbital), cylindrical regular precession (inertial)",
        labels="at rest in the orbital frame, turning with it in space: permanent rotation in both",
        exists="every orientation without torque about the normal has such a rotor, k is free along the normal;"
        " atlas.equilibria finds all orientations of a given body",
        free=("damping",),
    ),
    Family(
        name="perp_radius",
        flag=3,
        title="third axis at rest in the plane of normal and velocity, symmetric body spinning at m",
        equations="(17), (18)",
        conditions=(*_SYMMETRIC_TILT, NODE_ON_RADIUS, NO_AXIAL_RADIAL_TORQUE, TILT_BALANCE),
        solve={
            "psi0": solve_psi_on_radius,
            "theta0": solve_theta,
            "m": solve_m,
            "h3": solve_h3,
            "k3": solve_k3,
        },
        stability=stability_tilted,
        geometry="perp_radius",
        paper_wording="conical permanent rotation (orbital), conical regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="every theta0; for given k3 and m: |k3 + C m - mu3 h3 / Omega| <= Omega |A - C|",
        free=("phi0",),
    ),
    Family(
        name="perp_velocity",
        flag=4,
        title="third axis at rest in the plane of normal and radius, symmetric body spinning at m",
        equations="(24), (25)",
        conditions=(*_SYMMETRIC_TILT, NODE_ON_VELOCITY, TILT_BALANCE),
        solve={
            "psi0": solve_psi_on_velocity,
            "theta0": solve_theta,
            "m": solve_m,
            "h1": solve_h1,
            "h3": solve_h3,
            "k3": solve_k3,
        },
        stability=stability_tilted,
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="every theta0, but sin theta0 = 0 only if h1 mu3 = 0; for given k3 and m without h1 mu3:"
        " |k3 + C m - mu3 h3 / Omega| <= 4 Omega |A - C|",
        free=("phi0",),
    ),
    Family(
        name="oblique",
        flag=5,
        title="third axis at rest in an oblique plane through the normal, symmetric body with axial magnet",
        equations="derived from (1)-(3); not in the paper",
        conditions=(*_SYMMETRIC_TILT, OBLIQUE_BALANCE, TILT_BALANCE),
        solve={
            "psi0": solve_psi_oblique,
            **formulas(solve_oblique, "h1", "mu3"),
            "m": solve_m,
            "h3": solve_h3,
            "k3": solve_k3,
        },
        stability=stability_tilted,
        geometry="oblique",
        labels=_TILT_LABELS,
        exists="|h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|: from perp_radius at h1 mu3 = 0 to perp_velocity at equality",
        free=("phi0",),
    ),
    Family(
        name="transverse_magnet",
        flag=6,
        title="as perp_velocity, with rotor and magnet across the third axis",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            STEADY_TILT, NO_PRECESSION, SYMMETRIC, NODE_ON_VELOCITY, SPINNING_PAIR, NODE_PAIR,
            TILT_BALANCE,
        ),
        solve={
            "psi0": solve_psi_on_velocity,
            **formulas(solve_transverse, "m", "h1", "h3"),
            **formulas(solve_node_pair, "k1", "k2"),
            "k3": solve_k3,
        },
        geometry="perp_velocity",
        labels=_TILT_LABELS,
        exists="where mu1 or mu2 is not 0: sin psi0 h1 (Omega + m cos theta0) = m sin theta0 h3",
        free=("phi0",),
    ),
    Family(
        name="despun_transverse",
        flag=7,
        title="symmetric body without rotation about its axis (w3 = 0), rotor and magnet across it",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            STEADY_TILT, NO_PRECESSION, SYMMETRIC, DESPUN, FIELD_ACROSS, NODE_PAIR, DESPUN_BALANCE,
            TILT_BALANCE,
        ),
        solve={
            **formulas(solve_despun, "m", "h1", "h3"),
            "mu3": solve_mu3_despun,
            **formulas(solve_node_pair, "k1", "k2"),
            "k3": solve_k3,
        },
        labels=_TILT_LABELS,
        exists="cos psi0 = 0, or |h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|",
        free=("phi0",),
    ),
    Family(
        name="asymmetric_tilt",
        flag=8,
        title="any body, third axis at 60 or 120 degrees in the plane of normal and radius, m = -+Omega",
        equations="(19), (20); 120 degrees and psi0 = -pi/2 derived from (1)-(3)",
        conditions=(
            STEADY_TILT,
            NO_PRECESSION,
            ASYMMETRIC_TILT_ANGLE,
            ASYMMETRIC_TILT_SPIN,
            NODE_ON_VELOCITY,
            SPINNING_PAIR,
            NODE_PAIR,
            TILT_BALANCE,
        ),
        solve={
            "theta0": solve_theta_tilt,
            "psi0": solve_psi_on_velocity,
            "m": lambda p: -2 * p["Omega"] * np.cos(p["theta0"]),
            "h1": solve_h1_tilt,
            **formulas(solve_node_pair, "k1", "k2"),
            "k3": solve_k3,
        },
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="mu1 = mu2 = 0, or h1 = -sin psi0 sgn(cos theta0) sqrt(3) h3",
        free=("phi0",),
    ),
    Family(
        name="spherical",
        flag=9,
        title="spherical body, any tilt, precession and spin",
        equations="remarks after (31) and (45), completed from (1)-(3)",
        conditions=(
            STEADY_TILT,
            SYMMETRIC,
            EQUAL_B_AND_C,
            AXIAL_ROTOR,
            NO_RADIAL_TORQUE,
            NO_TRANSVERSE_TORQUE,
            SPHERICAL_BALANCE,
        ),
        solve=formulas(solve_spherical, "n", "m", "h3", "k3"),
        stability=stability_spherical,
        geometry="general",
        paper_wording="spherical symmetry: regular precession",
        labels="regular precession (n, m) in the orbital frame and (n + Omega, m) in space; permanent rotation where"
        " one of the two rates is 0",
        exists="n = -Omega only with h3 mu3 = 0; k3 and m are then free",
        free=("theta0", "psi0", "phi0"),
    ),
    Family(
        name="other_axis",
        flag=10,
        title="rotation at n about an axis of symmetry other than the third, which lies along the normal",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            STEADY_TILT,
            NO_SPIN,
            SYMMETRY_ABOUT_NORMAL,
            NO_RADIAL_TORQUE,
            NORMAL_ROTOR,
        ),
        solve=formulas(solve_k_other_axis, "k3", "k1", "k2"),
        stability=stability_about_normal,
        geometry="general",
        labels="permanent rotation in both frames, about the normal at n and in space at n + Omega",
        exists="n = -Omega only with h3 mu along the normal; k is then free",
        free=("psi0",),
    ),
)  # fmt: skip

# Damping leaves the motions at rest in the orbital frame, as the conditions of the family "equilibrium" require.
_UNDAMPED = {family.name: () if family.name == "equilibrium" else (NO_DISSIPATION,) for family in _TABLE}
FAMILIES: dict[str, Family] = {
    family.name: replace(family, motion=steady_motion, conditions=family.conditions + _UNDAMPED[family.name])
    for family in _TABLE
}


def condition_residual(points: Points) -> Array:
    """|w'-dot - n m gamma x e3| at the start over the largest squared rate; 0 on an exact motion.

    w'-dot is the relative angular acceleration of the start, n m gamma x e3 that of the steady motion
    w' = n gamma + m e3. The rates are Omega, |w| and sqrt(|h| |mu| / smallest moment of inertia).
    Shape of the points, dimensionless.
    """
    state = initial_state(points)
    w, gamma = state[:3], state[6:]
    rates = np.array(rhs(state, constants(points)))
    needed = np.array([gamma[1], -gamma[0], np.zeros_like(gamma[0])]) * (points["n"] * points["m"])
    residual = rates[:3] - points["Omega"] * rates[6:] - needed
    min_inertia = np.minimum(np.minimum(points["A"], points["B"]), points["C"])
    field = magnetic_moment(points) * np.hypot(points["h1"], points["h3"]) / min_inertia
    square = np.maximum(np.maximum(points["Omega"] ** 2, (w**2).sum(0)), field)
    return relative_to(length(residual), square)
