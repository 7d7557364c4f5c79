"""Fundamental matrices of periodic linear systems, against an adaptive integrator and Mathieu's equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atlas.systems.gyrostat import floquet, fundamental


def random_harmonics(rng, points, size):
    """Mean and two harmonics of matrices that are no small perturbation of the mean."""
    parts = rng.normal(size=(3, points, size, size)) + 1j * rng.normal(size=(3, points, size, size))
    parts[0] = parts[0].real
    return 0.4 * parts


@pytest.mark.parametrize("size", [4, 6])
def test_fundamental_matrices_are_those_of_an_adaptive_integrator(size):
    rng = np.random.default_rng(size)
    harmonics, period = (
        random_harmonics(rng, fundamental.LANES + 3, size),
        rng.uniform(2, 7, fundamental.LANES + 3),
    )
    span = 1.7 * period
    result, log_scale = fundamental.of_harmonics(harmonics, period, span, 1024)
    np.testing.assert_allclose(np.abs(result).max((1, 2)), 1.0, rtol=1e-14)
    for i in (0, 5, fundamental.LANES, fundamental.LANES + 2):
        mean, first, second = harmonics[:, i]

        def slope(t, y, mean=mean, first=first, second=second, frequency=2j * np.pi / period[i]):
            phase = np.exp(frequency * t)
            matrix = mean.real + 2 * (first * phase + second * phase**2).real
            return (matrix @ y.reshape(size, size)).ravel()

        run = solve_ivp(slope, (0, span[i]), np.eye(size).ravel(), "DOP853", rtol=1e-12, atol=1e-12)
        expected = run.y[:, -1].reshape(size, size)
        np.testing.assert_allclose(
            result[i] * np.exp(log_scale[i]), expected, rtol=0, atol=1e-8 * np.abs(expected).max()
        )


def test_the_compiled_function_is_the_python_one_and_no_point_depends_on_others(monkeypatch):
    rng = np.random.default_rng(1)
    harmonics, period = random_harmonics(rng, 5, 4), rng.uniform(2, 7, 5)
    together, log_scale = fundamental.of_harmonics(harmonics, period, period, 20)
    for part in (slice(0, 1), slice(3, 5)):
        alone = fundamental.of_harmonics(harmonics[:, part], period[part], period[part], 20)
        np.testing.assert_array_equal(alone[0], together[part])
        np.testing.assert_array_equal(alone[1], log_scale[part])
    monkeypatch.setattr(fundamental, "LANES", 2)
    monkeypatch.setattr(fundamental, "_compile", lambda: fundamental.integrate)
    interpreted = fundamental.of_harmonics(harmonics, period, period, 20)
    np.testing.assert_allclose(interpreted[0], together, rtol=0, atol=1e-13)
    np.testing.assert_allclose(interpreted[1], log_scale, rtol=0, atol=1e-13)


def test_multipliers_of_the_equation_of_mathieu():
    """x'' + (a - 2 q cos 2 t) x = 0 beside four multipliers 1: tongues at a = 1 +- q for small q."""

    def matrix(part, t):
        values = np.zeros((*t.shape, 6, 6))
        values[..., 0, 1] = 1.0
        values[..., 1, 0] = -(a[part] - 2 * q * np.cos(2 * t))
        return values

    q, a = 0.05, np.array([0.9, 0.96, 1.0, 1.04, 1.1, np.nan])
    period = np.where(np.isfinite(a), np.pi, np.nan)
    stable, growth = floquet.growth_of_periodic_motion(matrix, period)
    np.testing.assert_array_equal(stable, [1, 2, 2, 2, 1, 0])
    assert growth[2] == pytest.approx(q / 2, rel=1e-2)
    assert np.isnan(growth[5])


def test_growth_beyond_the_range_of_float64():
    harmonics = np.zeros((3, 1, 4, 4), complex)
    harmonics[0, 0, 0, 1], harmonics[0, 0, 1, 0] = 25.0, 1.0
    steps = 2 * fundamental.STEPS  # in two calls
    result, log_scale = fundamental.of_harmonics(harmonics, np.ones(1), np.full(1, 1000.0), steps)
    assert log_scale[0] == pytest.approx(5000.0 + np.log(2.5), rel=1e-7)
    np.testing.assert_allclose(result[0, :2, :2], [[0.2, 1.0], [0.04, 0.2]], rtol=1e-6)
