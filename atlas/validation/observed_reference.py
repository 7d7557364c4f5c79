"""Reference solutions of systems with observables: DOP853 with the statistics as quadratures beside the states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import DOP853

from ..systems.base import Array, Points, System
from ..variables import main_instrument

# Imaginary change of the state from which the derivative of an observable along the motion is computed.
COMPLEX_STEP = 1e-30


def observe(system: System, state: Array, constants: Array) -> Array:
    """Values of the observables, shape (observables, *points)."""
    equations = system.equations
    rows = [
        getattr(equations, o.name)(state, constants)
        if hasattr(equations, o.name)
        else state[equations.STATE.index(o.name)]
        for o in system.observables
    ]
    return np.array([row + 0.0 * state[0] for row in rows])


def integrate_group(
    system: System, points: Points, duration: Array, rtol: float, advance: Callable[[float], None]
) -> dict[str, Array] | None:
    """Integrate the points as one system of equations in the time t / duration; None if a step fails.

    rtol: relative and absolute tolerance of the states; advance: called with the number of points finished
    since the last call. Returns by the names of the statistics, (points,), and "state", (states, points).
    """
    equations, constants, start = system.equations, system.constants(points), system.initial_state(points)
    states, size = start.shape
    first = observe(system, start, constants)

    def slope(time: float, flat: Array) -> Array:
        """Slopes of the states and of the integrals of g, g^2 and u g, see `engine.observe`."""
        state = flat.reshape(-1, size)[:states]
        change = observe(system, state, constants) - first
        rows = [duration * rate for rate in equations.rhs(state, constants)]
        return np.concatenate([*rows, *change, *change**2, *((time - 0.5) * change)])

    count = len(first)
    tolerance = np.repeat([rtol, 1e2 * rtol], [states * size, 3 * count * size])
    initial = np.concatenate([start.ravel(), np.zeros(3 * count * size)])
    lowest = highest = first
    with np.errstate(all="ignore"):
        solver = DOP853(slope, 0.0, initial, 1.0, rtol=tolerance, atol=tolerance)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                return None
            low, high = _range_of_step(solver, system, constants, duration)
            lowest, highest = np.minimum(lowest, low), np.maximum(highest, high)
            advance(size * (solver.t - solver.t_old))
    final = solver.y.reshape(-1, size)
    total, square, trend = final[states:].reshape(3, count, size)
    deviation = np.sqrt(np.maximum(square - total**2, 0.0))
    columns = np.stack([first + total, deviation, lowest, highest, 12.0 * trend], axis=1)
    return dict(zip(main_instrument(system).statistics(system), columns.reshape(-1, size), strict=True)) | {
        "state": final[:states]
    }


def _range_of_step(solver: Any, system: System, constants: Array, duration: Array) -> tuple[Array, Array]:
    """Smallest and largest value of each observable in the solver's last step, by cubics between five instants of it."""
    times = np.linspace(solver.t_old, solver.t, 5)
    path = solver.dense_output()(times).reshape(-1, duration.size, times.size)[: len(system.equations.STATE)]
    wide = constants[:, :, None]
    rate = np.array([row + 0.0 * path[0] for row in system.equations.rhs(path, wide)])
    value = observe(system, path, wide)
    slope = observe(system, path + 1j * COMPLEX_STEP * rate, wide).imag / COMPLEX_STEP
    slope *= (duration * (times[1] - times[0]))[:, None]
    return range_of_cubics(value, slope)


def range_of_cubics(value: Array, slope: Array) -> tuple[Array, Array]:
    """Smallest and largest value of the cubics between instants, along the last axis.

    value, slope: at the instants, whose distance is 1. Returns low, high, of the shape of `value` without its
    last axis.
    """
    left, right, rise = slope[..., :-1], slope[..., 1:], np.diff(value, axis=-1)
    # value + left x + b x^2 + c x^3 on 0..1 turns where its slope changes sign
    b, c = 3 * rise - 2 * left - right, left + right - 2 * rise
    root = np.sqrt(np.maximum(b**2 - 3 * left * c, 0.0))
    x = -left / (b + np.where(left > 0, -root, root))
    turning = value[..., :-1] + x * (left + x * (b + x * c))
    turning = np.where((left * right < 0) & (x >= 0) & (x <= 1), turning, value[..., :-1])
    candidates = np.concatenate([value, turning], axis=-1)
    return candidates.min(-1), candidates.max(-1)
