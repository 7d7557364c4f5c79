"""Selection of points of an atlas by flags, by nearness to given values, or on the plane of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..errors import BadInput, allowed_text, option, shown
from ..scene.model import Duration
from ..scene.tables import check_written
from .degrees import factor, in_degrees
from .metadata import (
    CHANGED,
    axes_of,
    axis_values,
    check_not_empty,
    chunks,
    flag_names,
    flag_values,
    flags_of,
    has_flags,
    in_order,
    is_averaged,
    is_logarithmic,
    is_numeric_axis,
    numeric_coordinates,
    resolved_scene,
    scene_of,
    settings_of,
    system_of,
)

if TYPE_CHECKING:
    import pandas as pd

MAX_PANELS = 12
# Largest number of values of an axis on a map, about as many as a printer can show. Of a longer axis, every k-th value is shown.
MAX_CELLS = 2000


def select(
    ds: xr.Dataset, flags: Mapping[str, str | int | Sequence[str | int]], degrees: bool = False
) -> xr.Dataset:
    """Return the points with given flags, in memory, along the dimension "point"; see `Atlas.select`."""
    flag_numbers = {variable: flag_values(ds, variable, names) for variable, names in flags.items()}
    if not flag_numbers:
        raise BadInput("select: name at least one flag, such as label='drifting'")
    first, *others = flag_numbers
    for name in others:
        if set(ds[name].dims) != set(ds[first].dims):
            raise BadInput(f"{first} and {name} lie along different dimensions: not an atlas")
    if not ds[first].dims:
        ds = ds.expand_dims("point")
    dims = [str(dim) for dim in ds[first].dims]
    selected: list[xr.Dataset] = []
    for box in chunks(ds.sizes, dims):
        chunk = ds.isel(box)
        mask = np.ones([chunk.sizes[dim] for dim in dims], bool)
        for variable, values in flag_numbers.items():
            mask &= np.isin(chunk[variable].transpose(*dims).values, values)
        if mask.any():
            indices = dict(zip(dims, np.nonzero(mask), strict=True))
            pointwise = {dim: xr.DataArray(index, dims="point") for dim, index in indices.items()}
            selected.append(in_degrees(chunk.isel(pointwise).load(), degrees))
    if not selected:  # old versions of xarray fail to read an empty selection
        nothing = dict.fromkeys(dims, xr.DataArray(np.zeros(0, int), dims="point"))
        return in_degrees(ds.isel(dict.fromkeys(dims, slice(0, 1))).load().isel(nothing), degrees)
    if len(selected) == 1:
        return selected[0]
    return xr.concat(
        selected, "point", data_vars="minimal", coords="minimal", compat="override", combine_attrs="override"
    )


def to_dataframe(ds: xr.Dataset, degrees: bool) -> pd.DataFrame:
    """Return the points as a pandas DataFrame with flags as categories; see `Atlas.to_dataframe`."""
    from pandas import Categorical

    ds = in_degrees(ds if ds.dims else ds.expand_dims("point"), degrees)
    frame = ds.to_dataframe()
    for name, array in ds.items():
        if array.dtype.kind != "b" and has_flags(array):
            names = flag_names(array)
            flags_of(ds, str(name), len(names))
            frame[name] = Categorical.from_codes(frame[name].to_numpy(), names)
    return frame


def nearest(ds: xr.Dataset, values: Mapping[str, float], degrees: bool = False) -> xr.Dataset:
    """Return the part of an atlas nearest to `values` of axes or, among single points, of parameters; see `Atlas.nearest`."""
    if "point" not in ds.dims or not values:
        return nearest_on_axes(ds, values, degrees)
    check_not_empty(ds)
    distance = np.zeros(ds.sizes["point"])
    allowed = numeric_coordinates(ds, "point")
    for name, value in values.items():
        if name not in allowed:
            scene_of(ds, needed=True)  # raises BadInput for joined atlases
            raise BadInput(f"{name}: does not vary over these points; {allowed_text(name, allowed)}")
        column, value = ds[name].values * factor(ds[name].attrs, degrees), _number(name, value)
        finite = column[np.isfinite(column)]
        if not finite.size:
            raise BadInput(f"{name}: is not given at any of these points")
        # The distance in each parameter is divided by its range over the points.
        distance += ((column - value) / (np.ptp(finite) or 1.0)) ** 2
    if np.isnan(distance).all():
        raise BadInput(f"{', '.join(values)}: no point has values of all of them")
    return ds.isel(point=int(np.nanargmin(distance)))


def _number(name: str, value: object) -> float:
    """Return the value of an axis or parameter as a float. Raise BadInput unless the value is a finite number."""
    check_written(name, value)
    array = np.asarray(value)
    if array.ndim or array.dtype.kind not in "iuf" or not np.isfinite(array):
        raise BadInput(f"{name} = {shown(value)}: must be a finite number")
    return float(array)


def nearest_on_axes(ds: xr.Dataset, values: Mapping[str, float], degrees: bool = False) -> xr.Dataset:
    """Return the part of an atlas nearest to axis values. Raise BadInput if a name is no axis, or a value is outside the axis's cells."""
    check_not_empty(ds)
    axes = [str(dim) for dim in ds.dims if is_numeric_axis(ds, dim)]
    scene = scene_of(ds) if values else None
    # NCO writes cell_methods even on joined data. Once a point of the joined axis is chosen, such data would look like averages.
    sound = {n for n, a in ds.data_vars.items() if "cell_methods" in a.attrs and not is_averaged(a)}
    for name, value in values.items():
        if name not in axes:
            problem = "has no values in this dataset" if name in ds.dims else "not an axis of this atlas"
            raise BadInput(f"{name}: {problem}; {allowed_text(name, axes)}")
        value = _number(name, value)
        axis = ds[name].values * factor(ds[name].attrs, degrees)
        if axis.size > 1:
            log = is_logarithmic(scene, name, axis)
            edges = cell_edges(np.sort(axis), log)
            if not edges[0] <= value <= edges[-1]:
                raise BadInput(
                    f"{name} = {value:g}: outside the atlas; allowed: {axis.min():g} to {axis.max():g}"
                )
            axis, value = (np.log(axis), math.log(value)) if log else (axis, value)
        ds = ds.isel({name: int(np.lexsort((axis, np.abs(axis - value)))[0])})
    ds = ds.copy() if sound else ds
    for each in sound:
        ds[each].attrs.pop("cell_methods")
    return ds


