"""Reference solutions, and the statistics of the kernels compared with them where psi' has peaks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plain_kernel import plain_module
from strategies import BySystem, default_points, evaluate

import atlas
from atlas.extensions.studies import reference
from atlas.flags import Label
from atlas.kernel import quadratures
from atlas.kernel.specialization import slope_kernel
from atlas.kernel.statistics import RATES
from atlas.kernel.tableaux import METHODS
from atlas.measure.rates import state_distance
from atlas.scene import grid
from atlas.scene.model import Settings
from atlas.scene.read import load_scene
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

SATELLITE = SYSTEMS["satellite"]


def test_reference_on_a_family(scene_text):
    """Two runs of DOP853 against the closed form of a family, and the statistics of a steady motion."""
    scene = load_scene(scene_text({"nudge": None, "labels": None, "integration": {"duration": 10.0}}))
    part = grid.points_at_indices(scene, np.arange(0, 63, 9))
    solution = reference.reference(
        scene.system, part.points, part.duration, scene.settings.at(part.rate_tolerance)
    )
    assert solution.exact.all()
    assert solution.label_certain.all()
    assert solution.state_error.max() < 1e-11 * reference.SAFETY
    np.testing.assert_allclose(solution.statistics["phi_dot_mean"], part.points["m"], atol=1e-13)
    np.testing.assert_allclose(solution.statistics["theta_max"], part.points["theta0"], atol=1e-14)
    assert all(error.max() < 1e-7 for error in solution.statistics_error.values())
    # n = 0: the axis rests in the orbital frame
    np.testing.assert_array_equal(solution.label, Label.PERMANENT_ROTATION)


def test_reference_of_a_libration():
    """The third axis librates in the plane of normal and radius about pi/2, with a smooth theta'."""
    points = default_points(
        "satellite", A=1.0, B=1.2, C=1.1, theta0=np.pi / 2, psi0=np.pi / 2, theta_dot0=0.3
    )
    duration = np.array([7.0])
    solution = reference.reference(SATELLITE, points, duration, Settings().at(1e-5))
    loose = reference._integrate_group(SATELLITE, points, duration, 1e-5, 1e-10)
    assert solution.statistics["theta_dot_rms"][0] == pytest.approx(loose["theta_dot_rms"][0], rel=1e-8)
    run = atlas.label_points("satellite", points, duration=7.0, tolerance=1e-11)
    for name in RATES:
        assert run[name].item() == pytest.approx(solution.statistics[name][0], abs=1e-9), name
    assert run["theta_max"].item() == pytest.approx(solution.statistics["theta_max"][0], abs=5e-9)


@pytest.mark.long
def test_reference_after_a_transient():
    """Its states are those of one whole run; its statistics those of the kernel, damped and free."""
    given = {"B": 1.3, "C": 1.6, "theta0": 0.7, "psi0": 0.4, "n": 0.3, "damping": np.array([0.0, 0.1])}
    points = default_points("satellite", **given)
    settings, duration = Settings().at(1e-5, np.array([15.0, 8.0])), np.array([6.0, 7.0])
    solution = reference.reference(SATELLITE, points, duration, settings)
    whole = reference.reference(SATELLITE, points, duration + settings.transient, Settings().at(1e-5))
    np.testing.assert_allclose(solution.state, whole.state, atol=1e-11)
    for i in range(2):
        lengths = {"duration": duration[i], "transient": settings.transient[i]}
        run = atlas.label_points(
            "satellite", {**given, "damping": given["damping"][i]}, tolerance=1e-11, **lengths
        )
        for name in RATES:
            assert run[name].item() == pytest.approx(solution.statistics[name][i], abs=1e-9), name


def test_extremes_are_those_of_the_trajectory():
    points = default_points("satellite", A=1.0, B=1.2, C=0.8, theta0=0.4, psi0=0.3, n=0.3, m=0.5)
    solution = reference.reference(SATELLITE, points, np.array([6.0]), Settings().at(1e-5))
    point = {name: values[0] for name, values in points.items()}
    path = atlas.trajectory("satellite", point, duration=6.0, samples=3001)
    for name, extreme in (("theta_min", path.theta.min()), ("theta_max", path.theta.max())):
        assert solution.statistics[name][0] == pytest.approx(extreme.item(), abs=1e-5)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("compiled", [True, False])
def test_slopes_are_those_of_the_equations(name, compiled):
    """At a point outside the cylinder and one inside; rates of the angles follow from the motion of gamma."""
    system = SYSTEMS[name]
    points = default_points(name, theta0=[0.4, 0.02], phi0=0.7, theta_dot0=0.2, m=0.9)
    state, constants, cylinder = system.initial_state(points), system.constants(points), 0.1
    duration, first = np.array([3.0, 7.0]), np.zeros((4, 2))
    path = np.concatenate([state, np.full((len(reference.RATE_SUMS), 2), 5.0)])
    slopes = np.full_like(path, np.nan)
    plain = plain_module(system.equations, "rk8", of=quadratures)
    (slope_kernel(system) if compiled else plain).integrate(
        path, constants, duration, first, cylinder, slopes
    )
    size = len(state)
    np.testing.assert_allclose(
        slopes[:size], duration * system.equations.rhs(state, constants), rtol=1e-13, atol=1e-15
    )
    theta_dot, psi_dot, phi_dot, normal = sums = slopes[size:][[1, 4, 6, 8]]
    np.testing.assert_array_equal(slopes[size:][[0, 2, 5, 7, 9]], sums[[0, 0, 1, 2, 3]] ** 2)
    np.testing.assert_array_equal(slopes[size + 3], [1.0, 0.0])
    np.testing.assert_allclose(theta_dot, points["theta_dot0"], rtol=1e-13)
    u1, u2, u3, *gamma = system.equations.frame_motion(state, constants)
    # gamma' = gamma x u, and gamma is (sin theta sin phi, sin theta cos phi, cos theta).
    change = np.cross(np.array(gamma), np.array([u1, u2, u3]), axis=0)
    np.testing.assert_allclose(
        phi_dot[0], (change[0] * gamma[1] - change[1] * gamma[0])[0] / np.sin(0.4) ** 2, rtol=1e-12
    )
    np.testing.assert_allclose(normal, u1 * gamma[0] + u2 * gamma[1] + u3 * gamma[2], rtol=1e-12)
    # The component of u along the third body axis is phi' + psi' cos theta.
    np.testing.assert_allclose(u3[0], phi_dot[0] + psi_dot[0] * np.cos(0.4), rtol=1e-12)
    np.testing.assert_array_equal([psi_dot[1], phi_dot[1]], 0.0)


