"""Zarr stores of atlases, in version 3 of the format.

A Zarr chunk that is missing reads as its fill value, and metadata have no checksums. The attribute CHECKSUM
of a store therefore holds a hash of all metadata and of names and sizes of all other files, which is compared
when the store is opened. Every chunk ends in a CRC-32C, which Zarr compares whenever it is read. The
attribute CHUNKS binds these to their array and place; it is compared before an array is read.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.backends.zarr import ZarrStore
from xarray.core import indexing

from ..errors import BadInput
from ..files import atomic_folder, check_claim, one_line, read_json

METADATA = "zarr.json"
CHECKSUM = "atlas_checksum"
CHUNKS = "atlas_chunks"  # JSON text: name of an array -> `_crc_of_chunks`
CHUNKS_PER_SHARD = 16  # chunks in one file
COMPRESSION_LEVEL = 3


def zarr_package() -> Any:
    """The package zarr; BadInput if it is not installed."""
    try:
        import zarr
    except ImportError:
        raise BadInput("Zarr stores need the package zarr: python -m pip install zarr") from None
    return zarr


def shard_lengths(sizes: Mapping[str, int], chunk: Mapping[str, int]) -> dict[str, int]:
    """Lengths of the box of chunks in one file: at most CHUNKS_PER_SHARD chunks, the last dimension first."""
    shard, room = dict(chunk), CHUNKS_PER_SHARD
    for dim in reversed(list(chunk)):
        count = min(math.ceil(sizes[dim] / chunk[dim]), room)
        shard[dim], room = count * chunk[dim], room // count
    return shard


def write_blocks(
    ds: xr.Dataset, chunk: Mapping[str, int], names: Collection[str], blocks: Iterator[Any], path: Path
) -> None:
    """Write an atlas as a Zarr store, as `netcdf.write_blocks`; boxes are of `shard_lengths`, a file each."""
    zarr = zarr_package()
    coordinates = " ".join(str(name) for name in ds.coords if name not in ds.dims)
    shard = shard_lengths({str(dim): size for dim, size in ds.sizes.items()}, chunk)
    with atomic_folder(path) as temporary:
        root = zarr.create_group(str(temporary), zarr_format=3, attributes=_plain(ds.attrs))
        arrays = {}
        for name, variable in ds.variables.items():
            dims = [str(dim) for dim in variable.dims]
            attributes = variable.attrs | ({"coordinates": coordinates} if name in ds.data_vars else {})
            lengths = tuple(shard[dim] for dim in dims)
            array = arrays[name] = root.create_array(
                str(name),
                shape=variable.shape,
                dtype=variable.dtype,
                chunks=tuple(chunk[dim] for dim in dims),
                shards=lengths or None,
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
            elif name not in names:  # a parameter too large for memory
                variable.data.rechunk(lengths).store(array, lock=False, scheduler="synchronous")
        for box, values in blocks:
            for name, part in values.items():
                arrays[name][box] = part
        _add_checksum(temporary)


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON has them."""
    return {
        str(name): value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for name, value in attributes.items()
    }


def _add_checksum(path: Path) -> None:
    """Add the checksums to a store when all is written."""
    file = path / METADATA
    metadata = json.loads(file.read_bytes())
    arrays = _arrays(path)
    metadata["attributes"][CHUNKS] = json.dumps({name: _crc_of_chunks(path / name) for name in arrays})
    metadata["attributes"][CHECKSUM] = _checksum(path, metadata["attributes"])
    file.write_text(json.dumps(metadata, indent=2))


def _arrays(path: Path) -> dict[str, dict[str, Any]]:
    """Metadata of the arrays of a store by their names."""
    nodes = {file.parent.name: read_json(file) for file in path.glob(f"*/{METADATA}")}
    return {name: node for name, node in nodes.items() if node["node_type"] == "array"}


def _checksum(path: Path, attributes: Mapping[str, Any]) -> str:
    """Hash of the metadata of a store, and of names and sizes of its other files."""
    attributes = {name: value for name, value in attributes.items() if name != CHECKSUM}
    digest = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for file in sorted(path.rglob("*")):
        if file.is_file() and file != path / METADATA:
            name = file.relative_to(path).as_posix()
            content = file.read_bytes() if file.name == METADATA else b"%d" % file.stat().st_size
            digest.update(b"%s %d %s" % (name.encode(), len(content), content))
    return digest.hexdigest()


