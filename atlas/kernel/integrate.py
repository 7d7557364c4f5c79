"""The kernel, which integrates blocks of WIDTH points side by side. Each point has a SIMD lane.

`assemble` puts the text of this module, which is ordinary Python, into a module for the compiler. The compiler turns every loop
over the lanes `l` into vector instructions, and inlines every function into `integrate`. The functions of `generated` depend on
the system and the method.

Each point is integrated in units of its own (see `scaled` of the equations). In these units all steps are STEP long, and most
coefficients are 1, which saves a sixth of the multiplications. The statistics are in the units of the caller.

A node is an instant at which the motion and its derivative are evaluated. There is a node every steps_per_sample steps. Node i
is kept in slot i % 4 of `nodes`, so that the motion between the nodes i - 2 and i - 1 can be interpolated from four nodes. The
statistics are sums over the nodes and, near both ends of a run, over interpolated samples (see `sampling`). Passages near the
vertical and turning points of theta wait in queues. QUEUE passages or turning points are computed side by side (see `poles`).
"""

import numpy as np

from .generated import (
    CONSTANTS,
    HAS_AXIS,
    INTEGRALS,
    PLUGGED,
    PLUGGED_GIVEN,
    STATES,
    STEP,
    WIDTH,
    add_to_plugged,
    aligned_empty,
    axis_in_frame,
    frame_motion,
    frame_motion_change,
    full_vectors,
    load_constants,
    load_state,
    rhs,
    store_integrals,
    store_state,
)
from .lanes import (
    advance,
    extend_changes,
    load_plugged,
    load_points,
    load_runs,
    store_ends,
    store_plugged,
    store_runs,
    store_sums,
)
from .poles import (
    NEWTON_STEPS,
    PASSAGE_ROWS,
    REACH,
    TURN_ROWS,
    TURN_STEPS,
    Passage,
    Term,
    Turn,
    approximate_zero,
    difference,
    improve_zero,
    place_of_turn,
    pole_terms,
    sum_errors,
    turning_point,
    turns_near_vertical,
)
from .sampling import END, LONG, rule_position, stretched
from .statistics import Node, Row, accumulate, begin, end, extend, may_extend

MOTION = 6  # number of components of the motion, which are the first rows of a `Node`
# First integrals are evaluated at every fourth node and at the end only, because they change slowly.
NODES_PER_DRIFT = 4
# Every NODES_PER_LEVEL-th node is compared with levels of the energy.
NODES_PER_LEVEL = 8
# This many turning points, or passages, are computed side by side. The queues have room for WIDTH more.
QUEUE = 32
# An end of a run is searched for a passage if sin^2 theta there is below this value.
NEAR_END = 0.2


def motion_of(state, constants, inverse_unit):
    """Return the angular velocity relative to the frame, in the caller's units, and the vertical of the frame."""
    u1, u2, u3, g1, g2, g3 = frame_motion(state, constants)
    return u1 * inverse_unit, u2 * inverse_unit, u3 * inverse_unit, g1, g2, g3


def motion_change_of(state, constants, slope, inverse_unit):
    """Return the time derivative of the motion, given the slope of the state."""
    u1, u2, u3, g1, g2, g3 = frame_motion_change(state, constants, slope)
    return u1 * inverse_unit, u2 * inverse_unit, u3 * inverse_unit, g1, g2, g3


def store_motion(nodes, slot, row, l, motion):
    """Write the motion or the derivative of the motion into rows `row` to row + 5 of a node."""
    (
        nodes[slot, row, l], nodes[slot, row + 1, l], nodes[slot, row + 2, l],
        nodes[slot, row + 3, l], nodes[slot, row + 4, l], nodes[slot, row + 5, l],
    ) = motion  # fmt: skip


def motion_at(nodes, slot, l):
    return (
        nodes[slot, Node.U1, l], nodes[slot, Node.U2, l], nodes[slot, Node.U3, l],
        nodes[slot, Node.G1, l], nodes[slot, Node.G2, l], nodes[slot, Node.G3, l],
    )  # fmt: skip


