"""The extensions in docs/examples: one variable, one question, one line on a map; one format of atlases."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import atlas
from atlas import BadInput
from atlas.cli import main
from atlas.extension import Extension
from atlas.systems import SYSTEMS
from atlas.systems.base import derived_variables

pytestmark = pytest.mark.usefixtures("whole_kernels")
SCENE = """
schema = 1
system = "fixed_point"
fixed = { A = 1.0, B = 1.0, C = 0.5, theta0 = 0.7 }
axes.n = { from = 0.1, to = 2.0, count = 7 }
axes.m = { from = 0.1, to = 3.0, count = 9 }
integration = { duration = 1.0, tolerance = 1e-4 }
outputs = { variables = ["label", "start_energy"] }
"""


@pytest.fixture
def installed(install_example):
    """The extensions are installed as far as Python can tell."""
    install_example("start_energy")
    install_example("parquet_table")


@pytest.mark.usefixtures("installed")
def test_variable_question_and_line():
    ds = atlas.run(atlas.load_scene(SCENE), progress=False)
    theta, n, m = 0.7, ds.n, ds.m
    energy = 0.5 * ((n * np.sin(theta)) ** 2 + 0.5 * (m + n * np.cos(theta)) ** 2)
    np.testing.assert_allclose(ds.start_energy, energy.transpose(*ds.start_energy.dims), rtol=1e-14)
    assert ds.start_energy.attrs["units"] == "J"
    assert ds.atlas.energy_range() == (float(energy.min()), float(energy.max()))
    line = ds.atlas.boundary(variable="start_energy").sel(vertex=slice(None))
    line = line.where(line.kind == "energy = 1", drop=True)
    on_line = 0.5 * ((line.n * np.sin(theta)) ** 2 + 0.5 * (line.m + line.n * np.cos(theta)) ** 2)
    assert line.sizes["vertex"] > 50
    np.testing.assert_allclose(on_line, 1.0, atol=2e-4)
    assert "energy_range" in dir(ds.atlas)
    assert "ds.atlas.energy_range()" in repr(ds.atlas)
    with pytest.raises(BadInput, match="start_energy: not in this dataset"):
        ds.drop_vars("start_energy").atlas.energy_range()
    assert all("start_energy" in derived_variables(system) for system in SYSTEMS.values())


def test_without_the_extension_its_names_are_refused():
    with pytest.raises(BadInput, match="start_energy"):
        atlas.load_scene(SCENE)
    with pytest.raises(AttributeError, match="energy_range"):
        atlas.label_points("satellite", {"m": [0.5]}, duration=1.0, progress=False).atlas.energy_range()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, with the scene."""
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "top.toml").write_text(SCENE.replace(', "start_energy"', ', "predicted", "theta_max"'))
    monkeypatch.chdir(folder)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "20")
    return folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.long
@pytest.mark.usefixtures("installed")
def test_a_run_in_a_format_is_one_file_with_all_of_the_atlas(folder, capsys):
    pq = pytest.importorskip("pyarrow.parquet")
    assert main(["run", "top.toml", "-o", "top.parquet", "--quiet"]) == 0
    assert names(folder) == ["top.parquet", "top.toml"]
    whole, ds = atlas.run("top.toml", progress=False), atlas.open_atlas("top.parquet")
    xr.testing.assert_identical(ds.drop_attrs(deep=False), whole.drop_attrs(deep=False))
    assert [variable.dtype for variable in ds.variables.values()] == [
        variable.dtype for variable in whole.variables.values()
    ]
    assert ds.attrs["atlas_scene"] == whole.attrs["atlas_scene"]
    table = pd.read_parquet("top.parquet").set_index(["n", "m"])
    flags = whole.label.flag_meanings.split()
    for n, m in ((0, 0), (3, 5), (6, 8)):
        row = table.loc[float(whole.n[n]), float(whole.m[m])]
        assert row.label == flags[int(whole.label[n, m])]
        assert row.theta_max == whole.theta_max[n, m]
    assert pq.read_metadata("top.parquet").num_row_groups > 1
    capsys.readouterr()
    assert main(["status", "top.parquet", "--verify"]) == 0
    assert capsys.readouterr().out == "top: finished atlas, n 7 x m 9\nall of it is as it was written\n"
    assert main(["extend", "top.parquet", "top.toml", "-o", "again.nc", "--quiet"]) == 0
    with atlas.open_atlas("again.nc") as again:
        np.testing.assert_array_equal(again.theta_max, ds.theta_max)
    assert main(["map", "top.parquet"]) == 0
    assert {"top.png", "top.pdf"} <= {*names(folder)}


