"""Reduction (6)-(8), (11), (13), (14), (17), (26), (27) of Amer, Abo Essa, Ibrahim & Amer, printed and true.

These are the steps from the equations of motion to the solution (33), with residuals. Each row changes its
own equation alone: k, the frequency and chi, chi1, nu, X are the true ones (X = 1 / Omega, chi = 0) in both
readings. S1 and S2 are from (2), or from (3) with its own misprint corrected. Residuals are in units of the
difference of the two readings; where an equation is an expansion in eps, the true one is of order eps. Terms
with l2 / (A r0), which is of order eps, in S12, S22 and Phi1 are of higher order and left out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import combinations_with_replacement
from typing import NamedTuple, TypeVar

import numpy as np

from ...systems.base import Array
from .. import Measure
from . import fast_spin
from .fast_spin import FastSpin, random_spin, true_acceleration

# (3), corrected, and states that satisfy (2) with it.


def S1_S2(spin: FastSpin, y0: Array, y: Array) -> tuple[Array, Array]:
    """S1 and S2 of (3), corrected, of a state y that left the start y0."""
    (p0, q0, _, g10, g20, _), (p, q, _, g1, g2, g3) = y0, y
    a, k = spin.a, spin.k
    y1, y2, y3 = spin.y
    transverse = g10**2 - g1**2 + g20**2 - g2**2
    S1 = a * (p0**2 - p**2 + q0**2 - q**2) + k * (a * transverse + 1 - g3**2) - 2 * spin.z * (1 - g3)
    S2 = a * (p0 * g10 - p * g1 + q0 * g20 - q * g2) + y1 * (g10 - g1) + y2 * (g20 - g2) + y3 * (1 - g3)
    return S1, S2


def random_states(rng: np.random.Generator, spin: FastSpin) -> tuple[Array, Array]:
    """A random start with r1 = g1'' = 1, and a random state with the same energy and area, (2) with (3)."""
    y0, y = rng.normal(size=(2, 6))
    y0[[2, 5]] = y[[2, 5]] = 1.0
    for _ in range(60):  # a contraction by a factor of order eps
        S1, S2 = S1_S2(spin, y0, y)
        y[2] = np.sqrt(1 + spin.eps**2 * S1)
        y[5] = (1 + spin.eps * S2) / y[2]
    return y0, y


# (13): S1 = S11 + 2 eps S12 and S2 = S21 + eps S22 in p2, gamma2 and their rates.


def differences(x0: Array, x: Array) -> dict[str, Array]:
    """Values at x0 less those at x of p = p2, v = p2', g = gamma2, u = gamma2' and their products, by their names."""

    def values(state: Array) -> dict[str, Array]:
        of = dict(zip("pvgu", state, strict=True))
        return of | {a + b: of[a] * of[b] for a, b in combinations_with_replacement("pvgu", 2)}

    first, second = values(x0), values(x)
    return {name: first[name] - second[name] for name in first}


def coefficients(spin: FastSpin) -> tuple[Array, Array, Array, Array]:
    """X = 1 / Omega, chi2 = chi1 + z0'/a - k A1, nu2 = nu - X of (11) and l2 / (A r0), in their true forms."""
    X = 1 / spin.Omega
    return X, spin.chi1 + spin.G0, spin.nu - X, spin.l2 / (spin.A * spin.r0)


def S11(spin: FastSpin, x0: Array, x: Array) -> Array:
    """S11 of (13), true as printed."""
    d, (X, _, _, s2) = differences(x0, x), coefficients(spin)
    field = spin.k * (d["gg"] + d["uu"] + 2 * X * s2 * d["u"])
    return spin.a * (d["pp"] + X**2 * d["vv"] + field - 2 * spin.C * X**2 / spin.A * spin.y[1] * d["v"])


def S12(spin: FastSpin, x0: Array, x: Array, printed: bool = False) -> Array:
    """S12 of (13)."""
    d, (X, chi2, nu2, _) = differences(x0, x), coefficients(spin)
    front = 1.0 if printed else spin.a
    return (
        spin.a * (spin.chi1 * d["pg"] + X**2 * chi2 * d["vu"]) + (spin.z - spin.k) * S21(spin, x0, x)
        + spin.k * spin.a * (spin.nu * d["pg"] + nu2 * d["vu"])
        - front * spin.C * X**2 / spin.A * chi2 * spin.y[1] * d["u"]
    )  # fmt: skip


