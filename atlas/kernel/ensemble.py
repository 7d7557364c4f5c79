"""Ensemble of points of a system that are ready to be integrated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..systems.base import Array, Mask, Points, System
from . import blocks
from .blocks import ALL_THREADS, Threads
from .sampling import end_weights, quadrature
from .statistics import Row, theta_dot_squared_sum
from .stepsize import StepSizes

# After these fractions of the nodes a run is interrupted, so that points that certainly drift can end early. For most drifting
# points the drift is certain after a small part of the run. The drift is certain later if the motion leaves an unstable motion.
SEGMENTS = (1 / 256, 1 / 64, 1 / 16, 1 / 4, 1 / 2, 1.0)
# A run is not interrupted before this number of nodes, because shorter segments cost more than they save.
MIN_NODES = 8


class Plug(Protocol):
    """Instrument that keeps sums over the nodes of a body's motion. The sums are 0 at the start."""

    @property
    def sums(self) -> int:
        """Number of sums of the instrument."""

    @property
    def given(self) -> int:
        """Number of constants that the instrument has for each point."""

    @property
    def add_node(self) -> Callable[..., None] | None:
        """Function (sums, s, given, g, l, nodes, i, intervals, spacing, inverse_unit) that adds node i of lane l to the sums.

        The function is pasted into the kernel. The sums begin at row s, the constants at row g. The nodes of a run, numbered 0 to
        `intervals`, are `spacing` apart in the kernel's unit of time. Node i is nodes[i & 3, row, l] with the rows of
        `statistics.Node`, and the other three slots hold the nodes before. Without a function (None) the constants are levels of
        the energy, which is the first of the equations' INTEGRALS. Only every `integrate.NODES_PER_LEVEL`-th node is then
        examined, and each sum counts the nodes with more energy than one of the levels.
        """

    def constants(self, system: System, points: Points, start: Ensemble) -> Array:
        """Return the constants of the instrument, (given, points)."""


@dataclass(frozen=True)
class Integration:
    """Result of integrating an ensemble. Arrays without a stated shape have the shape (points,)."""

    final_state: Array  # state at the end of the run, (states, points)
    sums: Array  # output of the kernel, (kernel.SUMS, points)
    intervals: NDArray[np.int64]  # number of intervals up to the last node reached
    duration: Array  # time that was integrated, in time units
    stopped_early: Mask  # whether the run ended early because the point certainly drifts

    def subset(self, where: NDArray[np.int64]) -> Integration:
        return Integration(*(each[..., where] for each in vars(self).values()))

    @property
    def finite(self) -> Mask:
        return np.asarray(np.isfinite(self.final_state).all(0) & np.isfinite(self.sums).all(0))


