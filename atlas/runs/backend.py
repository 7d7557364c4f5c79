"""Opening an atlas from a file or a run folder; also the engine "atlas" of xarray, so that `xr.open_dataset` does the same."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray as xr
from xarray.backends import BackendEntrypoint

from ..errors import BadInput, shown
from ..files import one_line, parsed, read_bytes
from ..scene.checks import typed


class AtlasBackend(BackendEntrypoint):
    """Engine of xarray for atlases, which compares values with their checksums, as its own engines do not."""

    description = "Opens run folders and atlases of Precession Atlas"
    open_dataset_parameters = ("filename_or_obj", "drop_variables")

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether a path leads to a run folder."""
        if not isinstance(filename_or_obj, str | os.PathLike):
            return False
        try:
            return {"scene", "identity", "tile"} <= parsed(
                read_bytes(Path(filename_or_obj, "manifest.json"))
            ).keys()
        except (OSError, ValueError):
            return False

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> xr.Dataset:
        """Open an atlas as `atlas.open_atlas` does; of a run folder chunks={} gives a chunk for each tile."""
        if not isinstance(filename_or_obj, str | os.PathLike):
            raise BadInput(f"{shown(filename_or_obj)}: the engine atlas opens paths")
        ds = open_atlas(Path(filename_or_obj))
        tile = {dim: lengths[0] for dim, lengths in ds.chunksizes.items()}
        if tile:
            for variable in ds.variables.values():
                variable.encoding["preferred_chunks"] = {dim: tile[dim] for dim in variable.dims}
        names = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
        result = ds.drop_vars(names, errors="ignore")
        result.set_close(ds.close)
        return result


@typed
def open_atlas(path: str | Path) -> xr.Dataset:
    """Open an atlas lazily.

    Parameters
    ----------
    path : str or Path
        An atlas file (NAME.nc), a Zarr store (NAME.zarr, or an address such as s3://BUCKET/NAME.zarr), or a run folder. Store and
        folder may still be growing.

    Returns
    -------
    xarray.Dataset
        Flag variables are plain integers. A run folder gives dask arrays with a chunk for each tile;
        points of tiles that are missing are `not_computed` and nan, which is logged as a warning; that of a refined
        scene must be finished. Tiles are
        read whenever values are computed, so that tiles finished later appear in the same Dataset. Values of
        a file are compared with their checksums when they are read, and BadInput is raised if they differ.

    Raises
    ------
    BadInput
        If there is no such file, if it is damaged, or if it is not an atlas.
    """
    # Here, because xarray imports this module in every process that opens any file.
    from ..io import zarr_store
    from ..io.checksums import CheckedStore
    from ..io.storage import located, storage_at

    place = located(path)
    path = Path(path) if isinstance(place, Path) else place
    if isinstance(place, Path) and not place.exists():
        raise BadInput(f"{path}: there is no such file")
    if str(path).lower().endswith(".toml"):
        raise BadInput(f"{path}: this is a scene, not an atlas; `atlas run {path}` makes its atlas")
    is_file = isinstance(place, Path) and not place.is_dir()
    if not is_file and zarr_store.METADATA in storage_at(place).names():
        ds = zarr_store.open_store(path)
    elif not is_file:
        from .folder import RunFolder

        folder = RunFolder.open(path)
        missing_tiles = folder.tiling.count - folder.tiles.written_count()
        if missing_tiles and folder.scene.refine is None:
            logging.getLogger("atlas").warning(
                "%s: %d of %d tiles are missing; their points are not_computed",
                path, missing_tiles, folder.tiling.count,
            )  # fmt: skip
        return folder.dataset()
    else:
        try:
            store = CheckedStore.of(Path(place))
            try:
                ds = xr.open_dataset(store, chunks=None)
            except Exception:
                store.close()
                raise
            ds.encoding["source"] = str(place)
        except BadInput:
            raise
        except Exception as error:  # reading a damaged file may raise any error
            raise BadInput(f"{path}: not a NetCDF file that can be read ({one_line(error)})") from None
    missing = [name for name in ("atlas_system", "atlas_version") if name not in ds.attrs]
    if missing:
        ds.close()
        raise BadInput(f"{path}: not an atlas: the attribute {missing[0]} is missing")
    return ds
