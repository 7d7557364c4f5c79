"""Runs with a tangent vector, which give the indicators of chaos. Only plans that have tangent runs import this module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..flags import Label, Regularity, Status
from ..kernel import augmented, blocks, tangent
from ..kernel.ensemble import Ensemble
from ..kernel.generated import WIDTH
from ..kernel.stepsize import StepSettings, StepSizes, count_ladder, steps_of_length
from ..kernel.tableaux import METHODS
from ..kernel.tableaux import TANGENT_METHOD as METHOD
from ..systems.base import Array, Flags, Mask, Points, System, shape_of
from .rates import tolerated_error

# Least number of nodes of a run. At each node the tangent vector is divided by its norm, and its growth is added to the sums.
NODES = 1024
# Largest number of steps between two nodes. A tangent vector grows by less than e^700 in these steps and cannot overflow.
MAX_STEPS_PER_NODE = 1000
# Largest product of step and frequency bound. Longer steps make regular motions look chaotic. Shorter steps change the MEGNO of
# regular motions by less than 0.01.
MAX_RADIANS_PER_STEP = 0.3
# Largest relative loss of amplitude by numerical dissipation during a run. A loss of amplitude lowers MEGNO.
MAX_DISSIPATION_ERROR = 0.01
# A tangent run for the growth alone must agree with the main run only until the main run's error reaches some per cent. The step is
# GROWTH_STEP h if rk8 with the step h has the main run's error, but at most MAX_RADIANS_FOR_GROWTH / (frequency bound).
GROWTH_STEP, MAX_RADIANS_FOR_GROWTH = 3.0, 1.5
# Run time of a step with a tangent vector, divided by the run time of a step with statistics. See bench_engine.py.
RELATIVE_COST = 1.5
# Largest fall of L, the logarithm of the growth of a tangent vector. The vector grows in chaos, but also while a regular motion
# leaves the neighbourhood of an unstable motion. If the regular motion returns to a distance d, a vector along the velocity shrinks
# by the factor d, and L falls by ln(1/d). If d is 1e-6 to 1e-8, truncation and rounding errors carry the run across the separatrix
# and cause the growth. Falls of 14 to 22 were then measured. Along chaotic motions falls were at most 7.
MAX_DRAWDOWN = 10.0
# Bound of the growth of L near an unstable motion, at d > 1e-8 (see MAX_DRAWDOWN). Theory gives about ln(1/d^2) < 37. Runs gave up to 39.
MAX_PASSAGE_GROWTH = 50.0
# Limits of mean MEGNO. In regular motions MEGNO tends to 2 or less. In chaos MEGNO grows like L / 2. For L see MAX_DRAWDOWN.
MAX_REGULAR, MIN_CHAOTIC = 2.5, 5.0
# A chaotic run ends when L (see MAX_DRAWDOWN) falls by MAX_DRAWDOWN or reaches MAX_PASSAGE_GROWTH, or after this many durations.
MAX_DURATIONS = 16


@dataclass(frozen=True)
class TangentSteps:
    """Steps of the runs with tangent vectors. Arrays have shape (points,)."""

    steps: NDArray[np.int64]
    step_size: Array  # in time units
    resolved: Mask  # whether the steps are short enough for the indicators

    @classmethod
    def of(
        cls, bound: Array, duration: Array, step: float | None, max_steps: int, error: Array | None = None
    ) -> TangentSteps:
        """Return steps of at most `step`, if given, for frequency bounds (rad per time unit) and durations.

        If tangent runs give the growth alone, `error` is the relative error of the main runs, see GROWTH_STEP.
        """
        radians = bound * duration
        finite = np.isfinite(radians)
        radians = np.where(finite, radians, 0.0)
        if error is not None:
            y = GROWTH_STEP * (error / (METHOD.dispersion * np.maximum(radians, 1e-300))) ** (
                1 / METHOD.order
            )
            steps = count_ladder(
                np.minimum(radians / np.minimum(y, MAX_RADIANS_FOR_GROWTH), float(max_steps))
            )
            short = radians / steps <= MAX_RADIANS_FOR_GROWTH * (1.0 + 1e-9)
            return cls(steps, duration / steps, finite & short)
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
        """Number of nodes of each run."""
        return np.minimum(np.maximum(NODES, -(-self.steps // MAX_STEPS_PER_NODE)), self.steps)

    def subset(self, where: NDArray[np.int64]) -> TangentSteps:
        return TangentSteps(self.steps[where], self.step_size[where], self.resolved[where])


class TangentArrays(NamedTuple):
    """Data of points that the tangent kernel reads and writes. Other kernels have `blocks.Arrays`."""

    step_size: Array
    state: Array
    constants: Array
    vectors: Array  # in the kernel's units, (kernel.TANGENT, points)
    weights: Array  # factors of the vectors' components in the norm, (kernel.TANGENT, points)
    sums: Array  # (len(tangent.Growth), points)


def rate_unit(system: System, points: Points, without_frame: Array | float = 1.0) -> Array:
    """Return the unit of angular velocities in norms of tangent vectors: the rate of the frame, or `without_frame` if no frame turns.

    The Lyapunov exponent of a finite run depends a little on this unit. The limit for long runs does not.
    """
    rate = np.abs(system.frame_rate(points)) if system.frame_rate else np.zeros(shape_of(points))
    return np.where(rate > 0, rate, without_frame)


class Separation:
    """Tangent vectors of an ensemble. Each call of `integrate` continues the vectors of some points for one duration."""

    def __init__(
        self, system: System, kernel: ModuleType, ensemble: Ensemble, steps: TangentSteps, rate_unit: Array
    ) -> None:
        self.kernel, self.steps = kernel, steps
        self.state, self.constants = ensemble.state.copy(), ensemble.constants
        with np.errstate(all="ignore"):
            unit = steps.step_size / METHOD.kernel_step
            # The norm of a tangent vector is the Euclidean norm of its components in the kernel's units, each times a weight.
            equations = system.equations
            constants = equations.scaled(self.state, self.constants, unit)[1]
            # The conversion of a state of ones gives the factors by which the units of the components change.
            in_caller_units = equations.unscaled(np.ones_like(self.state), constants, unit)
            rows = [
                in_caller_units[i]
                / (rate_unit if equations.STATE[i] in system.rate_states else 1.0)
                * np.ones_like(unit)
                for i in augmented.own_components(equations)
            ]
            if augmented.rotates(equations):
                rows += 3 * [np.ones_like(unit)]
            self.weights = np.ascontiguousarray(rows)
            start = augmented.tangent_start(equations, self.state)
            self.vectors = np.ascontiguousarray(start / self.weights)
        self.durations = np.zeros(ensemble.size, np.int64)  # number of durations integrated so far
        self.sums = np.empty((len(tangent.Growth), ensemble.size))

    @property
    def megno(self) -> Array:
        """Mean MEGNO up to now, (points,). It is nan or infinite where numbers overflow."""
        with np.errstate(all="ignore"):
            return np.asarray(self.sums[tangent.Growth.MEGNO_INTEGRAL] / (self.durations * self.steps.steps))

    @property
    def lyapunov(self) -> Array:
        """Largest Lyapunov exponent up to now, per time unit, (points,). It is nan or infinite where numbers overflow."""
        with np.errstate(all="ignore"):
            time = self.steps.step_size * (self.durations * self.steps.steps)
            return np.asarray(self.sums[tangent.Growth.LOG_GROWTH] / time)

    def integrate(
        self, where: NDArray[np.int64] | None = None, *, threads: blocks.Threads = blocks.ALL_THREADS
    ) -> None:
        """Integrate the points `where`, which have completed the same number of durations, for one more duration."""
        where = np.arange(self.durations.size) if where is None else where
        schedule = blocks.pack_blocks(self.steps.steps[where], self.steps.nodes[where])
        points, nodes = where[schedule.points], schedule.steps_per_sample
        first_node = self.durations[points[:, 0]] * nodes

        longest = blocks.BlockSchedule(points, MAX_DURATIONS * schedule.steps, MAX_DURATIONS * nodes)
        arrays = TangentArrays(
            self.steps.step_size, self.state, self.constants, self.vectors, self.weights, self.sums
        )
        call = partial(self.kernel.integrate, longest, arrays)
        blocks.call_by_parts(call, schedule.steps * WIDTH, first_node, first_node + nodes, threads)
        self.durations[where] += 1


@dataclass(frozen=True)
class TangentRuns:
    """Points that are ready to be integrated with a tangent vector. Arrays have shape (points,)."""

    system: System
    kernel: ModuleType  # see `kernel.specialization.tangent_kernel`
    ensemble: Ensemble
    steps: TangentSteps
    rate_unit: Array  # unit of angular velocities in norms of tangent vectors
    share: float  # work of these runs, divided by the work of all runs of the points

    @classmethod
    def of(
        cls,
        system: System,
        kernel: ModuleType,
        ensemble: Ensemble,
        points: Points,
        duration: Array,
        settings: StepSettings,
        step_sizes: StepSizes,
        *,
        has_chaos: bool,
    ) -> TangentRuns:
        """Return tangent runs for main runs with `step_sizes`. If `has_chaos` is false, the runs give the growth alone."""
        bound = ensemble.frequency_bound
        with np.errstate(all="ignore"):
            error = None if has_chaos else tolerated_error(settings, step_sizes, bound)
            steps = TangentSteps.of(bound, duration, settings.step, settings.max_steps, error)
            # The growth decides flags, which must not depend on the unit of time.
            unit = rate_unit(system, points, 1.0 if has_chaos else system.natural_rate(points))
        own = METHODS[settings.method].step_cost * float(step_sizes.without_unresolved().whole_steps.sum())
        work = RELATIVE_COST * METHOD.step_cost * float(steps.steps[steps.resolved].sum())
        return cls(system, kernel, ensemble, steps, unit, work / (own + work))

    def _separation(self, where: NDArray[np.int64], threads: blocks.Threads) -> Separation:
        """Return tangent vectors of the points `where` after the runs. Progress advances by `share` times the number of all points."""
        steps = self.steps.subset(where)
        separation = Separation(
            self.system, self.kernel, self.ensemble.subset(where), steps, self.rate_unit[where]
        )
        points_per_step = self.rate_unit.size * self.share / float(steps.steps.sum())
        separation.integrate(threads=threads.scaled(points_per_step))
        return separation

    def growth(self, where: Mask, threads: blocks.Threads) -> Array:
        """Return the logarithm of the largest growth of a tangent vector. Progress advances by `share` times the number of all points.

        The result is infinite where the steps do not resolve the growth, and nan outside `where`.
        """
        result = np.where(where, np.inf, np.nan)
        resolved = np.flatnonzero(where & self.steps.resolved)
        if resolved.size:
            separation = self._separation(resolved, threads)
            result[resolved] = np.nan_to_num(separation.sums[tangent.Growth.HIGHEST], nan=np.inf)
        else:
            threads.progress(where.size * self.share)
        return result

    def variables(
        self, columns: Mapping[str, np.ndarray], unstable: Mask, threads: blocks.Threads
    ) -> dict[str, np.ndarray]:
        """Return variables of chaos, missing where the status is not ok. Progress advances by `share` times the number of all points."""
        size = self.rate_unit.size
        megno, lyapunov = np.full(size, np.nan), np.full(size, np.nan)
        flags = np.full(size, Regularity.NOT_COMPUTED, np.int8)
        where = np.flatnonzero(columns["status"] == Status.OK)
        if not where.size:
            threads.progress(size * self.share)
            return {"megno": megno, "lyapunov": lyapunov, "regularity": flags}
        separation = self._separation(where, threads)
        values = np.array([separation.megno, separation.lyapunov])
        values[:, ~np.isfinite(values).all(0)] = np.nan
        kind = regularity(columns["label"][where].astype(np.int8), values[0], unstable[where])
        drifting = np.isin(kind, (Regularity.REGULAR, Regularity.CHAOTIC, Regularity.UNDECIDED))
        # Errors can decide how a run leaves an unstable motion only after a tangent vector has grown.
        highest, drawdown = separation.sums[tangent.Growth.HIGHEST], separation.sums[tangent.Growth.DRAWDOWN]
        values[:, drifting & (drawdown > MAX_DRAWDOWN) & (highest > MAX_DRAWDOWN)] = np.nan
        # Chaos is certain where `log_growth` exceeds MAX_PASSAGE_GROWTH. Until then runs with the flag CHAOTIC go on (see MAX_DURATIONS).
        chaotic = np.flatnonzero(kind == Regularity.CHAOTIC)
        active = chaotic
        log_growth = separation.sums[tangent.Growth.LOG_GROWTH]  # a view of the sums, like `drawdown`
        for duration in range(1, MAX_DURATIONS + 1):
            active = active[(drawdown[active] <= MAX_DRAWDOWN) & (log_growth[active] <= MAX_PASSAGE_GROWTH)]
            if duration < MAX_DURATIONS and active.size:
                separation.integrate(active, threads=threads.scaled(0.0))
        sustained = (drawdown[chaotic] <= MAX_DRAWDOWN) & (log_growth[chaotic] > MAX_PASSAGE_GROWTH)
        kind[chaotic[~sustained]] = Regularity.UNDECIDED
        values[:, chaotic[~sustained]] = np.nan
        (megno[where], lyapunov[where]), flags[where] = values, kind
        return {"megno": megno, "lyapunov": lyapunov, "regularity": flags}


def regularity(label: Flags, megno: Array, unstable: Mask) -> Flags:
    """Return values of `flags.Regularity`. `unstable` is true where the start is on an unstable motion."""
    steady = np.isin(label, (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION))
    drifting = label == Label.DRIFTING
    conditions = {
        Regularity.NOT_COMPUTED: np.isnan(megno),
        Regularity.HYPERBOLIC: (steady | (unstable & drifting)) & (megno > MIN_CHAOTIC),
        Regularity.STEADY: steady,
        Regularity.CHAOTIC: drifting & (megno > MIN_CHAOTIC),
        Regularity.REGULAR: drifting & (megno < MAX_REGULAR),
        Regularity.UNDECIDED: drifting,
    }
    return np.select(list(conditions.values()), list(conditions), Regularity.NOT_COMPUTED).astype(np.int8)
