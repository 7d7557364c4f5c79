"""Equations of the double pendulum; the angles are counted from the downward vertical.

Written by atlas.systems.from_lagrangian from the Lagrangian

    L = g*l1*m1*cos(angle1) - g*m2*(-l1*cos(angle1) - l2*cos(angle2)) + l1**2*m1*rate1**2/2
        + m2*(l1**2*rate1**2 + 2*l1*l2*rate1*rate2*cos(angle1 - angle2) + l2**2*rate2**2)/2
"""

from numpy import cos, sin

STATE = ("angle1", "angle2", "rate1", "rate2")
CONSTANTS = ("m1", "m2", "l1", "l2", "g")
INTEGRALS = ("energy",)


def rhs(state, constants):
    """Time derivatives of the state; f is the right-hand side of M v' = f, with the mass matrix M."""
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    sin_angle1 = sin(angle1)
    sin_angle1_minus_angle2 = sin(angle1 - angle2)
    sin_angle2 = sin(angle2)
    cos_angle1_minus_angle2 = cos(angle1 - angle2)
    common1 = 1.0 / (m1 - cos_angle1_minus_angle2 * cos_angle1_minus_angle2 * m2 + m2)
    common2 = cos_angle1_minus_angle2 / (l1 * l2)
    f_rate1 = -g * l1 * sin_angle1 * (m1 + m2) - l1 * l2 * m2 * rate2 * rate2 * sin_angle1_minus_angle2
    f_rate2 = l2 * m2 * (l1 * rate1 * rate1 * sin_angle1_minus_angle2 - g * sin_angle2)
    rate1_dot = common1 * f_rate1 / (l1 * l1) - common1 * common2 * f_rate2
    rate2_dot = common1 * f_rate2 * (m1 + m2) / (l2 * l2 * m2) - common1 * common2 * f_rate1
    return rate1, rate2, rate1_dot, rate2_dot


def energy(state, constants):
    """Energy, sum of v dL/dv - L; the tuple of its terms."""
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    cos_angle1_minus_angle2 = cos(angle1 - angle2)
    cos_angle1 = cos(angle1)
    cos_angle2 = cos(angle2)
    common1 = l1 * l1 * rate1 * rate1
    return (
        0.5
        * m2
        * (common1 + 2 * cos_angle1_minus_angle2 * l1 * l2 * rate1 * rate2 + l2 * l2 * rate2 * rate2),
        0.5 * common1 * m1,
        g * m2 * (-cos_angle1 * l1 - cos_angle2 * l2),
        -cos_angle1 * g * l1 * m1,
    )


def height(state, constants):
    angle1, angle2, rate1, rate2 = state
    m1, m2, l1, l2, g = constants
    cos_angle1 = cos(angle1)
    cos_angle2 = cos(angle2)
    return -cos_angle1 * l1 - cos_angle2 * l2
