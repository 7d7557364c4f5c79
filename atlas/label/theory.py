"""Labels that theory predicts, and their agreement with measured labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..flags import Agreement, Label, Stability
from ..kernel.ensemble import Ensemble
from ..kernel.stepsize import ROUNDING, StepSettings, StepSizes
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
from ..systems.steady import growth_about_vertical, lacks_theory, polynomial_degree
from ..theory.motions import condition_residual, find_motions, predict_labels
from ..theory.point import Membership, SteadyTest
from ..theory.prediction import ROUNDING_RESIDUAL, rounding_limit
from ..theory.steady import Existence
from .plan import Plan

MAX_LOG_GROWTH = 700.0  # exp of a larger number overflows
# If halving the step changes the rms of theta' by more than this fraction, integration errors decide how the run leaves an unstable motion.
HALF_STEP_RTOL = 0.05
# `_statistics` samples a motion at _SAMPLES times. The error of a statistic is _SAMPLING_ERROR times the spread of the samples.
_SAMPLES, _SAMPLING_ERROR = 32, 0.5


@dataclass(frozen=True)
class Prediction:
    """Predictions of theory for a set of runs. Arrays have shape (points,)."""

    variables: Mapping[str, np.ndarray]  # predicted labels, family, stable and growth_rate
    motion: TwoAxes | None  # axes and rates of the motion without a nudge, or None if families alone predict
    test: SteadyTest
    answer: Flags  # values of `Existence` that `predict_labels` returns
    family_residual: Array  # residual of the family's conditions at the start without a nudge
    # Residual, at the start of the run, of the conditions of the steady motion to which `log_growth` belongs.
    start_residual: Array
    # Whether the motion is about axes other than the third and the vertical, and the plan measures labels of such motions.
    about_other_axes: Mask
    pushed: Mask  # whether a nudge moved the start off the steady motion
    # Logarithm of the factor by which a distance from the motion grows until the end of the run, 0 where the factor is unknown.
    log_growth: Array
    may_settle: Mask  # whether the run begins after a transient from a start that is no steady motion


@np.errstate(all="ignore")
def predict_runs(plan: Plan, tile: Grid) -> Prediction:
    """Predict labels and growth for the runs of a plan by the rules of `theory.prediction`.

    A motion about axes other than the third and the vertical has a `log_growth` only if labels of such motions are measured,
    because the other labels call the motion drifting anyway.
    """
    system, duration, until, base = plan.system, tile.duration, tile.until, SharedValues(tile.base)
    points, nudged = SharedValues(tile.points) if plan.nudged else base, plan.nudged
    tolerances, compiled = plan.settings.at(tile.rate_tolerance).tolerances, plan.in_machine_code
    motion, test, family, family_residual = _tests_and_families(
        system, base, points, until, tolerances, nudged, compiled
    )
    stable, growth_rate = system.linear_stability(base, family)
    varies, elsewhere = unsteady(system, family), on_other_axes(system, family)
    members, nudged_residual = np.flatnonzero(varies | elsewhere), family_residual.copy()
    if nudged and members.size:
        nudged_residual[members] = system.identify_family(subset(points, members))[1]
    growth = log_growth(system, base, family, growth_rate, until)
    membership = Membership(varies, elsewhere, family_residual, nudged_residual, stable, growth)
    frames = predicted_frames(system, base)
    exact = exact_labels(system, base, family, motion, test.elsewhere, duration, tolerances)
    own = exact["predicted"]
    inertial = exact.get("predicted_inertial", own)
    settings = system.frequency_bound(points), tolerances.rate, tolerances.angle, nudged, compiled
    predicted = predict_labels(system, test, membership, (own, inertial), *settings)
    about_other_axes = elsewhere & (CIRCLES[0] in plan.instruments)
    log_growths = np.minimum(np.where(elsewhere & ~about_other_axes, 0.0, predicted.growth), MAX_LOG_GROWTH)
    start_residual = np.where(varies | about_other_axes, nudged_residual, test.residual)
    pushed = np.where(about_other_axes, nudged & (nudged_residual > ROUNDING_RESIDUAL), test.pushed)
    may_settle = (tile.transient > 0) & ~((predicted.answer == Existence.EXACT) & ~pushed)
    labels = dict(zip(frames, (predicted.label, predicted.inertial), strict=False))
    forget_drifting(system, labels, may_settle, system.constants(points), system.initial_state(points))
    variables: dict[str, np.ndarray] = {
        "family": family,
        "stable": stable,
        "growth_rate": growth_rate,
        **labels,
    }
    return Prediction(
        variables, motion, test, predicted.answer, family_residual, start_residual, about_other_axes, pushed, log_growths, may_settle
    )  # fmt: skip


def _tests_and_families(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    tolerances: Tolerances,
    nudged: bool,
    in_machine_code: bool,
) -> tuple[TwoAxes | None, SteadyTest, Flags, Array]:
    """Return steady motions, tests of the starts, families of the starts, and residuals of the families' conditions.

    The motions and the tests come from the equations. Families decide instead if `polynomial_degree` refuses the system. The motions
    are then None, a start on a family is exact, and other starts have no label.
    """
    size = duration.size
    family, residual = np.zeros(size, np.int8), np.full(size, np.inf)
    if isinstance(polynomial_degree(system), str):
        family, residual = _identify(system, base)
        after = condition_residual(system, points)
        kept = (system.identify_family(points)[0] > 0) & (after <= ROUNDING_RESIDUAL)
        answer = np.where(family > 0, Existence.EXACT, Existence.NEAR).astype(np.int8)
        zero, pushed = np.zeros(size), nudged & ~kept
        test = SteadyTest(answer, on_other_axes(system, family), family > 0, kept, pushed, after, zero, zero)
        return None, test, family, residual
    motion, test = find_motions(
        system, base, points if nudged else None, duration, tolerances.rate, tolerances.angle, in_machine_code
    )
    where = np.flatnonzero(test.may_be_member)
    part = base if where.size == size else subset(base, where)
    family[where], residual[where] = _identify(system, part)
    return motion, test, family, residual


def forget_drifting(
    system: System, labels: dict[str, np.ndarray], where: Mask, constants: Array, *states: Array
) -> None:
    """Remove predictions of drifting where the flow changes phase volume at any of `states`, because the motion may settle there."""
    if where.any():
        changes = [changes_volume(system.equations, state, constants) for state in states]
        unknown = where & np.any(changes, axis=0)
        for name in labels:
            if name.startswith("predicted"):
                labels[name][unknown & (labels[name] == Label.DRIFTING)] = Label.NOT_COMPUTED


@dataclass(frozen=True)
class Theory:
    """Theory of a set of runs. Arrays have shape (points,), and growth is 0 for systems without theory."""

    prediction: Prediction
    rounding_growth: Array  # log_growth where the start is exact to within rounding, else 0
    growth_about_vertical: Array  # log_growth of the angle about the third axis while the axis is vertical
    unstable: Mask  # whether the start lies, to within rounding, on an unstable exact motion
    frame_rates: Mapping[str, Array]  # label variable -> rate added to psi', rad per time unit
    unknown_growth: Mask  # whether the growth is unknown because the family's extension is not installed

    @classmethod
    def of(cls, plan: Plan, tile: Grid, ensemble: Ensemble, step_sizes: StepSizes) -> Theory:
        """Compute the theory of the points of a plan."""
        system, zero = plan.system, np.zeros(ensemble.size)
        if not plan.main.has_theory:
            no, none = zero > 0, zero.astype(np.int8)
            test = SteadyTest(none, no, no, no, no, zero, zero, zero)
            nothing = Prediction({}, None, test, none, zero, zero, no, no, zero, no)
            return cls(nothing, zero, zero, zero > 0, {"label": zero}, zero > 0)
        prediction = predict_runs(plan, tile)
        # A start counts as exact if its offset grows in one step by at most a hundred rounding errors.
        growth_in_step = prediction.variables["growth_rate"] * step_sizes.step_size
        max_residual = np.fmin(
            np.fmax(ROUNDING_RESIDUAL, 100.0 * ROUNDING / growth_in_step), FAMILY_TOLERANCE
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
        """Whether an unstable motion amplifies the error of the method beyond the rate tolerance."""
        growth = np.where(self.prediction.pushed, 0.0, self.prediction.log_growth)
        amplified = step_sizes.rate_error * np.exp(growth) > settings.rate_tolerance
        return np.asarray(amplified & (growth > 0))

    def rounding(self, run: Run) -> tuple[Array, Array]:
        """Return the logarithm of the growth of rounding errors in a run, and the logarithm at which the errors reach a tolerance."""
        # A third axis that stays exactly on the vertical has no tilt that could grow.
        sine = run.measured.get("sine_max", np.ones(run.ensemble.size))
        residual = self.prediction.start_residual
        least = np.fmin(self.rounding_growth, self.growth_about_vertical)
        growth = np.where(sine == 0.0, least, self.rounding_growth)
        measured = np.log(sine / np.fmax(residual, ROUNDING))  # logarithm of growth from residual to tilt
        growth = np.where(self.unknown_growth, measured, growth)
        tolerances = run.settings.tolerances
        return growth, rounding_limit(residual, run.bound, tolerances.rate, tolerances.angle)

    def departed(self, run: Run) -> Mask:
        """Whether a run drifts and may have left an unstable motion because of integration errors."""
        kinds = run.labels()
        kind = np.where(
            self.prediction.about_other_axes, kinds.get("label_any_axis", kinds["label"]), kinds["label"]
        )
        tilted = run.measured.get("sine_max", np.ones(run.ensemble.size)) > 0.0
        return tilted & self.error_amplified(run.step_sizes, run.settings) & (kind == Label.DRIFTING)


def departure_changes(run: Run, fine: Run) -> Mask | bool:
    """Whether halving the step changes how a run leaves an unstable motion."""
    rms, fine_rms = (each.measured.get("theta_dot_rms", np.zeros(1)) for each in (run, fine))
    return np.asarray(np.abs(fine_rms - rms) > HALF_STEP_RTOL * fine_rms)


@np.errstate(all="ignore")
def predict(
    system: System,
    points: Points,
    tolerances: Tolerances,
    duration: Array | float = np.inf,
    rough: bool = False,
) -> dict[str, np.ndarray]:
    """Predict labels, family, stable and growth_rate at starts exactly as given, by families of steady motions alone.

    If `rough` is true, growth_rate may have fewer digits.
    """
    family, _ = _identify(system, points)
    stable, growth = (
        rough_stability(system, points, family) if rough else system.linear_stability(points, family)
    )
    others, times = on_other_axes(system, family), np.broadcast_to(duration, family.shape)
    exact = exact_labels(system, points, family, None, others, times, tolerances)
    labels = {name: np.where(family > 0, label, Label.NOT_COMPUTED) for name, label in exact.items()}
    return {"family": family, "stable": stable, "growth_rate": growth, **labels}


def exact_labels(
    system: System,
    points: Points,
    family: Flags,
    motion: TwoAxes | None,
    elsewhere: Mask,
    duration: Array,
    tolerances: Tolerances,
) -> dict[str, Flags]:
    """Return the labels that follow from the statistics of exact motions.

    Where `elsewhere` is true, a motion is about axes other than the third and the vertical, and its statistics are sampled. A label
    that the sampling error could change is not_computed. If `motion` is None, motions about other axes are labelled drifting.
    """
    others = np.flatnonzero(elsewhere)
    sine, n, m = system.steady_rates(points)
    zero, theta = np.zeros(family.shape), np.arcsin(np.minimum(np.abs(sine), 1.0))
    measured = dict.fromkeys(("theta_dot_rms", "psi_dot_std", "phi_dot_std"), zero) | {
        "psi_dot_mean": n, "phi_dot_mean": m, "normal_rate_std": rate_std(system, points, family, duration),
        "theta_min": theta, "theta_max": theta, "sine_max": np.abs(sine),
    }  # fmt: skip
    if motion is not None and others.size:
        of_others = subset(points, others), motion.subset(others), duration[others]
        sampled, error = _statistics(system, *of_others, tolerances.angle)
    labels: dict[str, Flags] = {}
    for name, frame_rate in predicted_frames(system, points).items():
        label = rates.rule(tolerances, frame_rate).label(measured)
        label[others] = Label.DRIFTING
        if motion is not None and others.size:
            rule = rates.rule(tolerances.subset(others), frame_rate[others])
            uncertain = could_change(rule, sampled, error)
            label[others] = np.where(uncertain, Label.NOT_COMPUTED, rule.label(sampled))
        labels[name] = label
    return labels


def frame_motion(system: System, points: Points) -> tuple[Array, Array]:
    """Return the body components, (3, points), of the angular velocity relative to the frame and of the vertical at the start."""
    motion = system.equations.frame_motion(system.initial_state(points), system.constants(points))
    return np.array(motion[:3]), np.array(motion[3:])


def _statistics(
    system: System, points: Points, axes: TwoAxes, duration: Array, cylinder: float
) -> tuple[Measured, Measured]:
    """Sample the measurements that decide the labels of exact motions, and return them with the sampling errors."""
    # Multiples of the golden section are spread evenly and are in resonance with no period.
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
    """Return family and residual of each start by `System.identify_family`. The family is 0 (none) where formulas may overflow."""
    family, residual = system.identify_family(points)
    return np.where(within_range(system, points), family, 0).astype(np.int8), residual


def predicted_frames(system: System, points: Points) -> dict[str, Array]:
    """Return the rates (rad per time unit) that are added to psi' for each predicted label, by the name of the label."""
    frames = {"predicted": np.zeros(shape_of(points))}
    if system.frame_rate is not None:
        frames["predicted_inertial"] = system.frame_rate(points)
    return frames


def on_other_axes(system: System, family: Flags) -> Mask:
    """Whether the motion of a family is about axes other than the third and the vertical."""
    return np.isin(family, [f.flag for f in families_of(system).values() if f.axes is not None])


def agreement(label: Flags, predicted: Flags) -> Flags:
    """Return the values of `flags.Agreement` for two labels of each point."""
    unknown = (predicted == Label.NOT_COMPUTED) | (label == Label.NOT_COMPUTED) | (label == Label.UNRESOLVED)
    conditions = {
        Agreement.NOT_COMPARED: unknown,
        Agreement.AGREE: label == predicted,
        Agreement.THEORY_ONLY: label == Label.DRIFTING,
        Agreement.NUMERICS_ONLY: predicted == Label.DRIFTING,
    }
    return np.select(list(conditions.values()), list(conditions), Agreement.DIFFER).astype(np.int8)
