"""Points of one's own: files and tables, samples in scenes, `atlas points`, and the errors of bad input."""

import csv
from pathlib import Path

import cf_xarray  # noqa: F401
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
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
SMALL = (Path(__file__).parents[1] / "small.toml").read_text()
SMALL = SMALL.replace("duration = 30.0", 'duration = "3 orbits"').replace(
    "tolerance = 1e-5", "tolerance = 1e-4"
)
BEFORE_AXES, FROM_TIES = SMALL[: SMALL.index("[axes")], SMALL[SMALL.index("[ties]") :]
SAMPLE = """\
[points]
sample = "sobol"
count = 48
seed = 3

[points.ranges.sigma]
from = 0.3
to = 1.7

[points.ranges.theta0]
from = 0.02
to = 1.4
spacing = "log"

"""
SAMPLED = BEFORE_AXES + SAMPLE + FROM_TIES
GIVEN = BEFORE_AXES + '[points]\nfile = "mine.csv"\n' + FROM_TIES


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


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.csv", b"", "empty"),
        ("a.csv", b"C,m\n", "no points"),
        ("a.csv", b"C,m\n1,2\n1\n", "a.csv, line 3: 1 fields, but the first line names 2 columns"),
        ("a.csv", b"C,m\n# 1\n1,2,3\n", "a.csv, line 3: 3 fields"),
        ("a.csv", b"C,m\n1,2\n\n1,two\n", "a.csv, line 4: m = 'two'"),
        ("a.csv", b"C;m\n1;0,5\n", "line 2: m = '0,5': must be a number with a decimal point, not a comma"),
        ("a.csv", b"C\n" + 1_000_001 * b"1", "line 2: more than 1000000 characters"),
        ("a.csv", b"C,C\n1,2\n", "'C' twice"),
        ("a.csv", b"C,\n1,2\n", "without name"),
        ("a.csv", b"C\n\xff\xfe\n", "UTF-8"),
        ("a.csv", b'C\n"1\n', "not a CSV file"),
        ("a.nc", b"C\n1\n", "not a NetCDF file"),
        ("a.txt", b"C\n1\n", ".csv or .nc"),
    ],
)
def test_files_that_hold_no_points_are_refused_in_one_line(tmp_path, name, content, named):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput) as error:
        tables.read(tmp_path / name, NAMES)
    assert named in str(error.value)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


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
        ds.drop_vars("index").drop_attrs(), atlas.label_points("satellite", frame, duration=5.0).drop_attrs()
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
    for name, problem in (("m", "a parameter"), ("trail", "no column")):
        assert main([*command, "--force", "--keep", name]) == 2
        assert problem in capsys.readouterr().err
    write(tmp_path / "in.csv", "C,label,m\n0.8,first,0.5\n")
    assert main([*command, "--force"]) == 2
    assert "the column label has the name of a variable of the result" in capsys.readouterr().err
    with pytest.raises(BadInput, match="different lengths"):
        atlas.label_points("satellite", {"C": [0.8, 1.2], "name": ["a", "b", "c"]})


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


def test_sources_that_are_no_table_of_points_are_refused(tmp_path):
    plane = xr.Dataset({"C": (("x", "y"), np.ones((2, 2)))})
    plane.to_netcdf(tmp_path / "plane.nc")
    cases = [
        (tmp_path / "none.csv", "no such file"),
        (tmp_path / "plane.nc", "x, y"),
        ([{"C": 1.0}, {"m": 1.0}], "number 1 and number 0 differ in C, m"),
        ([], "there are none"),
        (3.0, "float cannot be read"),
    ]
    (tmp_path / "folder.csv").mkdir()
    cases.append((tmp_path / "folder.csv", "folder"))
    for source, named in cases:
        with pytest.raises(BadInput, match=named):
            tables.table(source, NAMES)


@pytest.mark.parametrize("kind", SAMPLES)
def test_samples_fill_the_unit_cube_evenly(kind):
    points = quasi_random(kind, 3, 256, 5)
    assert points.shape == (3, 256)
    for column in points:
        assert kstest(column, "uniform").statistic < 0.02  # random numbers: about 0.05
    np.testing.assert_array_equal(points, quasi_random(kind, 3, 256, 5))
    assert (points != quasi_random(kind, 3, 256, 6)).any()
    assert quasi_random(kind, 2, 1, 0).shape == (2, 1)


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


