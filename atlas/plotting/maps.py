"""Maps of an atlas with theory drawn over the measurements."""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from .. import extension
from ..analysis.degrees import factor, in_degrees
from ..analysis.metadata import (
    axes_of,
    is_logarithmic,
    map_variable,
    numeric_coordinates,
    positions_as_flags,
    scene_of,
    scene_problem,
    system_of,
)
from ..analysis.select import cell_edges, check_axes, nearest_on_axes, plane_of
from ..errors import BadInput, allowed_text, attribute_text
from ..flags import Regularity
from ..systems.base import Mask, families_of
from ..variables import POINT
from . import cells
from .content import MIN_VISIBLE, NO_VALUE, SLOW, Panel, panel_of, remarks, visible
from .options import MapOptions
from .style import STYLE, SYMBOLS, PrintFigure, axis_label, caption, drawable, unit_text, variable_label

Entries = dict[str, Artist]  # text of the legend -> sample
# name of a flag -> function of a colour that makes its sample in the legend
Samples = Mapping[str, Callable[[str], Artist]]


def atlas_map(ds: xr.Dataset, variable: str | None = None, **options: Any) -> Figure:
    """Map of one variable of an atlas with theory drawn over it, as `Atlas.map`; a scatter map of single points."""
    system_of(ds)
    chosen = MapOptions(**options)
    if chosen.title:
        chosen = replace(chosen, title=drawable(chosen.title))
    name = map_variable(ds) if variable is None else variable
    if name not in list(ds.data_vars):
        raise BadInput(
            f"{name}: not a variable of this atlas; {allowed_text(name, list(map(str, ds.data_vars)))}"
        )
    samples_of = extension.load("samples", name)
    samples = samples_of(ds) if samples_of else {}
    ds = positions_as_flags(ds, name)
    with nullcontext() if chosen.ax is not None else rc_context(STYLE):
        draw = draw_scatter if ds[name].dims == ("point",) else draw_map
        return draw(ds, name, chosen, samples)


