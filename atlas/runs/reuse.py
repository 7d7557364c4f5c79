"""Reuse of points of earlier atlases. Values are taken from an atlas only if a new computation would give the same bits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MAX_MESSAGE, BadInput, attribute_text
from ..label.plan import Plan
from ..scene import grid
from ..scene.model import Scene, Settings
from ..scene.read import parse_scene
from ..store import dataset, finished
from ..store.place import located
from ..store.tile import DamagedTile
from ..store.tiling import Tiling
from ..systems.base import Mask, derived_variables
from ..variables import COMPUTED, data_variables, proofs_of_labels
from .backend import open_atlas
from .plan import differences, identity
from .run import RESULT, RunFolder, result_hash

SAMPLE = 2048  # largest number of points of an earlier atlas that are sought in the scene before a run


@dataclass(frozen=True, eq=False)
class Earlier:
    """A finished atlas or an unfinished run whose points are reused."""

    path: Path | str
    scene: Scene
    tiling: Tiling  # the boxes in which the atlas is read
    names: tuple[str, ...]  # names of the variables to read
    # Returns the values in the box with a given number. May raise FileNotFoundError or DamagedTile.
    read: Callable[[int], Mapping[str, np.ndarray]]
    history: str  # title, origin and history of the atlas

    @classmethod
    def of(cls, path: str | Path, scene: Scene) -> Earlier:
        """Open an earlier atlas for a scene. Raise BadInput unless this process would compute the same bits as the atlas."""
        path = located(path)
        ds = open_atlas(path)
        text = ds.attrs.get("atlas_scene")
        if not isinstance(text, str) or not text:
            raise BadInput(
                f"{path}: its points come from no scene; only the atlas of a scene can be extended"
            )
        old = parse_scene(text)
        own, programs, folder = identity(Plan.of(old)), "", None
        if not finished.is_finished(path):
            folder = RunFolder.open(path)
            programs = differences(folder.manifest["identity"], own, "there", "now")
        elif not finished.format_of(path).has_hash(path) or ds.attrs.get(RESULT) != result_hash(text, own):
            programs = "the programs or the processor, or another program wrote the file"
        if programs:
            raise BadInput(f"{path}: `atlas run` of now would not give its bits: different is {programs}")
        _check_scenes(path, old, scene)
        names = (*(name for name in scene.outputs if name in old.outputs), *({COMPUTED.name} & ds.keys()))
        attributes = ("title", "source", "date_created", "atlas_cpu", RESULT)
        history = "; ".join(attribute_text(ds.attrs, name) for name in attributes)
        if dataset.HISTORY in ds.attrs:
            history += f" (of these, {attribute_text(ds.attrs, dataset.HISTORY, limit=MAX_MESSAGE)})"
        if folder is not None:
            tiles = folder.tiles
            return cls(path, old, folder.tiling, names, lambda tile: tiles.read(tile, names)[1], history)
        finished.format_of(path).verify(path)
        tiling = Tiling.of(old.shape, grid.max_points_per_tile())

        def read(tile: int) -> dict[str, np.ndarray]:
            box = ds.isel(dict(zip(dataset.dims(old), tiling.slices(tile), strict=True)))
            return {name: box[name].values for name in names}

        return cls(path, old, tiling, names, read, history)

    def take(
        self, scene: Scene, indices: np.ndarray, points: grid.Grid
    ) -> tuple[Mask, dict[str, np.ndarray]]:
        """Return a mask of the points of a scene that are in this atlas, and the variables at these points."""
        places = _indices_in(self.scene, scene, indices, points)
        registry = data_variables(scene.system)
        columns = {name: np.empty(indices.size, registry[name].dtype) for name in self.names}
        along = np.unravel_index(np.maximum(places, 0), self.scene.shape)
        inner = [index // length for index, length in zip(along, self.tiling.tile, strict=True)]
        tiles = np.ravel_multi_index(inner, self.tiling.counts)
        mask = np.zeros(indices.size, bool)
        for tile in np.unique(tiles[places >= 0]):
            try:
                values = self.read(int(tile))
            except (FileNotFoundError, DamagedTile):
                continue
            here = np.flatnonzero((tiles == tile) & (places >= 0))
            first = [part.start for part in self.tiling.slices(int(tile))]
            inside = tuple(index[here] - start for index, start in zip(along, first, strict=True))
            for name, column in columns.items():
                column[here] = values[name][inside]
            mask[here] = True
        if COMPUTED.name in columns:
            mask &= columns.pop(COMPUTED.name) == 1
        return mask, {name: column[mask] for name, column in columns.items()}


def _check_scenes(path: Path | str, old: Scene, scene: Scene) -> None:
    """Raise BadInput if `old` and `scene` give values of different bits, if `old` lacks variables of `scene`, or if no point is shared."""
    own_facts, facts = (_facts(Plan.of(each)) for each in (old, scene))
    if different := differences(own_facts, facts, f"in {path}", "in the scene"):
        raise BadInput(
            f"{path}: its points have other bits than those of the scene: it differs in {different}"
        )
    if missing := [
        name for name in scene.outputs if name not in {*old.outputs, *derived_variables(scene.system)}
    ]:
        raise BadInput(f"{path}: has no {', '.join(missing)}, for which every point is integrated again")
    some = np.unique(np.linspace(0, old.size - 1, SAMPLE).astype(np.int64))
    if (_indices_in(scene, old, some, grid.points_at_indices(old, some)) < 0).all():
        raise BadInput(
            f"{path}: none of {some.size} points of it, evenly chosen, is a point of the scene, with the same duration,"
            " transient and rate tolerance and equal values of all parameters"
        )


def _facts(plan: Plan) -> dict[str, Any]:
    """Return what determines the bits of every point, apart from parameters, duration, transient and rate tolerance."""
    return {
        "system": plan.system.name,
        **{f.name: getattr(plan.settings, f.name) for f in fields(Settings) if f.name != "rate_tolerance"},
        "cylinder_tolerance": plan.settings.cylinder,
        "kernel": plan.kernel_hash,
        "measured": ", ".join(map(str, plan.instruments)),
        "nudge": "some" if plan.nudged else "none",
        "proved": ", ".join(
            label for label in proofs_of_labels() if plan.settings.prove and label in plan.names
        ),
        "runs": "to the end" if not plan.may_stop_early else "until the label is certain",
    }


def _indices_in(other: Scene, scene: Scene, indices: np.ndarray, points: grid.Grid) -> np.ndarray:
    """Return the flat index in `other` of each point of `scene`, or -1 if `other` has no point with the same bits."""
    along = np.unravel_index(indices, scene.shape)
    values = grid.parameter_values(scene, indices)
    values |= {axis.dim: axis.values[i] for axis, i in zip(scene.axes.values(), along, strict=True)}
    places, inside = [], points.exists.copy()
    for axis in other.axes.values():
        if axis.dim not in values:
            return np.full(indices.size, -1)
        order = np.argsort(axis.values)
        place = order[np.searchsorted(axis.values[order], values[axis.dim]).clip(max=order.size - 1)]
        inside &= axis.values[place] == values[axis.dim]
        places.append(place)
    result = np.where(inside, np.ravel_multi_index(places, other.shape), -1)
    candidates = np.flatnonzero(inside)
    if candidates.size:
        ours, theirs = points.subset(candidates), grid.points_at_indices(other, result[candidates])
        columns, others = (
            [g.duration, np.asarray(g.transient), g.rate_tolerance, *g.base.values(), *g.points.values()]
            for g in (ours, theirs)
        )
        same = ours.reason == theirs.reason
        for a, b in zip(columns, others, strict=True):
            same &= a.view(np.int64) == b.view(np.int64)
        result[candidates[~same]] = -1
    return result
