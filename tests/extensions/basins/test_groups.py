"""Ends as groups of equal statistics, against runs in 80 bits and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy import cos, sin

import atlas
from atlas.extensions.basins.groups import groups
from atlas.flags import Label, Status
from atlas.systems import Observable, Parameter, System
from tests.refusals import assert_refused


class VanDerPol(System):
    name, title = "van_der_pol", "van der Pol's oscillator"

    class equations:
        STATE = ("x", "v")
        CONSTANTS = ("mu",)

        def rhs(state, constants):
            x, v = state
            (mu,) = constants
            return v, mu * (1 - x * x) * v - x

    parameters = {  # noqa: RUF012
        "mu": Parameter("mu", "1", "strength", 1.0),
        "x0": Parameter("x0", "1", "place", start=True),
        "v0": Parameter("v0", "1", "rate", start=True),
    }
    observables = (Observable("x", "1", "place"),)

    def initial_state(self, points):
        return np.array([points["x0"], points["v0"]])


class Pendulum(System):
    name, title = "forced_pendulum", "forced pendulum"

    class equations:
        STATE = ("x", "v", "clock")
        CONSTANTS = ("d", "f", "w")

        def rhs(state, constants):
            x, v, clock = state
            d, f, w = constants
            return v, -sin(x) - d * v + f * cos(clock), w

    parameters = {  # noqa: RUF012
        "d": Parameter("d", "1", "damping", 0.2),
        "f": Parameter("f", "1", "force", 1.66),
        "w": Parameter("w", "1", "rate of the force", 1.0),
        "x0": Parameter("x0", "1", "angle", start=True),
        "v0": Parameter("v0", "1", "rate", start=True),
    }
    observables = (Observable("v", "1", "rate"),)

    def initial_state(self, points):
        return np.array([points["x0"], points["v0"], np.zeros_like(points["x0"])])


@pytest.fixture(autouse=True)
def own(own_systems):
    atlas.register(VanDerPol())
    atlas.register(Pendulum())


def cycles(mu, **options):
    """Motions of the oscillator over the dimensions of mu and of two starts."""
    points = {"mu": xr.DataArray(mu, dims="mu"), "x0": xr.DataArray([0.5, 1.5], dims="x0"), "v0": 0.3}
    options = {"transient": 120.0, "duration": 60.0, "method": "rk8", "tolerance": 1e-8} | options
    return atlas.label_points("van_der_pol", points, **options)


@pytest.mark.long
def test_starts_of_an_oscillator_end_in_its_cycle():
    """Extremes of runs in 80 bits; for mu < 0 rest is the end."""
    ds = cycles([2.094, -0.5])
    ends = ds.atlas.ends(["x_min", "x_max"], 1e-6)
    assert ends["end"].dtype == np.int16
    assert ends["end"].transpose("mu", "x0").values.tolist() == [[0, 0], [1, 1]]
    assert np.abs(ends["x_max"] - [2.020505075068344, 0.0]).max() < 1e-6
    assert np.abs(ends["x_min"] + [2.020505075068344, 0.0]).max() < 1e-6
    assert ends["count"].values.tolist() == [2, 2]
    assert (ends["spread"] < 1).all()
    assert (ds["label"].sel(mu=2.094) == Label.DRIFTING).all()
    fractions = ends.atlas.basin_fractions("x0", "end")
    assert fractions["end"].values.tolist() == [-1, 0, 1]
    assert fractions["fraction"].transpose("mu", "end").values.tolist() == [[0, 1, 0], [0, 0, 1]]
    joined = ds.assign(end=ends["end"])
    assert joined.atlas.select(end="end_1").sizes["point"] == 2
    assert [t.get_text() for t in joined.atlas.map("end").legends[0].get_texts()][:2] == ["end 0", "end 1"]


# Starts of the pendulum, and the extremes of its rate in runs in 80 bits.
STARTS = np.array([[2.819, 2.042], [-1.53, 0.405], [2.736, 1.714], [-0.784, -0.18], [0.107, 2.411]])
TURNING, BACK, SWINGING = (-1.4557034, 2.3847303), (-2.3847303, 1.4557034), (-2.7245481, 2.7245481)


@pytest.mark.long
def test_cycles_coexist():
    period = 2 * np.pi
    ds = atlas.label_points(
        "forced_pendulum", {"x0": STARTS[:, 0], "v0": STARTS[:, 1]}, transient=200 * period, duration=8 * period,
        method="rk8", tolerance=1e-9,
    )  # fmt: skip
    expected = np.array([TURNING, TURNING, BACK, BACK, SWINGING])
    assert np.abs(np.array([ds["v_min"], ds["v_max"]]).T - expected).max() < 1e-6
    ends = ds.atlas.ends(("v_min", "v_max"), {"v_min": 1e-5, "v_max": 1e-6})
    assert ends["end"].values.tolist() == [1, 1, 0, 0, -1]
    assert ends.atlas.basin_fractions(variable="end")["fraction"].values == pytest.approx([0.2, 0.4, 0.4])


def test_what_is_no_end_and_what_is_a_chain(caplog):
    ds = cycles(np.linspace(1.0, 1.05, 11))
    ds["status"][0, 0] = Status.NOT_FINITE
    ds["x_max"][1, 0] = np.nan
    ends = ds.atlas.ends("x_max", 2e-4)
    assert ends["end"].values.ravel()[[0, 2]].tolist() == [-1, -1]
    assert ends["count"].values.tolist() == [20]
    assert ends["spread"].item() > 1
    assert "chains 0" in caplog.text
    assert (
        not ds.where(False)
        .assign(status=ds["status"])
        .assign_attrs(ds.attrs)
        .atlas.ends("x_max", 1.0)["which"]
        .size
    )


def test_groups_are_connected_by_near_rows():
    """Against the definition, at random places on both sides of the tolerance; and of very many motions that agree."""
    places = np.random.default_rng(4).uniform(0, 30, (300, 2))
    near = (np.abs(places[:, None] - places).max(2) <= 1).astype(int)
    for _ in range(9):
        near = (near @ near > 0).astype(int)
    group = groups(places)
    assert ((group[:, None] == group) >= (near > 0)).mean() > 0.999
    assert ((group[:, None] == group) == (near > 0)).mean() > 0.9
    assert groups(np.random.default_rng(4).normal(0, 1e-3, (200_000, 2)) + 0.1).max() == 0


REFUSED = [
    (["x"], 1.0, "features: 'x' is no number measured here; allowed: ..."),
    (["label"], 1.0, "features: 'label' is no number measured here; ..."),
    ([], 1.0, "features: '' is no number measured here; ..."),
    ("x_max", 0.0, "tolerance of x_max = 0.0: must be a finite number above 0"),
    ("x_max", {"x_max": -1.0}, "tolerance of x_max = -1.0: must be a finite number above 0"),
    ("x_max", {"x_min": 1.0}, "tolerance: ...: must name the features x_max"),
]


@pytest.mark.parametrize(("features", "tolerance", "sentence"), REFUSED)
def test_refusals(features, tolerance, sentence):
    ds = cycles([1.0], transient=10.0, duration=10.0)
    assert_refused(lambda: ds.atlas.ends(features, tolerance), sentence)


def test_an_atlas_without_a_transient_is_refused():
    ds = cycles([1.0], transient=0, duration=10.0)
    assert_refused(lambda: ds.atlas.ends("x_max", 1.0), "ends: no atlas with a transient; ...")
