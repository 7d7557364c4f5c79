"""`ds.atlas`: questions to an atlas. Importing this module registers the accessor with xarray.

Atlases are read in blocks of about BLOCK points, so that one larger than memory can be asked: files
opened lazily, dask-chunked datasets and datasets in memory alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from scipy.special import betaincinv

from .errors import BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHUNK = 4_000_000
# Shorter axes are taken as so many separate maps: their cells say nothing about resolution.
MIN_VALUES = 5


@xr.register_dataset_accessor("atlas")
class Atlas:
    """Questions to a dataset made by `atlas.run`, `atlas.open_atlas` or `atlas.label_points`."""

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def map(self, variable: str | None = None, **options: Any) -> Figure:
        """Figure of one variable over two axes; options as in `maps.atlas_map`."""
        from .plotting.maps import atlas_map

        return atlas_map(self._ds, variable, **options)

    def select(self, **flags: str | Sequence[str]) -> xr.Dataset:
        """The points with the flags named, in memory, along the dimension "point".

        flags: flag variable -> a name or several, such as label="drifting", agreement=["theory_only",
        "differ"]; of several variables all must hold. Axes and parameters become coordinates along
        "point"; the order is that of the atlas. Raises BadInput for names that are not in the atlas.
        """
        wanted = {name: _values(self._ds, name, names) for name, names in flags.items()}
        if not wanted:
            raise BadInput("select: name at least one flag, such as label='drifting'")
        dims = [str(d) for d in self._ds[next(iter(wanted))].dims]
        parts: list[xr.Dataset] = []
        for place in _chunks(self._ds, dims):
            block = self._ds.isel(place)
            keep = np.ones([block.sizes[d] for d in dims], bool)
            for name, values in wanted.items():
                keep &= np.isin(block[name].transpose(*dims).values, values)
            if keep.any() or not parts:  # the first even if empty: it carries names and types
                found = zip(dims, np.nonzero(keep), strict=True)
                parts.append(block.isel({d: xr.DataArray(i, dims="point") for d, i in found}).load())
        return xr.concat(
            parts, "point", data_vars="minimal", coords="minimal", compat="override", combine_attrs="override"
        )

    def nearest(self, **coords: float) -> xr.Dataset:
        """The point nearest to values of some axes (or, among single points, of any parameters).

        Among single points distances are counted in the spread of each parameter. Raises BadInput for
        names that are not there and for values outside the axes.
        """
        from .analysis.select import nearest

        if "point" not in self._ds.dims or not coords:
            return nearest(self._ds, coords)
        distance = np.zeros(self._ds.sizes["point"])
        for name, value in coords.items():
            if name not in self._ds.coords or self._ds[name].dims != ("point",):
                known = [str(n) for n, c in self._ds.coords.items() if c.dims == ("point",)]
                raise BadInput(
                    f"{name}: does not vary over these points; allowed: {', '.join(known) or 'none'}"
                )
            values = self._ds[name].values
            distance += ((values - value) / (np.ptp(values) or 1.0)) ** 2
        return self._ds.isel(point=int(distance.argmin()))

    def fractions(self, variable: str = "label", along: str | None = None) -> xr.DataArray:
        """Share of the points with each flag of a variable, over all or along one axis.

        Returns float64 with the dimension named like the variable, whose coordinate holds the names of
        the flags, after the dimension `along` if that is given. The shares of a row sum to 1.
        """
        names = _names(self._ds, variable)
        array = self._ds[variable]
        dims = [str(d) for d in array.dims]
        if along is not None and along not in dims:
            raise BadInput(f"along = {along!r}: not an axis of this atlas; allowed: {', '.join(dims)}")
        rows = self._ds.sizes[along] if along is not None else 1
        counts = np.zeros((rows, len(names)), np.int64)
        for place in _chunks(self._ds, dims):
            values = array.isel(place).values
            table = np.moveaxis(values, dims.index(along), 0) if along is not None else values[np.newaxis]
            part = place.get(along, slice(None)) if along is not None else slice(None)
            for flag in range(len(names)):
                counts[part, flag] += (table == flag).reshape(len(table), -1).sum(1)
        shares = xr.DataArray(
            counts / counts.sum(1, keepdims=True),
            dims=(along or "every", variable),
            coords={variable: names} | ({along: self._ds[along]} if along in self._ds.coords else {}),
            name="fraction",
            attrs={"long_name": f"share of the points by {variable}", "units": "1"},
        )
        return shares if along is not None else shares.isel(every=0)

    def boundary(
        self,
        label: str,
        variable: str = "label",
        *,
        x: str | None = None,
        y: str | None = None,
        select: dict[str, float] | None = None,
    ) -> list[np.ndarray]:
        """Border of the region where a variable has one flag, on the plane of two axes.

        x, y, select as in `maps.atlas_map`. Returns polylines of shape (vertices, 2), float64: x and y
        in the units of the axes, halfway between points in and out of the region; a line ends at the
        edge of the atlas or closes. Of axes longer than `maps.MOST_CELLS` every k-th value counts.
        """
        import contourpy

        from .analysis.select import plane_of

        (flag,) = _values(self._ds, variable, label)
        part, dims, panels = plane_of(self._ds, x, y, select or {})
        if len(dims) != 2 or panels is not None:
            raise BadInput(
                f"boundary: needs two axes, found {', '.join(map(str, part.dims))}; use select for the others"
            )
        inside = (part[variable].transpose(dims[1], dims[0]) == flag).values.astype(float)
        generator = contourpy.contour_generator(
            part[dims[0]].values, part[dims[1]].values, inside, line_type="Separate"
        )
        return [np.asarray(line) for line in generator.lines(0.5)]

    def trajectory(self, *, samples: int = 1001, **coords: float) -> xr.Dataset:
        """Motion of the point nearest to values of the axes, integrated again as the atlas was.

        The start, its nudge, duration, method and step are those of the atlas' own scene; among points
        of one's own they are those of the point. Returns a Dataset over time, see `atlas.trajectory`.
        """
        from .analysis.select import axes_of, scene_of, system_of
        from .label.trajectory import trajectory, trajectory_of_scene

        scene = scene_of(self._ds)
        at = self.nearest(**coords).squeeze()
        if scene is not None:
            axes = axes_of(scene)
            places = {axes[d].name: float(at[d]) for d in axes if d in at.coords and not at[d].ndim}
            return trajectory_of_scene(scene, places, samples=samples)
        if "point" in at.dims:
            raise BadInput("trajectory: name the point by values of its parameters")
        system, attributes = system_of(self._ds), self._ds.attrs
        point = {name: float(at[name]) for name in system.parameters if name in at.coords}
        step = float(attributes["atlas_step"])
        return trajectory(
            system.name,
            {name: value for name, value in point.items() if not np.isnan(value)},
            duration=float(at["end_time"]),
            samples=samples,
            method=attributes["atlas_method"],
            rate_tolerance=float(attributes["atlas_rate_tolerance"]),
            **({"step": step} if np.isfinite(step) else {"tolerance": float(attributes["atlas_tolerance"])}),
        )

    def compare(self, worst: int = 5) -> str:
        """Comparison with theory in plain text, see `atlas compare`; reads label and predicted whole."""
        from .analysis.compare import report

        return report(self._ds, worst)

    def families(
        self, *, x: str | None = None, y: str | None = None, select: dict[str, float] | None = None
    ) -> dict[str, list[np.ndarray]]:
        """Curves of exact steady motions on the plane of one or two axes, from theory.

        x, y, select as in `maps.atlas_map`. Returns family -> curves of shape (vertices, axes), x first;
        rows of nan cut a curve. See `maps.family_curves` for which families show.
        """
        from .analysis.select import plane_of, scene_of
        from .analysis.theory_curves import Plane, family_curves

        scene = scene_of(self._ds)
        if scene is None:
            raise BadInput("families: these points come from no scene, so that there are no axes")
        part, dims, panels = plane_of(self._ds, x, y, select or {})
        if panels is not None:
            raise BadInput(f"{panels} has {part.sizes[panels]} values here: choose one by select")
        return family_curves(Plane.of(scene, part, dims))

    def trust(self, variable: str = "label") -> xr.Dataset:
        """How far a map can be trusted between its points, from the map itself.

        Cells of side s have their corners s points apart. Returned, for the axes of at least
        LEAST_VALUES values (shorter ones count as separate maps):
        - uncertain (stride): share of the cells of side 1, 2, 4, ... whose corners differ. Side 1: the
          share of the map in which a border runs.
        - exponent: least-squares slope of log(uncertain) over log(side), for sides with a share above 0
          (Grebogi, McDonald, Ott & Yorke 1983): 1 for smooth borders, towards 0 for fractal ones, which
          finer grids hardly sharpen; nan with less than two such sides. The dimension of the borders is
          the number of axes less the exponent.
        - missed: share of the cells of side 2 with equal corners that hide another value on the points
          between them, such as an island or a thin tongue.
        - missed_bound: its upper 95 % bound (Clopper & Pearson), cells taken as independent draws. It
          holds for side 2; with an exponent above 0 the map itself, of side 1, misses less.
        """
        _names(self._ds, variable)
        array = self._ds[variable]
        dims = [str(d) for d in array.dims if array.sizes[d] >= MIN_VALUES and d in self._ds.coords]
        if not dims:
            raise BadInput(f"trust: no axis has {MIN_VALUES} values or more")
        array = array.sortby(dims).transpose(..., *dims)
        strides = [1]
        while 4 * strides[-1] < min(array.sizes[d] for d in dims):
            strides.append(2 * strides[-1])
        shares = []
        for stride in strides:
            coarse = array.isel({d: slice(None, None, stride) for d in dims})
            cells, differ = 0, 0
            for place in _chunks(coarse, dims, overlap=1):
                values = coarse.isel(place).values
                low, high = _extremes(values, len(dims), inner=False, step=1)
                cells, differ = cells + low.size, differ + int((low != high).sum())
            shares.append(differ / cells)
        calm, missed = 0, 0
        for place in _chunks(array, dims, overlap=2):
            values = array.isel(place).values
            low, high = _extremes(values, len(dims), inner=False, step=2)
            least, most = _extremes(values, len(dims), inner=True, step=2)
            calm += int((low == high).sum())
            missed += int(((low == high) & (least != most)).sum())
        bound = float(betaincinv(missed + 1, calm - missed, 0.95)) if calm > missed else 1.0
        share = np.array(shares)
        known = share > 0
        slope = np.nan
        if known.sum() > 1:
            slope = np.polyfit(np.log(np.array(strides)[known]), np.log(share[known]), 1)[0]
        return xr.Dataset(
            {
                "uncertain": ("stride", share, {"long_name": "share of cells whose corners differ"}),
                "exponent": ((), slope, {"long_name": "uncertainty exponent"}),
                "missed": ((), missed / calm if calm else np.nan, {"long_name": "share of calm cells that hide a border"}),
                "missed_bound": ((), bound, {"long_name": "upper 95 % bound of missed"}),
            },
            coords={"stride": ("stride", strides, {"long_name": "side of the cells in points"})},
            attrs={"variable": variable, "axes": ", ".join(dims)},
        )  # fmt: skip

    def cite(self) -> str:
        """What a result from this atlas rests on: program, equations, and how it was computed."""
        from .analysis.select import system_of

        system, attributes = system_of(self._ds), self._ds.attrs
        return (
            f"Precession Atlas {attributes['atlas_version']}, kernel {attributes['atlas_kernel_hash']}"
            f" ({attributes['atlas_versions']}; {attributes['atlas_cpu']}, {attributes['atlas_platform']}).\n"
            f"Equations of the {system.title}: {attributes['references']}.\n"
            f"Atlas {attributes['title']!r}: {attributes['history']}."
        )


def _names(ds: xr.Dataset, variable: str) -> list[str]:
    """Names of the flags of a variable, BadInput if it has none."""
    if variable not in ds.data_vars or "flag_meanings" not in ds[variable].attrs:
        flags = [str(name) for name, array in ds.data_vars.items() if "flag_meanings" in array.attrs]
        raise BadInput(
            f"{variable}: not a flag variable of this atlas; allowed: {', '.join(flags) or 'none'}"
        )
    return str(ds[variable].attrs["flag_meanings"]).split()


def _values(ds: xr.Dataset, variable: str, names: str | Sequence[str]) -> list[int]:
    """Values of flags by their names."""
    known = _names(ds, variable)
    listed = [names] if isinstance(names, str) else list(names)
    for name in listed:
        if name not in known:
            raise BadInput(f"{variable} = {name!r}: allowed: {', '.join(known)}")
    return [known.index(name) for name in listed]


def _chunks(
    ds: xr.Dataset | xr.DataArray, dims: Sequence[str], overlap: int = 0
) -> Iterator[dict[str, slice]]:
    """Slices that cut the dims into blocks of about BLOCK points in C order, other dims whole.

    With an overlap each block holds so many of the points of the next, and starts at an even point.
    """
    room, cuts = CHUNK // math.prod(n for d, n in ds.sizes.items() if d not in dims), []
    for dim in reversed(dims):
        size, least = ds.sizes[dim], 2 if overlap else 1
        length = max(least, room // least * least)
        last = max(size - overlap, 1)
        cuts.append([slice(i, i + length + overlap) for i in range(0, last, length)])
        room //= size
    for place in product(*reversed(cuts)):
        yield dict(zip(dims, place, strict=True))


def _extremes(values: np.ndarray, axes: int, *, inner: bool, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value on the corners of cells along the last axes, or on all their points.

    Cells have sides of `step` points (1 or 2) and share their corners with their neighbours.
    """
    low = high = values
    for axis in range(values.ndim - axes, values.ndim):
        count = (values.shape[axis] - 1) // step
        take = [np.arange(count) * step + shift for shift in (range(step + 1) if inner else (0, step))]
        low = np.minimum.reduce([low.take(i, axis) for i in take])
        high = np.maximum.reduce([high.take(i, axis) for i in take])
    return low, high
