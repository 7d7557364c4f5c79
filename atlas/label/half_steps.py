"""Points whose error is measured by a second run: as `check_half_step` of a scene asks for, or without a proved bound."""

from __future__ import annotations

import numpy as np

from ..engine.ensemble import Ensemble
from ..engine.stepsize import StepSizes
from ..engine.tableaux import Method
from ..systems.base import Mask, System

# check_half_step = "sample" measures the error of one point in so many.
POINTS_PER_HALF_STEP = 64


def measured_points(system: System, ensemble: Ensemble, which: str) -> Mask:
    """Points whose error is measured: none, all, or one in POINTS_PER_HALF_STEP, by a hash of the point.

    What a numeric bound has not seen the expected error cannot contain: then all points are measured.
    """
    if which != "sample" or system.has_numeric_bound:
        return np.full(ensemble.size, which == "all" or system.has_numeric_bound)
    mixed = np.zeros(ensemble.size, np.uint64)
    for bits in np.concatenate([ensemble.state, ensemble.constants]).view(np.uint64):
        mixed = (mixed ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return np.asarray(mixed % np.uint64(POINTS_PER_HALF_STEP) == 0)


def second_steps(system: System, step_sizes: StepSizes, method: Method) -> StepSizes:
    """Fewer steps, by which the error is measured."""
    return step_sizes.incommensurate(method) if system.has_numeric_bound else step_sizes.coarsened(method)
