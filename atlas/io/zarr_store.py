"""Zarr stores of atlases, in version 3 of the format.

An object of a store holds the values of one variable at the points of one tile of the grid. The group RUN holds what else
belongs to the run that computes the store, with a sidecar for each tile, which has the hashes of its objects. `seal` writes the
coordinates, then the metadata of the store with the hashes of its other objects. Zarr takes a missing object for one of fill
values, and metadata without checksum as they are; therefore an object is compared with its hash before it is first read.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Collection, Mapping
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..files import MIN_CLAIM, check_claim, one_line, unsealed
from .storage import Folder, Storage, located, storage_at

METADATA = "zarr.json"
SUFFIX = ".zarr"
RUN = "atlas"  # the group of the run
SEAL = "atlas_seal"  # attribute with the hash of the metadata of a store
OBJECTS = "atlas_objects"  # JSON text: hashes of the objects that belong to no tile, by their names
KEY = "atlas_run_key"  # key of the run, which its sidecars carry
COMPRESSION_LEVEL = 3
TILES_PER_FOLDER = 1000
MAX_OBJECT_BYTES = 1 << 31
# Files of a store of another run, or of another program.
OWN = re.compile(rf"{RUN}/([\w/-]+\.(json|claim|pack|nc|bin)|clock)|[^/]+/(zarr\.json|c(/\d+)*)|zarr\.json")

Box = tuple[slice, ...]
Lengths = tuple[int, ...]


def zarr_package() -> Any:
    """The package zarr; BadInput if it is not installed."""
    try:
        import zarr
    except ImportError:
        raise BadInput("Zarr stores need the package zarr: python -m pip install zarr") from None
    return zarr


def tile_name(tile: int, count: int, suffix: str, per_folder: int = TILES_PER_FOLDER) -> str:
    """Name of a file of a tile, in folders of limited size."""
    folder = f"{tile // per_folder:05d}/" if count > per_folder else ""
    return f"{folder}{tile:08d}{suffix}"


def _array(
    contents: dict[str, Any],
    name: str,
    dtype: Any,
    shape: Lengths,
    chunk: Lengths,
    tile: Lengths,
    **metadata: Any,
) -> Any:
    """An empty array in memory, whose objects are those of a store."""
    zarr = zarr_package()
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


def encode(
    name: str, values: np.ndarray, box: Box, shape: Lengths, chunk: Lengths, tile: Lengths
) -> dict[str, bytes]:
    """Content of the object of a variable in the box of a tile, by its name."""
    contents = dict[str, Any]()
    _array(contents, name, values.dtype, shape, chunk, tile)[box] = values
    return {key: each.to_bytes() for key, each in contents.items() if not key.endswith(METADATA)}


def decode(
    name: str, dtype: str, content: bytes, box: Box, shape: Lengths, chunk: Lengths, tile: Lengths
) -> np.ndarray:
    """Inverse of `encode`."""
    contents = dict[str, Any]()
    array = _array(contents, name, dtype, shape, chunk, tile)
    place = [part.start // length for part, length in zip(box, tile, strict=True)]
    contents["/".join([name, "c", *map(str, place)])] = zarr_package().core.buffer.cpu.Buffer.from_bytes(
        content
    )
    return np.asarray(array[box])


def seal(
    root: Storage,
    ds: xr.Dataset,
    names: Collection[str],
    chunk: Mapping[str, int],
    tile: Mapping[str, int],
    key: str,
) -> None:
    """Write all of a store but the variables `names`, which the tiles of a run hold; its metadata are written last."""
    coordinates = " ".join(str(name) for name in ds.coords if name not in ds.dims)
    objects, metadata = dict[str, str](), dict[str, Any]()
    for variable_name, variable in ds.variables.items():
        name, contents, dims = str(variable_name), dict[str, Any](), [str(dim) for dim in variable.dims]
        attributes = variable.attrs | ({"coordinates": coordinates} if name in ds.data_vars else {})
        lengths = tuple(chunk[dim] for dim in dims), tuple(tile[dim] for dim in dims)
        _array(
            contents, name, variable.dtype, variable.shape, *lengths,
            dimension_names=dims, attributes=_plain(attributes),
        )  # fmt: skip
        content = contents[f"{name}/{METADATA}"].to_bytes()
        metadata[name] = json.loads(content)
        root.write(f"{name}/{METADATA}", content)
        if name in names:
            continue
        starts = [range(0, count, length) for count, length in zip(variable.shape, lengths[1], strict=True)]
        for place in product(*starts):  # a parameter may be too large for memory
            ends = (
                min(a + length, n) for a, length, n in zip(place, lengths[1], variable.shape, strict=True)
            )
            box = tuple(map(slice, place, ends))
            encoded = encode(name, np.asarray(variable[box].values), box, variable.shape, *lengths)
            for object_name, content in encoded.items():
                root.write(object_name, content)
                objects[object_name] = hashlib.sha256(content).hexdigest()
    group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
    root.write(f"{RUN}/{METADATA}", json.dumps(group).encode())
    attributes = _plain(ds.attrs) | {KEY: key, OBJECTS: json.dumps(objects)}
    consolidated = {"kind": "inline", "must_understand": False, "metadata": metadata}
    whole: dict[str, Any] = group | {"attributes": attributes, "consolidated_metadata": consolidated}
    attributes[SEAL] = _seal_of(whole)
    root.write(METADATA, json.dumps(whole).encode())


def _seal_of(metadata: Mapping[str, Any]) -> str:
    """Hash of the metadata of a store."""
    attributes = {name: value for name, value in metadata["attributes"].items() if name != SEAL}
    content = json.dumps({**metadata, "attributes": attributes}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON has them."""
    return {
        str(name): value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for name, value in attributes.items()
    }


