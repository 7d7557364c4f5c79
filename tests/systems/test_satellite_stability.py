"""Linear stability of the satellite's steady motions and its relative equilibria."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_satellite_equations import jacobians
from test_satellite_families import free_point, solved

from atlas.errors import BadInput
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.equilibria import equilibria
from atlas.systems.satellite.families import FAMILIES, identify_family
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state
from atlas.systems.satellite.stability import exponents, linear_stability


def stack(points):
    return {name: np.concatenate([point[name] for point in points]) for name in PARAMETERS}


def some(name, count, seed=0, slowest=0.15):
    """Points whose first family is the named one, the rotation not too slow to integrate."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        point = solved(name, rng)
        if point is None or identify_family(point)[0][0] != FAMILIES[name].flag:
            continue
        turn = np.hypot(
            point["n"] * np.sin(point["theta0"]), point["n"] * np.cos(point["theta0"]) + point["m"]
        )
        if turn[0] > slowest or name == "equilibrium":
            found.append(point)
    return stack(found)


def monodromy_growth(point, period):
    """Growth rate from the variational equations of the nine equations of motion themselves."""
    values = constants(point)

    def both(t, y):
        state, matrix = y[:9], y[9:].reshape(9, 9)
        return np.concatenate(
            [rhs(state, values[:, 0]), (jacobians(state[:, None], values)[0] @ matrix).ravel()]
        )

    first = np.concatenate([initial_state(point)[:, 0], np.eye(9).ravel()])
    run = solve_ivp(both, (0, period), first, "DOP853", rtol=1e-11, atol=1e-12)
    return np.log(np.abs(np.linalg.eigvals(run.y[9:, -1].reshape(9, 9))).max()) / period


@pytest.mark.parametrize("name", ["cylindrical", "transverse_magnet", "despun_transverse", "asymmetric_tilt",
                                  "other_axis"])  # fmt: skip
def test_multipliers_are_those_of_the_equations_of_motion(name):
    # fast enough that an unstable motion is still itself after a period
    points = some(name, 5, slowest=0.6)
    stable, growth = exponents(points)
    for i in range(5):
        point = {key: value[i : i + 1] for key, value in points.items()}
        turn = np.hypot(
            point["n"] * np.sin(point["theta0"]), point["n"] * np.cos(point["theta0"]) + point["m"]
        )
        expected = monodromy_growth(point, 2 * np.pi / turn[0])
        assert stable[i] > 0
        assert growth[i] == pytest.approx(expected, abs=2e-5)
        assert (stable[i] == 2) == (expected > 2e-5)


def test_eigenvalues_at_equilibria_are_those_of_the_equations_of_motion():
    points = some("equilibrium", 20)
    stable, growth = linear_stability(points, np.full(20, 2))
    values = np.linalg.eigvals(jacobians(initial_state(points), constants(points)))
    # the nine equations have three zeros more, of the lengths and the angle of alpha and gamma
    assert growth == pytest.approx(values.real.max(1), abs=1e-6)
    assert set(stable) == {1, 2}


@pytest.mark.parametrize("name", ["cylindrical", "perp_radius", "perp_velocity", "oblique", "other_axis"])
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_closed_forms_are_those_of_the_multipliers(name, seed):
    rng = np.random.default_rng(seed)
    point = solved(name, rng)
    if name in ("cylindrical", "other_axis"):  # axial rotor and magnet
        point = free_point(rng, name)
        if name == "cylindrical":
            point["theta0"] = np.pi * rng.integers(2, size=1)
            point |= {key: np.zeros(1) for key in ("k1", "k2", "mu1", "mu2")}
        else:
            axis = np.array([np.sin(point["theta0"]) * np.sin(point["phi0"]),
                             np.sin(point["theta0"]) * np.cos(point["phi0"]), np.cos(point["theta0"])])  # fmt: skip
            k, mu = rng.normal(), rng.normal()
            point |= {f"k{i + 1}": k * axis[i] for i in range(3)} | {
                f"mu{i + 1}": mu * axis[i] for i in range(3)
            }
    if point is None:
        return
    expected = exponents(point)
    if expected[0][0] == 0:  # too slow a rotation for the multipliers
        return
    stable, growth = linear_stability(point, np.array([FAMILIES[name].flag]))
    close = FAMILIES[name].stability(point)
    assert close[0][0] == stable[0] > 0
    # near a collision of multipliers the integration error counts by its square root
    assert growth[0] == pytest.approx(expected[1][0], abs=3e-5)


