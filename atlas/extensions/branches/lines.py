"""Lines at which the number of equilibria changes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise, product

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...analysis.boundary import borders
from ...analysis.plane import Plane
from ...analysis.tracer import TRACING, Lines, cached_lines, lines_at, narrowed_lines, shown_parts, values_at
from ...kernel import compiling
from ...systems.base import Array, Mask, Points, possible_body
from ...systems.gyrostat import Gyrostat
from .bifurcations import BodyFamily, curves, on_segments

CHANGE = "change of the number"
COUNT_TRISECTIONS = 4  # share of the distance between two neighbouring points of the atlas
# Counts that change only where equilibria merge.
MERGING_COUNTS = ("equilibrium_count", "equilibrium_energy_stable_count")
MANY_COUNTS = 300  # vertices, which take more than a second
SLICES, SLICE_VALUES = 7, 9  # along each axis, on which curves begin
MAX_SEARCHES = 8  # searches for points on further curves
MAX_SEGMENTS = 64  # changes of a count between neighbours in each search
CURVES_AT_ONCE = 4  # curves that are followed at once
SAME_CURVE = 1e-3  # distance over the extent of the axes: further than the chords of a curve are from it


def count_lines(count: str, plane: Plane, ds: xr.Dataset) -> Lines:
    """Lines between the numbers of equilibria of an atlas that has this count, which no start changes; else borders of motions."""
    if count not in ds:
        return borders(plane)
    counts = ds[count].transpose(*plane.extent)
    values = [array.values.tobytes() for array in (counts, *(counts[dim] for dim in plane.extent))]
    return cached_lines(lambda: count_borders(plane, counts), plane, count, *values)


of_all, of_stable, of_minima = (
    partial(count_lines, f"equilibrium_{kind}count") for kind in ("", "stable_", "energy_stable_")
)


def count_borders(plane: Plane, counts: xr.DataArray) -> Lines:
    """Lines, under CHANGE, between the regions of a plane where a count has different values.

    Regions narrower than a cell are missed, but for MERGING_COUNTS; each change of a count that skips values gives its own line.
    """
    values, name = counts.transpose(*plane.extent).values, str(counts.name)
    axes = [counts[dim].values for dim in plane.extent]
    levels = [0.5 * (a + b) for a, b in pairwise(np.unique(values[np.isfinite(values)]))]
    changes = np.concatenate(
        [np.zeros((0, len(axes))), *(line for level in levels for line in lines_at(values, level))]
    )
    if len(changes) > MANY_COUNTS:
        compiling.say(TRACING)
    if name in MERGING_COUNTS:
        assert isinstance(plane.scene.system, Gyrostat)
        lines = _merging_lines(plane, plane.scene.system, axes, changes, name)
        return {CHANGE: lines} if lines else {}

    def is_above(positions: Array, level: float) -> Mask:
        """Whether the count at positions (vertices, axes) is above a level."""
        coordinates = dict(zip(plane.extent, values_at(positions, axes).T, strict=True))
        return np.asarray(plane.derived(coordinates, (name,))[name] > level)

    classes = [(level, partial(is_above, level=level), COUNT_TRISECTIONS) for level in levels]
    lines = [values_at(line, axes) for each in classes for line in narrowed_lines(values, *each)[0]]
    return {CHANGE: lines} if lines else {}


def _merging_lines(
    plane: Plane, system: Gyrostat, axes: list[Array], changes: Array, count: str
) -> list[Array]:
    """Curves on which equilibria merge, exact but for rounding.

    They are followed from points on SLICES of the plane, then from changes of the count between neighbours, the indices halfway
    (N, axes), that none of them explains. Those on which no minimum merges are followed and left out where minima are counted.
    """
    minima = count == MERGING_COUNTS[1]
    extent = {dim: (axis.min(), axis.max()) for dim, axis in zip(plane.extent, axes, strict=True)}
    plane = replace(plane, extent=extent)
    places = [plane.positions(dim, axis) for dim, axis in zip(extent, axes, strict=True)]

    def points(positions: Array) -> Points:
        return plane.points(plane.coordinates(positions)).base

    def in_units(positions: Array) -> Array:
        return np.stack(list(plane.coordinates(positions).values()), -1)

    family = BodyFamily.of(system, points, np.array(list(product((0.0, 0.4, 1.0), repeat=len(axes)))))
    if len(axes) == 1:
        where, _, number = on_segments(family, np.zeros((1, 1)), np.ones((1, 1)), axes[0].size)
        where = where[(number == 0) | (not minima)]
        return list(in_units(where[np.unique(where.round(9), return_index=True)[1]])[:, None])
    across, ends = (np.arange(SLICES) + 0.38) / SLICES, np.repeat([[0.0], [1.0]], SLICES, 1)
    sides = np.stack([np.broadcast_to(across, ends.shape), ends], -1)
    (low, high), size = np.concatenate([sides, sides[..., ::-1]], 1), SLICE_VALUES
    indices = np.stack([np.floor(changes + 0.25), np.ceil(changes - 0.25)])
    unexplained = np.stack([values_at(each, places) for each in indices], 1)
    lines: list[tuple[Array, NDArray[np.int64]]] = []
    for _ in range(MAX_SEARCHES):
        where, frames, _ = on_segments(family, low, high, size)
        remaining = np.unique(where.round(9), axis=0, return_index=True)[1]
        for vertices, _ in lines:
            remaining = remaining[_distances(vertices, where[remaining]) > SAME_CURVE]
        while remaining.size:
            some = remaining[:CURVES_AT_ONCE]
            for i, line in zip(some, curves(family, where[some], frames[some]), strict=True):
                if i in remaining:
                    lines.append(line)
                    remaining = remaining[_distances(line[0], where[remaining]) > SAME_CURVE]
            remaining = np.setdiff1d(remaining, some)
        for vertices, number in lines:
            cells = np.array([axis.size - 1 for axis in axes])
            far = _distances(vertices * cells, unexplained.mean(1) * cells) > 1
            unexplained = unexplained[far | bool(minima and number.any())]
        if not len(unexplained):
            break
        (low, high), size = np.moveaxis(unexplained[:MAX_SEGMENTS], 1, 0), 2
        unexplained = unexplained[MAX_SEGMENTS:]
    shown = [possible_body(system, points(line)) & ((number == 0) | (not minima)) for line, number in lines]
    parts = [part for (line, _), mask in zip(lines, shown, strict=True) for part in shown_parts(line, mask)]
    return [in_units(part) for part in parts if len(part) > 1]


def _distances(line: Array, points: Array) -> Array:
    """Distances of points (N, axes) from a polyline."""
    start, chord = line[:-1], np.diff(line, axis=0)
    offset = points[:, None] - start
    fraction = np.clip((offset * chord).sum(-1) / np.maximum((chord**2).sum(-1), 1e-300), 0, 1)
    return np.sqrt(((offset - fraction[..., None] * chord) ** 2).sum(-1)).min(1, initial=np.inf)
