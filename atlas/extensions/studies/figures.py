"""Figures of stress studies and of work-precision studies."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ...kernel.tableaux import METHODS
from ...plotting.options import WIDTHS
from ...plotting.style import STYLE
from .stress import ACCURATE, LEVELS, RATIOS, Verdict, beyond_estimate
from .work_precision import nanmedian, summary

# The colours differ in luminance as well, for colour-blind readers and prints in grey.
VERDICT_COLOURS = {
    Verdict.RIGHT: "#7ab8e0",
    Verdict.UNRESOLVED: "#e9e9e9",
    Verdict.WRONG: "#d55e00",
    Verdict.LEFT_OUT: "#ffffff",
}
HATCHES = {Verdict.LEFT_OUT: "////"}
ACCURATE_DOT: dict[str, Any] = {"marker": ".", "color": "black", "markersize": 2.0, "linestyle": ""}
BEYOND_CROSS: dict[str, Any] = {
    "marker": "x",
    "color": "#d55e00",
    "markersize": 5.0,
    "markeredgewidth": 1.3,
    "linestyle": "",
}

MIN_HEIGHT = 5  # a case with fewer points is drawn as high as a case with MIN_HEIGHT points


def stress_figure(ds: xr.Dataset) -> Figure:
    """Draw the verdict on every point at every level. Each method has two panels, with fixed steps and with automatic steps.

    A dot marks accurate rates. A cross marks a statistic whose error exceeds ten times `error_estimate`.
    """
    cases = ds["case"].values
    first = np.flatnonzero(np.r_[True, cases[1:] != cases[:-1]])  # first point of each case
    size = np.diff(np.r_[first, cases.size])
    edges = np.r_[0.0, np.cumsum(np.repeat(np.maximum(size, MIN_HEIGHT) / size, size))]
    columns = {
        "fixed step over\nlimit of stability": slice(0, len(RATIOS)),
        "tolerance,\nautomatic step": slice(len(RATIOS), len(LEVELS)),
    }
    with rc_context(STYLE | {"hatch.linewidth": 0.3}):
        fig = Figure(figsize=(WIDTHS["page"] / 25.4, 1.5 + edges[-1] / 28), layout="constrained")
        widths = [levels.stop - levels.start for levels in columns.values()] * len(METHODS)
        axes = fig.subplots(1, 2 * len(METHODS), sharey=True, width_ratios=widths)
        beyond = beyond_estimate(ds)
        for i, method in enumerate(ds["method"].values):
            for ax, (name, levels) in zip(axes[2 * i : 2 * i + 2], columns.items(), strict=True):
                _draw_panel(ax, ds.isel(method=i, level=levels), beyond[i, levels], edges)
                ax.hlines(edges[first], *ax.get_xlim(), color="0.5", linewidth=0.4)
                ticks = [level.split()[1] for level in LEVELS[levels]]
                ax.set_xticks(np.arange(len(ticks)) + 0.5, ticks, rotation=90)
                ax.set_xlabel(name)
                ax.tick_params(length=2.0)
            axes[2 * i].set_title(method, loc="left")
        axes[0].set_yticks(0.5 * (edges[first] + edges[first + size]), cases[first])
        axes[0].set_ylim(edges[-1], 0)
        patches = [
            Patch(
                facecolor=VERDICT_COLOURS[flag], edgecolor="0.5", linewidth=0.4, hatch=HATCHES.get(flag),
                label=f"{name.replace('_', ' ')}: {flag.sentence}",
            )
            for flag, name in zip(Verdict, Verdict.meanings(), strict=True)
        ]  # fmt: skip
        measured = ds["error"].attrs["long_name"].removeprefix("relative error of the ")
        marks = [
            Line2D([], [], label=f"{measured} within {100 * ACCURATE:g} %, too", **ACCURATE_DOT),
            Line2D([], [], label="a statistic off by more than ten times error_estimate", **BEYOND_CROSS),
        ]
        fig.legend(handles=[*patches, *marks], loc="outside lower center", ncols=2, frameon=False)
    return fig


def _draw_panel(ax: Axes, ds: xr.Dataset, beyond: np.ndarray, edges: np.ndarray) -> None:
    """Draw the verdicts and marks of one method at some levels. `edges` are the edges of the points' cells along the y axis."""
    verdict, error = ds["verdict"].values.T, ds["error"].values.T
    colours = ListedColormap([VERDICT_COLOURS[flag] for flag in Verdict])
    columns = np.arange(verdict.shape[1] + 1)
    ax.pcolormesh(columns, edges, verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5, rasterized=True)
    for flag, hatch in HATCHES.items():
        for point, level in np.argwhere(verdict == flag):
            corner, height = (level, edges[point]), edges[point + 1] - edges[point]
            ax.add_patch(Rectangle(corner, 1, height, fill=False, hatch=hatch, edgecolor="0.5", linewidth=0))
    middle = 0.5 * (edges[:-1] + edges[1:])
    for mask, mark in (
        ((verdict == Verdict.RIGHT) & (error < ACCURATE), ACCURATE_DOT),
        (beyond.T, BEYOND_CROSS),
    ):
        points, levels = np.nonzero(mask)
        ax.plot(levels + 0.5, middle[points], **mark)
    ax.set_xlim(0, verdict.shape[1])


COLOURS, MARKERS = ("#1b6ca8", "#e0892b", "#262626", "#8c4799"), "os^D"
MAX_ERROR_DRAWN = 3.0  # States with larger errors are unrelated to the motion.


def work_precision_figure(ds: xr.Dataset) -> Figure:
    """Draw median errors against time per point by method, with solid lines for states, and dotted lines for rates or observables."""
    rows = summary(ds)
    with rc_context({"font.size": 8, "legend.fontsize": 7, "axes.linewidth": 0.6}):
        fig = Figure(figsize=(3.5, 2.8), layout="constrained")
        ax = fig.add_subplot()
        for method, colour, marker in zip(ds["method"].values, COLOURS, MARKERS, strict=False):
            usable = [r for r in rows if r["method"] == method and r["error_state"] < MAX_ERROR_DRAWN]
            usable = usable or rows[-1:]
            time = [1e6 * r["seconds_per_point"] for r in usable]
            states, rates = [r["error_state"] for r in usable], [r["error_rates"] for r in usable]
            ax.plot(time, states, marker + "-", color=colour, markersize=3, label=f"{method}, final state")
            ax.plot(time, rates, ":", color=colour, label=f"{method}, {ds.attrs['measured']}")
        for row in rows:
            if row["own_setting"] and row["error_state"] < MAX_ERROR_DRAWN:
                point = 1e6 * row["seconds_per_point"], row["error_state"]
                ax.plot(*point, "o", mfc="none", mec="black", ms=8, label="the scene's setting")
        ax.set(xscale="log", yscale="log", xlabel="time per point and processor (µs)", ylabel="median error")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        uncertainty = nanmedian(ds["reference_error"].values)
        bottom = min(ax.get_ylim()[0], uncertainty / 2)
        ax.set_ylim(bottom=bottom)
        ax.axhspan(bottom, uncertainty, color="0.9", zorder=0, label="uncertainty of reference")
        fig.legend(loc="outside lower center", ncols=2, frameon=False)
    return fig