def test_spherical_bodies_are_stable():
    """With n = 0 the multipliers can tell; without gravity the orbit's rate is no other than n."""
    rng = np.random.default_rng(2)
    points = [free_point(rng, "spherical") | {"n": np.zeros(1)} for _ in range(6)]
    points = stack([point | {"k3": FAMILIES["spherical"].solve["k3"](point)} for point in points])
    stable, growth = exponents(points)
    assert (stable == 1).all()
    assert not growth.any()
    assert (linear_stability(points, np.full(6, 9))[0] == 1).all()


def symmetric(theta0, psi0, sigma, b):
    """Symmetric body A = 1 with C = sigma and axial momentum b, m = 0.7; no magnet."""
    point = {name: np.zeros(1) for name in PARAMETERS} | {name: np.ones(1) for name in ("A", "B", "Omega")}
    point |= {
        "C": np.full(1, sigma),
        "theta0": np.full(1, theta0),
        "psi0": np.full(1, psi0),
        "m": np.full(1, 0.7),
    }
    return point | {"k3": np.full(1, b - sigma * (np.cos(theta0) + 0.7))}


@settings(max_examples=40, deadline=None)
@given(sigma=st.floats(0.05, 1.95), b=st.floats(-6, 6), theta0=st.floats(0.05, 1.5))
def test_classical_boundaries(sigma, b, theta0):
    """lambda^4 + P lambda^2 + Q = 0 in units of Omega, sigma = C/A, b = (C w3 + k3)/(A Omega)."""
    u = np.cos(theta0) ** 2
    forms = [
        ("cylindrical", 0.0, 0.0, b, b * b - 2 * b + 3 * sigma - 1, (b - 1) * (b + 3 * sigma - 4)),
        ("cylindrical", np.pi, 0.0, b, b * b + 2 * b + 3 * sigma - 1, (-b - 1) * (-b + 3 * sigma - 4)),
        ("perp_radius", theta0, 0.0, np.cos(theta0), 3 * sigma - 2, 3 * (sigma - 1) * (1 - u)),
        ("perp_velocity", theta0, np.pi / 2, (4 - 3 * sigma) * np.cos(theta0),
         7 - 6 * sigma + 9 * sigma * (sigma - 1) * u, 3 * (sigma - 1) * (3 * sigma - 4) * (1 - u)),
    ]  # fmt: skip
    for name, tilt, psi0, momentum, P, Q in forms:
        point = symmetric(tilt, psi0, sigma, momentum)
        # the axis at pi sees w3 = -Omega + m
        flag, _ = identify_family(point)
        assert flag[0] == FAMILIES[name].flag or abs(sigma - 1) < 1e-9
        stable, growth = FAMILIES[name].stability(point)
        roots = np.sqrt(np.roots([1, P, Q]).astype(complex))
        assert growth[0] == pytest.approx(np.abs(roots.real).max(), abs=2e-6)
        if min(abs(P), abs(Q), abs(P * P - 4 * Q)) > 1e-6:
            assert (stable[0] == 1) == (P > 0 and Q > 0 and P * P > 4 * Q)


def test_marginal_roots_count_as_stable():
    """sigma = 1: the axis may lie anywhere, lambda = 0 twice."""
    stable, growth = FAMILIES["perp_radius"].stability(symmetric(0.8, 0.0, 1.0, np.cos(0.8)))
    assert (stable[0], growth[0]) == (1, 0.0)


def test_slow_rotation_and_no_family_are_unknown():
    points = some("transverse_magnet", 2)
    slow = points | {"m": points["m"] * 1e-6}
    stable, growth = linear_stability(slow, np.array([6, 0]))
    assert stable.tolist() == [0, 0]
    assert np.isnan(growth).all()
    assert stable.dtype == np.int8


