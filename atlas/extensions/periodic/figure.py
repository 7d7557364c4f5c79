"""Diagrams of families of periodic motions."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...analysis.metadata import flags_of
from ...errors import BadInput, allowed_text, shown
from ...flags import FamilyEnd, OrbitStability, PeriodicEvent
from ...plotting.maps import Entries, Sheet
from ...plotting.options import MapOptions, Width
from ...plotting.style import QUALITATIVE, STYLE

LABELS = {"period": "period", "amplitude": r"range of $\theta$ (rad)", "energy": "energy integral"}
MARKERS = {
    PeriodicEvent.FOLD: "o", PeriodicEvent.PERIOD_FOLD: "x", PeriodicEvent.DOUBLING: "^", PeriodicEvent.BRANCH: "D",
    PeriodicEvent.KREIN: "*",
}  # fmt: skip
DASHED, COLOURS = (0, (3.0, 1.4)), (QUALITATIVE[3], QUALITATIVE[2], QUALITATIVE[5], *QUALITATIVE[6:])


def periodic_diagram(
    ds: xr.Dataset,
    y: str = "period",
    *,
    ax: Axes | None = None,
    title: str | None = None,
    legend: bool = True,
    width: Width = "column",
) -> Figure:
    """Diagram of families from `atlas.periodic` over the arc length from their birth.

    Parameters
    ----------
    y : {"period", "amplitude", "energy"}, optional
        What is drawn; the amplitude is the range of theta.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into; default a figure of its own.
    title : str, optional
        Title of the figure.
    legend : bool, optional
        Draw the legend, with the frequency at the birth of each family and its end.
    width : {"column", "page"}, optional
        88 mm or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Lines are full where orbits are stable and dashed where they are unstable; markers are events.
    """
    if "orbit_stable" not in ds or ds["arc"].dims != ("family", "orbit"):
        raise BadInput(
            "periodic_diagram: needs families of one body from atlas.periodic; choose one by sel or isel"
        )
    if y not in LABELS:
        raise BadInput(f"periodic_diagram: {shown(y)}: {allowed_text(y, LABELS)}")
    values = (ds["theta_max"] - ds["theta_min"] if y == "amplitude" else ds[y]).values
    stable, arcs = ds["orbit_stable"].values == OrbitStability.STABLE, ds["arc"].values
    kinds = ds["event_kind"].values if "event_kind" in ds else np.zeros((len(arcs), 0), int)
    entries: Entries = {}
    names, ends = [*FamilyEnd.meanings()], flags_of(ds, "end", len(FamilyEnd))
    for k, colour in zip(range(len(arcs)), np.resize(COLOURS, len(arcs)), strict=True):
        end = names[ends[k]].replace("_", " ")
        entries[rf"$\omega$ = {ds['frequency'].values[k]:.4g}: {end}"] = Line2D([], [], color=str(colour))
    styles: dict[PeriodicEvent, dict[str, Any]] = {
        kind: {"marker": marker, "color": "black", "linestyle": "", "markersize": 3.5}
        for kind, marker in MARKERS.items()
    }
    for kind in (each for each in MARKERS if each in kinds):
        entries[kind.name.lower().replace("_", " ")] = Line2D([], [], **styles[kind])
    with rc_context(STYLE) if ax is None else nullcontext():
        sheet = Sheet(MapOptions(ax=ax, title=title, legend=legend, width=width))
        figure, (axes,) = sheet.figure(entries, [])
        for k, colour in zip(range(len(arcs)), np.resize(COLOURS, len(arcs)), strict=True):
            exists = np.isfinite(arcs[k])
            arc, value, flag = arcs[k][exists], values[k][exists], stable[k][exists]
            for run in np.split(np.arange(len(arc)), np.flatnonzero(np.diff(flag[:-1].astype(int))) + 1):
                part = slice(run[0], run[-1] + 2) if len(run) else slice(0)
                axes.plot(
                    arc[part],
                    value[part],
                    color=str(colour),
                    linestyle="-" if flag[run[:1]].all() else DASHED,
                )
            for kind in MARKERS:
                at = ds["event_arc"].values[k][kinds[k] == kind] if kind in kinds[k] else []
                axes.plot(at, np.interp(at, arc, value), zorder=7, **styles[kind])
        sheet.label_axes([axes], [["arc length from the birth", LABELS[y]]], entries)
    return figure
