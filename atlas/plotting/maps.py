"""Maps of an atlas with theory drawn over the measurements."""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ..analysis.metadata import flag_names, is_logarithmic, scene_of, system_of
from ..analysis.select import cell_edges, nearest_on_axes, plane_of
from ..analysis.theory_curves import Plane, family_curves, stability_boundary
from ..errors import BadInput
from ..scene.model import Scene
from . import text
from .style import COLOURS, STYLE, WIDTHS, Width, check_width, flag_colours

MAX_DECADES = 10  # of a logarithmic colour scale
MIN_LOG_RATIO = 100  # positive numbers that span more get a logarithmic colour scale
DASHES: tuple[Any, ...] = ((0, (8, 2)), ":", "-.", "--", (0, (6, 1, 1, 1, 1, 1)))
LegendEntries = dict[str, Patch | Line2D]


def atlas_map(
    ds: xr.Dataset,
    variable: str | None = None,
    *,
    x: str | None = None,
    y: str | None = None,
    select: Mapping[str, float] | None = None,
    width: Width = "column",
    theory: bool = True,
    caption: bool = False,
) -> Figure:
    """Map of one variable of an atlas over two of its axes, with theory drawn over it.

    Flags have one colour each in every figure. Positive numbers that span more than two decades get a
    logarithmic scale of at most MAX_DECADES, numbers of both signs a scale centred on zero. Axes of more
    than `analysis.select.MAX_CELLS` values are drawn by every k-th one.

    Parameters
    ----------
    ds : Dataset
        An atlas. If it has one axis, the map is a strip or a line.
    variable : str, optional
        Default: label.
    x, y : str, optional
        Axes of the map; default the two longest, x the one that comes first in the atlas.
    select : mapping of str to float, optional
        Axis -> value for other axes; the nearest value is taken. One more axis of at most
        `analysis.select.MAX_PANELS` values becomes a row of panels.
    width : {"column", "page"}, optional
        88 mm or 180 mm.
    theory : bool, optional
        Draw the boundary of linear stability and the curves of exact steady motions, both from the
        scene of the atlas.
    caption : bool, optional
        Print `text.caption` under the map.

    Returns
    -------
    matplotlib.figure.Figure
        With one panel, or one for each value of a third axis.

    Raises
    ------
    BadInput
        For what is not in the atlas.
    """
    system_of(ds)
    check_width(width)
    name = "label" if variable is None else variable
    if name not in ds.data_vars:
        raise BadInput(f"{name}: not a variable of this atlas; allowed: {', '.join(map(str, ds.data_vars))}")
    plane, dims, panel_dim = plane_of(ds, x, y, select or {})
    footer = text.caption(nearest_on_axes(ds, select or {})) if caption else ""
    array = plane[name].transpose(*[dim for dim in (panel_dim, *dims[::-1]) if dim]).load()
    panels = [plane] if panel_dim is None else [plane.isel({panel_dim: i}) for i in range(len(array))]
    scene = scene_of(ds)
    with rc_context(STYLE):
        layout = _Layout(len(panels), len(dims), width, bool(flag_names(array)))
        figure, axes = layout.figure(footer)
        scale, legend, image = _color_scale(array), _flag_entries(array), None
        log = [scene is not None and is_logarithmic(scene, dim) for dim in dims]
        for i, (panel, ax) in enumerate(zip(panels, axes, strict=True)):
            image = _draw(ax, array if panel_dim is None else array[i], dims, log, scale)
            if theory and scene is not None:
                legend |= _overlay(ax, scene, panel, dims)
            if panel_dim is not None:
                ax.set_title(_panel_title(panel, panel_dim))
        layout.label_axes(axes, [text.axis_label(ds, dim) for dim in dims])
        if image is not None and not flag_names(array):
            _add_color_bar(figure, axes, image, scale, text.variable_label(array))
        if legend:
            _add_legend(figure, legend, width)
    return figure


# Layout.


