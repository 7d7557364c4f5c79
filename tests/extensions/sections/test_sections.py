"""Poincaré sections against other integrators and closed forms: numbers, places, touches, passages of the vertical, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy import cos, sin
from scipy.integrate import solve_ivp

import atlas
from atlas import cli, systems
from atlas.flags import Status
from atlas.scene.tables import point_columns
from atlas.systems import Observable, Parameter, System
from tests.refusals import assert_refused, assert_refused_in_shell

pytestmark = pytest.mark.usefixtures("whole_kernels")

BODY = {"A": 1.0, "B": 1.05, "C": 1.4, "k3": 0.05, "theta0": 0.9, "psi0": 0.4, "n": 0.1, "m": 0.4, "theta_dot0": 0.1}  # fmt: skip
RISING = {
    "psi_dot = 0 rising": 1,
    "theta_dot = 0 falling": -1,
    "theta = 0.7 either": 0,
    "phi = 0.5": 1,
    "axis_x = g1 * g2": 1,
}


class Oscillator(System):
    """x = a cos(t)."""

    name, title = "oscillator", "oscillator"

    class equations:
        STATE = ("x", "v")
        INTEGRALS = ("energy",)

        def rhs(state, constants):
            x, v = state
            return v, -x

        def energy(state, constants):
            x, v = state
            return 0.5 * v * v, 0.5 * x * x

    parameters = {  # noqa: RUF012
        "x0": Parameter("x0", "1", "x at the start", 1.0, start=True),
        "v0": Parameter("v0", "1", "rate", start=True),
    }
    observables = (Observable("x", "1", "place", symbol="$x$"), Observable("v", "s-1", "rate"))

    def initial_state(self, points):
        return np.array([points["x0"], points["v0"]])


@pytest.fixture(autouse=True)
def oscillator(own_systems):
    atlas.register(Oscillator())


def function(at, motion, axis):
    """The left side minus the right one, by its definition, and the kept quantities."""
    u1, u2, u3, g1, g2, g3 = motion
    sine = np.hypot(g1, g2)
    psi_dot, theta_dot = (u1 * g1 + u2 * g2) / sine**2, (u1 * g2 - u2 * g1) / sine
    theta, phi = np.arctan2(sine, g3), np.arctan2(g1, g2)
    value = {
        "psi_dot = 0 rising": psi_dot, "theta_dot = 0 falling": theta_dot, "theta = 0.7 either": theta - 0.7,
        "phi = 0.5": sin(phi - 0.5) if cos(phi - 0.5) > 0 else np.nan, "axis_x = g1 * g2": axis[0] - g1 * g2,
    }[at]  # fmt: skip
    return value, (theta, phi, theta_dot, psi_dot)


@pytest.mark.usual("theta = 0.7 either", "phi = 0.5")
@pytest.mark.parametrize("at", RISING)
def test_crossings_of_a_satellite_are_those_of_another_integrator(at):
    """DOP853 with dense output, whose zeros are between sign changes at many instants."""
    system, duration = systems.get("satellite"), 40.0
    columns, _ = point_columns(system, BODY)
    start, constants = system.initial_state(columns)[:, 0], system.constants(columns)[:, 0]
    equations = system.equations

    def of_state(y):
        return function(at, equations.frame_motion(y, constants), equations.axis_in_frame(y, constants))

    run = solve_ivp(
        lambda t, y: equations.rhs(y, constants), (0, duration), start, "DOP853", dense_output=True, rtol=1e-13,
        atol=1e-14, max_step=0.05,
    )  # fmt: skip
    times = np.linspace(0, duration, 4001)
    values = np.array([of_state(y)[0] for y in run.sol(times).T])
    expected = []
    for i in np.flatnonzero((values[:-1] * values[1:] < 0) & (RISING[at] * (values[1:] - values[:-1]) >= 0)):
        low, high = times[i : i + 2]
        for _ in range(50):
            middle = 0.5 * (low + high)
            same = of_state(run.sol(middle))[0] * values[i] > 0
            low, high = (middle, high) if same else (low, middle)
        expected.append([*of_state(run.sol(low))[1], low])
    ds = atlas.section("satellite", BODY, at=at, duration=duration)
    assert ds["crossings"].item() == len(expected) > 0
    assert ds["status"].item() == Status.OK
    measured = np.array([ds[name].values[0] for name in ("theta", "phi", "theta_dot", "psi_dot", "time")]).T
    near_vertical = 1 + np.abs(measured[:, 3])  # where small errors turn the line of nodes far
    assert (np.abs(measured - expected).max(1) / near_vertical).max() < 1e-9
    assert (ds["error"].values[0] / near_vertical).max() < 1e-9


# From the cases of an oracle: own runs in 80 bits.
CASES = [
    ({"A": 1.0, "B": 1.037, "C": 1.273, "k3": 0.065, "m": 0.38, "theta0": 0.325, "psi0": 0.568, "n": 0.062, "theta_dot0": 0.187},
     "psi_dot = 0 rising", 3, {"time": [7.254453509507017, 22.512457563717046, 39.1442775563263], "w1": [-0.2533528295912694, 0.06157137725376007, 0.33785116882240673]}),
    ({"A": 1.0, "B": 1.102, "C": 1.444, "k3": 0.01, "m": 0.358, "theta0": 0.886, "psi0": 0.047, "n": 0.245, "theta_dot0": -0.138},
     "theta_dot = 0 falling", 9, {"time": [3.655995300148363, 11.821515315623774, 17.157255731721865, 20.68746418154193, 24.337001731806378, 25.45669657048998]}),
    ({"A": 1.0, "B": 1.142, "C": 1.256, "k3": 0.018, "m": 0.154, "theta0": 0.865, "psi0": 0.783, "n": 0.097, "theta_dot0": 0.06},
     "theta = 0.7 rising", 1, {"time": [39.10151635542483], "g2": [0.6191205187180062]}),
]  # fmt: skip


@pytest.mark.parametrize(("point", "at", "count", "expected"), CASES)
def test_crossings_of_runs_in_80_bits(point, at, count, expected):
    ds = atlas.section("satellite", point, at=at, keep=[*expected.keys() - {"time"}], duration=40.0)
    assert ds["crossings"].item() == count
    for name, values in expected.items():
        assert np.abs(ds[name].values[0, : len(values)] - values).max() < 1e-9


def test_a_passage_of_the_vertical_in_mixed_expressions():
    """Of a top near theta = pi psi' has a peak of half a node's length; times and angles from own runs in 80 bits."""
    point = {
        "A": 0.9934662190707427, "B": 1.1402120913899574, "C": 1.112672030474827, "theta0": 2.426040082093583,
        "phi0": -1.8726587352927724, "n": 0.3289450810272502, "m": -0.2755221331364505, "theta_dot0": -0.0994744070991711,
        "Mg": 1.0, "x0": -0.03443183502206097, "z0": -0.3027260046752174, "l3": -0.11886788350097076,
    }  # fmt: skip
    ds = atlas.section("fixed_point", point, at="theta + 0.3 * psi_dot = 1.2 either", duration=40.0)
    times = [12.76239099606684, 12.901749789920519, 27.937414494348506, 28.0522941019892]
    angles = [3.0908105357456845, 3.0905818030261583, 3.086476516518967, 3.0862615628816092]
    assert ds["crossings"].item() == len(times)
    assert ds["status"].item() == Status.OK
    assert np.abs(ds["time"].values[0] - times).max() < 1e-9
    assert np.abs(ds["theta"].values[0] - angles).max() < 1e-9


# Passages at 2e-3 rad: rates there are exact to the state's errors times psi' / sin(theta); own runs in 80 bits.
NEAR_VERTICAL = [
    ({"A": 0.8347632080063832, "B": 0.8891981154643763, "C": 1.4213082834974573, "theta0": 1.4911071074785547,
      "psi0": -1.5311472576198206, "phi0": -1.4235516434465456, "n": -0.07979781652170105, "m": -0.4511415552410302,
      "theta_dot0": -0.049050829210480956, "k1": -0.07631817772148304, "k3": 0.1803221940585562}, "theta_dot = 0 falling", [24.629057292293012, 719.7578508809185]),
    ({"A": 1.47356214411652, "B": 1.4134708558070654, "C": 1.5397455410302987,
      "theta0": 0.5817583421222271, "psi0": -2.0095208139881606, "phi0": -1.63016180455272, "n": 0.540091839471506,
      "m": 1.3517902962682193, "theta_dot0": 0.05317351422686189, "k1": -0.019221477473105455, "k3": 0.05712619649762886}, "phi = 0.5 rising", [3.2156122993072946, -231.5132449872]),
]  # fmt: skip


@pytest.mark.parametrize(("point", "at", "expected"), NEAR_VERTICAL)
def test_errors_near_the_vertical_are_known(point, at, expected):
    ds = atlas.section("satellite", point, at=at, keep=["psi_dot"], duration=40.0)
    i = np.abs(ds["psi_dot"].values[0]).argmax()
    errors = np.abs([ds["time"].values[0, i], ds["psi_dot"].values[0, i]] - np.array(expected))
    assert errors[0] < 1e-9
    assert errors[1] < ds["error"].values[0, i] < 1e-5


@pytest.mark.long
def test_zeros_of_a_cosine():
    """Times and rates in closed form, of both directions."""
    ds = atlas.section(
        "oscillator", {"x0": [1.0, 2.0]}, at="x = 0 falling", keep=["x", "v", "x * v"], count=20
    )
    assert np.abs(ds["time"] - (np.arange(20) + 0.25) * 2 * np.pi).max() < 1e-9
    assert np.abs(ds["v"].values + np.array([[1.0], [2.0]])).max() < 1e-9
    assert (np.abs(ds["time"] - (np.arange(20) + 0.25) * 2 * np.pi) <= 3 * ds["error"]).all()
    assert ds.attrs["atlas_integral_spread"] == pytest.approx(0.75)
    assert "first integral energy" in ds.attrs["atlas_warnings"]
    either = atlas.section("oscillator", {}, at="-x = 0 either", count=4)
    assert np.abs(either["time"] - (np.arange(4) + 0.5) * np.pi).max() < 1e-9
    later = atlas.section("oscillator", {}, at="x = 0 falling", count=3, transient="10 / natural_rate")
    assert np.abs(later["time"] - (np.arange(3) + 2.25) * 2 * np.pi).max() < 1e-9


@pytest.mark.parametrize("depth", 10.0 ** -np.arange(1, 13))
def test_a_touch_is_two_crossings_or_none(depth):
    """x = cos t passes 1 - depth twice in each period, and 1 + depth never."""
    inside, outside = (
        atlas.section("oscillator", {"x0": 0.0, "v0": 1.0}, at=f"x = {float(level)!r} either", duration=19.0)
        for level in (1 - depth, 1 + depth)
    )
    assert outside["crossings"].item() == 0
    half = np.arccos(1 - depth)
    expected = np.add.outer(np.arange(3) * 2 * np.pi + np.pi / 2, [-half, half]).ravel()
    assert inside["crossings"].item() == 6
    # the rounding of x moves a touch by its root
    assert np.abs(inside["time"].values - expected).max() < 1e-10 + 1e-12 / half


def test_a_start_on_the_surface_is_no_crossing():
    ds = atlas.section("oscillator", {"x0": 0.0, "v0": [1.0, -1.0]}, at="x = 0 rising", duration=15.0)
    assert np.abs(ds["time"].values[:, 0] - [2 * np.pi, np.pi]).max() < 1e-9
    ds = atlas.section("satellite", BODY | {"n": 0.0, "psi0": 0.0}, at="psi = 0 either", duration=5.0)
    assert not (ds["time"] < 1e-3).any()


@pytest.mark.parametrize("at", ["theta_dot = 0 either", "psi_dot = 0.3 either"])
def test_a_motion_that_stays_on_the_surface_has_no_crossings(at):
    """The regular precession of a free top, C (m + n cos theta) = A n cos theta, where errors alone change the sign."""
    point = {"A": 1.0, "B": 1.0, "C": 1.5, "theta0": 0.5, "n": 0.3, "m": -0.1 * np.cos(0.5)}
    assert atlas.section("fixed_point", point, at=at, duration=50.0)["crossings"].item() == 0


@pytest.mark.long
def test_a_passage_of_the_vertical_hides_no_crossing():
    """A top whose axis passes the vertical at a small distance: psi' is a sharp peak there, and crosses a level twice a passage."""
    point = {"A": 1.0, "B": 1.0, "C": 0.5, "Mg": 1.0, "z0": 1.0, "theta0": 1.0, "n": 1e-3, "m": -5e-4}
    motion = atlas.trajectory(
        "fixed_point", point, duration=30.0, samples=200_001, tolerance=1e-10, method="rk8"
    )
    above = motion["psi_dot"].values > 0.5
    for word, changes in (("rising", ~above[:-1] & above[1:]), ("falling", above[:-1] & ~above[1:])):
        ds = atlas.section("fixed_point", point, at=f"psi_dot = 0.5 {word}", duration=30.0)
        times = motion["time"].values[1:][changes]
        assert ds["crossings"].item() == times.size > 2
        assert np.abs(ds["time"].values[0] - times).max() < 2e-4
        assert ds["psi_dot"].values == pytest.approx(0.5, abs=1e-6)


