"""Fundamental matrices of linear systems that are a mean and two harmonics in time, of many points side by side.

Magnus' series of order 6, symplectic where the system is Hamiltonian. The exponential is a Pade approximation, squared twice:
the multipliers of a stable motion stay on the unit circle. S. Blanes et al., Phys. Rep. 470 (2009) 151.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import Array

LANES = 64  # points side by side, over which the innermost loops are compiled to vector instructions
GAUSS = np.sqrt(0.15)  # distance of the outer Gauss nodes from the middle of a step, in steps
RESCALING = 16  # steps after which matrices are rescaled, lest they overflow, and phases computed anew


def of_harmonics(
    harmonics: NDArray[np.complex128], period: Array, span: Array, count: int
) -> tuple[Array, Array]:
    """Fundamental matrices over spans (points,) by equal steps: of moderate size, and the logarithms of their factors.

    harmonics: mean and two harmonics over the period, (3, points, size, size), as a real Fourier transform gives them.
    """
    points, size = harmonics.shape[1:3]
    mean, first, second = harmonics
    parts = np.stack([mean.real, 2 * first.real, -2 * first.imag, 2 * second.real, -2 * second.imag])
    step = span / count
    result, log_scale = np.empty((points, size, size)), np.empty(points)
    parts = np.ascontiguousarray(np.moveaxis(parts * step[:, None, None], 1, -1))
    _compiled()(parts, 2 * np.pi * step / period, count, result, log_scale)
    return result, log_scale


@cache
def _compiled() -> Any:
    """The function `integrate` in machine code."""
    from ... import jit

    numbers = "\n".join(f"{name} = {globals()[name]!r}" for name in ("LANES", "GAUSS", "RESCALING"))
    functions = [f"{jit.CALLED}\n{inspect.getsource(each)}" for each in (combine, multiply, solve)]
    return jit.load(
        "\n\n".join([jit.HEADER, numbers, *functions, f"{jit.KERNEL}\n{inspect.getsource(integrate)}"])
    ).integrate


def combine(x, a, y, b, z, c, out):
    """out = x a + y b + z c, (size, size, LANES) each."""
    for i in range(a.shape[0]):
        for j in range(a.shape[0]):
            for lane in range(LANES):
                out[i, j, lane] = x * a[i, j, lane] + y * b[i, j, lane] + z * c[i, j, lane]


def multiply(a, b, out, subtract):
    """out = a b, or out - a b; the size is even."""
    size = a.shape[0]
    for i in range(size):
        for j in range(size):
            if subtract:
                for k in range(0, size, 2):
                    for lane in range(LANES):
                        out[i, j, lane] -= (
                            a[i, k, lane] * b[k, j, lane] + a[i, k + 1, lane] * b[k + 1, j, lane]
                        )
            else:
                for lane in range(LANES):
                    out[i, j, lane] = a[i, 0, lane] * b[0, j, lane] + a[i, 1, lane] * b[1, j, lane]
                for k in range(2, size, 2):
                    for lane in range(LANES):
                        out[i, j, lane] += (
                            a[i, k, lane] * b[k, j, lane] + a[i, k + 1, lane] * b[k + 1, j, lane]
                        )


def solve(a, b):
    """Replace b by the solution x of a x = b, and a by its factors; a is near the identity and needs no pivots."""
    size = a.shape[0]
    for k in range(size):
        for lane in range(LANES):
            a[k, k, lane] = 1.0 / a[k, k, lane]
        for i in range(k + 1, size):
            for lane in range(LANES):
                a[i, k, lane] *= a[k, k, lane]
            for j in range(k + 1, size):
                for lane in range(LANES):
                    a[i, j, lane] -= a[i, k, lane] * a[k, j, lane]
            for j in range(size):
                for lane in range(LANES):
                    b[i, j, lane] -= a[i, k, lane] * b[k, j, lane]
    for i in range(size - 1, -1, -1):
        for j in range(size):
            for k in range(i + 1, size):
                for lane in range(LANES):
                    b[i, j, lane] -= a[i, k, lane] * b[k, j, lane]
            for lane in range(LANES):
                b[i, j, lane] *= a[i, i, lane]


def integrate(parts, turn, count, result, log_scale):
    """Write the matrices of all points, (points, size, size), and the logarithms of their factors.

    parts: mean, cosine and sine of both harmonics, times the step, (5, size, size, points); turn: phase of a step, rad.
    """
    size, points = parts.shape[1], parts.shape[3]
    part, nodes = np.empty((5, size, size, LANES)), np.empty((3, size, size, LANES))
    identity, space = np.zeros((size, size, LANES)), np.empty((8, size, size, LANES))
    for i in range(size):
        identity[i, i] = 1.0
    first, middle, last = nodes[0], nodes[1], nodes[2]
    b2, b3, c1, x, y, z = space[0], space[1], space[2], space[3], space[4], space[5]
    matrix, product = space[6], space[7]
    cosine, sine = np.empty((3, LANES)), np.empty((3, LANES))
    turn_of, turn_cosine, turn_sine = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    first_cosine, first_sine, second_cosine = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    second_sine, logarithm, largest = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    for start in range(0, points, LANES):
        for lane in range(LANES):
            point = min(start + lane, points - 1)
            turn_of[lane], logarithm[lane] = turn[point], 0.0
            turn_cosine[lane], turn_sine[lane] = np.cos(turn[point]), np.sin(turn[point])
            for k in range(5):
                for i in range(size):
                    for j in range(size):
                        part[k, i, j, lane] = parts[k, i, j, point]
        matrix[:] = identity
        for step in range(count):
            for node in range(3):
                if step % RESCALING == 0:
                    for lane in range(LANES):
                        phase = (step + 0.5 + GAUSS * (node - 1)) * turn_of[lane]
                        cosine[node, lane], sine[node, lane] = np.cos(phase), np.sin(phase)
                for lane in range(LANES):
                    c, s = cosine[node, lane], sine[node, lane]
                    first_cosine[lane], first_sine[lane] = c, s
                    second_cosine[lane], second_sine[lane] = c * c - s * s, 2 * c * s
                    cosine[node, lane] = c * turn_cosine[lane] - s * turn_sine[lane]
                    sine[node, lane] = s * turn_cosine[lane] + c * turn_sine[lane]
                for i in range(size):
                    for j in range(size):
                        for lane in range(LANES):
                            nodes[node, i, j, lane] = (
                                part[0, i, j, lane]
                                + part[1, i, j, lane] * first_cosine[lane]
                                + part[2, i, j, lane] * first_sine[lane]
                                + part[3, i, j, lane] * second_cosine[lane]
                                + part[4, i, j, lane] * second_sine[lane]
                            )
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
            # a quarter of the exponent, and the even and odd parts of its Pade approximation
            combine(0.25, middle, 1 / 48, b3, 1 / 960, z, z)
            multiply(z, z, x, False)
            combine(0.5, identity, 1 / 120, x, 0.0, x, y)
            multiply(z, y, c1, False)
            combine(1.0, identity, 0.1, x, 1.0, c1, z)
            combine(1.0, identity, 0.1, x, -1.0, c1, y)
            solve(y, z)
            multiply(z, z, x, False)
            multiply(x, x, y, False)
            multiply(y, matrix, product, False)
            matrix[:] = product
            if (step + 1) % RESCALING == 0 or step == count - 1:
                largest[:] = 0.0
                for i in range(size):
                    for j in range(size):
                        for lane in range(LANES):
                            largest[lane] = max(largest[lane], abs(matrix[i, j, lane]))
                for lane in range(LANES):
                    logarithm[lane] += np.log(largest[lane])
                    largest[lane] = 1.0 / largest[lane]
                for i in range(size):
                    for j in range(size):
                        for lane in range(LANES):
                            matrix[i, j, lane] *= largest[lane]
        for lane in range(min(LANES, points - start)):
            log_scale[start + lane] = logarithm[lane]
            for i in range(size):
                for j in range(size):
                    result[start + lane, i, j] = matrix[i, j, lane]
