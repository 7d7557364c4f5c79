"""Floquet multipliers of motions that are periodic in the body, of many points at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..flags import Stability
from .base import Array, Flags

# |s| - 2, with s = multiplier + 1/multiplier, up to this is round-off and the error of the integration: at a collision
# of multipliers at +-1 a shift of s by 1e-7 is a growth by 3e-4 over a period.
TRACE_TOLERANCE = 1e-7
_STEPS_PER_NORM = 2  # steps for each unit of norm times period: errors of the trace below 1e-7
_MIN_STEPS = 32
_POINTS_AND_STEPS = 2**11  # matrices at a time, which fit into the cache


def growth_of_periodic_motion(
    matrix: Callable[[np.ndarray, Array], Array], period: Array
) -> tuple[Flags, Array]:
    """Stability of periodic motions of a reduced system of two degrees of freedom.

    The linear system of six equations has four multipliers 1: a shift in time, the energy and two integrals that are
    linear or quadratic in the state, such as the area integral and the length of the vertical. The last two are
    mu and 1/mu, so that the trace of the monodromy matrix is 4 + mu + 1/mu; this is exact where the eigenvalues
    are not, because those at 1 are defective.

    matrix: (indices of points, times of shape (steps, points)) -> matrices of the linear system, (steps,
    points, 6, 6). period: time units; nan where there is no motion. Returns stable, values of
    flags.Stability: STABLE where |mu| = 1. Unknown where there is no motion; growth_rate, log |mu| / period,
    rad per time unit; 0 where stable, nan where unknown. S. Blanes et al., Phys. Rep. 470 (2009) 151, for
    Magnus' series of order 6.
    """
    stable, growth = np.full(period.shape, Stability.UNKNOWN, np.int8), np.full(period.shape, np.nan)
    where = np.flatnonzero(np.isfinite(period))
    if not where.size:
        return stable, growth
    norms = np.sqrt((matrix(where, period[where] * np.arange(4)[:, None] / 4) ** 2).sum((-2, -1)))
    steps_needed = _STEPS_PER_NORM * norms.max(0) * period[where]
    count = 2 ** np.ceil(np.log2(np.maximum(steps_needed, _MIN_STEPS)))
    for steps in np.unique(count[np.isfinite(count)]).astype(int):
        members = where[count == steps]
        for first in range(0, members.size, max(1, _POINTS_AND_STEPS // steps)):
            part = members[first : first + max(1, _POINTS_AND_STEPS // steps)]
            s = np.trace(_monodromy(matrix, part, period[part], steps), axis1=-2, axis2=-1) - 4
            unstable = np.abs(s) > 2 + TRACE_TOLERANCE
            growth[part] = np.where(unstable, np.arccosh(np.maximum(np.abs(s) / 2, 1.0)) / period[part], 0.0)
            stable[part] = np.where(unstable, Stability.UNSTABLE, Stability.STABLE)
    unknown = ~np.isfinite(growth)
    return np.where(unknown, Stability.UNKNOWN, stable).astype(np.int8), np.where(unknown, np.nan, growth)


def _monodromy(
    matrix: Callable[[np.ndarray, Array], Array], part: np.ndarray, period: Array, steps: int
) -> Array:
    """Fundamental matrix over a period, (points, 6, 6), by equal steps."""
    h = period / steps
    nodes = np.arange(steps)[:, None] + 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])[:, None, None]
    values = [matrix(part, node * h) * h[:, None, None] for node in nodes]
    product = magnus_propagator(*values)
    while len(product) > 1:
        product = product[1::2] @ product[::2]
    return product[0]


def magnus_propagator(first: Array, middle: Array, last: Array) -> Array:
    """Fundamental matrices over a step by Magnus' series of order 6, symplectic where the system is Hamiltonian.

    first, middle, last: the matrices of the linear system at the three Gauss nodes of the step, times its
    length. Returns the exponential is the diagonal Pade approximation of that of a quarter, squared twice,
    which keeps the multipliers of a stable motion on the unit circle. Blanes et al., Phys. Rep. 470 (2009)
    151, (..., size, size).
    """
    identity = np.eye(middle.shape[-1])
    b2, b3 = np.sqrt(15) / 3 * (last - first), 10 / 3 * (last - 2 * middle + first)
    c1 = middle @ b2 - b2 @ middle
    inner = 2 * b3 + c1
    c2 = (inner @ middle - middle @ inner) / 60
    x, y = -20 * middle - b3 + c1, b2 + c2
    z = (middle + b3 / 12 + (x @ y - y @ x) / 240) / 4
    square = z @ z
    even, odd = identity + square / 10, z @ (identity / 2 + square / 120)
    quarter = np.linalg.solve(even - odd, even + odd)
    half = quarter @ quarter
    return half @ half
