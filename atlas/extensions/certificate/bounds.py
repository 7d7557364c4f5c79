"""Bounds of a motion for all time, and the label that follows. `theory.compiled` compiles these scalar functions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...flags import Flag, Label
from ...theory.point import Vector, larger, smaller

BOUND = "proof_bound"
PROOFS_OF = {"label": "label_proof", "label_inertial": "label_inertial_proof"}
KEPT = 1e-9  # safety margin of comparisons, as a fraction of a tolerance
# `reach` tries at most `DOWN` distances, each twice the previous one, until a polynomial is negative. `WITHIN` bisections follow.
DOWN, WITHIN = 40, 34


class Proof(Flag):
    """How a label is proved."""

    NONE = 0, "no proof"
    ENERGY = 1, "for every duration the motion has the predicted label: the energy keeps it near a minimum"
    MOMENTA = (
        2,
        "for every duration the motion has the predicted label: two momenta limit the nutation of a top",
    )


class Direction(NamedTuple):
    """Gradient and field of the potential along a direction at rest in the frame, see `gyrostat.body.Direction`."""

    gradient: float
    field: Vector


class GyrostatBody(NamedTuple):
    """One gyrostat and its potential, as numbers. `gyrostat.body.Body` contains the same quantities as arrays."""

    inertia: Vector
    rotor: Vector
    turn: float
    alpha: Direction
    beta: Direction
    gamma: Direction
    damping: float


class Tolerances(NamedTuple):
    rate: float
    angle: float


class Bounds(NamedTuple):
    """Limits of theta and of the rates for all time, nan where nothing is known."""

    least_sine: float
    largest_sine: float
    theta_dot: float  # upper bound of |theta'|
    psi_dot: float  # centre of the range of psi'
    psi_width: float  # half the width of the range of psi'
    phi_dot: float
    phi_width: float
    normal_rate: float  # half the width of the range of the rate about the vertical


def unknown():
    """Return bounds that say nothing."""
    return Bounds(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)


def is_inside(bounds, tolerances):
    return bounds.largest_sine < tolerances.angle * (1 - KEPT)


def is_away(bounds, tolerances):
    return bounds.least_sine > tolerances.angle * (1 + KEPT)


def largest_deviation(bounds, tolerances):
    """Return half the width of the widest range of a rate, or nan if sin(theta) may be both below and above the angle tolerance."""
    if is_inside(bounds, tolerances):
        return bounds.normal_rate
    if is_away(bounds, tolerances):
        return larger(bounds.theta_dot, larger(bounds.psi_width, bounds.phi_width))
    return np.nan


def label_of(bounds, deviation, tolerances, frame_rate):
    """Return the label that `bounds` imply, or NOT_COMPUTED. The label holds for every duration, because the bounds contain mean rates."""
    rate = tolerances.rate * (1 - KEPT)
    if not deviation <= rate:
        return Label.NOT_COMPUTED
    n, m = abs(bounds.psi_dot + frame_rate), abs(bounds.phi_dot)
    if is_inside(bounds, tolerances) or n + bounds.psi_width <= rate or m + bounds.phi_width <= rate:
        return Label.PERMANENT_ROTATION
    if smaller(n - bounds.psi_width, m - bounds.phi_width) > tolerances.rate * (1 + KEPT):
        return Label.REGULAR_PRECESSION
    return Label.NOT_COMPUTED


def value_at(coefficients, distance):
    value = 0.0
    for k in range(len(coefficients) - 1, -1, -1):
        value = value * distance + coefficients[k]
    return value


def reach(coefficients, limit, start):
    """Return a distance in (start, limit] where the polynomial with `coefficients`, lowest degree first, is negative.

    No motion passes such a distance. The result is nan if none is found.
    """
    if not limit > start:
        return np.nan
    outer = limit * 2.0 ** (1 - DOWN)
    while not (outer > start and value_at(coefficients, outer) < 0):
        if outer >= limit:
            return np.nan
        outer *= 2
    inner = 0.5 * outer
    for _ in range(WITHIN):
        middle = 0.5 * (inner + outer)
        passed = middle > start and value_at(coefficients, middle) < 0
        inner, outer = (inner, middle) if passed else (middle, outer)
    return outer


def sine_range(theta, angle):
    """Return the least and the largest sine of the angles between theta - angle and theta + angle."""
    low, high = theta - angle, theta + angle
    first, second = np.sin(larger(low, 0.0)), np.sin(smaller(high, np.pi))
    least = smaller(first, second) if low > 0 and high < np.pi else np.float64(0.0)
    return least, 1.0 if abs(theta - np.pi / 2) <= angle else larger(first, second)
