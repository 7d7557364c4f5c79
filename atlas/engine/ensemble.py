"""An ensemble: points of a system, ready to be integrated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ..systems.base import Array, Mask, Points, System
from . import blocks
from .circle import Axis, Sum, circle_axes, circle_statistics
from .statistics import Row, finish, theta_dot_squared_sum
from .stepsize import StepSizes

# Where runs are interrupted to leave out the points that are certain to drift, as shares of their nodes. Most drifting
# motions are certain after a small part of the run; those that leave an unstable motion only later.
SEGMENTS = (1 / 256, 1 / 64, 1 / 16, 1 / 4, 1 / 2, 1.0)
# A run is not interrupted before this node: shorter segments cost more than they save.
MIN_NODES = 8


@dataclass(frozen=True)
class Integration:
    """What came of integrating an ensemble."""

    final_state: Array  # of the points that ran to the end, (states, points)
    sums: Array  # output of the kernel, (len(Row) + frames * len(Sum), points)
    intervals: NDArray[np.int64]  # intervals between the nodes reached
    duration: Array  # integrated time, time units
    stopped_early: Mask  # whether the point was certain to drift before its end
    axes: Array | None = None  # as in `Ensemble`, (frames * len(Axis), points)

    def statistics(self) -> dict[str, Array]:
        """Means, standard deviations and extremes; see `statistics.finish`."""
        return finish(self.sums[: len(Row)], self.intervals, self.duration)

    def circles(self) -> list[dict[str, Array]]:
        """What `circle.circle_statistics` returns, for each frame in which circles were measured."""
        if self.axes is None:
            return []
        sums = self.sums[len(Row) :].reshape(-1, len(Sum), self.intervals.size)
        axes = self.axes.reshape(-1, len(Axis), self.intervals.size)
        return [circle_statistics(*each, self.intervals) for each in zip(sums, axes, strict=True)]

    def subset(self, where: NDArray[np.int64]) -> Integration:
        """Some of the points, by their indices."""
        return Integration(
            self.final_state[:, where], self.sums[:, where], self.intervals[where], self.duration[where],
            self.stopped_early[where], None if self.axes is None else self.axes[:, where],
        )  # fmt: skip

    @property
    def finite(self) -> Mask:
        """Whether state and sums are finite, bool of shape (points,)."""
        return np.asarray(np.isfinite(self.final_state).all(0) & np.isfinite(self.sums).all(0))

    @property
    def crossed_cylinder(self) -> Mask:
        """Whether the axis was in the cylinder for a part of the run, bool of shape (points,)."""
        outside = self.sums[Row.OUTSIDE]
        return np.asarray((outside > 0.0) & (outside < self.intervals * (1.0 - 1e-10)))


@dataclass(frozen=True)
class Ensemble:
    """Initial states and constants of a set of points."""

    state: Array  # initial state, (states, points)
    constants: Array  # constants of the equations, (constants, points)
    scales: Array  # reciprocal sizes of the first integrals; see `integral_scales`, (integrals, points)
    frequency_bound: Array  # upper bound of the fastest frequency, rad per time unit
    # For kernels that measure circles; see `circle.circle_axes`, (frames * len(Axis), points)
    axes: Array | None = None

    @classmethod
    def of(cls, system: System, points: Points, frames: int = 0) -> Ensemble:
        """The ensemble of points of a system. Parameters that overflow make numbers that are not finite.

        frames: in how many a kernel measures circles: none, the system's frame, or inertial space as well.
        """
        with np.errstate(all="ignore"):
            state = np.ascontiguousarray(system.initial_state(points))
            constants = np.ascontiguousarray(system.constants(points))
            scales = integral_scales(system, state, constants, system.integral_scales(points))
            bound = system.frequency_bound(points)
            axes = None
            if frames:
                rates = [np.zeros_like(bound)]
                if frames > 1 and system.frame_rate is not None:
                    rates.append(system.frame_rate(points))
                axes = circle_axes(system.equations, state, constants, np.array(rates), bound)
            return cls(state, constants, scales, bound, axes)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.state.shape[1]

    def subset(self, where: NDArray[np.int64]) -> Ensemble:
        """Some of the points, by their indices."""
        state, constants, scales = (
            np.ascontiguousarray(rows[:, where]) for rows in (self.state, self.constants, self.scales)
        )
        axes = None if self.axes is None else np.ascontiguousarray(self.axes[:, where])
        return Ensemble(state, constants, scales, self.frequency_bound[where], axes)

    def integrate(
        self,
        kernel: ModuleType,
        step_sizes: StepSizes,
        cylinder: float,
        *,
        early_stop_rate: Array | None = None,
        threads: int | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Integration:
        """Integrate every point.

        kernel: see `specialization.kernel`; cylinder: radius of the cylinder, rad. early_stop_rate: root mean
        square of theta' over the whole run, rad per time unit, beyond which a point outside the cylinder is
        certain to drift; its run may then end early. Default: every run is whole, as they must be where
        circles are measured. threads, progress: see `blocks.integrate`.
        """
        state = blocks.start_state(kernel, self.state)
        if early_stop_rate is None:
            sums = blocks.integrate(
                kernel, blocks.schedule_of(step_sizes), step_sizes.step_size, state, self.constants, self.scales,
                cylinder, axes=self.axes, threads=threads, progress=progress,
            )  # fmt: skip
            nodes = step_sizes.intervals + 1
        else:
            sums, nodes = self._integrate_in_segments(
                kernel, step_sizes, cylinder, early_stop_rate, state, threads, progress
            )
        intervals = np.maximum(nodes - 1, 1)
        with np.errstate(over="ignore"):  # of a duration near the largest number
            duration = intervals * step_sizes.sample_spacing
        return Integration(
            final_state=state[: len(self.state)],
            sums=sums,
            intervals=intervals,
            duration=duration,
            stopped_early=nodes <= step_sizes.intervals,
            axes=self.axes,
        )

    def final_states(
        self,
        kernel: ModuleType,
        steps: NDArray[np.int64],
        step_size: Array,
        *,
        threads: int | None = None,
    ) -> Array:
        """States after so many steps of these sizes (time units), (states, points), without statistics."""
        state = blocks.start_state(kernel, self.state)
        blocks.integrate(
            kernel,
            blocks.pack_blocks(steps, steps),
            step_size,
            state,
            self.constants,
            self.scales,
            0.0,
            axes=self.axes,
            threads=threads,
        )
        return state[: len(self.state)]

    def _integrate_in_segments(
        self,
        kernel: ModuleType,
        step_sizes: StepSizes,
        cylinder: float,
        early_stop_rate: Array,
        state: Array,
        threads: int | None,
        progress: Callable[[int], None] | None,
    ) -> tuple[Array, NDArray[np.int64]]:
        """Sums, and how many nodes each point took.

        The weights of all samples are positive, so that the sum of theta'^2 only grows: once it exceeds the limit of
        the whole run outside the cylinder, no later motion can bring the label back. A passage of the vertical takes
        away at most one sample beside it. Points that run to the end have the same bits as in a single call.
        """
        run_nodes = step_sizes.intervals + 1
        sums = np.empty((len(Row), self.size))
        resume = blocks.resume_array(len(self.scales), self.size)
        with np.errstate(over="ignore"):
            limit = early_stop_rate * early_stop_rate * step_sizes.intervals * (1.0 + 1e-6)
        min_sin2_theta = cylinder * cylinder * (1.0 + 1e-9)
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
            last_node = _segment_end(share, schedule.nodes)
            segment = blocks.Segment(done[first_points], last_node, resume, sums)
            blocks.integrate(
                kernel, schedule, step_sizes.step_size, state, self.constants, self.scales, cylinder,
                segment=segment, threads=threads, progress=progress,
            )  # fmt: skip
            done[selected] = until[goes_on]
            certain = done[active] > 0  # sums of points that have not begun are undefined
            with np.errstate(invalid="ignore", over="ignore"):  # of those, and of motions that are not finite
                certain &= theta_dot_squared_sum(sums)[active] > limit[active]
            certain &= sums[Row.SIN2_THETA_MAX, active] > min_sin2_theta
            ended = certain | (done[active] == run_nodes[active])
            if progress is not None:
                left_out = (run_nodes[active] - done[active]) * step_sizes.steps_per_sample[active]
                progress(int(left_out[ended].sum()))
            active = active[~ended]
        return sums, done


def _segment_end(share: float, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Node at which runs of so many nodes are interrupted after a share of them; 0 where that is too early."""
    end = np.ceil(share * nodes).astype(np.int64)
    return np.where((end >= MIN_NODES) | (end == nodes), end, 0)


def integral_scales(
    system: System, state: Array, constants: Array, floors: Mapping[str, Array]
) -> NDArray[np.float64]:
    """Reciprocal of the sum of the magnitudes of each first integral's terms at the start, (integrals, points).

    floors: by integral, from `System.integral_scales`; nan (scale 0): its change does not count; else the least size. A sum
    of exactly zero counts as 1.
    """
    rows = []
    for name in system.equations.INTEGRALS:
        terms = getattr(system.equations, name)(state, constants)
        size = np.maximum(sum(np.abs(term) for term in terms), floors[name])
        size = np.where(size == 0.0, 1.0, size)
        rows.append(np.where(np.isnan(size), 0.0, 1.0 / size))
    return np.ascontiguousarray(np.reshape(rows, (len(rows), state.shape[1])))
