"""How many steps each point takes, and how often it is sampled: from that point and the settings alone."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .sampling import MIN_INTERVALS
from .tableaux import METHODS, Method

MAX_STEPS_PER_SAMPLE = 16
# Share of the rate tolerance that an automatic step may spend on a motion that turns at the frequency bound.
RATE_ERROR_BUDGET = 0.1
ROUNDING = 1e-16


class StepSizeSettings(Protocol):
    """What step sizes depend on beside the point; `scene.model.Settings` is one."""

    @property
    def method(self) -> str:
        """Key of tableaux.METHODS."""

    @property
    def tolerance(self) -> float:
        """Phase error of an oscillation at the frequency bound at the end of the run, rad."""

    @property
    def step(self) -> float | None:
        """Largest step in time units, instead of the tolerance."""

    @property
    def max_steps(self) -> int:
        """Largest number of steps."""

    @property
    def rate_tolerance(self) -> float:
        """Variation of a rate that counts as none, rad per time unit."""


@dataclass(frozen=True)
class StepSizes:
    """Step sizes of an ensemble and the errors to expect from them.

    Attributes
    ----------
    steps : ndarray of int64, shape (points,)
        Number of steps.
    steps_per_sample, samples_per_step : ndarray of int64, shape (points,)
        One of the two is 1.
    step_size : ndarray of float64, shape (points,)
        In time units.
    step_ratio : ndarray of float64, shape (points,)
        step_size times frequency bound, over the stability limit of the method.
    dispersion_error : ndarray of float64, shape (points,)
        Phase error of an oscillation at the frequency bound at the end of the run, rad.
    dissipation_error : ndarray of float64, shape (points,)
        Relative loss of its amplitude by then.
    rate_error : ndarray of float64, shape (points,)
        Expected variation of a steady rate as large as the bound, rad per time unit.
    """

    steps: NDArray[np.int64]
    steps_per_sample: NDArray[np.int64]
    samples_per_step: NDArray[np.int64]
    step_size: NDArray[np.float64]
    step_ratio: NDArray[np.float64]
    dispersion_error: NDArray[np.float64]
    dissipation_error: NDArray[np.float64]
    rate_error: NDArray[np.float64]

    @classmethod
    def of(
        cls, settings: StepSizeSettings, bound: NDArray[np.float64], duration: NDArray[np.float64]
    ) -> StepSizes:
        """Step sizes of points with these frequency bounds (rad per time unit) and durations (time units).

        With `settings.step` steps are at most that long. Otherwise they are so short that the phase error of an
        oscillation at the bound stays within `settings.tolerance`, and that neither its loss of amplitude nor the
        local error lets a steady rate as large as the bound vary by more than RATE_ERROR_BUDGET of the rate tolerance.
        `settings.max_steps` is never exceeded: the errors then show what that costs. A point without finite bound
        gets the fewest steps and an infinite step ratio.
        """
        method = METHODS[settings.method]
        finite = np.isfinite(bound) & np.isfinite(duration)
        radians = np.where(finite, bound * duration, 0.0)
        if settings.step is None:
            steps = count_ladder(_automatic_steps(method, settings, bound, radians, finite))
        else:
            count = np.where(finite, duration, 0.0) / settings.step
            steps = np.ceil(np.minimum(count, float(settings.max_steps)) - 1e-9)
            steps = np.maximum(steps, 1).astype(np.int64)
        steps_per_sample, samples_per_step = _sampling(method, radians / steps, steps)
        steps = -(-steps // steps_per_sample) * steps_per_sample
        radians = np.where(finite, radians, np.inf)  # no step resolves an infinite frequency
        y = radians / steps
        dispersion = method.dispersion * y**method.order
        dissipation_error = radians * method.dissipation * y ** (method.dissipation_order - 1)
        return cls(
            steps=steps,
            steps_per_sample=steps_per_sample,
            samples_per_step=samples_per_step,
            step_size=duration / steps,
            step_ratio=y / method.stability,
            dispersion_error=radians * dispersion,
            dissipation_error=dissipation_error,
            rate_error=bound * (dispersion + dissipation_error + ROUNDING * np.sqrt(steps)),
        )

    @property
    def intervals(self) -> NDArray[np.int64]:
        """Intervals between the samples of the whole run."""
        return self.steps // self.steps_per_sample * self.samples_per_step

    @property
    def nodes(self) -> NDArray[np.int64]:
        """Nodes of the kernel over the whole run; see `kernel`."""
        return self.steps // self.steps_per_sample + (self.samples_per_step > 1)

    @property
    def sample_spacing(self) -> NDArray[np.float64]:
        """Time between two samples, time units."""
        return self.step_size * self.steps_per_sample / self.samples_per_step

    def subset(self, where: NDArray[np.int64]) -> StepSizes:
        """Those of some points, by their indices."""
        return StepSizes(**{field.name: getattr(self, field.name)[where] for field in fields(self)})

    def halved(self, method: Method) -> StepSizes:
        """Twice as many steps of half the size, sampled twice as often."""
        return replace(
            self,
            steps=2 * self.steps,
            step_size=self.step_size / 2,
            step_ratio=self.step_ratio / 2,
            dispersion_error=self.dispersion_error / 2**method.order,
            dissipation_error=self.dissipation_error / 2 ** (method.dissipation_order - 1),
            rate_error=self.rate_error / 2**method.order,
        )


def count_ladder(count: NDArray[np.float64]) -> NDArray[np.int64]:
    """Round counts up to 16, 32, 48, ..., as near as may be to powers of 2^(1/4), so that points share lanes."""
    exponent = np.ceil(4 * np.log2(np.maximum(count / MAX_STEPS_PER_SAMPLE, 1.0)) - 1e-9)
    rounded = np.ceil(2.0 ** (exponent / 4) - 1e-9) * MAX_STEPS_PER_SAMPLE
    return rounded.astype(np.int64)


def _automatic_steps(
    method: Method,
    settings: StepSizeSettings,
    bound: NDArray[np.float64],
    radians: NDArray[np.float64],
    finite: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Steps, not yet whole, that keep the errors of StepSizes.of within the tolerances."""
    with np.errstate(divide="ignore"):
        y = (settings.tolerance / (method.dispersion * np.maximum(radians, 1e-300))) ** (1 / method.order)
        relative_rate = (
            RATE_ERROR_BUDGET * settings.rate_tolerance / np.where(finite, np.maximum(bound, 1e-300), 1.0)
        )
        y = np.minimum(y, (relative_rate / method.dispersion) ** (1 / method.order))
        dissipation = relative_rate / (method.dissipation * np.maximum(radians, 1e-300))
        y = np.minimum(y, dissipation ** (1 / (method.dissipation_order - 1)))
    return np.asarray(np.minimum(radians / y, float(settings.max_steps)))


def _sampling(
    method: Method, y: NDArray[np.float64], steps: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """steps_per_sample and samples_per_step for steps of y radians at the frequency bound.

    The quadrature rule has order 8 in the sample spacing; its error is kept at that of the phase. (For rk8 the spacing
    needs to fall no faster than the root of y, as measured.)
    """
    with np.errstate(divide="ignore"):
        spacing = (120 * method.dispersion) ** (1 / 8) * np.where(y > 0, y, 1e-12) ** -0.5  # in steps
    samples_per_step = np.ceil(np.clip(1 / spacing, 1, method.max_samples)).astype(np.int64)
    samples_per_step[steps < MIN_INTERVALS] = 1
    spacing = np.minimum(spacing, steps / MIN_INTERVALS)
    steps_per_sample = 2 ** np.floor(np.log2(np.clip(spacing, 1, MAX_STEPS_PER_SAMPLE))).astype(np.int64)
    return steps_per_sample, samples_per_step
