"""Statistics, labels and indicators of chaos after a transient: against other integrators, and against runs from its end."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from plugins import registry
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import atlas
from atlas import cli, systems
from atlas.flags import Agreement, Label, Status, Steadiness
from atlas.kernel import blocks
from atlas.label.theory import forget_drifting
from atlas.plotting.style import caption
from atlas.systems import Observable, Parameter
from atlas.systems.jacobian import changes_volume

pytestmark = pytest.mark.usefixtures("whole_kernels")

RATES = (
    "theta_dot_rms",
    "psi_dot_mean",
    "psi_dot_std",
    "normal_rate_mean",
    "normal_rate_std",
    "phi_dot_mean",
)
# Damping, other parameters, transient and duration -> RATES by DOP853 and in 80 bits.
BODIES = [
    (
        {"damping": 0.0, "B": 1.378, "C": 1.222, "k3": 0.285, "theta0": 1.683, "psi0": 0.883, "n": 0.507, "m": 0.591}, 22.0, 20.0,
        (0.4074537338422668, 0.5352166335811481, 0.6366581849614844, 0.3151983982275089, 0.41976337081227005, -0.2932790693799142),
    ),
    (
        {"damping": 0.05, "B": 1.389, "C": 1.195, "k3": 0.305, "theta0": 1.862, "psi0": 1.413, "n": -0.563, "m": 0.632}, 34.0, 23.0,
        (0.2214577181339872, 0.25691435755602504, 0.5324710974264992, -0.01115307807112148, 0.2846118593065412, -0.28084216482748786),
    ),
    (
        {"damping": 0.3, "B": 1.156, "C": 1.221, "k3": 0.152, "theta0": 1.194, "psi0": 1.523, "n": -0.155, "m": -0.712}, 20.0, 18.0,
        (0.028357454986899275, 0.3529926067938847, 0.3040071690144095, 0.013497538387828068, 0.03936365163326146, -0.3405862409320148),
    ),
]  # fmt: skip
SATELLITE = {
    "B": 1.3,
    "C": 1.6,
    "k3": 0.2,
    "theta0": 0.7,
    "psi0": 0.4,
    "n": 0.3,
    "m": -0.2,
    "theta_dot0": 0.1,
}


class Lorenz84(systems.System):
    """Lorenz's model of the general circulation, 1984: it is attracted by a point, a cycle or chaos."""

    name = title = "lorenz84"

    class equations:
        STATE, CONSTANTS = ("x", "y", "z"), ("F", "G")

        def rhs(state, constants):
            x, y, z = state
            F, G = constants
            return -y * y - z * z - 0.25 * x + 0.25 * F, x * y - 4.0 * x * z - y + G, 4.0 * x * y + x * z - z

    parameters = {name: Parameter(name, "1", name) for name in "FG"} | {
        f"{name}0": Parameter(f"{name}0", "1", name, 0.5, start=True) for name in "xyz"
    }
    observables = (Observable("x", "1", "x", tolerance=1e-6), Observable("y", "1", "y", tolerance=1e-6))

    def initial_state(self, points):
        return np.array([points["x0"], points["y0"], points["z0"]])


@pytest.fixture(scope="module")
def lorenz():
    with registry():
        yield atlas.register(Lorenz84)


@pytest.mark.parametrize("case", BODIES, ids=["free", "damped", "much damped"])
@pytest.mark.parametrize("options", [{}, {"method": "rk8", "check_half_step": "all"}], ids=["rk4", "rk8"])
def test_rates_are_those_of_other_integrators(case, options):
    body, transient, duration, expected = case
    ds = atlas.label_points("satellite", body, transient=transient, duration=duration, **options)
    for name, value in zip(RATES, expected, strict=True):
        assert float(ds[name][0]) == pytest.approx(value, abs=1e-9), name
    assert (ds.end_time == transient + duration).all()
    damped = body["damping"] > 0
    assert ds.predicted[0] == (Label.NOT_COMPUTED if damped else Label.DRIFTING)
    assert ds.agreement[0] == (Agreement.NOT_COMPARED if damped else Agreement.AGREE)
    assert ds.error_estimate[0] < 1e-6
    assert ds.attrs["atlas_transient"] == f"{transient:g}"


