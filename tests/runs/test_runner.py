"""Runs and atlas files: their content, that they are written whole or not at all, and that runs are repeatable."""

import json
import os
import shutil
import subprocess
import sys

import cf_xarray  # noqa: F401
import netCDF4
import numpy as np
import pytest
import xarray as xr
from truth import assert_same_bytes

import atlas
from atlas import BadInput, cli, load_scene
from atlas.flags import Label, Stability, Status
from atlas.runs import folder as folders
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.variables import variables


@pytest.fixture(scope="module")
def small_atlas(tmp_path_factory, small_scene):
    path = tmp_path_factory.mktemp("atlas") / "small.nc"
    ds = atlas.run(load_scene(small_scene), path, progress=False)
    return path, ds


@pytest.mark.long
def test_an_atlas_has_the_variables_and_parameters_of_the_registry(small_atlas):
    path, ds = small_atlas
    scene = load_scene(ds.attrs["atlas_scene"])
    with xr.open_dataset(path) as read:
        for name, variable in variables(scene.system).items():
            if variable.optional:  # only where a scene asks for them
                assert name not in read
                continue
            for dataset in (ds, read):
                assert dataset[name].dtype == variable.dtype
                assert dataset[name].dims == ("sigma", "theta0")
                assert dataset[name].attrs["long_name"] == variable.long_name
            np.testing.assert_array_equal(read[name].values, ds[name].values)
        assert read["sigma"].attrs["long_name"] == "C/A"
        assert read["theta0"].attrs["units"] == "rad"
        assert read["k3"].dims == ("sigma", "theta0")
        assert read["C"].dims == ("sigma",)
        assert read["Omega"].dims == ()
        assert set(scene.system.parameters) <= set(read.coords)
        attributes = [
            "Conventions",
            "title",
            "source",
            "references",
            "history",
            "atlas_kernel_hash",
            "atlas_cpu",
        ]
        assert all(read.attrs[name] for name in attributes)
        assert "10.22055/JACM.2021.37913.3113" in read.attrs["references"]


def test_flags_can_be_read_by_cf_xarray_and_by_plain_netcdf(small_atlas):
    path, ds = small_atlas
    with xr.open_dataset(path) as read:
        drifting = read.label.cf == "drifting"
        np.testing.assert_array_equal(drifting.values, ds.label.values == Label.DRIFTING)
        assert 0 < drifting.sum() < drifting.size
        assert read.label.cf.isin(["drifting", "unresolved"]).any()
    with netCDF4.Dataset(path) as raw:
        label = raw["label"]
        assert label.dtype == np.int8
        assert "_FillValue" not in label.ncattrs()
        assert label.getncattr("flag_meanings").split()[Label.DRIFTING] == "drifting"
        assert label.getncattr("flag_values").dtype == np.int8


@pytest.mark.long
def test_theory_and_measurement_agree_away_from_the_boundary(small_atlas):
    from atlas.analysis.compare import near_boundary

    _, ds = small_atlas
    away = ~near_boundary(ds.stable.values, range(ds.stable.ndim))
    drifting = ds.label == Label.DRIFTING
    assert ((ds.stable == Stability.STABLE) & drifting).values[away].sum() == 0
    survivors = ((ds.stable == Stability.UNSTABLE) & ~drifting).values & away
    assert (ds.growth_rate * ds.end_time).values[survivors].max(initial=0) < 12


def test_the_same_scene_gives_the_same_values_for_other_tiles_and_threads(small_atlas, tmp_path, monkeypatch):
    path, ds = small_atlas
    monkeypatch.setenv("ATLAS_TILE_POINTS", "10")
    rerun = atlas.run(load_scene(ds.attrs["atlas_scene"]), tmp_path / "again.nc", threads=2, progress=False)
    for name in ds.data_vars:
        np.testing.assert_array_equal(ds[name].values, rerun[name].values, err_msg=name)
    assert rerun.attrs["atlas_kernel_hash"] == ds.attrs["atlas_kernel_hash"]


@pytest.mark.parametrize("value", ["0", "-1", "seven", "65537", "1e3", " 7", "\u0667", "9" * 5000])
def test_a_wrong_number_of_points_per_tile_is_refused_before_anything_is_written(
    value, tmp_path, small_scene, monkeypatch, capsys
):
    monkeypatch.setenv("ATLAS_TILE_POINTS", value)
    (tmp_path / "small.toml").write_text(small_scene)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "small.toml", "-o", "again.nc"]) == cli.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "ATLAS_TILE_POINTS = " in line
    assert "a whole number from 1 to 65536" in line
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


