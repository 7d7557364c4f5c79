"""Kernel of systems with observables, which averages observables along the motions of blocks of points.

An observable f and the derivative of f are evaluated at the nodes, which are a few steps apart. The integrals over a run are sums
over the nodes by the trapezoidal rule, with the corrections of `sampling.end_weights` at both ends. Extremes between two nodes
are found by interpolation between four nodes. For an observable measured once a period, only the nodes at the ends of periods
count. Let f0 be the value at the start, g = f - f0, and u a variable that grows from -1/2 to 1/2 along the run. Then the sums
of g, g^2 and u g give the mean of f, the standard deviation, and the slope of the line fitted to f.
"""

from enum import IntEnum

import numpy as np

from .generated import (
    CONSTANTS,
    INTEGRALS,
    OBSERVABLES,
    STATES,
    STEP,
    STROBED,
    WIDTH,
    aligned_empty,
    full_vectors,
    load_constants,
    load_state,
    observe,
    observe_change,
    rhs,
    store_integrals,
    store_state,
    store_strobes,
    store_values,
)
from .lanes import advance, extend_changes, load_points, load_runs, store_ends, store_runs, store_sums
from .poles import place_of_turn, turns_twice

# Row CHANGE of the sums is the change of first integrals. The rows of `Field` for each observable begin at FIRST_ROW.
CHANGE, FIRST_ROW = 0, 1
# First integrals are evaluated at every fourth node and at the end only, because they change slowly.
NODES_PER_CHANGE = 4
# A relative change of an observable up to this size may be rounding.
CHANGE_ROUNDING = 1e-14


class Field(IntEnum):
    """Rows of the sums of an observable. ROUGHNESS is the largest distance of a node from the cubic through the nodes before and after."""

    START, TOTAL, SQUARE, TREND, LEAST, LARGEST, ROUGHNESS = range(7)


def integrate(schedule, arrays, first_block, last_block, first_node, last_node):
    """Integrate blocks over a range of nodes, as `integrate.integrate` does. `arrays.rule` is a `sampling.EndWeights`."""
    full_vectors()
    points, steps, steps_per_node = schedule
    step_size, state0, constants0, scales, given0, rule, cylinder_squared, resume, out = arrays
    value_weights, slope_weights = rule
    state, constants = aligned_empty((STATES, WIDTH)), aligned_empty((CONSTANTS, WIDTH))
    slopes, nodes = aligned_empty((STATES, WIDTH)), aligned_empty((4, 2 * OBSERVABLES, WIDTH))
    inverse_scales, integrals0 = aligned_empty((INTEGRALS, WIDTH)), aligned_empty((INTEGRALS, WIDTH))
    sums, turning = aligned_empty((FIRST_ROW + len(Field) * OBSERVABLES, WIDTH)), aligned_empty((WIDTH,))
    if STROBED:  # `given0` contains the number of intervals in a period
        sums = aligned_empty((FIRST_ROW + len(Field) * (OBSERVABLES + STROBED), WIDTH))
        strobes, period = aligned_empty((STROBED, WIDTH)), aligned_empty((WIDTH,))
    for block in range(first_block, last_block):
        stride = steps_per_node[block]
        intervals, spacing = steps[block] // stride, STEP * stride
        load_points(points, block, step_size, state0, constants0, scales, state, constants, inverse_scales)
        if first_node[block] == 0:
            for l in range(WIDTH):
                y, c = load_state(state, l), load_constants(constants, l)
                store_integrals(integrals0, l, y, c)
                store_values(nodes, 0, 0, l, observe(y, c))
            begin(sums, nodes)
        else:
            load_runs(points, block, state, sums, nodes, integrals0, state0, resume, out)
        if STROBED:
            for l in range(WIDTH):
                period[l] = given0[0, points[block, l]]
        for i in range(first_node[block], last_node[block]):
            slot = i & 3
            if STROBED:
                add_strobes(sums, strobes, state, constants, period, i, intervals)
            for l in range(WIDTH):
                y, c = load_state(state, l), load_constants(constants, l)
                slope = rhs(y, c)
                store_state(slopes, l, slope)
                store_values(nodes, slot, 0, l, observe(y, c))
                store_values(nodes, slot, OBSERVABLES, l, observe_change(y, c, slope))
            accumulate(sums, nodes, slot, i, intervals, spacing, value_weights, slope_weights)
            if i >= 2:
                compare_with_neighbours(sums, nodes, i, spacing)
            if i >= 3:  # treat the middle interval of nodes i - 3 to i, and a run's first and last interval
                for interval in range(i - 3 if i == 3 else i - 2, i if i == intervals else i - 1):
                    extend_between(sums, nodes, turning, i, interval, spacing)
            if (i + 1) % NODES_PER_CHANGE == 0 or i == intervals:
                extend_changes(sums, CHANGE, integrals0, inverse_scales, state, constants)
            advance(state, slopes, constants, stride if i < intervals else 0)
        if last_node[block] == intervals + 1:
            store_ends(points, block, step_size, state, constants, state0)
        else:
            store_runs(points, block, state, nodes, integrals0, state0, resume)
        store_sums(points, block, sums, out)


def begin(sums, nodes):
    """Set the sums to 0, and the extremes to the values at the start, which are in slot 0."""
    for row in range(sums.shape[0]):
        for l in range(WIDTH):
            sums[row, l] = 0.0
    for k in range(OBSERVABLES):
        row = FIRST_ROW + len(Field) * k
        for l in range(WIDTH):
            value = nodes[0, k, l]
            sums[row + Field.START, l], sums[row + Field.LEAST, l], sums[row + Field.LARGEST, l] = value, value, value  # fmt: skip


