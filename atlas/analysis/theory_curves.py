"""Boundaries of stability and curves of exact motions on a plane of parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import cast

import contourpy
import numpy as np
import xarray as xr

from ..errors import BadInput
from ..label.theory import predict
from ..scene import grid
from ..scene.model import Duration, Scene
from ..systems.base import Family, on_family
from .select import axes_of

# Even, so that no sample falls on the middle of a frame, where special values such as 0 like to be.
SAMPLES = 300


# Theory on the plane of a map.


@dataclass(frozen=True)
class Plane:
    """Part of a scene's parameter space that a map shows: one or two axes, the others held."""

    scene: Scene
    frame: Mapping[str, tuple[float, float]]  # dimension of the atlas -> lowest and highest value, x first
    held: Mapping[str, float]  # dimension -> value, all others

    @staticmethod
    def of(scene: Scene, ds: xr.Dataset, dims: Iterable[str]) -> Plane:
        """The plane of some dimensions of an atlas whose other axes have one value each."""
        frame = {dim: (float(ds[dim].min()), float(ds[dim].max())) for dim in dims}
        held = {}
        for dim in axes_of(scene):
            if dim not in frame:
                if dim not in ds.coords or ds[dim].size != 1:
                    raise BadInput(f"{dim}: this axis of the scene has no single value here; select one")
                held[dim] = float(ds[dim].item())
        return Plane(scene, frame, held)

    def log(self, dim: str) -> bool:
        """Is the axis spaced evenly in its logarithm?"""
        return axes_of(self.scene)[dim].table.get("spacing") == "log"

    def samples(self, dim: str, count: int = SAMPLES) -> np.ndarray:
        """Values along an axis, evenly spread over the frame."""
        return (np.geomspace if self.log(dim) else np.linspace)(*self.frame[dim], count)

    def points(self, places: Mapping[str, np.ndarray]) -> grid.Grid:
        """The points at places in the frame, before their duration is known."""
        size = next(iter(places.values())).shape
        every = {dim: np.full(size, value) for dim, value in self.held.items()} | dict(places)
        axes = axes_of(self.scene)
        # a duration in turns has no value where nothing turns, and theory does not ask for one
        timeless = replace(self.scene, duration=Duration(1.0))
        return grid.points_at(timeless, {axes[dim].name: values for dim, values in every.items()})

    def stable(self, places: Mapping[str, np.ndarray]) -> np.ndarray:
        """Linear stability from theory at places in the frame: 0 unknown, 1 stable, 2 unstable."""
        found = self.points(places)
        predicted = predict(self.scene.system, found.base, self.scene.settings.rate_tolerance, False)
        return np.where(found.there, predicted["stable"], 0)


