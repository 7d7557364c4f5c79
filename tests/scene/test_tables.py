"""Points of one's own: files and tables, samples in scenes, `atlas points`, and the errors of bad input."""

import csv

import cf_xarray  # noqa: F401
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import GIVEN, SAMPLED
from scipy.stats import kstest

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.flags import Label
from atlas.scene import grid, tables
from atlas.scene.points import SAMPLES, quasi_random
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

NAMES = set(SYSTEMS["satellite"].parameters)


def write(path, text):
    """Write a file and return its path."""
    path.write_text(text)
    return path


def test_every_form_of_table_gives_the_same_columns(tmp_path):
    columns = {"C": [0.8, 1.2, 1.3], "m": [0.5, -0.25, 2.0]}
    rows = [{"C": c, "m": m} for c, m in zip(*columns.values(), strict=True)]
    ds = xr.Dataset({name: ("particle", values) for name, values in columns.items()})
    ds.assign_coords(particle=[7, 8, 9]).to_netcdf(tmp_path / "a.nc")
    path = write(tmp_path / "a.csv", "\ufeffC, m\n0.8,0.5\n1.2,-0.25\n\n1.3,2e0\n")
    sources = [columns, rows, ds, pd.DataFrame(columns), path, str(path), tmp_path / "a.nc"]
    for source in sources:
        table = tables.table(source, NAMES)
        assert list(table) == ["C", "m"]
        for name, values in columns.items():
            np.testing.assert_array_equal(table[name], values)
    indexed = pd.DataFrame(columns).set_index("m").to_xarray()
    assert set(tables.table(indexed, NAMES)) == {"C", "m"}


@settings(max_examples=20)
@given(st.lists(st.tuples(st.floats(0.1, 1.9), st.floats(-1e3, 1e3)), min_size=1, max_size=20))
def test_csv_gives_back_every_bit(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("C", "m"), *rows])
    np.testing.assert_array_equal(np.transpose(list(tables.read(path, NAMES).values())), rows)


SAME_POINTS = {
    "commas": "C,m\n0.8,0.5\n1.2,-1\n",
    "semicolons": "C;m\n0.8;0.5\n1.2;-1\n",
    "tabs": "C\tm\n0.8\t0.5\n1.2\t-1\n",
    "comments": "# made by hand\nC,m\n\n  # first\n0.8,0.5\n1.2,-1",
    "byte-order mark": "\ufeffC,m\n0.8,0.5\n1.2,-1\n",
    "ends of old Macs": "C,m\r0.8,0.5\r1.2,-1\r",
    "ends of Windows": "C,m\r\n0.8,0.5\r\n1.2,-1\r\n",
    "blanks": " C , m \n 0.8 ,  0.5 \n1.2 , -1\n",
    "quotes": '"C", "m"\n"0.8","0.5"\n1.2, "-1"\n',
}


@pytest.mark.parametrize("text", SAME_POINTS.values(), ids=SAME_POINTS)
def test_csv_is_read_as_programs_write_it(tmp_path, text):
    (tmp_path / "a.csv").write_bytes(text.encode())
    table = tables.read(tmp_path / "a.csv", NAMES)
    assert {name: column.tolist() for name, column in table.items()} == {"C": [0.8, 1.2], "m": [0.5, -1.0]}


@pytest.mark.long
def test_columns_that_name_points_are_kept(tmp_path, monkeypatch, capsys):
    frame = pd.DataFrame(
        {"C": [0.8, 1.2, 1.3], "satellite": ["A, B", "#2", 'C "3"'], "ID": [7, 8, 10**17], "m": 0.5}
    )
    frame.index = [3, 1, 4]
    monkeypatch.chdir(tmp_path)
    for separator in (",", ";", "\t"):
        frame.to_csv("in.csv", sep=separator)
        ds = atlas.label_points("satellite", "in.csv", duration=5.0)
        assert ds.satellite.values.tolist() == frame.satellite.tolist()
        assert ds.ID.values.tolist() == frame.ID.tolist()
        assert ds["index"].values.tolist() == [3, 1, 4]
        assert set(ds.data_vars).isdisjoint(frame.columns)
    xr.testing.assert_identical(
        ds.drop_vars("index").assign_coords(point=[3, 1, 4]).drop_attrs(),
        atlas.label_points("satellite", frame, duration=5.0).drop_attrs(),
    )
    for name in ("out.csv", "out.nc"):
        assert main(["points", "satellite", "in.csv", "-o", name, "--duration", "5", "--quiet"]) == 0
    out = pd.read_csv("out.csv")
    assert list(out.columns[:3]) == ["index", "satellite", "ID"]
    assert out.satellite.tolist() == frame.satellite.tolist()
    assert out.ID.tolist() == frame.ID.tolist()
    with atlas.open_atlas("out.nc") as reopened:
        assert reopened.satellite.values.tolist() == frame.satellite.tolist()
        assert (reopened.label.values == ds.label.values).all()


def test_other_columns_of_numbers_are_kept_only_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "in.csv", "C,trial,m\n0.8,1,0.5\n1.2,2,0.5\n")
    command = ["points", "satellite", "in.csv", "-o", "out.csv", "--duration", "5", "--quiet"]
    assert main(command) == 2  # it may be a mistyped parameter
    assert "in.csv: trial: not a parameter of the satellite" in capsys.readouterr().err
    assert main([*command, "--keep", "trial"]) == 0
    assert pd.read_csv("out.csv").trial.tolist() == [1, 2]


