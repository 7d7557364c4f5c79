"""The parts of the theory that depend on a system: `compiled` writes them from its equations.

The signatures, whose bodies are empty here, serve readers, linters and type checkers. Vectors are tuples of three numbers in
body axes, w is the angular velocity, vectors are the vectors at rest in the frame.
"""

from __future__ import annotations

DEGREE = 0  # of the right-hand side in the states
# Ratios p : q in lowest terms of the rates of periodic motions, 1 <= p, q <= 2 DEGREE
PERIODS = ((1, 1),)


def load_state(block, i):
    """w and vectors of column i of a block of states."""


def load_constants(block, i):
    """Column i of a block of constants."""


def derivatives(w, vectors, constants):
    """w' and the derivatives of the vectors."""


def derivatives_change(w, vectors, constants, dw, changes):
    """Change of w' to first order in changes of w and of the vectors."""


def magnitudes(w, vectors, constants, size):
    """Magnitudes of the terms of w', plus their changes when w changes by `size` and the vectors by 1."""


def frame_motion(w, vectors, constants):
    """Angular velocity relative to the frame, and the frame's vertical."""


def frame_motion_change(w, vectors, constants, dw, changes):
    """Change of the angular velocity relative to the frame to first order in changes of w and of the vectors."""


def rotate_all(vectors, nu, back, s, around):
    """Vectors turned about nu by the angle with (cosine, sine) `back`, then about s by `around`."""


def turn_all(vectors, u):
    """v x u for every vector v."""
