"""Librations and rotations in the plane of the orbit: pitch, variation of its rate, and stability out of the plane."""

import json
import re

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from strategies import default_points, select
from truth import REFERENCE, monodromy_matrix

import atlas
from atlas.analysis.compare import report
from atlas.errors import BadInput
from atlas.extensions.plane.motions import PlaneMotions
from atlas.flags import Label, Regularity, Stability
from atlas.kernel import tangent
from atlas.kernel.blocks import Threads
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import tangent_kernel
from atlas.measure import tangent_runs
from atlas.systems.base import derived_values, families_of, rate_std, unsteady
from atlas.systems.satellite import SATELLITE
from atlas.systems.satellite.equations import rhs
from atlas.systems.satellite.initial import constants, initial_state

# A, B, C, k3, h3 mu3, psi0, m, growth rate; the largest rho is about 3, 3, -2.8, -1e13, -5e15 and 1e42.
MONODROMY = (
    (1.0, 1.2, 0.7, -2.0, 0.0, 0.4, 0.3, 0.19180441161647588),
    (1.0, 1.3, 1.6, -1.25, 0.0, 0.0, 1.5, 0.23649161154432527),
    (0.61, 1.11, 1.27, -1.1, 0.0, 1.216, -1.1, 0.09958912179409397),
    (0.87, 1.16, 1.25, -1.0, 6.5, 1.217, 0.0, 2.4655832959599087),
    (0.68, 1.02, 1.25, -0.6, 4.7, 1.468, 0.0, 2.1955650345717523),
    (0.84, 0.95, 1.23, 0.1, 9.0, 1.508, 0.0, 2.9953033627384813),
)
# A, B, C, k3, h3 mu3, psi0, m, t, s
TRACES = (
    (1.51, 1.52, 1.73, -1.8, 1.25, -3.26, 2.64, -1.5374027901652949, 2.516629707257922),
    (1.37, 1.34, 1.77, 0.4, 0.0, -0.52, 0.44, -1.556047229786669, 2.3049179020203381),
    (1.67, 1.42, 1.11, -0.1, 0.0, 0.23, 1.62, -0.6391533884271059, -0.27201767415927625),
    (1.33, 1.0, 1.62, 0.3, 0.0, -2.74, -1.14, 0.98794884150861151, -3.6283037356198742),
    (1.42, 1.47, 1.95, 0.3, -1.02, -3.12, -1.5, 1.0876782884120539, -2.6410126369212366),
    (1.14, 0.96, 1.37, 0.6, 0.0, 2.1, 1.8, -0.2924721941736762, 0.27154163973209533),
)

ORACLE = json.loads((REFERENCE / "plane_motions.json").read_text())
LIBRATION, ROTATION = (families_of(SATELLITE)[f"plane_{kind}"] for kind in ("libration", "rotation"))


def motions_of(points):
    return PlaneMotions.of(SATELLITE.body(points), *SATELLITE.start(points))


def points_of(**given):
    """Points with these parameters, in arrays of one length."""
    return default_points("satellite", np.broadcast(*map(np.asarray, given.values())).size, **given)


def motions_of_rows(rows):
    """Motions with these A, B, C, k3, h3 mu3, psi0 and m."""
    return motions_of(
        points_of(**dict(zip(("A", "B", "C", "k3", "mu3", "psi0", "m"), rows, strict=True)), h3=1.0)
    )


def random_points(count, seed=0):
    """Bodies with rotor and magnet, upright and upside down, about both stable axes, librating and rotating."""
    rng = np.random.default_rng(seed)
    parts = rng.uniform(0.4, 1.0, (3, count))
    points = dict(zip("ABC", parts.sum(0) - parts, strict=True))
    points |= {name: rng.normal(size=count) for name in ("k3", "h3", "n", "m")}
    points |= {name: rng.uniform(-4, 4, count) for name in ("psi0", "phi0")}
    points |= {"mu3": rng.uniform(0, 1, count), "Omega": rng.uniform(0.5, 1.5, count)}
    return points_of(**points, theta0=np.where(np.arange(count) % 3, 0.0, np.pi))


def out_of_plane(matrix):
    """Trace and second coefficient of a block in w1, w2, a3, g1, g2, without the multiplier 1 of alpha.gamma."""
    t = np.trace(matrix) - 1
    return t, 0.5 * ((t + 1) ** 2 - np.trace(matrix @ matrix)) - t


