"""Runs straight into a Zarr store, in a folder and on an S3 server."""

import json
import logging
import urllib.request

import numpy as np
import pytest
from truth import assert_same_bytes

import atlas
from atlas import BadInput, jit, load_scene
from atlas.cli import main
from atlas.files import process_name
from atlas.io import storage
from atlas.runs import runner, tiles
from atlas.runs.earlier import evaluate_at
from atlas.runs.folder import RunFolder
from atlas.runs.plan import ScenePlan
from atlas.scene import grid

pytest.importorskip("zarr")
pytest.importorskip("obstore")
FEW = {"outputs.variables": ["label", "predicted", "status", "theta_max"]}


@pytest.fixture(scope="module")
def server():
    """A server of S3 with a bucket, in a thread of this process."""
    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    urllib.request.urlopen(urllib.request.Request(f"{address}/bucket", method="PUT")).close()
    variables = {
        "ENDPOINT": address,
        "ACCESS_KEY_ID": "a",
        "SECRET_ACCESS_KEY": "b",
        "REGION": "us-east-1",
        "ALLOW_HTTP": "true",
    }
    with pytest.MonkeyPatch.context() as patched:
        for name, value in variables.items():
            patched.setenv(f"AWS_{name}", value)
        yield server
    server.stop()


@pytest.fixture(params=["folder", "s3"])
def place(request, tmp_path):
    """Where a store is written."""
    if request.param == "folder":
        return str(tmp_path / "night.zarr")
    request.getfixturevalue("server")
    return f"s3://bucket/{tmp_path.name}/night.zarr"


@pytest.fixture(scope="module")
def scene(scene_text):
    return load_scene(scene_text(FEW | {"axes.sigma.count": 5}))


@pytest.fixture(scope="module")
def whole(scene):
    """The atlas of the scene, computed in memory."""
    return atlas.run(scene, progress=False)


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch):
    """Tiles of one row: 5 for the scene."""
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 7)
    monkeypatch.setattr(tiles, "SHARD_CHUNKS", 1)


def test_a_run_is_interrupted_and_continued(
    scene, whole, place, tmp_path, evaluated, interrupt, capsys, caplog
):
    interrupt(4)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(scene, place, progress=False, threads=1)
    assert main(["status", place]) == 0
    assert "done 3, damaged 0, missing 2" in capsys.readouterr().out
    with atlas.open_atlas(place) as growing:
        assert int((growing.label == 0).sum()) == 14
    evaluated.clear()
    ds = atlas.run(scene, place, progress=False, threads=1)
    assert len(evaluated) == 2
    assert_same_bytes(whole, ds)
    assert "5 of 5 tiles" in ds.attrs["atlas_run"]
    with atlas.open_atlas(place) as opened:
        assert_same_bytes(whole, opened)
        assert opened.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
        assert opened.atlas.compare() == whole.atlas.compare()
    assert_same_bytes(whole, atlas.run(scene, place, progress=False))
    assert len(evaluated) == 2
    assert main(["join", place, "-o", str(tmp_path / "joined.nc")]) == 0
    with atlas.open_atlas(tmp_path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)
    caplog.clear()
    # Damaged and lost objects are reported, and computed again after that.
    run = RunFolder.open(place)
    for damage in (
        lambda: run.root.write("theta_max/c/3/0", run.root.read("theta_max/c/2/0")),
        lambda: run.root.remove("theta_max/c/3/0"),
    ):
        damage()
        with atlas.open_atlas(place) as opened, pytest.raises(BadInput, match="are damaged"):
            opened.load()
        assert run.tiles.status().damaged.keys() == {3}
        assert_same_bytes(whole, atlas.run(scene, place, progress=False))
        assert "tile 3 is computed again" in caplog.text
        with atlas.open_atlas(place) as opened:
            assert_same_bytes(whole, opened)


