"""Atlases joined along a dimension of names: a part answers as it did alone, the whole where no scene is needed."""

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput
from atlas.analysis.metadata import scene_of, scene_problem
from atlas.cli import main
from atlas.plotting.style import caption
from atlas.store.joined import part_of

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")
SCENE = tomllib.loads((Path(__file__).parent / "small.toml").read_text())
RADIUS = {
    "title": "radius",
    "ties": {"B": "A", "C": "sigma * A", "psi0": "0"},
    "family": {"name": "perp_radius", "solve": ["k3"]},
    "integration": {"duration": 20.0, "tolerance": 1e-4},
}
PLACE = {"sigma": 0.7, "theta0": 0.9}


@cache
def whole(**changes) -> xr.Dataset:
    """The atlas of small.toml after changes of tables."""
    return atlas.run(SCENE | changes, progress=False)


@cache
def radius() -> xr.Dataset:
    """The atlas of the second scene."""
    return atlas.run(SCENE | RADIUS, progress=False)


def parts() -> dict[str, xr.Dataset]:
    """Two atlases of different families, durations and tolerances."""
    return {"v": whole(title="velocity"), "r": radius()}


@pytest.fixture
def joined() -> xr.Dataset:
    """Both, joined."""
    return atlas.concat(parts(), "kind")


def same_answers(part: xr.Dataset, alone: xr.Dataset) -> None:
    """Every question to a part has the answer of the atlas alone."""
    ours, theirs = part.atlas, alone.atlas
    for question in (
        lambda a: a.trajectory(samples=5, **PLACE),
        lambda a: a.boundary(),
        lambda a: a.boundary("drifting"),
        lambda a: a.select(label="drifting"),
        lambda a: a.nearest(**PLACE),
        lambda a: a.trust(),
        lambda a: a.differences(whole()),
    ):
        xr.testing.assert_identical(
            question(ours).drop_attrs(deep=False), question(theirs).drop_attrs(deep=False)
        )
    for question in (lambda a: a.compare(), lambda a: a.compare(whole()), lambda a: a.cite(), repr):
        assert question(ours) == question(theirs)
    assert ours.families().keys() == theirs.families().keys()
    figures = [a.map(caption=True) for a in (ours, theirs)]
    texts = [[text.get_text() for text in figure.texts] for figure in figures]
    assert texts[0] == texts[1]
    lines = [[line.get_xydata() for line in figure.axes[0].lines] for figure in figures]
    assert len(lines[0]) == len(lines[1]) > 0
    for a, b in zip(*lines, strict=True):
        np.testing.assert_array_equal(a, b)
    assert scene_of(part).toml() == scene_of(alone).toml()
    assert scene_problem(part) == ""


@pytest.mark.long
@pytest.mark.parametrize("name", ["v", "r"])
@pytest.mark.parametrize("change", ["sel", "isel", "squeezed", "rewritten", "chunked", "one"])
def test_a_part_answers_as_it_did_alone(joined, name, change, tmp_path):
    part = joined.sel(kind=name)
    if change == "isel":
        part = joined.isel(kind=list(parts()).index(name))
    elif change == "squeezed":
        part = joined.sel(kind=[name]).squeeze()
    elif change == "chunked":
        part = joined.chunk(kind=1, sigma=3).sel(kind=name)
    elif change == "rewritten":
        joined.to_netcdf(tmp_path / "joined.nc")
        part = atlas.open_atlas(tmp_path / "joined.nc").sel(kind=name)
    elif change == "one":
        part.to_netcdf(tmp_path / "part.nc")
        part = atlas.open_atlas(tmp_path / "part.nc")
        assert caption(part) == caption(parts()[name])
    same_answers(part, parts()[name])


def test_a_part_is_the_atlas_with_all_its_attributes(joined):
    for name, alone in parts().items():
        part = part_of(joined.sel(kind=name))
        xr.testing.assert_identical(part, alone.assign_attrs(part.attrs))
        assert {k: str(v) for k, v in part.attrs.items()} == {k: str(v) for k, v in alone.attrs.items()}
        rejoined = atlas.concat({"again": joined.sel(kind=name)}, "kind").sel(kind="again")
        xr.testing.assert_identical(part_of(rejoined), part)


