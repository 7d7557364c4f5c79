"""Run folders joined as Zarr stores."""

import json
import warnings

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.io import netcdf, zarr_store
from atlas.io.storage import Folder
from atlas.runs import folder as folder_module
from atlas.runs.folder import RunFolder
from atlas.scene import grid

pytest.importorskip("zarr")


@pytest.fixture(scope="module")
def run(tmp_path_factory, scene_text):
    """A run folder of 18 tiles, and the atlas in memory."""
    path = tmp_path_factory.mktemp("zarr") / "night"
    few = {"outputs.variables": ["label", "predicted", "status", "theta_max", "step"]}
    scene = load_scene(scene_text(few | {"axes.sigma.count": 18, "axes.theta0.count": 48}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grid, "MAX_POINTS_PER_TILE", 64)
        atlas.run(scene, f"{path}/", progress=False)
    folder = RunFolder.open(path)
    assert folder.tiling.count == 18
    return folder, atlas.run(scene, progress=False)


@pytest.fixture
def store(run, tmp_path):
    run[0].join(tmp_path / "night.zarr")
    return tmp_path / "night.zarr"


def files_of(path, name):
    return [file for file in (path / name / "c").rglob("*") if file.is_file()]


@pytest.mark.parametrize(
    ("points_per_chunk", "chunks_per_shard", "files"), [(65536, 16, 1), (96, 4, 3), (20, 3, 18)]
)
def test_a_store_holds_the_atlas(run, tmp_path, monkeypatch, points_per_chunk, chunks_per_shard, files):
    folder, whole = run
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", points_per_chunk)
    monkeypatch.setattr(folder_module, "SHARD_CHUNKS", chunks_per_shard)
    folder.join(tmp_path / "night.zarr")
    assert len(files_of(tmp_path / "night.zarr", "label")) == files
    with atlas.open_atlas(tmp_path / "night.zarr") as ds, folder.dataset() as expected:
        assert set(ds.coords) == set(whole.coords)
        xr.testing.assert_identical(ds.load().drop_attrs(deep=False), expected.load().drop_attrs(deep=False))
        assert ds.attrs.keys() == expected.attrs.keys()
        assert {name: a.dtype for name, a in ds.variables.items()} == {
            name: a.dtype for name, a in whole.variables.items()
        }
        assert ds.atlas.compare() == whole.atlas.compare()
        assert ds.atlas.map().axes
        assert ds.atlas.select(label=3).sizes == whole.atlas.select(label="drifting").sizes


def test_large_parameters_are_written_in_parts(run, tmp_path, monkeypatch):
    folder, whole = run
    monkeypatch.setattr(netcdf, "MAX_EAGER_VALUES", 1)
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 96)
    folder.join(tmp_path / "night.zarr")
    with atlas.open_atlas(tmp_path / "night.zarr") as ds:
        for name in ("C", "k3", "Omega"):
            np.testing.assert_array_equal(ds[name], whole[name])


def test_other_programs_read_a_store(run, store):
    _, whole = run
    with xr.open_zarr(store, consolidated=False) as ds:
        np.testing.assert_array_equal(ds.label, whole.label)
        np.testing.assert_array_equal(ds.k3, whole.k3)
        assert ds.label.attrs["flag_values"] == [0, 1, 2, 3, 4]
    with xr.open_dataset(store, engine="zarr", consolidated=False, chunks={}) as ds:
        assert ds.atlas.fractions().identical(whole.atlas.fractions())


def test_damage_is_found(store):
    whole = store / "label" / "c" / "0" / "0"
    content = whole.read_bytes()
    for place in range(3, len(content), len(content) // 9):
        damaged = bytearray(content)
        damaged[place] ^= 16
        whole.write_bytes(damaged)
        with atlas.open_atlas(store) as ds, pytest.raises(BadInput, match="the values of label are damaged"):
            ds.label.load()
    whole.unlink()
    with atlas.open_atlas(store) as ds, pytest.raises(BadInput, match="the values of label are damaged"):
        ds.label.load()
    whole.write_bytes(content)
    with atlas.open_atlas(store) as ds:
        ds.label.load()
        ds.label.load()
    text = (store / "zarr.json").read_text()
    changes = [
        ("satellite", "satelite"),
        ('"s"', '"h"'),
        (text[-9:], ""),
        ('"chunk_shape": [18', '"chunk_shape": [9'),
    ]
    for old, new in [*changes, (zarr_store.SEAL, "atlas_seaz")]:
        assert old in text
        (store / "zarr.json").write_text(text.replace(old, new))
        with pytest.raises(BadInput, match="not a Zarr store that can be read"):
            atlas.open_atlas(store)
    (store / zarr_store.OBJECTS).unlink()
    (store / "zarr.json").write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))
    with pytest.raises(BadInput, match="not an atlas: the attribute atlas_system is missing"):
        atlas.open_atlas(store)


