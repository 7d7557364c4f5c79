"""Labels predicted by theory, and their agreement with the measured ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..flags import Agreement, Label, Stability
from ..kernel.ensemble import Ensemble
from ..kernel.stepsize import StepSettings, StepSizes
from ..measure import rates
from ..measure.circle import CIRCLES
from ..measure.instrument import Measured, Run, Tolerances, could_change
from ..scene.grid import Grid
from ..systems.base import (
    FAMILY_TOLERANCE,
    Array,
    Flags,
    Mask,
    Points,
    SharedValues,
    System,
    TwoAxes,
    families_of,
    motion_about_axes,
    rate_std,
    rough_stability,
    shape_of,
    subset,
    unsteady,
    within_range,
)
from ..systems.gyrostat.system import log_growth
from ..systems.jacobian import changes_volume
from ..systems.steady import condition_residual, growth_about_vertical, lacks_theory, polynomial_degree
from ..systems.vectors import length
from ..theory.motions import SteadyMotion, departures, steady_motions
from ..theory.steady import FAR, Existence
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
# Residual of a start about the third axis and the vertical beyond which it is on no family about these.
_NEARBY = 1e-6
# A nudged start keeps the label of a stable motion up to this change of its rates, in tolerances.
_KEPT = 1 / 3
# Instants at which exact motions about other axes are sampled, and the relative error of their statistics.
_SAMPLES, _SAMPLING_ERROR = 32, 0.5


@dataclass(frozen=True)
class Prediction:
    """What theory predicts of a set of runs; arrays of shape (points,)."""

    variables: Mapping[str, np.ndarray]  # as `predict` returns them
    motion: SteadyMotion | None  # of the start before the nudge; None where the equations do not decide
    residual: Array  # of the conditions of a steady motion, at the start that is integrated
    family_residual: Array  # of the conditions of the family, at the start before the nudge
    # As `residual`, of the conditions of a motion about any axes or in the plane where `log_growth` is about such a motion
    start_residual: Array
    # Whether `log_growth` is about a motion about other axes than the third and the vertical
    about_other_axes: Mask
    pushed: Mask  # whether a nudge moved the start off its motion
    # Growth of a distance from the motion until the end of the run, as a logarithm; 0 where it is unknown
    log_growth: Array
    may_settle: Mask  # whether a transient comes before the run, from a start that is no steady motion


def predict_runs(plan: Plan, tile: Grid) -> Prediction:
    """Predictions for the runs of a plan.

    A nudge along a family leads to another exact start. Where no labels about any axes are measured, a motion about other
    axes than the third and the vertical drifts, however it grows.
    """
    system, duration, until, base = plan.system, tile.duration, tile.until, SharedValues(tile.base)
    points = SharedValues(tile.points)
    tolerances, nudged = plan.settings.at(tile.rate_tolerance).tolerances, plan.nudged
    with np.errstate(all="ignore"):
        residual = condition_residual(system, points)
        motion = steady_motions_of(system, base, until, tolerances, plan.in_machine_code)
        family, family_residual = np.zeros(duration.shape, np.int8), np.full(duration.shape, np.inf)
        # A start that is far from every steady motion is on no family, unless it is on the vertical, as motions in the plane are.
        where = np.arange(duration.size)
        if motion is not None and not nudged:
            upright = np.abs(system.steady_rates(base)[0]) <= FAMILY_TOLERANCE
            where = np.flatnonzero((motion.answer != Existence.FAR) | (residual <= _NEARBY) | upright)
        part = base if where.size == duration.size else subset(base, where)
        family[where], family_residual[where] = _identify(system, part)
        other = on_other_axes(system, family)
        if motion is not None:
            in_plane = unsteady(system, family) & (nudged | (family_residual <= ROUNDING_RESIDUAL))
            motion.answer[in_plane] = Existence.EXACT  # no steady motion, but an exact one
        beside = nudged & (residual <= FAMILY_TOLERANCE)
        pushed = nudged & ~exact_starts(system, points, beside, plan.in_machine_code)
        variables = predict(system, base, tolerances, pushed, family, duration, motion=motion)
        if motion is not None and nudged:
            _take_away(system, base, points, until, tolerances, variables, plan.in_machine_code)
        growth = log_growth(system, base, family, variables["growth_rate"], until)
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
        if motion is not None and not nudged:
            # A distance that rounding of the equations hides, and that grows beyond the tolerances, decides nothing.
            is_exact = motion.answer == Existence.EXACT
            near = np.flatnonzero(is_exact & (start_residual > ROUNDING_RESIDUAL) & (growth > 0))
            bound = system.frequency_bound(subset(points, near))
            near = near[growth[near] > rounding_limit(start_residual[near], bound, tolerances.subset(near))]
            motion.answer[near] = Existence.NEAR
            for name in predicted_frames(system, base):
                variables[name][near] = Label.NOT_COMPUTED
        steady = family > 0 if motion is None else motion.answer == Existence.EXACT
        may_settle = (tile.transient > 0) & ~(steady & ~pushed)
        forget_drifting(system, variables, may_settle, system.constants(points), system.initial_state(points))
    growth = np.minimum(np.nan_to_num(growth, nan=0.0), MAX_LOG_GROWTH)
    return Prediction(
        variables, motion, residual, family_residual, start_residual, other, pushed, growth, may_settle
    )


def forget_drifting(
    system: System, labels: dict[str, np.ndarray], where: Mask, constants: Array, *states: Array
) -> None:
    """Take predictions of drifting from points where volumes of states change at one of these states: the motion may settle."""
    if where.any():
        changes = [changes_volume(system.equations, state, constants) for state in states]
        unknown = where & np.any(changes, axis=0)
        for name in labels:
            if name.startswith("predicted"):
                labels[name][unknown & (labels[name] == Label.DRIFTING)] = Label.NOT_COMPUTED


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
    unknown_growth: Mask  # whether only a missing extension could give the growth

    @classmethod
    def of(cls, plan: Plan, tile: Grid, ensemble: Ensemble, step_sizes: StepSizes) -> Theory:
        """Theory of the points of a plan."""
        system, zero = plan.system, np.zeros(ensemble.size)
        if not plan.main.has_theory:
            nothing = Prediction({}, None, zero, zero, zero, zero > 0, zero > 0, zero, zero > 0)
            return cls(nothing, zero, zero, zero > 0, {"label": zero}, zero > 0)
        prediction = predict_runs(plan, tile)
        # The growth of an offset in one step is rounded: where that is a per cent of it or more, rounding decides.
        growth_in_step = prediction.variables["growth_rate"] * step_sizes.step_size
        max_residual = np.fmin(
            np.fmax(ROUNDING_RESIDUAL, 100.0 * ROUNDOFF / growth_in_step), FAMILY_TOLERANCE
        )
        exact = ~prediction.pushed if plan.nudged else prediction.start_residual <= max_residual
        on_motion = (prediction.family_residual <= ROUNDING_RESIDUAL) & (not plan.nudged)
        about_vertical = growth_about_vertical(system, tile.points) * tile.until
        frames = predicted_frames(system, tile.points)
        return cls(
            prediction,
            np.where(exact, prediction.log_growth, 0.0),
            about_vertical,
            on_motion & (prediction.variables["stable"] == Stability.UNSTABLE),
            {name.replace("predicted", "label"): rate for name, rate in frames.items()},
            lacks_theory(system, tile.base) & (prediction.variables["family"] == 0) & (not plan.nudged),
        )

    def error_amplified(self, step_sizes: StepSizes, settings: StepSettings) -> Mask:
        """Whether an unstable motion amplifies the method's own error beyond the rate tolerance."""
        growth = np.where(self.prediction.pushed, 0.0, self.prediction.log_growth)
        amplified = step_sizes.rate_error * np.exp(growth) > settings.rate_tolerance
        return np.asarray(amplified & (growth > 0))

    def rounding(self, run: Run) -> tuple[Array, Array]:
        """Logarithms of the growth of rounding errors: in a run, and up to a tolerance."""
        # No tilt can grow where the third axis never left the vertical by a bit.
        sine = run.measured.get("sine_max", np.ones(run.ensemble.size))
        residual = self.prediction.start_residual
        least = np.fmin(self.rounding_growth, self.growth_about_vertical)
        growth = np.where(sine == 0.0, least, self.rounding_growth)
        measured = np.log(sine / np.fmax(residual, ROUNDOFF))  # of a tilt by as much as the residual
        growth = np.where(self.unknown_growth, measured, growth)
        return growth, rounding_limit(residual, run.bound, run.settings.tolerances)

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


