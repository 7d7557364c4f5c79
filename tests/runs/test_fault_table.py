"""Faults of runs in every place: what is left, what a reader sees meanwhile, and that the same command finishes the atlas.

Kills of real processes stand in `test_runner`, `test_folder` and `test_zarr`, at length in `test_faults`.
"""

import hashlib
import json
import os
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from truth import assert_same_bytes, state, tile_path

import atlas
from atlas import BadInput, files, load_scene
from atlas.cli import main
from atlas.flags import Label
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.store import place
from atlas.store.tile import DamagedTile

pytestmark = pytest.mark.usefixtures("small_tiles")


@pytest.fixture(scope="module")
def scene(scene_text):
    few = ["label", "predicted", "status", "theta_dot_rms", "theta_max", "step"]
    return load_scene(scene_text({"outputs.variables": few}))


@dataclass(frozen=True)
class Run:
    """A run: what the command is given, and where its tiles are."""

    out: str

    @property
    def tiles_at(self) -> str:
        return self.out if self.out.endswith("/") else f"{self.out}.run"

    @property
    def folder(self) -> RunFolder:
        return RunFolder.open(place.located(self.tiles_at))

    def compute(self, scene):
        return atlas.run(scene, self.out, progress=False, threads=1)

    def left(self) -> list[str]:
        """Names of all files of the run that are left, and of the atlas."""
        if "://" in self.out:
            return sorted(place.place_at(self.tiles_at).walk())
        root = Path(self.out).parent
        return sorted(str(path.relative_to(root)) for path in root.rglob("*") if not path.is_dir())


OUTS = {
    "folder": "{}/night/", "file": "{}/night.nc", "store": "{}/night.zarr",
    "bucket": "memory://{}/night/", "store in a bucket": "memory://{}/night.zarr", "server": "s3://bucket/{}/night/",
}  # fmt: skip


@pytest.fixture
def run(request, tmp_path):
    """A run in one of the places."""
    if not request.param.startswith(("folder", "file")):
        pytest.importorskip("zarr")
        pytest.importorskip("obstore")
    if request.param == "server":
        request.getfixturevalue("server")
    out = OUTS[request.param]
    return Run(out.format(tmp_path.name if "://" in out else tmp_path))


def assert_recovers(run, scene, whole, evaluated, missing) -> None:
    """Meanwhile nothing is shown where a tile is missing; the same command computes those tiles alone and leaves nothing else."""
    tiling = run.folder.tiling
    absent = np.concatenate([tiling.indices(tile) for tile in missing])
    meanwhile = atlas.open_atlas(run.tiles_at)
    label = meanwhile.label.values.ravel()
    np.testing.assert_array_equal(np.flatnonzero(label == Label.NOT_COMPUTED), absent)
    assert np.isnan(meanwhile.theta_max.values.ravel()[absent]).all()
    present = np.setdiff1d(np.arange(63), absent)
    np.testing.assert_array_equal(label[present], whole.label.values.ravel()[present])
    evaluated.clear()
    with run.compute(scene) as ds:
        assert_same_bytes(whole, ds)
    assert sum(evaluated) == absent.size
    # The atlas that was opened before shows what is there now: all of it, or nothing where its tiles have become one file.
    if run.out.endswith("/"):
        assert_same_bytes(whole, meanwhile)
    else:
        assert (meanwhile.label.values == Label.NOT_COMPUTED).all()
        assert not [
            name for name in run.left() if not name.startswith(("night.nc", "night.zarr/")) or ".run/" in name
        ]
    assert not [name for name in run.left() if name.endswith((".tmp", ".claim"))]


