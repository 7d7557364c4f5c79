"""The tangent kernel: variational equations, MEGNO and exponents against independent integrations."""

import numpy as np
import pytest
from plain_kernel import plain_module
from scipy.integrate import solve_ivp
from strategies import DRAG, RANDOM, random_satellites, select, specialization_of

from atlas.kernel import augmented, blocks, tangent
from atlas.kernel.blocks import Threads
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import tangent_kernel
from atlas.measure import tangent_runs
from atlas.systems import SYSTEMS


def indicators(name, points, duration, *, kernel=None, threads=1, step=None):
    system = SYSTEMS[name]
    ensemble = Ensemble.of(system, points)
    durations = np.full(ensemble.size, duration)
    steps = tangent_runs.TangentSteps.of(ensemble.frequency_bound, durations, step, 10**9)
    kernel = kernel or tangent_kernel(system)
    separation = tangent_runs.Separation(
        system, kernel, ensemble, steps, tangent_runs.rate_unit(system, points)
    )
    separation.integrate(threads=Threads(threads))
    return separation.megno, separation.lyapunov


def cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def satellite_variation(points, i):
    """Slope of w, alpha, gamma, dw, eta in vectors, written without the package's equations."""
    value = {name: column[i] for name, column in points.items()}
    inertia = np.array([value[name] for name in "ABC"])
    rotor, magnet, drag = (np.array([value[f"{name}{k}"] for k in (1, 2, 3)]) for name in ("k", "mu", "drag"))
    Omega, h1, h3 = value["Omega"], value["h1"], value["h3"]

    def slope(_, y):
        w, a, g, dw, eta = y.reshape(5, 3)
        da, dg = cross(a, eta), cross(g, eta)
        torque = cross(inertia * w + rotor, w) + 3 * Omega**2 * cross(a, inertia * a)
        torque += cross(h1 * a + h3 * g, magnet) + cross(cross(g, a), drag)
        change = cross(inertia * dw, w) + cross(inertia * w + rotor, dw)
        change += 3 * Omega**2 * (cross(da, inertia * a) + cross(a, inertia * da))
        change += cross(h1 * da + h3 * dg, magnet) + cross(cross(dg, a) + cross(g, da), drag)
        u = w - Omega * g
        return np.concatenate(
            [torque / inertia, cross(a, u), cross(g, u), change / inertia, dw + cross(eta, w)]
        )

    return slope


def fixed_point_variation(points, i):
    """Slope of w, gamma, dw, dgamma in vectors."""
    value = {name: column[i] for name, column in points.items()}
    inertia = np.array([value[name] for name in "ABC"])
    rotor = np.array([value[f"l{k}"] for k in (1, 2, 3)])
    weight, field = value["Mg"] * np.array([value[f"{x}0"] for x in "xyz"]), value["N"]

    def slope(_, y):
        w, g, dw, dg = y.reshape(4, 3)
        torque = cross(inertia * w + rotor, w) + cross(weight, g) + field * cross(g, inertia * g)
        change = cross(inertia * dw, w) + cross(inertia * w + rotor, dw) + cross(weight, dg)
        change += field * (cross(dg, inertia * g) + cross(g, inertia * dg))
        return np.concatenate([torque / inertia, cross(g, w), change / inertia, cross(dg, w) + cross(g, dw)])

    return slope


VARIATION = {"satellite": satellite_variation, "fixed_point": fixed_point_variation}


