"""Sentences and sizes of a plan, before anything runs: by arithmetic."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from atlas import BadInput
from atlas.kernel import blocks
from atlas.kernel.tableaux import METHODS
from atlas.runs import estimate
from atlas.runs.plan import MAX_PREDICTED, ScenePlan, differences
from atlas.scene.model import MAX_STEPS
from atlas.scene.read import scene_from
from atlas.store.tiling import tile_types

ORBIT = 2 * np.pi


def plan_of(axes, integration=None, system="satellite", **sections):
    table = {"schema": 1, "title": "plan", "system": system, "axes": axes, "integration": integration or {}}
    if system == "satellite":
        sections.setdefault("fixed", {"C": 1.2})
    return ScenePlan.of(scene_from(table | sections))


def grid(**counts):
    """Axes from 0.5 to 1.5 with so many values."""
    return {name: {"from": 0.5, "to": 1.5, "count": count} for name, count in counts.items()}


@pytest.mark.parametrize(
    ("spins", "named"),
    [
        ([2e4, 2.1e4, 2.2e4, 2.3e4], "m from 2e+04 to 2.3e+04"),
        ([-2.3e4, -2.2e4, 2.2e4, 2.3e4], None),
        ([-9.9e3, 2e4, 2.1e4, 2.2e4], None),  # 31 900 of 31 900
        ([9e3, 2e4, 2.1e4, 2.2e4], None),  # 13 000 of 21 999 is more than half
        ([1.2e4, 2e4, 2.1e4, 2.2e4], "m from 1.2e+04 to 2.2e+04"),
    ],
)  # fmt: skip
def test_the_few_points_that_take_most_steps_are_named_by_narrow_axes(spins, named):
    """One per cent of the points; an axis is named where they take less than half of it."""
    values = [float(n) for n in range(1, 397)]
    (warning,) = plan_of({"m": {"values": sorted(values + spins)}}, {"duration": 5.0}).step_warnings()
    share, _, rest = warning.partition(" of the steps")
    number = float(share.removeprefix("1 % of the points take ").removesuffix(" %"))
    steps = plan_of({"m": {"values": sorted(values + spins)}}, {"duration": 5.0}).step_sizes.steps
    assert number == pytest.approx(100 * np.sort(steps)[-4:].sum() / steps.sum(), abs=0.51)
    assert rest == f"{f', {named}' if named else ''}; max_steps would cut them short"


def test_points_that_max_steps_cuts_short():
    """Of spins 1 to 4, whose steps grow with them, the last; a spin of 1e9 has steps too long."""
    plan = plan_of({"m": {"values": [1.0, 2.0, 3.0, 40.0]}}, {"duration": 5.0})
    steps = plan.step_sizes.steps
    assert plan.step_warnings() == []
    few = {"duration": 5.0, "max_steps": int(steps[2] + steps[3]) // 2}
    (warning,) = plan_of({"m": {"values": [1.0, 2.0, 3.0, 40.0]}}, few).step_warnings()
    assert warning.startswith(f"max_steps = {few['max_steps']} cuts short 25 % of the points")
    far = plan_of({"m": {"values": [1.0, 2.0, 3.0, 1e9]}}, {"duration": 5.0, "max_steps": 100_000})
    *_, warning = far.step_warnings()
    assert warning.startswith("25 % of the points have steps too long")
    assert plan.limited(7).max_steps == 7
    assert (plan.step_sizes_by(plan.limited(MAX_STEPS)).steps == steps).all()


def test_work_is_that_of_the_points_that_exist():
    """An impossible body among three does not count; indicators of chaos add their steps at 1.5 times the cost of rk8."""
    axes = {"C": {"values": [1.2, 0.9, 5.0]}, "m": {"values": [0.5, 30.0]}}
    plan = plan_of(axes, {"duration": 40.0}, fixed={})
    steps, exists = plan.step_sizes.steps, plan.sample.exists
    assert (exists.sum(), exists.size) == (4, 6)
    assert plan.mean_steps == pytest.approx(steps[exists].mean())
    assert (plan.mean_work, plan.has_chaos, plan.growth_work) == (plan.mean_steps, False, 0.0)
    wanted, work = {"outputs": {"variables": ["label", "megno"], "map": "megno"}}, {}
    for method in ("rk8", "rk4"):
        chaos = plan_of(axes, {"duration": 40.0, "method": method}, fixed={}, **wanted)
        assert chaos.has_chaos
        work[method] = chaos.mean_work - chaos.mean_steps
    bound = plan.scene.system.frequency_bound(plan.sample.points)[exists]
    assert 0.2 < 40.0 * bound.mean() / (work["rk8"] / 1.5) <= 0.3  # radians in a step of the tangent vector
    assert work["rk4"] / work["rk8"] == pytest.approx(METHODS["rk8"].step_cost / METHODS["rk4"].step_cost)


def test_tiles_follow_from_the_work():
    """5e8 steps of points, rounded to a power of two; at least 512 points, and three times the grid over all tiles."""
    plan = plan_of(grid(theta0=100, m=1000), {"duration": 5.0, "step": 1e-3})
    assert plan.mean_steps == pytest.approx(5000, rel=0.02)
    assert plan.tiling.tile == (50, 1000)  # 1e5 points would fit, a power of two of 65 536
    slow = plan_of(grid(theta0=100, m=1000), {"duration": 5.0, "step": 1e-5})
    assert slow.tiling.tile == (1, 1000)
    for threads, calls in ((1, None), (2, 2), (64, 2)):
        expected = (
            1 if calls is None else min(1 + math.ceil(threads / (50_000 * plan.mean_steps / blocks.CHUNK)), 2)
        )
        assert plan.tiles_in_flight(threads) == expected
    per_tile = 1000 * slow.mean_steps / blocks.CHUNK
    assert slow.tiles_in_flight(40) == 1 + math.ceil(40 / per_tile)
    short = plan_of(grid(theta0=100, m=1000), {"duration": 0.01, "step": 1e-3})
    assert short.tiles_in_flight(3) <= min(4, short.tiling.count)


@pytest.mark.parametrize(("orbits", "text"), [(60, "50 %"), (30, "100 %"), (79.9999, "50 %"), (80, None)])
def test_runs_that_are_too_short_to_show_chaos(orbits, text):
    """80 revolutions of the frame, at Omega = 1 and 2."""
    plan = plan_of(
        {"Omega": {"values": [1.0, 2.0]}}, {"duration": orbits * ORBIT}, outputs={"variables": ["label", "megno"], "map": "megno"},
    )  # fmt: skip
    if text is None:
        assert plan.chaos_warnings() == []
        return
    (warning,) = plan.chaos_warnings()
    assert f": {text} of the runs are too short" in warning
    assert f"a duration {80 / orbits:.3g} times as long" in warning
    assert warning in plan.warnings
    without = plan_of({"Omega": {"values": [1.0, 2.0]}}, {"duration": orbits * ORBIT})
    assert without.chaos_warnings() == []


def test_runs_of_a_top_that_are_too_short_to_show_chaos():
    """400 periods of the bound, where no frame turns."""
    outputs = {"variables": ["label", "megno"], "map": "megno"}
    axes, fixed = {"m": {"values": [2.0, 2.5]}}, {"Mg": 1.0, "z0": 0.5, "theta0": 1.0, "C": 0.8}
    bound = plan_of(axes, {"duration": 1.0}, "fixed_point", outputs=outputs, fixed=fixed)
    bound = bound.scene.system.frequency_bound(bound.sample.points)
    duration = 300 * ORBIT / bound.min()
    plan = plan_of(axes, {"duration": duration}, "fixed_point", outputs=outputs, fixed=fixed)
    (warning,) = plan.chaos_warnings()
    assert f"a duration {4 / 3:.3g} times as long" in warning


def test_a_sentence_on_what_ends_early():
    """By theory, of a sample of the points; or on the transient, in which nothing ends."""
    axes = {"theta_dot0": {"values": [0.0, 0.0625, 0.125, 0.25]}}
    fixed = {"A": 1.0, "B": 1.0, "C": 0.7, "Mg": 0.0, "theta0": 0.9, "m": 1.0, "n": 0.0}
    plan = plan_of(axes, {"duration": 20.0}, "fixed_point", fixed=fixed)
    (line,) = plan.statistics_lines()
    assert "without them the 75 % of the points that drift" in line
    labels = {"variables": ["label", "status"], "map": "label"}
    assert (
        plan_of(axes, {"duration": 20.0}, "fixed_point", fixed=fixed, outputs=labels).statistics_lines() == []
    )
    settling = plan_of(
        axes, {"duration": 15.0}, "fixed_point", fixed=fixed, outputs=labels, labels={"transient": 5.0}
    )
    (line,) = settling.statistics_lines()
    assert line.startswith("transient: 25 % of the time")
    assert MAX_PREDICTED >= 4


def test_other_methods_and_their_costs():
    plan = plan_of(grid(theta0=3), {"duration": 50.0, "tolerance": 1e-9, "method": "rk4"})
    steps = {
        method: plan_of(grid(theta0=3), {"duration": 50.0, "tolerance": 1e-9, "method": method}).step_sizes.steps.mean()
        for method in ("rk4", "rk8")
    }  # fmt: skip
    ratio = METHODS["rk8"].step_cost * steps["rk8"] / (METHODS["rk4"].step_cost * steps["rk4"])
    assert plan.relative_costs == pytest.approx({"rk8": ratio})
    (line,) = plan.method_lines()
    assert f"in about {ratio:.2g} of the time" in line
    assert plan_of(grid(theta0=3), {"duration": 50.0, "step": 0.01}).method_lines() == []


def test_differences_of_identities():
    expected, actual = {"a": 1, "b": 2, "c": 3}, {"a": 1, "b": 4, "d": 5}
    text = differences(expected, actual, "in the run", "here")
    assert text == "b (2 in the run, 4 here), c (3 in the run, nothing here), d (nothing in the run, 5 here)"
    assert differences(expected, expected, "", "") == ""


def test_twice_the_size_of_an_atlas_is_enough_without_a_measurement(monkeypatch, tmp_path):
    """What is free decides; else a measured tile says how well the points are compressed."""
    plan, free, measured = plan_of(grid(theta0=30, m=20)), SimpleNamespace(free=0), []
    size = sum(np.dtype(dtype).itemsize for dtype in tile_types(plan.scene).values()) * 600
    monkeypatch.setattr(estimate.shutil, "disk_usage", lambda folder: free)

    def measure(plan, threads):
        measured.append(threads)
        return SimpleNamespace(stored_bytes_per_point=100.0)

    monkeypatch.setattr(estimate, "_measure", measure)
    free.free = 2 * size + 1
    estimate.check_disk(plan, tmp_path, 300, is_joined=True)
    assert measured == []
    # Tiles to be joined are not compressed.
    needed = size // 2 + 100 * 600 + 1000 * plan.tiling.count
    assert needed < 2 * size
    free.free = needed
    estimate.check_disk(plan, tmp_path, 300, is_joined=True)
    assert measured == [1]
    free.free = needed - 1
    with pytest.raises(BadInput, match=r"needs about 0\.000105 GB more, and 0\.000104 GB are free"):
        estimate.check_disk(plan, tmp_path, 300, is_joined=True)
    estimate.check_disk(plan, tmp_path, 300, is_joined=False)
