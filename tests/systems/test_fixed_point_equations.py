"""Equations, integrals, starts and frequency bound of the fixed-point system, from first principles."""

import itertools

import numpy as np
import pytest
import sympy as sp
from refusals import assert_refused
from scipy.integrate import solve_ivp
from strategies import default_points, random_fixed_points
from truth import jacobian_matrices

import atlas
from atlas.errors import BadInput
from atlas.systems import SYSTEMS
from atlas.systems.base import possible_body
from atlas.systems.fixed_point import equations, initial

pytestmark = pytest.mark.usefixtures("whole_kernels")


def integrate(points, duration, samples=2):
    """State at equidistant times, shape (6, points, samples), by DOP853."""
    constants, state = initial.constants(points), initial.initial_state(points)

    def rate(_, y):
        return np.ravel(equations.rhs(y.reshape(state.shape), constants))

    solution = solve_ivp(
        rate, (0, duration), state.ravel(), method="DOP853", rtol=1e-12, atol=1e-13,
        t_eval=np.linspace(0, duration, samples),
    )  # fmt: skip
    return solution.y.reshape(*state.shape, samples)


def test_equations_follow_from_the_lagrangian():
    angles = sp.symbols("psi theta phi")
    rates = sp.symbols("psi_dot theta_dot phi_dot")
    body = sp.symbols("A B C l1 l2 l3 Mx My Mz N")
    A, B, C, l1, l2, l3, Mx, My, Mz, N = body
    _, theta, phi = angles
    psi_dot, theta_dot, phi_dot = rates
    gamma = sp.Matrix([sp.sin(theta) * sp.sin(phi), sp.sin(theta) * sp.cos(phi), sp.cos(theta)])
    w = psi_dot * gamma + sp.Matrix([theta_dot * sp.cos(phi), -theta_dot * sp.sin(phi), phi_dot])
    inertia = sp.diag(A, B, C)
    kinetic = (w.T * inertia * w)[0] / 2 + sp.Matrix([l1, l2, l3]).dot(w)
    potential = -sp.Matrix([Mx, My, Mz]).dot(gamma) + N / 2 * (gamma.T * inertia * gamma)[0]
    lagrangian = kinetic - potential
    momenta = sp.Matrix([lagrangian]).jacobian(rates).T
    mass = momenta.jacobian(rates)
    force = sp.Matrix([lagrangian]).jacobian(angles).T - momenta.jacobian(angles) * sp.Matrix(rates)
    # w-dot = rate_matrix * accelerations + remainder
    rate_matrix, remainder = w.jacobian(rates), w.jacobian(angles) * sp.Matrix(rates)
    evaluate = sp.lambdify([*angles, *rates, *body], [mass, force, rate_matrix, remainder], "numpy")

    points = random_fixed_points(np.random.default_rng(1), 30)
    expected = np.array(equations.rhs(initial.initial_state(points), initial.constants(points)))
    for i in range(30):
        p = {name: float(value[i]) for name, value in points.items()}
        arguments = [
            p["psi0"], p["theta0"], p["phi0"], p["n"], p["theta_dot0"], p["m"], p["A"], p["B"], p["C"],
            p["l1"], p["l2"], p["l3"], p["Mg"] * p["x0"], p["Mg"] * p["y0"], p["Mg"] * p["z0"], p["N"],
        ]  # fmt: skip
        mass_i, force_i, matrix_i, remainder_i = (np.asarray(x, float) for x in evaluate(*arguments))
        w_dot = matrix_i @ np.linalg.solve(mass_i, force_i) + remainder_i
        np.testing.assert_allclose(w_dot[:, 0], expected[:3, i], rtol=1e-11, atol=1e-11)


