"""Quantities of a start of the satellite that its conditions, their solutions and closed forms of stability share."""

from __future__ import annotations

import numpy as np

from ..base import Array, Points
from ..vectors import cross
from .initial import directions


def sine_cosine(angle: Array) -> tuple[Array, Array]:
    """sin and cos, zero where only the rounding of pi keeps them from it."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.where(np.abs(sine) < 1e-14, 0.0, sine), np.where(np.abs(cosine) < 1e-14, 0.0, cosine)


def relative_to(value: Array, scale: Array) -> Array:
    """value / scale, 0 where value is 0, nan where only scale is."""
    safe = np.where(scale == 0, 1.0, scale)
    return np.where(value == 0, 0.0, np.where(scale == 0, np.nan, value / safe))


def quotient(value: Array, by: Array) -> Array:
    """value / by, nan where by is 0: nothing to solve for."""
    return np.where(by == 0, np.nan, value / np.where(by == 0, 1.0, by))


def largest_inertia(p: Points) -> Array:
    """Largest moment of inertia J."""
    return np.maximum(np.maximum(p["A"], p["B"]), p["C"])


def rate_scale(p: Points) -> Array:
    """Sum of the magnitudes of all rates of the start."""
    return np.abs(p["Omega"]) + np.abs(p["n"]) + np.abs(p["m"]) + np.abs(p["theta_dot0"])


def momentum_scale(p: Points) -> Array:
    """Largest moment of inertia times the sum of the rates, and the rotor's momentum."""
    return largest_inertia(p) * rate_scale(p) + np.sqrt(p["k1"] ** 2 + p["k2"] ** 2 + p["k3"] ** 2)


def magnetic_moment(p: Points) -> Array:
    """Magnitude of the magnetic moment."""
    return np.sqrt(p["mu1"] ** 2 + p["mu2"] ** 2 + p["mu3"] ** 2)


def torque_scale(p: Points) -> Array:
    """Rate times momentum, and the largest torque of the magnet."""
    return rate_scale(p) * momentum_scale(p) + magnetic_moment(p) * np.hypot(p["h1"], p["h3"])


def node_field(p: Points) -> tuple[Array, Array, Array]:
    """H in the axes of the node: node, across it, third body axis."""
    s, c = sine_cosine(p["theta0"])
    sp, cp = sine_cosine(p["psi0"])
    return p["h1"] * cp, p["h3"] * s - p["h1"] * c * sp, p["h3"] * c + p["h1"] * s * sp


def turn_rate(p: Points) -> Array:
    """|n gamma + m e3|, the rate of the rotation relative to the orbital frame."""
    s, c = sine_cosine(p["theta0"])
    return np.hypot(p["n"] * s, p["n"] * c + p["m"])


def axial_rate(p: Points) -> Array:
    """w3, the component of the angular velocity along the third body axis."""
    return (p["n"] + p["Omega"]) * sine_cosine(p["theta0"])[1] + p["m"]


def body_vectors(p: Points) -> tuple[Array, Array, Array]:
    """I, k, mu as arrays of shape (3, points)."""
    return tuple(  # type: ignore[return-value]
        np.array([p[name] for name in names])
        for names in (("A", "B", "C"), ("k1", "k2", "k3"), ("mu1", "mu2", "mu3"))
    )


def rest_torque(p: Points, with_rotor: bool = True) -> tuple[Array, Array, Array]:
    """Torque on the body at rest in the orbital frame, and alpha, gamma; shape (3, points) each."""
    inertia, k, mu = body_vectors(p)
    alpha, gamma = directions(p)
    square = p["Omega"] ** 2
    momentum = square * inertia * gamma + (p["Omega"] * k if with_rotor else 0.0)
    H = p["h1"] * alpha + p["h3"] * gamma
    return cross(momentum, gamma) + 3 * square * cross(alpha, inertia * alpha) + cross(H, mu), alpha, gamma
