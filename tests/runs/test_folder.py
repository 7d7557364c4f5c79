"""Run folders: what survives kills, damage, full disks and company, small; scripts/faults.py counts it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import atlas
from atlas import BadInput, files, load_scene
from atlas.analysis import summary
from atlas.io import netcdf
from atlas.runs import folder, runner, tiling
from atlas.runs.folder import RunFolder
from atlas.runs.tiling import Tiling
from atlas.scene import grid


def same(one: xr.Dataset, two: xr.Dataset) -> None:
    """Every variable and coordinate equal to the byte, with the same type, dims and attributes."""
    assert set(one.variables) == set(two.variables)
    for name, array in one.variables.items():
        other = two.variables[name]
        assert (array.dtype, array.dims) == (other.dtype, other.dims), name
        assert array.values.tobytes() == other.values.tobytes(), name
        assert set(array.attrs) == set(other.attrs), name


@pytest.fixture(scope="module")
def scene():
    from conftest import SMALL_SCENE

    return load_scene(SMALL_SCENE)


@pytest.fixture(scope="module")
def whole(scene):
    return atlas.run(scene, progress=False)


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 7)


def start(scene, path) -> RunFolder:
    """A run folder without tiles: its manifest decides how others cut it."""
    return RunFolder.prepare(scene, Path(path), grid.check(scene), [])


@given(st.lists(st.integers(1, 9), min_size=1, max_size=4).map(tuple), st.integers(1, 500))
def test_tiles_cover_a_grid_once_as_contiguous_boxes(shape, points):
    cut = Tiling.of(shape, points)
    seen = []
    for tile in range(cut.count):
        indices = cut.indices(tile)
        assert 1 <= indices.size <= points
        box = np.arange(np.prod(shape)).reshape(shape)[cut.place(tile)]
        np.testing.assert_array_equal(box.ravel(), indices)
        seen.append(indices)
    np.testing.assert_array_equal(np.sort(np.concatenate(seen)), np.arange(np.prod(shape)))


def test_the_cut_comes_from_the_scene_and_follows_its_cost(scene, small_scene):
    sample = grid.check(scene)
    assert tiling.tiling(scene, sample) == tiling.tiling(scene, sample)
    big = small_scene.replace("count = 9", "count = 900").replace("count = 7", "count = 700")
    cheap = load_scene(big)
    dear = load_scene(big.replace("tolerance = 1e-5", "tolerance = 1e-12"))
    cuts = [tiling.tiling(s, grid.check(s)) for s in (cheap, dear)]
    assert cuts[0].count < cuts[1].count
    assert 30_000 < np.prod(cuts[0].tile) <= grid.MAX_POINTS_PER_TILE
    assert 512 <= np.prod(cuts[1].tile) <= 4096


def test_a_run_folder_is_the_run(scene, whole, tmp_path, small_tiles):
    ds = atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert RunFolder.open(tmp_path / "run").tiling.count == 9
    same(whole, ds)
    assert "9 of 9 tiles" in ds.attrs["atlas_run"]
    RunFolder.open(tmp_path / "run").join(tmp_path / "joined.nc")
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        same(whole, joined)
        assert joined.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
    assert summary.summary(ds).splitlines()[:4] == summary.summary(whole).splitlines()[:4]
    one = atlas.run(scene, tmp_path / "one.nc", progress=False)
    same(whole, one)
    one.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["joined.nc", "one.nc", "run"]


def test_tiles_of_two_processes_have_the_same_bytes(scene, tmp_path, small_tiles):
    for name, threads in (("one", 1), ("two", 2)):
        atlas.run(scene, f"{tmp_path}/{name}/", threads=threads, progress=False)
    for file in (tmp_path / "one" / "tiles").glob("*.nc"):
        assert file.read_bytes() == (tmp_path / "two" / "tiles" / file.name).read_bytes()


def test_what_is_whole_is_not_computed_again(scene, whole, tmp_path, small_tiles, monkeypatch):
    out = f"{tmp_path}/run/"
    run = start(scene, out)
    calls = 0
    real = runner.evaluate_tile

    def some(*arguments, **more):
        nonlocal calls
        calls += 1
        if calls == 6:
            raise KeyboardInterrupt
        return real(*arguments, **more)

    monkeypatch.setattr(runner, "evaluate_tile", some)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(scene, out, progress=False, threads=1)
    kept = len(run.survey().done)
    assert 1 <= kept <= 5
    part = atlas.open_atlas(out)
    assert int((part.label == 0).sum()) == 63 - sum(len(run.tiling.indices(t)) for t in run.survey().done)
    calls = 10
    same(whole, atlas.run(scene, out, progress=False))
    assert calls - 10 == 9 - kept
    same(whole, part)  # lazily opened before it was finished


DAMAGES = {
    "truncated": lambda file: os.truncate(file, file.stat().st_size // 2),
    "zeroed": lambda file: file.write_bytes(bytes(file.stat().st_size)),
    "one flipped byte": lambda file: file.write_bytes(
        (b := bytearray(file.read_bytes()))[:900] + bytes([b[900] ^ 1]) + b[901:]
    ),
    "empty": lambda file: file.write_bytes(b""),
    "not NetCDF": lambda file: file.write_text("hello"),
    "gone": lambda file: file.unlink(),
    "another tile": lambda file: shutil.copy(file.with_name("00000001.nc"), file),
    "another tile with its sidecar": lambda file: [
        shutil.copy(file.with_name("00000001" + s), file.with_suffix(s)) for s in (".nc", ".json")
    ],
    "sidecar of no sense": lambda file: file.with_suffix(".json").write_text("[1"),
    "no sidecar": lambda file: file.with_suffix(".json").unlink(),
    "foreign key": lambda file: file.with_suffix(".json").write_text(
        json.dumps(json.loads(file.with_suffix(".json").read_text()) | {"key": "0" * 64})
    ),
    "points missing": lambda file: file.with_suffix(".json").write_text(
        json.dumps(json.loads(file.with_suffix(".json").read_text()) | {"computed": 1})
    ),
}


def test_every_damage_is_found_told_and_repaired(scene, whole, tmp_path, small_tiles, caplog):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    run = RunFolder.open(out)
    for name, damage in DAMAGES.items():
        before = {p: p.read_bytes() for p in (tmp_path / "run" / "tiles").glob("*.nc")}
        damage(tmp_path / "run" / "tiles" / "00000003.nc")
        survey = run.survey()
        assert len(survey.done) == 8, name
        assert (list(survey.damaged) or survey.missing) == [3], name
        with pytest.raises(BadInput):
            run.join(tmp_path / "joined.nc")
        assert not (tmp_path / "joined.nc").exists()
        caplog.clear()
        ds = atlas.run(scene, out, progress=False)
        assert name == "no sidecar" or "tile 3 is computed again" in caplog.text, name
        assert {p: p.read_bytes() for p in before} == before, name
    same(whole, ds)


def test_a_changed_scene_is_refused_with_what_differs(scene, small_scene, tmp_path):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(BadInput, match=r"fixed\.m \(0\.5 there, 0\.6 here\)"):
        atlas.run(load_scene(small_scene.replace("m = 0.5", "m = 0.6")), out, progress=False)
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
def test_a_manifest_of_another_version_is_refused_untouched(scene, tmp_path, manifest):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "manifest.json").write_text(manifest)
    for act in (
        lambda: atlas.run(scene, f"{tmp_path}/run/", progress=False),
        lambda: atlas.open_atlas(tmp_path / "run"),
    ):
        with pytest.raises(BadInput) as complaint:
            act()
        assert "\n" not in str(complaint.value)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["manifest.json"]
    assert (tmp_path / "run" / "manifest.json").read_text() == manifest


def test_a_folder_that_holds_something_else_is_refused_untouched(scene, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("mine")
    with pytest.raises(BadInput, match="something else"):
        atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["thesis.tex"]


def test_shards_in_any_order_make_the_run(scene, whole, tmp_path, small_tiles):
    out = f"{tmp_path}/run/"
    for part in (3, 1, 3):
        ds = atlas.run(scene, out, progress=False, shard=(part, 3))
    assert "6 of 9 tiles" in ds.attrs["atlas_run"]
    assert "done 6, damaged 0, missing 3" in RunFolder.open(out).status()
    same(whole, atlas.run(scene, out, progress=False, shard=(2, 3)))
    for wrong in ((0, 3), (4, 3), (1, 0)):
        with pytest.raises(BadInput, match="shard"):
            atlas.run(scene, out, progress=False, shard=wrong)
    with pytest.raises(BadInput, match="run folder"):
        atlas.run(scene, tmp_path / "a.nc", progress=False, shard=(1, 2))


def test_a_full_disk_stops_cleanly_and_can_be_continued(scene, whole, tmp_path, small_tiles, monkeypatch):
    out, written = f"{tmp_path}/run/", 0
    start(scene, out)

    def full(handle):
        nonlocal written
        written += 1
        if written > 20:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(folder.os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            atlas.run(scene, out, progress=False)
    assert not [p for p in Path(out).rglob("*.tmp")]
    survey = RunFolder.open(out).survey()
    assert not survey.damaged
    assert len(survey.done) >= 3
    same(whole, atlas.run(scene, out, progress=False))


def test_a_read_only_folder_is_refused_and_a_finished_one_read(
    scene, whole, tmp_path, small_tiles, monkeypatch
):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False, shard=(1, 2))

    def refuse(*args, **more):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(files.tempfile, "TemporaryFile", refuse)
    with pytest.raises(BadInput, match="cannot be written: Permission denied"):
        atlas.run(scene, out, progress=False)
    monkeypatch.undo()
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 7)
    atlas.run(scene, out, progress=False)
    monkeypatch.setattr(files.tempfile, "TemporaryFile", refuse)
    same(whole, atlas.run(scene, out, progress=False))


def test_a_clock_going_backwards_changes_nothing(scene, whole, tmp_path, small_tiles, monkeypatch):
    out, now = f"{tmp_path}/run/", 1e9
    start(scene, out)

    def back():
        nonlocal now
        now -= 1e6
        return now

    monkeypatch.setattr(time, "time", back)
    atlas.run(scene, out, progress=False, shard=(1, 2))
    for file in Path(out).rglob("*"):
        os.utime(file, (0, 0))
    same(whole, atlas.run(scene, out, progress=False))


def command(*arguments, cwd):
    return subprocess.Popen(
        [sys.executable, "-m", "atlas", *map(str, arguments)], cwd=cwd, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def test_kill_9_at_random_moments(longer):
    path, run, whole = longer
    rng = np.random.default_rng(7)
    times: dict[Path, int] = {}
    for _ in range(3):
        process = command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path)
        began = time.monotonic()
        while len(run.survey().done) <= len(times) and time.monotonic() - began < 20:
            time.sleep(0.02)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        done = {run._file(t, ".nc"): run._file(t, ".nc").stat().st_mtime_ns for t in run.survey().done}
        assert not run.survey().damaged
        assert all(done[file] == stamp for file, stamp in times.items())  # nothing whole was made again
        times = done
    process = command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path)
    assert process.wait(60) == 0
    process.communicate()
    same(whole, atlas.open_atlas(path / "run"))
    assert not list((path / "run" / "tiles").glob(".*"))
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in times.items())


def test_two_processes_finish_one_folder_together(longer):
    path, run, whole = longer
    both = [command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path) for _ in range(2)]
    for process in both:
        _, complaint = process.communicate(timeout=60)
        assert process.returncode == 0, complaint
    assert len(run.survey().done) == 18
    same(whole, atlas.open_atlas(path / "run"))


def test_ctrl_c_keeps_what_is_finished(longer):
    path, run, whole = longer
    process = command("run", "scene.toml", "-o", "run/", cwd=path)
    while not run.survey().done:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=30)
    assert process.returncode == 130
    assert complaint.strip().splitlines()[-1].startswith("atlas: interrupted")
    assert not [p for p in (path / "run").rglob("*.tmp")]
    said = json.loads((path / "run" / "progress.json").read_text())
    assert not said["running"]
    assert not run.survey().damaged
    same(whole, atlas.run(run.scene, f"{path}/run/", progress=False))


def test_status_join_and_dry_run_on_the_command_line(tmp_path, small_scene):
    (tmp_path / "s.toml").write_text(small_scene)
    said = {}
    for arguments in (
        ("run", "s.toml", "--dry-run"),
        ("run", "s.toml", "-o", "r/", "--shard", "1/2", "--quiet"),
        ("status", "r"),
        ("join", "r", "-o", "s.nc"),
    ):
        process = command(*arguments, cwd=tmp_path)
        said[arguments[0] + arguments[-1]], complaint = process.communicate(timeout=60)
        assert process.returncode == 0, complaint
    assert "63 points" in said["run--dry-run"]
    assert "phase error" in said["run--dry-run"]
    assert "done 1, damaged 0, missing 0" in said["statusr"]
    assert atlas.open_atlas(tmp_path / "s.nc").sizes == {"sigma": 9, "theta0": 7}


def test_a_grid_of_a_billion_points_opens_and_starts_at_once(tmp_path, small_scene):
    text = small_scene.replace("count = 9", "count = 1000").replace("count = 7", "count = 1000")
    text = text.replace("m = 0.5\n", "") + "\n[axes.m]\nfrom = 0.1\nto = 1.0\ncount = 1000\n"
    scene = load_scene(text.replace('C = "sigma * A"', 'C = "sigma * A"\nphi0 = "sigma * theta0 * m"'))
    began = time.perf_counter()
    run = start(scene, tmp_path / "run")
    ds = atlas.open_atlas(tmp_path / "run")
    assert time.perf_counter() - began < 5
    assert ds.label.size == 10**9
    assert int(ds.label[500, 500, :3].sum()) == 0
    here = ds.isel(sigma=7, theta0=8, m=9)
    assert float(here.phi0) == float(here.sigma * here.theta0 * here.m)
    tile = run.tiling.count // 2
    columns, computed = runner._tile(scene, run.tiling.indices(tile)[:1], 1, None)
    assert computed == 1
    assert set(columns) == set(folder.tile_types(scene))


def test_parameters_of_many_values_are_lazy_and_join_all_the_same(
    scene, whole, tmp_path, small_tiles, monkeypatch
):
    monkeypatch.setattr(netcdf, "MAX_EAGER_VALUES", 3)
    ds = atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert ds.C.chunks is not None
    RunFolder.open(tmp_path / "run").join(tmp_path / "joined.nc")
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        same(whole, joined)
