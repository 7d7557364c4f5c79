"""Diagrams of branches of equilibria."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.interpolate import PchipInterpolator

from ...errors import BadInput, allowed_text, shown
from ...flags import BifurcationKind, StabilityKind
from ...plotting.maps import Entries, Sheet
from ...plotting.options import MapOptions, Width
from ...plotting.style import COLOURS, STYLE, SYMBOLS, axis_label, variable_label
from ...plotting.trajectory import Sphere

Style = dict[str, Any]
# Lines in the order in which they are drawn: colour, width, and whether they are dashed.
_LINES = {
    StabilityKind.UNSTABLE: (COLOURS["unstable"], 0.9, True),
    StabilityKind.UNKNOWN: ("0.6", 0.9, True),
    StabilityKind.MARGINAL: (COLOURS["marginal"], 0.7, False),
    StabilityKind.LINEARLY_STABLE: (COLOURS["linearly_stable"], 0.7, False),
    StabilityKind.GYROSCOPIC: ("#5aa7d0", 0.7, False),  # the colour of maps is too pale for a line
    StabilityKind.ENERGY_STABLE: (COLOURS["energy_stable"], 1.7, False),
}
LINES: dict[StabilityKind, Style] = {
    kind: {"color": colour, "linewidth": width, "linestyle": (0, (3.5, 1.6)) if dashed else "-"}
    for kind, (colour, width, dashed) in _LINES.items()
}
MARKERS: dict[BifurcationKind, Style] = {
    kind: {"marker": marker, "color": "black", "markerfacecolor": face, "linestyle": "", "markersize": 3.5}
    for kind, marker, face in zip(BifurcationKind, ("$?$", "o", "D", "x"), ("k", "k", "w", "k"), strict=True)
}

# Bifurcations at which a branch that ends there has a vertical tangent, and steps between neighbouring points of a branch.
TURNS, SUBDIVISION = (BifurcationKind.FOLD, BifurcationKind.PITCHFORK), 12


def diagram(
    ds: xr.Dataset,
    variable: str = "theta0",
    *,
    ax: Axes | None = None,
    title: str | None = None,
    legend: bool = True,
    width: Width = "column",
) -> Figure:
    """Bifurcation diagram of branches from `atlas.branches`: a variable over the parameter, or a vector on the sphere.

    Parameters
    ----------
    variable : str, optional
        A variable of the branches, such as theta0, potential or frequency_1. gamma and alpha are drawn on the unit sphere of
        the body: for permanent rotations over their rate gamma gives Staude's arcs.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into; default a figure of its own.
    title : str, optional
        Title of the figure.
    legend : bool, optional
        Draw the legend.
    width : {"column", "page"}, optional
        88 mm or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Lines are thick where the energy proves stability, thin where motions are stable without it, dashed where they are
        unstable; dots, diamonds and crosses are folds, pitchforks and exchanges. Between the values of the parameter lines are
        interpolated without corners, and are vertical at folds.
    """
    if not {"fold_kind", "stability_kind"} <= set(ds) or "branch" not in ds.dims:
        raise BadInput("diagram: this dataset has no branches; atlas.branches makes one")
    (along,) = map(str, ds["completeness"].dims)
    allowed = [str(name) for name in ds if f"fold_{name}" in ds or ds[name].dtype == float]
    allowed = [name for name in allowed if ds[name].dims[:2] == ("branch", along) and name != "axis"]
    if variable not in allowed:
        raise BadInput(f"diagram: {shown(variable)}: {allowed_text(variable, allowed)}")
    chosen, on_sphere = MapOptions(ax=ax, title=title, legend=legend, width=width), ds[variable].ndim == 3
    lines, kinds = branch_lines(ds, variable, along), ds["fold_kind"].values
    entries: Entries = {
        kind.name.lower().replace("_", " "): Line2D([], [], **style)
        for styles, present in ((reversed(LINES.items()), lines), (MARKERS.items(), kinds))
        for kind, style in styles if kind in present
    }  # fmt: skip
    with rc_context(STYLE) if chosen.ax is None else nullcontext():
        sheet = Sheet(chosen, panel_height=(0.85 if on_sphere else 0.62) * chosen.size_mm[0])
        figure, (ax,) = sheet.figure(entries, [])
        points = ds.get(f"fold_{variable}", ds[f"fold_{along}"] * np.nan).values
        if on_sphere:
            sphere = Sphere(ax, ["$e_1$", "$e_2$", "$e_3$"])
            visible = points @ sphere.toward_viewer >= 0
            points, kinds = sphere.project(points[visible]), kinds[visible]
        else:
            points = np.stack([ds[f"fold_{along}"].values, points], -1)
            symbol = SYMBOLS.get(variable.removesuffix("0"))
            label = f"{symbol} (rad)" if symbol else variable_label(ds[variable])
            sheet.label_axes([ax], [[axis_label(ds, along), label]], entries)
            ax.set_xlim(ds[along].values.min(), ds[along].values.max())
        for kind, style in LINES.items():
            for line in lines.get(kind, []):
                sphere.draw(line, 3, **style) if on_sphere else ax.plot(*line.T, **style)
        for what, marker in MARKERS.items():
            ax.plot(*points[kinds == what].T, zorder=7, **marker)
    return figure


def branch_lines(ds: xr.Dataset, variable: str, along: str) -> dict[int, list[np.ndarray]]:
    """Smooth lines by stability: parameter and variable, or vectors, of each branch between bifurcations and changes."""
    every, of_folds = ds[variable].values, ds.get(f"fold_{variable}")
    folds = np.full((ds.sizes["fold"], *every.shape[2:]), np.nan) if of_folds is None else of_folds.values
    lines: dict[int, list[np.ndarray]] = {}
    for branch, kind in enumerate(ds["stability_kind"].values):
        own = (ds["fold_branch"].values == branch).any(1)
        position = np.concatenate([ds[along].values, ds[f"fold_{along}"].values[own]])
        value = np.concatenate([every[branch], folds[own]])
        flag = np.concatenate([kind, np.full(own.sum(), -1)])
        turns = np.concatenate([0 * kind, np.isin(ds["fold_kind"].values[own], TURNS)]).astype(bool)
        order = np.argsort(position, kind="stable")
        order = order[np.isfinite(value[order]).reshape(order.size, -1).all(1)]
        position, value, flag = position[order], value[order], flag[order]
        if order.size < 2:
            continue
        segment = np.where(flag[:-1] >= 0, flag[:-1], flag[1:])
        if variable in ("psi0", "phi0"):  # no line is drawn across a jump
            segment[np.abs(np.diff(value)) > 0.9 * np.pi] = -1
        fine = smooth(position, value, turns[order[0]], turns[order[-1]])
        for part in np.split(np.arange(segment.size), np.flatnonzero(np.diff(segment)) + 1):
            if segment[part[0]] >= 0:
                line = fine[part[0] * SUBDIVISION : (part[-1] + 1) * SUBDIVISION + 1]
                lines.setdefault(int(segment[part[0]]), []).append(line)
    return lines


def smooth(position: np.ndarray, value: np.ndarray, turns_first: bool, turns_last: bool) -> np.ndarray:
    """Parameter and values, or unit vectors, of a branch with SUBDIVISION steps between its points and no corners.

    At an end where the branch turns back, values change as the square root of the distance: there they are interpolated over this.
    """
    nodes = np.arange(len(position))
    steps = np.linspace(0, nodes[-1], nodes[-1] * SUBDIVISION + 1)
    first, last = position[[0, -1]]
    match bool(turns_first), bool(turns_last):
        case True, True:
            place = np.arccos(np.clip(1 - 2 * (position - first) / (last - first), -1, 1))
            between = np.interp(steps, nodes, place)
            along = first + 0.5 * (last - first) * (1 - np.cos(between))
        case True, False:
            place = np.sqrt(position - first)
            between = np.interp(steps, nodes, place)
            along = first + between**2
        case False, True:
            place = -np.sqrt(last - position)
            between = np.interp(steps, nodes, place)
            along = last - between**2
        case _:
            place = position
            along = between = np.interp(steps, nodes, place)
    kept = np.unique(place, return_index=True)[1]
    fine = PchipInterpolator(place[kept], value[kept])(between)
    fine[::SUBDIVISION], along[::SUBDIVISION] = value, position
    return (
        np.stack([along, fine], -1) if fine.ndim == 1 else fine / np.linalg.norm(fine, axis=-1, keepdims=True)
    )
