"""Equations of the double pendulum; the angles are counted from the downward vertical.

Written by atlas.systems.from_lagrangian from the Lagrangian

    L = g*l1*m1*cos(angle1) - g*m2*(-l1*cos(angle1) - l2*cos(angle2)) + l1**2*m1*rate1**2/2 +
        m2*(l1**2*rate1**2 + 2*l1*l2*rate1*rate2*cos(angle1 - angle2) + l2**2*rate2**2)/2
"""

from numpy import cos, sin

STATE = ("angle1", "angle2", "rate1", "rate2")
CONSTANTS = ("m1", "m2", "l1", "l2", "g")
INTEGRALS = ("energy",)


def rhs(state, constants):
    """Time derivatives of the state."""
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    angle1_minus_angle2 = angle1 - angle2
    cos_angle1_minus_angle2 = cos(angle1_minus_angle2)
    m1_plus_m2 = m1 + m2
    part4 = 1 / (-cos_angle1_minus_angle2**2 * m2 + m1_plus_m2)
    sin_angle1_minus_angle2 = sin(angle1_minus_angle2)
    part6 = part4 * (-g * sin(angle2) + l1 * rate1**2 * sin_angle1_minus_angle2)
    part7 = cos_angle1_minus_angle2 / l1
    part8 = -g * l1 * m1_plus_m2 * sin(angle1) - l1 * l2 * m2 * rate2**2 * sin_angle1_minus_angle2
    part9 = 1 / l2
    return (
        rate1,
        rate2,
        -m2 * part6 * part7 + part4 * part8 / l1**2,
        m1_plus_m2 * part6 * part9 - part4 * part7 * part8 * part9,
    )


def energy(state, constants):
    """Energy, sum of v dL/dv - L; the tuple of its terms."""
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    part1 = l1**2 * rate1**2
    part2 = l1 * cos(angle1)
    return (
        1 / 2 * m2 * (2 * l1 * l2 * rate1 * rate2 * cos(angle1 - angle2) + l2**2 * rate2**2 + part1),
        1 / 2 * m1 * part1,
        g * m2 * (-l2 * cos(angle2) - part2),
        -g * m1 * part2,
    )


def height(state, constants):
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    return -l1 * cos(angle1) - l2 * cos(angle2)
