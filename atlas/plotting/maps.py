"""Maps of atlases with theory drawn over the measurements, on one panel or several."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
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
    flag_names,
    is_logarithmic,
    map_variable,
    numeric_coordinates,
    positions_as_flags,
    scene_of,
    scene_problem,
    system_of,
)
from ..analysis.select import cell_edges, check_axes, check_panels, nearest_on_axes, plane_of
from ..errors import BadInput, allowed_text, attribute_text, shown
from ..flags import Regularity
from ..scene.checks import typed
from ..store.joined import subject_of
from ..systems.base import Mask, families_of
from ..variables import POINT, is_theory
from . import cells
from .cells import ColorScale
from .content import MIN_VISIBLE, NO_VALUE, SLOW, Panel, panel_of, remarks, visible
from .options import MapOptions, takes_map_options
from .style import (
    STYLE,
    SYMBOLS,
    PrintFigure,
    axis_label,
    caption,
    drawable,
    flag_colours,
    unit_text,
    variable_label,
    wrapped,
)

Entries = dict[str, Artist]  # text in the legend -> sample of the colour, hatching or line


@typed
@takes_map_options
def figure(
    panels: Sequence[xr.Dataset | tuple[xr.Dataset, str]] | Mapping[str, xr.Dataset | tuple[xr.Dataset, str]],
    **options: Any,
) -> Figure:
    """Figure of several atlases, or of several variables, with one legend for all panels.

    Panels of the same variable share a colour scale, and panels over the same axes share the axes.

    Parameters
    ----------
    panels : sequence or mapping of str to Dataset or (Dataset, str)
        Atlases, each alone or with the name of a variable. The keys of a mapping are written above the panels.
    **options

    Returns
    -------
    matplotlib.figure.Figure
        The figure, which has the panels row by row.

    Examples
    --------
    >>> atlas.figure({"radius": a, "velocity": b}, width="page").savefig("both.pdf")
    """
    listed = panels if isinstance(panels, list | tuple) else [panels]
    by_title = dict(panels) if isinstance(panels, dict) else dict(enumerate(listed))
    chosen, views = MapOptions(**options), list[View]()
    for title, panel in by_title.items():
        ds, variable = panel if isinstance(panel, tuple) and len(panel) == 2 else (panel, None)
        if not isinstance(ds, xr.Dataset):
            raise BadInput(f"panels: {title} = {shown(panel)}: must be an atlas, or an atlas and a variable")
        for view in views_of(subject_of(ds), variable, chosen):
            texts = [drawable(title), *view.texts] if isinstance(title, str) else view.texts
            views.append(replace(view, texts=[", ".join(texts)] if texts else []))
    if not views:
        raise BadInput("panels: must have at least one atlas")
    return draw(views, chosen)


def atlas_map(ds: xr.Dataset, variable: str | None = None, **options: Any) -> Figure:
    """Draw a map of a variable with theory over the values, or a scatter map of single points. See `Atlas.map`."""
    chosen = MapOptions(**options)
    return draw(views_of(ds, variable, chosen), chosen)


@dataclass(frozen=True)
class View:
    """Content and texts of one panel, which shows a variable over one or two axes, or at single points."""

    name: str  # name of the variable
    flags: Mapping[str, str]  # name of a flag -> colour, in the order of the values; empty for numbers
    flag_texts: Mapping[str, str]
    axes: list[str]  # names of the axes, x first
    labels: list[str]  # labels of the axes, x first; the y axis of a curve is labelled with the variable
    bar_label: str
    log: list[bool]  # whether each axis is logarithmic
    edges: list[np.ndarray]  # edges of cells along each axis, x first, or coordinates of points
    panel: Panel  # content of the panel, with angles in the unit to be shown
    notes: list[str]  # sentences below the figure
    families: list[str] = field(default_factory=list)  # families of the system in the order of their numbers
    texts: list[str] = field(default_factory=list)  # one text above the panel, or texts of row and column
    exponents: np.ndarray | None = None  # Lyapunov exponents of chaotic cells, nan in other cells
    heading: str = ""  # label of the variable if neither an axis nor a colour bar shows the label, else empty
    from_theory: bool = False  # whether theory alone gives the variable; the legend then omits "(theory)"

    def named(self) -> View:
        """Return the view with the heading added to the last text."""
        return replace(
            self, texts=[*self.texts[:-1], ": ".join(filter(None, [*self.texts[-1:], self.heading]))]
        )

    @property
    def is_points(self) -> bool:
        """Whether the panel shows single points."""
        return self.panel.array.dims == (POINT,)

    @property
    def is_curve(self) -> bool:
        """Whether the map has a single axis."""
        return len(self.edges) == 1

    def extent(self, axis: int) -> str:
        """Return a text that is equal for panels that can share the axis x (0) or y (1)."""
        edges = [] if self.is_points else [edge[[0, -1]].tolist() for edge in self.edges[axis : axis + 1]]
        return f"{self.labels[axis]} {edges} {self.log[axis : axis + 1] or self.name}"

    def draw(
        self,
        ax: Axes,
        scale: ColorScale,
        exponents: ColorScale | None,
        levels: list[int],
        width: float,
        *,
        inner: bool,
    ) -> ScalarMappable | None:
        """Draw the panel, which is `width` mm wide, and return the image for the colour bar. `inner` panels share a row with others."""
        array, image = self.panel.array, None
        if self.is_points:
            image = cells.draw_dots(ax, array, self.edges, scale, rare_on_top=bool(self.flags))
        elif self.flags and self.is_curve:
            cells.draw_levels(ax, array, list(self.flag_texts.values()), list(self.flags.values()), levels)
        else:
            image = cells.draw_values(ax, array, self.edges, scale)
        if self.name == "regularity" and len(array.dims) == 2:
            undecided = array.values == Regularity.UNDECIDED
            if undecided.any():
                cells.draw_hatching(ax, undecided, self.edges, cells.HATCHES[cells.UNDECIDED])
            if exponents is not None and self.exponents is not None:
                image = cells.draw_values(ax, array.copy(data=self.exponents), self.edges, exponents)
        for which, is_log in zip("xy", self.log, strict=False):
            cells.set_axis(ax, which, is_log, inner=inner and which == "x")
        if not self.is_points:
            cells.draw_overlay(ax, self.panel, self.edges, self.families, width)
        return image


def views_of(ds: xr.Dataset, variable: str | None, options: MapOptions) -> list[View]:
    """Return the panels of one variable of an atlas, row by row."""
    system_of(ds)
    for role in ("row", "col"):
        dim, is_row = getattr(options, role), role == "row"
        if dim in ds.dims and dim in ds.coords and ds[dim].dtype.kind in "OSTU":
            check_panels(dim, ds.sizes[dim])
            parts, rest = list[list[View]](), replace(options, **{role: None})  # type: ignore[arg-type]
            for i, value in enumerate(ds[dim].values):
                part, text = subject_of(ds.isel({dim: i})), [drawable(str(value))]
                part = part.drop_vars(dim, errors="ignore")
                variable = map_variable(part) if variable is None else variable
                views = views_of(part, variable, rest)
                parts.append([replace(v, texts=text + v.texts if is_row else v.texts + text) for v in views])
            return [view for row in (parts if is_row else zip(*parts, strict=True)) for view in row]
    name = map_variable(ds) if variable is None else variable
    if name not in list(ds.data_vars):
        raise BadInput(
            f"{name}: not a variable of this atlas; {allowed_text(name, list(map(str, ds.data_vars)))}"
        )
    texts_of = cells.regularity_texts if name == "regularity" else extension.load("flag_texts", name)
    texts = texts_of(ds) if texts_of else {}
    ds = positions_as_flags(ds, name)
    flags = {
        flag: (options.colors or {}).get(flag, c) for flag, c in flag_colours(flag_names(ds[name])).items()
    }
    texts = {flag: text_of(options, flag, texts.get(flag, flag.replace("_", " "))) for flag in flags}
    views_over = points_view if ds[name].dims == (POINT,) else axes_views
    return views_over(ds, options, partial(View, name, flags, texts))


def axes_views(ds: xr.Dataset, options: MapOptions, view: partial[View]) -> list[View]:
    """Return the panels of a variable over its axes. `view` holds the name and the flags of the variable."""
    name, flags = view.args[:2]
    ds = ds.drop_dims(set(ds.dims) - set(ds[name].dims))  # drops axes over which the variable was averaged
    select, degrees = options.select or {}, options.degrees
    in_input = degrees is True  # whether angles in `select` are in degrees; display_units only change output
    plane, dims, panel_dims = plane_of(
        ds, options.x, options.y, select, options.row, options.col, degrees=in_input
    )
    scene = scene_of(ds)
    log = [is_logarithmic(scene, dim, plane[dim].values) for dim in dims]
    edges = [cell_edges(plane[dim].values, is_log) for dim, is_log in zip(dims, log, strict=True)]
    has_axes = scene is not None and axes_of(scene).keys() <= ds.coords.keys()
    if options.boundary and has_axes and (problem := scene_problem(ds, plane)):
        logging.getLogger("atlas").warning("no theory on this map: %s", problem)
        scene = None
    notes = remarks(ds, filled=not flags)
    if options.caption:
        notes.append(caption(nearest_on_axes(ds, select, in_input)))
    labels = [text_of(options, dim, axis_label(in_degrees(plane[[dim]], degrees), dim)) for dim in dims]
    label = label_of(options, in_degrees(plane[name], degrees), ds)
    shown_edges = [e * factor(plane[dim].attrs, degrees) for e, dim in zip(edges, dims, strict=True)]
    views = []
    for index in np.ndindex(*(plane.sizes[dim] for dim in panel_dims)):
        part, texts = plane.isel(dict(zip(panel_dims, index, strict=True))), []
        place = in_degrees(part[panel_dims], degrees)
        for dim in panel_dims:
            value = f"{float(place[dim]):.4g}".replace("-", "\N{MINUS SIGN}")
            unit = unit_text(attribute_text(place[dim].attrs, "units"))
            texts.append(drawable(f"{axis_label(place, dim, unit=False)} = {value} {unit}".strip()))
        panel = visible(panel_of(part, name, dims, scene, options.boundary), edges).in_degrees(degrees)
        families, exponents = list(families_of(system_of(ds))), cells.chaotic_exponents(part, panel.array)
        heading = label if flags and len(dims) == 2 else ""
        bar_label = label
        if exponents is not None:
            bar_label = variable_label(plane["lyapunov"]).replace("exponent", r"exponent $\lambda$")
        shown_labels = [*labels, label][:2]
        views.append(
            view(
                dims,
                shown_labels,
                bar_label,
                log,
                shown_edges,
                panel,
                notes,
                families,
                texts,
                exponents,
                heading,
                is_theory(system_of(ds), name),
            )
        )
    if any(view.panel.crowded for view in views):
        logging.getLogger("atlas").warning(
            "%s: the grid is coarser than the lines of theory: many of its cells have two, with a region between them that may have"
            " no point; a finer grid or [refine] shows it",
            name,
        )
    return views


def points_view(ds: xr.Dataset, options: MapOptions, view: partial[View]) -> list[View]:
    """Return the panel of a variable of single points. `view` holds the name and the flags of the variable."""
    for option in ("select", "row", "col"):
        if getattr(options, option):
            raise BadInput(
                f"{option}: these are single points without axes; choose some by ds.atlas.select or ds.sel"
            )
    axes = scatter_axes(ds, options.x, options.y)
    notes = [caption(ds)] if options.caption else []
    (name, flags), log = view.args[:2], list[bool]()
    ds = in_degrees(ds[[name, *axes]].load(), options.degrees)
    array, places = ds[name], [np.asarray(ds[axis].values, float) for axis in axes]
    missing = np.zeros(array.shape, bool) if flags else ~np.isfinite(array.values)
    panel = Panel(array, {NO_VALUE: missing} if missing.any() else {}, np.zeros(array.shape, bool))
    for column in places:
        # An axis is logarithmic if a logarithmic scale spreads positive values more evenly.
        spread = bool((column > 0).all()) and column.max() >= cells.MIN_LOG_RATIO * column.min()
        log.append(spread and bool((np.median(column) - column.min()) / np.ptp(column) < 0.1))
    labels = [text_of(options, axis, axis_label(ds, axis)) for axis in axes]
    label = label_of(options, array, ds)
    return [view(axes, labels, label, log, places, panel, notes, heading=label if flags else "")]


def text_of(options: MapOptions, name: str, default: str) -> str:
    """Return the caller's text for a flag, an axis or a variable, or else `default`."""
    return drawable(str((options.labels or {}).get(name, default)))


