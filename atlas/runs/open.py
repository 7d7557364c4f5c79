"""Opening an atlas, file or run folder."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from ..errors import BadInput
from ..files import one_line


def open_atlas(path: str | Path) -> xr.Dataset:
    """Open an atlas file or a run folder lazily, as a Dataset with plain integer flags.

    A folder gives dask arrays of one block per tile; tiles that are not there (yet) are not_computed
    and nan, and are looked for again whenever values are asked for.

    Raises BadInput with one line if there is no such file, if it is damaged or no atlas.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: there is no such file")
    if path.is_dir():
        from .folder import RunFolder

        return RunFolder.open(path).dataset()
    try:
        ds = xr.open_dataset(path, engine="netcdf4", chunks=None)
    except Exception as error:  # whatever a damaged file makes the reader say
        raise BadInput(f"{path}: not a NetCDF file that can be read ({one_line(error)})") from None
    missing = [name for name in ("atlas_system", "atlas_version") if name not in ds.attrs]
    if missing:
        ds.close()
        raise BadInput(f"{path}: not an atlas: the attribute {missing[0]} is missing")
    return ds
