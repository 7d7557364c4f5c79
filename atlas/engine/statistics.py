"""Statistics of a run: their sums in the kernel, their final formulas, and what they are called in an atlas.

A statistic is added here alone: a row of the sums (`Row`), a line in `begin` and in `accumulate`, its formula in
`finish`, and its entry in STATISTICS, from which the registry of dataset variables takes name, unit and meaning.
No trajectory is kept. `begin` and `accumulate` are plain arithmetic on scalars and one lane of the sums: the kernel
calls them, compiled or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, auto
from typing import TYPE_CHECKING

import numpy as np

from .sampling import sample, turning_point

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Row(IntEnum):
    """Rows of the kernel's output.

    Weighted sums over the samples; sums over the nodes; extremes; the values from which rates are counted; the last
    sample; and what corrects theta' where the axis passes the vertical.
    """

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[int]) -> int:
        return count

    THETA_DOT = auto()
    THETA_DOT_SQUARED = auto()
    OUTSIDE = auto()
    PSI_DOT = auto()
    PSI_DOT_SQUARED = auto()
    PHI_DOT = auto()
    PHI_DOT_SQUARED = auto()
    NORMAL_RATE = auto()
    NORMAL_RATE_SQUARED = auto()
    AXIS_1 = auto()
    AXIS_2 = auto()
    COS_THETA_MIN = auto()
    COS_THETA_MAX = auto()
    SIN2_THETA_MIN_ABOVE = auto()  # of the samples with cos theta > 0
    SIN2_THETA_MIN_BELOW = auto()  # of those with cos theta < 0
    SIN2_THETA_MAX = auto()
    DRIFT = auto()
    PSI_DOT_REFERENCE = auto()
    PHI_DOT_REFERENCE = auto()
    NORMAL_RATE_REFERENCE = auto()
    COS_THETA = auto()
    SIN2_THETA = auto()
    THETA_DOT_SIN_THETA = auto()
    FIRST_THETA = auto()
    PASSAGES = auto()


@dataclass(frozen=True)
class Statistic:
    """A measured variable of the atlas.

    Attributes
    ----------
    name : str
        Name in the atlas and in the result of `finish`.
    unit : str
        UDUNITS spelling.
    long_name : str
        Meaning, in a few words.
    needs_psi : bool
        Has no meaning where the third axis stays inside the cylinder.
    """

    name: str
    unit: str
    long_name: str
    needs_psi: bool = False


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


def begin(stats, l, motion, weight, cylinder_squared):
    """Start lane l of the sums with the first sample, from whose rates psi', phi' and the normal rate are counted."""
    for row in range(stats.shape[0]):
        stats[row, l] = 0.0
    theta_dot, psi_dot, phi_dot, normal_rate, cos_theta, sin2_theta, slope, outside = sample(
        motion, cylinder_squared
    )
    stats[Row.THETA_DOT, l] = weight * theta_dot
    stats[Row.THETA_DOT_SQUARED, l] = weight * theta_dot * theta_dot
    stats[Row.OUTSIDE, l] = weight * outside
    stats[Row.PSI_DOT_REFERENCE, l] = psi_dot
    stats[Row.PHI_DOT_REFERENCE, l] = phi_dot
    stats[Row.NORMAL_RATE_REFERENCE, l] = normal_rate
    stats[Row.FIRST_THETA, l] = np.arctan2(np.sqrt(sin2_theta), cos_theta)
    stats[Row.COS_THETA, l] = cos_theta
    stats[Row.SIN2_THETA, l] = sin2_theta
    stats[Row.THETA_DOT_SIN_THETA, l] = slope
    stats[Row.COS_THETA_MIN, l] = cos_theta
    stats[Row.COS_THETA_MAX, l] = cos_theta
    stats[Row.SIN2_THETA_MAX, l] = sin2_theta
    stats[Row.SIN2_THETA_MIN_ABOVE, l] = sin2_theta if cos_theta > 0.0 else 1.0
    stats[Row.SIN2_THETA_MIN_BELOW, l] = sin2_theta if cos_theta < 0.0 else 1.0


def accumulate(stats, l, motion, weight, spacing, cylinder_squared):
    """Add one sample to lane l of the sums, `spacing` (time units) after the one before."""
    theta_dot, psi_dot, phi_dot, normal_rate, cos_theta, sin2_theta, slope, outside = sample(
        motion, cylinder_squared
    )
    cos_extreme, sin2_extreme = turning_point(
        spacing,
        stats[Row.COS_THETA, l],
        stats[Row.SIN2_THETA, l],
        stats[Row.THETA_DOT_SIN_THETA, l],
        cos_theta,
        sin2_theta,
        slope,
    )
    stats[Row.COS_THETA, l] = cos_theta
    stats[Row.SIN2_THETA, l] = sin2_theta
    stats[Row.THETA_DOT_SIN_THETA, l] = slope
    psi_dot = (psi_dot - stats[Row.PSI_DOT_REFERENCE, l]) * outside
    phi_dot = (phi_dot - stats[Row.PHI_DOT_REFERENCE, l]) * outside
    normal_rate = normal_rate - stats[Row.NORMAL_RATE_REFERENCE, l]
    stats[Row.THETA_DOT, l] += weight * theta_dot
    stats[Row.THETA_DOT_SQUARED, l] += weight * theta_dot * theta_dot
    stats[Row.OUTSIDE, l] += weight * outside
    stats[Row.PSI_DOT, l] += weight * psi_dot
    stats[Row.PSI_DOT_SQUARED, l] += weight * psi_dot * psi_dot
    stats[Row.PHI_DOT, l] += weight * phi_dot
    stats[Row.PHI_DOT_SQUARED, l] += weight * phi_dot * phi_dot
    stats[Row.NORMAL_RATE, l] += weight * normal_rate
    stats[Row.NORMAL_RATE_SQUARED, l] += weight * normal_rate * normal_rate
    low, high = stats[Row.COS_THETA_MIN, l], stats[Row.COS_THETA_MAX, l]
    stats[Row.COS_THETA_MIN, l] = cos_extreme if cos_extreme < low else low
    stats[Row.COS_THETA_MAX, l] = cos_extreme if cos_extreme > high else high
    above, least = (sin2_extreme if cos_extreme > 0.0 else 1.0), stats[Row.SIN2_THETA_MIN_ABOVE, l]
    stats[Row.SIN2_THETA_MIN_ABOVE, l] = above if above < least else least
    below, least = (sin2_extreme if cos_extreme < 0.0 else 1.0), stats[Row.SIN2_THETA_MIN_BELOW, l]
    stats[Row.SIN2_THETA_MIN_BELOW, l] = below if below < least else least
    largest = stats[Row.SIN2_THETA_MAX, l]
    stats[Row.SIN2_THETA_MAX, l] = sin2_extreme if sin2_extreme > largest else largest


def theta_from(cos_theta: NDArray[np.float64], sin2_theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """theta in rad, 0 to pi, from cos theta or sin^2 theta, whichever is better conditioned."""
    small = np.arcsin(np.sqrt(np.clip(sin2_theta, 0.0, 1.0)))
    from_sine = np.where(cos_theta > 0, small, np.pi - small)
    return np.where(np.abs(cos_theta) > 0.5, from_sine, np.arccos(np.clip(cos_theta, -1.0, 1.0)))


def finish(
    out: NDArray[np.float64], intervals: NDArray[np.int64], samples_per_step: NDArray[np.int64] | int = 1
) -> dict[str, NDArray[np.float64]]:
    """Means, standard deviations and extremes from the kernel's output.

    Parameters
    ----------
    out : ndarray of float64, shape (len(Row), points)
        Output of the kernel.
    intervals : ndarray of int64, shape (points,)
        Samples less one.
    samples_per_step : ndarray of int64, shape (points,), or int
        As in `stepsize.StepSizes`.

    Returns
    -------
    dict of ndarray of float64, shape (points,)
        Every name of STATISTICS; the means and standard deviations of psi' and phi' are over the samples outside the
        cylinder, nan if there is none. Also `sine_max`, the largest sin theta, and `axis_1`, `axis_2`, means of the
        system's `axis_in_frame`.
    """
    with np.errstate(all="ignore"):
        # np.maximum returns nan for nan: a run that overflowed stays visible.
        square, mean = out[Row.THETA_DOT_SQUARED] / intervals, out[Row.THETA_DOT] / intervals
        result = {
            "theta_dot_rms": np.sqrt(square),
            "theta_dot_std": np.sqrt(np.maximum(square - mean**2, 0.0)),
        }
        outside = out[Row.OUTSIDE]
        for name, reference, total, total_squared, weight in (
            ("psi_dot", Row.PSI_DOT_REFERENCE, Row.PSI_DOT, Row.PSI_DOT_SQUARED, outside),
            ("phi_dot", Row.PHI_DOT_REFERENCE, Row.PHI_DOT, Row.PHI_DOT_SQUARED, outside),
            ("normal_rate", Row.NORMAL_RATE_REFERENCE, Row.NORMAL_RATE, Row.NORMAL_RATE_SQUARED, intervals),
        ):
            shifted_mean, square = out[total] / weight, out[total_squared] / weight
            result[f"{name}_mean"] = out[reference] + shifted_mean
            result[f"{name}_std"] = np.sqrt(np.maximum(square - shifted_mean**2, 0.0))
        result |= _tilt_extremes(out)
        nodes = intervals // samples_per_step + 1
        result["axis_1"] = out[Row.AXIS_1] / nodes
        result["axis_2"] = out[Row.AXIS_2] / nodes
    result["integral_drift"] = out[Row.DRIFT].copy()
    return result


def _tilt_extremes(out: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """theta_min and theta_max in rad, and the largest sin theta."""
    cos_last, sin2_last = out[Row.COS_THETA], out[Row.SIN2_THETA]  # the end of a run is no turning point
    low = np.minimum(out[Row.COS_THETA_MIN], cos_last)
    high = np.maximum(out[Row.COS_THETA_MAX], cos_last)
    widest = np.maximum(out[Row.SIN2_THETA_MAX], sin2_last)
    above = np.minimum(out[Row.SIN2_THETA_MIN_ABOVE], np.where(cos_last > 0, sin2_last, 1.0))
    below = np.minimum(out[Row.SIN2_THETA_MIN_BELOW], np.where(cos_last < 0, sin2_last, 1.0))
    # All on one side of the equator the widest tilt is the extreme nearer to it.
    return {
        "theta_min": theta_from(high, np.where(high > 0, above, widest)),
        "theta_max": theta_from(low, np.where(low > 0, widest, below)),
        "sine_max": np.sqrt(np.minimum(widest, 1.0)),
    }
