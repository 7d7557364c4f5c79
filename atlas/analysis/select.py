"""Parts of an atlas: its scene, its axes, the nearest point, the plane of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput
from ..scene.model import Axis, Scene
from ..scene.read import load_scene
from ..systems.base import System

MAX_PANELS = 12
# More cells than the printer has dots along an axis are not drawn: every k-th one is.
MAX_CELLS = 2000


def system_of(ds: xr.Dataset) -> System:
    """The system of an atlas; BadInput if the dataset is none."""
    if "atlas_system" not in ds.attrs:
        raise BadInput("not an atlas: the attribute atlas_system is missing")
    return systems.get(ds.attrs["atlas_system"])


def scene_of(ds: xr.Dataset) -> Scene | None:
    """The scene of an atlas, None for points of one's own."""
    text = ds.attrs.get("atlas_scene", "")
    return load_scene(text) if text else None


def axes_of(scene: Scene) -> dict[str, Axis]:
    """The axes of a scene by the name of their dimension in the atlas."""
    return {f"{a.name}_offset" if a.offset_from_family else a.name: a for a in scene.axes.values()}


def nearest(ds: xr.Dataset, select: Mapping[str, float]) -> xr.Dataset:
    """The part of an atlas nearest to the values given for some of its axes.

    Raises BadInput for a name that is no axis and for a value more than half a cell outside it.
    """
    for name, value in select.items():
        if name not in ds.dims or name not in ds.coords:
            raise BadInput(
                f"{name}: not an axis of this atlas; allowed: {', '.join(map(str, ds.sizes)) or 'none'}"
            )
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float | np.number)
            or not math.isfinite(value)
        ):
            raise BadInput(f"{name} = {value!r}: must be a finite number")
        values = ds[name].values
        place = int(np.abs(values - value).argmin())
        if values.size > 1:
            edges = cell_edges(np.sort(values))
            if not min(edges) <= value <= max(edges):
                raise BadInput(
                    f"{name} = {value:g}: outside the atlas; allowed: {values.min():g} to {values.max():g}"
                )
        ds = ds.isel({name: place})
    return ds


def cell_edges(values: np.ndarray, log: bool = False) -> np.ndarray:
    """Edges of the cells around increasing values: midway between them, on a log scale if log is true.

    Shape (values + 1,). The outer cells are as wide to the outside as to the inside.
    """
    v = np.log(values) if log else np.asarray(values, float)
    if v.size == 1:
        edges = np.array([v[0] - 0.5, v[0] + 0.5])
    else:
        middle = 0.5 * (v[1:] + v[:-1])
        edges = np.concatenate([[2 * v[0] - middle[0]], middle, [2 * v[-1] - middle[-1]]])
    return np.exp(edges) if log else edges


def flag_names(array: xr.DataArray) -> list[str]:
    """Names of the values 0, 1, 2, ... of a flag variable; empty for any other variable."""
    return str(array.attrs.get("flag_meanings", "")).split()


def plane_of(
    ds: xr.Dataset, x: str | None, y: str | None, select: Mapping[str, float]
) -> tuple[xr.Dataset, list[str], str | None]:
    """The part of an atlas that a map shows, its axes (x first) and the axis of its panels.

    Sorted along its axes; of axes longer than MOST_CELLS every k-th value. Nothing is loaded.
    """
    part = nearest(ds, select).squeeze()
    dims, panel_dim = plane_dims(part, x, y)
    part = part.isel({dim: slice(None, None, -(-part.sizes[dim] // MAX_CELLS)) for dim in dims})
    return part.sortby(dims + ([panel_dim] if panel_dim else [])), dims, panel_dim


def plane_dims(ds: xr.Dataset, x: str | None, y: str | None) -> tuple[list[str], str | None]:
    """The plotted axes, x first, and the axis of the panels if there is one."""
    every = [str(d) for d in ds.dims if d in ds.coords]
    for role, dim in (("x", x), ("y", y)):
        if dim is not None and dim not in every:
            raise BadInput(
                f"{role} = {dim!r}: not an axis with several values here; allowed: {', '.join(every) or 'none'}"
            )
    if not every or set(map(str, ds.dims)) - set(every):
        raise BadInput("this dataset has no axes to draw a map over: single points, or all axes selected")
    if x is not None and x == y:
        raise BadInput(f"x = y = {x!r}: a map needs two axes")
    longest = sorted((d for d in every if d not in (x, y)), key=lambda d: -ds.sizes[d])
    room = (x is None) + (y is None)
    chosen, longest = sorted(longest[:room], key=every.index), longest[room:]
    if x is None and chosen:
        x = chosen.pop(0)
    if y is None and chosen:
        y = chosen.pop(0)
    for dim in longest:
        if len(longest) > 1 or ds.sizes[dim] > MAX_PANELS:
            raise BadInput(
                f"{dim} has {ds.sizes[dim]} values here: choose one by select = {{{dim!r}: value}}"
            )
    return [d for d in (x, y) if d is not None], (longest[0] if longest else None)