def _crc_of_chunks(folder: Path) -> int:
    """CRC-32 of the places of all chunks of an array, and of the CRC-32C in which each of them ends."""
    array, crc = read_json(folder / METADATA), 0
    codec = array["codecs"][0]
    for file in sorted(file for file in folder.rglob("*") if file.is_file() and file.name != METADATA):
        with file.open("rb") as opened:
            if codec["name"] == "sharding_indexed":
                shapes = array["chunk_grid"]["configuration"], codec["configuration"]
                in_file, in_chunk = (math.prod(shape["chunk_shape"]) for shape in shapes)
                opened.seek(-16 * (in_file // in_chunk) - 4, os.SEEK_END)
                content = opened.read()
                for place, length in np.frombuffer(content[:-4], "<u8").reshape(-1, 2).tolist():
                    if length < 1 << 63:  # a chunk beyond the end of the array is not stored
                        opened.seek(place + length - 4)
                        content += opened.read(4)
            else:
                opened.seek(-4, os.SEEK_END)
                content = opened.read()
        crc = zlib.crc32(file.relative_to(folder).as_posix().encode() + content, crc)
    return crc


def is_whole(path: Path) -> bool:
    """Whether a folder is a store with checksum that holds exactly the files that were written."""
    try:
        attributes = read_json(path / METADATA)["attributes"]
        return bool(attributes[CHECKSUM] == _checksum(path, attributes))
    except (OSError, LookupError, TypeError, ValueError):
        return False


def open_store(path: Path) -> xr.Dataset:
    """Open a store lazily; BadInput without the package zarr, or if it is damaged or too large for its files.

    A store of another program, without checksum, is read as it is. Reading finds damaged values.
    """
    zarr_package()
    try:
        attributes = read_json(path / METADATA)["attributes"]
        if {CHECKSUM, CHUNKS} & attributes.keys() and attributes.get(CHECKSUM) != _checksum(path, attributes):
            raise ValueError("files were changed, added or lost since it was written")
        claimed = 0
        for array in _arrays(path).values():
            lengths = array["chunk_grid"]["configuration"]["chunk_shape"]
            size = 1 if array["data_type"] in ("int8", "bool") else 8
            claimed += size * math.prod(map(max, array["shape"], lengths))
        check_claim(claimed, sum(file.stat().st_size for file in path.rglob("*")))
        ds = xr.open_dataset(_CheckedStore.open_group(str(path), consolidated=False))
    except Exception as error:  # damaged metadata may raise any error
        raise BadInput(f"{path}: not a Zarr store that can be read ({one_line(error)})") from None
    for name in (CHECKSUM, CHUNKS):
        ds.attrs.pop(name, None)
    return ds


class _CheckedStore(ZarrStore):
    """A store whose damaged values raise BadInput."""

    def open_store_variable(self, name: str, *args: Any) -> xr.Variable:
        """Variable of the store, read through `_CheckedArray`."""
        variable = super().open_store_variable(name, *args)
        attributes = dict(variable.attrs)
        if "flag_values" in attributes:
            attributes["flag_values"] = np.array(attributes["flag_values"], variable.dtype)
        crc = json.loads(self.zarr_group.attrs.get(CHUNKS, "{}")).get(name)
        array = _CheckedArray(variable._data.array, self.zarr_group.store.root / name, crc)
        return xr.Variable(variable.dims, indexing.LazilyIndexedArray(array), attributes, variable.encoding)


class _CheckedArray(BackendArray):
    """A Zarr array whose damaged chunks raise BadInput."""

    def __init__(self, array: Any, folder: Path, crc: int | None):
        self.array, self.folder, self.crc = array, folder, crc
        self.shape, self.dtype = array.shape, array.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        try:
            if self.crc is not None and self.crc != _crc_of_chunks(self.folder):
                raise ValueError("its chunks are not those that were written, or not in their places")
            self.crc = None  # compared once
            return self.array[key]
        except (ValueError, RuntimeError, OSError) as error:
            path, name = self.folder.parent, self.folder.name
            raise BadInput(f"{path}: the values of {name} are damaged: {one_line(error)}") from None
