"""Apply the theory of one start to many starts, in loops whose arguments and results are arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..systems.base import Array, Flags, Mask, Points, System, TwoAxes, shape_of, within_range
from ..systems.gyrostat.system import Gyrostat
from ..systems.steady import lacks_theory, polynomial_degree
from .compiled import FEW_POINTS, of_system
from .generated import load_constants, load_state
from .point import Body, Membership, StartLabels, SteadyTest
from .prediction import find, predict, predict_circle, residual_of


class Starts(NamedTuple):
    """Arrays of the numbers in `Body`. The last index of an array counts the starts of a run."""

    states: Array  # (states, points)
    constants: Array  # (constants, points)
    rates: Array  # (3, points)
    bound: Array
    square: Array
    in_range: Mask

    @classmethod
    @np.errstate(all="ignore")
    def of(cls, system: System, points: Points) -> Starts:
        bound, one = system.frequency_bound(points), np.ones(shape_of(points))
        square = system.squared_unit(points) if isinstance(system, Gyrostat) else bound**2
        states, constants, rates = (
            np.array([row * one for row in block])
            for block in (system.initial_state(points), system.constants(points), system.steady_rates(points))
        )
        return cls(states, constants, rates, bound * one, square * one, within_range(system, points))


def find_motions(
    system: System,
    base: Points,
    points: Points | None,
    duration: Array | float,
    rate_tolerance: Array | float,
    angle_tolerance: float,
    in_machine_code: bool = False,
) -> tuple[TwoAxes, SteadyTest]:
    """Return the steady motion of each start, or else the motion about the third axis and the vertical, and a `SteadyTest`.

    The points before a nudge are `base`, and `points` are after the nudge, or None without a nudge. Where the third axis is within
    `angle_tolerance` (rad) of the vertical, `departure` and `changes` apply other tests. The system needs a `polynomial_degree`.
    """
    before = Starts.of(system, base)
    after, one = before if points is None else Starts.of(system, points), np.ones_like(before.bound)
    settings = duration * one, rate_tolerance * one, angle_tolerance, points is not None
    axes = np.empty((8, one.size))
    flags, numbers = np.empty((4, one.size), bool), np.empty((3, one.size))
    test = SteadyTest(np.empty(one.size, np.int8), *flags, *numbers)
    find_all = of_system(find_starts, system, in_machine_code)
    find_all(before, after, *settings, lacks_theory(system, base), axes, test)
    return TwoAxes(axes[0:3], axes[3], axes[4:7], axes[7]), test


def find_starts(before, after, duration, rate_tolerance, angle_tolerance, nudged, lacking, axes, columns):
    """Write motions into the rows s, m, nu, n of `axes`, and tests into `columns`."""
    for i in range(duration.size):
        body, other = body_at(before, i), body_at(after, i)
        motion, test = find(body, other, duration[i], rate_tolerance[i], angle_tolerance, nudged, lacking[i])
        for k in range(3):
            axes[k, i], axes[4 + k, i] = motion.s[k], motion.nu[k]
        axes[3, i], axes[7, i] = motion.m, motion.n
        columns.answer[i], columns.elsewhere[i] = test.answer, test.elsewhere
        columns.may_be_member[i] = test.may_be_member
        columns.kept[i], columns.pushed[i] = test.kept, test.pushed
        columns.residual[i], columns.change[i], columns.away[i] = test.residual, test.change, test.away


def body_at(starts, i):
    w, vectors = load_state(starts.states, i)
    rates = starts.rates[0, i], starts.rates[1, i], starts.rates[2, i]
    return Body(
        w, vectors, load_constants(starts.constants, i), rates, starts.bound[i], starts.square[i], starts.in_range[i]
    )  # fmt: skip


@np.errstate(all="ignore")
def condition_residual(system: System, points: Points) -> Array:
    """Return the dimensionless residual of a steady motion about the third axis and the vertical at each start, (points,).

    If the theorem does not apply, the residual of the families is returned, or nan if the system has no families.
    """
    if isinstance(polynomial_degree(system), str):
        return system.identify_family(points)[1] if system.families else np.full(shape_of(points), np.nan)
    starts = Starts.of(system, points)
    residual = np.empty(starts.bound.size)
    of_system(find_residuals, system, residual.size > FEW_POINTS)(starts, residual)
    return residual


def find_residuals(starts, residual):
    for i in range(residual.size):
        residual[i] = residual_of(body_at(starts, i))


def predict_labels(
    system: System,
    test: SteadyTest,
    membership: Membership,
    exact: tuple[Flags, Flags],
    bound: Array,
    rate_tolerance: Array | float,
    angle_tolerance: float,
    nudged: bool,
    in_machine_code: bool = False,
) -> StartLabels:
    """Return labels predicted for starts, given labels `exact` of exact motions in the system's frame and in inertial space."""
    one = np.ones_like(test.residual)
    label, inertial, answer = np.empty((3, one.size), np.int8)
    result = StartLabels(label, inertial, answer, np.empty(one.size))
    by_equations = isinstance(polynomial_degree(system), int)
    settings = bound * one, rate_tolerance * one, angle_tolerance, nudged, by_equations
    of_system(predict_starts, system, in_machine_code)(test, membership, *exact, *settings, result)
    return result


def predict_starts(
    test, membership, exact, inertial, bound, rate_tolerance, angle_tolerance, nudged, by_equations, result
):
    for i in range(bound.size):
        of_family = Membership(
            membership.varies[i], membership.elsewhere[i], membership.residual[i], membership.nudged_residual[i], membership.stable[i], membership.growth[i]
        )  # fmt: skip
        settings = bound[i], rate_tolerance[i], angle_tolerance, nudged, by_equations
        prediction = predict(steady_test_at(test, i), of_family, exact[i], inertial[i], *settings)
        result.label[i], result.inertial[i], result.answer[i], result.growth[i] = prediction


def steady_test_at(test, i):
    return SteadyTest(
        test.answer[i], test.elsewhere[i], test.may_be_member[i], test.kept[i], test.pushed[i],
        test.residual[i], test.change[i], test.away[i],
    )  # fmt: skip


def predict_circles(
    system: System,
    test: SteadyTest,
    own: Flags,
    exact: Flags,
    answer: Flags,
    stable: Flags,
    near: Mask,
    in_range: Mask,
    nudged: bool,
    in_machine_code: bool = False,
) -> Flags:
    """Return the labels that `predict_circle` predicts for motions about any axes."""
    labels = np.empty(own.shape, np.int8)
    label_all = of_system(label_circles, system, in_machine_code)
    label_all(test, own, exact, answer, stable, near, in_range, nudged, labels)
    return labels


def label_circles(test, own, exact, answer, stable, near, in_range, nudged, labels):
    for i in range(own.size):
        of_start = own[i], exact[i], answer[i], stable[i], near[i], in_range[i]
        labels[i] = predict_circle(steady_test_at(test, i), *of_start, nudged)
