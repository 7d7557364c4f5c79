"""Summary of a run in a few lines of text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..flags import Label
from ..runs.method_costs import method_lines
from ..scene import grid
from ..validation import half_step
from .chunks import chunks
from .metadata import flag_names, scene_of

FLAGS = (
    "label", "label_inertial", "label_any_axis", "label_any_axis_inertial", "status", "agreement", "computed",
)  # fmt: skip
# Groups of points whose expected errors are printed apart: drifting motions amplify errors, steady ones do not.
GROUPS = {
    "steady": (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION),
    "drifting": (Label.DRIFTING,),
}
# Histogram from which the median is read: quarters of a decade from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161


def summary(ds: xr.Dataset) -> str:
    """Summary of an atlas, printed at the end of its run.

    Parameters
    ----------
    ds : Dataset
        An atlas; it may be larger than memory.

    Returns
    -------
    str
        Lines with the counts of labels, status and agreement with theory, the number of points that are not
        computed and why, the median and the largest expected error, labels that may change at half the step, time
        and speed, and, where the points are those of a scene with a tolerance, what the other method would cost.
    """
    lines = [f"{name}: {_flag_counts(ds[name])}" for name in FLAGS if name in ds]
    scene = scene_of(ds)
    sample = None if scene is None else grid.check(scene)
    if scene is not None and sample is not None:
        lines += grid.not_computed(scene, sample)
    lines += _error_lines(ds)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(half_step.half_step_text(ds.attrs))
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    if scene is not None and sample is not None:
        lines += method_lines(scene, sample)
    return "\n".join(lines)


def _flag_counts(array: xr.DataArray) -> str:
    """Number of points with each flag that occurs."""
    names = flag_names(array)
    counts = np.zeros(len(names), np.int64)
    for box in chunks(array.sizes, array.dims):
        counts += np.bincount(array.isel(box).values.ravel(), minlength=len(names))
    return ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True) if count)


def _error_lines(ds: xr.Dataset) -> list[str]:
    """The median and the largest expected error, of steady and of drifting points, and the largest drift."""
    lines = []
    if "error_estimate" in ds and "label" in ds:
        parts, remark = [], ""
        for name, labels in GROUPS.items():
            largest, median = _largest_and_median(ds.error_estimate, ds.label, labels)
            if not math.isnan(largest):
                parts.append(f"at {name} points {median:.0e} (median) to {largest:.2g} (largest)")
            if largest > 1:
                remark = "; above 1 an instability has amplified errors until the final state is unknown; the labels have checks of their own"
        if parts:
            lines.append(
                f"expected relative error of the motion (error_estimate): {', '.join(parts)}{remark}"
            )
    if "integral_drift" in ds:
        drift = ds.integral_drift
        largest = max(np.nanmax(drift.isel(box), initial=0.0) for box in chunks(drift.sizes, drift.dims))
        lines.append(f"largest relative change of a first integral (integral_drift): {largest:.2g}")
    return lines


def _largest_and_median(
    array: xr.DataArray, label: xr.DataArray, labels: Sequence[Label]
) -> tuple[float, float]:
    """Largest value where the label is one of some, nan if it nowhere is, and the median up to a quarter of a decade."""
    largest, histogram = math.nan, np.zeros(BINS, np.int64)
    for box in chunks(array.sizes, array.dims):
        values = array.isel(box).values[np.isin(label.isel(box).transpose(*array.dims).values, labels)]
        values = values[~np.isnan(values)]
        largest = float(np.fmax(largest, values.max())) if values.size else largest
        with np.errstate(divide="ignore"):
            exponent = np.log10(values)
        index = np.clip(np.ceil(BINS_PER_DECADE * (exponent - LOWEST_DECADE)), 0, BINS - 1)
        histogram += np.bincount(index.astype(np.int64), minlength=BINS)
    cumulative = np.cumsum(histogram)
    median_bin = np.searchsorted(cumulative, (cumulative[-1] + 1) // 2)
    return largest, min(10.0 ** (median_bin / BINS_PER_DECADE + LOWEST_DECADE), largest)
