"""Kernel of the chaos indicators, which integrates blocks of points with one tangent vector each.

`augmented` gives the layout of the tangent vector v. The nodes are equally spaced to within a step, and the last node is the end of
the run. At each node v is divided by its norm. Let L(t) be the logarithm of the growth of |v| up to the time t. Then

    Y(t) = 2 (L(t) - (1/t) int_0^t L ds),    mean MEGNO = (1/T) int_0^T Y dt,    Lyapunov exponent = L(T) / T

(Cincotta & Simo 2000, doi 10.1051/aas:2000108). Integration by parts gives this form of Y, which needs no derivative of v. The
integrals are computed by the trapezoidal rule over the nodes. Time is counted in steps.
"""

from enum import IntEnum

import numpy as np

from .generated import (
    CONSTANTS,
    STATES,
    STEP,
    TANGENT,
    WIDTH,
    aligned_empty,
    extended_rhs,
    full_vectors,
    load_constants,
    load_extended,
    load_state,
    scaled,
    step,
    store_constants,
    store_extended,
    store_state,
    unscaled,
)


class Growth(IntEnum):
    """Rows of the sums: log growth L and its integral, MEGNO and its integral, largest L, largest decrease of L (drawdown)."""

    LOG_GROWTH, LOG_INTEGRAL, MEGNO, MEGNO_INTEGRAL, HIGHEST, DRAWDOWN = range(6)


def integrate(schedule, arrays, first_block, last_block, first_node, last_node):
    """Integrate blocks from `first_node` to `last_node`. `schedule` holds the points, steps and nodes of the blocks."""
    full_vectors()
    points, steps, nodes = schedule
    step_size, state0, constants0, tangent0, weights, out = arrays
    extended, constants = aligned_empty((STATES + TANGENT, WIDTH)), aligned_empty((CONSTANTS, WIDTH))
    weight, sums, norm = (
        aligned_empty((TANGENT, WIDTH)),
        aligned_empty((len(Growth), WIDTH)),
        aligned_empty((WIDTH,)),
    )
    for block in range(first_block, last_block):
        for l in range(WIDTH):
            p = points[block, l]
            y, c = scaled(load_state(state0, p), load_constants(constants0, p), step_size[p] / STEP)
            store_state(extended, l, y if first_node[block] == 0 else load_state(state0, p))
            store_constants(constants, l, c)
            for row in range(TANGENT):
                extended[STATES + row, l] = tangent0[row, p]
                weight[row, l] = weights[row, p]
            for row in range(len(Growth)):
                sums[row, l] = 0.0 if first_node[block] == 0 else out[row, p]
        for node in range(first_node[block], last_node[block]):
            begin = node * steps[block] // nodes[block]
            end = (node + 1) * steps[block] // nodes[block]
            for _ in range(begin, end):
                for l in range(WIDTH):
                    y, c = load_extended(extended, l), load_constants(constants, l)
                    store_extended(extended, l, step(y, extended_rhs(y, c), c))
            for l in range(WIDTH):
                squared = 0.0
                for row in range(TANGENT):
                    component = extended[STATES + row, l] * weight[row, l]
                    squared += component * component
                norm[l] = np.sqrt(squared)
            for l in range(WIDTH):
                for row in range(TANGENT):
                    extended[STATES + row, l] /= norm[l]
                add_stretch(sums, l, np.log(norm[l]), end - begin, end)
        for l in range(WIDTH):
            p = points[block, l]
            y = load_state(extended, l)
            if last_node[block] == nodes[block]:
                y = unscaled(y, load_constants(constants, l), step_size[p] / STEP)
            store_state(state0, p, y)
            for row in range(TANGENT):
                tangent0[row, p] = extended[STATES + row, l]
            for row in range(len(Growth)):
                out[row, p] = sums[row, l]


def add_stretch(sums, l, log_growth, length, time):
    """Add the stretch between two nodes to the sums of lane `l`. The stretch has `length` steps and ends at `time`."""
    before = sums[Growth.LOG_GROWTH, l]
    after = before + log_growth
    sums[Growth.LOG_GROWTH, l] = after
    sums[Growth.LOG_INTEGRAL, l] += 0.5 * length * (before + after)
    megno = 2.0 * (after - sums[Growth.LOG_INTEGRAL, l] / time)
    sums[Growth.MEGNO_INTEGRAL, l] += 0.5 * length * (sums[Growth.MEGNO, l] + megno)
    sums[Growth.MEGNO, l] = megno
    sums[Growth.HIGHEST, l] = max(sums[Growth.HIGHEST, l], after)
    sums[Growth.DRAWDOWN, l] = max(sums[Growth.DRAWDOWN, l], sums[Growth.HIGHEST, l] - after)
