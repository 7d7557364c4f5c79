"""Scenes of strangers: names that clash, limits that hold before anything is made, and text that is safe to print."""

import os
import threading
import tracemalloc
import warnings
from contextlib import suppress

import numpy as np
import pytest
import tomli_w
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.analysis import compare, metadata
from atlas.errors import MAX_MESSAGE, MAX_TEXT, printable, shown
from atlas.scene import grid, points, tables
from atlas.scene.expressions import Expression
from atlas.store import dataset
from atlas.systems import SYSTEMS
from atlas.variables import COMPUTED, data_variables

pytestmark = pytest.mark.usefixtures("whole_kernels")

HEAD = 'schema = 1\nsystem = "satellite"\n'


def axis(name, count, **more):
    return tomli_w.dumps({"axes": {name: {"from": 0.1, "to": 1.0, "count": count} | more}})


def refused(text):
    """Message of the BadInput of a scene, which reading it must give without much memory."""
    tracemalloc.start()
    try:
        with pytest.raises(BadInput) as error:
            load_scene(text)
        assert tracemalloc.get_traced_memory()[1] < 2**26
    finally:
        tracemalloc.stop()
    message = str(error.value)
    assert message.isprintable()
    assert len(message) <= MAX_MESSAGE
    return message


# Names.


@pytest.mark.parametrize("name", sorted({*data_variables(SYSTEMS["satellite"])}))
@pytest.mark.parametrize("section", ["axes", "ties", "fixed", "points"])
def test_no_name_of_a_scene_can_be_that_of_a_variable(name, section):
    scene = {"schema": 1, "system": "satellite", "axes": {"theta0": {"values": [0.1]}}, "ties": {"m": name}}
    value = {"axes": {"values": [0.0, 1.0]}, "ties": "theta0", "fixed": 1.0}
    if section == "points":
        del scene["axes"]
        scene["points"] = {"values": {name: [0.0, 1.0]}}
    else:
        scene.setdefault(section, {})[name] = value[section]
    message = refused(tomli_w.dumps(scene))
    assert message == f"{section}.{name}: an atlas has a variable of this name; choose another name"


def test_the_reserved_names_are_all_that_a_dataset_holds_besides_parameters_and_axes():
    for system in ("satellite", "fixed_point"):
        everything = list(data_variables(SYSTEMS[system]))
        everything.remove(COMPUTED.name)
        text = {
            "schema": 1,
            "system": system,
            "axes": {"theta0": {"values": [0.1]}},
            "outputs": {"variables": everything},
        }
        scene = load_scene(tomli_w.dumps(text))
        ds = dataset.dataset(scene, {name: np.zeros(1) for name in everything})
        assert set(ds.data_vars) == set(everything)
        assert set(ds.coords) <= {*scene.system.parameters, *dataset.dims(scene)}


def test_each_of_two_axes_that_cannot_have_one_dimension_is_fine_alone(scene_text):
    offset = {"from": -0.1, "to": 0.1, "count": 3}
    grid.check(load_scene(scene_text({"axes.k3": offset | {"offset_from_family": True}})))
    grid.check(load_scene(scene_text({"axes.k3_offset": offset, "ties.mu3": "k3_offset"})))


