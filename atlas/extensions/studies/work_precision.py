"""Work-precision study, which measures errors and run times at points of a scene for many step sizes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from statistics import median
from time import process_time
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from ...errors import BadInput, attribute_text, text_table
from ...flags import Label
from ...kernel import numeric_bound
from ...kernel.blocks import Threads
from ...kernel.compiling import Stopwatch
from ...kernel.ensemble import Ensemble
from ...kernel.generated import WIDTH
from ...kernel.specialization import kernel
from ...kernel.stepsize import StepSizes
from ...kernel.tableaux import METHODS
from ...label.half_step import stratified_indices, upper_bound
from ...label.pipeline import after_transient, evaluate
from ...label.plan import Plan
from ...measure.observables import whole_periods
from ...measure.rates import state_distance
from ...scene import grid
from ...scene.model import Scene, Settings
from ...store import dataset
from ...store.progress import Progress
from ...systems.base import Array
from ...variables import main_instrument, variables
from .reference import MAX_RADIANS, Advance, Reference, reference_where_possible

# The levels are the scene's tolerance times powers of 10, from MIN_TOLERANCE to MAX_TOLERANCE, or the scene's step times powers of 2.
MAX_TOLERANCE, MIN_TOLERANCE, STEP_EXPONENTS = 1e-1, 1e-13, range(5, -7, -1)
MAX_POINT_STEPS = 5e8  # a level takes at most this many steps, summed over the sample
POINT_STEPS_TIMED = 6_000_000  # a timing takes about this many steps, summed over the points
# This many points are tried for each point of the sample, because the family may not exist at some points.
CANDIDATES_PER_POINT = 16

# Type, long name and units of each variable over (method, level, sample); seconds_per_point is over (method, level).
VARIABLES = {
    "error_state": (float, "largest error of a component of the final state, angular velocities over the frequency bound", "1"),
    "error_rates": (float, "error of the least accurate mean, rms or standard deviation of a rate, over the frequency bound", "1"),
    "integral_drift": (float, "largest relative change of a first integral", "1"),
    "step_length": (float, "length of a step", "s"),
    "steps": (np.int64, "steps to the end of the run", "1"),
    "label_compared": (np.int8, "both the method and the reference determine the label", "1"),
    "label_wrong": (np.int8, "a label differs from the reference's", "1"),
    "label_unresolved": (np.int8, "the method gives no label", "1"),
    "seconds_per_point": (float, "processor time to the end of the run", "s"),
}  # fmt: skip

# These variables have another meaning for systems with observables.
OF_OBSERVABLES = {
    "error_state": (float, "largest error of a component of the final state", "1"),
    "error_rates": (float, "error of the least accurate statistic of an observable, over its largest magnitude", "1"),
}  # fmt: skip


def levels(settings: Settings) -> tuple[str, list[float]]:
    """Return the name of the quantity that is varied ("tolerance" or "step"), and the values from coarse to fine."""
    if settings.step is not None:
        return "step", [settings.step * 2.0**k for k in STEP_EXPONENTS]
    above = math.floor(math.log10(MAX_TOLERANCE) - math.log10(settings.tolerance) + 1e-9)
    below = math.floor(math.log10(settings.tolerance) - math.log10(MIN_TOLERANCE) + 1e-9)
    decades = range(max(above, 0), -max(below, 0) - 1, -1)
    return "tolerance", [settings.tolerance * 10.0**k for k in decades if k == 0 or k >= -below]


def scene_level(settings: Settings) -> int:
    """Return the index of the scene's own setting among the levels."""
    _, values = levels(settings)
    value = settings.step if settings.step is not None else settings.tolerance
    return int(np.abs(np.log(np.array(values) / value)).argmin())


# Results of a method at a level, by the names of the dataset's variables. All but `seconds_per_point` are arrays (points,).
Columns: TypeAlias = dict[str, Any]


