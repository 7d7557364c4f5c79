"""A tile is a file or object that holds a part of a run. It consists of a header in JSON, columns of values, and a hash.

    {"key": ..., "tile": 12, "points": 8192, ..., "columns": {"label": ["|i1", 371], ...}}
    columns, each compressed by itself, with the first bytes of all values, then the second bytes, and so on
    SHA-256 of header and columns

A tile exists as a whole or not at all, and each reader compares the hash.
"""

from __future__ import annotations

import errno
import hashlib
import json
import re
import socket
import zlib
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import one_line
from ..files import check_types
from .place import Folder, Place
from .tally import Tally, Totals
from .tiling import Tiling

SUFFIX = ".tile"
LEVEL = 1  # compression level of zlib; higher levels take much time and save little space
HASH_BYTES = hashlib.sha256().digest_size
MAX_TILE_BYTES = 1 << 31
TILES_PER_FOLDER = 1000
TILE = re.compile(rf"(?:\d{{5}}/)?(\d{{8}}){re.escape(SUFFIX)}")
# `computed` counts the points that have a motion. `by` says what computed the tile. `reused` counts points taken from each earlier atlas.
HEADER_TYPES = {
    "computed": int, "seconds": (int, float), "by": str, "cpu": str, "reused": dict, "tally": dict
}  # fmt: skip
# Tiles of fewer points are read from a folder one after the other, because threads would wait for each other.
MIN_PARALLEL_POINTS = 4096


class DamagedTile(Exception):
    """An error for a tile that exists but cannot be used. The message gives the reason."""


def encode(header: Mapping[str, Any], columns: Mapping[str, np.ndarray], level: int = LEVEL) -> bytes:
    """Return the bytes of a tile. The columns are flat and of equal length, and are compressed at a level of zlib."""
    parts, table = list[bytes](), {}
    for name, values in columns.items():
        planes = np.ascontiguousarray(values).view(np.uint8).reshape(values.size, -1).T
        parts.append(zlib.compress(np.ascontiguousarray(planes).data, level))
        table[name] = values.dtype.str, len(parts[-1])
    line = json.dumps({**header, "points": values.size, "columns": table}).encode()
    content = b"".join([line, b"\n", *parts])
    return content + hashlib.sha256(content).digest()


