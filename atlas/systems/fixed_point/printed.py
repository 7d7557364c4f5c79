"""The fast-spin formulas of Amer, Abo Essa, Ibrahim & Amer exactly as the paper prints them.

For comparison only: most of them are wrong, ERRATA says how. Each function has the signature and the
units of its namesake in `perturbation`. X and what follows from it need A1 != 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..system import Array, BadInput
from .perturbation import FastSpin


class Erratum(NamedTuple):
    """One formula of the paper: what is printed, what is true, and what the difference does."""

    equation: str
    printed: str
    true: str
    effect: str


ERRATA = (
    Erratum(
        "(1), second equation", "eps/b (z0' g1 + a B1 g1 g1'')", "eps/b (z0' g1 + k a B1 g1 g1'')",
        "the Newtonian torque has no k",
    ),
    Erratum(
        "(3), S1", "a { .. + k [ .. + (1 - g1''^2)]}", "a { .. } with k (1 - g1''^2) outside the factor a",
        "r1^2 - eps^2 S1 is not constant",
    ),
    Erratum("(4)", "k = N / c^2", "k = N gamma0'' / c^2", "invisible with the paper's data (k = 1e-4)"),
    Erratum(
        "(7), (15)", "omega'^2 = A1^2 - 2 A1 l3 / (A r0)", "Omega^2 = (A1 + l3 / (A r0))^2",
        "wrong sign: frequencies shift the wrong way with l3, and omega' may become imaginary",
    ),
    Erratum(
        "(9)", "g1' = (g1-dot - eps q1 g1'') / r1", "g1' = (g1-dot + eps q1 g1'') / r1", "(11) has the right sign",
    ),
    Erratum(
        "(10), chi1 and nu", "divided by 1 - omega'^2", "chi1 = -G0 / (1 + Omega), nu = 1 / (1 + Omega)",
        "with omega' a pole at omega' = 1; none with Omega but at C r0 + l3 = 0",
    ),
    Erratum("(10), chi", "y2^2 l1 / (C r0 A1 A^2 omega'^2)", "0", "q1 l1 - p1 l2 vanishes on the forced solution"),
    Erratum(
        "(11), (16), (27)-(33)", "A^-1 y2", "C A^-1 y2", "dimensionally inconsistent as printed",
    ),
    Erratum(
        "(15), second equation", "l1 / (A r0)", "l1 / (C r0 + l3)", "Phi1 lacks a term of the same order",
    ),
    Erratum(
        "(18)", "gamma2(0, eps) = 0", "gamma2-dot(0, eps) = 0", "(22) has the right condition",
    ),
    Erratum(
        "(19), (20), (25)", "p2'' + omega'^2 p2 = 0", "p2'' + Omega^2 p2 = Omega mu1",
        "fatal: the forced part mu1/Omega of p1, not small, is lost",
    ),
    Erratum("(24), h_k", "sin omega'(tau - t1)", "sin(tau - t1)", "gamma2 has frequency 1"),
    Erratum("(32)", "W1 > 0", "W1 < 0", "sign-definite all the same: the argument survives"),
    Erratum(
        "(33), p1", "eps [chi + chi1 M3 cos tau]", "mu1/Omega + eps chi1 M3 cos tau",
        "p1 is wrong by its whole size wherever l1 != 0",
    ),
    Erratum(
        "(33), q1", "C X y2 / A + ..", "mu2/Omega - eps chi1 M3 sin tau", "X is 1/Omega to first order in l3 only",
    ),
    Erratum(
        "(33), g1''", "y1 (1 - cos tau) + y2 sin tau - ..", "[mu1 (1 - cos tau) + mu2 sin tau] / Omega",
        "wrong by a factor of order C / (C - A)",
    ),
    Erratum(
        "(33), alpha", "-eps pi n [ .. ]", "-2 pi n eps^2 [G0/(1 + Omega) + |mu|^2 / (2 Omega^2)]",
        "too large by 1/eps; the bracket is wrong where l1 or l2 != 0",
    ),
    Erratum(
        "theta after (34)", "y1, y2", "mu1/Omega, mu2/Omega", "the swing is wrong by a factor of order (C - A) / C",
    ),
    Erratum(
        "psi after (34)", "half the secular rate, a secular term in l2^2, no mu1 sin r0 t",
        "-(Mg z0 - N (C - A) cos theta0) / (C r0 + l3)", "precession at half its rate, or far off where l2 != 0",
    ),
    Erratum(
        "section VI, data", "A = 22.49 or 50.32 with M = 30, z0 = 5", "A >= M z0^2 = 750",
        "no real body has these moments about the fixed point",
    ),
)  # fmt: skip


def k(spin: FastSpin) -> Array:
    """N / c^2, (4)."""
    return spin.N * spin.C / np.abs(spin.weight)


def rhs(spin: FastSpin, y: Array) -> Array:
    """dy/dtau, (1) with (4) and (5); A = B, so C1 = 0."""
    p, q, r, g1, g2, g3 = y
    eps, a, A, A1, B1 = spin.eps, spin.a, spin.A, spin.A1, -spin.A1
    rotor2, rotor1 = r * spin.l2 / spin.scale, r * spin.l1 / spin.scale
    dp = (
        -A1 * q * r
        - (q * spin.l3 / spin.r0 - rotor2) / A
        - eps / a * (spin.z * g2 - k(spin) * a * A1 * g2 * g3)
    )
    dq = -B1 * p * r + (p * spin.l3 / spin.r0 - rotor1) / A + eps / a * (spin.z * g1 + a * B1 * g1 * g3)
    dr = eps**2 * (q * spin.l1 - p * spin.l2) / (spin.C * spin.scale)
    return np.array([dp, dq, dr, r * g2 - eps * q * g3, eps * p * g3 - r * g1, eps * (q * g1 - p * g2)])


def integrals(spin: FastSpin, y: Array) -> Array:
    """What (2) with (3) says is constant: energy, area and |gamma|^2, shape (3, ...)."""
    p, q, r, g1, g2, g3 = y
    y1, y2, y3 = spin.y
    length = g1**2 + g2**2 + g3**2
    energy = r**2 + spin.eps**2 * (spin.a * (p**2 + q**2 + k(spin) * length) - 2 * spin.z * g3)
    area = r * g3 + spin.eps * (spin.a * (p * g1 + q * g2) + y1 * g1 + y2 * g2 + y3 * g3)
    return np.array([energy, area, length])


def frequency_squared(spin: FastSpin) -> Array:
    """omega'^2 = A1^2 - 2 A1 l3 / (A r0), after (8); may be negative."""
    return spin.A1**2 - 2 * spin.A1 * spin.l3 / (spin.A * spin.r0)


