"""Section 4.2 of Yehia & El-kenani 2021, n/m irrational: (32)-(43) as printed and as true, with residuals.

With theta = theta0, psi = psi0 + n t and phi = m t, (32), (33) and (34) are Lagrange's equations (5), (6) and (7)
ordered by cos 2mt, sin 2mt, cos mt, sin mt and 1. (36)-(38) are the same at the times (35), where sin mt = 0, and
(40)-(42) at the times (39), where cos mt = 0. Each function below gives the left side in one of its two readings.

m u2 and mu2 look alike in print; each is read as the one that makes the equation right, and so is the letter
before n in "(.. n + m) Omega" of (33), which is u1. Where brackets do not match, the missing end is put at the end
of the line or of the factor that it belongs to.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy import cos, sin

from ...base import Array, PublishedEquation
from ..initial import constants
from . import lagrange
from .draws import Measure, Point, euler_state, random_point

Form = Callable[[SimpleNamespace, bool], Array]
# a random time, and i of (36)-(38) or j of (40)-(42)
Time = Callable[[np.random.Generator, Point], tuple[Any, int]]


def parts(p: Point, t: Any, index: int = 0) -> SimpleNamespace:
    """Parameters of a point and abbreviations of the paper at the time t; even is (-1)^index."""
    return SimpleNamespace(
        **p, u1=np.cos(p["theta0"]), u2=np.sin(p["theta0"]), psi=p["psi0"] + p["n"] * t, mt=p["m"] * t,
        x=p["n"] * t, N=p["n"] + p["Omega"], D=p["A"] - p["B"], sum=p["A"] + p["B"] - 2 * p["C"],
        even=(-1) ** index,
    )  # fmt: skip


def _thirty_two(q: SimpleNamespace, printed: bool) -> Array:
    turn = q.m * q.N * q.u2**2 * (1 if printed else -1)
    lean = q.u2 if printed else q.u1
    steady = (q.A + q.B) * q.u1**2 + (2 * q.u2**2 * q.A - q.B if printed else 2 * q.u2**2 * q.C - q.A - q.B)
    return (
        -0.75 * q.Omega**2 * q.D * (q.u1**2 + 1) * sin(2 * q.psi) * cos(2 * q.mt)
        - q.D * (turn + 1.5 * q.Omega**2 * q.u1 * cos(2 * q.psi)) * sin(2 * q.mt)
        + (-q.h1 * q.mu2 * lean * cos(q.psi) - q.h1 * q.mu1 * sin(q.psi) + q.m * q.k1 * q.u2) * cos(q.mt)
        + (-q.h1 * q.mu1 * q.u1 * cos(q.psi) + q.h1 * q.mu2 * sin(q.psi) - q.m * q.u2 * q.k2) * sin(q.mt)
        + 0.75 * q.Omega**2 * steady * sin(2 * q.psi) + q.h1 * q.mu3 * q.u2 * cos(q.psi)
    )  # fmt: skip


def _thirty_three(q: SimpleNamespace, printed: bool) -> Array:
    lean = q.u1 if printed else q.u2
    first = 1.25 * q.u1 * q.Omega**2 + (q.u1 * q.n + q.m) * q.Omega + q.n * (0.5 * q.n * q.u1 + q.m)
    steady = (1.25 * q.Omega**2 + q.n * q.Omega + 0.5 * q.n**2) * q.sum * q.u1 - (q.C * q.m + q.k3) * q.Omega
    steady = steady - q.n * q.m * q.C + q.mu3 * q.h3 - q.n * q.k3
    rotor1, rotor2 = (q.u1 * (-q.N * k + mu * q.h3) - q.m * k for k, mu in ((q.k1, q.mu1), (q.k2, q.mu2)))
    return (
        (-0.75 * q.Omega**2 * q.u1 * q.u2 * cos(2 * q.psi) + q.u2 * first) * q.D * cos(2 * q.mt)
        + 0.75 * q.Omega**2 * q.u2 * q.D * sin(2 * q.psi) * sin(2 * q.mt)
        + (q.h1 * q.mu2 * q.u2 * sin(q.psi) + rotor2) * cos(q.mt)
        + (q.h1 * q.mu1 * lean * sin(q.psi) + rotor1) * sin(q.mt)
        + 0.75 * q.Omega**2 * q.u1 * q.u2 * q.sum * cos(2 * q.psi) + q.h1 * q.mu3 * q.u1 * sin(q.psi) - q.u2 * steady
    )  # fmt: skip


def _thirty_four(q: SimpleNamespace, printed: bool) -> Array:
    gravity = q.Omega**2 * q.D * (q.u1**2 + 1) * cos(2 * q.psi)
    field = -q.h1 * q.mu1 * q.u1 * sin(q.psi) - q.h1 * q.mu2 * cos(q.psi)
    rotor = -q.u2 * (q.N * q.k1 - q.h3 * q.mu1)
    if printed:
        double = gravity - q.u2**2 / 3 * (q.Omega**2 * q.D - 4 * q.n * q.Omega - 2 * q.n**2)
        single = field + rotor * cos(q.mt)
    else:
        spin = q.D * (5 * q.Omega**2 + 4 * q.n * q.Omega + 2 * q.n**2)
        double = -0.75 * (gravity + q.u2**2 / 3 * spin)
        single = (field + rotor) * cos(q.mt)
    magnet = q.h3 * q.mu2 * (1 if printed else -1)
    across = q.h1 * q.mu2 * q.u1 * sin(q.psi) - q.h1 * q.mu1 * cos(q.psi) + q.u2 * (q.N * q.k2 + magnet)
    return (
        -1.5 * q.Omega**2 * q.u1 * q.D * sin(2 * q.psi) * cos(2 * q.mt) + double * sin(2 * q.mt)
        + single + across * sin(q.mt)
    )  # fmt: skip


def _thirty_six(q: SimpleNamespace, printed: bool) -> Array:
    gravity = 1.5 * q.Omega**2 * (q.A - q.B * q.u1**2 - q.C * q.u2**2)
    sp, cp = sin(q.psi0), cos(q.psi0)
    first, second = q.u1 * q.mu2 * cp, q.mu1 * sp
    along = q.even * first + second if printed else -q.even * (first + second)
    return (
        -gravity * sin(2 * q.psi0) * cos(2 * q.x) - gravity * cos(2 * q.psi0) * sin(2 * q.x)
        + q.h1 * (along + q.u2 * cp * q.mu3) * cos(q.x)
        + q.h1 * (q.even * (q.u1 * q.mu2 * sp - q.mu1 * cp) - q.u2 * sp * q.mu3) * sin(q.x)
        + q.u2 * q.m * q.even * (q.k3 if printed else q.k1)
    )  # fmt: skip


def _thirty_seven(q: SimpleNamespace, printed: bool) -> Array:
    gravity = 1.5 * q.Omega**2 * (q.B - q.C) * q.u1 * q.u2
    field = q.h1 * (q.even * q.u2 * q.mu2 + q.u1 * q.mu3)
    rate = q.n - q.Omega if printed else -q.N
    turn = (q.A - q.B + q.C) * q.m + q.k3
    steady = -2.5 * (q.B - q.C) * q.u1 * q.Omega**2 + (-2 * q.n * (q.B - q.C) * q.u1 + turn) * q.Omega
    return (
        gravity * (cos(2 * q.psi0) * cos(2 * q.x) - sin(2 * q.psi0) * sin(2 * q.x))
        + field * (sin(q.psi0) * cos(q.x) + cos(q.psi0) * sin(q.x))
        + (rate * q.u1 * q.k2 + q.h3 * q.mu2 * q.u1 - q.m * q.k2) * q.even
        + q.u2 * (steady - q.n**2 * (q.B - q.C) * q.u1 + turn * q.n - q.mu3 * q.h3)
    )  # fmt: skip


def _thirty_eight(q: SimpleNamespace, printed: bool) -> Array:
    gravity = 1.5 * q.Omega**2 * q.u1 * q.D
    sp, cp = sin(q.psi0), cos(q.psi0)
    if printed:
        rotor = q.even * q.u2 * (q.n - q.Omega) * q.k1 + q.h3 * q.mu1
    else:
        rotor = q.even * q.u2 * (-q.N * q.k1 + q.h3 * q.mu1)
    return (
        -gravity * (sin(2 * q.psi0) * cos(2 * q.x) + cos(2 * q.psi0) * sin(2 * q.x))
        - q.even * q.h1 * (q.mu1 * q.u1 * sp + q.mu2 * cp) * cos(q.x)
        - q.even * q.h1 * (q.mu1 * q.u1 * cp - q.mu2 * sp) * sin(q.x) + rotor
    )  # fmt: skip


def _forty(q: SimpleNamespace, printed: bool) -> Array:
    # (-1)^(2j + 1) = -1
    gravity = -(q.u1**2 + 1) * q.D - ((q.A + q.B) * q.u1**2 + 2 * q.u2**2 * q.C - q.A - q.B)
    sp, cp = sin(q.psi0), cos(q.psi0)
    radial = -q.even * q.h1 * (q.mu1 * q.u1 * cp - q.mu2 * sp)
    normal = q.mu3 * q.h1 * q.u2 * cp * cos(q.x)
    return (
        -0.75 * q.Omega**2 * gravity * sin(2 * q.psi0) * cos(2 * q.x)
        + (1 if printed else -1) * 0.75 * q.Omega**2 * gravity * cos(2 * q.psi0) * sin(2 * q.x)
        + (radial if printed else radial * cos(q.x)) + normal
        + q.h1 * (q.even * q.mu1 * sp * (1 if printed else q.u1) + q.even * q.mu2 * cp - q.mu3 * q.u2 * sp) * sin(q.x)
        - q.even * q.m * q.u2 * q.k2
    )  # fmt: skip


def _forty_one(q: SimpleNamespace, printed: bool) -> Array:
    sp, cp = sin(q.psi0), cos(q.psi0)
    gravity = 0.75 * q.Omega**2 * q.u1 * q.u2 * (-q.D - q.sum)
    field = q.h1 * (q.even * q.mu1 * q.u2 + q.mu3 * q.u1)
    quadratic = 5 * q.Omega**2 + 4 * q.Omega * q.n + 2 * q.n**2
    steady = 0.25 * q.sum * quadratic * q.u1 - (q.m * q.C + q.k3) * q.N + q.mu3 * q.h3
    return (
        gravity * (sin(2 * q.psi0) * sin(2 * q.x) - cos(2 * q.psi0) * cos(2 * q.x))
        + field * ((sin(2 * q.psi0) if printed else sp) * cos(q.x) + cp * sin(q.x))
        - 0.25 * (quadratic * q.u1 + 4 * q.m * q.N) * q.D * q.u2
        + ((-q.k1 * q.N + q.mu1 * q.h3) * q.u1 - q.m * q.k1) * q.even - q.u2 * steady
    )  # fmt: skip


def _forty_two(q: SimpleNamespace, printed: bool) -> Array:
    sp, cp = sin(q.psi0), cos(q.psi0)
    gravity = 1.5 * q.Omega**2 * q.u1 * q.D
    magnet = q.h3 * q.mu2 * (1 if printed else -1)
    return (
        gravity * (sin(2 * q.psi0) * cos(2 * q.x) + cos(2 * q.psi0) * sin(2 * q.x))
        + q.even * q.h1 * (q.mu2 * q.u1 * sp - q.mu1 * cp) * cos(q.x)
        + q.even * q.h1 * (q.mu2 * q.u1 * cp + q.mu1 * sp) * sin(q.x) + q.even * q.u2 * (q.N * q.k2 + magnet)
    )  # fmt: skip


# number of the equation -> left side, and index of Lagrange's equation that it is
FORMS: dict[str, tuple[Form, int]] = {
    "(32)": (_thirty_two, 0), "(33)": (_thirty_three, 1), "(34)": (_thirty_four, 2),
    "(36)": (_thirty_six, 0), "(37)": (_thirty_seven, 1), "(38)": (_thirty_eight, 2),
    "(40)": (_forty, 0), "(41)": (_forty_one, 1), "(42)": (_forty_two, 2),
}  # fmt: skip


def any_time(rng: np.random.Generator, p: Point) -> tuple[Any, int]:
    """A random time, and 0."""
    return rng.uniform(0.5, 5.0), 0


def time_35(rng: np.random.Generator, p: Point) -> tuple[Any, int]:
    """A time of (35), where sin mt = 0 and cos mt = (-1)^i, and i."""
    i = int(rng.integers(1, 11))
    return np.pi * i / p["m"], i


def time_39(rng: np.random.Generator, p: Point) -> tuple[Any, int]:
    """A time of (39), where cos mt = 0 and sin mt = (-1)^j, and j."""
    j = int(rng.integers(0, 10))
    return np.pi / (2 * p["m"]) + np.pi * j / p["m"], j


def time_of(number: str) -> Time:
    """The times at which an equation of FORMS is stated."""
    return any_time if number < "(35)" else time_35 if number < "(39)" else time_39


def true_left_side(p: Point, t: Any, index: int) -> Array:
    """Left side of (5), (6) or (7), corrected, on theta = theta0, psi = psi0 + n t, phi = m t."""
    moved = {**p, "psi0": p["psi0"] + p["n"] * t, "phi0": p["m"] * t}
    zero = np.zeros(1)
    return lagrange.equations(euler_state(moved), (zero, zero, zero), constants(moved))[index]


def _row(number: str, printed: str, true: str, effect: str) -> PublishedEquation:
    """Row of an equation of FORMS."""
    form, index = FORMS[number]

    def residual(reading: bool) -> Measure:
        def measured(rng: np.random.Generator) -> float:
            point = random_point(rng)
            t, count = time_of(number)(rng, point)
            left = form(parts(point, t, count), reading)
            return float(np.abs(left - true_left_side(point, t, index))[0])

        return measured

    measure = f"left side at a random time, less that of ({5 + index}), corrected, on the precession"
    return PublishedEquation(
        number, "", printed, true, "misprint", measure, residual(True), residual(False), effect
    )


def _time_row(number: str, text: str, time: Time, value: Callable[[Any, int], Any]) -> PublishedEquation:
    """Row of a choice of times, true as printed; value vanishes at these times."""

    def measured(rng: np.random.Generator) -> float:
        point = random_point(rng)
        t, count = time(rng, point)
        return float(np.abs(value(point["m"] * t, count)).max())

    return PublishedEquation(
        number, "", text, "the same", "true", "what is to vanish at a random one of these times", measured, measured
    )  # fmt: skip


def determinant_quotient(angles: Array) -> float:
    """The determinant of (43) over the product of sines on its right, which is to be c_*."""
    rows = np.array([cos(2 * angles), sin(2 * angles), cos(angles), sin(angles), np.ones(5)]).T
    pairs = [sin((angles[j] - angles[i]) / 2) for i in range(5) for j in range(i + 1, 5)]
    return float(np.linalg.det(rows) / np.prod(pairs))


def _determinant(rng: np.random.Generator) -> float:
    """Relative difference of c_* of (43) between two random sets of angles, none of them close together."""
    first, second = (
        determinant_quotient(2 * np.pi / 5 * (np.arange(5) + rng.uniform(0, 0.7, 5))) for _ in range(2)
    )
    return abs(first / second - 1)


ROWS: tuple[PublishedEquation, ...] = (
    _row("(32)", "(B - A) [m (n + Omega) u2^2 + 3/2 Omega^2 u1 cos(..)] sin 2mt; -h1 mu2 u2 cos(psi0 + nt) cos mt; "
         "(A + B) u1^2 + 2 u2^2 A - B",
         "(B - A) [-m (n + Omega) u2^2 + 3/2 Omega^2 u1 cos(..)] sin 2mt; -h1 mu2 u1 cos(psi0 + nt) cos mt; "
         "(A + B) u1^2 + 2 u2^2 C - A - B",
         "no multiple of (5), (6) or (7) as printed; (36) and (40) have the second and third term right"),
    _row("(33)", "h1 mu1 u1 sin(psi0 + nt) sin mt", "h1 mu1 u2 sin(psi0 + nt) sin mt", "(41) has u2 too"),
    _row("(34)", "[Omega^2 (A - B) (u1^2 + 1) cos(..) - u2^2 (Omega^2 (A - B) - 4 n Omega - 2 n^2) / 3] sin 2mt; "
         "-h1 mu1 u1 sin(..) - h1 mu2 cos(..) without cos mt; u2 ((Omega + n) k2 + h3 mu2) sin mt",
         "-3/4 (A - B) [Omega^2 (u1^2 + 1) cos(..) + u2^2 (5 Omega^2 + 4 n Omega + 2 n^2) / 3] sin 2mt; "
         "[-h1 mu1 u1 sin(..) - h1 mu2 cos(..) - ..] cos mt; u2 ((Omega + n) k2 - h3 mu2) sin mt",
         "no multiple of (5), (6) or (7) as printed; (38) has cos mt too"),
    _time_row("(35)", "t = pi i / m, where sin mt = 0 and cos mt = (-1)^i", time_35,
              lambda x, i: np.array([sin(x), cos(x) - (-1) ** i])),
    _row("(36)", "h1 [(-1)^i u1 mu2 cos psi0 + mu1 sin psi0 + u2 mu3 cos psi0] cos(n pi i/m); u2 m (-1)^i k3",
         "h1 [-(-1)^i (u1 mu2 cos psi0 + mu1 sin psi0) + u2 mu3 cos psi0] cos(n pi i/m); u2 m (-1)^i k1",
         "where sin theta0 != 0 it would need m k3 = 0 as printed, in place of m k1 = 0"),
    _row("(37)", "(-Omega + n) u1 k2 + h3 mu2 u1 - m k2) (-1)^i", "(-(Omega + n) u1 k2 + h3 mu2 u1 - m k2) (-1)^i",
         "one bracket is missing in print; before Omega it makes the equation true"),
    _row("(38)", "(-1)^i u2 (-Omega + n) k1 + h3 mu1", "(-1)^i u2 (-(Omega + n) k1 + h3 mu1)",
         "(44) has the sum Omega + n right"),
    _time_row("(39)", "t = pi / 2m + pi j / m, where cos mt = 0 and sin mt = (-1)^j", time_39,
              lambda x, j: np.array([cos(x), sin(x) - (-1) ** j])),
    _row("(40)", "+3/4 Omega^2 [..] sin((1 + 2j) n pi/m); -(-1)^j h1 [..] + mu3 h1 u2 cos psi0 cos(..); "
         "h1 (-1)^j mu1 sin psi0",
         "-3/4 Omega^2 [..] sin((1 + 2j) n pi/m); {-(-1)^j h1 [..] + mu3 h1 u2 cos psi0} cos(..); "
         "h1 (-1)^j mu1 u1 sin psi0", "not (32) at the times (39) as printed"),
    _row("(41)", "h1 [(-1)^j mu1 u2 sin 2psi0 + mu3 u1 sin 2psi0] cos(..)",
         "h1 [(-1)^j mu1 u2 sin psi0 + mu3 u1 sin psi0] cos(..)", "not (33) at the times (39) as printed"),
    _row("(42)", "(-1)^j u2 [(Omega + n) k2 + h3 mu2]", "(-1)^j u2 [(Omega + n) k2 - h3 mu2]",
         "the sign of (34) again; (38) has it right for mu1"),
    PublishedEquation("(43)", "", "5 x 5 determinant = c_* times a product of ten sines, c_* a constant", "the same", "true",
                      "relative difference of c_* between two random sets of angles", _determinant, _determinant),
)  # fmt: skip