# Limits.


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (HEAD + axis("theta0", 10**8), "axes.theta0.count = 100000000: must be a whole number from 1 to 10000000"),
        (HEAD + "".join(axis(n, 10**7) for n in ("theta0", "psi0", "phi0", "n", "m")), "axes: 1e+35 points in all"),
        (HEAD + axis("theta0", 10**6) + axis("psi0", 10**6), "axes: 1e+12 points in all; allowed: at most 1e+11"),
        (HEAD + "".join(axis(f"a{i}", 1) for i in range(33)), "axes: 33 of them; allowed: at most 32"),
        (HEAD + axis("theta0", 100_000) + "[refine]\nlevels = 8\n", "count = 100000: too many for 8 levels of [refine]"),
        (
            HEAD + axis("theta0", 10**4) + axis("psi0", 10**4) + "[refine]\nlevels = 2\n",
            "refine: 1.6e+09 points on the finest grid",
        ),
        (HEAD + axis("theta0", 3) + "[fixed]\n" + "".join(f"a{i} = 1\n" for i in range(200)), "201 names are given values"),
        (
            HEAD + "[points]\nsample = 'sobol'\ncount = 1\n" + "".join(f"ranges.a{i} = 1\n" for i in range(30_000)),
            "points: 30000 names; allowed: at most 100",
        ),
        (
            HEAD + "[points]\nsample = 'sobol'\ncount = 10_000_000\n[points.ranges]\n"
            "n = {from = 0, to = 1}\nm = {from = 0, to = 1}\n",
            "points: 10000000 points of 2 ranges; allowed: at most 10000000 numbers in all",
        ),
        (HEAD + "[axes.m]\nvalues = [" + "true," * 200_001 + "]\n", "axes.m.values: 200001 numbers; allowed: at most 200000"),
        (HEAD + axis("theta0", 3) + "[ties]\n" + "".join(f"a{i} = '{'(1+1+1+1)*' * 40}1'\n" for i in range(30)), "ties: 12030 characters"),
        (HEAD + axis("theta0", 3) + "[integration]\nmax_steps = 10_000_000_000_000\n", "must be a whole number from 1 to 10"),
        (HEAD + "title = " + "9" * 5000 + "\n", "a number has more digits than can be read"),
        (HEAD + "title = 0x" + "f" * 5000 + "\n[axes.m]\nvalues = [1]\n", "title = an integer of 6021 digits: must be a string"),
        (HEAD + "a = " + "[" * 100_000 + "\n", "nested too deeply"),
        (HEAD + ".".join("a" * 40_000) + " = 1\n", "more than 16 names joined by points"),
        (HEAD + ".".join(['"\\".\\""', "'a'"] * 4000) + " = 1\n", "more than 16 names joined by points"),
        (HEAD + "".join(f"[a{i}]\n" for i in range(2001)), "2001 tables; allowed: at most 2000"),
        (HEAD + "a = [" + "{}," * 2001 + "]\n", "2001 tables; allowed: at most 2000"),
        (HEAD + "#" * 6_000_000 + "\n", "characters; allowed: at most 6000000"),
    ],
    ids=lambda value: value[:30] if len(value) < 100 else "",
)  # fmt: skip
def test_limits_hold_before_anything_is_made(text, named):
    assert named in refused(text)


@pytest.mark.parametrize("piece", ["\0", "# a comment\n", "a = 1\n"])
def test_an_input_without_end_is_read_to_the_limit(tmp_path, piece):
    def write():
        with suppress(BrokenPipeError), (tmp_path / "pipe").open("w") as pipe:
            while True:
                pipe.write(piece * 10_000)

    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=write)
    writer.start()
    assert "pipe: too many characters; allowed: at most 6000000" in refused(tmp_path / "pipe")
    writer.join()


def test_a_table_without_end_is_read_to_the_limit(tmp_path, monkeypatch):
    """A line of it, which a file with a hole may be, and all lines, as from a pipe."""
    with (tmp_path / "hole.csv").open("wb") as file:
        file.truncate(2**33)
    (tmp_path / "device.csv").symlink_to("/dev/zero")
    monkeypatch.setattr(tables, "MAX_TABLE", 1000)
    (tmp_path / "long.csv").write_text("C\n" + "0.8\n" * 300)
    scene = HEAD + "[points]\nfile = '{}'\n"
    for name, problem in (
        ("hole.csv", ", line 1: more than 1000000 characters"),
        ("device.csv", ": this is no regular file"),
        ("long.csv", ": more than 1000 characters; give larger tables as .nc"),
    ):
        tracemalloc.start()
        with pytest.raises(BadInput, match=f"{name}{problem}"):
            tables.read(tmp_path / name, ["C"])
        assert tracemalloc.get_traced_memory()[1] < 2**24
        tracemalloc.stop()
        assert name in refused(
            (tmp_path / "scene.toml").write_text(scene.format(name)) and tmp_path / "scene.toml"
        )


def test_large_grids_are_valid_and_their_axes_are_arrays():
    scene = load_scene(HEAD + axis("theta0", 10**5) + axis("psi0", 10**4))
    assert scene.size == 10**9
    assert isinstance(scene.axes["theta0"].values, np.ndarray)
    np.testing.assert_array_equal(scene.axes["theta0"].values, np.linspace(0.1, 1.0, 10**5))
    assert grid.check(scene).exists.all()