def test_unstable_motions_leave_and_stable_ones_stay():
    """Nudged runs of the equations of motion for 12 orbits, of the families without closed form."""
    for name in ("transverse_magnet", "asymmetric_tilt"):
        points = some(name, 8, seed=3)
        stable, growth = linear_stability(points, np.full(8, FAMILIES[name].flag))
        for i in range(8):
            point = {key: value[i : i + 1] for key, value in points.items()}
            if stable[i] == 2 and growth[i] < 0.15:
                continue
            nudged = point | {"theta0": point["theta0"] + 1e-6, "psi0": point["psi0"] + 1e-6}
            end = 75 / point["Omega"][0]
            run = solve_ivp(
                lambda t, y, values: rhs(y, values), (0, end), initial_state(nudged)[:, 0],
                "DOP853", rtol=1e-9, atol=1e-11, args=(constants(point)[:, 0],),
            )  # fmt: skip
            left = np.abs(np.arccos(np.clip(run.y[8], -1, 1)) - np.arccos(np.cos(point["theta0"]))).max()
            assert (left > 2e-4) == (stable[i] == 2), (name, i, growth[i], left)


# Relative equilibria.


def algebraic_count(inertia, kappa):
    """Number of equilibria without h1 from the curves that beta, the direction of motion, lies on.

    alpha.(4 I gamma + kappa) = 0, beta.(I gamma + kappa) = 0, beta.I alpha = 0 with kappa = k/Omega give
    gamma = (I beta - (beta.I beta) beta)/rho, alpha = beta x I beta/rho, rho = -kappa.beta, and so a
    cubic and a quartic in beta; each common real point is two equilibria, +-alpha.
    """
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def curves(x, y):
        beta = basis @ np.array([x, y, np.ones_like(x)])
        moved = inertia[:, None] * beta
        normal = np.cross(beta, moved, axis=0)
        determinant = (normal * inertia[:, None] * moved).sum(0)
        along = kappa @ beta
        square = (beta**2).sum(0)
        cubic = 4 * determinant - along * (kappa @ normal)
        quartic = (moved**2).sum(0) * square - (beta * moved).sum(0) ** 2 - along**2 * square
        return cubic, quartic

    circle = np.exp(2j * np.pi * np.arange(8) / 8)

    def in_y(x):
        """Coefficients of both curves in powers of y, highest first, for one x."""
        values = curves(np.full(8, x, complex), circle)
        cubic, quartic = (np.fft.fft(value) / 8 for value in values)
        return cubic[3::-1], quartic[4::-1]

    def resultant(x):
        cubic, quartic = in_y(x)
        matrix = np.zeros((7, 7), complex)
        for i in range(4):
            matrix[i, i : i + 4] = cubic
        for i in range(3):
            matrix[4 + i, i : i + 5] = quartic
        return np.linalg.det(matrix)

    samples = np.exp(2j * np.pi * np.arange(16) / 16)
    coefficients = np.fft.fft([resultant(x) for x in samples]) / 16
    roots = np.roots(coefficients[12::-1])
    return 2 * int((np.abs(roots.imag) < 1e-7 * (1 + np.abs(roots))).sum())


