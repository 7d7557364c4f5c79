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


@dataclass(frozen=True)
class TangentSteps:
    """Steps of the runs with tangent vectors; arrays of shape (points,).

    Attributes
    ----------
    steps : ndarray of int64
    step_size : ndarray of float64
        In time units.
    resolved : ndarray of bool
        Whether the steps are short enough for the indicators.
    """

    steps: NDArray[np.int64]
    step_size: Array
    resolved: Mask

    @classmethod
    def of(cls, bound: Array, duration: Array, step: float | None, max_steps: int) -> TangentSteps:
        """Step sizes of points with these frequency bounds (rad per time unit) and durations (time units).

        Parameters
        ----------
        bound, duration : ndarray of float64, shape (points,)
        step : float or None
            Largest step in time units, instead of one that is short enough.
        max_steps : int
            Largest number of steps before it is rounded up.
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


def indicators(
    system: System,
    kernel: ModuleType,
    ensemble: Ensemble,
    steps: TangentSteps,
    rate_unit: Array,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Array, Array]:
    """Mean MEGNO and the largest Lyapunov exponent at the end of each run.

    Parameters
    ----------
    system : System
    kernel : module
        See `specialization.tangent_kernel`.
    ensemble : Ensemble
    steps : TangentSteps
    rate_unit : ndarray of float64, shape (points,)
        See `System.rate_unit`.
    threads, progress
        See `blocks.integrate`.

    Returns
    -------
    megno, lyapunov : ndarray of float64, shape (points,)
        Pure number, and per time unit; nan or infinite where numbers overflow.
    """
    state = ensemble.state.copy()
    with np.errstate(all="ignore"):
        unit = steps.step_size / METHOD.kernel_step
        weights = _norm_weights(system, ensemble, unit, rate_unit)
        vectors = np.ascontiguousarray(tangent_space.start(system.equations, state) / weights)
    schedule = blocks.pack_blocks(steps.steps, steps.nodes)
    nodes = schedule.steps_per_sample
    sums = np.empty((tangent.SUMS, ensemble.size))

    def call(first: int, last: int, first_node: NDArray[np.int64], last_node: NDArray[np.int64]) -> None:
        kernel.integrate(
            first, last, schedule.points, schedule.steps, nodes, first_node, last_node, steps.step_size, state,
            ensemble.constants, vectors, weights, sums,
        )  # fmt: skip

    blocks.call_by_parts(call, schedule.steps * WIDTH, np.zeros_like(nodes), nodes, threads, progress)
    with np.errstate(all="ignore"):
        megno = sums[tangent.MEGNO_INTEGRAL] / steps.steps
        return megno, sums[tangent.LOG_GROWTH] / (steps.step_size * steps.steps)


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