def test_ties_of_both_their_predecessors_cost_no_more_than_their_number():
    ties = {"t0": "theta0", "u0": "theta0"}
    for i in range(60):
        ties |= {f"t{i + 1}": f"(t{i} + u{i}) / 2", f"u{i + 1}": f"t{i} - u{i} + theta0"}
    scene = load_scene(HEAD + axis("theta0", 3) + tomli_w.dumps({"ties": ties | {"psi0": "t60 + u60"}}))
    visits = 0

    class Counted(dict):
        def __getitem__(self, key):
            nonlocal visits
            visits += 1
            assert visits < 10_000
            return super().__getitem__(key)

    object.__setattr__(scene, "ties", Counted(scene.ties))
    ds = dataset.dataset(scene, {name: np.zeros(3) for name in scene.outputs})
    assert ds.psi0.dims == ("theta0",)


@pytest.mark.parametrize("text", ["-" * 400 + "A", "A" + "**-1" * 120, "A" + "-+" * 210 + "A"])
def test_expressions_are_nested_only_so_deep(text):
    with pytest.raises(BadInput, match="nested more than 200 deep"):
        Expression("ties.C", text)


def test_long_sums_are_allowed():
    text = " + ".join(["A"] * 120)
    assert Expression("ties.C", text).value({"A": np.ones(1)})[0] == 120


def test_expressions_that_are_hardly_python_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for text in ("1if", "0x1for", "'\\d'", "1 is 1", "1(2)"):
            with pytest.raises(BadInput, match=r"ties\.C"):
                Expression("ties.C", text)


def test_ends_of_an_axis_that_are_too_far_apart_are_refused():
    far = {"from": -1.7e308, "to": 1.7e308}
    assert "too far apart" in refused(HEAD + axis("m", 3, **far))
    assert "too far apart" in refused(HEAD + axis("m", 3, spacing="log", **{"from": 1e-300, "to": 1e300}))


def test_a_duration_that_overflows_is_refused():
    scene = load_scene(
        HEAD + "[fixed]\nOmega = 1e-10\n" + axis("m", 3) + '[integration]\nduration = "1e305 orbits"\n'
    )
    with pytest.raises(BadInput, match="too long at some points"):
        grid.check(scene)
    ends = "[integration]\nduration = 1e300\nstep = 1e-300\n"
    assert grid.check(load_scene(HEAD + axis("m", 3) + ends)).duration[0] == 1e300


# Atlases and files of strangers.


def stranger(text):
    return xr.Dataset(attrs={"atlas_system": "satellite", "atlas_scene": text})


def test_the_scene_of_an_atlas_is_never_a_path(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(HEAD + axis("m", 3))
    monkeypatch.chdir(tmp_path)
    for text in ("scene.toml", str(tmp_path / "scene.toml"), "/dev/zero"):
        with pytest.raises(BadInput, match="not valid TOML"):
            metadata.scene_of(stranger(text))
    with pytest.raises(BadInput, match="atlas_scene is no text"):
        metadata.scene_of(stranger(np.array([1, 2])))
    assert metadata.scene_of(stranger("")) is None


def test_the_scene_of_an_atlas_reads_no_points_file(tmp_path, monkeypatch):
    (tmp_path / "points.csv").write_text("m\n0.5\n")
    (tmp_path / "scene.toml").write_text(HEAD + '[points]\nfile = "points.csv"\n')
    monkeypatch.chdir(tmp_path)
    scene = load_scene(tmp_path / "scene.toml")
    for file in ("points.csv", str(tmp_path / "points.csv")):
        with pytest.raises(BadInput, match=r"points.file: only a scene file may name one"):
            metadata.scene_of(stranger(HEAD + f'[points]\nfile = "{file}"\n'))
    assert metadata.scene_of(stranger(scene.toml())).toml() == scene.toml()


@pytest.mark.parametrize(
    "file", ["x" * 5000 + ".csv", "/dev/null.csv", "a\0b.csv", "a\x1bb.csv", "folder.nc"]
)
def test_names_of_points_files_that_cannot_be_opened(tmp_path, file):
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "scene.toml").write_text(HEAD + tomli_w.dumps({"points": {"file": file}}))
    refused(tmp_path / "scene.toml")