def steady_motions_of(
    system: System, points: Points, duration: Array, tolerances: Tolerances, in_machine_code: bool = False
) -> SteadyMotion | None:
    """Whether each start is a steady motion by the equations of its system; None where these are no polynomials."""
    if isinstance(polynomial_degree(system), str):
        return None
    motion = steady_motions(system, points, duration, tolerances.rate, tolerances.angle, in_machine_code)
    decided = within_range(system, points) & (
        (motion.answer == Existence.EXACT) | ~lacks_theory(system, points)
    )
    return motion._replace(answer=np.where(decided, motion.answer, Existence.NEAR))


@np.errstate(all="ignore")
def predict(
    system: System,
    points: Points,
    tolerances: Tolerances,
    nudged: Mask | bool,
    family: Flags | None = None,
    duration: Array | float = np.inf,
    rough: bool = False,
    motion: SteadyMotion | None = None,
) -> dict[str, np.ndarray]:
    """Labels of starts, given before any nudge, from theory alone, with family, stable and growth_rate.

    A steady motion has the label of its exact statistics; nudged, it keeps it where it is linearly stable and drifts where it
    is unstable. family, motion: those of each start, if they are known; without the motion a start on no family has no prediction.
    rough: whether growth_rate may have fewer digits.
    """
    if family is None:
        family, _ = _identify(system, points)
    stable, growth = (
        rough_stability(system, points, family) if rough else system.linear_stability(points, family)
    )
    result: dict[str, np.ndarray] = {"family": family, "stable": stable, "growth_rate": growth}
    times = np.broadcast_to(duration, family.shape)
    if motion is None:
        exact, others = family > 0, np.flatnonzero(on_other_axes(system, family))
        otherwise = np.full(family.shape, Label.NOT_COMPUTED, np.int8)
    else:
        exact = motion.answer == Existence.EXACT
        others = np.flatnonzero(turns_elsewhere(system, points, motion))
        otherwise = np.where(motion.answer == Existence.FAR, Label.DRIFTING, Label.NOT_COMPUTED)
    sine, n, m = system.steady_rates(points)
    zero, theta = np.zeros(family.shape), np.arcsin(np.minimum(np.abs(sine), 1.0))
    measured = dict.fromkeys(("theta_dot_rms", "psi_dot_std", "phi_dot_std"), zero) | {
        "psi_dot_mean": n, "phi_dot_mean": m, "normal_rate_std": rate_std(system, points, family, times),
        "theta_min": theta, "theta_max": theta, "sine_max": np.abs(sine),
    }  # fmt: skip
    if motion is not None and others.size:
        sampled, error = _statistics(
            system, subset(points, others), motion.axes.subset(others), times[others], tolerances.angle
        )
    for name, frame_rate in predicted_frames(system, points).items():
        label = rates.rule(tolerances, frame_rate).label(measured)
        label[others] = Label.DRIFTING
        if motion is not None and others.size:
            rule = rates.rule(tolerances.subset(others), frame_rate[others])
            uncertain = could_change(rule, sampled, error)
            label[others] = np.where(uncertain, Label.NOT_COMPUTED, rule.label(sampled))
        result[name] = np.where(exact, after_nudge(label, stable, nudged), otherwise)
    return result