@pytest.mark.long
def test_all_is_as_from_the_state_at_its_end():
    """By a trajectory, whose angles and rates there are a start: any axis, MEGNO and the drift of first integrals included."""
    names = ["label_any_axis", "precession_rate", "nutation", "spin_axis_3", "megno", "lyapunov", *RATES]
    # A body of revolution that precesses about the normal, and two satellites.
    given = {name: np.array([value, value, 0.0]) for name, value in SATELLITE.items()}
    given |= {"damping": np.array([0.0, 0.1, 0.0]), "B": np.array([1.3, 1.3, 1.0]), "C": np.full(3, 1.6)}
    given |= {
        "theta0": np.array([0.7, 1.1, 0.6]),
        "n": np.array([0.3, 0.3, 0.4]),
        "m": np.array([-0.2, -0.2, 1.0]),
    }
    later = {name: values.copy() for name, values in given.items()} | {"phi0": np.zeros(3)}
    for i in range(3):
        point = {name: values[i] for name, values in given.items()}
        end = atlas.trajectory("satellite", point, duration=31.0, samples=201, tolerance=1e-11).isel(time=-1)
        for start, name in zip(("theta0", "psi0", "phi0", "theta_dot0", "n", "m"), ("theta", "psi", "phi", "theta_dot", "psi_dot", "phi_dot"), strict=True):  # fmt: skip
            later[start][i] = end[name]
    options = {"duration": 40.0, "tolerance": 1e-10, "check_half_step": "all", "variables": [*names, "end_time", "status", "integral_drift"]}  # fmt: skip
    ds = atlas.label_points("satellite", given, transient=31.0, **options)
    expected = atlas.label_points("satellite", later, **options)
    assert (ds.status == Status.OK).all()
    for name in names:
        rtol = 1e-4 if name in ("megno", "lyapunov") else 1e-6  # their steps are longer
        np.testing.assert_allclose(ds[name], expected[name], rtol=rtol, atol=1e-8, err_msg=name)
    np.testing.assert_array_equal(ds.end_time, 31.0 + expected.end_time)
    whole = atlas.label_points("satellite", given, **options | {"duration": 71.0})
    assert (ds.integral_drift <= 2 * whole.integral_drift).all()
    assert (ds.integral_drift > 0).all()


@pytest.mark.long
def test_without_one_every_bit_is_the_same_whatever_the_neighbours():
    """A transient of 0 at some points, by arithmetic, and none at all; cut into parts and not."""
    given = SATELLITE | {"damping": np.array([0.0, 0.1, 0.0, 0.2]), "m": np.array([-0.2, 0.4, 0.1, 0.3])}
    names = ["label", "label_any_axis", "megno", "psi_dot_std", "predicted", "error_estimate", "end_time"]
    options = {"duration": 15.0, "variables": names, "check_half_step": "all"}
    none = atlas.label_points("satellite", given, **options)
    some = atlas.label_points("satellite", given, transient="200 * damping", **options)
    alone = atlas.label_points("satellite", {**given, "damping": 0.1, "m": 0.4}, transient=20.0, **options)
    for name in names:
        np.testing.assert_array_equal(some[name][::2], none[name][::2])
        np.testing.assert_array_equal(some[name][1], alone[name][0])
    np.testing.assert_array_equal(some.end_time, [15.0, 35.0, 15.0, 55.0])


def test_a_long_one_may_be_interrupted(monkeypatch):
    given = SATELLITE | {"damping": [0.0, 0.3]}
    whole = atlas.label_points("satellite", given, duration=30.0, transient=60.0)
    monkeypatch.setattr(blocks, "CHUNK", 2000)
    cut = atlas.label_points("satellite", given, duration=30.0, transient=60.0)
    for name in ("psi_dot_mean", "integral_drift", "error_estimate"):
        np.testing.assert_allclose(cut[name], whole[name], rtol=1e-6, atol=1e-13)