def test_verified_motions():
    columns = {name: np.array([case[name] for case in ORACLE["cases"]]) for name in ORACLE["cases"][0]}
    points = points_of(
        **{name: columns[name] for name in ("A", "B", "C", "k3")},
        h3=columns["h3mu3"], mu3=1.0, psi0=columns["chi0"], m=columns["m0"],
    )  # fmt: skip
    names = ("plane_period", "plane_trace", "plane_second")
    derived = derived_values(SATELLITE, names, points, np.ones(columns["A"].size), lambda: None)
    for name in names:
        expected = columns[name.removeprefix("plane_")]
        np.testing.assert_allclose(derived[name], expected, rtol=0, atol=1e-9)
    flags, _ = SATELLITE.identify_family(points)
    kinds = np.where(columns["kind"] == "libration", LIBRATION.flag, ROTATION.flag)
    np.testing.assert_array_equal(flags, kinds)
    stable, growth = SATELLITE.linear_stability(points, flags)
    verdict = np.where(columns["stable"] == "stable", Stability.STABLE, Stability.UNSTABLE)
    np.testing.assert_array_equal(stable, verdict)
    np.testing.assert_allclose(growth, columns["growth_rate"], rtol=0, atol=1e-10)


def test_verified_borders_of_tongues():
    for entry in ORACLE["borders"]:
        body = {name: entry[name] for name in ("A", "B", "C", "k3")}
        for amplitude, rho in entry["borders"]:

            def excess(x, body=body, rho=rho):
                return motions_of(points_of(**body, psi0=[x])).multipliers()[0][0] - 2 - rho

            assert brentq(excess, amplitude - 1e-6, amplitude + 1e-6, xtol=1e-11) == pytest.approx(
                amplitude, abs=1e-8
            )
            stable, _ = motions_of(points_of(**body, psi0=amplitude + np.array([-1e-8, 1e-8]))).stability()
            assert sorted(stable) == [Stability.STABLE, Stability.UNSTABLE]


@pytest.mark.long
def test_multipliers_are_those_of_the_equations_of_motion():
    points = random_points(5, seed=4)
    motions = motions_of(points)
    assert motions.rotates.any()
    assert not motions.rotates.all()
    period, (t, s), (stable, growth) = motions.period(), motions.multipliers(), motions.stability()
    for i in range(5):
        point = select(points, i)
        matrix = monodromy_matrix(rhs, initial_state(point)[:, 0], constants(point)[:, 0], period[i])
        expected = out_of_plane(matrix[np.ix_([0, 1, 5, 6, 7], [0, 1, 5, 6, 7])])
        np.testing.assert_allclose([t[i], s[i]], expected, rtol=1e-7, atol=1e-7)
        rho = np.roots([1, -expected[0], expected[1] - 2])
        exponent = np.abs(np.arccosh(rho / 2 + 0j).real).max()
        assert growth[i] == pytest.approx(exponent / period[i], abs=1e-7)
        assert stable[i] == (Stability.UNSTABLE if exponent > 1e-4 else Stability.STABLE)
    assert set(stable) == {Stability.STABLE, Stability.UNSTABLE}


def exponent_of(t, s):
    """Logarithm of the largest multiplier of rho^2 - t rho + s - 2 = 0, in 50 digits."""
    half = mpmath.mpf(t) / 2
    root = mpmath.sqrt(half**2 - mpmath.mpf(s) + 2)
    return max(abs(mpmath.acosh((half + sign * root) / 2).real) for sign in (1, -1))


def unstable_motions(count, seed):
    """A third of them beside the separatrix and a third beside borders of stability; strong fields make multipliers large."""
    rng = np.random.default_rng(seed)
    points, kind = random_points(count, seed), np.arange(count) % 3
    points["mu3"] *= rng.choice([1, 10, 100], count)
    beside = kind == 1
    frequency = points["Omega"] * np.sqrt(3 * np.abs(points["B"] - points["A"]) / points["C"])
    distance = np.where(rng.random(count) < 0.5, -1, 1) * 10 ** rng.uniform(-8, -1, count)
    points["n"][beside] = 0.0
    points["m"][beside] = (frequency * (1 + distance))[beside]
    points["psi0"][beside] = ROTATION.solve["psi0"](points)[beside]
    part = select(points, np.flatnonzero(kind == 2))
    low, high = part["k3"], part["k3"] + rng.normal(size=part["k3"].size)
    first, last = (motions_of(part | {"k3": k3}).stability()[0] for k3 in (low, high))
    for _ in range(45):
        middle = 0.5 * (low + high)
        same = motions_of(part | {"k3": middle}).stability(rough=True)[0] == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    away = np.where(first == Stability.UNSTABLE, low - high, high - low)
    distance = np.sign(away) * 10 ** rng.uniform(-12, -2, low.size)
    points["k3"][kind == 2] = np.where(first != last, high + distance, high)
    stable, _ = motions_of(points).stability()
    return select(points, np.flatnonzero(stable == Stability.UNSTABLE))