@pytest.mark.long
def test_a_run_is_continued_in_the_tiles_that_it_began_with(small_atlas, tmp_path, monkeypatch):
    scene = load_scene(small_atlas[1].attrs["atlas_scene"])
    monkeypatch.setenv("ATLAS_TILE_POINTS", "10")
    begun = RunFolder.prepare(ScenePlan.of(scene), tmp_path / "run").tiling
    monkeypatch.setenv("ATLAS_TILE_POINTS", "3")
    atlas.run(scene, f"{tmp_path}/run/", progress=False)
    continued = RunFolder.open(tmp_path / "run")
    assert continued.is_complete
    assert continued.tiling == begun


def test_a_tile_may_be_without_possible_bodies(scene_text, monkeypatch):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "4")
    ds = atlas.run(load_scene(scene_text({"axes.sigma.to": 4.7})), progress=False)
    possible = (ds.C <= 2).broadcast_like(ds.status)
    np.testing.assert_array_equal(ds.status == Status.IMPOSSIBLE_BODY, ~possible)
    np.testing.assert_array_equal(ds.theta_max.isnull(), ~possible)


def test_a_point_of_the_atlas_equals_the_same_point_labelled_alone(small_atlas):
    _, ds = small_atlas
    at = ds.isel(sigma=3, theta0=2)
    # The other parameters have their defaults, so that both kernels leave the same terms out.
    start = {name: float(at[name]) for name in ("C", "k3", "m", "theta0", "psi0")}
    start["theta0"] += 1e-4
    start["psi0"] += 1e-4
    alone = atlas.label_points("satellite", start, duration=30.0, tolerance=1e-5, rate_tolerance=1e-3)
    assert float(alone.theta_dot_rms[0]) == float(at.theta_dot_rms)
    assert int(alone.label[0]) == int(at.label)


def test_a_scene_may_leave_variables_out(small_scene, tmp_path):
    text = small_scene + '[outputs]\nvariables = ["theta_max", "label"]\n'
    ds = atlas.run(load_scene(text), tmp_path / "few.nc", progress=False)
    assert list(ds.data_vars) == ["label", "theta_max"]


def test_run_takes_the_path_of_a_scene(small_atlas, small_scene, tmp_path):
    _, ds = small_atlas
    (tmp_path / "small.toml").write_text(small_scene)
    for path in (tmp_path / "small.toml", str(tmp_path / "small.toml")):
        xr.testing.assert_equal(atlas.run(path, progress=False), ds)


def test_an_existing_file_is_kept_without_force(small_scene, tmp_path):
    scene, path = load_scene(small_scene), tmp_path / "kept.nc"
    for content, force, message in (
        ("mine", False, "holds something else"),
        ("mine", True, "holds something else"),
        ("a damaged atlas, by its atlas_version", False, "force"),
    ):
        path.write_text(content)
        with pytest.raises(BadInput, match=message):
            atlas.run(scene, path, progress=False, force=force)
        assert path.read_text() == content
    atlas.run(scene, path, progress=False, force=True)
    assert atlas.open_atlas(path).sizes == {"sigma": 9, "theta0": 7}
    xr.Dataset({"temperature": 290.0}).to_netcdf(tmp_path / "air.nc")
    before = (tmp_path / "air.nc").read_bytes()
    for force in (False, True):
        with pytest.raises(BadInput, match="holds something else than an atlas"):
            atlas.run(scene, tmp_path / "air.nc", progress=False, force=force)
    assert (tmp_path / "air.nc").read_bytes() == before


@pytest.mark.parametrize("name", ["no/such/folder/a.nc", "a.txt", "folder.nc"])
def test_an_output_that_cannot_be_written_is_refused_before_the_run(small_scene, tmp_path, name, evaluated):
    (tmp_path / "folder.nc").mkdir()
    with pytest.raises(BadInput):
        atlas.run(load_scene(small_scene), tmp_path / name, progress=False)
    assert evaluated == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder.nc"]