def decode(
    content: bytes, facts: Mapping[str, Any], types: Mapping[str, str], most: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header and the columns in `types`. Raise DamagedTile for a wrong hash, a header without `facts`, or over `most` points."""
    whole = memoryview(content)[:-HASH_BYTES]
    if hashlib.sha256(whole).digest() != content[-HASH_BYTES:]:
        raise DamagedTile("its hash differs")
    try:
        place = content.index(b"\n") + 1
        header = json.loads(content[:place])
        if any(header.get(name) != fact for name, fact in facts.items()):
            raise ValueError("it is a tile of another run or place")
        columns, size = dict[str, np.ndarray](), header["points"]
        if type(size) is not int or not 0 < size <= most:
            raise ValueError("its number of points is not allowed")
        for name, (kind, length) in header["columns"].items():
            if name in types:
                dtype = np.dtype(types[name])
                limit = size * dtype.itemsize
                planes = zlib.decompressobj().decompress(whole[place : place + length], limit + 1)
                if dtype.str != kind or len(planes) != limit:
                    raise ValueError("its shape or type is wrong")
                values = np.frombuffer(planes, np.uint8).reshape(dtype.itemsize, size).T
                columns[name] = np.ascontiguousarray(values).view(dtype)[:, 0]
            place += length
        return header, {name: columns[name] for name in types}
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError, zlib.error) as error:
        raise DamagedTile(one_line(error)) from None


@dataclass(eq=False)
class Tiles:
    """The tiles of a run or level. If two processes write the same tile, the last write stays."""

    place: Place
    key: str
    types: Mapping[str, str]
    tiling: Tiling
    points: np.ndarray | None = None  # flat indices of the points, if the tiles cover a part of the grid
    level: int = LEVEL  # compression level of zlib
    listing: tuple[int, set[int]] | None = None  # number of the folder that was listed last, and tiles in it

    def name(self, tile: int, suffix: str = SUFFIX) -> str:
        """Return the name of a tile. The suffix of claims gives the name of the claim on a tile."""
        folder = f"{tile // TILES_PER_FOLDER:05d}/" * (self.tiling.count > TILES_PER_FOLDER)
        return f"{folder}{tile:08d}{suffix}"

    def indices(self, tile: int) -> np.ndarray:
        """Return the flat grid indices of the points of a tile."""
        indices = self.tiling.indices(tile)
        return indices if self.points is None else self.points[indices]

    def write(self, tile: int, columns: Mapping[str, np.ndarray], **facts: Any) -> dict[str, Any]:
        """Write a tile with `facts` for the header, and return the header. Raise OSError if the bytes read back differ."""
        from ..kernel.machine_code import cpu

        columns = {name: columns[name].ravel().astype(kind, copy=False) for name, kind in self.types.items()}
        header = {"key": self.key, "tile": tile, "host": socket.gethostname(), "cpu": cpu(), "reused": {}}
        header |= facts
        header["tally"] = vars(Tally.of(columns))
        name, content = self.name(tile), encode(header, columns, self.level)
        self.place.write(name, content)
        if self.place.read(name, MAX_TILE_BYTES) != content:
            raise OSError(errno.EIO, "read back otherwise than it was written", name)
        return header | {"points": self.tiling.size_of(tile)}

    def read(
        self, tile: int, names: Collection[str] | None = None
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the header of a tile and the variables `names`, by default all. Raise FileNotFoundError or DamagedTile if this fails."""
        types = self.types if names is None else {name: self.types[name] for name in names}
        size = self.tiling.size_of(tile)
        facts = {"key": self.key, "tile": tile, "points": size}
        try:
            header, columns = decode(self.place.read(self.name(tile), MAX_TILE_BYTES), facts, types, size)
            check_types(header, HEADER_TYPES)
            if header["columns"].keys() != self.types.keys():
                raise ValueError("it has other columns")
            check_types(header["reused"], dict.fromkeys(header["reused"], int))
            Tally().add(**header["tally"])
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise DamagedTile(one_line(error)) from None
        shape = self.tiling.shape_of(tile)
        return header, {name: column.reshape(shape) for name, column in columns.items()}

    def check(self, tiles: Iterable[int]) -> tuple[Totals, dict[int, str]]:
        """Return the totals of the sound tiles, and the fault of each damaged tile by tile number. Missing tiles are ignored."""
        totals, damaged = Totals(), dict[int, str]()

        def header(tile: int) -> dict[str, Any] | None:
            try:
                return self.read(tile, ())[0]
            except DamagedTile as error:
                damaged[tile] = str(error)
            except FileNotFoundError:
                pass
            return None

        small = isinstance(self.place, Folder) and self.tiling.size_of(0) < MIN_PARALLEL_POINTS
        with ThreadPoolExecutor(8) as pool:
            for each in filter(None, (map if small else pool.map)(header, tiles)):
                totals.add(each)
        return totals, dict(sorted(damaged.items()))

    def written(self) -> set[int]:
        """Return the numbers of the written tiles."""
        return {int(match[1]) for name in self.place.walk() if (match := TILE.fullmatch(name))}

    def missing(self) -> list[int]:
        """Return the numbers of the missing tiles in ascending order."""
        return sorted({*range(self.tiling.count)} - self.written())

    def is_written(self, tile: int) -> bool:
        """Whether any process has finished a tile."""
        return self.place.stamp(self.name(tile)) is not None

    def was_written(self, tile: int) -> bool:
        """Whether a tile was in the last listing of the folder. This is faster than `is_written` for many tiles."""
        part = tile // TILES_PER_FOLDER
        if self.listing is None or self.listing[0] != part:
            names = self.place.names(self.name(tile).rpartition("/")[0])
            self.listing = part, {int(match[1]) for name in names if (match := TILE.fullmatch(name))}
        return tile in self.listing[1]