def label_of(options: MapOptions, array: xr.DataArray, ds: xr.Dataset) -> str:
    """Return the text for the variable of a map. It contains the word theory if the variable comes from theory alone."""
    name = str(array.name)
    return text_of(options, name, variable_label(array, theory=is_theory(system_of(ds), name)))


def scatter_axes(ds: xr.Dataset, x: str | None, y: str | None) -> list[str]:
    """Return x and y of a scatter map, by default the coordinates with most distinct values. Raise BadInput if fewer than two vary."""
    allowed = [name for name in numeric_coordinates(ds, POINT) if name != POINT]
    check_axes(allowed, "a number given at each of these points", x=x, y=y)
    varied_by_scene: set[str] = set()  # parameters for which the scene gives a range or a column
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


def draw(views: list[View], options: MapOptions) -> Figure:
    """Draw panels row by row with one legend."""
    check_options(views, options)
    # The legend names a single flag variable. Without `ax`, panels name flag variables instead if there are several or a title is given.
    headings = list(dict.fromkeys(view.heading for view in views if view.heading))
    heading = "".join(headings[:1]) if len(headings) == 1 else ""
    if options.ax is None and (options.title or not heading):
        views, heading = [view.named() for view in views], ""
    options = replace(options, title=options.title and drawable(options.title))
    # On a narrow figure, curves of flags need a whole row, because the names of the flags stand beside the curve.
    most = 4 if options.size_mm[0] >= 130 else 1 if views[0].is_curve and views[0].flags else 2
    columns = options.columns or (1 if options.row else min(len(views), most))
    if len(views[0].texts) == 2:
        columns = sum(view.texts[0] == views[0].texts[0] for view in views)
    by_variable, levels = dict[str, np.ndarray](), dict[str, list[int]]()
    for view in views:
        values = [each.panel.array.values.ravel() for each in views if each.name == view.name]
        by_variable[view.name] = np.concatenate(values)
        levels[view.name] = np.unique(by_variable[view.name].astype(int)).tolist() if view.flags else []
    exponents = cells.exponent_scale(view.exponents for view in views)
    width = options.size_mm[0] / columns
    heights = [8.0 + 7.0 * len(levels[v.name]) if v.flags else 0.6 * width for v in views if v.is_curve]
    height = max(heights) if len(heights) == len(views) else None
    share_x, share_y = (len({view.extent(axis) for view in views}) == 1 for axis in (0, 1))
    with nullcontext() if options.ax is not None else rc_context(STYLE):
        entries, notes = map_legend(views, width, caption=options.caption)
        sheet = Sheet(options, len(views), columns, height, share_x, share_y, heading)
        fig, axes = sheet.figure(entries, notes)
        bars: dict[int, tuple[Callable[[list[Axes]], None], list[Axes]]] = {}
        for i, (view, ax) in enumerate(zip(views, axes, strict=True)):
            scale = cells.color_scale(
                by_variable[view.name], list(view.flags.values()), options,
                name=view.name, angle=cells.is_angle(view.panel.array),
            )  # fmt: skip
            image = view.draw(ax, scale, exponents, levels[view.name], width, inner=columns > 1)
            if view.is_curve and not view.flags:
                if isinstance(options.norm, str):
                    ax.set_yscale(options.norm)
                ax.set_ylim(options.vmin, options.vmax)
            if len(view.texts) == 1 or (view.texts and i < columns):
                ax.set_title(wrapped(view.texts[-1], 0.75 * width, 8, fig.dpi))
            if len(view.texts) == 2 and (i + 1) % columns == 0:
                ax.annotate(view.texts[0], (1.03, 0.5), xycoords="axes fraction", rotation=270, va="center")
            of_bar = scale if not view.flags else exponents if view.exponents is not None else None
            if image is not None and of_bar is not None:
                bar = partial(cells.add_color_bar, fig, image=image, scale=of_bar, label=view.bar_label)
                bars.setdefault(i if len(by_variable) > 1 else -1, (bar, []))[1].append(ax)
        sheet.label_axes(axes, [view.labels for view in views], entries)
        for add_bar, beside in bars.values():
            add_bar(beside)
    return fig


