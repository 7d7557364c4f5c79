"""The dry run: what it integrates to measure is little, whatever the scene."""

import re
from dataclasses import replace

import numpy as np
import pytest

import atlas
from atlas import BadInput, load_scene
from atlas.kernel import blocks
from atlas.label.pipeline import evaluate
from atlas.measure import tangent_runs
from atlas.runs import estimate, memory
from atlas.runs.estimate import CALIBRATION_STEPS, dry_run
from atlas.runs.plan import ScenePlan
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.systems.base import derived_values

FEW_LONG = {"theta0": {"from": 0.1, "to": 1.5, "count": 3}}
MANY_LONG = {"theta0": {"from": 0.1, "to": 1.5, "count": 40}, "m": {"from": 1.0, "to": 300.0, "count": 40}}
MANY_POINTS = {
    "theta0": {"from": 0.1, "to": 1.5, "count": 1000},
    "k3": {"from": 0.0, "to": 1.0, "count": 1000},
}


def no_values(plan, points, **options):
    """Zeros in place of all variables."""
    return {name: np.zeros(points.exists.size) for name in plan.outputs}


@pytest.mark.parametrize("axes", [FEW_LONG, MANY_LONG, MANY_POINTS])
@pytest.mark.parametrize(
    "integration",
    [
        {"duration": 1e5},
        {"duration": 2e4, "max_steps": 3_000_000},
        {"duration": 1e3, "step": 1e-7},
        {"duration": 1e12, "tolerance": 1e-12},
    ],
)
def test_a_dry_run_is_short_whatever_the_scene(monkeypatch, axes, integration):
    """At most twice the intended point-steps (counts of steps are rounded up) for one point, one tile, and some whole runs."""
    scene = scene_from(
        {"schema": 1, "title": "long", "system": "satellite", "fixed": {"C": 1.2}, "axes": axes, "integration": integration}
    )  # fmt: skip
    measured = []

    def evaluate_nothing(plan, points, *, threads):
        sizes = ScenePlan(replace(scene, settings=plan.settings), points).step_sizes.without_unresolved()
        measured.append(blocks.schedule_of(sizes).point_steps)
        assert points.exists.size <= grid.MAX_POINTS_PER_TILE
        return no_values(plan, points)

    monkeypatch.setattr(estimate, "evaluate", evaluate_nothing)
    monkeypatch.setattr(estimate, "predict_runs", lambda plan, points: None)
    text = dry_run(scene, threads=2)
    assert f"{scene.size} points" in text
    assert len(measured) in (2, 3)
    assert 0 < max(measured) <= 2 * 2 * CALIBRATION_STEPS


def test_the_share_of_points_that_are_not_resolved_is_printed(monkeypatch):
    scene = scene_from(
        {
            "schema": 1, "title": "spins", "system": "satellite", "fixed": {"C": 1.2},
            "axes": {"theta0": {"values": [0.3]}, "m": {"values": [1.0, 1.1, 1.2, 1e9]}},
            "integration": {"duration": 30.0, "max_steps": 100_000},
        }
    )  # fmt: skip
    monkeypatch.setattr(estimate, "evaluate", no_values)
    assert "25 % of the points have steps too long" in dry_run(scene, threads=1)


@pytest.mark.long
def test_ends_are_priced_with_their_tangent_vectors(monkeypatch):
    """By the steps that a run takes with them, if every point settles; without ends there are none."""
    table = {
        "schema": 1, "title": "ends", "system": "satellite", "fixed": {"C": 1.2, "damping": 0.2}, "axes": FEW_LONG,
        "integration": {"duration": 50.0, "method": "rk4", "tolerance": 1e-8},
    }  # fmt: skip
    assert ScenePlan.of(scene_from(table)).growth_work == 0
    ends = {"outputs": {"variables": ["label", "end_equilibrium"], "map": "end_equilibrium"}}
    plan, runs, of = ScenePlan.of(scene_from(table | ends)), [], tangent_runs.TangentRuns.of

    def noted(*arguments, **options):
        runs.append(of(*arguments, **options))
        return runs[-1]

    monkeypatch.setattr(tangent_runs.TangentRuns, "of", noted)
    evaluate(plan.runs, plan.sample)
    (run,) = runs
    # The share of these runs in all work is w / (1 + w), w of the work of the runs with statistics.
    assert plan.growth_work / (plan.mean_work + plan.growth_work) == pytest.approx(run.share)