@pytest.mark.parametrize("seed", range(8))
def test_all_equilibria_of_a_gyrostat_are_found(seed):
    rng = np.random.default_rng(seed)
    # no component near 0, where the two curves touch in points that are no equilibria
    inertia, k = np.array([1.0, 1.3, 1.7]), rng.uniform(0.04, 0.2, 3) * (3 if seed % 2 else 1)
    found = equilibria({"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 1.0, **{f"k{i + 1}": k[i] for i in range(3)}})
    assert len(found["index"]) == algebraic_count(inertia, k)
    assert 8 <= len(found["index"]) <= 24
    assert ((-1.0) ** found["index"]).sum() == 0


def test_equilibria_are_equilibria():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 0.4, "k1": 0.04, "k2": -0.03, "k3": 0.05, "mu1": 0.1, "mu2": 0.2,
            "mu3": -0.1, "h1": 0.3, "h3": 0.2}  # fmt: skip
    found = equilibria(body)
    count = len(found["index"])
    points = {name: np.full(count, body.get(name, 0.0)) for name in PARAMETERS}
    points |= {name: found[name] for name in ("theta0", "psi0", "phi0")}
    flags, _ = identify_family(points)
    assert (flags == 2).all()
    state = initial_state(points)
    np.testing.assert_allclose(state[3:6].T, found["alpha"], atol=1e-12)
    np.testing.assert_allclose(state[6:].T, found["gamma"], atol=1e-12)
    assert (np.diff(found["potential"]) >= 0).all()
    # a minimum is stable
    assert (found["stable"][found["index"] == 0] == 1).all()
    # an odd index is not (Kelvin, Chetaev)
    assert (found["stable"][found["index"] % 2 == 1] == 2).all()
    assert ((-1.0) ** found["index"]).sum() == 0


def test_index_and_potential_by_differences():
    body = {
        "A": 1.0,
        "B": 1.3,
        "C": 1.7,
        "Omega": 0.7,
        "k1": 0.1,
        "k2": -0.03,
        "k3": 0.05,
        "mu1": 0.2,
        "h1": 0.3,
    }
    found = equilibria(body)
    inertia, k = np.array([1.0, 1.3, 1.7]), np.array([0.1, -0.03, 0.05])

    def potential(angles):
        point = {name: np.full(1, body.get(name, 0.0)) for name in PARAMETERS}
        point |= {
            name: np.full(1, angle) for name, angle in zip(("theta0", "psi0", "phi0"), angles, strict=True)
        }
        alpha, gamma = initial_state(point)[3:6, 0], initial_state(point)[6:, 0]
        gravity = 1.5 * 0.49 * inertia @ alpha**2 + 0.3 * 0.2 * alpha[0]
        return gravity - 0.7 * k @ gamma - 0.5 * 0.49 * inertia @ gamma**2

    step = 1e-3
    for i in range(len(found["index"])):
        if abs(np.sin(found["theta0"][i])) < 0.05:
            continue
        at = np.array([found[name][i] for name in ("theta0", "psi0", "phi0")])
        assert potential(at) == pytest.approx(found["potential"][i], abs=1e-12)
        hessian = np.zeros((3, 3))
        for p in range(3):
            for q in range(3):
                e, f = np.eye(3)[p] * step, np.eye(3)[q] * step
                corners = (
                    potential(at + e + f),
                    -potential(at + e - f),
                    -potential(at - e + f),
                    potential(at - e - f),
                )
                hessian[p, q] = sum(corners) / (4 * step**2)
        assert (np.linalg.eigvalsh(hessian) < 0).sum() == found["index"][i]


def test_the_24_of_a_rigid_body():
    found = equilibria({"A": 1.0, "B": 1.2, "C": 1.5})
    assert np.bincount(found["index"]).tolist() == [4, 8, 8, 4]
    assert np.allclose(np.sort(np.abs(found["gamma"]), axis=1), [0, 0, 1], atol=1e-9)
    assert not found["circle"].any()
    assert found["stable"].dtype == np.int8


def test_circles_of_a_symmetric_body():
    """A = B: the axis along normal, velocity or radius, turned about itself by any angle."""
    found = equilibria({"A": 1.0, "B": 1.0, "C": 1.5})
    assert len(found["circle"]) == 6
    assert found["circle"].all()
    np.testing.assert_allclose(np.abs(found["axis"]), np.tile([0, 0, 1.0], (6, 1)), atol=1e-9)
    # C > A: stable along the normal and along the velocity, as the classical diagram has it
    assert (found["stable"] == 1).sum() == 4
    ball = equilibria({"A": 1.0, "B": 1.0, "C": 1.0, "k1": 0.3, "k3": 0.4})
    assert ball["circle"].all()
    np.testing.assert_allclose(np.abs(ball["gamma"]), [[0.6, 0, 0.8]] * 2, atol=1e-9)
    np.testing.assert_allclose(np.abs(ball["axis"]), [[0.6, 0, 0.8]] * 2, atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("k", [0.0, 0.1, 0.7, 1.3, 3.0])
def test_circles_of_a_symmetric_gyrostat(axis, k):
    """Its axis on the normal (2), across the radius if |k| < |A - C| (2), across the velocity if |k| < 4 |A - C| (2)."""
    inertia = np.full(3, 1.5)
    inertia[axis] = 1.0
    found = equilibria({**dict(zip("ABC", inertia, strict=True)), f"k{axis + 1}": k})
    assert found["circle"].all()
    assert len(found["circle"]) == 2 + 2 * (k < 0.5) + 2 * (k < 2.0)


def test_a_body_at_rest_anywhere():
    with pytest.raises(BadInput, match="surface of equilibria"):
        equilibria({"A": 1.0, "B": 1.0, "C": 1.0})
    with pytest.raises(BadInput, match="any orientation"):
        equilibria({"Omega": 0.0})
