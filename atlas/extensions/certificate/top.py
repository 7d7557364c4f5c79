"""The symmetric top about a fixed point, whose two momenta leave one degree of freedom.

The momenta are S = C r + l3 about the axis, with the rotor's momentum l3, and K about the vertical. Let x = cos(theta). Then
(A x')^2 = f(x) for a polynomial f of degree 4, and x stays in the interval around the start x0 in which f >= 0. The rates psi' and
phi' and the rate about the vertical are functions of x alone. In powers of x - x0 the terms of f do not cancel near the start.
"""

from __future__ import annotations

import numpy as np

from ...systems.steady import TERM_ROUNDING
from ...theory.point import larger, smaller
from .bounds import Bounds, is_away, is_inside, reach


def top(body, w, gamma, tolerances):
    """Return bounds of the motion of a body with A = B and no damping, if rotor and field are along the body's third axis."""
    A, _, C = body.inertia
    p, q, r = w
    g1, g2, x0 = gamma
    sine2 = g1**2 + g2**2
    # The potential is V(x0) + v1 y + v2 y^2 with y = x - x0, and a is A psi' sin(theta)^2 at the start.
    v2 = 0.5 * body.gamma.gradient * (C - A)
    v1 = body.gamma.field[2] + 2 * v2 * x0
    S, a, e = C * r + body.rotor[2], A * (p * g1 + q * g2), A**2 * (p**2 + q**2)
    # `S_size` and `v_size` scale the rounding errors of S and v1. `spin` bounds psi' cos(theta), a term of r = phi' + psi' cos(theta).
    across = np.sqrt(e * sine2)
    spin = across / (A * sine2) if sine2 > 0 else 0.0
    S_size = abs(C * r) + C * spin + abs(body.rotor[2])
    v_size = abs(body.gamma.field[2]) + 2 * abs(v2)
    drift, error = abs(A * (p * g2 - q * g1)), TERM_ROUNDING * across
    _, f1, f2, f3, f4 = f = (
        drift**2,
        -2 * x0 * e + -2 * A * v1 * sine2 + 2 * a * S,
        -e + 4 * A * v1 * x0 + -2 * A * v2 * sine2 + -(S**2),
        2 * A * v1 + 4 * A * v2 * x0,
        2 * A * v2,
    )
    V2, X = abs(v2), abs(x0)
    errors = (
        error * (2 * drift + error),
        TERM_ROUNDING * (2 * X * e + 2 * A * v_size * sine2 + 2 * across * S_size),
        TERM_ROUNDING * (e + 4 * A * v_size * X + 2 * A * V2 * sine2 + S_size**2),
        TERM_ROUNDING * (2 * A * v_size + 4 * A * V2 * X),
        TERM_ROUNDING * (2 * A * V2),
    )
    low, high = -top_end(f, errors, sine2, x0, -1.0), top_end(f, errors, sine2, x0, 1.0)
    half, farthest = 0.5 * (high - low), larger(abs(low), abs(high))
    at_low, at_high = larger(sine2 - 2 * x0 * low - low**2, 0.0), larger(sine2 - 2 * x0 * high - high**2, 0.0)
    least = smaller(at_low, at_high)
    least_sine = np.sqrt(least)
    largest_sine = 1.0 if (low + x0) * (high + x0) <= 0 else np.sqrt(larger(at_low, at_high))
    normal_rate = half * abs(r - S / A)
    bounds = Bounds(least_sine, largest_sine, np.nan, np.nan, np.nan, np.nan, np.nan, normal_rate)
    if is_inside(bounds, tolerances) or not is_away(bounds, tolerances):
        return bounds
    # f <= 0 at low and high. So f(y) <= -D (y - low) (high - y), where D is the second divided difference of f at y, low and high.
    bent = -f2 + 3 * abs(f3) * farthest + 6 * abs(f4) * farthest**2 + errors[2]
    theta_dot = half * np.sqrt(larger(bent, 0.0) / least) / A
    # Extrema of psi' = (K - S x) / (A sin(theta)^2) and of x psi' are at the ends, or where the derivatives vanish.
    K, n = a + S * x0, a / (A * sine2)
    constants = a, S, A, sine2, x0, low, high
    psi_least, psi_largest = phi_least, phi_largest = np.inf, -np.inf
    for which in range(4):
        _, change = change_of_psi(which, S, K, constants)
        psi_least, psi_largest = smaller(psi_least, change), larger(psi_largest, change)
        y, change = change_of_psi(which, K, S, constants)
        phi = -y * n - (x0 + y) * change
        phi_least, phi_largest = smaller(phi_least, phi), larger(phi_largest, phi)
    return Bounds(
        least_sine, largest_sine, theta_dot,
        n + 0.5 * (psi_largest + psi_least), 0.5 * (psi_largest - psi_least),
        r - x0 * n + 0.5 * (phi_largest + phi_least), 0.5 * (phi_largest - phi_least), normal_rate,
    )  # fmt: skip


def top_end(f, errors, sine2, x0, sign):
    """Return a bound of the change of cos(theta) in the direction `sign`."""
    limit = sine2 / (1 + abs(x0)) if sign * x0 > 0 else 1 + abs(x0)
    sided = (
        f[0] + errors[0], sign * f[1] + errors[1], f[2] + errors[2], sign * f[3] + errors[3], f[4] + errors[4],
    )  # fmt: skip
    distance = reach(sided, limit, 0.0)
    return limit if distance != distance else distance


def change_of_psi(which, over, other, constants):
    """Return y = x - x0 and psi'(x) - psi'(x0). Here x = cos(theta) is an end of its range, or a zero of d(psi')/dx or of d(x psi')/dx."""
    a, S, A, sine2, x0, low, high = constants
    y = low if which == 0 else high
    if which > 1:
        root = np.sqrt(other**2 - over**2)
        y = (other + (root if which == 3 else -root)) / over - x0
        y = smaller(larger(0.0 if y != y else y, low), high)
    return y, y * (a * (2 * x0 + y) - S * sine2) / (A * sine2 * (sine2 - 2 * x0 * y - y**2))