@pytest.mark.usual("file-1", "folder-9", "bucket-8")
@pytest.mark.parametrize(
    ("run", "moment"),
    [("folder", 6), ("folder", 9), ("file", 1), ("store", 5), ("bucket", 8), ("store in a bucket", 5), ("server", 7)],
    indirect=["run"],
)  # fmt: skip
def test_an_interrupted_run(run, moment, scene, whole, evaluated, interrupt, capsys):
    """In the integration of a tile."""
    interrupt(moment)
    with pytest.raises(KeyboardInterrupt):
        run.compute(scene)
    after = state(run.folder.tiles)
    assert len(after.done) == moment - 1
    assert not after.damaged
    assert main(["status", run.tiles_at]) == 0
    assert f"done {moment - 1}, missing {10 - moment}" in capsys.readouterr().out
    assert_recovers(run, scene, whole, evaluated, after.missing)
    with atlas.open_atlas(run.out) as ds:
        assert_same_bytes(whole, ds)
        assert ds.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
        assert ds.atlas.compare() == whole.atlas.compare()
    if run.out.endswith("/"):
        with run.compute(scene) as ds:
            assert_same_bytes(whole, ds)
            assert "9 of 9 tiles" in ds.attrs["atlas_run"]
        assert len(evaluated) == len(after.missing)


@pytest.mark.usual("folder-12")
@pytest.mark.parametrize(("run", "moment"), [("folder", 12), ("file", 0), ("store", 12)], indirect=["run"])
def test_a_full_disk(run, moment, scene, whole, evaluated, monkeypatch):
    """After so many flushes of files."""
    RunFolder.prepare(ScenePlan.of(scene), place.located(run.tiles_at))
    calls, fsync = 0, os.fsync

    def full(handle):
        nonlocal calls
        calls += 1
        if calls > moment:
            raise OSError(28, "No space left on device")
        fsync(handle)

    with monkeypatch.context() as patched:
        patched.setattr(files.os, "fsync", full)
        with pytest.raises(OSError, match="No space"):
            run.compute(scene)
    after = state(run.folder.tiles)
    assert not after.damaged
    assert len(after.done) >= moment // 4
    assert not [
        name
        for name in run.left()
        if name.endswith(".tmp") or not name.startswith(("night/", "night.nc.run/", "night.zarr.run/"))
    ]
    assert_recovers(run, scene, whole, evaluated, after.missing)


# What is left as a claim, and the seconds since it was written: on a full disk by earlier versions, or by a clock that was ahead.
CLAIMS = {"empty": (b"", 60.0), "of the future": (b"00000000-00000000-1-1", -3600.0)}


@pytest.mark.usual("empty-folder-tiles/00000003.claim", "of the future-file-joining.claim")
@pytest.mark.parametrize(
    ("run", "name"),
    [("folder", "tiles/00000003.claim"), ("file", "joining.claim"), ("store", "manifest.claim")],
    indirect=["run"],
)
@pytest.mark.parametrize("fault", CLAIMS)
def test_a_claim_that_no_process_holds(run, name, fault, scene, whole, evaluated):
    """Nobody waits for it."""
    (content, seconds), path = CLAIMS[fault], Path(run.tiles_at)
    if name == "manifest.claim":
        path.mkdir()
    else:
        RunFolder.prepare(ScenePlan.of(scene), path)
    (path / name).write_bytes(content)
    os.utime(path / name, (time.time() - seconds,) * 2)
    began = time.monotonic()
    with run.compute(scene) as ds:
        assert_same_bytes(whole, ds)
    assert time.monotonic() - began < 60
    assert sum(evaluated) == 63
    assert not [name for name in run.left() if name.endswith((".tmp", ".claim"))]


def forged(content: bytes, **facts) -> bytes:
    """A tile with other facts in its header, whose hash fits."""
    line, _, parts = content[:-32].partition(b"\n")
    content = json.dumps(json.loads(line) | facts).encode() + b"\n" + parts
    return content + hashlib.sha256(content).digest()


def flipped(content: bytes, at: int, bit: int = 0) -> bytes:
    changed = bytearray(content)
    changed[at] ^= 1 << bit
    return bytes(changed)


