"""Comparison with theory: agreement, confusion table and report."""

import re

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis.extra import numpy as hnp
from strategies import predictions

import atlas
from atlas import BadInput, load_scene
from atlas.analysis import compare
from atlas.analysis.summary import summary
from atlas.flags import Agreement, Label, Stability
from atlas.label import theory

flags = hnp.arrays(np.int8, 30, elements={"min_value": 0, "max_value": len(Label) - 1})


@given(flags, flags)
def test_agreement_and_confusion_table_are_consistent(label, predicted):
    names = list(Label.meanings())
    header, *rows = (line.split() for line in compare.confusion("table", predicted, label, names))
    counts = {(row[0], to): int(n) for row in rows for to, n in zip(header[1:], row[1:], strict=True)}
    result = theory.agreement(label, predicted)
    assert sum(counts.values()) == label.size
    for p in Label:
        for m in Label:
            points = (predicted == p) & (label == m)
            assert counts.get((names[p], names[m]), 0) == points.sum()
            if Label.NOT_COMPUTED in (p, m) or m == Label.UNRESOLVED:
                expected = Agreement.NOT_COMPARED
            elif p == m:
                expected = Agreement.AGREE
            elif m == Label.DRIFTING:
                expected = Agreement.THEORY_ONLY
            elif p == Label.DRIFTING:
                expected = Agreement.NUMERICS_ONLY
            else:
                expected = Agreement.DIFFER
            assert (result[points] == expected).all()


def test_off_the_families_a_satellite_drifts_with_and_without_an_orbit():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start |= {
        "theta0": np.array([0.5, 0.5]),
        "Omega": np.array([1.0, 0.0]),
        "theta_dot0": np.array([0.1, 0.1]),
    }
    predicted = predictions(system, start)[0].variables
    assert predicted["family"].tolist() == [0, 0]
    assert predicted["predicted"].tolist() == [Label.DRIFTING, Label.DRIFTING]


def test_the_prediction_for_a_nudged_start_depends_on_stability():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start["C"] = np.array([1.2, 0.5])  # cylindrical: stable, unstable
    nudged = start | {"theta_dot0": np.full(2, 1e-8)}
    for points, unstable in ((None, Label.PERMANENT_ROTATION), (nudged, Label.DRIFTING)):
        predicted = predictions(system, start, points)[0].variables["predicted"]
        assert predicted.tolist() == [Label.PERMANENT_ROTATION, unstable]


@pytest.mark.long
def test_the_report_counts_and_lists_the_worst_disagreements(small_scene):
    ds = atlas.run(load_scene(small_scene), progress=False)
    text = compare.report(ds)
    assert f"of {ds.label.size} points" in text
    assert "linearly stable points that drift" in text
    assert "no time to grow" in text
    wrong = ds.copy()
    wrong["label"] = ds.label.copy()
    steady = int(ds.predicted[2, 3]) == Label.PERMANENT_ROTATION
    wrong.label[2, 3] = Label.DRIFTING if steady else Label.PERMANENT_ROTATION
    coordinates = f"sigma = {float(ds.sigma[2]):.9g}, theta0 = {float(ds.theta0[3]):.9g}: theory"
    assert coordinates in compare.report(wrong, worst=99)
    assert "theory" in compare.report(wrong, worst=1).splitlines()[-1]


