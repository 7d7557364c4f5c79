"""xr.open_dataset opens run folders and atlases."""

import json
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.runs.backend import AtlasBackend


@pytest.fixture(scope="module")
def run(tmp_path_factory, small_scene):
    """A run folder of several tiles, a file, and the atlas in memory."""
    folder = tmp_path_factory.mktemp("backend")
    scene = load_scene(small_scene)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATLAS_TILE_POINTS", "16")
        atlas.run(scene, f"{folder}/night/", progress=False)
    return folder / "night", folder / "small.nc", atlas.run(scene, folder / "small.nc", progress=False)


def test_the_package_declares_the_engine():
    """As its metadata have it in pyproject.toml: those that are installed may be older."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    ((name, value),) = project["entry-points"]["xarray.backends"].items()
    assert name == "atlas"
    assert EntryPoint(name, value, "xarray.backends").load() is AtlasBackend


@pytest.mark.usual("folder-None", "file-chunks1")
@pytest.mark.parametrize("chunks", [None, {}, {"theta0": 7}])
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_the_engine_opens_folders_and_files(run, kind, chunks):
    folder, file, whole = run
    path = folder if kind == "folder" else file
    with xr.open_dataset(path, engine=AtlasBackend, chunks=chunks) as ds:
        assert ds.label.dtype == np.int8
        assert (ds.chunks == {}) == (chunks is None)
        if kind == "folder" and chunks == {}:
            assert ds.label.chunks == ((2, 2, 2, 2, 1), (7,))  # a chunk for each tile
        for name in whole.variables:
            np.testing.assert_array_equal(ds[name], whole[name])
        assert ds.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
        assert ds.atlas.compare() == whole.atlas.compare()
    with xr.open_dataset(str(path), engine=AtlasBackend, drop_variables=["step", "absent"]) as ds:
        assert set(whole.variables) - set(ds.variables) == {"step"}


def test_only_run_folders_are_guessed(run, tmp_path):
    folder, file, _ = run
    guess = AtlasBackend().guess_can_open
    assert guess(folder)
    assert guess(f"{folder}/")
    (tmp_path / "manifest.json").write_text(json.dumps({"name": "an application of the web"}))
    for other in (file, tmp_path, tmp_path / "absent", "https://example.org/night", b"CDF", None):
        assert not guess(other)
    (tmp_path / "manifest.json").write_text("[")
    assert not guess(tmp_path)


def test_what_is_no_atlas_is_refused(tmp_path):
    with pytest.raises(BadInput, match="the engine atlas opens paths"):
        xr.open_dataset(b"CDF", engine=AtlasBackend)
    with pytest.raises(BadInput, match="there is no such file"):
        xr.open_dataset(tmp_path / "absent.nc", engine=AtlasBackend)
