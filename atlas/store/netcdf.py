"""The finished atlas as a NetCDF file, with a hash of the content.

Any program that reads the file checks the Fletcher checksums of chunks and headers. Index tables of chunks, and scalars, have no
checksum. `verify` hashes the dimensions, attributes and values in the file, and compares the result with the attribute HASH.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends.locks import HDF5_LOCK, NETCDFC_LOCK, combine_locks
from xarray.backends.netCDF4_ import NetCDF4ArrayWrapper
from xarray.core import indexing

from .. import files, hdf5
from ..errors import BadInput, one_line
from ..files import atomic_write, check_claim, disk_error
from .dataset import HASH, classic, without_fill_values
from .finished import Content, Format, suffixes
from .tiling import Tiling

COMPRESSION: dict[str, Any] = {"zlib": True, "complevel": 4, "shuffle": True, "fletcher32": True}
ROW_VALUES = 1 << 16  # number of values that are read together from a variable without chunks
MAX_ROW_VALUES = 1 << 23  # largest number of values in a row of chunks that is read as a whole
# The libraries below netCDF4 are not thread-safe. Xarray reads under the same lock.
NETCDF_LOCK = combine_locks([NETCDFC_LOCK, HDF5_LOCK])


def write(ds: xr.Dataset, path: Path) -> None:
    """Write a Dataset as a compressed NetCDF file, which appears whole or not at all."""
    floats = {name for name, variable in ds.data_vars.items() if variable.dtype.kind == "f"}
    encoding: dict[str, dict[str, Any]] = {
        str(name): {"_FillValue": np.nan if name in floats else None} | (COMPRESSION if variable.ndim else {})
        for name, variable in ds.variables.items()
    }
    with _file_with_hash(path) as temporary:
        ds.assign_attrs(classic(ds.attrs)).to_netcdf(
            temporary, engine="netcdf4", format="NETCDF4", encoding=encoding
        )


@contextmanager
def _file_with_hash(path: Path) -> Iterator[Path]:
    """Yield the temporary path of a file. When the context is closed, the file gets a hash and is moved to `path`."""
    with atomic_write(path) as temporary:
        try:
            yield temporary
            with NETCDF_LOCK, netCDF4.Dataset(temporary, "r+") as file:
                file.setncattr(HASH, _hash(file))
        except (RuntimeError, OSError) as error:
            raise disk_error(error, path) from None


def _limit_cache(variable: netCDF4.Variable[Any]) -> None:
    """Limit the cache of a variable to two chunks, because each chunk is used once and the default is 64 MB for a variable."""
    if isinstance(chunks := variable.chunking(), list):
        variable.set_var_chunk_cache(size=16 * math.prod(chunks))


def _hash(file: netCDF4.Dataset, *, by_chunks: bool = False) -> str:
    """Return the hash of a file's dimensions, variables, and attributes other than HASH. Values enter in C order or chunk by chunk."""
    digest = hashlib.sha256()

    def add(*facts: Any) -> None:
        digest.update(json.dumps(facts, sort_keys=True).encode())

    file.set_auto_maskandscale(False)
    file.set_auto_chartostring(False)
    add({name: len(dimension) for name, dimension in file.dimensions.items()}, _attributes(file))
    for name, variable in sorted(file.variables.items()):
        shape, chunks = variable.shape, variable.chunking()
        add(name, variable.dimensions, str(variable.dtype), _attributes(variable))
        blocks = Tiling.of(shape, ROW_VALUES)
        if isinstance(chunks, list):
            lengths = [max(min(pair), 1) for pair in zip(chunks, shape, strict=True)]
            if not by_chunks:  # A whole row of chunks is contiguous in C order.
                first = next((i for i, length in enumerate(lengths) if length > 1), len(shape) - 1)
                lengths[first + 1 :] = (max(n, 1) for n in shape[first + 1 :])
            if by_chunks or math.prod(lengths) <= MAX_ROW_VALUES:
                blocks = Tiling(shape, tuple(lengths))
            else:  # The row is too large for memory. Chunks are read again for each block of MAX_ROW_VALUES.
                blocks = Tiling.of(shape, MAX_ROW_VALUES)
        _limit_cache(variable)
        for box in blocks:
            values = np.asarray(variable[box or ...])
            if values.dtype.kind in "OSU":
                add(values.astype(str).ravel().tolist())
            else:
                digest.update(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).data)
    return digest.hexdigest()


