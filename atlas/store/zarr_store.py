"""The finished atlas as a Zarr store, written by xarray and zarr.

Each object has a CRC-32C, which any reader checks. The attribute HASH is written last, so that an unfinished store is never taken for
an atlas. The first part of HASH is a hash of the root metadata, and is checked when a store is opened. The second part is a hash of all
other objects. `verify` checks the second part, because readers take lost objects for fill values and misplaced objects for data.
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import io
import json
import math
import os
import re
import warnings
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends.zarr import ZarrArrayWrapper, ZarrStore
from xarray.core import indexing

from .. import files
from .._version import __version__
from ..errors import BadInput, one_line
from ..files import MAX_RATIO, MIN_CLAIM, TEMPORARY, atomic_folder, check_claim, hash_of
from ..hdf5 import MAX_CHUNK_BYTES, MAX_NAMES
from .dataset import EARLIER_HASHES, HASH, VERSION, without_fill_values
from .finished import METADATA, STORE, Content, Format, is_store, suffixes
from .place import Folder, Place, place_at

try:
    import zarr
    from google_crc32c import value as crc32c
    from zarr.abc.store import OffsetByteRequest, RangeByteRequest, SuffixByteRequest
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.core.buffer import Buffer
    from zarr.errors import ZarrUserWarning
    from zarr.storage import LocalStore, ObjectStore, WrapperStore
except ImportError:
    raise BadInput("Zarr stores need the package zarr: python -m pip install zarr") from None

# Names of objects in a store, including the group `atlas` that versions before 0.1.0 wrote.
OWN = re.compile(r"atlas/([\w/-]+\.(json|claim|pack|nc|bin)|clock)|[^/]+/(zarr\.json|c(/\d+)*)|zarr\.json")
MAX_OBJECT_BYTES = 1 << 31
MAX_WHOLE = 1 << 20  # A coordinate of up to this many values is a single object, which opens faster.
# PLAIN codecs do not compress. Versions before 0.1.0 used sharding_indexed. The unpacked size is checked for PACKING codecs.
PLAIN = {"bytes", "crc32c", "sharding_indexed", "transpose", "vlen-bytes", "vlen-utf8"}
PACKING = {"blosc", "gzip", "zstd"}
CODECS = {"compressors": [BloscCodec(cname="zstd", clevel=3, shuffle="shuffle"), Crc32cCodec()]}


class PlaceStore(WrapperStore[Any]):
    """A place as a store of the package zarr. A missing chunk raises BadInput if `is_whole`, and otherwise means fill values."""

    def __init__(
        self,
        place: Place,
        *,
        read_only: bool = True,
        is_whole: bool = False,
        packed: Mapping[str, tuple[str, int, int]] | None = None,
        has_checksums: bool = False,
        stamp: object = None,
    ):
        form, where = (LocalStore, place.path) if isinstance(place, Folder) else (ObjectStore, place.store)
        super().__init__(form(where, read_only=read_only))
        self.place, self.hashes = place, dict[str, str]()
        self.is_whole, self.has_checksums = is_whole, has_checksums
        self.stamp = stamp  # `Place.stamp` of METADATA when the store was opened
        # `packed` maps the name of an array to the codec of the array's objects and to the least and most bytes of an unpacked object.
        self.packed = {} if packed is None else packed
        self.folder = os.path.realpath(place.path) if isinstance(place, Folder) else ""

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Buffer | None:
        name = key.partition("/")[0]
        damaged = f"{self.place}: the values of {name} are damaged: the object {key}"
        try:
            if self.folder and os.path.realpath(where := os.path.join(self.folder, key)) != where:
                raise ValueError("it is no regular file (a symbolic link, or in one, which is not followed)")
            content = await asyncio.to_thread(self.place.read, key, MAX_OBJECT_BYTES)
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            if self.is_whole and "/c" in key:
                self.check_stamp()
                raise BadInput(f"{damaged} is lost") from None
            return None
        except ValueError as error:
            raise BadInput(f"{self.place}/{key}: {error}") from None
        if "/c" in key:
            if self.is_whole:
                await asyncio.to_thread(self.check_stamp)
            # The checksum is checked here, because codecs report errors after unpacking and without the name of the object.
            if self.has_checksums and int.from_bytes(content[-4:], "little") != crc32c(content[:-4]):
                raise BadInput(damaged)
            if name in self.packed:
                codec, least, most = self.packed[name]
                if not least <= _unpacked_bytes(content, codec, most) <= most:
                    raise BadInput(f"{damaged} does not unpack to the numbers of its chunk")
        match byte_range:
            case RangeByteRequest():
                content = content[byte_range.start : byte_range.end]
            case OffsetByteRequest():
                content = content[byte_range.offset :]
            case SuffixByteRequest():
                content = content[-byte_range.suffix :]
        return prototype.buffer.from_bytes(content)

    def check_stamp(self) -> None:
        """Raise BadInput if the store was replaced. Call this after a read, as a new store writes metadata before objects."""
        if self.stamp != self.place.stamp(METADATA):
            raise BadInput(f"{self.place}: was replaced or removed after it was opened; open it again")

    async def set(self, key: str, value: Buffer) -> None:
        content = value.to_bytes()
        self.hashes[key] = hashlib.sha256(content).hexdigest()
        await asyncio.to_thread(self.place.write, key, content, durable=False)


class _Store(ZarrStore):
    """A Zarr store for xarray that raises BadInput, with the name of the array, for any error in values."""

    def open_store_variable(self, name: str) -> xr.Variable:
        """Return a variable of the store. `_Array` reads the values of the variable."""
        variable = super().open_store_variable(name)
        array = _Array(self.members[name])
        array.what = f"{self.zarr_group.store.place}: the values of {name}"
        return variable.copy(deep=False, data=indexing.LazilyIndexedArray(array))


class _Array(ZarrArrayWrapper):
    """An array that raises BadInput if values cannot be read."""

    __slots__ = ("what",)
    what: str  # names the array and the store in messages

    def __getitem__(self, key: Any) -> Any:
        try:
            return super().__getitem__(key)
        except BadInput:
            raise
        except Exception as error:  # A codec may fail, or shapes may not fit.
            raise BadInput(f"{self.what} are damaged: {one_line(error)}") from None


def _unpacked_bytes(content: bytes, codec: str, most: int) -> int:
    """Return the unpacked size of an object in bytes, or -1 if it is unknown. For gzip, bytes are counted up to most + 1."""
    if codec == "blosc":
        return int.from_bytes(content[4:8], "little")
    if codec == "gzip":
        with suppress(OSError, EOFError, zlib.error):
            return len(gzip.open(io.BytesIO(content)).read(most + 1))
        return -1
    # By RFC 8878, a frame begins with magic number, descriptor, window and dictionary, and size of the content.
    descriptor = content[4] if content[:4] == b"\x28\xb5\x2f\xfd" and len(content) > 4 else 0
    is_single, flag = descriptor >> 5 & 1, descriptor >> 6
    start, length = 5 + (not is_single) + (0, 1, 2, 4)[descriptor & 3], (is_single, 2, 4, 8)[flag]
    size = int.from_bytes(content[start : start + length], "little")
    return size + 256 * (length == 2) if length else -1


def _codec(array: zarr.Array[Any]) -> str:
    """Return the name of the codec that compresses an array, or "". Raise ValueError if the unpacked size may have no limit."""
    codecs = getattr(array.metadata, "codecs", ())  # Metadata of format 2 have no codecs.
    names = [str(codec.to_dict()["name"]) for codec in codecs]
    packing = [name for name in names if name not in PLAIN]
    if len(packing) > 1 or not PACKING.issuperset(packing):
        raise ValueError(
            f"the codecs of {array.basename} may unpack to more than its chunks ({', '.join(names)})"
        )
    return packing[0] if packing else ""


def _root_hash(metadata: dict[str, Any]) -> str:
    """Return the hash of the root metadata without the attribute HASH."""
    attributes = {name: value for name, value in metadata["attributes"].items() if name != HASH}
    return hash_of(metadata | {"attributes": attributes})


def _objects_hash(hashes: Mapping[str, str]) -> str:
    """Return a hash of the names and hashes of all objects except the root metadata."""
    return hash_of({name: each for name, each in hashes.items() if name != METADATA})


def _attributes_of(place: Place) -> dict[str, Any]:
    """Return the attributes of a Zarr store, or no attributes if they cannot be read."""
    try:
        return dict(json.loads(place.read(METADATA))["attributes"])
    except (FileNotFoundError, NotADirectoryError, LookupError, TypeError, ValueError, RecursionError):
        return {}


class Zarr(Format):
    """Atlases as Zarr stores, in folders and on object stores."""

    def write(self, content: Content, path: Path | str) -> None:
        """Write an atlas as in `Format.write`. A killed process may leave an atlas, marked as unfinished, on an object store."""
        ds, names, chunk = content.ds, content.names, content.chunk
        with (
            atomic_folder(path) if isinstance(path, Path) else nullcontext(path) as where,
            warnings.catch_warnings(),
            zarr.config.set({"array.write_empty_chunks": True}),
        ):
            # The specification of Zarr 3 does not have consolidated metadata yet.
            warnings.simplefilter("ignore", ZarrUserWarning)
            place = place_at(where)
            # The atlas is marked as unfinished before earlier objects are removed, because the process may be killed at any time.
            unfinished: dict[str, Any] = {VERSION: __version__}
            metadata: dict[str, Any] = {"zarr_format": 3, "node_type": "group", "attributes": unfinished}
            place.write(METADATA, json.dumps(metadata).encode())
            if not isinstance(place, Folder):
                place.clear(but=METADATA)
            store, encoding, lazy = PlaceStore(place, read_only=False), dict[Any, Any](), dict[Any, Any]()
            for name, variable in ds.variables.items():
                lengths = [min(chunk[str(dim)], ds.sizes[dim]) for dim in variable.dims]
                if name not in names and variable.size <= MAX_WHOLE:
                    lengths = list(variable.shape)
                encoding[name] = CODECS | ({"chunks": lengths} if lengths else {})
                if name in names or variable.chunks is not None:
                    lazy[name] = variable.chunk(dict(zip(variable.dims, lengths, strict=True)))
            template = ds.drop_attrs(deep=False).assign_attrs(unfinished).assign(lazy)
            template.to_zarr(store, mode="a", compute=False, consolidated=False, encoding=encoding)
            group = zarr.open_group(store, mode="r+", use_consolidated=False)
            for name, variable in ds.variables.items():  # write parameters that are too large for memory
                if variable.chunks is not None and name not in names:
                    lazy[name].data.store(group[str(name)], lock=False, scheduler="synchronous")
            arrays: dict[str, Any] = {name: group[name] for name in names}
            with ThreadPoolExecutor(8) as pool:
                for box, values in content.blocks:
                    writes = [pool.submit(arrays[name].__setitem__, box, v) for name, v in values.items()]
                    for write in writes:
                        write.result()
            zarr.consolidate_metadata(store)
            metadata = json.loads(place.read(METADATA))
            for name, value in content.attributes().items():
                plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
                metadata["attributes"][str(name)] = plain
            metadata["attributes"][HASH] = f"{_root_hash(metadata)}-{_objects_hash(store.hashes)}"
            place.write(METADATA, json.dumps(metadata).encode())

    def open_dataset(self, path: Path | str) -> xr.Dataset:
        """Open any Zarr store lazily. Raise BadInput if the store is unfinished or damaged, or claims more data than its objects hold."""
        place = place_at(path)
        try:
            stamp, metadata = place.stamp(METADATA), json.loads(place.read(METADATA))
            attributes = metadata["attributes"]
            is_own = HASH in attributes
            if is_own and attributes[HASH].partition("-")[0] != _root_hash(metadata):
                raise ValueError("its metadata were changed since it was written")
            if attributes.keys() == {VERSION}:
                raise BadInput(
                    f"{path}: unfinished: the command that wrote it was ended; the same command finishes it"
                )
            is_whole = is_own or "atlas_seal" in attributes
            consolidated = (metadata.get("consolidated_metadata") or {}).get("metadata") or {}
            is_consolidated = bool(consolidated)
            if len(consolidated) > MAX_NAMES:
                raise ValueError(f"it has more than {MAX_NAMES} arrays")
            packed = dict[str, tuple[str, int, int]]()
            store = PlaceStore(place, is_whole=is_whole, packed=packed, has_checksums=is_own, stamp=stamp)
            group = zarr.open_group(store, mode="r", use_consolidated=is_consolidated)
            claimed = 0
            for count, (name, array) in enumerate(group.arrays(), 1):
                size = math.prod(array.shape) * array.dtype.itemsize
                claimed += size
                chunk_bytes = math.prod(array.chunks) * array.dtype.itemsize
                limits = (chunk_bytes, chunk_bytes) if array.dtype.kind in "biuf" else (0, MAX_CHUNK_BYTES)
                if codec := _codec(array):
                    packed[name] = codec, *limits
                if count > MAX_NAMES:
                    raise ValueError(f"it has more than {MAX_NAMES} arrays")
                for chunk in (array.chunks, array.shards or ()):
                    if math.prod(chunk) * array.dtype.itemsize > max(MAX_CHUNK_BYTES, size):
                        raise ValueError(f"the chunks of {name} are larger than the array")
            if claimed > MIN_CLAIM and isinstance(place, Folder):
                stored = 0
                for stored in accumulate(file.stat().st_size for file in place.path.rglob("*")):
                    if stored * MAX_RATIO >= claimed:  # Compressed, `claimed` bytes may fit into these files.
                        break
                check_claim(claimed, stored)
            own = _Store.open_group(store, mode="r", consolidated=is_consolidated)
            ds = xr.open_dataset(own, chunks=None)
        except BadInput:
            raise
        except FileNotFoundError:
            raise BadInput(f"{path}: not a Zarr store: there is no {METADATA} in it") from None
        except Exception as error:  # Damaged metadata may raise any error.
            raise BadInput(f"{path}: not a Zarr store that can be read ({one_line(error)})") from None
        for variable in ds.variables.values():
            if "flag_values" in variable.attrs:
                variable.attrs["flag_values"] = np.array(variable.attrs["flag_values"], variable.dtype)
        ds.encoding[HASH] = ds.attrs.pop(HASH, None)
        ds.attrs = {name: value for name, value in ds.attrs.items() if name not in EARLIER_HASHES}
        return without_fill_values(ds)

    def verify(self, path: Path | str) -> None:
        with self.open_dataset(path) as ds:  # `open_dataset` checks the hash of the root metadata.
            expected, place = ds.encoding[HASH], place_at(path)
        if expected is None:
            raise BadInput(
                f"{path}: has no hash: another program or an earlier version wrote it, or it is unfinished"
            )
        names = [name for name in place.walk() if not TEMPORARY.fullmatch(name.rpartition("/")[2])]
        try:
            with ThreadPoolExecutor(8) as pool:
                contents = pool.map(
                    lambda name: hashlib.sha256(place.read(name, MAX_OBJECT_BYTES)).hexdigest(), names
                )
                actual = _objects_hash(dict(zip(names, contents, strict=True)))
        except (FileNotFoundError, ValueError) as error:
            raise BadInput(f"{path}: damaged: {one_line(error)}") from None
        if expected.partition("-")[2] != actual:
            raise BadInput(f"{path}: changed or damaged: its objects are not those that were written")

    def has_hash(self, path: Path | str) -> bool:
        return HASH in _attributes_of(place_at(path))

    def stamp(self, path: Path | str) -> object:
        place, attributes = place_at(path), _attributes_of(place_at(path))
        is_whole = HASH in attributes or not EARLIER_HASHES.isdisjoint(attributes)
        return place.stamp(METADATA) if is_whole else None

    def writable(self, path: Path | str, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path | str:
        if isinstance(path, Path) and not (is_store(path) and path.is_dir()):
            return files.writable(path, suffixes(), force=force, inputs=inputs)
        if not is_store(path):
            raise BadInput(f"{path}: the name must end in {STORE}")
        files.check_not_input(Path(path), inputs)
        place, contents = place_at(path), place_at(path).walk()
        is_own = not contents or f"atlas/{METADATA}" in contents
        with suppress(FileNotFoundError, ValueError):
            # The bytes are searched for VERSION, because damaged metadata cannot be parsed.
            is_own = VERSION.encode() in place.read(METADATA)
        if not is_own or not all(
            OWN.fullmatch(each) or TEMPORARY.fullmatch(each.rpartition("/")[2]) for each in contents
        ):
            raise BadInput(files.foreign_message(path))
        if self.stamp(path) is not None and not force:
            raise BadInput(files.exists_message(path))
        return path


FORMAT = Zarr()
