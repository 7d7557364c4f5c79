"""The engine: order, sameness, statistics as good as the states, and a cache that is never stale."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipj, ellipk

import atlas
from atlas.engine import blocks, jit, measure, stepsize, template
from atlas.engine.tableaux import METHODS
from atlas.label.pipeline import kernel
from atlas.systems import SYSTEMS

SATELLITE = SYSTEMS["satellite"]


def points(count: int, seed: int = 0, **given) -> dict[str, np.ndarray]:
    """Random satellites: every parameter drawn, then those given."""
    rng = np.random.default_rng(seed)
    found = {name: rng.normal(size=count) * 0.4 for name in SATELLITE.parameters}
    found |= {
        "A": rng.uniform(1, 1.4, count),
        "B": rng.uniform(1, 1.4, count),
        "C": rng.uniform(0.6, 1.9, count),
    }
    found |= {"Omega": rng.uniform(0.5, 1.5, count), "theta0": rng.uniform(0.2, 2.9, count)}
    return found | {name: np.full(count, float(value)) for name, value in given.items()}


def integrate(p, counts, duration, *, method="rk4", threads=1, stride=1, parts=1, cylinder=1e-5):
    """(measured, final state) of points with the given numbers of steps."""
    counts = np.broadcast_to(counts, p["A"].shape).astype(np.int64)
    strides, pieces = np.full(counts.shape, stride), np.full(counts.shape, parts)
    state, constants = (
        np.ascontiguousarray(SATELLITE.initial_state(p)),
        np.ascontiguousarray(SATELLITE.constants(p)),
    )
    scales = measure.scales(SATELLITE.equations, state, constants, SATELLITE.integral_scales(p))
    out = blocks.integrate(
        kernel(SATELLITE, method), blocks.pack_blocks(counts, strides, pieces), duration / counts, state, constants, scales,
        cylinder, threads=threads,
    )  # fmt: skip
    return measure.finish(out, counts // strides * parts, parts), state


def reference(p, i, duration):
    """Final state of point i by DOP853, and its trajectory."""
    state, constants = SATELLITE.initial_state(p)[:, i], SATELLITE.constants(p)[:, i]
    solved = solve_ivp(
        lambda t, y: SATELLITE.equations.rhs(y, constants), (0, duration), state, "DOP853", rtol=1e-13, atol=1e-14,
        dense_output=True,
    )  # fmt: skip
    return solved.y[:, -1], solved.sol, constants


@pytest.mark.parametrize("method", METHODS)
def test_order_of_the_method(method):
    p, duration = points(6), 6.0
    exact = np.stack([reference(p, i, duration)[0] for i in range(6)], axis=1)
    order = METHODS[method].order
    coarse = 160 if order == 4 else 40
    errors = [np.abs(integrate(p, coarse * k, duration, method=method)[1] - exact).max() for k in (1, 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


def test_planar_libration_is_a_jacobi_function():
    """Theta = 0 stays, the body librates about the radius: chi'' + 3 (B - A)/C Omega^2 sin chi cos chi = 0."""
    A, B, C, Omega, rate = 1.0, 1.3, 1.1, 0.9, 0.4
    p = points(1, A=A, B=B, C=C, Omega=Omega, m=rate, n=0, theta0=0, psi0=0, phi0=0, theta_dot0=0, k1=0, k2=0,
               mu1=0, mu2=0, mu3=0, h1=0, h3=0)  # fmt: skip
    q, duration = Omega * np.sqrt(3 * (B - A) / C), 12.0
    k = rate / q
    assert k < 1
    _, state = integrate(p, 3000, duration)
    sn, _, _, _ = ellipj(q * duration, k * k)
    chi = np.arcsin(k * sn)  # alpha = (cos chi, -sin chi, 0), starting at chi = 0 with chi' = rate
    assert ellipk(k * k) / q < duration
    np.testing.assert_allclose(state[3:6, 0], [np.cos(chi), -np.sin(chi), 0.0], atol=2e-10)


@pytest.mark.parametrize(
    ("method", "counts", "look", "limit"),
    [("rk4", (320, 640), {"stride": 4}, 1e-5), ("rk8", (32, 48), {"parts": 4}, 1e-6)],
)
def test_statistics_are_as_good_as_the_states(method, counts, look, limit):
    """Means, spreads and extremes against a tight reference at two steps: they fall as the states' errors do."""
    p, duration = points(60, seed=3), 8.0
    rough, _ = integrate(p, 200, duration)
    away = np.flatnonzero((rough["theta_min"] > 0.5) & (rough["theta_max"] < 2.6))[:4]
    assert away.size == 4
    p = {name: values[away] for name, values in p.items()}
    exact, names = [], ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
    for i in range(4):
        end, sol, constants = reference(p, i, duration)
        nodes, weights = np.polynomial.legendre.leggauss(400)
        t = 0.5 * duration * (nodes + 1)
        u1, u2, u3, g1, g2, g3 = SATELLITE.equations.frame_motion(sol(t), constants)
        s2 = g1**2 + g2**2
        psi_dot = (u1 * g1 + u2 * g2) / s2
        rates = ((u1 * g2 - u2 * g1) / np.sqrt(s2), psi_dot, u3 - psi_dot * g3, u1 * g1 + u2 * g2 + u3 * g3)
        found = {}
        for name, values in zip(names, rates, strict=True):
            mean, square = 0.5 * weights @ values, 0.5 * weights @ values**2
            found |= {f"{name}_mean": mean, f"{name}_std": np.sqrt(square - mean**2)}
            found |= {f"{name}_rms": np.sqrt(square)}
        heights = sol(np.linspace(0, duration, 40001))[8]
        found |= {"theta_min": np.arccos(heights.max()), "theta_max": np.arccos(heights.min()), "state": end}
        exact.append(found)
    errors = []
    for count in counts:
        measured, state = integrate(p, count, duration, method=method, **look)
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


