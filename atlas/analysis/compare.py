"""The comparison of an atlas with theory in plain text."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.ndimage import maximum_filter, minimum_filter

from ..flags import Agreement, Label, Stability
from ..label.theory import agreement
from ..systems.base import Array, Flags

# Near the analytical boundary growth is slow and stable motions swing wide: a share of the axis range.
BAND = 0.02
# An unstable motion nudged by 1e-4 and watched with a tolerance of 1e-3 may survive growth by e^12.
NO_TIME_TO_GROW = 12.0


def confusion(label: Array, predicted: Array) -> np.ndarray:
    """Counts [predicted, measured] over the values of Label, int64 of shape (5, 5)."""
    size = len(Label)
    return np.bincount(
        np.ravel(predicted).astype(np.int64) * size + np.ravel(label), minlength=size * size
    ).reshape(size, size)


def report(ds: xr.Dataset, worst: int = 5) -> str:
    """The comparison of an atlas with theory in plain text: confusion table, survivors, worst points.

    Needs the variables label and predicted; uses stable, growth_rate, end_time and the rates if there.
    """
    table = confusion(ds["label"].values, ds["predicted"].values)
    names = list(Label.meanings())
    used = [i for i in range(len(names)) if table[i].any() or table[:, i].any()]
    width = max(len(names[i]) for i in used) + 2
    lines = ["theory \\ measured".ljust(width + 4) + "".join(names[i].rjust(width) for i in used)]
    lines += [
        names[i].ljust(width + 4) + "".join(f"{table[i, j]:{width}d}" for j in used)
        for i in used
        if table[i].any()
    ]
    agree = agreement(ds["label"].values, ds["predicted"].values)
    counts = np.bincount(agree.ravel(), minlength=len(Agreement))
    compared = counts[1:].sum()
    share = f"{100 * counts[1] / compared:.3f} %" if compared else "nothing"
    lines.append(f"compared: {compared} of {agree.size} points, {share} agree")
    lines += [f"  {name}: {n}" for name, n in zip(Agreement.meanings(), counts, strict=True) if n]
    if {"stable", "growth_rate", "end_time"} <= set(ds):
        lines += _survival(ds)
    lines += _worst(ds, agree, worst)
    return "\n".join(lines)


def _survival(ds: xr.Dataset) -> list[str]:
    """Stable points that drift and unstable ones that survive, near the boundary and away from it."""
    label, stable = ds["label"].values, ds["stable"].values
    grown = ds["growth_rate"].values * ds["end_time"].values
    near = near_boundary(stable)
    drift = (stable == Stability.STABLE) & (label == Label.DRIFTING)
    survive = (stable == Stability.UNSTABLE) & (
        (label == Label.REGULAR_PRECESSION) | (label == Label.PERMANENT_ROTATION)
    )
    lines = []
    for what, found in (("stable points that drift", drift), ("unstable points that survive", survive)):
        lines.append(
            f"linearly {what}: {found.sum()}, of these {(found & ~near).sum()} outside a band of"
            f" {100 * BAND:g} % of the axis range around the analytical boundary"
        )
    if survive.any():
        lines.append(
            f"  survivors with growth_rate x duration < {NO_TIME_TO_GROW:g} (no time to grow):"
            f" {(survive & (grown < NO_TIME_TO_GROW)).sum()} of {survive.sum()};"
            f" largest growth_rate x duration: {grown[survive].max():.2f}"
        )
    return lines


def near_boundary(stable: Flags) -> np.ndarray:
    """Points within BAND of the axis range of a change of linear stability, bool, on a grid of any rank.

    Nothing is near on a list of points, which has neighbours only by chance.
    """
    reach = [1 + 2 * max(1, int(np.ceil(BAND * (count - 1)))) if count > 1 else 1 for count in stable.shape]
    return np.asarray(maximum_filter(stable, reach) != minimum_filter(stable, reach))


def _worst(ds: xr.Dataset, agree: np.ndarray, count: int) -> list[str]:
    bad = np.flatnonzero(agree.ravel() >= 2)
    if not bad.size or not count:
        return []
    unsteady = np.zeros(agree.size)
    for name in ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std"):
        if name in ds:
            unsteady = np.fmax(unsteady, ds[name].transpose(*ds["label"].dims).values.ravel())
    # The clearest contradictions: strongest measured drift where theory is steady, least where it drifts.
    theory_steady = agree.ravel()[bad] == 2
    order = np.argsort(np.where(theory_steady, -unsteady[bad], unsteady[bad]), kind="stable")[:count]
    lines = ["worst disagreements (unsteadiness = largest rms or std of the rates):"]
    for flat in bad[order]:
        index = np.unravel_index(flat, agree.shape)
        place = dict(zip(ds["label"].dims, index, strict=True))
        at = ds.isel(place)
        where = ", ".join(f"{dim} = {float(at[dim]):.9g}" for dim in place if dim in at.coords)
        said, seen = list(Label.meanings())[int(at["predicted"])], list(Label.meanings())[int(at["label"])]
        growth = f", growth_rate x time = {float(at['growth_rate'] * at['end_time']):.2f}" if (
            {"growth_rate", "end_time"} <= set(ds)) else ""  # fmt: skip
        lines.append(f"  {where}: theory {said}, measured {seen}, unsteadiness {unsteady[flat]:.3g}{growth}")
    return lines
