"""What the panels of a map show: values, why some are missing, and what theory adds."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt

from ..analysis.boundary import CHANGE, EXISTENCE, RESONANCES, STABILITY, theory_lines
from ..analysis.compare import MAX_SURVIVED_GROWTH
from ..analysis.metadata import axes_of, flag_names, is_averaged
from ..analysis.plane import Plane, family_curves
from ..errors import BadInput, attribute_text
from ..flags import Label, Stability
from ..scene.model import Scene
from ..systems.base import Mask

# Why a cell of a map is white.
NO_BODY, NO_MOTION, NOT_YET, NO_VALUE = "no such body", "no such motion", "not computed yet", "no value"
SLOW = "unstable, too slow to show in this run"
# A region with a smaller share of the points is not visible.
MIN_VISIBLE = 1e-3
# Flags of motions, on whose maps theory draws the borders of labels.
MOTIONS = ("label", "predicted", "agreement", "geometry")

Lines = Mapping[str, list[np.ndarray]]


@dataclass(frozen=True)
class Panel:
    """Content of one panel."""

    array: xr.DataArray  # values over one axis, or over two with x last
    white: Mapping[str, Mask]  # why there is no value -> the cells, bool of the shape of the array
    slow: Mask  # cells of unstable motions that had no time to drift, bool of the shape of the array
    borders: Lines = field(default_factory=dict)  # kind of border, family -> lines
    families: Lines = field(default_factory=dict)  # kind of border, family -> lines


def panel_of(ds: xr.Dataset, name: str, dims: list[str], scene: Scene | None, boundary: bool) -> Panel:
    """Content of a panel over one or two axes (x first), in memory."""
    order = dims[::-1]
    needed = [
        n
        for n in _NEEDED
        if n in ds and set(ds[n].dims) == set(dims) and not is_averaged(ds[n]) and ds[n].dtype != bool
    ]
    ds = ds[[*needed, name]].transpose(*order).load()
    white = _white(ds, name, dims, scene)
    array = _without_gaps(ds, name)
    nothing = np.zeros(array.shape, bool)
    if not boundary or scene is None:
        return Panel(array, white, nothing)
    slow = _slow(ds) if scene.nudge and name.removesuffix("_inertial") in MOTIONS else nothing
    if not set(dims) <= set(axes_of(scene)):
        return Panel(array, white, slow)
    try:
        borders = theory_lines(scene, ds, dims, name)
        families = family_curves(Plane.of(scene, ds, dims))
    except BadInput as error:
        # Between the points of an atlas there may be bodies that cannot exist; the map itself needs none of them.
        logging.getLogger("atlas").warning("no theory on this map: %s", error)
        return Panel(array, white, slow)
    if CHANGE in borders:
        return Panel(array, white, slow, borders)
    if name.removesuffix("_inertial") not in MOTIONS:
        shown = (STABILITY, EXISTENCE, *RESONANCES)
        borders = {kind: borders[kind] for kind in shown if kind in borders}
    return Panel(array, white, slow, borders, families)


_NEEDED = ("label", "status", "stable", "growth_rate", "end_time", "computed")


def _white(ds: xr.Dataset, name: str, dims: list[str], scene: Scene | None) -> dict[str, Mask]:
    """Cells without a value, by the reason."""
    array = ds[name]
    flags = flag_names(array)
    if flags:
        if (
            array.dtype == bool
            or name in ("status", "computed")
            or ("not_computed" not in flags and "label" not in ds)
        ):
            return {}  # the flags of these variables state the reason
        source = array if "not_computed" in flags else ds["label"]
        missing = source.values == Label.NOT_COMPUTED
    else:
        missing = ~np.isfinite(array.values)
    if "computed" in ds:
        missing &= ds["computed"].values == 1  # elsewhere the value of the nearest point is drawn
    reasons = np.full(array.shape, "", object)
    not_computed = missing & (ds["label"].values == Label.NOT_COMPUTED if "label" in ds else bool(flags))
    reasons[missing] = NO_VALUE
    reasons[not_computed] = NO_MOTION
    if "status" in ds:
        names = flag_names(ds["status"])
        impossible = names.index("impossible_body") if "impossible_body" in names else -1
        reasons[missing & (ds["status"].values == impossible)] = NO_BODY
    if is_unfinished(ds) and scene is not None and set(dims) <= set(axes_of(scene)):
        reasons[_has_motion(ds, dims, scene, reasons == NO_MOTION)] = NOT_YET
    return {
        reason: reasons == reason
        for reason in (NO_BODY, NO_MOTION, NOT_YET, NO_VALUE)
        if (reasons == reason).any()
    }


def is_unfinished(ds: xr.Dataset) -> bool:
    """Whether tiles of the atlas are still missing, by the attribute atlas_run."""
    return tiles_done(ds) is not None


def tiles_done(ds: xr.Dataset) -> tuple[int, int] | None:
    """Tiles written and tiles of the whole run of an unfinished atlas; None for a finished one."""
    match = re.match(r"(\d+) of (\d+) tiles", attribute_text(ds.attrs, "atlas_run"))
    if match is None or int(match[1]) >= int(match[2]):
        return None
    return int(match[1]), int(match[2])


def _has_motion(ds: xr.Dataset, dims: list[str], scene: Scene, where: Mask) -> Mask:
    """Those of the marked cells at which the scene has a motion, so that only its tile is missing."""
    result = np.zeros(where.shape, bool)
    if where.any():
        grids = np.broadcast_arrays(*np.meshgrid(*[ds[dim].values for dim in dims[::-1]], indexing="ij"))
        columns = {dim: grid[where] for dim, grid in zip(dims[::-1], grids, strict=True)}
        try:
            result[where] = Plane.of(scene, ds, dims).points(columns).exists
        except BadInput:
            result[where] = True
    return result


def _without_gaps(ds: xr.Dataset, name: str) -> xr.DataArray:
    """Values of the variable; where a refined atlas did not integrate, of the nearest integrated point."""
    array = ds[name]
    if flag_names(array) or "computed" not in ds:
        return array
    gaps = ~np.isfinite(array.values) & (ds["computed"].values == 0)
    if not gaps.any() or gaps.all():
        return array
    nearest = distance_transform_edt(gaps, return_distances=False, return_indices=True)
    return array.copy(data=array.values[tuple(nearest)])


def _slow(ds: xr.Dataset) -> Mask:
    """Cells of nudged motions that are unstable by theory and stayed steady: the run ended before the nudge grew."""
    shape = next(iter(ds.values())).shape
    if not {"label", "stable", "growth_rate", "end_time"} <= set(ds):
        return np.zeros(shape, bool)
    label = ds["label"].values
    steady = (label == Label.REGULAR_PRECESSION) | (label == Label.PERMANENT_ROTATION)
    grown = ds["growth_rate"].values * ds["end_time"].values >= MAX_SURVIVED_GROWTH
    return steady & (ds["stable"].values == Stability.UNSTABLE) & ~grown


def visible(mask: Mask) -> bool:
    """Whether a region is large enough to be visible on a map."""
    return bool(mask.mean() >= MIN_VISIBLE)
