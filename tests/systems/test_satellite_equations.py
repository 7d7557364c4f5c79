"""The satellite's equations of motion, integrals, start and frequency bound, from (1)-(3) of the paper."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from strategies import default_points, random_satellites
from truth import (
    BODY_NAMES,
    exponents_along_runs,
    jacobian_matrices,
    lagrangian_arguments,
    lagrangian_functions,
    paper_vectors,
    satellite_symbols,
)

from atlas.systems import arithmetic
from atlas.systems.satellite import equations
from atlas.systems.satellite.initial import constants, directions, frequency_bound, initial_state


def test_accelerations_are_those_of_the_lagrangian():
    points = random_satellites(np.random.default_rng(1), 50)
    functions = lagrangian_functions()
    reference = []
    for i in range(50):
        point = {name: float(value[i]) for name, value in points.items()}
        mass = np.array(functions["mass"](*lagrangian_arguments(point)), float)
        force = -np.array(functions["left_sides"](*lagrangian_arguments(point)), float)[:, 0]
        accelerations = np.linalg.solve(mass, force)
        reference.append(
            np.array(functions["w_dot"](*lagrangian_arguments(point, accelerations)), float)[:, 0]
        )
    rates = np.array(equations.rhs(initial_state(points), constants(points)))[:3].T
    assert np.abs(rates - np.array(reference)).max() < 1e-12 * (1 + np.abs(rates).max())


def test_a_star_among_the_constants_becomes_their_names():
    texts = arithmetic.functions(equations)
    for name in ("jacobi", "jacobi_loss", "axis_in_frame"):
        assert f"{', '.join(equations.CONSTANTS)} = constants" in texts[name].replace("(", "").replace(
            ")", ""
        )


def test_kinematics_and_start_are_those_of_the_paper():
    angles, rates, _, _ = satellite_symbols()
    points = random_satellites(np.random.default_rng(2), 20)
    functions = [sp.lambdify((*angles, *rates), vector, modules="numpy") for vector in paper_vectors()]
    alpha, beta, gamma, relative_rate = (
        np.array(function(*lagrangian_arguments(points)[:6]))[:, 0] for function in functions
    )
    state = initial_state(points)
    np.testing.assert_allclose(state[3:6], alpha, atol=1e-15)
    np.testing.assert_allclose(state[6:], gamma, atol=1e-15)
    np.testing.assert_allclose(state[:3], relative_rate + points["Omega"] * gamma, atol=4e-15)
    np.testing.assert_allclose(np.cross(state[6:], state[3:6], axis=0), beta, atol=1e-15)
    np.testing.assert_array_equal(np.concatenate(directions(points)), state[3:])
    u1, u2, u3, g1, g2, g3 = equations.frame_motion(state, constants(points))
    np.testing.assert_allclose([u1, u2, u3], relative_rate, atol=4e-15)
    np.testing.assert_array_equal([g1, g2, g3], state[6:])
    np.testing.assert_allclose(
        equations.axis_in_frame(state, constants(points)), [alpha[2], beta[2]], atol=1e-15
    )


def test_alpha_and_gamma_move_as_the_angles_do():
    """The kinematic equations are the derivatives of (1)."""
    alpha, _, gamma, _ = paper_vectors()
    angles, angle_rates, _, _ = satellite_symbols()
    points = random_satellites(np.random.default_rng(3), 20)
    for vector, rows in ((alpha, slice(3, 6)), (gamma, slice(6, 9))):
        derivative = vector.jacobian(angles) * sp.Matrix(angle_rates)
        function = sp.lambdify((*angles, *angle_rates), derivative, modules="numpy")
        expected = np.array(function(*lagrangian_arguments(points)[:6]))[:, 0]
        rates = np.array(equations.rhs(initial_state(points), constants(points)))
        np.testing.assert_allclose(rates[rows], expected, atol=1e-14)


def test_integrals_are_conserved_identically():
    state = sp.symbols(equations.STATE)
    _, _, _, body = satellite_symbols()
    A, B = body[:2]
    values = tuple(constants(dict(zip(BODY_NAMES, body, strict=True)) | {"damping": 0}))
    rates = equations.rhs(state, values)
    conditions = {"axial_momentum": {B: A, **dict.fromkeys(sp.symbols("k1 k2 mu1 mu2 drag1 drag2"), 0)}}
    for name in equations.INTEGRALS:
        total = sum(getattr(equations, name)(state, values))
        change = sum(sp.diff(total, x) * rate for x, rate in zip(state, rates, strict=True))
        assert sp.expand(change.subs(conditions.get(name, {}))) == 0, name


def test_jacobi_is_that_of_the_lagrangian():
    points = random_satellites(np.random.default_rng(4), 30)
    expected = lagrangian_functions()["jacobi"](*lagrangian_arguments(points))
    terms = equations.jacobi(initial_state(points), constants(points))
    np.testing.assert_allclose(sum(terms), expected, atol=1e-13)


@pytest.mark.usual("1.0")
@pytest.mark.parametrize("rotor", [1.0, 30.0])
@pytest.mark.parametrize("symmetric", [False, True])
def test_frequency_bound_holds_along_trajectories(symmetric, rotor):
    """With rotors so fast that the motion is theirs, too: each term of the bound is then needed."""
    points = random_satellites(np.random.default_rng(5 + symmetric), 12)
    points |= {name: rotor * points[name] for name in ("k1", "k2", "k3")}
    if symmetric:
        points["B"] = points["A"]
        points |= {name: np.zeros(12) for name in ("k1", "k2", "mu1", "mu2", "drag1", "drag2")}
    bound, state, values = frequency_bound(points), initial_state(points), constants(points)
    for i in range(12):
        point_constants = values[:, i]
        solution = solve_ivp(
            lambda t, y, c=point_constants: equations.rhs(y, c), (0, 12), state[:, i], "DOP853",
            rtol=1e-8, atol=1e-8, max_step=0.2,
        )  # fmt: skip
        relative_rate = solution.y[:3] - points["Omega"][i] * solution.y[6:]
        matrices = jacobian_matrices(equations.rhs, solution.y, point_constants[:, None])
        if symmetric:  # w3 is constant and its perturbation decouples
            keep = [0, 1, 3, 4, 5, 6, 7, 8]
            assert np.ptp(solution.y[2]) < 1e-6
            matrices = matrices[:, keep][:, :, keep]
        frequencies = np.abs(np.linalg.eigvals(matrices)).max(1)
        assert np.linalg.norm(relative_rate, axis=0).max() <= bound[i]
        assert frequencies.max() <= bound[i]


def test_frequency_bound_of_a_sphere_is_that_of_its_rotation():
    """The gravity gradient, whose term would be 3 sqrt(2), does not act on it; at rest in the orbit it turns at Omega."""
    assert 1 < frequency_bound(default_points("satellite", C=1.0))[0] < 3.1


def test_frequency_bound_holds_where_light_magnets_turn_over():
    """From rest against the field, on a slow orbit: the rates are those of the magnetic energy and of the small moments."""
    points = default_points(
        "satellite", A=0.1, B=0.1, C=np.array([0.02, 0.1, 0.19]), Omega=0.01, mu3=np.array([2.0, -2.0, 2.0]),
        h3=np.array([1.0, 1.0, 0.0]), h1=np.array([0.0, 0.0, 1.0]),
        theta0=np.array([0.01, np.pi - 0.01, np.pi / 2]), psi0=np.array([0.0, 0.0, np.pi / 2 - 0.01]),
    )  # fmt: skip
    bound, state, values = frequency_bound(points), initial_state(points), constants(points)
    for i, (path, exponents) in enumerate(exponents_along_runs(equations.rhs, state, values, 4)):
        fastest = np.linalg.norm(path[:3] - points["Omega"][i] * path[6:], axis=0).max()
        assert 0.7 * bound[i] < fastest < bound[i]
        assert np.abs(exponents).max() <= bound[i]
