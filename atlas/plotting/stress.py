"""Figure of a stress study."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..engine.tableaux import METHODS
from ..validation.stress import ACCURATE, LEVELS, RATIOS, Verdict, beyond_estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {
    Verdict.RIGHT: "#59a14f",
    Verdict.UNRESOLVED: "#e6e6e6",
    Verdict.WRONG: "#d62728",
    Verdict.LEFT_OUT: "#ffffff",
}

# Least height of a case in the figure, in points of the study.
LEAST_HEIGHT = 4


def figure(ds: xr.Dataset) -> Figure:
    """Verdict on every point at every level, a panel for each method.

    A dot where the rates are accurate, too; a red one where a statistic is off by more than ten times its estimate.

    Parameters
    ----------
    ds : xarray.Dataset
        As `validation.stress.stress` returns it.
    """
    from matplotlib import rc_context
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    cases = ds["case"].values
    first = np.flatnonzero(np.r_[True, cases[1:] != cases[:-1]])  # point of each case
    # A case has at least the height of its name.
    size = np.diff(np.r_[first, cases.size])
    edges = np.r_[0.0, np.cumsum(np.repeat(np.maximum(size, LEAST_HEIGHT) / size, size))]
    middle, beyond = 0.5 * (edges[:-1] + edges[1:]), beyond_estimate(ds)
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(7.0, 1.5 + edges[-1] / 26), layout="constrained")
        axes = drawn.subplots(1, len(METHODS), sharey=True)
        for i, (ax, method) in enumerate(zip(axes, ds["method"].values, strict=True)):
            verdict, error = ds["verdict"].values[i].T, ds["error"].values[i].T
            colours = ListedColormap([COLOURS[flag] for flag in Verdict])
            columns = np.arange(len(LEVELS) + 1)
            ax.pcolormesh(columns, edges, verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5)
            points, levels = np.nonzero((verdict == Verdict.RIGHT) & (error < ACCURATE))
            ax.plot(levels + 0.5, middle[points], ".", color="black", markersize=1.5)
            points, levels = np.nonzero(beyond[i].T)
            ax.plot(levels + 0.5, middle[points], ".", color=COLOURS[Verdict.WRONG], markersize=2.5)
            ax.hlines(edges[first], 0, len(LEVELS), color="0.5", linewidth=0.4)
            ax.axvline(len(RATIOS), color="black", linewidth=0.8)
            ax.set_xticks(np.arange(len(LEVELS)) + 0.5, [level.split()[1] for level in LEVELS], rotation=90)
            ax.set(title=method, xlabel="step over limit of stability | tolerance")
        axes[0].set_yticks(0.5 * (edges[first] + edges[first + size]), cases[first])
        axes[0].set_ylim(edges[-1], 0)
        entries = [
            Patch(
                facecolor=COLOURS[flag], edgecolor="0.5", label=f"{name.replace('_', ' ')}: {flag.sentence}"
            )
            for flag, name in zip(Verdict, Verdict.meanings(), strict=True)
        ]
        drawn.legend(handles=entries, loc="outside lower center", ncols=2, frameon=False)
    return drawn
