"""The families of exact steady motions theta = theta0, psi' = n, phi' = m of the satellite.

For Omega > 0 and without drag the families contain all such motions. They follow from the equations of motion of (1)-(3)
of Yehia & El-kenani 2021 (doi 10.22055/JACM.2021.37913.3113) by the condition that u = n gamma + m e3 solves them for
all t, where u is the rotation relative to the orbital frame. `tests/systems/test_satellite_families.py` proves each family. Let
c = cos theta0, s = sin theta0, w3 = (n + Omega) c + m, K = k1 + i k2, U = mu1 + i mu2 and a = (A + B) / 2. The field in the
axes of the node, of which e3 is the third, is H = (h1 cos psi0, h3 s - h1 c sin psi0, h3 c + h1 s sin psi0).
With n = 0, A = B and m not 0, the motion is steady if and only if

    w3 K = H3 U,   Omega s K = (H2 + i H1) U,   cos psi0 (3 Omega^2 s sin psi0 (a - C) - h1 mu3) = 0,
    Omega s (k3 + C m) = Omega^2 s c (a - C) (1 + 3 sin^2 psi0) + mu3 H2.                       (*)

Drag along the third axis adds drag3 sin psi0 to the right side of the third equation and drag3 c cos psi0 to the right side of
the last equation. The families perp_radius and oblique allow such drag, equilibrium allows any drag, and the others allow none.
Drag across the axis allows more motions, which only the test of the equations finds.

The module `conditions` has the equations, which are solved for parameters in which they are linear. The families overlap, and a
point belongs to the first family in the order of FAMILIES. With Omega = 0 every family is still exact, but a free or heavy body
has more steady motions. With damping only motions at rest in the orbital frame, u = 0, remain steady, because the Jacobi
integral of all other motions falls.

Let J be the largest moment of inertia, T = |mu| |h| + |drag| and R = Omega + |n s| + |n c + m| + |theta_dot0| + sqrt(T / J).
Residuals of moments of inertia are divided by J, of rates by R, of momenta by J R + |k|, and of torques by R (J R + |k|) + T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..base import NEAR, Array, Family, Points, numbered
from ..gyrostat import motions
from ..gyrostat.motions import about_third_axis, each, linear, motion_of, nearest_root, relative_to
from ..vectors import cross, ratio
from . import conditions as the
from .conditions import field_torque, flatness, node, rest_torque, tilt
from .initial import body_vectors, directions, initial_state

# Closed form for `Family.motion` of the motion theta = theta0, psi = n t + psi0, phi = m t + phi0. theta_dot0 counts as 0.
steady_motion = motion_of(about_third_axis, directions, lambda points: points["Omega"])


def _psi_on_velocity(p: Points) -> Array:
    """Return the odd multiple of pi/2 that is nearest to psi0. For a multiple of pi, return the larger of the two nearest."""
    return np.pi * (np.floor(p["psi0"] / np.pi) + 0.5)


def nearest_pole(name: str, p: Points) -> Array:
    """Return the multiple of pi that is nearest to an angle."""
    return np.pi * np.round(p[name] / np.pi)


def _theta(p: Points) -> Array:
    """Return the tilt in [0, pi] from k3 and m. Of several tilts, return the nearest to a wanted tilt, or nan if no tilt is wanted."""
    sp, cp = node(p)
    momentum = p["k3"] + p["C"] * p["m"] - relative_to(p["mu3"] * p["h3"], p["Omega"])
    cosine = ratio(momentum, p["Omega"] * flatness(p) * (1 + 3 * sp**2), np.nan)
    is_single = (p["h1"] * p["mu3"] * sp == 0) & (p["drag3"] * cp == 0)
    exists = (np.abs(cosine) <= 1) & is_single
    single = np.where(exists, np.arccos(np.clip(cosine, -1, 1)), np.nan)
    if f"{NEAR}theta0" not in p:
        return single
    theta = _roots(the.tilt_balance, "theta0", p)
    near = nearest_root(np.where((theta > 0) & (theta < np.pi), theta, np.nan), p["theta0"])
    return np.where(is_single, single, near)


def _roots(function: Callable[[Points], Array], name: str, p: Points) -> Array:
    """Return the zeros in (-pi, pi] of a trigonometric polynomial of degree 2, (4, points), with nan for complex zeros."""
    angles = np.arange(8.0).reshape(8, *(1,) * p[name].ndim) * np.pi / 4
    values = function(
        {each: value[None] + 0 * angles for each, value in p.items()} | {name: angles + 0 * p[name]}
    )
    harmonics = np.moveaxis(np.fft.fft(values, axis=0)[[-2, -1, 0, 1, 2]], 0, -1)
    companion = np.zeros((*p[name].shape, 4, 4), complex)
    companion[..., [1, 2, 3], [0, 1, 2]] = 1.0
    with np.errstate(all="ignore"):  # the last harmonic is 0 if the degree is below 2
        companion[..., 3] = -harmonics[..., :4] / harmonics[..., 4:]
    finite = np.asarray(np.isfinite(companion).all((-2, -1)))
    roots = np.linalg.eigvals(np.where(finite[..., None, None], companion, 0.0))
    angle = np.where((np.abs(np.abs(roots) - 1) < 1e-6) & finite[..., None], np.angle(roots), np.nan)
    return np.moveaxis(angle, -1, 0)


def _k_along(line: Callable[[Points], tuple[Array, Array]], name: str, p: Points) -> Array:
    """Return a component of k = base + lambda gamma. For k3, lambda follows from k1 and k2. For k1 or k2, lambda follows from k3.

    Where gamma3 = 0, lambda does not enter k3, and k1 and k2 determine each other.
    """
    base, gamma = line(p)
    i, k = int(name[1]) - 1, np.array([p["k1"], p["k2"], p["k3"]])
    gamma = np.where(np.abs(gamma) < 1e-14, 0.0, gamma)
    free = (k - base) * gamma
    if i == 2:
        along = ratio(free[0] + free[1], gamma[0] ** 2 + gamma[1] ** 2, np.nan)
    else:
        other, third = (ratio(free[j], gamma[j] ** 2, np.nan) for j in (1 - i, 2))
        along = np.where(gamma[2] == 0, other, third)
    return base[i] + along * gamma[i]


def _rotor_at_rest(p: Points) -> tuple[Array, Array]:
    """Return two vectors: a rotor with which the torque is along the normal, and the normal."""
    torque, _, gamma = rest_torque(p, with_rotor=False)
    return ratio(cross(torque, gamma), p["Omega"], np.nan), gamma


def _psi_oblique(p: Points) -> Array:
    """Return psi0 from OBLIQUE_BALANCE. Without drag3, the sign of cos psi0 stays. With drag3, take the root nearest to the given psi0."""
    sine = ratio(p["h1"] * p["mu3"], 3 * p["Omega"] ** 2 * tilt(p)[0] * flatness(p), np.nan)
    angle = np.arcsin(np.where(np.abs(sine) <= 1, sine, np.nan))
    angle = np.where(np.cos(p["psi0"]) < 0, np.pi - angle, angle)
    if not p["drag3"].any():
        return angle
    roots = _roots(partial(the.oblique_balance, without_pole=True), "psi0", p)
    near = p["psi0"] + (roots - p["psi0"] + np.pi) % (2 * np.pi) - np.pi
    away = (p["h1"] * p["mu3"] != 0) | (np.abs(np.sin(near)) > 1e-6)
    return np.where(p["drag3"] == 0, angle, nearest_root(np.where(away, near, np.nan), p["psi0"]))


_SYMMETRIC_TILT = (the.NO_PRECESSION, the.SYMMETRIC, the.AXIAL_ROTOR, the.AXIAL_MAGNET)
_TILT_LABELS = (
    "permanent rotation about the third axis in the orbital frame; in space regular precession (Omega, m),"
    " permanent rotation where m = 0"
)
_tilted = partial(Family, labels=_TILT_LABELS, free=("phi0",))
_symmetric = partial(
    _tilted,
    stability_text="Symmetric body, k and mu along the axis, n = 0: lambda^4 + P lambda^2 + Q = 0. With the axial momentum"
    " p = (C w3 + k3) / a conserved, the axis moves like a charge on the sphere: U = -Omega^2 s^2/2 - Omega p c"
    " + (3/2) D Omega^2 s^2 sin^2 psi + (mu3 (h1 s sin psi + h3 c) - drag3 s cos psi) / a, D = C/a - 1, P = U_tt + U_pp / s^2"
    " + (2 Omega c - p)^2 and Q = (U_tt U_pp - U_tp^2) / s^2.",
)
_ABOUT_NORMAL = (
    "Rotation about the orbit's normal and an axis of symmetry along it, with k and mu along it too. With J the moment about"
    " that axis, T across it, nu the rate in the orbital frame: p = (J (Omega + nu) + k.gamma) / T,"
    " U_2 = Omega p - Omega^2 - h3 mu.gamma / T, U_1 = U_2 + 3 Omega^2 (J/T - 1),"
    " lambda^4 + (U_1 + U_2 + (2 Omega - p)^2) lambda^2 + U_1 U_2 = 0. Unknown where k or h3 mu has a part across the axis:"
    " the linear system is then periodic in time."
)
_TABLE = (
    Family(
        name="cylindrical",
        title="third axis along the orbit's normal, symmetric body turning about it at n +- m",
        equations="(14)-(16), (21)-(23), (29)-(31), (44), (45)",
        conditions=(the.UPRIGHT, the.SYMMETRIC, the.NO_RADIAL_TORQUE, the.SPINNING_PAIR),
        solve={**each(nearest_pole, "theta0"), **the.SPINNING_PAIR.solve("mu1", "mu2", "k1", "k2")},
        several={"theta0": "0"},
        stability_text=_ABOUT_NORMAL,
        geometry="cylindrical",
        paper_wording="n = 0: cylindrical permanent rotation (orbital), cylindrical regular precession "
        "(inertial); n != 0: cylindrical regular precession in both",
        labels="permanent rotation in both frames, about the normal at n +- m and in space at n + Omega +- m",
        exists="w3 = 0 only with H3 mu1 = H3 mu2 = 0; k1 and k2 are then free",
        free=("C", "k3", "psi0", "phi0"),
    ),
    Family(
        name="equilibrium",
        title="any body at rest in the orbital frame",
        equations="(27), (28) at theta0 = pi; otherwise derived from (1)-(3)",
        conditions=(the.NO_ROTATION, the.NO_TORQUE_ABOUT_NORMAL, the.NO_TORQUE_ACROSS_NORMAL),
        solve={
            # m is -n cos theta0 if the third axis is on the normal, and 0 if n = 0. Otherwise there is no solution.
            "m": lambda p: np.where((tilt(p)[0] == 0) | (p["n"] == 0), -p["n"] * tilt(p)[1], np.nan),
            **the.NO_TORQUE_ABOUT_NORMAL.solve("h1"),
            **each(partial(_k_along, _rotor_at_rest), "k3", "k1", "k2"),
        },
        paper_wording="equilibrium position (orbital), cylindrical regular precession (inertial)",
        labels="at rest in the orbital frame, turning with it in space: permanent rotation in both",
        exists="every orientation without torque about the normal has such a rotor, k is free along the normal;"
        " atlas.equilibria finds all orientations of a given body",
        free=("damping",),
    ),
    _symmetric(
        name="perp_radius",
        title="third axis at rest in the plane of normal and velocity, symmetric body spinning at m",
        equations="(17), (18)",
        conditions=(
            *_SYMMETRIC_TILT, the.AXIAL_DRAG, the.NODE_ON_RADIUS, the.NO_AXIAL_RADIAL_TORQUE, the.TILT_BALANCE,
        ),
        solve={
            **each(nearest_pole, "psi0"),
            "theta0": _theta,
            **the.TILT_BALANCE.solve("m"),
            **linear(the.tilt_over_sine, "h3"),
            **the.TILT_BALANCE.solve("k3"),
        },
        several={"psi0": "0", "theta0": "none with drag3, where there are up to 4"},
        geometry="perp_radius",
        paper_wording="conical permanent rotation (orbital), conical regular precession (inertial)",
        exists="every theta0, but sin theta0 = 0 only if drag3 = 0; for given k3 and m without drag3:"
        " |k3 + C m - mu3 h3 / Omega| <= Omega |A - C|",
    ),
    _symmetric(
        name="perp_velocity",
        title="third axis at rest in the plane of normal and radius, symmetric body spinning at m",
        equations="(24), (25)",
        conditions=(*_SYMMETRIC_TILT, the.NODE_ON_VELOCITY, the.TILT_BALANCE),
        solve={
            "psi0": _psi_on_velocity,
            "theta0": _theta,
            **the.TILT_BALANCE.solve("m"),
            **linear(the.tilt_balance, "h1"),
            **linear(the.tilt_over_sine, "h3"),
            **the.TILT_BALANCE.solve("k3"),
        },
        several={"psi0": "pi/2", "theta0": "none with h1 mu3, where there are up to 4"},
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        exists="every theta0, but sin theta0 = 0 only if h1 mu3 = 0; for given k3 and m without h1 mu3:"
        " |k3 + C m - mu3 h3 / Omega| <= 4 Omega |A - C|",
    ),
    _symmetric(
        name="oblique",
        title="third axis at rest in an oblique plane through the normal, symmetric body with axial magnet or drag",
        equations="derived from (1)-(3); not in the paper",
        conditions=(*_SYMMETRIC_TILT, the.AXIAL_DRAG, the.OBLIQUE_BALANCE, the.TILT_BALANCE),
        solve={
            "psi0": _psi_oblique,
            **the.OBLIQUE_BALANCE.solve("h1", "mu3", "drag3"),
            **the.TILT_BALANCE.solve("m"),
            **linear(the.tilt_over_sine, "h3"),
            **the.TILT_BALANCE.solve("k3"),
        },
        several={"psi0": "from -pi/2 to pi/2"},
        geometry="oblique",
        exists="|h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|: from perp_radius at h1 mu3 = 0 to perp_velocity at equality;"
        " with drag3 in place of h1 mu3: |drag3| <= 3 Omega^2 |sin theta0 (A - C)|, perp_radius at equality",
    ),
    _tilted(
        name="transverse_magnet",
        title="as perp_velocity, with rotor and magnet across the third axis",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            the.NO_PRECESSION, the.SYMMETRIC, the.NODE_ON_VELOCITY, the.SPINNING_PAIR, the.NODE_PAIR,
            the.TILT_BALANCE,
        ),
        solve={
            "psi0": _psi_on_velocity,
            # If the function below is 0, the same k1 and k2 solve SPINNING_PAIR and NODE_PAIR, because sin psi0 = +-1.
            **linear(
                lambda p: (
                    node(p)[0] * p["h1"] * (p["Omega"] + p["m"] * tilt(p)[1]) - p["m"] * tilt(p)[0] * p["h3"]
                ),
                "m", "h1", "h3",
            ),
            **the.NODE_PAIR.solve("k1", "k2"),
            **the.TILT_BALANCE.solve("k3"),
        },
        several={"psi0": "pi/2"},
        geometry="perp_velocity",
        exists="where mu1 or mu2 is not 0: sin psi0 h1 (Omega + m cos theta0) = m sin theta0 h3",
    ),
    _tilted(
        name="despun_transverse",
        title="symmetric body without rotation about its axis (w3 = 0), rotor and magnet across it",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            the.NO_PRECESSION, the.SYMMETRIC, the.DESPUN, the.FIELD_ACROSS, the.NODE_PAIR,
            the.DESPUN_BALANCE, the.TILT_BALANCE,
        ),
        solve={
            "m": lambda p: -p["Omega"] * tilt(p)[1],
            **the.FIELD_ACROSS.solve("h1", "h3"),
            # mu3 follows from OBLIQUE_BALANCE. Where cos psi0 = 0, mu3 is free and keeps the given value.
            "mu3": lambda p: np.where(node(p)[1] == 0, p["mu3"], the.OBLIQUE_BALANCE.solve("mu3")["mu3"](p)),
            **the.NODE_PAIR.solve("k1", "k2"),
            **the.TILT_BALANCE.solve("k3"),
        },
        exists="cos psi0 = 0, or |h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|",
    ),
    _tilted(
        name="asymmetric_tilt",
        title="any body, third axis at 60 or 120 degrees in the plane of normal and radius, m = -+Omega",
        equations="(19), (20); 120 degrees and psi0 = -pi/2 derived from (1)-(3)",
        conditions=(
            the.NO_PRECESSION, the.ASYMMETRIC_TILT_ANGLE, the.ASYMMETRIC_TILT_SPIN, the.NODE_ON_VELOCITY,
            the.SPINNING_PAIR, the.NODE_PAIR, the.TILT_BALANCE,
        ),
        solve={
            # theta0 becomes pi/3 or 2 pi/3, and the sign of cos theta0 is kept.
            "theta0": lambda p: np.where(np.cos(p["theta0"]) < 0, 2 * np.pi / 3, np.pi / 3),
            "psi0": _psi_on_velocity,
            **the.ASYMMETRIC_TILT_SPIN.solve("m"),
            # This h1 is needed if mu1 or mu2 is not 0.
            "h1": lambda p: -node(p)[0] * np.sign(tilt(p)[1]) * np.sign(tilt(p)[0]) * np.sqrt(3) * p["h3"],
            **the.NODE_PAIR.solve("k1", "k2"),
            **the.TILT_BALANCE.solve("k3"),
        },
        several={"theta0": "pi/3", "psi0": "pi/2"},
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        exists="mu1 = mu2 = 0, or h1 = -sin psi0 sgn(cos theta0) sqrt(3) h3",
    ),
    Family(
        name="spherical",
        title="spherical body, any tilt, precession and spin",
        equations="remarks after (31) and (45), completed from (1)-(3)",
        conditions=(
            the.SYMMETRIC, the.EQUAL_B_AND_C, the.AXIAL_ROTOR, the.NO_RADIAL_TORQUE,
            the.NO_TRANSVERSE_TORQUE, the.SPHERICAL_BALANCE,
        ),
        solve=the.SPHERICAL_BALANCE.solve("n", "m", "h3", "k3"),
        stability_text=motions.NEUTRAL,
        geometry="general",
        paper_wording="spherical symmetry: regular precession",
        labels="regular precession (n, m) in the orbital frame and (n + Omega, m) in space; permanent rotation where"
        " one of the two rates is 0",
        exists="n = -Omega only with h3 mu3 = 0; k3 and m are then free",
        free=("theta0", "psi0", "phi0"),
    ),
    Family(
        name="other_axis",
        title="rotation at n about an axis of symmetry other than the third, which lies along the normal",
        equations="derived from (1)-(3); not in the paper",
        conditions=(the.NO_SPIN, the.SYMMETRY_ABOUT_NORMAL, the.NO_RADIAL_TORQUE, the.NORMAL_ROTOR),
        solve=each(
            # The rotors k lie on a line parallel to the orbit normal, through the k with (n + Omega) k = h3 mu (mu: magnetic moment).
            partial(
                _k_along,
                lambda p: (ratio(p["h3"] * body_vectors(p)[2], p["n"] + p["Omega"], np.nan), directions(p)[1]),
            ),
            "k3", "k1", "k2",
        ),
        stability_text=_ABOUT_NORMAL,
        geometry="general",
        labels="permanent rotation in both frames, about the normal at n and in space at n + Omega",
        exists="n = -Omega only with h3 mu along the normal; k is then free",
        free=("psi0",),
    ),
)  # fmt: skip

# With damping only motions at rest in the orbital frame remain. Motions of the family "equilibrium" are at rest anyway.
_UNDAMPED = {family.name: () if family.name == "equilibrium" else (the.NO_DISSIPATION,) for family in _TABLE}
_UNDRAGGED = {
    family.name: () if family.name in ("equilibrium", "perp_radius", "oblique") else (the.NO_DRAG,)
    for family in _TABLE
}
FAMILIES = numbered(
    replace(
        family,
        motion=steady_motion,
        conditions=(the.STEADY_TILT, *family.conditions, *_UNDRAGGED[family.name], *_UNDAMPED[family.name]),
    )
    for family in _TABLE
)


def squared_rate(points: Points) -> Array:
    """Return the largest of Omega^2, |w|^2 at the start, and `field_torque` divided by the least moment of inertia."""
    turn = np.maximum(points["Omega"] ** 2, (initial_state(points)[:3] ** 2).sum(0))
    min_inertia = np.minimum(np.minimum(points["A"], points["B"]), points["C"])
    return np.maximum(turn, field_torque(points) / min_inertia)