def test_large_points_files_are_refused_before_they_are_read(tmp_path, monkeypatch):
    (tmp_path / "points.csv").write_text("m\n" + "0.5\n" * 1000)
    xr.Dataset({"m": ("i", np.zeros(10**5))}).to_netcdf(
        tmp_path / "points.nc", encoding={"m": {"zlib": True}}
    )
    monkeypatch.setattr(points, "MAX_FILE_BYTES", 3000)
    for name in ("points.csv", "points.nc"):
        (tmp_path / "scene.toml").write_text(HEAD + f'[points]\nfile = "{name}"\n')
        assert "bytes; a scene reads at most 3e+03" in refused(tmp_path / "scene.toml")
    assert len(tables.read(tmp_path / "points.nc", [])["m"]) == 10**5


def test_a_netcdf_file_of_points_with_a_text_where_a_number_belongs(tmp_path):
    ds = xr.Dataset({"m": ("i", np.zeros(2), {"scale_factor": "much"})})
    ds.to_netcdf(tmp_path / "points.nc")
    with pytest.raises(BadInput, match="not a NetCDF file that can be read"):
        tables.read(tmp_path / "points.nc", [])


def test_damaged_attributes_are_bad_input():
    with pytest.raises(BadInput, match="attribute atlas_step is no number"):
        metadata.number_attribute(xr.Dataset(attrs={"atlas_step": "short"}), "atlas_step")
    ds = atlas.label_points("satellite", {"m": [0.5]}, max_steps=20).assign_attrs(
        title="\x1b[2J", history="\n\u202e"
    )
    assert ds.atlas.cite().replace("\n", "").isprintable()
    del ds.attrs["atlas_tolerance"]
    with pytest.raises(BadInput, match="attribute atlas_tolerance is no number"):
        ds.atlas.trajectory(m=0.5)


@pytest.mark.parametrize("label", [np.full(3, 100), np.full(3, -1), np.array(["a", "b", "c"]), np.zeros(3)])
def test_compare_refuses_what_are_no_labels(label):
    ds = xr.Dataset({"label": ("m", label), "predicted": ("m", np.ones(3, np.int8))})
    with pytest.raises(BadInput, match="label: damaged"):
        compare.report(ds)


# Text.


def test_messages_are_printable_and_short():
    hostile = "\x1b[2J\n\x7f\x9b31m\u202e\u2028\ud800"
    assert str(BadInput(hostile)) == "\\x1b[2J\\n\\x7f\\x9b31m\\u202e\\u2028\\ud800"
    long = str(BadInput("key = " + "x" * 10**6 + ": allowed: y"))
    assert len(long) <= MAX_MESSAGE
    assert long.startswith("key = x")
    assert long.endswith(": allowed: y")
    assert printable("Größe, ψ'") == "Größe, ψ'"
    assert len(printable("\n" * 5000, MAX_TEXT)) <= MAX_TEXT


def test_values_are_shown_in_little_time_and_space():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    for value in (
        nested,
        {"a": nested},
        16**6000,
        "x" * 10**7,
        list(range(10**6)),
        np.zeros((300, 3)),
        {"\x1b": "\x1b"},
    ):
        assert len(shown(value)) <= MAX_TEXT
        assert shown(value).isprintable()
    assert [shown(value) for value in (1.5, "a", [1, 2], True)] == ["1.5", "'a'", "[1, 2]", "True"]
    while nested:  # freed step by step: the interpreter's own recursion would be deep
        nested = nested.pop()


@pytest.mark.parametrize("key", ["title", "system", "colour\x1b[2J"])
def test_control_characters_of_a_scene_are_not_printed(key):
    table = {"schema": 1, "system": "satellite", "axes": {"m": {"values": [0.5]}}} | {
        key: "\x1b]0;\x07\n\u202e"
    }
    try:
        text = repr(load_scene(tomli_w.dumps(table)))
    except BadInput as error:
        text = str(error)
    assert text.replace("\n  ", "").isprintable()


def test_label_points_shows_a_large_value_in_one_short_line():
    with pytest.raises(BadInput) as error:
        atlas.label_points("satellite", {"m": [[1.0, 2.0], ["x" * 3000]]})
    assert len(str(error.value)) < 300
