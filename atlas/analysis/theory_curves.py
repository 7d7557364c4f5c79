"""Boundaries of stability and curves of exact motions on a plane of parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import cast

import contourpy
import numpy as np
import xarray as xr

from ..errors import BadInput
from ..flags import Stability
from ..label.theory import predict
from ..scene import grid
from ..scene.model import Duration, Scene
from ..systems.base import Array, Family, Flags, on_family
from .metadata import axes_of, is_logarithmic

# Even, so that no sample falls on the middle of an extent, where special values such as 0 often are.
SAMPLES = 300
# Bisections of a vertex of the stability boundary: to 1e-5 of the distance between samples.
BISECTIONS = 17
# Values from which a family's formula is solved, and at most so many ends of its curve are resampled.
STARTS, MAX_ENDS = 17, 8


@dataclass(frozen=True)
class Plane:
    """Part of a scene's parameter space that a map shows: one or two axes, the others with one value.

    Attributes
    ----------
    scene : Scene
        The scene of the atlas.
    extent : mapping of str to (float, float)
        Dimension of the atlas -> lowest and highest value, x first.
    fixed : mapping of str to float
        Dimension -> value, for all others.
    """

    scene: Scene
    extent: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]

    @staticmethod
    def of(scene: Scene, ds: xr.Dataset, dims: Iterable[str]) -> Plane:
        """The plane of some dimensions of an atlas whose other axes have one value each.

        Raises BadInput for another axis with several values.
        """
        extent = {dim: (float(ds[dim].min()), float(ds[dim].max())) for dim in dims}
        fixed = {}
        for dim in axes_of(scene):
            if dim not in extent:
                if dim not in ds.coords or ds[dim].size != 1:
                    raise BadInput(f"{dim}: this axis of the scene has no single value here; select one")
                fixed[dim] = float(ds[dim].item())
        return Plane(scene, extent, fixed)

    def samples(self, dim: str) -> Array:
        """SAMPLES values evenly spaced along an axis, on a logarithmic axis in their logarithm."""
        return (np.geomspace if is_logarithmic(self.scene, dim) else np.linspace)(*self.extent[dim], SAMPLES)

    def points(self, coordinates: Mapping[str, Array]) -> grid.Grid:
        """The points of the scene at some coordinates in the plane: dimension -> values of one shape (points,)."""
        shape = next(iter(coordinates.values())).shape
        values = {dim: np.full(shape, value) for dim, value in self.fixed.items()} | dict(coordinates)
        axes = axes_of(self.scene)
        # A duration in turns is undefined where nothing turns, and theory does not need one.
        scene = replace(self.scene, duration=Duration(1.0))
        return grid.points_at(scene, {axes[dim].name: column for dim, column in values.items()})

    def stable(self, coordinates: Mapping[str, Array]) -> Flags:
        """Linear stability from theory at some coordinates in the plane: values of Stability."""
        points = self.points(coordinates)
        predicted = predict(self.scene.system, points.base, self.scene.settings.rate_tolerance, False)
        return np.where(points.exists, predicted["stable"], Stability.UNKNOWN).astype(np.int8)


# Stability boundary. Positions are in units of the sample spacing until the last step.


def stability_boundary(plane: Plane) -> list[np.ndarray]:
    """Lines between linearly stable and unstable motions in a plane, from theory.

    The lines are traced on SAMPLES x SAMPLES points, and each vertex is then bisected to 1e-5 of the
    distance between them.

    Parameters
    ----------
    plane : Plane
        Where to look for the boundary.

    Returns
    -------
    list of ndarray
        Polylines of shape (vertices, axes of the plane), float64, in the units of the axes.
    """
    n_axes = len(plane.extent)
    nodes = np.stack(np.meshgrid(*[np.arange(SAMPLES, dtype=float)] * n_axes, indexing="ij"), -1)
    stable = _stable_at(plane, nodes.reshape(-1, n_axes)).reshape(nodes.shape[:-1])
    lines = _trace(stable)
    if not lines:
        return []
    vertices = _values_at(plane, _bisect(plane, np.concatenate(lines)))
    return np.split(vertices, np.cumsum([len(line) for line in lines])[:-1])


def _values_at(plane: Plane, positions: Array) -> Array:
    """Axis values at positions (points, axes), which count samples."""
    columns = [
        np.interp(positions[:, i], np.arange(SAMPLES), plane.samples(dim))
        for i, dim in enumerate(plane.extent)
    ]
    return np.stack(columns, -1)


def _stable_at(plane: Plane, positions: Array) -> Flags:
    """Linear stability at positions (points, axes), which count samples."""
    return plane.stable(dict(zip(plane.extent, _values_at(plane, positions).T, strict=True)))


def _trace(stable: Flags) -> list[Array]:
    """Lines halfway between stable and unstable samples, as positions (vertices, axes)."""
    if stable.ndim == 1:
        known = (stable[1:] > Stability.UNKNOWN) & (stable[:-1] > Stability.UNKNOWN)
        changes = np.flatnonzero((stable[1:] != stable[:-1]) & known)
        return [np.array([[index + 0.5]]) for index in changes]
    masked = np.ma.masked_equal(stable.T, Stability.UNKNOWN)
    generator = contourpy.contour_generator(z=masked, corner_mask=False, line_type="Separate")
    lines = cast("list[Array]", generator.lines(0.5 * (Stability.STABLE + Stability.UNSTABLE)))
    # A ring of four vertices contains a single sample: the tip of a cusp, cut off by the sampling.
    return [line for line in lines if len(line) > 5]


def _bisect(plane: Plane, vertices: Array) -> Array:
    """Vertices halfway between two samples, moved along the edge between them to the change of stability."""
    low, high = np.floor(vertices), np.ceil(vertices)
    stable_at_low = _stable_at(plane, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        same = (_stable_at(plane, middle) == stable_at_low)[:, np.newaxis]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)


# Curves of families.


def family_curves(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Where exact steady motions cross a plane.

    A family has a curve if it can be solved for an axis of the plane: the family of the scene, or every
    one if the scene names none. Where a scene solves its points onto a family only an axis offset from
    the family has a curve: its zero.

    Parameters
    ----------
    plane : Plane
        Where to look for exact motions.

    Returns
    -------
    dict
        Family -> curves of shape (vertices, axes of the plane), float64, in the units of the axes; rows
        of nan cut a curve.
    """
    scene = plane.scene
    if scene.solve:
        lines = _zeros_of_offsets(plane)
        return {str(scene.family): lines} if lines else {}
    curves = {}
    for name in [scene.family] if scene.family is not None else list(scene.system.families):
        family = scene.system.families[name]
        # Whichever axis gives the longer curve: solved for the other one it may be a single point.
        longest = max((_solution_curves(plane, family, dim) for dim in plane.extent), key=_n_vertices)
        if _n_vertices(longest):
            curves[name] = longest
    return curves


def _n_vertices(curves: list[Array]) -> int:
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
