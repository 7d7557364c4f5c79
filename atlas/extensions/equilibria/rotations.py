"""All permanent rotations about the vertical of bodies on which no force acts along alpha."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import Completeness
from ...systems.base import FAMILY_TOLERANCE, Points, subset
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.oscillations import Equilibria
from ...systems.gyrostat.secular import NEARLY, PLACES, directions
from .algebra import body_at_rest, padded, stability_at_rest

_UNCERTAIN = 1e-13  # Rounding decides the sign of an eigenvalue below this fraction of the Hessian's size.


def rotations(system: Gyrostat, points: Points, nearly: bool = False) -> dict[str, NDArray[Any]]:
    """Return all permanent rotations of bodies about the vertical. Each body has its own rate n, and n = 0 means rest.

    `points` maps every parameter to an array (bodies,). A connected set of solutions is one entry. Entries are sorted by body, then by
    theta. The arrays are row (number of the body), dimension (of the set), index (number of directions in which the amended potential
    decreases), flat (whether the index is uncertain), theta0, phi0 (rad), gamma, circle (whether the set is a circle) and the variables
    `algebra.STABILITY`. With `nearly`, attitudes near complex solutions are added, with index -1.
    """
    turning = body_at_rest(system, points)
    vectors, dimensions = directions(turning, nearly=nearly)
    column, body = np.nonzero(dimensions != -1)
    g = vectors[:, column, body]
    theta, phi = np.arctan2(np.hypot(g[0], g[1]), g[2]), np.arctan2(g[0], g[1])
    order = np.lexsort([g[0], theta, body])
    g, body, theta, phi = g[:, order], body[order], theta[order], phi[order]
    dimension = dimensions[column[order], body]
    start = {"theta0": theta, "phi0": phi, "n": points["n"][body]}
    turning, gamma = turning.subset(body), g.T
    rate = turning.rate(turning.turn[:, None] * gamma)
    vertical = np.stack([gamma, np.zeros_like(gamma)], -1)
    scaled = turning.scaled(rate)
    equilibria = Equilibria(
        np.arange(theta.size), scaled, gamma, gamma, rate, vertical, np.zeros(theta.shape, bool)
    )
    values = equilibria.hessian_eigenvalues()
    flat = np.abs(values) <= np.where(dimension == 0, _UNCERTAIN, FAMILY_TOLERANCE)[:, None]
    index = np.where(dimension == NEARLY, -1, ((values < 0) & ~flat).sum(1)).astype(np.int8)
    return {
        "row": body, "theta0": theta, "phi0": phi, "gamma": gamma, "dimension": dimension,
        "index": index, **stability_at_rest(system, subset(points, body), start),
        "circle": dimension == 1, "flat": flat.any(1) & (dimension == 0),
    }  # fmt: skip


def rotations_of_bodies(system: Gyrostat, points: Points, nearly: bool) -> dict[str, NDArray[Any]]:
    """Return the results of `rotations` as arrays (bodies, places), with completeness, a value of `flags.Completeness`."""
    result = padded(rotations(system, points, nearly), points["n"].size, PLACES)
    flags = np.where(result.pop("flat").any(1), Completeness.NEAR_BIFURCATION, Completeness.COMPLETE)
    flags = np.where((result["dimension"] > 0).any(1), Completeness.NOT_ISOLATED, flags)
    return result | {"completeness": flags.astype(np.int8)}