def reference(name, points, i, duration):
    """Mean MEGNO and exponent of point i from DOP853 and fine quadratures of ln|v|."""
    system = SYSTEMS[name]
    state = system.initial_state(points)[:, [i]]
    v = augmented.tangent_start(system.equations, state)[:, 0]
    unit = tangent_runs.rate_unit(system, points)[i]
    v[:3] *= unit
    slope = VARIATION[name](points, i)
    times = np.linspace(0, duration, 20001)
    run = solve_ivp(
        slope, (0, duration), np.r_[state[:, 0], v], "DOP853", t_eval=times, rtol=1e-12, atol=1e-13
    )
    v = run.y[len(state) :].copy()
    v[:3] /= unit
    growth = 0.5 * np.log((v * v).sum(0))
    h = times[1]
    integral = np.r_[0, np.cumsum(0.5 * h * (growth[1:] + growth[:-1]))]
    megno = np.r_[0, 2 * (growth[1:] - integral[1:] / times[1:])]
    return np.trapezoid(megno, times) / duration, growth[-1] / duration


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("name", RANDOM)
def test_indicators_agree_with_an_independent_integration(name):
    points = RANDOM[name](np.random.default_rng(3), 6)
    duration = 25.0
    megno, lyapunov = indicators(name, points, duration)
    expected = np.array([reference(name, points, i, duration) for i in range(6)]).T
    np.testing.assert_allclose(lyapunov, expected[1], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(megno, expected[0], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("name", RANDOM)
def test_variation_is_the_difference_of_two_neighbours(name):
    """By differences of the state's slope: d(slope) for a change of the state made of a tangent vector."""
    system, rng = SYSTEMS[name], np.random.default_rng(5)
    equations = system.equations
    points = RANDOM[name](rng, 30)
    # Kernels hold for the units of `scaled` only.
    state, constants = map(
        np.array, equations.scaled(system.initial_state(points), system.constants(points), 0.7)
    )
    module = plain_module(equations, "rk8", of=tangent)
    v = rng.normal(size=(augmented.tangent_size(equations), 30))

    def displacement(state, v):
        if name == "fixed_point":
            return v
        return np.concatenate([v[:3], cross(state[3:6], v[3:]), cross(state[6:], v[3:])])

    slope, v_slope = (
        np.array(equations.rhs(state, constants)),
        np.array(module.variation(state, constants, v)),
    )
    h = 1e-6
    forward, backward = (
        np.array(equations.rhs(state + sign * h * displacement(state, v), constants)) for sign in (1, -1)
    )
    expected = (forward - backward) / (2 * h)
    # d/dt of the displacement along the motion, by the same differences
    moved = [displacement(state + sign * h * slope, v + sign * h * v_slope) for sign in (1, -1)]
    np.testing.assert_allclose((moved[0] - moved[1]) / (2 * h), expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("name", RANDOM)
def test_starts_have_norm_1_and_leave_the_constraints_satisfied(name):
    points = RANDOM[name](np.random.default_rng(0), 10)
    state = SYSTEMS[name].initial_state(points)
    v = augmented.tangent_start(SYSTEMS[name].equations, state)
    assert v.shape == (6, 10)
    np.testing.assert_allclose((v * v).sum(0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(v[0] / v[1], -1.25, rtol=1e-14)
    if name == "fixed_point":
        np.testing.assert_allclose((v[3:] * state[3:]).sum(0), 0.0, atol=1e-14)
    else:
        np.testing.assert_allclose(v[3] / v[0], 0.6, rtol=1e-14)


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("name", RANDOM)
def test_plain_and_compiled_kernels_agree(name):
    points = RANDOM[name](np.random.default_rng(7), 3)
    plain = plain_module(SYSTEMS[name].equations, "rk8", of=tangent)
    actual = indicators(name, points, 2.0, kernel=plain)
    np.testing.assert_allclose(actual, indicators(name, points, 2.0), rtol=1e-11, atol=1e-12)


def test_results_do_not_depend_on_threads_neighbours_or_how_a_run_is_cut(monkeypatch):
    points = random_satellites(np.random.default_rng(2), 70)
    whole = indicators("satellite", points, 20.0)
    alone = indicators("satellite", select(points, [41]), 20.0)
    np.testing.assert_array_equal(np.array(alone)[:, 0], np.array(whole)[:, 41])
    monkeypatch.setattr(blocks, "CHUNK", 1000)
    np.testing.assert_array_equal(indicators("satellite", points, 20.0, threads=2), whole)


def test_the_drawdown_is_the_largest_decrease():
    sums = np.zeros((len(tangent.Growth), 1))
    for i, log_growth in enumerate((1.0, 2.0, -3.0, 1.5, -2.0, 4.0)):
        tangent.add_stretch(sums, 0, log_growth, 1, i + 1)
    assert sums[[tangent.Growth.LOG_GROWTH, tangent.Growth.HIGHEST, tangent.Growth.DRAWDOWN], 0].tolist() == [
        3.5,
        3.5,
        3.5,
    ]


def test_runs_go_on_where_they_ended():
    points, system = random_satellites(np.random.default_rng(8), 20), SYSTEMS["satellite"]
    ensemble, unit = Ensemble.of(system, points), tangent_runs.rate_unit(system, points)
    steps = tangent_runs.TangentSteps.of(ensemble.frequency_bound, np.full(20, 15.0), None, 10**9)
    separation = tangent_runs.Separation(system, tangent_kernel(system), ensemble, steps, unit)
    separation.integrate()
    first = separation.lyapunov
    separation.integrate(np.arange(0, 20, 2))
    np.testing.assert_array_equal(separation.lyapunov[1::2], first[1::2])
    expected = indicators("satellite", points, 30.0)
    for actual, values in zip((separation.megno, separation.lyapunov), expected, strict=True):
        np.testing.assert_allclose(actual[::2], values[::2], rtol=1e-3, atol=1e-5)


@pytest.mark.long
def test_terms_that_vanish_may_be_left_out():
    zero = dict.fromkeys(("mu1", "mu2", "mu3", "k1", "k2", "k3"), 0.0)
    points = random_satellites(np.random.default_rng(4), 8, **zero)
    system = SYSTEMS["satellite"]
    special = tangent_kernel(system, specialization_of(system, points))
    actual = indicators("satellite", points, 10.0, kernel=special)
    np.testing.assert_allclose(actual, indicators("satellite", points, 10.0), rtol=1e-9, atol=1e-11)


def test_the_unit_of_time_does_not_matter():
    """A satellite in an orbit ten times slower moves alike in ten times the time."""
    points = random_satellites(np.random.default_rng(6), 5, Omega=1.0)
    slow = dict(points)
    for name in ("Omega", "n", "m", "theta_dot0", "k1", "k2", "k3", "mu1", "mu2", "mu3"):
        slow[name] = points[name] / 10
    for name in ("h1", "h3"):
        slow[name] = points[name] / 10
    slow |= {name: points[name] / 100 for name in DRAG}
    megno, lyapunov = indicators("satellite", points, 12.0)
    slow_megno, slow_lyapunov = indicators("satellite", slow, 120.0)
    np.testing.assert_allclose(slow_megno, megno, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slow_lyapunov, lyapunov / 10, rtol=1e-9, atol=1e-10)
