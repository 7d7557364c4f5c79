"""Dependence of labels on settings that have no true value. The same points are run with other durations and tolerances."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ...analysis.metadata import flag_names
from ...errors import BadInput, allowed_text, text_table
from ...flags import LABELS
from ...kernel.compiling import Stopwatch
from ...measure.instrument import Variable
from ...runs.memory import columns_of
from ...runs.plan import ScenePlan
from ...scene.model import Scene
from ...store import dataset
from ...store.progress import Progress

# Setting -> factors at which `label_change` compares flags. The table has rows for the other FACTORS as well.
VARIED = {
    "duration": (2.0, 4.0), "transient": (2.0, 4.0), "rate_tolerance": (0.25, 0.5, 2.0, 4.0), "tolerance": (0.25, 0.5),
}  # fmt: skip
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
FLAGS = (*LABELS, "regularity")
MAX_POINTS = 10_000  # default number of points
CHANGE = "label_change"
HEAD = ("variable", "setting", "factor", "changed", "percent", "changes")


def convergence(
    scene: Scene, names: Sequence[str], points: int = MAX_POINTS, *, progress: bool = True
) -> xr.Dataset:
    """Return flags at `points` or fewer points of a grid, for several values of settings.

    The variable FLAG_of_SETTING lies along SETTING_factor and the axes of the scene. At each point, `label_change` names the
    settings that change a flag if they are multiplied by one of their factors in VARIED.
    """
    for name in names:
        if name not in VARIED:
            raise BadInput(f"{name}: cannot be varied; {allowed_text(name, VARIED)}")
        if name == "transient" and not scene.transient.amount:
            raise BadInput("transient: the scene has none; labels.transient gives it one")
    flags = tuple(name for name in FLAGS if name == "label" or name in scene.outputs)
    if scene.refine is not None:
        factors = zip(scene.axes.items(), scene.coarsening, strict=True)
        axes = {name: replace(axis, values=axis.values[::factor]) for (name, axis), factor in factors}
        scene = replace(scene, axes=axes, refine=None)
    scene = replace(scene, outputs=flags, map="")
    if scene.points is None:
        share = min(1.0, points / scene.size) ** (1 / max(sum(count > 1 for count in scene.shape), 1))
        axes = dict(scene.axes)
        for name, axis in scene.axes.items():
            size = len(axis.values)
            if (count := math.ceil(share * size)) < size:
                values = axis.values[np.linspace(0, size - 1, max(count, 2)).round().astype(int)]
                interval = ("from", "to", "count", "spacing")
                table = {key: each for key, each in axis.table.items() if key not in interval}
                axes[name] = replace(axis, values=values, table=table | {"values": values.tolist()})
        scene = replace(scene, axes=axes)
    names, stopwatch = list(dict.fromkeys(names)), Stopwatch()
    cases = [(name, factor) for name in names for factor in FACTORS if factor != 1.0]
    plans = [ScenePlan.of(scene), *(ScenePlan.of(_with_setting(scene, *case)) for case in cases)]
    with closing(Progress(scene.size * len(plans), show=progress)) as bar:
        base, *others = (columns_of(plan, bar)[0] for plan in plans)
    varied = dict(zip(cases, others, strict=True))
    ds = dataset.dataset(scene, base)
    ds.attrs = dataset.provenance(
        scene.system, scene.settings, plans[0].runs.kernel_hash, scene=scene, warnings=[],
        timing=(bar.points, stopwatch.seconds()),
    )  # fmt: skip
    change = np.zeros(scene.shape, np.int8)
    for bit, name in enumerate(names):
        ds = ds.assign_coords({f"{name}_factor": list(FACTORS)})
        for flag in flags:
            stacked = [varied.get((name, factor), base)[flag].reshape(scene.shape) for factor in FACTORS]
            ds[f"{flag}_of_{name}"] = (f"{name}_factor", *ds[flag].dims), np.stack(stacked), ds[flag].attrs
            for factor, values in zip(FACTORS, stacked, strict=True):
                if factor in VARIED[name]:
                    change |= np.where(values != ds[flag].values, 1 << bit, 0).astype(np.int8)
    masks = range(1, 1 << len(names))
    ways = ["_and_".join(n for bit, n in enumerate(names) if mask >> bit & 1) for mask in masks]
    meanings = dict.fromkeys(["unchanged", *(f"by_{way}" for way in ways)], "")
    variable = Variable(CHANGE, "int8", "1", "settings by which a label changes", meanings)
    ds[CHANGE] = ds["label"].dims, change, variable.attributes()
    return ds


def _with_setting(scene: Scene, name: str, factor: float) -> Scene:
    """Return the scene with a setting multiplied by `factor`. In scenes with a step, the step is multiplied instead of the tolerance."""
    if name in ("duration", "transient"):
        length = getattr(scene, name)
        return replace(scene, **{name: replace(length, amount=_times(factor, length.amount))})
    settings = scene.settings
    if name == "tolerance" and settings.step is not None:
        name = "step"
    changed: dict[str, Any] = {name: _times(factor, getattr(settings, name))}
    return replace(scene, settings=replace(settings, **changed))


def _times(factor: float, amount: float | str) -> float | str:
    return f"{factor!r} * ({amount})" if isinstance(amount, str) else factor * amount


def rows(ds: xr.Dataset) -> list[tuple[str, ...]]:
    """Return a row with the columns HEAD for each flag, setting and factor. The last column has the three most frequent changes."""
    result = list[tuple[str, ...]]()
    for name in VARIED:
        for flag in (flag for flag in FLAGS if f"{flag}_of_{name}" in ds):
            meanings, base = flag_names(ds[flag]), ds[flag].values
            for factor, values in zip(FACTORS, ds[f"{flag}_of_{name}"].values, strict=True):
                where = values != base
                pairs = Counter(zip(base[where].tolist(), values[where].tolist(), strict=True)).most_common(3)
                changes = "; ".join(f"{meanings[a]} to {meanings[b]} {count}" for (a, b), count in pairs)
                result.append(
                    (flag, name, f"{factor:g}", str(where.sum()), f"{100 * where.mean():.3g}", changes)
                )
    return result


def report(ds: xr.Dataset) -> str:
    """Return the rows as a table, and how many points change at all."""
    changed, size = int((ds[CHANGE] != 0).sum()), ds[CHANGE].size
    varied = [name for name in VARIED if f"label_of_{name}" in ds]
    counted = [f"{' or '.join(f'{factor:g}' for factor in VARIED[name])} times the {name}" for name in varied]
    summary = f"{changed} of {size} points ({100 * changed / size:.3g} %) change with {', '.join(counted)}"
    return f"{text_table([HEAD, *rows(ds)])}\n{summary}"


def table(ds: xr.Dataset) -> str:
    """Return the rows as comma-separated values."""
    return "".join(f"{','.join(row)}\n" for row in [HEAD, *rows(ds)])