@pytest.mark.long
def test_an_exact_start_keeps_its_prediction_and_others_lose_that_of_drifting():
    """At rest on the orbit, beside it, and turning steadily about the normal, where damping acts and where not."""
    starts = {"theta0": [0.0, 0.3, 0.0], "n": [0.0, 0.0, 0.4], "B": 1.1, "C": 1.3}
    names = ["label", "predicted", "agreement", "label_any_axis", "predicted_any_axis", "agreement_any_axis"]
    options = {"duration": 30.0, "transient": 400.0, "variables": names}
    damped = atlas.label_points("satellite", {**starts, "damping": 0.3}, **options)
    free = atlas.label_points("satellite", {**starts, "damping": 0.0}, **options)
    rest, unknown = Label.PERMANENT_ROTATION, Label.NOT_COMPUTED
    assert damped.label.values.tolist() == [rest] * 3
    assert damped.predicted.values.tolist() == [rest, unknown, unknown]
    assert damped.agreement.values.tolist() == [Agreement.AGREE, *2 * [Agreement.NOT_COMPARED]]
    assert damped.predicted_any_axis.values.tolist() == [rest, unknown, unknown]
    for name in ("agreement", "agreement_any_axis"):
        assert (free[name] == Agreement.AGREE).all()
    assert free.predicted[1] == Label.DRIFTING


def test_damping_that_depends_on_the_state_is_seen_at_either_end_of_a_transient():
    """Of van der Pol's equations, whose divergence mu (1 - x^2) vanishes at x = 1."""

    def rhs(state, constants):
        x, v = state
        (mu,) = constants
        return v, mu * (1 - x * x) * v - x

    equations, constants = SimpleNamespace(rhs=rhs), np.array([[2.0, 2.0, 2.0, 0.0]])
    first, later = (np.array([x, np.full(4, 0.3)]) for x in ([1.0, 1.0, 0.5, 0.5], [1.0, 2.0, 1.0, 2.0]))
    for state, x in ((first, first[0]), (later, later[0])):
        divergence = constants[0] * (1 - x * x)
        np.testing.assert_array_equal(changes_volume(equations, state, constants), divergence != 0)
    labels = {"predicted": np.full(4, Label.DRIFTING), "label": np.full(4, Label.DRIFTING)}
    where = np.array([True, True, True, True])
    forget_drifting(SimpleNamespace(equations=equations), labels, where, constants, first, later)
    assert labels["predicted"].tolist() == [Label.DRIFTING, *2 * [Label.NOT_COMPUTED], Label.DRIFTING]
    assert (labels["label"] == Label.DRIFTING).all()


def test_labels_alone_and_points_without_resolution():
    given = SATELLITE | {"damping": [0.0, 0.3]}
    options = {"duration": 60.0, "transient": 30.0}
    whole = atlas.label_points("satellite", given, **options)
    labels = atlas.label_points("satellite", given, variables=["label", "end_time", "status"], **options)
    np.testing.assert_array_equal(labels.label, whole.label)
    assert 30.0 < labels.end_time[0] < 90.0  # certain to drift
    coarse = atlas.label_points("satellite", given, max_steps=150, drift_tolerance=10.0, **options)
    assert (coarse.status == Status.UNDER_RESOLVED).all()
    assert (coarse.label == Label.UNRESOLVED).all()
    np.testing.assert_allclose(coarse.end_time, 64 * coarse.step)  # hardly integrated, from the start


def test_lazy_points_and_texts_of_each_point():
    m = xr.DataArray(np.array([0.3, 0.5, 0.0]), dims="m").chunk(m=1)
    given = {**SATELLITE, "n": 0.0, "m": m, "Omega": 2.0}
    ds = atlas.label_points("satellite", given, duration=5.0, transient="2 turns").compute()
    expected = 2 * 2 * np.pi / np.array([0.3, 0.5]) + 5.0
    np.testing.assert_allclose(ds.end_time[:2], expected, rtol=1e-14)
    assert ds.status[2] == Status.NOT_COMPUTED
    orbits = atlas.label_points(
        "satellite", {**SATELLITE, "Omega": [1.0, 2.0]}, duration=5.0, transient="1 orbit"
    )
    np.testing.assert_allclose(orbits.end_time - 5.0, [2 * np.pi, np.pi], rtol=1e-14)
    assert orbits.attrs["atlas_transient"] == "1 orbit"