@dataclass(frozen=True)
class _Layout:
    """Panels of a map in rows."""

    n_panels: int
    n_axes: int
    width: Width
    flags: bool

    @property
    def columns(self) -> int:
        return min(self.n_panels, 2 if self.width == "column" else 4)

    def figure(self, caption: str) -> tuple[Figure, list[Axes]]:
        """An empty figure with its panels, and with room for a caption at its foot."""
        columns, rows = self.columns, -(-self.n_panels // self.columns)
        width = WIDTHS[self.width]
        if self.n_axes == 2:
            wide = self.n_panels == 1 and self.width == "page"
            panel_height = 0.5 * width if wide else 0.72 * width / columns
        else:
            panel_height = 18.0 if self.flags else 0.6 * width / columns
        caption = textwrap.fill(caption, 68 if self.width == "column" else 145)
        caption_height = 2.8 * (caption.count("\n") + 1) + 3.0 if caption else 0.0
        height = rows * panel_height + 18.0 + caption_height
        figure = Figure(figsize=(width / 25.4, height / 25.4), layout="constrained")
        engine = figure.get_layout_engine()
        assert engine is not None
        bottom = caption_height / height
        engine.set(rect=(0, bottom, 1, 1 - bottom), w_pad=0.02, h_pad=0.02)  # type: ignore[call-arg]
        if caption:
            figure.text(1.5 / width, 1.0 / height, caption, fontsize=6.5, va="bottom", ha="left")
        axes = list(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel())
        for unused in axes[self.n_panels :]:
            unused.remove()
        return figure, axes[: self.n_panels]

    def label_axes(self, axes: list[Axes], labels: list[str]) -> None:
        """Label the x axis of panels with nothing below them, and the y axis of the first column."""
        for i, ax in enumerate(axes):
            if i + self.columns >= len(axes):
                ax.set_xlabel(labels[0])
                ax.tick_params(labelbottom=True)
            if len(labels) == 2 and i % self.columns == 0:
                ax.set_ylabel(labels[1])


def _panel_title(panel: xr.Dataset, dim: str) -> str:
    """Symbol, value and unit of the axis of the panels."""
    value = f"{float(panel[dim]):.4g}".replace("-", "\N{MINUS SIGN}")
    unit = text.unit_text(str(panel[dim].attrs.get("units", "")))
    return f"{text.axis_label(panel, dim, unit=False)} = {value} {unit}".strip()


def _add_color_bar(
    figure: Figure, axes: list[Axes], image: ScalarMappable, scale: _ColorScale, label: str
) -> None:
    bar = figure.colorbar(image, ax=axes, pad=0.02, extend=scale.extend, aspect=25)
    bar.set_label(label)
    bar.ax.tick_params(length=2.5)
    bar.outline.set_linewidth(0.6)


def _add_legend(figure: Figure, legend: LegendEntries, width: Width) -> None:
    """Legend above the panels."""
    figure.legend(
        list(legend.values()), list(legend), loc="outside upper center",
        ncols=_legend_columns(legend, WIDTHS[width]),
        frameon=False, handlelength=1.8, columnspacing=1.4, borderaxespad=0.2,
    )  # fmt: skip


def _legend_columns(entries: Iterable[str], width: float) -> int:
    """The most columns of a legend that fit a width in mm; entries fill one column after the other."""
    names = list(entries)
    for columns in range(len(names), 1, -1):
        longest = [max(map(len, column)) for column in np.array_split(np.array(names, object), columns)]
        if sum(10.0 + 1.4 * length for length in longest) < width:
            return columns
    return 1


# Colours.


@dataclass(frozen=True)
class _ColorScale:
    """Colours of a variable."""

    colormap: Colormap
    norm: Normalize
    extend: str = "neither"  # as in Matplotlib's colour bars
    log_range: tuple[float, float] | None = None  # lowest and highest value of a logarithmic scale


def _color_scale(array: xr.DataArray) -> _ColorScale:
    """Colour scale of a variable by its values."""
    names, viridis = flag_names(array), colormaps["viridis"]
    if names:
        edges = np.arange(len(names) + 1) - 0.5
        return _ColorScale(
            ListedColormap(list(flag_colours(names).values())), BoundaryNorm(edges, len(names))
        )
    finite = array.values[np.isfinite(array.values)]
    if not finite.size:
        return _ColorScale(viridis, Normalize(0, 1))
    low, high = float(finite.min()), float(finite.max())
    if low < 0 < high:
        # Cividis is blue below, grey at and yellow above its middle, and its luminance shows the sign.
        bound = max(-low, high)
        return _ColorScale(colormaps["cividis"], Normalize(-bound, bound))
    if high > 0:
        min_positive = float(finite[finite > 0].min())
        if high > MIN_LOG_RATIO * min_positive:
            floor = max(min_positive, high * 10.0**-MAX_DECADES)
            extend = "min" if low < floor else "neither"
            return _ColorScale(viridis, LogNorm(floor, high), extend, (floor, high))
    if low == high:
        low, high = low - 0.5, high + 0.5
    return _ColorScale(viridis, Normalize(low, high))


def _flag_entries(array: xr.DataArray) -> LegendEntries:
    """Legend entries of the flags that occur, or of numbers that do not exist."""
    names = flag_names(array)
    if names:
        colours, present = flag_colours(names), [names[int(value)] for value in np.unique(array.values)]
        return {name.replace("_", " "): _patch(colours[name]) for name in present}
    return {} if np.isfinite(array.values).all() else {"no value": _patch("#ffffff")}


def _patch(colour: str) -> Patch:
    return Patch(facecolor=colour, edgecolor="0.4", linewidth=0.4)


# Content of a panel.


def _draw(
    ax: Axes, array: xr.DataArray, dims: list[str], log: list[bool], scale: _ColorScale
) -> ScalarMappable | None:
    """Draw the cells of an array, or its line if it has one axis and no flags; returns the cells."""
    edges = [cell_edges(array[dim].values, logarithmic) for dim, logarithmic in zip(dims, log, strict=True)]
    image = None
    if len(dims) == 1 and not flag_names(array):
        _draw_line(ax, array, dims[0], scale)
    else:
        image = _draw_cells(ax, array.values, edges, scale)
    for logarithmic, axis, set_scale in zip(
        log, (ax.xaxis, ax.yaxis), (ax.set_xscale, ax.set_yscale), strict=False
    ):
        if logarithmic:
            set_scale("log")
            axis.set_major_locator(LogLocator(numticks=6))
            axis.set_minor_formatter(NullFormatter())
        else:
            axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    ax.set_xlim(edges[0][0], edges[0][-1])
    ax.tick_params(direction="out", length=2.5)
    return image


def _draw_line(ax: Axes, array: xr.DataArray, dim: str, scale: _ColorScale) -> None:
    """Draw a variable over one axis."""
    values = array.values
    if scale.log_range is not None:
        low, high = scale.log_range
        ax.set_yscale("log")
        ax.set_ylim(0.5 * low, 2 * high)
        values = np.where(values > 0, values, np.nan)
    ax.plot(array[dim].values, values, color=COLOURS["regular_precession"])
    ax.set_ylabel(text.variable_label(array))


def _draw_cells(ax: Axes, values: np.ndarray, edges: list[np.ndarray], scale: _ColorScale) -> ScalarMappable:
    """Draw cells over two axes, or a strip of cells over one."""
    if values.ndim == 1:
        values, edges = values[np.newaxis], [edges[0], np.array([0.0, 1.0])]
        ax.set_yticks([])
    if scale.log_range is not None:
        # Zero has no logarithm; it gets the colour of the numbers below the scale.
        values = np.where(values <= 0, 0.5 * scale.log_range[0], values)
    image = ax.pcolormesh(*edges, values, cmap=scale.colormap, norm=scale.norm, rasterized=True)
    ax.set_ylim(edges[1][0], edges[1][-1])
    return image


def _overlay(ax: Axes, scene: Scene, ds: xr.Dataset, dims: list[str]) -> LegendEntries:
    """Draw theory over a panel; returns the entries of the legend."""
    try:
        plane = Plane.of(scene, ds, dims)
        boundary, families = stability_boundary(plane), family_curves(plane)
    except BadInput as error:
        # Between the points of an atlas there may be bodies that cannot exist; the map itself is sound.
        logging.getLogger("atlas").warning("no theory on this map: %s", error)
        return {}
    legend: LegendEntries = {}
    if boundary:
        line = {"color": "black", "linestyle": "-", "linewidth": 1.3}
        legend["stability limit (theory)"] = _draw_curves(ax, boundary, line, halo_width=2.5)
    order = list(scene.system.families)
    for name, curves in families.items():
        dashes = DASHES[order.index(name) % len(DASHES)]
        line = {"color": "black", "linestyle": dashes, "linewidth": 1.0}
        legend[f"{name.replace('_', ' ')} (exact)"] = _draw_curves(ax, curves, line, halo_width=1.0)
    return legend


def _draw_curves(ax: Axes, curves: list[np.ndarray], line: dict[str, Any], *, halo_width: float) -> Line2D:
    """Draw curves over dark and bright colours alike; returns the entry of the legend.

    The halo is white: around a full line, in the gaps of a dashed one, and below every line so that none
    is cut where they cross.
    """
    halo = line | {"color": "white", "linestyle": "-", "linewidth": halo_width}
    for curve in curves:
        for zorder, style in ((2.0, halo), (2.1, line)):
            if curve.shape[1] == 1:
                ax.axvline(float(curve[0, 0]), zorder=zorder, **style)
            else:
                ax.plot(curve[:, 0], curve[:, 1], zorder=zorder, **style)
    return Line2D([], [], **line)
