"""Systems with observables: statistics, labels and chaos against closed forms and scipy, and their atlases."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from numpy import cos
from plain_kernel import plain_module
from plugins import PENDULUM, PENDULUM_SCENE, registry
from scipy.integrate import simpson, solve_ivp
from strategies import evaluate

import atlas
from atlas import systems
from atlas.flags import Regularity, Status, Steadiness
from atlas.kernel import numeric_bound, observe, poles, sampling
from atlas.kernel.blocks import Threads
from atlas.kernel.ensemble import Ensemble
from atlas.kernel.specialization import kernel
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.measure import observables
from atlas.measure.instrument import Run
from atlas.scene.model import Settings
from atlas.systems import jacobian
from atlas.variables import variables

pytestmark = pytest.mark.usefixtures("whole_kernels")

METHOD = "rk8"


class Driven(systems.System):
    """An oscillator that is forced in time, which is a state: powers of its Jacobian do not contain the forcing.

    Linear and without damping by default.
    """

    class equations:
        STATE, CONSTANTS = ("x", "v", "t"), ("w", "force", "spring", "cubic", "damping")

        def rhs(state, constants):
            x, v, t = state
            w, force, spring, cubic, damping = constants
            return v, -spring * x - cubic * x * x * x - damping * v + force * cos(w * t), 1.0 + 0.0 * t

    name = title = "driven"
    parameters = {  # noqa: RUF012
        name: systems.Parameter(name, "1", name, default)
        for name, default in {"w": 1, "force": 0, "spring": 1, "cubic": 0, "damping": 0, "x0": 0}.items()
    }
    observables = (systems.Observable("x", "1", "x"), systems.Observable("v", "1", "v"))

    def initial_state(self, points):
        return np.array([points["x0"], *np.zeros((2, points["x0"].size))])


@pytest.fixture
def driven(own_systems):
    return atlas.register(Driven)


def errors_of_driven(ds, duration):
    """Largest error of an integral over the size of its observable, by the closed form."""
    times, w = np.linspace(0.0, duration, 100_001)[:, None], ds["w"].values
    u, amplitude = times / duration - 0.5, ds["force"].values / (1 - w**2)
    motion = {
        "x": amplitude * (np.cos(w * times) - np.cos(times)),
        "v": amplitude * (np.sin(times) - w * np.sin(w * times)),
    }
    error = np.zeros(w.size)
    for name, values in motion.items():
        mean = simpson(values, x=times, axis=0) / duration
        exact = {
            "mean": mean,
            "std": np.sqrt(simpson((values - mean) ** 2, x=times, axis=0) / duration),
            "drift": 12 * simpson(u * values, x=times, axis=0) / duration,
        }
        size = np.fmax(np.abs(ds[f"{name}_min"].values), np.abs(ds[f"{name}_max"].values))
        for suffix, value in exact.items():
            error = np.fmax(error, np.abs(ds[f"{name}_{suffix}"].values - value) / size)
    return error


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """The system, registered from a module file that is imported as the plug-in of a package would be."""
    folder = tmp_path_factory.mktemp("module")
    (folder / "observed_pendulum.py").write_text(PENDULUM)
    with registry(), pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        import observed_pendulum

        yield atlas.register(observed_pendulum.Pendulum)


def random_points(count):
    rng = np.random.default_rng(3)
    return {
        "omega": rng.uniform(0.3, 3.0, count),
        "cubic": rng.uniform(0.0, 2.0, count),
        "x0": rng.uniform(-2.5, 2.5, count),
        "v0": rng.uniform(-1.0, 1.0, count),
    }


def exact_motion(points, i, times):
    omega, cubic = points["omega"][i], points["cubic"][i]
    start = points["x0"][i], points["v0"][i]
    return solve_ivp(
        lambda _, y: (y[1], -(omega**2) * np.sin(y[0]) - cubic * y[0] ** 3),
        (0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip


def test_statistics_agree_with_dop853(pendulum):
    points, duration = random_points(6), 25.0
    ds = atlas.label_points("pendulum", points, duration=duration, method=METHOD)
    assert (ds["status"] == Status.OK).all()
    times = np.linspace(0.0, duration, 100_001)
    u = times / duration - 0.5
    for i in range(6):
        x, _ = exact_motion(points, i, times)
        for name, values in {"x": x, "height": 1 - np.cos(x)}.items():
            mean = simpson(values, x=times) / duration
            expected = {
                "mean": mean,
                "std": np.sqrt(simpson((values - mean) ** 2, x=times) / duration),
                "min": values.min(),
                "max": values.max(),
                "drift": 12 * simpson(u * values, x=times) / duration,
            }
            size = np.abs(values).max()
            for suffix, value in expected.items():
                assert float(ds[f"{name}_{suffix}"][i]) == pytest.approx(value, abs=3e-6 * size), (
                    name,
                    suffix,
                )
    assert float(ds["integral_drift"].max()) < 1e-8


def test_drift_of_a_free_motion(pendulum):
    """x = x0 + v0 t: a drift of v0 T, and the standard deviation of a uniform distribution."""
    points = {"omega": 0.0, "x0": 1.0, "v0": np.array([0.1, -2.0])}
    ds = atlas.label_points("pendulum", points, duration=30.0, method=METHOD)
    np.testing.assert_allclose(ds["x_drift"], 30.0 * points["v0"], rtol=1e-11)
    np.testing.assert_allclose(ds["x_std"], 30.0 * np.abs(points["v0"]) / np.sqrt(12), rtol=1e-11)
    np.testing.assert_allclose(ds["x_mean"], 1.0 + 15.0 * points["v0"], rtol=1e-11)


@pytest.mark.parametrize("intervals", [3, 4, 5, 7, 12])
def test_the_rule_is_exact_for_polynomials_of_degree_7(intervals):
    values, slopes = sampling.end_weights()
    weights, slope_weights = np.ones(intervals + 1), np.zeros(intervals + 1)
    for j in range(4):
        weights[j] += values[j]
        weights[intervals - j] += values[j]
        slope_weights[j] += slopes[j]
        slope_weights[intervals - j] -= slopes[j]
    t = np.arange(intervals + 1.0)
    errors = [
        weights @ t**k + slope_weights @ (k * t ** max(k - 1, 0)) - intervals ** (k + 1) / (k + 1)
        for k in range(9)
    ]
    relative = np.abs(errors) / [intervals ** (k + 1) / (k + 1) for k in range(9)]
    assert relative[:8].max() < 1e-13
    assert relative[8] > 1e-11


def test_turning_points_of_cubics_and_the_interpolation_between_nodes(pendulum):
    rng = np.random.default_rng(1)
    for _ in range(400):
        cubic = np.polynomial.Polynomial(rng.normal(size=4))
        f0, f1, s0, s1 = cubic(0.0), cubic(1.0), cubic.deriv()(0.0), cubic.deriv()(1.0)
        turns = cubic.deriv().roots()
        count = (np.isreal(turns) & (turns.real > 0) & (turns.real < 1)).sum()
        assert s0 * s1 < 0 or poles.turns_twice(f0, f1, s0, s1, 0.0) == (count == 2)
        if count:
            x = poles.place_of_turn(f0, f1, s0, s1)
            assert 0 <= x <= 1
            assert abs(cubic.deriv()(x)) < 1e-9 * (abs(s0) + abs(s1) + abs(f0 - f1))
    plain = plain_module(pendulum.equations, METHOD, of=observe)
    polynomial = np.polynomial.Polynomial(rng.normal(size=8))
    nodes, spacing, last = np.zeros((4, 4, 1)), 0.7, 6
    for node in range(last - 3, last + 1):
        nodes[node & 3, 1::2, 0] = polynomial(node - 3.0), polynomial.deriv()(node - 3.0) / spacing
    for x in (0.0, 0.4, 1.7, 3.0):
        value = plain.interpolated(nodes, last, 1, 0, spacing, x)
        assert value == pytest.approx(polynomial(x), rel=1e-10)


def test_the_interpreter_and_the_compiler_agree(pendulum):
    points = {name: values[:3] for name, values in random_points(3).items()}
    ensemble = Ensemble.of(pendulum, points)
    sizes = StepSizes.of(Settings(method=METHOD, tolerance=1e-4).at(1e-5), np.full(3, 3.0), np.full(3, 8.0))
    plain = plain_module(pendulum.equations, METHOD, of=observe)
    runs = [
        Run(pendulum, None, (), ensemble, sizes, {}, np.zeros(3), ensemble.integrate(module, sizes))
        for module in (plain, kernel(pendulum, METHOD))
    ]
    interpreted, compiled = (observables.Observables().measurements(run, {}) for run in runs)
    for name, values in compiled.items():
        np.testing.assert_allclose(values, interpreted[name], rtol=1e-11, atol=1e-12)


def test_labels_follow_the_tolerances(pendulum):
    scene = atlas.load_scene(PENDULUM_SCENE)
    ds = atlas.run(scene, progress=False)
    varies = (ds["x_std"] > 0.5) | (ds["height_std"] > 0.01)
    expected = np.where(varies, Steadiness.DRIFTING, Steadiness.STEADY)
    np.testing.assert_array_equal(ds["label"], expected)
    assert set(np.unique(ds["label"])) == {Steadiness.DRIFTING, Steadiness.STEADY}
    assert ds["label"].attrs["flag_meanings"].split() == list(Steadiness.meanings())
    looser = atlas.run(atlas.load_scene(PENDULUM_SCENE + "height = 10.0\n"), progress=False)
    np.testing.assert_array_equal(looser["label"] == Steadiness.DRIFTING, looser["x_std"] > 0.5)
    assert atlas.load_scene(scene.toml()).settings.std_tolerance == {"x": 0.5}


def test_a_label_at_the_tolerance_is_step_sensitive(pendulum):
    points = random_points(40)
    loose = {"duration": 20.0, "method": METHOD, "tolerance": 0.5}
    ds = atlas.label_points("pendulum", points, **loose)
    limit = float(ds["x_std"][0])
    at_limit = atlas.label_points("pendulum", points, std_tolerance={"x": limit, "height": 10.0}, **loose)
    assert at_limit["status"][0] == Status.STEP_SENSITIVE
    assert at_limit["label"][0] == Steadiness.UNRESOLVED
    assert (at_limit["status"][1:] == Status.OK).sum() > 30


@pytest.mark.usual("numeric-none")
@pytest.mark.parametrize(("bound", "check"), [("numeric", "none"), ("proved", "none"), ("proved", "all")])
def test_error_estimates_cover_the_errors(pendulum, monkeypatch, bound, check):
    points = random_points(200)
    if bound == "proved":
        monkeypatch.setattr(
            type(pendulum), "frequency_bound", lambda self, points: 2.5 * points["omega"] + 5.0
        )
    settings = {"duration": 20.0, "method": METHOD}
    exact = atlas.label_points("pendulum", points, tolerance=1e-13, **settings)
    ds = atlas.label_points("pendulum", points, tolerance=1e-4, check_half_step=check, **settings)
    error = np.zeros(200)
    for name in ("x", "height"):
        size = np.maximum(np.abs(exact[f"{name}_min"]), np.abs(exact[f"{name}_max"]))
        for suffix in observables.STATISTICS:
            error = np.fmax(error, np.abs(ds[f"{name}_{suffix}"] - exact[f"{name}_{suffix}"]) / size)
    assert (error <= ds["error_estimate"]).mean() > 0.95
    assert (error <= 10 * ds["error_estimate"]).all()


def test_variables_of_the_registry_and_of_the_trajectory(pendulum):
    assert list(variables(pendulum)) == [
        "label", "status", "x_mean", "x_std", "x_min", "x_max", "x_drift", "height_mean", "height_std", "height_min",
        "height_max", "height_drift", "integral_drift", "step", "step_ratio", "error_estimate", "end_time", "regularity",
        "megno", "lyapunov",
    ]  # fmt: skip
    tr = atlas.trajectory("pendulum", {"x0": 1.2}, duration=10.0, samples=101, method=METHOD)
    points = {"omega": [1.0], "cubic": [0.0], "x0": [1.2], "v0": [0.0]}
    exact = exact_motion(points, 0, tr["time"].values)
    np.testing.assert_allclose(tr["x"], exact[0], atol=1e-7)
    np.testing.assert_allclose(tr["height"], 1 - np.cos(exact[0]), atol=1e-7)
    assert tr["x"].attrs == {"long_name": "angle", "units": "rad"}
    assert float(tr["integral_drift"].max()) < 1e-8


@pytest.mark.long
def test_regular_motions_of_a_pendulum_are_not_chaotic(pendulum):
    points = {"omega": 1.0, "x0": np.array([1.5, 2.0, 3.0])}
    names = ["label", "status", "megno", "lyapunov", "regularity"]
    ds = atlas.label_points("pendulum", points, duration=400.0, method=METHOD, variables=names)
    np.testing.assert_allclose(ds["megno"], 2.0, atol=0.3)
    assert (ds["regularity"] == Regularity.REGULAR).all()
    # Beside the separatrix, from the upright position and from below.
    points = {
        "omega": 1.0,
        "x0": [np.pi - 1e-11, np.pi - 1e-7, 0.0, 0.0],
        "v0": [0.0, 0.0, 2 - 1e-12, 2 + 1e-9],
    }
    ds = atlas.label_points("pendulum", points, duration=100.0, method=METHOD, variables=names)
    assert (ds["regularity"] == Regularity.UNDECIDED).all()
    assert np.isnan(ds["megno"]).all()


def test_lines_of_the_spectrum_of_an_observable(pendulum):
    """Of small oscillations: x = x0 cos(omega t)."""
    tr = atlas.trajectory("pendulum", {"omega": 2.0, "x0": 1e-3}, duration=100.0, samples=1001, method=METHOD)
    lines = tr.atlas.frequencies(1, trajectory=tr)
    assert float(lines["frequency"].sel(signal="x")[0]) == pytest.approx(2.0, rel=1e-6)
    assert float(lines["amplitude"].sel(signal="x")[0]) == pytest.approx(1e-3, rel=1e-4)
    assert float(lines["frequency"].sel(signal="height")[0]) == pytest.approx(4.0, rel=1e-6)
    with pytest.raises(atlas.BadInput, match=r"samples = 48: too few for a line of height at (4|3\.9999)"):
        tr.atlas.frequencies(1, trajectory=tr.isel(time=slice(None, None, 21)))


def test_a_run_that_is_cut_has_the_same_bits(pendulum, monkeypatch):
    from atlas.kernel import blocks

    points = random_points(5)
    sizes = StepSizes.of(Settings(method=METHOD, tolerance=1e-6).at(1e-5), np.full(5, 3.0), np.full(5, 40.0))
    ensemble = Ensemble.of(pendulum, points)
    whole = ensemble.integrate(kernel(pendulum, METHOD), sizes)
    monkeypatch.setattr(blocks, "CHUNK", 500)
    cut = ensemble.integrate(kernel(pendulum, METHOD), sizes, threads=Threads(2))
    np.testing.assert_array_equal(cut.sums, whole.sums)
    np.testing.assert_array_equal(cut.final_state, whole.final_state)


@pytest.mark.long
def test_run_folders_tiles_threads_and_refinement(pendulum, tmp_path, monkeypatch):
    whole = atlas.run(atlas.load_scene(PENDULUM_SCENE), progress=False, threads=1)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "20")
    folder = atlas.run(atlas.load_scene(PENDULUM_SCENE), f"{tmp_path}/night/", progress=False)
    xr.testing.assert_equal(folder.load().drop_attrs(), whole.drop_attrs())
    refined = atlas.run(atlas.load_scene(PENDULUM_SCENE + "[refine]\nlevels = 1\n"), progress=False)
    coarse = refined.isel(omega=slice(None, None, 2), x0=slice(None, None, 2))
    np.testing.assert_array_equal(coarse["label"], whole["label"])
    assert 0 < float((refined["computed"] == 1).mean()) < 1


@pytest.mark.long
def test_figures(pendulum, tmp_path):
    ds = atlas.run(atlas.load_scene(PENDULUM_SCENE), progress=False)
    ds.atlas.map().savefig(tmp_path / "label.png")
    ds.atlas.map("height_std").savefig(tmp_path / "height.png")
    from atlas.plotting.trajectory import trajectory_figure

    figure = trajectory_figure(ds.atlas.trajectory(omega=1.0, x0=1.0))
    assert [ax.get_ylabel() for ax in figure.axes] == ["$x$ (rad)", "height"]
    assert float(ds.atlas.fractions().sum()) == pytest.approx(1.0)
    assert ds.atlas.fractions().label.values.tolist() == ["not_computed", "steady", "drifting", "unresolved"]
    assert ds.atlas.select(label="steady").sizes["point"] > 0


# The numeric bound.


def test_the_frequency_of_the_jacobian_is_its_spectral_radius_for_states_of_any_units(pendulum):
    points = random_points(50)
    state, constants = pendulum.initial_state(points), pendulum.constants(points)
    matrices = jacobian.jacobian(pendulum.equations, state, constants)
    slope = -(points["omega"] ** 2) * np.cos(points["x0"]) - 3 * points["cubic"] * points["x0"] ** 2
    np.testing.assert_allclose(matrices[:, 0, 1], 1.0)
    np.testing.assert_allclose(matrices[:, 1, 0], slope, rtol=1e-14)
    radius = np.abs(np.linalg.eigvals(matrices)).max(axis=1)
    bound = pendulum.frequency_bound(points)
    assert (bound >= radius * (1 - 1e-12)).all()
    assert (bound <= 1.15 * radius).all()


@pytest.mark.parametrize(("decades", "largest"), [(0, 1.08), (6, 1.3)])
def test_the_size_of_a_power_is_near_the_spectral_radius(decades, largest):
    rng = np.random.default_rng(0)
    matrices, units = rng.normal(size=(500, 6, 6)), 10 ** rng.uniform(0, decades, (500, 6))
    radius = np.abs(np.linalg.eigvals(matrices)).max(axis=1)

    class Linear:
        def rhs(state, constants):
            in_units = np.einsum("pij,jp->ip", matrices, state / units.T)
            return in_units * units.T

    ratio = jacobian.frequency(Linear, np.ones((6, 500)), np.ones((0, 500))) / radius
    assert ratio.min() >= 1 - 1e-12
    assert ratio.max() < largest


def bound_along(system, points, duration, **more):
    size = max(map(np.size, points.values()))
    defaults = {name: parameter.default for name, parameter in system.parameters.items()}
    points = {name: np.broadcast_to(values, size) for name, values in (defaults | points).items()}
    ensemble, durations = Ensemble.of(system, points), np.full(size, duration)
    return numeric_bound.along_runs(
        system, kernel(system, METHOD), METHODS[METHOD], ensemble, durations, 10**8, **more
    )


def test_the_bound_grows_along_motions_that_begin_slowly(pendulum):
    """x'' = -c x^3 from x = 0: the Jacobian vanishes at the start; the frequency is largest where x is."""
    v0 = np.array([0.5, 2.0, 30.0])
    points = {"omega": np.zeros(3), "cubic": np.ones(3), "x0": np.zeros(3), "v0": v0}
    assert (pendulum.frequency_bound(points) < 1e-20).all()
    bound, settled = bound_along(pendulum, points, 50.0)
    fastest = np.sqrt(3 * np.sqrt(2) * v0)  # x^4 = 2 v0^2 there
    assert settled.all()
    assert (bound > 0.6 * fastest).all()
    assert (bound < 1.6 * fastest).all()
    ds = atlas.label_points("pendulum", points, duration=50.0, method=METHOD)
    assert (ds["status"] == Status.OK).all()
    np.testing.assert_allclose(ds["x_max"], (2 * v0**2) ** 0.25, rtol=1e-5)


@pytest.mark.long
def test_the_bound_sees_a_forcing_that_the_jacobian_does_not_contain(driven, monkeypatch):
    """Where it is blind the second run shows it, also at frequencies that the steps and half as many take for 0."""
    duration, w = 20.0, np.array([2.0, 64 * np.pi / 10, 100.0, 300.0])
    points, settings = {"w": w, "force": 0.5 * w}, {"duration": duration, "method": METHOD}
    ds = atlas.label_points("driven", points, **settings)
    assert (ds["status"] == Status.OK).all()
    error, estimate = errors_of_driven(ds, duration), ds["error_estimate"].values
    assert (error < np.fmin(1e-5, 10 * estimate)).all()
    monkeypatch.setattr(numeric_bound, "OVERTONE", np.inf)
    blind = atlas.label_points("driven", points, **settings)
    error, estimate = errors_of_driven(blind, duration), blind["error_estimate"].values
    assert (error[1:] > 0.1).all()
    assert (error <= 10 * estimate).all()
    assert np.isfinite(estimate).all()


@pytest.mark.long
def test_a_forcing_that_turns_once_from_sample_to_sample_is_seen_at_all_phases(driven):
    """With equal distances all samples have one phase, in which the slope is zero and the bound had no limit."""
    points, duration = {"w": np.full(1, 2 * np.pi), "force": 1 - (2 * np.pi) ** 2, "x0": 1.0}, 2000.0
    ds = atlas.label_points("driven", points, duration=duration, method=METHOD)
    assert ds["status"] == Status.OK
    assert float(ds["x_std"][0]) == pytest.approx(np.sqrt(0.5), abs=1e-5)
    assert float(ds["error_estimate"][0]) < 1e-5
    assert duration / float(ds["step"][0]) < 40 * 2000


@pytest.mark.long
def test_no_number_of_turns_between_two_samples_raises_the_bound(driven):
    """Of x = cos(w t) the larger ratio of derivatives is w at least, and sqrt(2) w where the phases are a quarter turn wide."""
    turns = np.array([0.5, 1, 1.382, 1.5, 1.764, 2, 3.1459, 4.9098, 5, 8.0557, 13])
    w = np.linspace(4.0, 9.0, turns.size)
    duration = numeric_bound.MAX_SAMPLES * turns * 2 * np.pi / w
    bound, settled = bound_along(driven, {"w": w, "force": 1 - w**2, "x0": 1.0}, duration)
    assert settled.all()
    assert (bound >= 0.5 * w / numeric_bound.TOLERATED).all()
    assert (bound <= 0.75 * w).all()


@pytest.mark.long
def test_bounds_by_few_samples_are_about_those_by_many(driven, monkeypatch):
    rng, size = np.random.default_rng(0), 12
    w = rng.uniform(1.0, 20.0, size)
    points = {
        "w": w, "force": w * 10 ** rng.uniform(-1.5, 1.0, size), "spring": rng.uniform(0.1, 9.0, size),
        "cubic": rng.uniform(0.0, 0.2, size), "damping": rng.uniform(0.0, 0.5, size),
        "x0": rng.uniform(-2.0, 2.0, size),
    }  # fmt: skip
    duration = numeric_bound.MAX_SAMPLES * rng.choice([0.5, 1.0, 1.5, 2.0], size) * 2 * np.pi / w
    few, settled = bound_along(driven, points, duration)
    monkeypatch.setattr(numeric_bound, "MAX_SAMPLES", 8 * numeric_bound.MAX_SAMPLES)
    many, _ = bound_along(driven, points, duration)
    assert settled.all()
    assert (few > 0.5 * many).all()
    assert (few < 4.0 * many).all()


@pytest.mark.long
def test_a_trajectory_has_the_steps_of_the_atlas(driven):
    points = {"w": np.array([3.0, 2 * np.pi, 40.0]), "force": 5.0, "x0": 1.0, "damping": 0.1}
    options = {"duration": 600.0, "method": METHOD}
    ds = atlas.label_points("driven", points, **options)
    alone = atlas.label_points("driven", points | {"w": points["w"][1:2]}, threads=1, **options)
    xr.testing.assert_equal(alone.drop_attrs(), ds.isel(point=[1]).drop_attrs())
    for i, w in enumerate(points["w"]):
        tr = atlas.trajectory("driven", points | {"w": w}, samples=2, **options)
        assert float(tr["step"]) == float(ds["step"][i])


def test_the_differences_of_extremes_have_no_order(driven):
    values = {f"{name}_{suffix}": np.full(1, 2.0) for name in "xv" for suffix in observables.STATISTICS}
    for suffix in observables.STATISTICS:
        other = values | {f"v_{suffix}": np.full(1, 1.9)}
        expected = 0.05 if suffix in ("min", "max") else 0.01
        runs = (SimpleNamespace(system=driven, measured=measured) for measured in (values, other))
        assert observables.Observables().rate_change(*runs, 5.0) == pytest.approx(expected)


def test_the_bound_of_a_point_depends_on_it_alone(pendulum):
    points = random_points(70) | {"v0": np.linspace(0, 20, 70)}
    bound, _ = bound_along(pendulum, points, 30.0, threads=Threads(2))
    for i in (0, 33, 69):
        alone = {name: values[i : i + 1] for name, values in points.items()}
        assert bound_along(pendulum, alone, 30.0, threads=Threads(1))[0] == bound[i]


@pytest.mark.long
def test_a_motion_that_reaches_infinity_keeps_its_last_finite_bound(pendulum):
    """x'' = x^3 does so from x = 3 in 0.6 time units, whatever the steps: shorter ones would cost time and change nothing."""
    points = {"omega": np.zeros(1), "cubic": np.full(1, -1.0), "x0": np.full(1, 3.0), "v0": np.zeros(1)}
    bound, settled = bound_along(pendulum, points, 30.0)
    assert 3 * np.sqrt(3) < bound[0] < 1e4
    assert not settled[0]


def test_an_integral_is_compared_with_its_terms_at_the_start_or_with_1(pendulum):
    """Where they are all 0, its rounding errors would otherwise be infinitely large."""
    points = {
        "omega": np.full(2, 2.0),
        "cubic": np.zeros(2),
        "x0": np.array([0.0, np.pi]),
        "v0": np.array([0.0, 4.0]),
    }
    scales = Ensemble.of(pendulum, points).scales
    np.testing.assert_allclose(scales, [[1.0, 1 / 16]], rtol=1e-15)


@pytest.mark.long
def test_motions_that_end_are_not_resolved(pendulum, monkeypatch):
    """With a negative spring the motion reaches infinity in a finite time."""
    points = {"omega": np.zeros(2), "cubic": np.array([-1.0, 1.0]), "x0": np.ones(2), "v0": np.zeros(2)}
    base = dict(points)
    columns = evaluate(pendulum, base, points, np.full(2, 30.0), Settings(method=METHOD), threads=1)
    assert columns["status"][0] in (Status.NOT_FINITE, Status.UNDER_RESOLVED)
    assert columns["label"][0] == Steadiness.UNRESOLVED
    assert columns["status"][1] == Status.OK


def test_a_start_that_is_not_finite(pendulum, monkeypatch):
    original = type(pendulum).initial_state

    def start(self, points):
        return np.where(points["omega"] > 2.0, np.inf, original(self, points))

    monkeypatch.setattr(type(pendulum), "initial_state", start)
    ds = atlas.label_points("pendulum", {"omega": np.array([1.0, 3.0])}, duration=5.0, method=METHOD)
    assert list(ds["status"]) == [Status.OK, Status.NOT_COMPUTED]
    with pytest.raises(atlas.BadInput, match="the initial state must be finite"):
        atlas.label_points("pendulum", {"omega": np.array([3.0, 4.0])}, duration=5.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('[labels.std_tolerance]\nX = 0.5', "labels.std_tolerance.X: not an observable of the pendulum; did you mean 'x'?"),
        ("[labels.std_tolerance]\nx = -1", "labels.std_tolerance.x = -1: must be a finite number above 0"),
        ("[labels]\nstd_tolerance = 3", "labels.std_tolerance = 3: must be a table"),
    ],
)  # fmt: skip
def test_tolerances_of_a_scene_are_checked(pendulum, change, message):
    text = PENDULUM_SCENE.partition("[labels.std")[0] + change + "\n"
    with pytest.raises(atlas.BadInput) as caught:
        atlas.load_scene(text)
    assert message in str(caught.value)
    with pytest.raises(atlas.BadInput, match="nothing turns in the pendulum"):
        atlas.load_scene(PENDULUM_SCENE.replace("duration = 20.0", 'duration = "20 turns"'))


def test_bodies_in_a_frame_have_no_such_tolerances():
    with pytest.raises(atlas.BadInput, match="not an observable of the satellite"):
        atlas.label_points("satellite", {"A": 1.0}, std_tolerance={"x": 1.0})


def test_the_step_of_a_system_with_observables_is_taken_as_it_is(pendulum):
    tr = atlas.trajectory("pendulum", {"x0": 1.0}, step=0.125, duration=50.0, samples=2, method=METHOD)
    assert float(tr["step"]) == 0.125


class Wall(systems.System):
    """A ball on a spring that a wall repels by force / x^2."""

    class equations:
        STATE, CONSTANTS = ("x", "v"), ("force",)

        def rhs(state, constants):
            x, v = state
            (force,) = constants
            return v, -x + force / (x * x)

    name = title = "wall"
    parameters = {name: systems.Parameter(name, "1", name) for name in ("x0", "v0", "force")}  # noqa: RUF012
    observables = (systems.Observable("x", "1", "x"), systems.Observable("v", "1", "v"))

    def initial_state(self, points):
        return np.array([points["x0"], points["v0"]])


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_steps_through_a_wall_give_no_label(method, own_systems):
    """Against the ball that bounces, x = |R cos(t - phase)|: two runs that miss the wall alike are rare."""
    atlas.register(Wall)
    rng, duration = np.random.default_rng(3), 14.0
    points = {"x0": rng.uniform(0.6, 1.6, 48), "v0": rng.uniform(-2.0, 2.0, 48)}
    options = {"duration": duration, "method": method, "tolerance": 1e-5, "rate_tolerance": 1e-3}
    ds = atlas.label_points("wall", points | {"force": 1e-3}, **options)
    times = np.linspace(0.0, duration, 20_001)[:, None]
    truth = np.abs(points["x0"] * np.cos(times) + points["v0"] * np.sin(times))
    error = np.abs(ds["x_std"].values - truth.std(axis=0)) / truth.max(axis=0)
    ok, sensitive = (ds["status"].values == status for status in (Status.OK, Status.STEP_SENSITIVE))
    assert (ok & (error > 0.1)).sum() <= 2
    assert ok.sum() > 4
    assert sensitive.sum() > 10


class ConservativeWall(Wall):
    """The same ball with its energy named."""

    class equations:
        STATE, CONSTANTS, INTEGRALS = ("x", "v"), ("force",), {"energy": 2}
        rhs = Wall.equations.rhs

        def energy(state, constants):
            x, v = state
            (force,) = constants
            return 0.5 * v * v, 0.5 * x * x, force / x

    name = title = "conservative_wall"


@pytest.mark.long
def test_a_first_integral_shows_every_wall_that_steps_miss(own_systems):
    """Without the energy one of them is ok though every run misses its wall."""
    atlas.register(ConservativeWall)
    rng, duration = np.random.default_rng(8), 14.0
    points = {"x0": rng.uniform(0.6, 1.6, 48), "v0": rng.uniform(-2.0, 2.0, 48)}
    options = {"duration": duration, "method": "rk8", "tolerance": 1e-5, "rate_tolerance": 1e-3}
    ds = atlas.label_points("conservative_wall", points | {"force": 10 ** rng.uniform(-5, -2, 48)}, **options)
    ok, drifting_energy = (ds["status"].values == status for status in (Status.OK, Status.DRIFT_EXCEEDED))
    assert (ds["x_min"].values[ok] > 0).all()
    assert ok.sum() > 4
    assert drifting_energy.sum() > 10


@pytest.mark.long
def test_chaos_keeps_its_label(driven):
    """Errors as large as the motion, which grew as the difference of two starts does, in Duffing's two wells."""
    points = {"x0": np.linspace(-1.5, 1.5, 40), "force": 0.3, "spring": -1.0, "cubic": 1.0, "damping": 0.15}
    ds = atlas.label_points("driven", points, duration=400.0, tolerance=1e-6, method="rk8")
    assert (ds["status"] == Status.OK).all()
    assert (ds["error_estimate"] > 0.01).sum() > 20
