"""Atlases that take points from earlier ones: equal to the bit to a fresh run, and refused where they would not be."""

import re

import numpy as np
import pytest
import xarray as xr
from truth import assert_same_bytes, state, tile_path

import atlas
from atlas import BadInput, cli, load_scene
from atlas.flags import Label
from atlas.interruption import STOPPED, Stopped
from atlas.label.plan import Plan
from atlas.runs import estimate, memory, plan, reuse
from atlas.runs.run import RunFolder
from atlas.store.dataset import HISTORY

SIGMA = [0.3 + i * (1.4 / 8) for i in range(9)]
WIDER = {"axes.sigma": {"values": [*SIGMA[::-1], 0.45, 1.9]}, "axes.theta0.count": 13}


@pytest.fixture(scope="module")
def old(scene_text, tmp_path_factory):
    """Path of an atlas of 63 points."""
    path = tmp_path_factory.mktemp("old") / "old.nc"
    atlas.run(load_scene(scene_text({"axes.sigma": {"values": SIGMA}})), path, progress=False).close()
    return path


@pytest.mark.usual("a part", "other points under the same names")
@pytest.mark.parametrize(
    ("changes", "shared"),
    [
        pytest.param(WIDER, 63, id="finer and longer axes in another order"),
        pytest.param(
            {"axes.sigma": {"values": SIGMA[2:5]}, "axes.theta0": {"values": [0.2]}}, 3, id="a part"
        ),
        pytest.param(
            {"axes.sigma": {"values": SIGMA}, "fixed.m": None, "axes.m": {"values": [0.25, 0.5]}},
            63,
            id="a fixed parameter becomes an axis",
        ),
        pytest.param(
            {"axes.sigma": {"values": SIGMA}, "integration.duration": "4.5 orbits", "ties.psi0": None}
            | {"fixed.psi0": np.pi / 2, "fixed.Omega": 0.3 * np.pi},
            None,
            id="other points under the same names",
        ),
    ],
)
def test_an_extended_atlas_is_a_fresh_one_and_only_new_points_are_integrated(
    old, scene_text, changes, shared, evaluated, monkeypatch, tmp_path
):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "40")
    scene = load_scene(scene_text(changes))
    if shared is None:
        with pytest.raises(BadInput, match="none of 63 points of it, evenly chosen, is a point of the scene"):
            atlas.run(scene, reuse=old, progress=False)
        return
    fresh = atlas.run(scene, progress=False)
    assert sum(evaluated) == int((fresh.status > 0).sum())
    for out in (None, tmp_path / "new.nc"):
        evaluated.clear()
        ds = atlas.run(scene, out, reuse=[old], progress=False)
        assert sum(evaluated) == int((fresh.status > 0).sum()) - shared
        assert_same_bytes(fresh, ds)
        (line,) = ds.attrs[HISTORY].split("\n")
        assert line.startswith(f"{shared} points of: small; Precession Atlas")


@pytest.mark.long
def test_points_with_the_same_transient_are_taken(scene_text, tmp_path, evaluated):
    """Of two transients that are arithmetic, equal along one half of an axis."""
    changes = {"axes.sigma": {"values": SIGMA}, "labels.transient": "5 + 0 * sigma"}
    atlas.run(load_scene(scene_text(changes)), tmp_path / "old.nc", progress=False).close()
    scene = load_scene(scene_text(changes | {"labels.transient": "5 + abs(sigma - 0.9) + sigma - 0.9"}))
    fresh = atlas.run(scene, progress=False)
    some = int((fresh.status.where(fresh.sigma < 0.89, 0) > 0).sum())
    every = int((fresh.status > 0).sum())
    evaluated.clear()
    extended = atlas.run(scene, reuse=tmp_path / "old.nc", progress=False)
    assert 0 < sum(evaluated) < every
    assert every - sum(evaluated) <= some
    assert_same_bytes(fresh, extended)
    assert extended.attrs["atlas_transient"] == "5 + abs(sigma - 0.9) + sigma - 0.9"


def test_a_zero_with_another_sign_is_another_point(old, scene_text):
    """As starts and in the bits of results 0.0 and -0.0 differ."""
    scene = load_scene(scene_text({"axes.sigma": {"values": SIGMA}, "fixed.phi0": -0.0}))
    with pytest.raises(BadInput, match="none of 63 points of it, evenly chosen, is a point of the scene"):
        atlas.run(scene, reuse=old, progress=False)


def test_variables_of_theory_are_added_without_integrating(old, scene_text, evaluated):
    names = ["label", "theta_dot_rms", "frequency_1", "stability_kind", "status"]
    scene = load_scene(scene_text({"axes.sigma": {"values": SIGMA}, "outputs": {"variables": names}}))
    fresh = atlas.run(scene, progress=False)
    evaluated.clear()
    assert_same_bytes(fresh, atlas.run(scene, reuse=str(old), progress=False))
    assert sum(evaluated) == 0