def turns_elsewhere(system: System, points: Points, motion: SteadyMotion) -> Mask:
    """Whether a start is a steady motion about other axes than the third and the vertical."""
    others = (motion.axes.spin_axis[2] != 1.0) | (
        motion.axes.fixed_axis != frame_motion(system, points)[1]
    ).any(0)
    return others & (motion.answer == Existence.EXACT)


def frame_motion(system: System, points: Points) -> tuple[Array, Array]:
    """The angular velocity in the frame and the frame's vertical at the start, in body axes, (3, points)."""
    motion = system.equations.frame_motion(system.initial_state(points), system.constants(points))
    return np.array(motion[:3]), np.array(motion[3:])


def _statistics(
    system: System, points: Points, axes: TwoAxes, duration: Array, cylinder: float
) -> tuple[Measured, Measured]:
    """Measurements of exact motions from which labels are decided, from samples, and their errors."""
    # Multiples of the golden section, which are even and resonate with no period.
    times = (np.arange(1, _SAMPLES + 1) * (np.sqrt(5) - 1) / 2 % 1)[:, None] * duration
    u, g = motion_about_axes(axes, frame_motion(system, points)[1], times)
    sine = np.hypot(g[0], g[1])
    theta, psi_dot = np.arctan2(sine, g[2]), (u[0] * g[0] + u[1] * g[1]) / sine**2
    rms = np.sqrt((((g[0] * u[1] - g[1] * u[0]) / sine) ** 2).mean(0))
    varying = {"psi_dot": psi_dot, "phi_dot": u[2] - psi_dot * g[2], "normal_rate": (u * g).sum(0)}
    values = {f"{name}_mean": (rate.mean(0), rate.std(0)) for name, rate in varying.items()}
    values |= {f"{name}_std": (rate.std(0), rate.std(0)) for name, rate in varying.items()}
    values |= {"theta_dot_rms": (rms, rms), "sine_max": (sine.max(0), np.ptp(sine, axis=0))}
    outside = (sine >= cylinder).mean(0)
    values |= {"outside": (outside, outside * (1.0 - outside))}
    swing = np.ptp(theta, axis=0)
    values |= {"theta_min": (theta.min(0), swing), "theta_max": (theta.max(0), swing)}
    measured = {name: value for name, (value, _) in values.items()}
    return measured, {name: _SAMPLING_ERROR * spread for name, (_, spread) in values.items()}


