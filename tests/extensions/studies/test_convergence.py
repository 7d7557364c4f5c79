"""How labels depend on duration and tolerances: each row is that of a run with the setting changed."""

import csv

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, cli, load_scene
from atlas.analysis.metadata import flag_names
from atlas.extensions.studies import convergence
from atlas.extensions.studies.convergence import CHANGE, FACTORS, VARIED


@pytest.fixture(scope="module")
def study(scene_text):
    scene = load_scene(scene_text({"integration.duration": 12.0}))
    return scene, convergence.convergence(scene, ["duration", "rate_tolerance"], progress=False)


@pytest.mark.long
def test_labels_are_those_of_runs_with_other_settings(study, scene_text):
    _, ds = study
    for name, changes in (
        ("duration", {"integration.duration": 24.0}),
        ("rate_tolerance", {"integration.duration": 12.0, "labels.rate_tolerance": 2e-3}),
    ):
        run = atlas.run(load_scene(scene_text(changes)), progress=False)
        for flag in ("label", "label_inertial"):
            varied = ds[f"{flag}_of_{name}"].sel({f"{name}_factor": 2.0})
            np.testing.assert_array_equal(varied.values, run[flag].values)
    unchanged = atlas.run(study[0], progress=False)
    np.testing.assert_array_equal(ds.label.values, unchanged.label.values)
    np.testing.assert_array_equal(ds.label_of_duration.sel(duration_factor=1.0), unchanged.label)
    assert set(unchanged.coords) < set(ds.coords)


def test_points_that_change_are_flagged_and_counted(study):
    _, ds = study
    by = {}
    for name in ("duration", "rate_tolerance"):
        by[name] = np.zeros(ds.label.shape, bool)
        for flag in ("label", "label_inertial"):
            for factor in VARIED[name]:
                by[name] |= ds[f"{flag}_of_{name}"].sel({f"{name}_factor": factor}).values != ds[flag].values
    meanings = np.array(ds[CHANGE].attrs["flag_meanings"].split())
    assert list(meanings) == [
        "unchanged",
        "by_duration",
        "by_rate_tolerance",
        "by_duration_and_rate_tolerance",
    ]
    np.testing.assert_array_equal(ds[CHANGE].values, by["duration"] + 2 * by["rate_tolerance"])
    assert len(np.unique(ds[CHANGE])) > 1
    rows = [dict(zip(convergence.HEAD, row, strict=True)) for row in convergence.rows(ds)]
    rows = [row for row in rows if row["variable"] == "label" and row["setting"] == "duration"]
    assert [float(row["factor"]) for row in rows] == list(FACTORS)
    for row in rows:
        varied = ds.label_of_duration.sel(duration_factor=float(row["factor"]))
        assert int(row["changed"]) == int((varied != ds.label).sum())
        pairs = {f"{a} to {b}": 0 for a in flag_names(ds.label) for b in flag_names(ds.label)}
        for a, b in zip(ds.label.values.ravel(), varied.values.ravel(), strict=True):
            pairs[f"{flag_names(ds.label)[a]} to {flag_names(ds.label)[b]}"] += int(a != b)
        shown = dict(each.rsplit(" ", 1) for each in row["changes"].split("; ") if each)
        assert all(pairs[change] == int(count) > 0 for change, count in shown.items())
        assert float(row["percent"]) == pytest.approx(100 * float((varied != ds.label).mean()), rel=5e-3)
    share = 100 * float((ds[CHANGE] != 0).mean())
    assert f"{int((ds[CHANGE] != 0).sum())} of 63 points ({share:.3g} %) change with" in convergence.report(
        ds
    )
    (changes,) = [row["changes"] for row in rows if row["factor"] == "4"]
    assert changes.startswith("permanent_rotation to drifting ")
    assert "2 or 4 times the duration, 0.25 or 0.5 or 2 or 4 times the rate_tolerance" in convergence.report(
        ds
    )


@pytest.mark.long
def test_twice_the_transient_shows_whether_it_is_over(scene_text):
    """Damped satellites of which some have come to rest."""
    changes = {"integration.duration": 6.0, "fixed.damping": 0.4, "labels.transient": "12 / Omega"}
    changes |= {"family": None, "nudge": None}
    scene = load_scene(scene_text(changes))
    ds = convergence.convergence(scene, ["transient"], progress=False)
    run = atlas.run(load_scene(scene_text(changes | {"labels.transient": 24.0})), progress=False)
    np.testing.assert_array_equal(ds.label_of_transient.sel(transient_factor=2.0), run.label)
    np.testing.assert_array_equal(ds.label_of_transient.sel(transient_factor=1.0), ds.label)
    assert 0 < (ds[CHANGE] != 0).sum() < ds[CHANGE].size
    assert "2 or 4 times the transient" in convergence.report(ds)
    with pytest.raises(BadInput, match=r"^transient: the scene has none; labels.transient gives it one$"):
        convergence.convergence(load_scene(scene_text({})), ["transient"])


@pytest.mark.long
def test_a_large_grid_is_thinned_and_a_refined_one_taken_coarse(scene_text, monkeypatch):
    sizes = []
    columns = convergence.columns_of
    monkeypatch.setattr(
        convergence, "columns_of", lambda plan, bar: sizes.append(plan.scene.shape) or columns(plan, bar)
    )
    text = scene_text({"axes.sigma.count": 90, "axes.theta0.count": 70, "axes.h3.values": [0.0]})
    ds = convergence.convergence(load_scene(text), ["tolerance", "tolerance"], 63, progress=False)
    assert set(sizes) == {(9, 7, 1)}
    assert len(sizes) == len(FACTORS)
    np.testing.assert_array_equal(ds.sigma[[0, -1]], [0.3, 1.7])
    assert load_scene(ds.attrs["atlas_scene"]).shape == (9, 7, 1)
    sizes.clear()
    ds = convergence.convergence(load_scene(scene_text({"refine.levels": 3})), ["duration"], progress=False)
    assert sizes[0] == (9, 7)
    assert load_scene(ds.attrs["atlas_scene"]).shape == (9, 7)


def test_a_step_is_varied_in_place_of_the_tolerance(scene_text):
    scene = load_scene(scene_text({"integration.tolerance": None, "integration.step": 0.1}))
    assert convergence._with_setting(scene, "tolerance", 0.5).settings.step == 0.05


def test_the_command_writes_table_map_and_numbers(scene_text, tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(scene_text({}))
    names = [f"{tmp_path}/a{suffix}" for suffix in (".nc", ".csv", ".png")]
    command = ["accuracy", "--vary", "duration", "rate_tolerance", "-o", *names, "--points", "30"]
    assert cli.main([*command, str(tmp_path / "scene.toml")]) == cli.DONE
    text = capsys.readouterr().out
    assert "permanent_rotation to drifting" in text
    with xr.open_dataset(names[0]) as ds:
        assert ds.sizes == {"sigma": 7, "theta0": 5, "duration_factor": 5, "rate_tolerance_factor": 5}
    with open(names[1], newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 5
    assert (tmp_path / "a.png").stat().st_size > 10_000
    assert cli.main(["accuracy", str(tmp_path / "scene.toml"), "--vary", "durations"]) == cli.BAD_INPUT
    assert "durations: cannot be varied; " in capsys.readouterr().err
    with pytest.raises(BadInput, match="step: cannot be varied"):
        convergence.convergence(load_scene(scene_text({})), ["step"])
