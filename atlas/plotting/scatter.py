"""Scatter maps: single points over two of their parameters or coordinates."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from ..analysis.metadata import axes_of, flag_names, scene_of, system_of
from ..errors import BadInput, shown
from . import text
from .cells import set_axis
from .content import Panel
from .legend import map_legend
from .options import MapOptions
from .scales import MIN_LOG_RATIO, ColorScale, add_color_bar, color_scale
from .sheet import Sheet

# Area of a dot in square points: within limits that with which all dots together cover the panel about once.
PANEL_AREA, MIN_DOT, MAX_DOT = 6000.0, 0.5, 14.0


def draw_scatter(ds: xr.Dataset, name: str, options: MapOptions) -> Figure:
    """Draw a variable of single points as dots, see `atlas.plotting.maps.atlas_map`."""
    axes = scatter_axes(ds, options.x, options.y)
    options.check_for(ds[name], axes)
    caption = [text.caption(ds)] if options.caption else []
    ds = ds[[name, *axes]].load()
    array = ds[name]
    flags = options.flag_colours(array)
    families = list(system_of(ds).families)
    white = {} if flags else {"no value": ~np.isfinite(array.values)}
    panel = Panel(array, {k: v for k, v in white.items() if v.any()}, np.zeros(array.shape, bool))
    entries, notes = map_legend([panel], flags, options, families)
    sheet = Sheet(options, 1)
    figure, (ax,) = sheet.figure(entries, notes + caption)
    columns = [np.asarray(ds[axis].values, float) for axis in axes]
    log = [_is_logarithmic(column) for column in columns]
    scale = color_scale(array, options)
    image = _draw_dots(ax, columns, array, scale)
    for which, is_log in zip("xy", log, strict=True):
        set_axis(ax, which, is_log, inner=False)
    ax.margins(0.03)
    sheet.label_axes([ax], [options.text(axis, text.axis_label(ds, axis)) for axis in axes])
    if not flags:
        add_color_bar(figure, [ax], image, scale, options.text(name, text.variable_label(array)))
    return figure


def scatter_axes(ds: xr.Dataset, x: str | None, y: str | None) -> list[str]:
    """The two coordinates along the points that are the axes of a scatter map.

    ds: single points. x, y: names of coordinates; None: the one with the most different values, of several
    those that the scene varies. Returns two names, x first. Raises BadInput for a name that is no such
    coordinate, and where fewer than two of them vary.
    """
    allowed = [
        str(name)
        for name, coord in ds.coords.items()
        if coord.dims == ("point",) and coord.dtype.kind in "iuf" and name != "point"
    ]
    for role, name in (("x", x), ("y", y)):
        if name is not None and name not in allowed:
            raise BadInput(
                f"{role} = {shown(name)}: not a number given at each of these points; allowed:"
                f" {', '.join(allowed) or 'none'}"
            )
    if x is not None and x == y:
        raise BadInput(f"x = y = {shown(x)}: a map needs two axes")
    varied_by_scene = _names_varied_by_scene(ds)
    counts = {name: np.unique(ds[name].values).size for name in allowed if name not in (x, y)}
    candidates = sorted(
        (name for name, count in counts.items() if count > 1),
        key=lambda n: (-counts[n], n not in varied_by_scene),
    )
    chosen = [name if name is not None else (candidates.pop(0) if candidates else None) for name in (x, y)]
    if None in chosen:
        raise BadInput("these single points differ in fewer than two parameters: no map can be drawn")
    return [str(name) for name in chosen]


def _names_varied_by_scene(ds: xr.Dataset) -> set[str]:
    """Names with a range or a column in the scene of the points, not those that ties and families compute."""
    scene = scene_of(ds)
    if scene is None:
        return set()
    points = scene.points or {}
    return {*axes_of(scene), *points.get("ranges", {}), *points.get("values", {})}


def _is_logarithmic(column: np.ndarray) -> bool:
    """Whether a coordinate has positive values whose logarithms are spread more evenly than themselves."""
    if not (column > 0).all() or column.max() < MIN_LOG_RATIO * column.min():
        return False
    relative = (np.median(column) - column.min()) / np.ptp(column)
    return bool(relative < 0.1)


def _draw_dots(ax: Axes, columns: list[np.ndarray], array: xr.DataArray, scale: ColorScale) -> ScalarMappable:
    """Draw the points, those with rare flags above the others."""
    values = array.values.astype(np.int8) if array.dtype == bool else array.values
    order = np.arange(values.size)
    if flag_names(array):
        order = np.argsort(-np.bincount(values, minlength=1)[values], kind="stable")
    area = float(np.clip(PANEL_AREA / max(values.size, 1), MIN_DOT, MAX_DOT))
    return ax.scatter(
        columns[0][order], columns[1][order], c=scale.shown(values)[order], s=area, cmap=scale.colormap,
        norm=scale.norm, edgecolors="0.35", linewidths=0.25 if area > 2 else 0, rasterized=True,
        plotnonfinite=False,
    )  # fmt: skip
