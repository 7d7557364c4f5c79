"""How many steps each point takes, and how often it is sampled: from that point and the scene alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .measure import MIN_INTERVALS
from .tableaux import Method

MAX_STEPS_PER_SAMPLE = 16
# Share of the rate tolerance that an automatic step may spend on a motion that turns at the bound.
RATE_ERROR_BUDGET = 0.1
ROUNDING = 1e-16


@dataclass(frozen=True)
class StepSizes:
    """Step counts and what is known beforehand about them, each of shape (points,)."""

    count: NDArray[np.int64]
    stride: NDArray[np.int64]  # steps between two looks at the motion
    parts: NDArray[np.int64]  # samples of the statistics from one look to the next
    length: NDArray[np.float64]  # time units
    step_ratio: NDArray[np.float64]  # length * bound / stability limit
    phase_error: NDArray[np.float64]  # of an oscillation at the bound, rad at the end of the run
    hidden_damping: NDArray[np.float64]  # its relative loss of amplitude
    rate_error: NDArray[np.float64]  # of a steady rate as large as the bound, rad per time unit

    @property
    def intervals(self) -> NDArray[np.int64]:
        """Between the samples of the whole run."""
        return self.count // self.stride * self.parts

    @property
    def distance(self) -> NDArray[np.float64]:
        """Between two samples, time units."""
        return self.length * self.stride / self.parts

    def halved(self, method: Method) -> StepSizes:
        """Twice as many steps of half the length, sampled twice as often."""
        return replace(
            self,
            count=2 * self.count,
            length=self.length / 2,
            step_ratio=self.step_ratio / 2,
            phase_error=self.phase_error / 2**method.order,
            hidden_damping=self.hidden_damping / 2 ** (method.damping_order - 1),
            rate_error=self.rate_error / 2**method.order,
        )


def count_ladder(count: NDArray[np.float64]) -> NDArray[np.int64]:
    """Round up to 16, 32, 48, ... as near as may be to powers of 2^(1/4), so that points share lanes."""
    rung = np.ceil(4 * np.log2(np.maximum(count / MAX_STEPS_PER_SAMPLE, 1.0)) - 1e-9)
    low = np.ceil(2.0 ** (rung / 4) - 1e-9) * MAX_STEPS_PER_SAMPLE
    return low.astype(np.int64)


def choose(
    method: Method,
    bound: NDArray[np.float64],
    duration: NDArray[np.float64],
    *,
    tolerance: float,
    step: float | None,
    max_steps: int,
    rate_tolerance: float = np.inf,
) -> StepSizes:
    """Steps of each point: at most `step` long if given, else so that the phase error of an oscillation
    at the frequency bound (rad per time unit) reaches `tolerance` rad after `duration` (time units), or
    earlier where the loss of amplitude or the local error would let a steady rate as large as the bound
    vary by SHARE of rate_tolerance (rad per time unit).

    More than max_steps are never taken: step_ratio and phase_error then tell what that costs. A point
    without finite bound gets the fewest steps and an infinite step_ratio.
    """
    usable = np.isfinite(bound) & np.isfinite(duration)
    turns = np.where(usable, bound * duration, 0.0)
    if step is None:
        with np.errstate(divide="ignore"):
            y = (tolerance / (method.phase * np.maximum(turns, 1e-300))) ** (1 / method.order)
            rate = RATE_ERROR_BUDGET * rate_tolerance / np.where(usable, np.maximum(bound, 1e-300), 1.0)
            y = np.minimum(y, (rate / method.phase) ** (1 / method.order))
            y = np.minimum(
                y, (rate / (method.damping * np.maximum(turns, 1e-300))) ** (1 / (method.damping_order - 1))
            )
        count = count_ladder(np.minimum(turns / y, float(max_steps)))
    else:
        count = np.ceil(np.minimum(np.where(usable, duration, 0.0) / step, float(max_steps)) - 1e-9)
        count = np.maximum(count, 1).astype(np.int64)
    y = turns / count
    # The rule of the statistics has order 8 in the sampling distance: keep its error at that of the phase
    # (for rk8, too: there the distance needs to fall no faster than the root of y, as measured).
    with np.errstate(divide="ignore"):
        wanted = (120 * method.phase) ** (1 / 8) * np.where(y > 0, y, 1e-12) ** -0.5
    parts = np.ceil(np.clip(1 / wanted, 1, method.parts)).astype(np.int64)
    parts[count < MIN_INTERVALS] = 1
    wanted = np.minimum(wanted, count / MIN_INTERVALS)
    stride = 2 ** np.floor(np.log2(np.clip(wanted, 1, MAX_STEPS_PER_SAMPLE))).astype(np.int64)
    count = -(-count // stride) * stride
    turns = np.where(usable, turns, np.inf)  # what no step resolves
    y = turns / count
    damping = turns * method.damping * y ** (method.damping_order - 1)
    return StepSizes(
        count,
        stride,
        parts,
        duration / count,
        y / method.stability,
        turns * method.phase * y**method.order,
        damping,
        bound * (method.phase * y**method.order + damping + ROUNDING * np.sqrt(count)),
    )