def test_results_do_not_depend_on_threads_blocks_or_neighbours():
    p = points(100, seed=5)
    counts = np.random.default_rng(1).choice([32, 48, 64], 100)
    measured, state = integrate(p, counts, 3.0)
    for threads, order in ((2, np.arange(100)), (1, np.arange(100)[::-1]), (3, np.arange(0, 100, 7))):
        again, final = integrate({k: v[order] for k, v in p.items()}, counts[order], 3.0, threads=threads)
        np.testing.assert_array_equal(final, state[:, order])
        for name, values in again.items():
            np.testing.assert_array_equal(values, measured[name][order], err_msg=name)


def test_nan_and_overflow_stay_visible():
    p = points(3, seed=6)
    p["k1"][1] = 1e200
    measured, state = integrate(p, 64, 3.0)
    assert np.isfinite(state[:, [0, 2]]).all()
    assert not np.isfinite(state[:, 1]).all()
    assert np.isfinite(measured["theta_dot_rms"][[0, 2]]).all()


@given(st.integers(13, 200), st.integers(0, 7))
def test_gregory_weights_are_positive_and_exact_for_polynomials(intervals, degree):
    w = np.array([measure.weight(k, intervals, measure.WEIGHTS) for k in range(intervals + 1)])
    assert (w > 0).all()
    x = np.linspace(0, 1, intervals + 1)
    assert (w / intervals) @ x**degree == pytest.approx(1 / (degree + 1), rel=1e-12)


@given(st.floats(0, np.pi))
def test_theta_comes_back_at_both_poles_and_at_the_equator(theta):
    g = np.array([np.sin(theta), 0.0, np.cos(theta)])
    _, _, _, _, height, s2, _, _ = measure.sample((0.0, 0.0, 0.0, *g), 0.0)
    assert s2 == g[0] ** 2
    assert measure.tilt(np.asarray(height), np.asarray(s2)) == pytest.approx(theta, abs=5e-16, rel=1e-14)


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.integers(1, 4))
def test_between_the_steps_a_polynomial_of_seventh_degree_is_exact(coefficients, parts):
    polynomial = np.polynomial.Polynomial(coefficients)
    nodes = np.arange(4.0)
    values = np.r_[polynomial(nodes), polynomial.deriv()(nodes)]
    for case in range(3):
        for part in range(1, parts + 1):
            found = measure.between(4)[parts - 1, case, part - 1] @ values
            assert found == pytest.approx(polynomial(case + part / parts), abs=1e-12 * np.abs(values).max())


