"""Size of the regions of an atlas in which a flag variable has one value."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..errors import BadInput, shown
from .chunks import chunks
from .metadata import flag_names, flag_variable


def fractions(ds: xr.Dataset, variable: str, along: str | None) -> xr.DataArray:
    """Fraction of the points with each flag of a variable; see `Atlas.fractions`."""
    array = flag_variable(ds, variable)
    names, dims = flag_names(array), [str(dim) for dim in array.dims]
    if along is not None and along not in dims:
        raise BadInput(
            f"along = {shown(along)}: not an axis of this atlas; allowed: {', '.join(dims) or 'none'}"
        )
    counts = np.zeros((1 if along is None else ds.sizes[along], len(names)), np.int64)
    for box in chunks(array.sizes, dims):
        values = array.isel(box).values
        rows = slice(None) if along is None else box[along]
        table = values[np.newaxis] if along is None else np.moveaxis(values, dims.index(along), 0)
        for flag in range(len(names)):
            counts[rows, flag] += (table == flag).sum(tuple(range(1, table.ndim)))
    with np.errstate(invalid="ignore"):
        shares = counts / counts.sum(1, keepdims=True)  # nan where there are no points
    result = xr.DataArray(
        shares,
        dims=(along or "all", variable),
        coords={variable: names} | ({along: ds[along]} if along in ds.coords else {}),
        name="fraction",
        attrs={"long_name": f"share of the points by {variable}", "units": "1"},
    )
    return result.isel(all=0) if along is None else result
