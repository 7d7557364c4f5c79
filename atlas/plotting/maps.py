"""Maps of an atlas with theory drawn over the measurements."""

from __future__ import annotations

import logging
import math
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ..analysis.select import axes_of, cell_edges, flag_names, nearest, plane_of, scene_of, system_of
from ..analysis.theory_curves import Plane, family_curves, stability_boundary
from ..errors import BadInput
from ..scene.model import Scene
from ..systems.base import System
from .style import COLOURS, STYLE, SYMBOLS, WIDTHS, Width, flag_colours, unit_text

DECADES = 10  # at most, of a logarithmic colour scale
DASHES: tuple[Any, ...] = ((0, (8, 2)), ":", "-.", "--", (0, (6, 1, 1, 1, 1, 1)))
STATISTICS = {"mean": "mean", "rms": "rms", "std": "standard deviation of", "min": "least", "max": "largest"}


# Text.


def _symbol(name: str, system: System) -> str:
    """Mathematical form of a parameter."""
    return system.parameters[name].symbol or name


def axis_label(ds: xr.Dataset, dim: str, *, unit: bool = True) -> str:
    """Symbol and unit of an axis: those of the registry, or the long_name and units that the scene gave."""
    system, attributes = system_of(ds), ds[dim].attrs
    text = str(attributes.get("long_name", dim))
    stem = dim.removesuffix("_offset")
    if dim in system.parameters and text == system.parameters[dim].meaning:
        text = _symbol(dim, system)
    elif dim != stem and stem in system.parameters and "offset from the family" in text:
        text = f"{_symbol(stem, system)}, offset from the family"
    else:
        words = re.findall(r"[A-Za-z_]\w*", text)
        if words and all(word in system.parameters for word in words):
            text = re.sub(r"[A-Za-z_]\w*", lambda word: _symbol(word[0], system).strip("$"), text)
            text = f"${text.replace('*', ' ')}$"
    units = unit_text(str(attributes.get("units", "")))
    return f"{text} ({units})" if unit and units else text


def variable_label(array: xr.DataArray) -> str:
    """Short name and unit of a variable: a statistic of a symbol, or the words of its name."""
    name, units = str(array.name), unit_text(str(array.attrs.get("units", "")))
    stem, _, statistic = name.rpartition("_")
    text = f"{STATISTICS[statistic]} {SYMBOLS[stem]}" if stem in SYMBOLS else name.replace("_", " ")
    return f"{text} ({units})" if units else text


def caption(ds: xr.Dataset) -> str:
    """What a figure of this atlas shows: system, parameters, duration, tolerances, nudge, provenance."""
    system, scene, attributes = system_of(ds), scene_of(ds), ds.attrs
    parts = [f"{attributes.get('title', 'Atlas')}: {system.title}, motion in the {system.frame} frame."]
    if scene is not None:
        fixed = [f"{name} = {value:.6g}" for name, value in scene.fixed.items()]
        fixed += [f"{name} = {tie.text}" for name, tie in scene.ties.items()]
        held = [d for d in axes_of(scene) if d in ds.coords and ds[d].ndim == 0]
        fixed += [f"{name} = {float(ds[name]):.6g}" for name in held]
        spans = [
            f"{d} from {float(ds[d].min()):.6g} to {float(ds[d].max()):.6g} ({ds.sizes[d]} values)"
            for d in axes_of(scene)
            if d in ds.dims
        ]
        parts.append(f"Axes: {', '.join(spans)}." if spans else "")
        parts.append(f"Parameters: {', '.join(fixed)}; the others have their defaults." if fixed else "")
        if scene.family is not None:
            family = system.families[scene.family]
            solved = f", solved for {', '.join(scene.solve)}" if scene.solve else ""
            parts.append(f"Starts on the family {family.name} [{family.equations}]{solved}.")
        if scene.nudge:
            nudge = ", ".join(f"{name} by {value:g}" for name, value in scene.nudge.items())
            parts.append(f"Starts displaced from there: {nudge}.")
        parts.append(f"Duration {scene.duration if scene.duration.unit else f'{scene.duration} time units'}.")
    step = attributes.get("atlas_step", math.nan)
    accuracy = (
        f"step {step:g}"
        if math.isfinite(step)
        else f"phase tolerance {attributes.get('atlas_tolerance'):g} rad"
    )
    parts.append(
        f"Integrated by {attributes.get('atlas_method')}, {accuracy}; rates count as constant within"
        f" {attributes.get('atlas_rate_tolerance'):g} rad per time unit, the third axis as vertical within"
        f" {attributes.get('atlas_cylinder_tolerance'):g} rad."
    )
    parts.append(
        f"Computed with Precession Atlas {attributes.get('atlas_version')}"
        f" (kernel {attributes.get('atlas_kernel_hash')}); equations: {attributes.get('references')}."
    )
    return " ".join(part for part in parts if part)


