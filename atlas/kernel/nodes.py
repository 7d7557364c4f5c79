"""Kernel of trajectories, which gives states and derivatives at nodes of the motion, without statistics."""

from .generated import (
    CONSTANTS,
    INTEGRALS,
    STATES,
    STEP,
    WIDTH,
    aligned_empty,
    full_vectors,
    load_constants,
    load_state,
    rhs,
    store_state,
    unscaled,
)
from .lanes import advance, load_points


def integrate(schedule, arrays, first_block, last_block):
    """Write states and derivatives at the start and at equidistant nodes. The derivatives use the kernel's unit of time."""
    full_vectors()
    points, steps, _ = schedule
    step_size, state0, constants0, scales, states, derivatives = arrays
    state, slopes = aligned_empty((STATES, WIDTH)), aligned_empty((STATES, WIDTH))
    constants, inverse_scales = aligned_empty((CONSTANTS, WIDTH)), aligned_empty((INTEGRALS, WIDTH))
    for block in range(first_block, last_block):
        load_points(points, block, step_size, state0, constants0, scales, state, constants, inverse_scales)
        for node in range(states.shape[1]):
            for l in range(WIDTH):
                store_state(slopes, l, rhs(load_state(state, l), load_constants(constants, l)))
            for l in range(WIDTH):
                p, c = points[block, l], load_constants(constants, l)
                unit = step_size[p] / STEP
                store_state(states[:, node], p, unscaled(load_state(state, l), c, unit))
                store_state(derivatives[:, node], p, unscaled(load_state(slopes, l), c, unit))
            advance(state, slopes, constants, steps[block] if node + 1 < states.shape[1] else 0)
