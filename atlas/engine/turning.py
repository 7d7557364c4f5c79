"""Turning points between two nodes: of a cubic, and of theta on polynomials of degree 7 through four nodes.

The unit of time is the distance of two nodes.
"""

from enum import IntEnum

import numpy as np

from .poles import differences_of, polynomial

# Steps of Newton's method for the instant.
TURN_STEPS = 5


class Turn(IntEnum):
    """Rows that describe a turning point: the vertical and its derivatives at four nodes, four rows each."""

    G1 = 0
    G1_SLOPE = 4
    G2 = 8
    G2_SLOPE = 12
    G3 = 16
    G3_SLOPE = 20
    TIME = 24  # first approximation, counted from the first of the four nodes
    NODE = 25  # the node before it, counted likewise


TURN_ROWS = max(Turn) + 1


def turns_twice(f0, f1, s0, s1, rounding):
    """Whether the cubic with these values, of one sign, and slopes at 0 and 1 turns twice between, 1 or 0.

    So does a motion that starts at rest if it turns back once; less than `rounding` is no turn.
    """
    both = s0 + s1
    excess = both - 3.0 * (f1 - f0)
    may = 1.0 if excess * both > 0.0 else 0.0
    return may if excess * excess > s0 * s1 + rounding * rounding else 0.0


def place_of_turn(f0, f1, s0, s1):
    """Place from 0 to 1 at which that cubic turns; where it does so twice, the one farther from both nodes."""
    a = 3.0 * (s0 + s1 - 2.0 * (f1 - f0))  # the slope of the cubic is a x^2 + b x + s0
    b = 2.0 * (3.0 * (f1 - f0) - 2.0 * s0 - s1)
    root = np.sqrt(max(b * b - 4.0 * a * s0, 0.0))
    q = -0.5 * (b + (root if b > 0.0 else -root))
    x = s0 / q if q != 0.0 else 0.5
    y = q / a if a != 0.0 else x
    x = y if min(y, 1.0 - y) > min(x, 1.0 - x) else x
    return min(max(x, 0.0), 1.0)


def newton_change(g1, g2, g3):
    """Change of the instant at which theta' sin theta is 0; arguments: value and derivatives as `polynomial` returns."""
    u, du, ddu = g1
    v, dv, ddv = g2
    w, dw, ddw = g3
    radial, sin2_theta = u * du + v * dv, u * u + v * v
    slope = w * (du * du + dv * dv + 2.0 * (u * ddu + v * ddv)) - dw * radial - 2.0 * sin2_theta * ddw
    change = (sin2_theta * dw - w * radial) / slope
    return min(max(change, -0.5), 0.5)


def motion_of_turn(turns, e):
    """Value, first derivative and half the second of each component at TIME; `turns` holds divided differences."""
    x = turns[Turn.TIME, e]
    return (
        polynomial(differences_of(turns, Turn.G1, e), x),
        polynomial(differences_of(turns, Turn.G2, e), x),
        polynomial(differences_of(turns, Turn.G3, e), x),
    )


def turning_point(turns, e):
    """cos theta and sin^2 theta at TIME, in column e of `turns`; then TIME is improved.

    TIME stays between the nodes where the derivative of theta changes its sign: where theta is constant but
    for rounding errors, Newton's method would leave the four nodes.
    """
    u, v, w = motion_of_turn(turns, e)
    before = turns[Turn.NODE, e] - turns[Turn.TIME, e]
    turns[Turn.TIME, e] += min(max(newton_change(u, v, w), before), before + 1.0)
    return w[0], u[0] * u[0] + v[0] * v[0]