@pytest.mark.long
def test_atlases_are_joined_and_extended_again_with_the_provenance_of_all(
    old, scene_text, tmp_path, evaluated
):
    right = scene_text({"axes.sigma": {"values": [1.8, 1.9]}, "title": "right"})
    atlas.run(load_scene(right), f"{tmp_path}/right/", progress=False)
    both = load_scene(scene_text({"axes.sigma": {"values": [*SIGMA, 1.8, 1.9]}, "title": "both"}))
    evaluated.clear()
    ds = atlas.run(both, tmp_path / "both.nc", reuse=[old, tmp_path / "right"], progress=False)
    assert sum(evaluated) == 0
    assert re.findall(r"^(\d+) points of: (\w+);", ds.attrs[HISTORY], re.MULTILINE) == [
        ("14", "right"),
        ("63", "small"),
    ]
    ds.close()
    extended = atlas.run(both, reuse=tmp_path / "both.nc", progress=False)
    assert re.match(
        r"77 points of: both;.* \(of these, 14 points of: right; .*63 points of: small; ",
        extended.attrs[HISTORY],
    )
    assert_same_bytes(atlas.run(both, progress=False), extended)


@pytest.mark.long
def test_of_an_unfinished_folder_the_whole_tiles_are_taken(old, scene_text, tmp_path, monkeypatch, evaluated):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    few = {"outputs": {"variables": ["label", "status", "theta_dot_rms", "error_estimate"]}}
    scene = load_scene(scene_text({"axes.sigma": {"values": SIGMA}} | few))
    fresh = atlas.run(scene, f"{tmp_path}/night/", progress=False).load()
    run = RunFolder.open(tmp_path / "night")
    tile_path(run.tiles, 2).unlink()
    tile_path(run.tiles, 5).write_bytes(tile_path(run.tiles, 4).read_bytes())
    wider = load_scene(scene_text({"axes.sigma": {"values": [*SIGMA, 1.9]}} | few))
    evaluated.clear()
    ds = atlas.run(wider, f"{tmp_path}/wider/", reuse=tmp_path / "night", progress=False)
    assert sum(evaluated) == 3 * 7
    assert_same_bytes(fresh, ds.isel(sigma=slice(9)).load())
    assert_same_bytes(atlas.run(wider, progress=False), ds)
    # Without the earlier atlas the run goes on as well: it is the run of its scene.
    run = RunFolder.open(tmp_path / "wider")
    tile_path(run.tiles, 0).unlink()
    continued = atlas.run(wider, f"{tmp_path}/wider/", progress=False)
    assert continued.attrs[HISTORY].startswith("42 points of: small")
    assert_same_bytes(ds, continued)


@pytest.mark.long
def test_of_a_refined_atlas_only_integrated_points_are_taken(scene_text, tmp_path, evaluated):
    refined = load_scene(scene_text({"refine.levels": 2}))
    ds = atlas.run(refined, tmp_path / "refined.nc", progress=False)
    full = load_scene(scene_text({"axes.sigma.count": 33, "axes.theta0.count": 25}))
    fresh = atlas.run(full, progress=False)
    evaluated.clear()
    extended = atlas.run(full, reuse=tmp_path / "refined.nc", progress=False)
    assert sum(evaluated) == int((ds.computed == 0).sum()) > 0
    assert_same_bytes(fresh, extended)
    evaluated.clear()
    extended = atlas.run(refined, reuse=tmp_path / "refined.nc", progress=False)
    assert sum(evaluated) == 0
    xr.testing.assert_equal(extended, ds.load())


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"integration.tolerance": 1e-6}, r"differs in tolerance \(1e-05 in .*old.nc, 1e-06 in the scene\)"),
        ({"labels.rate_tolerance": 1e-4}, "differs in cylinder_tolerance"),
        ({"nudge": None}, r"nudge \(some in .*, none in the scene\)"),
        ({"integration.duration": 60.0}, "none of 63 points .* with the same duration"),
        (
            {"labels.transient": 3.0},
            "none of 63 points .* with the same duration, transient and rate tolerance",
        ),
        ({"fixed.m": 0.6}, "none of 63 points"),
        ({"axes.h1": {"values": [0.0, 0.5]}, "fixed.mu3": 0.5}, "differs in kernel"),
        ({"outputs": {"variables": ["label"]}}, "until the label is certain in the scene"),
        ({"outputs": {"variables": ["label", "theta_max", "megno"]}}, "differs in .*measured"),
    ],
)
def test_atlases_of_other_bits_are_refused(old, scene_text, changes, named, tmp_path):
    scene = load_scene(scene_text({"axes.sigma": {"values": SIGMA}} | changes))
    with pytest.raises(BadInput, match=named) as error:
        atlas.run(scene, f"{tmp_path}/new/", reuse=old, progress=False)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_variables_that_need_the_run_again_are_refused(old, scene_text, tmp_path):
    few = load_scene(scene_text({"outputs": {"variables": ["label", "theta_max"]}}))
    atlas.run(few, tmp_path / "few.nc", progress=False)
    with pytest.raises(
        BadInput, match=r"has no label_inertial, .*, end_time, for which every point is integrated"
    ):
        atlas.run(load_scene(scene_text({})), reuse=tmp_path / "few.nc", progress=False)