@pytest.mark.long
def test_growth_is_that_of_the_multipliers():
    """To 1e-9, or 10 times what changes of the multipliers by 1e-15 make of it, with multipliers of either sign beyond 1e25."""
    points = unstable_motions(180, seed=8)
    motions = motions_of(points)
    (t, s), period, (_, growth) = motions.multipliers(), motions.period(), motions.stability()
    finite = np.flatnonzero(np.isfinite(t) & np.isfinite(s))
    assert finite.size > 80
    assert t[finite].min() < -1e25
    assert t[finite].max() > 1e25
    exponents = growth * period
    assert exponents.min() < 1e-3
    with mpmath.workdps(50):
        for i in finite:
            expected, changes = exponent_of(t[i], s[i]), (1 - mpmath.mpf("1e-15"), 1 + mpmath.mpf("1e-15"))
            change = max(abs(exponent_of(t[i] * a, s[i] * b) - expected) for a in changes for b in changes)
            assert abs(exponents[i] - expected) <= max(1e-9 * expected, 10 * change)


def test_growth_is_that_of_monodromy_matrices_in_many_digits():
    """Of Taylor series of the equations of motion in 80 digits."""
    *rows, growth = np.array(MONODROMY).T
    np.testing.assert_allclose(motions_of_rows(rows).stability()[1], growth, rtol=1e-11)
    *rows, t, s = np.array(TRACES).T
    np.testing.assert_allclose(motions_of_rows(rows).multipliers(), [t, s], rtol=1e-14, atol=1e-14)


def test_numbers_do_not_depend_on_the_other_points():
    points = random_points(70, seed=3)
    duration = np.full(70, 40.0)
    together = motions_of(points)
    numbers = np.array([*together.multipliers(), *together.stability(), together.rate_std(duration)])
    for i in range(0, 70, 3):
        alone = together.subset(np.array([i]))
        own = np.array([*alone.multipliers(), *alone.stability(), alone.rate_std(duration[:1])])
        np.testing.assert_array_equal(own[:, 0], numbers[:, i])


