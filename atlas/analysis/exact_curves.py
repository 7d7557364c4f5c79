"""Curves of exact steady motions on a plane."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..scene.family import ON_FAMILY
from ..systems.base import Array, Condition, Family, Mask, families_of, on_family
from .metadata import axes_of
from .plane import Plane
from .tracer import lines_at, narrow, shown_parts, values_at

# Samples along each axis, and trisections of the distance between two of them, of curves that are traced.
TRACING_SAMPLES, TRISECTIONS = 150, 24


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Curves by family where exact steady motions cross a plane; rows of nan cut a curve.

    A family has a curve if it can be solved for an axis of the plane: the scene's family, or any if it names
    none; where ties use the axes, the lines on which its conditions hold. Where a scene solves its points onto a family only an
    axis offset from it has a curve, at zero.
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
    curves = {}
    for name in [scene.family] if scene.family is not None else list(families_of(scene.system)):
        family = families_of(scene.system)[name]
        if family.rate_std:  # its motions fill regions
            continue
        if lines := _traced_curves(plane, family):
            curves[name] = lines
    return curves


def _traced_curves(plane: Plane, family: Family) -> list[Array]:
    """The lines on which one condition of a family changes its sign where the others hold."""
    axes, coordinates = plane.lattice(TRACING_SAMPLES)
    shape = [axis.size for axis in axes]

    def base(places: Array) -> Mapping[str, Array]:
        return plane.points(dict(zip(plane.extent, places.T, strict=True))).base

    with np.errstate(all="ignore"):
        points = plane.points(coordinates).base
        fails = [np.broadcast_to(c.residual(points), math.prod(shape)) for c in family.conditions]
        curves = []
        for i, condition in enumerate(family.conditions):
            if (np.abs(fails[i]) < ON_FAMILY).all():
                continue  # rounding has signs too
            others = [np.abs(each) < ON_FAMILY for each in (*fails[:i], *fails[i + 1 :])]
            values = np.where(np.all(others, axis=0), fails[i], np.nan).reshape(shape)

            def is_above(positions: Array, condition: Condition = condition) -> Mask:
                return condition.residual(base(values_at(positions, axes))) > 0

            for line in lines_at(values, 0.0):
                line = line if line[0].sum() <= line[-1].sum() else line[::-1]  # whichever axis is the first
                low, high = np.floor(line), np.ceil(line)
                at_low = values[tuple(low.astype(int).T)] > 0
                places = values_at(narrow(is_above, at_low, low, high, TRISECTIONS), axes)
                here = base(places)
                shown = on_family(family, here) < ON_FAMILY
                if plane.scene.family is None:
                    shown &= plane.scene.system.identify_family(here)[0] == family.flag
                curves += [part for part in shown_parts(places, shown) if len(part) > 1 or len(axes) == 1]
    return curves
