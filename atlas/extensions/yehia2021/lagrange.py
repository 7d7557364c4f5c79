"""Lagrange's equations (5)-(7) of the satellite in Euler angles, with corrections.

`tests/systems/test_satellite_lagrange.py` derives the equations from the Lagrangian (2), (3) of Yehia & El-kenani 2021
(doi 10.22055/JACM.2021.37913.3113). The file equations.toml contains the equations as printed. The accelerations are
equal to those of the Euler-Poisson equations except at sin theta = 0. There the matrix of the second derivatives, whose
determinant is A B C sin^2 theta, is singular, and the result is not finite.
"""

from numpy import cos, sin

from ...systems.satellite.equations import CONSTANTS as CONSTANTS

STATE = ("psi", "theta", "phi", "psi_dot", "theta_dot", "phi_dot")


def rhs(state, constants):
    """Return the time derivatives of the state. The angles are in rad, relative to the orbital frame."""
    psi, theta, phi, psi_dot, theta_dot, phi_dot = state
    A, B, C = constants[:3]
    s, c, sf, cf = sin(theta), cos(theta), sin(phi), cos(phi)
    first, second, third = equations(state, (0.0, 0.0, 0.0), constants)
    # The first equation minus c times the third contains no phi'', and the other second derivatives have a factor s.
    node = (c * third - first) / s
    mixed = (A - B) * sf * cf
    psi_accel = ((A * cf * cf + B * sf * sf) * node + mixed * second) / (A * B * s)
    theta_accel = -((A * sf * sf + B * cf * cf) * second + mixed * node) / (A * B)
    return psi_dot, theta_dot, phi_dot, psi_accel, theta_accel, -third / C - c * psi_accel


def equations(state, accelerations, constants):
    """Return the corrected left sides of (5)-(7), which are torques about normal, node and axis and vanish on a motion."""
    psi, theta, phi, psi_dot, theta_dot, phi_dot = state
    psi_accel, theta_accel, phi_accel = accelerations
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3 = constants[:12]
    s, c, sf, cf, sp, cp = sin(theta), cos(theta), sin(phi), cos(phi), sin(psi), cos(psi)
    rate = psi_dot + Omega
    J = A * sf * sf + B * cf * cf
    sin2, cos2 = 2 * sf * cf, cf * cf - sf * sf
    k_node, k_across = k1 * cf - k2 * sf, k1 * sf + k2 * cf
    a1, a2, a3 = cp * cf - c * sf * sp, -cp * sf - c * cf * sp, s * sp
    b1, b2, b3 = sp * cf + c * sf * cp, -sp * sf + c * cf * cp, -s * cp
    g1, g2, g3 = s * sf, s * cf, c
    # V is the potential in (3). The derivative of alpha by psi is -beta. A change of theta turns alpha and gamma about the node.
    gravity = 3 * Omega * Omega
    V_psi = -gravity * (A * a1 * b1 + B * a2 * b2 + C * a3 * b3) - h1 * (mu1 * b1 + mu2 * b2 + mu3 * b3)
    V_theta = gravity * sp * (s * (A * sf * a1 + B * cf * a2) + C * c * a3)
    V_theta = (
        V_theta + h1 * sp * (mu1 * g1 + mu2 * g2 + mu3 * g3) + h3 * (c * (mu1 * sf + mu2 * cf) - s * mu3)
    )
    V_phi = gravity * (A - B) * a1 * a2 + h1 * (mu1 * a2 - mu2 * a1) + h3 * (mu1 * g2 - mu2 * g1)
    return (
        (J * s * s + C * c * c) * psi_accel + 0.5 * (A - B) * sin2 * s * theta_accel + C * c * phi_accel
        + 0.5 * (A - B) * sin2 * c * theta_dot * theta_dot
        + theta_dot * (((A - B) * cos2 - C) * s * phi_dot + 2 * (J - C) * s * c * rate - k3 * s + c * k_across)
        + phi_dot * ((A - B) * sin2 * s * s * rate + s * k_node) + V_psi,
        0.5 * (A - B) * sin2 * s * psi_accel + (A * cf * cf + B * sf * sf) * theta_accel
        - (J - C) * s * c * rate * rate
        + rate * (((A - B) * cos2 + C) * s * phi_dot + k3 * s - c * k_across)
        - (A - B) * sin2 * theta_dot * phi_dot - k_across * phi_dot + V_theta,
        C * c * psi_accel + C * phi_accel
        + 0.5 * (A - B) * sin2 * (theta_dot * theta_dot - s * s * rate * rate)
        - theta_dot * rate * s * ((A - B) * cos2 + C) + theta_dot * k_across - rate * s * k_node + V_phi,
    )  # fmt: skip
