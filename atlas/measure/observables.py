"""Names, formulas and errors of the statistics of observables, and the label, which states whether the observables are constant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..flags import Steadiness
from ..kernel.stepsize import INTERPOLATION_ERROR, StepSizes
from ..kernel.tableaux import METHODS
from ..systems import arithmetic
from ..systems.base import Array, Flags, Mask, Observable, System
from .instrument import MainInstrument, Measured, Rule, Run, RunSettings, Variable
from .rates import END_TIME, INTEGRAL_DRIFT, STATUS, rounding_error, step_variables

_T = TypeVar("_T")
# Suffix of a statistic in the atlas -> meaning of the statistic, where {} stands for the name of the observable.
STATISTICS = {
    "mean": "mean of the {}",
    "std": "standard deviation of the {}",
    "min": "least {}",
    "max": "largest {}",
    "drift": "change of the {} over the run along the straight line fitted to it by least squares",
}
# Highest frequency of an observable, including overtones, in units of the frequency bound.
OVERTONE = 3.0
# Largest product of frequency bound and time between two nodes, rad.
MAX_NODE_RADIANS = 0.4
# A run may lack the fraction MISSING of its last period, and has at most MAX_PERIODS periods.
MISSING, MAX_PERIODS = 1e-3, 10**9
MAX_HALVINGS = 8  # number of times that the step size or the number of steps between nodes may be halved
# Largest jump of an observable between two nodes, divided by the range of the observable in the run.
MAX_ROUGHNESS = 0.3
# Least order of the errors of statistics in the step size. It is the order of rk4, as quadrature and interpolation have order 8.
STATISTICS_ORDER = 4
# Rounding error of a statistic, divided by the largest magnitude of the observable.
STATISTIC_ROUNDING = 1e-15


@dataclass(frozen=True)
class Observables(MainInstrument):
    """The main instrument of a system with observables."""

    quantity = "observables"
    unsteadiness_text = "largest standard deviation of an observable over its tolerance"

    def variables(self, system: System) -> tuple[Variable, ...]:
        if not system.observables:
            return ()
        flag = [
            Variable("label", "int8", "1", "whether the observables are constant", Steadiness.meanings()),
            STATUS,
        ]
        measured = [
            Variable(f"{o.name}_{suffix}", "float64", o.unit, text.format(o.long_name))
            for o in system.observables
            for suffix, text in STATISTICS.items()
        ]
        if system.equations.INTEGRALS:
            measured.append(INTEGRAL_DRIFT)
        error = Variable(
            "error_estimate", "float64", "1", "estimated relative error of the final state and of every statistic",
            comment="of the statistics over the largest magnitude of their observable; expected from phase error, dissipation,"
            " rounding and the change of first integrals, or measured by a second run (check_half_step; always where the bound is numeric)",
        )  # fmt: skip
        return (*flag, *measured, *step_variables(system), error, END_TIME)

    def statistics(self, system: System) -> tuple[str, ...]:
        return tuple(
            f"{observable.name}_{suffix}" for observable in system.observables for suffix in STATISTICS
        )

    def unsteadiness(self, system: System, measured: Measured, settings: RunSettings) -> Array:
        limits = std_tolerances(system, settings.std_tolerance, settings.rate_tolerance)
        shares = [measured[f"{name}_std"] / limit for name, limit in limits.items()]
        return np.asarray(np.fmax.reduce(shares))

    def largest(self, system: System, measured: Measured, errors: Measured, bound: Array) -> Array:
        """Divide the error of each statistic by the largest magnitude of its observable, and return the largest quotient."""
        shares = [
            errors[f"{name}_{suffix}"] / np.where(size > 0, size, 1.0)
            for name, size in sizes(system, measured).items()
            for suffix in STATISTICS
        ]
        return np.asarray(np.fmax.reduce(shares))

    def step_sizes(
        self, settings: RunSettings, bound: Array, duration: Array, step: Array | None = None
    ) -> StepSizes:
        """Return steps with nodes at most MAX_NODE_RADIANS apart, so that no extreme is missed. Automatic steps are halved if needed."""
        step_sizes = StepSizes.of(settings, bound, duration, step)
        may_halve = step is None and settings.step is None
        finest = (np.maximum(step_sizes.dispersion_error, 1e-16) / INTERPOLATION_ERROR) ** (1 / 8) / OVERTONE
        for _ in range(MAX_HALVINGS):
            radians = bound * step_sizes.sample_spacing
            far = radians > MAX_NODE_RADIANS
            # The number of steps between two nodes is halved until the interpolation error is within the phase error.
            several = (radians > np.minimum(finest, MAX_NODE_RADIANS)) & (step_sizes.steps_per_sample > 1)
            per_node = np.where(several, step_sizes.steps_per_sample // 2, step_sizes.steps_per_sample)
            halve = far & ~several & may_halve & step_sizes.resolved
            step_sizes = step_sizes.halved(METHODS[settings.method], halve)
            step_sizes = replace(step_sizes, steps_per_sample=per_node)
        return step_sizes

    def resolved(self, run: Run) -> Mask:
        """Whether no observable jumps between nodes. A jump shows that the steps are too long for the motion."""
        from ..kernel import observe

        sums, radians = run.integration.sums, run.bound * run.step_sizes.sample_spacing
        # For an oscillation at the bound, the cubic through the neighbours of a node has a relative error of radians^4 / 24 there.
        allowed = MAX_ROUGHNESS + radians**4 / 12
        rough = np.zeros(run.ensemble.size, bool)
        for first in range(observe.FIRST_ROW, len(sums), len(observe.Field)):
            least, largest, distance = sums[first + observe.Field.LEAST : first + len(observe.Field)]
            rounding = 1e-9 * np.maximum(np.abs(least), np.abs(largest))
            rough |= distance > np.maximum(allowed * (largest - least), rounding)
        return ~rough | ~run.integration.finite

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        """Return every statistic of every observable, named as in the atlas, and `integral_drift`, (points,) each."""
        from ..kernel import observe

        sums, intervals = run.integration.sums, run.integration.intervals
        periods = run.step_sizes.periods
        result = {}
        with np.errstate(all="ignore"):
            for k, observable in enumerate(sorted(run.system.observables, key=is_strobed)):
                first = observe.FIRST_ROW + len(observe.Field) * k
                start, total, square, trend, least, largest, _ = sums[first : first + len(observe.Field)]
                count, per_trend = intervals, np.asarray(12.0)
                if is_strobed(observable):  # count / per_trend is the sum of ((time - middle) / duration)^2
                    count, per_trend = periods + 1, 12.0 * periods / (periods + 2)
                shift = total / count
                variance = np.maximum(square / count - shift * shift, 0.0)
                values = (start + shift, np.sqrt(variance), least, largest, per_trend * trend / count)
                for suffix, column in zip(STATISTICS, values, strict=True):
                    result[f"{observable.name}_{suffix}"] = column
        result["integral_drift"] = sums[observe.CHANGE].copy()
        return result

    def rules(self, run: Run, rules: Mapping[str, Rule]) -> dict[str, Rule]:
        limits = std_tolerances(run.system, run.settings.std_tolerance, run.settings.rate_tolerance)
        return {"label": Rule(partial(label, limits=limits), tuple(f"{name}_std" for name in limits))}

    def relative_error(self, run: Run) -> Array:
        """Return the relative error of states. A statistic has this error relative to the largest magnitude of the observable."""
        step_sizes = run.step_sizes
        error = np.maximum(step_sizes.dispersion_error, step_sizes.dissipation_error)
        error = error + rounding_error(step_sizes)
        with np.errstate(over="ignore"):
            # The interpolation between nodes has this error for the highest overtone.
            error += INTERPOLATION_ERROR * (OVERTONE * run.bound * step_sizes.sample_spacing) ** 8
        return error

    def errors(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return the error of each standard deviation: the relative error times the range of the observable, plus a rounding error."""
        measured = run.measured
        return {
            f"{name}_std": relative * (measured[f"{name}_max"] - measured[f"{name}_min"])
            + STATISTIC_ROUNDING * size
            for name, size in sizes(run.system, measured).items()
        }

    @np.errstate(all="ignore")
    def rounding(self, run: Run, relative: Array) -> dict[str, Array]:
        """Return the rounding errors of the observables or, where larger, the effects of rounding errors of the initial state."""
        equations, state, constants = run.system.equations, run.ensemble.state, run.ensemble.constants
        slope = np.array(np.broadcast_arrays(*equations.rhs(state, constants)))
        shifts = np.eye(len(state))[..., None] * relative * (np.abs(state) + np.abs(slope) / run.bound)
        rounding = {}
        for name, size in sizes(run.system, run.measured).items():
            value = getattr(equations, name, lambda y, _, name=name: y[equations.STATE.index(name)])
            changes = [np.abs(value(state + s, constants) - value(state, constants)) for s in shifts]
            rounding[f"{name}_std"] = np.fmax(relative * size, np.sum(changes, axis=0))
        return rounding

    def differences(self, run: Run, other: Run, relative: Array) -> dict[str, Array]:
        return self.errors(run, relative)

    def rate_change(self, run: Run, other: Run, order: Array | float = 1.0) -> Array:
        """Return the largest change of a statistic relative to the observable's size. `order` divides all changes but those of extremes."""
        changes = []
        for name, size in sizes(run.system, run.measured).items():
            for suffix in STATISTICS:
                statistic = f"{name}_{suffix}"
                difference = np.abs(run.measured[statistic] - other.measured[statistic])
                scale = size if suffix in ("min", "max") else size * order
                changes.append(np.divide(difference, scale, out=np.zeros_like(size), where=size > 0))
        return np.asarray(np.fmax.reduce(changes))

    def pair_error(self, run: Run, coarse: Run, expected: Array) -> Array:
        """Return Richardson estimates of the errors, but at least 0.3 of `expected`, because two runs may agree by chance."""
        ratio = run.step_sizes.steps / coarse.step_sizes.steps
        state, other = run.integration.final_state, coarse.integration.final_state
        size = np.maximum(np.abs(state), np.abs(state).mean(axis=0))
        change = np.divide(np.abs(state - other), size, out=np.zeros_like(size), where=size > 0).max(axis=0)
        change /= np.abs(ratio ** METHODS[run.settings.method].order - 1.0)
        statistics = self.rate_change(run, coarse, np.abs(ratio**STATISTICS_ORDER - 1.0))
        return np.asarray(np.fmax.reduce([statistics, change, 0.3 * expected]))


