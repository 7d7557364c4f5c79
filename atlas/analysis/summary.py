"""The end of a run in a few lines of text."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from ..runs.tiling import Tiling
from ..validation import half_step

# Points read at a time where a whole atlas is gone through.
CHUNK = 4_000_000


def summary(ds: xr.Dataset) -> str:
    """Counts of labels and status, agreement with theory, expected error, time and speed, as text."""
    flags = [name for name in ("label", "label_inertial", "status", "agreement", "computed") if name in ds]
    largest = {
        "error_estimate": "relative error of states and rates, by the estimate of each point: at most {:.2g}",
        "integral_drift": "drift of first integrals: at most {:.2g}",
    }
    # Quarters of a decade from 1e-20 on: enough to tell the median without keeping every point.
    quarters = {name: np.zeros(161, np.int64) for name in largest if name in ds}
    meanings = {name: ds[name].attrs["flag_meanings"].split() for name in flags}
    counts = {name: np.zeros(len(meanings[name]), np.int64) for name in flags}
    most = {name: math.nan for name in largest if name in ds}
    cut = Tiling.of(tuple(ds.sizes.values()), CHUNK)
    for slab in range(cut.count):
        part = ds[[*flags, *most]].isel(dict(zip(ds.sizes, cut.place(slab), strict=True)))
        for name in flags:
            counts[name] += np.bincount(part[name].values.ravel(), minlength=len(meanings[name]))
        for name in most:
            values = part[name].values.ravel()
            most[name] = float(np.fmax(most[name], np.fmax.reduce(values)))
            with np.errstate(divide="ignore", invalid="ignore"):
                place = np.ceil(4 * (np.log10(values[~np.isnan(values)]) + 20))
            quarters[name] += np.bincount(np.clip(place, 0, 160).astype(np.int64), minlength=161)
    lines = []
    for name in flags:
        shown = ", ".join(f"{m} {n}" for m, n in zip(meanings[name], counts[name], strict=True) if n)
        lines.append(f"{name}: {shown}")
    for name, value in most.items():
        total = np.cumsum(quarters[name])
        half = 10.0 ** (np.searchsorted(total, (total[-1] + 1) // 2) / 4 - 20)
        text = largest[name].format(value)
        lines.append(f"{text}, {min(half, value):.0e} at half of them" if value > 10 * half else text)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(half_step.half_step_text(ds.attrs))
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    return "\n".join(lines)
