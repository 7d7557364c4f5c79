"""Labels about any axes from theory alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..flags import Label, Stability
from ..measure.circle import label as circle_label
from ..measure.instrument import Tolerances
from ..systems.base import FAMILY_TOLERANCE, Array, Mask, Points, System, TwoAxes, within_range
from ..systems.jacobian import derivatives
from ..systems.steady import ROUNDING
from ..systems.vectors import cross, length
from ..theory.motions import SteadyMotion
from ..theory.steady import Existence
from .theory import (
    after_nudge,
    exact_starts,
    frame_motion,
    on_other_axes,
    predicted_frames,
    steady_motions_of,
    turns_elsewhere,
)

# Rates that change at first by more tolerances than this leave every circle.
_FAR_CIRCLE = 10.0


def predict_any_axis(
    system: System,
    base: Points,
    points: Points,
    theory: Mapping[str, np.ndarray],
    tolerances: Tolerances,
    *,
    nudged: bool,
    duration: Array | float = np.inf,
    motion: SteadyMotion | None = None,
    in_machine_code: bool = False,
) -> dict[str, np.ndarray]:
    """Labels about any axes of starts from theory alone, in the system's frame and, if that turns, in space.

    `base` and `points` are the starts before and after a nudge, which along a family leads to another exact
    start. Axes within the tolerance of angles count as parallel. Labels of starts that are no steady motion are drifting
    where they are far from every circle of the angular velocity, else not_computed. motion: that of `base`, if it is known.
    """
    names = {own: own.replace("predicted", "predicted_any_axis") for own in predicted_frames(system, base)}
    times = np.broadcast_to(np.asarray(duration, float), theory["family"].shape)
    with np.errstate(all="ignore"):
        motion = motion or steady_motions_of(system, base, times, tolerances, in_machine_code)
        if motion is None:
            known = (theory["family"] > 0) & ~on_other_axes(system, theory["family"])
            return {name: np.where(known, theory[own], 0).astype(np.int8) for own, name in names.items()}
        elsewhere = turns_elsewhere(system, base, motion)
        pushed = elsewhere & ~exact_starts(system, points, elsewhere, in_machine_code) if nudged else False
        # Beside a stable motion about the third axis a nudge may lead to one about other axes.
        beside = elsewhere | (theory["stable"] != Stability.STABLE) if nudged else True
        decided = ((motion.answer == Existence.EXACT) & beside) | ~within_range(system, base)
        # What rounding allows of the equations is an error of the spin rate, over the rate across its axis.
        s, m, fixed, n = motion.axes
        across, error = np.abs(n) * length(cross(s, fixed)), ROUNDING * (np.abs(n) + np.abs(m)) ** 2
        rounded = (m != 0) & (across > tolerances.rate) & (error > tolerances.rate * across)
        result = {}
        for own, frame_rate in predicted_frames(system, base).items():
            circle = _circle(system, base, motion.axes, frame_rate, times)
            label = circle_label(circle, theory[own], tolerances)
            label[np.isnan(circle["spin"]) | rounded] = Label.NOT_COMPUTED
            label = np.where(elsewhere, after_nudge(label, theory["stable"], pushed), theory[own])
            close = (
                ~decided
                & (label == Label.DRIFTING)
                & near_circle(system, points, times, tolerances.rate, frame_rate)
            )
            result[names[own]] = np.where(close, Label.NOT_COMPUTED, label)
    return result


def _circle(
    system: System, points: Points, axes: TwoAxes, frame_rate: Array, duration: Array
) -> dict[str, Array]:
    """Statistics of the angular velocity of exact motions in a frame that turns at a rate about the vertical.

    In a turning frame the axes must be that of the body and the vertical: a motion with a third rate has none, nan.
    """
    s, m, fixed, n = axes
    vertical = frame_motion(system, points)[1]
    # One rotation is about an axis at rest in the body, so that the fixed axis is any, such as the vertical.
    single, turning = (n == 0) | (m == 0), frame_rate != 0
    s, m = np.where((n != 0) & single, fixed, s), np.where((n != 0) & single, n, m)
    n = np.where(single, 0.0, n)
    about_vertical = single | (length(fixed - vertical) <= FAMILY_TOLERANCE)
    rate = np.where(turning & ~about_vertical, np.nan, n + frame_rate)
    sine = length(cross(s, np.where(turning & single, vertical, fixed)))
    zero, spin = np.zeros_like(rate), np.where(np.isnan(rate), np.nan, m)
    # The angular velocity runs along an arc of m T on its circle; one that is as small as the tolerance is a point.
    arc = np.sqrt(1.0 - np.nan_to_num(np.sinc(m * duration / (2.0 * np.pi))) ** 2)
    return {
        "spread": np.abs(rate) * sine * arc, "height_std": zero, "radius_std": zero, "spin_std": zero,
        "spin": spin, "precession": np.abs(rate), "sine": sine,
    }  # fmt: skip


def near_circle(
    system: System, points: Points, duration: Array, rate_tolerance: Array | float, frame_rate: Array
) -> Mask:
    """Whether the angular velocity of a start may stay on a circle in the body, as it does along steady motions about any axes.

    These have no linear theory. A start is far from all of them where in a radian of the bound the angular velocity changes by
    more than it is allowed to, and deviates as much from the circle of its first derivatives: there v.v' = 0 and
    v'' = -(|v'| / |v|)^2 v for v, the derivative of the angular velocity.
    """
    bound, place = system.frequency_bound(points), system.equations.STATE.index
    state, constants = system.initial_state(points), system.constants(points)
    values = derivatives(system.equations, state, constants, bound)
    v, first, second = values[1:, [place(name) for name in system.rate_states]]
    if system.frame_rate is not None:
        vertical = values[1:, [place(name) for name in system.equations.FRAME_VECTORS[-1]]]
        turn = system.frame_rate(points) - frame_rate
        v, first, second = v - turn * vertical[0], first - turn * vertical[1], second - turn * vertical[2]
    time, size = np.fmin(1.0, bound * duration), length(v)
    change = size * time + length(first) * time**2 / 2
    speed = np.abs((v * first).sum(0)) / size * time**2 / 2
    bend = length(second + (length(first) / size) ** 2 * v) * time**3 / 6
    return np.asarray(~(np.fmin(change, np.fmax(speed, bend)) > _FAR_CIRCLE * rate_tolerance))
