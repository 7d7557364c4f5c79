"""Run folders: tiles, manifests, other processes, kills; other faults are in test_fault_table.py, longer ones in test_faults.py."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from truth import assert_same_bytes, state, tile_path, with_key

import atlas
from atlas import BadInput, cli, files, load_scene
from atlas.analysis.summary import summary
from atlas.files import process_name
from atlas.flags import Label
from atlas.kernel.blocks import Threads
from atlas.label.plan import Plan
from atlas.runs import memory
from atlas.runs import run as folder
from atlas.runs.backend import AtlasBackend
from atlas.runs.memory import evaluate_at
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.runs.status import status
from atlas.scene import grid
from atlas.store import dataset
from atlas.store.tile import Tiles
from atlas.store.tiling import MAX_TILES, Tiling, tile_types


@pytest.fixture(scope="module")
def scene(small_scene):
    return load_scene(small_scene)


def empty_run_folder(scene, path) -> RunFolder:
    """A run folder without tiles; its manifest fixes the tiling for every process that continues it."""
    return RunFolder.prepare(ScenePlan.of(scene), Path(path))


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
    reloaded = load_scene(scene.toml())
    assert ScenePlan.of(scene).tiling == ScenePlan.of(reloaded).tiling
    large = {"axes.sigma.count": 900, "axes.theta0.count": 700}
    cheap = load_scene(scene_text(large))
    expensive = load_scene(scene_text(large | {"integration.tolerance": 1e-12}))
    cuts = [ScenePlan.of(s).tiling for s in (cheap, expensive)]
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
        assert set(joined.coords) == set(whole.coords)
    counted = [summary(ds, tally).splitlines()[:-2] for tally in (None, ds.encoding[folder.TALLY])]
    assert counted == 2 * [summary(whole).splitlines()[:-2]]
    with atlas.run(scene, tmp_path / "one.nc", progress=False) as one_file:
        assert_same_bytes(whole, one_file)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["joined.nc", "one.nc", "run"]


@pytest.mark.long
def test_tiles_of_unequal_lengths_are_joined(scene, whole, tmp_path, monkeypatch):
    """Their boxes in the file begin and end within tiles, or hold many of them."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "5")
    atlas.run(scene, f"{tmp_path}/run/", progress=False)
    run = RunFolder.open(tmp_path / "run")
    assert {run.tiling.shape_of(tile) for tile in range(run.tiling.count)} == {(1, 4), (1, 3)}
    for points in (2, 30):
        monkeypatch.setenv("ATLAS_TILE_POINTS", str(points))
        run.join(tmp_path / f"{points}.nc")
        with atlas.open_atlas(tmp_path / f"{points}.nc") as joined:
            assert_same_bytes(whole, joined)


@pytest.mark.long
def test_tiles_of_two_runs_have_the_same_values(scene, tmp_path, small_tiles):
    for name, threads in (("one", 1), ("two", 2)):
        atlas.run(scene, f"{tmp_path}/{name}/", threads=threads, progress=False)
    files_of_one = sorted((tmp_path / "one" / "tiles").glob("*.tile"))
    assert len(files_of_one) == 9
    for file in files_of_one:
        assert values_of(file) == values_of(tmp_path / "two" / "tiles" / file.name)


def values_of(file: Path) -> bytes:
    """The columns of a tile, without what computed it."""
    content = file.read_bytes()
    return content[content.index(b"\n") : -32]


