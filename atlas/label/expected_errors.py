"""Errors of the states and statistics of a run: expected from its step sizes, or measured by a second run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ..engine.ensemble import Integration
from ..engine.statistics import RATES, Row
from ..engine.stepsize import INTERPOLATION_ERROR, ROUNDING, StepSizes
from ..engine.tableaux import Method
from ..scene.model import Tolerances
from ..systems.base import Array, System
from . import any_axis


def error_estimate(
    step_sizes: StepSizes,
    bound: Array,
    log_growth: Array,
    integration: Integration,
    measured: Mapping[str, Array],
    cylinder: float,
) -> Array:
    """Relative error of states and statistics to expect, (points,).

    That of the states is the error of an oscillation at the frequency bound, amplified by the instability of the motion
    (to 1 at most); see `with_statistics` for the rest.

    bound: frequency bound, rad per time unit; log_growth: growth rate of the family's motion times duration;
    measured: statistics of the integration; cylinder: radius of the cylinder, rad.
    """
    error = np.maximum(step_sizes.dispersion_error, step_sizes.dissipation_error) + rounding_error(step_sizes)
    with np.errstate(all="ignore"):
        amplified = np.minimum(error * np.exp(log_growth), np.maximum(error, 1.0))
        error = np.where(log_growth > 0, amplified, error)
    return with_statistics(error, step_sizes, bound, integration, measured, cylinder)


def with_statistics(
    state_error: Array,
    step_sizes: StepSizes,
    bound: Array,
    integration: Integration,
    measured: Mapping[str, Array],
    cylinder: float,
) -> Array:
    """Relative error of states and statistics from that of the states, (points,).

    The interpolation between nodes adds to the error of the angles. That of psi' and phi' grows as the third axis comes
    near the vertical, and is as large as they are where it was in the cylinder for a part of the run. Arguments as for
    `error_estimate`.
    """
    with np.errstate(all="ignore"):
        angle = state_error + _interpolation_error(step_sizes, bound)
        sine = np.minimum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"]))
        spread = np.fmax(measured["psi_dot_std"], measured["phi_dot_std"]) / bound
        rates = np.fmax(angle, angle * (1.0 + (2.0 + 6.0 * spread) / np.maximum(sine, 1e-300)))
        # The peak of psi' of an axis that leaves the cylinder at the frequency bound.
        peak = np.sqrt(0.5 * np.pi / (cylinder * bound * integration.duration))
        undefined = np.fmax.reduce([np.ones_like(rates), spread, rates, peak])
    inside = integration.sums[Row.OUTSIDE] == 0.0  # psi' and phi' are missing
    crossed = ~inside & (integration.crossed_cylinder | (sine < 2.0 * cylinder))
    return np.asarray(np.select([inside, crossed], [angle, undefined], rates))


def rounding_error(step_sizes: StepSizes) -> Array:
    """Relative error of the states by rounding, (points,)."""
    return np.asarray(4.0 * ROUNDING * np.sqrt(step_sizes.steps))


def pair_error(
    system: System,
    method: Method,
    bound: Array,
    fine: tuple[StepSizes, Integration, Mapping[str, Array]],
    coarse: tuple[StepSizes, Integration, Mapping[str, Array]],
    cylinder: float,
) -> Array:
    """Relative error of the states and statistics of a run, measured by a second run with fewer steps, (points,).

    The difference of the final states is as many times the error of the finer as the order of the method implies. The
    statistics have no clean order: their differences are taken as they are, and count at least three tenths of what the
    error of the states implies, because two runs may agree by chance.

    bound: frequency bound, rad per time unit; fine, coarse: step sizes, integration and statistics of both
    runs; cylinder: radius of the cylinder, rad.
    """
    (fine_sizes, fine_run, fine_values), (coarse_sizes, coarse_run, coarse_values) = fine, coarse
    with np.errstate(all="ignore"):
        ratio = fine_sizes.steps / coarse_sizes.steps
        state = state_distance(system, fine_run.final_state, coarse_run.final_state, bound)
        state = np.fmax(state / np.abs(ratio**method.order - 1.0), rounding_error(fine_sizes))
        rates = [change / bound for change in differences(fine_values, coarse_values, RATES).values()]
        angles = differences(fine_values, coarse_values, ("theta_min", "theta_max")).values()
        implied = with_statistics(state, fine_sizes, bound, fine_run, fine_values, cylinder)
        about_any_axis = any_axis.change(fine_values, coarse_values, bound)
    return np.asarray(np.fmax.reduce([state, 0.3 * implied, about_any_axis, *rates, *angles]))


def differences(
    values: Mapping[str, Array], other: Mapping[str, Array], names: Iterable[str]
) -> dict[str, Array]:
    """Sizes of the differences of the statistics of two runs, by name."""
    with np.errstate(invalid="ignore"):
        return {name: np.abs(values[name] - other[name]) for name in names}


def state_distance(system: System, state: Array, other: Array, bound: Array) -> Array:
    """Largest difference of a component of two states.

    state, other: (state, points). bound: frequency bound, rad per time unit; the unit of the differences of
    angular velocities.
    """
    difference = np.abs(state - other)
    difference[[name in system.rate_states for name in system.equations.STATE]] /= bound
    return np.asarray(difference.max(0))


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
    angle = (measured["theta_max"] - measured["theta_min"]) * relative
    angle += measured["sine_max"] * np.where(bound > 0, step_sizes.rate_error / bound, 0.0)
    absolute = {
        "theta_dot_rms": step_sizes.rate_error,
        "normal_rate_std": step_sizes.rate_error,
        "psi_dot_std": near_vertical,
        "phi_dot_std": near_vertical,
    }
    errors = {name: size + relative * measured[name] for name, size in absolute.items()}
    errors |= {"psi_dot_mean": near_vertical, "phi_dot_mean": near_vertical}
    for name in any_axis.labels_in(measured):
        circle = any_axis.measurement_errors(step_sizes, bound, relative, measured, name)
        errors |= {f"{name}:{key}": error for key, error in circle.items()}
    return errors | {"theta_min": angle, "theta_max": angle, "sine_max": angle}


def _relative_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Relative error of a standard deviation: dispersion, dissipation and interpolation error."""
    interpolation = _interpolation_error(step_sizes, bound)
    return np.asarray(step_sizes.dispersion_error + step_sizes.dissipation_error + interpolation)


def _interpolation_error(step_sizes: StepSizes, bound: Array) -> Array:
    """Relative error of the motion between nodes, for an oscillation at the frequency bound."""
    with np.errstate(over="ignore"):
        return np.asarray(INTERPOLATION_ERROR * (bound * step_sizes.sample_spacing) ** 8)