def check_options(views: list[View], options: MapOptions) -> None:
    """Raise BadInput for options that suit no panel, and for too many panels."""
    if options.ax is not None and len(views) > 1:
        raise BadInput(f"ax: {len(views)} panels do not fit into one; choose one by select")
    check_panels("these", len(views))
    flags = list(dict.fromkeys(flag for view in views for flag in view.flags))
    for name in ("cmap", "vmin", "vmax", "norm"):
        if getattr(options, name) is not None and all(view.flags for view in views):
            raise BadInput(
                f"{name}: {views[0].name} has flags, each with a colour of its own; choose them by colors"
            )
    if options.colors and not flags:
        raise BadInput(f"colors: {views[0].name} has no flags; choose its colours by cmap")
    others = dict.fromkeys(name for view in views for name in [*view.axes, view.name])
    for name, names, allowed in (
        ("colors", options.colors, flags),
        ("labels", options.labels, [*flags, *others]),
    ):
        for each in names or {}:
            if each not in allowed:
                raise BadInput(f"{name}: {shown(each)}: {allowed_text(each, allowed)}")


TEXT_ROW = 2.8  # height of a line of text, mm
LEGEND_SHARE = 0.97  # largest width of a legend, divided by the figure's; below 1, because letters are wider at low resolution


