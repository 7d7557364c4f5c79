"""Points of a run integrated again at half the step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import beta

from ..flags import Label
from ..label.pipeline import RATES, evaluate_tile
from ..scene import grid
from ..scene.model import Scene

CONFIDENCE = 0.95
# Half-step sample: at least and at most so many points, and one in so many between (1 % of the cost).
MIN_SAMPLE, MAX_SAMPLE, POINTS_PER_SAMPLE = 64, 1000, 300


def upper_bound(found: int, of: int, size: int | None = None) -> float:
    """Share that `found` of `of` random draws bound from above at 95 % (Clopper and Pearson), 0 to 1.

    size: how many there are to draw from; if all were drawn, the share itself.
    """
    if of == size:
        return found / of
    return 1.0 if found >= of else float(beta.ppf(CONFIDENCE, found + 1, of - found))


def stratified_indices(size: int, count: int) -> np.ndarray:
    """One flat index from each of `count` equal parts of range(size), int64: the same for the same size.

    The place in each part is a hash of the part's number, so that no period of the grid is met.
    """
    count = min(size, count)
    part = np.arange(count, dtype=np.uint64)
    mixed = (part + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    place = ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) / 2.0**53
    edges = [i * size // count for i in range(count + 1)]
    first, width = np.array(edges[:-1]), np.diff(edges)
    return np.asarray(first + np.minimum((place * width).astype(np.int64), width - 1), np.int64)


# Half-step sample of a run.


def half_step_sample(scene: Scene, *, threads: int | None = None) -> dict[str, Any]:
    """Integrate some of a scene's points at the scene's step and at half of it: what does it change?

    The points depend on the scene's size alone and cost about 1 % of a run; the engine gives them the
    same bits as the run. Returns attributes for the atlas: the number of points tried and how many have
    another label at half the step (a label given becomes another, or none); the bound "at most this
    many points of the atlas" at 95 % (all points tried: exactly); and, where the scene keeps means and
    spreads of the rates, the largest change of one at each point, rad per time unit: the median over all
    points, the largest where the point does not drift, and, where it keeps error_estimate, at how many
    points the change is more than that says.
    """
    indices = stratified_indices(
        scene.size, min(max(MIN_SAMPLE, scene.size // POINTS_PER_SAMPLE), MAX_SAMPLE)
    )
    part = grid.points_at_indices(scene, indices)
    scene = replace(scene, outputs=tuple(name for name in scene.outputs if name not in scene.system.derived))
    own, again = (evaluate_tile(scene, part, halved=halved, threads=threads) for halved in (False, True))
    changed, drifting = np.zeros(indices.size, bool), own["label"] == Label.DRIFTING
    for name in ("label", "label_inertial"):
        if name in own:
            given = (own[name] != Label.NOT_COMPUTED) & (own[name] != Label.UNRESOLVED)
            changed |= given & (again[name] != own[name])
    found = int(changed.sum())
    values: dict[str, Any] = {
        "atlas_half_step_points": indices.size,
        "atlas_half_step_changed": found,
        "atlas_labels_may_change": math.ceil(
            upper_bound(found, indices.size, scene.size) * scene.size - 1e-9
        ),
        "atlas_points": scene.size,
    }
    kept = [np.abs(again[name] - own[name]) for name in RATES if name in scene.outputs]
    change = np.fmax.reduce([np.full(indices.size, np.nan), *kept])
    if np.isfinite(change).any():
        values["atlas_half_step_median"] = float(np.nanmedian(change))
        if "error_estimate" in scene.outputs:
            with np.errstate(all="ignore"):
                bound = scene.system.frequency_bound(part.points)
            values["atlas_half_step_beyond"] = int((change > own["error_estimate"] * bound).sum())
    # The rates of a drifting point may be those of a chaotic motion or a spike near the vertical.
    steady = change[part.there & ~changed & ~drifting & (own["label"] != Label.UNRESOLVED)]
    if np.isfinite(steady).any():
        values["atlas_half_step_difference"] = float(np.nanmax(steady))
    return values


def half_step_text(attributes: Mapping[str, Any]) -> str:
    """The line for the end of a run from the attributes that half_step_sample gave."""
    a = attributes
    text = (
        f"labels that may be wrong: at most {a['atlas_labels_may_change']} of {a['atlas_points']}"
        f" ({100 * CONFIDENCE:g} %); {a['atlas_half_step_changed']} of {a['atlas_half_step_points']}"
        " changed at half the step"
    )
    if "atlas_half_step_median" in a:
        text += f", means and spreads by {a['atlas_half_step_median']:.2g} (median)"
    if "atlas_half_step_difference" in a:
        text += f", those of steady points by at most {a['atlas_half_step_difference']:.2g}"
    if a.get("atlas_half_step_beyond"):
        text += f"; {a['atlas_half_step_beyond']} changed by more than their estimate"
    return text