# Maps.


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

    variable: default label. x, y: axes; default the two longest, x the one that comes first in the
    atlas. select: axis -> value for others (the nearest is taken); one more axis of at most
    MOST_PANELS values becomes a row of panels. An atlas of one axis gives a strip or a line. width:
    88 mm or 180 mm. theory: draw the boundary of linear stability and the curves of exact steady
    motions, both from the scene of the atlas. caption: print `caption(ds)` under the map.

    Flags have one colour each in every figure. Positive numbers that span more than two decades get a
    logarithmic scale of at most DECADES, numbers of both signs a scale centred on zero. Axes of more
    than MOST_CELLS values are drawn by every k-th one. Raises BadInput for what is not in the atlas.
    """
    system_of(ds)
    if width not in WIDTHS:
        raise BadInput(f"width = {width!r}: allowed: {', '.join(WIDTHS)}")
    name = "label" if variable is None else variable
    if name not in ds.data_vars:
        raise BadInput(f"{name}: not a variable of this atlas; allowed: {', '.join(map(str, ds.data_vars))}")
    part, dims, panel_dim = plane_of(ds, x, y, select or {})
    text = _footer(nearest(ds, select or {}), width) if caption else ""
    array = part[name].transpose(*[d for d in (panel_dim, *dims[::-1]) if d]).load()
    panels = (
        [part.isel({panel_dim: i}) for i in range(part.sizes[panel_dim])] if panel_dim is not None else [part]
    )
    scene = scene_of(ds)
    with rc_context(STYLE):
        figure, axes = _figure(len(panels), width, len(dims), bool(flag_names(array)), text)
        paint, legend = _color_scale(array)
        log = [scene is not None and axes_of(scene)[d].table.get("spacing") == "log" for d in dims]
        across = _across(len(panels), width)
        image = None
        for i, (one, ax) in enumerate(zip(panels, axes, strict=True)):
            values = array if panel_dim is None else array.isel({panel_dim: i})
            image = _draw(ax, values, dims, log, paint)
            if theory and scene is not None:
                legend |= _overlay(ax, scene, one, dims)
            if i + across >= len(axes):  # nothing below it
                ax.set_xlabel(axis_label(ds, dims[0]))
                ax.tick_params(labelbottom=True)
            if len(dims) == 2 and i % across == 0:
                ax.set_ylabel(axis_label(ds, dims[1]))
            if panel_dim is not None:
                unit = unit_text(str(one[panel_dim].attrs.get("units", "")))
                symbol = axis_label(ds, panel_dim, unit=False)
                value = f"{float(one[panel_dim]):.4g}".replace("-", "\N{MINUS SIGN}")
                ax.set_title(f"{symbol} = {value} {unit}".strip())
        _add_legend(figure, axes, array, image, paint.extend, legend, width)
    return figure


def _footer(ds: xr.Dataset, width: Width) -> str:
    return textwrap.fill(caption(ds), 68 if width == "column" else 145)


def _across(panels: int, width: Width) -> int:
    """Panels in a row."""
    return min(panels, 2 if width == "column" else 4)


def _figure(panels: int, width: Width, axes: int, flags: bool, text: str) -> tuple[Figure, list[Axes]]:
    """An empty figure of the journal's width with its panels, and room for the text at its foot."""
    across = _across(panels, width)
    down = -(-panels // across)
    wide = WIDTHS[width]
    panel = 0.72 * wide / across if axes == 2 else (18.0 if flags else 0.6 * wide / across)
    if axes == 2 and panels == 1 and width == "page":
        panel = 0.5 * wide
    foot = 2.8 * (text.count("\n") + 1) + 3.0 if text else 0.0
    high = down * panel + 18.0 + foot
    figure = Figure(figsize=(wide / 25.4, high / 25.4), layout="constrained")
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0, foot / high, 1, 1 - foot / high), w_pad=0.02, h_pad=0.02)  # type: ignore[call-arg]
    if text:
        figure.text(1.5 / wide, 1.0 / high, text, fontsize=6.5, va="bottom", ha="left")
    grid_of = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    flat = list(grid_of.ravel())
    for spare in flat[panels:]:
        spare.remove()
    return figure, flat[:panels]


