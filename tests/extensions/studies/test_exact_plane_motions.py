"""Exact motions in the plane, against integration and closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import default_points
from truth import check_whole_periods

from atlas.extensions.studies import exact
from atlas.extensions.studies.plane_cases import PlaneMotion
from atlas.systems.satellite import SATELLITE

ACCURATE = 2e-11


def planar_libration(A, B, C, Omega, angle, rate):
    points = default_points("satellite", A=A, B=B, C=C, Omega=Omega, psi0=angle, m=rate)
    return exact.motion_of(SATELLITE, PlaneMotion, points, 0)


@pytest.mark.usual("1", "9")
@pytest.mark.parametrize("seed", range(16))
def test_planar_libration(seed):
    """Librations and rotations about either stable direction, against the pendulum equation."""
    rng = np.random.default_rng(seed)
    A, B, C, Omega = *rng.uniform(0.8, 1.4, 2), rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.5)
    angle, rate, duration = rng.uniform(-7, 7), rng.normal() * (0.5 if seed % 2 else 3) * (seed % 5 > 0), 9.0

    def slope(_, y):
        return [y[1], -3 * Omega**2 * (B - A) / C * np.sin(y[0]) * np.cos(y[0]), y[1] ** 2]

    run = solve_ivp(
        slope, (0, duration), [angle, rate, 0], "DOP853", dense_output=True, rtol=1e-13, atol=1e-14
    )
    motion = planar_libration(A, B, C, Omega, angle, rate)
    time = np.linspace(0, duration, 101)
    np.testing.assert_allclose(motion(time).normal_rate, run.sol(time)[1], rtol=0, atol=ACCURATE)
    measured, mean = exact.statistics(motion, duration), (run.y[0, -1] - angle) / duration
    assert measured["normal_rate_mean"] == pytest.approx(mean, abs=ACCURATE)
    assert measured["normal_rate_std"] == pytest.approx(
        np.sqrt(run.y[2, -1] / duration - mean**2), abs=ACCURATE
    )
    assert measured["theta_min"] == measured["theta_max"] == measured["theta_dot_rms"] == 0
    assert np.isnan(measured["psi_dot_mean"])


@pytest.mark.parametrize("offset", [1e-10, 1e-13, 1e-15])
def test_departure_from_the_unstable_direction(offset):
    """From rest beside it the angle grows like cosh(s t) as long as it is small, whatever the offset."""
    A, B, C = 1.2, 1.0, 0.9
    growth = np.sqrt(3 * (A - B) / C)
    time = np.linspace(0.0, (np.log(1e-5 / offset)) / growth, 50)
    now = planar_libration(A, B, C, 1.0, offset, 0.0)(time)
    np.testing.assert_allclose(
        now.normal_rate, offset * growth * np.sinh(growth * time), rtol=1e-9, atol=1e-9 * offset
    )


@pytest.mark.parametrize("rate", [0.5, 2.5])
def test_whole_periods_count_alike(rate):
    check_whole_periods(planar_libration(1.0, 1.3, 1.2, 1.0, 0.4, rate))


@pytest.mark.parametrize(
    ("given", "condition"),
    [
        ({"theta0": 0.1}, "sin theta0 = 0"),
        ({"theta0": np.pi}, "theta0 = 0"),
        ({"damping": 0.1}, "damping = 0"),
        ({"k1": 1e-3}, "k1 = k2 = 0"),
    ],
)
def test_points_without_an_exact_motion_in_the_plane(given, condition):
    points = default_points("satellite", **{"A": 1.0, "B": 1.3, "psi0": 0.1} | given)
    with pytest.raises(ValueError, match="no exact motion in the plane") as error:
        exact.motion_of(SATELLITE, PlaneMotion, points, 0)
    assert condition in str(error.value)
