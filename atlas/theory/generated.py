"""The parts of the theory that depend on a system, which `compiled` writes from the equations of the system.

The functions have empty bodies here and serve readers, linters and type checkers. Vectors are tuples of three numbers in body
axes. The angular velocity is `w`, and `vectors` are the vectors at rest in the frame.
"""

from __future__ import annotations

DEGREE = 0  # degree of the right-hand side in the states
# Pairs (p, q) of integers from 1 to 2 * DEGREE without a common factor. The two rates of a periodic motion have a ratio p : q.
PERIODS = ((1, 1),)


def load_state(block, i):
    """Return w and the vectors of column `i` of a block of states."""


def load_constants(block, i):
    """Return column `i` of a block of constants."""


def derivatives(w, vectors, constants):
    """Return w' and the derivatives of the vectors."""


def derivatives_change(w, vectors, constants, dw, changes):
    """Return the change of w' to first order in the changes `dw` of w and `changes` of the vectors."""


def magnitudes(w, vectors, constants, size):
    """Return for each component of w' the sum of the terms' magnitudes and changes, if w changes by `size` and the vectors by 1."""


def frame_motion(w, vectors, constants):
    """Return the angular velocity relative to the frame, and the frame's vertical."""


def frame_motion_change(w, vectors, constants, dw, changes):
    """Return the change of the angular velocity relative to the frame, to first order in `dw` and `changes`."""


def rotate_all(vectors, nu, back, s, around):
    """Return the vectors turned about `nu` by the angle with (cosine, sine) `back`, then about `s` by `around`."""


def turn_all(vectors, u):
    """Return v x u for every vector v."""
