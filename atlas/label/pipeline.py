"""A set of points, from parameters to labels beside theory: prepare, integrate, recheck at half the step, assemble."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from ..engine import numeric_bound
from ..engine.ensemble import Ensemble, Integration
from ..engine.specialization import (
    GENERIC,
    Specialization,
    kernel,
    kernel_hash,
    tangent_kernel_hash,
)
from ..engine.statistics import NEEDS_PSI, RATES, STATISTICS
from ..engine.stepsize import ROUNDING, StepSizes
from ..engine.tableaux import METHODS
from ..flags import Label, Status
from ..scene.grid import Grid, Reason, status_of
from ..scene.model import Scene, Settings
from ..systems.base import FAMILY_TOLERANCE, Array, Flags, Mask, Points, System, derived_values, subset
from ..variables import ANY_AXIS, ANY_AXIS_THEORY
from . import any_axis, labels, observed
from .chaos import TangentRuns
from .expected_errors import differences, early_stop_rate, error_estimate, measurement_errors, pair_error
from .half_steps import measured_points, second_steps
from .regularity import has_chaos
from .theory import agreement, predict_any_axis, predict_runs

# A start beside an unstable motion departs because of its nudge, and not of integration errors, where theta' at half the
# step is the same within this share.
HALF_STEP_RTOL = 0.05
# Variables that only a whole run can give: a scene that asks for none of them ends its points early.
WHOLE_RUN = frozenset((*(statistic.name for statistic in STATISTICS), *ANY_AXIS))


def scene_specialization(scene: Scene) -> Specialization:
    """What the kernel of a scene leaves out."""
    return Specialization.of(scene.system, *scene.zero_and_equal_parameters())


def scene_kernel_hash(scene: Scene) -> str:
    """`hash_of_kernels` of a scene."""
    return hash_of_kernels(scene.system, scene.settings.method, scene_specialization(scene), scene.outputs)


def hash_of_kernels(
    system: System, method: str, specialization: Specialization, outputs: Collection[str]
) -> str:
    """Hash of the kernel that points are integrated with; a second one follows where it is the tangent kernel as well."""
    own = kernel_hash(system, method, specialization, any_axis.frames(system, outputs))
    return f"{own}-{tangent_kernel_hash(system, specialization)}" if has_chaos(outputs) else own


def evaluate_tile(
    scene: Scene,
    tile: Grid,
    *,
    halved: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """`evaluate` for some points of a scene, with its outputs; other variables may be missing."""
    return evaluate(
        scene.system, tile.base, tile.points, tile.duration, scene.settings,
        specialization=scene_specialization(scene), outputs=scene.outputs, nudged=bool(scene.nudge), reason=tile.reason,
        halved=halved, threads=threads, progress=progress,
    )  # fmt: skip


def evaluate(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    *,
    specialization: Specialization = GENERIC,
    outputs: Collection[str] | None = None,
    nudged: bool = False,
    reason: Flags | None = None,
    halved: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """Integrate, measure, label and compare points.

    base: the points before the nudge, for theory; points: the points to integrate; duration: in time units;
    specialization: what the kernel leaves out, the same for all points of a scene. outputs: names of
    variables; default: those of `variables.default_variables`. Statistics that are not among them may be
    missing or cover a part of the run, for without them a point ends when its label is certain. nudged:
    whether the points were moved off a family's motions. reason: values of `scene.grid.Reason`. Where it is
    not NONE, points are not computed: their flags are 0, but for the status, and their numbers nan. halved:
    integrate at half the step that the settings give; progress: called with the points done since the last
    call, fractions included. Returns by the names of the registry of variables.
    """
    if reason is not None and (reason != Reason.NONE).any():
        exists = reason == Reason.NONE
        where = np.flatnonzero(exists)
        columns = evaluate(
            system, subset(base, where), subset(points, where), duration[where], settings,
            specialization=specialization, outputs=outputs, nudged=nudged, halved=halved, threads=threads,
            progress=progress,
        )  # fmt: skip
        columns = {name: _scatter(values, exists) for name, values in columns.items()}
        return columns | {"status": np.where(exists, columns["status"], status_of(reason))}
    if system.observables:
        return observed.evaluate(
            system, base, points, duration, settings, specialization=specialization, outputs=outputs, halved=halved,
            threads=threads, progress=progress,
        )  # fmt: skip
    names = frozenset(outputs or ())  # those sought below are no default variables
    frames = any_axis.frames(system, names)
    execution = _Execution(threads, progress or (lambda points: None))
    runs = _prepare(
        system, base, points, duration, settings, specialization, nudged, halved, frames, execution
    )
    if has_chaos(names):
        tangent = TangentRuns.of(
            system, specialization, runs.ensemble, points, duration, settings, runs.step_sizes
        )
        runs = replace(runs, tangent=tangent)
    whole_run = outputs is None or not WHOLE_RUN.isdisjoint(names)
    integration = _integrate(runs, whole_run, execution)
    measured = _measured(integration, settings)
    recheck = _recheck(runs, integration, measured, execution)
    columns = _assemble(runs, integration, measured, recheck)
    if runs.tangent is not None:
        columns |= runs.tangent.variables(columns, execution.threads, execution.progress)
    if not names.isdisjoint(ANY_AXIS_THEORY):
        columns |= predict_any_axis(
            system, base, points, columns, settings.rate_tolerance,
            nudged=nudged, cylinder_tolerance=settings.cylinder, duration=duration,
        )  # fmt: skip
    if "agreement_any_axis" in names:
        columns["agreement_any_axis"] = agreement(columns["label_any_axis"], columns["predicted_any_axis"])
    return columns | derived_values(system, names, base, duration, lambda: execution.progress(0.0))


@dataclass(frozen=True)
class _Execution:
    """By how many threads points are integrated, and the function that is called with their progress."""

    threads: int | None
    progress: Callable[[float], None]  # takes a number of points; may raise an exception to end the run

    def check(self, point_steps: int) -> None:
        """For integrations that do not count as progress: call `progress`, which may end the run."""
        self.progress(0.0)


@dataclass(frozen=True)
class _Runs:
    """Points ready to be integrated, and what theory predicts of them; arrays of shape (points,)."""

    system: System
    settings: Settings
    kernel: ModuleType  # that integrates the points
    ensemble: Ensemble
    step_sizes: StepSizes
    duration: Array
    theory: Mapping[str, np.ndarray]
    residual: Array  # of the conditions of a steady motion, at the nudged start
    start_residual: Array  # the same, or of a motion about other axes
    about_other_axes: Mask  # whether the next lines are about such a motion
    log_growth: Array  # growth of a distance from the family's motion over the run, as a logarithm
    log_growth_exact: Array  # the same where no nudge moved the start off the motion, else 0
    rounding_growth: Array  # the same where the start is on the motion to rounding, else 0
    rounding_growth_on_vertical: Array  # the same of runs whose third axis never leaves the vertical by a bit
    frame_rates: Mapping[str, Array]  # label variable -> rate added to psi', rad per time unit
    tangent: TangentRuns | None = None

    @property
    def error_amplified(self) -> Mask:
        """Whether an unstable motion amplifies the method's own error beyond the rate tolerance."""
        amplified = self.step_sizes.rate_error * np.exp(self.log_growth_exact) > self.settings.rate_tolerance
        return np.asarray(amplified & (self.log_growth_exact > 0))