def test_the_same_command_ends_well_wherever_a_run_was_killed_after_its_join(small_scene, tmp_path):
    scene, path, folder = load_scene(small_scene), tmp_path / "a.nc", tmp_path / "a.nc.run"
    whole = atlas.run(scene, f"{tmp_path}/whole/", progress=False)
    RunFolder.open(tmp_path / "whole").join(path)
    joined = path.read_bytes()

    def finish(left):
        """Run again beside what is left of the run folder."""
        with atlas.run(scene, path, progress=False) as ds:
            assert_same_bytes(whole, ds)
        assert path.read_bytes() == joined
        assert not folder.exists(), left

    with pytest.raises(BadInput, match="force"):
        atlas.run(scene, path, progress=False)
    for removed in ((), ("tiles",), ("tiles", "notes.json"), ("tiles", "notes.json", "manifest.json")):
        shutil.copytree(tmp_path / "whole", folder)
        for name in removed:
            (shutil.rmtree if name == "tiles" else os.unlink)(folder / name)
        for file in folder.glob("progress-*.json"):
            file.unlink()
        finish(removed)
    shutil.copytree(tmp_path / "whole", folder)
    with netCDF4.Dataset(path, "r+") as file:
        file["theta_max"][0, 0] += 1e-9
    with pytest.raises(BadInput, match="damaged"):
        atlas.run(scene, path, progress=False)
    assert (folder / "manifest.json").exists()


@pytest.mark.long
def test_another_file_or_folder_in_the_way_is_kept(small_scene, scene_text, tmp_path):
    scene, path = load_scene(small_scene), tmp_path / "a.nc"
    other = load_scene(scene_text({"fixed.m": 0.6}))
    atlas.run(other, path, progress=False).close()
    with atlas.open_atlas(path) as ds:
        ds.to_netcdf(tmp_path / "derived.nc")
    for existing, its_scene in ((path, scene), (tmp_path / "derived.nc", other)):
        before = existing.read_bytes()
        with pytest.raises(BadInput, match="force"):
            atlas.run(its_scene, existing, progress=False)
        assert existing.read_bytes() == before
    atlas.run(scene, f"{tmp_path}/a.nc.run/", progress=False)
    (tmp_path / "a.nc.run" / "thesis.tex").write_text("mine")
    with pytest.raises(BadInput, match="force"):
        atlas.run(scene, path, progress=False)
    atlas.run(other, path, progress=False).close()
    assert len(list((tmp_path / "a.nc.run" / "tiles").iterdir())) == 1


@pytest.mark.long
def test_a_run_whose_file_another_process_finishes_ends_well(small_scene, tmp_path, monkeypatch):
    scene, path = load_scene(small_scene), tmp_path / "a.nc"
    whole = atlas.run(scene, progress=False)
    real_join, real_prepare, real_complete = RunFolder.join, RunFolder.prepare, folders.complete

    def finish_first(*arguments):
        """The other process."""
        with monkeypatch.context() as patched:
            patched.setattr(RunFolder, "join", real_join)
            patched.setattr(RunFolder, "prepare", real_prepare)
            patched.setattr(folders, "complete", real_complete)
            atlas.run(scene, path, progress=False, force=True).close()

    def late_join(self, out):
        finish_first()
        real_join(self, out)

    def late_prepare(*arguments):
        finish_first()
        monkeypatch.setattr(folders, "complete", None)  # nothing is computed again
        return real_prepare(*arguments)

    for force in (False, True):
        for name, late in (("join", late_join), ("prepare", late_prepare)):
            path.unlink(missing_ok=True)
            with monkeypatch.context() as patched:
                patched.setattr(RunFolder, name, late)
                with atlas.run(scene, path, progress=False, force=force) as ds:
                    assert_same_bytes(whole, ds)
            monkeypatch.setattr(folders, "complete", real_complete)
            assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]


@pytest.mark.long
def test_names_of_any_length_work_or_are_refused_before_the_run(small_scene, tmp_path, evaluated):
    scene = load_scene(small_scene)
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    for name in ("a" * 215 + ".nc", "b" * (longest - 7) + ".nc", "c" * longest + "/"):
        atlas.run(scene, f"{tmp_path}/{name}", progress=False).close()
    deep = tmp_path
    while len(str(deep)) + 240 < os.pathconf(tmp_path, "PC_PATH_MAX"):
        deep = deep / ("d" * 200)
    os.makedirs(deep)
    evaluated.clear()
    before = sorted(tmp_path.rglob("*"))
    for out in (
        f"{tmp_path}/{'a' * (longest - 6)}.nc",
        f"{tmp_path}/{'c' * (longest + 1)}/",
        f"{deep}/{'e' * 170}/",
        f"{deep}/{'e' * 170}.nc",
    ):
        with pytest.raises(BadInput, match="too long") as error:
            atlas.run(scene, out, progress=False)
        assert len(str(error.value)) < 400
    assert evaluated == []
    assert sorted(tmp_path.rglob("*")) == before


