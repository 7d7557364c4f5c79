"""Linear stability of the satellite's steady motions and its relative equilibria."""

from __future__ import annotations

import numpy as np
import pytest
from family_starts import points_of_family, rotation_rate, stack
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import (
    default_points,
    satellite_for_family,
    select,
)
from truth import fundamental_matrix, jacobian_matrices, monodromy_matrix

from atlas.errors import BadInput
from atlas.flags import Stability
from atlas.systems.gyrostat import floquet
from atlas.systems.gyrostat.system import log_growth
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.families import FAMILIES
from atlas.systems.satellite.initial import PARAMETERS, constants, initial_state


def monodromy_growth(point, period):
    """Growth rate from the variational equations of the nine equations of motion themselves."""
    matrix = monodromy_matrix(rhs, initial_state(point)[:, 0], constants(point)[:, 0], period)
    return np.log(np.abs(np.linalg.eigvals(matrix)).max()) / period


def matrix_along_the_motion(name, point, duration):
    """Fundamental matrix of the nine equations of motion, linearised along the exact motion, and its scale."""
    motion = FAMILIES[name].motion
    return fundamental_matrix(rhs, lambda t: motion(point, t)[..., 0], constants(point)[:, 0], duration)


def growth_along_the_motion(name, point):
    """Growth rate of one point from the nine equations of motion over one period."""
    period = 2 * np.pi / rotation_rate(point)[0]
    monodromy, log_scale = matrix_along_the_motion(name, point, period)
    return (np.log(np.abs(np.linalg.eigvals(monodromy)).max()) + log_scale) / period


PERIODIC = ["cylindrical", "transverse_magnet", "despun_transverse", "asymmetric_tilt", "other_axis"]


@pytest.mark.parametrize("name", PERIODIC)
def test_multipliers_are_those_of_the_equations_of_motion(name):
    # fast enough that rounding errors of an unstable motion stay small over a period
    points = points_of_family(name, 5, min_rate=0.6)
    stable, growth = SATELLITE.stability(points)
    for i in range(5):
        point = select(points, i)
        expected = monodromy_growth(point, 2 * np.pi / rotation_rate(point)[0])
        assert growth[i] == pytest.approx(expected, abs=2e-5)
        assert stable[i] == (Stability.UNSTABLE if expected > 2e-5 else Stability.STABLE)


def test_eigenvalues_at_equilibria_are_those_of_the_equations_of_motion():
    points = points_of_family("equilibrium", 20)
    stable, growth = SATELLITE.linear_stability(points, np.full(20, FAMILIES["equilibrium"].flag))
    eigenvalues = np.linalg.eigvals(jacobian_matrices(rhs, initial_state(points), constants(points)))
    # the nine equations have three more eigenvalues 0, for the lengths and the angle of alpha and gamma
    assert growth == pytest.approx(eigenvalues.real.max(1), abs=1e-6)
    assert set(stable) == {Stability.STABLE, Stability.UNSTABLE}


def test_spherical_bodies_are_stable():
    """With n = 0, where the multipliers decide; without gravity Omega acts only through n + Omega."""
    rng = np.random.default_rng(2)
    points = [satellite_for_family("spherical", rng) | {"n": np.zeros(1)} for _ in range(6)]
    points = stack([point | {"k3": FAMILIES["spherical"].solve["k3"](point)} for point in points])
    stable, growth = SATELLITE.stability(points)
    assert (stable == Stability.STABLE).all()
    assert not growth.any()
    stable, _ = SATELLITE.linear_stability(points, np.full(6, FAMILIES["spherical"].flag))
    assert (stable == Stability.STABLE).all()


def symmetric_point(theta0, psi0, sigma, b):
    """Symmetric body A = 1 with C = sigma and axial momentum b, m = 0.7; no magnet."""
    k3 = b - sigma * (np.cos(theta0) + 0.7)
    return default_points("satellite", A=1, B=1, Omega=1, C=sigma, theta0=theta0, psi0=psi0, m=0.7, k3=k3)


