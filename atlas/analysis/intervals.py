"""Confidence intervals of probabilities."""

from __future__ import annotations

import numpy as np

from ..systems.base import Array


def wilson_interval(events: Array, draws: Array | int, confidence: float = 0.95) -> tuple[Array, Array]:
    """Lower and upper limit of a probability of which `events` of `draws` independent trials are an estimate.

    E. B. Wilson, Journal of the American Statistical Association 22 (1927) 209-212; nan without trials.
    """
    from scipy.special import ndtri  # slow to import, and most questions do not need it

    z = float(ndtri(0.5 + 0.5 * confidence))
    with np.errstate(invalid="ignore", divide="ignore"):
        share, width = np.divide(events, draws), np.divide(z * z, draws)
        middle = (share + 0.5 * width) / (1.0 + width)
        half = np.sqrt(width * (share * (1.0 - share) + 0.25 * width)) / (1.0 + width)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
