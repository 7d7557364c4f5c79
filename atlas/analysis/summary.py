"""Summary of a run in a few lines of text."""

from __future__ import annotations

from collections import Counter

import numpy as np
import xarray as xr

from ..runs.plan import ScenePlan
from ..runs.tiles import BINS, BINS_PER_DECADE, COUNTED, GROUPS, LOWEST_DECADE, Tally
from ..scene import grid
from ..validation import half_step
from .metadata import chunks, flag_names, scene_of


def summary(ds: xr.Dataset, tally: Tally | None = None) -> str:
    """Summary of an atlas at the end of its run, as text; without a tally all points are read."""
    tally = tally or _tally(ds)
    lines = [f"{name}: {_flag_counts(ds[name], tally)}" for name in COUNTED if name in ds]
    scene = scene_of(ds)
    sample = None if scene is None else grid.check(scene)
    if scene is not None and sample is not None:
        lines += grid.not_computed(scene, sample)
    lines += _error_lines(ds, tally)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(half_step.half_step_text(ds.attrs))
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    if scene is not None and sample is not None:
        lines += ScenePlan(scene, sample).method_lines()
    return "\n".join(lines)


def _tally(ds: xr.Dataset) -> Tally:
    """Tally of all points of an atlas, read once."""
    names = [name for name in (*COUNTED, "error_estimate", "integral_drift") if name in ds]
    total = Tally()
    for box in chunks(ds[names[0]].sizes, ds[names[0]].dims) if names else ():
        part = ds[names].isel(box).load()
        total.add(Tally.of({name: part[name].transpose(*ds[names[0]].dims).values for name in names}))
    return total


def _flag_counts(array: xr.DataArray, tally: Tally) -> str:
    """Number of points with each flag that occurs."""
    counts = tally.counts.get(str(array.name), Counter())
    named = ((name, counts.get(str(flag), 0)) for flag, name in enumerate(flag_names(array)))
    return ", ".join(f"{name} {count}" for name, count in named if count)


def _error_lines(ds: xr.Dataset, tally: Tally) -> list[str]:
    """The median and the largest expected error, of steady and of drifting points, and the largest drift."""
    lines = []
    if "error_estimate" in ds and "label" in ds:
        parts, remark = [], ""
        for name in GROUPS:
            if name not in tally.largest:
                continue
            largest = tally.largest[name]
            parts.append(f"at {name} points {_median(tally, name):.0e} (median) to {largest:.2g} (largest)")
            if largest > 1:
                remark = "; above 1 an instability has amplified errors until the final state is unknown; the labels have checks of their own"
        if parts:
            lines.append(
                f"expected relative error of the motion (error_estimate): {', '.join(parts)}{remark}"
            )
    if "integral_drift" in tally.largest:
        largest = tally.largest["integral_drift"]
        lines.append(f"largest relative change of a first integral (integral_drift): {largest:.2g}")
    return lines


def _median(tally: Tally, group: str) -> float:
    """Median error of a group of points, up to a quarter of a decade."""
    cumulative = np.cumsum([tally.counts[group].get(str(index), 0) for index in range(BINS)])
    median_bin = int(np.searchsorted(cumulative, (cumulative[-1] + 1) // 2))
    return min(10.0 ** (median_bin / BINS_PER_DECADE + LOWEST_DECADE), tally.largest[group])
