"""Distance of points, along one axis, from the place where a flag changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from ...analysis.boundary import EXISTENCE, KINDS, LABEL, STABILITY
from ...analysis.degrees import factor, in_degrees
from ...analysis.exact_curves import TRISECTIONS
from ...analysis.metadata import (
    axes_of,
    flag_variable,
    in_order,
    is_logarithmic,
    neighbour_axes,
    scene_of,
    scene_problem,
)
from ...analysis.plane import IN_SPACE, Plane
from ...analysis.select import cell_edges, nearest_on_axes
from ...analysis.tracer import narrow
from ...errors import BadInput, allowed_text, attribute_text, shown
from ...flags import LABELS, Flag, Label
from ...measure.instrument import Variable
from ...scene.model import Scene
from ...systems.base import Array, families_of

# Each function tells on which side of a curve of theory a point is.
CURVES = [KINDS[name].classes for name in (STABILITY, LABEL, EXISTENCE)]
# Variable that changes at curves of theory -> frame of these curves: IN_SPACE, or "" for the frame of the system.
FRAMES = dict.fromkeys(("label", "predicted", "stable", "stability_kind"), "")
FRAMES |= dict.fromkeys(("label_inertial", "predicted_inertial"), IN_SPACE)


class Source(Flag):
    """How the place at which a flag changes is found."""

    NOTHING = 0, "nothing changes within the atlas"
    CELLS = 1, "halfway between two neighbouring points"
    CURVE = 2, "a curve of theory between two neighbouring points"


SOURCE = Variable("source", "int8", "1", "what the place of a change is known from", Source.meanings())


def margin(
    ds: xr.Dataset, axis: str, variable: str = "label", *, degrees: bool = False, **coords: float
) -> xr.Dataset:
    """Least change of one axis at which a flag changes, at each point or at given values of the axes.

    Parameters
    ----------
    axis : str
        The axis that changes; the others stay.
    variable : str, optional
        A flag variable; default label. Every other flag counts as a change, also unresolved and not_computed.
    degrees : bool, optional
        Take and return angles in degrees.
    **coords : float
        Axis -> value, as in `nearest`. If a value of `axis` is given, margins are measured from this value, not from the nearest point.

    Returns
    -------
    Dataset
        `margin` is the lesser of `down` and `up`, the least changes to lower and to higher values. They are inf if nothing changes
        within the atlas, and nan without a label. The flags `source_margin`, `source_down` and `source_up` tell how the place of a
        change is known. The place is halfway between neighbouring points (on a logarithmic axis in the logarithm), or on a limit of
        stability or precession or an edge of existence that theory predicts. ``ds.atlas.margin("k3").atlas.map("margin")`` draws a map.

    Notes
    -----
    A margin concerns one known point; for uncertain parameters use random draws, see `probability`.
    """
    flag_variable(ds, variable)  # raises BadInput unless `variable` is a flag variable
    if axis not in (axes := neighbour_axes(ds)):
        raise BadInput(f"axis = {shown(axis)}: no axis with neighbouring points; {allowed_text(axis, axes)}")
    part = nearest_on_axes(ds, {dim: value for dim, value in coords.items() if dim != axis}, degrees)
    scene = None if scene_problem(part) else scene_of(part)
    line = in_order(part, {axis: 1})[variable].transpose(axis, ...)
    flags, values = line.values, line[axis].values.astype(float)
    at = values.reshape(-1, *[1] * (flags.ndim - 1))
    changed = np.pad(flags[1:] != flags[:-1], [(1, 1), *[(0, 0)] * (flags.ndim - 1)])
    edges = cell_edges(values, is_logarithmic(scene, axis, values)).reshape(-1, *at.shape[1:])
    places = np.where(changed, edges, np.nan)
    curves = np.full(places.shape, np.nan)
    if scene is not None and variable in FRAMES and families_of(scene.system) and changed.any():
        curves[changed] = _curves(scene, line, axis, FRAMES[variable], np.nonzero(changed))
        places = np.where(np.isnan(curves), places, curves)
    missing = (flags == Label.NOT_COMPUTED) & (variable in LABELS)
    if axis in coords:
        nearest_on_axes(part, {axis: coords[axis]}, degrees)  # raises BadInput for a value outside the axis
        at = np.array(coords[axis] / factor(part[axis].attrs, degrees))
        nearest = int(np.abs(values - at).argmin())
        tied = [name for name, each in line.coords.items() if axis in each.dims and name != axis]
        line, missing = line.drop_vars(tied).isel({axis: nearest}), missing[nearest]
        line = line.assign_coords({axis: ((), at, part[axis].attrs)})
    distances, sources = [], []
    for side in (-1, 1):
        place, curve = (_next(each, at if axis in coords else None, side) for each in (places, curves))
        distances.append(np.where(np.isnan(place), np.inf, side * (place - at)))
        sources.append(
            np.select([np.isnan(place), curve == place], [Source.NOTHING, Source.CURVE], Source.CELLS)
        )
    is_down = distances[0] <= distances[1]
    distances.append(np.where(is_down, *distances))
    sources.append(np.where(is_down, *sources))
    number = {"long_name": f"distance along {axis} from a change of {variable}"}
    number["units"] = attribute_text(part[axis].attrs, "units", "1")
    columns: dict[str, Any] = {}
    for name, distance, source in zip(("down", "up", "margin"), distances, sources, strict=True):
        columns[name] = line.dims, np.where(missing, np.nan, distance), number
        known_from = np.where(missing, Source.NOTHING, source).astype(np.int8)
        columns[f"source_{name}"] = line.dims, known_from, SOURCE.attributes()
    result = xr.Dataset(columns, line.coords, ds.attrs)
    if axis in result.dims:
        result = result.sel({axis: part[axis].values})
    return in_degrees(result.transpose(*(dim for dim in part[variable].dims if dim in result.dims)), degrees)


def _next(places: Array, value: np.ndarray | None, side: int) -> Array:
    """Return the nearest of `places` below (`side` -1) or above (`side` 1) `value`, or nan. If `value` is None, do so for each sample."""
    if value is None:
        return np.fmax.accumulate(places)[:-1] if side < 0 else np.fmin.accumulate(places[::-1])[-2::-1]
    if side < 0:
        return np.fmax.reduce(np.where(places < value, places, np.nan))
    return np.fmin.reduce(np.where(places < value, np.nan, places))


def _curves(scene: Scene, line: xr.DataArray, axis: str, frame: str, index: tuple[np.ndarray, ...]) -> Array:
    """Return the values of `axis` where a border of theory runs between the points `index` and their predecessors on `axis`, or nan."""
    whole = {
        dim: line[dim].values[index[line.dims.index(dim)]]
        if dim in line.dims
        else np.full(index[0].size, float(line[dim]))
        for dim in axes_of(scene)
    }
    low = line[axis].values[index[0] - 1].astype(float)
    plane, nudged = Plane(scene, {axis: (float(low.min()), float(low.max()))}, {}), bool(scene.nudge)

    def classes(values: Array, repeats: int = 1) -> np.ndarray:
        theory = plane.theory({dim: np.tile(each, repeats) for dim, each in whole.items()} | {axis: values})
        return np.array([each(theory, frame, nudged) for each in CURVES])

    at_low, at_high = classes(low), classes(whole[axis].astype(float))
    crossed = (at_low > 0) & (at_high > 0) & (at_low != at_high)
    kind, pairs = crossed.argmax(0), np.arange(low.size)

    def is_above(positions: Array) -> np.ndarray:
        return classes(positions[:, 0], 2)[np.tile(kind, 2), np.arange(2 * low.size)] > 1

    place = narrow(
        is_above,
        at_low[kind, pairs] > 1,
        low[:, np.newaxis],
        whole[axis][:, np.newaxis].astype(float),
        TRISECTIONS,
    )
    return np.where(crossed.any(0), place[:, 0], np.nan)