def interpolate(nodes, slots, weights, row, l):
    """Return a component of the motion, interpolated by `weights` from the values and derivatives at four nodes."""
    s0, s1, s2, s3 = slots
    w0, w1, w2, w3, w4, w5, w6, w7 = weights
    d = row + MOTION
    values = w0 * nodes[s0, row, l] + w1 * nodes[s1, row, l] + w2 * nodes[s2, row, l] + w3 * nodes[s3, row, l]
    slopes = w4 * nodes[s0, d, l] + w5 * nodes[s1, d, l] + w6 * nodes[s2, d, l] + w7 * nodes[s3, d, l]
    return values + slopes


def interpolated_motion(nodes, slots, weights, l):
    return (
        interpolate(nodes, slots, weights, 0, l),
        interpolate(nodes, slots, weights, 1, l),
        interpolate(nodes, slots, weights, 2, l),
        interpolate(nodes, slots, weights, 3, l),
        interpolate(nodes, slots, weights, 4, l),
        interpolate(nodes, slots, weights, 5, l),
    )


def sample_weights(samples, j, spacing):
    """Return the eight weights of sample j. Weights of derivatives are multiplied by `spacing`, the distance of two nodes."""
    w = samples[j]
    return w[1], w[2], w[3], w[4], w[5] * spacing, w[6] * spacing, w[7] * spacing, w[8] * spacing


def integrate(schedule, arrays, first_block, last_block, first_node, last_node):
    """Integrate each block from `first_node` to the node before `last_node`. Both arrays have the shape (blocks,).

    Several calls for the nodes 0 to steps / steps_per_sample of a run give exactly the result of one call. `arrays.rule` is a `Quadrature`.
    """
    full_vectors()
    points, steps, steps_per_sample = schedule
    step_size, state0, constants0, scales, given0, rules, cylinder_squared, resume, out = arrays
    node_weights, first_sample, samples = rules
    state, constants = aligned_empty((STATES, WIDTH)), aligned_empty((CONSTANTS, WIDTH))
    dt, inverse_unit = aligned_empty((WIDTH,)), aligned_empty((WIDTH,))
    inverse_scales, integrals0 = aligned_empty((INTEGRALS, WIDTH)), aligned_empty((INTEGRALS, WIDTH))
    stats, nodes = aligned_empty((len(Row), WIDTH)), aligned_empty((4, 2 * MOTION, WIDTH))
    slopes = aligned_empty((STATES, WIDTH))
    turning, near = aligned_empty((WIDTH,)), aligned_empty((WIDTH,))
    turns, extremes = empty_queue(TURN_ROWS), aligned_empty((2, QUEUE))
    passages, farther = empty_queue(PASSAGE_ROWS), empty_queue(PASSAGE_ROWS)
    terms = aligned_empty((2, len(Term), QUEUE))
    numbers = np.zeros((4, QUEUE + WIDTH), np.int64)
    turn_lanes, lanes, first_nodes, places = numbers[0], numbers[1], numbers[2], numbers[3]
    if PLUGGED:
        given, plugged = aligned_empty((PLUGGED_GIVEN, WIDTH)), aligned_empty((PLUGGED, WIDTH))
    for block in range(first_block, last_block):
        stride = steps_per_sample[block]
        intervals, spacing = steps[block] // stride, STEP * stride
        rule = min(intervals, LONG)
        begins, ends = first_node[block] == 0, last_node[block] == intervals + 1
        # The counts are integers of NumPy. For a literal 0, Numba would compile the called functions a second time.
        passage_count, turn_count = np.int64(0), np.int64(0)
        load_points(points, block, step_size, state0, constants0, scales, state, constants, inverse_scales)
        load_step_sizes(points, block, step_size, dt, inverse_unit)
        if begins:
            begin_runs(stats, integrals0, state, constants, inverse_unit, cylinder_squared)
        else:
            load_runs(points, block, state, stats, nodes, integrals0, state0, resume, out)
        if PLUGGED:
            load_plugged(points, block, begins, given, plugged, given0, out, len(Row))
        for i in range(first_node[block], last_node[block]):
            slot, last = i & 3, i + 1 == last_node[block]
            evaluate_node(nodes, slot, slopes, state, constants, inverse_unit)
            add_node(stats, nodes, slot, node_weights[rule, rule_position(i, intervals)], cylinder_squared)
            if i >= 3:  # treat the middle one of three intervals, and at an end of the run the outer one too
                slots = (i - 3) & 3, (i - 2) & 3, (i - 1) & 3, slot
                for interval in range(i - 3 if i == 3 else i - 2, i if i == intervals else i - 1):
                    position = rule_position(interval, intervals)
                    first, stop = first_sample[rule, position], first_sample[rule, position + 1]
                    add_samples(stats, nodes, slots, spacing, samples, first, stop, cylinder_squared)
                    mark(turning, near, stats, nodes, spacing, interval, intervals)
                    turn_count = queue_turns(
                        turns, turn_lanes, turn_count, turning, nodes, slots, spacing, i - 3, interval
                    )
                    passage_count = queue_passages(
                        passages, lanes, first_nodes, passage_count, near, stats, nodes, slots, spacing, stride, dt,
                        i - 3, interval, intervals,
                    )  # fmt: skip
                    while turn_count >= QUEUE or (last and turn_count > 0):
                        turn_count = extend_to_turns(stats, turns, turn_lanes, turn_count, extremes)
                    while passage_count >= QUEUE or (last and passage_count > 0):
                        passage_count = correct(
                            stats, passages, farther, places, terms, lanes, first_nodes, passage_count, stride, dt,
                            intervals, cylinder_squared,
                        )  # fmt: skip
            if PLUGGED:
                add_to_plugged(plugged, given, nodes, i, intervals, spacing, inverse_unit, state, constants)
            if HAS_AXIS:
                add_axis(stats, state, constants)
            if (i + 1) % NODES_PER_DRIFT == 0 or i == intervals:
                extend_changes(stats, Row.DRIFT, integrals0, inverse_scales, state, constants)
            advance(state, slopes, constants, stride if i < intervals else 0)
        if ends:
            end_runs(stats, nodes, intervals & 3)
            store_ends(points, block, step_size, state, constants, state0)
        else:
            store_runs(points, block, state, nodes, integrals0, state0, resume)
        store_sums(points, block, stats, out)
        if PLUGGED:
            store_plugged(points, block, plugged, out, len(Row))


