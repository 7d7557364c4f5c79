"""The end of a run in a few lines of text."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from ..runs.method_costs import method_lines
from ..scene import grid
from ..validation import half_step
from .chunks import chunks
from .metadata import flag_names, scene_of

FLAGS = ("label", "label_inertial", "status", "agreement", "computed")
# Variable -> the line with its largest value.
ERRORS = {
    "error_estimate": "relative error of states and rates, by the estimate of each point: at most {:.2g}",
    "integral_drift": "drift of first integrals: at most {:.2g}",
}
# Histogram from which the median is read: quarters of a decade from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161


def summary(ds: xr.Dataset) -> str:
    """Summary of an atlas for the end of its run.

    Parameters
    ----------
    ds : Dataset
        An atlas; it may be larger than memory.

    Returns
    -------
    str
        Lines with the counts of labels, status and agreement with theory, the largest and the median
        expected error, labels that may change at half the step, time and speed, and, where the points are those
        of a scene with a tolerance, what the other method would cost.
    """
    lines = [f"{name}: {_flag_counts(ds[name])}" for name in FLAGS if name in ds]
    for name, sentence in ERRORS.items():
        if name in ds:
            largest, median = _largest_and_median(ds[name])
            text = sentence.format(largest)
            lines.append(f"{text}, {median:.0e} at half of them" if largest > 10 * median else text)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(half_step.half_step_text(ds.attrs))
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    if (scene := scene_of(ds)) is not None:
        lines += method_lines(scene, grid.check(scene))
    return "\n".join(lines)


def _flag_counts(array: xr.DataArray) -> str:
    """Number of points with each flag that occurs."""
    names = flag_names(array)
    counts = np.zeros(len(names), np.int64)
    for box in chunks(array.sizes, array.dims):
        counts += np.bincount(array.isel(box).values.ravel(), minlength=len(names))
    return ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True) if count)


def _largest_and_median(array: xr.DataArray) -> tuple[float, float]:
    """Largest value of a non-negative variable, and its median rounded up to a quarter of a decade."""
    largest, histogram = math.nan, np.zeros(BINS, np.int64)
    for box in chunks(array.sizes, array.dims):
        values = array.isel(box).values.ravel()
        largest = float(np.fmax(largest, np.fmax.reduce(values)))
        with np.errstate(divide="ignore"):
            exponent = np.log10(values[~np.isnan(values)])
        index = np.clip(np.ceil(BINS_PER_DECADE * (exponent - LOWEST_DECADE)), 0, BINS - 1)
        histogram += np.bincount(index.astype(np.int64), minlength=BINS)
    cumulative = np.cumsum(histogram)
    median_bin = np.searchsorted(cumulative, (cumulative[-1] + 1) // 2)
    return largest, 10.0 ** (median_bin / BINS_PER_DECADE + LOWEST_DECADE)
