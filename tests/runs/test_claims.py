"""Any number of processes on one folder: each claims the tiles that it computes, and claims of dead ones expire."""

import errno
import os
import resource
import subprocess
import sys
import time
from threading import Event
from types import SimpleNamespace

import pytest
from truth import assert_same_bytes, tile_path

import atlas
from atlas import BadInput, files, load_scene
from atlas.interruption import Stopped
from atlas.runs import claims, memory
from atlas.runs import folder as folders
from atlas.runs.claims import SUFFIX, claim
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.runs.status import status
from atlas.store import place as places


@pytest.fixture
def folder(small_scene, tmp_path, monkeypatch):
    """An empty run folder of 9 tiles."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    return RunFolder.prepare(ScenePlan.of(load_scene(small_scene)), tmp_path / "run")


@pytest.fixture(scope="module")
def living():
    """Name of another process that runs."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from atlas.files import process_name; print(process_name(), flush=True); input()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    yield process.stdout.readline().strip()
    process.communicate("\n")


def dead(living):
    """Name of a process that is gone, whose number another one has now."""
    return living[:-1] + str((int(living[-1]) + 1) % 10)


def age(path, seconds):
    """Let the last sign of life of a claim be so long ago."""
    status = path.stat()
    os.utime(path, (status.st_atime - seconds, status.st_mtime - seconds))


@pytest.mark.long
def test_a_claim_holds_while_its_process_gives_signs_of_life(tmp_path, living):
    path, place = tmp_path / "a.claim", (places.Folder(tmp_path), "a.claim")
    assert claim(*place)
    assert path.read_text() == files.process_name()
    assert claim(*place)  # one's own, from a call that was interrupted
    path.write_text(living)
    assert not claim(*place)
    age(path, claims.CLAIM_AGE + 10)  # it is suspended
    assert claim(*place)
    assert path.read_text() == files.process_name()
    machine, boot, pid, start = living.split("-")
    path.write_text(
        "-".join((machine, boot, pid, str(int(start) - 1)))
    )  # a dead one whose number was used again
    assert claim(*place)
    path.write_text("-".join(("0" * 8, boot, pid, start)))  # on another machine
    assert not claim(*place)
    age(path, claims.CLAIM_AGE + 10)
    assert claim(*place)
    path.write_text("")  # just created, by an earlier version
    assert not claim(*place)
    age(path, claims.NAMELESS_AGE + 1)  # on a full disk
    assert claim(*place)
    for seconds, is_expired in ((30, False), (3600, True)):  # of a clock that was ahead
        path.write_text("-".join(("0" * 8, boot, pid, start)))
        age(path, -seconds)
        assert claim(*place) == is_expired


def test_of_several_processes_that_take_over_a_claim_at_once_one_has_it(tmp_path, living, monkeypatch):
    place = places.Folder(tmp_path)
    place.write("a.claim", dead(living).encode())
    later = SimpleNamespace(sleep=lambda seconds: place.write("a.claim", living.encode()))
    monkeypatch.setattr("atlas.runs.claims.time", later)
    assert not claim(place, "a.claim")


def test_only_one_process_creates_a_claim(tmp_path):
    for place in (places.Folder(tmp_path), places.Objects("memory://claims")):
        assert place.create("a.claim", b"one")
        assert not place.create("a.claim", b"two")
        assert place.read("a.claim") == b"one"


@pytest.mark.parametrize("links", ["links", "no links"])
def test_a_claim_that_cannot_be_written_is_not_there(tmp_path, links, monkeypatch):
    """Not even empty: that would be one of an unknown process."""

    def refuse(*names):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    if links == "no links":
        monkeypatch.setattr(files.os, "link", refuse)
    place, limits = places.Folder(tmp_path), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))  # as on a full disk
    try:
        with pytest.raises(OSError, match="File too large"):
            place.create("a.claim", b"one")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())
    assert place.create("a.claim", b"one")
    assert not place.create("a.claim", b"two")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.claim", b"one")]