def test_objects_are_bound_to_their_array_and_place(run, tmp_path, monkeypatch):
    """Whole objects in each other's place; the table of their hashes."""
    monkeypatch.setattr(folder_module, "SHARD_CHUNKS", 4)
    monkeypatch.setattr(grid, "MAX_POINTS_PER_TILE", 96)
    store = tmp_path / "night.zarr"
    run[0].join(store)
    pairs = [("label/c/0/0", "predicted/c/0/0"), ("label/c/0/0", "label/c/1/0"), ("A/c", "mu1/c")]
    for one, other in pairs:
        contents = (store / one).read_bytes(), (store / other).read_bytes()
        if contents[0] == contents[1]:  # where all labels are as predicted
            continue
        (store / one).write_bytes(contents[1])
        name = one.partition("/")[0]
        with (
            atlas.open_atlas(store) as ds,
            pytest.raises(BadInput, match=f"the values of {name} are damaged"),
        ):
            ds[name].load()
        (store / one).write_bytes(contents[0])
    with atlas.open_atlas(store) as ds:
        ds.load()
    objects = (store / zarr_store.OBJECTS).read_text()
    (store / zarr_store.OBJECTS).write_text(objects.replace("label/c/0/0", "label/c/9/0"))
    with pytest.raises(BadInput, match="not a Zarr store that can be read"):
        atlas.open_atlas(store)
    (store / zarr_store.OBJECTS).unlink()
    with pytest.raises(BadInput, match="not a Zarr store that can be read"):
        atlas.open_atlas(store)


def test_a_copy_by_another_program_is_read_as_it_is(store, tmp_path):
    with atlas.open_atlas(store) as ds, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ds.to_zarr(tmp_path / "copy.zarr")
    with atlas.open_atlas(tmp_path / "copy.zarr") as copy, atlas.open_atlas(store) as ds:
        np.testing.assert_array_equal(copy.label, ds.label)
    assert not zarr_store.is_whole(Folder(tmp_path / "copy.zarr"))


def test_a_store_that_claims_more_than_its_files_can_hold_is_refused(store):
    metadata = json.loads((store / "zarr.json").read_text())
    del metadata["attributes"][zarr_store.SEAL]
    (store / zarr_store.OBJECTS).unlink()
    del metadata["consolidated_metadata"]
    (store / "zarr.json").write_text(json.dumps(metadata))
    axis = json.loads((store / "sigma" / "zarr.json").read_text())
    (store / "sigma" / "zarr.json").write_text(json.dumps(axis | {"shape": [10**12]}))
    with pytest.raises(BadInput, match=r"claims 8e\+12 bytes of numbers"):
        atlas.open_atlas(store)


def test_a_join_that_fails_leaves_what_was_there(run, store, monkeypatch):
    folder, _ = run
    before = (store / "zarr.json").read_bytes()

    def fail(*args):
        raise KeyboardInterrupt

    for name in ("encode", "seal"):
        with monkeypatch.context() as patched:
            patched.setattr(zarr_store, name, fail)
            with pytest.raises(KeyboardInterrupt):
                folder.join(store)
            with pytest.raises(KeyboardInterrupt):
                folder.join(store.parent / "new.zarr")
        assert [entry.name for entry in store.parent.iterdir()] == [store.name]
        assert (store / "zarr.json").read_bytes() == before
    path = folder.tiles.path(3)
    content = path.read_bytes()
    try:
        path.write_bytes(content[:-1])
        with pytest.raises(BadInput, match=r"tile 3: its hash differs; run its scene again first"):
            folder.join(store)
    finally:
        path.write_bytes(content)
    assert [entry.name for entry in store.parent.iterdir()] == [store.name]


def test_the_command_join_writes_stores(run, tmp_path, capsys):
    folder, _ = run
    out = tmp_path / "a.zarr"
    assert main(["join", str(folder.path), "-o", str(out)]) == 0
    assert main(["join", str(folder.path), "-o", str(out)]) == 2
    assert "this file exists; --force" in capsys.readouterr().err
    assert main(["join", str(folder.path), "-o", str(out), "--force"]) == 0
    assert main(["compare", str(out)]) == 0
    (tmp_path / "other.zarr").mkdir()
    assert main(["join", str(folder.path), "-o", str(tmp_path / "other.zarr"), "--force"]) == 2
    assert "this is a folder" in capsys.readouterr().err
    (tmp_path / "other.zarr" / "zarr.json").write_text('{"attributes": {}}')
    for place in ("other.zarr", "a.zarr", "a.zarr/label", "a.zarr/atlas"):
        (tmp_path / place / "thesis.txt").write_text("mine")
        before = sorted(tmp_path.rglob("*"))
        assert (
            main(["join", str(folder.path), "-o", str(tmp_path / place[:10].partition("/")[0]), "--force"])
            == 2
        )
        assert "holds something else than an atlas" in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before
        (tmp_path / place / "thesis.txt").unlink()