def test_the_whole_answers_what_needs_no_scene(joined):
    fractions = joined.atlas.fractions(along="kind")
    drifting = joined.atlas.select(label="drifting")
    for name, alone in parts().items():
        np.testing.assert_array_equal(fractions.sel(kind=name), alone.atlas.fractions())
        assert (drifting.kind == name).sum() == alone.atlas.select(label="drifting").sizes["point"]
    assert list(joined.atlas.to_dataframe().index.names) == ["kind", "sigma", "theta0"]


@pytest.mark.parametrize(
    "question",
    [
        lambda ds: ds.atlas.trajectory(**PLACE),
        lambda ds: ds.atlas.trajectory(),
        lambda ds: ds.isel(sigma=0, theta0=0).atlas.trajectory(),
        pytest.param(lambda ds: ds.atlas.frequencies(**PLACE), marks=pytest.mark.extension("frequencies")),
        lambda ds: ds.atlas.map(),
        lambda ds: ds.atlas.map("theta_max"),
        lambda ds: ds.atlas.boundary(),
        lambda ds: ds.atlas.boundary("drifting"),
        lambda ds: ds.atlas.families(),
        lambda ds: ds.atlas.compare(),
        lambda ds: ds.atlas.compare(ds),
        lambda ds: ds.atlas.nearest(**PLACE),
        lambda ds: ds.atlas.trust(),
        lambda ds: ds.atlas.roughness(),
        lambda ds: ds.atlas.cite(),
        lambda ds: ds.atlas.select(label="drifting").atlas.map(),
        lambda ds: ds.rename(kind="sort").sel(sort="r").atlas.map(),
        lambda ds: ds.sel(kind="r", drop=True).atlas.map(),
    ],
)
def test_the_whole_names_the_parts_where_one_scene_is_needed(joined, question):
    with pytest.raises(BadInput, match=r"^kind: joined atlases \(v, r\) .*\.sel\(kind=") as error:
        question(joined)
    assert "\n" not in str(error.value)


@pytest.mark.long
def test_lazy_parts_stay_lazy(tmp_path, monkeypatch):
    from atlas.store.tile import Tiles

    monkeypatch.setenv("ATLAS_TILE_POINTS", "16")
    for name in ("v.nc", "v"):
        atlas.run(SCENE | {"title": "velocity"}, tmp_path / name, progress=False)
    opened = [atlas.open_atlas(tmp_path / name) for name in ("v.nc", "v")]
    read, tiles = Tiles.read, set[int]()
    monkeypatch.setattr(
        Tiles, "read", lambda self, tile, *rest: (tiles.add(tile), read(self, tile, *rest))[1]
    )
    joined = atlas.concat({"file": opened[0], "run": opened[1], "memory": whole(title="velocity")}, "kind")
    assert not tiles
    assert all(array.chunks for array in joined.data_vars.values())
    assert joined.k3.chunks
    for name in ("file", "run", "memory"):
        xr.testing.assert_equal(joined.sel(kind=name).load().drop_vars("kind"), whole(title="velocity"))
        joined.sel(kind=name).atlas.trajectory(samples=3, **PLACE)


def test_points_without_a_scene_are_joined_too():
    a, b = (
        atlas.label_points("satellite", {"theta0": [0.4, 0.9], "m": m}, duration=2.0, step=step)
        for m, step in ((0.3, 0.05), (0.5, 0.04))
    )
    joined = atlas.concat({"a": a, "b": b}, "spin")
    for name, alone in (("a", a), ("b", b)):
        motions = [
            ds.atlas.trajectory(theta0=0.9, samples=3).drop_attrs(deep=False)
            for ds in (joined.sel(spin=name), alone)
        ]
        xr.testing.assert_identical(*motions)
    with pytest.raises(BadInput, match="spin: joined atlases"):
        joined.atlas.trajectory(theta0=0.9)


