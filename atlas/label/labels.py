"""From measurements to labels and status."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..flags import Label, Status
from ..scene.model import Tolerances
from ..systems.base import Array, Flags, Mask

# Relative rounding error of an initial state: an unstable motion amplifies it.
ROUNDOFF = 1e-16
# The conditions of a steady motion are satisfied as well as rounding allows where their residual is at most this: of a
# larger distance from the motion, rounding errors change less than a hundredth.
ROUNDING_RESIDUAL = 1e-13
# The measurements from which a label is decided.
LABEL_STATISTICS = (
    "theta_dot_rms", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std", "normal_rate_std",
    "theta_min", "theta_max", "sine_max",
)  # fmt: skip


def label(measured: Mapping[str, Array], tolerances: Tolerances, frame_rate: Array | float = 0.0) -> Flags:
    """Label of each point, whatever its status.

    measured: LABEL_STATISTICS as `engine.statistics.finish` returns them, all of one shape. frame_rate: added
    to the mean of psi', rad per time unit: the rate of the orbital frame, for the label in the inertial
    frame. Returns values of `flags.Label`.
    """
    rate = tolerances.rate
    cylinder = in_cylinder(measured, tolerances.angle)
    nutates = measured["theta_dot_rms"] > rate
    # A run that enters or leaves the cylinder has no usable psi' there: theta decides.
    entered = np.minimum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"])) < tolerances.angle
    # psi' is then measured on a small part of the run, so the rate about the vertical must be steady as well.
    swings = measured["theta_max"] - measured["theta_min"] > tolerances.angle
    crossing = entered & (swings | (measured["normal_rate_std"] > rate))
    unsteady = (measured["psi_dot_std"] > rate) | (measured["phi_dot_std"] > rate)
    drifting = np.where(cylinder, measured["normal_rate_std"] > rate, nutates | crossing | unsteady)
    return steady_label(
        measured["psi_dot_mean"] + frame_rate, measured["phi_dot_mean"], cylinder, rate, drifting
    )


def steady_label(
    n: Array, m: Array, cylinder: Mask, tolerance: float, drifting: Mask | bool = False
) -> Flags:
    """Label of a steady motion with rates n = psi' and m = phi'; rates of at most the tolerance count as zero."""
    zero_rate = (np.abs(n) <= tolerance) | (np.abs(m) <= tolerance)
    steady = np.where(cylinder | zero_rate, Label.PERMANENT_ROTATION, Label.REGULAR_PRECESSION)
    return np.where(drifting, Label.DRIFTING, steady).astype(np.int8)


def in_cylinder(measured: Mapping[str, Array], cylinder_tolerance: float) -> Mask:
    """Whether sin theta stayed below the tolerance (rad) through the run."""
    return np.asarray(measured["sine_max"] < cylinder_tolerance)


def unsure(
    measured: Mapping[str, Array],
    error: Mapping[str, Array],
    tolerances: Tolerances,
    frame_rate: Array | float = 0.0,
) -> Mask:
    """Whether the label could be another one, were every measurement off by as much as its error.

    measured, tolerances, frame_rate: as for `label`; error: errors of the measurements that `label` reads, by
    their names and in their units.
    """
    labels = []
    for sign in (-1.0, 0.0, 1.0):
        moved = {name: measured[name] + sign * size for name, size in error.items()}
        moved["theta_min"] = measured["theta_min"] - sign * error["theta_min"]
        for name, rate in (("psi_dot_mean", frame_rate), ("phi_dot_mean", 0.0)):
            mean = measured[name] + rate
            size = np.maximum(np.abs(mean) + sign * error[name], 0.0)
            moved[name] = np.copysign(size, mean) - rate
        labels.append(label(moved, tolerances, frame_rate))
    lower, central, upper = labels
    return np.asarray((lower != central) | (upper != central))


def rounding_limit(residual: Array, frequency_bound: Array, tolerances: Tolerances) -> Array:
    """Growth, as a logarithm, by which rounding errors reach a tolerance, (points,).

    Rounding errors of rates are relative to the frequency bound, those of angles to 1.

    residual: residual of the conditions of the steady motion at the start, dimensionless; frequency_bound: in
    rad per time unit.
    """
    tolerance = np.minimum(tolerances.rate / frequency_bound, tolerances.angle)
    return np.asarray(np.log(tolerance / np.fmax(residual, ROUNDOFF)))


def status(
    finite: Mask,
    integral_drift: Array,
    drift_tolerance: float,
    resolved: Mask,
    rounding_growth: Array,
    rounding_limit: Array | float,
    step_sensitive: Mask | bool = False,
) -> Flags:
    """Status of each computed point: the first that applies, in the order of `flags.Status`.

    finite: whether state and statistics are finite; integral_drift: largest relative change of a first
    integral, at most drift_tolerance. resolved: whether the steps are short enough for the frequency bound;
    see `engine.stepsize.StepSizes.resolved`. rounding_growth: growth rate times duration where the start is
    on an unstable motion to rounding, else 0; rounding_limit: as the function of that name returns it;
    step_sensitive: whether the label changes, or could, when the step is halved. Returns values of
    `flags.Status`.
    """
    conditions = {
        Status.NOT_FINITE: ~finite,
        Status.DRIFT_EXCEEDED: integral_drift > drift_tolerance,
        Status.UNDER_RESOLVED: ~resolved,
        Status.STEP_SENSITIVE: step_sensitive,
        Status.ROUNDOFF_DECIDED: (rounding_growth > 0) & (rounding_growth > rounding_limit),
    }
    return np.select(list(conditions.values()), list(conditions), Status.OK).astype(np.int8)
