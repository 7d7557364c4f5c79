"""Tables and text of a work-precision study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from ..errors import attribute_text
from ..systems.base import Array
from .half_step import upper_bound
from .text_table import text_table
from .work_precision import nanmedian, points_text, uncertainty_name


def summary(ds: xr.Dataset) -> list[dict[str, Any]]:
    """Medians and largest values over the points, one row for each method and level that was run."""
    name, rows = ds.attrs["ladder"], []
    for method in ds["method"].values:
        for level in range(ds.sizes["level"]):
            at = ds.sel({"method": method}).isel(level=level)
            if np.isfinite(at["seconds_per_point"]):
                own = method == ds.attrs["own_method"] and level == ds.attrs["own_level"]
                setting = {"method": str(method), name: float(ds[name][level]), "own_setting": own}
                rows.append(setting | _summary_of_level(at, ds.attrs["atlas_points"]))
    return rows


def _summary_of_level(at: xr.Dataset, atlas_points: int) -> dict[str, Any]:
    """Medians, largest values and counts of one method at one level."""
    compared, wrong = int(at["label_compared"].sum()), int(at["label_wrong"].sum())
    row = {
        "steps": float(at["steps"].mean()),
        "seconds_per_point": float(at["seconds_per_point"]),
        **_median_and_largest(at, "state"),
        **_median_and_largest(at, "rates"),
        "labels_unresolved": int(at["label_unresolved"].sum()),
        "labels_compared": compared,
        "labels_wrong": wrong,
        "labels_wrong_at_most": upper_bound(wrong, compared, atlas_points),
        "integral_drift_largest": nanmax(at["integral_drift"].values),
        "order": float(at["order"]),
    }
    for name in _statistics(at):
        row |= _median_and_largest(at, name)
    return row


def _statistics(ds: xr.Dataset) -> list[str]:
    """Names of the statistics that were compared."""
    names = [str(name).removeprefix("error_") for name in ds.data_vars if str(name).startswith("error_")]
    return [name for name in names if name not in ("state", "rates")]


def _median_and_largest(at: xr.Dataset, quantity: str) -> dict[str, float]:
    """Median and largest error of the states, the rates or a statistic, by the names of the table."""
    values = at[f"error_{quantity}"].values
    return {f"error_{quantity}": nanmedian(values), f"error_{quantity}_largest": nanmax(values)}


def table(ds: xr.Dataset) -> str:
    """`summary` as CSV."""
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

MEASURED = {
    "rates": "rates: median error of the least accurate mean, rms or standard deviation of a rate, over the frequency bound",
    "observables": "observables: median error of the least accurate statistic of an observable, over its largest magnitude",
}


def report(ds: xr.Dataset) -> str:
    """The study as plain text: header, table of the levels, table of the statistics, advice."""
    rows = summary(ds)
    legend = LEGEND.format(measured=MEASURED[ds.attrs["measured"]])
    parts = [_header(ds), _levels_table(ds, rows), legend, _statistics_table(ds, rows), advice(ds)]
    return "\n\n".join(part for part in parts if part)


def _header(ds: xr.Dataset) -> str:
    """Lines about the sample, the processor and the reference."""
    exact, uncertainty = int(ds["reference_exact"].sum()), ds["reference_error"].values
    lines = [
        f"{attribute_text(ds.attrs, 'title')}: {ds.sizes['sample']} of {ds.attrs['atlas_points']} points;"
        f" processor {ds.attrs['atlas_cpu']}, atlas {ds.attrs['atlas_version']}",
        f"reference: closed form at {exact} points, DOP853 at {ds.sizes['sample'] - exact};"
        f" uncertainty of its final states {nanmedian(uncertainty):.1e} (median), {uncertainty.max():.1e} (largest)",
    ]
    if "left_out" in ds.attrs:
        lines.append(f"left out: {ds.attrs['left_out']}")
    return "\n".join(lines)


def _levels_table(ds: xr.Dataset, rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each method and level that was run."""
    name, measured = ds.attrs["ladder"], ds.attrs["measured"]
    cells: list[tuple[str, ...]] = [
        ("method", name, "steps", "us/point", "state error", "largest", measured, "labels wrong", "drift", "order")
    ]  # fmt: skip
    for row in rows:
        at = _at_row(ds, row)
        cells.append(
            (
                row["method"],
                f"{row[name]:.3g}" + (" *" if row["own_setting"] else ""),
                f"{row['steps']:.0f}",
                f"{1e6 * row['seconds_per_point']:.3g}",
                *_error_texts(at, "state"),
                _error_texts(at, "rates")[0],
                f"{row['labels_wrong']}/{row['labels_compared']} (<= {100 * row['labels_wrong_at_most']:.3g} %)",
                f"{row['integral_drift_largest']:.1e}",
                "-" if np.isnan(row["order"]) else f"{row['order']:.2f}",
            )
        )
    return text_table(cells, right=True)


