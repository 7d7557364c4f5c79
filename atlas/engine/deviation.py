"""The kernel of linear deviations: blocks of points, each with a given motion and a small deviation from it.

The given motion x0(t) is a turn by n t about the vertical after one by m t about the third axis; it need not
solve the equations of motion x' = F(x). The deviation d obeys

    d' = F'(x0(t)) d + f(t),

where f is the acceleration by which x0 fails to solve them. It is integrated by the classical Runge-Kutta
method, the sums over its nodes are sums of x0 + d, and everything is in the units of the caller.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from .generated import (
    CONSTANTS,
    STATES,
    WIDTH,
    add_to_rates,
    add_to_state,
    aligned_empty,
    aligned_stack,
    frame_motion,
    load_constants,
    load_state,
    rhs,
    rhs_change,
    store_constants,
    store_state,
    vectors_of_frame,
)


class Given(IntEnum):
    """Rows that describe a point."""

    PRECESSION = 0  # psi' of x0
    SPIN = 1  # phi' of x0
    STEPS = 2
    STEP_SIZE = 3
    DIRECTION = 4  # 1 / sin^2 theta of x0, 0 where the direction of the tilt does not count


class Deviation(IntEnum):
    """Rows of the sums; rates are differences from x0."""

    LINEAR = 0  # 1 if d has been small at every node, else 0; nodes from the first on at which it is not are left out
    LARGEST_SQUARE = 1  # square of the largest size of d
    THETA_DOT_SQUARE = 2
    PSI_DOT = 3
    PSI_DOT_SQUARE = 4
    PHI_DOT = 5
    PHI_DOT_SQUARE = 6
    NORMAL_RATE = 7
    NORMAL_RATE_SQUARE = 8
    LEAST_COTANGENT = 9  # of theta
    LARGEST_COTANGENT = 10
    LARGEST_SINE = 11
    NODES = 12  # that are in the sums


# Rows of the turns of x0: cosines and sines of n t and m t, and of their changes in half a step.
COSINE, SINE, HALF_COSINE, HALF_SINE, TURNS = 0, 2, 4, 6, 8
# Size beyond which d is not small: angles in rad, rates over the frequency bound.
LIMIT = 1e-2
# Steps in which the turns follow from one another; then they are computed anew.
STRETCH = 64
# Of the Runge-Kutta method: weights of the slopes, and how far the next stage is, in steps.
WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
ADVANCES = (0.5, 0.5, 1.0, 0.0)


class DeviationArrays(NamedTuple):
    """What the kernel reads and writes of its points, all arrays (rows, points)."""

    constants: np.ndarray  # of the equations
    # The vectors at rest in the frame before the turn about the third axis: of each the constant parts of its components, then
    # the coefficients of cos n t and sin n t
    harmonics: np.ndarray
    given: np.ndarray  # (len(Given), points)
    start: np.ndarray  # the deviations at the start, (STATES, points)
    scales: np.ndarray  # factors of their components in their size, (STATES, points)
    angle: float  # where sin theta is smaller, psi' and phi' do not count
    sums: np.ndarray  # (len(Deviation), points)


def integrate(points, arrays, first_block, last_block, first_node, last_node):
    """Integrate the deviations of blocks of points, (blocks, WIDTH), over their whole runs: no call ends at a node."""
    aligned_stack()
    constants0, harmonics, given0, start, scales, angle, out = arrays
    constants, harmonic = aligned_empty((CONSTANTS, WIDTH)), aligned_empty((len(harmonics), WIDTH))
    given, scale = aligned_empty((len(Given), WIDTH)), aligned_empty((STATES, WIDTH))
    turns, sums = aligned_empty((TURNS, WIDTH)), aligned_empty((len(Deviation), WIDTH))
    x, force = aligned_empty((STATES, WIDTH)), aligned_empty((3, WIDTH))
    d, stage = aligned_empty((STATES, WIDTH)), aligned_empty((STATES, WIDTH))
    total, size = aligned_empty((STATES, WIDTH)), aligned_empty((WIDTH,))
    for block in range(first_block, last_block):
        for l in range(WIDTH):
            p = points[block, l]
            store_constants(constants, l, load_constants(constants0, p))
            store_state(d, l, load_state(start, p))
            store_state(stage, l, load_state(start, p))
            store_state(total, l, load_state(start, p))
            store_state(scale, l, load_state(scales, p))
            for row in range(len(harmonics)):
                harmonic[row, l] = harmonics[row, p]
            for row in range(len(Given)):
                given[row, l] = given0[row, p]
        begin(sums, turns, given)
        k = 0
        while any_used(sums, given, k):
            for i in range(4):
                renewed, halfway = i == 0 and k % STRETCH == 0, i % 2 == 1
                if renewed:
                    compute_turns(turns, given, k)
                if halfway:
                    advance_turns(turns)
                if renewed or halfway:
                    place(x, force, harmonic, turns, given, constants)
                if i == 0:
                    add_sample(sums, x, d, size, scale, given, constants, angle, k)
                add_stage(total, stage, d, x, force, given, constants, WEIGHTS[i], ADVANCES[i])
            end_step(d, stage, total)
            k += 1
        for l in range(WIDTH):
            for row in range(len(Deviation)):
                out[row, points[block, l]] = sums[row, l]


def begin(sums, turns, given):
    """Start the sums, and compute the turns of x0 in half a step."""
    for row in range(len(Deviation)):
        for l in range(WIDTH):
            sums[row, l] = 0.0
    for l in range(WIDTH):
        sums[Deviation.LINEAR, l] = 1.0
        sums[Deviation.LEAST_COTANGENT, l], sums[Deviation.LARGEST_COTANGENT, l] = np.inf, -np.inf
    for i in range(2):  # PRECESSION and SPIN
        for l in range(WIDTH):
            half = 0.5 * given[Given.STEP_SIZE, l] * given[i, l]
            turns[HALF_COSINE + i, l], turns[HALF_SINE + i, l] = np.cos(half), np.sin(half)


def any_used(sums, given, k):
    """Whether node k of one lane at least belongs to its run and may count."""
    used = 0.0
    for l in range(WIDTH):
        used += sums[Deviation.LINEAR, l] if k <= given[Given.STEPS, l] else 0.0
    return used > 0.0


def compute_turns(turns, given, k):
    """The turns of x0 at node k."""
    for i in range(2):
        for l in range(WIDTH):
            angle = k * given[Given.STEP_SIZE, l] * given[i, l]
            turns[COSINE + i, l], turns[SINE + i, l] = np.cos(angle), np.sin(angle)


def advance_turns(turns):
    """The turns of x0 half a step later."""
    for i in range(2):
        for l in range(WIDTH):
            c, s = turns[COSINE + i, l], turns[SINE + i, l]
            dc, ds = turns[HALF_COSINE + i, l], turns[HALF_SINE + i, l]
            turns[COSINE + i, l], turns[SINE + i, l] = c * dc - s * ds, s * dc + c * ds


def place(x, force, harmonic, turns, given, constants):
    """x0 after these turns, and f there: u' - n m gamma x e3 with u' from the equations."""
    for l in range(WIDTH):
        c, n, m = load_constants(constants, l), given[Given.PRECESSION, l], given[Given.SPIN, l]
        cosine, sine = turns[COSINE + Given.SPIN, l], turns[SINE + Given.SPIN, l]
        y = vectors_of_frame(harmonic, l, turns[COSINE, l], turns[SINE, l], cosine, sine)
        # The rate relative to the frame is the sum of the angular velocity, here still 0, and terms of these vectors.
        u1, u2, u3, g1, g2, g3 = frame_motion(y, c)
        y = add_to_rates(y, n * g1 - u1, n * g2 - u2, n * g3 + m - u3)
        du1, du2, du3, dg1, dg2, dg3 = frame_motion(rhs(y, c), c)
        store_state(x, l, y)
        force[0, l], force[1, l], force[2, l] = du1 - n * m * g2, du2 + n * m * g1, du3


def add_stage(total, stage, d, x, force, given, constants, weight, advance):
    """Add the slope of d to their sum, and compute d of the next stage."""
    for l in range(WIDTH):
        h = given[Given.STEP_SIZE, l]
        slope = rhs_change(load_state(x, l), load_constants(constants, l), load_state(stage, l))
        slope = add_to_rates(slope, force[0, l], force[1, l], force[2, l])
        store_state(total, l, add_to_state(load_state(total, l), weight * h, slope))
        store_state(stage, l, add_to_state(load_state(d, l), advance * h, slope))


def end_step(d, stage, total):
    """d after a step."""
    for l in range(WIDTH):
        after = load_state(total, l)
        store_state(d, l, after)
        store_state(stage, l, after)


def add_sample(sums, x, d, size, scale, given, constants, angle, k):
    """Add node k of x0 + d to the sums, unless d is or has been large; size: one row, overwritten."""
    for row in range(STATES):
        for l in range(WIDTH):
            component = d[row, l] * scale[row, l]
            square, before = component * component, size[l] if row > 0 else 0.0
            size[l] = before if square <= before else (square if square < np.inf else np.inf)  # for nan
    for l in range(WIDTH):
        c = load_constants(constants, l)
        u1, u2, u3, g1, g2, g3 = frame_motion(load_state(x, l), c)
        du1, du2, du3, dg1, dg2, dg3 = frame_motion(load_state(d, l), c)
        normal_rate = u1 * dg1 + u2 * dg2 + u3 * dg3 + du1 * (g1 + dg1) + du2 * (g2 + dg2) + du3 * (g3 + dg3)
        u1, u2, u3, g1, g2, g3 = u1 + du1, u2 + du2, u3 + du3, g1 + dg1, g2 + dg2, g3 + dg3
        sine = np.sqrt(g1 * g1 + g2 * g2)
        cosecant = 1.0 / sine
        cotangent, rate = g3 * cosecant, (u1 * g1 + u2 * g2) * cosecant * cosecant
        across = (dg1 * dg1 + dg2 * dg2) * given[Given.DIRECTION, l]
        square = across if across > size[l] else size[l]
        within = k <= given[Given.STEPS, l]
        linear = sums[Deviation.LINEAR, l] > 0.0 and (square <= LIMIT * LIMIT or not within)
        used = linear and within
        outside = used and sine >= angle
        theta_dot = (u1 * g2 - u2 * g1) * cosecant if used and sine > 0.0 else 0.0
        psi_dot = rate - given[Given.PRECESSION, l] if outside else 0.0
        phi_dot = u3 - rate * g3 - given[Given.SPIN, l] if outside else 0.0
        normal_rate = normal_rate if used else 0.0
        sums[Deviation.LINEAR, l] = 1.0 if linear else 0.0
        largest = sums[Deviation.LARGEST_SQUARE, l]
        sums[Deviation.LARGEST_SQUARE, l] = square if used and square > largest else largest
        sums[Deviation.THETA_DOT_SQUARE, l] += theta_dot * theta_dot
        sums[Deviation.PSI_DOT, l] += psi_dot
        sums[Deviation.PSI_DOT_SQUARE, l] += psi_dot * psi_dot
        sums[Deviation.PHI_DOT, l] += phi_dot
        sums[Deviation.PHI_DOT_SQUARE, l] += phi_dot * phi_dot
        sums[Deviation.NORMAL_RATE, l] += normal_rate
        sums[Deviation.NORMAL_RATE_SQUARE, l] += normal_rate * normal_rate
        least, largest = sums[Deviation.LEAST_COTANGENT, l], sums[Deviation.LARGEST_COTANGENT, l]
        sums[Deviation.LEAST_COTANGENT, l] = cotangent if used and cotangent < least else least
        sums[Deviation.LARGEST_COTANGENT, l] = cotangent if used and cotangent > largest else largest
        largest = sums[Deviation.LARGEST_SINE, l]
        sums[Deviation.LARGEST_SINE, l] = sine if used and sine > largest else largest
        sums[Deviation.NODES, l] += 1.0 if used else 0.0
