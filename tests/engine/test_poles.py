"""Quadrature errors of passages near the vertical."""

import numpy as np
import pytest
from scipy.integrate import quad

from atlas.engine import poles, sampling
from atlas.engine.poles import Passage, Term


@pytest.mark.parametrize("intervals", [9, 30])
@pytest.mark.parametrize("place", [0.4, 2.7, 4.5])
@pytest.mark.parametrize("height", [0.01, 0.3, -0.3, 2.0])
def test_quadrature_error_of_a_pole(intervals, place, height):
    """Beside the sums over all samples and integrals by quadrature; the same from both ends."""
    t, weights = sampling.instants(intervals)
    for z in (complex(place, height), complex(intervals - place, height)):
        tau, slope = sampling.stretched(z, intervals - z)
        errors = poles.trapezoid_error_of_pole(tau, slope)
        for power, value in zip((1, 2), errors, strict=True):
            points = [
                x for x in (z.real - 5 * abs(height), z.real, z.real + 5 * abs(height)) if 0 < x < intervals
            ]
            integral, _ = quad(
                lambda t, z=z, power=power: (t - z) ** -power, 0, intervals, points=points, complex_func=True,
                limit=500, epsabs=1e-11, epsrel=1e-12,
            )  # fmt: skip
            ends = 0.5 * (intervals - weights.sum()) * ((-z) ** -power + (intervals - z) ** -power)
            true = (weights * (t - z) ** -power).sum() + ends - integral
            assert abs(value - true) < 1e-7 * (1 + abs(true))


def motion(t, zeros, rotation):
    """zeta with these zeros, u3 and g3 of a motion of the vertical, and the derivative of zeta; t may be complex."""
    zeta = 0.04 / 4 ** len(zeros) * np.exp(1j * rotation * t)
    slope = 1j * rotation + sum(1 / (t - z) for z in zeros)
    for z in zeros:
        zeta = zeta * (t - z)
    return zeta, zeta * slope


@pytest.mark.parametrize("zeros", [(1.4 + 0.2j,), (1.6 - 0.7j,), (1.2 + 0.3j, 1.9 - 0.4j)])
def test_corrected_sums_are_integrals(zeros):
    """Sums of phi'^2, theta'^2 and psi'^2 of a passage, less their errors, against quadrature; one or two zeros near."""
    rotation, u3 = 0.3, 0.4
    first = 20

    def rates(t):
        zeta, slope = motion(t - first, zeros, rotation)
        g3 = np.sqrt(1 - np.abs(zeta) ** 2)
        phi_dot = -(slope / zeta).imag
        theta_dot = (slope * zeta.conjugate()).real / (np.abs(zeta) * g3)
        return np.array([theta_dot**2, (u3 - phi_dot) / g3, ((u3 - phi_dot) / g3) ** 2, phi_dot, phi_dot**2])

    passages, terms = np.zeros((poles.PASSAGE_ROWS, 1)), np.zeros((2, len(Term), 1))
    zeta, slope = motion(np.arange(4.0), zeros, rotation)
    passages[Passage.G1 : Passage.G1 + 4, 0], passages[Passage.G2 : Passage.G2 + 4, 0] = zeta.real, zeta.imag
    passages[Passage.G1_SLOPE : Passage.G1_SLOPE + 4, 0] = slope.real
    passages[Passage.G2_SLOPE : Passage.G2_SLOPE + 4, 0] = slope.imag
    passages[Passage.U3 : Passage.U3 + 4, 0] = u3
    passages[Passage.TIME, 0], passages[Passage.VERTICAL, 0] = 1.5, 1.0
    for row in (Passage.G1, Passage.G2, Passage.U3):
        poles.difference(passages, row, 0)
    # Over an interval at whose ends the rule is exact: the trapezoidal rule of a periodic continuation is not needed,
    # because the end corrections of both sums below are the same.
    inner = np.arange(first - 8, first + 12.0)
    fine = np.linspace(inner[0], inner[-1], 64 * (inner.size - 1) + 1)
    coarse_sum = rates(inner).sum(1) - 0.5 * (rates(inner[0]) + rates(inner[-1]))
    fine_sum = (rates(fine).sum(1) - 0.5 * (rates(fine[0]) + rates(fine[-1]))) / 64
    slopes = np.array([(rates(x + 1e-4) - rates(x - 1e-4)) / 2e-4 for x in (inner[0], inner[-1])])
    expected = coarse_sum - fine_sum - (slopes[1] - slopes[0]) / 12 * (1 - 1 / 64**2)
    errors = np.zeros(5)
    for farther in range(len(zeros)):
        poles.approximate_zero(passages, 0, farther == 1)
        for _ in range(poles.NEWTON_STEPS):
            poles.improve_zero(passages, 0)
        z = complex(passages[Passage.Z_REAL, 0], passages[Passage.Z_IMAG, 0])
        assert min(abs(z - zero) for zero in zeros) < 1e-4
        poles.pole_terms(passages, 0, terms, int(farther))
        errors += poles.sum_errors(terms, farther, 0, *poles.trapezoid_error_of_pole(z, 1.0 + 0.0j), 1.0)
    np.testing.assert_allclose(errors, expected, rtol=2e-3, atol=2e-4)


def test_nothing_is_divided_by_zero():
    """A third axis at rest on the vertical, or beside it: zeta has no zero."""
    terms = np.zeros((2, len(Term), 1))
    for value in (0.0, 1.0, np.nan, np.inf):
        passages = np.full((poles.PASSAGE_ROWS, 1), value)
        with np.errstate(all="ignore"):
            for farther in (False, True):
                poles.approximate_zero(passages, 0, farther)
                poles.improve_zero(passages, 0)
                poles.pole_terms(passages, 0, terms, int(farther))
