"""Zarr stores of atlases, in version 3 of the format.

An object of a store holds the values of one variable at the points of one tile of the grid. The group RUN holds what else
belongs to the run that computes the store, with a sidecar for each tile, which has the hashes of its objects. `seal` writes the
coordinates, the hashes of all objects by their places and, last, the metadata with a hash of all that. Zarr takes a missing object
for one of fill values, and metadata as they are; therefore an object is compared with its hash before it is first read.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import accumulate, product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..files import MAX_RATIO, MIN_CLAIM, check_claim, is_temporary, one_line
from .storage import Folder, Storage, located, storage_at

METADATA = "zarr.json"
SUFFIX = ".zarr"
RUN = "atlas"  # the group of the run
OBJECTS = f"{RUN}/objects.json"  # hashes of the objects of a store by their names
SEAL = "atlas_seal"  # attribute with a hash of the metadata of a store and of OBJECTS
COMPRESSION_LEVEL = 3
MAX_OBJECT_BYTES = 1 << 31
MAX_WHOLE = 1 << 20  # values of a coordinate in one object, so that a store with a long axis opens at once
# Files of a store of another run, or of another program.
OWN = re.compile(rf"{RUN}/([\w/-]+\.(json|claim|pack|nc|bin)|clock)|[^/]+/(zarr\.json|c(/\d+)*)|zarr\.json")

Box = tuple[slice, ...]
Lengths = tuple[int, ...]
Layout = tuple[Lengths, Lengths, Lengths]  # shape of an array, of its chunks, and of the part of it in a tile


def zarr_package() -> Any:
    """The package zarr; BadInput if it is not installed."""
    try:
        import zarr
    except ImportError:
        raise BadInput("Zarr stores need the package zarr: python -m pip install zarr") from None
    return zarr


def _array(contents: dict[str, Any], name: str, dtype: Any, layout: Layout, **metadata: Any) -> Any:
    """An empty array in memory, whose objects are those of a store."""
    zarr, (shape, chunk, tile) = zarr_package(), layout
    shards = tuple(-(-length // part) * part for length, part in zip(tile, chunk, strict=True))
    codecs = zarr.codecs
    return zarr.create_array(
        zarr.storage.MemoryStore(contents),
        name=name, shape=shape, dtype=dtype, chunks=chunk, shards=shards or None,
        compressors=[codecs.BloscCodec(cname="zstd", clevel=COMPRESSION_LEVEL, shuffle="shuffle"), codecs.Crc32cCodec()],
        fill_value=math.nan if np.dtype(dtype).kind == "f" else 0,
        config={"write_empty_chunks": True},  # so that a missing object is always a loss
        **metadata,
    )  # fmt: skip


def encode(name: str, values: np.ndarray, box: Box, layout: Layout) -> dict[str, bytes]:
    """Content of the object of a variable in the box of a tile, by its name."""
    contents = dict[str, Any]()
    _array(contents, name, values.dtype, layout)[box] = values
    return {key: each.to_bytes() for key, each in contents.items() if not key.endswith(METADATA)}


def decode(name: str, dtype: str, content: bytes, box: Box, layout: Layout) -> np.ndarray:
    """Inverse of `encode`."""
    contents = dict[str, Any]()
    array = _array(contents, name, dtype, layout)
    place = [part.start // length for part, length in zip(box, layout[2], strict=True)]
    buffer = zarr_package().core.buffer.cpu.Buffer
    contents["/".join([name, "c", *map(str, place)])] = buffer.from_bytes(content)
    return np.asarray(array[box])


def seal(
    root: Storage, ds: xr.Dataset, objects: dict[str, str], dims: tuple[str, ...], layout: Layout
) -> None:
    """Write all of a store but the objects with these hashes, which the tiles of a run are; its metadata are written last."""
    coordinates = " ".join(str(name) for name in ds.coords if name not in ds.dims)
    names, metadata = {name.partition("/")[0] for name in objects}, dict[str, Any]()
    lengths = dict(zip(dims, zip(*layout, strict=True), strict=True))
    for variable_name, variable in ds.variables.items():
        name, contents = str(variable_name), dict[str, Any]()
        own: Any = tuple(tuple(lengths[str(dim)][i] for dim in variable.dims) for i in range(3))
        if name not in names and math.prod(own[0]) <= MAX_WHOLE:
            own = (own[0],) * 3
        shape, _, tile = own
        attributes = variable.attrs | ({"coordinates": coordinates} if name in ds.data_vars else {})
        described = {"dimension_names": [*map(str, variable.dims)], "attributes": _plain(attributes)}
        _array(contents, name, variable.dtype, own, **described)
        content = contents[f"{name}/{METADATA}"].to_bytes()
        metadata[name] = json.loads(content)
        root.write(f"{name}/{METADATA}", content)
        if name in names:
            continue
        for place in product(
            *map(range, [0] * len(shape), shape, tile)
        ):  # a parameter may be too large for memory
            box = tuple(slice(a, min(a + length, n)) for a, length, n in zip(place, tile, shape, strict=True))
            for object_name, content in encode(name, np.asarray(variable[box].values), box, own).items():
                root.write(object_name, content)
                objects[object_name] = hashlib.sha256(content).hexdigest()
    group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
    root.write(f"{RUN}/{METADATA}", json.dumps(group).encode())
    content = json.dumps(objects, sort_keys=True).encode()  # the same by any process that seals
    root.write(OBJECTS, content)
    consolidated = {"kind": "inline", "must_understand": False, "metadata": metadata}
    whole: dict[str, Any] = group | {"attributes": _plain(ds.attrs), "consolidated_metadata": consolidated}
    whole["attributes"][SEAL] = _seal_of(whole, content)
    root.write(METADATA, json.dumps(whole).encode())


def _seal_of(metadata: Mapping[str, Any], objects: bytes) -> str:
    """Hash of the metadata of a store and of the hashes of its objects."""
    attributes = {name: value for name, value in metadata["attributes"].items() if name != SEAL}
    content = json.dumps({**metadata, "attributes": attributes}, sort_keys=True)
    return hashlib.sha256(content.encode() + objects).hexdigest()


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON has them."""
    return {
        str(name): value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for name, value in attributes.items()
    }


