"""The parts of a kernel that depend on system and method: `assemble` writes them for each pair.

The signatures, whose bodies are empty here, serve readers, linters and type checkers. `state` and `constants` are in the
kernel's units (see `scaled` of a system's equations), blocks are (rows, WIDTH), l is a lane.
"""

from __future__ import annotations

WIDTH = 32  # points of a block
STATES = 0  # states of the equations, and accumulated losses
CONSTANTS = 0
INTEGRALS = 0
LOSSES = ()  # integrals whose losses are the last states, see `augmented`; left out if there are none
OBSERVABLES = 0  # observables measured at every node
STROBED = 0  # observables measured once a period; without them the blocks `if STROBED:` are left out
TANGENT = 0  # components of a tangent vector
STEP = 1.0  # length of a step in the kernel's unit of time, `Method.kernel_step`
STORES_SLOPE = False  # whether the slope at a node is kept for the first stage of the step after it
HAS_AXIS = False  # whether the system has `axis_in_frame`
# Sums and constants of the plugged instruments, see `ensemble.Plug`; without them the blocks `if PLUGGED:` are left out.
PLUGGED, PLUGGED_GIVEN = 0, 0


def aligned_empty(shape):
    """Uninitialised array of float64, aligned to cache lines."""


def full_vectors():
    """Let the calling kernel use the longest vectors."""


def axpy(y, weights, slopes):
    """The tuple y plus the weighted sum of other tuples."""


def rhs(state, constants):
    """Time derivatives of the state."""


def rhs_change(state, constants, change):
    """Change of the time derivatives to first order in a change of the state."""


def scaled(state, constants, unit):
    """State and constants in units in which the time `unit` is 1."""


def unscaled(state, constants, unit):
    """State in the caller's units; constants: as `scaled` returned them."""


def frame_motion(state, constants):
    """Angular velocity relative to the frame and the frame's vertical: u1, u2, u3, g1, g2, g3."""


def frame_motion_change(state, constants, change):
    """Change of `frame_motion` to first order in a change of the state."""


def axis_in_frame(state, constants):
    """Two components of the third body axis in the frame."""


def step(state, slope, constants):
    """State after one step of length STEP; slope: derivative of the state before the step."""


def load_state(block, l):
    """Column l of a block of states, as a tuple."""


def store_state(block, l, state):
    """Write a state into column l of a block."""


def load_constants(block, l):
    """Column l of a block of constants, as a tuple."""


def store_constants(block, l, constants):
    """Write constants into column l of a block."""


def store_scales(block, l, scales, p, inverse_unit):
    """Write the scales of the first integrals of point p, in the kernel's units, into column l of a block."""


def store_integrals(block, l, state, constants):
    """Write the first integrals of a state into column l of a block."""


def largest_change(first, scales, l, state, constants, largest):
    """Largest of `largest` and the scaled changes of the first integrals since the values in column l of `first`."""


def add_to_plugged(plugged, given, nodes, i, intervals, spacing, inverse_unit, state, constants):
    """Add node i to the sums of every plugged instrument."""


def load_extended(block, l):
    """Column l of a block of states and tangent vectors, as one tuple."""


def store_extended(block, l, extended):
    """Write a state and a tangent vector into column l of a block."""


def extended_rhs(extended, constants):
    """Time derivatives of a state and a tangent vector."""


def observe(state, constants):
    """Every observable, as a tuple."""


def observe_change(state, constants, change):
    """First-order change of every observable for a change of the state, as a tuple."""


def store_values(nodes, slot, row, l, values):
    """Write the values of every observable, or their derivatives, into rows `row` and following of a node."""


def store_strobes(block, l, state, constants):
    """Write the values of the observables that are measured once a period into column l of a block."""