def S21(spin: FastSpin, x0: Array, x: Array, signs: tuple[int, int] = (1, 1)) -> Array:
    """S21 of (13); signs of its two terms in l2, both -1 as printed."""
    d, (X, _, _, s2) = differences(x0, x), coefficients(spin)
    twist = d["vu"] + signs[0] * X * s2 * d["v"]
    lean = spin.y[0] * d["g"] + spin.y[1] * (1 + signs[1] * spin.a * X * spin.C / spin.A) * d["u"]
    return spin.a * (d["pg"] - X * twist) + lean


def S22(spin: FastSpin, x0: Array, x: Array, printed: bool = False) -> Array:
    """S22 of (13)."""
    d, (X, chi2, nu2, _) = differences(x0, x), coefficients(spin)
    y1, y2, y3 = spin.y
    last = 1.0 if printed else nu2
    return (
        spin.a * (spin.nu * d["pp"] + spin.chi1 * d["gg"])
        + spin.a * X * (-nu2 * d["vv"] + spin.C / spin.A * y2 * nu2 * d["v"] - chi2 * d["uu"])
        + y1 * spin.nu * d["p"] + y2 * last * d["v"] - y3 * S21(spin, x0, x)
    )  # fmt: skip


# (6), (11), (14) and (17).


def half_6(spin: FastSpin, y: Array, S1: Array, printed: bool) -> Array:
    """What (6) adds to 1 in r1, over eps^2."""
    return 0.5 * (S1 + 2 * spin.z * (1 - y[5]) - spin.k * (1 - y[5] ** 2) if printed else S1)


def third_14(spin: FastSpin, x0: Array, x: Array, printed: bool) -> Array:
    """What (14) adds to r1 in its third order, over eps^3."""
    third = S12(spin, x0, x)
    return third + (spin.k - spin.z) * S21(spin, x0, x) if printed else third


def q1_of_11(spin: FastSpin, x0: Array, x: Array, printed: bool) -> Array:
    """q1 of (11)."""
    _, v, _, u = x
    X, chi2, nu2, s2 = coefficients(spin)
    first_integral, eps = S11(spin, x0, x), spin.eps
    field = s2 * first_integral if printed else -X * spin.G0 * s2
    carried = spin.nu if printed else nu2
    second = X * (0.5 * first_integral - spin.G0 * carried) * v + X * spin.k * spin.A1 * u * S21(spin, x0, x)
    return -X * (v - spin.mu.imag) - eps * X * (chi2 * u - field) + eps**2 * second


def length_17(spin: FastSpin, x0: Array, x: Array, printed: bool) -> Array:
    """Left side of (17), which is |gamma|^2 / gamma0''^2 - 1."""
    p, v, g, u = x
    X, chi2, nu2, s2 = coefficients(spin)
    turn, area = S11(spin, x0, x), S21(spin, x0, x)
    lowest = g**2 + u * (u + 2 * X * s2)
    first = 2 * (spin.nu * g * p + (u + X * s2) * (nu2 * v + X * s2 * area) + area)
    second = (spin.nu * p) ** 2 + (nu2 * v) ** 2 - 2 * X * u * (chi2 * u + area * v) + area**2
    second = second + 2 * S22(spin, x0, x) - turn
    if not printed:
        lowest, second = lowest + (X * s2) ** 2, second - turn * u**2
    return lowest + spin.eps * first + spin.eps**2 * second


# (7) and (8): second derivatives of p1 and g1.


def seven(spin: FastSpin, y: Array, S1: Array, printed: bool) -> Array:
    """p1'' by (7) up to its terms of first order, with the true frequency in place of omega'."""
    p, q, _, g1, _, _ = y
    A, C, A1, r0 = spin.A, spin.C, spin.A1, spin.r0
    s3, mu1, mu2 = spin.l3 / (A * r0), spin.mu.real, spin.mu.imag
    torque = (q * spin.l1 - p * spin.l2) / (C * r0)
    field, newton = spin.z / spin.a * g1, spin.k * A1 * g1
    first = A1 * spin.l1 / (A * r0) * S1 + (1 - A1) * (field - newton)
    if printed:
        return A1 * mu1 + spin.eps * (first + A1 * torque * q + s3 * (field + newton)) - spin.Omega**2 * p
    first = first + torque * (mu2 - A1 * q) + s3 * (newton - field)
    return (A1 + s3) * mu1 + spin.eps * first - spin.Omega**2 * p


