"""Number and size of the integration steps of each point; other points have no influence on them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .sampling import MIN_INTERVALS
from .tableaux import METHODS, Method

MAX_STEPS_PER_SAMPLE = 16
# Largest error of a rate by automatic steps, divided by the rate tolerance, in a motion at the frequency bound.
RATE_ERROR_BUDGET = 0.1
ROUNDING = 1e-16  # relative rounding error of the state at the start, and of each step
# A run is resolved up to this step ratio and this dissipation error.
MAX_STEP_RATIO, MAX_DISSIPATION_ERROR = 0.5, 0.1
# Number of steps of an unresolved run, which gets no label in any case: enough steps to show an overflow.
STEPS_UNRESOLVED = 64
MIN_NODES_PER_PERIOD = 8
GOLDEN_SECTION = 0.5 * (5**0.5 - 1.0)
# Error of an oscillation that is interpolated between four nodes x rad apart, divided by x^8.
INTERPOLATION_ERROR = 81 / 256 / 40320


class StepSettings(Protocol):
    """Settings that determine steps, see `scene.model.Settings`."""

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
    """Step sizes of an ensemble and the errors to expect from them."""

    steps: NDArray[np.int64]  # number of steps
    steps_per_sample: NDArray[np.int64]  # steps between two nodes of the statistics
    step_size: NDArray[np.float64]  # in time units
    step_ratio: NDArray[np.float64]  # step_size x frequency bound / stability limit of the method
    # At the end of the run, for an oscillation at the frequency bound: phase error in rad, relative loss of amplitude
    dispersion_error: NDArray[np.float64]
    dissipation_error: NDArray[np.float64]
    # Expected variation, by errors of the steps, of a steady rate that is as large as the bound, rad per time unit
    rate_error: NDArray[np.float64]
    # Number of periods in the run, each with equally many nodes; 0 without strobed observables
    periods: NDArray[np.int64]
    transient: NDArray[np.float64]  # time before the run, time units
    transient_steps: NDArray[np.int64]  # number of steps in this time; they are about as long as in the run

    @classmethod
    def of(
        cls,
        settings: StepSettings,
        bound: NDArray[np.float64],
        duration: NDArray[np.float64],
        step: NDArray[np.float64] | None = None,
    ) -> StepSizes:
        """Step sizes of points with these frequency bounds (rad per time unit) and durations (time units).

        Steps are at most as long as `step`, (points,), or else `settings.step`. Without both, the phase error of an
        oscillation at the bound stays within `settings.tolerance`, and neither its loss of amplitude nor the local error lets a
        steady rate as large as the bound vary by more than RATE_ERROR_BUDGET of the rate tolerance. `settings.max_steps` limits
        the number of steps before rounding up, at the cost of larger errors. A point without a finite bound gets the fewest steps
        and an infinite step ratio.
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
                # A body at rest needs no steps, also where the tolerances are so small that y underflows to 0.
                count = np.divide(radians, y, out=np.zeros_like(radians), where=radians > 0)
            steps = count_ladder(np.minimum(count, float(settings.max_steps)))
        else:
            run = np.where(finite, duration, 0.0)
            steps = steps_of_length(length, run, MIN_INTERVALS, settings.max_steps)
        y = radians / steps
        # steps_per_sample is a power of 2 that keeps the interpolation error, of order 8, below a tenth of the phase error.
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
        """Step sizes if these runs consist of a transient and a duration after it; the errors are those of the whole runs."""
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
        """Number of steps from the start, the transient included."""
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
        """The same step sizes, but at most STEPS_UNRESOLVED steps and no transient at unresolved points."""
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
        """The same runs with twice as many steps and nodes where the mask is true."""
        return self._in_steps(np.where(where, 2, 1) * self.steps, self.steps_per_sample, method)

    def coarsened(self, method: Method) -> StepSizes:
        """The same runs with half as many steps, rounded up."""
        steps = np.maximum(-(-self.steps // 2), MIN_INTERVALS)
        return self._in_steps(steps, np.gcd(steps, self.steps_per_sample), method)

    def incommensurate(self, method: Method) -> StepSizes:
        """The same runs with about 0.618 times as many steps (golden section), so that old and new runs share hardly any node.

        If a motion is faster than the steps and looks slow at the old nodes, it looks different at the new ones: the golden section
        is the number farthest from all fractions with small denominators.
        """
        nodes, periods = self.nodes_per_period, np.maximum(self.periods, 1)
        fewer = (GOLDEN_SECTION * nodes).astype(np.int64) | 1
        for _ in range(3):  # the next odd number, where fewer and nodes have a common factor above 3
            fewer = np.where(np.gcd(fewer, nodes) > 3, fewer + 2, fewer)
        intervals = np.where(fewer * periods >= MIN_INTERVALS, fewer, 2 * nodes - 1) * periods
        return self._in_steps(intervals * self.steps_per_sample, self.steps_per_sample, method)

    def in_periods(self, periods: NDArray[np.int64] | None, method: Method) -> StepSizes:
        """The same runs with equally many nodes in each period; periods: their number in each run; None changes nothing."""
        if periods is None:
            return self
        steps = np.maximum(self.steps, MIN_NODES_PER_PERIOD * periods * self.steps_per_sample)
        return replace(self, periods=periods)._in_steps(steps, self.steps_per_sample, method)

    def _in_steps(
        self, steps: NDArray[np.int64], steps_per_sample: NDArray[np.int64], method: Method
    ) -> StepSizes:
        """The same runs with other numbers of steps, rounded up so that all periods have equally many nodes."""
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
    """Number of steps no longer than `length`, but at least `least` and at most `most`."""
    count = np.ceil(np.minimum(duration / length, float(most)) - 1e-9)
    return np.maximum(count, least).astype(np.int64)


def steps_between_instants(
    settings: StepSettings, steps: NDArray[np.int64], duration: NDArray[np.float64], intervals: int
) -> NDArray[np.int64]:
    """Steps in each of `intervals` equal parts of runs; they are at most as long as with `steps` in all, or as `settings.step`."""
    if settings.step is None:
        return -(-steps // intervals)
    return steps_of_length(settings.step, duration / intervals, 1, max(settings.max_steps // intervals, 1))


def count_ladder(count: NDArray[np.float64]) -> NDArray[np.int64]:
    """Round counts up to a ladder 16, 32, 48, ... near powers of 2^(1/4), so that points share lanes."""
    exponent = np.ceil(4 * np.log2(np.maximum(count / MAX_STEPS_PER_SAMPLE, 1.0)) - 1e-9)
    rounded = np.ceil(2.0 ** (exponent / 4) - 1e-9) * MAX_STEPS_PER_SAMPLE
    return rounded.astype(np.int64)
