"""Tests of equations of Amer, Abo Essa, Ibrahim & Amer. Each equation of equations.toml has a printed and a true reading.

Both readings have the true values of k, the frequency Omega, chi, chi1, nu and X, such as chi = 0 and X = 1 / Omega. In both readings
C A^-1 y2 replaces A^-1 y2. S1 and S2 follow from (2), or from the corrected (3). S11 to S22 follow from the corrected (13).
Terms in l2 / (A r0) of (13) are left out, because these terms are of higher order in eps. A residual is divided by the difference of
the readings, or by the exact value if the readings are equal. The true reading of an expansion in eps has a residual of order eps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from ...systems.base import Array
from ..catalogue.papers import Entry, expression, load, side
from . import fast_spin, periodic
from .fast_spin import (
    PAPER_BODIES,
    PAPER_ROTORS,
    FastSpin,
    paper_body,
    random_spin,
    true_acceleration,
    true_rate,
)

Values = dict[str, Any]
VARIABLES = ("p1", "q1", "r1", "g1", "g2", "g3")  # written p1, q1, r1, g1, g1' and g1'' in (1)
CONTENT, ENTRIES = load(__package__)


def evaluate(text: str, values: Values, definitions: Mapping[str, str] = CONTENT["definitions"]) -> Any:
    """Return the value of an expression in names of equations.toml. A name without a value is evaluated from its definition."""
    parsed = expression("equations.toml", text)
    for name in parsed.names - values.keys():
        values[name] = evaluate(definitions[name], values, definitions)
    return parsed.value(values)


def left_side(entry: Entry, reading: str, values: Values) -> Any:
    """Return the sum of the terms of an equation in one reading."""
    return side(entry, reading, ENTRIES, lambda term: evaluate(term, values))


def numbers(spin: FastSpin, *names: str) -> Values:
    """Return the named numbers of a body, and the components y1, y2, y3 of its rotor."""
    return {name: getattr(spin, name) for name in names} | dict(zip(("y1", "y2", "y3"), spin.y, strict=True))


def names(spin: FastSpin) -> Values:
    """Return the true values of a body's numbers, by the names of the numbers in equations.toml."""
    X, momentum = 1 / spin.Omega, spin.A * spin.r0
    fields = (
        "A", "C", "A1", "a", "k", "z", "r0", "eps", "l1", "l2", "l3", "Omega", "M3", "G0", "chi1", "nu", "gamma0",
    )  # fmt: skip
    return numbers(spin, *fields) | {
        "mu1": spin.mu.real, "mu2": spin.mu.imag, "s1": spin.l1 / momentum, "s2": spin.l2 / momentum,
        "s3": spin.l3 / momentum, "X": X, "chi2": spin.chi1 + spin.G0, "nu2": spin.nu - X,
    }  # fmt: skip


def state(y: Array, prefix: str = "") -> Values:
    """Return the components of y by the names of the variables of (1), with `prefix` before each name."""
    return {prefix + name: value for name, value in zip(VARIABLES, y, strict=True)}


# The following functions give S1 and S2 of the corrected (3), and states that satisfy (2) with these S1 and S2.


def S1_S2(spin: FastSpin, y0: Array, y: Array) -> tuple[Array, Array]:
    """Return S1 and S2 of the corrected (3) at a state y of the motion from y0."""
    (p0, q0, _, g10, g20, _), (p, q, _, g1, g2, g3) = y0, y
    a, k = spin.a, spin.k
    y1, y2, y3 = spin.y
    transverse = g10**2 - g1**2 + g20**2 - g2**2
    S1 = a * (p0**2 - p**2 + q0**2 - q**2) + k * (a * transverse + 1 - g3**2) - 2 * spin.z * (1 - g3)
    S2 = a * (p0 * g10 - p * g1 + q0 * g20 - q * g2) + y1 * (g10 - g1) + y2 * (g20 - g2) + y3 * (1 - g3)
    return S1, S2