TALLY = {"counts": {"label": {"2": "many"}}, "largest": {}}
# What becomes of a tile, and of another one, from the contents of all; a tile without content is gone.
DAMAGES = {
    "another tile": lambda tiles, tile: {tile: tiles[(tile + 2) % 9]},
    "removed": lambda tiles, tile: {tile: None},
    "truncated": lambda tiles, tile: {tile: tiles[tile][: len(tiles[tile]) // 2]},
    "one flipped bit": lambda tiles, tile: {tile: flipped(tiles[tile], len(tiles[tile]) // 2)},
    "empty": lambda tiles, tile: {tile: b""},
    "of another run": lambda tiles, tile: {tile: forged(tiles[tile], key="0" * 64)},
    "swapped": lambda tiles, tile: {tile: tiles[tile + 1], tile + 1: tiles[tile]},
    "zeroed": lambda tiles, tile: {tile: bytes(len(tiles[tile]))},
    "no tile": lambda tiles, tile: {tile: b"hello"},
    "another number": lambda tiles, tile: {tile: forged(tiles[tile], tile=8 - tile)},
    "fewer points": lambda tiles, tile: {tile: forged(tiles[tile], points=1)},
    "endless points": lambda tiles, tile: {tile: forged(tiles[tile], points=10**18)},
    "no columns": lambda tiles, tile: {tile: forged(tiles[tile], columns={})},
    "columns of another kind": lambda tiles, tile: {tile: forged(tiles[tile], columns=[1])},
    "seconds of another kind": lambda tiles, tile: {tile: forged(tiles[tile], seconds="long")},
    "a tally of another kind": lambda tiles, tile: {tile: forged(tiles[tile], tally=TALLY)},
}  # fmt: skip
# In a folder, what is no file at all.
OBSTACLES = {"a FIFO": os.mkfifo, "endless": lambda path: path.symlink_to("/dev/zero")}


def values_of(content: bytes) -> bytes:
    """The columns of a tile, without what computed it."""
    return content[content.index(b"\n") : -32]


# What the header of a tile says does not depend on its place, and a server differs from a bucket in memory by its answers.
@pytest.mark.usual("bucket-names1")
@pytest.mark.parametrize(
    ("run", "names"),
    [("folder", [*DAMAGES, *OBSTACLES]), ("bucket", [*DAMAGES][:7]), ("server", [*DAMAGES][:2])],
    indirect=["run"],
)
def test_a_damaged_tile(run, names, scene, whole, tmp_path, evaluated, caplog, capsys):
    """Each alone is found by `status --verify` and by a join; the next run computes all of them again."""
    run.compute(scene).close()
    tiles, joined = run.folder.tiles, tmp_path / "joined.nc"
    contents = {tile: tiles.place.read(tiles.name(tile)) for tile in range(9)}

    def damage(name, tile):
        changes = DAMAGES.get(name, lambda tiles, tile: {tile: None})(contents, tile)
        for each, content in changes.items():
            tiles.place.remove(tiles.name(each))
            if content is not None:
                tiles.place.write(tiles.name(each), content)
        if name in OBSTACLES:
            OBSTACLES[name](tile_path(tiles, tile))
        return changes

    for name in names:
        changes = damage(name, 3)
        after, lost = state(tiles), name == "removed"
        assert (after.missing, [*after.damaged]) == (([3], []) if lost else ([], [*changes])), name
        assert main(["status", run.out, "--verify"]) == 0
        counts = (8, 0, 1) if lost else (9 - len(changes), len(changes), 0)
        assert "done {}, damaged {}, missing {}".format(*counts) in capsys.readouterr().out, name
        joined.write_text("an older atlas_version")
        with pytest.raises(BadInput):
            run.folder.join(joined)
        assert joined.read_text() == "an older atlas_version", name
        for tile in changes:
            tiles.place.remove(tiles.name(tile))
            tiles.place.write(tiles.name(tile), contents[tile])
    while names:  # in a few tiles at a time, each of which is named in the log
        damaged = {}
        while names and len(damaged) < 5:
            damaged |= dict.fromkeys(damage(names[0], len(damaged)), names[0])
            names = names[1:]
        caplog.clear()
        assert_recovers(run, scene, whole, evaluated, [*damaged])
        for tile, name in damaged.items():
            reason = ": it is a tile of another run or place" if name in ("another tile", "swapped") else ""
            assert name == "removed" or f"tile {tile} is computed again{reason}" in caplog.text, name
            assert values_of(tiles.place.read(tiles.name(tile))) == values_of(contents[tile]), name
    assert main(["join", run.out, "-o", str(joined), "--force"]) == 0
    with atlas.open_atlas(joined) as ds:
        assert_same_bytes(whole, ds)


@pytest.mark.usual("file")
@pytest.mark.parametrize("run", ["file", "store in a bucket"], indirect=True)
def test_a_tile_that_is_damaged_after_an_interruption(run, scene, whole, evaluated, interrupt, caplog):
    """It is computed again before the tiles are joined."""
    interrupt(5)
    with pytest.raises(KeyboardInterrupt):
        run.compute(scene)
    after = state(run.folder.tiles)
    tiles, tile = run.folder.tiles, after.done[0]
    content = tiles.place.read(tiles.name(tile))
    tiles.place.remove(tiles.name(tile))
    tiles.place.write(tiles.name(tile), flipped(content, len(content) // 2))
    assert_recovers(run, scene, whole, evaluated, sorted([tile, *after.missing]))
    assert f"tile {tile} is computed again: its hash differs" in caplog.text


def read_run(path):
    """What a run folder holds, where no tile is damaged."""
    run = RunFolder.open(path)
    if state(run.tiles).damaged:
        raise BadInput("damaged")
    return repr(run.dataset().attrs), run.dataset()


# A file of a run, the function that reads it, and the number of flipped bits; those of a tile are always seen.
FLIPPED = {
    "tiles/00000003.tile": (lambda path: partial(RunFolder.open(path).tiles.read, 3), 300),
    "manifest.json": (lambda path: lambda: RunFolder.open(path).manifest, 300),
    "notes.json": (lambda path: partial(read_run, path), 20),
}


def assert_same(one, other) -> None:
    """Equal manifests, or equal attributes and bytes of atlases."""
    if isinstance(one, dict):
        assert one == other
    else:
        assert one[0] == other[0]
        assert_same_bytes(one[1], other[1])


@pytest.mark.usual("tiles/00000003.tile")
@pytest.mark.parametrize("name", FLIPPED)
def test_a_flipped_bit_never_gives_other_data(name, scene, tmp_path):
    atlas.run(scene, f"{tmp_path}/night/", progress=False).close()
    (reader, count), path, rng = FLIPPED[name], tmp_path / "night" / name, np.random.default_rng(6)
    read = reader(tmp_path / "night")
    content, expected, refused = path.read_bytes(), read(), 0
    places = [*rng.integers(0, len(content), count)]
    if name == "manifest.json":
        places.append(content.index(b'"atlas_method": "rk4"') + 18)
    for at in places:
        path.write_bytes(flipped(content, at, int(rng.integers(8))))
        try:
            assert_same(expected, read())
        except DamagedTile as error:
            assert "its hash differs" in str(error)  # noqa: PT017
            refused += 1
        except BadInput as error:
            assert "\n" not in str(error)  # noqa: PT017
            refused += 1
    assert refused > 5
    assert not name.startswith("tiles") or refused == len(places)
    if name == "manifest.json":
        path.write_bytes(content.replace(b'"atlas_method": "rk4"', b'"atlas_method": "rk8"'))
        with pytest.raises(BadInput, match="checksum"):
            read()
