"""Quadrature and interpolation of the samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atlas.kernel.sampling import (
    END,
    LONG,
    MIN_INTERVALS,
    hermite_weights,
    instants,
    quadrature,
    rule_position,
    sample,
)
from atlas.kernel.statistics import theta_from


def rule(intervals: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants and weights of all samples of a run, as the kernel takes them, from the nodes and between them."""
    rules, n = quadrature(), min(intervals, LONG)
    weights = [rules.node_weights[n, rule_position(i, intervals)] for i in range(intervals + 1)]
    t = list(np.arange(intervals + 1.0))
    for i in range(intervals):
        position = rule_position(i, intervals)
        row = rules.samples[rules.first_sample[n, position] : rules.first_sample[n, position + 1]]
        first = min(max(i - 1, 0), intervals - 3)
        # The weights interpolate time itself: its values at the nodes are 0, 1, 2, 3 and its slopes 1.
        t += list(first + row[:, 1:] @ np.r_[np.arange(4.0), np.ones(4)])
        weights += list(row[:, 0])
    return np.array(t), np.array(weights)


@pytest.mark.parametrize("intervals", [3, 4, 7, 16, 31, 32, 33, 40, 200])
def test_weights_are_positive_and_integrate_smooth_functions(intervals):
    t, w = rule(intervals)
    assert (w >= 0).all()
    assert w.sum() == pytest.approx(intervals, rel=1e-12)
    assert ((t >= 0) & (t <= intervals)).all()
    for degree in range(8):
        assert (w / intervals) @ (t / intervals) ** degree == pytest.approx(1 / (degree + 1), rel=1e-9)
    for frequency in (0.3, 1.0, 1.5):
        exact = np.sin(frequency * intervals) / frequency
        assert w @ np.cos(frequency * t) == pytest.approx(exact, abs=2e-8 * intervals)


@pytest.mark.parametrize("intervals", [3, 16, 50])
@pytest.mark.parametrize("angle", [100, 130, 180])
def test_poles_beyond_the_ends_do_no_harm(intervals, angle):
    """1 / (t - z)^2 with z at any distance from the start, relative to the integral of its absolute value."""
    t, w = rule(intervals)
    for distance in 10.0 ** np.arange(-3, 1.5, 0.25):
        z = distance * np.exp(1j * np.deg2rad(angle))
        exact = -1 / z - 1 / (intervals - z)
        assert abs(w @ (t - z) ** -2.0 - exact) < 2e-7 / distance
        assert abs(w @ (intervals - t - z) ** -2.0 - exact) < 2e-7 / distance


def test_a_long_run_is_uniform_but_for_its_ends():
    ((t, w),) = instants(LONG)
    inner = np.abs(t - LONG / 2) < LONG / 2 - END + 2
    np.testing.assert_allclose(t[inner], np.rint(t[inner]), atol=1e-8)
    np.testing.assert_allclose(w[inner], 1.0, atol=1e-7)
    assert MIN_INTERVALS == 3


@pytest.mark.parametrize("theta", [0.0, 1e-3, 0.1, 2.0, np.pi - 1e-3])
def test_rates_are_those_of_the_euler_angles(theta):
    """Inside the cylinder, and on the vertical, psi' and phi' are 0 and the others finite."""
    psi_dot, phi_dot, theta_dot, phi = 0.7, -1.1, 0.4, 2.3
    g = np.array([np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)])
    u = psi_dot * g + [theta_dot * np.cos(phi), -theta_dot * np.sin(phi), phi_dot]
    rates = sample((*u, *g), 0.01**2)
    outside = float(np.sin(theta) > 0.01)
    expected = [psi_dot, phi_dot] if outside else [0.0, 0.0]
    assert rates[0] == pytest.approx(theta_dot if theta else 0.0, rel=1e-12)
    assert rates[1:3] == pytest.approx(expected, rel=1e-12)
    assert rates[3:] == pytest.approx((u @ g, np.sin(theta) ** 2, outside), rel=1e-12)


@given(st.floats(0, np.pi))
def test_theta_comes_back_at_both_poles_and_at_the_equator(theta):
    g = np.array([np.sin(theta), 0.0, np.cos(theta)])
    sin2_theta = sample((0.0, 0.0, 0.0, *g), 0.0)[4]
    assert sin2_theta == g[0] ** 2
    returned = theta_from(np.asarray(g[2]), np.asarray(sin2_theta))
    assert returned == pytest.approx(theta, abs=5e-16, rel=1e-14)


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.floats(0, 3))
def test_interpolation_is_exact_for_polynomials_of_seventh_degree(coefficients, x):
    polynomial = np.polynomial.Polynomial(coefficients)
    nodes = np.arange(4.0)
    values = np.r_[polynomial(nodes), polynomial.deriv()(nodes)]
    interpolated = hermite_weights(np.array([x]))[0] @ values
    assert interpolated == pytest.approx(polynomial(x), abs=1e-12 * np.abs(values).max())
