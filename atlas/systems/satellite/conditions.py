"""Equations of the families of steady motions of the satellite, and quantities in these equations.

`families` explains the short names, the equations (*) and the scales of the residuals.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ..base import Array, Points, shared
from ..gyrostat.motions import Equation, relative_to
from ..vectors import cross, dot, length, ratio
from .initial import body_vectors, directions, drag_vector


def sine_cosine(angle: Array) -> tuple[Array, Array]:
    """Return sin and cos of an angle. Magnitudes below 1e-14 come from the rounding of pi and become 0."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.where(np.abs(sine) < 1e-14, 0.0, sine), np.where(np.abs(cosine) < 1e-14, 0.0, cosine)


@shared
def tilt(p: Points) -> tuple[Array, Array]:
    """Return s = sin theta0 and c = cos theta0."""
    return sine_cosine(p["theta0"])


@shared
def node(p: Points) -> tuple[Array, Array]:
    """Return sin psi0 and cos psi0."""
    return sine_cosine(p["psi0"])


@shared
def largest_inertia(p: Points) -> Array:
    return np.maximum(np.maximum(p["A"], p["B"]), p["C"])


@shared
def rate_scale(p: Points) -> Array:
    """Return a unit of rates, which is the sum of the orbital rate, a rate due to magnet and drag, and rates of the body at the start."""
    across, along = p["n"] * np.sin(p["theta0"]), p["n"] * np.cos(p["theta0"]) + p["m"]
    of_fields = np.sqrt(field_torque(p) / largest_inertia(p))
    return np.abs(p["Omega"]) + of_fields + np.abs(across) + np.abs(along) + np.abs(p["theta_dot0"])


@shared
def momentum_scale(p: Points) -> Array:
    """Return the largest moment of inertia times `rate_scale`, plus the rotor's momentum."""
    return largest_inertia(p) * rate_scale(p) + np.sqrt(p["k1"] ** 2 + p["k2"] ** 2 + p["k3"] ** 2)


@shared
def magnetic_moment(p: Points) -> Array:
    return np.sqrt(p["mu1"] ** 2 + p["mu2"] ** 2 + p["mu3"] ** 2)


@shared
def field_torque(p: Points) -> Array:
    """Return the sum of the largest torques of magnet and drag."""
    return magnetic_moment(p) * np.hypot(p["h1"], p["h3"]) + length(drag_vector(p))


@shared
def torque_scale(p: Points) -> Array:
    """Return `rate_scale` times `momentum_scale`, plus the largest torques of magnet and drag."""
    return rate_scale(p) * momentum_scale(p) + field_torque(p)


@shared
def node_field(p: Points) -> tuple[Array, Array, Array]:
    """Return the components of the field H along the node, across the node, and along the third body axis."""
    (s, c), (sp, cp) = tilt(p), node(p)
    return p["h1"] * cp, p["h3"] * s - p["h1"] * c * sp, p["h3"] * c + p["h1"] * s * sp


def axial_rate(p: Points) -> Array:
    """Return w3, the component of the angular velocity along the third body axis."""
    return (p["n"] + p["Omega"]) * tilt(p)[1] + p["m"]


def rest_torque(p: Points, with_rotor: bool = True) -> tuple[Array, Array, Array]:
    """Return three vectors (3, points): the torque on a body at rest in the orbital frame, alpha and gamma."""
    inertia, k, mu = body_vectors(p)
    alpha, gamma = directions(p)
    square = p["Omega"] ** 2
    momentum = square * inertia * gamma + (p["Omega"] * k if with_rotor else 0.0)
    H = p["h1"] * alpha + p["h3"] * gamma
    torque = cross(momentum, gamma) + 3 * square * cross(alpha, inertia * alpha) + cross(H, mu)
    return torque + cross(cross(gamma, alpha), drag_vector(p)), alpha, gamma


def flatness(p: Points) -> Array:
    """Return a - C with a = (A + B) / 2."""
    return 0.5 * (p["A"] + p["B"]) - p["C"]


def _pair(p: Points, factor: Array, imaginary: Array | float, real: Array) -> Array:
    """Return real and imaginary part of factor K - (real + i imaginary) U, (2, points), for K = k1 + i k2 and U = mu1 + i mu2."""
    return np.array(
        [
            factor * p["k1"] - real * p["mu1"] + imaginary * p["mu2"],
            factor * p["k2"] - real * p["mu2"] - imaginary * p["mu1"],
        ]
    )


