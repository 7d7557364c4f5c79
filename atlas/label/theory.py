"""Labels predicted by theory, and their agreement with the measured ones."""

from __future__ import annotations

import numpy as np

from ..flags import Label, Stability
from ..systems.base import Flags, Points, System
from .labels import steady_label

# A start whose sin theta is below this is on the vertical: np.pi itself has sin 1.2e-16.
ON_VERTICAL = 1e-12
# Beyond this (moments of inertia: below its inverse, too) products and quotients of parameters overflow and
# residuals mean nothing: theory is silent.
LARGEST = 1e60


def predict(system: System, points: Points, rate_tolerance: float, nudged: bool) -> dict[str, np.ndarray]:
    """family, stable, growth_rate, predicted and, where the system's frame turns, predicted_inertial.

    points: the starts before any nudge. Exact start: the label of the family's motion; nudged: that
    label if the motion is linearly stable, drifting if unstable, 0 if unknown. Off every family:
    drifting once the system's catalogue is complete, else 0.
    """
    within = np.all([~(np.abs(values) > LARGEST) for values in points.values()], axis=0)
    within &= np.all([points[name] >= 1 / LARGEST for name in ("A", "B", "C")], axis=0)
    family = np.where(within, system.identify_family(points)[0], 0).astype(np.int8)
    stable, growth = system.linear_stability(points, family)
    sine, n, m = system.steady_rates(points)
    result: dict[str, np.ndarray] = {"family": family, "stable": stable, "growth_rate": growth}
    frames = {"predicted": n}
    if system.frame_rate is not None:
        frames["predicted_inertial"] = n + system.frame_rate(points)
    for name, rate in frames.items():
        label = steady_label(rate, m, np.abs(sine) < ON_VERTICAL, rate_tolerance)
        if nudged:
            label = np.select(
                [stable == Stability.STABLE, stable == Stability.UNSTABLE],
                [label, Label.DRIFTING],
                Label.NOT_COMPUTED,
            )
        off = np.where(system.complete(points) & within, Label.DRIFTING, Label.NOT_COMPUTED)
        result[name] = np.where(family > 0, label, off).astype(np.int8)
    return result


def agreement(label: Flags, predicted: Flags) -> Flags:
    """Value of Agreement for each point, int8."""
    silent = (predicted == Label.NOT_COMPUTED) | (label == Label.NOT_COMPUTED) | (label == Label.UNRESOLVED)
    kinds = [silent, label == predicted, label == Label.DRIFTING, predicted == Label.DRIFTING]
    return np.select(kinds, [0, 1, 2, 3], 4).astype(np.int8)