@pytest.mark.parametrize("samples", [9, 30, 400])
@pytest.mark.parametrize("place", [-1.3, 0.4, 6.7, 23.9, 24.1])
@pytest.mark.parametrize("height", [0.01, 0.3, 4.0])
def test_what_samples_make_of_a_pole(samples, place, height):
    """Beside the sums over all samples and integrals by quadrature; the same from both ends."""
    weights = np.array([measure.weight(k, samples, measure.WEIGHTS) for k in range(samples + 1)])
    k = np.arange(samples + 1.0)
    for z in (complex(place, height), complex(samples - place, height)):
        found = measure.lattice(z, samples, measure.WEIGHTS)
        for power, value in zip((1, 2), found, strict=True):
            inner = [x for x in (z.real - 5 * height, z.real, z.real + 5 * height) if 0 < x < samples]
            integral, _ = quad(
                lambda t, z=z, power=power: (t - z) ** -power, 0, samples, points=inner or None,
                complex_func=True, limit=500, epsabs=1e-11, epsrel=1e-12,
            )  # fmt: skip
            true = (weights * (k - z) ** -power).sum() - integral
            assert abs(value - true) < 1e-8 * (1 + abs(true))


def test_a_passage_without_a_pole_is_none():
    """A third axis at rest on the vertical, or beside it, has no zero to find: nothing is divided by 0."""
    texts = jit.functions(measure)
    names = ("weight", "_inverse", "_newton_form", "lattice", "passage")
    space: dict = {}
    exec(jit.HEADER + "\n".join(f"{jit.FUNCTION}\n{texts[name]}" for name in names), space)
    for height in (0.0, 1.0, np.nan, np.inf):
        forms = np.full((3, 8), height, complex)
        assert space["passage"](forms, 1, 100, 4, 400, measure.WEIGHTS, 0.0, 0.0, 0.0) == (0.0,) * 5


def test_a_turn_between_two_samples_is_found_to_the_fourth_order():
    """cos theta = 0.3 + 0.5 cos t, sampled about its maximum and its minimum."""
    errors = []
    for distance in (0.2, 0.1):
        worst = 0.0
        for turn, at in ((0.8, 0.0), (-0.2, np.pi)):
            t = at + distance * np.array([-0.3, 0.7])
            height, slope = 0.3 + 0.5 * np.cos(t), -0.5 * np.sin(t)
            s2 = 1 - height**2
            top, wide = measure.turning(distance, height[0], s2[0], -slope[0], height[1], s2[1], -slope[1])
            worst = max(worst, abs(top - turn), abs(wide - (1 - turn**2)))
        errors.append(worst)
    assert errors[0] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)
    monotone = 0.3 + 0.5 * np.cos([0.5, 0.7])
    assert measure.turning(0.2, monotone[0], 0.5, 0.2, monotone[1], 0.6, 0.3) == (monotone[1], 0.6)


@given(
    st.floats(1e-3, 1e4),
    st.floats(1e-3, 1e5),
    st.sampled_from([1e-4, 1e-6, 1e-8, 1e-10]),
    st.sampled_from(list(METHODS)),
)
def test_steps_follow_from_the_point_alone(bound, duration, tolerance, method):
    chosen = stepsize.choose(
        METHODS[method], np.array([bound, 1.0]), np.array([duration, 3.0]), tolerance=tolerance, step=None,
        max_steps=10**9,
    )  # fmt: skip
    alone = stepsize.choose(
        METHODS[method],
        np.array([bound]),
        np.array([duration]),
        tolerance=tolerance,
        step=None,
        max_steps=10**9,
    )
    assert chosen.count[0] == alone.count[0]
    assert chosen.count[0] % chosen.stride[0] == 0
    assert chosen.length[0] * chosen.count[0] == pytest.approx(duration, rel=1e-14)
    if chosen.count[0] < 10**9 // 2:
        assert chosen.phase_error[0] <= tolerance * (1 + 1e-9)