def empty_queue(rows):
    """Return a queue of zeros. Unused columns take part in computations and must hold numbers."""
    queue = aligned_empty((rows, QUEUE + WIDTH))
    queue[:] = 0.0
    return queue


def move_up(queue, lanes, first_nodes, count):
    """Move the columns QUEUE to `count` - 1 of a queue to the front. Return the number of these columns."""
    rest = max(count - QUEUE, 0)
    for e in range(rest):
        lanes[e], first_nodes[e] = lanes[QUEUE + e], first_nodes[QUEUE + e]
        for row in range(queue.shape[0]):
            queue[row, e] = queue[row, QUEUE + e]
    return rest


def load_step_sizes(points, block, step_size, dt, inverse_unit):
    """Load the step sizes of a block's points, and the reciprocals of the kernel's units of time, into the lanes."""
    for l in range(WIDTH):
        dt[l] = step_size[points[block, l]]
        inverse_unit[l] = 1.0 / (dt[l] / STEP)


def begin_runs(stats, integrals0, state, constants, inverse_unit, cylinder_squared):
    """Begin the statistics and the first integrals of a block."""
    for l in range(WIDTH):
        y, c = load_state(state, l), load_constants(constants, l)
        begin(stats, l, motion_of(y, c, inverse_unit[l]), cylinder_squared)
        store_integrals(integrals0, l, y, c)