@pytest.mark.long
def test_an_attracting_point_is_steady_and_observables_begin_at_the_end_of_the_transient(lorenz):
    """The point is a zero of the equations, the end that of DOP853."""
    rng = np.random.default_rng(2)
    starts = {name: rng.uniform(-1.0, 1.0, 12) for name in ("x0", "y0", "z0")}
    at_once = atlas.label_points("lorenz84", {"F": 0.9, "G": 0.05, **starts}, duration=1000.0)
    assert (at_once.label == Steadiness.DRIFTING).all()
    ds = atlas.label_points("lorenz84", {"F": 0.9, "G": 0.05, **starts}, duration=60.0, transient=240.0)
    assert (ds.label == Steadiness.STEADY).all()
    point = fsolve(lambda y: Lorenz84.equations.rhs(y, (0.9, 0.05)), (0.9, 0.1, 0.1), xtol=1e-13)
    np.testing.assert_allclose(ds.x_mean, point[0], atol=1e-9)
    np.testing.assert_allclose(ds.y_mean, point[1], atol=1e-9)
    assert "atlas_warnings" not in ds.attrs
    run = solve_ivp(lambda _, y: Lorenz84.equations.rhs(y, (8.0, 1.0)), (0.0, 20.0), (0.5, 0.2, 0.1), "DOP853", rtol=1e-12, atol=1e-12)  # fmt: skip
    start, end = ({f"{name}0": float(y) for name, y in zip("xyz", run.y[:, i], strict=True)} for i in (0, -1))
    names = ["x_mean", "x_std", "x_max", "y_drift"]
    options = {"duration": 12.0, "tolerance": 1e-11, "variables": names}
    after = atlas.label_points("lorenz84", {"F": 8.0, "G": 1.0, **start}, transient=20.0, **options)
    from_there = atlas.label_points("lorenz84", {"F": 8.0, "G": 1.0, **end}, **options)
    for name in names:
        assert float(after[name][0]) == pytest.approx(float(from_there[name][0]), rel=1e-7), name


SCENE = """
schema = 1
system = "satellite"
[fixed]
B = 1.3
C = 1.6
theta0 = 0.7
[axes.damping]
from = 0.0
to = 0.3
count = 4
[integration]
duration = 10.0
tolerance = 1e-6
[labels]
transient = "40 * damping"
"""


@pytest.mark.long
def test_of_a_scene(tmp_path, capsys):
    """Its text, motions, captions and lines of `atlas check` have the transient; refined, it has the same labels."""
    scene = atlas.load_scene(SCENE)
    again = atlas.load_scene(scene.toml())
    assert again == scene or again.toml() == scene.toml()
    assert "duration 10 after a transient of 40 * damping" in str(scene)
    assert "transient" not in atlas.load_scene(SCENE[: SCENE.index("[labels]")]).toml()
    ds = atlas.run(scene, progress=False)
    until = 10.0 + 40.0 * ds.damping.values
    np.testing.assert_allclose(ds.end_time, until, rtol=1e-15)
    alone = atlas.label_points("satellite", {"B": 1.3, "C": 1.6, "theta0": 0.7, "damping": 0.3}, duration=10.0, transient=12.0, tolerance=1e-6)  # fmt: skip
    np.testing.assert_allclose(ds.psi_dot_std[3], alone.psi_dot_std[0], rtol=1e-9)
    for motion in (ds.atlas.trajectory(damping=0.3), alone.isel(point=0).atlas.trajectory()):
        assert float(motion.time[-1]) == pytest.approx(22.0, rel=1e-15)
    assert caption(ds).count("After a transient of 40 * damping.") == 1
    assert "After a transient of 12." in caption(alone)
    (tmp_path / "scene.toml").write_text(SCENE)
    assert cli.main(["check", str(tmp_path / "scene.toml")]) == cli.DONE
    out = capsys.readouterr().out
    assert "4 points, duration 10 after a transient of 40 * damping" in out
    assert 'transient = "40 * damping" is 0 to 12 time units' in out
    refined = atlas.run(SCENE.replace("count = 4", "count = 2") + "[refine]\nlevels = 2\n", progress=False)
    np.testing.assert_array_equal(refined.label.sel(damping=[0.0, 0.3]), ds.label[[0, 3]])


def test_what_nothing_damps_is_warned_of(caplog):
    """Not of what a nudge moves, nor where it is 0."""
    atlas.label_points(
        "satellite", {"theta0": 0.3, "damping": [0.0, 0.0, 0.1]}, duration=7.0, transient="10 * damping + 1"
    )
    (message,) = caplog.messages
    assert message.startswith("transient: nothing damps the motion at 66.7 % of the points")
    caplog.clear()
    atlas.label_points(
        "satellite", {"theta0": 0.3, "damping": [0.0, 0.1]}, duration=7.0, transient="10 * damping"
    )
    atlas.run(SCENE + "[nudge]\ntheta0 = 1e-3\n", progress=False)
    assert not [text for text in caplog.messages if "transient" in text]