def test_status():
    """Where both runs have different numbers, where the step is too long, and where there is no body."""
    points = {**BODY, "k3": 0.01, "theta_dot0": np.linspace(0.2, 0.9, 24), "C": 1.6}
    ds = atlas.section("satellite", points, at="psi_dot = 0", duration=400.0, tolerance=1e-4)
    sensitive = ds["status"].values == Status.STEP_SENSITIVE
    assert sensitive.any()
    assert np.nanmax(ds["error"].values[sensitive]) > 1e-3
    ds = atlas.section("satellite", BODY | {"C": [1.4, 3.0]}, at="psi_dot = 0", duration=9.0)
    assert ds["status"].values.tolist() == [Status.OK, Status.IMPOSSIBLE_BODY]
    assert ds["crossings"].values[1] == 0
    assert np.isnan(ds["time"].values[1]).all()


REFUSED = [
    ({"at": "psi_dot"}, "at = 'psi_dot': allowed: two expressions with = between them, then \"rising\", \"falling\" or \"either\", such as ..."),
    ({"at": "psi_dot = 0 upwards"}, "at = 'psi_dot = 0 upwards': allowed: two expressions with = ..."),
    ({"at": "spin = 0"}, "at = ...: 'spin' is unknown; ..."),
    ({"at": "abs(g1) = 0.1"}, "at = ...: abs is not smooth; allowed: smooth functions"),
    ({"at": "A = B"}, "at = ...: no quantity of the motion; ..."),
    ({"at": "psi + phi = 0"}, "at = ...: psi and phi jump by a turn; allowed: one of them alone, ..."),
    ({"at": "g1 = 0", "keep": ["speed"]}, "keep: 'speed' is unknown; ..."),
    ({"at": "g1 = 0", "keep": ["time"]}, "keep: 'time' is unknown; ..."),
    ({"at": "g1 = 0", "keep": ["A"]}, "keep: 'A' is part of every section"),
    ({"at": "g1 = 0", "count": 0}, "count = 0: must be a whole number from 1 to 100000000"),
    ({"at": "g1 = 0", "duration": -1.0}, "duration = -1...: must be ..."),
    ({"at": "g1 = 0", "transient": "3 days"}, "transient = ...: allowed: ..."),
    ({"at": "g1 = 0", "method": "euler"}, "method = ..."),
]  # fmt: skip