@pytest.mark.long
def test_a_part_in_a_file_is_mapped_by_the_shell(joined, tmp_path, capsys):
    joined.to_netcdf(tmp_path / "joined.nc")
    joined.sel(kind="r").to_netcdf(tmp_path / "part.nc")
    radius().to_netcdf(tmp_path / "alone.nc")
    assert main(["map", str(tmp_path / "joined.nc")]) == 2
    assert ".sel(kind=NAME)" in capsys.readouterr().err
    texts = []
    for name in ("part", "alone"):
        figure = tmp_path / f"{name}.png"
        assert main(["map", str(tmp_path / f"{name}.nc"), "-o", str(figure), "--caption"]) == 0
        texts.append((capsys.readouterr().out.split("wrote")[0], figure.read_bytes()))
    assert texts[0] == texts[1]
    assert "perp_radius" in texts[0][0]


def flags_changed(ds: xr.Dataset) -> xr.Dataset:
    """The atlas with another meaning of a flag."""
    return ds.assign(label=ds.label.assign_attrs(flag_meanings="a b c d e"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.isel(sigma=slice(3)), "sigma has other values"),
        (lambda ds: ds.assign_coords(sigma=ds.sigma * 2), "sigma has other values"),
        (lambda ds: ds.isel(sigma=0), "only one of them has sigma"),
        (lambda ds: ds.drop_vars("status"), "only one of them has status"),
        (lambda ds: ds.assign_attrs(atlas_system="fixed_point"), "atlas_system is 'satellite' and 'fixed_point'"),
        (lambda ds: ds.assign_attrs(atlas_version="0.0.1"), "atlas_version is "),
        (flags_changed, "label has other attributes"),
        (lambda ds: ds.assign_coords(m=ds.m.assign_attrs(units="g")), "m has other attributes"),
    ],
)  # fmt: skip
def test_other_atlases_are_refused(change, words):
    with pytest.raises(BadInput, match=r"^parts: a and b cannot be joined: .*") as error:
        atlas.concat({"a": whole(), "b": change(whole())}, "kind")
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda a: ([a, a], "kind"), "^parts = .*: must be a mapping"),
        (lambda a: ({}, "kind"), "^parts: must have at least one atlas"),
        (lambda a: ({1: a}, "kind"), "^parts: the name 1 must be a text"),
        (lambda a: ({"": a}, "kind"), "^parts: the name '' must be a text"),
        (lambda a: ({"a": a.label}, "kind"), "^parts: a = .*: must be the dataset of an atlas"),
        (lambda a: ({"a": a.drop_attrs()}, "kind"), "^parts: a = .*: must be the dataset of an atlas"),
        (lambda a: ({"a": atlas.concat({"b": a}, "kind")}, "other"), "^parts: a is joined itself"),
        (lambda a: ({"a": a}, 3), "^dim = 3: must be a text"),
        (lambda a: ({"a": a}, "two words"), "^dim = 'two words': must be a name"),
        (lambda a: ({"a": a}, "sigma"), "^dim = 'sigma': must be a name"),
        (lambda a: ({"a": a}, "label"), "^dim = 'label': must be a name"),
        (lambda a: ({"a": a}, "point"), "^dim = 'point': must be a name"),
    ],
)
def test_wrong_arguments_get_one_line(arguments, words):
    with pytest.raises(BadInput, match=words) as error:
        atlas.concat(*arguments(whole()))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"kind": 3}', '{"kind": {"a": {}}}', '{"a": {}, "b": {}}'])
def test_damaged_parts_get_one_line(joined, text):
    with pytest.raises(BadInput, match=r"^damaged: the attribute atlas_parts"):
        joined.sel(kind="r").assign_attrs(atlas_parts=text).atlas.map()


def test_plain_concat_of_joined_atlases_is_refused(joined):
    other = joined.assign_coords(kind=["a", "b"])
    with pytest.raises(BadInput, match="damaged"):
        xr.concat([joined, other], "kind").sel(kind="a").atlas.map()
