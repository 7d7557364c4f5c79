"""Curves on the plane of a map. The points of a curve have exact steady motions."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..scene.family import ON_FAMILY
from ..systems.base import Array, Family, Mask, families_of, on_family
from .metadata import axes_of
from .plane import Plane
from .tracer import cached_lines, lines_at, narrow, shown_parts, values_at

# Curves are traced on TRACING_SAMPLES samples along each axis. TRISECTIONS trisections find a vertex between two samples.
TRACING_SAMPLES, TRISECTIONS = 150, 24
# A condition that holds at more than this fraction of the samples holds in a region and gives no curve.
REGION = 0.1


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Return the curves on a plane along which exact steady motions exist, by family.

    If the scene names a family, only this family is traced. If the scene solves parameters for the family, each axis of offsets
    from the solution gives the line on which the offset is 0. Otherwise all conditions of a family hold on a curve.
    """
    scene = plane.scene
    if scene.solve:
        axes, lines = axes_of(scene), []
        for i, (dim, (low, high)) in enumerate(plane.extent.items()):
            if axes[dim].offset_from_family and low <= 0 <= high:
                line = np.array(list(plane.extent.values())).T if len(plane.extent) > 1 else np.zeros((1, 1))
                line[:, i] = 0.0
                lines.append(line)
        return {str(scene.family): lines} if lines else {}
    families = families_of(scene.system)
    chosen = families if scene.family is None else [scene.family]
    traced = [name for name in chosen if not families[name].rate_std]  # unsteady families fill regions

    def trace() -> dict[str, list[Array]]:
        return {name: _traced_curves(plane, families[name]) for name in traced}

    return {name: lines for name, lines in cached_lines(trace, plane, traced).items() if lines}


def _traced_curves(plane: Plane, family: Family) -> list[Array]:
    """Return the lines on which one condition of a family changes sign and the other conditions hold.

    A condition that is the magnitude of a vector has no sign, and is replaced by the difference between a parameter and its
    solved value. If several parameters can be solved for, the parameter with the longest lines is used.
    """
    axes, coordinates = plane.lattice(TRACING_SAMPLES)

    def solved(name: str, points: Mapping[str, Array]) -> Array:
        return family.solve[name](points) - points[name]

    with np.errstate(all="ignore"):
        points = plane.points(coordinates).base
        fails = [np.broadcast_to(c.residual(points), axes[0].size ** len(axes)) for c in family.conditions]
        holds = [np.abs(each) < ON_FAMILY for each in fails]
        curves = list[Array]()
        for i, condition in enumerate(family.conditions):
            others = np.logical_and.reduce(holds[:i] + holds[i + 1 :], axis=0, initial=True)
            if not others.any() or holds[i][others].mean() > REGION:
                continue
            varied = [name for name in family.solve if np.ptp(points[name])]
            names = [name for name in varied if name in plane.extent] or varied
            has_signs = bool((fails[i][others] < 0).any())
            functions = [condition.residual] if has_signs else [partial(solved, name) for name in names]
            if not functions:
                logging.getLogger("atlas").info(
                    "no curve of exact motions of %s: no parameter that varies here solves %s",
                    family.name, condition.text,
                )  # fmt: skip
            candidates = [
                _zero_lines(plane, family, axes, np.where(others, f(points), np.nan), f) for f in functions
            ]
            curves += max(candidates, key=lambda lines: sum(map(len, lines)), default=[])
    return curves


def _zero_lines(
    plane: Plane, family: Family, axes: list[Array], column: Array, function: Callable[[Any], Array]
) -> list[Array]:
    """Return the lines on which `function` is 0 and the family exists. `column` contains the function's values on the lattice of `axes`."""

    def base(places: Array) -> Mapping[str, Array]:
        return plane.points(dict(zip(plane.extent, places.T, strict=True))).base

    def is_above(positions: Array) -> Mask:
        return function(base(values_at(positions, axes))) > 0

    values = column.reshape([axis.size for axis in axes])
    lines = lines_at(values, 0.0)
    if not lines or (np.abs(column) < ON_FAMILY).mean() > REGION:
        return []
    # The direction of a line must not depend on the order of the axes.
    lines = [line if line[0].sum() <= line[-1].sum() else line[::-1] for line in lines]
    low, high = np.floor(np.concatenate(lines)), np.ceil(np.concatenate(lines))
    at_low = values[tuple(low.astype(int).T)] > 0
    places = values_at(narrow(is_above, at_low, low, high, TRISECTIONS), axes)
    here = base(places)
    shown = on_family(family, here) < ON_FAMILY
    if plane.scene.family is None:
        shown &= plane.scene.system.identify_family(here)[0] == family.flag
    ends = np.cumsum([len(line) for line in lines])[:-1]
    parts = map(shown_parts, np.split(places, ends), np.split(shown, ends))
    return [part for each in parts for part in each if len(part) > 1 or len(axes) == 1]