def _prepare(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    specialization: Specialization,
    nudged: bool,
    halved: bool,
    frames: int,
    execution: _Execution,
) -> _Runs:
    """The ensemble, its step sizes and its theory. Parameters may overflow: such points end up unresolved."""
    ensemble = Ensemble.of(system, points, frames)
    module, method = kernel(system, settings.method, specialization, frames), METHODS[settings.method]
    if system.has_numeric_bound:
        bound, settled = numeric_bound.along_runs(
            system, module, method, ensemble, duration, settings.max_steps, threads=execution.threads
        )
        ensemble = replace(ensemble, frequency_bound=np.where(settled, bound, np.inf))
    with np.errstate(all="ignore"):
        step_sizes = StepSizes.of(settings, ensemble.frequency_bound, duration)
        if halved:
            step_sizes = step_sizes.halved(method)
        prediction = predict_runs(
            system,
            base,
            points,
            duration,
            settings.tolerances,
            nudged=nudged,
            any_axis=frames > 0,
            pause=lambda: execution.progress(0.0),
            threads=execution.threads,
        )
        theory, pushed, log_growth = prediction.variables, prediction.pushed, prediction.log_growth
        # The growth of an offset in one step is rounded: where that is a per cent of it or more, rounding decides.
        max_residual = np.fmax(
            labels.ROUNDING_RESIDUAL, 100.0 * labels.ROUNDOFF / (theory["growth_rate"] * step_sizes.step_size)
        )
        near = prediction.start_residual <= FAMILY_TOLERANCE
        exact = ~pushed if nudged else near & (prediction.family_residual <= max_residual)
        rounding_growth = np.where(exact, log_growth, 0.0)
        about_vertical = system.growth_about_vertical(points) * duration
    frame_rates = {"label": np.zeros_like(duration)}
    if system.frame_rate is not None:
        frame_rates["label_inertial"] = system.frame_rate(points)
    return _Runs(
        system=system,
        settings=settings,
        kernel=module,
        ensemble=ensemble,
        step_sizes=step_sizes,
        duration=duration,
        theory=theory,
        residual=prediction.residual,
        start_residual=prediction.start_residual,
        about_other_axes=prediction.about_other_axes,
        log_growth=log_growth,
        log_growth_exact=np.where(pushed, 0.0, log_growth),
        rounding_growth=rounding_growth,
        rounding_growth_on_vertical=np.fmin(rounding_growth, about_vertical),
        frame_rates=frame_rates,
    )


