"""Opening of an atlas from a file, a store or a run folder, also by `xr.open_dataset(..., engine="atlas")`."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import xarray as xr
from xarray.backends import BackendEntrypoint

from ..errors import BadInput, shown
from ..files import parsed, read_bytes
from ..scene.checks import typed


class AtlasBackend(BackendEntrypoint):
    """Engine "atlas" of xarray, which opens atlases and run folders."""

    description = "Opens run folders and atlases of Precession Atlas"
    open_dataset_parameters = ("filename_or_obj", "drop_variables")

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether a path leads to a run folder."""
        with suppress(OSError, ValueError):
            if isinstance(filename_or_obj, str | os.PathLike):
                manifest = parsed(read_bytes(Path(filename_or_obj, "manifest.json")))
                return {"scene", "identity", "tile"} <= manifest.keys()
        return False

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> xr.Dataset:
        """Open an atlas as `atlas.open_atlas` does. With chunks={}, a run folder has a chunk for each tile."""
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
        An atlas file (NAME.nc, or with a suffix of an extension), a Zarr store (NAME.zarr, or an address such as
        s3://BUCKET/NAME.zarr), or a run folder, which may still be growing (also s3://BUCKET/NAME/).

    Returns
    -------
    xarray.Dataset
        The atlas, whose flag variables are plain integers. A run folder gives dask arrays with a chunk for each tile. Points of
        missing tiles are `not_computed` and nan, and a warning is logged. Tiles are read each time values are computed, so that tiles
        finished later appear in the same Dataset. The run of a refined scene must be finished. Reading values whose checksum is wrong
        raises BadInput. `atlas status FILE --verify` compares all checksums.

    Raises
    ------
    BadInput
        If there is no such file, if it is damaged, or if it is not an atlas.
    """
    # Imported here, because xarray imports this module in every process that opens any file.
    from ..store import finished
    from ..store.place import located

    place = located(path)
    path = Path(path) if isinstance(place, Path) else place
    if isinstance(place, Path) and not place.exists():
        raise BadInput(f"{path}: there is no such file")
    if str(path).lower().endswith(".toml"):
        raise BadInput(f"{path}: this is a scene, not an atlas; `atlas run {path}` makes its atlas")
    if not finished.is_finished(place):
        from .run import RunFolder

        folder = RunFolder.open(path)
        missing_tiles = len(folder.tiles.missing())
        if missing_tiles and folder.scene.refine is None:
            logging.getLogger("atlas").warning(
                "%s: %d of %d tiles are missing; their points are not_computed",
                path, missing_tiles, folder.tiling.count,
            )  # fmt: skip
        return folder.dataset()
    ds = finished.format_of(path).open_dataset(path)
    missing = [name for name in ("atlas_system", "atlas_version") if name not in ds.attrs]
    if missing:
        ds.close()
        raise BadInput(f"{path}: not an atlas: the attribute {missing[0]} is missing")
    if "atlas_parts" in ds.attrs:
        from ..store.joined import part_of

        return part_of(ds)
    return ds
