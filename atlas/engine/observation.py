"""Statistics of observables: their names, the runs that measure them, and their final formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from types import ModuleType

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ..systems.base import Array, Mask, System
from . import blocks, observe
from .ensemble import Ensemble
from .generated import WIDTH
from .sampling import hermite_weights
from .stepsize import INTERPOLATION_ERROR, StepSizes
from .tableaux import Method

# Suffix of a statistic in the atlas -> what it is, of an observable.
STATISTICS = {
    "mean": "mean of the {}",
    "std": "standard deviation of the {}",
    "min": "least {}",
    "max": "largest {}",
    "drift": "change of the {} over the run along the straight line fitted to it by least squares",
}
# Observables have overtones of the motion's frequencies: those up to this multiple of the bound are accounted for.
OVERTONE = 3.0
# Largest distance of two nodes in rad of the frequency bound.
MAX_NODE_RADIANS = 0.4
MAX_HALVINGS = 8  # of steps and of steps between nodes together: by 2^8 in all
# Share of the range of an observable by which it may jump between two nodes.
MAX_ROUGHNESS = 0.3
# Terms of the Euler-Maclaurin formula: B_2k / (2k)! of the derivatives of the orders 1, 3, 5, 7.
_EULER_MACLAURIN = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600)


@dataclass(frozen=True)
class Measurement:
    """What came of integrating an ensemble of a system with observables."""

    final_state: Array  # (states, points)
    sums: Array  # (rows of `observe`, points)
    intervals: NDArray[np.int64]  # intervals between the nodes

    @property
    def finite(self) -> Mask:
        """Whether state and sums are finite, bool of shape (points,)."""
        return np.asarray(np.isfinite(self.final_state).all(0) & np.isfinite(self.sums).all(0))

    def statistics(self, system: System) -> dict[str, Array]:
        """Every statistic of every observable, as `name_mean`, and `integral_drift`; arrays (points,)."""
        result = {}
        with np.errstate(all="ignore"):
            for k, observable in enumerate(system.observables):
                first = observe.FIRST_ROW + observe.FIELDS * k
                start, total, square, trend, least, largest, _ = self.sums[first : first + observe.FIELDS]
                shift = total / self.intervals
                variance = np.maximum(square / self.intervals - shift * shift, 0.0)
                values = (start + shift, np.sqrt(variance), least, largest, 12.0 * trend / self.intervals)
                for suffix, column in zip(STATISTICS, values, strict=True):
                    result[f"{observable.name}_{suffix}"] = column
        result["integral_drift"] = self.sums[observe.CHANGE].copy()
        return result

    def rough(self, radians: Array) -> Mask:
        """Where an observable jumps between nodes, bool (points,): the steps are too long for the motion.

        radians: distance of two nodes times the frequency bound, (points,). An oscillation at the bound is at most
        radians^4 / 24 of its amplitude away from the cubic through the neighbours of a node.
        """
        allowed = MAX_ROUGHNESS + radians**4 / 12
        rough = np.zeros(self.intervals.shape, bool)
        for first in range(observe.FIRST_ROW, len(self.sums), observe.FIELDS):
            least, largest, distance = self.sums[first + observe.LEAST : first + observe.FIELDS]
            rounding = 1e-9 * np.maximum(np.abs(least), np.abs(largest))
            rough |= distance > np.maximum(allowed * (largest - least), rounding)
        return rough


def with_dense_nodes(step_sizes: StepSizes, bound: Array, method: Method, *, may_halve: bool) -> StepSizes:
    """The same steps with nodes at most MAX_NODE_RADIANS apart; longer steps are halved as often as needed.

    Where a node comes after several steps, the error of the interpolation between nodes is within the phase error.

    bound: frequency bound, rad per time unit. may_halve: whether steps may be made shorter: not where the
    user has set them.
    """
    finest = (np.maximum(step_sizes.dispersion_error, 1e-16) / INTERPOLATION_ERROR) ** (1 / 8) / OVERTONE
    for _ in range(MAX_HALVINGS):
        radians = bound * step_sizes.sample_spacing
        far = radians > MAX_NODE_RADIANS
        several = (radians > np.minimum(finest, MAX_NODE_RADIANS)) & (step_sizes.steps_per_sample > 1)
        per_node = np.where(several, step_sizes.steps_per_sample // 2, step_sizes.steps_per_sample)
        halved, halve = step_sizes.halved(method), far & ~several & may_halve & step_sizes.resolved
        step_sizes = replace(
            step_sizes,
            **{
                field.name: np.where(halve, getattr(halved, field.name), getattr(step_sizes, field.name))
                for field in fields(step_sizes)
            },
        )
        step_sizes = replace(step_sizes, steps_per_sample=per_node)
    return step_sizes


def interpolation_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Relative error of statistics by the distance of the nodes, to expect of an overtone of the bound, (points,)."""
    with np.errstate(over="ignore"):
        return np.asarray(INTERPOLATION_ERROR * (OVERTONE * bound * step_sizes.sample_spacing) ** 8)


