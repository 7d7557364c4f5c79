"""Work-precision figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..validation.work_precision import median_of, summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS, MARKS = ("#1b6ca8", "#e0892b", "#262626", "#59a14f"), "os^D"


def figure(ds: xr.Dataset) -> Figure:
    """Work-precision figure: median errors against time per point, a line and a dotted one per method."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    rows = summary(ds)
    with rc_context({"font.size": 8, "legend.fontsize": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(3.5, 2.8), layout="constrained")
        ax = drawn.add_subplot()
        for method, colour, mark in zip(ds["method"].values, COLOURS, MARKS, strict=False):
            # A run that is nowhere near the motion has no error worth drawing.
            sane = [r for r in rows if r["method"] == method and r["error_state"] < 3.0] or rows[-1:]
            line = [(1e6 * r["seconds_per_point"], r["error_state"]) for r in sane]
            ax.plot(
                *np.transpose(line), mark + "-", color=colour, markersize=3, label=f"{method}, final state"
            )
            line = [(1e6 * r["seconds_per_point"], r["error_rates"]) for r in sane]
            ax.plot(*np.transpose(line), ":", color=colour, label=f"{method}, means and spreads")
        for row in rows:
            if row["own_setting"] and row["error_state"] < 3.0:
                place = 1e6 * row["seconds_per_point"], row["error_state"]
                ax.plot(*place, "o", mfc="none", mec="black", ms=8, label="the scene's setting")
        ax.set(xscale="log", yscale="log")
        ax.set(xlabel="time per point and processor (µs)", ylabel="median error")
        known = median_of(ds["reference_error"].values)
        floor = min(ax.get_ylim()[0], known / 2)
        ax.set_ylim(bottom=floor)
        ax.axhspan(floor, known, color="0.9", zorder=0, label="reference unsure of states")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.tick_params(axis="x", labelrotation=0)
        drawn.legend(loc="outside lower center", ncols=2, frameon=False)
    return drawn