def test_fields_are_the_attraction_of_a_distant_point():
    """Torque of weight and gravity gradient against that of point masses, to fourth order in 1/R.

    With the opposite sign of N the difference is of third order.
    """
    rng = np.random.default_rng(2)
    masses, positions = rng.uniform(0.5, 1.5, 6), rng.normal(size=(6, 3))
    tensor = np.einsum("i,ijk->jk", masses, [np.eye(3) * (x @ x) - np.outer(x, x) for x in positions])
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    positions = positions @ axes
    centre = masses @ positions / masses.sum()
    gamma = np.array([0.48, -0.6, 0.64])

    def error(R, sign):
        distance = R * gamma - positions
        force = masses[:, None] * distance / np.linalg.norm(distance, axis=1)[:, None] ** 3
        exact = np.cross(positions, force).sum(0)
        body = dict(zip(("A", "B", "C", "x0", "y0", "z0"), (*moments, *centre), strict=True))
        points = default_points("fixed_point", **body, M=masses.sum(), R=R, **{"lambda": 1.0})
        constants = initial.constants(points)[:, 0]
        constants[12:] *= sign
        w_dot = equations.rhs((0.0, 0.0, 0.0, *gamma), constants)[:3]
        return np.linalg.norm(moments * w_dot - exact)

    assert error(100.0, 1) / error(200.0, 1) == pytest.approx(16, rel=0.05)
    assert error(100.0, -1) / error(200.0, -1) == pytest.approx(8, rel=0.05)


def test_rates_of_the_frame_are_the_rates_of_the_start():
    points = random_fixed_points(np.random.default_rng(3), 50)
    p, q, r, g1, g2, g3 = equations.frame_motion(initial.initial_state(points), initial.constants(points))
    sine2 = g1**2 + g2**2
    psi_dot = (p * g1 + q * g2) / sine2
    np.testing.assert_allclose(psi_dot, points["n"], atol=1e-12)
    np.testing.assert_allclose((p * g2 - q * g1) / np.sqrt(sine2), points["theta_dot0"], atol=1e-12)
    np.testing.assert_allclose(r - psi_dot * g3, points["m"], atol=1e-12)
    np.testing.assert_allclose(np.arctan2(g1, g2) % (2 * np.pi), points["phi0"], atol=1e-12)


# Conditions on the parameters under which each integral exists, one entry for each case.
EXISTS = {
    "energy": [{}],
    "area": [{}],
    "length_gamma": [{}],
    "lagrange": [{"B": "A", "l1": 0, "l2": 0, "x0": 0, "y0": 0}],
    "clebsch": [{"Mg": 0, "l1": 0, "l2": 0, "l3": 0}, {"Mg": 0, "N": 0}, {"Mg": 0, "B": "A", "C": "A"}],
    "kovalevskaya": [{"A": "2*C", "B": "2*C", "z0": 0, "l1": 0, "l2": 0, "N": 0}],
}


@pytest.mark.parametrize("name", equations.INTEGRALS)
def test_integrals_are_conserved_where_they_exist(name):
    state = sp.symbols("p q r g1 g2 g3")
    A, B, C, Mg, x0, y0, z0, N, l1, l2, l3 = sp.symbols("A B C Mg x0 y0 z0 N l1 l2 l3")
    constants = (A, B, C, 1 / A, 1 / B, 1 / C, l1, l2, l3, Mg * x0, Mg * y0, Mg * z0, N * A, N * B, N * C, 0)
    integral = sum(getattr(equations, name)(state, constants))
    rates = equations.rhs(state, constants)
    change = sum(integral.diff(x) * rate for x, rate in zip(state, rates, strict=True))
    for conditions in EXISTS[name]:
        values = {sp.Symbol(key): sp.sympify(value) for key, value in conditions.items()}
        assert sp.expand(change.subs(values)) == 0

    generic = random_fixed_points(np.random.default_rng(4), 1)
    for conditions in EXISTS[name]:
        body = {"A": 1.0, "C": 0.7, "B": 1.3} | {
            key: value for key, value in conditions.items() if not isinstance(value, str)
        }
        for key, value in conditions.items():
            if isinstance(value, str):
                body[key] = {"A": body["A"], "2*C": 2 * body["C"]}[value]
        points = generic | {key: np.full(1, float(value)) for key, value in body.items()}
        scale = initial.integral_scales(points)[name]
        assert np.isfinite(scale).all()
        # Where one of the conditions fails, the integral is not conserved and its scale is nan.
        for key in conditions:
            broken = points | {key: points[key] + 0.1}
            if name == "clebsch" and not np.isnan(initial.integral_scales(broken)[name]).all():
                continue
            assert np.isnan(initial.integral_scales(broken)[name]).all()
            states = integrate(broken, 1.0)
            start, end = sum(getattr(equations, name)(states, initial.constants(broken)[..., None]))[0]
            assert abs(end - start) > 1e-8


