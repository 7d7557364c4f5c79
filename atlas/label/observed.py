"""Points of a system with observables, from parameters to labels; `pipeline` does the same for bodies in a frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from ..engine import numeric_bound, observation
from ..engine.ensemble import Ensemble
from ..engine.observation import Measurement
from ..engine.specialization import Specialization, kernel
from ..engine.stepsize import StepSizes
from ..engine.tableaux import METHODS
from ..flags import Status, Steadiness
from ..scene.model import Settings, std_tolerances
from ..systems.base import Array, Flags, Mask, Points, System, derived_values, subset
from . import labels
from .chaos import TangentRuns
from .expected_errors import rounding_error
from .half_steps import measured_points, second_steps
from .regularity import has_chaos

# Order in the step of the errors of statistics, at least: that of rk4; quadrature and interpolation have order 8.
STATISTICS_ORDER = 4
# Rounding error of a statistic in units of the largest value of its observable.
ROUNDING = 1e-15


@dataclass(frozen=True)
class _Runs:
    """Points ready to be integrated; arrays of shape (points,)."""

    system: System
    settings: Settings
    kernel: ModuleType
    ensemble: Ensemble
    step_sizes: StepSizes
    settled: Mask  # whether the frequency bound holds for the whole run, as far as is known
    threads: int | None
    advance: Callable[[float], None]  # takes a number of points; may raise an exception to end the run

    def measure(self, progress: Callable[[int], None]) -> Measurement:
        """Integrate the points; those that their steps do not resolve for a few steps only."""
        return observation.measure(
            self.kernel,
            self.ensemble,
            self.step_sizes.without_unresolved(),
            threads=self.threads,
            progress=progress,
        )

    def repeated(self, where: np.ndarray, step_sizes: StepSizes) -> Measurement:
        """Integrate some of the points with other steps."""
        return observation.measure(
            self.kernel,
            self.ensemble.subset(where),
            step_sizes,
            threads=self.threads,
            progress=lambda steps: self.advance(0.0),
        )


def evaluate(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    *,
    specialization: Specialization,
    outputs: Collection[str] | None,
    halved: bool,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> dict[str, np.ndarray]:
    """Integrate, measure and label points of a system with observables; see `pipeline.evaluate`."""
    advance = progress or (lambda points: None)
    runs = _prepare(system, points, duration, settings, specialization, halved, threads, advance)
    names = frozenset(outputs or ())  # those sought below are no default variables
    tangent, share = None, 0.0
    if has_chaos(names):
        tangent = TangentRuns.of(
            system, specialization, runs.ensemble, points, duration, settings, runs.step_sizes
        )
        share = tangent.share
    total = max(int(runs.step_sizes.without_unresolved().steps.sum()), 1)
    measurement = runs.measure(lambda steps: advance(duration.size * (1.0 - share) * steps / total))
    measured = measurement.statistics(system)
    resolved = _resolved(runs, measurement)
    if tangent is not None:
        resolved &= tangent.steps.resolved
    error, step_sensitive = _recheck(runs, measurement, measured, resolved)
    columns = _assemble(runs, measurement, measured, resolved, error, step_sensitive)
    columns["end_time"] = np.where(runs.step_sizes.resolved, duration, _integrated(runs))
    if tangent is not None:
        columns |= tangent.variables(columns, threads, advance)
    return columns | derived_values(system, names, base, duration, lambda: advance(0.0))


def _prepare(
    system: System,
    points: Points,
    duration: Array,
    settings: Settings,
    specialization: Specialization,
    halved: bool,
    threads: int | None,
    advance: Callable[[float], None],
) -> _Runs:
    """The ensemble with its frequency bound, and its step sizes."""
    ensemble, module = Ensemble.of(system, points), kernel(system, settings.method, specialization)
    method, settled = METHODS[settings.method], np.ones(duration.shape, bool)
    if system.has_numeric_bound:
        bound, settled = numeric_bound.along_runs(
            system, module, method, ensemble, duration, settings.max_steps, threads=threads
        )
        ensemble = replace(ensemble, frequency_bound=bound)
    with np.errstate(all="ignore"):
        bound = ensemble.frequency_bound
        step_sizes = StepSizes.of(settings, bound, duration)
        step_sizes = observation.with_dense_nodes(step_sizes, bound, method, may_halve=settings.step is None)
        if halved:
            step_sizes = step_sizes.halved(method)
    return _Runs(system, settings, module, ensemble, step_sizes, settled, threads, advance)


def _integrated(runs: _Runs) -> Array:
    """Time that is integrated of each point, time units."""
    sizes = runs.step_sizes.without_unresolved()
    with np.errstate(over="ignore"):
        return np.asarray(sizes.steps * sizes.step_size)


def _resolved(runs: _Runs, measurement: Measurement) -> Mask:
    """Whether the steps are short enough for the bound, the bound holds, and no observable jumps between nodes."""
    with np.errstate(all="ignore"):
        radians = runs.ensemble.frequency_bound * runs.step_sizes.sample_spacing
        smooth = ~measurement.rough(radians) | ~measurement.finite
        return np.asarray(runs.step_sizes.resolved & runs.settled & smooth)


def label(system: System, measured: Mapping[str, Array], settings: Settings) -> Flags:
    """Label of each point, values of `flags.Steadiness`, whatever its status."""
    limits = std_tolerances(system, settings)
    varies = [measured[f"{name}_std"] > limit for name, limit in limits.items()]
    return np.where(np.any(varies, axis=0), Steadiness.DRIFTING, Steadiness.STEADY).astype(np.int8)


def sizes(system: System, measured: Mapping[str, Array]) -> dict[str, Array]:
    """Largest magnitude of each observable, in its unit, by name."""
    names = [observable.name for observable in system.observables]
    return {n: np.maximum(np.abs(measured[f"{n}_min"]), np.abs(measured[f"{n}_max"])) for n in names}


def _unsure(system: System, measured: Mapping[str, Array], error: Array, settings: Settings) -> Mask:
    """Whether the label could be another one within a relative error of the statistics."""
    labels_within = []
    for sign in (-1.0, 1.0):
        moved = dict(measured)
        for name, size in sizes(system, measured).items():
            spread = measured[f"{name}_max"] - measured[f"{name}_min"]
            moved[f"{name}_std"] = measured[f"{name}_std"] + sign * (error * spread + ROUNDING * size)
        labels_within.append(label(system, moved, settings))
    return np.asarray(labels_within[0] != labels_within[1])


def _recheck(
    runs: _Runs, measurement: Measurement, measured: Mapping[str, Array], resolved: Mask
) -> tuple[Array, Mask]:
    """Relative errors, expected or measured by a second run, and where the label depends on the step."""
    system, settings, method = runs.system, runs.settings, METHODS[runs.settings.method]
    with np.errstate(all="ignore"):
        error = np.maximum(runs.step_sizes.dispersion_error, runs.step_sizes.dissipation_error)
        error = error + rounding_error(runs.step_sizes)
        error += observation.interpolation_error(runs.step_sizes, runs.ensemble.frequency_bound)
        usable = resolved & measurement.finite & ~(measured["integral_drift"] > settings.drift_tolerance)
        overflows = np.zeros(error.shape, bool)
        sample = np.flatnonzero(usable & measured_points(system, runs.ensemble, settings.check_half_step))
        if sample.size:
            coarser = second_steps(system, runs.step_sizes.subset(sample), method)
            other = runs.repeated(sample, coarser)
            ratio = runs.step_sizes.steps[sample] / coarser.steps
            order = np.abs(ratio**STATISTICS_ORDER - 1.0)
            change = _change(system, subset(measured, sample), other.statistics(system), order)
            state = _state_change(measurement.final_state[:, sample], other.final_state)
            state /= np.abs(ratio**method.order - 1.0)
            # Two runs may agree by chance.
            error[sample] = np.fmax.reduce([change, state, 0.3 * error[sample]])
            overflows[sample] = ~other.finite
        unsure = np.flatnonzero(usable & (overflows | _unsure(system, measured, error, settings)))
        step_sensitive = np.zeros(error.shape, bool)
        if unsure.size:
            fine = runs.repeated(unsure, runs.step_sizes.subset(unsure).halved(method)).statistics(system)
            change = _change(system, subset(measured, unsure), fine)
            differs = label(system, fine, settings) != label(system, subset(measured, unsure), settings)
            step_sensitive[unsure] = differs | _unsure(system, fine, change, settings)
            error[unsure] = np.fmax(error[unsure], change)
        return np.fmax(error, measured["integral_drift"]), step_sensitive


def _change(
    system: System, measured: Mapping[str, Array], other: Mapping[str, Array], order: Array | float = 1.0
) -> Array:
    """Largest difference of a statistic of two runs, over the largest magnitude of its observable.

    order: what the differences of integrals are divided by; those of extremes have no order, for they lie anywhere between nodes.
    """
    changes = []
    for name, size in sizes(system, measured).items():
        for suffix in observation.STATISTICS:
            difference = np.abs(measured[f"{name}_{suffix}"] - other[f"{name}_{suffix}"])
            scale = size if suffix in ("min", "max") else size * order
            changes.append(np.divide(difference, scale, out=np.zeros_like(size), where=size > 0))
    return np.asarray(np.fmax.reduce(changes))


def _state_change(state: Array, other: Array) -> Array:
    """Largest difference of a component of two states, over the larger of its magnitude and that of the state's mean."""
    size = np.maximum(np.abs(state), np.abs(state).mean(axis=0))
    change = np.divide(np.abs(state - other), size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(change.max(axis=0))


def _assemble(
    runs: _Runs,
    measurement: Measurement,
    measured: Mapping[str, Array],
    resolved: Mask,
    error: Array,
    step_sensitive: Mask,
) -> dict[str, np.ndarray]:
    """The variables of the registry but those of chaos, the derived ones and the end of the run."""
    no_growth = np.zeros(resolved.shape)
    status = labels.status(
        measurement.finite, measured["integral_drift"], runs.settings.drift_tolerance, resolved, no_growth,
        no_growth, step_sensitive,
    )  # fmt: skip
    kind = np.where(status == Status.OK, label(runs.system, measured, runs.settings), Steadiness.UNRESOLVED)
    columns: dict[str, np.ndarray] = {
        name: values if name == "integral_drift" else np.where(resolved, values, np.nan)
        for name, values in measured.items()
    }
    return columns | {
        "label": kind.astype(np.int8),
        "status": status,
        "step": runs.step_sizes.step_size,
        "step_ratio": runs.step_sizes.step_ratio,
        "error_estimate": np.where(resolved, error, np.inf),
    }