def tilt_balance(p: Points) -> Array:
    (s, c), (sp, cp) = tilt(p), node(p)
    torque = p["Omega"] ** 2 * s * c * flatness(p) * (1 + 3 * sp**2) + p["mu3"] * node_field(p)[1]
    torque = torque + p["drag3"] * c * cp
    return p["Omega"] * s * (p["k3"] + p["C"] * p["m"]) - torque


def tilt_over_sine(p: Points, by_rate: bool = False) -> Array:
    """Return `tilt_balance` divided by s = sin theta0, or by Omega s if `by_rate` is true. At s = 0 return the limit, or nan."""
    (s, c), (sp, cp) = tilt(p), node(p)
    radial = p["mu3"] * p["h1"] * c * sp - p["drag3"] * c * cp
    field = p["mu3"] * p["h3"] - np.where(radial == 0, 0.0, ratio(radial, s, np.nan))
    momentum = p["k3"] + p["C"] * p["m"] - p["Omega"] * c * flatness(p) * (1 + 3 * sp**2)
    return momentum - relative_to(field, p["Omega"]) if by_rate else p["Omega"] * momentum - field


def oblique_balance(p: Points, without_pole: bool = False) -> Array:
    """Return left minus right side of OBLIQUE_BALANCE. `without_pole` multiplies by cos psi0, which removes the pole of tan psi0."""
    sp, cp = node(p)
    balance, drag = 3 * p["Omega"] ** 2 * tilt(p)[0] * sp * flatness(p) - p["h1"] * p["mu3"], p["drag3"] * sp
    return (
        cp * balance - drag if without_pole else balance - np.where(drag == 0, 0.0, ratio(drag, cp, np.inf))
    )


def _normal_torque(p: Points) -> Array:
    inertia, _, mu = body_vectors(p)
    alpha, gamma = directions(p)
    radial = dot(cross(gamma, alpha), 3 * p["Omega"] ** 2 * inertia * alpha + p["h1"] * mu)
    return radial - dot(alpha, drag_vector(p))


def _plane_torque(p: Points) -> Array:
    torque, alpha, gamma = rest_torque(p)
    return np.array([dot(torque, alpha), dot(torque, cross(gamma, alpha))])


def _asymmetry_about_normal(p: Points) -> Array:
    """Return residuals that vanish if gamma is a principal axis and all directions normal to gamma have the same moment of inertia."""
    inertia, _, _ = body_vectors(p)
    alpha, gamma = directions(p)
    beta = cross(gamma, alpha)
    difference = dot(inertia, alpha**2 - beta**2)
    return np.array([length(cross(inertia * gamma, gamma)), difference, dot(inertia, 2 * alpha * beta)])


