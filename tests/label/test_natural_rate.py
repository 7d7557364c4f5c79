"""Durations and tolerances in natural rates: words do not depend on the unit of time."""

from dataclasses import replace

import numpy as np
import pytest
from family_starts import STARTS
from strategies import default_points, in_units, random_fixed_points, random_satellites, select
from truth import assert_at_points

import atlas
from atlas import systems
from atlas.cli import main
from atlas.flags import Label, Status
from atlas.plotting.style import caption
from atlas.scene.grid import durations, points_at_indices, unit_warnings
from atlas.scene.model import Duration
from atlas.scene.read import load_scene, parse_scene
from atlas.systems import System
from atlas.systems.gyrostat.body import SLOW

pytestmark = pytest.mark.usefixtures("whole_kernels")

SATELLITE, TOP = systems.get("satellite"), systems.get("fixed_point")


def rate(system, **given):
    return system.natural_rate(default_points(system.name, **given))


def test_natural_rate_of_a_satellite():
    assert rate(SATELLITE, Omega=[2.5, -2.0], m=50.0) == pytest.approx([2.5, 2.0])
    # Without an orbit a compass needle of the largest moment in the field of both components.
    magnet = {"Omega": 0.0, "mu1": 0.3, "mu2": -0.4, "B": 1.5, "h1": 0.2, "h3": 3.0}
    small = 0.5**0.5 * (0.2 + 3.0) ** 0.5 / 1.5**0.5
    assert rate(SATELLITE, **magnet) == pytest.approx(small, rel=1e-14)
    assert rate(SATELLITE, Omega=0.0, m=-3.0, k1=2.4) == pytest.approx(3.0 + 2.0)
    assert rate(SATELLITE, Omega=0.0) == 1.0


def test_natural_rate_of_a_body_about_a_fixed_point():
    assert rate(TOP, Mg=2.0, z0=0.6) == pytest.approx(1.0)  # a pendulum of the largest moment
    assert rate(TOP, N=0.25) == pytest.approx(0.5)
    assert rate(TOP, N=0.25, A=1.2, B=1.2) == 1.0  # turns no sphere
    assert rate(TOP, Mg=2.0, z0=0.6, N=0.25, m=9.0) == pytest.approx(1.25**0.5)
    assert rate(TOP, m=-7.0, l2=6.0) == pytest.approx(7.0 + 5.0)
    assert rate(TOP) == 1.0


@pytest.mark.parametrize("factor", [1 - 1e-9, 1 + 1e-9])
def test_slow_frames_and_fields_do_not_count(factor):
    spin = 40.0
    slow = spin * SLOW * factor
    expected = slow if factor > 1 else spin
    assert rate(TOP, m=spin, Mg=1.2 * slow**2, z0=1.0) == pytest.approx(expected, rel=1e-12)
    # The frame turns with the body: its angular velocity is n + Omega about the vertical.
    at_right_angle = {"theta0": np.pi / 2, "n": -slow, "m": spin}
    assert rate(SATELLITE, Omega=slow, **at_right_angle) == pytest.approx(expected, rel=1e-12)


class Plain(type(TOP)):
    """Tops without a natural rate."""

    natural_rate = System.natural_rate


class Own(type(TOP)):
    """Tops with a natural rate of a test."""

    def natural_rate(self, points):
        return 4.0 * points["A"]


def test_other_systems_have_1_unless_they_give_one():
    points = default_points("fixed_point", Mg=4.0, z0=1.2)
    for system, natural_rate in ((TOP, 2.0), (Plain(), 1.0), (Own(), 4.0)):
        np.testing.assert_array_equal(durations(system, Duration(), points), 60 / natural_rate)
    short = points_at_indices(load_scene(SCENE.replace("24 /", "2 /")), np.arange(2))
    assert unit_warnings(Plain(), ["label"], short) == []
    assert len(unit_warnings(SATELLITE, ["label"], short)) == 1


def bodies(name, seed, count=10):
    """Random bodies, and exact starts on families."""
    rng = np.random.default_rng(seed)
    draw = random_satellites if name == "satellite" else random_fixed_points
    parts = [draw(rng, count)]
    if name == "satellite":
        parts.append(draw(rng, 2, Omega=0.0))
    kinds = list(STARTS[name])
    for kind in rng.choice(kinds, 2, replace=False):
        starts = STARTS[name][kind](rng, 8)
        parts.append(select(starts, slice(0, 4)))
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


