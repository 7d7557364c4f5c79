"""Checksums of everything in a NetCDF file, so that damage is found and never read as data.

NetCDF-4 can store a Fletcher checksum for each chunk, but none for scalars, and none for the tables in which
HDF5 looks chunks up: one flipped bit there makes a chunk read as missing, or without its filters. A group
`checksums` therefore holds a CRC-32 of every block of every variable, compared whenever it is read, and a
hash of dimensions, attributes, types and these numbers, compared when the file is opened. `crc32(block)` has
the blocks of all variables, in C order; the attribute `block_shapes` (JSON) has their shape by variable.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends.locks import HDF5_LOCK, NETCDFC_LOCK, combine_locks
from xarray.backends.netCDF4_ import NetCDF4ArrayWrapper
from xarray.core import indexing

from ..errors import BadInput
from ..files import check_claim, one_line

GROUP = "checksums"
BLOCK_VALUES = 1 << 16  # in a block of a variable that is not stored in chunks
# The libraries below netCDF4 are not thread-safe; xarray reads under the same lock.
NETCDF_LOCK = combine_locks([NETCDFC_LOCK, HDF5_LOCK])

BlockShapes = dict[str, list[int]]


def add(path: Path) -> None:
    """Add checksums, of what is read back, to a new netCDF-4 file without groups."""
    with NETCDF_LOCK, netCDF4.Dataset(path, "r+") as file:
        file.set_auto_maskandscale(False)
        file.set_auto_chartostring(False)
        blocks: BlockShapes = {}
        for name, variable in file.variables.items():
            # The chunks of a variable, or some rows of one without chunks.
            chunks, room = variable.chunking(), BLOCK_VALUES
            block: list[int] = []
            if chunks == "contiguous":
                for count in reversed(variable.shape):
                    block.insert(0, min(count, room))
                    room = max(room // count, 1)
            else:
                block = [min(length, count) for length, count in zip(chunks, variable.shape, strict=True)]
                limit_cache(variable)
            blocks[name] = block
        crc = [
            _crc(np.asarray(variable[_slices(index, blocks[name]) or ...]))
            for name, variable in file.variables.items()
            for index in np.ndindex(*_counts(variable.shape, blocks[name]))
        ]
        group = file.createGroup(GROUP)
        group.createDimension("block", len(crc))
        group.createVariable("crc32", np.uint32, ["block"], fill_value=False)[:] = np.array(crc, np.uint32)
        group.setncattr("block_shapes", json.dumps(blocks))
        group.setncattr("metadata_sha256", _metadata_hash(file))


def limit_cache(variable: netCDF4.Variable[Any]) -> None:
    """Cache two chunks of a variable: each is used once, and the library would keep up to 64 MB of every variable."""
    if isinstance(chunks := variable.chunking(), list):
        variable.set_var_chunk_cache(size=16 * math.prod(chunks))


def are_in(path: Path) -> bool:
    """Whether a NetCDF file has checksums; a copy by another program has none."""
    with NETCDF_LOCK, netCDF4.Dataset(path) as file:
        return GROUP in file.groups


def check_path(path: Path) -> None:
    """Raise BadInput for a path that the NetCDF library takes for another one, or cannot take."""
    whole = os.path.abspath(path)
    if "\\" in whole or any("\ud800" <= character <= "\udfff" for character in whole):
        raise BadInput(
            f"{path}: the NetCDF library opens no path with a backslash or with bytes that are not UTF-8 ({whole})"
        )


def verify(path: Path) -> None:
    """Read all of a file that has checksums; BadInput if it is damaged."""
    with closing(CheckedStore.of(path)) as store:
        for name, (block, crc) in store.checksums.items():
            array = _CheckedArray(name, store)
            for index in np.ndindex(crc.shape):
                array[indexing.BasicIndexer(_slices(index, block))]


def _counts(shape: Sequence[int], block: Sequence[int]) -> list[int]:
    """Number of blocks along each axis."""
    return [-(-count // length) for count, length in zip(shape, block, strict=True)]


def _slices(index: Sequence[int], block: Sequence[int]) -> tuple[slice, ...]:
    """Place of a block, given by its number along each axis."""
    return tuple(slice(i * n, (i + 1) * n) for i, n in zip(index, block, strict=True))


def _crc(values: np.ndarray) -> int:
    """CRC-32 of values in C order: little-endian numbers, or texts joined by zero characters."""
    if values.dtype.kind in "OSU":
        return zlib.crc32("\0".join(map(str, values.ravel())).encode())
    return zlib.crc32(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).data)


def _metadata_hash(file: netCDF4.Dataset) -> str:
    """Hash of dimensions, attributes and types of a file, and of the checksums in it."""
    group = file.groups[GROUP]
    content = [
        {name: len(dimension) for name, dimension in file.dimensions.items()},
        _attributes(file),
        {
            name: [variable.dimensions, str(variable.dtype), _attributes(variable)]
            for name, variable in file.variables.items()
        },
        group.getncattr("block_shapes"),
        _crc(np.asarray(group.variables["crc32"][:])),
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _attributes(owner: Any) -> dict[str, Any]:
    """Attributes of a file or variable as lists of texts, types and exact numbers."""
    attributes = {}
    for name in owner.ncattrs():
        value = np.asarray(owner.getncattr(name))
        attributes[name] = [value.dtype.kind, value.dtype.itemsize, repr(value.tolist())]
    return attributes


class CheckedStore(xr.backends.NetCDF4DataStore):
    """A NetCDF file for xarray, whose values are checked when read; without checksums it is read as it is."""

    checksums: dict[str, tuple[list[int], np.ndarray]]  # shape of a block, CRC of each block

    @classmethod
    def of(cls, path: Path) -> CheckedStore:
        """Open a file; BadInput if its metadata do not fit their hash, or claim more than the file can hold."""
        check_path(path)
        store = cls.open(str(path))
        file, store.checksums = store.ds, {}
        try:
            with NETCDF_LOCK:
                claimed = sum(
                    math.prod(variable.shape) * getattr(variable.dtype, "itemsize", 8)
                    for group in (file, *file.groups.values())
                    for variable in group.variables.values()
                )
                check_claim(claimed, path.stat().st_size)
                group = file.groups.get(GROUP)
                # A copy by another program has no groups; a flipped bit of the name must not make the file look like one.
                if group is None and any(
                    "crc32" in each.variables or "block" in each.dimensions for each in file.groups.values()
                ):
                    raise ValueError(f"the group {GROUP} has another name")
                if group is not None:
                    if group.getncattr("metadata_sha256") != _metadata_hash(file):
                        raise ValueError("their hash differs")
                    blocks: BlockShapes = json.loads(group.getncattr("block_shapes"))
                    crc = np.asarray(group.variables["crc32"][:])
                    for name, variable in file.variables.items():
                        counts = _counts(variable.shape, blocks[name])
                        store.checksums[name] = blocks[name], crc[: math.prod(counts)].reshape(counts)
                        crc = crc[math.prod(counts) :]
        except Exception as error:  # damaged metadata may raise any error
            store.close()
            raise BadInput(f"{path}: its dimensions or attributes are damaged: {one_line(error)}") from None
        return store

    def open_store_variable(self, name: str, var: Any) -> xr.Variable:
        """Variable of the file, read through `_CheckedArray`."""
        variable = super().open_store_variable(name, var)
        if name not in self.checksums:
            return variable
        limit_cache(var)
        return variable.copy(deep=False, data=indexing.LazilyIndexedArray(_CheckedArray(name, self)))


class _CheckedArray(NetCDF4ArrayWrapper):
    """A variable that is read block by block, and compared with the CRC of each block."""

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._getitem
        )

    def _getitem(self, key: tuple[int | slice, ...]) -> np.ndarray:
        """Values at an integer or a slice with a positive step for each axis."""
        path, (block, crc) = self.datastore._filename, self.datastore.checksums[self.variable_name]
        chosen = [range(count)[k] for count, k in zip(self.shape, key, strict=True)]
        ranges = [c if isinstance(c, range) else range(c, c + 1) for c in chosen]
        values = np.empty([len(r) for r in ranges], self.dtype)
        for parts in product(*map(_parts, ranges, block)):
            index, places, inside = zip(*parts, strict=True) if parts else ((), (), ())
            damaged = f"{path}: the values of {self.variable_name} are damaged"
            try:
                content = np.asarray(super()._getitem(_slices(index, block)))
            except (RuntimeError, OSError) as error:
                raise BadInput(f"{damaged}: {one_line(error)}") from None
            if _crc(content) != crc[index]:
                raise BadInput(f"{damaged}: their checksum differs")
            values[places] = content[inside]
        return values[tuple(slice(None) if isinstance(c, range) else 0 for c in chosen)]


def _parts(positions: range, length: int) -> Iterator[tuple[int, slice, slice]]:
    """For each block along an axis its number, and the places of its positions in the result and in it."""
    place = 0
    while place < len(positions):
        block, first = divmod(positions[place], length)
        end = min(place - (-(length - first) // positions.step), len(positions))
        yield block, slice(place, end), slice(first, positions[end - 1] - block * length + 1, positions.step)
        place = end
