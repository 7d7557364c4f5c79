"""What is in a page: texts, arrays, points, the file."""

import base64
import json
import re
import zlib

import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_hex

import atlas
from atlas import cli, systems
from atlas.extensions.page import page
from atlas.extensions.page.content import Store, float_array, page_layout
from atlas.extensions.page.motion import CannotTranslate, motions
from atlas.extensions.page.page import atlas_page
from atlas.extensions.page.text import plain, text_runs

pytestmark = pytest.mark.usefixtures("whole_kernels")


def table_of(text):
    """The table in the file."""
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return json.loads(data)


def unpacked(entry):
    """An array of the table."""
    columns = np.frombuffer(zlib.decompress(base64.b64decode(entry["data"])), np.uint8)
    name = {"Int8Array": "i1", "Int32Array": "<i4", "Float32Array": "<f4", "Float64Array": "<f8"}[
        entry["type"]
    ]
    return np.ascontiguousarray(columns.reshape(-1, entry["size"]).T).view(name).ravel()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (r"$\theta_0$ (rad)", "θ₀ (rad)"),
        (r"mean $\dot\psi$ (rad s$^{-1}$)", "mean ψ\u0307 (rad s⁻¹)"),
        (r"$\omega'\cdot\gamma$", "ω\N{PRIME}·\N{GREEK SMALL LETTER GAMMA}"),
        ("$K_{1} = (C - A)/B$", "K₁ = (C \N{MINUS SIGN} A)/B"),
        (r"$\Omega \cos \theta$", "Ω\u2009cos\u2009\N{GREEK SMALL LETTER THETA}"),
        (r"$(\sin(x) + \cos^2 y)$", "(sin(x) + cos²y)"),
        ("costs 5 $", "costs 5 $"),
        (r"$\unknown x$", "unknownx"),
        ("$" + "{" * 90 + "x$", "x"),
    ],
)
def test_formulas_are_set_in_unicode(text, expected):
    assert plain(text) == expected


def test_styles_of_formulas():
    assert text_runs(r"a $x_{12}^2$") == [
        {"t": "a "}, {"t": "x", "i": True}, {"t": "12", "s": -1}, {"t": "2", "s": 1},
    ]  # fmt: skip


def test_arrays_are_stored_once_and_only_where_they_vary():
    store = Store((4, 3))
    whole = np.arange(12.0).reshape(4, 3)
    along = np.broadcast_to(np.array([1.5, np.nan, -0.0]), (4, 3))
    assert store.add(whole) == {"array": 0, "over": [0, 1]}
    assert store.add(along) == {"array": 1, "over": [1]}
    assert store.add(whole.copy()) == {"array": 0, "over": [0, 1]}
    assert store.add(np.full((4, 3), np.nan)) == {"array": 2, "over": []}
    assert store.add(whole.astype(np.float32)) == {"array": 3, "over": [0, 1]}
    assert store.nbytes == 8 * (12 + 3 + 1) + 4 * 12
    entries = store.packed()
    for entry, expected in zip(entries, (whole.ravel(), along[0], [np.nan], whole.ravel()), strict=True):
        assert np.array_equal(unpacked(entry), expected, equal_nan=True)
    assert np.signbit(unpacked(entries[1])[2])


def test_numbers_beyond_float32_keep_their_magnitude():
    assert float_array(np.array([1.0, np.inf, 0.0, np.nan])).dtype == np.float32
    for extreme in (1e60, 1e-60):
        assert float_array(np.array([1.0, extreme])).dtype == np.float64


