"""Tiles: the boxes into which the grid of a scene is cut."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import shown

# Work of a tile, in points times steps: a few seconds of one processor at about 6 ns each.
TILE_POINT_STEPS = 5e8
# With fewer points the blocks of the kernel would not be full.
MIN_POINTS_PER_TILE = 512
# Limits of what a run folder may claim. The tiles of the largest grid, cut evenly, are half as many.
MAX_TILES, MAX_TILE_POINTS = 8_000_000, 1_000_000


@dataclass(frozen=True)
class Tiling:
    """A grid cut into boxes, each a contiguous range of flat C-order indices; the last may be shorter."""

    shape: tuple[int, ...]
    tile: tuple[int, ...]  # 1, ..., 1, some rows, then whole axes

    @classmethod
    def of(cls, shape: tuple[int, ...], max_points: int) -> Tiling:
        """Cut a grid evenly into tiles of at most so many points."""
        tile, remaining = [], max_points
        for count in reversed(shape):
            tile.append(math.ceil(count / math.ceil(count / min(count, max(remaining, 1)))))
            remaining //= count
        return cls(shape, tuple(reversed(tile)))

    def check(self) -> None:
        """Raise ValueError unless these are boxes as `of` makes them, and not too many or too large."""
        if len(self.tile) != len(self.shape) or not all(type(length) is int for length in self.tile):
            raise ValueError(
                f"tile = {shown(self.tile)}: must be a whole number for each of {len(self.shape)} axes"
            )
        cut = next((i for i, length in enumerate(self.tile) if length > 1), len(self.tile))
        if (
            not all(1 <= length <= count for length, count in zip(self.tile, self.shape, strict=True))
            or self.tile[cut + 1 :] != self.shape[cut + 1 :]
            or math.prod(self.tile) > MAX_TILE_POINTS
            or self.count > MAX_TILES
        ):
            raise ValueError(
                f"tile = {shown(self.tile)}: allowed: some rows of a grid of {shown(self.shape)}, at most"
                f" {MAX_TILE_POINTS} points in each and {MAX_TILES} tiles"
            )

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of tiles along each axis."""
        return tuple(-(-count // length) for count, length in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.counts)

    def slices(self, tile: int) -> tuple[slice, ...]:
        """Slices of the grid that a tile covers."""
        first = [int(i) * n for i, n in zip(np.unravel_index(tile, self.counts), self.tile, strict=True)]
        bounds = zip(first, self.tile, self.shape, strict=True)
        return tuple(slice(start, min(start + length, count)) for start, length, count in bounds)

    def shape_of(self, tile: int) -> tuple[int, ...]:
        """Shape of one tile."""
        return tuple(s.stop - s.start for s in self.slices(tile))

    def size_of(self, tile: int) -> int:
        """Number of points of one tile."""
        return math.prod(self.shape_of(tile))

    def indices(self, tile: int) -> np.ndarray:
        """Flat indices of the points of a tile, int64 of shape (points,)."""
        first = int(np.ravel_multi_index(tuple(s.start for s in self.slices(tile)), self.shape))
        return np.arange(first, first + self.size_of(tile))
