"""Integrate fundamental matrices of linear systems for many points side by side.

Magnus' series of order 6 is symplectic where the system is Hamiltonian. The exponential is a Pade approximation that is squared
twice. The multipliers of a stable motion thus stay on the unit circle. S. Blanes et al., Phys. Rep. 470 (2009) 151.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import Array

# Vector instructions integrate at most LANES points side by side. Fewer points are padded to a multiple of GROUP.
LANES, GROUP = 64, 8
GAUSS = np.sqrt(0.15)  # distance of the outer Gauss nodes from the middle of a step, in steps
RESCALING = 16  # number of steps after which matrices are rescaled, to avoid overflow, and phases recomputed
STEPS = 4096  # largest number of steps in a call, some tenths of a second; a multiple of RESCALING


def of_harmonics(
    harmonics: NDArray[np.complex128], period: Array, span: Array, count: int
) -> tuple[Array, Array]:
    """Return fundamental matrices over spans (points,), scaled to largest entry 1, and logarithms of the scale factors.

    The array `harmonics`, (3, points, size, size), contains the mean and two harmonics of the periodic matrix of each system.
    These three parts come from `np.fft.rfft` and are divided by the number of samples. The size is even. A span has `count` equal steps.
    """
    points, size = harmonics.shape[1:3]
    mean, first, second = harmonics
    parts = np.stack([mean.real, 2 * first.real, -2 * first.imag, 2 * second.real, -2 * second.imag])
    parts, turn = np.moveaxis(parts * (span / count)[:, None, None], 1, -1), 2 * np.pi * span / count / period
    result, log_scale = np.tile(np.eye(size), (points, 1, 1)), np.zeros(points)
    integrate_steps = _compile()
    for start in range(0, points, LANES):
        lanes = slice(start, start + LANES)
        of_lanes = np.ascontiguousarray(parts[np.newaxis, ..., lanes])
        for begin in range(0, count, STEPS):
            end = min(begin + STEPS, count)
            integrate_steps(of_lanes, turn[lanes], begin, end, result[lanes], log_scale[lanes])
    largest = np.abs(result).max((1, 2))
    return result / largest[:, None, None], log_scale + np.log(largest)


def of_steps(matrices: Array) -> tuple[Array, Array]:
    """Return fundamental matrices of at most LANES points, with largest entries of 1 to 2, and the logarithms of their scale factors.

    The array `matrices`, (steps, 3, size, size, points), contains the system's matrices at the Gauss nodes, times the step.
    """
    steps, _, size, _, points = matrices.shape
    result, log_scale = np.tile(np.eye(size), (points, 1, 1)), np.zeros(points)
    _compile()(matrices, np.zeros(points), 0, steps, result, log_scale)
    return result, log_scale


@cache
def _compile() -> Any:
    """Return the function `integrate` in machine code."""
    from ...kernel import machine_code  # imported here, as commands that only read systems need no compiler

    numbers = {"GROUP": repr(GROUP), "GAUSS": repr(GAUSS), "RESCALING": repr(RESCALING)}
    functions = {each.__name__: inspect.getsource(each) for each in _FUNCTIONS}
    return machine_code.load(machine_code.module_text(numbers, functions, machine_code.CALLED)).integrate


def combine(x, a, y, b, z, c, out):
    """out = x a + y b + z c, (size, size, LANES) each."""
    for i in range(a.shape[0]):
        for j in range(a.shape[0]):
            for lane in range(a.shape[2]):
                out[i, j, lane] = x * a[i, j, lane] + y * b[i, j, lane] + z * c[i, j, lane]


def multiply(a, b, out, subtract):
    """out = a b, or out - a b; the size is even."""
    size = a.shape[0]
    for i in range(size):
        for j in range(size):
            if subtract:
                for k in range(0, size, 2):
                    for lane in range(a.shape[2]):
                        pair = a[i, k, lane] * b[k, j, lane] + a[i, k + 1, lane] * b[k + 1, j, lane]
                        out[i, j, lane] -= pair
            else:
                for lane in range(a.shape[2]):
                    out[i, j, lane] = a[i, 0, lane] * b[0, j, lane] + a[i, 1, lane] * b[1, j, lane]
                for k in range(2, size, 2):
                    for lane in range(a.shape[2]):
                        out[i, j, lane] += (
                            a[i, k, lane] * b[k, j, lane] + a[i, k + 1, lane] * b[k + 1, j, lane]
                        )


def solve(a, b):
    """Replace b by the solution x of a x = b, and a by its factors; a is near the identity and needs no pivots."""
    size = a.shape[0]
    for k in range(size):
        for lane in range(a.shape[2]):
            a[k, k, lane] = 1.0 / a[k, k, lane]
        for i in range(k + 1, size):
            for lane in range(a.shape[2]):
                a[i, k, lane] *= a[k, k, lane]
            for j in range(k + 1, size):
                for lane in range(a.shape[2]):
                    a[i, j, lane] -= a[i, k, lane] * a[k, j, lane]
            for j in range(size):
                for lane in range(a.shape[2]):
                    b[i, j, lane] -= a[i, k, lane] * b[k, j, lane]
    for i in range(size - 1, -1, -1):
        for j in range(size):
            for k in range(i + 1, size):
                for lane in range(a.shape[2]):
                    b[i, j, lane] -= a[i, k, lane] * b[k, j, lane]
            for lane in range(a.shape[2]):
                b[i, j, lane] *= a[i, i, lane]


def add(total, error, change):
    """Add a change to a total by compensated summation; error: the rounding error of the total, which the next call adds."""
    size = total.shape[0]
    for i in range(size):
        for j in range(size):
            for lane in range(total.shape[2]):
                before, increment = total[i, j, lane], change[i, j, lane] + error[i, j, lane]
                after = before + increment
                added = after - before
                error[i, j, lane] = (before - (after - added)) + (increment - added)
                total[i, j, lane] = after


def at_nodes(part, phases, turns, nodes):
    """Write the matrices at the Gauss nodes of a step, from their mean and the cosines and sines of two harmonics.

    phases: cosine and sine at each node, (2, 3, LANES), updated for the next step; turns: cosine and sine of a step, (2, LANES).
    """
    size = part.shape[1]
    for node in range(3):
        cosine, sine = phases[0, node], phases[1, node]
        for i in range(size):
            for j in range(size):
                for lane in range(part.shape[3]):
                    c, s = cosine[lane], sine[lane]
                    nodes[node, i, j, lane] = (
                        part[0, i, j, lane]
                        + part[1, i, j, lane] * c
                        + part[2, i, j, lane] * s
                        + part[3, i, j, lane] * (c * c - s * s)
                        + part[4, i, j, lane] * (2 * c * s)
                    )
        for lane in range(part.shape[3]):
            c, s = cosine[lane], sine[lane]
            cosine[lane] = c * turns[0, lane] - s * turns[1, lane]
            sine[lane] = s * turns[0, lane] + c * turns[1, lane]


def exponential(nodes, identity, space, z):
    """Replace z by exp(M) - 1, where M is Magnus' series of a step. The matrices at the step's Gauss nodes give M."""
    first, middle, last = nodes[0], nodes[1], nodes[2]
    b2, b3, c1, x, y = space[0], space[1], space[2], space[3], space[4]
    combine(15**0.5 / 3, last, -(15**0.5) / 3, first, 0.0, first, b2)
    combine(10 / 3, last, -20 / 3, middle, 10 / 3, first, b3)
    multiply(middle, b2, c1, False)
    multiply(b2, middle, c1, True)
    combine(2.0, b3, 1.0, c1, 0.0, c1, x)
    multiply(x, middle, z, False)
    multiply(middle, x, z, True)
    combine(1.0, b2, 1 / 60, z, 0.0, z, y)
    combine(-20.0, middle, -1.0, b3, 1.0, c1, x)
    multiply(x, y, z, False)
    multiply(y, x, z, True)
    # z becomes M / 4, and c1 the odd part of the Pade approximation of exp(z), then (exp(z) - 1) / 2. Two doublings give
    # exp(M) - 1 without a sum with 1, which would lose digits.
    combine(0.25, middle, 1 / 48, b3, 1 / 960, z, z)
    multiply(z, z, x, False)
    combine(0.5, identity, 1 / 120, x, 0.0, x, y)
    multiply(z, y, c1, False)
    combine(1.0, identity, 0.1, x, -1.0, c1, y)
    solve(y, c1)
    multiply(c1, c1, x, False)
    combine(2.0, c1, 2.0, x, 0.0, x, y)
    multiply(y, y, x, False)
    combine(4.0, y, 4.0, x, 0.0, x, z)


def rescale(matrix, error, log_scale):
    """Divide matrices and errors by the power of 2 below the largest entry of each point. Add its logarithm to log_scale."""
    size, largest = matrix.shape[0], np.zeros(matrix.shape[2])
    for i in range(size):
        for j in range(size):
            for lane in range(matrix.shape[2]):
                largest[lane] = max(largest[lane], abs(matrix[i, j, lane]))
    for lane in range(matrix.shape[2]):
        largest[lane] = np.exp2(np.floor(np.log2(largest[lane])))  # divides without an error
    for i in range(size):
        for j in range(size):
            for lane in range(matrix.shape[2]):
                matrix[i, j, lane] /= largest[lane]
                error[i, j, lane] /= largest[lane]
    for point in range(log_scale.size):
        log_scale[point] += np.log(largest[point])


def integrate(parts, turn, begin, end, result, log_scale):
    """Multiply the matrices of at most LANES points by the matrices of the steps from begin to end.

    parts: for all steps the mean, cosines and sines of two harmonics, (1, 5, size, size, points), or for each step the matrices
    at the Gauss nodes, (steps, 3, size, size, points), all multiplied by the step size; turn: phase of a step, rad; result:
    (points, size, size), which is rescaled. The logarithms of its factors are added to log_scale.
    """
    size, points, harmonic = parts.shape[2], parts.shape[4], parts.shape[1] == 5
    lanes = -(-points // GROUP) * GROUP
    part, nodes = np.zeros((5, size, size, lanes)), np.empty((3, size, size, lanes))
    identity, space = np.zeros((size, size, lanes)), np.empty((5, size, size, lanes))
    matrix, change = np.empty((size, size, lanes)), np.empty((size, size, lanes))
    product, error = np.empty((size, size, lanes)), np.zeros((size, size, lanes))
    phases, turns, turn_of = np.empty((2, 3, lanes)), np.empty((2, lanes)), np.empty(lanes)
    for lane in range(lanes):
        point = min(lane, points - 1)
        turn_of[lane] = turn[point]
        turns[0, lane], turns[1, lane] = np.cos(turn[point]), np.sin(turn[point])
        for i in range(size):
            identity[i, i, lane] = 1.0
            for j in range(size):
                matrix[i, j, lane] = result[point, i, j]
    for step in range(begin, end):
        if step == begin or not harmonic:
            of_step = parts[step % parts.shape[0]]
            for k in range(parts.shape[1]):
                for i in range(size):
                    for j in range(size):
                        for lane in range(lanes):
                            part[k, i, j, lane] = of_step[k, i, j, min(lane, points - 1)]
        if harmonic:
            if step % RESCALING == 0:
                for node in range(3):
                    for lane in range(lanes):
                        phase = (step + 0.5 + GAUSS * (node - 1)) * turn_of[lane]
                        phases[0, node, lane], phases[1, node, lane] = np.cos(phase), np.sin(phase)
            at_nodes(part, phases, turns, nodes)
        exponential(nodes if harmonic else part[:3], identity, space, change)
        multiply(change, matrix, product, False)
        add(matrix, error, product)
        if (step + 1) % RESCALING == 0 or step == end - 1:
            rescale(matrix, error, log_scale)
    for lane in range(points):
        for i in range(size):
            for j in range(size):
                result[lane, i, j] = matrix[i, j, lane]


# Functions to compile, callees first.
_FUNCTIONS = (combine, multiply, solve, add, at_nodes, exponential, rescale, integrate)