def draw_map(ds: xr.Dataset, name: str, options: MapOptions, samples: Samples) -> Figure:
    """Draw a variable over its axes, see `atlas_map`."""
    ds = ds.drop_dims(set(ds.dims) - set(ds[name].dims))  # over which the variable was averaged
    select = options.select or {}
    in_input = options.degrees is True  # a scene asks for degrees in figures only
    plane, dims, panel_dims = plane_of(
        ds, options.x, options.y, select, options.row, options.col, degrees=in_input
    )
    options.check_for(ds[name], dims)
    counts = tuple(plane.sizes[dim] for dim in panel_dims)
    if panel_dims and options.ax is not None:
        raise BadInput(
            f"ax: {' x '.join(panel_dims)} has {prod(counts)} values here, and a panel for each; choose one by select"
        )
    shown = in_degrees(plane[[name]], options.degrees)
    array = shown[name].transpose(*panel_dims, *dims[::-1]).load()
    scene = scene_of(ds)
    log = [is_logarithmic(scene, dim, plane[dim].values) for dim in dims]
    edges = [cell_edges(plane[dim].values, is_log) for dim, is_log in zip(dims, log, strict=True)]
    has_axes = scene is not None and axes_of(scene).keys() <= ds.coords.keys()
    if options.boundary and has_axes and (problem := scene_problem(ds, plane)):
        logging.getLogger("atlas").warning("no theory on this map: %s", problem)
        scene = None
    parts = [plane.isel(dict(zip(panel_dims, index, strict=True))) for index in np.ndindex(counts)]
    panels = [visible(panel_of(part, name, dims, scene, options.boundary), edges) for part in parts]
    panels = [panel.in_degrees(options.degrees) for panel in panels]
    edges = [edge * factor(plane[dim].attrs, options.degrees) for edge, dim in zip(edges, dims, strict=True)]
    if name == "regularity":
        options = replace(options, labels={**cells.regularity_texts(scene), **(options.labels or {})})
    flags = options.flag_colours(array)
    drawing = Drawing(
        name=name,
        label=options.text(name, variable_label(array)),
        edges=edges,
        log=log,
        scale=cells.color_scale(array, options),
        exponents=cells.exponent_scale(plane, name) if len(dims) == 2 else None,
        flags={options.text(flag, flag.replace("_", " ")): colour for flag, colour in flags.items()},
        levels=np.unique(array.values.astype(int)).tolist() if flags else [],
        families=list(families_of(system_of(ds))),
    )
    entries, notes = map_legend(panels, {} if drawing.is_curve else flags, options, drawing.families, samples)
    notes += remarks(ds, filled=not drawing.flags)
    if options.caption:
        notes.append(caption(nearest_on_axes(ds, select, in_input)))
    columns = 1 if options.row else min(prod(counts), 2 if options.size_mm[0] < 130 else 4)
    columns = counts[-1] if options.row and options.col else columns
    sheet = Sheet(options, len(panels), columns, drawing.curve_height(options.size_mm[0] / columns))
    figure, axes = sheet.figure(entries, notes)
    for i, (part, panel, ax) in enumerate(zip(parts, panels, axes, strict=True)):
        image = drawing.draw(ax, part, panel, inner=columns > 1)
        place = in_degrees(part[panel_dims], options.degrees)
        name_panel(ax, place, panel_dims, top=i < columns, end=(i + 1) % columns == 0)
    sheet.label_axes(axes, [options.text(dim, axis_label(shown, dim)) for dim in dims], entries)
    if image is not None and drawing.exponents is not None:
        label = variable_label(plane["lyapunov"]).replace("lyapunov", r"Lyapunov exponent $\lambda$")
        cells.add_color_bar(figure, axes, image, drawing.exponents, label)
    elif image is not None and not drawing.flags:
        cells.add_color_bar(figure, axes, image, drawing.scale, drawing.label)
    return figure


@dataclass(frozen=True)
class Drawing:
    """Colours, texts and axes that the panels of a map over one or two axes share."""

    name: str  # of the variable
    label: str  # name and unit of the variable, or the caller's text
    edges: list[np.ndarray]  # of the cells along each axis, x first
    log: list[bool]  # whether each axis is logarithmic
    scale: cells.ColorScale
    exponents: cells.ColorScale | None  # scale of the Lyapunov exponents over cells of regularity
    flags: Mapping[str, str]  # text of each flag -> its colour, in the order of the values; empty for numbers
    levels: list[int]  # values of the flags that occur
    families: list[str]  # of the system, in the order of their flags

    @property
    def is_curve(self) -> bool:
        """Whether the map has a single axis."""
        return len(self.edges) == 1

    def curve_height(self, width: float) -> float | None:
        """Height in mm of a panel of this width, None for cells over two axes."""
        if not self.is_curve:
            return None
        return 8.0 + 7.0 * len(self.levels) if self.flags else 0.6 * width

    def draw(self, ax: Axes, part: xr.Dataset, panel: Panel, *, inner: bool) -> ScalarMappable | None:
        """Draw a panel, inner if it has neighbours in its row; returns the cells that the colour bar explains."""
        image = None
        if self.flags and self.is_curve:
            cells.draw_levels(ax, panel.array, self.flags, self.levels)
        else:
            image = cells.draw_values(ax, panel.array, self.edges, self.scale, self.label)
        if self.name == "regularity" and not self.is_curve:
            undecided = panel.array.values == Regularity.UNDECIDED
            if undecided.any():
                cells.draw_hatching(ax, undecided, self.edges, cells.HATCHES[cells.UNDECIDED])
            if self.exponents is not None:
                image = cells.draw_exponents(ax, part, panel.array, self.edges, self.exponents)
        for which, is_log in zip("xy", self.log, strict=False):
            cells.set_axis(ax, which, is_log, inner=inner and which == "x")
        if self.flags or not self.is_curve:
            cells.draw_overlay(ax, panel, self.edges, self.families)
        return image