@dataclass(frozen=True)
class Sheet:
    """Figure with panels in rows, or the Axes of the caller."""

    options: MapOptions  # choices of the caller
    panels: int = 1
    columns: int = 1  # number of panels in a row
    panel_height: float | None = None  # height in mm, or None for the height of a map over two axes
    share_x: bool = True
    share_y: bool = True
    heading: str = ""  # heading of the legend, if the caller chose no title

    def figure(self, legend: Entries, notes: Sequence[str]) -> tuple[Figure, list[Axes]]:
        """Return the figure and its empty panels, with legend, title and notes. On Axes of the caller, notes are logged instead."""
        options = self.options
        legend = legend if options.legend else {}
        if options.ax is not None:
            caller = options.ax.get_figure(root=True)
            assert caller is not None
            handles, names = list(legend.values()), list(legend)
            if legend:  # there may be no room for a legend around the Axes of the caller
                options.ax.legend(
                    handles, names, loc="upper right", fontsize="small", framealpha=0.85,
                    title=self.heading or None, title_fontsize="small",
                )  # fmt: skip
            if title := options.title or ("" if legend else self.heading):
                options.ax.set_title(title)
            for note in notes:
                logging.getLogger("atlas").info("%s", note)
            return caller, [options.ax]
        width, height = options.size_mm
        figure = PrintFigure(
            figsize=(width / 25.4, (height or width) / 25.4), layout="constrained", dpi=float(options.dpi)
        )
        text = wrapped(drawable(" ".join(notes)), width - 3.0, 6.5, figure.dpi)
        foot = TEXT_ROW * (text.count("\n") + 1) + 2.0 if text else 0.0
        head = self._draw_legend(figure, legend)
        rows = -(-self.panels // self.columns)
        if height is None:
            of_map = (0.5 if width >= 130 else 0.72) * width
            if self.panels > 1:
                of_map = 0.72 * width / self.columns + 6.0  # room for a title above each panel
            height = rows * (self.panel_height or of_map) + head + foot + 9.0
            figure.set_size_inches(width / 25.4, height / 25.4)
        engine = figure.get_layout_engine()
        assert engine is not None
        engine.set(rect=(0, foot / height, 1, 1 - foot / height), w_pad=0.02, h_pad=0.02)  # type: ignore[call-arg]
        if text:
            figure.text(1.5 / width, 1.0 / height, text, fontsize=6.5, va="bottom", ha="left")
        grid = figure.subplots(rows, self.columns, sharex=self.share_x, sharey=self.share_y, squeeze=False)
        axes = list(grid.ravel())
        for unused in axes[self.panels :]:
            unused.remove()
        return figure, axes[: self.panels]

    def _draw_legend(self, figure: Figure, legend: Entries) -> float:
        """Draw title and legend above the panels. The legend has as many columns as fit. Return the height of title and legend, mm."""
        width = self.options.size_mm[0]
        texts = [wrapped(text, width - 9.0, 7, figure.dpi) for text in legend]
        size, text = (9, self.options.title) if self.options.title else (8, self.heading)
        title = wrapped(text, width, size, figure.dpi) if text else None
        letters = 6.5 if width < cells.NARROW else 7
        entries = list(zip(legend.values(), texts, strict=True))
        by_length = sorted(entries, key=lambda entry: len(entry[1]))
        # A column is as wide as its longest text. Entries may be sorted by length, so that more columns fit.
        for columns, listed in product(range(len(legend), 0, -1), (entries, by_length, by_length[::-1])):
            drawn = figure.legend(
                *zip(*listed, strict=True), loc="outside upper center",
                ncols=columns, frameon=False, columnspacing=0.8, fontsize=letters,
                handlelength=1.6, handletextpad=0.5, borderaxespad=0.2, borderpad=0, title=title, title_fontsize=size,
            )  # fmt: skip
            box = drawn.get_window_extent()
            if columns == 1 or box.width < LEGEND_SHARE * figure.bbox.width:
                return box.height / figure.dpi * 25.4
            drawn.remove()
        if title is None:
            return 0.0
        figure.suptitle(title, fontsize=size)
        return 1.0 + 4.0 * (title.count("\n") + 1)

    def label_axes(self, axes: list[Axes], labels: Sequence[Sequence[str]], entries: Entries) -> None:
        """Label the axes of the panels, with one common label if all labels agree, and add the samples of the legend to axes[0]."""
        for text, sample in entries.items():
            sample.set_label(text)
            axes[0].add_artist(sample)
        figure = axes[0].get_figure(root=True)
        assert figure is not None
        width = self.options.size_mm[0]
        for which, share, own in zip("xy", (0.7, 0.6), zip(*labels, strict=True), strict=True):
            if len(axes) > 1 and len(set(own)) == 1:
                getattr(figure, f"sup{which}label")(wrapped(own[0], share * width, 8, figure.dpi))
            else:
                for ax, text in zip(axes, own, strict=True):
                    ax.set(**{f"{which}label": wrapped(text, share * width / self.columns, 8, figure.dpi)})
        for ax in axes[-self.columns :]:  # panels with no panel below
            ax.tick_params(labelbottom=True)


def map_legend(views: Sequence[View], width: float, *, caption: bool) -> tuple[Entries, list[str]]:
    """Return the legend of all panels and the sentences below the figure. Each panel is `width` mm wide."""
    regions: dict[str, tuple[Patch, list[Mask]]] = {}  # text -> sample, and mask of the region in each panel
    panels = [view.panel for view in views]
    for view, panel in zip(views, panels, strict=True):
        white = sum(panel.white.values(), np.zeros(panel.array.shape, bool))
        for value, (flag, colour) in enumerate({} if view.is_curve else view.flags.items()):
            text, sample = view.flag_texts[flag], _sample(flag, colour)
            if regions.get(text, (sample,))[0].get_facecolor() != sample.get_facecolor():
                text += f" ({view.name.replace('_', ' ')})"  # another variable has a flag of this name
            regions.setdefault(text, (sample, []))[1].append((panel.array.values == value) & ~white)
    for panel in panels:
        for reason, mask in panel.white.items():
            regions.setdefault(reason, (_sample(reason), []))[1].append(mask)
    for panel in panels:
        regions.setdefault(SLOW, (_sample(SLOW), []))[1].append(panel.slow)
    entries: Entries = {
        text: sample
        for text, (sample, masks) in regions.items()
        if any(mask.mean() >= MIN_VISIBLE for mask in masks)
    }
    source = "" if all(view.from_theory for view in views) else " (theory)"
    for panel in panels:
        for kind in panel.borders:
            entries.setdefault(as_math(kind) + source, Line2D([], [], **cells.border_style(kind, width)))
    for view in views:
        for name in view.panel.families:
            style = cells.family_style(view.families.index(name), width)
            entries[f"{name.replace('_', ' ')} (exact)"] = Line2D([], [], **style)
    notes = [note for view in views for note in view.notes]
    rare = [
        f"{text}, {mask.sum()} of {mask.size} points"
        for text, (_, masks) in regions.items()
        if text not in (*entries, SLOW)
        for mask in masks
        if mask.any()
    ]
    if rare and caption:
        notes.insert(0, f"Too few to be seen: {'; '.join(rare)}.")
    elif rare:
        logging.getLogger("atlas").info("too few to be seen, and not in the legend: %s", "; ".join(rare))
    return entries, list(dict.fromkeys(notes))


def as_math(kind: str) -> str:
    """Return the text for a kind of border, with symbols in place of the names of rates."""
    for name in ("psi", "phi"):
        kind = kind.replace(f"{name}' = 0", f"{SYMBOLS[f'{name}_dot']} = 0")
    return kind


# Position of samples of the legend. Samples belong to the Axes, but at nan they draw nothing in the Axes.
_NOWHERE = np.full((1, 2), np.nan)


def _sample(region: str, colour: str = "") -> Patch:
    """Return a legend sample of a region with its hatching, on `colour` or else on the hatching's background."""
    hatch = cells.HATCHES.get(region, cells.PLAIN)
    background = colour or hatch.background
    return Polygon(_NOWHERE, facecolor=background, edgecolor=hatch.colour, hatch=hatch.pattern, linewidth=0.4)
