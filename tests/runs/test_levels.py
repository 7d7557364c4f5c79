"""Refined runs in run folders: equal to those in memory after interruptions, damage, shards and on dask workers."""

import os
import shutil
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from truth import state, tile_path

import atlas
from atlas import BadInput, cli, load_scene
from atlas.interruption import STOPPED, Stopped
from atlas.runs import folder as folders
from atlas.runs import memory
from atlas.runs.levels import POINTS, Level
from atlas.runs.run import RunFolder

CHANGES = {
    "refine": {"levels": 2, "probe": 0.02},
    "outputs": {"variables": ["label", "status", "agreement", "predicted", "theta_dot_rms", "growth_rate"]},
}


@pytest.fixture(scope="module")
def scene(scene_text):
    return load_scene(scene_text(CHANGES))


@pytest.fixture
def small_tiles(monkeypatch):
    """Tiles of at most 25 points: a row of the finest grid, and 3 tiles of the first level."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "25")


def run(scene, out, **options):
    """The atlas of a run."""
    with atlas.run(scene, out, threads=1, progress=False, **options) as ds:
        return ds.load()


def decode(content):
    """The values of a tile, without what computed it."""
    return content[content.index(b"\n") : -32]


def assert_whole(ds, whole):
    xr.testing.assert_equal(ds, whole)
    for name in (
        "atlas_computed_share",
        "atlas_probe_points",
        "atlas_probe_missed",
        "atlas_half_step_points",
    ):
        assert ds.attrs[name] == whole.attrs[name]


@pytest.mark.long
@pytest.mark.usefixtures("small_tiles")
def test_a_refined_run_folder_holds_the_atlas_computed_in_memory(scene, whole, tmp_path, evaluated, capsys):
    ds = run(scene, f"{tmp_path}/night/")
    assert_whole(ds, whole)
    assert sum(evaluated) == int(whole.computed.sum())
    folder = RunFolder.open(tmp_path / "night")
    levels = [*folder.levels()]
    assert len(levels) >= 4
    assert levels[0].points.size == 63
    assert max(level.tiles.tiling.count for level in levels) > 1
    for before, level in pairwise(levels):
        assert level.before == before.tiles.key
    points = np.concatenate([level.points for level in levels])
    assert points.size == np.unique(points).size == int(whole.computed.sum())
    tiles = sum(level.tiles.tiling.count for level in levels)
    assert ds.attrs["atlas_run"] == f"{tiles} of {tiles} tiles; {tiles} by 1 threads"
    evaluated.clear()
    assert_whole(run(scene, f"{tmp_path}/night/"), whole)
    assert_whole(run(scene, tmp_path / "night.nc"), whole)
    assert sum(evaluated) == int(whole.computed.sum())  # of the file alone
    assert sorted(os.listdir(tmp_path)) == ["night", "night.nc"]
    assert cli.main(["status", f"{tmp_path}/night"]) == cli.DONE
    status = capsys.readouterr().out
    assert "small: refined, 825 points on the finest grid\nlevel 0: done 3, missing 0\n" in status
    assert "points left" not in status
    for suffix in (".nc", ".zarr"):
        assert cli.main(["join", f"{tmp_path}/night", "-o", f"{tmp_path}/joined{suffix}"]) == cli.DONE
        with atlas.open_atlas(tmp_path / f"joined{suffix}") as joined:
            assert_whole(joined.load(), whole)
    folder.remove()
    assert not folder.path.exists()


@pytest.mark.long
@pytest.mark.usefixtures("small_tiles")
def test_a_refined_run_that_ends_at_any_tile_is_continued_there(
    scene, whole, tmp_path, evaluated, interrupt, capsys
):
    more = True
    while more:
        interrupt(3)
        try:
            ds = run(scene, f"{tmp_path}/night/")
            more = False
        except KeyboardInterrupt:
            with pytest.raises(BadInput, match=r"\d+ of \d+ tiles are in .*, and more levels may follow"):
                atlas.open_atlas(tmp_path / "night")
            assert cli.main(["status", f"{tmp_path}/night"]) == cli.DONE
            assert (
                "of the levels that have begun, and more levels may follow, no process"
                in capsys.readouterr().out
            )
    assert_whole(ds, whole)
    assert sum(evaluated) == int(whole.computed.sum())  # no tile twice


@pytest.mark.long
@pytest.mark.usefixtures("small_tiles")
def test_damaged_levels_are_computed_again(scene, whole, tmp_path, evaluated):
    run(scene, f"{tmp_path}/night/")
    folder = RunFolder.open(tmp_path / "night")
    damaged = [*folder.levels()][1]
    content = decode(tile_path(damaged.tiles, 0).read_bytes())

    def swap_tiles():
        tile_path(damaged.tiles, 0).write_bytes(tile_path(damaged.tiles, 1).read_bytes())

    def lose_points():
        (damaged.place.path / POINTS).write_bytes(b"\0" * 8)

    def lose_result():
        pass

    for damage, points in ((swap_tiles, damaged.tiles.tiling.size_of(0)), (lose_points, 0), (lose_result, 0)):
        shutil.rmtree(folder.tiles.place.path)
        damage()
        evaluated.clear()
        assert_whole(run(scene, f"{tmp_path}/night/"), whole)
        assert sum(evaluated) == points
    assert decode(tile_path(damaged.tiles, 0).read_bytes()) == content
    tile_path(folder.tiles, 3).write_bytes(b"no atlas")
    assert_whole(run(scene, f"{tmp_path}/night/"), whole)
    # A level of another run is none of this one.
    other = RunFolder.prepare(folders.ScenePlan.of(scene), tmp_path / "other")
    (other.path / "levels").mkdir()
    damaged.place.path.rename(other.path / "levels" / "0000")
    evaluated.clear()
    assert_whole(run(scene, f"{tmp_path}/other/"), whole)
    assert sum(evaluated) == int(whole.computed.sum())


@pytest.mark.usefixtures("small_tiles")
def test_shards_share_each_level_and_any_of_them_completes_it(scene, whole, tmp_path, evaluated, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(memory.Execution, "time_is_up", property(lambda execution: sum(evaluated) >= 300))
        with pytest.raises(Stopped, match="stopped after 0:01"):
            run(scene, f"{tmp_path}/night/", shard=(1, 2), stop_after=1.0)
    assert 300 <= sum(evaluated) <= 300 + 25
    assert_whole(run(scene, f"{tmp_path}/night/", shard=(2, 2)), whole)
    assert sum(evaluated) == int(whole.computed.sum())
    assert_whole(run(scene, f"{tmp_path}/night/", shard=(1, 2)), whole)
    assert sum(evaluated) == int(whole.computed.sum())
    by = atlas.open_atlas(tmp_path / "night").attrs["atlas_run"]
    assert "by 1 threads, shard 1/2" in by
    assert "by 1 threads, shard 2/2" in by


def test_the_command_stops_and_continues_a_refined_run(
    scene, whole, scene_text, tmp_path, monkeypatch, capsys
):
    (tmp_path / "scene.toml").write_text(scene_text(CHANGES))
    command = ["run", str(tmp_path / "scene.toml"), "-o", f"{tmp_path}/night.nc", "--quiet", "--threads", "1"]
    with monkeypatch.context() as patched:
        patched.setattr(memory.Execution, "time_is_up", property(lambda execution: True))
        assert cli.main([*command, "--stop-after", "2h"]) == STOPPED
        assert "stopped after 2:00:00; 0 of 1 tiles are in" in capsys.readouterr().err
    assert cli.main(command) == cli.DONE
    with atlas.open_atlas(tmp_path / "night.nc") as ds:
        assert_whole(ds.load(), whole)
    assert not (tmp_path / "night.nc.run").exists()


def test_a_worker_computes_a_tile_of_a_level_and_refuses_another_one(scene, tmp_path):
    folder = RunFolder.prepare(folders.ScenePlan.of(scene), tmp_path / "night")
    level = Level.of(folder, 0, "", np.arange(0, 825, 8), 1000)
    folders.compute_tile(str(folder.path), 0, level.tiles.key, 0)
    assert state(level.tiles).done == [0]
    with pytest.raises(BadInput, match="holds another run on the machine of this worker"):
        folders.compute_tile(str(folder.path), 0, "0" * 64, 0)
    (level.place.path / POINTS).unlink()
    folders._open_cached.cache_clear()
    with pytest.raises(BadInput, match="level 0 is not there"):
        folders.compute_tile(str(folder.path), 0, level.tiles.key, 0)


@pytest.mark.long
def test_dask_workers_compute_the_levels(scene, whole, tmp_path):
    with atlas.run(scene, f"{tmp_path}/night/", workers=1, progress=False) as ds:
        assert_whole(ds.load(), whole)
        assert ds.attrs["atlas_run"].endswith("by dask workers")