def _attributes(owner: Any) -> dict[str, Any]:
    """Return the attributes of a file or variable except HASH, as lists of kind, size and exact value."""
    values = {name: np.asarray(owner.getncattr(name)) for name in owner.ncattrs() if name != HASH}
    return {name: [v.dtype.kind, v.dtype.itemsize, repr(v.tolist())] for name, v in values.items()}


class _Store(xr.backends.NetCDF4DataStore):
    """A NetCDF file for xarray that raises BadInput if the library finds damage."""

    def open_store_variable(self, name: str, var: Any) -> xr.Variable:
        """Return a variable of the file, whose values are read through `_Array`."""
        variable = super().open_store_variable(name, var)
        _limit_cache(var)
        return variable.copy(deep=False, data=indexing.LazilyIndexedArray(_Array(name, self)))


class _Array(NetCDF4ArrayWrapper):
    """A variable that raises BadInput if values cannot be read."""

    def _getitem(self, key: Any) -> Any:
        try:
            return super()._getitem(key)
        except (RuntimeError, OSError, IndexError) as error:
            raise BadInput(
                f"{self.datastore._filename}: the values of {self.variable_name} are damaged: {one_line(error)}"
            ) from None


class NetCDF(Format):
    """Atlases as NetCDF files."""

    def write(self, content: Content, path: Path | str) -> None:
        ds, names, chunk = content.ds, content.names, content.chunk
        coordinates = " ".join(str(name) for name in ds.coords if name not in ds.dims)
        with (
            _file_with_hash(Path(path)) as temporary,
            NETCDF_LOCK,
            netCDF4.Dataset(temporary, "w", format="NETCDF4") as file,
        ):
            for dim, length in ds.sizes.items():
                file.createDimension(str(dim), length)
            for name, array in ds.variables.items():
                is_data, dimensions = name in ds.data_vars, [str(dim) for dim in array.dims]
                fill = np.nan if is_data and array.dtype.kind == "f" else False
                options: dict[str, Any] = {"fill_value": fill}
                if dimensions:
                    options |= COMPRESSION | {"chunksizes": [chunk[d] for d in dimensions]}
                variable = file.createVariable(str(name), array.dtype, dimensions, **options)
                variable.set_auto_maskandscale(False)
                variable.setncatts(array.attrs | ({"coordinates": coordinates} if is_data else {}))
                _limit_cache(variable)
                if name not in names and array.chunks is None:
                    variable[...] = array.values
                elif name not in names:  # a parameter too large for memory
                    array.data.store(variable, lock=False, scheduler="synchronous")
            for box, values in content.blocks:
                for name, part in values.items():
                    file[name][box] = part
            file.setncatts(classic(content.attributes()))

    def open_dataset(self, path: Path | str) -> xr.Dataset:
        """Open a file lazily. Raise BadInput if the file cannot be read, or claims more values than the file can hold."""
        try:
            hdf5.check_contained(path)
            with ExitStack() as stack:
                store = _Store.open(str(path))
                stack.callback(store.close)
                file = store.ds  # xarray acquires NETCDF_LOCK here
                with NETCDF_LOCK:
                    variables = [v for g in (file, *file.groups.values()) for v in g.variables.values()]
                    claimed = (math.prod(v.shape) * getattr(v.dtype, "itemsize", 8) for v in variables)
                    check_claim(sum(claimed), Path(path).stat().st_size)
                ds = xr.open_dataset(store, chunks=None)
                stack.pop_all()
        except Exception as error:  # A damaged file may raise any error.
            raise hdf5.unreadable(path, error) from None
        ds.encoding["source"] = str(path)
        ds.attrs.pop(HASH, None)
        return without_fill_values(ds)

    def verify(self, path: Path | str) -> None:
        try:
            hdf5.check_contained(path)
            with NETCDF_LOCK, netCDF4.Dataset(path) as file:
                expected = file.__dict__.get(HASH)
                # Earlier versions hashed values in the order of the chunks.
                is_sound = expected is None or expected in (_hash(file, by_chunks=c) for c in (False, True))
        except Exception as error:  # A damaged file may raise any error.
            raise hdf5.unreadable(path, error, "damaged") from None
        if expected is None:
            raise BadInput(f"{path}: has no hash: another program or an earlier version wrote it")
        if not is_sound:
            raise BadInput(f"{path}: changed or damaged: its hash differs")

    def has_hash(self, path: Path | str) -> bool:
        # A damaged attribute name may raise any error.
        with suppress(Exception), NETCDF_LOCK, netCDF4.Dataset(Path(path)) as file:
            return HASH in file.ncattrs()
        return False

    def writable(self, path: Path | str, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path:
        return files.writable(path, suffixes(), force=force, inputs=inputs)


FORMAT = NetCDF()