def test_atlases_of_other_programs_and_changed_ones_are_refused(old, scene_text, tmp_path, monkeypatch):
    scene = load_scene(scene_text(WIDER))
    with atlas.open_atlas(old) as ds:
        changed = ds.load().copy()
    changed["label"][0, 0] = Label.DRIFTING
    changed.to_netcdf(tmp_path / "changed.nc")
    points = atlas.label_points("satellite", {"C": [1.2, 1.3]}, duration=5.0)
    points.to_netcdf(tmp_path / "points.nc")
    for name, reason in (("changed", "another program wrote the file"), ("points", "come from no scene")):
        with pytest.raises(BadInput, match=reason):
            atlas.run(scene, reuse=tmp_path / f"{name}.nc", progress=False)
    with pytest.raises(BadInput, match="there is no such file"):
        atlas.run(scene, reuse=tmp_path / "none.nc", progress=False)
    atlas.run(load_scene(scene_text({})), f"{tmp_path}/night/", progress=False)
    other = plan.identity(Plan.of(scene)) | {"architecture": "abacus"}
    monkeypatch.setattr(reuse, "identity", lambda plan: other)
    for path, reason in (
        (old, "different is the programs or the processor"),
        (tmp_path / "night", "is architecture .*abacus now"),
    ):
        with pytest.raises(BadInput, match=reason):
            atlas.run(scene, reuse=path, progress=False)


def test_the_command_extends_an_atlas(old, scene_text, tmp_path, capsys):
    (tmp_path / "wider.toml").write_text(scene_text(WIDER))
    command = ["extend", str(old), str(tmp_path / "wider.toml"), "--quiet", "-o"]
    assert cli.main([*command, str(old), "--force"]) == cli.BAD_INPUT
    assert "this is the input" in capsys.readouterr().err
    assert cli.main([*command, f"{tmp_path}/wider.nc"]) == cli.DONE
    assert capsys.readouterr().out.startswith("63 points of: small; Precession Atlas")
    with atlas.open_atlas(tmp_path / "wider.nc") as ds:
        assert_same_bytes(atlas.run(load_scene(scene_text(WIDER)), progress=False), ds)


@pytest.mark.long
def test_a_run_whose_time_is_over_stops_in_good_order_and_is_continued(
    scene_text, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    (tmp_path / "scene.toml").write_text(scene_text({}))
    command = ["run", str(tmp_path / "scene.toml"), "-o", f"{tmp_path}/night.nc", "--quiet", "--threads", "1"]
    folder = tmp_path / "night.nc.run"

    def time_is_up(execution):
        return len(RunFolder.open(folder).tiles.written()) >= 4

    with monkeypatch.context() as patched:
        patched.setattr(memory.Execution, "time_is_up", property(time_is_up))
        assert cli.main([*command, "--stop-after", "1h30m"]) == STOPPED == 75
        assert re.search(
            r"atlas: stopped after 1:30:00; 4 of 9 tiles are in .*; the same command continues",
            capsys.readouterr().err,
        )
        scene = load_scene(tmp_path / "scene.toml")
        with pytest.raises(Stopped, match="4 of 9 tiles"):
            atlas.run(scene, tmp_path / "night.nc", stop_after=1, progress=False)
    assert len(state(RunFolder.open(folder).tiles).done) == 4
    assert cli.main([*command, "--stop-after", "1d"]) == cli.DONE
    with atlas.open_atlas(tmp_path / "night.nc") as ds:
        assert_same_bytes(atlas.run(scene, progress=False), ds)
    assert not folder.exists()


def test_no_tile_begins_after_the_time(scene_text, tmp_path):
    with pytest.raises(Stopped, match="stopped after 0:00; 0 of 1 tiles"):
        atlas.run(load_scene(scene_text({})), f"{tmp_path}/night/", stop_after=1e-9, progress=False)


def test_a_disk_that_is_too_small_is_refused_before_the_run(scene_text, tmp_path, monkeypatch, evaluated):
    scene = load_scene(scene_text({}))
    usage = type("Usage", (), {"free": 2_000})
    with monkeypatch.context() as patched:
        patched.setattr(estimate.shutil, "disk_usage", lambda folder: usage)
        with pytest.raises(
            BadInput, match=r"the run needs about \S+ GB more, and 2e-06 GB are free on this disk"
        ):
            atlas.run(scene, tmp_path / "night.nc", progress=False)
    assert evaluated == []
    with monkeypatch.context() as patched:
        patched.setattr(
            estimate, "_measure", None
        )  # with room for more than the run can take nothing is measured
        atlas.run(scene, tmp_path / "night.nc", progress=False)