def small_atlas(**changes) -> xr.Dataset:
    """Eight points along x and two along y: stable below x = 4 and unstable from there; six disagree with theory."""
    label = np.repeat([[2], [3]], 4, axis=0).repeat(2, axis=1)
    predicted, stable = label.copy(), np.repeat([1, 2], 4)[:, None].repeat(2, axis=1)
    label[0, 0] = label[3, 1] = Label.DRIFTING  # far from the boundary and near it
    label[1, 0] = Label.DRIFTING  # far as well
    label[4, 0], label[7, 1] = Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
    label[6, 1] = Label.PERMANENT_ROTATION
    label[7, 0] = Label.UNRESOLVED
    rms, std = np.zeros((8, 2)), np.full((8, 2), np.nan)
    rms[0, 0], std[3, 1], rms[4, 0], std[7, 1] = 0.25, 0.5, 0.0625, 0.125
    rms[1, 0], rms[6, 1] = 0.375, 0.75
    growth = np.zeros((8, 2))
    growth[4, 0], growth[7, 1], growth[6, 1] = 2.0, 1.25, 1.5  # at the limit of the time to grow
    growth[6, 0] = 9.0
    xy = ("x", "y")
    variables = {
        "label": (xy, label), "predicted": (xy, predicted), "stable": (xy, stable), "growth_rate": (xy, growth),
        "end_time": (xy, np.full((8, 2), 8.0)), "theta_dot_rms": (xy, rms), "psi_dot_std": (("y", "x"), std.T),
    }  # fmt: skip
    return xr.Dataset(variables | changes, coords={"x": np.arange(8.0), "y": [0.0, 5.0]})


