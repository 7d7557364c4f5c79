"""The work-precision study: levels, errors and labels against the reference, report, command."""

import math
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from readers import entries, look

from atlas.cli import main
from atlas.errors import BadInput
from atlas.extensions.studies import reference
from atlas.extensions.studies.figures import work_precision_figure
from atlas.extensions.studies.work_precision import (
    advice,
    levels,
    report,
    scene_level,
    summary,
    table,
    work_precision,
)
from atlas.kernel.tableaux import METHODS
from atlas.label import half_step
from atlas.scene.model import Settings
from atlas.scene.read import load_scene

pytestmark = pytest.mark.usefixtures("whole_kernels", "short_timings", "coarse_lines")


@pytest.fixture(scope="module")
def study(scene_text):
    scene = load_scene(scene_text({"integration.duration": 12.0, "integration.tolerance": 1e-6}))
    return work_precision(scene, 10)


@settings(max_examples=8)
@given(st.floats(1e-13, 1e-1), st.booleans())
def test_levels_contain_the_scenes_own_setting(value, step):
    chosen = Settings(step=value) if step else Settings(tolerance=value)
    name, values = levels(chosen)
    assert name == ("step" if step else "tolerance")
    assert values[scene_level(chosen)] == pytest.approx(value, rel=1e-12)
    assert all(math.log(a / b) > 0 for a, b in pairwise(values))


@pytest.mark.long
def test_no_error_is_below_the_uncertainty_of_the_reference(study):
    assert study.sizes["sample"] == 10
    was_run = np.isfinite(study.seconds_per_point)
    assert (study.error_state.where(was_run) >= study.reference_error).where(was_run, True).all()
    rows = summary(study)
    assert {row["method"] for row in rows} == set(METHODS)
    (own,) = [row for row in rows if row["own_setting"]]
    assert (own["method"], own["tolerance"]) == ("rk4", pytest.approx(1e-6))
    assert all(row["labels_wrong"] == 0 and row["seconds_per_point"] > 0 for row in rows)
    assert own["labels_wrong_at_most"] == pytest.approx(1 - 0.05 ** (1 / own["labels_compared"]))


@pytest.mark.long
def test_the_report_ends_with_the_cheapest_setting(study):
    text, rows = report(study), summary(study)
    assert len([line for line in text.splitlines() if line.lstrip().startswith("rk")]) == len(rows)
    last = text.splitlines()[-1]
    assert last == advice(study)
    cheapest = min(
        (r for r in rows if max(r["error_state"], r["error_rates"]) <= 1e-6 and not r["labels_unresolved"]),
        key=lambda r: r["seconds_per_point"],
    )
    assert f"{cheapest['method']} with tolerance = {cheapest['tolerance']:.3g}" in last


def test_the_figure_has_errors_over_time(study):
    """Medians over the points of each level, in microseconds, by the entries of the legend."""
    figure = work_precision_figure(study)
    (ax,) = figure.axes
    assert ax.get_xlabel() == "time per point and processor (\N{MICRO SIGN}s)"
    assert (ax.get_ylabel(), ax.get_xscale(), ax.get_yscale()) == ("median error", "log", "log")
    samples = entries(figure)
    for method in METHODS:
        at = study.sel({"method": method})
        time = 1e6 * at.seconds_per_point.values
        for text, error in (
            (f"{method}, final state", at.error_state),
            (f"{method}, {study.measured}", at.error_rates),
        ):
            median, seen = error.median("sample").values, at.error_state.median("sample").values < 3
            (drawn,) = (line.get_xydata() for line in ax.lines if look(line) == look(samples[text]))
            seen &= np.isfinite(time)
            np.testing.assert_allclose(drawn, np.stack([time, median], -1)[seen])
    (own,) = (row for row in summary(study) if row["own_setting"])
    (ring,) = (line.get_xydata() for line in ax.lines if look(line) == look(samples["the scene's setting"]))
    np.testing.assert_allclose(ring, [[1e6 * own["seconds_per_point"], own["error_state"]]])
    band = samples["uncertainty of reference"]
    top, median = ax.patches[0].get_y() + ax.patches[0].get_height(), float(study.reference_error.median())
    assert top == pytest.approx(median, abs=0)
    assert band.get_facecolor() == ax.patches[0].get_facecolor()