@dataclass(frozen=True)
class _Sample:
    """Points of a scene with a reference solution, in arrays of shape (points,)."""

    scene: Scene
    indices: np.ndarray  # indices of the points in the flattened grid of the scene
    grid: grid.Grid
    reference: Reference
    bound: Array  # frequency bound, rad per time unit
    left_out: str  # text about the points without a reference

    @property
    def rates_uncertainty(self) -> Array:
        """Largest uncertainty of a statistic of the reference, relative to the same scale as in `worst`."""
        return self.worst(self.reference.statistics_error)

    def worst(self, errors: Mapping[str, Array]) -> Array:
        """Return the largest error of a statistic, relative to the frequency bound (rates) or to the magnitude (observables)."""
        system = self.scene.system
        return main_instrument(system).largest(system, self.reference.statistics, errors, self.bound)


def work_precision(scene: Scene, count: int = 64, *, progress: bool = False) -> xr.Dataset:
    """Measure errors and run times of every method at many levels, for a sample of points of a scene."""
    if count < 2:
        raise BadInput(f"points = {count}: must be at least 2")
    stopwatch = Stopwatch()
    grid.check(scene)
    indices = stratified_indices(scene.size, CANDIDATES_PER_POINT * count)
    exists = np.flatnonzero(grid.points_at_indices(scene, indices).exists)
    if not exists.size:
        raise BadInput(f"family.name = {scene.family!r}: exists at none of the points tried")
    indices = indices[exists[stratified_indices(exists.size, count)]]
    bar = Progress(indices.size, show=progress)

    def advance(points: float) -> None:
        bar.advance(points / (2 + len(METHODS)))  # two runs by the reference, one by each method

    try:
        sample = _with_reference(scene, indices, advance)
        results = {
            (i, level): result
            for i, method in enumerate(METHODS)
            for level, result in _run_method(sample, method, advance)
        }
    finally:
        bar.close()
    ds = _dataset(sample, results)
    kernel, timing = Plan.of(scene).kernel_hash, (sample.indices.size, stopwatch.seconds())
    attributes = dataset.provenance(
        scene.system, scene.settings, kernel, scene=scene, warnings=[], timing=timing
    )
    ds.attrs = attributes | ds.attrs
    return ds


def _with_reference(scene: Scene, indices: np.ndarray, advance: Advance) -> _Sample:
    """Return the points that have a reference solution. Raise BadInput if fewer than two remain."""
    system, method, left_out = scene.system, METHODS[scene.settings.method], ""
    part = grid.points_at_indices(scene, indices)
    part = replace(part, duration=whole_periods(system, system.constants(part.points), part.duration)[1])
    transient = whole_periods(system, system.constants(part.points), np.asarray(part.transient))[1]
    part, settings = replace(part, transient=transient), scene.settings.at(part.rate_tolerance, transient)
    solution, where = reference_where_possible(system, part.points, part.duration, settings, advance)
    if where.size < indices.size:
        failed = np.delete(indices, where)
        left_out = (
            f"the reference fails at {failed.size} of {indices.size} points, where the motion is not finite"
            f" or turns more than {MAX_RADIANS:g} rad: {points_text(_on_axes(scene, failed), 5)}"
        )
        indices, part = indices[where], part.subset(where)
    if solution is None or (left_out and indices.size < 2):
        raise BadInput(left_out)
    ensemble, kernel_of_scene = Ensemble.of(system, part.points), _kernel(scene, method.name)
    bound, _ = numeric_bound.along_runs(
        system, kernel_of_scene, method, ensemble, part.until, scene.settings.max_steps
    )
    return _Sample(scene, indices, part, solution, bound, left_out)


