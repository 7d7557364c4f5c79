"""Without the extension: what it gives is refused by name, and its atlases can still be drawn."""

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput
from atlas.analysis.boundary import KINDS
from atlas.cli import BAD_INPUT, main
from atlas.extensions.branches import COUNTS
from atlas.extensions.branches.lines import CHANGE

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")

SCENE = """
schema = 1
title = "counts"
system = "satellite"
[fixed]
A = 1.0
B = 1.3
C = 1.7
k1 = 0.02
[axes.k3]
from = 0.05
to = 4.0
count = 9
[axes.Omega]
from = 0.5
to = 1.5
count = 5
[integration]
duration = 0.1
[outputs]
variables = ["equilibrium_count", "equilibrium_stable_count", "equilibrium_energy_stable_count", "label", "predicted"]
map = "equilibrium_stable_count"
"""


@pytest.fixture
def counts(tmp_path):
    """File of an atlas with numbers of equilibria."""
    atlas.run(atlas.load_scene(SCENE), tmp_path / "counts.nc", progress=False)
    return tmp_path / "counts.nc"


def legend(figure):
    return [text.get_text() for box in figure.legends for text in box.get_texts()]


def test_what_it_gives_is_refused_by_name(without_extension, tmp_path, monkeypatch, capsys):
    ds = atlas.run(atlas.load_scene(SCENE), progress=False)
    assert "branches" in dir(atlas)
    assert "branches" in atlas.__all__
    assert "diagram" in dir(ds.atlas)
    without_extension("branches")
    assert "branches" not in dir(atlas)
    assert "branches" not in atlas.__all__
    assert "diagram" not in dir(ds.atlas)
    with pytest.raises(AttributeError, match=r"^module 'atlas' has no attribute 'branches'$"):
        atlas.branches  # noqa: B018
    with pytest.raises(AttributeError, match=r"^'Atlas' object has no attribute 'diagram'$"):
        ds.atlas.diagram()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "counts.toml").write_text(SCENE)
    for name in COUNTS:
        with pytest.raises(BadInput, match=f"^outputs.variables: '{name}' is unknown; [^\n]*$"):
            atlas.load_scene(SCENE.replace(COUNTS[0], name))
    assert main(["check", "counts.toml"]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("atlas: counts.toml, line 21: ")
    assert COUNTS[0] in line
    with pytest.raises(SystemExit) as stop:
        main(["branches", "counts.toml"])
    assert stop.value.code == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "'branches'" in line


@pytest.mark.long
def test_its_atlases_are_drawn_without_its_lines(without_extension, counts, tmp_path):
    with atlas.open_atlas(counts) as ds:
        ds = ds.load()
    figure = ds.atlas.map()
    assert legend(figure) == [CHANGE]
    assert figure.axes[-1].get_ylabel() == "equilibrium stable count (theory)"
    here = {name: ds.atlas.map(name) for name in ("label",)}
    motion = ds.atlas.trajectory(k3=1.0, Omega=1.0, samples=5)
    without_extension("branches")
    for name in (None, COUNTS[0]):
        alone = ds.atlas.map(name)
        assert not any(CHANGE in text for text in legend(alone))
        assert alone.axes[-1].get_ylabel() == (name or COUNTS[1]).replace("_", " ")
    for name, figure in here.items():
        assert legend(ds.atlas.map(name)) == legend(figure)
    assert set(ds.atlas.boundary(variable=COUNTS[1]).kind.values) <= set(KINDS)
    xr.testing.assert_equal(ds.atlas.trajectory(k3=1.0, Omega=1.0, samples=5), motion)
    assert main(["map", str(counts), "-o", str(tmp_path / "counts.png")]) == 0
    assert main(["compare", str(counts)]) == 0


def test_other_variables_do_not_depend_on_it(without_extension):
    text = SCENE.replace(', "label"', ', "label", "stable", "frequency_1"').replace("map = ", "# ")
    ds = atlas.run(atlas.load_scene(text), progress=False)
    without_extension("branches")
    for name in COUNTS:
        text = text.replace(f'"{name}", ', "")
    alone = atlas.run(atlas.load_scene(text), progress=False)
    for name in alone:
        np.testing.assert_array_equal(alone[name], ds[name])


def test_its_run_folders_are_refused_by_name(without_extension, tmp_path, capsys):
    atlas.run(atlas.load_scene(SCENE), tmp_path / "run", progress=False)
    with atlas.open_atlas(tmp_path / "run") as ds:
        assert set(COUNTS) <= set(ds)
    without_extension("branches")
    with pytest.raises(BadInput, match=r"extensions: 'branches' is not installed; installed: [a-z0-9_, ]+$"):
        atlas.open_atlas(tmp_path / "run")
    out = str(tmp_path / "out")
    for command in (
        ["status", str(tmp_path / "run")],
        ["join", str(tmp_path / "run"), "-o", f"{out}.nc"],
        ["map", str(tmp_path / "run"), "-o", f"{out}.png"],
        ["compare", str(tmp_path / "run")],
    ):
        assert main(command) == BAD_INPUT
        (line,) = capsys.readouterr().err.splitlines()
        assert "extensions: 'branches' is not installed" in line
    assert not list(tmp_path.glob("out*"))
