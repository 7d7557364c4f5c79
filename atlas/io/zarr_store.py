"""Zarr stores of atlases, in version 3 of the format.

A Zarr chunk that is missing reads as its fill value, and metadata have no checksums. The attribute CHECKSUM of a store
therefore holds a hash of all metadata and of names and sizes of all other files, which is compared when the store is
opened. Every chunk ends in a CRC-32C, which Zarr compares whenever it is read.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.backends.zarr import ZarrStore
from xarray.core import indexing

from ..errors import BadInput
from ..files import one_line

METADATA = "zarr.json"
CHECKSUM = "atlas_checksum"
CHUNKS_PER_SHARD = 16  # chunks in one file
COMPRESSION_LEVEL = 3


def zarr_package() -> Any:
    """The package zarr; BadInput if it is not installed."""
    try:
        import zarr
    except ImportError:
        raise BadInput(
            'Zarr stores need the package zarr: python -m pip install "precession-atlas[zarr]"'
        ) from None
    return zarr


def shard_lengths(sizes: Mapping[str, int], chunk: Mapping[str, int]) -> dict[str, int]:
    """Lengths of the box of chunks in one file: at most CHUNKS_PER_SHARD chunks, the last dimension first."""
    shard, room = dict(chunk), CHUNKS_PER_SHARD
    for dim in reversed(list(chunk)):
        count = min(math.ceil(sizes[dim] / chunk[dim]), room)
        shard[dim], room = count * chunk[dim], room // count
    return shard


def create(path: Path, ds: xr.Dataset, chunk: Mapping[str, int]) -> dict[str, Any]:
    """Create a store with everything but the values of dask arrays.

    Parameters
    ----------
    path : Path
        An empty folder.
    ds : Dataset
        Its variables in memory are written.
    chunk : mapping of str to int
        Length of a chunk along each dimension.

    Returns
    -------
    dict
        Name -> Zarr array, of the variables that are dask arrays.
    """
    zarr = zarr_package()
    coordinates = " ".join(str(name) for name in ds.coords if name not in ds.dims)
    shard = shard_lengths({str(dim): size for dim, size in ds.sizes.items()}, chunk)
    root = zarr.create_group(str(path), zarr_format=3, attributes=_plain(ds.attrs))
    unwritten = {}
    for name, variable in ds.variables.items():
        dims = [str(dim) for dim in variable.dims]
        attributes = variable.attrs | ({"coordinates": coordinates} if name in ds.data_vars else {})
        array = root.create_array(
            str(name),
            shape=variable.shape,
            dtype=variable.dtype,
            chunks=tuple(chunk[dim] for dim in dims),
            shards=tuple(shard[dim] for dim in dims) or None,
            compressors=[
                zarr.codecs.BloscCodec(cname="zstd", clevel=COMPRESSION_LEVEL, shuffle="shuffle"),
                zarr.codecs.Crc32cCodec(),
            ],
            fill_value=math.nan if variable.dtype.kind == "f" else 0,
            dimension_names=dims,
            attributes=_plain(attributes),
            config={"write_empty_chunks": True},  # so that a missing file is always a loss
        )
        if variable.chunks is None:
            array[...] = variable.values
        else:
            unwritten[str(name)] = array
    return unwritten


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON has them."""
    return {
        str(name): value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for name, value in attributes.items()
    }


def add_checksum(path: Path) -> None:
    """Add the checksum to a store when all is written."""
    file = path / METADATA
    metadata = json.loads(file.read_bytes())
    metadata["attributes"][CHECKSUM] = _checksum(path, metadata)
    file.write_text(json.dumps(metadata, indent=2))


def _checksum(path: Path, metadata: dict[str, Any]) -> str:
    """Hash of the metadata of a store, and of names and sizes of its other files."""
    attributes = {name: value for name, value in metadata["attributes"].items() if name != CHECKSUM}
    digest = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for file in sorted(path.rglob("*")):
        if file.is_file() and file != path / METADATA:
            name = file.relative_to(path).as_posix()
            content = file.read_bytes() if file.name == METADATA else b"%d" % file.stat().st_size
            digest.update(b"%s %d %s" % (name.encode(), len(content), content))
    return digest.hexdigest()


def open_store(path: Path) -> xr.Dataset:
    """Open a store lazily.

    Parameters
    ----------
    path : Path
        A folder with a file METADATA. A store of another program, without checksum, is read as it is.

    Returns
    -------
    Dataset

    Raises
    ------
    BadInput
        If the package zarr is missing, or the store is damaged. Damaged values are found when they are read.
    """
    zarr_package()
    try:
        metadata = json.loads((path / METADATA).read_bytes())
        if CHECKSUM in metadata["attributes"] and metadata["attributes"][CHECKSUM] != _checksum(
            path, metadata
        ):
            raise ValueError("files were changed, added or lost since it was written")
        ds = xr.open_dataset(_CheckedStore.open_group(str(path), consolidated=False))
    except Exception as error:  # damaged metadata may raise any error
        raise BadInput(f"{path}: not a Zarr store that can be read ({one_line(error)})") from None
    ds.attrs.pop(CHECKSUM, None)
    return ds


class _CheckedStore(ZarrStore):
    """A store whose damaged values raise BadInput."""

    def open_store_variable(self, name: str, *args: Any) -> xr.Variable:
        """Variable of the store, read through `_CheckedArray`."""
        variable = super().open_store_variable(name, *args)
        attributes = dict(variable.attrs)
        if "flag_values" in attributes:
            attributes["flag_values"] = np.array(attributes["flag_values"], variable.dtype)
        array = _CheckedArray(
            variable._data.array, f"{self.zarr_group.store}: the values of {name} are damaged"
        )
        return xr.Variable(variable.dims, indexing.LazilyIndexedArray(array), attributes, variable.encoding)


class _CheckedArray(BackendArray):
    """A Zarr array whose damaged chunks raise BadInput."""

    def __init__(self, array: Any, message: str):
        self.array, self.message = array, message
        self.shape, self.dtype = array.shape, array.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        try:
            return self.array[key]
        except (ValueError, RuntimeError, OSError) as error:
            raise BadInput(f"{self.message}: {one_line(error)}") from None
