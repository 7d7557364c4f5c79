"""Statistics of a run: their sums in the kernel, their final formulas, and their names in an atlas.

A new statistic of every atlas is written in this module alone. It needs a row of the sums (`Row`), a line in `begin` and in
`accumulate`, a formula in `finish`, and an entry in STATISTICS. The registry of variables takes name, unit and meaning from the
entry. Statistics that only some scenes ask for are instruments (`measure.instrument`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from .poles import turns_twice
from .sampling import sample

if TYPE_CHECKING:
    from numpy.typing import NDArray


# ZERO_1_REAL or ZERO_2_REAL has this value while no zero is stored.
NO_ZERO = -1e3
# theta' may jump if the mean of its samples and (theta_end - theta_start) / duration differ by more than a factor times the rms theta'.
# The factor is SAME_MEAN (for rounding), or SAME_MEAN_OF_CONSTANT (for errors of the steps) if variance / mean square < CONSTANT.
SAME_MEAN, SAME_MEAN_OF_CONSTANT, CONSTANT = 1e-12, 1e-7, 1e-4


class Row(IntEnum):
    """Rows of the kernel's output, with sums, quadrature errors, extremes, rates at the start (REFERENCE), and theta at start and end."""

    OUTSIDE, THETA_DOT_SQUARED, THETA_DOT_CHANGE, THETA_DOT_CHANGE_SQUARED = range(4)
    PSI_DOT, PSI_DOT_SQUARED, PHI_DOT, PHI_DOT_SQUARED, NORMAL_RATE, NORMAL_RATE_SQUARED = range(4, 10)
    THETA_DOT_SQUARED_ERROR, PSI_DOT_ERROR, PSI_DOT_SQUARED_ERROR = range(10, 13)
    PHI_DOT_ERROR, PHI_DOT_SQUARED_ERROR = range(13, 15)
    AXIS_1, AXIS_2, COS_THETA_MIN, COS_THETA_MAX = range(15, 19)
    # ABOVE is the least sin^2 theta where cos theta > 0, BELOW where cos theta < 0. Each is 1 if cos theta never has this sign.
    SIN2_THETA_MIN_ABOVE, SIN2_THETA_MIN_BELOW, SIN2_THETA_MAX, DRIFT = range(19, 23)
    THETA_DOT_REFERENCE, PSI_DOT_REFERENCE, PHI_DOT_REFERENCE, NORMAL_RATE_REFERENCE = range(23, 27)
    FIRST_THETA, LAST_THETA = range(27, 29)
    # These are the last two zeros of zeta = g1 + i g2 (see `kernel.poles`) whose quadrature errors were added.
    ZERO_1_REAL, ZERO_1_IMAG, ZERO_2_REAL, ZERO_2_IMAG = range(29, 33)


class Node(IntEnum):
    """Rows of a node of a motion, which are the angular velocity u and the vertical g, then the derivatives of u and g.

    u is in rad per time unit. The derivatives are per unit of the kernel's time, and nodes are `spacing` of these units apart. A
    derivative times `inverse_unit` is per time unit.
    """

    U1, U2, U3, G1, G2, G3 = range(6)
    DU1, DU2, DU3, DG1, DG2, DG3 = range(6, 12)


@dataclass(frozen=True)
class Statistic:
    """A measured variable of the atlas."""

    name: str  # name in the atlas and in the result of `finish`
    unit: str  # UDUNITS spelling
    long_name: str  # meaning, in a few words
    needs_psi: bool = False  # whether the value is undefined if the third axis stays near the vertical


_RATE = "rad s-1"
RATE_STATISTICS = (
    Statistic("theta_dot_rms", _RATE, "root mean square of the nutation rate"),
    Statistic("theta_dot_std", _RATE, "standard deviation of the nutation rate"),
    Statistic("psi_dot_mean", _RATE, "mean precession rate", needs_psi=True),
    Statistic("psi_dot_std", _RATE, "standard deviation of the precession rate", needs_psi=True),
    Statistic("phi_dot_mean", _RATE, "mean rate of proper rotation", needs_psi=True),
    Statistic("phi_dot_std", _RATE, "standard deviation of the rate of proper rotation", needs_psi=True),
    Statistic("normal_rate_mean", _RATE, "mean rate about the vertical of the frame"),
    Statistic("normal_rate_std", _RATE, "standard deviation of the rate about the vertical of the frame"),
)
STATISTICS = (
    *RATE_STATISTICS,
    Statistic("theta_min", "rad", "least angle between third axis and vertical"),
    Statistic("theta_max", "rad", "largest angle between third axis and vertical"),
    Statistic("integral_drift", "1", "largest relative change of a first integral"),
)
RATES = tuple(statistic.name for statistic in RATE_STATISTICS)
NEEDS_PSI = tuple(statistic.name for statistic in STATISTICS if statistic.needs_psi)