def test_the_table_has_medians_and_largest_values(study):
    """Each column under its name; microseconds in the report, seconds in the file."""
    names, *rows = (line.split(",") for line in table(study).splitlines())
    shown = [line.split() for line in report(study).splitlines() if line.lstrip().startswith("rk")]
    for row, line in zip(rows, shown, strict=True):
        each = dict(zip(names, row, strict=True))
        level = int(np.argmin(abs(study.tolerance.values - float(each["tolerance"]))))
        at = study.sel({"method": each["method"]}).isel(level=level)
        assert float(each["seconds_per_point"]) == float(at.seconds_per_point)
        assert float(each["error_state"]) == pytest.approx(float(np.nanmedian(at.error_state)), abs=0)
        assert float(each["error_state_largest"]) == pytest.approx(float(np.nanmax(at.error_state)), abs=0)
        assert float(each["error_rates"]) == pytest.approx(float(np.nanmedian(at.error_rates)), abs=0)
        assert float(each["steps"]) == pytest.approx(float(at.steps.mean()))
        line = [part for part in line if part not in ("*", "<=")]
        assert (line[0], float(line[1])) == (
            each["method"],
            pytest.approx(float(each["tolerance"]), rel=5e-3),
        )
        assert float(line[2]) == pytest.approx(float(at.steps.mean()), abs=0.5)
        assert float(line[3]) == pytest.approx(1e6 * float(at.seconds_per_point), rel=5e-3, abs=0)


def test_wrong_labels_are_counted_and_bounded(study):
    flipped = study.copy(deep=True)
    flipped["label_wrong"][0, :, :3] = 1
    row = summary(flipped)[0]
    assert row["labels_wrong"] == 3
    assert row["labels_wrong_at_most"] == half_step.upper_bound(3, row["labels_compared"])


@pytest.mark.long
def test_advice_where_no_level_reaches_the_tolerance(scene_text):
    scene = load_scene(scene_text({"integration.duration": 0.5, "integration.tolerance": 1e-17}))
    ds = work_precision(scene, 3)
    text = advice(ds)
    assert text.startswith("Out of reach: a median error of 1e-17")
    assert "the uncertainty of the reference is larger" in text
    assert "sigma = " in text
    assert float(ds.error_state.min()) >= reference.LEAST_UNCERTAINTY


@pytest.mark.long
def test_a_scene_with_a_step_and_the_observed_orders(scene_text):
    changes = {"integration.duration": 5.0, "integration.tolerance": None, "integration.step": 0.05}
    ds = work_precision(load_scene(scene_text(changes)), 4)
    for method in METHODS.values():
        orders = ds.order.sel({"method": method.name})
        assert orders.notnull().any()
        assert float(orders.median()) == pytest.approx(method.order, abs=0.6)
    (own,) = [row for row in summary(ds) if row["own_setting"]]
    assert own["step"] == pytest.approx(0.05)
    assert "own median error" in advice(ds)


@pytest.mark.long
def test_points_without_a_reference_are_left_out_and_named(scene_text):
    """One point of three turns too fast for the reference; the others keep theirs."""
    changes = {
        "family": None, "nudge": None, "labels": None, "fixed.m": None,
        "axes.sigma": {"values": [0.3]}, "axes.theta0": {"values": [0.2]}, "axes.m": {"values": [0.5, 0.7, 1e9]},
        "integration": {"duration": 5.0, "max_steps": 1000},
    }  # fmt: skip
    ds = work_precision(load_scene(scene_text(changes)), 3)
    (line,) = [line for line in report(ds).splitlines() if line.startswith("left out: ")]
    assert "fails at 1 of 3 points" in line
    assert "m = 1e+09" in line
    assert "0.5" not in line
    assert ds.sizes["sample"] == 2
    changes |= {"axes.m": {"values": [0.5, 1e8, 1e9]}}
    expected = r"fails at 2 of 3 points, where .* turns more than 100000 rad.*m = 1e\+09"
    with pytest.raises(BadInput, match=expected):
        work_precision(load_scene(scene_text(changes)), 3)


@pytest.mark.parametrize("count", [1, 0, -3])
def test_too_few_points(small_scene, count):
    with pytest.raises(BadInput, match="at least 2"):
        work_precision(load_scene(small_scene), count)


def test_the_command_prints_the_report_and_writes_every_format(tmp_path, monkeypatch, scene_text, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(scene_text({"integration.duration": 4.0}))
    command = ["accuracy", "small.toml", "--points", "3", "-o", "a.nc", "-o", "a.csv", "-o", "a.png"]
    assert main(command) == 0
    text = capsys.readouterr().out
    with xr.open_dataset("a.nc") as ds:
        assert report(ds) in text
    table = (tmp_path / "a.csv").read_text().splitlines()
    assert table[0].startswith("method,tolerance,own_setting,steps,seconds_per_point,error_state")
    assert {len(line.split(",")) for line in table} == {len(table[0].split(","))}
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["accuracy", "small.toml", "-o", "a.txt"]) == 2
    assert ".csv" in capsys.readouterr().err
    assert main(["accuracy", "small.toml", "--points", "1"]) == 2
    assert "at least 2" in capsys.readouterr().err
