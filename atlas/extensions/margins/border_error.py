"""Errors of a map's borders, measured by cell sizes, distances to curves of theory, and labels that change if the time step is halved."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ...analysis.boundary import boundary
from ...analysis.degrees import DEGREE, factor
from ...analysis.metadata import (
    flag_names,
    flag_variable,
    has_flags,
    is_logarithmic,
    number_attribute,
    scene_of,
    scene_problem,
    system_of,
)
from ...analysis.select import plane_of
from ...errors import BadInput, attribute_text
from ...flags import Status
from ...systems.base import Array, families_of

BORDER = ["first", "second", "curve"]  # flags on both sides of a border, kind of the nearest curve of theory
# Variable with the dimensions border and axis -> column of the table of pairs of neighbours, and statistic of this column.
OF_AXES = {
    "pairs": ("half", "count"),
    "half_cell": ("half", "max"),
    "distance_median": ("distance", "median"),
    "distance_largest": ("distance", "max"),
}


class BorderError(xr.Dataset):
    """Borders of a map and their errors. `str` turns this dataset into a sentence about the borders."""

    __slots__ = ()

    def __str__(self) -> str:
        borders = self if "border" in self.dims else self.expand_dims("border")
        texts = [_about(borders.isel(border=i)) for i in range(borders.sizes["border"])]
        texts = texts or ["there is no border"]
        if "points_checked" in self:
            changed = f"{int(self['points_changed'])} of {int(self['points_checked'])}"
            texts.append(f"{changed} points of the whole run checked at half the step changed their label")
        text = "; ".join(texts)
        return f"{text[0].upper()}{text[1:]}."


def _about(border: xr.Dataset) -> str:
    def lengths(name: str) -> str:
        of_axes = zip(border[name].values, border["unit"].values, border["axis"].values, strict=True)
        texts = (f"{size:.2g} {unit} in {axis}" for size, unit, axis in of_axes if np.isfinite(size))
        return " and ".join(texts).replace(" 1 in ", " in ")

    text = f"the border between {border['first'].item()} and {border['second'].item()}".replace("_", " ")
    text += f" is known to half a cell, {lengths('half_cell')}"
    if curve := border["curve"].item():
        median, largest = lengths("distance_median"), lengths("distance_largest")
        text += f", and differs from theory's {curve} by {median} in the median and at most {largest}"
    else:
        text += ", with no curve of theory beside it"
    if "sensitive" in border:
        counts = f"{int(border['sensitive'])} of {int(border['checked'])}"
        text += f", where {counts} points are sensitive to the step"
    return text


def border_error(
    ds: xr.Dataset,
    variable: str = "label",
    *,
    x: str | None = None,
    y: str | None = None,
    select: Mapping[str, float] | None = None,
    degrees: bool = False,
) -> BorderError:
    """How sure the borders of a map are: half a cell, the distance from theory, and the effect of halving the step.

    Parameters
    ----------
    variable : str, optional
        A flag variable, or one of whole numbers such as equilibrium_count; default label.
    x, y : str, optional
        Axes, as in `map`.
    select : mapping of str to float, optional
        Axis -> value, for the other axes.
    degrees : bool, optional
        Take and return angles in degrees.

    Returns
    -------
    Dataset
        `str` of the dataset, or of a part such as ``.isel(border=0)``, is a sentence to cite. The longest border is first. Over
        "border" there are `first` and `second` (flags on the two sides) and `curve` (kind of the nearest line of `boundary()`).
        Over "border" and "axis" there are `pairs` (number of pairs of neighbouring points across the border), `half_cell`,
        `distance_median` and `distance_largest` (from the middle of a pair to the curve). `points_checked` counts the points of the
        whole run that were checked at half the step, and `points_changed` counts the checked points whose label changed. With
        check_half_step = "all", `checked` counts the points beside the border, and `sensitive` counts those that depend on the step.
    """
    plane, dims, panels = plane_of(ds, x, y, select or {}, degrees=degrees)
    for dim in panels:
        raise BadInput(f"{dim} has {plane.sizes[dim]} values here: choose one by select")
    array = plane.data_vars.get(variable)
    is_number = array is not None and array.dtype.kind in "iuf" and not has_flags(array)
    if array is not None and is_number and not (array % 1 > 0).any():  # for example a number of equilibria
        array = array.fillna(-1)
    else:
        array = flag_variable(plane, variable)
    names, array = flag_names(array), array.transpose(*dims)
    scene = None if scene_problem(ds, plane) else scene_of(plane)
    logs = [dim for dim in dims if is_logarithmic(scene, dim, plane[dim].values)]
    lines = None
    if scene is not None and families_of(scene.system):
        lines = boundary(plane, None, variable, dims[0], dims[1] if len(dims) > 1 else None, {})
    rows, titles, units = [], [], []
    numbers = np.arange(array.size).reshape(array.shape)
    for i, dim in enumerate(dims):
        at, unit = plane[dim].values.astype(float), factor(plane[dim].attrs, degrees)
        is_own = dim not in system_of(ds).parameters
        titles.append(attribute_text(plane[dim].attrs, "long_name", dim) if is_own else dim)
        units.append(DEGREE if unit != 1 else attribute_text(plane[dim].attrs, "units", "1"))
        middle = np.sqrt(at[1:] * at[:-1]) if dim in logs else 0.5 * (at[1:] + at[:-1])
        half = np.maximum(middle - at[:-1], at[1:] - middle)
        flags, index = (np.moveaxis(each, i, 0).reshape(at.size, -1) for each in (array.values, numbers))
        for row in np.flatnonzero((flags[1:] != flags[:-1]).any(0)):
            across = [(other, float(plane[other][row])) for other in dims if other != dim]
            places, kinds = _crossings(lines, dim, across, logs)
            for j in np.flatnonzero(flags[1:, row] != flags[:-1, row]):
                distance = np.append(np.abs(places - middle[j]), np.inf)
                k = int(distance.argmin())
                sides = sorted(flags[j : j + 2, row].tolist())
                pair = [names[side] if names else f"{side:g}" if side >= 0 else "no value" for side in sides]
                border = *pair, str(kinds[k]) if k < len(kinds) else ""
                rows.append((*border, dim, unit * half[j], unit * distance[k], *index[j : j + 2, row]))
    frame = pd.DataFrame(rows, columns=[*BORDER, "axis", "half", "distance", "low", "high"])
    frame = frame.replace({"distance": np.inf}, np.nan)
    groups = sorted(frame.groupby(BORDER), key=lambda group: -len(group[1]))
    columns: dict[str, Any] = {
        name: ("border", [group[0][i] for group in groups]) for i, name in enumerate(BORDER)
    }
    for name, (column, statistic) in OF_AXES.items():
        own = [
            [getattr(part[column][part["axis"] == dim], statistic)() for dim in dims] for _, part in groups
        ]
        columns[name] = ("border", "axis"), np.reshape(own, (-1, len(dims)))
    if scene is not None and scene.settings.check_half_step == "all" and "status" in plane:
        sensitive = plane["status"].transpose(*dims).values.ravel() == Status.STEP_SENSITIVE
        beside = [np.unique(part[["low", "high"]]) for _, part in groups]
        columns["checked"] = "border", [each.size for each in beside]
        columns["sensitive"] = "border", [int(sensitive[each].sum()) for each in beside]
    if "atlas_half_step_points" in ds.attrs:
        columns["points_checked"] = (), number_attribute(ds, "atlas_half_step_points")
        columns["points_changed"] = (), number_attribute(ds, "atlas_half_step_changed")
    title = f"borders of {variable} in {attribute_text(plane.attrs, 'title', 'an atlas')!r}"
    return BorderError(columns, {"axis": titles, "unit": ("axis", units)}, {"title": title})


def _crossings(
    lines: xr.Dataset | None, dim: str, across: Sequence[tuple[str, float]], logs: Collection[str]
) -> tuple[Array, np.ndarray]:
    """Return where lines cross a row of points along `dim`, and the kinds of the lines. `across` has the row's value of any other axis."""
    if lines is None:
        return np.zeros(0), np.zeros(0, str)
    place, kinds = lines[dim].values, lines["kind"].values
    for other, value in across:
        within = lines["line"].values[1:] == lines["line"].values[:-1]
        along, beside = (np.log(lines[n].values) if n in logs else lines[n].values for n in (dim, other))
        beside = beside - (np.log(value) if other in logs else value)
        crossed = np.flatnonzero(within & (beside[1:] * beside[:-1] <= 0) & (beside[1:] != beside[:-1]))
        share = beside[crossed] / (beside[crossed] - beside[crossed + 1])
        place, kinds = along[crossed] + share * (along[crossed + 1] - along[crossed]), kinds[crossed]
        place = np.exp(place) if dim in logs else place
    return place, kinds