def test_a_given_step_is_kept():
    chosen = stepsize.choose(
        METHODS["rk4"], np.array([2.0]), np.array([10.0]), tolerance=1e-8, step=0.01, max_steps=10**8
    )
    assert chosen.length[0] <= 0.01
    assert chosen.length[0] > 0.0098
    assert chosen.step_ratio[0] == pytest.approx(chosen.length[0] * 2.0 / np.sqrt(8))


def test_stability_limit_on_the_imaginary_axis():
    """|R(iy)| <= 1 up to the limit in the table and > 1 beyond; phase and damping constants as y -> 0."""
    for method in METHODS.values():
        a = np.zeros((method.stages, method.stages))
        for i, row in enumerate(method.a):
            a[i, : len(row)] = row

        def amplification(y, a=a, method=method):
            b = np.array(method.b)
            return 1 + 1j * y * b @ np.linalg.solve(np.eye(len(b)) - 1j * y * a, np.ones(len(b)))

        inside = np.linspace(0.05, method.stability * (1 - 1e-6), 400)
        assert max(abs(amplification(y)) for y in inside) <= 1 + 1e-12
        assert abs(amplification(method.stability * 1.001)) > 1
        y = 0.1 if method.order == 4 else 0.6
        phase = abs(np.angle(amplification(y) * np.exp(-1j * y)))
        assert phase / y ** (method.order + 1) == pytest.approx(method.phase, rel=0.1)
        damping = 1 - abs(amplification(y))
        assert damping / y**method.damping_order == pytest.approx(method.damping, rel=0.1)


def test_an_edited_line_is_never_answered_by_a_stale_kernel(tmp_path):
    """A copy of the package, one sign of the right-hand side edited: the result must change; a comment must not."""
    shutil.copytree(
        Path(atlas.__file__).parent, tmp_path / "atlas", ignore=shutil.ignore_patterns("__pycache__")
    )
    code = (
        "import atlas; from atlas.label.pipeline import kernel_hash; from atlas.systems import SYSTEMS\n"
        "ds = atlas.label_points('satellite', dict(theta0=0.4, n=0.3, k3=0.2), duration=5.0, tolerance=1e-6)\n"
        "print(kernel_hash(SYSTEMS['satellite'], 'rk4'), float(ds.theta_dot_rms[0]).hex())"
    )

    def result() -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True,
            env={"PATH": "", "ATLAS_CACHE": str(tmp_path / "cache"), "HOME": str(tmp_path)},
        )  # fmt: skip
        return done.stdout.split()

    path = tmp_path / "atlas" / "systems" / "satellite" / "equations.py"
    original = path.read_text()
    first = result()
    assert result() == first
    path.write_text(original.replace("H1, H2, H3 =", "# a comment\n    H1, H2, H3 =", 1))
    assert result() == first
    edited = original.replace("- N * D1 * a2 * a3", "+ N * D1 * a2 * a3", 1)
    assert edited != original
    path.write_text(edited)
    changed = result()
    assert changed[0] != first[0]
    assert changed[1] != first[1]


def test_cache_that_cannot_be_written_compiles_in_memory(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("ATLAS_CACHE", str(blocked))
    source = jit.HEADER + "\n\n" + jit.KERNEL + "\ndef integrate(x):\n    return x + 1.0\n"
    with pytest.warns(UserWarning, match="compiling in memory"):
        module = jit.load(source)
    assert module.integrate(1.0) == 2.0


def test_cache_is_listed_and_cleared(tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path / "kernels"))
    source = jit.HEADER + "\n\n" + jit.KERNEL + "\ndef integrate(x):\n    return x + 2.0\n"
    assert jit.load(source).integrate(1.0) == 3.0
    assert len(jit.cached()) == 1
    assert jit.clear() == 1
    assert jit.cached() == []


def test_kernel_source_is_the_physics_as_written():
    source = template.source(SATELLITE.equations, "rk4")
    tree = ast.parse(source)
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert {"rhs", "frame_motion", "sample", "integrate", *SATELLITE.equations.INTEGRALS} <= names
    assert jit.digest(source) == jit.digest(source.replace("\n\n", "\n\n# note\n"))