@pytest.mark.long
def test_a_finished_run_is_opened_without_reading_its_tiles(
    scene, whole, tmp_path, small_tiles, monkeypatch, capsys
):
    """Nor by `status`; the same command reads each once, and a join as well."""
    (tmp_path / "small.toml").write_text(scene.toml())
    out, opened, read = f"{tmp_path}/run/", [], Tiles.read
    atlas.run(scene, out, progress=False)
    monkeypatch.setattr(
        Tiles, "read", lambda self, tile, names=None: opened.append(tile) or read(self, tile, names)
    )
    assert cli.main(["status", out]) == 0
    assert "done 9, missing 0" in capsys.readouterr().out
    assert atlas.open_atlas(out).encoding[folder.TALLY].counts
    assert opened == []
    assert cli.main(["run", f"{tmp_path}/small.toml", "-o", out, "--quiet"]) == 0
    assert sorted(opened) == list(range(9))
    assert summary(whole).splitlines()[0] in capsys.readouterr().out
    del opened[:]
    RunFolder.open(out).join(tmp_path / "joined.nc")
    assert sorted(opened) == list(range(9))


def test_a_run_of_another_scene_or_processor_is_refused_with_the_differences(scene, scene_text, tmp_path):
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(BadInput, match=r"fixed\.m \(0\.5 in the folder, 0\.6 now\)"):
        atlas.run(load_scene(scene_text({"fixed.m": 0.6})), out, progress=False)
    manifest = files.parsed((tmp_path / "run" / "manifest.json").read_text(), is_sealed=True)
    manifest["identity"]["architecture"] = "abacus"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "manifest.json").write_text(files.sealed(with_key(manifest)))
    with pytest.raises(BadInput, match=r"architecture \(abacus in the folder"):
        atlas.run(scene, f"{tmp_path}/other/", progress=False)
    assert {p: p.read_bytes() for p in before} == before


@pytest.mark.parametrize(
    "manifest",
    [
        "",
        "[]",
        '{"format": 2}',
        files.sealed({"format": 99}),
        files.sealed({"format": folder.FORMAT}),
        files.sealed({"format": folder.FORMAT, "key": "x", "scene": 3, "identity": 1, "tile": []}),
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


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("tile", [0, 0]), ("tile", [1]), ("tile", ["a", "b"]), ("tile", [-1, 5]), ("tile", [1, True]), ("tile", [3, 5]),
        ("tile", {}), ("tile", [10, 7]), ("provenance", ["a"]), ("provenance", None), ("provenance", {"a": {}}),
        ("provenance", {"a": 10**400}), ("provenance", {"a": "\ud800"}), ("identity", {"architecture": 1}), ("scene", 3), ("key", 3),
    ],
)  # fmt: skip
def test_a_manifest_with_values_of_other_kinds_is_refused_in_one_line(
    scene, tmp_path, entry, value, small_tiles
):
    file = tmp_path / "run" / "manifest.json"
    manifest = empty_run_folder(scene, file.parent).manifest | {entry: value}
    file.write_text(files.sealed(manifest if entry == "key" else with_key(manifest)))
    with pytest.raises(BadInput, match=r"manifest\.json: damaged: ") as error:
        RunFolder.open(file.parent)
    assert str(error.value).isprintable()


def test_what_a_run_folder_claims_is_limited(scene_text, tmp_path):
    """Before anything of that size is made: tiles of the largest grid, points of a tile, nested and endless files."""
    large = {"axes.sigma.count": 10**7, "axes.theta0.count": 10**4}
    run = empty_run_folder(load_scene(scene_text(large)), tmp_path / "run")
    assert run.tiling.count < MAX_TILES
    file = run.path / "manifest.json"
    for tile in ([1, 1], [10**3, 10**4]):
        manifest = run.manifest | {"tile": tile}
        file.write_text(files.sealed(with_key(manifest)))
        tracemalloc.start()
        with pytest.raises(BadInput, match="at most 1000000 points in each and 8000000 tiles"):
            RunFolder.open(run.path)
        assert tracemalloc.get_traced_memory()[1] < 2**28
        tracemalloc.stop()
    file.write_text("[" * 10**5)
    with pytest.raises(BadInput, match="nested too deeply"):
        RunFolder.open(run.path)
    assert not AtlasBackend().guess_can_open(run.path)
    file.unlink()
    file.symlink_to("/dev/zero")
    with pytest.raises(BadInput, match="no regular file"):
        RunFolder.open(run.path)


