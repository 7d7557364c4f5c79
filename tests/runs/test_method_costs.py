"""The line on what the other method would cost: its number, and where it is printed."""

import re
from dataclasses import replace

import numpy as np
import pytest

import atlas
from atlas import load_scene
from atlas.analysis.summary import summary
from atlas.cli import main
from atlas.kernel.tableaux import METHODS
from atlas.runs.estimate import dry_run
from atlas.runs.plan import ScenePlan

pytestmark = pytest.mark.usefixtures("whole_kernels")


def relative_costs(scene, sample):
    return ScenePlan(scene, sample).relative_costs


def lines_and_sample(text):
    """The lines on the other methods of a scene, its sample and itself."""
    plan = ScenePlan.of(load_scene(text))
    return plan.method_lines(), plan.sample, plan.scene


@pytest.mark.parametrize(("method", "other", "words"), [("rk4", "rk8", "of"), ("rk8", "rk4", "times")])
def test_the_line_names_both_methods_and_what_the_other_costs(scene_text, method, other, words):
    (line,), sample, scene = lines_and_sample(scene_text({"integration.method": method}))
    ratio = relative_costs(scene, sample)[other]
    assert line == (
        f'method: {method}; method = "{other}" would integrate in about {ratio:.2g} {words} the time'
        " at the same tolerance"
    )
    assert (ratio < 1) == (other == "rk8")


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_the_costs_are_those_of_the_steps_that_keep_the_phase_error(scene_text, tolerance):
    text = scene_text({"integration.tolerance": tolerance, "labels.rate_tolerance": 1.0})
    _, sample, scene = lines_and_sample(text)
    radians = scene.system.frequency_bound(sample.points) * sample.duration
    # N steps of y = radians / N rad cause the phase error N c y^(p + 1) = tolerance.
    steps = {
        name: (radians * (radians * method.dispersion / tolerance) ** (1 / method.order)).mean()
        for name, method in METHODS.items()
    }
    expected = METHODS["rk8"].step_cost * steps["rk8"] / steps["rk4"]
    assert relative_costs(scene, sample)["rk8"] == pytest.approx(expected, rel=0.2)  # counts are rounded up
    other_way = replace(scene, settings=replace(scene.settings, method="rk8"))
    product = relative_costs(scene, sample)["rk8"] * relative_costs(other_way, sample)["rk4"]
    assert product == pytest.approx(1.0)


def test_only_points_where_the_family_exists_count(scene_text):
    changes = {"family": {"name": "oblique", "solve": ["psi0", "k3"]}, "ties.psi0": None}
    _, sample, scene = lines_and_sample(scene_text(changes | {"fixed.mu3": 1.0, "fixed.h1": 0.5}))
    assert 0 < sample.exists.sum() < sample.exists.size
    assert relative_costs(scene, sample) == relative_costs(scene, sample.subset(sample.exists))


def test_a_scene_with_a_step_has_no_line(scene_text):
    lines, sample, scene = lines_and_sample(
        scene_text({"integration.tolerance": None, "integration.step": 0.01})
    )
    assert lines == []
    assert relative_costs(scene, sample) == {}


def test_dry_run_measures_and_check_expects_what_statistics_cost():
    """One motion in five is exact and never ends early; theta of the others changes from the start."""
    table = atlas.example("conditions_k3")
    table["axes"]["k3"]["count"], table["axes"]["theta0"]["count"] = 5, 8
    plan = ScenePlan.of(load_scene(table))
    statistics = "statistics: they need whole runs; without them"
    expected = f"{statistics} the 80 % of the points that drift by theory would end once that is certain"
    assert plan.statistics_lines() == [expected]
    (line,) = (line for line in dry_run(plan.scene, threads=1).splitlines() if line.startswith("statistics"))
    share = re.fullmatch(rf"{statistics} about ([0-9.]+) of the integration", line)
    assert 0.2 <= float(share[1]) < 0.25
    table["outputs"] = {"variables": ["label", "predicted"]}
    assert ScenePlan.of(load_scene(table)).statistics_lines() == []
    table["integration"]["duration"], table["labels"] = 10.0, {"transient": 30.0}
    (line,) = ScenePlan.of(load_scene(table)).statistics_lines()
    assert (
        line == "transient: 75 % of the time of all runs, in which none ends early, however certain its label"
    )


def test_the_first_line_of_a_run_names_a_faster_method(small_scene, capsys):
    (line,), _, scene = lines_and_sample(small_scene)
    atlas.run(scene)
    assert capsys.readouterr().err.splitlines()[0] == line
    atlas.run(replace(scene, settings=replace(scene.settings, method="rk8")))
    assert "method" not in capsys.readouterr().err


def test_long_calls_of_label_points_are_told_of_a_faster_method_once(monkeypatch, caplog):
    monkeypatch.setattr("atlas.label.points.MANY_STEPS", 1e4)
    monkeypatch.setattr("atlas.label.points._advised", False)
    rows = {"theta0": np.linspace(0.3, 1.0, 120), "m": 1.0}
    for count, messages in ((99, 0), (120, 1), (120, 1)):
        some = {name: np.broadcast_to(values, 120)[:count] for name, values in rows.items()}
        atlas.label_points("satellite", some, duration=7.0)
        assert len(caplog.messages) == messages
    assert re.fullmatch(
        r'method: rk4; method = "rk8" would integrate in about 0\.\d+ of the time at the same tolerance',
        caplog.messages[0],
    )


@pytest.mark.long
def test_check_dry_run_and_summary_print_the_line_once(small_scene, tmp_path, monkeypatch, capsys):
    (tmp_path / "small.toml").write_text(small_scene)
    (line,), _, scene = lines_and_sample(small_scene)
    monkeypatch.chdir(tmp_path)
    assert main(["check", "small.toml"]) == 0
    assert capsys.readouterr().out.splitlines().count(line) == 1
    assert dry_run(scene, threads=1).splitlines().count(line) == 1
    assert main(["run", "small.toml", "--quiet", "--verbose"]) == 0
    assert capsys.readouterr().out.splitlines().count(line) == 1


def test_the_summary_of_points_without_a_scene_has_no_line():
    assert "method" not in summary(atlas.label_points("satellite", {"theta0": 0.3}, duration=1.0))