def name_panel(ax: Axes, part: xr.Dataset, dims: Sequence[str], *, top: bool, end: bool) -> None:
    """Write the values of the axes of panels: of one axis above each panel; of two above the top row and at the ends of rows."""
    texts = []
    for dim in dims:
        value = f"{float(part[dim]):.4g}".replace("-", "\N{MINUS SIGN}")
        unit = unit_text(attribute_text(part[dim].attrs, "units"))
        texts.append(drawable(f"{axis_label(part, dim, unit=False)} = {value} {unit}".strip()))
    if len(texts) == 1 or (texts and top):
        ax.set_title(texts[-1])
    if len(texts) == 2 and end:
        ax.annotate(texts[0], (1.03, 0.5), xycoords="axes fraction", rotation=270, va="center")


# Area of a dot in square points, within limits: all dots of a panel cover it about once.
PANEL_AREA, MIN_DOT, MAX_DOT = 6000.0, 0.5, 14.0


def draw_scatter(ds: xr.Dataset, name: str, options: MapOptions, samples: Samples) -> Figure:
    """Draw a variable of single points as dots, see `atlas_map`."""
    for option in ("select", "row", "col"):
        if getattr(options, option):
            raise BadInput(
                f"{option}: these are single points without axes; choose some by ds.atlas.select or ds.sel"
            )
    axes = scatter_axes(ds, options.x, options.y)
    options.check_for(ds[name], axes)
    captions = [caption(ds)] if options.caption else []
    ds = in_degrees(ds[[name, *axes]].load(), options.degrees)
    array = ds[name]
    flags = options.flag_colours(array)
    missing = np.zeros(array.shape, bool) if flags else ~np.isfinite(array.values)
    panel = Panel(array, {NO_VALUE: missing} if missing.any() else {}, np.zeros(array.shape, bool))
    entries, notes = map_legend([panel], flags, options, [], samples)
    sheet = Sheet(options)
    figure, (ax,) = sheet.figure(entries, notes + captions)
    columns = [np.asarray(ds[axis].values, float) for axis in axes]
    scale = cells.color_scale(array, options)
    values = array.values.astype(np.int8) if array.dtype == bool else array.values
    order = np.arange(values.size)
    if flags:  # rare ones on top
        order = np.argsort(-np.bincount(values, minlength=1)[values], kind="stable")
    area = float(np.clip(PANEL_AREA / max(values.size, 1), MIN_DOT, MAX_DOT))
    image = ax.scatter(
        columns[0][order], columns[1][order], c=scale.as_drawn(values)[order], s=area, cmap=scale.colormap,
        norm=scale.norm, edgecolors="0.35", linewidths=0.25 if area > 2 else 0, rasterized=True,
        plotnonfinite=False,
    )  # fmt: skip
    for which, column in zip("xy", columns, strict=True):
        # Positive values get a logarithmic axis if it spreads them more evenly.
        log = bool((column > 0).all()) and column.max() >= cells.MIN_LOG_RATIO * column.min()
        log = log and bool((np.median(column) - column.min()) / np.ptp(column) < 0.1)
        cells.set_axis(ax, which, log, inner=False)
    ax.margins(0.03)
    sheet.label_axes([ax], [options.text(axis, axis_label(ds, axis)) for axis in axes], entries)
    if not flags:
        cells.add_color_bar(figure, [ax], image, scale, options.text(name, variable_label(array)))
    return figure


