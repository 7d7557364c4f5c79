"""Diagrams of branches of equilibria."""

from __future__ import annotations

from contextlib import nullcontext
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from scipy.interpolate import PchipInterpolator

from ...analysis.degrees import factor, in_degrees
from ...errors import BadInput, allowed_text, shown
from ...flags import BifurcationKind, StabilityKind
from ...plotting.maps import Entries, Sheet
from ...plotting.options import MapOptions, Width
from ...plotting.style import COLOURS, STYLE, SYMBOLS, axis_label, variable_label
from ...plotting.trajectory import Sphere

Style = dict[str, Any]
# Lines in the order in which they are drawn, with colour, width and whether they are dashed.
_LINES = {
    StabilityKind.UNSTABLE: (COLOURS["unstable"], 0.9, True),
    StabilityKind.UNKNOWN: ("0.6", 0.9, True),
    StabilityKind.MARGINAL: (COLOURS["marginal"], 0.7, False),
    StabilityKind.LINEARLY_STABLE: (COLOURS["linearly_stable"], 0.7, False),
    StabilityKind.GYROSCOPIC: ("#5aa7d0", 0.7, False),  # the colour on maps is too pale for a line
    StabilityKind.ENERGY_STABLE_AXIAL: (COLOURS["energy_stable_axial"], 1.2, False),
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

# Texts and line styles of borders by kind, or by MINIMUM where a minimum ends. Texts and markers of special points by kind.
MINIMUM = 0
BORDER_TEXTS = {
    MINIMUM: "a minimum ends",
    1: "fold",
    2: "pitchfork",
    3: "limit of stability",
    4: "extremal momentum",
}
BORDERS: dict[int, Style] = {
    MINIMUM: {"color": COLOURS["energy_stable"], "linewidth": 1.4},
    1: {"color": "black", "linewidth": 0.7}, 3: {"color": COLOURS["linearly_stable"], "linewidth": 0.9},
    4: {"color": COLOURS["linearly_stable"], "linewidth": 0.9, "linestyle": (0, (1, 1.2))}, 2: {"color": "black", "linewidth": 0.7, "linestyle": (0, (3.5, 1.6))},
}  # fmt: skip
SPECIAL: dict[int, tuple[str, Style]] = {
    i: (text, MARKERS[kind] | {"markersize": 2.5}) for i, (text, kind) in enumerate(
        (("cusp", BifurcationKind.FOLD), ("meeting of borders", BifurcationKind.PITCHFORK), ("exponents meet at 0", BifurcationKind.EXCHANGE)), 1
    )
}  # fmt: skip

# A branch ends with a vertical tangent at TURNS. SUBDIVISION steps are drawn between neighbouring points of a branch.
TURNS, SUBDIVISION = (BifurcationKind.FOLD, BifurcationKind.PITCHFORK), 12


def diagram(
    ds: xr.Dataset,
    variable: str = "theta0",
    *,
    ax: Axes | None = None,
    title: str | None = None,
    legend: bool = True,
    width: Width = "column",
    degrees: bool = False,
) -> Figure:
    """Bifurcation diagram of branches from `atlas.branches`, or the curves of `atlas.borders` over their two parameters.

    Parameters
    ----------
    variable : str, optional
        A variable of the branches, such as theta0, potential or frequency_1. gamma and alpha are drawn on the unit sphere of
        the body. For permanent rotations, gamma over the rate gives Staude's arcs. Borders ignore this option.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into. By default a new figure is made.
    title : str, optional
        Title of the figure.
    legend : bool, optional
        Draw the legend.
    width : {"column", "page"}, optional
        88 mm or 180 mm.
    degrees : bool, optional
        Show angles in degrees.

    Returns
    -------
    matplotlib.figure.Figure
        Lines are thick where the energy proves stability, thin where motions are stable without such a proof, and dashed where
        motions are unstable. Dots are folds, diamonds are pitchforks and crosses are exchanges. Lines are interpolated without
        corners between the values of the parameter, and are vertical at folds. Borders are thick where a minimum ends,
        dashed at pitchforks and dotted at extrema of the momentum. Dots are cusps, and diamonds are meetings with pitchforks.
    """
    chosen = MapOptions(ax=ax, title=title, legend=legend, width=width, degrees=degrees)
    if "count_change" in ds:
        return border_diagram(ds, chosen)
    if not {"fold_kind", "stability_kind"} <= set(ds) or "branch" not in ds.dims:
        raise BadInput("diagram: this dataset has no branches; atlas.branches makes one")
    (along,) = map(str, ds["completeness"].dims)
    allowed = [str(name) for name in ds if f"fold_{name}" in ds or ds[name].dtype == float]
    allowed = [name for name in allowed if ds[name].dims[:2] == ("branch", along) and name != "axis"]
    if variable not in allowed:
        raise BadInput(f"diagram: {shown(variable)}: {allowed_text(variable, allowed)}")
    on_sphere = ds[variable].ndim == 3
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
            scale = [1.0, factor(ds[variable].attrs, degrees)]
            lines = {kind: [line * scale for line in group] for kind, group in lines.items()}
            points = np.stack([ds[f"fold_{along}"].values, points], -1) * scale
            symbol = SYMBOLS.get(variable.removesuffix("0"))
            label = variable_label(in_degrees(ds[variable], degrees))
            label = label.replace(variable, symbol) if symbol else label
            sheet.label_axes([ax], [[axis_label(ds, along), label]], entries)
            ax.set_xlim(ds[along].values.min(), ds[along].values.max())
        for kind, style in LINES.items():
            for line in lines.get(kind, []):
                sphere.draw(line, 3, **style) if on_sphere else ax.plot(*line.T, **style)
        for what, marker in MARKERS.items():
            ax.plot(*points[kinds == what].T, zorder=7, **marker)
    return figure


def border_diagram(ds: xr.Dataset, chosen: MapOptions) -> Figure:
    """Draw the curves of `atlas.borders` as cubics through the vertices."""
    names = [str(dim).removeprefix("cell_") for dim in ds["cells"].dims]
    at, slope = (np.stack([ds[head + name].values for name in names], -1) for head in ("", "tangent_"))
    third = np.diff(ds["arc"].values)[:, None] / 3
    knots = np.stack([at[:-1] + third * slope[:-1], at[1:] - third * slope[1:], at[1:]], 1)
    minimum = (ds["index_below"].values == 0) & (ds["index_above"].values == 1)
    style = np.where(minimum, MINIMUM, ds["kind"].values)
    same = np.diff(ds["curve"].values) == 0
    cuts = np.flatnonzero(np.r_[True, ~same, True] | np.r_[True, np.diff(style) != 0, True])
    lines: dict[int, list[Path]] = {}
    # A line joins successive vertices of one style on one curve, and the first vertex of the next style on this curve, if any.
    for start, end in pairwise(cuts.tolist()):
        end -= end == len(style) or not same[end - 1]
        if end > start:
            points = np.concatenate([at[start : start + 1], knots[start:end].reshape(-1, 2)])
            path = Path(points, [Path.MOVETO] + [Path.CURVE4] * (len(points) - 1))
            lines.setdefault(int(style[start]), []).append(path)
    special = ds["special_kind"].values
    entries: Entries = {
        text: Line2D([], [], **BORDERS[kind]) for kind, text in BORDER_TEXTS.items() if kind in lines
    }
    entries |= {text: Line2D([], [], **marker) for kind, (text, marker) in SPECIAL.items() if kind in special}
    with rc_context(STYLE) if chosen.ax is None else nullcontext():
        sheet = Sheet(chosen, panel_height=0.85 * chosen.size_mm[0])
        figure, (ax,) = sheet.figure(entries, [])
        sheet.label_axes([ax], [[axis_label(ds, name) for name in names]], entries)
        for kind, paths in lines.items():
            for path in paths:
                ax.add_patch(PathPatch(path, fill=False, **BORDERS[kind]))
        for kind, (_, marker) in SPECIAL.items():
            ax.plot(*(ds[f"special_{name}"].values[special == kind] for name in names), **marker)
        ax.autoscale_view()
    return figure


def branch_lines(ds: xr.Dataset, variable: str, along: str) -> dict[int, list[np.ndarray]]:
    """Return smooth lines for each stability flag, with points (parameter, value) or unit vectors. Lines end where the flag changes."""
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
        if variable in ("psi0", "phi0"):  # no line is drawn across a jump of the angle
            segment[np.abs(np.diff(value)) > 0.9 * np.pi] = -1
        fine = smooth(position, value, turns[order[0]], turns[order[-1]])
        for part in np.split(np.arange(segment.size), np.flatnonzero(np.diff(segment)) + 1):
            if segment[part[0]] >= 0:
                line = fine[part[0] * SUBDIVISION : (part[-1] + 1) * SUBDIVISION + 1]
                lines.setdefault(int(segment[part[0]]), []).append(line)
    return lines


def smooth(position: np.ndarray, value: np.ndarray, turns_first: bool, turns_last: bool) -> np.ndarray:
    """Return points (parameter, value), or unit vectors, along a smooth branch, with SUBDIVISION steps between the given points.

    At an end where a branch turns back, values are interpolated in the square root of the distance from the end.
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
