"""Scenes as dictionaries: the same scenes, checks and words as from files."""

import tomllib

import numpy as np
import pytest
from installed import CONFIGS, example_scenes

import atlas
from atlas import BadInput, load_scene


@pytest.mark.parametrize("path", example_scenes(), ids=lambda path: path.stem)
def test_a_dictionary_is_the_scene_of_its_file(path, monkeypatch):
    monkeypatch.chdir(CONFIGS)  # of points files
    assert load_scene(tomllib.loads(path.read_text())).toml() == load_scene(path).toml()
    assert atlas.example(path.stem) == tomllib.loads(path.read_text())


def test_values_may_be_those_of_numpy(small_scene):
    table = tomllib.loads(small_scene)
    axes = {"theta0": {"values": [0.25, 0.5]}, "sigma": {"values": (1.0, 1.5)}}
    plain = table | {"axes": axes, "fixed": table["fixed"] | {"A": 2.0}, "seed": 3}
    arrays = {name: {"values": np.array(axis["values"])} for name, axis in axes.items()}
    fixed = table["fixed"] | {"A": np.float32(2.0)}
    own = table | {"axes": arrays, "fixed": fixed, "seed": np.int64(3)}
    assert load_scene(own).toml() == load_scene(plain).toml()


def test_a_points_file_may_be_a_path(tmp_path):
    (tmp_path / "points.csv").write_text("m,theta0\n0.1,0.2\n0.3,0.4\n")
    table = {"schema": 1, "system": "satellite", "points": {"file": tmp_path / "points.csv"}}
    text = table | {"points": {"file": str(tmp_path / "points.csv")}}
    assert load_scene(table).toml() == load_scene(text).toml()


def test_a_run_takes_a_dictionary(small_scene):
    table = tomllib.loads(small_scene)
    for axis in table["axes"].values():
        axis["count"] = 2
    before = str(table)
    ds = atlas.run(table, progress=False)
    assert ds.sizes == {"sigma": 2, "theta0": 2}
    assert str(table) == before
    assert load_scene(ds.attrs["atlas_scene"]).toml() == load_scene(table).toml()


def test_changes_of_an_example():
    whole = atlas.example("quickstart")
    scene = atlas.example(
        "quickstart", axes={"n": {"count": 5, "long_name": None}}, title="coarse", labels={}
    )
    assert scene["axes"]["n"] == {k: v for k, v in whole["axes"]["n"].items() if k != "long_name"} | {
        "count": 5
    }
    assert scene["axes"]["l3"] == whole["axes"]["l3"]
    assert scene["title"] == "coarse"
    assert atlas.example("quickstart") == whole
    assert "axes" not in atlas.example("quickstart", axes=None)
    assert load_scene(scene).shape == (load_scene(whole).shape[0], 5)


def test_a_dictionary_that_contains_itself():
    table = atlas.example("quickstart")
    table["fixed"]["A"] = table
    with pytest.raises(BadInput, match=r"^scene: nested too deeply$"):
        load_scene(table)


def test_an_example_that_there_is_not():
    with pytest.raises(BadInput, match=r"^quikstart: no such example; .*quickstart"):
        atlas.example("quikstart")
