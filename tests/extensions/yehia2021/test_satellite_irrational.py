"""Section 4.2 of the satellite's paper, (32)-(43), against Lagrange's equations by computer algebra."""

import numpy as np
import pytest
import sympy as sp
from truth import BODY_NAMES, lagrangian_arguments, lagrangian_functions, paper_vectors, satellite_symbols

from atlas.extensions.yehia2021.published import (
    ENTRIES,
    PUBLISHED,
    determinant_quotient,
    instant,
    left_side,
    parts,
    random_point,
    true_left_side,
)

NUMBERS = [f"({i})" for i in range(32, 44)]
TRUE = {"(35)", "(39)", "(43)"}
FORMS = [number for number in NUMBERS if number not in TRUE]


def left_sides(point, t):
    """Left sides of Lagrange's equations of (2) with (3) on the precession at the time t."""
    moved = {**point, "psi0": point["psi0"] + point["n"] * t, "phi0": point["m"] * t}
    return np.array(lagrangian_functions()["left_sides"](*lagrangian_arguments(moved)))[:, 0]


def ratios(number, printed, count=20):
    """Left side of an equation of section 4.2 over each of Lagrange's three, at times of one point: (3, count)."""
    rng = np.random.default_rng(1)
    point = random_point(rng)
    quotients = []
    for _ in range(count):
        at = instant(ENTRIES[number], rng, point)
        reading = "printed" if printed else "true"
        quotients.append(
            left_side(ENTRIES[number], reading, parts(point | at)) / left_sides(point, at["t"])[:, 0]
        )
    return np.array(quotients).T


@pytest.mark.parametrize("number", FORMS)
def test_the_true_reading_is_lagrange_s_equation_and_the_printed_one_is_no_multiple_of_any(number):
    index = ENTRIES[number]["left_side"] - 5
    np.testing.assert_allclose(ratios(number, printed=False)[index], 1, rtol=1e-9)
    spread = np.ptp(ratios(number, printed=True), axis=1)
    assert spread.min() > 1e-2


@pytest.mark.long
def test_harmonics_of_the_true_readings_by_computer_algebra():
    """(32)-(34) as the coefficients of cos 2phi, sin 2phi, cos phi, sin phi and 1 of Lagrange's equations."""
    (psi, theta, phi), (psi_dot, theta_dot, phi_dot), _, body = satellite_symbols()
    symbols = dict(zip(BODY_NAMES, body, strict=True))
    alpha, _, gamma, relative = paper_vectors()
    inertia, rotor, moment = (
        [symbols[name] for name in names.split()] for names in ("A B C", "k1 k2 k3", "mu1 mu2 mu3")
    )
    w = relative + symbols["Omega"] * gamma
    lagrangian = sum(
        inertia[i] * w[i] ** 2 / 2 + rotor[i] * w[i]
        - sp.Rational(3, 2) * symbols["Omega"] ** 2 * inertia[i] * alpha[i] ** 2
        - moment[i] * (symbols["h1"] * alpha[i] + symbols["h3"] * gamma[i])
        for i in range(3)
    )  # fmt: skip
    point = random_point(np.random.default_rng(4))
    numbers = {psi_dot: point["n"][0], theta_dot: 0, phi_dot: point["m"][0], theta: point["theta0"][0]}
    numbers |= {symbols[name]: point[name][0] for name in BODY_NAMES}
    x = point["psi0"] + 0.7
    # psi = x at phi = 0, pi/4, ...: five values of phi fix the five harmonics
    angles = 2 * np.pi * np.arange(5) / 5
    basis = np.array([np.cos(2 * angles), np.sin(2 * angles), np.cos(angles), np.sin(angles), np.ones(5)]).T
    for number, angle, rate in (("(32)", psi, psi_dot), ("(33)", theta, theta_dot), ("(34)", phi, phi_dot)):
        momentum = sp.diff(lagrangian, rate)
        equation = sum(sp.diff(momentum, q) * v for q, v in ((psi, psi_dot), (phi, phi_dot)))
        function = sp.lambdify((psi, phi), (equation - sp.diff(lagrangian, angle)).subs(numbers))
        expected = np.linalg.solve(basis, [function(x[0], a) for a in angles])
        entry, values = ENTRIES[number], parts(point | {"t": 0.0}) | {"psi": x}

        def value(a, entry=entry, values=values):
            return left_side(entry, "true", values | {"mt": a})[0]

        np.testing.assert_allclose(np.linalg.solve(basis, [value(a) for a in angles]), expected, atol=1e-12)


def test_the_determinant_is_256_times_the_product_of_sines():
    rng = np.random.default_rng(2)
    for _ in range(5):
        assert determinant_quotient(rng.uniform(0, 2 * np.pi, 5)) == pytest.approx(256, rel=1e-6)


def test_the_determinant_by_computer_algebra():
    """With z = exp(i phi) the rows are those of a Vandermonde matrix: the quotient of (43) has no angle in it."""
    z = sp.symbols("z1:6")
    vandermonde = sp.Matrix([[x**4, x**3, x**2, x, 1] for x in z]).det(method="berkowitz")
    differences = sp.prod(z[i] - z[j] for i in range(5) for j in range(i + 1, 5))
    assert sp.expand(vandermonde - differences) == 0


def test_every_equation_of_the_section_has_a_row_with_both_residuals():
    rows = {row.number: row for row in PUBLISHED}
    for number in NUMBERS:
        row = rows[number]
        assert (row.verdict == "true") == (number in TRUE)
        assert (row.printed != row.true and row.true != "the same") == (number not in TRUE)
        true = [row.residual_true(np.random.default_rng(seed)) for seed in range(5)]
        printed = [row.residual_printed(np.random.default_rng(seed)) for seed in range(5)]
        assert max(true) < 1e-12
        assert (max(printed) < 1e-12) if number in TRUE else max(printed) > 1e-2


def test_a_bracket_before_omega_makes_37_true():
    """The print lacks one bracket; without it k2 has the rate n - Omega."""
    rng = np.random.default_rng(3)
    point = random_point(rng)
    at = instant(ENTRIES["(37)"], rng, point)
    q = parts(point | at)
    change = left_side(ENTRIES["(37)"], "printed", q) - true_left_side(point, at["t"], 6)
    np.testing.assert_allclose(change, 2 * q["n"] * q["u1"] * q["k2"] * q["even"], atol=1e-13)
