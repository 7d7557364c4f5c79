"""What a motion never exceeds, and the label that follows for every duration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...flags import Label
from ...measure.instrument import Tolerances
from ...systems.base import Array, Flags

# Rounding error of an energy over the magnitudes of its terms: each has fewer than 40 roundings.
ROUNDING = 64 * 2.0**-53
_KEPT = 1e-9  # share of a tolerance that is not used
# How often a limit is halved to find a distance, and then the interval in which it is.
_DOWN, _WITHIN = 40, 34


class Bounds(NamedTuple):
    """Limits of theta and of the rates for all time, arrays (points,); nan where nothing is known."""

    sine: tuple[Array, Array]  # least and largest sin(theta)
    theta_dot: Array  # largest magnitude
    psi_dot: tuple[Array, Array]  # centre of the range and half its width
    phi_dot: tuple[Array, Array]
    normal_rate: Array  # half the width of the range of the rate about the vertical


def label(bounds: Bounds, tolerances: Tolerances, frame_rate: Array | float) -> tuple[Flags, Array]:
    """The label of every duration, 0 where none follows, and the largest deviation that a rate can have, (points,).

    A standard deviation is at most half the width of the range, and a mean is in it.
    """
    (least, largest), (n, n_width), (m, m_width) = bounds.sine, bounds.psi_dot, bounds.phi_dot
    rate, inside = tolerances.rate * (1 - _KEPT), largest < tolerances.angle * (1 - _KEPT)
    n, away = n + frame_rate, least > tolerances.angle * (1 + _KEPT)
    deviation = np.select(
        [inside, away],
        [bounds.normal_rate, np.maximum(bounds.theta_dot, np.maximum(n_width, m_width))],
        np.nan,
    )
    zero = (np.abs(n) + n_width <= rate) | (np.abs(m) + m_width <= rate)
    turning = np.minimum(np.abs(n) - n_width, np.abs(m) - m_width) > tolerances.rate * (1 + _KEPT)
    kinds = [~(deviation <= rate), inside | zero, turning]
    flags = np.select(kinds, [Label.NOT_COMPUTED, Label.PERMANENT_ROTATION, Label.REGULAR_PRECESSION], 0)
    return flags.astype(np.int8), deviation


def reach(coefficients: Sequence[Array | float], limit: Array, start: Array | float = 0.0) -> Array:
    """A distance that no motion passes: up to the limit and beyond the start, with a negative polynomial; nan if none is found.

    coefficients: from that of degree 0 upwards.
    """

    def excluded(distance: Array) -> Array:
        value: Array | float = 0.0
        for coefficient in reversed(coefficients):
            value = value * distance + coefficient
        return np.asarray((value < 0) & (distance > start))

    outer, distance = np.full(limit.shape, np.nan), limit
    for _ in range(_DOWN):
        outer = np.where(excluded(distance), distance, outer)
        distance = 0.5 * distance
    inner = 0.5 * outer
    for _ in range(_WITHIN):
        middle = 0.5 * (inner + outer)
        passed = excluded(middle)
        inner, outer = np.where(passed, inner, middle), np.where(passed, middle, outer)
    return outer


def sine_range(theta: Array, angle: Array) -> tuple[Array, Array]:
    """Least and largest sin(theta) within an angle of theta."""
    low, high = theta - angle, theta + angle
    ends = np.sin(np.maximum(low, 0.0)), np.sin(np.minimum(high, np.pi))
    least = np.where((low > 0) & (high < np.pi), np.minimum(*ends), 0.0)
    return least, np.where(np.abs(theta - np.pi / 2) <= angle, 1.0, np.maximum(*ends))
