"""No table is labelled at defaults that it did not mean: a search over mangled tables, and tables that must be read."""

from importlib.util import find_spec

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from mangled_tables import EXTRAS, FORMS, OTHER_NAMES, SATELLITE, a_table, draw, mangled, read, source
from scenes import GIVEN

import atlas
from atlas import BadInput, load_scene
from atlas.cli import main
from atlas.scene import grid, tables
from atlas.scene.other_columns import parameter_meant

HERE = [
    form for form in FORMS if find_spec(form.split()[-1]) or form not in ("polars", "lazy polars", "pyarrow")
]


def test_mangled_tables_are_read_as_meant_or_refused(tmp_path):
    """Of 20 000 tables of this search, with other seeds, none was labelled at a default that it did not mean."""
    outcomes = {True: 0, False: 0}
    for seed in range(500):
        rng = np.random.default_rng([80, seed])
        meant, table = a_table(rng)
        form = draw(rng, HERE)
        plain = rng.integers(5) == 0
        table = table if plain else mangled(rng, table, meant)
        names = [column[0] for column in table]
        if len({*names}) < len(names) or (form == "index" and names[0] in OTHER_NAMES):
            continue
        answer = read(source(rng, table, form, tmp_path))
        expected = {name: values.tolist()[: 1 if form == "row" else None] for name, values in meant.items()}
        if isinstance(answer, str):
            assert answer.isprintable()
            assert not plain or form in ("csv", "texts"), (table, answer)
        else:
            assert answer == expected, (form, table)
        outcomes[isinstance(answer, str)] += 1
    assert min(outcomes.values()) > 100


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "   "])
@pytest.mark.parametrize("before", ["", "# "])
def test_a_file_is_read_with_each_separator(tmp_path, separator, before):
    rows = np.array([[0.8, 0.5, 0.2], [1.2, -0.6, 0.3]])
    np.savetxt(
        tmp_path / "a.csv",
        rows,
        delimiter=separator,
        header=separator.join(("C", "m", "theta0")),
        comments=before,
    )
    assert read(tmp_path / "a.csv") == dict(zip(("C", "m", "theta0"), rows.T.tolist(), strict=True))


COMMENTED = {
    "lines above": "# run 3\n# C m\n0.8 0.5\n1.2 0.6\n",
    "units below": "# C m\n# kg rad/s\n0.8 0.5\n1.2 0.6\n",
    "a column of names": "# name, C, m\nALPHA, 0.8, 0.5\nBETA, 1.2, 0.6\n",
    "names in quotes": '# "name" "C" "m"\n"A 1" 0.8 0.5\n"A 2" 1.2 0.6\n',
    "a comment of quotes": "# Bob's \"run\n#C,m\n0.8,0.5\n1.2,0.6\n",
    "names below a comment": "# m, C\nC,m\n0.8,0.5\n1.2,0.6\n",
    "one column for rows": "#,C,m\n0,0.8,0.5\n1,1.2,0.6\n",
    "blanks at the ends": "  C   m  \n  0.8   0.5  \n 1.2 0.6 \n",
}


