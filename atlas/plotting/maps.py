"""Maps of an atlas with theory drawn over the measurements."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from ..analysis.metadata import axes_of, flag_names, is_logarithmic, map_variable, scene_of, system_of
from ..analysis.select import nearest_on_axes, plane_of
from ..errors import BadInput, attribute_text, shown
from . import text
from .cells import (
    MIN_LOG_RATIO,
    ColorScale,
    add_color_bar,
    color_scale,
    draw_exponents,
    draw_overlay,
    draw_values,
    edges_of,
    exponent_scale,
    hatch_undecided,
    set_axis,
    texts,
)
from .content import Panel, panel_of, tiles_done
from .options import MapOptions
from .sheet import Sheet, map_legend
from .style import STYLE


def atlas_map(ds: xr.Dataset, variable: str | None = None, **options: Any) -> Figure:
    """Map of one variable of an atlas over two of its axes, with theory drawn over it, as `Atlas.map`.

    Flags have one colour each in every figure. Positive numbers that span more than two decades get a
    logarithmic scale of at most `cells.MAX_DECADES`, numbers of both signs a scale centred on zero, integers
    a colour each. White cells have no value. Regions that are too small to be visible are not in the legend
    but in a note below the map. A single axis gives a strip or a line, single points a scatter map. Raises
    BadInput for wrong options.
    """
    system_of(ds)
    chosen = MapOptions(**options)
    if chosen.title:
        chosen = replace(chosen, title=text.drawable(chosen.title))
    name = map_variable(ds) if variable is None else variable
    if name not in list(ds.data_vars):
        raise BadInput(f"{name}: not a variable of this atlas; allowed: {', '.join(map(str, ds.data_vars))}")
    with nullcontext() if chosen.ax is not None else rc_context(STYLE):
        if ds[name].dims != ("point",):
            return _draw_map(ds, name, chosen)
        if chosen.select:
            raise BadInput(
                "select: these are single points without axes; choose some by ds.atlas.select or ds.sel"
            )
        return draw_scatter(ds, name, chosen)


def _draw_map(ds: xr.Dataset, name: str, options: MapOptions) -> Figure:
    """Draw a variable over its axes."""
    ds = ds.drop_dims(set(ds.dims) - set(ds[name].dims))  # over which the variable was averaged
    select = options.select or {}
    plane, dims, panel_dim = plane_of(ds, options.x, options.y, select)
    options.check_for(ds[name], dims)
    if panel_dim is not None and options.ax is not None:
        raise BadInput(
            f"ax: {panel_dim} has {plane.sizes[panel_dim]} values here, and a panel for each; choose one by select"
        )
    array = plane[name].transpose(*[dim for dim in (panel_dim, *dims[::-1]) if dim]).load()
    parts = [plane] if panel_dim is None else [plane.isel({panel_dim: i}) for i in range(len(array))]
    scene = scene_of(ds)
    panels = [panel_of(part, name, dims, scene, options.boundary) for part in parts]
    flags = options.flag_colours(array)
    families = list(system_of(ds).families)
    exponents = exponent_scale(plane, name)
    if name == "regularity":
        options = replace(options, labels={**texts(ds), **(options.labels or {})})
    entries, notes = map_legend(panels, flags, options, families)
    if not flags and "computed" in ds:
        notes.append("Between the points that were integrated: the value of the nearest one.")
    if (tiles := tiles_done(ds)) is not None:
        notes.append(f"Unfinished: {tiles[0]} of {tiles[1]} tiles are computed.")
    if options.caption:
        notes.append(text.caption(nearest_on_axes(ds, select)))
    sheet = Sheet(options, len(panels), len(dims) == 1, len(dims) == 1 and not flags)
    figure, axes = sheet.figure(entries, notes)
    scale, image = color_scale(array, options), None
    variable_text = options.text(name, text.variable_label(array))
    log = [is_logarithmic(scene, dim, plane[dim].values) for dim in dims]
    for part, panel, ax in zip(parts, panels, axes, strict=True):
        edges = edges_of(panel.array, dims, log)
        image = draw_values(ax, panel.array, edges, scale, variable_text)
        if name == "regularity":
            hatch_undecided(ax, panel.array, edges)
            image = image if exponents is None else draw_exponents(ax, part, panel.array, edges, exponents)
        for which, is_log in zip("xy", log, strict=False):
            set_axis(ax, which, is_log, inner=which == "x" and sheet.columns > 1)
        if panel.array.ndim == 2 or flags:
            draw_overlay(ax, panel, edges, families)
        if panel_dim is not None:
            ax.set_title(_panel_title(part, panel_dim))
    sheet.label_axes(axes, [options.text(dim, text.axis_label(ds, dim)) for dim in dims])
    if image is not None and exponents is not None:
        label = text.variable_label(plane["lyapunov"]).replace("lyapunov", r"Lyapunov exponent $\lambda$")
        add_color_bar(figure, axes, image, exponents, label)
    elif image is not None and not flags:
        add_color_bar(figure, axes, image, scale, variable_text)
    return figure


def _panel_title(panel: xr.Dataset, dim: str) -> str:
    """Symbol, value and unit of the axis of the panels."""
    value = f"{float(panel[dim]):.4g}".replace("-", "\N{MINUS SIGN}")
    unit = text.unit_text(attribute_text(panel[dim].attrs, "units"))
    return text.drawable(f"{text.axis_label(panel, dim, unit=False)} = {value} {unit}".strip())


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
    """Axes of a scatter map, x first, by default the most varied coordinates; BadInput without two."""
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
    """Names with a range or a column in the scene of the points, not computed by ties and families."""
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
    """Draw the points, rare flags on top."""
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