@pytest.mark.parametrize(("options", "sentence"), REFUSED)
def test_refusals(options, sentence):
    assert_refused(lambda: atlas.section("satellite", BODY, **options), sentence)


def test_other_refusals():
    assert_refused(
        lambda: atlas.section("fixed_point", {"C": 1.0}, at="psi = 0"), "at = ...: 'psi' is unknown; ..."
    )
    grid = {"theta0": xr.DataArray([0.5, 0.6], dims="row")}
    assert_refused(lambda: atlas.section("satellite", grid, at="g1 = 0"), "points: an array along 'row'; ...")
    assert_refused(lambda: xr.Dataset().atlas.section_map(), "section_map: this dataset is no section; ...")
    ds = atlas.section("oscillator", {}, at="x = 0", count=3)
    assert_refused(lambda: ds.atlas.section_map("y"), "section_map: 'y': ...")
    assert_refused(lambda: ds.atlas.section_map(colour="y"), "section_map: 'y': ...")


def test_a_figure_has_a_dot_for_each_crossing():
    points = {**BODY, "theta0": [0.4, 0.9], "A": 1.1}
    ds = atlas.section("satellite", points, at="psi_dot = 0", duration=60.0)
    for colour in (None, "theta0", "regularity"):
        figure = ds.atlas.section_map("theta", "theta_dot", colour=colour, title="a title")
        (dots,) = figure.axes[0].collections
        assert len(dots.get_offsets()) == ds["crossings"].sum()
        assert [figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()] == [
            r"$\theta$ (rad)",
            r"$\dot{\theta}$ (rad s$^{-1}$)",
        ]


