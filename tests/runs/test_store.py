"""Runs in a folder and on an S3 server, by the same code; their interruption and damage are in test_fault_table.py."""

import json
import sys
from dataclasses import replace

import pytest
from truth import assert_same_bytes, state, tile_path, with_key

import atlas
from atlas import BadInput, load_scene
from atlas.files import process_name
from atlas.kernel import machine_code
from atlas.runs import claims
from atlas.runs import folder as folders
from atlas.runs.memory import evaluate_at
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.store import place as places
from atlas.store import tile

pytest.importorskip("zarr")
obstore = pytest.importorskip("obstore")
pytestmark = pytest.mark.usefixtures("small_tiles")

FEW = {"outputs.variables": ["label", "predicted", "status", "theta_max"]}


@pytest.fixture(params=["folder", "s3"])
def place(request, tmp_path):
    """Where a run is kept."""
    if request.param == "folder":
        return f"{tmp_path}/night/"
    request.getfixturevalue("server")
    return f"s3://bucket/{tmp_path.name}/night/"


@pytest.fixture(scope="module")
def scene(scene_text):
    return load_scene(scene_text(FEW | {"axes.sigma.count": 5}))


@pytest.mark.usual("folder")
def test_another_scene_and_anything_else_are_refused(scene, scene_text, place):
    RunFolder.prepare(ScenePlan.of(scene), place)
    other = load_scene(scene_text(FEW | {"fixed.m": 0.6}))
    with pytest.raises(BadInput, match=r"holds another run.*fixed\.m \(0\.5 in the folder, 0\.6 now\)"):
        atlas.run(other, place, progress=False)
    elsewhere = f"{place[:-1]}2/"
    root = places.place_at(places.located(elsewhere))
    root.make()
    root.write("zarr.json", b"mine")
    with pytest.raises(BadInput, match="contains something else"):
        atlas.run(scene, elsewhere, progress=False)


@pytest.mark.usual("folder")
@pytest.mark.parametrize("sign", ["progress", "claim"])
def test_force_replaces_another_run_that_nobody_computes(scene, scene_text, whole, place, evaluated, sign):
    other = load_scene(scene_text(FEW | {"fixed.m": 0.6}))
    run = RunFolder.prepare(ScenePlan.of(other), place)
    process = process_name()
    if sign == "claim":  # of a job on another machine, whose progress nobody sees
        process = process.replace(process[:8], "0" * 8)
        name, content = "tiles/00000002.claim", process
    else:
        progress = {"shard": "1/1", "host": "h", "points": 63, "done": 1, "points_per_second": 1.0}
        progress |= {"running": True, "process": process, "written": "2026-01-01T00:00:00Z"}
        name, content = f"progress-{process}.json", json.dumps(progress)
    run.place.write(name, content.encode())
    before = sorted(run.place.walk())
    with pytest.raises(BadInput, match=f"is computed by process {process.split('-')[2]} on"):
        atlas.run(scene, place, force=True, progress=False)
    assert {*before} <= {*run.place.walk()}
    run.place.remove(name)
    run.place.write("thesis.txt", b"mine")
    if place.startswith("s3"):
        with pytest.raises(BadInput, match="contains something else"):
            atlas.run(scene, place, force=True, progress=False)
        assert run.place.walk() == ["thesis.txt"]
        run.place.remove("thesis.txt")
    else:
        run.place.remove("thesis.txt")
    for _ in range(2):  # the second time it is the run of this scene
        assert_same_bytes(whole, atlas.run(scene, place, force=True, progress=False))
        assert len(evaluated) == 5


@pytest.mark.usual("folder")
def test_a_run_takes_no_tile_of_another_processor(scene, whole, place, monkeypatch):
    run = RunFolder.prepare(ScenePlan.of(scene), place)
    values, computed, _ = evaluate_at(ScenePlan.of(scene).runs, scene, run.tiles.indices(3))
    other = run.manifest | {"identity": run.manifest["identity"] | {"architecture": "another"}}
    foreign = replace(run.tiles, key=with_key(other)["key"])
    foreign.write(3, values, computed=computed, seconds=0.0, by="a job on another processor")
    assert state(run.tiles).damaged == {3: "it is a tile of another run or place"}
    before = run.place.walk()
    with monkeypatch.context() as patched:
        patched.setattr(machine_code, "architecture", lambda: "another")
        for shared in ({}, {"shard": (1, 2)}):
            with pytest.raises(BadInput, match=r"differs in architecture \(.* in the folder, another now\)$"):
                atlas.run(scene, place, progress=False, **shared)
        with pytest.raises(
            BadInput,
            match=r"would compute other bits.* differs in architecture \(.*, another in the worker\)$",
        ):
            folders.check_worker(place, None, run.key)
    assert sorted(run.place.walk()) == sorted(before)
    assert_same_bytes(whole, atlas.run(scene, place, progress=False))