def begin(stats, l, motion, cylinder_squared):
    """Start the sums of lane l at the first node. The rates there are subtracted from later rates."""
    for row in range(stats.shape[0]):
        stats[row, l] = 0.0
    theta_dot, psi_dot, phi_dot, normal_rate, sin2_theta, _ = sample(motion, cylinder_squared)
    cos_theta = motion[5]
    stats[Row.ZERO_1_REAL, l], stats[Row.ZERO_2_REAL, l] = NO_ZERO, NO_ZERO
    stats[Row.THETA_DOT_REFERENCE, l] = theta_dot
    stats[Row.PSI_DOT_REFERENCE, l] = psi_dot
    stats[Row.PHI_DOT_REFERENCE, l] = phi_dot
    stats[Row.NORMAL_RATE_REFERENCE, l] = normal_rate
    stats[Row.FIRST_THETA, l] = np.arctan2(np.sqrt(sin2_theta), cos_theta)
    stats[Row.COS_THETA_MIN, l] = cos_theta
    stats[Row.COS_THETA_MAX, l] = cos_theta
    stats[Row.SIN2_THETA_MIN_ABOVE, l] = 1.0
    stats[Row.SIN2_THETA_MIN_BELOW, l] = 1.0


def accumulate(stats, l, motion, weight, cylinder_squared):
    theta_dot, psi_dot, phi_dot, normal_rate, _, outside = sample(motion, cylinder_squared)
    change = theta_dot - stats[Row.THETA_DOT_REFERENCE, l]
    psi_dot = (psi_dot - stats[Row.PSI_DOT_REFERENCE, l]) * outside
    phi_dot = (phi_dot - stats[Row.PHI_DOT_REFERENCE, l]) * outside
    normal_rate = normal_rate - stats[Row.NORMAL_RATE_REFERENCE, l]
    # Adding to these sums in another order makes rk8 up to a tenth slower.
    stats[Row.OUTSIDE, l] += weight * outside
    stats[Row.THETA_DOT_SQUARED, l] += weight * theta_dot * theta_dot
    stats[Row.PSI_DOT, l] += weight * psi_dot
    stats[Row.PSI_DOT_SQUARED, l] += weight * psi_dot * psi_dot
    stats[Row.PHI_DOT, l] += weight * phi_dot
    stats[Row.PHI_DOT_SQUARED, l] += weight * phi_dot * phi_dot
    stats[Row.NORMAL_RATE, l] += weight * normal_rate
    stats[Row.NORMAL_RATE_SQUARED, l] += weight * normal_rate * normal_rate
    stats[Row.THETA_DOT_CHANGE, l] += weight * change
    stats[Row.THETA_DOT_CHANGE_SQUARED, l] += weight * change * change


def extend(stats, l, cos_theta, sin2_theta):
    """Update the extremes of lane l with a direction of the third axis."""
    low, high = stats[Row.COS_THETA_MIN, l], stats[Row.COS_THETA_MAX, l]
    stats[Row.COS_THETA_MIN, l] = cos_theta if cos_theta < low else low
    stats[Row.COS_THETA_MAX, l] = cos_theta if cos_theta > high else high
    above, least = (sin2_theta if cos_theta > 0.0 else 1.0), stats[Row.SIN2_THETA_MIN_ABOVE, l]
    stats[Row.SIN2_THETA_MIN_ABOVE, l] = above if above < least else least
    below, least = (sin2_theta if cos_theta < 0.0 else 1.0), stats[Row.SIN2_THETA_MIN_BELOW, l]
    stats[Row.SIN2_THETA_MIN_BELOW, l] = below if below < least else least
    largest = stats[Row.SIN2_THETA_MAX, l]
    stats[Row.SIN2_THETA_MAX, l] = sin2_theta if sin2_theta > largest else largest


def may_extend(stats, l, cos_0, cos_1, slope_0, slope_1):
    """Return 1.0 if theta in lane l may have a new extreme between two nodes at unit distance, else 0.0."""
    margin = 0.25 * (abs(slope_0) + abs(slope_1)) + 1e-9
    above = 1.0 if max(cos_0, cos_1) + margin > stats[Row.COS_THETA_MAX, l] else 0.0
    below = 1.0 if min(cos_0, cos_1) - margin < stats[Row.COS_THETA_MIN, l] else 0.0
    possible = above if slope_0 > 0.0 else below
    twice = turns_twice(cos_0, cos_1, slope_0, slope_1, 1e-12) * max(above, below)
    return possible if slope_0 * slope_1 < 0.0 else twice