def measure(
    kernel: ModuleType,
    ensemble: Ensemble,
    step_sizes: StepSizes,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Measurement:
    """Integrate every point to its end.

    kernel: see `specialization.kernel`, of a system with observables; threads, progress: see
    `blocks.integrate`.
    """
    state = blocks.start_state(kernel, ensemble.state)
    sums = _call(
        kernel, blocks.schedule_of(step_sizes), step_sizes.step_size, state, ensemble, threads, progress
    )
    return Measurement(state[: len(ensemble.state)], sums, step_sizes.intervals)


def final_states(
    kernel: ModuleType,
    ensemble: Ensemble,
    steps: NDArray[np.int64],
    step_size: Array,
    *,
    threads: int | None = None,
) -> Array:
    """States after so many steps of these sizes (time units), (states, points)."""
    state = blocks.start_state(kernel, ensemble.state)
    _call(kernel, blocks.pack_blocks(steps, steps), step_size, state, ensemble, threads, None)
    return state[: len(ensemble.state)]


def _call(
    kernel: ModuleType,
    schedule: blocks.BlockSchedule,
    step_size: Array,
    state: Array,
    ensemble: Ensemble,
    threads: int | None,
    progress: Callable[[int], None] | None,
) -> Array:
    """The sums of whole runs; the state is overwritten."""
    rows, states = len(ensemble.scales), kernel.OBSERVABLES
    sums = np.empty((observe.FIRST_ROW + observe.FIELDS * states, ensemble.size))
    resume = np.empty((8 * states + rows, ensemble.size))
    value_weights, slope_weights = end_weights()

    def call(first: int, last: int, first_node: NDArray[np.int64], last_node: NDArray[np.int64]) -> None:
        kernel.integrate(
            first, last, schedule.points, schedule.steps, schedule.steps_per_sample, first_node, last_node, step_size,
            state, ensemble.constants, ensemble.scales, value_weights, slope_weights, resume, sums,
        )  # fmt: skip

    nodes = schedule.nodes
    blocks.call_by_parts(call, schedule.steps * WIDTH, np.zeros_like(nodes), nodes, threads, progress)
    return sums


@cache
def end_weights() -> tuple[Array, Array]:
    """What is added to the weights of the trapezoidal rule at the first four nodes, those of a run's end mirrored.

    By the Euler-Maclaurin formula the integral over a run is the sum over the nodes, in which the first and the last count
    half, and B_2k / (2k)! times the odd derivatives at the start less those at the end. The derivatives are those of the
    Hermite interpolation of four nodes, so that the rule is exact for polynomials of degree 7.

    Returns values, slopes, for values and derivatives by the number of the node; the half of the first node
    is in the first value. At the end of a run the slopes count with the opposite sign, (4,).
    """
    x = np.linspace(0.0, 3.0, 8)
    basis = [Polynomial.fit(x, column, 7, domain=[-1, 1]) for column in hermite_weights(x).T]
    weights = np.array(
        [
            sum(factor * polynomial.deriv(2 * k + 1)(0.0) for k, factor in enumerate(_EULER_MACLAURIN))
            for polynomial in basis
        ]
    )
    weights[0] -= 0.5
    return weights[:4].copy(), weights[4:].copy()