def _statistics_table(ds: xr.Dataset, rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each statistic at the scene's own setting; empty if that was not run."""
    own = _own_row(rows)
    if own is None:
        return ""
    at = _at_row(ds, own)
    cells = [("at the scene's setting", "median error", "largest", "points with a value")]
    for name in _statistics(ds):
        points = int(at[f"error_{name}"].notnull().sum())
        if points:
            cells.append((name, *_error_texts(at, name), str(points)))
    return text_table(cells, right=True)


def _own_row(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """The row of the scene's own setting, None if that was not run."""
    return next((row for row in rows if row["own_setting"]), None)


def _at_row(ds: xr.Dataset, row: Mapping[str, Any]) -> xr.Dataset:
    """The dataset at the method and level of a row of the summary."""
    name = ds.attrs["ladder"]
    return ds.sel({"method": row["method"]}).isel(level=int(np.abs(ds[name].values - row[name]).argmin()))


def _error_texts(at: xr.Dataset, quantity: str) -> tuple[str, str]:
    """Median and largest error, with <= where it is close to the uncertainty of the reference."""
    error = at[f"error_{quantity}"].values
    uncertainty = np.where(np.isnan(error), np.nan, at[uncertainty_name(quantity)].values)
    texts = []
    for statistic in (nanmedian, nanmax):
        resolved = statistic(error) > 3 * statistic(uncertainty)
        texts.append(("" if resolved else "<= ") + f"{statistic(error):.1e}")
    return texts[0], texts[1]


def advice(ds: xr.Dataset) -> str:
    """Which method and level reach the scene's tolerance at the least cost, in one sentence.

    A scene with a step has no tolerance; the target is then the median error of its own setting.
    """
    name, rows, measured = ds.attrs["ladder"], summary(ds), ds.attrs["measured"]
    own = _own_row(rows)
    if name == "tolerance":
        target = float(ds["tolerance"][ds.attrs["own_level"]])
        target_text = f"a median error of {target:.3g} in states and {measured}"
    elif own is None:
        return "The scene's own step takes too many steps for a sample: no advice."
    else:
        target = _median_error(own)
        target_text = f"the scene's own median error in states and {measured}, {target:.2g}"
    # A setting must not lose a label, nor get one wrong, that another setting gives.
    label_errors = [(row["labels_unresolved"], row["labels_wrong"]) for row in rows]
    fewest = tuple(min(numbers) for numbers in zip(*label_errors, strict=True))
    adequate = [
        row
        for row, numbers in zip(rows, label_errors, strict=True)
        if _median_error(row) <= target and numbers == fewest
    ]
    if not adequate:
        return _out_of_reach_text(ds, min(rows, key=_median_error), target, target_text)
    cheapest = min(adequate, key=lambda row: row["seconds_per_point"])
    return _cheapest_text(ds, cheapest, own, target, target_text)


def _median_error(row: Mapping[str, Any]) -> float:
    """The larger one of the median errors of states and rates."""
    return max(row["error_state"], row["error_rates"])


def _out_of_reach_text(ds: xr.Dataset, best: Mapping[str, Any], target: float, target_text: str) -> str:
    """Advice where no setting reaches the target: the most accurate one."""
    name, measured = ds.attrs["ladder"], ds.attrs["measured"]
    text = (
        f"Out of reach: {target_text}. The most accurate setting, {best['method']} with {name} = {best[name]:.3g},"
        f" has {best['error_state']:.1e} in states and {best['error_rates']:.1e} in {measured}"
    )
    states, rates = (nanmedian(ds[uncertainty_name(quantity)].values) for quantity in ("state", "rates"))
    if max(states, rates) > target:
        text += f"; the uncertainty of the reference is larger than that (states {states:.1e}, {measured} {rates:.1e})"
    return f"{text}; the largest errors are at {_points_above(ds, best, target)[1]}."


def _cheapest_text(
    ds: xr.Dataset, row: Mapping[str, Any], own: Mapping[str, Any] | None, target: float, target_text: str
) -> str:
    """Advice where some settings reach the target: the cheapest one."""
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
    if above and name == "tolerance":  # half of the points are above a median
        text += f"; {above} of {ds.sizes['sample']} points have larger errors, the largest at {names}"
        uncertain = np.fmax(ds["reference_error"].values, ds["reference_error_rates"].values) > target
        if uncertain.any():
            text += f" (at {int(uncertain.sum())} of them the uncertainty of the reference is larger than that, too)"
    return text + "."


def _points_above(ds: xr.Dataset, row: Mapping[str, Any], target: float, most: int = 3) -> tuple[int, str]:
    """Number of points whose error in states or rates (or observables) is above the target, and the worst of them in words."""
    at = _at_row(ds, row)
    error = np.fmax(at["error_state"].values, at["error_rates"].values)
    above = np.flatnonzero(error > target)
    worst = above[np.argsort(-error[above])]
    axes = [str(name) for name in ds.coords if str(name).startswith("axis_")]
    on_axes = {name.removeprefix("axis_"): ds[name].values[worst] for name in axes}
    return above.size, points_text(on_axes, most)


def nanmax(values: Array) -> float:
    """Largest of the values that are not NaN; NaN, without a warning, if there are none."""
    return float(np.fmax.reduce(values))
