"""The steps from the equations of motion to (33): by computer algebra, along the motion, and their printed forms."""

import numpy as np
import pytest
import sympy as sp

from atlas.extensions.amer2013 import fast_spin, published, reduction

ROWS = {row.number: row for row in published.PUBLISHED}
NUMBERS = ("p1", "q1", "r1", "g1", "g2", "g3")


def of_states(spin, y0, y):
    """The names of equations.toml at two states of one motion."""
    x0, x = (fast_spin.to_quasilinear(spin, state) for state in (y0, y))
    return reduction.names(spin) | reduction.variables(x0, x) | dict(zip(NUMBERS, y, strict=True))


# (7) and (8) by computer algebra, from (1) with k of (1) corrected.


SYMBOLS = sp.symbols("p q r g1 g2 g3 eps A1 a k z m1 m2 s3 S1 S2")


def second_derivative(name, order, **given):
    """p1'' or g1'' as a series in eps, with r1^2 = 1 + eps^2 S1, r1 g1'' = 1 + eps S2 and s3 = l3 / (A r0)."""
    p, q, r, g1, g2, g3, eps, A1, a, k, z, m1, m2, s3, S1, S2 = SYMBOLS
    field = eps * (z / a - k * A1 * g3)
    rates = {
        p: -(A1 * r + s3) * q + m2 * r - field * g2,
        q: (A1 * r + s3) * p - m1 * r + field * g1,
        r: eps**2 * a * (q * m1 - p * m2),
        g1: r * g2 - eps * q * g3,
        g2: eps * p * g3 - r * g1,
        g3: eps * (q * g1 - p * g2),
    }
    rate = rates[sp.Symbol(name)]
    second = sum(sp.diff(rate, other) * slope for other, slope in rates.items()).subs(given)
    on_integrals = second.subs(g3, (1 + eps * S2) / r).subs(r, sp.sqrt(1 + eps**2 * S1))
    return sp.expand(sp.series(on_integrals, eps, 0, order + 1).removeO())


def random_numbers(seed):
    """A random body, state, S1 and S2, and the values of SYMBOLS there; r and g3 are not needed."""
    rng = np.random.default_rng(seed)
    spin = fast_spin.random_spin(rng, r0=1.0, weight=1.0)
    y, S1, S2 = rng.normal(size=6), *rng.normal(size=2)
    values = [
        y[0], y[1], 1, y[3], y[4], 1, spin.eps, spin.A1, spin.a, spin.k, spin.z, spin.mu.real, spin.mu.imag,
        spin.l3 / (spin.A * spin.r0), S1, S2,
    ]  # fmt: skip
    return spin, y, S1, S2, dict(zip(SYMBOLS, map(float, values), strict=True))


def assert_reading_is(number, spin, y, more, exact):
    """The true reading of an equation is a number, the printed one is not."""
    values = reduction.names(spin) | dict(zip(NUMBERS, y, strict=True)) | more
    assert float(reduction.left_side(reduction.ENTRIES[number], "true", values)) == pytest.approx(
        exact, rel=1e-12
    )
    assert abs(float(reduction.left_side(reduction.ENTRIES[number], "printed", values)) - exact) > 1e-3


@pytest.mark.long
def test_7_is_the_series_of_p1():
    """In (7) eps mu1 = l1 / (A r0): its first order contains the terms of order eps^2 with mu, without l3."""
    _, _, _, _, _, _, eps, *_, m1, m2, s3, _, _ = SYMBOLS
    series = second_derivative("p", 2)
    second = series.coeff(eps, 2)
    with_rotor = (second - second.subs({m1: 0, m2: 0})).subs(s3, 0)
    expected = series.coeff(eps, 0) + eps * series.coeff(eps, 1) + eps**2 * with_rotor
    for seed in range(3):
        spin, y, S1, _, values = random_numbers(seed)
        exact = float(expected.subs(values))
        assert_reading_is("(7), forcing and first order", spin, y, {"S1": S1}, exact)


@pytest.mark.long
def test_8_is_the_series_of_g1():
    """With l3 / (A r0) of order eps."""
    eps, s3 = SYMBOLS[6], SYMBOLS[13]
    m3 = sp.Symbol("m3")
    series = second_derivative("g1", 3, s3=eps * m3).subs(m3, s3 / eps)
    for seed in range(3):
        spin, y, S1, S2, values = random_numbers(seed)
        exact = float(series.subs(values))
        assert_reading_is("(8)", spin, y, {"S1": S1, "S2": S2}, exact)


# The others along the motion.


def test_random_states_have_the_energy_and_area_of_their_start():
    rng = np.random.default_rng(0)
    spin = fast_spin.random_spin(rng, r0=100.0)
    y0, y = reduction.random_states(rng, spin)
    start, state = (fast_spin.integrals(spin, point)[:2] for point in (y0, y))
    np.testing.assert_allclose(state, start, rtol=1e-14)
    assert np.abs(y - y0).max() > 0.1


