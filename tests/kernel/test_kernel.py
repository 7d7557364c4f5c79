"""The kernel, compiled and as plain Python: order, exact motions, statistics, and independence of neighbours."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from plain_kernel import plain_module
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk
from strategies import RANDOM

from atlas.kernel import blocks
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.statistics import finish
from atlas.kernel.tableaux import METHODS
from atlas.systems import SYSTEMS

SATELLITE = SYSTEMS["satellite"]


@pytest.fixture(params=["compiled", "plain"])
def module_of(request):
    """(system, method) -> kernel module, compiled or interpreted; `test_the_compiled_kernel_is_the_python_one` compares both."""
    if request.param == "compiled":
        return kernel
    return lambda system, method: plain_module(system.equations, method)


def satellites(count: int, seed: int = 0, **given) -> dict[str, np.ndarray]:
    """Random satellites in gentle motion, without damping."""
    rng = np.random.default_rng(seed)
    names = [name for name in SATELLITE.parameters if name != "damping"]
    points = {name: rng.normal(size=count) * 0.4 for name in names} | {"damping": np.zeros(count)}
    points |= {name: rng.uniform(1, 1.4, count) for name in ("A", "B")}
    points |= {"C": rng.uniform(0.6, 1.9, count), "Omega": rng.uniform(0.5, 1.5, count)}
    points |= {"theta0": rng.uniform(0.2, 2.9, count)}
    return points | {name: np.full(count, float(value)) for name, value in given.items()}


def integrate(
    module,
    points,
    steps,
    duration,
    *,
    system=SATELLITE,
    threads=1,
    steps_per_sample=1,
    cylinder=1e-5,
    progress=lambda work: None,
):
    """Statistics and final state of points with the given numbers of steps."""
    ensemble = Ensemble.of(system, points)
    steps = np.broadcast_to(steps, (ensemble.size,)).astype(np.int64)
    schedule = blocks.pack_blocks(steps, np.full(ensemble.size, steps_per_sample))
    arrays = ensemble.arrays(module, duration / steps, cylinder)
    blocks.integrate(module, schedule, arrays, threads=blocks.Threads(threads, progress))
    measured = finish(arrays.sums, steps // steps_per_sample, np.full(ensemble.size, duration))
    return measured, arrays.state[: len(ensemble.state)]


def reference(points, i, duration):
    """Final state of satellite i by DOP853, its dense output and the constants."""
    state, constants = SATELLITE.initial_state(points)[:, i], SATELLITE.constants(points)[:, i]
    solution = solve_ivp(
        lambda t, y: SATELLITE.equations.rhs(y, constants), (0, duration), state, "DOP853", rtol=1e-13, atol=1e-14,
        dense_output=True,
    )  # fmt: skip
    return solution.y[:, -1], solution.sol, constants


def test_orders_of_the_methods():
    points, duration = satellites(6), 6.0
    exact = np.stack([reference(points, i, duration)[0] for i in range(6)], axis=1)
    for method, coarse in (("rk4", 160), ("rk8", 40)):
        module = kernel(SATELLITE, method)
        errors = [np.abs(integrate(module, points, coarse * k, duration)[1] - exact).max() for k in (1, 2)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(METHODS[method].order, abs=0.35)


def test_planar_libration_is_a_jacobi_function():
    """Theta = 0 stays, the body librates about the radius: chi'' + 3 (B - A)/C Omega^2 sin chi cos chi = 0."""
    A, B, C, Omega, rate = 1.0, 1.3, 1.1, 0.9, 0.4
    points = satellites(1, A=A, B=B, C=C, Omega=Omega, m=rate, n=0, theta0=0, psi0=0, phi0=0, theta_dot0=0, k1=0, k2=0,
                        mu1=0, mu2=0, mu3=0, h1=0, h3=0, drag1=0, drag2=0, drag3=0)  # fmt: skip
    q, duration = Omega * np.sqrt(3 * (B - A) / C), 12.0
    k = rate / q
    assert k < 1
    steps = 300  # rk8: 2e-10 from the exact motion
    _, state = integrate(kernel(SATELLITE, "rk8"), points, steps, duration)
    sn, _, _, _ = ellipj(q * duration, k * k)
    chi = np.arcsin(k * sn)  # alpha = (cos chi, -sin chi, 0), starting at chi = 0 with chi' = rate
    assert ellipk(k * k) / q < duration
    np.testing.assert_allclose(state[3:6, 0], [np.cos(chi), -np.sin(chi), 0.0], atol=2e-10)


@pytest.fixture(scope="module")
def tilted():
    """Four satellites that stay away from the vertical, a duration, and their statistics and final states by a tight reference."""
    points, duration = satellites(60, seed=3), 8.0
    coarse, _ = integrate(kernel(SATELLITE, "rk4"), points, 200, duration)
    members = np.flatnonzero((coarse["theta_min"] > 0.5) & (coarse["theta_max"] < 2.6))[:4]
    assert members.size == 4
    points = {name: values[members] for name, values in points.items()}
    exact, names = [], ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
    nodes, weights = np.polynomial.legendre.leggauss(400)
    for i in range(4):
        end, sol, constants = reference(points, i, duration)
        t = 0.5 * duration * (nodes + 1)
        u1, u2, u3, g1, g2, g3 = SATELLITE.equations.frame_motion(sol(t), constants)
        s2 = g1**2 + g2**2
        psi_dot = (u1 * g1 + u2 * g2) / s2
        rates = ((u1 * g2 - u2 * g1) / np.sqrt(s2), psi_dot, u3 - psi_dot * g3, u1 * g1 + u2 * g2 + u3 * g3)
        statistics = {}
        for name, values in zip(names, rates, strict=True):
            mean, square = 0.5 * weights @ values, 0.5 * weights @ values**2
            statistics |= {f"{name}_mean": mean, f"{name}_std": np.sqrt(square - mean**2)}
            statistics |= {f"{name}_rms": np.sqrt(square)}
        cosines = sol(np.linspace(0, duration, 40001))[8]
        statistics |= {
            "theta_min": np.arccos(cosines.max()),
            "theta_max": np.arccos(cosines.min()),
            "state": end,
        }
        exact.append(statistics)
    return points, duration, exact


@pytest.mark.parametrize(
    ("method", "counts", "sampling", "limit"),
    [("rk4", (320, 640), {"steps_per_sample": 4}, 1e-5), ("rk8", (48, 96), {}, 1e-6)],
)
def test_statistics_are_as_good_as_the_states(tilted, method, counts, sampling, limit):
    """Means, standard deviations and extremes against a tight reference at two steps: as accurate as the states."""
    points, duration, exact = tilted
    errors = []
    for count in counts:
        measured, state = integrate(kernel(SATELLITE, method), points, count, duration, **sampling)
        measured["state"] = state.T
        errors.append(
            {name: max(np.abs(measured[name][i] - exact[i][name]).max() for i in range(4))
             for name in exact[0] if name in measured}
        )  # fmt: skip
    order, ratio = METHODS[method].order, np.log(counts[1] / counts[0])
    assert max(errors[0].values()) < limit
    rates = [max(v for k, v in e.items() if "theta_m" not in k and k != "state") for e in errors]
    assert np.log(rates[0] / rates[1]) / ratio > order - 0.7
    assert max(errors[1]["theta_min"], errors[1]["theta_max"]) < 1e-6
    assert rates[1] < 3 * errors[1]["state"]


@pytest.mark.usual("compiled")
def test_results_do_not_depend_on_threads_blocks_or_neighbours(module_of):
    points, module = satellites(40, seed=5), module_of(SATELLITE, "rk4")
    steps = np.random.default_rng(1).choice([16, 32, 48], 40)
    statistics, state = integrate(module, points, steps, 3.0)
    for threads, order in ((2, np.arange(40)), (1, np.arange(40)[::-1]), (3, np.arange(0, 40, 7))):
        subset = {name: values[order] for name, values in points.items()}
        repeated, final = integrate(module, subset, steps[order], 3.0, threads=threads)
        np.testing.assert_array_equal(final, state[:, order])
        for name, values in repeated.items():
            np.testing.assert_array_equal(values, statistics[name][order], err_msg=name)


@pytest.mark.parametrize(
    ("threads", "steps", "elsewhere"), [(None, 64, False), (None, 4096, True), (2, 64, True)]
)
def test_threads_are_started_for_many_steps_and_where_they_are_asked_for(threads, steps, elsewhere):
    """A kernel that has been called: one that may be compiled is called in a thread."""
    points, module, identities = satellites(40, seed=5), kernel(SATELLITE, "rk4"), set()
    integrate(module, points, 16, 3.0)
    assert module.integrate.signatures
    integrate(
        module, points, steps, 3.0, threads=threads, progress=lambda _: identities.add(threading.get_ident())
    )
    assert identities
    assert (threading.get_ident() not in identities) == elsewhere


def test_nan_and_overflow_stay_visible(module_of):
    points = satellites(3, seed=6)
    points["k1"][1] = 1e200
    statistics, state = integrate(module_of(SATELLITE, "rk4"), points, 64, 3.0)
    assert np.isfinite(state[:, [0, 2]]).all()
    assert not np.isfinite(state[:, 1]).all()
    assert np.isfinite(statistics["theta_dot_rms"][[0, 2]]).all()


@pytest.mark.usual("rk4")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda system: system.name)
def test_the_compiled_kernel_is_the_python_one(system, method):
    """Through the vertical, too, where sums are corrected for poles; the compiler may fuse multiply and add."""
    points = RANDOM[system.name](np.random.default_rng(7), 20)
    points["theta0"][:6], points["theta_dot0"][:6] = 0.3, -0.5
    sampling = {"steps_per_sample": 1 if method == "rk8" else 2}
    compiled, plain = (
        integrate(module, points, 48, 2.0, system=system, **sampling)
        for module in (kernel(system, method), plain_module(system.equations, method))
    )
    np.testing.assert_allclose(compiled[1], plain[1], rtol=1e-11, atol=1e-12)
    for name, values in compiled[0].items():
        np.testing.assert_allclose(values, plain[0][name], rtol=1e-8, atol=1e-9, err_msg=name)


@pytest.mark.usual("compiled", "plain-0.3-rk4")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_an_interrupted_run_has_the_bits_of_a_whole_one(module_of, method, damping):
    points = satellites(5, seed=8, damping=damping)
    ensemble, module = Ensemble.of(SATELLITE, points), module_of(SATELLITE, method)
    schedule = blocks.pack_blocks(np.full(5, 32), np.ones(5, np.int64))
    whole, cut = (ensemble.arrays(module, np.full(5, 0.05), 1e-5) for _ in range(2))
    blocks.integrate(module, schedule, whole, threads=blocks.Threads(1))
    first, cut = np.zeros_like(schedule.nodes), blocks.resumable(module, cut)
    for last in (1, 2, 5, 20, int(schedule.nodes[0])):
        segment = first, np.full_like(first, last)
        blocks.integrate(module, schedule, cut, segment=segment, threads=blocks.Threads(1))
        first = segment[1]
    np.testing.assert_array_equal(cut.state, whole.state)
    np.testing.assert_array_equal(cut.sums, whole.sums)
    assert np.all((whole.state[9] > 0) == (damping > 0))  # what the Jacobi integral has lost


def test_a_long_run_takes_many_short_calls(monkeypatch):
    """Ctrl-C waits for one call, however long a run is; the bits are those of a single call."""
    module, ensemble = kernel(SATELLITE, "rk4"), Ensemble.of(SATELLITE, satellites(40, seed=3))
    schedule = blocks.pack_blocks(np.r_[np.full(35, 640), np.full(5, 16)], np.full(40, 2))
    whole, arrays = (ensemble.arrays(module, np.full(40, 0.01), 1e-5) for _ in range(2))
    calls, progress = [], []
    blocks.integrate(module, schedule, whole, threads=blocks.Threads(1))

    def integrate_counted(*call_arguments):
        calls.append(call_arguments[2:4])
        module.integrate(*call_arguments)

    monkeypatch.setattr(blocks, "CHUNK", 64 * blocks.WIDTH)
    counted = SimpleNamespace(**{**vars(module), "integrate": integrate_counted})
    blocks.integrate(counted, schedule, arrays, threads=blocks.Threads(2, progress.append))
    assert len(calls) == len(progress) == 2 * 10 + 1  # two blocks of 640 steps, one of 16
    assert sum(progress) == schedule.point_steps
    np.testing.assert_array_equal(arrays.state, whole.state)
    np.testing.assert_array_equal(arrays.sums, whole.sums)
