"""Comparison of two atlases on the same grid."""

import re

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import load_scene, systems
from atlas.analysis import differences
from atlas.cli import main
from atlas.flags import Label

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
    constants = {name: np.ravel(p.default) for name, p in systems.SYSTEMS["satellite"].parameters.items()}
    points = {
        n: first[n].broadcast_like(first.label).values.ravel() if n in first else v
        for n, v in constants.items()
    }
    bound = systems.SYSTEMS["satellite"].frequency_bound(points).reshape(error.shape)
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


def test_an_error_estimate_of_an_observable_counts_over_its_magnitude(monkeypatch):
    system = type("System", (), {"observables": ("x",), "name": "pendulum"})()
    monkeypatch.setattr(differences, "system_of", lambda ds: system)
    monkeypatch.setattr(differences, "main_instrument", lambda system: type("Main", (), {"statistics": lambda self, system: ("x_mean",)})())  # fmt: skip
    first = xr.Dataset({"x_mean": ("point", [0.0, 1.0]), "x_min": ("point", [-4.0, 0.0]), "x_max": ("point", [1.0, 2.0]), "error_estimate": ("point", [1e-3, 1e-2])})  # fmt: skip
    second = first.assign(error_estimate=2e-3)
    np.testing.assert_allclose(differences._estimate(first, second, "x_mean"), [4 * 2e-3, 2 * 1e-2])
    assert differences._estimate(first.drop_vars("x_min"), second, "x_mean") is None


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


@pytest.mark.usefixtures("coarse_figures")
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