def accumulate(sums, nodes, slot, i, intervals, spacing, value_weights, slope_weights):
    """Add node i to the sums, and update the extremes."""
    weight, slope_weight = 1.0, 0.0
    if i < 4:
        weight += value_weights[i]
        slope_weight += slope_weights[i]
    if intervals - i < 4:
        weight += value_weights[intervals - i]
        slope_weight -= slope_weights[intervals - i]
    u, du = i / intervals - 0.5, 1.0 / intervals
    for k in range(OBSERVABLES):
        row = FIRST_ROW + len(Field) * k
        for l in range(WIDTH):
            value = nodes[slot, k, l]
            g, slope = value - sums[row + Field.START, l], nodes[slot, OBSERVABLES + k, l] * spacing
            sums[row + Field.TOTAL, l] += weight * g + slope_weight * slope
            sums[row + Field.SQUARE, l] += g * (weight * g + 2.0 * slope_weight * slope)
            sums[row + Field.TREND, l] += weight * u * g + slope_weight * (u * slope + du * g)
            least, largest = sums[row + Field.LEAST, l], sums[row + Field.LARGEST, l]
            sums[row + Field.LEAST, l] = value if value < least else least
            sums[row + Field.LARGEST, l] = value if value > largest else largest


def add_strobes(sums, strobes, state, constants, period, i, intervals):
    """Add node i to the sums of observables measured once a period, in lanes where a period ends or the run begins."""
    for l in range(WIDTH):
        store_strobes(strobes, l, load_state(state, l), load_constants(constants, l))
    u = i / intervals - 0.5
    for k in range(STROBED):
        row = FIRST_ROW + len(Field) * (OBSERVABLES + k)
        for l in range(WIDTH):
            value = strobes[k, l]
            if i == 0:
                sums[row + Field.START, l], sums[row + Field.LEAST, l], sums[row + Field.LARGEST, l] = value, value, value  # fmt: skip
            weight = 1.0 if np.floor(i / period[l] + 0.5) * period[l] == i else 0.0
            g = value - sums[row + Field.START, l]
            least, largest = sums[row + Field.LEAST, l], sums[row + Field.LARGEST, l]
            sums[row + Field.TOTAL, l] += weight * g
            sums[row + Field.SQUARE, l] += weight * g * g
            sums[row + Field.TREND, l] += weight * u * g
            sums[row + Field.LEAST, l] = value if weight > 0.0 and value < least else least
            sums[row + Field.LARGEST, l] = value if weight > 0.0 and value > largest else largest


def compare_with_neighbours(sums, nodes, i, spacing):
    """Update ROUGHNESS with the distance of node i - 1 from the Hermite cubic through the nodes i - 2 and i."""
    before, middle, after = (i - 2) & 3, (i - 1) & 3, i & 3
    for k in range(OBSERVABLES):
        row, slope_row = FIRST_ROW + len(Field) * k + Field.ROUGHNESS, OBSERVABLES + k
        for l in range(WIDTH):
            expected = 0.5 * (nodes[before, k, l] + nodes[after, k, l])
            expected += 0.25 * spacing * (nodes[before, slope_row, l] - nodes[after, slope_row, l])
            distance = abs(nodes[middle, k, l] - expected)
            sums[row, l] = distance if distance > sums[row, l] else sums[row, l]


def extend_between(sums, nodes, turning, i, interval, spacing):
    """Update the extremes with turning points in `interval`, which lies between two of the nodes i - 3 to i."""
    first, second = interval & 3, (interval + 1) & 3
    for k in range(OBSERVABLES):
        row, slope_row = FIRST_ROW + len(Field) * k, OBSERVABLES + k
        for l in range(WIDTH):
            f0, f1 = nodes[first, k, l], nodes[second, k, l]
            s0, s1 = nodes[first, slope_row, l] * spacing, nodes[second, slope_row, l] * spacing
            margin = 0.25 * (abs(s0) + abs(s1))
            above = 1.0 if max(f0, f1) + margin > sums[row + Field.LARGEST, l] else 0.0
            below = 1.0 if min(f0, f1) - margin < sums[row + Field.LEAST, l] else 0.0
            possible = above if s0 > 0.0 else below
            twice = turns_twice(f0, f1, s0, s1, CHANGE_ROUNDING * (abs(f0) + abs(f1))) * max(above, below)
            turning[l] = possible if s0 * s1 < 0.0 else twice
        for l in range(WIDTH):
            if turning[l] > 0.0:
                x = place_of_turn(
                    nodes[first, k, l], nodes[second, k, l],
                    nodes[first, slope_row, l] * spacing, nodes[second, slope_row, l] * spacing,
                )  # fmt: skip
                value = interpolated(nodes, i, k, l, spacing, interval - (i - 3) + x)
                least, largest = sums[row + Field.LEAST, l], sums[row + Field.LARGEST, l]
                sums[row + Field.LEAST, l] = value if value < least else least
                sums[row + Field.LARGEST, l] = value if value > largest else largest


def interpolated(nodes, i, k, l, spacing, x):
    """Interpolate observable k at the place x, from 0 to 3, among the nodes i - 3 to i. The degree of the polynomial is 7."""
    value = 0.0
    for j in range(4):
        slot = (i - 3 + j) & 3
        product, inverse = 1.0, 0.0
        for m in range(4):
            if m != j:
                product *= (x - m) / (j - m)
                inverse += 1.0 / (j - m)
        square = product * product
        value += square * (1.0 - 2.0 * inverse * (x - j)) * nodes[slot, k, l]
        value += square * (x - j) * nodes[slot, OBSERVABLES + k, l] * spacing
    return value
