"""Indicators of chaos: mean MEGNO and the largest Lyapunov exponent of every point of an ensemble."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ..systems.base import Array, Mask, System
from . import blocks, tangent, tangent_space
from .ensemble import Ensemble
from .generated import WIDTH
from .stepsize import count_ladder, steps_of_length
from .tableaux import METHODS

# Instants of a run at which the tangent vector is divided by its norm and the sums are taken, at least.
NODES = 1024
# Steps between two of them at most: a tangent vector grows by less than e^700 in as many, so that it cannot overflow.
MAX_STEPS_PER_NODE = 1000
# The method of these runs, whatever the method of the others: of the two it needs the least time for a given error.
METHOD = METHODS["rk8"]
# Largest step times frequency bound: longer steps make regular motions look chaotic, shorter ones change MEGNO of regular
# motions by less than 0.01.
MAX_RADIANS_PER_STEP = 0.3
# Largest loss of an amplitude by dissipation during a run: it lowers MEGNO.
MAX_DISSIPATION_ERROR = 0.01
# Time of a step with a tangent vector over that of a step with statistics, see bench_engine.py.
RELATIVE_COST = 1.5
# Chaos and one passage of an unstable motion, from nearby and back, both let a tangent vector grow. A regular motion that
# returns to within a distance d of an unstable one has a tangent vector along its own velocity, which falls by a factor d:
# L has a drawdown of ln(1/d). At d = 1e-6 to 1e-8 truncation and rounding errors carry the run across the separatrix, and
# growth is theirs: drawdowns of 14 to 22 were measured, along chaotic motions of at most 7.
MAX_DRAWDOWN = 10.0
# Until it returns, L grows by ln(1/d^2) or less, where rounding errors of 1e-16 are the least d^2: 39 was measured.
MAX_PASSAGE_GROWTH = 50.0
# Durations for which a run goes on at most until it has passed one of these two limits.
MAX_DURATIONS = 16


@dataclass(frozen=True)
class TangentSteps:
    """Steps of the runs with tangent vectors; arrays of shape (points,)."""

    steps: NDArray[np.int64]
    step_size: Array  # in time units
    resolved: Mask  # whether the steps are short enough for the indicators

    @classmethod
    def of(cls, bound: Array, duration: Array, step: float | None, max_steps: int) -> TangentSteps:
        """Step sizes of points with these frequency bounds (rad per time unit) and durations (time units).

        step: largest step in time units, instead of one that is short enough; max_steps: largest number of
        steps before it is rounded up.
        """
        radians = bound * duration
        finite = np.isfinite(radians)
        radians = np.where(finite, radians, 0.0)
        if step is None:
            loss = MAX_DISSIPATION_ERROR / (METHOD.dissipation * np.maximum(radians, 1e-300))
            y = np.minimum(MAX_RADIANS_PER_STEP, loss ** (1 / (METHOD.dissipation_order - 1)))
            steps = count_ladder(np.minimum(radians / y, float(max_steps)))
        else:
            steps = steps_of_length(step, np.where(finite, duration, 0.0), 1, max_steps)
        y = radians / steps
        lost = radians * METHOD.dissipation * y ** (METHOD.dissipation_order - 1)
        rounding = 1.0 + 1e-9
        short = (y <= MAX_RADIANS_PER_STEP * rounding) & (lost <= MAX_DISSIPATION_ERROR * rounding)
        return cls(steps, duration / steps, finite & short)

    @property
    def nodes(self) -> NDArray[np.int64]:
        """Instants at which the tangent vectors are divided by their norms."""
        return np.minimum(np.maximum(NODES, -(-self.steps // MAX_STEPS_PER_NODE)), self.steps)

    def subset(self, where: NDArray[np.int64]) -> TangentSteps:
        """Those of some points, by their indices."""
        return TangentSteps(self.steps[where], self.step_size[where], self.resolved[where])


class Separation:
    """Tangent vectors of an ensemble, integrated with it for its durations and, where that does not decide, for longer.

    kernel: see `specialization.tangent_kernel`; rate_unit: see `System.rate_unit`.
    """

    def __init__(
        self, system: System, kernel: ModuleType, ensemble: Ensemble, steps: TangentSteps, rate_unit: Array
    ) -> None:
        self.kernel, self.steps = kernel, steps
        self.state, self.constants = ensemble.state.copy(), ensemble.constants
        with np.errstate(all="ignore"):
            unit = steps.step_size / METHOD.kernel_step
            self.weights = _norm_weights(system, ensemble, unit, rate_unit)
            start = tangent_space.start(system.equations, self.state)
            self.vectors = np.ascontiguousarray(start / self.weights)
        self.durations = np.zeros(ensemble.size, np.int64)  # integrated so far
        self.sums = np.empty((tangent.SUMS, ensemble.size))

    @property
    def megno(self) -> Array:
        """Mean MEGNO up to now, (points,); nan or infinite where numbers overflow."""
        with np.errstate(all="ignore"):
            return np.asarray(self.sums[tangent.MEGNO_INTEGRAL] / (self.durations * self.steps.steps))

    @property
    def lyapunov(self) -> Array:
        """Largest Lyapunov exponent up to now, per time unit, (points,); nan or infinite where numbers overflow."""
        with np.errstate(all="ignore"):
            time = self.steps.step_size * (self.durations * self.steps.steps)
            return np.asarray(self.sums[tangent.LOG_GROWTH] / time)

    def integrate(
        self,
        where: NDArray[np.int64] | None = None,
        *,
        threads: int | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Integrate all points, or some by their indices, that all have run for as long, for one more duration.

        threads, progress: see `blocks.integrate`.
        """
        where = np.arange(self.durations.size) if where is None else where
        schedule = blocks.pack_blocks(self.steps.steps[where], self.steps.nodes[where])
        points, nodes = where[schedule.points], schedule.steps_per_sample
        first_node = self.durations[points[:, 0]] * nodes

        def call(first: int, last: int, begin: NDArray[np.int64], end: NDArray[np.int64]) -> None:
            self.kernel.integrate(
                first, last, points, MAX_DURATIONS * schedule.steps, MAX_DURATIONS * nodes, begin, end,
                self.steps.step_size, self.state, self.constants, self.vectors, self.weights, self.sums,
            )  # fmt: skip

        blocks.call_by_parts(call, schedule.steps * WIDTH, first_node, first_node + nodes, threads, progress)
        self.durations[where] += 1

    @property
    def passes_unstable_motion(self) -> Mask:
        """Whether errors may decide how motions leave an unstable one: after growth, not where all neighbours come nearer."""
        highest, drawdown = self.sums[tangent.HIGHEST], self.sums[tangent.DRAWDOWN]
        return np.asarray((drawdown > MAX_DRAWDOWN) & (highest > MAX_DRAWDOWN))

    def is_sustained(
        self,
        where: NDArray[np.int64],
        *,
        threads: int | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Mask:
        """Whether the vectors of points, by their indices, grow by more than one passage of an unstable motion explains.

        Runs of points that have not grown by as much go on. threads, progress: see `blocks.integrate`.
        """
        drawdown, log_growth = self.sums[tangent.DRAWDOWN], self.sums[tangent.LOG_GROWTH]  # views
        active = where
        for duration in range(1, MAX_DURATIONS + 1):
            active = active[(drawdown[active] <= MAX_DRAWDOWN) & (log_growth[active] <= MAX_PASSAGE_GROWTH)]
            if duration < MAX_DURATIONS and active.size:
                self.integrate(active, threads=threads, progress=progress)
        return (drawdown[where] <= MAX_DRAWDOWN) & (log_growth[where] > MAX_PASSAGE_GROWTH)


def _norm_weights(system: System, ensemble: Ensemble, unit: Array, rate_unit: Array) -> Array:
    """Factors of the components of a tangent vector, in the kernel's units, in its norm: (components, points)."""
    equations = system.equations
    constants = equations.scaled(ensemble.state, ensemble.constants, unit)[1]
    ones = np.ones_like(ensemble.state)
    in_caller_units = equations.unscaled(ones, constants, unit)  # of changes by 1, for the units are factors
    rows = [
        in_caller_units[i]
        / (rate_unit if equations.STATE[i] in system.rate_states else 1.0)
        * np.ones_like(unit)
        for i in tangent_space.own_components(equations)
    ]
    if tangent_space.rotates(equations):
        rows += 3 * [np.ones_like(unit)]
    return np.ascontiguousarray(rows)
