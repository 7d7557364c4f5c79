"""Figures for papers: maps of an atlas with theory drawn over the measurements, and trajectories."""

from __future__ import annotations

import logging
import math
import os
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import contourpy
import numpy as np
import xarray as xr
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from . import compare, grid, systems
from .scene import Axis, Duration, Scene, load_scene
from .store import check_folder
from .systems.system import BadInput, Family, System, on_family

Width = Literal["column", "page"]
WIDTHS = {"column": 88.0, "page": 180.0}  # mm, one and two columns of a journal
FORMATS = (".png", ".pdf", ".svg")
MOST_PANELS = 12
# More cells than the printer has dots along an axis are not drawn: every k-th one is.
MOST_CELLS = 2000
# Even, so that no sample falls on the middle of a frame, where special values such as 0 like to be.
SAMPLES = 300
DECADES = 10  # at most, of a logarithmic colour scale
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same everywhere
    "mathtext.fontset": "dejavusans",
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,
    "savefig.dpi": 600,
    "svg.hashsalt": "atlas",
}
# Safe for colour-blind readers and, by their luminance, readable in grey: one colour per meaning.
COLOURS = {
    "not_computed": "#ffffff",
    "permanent_rotation": "#a8d8f0",
    "drifting": "#e0892b",
    "regular_precession": "#1b6ca8",
    "unresolved": "#262626",
    "not_compared": "#ffffff",
    "agree": "#b9e3cc",
    "theory_only": "#e0892b",
    "numerics_only": "#1b6ca8",
    "differ": "#262626",
    "unknown": "#ffffff",
    "stable": "#a8d8f0",
    "unstable": "#e0892b",
}
DASHES: tuple[Any, ...] = ((0, (8, 2)), ":", "-.", "--", (0, (6, 1, 1, 1, 1, 1)))
RATES = ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
SYMBOLS = {
    "theta": r"$\theta$",
    "psi": r"$\psi$",
    "phi": r"$\varphi$",
    "theta_dot": r"$\dot\theta$",
    "psi_dot": r"$\dot\psi$",
    "phi_dot": r"$\dot\varphi$",
    "normal_rate": r"$\omega'\cdot\gamma$",
}
FRAME_AXES = {"orbital": ("radius", "velocity", "normal"), "space": ("$x$", "$y$", "vertical")}
STATISTICS = {"mean": "mean", "rms": "rms", "std": "standard deviation of", "min": "least", "max": "largest"}


def flag_colours(meanings: Iterable[str]) -> dict[str, str]:
    """A colour for each flag of a variable, the same in every figure: the first is white."""
    names = list(meanings)
    # even steps of luminance from white, which continues the map beyond its light end
    shades = colormaps["cividis"](np.linspace(1.1, 0.0, len(names)))
    return {
        name: COLOURS.get(name, "#ffffff" if i == 0 else to_hex(shades[i])) for i, name in enumerate(names)
    }


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


# Theory on the plane of a map.


@dataclass(frozen=True)
class Plane:
    """Part of a scene's parameter space that a map shows: one or two axes, the others held."""

    scene: Scene
    frame: Mapping[str, tuple[float, float]]  # dimension of the atlas -> lowest and highest value, x first
    held: Mapping[str, float]  # dimension -> value, all others

    @staticmethod
    def of(scene: Scene, ds: xr.Dataset, dims: Iterable[str]) -> Plane:
        """The plane of some dimensions of an atlas whose other axes have one value each."""
        frame = {dim: (float(ds[dim].min()), float(ds[dim].max())) for dim in dims}
        held = {}
        for dim in axes_of(scene):
            if dim not in frame:
                if dim not in ds.coords or ds[dim].size != 1:
                    raise BadInput(f"{dim}: this axis of the scene has no single value here; select one")
                held[dim] = float(ds[dim].item())
        return Plane(scene, frame, held)

    def log(self, dim: str) -> bool:
        """Is the axis spaced evenly in its logarithm?"""
        return axes_of(self.scene)[dim].table.get("spacing") == "log"

    def samples(self, dim: str, count: int = SAMPLES) -> np.ndarray:
        """Values along an axis, evenly spread over the frame."""
        return (np.geomspace if self.log(dim) else np.linspace)(*self.frame[dim], count)

    def points(self, places: Mapping[str, np.ndarray]) -> grid.Grid:
        """The points at places in the frame, before their duration is known."""
        size = next(iter(places.values())).shape
        every = {dim: np.full(size, value) for dim, value in self.held.items()} | dict(places)
        axes = axes_of(self.scene)
        # a duration in turns has no value where nothing turns, and theory does not ask for one
        timeless = replace(self.scene, duration=Duration(1.0))
        return grid.points_at(timeless, {axes[dim].name: values for dim, values in every.items()})

    def stable(self, places: Mapping[str, np.ndarray]) -> np.ndarray:
        """Linear stability from theory at places in the frame: 0 unknown, 1 stable, 2 unstable."""
        found = self.points(places)
        theory = compare.theory(self.scene.system, found.base, self.scene.settings.rate_tolerance, False)
        return np.where(found.there, theory["stable"], 0)