@pytest.mark.long
def test_the_page_holds_the_points_of_the_atlas(small_atlas, small_page):
    table = table_of(small_page.html)
    arrays = [unpacked(entry) for entry in table["arrays"]]

    def over_points(reference):
        shape = [table["shape"][axis] if axis in reference["over"] else 1 for axis in (0, 1)]
        return np.broadcast_to(arrays[reference["array"]].reshape(shape), table["shape"])

    assert [axis["name"] for axis in table["axes"]] == ["sigma", "theta0"]
    assert table["axes"][0]["values"] == small_atlas.sigma.values.tolist()
    assert [variable["name"] for variable in table["variables"]] == list(small_atlas.data_vars)
    for variable in table["variables"]:
        expected = small_atlas[variable["name"]].values
        expected = expected if variable.get("flags") else expected.astype(np.float32)
        assert np.array_equal(over_points(variable["values"]), expected, equal_nan=True), variable["name"]
    motion = table["motion"]
    constants = dict(zip(small_atlas_constants(), motion["constants"], strict=True))
    assert np.array_equal(over_points(constants["C"])[:, 0], small_atlas.sigma.values)
    assert constants["A"]["over"] == []


def small_atlas_constants():
    """Names of the constants of the satellite."""
    return systems.get("satellite").equations.CONSTANTS


@pytest.mark.long
def test_scales_of_colours_span_the_values(small_atlas, small_page):
    table = table_of(small_page.html)
    shades, entries = table["shades"], table["variables"]
    for name in ("viridis", "cividis"):
        assert [shades[name][i] for i in (0, -1)] == [to_hex(colormaps[name](end))[1:] for end in (0.0, 1.0)]
    ends = {
        each["name"]: (each["scale"]["low"], each["scale"]["high"]) for each in entries if "scale" in each
    }
    for name in ("growth_rate", "phi_dot_mean", "theta_max"):
        assert ends[name] == (float(small_atlas[name].min()), float(small_atlas[name].max()))
    assert ends["growth_rate"][0] == 0.0
    largest = float(np.abs(small_atlas.psi_dot_mean).max())
    assert ends["psi_dot_mean"] == (-largest, largest)