def test_relative_drift_of_every_integral_is_small():
    """Also for bodies at rest, for which the terms of an integral are 0 at the start."""
    rng, count = np.random.default_rng(5), 40
    symmetric = {"A": 1.0, "B": 1.0, "C": 1.4, "l1": 0.0, "l2": 0.0, "x0": 0.0, "y0": 0.0}
    at_rest = {"n": 0.0, "m": 0.0, "theta_dot0": 0.0, "theta0": np.pi / 2, "l3": 0.0}
    kovalevskaya = symmetric | {"C": 0.5, "x0": 0.8, "y0": 0.5, "z0": 0.0, "N": 0.0}
    for conditions in (
        {},
        symmetric,
        symmetric | at_rest,
        kovalevskaya,
        kovalevskaya | {"l3": 0.0},
        {"Mg": 0.0, "N": 0.0},
    ):
        points = random_fixed_points(rng, count, **conditions)
        constants = initial.constants(points)
        first, last = np.moveaxis(integrate(points, 3.0), -1, 0)
        for name, scale in initial.integral_scales(points).items():
            initial_terms, final_terms = (
                np.array(getattr(equations, name)(y, constants)) for y in (first, last)
            )
            size = np.maximum(np.abs(initial_terms).sum(0), scale)
            drift = np.abs(final_terms.sum(0) - initial_terms.sum(0)) / size
            assert np.isnan(scale).all() or np.nanmax(np.where(np.isnan(scale), 0, drift)) < 1e-9, name


def assert_bound_holds(points, duration):
    """No rate and no frequency of the linearised equations along the motions is above the bound."""
    bound, constants = initial.frequency_bound(points), initial.constants(points)
    states = integrate(points, duration, 40)
    assert (np.linalg.norm(states[:3], axis=0).max(1) <= bound * (1 + 1e-6)).all()
    matrices = jacobian_matrices(
        equations.rhs, states.reshape(len(states), -1), np.repeat(constants, 40, axis=1)
    )
    frequencies = np.abs(np.linalg.eigvals(matrices)).max(1).reshape(-1, 40)
    assert (frequencies.max(1) <= bound * (1 + 1e-6)).all()


@pytest.mark.long
def test_frequency_bound_is_never_below_the_motion():
    rng = np.random.default_rng(0)
    symmetry = {"A": 1.0, "B": 1.0, "C": 1.5, "l1": 0.0, "l2": 0.0, "x0": 0.0, "y0": 0.0}
    bodies = []
    for seed, given, rotor in itertools.product(range(10), ({}, symmetry), (1.0, 30.0)):
        spin = rng.uniform(0, 30) if seed else 0.0
        bodies.append(random_fixed_points(np.random.default_rng(seed), 1, m=spin, **given))
        bodies[-1] |= {name: rotor * bodies[-1][name] for name in ("l1", "l2", "l3")}
    points = {name: np.concatenate([body[name] for body in bodies]) for name in bodies[0]}
    assert_bound_holds(points, 4.0)


def test_frequency_bound_holds_where_symmetric_bodies_fall():
    """From rest near the highest potential of weight or gradient: each term of what the kinetic energy gains is needed."""
    flat, upright = np.pi / 2 - 0.01, 0.01
    points = default_points(
        "fixed_point", A=1.0, B=1.0, C=np.array([0.1, 0.1, 0.1, 1.9, 0.1, 1.9]),
        Mg=np.array([2.0, 2.0, 0.0, 0.0, 0.0, 0.0]), z0=np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0]),
        N=np.array([0.0, 0.0, 3.0, -3.0, -3.0, 3.0]),
        theta0=np.array([np.pi - 0.01, upright, flat, flat, upright, upright]),
    )  # fmt: skip
    assert_bound_holds(points, 8.0)


def test_frequency_bound_is_tight_for_a_fast_symmetric_top():
    points = default_points(
        "fixed_point", A=22.49, B=22.49, C=35.6, Mg=1.0, z0=5.0, N=1e-3, l3=50.0, theta0=1.2, m=1000.0
    )
    assert 1000 <= initial.frequency_bound(points)[0] < 1000.1


def test_vector_starts_equal_angle_starts():
    points = random_fixed_points(np.random.default_rng(7), 20)
    state = initial.initial_state(points)
    names = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
    angles = ("theta0", "psi0", "phi0", "theta_dot0", "n", "m")
    by_vectors = points | {name: np.zeros(20) for name in angles} | dict(zip(names, state, strict=True))
    initial.check(by_vectors)
    np.testing.assert_allclose(initial.initial_state(by_vectors), state, atol=1e-15)
    np.testing.assert_allclose(
        initial.rates(by_vectors), [points["theta_dot0"], points["n"], points["m"]], atol=1e-12
    )


