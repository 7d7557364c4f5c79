"""Values of an atlas along its axes: cells over two, a strip or a line over one."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ..analysis.metadata import flag_names
from ..analysis.select import cell_edges
from .scales import ColorScale
from .style import COLOURS


def edges_of(array: xr.DataArray, dims: list[str], log: list[bool]) -> list[np.ndarray]:
    """Edges of the cells along x and y; a strip has the y edges 0 and 1."""
    edges = [cell_edges(array[dim].values, is_log) for dim, is_log in zip(dims, log, strict=True)]
    return edges if len(edges) == 2 else [edges[0], np.array([0.0, 1.0])]


def draw_values(
    ax: Axes, array: xr.DataArray, edges: list[np.ndarray], scale: ColorScale, label: str
) -> ScalarMappable | None:
    """Draw the cells of an array, or its line if it has one axis and no flags; returns the cells."""
    ax.set_xlim(edges[0][0], edges[0][-1])
    if array.ndim == 1 and not flag_names(array):
        _draw_line(ax, array, scale, label)
        return None
    if array.ndim == 1:
        ax.set_yticks([])
    values = scale.shown(np.atleast_2d(array.values))
    image = ax.pcolormesh(*edges, values, cmap=scale.colormap, norm=scale.norm, rasterized=True)
    ax.set_ylim(edges[1][0], edges[1][-1])
    return image


def _draw_line(ax: Axes, array: xr.DataArray, scale: ColorScale, label: str) -> None:
    """Draw a variable over one axis."""
    values = array.values
    if scale.log_range is not None:
        low, high = scale.log_range
        ax.set_yscale("log")
        ax.set_ylim(0.5 * low, 2 * high)
        values = np.where(values > 0, values, np.nan)
    ax.plot(array[array.dims[0]].values, values, color=COLOURS["regular_precession"])
    ax.set_ylabel(label)


def set_axis(ax: Axes, which: str, log: bool, *, inner: bool) -> None:
    """Scale and ticks of an axis, "x" or "y"; inner: no label near the ends, where a neighbour has its own."""
    axis = ax.xaxis if which == "x" else ax.yaxis
    if log:
        (ax.set_xscale if which == "x" else ax.set_yscale)("log")
        axis.set_major_locator(LogLocator(numticks=6))
        axis.set_minor_formatter(NullFormatter())
    else:
        axis.set_major_locator(
            MaxNLocator(4 if inner else 6, steps=[1, 2, 2.5, 5, 10], prune="both" if inner else None)
        )
    ax.tick_params(axis="x" if which == "x" else "y", direction="out", length=2.5)
