"""Figure of a stress study."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..engine.tableaux import METHODS
from ..validation.stress import ACCURATE, LEVELS, RATIOS, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {
    Verdict.RIGHT: "#59a14f",
    Verdict.UNRESOLVED: "#e6e6e6",
    Verdict.WRONG: "#d62728",
    Verdict.LEFT_OUT: "#ffffff",
}


def figure(ds: xr.Dataset) -> Figure:
    """Verdict on every point at every level, a panel for each method; a dot where the rates are accurate, too.

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
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(7.0, 8.2), layout="constrained")
        axes = drawn.subplots(1, len(METHODS), sharey=True)
        for i, (ax, method) in enumerate(zip(axes, ds["method"].values, strict=True)):
            verdict, error = ds["verdict"].values[i].T, ds["error"].values[i].T
            colours = ListedColormap([COLOURS[flag] for flag in Verdict])
            ax.pcolormesh(verdict, cmap=colours, vmin=-0.5, vmax=len(Verdict) - 0.5)
            points, levels = np.nonzero((verdict == Verdict.RIGHT) & (error < ACCURATE))
            ax.plot(levels + 0.5, points + 0.5, ".", color="black", markersize=1.5)
            ax.hlines(first, 0, len(LEVELS), color="0.5", linewidth=0.4)
            ax.axvline(len(RATIOS), color="black", linewidth=0.8)
            ax.set_xticks(np.arange(len(LEVELS)) + 0.5, [level.split()[1] for level in LEVELS], rotation=90)
            ax.set(title=method, xlabel="step over stability limit | tolerance of automatic step")
        axes[0].set_yticks(np.r_[first[1:], cases.size] * 0.5 + first * 0.5, cases[first])
        axes[0].set_ylim(cases.size, 0)
        entries = [
            Patch(
                facecolor=COLOURS[flag], edgecolor="0.5", label=f"{name.replace('_', ' ')}: {flag.sentence}"
            )
            for flag, name in zip(Verdict, Verdict.meanings(), strict=True)
        ]
        drawn.legend(handles=entries, loc="outside lower center", ncols=2, frameon=False)
    return drawn
