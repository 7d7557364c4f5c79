"""Labels predicted by theory, and their agreement with the measured ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.ensemble import Ensemble
from ..engine.stepsize import StepSizes
from ..flags import Agreement, Label, Stability
from ..measure.circle import CIRCLES
from ..measure.instrument import Run, Tolerances
from ..measure.rates import steady_label
from ..scene.grid import Grid
from ..scene.model import Settings
from ..systems.base import (
    FAMILY_TOLERANCE,
    Array,
    Flags,
    Mask,
    Points,
    SharedValues,
    System,
    rate_std,
    shape_of,
    subset,
    unsteady,
)
from .offsets import describes, near_circle, off_family_labels
from .plan import Plan

MAX_LOG_GROWTH = 700.0  # exp of more overflows
# A start near an unstable motion departs by its nudge, not by integration errors, where theta' at half the
# step is the same within this share.
HALF_STEP_RTOL = 0.05
# Relative rounding error of an initial state: an unstable motion amplifies it.
ROUNDOFF = 1e-16
# The conditions of a steady motion are satisfied as well as rounding allows where their residual is at most this: of a
# larger distance from the motion, rounding errors change less than a hundredth.
ROUNDING_RESIDUAL = 1e-13


@dataclass(frozen=True)
class Prediction:
    """What theory predicts of a set of runs; arrays of shape (points,)."""

    # As `predict` returns them, but for the predicted labels of starts near a steady motion that are not on
    # it to rounding: these come from the linear equations, see `offsets`
    variables: Mapping[str, np.ndarray]
    residual: Array  # of the conditions of a steady motion, at the start that is integrated
    family_residual: Array  # of the conditions of the family, at the start before the nudge
    # As `residual`, of the conditions of a motion about any axes or in the plane where `log_growth` is about such a motion
    start_residual: Array
    # Whether `log_growth` is about a motion about other axes than the third and the vertical
    about_other_axes: Mask
    pushed: Mask  # whether a nudge moved the start off its motion
    # Growth of a distance from the motion over the run, as a logarithm; 0 where it is unknown
    log_growth: Array


def predict_runs(
    plan: Plan, tile: Grid, *, pause: Callable[[], None] = lambda: None, threads: int | None = None
) -> Prediction:
    """Predictions for the runs of a plan.

    A nudge along a family leads to another exact start. Where no labels about any axes are measured, a motion about other
    axes than the third and the vertical drifts, however it grows. pause, threads: see `offsets.off_family_labels`.
    """
    system, duration, base = plan.system, tile.duration, SharedValues(tile.base)
    points = SharedValues(tile.points)
    tolerances, nudged = plan.settings.tolerances, plan.nudged
    with np.errstate(all="ignore"):
        residual = system.condition_residual(points)
        nearby = residual <= FAMILY_TOLERANCE
        pushed = ~exact_starts(system, points, nearby) if nudged else np.zeros_like(nearby)
        family, family_residual = _identify(system, base)
        other = _about_other_axes(system, family)
        variables = predict(system, base, tolerances.rate, pushed, tolerances.angle, family, duration)
        off = ((family == 0) | other) & system.complete(base)
        if not nudged:
            off |= (family > 0) & (family_residual > ROUNDING_RESIDUAL)
        where = np.flatnonzero(off & system.within_range(base))
        if where.size and describes(system):
            # The linear equations decide the labels of these starts.
            near = subset(points, where)
            frames = _frame_rates(system, near)
            off_labels = off_family_labels(system, near, duration[where], tolerances, frames, pause, threads)
            for name, values in off_labels.items():
                variables[name][where] = values
        growth = system.log_growth(base, family, variables["growth_rate"], duration)
        # What drifts in any case drifts however it grows.
        growth[unsteady(system, family) & (variables["predicted"] == Label.DRIFTING)] = 0.0
        start_residual, varying = residual.copy(), np.flatnonzero(unsteady(system, family))
        start_residual[varying] = system.identify_family(subset(points, varying))[1]
        if CIRCLES[0] in plan.instruments:
            members = np.flatnonzero(other)
            start_residual[members] = system.identify_family(subset(points, members))[1]
            pushed[members] = nudged & (start_residual[members] > ROUNDING_RESIDUAL)
        else:
            growth, other = np.where(other, 0.0, growth), np.zeros_like(other)
    log_growth = np.minimum(np.nan_to_num(growth, nan=0.0), MAX_LOG_GROWTH)
    return Prediction(variables, residual, family_residual, start_residual, other, pushed, log_growth)


@dataclass(frozen=True)
class Theory:
    """What theory says of runs; arrays of shape (points,). Of systems without theory nothing grows."""

    prediction: Prediction
    rounding_growth: Array  # log_growth where the start is on the motion to rounding, else 0
    growth_about_vertical: (
        Array  # as a logarithm, of runs whose third axis never leaves the vertical by a bit
    )
    unstable: Mask  # whether the start is, to rounding, an unstable steady motion or one in the plane
    frame_rates: Mapping[str, Array]  # label variable -> rate added to psi', rad per time unit

    @classmethod
    def of(cls, plan: Plan, tile: Grid, ensemble: Ensemble, step_sizes: StepSizes, **options: Any) -> Theory:
        """Theory of the points of a plan; options: pause and threads of `predict_runs`."""
        system, zero = plan.system, np.zeros(ensemble.size)
        if not plan.main.has_theory:
            nothing = Prediction({}, zero, zero, zero, zero > 0, zero > 0, zero)
            return cls(nothing, zero, zero, zero > 0, {"label": zero})
        prediction = predict_runs(plan, tile, **options)
        # The growth of an offset in one step is rounded: where that is a per cent of it or more, rounding decides.
        growth_in_step = prediction.variables["growth_rate"] * step_sizes.step_size
        max_residual = np.fmax(ROUNDING_RESIDUAL, 100.0 * ROUNDOFF / growth_in_step)
        near = prediction.start_residual <= FAMILY_TOLERANCE
        exact = ~prediction.pushed if plan.nudged else near & (prediction.family_residual <= max_residual)
        on_motion = (prediction.family_residual <= ROUNDING_RESIDUAL) & (not plan.nudged)
        about_vertical = system.growth_about_vertical(tile.points) * tile.duration
        rates = _frame_rates(system, tile.points)
        return cls(
            prediction,
            np.where(exact, prediction.log_growth, 0.0),
            about_vertical,
            on_motion & (prediction.variables["stable"] == Stability.UNSTABLE),
            {name.replace("predicted", "label"): rate for name, rate in rates.items()},
        )

    def error_amplified(self, step_sizes: StepSizes, settings: Settings) -> Mask:
        """Whether an unstable motion amplifies the method's own error beyond the rate tolerance."""
        growth = np.where(self.prediction.pushed, 0.0, self.prediction.log_growth)
        amplified = step_sizes.rate_error * np.exp(growth) > settings.rate_tolerance
        return np.asarray(amplified & (growth > 0))

    def rounding(self, run: Run) -> tuple[Array, Array]:
        """Logarithms of the growth of rounding errors: in a run, and up to a tolerance."""
        # No tilt can grow where the third axis never left the vertical by a bit.
        on_vertical = run.measured.get("sine_max", np.ones(run.ensemble.size)) == 0.0
        least = np.fmin(self.rounding_growth, self.growth_about_vertical)
        growth = np.where(on_vertical, least, self.rounding_growth)
        return growth, rounding_limit(self.prediction.start_residual, run.bound, run.settings.tolerances)

    def departed(self, run: Run) -> Mask:
        """Which drifting motions may have left an unstable one by integration errors."""
        kinds = run.labels()
        kind = np.where(
            self.prediction.about_other_axes, kinds.get("label_any_axis", kinds["label"]), kinds["label"]
        )
        tilted = run.measured.get("sine_max", np.ones(run.ensemble.size)) > 0.0
        return tilted & self.error_amplified(run.step_sizes, run.settings) & (kind == Label.DRIFTING)


