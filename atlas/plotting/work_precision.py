"""Figure of a work-precision study."""

from __future__ import annotations

import xarray as xr
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..validation.work_precision import nanmedian
from ..validation.work_precision_report import summary

COLOURS, MARKERS = ("#1b6ca8", "#e0892b", "#262626", "#8c4799"), "os^D"
# States with larger errors are unrelated to the motion; they are not drawn.
MAX_ERROR_DRAWN = 3.0


def figure(ds: xr.Dataset) -> Figure:
    """Median errors against time per point, by method: states (solid), rates or observables (dotted)."""
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