@pytest.mark.long
def test_starts_are_those_of_the_trajectory(small_atlas, cube_atlas, sampled_atlas):
    for ds in (small_atlas, cube_atlas, sampled_atlas):
        shown = page_layout(ds)
        starts = motions(shown.ds, systems.get("satellite"), shown.scene, shown.dims)
        index = tuple(size // 3 for size in shown.shape)
        place = {dim: float(ds[dim][i]) for dim, i in zip(shown.dims, index, strict=True)}
        tr = ds.atlas.trajectory(**place)
        names = systems.get("satellite").equations.STATE
        assert [float(tr[name][0]) for name in names] == starts.state[(slice(None), *index)].tolist()
        assert float(tr.time[-1]) == starts.duration[index]
        assert float(tr.step) == starts.duration[index] / (starts.steps[index] * 1000)
        for name, values in starts.parameters.items():
            expected = float(tr.get(f"{name}_start", tr.get(name)))
            assert values[index] == expected, name


def test_points_without_a_scene_have_motions(quick_page):
    points = {"C": np.array([0.5, 1.3]), "theta0": np.array([0.3, 0.7]), "k3": 0.2, "m": 0.4, "psi0": 0.1}
    ds = atlas.label_points("satellite", points, duration=20.0)
    table = table_of(atlas_page(ds, file="points.nc").html)
    assert table["points"]
    assert "fault" not in table["motion"]
    assert {place["name"] for place in table["commands"]["places"]} == {"C", "theta0"}
    assert table["commands"]["shell"] == "atlas trajectory points.nc --at"


@pytest.mark.long
def test_each_point_of_a_grid_without_a_scene_has_its_own_motion(small_atlas, quick_page):
    """Labelled points put on a grid, and an atlas that has lost its scene: the starts are the coordinates, by name."""
    C, m = np.repeat([0.5, 1.0, 1.3], 2), np.tile([0.1, 0.4], 3)
    labelled = atlas.label_points("satellite", {"C": C, "m": m, "theta0": 0.3}, duration=np.arange(2.0, 8.0))
    table = labelled.set_index(point=["C", "m"]).unstack("point")
    lost = small_atlas.drop_attrs(deep=False).assign_attrs(small_atlas.attrs)
    del lost.attrs["atlas_scene"]
    for ds in (table, table.transpose("m", "C"), table.isel(C=slice(2)), lost):
        assert "fault" not in table_of(atlas_page(ds).html)["motion"]
        shown = page_layout(ds)
        starts = motions(shown.ds, systems.get("satellite"), None, shown.dims)
        for name, values in {**starts.parameters, "end_time": starts.duration}.items():
            expected = ds.get(name, xr.DataArray(np.nan)).broadcast_like(ds.label).transpose(*shown.dims)
            np.testing.assert_array_equal(values, expected, name)
    texts = ["".join(run["t"] for run in note) for note in table_of(atlas_page(lost).html)["notes"]]
    assert texts == ["The scene of this atlas is missing: motions start without its nudge."]


def test_large_atlases_are_strided_and_the_page_states_it(small_atlas):
    shown = page_layout(small_atlas, max_points=20)
    assert shown.shape == (5, 4)
    assert shown.notes == [
        "This page shows every 2nd value of $C/A$ and 2nd value of $\\theta_0$: 20 of 63 points."
    ]
    assert page_layout(small_atlas, max_points=63).notes == []


def test_equations_without_translation_leave_the_map(small_atlas, monkeypatch, quick_page):
    def fails(system, method):
        raise CannotTranslate("rhs: for i in state:")

    monkeypatch.setattr(page, "sources", fails)
    text = atlas_page(small_atlas).html
    assert "const equations = null;" in text
    assert "cannot be translated for this page: rhs: for i in state:" in table_of(text)["motion"]["fault"]
    assert len(table_of(text)["variables"]) == len(small_atlas.data_vars)


def test_the_same_atlas_gives_the_same_page_with_a_picture(small_atlas, small_page):
    assert atlas_page(small_atlas, file="small.nc").html == small_page.html
    assert '<img src="data:image/png;base64,iVBOR' in small_page.html


def test_a_renamed_axis_leaves_the_map(small_atlas, quick_page):
    table = table_of(atlas_page(small_atlas.rename(sigma="ratio")).html)
    assert [axis["name"] for axis in table["axes"]] == ["ratio", "theta0"]
    assert "sigma: this axis of the scene is not in the dataset" in table["motion"]["fault"]
    assert table["commands"]["places"] == []


def test_selected_points_keep_their_motions(small_atlas, quick_page):
    chosen = small_atlas.atlas.select(label="drifting")
    table = table_of(atlas_page(chosen).html)
    assert table["points"]
    assert table["shape"] == [chosen.sizes["point"]]
    assert {place["dim"] for place in table["commands"]["places"]} == {"sigma", "theta0"}
    assert "fault" not in table["motion"]


def test_bad_input(small_atlas, tmp_path):
    with pytest.raises(atlas.BadInput, match="atlas_system"):
        atlas_page(xr.Dataset({"a": ("x", [1.0, 2.0])}))
    with pytest.raises(atlas.BadInput, match="no axes"):
        atlas_page(small_atlas.isel(sigma=0, theta0=0))
    with pytest.raises(atlas.BadInput, match="no variables"):
        atlas_page(small_atlas.drop_vars(small_atlas.data_vars))
    with pytest.raises(atlas.BadInput, match=r"must end in \.html or \.htm"):
        page.Page("").save(tmp_path / "a.txt")
    page.Page("old").save(tmp_path / "a.html")
    with pytest.raises(atlas.BadInput, match="exists"):
        page.Page("new").save(tmp_path / "a.html")
    page.Page("new").save(tmp_path / "a.html", force=True)
    assert (tmp_path / "a.html").read_text() == "new"


def test_command(small_atlas, tmp_path, monkeypatch, capsys, quick_page):
    from atlas.store import netcdf

    monkeypatch.chdir(tmp_path)
    netcdf.write(small_atlas, tmp_path / "small.nc")
    assert cli.main(["page", "small.nc"]) == 0
    assert "wrote small.html" in capsys.readouterr().out
    assert "atlas trajectory small.nc --at" in (tmp_path / "small.html").read_text()
    assert cli.main(["page", "small.nc"]) == 2
    assert "--force" in capsys.readouterr().err
    assert cli.main(["page", "small.nc", "-o", "small.nc"]) == 2
