"""Number and size of the integration steps of each point, which do not depend on the other points."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .sampling import MIN_INTERVALS
from .tableaux import METHODS, Method

MAX_STEPS_PER_SAMPLE = 16
# With automatic steps, neither the local error nor dissipation changes a steady rate by more than this fraction of the rate tolerance.
RATE_ERROR_BUDGET = 0.1
ROUNDING = 1e-16  # relative rounding error of the initial state and of each step
# A run counts as resolved if `step_ratio` and `dissipation_error` do not exceed these limits.
MAX_STEP_RATIO, MAX_DISSIPATION_ERROR = 0.5, 0.1
# An unresolved run gets no label. The run takes at most this number of steps, which is enough to show an overflow.
STEPS_UNRESOLVED = 64
MIN_NODES_PER_PERIOD = 8
GOLDEN_SECTION = 0.5 * (5**0.5 - 1.0)
# If the phase of an oscillation grows by x rad per node, interpolation between four nodes has the relative error INTERPOLATION_ERROR * x^8.
INTERPOLATION_ERROR = 81 / 256 / 40320


class StepSettings(Protocol):
    """The settings that determine the steps. See `scene.model.Settings`."""

    @property
    def method(self) -> str: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def step(self) -> float | None: ...
    @property
    def max_steps(self) -> int: ...
    @property
    def rate_tolerance(self) -> NDArray[np.float64] | float: ...


@dataclass(frozen=True)
class StepSizes:
    """Step sizes of an ensemble and the expected integration errors. Arrays have shape (points,)."""

    steps: NDArray[np.int64]
    steps_per_sample: NDArray[np.int64]  # number of steps between two nodes of the statistics
    step_size: NDArray[np.float64]  # in time units
    step_ratio: NDArray[np.float64]  # step size times frequency bound, divided by the stability limit
    # Phase error (rad) and relative loss of amplitude that an oscillation at the frequency bound has at the end of the run.
    dispersion_error: NDArray[np.float64]
    dissipation_error: NDArray[np.float64]
    # Expected variation that step errors cause in a steady rate equal to the frequency bound, in rad per time unit.
    rate_error: NDArray[np.float64]
    # Number of periods in the run, or 0 for a system without strobed observables. All periods have equally many nodes.
    periods: NDArray[np.int64]
    transient: NDArray[np.float64]  # duration of the transient before the run, in time units
    transient_steps: NDArray[np.int64]  # number of steps in the transient

    @classmethod
    def of(
        cls,
        settings: StepSettings,
        bound: NDArray[np.float64],
        duration: NDArray[np.float64],
        step: NDArray[np.float64] | None = None,
    ) -> StepSizes:
        """Return the step sizes for frequency bounds (rad per time unit) and durations (time units).

        No step is longer than `step` or, if `step` is None, than `settings.step`. If both are None, the steps are automatic. The
        phase error of an oscillation at the bound then stays within `settings.tolerance`, and neither the loss of amplitude nor
        the local error changes a steady rate equal to the bound by more than RATE_ERROR_BUDGET times the rate tolerance.
        The number of steps before rounding up never exceeds `settings.max_steps`, even if errors become larger. A point without
        a finite bound gets the fewest steps and an infinite step ratio.
        """
        method, length = METHODS[settings.method], settings.step if step is None else step
        radians = bound * duration
        finite = np.isfinite(radians)
        radians = np.where(finite, radians, 0.0)
        if length is None:
            with np.errstate(divide="ignore"):
                by_phase = settings.tolerance / (method.dispersion * np.maximum(radians, 1e-300))
                rate_unit = np.where(finite, np.maximum(bound, 1e-300), 1.0)
                relative_rate = RATE_ERROR_BUDGET * settings.rate_tolerance / rate_unit
                y = np.minimum(
                    by_phase ** (1 / method.order), (relative_rate / method.dispersion) ** (1 / method.order)
                )
                by_dissipation = relative_rate / (method.dissipation * np.maximum(radians, 1e-300))
                y = np.minimum(y, by_dissipation ** (1 / (method.dissipation_order - 1)))
                # A body at rest needs no steps, even if tiny tolerances make y underflow to 0.
                count = np.divide(radians, y, out=np.zeros_like(radians), where=radians > 0)
            steps = count_ladder(np.minimum(count, float(settings.max_steps)))
        else:
            run = np.where(finite, duration, 0.0)
            steps = steps_of_length(length, run, MIN_INTERVALS, settings.max_steps)
        y = radians / steps
        # steps_per_sample is a power of 2. The interpolation error, which has order 8, stays below a tenth of the phase error.
        with np.errstate(divide="ignore", invalid="ignore"):
            phase_error = radians * method.dispersion * y**method.order
            spacing = (0.1 * phase_error / INTERPOLATION_ERROR) ** (1 / 8) / y  # in steps
        spacing = np.minimum(np.where(y > 0, spacing, MAX_STEPS_PER_SAMPLE), steps / (4 * MIN_INTERVALS))
        steps_per_sample = 2 ** np.floor(np.log2(np.clip(spacing, 1, MAX_STEPS_PER_SAMPLE))).astype(np.int64)
        steps = -(-steps // steps_per_sample) * steps_per_sample
        radians = np.where(finite, radians, np.inf)  # no step resolves an infinite frequency
        y = radians / steps
        dispersion = method.dispersion * y**method.order
        dissipation_error = radians * method.dissipation * y ** (method.dissipation_order - 1)
        return cls(
            steps=steps,
            steps_per_sample=steps_per_sample,
            step_size=duration / steps,
            step_ratio=y / method.stability,
            dispersion_error=radians * dispersion,
            dissipation_error=dissipation_error,
            rate_error=bound * (dispersion + dissipation_error + ROUNDING * np.sqrt(steps)),
            periods=np.zeros_like(steps),
            transient=np.zeros(steps.shape),
            transient_steps=np.zeros_like(steps),
        )

    def after(self, transient: NDArray[np.float64], duration: NDArray[np.float64]) -> StepSizes:
        """Return step sizes of runs that are divided into a transient and a duration. The expected errors stay those of the whole runs."""
        has = transient > 0
        intervals = np.ceil(self.intervals * duration / (transient + duration) - 1e-9).astype(np.int64)
        steps = np.maximum(intervals, 2 * MIN_INTERVALS) * self.steps_per_sample
        step_size = np.where(has, duration / steps, self.step_size)
        return replace(
            self,
            steps=np.where(has, steps, self.steps),
            step_size=step_size,
            step_ratio=self.step_ratio * np.where(has, step_size / self.step_size, 1.0),
            transient=transient,
            transient_steps=np.ceil(transient / self.step_size - 1e-9).astype(np.int64),
        )

    @property
    def whole_steps(self) -> NDArray[np.int64]:
        """Number of steps from the start, including the transient."""
        return self.steps + self.transient_steps

    @property
    def intervals(self) -> NDArray[np.int64]:
        """Number of intervals between nodes in the run."""
        return self.steps // self.steps_per_sample

    @property
    def nodes_per_period(self) -> NDArray[np.int64]:
        """Number of intervals between nodes in one period."""
        return np.maximum(self.intervals // np.maximum(self.periods, 1), 1)

    @property
    def sample_spacing(self) -> NDArray[np.float64]:
        """Time between two nodes, time units."""
        return self.step_size * self.steps_per_sample

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Whether the steps are short enough for the frequency bound."""
        stable = self.step_ratio <= MAX_STEP_RATIO
        return np.asarray(stable & (self.dissipation_error <= MAX_DISSIPATION_ERROR))

    def without_unresolved(self) -> StepSizes:
        """Return step sizes with at most STEPS_UNRESOLVED steps and no transient at unresolved points."""
        shorter = ~self.resolved & (self.steps > STEPS_UNRESOLVED)
        return replace(
            self,
            steps=np.where(shorter, STEPS_UNRESOLVED, self.steps),
            steps_per_sample=np.where(shorter, 1, self.steps_per_sample),
            transient_steps=np.where(self.resolved, self.transient_steps, 0),
        )

    def subset(self, where: NDArray[np.int64]) -> StepSizes:
        return StepSizes(**{field.name: getattr(self, field.name)[where] for field in fields(self)})

    def halved(self, method: Method, where: NDArray[np.bool_] | bool = True) -> StepSizes:
        """Return step sizes with twice as many steps and nodes where `where` is true."""
        return self._in_steps(np.where(where, 2, 1) * self.steps, self.steps_per_sample, method)

    def coarsened(self, method: Method) -> StepSizes:
        """Return step sizes with half as many steps, rounded up."""
        steps = np.maximum(-(-self.steps // 2), MIN_INTERVALS)
        return self._in_steps(steps, np.gcd(steps, self.steps_per_sample), method)

    def incommensurate(self, method: Method) -> StepSizes:
        """Return step sizes with about 0.618 times as many steps (golden section).

        The golden section is the number farthest from fractions with small denominators, so that old and new runs share hardly any
        node. A motion that is faster than the steps and looks slow at the old nodes looks different at the new nodes.
        """
        nodes, periods = self.nodes_per_period, np.maximum(self.periods, 1)
        fewer = (GOLDEN_SECTION * nodes).astype(np.int64) | 1
        for _ in range(3):  # add 2 where `fewer` and `nodes` have a common factor above 3
            fewer = np.where(np.gcd(fewer, nodes) > 3, fewer + 2, fewer)
        intervals = np.where(fewer * periods >= MIN_INTERVALS, fewer, 2 * nodes - 1) * periods
        return self._in_steps(intervals * self.steps_per_sample, self.steps_per_sample, method)

    def in_periods(self, periods: NDArray[np.int64] | None, method: Method) -> StepSizes:
        """Return step sizes with equally many nodes in each of the `periods` periods of a run, or the same step sizes for None."""
        if periods is None:
            return self
        steps = np.maximum(self.steps, MIN_NODES_PER_PERIOD * periods * self.steps_per_sample)
        return replace(self, periods=periods)._in_steps(steps, self.steps_per_sample, method)

    def _in_steps(
        self, steps: NDArray[np.int64], steps_per_sample: NDArray[np.int64], method: Method
    ) -> StepSizes:
        """Return step sizes with other numbers of steps, rounded up so that all periods have equally many nodes."""
        nodes = np.maximum(self.periods, 1) * steps_per_sample
        steps = -(-steps // nodes) * nodes
        ratio = self.steps / steps
        return replace(
            self,
            steps=steps,
            steps_per_sample=steps_per_sample,
            step_size=self.step_size * ratio,
            step_ratio=self.step_ratio * ratio,
            dispersion_error=self.dispersion_error * ratio**method.order,
            dissipation_error=self.dissipation_error * ratio ** (method.dissipation_order - 1),
            rate_error=self.rate_error * ratio**method.order,
            transient_steps=np.ceil(self.transient_steps / ratio - 1e-9).astype(np.int64),
        )


def steps_of_length(length: Any, duration: NDArray[np.float64], least: int, most: int) -> NDArray[np.int64]:
    """Return the number of steps of at most `length` in `duration`, clipped to the range from `least` to `most`."""
    count = np.ceil(np.minimum(duration / length, float(most)) - 1e-9)
    return np.maximum(count, least).astype(np.int64)


def steps_between_instants(
    settings: StepSettings, steps: NDArray[np.int64], duration: NDArray[np.float64], intervals: int
) -> NDArray[np.int64]:
    """Return the number of steps in each of `intervals` equal parts of a run of `steps` steps. A given `settings.step` replaces `steps`."""
    if settings.step is None:
        return -(-steps // intervals)
    return steps_of_length(settings.step, duration / intervals, 1, max(settings.max_steps // intervals, 1))


def count_ladder(count: NDArray[np.float64]) -> NDArray[np.int64]:
    """Round numbers of steps up to multiples of 16 near 16 times powers of 2^(1/4), so that many points share a number."""
    exponent = np.ceil(4 * np.log2(np.maximum(count / MAX_STEPS_PER_SAMPLE, 1.0)) - 1e-9)
    rounded = np.ceil(2.0 ** (exponent / 4) - 1e-9) * MAX_STEPS_PER_SAMPLE
    return rounded.astype(np.int64)