def departure_changes(run: Run, fine: Run) -> Mask | bool:
    """Whether a motion leaves an unstable one otherwise at half the step."""
    rms, fine_rms = (each.measured.get("theta_dot_rms", np.zeros(1)) for each in (run, fine))
    return np.asarray(np.abs(fine_rms - rms) > HALF_STEP_RTOL * fine_rms)


def predict(
    system: System,
    points: Points,
    rate_tolerance: float,
    nudged: Mask | bool,
    cylinder_tolerance: float | None = None,
    family: Flags | None = None,
    duration: Array | float = np.inf,
    rough: bool = False,
) -> dict[str, np.ndarray]:
    """Labels of starts, given before any nudge, from theory alone, with family, stable and growth_rate.

    A nudged start keeps the label of its family where the motion is linearly stable and drifts where it is
    unstable. Off every family `predicted` is drifting where the system's catalogue is complete, else
    not_computed. Rates of at most rate_tolerance, rad per time unit, count as zero, and a tilt below
    cylinder_tolerance, rad (default: the same number), as on the vertical. A family of motions of which the rate about the
    vertical varies during a run of this duration by more than rate_tolerance drifts. family: that of each start, if it is known;
    rough: whether growth_rate may have fewer digits.
    """
    if family is None:
        family, _ = _identify(system, points)
    angle = rate_tolerance if cylinder_tolerance is None else cylinder_tolerance
    stable, growth = (system.rough_stability if rough else system.linear_stability)(points, family)
    sine, n, m = system.steady_rates(points)
    result: dict[str, np.ndarray] = {"family": family, "stable": stable, "growth_rate": growth}
    on_family = (family > 0) & ~_about_other_axes(system, family)
    complete = system.complete(points) & system.within_range(points)
    drifts = rate_std(system, points, family, np.broadcast_to(duration, family.shape)) > rate_tolerance
    for name, frame_rate in _frame_rates(system, points).items():
        label = steady_label(n + frame_rate, m, np.abs(sine) < angle, rate_tolerance)
        label = _after_nudge(label, stable, nudged, on_family, complete)
        result[name] = np.where(drifts, np.int8(Label.DRIFTING), label)
    return result