# Runs `atlas run` in a fork, ended by SIGKILL just before its n-th change of a file or
# folder, and again to its end.
KILLED_AT_STEPS = """
import os, signal, sys
import atlas

STRIDE, NO_LINKS = int(sys.argv[1]), sys.argv[2] == "no links"
scene = atlas.load_scene("small.toml")
atlas.run(scene, "a.nc", threads=1, progress=False)  # so that every fork has the kernel and all modules
os.unlink("a.nc")
OUT = os.open("steps.txt", os.O_RDWR | os.O_CREAT)

def refuse(*arguments, **options):
    raise OSError(95, "Operation not supported")

def run(step):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    steps = 0

    def counted(change):
        def change_or_die(*arguments, **options):
            nonlocal steps
            steps += 1
            if steps == step:
                os.kill(os.getpid(), signal.SIGKILL)
            return change(*arguments, **options)
        return change_or_die

    if NO_LINKS:
        os.link = refuse
    for name in ("replace", "link", "rename", "unlink", "rmdir", "mkdir", "fsync"):
        setattr(os, name, counted(getattr(os, name)))
    try:
        atlas.run(scene, "a.nc", threads=1, progress=False)
        os.pwrite(OUT, b"%8d" % steps, 0)
        os._exit(0)
    finally:
        os._exit(1)

assert run(None) == 0
steps = int(os.pread(OUT, 8, 0))
os.unlink("steps.txt")
for step in (*range(1, steps - 14, STRIDE), *range(steps - 14, steps + 1)):
    os.unlink("a.nc")
    assert run(step) == -signal.SIGKILL, step
    assert run(None) == 0, step
    assert sorted(os.listdir()) == ["a.nc", "small.toml"], step
    os.link("a.nc", f"../{step}.nc")
"""


@pytest.mark.long
@pytest.mark.parametrize("links", ["links", pytest.param("no links", marks=pytest.mark.faults)])
def test_after_a_kill_at_any_step_the_same_command_finishes(scene_text, tmp_path, fault_rounds, links):
    """On disks with and without hard links; at every step from 15 fault rounds on; few variables, for the steps are of files."""
    text = scene_text({"outputs.variables": ["label", "predicted", "psi_dot_std"]})
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "small.toml").write_text(text)
    whole = atlas.run(load_scene(text), progress=False)
    done = subprocess.run(
        [sys.executable, "-c", KILLED_AT_STEPS, str(max(15 // fault_rounds, 1)), links], cwd=folder,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    files_written = list(tmp_path.glob("*.nc"))
    assert len(files_written) > 18
    for path in files_written:
        with atlas.open_atlas(path) as ds:
            assert_same_bytes(whole, ds)


def test_label_points_takes_scalars_arrays_and_datasets():
    # The same terms vanish as in the small scene, so that these points share its kernel.
    table = xr.Dataset({"theta0": ("point", [0.3, 0.6]), "m": 0.2, "k3": 0.1})
    mapping = {"theta0": [0.3, 0.6], "m": 0.2, "k3": 0.1}
    from_table, from_mapping = (
        atlas.label_points("satellite", points, duration=[3.0, 4.0], tolerance=1e-6)
        for points in (table, mapping)
    )
    xr.testing.assert_identical(from_table.drop_attrs(), from_mapping.drop_attrs())
    assert from_table.sizes == {"point": 2}
    np.testing.assert_array_equal(from_table.end_time, [3.0, 4.0])


def test_a_trajectory_agrees_with_the_statistics_of_its_point():
    point = {"theta0": 0.7, "k3": 0.3, "n": 0.2, "m": 0.4}
    tr = atlas.trajectory("satellite", point, duration=12.0, samples=301)
    ds = atlas.label_points("satellite", point, duration=12.0)
    assert tr.time[-1] == 12.0
    assert float(tr.theta[0]) == pytest.approx(0.7, abs=1e-15)
    assert float(tr.psi_dot[0]) == pytest.approx(0.2, abs=1e-14)
    assert float(tr.theta.max()) == pytest.approx(float(ds.theta_max[0]), abs=1e-4)
    mean = np.trapezoid(tr.normal_rate, tr.time) / 12.0
    assert mean == pytest.approx(float(ds.normal_rate_mean[0]), abs=1e-5)
    np.testing.assert_allclose(tr.axis_x**2 + tr.axis_y**2 + tr.axis_z**2, 1.0, atol=1e-10)
    psi_dot = np.gradient(tr.psi, tr.time)
    before_the_pole = slice(1, 20)  # later the axis passes close to it
    np.testing.assert_allclose(psi_dot[before_the_pole], tr.psi_dot[before_the_pole], atol=2e-3)


def test_reference_cases_state_their_conventions(pytestconfig):
    data = json.loads((pytestconfig.rootpath / "tests/reference/satellite_cases.json").read_text())
    assert "equations of motion" in data["convention"]
