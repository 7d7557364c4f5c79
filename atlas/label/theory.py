"""Labels predicted by theory, and their agreement with the measured ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..flags import Agreement, Label, Stability
from ..scene.model import Tolerances
from ..systems.base import FAMILY_TOLERANCE, Array, Flags, Mask, Points, System, subset
from .labels import ROUNDING_RESIDUAL, steady_label
from .offsets import MAX_RESIDUAL, describes, off_family_labels

# Predicted label about any axes -> about the third axis and the vertical.
THIRD_AXIS = {"predicted_any_axis": "predicted", "predicted_any_axis_inertial": "predicted_inertial"}
MAX_LOG_GROWTH = 700.0  # exp of more overflows


@dataclass(frozen=True)
class Prediction:
    """What theory predicts of a set of runs; arrays of shape (points,).

    Attributes
    ----------
    variables : mapping of str to ndarray
        As `predict` returns them, but for the predicted labels of starts that are off every family and near one: these
        come from the linear equations, see `offsets`.
    residual : ndarray of float64
        Of the conditions of a steady motion, at the start that is integrated.
    start_residual : ndarray of float64
        The same, of the conditions of a motion about any axes where `log_growth` is about such a motion.
    about_other_axes : ndarray of bool
        Whether `log_growth` is about a motion about other axes than the third and the vertical.
    pushed : ndarray of bool
        Whether a nudge moved the start off its motion.
    log_growth : ndarray of float64
        Growth of a distance from the motion over the run, as a logarithm; 0 where it is unknown.
    """

    variables: Mapping[str, np.ndarray]
    residual: Array
    start_residual: Array
    about_other_axes: Mask
    pushed: Mask
    log_growth: Array


def predict_runs(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    tolerances: Tolerances,
    *,
    nudged: bool,
    any_axis: bool = False,
    pause: Callable[[], None] = lambda: None,
    threads: int | None = None,
) -> Prediction:
    """Predictions for runs of some length.

    Parameters
    ----------
    system : System
    base, points : mapping of str to ndarray of float64, shape (points,)
        The starts before and after the nudge.
    duration : ndarray of float64, shape (points,)
        In time units.
    tolerances : Tolerances
        Of labels.
    nudged : bool
        Whether there is a nudge. One along a family leads to another exact start.
    any_axis : bool
        Whether labels about any axes are measured. Without them a motion about other axes than the third and the
        vertical drifts, however it grows.
    pause, threads
        See `offsets.off_family_labels`.
    """
    with np.errstate(all="ignore"):
        residual = system.condition_residual(points)
        nearby = residual <= FAMILY_TOLERANCE
        pushed = ~exact_starts(system, points, nearby) if nudged else np.zeros_like(nearby)
        variables = predict(system, base, tolerances.rate, pushed)
        variables |= _near_families(
            system, base, points, residual, variables, duration, tolerances, pause, threads
        )
        growth = system.log_growth(base, variables["family"], variables["growth_rate"], duration)
        other = _about_other_axes(system, variables["family"])
        start_residual = residual.copy()
        if any_axis:
            members = np.flatnonzero(other)
            start_residual[members] = system.identify_family(subset(points, members))[1]
            pushed[members] = nudged & (start_residual[members] > ROUNDING_RESIDUAL)
        else:
            growth, other = np.where(other, 0.0, growth), np.zeros_like(other)
    log_growth = np.minimum(np.nan_to_num(growth, nan=0.0), MAX_LOG_GROWTH)
    return Prediction(variables, residual, start_residual, other, pushed, log_growth)


def _near_families(
    system: System,
    base: Points,
    points: Points,
    residual: Array,
    theory: Mapping[str, np.ndarray],
    duration: Array,
    tolerances: Tolerances,
    pause: Callable[[], None],
    threads: int | None,
) -> dict[str, np.ndarray]:
    """Predicted labels where starts that are off every family may be near one, from the linear equations."""
    if not describes(system):
        return {}
    off = (theory["family"] == 0) | _about_other_axes(system, theory["family"])
    off &= system.complete(base) & system.within_range(base)
    where = np.flatnonzero(off & (residual <= MAX_RESIDUAL))
    frames = {"predicted": np.zeros(where.size)}
    if not where.size:
        return {}
    if system.frame_rate is not None:
        frames["predicted_inertial"] = system.frame_rate(base)[where]
    near = subset(points, where)
    labels = off_family_labels(system, near, duration[where], tolerances, frames, pause, threads)
    predicted = {name: theory[name].copy() for name in frames}
    for name, values in labels.items():
        predicted[name][where] = values
    return predicted


def predict(
    system: System, points: Points, rate_tolerance: float, nudged: Mask | bool
) -> dict[str, np.ndarray]:
    """Labels of a set of starts from theory alone.

    Parameters
    ----------
    system : System
    points : mapping of str to ndarray of float64, shape (points,)
        The starts before any nudge.
    rate_tolerance : float
        Rates of at most this count as zero, rad per time unit.
    nudged : ndarray of bool or bool
        Whether a nudge moved the start off its motion. It is then predicted to keep the label of its family where the
        motion is linearly stable and to drift where it is unstable.

    Returns
    -------
    dict of ndarray, shape (points,)
        family, stable, growth_rate, predicted and, where the system's frame turns, predicted_inertial. Off every family
        `predicted` is drifting where the system's catalogue is complete, else not_computed.
    """
    within = system.within_range(points)
    family = np.where(within, system.identify_family(points)[0], 0).astype(np.int8)
    stable, growth = system.linear_stability(points, family)
    sine, n, m = system.steady_rates(points)
    result: dict[str, np.ndarray] = {"family": family, "stable": stable, "growth_rate": growth}
    frames = {"predicted": n}
    if system.frame_rate is not None:
        frames["predicted_inertial"] = n + system.frame_rate(points)
    for name, rate in frames.items():
        label = steady_label(rate, m, np.abs(sine) <= FAMILY_TOLERANCE, rate_tolerance)
        on_family = (family > 0) & ~_about_other_axes(system, family)
        result[name] = _after_nudge(label, stable, nudged, on_family, system.complete(points) & within)
    return result


def _about_other_axes(system: System, family: Flags) -> Mask:
    """Whether a motion is about other axes than the third and the vertical."""
    return np.isin(family, [f.flag for f in system.families.values() if f.axes is not None])


def _after_nudge(label: Flags, stable: Flags, nudged: Mask | bool, on_family: Mask, complete: Mask) -> Flags:
    """Predicted labels: of a nudged motion, and off every family, see `predict`."""
    label = np.select(
        [np.logical_not(nudged) | (stable == Stability.STABLE), stable == Stability.UNSTABLE],
        [label, Label.DRIFTING],
        Label.NOT_COMPUTED,
    )
    return np.where(on_family, label, np.where(complete, Label.DRIFTING, Label.NOT_COMPUTED)).astype(np.int8)


def predict_any_axis(
    system: System,
    base: Points,
    points: Points,
    theory: Mapping[str, np.ndarray],
    rate_tolerance: float,
    *,
    nudged: bool,
) -> dict[str, np.ndarray]:
    """Labels about any axes of a set of starts from theory alone.

    Parameters
    ----------
    system : System
    base, points : mapping of str to ndarray of float64, shape (points,)
        The starts before and after the nudge.
    theory : mapping of str to ndarray
        family, stable and the predicted labels, as `Prediction.variables`.
    rate_tolerance : float
        Rates of at most this count as zero, rad per time unit.
    nudged : bool
        Whether there is a nudge. One along a family leads to another exact start.

    Returns
    -------
    dict of ndarray, shape (points,)
        predicted_any_axis and, where the system's frame turns, predicted_any_axis_inertial. Off every family they are
        drifting where the system's catalogue of motions about any axes is complete, else not_computed.
    """
    family, stable = theory["family"], theory["stable"]
    with np.errstate(all="ignore"):
        other = _about_other_axes(system, family)
        complete = system.complete_any_axis(base) & system.within_range(base)
        pushed = np.zeros(family.shape, bool)
        if nudged:
            pushed = ~exact_starts(system, points, np.ones(family.shape, bool))
        sine, n, m = system.any_axis_rates(base, family)
        frames = {"predicted_any_axis": n}
        if system.frame_rate is not None:
            frames["predicted_any_axis_inertial"] = n + system.frame_rate(base)
        result = {}
        for name, rate in frames.items():
            # A circle of the angular velocity that is as small as the tolerance is a point.
            constant = (sine <= FAMILY_TOLERANCE) | (other & (np.abs(rate) * sine <= rate_tolerance))
            label = steady_label(rate, m, constant, rate_tolerance)
            label = _after_nudge(label, stable, pushed, family > 0, complete)
            # Near a family about the third axis and the vertical the label about these is that about any axes.
            near = (family == 0) & (theory[THIRD_AXIS[name]] != Label.DRIFTING)
            result[name] = np.where(near, theory[THIRD_AXIS[name]], label).astype(np.int8)
    return result


def exact_starts(
    system: System, points: Points, candidates: Mask, max_residual: Array | float = ROUNDING_RESIDUAL
) -> Mask:
    """Which of the candidates are on a steady motion of a family as exactly as rounding allows, (points,).

    A nudge along a family or a symmetry leads to such a start again. max_residual: residual of the conditions of the
    family up to which a start is exact.
    """
    exact = np.zeros(candidates.shape, bool)
    where = np.flatnonzero(candidates)
    if where.size:
        flag, residual = system.identify_family(subset(points, where))
        exact[where] = (flag > 0) & (residual <= np.broadcast_to(max_residual, candidates.shape)[where])
    return exact


def agreement(label: Flags, predicted: Flags) -> Flags:
    """Value of flags.Agreement for each point."""
    unknown = (predicted == Label.NOT_COMPUTED) | (label == Label.NOT_COMPUTED) | (label == Label.UNRESOLVED)
    conditions = {
        Agreement.NOT_COMPARED: unknown,
        Agreement.AGREE: label == predicted,
        Agreement.THEORY_ONLY: label == Label.DRIFTING,
        Agreement.NUMERICS_ONLY: predicted == Label.DRIFTING,
    }
    return np.select(list(conditions.values()), list(conditions), Agreement.DIFFER).astype(np.int8)