def test_vertical_start_has_all_its_rate_in_the_spin():
    points = default_points("fixed_point", p0=0.0, q0=0.0, r0=2.0, gamma10=0.0, gamma20=0.0, gamma30=-1.0)
    np.testing.assert_array_equal(np.ravel(initial.rates(points)), [0.0, 0.0, 2.0])
    tilted = points | {"p0": np.full(1, 0.3), "q0": np.full(1, 0.4)}
    assert initial.rates(tilted)[0] == 0.5


def test_a_vertical_off_by_rounding_is_normalised():
    gamma = np.array([0.6, 0.0, 0.8]) * (1 + 5e-10)
    points = default_points(
        "fixed_point", p0=0.0, q0=0.0, r0=0.0, gamma10=gamma[0], gamma20=gamma[1], gamma30=gamma[2]
    )
    initial.check(points)
    np.testing.assert_allclose(initial.vertical(points)[:, 0], [0.6, 0, 0.8], atol=1e-16)


def test_paper_units_give_weight_and_gradient():
    points = default_points("fixed_point", M=30.0, R=2000.0, **{"lambda": 0.6})
    initial.check(points)
    np.testing.assert_allclose(
        initial.fields(points), [[30 * 0.6 / 2000**2], [3 * 0.6 / 2000**3]], rtol=1e-15
    )


@pytest.mark.parametrize(
    ("given_values", "sentence"),
    [
        ({"M": 1.0}, "lambda, R missing: M, lambda, R must be given together or not at all"),
        (
            {"M": 1.0, "lambda": 1.0, "R": 2.0, "Mg": 1.0},
            "Mg = 1 beside M, lambda and R (1 of 1 points): give one or the other",
        ),
        (
            {"M": 1.0, "lambda": 1.0, "R": 2.0, "N": 0.5},
            "N = 0.5 beside M, lambda and R (1 of 1 points): give one or the other",
        ),
        (
            {"p0": 1.0, "gamma10": 1.0},
            "q0, r0, gamma20, gamma30 missing: p0, q0, r0, gamma10, gamma20, gamma30 must be given together or not at all",
        ),
        (
            {"p0": 0, "q0": 0, "r0": 0, "gamma10": 0, "gamma20": 0.6, "gamma30": 0.8, "theta0": 0.1},
            "theta0 = 0.1 beside p0 .. gamma30 (1 of 1 points): give one or the other",
        ),
    ],
)
def test_bad_input_is_named(given_values, sentence):
    assert_refused(lambda: initial.check(default_points("fixed_point", **given_values)), sentence)


def test_what_no_body_and_no_start_can_be_is_named():
    bodies = default_points("fixed_point", A=1.0, B=1.0, C=np.array([1.9, 2.0, 2.5]))
    np.testing.assert_array_equal(possible_body(SYSTEMS["fixed_point"], bodies), [True, True, False])
    gamma30 = np.array([1.0, 1.1, -1.0, np.nan])
    zero = dict.fromkeys(("p0", "q0", "r0", "gamma10", "gamma20"), 0.0)
    starts = default_points("fixed_point", gamma30=gamma30, **zero)
    np.testing.assert_array_equal(SYSTEMS["fixed_point"].possible_start(starts)[:3], [True, False, True])
    impossible = {"A": 1.0, "B": 1.0, "C": 2.5}, zero | {"gamma30": 1.1}
    for parameters, words in zip(impossible, ("no rigid body", "unit vector"), strict=True):
        with pytest.raises(BadInput, match=words):
            atlas.trajectory("fixed_point", parameters, duration=1.0)


def test_moments_below_the_offset_of_the_mass_are_a_warning():
    points = default_points(
        "fixed_point", A=22.49, B=22.49, C=35.6, M=30.0, z0=5.0, R=2000.0, **{"lambda": 0.6}
    )
    initial.check(points)
    warnings = initial.warnings(points)
    assert [text[0] for text in warnings] == ["A", "B"]
    assert "A = 22.49 is below M (y0^2 + z0^2) = 750" in warnings[0]
    assert initial.warnings(default_points("fixed_point")) == []
