"""Euler-Poisson equations: a, g are unit vectors across and along the vertical, g downwards; I w' = (I w + l) x w + Mg r x g + mu x a."""

STATE = ("w1", "w2", "w3", "a1", "a2", "a3", "g1", "g2", "g3")
FRAME_VECTORS = (("a1", "a2", "a3"), ("g1", "g2", "g3"))
CONSTANTS = ("A", "B", "C", "l1", "l2", "l3", "Mx", "My", "Mz", "mu1", "mu2", "mu3")
INTEGRALS = {"energy": 2}


def rhs(state, constants):
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, l1, l2, l3, Mx, My, Mz, mu1, mu2, mu3 = constants
    L1, L2, L3 = A * w1 + l1, B * w2 + l2, C * w3 + l3
    return (
        (L2 * w3 - L3 * w2 + My * g3 - Mz * g2 + mu2 * a3 - mu3 * a2) / A,
        (L3 * w1 - L1 * w3 + Mz * g1 - Mx * g3 + mu3 * a1 - mu1 * a3) / B,
        (L1 * w2 - L2 * w1 + Mx * g2 - My * g1 + mu1 * a2 - mu2 * a1) / C,
        a2 * w3 - a3 * w2,
        a3 * w1 - a1 * w3,
        a1 * w2 - a2 * w1,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def frame_motion(state, constants):
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    return w1, w2, w3, g1, g2, g3


def energy(state, constants):
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, l1, l2, l3, Mx, My, Mz, mu1, mu2, mu3 = constants
    kinetic = 0.5 * (A * w1 * w1 + B * w2 * w2 + C * w3 * w3)
    return kinetic, -(Mx * g1 + My * g2 + Mz * g3), -(mu1 * a1 + mu2 * a2 + mu3 * a3)