def scatter_axes(ds: xr.Dataset, x: str | None, y: str | None) -> list[str]:
    """Axes of a scatter map, x first, by default the most varied coordinates; BadInput without two."""
    allowed = [name for name in numeric_coordinates(ds, POINT) if name != POINT]
    check_axes(allowed, "a number given at each of these points", x=x, y=y)
    varied_by_scene: set[str] = set()  # names with a range or a column, not computed by ties and families
    if (scene := scene_of(ds)) is not None:
        points = scene.points or {}
        varied_by_scene = {*axes_of(scene), *points.get("ranges", {}), *points.get("values", {})}
    counts = {name: np.unique(ds[name].values).size for name in allowed if name not in (x, y)}
    candidates = sorted(
        (name for name, count in counts.items() if count > 1),
        key=lambda n: (-counts[n], n not in varied_by_scene),
    )
    chosen = [name if name is not None else (candidates.pop(0) if candidates else None) for name in (x, y)]
    if None in chosen:
        raise BadInput("these single points differ in fewer than two parameters: no map can be drawn")
    return [str(name) for name in chosen]


TEXT_ROW = 2.8  # height in mm
SAMPLE = 2.6  # side of a sample in the legend that an extension makes, in sizes of the font
LEGEND_SHARE = 0.97  # of the width that a legend may take; screens of few dots draw letters wider than print