@pytest.mark.long
@pytest.mark.parametrize("name", ["manifest.claim", "joining.claim", "tiles/00000003.claim"])
def test_who_waits_says_for_whom_and_ends_when_the_time_is_up(
    name, small_scene, tmp_path, living, monkeypatch, caplog
):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    monkeypatch.setattr(claims, "NAMED_AFTER", 0.0)
    scene, run = load_scene(small_scene), tmp_path / "a.nc.run"
    if name == "manifest.claim":
        run.mkdir()
    else:
        RunFolder.prepare(ScenePlan.of(scene), run)
    places.Folder(run).write(name, living.encode())
    with pytest.raises(Stopped, match=r"stopped after 0:0\d; .*a\.nc\.run"):
        atlas.run(scene, tmp_path / "a.nc", threads=1, progress=False, stop_after=3.0)
    number = living.split("-")[2]
    place, claim = str(run) + "/tiles" * ("/" in name), name.rpartition("/")[2]
    assert [record.getMessage() for record in caplog.records if "waits" in record.getMessage()] == [
        f"{place}: waits for process {number} on this or another machine, which holds {claim}; this claim expires 180 s"
        " after its last sign of life"
    ]
    (run / name).unlink()
    atlas.run(scene, tmp_path / "a.nc", threads=1, progress=False).close()


@pytest.mark.parametrize("creator", ["slow", "dead"])
def test_one_of_several_processes_creates_a_run(
    creator, small_scene, scene_text, tmp_path, living, monkeypatch
):
    """Another one makes its run while this one waits, or was killed before it did."""
    claim, waits = tmp_path / "run" / "manifest.claim", []
    claim.parent.mkdir()
    claim.write_text(living if creator == "slow" else dead(living))

    def sleep(seconds):
        waits.append(seconds)
        claim.unlink()
        RunFolder.prepare(ScenePlan.of(load_scene(scene_text({"fixed.m": 0.6}))), tmp_path / "run")

    monkeypatch.setattr("atlas.runs.run.time", SimpleNamespace(sleep=sleep))
    plan = ScenePlan.of(load_scene(small_scene))
    if creator == "slow":
        with pytest.raises(BadInput, match=r"holds another run.*fixed\.m \(0\.6 in the folder, 0\.5 now\)"):
            RunFolder.prepare(plan, tmp_path / "run")
    else:
        RunFolder.prepare(plan, tmp_path / "run")
    assert len(waits) == (creator == "slow")
    assert {path.name for path in claim.parent.iterdir()} == {"manifest.json", "tiles"}


@pytest.mark.usual("dead-a.nc")
@pytest.mark.parametrize("name", ["a.nc", "memory://claims/a.zarr"])
@pytest.mark.parametrize("end", ["done", "dead"])
def test_one_of_several_processes_joins_a_run(name, end, small_scene, tmp_path, living, monkeypatch):
    """Another one writes the atlas and removes its run while this one waits, or is killed: what one writes another one never removes."""
    if name.endswith("zarr"):
        pytest.importorskip("obstore")
    monkeypatch.chdir(tmp_path)
    scene, joins, join = load_scene(small_scene), [], RunFolder.join
    atlas.run(scene, f"{name}.run/", progress=False)
    run = RunFolder.open(f"{name}.run")
    run.place.write("joining.claim", living.encode())

    def counted(self, out):
        joins.append(out)
        return join(self, out)

    def sleep(seconds):
        if end == "dead":
            run.place.write("joining.claim", dead(living).encode())
        else:
            run.join(places.located(name))
            run.remove()

    monkeypatch.setattr(RunFolder, "join", counted)
    monkeypatch.setattr(folders, "time", SimpleNamespace(sleep=sleep, monotonic=time.monotonic))
    ds = atlas.run(scene, name, force=name == "a.nc", progress=False)
    assert len(joins) == 1
    assert_same_bytes(atlas.run(scene, progress=False), ds)
    assert not run.place.walk()
    assert [path.name for path in tmp_path.iterdir()] == ["a.nc"][: not name.endswith("zarr")]
    ds.close()
    if name.endswith("zarr"):
        places.place_at(name).clear()