def test_a_manifest_of_another_version_is_not_called_damaged(scene, tmp_path):
    file = tmp_path / "run" / "manifest.json"
    manifest = empty_run_folder(scene, file.parent).manifest
    file.write_text(files.sealed(manifest | {"format": 99}))
    with pytest.raises(BadInput, match=rf"not a run of this version .* finish it with .*{atlas.__version__}"):
        RunFolder.open(file.parent)
    file.write_text(files.sealed(manifest | {"scene": "schema = 99"} | {"key": ""}))
    with pytest.raises(BadInput, match="damaged: its key"):
        RunFolder.open(file.parent)
    file.write_text(files.sealed(with_key(manifest | {"scene": "schema = 99"})))
    with pytest.raises(BadInput, match=f"its scene, of atlas {atlas.__version__}, cannot be read"):
        RunFolder.open(file.parent)


def test_a_file_is_no_run_folder_and_left_unchanged(scene, tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(BadInput, match="this is a file"):
        empty_run_folder(scene, tmp_path / "run")
    with pytest.raises(BadInput, match="not a run folder but a file"):
        RunFolder.open(tmp_path / "run")
    assert (tmp_path / "run").read_text() == "mine"


@pytest.mark.long
def test_only_the_run_of_another_scene_is_discarded(scene, scene_text, tmp_path):
    """Its own files go, with those of dead processes; files of others stay."""
    path, other = tmp_path / "run", load_scene(scene_text({"fixed.m": 0.6}))
    machine, boot, pid, start = process_name().split("-")
    of_dead = f".atlas-{machine}-{boot}-{pid}-{int(start) + 1}-0123abcd.tmp"
    for mine in ([], ["thesis.tex"]):
        atlas.run(scene, f"{path}/", progress=False).close()
        for name in (of_dead, *mine):
            (path / name).write_text("text")
        before = {p: p.read_bytes() for p in path.rglob("*") if p.is_file()}
        RunFolder.discard(ScenePlan.of(scene), path)
        assert {p: p.read_bytes() for p in path.rglob("*") if p.is_file()} == before
        RunFolder.discard(ScenePlan.of(other), path)
        assert path.exists() == bool(mine)
    assert [p.name for p in path.iterdir()] == ["thesis.tex"]
    (path / "manifest.json").write_text("damaged")
    RunFolder.discard(ScenePlan.of(other), path)
    assert {p.name for p in path.iterdir()} == {"thesis.tex", "manifest.json"}


def progress_file(path, **entries):
    """A progress file in a run folder, of this process at work."""
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    content = {"shard": "1/1", "host": "h", "points": 63, "done": 1, "points_per_second": 1.0}
    content |= {"running": True, "process": process_name(), "written": now}
    content |= entries
    (path / f"progress-{process_name()}.json").write_text(json.dumps(content))


@pytest.mark.long
def test_the_folder_of_a_process_at_work_is_never_removed(scene, scene_text, tmp_path):
    other, path = load_scene(scene_text({"fixed.m": 0.6})), tmp_path / "a.nc.run"
    empty_run_folder(scene, path)
    machine, boot, pid, start = process_name().split("-")
    for process in (process_name(), f"{'0' * 8}-{boot}-{pid}-{start}"):
        progress_file(path, process=process)
        before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
        with pytest.raises(BadInput, match=rf"a\.nc\.run: is computed by process {pid} on h; wait for it"):
            atlas.run(other, tmp_path / "a.nc", progress=False, force=True)
        assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    for entries in (
        {"running": False},
        {"process": f"{machine}-{boot}-{pid}-{int(start) + 1}"},
        {"process": 3},
    ):
        empty_run_folder(scene, path)
        progress_file(path, **entries)
        atlas.run(other, tmp_path / "a.nc", progress=False, force=True).close()
        assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]


