"""Linear stability of the steady motions of a gyrostat about a fixed point."""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Flags, Points
from .initial import fields, initial_state, rates, symmetric, vertical

# A discriminant below this fraction of the magnitude of its terms is rounding and does not decide stability.
ROUNDING = 1e-12


def decide(value: Array, size: Array, growth: Array) -> tuple[Flags, Array]:
    """Stable where value > 0, unstable where value < 0, unknown where it is rounding of terms of that size."""
    clear = np.abs(value) > ROUNDING * size
    stable = np.where(value > 0, Stability.STABLE, Stability.UNSTABLE)
    stable = np.where(clear, stable, Stability.UNKNOWN).astype(np.int8)
    return stable, np.where(stable == Stability.UNSTABLE, growth, 0.0)


def nutation(points: Points) -> tuple[Array, Array]:
    """Squared nutation frequency of a conical motion and the sum of the magnitudes of its terms.

    (n^2 + N (C - A)/A) sin^2 theta + ((C r + l3)/A - 2 n cos theta)^2, the curvature of the effective
    potential at fixed C r + l3 and fixed momentum about the vertical; rad^2 per time unit squared.
    """
    gamma = vertical(points)
    _, n, m = rates(points)
    A, C, N = points["A"], points["C"], fields(points)[1]
    s2 = gamma[0] ** 2 + gamma[1] ** 2
    spin = (C * (m + n * gamma[2]) + points["l3"]) / A
    gyroscopic = (spin - 2 * n * gamma[2]) ** 2
    size = (n**2 + np.abs(N * (C - A) / A)) * s2 + spin**2 + 4 * n**2 * gamma[2] ** 2
    return (n**2 + N * (C - A) / A) * s2 + gyroscopic, size


def conical_stability(points: Points) -> tuple[Flags, Array]:
    """Stable where (n^2 + N (C - A)/A) sin^2 theta + ((C r + l3)/A - 2 n cos theta)^2 > 0.

    That is the squared frequency of nutation; where it is negative the tilt grows at the root of its size.
    """
    value, size = nutation(points)
    return decide(value, size, np.sqrt(np.maximum(-value, 0.0)))


def sleeping_discriminant(points: Points) -> tuple[Array, Array]:
    """(C r + l3)^2 - 4 A (N (C - A) - s Mg z0) of a symmetric body on the vertical, and its terms' magnitude.

    s = cos theta = +-1. Positive: stable; negative: the tilt grows at sqrt(-D) / (2 A).
    """
    Mg, N = fields(points)
    A, C = points["A"], points["C"]
    spin = C * initial_state(points)[2] + points["l3"]
    gradient, weight = N * (C - A), np.sign(vertical(points)[2]) * Mg * points["z0"]
    size = spin**2 + 4 * A * (np.abs(gradient) + np.abs(weight))
    return spin**2 - 4 * A * (gradient - weight), size


def sleeping_at_threshold(points: Points) -> Array:
    """2 N (C - A) - s Mg z0: where the discriminant is zero, the body is stable if this is positive.

    It is the sign of the term theta^4 of the effective potential, whose term theta^2 vanishes there; a
    nudge by d then swings to an angle of order sqrt(d). Linear theory does not decide the stability at the threshold.
    """
    Mg, N = fields(points)
    return 2 * N * (points["C"] - points["A"]) - np.sign(vertical(points)[2]) * Mg * points["z0"]


def sleeping_stability(points: Points) -> tuple[Flags, Array]:
    """A = B, rotor and weight along the axis: stable where (C r + l3)^2 > 4 A (N (C - A) - s Mg z0), s = cos theta.

    Other bodies: the roots of x^2 + P x + Q, x the squared exponents of the linear equations.
    """
    value, size = sleeping_discriminant(points)
    return _of_symmetric(points, decide(value, size, np.sqrt(np.maximum(-value, 0.0)) / (2 * points["A"])))


def staude_stability(points: Points) -> tuple[Flags, Array]:
    """A = B, rotor and weight along the axis: as conical with m = 0.

    Other bodies: the roots of x^2 + P x + Q, x the squared exponents of the linear equations.
    """
    return _of_symmetric(points, conical_stability(points))


def rest_stability(points: Points) -> tuple[Flags, Array]:
    """At rest: as staude with n = 0. A free body that turns about its third axis: stable where
    ((C - A) m + l3) ((C - B) m + l3) > 0.
    """
    stable, growth = staude_stability(points)
    A, B, C, m = points["A"], points["B"], points["C"], rates(points)[2]
    # Free body that turns about its third axis: Euler's equations linearised, with a rotor.
    first, second = (C - A) * m + points["l3"], (C - B) * m + points["l3"]
    size = (np.abs((C - A) * m) + np.abs(points["l3"])) * (np.abs((C - B) * m) + np.abs(points["l3"]))
    turning = decide(first * second, size, np.sqrt(np.maximum(-first * second / (A * B), 0.0)))
    free = (m != 0) & ~symmetric(points)
    return np.where(free, turning[0], stable), np.where(free, turning[1], growth)


def _of_symmetric(points: Points, closed: tuple[Flags, Array]) -> tuple[Flags, Array]:
    """The closed form of a symmetric body; unknown of another one, whose linear equations decide."""
    where = symmetric(points)
    return np.where(where, closed[0], Stability.UNKNOWN).astype(np.int8), np.where(where, closed[1], np.nan)
