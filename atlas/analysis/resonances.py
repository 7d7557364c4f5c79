"""Lines on a plane of parameters at which two frequencies of small oscillations are in resonance."""

from __future__ import annotations

from itertools import combinations
from typing import cast

import contourpy
import numpy as np

from ..flags import Stability
from ..systems.base import Array, derived_values
from ..systems.gyrostat.variables import FREQUENCIES
from .plane import Plane

RATIOS = (1, 2, 3)
KINDS = tuple(f"resonance {ratio}:1" for ratio in RATIOS)
# Variables on whose maps the lines are drawn.
VARIABLES = (*FREQUENCIES, "stability_kind")
_SAMPLES = 200  # along each axis
# By how much the difference of two frequencies, continued linearly from two samples, may miss the third where they cross.
_CURVATURE = 0.5


def resonance_lines(plane: Plane) -> dict[str, list[Array]]:
    """Lines at which the ratio of two frequencies of a motion that is not unstable is 1, 2 or 3.

    plane: with two axes, of a system that has the variables of `systems.gyrostat.variables`. Returns kind of line,
    one of KINDS, -> polylines of shape (vertices, 2), float64, in the units of the axes. A resonance 1:1 at
    which stability ends is a stability limit, and is not among them. Kinds without a line are missing.
    """
    axes = [plane.samples(dim, _SAMPLES) for dim in plane.extent]
    grids = np.meshgrid(*axes, indexing="ij")
    coordinates = dict(zip(plane.extent, (grid.ravel() for grid in grids), strict=True))
    points, theory = plane.points(coordinates), plane.theory(coordinates)
    not_unstable = theory.exists & (theory.stable != Stability.UNSTABLE)
    derived = derived_values(plane.scene.system, FREQUENCIES, points.base, points.duration, lambda: None)
    frequencies = [
        np.where(not_unstable, derived[name], np.nan).reshape(_SAMPLES, _SAMPLES) for name in FREQUENCIES
    ]
    result = {}
    for ratio, kind in zip(RATIOS, KINDS, strict=True):
        trace = _crossings if ratio == 1 else _zeros
        lines = [
            line for large, small in combinations(frequencies, 2) for line in trace(large - ratio * small)
        ]
        if lines:
            result[kind] = [_values(line, axes) for line in lines]
    return result


def _values(line: Array, axes: list[Array]) -> Array:
    """Axis values at positions in units of samples."""
    steps = np.arange(_SAMPLES)
    return np.stack([np.interp(line[:, i], steps, axis) for i, axis in enumerate(axes)], -1)


def _zeros(difference: Array) -> list[Array]:
    """Lines on which a smooth function vanishes; nan where it is not defined."""
    generator = contourpy.contour_generator(
        z=np.ma.masked_invalid(difference.T), corner_mask=False, line_type="Separate"
    )
    return cast("list[Array]", generator.lines(0.0))


def _crossings(difference: Array) -> list[Array]:
    """Segments on which two frequencies cross: their difference, the larger less the smaller, has a kink at 0.

    It crosses between two samples where its continuation from one side of them is the negative of its value on the other.
    """
    along_x = _crossed_edges(difference)
    along_y = _crossed_edges(difference.T).T
    lines = []
    count = difference.shape[0] - 1
    marked = np.isfinite(along_x)[:, :-1] | np.isfinite(along_x)[:, 1:]
    marked = marked | np.isfinite(along_y)[:-1] | np.isfinite(along_y)[1:]
    for i, j in np.argwhere(marked[:count, :count]):
        ends = [(i + along_x[i, j + side], j + side) for side in (0, 1)]
        ends += [(i + side, j + along_y[i + side, j]) for side in (0, 1)]
        ends = [end for end in ends if np.isfinite(end).all()]
        if len(ends) == 2:
            lines.append(np.array(ends, float))
    return lines


def _crossed_edges(difference: Array) -> Array:
    """Fraction at which the difference vanishes between samples i and i + 1 of the first axis; nan where it does not."""
    fraction = np.full((difference.shape[0] - 1, difference.shape[1]), np.nan)
    before, low, high, after = difference[:-3], difference[1:-2], difference[2:-1], difference[3:]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = low + high
        crossed = (np.abs(2 * low - before + high) < _CURVATURE * size) & (low < before)
        crossed &= (np.abs(2 * high - after + low) < _CURVATURE * size) & (high < after)
        fraction[1:-1] = np.where(crossed, low / size, np.nan)
    return fraction