class Coefficients(NamedTuple):
    """chi, chi1 and nu of (10), X, chi2 and nu2 of (11)."""

    chi: Array
    chi1: Array
    nu: Array
    X: Array
    chi2: Array
    nu2: Array


def coefficients(spin: FastSpin) -> Coefficients:
    """Coefficients of (10) and (11); BadInput where they divide by zero."""
    A, C, A1, a, r0 = spin.A, spin.C, spin.A1, spin.a, spin.r0
    squared = frequency_squared(spin)
    if np.any(A1 == 0):
        raise BadInput("A1 = 0 (A = C): X of (11) divides by A1")
    if np.any((squared == 1) | (squared == 0)):
        raise BadInput("omega'^2 = 0 or 1: chi, chi1 and nu of (10) divide by omega'^2 or 1 - omega'^2")
    y2, s = spin.y[1], spin.l3 / (A * r0)
    chi = y2**2 * spin.l1 / (C * r0 * A1 * A**2 * squared)
    field = spin.z / a
    chi1 = (-field * (1 - A1) + k(spin) * (A1 - A1**2) + s * (field - k(spin) * A1)) / (1 - squared)
    nu = (1 - A1 - s) / (1 - squared)
    X = (1 - s / A1) / A1
    return Coefficients(chi, chi1, nu, X, chi1 + field - k(spin) * A1, nu - X)


def quasilinear(spin: FastSpin, x: Array, x0: Array) -> Array:
    """d/dtau of x = (p2, p2', gamma2, gamma2'), (15) with F1 and Phi1 of (16); x0 is x at tau = 0."""
    p, p_dot, g, g_dot = x
    A, C, A1, a, r0, eps = spin.A, spin.C, spin.A1, spin.a, spin.r0, spin.eps
    l1, l2 = spin.l1, spin.l2
    y1, y2, _ = spin.y
    _, chi1, _, X, chi2, _ = coefficients(spin)
    p0, p_dot0, g0, g_dot0 = x0
    twist = (p_dot0 * g_dot0 - p_dot * g_dot) - X / (A * r0) * l2 * (p_dot0 - p_dot)
    S21 = a * ((p0 * g0 - p * g) - X * twist)
    S21 = S21 + y1 * (g0 - g) + y2 * (1 - a * X * C / A) * (g_dot0 - g_dot)
    inner = (p_dot**2 - 2 * y2 / A * p_dot + 2 * p_dot * chi2 * g_dot) / C - A1 * p * (y2 / A - p_dot) / C
    F1 = -chi1 * l1 / (A * r0) + l2 / (A1 * r0) * inner
    Phi1 = l1 * S21 / (A * r0) + g_dot * (l1 / A * (y2 / A - p_dot) - l2 * p) / (C * r0)
    forcing = C * A1 * y1 / A
    return np.array(
        [p_dot, forcing + eps * F1 - frequency_squared(spin) * p, g_dot, l1 / (A * r0) + eps * Phi1 - g]
    )