def on_integrals(spin: FastSpin, y0: Array, y: Array) -> Array:
    """Return the state y with r1 and g1'' replaced by their values from (2) and the start y0."""
    S1, S2 = S1_S2(spin, y0, y)
    r = np.sqrt(1 + spin.eps**2 * S1)
    return np.array([*y[:2], r, *y[3:5], (1 + spin.eps * S2) / r])


def random_states(rng: np.random.Generator, spin: FastSpin) -> tuple[Array, Array]:
    """Return two random states with equal energy and area integral, as defined by (2) and the corrected (3). In the first, r1 = g3 = 1."""
    y0, y = rng.normal(size=(2, 6))
    y0[[2, 5]] = y[[2, 5]] = 1.0
    for _ in range(60):  # each step is a contraction by a factor of order eps
        y = on_integrals(spin, y0, y)
    return y0, y


def of_variables(spin: FastSpin, x: Array, start: Array | None = None) -> Array:
    """Return y from (p2, p2', gamma2, gamma2'). r1 and g1'' follow from the integrals (2) of `start`, and are 1 without a start."""
    p, v, g, u = x
    eps, q, g2, r, g3 = spin.eps, 0.0, 0.0, 1.0, 1.0
    for _ in range(60):
        field = spin.z / spin.a - spin.k * spin.A1 * g3
        q = spin.mu.imag * r - v - eps * (spin.chi1 * u + field * g2)
        q = q / (spin.A1 * r + spin.l3 / (spin.A * spin.r0))
        g2 = (u + eps * (spin.nu * v + q * g3)) / r
        y = np.array(np.broadcast_arrays(p + eps * spin.chi1 * g, q, r, g + eps * spin.nu * p, g2, g3))
        if start is not None:
            r, g3 = on_integrals(spin, start, y)[[2, 5]]
    return y


def variables(x0: Array, x: Array) -> Values:
    """Return p2, p2', gamma2, gamma2' under the names p, v, g, u at x and p0, v0, g0, u0 at x0. Dp is p0 - p, Dpv is p0 v0 - p v etc."""

    def products(x: Array) -> Values:
        values = dict(zip("pvgu", x, strict=True))
        return values | {a + b: values[a] * values[b] for a, b in combinations_with_replacement("pvgu", 2)}

    first, second = products(x0), products(x)
    differences = {f"D{name}": first[name] - second[name] for name in first}
    return (
        dict(zip("pvgu", x, strict=True)) | dict(zip(("p0", "v0", "g0", "u0"), x0, strict=True)) | differences
    )


# The following functions of a random generator and an entry return values for the expressions of the entry. AT maps the value of
# `at` in an entry to the function.


def _states(rng: np.random.Generator, entry: Entry) -> Values:
    """Return the values of two random states of one motion. S1 and S2 belong to the second state."""
    spin = random_spin(rng, r0=entry.get("r0", 1e4))
    y0, y = random_states(rng, spin)
    x0, x = (fast_spin.to_quasilinear(spin, each) for each in (y0, y))
    S1, S2 = S1_S2(spin, y0, y)
    return names(spin) | variables(x0, x) | state(y) | {"S1": S1, "S2": S2}


def _motion(rng: np.random.Generator, entry: Entry) -> Values:
    """Return a random state with rates and accelerations. S1 and S2, from which (2) gives r1 and g1'', are random too."""
    spin = random_spin(rng, r0=entry.get("r0", 1e4))
    p, q, g1, g2, S1, S2 = rng.normal(size=6)
    r = np.sqrt(1 + spin.eps**2 * S1)
    y = np.array([p, q, r, g1, g2, (1 + spin.eps * S2) / r])
    rates = state(true_rate(spin, y), "d_") | state(true_acceleration(spin, y), "dd_")
    return names(spin) | state(y) | rates | {"S1": S1, "S2": S2}


