"""Angles in degrees: where a caller or a scene asks for them, with the same points, lines and numbers as in rad."""

import re

import numpy as np
import pytest

import atlas
from atlas import BadInput
from atlas.cli import main


@pytest.fixture(scope="module")
def ds(scene_text):
    return atlas.run(atlas.load_scene(scene_text({})), progress=False)


def drawn(figure):
    """Label and limits of the y axis of a map, and the vertices of its lines of theory."""
    ax = figure.axes[0]
    return ax.get_ylabel(), np.array(ax.get_ylim()), [line.get_xydata() for line in ax.lines]


@pytest.mark.long
def test_a_map_in_degrees_has_the_lines_of_the_map_in_rad(ds):
    label, limits, lines = drawn(ds.atlas.map())
    in_degrees = drawn(ds.atlas.map(degrees=True))
    assert (label, in_degrees[0]) == (r"$\theta_0$ (rad)", r"$\theta_0$ (deg)")
    np.testing.assert_allclose(in_degrees[1], np.degrees(limits))
    assert lines
    for line, other in zip(lines, in_degrees[2], strict=True):
        if len(line) > 1:
            np.testing.assert_allclose(other, line * [1.0, np.degrees(1.0)])


@pytest.mark.long
def test_values_panels_and_points_in_degrees(ds, scene_text):
    figure = ds.atlas.map("theta_max", degrees=True)
    assert "(deg)" in figure.axes[-1].get_ylabel()
    assert figure.axes[0].collections[0].get_array().max() == pytest.approx(
        np.degrees(ds.theta_max.max().item())
    )
    points = atlas.label_points(
        "satellite", {"C": 0.8, "theta0": [0.2, 0.7, 1.1], "m": [0.5, 0.6, 0.9]}, duration=5.0
    )
    dots = points.atlas.map(x="theta0", y="m", degrees=True).axes[0]
    assert dots.get_xlabel() == r"$\theta_0$ (deg)"
    assert max(dots.collections[0].get_offsets()[:, 0]) == pytest.approx(np.degrees(1.1))
    panels = ds.isel(theta0=[0, 3]).atlas.map(x="sigma", col="theta0", degrees=True)
    assert [
        f"{np.degrees(v):.4g} deg" in ax.get_title()
        for v, ax in zip(ds.theta0[[0, 3]].values, panels.axes, strict=False)
    ]


@pytest.mark.long
def test_a_scene_asks_for_degrees_in_figures_alone(scene_text):
    scene = atlas.load_scene(scene_text({"axes.theta0.display_units": "deg"}))
    ds = atlas.run(scene, progress=False)
    assert ds.theta0.attrs["display_units"] == "deg"
    assert ds.theta0.attrs["units"] == "rad"
    assert atlas.load_scene(scene.toml()).toml() == scene.toml()
    assert drawn(ds.atlas.map())[0] == r"$\theta_0$ (deg)"
    assert drawn(ds.atlas.map(degrees=False))[0] == r"$\theta_0$ (rad)"
    assert drawn(ds.atlas.map(select={"sigma": 1.0}, x="theta0"))  # input stays in rad
    assert ds.atlas.boundary().theta0.attrs["units"] == "rad"
    assert ds.atlas.nearest(theta0=0.5).theta0.item() < 1.6


def test_tables_and_points_in_degrees(ds):
    rad, deg = ds.atlas.boundary(), ds.atlas.boundary(degrees=True)
    np.testing.assert_allclose(deg.theta0.values, np.degrees(rad.theta0.values))
    assert (deg.theta0.attrs["units"], deg.sigma.attrs["units"]) == ("degree", "1")
    selected = ds.atlas.select(label="drifting", degrees=True)
    np.testing.assert_allclose(
        selected.theta0.values, np.degrees(ds.atlas.select(label="drifting").theta0.values)
    )
    with pytest.raises(BadInput, match="theta0: units degree here, rad by the scene"):
        selected.isel(point=0).atlas.trajectory()
    value = ds.theta0.values[2]
    point = ds.atlas.nearest(sigma=1.0, theta0=np.degrees(value) + 0.5, degrees=True)
    assert point.theta0.item() == pytest.approx(np.degrees(value))
    assert point.label.item() == ds.atlas.nearest(sigma=1.0, theta0=value).label.item()
    with pytest.raises(BadInput, match=r"theta0 = 400: outside the atlas; allowed: [\d.]+ to 8\d"):
        ds.atlas.nearest(theta0=400.0, degrees=True)


def test_a_motion_in_degrees(ds):
    value = ds.theta0.values[2]
    rad = ds.atlas.trajectory(sigma=1.0, theta0=value, samples=201)
    deg = ds.atlas.trajectory(sigma=1.0, theta0=np.degrees(value), samples=201, degrees=True)
    np.testing.assert_allclose(deg.theta.values, np.degrees(rad.theta.values))
    assert np.array_equal(deg.psi_dot.values, rad.psi_dot.values)
    labels = [ax.get_ylabel() for figure in deg.atlas.plot().subfigs for ax in figure.axes]
    assert r"$\theta$ (deg)" in labels


def test_comparisons_print_degrees(ds):
    other = ds.assign(label=ds.label.copy(data=np.where(ds.theta0 > 1, 2, ds.label)).astype(np.int8))
    line = next(
        each for each in ds.atlas.compare(other, degrees=True).split("\n") if " to permanent_rotation" in each
    )
    theta0 = float(re.search(r"theta0 = ([\d.]+) deg", line)[1])
    assert np.isclose(np.radians(theta0), ds.theta0.values).any()
    assert " deg" not in ds.atlas.compare(other)


def test_wrong_values_are_one_line(ds, scene_text):
    for ask in (
        ds.atlas.map, ds.atlas.boundary, ds.atlas.select, ds.atlas.nearest, ds.atlas.trajectory,
        ds.atlas.compare,
    ):  # fmt: skip
        with pytest.raises(BadInput, match=r"^degrees = 'yes': must be true or false$"):
            ask(degrees="yes")
    for changes, message in (
        ({"axes.theta0.display_units": "gon"}, "axes.theta0.display_units = 'gon': allowed: rad, deg"),
        ({"axes.theta0.display_units": 1}, "axes.theta0.display_units = 1: "),
        (
            {"axes.sigma.display_units": "deg"},
            "axes.sigma.display_units = 'deg': only of angles with units = 'rad'; sigma has '1'",
        ),
    ):
        with pytest.raises(BadInput, match=f"^{re.escape(message)}"):
            atlas.load_scene(scene_text(changes))


@pytest.mark.long
def test_the_shell_takes_and_shows_degrees(ds, scene_text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(scene_text({}))
    assert main(["run", "a.toml", "--quiet"]) == 0
    assert main(["map", "a.nc", "-o", "a.svg", "--degrees"]) == 0
    assert main(["compare", "a.nc", "--degrees"]) == 0
    at = ["--at", "sigma=1.0", "theta0=40 * deg", "-o", "a_motion.nc"]
    assert main(["trajectory", "a.toml", *at]) == 0
    assert atlas.open_atlas("a_motion.nc").theta.values[0] == pytest.approx(np.radians(40), abs=1e-3)
    capsys.readouterr()
    assert main(["trajectory", "a.toml", "--at", "sigma=1.0", "theta0=forty", "--force"]) == 2
    message = '--at theta0=forty: must be AXIS=VALUE with a finite number, or arithmetic such as "60 * deg"'
    assert message in capsys.readouterr().err