@settings(max_examples=40, deadline=None)
@given(sigma=st.floats(0.05, 1.95), b=st.floats(-6, 6), theta0=st.floats(0.05, 1.5))
def test_classical_boundaries(sigma, b, theta0):
    """lambda^4 + P lambda^2 + Q = 0 in units of Omega, sigma = C/A, b = (C w3 + k3)/(A Omega)."""
    u = np.cos(theta0) ** 2
    motions = [
        ("cylindrical", 0.0, 0.0, b, b * b - 2 * b + 3 * sigma - 1, (b - 1) * (b + 3 * sigma - 4)),
        ("cylindrical", np.pi, 0.0, b, b * b + 2 * b + 3 * sigma - 1, (-b - 1) * (-b + 3 * sigma - 4)),
        ("perp_radius", theta0, 0.0, np.cos(theta0), 3 * sigma - 2, 3 * (sigma - 1) * (1 - u)),
        ("perp_velocity", theta0, np.pi / 2, (4 - 3 * sigma) * np.cos(theta0),
         7 - 6 * sigma + 9 * sigma * (sigma - 1) * u, 3 * (sigma - 1) * (3 * sigma - 4) * (1 - u)),
    ]  # fmt: skip
    for name, tilt, psi0, momentum, P, Q in motions:
        point = symmetric_point(tilt, psi0, sigma, momentum)
        flag, _ = SATELLITE.identify_family(point)
        assert flag[0] == FAMILIES[name].flag or abs(sigma - 1) < 1e-9
        stable, growth = SATELLITE.linear_stability(point, np.array([FAMILIES[name].flag]))
        roots = np.sqrt(np.roots([1, P, Q]).astype(complex))
        assert growth[0] == pytest.approx(np.abs(roots.real).max(), abs=2e-6)
        if min(abs(P), abs(Q), abs(P * P - 4 * Q)) > 1e-6:
            assert (stable[0] == Stability.STABLE) == (P > 0 and Q > 0 and P * P > 4 * Q)


def test_marginal_roots():
    """Exponents 0 along neighbouring steady motions, as of every sphere, decide nothing; others are undecided."""
    sphere = symmetric_point(0.8, 0.0, 1.0, np.cos(0.8))
    border = symmetric_point(0.0, 0.0, 1.2, 1.0)
    for point, expected in ((sphere, Stability.STABLE), (border, Stability.UNKNOWN)):
        flags, _ = SATELLITE.identify_family(point)
        assert SATELLITE.linear_stability(point, flags) == (expected, 0.0)


@pytest.mark.parametrize("name", ["cylindrical", "transverse_magnet", "other_axis"])
def test_multipliers_of_slow_rotations_are_those_of_the_equations_of_motion(name):
    points = points_of_family(name, 6, min_rate=0.0, slower=0.05)
    stable, growth = SATELLITE.linear_stability(points, np.full(6, FAMILIES[name].flag))
    known = np.flatnonzero(stable != Stability.UNKNOWN)
    assert known.size >= 5
    for i in known:
        expected = growth_along_the_motion(name, select(points, i))
        assert growth[i] == pytest.approx(expected, abs=2e-5)
        assert stable[i] == (Stability.UNSTABLE if expected > 2e-5 else Stability.STABLE)


@pytest.mark.parametrize("name", ["cylindrical", "transverse_magnet", "other_axis"])
def test_very_slow_rotations_grow_like_their_frozen_phases(name, monkeypatch):
    points = points_of_family(name, 60, min_rate=0.0, slower=0.01)
    integrated, growth = SATELLITE.stability(points)
    monkeypatch.setattr(floquet, "_MAX_STEPS", 0)
    adiabatic, approximate = SATELLITE.stability(points)
    period = 2 * np.pi / rotation_rate(points)
    certain = adiabatic != Stability.UNKNOWN
    assert certain.sum() > 20
    assert (adiabatic[certain] == integrated[certain]).all()
    np.testing.assert_allclose((approximate * period)[certain], (growth * period)[certain], rtol=0.05, atol=5)


@pytest.mark.parametrize("name", ["cylindrical", "transverse_magnet", "despun_transverse", "other_axis"])
def test_growth_over_a_part_of_a_period_is_that_of_the_equations_of_motion(name):
    points = points_of_family(name, 12, min_rate=0.0, slower=0.05)
    flags = np.full(12, FAMILIES[name].flag, np.int8)
    _, growth = SATELLITE.linear_stability(points, flags)
    duration = np.minimum(30.0, 0.5 * 2 * np.pi / rotation_rate(points))
    result = log_growth(SATELLITE, points, flags, growth, duration)
    mean = np.nan_to_num(growth * duration)
    assert (np.nan_to_num(result) >= mean).all()
    assert np.isnan(log_growth(SATELLITE, points, np.zeros_like(flags), np.full(12, np.nan), duration)).all()
    for i in range(12):
        _, log_scale = matrix_along_the_motion(name, select(points, i), duration[i])
        # the entries of the two matrices have other units
        if log_scale > max(13.0, mean[i] + 3):
            assert result[i] == pytest.approx(log_scale, abs=3)
        elif log_scale < 7:
            assert result[i] == pytest.approx(mean[i]) or np.isnan(result[i])


@pytest.mark.parametrize("slower", [1.0, 0.03])
def test_exponents_do_not_depend_on_the_other_points(slower):
    points = points_of_family("other_axis", 40, min_rate=0.0, slower=slower)
    _, together = SATELLITE.stability(points)
    for part in (slice(0, 1), slice(3, 20), slice(7, None)):
        _, alone = SATELLITE.stability({name: values[part] for name, values in points.items()})
        np.testing.assert_array_equal(alone, together[part])


