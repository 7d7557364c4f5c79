"""Conditions of the families of steady motions of the satellite.

Short names, the equations (*) and the scales of the residuals are those of `families`.
"""

from __future__ import annotations

import numpy as np

from ..base import Array, Condition, Points
from ..vectors import cross, length
from .initial import directions
from .quantities import (
    axial_rate,
    body_vectors,
    largest_inertia,
    magnetic_moment,
    momentum_scale,
    node_field,
    rate_scale,
    relative_to,
    rest_torque,
    sine_cosine,
    torque_scale,
    turn_rate,
)


def _equal(a: str, b: str) -> Condition:
    """Two moments of inertia are equal."""
    return Condition(f"{a} = {b}", lambda p: relative_to(p[a] - p[b], largest_inertia(p)))


SYMMETRIC = _equal("A", "B")
EQUAL_B_AND_C = _equal("B", "C")
STEADY_TILT = Condition("theta_dot0 = 0", lambda p: relative_to(p["theta_dot0"], rate_scale(p)))
NO_PRECESSION = Condition("n = 0", lambda p: relative_to(p["n"], rate_scale(p)))
NO_SPIN = Condition("m = 0", lambda p: relative_to(p["m"], rate_scale(p)))
UPRIGHT = Condition("sin theta0 = 0", lambda p: sine_cosine(p["theta0"])[0])
NODE_ON_RADIUS = Condition("sin psi0 = 0", lambda p: sine_cosine(p["psi0"])[0])
NODE_ON_VELOCITY = Condition("cos psi0 = 0", lambda p: sine_cosine(p["psi0"])[1])
AXIAL_ROTOR = Condition("k1 = k2 = 0", lambda p: relative_to(np.hypot(p["k1"], p["k2"]), momentum_scale(p)))
AXIAL_MAGNET = Condition(
    "mu1 = mu2 = 0 (or h1 = h3 = 0)",
    lambda p: relative_to(np.hypot(p["mu1"], p["mu2"]) * np.hypot(p["h1"], p["h3"]), torque_scale(p)),
)
NO_RADIAL_TORQUE = Condition(
    "h1 mu = 0", lambda p: relative_to(p["h1"] * magnetic_moment(p), torque_scale(p))
)
NO_AXIAL_RADIAL_TORQUE = Condition("h1 mu3 = 0", lambda p: relative_to(p["h1"] * p["mu3"], torque_scale(p)))


def _dissipation(p: Points) -> Array:
    """Torque of the damping, over the scale of torques."""
    return relative_to(p["damping"] * turn_rate(p), torque_scale(p) + p["damping"] * rate_scale(p))


def _pair(p: Points, factor: Array, real: Array, imaginary: Array) -> Array:
    """|factor K - (real + i imaginary) U| over the scale of torques."""
    first = factor * p["k1"] - real * p["mu1"] + imaginary * p["mu2"]
    second = factor * p["k2"] - real * p["mu2"] - imaginary * p["mu1"]
    return relative_to(np.hypot(first, second), torque_scale(p))


def _spinning_pair(p: Points) -> Array:
    return _pair(p, axial_rate(p), node_field(p)[2], np.zeros_like(p["A"]))


def _node_pair(p: Points) -> Array:
    H1, H2, _ = node_field(p)
    return _pair(p, p["Omega"] * sine_cosine(p["theta0"])[0], H2, H1)


NO_DISSIPATION = Condition("damping (w - Omega gamma) = 0", _dissipation)
SPINNING_PAIR = Condition("w3 k1,2 = H3 mu1,2", _spinning_pair)
NODE_PAIR = Condition("Omega sin theta0 (k1 + i k2) = (H2 + i H1) (mu1 + i mu2)", _node_pair)


def _tilt_torque(p: Points) -> Array:
    """Right side of the last equation of (*): Omega s (k3 + C m) that balances gravity and magnet."""
    s, c = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    return p["Omega"] ** 2 * s * c * flatness * (1 + 3 * sp**2) + p["mu3"] * node_field(p)[1]


def _tilt_balance(p: Points) -> Array:
    lever = p["Omega"] * sine_cosine(p["theta0"])[0]
    return relative_to(lever * (p["k3"] + p["C"] * p["m"]) - _tilt_torque(p), torque_scale(p))


TILT_BALANCE = Condition(
    "Omega s (k3 + C m) = Omega^2 s c ((A + B)/2 - C) (1 + 3 sin^2 psi0) + mu3 (h3 s - h1 c sin psi0)",
    _tilt_balance,
)