def first_order(spin: FastSpin, tau: Array) -> Array:
    """The periodic solution (33); tau broadcasts with the fields of spin; returns y of shape (6, ...)."""
    A, C, A1, a, r0, eps, M3 = spin.A, spin.C, spin.A1, spin.a, spin.r0, spin.eps, spin.M3
    l2, l3 = spin.l2, spin.l3
    y1, y2, y3 = spin.y
    chi, chi1, _, X, chi2, _ = coefficients(spin)
    cosine, sine = np.cos(tau), np.sin(tau)
    s2, s3 = l2 / (A * A1 * r0), l3 / (A * A1 * r0)
    # The first term of (33) is l1 y2^2 / (C A1 A^2 r0 omega'^2), the chi of (10).
    p = eps * (chi + chi1 * M3 * cosine)
    q = C * X * y2 / A + eps * (2 * a * k(spin) * l2 * l3 / (A * A1 * r0) ** 2 + X * chi2) * M3 * sine
    r = 1 - eps**2 * k(spin) * M3 * a * s3 * sine
    swing = y1 * (1 - cosine) + y2 * sine
    second = X * chi2 * M3 * sine + k(spin) * M3 * a * s3 * sine * (2 * s2 + X * M3 * sine)
    g2 = -M3 * sine + s2 * (1 + eps * M3 * swing) + eps**2 * second
    lean = swing - a * C * l2 * y2 / (A**2 * A1**2 * r0) * sine
    third = a * chi * (1 - cosine) + 0.5 * a * M3 * (chi1 + X * chi2) * (1 - np.cos(2 * tau))
    third = third - a * l2 * chi2 / (A * A1**2 * r0) * sine - y3 * lean - k(spin) * a * s3 * sine
    g3 = 1 + eps * M3 * lean + eps**2 * M3 * third
    return np.array(np.broadcast_arrays(p, q, r, M3 * cosine, g2, g3))


def period_correction(spin: FastSpin, turns: int = 1) -> Array:
    """alpha(eps) of (33) with beta3 = 0, its value to the lowest order."""
    A, a, A1 = spin.A, spin.a, spin.A1
    y1, y2, _ = spin.y
    chi, chi1, nu, X, _, _ = coefficients(spin)
    front = 1 + spin.l1 / A / (spin.r0 * spin.M3 - spin.l3)
    bracket = spin.z / a - nu * chi1 * (1 - frequency_squared(spin)) + (y2 * X / A) ** 2 - k(spin) * A1
    bracket = bracket + a * chi * spin.l1 / (A * spin.r0) + y1 * spin.M3 * (spin.z / a - 2 * k(spin) * A1)
    return -spin.eps * np.pi * turns * front * bracket


def angles(spin: FastSpin, t: Array, h: float = 0.0, psi0: float = 0.0) -> Array:
    """theta, psi and phi after (34), shape (3, ...)."""
    A, C, A1, a, r0, eps = spin.A, spin.C, spin.A1, spin.a, spin.r0, spin.eps
    l2, l3 = spin.l2, spin.l3
    y1, y2, y3 = spin.y
    chi, chi1, _, X, chi2, _ = coefficients(spin)
    theta0 = np.arctan(spin.M3)
    tangent, cosine0 = np.tan(theta0), np.cos(theta0)
    c = spin.scale / np.sqrt(spin.gamma0)
    field = k(spin) * l3

    def theta1(s: Array) -> Array:
        # "c a l2" in the printed bracket is the c of (5).
        return -y1 * np.cos(r0 * s) + (1 - c * a * l2 / (A1**2 * A**2 * r0)) * y2 * np.sin(r0 * s)

    def theta2(s: Array) -> Array:
        sine = -y2 * y3 - a / (A1 * A * r0) * (l2 * chi2 / A1 + field)
        return (
            (y1 * y3 - a * chi) * np.cos(r0 * s)
            + sine * np.sin(r0 * s)
            - 0.5 * a * tangent * (chi1 + X * chi2) * np.cos(2 * r0 * s)
        )

    def psi1(s: Array) -> Array:
        return C * y2 / (A1 * A * r0) * (l2 * cosine0 / (A1 * A) * s + np.cos(r0 * s))

    def psi2(s: Array) -> Array:
        drift = l2 * C * y1 * y2 / (A1**2 * A**2 * r0) - 0.5 * X * chi2 * tangent
        return drift * s + chi2 * tangent / (4 * r0 * A1) * np.sin(2 * r0 * s)

    def psi3(s: Array) -> Array:
        drift = chi1 + C * X**2 * y2 * a * field / (A1 * A**2 * r0) + chi2 * y2 * l2 / (A1**2 * A * r0)
        wave = chi1 * tangent / (4 * r0) * np.sin(2 * r0 * s)
        return 0.5 * drift * tangent * s + wave - C * y2 * chi2 / (A1**2 * A * r0) * np.cos(r0 * s)

    def phi3(s: Array) -> Array:
        return a * field / (8 * A1 * A * r0) * np.cos(r0 * s)

    def change(f, s: Array) -> Array:
        return f(s + h) - f(h)

    t = np.asarray(t, float)
    unit = c * np.sqrt(cosine0)
    theta = theta0 - eps * change(theta1, t) - eps**2 * change(theta2, t)
    sway = change(psi1, t) + eps * change(psi2, t) + eps**2 * change(psi3, t)
    psi = psi0 + unit / np.sin(theta0) * sway
    phi = np.pi / 2 + r0 * h + r0 * t - unit / tangent * sway - eps**2 * tangent * change(phi3, t)
    return np.array(np.broadcast_arrays(theta, psi, phi))
