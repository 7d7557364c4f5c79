"""The kernel: blocks of WIDTH points integrated side by side, one SIMD lane each.

Ordinary Python. Every loop over `l` runs over the lanes and is what the compiler turns into vector instructions; every
function is inlined into `integrate` but for the rare `pole_correction`. What depends on the system and the method stands
in `generated` and is written by `assemble`, which makes of this file a module for the compiler, or for the interpreter.

Each point is integrated in units of its own (`scaled` of its equations), in which all steps are STEP long and most
coefficients are 1: a sixth of the multiplications less. The statistics are in the units of the caller.

A node is an instant at which the motion is known with its derivative: every steps_per_sample steps, and where there are
several samples per step, every step. Node i is kept in slot i % 4 of `nodes`, so that the interval from node i - 2 to
i - 1 can be interpolated, and corrected for poles, from the four nodes around it once node i is known.
"""

import numpy as np

from .generated import (
    CONSTANTS,
    HAS_AXIS,
    INTEGRALS,
    MAX_SAMPLES,
    STATES,
    STEP,
    WIDTH,
    aligned_empty,
    aligned_stack,
    axis_in_frame,
    frame_motion,
    largest_change,
    load_constants,
    load_state,
    rhs,
    scaled,
    step,
    store_constants,
    store_integrals,
    store_scales,
    store_state,
    unscaled,
)
from .poles import is_near_vertical, pole_correction
from .sampling import quadrature_weight
from .statistics import Row, accumulate, begin

# Components of the motion, u1, u2, u3, g1, g2, g3: rows of a node, followed by those of their derivatives.
MOTION = 6
# First integrals change slowly: they are evaluated at every fourth node and at the end.
NODES_PER_DRIFT = 4


def motion_of(state, constants, inverse_unit):
    """Angular velocity relative to the frame, in the caller's units, and the frame's vertical."""
    u1, u2, u3, g1, g2, g3 = frame_motion(state, constants)
    return u1 * inverse_unit, u2 * inverse_unit, u3 * inverse_unit, g1, g2, g3


def store_motion(nodes, slot, row, l, motion):
    """Write the motion, or its derivative, into rows `row` to row + 5 of a node."""
    (
        nodes[slot, row, l], nodes[slot, row + 1, l], nodes[slot, row + 2, l],
        nodes[slot, row + 3, l], nodes[slot, row + 4, l], nodes[slot, row + 5, l],
    ) = motion  # fmt: skip


def interpolate(nodes, slots, weights, row, l):
    """One component of the motion between four nodes: `hermite_weights` of values and derivatives."""
    s0, s1, s2, s3 = slots
    w0, w1, w2, w3, w4, w5, w6, w7 = weights
    d = row + MOTION
    values = w0 * nodes[s0, row, l] + w1 * nodes[s1, row, l] + w2 * nodes[s2, row, l] + w3 * nodes[s3, row, l]
    slopes = w4 * nodes[s0, d, l] + w5 * nodes[s1, d, l] + w6 * nodes[s2, d, l] + w7 * nodes[s3, d, l]
    return values + STEP * slopes


def interpolated_motion(nodes, slots, weights, l):
    """The motion between four nodes that are one step apart."""
    return (
        interpolate(nodes, slots, weights, 0, l),
        interpolate(nodes, slots, weights, 1, l),
        interpolate(nodes, slots, weights, 2, l),
        interpolate(nodes, slots, weights, 3, l),
        interpolate(nodes, slots, weights, 4, l),
        interpolate(nodes, slots, weights, 5, l),
    )


def interpolation_weights(hermite, samples_per_step, interval, sample):
    """The eight weights of a sample in an interval, as scalars; hermite: sampling.hermite_weights."""
    w = hermite[samples_per_step - 1, interval, sample - 1]
    return w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]


def near_vertical(nodes, first, second, l, interval, spacing, samples_per_step):
    """Do the samples between two nodes need a correction? See `is_near_vertical`; spacing in the kernel's units."""
    slope_0 = spacing * (nodes[first, 3, l] * nodes[first, 9, l] + nodes[first, 4, l] * nodes[first, 10, l])
    slope_1 = spacing * (
        nodes[second, 3, l] * nodes[second, 9, l] + nodes[second, 4, l] * nodes[second, 10, l]
    )
    sin2_theta = nodes[first, 3, l] * nodes[first, 3, l] + nodes[first, 4, l] * nodes[first, 4, l]
    return is_near_vertical(interval, sin2_theta, slope_0, slope_1, samples_per_step)


