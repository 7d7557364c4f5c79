"""How sure the borders of a map are: cells across them, curves of theory beside them, and what half the step changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..errors import BadInput, attribute_text
from ..flags import Status
from ..systems.base import Array, families_of
from .boundary import boundary
from .degrees import DEGREE, factor
from .metadata import (
    flag_names,
    flag_variable,
    has_flags,
    is_logarithmic,
    number_attribute,
    scene_of,
    scene_problem,
    system_of,
)
from .select import plane_of

# Variables of borders and what they are; of each axis also the column of its pairs of neighbours and a statistic of it.
BORDER = {
    "first": "flag on one side",
    "second": "flag on the other side",
    "curve": "nearest curve of theory",
}
OF_AXES = {
    "pairs": ("half", "count", "pairs of neighbours on both sides of the border"),
    "half_cell": ("half", "max", "largest half of a cell across the border"),
    "distance_median": ("distance", "median", "median distance of the border from the curve"),
    "distance_largest": ("distance", "max", "largest distance of the border from the curve"),
}
WHOLE = {"checked": "points", "changed": "changed"}


class BorderError(xr.Dataset):
    """Borders of a map, whose `str` is a sentence about them."""

    __slots__ = ()

    def __str__(self) -> str:
        borders = self if "border" in self.dims else self.expand_dims("border")
        texts = [_about(borders.isel(border=i)) for i in range(borders.sizes["border"])] or [
            "there is no border"
        ]
        if "points_checked" in self:
            changed = f"{int(self['points_changed'])} of {int(self['points_checked'])}"
            texts.append(f"{changed} points of the whole run checked at half the step changed their label")
        text = "; ".join(texts)
        return f"{text[0].upper()}{text[1:]}."


def _about(border: xr.Dataset) -> str:
    """Words about one border."""

    def lengths(name: str) -> str:
        units = ("" if unit == "1" else f" {unit}" for unit in border["unit"].values)
        of_axes = zip(border[name].values, units, border["axis"].values, strict=True)
        return " and ".join(
            f"{size:.2g}{unit} in {axis}" for size, unit, axis in of_axes if np.isfinite(size)
        )

    text = f"the border between {border['first'].item()} and {border['second'].item()}"
    text = f"{text.replace('_', ' ')} is known to half a cell, {lengths('half_cell')}"
    if curve := border["curve"].item():
        text += (
            f", and differs from theory's {curve} by {lengths('distance_median')} in the median and at most"
        )
        text += f" {lengths('distance_largest')}"
    else:
        text += ", with no curve of theory beside it"
    if "sensitive" in border:
        text += (
            f", where {int(border['sensitive'])} of {int(border['checked'])} points are sensitive to the step"
        )
    return text


def border_error(
    ds: xr.Dataset, variable: str, x: str | None, y: str | None, select: Mapping[str, float], degrees: bool
) -> BorderError:
    """Borders between the flags of a variable with their errors; see `Atlas.border_error`."""
    plane, dims, panels = plane_of(ds, x, y, select, degrees=degrees)
    for dim in panels:
        raise BadInput(f"{dim} has {plane.sizes[dim]} values here: choose one by select")
    if variable in plane and not has_flags(plane[variable]) and not (plane[variable] % 1 > 0).any():
        array = plane[variable].fillna(-1)  # numbers, such as those of equilibria
    else:
        array = flag_variable(plane, variable)
    names, array = flag_names(array), array.transpose(*dims)
    scene = None if scene_problem(ds, plane) else scene_of(plane)
    logs = [dim for dim in dims if is_logarithmic(scene, dim, plane[dim].values)]
    lines = None
    if scene is not None and families_of(scene.system):
        lines = boundary(plane, None, variable, dims[0], dims[1] if len(dims) > 1 else None, {})
    rows, numbers = [], np.arange(array.size).reshape(array.shape)
    for i, dim in enumerate(dims):
        at = plane[dim].values.astype(float)
        middle = np.sqrt(at[1:] * at[:-1]) if dim in logs else 0.5 * (at[1:] + at[:-1])
        half = np.maximum(middle - at[:-1], at[1:] - middle)
        flags, index = (np.moveaxis(each, i, 0).reshape(at.size, -1) for each in (array.values, numbers))
        for row in np.flatnonzero((flags[1:] != flags[:-1]).any(0)):
            across = [(other, float(plane[other][row])) for other in dims if other != dim]
            places, kinds = _crossings(lines, dim, across, logs)
            for j in np.flatnonzero(flags[1:, row] != flags[:-1, row]):
                distance = np.abs(places - middle[j])
                k = int(np.argmin(distance)) if distance.size else None
                nearest = ("", np.nan) if k is None else (str(kinds[k]), distance[k])
                sides = sorted(flags[j : j + 2, row].tolist())
                pair = [names[side] if names else f"{side:g}" if side >= 0 else "no value" for side in sides]
                rows.append((*pair, *nearest, dim, half[j], index[j, row], index[j + 1, row]))
    frame = pd.DataFrame(rows, columns=[*BORDER, "distance", "axis", "half", "low", "high"])
    groups = sorted(frame.groupby(list(BORDER)), key=lambda group: -len(group[1]))
    factors = [factor(plane[dim].attrs, degrees) for dim in dims]
    columns: dict[str, Any] = {
        name: ("border", np.array([group[0][i] for group in groups], str), {"long_name": text})
        for i, (name, text) in enumerate(BORDER.items())
    }
    for name, (column, statistic, text) in OF_AXES.items():
        own = [
            [getattr(part[column][part["axis"] == dim], statistic)() for dim in dims] for _, part in groups
        ]
        values = np.reshape(own, (-1, len(dims))) * ([1] * len(dims) if name == "pairs" else factors)
        columns[name] = ("border", "axis"), values, {"long_name": text}
    if scene is not None and scene.settings.check_half_step == "all" and "status" in plane:
        sensitive = plane["status"].transpose(*dims).values.ravel() == Status.STEP_SENSITIVE
        beside = [np.unique(part[["low", "high"]]) for _, part in groups]
        columns["checked"] = (
            "border",
            [each.size for each in beside],
            {"long_name": "points beside the border"},
        )
        text = "those of them whose label changes, or could change, at half the step"
        columns["sensitive"] = "border", [int(sensitive[each].sum()) for each in beside], {"long_name": text}
    if "atlas_half_step_points" in ds.attrs:
        columns |= {
            f"points_{what}": ((), number_attribute(ds, f"atlas_half_step_{name}"))
            for what, name in WHOLE.items()
        }
    attributes = [plane[dim].attrs for dim in dims]
    units = [
        DEGREE if f != 1 else attribute_text(a, "units", "1")
        for f, a in zip(factors, attributes, strict=True)
    ]
    known = system_of(ds).parameters
    titles = [
        dim if dim in known else attribute_text(a, "long_name", dim)
        for dim, a in zip(dims, attributes, strict=True)
    ]
    title = f"borders of {variable} in {attribute_text(plane.attrs, 'title', 'an atlas')!r}"
    return BorderError(columns, {"axis": titles, "unit": ("axis", units)}, {"title": title})


def _crossings(
    lines: xr.Dataset | None, dim: str, across: Sequence[tuple[str, float]], logs: Collection[str]
) -> tuple[Array, np.ndarray]:
    """Places along an axis where lines cross a row of points, at a value of the other axis, and the kinds of the lines."""
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
