"""The status of a run: how far its labels can be trusted."""

from __future__ import annotations

import numpy as np

from ..flags import Status
from ..measure.instrument import Tolerances
from ..systems.base import Array, Flags, Mask

# Relative rounding error of an initial state: an unstable motion amplifies it.
ROUNDOFF = 1e-16
# The conditions of a steady motion are satisfied as well as rounding allows where their residual is at most this: of a
# larger distance from the motion, rounding errors change less than a hundredth.
ROUNDING_RESIDUAL = 1e-13


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