def evaluate_node(nodes, slot, slopes, state, constants, inverse_unit):
    """Write the motion and the derivative of the motion into a node, and the derivatives of the states into `slopes`."""
    for l in range(WIDTH):
        y, c = load_state(state, l), load_constants(constants, l)
        store_motion(nodes, slot, 0, l, motion_of(y, c, inverse_unit[l]))
        slope = rhs(y, c)
        store_state(slopes, l, slope)
        store_motion(nodes, slot, MOTION, l, motion_change_of(y, c, slope, inverse_unit[l]))


def add_node(stats, nodes, slot, weight, cylinder_squared):
    for l in range(WIDTH):
        motion = motion_at(nodes, slot, l)
        if weight > 0.0:  # near the ends of a run, samples replace some nodes
            accumulate(stats, l, motion, weight, cylinder_squared)
        extend(stats, l, motion[5], motion[3] * motion[3] + motion[4] * motion[4])


def add_samples(stats, nodes, slots, spacing, samples, first, stop, cylinder_squared):
    """Add the samples `first` to `stop` - 1, which lie in one interval between the four nodes."""
    for j in range(first, stop):
        weights = sample_weights(samples, j, spacing)
        for l in range(WIDTH):
            motion = interpolated_motion(nodes, slots, weights, l)
            accumulate(stats, l, motion, samples[j, 0], cylinder_squared)


def add_axis(stats, state, constants):
    """Add the third body axis to the statistics."""
    for l in range(WIDTH):
        a1, a2 = axis_in_frame(load_state(state, l), load_constants(constants, l))
        stats[Row.AXIS_1, l] += a1
        stats[Row.AXIS_2, l] += a2


def end_runs(stats, nodes, slot):
    """End the statistics of a block at the last node."""
    for l in range(WIDTH):
        end(stats, l, motion_at(nodes, slot, l))


def mark(turning, near, stats, nodes, spacing, interval, intervals):
    """Set `turning` to 1.0 where theta may have a new extreme, and `near` to 1.0 where the axis may pass near the vertical."""
    first, second = interval & 3, (interval + 1) & 3
    for l in range(WIDTH):
        slope_0, slope_1 = spacing * nodes[first, Node.DG3, l], spacing * nodes[second, Node.DG3, l]
        turning[l] = may_extend(stats, l, nodes[first, Node.G3, l], nodes[second, Node.G3, l], slope_0, slope_1)  # fmt: skip
        near[l], _ = near_vertical(nodes, first, second, l, spacing, interval, intervals)


def queue_turns(turns, lanes, count, turning, nodes, slots, spacing, first_node, interval):
    """Append the turning points of the marked lanes to the queue, and return the length of the queue."""
    first, second = interval & 3, (interval + 1) & 3
    for l in range(WIDTH):
        if turning[l] > 0.0:
            lanes[count] = l
            slope_0, slope_1 = spacing * nodes[first, Node.DG3, l], spacing * nodes[second, Node.DG3, l]
            x = place_of_turn(nodes[first, Node.G3, l], nodes[second, Node.G3, l], slope_0, slope_1)
            store_turn(turns, count, nodes, slots, l, spacing, interval - first_node, x)
            count += 1
    return count


def queue_passages(
    passages, lanes, first_nodes, count, near, stats, nodes, slots, spacing, stride, dt, first_node, interval, intervals
):  # fmt: skip
    """Append the passages of the marked lanes to the queue, and return the length of the queue."""
    first, second = interval & 3, (interval + 1) & 3
    for l in range(WIDTH):
        if near[l] > 0.0:
            lanes[count], first_nodes[count] = l, first_node
            _, instant = near_vertical(nodes, first, second, l, spacing, interval, intervals)
            time = interval - first_node + instant
            store_passage(passages, count, nodes, slots, l, spacing, stride * dt[l], time, stats)
            count += 1
    return count


