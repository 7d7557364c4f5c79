"""The satellite's equations of motion, integrals, start and frequency bound, from (1)-(3) of the paper."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from atlas.systems.satellite import equations
from atlas.systems.satellite.initial import PARAMETERS, constants, directions, frequency_bound, initial_state

ANGLES = sp.symbols("psi theta phi")
RATES = sp.symbols("psi_dot theta_dot phi_dot")
ACCELERATIONS = sp.symbols("psi_accel theta_accel phi_accel")
BODY = sp.symbols("A B C Omega k1 k2 k3 mu1 mu2 mu3 h1 h3")
BODY_NAMES = [str(symbol) for symbol in BODY]


def paper_vectors():
    """alpha, beta, gamma, w' of (1)."""
    (psi, theta, phi), (psi_dot, theta_dot, phi_dot) = ANGLES, RATES
    s, c, sf, cf = sp.sin(theta), sp.cos(theta), sp.sin(phi), sp.cos(phi)
    sy, cy = sp.sin(psi), sp.cos(psi)
    alpha = sp.Matrix([cy * cf - c * sf * sy, -cy * sf - c * cf * sy, s * sy])
    beta = sp.Matrix([sy * cf + c * sf * cy, -sy * sf + c * cf * cy, -s * cy])
    gamma = sp.Matrix([s * sf, s * cf, c])
    turn = [psi_dot * s * sf + theta_dot * cf, psi_dot * s * cf - theta_dot * sf, psi_dot * c + phi_dot]
    return alpha, beta, gamma, sp.Matrix(turn)


@cache
def derived():
    """Functions of (angles, rates, accelerations, body), all from the Lagrangian (2) with (3).

    Left sides of Lagrange's equations, mass matrix, Jacobi integral, absolute rates and their derivative.
    """
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3 = BODY
    alpha, _, gamma, turn = paper_vectors()
    inertia, rotor, moment = sp.diag(A, B, C), sp.Matrix([k1, k2, k3]), sp.Matrix([mu1, mu2, mu3])
    w = turn + Omega * gamma
    potential = sp.Rational(3, 2) * Omega**2 * alpha.dot(inertia * alpha) + moment.dot(
        h1 * alpha + h3 * gamma
    )
    lagrangian = w.dot(inertia * w) / 2 + w.dot(rotor) - potential
    momenta = sp.Matrix([lagrangian]).jacobian(RATES).T
    mass = momenta.jacobian(RATES)
    moved = momenta.jacobian(ANGLES) * sp.Matrix(RATES)
    left = mass * sp.Matrix(ACCELERATIONS) + moved - sp.Matrix([lagrangian]).jacobian(ANGLES).T
    jacobi = momenta.dot(sp.Matrix(RATES)) - lagrangian
    w_dot = w.jacobian(ANGLES) * sp.Matrix(RATES) + w.jacobian(RATES) * sp.Matrix(ACCELERATIONS)
    arguments = (*ANGLES, *RATES, *ACCELERATIONS, *BODY)
    return {
        name: sp.lambdify(arguments, value, modules="numpy", cse=True)
        for name, value in (("left", left), ("mass", mass), ("jacobi", jacobi), ("w", w), ("w_dot", w_dot))
    }


def random_points(seed: int, count: int, **given) -> dict[str, np.ndarray]:
    """Random points of any body, start and field; theta away from 0 and pi."""
    rng = np.random.default_rng(seed)
    points = {name: rng.normal(size=count) for name in PARAMETERS}
    points |= {name: rng.uniform(0.8, 1.5, count) for name in ("A", "B", "C")}
    points |= {"Omega": rng.uniform(0.3, 1.5, count), "theta0": rng.uniform(0.3, 2.8, count)}
    return points | {name: np.broadcast_to(value, count).astype(float) for name, value in given.items()}