def _oblique_balance(p: Points) -> Array:
    s, _ = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    gravity = 3 * p["Omega"] ** 2 * s * sp * (0.5 * (p["A"] + p["B"]) - p["C"])
    return relative_to(gravity - p["h1"] * p["mu3"], torque_scale(p))


def _despun_balance(p: Points) -> Array:
    return sine_cosine(p["psi0"])[1] * _oblique_balance(p)


OBLIQUE_BALANCE = Condition("3 Omega^2 s sin psi0 ((A + B)/2 - C) = h1 mu3", _oblique_balance)


def _no_rotation(p: Points) -> Array:
    return relative_to(turn_rate(p), rate_scale(p))


def _normal_torque(p: Points) -> Array:
    torque, _, gamma = rest_torque(p)
    return relative_to((torque * gamma).sum(0), torque_scale(p))


def _plane_torque(p: Points) -> Array:
    torque, alpha, gamma = rest_torque(p)
    beta = cross(gamma, alpha)
    return relative_to(np.hypot((torque * alpha).sum(0), (torque * beta).sum(0)), torque_scale(p))


NO_ROTATION = Condition("n sin theta0 = 0 and n cos theta0 + m = 0", _no_rotation)
NO_TORQUE_ABOUT_NORMAL = Condition("beta.(3 Omega^2 I alpha + h1 mu) = 0", _normal_torque)
NO_TORQUE_ACROSS_NORMAL = Condition(
    "Omega gamma x k = Omega^2 I gamma x gamma + 3 Omega^2 alpha x I alpha + (h1 alpha + h3 gamma) x mu"
    " across gamma",
    _plane_torque,
)
DESPUN = Condition("m = -Omega cos theta0", lambda p: relative_to(axial_rate(p), rate_scale(p)))
FIELD_ACROSS = Condition(
    "h3 c = -h1 s sin psi0 (or mu1 = mu2 = 0)",
    lambda p: relative_to(node_field(p)[2] * np.hypot(p["mu1"], p["mu2"]), torque_scale(p)),
)
DESPUN_BALANCE = Condition(
    "cos psi0 (3 Omega^2 s sin psi0 ((A + B)/2 - C) - h1 mu3) = 0",
    _despun_balance,
)


def _tilt_angle(p: Points) -> Array:
    return 4 * sine_cosine(p["theta0"])[1] ** 2 - 1


def _tilt_spin(p: Points) -> Array:
    return relative_to(p["m"] + 2 * p["Omega"] * sine_cosine(p["theta0"])[1], rate_scale(p))


def _spherical_balance(p: Points) -> Array:
    torque = (p["n"] + p["Omega"]) * (p["C"] * p["m"] + p["k3"]) - p["h3"] * p["mu3"]
    return relative_to(torque, torque_scale(p))


ASYMMETRIC_TILT_ANGLE = Condition("cos theta0 = +-1/2", _tilt_angle)
ASYMMETRIC_TILT_SPIN = Condition("m = -2 Omega cos theta0", _tilt_spin)
NO_TRANSVERSE_TORQUE = Condition(
    "h3 mu1 = h3 mu2 = 0",
    lambda p: relative_to(p["h3"] * np.hypot(p["mu1"], p["mu2"]), torque_scale(p)),
)
SPHERICAL_BALANCE = Condition("(n + Omega) (C m + k3) = h3 mu3", _spherical_balance)


def _symmetry_about_normal(p: Points) -> Array:
    """Deviation of gamma from an axis across which every direction has the same moment of inertia."""
    inertia, _, _ = body_vectors(p)
    alpha, gamma = directions(p)
    beta = cross(gamma, alpha)
    parts = (
        length(cross(inertia * gamma, gamma)),
        (inertia * (alpha**2 - beta**2)).sum(0),
        (inertia * 2 * alpha * beta).sum(0),
    )
    return relative_to(length(np.array(parts)), largest_inertia(p))


def _normal_rotor(p: Points) -> Array:
    _, k, mu = body_vectors(p)
    _, gamma = directions(p)
    return relative_to(length(cross(gamma, (p["n"] + p["Omega"]) * k - p["h3"] * mu)), torque_scale(p))


SYMMETRY_ABOUT_NORMAL = Condition(
    "gamma an axis of equal moments: (A = C, gamma = +-e2), (B = C, gamma = +-e1) or A = B = C",
    _symmetry_about_normal,
)
NORMAL_ROTOR = Condition("gamma x ((n + Omega) k - h3 mu) = 0", _normal_rotor)
