"""Points whose error is measured by a second run, as `check_half_step` of a scene asks for."""

from __future__ import annotations

import numpy as np

from ..engine.ensemble import Ensemble
from ..systems.base import Mask

# check_half_step = "sample" measures the error of one point in so many.
POINTS_PER_HALF_STEP = 64


def half_step_sample(ensemble: Ensemble, which: str) -> Mask:
    """Points whose error is measured: none, all, or one in POINTS_PER_HALF_STEP, by a hash of the point."""
    if which != "sample":
        return np.full(ensemble.size, which == "all")
    mixed = np.zeros(ensemble.size, np.uint64)
    for bits in np.concatenate([ensemble.state, ensemble.constants]).view(np.uint64):
        mixed = (mixed ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return np.asarray(mixed % np.uint64(POINTS_PER_HALF_STEP) == 0)
