"""Declarations of the parts of a kernel that depend on system and method. `assemble` writes the code for each pair.

The bodies are empty here, because the declarations serve readers, linters and type checkers. `state` and `constants` are in the
kernel's units (see `scaled` of a system's equations). Blocks have the shape (rows, WIDTH), and l is a lane.
"""

from __future__ import annotations

WIDTH = 32  # number of points in a block
STATES = 0  # number of states of the equations, including accumulated losses
CONSTANTS = 0
INTEGRALS = 0
LOSSES = ()  # integrals whose losses are the last states, see `augmented`; not defined if there are none
OBSERVABLES = 0  # number of observables measured at every node
STROBED = 0  # number of observables measured once a period; if it is 0, blocks `if STROBED:` are left out
TANGENT = 0  # number of components of a tangent vector
STEP = 1.0  # length of a step in the kernel's unit of time, `Method.kernel_step`
STORES_SLOPE = False  # whether the slope at a node is kept for the first stage of the next step
HAS_AXIS = False  # whether the system has `axis_in_frame`
# Numbers of sums and constants of the plugged instruments (see `ensemble.Plug`). If 0, blocks `if PLUGGED:` are left out.
PLUGGED, PLUGGED_GIVEN = 0, 0


def aligned_empty(shape):
    """Return an uninitialised array of float64 that is aligned to cache lines."""


def full_vectors():
    """Let the calling kernel use the longest vectors."""


def axpy(y, weights, slopes):
    """Return the tuple y plus the weighted sum of the tuples in `slopes`."""


def rhs(state, constants):
    """Return the time derivatives of the state."""


def rhs_change(state, constants, change):
    """Return the first-order change of the time derivatives for a change of the state."""


def scaled(state, constants, unit):
    """Return state and constants in units in which the time `unit` is 1."""


def unscaled(state, constants, unit):
    """Return the state in the caller's units. `constants` are as `scaled` returned."""


def frame_motion(state, constants):
    """Return the angular velocity u1, u2, u3 relative to the frame, and the vertical g1, g2, g3 of the frame."""


def frame_motion_change(state, constants, change):
    """Return the first-order change of `frame_motion` for a change of the state."""


def axis_in_frame(state, constants):
    """Return two components of the third body axis in the frame."""


def step(state, slope, constants):
    """Return the state after one step of length STEP. `slope` is the derivative of the state before the step."""


def load_state(block, l):
    """Return column l of a block of states as a tuple."""


def store_state(block, l, state):
    """Write a state into column l of a block."""


def load_constants(block, l):
    """Return column l of a block of constants as a tuple."""


def store_constants(block, l, constants):
    """Write constants into column l of a block."""


def store_scales(block, l, scales, p, inverse_unit):
    """Write the scales of the first integrals of point p, in the kernel's units, into column l of a block."""


def store_integrals(block, l, state, constants):
    """Write the first integrals of a state into column l of a block."""


def largest_change(first, scales, l, state, constants, largest):
    """Return the largest scaled change of a first integral from the value in column l of `first`, but at least `largest`."""


def add_to_plugged(plugged, given, nodes, i, intervals, spacing, inverse_unit, state, constants):
    """Add node i to the sums of every plugged instrument."""


def load_extended(block, l):
    """Return column l of a block of states and tangent vectors as one tuple."""


def store_extended(block, l, extended):
    """Write a state and a tangent vector into column l of a block."""


def extended_rhs(extended, constants):
    """Return the time derivatives of a state and a tangent vector."""


def observe(state, constants):
    """Return all observables as a tuple."""


def observe_change(state, constants, change):
    """Return the first-order changes of all observables for a change of the state, as a tuple."""


def store_values(nodes, slot, row, l, values):
    """Write values or derivatives of all observables into a node, beginning at row `row`."""


def store_strobes(block, l, state, constants):
    """Write the values of the observables that are measured once a period into column l of a block."""