def is_store(path: Path | str) -> bool:
    """Whether what `located` gives has the name of a store."""
    return str(path).lower().endswith(SUFFIX)


def is_whole(root: Storage) -> bool:
    """Whether this is a sealed store, in which nothing else is."""
    try:
        metadata = json.loads(root.read(METADATA))
        names = {*metadata["consolidated_metadata"]["metadata"], RUN, METADATA}
        sealed = metadata["attributes"][SEAL] == _seal_of(metadata, root.read(OBJECTS, MAX_OBJECT_BYTES))
        contents = root.walk()
        return sealed and are_own(contents) and {name.partition("/")[0] for name in contents} <= names
    except (OSError, LookupError, TypeError, ValueError):
        return False


def are_own(contents: Iterable[str]) -> bool:
    """Whether all contents have names of a store and of its run, or of temporary files."""
    return all(OWN.fullmatch(name) or is_temporary(name.rpartition("/")[2]) for name in contents)


def is_sealed(root: Storage) -> bool:
    """Whether a store is written, by `seal`."""
    try:
        return SEAL in json.loads(root.read(METADATA))["attributes"]
    except (OSError, LookupError, TypeError, ValueError):
        return False


def open_store(path: Path | str) -> xr.Dataset:
    """Open a store lazily; BadInput without the package zarr, or if it is damaged or too large for its files.

    A store of another program, or of a version without a seal, is read as it is. Reading finds damaged values.
    """
    zarr, root = zarr_package(), storage_at(located(path))
    try:
        metadata = json.loads(root.read(METADATA))
        attributes = metadata["attributes"]
        store, own = root.zarr(zarr), SEAL in attributes or OBJECTS.rpartition("/")[2] in root.names(RUN)
        if own:
            objects = root.read(OBJECTS, MAX_OBJECT_BYTES)
            if attributes.get(SEAL) != _seal_of(metadata, objects):
                raise ValueError("its metadata were changed since it was written")
            store = _checked_store()(store, path, json.loads(objects))
        group = zarr.open_group(store, mode="r", use_consolidated=own)
        claimed = sum(array.size * array.dtype.itemsize for _, array in group.arrays())
        if claimed > MIN_CLAIM and isinstance(root, Folder):
            for stored in accumulate(file.stat().st_size for file in root.path.rglob("*")):
                if stored * MAX_RATIO >= claimed:  # a large store has many files
                    break
            check_claim(claimed, stored)
        ds = xr.open_zarr(store, consolidated=own, chunks=None)
    except BadInput:
        raise
    except Exception as error:  # damaged metadata may raise any error
        raise BadInput(f"{path}: not a Zarr store that can be read ({one_line(error)})") from None
    for variable in ds.variables.values():
        if "flag_values" in variable.attrs:
            variable.attrs["flag_values"] = np.array(variable.attrs["flag_values"], variable.dtype)
    for name in (SEAL, "atlas_checksum", "atlas_chunks"):  # the last two of earlier versions
        ds.attrs.pop(name, None)
    return ds


@lru_cache
def _checked_store() -> Any:
    """A class of the package zarr: a store that compares each object with its hash before it is first read."""

    class CheckedStore(zarr_package().storage.WrapperStore):  # type: ignore[misc]
        def __init__(self, store: Any, path: Path | str, objects: dict[str, str]):
            super().__init__(store)
            self.path, self.objects = path, objects

        def _with_store(self, store: Any) -> Any:
            return type(self)(store, self.path, self.objects)

        async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
            if key in self.objects:
                content = await self._store.get(key, prototype)
                if content is None or hashlib.sha256(content.to_bytes()).hexdigest() != self.objects[key]:
                    name = key.partition("/")[0]
                    raise BadInput(
                        f"{self.path}: the values of {name} are damaged: not the object {key} that was written"
                    )
                self.objects.pop(key, None)  # compared once
            return await self._store.get(key, prototype, byte_range)

    return CheckedStore
