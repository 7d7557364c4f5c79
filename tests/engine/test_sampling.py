"""Quadrature, interpolation and turning points of the samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atlas.engine.sampling import END_WEIGHTS, hermite_weights, quadrature_weight, sample, turning_point
from atlas.engine.statistics import theta_from


@given(st.integers(13, 200), st.integers(0, 7))
def test_gregory_weights_are_positive_and_exact_for_polynomials(intervals, degree):
    w = np.array([quadrature_weight(k, intervals, END_WEIGHTS) for k in range(intervals + 1)])
    assert (w > 0).all()
    x = np.linspace(0, 1, intervals + 1)
    assert (w / intervals) @ x**degree == pytest.approx(1 / (degree + 1), rel=1e-12)


@given(st.floats(0, np.pi))
def test_theta_comes_back_at_both_poles_and_at_the_equator(theta):
    g = np.array([np.sin(theta), 0.0, np.cos(theta)])
    _, _, _, _, cos_theta, sin2_theta, _, _ = sample((0.0, 0.0, 0.0, *g), 0.0)
    assert sin2_theta == g[0] ** 2
    returned = theta_from(np.asarray(cos_theta), np.asarray(sin2_theta))
    assert returned == pytest.approx(theta, abs=5e-16, rel=1e-14)


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.integers(1, 4))
def test_interpolation_is_exact_for_polynomials_of_seventh_degree(coefficients, samples):
    polynomial = np.polynomial.Polynomial(coefficients)
    nodes = np.arange(4.0)
    values = np.r_[polynomial(nodes), polynomial.deriv()(nodes)]
    for interval in range(3):
        for sample_number in range(1, samples + 1):
            interpolated = hermite_weights(4)[samples - 1, interval, sample_number - 1] @ values
            exact = polynomial(interval + sample_number / samples)
            assert interpolated == pytest.approx(exact, abs=1e-12 * np.abs(values).max())


def test_turning_point_between_two_samples_is_of_fourth_order():
    """cos theta = 0.3 + 0.5 cos t, sampled about its maximum and its minimum."""
    errors = []
    for spacing in (0.2, 0.1):
        worst = 0.0
        for extreme, instant in ((0.8, 0.0), (-0.2, np.pi)):
            t = instant + spacing * np.array([-0.3, 0.7])
            cos_theta, slope = 0.3 + 0.5 * np.cos(t), -0.5 * np.sin(t)
            sin2_theta = 1 - cos_theta**2
            cos_extreme, sin2_extreme = turning_point(
                spacing, cos_theta[0], sin2_theta[0], -slope[0], cos_theta[1], sin2_theta[1], -slope[1]
            )
            worst = max(worst, abs(cos_extreme - extreme), abs(sin2_extreme - (1 - extreme**2)))
        errors.append(worst)
    assert errors[0] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)
    monotone = 0.3 + 0.5 * np.cos([0.5, 0.7])
    assert turning_point(0.2, monotone[0], 0.5, 0.2, monotone[1], 0.6, 0.3) == (monotone[1], 0.6)