def is_strobed(observable: Observable) -> bool:
    """Whether an observable is measured once a period."""
    return observable.every is not None


def whole_periods(
    system: System, constants: Array, duration: Array
) -> tuple[NDArray[np.int64] | None, Array]:
    """Return the number of whole periods (at least 1) in each run and their total time, or (None, duration) without strobes."""
    every = next((str(o.every) for o in system.observables if is_strobed(o)), None)
    if every is None:
        return None, duration
    names = dict(zip(system.equations.CONSTANTS, constants, strict=True))
    with np.errstate(all="ignore"):
        period = np.abs(arithmetic.value("every", every, names))
        periods = np.clip(np.floor(duration / period + MISSING), duration > 0, MAX_PERIODS)
        periods = np.nan_to_num(periods, nan=1.0).astype(np.int64)
        return periods, np.where(periods > 0, periods * period, 0.0)


def std_tolerances(
    system: System, settings: Mapping[str, float] | None, rate_tolerance: _T
) -> dict[str, float | _T]:
    """Return the standard deviation up to which each observable counts as constant, from `settings` or else from the system."""
    limits = {
        o.name: rate_tolerance if o.tolerance is None else float(o.tolerance) for o in system.observables
    }
    return limits | {name: limit for name, limit in (settings or {}).items() if name in limits}


def label(measured: Measured, limits: Mapping[str, Array | float]) -> Flags:
    """Return values of `flags.Steadiness`, whatever the status. `limits` is the result of `std_tolerances`."""
    varies = [measured[f"{name}_std"] > limit for name, limit in limits.items()]
    return np.where(np.any(varies, axis=0), Steadiness.DRIFTING, Steadiness.STEADY).astype(np.int8)


def sizes(system: System, measured: Measured) -> dict[str, Array]:
    """Return the largest magnitude of each observable by name."""
    names = [observable.name for observable in system.observables]
    return {n: np.maximum(np.abs(measured[f"{n}_min"]), np.abs(measured[f"{n}_max"])) for n in names}
