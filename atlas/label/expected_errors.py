"""Errors to expect of the statistics of a run, from its step sizes alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..engine.ensemble import Integration
from ..engine.sampling import MIN_INTERVALS
from ..engine.stepsize import ROUNDING, StepSizes
from ..scene.model import Tolerances
from ..systems.base import Array


def error_estimate(step_sizes: StepSizes, log_growth: Array, integration: Integration) -> Array:
    """Relative error of states and statistics, (points,).

    The error of an oscillation at the frequency bound, amplified by the instability of the motion (to 1 at most); where
    the axis was in the cylinder for a part of the run, at least the share of one sample.

    Parameters
    ----------
    step_sizes : StepSizes
    log_growth : ndarray of float64, shape (points,)
        Growth rate of the family's motion times duration.
    integration : Integration
    """
    error = np.maximum(step_sizes.dispersion_error, step_sizes.dissipation_error)
    with np.errstate(over="ignore"):
        amplified = np.minimum(error * np.exp(log_growth), np.maximum(error, 1.0))
    error = np.where(log_growth > 0, amplified, error)
    run = step_sizes.step_size * step_sizes.steps
    one_sample = np.maximum(error, step_sizes.sample_spacing / run)
    return np.asarray(np.where(integration.crossed_cylinder, one_sample, error))


def early_stop_rate(step_sizes: StepSizes, bound: Array, tolerances: Tolerances) -> Array:
    """Rate beyond which no expected error can bring a drifting label back, (points,), rad per time unit."""
    absolute = step_sizes.rate_error + bound * ROUNDING * np.sqrt(step_sizes.steps) / tolerances.angle
    return np.asarray(
        (tolerances.rate + absolute) / (1.0 - np.minimum(_relative_error(step_sizes, bound), 1.0))
    )


def measurement_errors(
    step_sizes: StepSizes, bound: Array, measured: Mapping[str, Array]
) -> dict[str, Array]:
    """Expected error of each measurement that decides a label, in its unit, (points,) each."""
    relative = np.minimum(_relative_error(step_sizes, bound), 1.0)
    # psi' and phi' divide by sin theta: rounding counts the more, the nearer the vertical.
    sine = np.minimum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"]))
    near_vertical = step_sizes.rate_error + bound * ROUNDING * np.sqrt(step_sizes.steps) / np.maximum(
        sine, 1e-300
    )
    # A cubic between two samples misses the extreme of an oscillation by the fourth power of their spacing.
    interpolation = (bound * step_sizes.sample_spacing) ** 4 / 384
    angle = (measured["theta_max"] - measured["theta_min"]) * np.minimum(relative + interpolation, 1.0)
    angle += measured["sine_max"] * np.where(bound > 0, step_sizes.rate_error / bound, 0.0)
    absolute = {
        "theta_dot_rms": step_sizes.rate_error,
        "normal_rate_std": step_sizes.rate_error,
        "psi_dot_std": near_vertical,
        "phi_dot_std": near_vertical,
    }
    errors = {name: size + relative * measured[name] for name, size in absolute.items()}
    errors |= {"psi_dot_mean": near_vertical, "phi_dot_mean": near_vertical}
    return errors | {"theta_min": angle, "theta_max": angle, "sine_max": angle}


def _relative_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Relative error of a standard deviation: dispersion, dissipation and quadrature error."""
    quadrature = np.where(
        step_sizes.intervals < MIN_INTERVALS, 1.0, (0.5 * bound * step_sizes.sample_spacing) ** 8
    )
    return np.asarray(step_sizes.dispersion_error + step_sizes.dissipation_error + quadrature)