def correct(
    stats, nodes, hermite_data, l, slot, interval, spacing, duration, first, samples_per_step, intervals, end_weights,
    cylinder_squared,
):  # fmt: skip
    """Subtract the quadrature error of a passage near the vertical from the sums of lane l.

    spacing, duration: distance of two nodes in the kernel's and in the caller's units; first: sample at the first of
    the four nodes.
    """
    for k in range(4):
        n = (slot + 1 + k) & 3
        for derivative in range(2):
            row, unit = MOTION * derivative, (spacing if derivative else 1.0)
            rate = duration * unit
            hermite_data[0, 2 * k + derivative] = complex(
                nodes[n, row + 3, l] * unit, nodes[n, row + 4, l] * unit
            )
            hermite_data[1, 2 * k + derivative] = complex(
                nodes[n, row, l] * rate, nodes[n, row + 1, l] * rate
            )
            hermite_data[2, 2 * k + derivative] = complex(
                nodes[n, row + 5, l] * unit, nodes[n, row + 2, l] * rate
            )
    theta_squared, psi, psi_squared, phi, phi_squared = pole_correction(
        hermite_data, interval, first, samples_per_step, intervals, end_weights,
        stats[Row.PSI_DOT_REFERENCE, l] * duration, stats[Row.PHI_DOT_REFERENCE, l] * duration, cylinder_squared,
    )  # fmt: skip
    stats[Row.PASSAGES, l] += 1.0
    stats[Row.THETA_DOT_SQUARED, l] -= theta_squared / (duration * duration)
    stats[Row.PSI_DOT, l] -= psi / duration
    stats[Row.PSI_DOT_SQUARED, l] -= psi_squared / (duration * duration)
    stats[Row.PHI_DOT, l] -= phi / duration
    stats[Row.PHI_DOT_SQUARED, l] -= phi_squared / (duration * duration)


def integrate(
    first_block, last_block, points, steps, steps_per_sample, samples_per_step, first_node, last_node, step_size,
    state0, constants0, scales, end_weights, hermite, cylinder_squared, resume, out,
):  # fmt: skip
    """Integrate blocks of points over a range of nodes.

    Parameters
    ----------
    first_block, last_block : int
        Range of the blocks to integrate.
    points : ndarray of int64, shape (blocks, WIDTH)
        The points of each block.
    steps, steps_per_sample, samples_per_step : ndarray of int64, shape (blocks,)
        Of the whole run of a block's points, as in `stepsize.StepSizes`.
    first_node, last_node : ndarray of int64, shape (blocks,)
        Range of the nodes of this call; 0 begins the runs, `nodes_of_run` ends them. Between calls the state lies in
        `state0` in the kernel's units, the sums in `out`, the rest in `resume`; the results are the same to the bit
        as those of a single call.
    step_size : ndarray of float64, shape (points,)
        In time units.
    state0 : ndarray of float64, shape (STATES, points), overwritten
        State at the start and, after the last node, at the end.
    constants0, scales : ndarray of float64, shapes (CONSTANTS, points) and (INTEGRALS, points)
        Constants of the equations and reciprocal scales of the first integrals.
    end_weights, hermite : ndarray of float64
        `sampling.END_WEIGHTS` and `sampling.hermite_weights(MAX_SAMPLES)`.
    cylinder_squared : float
        Square of the cylinder tolerance.
    resume : ndarray of float64, shape (4 * 2 * MOTION + INTEGRALS, points), or (0, 0) where all runs are whole
        The last four nodes and the first integrals at the start.
    out : ndarray of float64, shape (len(Row), points), overwritten
        The sums.
    """
    aligned_stack()
    state, constants = aligned_empty((STATES, WIDTH)), aligned_empty((CONSTANTS, WIDTH))
    dt, inverse_unit = aligned_empty((WIDTH,)), aligned_empty((WIDTH,))
    inverse_scales, integrals0 = aligned_empty((INTEGRALS, WIDTH)), aligned_empty((INTEGRALS, WIDTH))
    stats, nodes = aligned_empty((len(Row), WIDTH)), aligned_empty((4, 2 * MOTION, WIDTH))
    near = aligned_empty((WIDTH,))
    hermite_data = np.empty((3, 8), np.complex128)
    for block in range(first_block, last_block):
        stride, samples = steps_per_sample[block], samples_per_step[block]
        intervals = steps[block] // stride
        all_samples = intervals * samples
        last_interval_node = intervals if samples > 1 else intervals - 1
        # The last node, for the derivative at the end of the last interval, has no steps after it.
        run_nodes = intervals + 1 if samples > 1 else intervals
        for l in range(WIDTH):
            p = points[block, l]
            dt[l] = step_size[p]
            unit = dt[l] / STEP
            inverse_unit[l] = 1.0 / unit
            y, c = scaled(load_state(state0, p), load_constants(constants0, p), unit)
            store_state(state, l, y)
            store_constants(constants, l, c)
            store_scales(inverse_scales, l, scales, p, inverse_unit[l])
        if first_node[block] == 0:
            weight = quadrature_weight(0, all_samples, end_weights)
            for l in range(WIDTH):
                y, c = load_state(state, l), load_constants(constants, l)
                begin_run(l, y, c, inverse_unit[l], weight, cylinder_squared, stats, integrals0)
        else:
            for l in range(WIDTH):
                load_run(points[block, l], l, state, stats, nodes, integrals0, state0, resume, out)
        for i in range(first_node[block], last_node[block]):
            slot = i & 3
            for l in range(WIDTH):
                y, c = load_state(state, l), load_constants(constants, l)
                store_motion(nodes, slot, 0, l, motion_of(y, c, inverse_unit[l]))
                store_motion(nodes, slot, MOTION, l, motion_of(rhs(y, c), c, inverse_unit[l]))
            for _ in range(stride if i < intervals else 0):
                for l in range(WIDTH):
                    store_state(state, l, step(load_state(state, l), load_constants(constants, l)))
            if samples == 1:
                weight = quadrature_weight(i + 1, all_samples, end_weights)
                for l in range(WIDTH):
                    motion = motion_of(load_state(state, l), load_constants(constants, l), inverse_unit[l])
                    accumulate(stats, l, motion, weight, dt[l] * stride, cylinder_squared)
            if i >= 3:  # the inner interval; at both ends of the run those beside it, too
                for interval in range(0 if i == 3 else 1, 3 if i == last_interval_node else 2):
                    sample_interval(
                        interval, i, stride, samples, all_samples, dt, nodes, near, hermite_data, stats, end_weights,
                        hermite, cylinder_squared,
                    )  # fmt: skip
            if HAS_AXIS and i < intervals:
                for l in range(WIDTH):
                    a1, a2 = axis_in_frame(load_state(state, l), load_constants(constants, l))
                    stats[Row.AXIS_1, l] += a1
                    stats[Row.AXIS_2, l] += a2
            if (i + 1) % NODES_PER_DRIFT == 0 or i + 1 == intervals:
                for l in range(WIDTH):
                    y, c, drift = load_state(state, l), load_constants(constants, l), stats[Row.DRIFT, l]
                    stats[Row.DRIFT, l] = largest_change(integrals0, inverse_scales, l, y, c, drift)
        for l in range(WIDTH):
            p = points[block, l]
            if last_node[block] == run_nodes:
                y = unscaled(load_state(state, l), load_constants(constants, l), dt[l] / STEP)
                store_state(state0, p, y)
                end_run(l, dt[l] * stride, samples, stats)
            else:
                store_run(p, l, state, nodes, integrals0, state0, resume)
            for row in range(len(Row)):
                out[row, p] = stats[row, l]


