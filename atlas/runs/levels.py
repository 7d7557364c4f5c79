"""Run folders of refined scenes: each level is a list of points, computed in tiles as those of a grid.

    NAME/manifest.json                 as in every run folder
    NAME/levels/0003/manifest.json     the number of the level, its key, and the key of the level before
    NAME/levels/0003/points.bin        flat indices of its points in the finest grid, int64, little-endian
    NAME/levels/0003/tiles/            as in every run folder
    NAME/atlas.nc                      the refined atlas, written when all levels are done

The points of a level follow from the results of those before, so that a run that is continued, and every process that shares
it, finds the same levels; the key of a level is a hash of run, points and key before, and all its tiles carry it.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..files import check_types, one_line, sealed, unsealed
from ..io import zarr_store
from ..io.netcdf import Block
from ..io.zarr_store import MAX_OBJECT_BYTES, Box
from ..variables import COMPUTED, POINT, variables
from .backend import open_atlas
from .folder import MANIFEST, RunFolder, hash_of
from .tiles import MIN_POINTS_PER_TILE, DamagedTile, TileFiles, Tiling

LEVELS, POINTS, RESULT_FILE = "levels", "points.bin", "atlas.nc"
# Measured flags whose boundaries are traced: the label always, the others where the scene asks for them.
MEASURED = (
    "label", "label_inertial", "label_any_axis", "label_any_axis_inertial", "geometry", "status", "regularity",
    "end_equilibrium", "end_index", "settled_by",
)  # fmt: skip
MAX_VALUES = 32  # of those that have no flags
TILES_PER_LEVEL = 64  # if they have enough points, so that many processes can share a level
# Flat indices of some points in the finest grid, in order, and their variables.
Part: TypeAlias = tuple[np.ndarray, Mapping[str, np.ndarray]]


def level_name(number: int) -> str:
    """Name of the folder of a level."""
    return f"{LEVELS}/{number:04d}"


class RefinedFolder(RunFolder):
    """The run of a refined scene on disk."""

    content = LEVELS
    more = " of the levels that have begun, and more levels may follow"

    @property
    def types(self) -> dict[str, str]:
        return super().types | {COMPUTED.name: COMPUTED.dtype}

    @property
    def result(self) -> Path | str:
        """The file or store of the finished atlas."""
        return self.path / RESULT_FILE if isinstance(self.path, Path) and not self.is_store else self.path

    def save_result(
        self, attributes: dict[str, Any], values: Callable[[Box], Any], levels: Sequence[Level]
    ) -> None:
        """Write the finished atlas, box by box, from `values` in a box of the grid and the numbers that levels have."""
        self.check_kept()
        ds, shape, types = self.template(), self.scene.shape, self.types
        ds.attrs = self.attributes(self.totals()) | attributes

        def blocks(lengths: tuple[int, ...]) -> Iterator[Block]:
            for tile, box in enumerate(boxes := Tiling(shape, lengths)):
                columns, indices = values(box), boxes.indices(tile)
                numbers = types.keys() - columns
                columns |= {name: np.full(boxes.shape_of(tile), np.nan) for name in numbers}
                for points, measured in chain.from_iterable(level.read(indices) for level in levels):
                    for name in numbers:
                        columns[name].flat[points - indices[0]] = measured[name]
                yield box, {name: columns[name] for name in types}

        if self.is_store:
            self.write_store(self.root, ds, blocks)
        else:
            self.write(Path(self.result), ds, blocks)

    def levels(self) -> list[Level]:
        """The levels that have begun; the next run writes damaged ones, which are logged, anew."""
        levels, number = list[Level](), 0
        while MANIFEST in self.storage.names(level_name(number)):
            try:
                levels.append(Level.open(self, number))
            except BadInput as error:
                logging.getLogger("atlas").warning("%s", error)
            number += 1
        return levels

    def tile_sets(self) -> dict[str, TileFiles]:
        """The tiles of each level by its name."""
        return {f"level {level.number}: ": level.tiles for level in self.levels()}

    def _size_text(self) -> str:
        return f"refined, {self.scene.size} points on the finest grid"

    @property
    def is_complete(self) -> bool:
        """Whether the atlas is written."""
        return zarr_store.is_sealed(self.root) if self.is_store else Path(self.result).exists()

    def dataset(self) -> xr.Dataset:
        """The finished atlas, lazily."""
        if not self.is_complete:
            raise BadInput(
                f"{self.path}: {self.progress_text()}, and more levels may follow; run its scene again first"
            )
        return open_atlas(self.result)

    def _blocks(self, ds: xr.Dataset, lengths: tuple[int, ...]) -> Iterator[Block]:
        result = self.dataset()
        for box in Tiling(self.scene.shape, lengths):
            yield box, {name: result[name].variable[box].values for name in self.types}
        ds.attrs = result.attrs

    def remove(self) -> None:
        """Remove the run, the manifest last."""
        if not self.is_store:
            Path(self.result).unlink(missing_ok=True)
        super().remove()


class Level:
    """Some points of the finest grid, which are computed in tiles like a grid of one axis."""

    def __init__(self, run: RunFolder, number: int, before: str, points: np.ndarray):
        self.run, self.number, self.before, self.points = run, number, before, points
        self.scene, self.manifest = run.scene, run.manifest
        self.storage = run.storage.inside(level_name(number))
        most = max(MIN_POINTS_PER_TILE, min(math.prod(run.tiling.tile), points.size // TILES_PER_LEVEL))
        self.tiling = Tiling.of((points.size,), most)
        self.key = self.key_with(run.manifest["identity"])
        self.tiles = self.tiles_with(self.key)
        self.read_tile = lru_cache(maxsize=1)(self.tiles.read)

    @classmethod
    def open(cls, run: RunFolder, number: int) -> Level:
        """A level that some process has begun; BadInput if it is damaged."""
        storage = run.storage.inside(level_name(number))
        try:
            manifest = unsealed(storage.read(MANIFEST))
            check_types(manifest, {"key": str, "level": int, "before": str})
            points = np.frombuffer(storage.read(POINTS, MAX_OBJECT_BYTES), "<i8")
            level = cls(run, manifest["level"], manifest["before"], points)
            if manifest["key"] != level.key:
                raise ValueError("its key does not match its points")
            return level
        except (OSError, ValueError) as error:
            raise BadInput(
                f"{storage}: damaged: {one_line(error)}; run the scene again, which writes it anew"
            ) from None

    def key_with(self, identity: dict[str, str]) -> str:
        """Key of this level if programs and processors of another identity computed it."""
        run, points = self.run.key_with(identity), hashlib.sha256(self.points.astype("<i8").tobytes())
        content = {"run": run, "level": self.number, "before": self.before, "points": points.hexdigest()}
        return hash_of(content)

    def tiles_with(self, key: str) -> TileFiles:
        """The tiles of this level if it had this key."""
        outputs = {*self.scene.outputs, "label"} - {"growth_rate"}
        measured = (v for v in variables(self.scene.system).values() if v.name in MEASURED or not v.flags)
        types = {variable.name: variable.dtype for variable in measured if variable.name in outputs}
        return TileFiles(
            self.storage.inside("tiles"), key, (POINT,), types, self.tiling, is_flat=self.run.is_flat
        )

    def prepare(self) -> None:
        """Write the manifest of the level unless it is there; a damaged one is replaced."""
        with suppress(BadInput):
            if Level.open(self.run, self.number).key == self.key:
                self.remove_leftovers()
                return
        self.run.check_kept()
        for storage in self.storage, self.tiles.storage:  # not the run, which may have been removed
            storage.make()
        self.storage.write(POINTS, self.points.astype("<i8").tobytes())
        manifest: dict[str, Any] = {"key": self.key, "level": self.number, "before": self.before}
        self.storage.write(MANIFEST, sealed(manifest).encode())

    def read(self, indices: np.ndarray) -> Iterator[Part]:
        """The points between the first and the last of some flat indices, and their variables, tile by tile."""
        start, end = np.searchsorted(self.points, (indices[0], indices[-1] + 1))
        length = self.tiling.tile[0]
        for tile in range(start // length, -(-end // length) if end > start else 0):
            inside = slice(max(start - tile * length, 0), end - tile * length)
            try:
                values = self.read_tile(tile)
            except DamagedTile as error:
                raise OSError(f"{self.storage}: tile {tile}: {error}; run the scene again") from None
            yield self.indices(tile)[inside], {name: column[inside] for name, column in values.items()}

    def indices(self, tile: int) -> np.ndarray:
        """Flat indices in the finest grid of the points of a tile."""
        return self.points[self.tiling.indices(tile)]

    def remove_leftovers(self) -> None:
        """Remove temporary files and claims of processes that were killed."""
        self.storage.remove_leftovers()
        self.tiles.remove_claims()
