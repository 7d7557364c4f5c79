"""Figures of sections."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ...analysis.metadata import system_of
from ...errors import BadInput, allowed_text, attribute_text, shown
from ...flags import Status
from ...label.points import label_points
from ...plotting.maps import atlas_map
from ...store.dataset import TRANSIENT
from .section import AT, DIMS, LENGTH

LARGEST_DOT = 2.0  # largest area of a dot, in square points


def section_map(
    ds: xr.Dataset, x: str | None = None, y: str | None = None, *, colour: str | None = None, **options: Any
) -> Figure:
    """Figure of a section from `atlas.section`, with a dot for each crossing.

    Parameters
    ----------
    ds : Dataset
        The section; `ds.atlas.section_map` passes its own.
    x, y : str, optional
        Quantities that the section keeps, or time or error. By default the first two quantities.
    colour : str, optional
        A parameter or variable of the points, or "regularity", which `label_points` measures over the duration of the section,
        after its transient. Dots are black by default.
    **options
        Options of `map`, such as title, ax, legend and width.

    Returns
    -------
    matplotlib.figure.Figure
        The figure of `map` with the crossings as points.
    """
    if AT not in ds.attrs or not {*DIMS} <= {*ds.dims}:
        raise BadInput("section_map: this dataset is no section; atlas.section makes one")
    kept = [str(name) for name in ds if ds[name].dims == DIMS]
    axes = [name or default for name, default in zip((x, y), kept, strict=False)]
    if colour == "regularity" and colour not in ds:
        given = {name: ds[name].values for name in system_of(ds).parameters if name in ds.coords}
        labels = label_points(
            attribute_text(ds.attrs, "atlas_system"), given, duration=attribute_text(ds.attrs, LENGTH),
            transient=attribute_text(ds.attrs, TRANSIENT, "0"), variables=[colour],
        )  # fmt: skip
        ds = ds.assign({colour: labels[colour].variable})
    of_points = [
        str(name) for name in ds.variables if ds[name].dims == DIMS[:1] and ds[name].dtype.kind in "if"
    ]
    if colour is None:
        colour, black = "status", dict.fromkeys(Status.meanings(), "black")
        options = {"colors": black, "legend": False} | options
    for name, allowed in ((axes[0], kept), (axes[1], kept), (colour, [*of_points, "regularity"])):
        if name not in allowed:
            raise BadInput(f"section_map: {shown(name)}: {allowed_text(name, allowed)}")
    table = ds[[*axes, colour]].to_dataframe().dropna(subset=axes)
    symbols = {o.name: o.symbol for o in system_of(ds).observables}
    dots = xr.Dataset(
        {name: ("point", table[name], ds[name].attrs) for name in (*axes, colour)}, attrs=ds.attrs
    )
    for axis in axes:
        dots[axis].attrs |= {"long_name": symbols.get(axis) or axis}
    figure = atlas_map(dots.set_coords(axes), colour, x=axes[0], y=axes[1], **options)
    drawn: Any = (options.get("ax") or figure.axes[0]).collections[-1]
    drawn.set(sizes=np.minimum(drawn.get_sizes(), LARGEST_DOT), linewidths=0.0)
    return figure