def arguments(points, accelerations=None):
    states = [points[name] for name in ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")]
    zero = np.zeros_like(points["A"])
    return (
        *states,
        *(accelerations if accelerations is not None else [zero] * 3),
        *(points[i] for i in BODY_NAMES),
    )


def test_accelerations_are_those_of_the_lagrangian():
    points = random_points(1, 50)
    functions = derived()
    reference = []
    for i in range(50):
        one = {name: float(value[i]) for name, value in points.items()}
        mass = np.array(functions["mass"](*arguments(one)), float)
        force = -np.array(functions["left"](*arguments(one)), float)[:, 0]
        accelerations = np.linalg.solve(mass, force)
        reference.append(np.array(functions["w_dot"](*arguments(one, accelerations)), float)[:, 0])
    rates = np.array(equations.rhs(initial_state(points), constants(points)))[:3].T
    assert np.abs(rates - np.array(reference)).max() < 1e-12 * (1 + np.abs(rates).max())


def test_kinematics_and_start_are_those_of_the_paper():
    alpha, beta, gamma, turn = paper_vectors()
    points = random_points(2, 20)
    functions = [
        sp.lambdify((*ANGLES, *RATES), vector, modules="numpy") for vector in (alpha, beta, gamma, turn)
    ]
    expected = [np.array(f(*arguments(points)[:6]))[:, 0] for f in functions]
    state = initial_state(points)
    np.testing.assert_allclose(state[3:6], expected[0], atol=1e-15)
    np.testing.assert_allclose(state[6:], expected[2], atol=1e-15)
    np.testing.assert_allclose(state[:3], expected[3] + points["Omega"] * expected[2], atol=4e-15)
    np.testing.assert_allclose(np.cross(state[6:], state[3:6], axis=0), expected[1], atol=1e-15)
    np.testing.assert_array_equal(np.concatenate(directions(points)), state[3:])
    u1, u2, u3, g1, g2, g3 = equations.frame_motion(state, constants(points))
    np.testing.assert_allclose([u1, u2, u3], expected[3], atol=4e-15)
    np.testing.assert_array_equal([g1, g2, g3], state[6:])
    np.testing.assert_allclose(
        equations.axis_in_frame(state, constants(points)), [expected[0][2], expected[1][2]], atol=1e-15
    )


def test_alpha_and_gamma_move_as_the_angles_do():
    """The kinematic equations are the derivatives of (1)."""
    alpha, _, gamma, _ = paper_vectors()
    points = random_points(3, 20)
    for vector, rows in ((alpha, slice(3, 6)), (gamma, slice(6, 9))):
        slope = vector.jacobian(ANGLES) * sp.Matrix(RATES)
        expected = np.array(sp.lambdify((*ANGLES, *RATES), slope, modules="numpy")(*arguments(points)[:6]))[
            :, 0
        ]
        rates = np.array(equations.rhs(initial_state(points), constants(points)))
        np.testing.assert_allclose(rates[rows], expected, atol=1e-14)


def test_integrals_are_conserved_identically():
    state = sp.symbols(equations.STATE)
    A, B = BODY[:2]
    values = tuple(constants(dict(zip(BODY_NAMES, BODY, strict=True))))
    rates = equations.rhs(state, values)
    special = {"axial_momentum": {B: A, **dict.fromkeys(sp.symbols("k1 k2 mu1 mu2"), 0)}}
    for name in equations.INTEGRALS:
        total = sum(getattr(equations, name)(state, values))
        slope = sum(sp.diff(total, x) * rate for x, rate in zip(state, rates, strict=True))
        assert sp.expand(slope.subs(special.get(name, {}))) == 0, name


def test_jacobi_is_that_of_the_lagrangian():
    points = random_points(4, 30)
    expected = derived()["jacobi"](*arguments(points))
    terms = equations.jacobi(initial_state(points), constants(points))
    np.testing.assert_allclose(sum(terms), expected, atol=1e-13)


def jacobians(state, values):
    """Matrices of the linearised equations, by complex steps, shape (samples, 9, 9)."""
    columns = []
    for i in range(9):
        moved = state.astype(complex)
        moved[i] += 1e-30j
        columns.append(np.array(equations.rhs(moved, values)).imag / 1e-30)
    return np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)


@pytest.mark.parametrize("symmetric", [False, True])
def test_frequency_bound_holds_along_trajectories(symmetric):
    points = random_points(5 + symmetric, 12)
    if symmetric:
        points["B"] = points["A"]
        points |= {name: np.zeros(12) for name in ("k1", "k2", "mu1", "mu2")}
    bound, state, values = frequency_bound(points), initial_state(points), constants(points)
    for i in range(12):
        column = values[:, i]
        run = solve_ivp(
            lambda t, y, c=column: equations.rhs(y, c), (0, 12), state[:, i], "DOP853",
            rtol=1e-8, atol=1e-8, max_step=0.2,
        )  # fmt: skip
        turn = run.y[:3] - points["Omega"][i] * run.y[6:]
        matrices = jacobians(run.y, column[:, None])
        if symmetric:  # w3 stands still, its perturbation decouples
            keep = [0, 1, 3, 4, 5, 6, 7, 8]
            assert np.ptp(run.y[2]) < 1e-6
            matrices = matrices[:, keep][:, :, keep]
        frequencies = np.abs(np.linalg.eigvals(matrices)).max(1)
        assert np.linalg.norm(turn, axis=0).max() <= bound[i]
        assert frequencies.max() <= bound[i]
