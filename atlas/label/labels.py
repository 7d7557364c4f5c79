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
    """Growth, as a logarithm, by which rounding errors reach a tolerance, by the residual of a steady start.

    Rounding errors of rates are relative to the frequency bound, errors of angles to 1.
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

    rounding_growth is growth rate times duration where the start is on an unstable motion to rounding, else
    0; step_sensitive: whether the label changes, or could, when the step is halved.
    """
    conditions = {
        Status.NOT_FINITE: ~finite,
        Status.DRIFT_EXCEEDED: integral_drift > drift_tolerance,
        Status.UNDER_RESOLVED: ~resolved,
        Status.STEP_SENSITIVE: step_sensitive,
        Status.ROUNDOFF_DECIDED: (rounding_growth > 0) & (rounding_growth > rounding_limit),
    }
    return np.select(list(conditions.values()), list(conditions), Status.OK).astype(np.int8)