@pytest.mark.usual("1e-08")
@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
@pytest.mark.parametrize("unit", [2.0**-40, 1e-8, 1e8])
def test_no_word_depends_on_the_unit_of_time(name, unit):
    points = bodies(name, 74)
    first, second = (
        atlas.label_points(name, each, method="rk8", tolerance=1e-6)
        for each in (points, in_units(points, 1 / unit))
    )
    is_power = unit == 2.0**-40
    for key, values in first.data_vars.items():
        if values.dtype.kind != "f":
            assert_at_points(values, second[key], points, 74)
        elif is_power:
            time = {"rad s-1": -1, "s": 1}.get(values.attrs["units"], 0)
            assert_at_points(values * unit**-time, second[key], points, 74)
    assert set(first.label.values.tolist()) > {Label.DRIFTING}
    assert first.attrs["atlas_rate_tolerance"] == "1e-5 * natural_rate"


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
def test_no_end_depends_on_the_unit_of_time(name):
    rng = np.random.default_rng(7)
    draw = random_satellites if name == "satellite" else random_fixed_points
    points = draw(rng, 16, damping=rng.choice([0.05, 0.3], 16))
    names = ["end_equilibrium", "settled_by", "settling_time"]
    unit = 2.0**-40
    first, second = (
        atlas.label_points(name, each, variables=names, method="rk8", tolerance=1e-6)
        for each in (points, in_units(points, 1 / unit))
    )
    for key in names:
        time = unit if key == "settling_time" else 1.0
        assert_at_points(first[key] / time, second[key], points, 7)
    assert (first.end_equilibrium >= 0).sum() > 4


@pytest.mark.long
def test_a_chaotic_tumble_in_si_is_no_permanent_rotation():
    """The libration of an asteroid on an eccentric... orbit of months: its rates are far below 1e-5 rad/s."""
    point = {"A": 1.0, "B": 1.6, "C": 2.0, "Omega": 2.66e-6, "theta0": 1.2, "psi0": 0.4, "m": 3e-6}
    ds = atlas.label_points("satellite", point, duration="50 orbits")
    assert (ds.label.item(), ds.status.item()) == (Label.DRIFTING, Status.OK)
    ds = atlas.label_points("satellite", point | {"theta0": np.array([0.8, 1.2])})
    assert (ds.label == Label.DRIFTING).all()
    ds = atlas.label_points("satellite", point, duration=60.0, rate_tolerance=1e-5)
    assert ds.label.item() == Label.PERMANENT_ROTATION  # the numbers are absolute, and both warned of
    for text in ("1 of 1 points: rate_tolerance is above 0.01", "1 of 1 points: the duration is shorter"):
        assert text in ds.attrs["atlas_warnings"]


def test_texts_are_evaluated_at_each_point():
    points = {"Omega": np.array([0.5, 2.0]), "theta0": 0.6, "C": np.array([1.3, 1.4])}
    numbers = {
        "duration": np.array([40.0, 10.0]),
        "variables": ["end_time", "label", "psi_dot_std", "natural_rate"],
    }
    by_number = atlas.label_points("satellite", points, rate_tolerance=1e-4, **numbers)
    texts = numbers | {"duration": "20 / Omega", "rate_tolerance": "1e-4 * Omega * 1.0"}
    by_text = atlas.label_points("satellite", points, **texts)
    np.testing.assert_allclose(by_text.end_time, [40.0, 10.0], rtol=1e-15)
    np.testing.assert_array_equal(by_text.natural_rate, points["Omega"])
    np.testing.assert_array_equal(by_number.end_time, by_text.end_time)
    assert by_text.attrs["atlas_rate_tolerance"] == "1e-4 * Omega * 1.0"
    motion = atlas.trajectory("satellite", {"Omega": 2.0, "theta0": 0.6}, duration="20 / Omega", samples=3)
    assert motion.time.values[-1] == 10.0
    assert atlas.trajectory("satellite", {"Omega": 2.0}, samples=3).time.values[-1] == 30.0


def test_points_without_a_value_are_masked_and_counted():
    ds = atlas.label_points(
        "satellite", {"Omega": np.array([1.0, 0.0])}, duration="9 / Omega", rate_tolerance=1e-5
    )
    assert ds.status.values.tolist() == [Status.OK, Status.NOT_COMPUTED]
    assert ds.attrs["atlas_warnings"].startswith("1 of 2 points: duration = '9 / Omega', but it is no finite")
    ds = atlas.label_points("satellite", {"Omega": np.array([1.0, 0.0])}, rate_tolerance="1e-5 * Omega")
    assert ds.status.values.tolist() == [Status.OK, Status.NOT_COMPUTED]
    assert ds.attrs["atlas_warnings"].startswith("1 of 2 points: rate_tolerance is no finite number above 0")


