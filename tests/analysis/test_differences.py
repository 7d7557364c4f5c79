"""Comparison of two atlases on the same grid."""

import re

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import load_scene
from atlas.cli import main
from atlas.flags import Label
from atlas.systems import Observable, Parameter, System

NAMES = list(Label.meanings())


@pytest.fixture(scope="module")
def pair(small_scene, scene_text):
    longer = load_scene(scene_text({"integration.duration": 60.0}))
    return atlas.run(load_scene(small_scene), progress=False), atlas.run(longer, progress=False)


def rows(report):
    """Lines of the table of numbers: name -> largest difference, beside the error estimate, place."""
    lines = report.split("\n")
    table = lines[next(i for i, line in enumerate(lines) if line.startswith("variable")) + 1 :]
    return {
        line.split()[0]: re.split(r"\s\s+", line)[1:] for line in table if not line.startswith("the same")
    }


@pytest.mark.long
def test_changes_of_labels_are_counted_and_located(pair):
    first, second = pair
    text = first.atlas.compare(second)
    changed = first.label.values != second.label.values
    assert 0 < changed.sum() < 5
    assert f"label: {changed.sum()} of 63 points change ({100 * changed.sum() / 63:.3g} %)" in text
    assert "-duration = 30.0" in text
    assert "+duration = 60.0" in text
    i, j = np.argwhere(changed)[0]
    before, after = NAMES[first.label.values[i, j]], NAMES[second.label.values[i, j]]
    place = f"sigma = {float(first.sigma[i]):.9g}, theta0 = {float(first.theta0[j]):.9g}"
    assert f"  {place}: {before} to {after}" in text
    table = re.search(rf"^ +{before} *((?: +\d+)+)$", text, re.MULTILINE)[1].split()
    both = [(first.label == NAMES.index(before)) & (second.label == NAMES.index(n)) for n in (before, after)]
    assert sorted(map(int, table)) == sorted(int(each.sum()) for each in both)
    assert f"  {place}" not in first.atlas.compare(second, worst=0)


def test_numbers_differ_beside_the_larger_error_estimate(pair):
    first, second = pair
    table = rows(first.atlas.compare(second))
    error = np.fmax(first.error_estimate, second.error_estimate).values
    constants = {name: np.ravel(p.default) for name, p in atlas.systems.get("satellite").parameters.items()}
    points = {
        n: first[n].broadcast_like(first.label).values.ravel() if n in first else v
        for n, v in constants.items()
    }
    bound = atlas.systems.get("satellite").frequency_bound(points).reshape(error.shape)
    for name, unit in {"theta_max": 1.0, "psi_dot_std": bound}.items():
        difference = np.abs(first[name] - second[name]).values
        ratio = difference / (error * unit)
        i, j = np.unravel_index(ratio.argmax(), ratio.shape)
        place = f"sigma = {float(first.sigma[i]):.9g}, theta0 = {float(first.theta0[j]):.9g}"
        assert table[name][0] == f"{difference.max():.3g}"
        assert float(table[name][1]) == pytest.approx(ratio.max(), rel=0.01)
        assert table[name][2] == place
    assert table["end_time"][1] == "-"


def test_an_atlas_equals_itself_and_missing_values_are_infinite_differences(pair):
    first, _ = pair
    text = first.atlas.compare(first.copy())
    assert "change (" not in text
    assert "variable" not in text
    assert text.split("\n")[-1].startswith("the same at every point: label, ")
    holes = first.assign(theta_max=first.theta_max.where(first.sigma > 0.5))
    assert rows(first.atlas.compare(holes))["theta_max"][:2] == ["inf", "inf"]


class Oscillator(System):
    """x'' = -x."""

    class equations:
        STATE, CONSTANTS, INTEGRALS = ("x", "v"), (), ()

        def rhs(state, constants):
            x, v = state
            return v, -x

    name = title = "oscillator"
    parameters = {"x0": Parameter("x0", "1", "start", 1.0, start=True)}  # noqa: RUF012
    observables = (Observable("x", "1", "x"),)

    def initial_state(self, points):
        return np.array([points["x0"], 0.0 * points["x0"]])


def test_an_error_estimate_of_an_observable_counts_over_its_magnitude(own_systems):
    atlas.register(Oscillator)
    numbers = {
        "x_mean": [0.0, 1.0],
        "x_min": [-4.0, 0.0],
        "x_max": [1.0, 2.0],
        "error_estimate": [1e-3, 1e-2],
    }
    first = xr.Dataset(
        {name: ("point", values) for name, values in numbers.items()}, attrs={"atlas_system": "oscillator"}
    )
    for change, over in (([0.5, 0.0], 0.5 / (4 * 2e-3)), ([0.0, 0.5], 0.5 / (2 * 1e-2))):
        second = first.assign(error_estimate=0 * first.error_estimate + 2e-3, x_mean=first.x_mean + change)
        assert rows(first.atlas.compare(second))["x_mean"][:2] == ["0.5", f"{over:.3g}"]
        assert rows(first.drop_vars("x_min").atlas.compare(second))["x_mean"][:2] == ["0.5", "-"]


@pytest.mark.long
def test_differences_are_an_atlas_to_be_mapped(pair):
    first, second = pair
    ds = first.atlas.differences(second)
    same = first.label.values == second.label.values
    np.testing.assert_array_equal(ds.label_change, np.where(same, 0, second.label.values + 1))
    np.testing.assert_array_equal(ds.theta_max_difference, second.theta_max.values - first.theta_max.values)
    assert ds.label_change.attrs["flag_meanings"].split()[:3] == [
        "unchanged",
        "to_not_computed",
        "to_regular_precession",
    ]
    texts = [t.get_text() for t in ds.atlas.map(boundary=False).legends[0].get_texts()]
    assert texts[:2] == ["unchanged", "to drifting"]
    assert ds.atlas.map("theta_max_difference", boundary=False).axes
    chunked = first.chunk(sigma=4).atlas.differences(second)
    assert chunked.label_change.chunks is not None
    xr.testing.assert_identical(chunked.compute(), ds)
    assert first.chunk(sigma=4).atlas.compare(second.transpose()) == first.atlas.compare(second)


def test_atlases_of_points_without_axes_are_compared(pair):
    free = xr.Dataset({"label": ("point", np.int8([1, 2]))}, {"m": ("point", [0.1, 0.2])}, pair[0].attrs)
    assert "the same at every point: label" in free.atlas.compare(free.copy())


@pytest.mark.long
@pytest.mark.usefixtures("coarse_lines")
def test_the_command_prints_and_draws_differences(pair, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, ds in zip("ab", pair, strict=True):
        ds.assign_attrs(atlas_scene="").to_netcdf(
            f"{name}.nc"
        )  # without lines of theory, which take some seconds
    assert main(["compare", "a.nc", "b.nc", "--worst", "1", "-o", "changes.png"]) == 0
    output = capsys.readouterr().out
    with atlas.open_atlas("a.nc") as a, atlas.open_atlas("b.nc") as b:
        assert output == f"{a.atlas.compare(b, worst=1)}\nwrote changes.png\n"
    assert (tmp_path / "changes.png").read_bytes().startswith(b"\x89PNG")
    assert main(["compare", "a.nc", "b.nc", "-o", "changes.nc"]) == 0
    with atlas.open_atlas("changes.nc") as changes:
        xr.testing.assert_equal(changes.load(), pair[0].atlas.differences(pair[1]))