def _integrate(runs: _Runs, whole_run: bool, execution: _Execution) -> Integration:
    """Integrate the points, those that are certain to drift only as long as needed unless whole_run is set.

    Points that their steps do not resolve run for a few steps.
    """
    settings, step_sizes = runs.settings, runs.step_sizes.without_unresolved()
    total = int(step_sizes.steps.sum())
    points = runs.duration.size if runs.tangent is None else runs.duration.size * (1.0 - runs.tangent.share)

    def advance(point_steps: int) -> None:
        execution.progress(points * point_steps / total)

    stop_rate = None
    if not whole_run:
        with np.errstate(all="ignore"):
            stop_rate = early_stop_rate(step_sizes, runs.ensemble.frequency_bound, settings.tolerances)
            stop_rate = np.where(runs.error_amplified, np.inf, stop_rate)
    return runs.ensemble.integrate(
        runs.kernel, step_sizes, settings.cylinder,
        early_stop_rate=stop_rate, threads=execution.threads, progress=advance,
    )  # fmt: skip


def _measured(integration: Integration, settings: Settings) -> dict[str, Array]:
    """Statistics of an integration, and those of its circles."""
    measured = integration.statistics()
    return measured | any_axis.measurements(integration, measured, settings.tolerances)


def _status(
    runs: _Runs, integration: Integration, measured: Mapping[str, Array], step_sensitive: Mask | bool
) -> Flags:
    """Status of the points."""
    # No tilt can grow where the third axis never left the vertical by a bit.
    on_vertical = measured["sine_max"] == 0.0
    rounding_growth = np.where(on_vertical, runs.rounding_growth_on_vertical, runs.rounding_growth)
    settings, step_sizes = runs.settings, runs.step_sizes
    with np.errstate(all="ignore"):
        limit = labels.rounding_limit(runs.start_residual, runs.ensemble.frequency_bound, settings.tolerances)
        resolved = step_sizes.resolved
        if runs.tangent is not None:
            resolved = resolved & runs.tangent.steps.resolved
        return labels.status(
            integration.finite, measured["integral_drift"], settings.drift_tolerance, resolved,
            rounding_growth, limit, step_sensitive,
        )  # fmt: skip


@dataclass(frozen=True)
class _Recheck:
    """Errors of points, some of which are integrated again with other steps; arrays of shape (points,)."""

    step_sensitive: Mask
    error: Array  # relative error of states and statistics


