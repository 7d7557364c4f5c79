"""Opening an atlas from a file or a run folder."""

from __future__ import annotations

import logging
from pathlib import Path

import xarray as xr

from ..errors import BadInput
from ..files import one_line
from ..io import zarr_store
from ..io.checksums import CheckedStore
from ..scene.checks import typed


@typed
def open_atlas(path: str | Path) -> xr.Dataset:
    """Open an atlas lazily.

    Parameters
    ----------
    path : str or Path
        An atlas file (NAME.nc), a Zarr store (NAME.zarr), or a run folder, which may still be growing.

    Returns
    -------
    xarray.Dataset
        Flag variables are plain integers. A run folder gives dask arrays with a chunk for each tile;
        points of tiles that are missing are `not_computed` and nan, which is logged as a warning. Tiles are
        read whenever values are computed, so that tiles finished later appear in the same Dataset. Values of
        a file are compared with their checksums when they are read, and BadInput is raised if they differ.

    Raises
    ------
    BadInput
        If there is no such file, if it is damaged, or if it is not an atlas.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: there is no such file")
    if (path / zarr_store.METADATA).is_file():
        return _checked(zarr_store.open_store(path), path)
    if path.is_dir():
        from .folder import RunFolder

        folder = RunFolder.open(path)
        missing_tiles = folder.tiling.count - folder.tiles.written_count()
        if missing_tiles:
            logging.getLogger("atlas").warning(
                "%s: %d of %d tiles are missing; their points are not_computed",
                path, missing_tiles, folder.tiling.count,
            )  # fmt: skip
        return folder.dataset()
    try:
        store = CheckedStore.of(path)
        try:
            ds = xr.open_dataset(store, chunks=None)
        except Exception:
            store.close()
            raise
        ds.encoding["source"] = str(path.absolute())
    except BadInput:
        raise
    except Exception as error:  # reading a damaged file may raise any error
        raise BadInput(f"{path}: not a NetCDF file that can be read ({one_line(error)})") from None
    return _checked(ds, path)


def _checked(ds: xr.Dataset, path: Path) -> xr.Dataset:
    """The dataset, if it has the attributes of an atlas; else BadInput."""
    missing = [name for name in ("atlas_system", "atlas_version") if name not in ds.attrs]
    if missing:
        ds.close()
        raise BadInput(f"{path}: not an atlas: the attribute {missing[0]} is missing")
    return ds
