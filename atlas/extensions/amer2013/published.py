"""The fast-spin formulas of Amer, Abo Essa, Ibrahim & Amer exactly as the paper prints them.

The formulas serve for comparison only, because most of them are wrong. PUBLISHED lists the errors, with measured sizes where
possible. The table [printed] of equations.toml has the formulas, and `reduction` has the steps between (6) and (27). Each
function has the signature and the units of its namesake in `fast_spin`. X of (11) and formulas with X need A1 != 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from ...errors import BadInput
from ...systems.base import Array, Points
from ..catalogue.papers import EntryMeasure, rows
from . import fast_spin, reduction
from .fast_spin import FastSpin, paper_spin, random_spin, true_acceleration, true_rate
from .reduction import CONTENT, VARIABLES, Values, evaluate, state

COEFFICIENTS = ("chi", "chi1", "nu", "X", "chi2", "nu2")


def frequency_squared(spin: FastSpin) -> Array:
    """Return omega'^2 = A1^2 - 2 A1 l3 / (A r0), as printed after (8). The value may be negative."""
    return spin.A1**2 - 2 * spin.A1 * spin.l3 / (spin.A * spin.r0)


def numbers(spin: FastSpin) -> Values:
    """Return the numbers of a body by their names in the table [printed]."""
    names = ("A", "C", "weight", "N", "l1", "l2", "l3", "r0", "gamma0", "A1", "a", "z", "scale", "eps", "M3")
    return reduction.numbers(spin, *names) | {"squared": frequency_squared(spin)}


def formulas(values: Values, *names: str) -> Array:
    """Return the values of formulas in the table [printed], shape (names, ...)."""
    return np.array(np.broadcast_arrays(*(evaluate(name, values, CONTENT["printed"]) for name in names)))


@lru_cache(maxsize=8)  # coefficients are needed at every step of an integration
def coefficients(spin: FastSpin) -> Values:
    """Return the result of `numbers`, with chi, chi1, nu of (10) and X, chi2, nu2 of (11). Raise BadInput where a divisor is zero."""
    values = numbers(spin)
    if np.any(spin.A1 == 0):
        raise BadInput("A1 = 0 (A = C): X of (11) divides by A1")
    if np.any((values["squared"] == 1) | (values["squared"] == 0)):
        raise BadInput("omega'^2 = 0 or 1: chi, chi1 and nu of (10) divide by omega'^2 or 1 - omega'^2")
    formulas(values, *COEFFICIENTS)
    return values


def rhs(spin: FastSpin, y: Array) -> Array:
    """Return dy/dtau from (1) with (4) and (5). A = B, so that C1 = 0."""
    values = numbers(spin) | state(y)
    return formulas(values, *(f"d_{name}" for name in VARIABLES))


def integrals(spin: FastSpin, y: Array) -> Array:
    """Return the constants of the motion from (2) with (3). They are the energy, the area integral and |gamma|^2, shape (3, ...)."""
    return formulas(numbers(spin) | state(y), "energy", "area", "length")


def quasilinear(spin: FastSpin, x: Array, x0: Array) -> Array:
    """Return d/dtau of x = (p2, p2', gamma2, gamma2') from (15), with F1 and Phi1 of (16). The vector x0 is x at tau = 0."""
    (p, v, g, u), (p0, v0, g0, u0), values = x, x0, coefficients(spin)
    A, C, A1, a, r0, eps, X, chi2 = (values[name] for name in ("A", "C", "A1", "a", "r0", "eps", "X", "chi2"))
    l1, l2, y1, y2 = (values[name] for name in ("l1", "l2", "y1", "y2"))
    twist = (v0 * u0 - v * u) - X / (A * r0) * l2 * (v0 - v)
    S21 = a * ((p0 * g0 - p * g) - X * twist) + y1 * (g0 - g) + y2 * (1 - a * X * C / A) * (u0 - u)
    inner = (v**2 - 2 * y2 / A * v + 2 * v * chi2 * u) / C - A1 * p * (y2 / A - v) / C
    F1 = -values["chi1"] * l1 / (A * r0) + l2 / (A1 * r0) * inner
    Phi1 = l1 * S21 / (A * r0) + u * (l1 / A * (y2 / A - v) - l2 * p) / (C * r0)
    return np.array(
        [v, C * A1 * y1 / A + eps * F1 - values["squared"] * p, u, l1 / (A * r0) + eps * Phi1 - g]
    )