@dataclass(frozen=True)
class Sheet:
    """A figure with panels in rows, or the Axes of the caller."""

    options: MapOptions  # choices of the caller
    panels: int = 1  # how many panels
    columns: int = 1  # panels in a row
    panel_height: float | None = None  # mm; default: that of a map over two axes

    def figure(self, legend: Entries, notes: Sequence[str]) -> tuple[Figure, list[Axes]]:
        """The figure with empty panels, legend, title and notes; notes on the caller's Axes are logged."""
        options = self.options
        legend = legend if options.legend else {}
        if options.ax is not None:
            caller = options.ax.get_figure(root=True)
            assert caller is not None
            handles, names = list(legend.values()), list(legend)
            if legend:  # inside, since there may be no room around the Axes of the caller
                options.ax.legend(handles, names, loc="upper right", fontsize="small", framealpha=0.85)
            if options.title:
                options.ax.set_title(options.title)
            for note in notes:
                logging.getLogger("atlas").info("%s", note)
            return caller, [options.ax]
        width, height = options.size_mm
        figure = PrintFigure(
            figsize=(width / 25.4, (height or width) / 25.4), layout="constrained", dpi=float(options.dpi)
        )
        text = drawable(textwrap.fill(" ".join(notes), int(0.78 * width))) if notes else ""
        foot = TEXT_ROW * (text.count("\n") + 1) + 2.0 if text else 0.0
        head = self._draw_legend(figure, legend)
        rows = -(-self.panels // self.columns)
        if height is None:
            of_map = (0.5 if width >= 130 else 0.72) * width
            if self.panels > 1:
                of_map = 0.72 * width / self.columns + 6.0  # with a title above each panel
            height = rows * (self.panel_height or of_map) + head + foot + 9.0
            figure.set_size_inches(width / 25.4, height / 25.4)
        engine = figure.get_layout_engine()
        assert engine is not None
        engine.set(rect=(0, foot / height, 1, 1 - foot / height), w_pad=0.02, h_pad=0.02)  # type: ignore[call-arg]
        if text:
            figure.text(1.5 / width, 1.0 / height, text, fontsize=6.5, va="bottom", ha="left")
        axes = list(figure.subplots(rows, self.columns, sharex=True, sharey=True, squeeze=False).ravel())
        for unused in axes[self.panels :]:
            unused.remove()
        return figure, axes[: self.panels]

    def _draw_legend(self, figure: Figure, legend: Entries) -> float:
        """Draw the legend above the panels in as many columns as fit, and the title; returns their height in mm."""
        has_samples = any(type(sample) not in (Polygon, Line2D) for sample in legend.values())
        for columns in range(len(legend), 0, -1):
            drawn = figure.legend(
                list(legend.values()), list(legend), loc="outside upper center",
                ncols=columns, frameon=False, columnspacing=0.8,
                **({"handlelength": SAMPLE, "handleheight": SAMPLE} if has_samples else {"handlelength": 1.8}),
                borderaxespad=0.2, borderpad=0, title=self.options.title, title_fontsize=9,
            )  # fmt: skip
            box = drawn.get_window_extent()
            if columns == 1 or box.width < LEGEND_SHARE * figure.bbox.width:
                return box.height / figure.dpi * 25.4
            drawn.remove()
        if self.options.title:
            figure.suptitle(self.options.title, fontsize=9)
        return 5.0 if self.options.title else 0.0

    def label_axes(self, axes: list[Axes], labels: list[str], entries: Entries) -> None:
        """Label the axes, of several panels once for all of them; entries: the legend, which the caller may draw again."""
        for text, sample in entries.items():
            sample.set_label(text)
            axes[0].add_artist(sample)
        figure = axes[0].get_figure(root=True)
        assert figure is not None
        setters: list[Callable[[str], object]] = [figure.supxlabel, figure.supylabel]
        if self.panels == 1:
            setters = [axes[0].set_xlabel, axes[0].set_ylabel]
        for set_label, label in zip(setters, labels, strict=False):
            set_label(label)
        for ax in axes[-self.columns :]:  # nothing is below them
            ax.tick_params(labelbottom=True)


def map_legend(
    panels: Sequence[Panel],
    flags: Mapping[str, str],
    options: MapOptions,
    families: Sequence[str],
    samples: Samples,
) -> tuple[Entries, list[str]]:
    """Legend (text -> sample of colour, hatching or line), and notes about regions too small to see."""
    entries: Entries = {}
    too_small: list[str] = []
    total = sum(panel.array.size for panel in panels)

    def add(text: str, masks: list[Mask], sample: Artist) -> None:
        """Add a region, its cells in each panel, if it is visible; else a sentence with its number of points."""
        count = sum(int(mask.sum()) for mask in masks)
        if any(mask.mean() >= MIN_VISIBLE for mask in masks):
            entries[text] = sample
        elif count and text != SLOW:
            too_small.append(f"{text}, {count} of {total} points")

    white = [sum(panel.white.values(), np.zeros(panel.array.shape, bool)) for panel in panels]
    for value, (name, colour) in enumerate(flags.items()):
        masks = [(panel.array.values == value) & ~mask for panel, mask in zip(panels, white, strict=True)]
        sample = samples.get(name, partial(_sample, name))
        add(options.text(name, name.replace("_", " ")), masks, sample(colour))
    for reason in dict.fromkeys(reason for panel in panels for reason in panel.white):
        masks = [panel.white[reason] for panel in panels if reason in panel.white]
        add(reason, masks, _sample(reason))
    add(SLOW, [panel.slow for panel in panels], _sample(SLOW))
    for kind in dict.fromkeys(kind for panel in panels for kind in panel.borders):
        entries[f"{as_math(kind)} (theory)"] = Line2D([], [], **cells.border_style(kind))
    for name in dict.fromkeys(name for panel in panels for name in panel.families):
        entries[f"{name.replace('_', ' ')} (exact)"] = Line2D(
            [], [], **cells.family_style(families.index(name))
        )
    return entries, [f"Too few to be seen: {'; '.join(too_small)}."] if too_small else []


def as_math(kind: str) -> str:
    """A kind of border with its rates as symbols."""
    for name in ("psi", "phi"):
        kind = kind.replace(f"{name}' = 0", f"{SYMBOLS[f'{name}_dot']} = 0")
    return kind


# Samples are part of the Axes, where they draw nothing.
_NOWHERE = np.full((1, 2), np.nan)


def _sample(region: str, colour: str = "") -> Patch:
    """Sample of the colour of a region, or its background, with the hatching of cells.HATCHES."""
    hatch = cells.HATCHES.get(region, cells.PLAIN)
    background = colour or hatch.background
    return Polygon(_NOWHERE, facecolor=background, edgecolor=hatch.colour, hatch=hatch.pattern, linewidth=0.4)
