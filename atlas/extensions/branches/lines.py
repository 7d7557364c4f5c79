"""Lines at which numbers of equilibria change."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from itertools import pairwise

import numpy as np
import xarray as xr

from ...analysis.boundary import borders
from ...analysis.plane import Plane
from ...analysis.tracer import TRACING, Lines, cached_lines, lines_at, narrowed_lines, values_at
from ...errors import BadInput
from ...flags import BifurcationKind
from ...kernel import compiling
from ...systems.base import Array, Mask, Points
from ...systems.gyrostat import Gyrostat
from .bifurcations import BodyFamily, follow
from .borders import Borders
from .starts import Cell

CHANGE = "change of the number"
COUNT_TRISECTIONS = 4  # number of trisections between two neighbouring points of the atlas
# The number of minima changes only where a minimum meets another equilibrium. The stable count also changes at limits of stability.
MINIMA_COUNT, STABLE_COUNT = "equilibrium_energy_stable_count", "equilibrium_stable_count"
MANY_COUNTS = 300  # tracing more vertices takes more than a second and is announced
BETWEEN = 6  # number of straight parts that replace a cubic of a border, with errors below 1e-5 of the plane's sides


def count_lines(count: str, plane: Plane, ds: xr.Dataset) -> Lines:
    """Return the lines at which a count of equilibria changes. If the atlas lacks the count, return lines that theory predicts."""
    if count not in ds:
        return borders(plane)
    counts = ds[count].transpose(*plane.extent)
    values = [array.values.tobytes() for array in (counts, *(counts[dim] for dim in plane.extent))]
    return cached_lines(lambda: count_borders(plane, counts), plane, count, *values)


of_all, of_stable, of_minima = (
    partial(count_lines, f"equilibrium_{kind}count") for kind in ("", "stable_", "energy_stable_")
)


def count_borders(plane: Plane, counts: xr.DataArray) -> Lines:
    """Return {CHANGE: lines}. The lines separate regions of a plane in which a count has different values.

    The lines are exact if the bodies depend smoothly on the plane. If stable equilibria are counted, the plane must also have
    two axes, and `Borders` must explain all counts. Other lines are traced between the points of the atlas. Regions narrower than a
    cell are then missed, and several lines appear where a count jumps over values.
    """
    name = str(counts.name)
    with suppress(BadInput):
        if (lines := _exact_lines(name, plane, counts)) is not None:
            return {CHANGE: lines} if lines else {}
    values = counts.transpose(*plane.extent).values
    axes = [counts[dim].values for dim in plane.extent]
    levels = [0.5 * (a + b) for a, b in pairwise(np.unique(values[np.isfinite(values)]))]
    if sum(len(line) for level in levels for line in lines_at(values, level)) > MANY_COUNTS:
        compiling.say(TRACING)

    def is_above(positions: Array, level: float) -> Mask:
        coordinates = dict(zip(plane.extent, values_at(positions, axes).T, strict=True))
        return np.asarray(plane.derived(coordinates, (name,))[name] > level)

    classes = [(level, partial(is_above, level=level), COUNT_TRISECTIONS) for level in levels]
    lines = [values_at(line, axes) for each in classes for line in narrowed_lines(values, *each)[0]]
    return {CHANGE: lines} if lines else {}


def _exact_lines(name: str, plane: Plane, counts: xr.DataArray) -> list[Array] | None:
    """Return lines, or points on a single axis, at which the count `name` changes. Return None if not all lines are known."""
    system, minima = plane.scene.system, name == MINIMA_COUNT
    if not isinstance(system, Gyrostat):
        return None
    if len(plane.extent) == 1:
        values = counts[next(iter(plane.extent))].values
        return None if name == STABLE_COUNT else _merging_points(plane, system, values, minima)
    curves = Borders.of(plane, name == STABLE_COUNT)
    number, stable = curves.changes != 0
    if name != STABLE_COUNT:
        return curves.polylines(BETWEEN, number & ((curves.morse_index == 0) | (not minima)))
    return None if (curves.cells == Cell.UNEXPLAINED).any() else curves.polylines(BETWEEN, stable)


def _merging_points(plane: Plane, system: Gyrostat, values: Array, minima: bool) -> list[Array]:
    """Return the values on a single axis at which equilibria merge. If `minima` is true, one of these equilibria must be a minimum."""
    (dim,) = plane.extent

    def points(values: Array) -> Points:
        return plane.points({dim: values[:, 0]}).base

    family = BodyFamily.of(system, points, values[:, None])
    merging = BifurcationKind.FOLD, BifurcationKind.PITCHFORK
    mergers = [p for p in follow(family, values, np.zeros(values.size, int)).points if p.kind in merging]
    where = np.array([p.value for p in mergers])
    frames = np.array([p.frame for p in mergers])
    if minima and where.size:
        where = where[np.abs(np.linalg.eigvalsh(family.linear(where[:, None], frames)[1])).argmin(1) == 0]
    return list(where[np.unique(where.round(9), return_index=True)[1]].reshape(-1, 1, 1))
