"""Summary of an atlas in plain text, printed at the end of its run."""

from __future__ import annotations

from collections import Counter

import numpy as np
import xarray as xr

from ..flags import Label
from ..label import half_step
from ..runs.plan import ScenePlan
from ..scene import grid
from ..store.tally import BINS, BINS_PER_DECADE, COUNTED, GROUPS, LOWEST_DECADE, Tally
from ..systems.base import families_of, on_family
from .metadata import chunks, flag_names, number_attribute, scene_of, system_of, without_run

MAX_NEAREST = 10_000  # largest number of drifting points that are compared with families
# What an error estimate above 1 means for these two groups of points in `Tally.largest`.
_UNKNOWN = {
    "unstable": "an instability has amplified errors until the final state is unknown",
    "others": "the final state or a statistic, such as psi' of an axis that passes through the vertical, is unknown",
}


def summary(ds: xr.Dataset, tally: Tally | None = None, *, verbose: bool = True) -> str:
    """Return the summary of an atlas as text. Without a tally, all points are read."""
    names = [name for name in (*COUNTED, "error_estimate", "integral_drift", "stable") if name in ds]
    if tally is None:
        tally = Tally()
        for box in chunks(ds[names[0]].sizes, ds[names[0]].dims) if names else ():
            part = ds[names].isel(box).load()
            columns = {name: part[name].transpose(*ds[names[0]].dims).values for name in names}
            tally.add(**vars(Tally.of(columns)))
    counts: dict[str, dict[str, int]] = {}
    for name in (name for name in COUNTED if name in ds):
        tallied = tally.counts.get(name, Counter())
        flags = enumerate(flag_names(ds[name]))
        counts[name] = {flag: n for value, flag in flags if (n := tallied.get(str(value), 0))}

    def counts_text(name: str, *without: str) -> str:
        return ", ".join(f"{flag} {n}" for flag, n in counts.get(name, {}).items() if flag not in without)

    shown = [name for name in counts if verbose or name not in ("status", "agreement", "computed")]
    lines = [f"{name}: {counts_text(name)}" for name in shown]
    if not verbose:
        agreement = counts.get("agreement", {})
        if compared := sum(agreement.values()) - agreement.get("not_compared", 0):
            share = 100 * agreement.get("agree", 0) / compared
            lines.append(f"theory: {share:.2f} % of {compared} compared points agree")
        lines.append(
            f"in doubt: {counts_text('status', 'ok', 'not_computed', 'impossible_body') or 'no point'}"
        )
        if "atlas_half_step_points" in ds.attrs:
            lines.append(half_step.half_step_text(ds.attrs, verbose=False))
    if (proved := without_run(ds)) is not None:
        lines.append(
            f"proved, not integrated: {int(proved.sum())} points, whose labels are those of the proof"
        )
    scene = scene_of(ds)
    plan = None if scene is None else ScenePlan.of(scene)
    if plan is not None:
        lines += grid.not_computed(plan.scene, plan.sample)
    lines += _nearest_family(ds)
    if not verbose:
        return "\n".join(lines)
    lines += _error_lines(tally)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(half_step.half_step_text(ds.attrs))
    seconds, speed = (number_attribute(ds, f"atlas_{name}") for name in ("seconds", "points_per_second"))
    lines.append(f"{seconds:.1f} s, {speed:.4g} points/s")
    if plan is not None and not plan.has_chaos:
        lines += [*plan.method_lines(), *plan.proof_lines()]
    return "\n".join(lines)


def _nearest_family(ds: xr.Dataset) -> list[str]:
    """Return a sentence that names the family of motions nearest to the drifting points. Return no sentence unless single points drift."""
    if "label" not in ds or ds["label"].dims != ("point",) or "atlas_system" not in ds.attrs:
        return []
    system = system_of(ds)
    drifting = ds.isel(point=np.flatnonzero(ds["label"].values == Label.DRIFTING)[:MAX_NEAREST])
    families = [f for f in families_of(system).values() if f.conditions and not (f.axes or f.rate_std)]
    if not drifting.sizes["point"] or not families or not set(system.parameters) <= set(ds.coords):
        return []
    points = {n: np.broadcast_to(drifting[n].values, drifting.sizes["point"]) for n in system.parameters}
    with np.errstate(all="ignore"):
        residuals = [float(np.median(on_family(each, points))) for each in families]
    name, residual = families[int(np.argmin(residuals))].name, min(residuals)
    return [f"drifting points: nearest to the family {name}, residual {residual:.2g} (median)"]


def _error_lines(tally: Tally) -> list[str]:
    """Return lines with the median and largest error_estimate of each group of points, and with the largest integral_drift."""
    lines, parts = [], []
    for name in (name for name in GROUPS if name in tally.largest):
        largest = tally.largest[name]
        cumulative = np.cumsum([tally.counts[name].get(str(index), 0) for index in range(BINS)])
        median_bin = int(np.searchsorted(cumulative, (cumulative[-1] + 1) // 2))
        # The histogram resolves the median to a quarter of a decade.
        median = min(10.0 ** (median_bin / BINS_PER_DECADE + LOWEST_DECADE), largest)
        parts.append(f"at {name} points {median:.0e} (median) to {largest:.2g} (largest)")
    if parts:
        unknown = [words for name, words in _UNKNOWN.items() if tally.largest.get(name, 0.0) > 1]
        remark = f"; above 1 {' or '.join(unknown)}; the labels have checks of their own" if unknown else ""
        lines.append(f"expected relative error of the motion (error_estimate): {', '.join(parts)}{remark}")
    if "integral_drift" in tally.largest:
        largest = tally.largest["integral_drift"]
        lines.append(f"largest relative change of a first integral (integral_drift): {largest:.2g}")
    return lines