def cell_edges(values: np.ndarray, log: bool = False) -> np.ndarray:
    """Return edges of cells around increasing values. Inner edges are midway between values, and end values are centred in their cells."""
    v = np.log(values) if log else np.asarray(values, float)
    if v.size == 1:
        edges = np.array([v[0] - 0.5, v[0] + 0.5])
    else:
        middle = 0.5 * (v[1:] + v[:-1])
        edges = np.concatenate([[2 * v[0] - middle[0]], middle, [2 * v[-1] - middle[-1]]])
    return np.exp(edges) if log else edges


def check_axes(allowed: Sequence[str], what: str, **chosen: str | None) -> None:
    """Raise BadInput unless the chosen axes of a map are distinct and allowed. The message describes an allowed axis as `what`."""
    roles: dict[str, str] = {}
    for role, name in chosen.items():
        if name is not None and name not in allowed:
            raise BadInput(f"{role} = {shown(name)}: not {what}; {allowed_text(name, allowed)}")
        if name in roles:
            raise BadInput(f"{roles[name]} = {role} = {shown(name)}: each must be another axis")
        if name is not None:
            roles[name] = role


def check_panels(what: str, count: int) -> None:
    """Raise BadInput for more panels than a figure may have."""
    if count > MAX_PANELS:
        raise BadInput(f"{what} are {count} panels; allowed: at most {MAX_PANELS}")


