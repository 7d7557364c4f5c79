"""Linear stability of steady motions of the satellite in closed form."""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Flags, Points
from ..gyrostat.equation import quotient, relative_to
from ..gyrostat.floquet import quartic_growth
from ..gyrostat.oscillations import GROWTH_TOLERANCE
from ..vectors import cross, length
from .conditions import axial_rate, body_vectors, momentum_scale, node, tilt, torque_scale
from .initial import directions

# Ratio of squared exponents below which they are zero or coincide but for rounding.
_ROUNDING = 1e-12


def _quartic(P: Array, Q: Array, scale: Array) -> tuple[Flags, Array]:
    """Stability and growth of lambda^4 + P lambda^2 + Q = 0; unknown where P or Q is nan, and at a multiple root.

    Growth up to GROWTH_TOLERANCE * scale is round-off.
    """
    growth = quartic_growth(P, Q)
    margin = _ROUNDING * P * P
    stable = np.where((P > 0) & (margin < Q) & (margin < P * P - 4 * Q), Stability.STABLE, Stability.UNKNOWN)
    unstable = growth > GROWTH_TOLERANCE * scale
    growth = np.where(unstable | np.isnan(growth), growth, 0.0)
    return np.where(unstable, Stability.UNSTABLE, stable).astype(np.int8), growth


def stability_tilted(p: Points) -> tuple[Flags, Array]:
    """Symmetric body, k and mu along the axis, n = 0: lambda^4 + P lambda^2 + Q = 0.

    With the axial momentum p = (C w3 + k3) / a conserved, the axis moves like a charge on the sphere:
    U = -Omega^2 s^2/2 - Omega p c + (3/2) D Omega^2 s^2 sin^2 psi + mu3 (h1 s sin psi + h3 c) / a,
    D = C/a - 1, P = U_tt + U_pp / s^2 + (2 Omega c - p)^2 and Q = (U_tt U_pp - U_tp^2) / s^2.
    """
    s, c = tilt(p)
    sp, cp = node(p)
    a, square = 0.5 * (p["A"] + p["B"]), p["Omega"] ** 2
    momentum = (p["C"] * axial_rate(p) + p["k3"]) / a
    D = p["C"] / a - 1
    radial, normal = p["mu3"] * p["h1"] / a, p["mu3"] * p["h3"] / a
    tt = (
        (c**2 - s**2) * square * (3 * D * sp**2 - 1)
        + p["Omega"] * momentum * c
        - radial * s * sp
        - normal * c
    )
    tp = quotient(6 * D * square * s * c * sp * cp + radial * c * cp, s)
    pp = 3 * D * square * (cp**2 - sp**2) - quotient(radial * sp, s)
    P = tt + pp + (2 * p["Omega"] * c - momentum) ** 2
    return _quartic(P, tt * pp - tp**2, np.abs(p["Omega"]) + np.abs(momentum))


def stability_about_normal(p: Points) -> tuple[Flags, Array]:
    """Rotation about the orbit's normal and an axis of symmetry along it, with k and mu along it too.

    With J the moment about that axis, T across it, nu the rate in the orbital frame:
    p = (J (Omega + nu) + k.gamma) / T, U_2 = Omega p - Omega^2 - h3 mu.gamma / T,
    U_1 = U_2 + 3 Omega^2 (J/T - 1), lambda^4 + (U_1 + U_2 + (2 Omega - p)^2) lambda^2 + U_1 U_2 = 0.
    Unknown where k or h3 mu has a part across the axis: the linear system is then periodic in time.
    """
    inertia, k, mu = body_vectors(p)
    _, gamma = directions(p)
    nu = p["n"] + p["m"] * gamma[2]
    along = (inertia * gamma**2).sum(0)
    across = 0.5 * (inertia.sum(0) - along)
    momentum = (along * (p["Omega"] + nu) + (k * gamma).sum(0)) / across
    second = p["Omega"] * momentum - p["Omega"] ** 2 - p["h3"] * (mu * gamma).sum(0) / across
    first = second + 3 * p["Omega"] ** 2 * (along / across - 1)
    oblique = relative_to(length(cross(k, gamma)), momentum_scale(p))
    oblique = oblique + relative_to(p["h3"] * length(cross(mu, gamma)), torque_scale(p))
    P = np.where(np.abs(oblique) < 1e-12, first + second + (2 * p["Omega"] - momentum) ** 2, np.nan)
    return _quartic(P, first * second, np.abs(p["Omega"]) + np.abs(momentum))


def stability_spherical(p: Points) -> tuple[Flags, Array]:
    """Seen from axes that turn with n + Omega, lambda^2 = 0 twice and -((N s)^2 + (2 N c - p)^2): stable."""
    return np.full(np.shape(p["A"]), Stability.STABLE, np.int8), np.zeros(np.shape(p["A"]))