@dataclass(frozen=True)
class Ensemble:
    """Initial states and constants of a set of points."""

    state: Array  # state from which statistics begin, (states, points)
    constants: Array  # constants of the equations, (constants, points)
    scales: Array  # reciprocals of the sizes of first integrals, (integrals, points)
    frequency_bound: Array  # upper bound of the fastest frequency, rad per time unit
    given: Array  # constants of the plugged instruments, (rows, points)
    origin: Array  # initial state, before a transient, (states, points)
    change: Array  # largest relative change of a first integral in the transient, (points,)

    @classmethod
    def of(cls, system: System, points: Points, plugs: Sequence[Plug] = ()) -> Ensemble:
        """Return the ensemble of points of a system. Numbers are not finite where parameters overflow."""
        with np.errstate(all="ignore"):
            state = np.ascontiguousarray(system.initial_state(points))
            constants = np.ascontiguousarray(system.constants(points))
            scales = integral_scales(system, state, constants, system.integral_scales(points))
            bound, none = system.frequency_bound(points), np.empty((0, state.shape[1]))
            start = cls(state, constants, scales, bound, none, state, np.zeros(state.shape[1]))
            return start.with_given(system, points, plugs)

    def with_given(self, system: System, points: Points, plugs: Sequence[Plug]) -> Ensemble:
        """Return the ensemble with the constants of the instruments `plugs`. The instruments measure the motion that begins at `state`."""
        given = [plug.constants(system, points, self) for plug in plugs]
        return replace(self, given=np.concatenate([np.empty((0, self.size)), *given]))

    @property
    def size(self) -> int:
        return self.state.shape[1]

    def subset(self, where: NDArray[np.int64]) -> Ensemble:
        return Ensemble(*(np.ascontiguousarray(each[..., where]) for each in vars(self).values()))

    def arrays(
        self, kernel: ModuleType, step_size: Array, cylinder: float = 0.0, period: ArrayLike = 1
    ) -> blocks.Arrays:
        """Return the arrays for a kernel. `period` is the number of nodes in a period, for observables measured once a period."""
        rule = end_weights() if kernel.OBSERVABLES else quadrature()
        sums = np.empty((kernel.SUMS, self.size))
        given = self.given
        if len(given) < kernel.PLUGGED_GIVEN:  # observables measured once a period need the period
            given = np.full((1, self.size), period, np.float64)
        return blocks.Arrays(
            step_size, blocks.start_state(kernel, self.state), self.constants, self.scales, given, rule,
            cylinder * cylinder, np.empty((0, 0)), sums,
        )  # fmt: skip

    def integrate(
        self,
        kernel: ModuleType,
        step_sizes: StepSizes,
        cylinder: float = 0.0,
        *,
        early_stop_rate: Array | None = None,
        threads: Threads = ALL_THREADS,
    ) -> Integration:
        """Integrate every point. `threads.progress` counts point-steps.

        `cylinder` is a radius in rad. A run may end early once sin theta has exceeded twice the radius, and the root mean square of
        theta' over the whole run will certainly exceed `early_stop_rate`. By default every run is whole.
        """
        arrays = self.arrays(kernel, step_sizes.step_size, cylinder, step_sizes.nodes_per_period)
        nodes = step_sizes.intervals + 1
        if early_stop_rate is None:
            blocks.integrate(kernel, blocks.schedule_of(step_sizes), arrays, threads=threads)
        else:
            nodes = self._integrate_in_segments(kernel, step_sizes, arrays, early_stop_rate, threads)
        intervals = np.maximum(nodes - 1, 1)
        with np.errstate(over="ignore"):  # a very long duration may overflow
            duration = intervals * step_sizes.sample_spacing
        return Integration(
            arrays.state[: len(self.state)], arrays.sums, intervals, duration, nodes <= step_sizes.intervals
        )

    def final_states(
        self, kernel: ModuleType, steps: NDArray[np.int64], step_size: Array, threads: Threads = ALL_THREADS
    ) -> Array:
        """Return the states, (states, points), after `steps` steps of length `step_size`, without statistics."""
        return self.states_at_samples(kernel, steps, step_size[None], threads)[:, 0]

    def states_at_samples(
        self, kernel: ModuleType, steps: NDArray[np.int64], step_sizes: Array, threads: Threads = ALL_THREADS
    ) -> Array:
        """Return the states, (states, samples, points), at samples `steps` steps apart. `step_sizes` is (samples, points)."""
        arrays, schedule = self.arrays(kernel, step_sizes[0]), blocks.pack_blocks(steps, steps)
        states, whole = np.empty((len(self.state), *step_sizes.shape)), (np.zeros_like(steps), schedule.nodes)
        direct = threads.count == 0 and schedule.point_steps <= blocks.CHUNK  # saves time in many short calls
        for k, step_size in enumerate(step_sizes):
            arrays = arrays._replace(step_size=step_size)
            if direct:
                kernel.integrate(schedule, arrays, 0, len(schedule.steps), *whole)
            else:
                blocks.integrate(kernel, schedule, arrays, threads=threads)
            states[:, k] = arrays.state[: len(self.state)]
            arrays.state[len(self.state) :] = 0.0  # accumulated losses begin anew in each sample
        return states

    def nodes(self, kernel: ModuleType, steps: NDArray[np.int64], step_size: Array, count: int) -> tuple[Array, Array]:  # fmt: skip
        """Return states and derivatives, (states, count, points), at the start and at nodes that are `steps` steps apart.

        `kernel` is a `specialization.node_kernel`.
        """
        states, derivatives = np.empty((2, len(self.state), count, self.size))
        if self.size:
            schedule = blocks.pack_blocks(steps, steps)
            arrays = step_size, self.state, self.constants, self.scales, states, derivatives
            kernel.integrate(schedule, arrays, 0, len(schedule.steps))
            derivatives /= step_size / kernel.STEP
        return states, derivatives

    def _integrate_in_segments(
        self,
        kernel: ModuleType,
        step_sizes: StepSizes,
        arrays: blocks.Arrays,
        early_stop_rate: Array,
        threads: Threads,
    ) -> NDArray[np.int64]:
        """Integrate in SEGMENTS, and return the number of nodes that each point reaches.

        All weights are positive, so that the sum of theta'^2 only grows. (The correction of a passage near the vertical removes at
        most one sample.) A point drifts once the sum exceeds the limit of the whole run and sin theta has exceeded twice the radius
        of the cylinder. A later entry into the cylinder counts as drift, too. Interruptions do not change a run that does not end early.
        """
        run_nodes, arrays = step_sizes.intervals + 1, blocks.resumable(kernel, arrays)
        with np.errstate(over="ignore"):
            limit = early_stop_rate * early_stop_rate * step_sizes.intervals * (1.0 + 1e-6)
        min_sin2_theta = 4.0 * arrays.cylinder_squared * (1.0 + 1e-9)
        done = np.zeros_like(run_nodes)
        active, packed, schedule = np.arange(self.size), np.empty(0, np.int64), None
        for share in SEGMENTS:
            until = _segment_end(share, run_nodes[active])
            goes_on = until > done[active]
            selected = active[goes_on]
            if not selected.size:
                continue
            if schedule is None or not np.array_equal(selected, packed):
                schedule, packed = blocks.schedule_of(step_sizes, selected), selected
            first_points = schedule.points[:, 0]  # all points of a block have the same history
            segment = done[first_points], _segment_end(share, schedule.nodes)
            blocks.integrate(kernel, schedule, arrays, segment=segment, threads=threads)
            done[selected] = until[goes_on]
            certain = done[active] > 0  # sums are undefined before the first node of a point
            with np.errstate(invalid="ignore", over="ignore"):  # undefined sums and overflow are ignored
                certain &= theta_dot_squared_sum(arrays.sums)[active] > limit[active]
            certain &= arrays.sums[Row.SIN2_THETA_MAX, active] > min_sin2_theta
            ended = certain | (done[active] == run_nodes[active])
            left_out = (run_nodes[active] - done[active]) * step_sizes.steps_per_sample[active]
            threads.progress(int(left_out[ended].sum()))
            active = active[~ended]
        return done


def _segment_end(share: float, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the node after the fraction `share` of a run, or 0 if this node is before MIN_NODES and is not the end of the run."""
    end = np.ceil(share * nodes).astype(np.int64)
    return np.where((end >= MIN_NODES) | (end == nodes), end, 0)


def integral_scales(
    system: System, state: Array, constants: Array, floors: Mapping[str, Array]
) -> NDArray[np.float64]:
    """Return 1 / size of each first integral at the start. The size is the sum of the terms' magnitudes, at least the floor."""
    rows = []
    for name in system.equations.INTEGRALS:
        terms = getattr(system.equations, name)(state, constants)
        size = np.maximum(sum(np.abs(term) for term in terms), floors[name])
        size = np.where(size == 0.0, 1.0, size)
        # If the floor is nan, the size is nan. The scale is then 0, so that changes of the integral are ignored.
        rows.append(np.where(np.isnan(size), 0.0, 1.0 / size))
    return np.ascontiguousarray(np.reshape(rows, (len(rows), state.shape[1])))
