"""Turning points of theta, on the polynomials of seventh degree through four nodes of the vertical.

The unit of time is the distance of two nodes. The functions are plain arithmetic on scalars and one column of an array:
the kernel calls them for several turning points side by side, compiled or not.
"""

from enum import IntEnum

from .poles import differences_of, polynomial

# Steps of Newton's method for the instant.
TURN_STEPS = 5


class Turn(IntEnum):
    """Rows that describe a turning point: the vertical at four nodes and its derivatives, four rows each.

    `poles.difference` turns them into the divided differences of the components.
    """

    G1 = 0
    G1_SLOPE = 4
    G2 = 8
    G2_SLOPE = 12
    G3 = 16
    G3_SLOPE = 20
    TIME = 24  # first approximation, counted from the first of the four nodes


TURN_ROWS = max(Turn) + 1


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
    """Improve TIME, and return cos theta and sin^2 theta at the turning point in column e of `turns`."""
    u, v, w = motion_of_turn(turns, e)
    x = newton_change(u, v, w)
    turns[Turn.TIME, e] += x
    g1, g2, g3 = u[0] + x * (u[1] + x * u[2]), v[0] + x * (v[1] + x * v[2]), w[0] + x * (w[1] + x * w[2])
    return g3, g1 * g1 + g2 * g2
