"""Labels of motions about any axes, predicted by theory alone."""

from __future__ import annotations

import numpy as np

from ..flags import Label
from ..measure.circle import label as circle_label
from ..scene.grid import Grid
from ..systems.base import FAMILY_TOLERANCE, Array, Mask, Points, System, TwoAxes, within_range
from ..systems.jacobian import derivatives
from ..systems.steady import TERM_ROUNDING
from ..systems.vectors import cross, length
from ..theory.motions import predict_circles
from .plan import Plan
from .theory import Prediction, frame_motion, on_other_axes, predicted_frames

# Where no steady motion is near, the angular velocity changes by more than this number of rate tolerances, see `near_circle`.
_FAR_CIRCLE = 10.0


@np.errstate(all="ignore")
def predict_any_axis(plan: Plan, tile: Grid, prediction: Prediction) -> dict[str, np.ndarray]:
    """Predict labels of motions about any axes in the system's frame and, if the frame turns, in inertial space.

    Axes within the angle tolerance count as parallel. If the start is no steady motion, the label is drifting. But the label is
    not_computed if the angular velocity may stay on a circle in the body (see `near_circle`).
    """
    system, base, theory = plan.system, tile.base, prediction.variables
    frames = predicted_frames(system, base)
    names = {own: own.replace("predicted", "predicted_any_axis") for own in frames}
    if prediction.motion is None:
        membership = (theory["family"] > 0) & ~on_other_axes(system, theory["family"])
        return {name: np.where(membership, theory[own], 0).astype(np.int8) for own, name in names.items()}
    tolerances, duration = plan.settings.at(tile.rate_tolerance).tolerances, tile.duration
    # The rounding error of the equations, divided by the rate across the spin axis, is an error of the spin rate.
    s, m, fixed, n = prediction.motion
    across, error = np.abs(n) * length(cross(s, fixed)), TERM_ROUNDING * (np.abs(n) + np.abs(m)) ** 2
    rounded = (m != 0) & (across > tolerances.rate) & (error > tolerances.rate * across)
    in_range, result = within_range(system, base), {}
    for own, frame_rate in frames.items():
        circle = _circle(system, base, prediction.motion, frame_rate, duration)
        exact = circle_label(circle, theory[own], tolerances)
        exact = np.where(np.isnan(circle["spin"]) | rounded, Label.NOT_COMPUTED, exact).astype(np.int8)
        near = near_circle(system, tile.points, duration, tolerances.rate, frame_rate)
        columns = theory[own], exact, prediction.answer, theory["stable"], near, in_range
        result[names[own]] = predict_circles(
            system, prediction.test, *columns, plan.nudged, plan.in_machine_code
        )
    return result


def _circle(
    system: System, points: Points, axes: TwoAxes, frame_rate: Array, duration: Array
) -> dict[str, Array]:
    """Return statistics of the angular velocity of exact motions in a frame that turns about the vertical at `frame_rate`.

    Rates are nan if the frame turns and the precession is not about the vertical, because the motion then has three rotations.
    """
    s, m, fixed, n = axes
    vertical = frame_motion(system, points)[1]
    # If the rate m or n is 0, the motion counts as a rotation about a body axis. The axis fixed in the frame is then arbitrary.
    single, turning = (n == 0) | (m == 0), frame_rate != 0
    s, m = np.where((n != 0) & single, fixed, s), np.where((n != 0) & single, n, m)
    n = np.where(single, 0.0, n)
    about_vertical = single | (length(fixed - vertical) <= FAMILY_TOLERANCE)
    rate = np.where(turning & ~about_vertical, np.nan, n + frame_rate)
    sine = length(cross(s, np.where(turning & single, vertical, fixed)))
    zero, spin = np.zeros_like(rate), np.where(np.isnan(rate), np.nan, m)
    # In the duration T the angular velocity covers an arc of the angle m T. `arc` is the standard deviation of such an arc of radius 1.
    arc = np.sqrt(1.0 - np.nan_to_num(np.sinc(m * duration / (2.0 * np.pi))) ** 2)
    return {
        "spread": np.abs(rate) * sine * arc, "height_std": zero, "radius_std": zero, "spin_std": zero,
        "spin": spin, "precession": np.abs(rate), "sine": sine,
    }  # fmt: skip


def near_circle(
    system: System, points: Points, duration: Array, rate_tolerance: Array | float, frame_rate: Array
) -> Mask:
    """Return whether the angular velocity may stay on a circle in the body. Steady motions about any axes require a circle.

    No linear theory covers these motions. Let v be the derivative of the angular velocity. On a circle v.v' = 0 and
    v'' = -(|v'| / |v|)^2 v. A start is far from every circle if two changes exceed _FAR_CIRCLE rate tolerances within the time
    1 / (frequency bound). One is the change of the angular velocity. The other is the distance of the angular velocity from a circle.
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
