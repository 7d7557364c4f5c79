"""Sums of linear deviations from steady motions, against nonlinear motions and the kernel in plain Python."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import select
from test_offsets import TOLERANCES, near_families

from atlas.engine import assemble, blocks, deviation
from atlas.engine.deviation import Deviation
from atlas.label import offsets
from atlas.systems import SYSTEMS

ANGLE = TOLERANCES.angle


def sums_of(name, points, steps, duration, threads=1):
    """The sums, motions and frequency bounds of some points."""
    system = SYSTEMS[name]
    bound = system.frequency_bound(points)
    motions = offsets._SteadyMotions.of(system, points, bound, ANGLE)
    count = bound.size
    steps = np.broadcast_to(steps, count).astype(np.int64)
    with np.errstate(divide="ignore"):  # where the third axis is on the vertical
        sums = offsets._integrate(motions, bound, steps, duration / steps, ANGLE, threads, lambda: None)
    return sums, motions, bound


def nonlinear_means(name, points, i, steps, duration):
    """Means over the nodes of a nonlinear motion, and extremes of theta, by DOP853."""
    system = SYSTEMS[name]
    one = select(points, i)
    constants = system.constants(one)[:, 0]
    run = solve_ivp(
        lambda _, y: system.equations.rhs(y, constants), (0, duration), system.initial_state(one)[:, 0], "DOP853",
        t_eval=np.linspace(0, duration, steps + 1), rtol=1e-13, atol=1e-14,
    )  # fmt: skip
    u1, u2, u3, g1, g2, g3 = np.array(system.equations.frame_motion(run.y, constants[:, None]))
    theta = np.arctan2(np.hypot(g1, g2), g3)
    _, n, m = system.steady_rates(one)
    psi_dot = (u1 * g1 + u2 * g2) / np.sin(theta) ** 2
    theta_dot = (u1 * g2 - u2 * g1) / np.sin(theta)
    normal_rate = u1 * g1 + u2 * g2 + u3 * g3 - (n + m * np.cos(theta[0]))
    return np.array(
        [
            np.sqrt((theta_dot**2).mean()),
            (psi_dot - n).mean(),
            np.sqrt(((psi_dot - n) ** 2).mean()),
            (u3 - psi_dot * g3 - m).mean(),
            np.sqrt(((u3 - psi_dot * g3 - m) ** 2).mean()),
            normal_rate.mean(),
            np.sqrt((normal_rate**2).mean()),
            theta.min(),
            theta.max(),
        ]
    )


def linear_means(sums, steps):
    """The same from the sums of the linear motions, (9, points)."""
    mean = sums / (steps + 1)
    rows = [np.sqrt(mean[Deviation.THETA_DOT_SQUARE])]
    for row in (Deviation.PSI_DOT, Deviation.PHI_DOT, Deviation.NORMAL_RATE):
        rows += [mean[row], np.sqrt(mean[row + 1])]
    extremes = sums[[Deviation.LARGEST_COTANGENT, Deviation.LEAST_COTANGENT]]
    return np.array([*rows, *np.arctan2(1.0, extremes)])


@pytest.mark.parametrize(("name", "each"), [("satellite", 4), ("fixed_point", 6)])
def test_sums_are_those_of_the_nonlinear_motions_to_first_order(name, each):
    """What remains is of second order in the deviation; the steps are so short that they do not matter."""
    points = near_families(name, np.random.default_rng(31), each)
    steps, duration = 500, 7.0
    sums, motions, bound = sums_of(name, points, steps, duration)
    largest = np.sqrt(sums[Deviation.LARGEST_SQUARE])
    near = offsets._near(motions, bound, np.full(bound.size, duration), TOLERANCES)
    near &= np.hypot(*motions.vertical[:2]) > 0.1
    assert near.sum() > 0.3 * near.size
    chosen = np.flatnonzero(near & (sums[Deviation.LINEAR] > 0) & (largest < 1e-3))
    assert chosen.size > 0.9 * near.sum()
    actual = linear_means(sums, steps)
    unit = np.fmax(bound, 1.0)
    for i in chosen[::2]:
        expected = nonlinear_means(name, points, i, steps, duration)
        error = 10.0 * largest[i] ** 2 + 1e-3 * largest[i] + 1e-11
        assert np.abs(actual[:, i] - expected).max() < unit[i] * error


@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
def test_plain_and_compiled_kernels_agree(name, monkeypatch):
    points = near_families(name, np.random.default_rng(8), 2)
    compiled = sums_of(name, points, 70, 3.0)[0]
    plain = assemble.plain_module(SYSTEMS[name].equations, "rk4", of=deviation)
    monkeypatch.setattr(offsets, "deviation_kernel", lambda _: plain)
    # Means of changes that cancel are small differences of rounded numbers.
    np.testing.assert_allclose(sums_of(name, points, 70, 3.0)[0], compiled, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
def test_sums_do_not_depend_on_threads_neighbours_or_order(name, monkeypatch):
    """To the bit, also in a block of runs of different lengths."""
    points = near_families(name, np.random.default_rng(9), 7)
    count = points["A"].size
    assert count > blocks.WIDTH
    steps, duration = 64 + 7 * np.arange(count), 4.0
    together = sums_of(name, points, steps, duration)[0]
    for i in range(0, count, 9):
        alone = sums_of(name, select(points, [i]), steps[i], duration)[0]
        np.testing.assert_array_equal(alone[:, 0], together[:, i])
    order = np.random.default_rng(1).permutation(count)
    monkeypatch.setattr(blocks, "CHUNK", 100)
    shuffled = sums_of(name, select(points, order), steps[order], duration, threads=2)[0]
    np.testing.assert_array_equal(shuffled, together[:, order])


def test_nodes_from_the_first_large_deviation_on_are_left_out():
    """A run that has left the linear range in 20 steps has the same sums after 400."""
    points = near_families("fixed_point", np.random.default_rng(3), 12)
    h, sums = 0.1, {}
    for steps in (20, 400):
        sums[steps] = sums_of("fixed_point", points, steps, h * steps)[0]
    early = sums[20][Deviation.LINEAR] == 0
    late = ~early & (sums[400][Deviation.LINEAR] == 0)
    assert early.any()
    assert late.any()
    np.testing.assert_array_equal(sums[400][:, early], sums[20][:, early])
    assert (sums[400][Deviation.LARGEST_SQUARE] <= deviation.LIMIT**2).all()
    assert np.isfinite(sums[400][: Deviation.LEAST_COTANGENT]).all()


def test_the_order_of_the_rates_decides_whether_a_system_is_described():
    equations = SYSTEMS["fixed_point"].equations
    assert offsets.describes(SimpleNamespace(equations=equations, rate_states=("p", "q", "r")))
    assert not offsets.describes(SimpleNamespace(equations=equations, rate_states=("q", "p", "r")))
    assert not offsets.describes(SimpleNamespace(equations=equations, rate_states=("p", "q")))
