"""Lines on a plane of an atlas at which a count that follows from theory changes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import cast

import contourpy
import numpy as np
import xarray as xr

from ..systems.base import Array, DerivedVariable
from .plane import Plane

CHANGE = "change of the number"
_BISECTIONS = 6  # of the distance between two neighbouring points of the atlas


def count_borders(plane: Plane, counts: xr.DataArray, derived: DerivedVariable) -> dict[str, list[Array]]:
    """Lines between the regions of a plane where a count has different values.

    plane: the plane of the atlas. counts: the counts of the atlas over the axes of the plane; regions
    narrower than its cells are missed. derived: the count, which is computed between neighbouring points that
    differ. Returns CHANGE -> polylines of shape (vertices, axes of the plane), float64, in the units of the
    axes; empty without a line. Where the count skips values that it has elsewhere, the line is returned once
    for each change.
    """
    values = counts.transpose(*plane.extent).values
    axes = [counts[dim].values for dim in plane.extent]
    trace = _contours if values.ndim == 2 else _changes
    levels = [0.5 * (a + b) for a, b in pairwise(np.unique(values[np.isfinite(values)]))]
    lines = [(level, line) for level in levels for line in trace(values, level)]
    if not lines:
        return {}

    def count_at(positions: Array) -> Array:
        """The count at positions (vertices, axes)."""
        points = plane.points(dict(zip(plane.extent, _values(positions, axes).T, strict=True)))
        return derived.values(points.base, points.duration, lambda: None)

    vertices = np.concatenate([line for _, line in lines])
    level_of = np.concatenate([np.full(len(line), level) for level, line in lines])
    values_on_axes = _values(_bisected(count_at, vertices, level_of), axes)
    return {CHANGE: np.split(values_on_axes, np.cumsum([len(line) for _, line in lines])[:-1])}


# Positions are indices of the points along each axis, and fractions between them.


def _values(positions: Array, axes: list[Array]) -> Array:
    """Axis values at positions (vertices, axes)."""
    columns = [np.interp(p, np.arange(axis.size), axis) for p, axis in zip(positions.T, axes, strict=True)]
    return np.stack(columns, -1)


def _contours(values: Array, level: float) -> list[Array]:
    """Lines between the points above and below a level, halfway between neighbours, (vertices, 2)."""
    above = np.where(np.isfinite(values), np.where(values > level, 1.0, 0.0), np.nan)
    generator = contourpy.contour_generator(
        z=np.ma.masked_invalid(above.T), corner_mask=False, line_type="Separate"
    )
    lines = cast("list[Array]", generator.lines(0.5))
    # A ring of up to six vertices contains one or two points, as many of a region narrower than the cells do.
    return [line for line in lines if len(line) > 7 or (line[0] != line[-1]).any()]


def _changes(values: Array, level: float) -> list[Array]:
    """Positions halfway between neighbours on one axis of which one is above a level, as lines of one vertex."""
    finite = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    changes = np.flatnonzero(finite & ((values[1:] > level) != (values[:-1] > level)))
    return [np.array([[index + 0.5]]) for index in changes]


def _bisected(count_at: Callable[[Array], Array], vertices: Array, level: Array) -> Array:
    """Vertices moved to where the count passes the level between their two neighbours."""
    low, high = np.floor(vertices + 0.25), np.ceil(vertices - 0.25)
    above_at_low = count_at(low) > level
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_low = ((count_at(middle) > level) == above_at_low)[:, np.newaxis]
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return 0.5 * (low + high)