def eight(spin: FastSpin, y: Array, S1: Array, S2: Array, printed: bool) -> Array:
    """g1'' by (8)."""
    p, q, _, g1, g2, _ = y
    A, A1, eps = spin.A, spin.A1, spin.eps
    s1, s3, field = spin.l1 / (A * spin.r0), spin.l3 / (A * spin.r0), spin.z / spin.a
    torque = (q * spin.l1 - p * spin.l2) / (spin.C * spin.r0)
    first = (1 - A1) * p + s1 * S2 - s3 * p + torque * g2
    second = -S1 * g1 + (1 - A1) * p * S2 + p * q * g2 - g1 * (field + q * q) + spin.k * A1 * g1
    third = (field - 2 * spin.k * A1) * g1 * S2
    if not printed:
        second, third = second - s3 * p * S2, -third
    return s1 - g1 + eps * first + eps**2 * second + eps**3 * third


# (26) and (27): (13) and Phi1 on the generating solution (20), (25).


def generating(spin: FastSpin, E: float, eta: float, tau: Array) -> Array:
    """(p2, p2', gamma2, gamma2') of (25), with the true frequency."""
    turn = spin.Omega * tau - eta
    return np.array(
        [E * np.cos(turn), -spin.Omega * E * np.sin(turn), spin.M3 * np.cos(tau), -spin.M3 * np.sin(tau)]
    )


def start_and_state(spin: FastSpin, E: float, eta: float, tau: Array | float) -> tuple[Array, Array]:
    """The variables of (25) at 0 and at tau."""
    return generating(spin, E, eta, np.asarray(0.0)), generating(spin, E, eta, np.asarray(tau))


def S11_of_26(spin: FastSpin, E: float, eta: float, tau: Array | float, printed: bool) -> Array:
    """S11^(0) of (26)."""
    X, _, _, s2 = coefficients(spin)
    turn, square = spin.Omega * tau - eta, (X * spin.Omega) ** 2
    wave = np.cos(eta) ** 2 + square * np.sin(eta) ** 2
    if printed:
        wave = wave + 0.5 * (square - 1) * (1 - np.cos(2 * turn))
        rotor = spin.l3 * X / (spin.A * spin.r0)
    else:
        wave = wave - 0.5 * (square + 1) + 0.5 * (square - 1) * np.cos(2 * turn)
        rotor = X * s2
    sway = 2 * spin.a * E * spin.Omega * X**2 * spin.mu.imag * (np.sin(eta) + np.sin(turn))
    return spin.a * E**2 * wave + 2 * spin.k * spin.a * spin.M3 * rotor * np.sin(tau) - sway


def Phi1(spin: FastSpin, x0: Array, x: Array) -> Array:
    """Phi1 of (16), with C A^-1 y2 for A^-1 y2 and X l1 for A^-1 l1."""
    p, v, _, u = x
    torque = (spin.l1 / spin.Omega * (spin.mu.imag - v) - spin.l2 * p) / (spin.C * spin.r0)
    return spin.l1 * S21(spin, x0, x) / (spin.A * spin.r0) + u * torque


def Phi1_of_27(spin: FastSpin, tau: Array, printed: bool) -> Array:
    """Phi1^(0) of (27) with M1 = M2 = 0, which the paper arrives at."""
    X = 1 / spin.Omega
    y1, y2, _ = spin.y
    if printed:
        inner = spin.a * X * spin.C - spin.l1 / (spin.A1 * spin.C * spin.r0)
        return y2 * (1 + inner / spin.A) * spin.M3 * np.sin(tau)
    return spin.l1 / (spin.A * spin.r0) * spin.M3 * (y1 * (1 - np.cos(tau)) + y2 * np.sin(tau))


# The measures of both readings.


