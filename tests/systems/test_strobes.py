"""Observables that are measured once a period, against closed forms and SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from numpy import cos, sin
from plugins import registry

import atlas
from atlas import BadInput, systems
from atlas.flags import Status, Steadiness
from atlas.scene.model import Settings
from atlas.systems import Observable, Parameter

pytestmark = pytest.mark.usefixtures("whole_kernels")


class Equations:
    STATE, CONSTANTS = ("x", "v", "c", "s"), ("w", "force")

    def rhs(state, constants):
        x, v, c, s = state
        w, force = constants
        return v, -x + force * c, -w * s, w * c

    def strobed_x(state, constants):
        x, v, c, s = state
        return x + 0.0 * c


class Forced(systems.System):
    """A linear oscillator under a periodic force: x = a cos(w t) + b cos(t), a = force / (1 - w^2), starts at rest."""

    name = title = "forced"
    equations = Equations
    parameters = {  # noqa: RUF012
        "w": Parameter("w", "s-1", "rate of the force", 1.0),
        "force": Parameter("force", "1", "force"),
        "x0": Parameter("x0", "1", "x at the start", start=True),
    }
    observables = (
        Observable("x", "1", "x", tolerance=np.inf),
        Observable("strobed_x", "1", "x", every="2*pi/w"),
        Observable("v", "1", "v", tolerance=1e-4, every="2*pi/w"),
    )

    def initial_state(self, points):
        zero = 0 * points["x0"]
        return np.array([points["x0"], zero, 1 + zero, zero])


@pytest.fixture(scope="module")
def forced():
    with registry():
        yield atlas.register(Forced)


def points():
    rng = np.random.default_rng(5)
    w, force = rng.uniform(1.2, 3.0, 40), rng.uniform(0.5, 1.0, 40)
    periodic = force / (1 - w**2)
    x0 = np.where(np.arange(40) % 2, periodic, rng.uniform(-1, 1, 40))
    return {"w": w, "force": force, "x0": x0}, periodic


def test_statistics_are_those_of_the_instants(forced):
    given, amplitude = points()
    ds = atlas.label_points("forced", given, duration=60.0, tolerance=1e-9)
    assert (ds.status == Status.OK).all()
    period = 2 * np.pi / given["w"]
    count = np.floor(60 / period + 1e-3).astype(int)
    np.testing.assert_allclose(ds.end_time, count * period, rtol=1e-14)
    for i in range(40):
        t = np.arange(count[i] + 1) * period[i]
        free = given["x0"][i] - amplitude[i]
        for name, values in (("strobed_x", amplitude[i] + free * cos(t)), ("v", -free * sin(t))):
            exact = {
                "mean": values.mean(), "std": values.std(), "min": values.min(), "max": values.max(),
                "drift": np.polyfit(t / t[-1], values, 1)[0],
            }  # fmt: skip
            for statistic, value in exact.items():
                assert float(ds[f"{name}_{statistic}"][i]) == pytest.approx(value, abs=1e-7)
    # Motions with the period of the force are steady, although x itself oscillates.
    steady = np.arange(40) % 2 == 1
    np.testing.assert_array_equal(ds.label.values == Steadiness.STEADY, steady)
    assert (ds.x_std.values[steady] > 0.05).all()
    assert ds.v_mean.attrs["long_name"] == "mean of the v"


def test_a_transient_is_of_whole_periods(forced):
    given, amplitude = points()
    ds = atlas.label_points("forced", given, duration=20.0, transient=9.0, tolerance=1e-9)
    period = 2 * np.pi / given["w"]
    before, count = (np.floor(time / period + 1e-3).astype(int) for time in (9.0, 20.0))
    np.testing.assert_allclose(ds.end_time, (before + count) * period, rtol=1e-14)
    for i in range(0, 40, 7):
        t = (before[i] + np.arange(count[i] + 1)) * period[i]
        x = amplitude[i] + (given["x0"][i] - amplitude[i]) * cos(t)
        exact = {"mean": x.mean(), "std": x.std(), "min": x.min(), "max": x.max()}
        for statistic, value in exact.items():
            assert float(ds[f"strobed_x_{statistic}"][i]) == pytest.approx(value, abs=1e-7)


def test_results_depend_on_no_neighbour_or_cut(forced, monkeypatch):
    from atlas.kernel import blocks

    given, _ = points()
    names = ["strobed_x_std", "v_drift", "x_mean", "step"]
    whole = atlas.label_points("forced", given, duration=60.0, variables=names)
    some = {name: values[7:19] for name, values in given.items()}
    monkeypatch.setattr(blocks, "CHUNK", 3000)
    cut = atlas.label_points("forced", some, duration=60.0, variables=names, threads=1)
    for name in names:
        np.testing.assert_array_equal(cut[name], whole[name][7:19])
    np.testing.assert_allclose(
        np.rint(2 * np.pi / given["w"] / whole.step), 2 * np.pi / given["w"] / whole.step, rtol=1e-12
    )


def test_a_period_that_is_not_finite_gives_no_label(forced):
    ds = atlas.label_points(
        "forced", {"w": [0.0, 1.5], "x0": 1.0}, duration=20.0, variables=["label", "status"]
    )
    assert list(ds.label.values) == [Steadiness.UNRESOLVED, Steadiness.DRIFTING]


@pytest.mark.long
@pytest.mark.extension("studies")
def test_reference_by_dop853_measures_at_the_same_instants(forced):
    from atlas.extensions.studies.reference import reference

    given, _ = points()
    given = {name: values[:2] for name, values in given.items()}
    settings = Settings(tolerance=1e-9).at(1e-5)
    exact = reference(forced, given, np.full(2, 12.0), settings)
    ds = atlas.label_points("forced", given, duration=12.0, tolerance=1e-9)
    for name, values in exact.statistics.items():
        np.testing.assert_allclose(ds[name], values, atol=1e-8, err_msg=name)
    period = 2 * np.pi / given["w"]
    after = reference(forced, given, np.full(2, 12.0), replace(settings, transient=2 * period))
    ds = atlas.label_points("forced", given, duration=12.0, tolerance=1e-9, transient="4 * pi / w")
    for name, values in after.statistics.items():
        np.testing.assert_allclose(ds[name], values, atol=1e-8, err_msg=name)


@pytest.mark.parametrize(
    ("observables", "message"),
    [
        ((Observable("x", "1", "x", every="2*pi"),), "one at least must be measured throughout"),
        ((Observable("x", "1", "x"), Observable("v", "1", "v", every="period")), "'period' is not defined"),
        ((Observable("x", "1", "x"), Observable("v", "1", "v", every="2 pi")), "every = '2 pi' is not arithmetic"),
        (
            (Observable("x", "1", "x"), Observable("v", "1", "v", every=1.0), Observable("c", "1", "c", every=2.0)),
            "every = 1.0, 2.0: allowed: one time for all",
        ),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(observables, message, own_systems):
    wrong = type("Wrong", (Forced,), {"name": "wrong", "observables": observables})
    with pytest.raises(BadInput, match=message) as caught:
        atlas.register(wrong)
    assert "\n" not in str(caught.value)