def test_a_point_that_fails_does_not_fail_its_group(monkeypatch):
    """DOP853 fails at one of three points that are integrated together."""
    integrate_group = reference._integrate_group

    def failing(system, points, *arguments):
        return None if (points["m"] == 0.6).any() else integrate_group(system, points, *arguments)

    monkeypatch.setattr(reference, "_integrate_group", failing)
    points = default_points("satellite", theta0=0.3, m=[0.5, 0.6, 0.7])
    run, failed = reference._dop853(SATELLITE, points, np.full(3, 2.0), 1e-5, 1e-10, reference.no_progress)
    np.testing.assert_array_equal(failed, [False, True, False])
    np.testing.assert_array_equal(np.isfinite(run["state"]).all(0), ~failed)


# Statistics of the kernels where the third axis passes near the vertical and psi' has a narrow peak.


PASSAGES = Settings(tolerance=1e-9, cylinder_tolerance=1e-7)


@cache
def passages_near_the_vertical(name):
    """Points, durations and the statistics of the reference, which are those of both methods."""
    system, rng = SYSTEMS[name], np.random.default_rng(4)
    given = BySystem(
        satellite={"mu1": 0.2, "h3": 0.4, "k3": 0.3}, fixed_point={"Mg": 1.0, "z0": 0.6, "l3": 0.3}
    )
    points = default_points(name, 24, A=1.0, B=1.2, C=0.8, theta0=0.7, theta_dot0=-1.0, **given[name])
    points |= {
        "m": rng.uniform(-1.0, 1.0, 24),
        "n": rng.uniform(-0.02, 0.02, 24),
        "phi0": rng.uniform(0, 6, 24),
    }
    duration = np.full(24, 8.0)
    return points, duration, reference.reference(system, points, duration, PASSAGES.at(1e-5)).statistics


@pytest.mark.usual("rk8")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_statistics_of_passages_near_the_vertical(name, method):
    """Peaks of psi' a hundred times as high as elsewhere, and narrower than the distance of two samples.

    Without the correction of the sums the largest errors are 0.2 (satellite, rk4) to 6 (fixed_point).
    """
    points, duration, expected = passages_near_the_vertical(name)
    measured = evaluate(SYSTEMS[name], points, points, duration, replace(PASSAGES, method=method))
    assert expected["theta_min"].min() < 0.01
    assert expected["psi_dot_std"].max() > 5.0
    for rate in RATES:
        error = np.abs(measured[rate] - expected[rate])
        assert error.max() < 1e-4, rate
        assert np.median(error) < 2e-6, rate


@cache
def passages_at_an_end(at):
    """As `passages_near_the_vertical`, in the first and last few samples and just before and after them."""
    rng, count = np.random.default_rng(4), 48
    points = default_points("satellite", count, A=1.0, B=1.2, C=0.8, theta_dot0=-1.0, mu1=0.2, h3=0.4, k3=0.3)
    points |= {
        "m": rng.uniform(-1.0, 1.0, count),
        "n": rng.uniform(-0.02, 0.02, count),
        "phi0": rng.uniform(0, 6, count),
    }
    if at == "beginning":
        points["theta0"], duration = np.linspace(-0.1, 0.2, count), np.full(count, 4.0)
    else:
        points["theta0"], duration = np.full(count, 0.7), np.linspace(0.5, 0.95, count)
    return points, duration, reference.reference(SATELLITE, points, duration, PASSAGES.at(1e-5)).statistics


@pytest.mark.usual("end-rk8")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("at", ["beginning", "end"])
def test_statistics_of_passages_at_an_end_of_the_run(at, method):
    """Where the weights of the samples are not 1."""
    points, duration, expected = passages_at_an_end(at)
    settings = replace(PASSAGES, tolerance=1e-8, method=method)
    measured = evaluate(SATELLITE, points, points, duration, settings)
    error = np.max([np.abs(measured[name] - expected[name]) for name in RATES], axis=0)
    assert expected["psi_dot_std"].max() > 5.0
    # Without the correction: medians from 1e-6 to 1, the largest from 0.7 to 700.
    assert np.median(error) < 1e-6
    assert np.quantile(error, 0.9) < 1e-4
    assert error.max() < 0.02


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_the_distance_of_states_is_that_of_the_component_that_differs_most(system):
    """A rate by 0.4, in units of the bound, and a direction by 0.05."""
    state = np.zeros((len(system.equations.STATE), 2))
    other = state.copy()
    other[1], other[-1] = 0.4, -0.05
    np.testing.assert_allclose(state_distance(system, state, other, np.array([4.0, 16.0])), [0.1, 0.05])