BAD = [
    (SAMPLED, 'sample = "sobol"', 'sample = "random"', "points.sample"),
    (SAMPLED, 'sample = "sobol"', "", "one of sample, file and values, found none"),
    (SAMPLED, 'sample = "sobol"', 'sample = "sobol"\nfile = "a.csv"', "found sample and file"),
    (SAMPLED, "count = 48", "count = 0", "points.count = 0"),
    (SAMPLED, "count = 48", "count = 4.0", "points.count"),
    (SAMPLED, "count = 48", "", "points.count is missing"),
    (SAMPLED, "seed = 3", "seed = -1", "points.seed"),
    (SAMPLED, "seed = 3", "grain = 3", "points.grain"),
    (SAMPLED, "from = 0.3", "", "points.ranges.sigma.from is missing"),
    (SAMPLED, "from = 0.3", "from = 1.7", "from = to"),
    (SAMPLED, "from = 0.3", "from = nan", "points.ranges.sigma.from"),
    (SAMPLED, "from = 0.3", "from = 0.3\ncount = 3", "points.ranges.sigma.count"),
    (SAMPLED, "from = 0.02", "from = -0.02", "spacing = 'log'"),
    (SAMPLED, 'spacing = "log"', 'spacing = "cubic"', "cubic"),
    (SAMPLED, "ranges.sigma", "ranges.sine", "ties.C = 'sigma * A': 'sigma' is neither"),
    (SAMPLED, 'C = "sigma * A"', 'C = "A"', "points.sigma"),
    (SAMPLED, 'C = "sigma * A"', 'C = "sigma * A"\ntheta0 = "0.3"', "theta0 is given in ties and in points"),
    (SAMPLED, "from = 0.3\nto = 1.7", "from = 2.3\nto = 2.7", "no rigid body"),
    (SAMPLED, "[ties]", "[axes.k1]\nvalues = [0.0]\n[ties]", "points and axes are both given"),
    (SAMPLED, "[ties]", "[refine]\nlevels = 2\n[ties]", "points and refine are both given"),
    (SAMPLED, SAMPLE, "[points]\nvalues = 3\n", "points.values"),
    (SAMPLED, SAMPLE, "[points.values]\n", "points: there are none"),
    (SAMPLED, SAMPLE, "[points.values]\nsigma = []\n", "points.values.sigma"),
    (SAMPLED, SAMPLE, "[points.values]\nsigma = [1.0, true]\n", "points.values.sigma = True"),
    (SAMPLED, SAMPLE, "[points.values]\nsigma = [1.0]\ntheta0 = [1.0, 2.0]\n", "different lengths (sigma: 1"),
    (SAMPLED, SAMPLE, "[points.values]\nsigma = [1.0]\nA = [1.0]\n", "A is given in fixed and in points"),
    (GIVEN, 'file = "mine.csv"', 'file = "none.csv"', "no such file"),
    (GIVEN, 'file = "mine.csv"', "file = 3", "points.file"),
    (GIVEN, 'file = "mine.csv"', 'file = "mine.csv"\nseed = 2', "points.seed: only together with sample"),
    (GIVEN, 'C = "sigma * A"', 'C = "sigma * A"\nk1 = "q"', "'q' is neither"),
    (GIVEN, "A = 1.0", "A = 1.0\n[missing]", "missing"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "named"), BAD, ids=[b[3] for b in BAD])
def test_error_of_bad_points_in_a_scene_is_one_line_that_names_the_key(tmp_path, text, old, new, named):
    assert old in text
    write(tmp_path / "mine.csv", "sigma,theta0\n0.5,0.3\n")
    path = write(tmp_path / "scene.toml", text.replace(old, new, 1))
    with pytest.raises(BadInput) as error:
        grid.check(load_scene(path))
    assert named in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("sigma,theta0\n0.5,\n", "mine.csv, line 2: theta0 is empty or nan"),
        ("sigma,theta0\n0.5,0.1\n\n0.5,inf\n", "mine.csv, line 4: theta0 = inf"),
        ("sigma,theta0,colour\n0.5,0.1,3\n", "points.colour: not a parameter"),
        ("theta0\n0.5\n", "'sigma' is neither"),
        ("sigma,theta0,sin\n0.5,0.1,3\n", "'sin' cannot be used as a name"),
    ],
)
def test_bad_columns_of_a_file_are_named(tmp_path, content, named):
    write(tmp_path / "mine.csv", content)
    with pytest.raises(BadInput, match=named):
        load_scene(write(tmp_path / "scene.toml", GIVEN))


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


@pytest.mark.parametrize(
    ("content", "arguments", "named"),
    [
        ("C,sigma\n1,2\n", [], "sigma: not a parameter"),
        ("C\nnan\n", [], "mine.csv, line 2: C is empty or nan; must be a finite number"),
        ("C,m\n1,1\n\n1,\n", [], "mine.csv, line 4: m is empty or nan; must be a finite number"),
        ("C,m\n1,1\n1,-inf\n", [], "mine.csv, line 3: m = -inf: must be a finite number"),
        ("C\n1\n-1\n", [], "mine.csv, line 3: C = -1: allowed: C > 0"),
        ("C\n1\n", ["--threads", "0"], "--threads"),
        ("C\n1\n", ["--duration", "-3"], "duration"),
        ("C\n1\n", ["--tolerance", "0"], "tolerance"),
        ("C\n1\n", ["--method", "euler"], "euler"),
        ("C\n1\n", ["--step", "0.1", "--tolerance", "1e-3"], "not allowed with"),
        ("C\n1\n", ["-o", "no/out.nc"], "no folder"),
        ("C\n1\n", ["-o", "out.txt"], ".csv or .nc"),
    ],
)
def test_atlas_points_answers_bad_input_with_one_line_and_exit_2(
    tmp_path, monkeypatch, capsys, content, arguments, named
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "mine.csv", content)
    try:
        code = main(["points", "satellite", "mine.csv", "-o", "out.nc", *arguments])
    except SystemExit as stop:
        code = stop.code
    message = capsys.readouterr().err
    assert code == 2
    assert named in message
    assert len(message.strip().splitlines()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.csv"]


def test_label_points_takes_any_table(tmp_path):
    columns = {"C": [0.8, 1.2], "theta0": [0.1, 0.2], "m": [0.5, 0.5]}
    expected = atlas.label_points("satellite", columns, duration=5.0)
    frame = pd.DataFrame(columns)
    frame.to_csv(tmp_path / "a.csv", index=False)
    for table in (frame, frame.to_dict("records"), tmp_path / "a.csv", frame.to_xarray()):
        xr.testing.assert_equal(atlas.label_points("satellite", table, duration=5.0), expected)