def end(stats, l, motion):
    """Store theta at the last node of lane l."""
    stats[Row.LAST_THETA, l] = np.arctan2(np.sqrt(motion[3] * motion[3] + motion[4] * motion[4]), motion[5])


def theta_from(cos_theta: NDArray[np.float64], sin2_theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return theta from 0 to pi, computed from cos theta or sin^2 theta, whichever is better conditioned."""
    small = np.arcsin(np.sqrt(np.clip(sin2_theta, 0.0, 1.0)))
    from_sine = np.where(cos_theta > 0, small, np.pi - small)
    return np.where(np.abs(cos_theta) > 0.5, from_sine, np.arccos(np.clip(cos_theta, -1.0, 1.0)))


def finish(
    out: NDArray[np.float64], intervals: NDArray[np.int64], duration: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return STATISTICS by name, with the largest sin theta (sine_max), the fraction outside the cylinder, and the mean axis."""
    with np.errstate(all="ignore"):
        # np.maximum returns nan for nan, so that an overflow stays visible.
        square = np.maximum(theta_dot_squared_sum(out) / intervals, 0.0)
        rms, shift = np.sqrt(square), out[Row.THETA_DOT_CHANGE] / intervals
        about_start = out[Row.THETA_DOT_CHANGE_SQUARED] - out[Row.THETA_DOT_SQUARED_ERROR]
        variance = np.maximum(about_start / intervals - shift**2, 0.0)
        # theta' jumps where the axis passes the vertical, so that the sum over the samples differs from the change of theta.
        mean = (out[Row.LAST_THETA] - out[Row.FIRST_THETA]) / duration
        same = np.where(variance < CONSTANT * square, SAME_MEAN_OF_CONSTANT, SAME_MEAN)
        jumps = np.abs(out[Row.THETA_DOT_REFERENCE] + shift - mean) > same * rms
        jumps &= (out[Row.ZERO_1_REAL] > NO_ZERO) | (
            np.minimum(out[Row.SIN2_THETA_MIN_ABOVE], out[Row.SIN2_THETA_MIN_BELOW]) < 0.01
        )
        variance = np.where(jumps, np.maximum(square - mean**2, 0.0), variance)
        result = {"theta_dot_rms": rms, "theta_dot_std": np.sqrt(variance)}
        outside = out[Row.OUTSIDE]  # weight of samples outside the cylinder; if 0, psi' and phi' are nan
        psi, phi = out[Row.PSI_DOT] - out[Row.PSI_DOT_ERROR], out[Row.PHI_DOT] - out[Row.PHI_DOT_ERROR]
        psi_squared = out[Row.PSI_DOT_SQUARED] - out[Row.PSI_DOT_SQUARED_ERROR]
        phi_squared = out[Row.PHI_DOT_SQUARED] - out[Row.PHI_DOT_SQUARED_ERROR]
        normal, normal_squared = out[Row.NORMAL_RATE], out[Row.NORMAL_RATE_SQUARED]
        for name, reference, total, total_squared, weight in (
            ("psi_dot", Row.PSI_DOT_REFERENCE, psi, psi_squared, outside),
            ("phi_dot", Row.PHI_DOT_REFERENCE, phi, phi_squared, outside),
            ("normal_rate", Row.NORMAL_RATE_REFERENCE, normal, normal_squared, intervals),
        ):
            shifted_mean, square = total / weight, total_squared / weight
            result[f"{name}_mean"] = out[reference] + shifted_mean
            result[f"{name}_std"] = np.sqrt(np.maximum(square - shifted_mean**2, 0.0))
        low, high = out[Row.COS_THETA_MIN], out[Row.COS_THETA_MAX]
        widest = np.where((low < 0) & (high > 0), 1.0, out[Row.SIN2_THETA_MAX])
        # If theta stays on one side of the equator, sin theta is largest at the extreme nearer to the equator.
        result |= {
            "theta_min": theta_from(high, np.where(high > 0, out[Row.SIN2_THETA_MIN_ABOVE], widest)),
            "theta_max": theta_from(low, np.where(low > 0, widest, out[Row.SIN2_THETA_MIN_BELOW])),
            "sine_max": np.sqrt(np.minimum(widest, 1.0)),
            "outside": outside / intervals,
        }
        result["axis_1"] = out[Row.AXIS_1] / (intervals + 1)
        result["axis_2"] = out[Row.AXIS_2] / (intervals + 1)
    result["integral_drift"] = out[Row.DRIFT].copy()
    return result


def theta_dot_squared_sum(out: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of theta'^2 over the samples, corrected for passages near the vertical."""
    return np.asarray(out[Row.THETA_DOT_SQUARED] - out[Row.THETA_DOT_SQUARED_ERROR])