SYMMETRIC = Equation("A = B", lambda p: p["A"] - p["B"], largest_inertia)
EQUAL_B_AND_C = Equation("B = C", lambda p: p["B"] - p["C"], largest_inertia)
STEADY_TILT = Equation("theta_dot0 = 0", lambda p: p["theta_dot0"], rate_scale)
NO_PRECESSION = Equation("n = 0", lambda p: p["n"], rate_scale)
NO_SPIN = Equation("m = 0", lambda p: p["m"], rate_scale)
UPRIGHT = Equation(
    "sin theta0 = 0",
    lambda p: np.array([tilt(p)[0], relative_to(p["n"] * np.sin(p["theta0"]), rate_scale(p))]),
)
NODE_ON_RADIUS = Equation("sin psi0 = 0", lambda p: node(p)[0])
NODE_ON_VELOCITY = Equation("cos psi0 = 0", lambda p: node(p)[1])
AXIAL_ROTOR = Equation("k1 = k2 = 0", lambda p: np.array([p["k1"], p["k2"]]), momentum_scale)
AXIAL_MAGNET = Equation(
    "mu1 = mu2 = 0 (or h1 = h3 = 0)",
    lambda p: np.hypot(p["mu1"], p["mu2"]) * np.hypot(p["h1"], p["h3"]),
    torque_scale,
)
AXIAL_DRAG = Equation("drag1 = drag2 = 0", lambda p: np.array([p["drag1"], p["drag2"]]), torque_scale)
NO_DRAG = Equation("drag = 0", drag_vector, torque_scale)
NO_RADIAL_TORQUE = Equation("h1 mu = 0", lambda p: p["h1"] * magnetic_moment(p), torque_scale)
NO_AXIAL_RADIAL_TORQUE = Equation("h1 mu3 = 0", lambda p: p["h1"] * p["mu3"], torque_scale)
NO_ROTATION = Equation(
    "n sin theta0 = 0 and n cos theta0 + m = 0",
    lambda p: np.hypot(p["n"] * np.sin(p["theta0"]), p["n"] * tilt(p)[1] + p["m"]),
    rate_scale,
)
NO_DISSIPATION = Equation(
    "damping (w - Omega gamma) = 0",
    lambda p: p["damping"] * NO_ROTATION.function(p),
    lambda p: torque_scale(p) + p["damping"] * rate_scale(p),
)
SPINNING_PAIR = Equation(
    "w3 k1,2 = H3 mu1,2", lambda p: _pair(p, axial_rate(p), 0.0, node_field(p)[2]), torque_scale
)
NODE_PAIR = Equation(
    "Omega sin theta0 (k1 + i k2) = (H2 + i H1) (mu1 + i mu2)",
    lambda p: _pair(p, p["Omega"] * tilt(p)[0], *node_field(p)[:2]),
    torque_scale,
)
TILT_BALANCE = Equation(
    "Omega s (k3 + C m) = Omega^2 s c ((A + B)/2 - C) (1 + 3 sin^2 psi0) + mu3 (h3 s - h1 c sin psi0)"
    " + drag3 c cos psi0",
    tilt_balance,
    torque_scale,
    partial(tilt_over_sine, by_rate=True),
)
OBLIQUE_BALANCE = Equation(
    "3 Omega^2 s sin psi0 ((A + B)/2 - C) = h1 mu3 + drag3 tan psi0", oblique_balance, torque_scale
)
NO_TORQUE_ABOUT_NORMAL = Equation(
    "beta.(3 Omega^2 I alpha + h1 mu) = alpha.drag", _normal_torque, torque_scale
)
NO_TORQUE_ACROSS_NORMAL = Equation(
    "Omega gamma x k = Omega^2 I gamma x gamma + 3 Omega^2 alpha x I alpha + (h1 alpha + h3 gamma) x mu"
    " + beta x drag across gamma",
    _plane_torque,
    torque_scale,
)
DESPUN = Equation("m = -Omega cos theta0", axial_rate, rate_scale)
FIELD_ACROSS = Equation(
    "h3 c = -h1 s sin psi0 (or mu1 = mu2 = 0)",
    lambda p: node_field(p)[2] * np.hypot(p["mu1"], p["mu2"]),
    torque_scale,
    lambda p: node_field(p)[2],
)
DESPUN_BALANCE = Equation(
    "cos psi0 (3 Omega^2 s sin psi0 ((A + B)/2 - C) - h1 mu3) = 0",
    partial(oblique_balance, without_pole=True),
    torque_scale,
)
ASYMMETRIC_TILT_ANGLE = Equation("cos theta0 = +-1/2", lambda p: 4 * tilt(p)[1] ** 2 - 1)
ASYMMETRIC_TILT_SPIN = Equation(
    "m = -2 Omega cos theta0", lambda p: p["m"] + 2 * p["Omega"] * tilt(p)[1], rate_scale
)
NO_TRANSVERSE_TORQUE = Equation(
    "h3 mu1 = h3 mu2 = 0", lambda p: p["h3"] * np.hypot(p["mu1"], p["mu2"]), torque_scale
)
SPHERICAL_BALANCE = Equation(
    "(n + Omega) (C m + k3) = h3 mu3",
    lambda p: (p["n"] + p["Omega"]) * (p["C"] * p["m"] + p["k3"]) - p["h3"] * p["mu3"],
    lambda p: torque_scale(p) + p["C"] * np.maximum(p["n"] ** 2, p["m"] ** 2),
)
SYMMETRY_ABOUT_NORMAL = Equation(
    "gamma an axis of equal moments: (A = C, gamma = +-e2), (B = C, gamma = +-e1) or A = B = C",
    _asymmetry_about_normal,
    largest_inertia,
)
NORMAL_ROTOR = Equation(
    "gamma x ((n + Omega) k - h3 mu) = 0",
    lambda p: cross(
        directions(p)[1], (p["n"] + p["Omega"]) * body_vectors(p)[1] - p["h3"] * body_vectors(p)[2]
    ),
    torque_scale,
)
