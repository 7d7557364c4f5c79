"""Curves of exact motions on a plane of parameters."""

from __future__ import annotations

import numpy as np

from ..scene import grid
from ..systems.base import Array, Family, on_family
from .metadata import axes_of
from .plane import SAMPLES, Plane

# Number of values from which a family's formula is solved, and most ends of its curve that are resampled.
STARTS, MAX_ENDS = 17, 8


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Where exact steady motions cross a plane.

    A family has a curve if it can be solved for an axis of the plane: the family of the scene, or every
    one if the scene names none. Where a scene solves its points onto a family only an axis offset from
    the family has a curve: its zero.

    plane: where to look for exact motions. Returns family -> curves of shape (vertices, axes of the plane),
    float64, in the units of the axes; rows of nan cut a curve.
    """
    scene = plane.scene
    if scene.solve:
        lines = _zeros_of_offsets(plane)
        return {str(scene.family): lines} if lines else {}
    curves = {}
    for name in [scene.family] if scene.family is not None else list(scene.system.families):
        family = scene.system.families[name]
        # Of the axes that the family is solved for, the one with the longer curve: the other may give a single point.
        longest = max((_solution_curves(plane, family, dim) for dim in plane.extent), key=_n_vertices)
        if _n_vertices(longest):
            curves[name] = longest
    return curves


def _n_vertices(curves: list[Array]) -> int:
    """Number of vertices of some curves, those that cut a curve left out."""
    return sum(int(np.isfinite(curve).all(1).sum()) for curve in curves)


def _zeros_of_offsets(plane: Plane) -> list[Array]:
    """Straight lines on which an axis offset from the family is zero."""
    axes, lines = axes_of(plane.scene), []
    for i, (dim, (low, high)) in enumerate(plane.extent.items()):
        if axes[dim].offset_from_family and low <= 0 <= high:
            line = np.array(list(plane.extent.values())).T if len(plane.extent) > 1 else np.zeros((1, 1))
            line[:, i] = 0.0
            lines.append(line)
    return lines


def _solution_curves(plane: Plane, family: Family, dim: str) -> list[Array]:
    """The family solved for one axis over the other: every branch that enters the plane."""
    tied = any(dim in tie.names for tie in plane.scene.ties.values())
    if dim not in family.solve or tied:
        return []
    low, high = plane.extent[dim]
    abscissa, branches = _sampled_branches(plane, family, dim)
    branches[:, 1:][np.abs(np.diff(branches)) > high - low] = np.nan  # the two sides of a pole
    with_line = len(plane.extent) > 1
    curves: list[Array] = []
    for branch in np.unique(branches.round(12), axis=0):
        with np.errstate(invalid="ignore"):
            inside = (branch >= low) & (branch <= high)
        repeated = any(np.allclose(branch, c[:, -1], rtol=0, atol=1e-9, equal_nan=True) for c in curves)
        visible = (inside[1:] & inside[:-1]).any() if with_line else inside.any()
        if visible and not repeated:
            curves.append(np.stack([abscissa, branch], -1) if with_line else branch[:, np.newaxis])
    if with_line and next(iter(plane.extent)) == dim:
        curves = [curve[:, ::-1] for curve in curves]
    return curves


def _sampled_branches(plane: Plane, family: Family, dim: str) -> tuple[Array, Array]:
    """Values of the other axis, and the family's branches there: (samples,), (STARTS, samples)."""
    others = [d for d in plane.extent if d != dim]
    abscissa = plane.samples(others[0]) if others else np.zeros(1)
    branches = _branches(plane, family, dim, abscissa)
    exists = np.isfinite(branches)
    ends = np.flatnonzero((exists[:, 1:] != exists[:, :-1]).any(0))
    if 0 < ends.size <= MAX_ENDS:  # curves often end steeply, where a cosine passes 1
        between = [np.linspace(abscissa[i], abscissa[i + 1], 2 * SAMPLES) for i in ends]
        abscissa = np.unique(np.concatenate([abscissa, *between]))
        branches = _branches(plane, family, dim, abscissa)
    return abscissa, branches


def _branches(plane: Plane, family: Family, dim: str, abscissa: Array) -> Array:
    """The family solved for one axis, from STARTS values of it at each value of the other; nan off the family.

    Formulas with several branches give the one near the value that they start from.
    """
    scene = plane.scene
    low, high = plane.extent[dim]
    # Uneven fractions, so that no start is a solution by chance.
    starts = low + (high - low) * (np.arange(STARTS) + 0.381966) / STARTS
    start, other = (a.ravel() for a in np.meshgrid(starts, abscissa, indexing="ij"))
    base = dict(plane.points({dim: start} | {d: other for d in plane.extent if d != dim}).base)
    with np.errstate(all="ignore"):
        base[dim] = np.asarray(family.solve[dim](base), float)
        valid = on_family(family, base) < grid.ON_FAMILY
        if scene.family is None:  # families overlap: a point belongs to the first that holds
            valid &= scene.system.identify_family(base)[0] == family.flag
    # A formula that returns its start: the whole plane is on the family, or none of it.
    valid &= np.isfinite(base[dim]) & (np.abs(base[dim] - start) > 1e-9 * (high - low))
    return np.where(valid, base[dim], np.nan).reshape(starts.size, abscissa.size)
