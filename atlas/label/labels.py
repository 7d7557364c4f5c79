"""From measurements to labels and status: what a point is called, and when it is not called anything."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..flags import Label, Status
from ..systems.base import Array, Flags, Mask

ROUNDOFF = 1e-16


def label(
    measured: Mapping[str, Array],
    rate_tolerance: float,
    cylinder_tolerance: float,
    frame_rate: Array | float = 0.0,
) -> Flags:
    """Label of each point from the measurements of `engine.measure.finish`, int8 of their shape.

    rate_tolerance: rad per time unit, absolute; cylinder_tolerance: rad; frame_rate: added to the mean
    of psi' (the rate of the orbital frame, for the label in the inertial frame). Every point gets a
    label here: `status` decides which of them may be kept.
    """
    m, tol = measured, rate_tolerance
    cylinder = in_cylinder(m, cylinder_tolerance)
    moving = m["theta_dot_rms"] > tol
    # A run that enters or leaves the cylinder has no usable psi' there: theta decides.
    entered = np.minimum(np.sin(m["theta_min"]), np.sin(m["theta_max"])) < cylinder_tolerance
    # psi' then comes from the outer sliver alone, so the rate about the vertical must be steady as well.
    swings = m["theta_max"] - m["theta_min"] > cylinder_tolerance
    crossing = entered & (swings | (m["normal_rate_std"] > tol))
    unsteady = (m["psi_dot_std"] > tol) | (m["phi_dot_std"] > tol)
    drifting = np.where(cylinder, m["normal_rate_std"] > tol, moving | crossing | unsteady)
    return steady_label(m["psi_dot_mean"] + frame_rate, m["phi_dot_mean"], cylinder, tol, drifting)


def steady_label(
    n: Array, m: Array, cylinder: Mask, tolerance: float, drifting: Mask | bool = False
) -> Flags:
    """Label of a steady motion with rates n = psi' and m = phi', zero meaning at most the tolerance."""
    still = (np.abs(n) <= tolerance) | (np.abs(m) <= tolerance)
    steady = np.where(cylinder | still, Label.PERMANENT_ROTATION, Label.REGULAR_PRECESSION)
    return np.where(drifting, Label.DRIFTING, steady).astype(np.int8)


def in_cylinder(measured: Mapping[str, Array], cylinder_tolerance: float) -> Mask:
    """Did sin theta stay below the tolerance through the run? bool."""
    return np.asarray(measured["sine_max"] < cylinder_tolerance)


def unsure(
    measured: Mapping[str, Array],
    error: Mapping[str, Array],
    rate_tolerance: float,
    cylinder_tolerance: float,
    frame_rate: Array | float = 0.0,
) -> Mask:
    """Could the label be another one, were every measurement off by as much as its error? bool.

    error: of the measurements that `label` reads, by their names and in their units; other arguments as there.
    """
    found = []
    for sign in (-1.0, 0.0, 1.0):
        moved = {name: measured[name] + sign * size for name, size in error.items()}
        moved["theta_min"] = measured["theta_min"] - sign * error["theta_min"]
        for name, rate in (("psi_dot_mean", frame_rate), ("phi_dot_mean", 0.0)):
            mean = measured[name] + rate
            size = np.maximum(np.abs(mean) + sign * error[name], 0.0)
            moved[name] = np.copysign(size, mean) - rate
        found.append(label(moved, rate_tolerance, cylinder_tolerance, frame_rate))
    return np.asarray((found[0] != found[1]) | (found[2] != found[1]))


def status(
    finite: Mask,
    integral_drift: Array,
    drift_tolerance: float,
    step_ratio: Array,
    hidden_damping: Array,
    exact_growth: Array,
    rate_tolerance: float,
    step_sensitive: Mask | bool = False,
) -> Flags:
    """Status of each computed point, the first that applies in the order of the registry, int8.

    finite: bool; step_ratio: step times frequency bound over the stability limit (at most 1/2);
    hidden_damping: relative loss of amplitude of the fastest frequency over the run (at most 0.1);
    exact_growth: growth rate times duration where the start is exactly on an unstable motion, else 0;
    step_sensitive: the label changes, or could, when the step is halved.
    """
    conditions = [
        ~finite,
        integral_drift > drift_tolerance,
        ~((step_ratio <= 0.5) & (hidden_damping <= 0.1)),
        step_sensitive,
        exact_growth > np.log(rate_tolerance / ROUNDOFF),
    ]
    values = [
        Status.NOT_FINITE,
        Status.DRIFT_EXCEEDED,
        Status.UNDER_RESOLVED,
        Status.STEP_SENSITIVE,
        Status.ROUNDOFF_DECIDED,
    ]
    return np.select(conditions, values, Status.OK).astype(np.int8)
