"""Content of maps, which consists of values, reasons for missing values, and lines of theory."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import contourpy
import numpy as np
import xarray as xr
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from ..analysis.boundary import KINDS, RESONANCES, theory_lines
from ..analysis.compare import MAX_SURVIVED_GROWTH
from ..analysis.degrees import in_degrees, lines_in_degrees
from ..analysis.exact_curves import family_curves
from ..analysis.metadata import axes_of, flag_names, is_averaged, system_of, without_run
from ..analysis.plane import Plane
from ..errors import BadInput, attribute_text
from ..flags import Label, Stability
from ..scene.model import Scene
from ..systems.base import Mask
from ..variables import is_theory, proofs_of_labels

# Reasons why a cell of a map is white.
NO_BODY, NO_MOTION, NOT_YET, NO_VALUE = "no such body", "no such motion", "not computed yet", "no value"
NO_THEORY = "theory says nothing"
BY_PROOF, PROVED = "proved, not integrated", "edge of what is proved for every duration"
SLOW = "too slow to show"
# A region with less than this fraction of the points is not visible.
MIN_VISIBLE = 1e-3
# Smallest visible width of hatching, and smallest distance of a visible line from the frame, as a fraction of the frame's side.
MIN_HATCHED = 0.01
INSIDE = Bbox([[MIN_HATCHED] * 2, [1 - MIN_HATCHED] * 2])
# Lines with a `crowding` above CROWDED have no halo. Lines are sampled at a spacing SAMPLING. A line that meets a cell again after
# more than the length RETURN counts as crossing the cell twice. The unit of SAMPLING and RETURN is the side of a cell.
CROWDED, SAMPLING, RETURN = 0.2, 0.25, 2.0
# Maps of these flag variables show the predicted borders between labels.
MOTIONS = ("label", "predicted", "agreement", "geometry")

Lines = Mapping[str, list[np.ndarray]]


@dataclass(frozen=True)
class Panel:
    """Content of one panel."""

    array: xr.DataArray  # values over one axis, or over two axes with x last
    white: Mapping[str, Mask]  # reason for a missing value -> mask of the cells, in the shape of the array
    slow: Mask  # mask of the cells with unstable motions that had no time to drift
    borders: Lines = field(default_factory=dict)  # kind of border -> lines
    families: Lines = field(default_factory=dict)  # family -> lines
    crowded: Collection[str] = ()  # kinds of borders whose lines are often less than a cell apart

    def in_degrees(self, degrees: bool | None) -> Panel:
        """Return the panel with angles in the unit to be shown. For `degrees` see `analysis.degrees.factor`."""
        axes = [self.array[dim] for dim in self.array.dims[::-1]]
        borders, families = (lines_in_degrees(each, axes, degrees) for each in (self.borders, self.families))
        return replace(self, array=in_degrees(self.array, degrees), borders=borders, families=families)


def visible(panel: Panel, edges: list[np.ndarray]) -> Panel:
    """Return the panel with `crowded` set. Remove hatching too small to be seen, and each kind of line that stays near the frame."""
    slow, box = panel.slow, [math.ceil(MIN_HATCHED * count) for count in panel.slow.shape]
    is_visible = slow.mean() >= MIN_VISIBLE
    if is_visible:
        from scipy.ndimage import binary_erosion  # slow to import, and most maps do not need it

        is_visible = binary_erosion(slow, np.ones(box)).any()

    def is_inside(line: np.ndarray) -> bool:
        """Whether a line enters INSIDE, the map without a narrow rim. On a map with one axis, a line is a value of this axis."""
        places = [np.interp(v, e, np.linspace(0, 1, e.size)) for v, e in zip(line.T, edges, strict=True)]
        path = Path(np.transpose(places if len(places) == 2 else [places[0].repeat(2), [0, 1]]))
        return path.intersects_bbox(INSIDE, filled=False)

    borders, families = (
        {kind: lines for kind, lines in group.items() if any(map(is_inside, lines))}
        for group in (panel.borders, panel.families)
    )
    crowded = [kind for kind, lines in borders.items() if kind in KINDS and crowding(lines, edges) > CROWDED]
    return replace(panel, slow=slow & is_visible, borders=borders, families=families, crowded=crowded)


def crowding(lines: list[np.ndarray], edges: list[np.ndarray]) -> float:
    """Return which fraction of the cells that lines cross is crossed twice. The two sides of a region narrower than a cell do this."""
    if len(edges) == 1:
        return 0.0
    samples, start = [], 0.0
    for line in lines:
        places = [np.interp(v, e, np.arange(e.size)) for v, e in zip(line.T, edges, strict=True)]
        along = start + np.cumsum(np.hypot(*np.diff(places, axis=1, prepend=np.array(places)[:, :1])))
        even = np.arange(along[0], along[-1], SAMPLING)
        samples.append([even, *(np.floor(np.interp(even, along, place)) for place in places)])
        start = along[-1] + 2 * RETURN
    along, *cell = np.concatenate(samples, axis=1)
    order = np.lexsort([along, *cell])
    same = (np.diff(np.array(cell)[:, order]) == 0).all(0)
    returns = np.r_[False, same & (np.diff(along[order]) > RETURN)]
    first = np.cumsum(~np.r_[False, same])[returns]  # numbers of the cells to which lines return
    return float(np.unique(first).size / (1 + (~same).sum()))


def panel_of(ds: xr.Dataset, name: str, dims: list[str], scene: Scene | None, boundary: bool) -> Panel:
    """Return the content of a panel over one or two axes (x first), loaded into memory."""
    names = [
        n
        for n in (
            "label",
            "status",
            "stable",
            "growth_rate",
            "end_time",
            "computed",
            *proofs_of_labels().values(),
        )
        if n in ds and set(ds[n].dims) == set(dims) and not is_averaged(ds[n]) and ds[n].dtype != bool
    ]
    ds = ds[[*names, name]].transpose(*dims[::-1]).load()
    white = _white(ds, name, dims, scene)
    array, slow = ds[name], np.zeros(ds[name].shape, bool)
    if "computed" in ds and not flag_names(array):
        # Where a refined atlas has no run, the value of the nearest integrated point is drawn.
        gaps = ~np.isfinite(array.values) & (ds["computed"].values == 0)
        if gaps.any() and not gaps.all():
            from scipy.ndimage import distance_transform_edt  # slow to import, and most maps do not need it

            nearest = distance_transform_edt(gaps, return_distances=False, return_indices=True)
            array = array.copy(data=array.values[tuple(nearest)])
    if not boundary or scene is None:
        return Panel(array, white, slow)
    of_motions = name.removesuffix("_inertial") in MOTIONS
    of_runs = of_motions and not name.startswith("predicted")
    if scene.nudge and of_runs and {"label", "stable", "growth_rate", "end_time"} <= set(ds):
        # `slow` marks motions that are unstable by theory but stayed steady, because the run ended before the nudge grew.
        label = ds["label"].values
        steady = (label == Label.REGULAR_PRECESSION) | (label == Label.PERMANENT_ROTATION)
        grown = ds["growth_rate"].values * ds["end_time"].values >= MAX_SURVIVED_GROWTH
        slow = steady & (ds["stable"].values == Stability.UNSTABLE) & ~grown
    # Theory is drawn only on maps over axes of the scene, and not on maps of values that are averaged over an axis.
    if not set(dims) <= axes_of(scene).keys() <= ds.coords.keys():
        return Panel(array, white, slow)
    try:
        borders = theory_lines(scene, ds, dims, name)
        families = family_curves(Plane.of(scene, ds, dims))
    except BadInput as error:
        # Between the points of an atlas there may be impossible bodies, for which theory raises BadInput.
        logging.getLogger("atlas").warning("no theory on this map: %s", error)
        return Panel(array, white, slow)
    if borders and borders.keys().isdisjoint(
        (*KINDS, *RESONANCES)
    ):  # the lines belong to properties of bodies, such as the number of equilibria
        return Panel(array, white, slow, borders)
    if not of_motions:
        borders = {
            kind: lines for kind, lines in borders.items() if kind not in KINDS or not KINDS[kind].of_frame
        }
    return Panel(array, white, slow, {**borders, **_outline(ds, name, dims)}, families)


def _outline(ds: xr.Dataset, name: str, dims: list[str]) -> Lines:
    """Return the edge of the region in which labels are proved, for a map over two axes."""
    label = name.replace("predicted", "label").replace("agreement", "label")
    proof = proofs_of_labels().get(label)
    if proof not in ds or len(dims) != 2:
        return {}
    inside = (ds[proof].values != 0).astype(float)
    generator = contourpy.contour_generator(
        ds[dims[0]].values, ds[dims[1]].values, inside, line_type="Separate"
    )
    return {PROVED: [np.asarray(line) for line in generator.lines(0.5)]} if 0 < inside.mean() < 1 else {}


def _white(ds: xr.Dataset, name: str, dims: list[str], scene: Scene | None) -> dict[str, Mask]:
    """Return the reasons why cells are white, with a mask of the cells for each reason."""
    array = ds[name]
    flags = flag_names(array)
    if flags:
        without_reason = "not_computed" not in flags and "label" not in ds
        if array.dtype == bool or name in ("status", "computed") or without_reason:
            return {}  # flags of these variables tell why a cell has no result
        source = array if "not_computed" in flags else ds["label"]
        missing = source.values == Label.NOT_COMPUTED
    else:
        missing = ~np.isfinite(array.values)
    if "computed" in ds:
        missing &= ds["computed"].values == 1  # a cell without a run shows the nearest integrated point
    reasons = np.full(array.shape, "", object)
    run = next((each for each in ("label", "status") if each in ds), None)  # flag 0 of `run` is no motion
    not_computed = missing & (ds[run].values == Label.NOT_COMPUTED if run else bool(flags))
    reasons[missing] = NO_THEORY if is_theory(system_of(ds), name) else NO_VALUE
    reasons[not_computed] = NO_MOTION
    if (proved := without_run(ds)) is not None:
        reasons[missing & proved.transpose(*array.dims).values] = BY_PROOF
    if "status" in ds:
        names = flag_names(ds["status"])
        impossible = names.index("impossible_body") if "impossible_body" in names else -1
        reasons[missing & (ds["status"].values == impossible)] = NO_BODY
    without_motion = reasons == NO_MOTION
    if (
        tiles_done(ds) is not None
        and scene is not None
        and set(dims) <= set(axes_of(scene))
        and without_motion.any()
    ):
        # If the scene has a motion at a white cell, the cell belongs to a tile that is not computed yet.
        grids = np.broadcast_arrays(*np.meshgrid(*[ds[dim].values for dim in dims[::-1]], indexing="ij"))
        columns = {dim: grid[without_motion] for dim, grid in zip(dims[::-1], grids, strict=True)}
        try:
            exists = Plane.of(scene, ds, dims).points(columns).exists
            reasons[without_motion] = np.where(exists, NOT_YET, NO_MOTION)
        except BadInput:
            reasons[without_motion] = NOT_YET
    return {
        reason: reasons == reason
        for reason in (NO_BODY, NO_MOTION, NOT_YET, BY_PROOF, NO_THEORY, NO_VALUE)
        if (reasons == reason).any()
    }


def tiles_done(ds: xr.Dataset) -> tuple[int, int] | None:
    """Return the numbers of finished tiles and of all tiles of an unfinished atlas, or None for a finished atlas."""
    match = re.match(r"(\d+) of (\d+) tiles", attribute_text(ds.attrs, "atlas_run"))
    if match is None or int(match[1]) >= int(match[2]):
        return None
    return int(match[1]), int(match[2])


def remarks(ds: xr.Dataset, *, filled: bool) -> list[str]:
    """Return sentences to print below a map. They tell of gaps filled with the nearest values and of an unfinished run."""
    tiles = tiles_done(ds)
    sentences = []
    if filled and "computed" in ds:
        sentences.append("Between the points that were integrated: the value of the nearest one.")
    if tiles is not None:
        sentences.append(f"Unfinished: {tiles[0]} of {tiles[1]} tiles are computed.")
    return sentences