def _run_method(sample: _Sample, method: str, advance: Advance) -> Iterator[tuple[int, Columns]]:
    """Yield index and result of each level from coarse to fine. Stop when smaller steps no longer reduce the error."""
    settings, part = sample.scene.settings, sample.grid
    name, values = levels(settings)
    at_levels = [replace(settings, method=method, **{name: value}) for value in values]  # type: ignore[arg-type]
    main = main_instrument(sample.scene.system)
    ensemble = Ensemble.of(sample.scene.system, part.points)
    periods, _ = whole_periods(sample.scene.system, ensemble.constants, part.duration)
    step_sizes = [main.step_sizes(s.at(part.rate_tolerance), sample.bound, part.until) for s in at_levels]
    step_sizes = [each.after(np.asarray(part.transient), part.duration) for each in step_sizes]
    step_sizes = [each.in_periods(periods, METHODS[method]) for each in step_sizes]
    own = scene_level(settings)
    # Of levels with the same steps only one is run: the scene's own or else the finest. Levels with too many steps are left out.
    selected = []
    for level, sizes in enumerate(step_sizes):
        equal = [k for k, other in enumerate(step_sizes) if (other.steps == sizes.steps).all()]
        representative = own if own in equal else equal[-1]
        if level == representative and (level == 0 or sizes.whole_steps.sum() <= MAX_POINT_STEPS):
            selected.append(level)
    uncertainty = max(nanmedian(sample.reference.state_error), nanmedian(sample.rates_uncertainty))
    smallest_error, without_gain = math.inf, 0
    for level in selected:
        result = _run_level(sample, ensemble, at_levels[level], step_sizes[level])
        yield level, result
        advance(sample.indices.size / len(selected))
        error = max(nanmedian(result["error_state"]), nanmedian(result["error_rates"]))
        without_gain = without_gain + 1 if error > 0.5 * smallest_error else 0
        # Smaller steps cannot reduce the error below rounding and the uncertainty of the reference.
        if level > own and without_gain >= (1 if error < 3 * uncertainty else 3):
            return
        smallest_error = min(smallest_error, error)


def _run_level(sample: _Sample, ensemble: Ensemble, settings: Settings, step_sizes: StepSizes) -> Columns:
    """Integrate the sample and compare states, statistics and labels with the reference."""
    system = sample.scene.system
    statistics = main_instrument(system).statistics(system)
    outputs = (*statistics, *(["integral_drift"] if system.equations.INTEGRALS else []), "label")
    plan = replace(Plan.of(sample.scene), settings=settings, outputs=outputs)
    measured = evaluate(plan, sample.grid)
    module = _kernel(sample.scene, settings.method)
    ensemble = after_transient(plan, sample.grid.points, ensemble, step_sizes)
    final = ensemble.final_states(module, step_sizes.steps, step_sizes.step_size)
    solution, label = sample.reference, measured["label"]
    # Errors are at least as large as the uncertainty of the reference.
    with np.errstate(invalid="ignore"):
        not_finite = ~np.isfinite(final).all(0)
        distance = np.where(not_finite, np.inf, state_distance(system, final, solution.state, sample.bound))
        errors = {
            name: np.maximum(
                np.abs(measured[name] - solution.statistics[name]), solution.statistics_error[name]
            )
            for name in statistics
        }
        worst = np.where(not_finite | ~step_sizes.resolved, np.inf, sample.worst(errors))
        distance = np.maximum(distance, solution.state_error)
    values = {f"error_{name}": error for name, error in errors.items()} | {
        "error_state": distance,
        "error_rates": worst,
        "integral_drift": measured.get("integral_drift", np.full(final.shape[1], np.nan)),
        "step_length": step_sizes.step_size,
        "steps": step_sizes.steps,
    }
    wrong = label != solution.label
    if solution.label_inertial is not None:
        wrong |= measured["label_inertial"] != solution.label_inertial
    compared = solution.label_certain & (label != Label.UNRESOLVED) & (label != Label.NOT_COMPUTED)
    return values | {
        "label_compared": compared.astype(np.int8),
        "label_wrong": (compared & wrong).astype(np.int8),
        "label_unresolved": (label == Label.UNRESOLVED).astype(np.int8),
        "seconds_per_point": _seconds_per_point(sample, step_sizes, settings.method),
    }