def near_vertical(nodes, first, second, l, spacing, interval, intervals):
    """Return 1.0 if zeta = g1 + i g2 may have a zero near an interval, else 0.0. Return also the zero's place from 0 to 1.

    See `poles.turns_near_vertical`. At an end of a run near the vertical, a zero may exist although sin^2 theta has no minimum.
    """
    slope_0 = spacing * (nodes[first, Node.G1, l] * nodes[first, Node.DG1, l] + nodes[first, Node.G2, l] * nodes[first, Node.DG2, l])  # fmt: skip
    slope_1 = spacing * (nodes[second, Node.G1, l] * nodes[second, Node.DG1, l] + nodes[second, Node.G2, l] * nodes[second, Node.DG2, l])  # fmt: skip
    sin2_0 = nodes[first, Node.G1, l] * nodes[first, Node.G1, l] + nodes[first, Node.G2, l] * nodes[first, Node.G2, l]  # fmt: skip
    sin2_1 = nodes[second, Node.G1, l] * nodes[second, Node.G1, l] + nodes[second, Node.G2, l] * nodes[second, Node.G2, l]  # fmt: skip
    near, instant = turns_near_vertical(sin2_0, slope_0, slope_1)
    at_start = (1.0 if interval == 0 else 0.0) * ((1.0 - near) if sin2_0 < NEAR_END else 0.0)
    at_end = (1.0 if interval == intervals - 1 else 0.0) * ((1.0 - near) if sin2_1 < NEAR_END else 0.0)
    ends = at_start + at_end
    return near + (1.0 if ends > 0.0 else 0.0), (instant if near > 0.0 else (0.0 if at_start > 0.0 else 1.0))


def store_passage(passages, e, nodes, slots, l, spacing, duration, time, stats):
    """Write a passage of lane l into column e. `duration` is `spacing` in the caller's units."""
    store_component(passages, Passage.G1, Passage.G1_SLOPE, e, nodes, slots, 3, l, 1.0, spacing)
    store_component(passages, Passage.G2, Passage.G2_SLOPE, e, nodes, slots, 4, l, 1.0, spacing)
    store_component(
        passages, Passage.U3, Passage.U3_SLOPE, e, nodes, slots, 2, l, duration, spacing * duration
    )
    passages[Passage.TIME, e] = time
    passages[Passage.VERTICAL, e] = 1.0 if nodes[slots[1], 5, l] > 0.0 else -1.0
    passages[Passage.PSI_DOT_REFERENCE, e] = stats[Row.PSI_DOT_REFERENCE, l] * duration
    passages[Passage.PHI_DOT_REFERENCE, e] = stats[Row.PHI_DOT_REFERENCE, l] * duration


def store_turn(turns, e, nodes, slots, l, spacing, node, x):
    """Write a turning point of lane l into column e. The point is about x intervals after `node`, the index of one of the four nodes."""
    store_component(turns, Turn.G1, Turn.G1_SLOPE, e, nodes, slots, 3, l, 1.0, spacing)
    store_component(turns, Turn.G2, Turn.G2_SLOPE, e, nodes, slots, 4, l, 1.0, spacing)
    store_component(turns, Turn.G3, Turn.G3_SLOPE, e, nodes, slots, 5, l, 1.0, spacing)
    turns[Turn.TIME, e] = node + x
    turns[Turn.NODE, e] = node


def store_component(queue, row, slope_row, e, nodes, slots, component, l, unit, slope_unit):
    """Write a component at four nodes, times `unit`, and the derivative, times `slope_unit`, into column e of a queue."""
    for k in range(4):
        queue[row + k, e] = nodes[slots[k], component, l] * unit
        queue[slope_row + k, e] = nodes[slots[k], component + MOTION, l] * slope_unit


def extend_to_turns(stats, turns, lanes, count, extremes):
    """Update the extremes with the first QUEUE of `count` turning points, and return the number of turning points left."""
    for e in range(QUEUE):
        difference(turns, Turn.G1, e)
        difference(turns, Turn.G2, e)
        difference(turns, Turn.G3, e)
    for _ in range(TURN_STEPS):
        for e in range(QUEUE):
            extremes[0, e], extremes[1, e] = turning_point(turns, e)
    for e in range(min(count, QUEUE)):
        extend(stats, lanes[e], extremes[0, e], extremes[1, e])
    return move_up(turns, lanes, lanes, count)