def test_dots_are_the_crossings_in_the_colours_of_the_bar():
    ds = atlas.section("satellite", {**BODY, "theta0": [0.4, 0.9], "A": 1.1}, at="psi_dot = 0", duration=60.0)
    figure = ds.atlas.section_map("theta_dot", "theta", colour="theta0", degrees=True)
    ax, bar = figure.axes
    assert [ax.get_xlabel(), ax.get_ylabel(), bar.get_ylabel()] == [
        r"$\dot{\theta}$ (rad s$^{-1}$)", r"$\theta$ (deg)", "theta0 (deg)",
    ]  # fmt: skip
    (dots,) = ax.collections
    crossings = np.isfinite(ds.theta.values)
    start = np.degrees(ds.theta0.values)[:, None] + 0 * ds.theta.values
    expected = np.stack([ds.theta_dot.values, np.degrees(ds.theta.values), start], -1)[crossings]
    drawn = np.concatenate([dots.get_offsets(), np.asarray(dots.get_array())[:, None]], 1)
    np.testing.assert_allclose(drawn, expected)


def test_regularity_is_measured_after_the_transient():
    points = {**BODY, "theta0": [0.4, 0.9]}
    ds = atlas.section("satellite", points, at="psi_dot = 0", duration=60.0, transient="20 / natural_rate")
    assert ds.attrs["atlas_transient"] == "20 / natural_rate"
    (dots,) = ds.atlas.section_map(colour="regularity").axes[0].collections
    assert len(dots.get_offsets()) == ds["crossings"].sum() > 0


