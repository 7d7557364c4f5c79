"""Passages near the vertical: their quadrature errors, and which of them count; turning points of theta."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import quad

from atlas.kernel import integrate as kernel
from atlas.kernel import poles, sampling
from atlas.kernel.poles import Passage, Term, Turn
from atlas.kernel.statistics import NO_ZERO, Row


@pytest.mark.parametrize("intervals", [9, 30])
@pytest.mark.parametrize("place", [0.4, 2.7, 4.5])
@pytest.mark.parametrize("height", [0.01, 0.3, -0.3, 2.0])
def test_quadrature_error_of_a_pole(intervals, place, height):
    """Beside the sums over all samples and integrals by quadrature; the same from both ends."""
    ((t, weights),) = sampling.instants(intervals)
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
def test_corrected_sums_are_integrals(zeros, monkeypatch):
    """Sums of phi'^2, theta'^2 and psi'^2 of a passage, less their errors, against quadrature; one or two zeros near."""
    monkeypatch.setattr(kernel, "QUEUE", 1)
    rotation, u3 = 0.3, 0.4
    first = 20

    def rates(t):
        zeta, slope = motion(t - first, zeros, rotation)
        g3 = np.sqrt(1 - np.abs(zeta) ** 2)
        phi_dot = -(slope / zeta).imag
        theta_dot = (slope * zeta.conjugate()).real / (np.abs(zeta) * g3)
        return np.array([theta_dot**2, (u3 - phi_dot) / g3, ((u3 - phi_dot) / g3) ** 2, phi_dot, phi_dot**2])

    passages, farther = np.zeros((poles.PASSAGE_ROWS, 1)), np.zeros((poles.PASSAGE_ROWS, 8))
    terms = np.zeros((2, len(Term), 8))
    zeta, slope = motion(np.arange(4.0), zeros, rotation)
    passages[Passage.G1 : Passage.G1 + 4, 0], passages[Passage.G2 : Passage.G2 + 4, 0] = zeta.real, zeta.imag
    passages[Passage.G1_SLOPE : Passage.G1_SLOPE + 4, 0] = slope.real
    passages[Passage.G2_SLOPE : Passage.G2_SLOPE + 4, 0] = slope.imag
    passages[Passage.U3 : Passage.U3 + 4, 0] = u3
    passages[Passage.TIME, 0], passages[Passage.VERTICAL, 0] = 1.5, 1.0
    # Over an interval at whose ends the rule is exact: the trapezoidal rule of a periodic continuation is not needed,
    # because the end corrections of both sums below are the same.
    inner = np.arange(first - 8, first + 12.0)
    fine = np.linspace(inner[0], inner[-1], 64 * (inner.size - 1) + 1)
    coarse_sum = rates(inner).sum(1) - 0.5 * (rates(inner[0]) + rates(inner[-1]))
    fine_sum = (rates(fine).sum(1) - 0.5 * (rates(fine[0]) + rates(fine[-1]))) / 64
    slopes = np.array([(rates(x + 1e-4) - rates(x - 1e-4)) / 2e-4 for x in (inner[0], inner[-1])])
    expected = coarse_sum - fine_sum - (slopes[1] - slopes[0]) / 12 * (1 - 1 / 64**2)
    stats = np.zeros((len(Row), 1))
    stats[[Row.ZERO_1_REAL, Row.ZERO_2_REAL], 0] = NO_ZERO
    lane, place, stride, dt = np.zeros(1, int), np.zeros(1, int), 2, np.array([0.25])
    kernel.correct(stats, passages, farther, place, terms, lane, np.array([first]), 1, stride, dt, 60, 1e-12)
    corrected = (
        stats[[Row.ZERO_2_REAL, Row.ZERO_1_REAL], 0] + 1j * stats[[Row.ZERO_2_IMAG, Row.ZERO_1_IMAG], 0]
    )
    expected_zeros = (*[NO_ZERO] * (2 - len(zeros)), *(first + z for z in zeros))
    np.testing.assert_allclose(corrected, expected_zeros, atol=1e-4)
    errors = stats[Row.THETA_DOT_SQUARED_ERROR : Row.PHI_DOT_SQUARED_ERROR + 1, 0]
    units = (stride * dt) ** np.array([2, 1, 2, 1, 2])
    np.testing.assert_allclose(errors * units, expected, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("size", [1e-3, 0.1, 2.0])
@pytest.mark.parametrize(
    "zeros", [(1.4 + 0.2j, 2.1 - 0.6j), (1.7 - 0.5j, -3.5 + 1.0j), (1.45 + 0.0j, 1.5 + 1.2j)]
)
@pytest.mark.parametrize("phase", [0.0, 0.8, 2.3, 3.9, 5.5])
def test_zeros_of_a_parabola_are_exact(size, zeros, phase):
    """zeta of degree 2: the parabola that touches it is zeta itself, whatever its size and direction."""
    t, (near, far) = np.arange(4.0), zeros
    factor = size * np.exp(1j * phase)
    zeta, slope = factor * (t - near) * (t - far), factor * (2.0 * t - near - far)
    passages = np.zeros((poles.PASSAGE_ROWS, 1))
    for row, values in ((Passage.G1, zeta), (Passage.G1_SLOPE, slope)):
        passages[row : row + 4, 0] = values.real
        passages[row + 8 : row + 12, 0] = values.imag
    poles.difference(passages, Passage.G1, 0)
    poles.difference(passages, Passage.G2, 0)
    passages[Passage.TIME, 0] = 1.5
    for farther, zero in enumerate(zeros):
        poles.approximate_zero(passages, 0, bool(farther))
        approximation = complex(passages[Passage.Z_REAL, 0], passages[Passage.Z_IMAG, 0])
        assert approximation == pytest.approx(zero, abs=1e-11)
    assert passages[Passage.FARTHER, 0] == (
        far.real > 0.0
    )  # near: within REACH of the nodes and of the real axis


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


@pytest.mark.parametrize(
    ("zero", "size", "interval", "expected"),
    [
        (0.3 + 1j, 0.4, 7, (1, 0.3)), (0.3 - 1j, 0.4, 0, (1, 0.3)), (0.9 + 3.9j, 0.1, 19, (1, 0.9)),
        # Too far from the real axis, and turning beside the interval.
        (0.3 + 4.1j, 0.1, 7, (0, None)), (-0.3 + 1j, 0.1, 7, (0, None)), (1.3 + 1j, 0.1, 7, (0, None)),
        # At an end of the run that is near the vertical: |0.4 zeta|^2 = 0.17 at the nearer node, 0.43 at the other.
        (-0.3 + 1j, 0.4, 0, (1, 0.0)), (1.3 + 1j, 0.4, 0, (0, None)),
        (1.3 + 1j, 0.4, 19, (1, 1.0)), (-0.3 + 1j, 0.4, 19, (0, None)), (1.3 + 1j, 0.4, 18, (0, None)),
    ],
)  # fmt: skip
def test_where_a_straight_path_of_the_axis_comes_near_the_vertical(zero, size, interval, expected):
    """zeta = size exp(0.7 i) (t - zero): sin^2 theta is a parabola whose zeros are `zero` and its conjugate."""
    spacing, nodes = 0.7, np.full((4, 12, 1), np.nan)
    slope = size * np.exp(0.7j)
    rates = np.array([slope.real, slope.imag]) / spacing
    for t in (0, 1):
        zeta = slope * (t - zero)
        nodes[(interval + t) & 3, [3, 4, 9, 10], 0] = zeta.real, zeta.imag, *rates
    first, second = interval & 3, (interval + 1) & 3
    near, instant = kernel.near_vertical(nodes, first, second, 0, spacing, interval, 20)
    assert near == expected[0]
    if near:
        assert instant == pytest.approx(expected[1], abs=1e-14)


@pytest.mark.parametrize(
    ("counts", "passage"),
    [
        (True, {}),
        # Beside the four nodes, where it may be the farther the higher the zero lies, and far from the real axis.
        (True, {"place": 3.24}), (False, {"place": 3.26}), (True, {"place": -0.24}), (False, {"place": -0.26}),
        (True, {"z": 9 + 4.9j}), (False, {"z": 9 - 5.1j}),
        # Newton's method has not converged.
        (True, {"change": 0.2e-4}), (False, {"change": 0.3e-4}),
        # Inside the cylinder, where psi' and phi' are not sampled during the run.
        (False, {"sine": 1e-4}), (True, {"sine": 1e-4, "z": -0.1 + 0.5j}), (True, {"sine": 1e-4, "z": 20.1 + 0.5j}),
        # The last or the last but one that was corrected for.
        (False, {"zero_1": 9.04 + 0.5j}), (False, {"zero_1": 9 + 0.54j}), (True, {"zero_1": 9.04 + 0.54j}),
        (False, {"zero_2": 8.96 + 0.5j}), (False, {"zero_2": 9 + 0.46j}), (True, {"zero_2": 8.96 + 0.46j}),
    ],
)  # fmt: skip
def test_which_passages_are_corrected_for(counts, passage):
    given = {"place": 1.5, "z": 9 + 0.5j, "change": 0.0, "sine": 0.1, "zero_1": NO_ZERO, "zero_2": NO_ZERO}
    place, z, change, sine, zero_1, zero_2 = (given | passage).values()
    terms, stats = np.full((2, len(Term), 1), np.nan), np.zeros((len(Row), 1))
    terms[1, [Term.Z_REAL, Term.CHANGE, Term.SIN2_THETA], 0] = place, change, sine**2
    stats[[Row.ZERO_1_REAL, Row.ZERO_1_IMAG], 0] = zero_1.real, zero_1.imag
    stats[[Row.ZERO_2_REAL, Row.ZERO_2_IMAG], 0] = zero_2.real, zero_2.imag
    assert kernel.counts(stats, 0, terms, 1, 0, complex(z), 20, 1e-3**2) == counts


def test_turning_points_are_roots_of_the_derivative_of_theta():
    """Random cubic paths of the vertical, of any length, against NumPy's polynomials and their roots."""
    rng = np.random.default_rng(2)
    clipped = roots = 0
    for _ in range(40):
        path = [Polynomial(rng.normal(size=4)) for _ in range(3)]
        u, v, w = path
        sin2_theta = u**2 + v**2
        numerator = sin2_theta * w.deriv() - w * 0.5 * sin2_theta.deriv()  # of -theta' sin theta
        for x in (0.2, 1.7, 2.9):
            values = [(p(x), p.deriv()(x), 0.5 * p.deriv(2)(x)) for p in path]
            change = -numerator(x) / numerator.deriv()(x)
            assert poles.newton_change(*values) == pytest.approx(np.clip(change, -0.5, 0.5), rel=1e-9)
            clipped += abs(change) > 0.5
        turns, nodes = np.zeros((poles.TURN_ROWS, 1)), np.arange(4.0)
        for row, p in zip((Turn.G1, Turn.G2, Turn.G3), path, strict=True):
            turns[row : row + 8, 0] = np.r_[p(nodes), p.deriv()(nodes)]
            poles.difference(turns, row, 0)
        for root in numerator.roots():
            simple = abs(numerator.deriv(2)(root)) < 10 * abs(numerator.deriv()(root))
            if abs(root.imag) > 1e-9 or not 1.0 < root.real < 1.95 or not simple:
                continue
            root, roots = root.real, roots + 1
            turns[Turn.TIME, 0], turns[Turn.NODE, 0] = root + 0.05, 1.0
            for _ in range(poles.TURN_STEPS):
                poles.turning_point(turns, 0)
            x = turns[Turn.TIME, 0]
            assert x == pytest.approx(root, abs=1e-7)
            assert poles.turning_point(turns, 0) == pytest.approx((w(x), sin2_theta(x)), abs=1e-11)
        turns[Turn.TIME, 0], turns[Turn.NODE, 0] = 1.5, 1.0
        for _ in range(poles.TURN_STEPS):
            poles.turning_point(turns, 0)
            assert 1.0 <= turns[Turn.TIME, 0] <= 2.0
    assert 20 < clipped < 100
    assert roots > 10


@pytest.mark.parametrize("factor", [1.0, -2.5])
@pytest.mark.parametrize(
    ("roots", "expected"),
    [((0.2, 0.6), 0.6), ((0.45, 0.9), 0.45), ((0.3, 2.0), 0.3), ((-1.0, 0.7), 0.7), ((0.25, 1e6), 0.25)],
)
def test_a_cubic_turns_at_the_root_of_its_slope_that_is_farther_from_both_nodes(roots, expected, factor):
    slope = factor * Polynomial.fromroots(roots)
    cubic = slope.integ()
    place = poles.place_of_turn(*cubic([0.0, 1.0]), *slope([0.0, 1.0]))
    assert place == pytest.approx(expected, rel=1e-6)
