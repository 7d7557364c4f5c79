"""The grid of a scene cut into tiles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..engine import stepsize
from ..engine.tableaux import METHODS
from ..scene import grid
from ..scene.model import Scene

# A tile takes a few seconds of one processor at some 6 ns a point-step, but fills the lanes of its kernel.
TILE_POINT_STEPS, MIN_POINTS_PER_TILE = 5e8, 512


@dataclass(frozen=True)
class Tiling:
    """A grid cut into equal boxes, each a contiguous range of flat C-order indices."""

    shape: tuple[int, ...]
    tile: tuple[int, ...]  # 1, ..., 1, some rows, whole axes

    @classmethod
    def of(cls, shape: tuple[int, ...], points: int) -> Tiling:
        """Tiles of at most so many points, cut evenly."""
        tile, room = [], points
        for count in reversed(shape):
            tile.append(math.ceil(count / math.ceil(count / min(count, max(room, 1)))))
            room //= count
        return cls(shape, tuple(reversed(tile)))

    @property
    def blocks(self) -> tuple[int, ...]:
        """Number of tiles along each axis."""
        return tuple(-(-count // length) for count, length in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        return math.prod(self.blocks)

    def place(self, tile: int) -> tuple[slice, ...]:
        """Where a tile lies in the grid."""
        first = [int(i) * n for i, n in zip(np.unravel_index(tile, self.blocks), self.tile, strict=True)]
        ends = zip(first, self.tile, self.shape, strict=True)
        return tuple(slice(start, min(start + length, count)) for start, length, count in ends)

    def extent(self, tile: int) -> tuple[int, ...]:
        """Shape of a tile: those at the end of an axis may be shorter."""
        return tuple(s.stop - s.start for s in self.place(tile))

    def indices(self, tile: int) -> np.ndarray:
        """Flat indices of the points of a tile."""
        first = int(np.ravel_multi_index(tuple(s.start for s in self.place(tile)), self.shape))
        return np.arange(first, first + math.prod(self.extent(tile)))


def step_sizes(scene: Scene, sample: grid.Grid) -> stepsize.StepSizes:
    """Step counts of some points of the scene, and what is known beforehand of their errors."""
    settings = scene.settings
    with np.errstate(all="ignore"):
        return stepsize.choose(
            METHODS[settings.method], scene.system.frequency_bound(sample.points), sample.duration,
            tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
            rate_tolerance=settings.rate_tolerance,
        )  # fmt: skip


def mean_steps(scene: Scene, sample: grid.Grid) -> float:
    """Integration steps of a point of the scene, averaged over the sample of `grid.check`."""
    return float(step_sizes(scene, sample).count[sample.there].mean())


def tiling(scene: Scene, sample: grid.Grid) -> Tiling:
    """How a scene is cut: from the scene alone, never from timing."""
    wanted = min(
        max(TILE_POINT_STEPS / mean_steps(scene, sample), MIN_POINTS_PER_TILE), grid.MAX_POINTS_PER_TILE
    )
    # A power of two: a last bit of the mean that differs between machines makes no other tiles.
    return Tiling.of(scene.shape, 2 ** round(math.log2(wanted)))