def _seconds_per_point(sample: _Sample, step_sizes: StepSizes, method: str) -> float:
    """Return the mean processor time of a point. The time of a step is measured for each number of steps per sample."""
    counts, size = step_sizes.steps_per_sample.tolist(), step_sizes.steps.size
    repeated = np.resize(np.arange(size), -(-size // WIDTH) * WIDTH)
    ensemble = Ensemble.of(sample.scene.system, sample.grid.points).subset(repeated)
    module, seconds = _kernel(sample.scene, method), {}  # seconds for a step of a point, by steps per sample
    for count in set(counts):
        steps = max(POINT_STEPS_TIMED // repeated.size // count, 1) * count
        timed = replace(
            step_sizes.subset(repeated),
            steps=np.full(repeated.size, steps),
            steps_per_sample=np.full(repeated.size, count),
        )
        times = []
        for _ in range(6):  # the first call may load or compile the kernel
            began = process_time()
            ensemble.integrate(module, timed, sample.scene.settings.cylinder, threads=Threads(1))
            times.append(process_time() - began)
        seconds[count] = median(times[1:]) / (steps * repeated.size)
    return float((np.array([seconds[count] for count in counts]) * step_sizes.whole_steps).mean())


def _kernel(scene: Scene, method: str) -> ModuleType:
    """Return the kernel that integrates the points of a scene by `method`."""
    return kernel(scene.system, method, Plan.of(scene).specialization)


def _on_axes(scene: Scene, indices: np.ndarray) -> dict[str, Array]:
    """Return the coordinates of some points of a scene, by axis."""
    on_grid = np.unravel_index(indices, scene.shape)
    axes = zip(scene.axes.values(), on_grid, strict=True)
    return {axis.name: np.asarray(axis.values)[index] for axis, index in axes}


def points_text(on_axes: Mapping[str, Array], most: int) -> str:
    """Return a text with the coordinates of the first `most` points and the number of the other points."""
    texts = [
        ", ".join(f"{name} = {value:.6g}" for name, value in zip(on_axes, point, strict=True))
        for point in zip(*on_axes.values(), strict=True)
    ]
    return "; ".join(texts[:most]) + (f" and {len(texts) - most} more" if len(texts) > most else "")


def _dataset(sample: _Sample, results: Mapping[tuple[int, int], Columns]) -> xr.Dataset:
    """Return a dataset of the results. The keys of `results` are indices of method and level."""
    scene, solution = sample.scene, sample.reference
    name, values = levels(scene.settings)
    dims, shape = ("method", "level", "sample"), (len(METHODS), len(values), sample.indices.size)
    ds = xr.Dataset(
        coords={
            "method": ("method", list(METHODS)),
            "index": ("sample", sample.indices, {"long_name": "flat index in the scene's grid"}),
            name: ("level", values, {"long_name": f"{name} of the scene's [integration]"}),
        }
    )
    for axis, on_axis in _on_axes(scene, sample.indices).items():
        ds.coords[f"axis_{axis}"] = "sample", on_axis
    registry, main = variables(scene.system), main_instrument(scene.system)
    errors = {
        f"error_{name}": (float, f"error of {name}", registry[name].units)
        for name in main.statistics(scene.system)
    }
    descriptions = VARIABLES | (OF_OBSERVABLES if main.quantity == "observables" else {})
    for variable, (dtype, long_name, units) in (errors | descriptions).items():
        rank = 2 if variable == "seconds_per_point" else 3
        column = np.full(shape[:rank], np.nan if dtype is float else 0, dtype)
        for cell, result in results.items():
            column[cell] = result[variable]
        ds[variable] = dims[:rank], column, {"long_name": long_name, "units": units}
    # The observed order is the median over the points of log(error ratio) / log(step ratio), NaN if too few points show an order.
    error, step = ds["error_state"].values, ds["step_length"].values
    order = np.full(error.shape[:2], np.nan)
    with np.errstate(all="ignore"):
        ratio = np.log(error[:, :-1] / error[:, 1:]) / np.log(step[:, :-1] / step[:, 1:])
    # Errors that are close to the uncertainty of the reference, or larger than 0.01, show no order.
    usable = (error[:, 1:] > 10 * solution.state_error) & (error[:, :-1] < 1e-2) & np.isfinite(ratio)
    for i, j in np.argwhere(usable.sum(2) >= max(2, error.shape[2] / 2)):
        order[i, j + 1] = np.median(ratio[i, j][usable[i, j]])
    ds["order"] = dims[:2], order, {"long_name": "observed order from the level before"}
    uncertainties = {"state": solution.state_error, "rates": sample.rates_uncertainty}
    uncertainties |= {name: solution.statistics_error[name] for name in main.statistics(sample.scene.system)}
    for quantity, uncertainty in uncertainties.items():
        attributes = {"long_name": f"uncertainty of the reference: error_{quantity} is never less"}
        attributes["units"] = ds[f"error_{quantity}"].units
        ds[uncertainty_name(quantity)] = "sample", uncertainty, attributes
    ds["reference_exact"] = "sample", solution.exact.astype(np.int8), {"long_name": "closed form of a family"}
    ds.attrs = {
        "atlas_points": scene.size,
        "ladder": name,
        "own_method": scene.settings.method,
        "own_level": scene_level(scene.settings),
        "measured": main.quantity,
    }
    if sample.left_out:
        ds.attrs["left_out"] = sample.left_out
    return ds


def uncertainty_name(quantity: str) -> str:
    """Return the name of the variable that holds the uncertainty of "state", of "rates" or of a statistic."""
    return "reference_error" + ("" if quantity == "state" else f"_{quantity}")


def nanmedian(values: Array) -> float:
    """Return the median of the values that are not NaN, or NaN without a warning if all values are NaN."""
    values = values[~np.isnan(values)]
    return float(np.median(values)) if values.size else math.nan


def summary(ds: xr.Dataset) -> list[dict[str, Any]]:
    """Return a row for each method and level that was run, with medians, largest values and counts over the points."""
    name, rows = ds.attrs["ladder"], []
    for method in ds["method"].values:
        for level in range(ds.sizes["level"]):
            at = ds.sel({"method": method}).isel(level=level)
            if not np.isfinite(at["seconds_per_point"]):
                continue
            compared, wrong = int(at["label_compared"].sum()), int(at["label_wrong"].sum())
            row = {
                "method": str(method),
                name: float(ds[name][level]),
                "own_setting": method == ds.attrs["own_method"] and level == ds.attrs["own_level"],
                "steps": float(at["steps"].mean()),
                "seconds_per_point": float(at["seconds_per_point"]),
                **_median_and_largest(at, "state"),
                **_median_and_largest(at, "rates"),
                "labels_unresolved": int(at["label_unresolved"].sum()),
                "labels_compared": compared,
                "labels_wrong": wrong,
                "labels_wrong_at_most": upper_bound(wrong, compared, ds.attrs["atlas_points"]),
                "integral_drift_largest": nanmax(at["integral_drift"].values),
                "order": float(at["order"]),
            }
            for statistic in _statistics(at):
                row |= _median_and_largest(at, statistic)
            rows.append(row)
    return rows


def _statistics(ds: xr.Dataset) -> list[str]:
    """Names of the statistics that were compared."""
    names = [str(name).removeprefix("error_") for name in ds.data_vars if str(name).startswith("error_")]
    return [name for name in names if name not in ("state", "rates")]


def _median_and_largest(at: xr.Dataset, quantity: str) -> dict[str, float]:
    """Return the median and the largest error of `quantity`, by the column names of the table."""
    values = at[f"error_{quantity}"].values
    return {f"error_{quantity}": nanmedian(values), f"error_{quantity}_largest": nanmax(values)}


def table(ds: xr.Dataset) -> str:
    """Return `summary` as text in CSV."""
    rows = summary(ds)
    lines = [",".join(rows[0])]
    lines += [",".join(v if isinstance(v, str) else repr(v) for v in row.values()) for row in rows]
    return "\n".join(lines) + "\n"


LEGEND = """\
us/point: processor time of a point to the end of its run, microseconds
state error: of the final state, median and largest over the points
{measured}
labels wrong: labels that differ from the reference's, of those compared (upper bound of the share, 95 % confidence)
drift: largest relative change of a first integral; order: observed from the level before
<=: the value is the uncertainty of the reference; *: the scene's own setting"""


def report(ds: xr.Dataset) -> str:
    """Return the study as plain text, with tables of the levels and of the statistics, and with advice."""
    rows = summary(ds)
    worst = attribute_text(ds["error_rates"].attrs, "long_name")
    legend = LEGEND.format(measured=f"{ds.attrs['measured']}: median {worst}")
    exact, uncertainty = int(ds["reference_exact"].sum()), ds["reference_error"].values
    lines = [
        f"{attribute_text(ds.attrs, 'title')}: {ds.sizes['sample']} of {ds.attrs['atlas_points']} points;"
        f" processor {ds.attrs['atlas_cpu']}, atlas {ds.attrs['atlas_version']}",
        f"reference: closed form at {exact} points, DOP853 at {ds.sizes['sample'] - exact};"
        f" uncertainty of its final states {nanmedian(uncertainty):.1e} (median), {uncertainty.max():.1e} (largest)",
    ]
    if "left_out" in ds.attrs:
        lines.append(f"left out: {ds.attrs['left_out']}")
    name, measured = ds.attrs["ladder"], ds.attrs["measured"]
    level_cells: list[tuple[str, ...]] = [
        ("method", name, "steps", "us/point", "state error", "largest", measured, "labels wrong", "drift", "order")
    ]  # fmt: skip
    for row in rows:
        at = _at_row(ds, row)
        level_cells.append((
            row["method"],
            f"{row[name]:.3g}" + (" *" if row["own_setting"] else ""),
            f"{row['steps']:.0f}",
            f"{1e6 * row['seconds_per_point']:.3g}",
            *_error_texts(at, "state"),
            _error_texts(at, "rates")[0],
            f"{row['labels_wrong']}/{row['labels_compared']} (<= {100 * row['labels_wrong_at_most']:.3g} %)",
            f"{row['integral_drift_largest']:.1e}",
            "-" if np.isnan(row["order"]) else f"{row['order']:.2f}",
        ))  # fmt: skip
    parts = ["\n".join(lines), text_table(level_cells, right=True), legend]
    own = next((row for row in rows if row["own_setting"]), None)
    if own is not None:
        at = _at_row(ds, own)
        cells = [("at the scene's setting", "median error", "largest", "points with a value")]
        for name in _statistics(ds):
            points = int(at[f"error_{name}"].notnull().sum())
            if points:
                cells.append((name, *_error_texts(at, name), str(points)))
        parts.append(text_table(cells, right=True))
    return "\n\n".join([*parts, advice(ds)])


def _at_row(ds: xr.Dataset, row: Mapping[str, Any]) -> xr.Dataset:
    """Return the dataset at the method and level of a row of `summary`."""
    name = ds.attrs["ladder"]
    return ds.sel({"method": row["method"]}).isel(level=int(np.abs(ds[name].values - row[name]).argmin()))


def _error_texts(at: xr.Dataset, quantity: str) -> tuple[str, str]:
    """Return the median and the largest error as text. The sign <= marks an error close to the uncertainty of the reference."""
    error = at[f"error_{quantity}"].values
    uncertainty = np.where(np.isnan(error), np.nan, at[uncertainty_name(quantity)].values)
    texts = []
    for statistic in (nanmedian, nanmax):
        resolved = statistic(error) > 3 * statistic(uncertainty)
        texts.append(("" if resolved else "<= ") + f"{statistic(error):.1e}")
    return texts[0], texts[1]


def advice(ds: xr.Dataset) -> str:
    """Return advice on the cheapest setting whose error does not exceed the scene's tolerance or, with a fixed step, the step's error."""
    name, rows, measured = ds.attrs["ladder"], summary(ds), ds.attrs["measured"]
    own = next((row for row in rows if row["own_setting"]), None)
    if name == "tolerance":
        target = float(ds["tolerance"][ds.attrs["own_level"]])
        target_text = f"a median error of {target:.3g} in states and {measured}"
    elif own is None:
        return "The scene's own step takes too many steps for a sample: no advice."
    else:
        target = _median_error(own)
        target_text = f"the scene's own median error in states and {measured}, {target:.2g}"
    # A setting is adequate only if no other setting has fewer unresolved or fewer wrong labels.
    label_errors = [(row["labels_unresolved"], row["labels_wrong"]) for row in rows]
    fewest = tuple(min(numbers) for numbers in zip(*label_errors, strict=True))
    adequate = [
        row
        for row, numbers in zip(rows, label_errors, strict=True)
        if _median_error(row) <= target and numbers == fewest
    ]
    if not adequate:
        best = min(rows, key=_median_error)
        text = (
            f"Out of reach: {target_text}. The most accurate setting, {best['method']} with {name} = {best[name]:.3g},"
            f" has {best['error_state']:.1e} in states and {best['error_rates']:.1e} in {measured}"
        )
        states, rates = (nanmedian(ds[uncertainty_name(quantity)].values) for quantity in ("state", "rates"))
        if max(states, rates) > target:
            text += f"; the uncertainty of the reference is larger than that (states {states:.1e}, {measured} {rates:.1e})"
        return f"{text}; the largest errors are at {_points_above(ds, best, target)[1]}."
    cheapest = min(adequate, key=lambda row: row["seconds_per_point"])
    return _cheapest_text(ds, cheapest, own, target, target_text)


def _median_error(row: Mapping[str, Any]) -> float:
    return max(row["error_state"], row["error_rates"])


def _cheapest_text(
    ds: xr.Dataset, row: Mapping[str, Any], own: Mapping[str, Any] | None, target: float, target_text: str
) -> str:
    """Return the advice to use the cheapest setting."""
    name = ds.attrs["ladder"]
    text = (
        f"Cheapest for {target_text}: {row['method']} with {name} = {row[name]:.3g},"
        f" {1e6 * row['seconds_per_point']:.3g} us a point"
    )
    if row["own_setting"]:
        text += ", the scene's own setting"
    elif own is not None:
        text += (
            f" (the scene's {own['method']} with {name} = {own[name]:.3g}:"
            f" {1e6 * own['seconds_per_point']:.3g} us, error {_median_error(own):.1e})"
        )
    angles = max(row.get("error_theta_min", 0.0), row.get("error_theta_max", 0.0))
    if angles > target:
        text += f"; theta_min and theta_max then have a median error of {angles:.1e}"
    above, names = _points_above(ds, row, target)
    # If steps are given, the target is a median error, which half of the points exceed.
    if above and name == "tolerance":
        text += f"; {above} of {ds.sizes['sample']} points have larger errors, the largest at {names}"
        uncertain = np.fmax(ds["reference_error"].values, ds["reference_error_rates"].values) > target
        if uncertain.any():
            text += f" (at {int(uncertain.sum())} of them the uncertainty of the reference is larger than that, too)"
    return text + "."


def _points_above(ds: xr.Dataset, row: Mapping[str, Any], target: float, most: int = 3) -> tuple[int, str]:
    """Return the number of points with an error above `target`, and a text with the worst of these points."""
    at = _at_row(ds, row)
    error = np.fmax(at["error_state"].values, at["error_rates"].values)
    above = np.flatnonzero(error > target)
    worst = above[np.argsort(-error[above])]
    axes = [str(name) for name in ds.coords if str(name).startswith("axis_")]
    on_axes = {name.removeprefix("axis_"): ds[name].values[worst] for name in axes}
    return above.size, points_text(on_axes, most)


def nanmax(values: Array) -> float:
    """Return the largest of the values that are not NaN, or NaN without a warning if all values are NaN."""
    return float(np.fmax.reduce(values))