@dataclass(frozen=True)
class _ColorScale:
    colours: Colormap
    norm: Normalize
    extend: str = "neither"


def _color_scale(array: xr.DataArray) -> tuple[_ColorScale, dict[str, Patch | Line2D]]:
    """Colour scale of a variable, and the legend of its flags that occur."""
    legend: dict[str, Patch | Line2D] = {}
    names = flag_names(array)
    values = array.values
    if names:
        colours = flag_colours(names)
        for value in np.unique(values):
            name = names[int(value)]
            legend[name.replace("_", " ")] = _patch(colours[name])
        norm: Normalize = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
        return _ColorScale(ListedColormap(list(colours.values())), norm), legend
    finite = values[np.isfinite(values)]
    if finite.size < values.size:
        legend["no value"] = _patch("#ffffff")
    if not finite.size:
        return _ColorScale(colormaps["viridis"], Normalize(0, 1)), legend
    low, high = float(finite.min()), float(finite.max())
    if low < 0 < high:
        # Cividis is blue below, grey at and yellow above its middle, and its luminance tells the sign.
        edge = max(-low, high)
        return _ColorScale(colormaps["cividis"], Normalize(-edge, edge)), legend
    if high > 0:
        least = float(finite[finite > 0].min())
        if high > 100 * least:
            floor = max(least, high * 10.0**-DECADES)
            return _ColorScale(
                colormaps["viridis"], LogNorm(floor, high), "min" if low < floor else "neither"
            ), legend
    if low == high:
        low, high = low - 0.5, high + 0.5
    return _ColorScale(colormaps["viridis"], Normalize(low, high)), legend


def _patch(colour: str) -> Patch:
    return Patch(facecolor=colour, edgecolor="0.4", linewidth=0.4)