def test_a_claim_is_kept_while_a_tile_is_computed_and_then_released(folder, monkeypatch):
    monkeypatch.setattr("atlas.runs.claims.CLAIM_INTERVAL", 0.01)
    path = tile_path(folder.tiles, 3, SUFFIX)
    assert claim(folder.tiles.place, folder.tiles.name(3, SUFFIX))
    age(path, 100)
    before, ended = path.stat().st_mtime, time.monotonic() + 10
    with claims.held(folder.tiles.place, path.name):
        while path.stat().st_mtime < before + 90:
            assert time.monotonic() < ended
    assert not path.exists()


@pytest.mark.usual("written")
@pytest.mark.parametrize("end", ["written", "expired"])
def test_tiles_of_others_are_left_to_them_until_they_are_done_or_dead(end, folder, living, monkeypatch):
    other = tile_path(folder.tiles, 3, SUFFIX)
    other.write_text(living)
    computed, waits = [], []
    evaluate_at = folders.evaluate_at

    def counted(plan, scene, indices, *arguments, **options):
        computed.append(int(indices[0]) // 7)
        return evaluate_at(plan, scene, indices, *arguments, **options)

    def wait(event, seconds):
        waits.append(seconds)
        assert sorted(computed) == [0, 1, 2, 4, 5, 6, 7, 8]
        if end == "expired":
            age(other, claims.CLAIM_AGE + 10)
        else:
            columns, number, _ = evaluate_at(plan.runs, folder.scene, folder.tiles.indices(3))
            folder.tiles.write(3, columns, computed=number, seconds=0.0, by="the other one")
        return False

    plan = ScenePlan.of(folder.scene)
    monkeypatch.setattr(folders, "evaluate_at", counted)
    monkeypatch.setattr(folders, "Event", type("Event", (Event,), {"wait": wait}))
    ds = atlas.run(folder.scene, folder.path, threads=1, progress=False)
    assert waits == [claims.POLL]
    assert computed[8:] == ([] if end == "written" else [3])
    assert ("1 by the other one" in ds.attrs["atlas_run"]) == (end == "written")
    monkeypatch.undo()
    assert_same_bytes(atlas.run(folder.scene, progress=False), ds)
    assert list(folder.tiles.place.path.glob(f"*{SUFFIX}")) == ([other] if end == "written" else [])


def job_of(folder, shard=(1, 1)):
    """All tiles of a run, by one thread."""
    run = memory.Execution(ScenePlan.of(folder.scene), [], threads=1, shard=shard)
    return folders._Job(folder, folder.tiles, range(9), run)


def test_who_waits_for_others_ends_at_once_when_the_job_is_stopped(folder, living):
    for tile in range(9):
        tile_path(folder.tiles, tile, SUFFIX).write_text(living)
    job = job_of(folder)
    job.stop.set()
    assert list(job.remaining_tiles(range(9), None)) == []


def test_a_shard_begins_with_its_own_tiles(folder):
    tiles = [*job_of(folder, (2, 3)).remaining_tiles(range(9), None)]
    assert sorted(tiles[:3]) == [1, 4, 7]
    assert sorted(tiles) == [*range(9)]


def test_claims_of_killed_processes_are_removed(folder, living):
    tile_path(folder.tiles, 1, SUFFIX).write_text(living)
    tile_path(folder.tiles, 2, SUFFIX).write_text(dead(living))
    status(folder.path)
    assert [path.name for path in folder.tiles.place.path.iterdir()] == [f"00000001{SUFFIX}"]


@pytest.mark.long
def test_a_tile_that_another_process_has_finished_since_the_listing_is_not_computed_again(folder):
    skipped = []
    bar = type("Bar", (), {"skip": lambda self, points: skipped.append(points)})()
    remaining = job_of(folder).remaining_tiles(range(9), bar)
    first = next(remaining)
    other = (first + 4) % 9
    columns, number, _ = folders.evaluate_at(
        ScenePlan.of(folder.scene).runs, folder.scene, folder.tiles.indices(other)
    )
    folder.tiles.write(other, columns, computed=number, seconds=0.0, by="the other one")
    assert sorted([first, *remaining]) == sorted({*range(9)} - {other})
    assert skipped == [7]
    assert not tile_path(folder.tiles, other, SUFFIX).exists()