def test_another_scene_and_anything_else_are_refused(scene, scene_text, place):
    RunFolder.prepare(ScenePlan.of(scene), place, [])
    other = load_scene(scene_text(FEW | {"fixed.m": 0.6}))
    with pytest.raises(BadInput, match=r"holds another run.*fixed\.m \(0\.5 in the folder, 0\.6 now\)"):
        atlas.run(other, place, progress=False)
    elsewhere = f"{place[:-5]}2.zarr"
    root = storage.storage_at(storage.located(elsewhere))
    root.make()
    root.write("zarr.json", b"mine")
    with pytest.raises(BadInput, match="contains something else"):
        atlas.run(scene, elsewhere, progress=False)


def test_force_replaces_another_run_and_nothing_else(scene, scene_text, whole, place, evaluated):
    other = load_scene(scene_text(FEW | {"fixed.m": 0.6}))
    RunFolder.prepare(ScenePlan.of(other), place, [])
    for _ in range(2):  # the second time it is the run of this scene
        assert_same_bytes(whole, atlas.run(scene, place, force=True, progress=False))
        assert len(evaluated) == 5
    root = RunFolder.open(place).root
    root.clear("")
    assert not root.walk()
    RunFolder.prepare(ScenePlan.of(other), place, [])
    progress = {"shard": "1/1", "host": "h", "points": 63, "done": 1, "points_per_second": 1.0}
    progress |= {"running": True, "process": process_name(), "written": "2026-01-01T00:00:00Z"}
    for name, content, message in (
        ("atlas/progress.json", json.dumps(progress), "is computed by process"),
        ("thesis.txt", "mine", "holds something else than a run"),
    ):
        root.write(name, content.encode())
        before = root.walk()
        with pytest.raises(BadInput, match=message):
            atlas.run(scene, place, force=True, progress=False)
        assert sorted(root.walk()) == sorted(before)
        root.remove(name)


def test_force_replaces_a_joined_store(scene, whole, tmp_path):
    atlas.run(scene, f"{tmp_path}/run/", progress=False).close()
    out = tmp_path / "joined.zarr"
    RunFolder.open(tmp_path / "run").join(out)
    with pytest.raises(BadInput, match=r"joined\.zarr: this file exists; force=True replaces it"):
        atlas.run(scene, out, progress=False)
    (out / "mine").write_text("")
    with pytest.raises(BadInput, match="contains something else"):
        atlas.run(scene, out, force=True, progress=False)
    (out / "mine").unlink()
    assert_same_bytes(whole, atlas.run(scene, out, force=True, progress=False))


def test_a_store_takes_no_tile_of_another_processor(scene, whole, place, monkeypatch):
    run = RunFolder.prepare(ScenePlan.of(scene), place, [])
    values, computed, _ = evaluate_at(ScenePlan.of(scene).points, scene, run.indices(3))
    foreign = run.tiles_with(run.key_with(run.manifest["identity"] | {"cpu": "another"}))
    foreign.write(3, values, computed=computed, seconds=0.0, by="a job on another processor")
    assert run.tiles.status().damaged == {3: "its sidecar is of another run or tile"}
    before = run.root.walk()
    with monkeypatch.context() as patched:
        patched.setattr(jit, "cpu", lambda: "another")
        for execution in ({}, {"shard": (1, 2)}):
            with pytest.raises(BadInput, match=r"differs in cpu \(.* in the folder, another now\)$"):
                atlas.run(scene, place, progress=False, **execution)
        with pytest.raises(
            BadInput, match=r"would compute other bits.* differs in cpu \(.*, another in the worker\)$"
        ):
            runner.check_worker(place, None, run.key)
    assert sorted(run.root.walk()) == sorted(before)
    assert_same_bytes(whole, atlas.run(scene, place, progress=False))


def test_claims_expire_by_the_clock_of_the_storage(scene, place, monkeypatch):
    run = RunFolder.prepare(ScenePlan.of(scene), place, [])
    other = storage.process_name().replace(storage.process_name()[:8], "0" * 8).encode()  # on another machine
    run.tiles.storage.write("00000003.claim", other)
    assert run.tiles.claim(2)
    assert not run.tiles.claim(3)
    monkeypatch.setattr(storage, "CLAIM_AGE", -1.0)
    assert run.tiles.claim(3)
    run.remove_leftovers()
    assert run.tiles.storage.names() <= {"clock"}


