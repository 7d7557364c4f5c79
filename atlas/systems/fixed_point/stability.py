"""Linear stability of the steady motions of a gyrostat about a fixed point."""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Flags, Mask, Points
from ..vectors import cross
from .initial import bodies, fields, initial_state, rates, symmetric, vertical

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
    stable, growth = decide(value, size, np.sqrt(np.maximum(-value, 0.0)) / (2 * points["A"]))
    state = initial_state(points)
    general = _equilibrium_stability(points, state[2] * np.sign(state[5]), state[3:])
    closed = symmetric(points)
    return np.where(closed, stable, general[0]), np.where(closed, growth, general[1])


def staude_stability(points: Points) -> tuple[Flags, Array]:
    """A = B, rotor and weight along the axis: as conical with m = 0.

    Other bodies: the roots of x^2 + P x + Q, x the squared exponents of the linear equations.
    """
    stable, growth = conical_stability(points)
    general = _equilibrium_stability(points, rates(points)[1], vertical(points))
    closed = symmetric(points)
    return np.where(closed, stable, general[0]), np.where(closed, growth, general[1])


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


def amended_hessian(points: Points, n: Array, gamma: Array) -> tuple[Array, Array, Array]:
    """Second variation of the amended potential at the permanent rotation w = n gamma.

    The amended potential is U + (k - l.g)^2 / (2 g.I g) at the fixed angular momentum k about the
    vertical. Returns the determinant and the trace of its Hessian on the plane normal to gamma, and
    the magnitude of the terms of the determinant; each (points,).
    """
    inertia, rotor, weight, N = bodies(points)
    moment = (inertia * gamma**2).sum(0)
    multiplier = (((n**2 - N) * inertia * gamma + n * rotor + weight) * gamma).sum(0)
    v = rotor + 2 * n * inertia * gamma
    diagonal = multiplier - (n**2 - N) * inertia
    hessian = v[:, None] * v[None] / moment
    for i in range(3):
        hessian[i, i] += diagonal[i]
    trace = (
        hessian[0, 0] + hessian[1, 1] + hessian[2, 2] - np.einsum("i...,ij...,j...", gamma, hessian, gamma)
    )
    # The determinant on the plane normal to gamma is gamma . adj(hessian) gamma.
    adjugate = np.array([[_cofactor(hessian, i, j) for j in range(3)] for i in range(3)])
    determinant = np.einsum("i...,ij...,j...", gamma, adjugate, gamma)
    size = (v**2).sum(0) / moment + np.abs(multiplier) + np.abs(n**2 - N) * inertia.max(0)
    return determinant, trace, size**2


def _cofactor(matrix: Array, i: int, j: int) -> Array:
    a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
    return matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]


def _equilibrium_stability(points: Points, n: Array, gamma: Array) -> tuple[Flags, Array]:
    """Linear stability of the permanent rotation w = n gamma of any body."""
    P, Q, discriminant, minimum = _quartic(points, n, gamma)
    first, second = _squared_exponents(P, Q, discriminant)
    real = np.sqrt(np.maximum(np.maximum(first, second), 0.0))
    # Real part of sqrt(x) for x = -P/2 + i sqrt(4 Q - P^2)/2, whose modulus is sqrt(Q).
    paired = np.sqrt(np.maximum(0.5 * (np.sqrt(np.maximum(Q, 0.0)) - 0.5 * P), 0.0))
    growth = np.where(minimum, 0.0, np.where(discriminant < 0, paired, real))
    proved = minimum | ((Q > 0) & (discriminant > 0))
    stable = np.where(proved, Stability.STABLE, Stability.UNKNOWN)
    return np.where(growth > 0, Stability.UNSTABLE, stable).astype(np.int8), growth


def rotation_frequencies(points: Points, n: Array, gamma: Array) -> Array:
    """Frequencies relative to the body about the permanent rotation w = n gamma, (2, points), the larger first.

    nan for exponents that are zero or have a real part.
    """
    P, Q, discriminant, minimum = _quartic(points, n, gamma)
    # At a minimum of the amended potential the squared exponents are real; rounding decides no double root.
    squares = np.array(_squared_exponents(P, Q, discriminant))
    squares = np.where((discriminant >= 0) | minimum, squares, np.nan)
    return -np.sort(-np.sqrt(np.where(squares < 0, -squares, np.nan)), axis=0)


def _squared_exponents(P: Array, Q: Array, discriminant: Array) -> tuple[Array, Array]:
    """Roots x of x^2 + P x + Q, the one of larger magnitude first; the real part where they are complex."""
    first = -0.5 * (P + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), P))
    return first, np.divide(Q, first, out=np.zeros_like(Q), where=first != 0)


def _quartic(points: Points, n: Array, gamma: Array) -> tuple[Array, Array, Array, Mask]:
    """P, Q, P^2 - 4 Q of the permanent rotation w = n gamma, and where the amended potential has a minimum.

    Two of the six exponents are zero (|gamma| and the momentum about the vertical), the squares x of
    the others solve x^2 + P x + Q = 0. P comes from the trace of the squared matrix and Q from the
    amended potential, so the zero exponents, which are defective in general, do not enter.
    """
    inertia, rotor, weight, N = bodies(points)
    w = n * gamma
    momentum, force = inertia * w + rotor, N * inertia * gamma - weight
    matrix = np.zeros((6, 6, *n.shape))
    for j in range(3):
        unit = np.zeros_like(gamma)
        unit[j] = 1.0
        turn = cross(inertia * unit, w) + cross(momentum, unit)
        tilt = cross(unit, force) + cross(gamma, N * inertia * unit)
        matrix[:3, j], matrix[3:, j] = turn / inertia, cross(gamma, unit)
        matrix[:3, 3 + j], matrix[3:, 3 + j] = tilt / inertia, cross(unit, w)
    products = matrix * np.swapaxes(matrix, 0, 1)
    P, size = -0.5 * products.sum((0, 1)), 0.5 * np.abs(products).sum((0, 1))
    P = np.where(np.abs(P) <= ROUNDING * size, 0.0, P)
    determinant, trace, size = amended_hessian(points, n, gamma)
    ratio = (inertia * gamma**2).sum(0) / inertia.prod(0)
    Q = np.where(np.abs(determinant) <= ROUNDING * size, 0.0, determinant * ratio)
    discriminant = P**2 - 4 * Q
    discriminant = np.where(np.abs(discriminant) <= ROUNDING * (P**2 + 4 * np.abs(Q)), 0.0, discriminant)
    return P, Q, discriminant, (Q > 0) & (trace > 0)
