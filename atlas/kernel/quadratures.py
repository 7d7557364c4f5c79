"""Kernel of reference solutions, which gives derivatives of the states and of integrals of the Euler rates."""

import numpy as np

from .generated import STATES, frame_motion, load_constants, load_state, rhs, store_state


def integrate(path, constants, duration, first, cylinder, slopes):
    """Write the derivatives of a path with respect to t / duration. Columns are points; rows are the states, then the sums."""
    for p in range(path.shape[1]):
        state, c = load_state(path, p), load_constants(constants, p)
        store_state(slopes, p, rhs(state, c))
        for row in range(STATES):
            slopes[row, p] *= duration[p]
        rate0, psi0, phi0, normal0 = first[0, p], first[1, p], first[2, p], first[3, p]
        theta_dot, psi_dot, phi_dot, normal, outside, _ = euler_rates(frame_motion(state, c), cylinder)
        psi, phi, normal = (psi_dot - psi0) * outside, (phi_dot - phi0) * outside, normal - normal0
        change = theta_dot - rate0
        sums = theta_dot**2, change, change**2, outside, psi, psi**2, phi, phi**2, normal, normal**2
        for row in range(len(sums)):
            slopes[STATES + row, p] = sums[row]


def euler_rates(motion, cylinder):
    """Return theta', psi', phi', normal rate, `outside` (1.0, or 0.0 in the cylinder, where psi' and phi' become 0) and theta."""
    u1, u2, u3, g1, g2, g3 = motion
    sine = np.hypot(g1, g2)
    outside, safe_sine = 1.0 * (sine >= cylinder), sine + 1.0 * (sine == 0.0)
    psi_dot = (u1 * g1 + u2 * g2) / safe_sine**2 * outside
    theta_dot, normal_rate = (u1 * g2 - u2 * g1) / safe_sine, u1 * g1 + u2 * g2 + u3 * g3
    phi_dot = (u3 - psi_dot * g3) * outside
    return theta_dot, psi_dot, phi_dot, normal_rate, outside, np.arctan2(sine, g3)
