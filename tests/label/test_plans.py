"""Plans of integrations, and warnings about points, without a run."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import default_points

from atlas import BadInput
from atlas.kernel.specialization import GENERIC
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.label.plan import Plan, method_lines
from atlas.label.points import warnings_of
from atlas.scene import grid
from atlas.scene.model import Duration, Settings
from atlas.systems import SYSTEMS
from atlas.theory.compiled import FEW_POINTS
from atlas.variables import default_variables

TOP, SATELLITE = SYSTEMS["fixed_point"], SYSTEMS["satellite"]


def plan_of(*outputs, system=SATELLITE, **settings):
    return Plan(system, Settings(**settings), outputs or None)


@pytest.mark.parametrize(
    ("outputs", "early"),
    [
        (("label", "status"), True), (("label", "psi_dot_mean"), False), (("label", "theta_max"), False), ((), False),
        (("label", "label_any_axis"), False), (("label", "megno"), True), (("predicted", "step"), True),
    ],
)  # fmt: skip
def test_runs_that_may_stop_early(outputs, early):
    """Without statistics and without sums of other instruments."""
    assert plan_of(*outputs).may_stop_early == early


def test_the_plan_without_statistics():
    """Where it lets runs stop early, and they do not yet: of all variables, and of labels with a statistic."""
    less = plan_of("label", "psi_dot_mean", "status").without_statistics
    assert less.outputs == ["label", "status"]
    assert plan_of("label", "status").without_statistics is None
    assert plan_of("label_any_axis", "psi_dot_mean").without_statistics is None
    every = plan_of().without_statistics
    assert "psi_dot_mean" not in every.outputs
    assert set(every.outputs) < set(default_variables(SATELLITE))


def test_instruments_of_a_plan():
    assert [each.name for each in plan_of("label_any_axis").plugs] == ["label_any_axis"]
    both = plan_of("label_any_axis", "label_any_axis_inertial")
    assert [each.name for each in both.plugs] == ["label_any_axis", "label_any_axis_inertial"]
    assert [each.name for each in plan_of("label_any_axis_inertial").plugs] == [
        "label_any_axis", "label_any_axis_inertial"
    ]  # fmt: skip
    for outputs, chaos in ((("label", "megno"), True), (("label",), False)):
        plan = plan_of(*outputs)
        assert (plan.plugs, plan.has_chaos, plan.has_tangent, plan.needs_growth) == ((), chaos, chaos, False)
        assert plan.instruments[0] == plan.main
    ends = plan_of("label", "end_equilibrium")
    assert (ends.has_chaos, ends.needs_growth, ends.has_tangent) == (False, True, True)
    assert plan_of().names == ()


def test_parts_of_a_plan():
    plan = plan_of("label", "frequency_1", prove=True)
    assert plan.without_derived().outputs == ["label"]
    assert not plan.without_prove().settings.prove
    assert plan_of().without_derived().outputs is None
    for size, compiled in ((1, False), (FEW_POINTS, False), (FEW_POINTS + 1, True)):
        of_points = Plan.of_points(SATELLITE, Settings(), None, ["m"], size)
        assert of_points.in_machine_code == compiled
    assert of_points.specialization != GENERIC
    every = Plan.of_points(SATELLITE, Settings(), None, SATELLITE.parameters)
    assert every.specialization == GENERIC


def test_costs_of_other_methods():
    """Steps times the cost of a step, over those of the plan; none of a given step, whose errors would differ."""
    points = default_points("satellite", 3, m=[0.5, 3.0, 9.0])
    tile = grid.of_points(SATELLITE, Settings(), points, np.full(3, 40.0), Duration(0.0))
    bound = SATELLITE.frequency_bound(points)
    for method, other in (("rk4", "rk8"), ("rk8", "rk4")):
        settings = Settings(method=method, tolerance=1e-7)
        (name, cost), *_ = plan_of(method=method, tolerance=1e-7).relative_costs(bound, tile).items()
        work = {
            each: METHODS[each].step_cost * StepSizes.of(replace(settings, method=each).at(1e-5), bound, tile.duration).steps.mean()
            for each in METHODS
        }  # fmt: skip
        assert name == other
        assert cost == pytest.approx(work[other] / work[method], rel=1e-6)
    assert plan_of(step=0.01).relative_costs(bound, tile) == {}
    lines = method_lines("rk4", {"rk8": 0.25, "other": 3.0})
    assert lines[0].endswith("in about 0.25 of the time at the same tolerance")
    assert lines[1].endswith("in about 3 times the time at the same tolerance")


def warned(system, duration=None, outputs=("label",), **given):
    name = system.name
    size = max(np.size(value) for value in given.values())
    points = default_points(name, size, **given)
    amount = duration or Duration(10.0)
    return warnings_of(
        system, outputs, grid.of_points(system, Settings(), points, amount, Duration(0.0)), amount
    )


def test_warnings_about_points():
    """Points that are not computed are counted; none of them is an error."""
    assert warned(SATELLITE, C=1.2, m=[0.5, 1.0]) == []
    (line,) = warned(SATELLITE, C=[1.2, 5.0, 6.0], m=0.5)
    assert line.startswith("2 ")
    with pytest.raises(BadInput):
        warned(SATELLITE, C=[5.0, 6.0])
    with pytest.raises(BadInput, match="give a number of time units"):
        warned(TOP, Duration(5.0, "turns"), n=0.0, m=[0.0])
