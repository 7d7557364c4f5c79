"""The exact motions against plain equations of motion integrated to 1e-13, and against closed forms."""

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipkm1
from truth import check_whole_periods, gyrostat_run, gyrostat_start

from atlas.extensions.studies import exact

# What DOP853 at 1e-13 leaves of states and statistics, relative to the larger of 1 and the value.
ACCURATE = 2e-11


def assert_same_motion(motion, run, expected, duration, tolerance=ACCURATE):
    """Rates and theta at many times, and every statistic."""
    time = np.linspace(0.0, duration, 101)
    now, (p, q, r, g1, g2, g3) = motion(time), run(time)
    sine = np.hypot(g1, g2)
    np.testing.assert_allclose(now.theta, np.arctan2(sine, g3), rtol=0, atol=tolerance)
    np.testing.assert_allclose(now.cos_theta_dot, q * g1 - p * g2, rtol=0, atol=tolerance)
    np.testing.assert_allclose(now.psi_dot + now.phi_dot * g3, now.normal_rate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(now.phi_dot, r - (p * g1 + q * g2) / sine**2 * g3, rtol=1e-9, atol=1e-9)
    measured = exact.statistics(motion, duration)
    assert measured.keys() == expected.keys()
    for name, value in expected.items():
        # A deviation of 0 is the root of a rounding error in the quadratures of the integrator.
        assert measured[name] == pytest.approx(
            value, rel=tolerance, abs=max(tolerance, 1e-7 * (value < 1e-6))
        )


@pytest.mark.parametrize("m", [0.0, 0.3, 0.99, 1 - 1e-12])
def test_elliptic_functions(m):
    mpmath.mp.dps = 30
    complement = mpmath.mpf(1) - mpmath.mpf(m)
    quarter = float(ellipkm1(float(complement)))
    argument = np.linspace(-2.5 * quarter, 2.5 * quarter, 23)
    for values, name in zip(exact.jacobi(argument, float(complement)), ("sn", "cn", "dn"), strict=True):
        expected = [float(mpmath.ellipfun(name, u, m=1 - complement)) for u in argument]
        np.testing.assert_allclose(values, expected, rtol=0, atol=3e-14)


def test_elliptic_functions_beside_the_separatrix():
    """There the complement is far below the rounding of m; half the quarter period is known in closed form."""
    complement = 1e-24
    quarter = float(ellipkm1(complement))
    sn, cn, dn = exact.jacobi(np.array([quarter / 2, quarter]), complement)
    np.testing.assert_allclose(sn, [1 / np.sqrt(1 + np.sqrt(complement)), 1], rtol=1e-14)
    np.testing.assert_allclose(dn, [complement**0.25, np.sqrt(complement)], rtol=1e-12)
    np.testing.assert_allclose(cn[0], complement**0.25 / np.sqrt(1 + np.sqrt(complement)), rtol=1e-12)
    with pytest.raises(ValueError, match="complement"):
        exact.jacobi(np.zeros(1), 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_inverse_elliptic_functions(seed):
    rng = np.random.default_rng(seed)
    complement = 10.0 ** rng.uniform(-20, 0)
    argument = rng.uniform(-1.9, 1.9) * float(ellipkm1(complement))
    sn, cn, _ = (float(values[0]) for values in exact.jacobi(np.array([argument]), complement))
    round_trip = exact.jacobi(np.array([exact.inverse_jacobi(sn, cn, complement)]), complement)
    np.testing.assert_allclose([round_trip[0][0], round_trip[1][0]], [sn, cn], rtol=0, atol=1e-13)


@pytest.mark.usual("3", "7", "11", "15")
@pytest.mark.parametrize("seed", range(16))
def test_symmetric_top(seed):
    """Heavy and free tops with a rotor, upright and hanging, in a frame at rest and in one that turns."""
    rng = np.random.default_rng(seed)
    A, C, rotor = rng.uniform(0.7, 1.4), rng.uniform(0.3, 1.3), rng.normal()
    weight = rng.normal() * (seed % 4 > 0)
    theta, theta_dot, n, m = rng.uniform(0.2, 2.9), rng.normal() * (seed % 3 > 0), rng.normal(), rng.normal()
    frame_rate, duration = 0.7 * (seed % 2), rng.uniform(1, 8)
    start = gyrostat_start(theta, 0.3, theta_dot, n + frame_rate, m)
    run, expected = gyrostat_run(
        np.array([A, A, C]), np.array([0, 0, rotor]), np.array([0, 0, weight]), start, duration, frame_rate
    )
    motion = exact.SymmetricTop(A, C, rotor, weight, (theta, theta_dot, n, m), frame_rate)
    assert_same_motion(motion, run, expected, duration)


@pytest.mark.usual("0.001-passes", "0.01-ends")
@pytest.mark.parametrize("part", ["starts", "ends", "passes"])
@pytest.mark.parametrize("sine", [1e-1, 1e-2, 1e-3])
@pytest.mark.parametrize("weight", [0.8, -0.8])
def test_symmetric_top_beside_the_vertical(weight, sine, part):
    """A passage at the given distance, at the start, at the end or in the middle of the run."""
    A, C, rotor = 1.0, 0.7, 0.4
    start = sine, 0.0, 0.3 / sine, -0.3 / sine
    if part != "starts":  # the same motion from a moment before the passage
        before = exact.SymmetricTop(A, C, rotor, weight, start)(np.array([-1.5]))
        start = tuple(float(values[0]) for values in before[:4])
    duration = 3.0 if part == "passes" else 1.5
    theta, theta_dot, n, m = start
    run, expected = gyrostat_run(
        np.array([A, A, C]), np.array([0, 0, rotor]), np.array([0, 0, weight]),
        gyrostat_start(theta, 0.3, theta_dot, n, m), duration,
    )  # fmt: skip
    assert expected["theta_min"] == pytest.approx(sine, rel=1e-6)
    motion = exact.SymmetricTop(A, C, rotor, weight, start)
    assert_same_motion(motion, run, expected, duration, tolerance=1e-12 / sine**2)


@pytest.mark.usual("0.6-0.001", "0.0-0.1")
@pytest.mark.parametrize("sine", [1e-1, 1e-2, 1e-3])
@pytest.mark.parametrize("rotor", [0.0, 0.6])
def test_free_gyrostat_beside_the_vertical(sine, rotor):
    inertia, rotor = np.array([1.0, 1.3, 1.7]), np.array([rotor, 0.0, 0.0])
    start = gyrostat_start(np.pi - sine, 0.3, -0.2, 0.3 / sine, 0.5 + 0.3 / sine)
    run, expected = gyrostat_run(inertia, rotor, np.zeros(3), start, 2.0)
    motion = exact.FreeGyrostat(inertia, rotor, *start)
    assert_same_motion(motion, run, expected, 2.0, tolerance=1e-12 / sine**2)


@pytest.mark.usual("-1.0")
@pytest.mark.parametrize("theta_dot", [1.0, -1.0])
def test_free_sphere(theta_dot):
    """A free sphere turns about a fixed w: its third axis by Rodrigues' formula, psi from its direction."""
    theta0, n, m, duration = 1e-3, 0.5, -0.5, 2.0
    measured = exact.statistics(exact.SymmetricTop(1, 1, 0, 0, (theta0, theta_dot, n, m)), duration)
    # In space, with the node along x: gamma = z, e3 = (0, -sin theta, cos theta), w = n z + m e3 + theta' x.
    axis = np.array([0.0, -np.sin(theta0), np.cos(theta0)])
    w = np.array([theta_dot, 0.0, n]) + m * axis
    rate = np.sqrt(w @ w)

    def e3(t):
        along = (w @ axis) / rate**2 * w
        return along + np.cos(rate * t) * (axis - along) + np.sin(rate * t) * np.cross(w, axis) / rate

    def psi_dot(t):
        x, y, _ = e3(t)
        x_dot, y_dot, _ = np.cross(w, e3(t))
        return (x * y_dot - y * x_dot) / (x**2 + y**2)

    peaks = np.array([1e-3, 1e-2])  # of psi', in time units after the start
    square, _ = quad(
        lambda t: psi_dot(t) ** 2, 0, duration, points=peaks, epsabs=1e-13, epsrel=1e-12, limit=500
    )
    turned, _ = quad(psi_dot, 0, duration, points=peaks, epsabs=1e-13, epsrel=1e-12, limit=500)
    at_end = e3(duration)
    direction = np.arctan2(at_end[1], at_end[0]) - np.arctan2(axis[1], axis[0])
    assert np.exp(1j * turned) == pytest.approx(np.exp(1j * direction), abs=1e-11)
    assert measured["psi_dot_mean"] == pytest.approx(turned / duration, abs=1e-11)
    assert measured["psi_dot_std"] == pytest.approx(
        np.sqrt(square / duration - (turned / duration) ** 2), rel=1e-9
    )
    np.testing.assert_allclose(measured["normal_rate_std"], 0, atol=1e-15)
    if theta_dot > 0:
        assert measured["theta_min"] == pytest.approx(theta0, rel=1e-12)


def random_free_gyrostat(seed):
    """Inertia, rotor (one in three has none) and start of a free asymmetric body."""
    rng = np.random.default_rng(seed)
    inertia = rng.uniform(0.4, 1.0, 3)
    rotor = np.zeros(3)
    if seed % 3:
        rotor[rng.integers(3)] = 1.5 * rng.normal()
    start = gyrostat_start(rng.uniform(0.2, 2.9), rng.uniform(0, 6), *rng.normal(size=3))
    return inertia.sum() - inertia, rotor, start


@pytest.mark.usual("3", "7", "11", "15")
@pytest.mark.parametrize("seed", range(16))
def test_free_gyrostat(seed):
    inertia, rotor, start = random_free_gyrostat(seed)
    frame_rate, duration = 0.7 * (seed % 2), 2.0 + 0.5 * seed
    run, expected = gyrostat_run(inertia, rotor, np.zeros(3), start, duration, frame_rate)
    motion = exact.FreeGyrostat(inertia, rotor, *start, frame_rate)
    assert_same_motion(motion, run, expected, duration)


def test_free_gyrostats_of_every_form():
    """Those above include both kinds of roots, and turns of r at one and at two of its quadratics."""
    motions = [
        exact.FreeGyrostat(inertia, rotor, *start)
        for inertia, rotor, start in map(random_free_gyrostat, range(16))
    ]
    assert {(motion.roots_real, motion.both_turn) for motion in motions} == {
        (True, True),
        (True, False),
        (False, False),
    }


def test_whole_periods_count_alike():
    check_whole_periods(exact.SymmetricTop(1.0, 0.7, 0.4, -0.8, (0.3, 0.2, 1.0, -0.5)))


def test_bodies_without_an_exact_motion():
    with pytest.raises(ValueError, match="principal axis"):
        exact.FreeGyrostat(np.array([1.0, 1.2, 1.5]), np.array([1.0, 1.0, 0]), np.ones(3), np.eye(3)[0])
    with pytest.raises(ValueError, match="SymmetricTop"):
        exact.FreeGyrostat(np.array([1.0, 1.0, 1.5]), np.zeros(3), np.ones(3), np.eye(3)[0])