@pytest.mark.long
def test_a_process_is_at_work_until_its_file_is_in_its_place(scene, scene_text, tmp_path, monkeypatch):
    other, join = load_scene(scene_text({"fixed.m": 0.6})), RunFolder.join

    def late_join(self, out):
        with pytest.raises(BadInput, match="is computed by process"):
            RunFolder.discard(ScenePlan.of(other), self.path)
        join(self, out)

    monkeypatch.setattr(RunFolder, "join", late_join)
    for _ in range(2):  # the second time all tiles are written
        with monkeypatch.context() as patched:
            patched.setattr(RunFolder, "remove", lambda self: None)
            atlas.run(scene, tmp_path / "a.nc", progress=False).close()
        (tmp_path / "a.nc").unlink()
    RunFolder.discard(ScenePlan.of(other), tmp_path / "a.nc.run")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("out", ["run/", "a.nc"])
def test_a_process_whose_folder_is_removed_says_so(
    scene, scene_text, tmp_path, monkeypatch, small_tiles, out
):
    """Removed or replaced by another run, in which it writes nothing; the removal leaves nothing without a manifest."""
    path = tmp_path / ("run" if out == "run/" else "a.nc.run")
    evaluate, rmtree = memory.evaluate, shutil.rmtree

    def remove_first(*arguments, **options):
        run = RunFolder.open(path)
        run.remove()
        if replaced:
            empty_run_folder(load_scene(scene_text({"fixed.m": 0.6})), path)
        return evaluate(*arguments, **options)

    def tile_in_between(folder, **options):
        with suppress(FileNotFoundError):
            (path / "tiles" / "00000012.tile").write_text("a tile of a process at work")
        rmtree(folder, **options)

    monkeypatch.setattr(memory, "evaluate", remove_first)
    monkeypatch.setattr(shutil, "rmtree", tile_in_between)
    for replaced in (False, True):
        with pytest.raises(OSError, match="another process has removed this run while it was computed"):
            atlas.run(scene, f"{tmp_path}/{out}", progress=False, threads=1)
        assert path.exists() == replaced
        assert not list(path.glob("tiles/*"))


def test_the_key_of_a_run_depends_on_scene_identity_and_tiling(scene, scene_text, tmp_path, monkeypatch):
    run = empty_run_folder(scene, tmp_path / "run")
    assert with_key(run.manifest)["key"] == run.key == run.manifest["key"]
    other = run.manifest | {"identity": run.manifest["identity"] | {"architecture": "abacus"}}
    keys = {run.key, with_key(other)["key"]}
    keys.add(empty_run_folder(load_scene(scene_text({"fixed.m": 0.6})), tmp_path / "other").key)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    keys.add(empty_run_folder(scene, tmp_path / "small").key)
    assert len(keys) == 4


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
    lines = status(out).splitlines()
    assert lines[1] == "tiles: done 6, missing 3"
    assert not [line for line in lines if line.startswith("shard")]  # all of them did what they had to
    assert_same_bytes(whole, atlas.run(scene, out, progress=False, shard=(2, 3)))
    for wrong in ((0, 3), (4, 3), (1, 0)):
        with pytest.raises(BadInput, match="shard"):
            atlas.run(scene, out, progress=False, shard=wrong)
    with pytest.raises(BadInput, match="run folder"):
        atlas.run(scene, tmp_path / "a.nc", progress=False, shard=(1, 2))
    for part in ((1, 5), (3, 5), (1, 2), (2, 2)):  # a queue counts the missing shards anew
        ds = atlas.run(scene, f"{tmp_path}/anew/", progress=False, shard=part)
    assert_same_bytes(whole, ds)


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


@pytest.mark.long
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


