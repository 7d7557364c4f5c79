"""Size and borders of the regions of an atlas in which a flag variable has one value."""

from __future__ import annotations

from collections.abc import Mapping

import contourpy
import numpy as np
import xarray as xr

from ..errors import BadInput, shown
from .chunks import chunks
from .metadata import flag_names, flag_values, flag_variable
from .select import plane_of


def fractions(ds: xr.Dataset, variable: str, along: str | None) -> xr.DataArray:
    """Fraction of the points with each flag of a variable; see `Atlas.fractions`."""
    array = flag_variable(ds, variable)
    names, dims = flag_names(array), [str(dim) for dim in array.dims]
    if along is not None and along not in dims:
        raise BadInput(f"along = {shown(along)}: not an axis of this atlas; allowed: {', '.join(dims)}")
    counts = np.zeros((1 if along is None else ds.sizes[along], len(names)), np.int64)
    for box in chunks(array.sizes, dims):
        values = array.isel(box).values
        rows = slice(None) if along is None else box[along]
        table = values[np.newaxis] if along is None else np.moveaxis(values, dims.index(along), 0)
        for flag in range(len(names)):
            counts[rows, flag] += (table == flag).reshape(len(table), -1).sum(1)
    result = xr.DataArray(
        counts / counts.sum(1, keepdims=True),
        dims=(along or "all", variable),
        coords={variable: names} | ({along: ds[along]} if along in ds.coords else {}),
        name="fraction",
        attrs={"long_name": f"share of the points by {variable}", "units": "1"},
    )
    return result.isel(all=0) if along is None else result


def boundary(
    ds: xr.Dataset, label: str, variable: str, x: str | None, y: str | None, select: Mapping[str, float]
) -> list[np.ndarray]:
    """Border of the region where a variable has one flag, on a plane of two axes; see `Atlas.boundary`."""
    (flag,) = flag_values(ds, variable, label)
    plane, dims, panel_dim = plane_of(ds, x, y, select)
    if len(dims) != 2 or panel_dim is not None:
        raise BadInput(
            f"boundary: needs two axes, found {', '.join(map(str, plane.dims))}; use select for the others"
        )
    inside = (plane[variable].transpose(dims[1], dims[0]) == flag).values.astype(float)
    generator = contourpy.contour_generator(
        plane[dims[0]].values, plane[dims[1]].values, inside, line_type="Separate"
    )
    return [np.asarray(line) for line in generator.lines(0.5)]