def stability_boundary(plane: Plane) -> list[np.ndarray]:
    """Lines between linearly stable and unstable motions in a plane, from theory.

    Returns arrays of shape (vertices, axes of the plane). The lines are traced on SAMPLES x SAMPLES
    points, and each vertex is then bisected to 1e-5 of the distance between them.
    """
    lines = [plane.samples(dim) for dim in plane.frame]

    def flags(index: np.ndarray) -> np.ndarray:
        columns = [np.interp(index[:, i], np.arange(SAMPLES), line) for i, line in enumerate(lines)]
        return plane.stable(dict(zip(plane.frame, columns, strict=True)))

    nodes = np.stack(np.meshgrid(*[np.arange(SAMPLES, dtype=float)] * len(lines), indexing="ij"), -1)
    stable = flags(nodes.reshape(-1, len(lines))).reshape(nodes.shape[:-1])
    if len(lines) == 1:
        flips = np.flatnonzero((stable[1:] != stable[:-1]) & (stable[1:] > 0) & (stable[:-1] > 0))
        found = [np.array([[flip + 0.5]]) for flip in flips]
    else:
        known = np.ma.masked_equal(stable.T, 0)
        generator = contourpy.contour_generator(z=known, corner_mask=False, line_type="Separate")
        # A ring of four vertices holds a single sample: the tip of a cusp that the samples broke off.
        found = [line for line in cast("list[np.ndarray]", generator.lines(1.5)) if len(line) > 5]
    if not found:
        return []
    vertex = np.concatenate(found)
    low, high = np.floor(vertex), np.ceil(vertex)  # the two nodes of the edge that the vertex halves
    at_low = flags(low)
    for _ in range(17):
        middle = 0.5 * (low + high)
        same = (flags(middle) == at_low)[:, np.newaxis]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    columns = [np.interp(0.5 * (low + high)[:, i], np.arange(SAMPLES), line) for i, line in enumerate(lines)]
    return np.split(np.stack(columns, -1), np.cumsum([len(line) for line in found])[:-1])


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Where exact steady motions cross a plane: family -> curves of shape (vertices, axes of the plane).

    A family shows if it can be solved for an axis of the plane; the family of the scene, or every one
    if the scene names none. Curves are cut by rows of nan. Where a scene solves its points onto a
    family only an axis offset from the family has a curve: its zero.
    """
    scene, axes = plane.scene, axes_of(plane.scene)
    if scene.solve:
        dims = list(plane.frame)
        curves = []
        for i, dim in enumerate(dims):
            low, high = plane.frame[dim]
            if axes[dim].offset_from_family and low <= 0 <= high:
                ends = np.array([list(plane.frame[d]) for d in dims]).T if len(dims) > 1 else np.zeros((1, 1))
                ends[:, i] = 0.0
                curves.append(ends)
        return {str(scene.family): curves} if curves else {}
    named = [scene.family] if scene.family is not None else list(scene.system.families)
    found = {}
    for name in named:
        family = scene.system.families[name]
        # Whichever axis gives the longer curve: solved for the other one it may be a single point.
        best = max((_solution_curves(plane, family, dim) for dim in plane.frame), key=_length)
        if _length(best):
            found[name] = best
    return found


def _length(curves: list[np.ndarray]) -> int:
    return sum(int(np.isfinite(curve).all(1).sum()) for curve in curves)


def _solution_curves(plane: Plane, family: Family, dim: str) -> list[np.ndarray]:
    """The family solved for one axis over the other: every branch that enters the frame."""
    scene = plane.scene
    tied = any(dim in tie.names for tie in scene.ties.values())
    if dim not in family.solve or tied:
        return []
    # Formulas with several branches answer with the one near the value given; uneven starts, so that
    # none of them is a solution by chance.
    low, high = plane.frame[dim]
    starts = low + (high - low) * (np.arange(17) + 0.381966) / 17
    others = [d for d in plane.frame if d != dim]

    def branches(along: np.ndarray) -> np.ndarray:
        start, other = (a.ravel() for a in np.meshgrid(starts, along, indexing="ij"))
        base = dict(plane.points({dim: start} | {d: other for d in others}).base)
        with np.errstate(all="ignore"):
            base[dim] = np.asarray(family.solve[dim](base), float)
            there = on_family(family, base) < grid.ON_FAMILY
            if scene.family is None:  # families overlap: the first that holds is the point's
                there &= scene.system.identify_family(base)[0] == family.flag
        # A formula that gives back what it was given: the whole plane is on the family, or none of it.
        there &= np.isfinite(base[dim]) & (np.abs(base[dim] - start) > 1e-9 * (high - low))
        return np.where(there, base[dim], np.nan).reshape(starts.size, along.size)

    along = plane.samples(others[0]) if others else np.zeros(1)
    values = branches(along)
    ends = np.flatnonzero((np.isfinite(values[:, 1:]) != np.isfinite(values[:, :-1])).any(0))
    if 0 < ends.size <= 8:  # curves often end steeply, where a cosine passes 1
        along = np.unique(
            np.concatenate([along, *(np.linspace(along[i], along[i + 1], 2 * SAMPLES) for i in ends)])
        )
        values = branches(along)
    values[:, 1:][np.abs(np.diff(values)) > high - low] = np.nan  # the two sides of a pole
    curves: list[np.ndarray] = []
    for branch in np.unique(values.round(12), axis=0):
        with np.errstate(invalid="ignore"):
            inside = (branch >= low) & (branch <= high)
        repeated = any(np.allclose(branch, c[:, -1], rtol=0, atol=1e-9, equal_nan=True) for c in curves)
        enough = (inside[1:] & inside[:-1]).any() if others else inside.any()
        if enough and not repeated:
            curves.append(np.stack([along, branch], -1) if others else branch[:, np.newaxis])
    if others and next(iter(plane.frame)) == dim:
        curves = [curve[:, ::-1] for curve in curves]
    return curves