@pytest.mark.long
def test_finished_tiles_survive_kill_9_at_random_moments(longer, fault_rounds, monkeypatch):
    path, run, whole = longer
    rng = np.random.default_rng(7)
    modified: dict[Path, int] = {}
    for _ in range(fault_rounds):
        if len(modified) == run.tiling.count:
            break
        process = command("run", "scene.toml", "-o", "run/", "--quiet", cwd=path)
        started = time.monotonic()
        while len(run.tiles.written()) <= len(modified) and time.monotonic() - started < 20:
            time.sleep(0.02)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        status = state(run.tiles)
        files_done = [tile_path(run.tiles, tile) for tile in status.done]
        modified_now = {file: file.stat().st_mtime_ns for file in files_done}
        assert not status.damaged
        assert all(modified_now[file] == stamp for file, stamp in modified.items())
        modified = modified_now
    monkeypatch.chdir(path)
    assert cli.main(["run", "scene.toml", "-o", "run/", "--quiet"]) == cli.DONE
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))
    assert not list((path / "run" / "tiles").glob(".*"))
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in modified.items())


@pytest.mark.long
@pytest.mark.parametrize("out", ["run/", pytest.param("run.nc", marks=pytest.mark.faults)])
def test_two_processes_finish_one_atlas_together(longer, out):
    path, run, whole = longer
    if out == "run.nc":
        run.path.rename(path / "run.nc.run")
    processes = [command("run", "scene.toml", "-o", out, "--quiet", cwd=path) for _ in range(2)]
    for process in processes:
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
    assert sorted(file.name for file in path.iterdir()) == [out.rstrip("/"), "scene.toml"]
    with atlas.open_atlas(path / out) as ds:
        assert_same_bytes(whole, ds)


# The third tile never ends by itself, so that the signal always comes during the run.
ENDLESS_THIRD_TILE = """
import itertools, sys, time
from atlas import cli
from atlas.runs import memory

calls, evaluate = itertools.count(1), memory.evaluate

def endless_third(plan, points, *, threads):
    if next(calls) == 3:
        print("at work", flush=True)
        while True:
            threads.progress(0.0)
            time.sleep(0.01)
    return evaluate(plan, points, threads=threads)

memory.evaluate = endless_third
sys.exit(cli.main(["run", "scene.toml", "-o", "run/", "--threads", "1", "--quiet"]))
"""


@pytest.mark.long
def test_ctrl_c_keeps_finished_tiles(longer):
    path, run, whole = longer
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS_THIRD_TILE], cwd=path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "at work\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors.strip().splitlines()[-1].startswith("atlas: interrupted")
    assert not list((path / "run").rglob("*.tmp"))
    (progress,) = (path / "run").glob("progress-*.json")
    assert not json.loads(progress.read_text())["running"]
    status = state(run.tiles)
    assert len(status.done) == 2
    assert not status.damaged
    assert_same_bytes(whole, atlas.run(run.scene, f"{path}/run/", progress=False))


def test_a_tile_is_written_whole_or_not_at_all(scene, tmp_path, small_tiles, monkeypatch):
    run = empty_run_folder(scene, tmp_path / "run")
    columns, computed, _ = evaluate_at(Plan.of(scene), scene, run.tiling.indices(3), threads=Threads(1))
    facts = {"computed": computed, "seconds": 1.0, "by": "test"}
    run.tiles.write(3, columns, **facts)
    assert run.tiles.read(3)[1].keys() == tile_types(scene).keys()
    before = tile_path(run.tiles, 3).read_bytes()

    def disk_full(handle):
        raise OSError(28, "No space left on device")

    changed = columns | {"theta_max": columns["theta_max"] + 1}
    with monkeypatch.context() as patched:
        patched.setattr(files.os, "fsync", disk_full)
        with pytest.raises(OSError, match="No space"):
            run.tiles.write(3, changed, **facts)
    assert {p: p.read_bytes() for p in run.tiles.place.path.iterdir()} == {tile_path(run.tiles, 3): before}
    with monkeypatch.context() as patched:  # a disk that keeps something else
        patched.setattr(type(run.place), "read", lambda self, name, most: before[:-1])
        with pytest.raises(OSError, match="read back otherwise"):
            run.tiles.write(3, columns, **facts)