@pytest.mark.parametrize("text", COMMENTED.values(), ids=COMMENTED)
def test_names_may_stand_in_a_comment(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    assert read(tmp_path / "a.csv") == {"C": [0.8, 1.2], "m": [0.5, 0.6]}


# Columns of texts that name points; beside C they are kept.
KEPT = {
    **{name: list(texts) for name, texts in EXTRAS.items() if name != "id"},
    "class A": ["yes", "no"],
    "units": ["kg m2", "rad/s"],
    "time": ["12:30", "12:30:00.5"],
    "version": ["1.2.3", "1.2.4"],
    "asteroid": ["433 Eros", "4 Vesta"],
    "letter": ["1A", "2A", "1B"],
    "remark": ["", "12 h", "restarted"],
    "C (label)/who": ["a", "b"],
    "empty": ["", ""],
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(KEPT.keys() - {"C (label)/who"}))
def test_texts_that_name_points_are_kept(tmp_path, name):
    texts = KEPT[name]
    columns = {"C": np.linspace(0.8, 1.2, len(texts)), name: texts}
    frame = pd.DataFrame(columns)
    frame.to_csv(tmp_path / "a.csv", index=False, sep=";")
    frame.to_xarray().to_netcdf(tmp_path / "a.nc")
    for each in (columns, frame, frame.set_index(name), tmp_path / "a.csv", tmp_path / "a.nc"):
        assert isinstance(read(each), dict) or (name, str(each)[-3:]) == ("empty", "csv")


# A column beside theta0, and the beginning of the sentence.
REFUSED = [
    ("c", ["low", "high"], "'c': no parameter, but C if case, blanks and units do not count; rename it, or keep it"),
    ("k 3", ["a", "b"], "'k 3': no parameter, but k3 if"),
    ("m (rpm)", ["0.5 rpm", "0.6"], "'m (rpm)': no parameter, but m if"),
    ("n_rpm", ["5,0", "6,0"], "'n_rpm': no parameter, but n if"),
    ("C m", ["0.8 0.5", "1.2 0.6"], "'C m': understood as one column, whose name holds C, m; separate the columns, or"),
    ("C|m", ["0.8|0.5", "1.2|0.6"], "'C|m': understood as one column, whose name holds C, m; "),
    ("who C", ["ALPHA 0.8", "BETA 1.2"], "'who C': understood as one column, whose name holds C; "),
    ("moment", ["0,8", "1,2"], "'moment': no parameter, and its texts are numbers but for decimal commas, units, quotes or"
     " separators, such as '0,8'; rename it, or keep it as it is by keep"),
    ("moment", ["0.8 kg m2", "1.2"], "'moment': no parameter, and its texts are numbers but for decimal commas,"),
    ("moment", ["'0.8'", "n/a"], "'moment': no parameter, and its texts are numbers but for decimal commas,"),
    ("moment", ["0.8 0.5", "1.2 0.6"], "'moment': no parameter, and its texts are numbers but for decimal commas,"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "texts", "sentence"), REFUSED)
def test_columns_that_may_be_parameters_are_refused_and_kept_by_name(
    tmp_path, monkeypatch, capsys, name, texts, sentence
):
    monkeypatch.chdir(tmp_path)
    columns = {"theta0": [0.1, 0.2], name: texts}
    frame = pd.DataFrame(columns)
    frame.to_csv("a.csv", index=False, sep=";")
    xr.Dataset({key: ("point", values) for key, values in columns.items()}).to_netcdf("a.nc")
    for each, place in ((columns, ""), (frame, ""), ("a.csv", "a.csv: "), ("a.nc", "")):
        assert read(each).startswith(place + sentence)
        assert read(each, keep=[name]) == {"theta0": [0.1, 0.2]}
    (tmp_path / "scene.toml").write_text(GIVEN.replace("mine.csv", "a.csv").replace("sigma * A", "A"))
    with pytest.raises(BadInput) as error:
        load_scene(tmp_path / "scene.toml")
    assert sentence in str(error.value)
    command = ["points", "satellite", "a.csv", "-o", "out.csv", "--duration", "5", "--quiet"]
    assert main(command) == 2
    assert f"a.csv: {sentence}" in capsys.readouterr().err
    assert main([*command, "--keep", name]) == 0
    assert pd.read_csv("out.csv", keep_default_na=False)[name].tolist() == texts


@pytest.mark.parametrize("unit", ["degree", "deg", "\N{DEGREE SIGN}", "degrees", "arcmin"])
def test_angles_whose_units_are_degrees_are_refused(tmp_path, unit):
    """As `select` gives them with degrees=True; in rad they would be other angles."""
    angle = xr.DataArray([30.0, 40.0], dims="point", attrs={"units": unit})
    ds = xr.Dataset({"theta0": angle, "A": ("point", [0.8, 0.9], {"units": "kg m2"})})
    ds.to_netcdf(tmp_path / "mine.nc")
    sentence = f"theta0: its units are '{unit}'; must be rad"
    for given in (ds, {"theta0": angle}, ds.set_coords("theta0"), tmp_path / "mine.nc"):
        assert read(given).endswith(sentence)
    (tmp_path / "scene.toml").write_text(GIVEN.replace("mine.csv", "mine.nc").replace("sigma * A", "A"))
    with pytest.raises(BadInput, match=sentence):
        load_scene(tmp_path / "scene.toml")
    assert read(ds.assign(theta0=angle.assign_attrs(units="rad")))["theta0"] == [30.0, 40.0]
    rate = xr.DataArray([6.0], dims="point", attrs={"units": "rpm"})
    assert read({"m": rate}) == "m: its units are 'rpm'; must be rad s-1"


def test_an_index_that_may_be_a_parameter_is_refused():
    frame = pd.DataFrame({"c": [0.8, 1.2], "m": [0.5, 0.6]}).set_index("c")
    for given in (
        frame,
        frame.to_xarray(),
        {"m": xr.DataArray([1.0, 2.0], dims="c", coords={"c": [0.8, 1.2]})},
    ):
        with pytest.raises(BadInput, match="'c': no parameter, but C if case, blanks and units do not count"):
            atlas.label_points("satellite", given, duration=5.0)
    counted = xr.DataArray([1.0, 2.0], dims="c", coords={"c": [0, 1]})
    assert read({"m": counted}) == read({"m": counted.drop_vars("c")}) == {"m": [1.0, 2.0]}
    both = counted.assign_coords(c=[0.8, 1.2])  # C is given
    assert read({"m": both, "C": both * 0 + 0.9}) == {"m": [1.0, 2.0], "C": [0.9, 0.9]}


def test_a_scene_without_any_column_of_its_own_says_so(tmp_path):
    (tmp_path / "scene.toml").write_text(GIVEN)
    for text, sentence in (
        ("who|C\nALPHA|0.8\n", "holds C"),
        ("who\nALPHA\n", "none of the columns is a parameter: who"),
    ):
        (tmp_path / "mine.csv").write_text(text)
        with pytest.raises(BadInput, match=sentence):
            load_scene(tmp_path / "scene.toml")
    (tmp_path / "mine.csv").write_text(
        "sigma_deg,theta0_deg\n0.5,20\n"
    )  # names of ties may be like parameters
    (tmp_path / "scene.toml").write_text(
        GIVEN.replace("sigma * A", 'sigma_deg * A"\ntheta0 = "theta0_deg * deg')
    )
    scene = load_scene(tmp_path / "scene.toml")
    np.testing.assert_allclose(grid.points_at_indices(scene, np.arange(1)).base["theta0"], np.pi / 9)


def test_names_are_understood():
    for name in (
        "theta 0",
        "Theta_0",
        "theta0 (deg)",
        "theta0_deg",
        "theta0 in deg",
        "THETA0",
        "theta\u00a00",
        " theta0*",
    ):
        assert parameter_meant(name, SATELLITE.parameters) == "theta0"
    for name in ("note", "class A", "N\u00b0", "mass", "theta", "theta0_class", "_" * 10**6):
        assert parameter_meant(name, SATELLITE.parameters) == ""


def test_columns_of_texts_are_kept_by_name_in_files(tmp_path):
    """Numbers are numbers, whole ones whole, as in a DataFrame."""
    (tmp_path / "a.csv").write_text("C;trial;grade\n0.8;1;a\n1.2;2;b\n")
    table = tables.table(tmp_path / "a.csv", SATELLITE.parameters, ["trial", "grade"])
    assert table["trial"].tolist() == [1, 2]
    assert table["grade"].tolist() == ["a", "b"]