def first_order(spin: FastSpin, tau: Array) -> Array:
    """Return y, (6, ...), of the periodic solution (33). `tau` broadcasts with the fields of `spin`."""
    return formulas(coefficients(spin) | {"tau": tau}, *VARIABLES)


def to_quasilinear(spin: FastSpin, y: Array) -> Array:
    """Return (p2, gamma2), shape (2, ...), of the state y by equations (10)."""
    return formulas(coefficients(spin) | state(y), "p2", "gamma2")


def period_correction(spin: FastSpin, turns: int = 1) -> Array:
    """Return alpha(eps) of (33), where beta3 is set to 0, its value to the lowest order."""
    return turns * formulas(coefficients(spin), "alpha")[0]


def angles(spin: FastSpin, t: Array) -> Array:
    """Return theta, psi and phi from the formulas after (34) with h = 0, shape (3, ...)."""
    values = coefficients(spin)
    now, start = (formulas(values | {"t": time}, "theta", "psi", "phi") for time in (t, np.zeros_like(t)))
    theta, psi, phi = now - start
    return np.array([np.arctan(spin.M3) + theta, psi, np.pi / 2 + phi])


def check(points: Points, duration: Array) -> None:
    """Raise BadInput for points at which the printed solution does not exist, and for runs longer than MAX_RADIANS."""
    with np.errstate(all="ignore"):
        coefficients(fast_spin.fast_spin(points))
    fast_spin.check(points, duration)


def measured_period_correction(spin: FastSpin, turns: int = 4) -> float:
    """Return the correction alpha of (33) to the period of a turn, measured in a run. The vector (y[3], y[4]) turns once in a period."""
    tau = np.linspace(0, 2 * np.pi * turns, 40 * turns + 1)
    y = fast_spin.integrate(spin, fast_spin.first_order(spin, np.array(0.0)), tau)
    rate = fast_spin.rhs(spin, y)
    speed = -((rate[3] + 1j * rate[4]) / (y[3] + 1j * y[4])).imag
    window = np.sin(np.pi * tau / tau[-1]) ** 2  # removes the oscillations with the period of a turn
    return float(-2 * np.pi * ((speed - 1) * window).sum() / window.sum())


# The following functions measure the errors of printed formulas and of true formulas.

Formula = Callable[[FastSpin, Array], Array]


def _of_body(
    measure: Callable[[FastSpin, np.random.Generator, Any], Any],
    printed: Any,
    true: Any,
    draw: Callable[[np.random.Generator], FastSpin] = random_spin,
) -> EntryMeasure:
    """Return a function (entry, reading, generator) whose value is the largest magnitude of `measure` for a body from `draw`."""
    readings = {"printed": printed, "true": true}
    return lambda entry, reading, rng: float(np.abs(measure(draw(rng), rng, readings[reading])).max())


def _rate_error(
    index: int | list[int], spin: FastSpin, rng: np.random.Generator, right_side: Formula
) -> Array:
    y = rng.normal(size=6)
    return (right_side(spin, y) - true_rate(spin, y))[index]


def _constancy(index: int | list[int], spin: FastSpin, rng: np.random.Generator, constants: Formula) -> Array:
    begin = fast_spin.first_order(spin, np.array(0.0))
    y = fast_spin.integrate(spin, begin, np.linspace(0, 2 * np.pi, 41))
    return np.ptp(constants(spin, y)[index], axis=-1)


def _direction_cosine(spin: FastSpin, rng: np.random.Generator, sign: int) -> Array:
    y = rng.normal(size=6)
    return (true_rate(spin, y)[3] + sign * spin.eps * y[1] * y[5]) / y[2] - y[4]


def _coupling_residual(
    spin: FastSpin, rng: np.random.Generator, pair: Callable[[FastSpin], tuple[Array, Array]]
) -> Array:
    """Return the error of chi1 and nu. The part eps chi1 G of w = p1 + i q1 must turn like G = g1 + i g2, and part eps nu w of G like w."""
    chi1, nu = pair(spin)
    forced = true_rate(spin, np.array([spin.eps * chi1, 0, 1, 1, 0, 1]))[1] / spin.eps
    carried = true_rate(spin, np.array([1, 0, 1, spin.eps * nu, 0, 1]))[4] / spin.eps
    return np.abs(forced + chi1) + np.abs(carried - spin.Omega * nu)