def test_damaged_final_attributes_are_refused_and_written_anew(scene, tmp_path, small_tiles, caplog):
    run = f"{tmp_path}/run/"
    attributes = atlas.run(scene, run, progress=False).attrs
    file = tmp_path / "run" / "notes.json"
    whole = file.read_text()
    file.write_text(whole.replace("0", "1", 1))
    for action in (lambda: atlas.open_atlas(run), lambda: RunFolder.open(run).join(tmp_path / "a.nc")):
        with pytest.raises(BadInput, match=r"notes\.json: damaged"):
            action()
    assert not (tmp_path / "a.nc").exists()
    assert atlas.run(scene, run, progress=False).attrs == attributes
    assert "damaged" in caplog.text
    assert file.read_text() == whole


@pytest.mark.long
def test_files_that_killed_processes_left_are_removed_and_those_of_others_kept(scene, tmp_path, small_tiles):
    run = empty_run_folder(scene, tmp_path / "run")
    machine, boot, pid, start = process_name().split("-")
    dead = [
        f"{machine}-{boot}-{2**22 + 1}-5",
        f"{machine}-{boot}-{pid}-{int(start) + 1}",
        f"{machine}-0{boot[1:]}-1-1",
    ]
    alive = [process_name(), f"{'0' * 8}-{boot}-{pid}-{start}"]

    def put_temporaries() -> list[set[Path]]:
        temporary_files = []
        for names in (dead, alive):
            temporary_files.append(
                {
                    place / f".atlas-{name}-0123abcd.tmp"
                    for name in names
                    for place in (tmp_path, run.path, run.tiles.place.path)
                }
            )
            for path in temporary_files[-1]:
                path.write_text("half a file")
        return temporary_files

    for action, cleaned in (
        (lambda: status(run.path), (tmp_path, run.path, run.tiles.place.path)),
        (lambda: atlas.run(scene, f"{run.path}/", progress=False).close(), (run.path, run.tiles.place.path)),
        (lambda: cli.main(["join", str(run.path), "-o", f"{tmp_path}/a.nc"]), (tmp_path,)),
        (lambda: atlas.run(scene, tmp_path / "b.nc", progress=False).close(), (tmp_path,)),
    ):
        of_dead, of_living = put_temporaries()
        action()
        remaining = set(tmp_path.rglob("*.tmp"))
        assert of_living <= remaining
        assert not {path for path in of_dead if path.parent in cleaned} & remaining


@pytest.mark.long
def test_a_run_folder_needs_no_hard_links(scene, whole, tmp_path, small_tiles, monkeypatch):
    def refuse(*arguments, **options):
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))

    monkeypatch.setattr(files.os, "link", refuse)
    out = f"{tmp_path}/run/"
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))
    assert_same_bytes(whole, atlas.run(scene, out, progress=False))
    with atlas.run(scene, tmp_path / "one.nc", progress=False) as one_file:
        assert_same_bytes(whole, one_file)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.nc", "run"]


