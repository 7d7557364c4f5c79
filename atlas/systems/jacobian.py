"""Compute time derivatives of states, and bounds of frequencies from a high power of the Jacobian."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Complex step of the derivative f'(x) = Im f(x + i STEP) / STEP, which is exact up to rounding.
STEP = 1e-30
# Step in time of central differences, in units of 1 / rate.
DISTANCE = 1e-3
# The bound |J^p|^(1/p), p = 2^SQUARINGS, exceeds the spectral radius of random 6 x 6 matrices by 1 % (at most 6 %). If units
# of states differ by factors of up to 10^6, the excess is 14 % (at most 25 %). With p = 16 the excess is 69 % (at most 135 %).
SQUARINGS = 6
CHUNK = 4096  # number of points whose matrices are in memory together


def frequency(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return |J^64|^(1/64) of the Jacobian J of the right-hand side, or the angular velocity of a body if this is larger.

    The result, in rad per time unit, is at least the largest |eigenvalue| of J. It is nan or infinite where J is not finite.
    """
    result = np.empty(state.shape[1:])
    flat = result.reshape(-1)
    states, numbers = (np.reshape(x, (len(x), flat.size)) for x in (state, constants))
    for first in range(0, flat.size, CHUNK):
        chunk = slice(first, first + CHUNK)
        matrices = jacobian(equations, states[:, chunk], numbers[:, chunk])
        logarithm, power = np.zeros(len(matrices)), 1
        with np.errstate(all="ignore"):
            for squaring in range(SQUARINGS + 1):
                size = np.sqrt((matrices * matrices).sum(axis=(1, 2)))  # the Frobenius norm
                logarithm += np.log(size) / power
                matrices = matrices / np.where(size > 0, size, 1.0)[:, None, None]
                if squaring < SQUARINGS:
                    matrices, power = matrices @ matrices, 2 * power
            flat[chunk] = np.exp(logarithm)
    if not hasattr(equations, "frame_motion"):
        return np.fmax(result, 0.0)
    # If the right-hand side does not depend on the angle of a rotation, the Jacobian does not contain the rate of rotation.
    with np.errstate(all="ignore"):
        u1, u2, u3, *_ = equations.frame_motion(state, constants)
        return np.fmax(result, np.sqrt(u1 * u1 + u2 * u2 + u3 * u3))


def derivatives(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64], rate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return states and their first three time derivatives in units of time 1 / `rate`, with errors of about DISTANCE^2.

    Unlike the Jacobian, the third derivative contains the rate at which the equations change in time.
    """

    def first(at: NDArray[Any]) -> NDArray[Any]:
        return np.array([np.broadcast_to(slope / rate, rate.shape) for slope in equations.rhs(at, constants)])

    def second(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.imag(first(at + 1j * STEP * first(at))) / STEP)

    with np.errstate(all="ignore"):
        slope = first(state)
        bend = 0.5 * DISTANCE**2 * second(state)
        before, after = second(state - DISTANCE * slope + bend), second(state + DISTANCE * slope + bend)
        return np.array([state, slope, 0.5 * (before + after), (after - before) / (2 * DISTANCE)])


def jacobian(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the derivatives of the right-hand side by the state, shape (points, states, states)."""
    matrices = np.empty((state.shape[1], len(state), len(state)))
    with np.errstate(all="ignore"):
        for i in range(len(state)):
            shifted = state.astype(complex)
            shifted[i] += 1j * STEP
            for j, slope in enumerate(equations.rhs(shifted, constants)):
                matrices[:, j, i] = np.imag(slope) / STEP
    return matrices


def changes_volume(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return where the trace of the Jacobian is not 0, (points,). Phase volume changes there, as in damped motion."""
    own = np.diagonal(jacobian(equations, state, constants), axis1=1, axis2=2)
    return np.asarray(np.abs(own.sum(1)) > 1e-12 * np.abs(own).sum(1))
