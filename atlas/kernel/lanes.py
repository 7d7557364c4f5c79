"""Copy points to and from the lanes of a block, and take steps. The arrays of a block have a column for each lane."""

from .generated import (
    INTEGRALS,
    STATES,
    STEP,
    STORES_SLOPE,
    WIDTH,
    largest_change,
    load_constants,
    load_state,
    rhs,
    scaled,
    step,
    store_constants,
    store_scales,
    store_state,
    unscaled,
)


def load_points(points, block, step_size, state0, constants0, scales, state, constants, inverse_scales):
    """Load the starts of a block's points into the lanes, in the kernel's units."""
    for l in range(WIDTH):
        p = points[block, l]
        unit = step_size[p] / STEP
        y, c = scaled(load_state(state0, p), load_constants(constants0, p), unit)
        store_state(state, l, y)
        store_constants(constants, l, c)
        store_scales(inverse_scales, l, scales, p, 1.0 / unit)


def load_runs(points, block, state, sums, nodes, integrals0, state0, resume, out):
    """Load the interrupted runs of a block's points into the lanes. `load_points` must be called before."""
    rows = nodes.shape[1]
    for l in range(WIDTH):
        p = points[block, l]
        for row in range(STATES):
            state[row, l] = state0[row, p]
        for row in range(sums.shape[0]):
            sums[row, l] = out[row, p]
        for row in range(4 * rows):
            nodes[row // rows, row % rows, l] = resume[row, p]
        for row in range(INTEGRALS):
            integrals0[row, l] = resume[4 * rows + row, p]


def store_runs(points, block, state, nodes, integrals0, state0, resume):
    """Store interrupted runs for `load_runs`. This does not include the sums."""
    rows = nodes.shape[1]
    for l in range(WIDTH):
        p = points[block, l]
        for row in range(STATES):
            state0[row, p] = state[row, l]
        for row in range(4 * rows):
            resume[row, p] = nodes[row // rows, row % rows, l]
        for row in range(INTEGRALS):
            resume[4 * rows + row, p] = integrals0[row, l]


def store_ends(points, block, step_size, state, constants, state0):
    """Write the final states of the runs, in the caller's units."""
    for l in range(WIDTH):
        p = points[block, l]
        y = unscaled(load_state(state, l), load_constants(constants, l), step_size[p] / STEP)
        store_state(state0, p, y)


def store_sums(points, block, sums, out):
    for l in range(WIDTH):
        p = points[block, l]
        for row in range(sums.shape[0]):
            out[row, p] = sums[row, l]


def load_plugged(points, block, begins, given, plugged, given0, out, first_row):
    """Load constants and sums of the plugged instruments into the lanes. The sums are 0 if the runs begin."""
    for l in range(WIDTH):
        p = points[block, l]
        for row in range(given.shape[0]):
            given[row, l] = given0[row, p]
        for row in range(plugged.shape[0]):
            plugged[row, l] = 0.0 if begins else out[first_row + row, p]


def store_plugged(points, block, plugged, out, first_row):
    """Write the sums of the plugged instruments after the sums of the kernel."""
    for l in range(WIDTH):
        for row in range(plugged.shape[0]):
            out[first_row + row, points[block, l]] = plugged[row, l]


def advance(state, slopes, constants, steps):
    """Take `steps` steps. `slopes` holds the derivatives of the states before the first step."""
    for k in range(steps):
        if STORES_SLOPE and k > 0:
            for l in range(WIDTH):
                store_state(slopes, l, rhs(load_state(state, l), load_constants(constants, l)))
        for l in range(WIDTH):
            y, c = load_state(state, l), load_constants(constants, l)
            slope = load_state(slopes, l) if STORES_SLOPE else rhs(y, c)
            store_state(state, l, step(y, slope, c))


def extend_changes(sums, row, integrals0, inverse_scales, state, constants):
    """Update `row` of the sums, which holds the largest change of a first integral in each lane."""
    for l in range(WIDTH):
        y, c, change = load_state(state, l), load_constants(constants, l), sums[row, l]
        sums[row, l] = largest_change(integrals0, inverse_scales, l, y, c, change)