def test_the_report_of_a_small_atlas():
    table, lines = np.split(np.array(compare.report(small_atlas()).splitlines()), [3])
    assert [line.split() for line in table] == [
        ["theory", "\\", "measured", "regular_precession", "permanent_rotation", "drifting", "unresolved"],
        ["permanent_rotation", "0", "5", "3", "0"],
        ["drifting", "1", "2", "4", "1"],
    ]
    assert len({len(line) for line in table}) == 1  # columns are aligned on the right
    assert lines.tolist() == [
        "compared: 15 of 16 points, 60.000 % agree",
        "  not_compared: 1",
        "  agree: 9",
        "  theory_only: 3",
        "  numerics_only: 3",
        "linearly stable points that drift: 3, of these 2 outside a band of 2 % of the axis range around the"
        " analytical boundary",
        "linearly unstable points that survive: 3, of these 2 outside a band of 2 % of the axis range around the"
        " analytical boundary",
        "  survivors with growth_rate x duration < 12 (no time to grow): 1 of 3; largest growth_rate x duration:"
        " 16.00",
        "worst disagreements (unsteadiness = largest rms or std of the rates):",
        "  x = 3, y = 5: theory permanent_rotation, measured drifting, unsteadiness 0.5, growth_rate x time = 0.00",
        "  x = 1, y = 0: theory permanent_rotation, measured drifting, unsteadiness 0.375, growth_rate x time = 0.00",
        "  x = 0, y = 0: theory permanent_rotation, measured drifting, unsteadiness 0.25, growth_rate x time = 0.00",
        "  x = 4, y = 0: theory drifting, measured regular_precession, unsteadiness 0.0625, growth_rate x time = 16.00",
        "  x = 7, y = 5: theory drifting, measured permanent_rotation, unsteadiness 0.125, growth_rate x time = 10.00",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std"])
def test_the_report_uses_what_the_atlas_has(name):
    """Without stability and time there is no line about them; any one of the rates shows what is unsteady."""
    ds = small_atlas().drop_vars(["stable", "growth_rate", "end_time", "theta_dot_rms", "psi_dot_std"])
    ds[name] = ds["label"] / 8.0
    lines = compare.report(ds, worst=1).splitlines()
    assert lines[-3] == "  numerics_only: 3"
    assert lines[-1] == "  x = 0, y = 0: theory permanent_rotation, measured drifting, unsteadiness 0.375"
    assert compare.report(ds, worst=0).splitlines() == lines[:-2]
    # a label that only theory has keeps its row
    ds["label"] = ds["predicted"] * 0 + Label.DRIFTING
    assert [line.split()[0] for line in compare.report(ds).splitlines()[1:3]] == [
        "permanent_rotation",
        "drifting",
    ]
    ds["label"] = ds["predicted"]
    assert compare.report(ds).splitlines()[-2:] == [
        "compared: 16 of 16 points, 100.000 % agree", "  agree: 16",
    ]  # fmt: skip
    ds["label"] = xr.full_like(ds["label"], Label.NOT_COMPUTED)
    assert "compared: 0 of 16 points, nothing agree" in compare.report(ds)


def test_numbers_that_the_atlas_does_not_hold_are_not_printed():
    """Neither of atlases of labels alone, nor at points without them."""
    ds = small_atlas()
    lines = compare.report(ds.drop_vars(["theta_dot_rms", "psi_dot_std"]), worst=2).splitlines()
    assert lines[-3:] == [
        "disagreements in the order of the grid"
        " (the worst need theta_dot_rms, psi_dot_std, phi_dot_std, normal_rate_std in [outputs]):",
        "  x = 0, y = 0: theory permanent_rotation, measured drifting, growth_rate x time = 0.00",
        "  x = 1, y = 0: theory permanent_rotation, measured drifting, growth_rate x time = 0.00",
    ]
    lines = compare.report(ds[["label", "predicted"]], worst=1).splitlines()
    assert lines[-1] == "  x = 0, y = 0: theory permanent_rotation, measured drifting"
    ds["theta_dot_rms"][1, 0] = ds["growth_rate"][3, 1] = np.nan
    lines = compare.report(ds, worst=9).splitlines()[-6:]
    assert lines[0] == "  x = 3, y = 5: theory permanent_rotation, measured drifting, unsteadiness 0.5"
    (unknown,) = (line for line in lines if "x = 1, y = 0" in line)
    assert (
        unknown
        == lines[-1]
        == ("  x = 1, y = 0: theory permanent_rotation, measured drifting, growth_rate x time = 0.00")
    )


@pytest.mark.long
def test_a_comparison_says_once_that_labels_follow_the_third_axis(caplog):
    """Of bodies that are symmetric about another axis; neither a run nor its check says so."""
    bodies = {"A": 1.0, "B": np.array([1.3, 1.2]), "C": 1.3, "theta0": 0.3}
    names = ["label", "predicted", "label_any_axis"]
    ds = atlas.label_points("satellite", bodies, duration=5.0, variables=names)
    assert "third axis" not in caplog.text + str(ds.attrs.get("atlas_warnings"))
    text = ds.drop_vars("label_any_axis").atlas.compare()
    assert text.count("label describes the motion of the third axis") == 1
    assert "label describes" not in ds.atlas.compare()
    assert "label describes" not in ds.drop_vars("label_any_axis").isel(point=[1]).atlas.compare()


def test_the_report_refuses_what_is_no_atlas():
    ds = small_atlas()
    for name in ("label", "predicted"):
        with pytest.raises(BadInput, match=f"^{name}: not in this dataset"):
            compare.report(ds.drop_vars(name))
        for damaged in (ds[name] * 1.0, ds[name] * 0 - 1, ds[name] * 0 + len(Label)):
            with pytest.raises(BadInput, match=f"^{name}: damaged"):
                compare.report(ds.assign({name: damaged}))
    with pytest.raises(BadInput, match="different dimensions"):
        compare.report(ds.assign(predicted=ds["predicted"].T))


def test_the_boundary_is_near_within_a_fiftieth_of_the_axis_range():
    """And at least at the neighbours of a point; never along an axis of one point."""
    for count, width in ((8, 1), (51, 1), (52, 2), (201, 4), (202, 5)):
        stable = np.full((count, 1), Stability.STABLE)
        stable[count // 2 :] = Stability.UNSTABLE
        near = np.flatnonzero(compare.near_boundary(stable, (0, 1)))
        assert near.tolist() == list(range(count // 2 - width, count // 2 + width))
    assert compare.near_boundary(np.array([[1, 2], [1, 2]]), (0, 1)).all()
    assert not compare.near_boundary(np.array([1]), (0,)).any()
    assert not compare.near_boundary(np.array([1, 2]), ()).any()  # a list


@pytest.mark.long
def test_other_orders_and_forms_of_an_atlas_get_the_same_comparison(scene_text, tmp_path):
    """Also lazy ones, of which xarray 2026.9 cannot choose single points, and stacked ones with angles in degrees."""
    text = scene_text(
        {"axes.theta0.display_units": "deg", "axes.theta0.count": 9, "integration.duration": 20.0}
    )
    ds = atlas.run(load_scene(text), tmp_path / "a.nc", progress=False).load()
    whole = ds.atlas.compare()
    assert " deg: theory drifting, measured permanent_rotation, unsteadiness" in whole
    transposed = ds.transpose("theta0", "sigma")
    transposed.to_netcdf(tmp_path / "transposed.nc")
    for opened in (
        atlas.open_atlas(tmp_path / "transposed.nc"),
        atlas.open_atlas(tmp_path / "a.nc").transpose(),
    ):
        with opened:
            assert opened.atlas.compare() == whole
    stacked = ds.stack(p=("sigma", "theta0"))
    places = [re.findall(r"theta0 = \S+ deg", text) for text in (whole, stacked.atlas.compare())]
    assert places[0] == places[1] != []
    assert len(stacked.atlas.map().axes[0].collections) > 0
    frame = stacked.atlas.to_dataframe(degrees=True)
    np.testing.assert_allclose(frame.theta0, np.degrees(stacked.theta0))


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_the_summary_reads_the_median_of_some_labels_to_a_quarter_of_a_decade(count):
    values = 10.0 ** np.random.default_rng(count).uniform(-9, 0, count)
    estimates = xr.DataArray([*values, np.nan, 7.0], dims="point")
    labels = [Label.DRIFTING] * (count + 1) + [Label.REGULAR_PRECESSION]
    label = xr.DataArray(np.array(labels, np.int8), dims="point")
    line = summary(
        xr.Dataset(
            {"label": label, "error_estimate": estimates},
            attrs={"atlas_seconds": 1.0, "atlas_points_per_second": 1.0},
        )
    ).splitlines()[1]
    median, largest = map(float, re.search(r"drifting points (\S+) \(median\) to (\S+) ", line).groups())
    middle = np.sort(values)[(count - 1) // 2]
    assert largest == pytest.approx(values.max(), rel=0.05)  # printed with two digits
    assert 0.9 * middle <= median <= 1.1 * middle * 10**0.25  # printed with one digit


def test_a_run_ends_with_labels_agreement_and_points_in_doubt(small_scene):
    ds = atlas.run(load_scene(small_scene), progress=False)
    lines = summary(ds, verbose=False).splitlines()
    agree = int((ds.agreement == Agreement.AGREE).sum())
    compared = int((ds.agreement != Agreement.NOT_COMPARED).sum())
    assert lines[2:] == [
        f"theory: {100 * agree / compared:.2f} % of {compared} compared points agree",
        "in doubt: no point",
        f"0 of {ds.attrs['atlas_half_step_points']} points checked at half the step changed their label; with 95 %"
        f" confidence at most {ds.attrs['atlas_labels_may_change']} of all {ds.label.size} would",
    ]
    assert lines[:2] == summary(ds).splitlines()[:2]
    ds["status"][0, 0] = 5
    assert "in doubt: step_sensitive 1" in summary(ds, verbose=False)


def test_drifting_points_are_told_the_nearest_family():
    bodies = {"C": np.array([1.2, 1.3]), "k3": 0.1, "theta0": np.array([0.4, 0.5]), "m": 0.5}
    ds = atlas.label_points("satellite", bodies, duration=20.0)
    line = summary(ds, verbose=False).splitlines()[-1]
    residual = float(re.search(r"nearest to the family perp_radius, residual (\S+) \(median\)", line)[1])
    assert residual == pytest.approx(0.14)
    # nearer to (17), Omega (A - C) cos(theta0) = C m + k3
    exact = (1 - bodies["C"]) * np.cos(bodies["theta0"]) - bodies["C"] * 0.5
    ds = atlas.label_points("satellite", bodies | {"k3": exact + 0.1}, duration=20.0)
    assert "perp_radius, residual 0.011" in summary(ds, verbose=False)
