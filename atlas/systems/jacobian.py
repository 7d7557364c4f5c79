"""Numeric bounds of frequencies: the size of a high power of the Jacobian, and how fast the slopes of the states change."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# The derivative of a function is the imaginary part of its value at x + i STEP over STEP, exact but for rounding.
STEP = 1e-30
# Distance in time, in units of 1 / rate, of two neighbouring instants whose difference gives a derivative.
DISTANCE = 1e-3
# |J^p|^(1/p), p = 2^SQUARINGS, exceeds the spectral radius, of random 6 x 6 matrices by 1 % (at most 6 %); where the units of the
# states differ by factors of up to 10^6, by 14 % (at most 25 %). The 16th power would give 69 % (135 %) there.
SQUARINGS = 6
CHUNK = 4096  # points whose matrices are in memory together


def frequency(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """|J^64|^(1/64) of the Jacobian J of the right-hand side, or a body's angular velocity if larger, rad per time unit.

    It is at least the largest |eigenvalue| of J; nan or infinite where the Jacobian is not finite.
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
    # The Jacobian does not contain the rate of turn where the angle of a rotation occurs nowhere in the right-hand side.
    with np.errstate(all="ignore"):
        u1, u2, u3, *_ = equations.frame_motion(state, constants)
        return np.fmax(result, np.sqrt(u1 * u1 + u2 * u2 + u3 * u3))


def derivatives(
    equations: Any, state: NDArray[np.float64], constants: NDArray[np.float64], rate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The states and their first three derivatives along the motion, in units of 1 / rate, with errors of about DISTANCE^2.

    The third contains what the Jacobian cannot: the rate at which the equations themselves change in time.
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
    """Derivatives of the right-hand side by the state, shape (points, states, states); arguments as for `frequency`."""
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
    """Whether volumes of states change, as they do where motions are damped or driven: by the trace of the Jacobian, (points,)."""
    own = np.diagonal(jacobian(equations, state, constants), axis1=1, axis2=2)
    return np.asarray(np.abs(own.sum(1)) > 1e-12 * np.abs(own).sum(1))
