"""Equations, integrals, starts and frequency bound of the fixed-point system, from first principles."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from atlas.errors import BadInput
from atlas.systems.fixed_point import equations, initial

rng = np.random.default_rng(20260101)


def points(**given):
    size = max((np.size(value) for value in given.values()), default=1)
    known = {name: parameter.default for name, parameter in initial.PARAMETERS.items()} | given
    assert set(known) == set(initial.PARAMETERS)
    return {name: np.broadcast_to(np.asarray(value, float), (size,)).copy() for name, value in known.items()}


def random_points(size, rng=rng, **given):
    """Bodies and starts without any symmetry; moments of real bodies."""
    part = rng.uniform(0.3, 1.0, (3, size))
    body = dict(zip("ABC", part.sum(0) - part, strict=True))
    names = ("Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "theta_dot0", "n", "m")
    rest = {name: rng.normal(size=size) for name in names}
    angles = {"theta0": rng.uniform(0.2, 2.9, size), "phi0": rng.uniform(0, 6, size)}
    return points(**(body | rest | angles | given))


def integrate(at, duration, samples=2):
    """State at equidistant times, shape (6, points, samples), by DOP853."""
    constants, state = initial.constants(at), initial.initial_state(at)

    def rate(_, y):
        return np.ravel(equations.rhs(y.reshape(state.shape), constants))

    found = solve_ivp(
        rate, (0, duration), state.ravel(), method="DOP853", rtol=1e-12, atol=1e-13,
        t_eval=np.linspace(0, duration, samples),
    )  # fmt: skip
    return found.y.reshape(*state.shape, samples)


def test_equations_follow_from_the_lagrangian():
    q = sp.symbols("psi theta phi")
    v = sp.symbols("psi_dot theta_dot phi_dot")
    names = sp.symbols("A B C l1 l2 l3 Mx My Mz N")
    A, B, C, l1, l2, l3, Mx, My, Mz, N = names
    _, theta, phi = q
    gamma = sp.Matrix([sp.sin(theta) * sp.sin(phi), sp.sin(theta) * sp.cos(phi), sp.cos(theta)])
    w = v[0] * gamma + sp.Matrix([v[1] * sp.cos(phi), -v[1] * sp.sin(phi), v[2]])
    inertia = sp.diag(A, B, C)
    kinetic = (w.T * inertia * w)[0] / 2 + sp.Matrix([l1, l2, l3]).dot(w)
    potential = -sp.Matrix([Mx, My, Mz]).dot(gamma) + N / 2 * (gamma.T * inertia * gamma)[0]
    lagrangian = kinetic - potential
    momenta = [lagrangian.diff(rate) for rate in v]
    mass = sp.Matrix([[p.diff(rate) for rate in v] for p in momenta])
    force = sp.Matrix(
        [
            lagrangian.diff(x) - sum(p.diff(y) * u for y, u in zip(q, v, strict=True))
            for x, p in zip(q, momenta, strict=True)
        ]
    )
    fast = sp.Matrix([[component.diff(rate) for rate in v] for component in w])
    slow = sp.Matrix([sum(component.diff(y) * u for y, u in zip(q, v, strict=True)) for component in w])
    system = sp.lambdify([*q, *v, *names], [mass, force, fast, slow], "numpy")

    at = random_points(30)
    expected = np.array(equations.rhs(initial.initial_state(at), initial.constants(at)))
    for i in range(30):
        p = {name: float(value[i]) for name, value in at.items()}
        arguments = [
            p["psi0"], p["theta0"], p["phi0"], p["n"], p["theta_dot0"], p["m"], p["A"], p["B"], p["C"],
            p["l1"], p["l2"], p["l3"], p["Mg"] * p["x0"], p["Mg"] * p["y0"], p["Mg"] * p["z0"], p["N"],
        ]  # fmt: skip
        mass_i, force_i, fast_i, slow_i = (np.asarray(x, float) for x in system(*arguments))
        acceleration = fast_i @ np.linalg.solve(mass_i, force_i) + slow_i
        np.testing.assert_allclose(acceleration[:, 0], expected[:3, i], rtol=1e-11, atol=1e-11)


def test_fields_are_the_attraction_of_a_distant_point():
    """Torque of weight and gradient against point masses; with N of the other sign one order is lost."""
    masses, where = rng.uniform(0.5, 1.5, 6), rng.normal(size=(6, 3))
    tensor = np.einsum("i,ijk->jk", masses, [np.eye(3) * (x @ x) - np.outer(x, x) for x in where])
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    where = where @ axes
    centre = masses @ where / masses.sum()
    gamma = np.array([0.48, -0.6, 0.64])

    def error(R, sign):
        pull = R * gamma - where
        force = masses[:, None] * pull / np.linalg.norm(pull, axis=1)[:, None] ** 3
        exact = np.cross(where, force).sum(0)
        at = points(A=moments[0], B=moments[1], C=moments[2], x0=centre[0], y0=centre[1], z0=centre[2],
                    M=masses.sum(), R=R, **{"lambda": 1.0})  # fmt: skip
        constants = initial.constants(at)[:, 0]
        constants[12:] *= sign
        rate = equations.rhs((0.0, 0.0, 0.0, *gamma), constants)[:3]
        return np.linalg.norm(moments * rate - exact)

    assert error(100.0, 1) / error(200.0, 1) == pytest.approx(16, rel=0.05)
    assert error(100.0, -1) / error(200.0, -1) == pytest.approx(8, rel=0.05)


def test_rates_of_the_frame_are_the_rates_of_the_start():
    at = random_points(50)
    p, q, r, g1, g2, g3 = equations.frame_motion(initial.initial_state(at), initial.constants(at))
    sine2 = g1**2 + g2**2
    psi_dot = (p * g1 + q * g2) / sine2
    np.testing.assert_allclose(psi_dot, at["n"], atol=1e-12)
    np.testing.assert_allclose((p * g2 - q * g1) / np.sqrt(sine2), at["theta_dot0"], atol=1e-12)
    np.testing.assert_allclose(r - psi_dot * g3, at["m"], atol=1e-12)
    np.testing.assert_allclose(np.arctan2(g1, g2) % (2 * np.pi), at["phi0"], atol=1e-12)


# Where each integral exists, as replacements of symbols; one entry per kind of body.
EXISTS = {
    "energy": [{}],
    "area": [{}],
    "length_gamma": [{}],
    "lagrange": [{"B": "A", "l1": 0, "l2": 0, "x0": 0, "y0": 0}],
    "clebsch": [
        {"Mg": 0, "l1": 0, "l2": 0, "l3": 0},
        {"Mg": 0, "N": 0},
        {"Mg": 0, "B": "A", "C": "A"},
    ],
    "kovalevskaya": [{"A": "2*C", "B": "2*C", "z0": 0, "l1": 0, "l2": 0, "N": 0}],
}


@pytest.mark.parametrize("name", equations.INTEGRALS)
def test_integrals_are_conserved_where_they_exist(name):
    state = sp.symbols("p q r g1 g2 g3")
    A, B, C, Mg, x0, y0, z0, N, l1, l2, l3 = sp.symbols("A B C Mg x0 y0 z0 N l1 l2 l3")
    constants = (A, B, C, 1 / A, 1 / B, 1 / C, l1, l2, l3, Mg * x0, Mg * y0, Mg * z0, N * A, N * B, N * C)
    integral = sum(getattr(equations, name)(state, constants))
    rates = equations.rhs(state, constants)
    change = sum(integral.diff(x) * rate for x, rate in zip(state, rates, strict=True))
    for case in EXISTS[name]:
        assert sp.expand(change.subs({sp.Symbol(key): sp.sympify(value) for key, value in case.items()})) == 0

    generic = random_points(1)
    for case in EXISTS[name]:
        body = {"A": 1.0, "C": 0.7, "B": 1.3} | {
            key: value for key, value in case.items() if not isinstance(value, str)
        }
        for key, value in case.items():
            if isinstance(value, str):
                body[key] = {"A": body["A"], "2*C": 2 * body["C"]}[value]
        at = generic | {key: np.full(1, float(value)) for key, value in body.items()}
        floor = initial.integral_scales(at)[name]
        assert np.isfinite(floor).all()
        # Whatever is taken away from the conditions, the integral is gone and said to be.
        for key in case:
            broken = at | {key: at[key] + 0.1}
            if name == "clebsch" and not np.isnan(initial.integral_scales(broken)[name]).all():
                continue
            assert np.isnan(initial.integral_scales(broken)[name]).all()
            values = [
                sum(getattr(equations, name)(y, initial.constants(broken)))
                for y in np.moveaxis(integrate(broken, 1.0), -1, 0)
            ]
            assert abs(values[1] - values[0]) > 1e-8


def test_no_integral_drifts_relative_to_its_floor():
    """Also for bodies at rest, where the terms of an integral vanish at the start."""
    n = 40
    symmetric = {"A": 1.0, "B": 1.0, "C": 1.4, "l1": 0.0, "l2": 0.0, "x0": 0.0, "y0": 0.0}
    at_rest = {"n": 0.0, "m": 0.0, "theta_dot0": 0.0, "theta0": np.pi / 2, "l3": 0.0}
    kovalevskaya = symmetric | {"C": 0.5, "x0": 0.8, "y0": 0.5, "z0": 0.0, "N": 0.0}
    for case in (
        {},
        symmetric,
        symmetric | at_rest,
        kovalevskaya,
        kovalevskaya | {"l3": 0.0},
        {"Mg": 0.0, "N": 0.0},
    ):
        at = random_points(n, **case)
        constants = initial.constants(at)
        first, last = np.moveaxis(integrate(at, 3.0), -1, 0)
        for name, floor in initial.integral_scales(at).items():
            before, after = (np.array(getattr(equations, name)(y, constants)) for y in (first, last))
            size = np.maximum(np.abs(before).sum(0), floor)
            drift = np.abs(after.sum(0) - before.sum(0)) / size
            assert np.isnan(floor).all() or np.nanmax(np.where(np.isnan(floor), 0, drift)) < 1e-9, name


def jacobian(y, constants):
    rate = np.array(equations.rhs(y, constants))
    step = 1e-7
    columns = []
    for i in range(6):
        moved = y.copy()
        moved[i] += step
        columns.append((np.array(equations.rhs(moved, constants)) - rate) / step)
    return np.array(columns).T


@given(seed=st.integers(0, 10**6), symmetric=st.booleans(), spin=st.floats(0, 30))
@settings(max_examples=25, deadline=None)
def test_frequency_bound_is_never_below_the_motion(seed, symmetric, spin):
    given_values = {"m": spin}
    if symmetric:
        given_values |= {"A": 1.0, "B": 1.0, "C": 1.5, "l1": 0.0, "l2": 0.0, "x0": 0.0, "y0": 0.0}
    at = random_points(1, np.random.default_rng(seed), **given_values)
    bound = initial.frequency_bound(at)[0]
    constants = initial.constants(at)[:, 0]
    for y in integrate(at, 4.0, 40)[:, 0].T:
        assert np.linalg.norm(y[:3]) <= bound * (1 + 1e-6)
        assert np.abs(np.linalg.eigvals(jacobian(y, constants))).max() <= bound * (1 + 1e-5)


def test_frequency_bound_is_tight_for_a_fast_symmetric_top():
    at = points(A=22.49, B=22.49, C=35.6, Mg=1.0, z0=5.0, N=1e-3, l3=50.0, theta0=1.2, m=1000.0)
    assert 1000 <= initial.frequency_bound(at)[0] < 1000.1


def test_vector_starts_equal_angle_starts():
    at = random_points(20)
    state = initial.initial_state(at)
    names = ("p0", "q0", "r0", "gamma10", "gamma20", "gamma30")
    angles = ("theta0", "psi0", "phi0", "theta_dot0", "n", "m")
    other = at | {name: np.zeros(20) for name in angles} | dict(zip(names, state, strict=True))
    initial.check(other)
    np.testing.assert_allclose(initial.initial_state(other), state, atol=1e-15)
    np.testing.assert_allclose(initial.rates(other), [at["theta_dot0"], at["n"], at["m"]], atol=1e-12)


def test_vertical_start_has_all_its_rate_in_the_spin():
    at = points(p0=0.0, q0=0.0, r0=2.0, gamma10=0.0, gamma20=0.0, gamma30=-1.0)
    np.testing.assert_array_equal(np.ravel(initial.rates(at)), [0.0, 0.0, 2.0])
    wobbling = at | {"p0": np.full(1, 0.3), "q0": np.full(1, 0.4)}
    assert initial.rates(wobbling)[0] == 0.5


def test_a_vertical_off_by_rounding_is_normalised():
    gamma = np.array([0.6, 0.0, 0.8]) * (1 + 5e-10)
    at = points(p0=0.0, q0=0.0, r0=0.0, gamma10=gamma[0], gamma20=gamma[1], gamma30=gamma[2])
    initial.check(at)
    np.testing.assert_allclose(initial.vertical(at)[:, 0], [0.6, 0, 0.8], atol=1e-16)


def test_paper_units_give_weight_and_gradient():
    at = points(M=30.0, R=2000.0, **{"lambda": 0.6})
    initial.check(at)
    np.testing.assert_allclose(initial.fields(at), [[30 * 0.6 / 2000**2], [3 * 0.6 / 2000**3]], rtol=1e-15)


@pytest.mark.parametrize(
    ("given_values", "message"),
    [
        ({"A": 1.0, "B": 1.0, "C": 2.5}, "A \\+ B = 2 is less than C = 2.5"),
        ({"M": 1.0}, "lambda, R missing"),
        ({"M": 1.0, "lambda": 1.0, "R": 2.0, "Mg": 1.0}, "Mg = 1 beside M, lambda and R"),
        ({"M": 1.0, "lambda": 1.0, "R": 2.0, "N": 0.5}, "N = 0.5 beside"),
        ({"p0": 1.0, "gamma10": 1.0}, "q0, r0, gamma20, gamma30 missing"),
        (
            {"p0": 0, "q0": 0, "r0": 0, "gamma10": 0, "gamma20": 0.6, "gamma30": 0.8, "theta0": 0.1},
            "theta0 = 0.1 beside p0 .. gamma30",
        ),
        ({"p0": 0, "q0": 0, "r0": 0, "gamma10": 0, "gamma20": 0, "gamma30": 1.1}, "has length 1.1"),
    ],
)
def test_bad_input_is_named(given_values, message):
    with pytest.raises(BadInput, match=message):
        initial.check(points(**given_values))


def test_moments_below_the_offset_of_the_mass_are_a_warning():
    at = points(A=22.49, B=22.49, C=35.6, M=30.0, z0=5.0, R=2000.0, **{"lambda": 0.6})
    initial.check(at)
    found = initial.warnings(at)
    assert [text[0] for text in found] == ["A", "B"]
    assert "A = 22.49 is below M (y0^2 + z0^2) = 750" in found[0]
    assert initial.warnings(points()) == []
