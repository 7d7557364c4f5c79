"""Which part of an atlas a page shows: its axes, and every k-th value of those that are too long."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ..analysis.metadata import check_not_empty, is_logarithmic, is_numeric_axis, scene_of
from ..errors import BadInput
from ..plotting import text
from ..plotting.scatter import scatter_axes
from ..scene.model import Scene
from ..variables import POINT

MAX_POINTS = 120_000
# Bytes of numbers before compression: about as many in the page, because base64 loses what compression gains.
MAX_BYTES = 12_000_000


@dataclass(frozen=True)
class Layout:
    """Axes and points of a page."""

    whole: xr.Dataset  # the atlas
    ds: xr.Dataset  # the points that are shown, in memory, sorted along their axes
    scene: Scene | None  # scene of the atlas
    dims: list[str]  # dimensions of the points, in the order of the atlas
    axes: list[str]  # one or two axes of the map, x first, or two coordinates of single points
    further: list[str]  # the other dimensions
    points: bool  # whether these are single points without axes
    notes: list[str]  # sentences about what is left out

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the points."""
        return tuple(self.ds.sizes[dim] for dim in self.dims)

    def is_log(self, dim: str) -> bool:
        """Whether an axis is spaced evenly in its logarithm."""
        return is_logarithmic(self.scene, dim, self.ds[dim].values)

    def slices(self) -> Iterator[tuple[tuple[int, ...], xr.Dataset]]:
        """Each map: its indices along the further axes, and the part of the atlas that it shows."""
        for index in np.ndindex(*(self.ds.sizes[dim] for dim in self.further)):
            yield index, self.ds.isel(dict(zip(self.further, index, strict=True)))

    def points_of_slice(self, index: tuple[int, ...]) -> tuple[int | slice, ...]:
        """Index of the points of one map in an array over all points; index: along the further axes."""
        along = dict(zip(self.further, index, strict=True))
        return tuple(along.get(dim, slice(None)) for dim in self.dims)


def layout(ds: xr.Dataset, max_points: int = MAX_POINTS) -> Layout:
    """What a page shows of an atlas.

    ds: an atlas; max_points: of the longest axis every k-th value is shown until there are no more points
    than this. Raises BadInput for a dataset without points, and with a dimension that is no axis.
    """
    check_not_empty(ds)
    scene = scene_of(ds)
    single = POINT in ds.dims
    dims = (
        [POINT] if single else [str(dim) for dim in ds.dims if ds.sizes[dim] > 1 and is_numeric_axis(ds, dim)]
    )
    ds = ds.isel({dim: 0 for dim in ds.dims if ds.sizes[dim] == 1 and str(dim) not in dims})
    if not dims or set(map(str, ds.dims)) - set(dims):
        raise BadInput("page: this dataset has no axes to draw a map over")
    size = {dim: ds.sizes[dim] for dim in dims}
    stride = dict.fromkeys(dims, 1)
    while np.prod([-(-size[dim] // stride[dim]) for dim in dims]) > max_points:
        longest = max(dims, key=lambda dim: -(-size[dim] // stride[dim]))
        stride[longest] += 1
    shown = ds.isel({dim: slice(None, None, stride[dim]) for dim in dims})
    if not single:
        shown = shown.sortby(dims)
    shown = shown.load()
    axes = scatter_axes(shown, None, None) if single else _longest(shown, dims)
    further = [] if single else [dim for dim in dims if dim not in axes]
    return Layout(ds, shown, scene, dims, axes, further, single, _stride_notes(ds, size, stride))


def _longest(ds: xr.Dataset, dims: list[str]) -> list[str]:
    """The two longest axes, in the order of the atlas."""
    longest = sorted(dims, key=lambda dim: -ds.sizes[dim])[:2]
    return [dim for dim in dims if dim in longest]


def _stride_notes(ds: xr.Dataset, size: dict[str, int], stride: dict[str, int]) -> list[str]:
    """A sentence about the points that are left out."""
    left_out = {dim: k for dim, k in stride.items() if k > 1}
    if not left_out:
        return []
    shown = int(np.prod([-(-size[dim] // stride[dim]) for dim in size]))
    total = int(np.prod(list(size.values())))
    which = " and ".join(
        f"{_ordinal(k)} {'point' if dim == POINT else f'value of {text.axis_label(ds, dim, unit=False)}'}"
        for dim, k in left_out.items()
    )
    return [f"This page shows every {which}: {shown} of {total} points."]


def _ordinal(number: int) -> str:
    """2nd, 3rd, 4th, 11th, 22nd."""
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