def _recheck(
    runs: _Runs, integration: Integration, measured: Mapping[str, Array], execution: _Execution
) -> _Recheck:
    """Measure the error of some points, and integrate again those whose label an error could change."""
    settings, step_sizes, bound = runs.settings, runs.step_sizes, runs.ensemble.frequency_bound
    with np.errstate(all="ignore"):
        label = _label_of_motion(runs, measured)
        resolved = (_status(runs, integration, measured, False) == Status.OK) & ~integration.stopped_early
        # A departure from an unstable motion may be caused by integration errors; it must be where the start
        # satisfies the conditions of the motion to rounding.
        departed = resolved & (measured["sine_max"] > 0.0) & runs.error_amplified & (label == Label.DRIFTING)
        step_sensitive = departed & (runs.start_residual <= ROUNDING * np.sqrt(step_sizes.steps))
        unsure = _unsure(measured, measurement_errors(step_sizes, bound, measured), runs)
        error = error_estimate(step_sizes, bound, runs.log_growth, integration, measured, settings.cylinder)
        rate_error = step_sizes.rate_error * np.exp(runs.log_growth)
        error = np.fmax(error, any_axis.error_of_values(rate_error, bound, measured, settings.tolerances))
    sample = np.flatnonzero(resolved & measured_points(runs.system, runs.ensemble, settings.check_half_step))
    if sample.size:
        error[sample], unsure[sample] = _measured_error(
            runs, integration, measured, sample, error[sample], execution
        )
    where = np.flatnonzero(resolved & ~step_sensitive & (unsure | departed))
    if where.size:
        changes, difference = _at_half_step(runs, measured, departed[where], where, execution)
        step_sensitive[where] = changes
        error[where] = np.fmax(error[where], difference)
    return _Recheck(step_sensitive, np.fmax(error, measured["integral_drift"]))


def _measured_error(
    runs: _Runs,
    integration: Integration,
    measured: Mapping[str, Array],
    where: np.ndarray,
    expected: Array,
    execution: _Execution,
) -> tuple[Array, Mask]:
    """Errors of points from a second run with fewer steps, and whether a label could change within them.

    Where the second run is not resolved, the expected error counts if it is larger; where it overflows, a label could change.
    """
    bound, method = runs.ensemble.frequency_bound[where], METHODS[runs.settings.method]
    sizes = runs.step_sizes.subset(where)
    coarse_sizes = second_steps(runs.system, sizes, method)
    coarse = _integrate_again(runs, where, coarse_sizes, execution)
    run, values = integration.subset(where), subset(measured, where)
    coarse_values = _measured(coarse, runs.settings)
    error = pair_error(
        runs.system,
        method,
        bound,
        (sizes, run, values),
        (coarse_sizes, coarse, coarse_values),
        runs.settings.cylinder,
    )
    with np.errstate(all="ignore"):
        difference = differences(values, coarse_values, _label_statistics(values))
        unsure = _unsure(values, difference, runs, where)
    trusted = (coarse_sizes.step_ratio < 0.5) & coarse.finite
    return np.where(trusted, error, np.fmax(error, expected)), unsure | ~coarse.finite


def _at_half_step(
    runs: _Runs, measured: Mapping[str, Array], departed: Mask, where: np.ndarray, execution: _Execution
) -> tuple[Mask, Array]:
    """Whether labels change at half the step, and the largest change of a rate over the frequency bound."""
    fine_sizes = runs.step_sizes.subset(where).halved(METHODS[runs.settings.method])
    fine = _measured(_integrate_again(runs, where, fine_sizes, execution), runs.settings)
    coarse = subset(measured, where)
    changes = _label_changes(coarse, fine, runs, where)
    rates = differences(fine, coarse, (*RATES, *(name for name in any_axis.RATES if name in fine)))
    changes |= departed & (rates["theta_dot_rms"] > HALF_STEP_RTOL * fine["theta_dot_rms"])
    return changes, np.fmax.reduce(list(rates.values())) / runs.ensemble.frequency_bound[where]


def _integrate_again(
    runs: _Runs, where: np.ndarray, step_sizes: StepSizes, execution: _Execution
) -> Integration:
    """Integrate some of the points, by their indices, with other step sizes."""
    return runs.ensemble.subset(where).integrate(
        runs.kernel, step_sizes, runs.settings.cylinder, threads=execution.threads, progress=execution.check
    )


def _label_statistics(measured: Mapping[str, Array]) -> list[str]:
    """Names of the measurements from which the labels are decided."""
    return [*labels.LABEL_STATISTICS, *any_axis.names_in(measured)]