def plane_of(
    ds: xr.Dataset,
    x: str | None,
    y: str | None,
    select: Mapping[str, float],
    row: str | None = None,
    col: str | None = None,
    *,
    degrees: bool = False,
) -> tuple[xr.Dataset, list[str], list[str]]:
    """Return the plane that a map shows, the axes of the map (x first) and the axes of panels; see `Atlas.map`.

    The plane is sorted along its axes and not loaded into memory. If `degrees` is true, only the angles in `select` are in degrees.
    """
    check_not_empty(ds)
    plane = nearest_on_axes(ds, select, degrees).squeeze()
    axes = [str(d) for d in plane.dims if is_numeric_axis(plane, d)]
    check_axes(axes, "an axis with several values here", x=x, y=y, row=row, col=col)
    unnumbered = [str(dim) for dim in plane.dims if dim not in axes]
    if not axes or unnumbered:
        scene_of(ds)  # raises BadInput for joined atlases
        raise BadInput(
            f"{unnumbered[0]}: has no numbers as coordinate; choose one by isel, or draw names by col={unnumbered[0]!r}"
            if axes
            else "this dataset has no axes to draw a map over: single points, or all axes selected"
        )
    by_length = sorted((d for d in axes if d not in (x, y, row, col)), key=lambda d: -plane.sizes[d])
    n_free = (x is None) + (y is None)
    chosen, others = sorted(by_length[:n_free], key=axes.index), by_length[n_free:]
    panel_dims = [dim for dim in (row, col) if dim is not None]
    for dim in others:
        if len(others) > 1 or panel_dims or plane.sizes[dim] > MAX_PANELS:
            raise BadInput(
                f"{dim} has {plane.sizes[dim]} values here: choose one by {option('select', {dim: 'VALUE'})}"
            )
    panel_dims = panel_dims or others
    check_panels(" x ".join(panel_dims), math.prod(plane.sizes[dim] for dim in panel_dims))
    dims = [name or chosen.pop(0) for name in (x, y) if name or chosen]
    for dim in dims:
        if not 0 < np.ptp(plane[dim].values) < np.inf:
            raise BadInput(f"{dim}: its values are equal or not finite: no axis to draw a map over")
    stride = {dim: -(-plane.sizes[dim] // MAX_CELLS) for dim in dims} | dict.fromkeys(panel_dims, 1)
    return in_order(plane, stride), dims, panel_dims


def nearest_trajectory(
    ds: xr.Dataset, coordinates: Mapping[str, float], samples: int, degrees: bool = False
) -> xr.Dataset:
    """Return the motion of the point nearest to given values, with angles in rad. The motion is integrated as in the atlas."""
    from ..label.plan import Plan
    from ..label.trajectory import trajectory_of_point, trajectory_of_scene

    system = system_of(ds)
    point = nearest(ds, coordinates, degrees).squeeze()
    scene = resolved_scene(ds, point)
    if scene is not None:
        axes = {dim: axis for dim, axis in axes_of(scene).items() if not point[dim].ndim}
        values = {axis.name: float(axis_values(point[dim].values, axis)) for dim, axis in axes.items()}
        return trajectory_of_scene(scene, values, samples=samples)
    if "atlas_scene" not in ds.attrs:
        raise BadInput(f"trajectory: the attribute atlas_scene with the scene is missing: {CHANGED}")
    if point.dims:
        raise BadInput("trajectory: these are several points; name the point by values of its parameters")
    if "end_time" not in point:
        raise BadInput("end_time: not in this dataset; a trajectory needs it to end where the point did")
    for name, parameter in system.parameters.items():
        if name not in point.coords and not math.isnan(parameter.default):
            raise BadInput(f"{name}: this parameter of the point is not in the dataset")
    start = {name: float(point[name]) for name in system.parameters if name in point.coords}
    given = {name: value for name, value in start.items() if not math.isnan(value)}
    # The kernel of `label_points` depends on which parameters were given. Those that vary or differ from their defaults count as given.
    varied = [name for name in given if ds[name].ndim or given[name] != system.parameters[name].default]
    plan = Plan.of_points(system, settings_of(ds), None, varied)
    return trajectory_of_point(plan, given, Duration(float(point["end_time"])), samples)