def test_a_scene_leaves_out_columns_that_name_points(tmp_path):
    write(tmp_path / "mine.csv", ";sigma;theta0;who\n0;0.5;0.3;a\n1;1.5;0.7;b\n")
    scene = load_scene(write(tmp_path / "scene.toml", GIVEN))
    np.testing.assert_array_equal(grid.points_at_indices(scene, np.arange(2)).base["theta0"], [0.3, 0.7])
    assert "who" not in scene.toml()


def test_a_long_header_is_read_at_once(tmp_path):
    """Looking each name up among all others would take hours."""
    names = ",".join(map(str, range(150_000)))
    with pytest.raises(BadInput, match="no points"):
        tables.read(write(tmp_path / "a.csv", names + "\n"), NAMES)


@pytest.mark.parametrize("kind", SAMPLES)
def test_samples_fill_the_unit_cube_evenly(kind):
    points = quasi_random(kind, 3, 256, 5)
    assert points.shape == (3, 256)
    for column in points:
        assert kstest(column, "uniform").statistic < 0.02  # random numbers: about 0.05
    np.testing.assert_array_equal(points, quasi_random(kind, 3, 256, 5))
    assert (points != quasi_random(kind, 3, 256, 6)).any()
    assert quasi_random(kind, 2, 1, 0).shape == (2, 1)


@pytest.mark.long
def test_a_sampled_scene_runs_and_is_read_back_like_any_other(tmp_path):
    scene = load_scene(SAMPLED)
    ds = atlas.run(scene, tmp_path / "a.nc", progress=False)
    assert dict(ds.sizes) == {"point": 48}
    assert ds.C.dims == ds.theta0.dims == ds.k3.dims == ("point",)
    assert ((ds.C > 0.3) & (ds.C < 1.7)).all()
    assert float(np.log(ds.theta0).mean()) == pytest.approx(np.log(0.02 * 1.4) / 2, abs=0.05)
    assert (ds.family.cf == "perp_velocity").all()
    assert set(np.unique(ds.label)) == {Label.PERMANENT_ROTATION, Label.DRIFTING}
    base = {name: ds[name].values for name in scene.system.parameters}
    nudged = base | {"theta0": base["theta0"] + 1e-4, "psi0": base["psi0"] + 1e-4}
    labelled = atlas.label_points(
        "satellite", nudged, duration=ds.end_time.values, tolerance=1e-4, rate_tolerance=1e-3
    )
    np.testing.assert_array_equal(labelled.label, ds.label)
    np.testing.assert_array_equal(labelled.theta_dot_rms, ds.theta_dot_rms)
    copy = load_scene(ds.attrs["atlas_scene"])
    assert copy.toml() == scene.toml()
    motion = ds.atlas.trajectory(point=5, samples=3)
    assert float(motion.theta[0]) == pytest.approx(float(ds.theta0[5]) + 1e-4, abs=1e-12)
    folder = atlas.run(scene, tmp_path / "folder/", progress=False)
    np.testing.assert_array_equal(folder.label, ds.label)


def test_a_scene_takes_its_points_from_a_file_beside_it(tmp_path, monkeypatch):
    write(tmp_path / "mine.csv", "sigma,theta0\n0.5,0.3\n1.5,0.7\n0.7,1.1\n")
    scene = load_scene(write(tmp_path / "scene.toml", GIVEN))
    points = grid.points_at_indices(scene, np.arange(scene.size))
    np.testing.assert_array_equal(points.base["C"], [0.5, 1.5, 0.7])
    np.testing.assert_array_equal(points.base["theta0"], [0.3, 0.7, 1.1])
    monkeypatch.chdir(tmp_path.parent)
    (tmp_path / "mine.csv").unlink()
    copy = load_scene(scene.toml())  # as an atlas keeps it: without the file
    np.testing.assert_array_equal(
        grid.points_at_indices(copy, np.arange(3)).points["k3"], points.points["k3"]
    )


def test_atlas_points_labels_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "mine.csv", "C,theta0,m\n0.8,0.1,0.5\n1.2,0.0,0.5\n")
    options = ["--duration", "20", "--tolerance", "1e-6", "--method", "rk8", "--quiet"]
    assert main(["points", "satellite", "mine.csv", "-o", "out.nc", *options]) == 0
    output = capsys.readouterr().out
    assert "drifting 1" in output
    assert "wrote out.nc" in output
    with atlas.open_atlas("out.nc") as ds:
        expected = atlas.label_points(
            "satellite", tables.read("mine.csv", NAMES), duration=20.0, tolerance=1e-6, method="rk8"
        )
        xr.testing.assert_equal(ds.load(), expected)
        assert ds.attrs["atlas_method"] == "rk8"
    assert main(["points", "satellite", "mine.csv", "-o", "out.csv", *options]) == 0
    with open("out.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[len(NAMES) :] == list(expected.data_vars)
    assert [row["label"] for row in rows] == ["drifting", "permanent_rotation"]
    assert [float(row["theta_dot_rms"]) for row in rows] == expected.theta_dot_rms.values.tolist()
    assert [float(row["C"]) for row in rows] == [0.8, 1.2]
    capsys.readouterr()
    assert main(["points", "satellite", "mine.csv", "-o", "out.csv", *options]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["points", "satellite", "mine.csv", "-o", "out.csv", "--force", *options]) == 0


def test_label_points_takes_any_table(tmp_path):
    columns = {"C": [0.8, 1.2], "theta0": [0.1, 0.2], "m": [0.5, 0.5]}
    expected = atlas.label_points("satellite", columns, duration=5.0)
    frame = pd.DataFrame(columns)
    frame.to_csv(tmp_path / "a.csv", index=False)
    for table in (frame, frame.to_dict("records"), tmp_path / "a.csv", frame.to_xarray()):
        xr.testing.assert_equal(atlas.label_points("satellite", table, duration=5.0), expected)