SCENE = """
schema = 1
system = "satellite"
[fixed]
theta0 = 0.6
C = 1.4
[axes.rate]
values = [0.5, 1.0, 2.0]
[ties]
Omega = "2 * rate"
[integration]
duration = "24 / rate"
[labels]
rate_tolerance = "1e-4 * rate"
"""


@pytest.mark.long
def test_scenes_take_texts_in_parameters_and_axes(tmp_path):
    scene = load_scene(SCENE)
    round_trip = parse_scene(scene.toml())
    assert round_trip.duration == scene.duration
    assert round_trip.settings == replace(scene.settings, cylinder_tolerance=1e-5)
    assert scene.settings.cylinder == 1e-5
    ds = atlas.run(scene, tmp_path / "a.nc", progress=False)
    np.testing.assert_allclose(ds.end_time, [48.0, 24.0, 12.0])
    by_number = load_scene(SCENE.replace('"24 / rate"', "48.0").replace('"1e-4 * rate"', "5e-5"))
    one = atlas.run(by_number, progress=False)
    assert one.label.values[0] == ds.label.values[0]
    np.testing.assert_array_equal(one.psi_dot_mean.values[0], ds.psi_dot_mean.values[0])
    motion = ds.atlas.trajectory(rate=2.0, samples=3)
    assert motion.time.values[-1] == 12.0
    assert motion.attrs["atlas_rate_tolerance"] == 2e-4
    assert "within 1e-4 * rate rad per time unit" in caption(ds)


def test_defaults_of_a_scene_are_texts():
    scene = load_scene('schema = 1\nsystem = "satellite"\n[axes.C]\nvalues = [1.2, 1.4]\n')
    assert 'duration = "60 / natural_rate"' in scene.toml()
    assert 'rate_tolerance = "1e-5 * natural_rate"' in scene.toml()
    given = {"system": "satellite", "schema": 1, "axes": {"C": {"values": [1.2, 1.4]}}}
    numbers = given | {"integration": {"duration": 60}, "labels": {"rate_tolerance": 1e-5}}
    by_default, by_number = (atlas.run(each, progress=False) for each in (given, numbers))
    for name, values in by_default.data_vars.items():
        np.testing.assert_array_equal(values, by_number[name], name)


def test_check_says_what_texts_are_in_numbers(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("24 / rate", "2 / rate"))
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    assert (
        'duration = "2 / rate" is 1 to 4 time units; rate_tolerance = "1e-4 * rate" is 5e-05 to 0.0002 rad per time unit\n'
    ) in printed
    assert "warning: 3 of 3 points: the duration is shorter than a period of natural_rate" in printed
    path.write_text(
        SCENE.replace("[labels]", '[outputs]\nvariables = ["predicted"]\n[labels]').replace("24 /", "2 /")
    )
    assert main(["check", str(path)]) == 0
    assert "warning" not in capsys.readouterr().out  # no label is measured


@pytest.mark.long
def test_reuse_compares_the_tolerance_of_each_point(tmp_path, evaluated):
    """An atlas of one number has those points of the text where both are equal."""
    old = tmp_path / "old.nc"
    atlas.run(
        load_scene(SCENE.replace('"1e-4 * rate"', "1e-4\ncylinder_tolerance = 1e-5")), old, progress=False
    )
    evaluated.clear()
    ds = atlas.run(load_scene(SCENE), tmp_path / "new.nc", reuse=[old], progress=False)
    assert sum(evaluated) == 2
    fresh = atlas.run(load_scene(SCENE), progress=False)
    np.testing.assert_array_equal(ds.psi_dot_std, fresh.psi_dot_std)


@pytest.mark.long
def test_an_atlas_of_points_keeps_its_text(tmp_path):
    """Its trajectory takes the steps of the atlas, by the tolerance of that point."""
    points = {"Omega": np.array([1e-3, 1.0]), "theta0": 0.6, "C": 1.4}
    ds = atlas.label_points(
        "satellite", points, method="rk8", variables=["theta_dot_rms", "end_time", "step"]
    )
    ds.to_netcdf(tmp_path / "points.nc")
    with atlas.open_atlas(tmp_path / "points.nc") as read:
        motion = read.atlas.trajectory(Omega=1e-3, samples=2)
        assert motion.time.values[-1] == 6e4
        assert motion.attrs["atlas_rate_tolerance"] == 1e-8
        assert float(motion.step) == pytest.approx(float(ds.step[0]), rel=1e-12)
