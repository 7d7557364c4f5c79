"""Drawing of the values of an atlas. Over two axes, values are cells. Over one axis, numbers are a curve and flags are a step curve."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import (
    BoundaryNorm,
    Colormap,
    LinearSegmentedColormap,
    ListedColormap,
    LogNorm,
    Normalize,
)
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from .. import extension
from ..analysis.boundary import EXISTENCE, KINDS, LABEL, RESONANCES, STABILITY, ZERO_RATES
from ..analysis.degrees import DEGREE, RAD
from ..analysis.metadata import scene_of
from ..errors import BadInput, attribute_text
from ..flags import Regularity
from ..systems.base import Mask
from .content import NOT_YET, PROVED, SLOW, Panel
from .options import MapOptions
from .style import COLOURS


def draw_values(
    ax: Axes, array: xr.DataArray, edges: list[np.ndarray], scale: ColorScale
) -> ScalarMappable | None:
    """Draw an array over two axes as cells, and return the cells. Draw an array over one axis as a curve."""
    ax.set_xlim(edges[0][0], edges[0][-1])
    if array.ndim == 1:
        values = array.values
        if scale.log_range is not None:
            low, high = scale.log_range
            ax.set_yscale("log")
            ax.set_ylim(0.5 * low, 2 * high)
            values = np.where(values > 0, values, np.nan)
        ax.plot(array[array.dims[0]].values, values, color=COLOURS["regular_precession"])
        return None
    image = ax.pcolormesh(
        *edges, scale.as_drawn(array.values), cmap=scale.colormap, norm=scale.norm, rasterized=True
    )
    ax.set_ylim(edges[1][0], edges[1][-1])
    return image


def draw_levels(
    ax: Axes, array: xr.DataArray, texts: Sequence[str], colours: Sequence[str], levels: Sequence[int]
) -> None:
    """Draw flags over one axis as a step curve with a level for each flag, and a dot in the colour of the flag at each point."""
    x, heights = array[array.dims[0]].values, np.searchsorted(levels, array.values)
    ax.step(x, heights, where="mid", color="0.35", linewidth=0.6)
    ax.scatter(x, heights, c=np.array(colours)[array.values.astype(int)], s=9, marker="s", zorder=2.2)
    ax.set_yticks(range(len(levels)), np.array(texts)[levels])
    ax.set_ylim(-0.6, len(levels) - 0.4)
    ax.tick_params(axis="y", length=0)


# Areas in square points. All dots of a panel have the area PANEL_AREA together, about that of the panel. A dot has MIN_DOT to MAX_DOT.
PANEL_AREA, MIN_DOT, MAX_DOT = 6000.0, 0.5, 14.0


def draw_dots(
    ax: Axes, array: xr.DataArray, places: list[np.ndarray], scale: ColorScale, *, rare_on_top: bool
) -> ScalarMappable:
    """Draw the values of single points as dots, and return the dots."""
    values = array.values.astype(np.int8) if array.dtype == bool else array.values
    order = np.arange(values.size)
    if rare_on_top:
        order = np.argsort(-np.bincount(values, minlength=1)[values], kind="stable")
    area = float(np.clip(PANEL_AREA / max(values.size, 1), MIN_DOT, MAX_DOT))
    ax.margins(0.03)
    return ax.scatter(
        places[0][order], places[1][order], c=scale.as_drawn(values)[order], s=area, cmap=scale.colormap,
        norm=scale.norm, edgecolors="0.35", linewidths=0.25 if area > 2 else 0, rasterized=True,
        plotnonfinite=False,
    )  # fmt: skip


def set_axis(ax: Axes, which: str, log: bool, *, inner: bool) -> None:
    """Set the scale and the ticks of an axis, "x" or "y". At its ends, an `inner` axis leaves room for tick labels of neighbours."""
    axis = {"x": ax.xaxis, "y": ax.yaxis}[which]
    if log:
        ax.set(**{f"{which}scale": "log"})
        axis.set_major_locator(LogLocator(numticks=6))
        axis.set_minor_formatter(NullFormatter())
    else:
        axis.set_major_locator(
            MaxNLocator(4 if inner else 6, steps=[1, 2, 2.5, 5, 10], prune="both" if inner else None)
        )
    axis.set_tick_params(direction="out", length=2.5)


MAX_DECADES = 10  # largest number of decades of a logarithmic colour scale
MIN_LOG_RATIO = 100  # a colour scale is logarithmic if the ratio of the extremes exceeds this value
MAX_INTEGERS = 40  # each integer gets its own colour if the range of the values is at most this wide


@dataclass(frozen=True)
class ColorScale:
    """Colours of a variable."""

    colormap: Colormap
    norm: Normalize
    extend: str = "neither"  # ends of the colour bar that values exceed, "min", "max" or "both"
    log_range: tuple[float, float] | None = None  # lowest and highest value of a logarithmic scale
    integers: bool = False  # whether each integer has a colour of its own

    def as_drawn(self, values: np.ndarray) -> np.ndarray:
        """Return the values to draw. On a logarithmic scale, zero and negative values get the colour below the scale."""
        if self.log_range is None:
            return values
        return np.where(values <= 0, 0.5 * self.log_range[0], values)


def is_angle(array: xr.DataArray) -> bool:
    """Whether a variable is an angle, whose scale is always linear. Errors and variations of angles do not count."""
    is_small = re.search("error|drift|std|rms|roughness", str(array.name))
    return attribute_text(array.attrs, "units") in (RAD, DEGREE) and not is_small


def color_scale(
    values: np.ndarray,
    flags: Sequence[str] = (),
    options: MapOptions | None = None,
    *,
    name: str = "",
    angle: bool = False,
) -> ColorScale:
    """Return the colour scale of `values`, or of flags that have the colours `flags`. Options that do not suit `values` raise BadInput."""
    if flags:
        return ColorScale(ListedColormap(flags), BoundaryNorm(np.arange(len(flags) + 1) - 0.5, len(flags)))
    options = MapOptions() if options is None else options
    vmin, vmax, chosen = options.vmin, options.vmax, options.norm
    colormap = colormaps.get_cmap("viridis" if options.cmap is None else options.cmap)
    finite = values[np.isfinite(values)]
    if not finite.size:
        return ColorScale(colormap, Normalize(0, 1))
    low, high = float(finite.min()), float(finite.max())
    is_free = vmin is None and vmax is None and chosen is None
    if (
        is_free
        and high - low <= MAX_INTEGERS
        and (finite == np.rint(finite)).all()
        and (high > low or low != 0)
    ):
        edges = np.arange(low, high + 2) - 0.5
        shades = colormap(np.linspace(0, 1, max(len(edges) - 1, 2)))[: len(edges) - 1]
        return ColorScale(ListedColormap(shades), BoundaryNorm(edges, len(edges) - 1), integers=True)
    if low == high:
        low, high = low - 0.5, high + 0.5
    first, last = low if vmin is None else vmin, high if vmax is None else vmax
    if not first < last:
        option = "vmin" if vmax is None else "vmax"
        raise BadInput(f"{option}: beyond the values of {name}, which are from {low:g} to {high:g}")
    if isinstance(chosen, Normalize):
        norm = copy(chosen)
        norm.autoscale_None(finite)
        return ColorScale(colormap, norm, _extend(finite, norm))
    if chosen is None and first < 0 < last and (vmin is None or vmax is None):
        # Cividis is blue below the middle, grey there and yellow above, so that luminance shows the sign.
        bound = next((abs(end) for end in (vmin, vmax) if end is not None), max(-low, high))
        signed = colormaps["cividis"] if options.cmap is None else colormap
        norm = Normalize(-bound, bound)
        return ColorScale(signed, norm, _extend(finite, norm))
    positive = finite[finite > 0]
    floor = float(positive.min()) if vmin is None and positive.size else first
    is_wide = chosen is None and not angle and 0 < MIN_LOG_RATIO * floor < last
    if chosen == "log" or is_wide:
        if not 0 < floor < last:
            raise BadInput(f"norm = 'log': {name} from {first:g} to {last:g} is not above 0")
        return _log_scale(colormap, finite, floor if vmin else max(floor, last * 10.0**-MAX_DECADES), last)
    named: Any = ScalarMappable(norm=chosen).norm  # type: ignore[arg-type]
    named.vmin, named.vmax = first, last
    return ColorScale(colormap, named, _extend(finite, named))


def _extend(values: np.ndarray, norm: Normalize) -> str:
    """Return the ends of a colour bar that values exceed. See `ColorScale.extend`."""
    below, above = values.min() < norm.vmin, values.max() > norm.vmax
    return {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")


def _log_scale(colormap: Colormap, values: np.ndarray, low: float, high: float) -> ColorScale:
    """Return a logarithmic scale between two positive numbers."""
    norm = LogNorm(low, high)
    return ColorScale(colormap, norm, _extend(values, norm), (low, high))


def add_color_bar(
    figure: Figure, axes: list[Axes], image: ScalarMappable, scale: ColorScale, label: str
) -> None:
    """Add a colour bar to the right of the panels."""
    bar = figure.colorbar(image, ax=axes, pad=0.02, extend=scale.extend, aspect=25)
    bar.set_label(label)
    if isinstance(scale.norm, BoundaryNorm):  # each integer has a colour
        low, high = scale.norm.boundaries[0] + 0.5, scale.norm.boundaries[-1] - 0.5
        ticks = MaxNLocator(10, integer=True, steps=[1, 2, 5, 10]).tick_values(low, high)
        bar.set_ticks([tick for tick in ticks if low <= tick <= high and tick == round(tick)])
        bar.minorticks_off()
    bar.ax.tick_params(length=2.5)
    bar.outline.set_linewidth(0.6)


# Colours from a weak orange to black. A darker colour means that neighbouring motions separate faster.
_COLOURS = LinearSegmentedColormap.from_list("exponents", ["#b86a1c", "#5e2205", "#160300"])
MAX_EXPONENT_DECADES = 3  # largest number of decades of the colour scale


def chaotic_exponents(ds: xr.Dataset, flags: xr.DataArray) -> np.ndarray | None:
    """Return Lyapunov exponents, nan at points that are not chaotic. Return None if the map is not of regularity or has no exponents."""
    if flags.name != "regularity" or "lyapunov" not in ds or {*ds["lyapunov"].dims} != {*flags.dims}:
        return None
    exponents = ds["lyapunov"].transpose(*flags.dims).values
    return np.where(flags.values == Regularity.CHAOTIC, exponents, np.nan)


def exponent_scale(exponents: Iterable[np.ndarray | None]) -> ColorScale | None:
    """Return the colour scale of the exponents of chaotic points, or None if there are no exponents."""
    values = np.concatenate([np.empty(0), *(each.ravel() for each in exponents if each is not None)])
    values = values[values > 0]
    if not values.size or values.max() == values.min():
        return None
    high = float(values.max())
    return _log_scale(_COLOURS, values, max(float(values.min()), high * 10.0**-MAX_EXPONENT_DECADES), high)


def regularity_texts(ds: xr.Dataset) -> Mapping[str, str]:
    """Return legend texts for flags of regularity. "regular" and "chaotic" state the length of the runs of a scene."""
    texts = {"hyperbolic": "hyperbolic (unstable)"}
    if (scene := scene_of(ds)) is not None:
        texts |= {name: f"{name} up to {scene.duration}" for name in ("regular", "chaotic")}
    return texts


_RESONANCE_COLOURS = dict(zip(RESONANCES, ("#d62728", "#2ca02c", "#9467bd"), strict=True))
# Kind of border -> line style.
BORDERS: dict[str, dict[str, Any]] = {
    STABILITY: {"linestyle": "-", "linewidth": 1.0},
    LABEL: {"linestyle": (0, (5, 1.5)), "linewidth": 1.0},
    EXISTENCE: {"linestyle": "-", "linewidth": 0.6},
    PROVED: {"linestyle": "-", "linewidth": 1.0, "color": "#7b2cbf"},
    **{kind: {"linestyle": (0, (1.5, 1.2)), "linewidth": 1.0} for kind in ZERO_RATES.values()},
    **{
        kind: {"linestyle": "-", "linewidth": 0.8, "color": colour}
        for kind, colour in _RESONANCE_COLOURS.items()
    },
}
PLAIN_LINE: dict[str, Any] = {"linestyle": "-", "linewidth": 0.6}
# Dashes of families by the number of the family in the system.
DASHES: tuple[Any, ...] = ((0, (8, 2)), ":", "-.", "--", (0, (6, 1, 1, 1, 1, 1)))
# Lines are thinner by the factor THINNER on panels narrower than NARROW (mm).
NARROW, THINNER = 90.0, 0.5
# A halo keeps lines visible on dark colours. It must not hide a strip of cells along the line.
HALO = 0.35  # width on each side of a line, in points
# More than MAX_HALOED lines of a kind in KINDS, or crowded lines, have no halo, because halos would cover the cells between the lines.
MAX_HALOED = 40


@dataclass(frozen=True)
class Hatch:
    """Hatching of a region."""

    pattern: str
    colour: str
    background: str


UNDECIDED = "undecided"
PLAIN = Hatch("", "0.4", "#ffffff")
HATCHES = {
    UNDECIDED: Hatch("\\\\\\\\\\\\", "0.9", "none"),
    SLOW: Hatch("//////", "#262626", "none"),
    NOT_YET: Hatch("xxxxx", "0.65", "0.92"),
}


def border_style(kind: str, width: float = math.inf) -> dict[str, Any]:
    """Return the line style of a kind of border on a panel of `width` mm. An extension may define the kind."""
    return at_width(
        {"color": "black"} | (extension.load("line_styles", kind) or BORDERS.get(kind, PLAIN_LINE)), width
    )


def family_style(number: int, width: float = math.inf) -> dict[str, Any]:
    """Return the line style of the family with this number in the system, on a panel of `width` mm."""
    return at_width({"color": "black", "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.0}, width)


def at_width(style: dict[str, Any], width: float) -> dict[str, Any]:
    """Return the line style with the linewidth for a panel of `width` mm."""
    return style | {"linewidth": style["linewidth"] * (THINNER if width < NARROW else 1.0)}


def draw_overlay(
    ax: Axes, panel: Panel, edges: list[np.ndarray], families: Sequence[str], width: float
) -> None:
    """Draw hatching and theory over the cells of a panel of `width` mm. The limits and scales of `ax` must be set before."""
    for what, mask in ((NOT_YET, panel.white.get(NOT_YET)), (SLOW, panel.slow)):
        if mask is not None and mask.any():
            draw_hatching(ax, mask, edges, HATCHES[what])
    for kind in (*(each for each in panel.borders if each not in KINDS), *list(KINDS)[::-1]):
        if lines := panel.borders.get(kind):
            is_dense = kind in KINDS and (len(lines) > MAX_HALOED or kind in panel.crowded)
            _draw_lines(ax, lines, border_style(kind, width), halo=0.0 if is_dense else HALO)
    for name, lines in panel.families.items():
        _draw_lines(ax, lines, family_style(families.index(name), width), halo=HALO)


def draw_hatching(ax: Axes, mask: Mask, edges: list[np.ndarray], hatch: Hatch) -> None:
    """Hatch the marked cells. Over one axis the cells reach from bottom to top.

    Marked neighbours along x form a rectangle. All rectangles are one path, because Matplotlib takes seconds to hatch many paths.
    """
    x, y = edges[0], edges[1] if mask.ndim == 2 else ax.get_ylim()
    mask = np.atleast_2d(mask)
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(steps == 1)
    stop = np.nonzero(steps == -1)[1]
    left, right, bottom, top = x[start], x[stop], np.asarray(y)[row], np.asarray(y)[row + 1]
    corners = np.stack([left, bottom, right, bottom, right, top, left, top, left, bottom], -1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], left.size)
    ax.add_collection(
        PathCollection(
            [Path(corners, codes)], facecolors=hatch.background, edgecolors=hatch.colour,
            hatch=hatch.pattern, linewidths=0, zorder=1.5, rasterized=True,
        ),
        autolim=False,
    )  # fmt: skip


def _draw_lines(ax: Axes, lines: list[np.ndarray], style: dict[str, Any], *, halo: float) -> None:
    """Draw lines over a white halo. The halo has no dashes, extends `halo` points to each side of a line, and lies below all lines.

    Lines over two axes are one path with gaps, because Matplotlib takes milliseconds for each path.
    """
    if not lines:
        return
    white = {"color": "white", "linestyle": "-", "linewidth": style["linewidth"] + 2 * halo}
    for level, each in [(2.0, style | white), (2.1, style)] if halo else [(2.1, style)]:
        if lines[0].shape[1] == 1:
            for line in lines:
                ax.axvline(float(line[0, 0]), zorder=level, **each)
        else:
            path = np.concatenate([part for line in lines for part in (line, [[np.nan, np.nan]])])
            ax.plot(*path.T, zorder=level, scalex=False, scaley=False, **each)