def test_status_counts_only_processes_that_live(scene, tmp_path, small_tiles):
    run = empty_run_folder(scene, tmp_path / "run")
    machine, boot, pid, start = process_name().split("-")
    now = datetime.now(UTC)
    cases = {
        "at work": process_name(),
        "died": f"{machine}-{boot}-{pid}-{int(start) + 1}",
        "at work, of another machine": f"{'0' * 8}-{boot}-{pid}-{start}",
        "no progress for more than 10 minutes": f"{'0' * 8}-{boot}-{pid}-{start}",
        "ended": process_name(),
        "no progress for more than 10 minutes, of the future": f"{'0' * 8}-{boot}-{pid}-{start}",
    }
    for i, (case, name) in enumerate(cases.items()):
        file = run.path / f"progress-{i}{name}.json"
        file.write_text(json.dumps({
            "shard": f"{i + 1}/5", "host": "h", "points": 13, "done": 1, "points_per_second": 10.0**i,
            "running": case != "ended", "process": name, "written": f"{now:%Y-%m-%dT%H:%M:%SZ}",
        }))  # fmt: skip
        if "no progress" in case:
            os.utime(file, (now.timestamp() + (3600 if "future" in case else -3600),) * 2)
    lines = status(run.path).splitlines()
    for line, case in zip(lines[2:8], cases, strict=True):
        assert f", {case.partition(',')[0]}; written" in line
    assert lines[8].startswith("63 points left, 0:01 at")  # 101 points per second
    assert any(line.startswith("shard 5/5 on h: 1 of 13 points, 1e+04 points/s, ended;") for line in lines)
    (finished,) = run.path.glob("progress-4*.json")
    finished.write_text(finished.read_text().replace('"done": 1,', '"done": 13,'))
    assert "shard 5/5" not in status(run.path)
    progress_file(run.path, points_per_second=1e-310)
    for file in run.path.glob("progress-[0-4]*.json"):
        if file.name != f"progress-{process_name()}.json":
            file.unlink()
    assert status(run.path).splitlines()[-1].startswith("63 points left, 277777:46:40 at")
    for text in ("[" * 10**5, "[]", "3"):
        (run.path / f"progress-{process_name()}.json").write_text(text)
        assert "no process is at work" in status(run.path)
    assert status(run.path).splitlines()[-1].startswith("63 points left, no process is at work;")


def test_status_join_and_dry_run_on_the_command_line(tmp_path, small_scene, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(small_scene)

    def output(*arguments):
        code, printed = cli.main(arguments), capsys.readouterr()
        assert code == cli.DONE, printed.err
        return printed.out

    estimate = output("run", "s.toml", "--dry-run")
    assert "63 points" in estimate
    assert "phase error" in estimate
    assert "file: about" in estimate
    assert "store: about" in output("run", "s.toml", "--dry-run", "-o", "s.zarr")
    output("run", "s.toml", "-o", "r/", "--shard", "1/2", "--quiet")
    assert "done 1, missing 0" in output("status", "r")
    assert "done 1, damaged 0, missing 0" in output("status", "r", "--verify")
    shutil.copytree("r", "t.nc.run")  # the run of t.nc, which is not there yet
    assert "done 1, missing 0" in output("status", "t.nc")
    output("join", "r", "-o", "s.nc")
    assert "finished atlas, sigma 9 x theta0 7" in output("status", "s.nc")
    assert "all of it is as it was written" in output("status", "s.nc", "--verify")
    with atlas.open_atlas("s.nc") as ds:
        assert ds.sizes == {"sigma": 9, "theta0": 7}


@pytest.mark.long
def test_a_grid_of_a_billion_points_opens_and_starts_in_little_memory(tmp_path, scene_text, monkeypatch):
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
    indices = run.tiling.indices(tile)[:1]
    monkeypatch.setattr(Tiling, "indices", lambda *_: indices)
    columns, computed, _ = evaluate_at(Plan.of(scene), scene, run.tiling.indices(tile), threads=Threads(1))
    assert computed == 1
    assert set(columns) >= set(tile_types(scene))


@pytest.mark.long
def test_parameters_of_many_values_are_lazy_and_can_be_joined(
    scene, whole, tmp_path, small_tiles, monkeypatch
):
    monkeypatch.setattr(dataset, "MAX_EAGER_VALUES", 3)
    ds = atlas.run(scene, f"{tmp_path}/run/", progress=False)
    assert ds.C.chunks is not None
    RunFolder.open(tmp_path / "run").join(tmp_path / "joined.nc")
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)


@pytest.mark.parametrize("other", [None, "notes.txt"])
def test_the_rest_of_a_removed_run_goes_unless_something_else_is_there(tmp_path, other):
    place = tmp_path / "a.nc.run"
    place.mkdir()
    for name in filter(None, (folder.CREATION, folder.JOINING, other)):
        (place / name).write_text("")
    folder.remove_empty(place)
    assert place.exists() == (other is not None)
    assert other is None or (place / other).exists()
