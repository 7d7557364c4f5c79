"""Check of a scene's labels and rates in a sample of points that is integrated again at half the step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..flags import LABELS, Label
from ..kernel.blocks import ALL_THREADS, Threads
from ..kernel.statistics import RATES
from ..scene import grid
from ..scene.draws import mixed
from ..scene.model import Scene
from ..systems.base import subset
from .pipeline import evaluate
from .plan import Plan

CONFIDENCE = 0.95
# The sample has one point in POINTS_PER_SAMPLE (about 1 % of the cost of a run), but at least MIN_SAMPLE and at most MAX_SAMPLE points.
MIN_SAMPLE, MAX_SAMPLE, POINTS_PER_SAMPLE = 64, 1000, 300


def upper_bound(events: int, draws: int, population: int | None = None) -> float:
    """Return the upper 95 % confidence bound of a probability, or the observed fraction if the whole population is drawn.

    See C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404-413.
    """
    if draws == population:
        return events / draws
    if events >= draws:
        return 1.0
    if events == 0:
        return -math.expm1(math.log1p(-CONFIDENCE) / draws)
    from scipy.special import betaincinv  # slow to import, and most runs do not need it

    return float(betaincinv(events + 1, draws - events, CONFIDENCE))


def stratified_indices(size: int, count: int) -> np.ndarray:
    """Return ascending pseudorandom indices, one from each of `count` equal parts of range(size)."""
    count = min(size, count)
    fraction = (mixed(np.arange(count, dtype=np.uint64)) >> np.uint64(11)).astype(np.float64) / 2.0**53
    edges = [i * size // count for i in range(count + 1)]
    first, width = np.array(edges[:-1]), np.diff(edges)
    return np.asarray(first + np.minimum((fraction * width).astype(np.int64), width - 1), np.int64)


def half_step_sample(
    scene: Scene, plan: Plan | None = None, *, threads: Threads = ALL_THREADS
) -> dict[str, Any]:
    """Return attributes that compare a sample of points at the scene's step and at half the step. See docs/accuracy.md."""
    indices = stratified_indices(
        scene.size, min(max(MIN_SAMPLE, scene.size // POINTS_PER_SAMPLE), MAX_SAMPLE)
    )
    plan = (plan or Plan.of(scene)).without_derived()
    # One call makes both runs of each point, because theory takes as long for one point as for a few.
    both = grid.points_at_indices(scene, np.tile(indices, 2))
    columns = evaluate(plan, both, halved=np.repeat([False, True], indices.size), threads=threads)
    first, second = slice(indices.size), slice(indices.size, None)
    part, full, half = both.subset(first), subset(columns, first), subset(columns, second)
    # A point has changed if it has a label at the full step, and another label or no label at half the step.
    changed = np.zeros(indices.size, bool)
    for name in LABELS:
        if name in full:
            labelled = (full[name] != Label.NOT_COMPUTED) & (full[name] != Label.UNRESOLVED)
            changed |= labelled & (half[name] != full[name])
    bound = upper_bound(int(changed.sum()), indices.size, scene.size)
    attributes: dict[str, Any] = {
        "atlas_half_step_points": indices.size,
        "atlas_half_step_changed": int(changed.sum()),
        "atlas_labels_may_change": math.ceil(bound * scene.size - 1e-9),
        "atlas_points": scene.size,
    }
    compared = [np.abs(half[name] - full[name]) for name in RATES if name in scene.outputs]
    change = np.fmax.reduce([np.full(indices.size, np.nan), *compared])
    if np.isfinite(change).any():
        attributes["atlas_half_step_median"] = float(np.nanmedian(change))
        if "error_estimate" in scene.outputs:
            with np.errstate(all="ignore"):
                beyond = change > full["error_estimate"] * scene.system.frequency_bound(part.points)
            attributes["atlas_half_step_beyond"] = int(beyond.sum())
    unsteady = (full["label"] == Label.DRIFTING) | (full["label"] == Label.UNRESOLVED)
    steady_change = change[part.exists & ~changed & ~unsteady]
    if np.isfinite(steady_change).any():
        attributes["atlas_half_step_difference"] = float(np.nanmax(steady_change))
    return attributes


def half_step_text(attributes: Mapping[str, Any], *, verbose: bool = True) -> str:
    """Return one line of text about the attributes from `half_step_sample`."""
    a = attributes
    text = (
        f"{a['atlas_half_step_changed']} of {a['atlas_half_step_points']} points checked at half the step changed"
        f" their label; with {100 * CONFIDENCE:g} % confidence at most {a['atlas_labels_may_change']} of all"
        f" {a['atlas_points']} would"
    )
    if not verbose:
        return text
    if "atlas_half_step_median" in a:
        text += f"; largest change of a mean, rms or standard deviation of the rates: {a['atlas_half_step_median']:.2g} (median of all points)"
    if "atlas_half_step_difference" in a:
        text += f", {a['atlas_half_step_difference']:.2g} (largest at steady points)"
    if a.get("atlas_half_step_beyond"):
        text += f"; {a['atlas_half_step_beyond']} points changed by more than their error_estimate"
    return text
