"""Levels of refined runs. A level is a list of points of the finest grid, computed in tiles like a grid of one axis.

    NAME/levels/0003/points.tile    flat indices of the points of level 3 in the finest grid
    NAME/levels/0003/00000012.tile  a tile of level 3

The results of earlier levels determine the points of a level, so that a continued run has the same levels. Every tile contains the
key of the level, which is a hash of the run, the points and the key of the previous level.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from .. import extension
from ..errors import BadInput
from ..files import damaged_message, hash_of
from ..flags import LABELS
from ..scene import grid
from ..store.tile import MAX_TILE_BYTES, DamagedTile, Tiles, decode, encode
from ..store.tiling import MIN_POINTS_PER_TILE, Tiling
from ..variables import variables

if TYPE_CHECKING:
    from ..scene.model import Scene
    from ..store.place import Place

POINTS = "points.tile"
# Flags whose boundaries are traced, without those of extensions. All but the label are traced only if they are outputs.
MEASURED = (*LABELS, "geometry", "status", "regularity")
MAX_VALUES = 32  # largest number of different values of an integer variable without flags
TILES_PER_LEVEL = 64  # least number of tiles of a large level, so that many processes share the work
# Ascending flat indices of points in the finest grid, and the variables at the points.
Part: TypeAlias = tuple[np.ndarray, Mapping[str, np.ndarray]]


def traced(scene: Scene) -> list[str]:
    """Return the names of the measured flags and integers whose boundaries are traced in a scene."""
    of_extensions = (v for each in extension.every("instruments") for v in each.variables(scene.system))
    integers = (variable.name for variable in of_extensions if variable.dtype.startswith("int"))
    return [name for name in (*MEASURED, *integers) if name == "label" or name in scene.outputs]


class Run(Protocol):
    """The part of a run that the class Level uses."""

    key: str
    scene: Scene
    levels_place: Place


class Level:
    """A list of points of the finest grid of a run, and the tiles of the points."""

    def __init__(self, run: Run, number: int, before: str, points: np.ndarray, length: int):
        self.number, self.before, self.points, self.length = number, before, points, length
        self.place = run.levels_place.inside(f"{number:04d}")
        digest = hashlib.sha256(points.astype("<i8").tobytes()).hexdigest()
        self.key = hash_of([run.key, number, before, length, digest])
        outputs = {*run.scene.outputs, "label"} - {"growth_rate"}
        flags = traced(run.scene)
        measured = (v for v in variables(run.scene.system).values() if v.name in flags or not v.flags)
        types = {variable.name: variable.dtype for variable in measured if variable.name in outputs}
        tiling = Tiling(points.shape, (length,))
        self.tiles = Tiles(self.place, self.key, types, tiling, points)
        self.read_tile = lru_cache(maxsize=1)(lambda tile: self.tiles.read(tile)[1])

    @classmethod
    def of(cls, run: Run, number: int, before: str, points: np.ndarray, most: int) -> Level:
        """Return a level in tiles of at most max(most, MIN_POINTS_PER_TILE) points. Write the points unless the run has them."""
        most = max(MIN_POINTS_PER_TILE, min(most, points.size // TILES_PER_LEVEL))
        most = min(most, grid.max_points_per_tile())
        level = cls(run, number, before, points, *Tiling.of(points.shape, most).tile)
        with suppress(BadInput, FileNotFoundError):
            if cls.open(run, number).key == level.key:
                return level
        run.levels_place.make()  # This fails if another process has removed the folder of the run.
        level.place.make()
        header = {"key": level.key, "level": number, "before": before, "length": level.length}
        level.place.write(POINTS, encode(header, {"points": points.astype("<i8")}))
        return level

    @classmethod
    def open(cls, run: Run, number: int) -> Level:
        """Open a level of a run. Raise FileNotFoundError if the level has not begun, BadInput if the level is damaged."""
        place = run.levels_place.inside(f"{number:04d}")
        try:
            content, facts, types = place.read(POINTS, MAX_TILE_BYTES), {"level": number}, {"points": "<i8"}
            header, columns = decode(content, facts, types, run.scene.size)
            points, length = columns["points"], header.get("length")
            if type(length) is not int or not 0 < length <= points.size:
                raise ValueError("its tiles are not allowed")
            level = cls(run, number, str(header.get("before")), points, length)
            if header.get("key") != level.key:
                raise ValueError("its key does not match its points")
            return level
        except FileNotFoundError:
            raise
        except (OSError, ValueError, DamagedTile) as error:
            raise BadInput(damaged_message(place, error)) from None

    def read(self, indices: np.ndarray) -> Iterator[Part]:
        """Yield, tile by tile, the flat indices of the level's points from indices[0] to indices[-1], and the variables at these points."""
        start, end = np.searchsorted(self.points, (indices[0], indices[-1] + 1))
        for tile in range(start // self.length, -(-end // self.length) if end > start else 0):
            inside = slice(max(start - tile * self.length, 0), end - tile * self.length)
            try:
                values = self.read_tile(tile)
            except DamagedTile as error:
                raise OSError(f"{self.place}: tile {tile}: {error}; run the scene again") from None
            yield self.tiles.indices(tile)[inside], {name: column[inside] for name, column in values.items()}

    def fill(self, columns: Mapping[str, np.ndarray], indices: np.ndarray) -> None:
        """Write the values of the level into `columns`, which cover the flat indices from indices[0] to indices[-1]."""
        for points, values in self.read(indices):
            for name, column in columns.items():
                column.flat[points - indices[0]] = values[name]
