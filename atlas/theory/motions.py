"""The steady motions that many starts are: the test of `steady` in a loop, arrays in and out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..systems.base import Array, Flags, Points, System, TwoAxes, shape_of
from .compiled import of_system
from .generated import load_constants, load_state
from .steady import departure, motion_about_third, start_on_axis, steady_motion


class SteadyMotion(NamedTuple):
    """The steady motion that each start is, or would be."""

    axes: TwoAxes  # relative to the frame; the third axis and the vertical where it is none
    answer: Flags  # values of Existence


def steady_motions(
    system: System,
    points: Points,
    duration: Array | float,
    rate_tolerance: Array | float,
    angle_tolerance: float,
    in_machine_code: bool = False,
) -> SteadyMotion:
    """Whether each start is a steady motion about any axes, or drifts about the third axis and the vertical; see Existence.

    Of a system of a `polynomial_degree`. Inside a cone of angle_tolerance about the vertical, rad, only the tilt and the rate about
    the vertical count.
    """
    starts = _Starts.of(system, points, duration, rate_tolerance)
    axes, answer = np.empty((8, starts.bound.size)), np.empty(starts.bound.size, np.int8)
    of_system(find_motions, system, in_machine_code)(*starts, angle_tolerance, axes, answer)
    return SteadyMotion(TwoAxes(axes[0:3], axes[3], axes[4:7], axes[7]), answer)


def departures(
    system: System,
    points: Points,
    duration: Array | float,
    rate_tolerance: Array | float,
    angle_tolerance: float,
    in_machine_code: bool = False,
) -> Array:
    """How far each start is from a steady motion about the third axis and the vertical, in tolerances of labels."""
    starts = _Starts.of(system, points, duration, rate_tolerance)
    change = np.empty(starts.bound.size)
    of_system(find_departures, system, in_machine_code)(*starts, angle_tolerance, change)
    return change


class _Starts(NamedTuple):
    """What the loops read of starts."""

    states: Array  # (states, points)
    constants: Array  # (constants, points)
    rates: Array  # of System.steady_rates, (3, points)
    bound: Array
    duration: Array
    rate_tolerance: Array

    @classmethod
    @np.errstate(all="ignore")
    def of(
        cls, system: System, points: Points, duration: Array | float, rate_tolerance: Array | float
    ) -> _Starts:
        columns = (system.frequency_bound(points), duration, rate_tolerance)
        blocks = (system.initial_state(points), system.constants(points), system.steady_rates(points))
        one = np.ones(shape_of(points))
        return cls(
            *(np.array([row * one for row in block]) for block in blocks),
            *(column * one for column in columns),
        )


def find_motions(states, constants, rates, bound, duration, rate_tolerance, angle_tolerance, axes, answer):
    """Rows of axes: s, m, nu, n."""
    for i in range(bound.size):
        w, vectors = load_state(states, i)
        of_axes = rates[0, i], rates[1, i], rates[2, i]
        answer[i], motion = steady_motion(
            w, vectors, load_constants(constants, i), of_axes, bound[i], duration[i], rate_tolerance[i], angle_tolerance
        )  # fmt: skip
        for k in range(3):
            axes[k, i], axes[4 + k, i] = motion.s[k], motion.nu[k]
        axes[3, i], axes[7, i] = motion.m, motion.n


def find_departures(states, constants, rates, bound, duration, rate_tolerance, angle_tolerance, change):
    """Values of `departure`."""
    for i in range(bound.size):
        w, vectors = load_state(states, i)
        body, of_axes = load_constants(constants, i), (rates[0, i], rates[1, i], rates[2, i])
        start = start_on_axis(w, vectors, body, of_axes)
        motion = motion_about_third(start, of_axes)
        change[i] = departure(start, body, motion, bound[i], duration[i], rate_tolerance[i], angle_tolerance)
