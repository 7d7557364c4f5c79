"""Run folders after kills, damage and full disks, on a small scene; scripts/tools/faults.py does the same at length."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from truth import assert_same_bytes

import atlas
from atlas import BadInput, files, load_scene
from atlas.analysis import summary
from atlas.flags import Label
from atlas.io import netcdf
from atlas.runs import folder, runner, tiles, tiling
from atlas.runs.folder import RunFolder
from atlas.runs.tiling import Tiling
from atlas.scene import grid


@pytest.fixture(scope="module")
def scene(small_scene):
    return load_scene(small_scene)


@pytest.fixture(scope="module")
def whole(scene):
    """The atlas of the scene, computed in memory."""
    return atlas.run(scene, progress=False)


@pytest.fixture
def small_tiles(monkeypatch):
    """Tiles of at most 7 points: 9 for the scene."""
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 7)


def empty_run_folder(scene, path) -> RunFolder:
    """A run folder without tiles; its manifest fixes the tiling for every process that continues it."""
    return RunFolder.prepare(scene, Path(path), grid.check(scene), [])


@given(st.lists(st.integers(1, 9), min_size=1, max_size=4).map(tuple), st.integers(1, 500))
def test_tiles_cover_a_grid_once_as_contiguous_boxes(shape, points):
    cut = Tiling.of(shape, points)
    covered = []
    for tile in range(cut.count):
        indices = cut.indices(tile)
        assert 1 <= indices.size <= points
        box = np.arange(np.prod(shape)).reshape(shape)[cut.slices(tile)]
        assert box.shape == cut.shape_of(tile)
        np.testing.assert_array_equal(box.ravel(), indices)
        covered.append(indices)
    np.testing.assert_array_equal(np.sort(np.concatenate(covered)), np.arange(np.prod(shape)))


def test_tiling_depends_on_the_scene_alone_and_follows_its_cost(scene, scene_text):
    again = load_scene(scene.toml())
    assert tiling.tiling(scene, grid.check(scene)) == tiling.tiling(again, grid.check(again))
    large = {"axes.sigma.count": 900, "axes.theta0.count": 700}
    cheap = load_scene(scene_text(large))
    expensive = load_scene(scene_text(large | {"integration.tolerance": 1e-12}))
    cuts = [tiling.tiling(s, grid.check(s)) for s in (cheap, expensive)]
    assert cuts[0].count < cuts[1].count
    assert 30_000 < np.prod(cuts[0].tile) <= grid.MAX_POINTS_PER_TILE
    assert 512 <= np.prod(cuts[1].tile) <= 4096


def test_a_run_folder_and_a_joined_file_hold_the_atlas_computed_in_memory(
    scene, whole, tmp_path, small_tiles
):
    ds = atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert RunFolder.open(tmp_path / "run").tiling.count == 9
    assert_same_bytes(whole, ds)
    assert "9 of 9 tiles" in ds.attrs["atlas_run"]
    RunFolder.open(tmp_path / "run").join(tmp_path / "joined.nc")
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)
        assert joined.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
    assert summary.summary(ds).splitlines()[:4] == summary.summary(whole).splitlines()[:4]
    with atlas.run(scene, tmp_path / "one.nc", progress=False) as one_file:
        assert_same_bytes(whole, one_file)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["joined.nc", "one.nc", "run"]


def test_tiles_of_two_runs_have_the_same_bytes(scene, tmp_path, small_tiles):
    for name, threads in (("one", 1), ("two", 2)):
        atlas.run(scene, f"{tmp_path}/{name}/", threads=threads, progress=False)
    files_of_one = sorted((tmp_path / "one" / "tiles").glob("*.nc"))
    assert len(files_of_one) == 9
    for file in files_of_one:
        assert file.read_bytes() == (tmp_path / "two" / "tiles" / file.name).read_bytes()


def test_finished_tiles_are_not_computed_again(scene, whole, tmp_path, small_tiles, monkeypatch):
    out = f"{tmp_path}/run/"
    run = empty_run_folder(scene, out)
    calls, evaluate_tile = 0, runner.evaluate_tile

    def interrupted_at_the_sixth_call(*arguments, **options):
        nonlocal calls
        calls += 1
        if calls == 6:
            raise KeyboardInterrupt
        return evaluate_tile(*arguments, **options)

    monkeypatch.setattr(runner, "evaluate_tile", interrupted_at_the_sixth_call)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(scene, out, progress=False, threads=1)
    kept = run.tiles.status().done
    assert 1 <= len(kept) <= 5
    partial = atlas.open_atlas(out)
    not_computed = int((partial.label == Label.NOT_COMPUTED).sum())
    assert not_computed == 63 - sum(run.tiling.size_of(tile) for tile in kept)
    calls = 10
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))
    assert calls - 10 == 9 - len(kept)
    assert_same_bytes(whole, partial)  # lazily opened before it was finished


def edit_sidecar(file: Path, **entries) -> None:
    sidecar = file.with_suffix(".json")
    sidecar.write_text(json.dumps(json.loads(sidecar.read_text()) | entries))


def flip_one_bit(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[900] ^= 1
    file.write_bytes(content)


DAMAGES = {
    "truncated": lambda file: os.truncate(file, file.stat().st_size // 2),
    "zeroed": lambda file: file.write_bytes(bytes(file.stat().st_size)),
    "one flipped bit": flip_one_bit,
    "empty": lambda file: file.write_bytes(b""),
    "not NetCDF": lambda file: file.write_text("hello"),
    "removed": lambda file: file.unlink(),
    "another tile": lambda file: shutil.copy(file.with_name("00000001.nc"), file),
    "another tile with its sidecar": lambda file: [
        shutil.copy(file.with_name("00000001" + s), file.with_suffix(s)) for s in (".nc", ".json")
    ],
    "sidecar not JSON": lambda file: file.with_suffix(".json").write_text("[1"),
    "no sidecar": lambda file: file.with_suffix(".json").unlink(),
    "sidecar of another run": lambda file: edit_sidecar(file, key="0" * 64),
    "points missing": lambda file: edit_sidecar(file, computed=1),
}


def test_every_damaged_tile_is_reported_and_computed_again(scene, whole, tmp_path, small_tiles, caplog):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    run = RunFolder.open(out)
    for name, damage in DAMAGES.items():
        before = {p: p.read_bytes() for p in (tmp_path / "run" / "tiles").glob("*.nc")}
        damage(tmp_path / "run" / "tiles" / "00000003.nc")
        status = run.tiles.status()
        assert len(status.done) == 8, name
        assert (list(status.damaged) or status.missing) == [3], name
        with pytest.raises(BadInput):
            run.join(tmp_path / "joined.nc")
        assert not (tmp_path / "joined.nc").exists()
        caplog.clear()
        ds = atlas.run(scene, out, progress=False)
        assert name == "no sidecar" or "tile 3 is computed again" in caplog.text, name
        assert {p: p.read_bytes() for p in before} == before, name
    assert_same_bytes(whole, ds)


def test_a_run_of_another_scene_or_processor_is_refused_with_the_differences(scene, scene_text, tmp_path):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(BadInput, match=r"fixed\.m \(0\.5 there, 0\.6 here\)"):
        atlas.run(load_scene(scene_text({"fixed.m": 0.6})), out, progress=False)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    manifest["identity"]["cpu"] = "abacus"
    manifest["key"] = folder._key(manifest)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match=r"cpu \(abacus there"):
        atlas.run(scene, f"{tmp_path}/other/", progress=False)
    assert {p: p.read_bytes() for p in before} == before


@pytest.mark.parametrize(
    "manifest",
    [
        "",
        "[]",
        '{"format": 99}',
        '{"format": 1}',
        '{"format": 1, "key": "x", "scene": 3, "identity": 1, "tile": []}',
    ],
)
def test_an_unreadable_manifest_is_refused_and_left_unchanged(scene, tmp_path, manifest):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "manifest.json").write_text(manifest)
    for action in (
        lambda: atlas.run(scene, f"{tmp_path}/run/", progress=False),
        lambda: atlas.open_atlas(tmp_path / "run"),
    ):
        with pytest.raises(BadInput) as error:
            action()
        assert "\n" not in str(error.value)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["manifest.json"]
    assert (tmp_path / "run" / "manifest.json").read_text() == manifest


def test_a_folder_with_other_files_is_refused_and_left_unchanged(scene, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("mine")
    with pytest.raises(BadInput, match="something else"):
        atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["thesis.tex"]


def test_shards_in_any_order_complete_the_run(scene, whole, tmp_path, small_tiles):
    out = f"{tmp_path}/run/"
    for part in (3, 1, 3):
        ds = atlas.run(scene, out, progress=False, shard=(part, 3))
    assert "6 of 9 tiles" in ds.attrs["atlas_run"]
    assert "done 6, damaged 0, missing 3" in RunFolder.open(out).status()
    assert_same_bytes(whole, atlas.run(scene, out, progress=False, shard=(2, 3)))
    for wrong in ((0, 3), (4, 3), (1, 0)):
        with pytest.raises(BadInput, match="shard"):
            atlas.run(scene, out, progress=False, shard=wrong)
    with pytest.raises(BadInput, match="run folder"):
        atlas.run(scene, tmp_path / "a.nc", progress=False, shard=(1, 2))


def test_after_a_full_disk_the_run_can_be_continued(scene, whole, tmp_path, small_tiles, monkeypatch):
    out, calls = f"{tmp_path}/run/", 0
    empty_run_folder(scene, out)

    def disk_full_after_20_calls(handle):
        nonlocal calls
        calls += 1
        if calls > 20:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(files.os, "fsync", disk_full_after_20_calls)
        with pytest.raises(OSError, match="No space"):
            atlas.run(scene, out, progress=False)
    assert not list(Path(out).rglob("*.tmp"))
    status = RunFolder.open(out).tiles.status()
    assert not status.damaged
    assert len(status.done) >= 3
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))


def test_a_read_only_folder_is_refused_unless_it_is_finished(
    scene, whole, tmp_path, small_tiles, monkeypatch
):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False, shard=(1, 2))

    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(files.tempfile, "TemporaryFile", refuse)
        with pytest.raises(BadInput, match="cannot be written: Permission denied"):
            atlas.run(scene, out, progress=False)
    atlas.run(scene, out, progress=False)
    monkeypatch.setattr(files.tempfile, "TemporaryFile", refuse)
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))


def test_a_clock_going_backwards_has_no_effect(scene, whole, tmp_path, small_tiles, monkeypatch):
    out, now = f"{tmp_path}/run/", 1e9
    empty_run_folder(scene, out)

    def earlier_at_each_call():
        nonlocal now
        now -= 1e6
        return now

    monkeypatch.setattr(time, "time", earlier_at_each_call)
    atlas.run(scene, out, progress=False, shard=(1, 2))
    for file in Path(out).rglob("*"):
        os.utime(file, (0, 0))
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))


def command(*arguments, cwd):
    return subprocess.Popen(
        [sys.executable, "-m", "atlas", *map(str, arguments)], cwd=cwd, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def test_finished_tiles_survive_kill_9_at_random_moments(longer):
    path, run, whole = longer
    rng = np.random.default_rng(7)
    modified: dict[Path, int] = {}
    for _ in range(3):
        process = command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path)
        started = time.monotonic()
        while len(run.tiles.status().done) <= len(modified) and time.monotonic() - started < 20:
            time.sleep(0.02)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        status = run.tiles.status()
        files_done = [run.tiles.path(tile) for tile in status.done]
        modified_now = {file: file.stat().st_mtime_ns for file in files_done}
        assert not status.damaged
        assert all(modified_now[file] == stamp for file, stamp in modified.items())
        modified = modified_now
    process = command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path)
    assert process.wait(60) == 0
    process.communicate()
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))
    assert not list((path / "run" / "tiles").glob(".*"))
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in modified.items())


def test_two_processes_finish_one_folder_together(longer):
    path, run, whole = longer
    processes = [command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path) for _ in range(2)]
    for process in processes:
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
    assert len(run.tiles.status().done) == 18
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


def test_ctrl_c_keeps_finished_tiles(longer):
    path, run, whole = longer
    process = command("run", "scene.toml", "-o", "run/", cwd=path)
    while not run.tiles.status().done:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip().splitlines()[-1].startswith("atlas: interrupted")
    assert not list((path / "run").rglob("*.tmp"))
    assert not json.loads((path / "run" / "progress.json").read_text())["running"]
    assert not run.tiles.status().damaged
    assert_same_bytes(whole, atlas.run(run.scene, f"{path}/run/", progress=False))


def test_status_join_and_dry_run_on_the_command_line(tmp_path, small_scene):
    (tmp_path / "s.toml").write_text(small_scene)

    def output(*arguments):
        process = command(*arguments, cwd=tmp_path)
        printed, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        return printed

    estimate = output("run", "s.toml", "--dry-run")
    assert "63 points" in estimate
    assert "phase error" in estimate
    output("run", "s.toml", "-o", "r/", "--shard", "1/2", "--quiet")
    assert "done 1, damaged 0, missing 0" in output("status", "r")
    output("join", "r", "-o", "s.nc")
    assert atlas.open_atlas(tmp_path / "s.nc").sizes == {"sigma": 9, "theta0": 7}


def test_a_grid_of_a_billion_points_opens_and_starts_in_little_memory(tmp_path, scene_text):
    scene = load_scene(
        scene_text(
            {
                "axes.sigma.count": 1000,
                "axes.theta0.count": 1000,
                "axes.m": {"from": 0.1, "to": 1.0, "count": 1000},
                "fixed.m": None,
                "ties.phi0": "sigma * theta0 * m",
            }
        )
    )
    tracemalloc.start()
    run = empty_run_folder(scene, tmp_path / "run")
    ds = atlas.open_atlas(tmp_path / "run")
    assert tracemalloc.get_traced_memory()[1] < 2**28  # an array of all points has at least 10^9 bytes
    tracemalloc.stop()
    assert ds.label.size == 10**9
    assert (ds.label[500, 500, :3] == Label.NOT_COMPUTED).all()
    point = ds.isel(sigma=7, theta0=8, m=9)
    assert float(point.phi0) == float(point.sigma * point.theta0 * point.m)
    tile = run.tiling.count // 2
    columns, computed = runner._compute_points(scene, run.tiling.indices(tile)[:1], 1, None)
    assert computed == 1
    assert set(columns) == set(tiles.tile_types(scene))


def test_parameters_of_many_values_are_lazy_and_can_be_joined(
    scene, whole, tmp_path, small_tiles, monkeypatch
):
    monkeypatch.setattr(netcdf, "MAX_EAGER_VALUES", 3)
    ds = atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert ds.C.chunks is not None
    RunFolder.open(tmp_path / "run").join(tmp_path / "joined.nc")
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)