def _reduced_error(index: int, spin: FastSpin, rng: np.random.Generator, right_side: Formula) -> Array:
    """Return the error of the reduced equation for p2'' (index 1) or gamma2'' (index 3), divided by the forced term."""
    y = fast_spin.first_order(spin, rng.uniform(0, 6, 1))[:, 0]
    exact = fast_spin.p2_gamma2(spin, true_acceleration(spin, y))[index // 2]
    term = (spin.Omega if index == 1 else spin.eps * spin.nu) * spin.mu.real
    return (right_side(spin, fast_spin.to_quasilinear(spin, y))[index] - exact) / term


def _solution_error(index: int, spin: FastSpin, rng: np.random.Generator, solution: Formula) -> Array:
    return _solution_errors(spin, solution)[index]


@cache
def _solution_errors(spin: FastSpin, solution: Formula) -> Array:
    """Return the largest errors of the solution for tau from 0 to 2 pi, relative to the forced part of its first-order term."""
    tau = np.linspace(0, 2 * np.pi, 41)
    y = fast_spin.integrate(spin, solution(spin, np.array(0.0)), tau)
    forced = np.abs(spin.forced)
    size = np.array([forced, forced, spin.eps**2 * spin.a * forced**2, *3 * (spin.eps * forced,)])
    return np.abs(solution(spin, tau) - y).max(-1) / size


def _angle_error(index: int, spin: FastSpin, rng: np.random.Generator, formula: Formula) -> Array:
    """Return the largest error of theta, psi or phi in two turns of the body, relative to the oscillation of first order in eps."""
    t, *exact = _exact_angles(spin)
    return np.abs(formula(spin, t)[index] - exact[index]).max() / (spin.eps * np.abs(spin.forced))


@cache
def _exact_angles(spin: FastSpin) -> tuple[Array, Array, Array, Array]:
    """Return times in two turns of the body at the spin r0, and theta, psi and phi at these times from the integrated motion."""
    from scipy.integrate import cumulative_simpson  # slow to import, and scenes do not need it

    tau = np.linspace(0, 4 * np.pi, 401)
    begin = fast_spin.first_order(spin, np.array(0.0))
    p, q, _, g1, g2, g3 = fast_spin.dimensional(spin, fast_spin.integrate(spin, begin, tau))
    t = tau / spin.r0
    psi = cumulative_simpson((p * g1 + q * g2) / (1 - g3**2), x=t, initial=0)
    return t, np.arccos(g3), psi, np.unwrap(np.arctan2(g1, g2))


def _constant_10(spin: FastSpin, rng: np.random.Generator, chi: Callable[[FastSpin], Array]) -> Array:
    """Return chi minus the term A1 (q1 l1 - p1 l2) q1 / (C r0) of (7), on the forced motion p1 + i q1 = mu / Omega."""
    y = np.array([spin.forced.real, spin.forced.imag, 1, 0, 0, 1])
    return chi(spin) - spin.A1 * y[1] * true_rate(spin, y)[2] / (spin.eps * spin.Omega**2)


def _change_by_units(spin: FastSpin, rng: np.random.Generator, term: Callable[[FastSpin], Array]) -> Array:
    """Return the relative change of a dimensionless number when the unit of mass is halved."""
    doubled = {name: 2 * getattr(spin, name) for name in ("A", "C", "weight", "l1", "l2", "l3")}
    return term(replace(spin, **doubled)) / term(spin) - 1


def _kernel_24(spin: FastSpin, rng: np.random.Generator, frequencies: Callable[[FastSpin], Any]) -> Array:
    """Return h'' + f^2 h - 1 at a random tau for frequencies f and w. h is the integral of sin(w (tau - t1)) / f over t1 from 0 to tau."""
    (f, w), tau = frequencies(spin), rng.uniform(0.5, 5.0)
    return (w * np.cos(w * tau) + f**2 * (1 - np.cos(w * tau)) / w) / f - 1


_ONE, _NONE = np.array([1.0, 0, 1, 0, 0, 1]), np.array([0.0, 0, 1, 0, 0, 1])
_FAST = partial(random_spin, r0=50.0)
_FASTEST = partial(random_spin, r0=1e5)
# The key of a measure is the number of an equation, or a key of entries in equations.toml.
MEASURES: dict[str, EntryMeasure] = {
    "(1), second equation": _of_body(partial(_rate_error, 1), rhs, fast_spin.rhs),
    "(1) but for the second equation, (5)": _of_body(
        partial(_rate_error, [0, 2, 3, 4, 5]),
        *2 * (lambda spin, y: rhs(replace(spin, N=spin.N * spin.gamma0), y),),
    ),
    "(2), (3), S2": _of_body(partial(_constancy, [1, 2]), integrals, integrals),
    "(3), S1": _of_body(partial(_constancy, 0), integrals, fast_spin.integrals),
    "(4)": _of_body(partial(_rate_error, 0), rhs, fast_spin.rhs),
    "(7), (15)": _of_body(
        # the derivative of q1' by p1 is the frequency of p1 and q1
        lambda spin, rng, squared: squared(spin) - (true_rate(spin, _ONE) - true_rate(spin, _NONE))[1] ** 2,
        frequency_squared,
        lambda spin: spin.Omega**2,
    ),
    "(9)": _of_body(_direction_cosine, -1, 1),
    "(10), chi1 and nu": _of_body(
        _coupling_residual,
        lambda spin: formulas(coefficients(spin), "chi1", "nu"),
        lambda spin: (spin.chi1, spin.nu),
        partial(random_spin, l1=0.0, l2=0.0),
    ),
    "(10), chi": _of_body(
        _constant_10, lambda spin: coefficients(spin)["chi"], lambda spin: np.zeros(()), _FAST
    ),
    "(15), second equation": _of_body(
        partial(_reduced_error, 3), lambda spin, x: quasilinear(spin, x, x), fast_spin.quasilinear, _FASTEST
    ),
    "(16), (27)-(33)": _of_body(
        _change_by_units,
        lambda spin: (spin.y[1] * coefficients(spin)["X"] / spin.A) ** 2,
        lambda spin: (spin.C * spin.y[1] * coefficients(spin)["X"] / spin.A) ** 2,
    ),
    # (19), with the true frequency, has no forcing
    "(19), (20), (25)": _of_body(
        partial(_reduced_error, 1),
        lambda spin, x: np.array([x[1], -(spin.Omega**2) * x[0], x[3], -x[2]]),
        fast_spin.quasilinear,
        _FASTEST,
    ),
    "(24), h_k": _of_body(
        _kernel_24, lambda spin: (1, np.sqrt(frequency_squared(spin))), lambda spin: (1, 1), _FAST
    ),
    "(24), g_k": _of_body(_kernel_24, *2 * (lambda spin: 2 * (np.sqrt(frequency_squared(spin)),),), _FAST),
    # The printed form says W1 > 0, the true form W1 < 0. The error of a form is |W1| where W1 contradicts the form, else 0.
    "(32)": _of_body(
        lambda spin, rng, sign: np.maximum(0, -sign * formulas(coefficients(spin), "W1")), 1, -1, paper_spin
    ),
    **{
        f"(33), {name}": _of_body(
            partial(_solution_error, index), first_order, fast_spin.first_order, paper_spin
        )
        for index, name in enumerate(("p1", "q1", "r1", "g1", "g1'", "g1''"))
    },
    # relative errors of alpha
    "(33), alpha": _of_body(
        lambda spin, rng, correction: correction(spin) / measured_period_correction(spin) - 1,
        period_correction,
        fast_spin.period_correction,
        partial(random_spin, r0=1e3),
    ),
    "theta after (34)": _of_body(partial(_angle_error, 0), angles, fast_spin.angles, paper_spin),
    "psi after (34)": _of_body(partial(_angle_error, 1), angles, fast_spin.angles, paper_spin),
    "phi after (34)": _of_body(partial(_angle_error, 2), angles, fast_spin.angles, paper_spin),
    "at": reduction.residual,
}

PUBLISHED = rows(CONTENT, MEASURES)
