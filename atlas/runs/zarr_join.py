"""A finished run folder as a Zarr store."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..files import atomic_folder
from ..io import netcdf, zarr_store
from ..scene import grid
from .tiles import DamagedTileError, tile_types
from .tiling import Tiling

if TYPE_CHECKING:
    from .folder import RunFolder


def write_zarr(run: RunFolder, out: Path) -> None:
    """Write the atlas of a run folder as a Zarr store, which appears whole or not at all.

    run: with all tiles written; out: an existing store is replaced. Raises DamagedTileError if a tile is
    missing or damaged; `out` is then unchanged. Raises BadInput if the package zarr is missing. Raises
    OSError if the disk is full.
    """
    zarr_store.zarr_package()
    ds = run.dataset()
    sizes = dict(zip(netcdf.dims(run.scene), run.scene.shape, strict=True))
    chunk = dict(zip(sizes, Tiling.of(run.scene.shape, grid.MAX_POINTS_PER_TILE).tile, strict=True))
    shard = zarr_store.shard_lengths(sizes, chunk)
    with atomic_folder(out) as temporary:
        arrays = zarr_store.create(temporary, ds, chunk)
        from_tiles = {name: arrays.pop(name) for name in tile_types(run.scene)}
        for name, array in arrays.items():  # parameters too large for memory
            lengths = tuple(shard[str(dim)] for dim in ds[name].dims)
            ds[name].data.rechunk(lengths).store(array, lock=False, scheduler="synchronous")
        for box in boxes(run.scene.shape, tuple(shard.values())):
            for name, values in read_box(run, box).items():
                from_tiles[name][box] = values
        zarr_store.add_checksum(temporary)


def boxes(shape: Sequence[int], lengths: Sequence[int]) -> Iterator[tuple[slice, ...]]:
    """Boxes of some lengths that cover a grid, each the points of one file."""
    counts = [-(-size // length) for size, length in zip(shape, lengths, strict=True)]
    for index in np.ndindex(*counts):
        yield tuple(
            slice(i * length, min((i + 1) * length, size))
            for i, length, size in zip(index, lengths, shape, strict=True)
        )


def read_box(run: RunFolder, box: tuple[slice, ...]) -> dict[str, Any]:
    """Values of all variables of the tiles in a box."""
    shape = [part.stop - part.start for part in box]
    values = {name: np.empty(shape, dtype) for name, dtype in tile_types(run.scene).items()}
    first = [part.start // length for part, length in zip(box, run.tiling.tile, strict=True)]
    last = [(part.stop - 1) // length for part, length in zip(box, run.tiling.tile, strict=True)]
    for offset in np.ndindex(*[b - a + 1 for a, b in zip(first, last, strict=True)]):
        tile = int(np.ravel_multi_index(tuple(np.add(first, offset)), run.tiling.counts))
        try:
            arrays = run.tiles.read(tile)
        except (FileNotFoundError, DamagedTileError) as error:
            raise DamagedTileError(f"tile {tile}: {error}") from None
        common = [
            slice(max(a.start, b.start), min(a.stop, b.stop))
            for a, b in zip(box, run.tiling.slices(tile), strict=True)
        ]
        in_box = tuple(slice(c.start - b.start, c.stop - b.start) for c, b in zip(common, box, strict=True))
        in_tile = tuple(
            slice(c.start - t.start, c.stop - t.start)
            for c, t in zip(common, run.tiling.slices(tile), strict=True)
        )
        for name, array in arrays.items():
            values[name][in_box] = array[in_tile]
    return values