def stability_boundary(plane: Plane) -> list[np.ndarray]:
    """Lines between linearly stable and unstable motions in a plane, from theory.

    Returns arrays of shape (vertices, axes of the plane). The lines are traced on SAMPLES x SAMPLES
    points, and each vertex is then bisected to 1e-5 of the distance between them.
    """
    lines = [plane.samples(dim) for dim in plane.frame]

    def flags(index: np.ndarray) -> np.ndarray:
        columns = [np.interp(index[:, i], np.arange(SAMPLES), line) for i, line in enumerate(lines)]
        return plane.stable(dict(zip(plane.frame, columns, strict=True)))

    nodes = np.stack(np.meshgrid(*[np.arange(SAMPLES, dtype=float)] * len(lines), indexing="ij"), -1)
    stable = flags(nodes.reshape(-1, len(lines))).reshape(nodes.shape[:-1])
    if len(lines) == 1:
        flips = np.flatnonzero((stable[1:] != stable[:-1]) & (stable[1:] > 0) & (stable[:-1] > 0))
        found = [np.array([[flip + 0.5]]) for flip in flips]
    else:
        known = np.ma.masked_equal(stable.T, 0)
        generator = contourpy.contour_generator(z=known, corner_mask=False, line_type="Separate")
        # A ring of four vertices holds a single sample: the tip of a cusp that the samples broke off.
        found = [line for line in cast("list[np.ndarray]", generator.lines(1.5)) if len(line) > 5]
    if not found:
        return []
    vertex = np.concatenate(found)
    low, high = np.floor(vertex), np.ceil(vertex)  # the two nodes of the edge that the vertex halves
    at_low = flags(low)
    for _ in range(17):
        middle = 0.5 * (low + high)
        same = (flags(middle) == at_low)[:, np.newaxis]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    columns = [np.interp(0.5 * (low + high)[:, i], np.arange(SAMPLES), line) for i, line in enumerate(lines)]
    return np.split(np.stack(columns, -1), np.cumsum([len(line) for line in found])[:-1])


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Where exact steady motions cross a plane: family -> curves of shape (vertices, axes of the plane).

    A family shows if it can be solved for an axis of the plane; the family of the scene, or every one
    if the scene names none. Curves are cut by rows of nan. Where a scene solves its points onto a
    family only an axis offset from the family has a curve: its zero.
    """
    scene, axes = plane.scene, axes_of(plane.scene)
    if scene.solve:
        dims = list(plane.frame)
        curves = []
        for i, dim in enumerate(dims):
            low, high = plane.frame[dim]
            if axes[dim].offset_from_family and low <= 0 <= high:
                ends = np.array([list(plane.frame[d]) for d in dims]).T if len(dims) > 1 else np.zeros((1, 1))
                ends[:, i] = 0.0
                curves.append(ends)
        return {str(scene.family): curves} if curves else {}
    named = [scene.family] if scene.family is not None else list(scene.system.families)
    found = {}
    for name in named:
        family = scene.system.families[name]
        # Whichever axis gives the longer curve: solved for the other one it may be a single point.
        best = max((_solved(plane, family, dim) for dim in plane.frame), key=_length)
        if _length(best):
            found[name] = best
    return found


def _length(curves: list[np.ndarray]) -> int:
    return sum(int(np.isfinite(curve).all(1).sum()) for curve in curves)


def _solved(plane: Plane, family: Family, dim: str) -> list[np.ndarray]:
    """The family solved for one axis over the other: every branch that enters the frame."""
    scene = plane.scene
    tied = any(dim in tie.names for tie in scene.ties.values())
    if dim not in family.solve or tied:
        return []
    # Formulas with several branches answer with the one near the value given; uneven starts, so that
    # none of them is a solution by chance.
    low, high = plane.frame[dim]
    starts = low + (high - low) * (np.arange(17) + 0.381966) / 17
    others = [d for d in plane.frame if d != dim]

    def branches(along: np.ndarray) -> np.ndarray:
        start, other = (a.ravel() for a in np.meshgrid(starts, along, indexing="ij"))
        base = dict(plane.points({dim: start} | {d: other for d in others}).base)
        with np.errstate(all="ignore"):
            base[dim] = np.asarray(family.solve[dim](base), float)
            there = on_family(family, base) < grid.ON_FAMILY
            if scene.family is None:  # families overlap: the first that holds is the point's
                there &= scene.system.recognise(base)[0] == family.flag
        # A formula that gives back what it was given: the whole plane is on the family, or none of it.
        there &= np.isfinite(base[dim]) & (np.abs(base[dim] - start) > 1e-9 * (high - low))
        return np.where(there, base[dim], np.nan).reshape(starts.size, along.size)

    along = plane.samples(others[0]) if others else np.zeros(1)
    values = branches(along)
    ends = np.flatnonzero((np.isfinite(values[:, 1:]) != np.isfinite(values[:, :-1])).any(0))
    if 0 < ends.size <= 8:  # curves often end steeply, where a cosine passes 1
        along = np.unique(
            np.concatenate([along, *(np.linspace(along[i], along[i + 1], 2 * SAMPLES) for i in ends)])
        )
        values = branches(along)
    values[:, 1:][np.abs(np.diff(values)) > high - low] = np.nan  # the two sides of a pole
    curves: list[np.ndarray] = []
    for branch in np.unique(values.round(12), axis=0):
        with np.errstate(invalid="ignore"):
            inside = (branch >= low) & (branch <= high)
        repeated = any(np.allclose(branch, c[:, -1], rtol=0, atol=1e-9, equal_nan=True) for c in curves)
        enough = (inside[1:] & inside[:-1]).any() if others else inside.any()
        if enough and not repeated:
            curves.append(np.stack([along, branch], -1) if others else branch[:, np.newaxis])
    if others and next(iter(plane.frame)) == dim:
        curves = [curve[:, ::-1] for curve in curves]
    return curves


# Text.


def _math(name: str, system: System) -> str:
    """Mathematical form of a parameter."""
    return system.parameters[name].symbol or name


def unit_text(unit: str) -> str:
    """A unit in UDUNITS spelling for print, with raised exponents; empty for pure numbers."""
    if unit in ("", "1"):
        return ""
    return re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", unit)


def axis_label(ds: xr.Dataset, dim: str, *, unit: bool = True) -> str:
    """Symbol and unit of an axis: those of the registry, or the long_name and units that the scene gave."""
    system, attributes = system_of(ds), ds[dim].attrs
    text = str(attributes.get("long_name", dim))
    stem = dim.removesuffix("_offset")
    if dim in system.parameters and text == system.parameters[dim].meaning:
        text = _math(dim, system)
    elif dim != stem and stem in system.parameters and "offset from the family" in text:
        text = f"{_math(stem, system)}, offset from the family"
    else:
        words = re.findall(r"[A-Za-z_]\w*", text)
        if words and all(word in system.parameters for word in words):
            text = re.sub(r"[A-Za-z_]\w*", lambda word: _math(word[0], system).strip("$"), text)
            text = f"${text.replace('*', ' ')}$"
    units = unit_text(str(attributes.get("units", "")))
    return f"{text} ({units})" if unit and units else text


def variable_label(array: xr.DataArray) -> str:
    """Short name and unit of a variable: a statistic of a symbol, or the words of its name."""
    name, units = str(array.name), unit_text(str(array.attrs.get("units", "")))
    stem, _, statistic = name.rpartition("_")
    text = f"{STATISTICS[statistic]} {SYMBOLS[stem]}" if stem in SYMBOLS else name.replace("_", " ")
    return f"{text} ({units})" if units else text


def flag_names(array: xr.DataArray) -> list[str]:
    """Names of the values 0, 1, 2, ... of a flag variable; empty for any other variable."""
    return str(array.attrs.get("flag_meanings", "")).split()


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
    text = _foot(nearest(ds, select or {}), width) if caption else ""
    array = part[name].transpose(*[d for d in (panel_dim, *dims[::-1]) if d]).load()
    panels = (
        [part.isel({panel_dim: i}) for i in range(part.sizes[panel_dim])] if panel_dim is not None else [part]
    )
    scene = scene_of(ds)
    with rc_context(STYLE):
        figure, axes = _figure(len(panels), width, len(dims), bool(flag_names(array)), text)
        paint, legend = _paint(array)
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
        _finish(figure, axes, array, image, paint.extend, legend, width)
    return figure


def _foot(ds: xr.Dataset, width: Width) -> str:
    return textwrap.fill(caption(ds), 68 if width == "column" else 145)


def plane_of(
    ds: xr.Dataset, x: str | None, y: str | None, select: Mapping[str, float]
) -> tuple[xr.Dataset, list[str], str | None]:
    """The part of an atlas that a map shows, its axes (x first) and the axis of its panels.

    Sorted along its axes; of axes longer than MOST_CELLS every k-th value. Nothing is loaded.
    """
    part = nearest(ds, select).squeeze()
    dims, panel_dim = _dims(part, x, y)
    part = part.isel({dim: slice(None, None, -(-part.sizes[dim] // MOST_CELLS)) for dim in dims})
    return part.sortby(dims + ([panel_dim] if panel_dim else [])), dims, panel_dim


def _dims(ds: xr.Dataset, x: str | None, y: str | None) -> tuple[list[str], str | None]:
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
        if len(longest) > 1 or ds.sizes[dim] > MOST_PANELS:
            raise BadInput(
                f"{dim} has {ds.sizes[dim]} values here: choose one by select = {{{dim!r}: value}}"
            )
    return [d for d in (x, y) if d is not None], (longest[0] if longest else None)


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
class _Paint:
    colours: Colormap
    norm: Normalize
    extend: str = "neither"


def _paint(array: xr.DataArray) -> tuple[_Paint, dict[str, Patch | Line2D]]:
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
        return _Paint(ListedColormap(list(colours.values())), norm), legend
    finite = values[np.isfinite(values)]
    if finite.size < values.size:
        legend["no value"] = _patch("#ffffff")
    if not finite.size:
        return _Paint(colormaps["viridis"], Normalize(0, 1)), legend
    low, high = float(finite.min()), float(finite.max())
    if low < 0 < high:
        # Cividis is blue below, grey at and yellow above its middle, and its luminance tells the sign.
        edge = max(-low, high)
        return _Paint(colormaps["cividis"], Normalize(-edge, edge)), legend
    if high > 0:
        least = float(finite[finite > 0].min())
        if high > 100 * least:
            floor = max(least, high * 10.0**-DECADES)
            return _Paint(
                colormaps["viridis"], LogNorm(floor, high), "min" if low < floor else "neither"
            ), legend
    if low == high:
        low, high = low - 0.5, high + 0.5
    return _Paint(colormaps["viridis"], Normalize(low, high)), legend


def _patch(colour: str) -> Patch:
    return Patch(facecolor=colour, edgecolor="0.4", linewidth=0.4)


def _draw(ax: Axes, array: xr.DataArray, dims: list[str], log: list[bool], paint: _Paint) -> Any:
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


def _finish(
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
            list(legend.values()), list(legend), loc="outside upper center", ncols=_columns(legend, WIDTHS[width]),
            frameon=False, handlelength=1.8, columnspacing=1.4, borderaxespad=0.2,
        )  # fmt: skip


def _columns(entries: Iterable[str], wide: float) -> int:
    """The most columns of a legend that fit a width in mm; entries fill one column after the other."""
    names = list(entries)
    for columns in range(len(names), 1, -1):
        longest = [max(map(len, part)) for part in np.array_split(np.array(names, object), columns)]
        if sum(10.0 + 1.4 * length for length in longest) < wide:
            return columns
    return 1


# Trajectories.


def trajectory_figure(tr: xr.Dataset, *, width: Width = "page") -> Figure:
    """Angles and rates over time, and the path of the third body axis on the unit sphere of the frame.

    tr: as `atlas.trajectory` returns it. psi and phi are shown between -pi and pi; the path is dark on
    the near side of the sphere and pale on the far side, with a dot at its start. Where a passage near
    the vertical makes rates more than ten times their 90 % quantile, the panel ends at three times that.
    """
    if width not in WIDTHS:
        raise BadInput(f"width = {width!r}: allowed: {', '.join(WIDTHS)}")
    missing = [n for n in ("theta", "psi", "phi", *RATES, "axis_x", "axis_y", "axis_z") if n not in tr]
    if missing or "time" not in tr.dims:
        raise BadInput(f"not a trajectory: {missing[0] if missing else 'time'} is missing")
    time = tr["time"].values
    colours = [COLOURS["regular_precession"], COLOURS["drifting"], "black", "#7fb9d8"]
    with rc_context(STYLE):
        wide = WIDTHS[width]
        page = width == "page"
        size = (wide, 85.0) if page else (wide, 165.0)
        figure = Figure(figsize=(size[0] / 25.4, size[1] / 25.4), layout="constrained")
        if page:
            parts = figure.subfigures(1, 2, width_ratios=(1.35, 1), squeeze=False)
        else:
            parts = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)
        left, right = parts.ravel()
        tilt, turn, rate = left.subplots(3, 1, sharex=True)
        tilt.plot(time, tr["theta"].values, color=colours[0])
        tilt.set_ylabel(r"$\theta$ (rad)")
        for name, colour, dashes in (("psi", colours[0], "-"), ("phi", colours[1], "--")):
            turn.plot(time, _around(tr[name].values), color=colour, linestyle=dashes, label=SYMBOLS[name])
        turn.set_ylim(-np.pi, np.pi)
        turn.set_yticks([-np.pi, 0, np.pi], [r"$-\pi$", "0", r"$\pi$"])
        turn.set_ylabel(r"$\psi$, $\varphi$ (rad)")
        for name, colour, dashes in zip(RATES, colours, ("-", "--", ":", "-."), strict=True):
            rate.plot(time, tr[name].values, color=colour, linestyle=dashes, label=SYMBOLS[name])
        rate.set_ylabel("rates (rad s$^{-1}$)")
        rate.set_xlabel(f"time ({unit_text(str(tr['time'].attrs.get('units', 's')))})")
        rate.set_xlim(time[0], time[-1])
        magnitude = np.abs(np.concatenate([tr[name].values for name in RATES]))
        usual = float(np.nanquantile(magnitude, 0.9))
        if np.nanmax(magnitude) > 10 * usual > 0:
            rate.set_ylim(-3 * usual, 3 * usual)
        for ax in (turn, rate):
            ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.6)
        left.align_ylabels()
        names = FRAME_AXES[system_of(tr).frame]
        _sphere(right.subplots(), np.stack([tr[f"axis_{n}"].values for n in "xyz"], -1), names)
    return figure


def _around(angle: np.ndarray) -> np.ndarray:
    """Angle between -pi and pi, with nan where it jumps so that no line is drawn there."""
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    wrapped[1:][np.abs(np.diff(wrapped)) > np.pi] = np.nan
    return wrapped


def _sphere(ax: Axes, path: np.ndarray, names: Iterable[str]) -> None:
    """Orthographic picture of a path on the unit sphere, shape (times, 3), seen from above the x-y plane."""
    turn, lift = np.radians(40.0), np.radians(25.0)
    toward = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.cross(toward, right)

    def draw(points: np.ndarray, colour: str, thickness: float, order: int) -> None:
        for near, shade, level in ((False, 0.35, order), (True, 1.0, order + 1)):
            hidden = (points @ toward >= 0) != near
            flat = np.stack([points @ right, points @ up], -1)
            flat[hidden] = np.nan
            ax.plot(flat[:, 0], flat[:, 1], color=colour, alpha=shade, linewidth=thickness, zorder=level)

    around = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], -1)
    ax.plot(circle[:, 0], circle[:, 1], color="0.3", linewidth=0.8)
    for latitude in np.radians((-60, -30, 0, 30, 60)):
        draw(circle * np.cos(latitude) + [0, 0, np.sin(latitude)], "0.7", 0.6 if latitude == 0 else 0.3, 1)
    for direction, name in zip(np.eye(3), names, strict=True):
        tip = np.array([direction @ right, direction @ up])
        ax.plot(*np.transpose([tip, 1.2 * tip]), color="0.3", linewidth=0.8, zorder=2)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8}
        ax.text(1.35 * tip[0], 1.35 * tip[1], name, ha="center", va="center", zorder=5, bbox=box)
    draw(path, COLOURS["regular_precession"], 1.1, 3)
    ax.plot(path[0] @ right, path[0] @ up, "o", color=COLOURS["drifting"], markersize=3.5, zorder=6)
    ax.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.15, 1.35))
    ax.set_axis_off()


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG (600 dpi), PDF or SVG by the suffix of its name, and move it into place.

    Raises BadInput for another suffix and for a place that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise BadInput(f"{path}: a figure's name ends in {', '.join(FORMATS)}")
    check_folder(path)
    kind = path.suffix.lower()[1:]
    # no date, so that the same atlas gives the same file
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with rc_context(STYLE):
            figure.savefig(temporary, format=kind, metadata=undated)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
