"""A picture of chaos without tangent vectors: how roughly the range of theta varies over the grid."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..variables import POINT


def roughness(ds: xr.Dataset, x: str | None, y: str | None) -> xr.DataArray:
    """Second differences of theta_max - theta_min; see `Atlas.roughness`."""
    for name in ("theta_min", "theta_max"):
        if name not in ds:
            raise BadInput(f"{name}: not in this dataset; list theta_min and theta_max in outputs.variables")
    span = ds["theta_max"] - ds["theta_min"]
    dims = [str(dim) for dim in span.dims if dim != POINT and span.sizes[dim] > 2]
    chosen = [dim for dim in (x, y) if dim is not None] or dims
    for dim in chosen:
        if dim not in dims:
            raise BadInput(f"{dim}: not an axis of at least 3 values; allowed: {', '.join(dims) or 'none'}")
    if not chosen:
        raise BadInput("roughness: needs an axis of at least 3 values")
    total = xr.zeros_like(span)
    for dim in chosen:
        neighbours = span.shift({dim: 1}) + span.shift({dim: -1})
        total = total + np.abs(neighbours - 2 * span)
    return total.rename("roughness").assign_attrs(
        long_name="second differences of the range of theta", units="rad"
    )
