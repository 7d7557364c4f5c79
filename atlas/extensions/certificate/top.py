"""The symmetric top about a fixed point, whose two momenta leave one degree of freedom.

With S = C r + l3, K the momentum about the vertical and x = cos(theta), (A x')^2 = f(x) for a polynomial f of degree 4. So x
stays where f >= 0 about its start x0, and psi', phi' and the rate about the vertical are functions of x alone. f in powers of
x - x0 has no cancellation near the start.
"""

from __future__ import annotations

import numpy as np

from ...systems.base import Array
from ...systems.gyrostat.body import Body
from .bounds import ROUNDING, Bounds, reach


def top(body: Body, w: Array, gamma: Array) -> Bounds:
    """Bounds of a body with A = B, and rotor and field along its third axis, without damping."""
    (A, _, C), (p, q, r), (g1, g2, x0) = body.inertia.T, w.T, gamma.T
    sine2 = g1**2 + g2**2
    # The potential is V(x0) + v1 y + v2 y^2, y = x - x0; a = A psi' sin^2 at the start.
    v2 = 0.5 * body.gamma.gradient * (C - A)
    v1 = body.gamma.field[:, 2] + 2 * v2 * x0
    S, a, e = C * r + body.rotor[:, 2], A * (p * g1 + q * g2), A**2 * (p**2 + q**2)

    def rows(S: Array, a: Array, x: Array, v: Array) -> list[list[Array]]:
        """Terms of the coefficients of f but for the first."""
        return [
            [-2 * x * e, -2 * A * v * sine2, 2 * a * S],
            [-e, 4 * A * v * x, -2 * A * v2 * sine2, -(S**2)],
            [2 * A * v, 4 * A * v2 * x],
            [2 * A * v2],
        ]

    # Errors are relative to what S and v1 are sums of: the spin is m + n cos(theta).
    across = np.sqrt(e * sine2)
    n = np.where(sine2 > 0, across / (A * np.where(sine2 > 0, sine2, 1.0)), 0.0)
    S_size, v_size = (
        np.abs(C * r) + C * n + np.abs(body.rotor[:, 2]),
        np.abs(body.gamma.field[:, 2]) + 2 * np.abs(v2),
    )
    drift, error = np.abs(A * (p * g2 - q * g1)), ROUNDING * across
    f = [drift**2, *(sum(row) for row in rows(S, a, x0, v1))]
    errors = [error * (2 * drift + error)]
    errors += [ROUNDING * np.abs(row).sum(0) for row in rows(S_size, across, np.abs(x0), v_size)]
    ends = []
    for sign in (-1.0, 1.0):
        limit = np.where(sign * x0 > 0, sine2 / (1 + np.abs(x0)), 1 + np.abs(x0))
        distance = reach([sign**k * f[k] + errors[k] for k in range(5)], limit)
        ends.append(sign * np.where(np.isnan(distance), limit, distance))
    low, high = y = np.array(ends)
    half, farthest = 0.5 * (high - low), np.abs(y).max(0)
    squares = np.maximum(sine2 - 2 * x0 * y - y**2, 0.0)
    least = squares.min(0)
    sine = np.sqrt(least), np.where((low + x0) * (high + x0) <= 0, 1.0, np.sqrt(squares.max(0)))
    # f(y) is at most (y - low) (high - y) times the second divided difference with the ends, negative.
    bent = -f[2] + 3 * np.abs(f[3]) * farthest + 6 * np.abs(f[4]) * farthest**2 + errors[2]
    theta_dot = half * np.sqrt(np.maximum(bent, 0.0) / least) / A
    # psi' = (K - S x) / (A sin^2) and x psi' are extreme at the ends or where their derivatives vanish.
    K, n, ratio = a + S * x0, a / (A * sine2), []
    for over, root in ((S, np.sqrt(K**2 - S**2)), (K, np.sqrt(S**2 - K**2))):
        other = K + S - over
        inner = [np.nan_to_num((other + s * root) / over - x0) for s in (-1, 1)]
        at = np.clip([low, high, *inner], low, high)
        ratio.append((at, at * (a * (2 * x0 + at) - S * sine2) / (A * sine2 * (sine2 - 2 * x0 * at - at**2))))
    (_, psi), (at, change) = ratio
    phi = -at * n - (x0 + at) * change
    (n, n_half), (m, m_half) = (
        (start + 0.5 * (each.max(0) + each.min(0)), 0.5 * np.ptp(each, axis=0))
        for start, each in ((n, psi), (r - x0 * n, phi))
    )
    return Bounds(sine, theta_dot, (n, n_half), (m, m_half), half * np.abs(r - S / A))
