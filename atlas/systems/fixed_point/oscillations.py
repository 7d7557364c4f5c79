"""Frequencies of small oscillations about steady motions of a gyrostat with a fixed point, and stability by the energy.

On the level of the momentum about the vertical a permanent rotation is stable by the energy where the Hessian of the amended
potential is positive definite (V. V. Rumyantsev, J. Appl. Math. Mech. 30 (1966) 1090). With the momentum C r + l3 of a
symmetric body as a further integral, and for a free body, whose momentum is constant, stability by the integrals is linear
stability, except where exponents vanish (N. G. Chetaev, The Stability of Motion, Pergamon 1961).
"""

from __future__ import annotations

import numpy as np

from ...flags import EnergyStability, Stability
from ..base import FAMILY_TOLERANCE, Array, Flags, Mask, Points, subset
from ..vectors import dot
from .initial import initial_state, rates, symmetric, vertical
from .stability import ROUNDING, amended_hessian, nutation, rotation_frequencies, sleeping_discriminant


def frequencies(points: Points, flags: Flags) -> Array:
    """Frequencies of the small oscillations about steady motions.

    Of a permanent rotation about the vertical, relative to the body; of a symmetric body that sleeps, relative to space;
    of a regular precession that of the nutation, of a free body that of the polhode.

    points: 1-D arrays of one length. flags: families, as identify_family gives them; only whether there is
    one counts. Returns rad per time unit, the largest first, at most two; nan for exponents that are 0 or
    have a real part, and off every family, (points, 3).
    """
    result = np.full((3, flags.size), np.nan)
    axial = symmetric(points)
    gamma = vertical(points)
    asleep = np.hypot(gamma[0], gamma[1]) <= FAMILY_TOLERANCE
    turning = ~asleep & (rates(points)[2] != 0)
    with np.errstate(all="ignore"):
        for where, pair in (
            (axial & asleep, _sleeping),
            (axial & ~asleep, _nutation),
            (~axial & turning, _free),
            (~axial & ~turning, _rotation),
        ):
            members = np.flatnonzero(where & (flags > 0))
            result[:2, members] = pair(subset(points, members))
    return result.T


def _sleeping(points: Points) -> Array:
    """(S +- sqrt D) / (2 A) with S = C r + l3 and D its discriminant."""
    value, size = sleeping_discriminant(points)
    spin = points["C"] * initial_state(points)[2] + points["l3"]
    root = np.sqrt(np.where(value > ROUNDING * size, value, np.nan))
    pair = np.abs(np.array([spin + root, spin - root])) / (2 * points["A"])
    return -np.sort(-_without_zeros(pair, np.sqrt(size) / points["A"]), axis=0)


def _nutation(points: Points) -> Array:
    """Root of `stability.nutation`."""
    value, size = nutation(points)
    root = np.sqrt(np.where(value > ROUNDING * size, value, np.nan))
    return np.array([root, np.full_like(root, np.nan)])


def _free(points: Points) -> Array:
    """Free body that turns about its third axis: Euler's equations linearised, with a rotor."""
    A, B, C, m = points["A"], points["B"], points["C"], rates(points)[2]
    square = ((C - A) * m + points["l3"]) * ((C - B) * m + points["l3"]) / (A * B)
    root = np.sqrt(np.where(square > 0, square, np.nan))
    return np.array([root, np.full_like(root, np.nan)])


def _rotation(points: Points) -> Array:
    """Permanent rotation about the vertical of any body."""
    gamma = vertical(points)
    n = dot(initial_state(points)[:3], gamma)
    pair = rotation_frequencies(points, n, gamma)
    return _without_zeros(pair, np.fmax.reduce(pair))


def _without_zeros(pair: Array, scale: Array) -> Array:
    """The frequencies, nan where they are zero but for rounding."""
    return np.where(pair > np.sqrt(ROUNDING) * scale, pair, np.nan)


def energy_stability(points: Points, flags: Flags, linear: Flags) -> tuple[Flags, Mask]:
    """Whether steady motions are stable by the energy; as `systems.oscillations.oscillation_variables` needs it.

    linear: values of flags.Stability of the motions.
    """
    gamma = vertical(points)
    with np.errstate(all="ignore"):
        n = dot(initial_state(points)[:3], gamma)
        determinant, trace, size = amended_hessian(points, n, gamma)
        zero = ~(np.abs(determinant) > ROUNDING * size)
    by_potential = np.where((determinant > 0) & (trace > 0), EnergyStability.YES, EnergyStability.NO)
    by_potential = np.where(zero, EnergyStability.UNKNOWN, by_potential)
    by_exponents = np.select(
        [linear == Stability.STABLE, linear == Stability.UNSTABLE],
        [EnergyStability.YES, EnergyStability.NO],
        0,
    )
    asleep = np.hypot(gamma[0], gamma[1]) <= FAMILY_TOLERANCE
    free = ~asleep & (rates(points)[2] != 0)
    result = np.where(symmetric(points) | free, by_exponents, by_potential)
    result = np.where(flags > 0, result, EnergyStability.UNKNOWN).astype(np.int8)
    return result, (flags > 0) & (result == EnergyStability.UNKNOWN)