def correct(
    stats, passages, farther, places, terms, lanes, first_nodes, count, stride, dt, intervals, cylinder_squared
):  # fmt: skip
    """Add up the quadrature errors at the first QUEUE of `count` passages, and return the number of passages left."""
    for e in range(QUEUE):
        difference(passages, Passage.G1, e)
        difference(passages, Passage.G2, e)
        difference(passages, Passage.U3, e)
    zeros(passages, terms, np.int64(0), np.int64(QUEUE))
    zeros(farther, terms, np.int64(1), collect_farther(passages, farther, places, min(count, QUEUE)))
    for e in range(min(count, QUEUE)):
        l = lanes[e]
        for zero in range(2 if passages[Passage.FARTHER, e] > 0.0 else 1):
            column = places[e] if zero else e
            z = complex(terms[zero, Term.Z_REAL, column] + first_nodes[e], terms[zero, Term.Z_IMAG, column])
            if counts(stats, l, terms, zero, column, z, intervals, cylinder_squared):
                stats[Row.ZERO_2_REAL, l], stats[Row.ZERO_2_IMAG, l] = (
                    stats[Row.ZERO_1_REAL, l],
                    stats[Row.ZERO_1_IMAG, l],
                )
                stats[Row.ZERO_1_REAL, l], stats[Row.ZERO_1_IMAG, l] = z.real, z.imag
                if min(z.real, intervals - z.real) < END:
                    tau, slope = stretched(z, intervals - z)
                    sum_errors(terms, zero, column, tau, slope, passages[Passage.VERTICAL, e])
                per_time = 1.0 / (stride * dt[l])
                for k in range(5):  # for even k the row belongs to a squared rate
                    unit = per_time if k % 2 else per_time * per_time
                    error = terms[zero, Term.THETA_DOT_SQUARED_ERROR + k, column]
                    stats[Row.THETA_DOT_SQUARED_ERROR + k, l] += error * unit
    return move_up(passages, lanes, first_nodes, count)


def zeros(passages, terms, farther, count):
    """Find the nearer zero of zeta = g1 + i g2 at each passage, or the farther zero if `farther` is 1. Write pole terms into `terms`."""
    for e in range(count):
        approximate_zero(passages, e, farther)
    for _ in range(NEWTON_STEPS):
        for e in range(count):
            improve_zero(passages, e)
    for e in range(count):
        pole_terms(passages, e, terms, farther)


def collect_farther(passages, farther, places, count):
    """Copy into `farther` the passages whose farther zero may need a correction. Return their number, rounded up to a multiple of 8."""
    number = 0
    for e in range(count):
        if passages[Passage.FARTHER, e] > 0.0:
            places[e] = number
            for row in range(PASSAGE_ROWS):
                farther[row, number] = passages[row, e]
            number += 1
    return (number + 7) // 8 * 8


def counts(stats, l, terms, farther, e, z, intervals, cylinder_squared):
    """Whether the zero z of a passage needs a correction of its own. z is relative to the first node of the run."""
    x, y = abs(terms[farther, Term.Z_REAL, e] - 1.5), abs(z.imag)
    # The polynomial loses accuracy beyond the four nodes. This matters little for a zero far from the real axis.
    near = x < 1.5 + 0.5 * y and y < REACH + 1.0 and terms[farther, Term.CHANGE, e] < 1e-4 * y * y
    # Inside the cylinder there are no samples of psi' and phi'.
    inside = terms[farther, Term.SIN2_THETA, e] <= cylinder_squared and 0.0 < z.real < intervals
    # Successive passages, or both approximations of one passage, may lead to the same zero.
    same = 0.1 * y
    x1, y1 = z.real - stats[Row.ZERO_1_REAL, l], z.imag - stats[Row.ZERO_1_IMAG, l]
    x2, y2 = z.real - stats[Row.ZERO_2_REAL, l], z.imag - stats[Row.ZERO_2_IMAG, l]
    corrected = x1 * x1 + y1 * y1 < same * same or x2 * x2 + y2 * y2 < same * same
    return near and not inside and not corrected