def _draw(ax: Axes, array: xr.DataArray, dims: list[str], log: list[bool], paint: _ColorScale) -> Any:
    """Cells of the array, or its line if it has one axis and no flags."""
    edges = [cell_edges(array[dim].values, logarithmic) for dim, logarithmic in zip(dims, log, strict=True)]
    values, flags = array.values, bool(flag_names(array))
    image = None
    if len(dims) == 1 and not flags:
        shown = values
        if isinstance(paint.norm, LogNorm):
            ax.set_yscale("log")
            shown = np.where(values > 0, values, np.nan)
            ax.set_ylim(0.5 * float(paint.norm.vmin or 0), 2 * float(paint.norm.vmax or 1))
        ax.plot(array[dims[0]].values, shown, color=COLOURS["regular_precession"])
        ax.set_ylabel(variable_label(array))
    else:
        if len(dims) == 1:
            values, edges = values[np.newaxis], [edges[0], np.array([0.0, 1.0])]
            ax.set_yticks([])
        if isinstance(paint.norm, LogNorm):
            # zero has no logarithm, and is below the scale as other small numbers are
            values = np.where(values <= 0, 0.5 * float(paint.norm.vmin or 0), values)
        image = ax.pcolormesh(*edges, values, cmap=paint.colours, norm=paint.norm, rasterized=True)
        ax.set_ylim(edges[1][0], edges[1][-1])
    for logarithmic, axis, scale in zip(
        log, (ax.xaxis, ax.yaxis), (ax.set_xscale, ax.set_yscale), strict=False
    ):
        if logarithmic:
            scale("log")
            axis.set_major_locator(LogLocator(numticks=6))
            axis.set_minor_formatter(NullFormatter())
        else:
            axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    ax.set_xlim(edges[0][0], edges[0][-1])
    ax.tick_params(direction="out", length=2.5)
    return image


def _overlay(ax: Axes, scene: Scene, ds: xr.Dataset, dims: list[str]) -> dict[str, Patch | Line2D]:
    """Draw theory over a panel; returns the entries of the legend."""
    try:
        plane = Plane.of(scene, ds, dims)
        lines: dict[str, list[np.ndarray]] = {"stability limit (theory)": stability_boundary(plane)}
        families = family_curves(plane)
    except BadInput as complaint:
        # Between the points of an atlas there may be bodies that cannot be; the map itself is sound.
        logging.getLogger("atlas").warning("no theory on this map: %s", complaint)
        return {}
    lines |= {f"{name.replace('_', ' ')} (exact)": curves for name, curves in families.items()}
    order = list(scene.system.families)
    legend: dict[str, Patch | Line2D] = {}
    for i, (name, curves) in enumerate(lines.items()):
        if not curves:
            continue
        family = list(families)[i - 1] if i else None
        look: dict[str, Any] = {
            "color": "black",
            "linestyle": DASHES[order.index(family) % len(DASHES)] if family else "-",
            "linewidth": 1.0 if family else 1.3,
        }
        # White shows on dark colours: around a full line, in the gaps of a dashed one, and under every
        # line so that none is cut where they cross.
        rim = look | {"color": "white", "linestyle": "-", "linewidth": 1.0 if family else 2.5}
        for curve in curves:
            for level, style in ((2.0, rim), (2.1, look)):
                if len(dims) == 1:
                    ax.axvline(float(curve[0, 0]), zorder=level, **style)
                else:
                    ax.plot(curve[:, 0], curve[:, 1], zorder=level, **style)
        legend[name] = Line2D([], [], **look)
    return legend


def _add_legend(
    figure: Figure,
    axes: list[Axes],
    array: xr.DataArray,
    image: Any,
    extend: str,
    legend: dict[str, Patch | Line2D],
    width: Width,
) -> None:
    """Colour bar and legend."""
    if image is not None and not flag_names(array):
        bar = figure.colorbar(image, ax=axes, pad=0.02, extend=extend, aspect=25)
        bar.set_label(variable_label(array))
        bar.ax.tick_params(length=2.5)
        bar.outline.set_linewidth(0.6)
    if legend:
        figure.legend(
            list(legend.values()), list(legend), loc="outside upper center", ncols=_legend_columns(legend, WIDTHS[width]),
            frameon=False, handlelength=1.8, columnspacing=1.4, borderaxespad=0.2,
        )  # fmt: skip


def _legend_columns(entries: Iterable[str], wide: float) -> int:
    """The most columns of a legend that fit a width in mm; entries fill one column after the other."""
    names = list(entries)
    for columns in range(len(names), 1, -1):
        longest = [max(map(len, part)) for part in np.array_split(np.array(names, object), columns)]
        if sum(10.0 + 1.4 * length for length in longest) < wide:
            return columns
    return 1