def is_whole(path: Path) -> bool:
    """Whether a folder is a sealed store, in which nothing else is."""
    try:
        metadata = json.loads((path / METADATA).read_bytes())
        names = {*metadata["consolidated_metadata"]["metadata"], RUN, METADATA}
        files = [file.relative_to(path) for file in path.rglob("*") if file.is_file()]
        return bool(metadata["attributes"][SEAL] == _seal_of(metadata)) and all(
            file.parts[0] in names and OWN.fullmatch(file.as_posix()) for file in files
        )
    except (OSError, LookupError, TypeError, ValueError):
        return False


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
        own = not {SEAL, OBJECTS, KEY}.isdisjoint(attributes)
        if own and attributes.get(SEAL) != _seal_of(metadata):
            raise ValueError("its metadata were changed since it was written")
        store = root.zarr(zarr)
        if own:
            arrays = metadata["consolidated_metadata"]["metadata"]
            store = _checked_store(zarr)(store, path, root, attributes, arrays)
        group = zarr.open_group(store, mode="r", use_consolidated=own)
        claimed = sum(array.size * array.dtype.itemsize for _, array in group.arrays())
        if claimed > MIN_CLAIM and isinstance(root, Folder):
            check_claim(claimed, sum(file.stat().st_size for file in root.path.rglob("*")))
        ds = xr.open_zarr(store, consolidated=own, chunks=None)
    except BadInput:
        raise
    except Exception as error:  # damaged metadata may raise any error
        raise BadInput(f"{path}: not a Zarr store that can be read ({one_line(error)})") from None
    for variable in ds.variables.values():
        if "flag_values" in variable.attrs:
            variable.attrs["flag_values"] = np.array(variable.attrs["flag_values"], variable.dtype)
    for name in (SEAL, OBJECTS, KEY, "atlas_checksum", "atlas_chunks"):  # the last two of earlier versions
        ds.attrs.pop(name, None)
    return ds


@lru_cache
def _checked_store(zarr: Any) -> Any:
    """A class of the package zarr: a store that compares each object with its hash before it is first read."""

    class CheckedStore(zarr.storage.WrapperStore):  # type: ignore[misc]
        def __init__(
            self,
            store: Any,
            path: Any,
            root: Storage,
            attributes: Mapping[str, Any],
            arrays: Mapping[str, Any],
        ):
            super().__init__(store)
            self.arguments = path, root, attributes, arrays
            self.objects, self.verified = json.loads(attributes[OBJECTS]), {METADATA}

        def _with_store(self, store: Any) -> Any:
            return type(self)(store, *self.arguments)

        def check(self, key: str, content: bytes) -> None:
            path, root, attributes, arrays = self.arguments
            name = key.partition("/")[0]
            try:
                computed = None
                if key not in self.objects:
                    grid = [arrays[name]["shape"], arrays[name]["chunk_grid"]["configuration"]["chunk_shape"]]
                    counts = [-(-count // length) for count, length in zip(*grid, strict=True)]
                    place = tuple(map(int, key.split("/")[2:]))
                    tile = int(np.ravel_multi_index(place, counts))
                    file = f"{RUN}/tiles/{tile_name(tile, math.prod(counts), '.json')}"
                    sidecar = unsealed(root.read(file))
                    if (sidecar["key"], sidecar["tile"]) != (attributes[KEY], tile):
                        raise ValueError("its sidecar is of another run or tile")
                    expected, computed = sidecar["hash"][name], sidecar["computed"]
                    actual = tile_hash(attributes[KEY], tile, content, computed)
                else:
                    expected, actual = self.objects[key], hashlib.sha256(content).hexdigest()
                if expected != actual:
                    raise ValueError("its objects are not those that were written, or not in their places")
            except (ValueError, LookupError, OSError, TypeError) as error:
                raise BadInput(f"{path}: the values of {name} are damaged: {one_line(error)}") from None
            self.verified.add(key)

        async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
            if key not in self.verified and "/c" in key:
                content = await self._store.get(key, prototype)
                self.check(key, b"" if content is None else content.to_bytes())
            return await self._store.get(key, prototype, byte_range)

    return CheckedStore


def tile_hash(key: str, tile: int, content: bytes, computed: int) -> str:
    """SHA-256 of a content together with its run, its place in the grid and the number of computed points."""
    digest = hashlib.sha256(json.dumps([key, tile, computed]).encode())
    digest.update(content)
    return digest.hexdigest()