@pytest.mark.usefixtures("installed")
def test_the_help_lists_a_format(capsys):
    for command, words in (
        ("run", "which the same command continues; or NAME.parquet of the extension parquet_table (default"),
        ("join", "atlas to write (.nc, .zarr or .parquet)"),
        ("status", "also of a finished atlas (.nc, .zarr, .parquet)"),
    ):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert words in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("installed")
def test_a_file_in_a_format_that_is_damaged_or_of_another_program_is_refused(folder):
    pytest.importorskip("pyarrow")
    atlas.run("top.toml", "top.parquet", progress=False)
    content = Path("top.parquet").read_bytes()
    changed = Path("top.parquet").read_bytes().replace(b"drifting", b"driftind")
    for damaged in (changed, content[: len(content) // 2], b""):
        assert damaged != content
        Path("top.parquet").write_bytes(damaged)
        assert main(["status", "top.parquet", "--verify"]) == 2
        with pytest.raises(BadInput, match=r"^top\.parquet: damaged, or not a Parquet file of an atlas \("):
            atlas.open_atlas("top.parquet")
    Path("top.parquet").write_bytes(content)
    with pytest.raises(BadInput, match=r"^top\.parquet: this file exists; "):
        atlas.run(SCENE, "top.parquet", progress=False)
    pd.DataFrame({"label": ["mine"]}).to_parquet("mine.parquet")
    with pytest.raises(BadInput, match=r"^mine\.parquet: holds something else than an atlas"):
        atlas.run("top.toml", "mine.parquet", force=True, progress=False)


def test_without_the_extension_its_suffix_is_refused(folder, installed_extensions, capsys):
    assert main(["run", "top.toml", "-o", "top.parquet"]) == 2
    formats = "the name must end in .nc, for one file, in /, for a run folder, or in .zarr, for a Zarr store"
    assert capsys.readouterr().err == f"atlas: top.parquet: {formats}\n"
    installed_extensions({}, {"parquet_table": "no such library"})
    assert main(["run", "top.toml", "-o", "top.parquet"]) == 2
    why = "; the extension parquet_table cannot be loaded (no such library)"
    assert capsys.readouterr().err == f"atlas: top.parquet: {formats}{why}\n"
    assert names(folder) == ["top.toml"]


@pytest.mark.usefixtures("installed")
def test_a_format_whose_library_is_not_installed_is_refused(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "parquet_table.format", raising=False)
    assert main(["run", "top.toml", "-o", "top.parquet"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("atlas: the extension parquet_table cannot be loaded (ModuleNotFoundError: ")
    assert message.count("\n") == 1
    assert main(["run", "top.toml", "-o", "top.txt"]) == 2
    assert (
        "in .zarr, for a Zarr store, or in .parquet, of the extension parquet_table"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("suffix", [".nc", ".Parquet", "parquet"])
def test_a_format_needs_a_new_suffix(suffix, folder, installed_extensions, capsys):
    installed_extensions({"mine": Extension("mine", "mine", "a format", formats={suffix: "format:FORMAT"})})
    assert main(["run", "top.toml"]) == 2
    message = f"the extension mine: {suffix} must be a new suffix in lower case"
    assert capsys.readouterr().err == f"atlas: {message}\n"