def test_accelerations_are_those_of_the_motion():
    rng = np.random.default_rng(1)
    spin, y = fast_spin.random_spin(rng), rng.normal(size=6)
    h = 1e-4
    ahead, behind = (fast_spin.integrate(spin, y, np.array([0.0, side * h]))[:, -1] for side in (1, -1))
    numeric = (ahead - 2 * y + behind) / h**2
    np.testing.assert_allclose(
        fast_spin.true_acceleration(spin, y), numeric, atol=1e-5 * np.abs(numeric).max()
    )


def errors_along_a_motion(seed, r0, printed):
    """Errors of r1, q1 and |gamma|^2 by (14), (11) and (17) over eps^3, eps^2, eps^2, on the full equations."""
    rng = np.random.default_rng(seed)
    spin = fast_spin.random_spin(rng, r0=r0)
    y0 = rng.normal(size=6)
    y0[[2, 5]] = 1.0
    y = fast_spin.integrate(spin, y0, np.array([0.0, 2.0]))[:, -1]
    values, which = of_states(spin, y0, y), "printed" if printed else "true"
    third, q1, length = (
        reduction.left_side(reduction.ENTRIES[number], which, values)
        for number in ("(14)", "(11), q1", "(17)")
    )
    r1, length = 1 + spin.eps**2 * (0.5 * values["S11"] + spin.eps * third), length + 1
    exact = y[2], y[1], (y0[3:] ** 2).sum()
    return (np.array([r1, q1, length]) - exact) / spin.eps ** np.array([3, 2, 2])


def test_expansions_hold_along_a_motion():
    """The error of a true expansion falls with eps below its last order, that of a printed one does not."""
    for printed, factor in ((False, 10.0), (True, 1.0)):
        coarse, fine = (
            np.linalg.norm([errors_along_a_motion(seed, r0, printed) for seed in range(4)], axis=0)
            for r0 in (300.0, 3000.0)
        )
        np.testing.assert_allclose(coarse / fine, factor, rtol=0.15)


@pytest.mark.parametrize("signs", [(-1, 1), (1, -1), (-1, -1)])
def test_each_sign_in_S21_is_wrong_as_printed(signs):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        spin = fast_spin.random_spin(rng, r0=1e4)
        y0, y = reduction.random_states(rng, spin)
        values = of_states(spin, y0, y)
        S2 = reduction.S1_S2(spin, y0, y)[1] - spin.eps * reduction.evaluate("S22", values)
        text = "a * (Dpg - X * (Dvu + ({}) * X * s2 * Dv)) + y1 * Dg + y2 * (1 + ({}) * a * X * C / A) * Du"
        true, printed = (abs(S2 - reduction.evaluate(text.format(*pair), values)) for pair in ((1, 1), signs))
        assert true < 1e-5
        assert printed > 1e3 * true


def test_Phi1_is_what_8_has_at_first_order_in_the_rotor():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        spin = fast_spin.random_spin(rng, r0=1e5)
        y0, y = reduction.random_states(rng, spin)
        values = of_states(spin, y0, y)
        torque = (y[1] * spin.l1 - y[0] * spin.l2) / (spin.C * spin.r0)
        exact = spin.l1 * reduction.S1_S2(spin, y0, y)[1] / (spin.A * spin.r0) + torque * y[4]
        by_16 = reduction.evaluate(reduction.ENTRIES["(27), Phi1"]["exact"], values)
        assert float(by_16) == pytest.approx(float(exact), rel=1e-3)


def test_the_generating_S11_vanishes_at_the_start_only_when_corrected():
    entry = reduction.ENTRIES["(26), S11"]
    values = reduction.AT["generating"](np.random.default_rng(2), entry)
    true, printed = (float(reduction.left_side(entry, which, values)[0, 0]) for which in ("true", "printed"))
    assert abs(true) < 1e-14
    assert abs(printed) > 1e-2


def test_variables_of_a_state_lead_back_to_it():
    rng = np.random.default_rng(6)
    spin = fast_spin.random_spin(rng, r0=300.0)
    y0, y = reduction.random_states(rng, spin)
    x0, x = (fast_spin.to_quasilinear(spin, state) for state in (y0, y))
    start = reduction.of_variables(spin, x0)
    np.testing.assert_allclose(start, y0, atol=1e-13)
    np.testing.assert_allclose(reduction.of_variables(spin, x, start), y, atol=1e-13)