def _generating_solution(rng: np.random.Generator, entry: Entry) -> Values:
    """Return the solution (25), with the true frequency, on a grid of the phases t1 = Omega tau and tau."""
    spin = random_spin(rng, **{"r0": entry["r0"]} if "r0" in entry else {})
    E, eta = rng.uniform(0.5, 1.5, 2) * (entry.get("amplitude", 1.0), 1)
    phases = 2 * np.pi * np.arange(12) / 12
    tau, t1 = phases[:, None], phases
    M1, M2, w = E * np.cos(eta), E * np.sin(eta), spin.Omega
    x0 = np.array([M1, w * M2, spin.M3, 0.0])
    p, v = M1 * np.cos(t1) + M2 * np.sin(t1), w * (M2 * np.cos(t1) - M1 * np.sin(t1))
    x = np.array(np.broadcast_arrays(p, v, spin.M3 * np.cos(tau), -spin.M3 * np.sin(tau)))
    beta = dict(zip(("b1", "b2", "b3"), rng.uniform(0.1, 1.0, 3), strict=True))
    return (
        names(spin) | variables(x0, x) | {"M1": M1, "M2": M2, "E": E, "eta": eta, "t1": t1, "tau": tau} | beta
    )


def _series(rng: np.random.Generator, entry: Entry) -> Values:
    """Return two random states of a random body, and p2'' and gamma2'' by the equations of motion at eight values of eps."""
    eps = 0.002 * np.array([-4.0, -3, -2, -1, 1, 2, 3, 4])
    C, gamma0, (l1, l2, l3) = rng.uniform(1.2, 1.8), rng.uniform(0.3, 0.7), rng.uniform(0.5, 1, 3)
    spin = FastSpin(1.0, C, C / gamma0, rng.uniform(1, 2), l1, l2, l3, 1 / eps, gamma0).of_shape(eps.shape)
    x0, x = rng.normal(size=(2, 4, 1)) * np.ones(eps.size)
    y = of_variables(spin, x, of_variables(spin, x0))
    rate = fast_spin.rhs(spin, y)
    # This difference is exact, because (1) is quadratic.
    acceleration = 0.5 * (fast_spin.rhs(spin, y + rate) - fast_spin.rhs(spin, y - rate))
    exact = zip(("dd_p", "dd_g"), fast_spin.p2_gamma2(spin, acceleration), strict=True)
    return names(spin) | variables(x0, x) | dict(exact)


@cache
def _periodic(body: str, rotor: float) -> Values:
    """Return the state at tau = 0 of the periodic solution for a body of section VI, with p2, p2', gamma2 and gamma2'."""
    spin = paper_body(body, rotor).of_shape((1,))
    start = periodic.solutions(spin).start
    x = dict(zip("pvgu", fast_spin.to_quasilinear(spin, start), strict=True))
    return names(spin) | state(start) | x | {"b1": 0.0, "b2": 0.0, "b3": 0.0}


def _orbit(rng: np.random.Generator, entry: Entry) -> Values:
    """Return the values of `_periodic` for a random body and a random rotor from section VI of the paper."""
    return dict(_periodic(str(rng.choice(list(PAPER_BODIES))), float(rng.choice(PAPER_ROTORS[1:4]))))


AT: dict[str, Callable[[np.random.Generator, Entry], Values]] = {
    "states": _states, "motion": _motion, "generating": _generating_solution, "series": _series, "orbit": _orbit,
}  # fmt: skip


def residual(entry: Entry, reading: str, rng: np.random.Generator) -> float:
    """Return the largest error of a reading in units of the exact value. With "terms_printed" the unit is printed minus true value."""
    values = AT[entry["at"]](rng, entry)
    results = [evaluate(entry["exact"], values)]
    results += [left_side(entry, each, values) for each in ("printed", "true")]
    if "order" in entry:  # a coefficient of the series in eps
        powers = np.vander(values["eps"], increasing=True)
        results = [np.linalg.solve(powers, each + 0 * values["eps"])[entry["order"]] for each in results]
    elif "mean" in entry:  # the mean of each result over all phases
        results = [np.mean(each) for each in results]
    exact, printed, true = results
    size = np.abs(printed - true).max() if "terms_printed" in entry else max(np.abs(exact).max(), 1e-3)
    return float(np.abs((printed if reading == "printed" else true) - exact).max() / size)
