"""Figure of the stress cases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..engine.tableaux import METHODS
from ..validation.stress import ACCURATE, LEVELS, RATIOS, RIGHT, VERDICTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(ds: xr.Dataset) -> Figure:
    """Verdict of every point at every rung, a panel for each method; a dot where the label is accurate, too."""
    from matplotlib import rc_context
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = ["#59a14f", "#e6e6e6", "#d62728", "#ffffff"]
    cases = ds["case"].values
    first = np.flatnonzero(np.r_[True, cases[1:] != cases[:-1]])
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(7.0, 8.2), layout="constrained")
        axes = drawn.subplots(1, len(METHODS), sharey=True)
        for i, (ax, method) in enumerate(zip(axes, ds["method"].values, strict=True)):
            verdict = ds["verdict"].values[i].T
            ax.pcolormesh(verdict, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(colours) - 0.5)
            close = (verdict == RIGHT) & (ds["error"].values[i].T < ACCURATE)
            rows, columns = np.nonzero(close)
            ax.plot(columns + 0.5, rows + 0.5, ".", color="black", markersize=1.5)
            ax.hlines(first, 0, len(LEVELS), color="0.5", linewidth=0.4)
            ax.axvline(len(RATIOS), color="black", linewidth=0.8)
            ax.set_xticks(np.arange(len(LEVELS)) + 0.5, [rung.split()[1] for rung in LEVELS], rotation=90)
            ax.set(title=method, xlabel="step over stability limit | tolerance of automatic step")
        axes[0].set_yticks(np.r_[first[1:], cases.size] * 0.5 + first * 0.5, cases[first])
        axes[0].set_ylim(cases.size, 0)
        entries = [
            Patch(facecolor=colour, edgecolor="0.5", label=f"{name.replace('_', ' ')}: {text}")
            for colour, (name, text) in zip(colours, VERDICTS.items(), strict=True)
        ]
        drawn.legend(handles=entries, loc="outside lower center", ncols=2, frameon=False)
    return drawn