SCENE = """
schema = 1
title = "Sections"
system = "satellite"
[fixed]
A = 1.0
B = 1.1
C = 1.4
k3 = 0.05
psi0 = 0.4
[axes.theta0]
from = 0.5
to = 1.0
count = 3
[axes.n]
from = 0.2
to = 0.4
count = 2
[integration]
duration = 10.0
"""


@pytest.mark.long
def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    command = ["section", "scene.toml", "--on", "theta_dot = 0 rising", "--count", "5"]
    assert cli.main([*command, "--at", "n=0.3", "--keep", "theta", "psi_dot", "-o", "s.nc"]) == cli.DONE
    assert "3 points, 15 crossings; wrote s.nc" in capsys.readouterr().out
    with xr.open_dataset("s.nc") as ds:
        assert {"theta", "psi_dot", "time", "error"} <= {*ds}
        expected = atlas.section(
            "satellite", {"A": 1.0, "B": 1.1, "C": 1.4, "k3": 0.05, "psi0": 0.4, "n": 0.3, "theta0": [0.5, 0.75, 1.0]},
            at="theta_dot = 0 rising", count=5,
        )  # fmt: skip
        assert np.abs(ds["time"] - expected["time"]).max() < 1e-9
    assert cli.main(command) == cli.DONE
    assert (tmp_path / "scene_section.png").stat().st_size > 1000
    on = 'section scene.toml --on "theta_dot = 0"'
    assert_refused_in_shell(f"{on} --at m=1 -o t.png", "--at m: no axis of the scene; ...", capsys)
    (tmp_path / "scene.toml").write_text(SCENE.replace("count = 3", "count = 3000"))
    assert_refused_in_shell(
        f"{on} -o t.png", "6000 points; a section of a scene has at most 4096: ...", capsys
    )