def test_16_of_a_motion():
    """p2'' and gamma2'' along the full motion, by the variables alone: the error falls with eps^4, as printed with eps^2."""
    errors = {"true": [], "printed": []}
    for r0 in (200.0, 400.0):
        spin = fast_spin.random_spin(np.random.default_rng(7), r0=r0)
        y0 = np.random.default_rng(8).normal(size=6)
        y0[[2, 5]] = 1.0
        y = fast_spin.integrate(spin, y0, np.array([0.0, 2.0]))[:, -1]
        ddy = fast_spin.true_acceleration(spin, y)
        values = of_states(spin, y0, y)
        gamma2 = (ddy[3] - spin.eps * spin.nu * ddy[0]) / (1 - spin.eps**2 * spin.nu * spin.chi1)
        exact = {"dd_p": ddy[0] - spin.eps * spin.chi1 * gamma2, "dd_g": gamma2}
        for which, found in errors.items():
            found.append(
                [
                    reduction.left_side(reduction.ENTRIES[f"(16), {name}: third order"], which, values)
                    - reduction.evaluate(
                        reduction.ENTRIES[f"(16), {name}: third order"]["exact"], values | exact
                    )
                    for name in ("F", "Phi")
                ]
            )
    order = {which: np.log2(np.abs(np.divide(*found))) for which, found in errors.items()}
    assert order["true"] == pytest.approx([4, 4], abs=0.2)
    assert order["printed"] == pytest.approx([2, 2], abs=0.3)


def test_means_over_the_phases_are_integrals_over_a_period():
    """g2(T0) and h2-dot(T0) of (29), by quadrature in time for a rational frequency 2/3."""
    w, n, count = 2 / 3, 3, 600
    t = 2 * np.pi * n * np.arange(count) / count
    M1, M2, L, N, M3 = 0.7, -0.4, 1.3, 0.8, 2.0
    force = L * (M1 * np.cos(w * t) + M2 * np.sin(w * t))
    step = t[1]
    g2 = (force * np.sin(w * (2 * np.pi * n - t))).sum() * step / w
    assert g2 == pytest.approx(-np.pi * n * M2 * L / w)
    assert (force * np.cos(w * (2 * np.pi * n - t))).sum() * step == pytest.approx(np.pi * n * M1 * L)
    assert (M3 * N * np.cos(t) * np.cos(2 * np.pi * n - t)).sum() * step == pytest.approx(np.pi * n * M3 * N)
    # Phi1 = sin: h1 and not its rate
    assert (np.sin(t) * np.sin(2 * np.pi * n - t)).sum() * step == pytest.approx(-np.pi * n)
    assert (np.sin(t) * np.cos(2 * np.pi * n - t)).sum() * step == pytest.approx(0, abs=1e-12)


# The rows.


@pytest.mark.long
@pytest.mark.parametrize("number", [number for number, entry in reduction.ENTRIES.items() if "at" in entry])
def test_rows_have_the_true_reading_much_closer(number):
    row, entry = ROWS[number], reduction.ENTRIES[number]
    seeds = range(5)
    true = [row.residual_true(np.random.default_rng(seed)) for seed in seeds]
    assert max(true) < 2e-2
    assert (row.verdict == "true") == ("terms_printed" not in entry)
    if row.verdict != "true":
        printed = [row.residual_printed(np.random.default_rng(seed)) for seed in seeds]
        assert min(printed) > 0.9


def test_every_numbered_equation_has_a_row():
    numbers = " ".join(ROWS)
    for i in range(1, 35):
        assert f"({i})" in numbers, i


def test_all_but_the_data_have_residuals():
    assert [row.number for row in published.PUBLISHED if row.residual_true is None] == ["section VI, data"]


def test_33_with_the_data_of_the_paper():
    """g1, g1' and r1 for A < C and l = 10 over 4 pi, and the true forms."""
    spin = fast_spin.paper_body("A < C", 10.0)
    tau = np.linspace(0, 4 * np.pi, 401)
    errors = {}
    for module in (fast_spin, published):
        y = module.first_order(spin, tau)
        exact = fast_spin.integrate(spin, y[:, 0], tau)
        errors[module] = np.abs(y - exact).max(1)[[3, 4, 2]]
    np.testing.assert_allclose(errors[published], [1.3e-3, 7.6e-4, 8.9e-7], rtol=0.05)
    assert np.all(errors[fast_spin] < [1e-5, 1e-5, 1e-14])


@pytest.mark.long
def test_period_is_measured_by_the_phase():
    """Against a fit of the phase over 100 turns."""
    spin = fast_spin.FastSpin(22.49, 35.6, 30 * 9.81 * 5, 0.0147, 30.0, 20.0, 10.0, 300.0, 0.352)
    tau = np.linspace(0, 200 * np.pi, 4001)
    y = fast_spin.integrate(spin, fast_spin.first_order(spin, np.array(0.0)), tau)
    shift = np.polyfit(tau, -np.unwrap(np.angle(y[3] + 1j * y[4])), 1)[0] - 1
    assert published.measured_period_correction(spin) == pytest.approx(-2 * np.pi * shift, rel=0.02)
