"""Diagrams of families of periodic motions."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from itertools import pairwise

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
        Quantity to draw; the amplitude is the range of theta.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into. By default a new figure is made.
    title : str, optional
        Title of the figure.
    legend : bool, optional
        Draw the legend, which gives the frequency at the birth of each family and the kind of its end.
    width : {"column", "page"}, optional
        Width of the figure, 88 mm or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Lines are full where orbits are stable and dashed where orbits are unstable; markers show events.
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
    names, colours = [*FamilyEnd.meanings()], np.resize(COLOURS, len(arcs)).tolist()
    entries: Entries = {}
    for frequency, end, colour in zip(
        ds["frequency"].values, flags_of(ds, "end", len(names)), colours, strict=True
    ):
        text = names[end].replace("_", " ")
        entries[rf"$\omega$ = {frequency:.4g}: {text}"] = Line2D([], [], color=colour)
    marks = {
        kind: partial(Line2D, color="black", linestyle="", marker=MARKERS[kind], markersize=3.5, zorder=7)
        for kind in MARKERS
        if kind in kinds
    }
    entries |= {kind.name.lower().replace("_", " "): mark([], []) for kind, mark in marks.items()}
    with rc_context(STYLE) if ax is None else nullcontext():
        sheet = Sheet(MapOptions(ax=ax, title=title, legend=legend, width=width))
        figure, (axes,) = sheet.figure(entries, [])
        for k, colour in enumerate(colours):
            exists = np.isfinite(arcs[k])
            arc, value, flags = arcs[k][exists], values[k][exists], stable[k][exists]
            starts = [0, *np.flatnonzero(np.diff(flags[:-1])) + 1, len(arc) - 1]
            for first, last in pairwise(starts):
                part = slice(first, last + 1)
                axes.plot(arc[part], value[part], color=colour, linestyle="-" if flags[first] else DASHED)
            for kind, mark in marks.items():
                at = ds["event_arc"].values[k][kinds[k] == kind]
                axes.add_line(mark(at, np.interp(at, arc, value)))
        sheet.label_axes([axes], [["arc length from the birth", LABELS[y]]], entries)
    return figure
