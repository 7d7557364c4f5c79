"""The plane of a map in the parameter space of its scene, and predictions of theory on it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ..errors import BadInput
from ..label.theory import predict
from ..measure.instrument import Tolerances
from ..scene import grid
from ..scene.model import Duration, Scene
from ..systems.base import Array, Mask, derived_values
from .metadata import axes_of, is_logarithmic
from .select import cell_edges

# Even number of samples along an axis. No sample is then in the middle of an extent, where special values such as 0 often are.
SAMPLES = 300
# Rates up to this size, in rad per time unit, count as zero, because they may be rounding errors.
ZERO_RATE = 1e-9
IN_SPACE = " in space"


@dataclass(frozen=True)
class Predictions:
    """Predictions of theory at points of a plane, in arrays of shape (points,)."""

    exists: Mask  # whether the scene has a motion at the point
    stable: np.ndarray  # linear stability, values of Stability
    # Frame ("" or IN_SPACE) -> values of Label for exact motions, and the rates psi' (key "n") and phi' (key "m") in rad per time unit.
    frames: Mapping[str, tuple[np.ndarray, Mapping[str, Array]]]


@dataclass(frozen=True)
class Plane:
    """Part of the parameter space of a scene that a map shows, over one or two axes. Every other axis has one value."""

    scene: Scene  # the scene of the atlas
    extent: Mapping[str, tuple[float, float]]  # lowest and highest value along each dimension, x first
    fixed: Mapping[str, float]  # value along every other dimension

    @staticmethod
    def of(scene: Scene, ds: xr.Dataset, dims: Iterable[str]) -> Plane:
        """Return the plane of the given dimensions of an atlas. Raise BadInput if another axis has several values.

        The plane reaches half a cell beyond the outermost points, except on a side where a parameter would be out of range.
        """
        # NumPy's min and max are used, because xarray's would import dask.
        extent = {dim: (float(ds[dim].values.min()), float(ds[dim].values.max())) for dim in dims}
        fixed = {}
        for dim in axes_of(scene):
            if dim not in extent:
                if dim not in ds.coords or ds[dim].size != 1:
                    raise BadInput(f"{dim}: this axis of the scene has no single value here; select one")
                fixed[dim] = float(ds[dim].item())
        plane = Plane(scene, extent, fixed)
        for dim in extent:
            values = np.unique(ds[dim].values)
            edges = cell_edges(values, is_logarithmic(scene, dim, values))
            plane = plane._extend(dim, float(edges[0]), float(edges[-1]))
        return plane

    def _extend(self, dim: str, low: float, high: float) -> Plane:
        """Return the plane with wider limits along an axis. A limit at which a parameter is out of range is not used."""
        parameter = self.scene.system.parameters.get(dim)
        plane = self
        for side, value in enumerate((low, high)):
            if parameter is not None and not parameter.low <= value <= parameter.high:
                continue
            limits = list(plane.extent[dim])
            limits[side] = value
            wider = replace(plane, extent={**plane.extent, dim: (limits[0], limits[1])})
            border = {d: self.samples(d) for d in self.extent} | {dim: np.full(SAMPLES, value)}
            try:
                wider.points(border)
            except BadInput:
                continue
            plane = wider
        return plane

    def samples(self, dim: str, count: int = SAMPLES) -> Array:
        """Return evenly spaced values along an axis, (count,). On a logarithmic axis, the logarithms of the values are evenly spaced."""
        spaced = np.geomspace if is_logarithmic(self.scene, dim, self.extent[dim]) else np.linspace
        return spaced(*self.extent[dim], count)

    def coordinates(self, positions: Array) -> dict[str, Array]:
        """Return coordinates by dimension at `positions`, (points, axes). A position is given as fractions of the extents of the axes."""
        values = {}
        for position, (dim, (low, high)) in zip(positions.T, self.extent.items(), strict=True):
            if is_logarithmic(self.scene, dim, (low, high)):
                values[dim] = low * (high / low) ** position
            else:
                values[dim] = low + (high - low) * position
        return values

    def lattice(self, count: int) -> tuple[list[Array], dict[str, Array]]:
        """Return the samples along each axis, and the coordinates of all points of the lattice as arrays (points,) by dimension."""
        axes = [self.samples(dim, count) for dim in self.extent]
        grids = np.meshgrid(*axes, indexing="ij")
        return axes, dict(zip(self.extent, (grid.ravel() for grid in grids), strict=True))

    def positions(self, dim: str, values: Array) -> Array:
        """Return the positions of values along an axis, as fractions of the extent of the axis."""
        scale = np.log if is_logarithmic(self.scene, dim, self.extent[dim]) else np.asarray
        low, high = scale(self.extent[dim])
        return (scale(values) - low) / (high - low)

    def points(self, coordinates: Mapping[str, Array]) -> grid.Grid:
        """Return the points of the scene at `coordinates` in the plane. `coordinates` maps dimensions to arrays (points,)."""
        shape = next(iter(coordinates.values())).shape
        values = {dim: np.full(shape, value) for dim, value in self.fixed.items()} | dict(coordinates)
        axes = axes_of(self.scene)
        # Theory needs no duration, and a duration in turns is undefined where nothing turns.
        scene = replace(self.scene, duration=Duration(1.0))
        return grid.points_at(scene, {axes[dim].name: column for dim, column in values.items()})

    def theory(self, coordinates: Mapping[str, Array]) -> Predictions:
        """Return the predictions for exact motions at points of the plane. Where no motion exists, only `exists` has a meaning."""
        system, points = self.scene.system, self.points(coordinates)
        with np.errstate(all="ignore"):
            predicted = predict(system, points.base, Tolerances(ZERO_RATE, ZERO_RATE), rough=True)
            _, n, m = system.steady_rates(points.base)
        frames = {"": (predicted["predicted"], {"n": n, "m": m})}
        if system.frame_rate is not None:
            in_space = {"n": n + system.frame_rate(points.base), "m": m}
            frames[IN_SPACE] = predicted["predicted_inertial"], in_space
        return Predictions(points.exists, predicted["stable"], frames)

    def derived(self, coordinates: Mapping[str, Array], names: Collection[str]) -> dict[str, NDArray[Any]]:
        """Return variables from theory at points of the plane, by their names."""
        points = self.points(coordinates)
        return derived_values(self.scene.system, names, points.base, points.duration, lambda: None)