def test_no_family_is_unknown_and_the_slowest_rotations_are_not():
    points = points_of_family("transverse_magnet", 30)
    slow = points | {"m": points["m"] * 1e-6}
    for name in ("h1", "k1", "k2", "k3"):
        slow[name] = FAMILIES["transverse_magnet"].solve[name](slow)
    flags = np.full(30, FAMILIES["transverse_magnet"].flag, np.int8)
    flags[::2] = 0
    stable, growth = SATELLITE.linear_stability(slow, flags)
    assert (stable[::2] == Stability.UNKNOWN).all()
    assert np.isnan(growth[::2]).all()
    assert set(stable[1::2]) == {Stability.STABLE, Stability.UNSTABLE}
    assert stable.dtype == np.int8


def test_nudged_motions_stay_where_stable_and_leave_where_unstable():
    """Nudged motions over 12 orbits, of the families without closed form."""
    for name in ("transverse_magnet", "asymmetric_tilt"):
        points = points_of_family(name, 8, seed=3)
        stable, growth = SATELLITE.linear_stability(points, np.full(8, FAMILIES[name].flag))
        for i in range(8):
            point = select(points, i)
            if stable[i] == Stability.UNSTABLE and growth[i] < 0.15:  # too slow to leave in 12 orbits
                continue
            nudged = point | {"theta0": point["theta0"] + 1e-6, "psi0": point["psi0"] + 1e-6}
            end = 75 / point["Omega"][0]
            solution = solve_ivp(
                lambda t, y, values: rhs(y, values), (0, end), initial_state(nudged)[:, 0],
                "DOP853", rtol=1e-9, atol=1e-11, args=(constants(point)[:, 0],),
            )  # fmt: skip
            theta = np.arccos(np.clip(solution.y[8], -1, 1))
            change = np.abs(theta - np.arccos(np.cos(point["theta0"]))).max()
            assert (change > 2e-4) == (stable[i] == Stability.UNSTABLE), (name, i, growth[i], change)


# Relative equilibria.


def algebraic_count(inertia, kappa):
    """Number of equilibria without h1, from two curves that contain beta, the direction of motion.

    alpha.(4 I gamma + kappa) = 0, beta.(I gamma + kappa) = 0, beta.I alpha = 0 with kappa = k/Omega give
    gamma = (I beta - (beta.I beta) beta)/rho, alpha = beta x I beta/rho, rho = -kappa.beta, and so a
    cubic and a quartic in beta; each common real point is two equilibria, +-alpha.
    """
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def curves(x, y):
        beta = basis @ np.array([x, y, np.ones_like(x)])
        momentum = inertia[:, None] * beta
        normal = np.cross(beta, momentum, axis=0)
        determinant = (normal * inertia[:, None] * momentum).sum(0)
        component = kappa @ beta
        square = (beta**2).sum(0)
        cubic = 4 * determinant - component * (kappa @ normal)
        quartic = (momentum**2).sum(0) * square - (beta * momentum).sum(0) ** 2 - component**2 * square
        return cubic, quartic

    circle = np.exp(2j * np.pi * np.arange(8) / 8)

    def coefficients_in_y(x):
        """Coefficients of both curves in powers of y, highest first, for one x."""
        values = curves(np.full(8, x, complex), circle)
        cubic, quartic = (np.fft.fft(value) / 8 for value in values)
        return cubic[3::-1], quartic[4::-1]

    def resultant(x):
        cubic, quartic = coefficients_in_y(x)
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
    # no component near 0, where the two curves touch at points that are not equilibria
    inertia, k = np.array([1.0, 1.3, 1.7]), rng.uniform(0.04, 0.2, 3) * (3 if seed % 2 else 1)
    body = dict(zip("ABC", inertia, strict=True)) | {f"k{i + 1}": k[i] for i in range(3)}
    index = SATELLITE.equilibria(body | {"Omega": 1.0})["index"]
    assert len(index) == algebraic_count(inertia, k)
    assert 8 <= len(index) <= 24
    assert ((-1.0) ** index).sum() == 0  # Euler characteristic of the rotation group