@pytest.mark.parametrize("place", ["s3"], indirect=True)
def test_a_refined_run_is_kept_in_a_store(scene_text, place):
    text = scene_text(FEW | {"axes.sigma.count": 5, "axes.theta0.count": 5, "refine.levels": 2})
    whole = atlas.run(load_scene(text), progress=False)
    assert_same_bytes(whole, atlas.run(load_scene(text), place, progress=False))
    with atlas.open_atlas(place) as ds:
        assert_same_bytes(whole, ds)


@pytest.mark.parametrize("place", ["s3"], indirect=True)
def test_a_scene_is_extended_from_a_store(scene, scene_text, whole, place):
    atlas.run(scene, place, progress=False)
    longer = load_scene(scene_text(FEW | {"axes.sigma.count": 9}))
    ds = atlas.run(longer, reuse=place, progress=False)
    assert "35 points of: " in ds.attrs["atlas_history"]
    assert_same_bytes(atlas.run(longer, progress=False), ds)


def test_a_store_that_cannot_be_reached_ends_a_run_in_one_line(scene, server, monkeypatch):
    with pytest.raises(OSError, match="nobucket") as error:
        atlas.run(scene, "s3://nobucket/night.zarr", progress=False)
    assert len(str(error.value).splitlines()) == 1
    for address, text in (
        ("s3://bucket/night", "must end in .zarr"),
        ("gopher://a/b.zarr", "no address of an object store"),
    ):
        with pytest.raises(BadInput, match=text):
            atlas.run(scene, address, progress=False)


def test_packs_spare_reading_files_that_did_not_change(scene_text, tmp_path, monkeypatch):
    scene = load_scene(scene_text(FEW))
    monkeypatch.setattr(tiles, "MIN_PACK", 1)
    monkeypatch.setattr(tiles, "TILES_PER_FOLDER", 4)
    atlas.run(scene, f"{tmp_path}/run/", progress=False)
    folder = tmp_path / "run" / "tiles"
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {"00000", "00001", "00002"}
    run = RunFolder.open(tmp_path / "run")
    assert run.tiles.status().done == list(range(9))
    checked = []
    whole_check, whole_sidecar = tiles.TileFiles._checked, tiles.TileFiles._sidecar
    monkeypatch.setattr(
        tiles.TileFiles, "_checked", lambda self, tile: checked.append(tile) or whole_check(self, tile)
    )
    assert run.tiles.status().done == list(range(9))
    assert run.dataset().encoding
    assert checked == []
    sidecars = []
    monkeypatch.setattr(tiles.TileFiles, "_sidecar", lambda self, tile: sidecars.append(tile))
    run.join(tmp_path / "packed.nc")
    assert sidecars == []
    with atlas.open_atlas(tmp_path / "packed.nc") as joined:
        assert_same_bytes(atlas.run(scene, progress=False), joined)
    monkeypatch.setattr(tiles.TileFiles, "_sidecar", whole_sidecar)
    content = bytearray(run.tiles.path(5).read_bytes())
    content[-9] ^= 1
    run.tiles.path(5).write_bytes(content)
    run.tiles.path(7, ".json").unlink()
    assert run.tiles.status().damaged.keys() == {5}
    assert run.tiles.status().missing == [7]
    assert set(checked) == {5}
    (folder / "00000.pack").write_bytes((folder / "00001.pack").read_bytes())
    (folder / "00002.pack").write_bytes(b"")
    del checked[:]
    run.tiles.status()
    assert checked == [0, 1, 2, 3, 5, 8]
    assert_same_bytes(atlas.run(scene, progress=False), atlas.run(scene, f"{tmp_path}/run/", progress=False))


def test_addresses_of_files_are_paths(tmp_path):
    assert storage.located(f"file://{tmp_path}/a%20b.zarr") == tmp_path / "a b.zarr"
    assert storage.located("s3://bucket/night.zarr/") == "s3://bucket/night.zarr"
    memory = storage.storage_at("memory://tests")
    memory.inside("part").write("one", b"1")
    np.testing.assert_equal(memory.names("part"), {"one"})
    assert memory.inside("part").age("one") >= 0
    with pytest.raises(FileNotFoundError):
        memory.read("one")