def begin_run(l, y, c, inverse_unit, weight, cylinder_squared, stats, integrals0):
    """Start the run of lane l: its first sample and its first integrals."""
    begin(stats, l, motion_of(y, c, inverse_unit), weight, cylinder_squared)
    if HAS_AXIS:
        stats[Row.AXIS_1, l], stats[Row.AXIS_2, l] = axis_in_frame(y, c)
    store_integrals(integrals0, l, y, c)


def sample_interval(
    interval, i, stride, samples, all_samples, dt, nodes, near, hermite_data, stats, end_weights, hermite,
    cylinder_squared,
):  # fmt: skip
    """Take the samples of an interval between nodes i - 3 to i, and correct them where it is near the vertical."""
    slot = i & 3
    if MAX_SAMPLES > 1 and samples > 1:
        slots = (slot + 1) & 3, (slot + 2) & 3, (slot + 3) & 3, slot
        for sample in range(1, samples + 1):
            weight = quadrature_weight(samples * (i - 3 + interval) + sample, all_samples, end_weights)
            weights = interpolation_weights(hermite, samples, interval, sample)
            for l in range(WIDTH):
                motion = interpolated_motion(nodes, slots, weights, l)
                accumulate(stats, l, motion, weight, dt[l] * (1.0 / samples), cylinder_squared)
    first, second, spacing = (slot + 1 + interval) & 3, (slot + 2 + interval) & 3, STEP * stride
    for l in range(WIDTH):
        near[l] = near_vertical(nodes, first, second, l, interval, spacing, samples)
    for l in range(WIDTH):
        if near[l] > 0.0:
            correct(
                stats, nodes, hermite_data, l, slot, interval, spacing, dt[l] * stride, samples * (i - 3), samples,
                all_samples, end_weights, cylinder_squared,
            )  # fmt: skip


def end_run(l, spacing, samples, stats):
    """Take the sum of theta' from theta itself where the axis passed the vertical: theta' jumps there."""
    if stats[Row.PASSAGES, l] > 0.0:
        theta = np.arctan2(np.sqrt(stats[Row.SIN2_THETA, l]), stats[Row.COS_THETA, l])
        stats[Row.THETA_DOT, l] = (theta - stats[Row.FIRST_THETA, l]) * samples / spacing


def load_run(p, l, state, stats, nodes, integrals0, state0, resume, out):
    """Bring an interrupted run of point p into lane l."""
    for row in range(STATES):
        state[row, l] = state0[row, p]
    for row in range(len(Row)):
        stats[row, l] = out[row, p]
    for row in range(8 * MOTION):
        nodes[row // (2 * MOTION), row % (2 * MOTION), l] = resume[row, p]
    for row in range(INTEGRALS):
        integrals0[row, l] = resume[8 * MOTION + row, p]


def store_run(p, l, state, nodes, integrals0, state0, resume):
    """Keep what `load_run` needs beside the sums."""
    for row in range(STATES):
        state0[row, p] = state[row, l]
    for row in range(8 * MOTION):
        resume[row, p] = nodes[row // (2 * MOTION), row % (2 * MOTION), l]
    for row in range(INTEGRALS):
        resume[8 * MOTION + row, p] = integrals0[row, l]