@pytest.mark.usual("s3")
def test_claims_expire_by_the_clock_of_the_storage(scene, place, monkeypatch):
    run = RunFolder.prepare(ScenePlan.of(scene), place)
    other = process_name().replace(process_name()[:8], "0" * 8).encode()  # on another machine
    run.tiles.place.write("00000003.claim", other)
    assert claims.claim(run.tiles.place, run.tiles.name(2, claims.SUFFIX))
    assert not claims.claim(run.tiles.place, run.tiles.name(3, claims.SUFFIX))
    monkeypatch.setattr(claims, "CLAIM_AGE", -1.0)
    assert claims.claim(run.tiles.place, run.tiles.name(3, claims.SUFFIX))
    run.remove_leftovers()
    assert {*run.tiles.place.names()} <= {"clock"}


@pytest.mark.long
@pytest.mark.parametrize("place", ["s3"], indirect=True)
def test_a_refined_run_is_kept_on_a_server(scene_text, place, monkeypatch):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "20")  # several tiles for each level, not forty
    text = scene_text(FEW | {"axes.sigma.count": 5, "axes.theta0.count": 5, "refine.levels": 2})
    whole = atlas.run(load_scene(text), progress=False)
    assert_same_bytes(whole, atlas.run(load_scene(text), place, progress=False))
    with atlas.open_atlas(place) as ds:
        assert_same_bytes(whole, ds)


@pytest.mark.long
@pytest.mark.parametrize("place", ["s3"], indirect=True)
def test_a_scene_is_extended_from_a_run_on_a_server(scene, scene_text, whole, place):
    atlas.run(scene, place, progress=False)
    longer = load_scene(scene_text(FEW | {"axes.sigma.count": 9}))
    ds = atlas.run(longer, reuse=place, progress=False)
    assert "35 points of: " in ds.attrs["atlas_history"]
    assert_same_bytes(atlas.run(longer, progress=False), ds)


def test_a_store_that_cannot_be_reached_ends_a_run_in_one_line(scene, server, monkeypatch):
    with pytest.raises(OSError, match="nobucket") as error:
        atlas.run(scene, "s3://nobucket/night/", progress=False)
    assert len(str(error.value).splitlines()) == 1
    for address, text in (
        ("s3://bucket/night", "must end in /, for a run, or in .zarr"),
        ("gopher://a/b.zarr", "no address of an object store"),
    ):
        with pytest.raises(BadInput, match=text):
            atlas.run(scene, address, progress=False)


@pytest.mark.long
def test_a_run_of_many_tiles_has_folders_of_them(scene_text, tmp_path, monkeypatch):
    scene = load_scene(scene_text(FEW))
    monkeypatch.setattr(tile, "TILES_PER_FOLDER", 4)
    out = f"{tmp_path}/run/"
    atlas.run(scene, out, progress=False)
    run = RunFolder.open(out)
    assert {path.name for path in run.tiles.place.path.iterdir()} == {"00000", "00001", "00002"}
    assert run.tiles.written() == {*range(9)}
    tile_path(run.tiles, 7).unlink()
    assert run.tiles.missing() == [7]
    assert_same_bytes(atlas.run(scene, progress=False), atlas.run(scene, out, progress=False))


class Away:
    """A server that does not answer so many requests."""

    def __init__(self, store, failures):
        self.store, self.failures = store, failures

    def __getattr__(self, name):
        def call(store, *arguments, **options):
            self.failures -= 1
            if self.failures >= 0:
                raise obstore.exceptions.GenericError(
                    "HTTP error: error sending request\n\nDebug source: ..."
                )
            return getattr(obstore, name)(store, *arguments, **options)

        return getattr(obstore, name) if name == "exceptions" else call


def test_a_server_that_is_away_for_a_while_does_not_end_a_run(monkeypatch, caplog):
    place, pauses, now = places.Objects("memory://away"), [], [0.0]
    monkeypatch.setattr(places.time, "monotonic", lambda: now[0])

    def sleep(seconds):
        pauses.append(seconds)
        now[0] += seconds

    monkeypatch.setattr(places.time, "sleep", sleep)
    monkeypatch.setitem(sys.modules, "obstore", Away(place.store, 30))
    place.write("one", b"1")
    assert 120 < sum(pauses) < 150
    assert max(pauses) == places.LONGEST_PAUSE
    assert "memory://away does not answer, and is asked again for 10 minutes" in caplog.text
    assert place.read("one") == b"1"
    monkeypatch.setitem(sys.modules, "obstore", Away(place.store, 10**6))
    with pytest.raises(OSError, match="the same command continues") as error:
        place.read("one")
    assert len(str(error.value).splitlines()) == 1
    assert "Debug" not in str(error.value)
    assert now[0] > places.PATIENCE


def test_addresses_of_files_are_paths(tmp_path):
    assert places.located(f"file://{tmp_path}/a%20b.zarr") == tmp_path / "a b.zarr"
    assert places.located("s3://bucket/night.zarr/") == "s3://bucket/night.zarr"
    memory = places.place_at("memory://tests")
    memory.inside("part").write("one", b"1")
    assert memory.names("part") == ["one"]
    assert memory.inside("part").age("one") >= 0
    with pytest.raises(FileNotFoundError):
        memory.read("one")