def test_numba_num_threads_limits_the_threads(monkeypatch):
    monkeypatch.setattr(blocks.os, "sched_getaffinity", lambda pid: range(8), raising=False)
    for text, threads in {"3": 3, "20": 8, "0": 1, "": 8, "all": 8}.items():
        monkeypatch.setenv("NUMBA_NUM_THREADS", text)
        assert blocks.available_threads() == threads


def test_the_few_points_that_take_most_steps_are_named():
    axes = {"theta0": {"from": 0.1, "to": 1.5, "count": 4}, "m": {"values": [*range(1, 100), 20_000]}}
    table = {"schema": 1, "title": "spins", "system": "satellite", "fixed": {"C": 1.2}, "axes": axes}
    table["integration"] = {"duration": 5.0}
    (warning,) = ScenePlan.of(scene_from(table)).step_warnings()
    assert warning.startswith("1 % of the points take 94 % of the steps, m from 2e+04 to 2e+04;")
    axes["m"] = {"from": 1.0, "to": 100.0, "count": 100}
    assert ScenePlan.of(scene_from(table)).step_warnings() == []


def test_derived_variables_are_priced_by_some_points(monkeypatch):
    scene = scene_from(
        {
            "schema": 1, "title": "oscillations", "system": "satellite", "axes": MANY_LONG,
            "integration": {"duration": 1.0}, "outputs": {"variables": ["label", "energy_stable"]},
        }
    )  # fmt: skip
    sizes = []

    def values(system, names, points, duration, pause):
        sizes.append(duration.size)
        assert names == scene.outputs
        return derived_values(system, names, points, duration, pause)

    monkeypatch.setattr(estimate, "derived_values", values)
    monkeypatch.setattr(estimate, "evaluate", lambda plan, points, **options: check_outputs(plan, points))

    def check_outputs(plan, points):
        assert plan.outputs == ("label",)
        return no_values(plan, points)

    assert "of which theory" in dry_run(scene, threads=1)
    assert sizes[0] == 6
    assert max(sizes) <= scene.size


@pytest.mark.long
def test_a_long_run_says_so_first(monkeypatch, caplog, small_scene):
    monkeypatch.setattr(memory, "LONG", 1e-6)
    monkeypatch.setattr(estimate, "LONG", 1e-6)
    scene = load_scene(small_scene.replace("from = 0.2\nto = 1.4", "from = 0.2\nto = 9.0"))
    atlas.run(scene, threads=1, progress=False)
    first, *others = [record.getMessage() for record in caplog.records]
    assert re.fullmatch(
        r"this run takes about \S+ h on 1 threads for 63 points; atlas run SCENE --dry-run shows .*", first
    )
    assert others  # the warnings about the angles
    caplog.clear()
    monkeypatch.setattr(estimate, "LONG", 7200.0)
    atlas.run(scene, threads=1, progress=False)
    assert "this run takes" not in caplog.text


def test_a_short_run_measures_nothing(monkeypatch, small_scene):
    monkeypatch.setattr(estimate, "long_run", None)
    atlas.run(load_scene(small_scene), threads=1, progress=False)


@pytest.mark.long
def test_a_count_that_is_a_typo_costs_seconds(monkeypatch, caplog, tmp_path, small_scene):
    text = small_scene.replace("count = 9", "count = 100_000").replace("count = 7", "count = 100_000")
    with pytest.raises(
        BadInput, match=r"^1e\+10 points: the atlas has \S+ GB, this machine \S+ GB of memory; name a file"
    ):
        atlas.run(load_scene(text), progress=False)
    options = {"threads": 2, "shard": (1, 10), "scheduler": None, "workers": None}
    memory.Execution.of(load_scene(text), (), options)
    assert re.match(r"this run takes about \S+ h on 2 threads for 1e\+09 points", caplog.messages[0])
