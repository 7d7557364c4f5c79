"""Reliability of a map between its points, estimated from the map itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..errors import BadInput, shown
from ..flags import Steadiness
from ..label.half_step import upper_bound
from ..systems.base import Array
from ..variables import proofs_of_labels
from .metadata import (
    check_not_empty,
    chunks,
    flag_names,
    flag_variable,
    in_order,
    neighbour_axes,
    without_run,
)

# Least number of values of an axis that is divided into cells. Each value of a shorter axis is a separate map.
MIN_VALUES = 5
BOX = 4  # number of points along each side of a box for which the entropy is computed


def trust(ds: xr.Dataset, variable: str) -> xr.Dataset:
    """Return the uncertainty of a map at several resolutions, and the fraction of cells with a missed border; see `Atlas.trust`."""
    check_not_empty(ds)
    grid = flag_variable(ds, variable).to_dataset()
    dims = [dim for dim in neighbour_axes(grid.assign_attrs(ds.attrs)) if grid.sizes[dim] >= MIN_VALUES]
    if not dims:
        raise BadInput(f"trust: no axis has {MIN_VALUES} values or more")
    array = in_order(grid, dict.fromkeys(dims, 1))[variable].transpose(..., *dims)
    sides = [1]
    while 4 * sides[-1] < min(array.sizes[d] for d in dims):
        sides.append(2 * sides[-1])
    uncertain = np.zeros(len(sides))
    for i, side in enumerate(sides):  # cells with corners `side` points apart
        coarse = array.isel({dim: slice(None, None, side) for dim in dims})
        n_cells = n_different = 0
        for box in chunks(coarse.sizes, dims, cell_side=1):
            differ = _differ(coarse.isel(box).values, len(dims), (0, 1), step=1)
            n_cells, n_different = n_cells + differ.size, n_different + int(differ.sum())
        uncertain[i] = n_different / n_cells
    positive, exponent = uncertain > 0, np.nan
    if positive.sum() >= 2:
        exponent = np.polyfit(np.log(np.array(sides)[positive]), np.log(uncertain[positive]), 1)[0]
    n_uniform = n_missed = 0
    for box in chunks(array.sizes, dims, cell_side=2):
        values = array.isel(box).values
        uniform = ~_differ(values, len(dims), (0, 2), step=2)
        n_uniform += int(uniform.sum())
        n_missed += int((uniform & _differ(values, len(dims), (0, 1, 2), step=2)).sum())
    missed = n_missed / n_uniform if n_uniform else np.nan
    bound = upper_bound(n_missed, n_uniform)
    boxes = mixed = total = 0.0
    for box in chunks(array.sizes, dims, cell_side=BOX):
        part, entropy = xr.DataArray(array.isel(box).values, dims=array.dims), np.zeros(1)
        for flag in np.unique(part):
            share = (part == flag).coarsen(dict.fromkeys(dims, BOX), boundary="trim").mean().values
            entropy = entropy - share * np.log(np.where(share > 0, share, 1.0))
        boxes, mixed = boxes + entropy.size, mixed + np.count_nonzero(entropy)
        total += float(entropy.sum())
    border = total / mixed if mixed else np.nan
    return xr.Dataset(
        {
            "uncertain": ("stride", uncertain, {"long_name": "share of cells whose corners differ"}),
            "exponent": ((), exponent, {"long_name": "uncertainty exponent"}),
            "entropy": ((), total / boxes, {"long_name": f"basin entropy, of boxes of side {BOX}"}),
            "border_entropy": ((), border, {"long_name": "basin entropy of the boxes with several flags"}),
            "missed": ((), missed, {"long_name": "share of cells with equal corners that hide a border"}),
            "missed_bound": ((), bound, {"long_name": "upper 95 % bound of missed"}),
        },
        coords={"stride": ("stride", sides, {"long_name": "side of the cells in points"})},
        attrs={"variable": variable, "axes": ", ".join(dims)},
    )


def _differ(values: np.ndarray, n_axes: int, offsets: tuple[int, ...], *, step: int) -> np.ndarray:
    """Whether the values in each cell differ. A cell begins at every `step`-th point of an axis, and has points at `offsets` from there."""
    low = high = values
    for axis in range(values.ndim - n_axes, values.ndim):
        first = np.arange((values.shape[axis] - 1) // step) * step
        low = np.minimum.reduce([low.take(first + offset, axis) for offset in offsets])
        high = np.maximum.reduce([high.take(first + offset, axis) for offset in offsets])
    return low != high


def roughness(ds: xr.Dataset, x: str | None, y: str | None) -> xr.DataArray:
    """Return second differences of theta_max - theta_min; see `Atlas.roughness`."""
    for name in ("theta_min", "theta_max"):
        if name not in ds:
            raise BadInput(f"{name}: not in this dataset; list theta_min and theta_max in outputs.variables")
    ds = ds[["theta_min", "theta_max"]]
    dims = [dim for dim in neighbour_axes(ds) if ds.sizes[dim] > 2]
    ds = in_order(ds, dict.fromkeys(dims, 1))
    span = ds["theta_max"] - ds["theta_min"]
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


def fractions(ds: xr.Dataset, variable: str, along: str | None) -> xr.DataArray:
    """Return the fraction of the points with each flag of a variable; see `Atlas.fractions`."""
    counts = flag_counts(ds, variable, [] if along is None else [_axis(ds, variable, "along", along)])
    with np.errstate(invalid="ignore"):
        shares = counts / counts.sum(variable)  # nan where there are no points
    attributes = {"long_name": f"share of the points by {variable}", "units": "1"}
    if variable in proofs_of_labels() and (proved := without_run(ds)) is not None:
        attributes["comment"] = f"{int(proved.sum())} of the points have the label of a proof and no run"
    return shares.rename("fraction").assign_attrs(attributes)


def probability(ds: xr.Dataset, variable: str, over: str | Sequence[str]) -> xr.Dataset:
    """Return the fraction of random draws with each flag of a variable, and its confidence interval; see `Atlas.probability`."""
    draw_axes = [_axis(ds, variable, "over", name) for name in ([over] if isinstance(over, str) else over)]
    counts = flag_counts(ds, variable, [str(dim) for dim in ds[variable].dims if dim not in draw_axes])
    draws = math.prod(ds.sizes[dim] for dim in draw_axes)
    coords = {name: c for name, c in ds.coords.items() if set(c.dims) <= {*counts.dims} and name != variable}
    with np.errstate(invalid="ignore"):  # 0 / 0 if there are no draws
        columns = counts.values / draws, *wilson_interval(counts.values, draws)
    what = f"probability of each {variable} over {' and '.join(draw_axes)}"
    texts = {"probability": "", "lower": "lower 95 % limit of the ", "upper": "upper 95 % limit of the "}
    variables = {
        name: (counts.dims, values, {"long_name": text + what, "units": "1"})
        for (name, text), values in zip(texts.items(), columns, strict=True)
    }
    return xr.Dataset(variables, {**coords, **counts.coords}, {**ds.attrs, "atlas_draws": draws})


def wilson_interval(events: Array, draws: int) -> tuple[Array, Array]:
    """Return the lower and upper 95 % limit of a probability from `events` in `draws` independent trials, or nan without trials.

    E. B. Wilson, Journal of the American Statistical Association 22 (1927) 209-212.
    """
    from scipy.special import ndtri  # slow to import, and rarely needed

    z = float(ndtri(0.975))
    with np.errstate(invalid="ignore", divide="ignore"):
        share, width = np.divide(events, draws), np.divide(z * z, draws)
        middle = (share + 0.5 * width) / (1.0 + width)
        half = np.sqrt(width * (share * (1.0 - share) + 0.25 * width)) / (1.0 + width)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


def _axis(ds: xr.Dataset, variable: str, option: str, name: str) -> str:
    """Return the given name. Raise BadInput unless it is an axis of a flag variable."""
    if name not in (dims := [str(dim) for dim in flag_variable(ds, variable).dims]):
        raise BadInput(
            f"{option} = {shown(name)}: not an axis of this atlas; allowed: {', '.join(dims) or 'none'}"
        )
    return name


def flag_counts(ds: xr.Dataset, variable: str, along: Sequence[str]) -> xr.DataArray:
    """Return the number of points with each flag. The dimensions are those of `along`, in the order of the atlas, and then `variable`."""
    array = flag_variable(ds, variable)
    names, dims = flag_names(array), [str(dim) for dim in array.dims]
    dims_along = [dim for dim in dims if dim in along]
    others = tuple(i for i, dim in enumerate(dims) if dim not in along)
    counts = np.zeros([*(array.sizes[dim] for dim in dims_along), len(names)], np.int64)
    for box in chunks(array.sizes, dims):
        values = array.isel(box).values
        for flag in range(len(names)):
            counts[..., flag][tuple(box[dim] for dim in dims_along)] += (values == flag).sum(others)
    coords = {dim: ds[dim] for dim in dims_along if dim in ds.coords}
    # Label 2 is not used by systems with observables.
    listed = [
        i for i, name in enumerate(names) if name != Steadiness.UNUSED.name.lower() or counts[..., i].any()
    ]
    return xr.DataArray(
        counts[..., listed], {**coords, variable: [names[i] for i in listed]}, (*dims_along, variable)
    )
