"""Euler-Poisson equations of a symmetric heavy top: equations of a system that is not part of the package.

w is the angular velocity and g the upward vertical, both in body axes; the third axis is that of symmetry.
"""

STATE = ("w1", "w2", "w3", "g1", "g2", "g3")
CONSTANTS = ("transverse", "axial", "weight")
ONES = ()
INTEGRALS = {"energy": 2, "length_vertical": 0}


def rhs(state, constants):
    w1, w2, w3, g1, g2, g3 = state
    transverse, axial, weight = constants
    return (
        ((transverse - axial) * w2 * w3 + weight * g2) / transverse,
        ((axial - transverse) * w3 * w1 - weight * g1) / transverse,
        0.0 * w3,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def scaled(state, constants, h):
    w1, w2, w3, g1, g2, g3 = state
    transverse, axial, weight = constants
    return (w1 * h, w2 * h, w3 * h, g1, g2, g3), (transverse, axial, weight * h * h)


def unscaled(state, constants, h):
    w1, w2, w3, g1, g2, g3 = state
    return w1 / h, w2 / h, w3 / h, g1, g2, g3


def frame_motion(state, constants):
    w1, w2, w3, g1, g2, g3 = state
    return w1, w2, w3, g1, g2, g3


def energy(state, constants):
    w1, w2, w3, g1, g2, g3 = state
    transverse, axial, weight = constants
    return 0.5 * transverse * (w1 * w1 + w2 * w2), 0.5 * axial * w3 * w3, weight * g3


def length_vertical(state, constants):
    w1, w2, w3, g1, g2, g3 = state
    return g1 * g1, g2 * g2, g3 * g3