def _identify(system: System, points: Points) -> tuple[Flags, Array]:
    """Family of each start and the residual of its conditions, as System.identify_family; none beyond its range."""
    family, residual = system.identify_family(points)
    return np.where(system.within_range(points), family, 0).astype(np.int8), residual


def _frame_rates(system: System, points: Points) -> dict[str, Array]:
    """Rate of each frame, which is added to psi', by the names of the predicted labels."""
    rates = {"predicted": np.zeros(shape_of(points))}
    if system.frame_rate is not None:
        rates["predicted_inertial"] = system.frame_rate(points)
    return rates


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
    cylinder_tolerance: float | None = None,
    duration: Array | float = np.inf,
) -> dict[str, np.ndarray]:
    """Labels about any axes of starts from theory alone, in the system's frame and, if that turns, in space.

    `base` and `points` are the starts before and after a nudge, which along a family leads to another exact
    start. Rates of at most rate_tolerance, rad per time unit, count as zero, and axes within
    cylinder_tolerance, rad (default: the same number), as parallel. Off every family labels are drifting
    where the system's catalogue of motions about any axes is complete and the start is far from all of them,
    else not_computed.
    """
    family, stable = theory["family"], theory["stable"]
    angle = rate_tolerance if cylinder_tolerance is None else cylinder_tolerance
    with np.errstate(all="ignore"):
        other = _about_other_axes(system, family)
        complete = system.complete_any_axis(base) & system.within_range(base)
        complete &= ~near_circle(system, points, duration, rate_tolerance)
        pushed = other & ~exact_starts(system, points, other) if nudged else False
        sine, n, m = system.any_axis_rates(base, family)
        result = {}
        for own, frame_rate in _frame_rates(system, base).items():
            rate = n + frame_rate
            # The angular velocity runs along an arc of m T on its circle; one that is as small as the tolerance is a point.
            spread = np.sqrt(1.0 - np.nan_to_num(np.sinc(m * duration / (2.0 * np.pi))) ** 2)
            constant = (sine < angle) | (np.abs(rate) * sine * spread <= rate_tolerance)
            label = steady_label(rate, m, constant, rate_tolerance)
            label = _after_nudge(label, stable, pushed, other, complete)
            # On and near a motion about the third axis and the vertical the label about these is that about any axes.
            steady = np.isin(theory[own], (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))
            kept = steady | ~other & ((family > 0) | (theory[own] != Label.DRIFTING))
            result[own.replace("predicted", "predicted_any_axis")] = np.where(kept, theory[own], label)
    return result


def exact_starts(system: System, points: Points, candidates: Mask) -> Mask:
    """Which candidates are on a steady motion of a family as exactly as rounding allows.

    A nudge along a family or a symmetry leads to such a start again.
    """
    exact = np.zeros(candidates.shape, bool)
    where = np.flatnonzero(candidates)
    if where.size:
        flag, residual = system.identify_family(subset(points, where))
        exact[where] = (flag > 0) & (residual <= ROUNDING_RESIDUAL)
    return exact


def rounding_limit(residual: Array, frequency_bound: Array, tolerances: Tolerances) -> Array:
    """Growth, as a logarithm, by which rounding errors reach a tolerance, by the residual of a steady start.

    Rounding errors of rates are relative to the frequency bound, errors of angles to 1.
    """
    tolerance = np.minimum(tolerances.rate / frequency_bound, tolerances.angle)
    return np.asarray(np.log(tolerance / np.fmax(residual, ROUNDOFF)))


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