class States(NamedTuple):
    """Two random states of one motion in the variables of (15), the second also in those of (1) and with S1, S2."""

    spin: FastSpin
    x0: Array
    x: Array
    y: Array
    S1: Array
    S2: Array

    @classmethod
    def draw(cls, rng: np.random.Generator) -> States:
        spin = random_spin(rng, r0=1e4)
        y0, y = random_states(rng, spin)
        x0, x = (fast_spin.to_quasilinear(spin, state) for state in (y0, y))
        return cls(spin, x0, x, y, *S1_S2(spin, y0, y))


class Motion(NamedTuple):
    """A random state y with random S1, S2, which are what (2) makes of r1 and g1''."""

    spin: FastSpin
    y: Array
    S1: Array
    S2: Array

    @classmethod
    def draw(cls, r0: float, rng: np.random.Generator) -> Motion:
        spin = random_spin(rng, r0=r0)
        p, q, g1, g2, S1, S2 = rng.normal(size=6)
        r = np.sqrt(1 + spin.eps**2 * S1)
        return cls(spin, np.array([p, q, r, g1, g2, (1 + spin.eps * S2) / r]), S1, S2)


Drawn = TypeVar("Drawn")


def _readings(
    draw: Callable[[np.random.Generator], Drawn], error: Callable[[Drawn, bool], Array]
) -> tuple[Measure, Measure]:
    """Errors (drawn, printed) of both readings at what `draw` draws, over the difference of the two."""

    def measured(reading: int, rng: np.random.Generator) -> float:
        drawn = draw(rng)
        pair = error(drawn, True), error(drawn, False)
        return float(np.abs(pair[reading] / (pair[0] - pair[1])))

    return partial(measured, 0), partial(measured, 1)


def _error_13(s: States, signs: tuple[int, int] = (1, 1), printed: bool = False) -> Array:
    """S2 less S21 + eps S22, with S21 of these signs, or with S22 as printed."""
    return s.S2 - S21(*s[:3], signs) - s.spin.eps * S22(*s[:3], printed)


READINGS = {
    # r1 - 1 = eps^2 S1 / (r1 + 1), without cancellation
    "(6)": _readings(
        States.draw, lambda s, printed: s.S1 / (s.y[2] + 1) - half_6(s.spin, s.y, s.S1, printed)
    ),
    "(7), forcing and first order": _readings(
        partial(Motion.draw, 1e4),
        lambda m, printed: seven(*m[:3], printed=printed) - true_acceleration(*m[:2])[0],
    ),
    "(8)": _readings(  # eps^3 far above rounding errors
        partial(Motion.draw, 1e3),
        lambda m, printed: eight(*m, printed=printed) - true_acceleration(*m[:2])[3],
    ),
    "(11), q1": _readings(States.draw, lambda s, printed: q1_of_11(*s[:3], printed=printed) - s.y[1]),
    "(13), S12": _readings(
        States.draw, lambda s, printed: (s.S1 - S11(*s[:3])) / s.spin.eps - 2 * S12(*s[:3], printed=printed)
    ),
    "(13), S21": _readings(States.draw, lambda s, printed: _error_13(s, (-1, -1) if printed else (1, 1))),
    "(13), S22": _readings(States.draw, lambda s, printed: _error_13(s, printed=printed)),
    "(14)": _readings(
        States.draw,
        lambda s, printed: (
            s.S1 / (s.y[2] + 1) - 0.5 * S11(*s[:3]) - s.spin.eps * third_14(*s[:3], printed=printed)
        ),
    ),
    "(17)": _readings(
        States.draw, lambda s, printed: length_17(*s[:3], printed=printed) - ((s.y[3:] ** 2).sum() - 1)
    ),
    "(26), S11": _readings(
        lambda rng: (random_spin(rng), rng.uniform(0.5, 1.5), rng.uniform(0.5, 5.0), rng.uniform(0.5, 5.0)),
        lambda drawn, printed: S11_of_26(*drawn, printed) - S11(drawn[0], *start_and_state(*drawn)),
    ),
    "(27), Phi1": _readings(
        lambda rng: (random_spin(rng), 0.0, 0.0, rng.uniform(0.5, 5.0, ())),
        lambda drawn, printed: (
            Phi1_of_27(drawn[0], drawn[3], printed) - Phi1(drawn[0], *start_and_state(*drawn))
        ),
    ),
}
