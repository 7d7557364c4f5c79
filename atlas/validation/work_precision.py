"""Error against run time: some of a scene's points, by every method at many steps, beside a tight reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np
import xarray as xr

from ..engine import blocks, measure, stepsize
from ..engine.tableaux import METHODS
from ..errors import BadInput
from ..flags import Label
from ..io import provenance
from ..io.progress import Progress
from ..label.pipeline import RATES, Specialization, evaluate_tile, kernel, scene_kernel_hash
from ..scene import grid
from ..scene.model import Scene, Settings
from ..systems.base import Array, Points, System
from ..variables import variables
from .half_step import stratified_indices, upper_bound
from .reference import (
    MAX_RADIANS,
    STATISTICS,
    Advance,
    Reference,
    ReferenceFailureError,
    reference,
    state_distance,
)

# Rungs of the ladder: decades of the tolerance around the scene's own, or halves of its step.
COARSEST, FINEST, HALVES = 1e-1, 1e-13, range(5, -7, -1)
# A rung that takes more point-steps than this for the sample is left out.
MAX_POINT_STEPS = 5e8
POINT_STEPS_TIMED = 6_000_000  # point-steps of one timing


# The report.


def levels(settings: Settings) -> tuple[str, list[float]]:
    """Tolerances (decades around the scene's own), or steps (halves and doubles), coarse to fine."""
    if settings.step is not None:
        return "step", [settings.step * 2.0**k for k in HALVES]
    above = math.floor(math.log10(COARSEST) - math.log10(settings.tolerance) + 1e-9)
    below = math.floor(math.log10(settings.tolerance) - math.log10(FINEST) + 1e-9)
    decades = range(max(above, 0), -max(below, 0) - 1, -1)
    return "tolerance", [settings.tolerance * 10.0**k for k in decades if k == 0 or k >= -below]


def own_level(settings: Settings) -> int:
    """Place of the scene's own setting on the ladder."""
    kind, rungs = levels(settings)
    own = settings.step if settings.step is not None else settings.tolerance
    return int(np.abs(np.log(np.array(rungs) / own)).argmin())


def work_precision(scene: Scene, count: int = 64, *, progress: bool = False) -> xr.Dataset:
    """Errors and run times of `count` points of a scene, over the dimensions (method, rung, sample).

    Every method of the engine runs at a ladder of tolerances (or steps, if the scene gives one). State
    errors are the largest difference of a component at the end of the run, angular velocities in units
    of the point's frequency bound; `error_rates` is that of the least accurate mean or spread of a rate
    in the same units, `error_NAME` that of one statistic; inf where a run is not finite. No error is
    below what the reference knows, `reference_error` and `reference_error_NAME`. seconds_per_point: one
    processor, full blocks of points, to the end of the run, from the measured time of a point-step.
    Rungs are nan that take too many steps, the same steps as a finer one (or as the scene's own), or that
    are finer than rounding lets errors fall. Points where the reference fails are left out and named in the
    attribute `left_out`. progress: say on stderr what is done. Raises BadInput for a count below 2, and where
    the reference leaves fewer than 2 points.
    """
    if count < 2:
        raise BadInput(f"points = {count}: must be at least 2")
    began = perf_counter()
    grid.check(scene)
    system, settings = scene.system, scene.settings
    indices = stratified_indices(scene.size, 16 * count)
    there = np.flatnonzero(grid.points_at_indices(scene, indices).there)
    if not there.size:
        raise BadInput(f"family.name = {scene.family!r}: exists at none of the points tried")
    indices = indices[there[stratified_indices(there.size, count)]]
    bar = Progress((2 + len(METHODS)) * indices.size, show=progress)
    try:
        indices, part, truth, left_out = _with_reference(scene, indices, bar.advance)
        (kind, rungs), methods = levels(settings), list(METHODS)
        shape = (len(methods), len(rungs), indices.size)
        columns = {f"error_{name}": np.full(shape, np.nan) for name in STATISTICS}
        columns |= {
            name: np.full(shape, np.nan)
            for name in ("error_state", "error_rates", "integral_drift", "step_length")
        }
        counts = np.zeros(shape, np.int64)
        called, wrong = np.zeros(shape, np.int8), np.zeros(shape, bool)
        seconds = np.full(shape[:2], np.nan)
        bound, own = system.frequency_bound(part.points), own_level(settings)
        known = max(median_of(truth.state_error), median_of(_reference_rates_error(truth, bound)))
        for i, method in enumerate(methods):
            runner, least, stale = _Runner(scene, part.points, method), math.inf, 0
            settled = [
                replace(settings, method=method, **{kind: rung})  # type: ignore[arg-type]
                for rung in rungs
            ]
            plans = [_step_sizes(system, part.points, part.duration, chosen) for chosen in settled]
            for j, (chosen, plan) in enumerate(zip(settled, plans, strict=True)):
                alike = [k for k, other in enumerate(plans) if (other.count == plan.count).all()]
                last = own if own in alike else alike[-1]
                bar.advance(indices.size / len(rungs))
                if j != last or (j and plan.count.sum() > MAX_POINT_STEPS):
                    continue
                found = evaluate_tile(
                    replace(scene, settings=chosen, outputs=(*STATISTICS, "integral_drift", "label")), part
                )
                state = runner.end(blocks.pack_blocks(plan.count, plan.count), plan.length)
                with np.errstate(invalid="ignore"):
                    lost = ~np.isfinite(state).all(0)
                    error = np.where(lost, np.inf, state_distance(state, truth.state, bound))
                    columns["error_state"][i, j] = np.maximum(error, truth.state_error)
                    for name in STATISTICS:
                        columns[f"error_{name}"][i, j] = np.maximum(
                            np.abs(found[name] - truth.statistics[name]), truth.statistics_error[name]
                        )
                    worst = np.fmax.reduce([columns[f"error_{name}"][i, j] for name in RATES])
                    columns["error_rates"][i, j] = np.where(lost, np.inf, worst / bound)
                columns["integral_drift"][i, j], columns["step_length"][i, j] = (
                    found["integral_drift"],
                    plan.length,
                )
                counts[i, j], called[i, j] = plan.count, found["label"]
                wrong[i, j] = found["label"] != truth.label
                if truth.label_inertial is not None:
                    wrong[i, j] |= found["label_inertial"] != truth.label_inertial
                looks = list(zip(plan.stride.tolist(), plan.parts.tolist(), strict=True))
                # At every rung: passages of the vertical cost the more, the longer the steps.
                paces = {
                    look: _seconds_per_point_step(scene, part.points, plan, method, *look)
                    for look in set(looks)
                }
                pace = np.array([paces[look] for look in looks])
                seconds[i, j] = (pace * plan.count).mean()
                reached = median_of(columns["error_state"][i, j])
                typical = max(reached, median_of(columns["error_rates"][i, j]))
                stale = stale + 1 if typical > 0.5 * least else 0
                if j > own and stale >= (1 if typical < 3 * known else 3):
                    break  # rounding, or what the reference knows: finer steps show no less
                least = min(least, typical)
    finally:
        bar.close()
    ds = _dataset(scene, indices, truth, bound, columns, counts, called, wrong, seconds)
    ds.attrs = provenance.provenance(
        system, settings, scene_kernel_hash(scene), title=scene.title, scene=scene.toml(),
        seconds=perf_counter() - began, points=indices.size, remarks=[],
    ) | ds.attrs | ({"left_out": left_out} if left_out else {})  # fmt: skip
    return ds


def _with_reference(
    scene: Scene, indices: np.ndarray, advance: Advance
) -> tuple[np.ndarray, grid.Grid, Reference, str]:
    """Those points that the reference can follow, and which it cannot, in words; BadInput for less than 2."""
    left_out = ""
    while True:
        part = grid.points_at_indices(scene, indices)
        try:
            truth = reference(scene.system, part.points, part.duration, scene.settings, advance)
            return indices, part, truth, left_out
        except ReferenceFailureError as failure:
            left_out = (
                f"the reference fails at {failure.places.size} of {indices.size} points, where the motion is"
                f" not finite or turns more than {MAX_RADIANS:g} rad: {_axis_values_text(scene, indices[failure.places])}"
            )
            indices = np.delete(indices, failure.places)
            if indices.size < 2:
                raise BadInput(left_out) from None


def _step_sizes(system: System, points: Points, duration: Array, settings: Settings) -> stepsize.StepSizes:
    return stepsize.choose(
        METHODS[settings.method], system.frequency_bound(points), duration,
        tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
        rate_tolerance=settings.rate_tolerance,
    )  # fmt: skip


class _Runner:
    """Points of a scene in the kernel that the scene gets."""

    def __init__(self, scene: Scene, points: Points, method: str):
        system = scene.system
        self.kernel = kernel(system, method, Specialization.of(system, *scene.vanishing()))
        self.cylinder = scene.settings.cylinder
        self.start = np.ascontiguousarray(system.initial_state(points))
        self.constants = np.ascontiguousarray(system.constants(points))
        conserved = dict(system.integral_scales(points))
        self.scales = measure.scales(system.equations, self.start, self.constants, conserved)

    def end(self, schedule: blocks.BlockSchedule, length: Array, threads: int | None = None) -> Array:
        """Final states, (state, points)."""
        state = self.start.copy()
        blocks.integrate(
            self.kernel, schedule, length, state, self.constants, self.scales, self.cylinder, threads=threads
        )
        return state


def _seconds_per_point_step(
    scene: Scene, points: Points, plan: stepsize.StepSizes, method: str, stride: int, parts: int
) -> float:
    """Seconds per point-step on one processor in full blocks; stride, parts: as in steps.Steps."""
    full_blocks = -(-plan.count.size // blocks.WIDTH)
    many = np.resize(np.arange(plan.count.size), full_blocks * blocks.WIDTH)
    runner = _Runner(scene, {name: values[many] for name, values in points.items()}, method)
    each = np.full(many.size, max(POINT_STEPS_TIMED // many.size // stride, 1) * stride)
    work, times = blocks.pack_blocks(each, np.full(many.size, stride), np.full(many.size, parts)), []
    for _ in range(6):  # the first may load or compile the kernel
        began = process_time()
        runner.end(work, plan.length[many], threads=1)
        times.append(process_time() - began)
    return median(times[1:]) / work.point_steps


def _axis_values_text(scene: Scene, indices: np.ndarray, most: int = 5) -> str:
    """Points by the values on their axes."""
    shown = []
    for place in np.transpose(np.unravel_index(indices[:most], scene.shape)):
        values = zip(scene.axes.values(), place, strict=True)
        shown.append(", ".join(f"{axis.name} = {axis.values[i]:.6g}" for axis, i in values))
    return "; ".join(shown) + (f" and {indices.size - most} more" if indices.size > most else "")


def _reference_rates_error(truth: Reference, bound: Array) -> Array:
    """What the reference knows of the least certain mean or spread of a rate, over the bound."""
    return np.asarray(np.fmax.reduce([truth.statistics_error[name] for name in RATES]) / bound)


LONG_NAMES = {
    "error_state": "largest error of a component of the final state, angular velocities over the frequency bound",
    "error_rates": "error of the least accurate mean or spread of a rate, over the frequency bound",
    "integral_drift": "largest relative change of a first integral",
    "step_length": "length of a step",
}


def _dataset(scene, indices, truth: Reference, bound, columns, counts, called, wrong, seconds) -> xr.Dataset:
    settings, dims, registry = scene.settings, ("method", "rung", "sample"), variables(scene.system)
    compared = truth.certain & (called != Label.UNRESOLVED) & (called != Label.NOT_COMPUTED)
    ds = xr.Dataset()
    for name, values in columns.items():
        statistic = name.removeprefix("error_")
        units = registry[statistic].units if statistic in STATISTICS else "1"
        long_name = LONG_NAMES.get(name) or f"error of {statistic}"
        ds[name] = dims, values, {"long_name": long_name, "units": units}
    ds["step_length"].attrs["units"] = "s"
    ds["steps"] = dims, counts, {"long_name": "steps to the end of the run", "units": "1"}
    ds["label_compared"] = dims, compared.astype(np.int8), {"long_name": "both label and reference are sure"}
    ds["label_wrong"] = (
        dims,
        (compared & wrong).astype(np.int8),
        {"long_name": "a label is not the reference's"},
    )
    unresolved = (called == Label.UNRESOLVED).astype(np.int8)
    ds["label_unresolved"] = dims, unresolved, {"long_name": "the method gives no label"}
    ds["seconds_per_point"] = (
        dims[:2], seconds, {"long_name": "processor time to the end of the run", "units": "s"}
    )  # fmt: skip
    ds["order"] = dims[:2], _orders(columns, truth), {"long_name": "observed order from the rung before"}
    known = {"": ("state", truth.state_error), "_rates": ("rates", _reference_rates_error(truth, bound))}
    known |= {f"_{name}": (name, values) for name, values in truth.statistics_error.items()}
    for suffix, (name, values) in known.items():
        attributes = {"long_name": f"uncertainty of the reference: error_{name} is never less"}
        ds[f"reference_error{suffix}"] = "sample", values, attributes | {"units": ds[f"error_{name}"].units}
    ds["reference_exact"] = "sample", truth.exact.astype(np.int8), {"long_name": "closed form of a family"}
    kind, rungs = levels(settings)
    ds = ds.assign_coords(
        {
            "method": ("method", list(METHODS)),
            "index": ("sample", indices, {"long_name": "flat index in the scene's grid"}),
            kind: ("rung", rungs, {"long_name": f"{kind} of the scene's [integration]"}),
        }
    )
    for axis, place in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
        ds = ds.assign_coords({f"axis_{axis.name}": ("sample", np.asarray(axis.values)[place])})
    ds.attrs = {
        "atlas_points": scene.size,
        "ladder": kind,
        "own_method": settings.method,
        "own_rung": own_level(settings),
    }
    return ds


def _orders(columns: Mapping[str, Array], truth: Reference) -> Array:
    """Median over the points of log(error ratio) / log(step ratio), where the reference can tell; else nan."""
    error, step = columns["error_state"], columns["step_length"]
    order = np.full(error.shape[:2], np.nan)
    with np.errstate(all="ignore"):
        each = np.log(error[:, :-1] / error[:, 1:]) / np.log(step[:, :-1] / step[:, 1:])
    # Errors near the reference's own, and those of a run that is nowhere near converged, show no order.
    told = (error[:, 1:] > 10 * truth.state_error) & (error[:, :-1] < 1e-2) & np.isfinite(each)
    for place in np.argwhere(told.sum(2) >= max(2, error.shape[2] / 2)):
        i, j = place
        order[i, j + 1] = np.median(each[i, j][told[i, j]])
    return order


def summary(ds: xr.Dataset) -> list[dict[str, Any]]:
    """One row per method and rung that ran: medians and largest values over the points."""
    rows: list[dict[str, Any]] = []
    kind = ds.attrs["ladder"]
    for method in ds["method"].values:
        for j in range(ds.sizes["rung"]):
            at = ds.sel({"method": method}).isel(rung=j)
            if not np.isfinite(at["seconds_per_point"]):
                continue
            compared, wrong = int(at["label_compared"].sum()), int(at["label_wrong"].sum())
            error = at["error_state"].values
            row = {
                "method": str(method),
                kind: float(ds[kind][j]),
                "own_setting": method == ds.attrs["own_method"] and j == ds.attrs["own_rung"],
                "steps": float(at["steps"].mean()),
                "seconds_per_point": float(at["seconds_per_point"]),
                "error_state": median_of(error),
                "error_state_largest": _largest(error),
                "error_rates": median_of(at["error_rates"].values),
                "error_rates_largest": _largest(at["error_rates"].values),
                "labels_unresolved": int(at["label_unresolved"].sum()),
                "labels_compared": compared,
                "labels_wrong": wrong,
                "labels_wrong_at_most": upper_bound(wrong, compared, ds.attrs["atlas_points"]),
                "integral_drift_largest": _largest(at["integral_drift"].values),
                "order": float(at["order"]),
            }
            for name in STATISTICS:
                values = at[f"error_{name}"].values
                row |= {f"error_{name}": median_of(values), f"error_{name}_largest": _largest(values)}
            rows.append(row)
    return rows


def median_of(values: Array) -> float:
    """Median of what has a meaning; nan if nothing has."""
    values = values[~np.isnan(values)]
    return float(np.median(values)) if values.size else math.nan


def _largest(values: Array) -> float:
    values = values[~np.isnan(values)]
    return float(values.max()) if values.size else math.nan


def _row_dataset(ds: xr.Dataset, row: Mapping[str, Any]) -> xr.Dataset:
    """The method and rung that a row of the summary is made from."""
    kind = ds.attrs["ladder"]
    return ds.sel({"method": row["method"]}).isel(rung=int(np.abs(ds[kind].values - row[kind]).argmin()))


def _shown(ds: xr.Dataset, at: xr.Dataset, name: str) -> tuple[str, str]:
    """Median and largest error_NAME at a rung; with <= where the reference knows no better."""
    known = ds[f"reference_error{'' if name == 'state' else '_' + name}"].values
    values = at[f"error_{name}"].values
    return tuple(
        ("" if of(values) > 3 * of(np.where(np.isnan(values), np.nan, known)) else "<= ")
        + f"{of(values):.1e}"
        for of in (median_of, _largest)
    )  # type: ignore[return-value]


def report(ds: xr.Dataset) -> str:
    """The work and what it buys as plain text, ending with one sentence of advice."""
    kind, rows = ds.attrs["ladder"], summary(ds)
    exact, own = int(ds["reference_exact"].sum()), ds["reference_error"].values
    lines = [
        f"{ds.attrs['title']}: {ds.sizes['sample']} of {ds.attrs['atlas_points']} points;"
        f" processor {ds.attrs['atlas_cpu']}, atlas {ds.attrs['atlas_version']}",
        f"reference: closed form at {exact} points, DOP853 at {ds.sizes['sample'] - exact};"
        f" it knows final states to {median_of(own):.1e} (median), {own.max():.1e} (worst point)",
    ]
    lines += [f"left out: {ds.attrs['left_out']}"] if "left_out" in ds.attrs else []
    lines.append("")
    cells: list[tuple[str, ...]] = [
        ("method", kind, "steps", "us/point", "state error", "worst", "rates", "labels wrong", "drift", "order")
    ]  # fmt: skip
    marked = None
    for row in rows:
        at = _row_dataset(ds, row)
        marked = at if row["own_setting"] else marked
        cells.append(
            (
                row["method"],
                f"{row[kind]:.3g}" + (" *" if row["own_setting"] else ""),
                f"{row['steps']:.0f}",
                f"{1e6 * row['seconds_per_point']:.3g}",
                *_shown(ds, at, "state"),
                _shown(ds, at, "rates")[0],
                f"{row['labels_wrong']}/{row['labels_compared']} (<= {100 * row['labels_wrong_at_most']:.3g} %)",
                f"{row['integral_drift_largest']:.1e}",
                "-" if np.isnan(row["order"]) else f"{row['order']:.2f}",
            )
        )
    lines += [_columns(cells), ""]
    lines += [
        "us/point: one processor, to the end of the run; errors: median over the points; <=: the reference knows",
        "no better; rates: the least accurate mean or spread, over the frequency bound; labels wrong: beside the",
        "reference, share at most (95 %); * the scene's setting.",
        "",
    ]
    if marked is not None:
        cells = [("at the scene's setting", "median error", "worst", "points that have it")]
        for name in STATISTICS:
            there = int(marked[f"error_{name}"].notnull().sum())
            if there:
                cells.append((name, *_shown(ds, marked, name), str(there)))
        lines += [_columns(cells), ""]
    return "\n".join([*lines, advice(ds)])


def _columns(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)


def advice(ds: xr.Dataset) -> str:
    """Which method and step reach the scene's tolerance most cheaply, in one sentence.

    A scene with a step has no tolerance: what counts there is the median error of its own setting.
    """
    kind, rows = ds.attrs["ladder"], summary(ds)
    own = next((row for row in rows if row["own_setting"]), None)
    if kind == "tolerance":
        target = float(ds["tolerance"][ds.attrs["own_rung"]])
        what = f"a median error of {target:.3g} in states and rates"
    elif own is None:
        return "The scene's own step takes too many steps for a sample: no advice."
    else:
        target = max(own["error_state"], own["error_rates"])
        what = f"the scene's own median error in states and rates, {target:.2g}"
    states, rates = ds["reference_error"].values, ds["reference_error_rates"].values
    unsure = np.fmax(states, rates) > target
    # A setting must not lose a label, nor get one wrong, that another gives.
    lost = [(row["labels_unresolved"], row["labels_wrong"]) for row in rows]
    fewest = tuple(min(numbers) for numbers in zip(*lost, strict=True))
    reach = [
        row
        for row in rows
        if max(row["error_state"], row["error_rates"]) <= target
        and (row["labels_unresolved"], row["labels_wrong"]) == fewest
    ]
    if not reach:
        best = min(rows, key=lambda row: max(row["error_state"], row["error_rates"]))
        known = max(median_of(states), median_of(rates))
        text = (
            f"Out of reach: {what}; the best of the ladder, {best['method']} with {kind} = {best[kind]:.3g}, has"
            f" {best['error_state']:.1e} in states and {best['error_rates']:.1e} in rates"
        )
        if known > target:
            text += f", and the reference cannot tell errors that small (states {median_of(states):.1e}, rates {median_of(rates):.1e})"
        names = _beyond(ds, best, target)[1]
        return f"{text}, first of all at {names}."
    cheap = min(reach, key=lambda row: row["seconds_per_point"])
    text = (
        f"Cheapest for {what}: {cheap['method']} with {kind} = {cheap[kind]:.3g},"
        f" {1e6 * cheap['seconds_per_point']:.3g} us a point"
    )
    if cheap["own_setting"]:
        text += ", the scene's own setting"
    elif own is not None:
        text += (
            f" (the scene's {own['method']} with {kind} = {own[kind]:.3g}: {1e6 * own['seconds_per_point']:.3g} us,"
            f" error {max(own['error_state'], own['error_rates']):.1e})"
        )
    angles = max(cheap["error_theta_min"], cheap["error_theta_max"])
    if angles > target:
        text += f"; theta_min and theta_max then have a median error of {angles:.1e}"
    above, names = _beyond(ds, cheap, target)
    if above and kind == "tolerance":  # half of the points are above the median of a setting
        text += f"; {above} of {unsure.size} points stay above it, first of all {names}"
        if unsure.any():
            text += f" ({int(unsure.sum())} where the reference itself does not know)"
    return text + "."


def _beyond(ds: xr.Dataset, row: Mapping[str, Any], target: float) -> tuple[int, str]:
    """How many points have a larger error in states or rates than the target at a row's setting, and the worst."""
    at = _row_dataset(ds, row)
    error = np.fmax(at["error_state"].values, at["error_rates"].values)
    beyond = np.flatnonzero(error > target)
    return beyond.size, _named_points(ds, beyond[np.argsort(-error[beyond])])


def _named_points(ds: xr.Dataset, places: np.ndarray, most: int = 3) -> str:
    axes = [str(name) for name in ds.coords if str(name).startswith("axis_")]
    shown = [
        ", ".join(f"{name.removeprefix('axis_')} = {float(ds[name][i]):.6g}" for name in axes)
        for i in places[:most]
    ]
    return "; ".join(shown) + (f" and {places.size - most} more" if places.size > most else "")


def table(ds: xr.Dataset) -> str:
    """`summary` as CSV."""
    rows = summary(ds)
    lines = [",".join(rows[0])]
    lines += [",".join(v if isinstance(v, str) else repr(v) for v in row.values()) for row in rows]
    return "\n".join(lines) + "\n"
