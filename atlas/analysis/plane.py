"""The plane of a map in the parameter space of its scene, and what theory predicts on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..label.theory import predict
from ..scene import grid
from ..scene.model import Duration, Scene
from ..systems.base import Array, Mask
from .metadata import axes_of, is_logarithmic
from .select import cell_edges

# Even, so that no sample falls on the middle of an extent, where special values such as 0 often are.
SAMPLES = 300
# Rates of at most this, in rad per time unit, are zero but for rounding.
ZERO_RATE = 1e-9


@dataclass(frozen=True)
class Theory:
    """What theory predicts at some points of a plane; arrays of shape (points,)."""

    exists: Mask  # whether the scene has a motion there
    stable: np.ndarray  # linear stability, values of Stability
    label: np.ndarray  # label of the exact motion, values of Label
    rates: Mapping[str, Array]  # psi' and phi' of the motion by the names "n" and "m", rad per time unit


@dataclass(frozen=True)
class Plane:
    """Part of a scene's parameter space that a map shows: one or two axes, the others with one value."""

    scene: Scene  # the scene of the atlas
    extent: Mapping[str, tuple[float, float]]  # dimension of the atlas -> lowest and highest value, x first
    fixed: Mapping[str, float]  # dimension -> value, for all others

    @staticmethod
    def of(scene: Scene, ds: xr.Dataset, dims: Iterable[str]) -> Plane:
        """The plane of some dimensions of an atlas whose other axes have one value each.

        It reaches to the outer edges of the atlas' cells, half a cell beyond its outermost points, except
        on sides where the scene has no points. Raises BadInput for another axis with several values.
        """
        extent = {dim: (float(ds[dim].min()), float(ds[dim].max())) for dim in dims}
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
            plane = plane._extended(dim, float(edges[0]), float(edges[-1]))
        return plane

    def _extended(self, dim: str, low: float, high: float) -> Plane:
        """The plane with wider limits along an axis, each only if the scene has points at it."""
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
        """Values evenly spaced along an axis, on a logarithmic axis in their logarithm, (count,)."""
        spaced = np.geomspace if is_logarithmic(self.scene, dim, self.extent[dim]) else np.linspace
        return spaced(*self.extent[dim], count)

    def points(self, coordinates: Mapping[str, Array]) -> grid.Grid:
        """The points of the scene at some coordinates in the plane: dimension -> values of one shape (points,)."""
        shape = next(iter(coordinates.values())).shape
        values = {dim: np.full(shape, value) for dim, value in self.fixed.items()} | dict(coordinates)
        axes = axes_of(self.scene)
        # A duration in turns is undefined where nothing turns, and theory does not need one.
        scene = replace(self.scene, duration=Duration(1.0))
        return grid.points_at(scene, {axes[dim].name: column for dim, column in values.items()})

    def theory(self, coordinates: Mapping[str, Array], *, inertial: bool = False) -> Theory:
        """What theory predicts of the exact motions at some coordinates in the plane.

        coordinates: dimension -> values of one shape (points,); inertial: labels and rates in inertial space,
        if the frame of the system turns. Returns also at points without a motion, where only `exists` has a
        meaning.
        """
        system, points = self.scene.system, self.points(coordinates)
        with np.errstate(all="ignore"):
            predicted = predict(system, points.base, ZERO_RATE, False)
            _, n, m = system.steady_rates(points.base)
        label = predicted["predicted"]
        if inertial and system.frame_rate is not None:
            label, n = predicted["predicted_inertial"], n + system.frame_rate(points.base)
        return Theory(points.exists, predicted["stable"], label, {"n": n, "m": m})
