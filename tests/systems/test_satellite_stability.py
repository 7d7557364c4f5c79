"""Linear stability of the satellite's steady motions."""

from __future__ import annotations

import numpy as np
import pytest
from family_starts import points_of_family, rotation_rate, stack
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import default_points, satellite_for_family, select
from truth import fundamental_matrix, jacobian_matrices, monodromy_matrix

from atlas.flags import Stability
from atlas.systems.gyrostat import floquet
from atlas.systems.gyrostat.system import log_growth
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.families import FAMILIES
from atlas.systems.satellite.initial import constants, initial_state


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


@pytest.mark.usual("cylindrical")
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


@pytest.mark.long
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


@pytest.mark.usual("transverse_magnet")
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


@pytest.mark.usual("other_axis")
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


@pytest.mark.usual("cylindrical")
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


@pytest.mark.long
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