def test_multipliers_are_those_of_the_compiled_tangent_vectors():
    """Six tangent vectors over the period, and the block of those out of the plane."""
    points = random_points(4, seed=1)
    motions = motions_of(points)
    period, size = motions.period(), 4
    many = {name: np.repeat(values, 6) for name, values in points.items()}
    ensemble, duration = Ensemble.of(SATELLITE, many), np.repeat(period, 6)
    steps = tangent_runs.TangentSteps.of(ensemble.frequency_bound, duration, 0.01, 10**6)
    separation = tangent_runs.Separation(
        SATELLITE, tangent_kernel(SATELLITE), ensemble, steps, tangent_runs.rate_unit(SATELLITE, many)
    )
    separation.vectors[:] = np.tile(np.eye(6), size) / separation.weights
    separation.integrate(threads=Threads(1))
    columns = separation.vectors * separation.weights * np.exp(separation.sums[tangent.Growth.LOG_GROWTH])
    t, s = motions.multipliers()
    for i in range(size):
        matrix = columns[:, 6 * i : 6 * i + 6][np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
        second = 0.5 * (np.trace(matrix) ** 2 - np.trace(matrix @ matrix))
        np.testing.assert_allclose([t[i], s[i]], [np.trace(matrix), second], rtol=1e-8, atol=1e-8)


def test_tongues_of_symmetric_bodies_begin_where_frequencies_are_in_resonance():
    """At amplitude 0 the axis oscillates out of the plane at sqrt(4 - 3a), in it at sqrt(3 - 3a), a = A/B."""
    a = np.array([0.3, 0.7, 11 / 15, 0.8, 8 / 9, 0.95])
    motions = motions_of(points_of(A=a, B=1.0, C=1.0, psi0=1e-5))
    rho = 2 * np.cos(2 * np.pi * np.sqrt((4 - 3 * a) / (3 - 3 * a)))
    np.testing.assert_allclose(motions.multipliers()[0] - 2, rho, rtol=0, atol=1e-8)
    np.testing.assert_allclose(rho[[2, 4]], [-2, 2], rtol=0, atol=1e-12)
    stable, growth = motions_of(points_of(A=a[[0, 1, 3, 5]], B=1.0, C=1.0, psi0=1e-5)).stability()
    assert (stable == Stability.STABLE).all()
    assert not growth.any()


@pytest.mark.parametrize(("psi0", "m"), [(0.4, 0.0), (1.5707, 0.0), (0.3, 0.2), (0.0, 2.0), (0.4, -0.9)])
def test_pitch_is_an_elliptic_function(psi0, m):
    A, B, C, f = 1.0, 1.3, 1.2, np.sqrt(0.9 / 1.2)
    motions = motions_of(points_of(A=A, B=B, C=C, psi0=[psi0], m=m))
    square = mpmath.mpf(np.sin(psi0)) ** 2 + (m / mpmath.mpf(f)) ** 2
    period = (
        4 * mpmath.ellipk(square) / f
        if square < 1
        else 4 * mpmath.ellipk(1 / square) / f / mpmath.sqrt(square)
    )
    assert motions.period()[0] == pytest.approx(float(period), rel=1e-9)
    time = np.linspace(0, 25, 7)
    run = solve_ivp(
        lambda _, y: [y[1], -(f**2) * np.sin(y[0]) * np.cos(y[0])],
        (0, 25), [psi0, m], "DOP853", t_eval=time, rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    pitch, rate = motions.pitch(time[:, None])
    np.testing.assert_allclose(np.array([pitch[:, 0], rate[:, 0]]), run.y, rtol=0, atol=1e-8)


def test_deviation_of_the_rate_is_that_of_the_exact_pitch():
    points = random_points(12, seed=2)
    motions, duration = motions_of(points), np.random.default_rng(3).uniform(0.1, 30, 12)
    nodes, weights = np.polynomial.legendre.leggauss(600)
    rates = motions.pitch(0.5 * duration * (nodes[:, None] + 1))[1]
    means = [0.5 * weights @ rates**power for power in (1, 2)]
    expected = np.sqrt(means[1] - means[0] ** 2)
    np.testing.assert_allclose(motions.rate_std(duration), expected, rtol=0, atol=1e-7)


def test_deviation_of_small_librations_and_fast_rotations():
    """f a / sqrt(2) and f^2 / (sqrt(32) m), f^2 = 3 (B - A)/C, with all their digits."""
    sizes = 10.0 ** np.arange(-3, -9, -1)
    zero, whole = np.zeros(6), np.full(6, np.inf)
    small = motions_of(points_of(A=1.0, B=1.3, C=1.2, psi0=sizes)).rate_std(whole)
    np.testing.assert_allclose(small, np.sqrt(0.75 / 2) * sizes, rtol=1e-6)
    fast = motions_of(points_of(A=1.0, B=1.3, C=1.2, psi0=zero, m=1 / sizes)).rate_std(whole)
    np.testing.assert_allclose(fast, 0.75 / np.sqrt(32) * sizes, rtol=1e-6)


@pytest.mark.usefixtures("whole_kernels")
def test_predicted_labels_are_the_measured_ones():
    """Librations and rotations of which the rate varies by a little more or less than the tolerance."""
    factor = np.array([0.9, 0.99, 1.01, 1.1])
    points = points_of(
        A=1.0, B=1.3, C=1.2, psi0=np.r_[factor * 1e-3 / np.sqrt(0.375), np.zeros(4), 1.2, 0.0],
        m=np.r_[np.zeros(4), 0.75e3 / np.sqrt(32) / factor, 0.0, 1.5],
    )  # fmt: skip
    period = motions_of(points).period()
    ds = atlas.label_points("satellite", points, duration=20 * period, tolerance=1e-9, rate_tolerance=1e-3)
    np.testing.assert_allclose(
        ds.normal_rate_std, rate_std(SATELLITE, points, ds.family.values, 20 * period), atol=1e-8
    )
    steady, drifting = Label.PERMANENT_ROTATION, Label.DRIFTING
    expected = [steady, steady, drifting, drifting, steady, steady, drifting, drifting, drifting, drifting]
    np.testing.assert_array_equal(ds.predicted, expected)
    for measured, predicted in (("label", "predicted"), ("label_inertial", "predicted_inertial")):
        np.testing.assert_array_equal(ds[measured], ds[predicted])


def test_where_the_period_is_too_long_nothing_is_said():
    """Within rounding of the separatrix, and of bodies on which gravity has next to no torque; beside both the multipliers decide."""
    f = np.sqrt(0.9 / 1.2)
    rate = f * np.array([1 - 1e-15, 1 + 1e-15, 1 - 1e-6, 1 + 1e-6])
    stable, growth = motions_of(points_of(A=1.0, B=1.3, C=1.2, m=rate)).stability()
    assert (stable[:2] == Stability.UNKNOWN).all()
    assert np.isnan(growth[:2]).all()
    assert (stable[2:] != Stability.UNKNOWN).all()
    slow = points_of(A=1.0, B=1.0 + np.array([1e-4, 1e-8]), C=1.2, psi0=1.0)
    stable, _ = motions_of(slow).stability()
    np.testing.assert_array_equal(stable == Stability.UNKNOWN, [False, True])


def test_conditions_and_solvers():
    on = dict(A=[1.3], B=1.0, C=1.2, k3=0.3, mu3=0.5, h3=0.2, psi0=1.2, phi0=0.4, theta0=np.pi, n=0.3, m=0.2)
    assert SATELLITE.identify_family(points_of(**on))[0] == LIBRATION.flag
    assert SATELLITE.identify_family(points_of(**on | {"m": 3.0}))[0] == ROTATION.flag
    for change in (
        {"B": 1.3},
        {"k1": 0.1},
        {"mu1": 0.1},
        {"h1": 0.1},
        {"damping": 0.1},
        {"Omega": 0.0},
        {"theta0": 0.1},
    ):
        assert not unsteady(SATELLITE, SATELLITE.identify_family(points_of(**on | change))[0]).any()
    solved = points_of(**on)
    solved["psi0"] = LIBRATION.solve["psi0"](solved)
    motions = motions_of(solved)
    assert motions.sine == pytest.approx(0, abs=1e-15)
    assert abs(solved["psi0"] - 1.2) < np.pi / 2
    solved = points_of(**on)
    solved["m"] = LIBRATION.solve["m"](solved)
    assert motions_of(solved).start_rate == pytest.approx(0, abs=1e-15)
    solved["theta0"] = LIBRATION.solve["theta0"](solved | {"theta0": np.array([3.0])})
    assert solved["theta0"] == np.pi


SCENE = """
schema = 1
system = "satellite"
[fixed]
A = 1.0
B = 1.3
C = 1.6
[axes.k3]
values = [-0.5, 0.4, 1.5]
[axes.psi0]
from = 0.2
to = 1.4
count = 4
[family]
name = "plane_libration"
solve = ["m"]
[integration]
duration = "100 orbits"
method = "rk8"
tolerance = 1e-4
[labels]
rate_tolerance = 1e-3
[outputs]
variables = ["label", "predicted", "regularity", "lyapunov", "family", "stable", "growth_rate", "end_time", "plane_period"]
"""


@pytest.mark.long
@pytest.mark.usefixtures("whole_kernels")
def test_a_scene_compares_stability_with_regularity(tmp_path):
    ds = atlas.run(atlas.load_scene(SCENE), progress=False)
    assert (ds.predicted == Label.DRIFTING).all()
    assert (ds.family == LIBRATION.flag).all()
    np.testing.assert_allclose(ds.plane_period.values.std(0), 0, atol=1e-12)  # whatever the rotor is
    unstable = ds.stable == Stability.UNSTABLE
    assert not (unstable & (ds.regularity == Regularity.REGULAR) & (ds.growth_rate * ds.end_time > 12)).any()
    assert not (~unstable & (ds.regularity == Regularity.HYPERBOLIC)).any()
    assert not (ds.regularity == Regularity.CHAOTIC).any()
    seen = (ds.regularity == Regularity.HYPERBOLIC).values
    assert seen.sum() > 3
    np.testing.assert_allclose(ds.lyapunov.values[seen] / ds.growth_rate.values[seen], 1, atol=0.1)
    text = report(ds)
    assert "motions in the plane, stability out of it" in text
    assert re.search(rf"^unstable .*\b{seen.sum()}\b", text, re.M)
    assert "linearly stable points that drift: 0" in text
    assert "lyapunov / growth_rate of hyperbolic ones: " in text
    assert "motions in the plane" not in report(ds.drop_vars("lyapunov"))


def test_a_scene_of_a_symmetric_body_has_no_motion_of_the_family():
    with pytest.raises(BadInput, match="it needs A != B, which fails"):
        atlas.run(atlas.load_scene(SCENE.replace("B = 1.3", "B = 1.0")), progress=False)