def _identify(system: System, points: Points) -> tuple[Flags, Array]:
    """Family of each start and the residual of its conditions, as System.identify_family; none beyond its range."""
    family, residual = system.identify_family(points)
    return np.where(within_range(system, points), family, 0).astype(np.int8), residual


def predicted_frames(system: System, points: Points) -> dict[str, Array]:
    """Rate of each frame, which is added to psi', by the names of the predicted labels."""
    frames = {"predicted": np.zeros(shape_of(points))}
    if system.frame_rate is not None:
        frames["predicted_inertial"] = system.frame_rate(points)
    return frames


def on_other_axes(system: System, family: Flags) -> Mask:
    """Whether a family's motion is about other axes than the third and the vertical."""
    return np.isin(family, [f.flag for f in families_of(system).values() if f.axes is not None])


def after_nudge(label: Flags, stable: Flags, nudged: Mask | bool) -> Flags:
    """Predicted label of a steady motion that is nudged or not, see `predict`."""
    kept = np.logical_not(nudged) | (stable == Stability.STABLE) | (label == Label.DRIFTING)
    moved = np.where(stable == Stability.UNSTABLE, Label.DRIFTING, Label.NOT_COMPUTED)
    return np.where(kept, label, moved).astype(np.int8)


def _take_away(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    tolerances: Tolerances,
    theory: Mapping[str, np.ndarray],
    in_machine_code: bool,
) -> None:
    """Take labels away from starts that a nudge from base moves further than the tolerances allow, (points,).

    The departure from a steady motion to first order is the least change of the rates; the oscillation may be some times as large,
    that of psi' by 1 / sin(theta). Inside the cone the tilt is no measure of it, but the change of the angular velocity.
    """
    names = predicted_frames(system, points)
    steady = np.any([theory[name] != Label.DRIFTING for name in names], axis=0)
    where = np.flatnonzero(steady & ~unsteady(system, theory["family"]) & within_range(system, points))
    part, tolerances = subset(points, where), tolerances.subset(where)
    (u, vertical), (before, _) = frame_motion(system, part), frame_motion(system, subset(base, where))
    moved = departures(system, part, duration[where], tolerances.rate, tolerances.angle, in_machine_code)
    sine = np.hypot(*vertical[:2])
    change = np.where(sine < tolerances.angle, length(u - before) / tolerances.rate, moved / sine)
    for label in (theory[name] for name in names):
        label[where[(change > _KEPT) & (label[where] != Label.DRIFTING)]] = Label.NOT_COMPUTED
        label[where[moved > FAR]] = Label.DRIFTING


def exact_starts(system: System, points: Points, candidates: Mask, in_machine_code: bool = False) -> Mask:
    """Which candidates are on a steady motion as exactly as rounding allows.

    A nudge along a family or a symmetry leads to such a start again.
    """
    exact = np.zeros(candidates.shape, bool)
    where = np.flatnonzero(candidates)
    if where.size:
        part = subset(points, where)
        anything = Tolerances(np.inf, np.inf)
        motion = steady_motions_of(system, part, np.ones(where.size), anything, in_machine_code)
        if motion is None:
            flag, residual = system.identify_family(part)
            exact[where] = (flag > 0) & (residual <= ROUNDING_RESIDUAL)
        else:
            exact[where] = motion.answer == Existence.EXACT
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