def _labels(
    runs: _Runs, measured: Mapping[str, Array], where: np.ndarray | slice = slice(None)
) -> dict[str, Flags]:
    """Every label of the points, or of some of them, whatever their status."""
    tolerances = runs.settings.tolerances
    kinds = {name: labels.label(measured, tolerances, rate[where]) for name, rate in runs.frame_rates.items()}
    for name in any_axis.labels_in(measured):
        circle = any_axis.statistics_of(measured, name)
        kinds[name] = any_axis.label(circle, kinds[any_axis.LABELS[name]], tolerances)
    return kinds


def _label_of_motion(runs: _Runs, measured: Mapping[str, Array]) -> Flags:
    """Label about the axes of the motion that the start is on or near, else about the third axis and the vertical."""
    kinds = _labels(runs, measured)
    return np.where(runs.about_other_axes, kinds.get("label_any_axis", kinds["label"]), kinds["label"])


def _unsure(
    measured: Mapping[str, Array],
    error: Mapping[str, Array],
    runs: _Runs,
    where: np.ndarray | slice = slice(None),
) -> Mask:
    """Whether a label could be another one within the errors of the measurements that decide it."""
    tolerances = runs.settings.tolerances
    own_error = {name: error[name] for name in labels.LABEL_STATISTICS}
    unsure = [
        labels.unsure(measured, own_error, tolerances, rate[where]) for rate in runs.frame_rates.values()
    ]
    for name in any_axis.labels_in(measured):
        own_label = labels.label(measured, tolerances, runs.frame_rates[any_axis.LABELS[name]][where])
        circle, errors = (any_axis.statistics_of(values, name) for values in (measured, error))
        unsure.append(any_axis.unsure(circle, errors, own_label, tolerances))
    return np.logical_or.reduce(unsure)


def _label_changes(
    coarse: Mapping[str, Array], fine: Mapping[str, Array], runs: _Runs, where: np.ndarray
) -> Mask:
    """Whether a label differs at half the step, or could by as much as the measurements differ."""
    with np.errstate(all="ignore"):
        difference = differences(fine, coarse, _label_statistics(fine))
        changes = _unsure(fine, difference, runs, where)
        before, after = _labels(runs, coarse, where), _labels(runs, fine, where)
        for name, label in before.items():
            changes |= label != after[name]
    return changes


def _assemble(
    runs: _Runs, integration: Integration, measured: Mapping[str, Array], recheck: _Recheck
) -> dict[str, np.ndarray]:
    """Every variable of the registry but the system's derived ones."""
    tolerances = runs.settings.tolerances
    resolved = runs.step_sizes.resolved
    columns: dict[str, np.ndarray] = {
        name: values if name == "integral_drift" else np.where(resolved, values, np.nan)
        for name, values in measured.items()
        if ":" not in name  # what decides labels about any axes
    }
    status = _status(runs, integration, measured, recheck.step_sensitive)
    cylinder = labels.in_cylinder(measured, tolerances.angle)
    with np.errstate(invalid="ignore"):
        for name, label in _labels(runs, measured).items():
            label[integration.stopped_early] = Label.DRIFTING
            columns[name] = np.where(status == Status.OK, label, Label.UNRESOLVED).astype(np.int8)
        steady = (status == Status.OK) & (columns["label"] != Label.DRIFTING)
        columns["geometry"] = runs.system.geometry(
            measured, steady, cylinder, tolerances.rate, tolerances.angle
        )
    for name in NEEDS_PSI:
        columns[name] = np.where(cylinder, np.nan, columns[name])
    for name in (*any_axis.RATES, *any_axis.ANGLES):
        if name in columns:
            columns[name] = np.where(status == Status.OK, columns[name], np.nan)
    columns |= runs.theory
    return columns | {
        "status": status,
        "step": runs.step_sizes.step_size,
        "step_ratio": runs.step_sizes.step_ratio,
        "error_estimate": np.where(resolved, recheck.error, np.inf),
        "condition_residual": runs.residual,
        "end_time": np.where(integration.stopped_early | ~resolved, integration.duration, runs.duration),
        "agreement": agreement(columns["label"], runs.theory["predicted"]),
    }


def _scatter(values: np.ndarray, exists: Mask) -> np.ndarray:
    """Values of the points that exist among all points; the others get 0 or nan."""
    full = np.full(exists.shape, np.nan if values.dtype.kind == "f" else 0, values.dtype)
    full[exists] = values
    return full
