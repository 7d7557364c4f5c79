"""The finished atlas as a Zarr store, in a folder and on an object store."""

import json
import os
import pickle
import warnings

import numpy as np
import pytest
import xarray as xr
from truth import assert_same_bytes, tile_path

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.runs.run import RunFolder
from atlas.store import dataset, finished
from atlas.store.place import Folder, Objects

zarr = pytest.importorskip("zarr")
ADDRESS = "memory://zarr"


@pytest.fixture(scope="module")
def run(tmp_path_factory, scene_text):
    """A run folder of 18 tiles, and the atlas in memory."""
    path = tmp_path_factory.mktemp("zarr") / "night"
    few = {"outputs.variables": ["label", "predicted", "status", "theta_max", "step"]}
    scene = load_scene(scene_text(few | {"axes.sigma.count": 18, "axes.theta0.count": 48}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATLAS_TILE_POINTS", "64")
        atlas.run(scene, f"{path}/", progress=False)
    folder = RunFolder.open(path)
    assert folder.tiling.count == 18
    return folder, atlas.run(scene, progress=False)


@pytest.fixture
def store(run, tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "96")
    run[0].join(tmp_path / "night.zarr")
    return tmp_path / "night.zarr"


def files_of(path, name):
    return [file for file in (path / name / "c").rglob("*") if file.is_file()]


@pytest.mark.usual("96-9")
@pytest.mark.parametrize(("points_per_chunk", "files"), [(65536, 1), (96, 9), (20, 54)])
def test_a_store_holds_the_atlas(run, tmp_path, monkeypatch, points_per_chunk, files):
    folder, whole = run
    monkeypatch.setenv("ATLAS_TILE_POINTS", str(points_per_chunk))
    folder.join(tmp_path / "night.zarr")
    assert len(files_of(tmp_path / "night.zarr", "label")) == files
    with atlas.open_atlas(tmp_path / "night.zarr") as ds, folder.dataset() as expected:
        assert set(ds.coords) == set(whole.coords)
        xr.testing.assert_identical(ds.load().drop_attrs(deep=False), expected.load().drop_attrs(deep=False))
        assert ds.attrs.keys() == expected.attrs.keys()
        assert_same_bytes(whole, ds)
        assert ds.atlas.compare() == whole.atlas.compare()
        assert ds.atlas.map().axes
        assert ds.atlas.select(label=3).sizes == whole.atlas.select(label="drifting").sizes


@pytest.mark.long
def test_large_parameters_are_written_in_parts(run, tmp_path, monkeypatch):
    folder, whole = run
    monkeypatch.setattr(dataset, "MAX_EAGER_VALUES", 1)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "96")
    folder.join(tmp_path / "night.zarr")
    with atlas.open_atlas(tmp_path / "night.zarr") as ds:
        for name in ("C", "k3", "Omega"):
            np.testing.assert_array_equal(ds[name], whole[name])


@pytest.mark.long
def test_other_programs_read_a_store(run, store):
    _, whole = run
    for consolidated in (True, False):
        with xr.open_zarr(store, consolidated=consolidated) as ds:
            np.testing.assert_array_equal(ds.label, whole.label)
            np.testing.assert_array_equal(ds.k3, whole.k3)
            assert ds.label.attrs["flag_values"] == [0, 1, 2, 3, 4]
    with xr.open_dataset(store, engine="zarr", consolidated=False, chunks={}) as ds:
        assert ds.atlas.fractions().identical(whole.atlas.fractions())


@pytest.mark.long
def test_a_store_can_be_pickled(run, store):
    with atlas.open_atlas(store) as ds:
        assert_same_bytes(run[1], pickle.loads(pickle.dumps(ds)))


def damaged(path, name):
    """Whether reading a variable ends in one line."""
    with atlas.open_atlas(path) as ds:
        try:
            ds[name].load()
        except Exception as error:
            return type(error).__name__, str(error)
    return None


@pytest.mark.long
def test_damage_is_found(store, capsys):
    """A flipped bit and a lost object when they are read; an object in the place of another by `status --verify`."""
    whole = store / "label" / "c" / "0" / "0"
    content = whole.read_bytes()
    for place in range(3, len(content), len(content) // 9):
        changed = bytearray(content)
        changed[place] ^= 16
        whole.write_bytes(changed)
        assert damaged(store, "label")
        assert main(["status", str(store), "--verify"]) == 2
        assert "damaged: its objects are not those that were written" in capsys.readouterr().err
        assert main(["compare", str(store)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    whole.unlink()
    with pytest.raises(BadInput, match=r"the values of label are damaged: the object label/c/0/0 is lost"):
        atlas.open_atlas(store).label.load()
    for broken in (lambda: os.mkfifo(whole), lambda: whole.symlink_to("/dev/zero")):
        broken()
        with pytest.raises(BadInput, match="no regular file"):
            atlas.open_atlas(store).label.load()
        whole.unlink()
    whole.write_bytes((store / "label" / "c" / "8" / "0").read_bytes())
    (store / "label" / "c" / "8" / "0").write_bytes(content)
    assert main(["status", str(store), "--verify"]) == 2
    assert "damaged" in capsys.readouterr().err
    (store / "label" / "c" / "8" / "0").write_bytes(whole.read_bytes())
    whole.write_bytes(content)
    assert main(["status", str(store), "--verify"]) == 0
    text = (store / "zarr.json").read_text()
    for old, new in (
        ("satellite", "satelite"),
        ('"s"', '"h"'),
        (text[-9:], ""),
        ('"chunk_shape": [2', '"chunk_shape": [1'),
    ):
        assert old in text
        (store / "zarr.json").write_text(text.replace(old, new))
        with pytest.raises(BadInput, match="not a Zarr store that can be read"):
            atlas.open_atlas(store)
    (store / "zarr.json").write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))
    with pytest.raises(BadInput, match="not an atlas: the attribute atlas_system is missing"):
        atlas.open_atlas(store)


@pytest.mark.usual("sigma/c/0")
@pytest.mark.parametrize("other", ["theta_max/c/0/0", "label/c", "sigma/c/0"])
def test_an_object_of_another_form_is_refused(store, other):
    """Of another type, or unpacking to more numbers than its chunk has."""
    from google_crc32c import value as crc32c
    from numcodecs import Blosc

    path = store / "label" / "c" / "0" / "0"
    if other == "label/c":
        content = bytes(Blosc("zstd").encode(np.ones(50_000_000, np.int8)))
        path.write_bytes(content + crc32c(content).to_bytes(4, "little"))
    else:
        path.write_bytes((store / other).read_bytes())
    with pytest.raises(BadInput, match="the values of label are damaged: the object label/c/0/0"):
        atlas.open_atlas(store).label.load()


@pytest.mark.long
def test_a_copy_by_another_program_is_read_as_it_is(store, tmp_path, capsys):
    with atlas.open_atlas(store) as ds, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ds.to_zarr(tmp_path / "copy.zarr")
    with atlas.open_atlas(tmp_path / "copy.zarr") as copy, atlas.open_atlas(store) as ds:
        np.testing.assert_array_equal(copy.label, ds.label)
    assert not finished.format_of(tmp_path / "copy.zarr").has_hash(tmp_path / "copy.zarr")
    assert main(["status", f"{tmp_path}/copy.zarr", "--verify"]) == 2
    assert "has no hash" in capsys.readouterr().err


def test_a_store_that_claims_more_than_its_files_can_hold_is_refused(store, tmp_path):
    metadata = json.loads((store / "zarr.json").read_text())
    del metadata["attributes"][dataset.HASH]
    del metadata["consolidated_metadata"]
    (store / "zarr.json").write_text(json.dumps(metadata))
    axis = json.loads((store / "sigma" / "zarr.json").read_text())
    (store / "sigma" / "zarr.json").write_text(json.dumps(axis | {"shape": [10**12]}))
    with pytest.raises(BadInput, match=r"claims 8e\+12 bytes of numbers"):
        atlas.open_atlas(store)
    group = zarr.create_group(tmp_path / "bomb.zarr", attributes=metadata["attributes"])
    group.create_array("theta_max", shape=(40, 12), chunks=(40, 6_000_000), dtype="f8")
    with pytest.raises(BadInput, match="the chunks of theta_max are larger than the array"):
        atlas.open_atlas(tmp_path / "bomb.zarr")


@pytest.mark.long
def test_a_join_that_fails_leaves_what_was_there(run, store, monkeypatch):
    folder, _ = run
    before = (store / "zarr.json").read_bytes()

    def fail(*args, **options):
        raise KeyboardInterrupt

    for module, name in ((zarr, "consolidate_metadata"), (zarr, "open_group")):
        with monkeypatch.context() as patched:
            patched.setattr(module, name, fail)
            with pytest.raises(KeyboardInterrupt):
                folder.join(store)
            with pytest.raises(KeyboardInterrupt):
                folder.join(store.parent / "new.zarr")
        assert [entry.name for entry in store.parent.iterdir()] == [store.name]
        assert (store / "zarr.json").read_bytes() == before
    path = tile_path(folder.tiles, 3)
    content = path.read_bytes()
    try:
        path.write_bytes(content[:-1])
        with pytest.raises(BadInput, match=r"tile 3: its hash differs; run its scene again first"):
            folder.join(store)
    finally:
        path.write_bytes(content)
    assert [entry.name for entry in store.parent.iterdir()] == [store.name]


@pytest.mark.long
def test_an_export_to_an_object_store_that_is_killed_is_refused_and_finished(scene_text, monkeypatch, capsys):
    """At any object, also while those of the time before are removed: what is there is no atlas, and the same command makes it one."""
    pytest.importorskip("obstore")
    few = {"outputs.variables": ["label", "theta_max"], "axes.sigma.count": 3}
    scene, out = load_scene(scene_text(few)), f"{ADDRESS}/night.zarr"
    whole, write, clear = atlas.run(scene, progress=False), Objects.write, Objects.clear
    root = Objects(out)
    left = 0
    while not finished.format_of(out).has_hash(out):
        left += 17
        count = left

        def killed(self, name, content, *, durable=True):
            nonlocal count
            if self.address == out:
                count -= 1
                if count < 0:
                    raise ConnectionAbortedError
            write(self, name, content, durable=durable)

        def half_cleared(self, **options):
            if self.address != out:
                return clear(self, **options)
            for name in set(self.walk()[::2]) - {"zarr.json"}:
                self.remove(name)
            raise ConnectionAbortedError

        for method, replacement in (("write", killed), ("clear", half_cleared)):
            with monkeypatch.context() as patched:
                patched.setattr(Objects, method, replacement)
                try:
                    atlas.run(scene, out, progress=False)
                    break
                except ConnectionAbortedError:
                    with pytest.raises(BadInput, match=r"unfinished: .* the same command finishes it"):
                        atlas.open_atlas(out)
    assert left > 40
    with atlas.open_atlas(out) as ds:
        assert_same_bytes(whole, ds)
    assert Objects(f"{out}.run").walk() == []
    with pytest.raises(BadInput, match="this file exists"):
        atlas.run(scene, out, progress=False)
    root.remove("label/c/0/0")
    with pytest.raises(BadInput, match="this file exists"):
        atlas.run(scene, out, progress=False)
    assert_same_bytes(whole, atlas.run(scene, out, force=True, progress=False))


@pytest.mark.long
def test_a_run_that_was_killed_after_its_export_is_finished_unless_the_store_is_damaged(
    scene_text, tmp_path, monkeypatch, evaluated
):
    scene = load_scene(scene_text({"outputs.variables": ["label", "theta_max"]}))
    out = tmp_path / "night.zarr"
    with monkeypatch.context() as patched:
        patched.setattr(RunFolder, "remove", lambda self: None)
        whole = atlas.run(scene, out, progress=False).load()
    evaluated.clear()
    content = (out / "label" / "c" / "0" / "0").read_bytes()
    (out / "label" / "c" / "0" / "0").write_bytes(content[:-1] + b"x")
    with pytest.raises(BadInput, match="damaged: its objects are not those that were written"):
        atlas.run(scene, out, progress=False)
    assert (tmp_path / "night.zarr.run" / "manifest.json").exists()
    assert_same_bytes(whole, atlas.run(scene, out, force=True, progress=False))  # from its run
    assert evaluated == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["night.zarr"]


def test_the_command_join_writes_stores(run, tmp_path, capsys):
    folder, _ = run
    out = tmp_path / "a.zarr"
    assert main(["join", str(folder.path), "-o", str(out)]) == 0
    assert main(["join", str(folder.path), "-o", str(out)]) == 2
    assert "this file exists; --force" in capsys.readouterr().err
    assert main(["join", str(folder.path), "-o", str(out), "--force"]) == 0
    assert main(["compare", str(out)]) == 0
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "zarr.json").write_text('{"attributes": {}}')
    for place in ("other.zarr", "a.zarr", "a.zarr/label"):
        (tmp_path / place / "thesis.txt").write_text("mine")
        before = sorted(tmp_path.rglob("*"))
        name = str(tmp_path / place[:10].partition("/")[0])
        for command in (["join", str(folder.path)], ["run", str(folder.path.parent / "scene.toml")]):
            (folder.path.parent / "scene.toml").write_text(folder.scene.toml())
            assert main([*command, "-o", name, "--force"]) == 2
            assert "holds something else than an atlas" in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before
        (tmp_path / place / "thesis.txt").unlink()
    assert Folder(out).walk()


@pytest.mark.long
@pytest.mark.parametrize("address", ["", f"{ADDRESS}/replaced.zarr"])
def test_a_store_that_is_replaced_below_its_reader_never_mixes(run, tmp_path, address):
    """Also where the new one is that of the same scene, and in a process that got the dataset."""
    path = address or tmp_path / "a.zarr"
    run[0].join(path)
    readers = [atlas.open_atlas(path)]
    if not address:
        readers.append(pickle.loads(pickle.dumps(readers[0])))
    for ds in readers:
        assert ds.theta_max[0, 0].item() == run[1].theta_max[0, 0].item()
    atlas.run(run[0].scene, path, force=True, progress=False).close()
    for ds in readers:
        with pytest.raises(
            BadInput, match=r"\.zarr: was replaced or removed after it was opened; open it again$"
        ):
            ds.theta_max.load()
    with atlas.open_atlas(path) as again:
        np.testing.assert_array_equal(again.theta_max, run[1].theta_max)
