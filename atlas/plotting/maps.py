"""Maps of an atlas with theory drawn over the measurements."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import xarray as xr
from matplotlib import rc_context
from matplotlib.figure import Figure

from ..analysis.metadata import is_logarithmic, map_variable, scene_of, system_of
from ..analysis.select import nearest_on_axes, plane_of
from ..errors import BadInput, attribute_text
from . import text
from .cells import draw_values, edges_of, set_axis
from .content import panel_of, tiles_done
from .exponents import draw_exponents, exponent_scale, hatch_undecided, texts
from .legend import map_legend
from .options import MapOptions
from .overlay import draw_overlay
from .scales import add_color_bar, color_scale
from .scatter import draw_scatter
from .sheet import Sheet
from .style import STYLE


def atlas_map(ds: xr.Dataset, variable: str | None = None, **options: Any) -> Figure:
    """Map of one variable of an atlas over two of its axes, with theory drawn over it.

    Flags have one colour each in every figure. Positive numbers that span more than two decades get a
    logarithmic scale of at most `scales.MAX_DECADES`, numbers of both signs a scale centred on zero, integers
    a colour each. Axes of more than `analysis.select.MAX_CELLS` values are drawn by every k-th one. White
    cells have no value; the legend gives the reason. Regions that are too small to be visible are not in the
    legend but in a note below the map.

    ds: an atlas. If it has one axis, the map is a strip or a line; if it has single points, a scatter map. options: fields
    of `MapOptions`. Returns as `atlas.accessor.Atlas.map` returns it. Raises BadInput for what is not in the atlas, and
    for options that are not allowed.
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