def test_equilibria_are_on_their_family_and_sorted_by_potential():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 0.4, "k1": 0.04, "k2": -0.03, "k3": 0.05, "mu1": 0.1, "mu2": 0.2,
            "mu3": -0.1, "h1": 0.3, "h3": 0.2}  # fmt: skip
    solutions = SATELLITE.equilibria(body)
    count = len(solutions["index"])
    points = {name: np.full(count, body.get(name, 0.0)) for name in PARAMETERS}
    points |= {name: solutions[name] for name in ("theta0", "psi0", "phi0")}
    flags, _ = SATELLITE.identify_family(points)
    assert (flags == FAMILIES["equilibrium"].flag).all()
    state = initial_state(points)
    np.testing.assert_allclose(state[3:6].T, solutions["alpha"], atol=1e-12)
    np.testing.assert_allclose(state[6:].T, solutions["gamma"], atol=1e-12)
    assert (np.diff(solutions["potential"]) >= 0).all()
    # a minimum of the potential is stable, an odd index unstable (Kelvin, Chetaev)
    assert (solutions["stable"][solutions["index"] == 0] == Stability.STABLE).all()
    assert (solutions["stable"][solutions["index"] % 2 == 1] == Stability.UNSTABLE).all()
    assert ((-1.0) ** solutions["index"]).sum() == 0


def test_index_is_that_of_the_difference_quotients_of_the_potential():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 0.7, "mu1": 0.2, "h1": 0.3}
    body |= {"k1": 0.1, "k2": -0.03, "k3": 0.05}
    solutions = SATELLITE.equilibria(body)
    inertia, k = np.array([1.0, 1.3, 1.7]), np.array([0.1, -0.03, 0.05])
    names = ("theta0", "psi0", "phi0")

    def potential(angles):
        state = initial_state(default_points("satellite", **body, **dict(zip(names, angles, strict=True))))
        alpha, gamma = state[3:6, 0], state[6:, 0]
        gravity = 1.5 * 0.49 * inertia @ alpha**2 + 0.3 * 0.2 * alpha[0]
        return gravity - 0.7 * k @ gamma - 0.5 * 0.49 * inertia @ gamma**2

    step = 1e-3
    for i in range(len(solutions["index"])):
        if abs(np.sin(solutions["theta0"][i])) < 0.05:
            continue
        x = np.array([solutions[name][i] for name in names])
        assert potential(x) == pytest.approx(solutions["potential"][i], abs=1e-12)
        hessian = np.zeros((3, 3))
        for p in range(3):
            for q in range(3):
                e, f = np.eye(3)[p] * step, np.eye(3)[q] * step
                difference = potential(x + e + f) - potential(x + e - f)
                difference -= potential(x - e + f) - potential(x - e - f)
                hessian[p, q] = difference / (4 * step**2)
        assert (np.linalg.eigvalsh(hessian) < 0).sum() == solutions["index"][i]


def test_a_rigid_body_has_24_equilibria():
    solutions = SATELLITE.equilibria({"A": 1.0, "B": 1.2, "C": 1.5})
    assert np.bincount(solutions["index"]).tolist() == [4, 8, 8, 4]
    assert np.allclose(np.sort(np.abs(solutions["gamma"]), axis=1), [0, 0, 1], atol=1e-9)
    assert not solutions["circle"].any()
    assert solutions["stable"].dtype == np.int8


def test_circles_of_a_symmetric_body():
    """A = B: the axis along normal, velocity or radius, and any angle about it."""
    solutions = SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.5})
    assert len(solutions["circle"]) == 6
    assert solutions["circle"].all()
    np.testing.assert_allclose(np.abs(solutions["axis"]), np.tile([0, 0, 1.0], (6, 1)), atol=1e-9)
    # C > A: stable along the normal and along the velocity, as in the classical diagram
    assert (solutions["stable"] == Stability.STABLE).sum() == 4
    ball = SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.0, "k1": 0.3, "k3": 0.4})
    assert ball["circle"].all()
    np.testing.assert_allclose(np.abs(ball["gamma"]), [[0.6, 0, 0.8]] * 2, atol=1e-9)
    np.testing.assert_allclose(np.abs(ball["axis"]), [[0.6, 0, 0.8]] * 2, atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("k", [0.0, 0.1, 0.7, 1.3, 3.0])
def test_circles_of_a_symmetric_gyrostat(axis, k):
    """Two each: axis on the normal; across the radius if |k| < |A - C|; across the velocity if |k| < 4 |A - C|."""
    inertia = np.full(3, 1.5)
    inertia[axis] = 1.0
    solutions = SATELLITE.equilibria({**dict(zip("ABC", inertia, strict=True)), f"k{axis + 1}": k})
    assert solutions["circle"].all()
    assert len(solutions["circle"]) == 2 + 2 * (k < 0.5) + 2 * (k < 2.0)


def test_bodies_at_rest_in_every_orientation_are_refused():
    with pytest.raises(BadInput, match="surface of equilibria"):
        SATELLITE.equilibria({"A": 1.0, "B": 1.0, "C": 1.0})
    with pytest.raises(BadInput, match="any orientation"):
        SATELLITE.equilibria({"Omega": 0.0})
