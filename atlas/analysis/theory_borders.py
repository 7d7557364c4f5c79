"""Lines on a plane of parameters at which theory predicts a change: of stability, of the label, of existence."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import contourpy
import numpy as np

from ..flags import Label, Stability
from ..systems.base import Array, Flags, Mask
from .metadata import is_logarithmic
from .plane import SAMPLES, Plane, Theory

# Samples along each axis before refinement: even, as SAMPLES.
COARSE_SAMPLES = 150
# Cells that a line crosses are divided into 3 x 3, so often. An odd number leaves the middle of an extent, where
# special values such as 0 often are, between two samples.
DIVISION, LEVELS = 3, 2
# Bisections of a vertex: on two axes to about 1e-5 of each, on one axis to less.
BISECTIONS, LINE_BISECTIONS = 5, 17

STABILITY = "stability limit"
LABEL = "precession limit"
EXISTENCE = "edge of existence"
ZERO_RATES = {"n": "permanent rotation: psi' = 0", "m": "permanent rotation: phi' = 0"}
KINDS = (STABILITY, LABEL, EXISTENCE, *ZERO_RATES.values())

# Classes of points: 1 and 2 on the two sides of a line, 0 where there is no line.
Classes = dict[str, Flags]


def theory_borders(plane: Plane, *, inertial: bool = False) -> dict[str, list[np.ndarray]]:
    """Lines at which theory predicts a change in a plane.

    plane: where to look for lines; inertial: of labels in inertial space, if the frame of the system turns.
    Returns kind of line, one of KINDS, -> polylines of shape (vertices, axes of the plane), float64, in the
    units of the axes. Between linearly stable and unstable motions; between regular precession and permanent
    rotation, both of some extent; where a regular precession has psi' = 0 or phi' = 0, so that it is a
    permanent rotation on that line alone; and between points with a motion and without. Kinds without a line
    are missing.

    Samples on COARSE_SAMPLES values along each axis are refined where a line crosses a cell, and around it as far
    as the line continues, so that a region wider than 1 / (COARSE_SAMPLES * DIVISION**LEVELS) of an axis is followed
    to its ends if one sample is inside it. Vertices are then bisected.
    """

    def classes(positions: Array) -> Classes:
        """Classes at positions (points, axes)."""
        return _classes(plane, plane.theory(_coordinates(plane, positions), inertial=inertial))

    if len(plane.extent) == 1:
        samples = classes(np.linspace(0, 1, SAMPLES)[:, np.newaxis])
        traced = {kind: _changes(column) for kind, column in samples.items()}
    else:
        samples = _refined_samples(classes)
        traced = {kind: _trace(column) for kind, column in samples.items()}
    result = {}
    for kind, lines in traced.items():
        edges = [_edges(line, len(samples[kind]) - 1) for line in lines]
        vertices = _bisected(classes, kind, edges)
        if kind in ZERO_RATES.values():
            vertices = _without_poles(plane, kind, edges, vertices, inertial)
        if vertices:
            result[kind] = [_values(plane, line) for line in vertices]
    return result


def stability_boundary(plane: Plane) -> list[np.ndarray]:
    """Lines between linearly stable and unstable motions in a plane, see `theory_borders`.

    plane: where to look for the boundary. Returns polylines of shape (vertices, axes of the plane), float64,
    in the units of the axes.
    """
    return theory_borders(plane).get(STABILITY, [])


# Positions are fractions of the extent of each axis.


def _coordinates(plane: Plane, positions: Array) -> dict[str, Array]:
    """Axis values by dimension at positions (points, axes)."""
    return dict(zip(plane.extent, _values(plane, positions).T, strict=True))


def _values(plane: Plane, positions: Array) -> Array:
    """Axis values at positions (points, axes)."""
    columns = []
    for i, (dim, (low, high)) in enumerate(plane.extent.items()):
        if is_logarithmic(plane.scene, dim, (low, high)):
            columns.append(low * (high / low) ** positions[:, i])
        else:
            columns.append(low + (high - low) * positions[:, i])
    return np.stack(columns, -1)


def _classes(plane: Plane, theory: Theory) -> Classes:
    """Classes of some points for each kind of line."""
    regular = theory.exists & (theory.label == Label.REGULAR_PRECESSION)
    # A nudged unstable motion has no label of its own, so that no line divides such points.
    kept = regular & ((theory.stable != Stability.UNSTABLE) | (not plane.scene.nudge))
    permanent = theory.exists & (theory.label == Label.PERMANENT_ROTATION)
    columns = {
        STABILITY: np.where(theory.exists, theory.stable, Stability.UNKNOWN),
        LABEL: np.select([regular, permanent], [1, 2], 0),
        EXISTENCE: np.where(theory.exists, 1, 2),
    }
    for name, kind in ZERO_RATES.items():
        if name not in plane.extent:  # the zero of an axis needs no line
            columns[kind] = np.where(kept, np.where(theory.rates[name] < 0, 1, 2), 0)
    return {kind: column.astype(np.int8) for kind, column in columns.items()}


def _refined_samples(classes: Callable[[Array], Classes]) -> Classes:
    """Classes on a fine grid over two axes, evaluated only where they change, (samples, samples)."""
    count = COARSE_SAMPLES
    samples = {kind: column.reshape(count, count) for kind, column in classes(_grid_positions(count)).items()}
    evaluated = np.ones((count, count), bool)
    for _ in range(LEVELS):
        # Each fine sample begins with the class of the coarse one next to it, which holds unless a line is near.
        count = DIVISION * (count - 1) + 1
        nearest = np.rint(np.arange(count) / DIVISION).astype(int)
        samples = {kind: column[np.ix_(nearest, nearest)] for kind, column in samples.items()}
        known, coarse = np.zeros((count, count), bool), evaluated
        known[::DIVISION, ::DIVISION] = True
        evaluated = np.zeros((count, count), bool)
        evaluated[::DIVISION, ::DIVISION] = coarse
        while True:
            missing = _samples_of_cells(_cells_with_a_change(samples, known)) & ~evaluated
            if not missing.any():
                break
            for kind, column in classes(np.argwhere(missing) / (count - 1)).items():
                samples[kind][missing] = column
            evaluated |= missing
            known |= missing
    return samples


def _grid_positions(count: int) -> Array:
    """Positions of a whole grid, (count**2, 2)."""
    steps = np.linspace(0, 1, count)
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)


def _cells_with_a_change(fine: Classes, known: Mask) -> Mask:
    """Coarse cells of which two known samples have different classes, edges included; (cells, cells)."""
    result = np.zeros(2 * [(len(known) - 1) // DIVISION], bool)
    for column in fine.values():
        low, high = np.where(known, column, 127), np.where(known, column, -1)
        result |= _over_cells(low, np.minimum) != _over_cells(high, np.maximum)
    return result


def _over_cells(column: np.ndarray, reduce: np.ufunc) -> np.ndarray:
    """Smallest or largest sample of each coarse cell, the samples on its edges included; (cells, cells)."""
    for axis in (0, 1):
        moved = np.moveaxis(column, axis, 0)
        parts = [moved[i : len(moved) - DIVISION + i : DIVISION] for i in range(DIVISION)]
        column = np.moveaxis(reduce.reduce([*parts, moved[DIVISION::DIVISION]]), 0, axis)
    return column


def _samples_of_cells(cells: Mask) -> Mask:
    """Fine samples of some coarse cells, those on their edges included; (samples, samples)."""
    count = DIVISION * len(cells) + 1
    result = np.zeros((count, count), bool)
    blocks = np.repeat(np.repeat(cells, DIVISION, 0), DIVISION, 1)
    for x in (0, 1):
        for y in (0, 1):
            result[x : count - 1 + x, y : count - 1 + y] |= blocks
    return result


def _changes(column: Flags) -> list[Array]:
    """Positions halfway between samples of class 1 and 2 on one axis, as lines of one vertex (1, 1)."""
    changes = np.flatnonzero((column[1:] != column[:-1]) & (column[1:] > 0) & (column[:-1] > 0))
    return [np.array([[(index + 0.5) / (len(column) - 1)]]) for index in changes]


def _trace(column: Flags) -> list[Array]:
    """Lines halfway between samples of class 1 and 2 on two axes, as positions (vertices, 2)."""
    if not ((column == 1).any() and (column == 2).any()):
        return []
    masked = np.ma.masked_equal(column.T, 0)
    generator = contourpy.contour_generator(z=masked, corner_mask=False, line_type="Separate")
    lines = cast("list[Array]", generator.lines(1.5))
    # A ring of up to six vertices contains one or two samples: the tip of a cusp, cut off by the sampling.
    return [line / (len(column) - 1) for line in lines if len(line) > 7 or (line[0] != line[-1]).any()]


def _edges(line: Array, count: int) -> tuple[Array, Array]:
    """The two samples of a grid with `count` cells along an axis between which each vertex of a line is."""
    return np.floor(line * count + 0.25) / count, np.ceil(line * count - 0.25) / count


def _bisected(
    classes: Callable[[Array], Classes], kind: str, edges: list[tuple[Array, Array]]
) -> list[Array]:
    """Lines whose vertices are at the change of class between the two samples given for each."""
    if not edges:
        return []
    low, high = (np.concatenate(ends) for ends in zip(*edges, strict=True))
    bisections = BISECTIONS if low.shape[1] > 1 else LINE_BISECTIONS
    class_at_low = classes(low)[kind]
    for _ in range(bisections):
        middle = 0.5 * (low + high)
        is_low = (classes(middle)[kind] == class_at_low)[:, np.newaxis]
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return np.split(0.5 * (low + high), np.cumsum([len(line) for line, _ in edges])[:-1])


def _without_poles(
    plane: Plane, kind: str, edges: list[tuple[Array, Array]], lines: list[Array], inertial: bool
) -> list[Array]:
    """The parts of lines on which a rate changes its sign through zero, not through infinity."""
    (name,) = (rate for rate, zero_kind in ZERO_RATES.items() if zero_kind == kind)

    def size(positions: Array) -> Array:
        """Magnitude of the rate."""
        return np.abs(plane.theory(_coordinates(plane, positions), inertial=inertial).rates[name])

    parts = []
    for (low, high), line in zip(edges, lines, strict=True):
        through_zero = size(line) < np.maximum(size(low), size(high))
        indices = np.split(np.arange(len(line)), np.flatnonzero(np.diff(through_zero)) + 1)
        parts += [line[part] for part in indices if through_zero[part[0]]]
    return parts
