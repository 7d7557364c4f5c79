"""Tiles of a run: of each a NetCDF file or the objects of a Zarr store, and a JSON file (its sidecar) with hashes and cost."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import socket
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import accumulate, groupby
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
import xarray as xr

from ..errors import shown
from ..files import check_types, disk_error, one_line, process_name, sealed, unsealed
from ..flags import Label, Status
from ..io import netcdf, zarr_store
from ..io.checksums import NETCDF_LOCK
from ..io.storage import CLAIM_INTERVAL, Folder, Stamp, Storage, claim, is_claimed
from ..io.zarr_store import MAX_OBJECT_BYTES
from ..scene import grid
from ..scene.model import Scene
from ..variables import variables

# Below this number of points the tables of a NetCDF-4 file take more room and time than its compression saves.
MIN_COMPRESSED_POINTS = 4096
# Bytes of a sidecar, and of the tables of one variable in a NetCDF-4 file.
SIDECAR_BYTES, TABLE_BYTES = 1200, 3600
CLAIM = ".claim"  # suffix of the file of a tile that a process computes
TILES_PER_FOLDER = 1000
MIN_PACK = 64  # tiles that are worth a new pack
SIDECAR_TYPES = {"points": int, "computed": int, "seconds": (int, float), "by": str, "reused": dict}

COUNTED = (
    "label", "label_inertial", "label_any_axis", "label_any_axis_inertial", "regularity", "status", "agreement", "computed",
)  # fmt: skip
# Groups of points whose expected errors are printed apart: drifting motions amplify errors, steady ones do not.
GROUPS = {"steady": (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION), "drifting": (Label.DRIFTING,)}
# Histogram of errors: quarters of a decade from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161
# Flags of points that are not computed.
MISSING = {
    "label": [int(Label.NOT_COMPUTED)],
    "status": [int(Status.NOT_COMPUTED), int(Status.IMPOSSIBLE_BODY)],
}


class DamagedTile(Exception):
    """A tile that exists but cannot be used; the message gives the reason."""


@dataclass
class TileStatus:
    """State of some tiles of a run."""

    done: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    damaged: dict[int, str] = field(default_factory=dict)  # tile -> reason


def tile_types(scene: Scene) -> dict[str, str]:
    """Names and types of the columns of a tile: its variables, and the parameters the family is solved for."""
    registry = variables(scene.system)
    return {name: registry[name].dtype for name in scene.outputs} | dict.fromkeys(scene.solve, "float64")


def computed_counts(columns: Mapping[str, np.ndarray]) -> set[int]:
    """Number of points that are computed, by each variable that shows it."""
    return {
        columns[name].size - sum(int(np.count_nonzero(columns[name] == flag)) for flag in flags)
        for name, flags in MISSING.items()
        if name in columns
    }


class Tally:
    """What the summary of a run prints of its points: numbers that are added or compared, tile by tile."""

    def __init__(self) -> None:
        # Points by flag variable and flag, or by group of GROUPS and bin of errors; largest values by variable or group.
        self.counts, self.largest = defaultdict[str, Counter[str]](Counter), dict[str, float]()

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray]) -> Tally:
        """Tally of some points, whose variables are of the same shape; other variables are ignored."""
        tally = cls()
        counted = {name: columns[name] for name in COUNTED if name in columns}
        if "error_estimate" in columns and "label" in columns:
            for name, labels in GROUPS.items():
                values = columns["error_estimate"][np.isin(columns["label"], labels)]
                values = values[~np.isnan(values)]
                if values.size:
                    with np.errstate(divide="ignore"):
                        bins = np.ceil(BINS_PER_DECADE * (np.log10(np.fmax(values, 0.0)) - LOWEST_DECADE))
                    counted[name] = np.clip(bins, 0, BINS - 1).astype(np.int64)
                    tally.largest[name] = float(values.max())
        if "integral_drift" in columns:
            tally.largest["integral_drift"] = float(np.nanmax(columns["integral_drift"], initial=0.0))
        for name, values in counted.items():
            unique, counts = np.unique(values, return_counts=True)
            tally.counts[name] = Counter(dict(zip(map(str, unique.tolist()), counts.tolist(), strict=True)))
        return tally

    def add(self, counts: Mapping[str, Mapping[str, int]], largest: Mapping[str, float]) -> None:
        """Add the entries of the tally of other points."""
        for name, number in counts.items():
            total = self.counts[name]
            for flag, n in number.items():
                total[flag] += int(n)
        for name, value in largest.items():
            self.largest[name] = max(self.largest.get(name, float(value)), float(value))


@dataclass
class Totals:
    """Sums over the tiles whose sidecars are added."""

    points: int = 0
    tallied: int = 0  # points in the tally, which sidecars of an older version do not have
    seconds: float = 0.0
    tiles_by: Counter[str] = field(default_factory=Counter)  # by the processes that computed them
    reused: Counter[str] = field(default_factory=Counter)  # points by the earlier atlas
    tally: Tally = field(default_factory=Tally)

    def add(self, sidecar: Mapping[str, Any]) -> None:
        """Add a tile."""
        self.points += sidecar["points"]
        self.seconds += sidecar["seconds"]
        self.tiles_by[sidecar["by"]] += 1
        self.reused.update(sidecar["reused"])
        with suppress(LookupError, TypeError, ValueError, AttributeError):
            self.tally.add(**sidecar["tally"])
            self.tallied += sidecar["points"]


@dataclass(eq=False)
class TileFiles:
    """The tiles of one run: of each a NetCDF file, then a sidecar that marks it as written.

    A pack holds the sidecars of many tiles whose files were read and not changed since, so that these are not read again.
    """

    storage: Storage
    key: str
    dims: tuple[str, ...]
    types: Mapping[str, str]
    tiling: Tiling
    is_flat: bool = False  # all tiles are in one folder
    listed: tuple[int, set[int]] | None = None  # number of a folder, and the tiles written in it
    _last: int = 0  # tile that this process wrote
    # By shape: the head of a classic NetCDF file that the library has read, but for the number of its tile.
    _heads: dict[tuple[int, ...], bytes] = field(default_factory=dict)

    @property
    def per_folder(self) -> int:
        """Tiles in a folder."""
        return MAX_TILES if self.is_flat else TILES_PER_FOLDER

    def name(self, tile: int, suffix: str = ".nc") -> str:
        """Name of the file of a tile, or with suffix ".json" of its sidecar."""
        folder = f"{tile // self.per_folder:05d}/" if self.tiling.count > self.per_folder else ""
        return f"{folder}{tile:08d}{suffix}"

    def path(self, tile: int, suffix: str = ".nc") -> Path:
        """Path of a file in a folder."""
        return self.folder / self.name(tile, suffix)

    @property
    def folder(self) -> Path:
        """The folder of the tiles."""
        assert isinstance(self.storage, Folder)
        return self.storage.path

    def is_written(self, tile: int) -> bool:
        """Whether some process has finished writing a tile, whose values may be damaged since."""
        with suppress(FileNotFoundError, DamagedTile):
            return bool(self._sidecar(tile))
        return False

    def was_written(self, tile: int) -> bool:
        """Whether the folder of a tile had its sidecar when it was last listed; this needs no look at each tile."""
        part = tile // self.per_folder
        if self.listed is None or self.listed[0] != part:
            self.listed = part, _written(self.storage.names(self._folder(part)))
        return tile in self.listed[1]

    def written_count(self) -> int:
        """Number of the tiles that are written; some may be damaged."""
        return sum(len(_written(self.storage.names(self._folder(part)))) for part in self._parts())

    def write(
        self,
        tile: int,
        columns: Mapping[str, np.ndarray],
        *,
        computed: int,
        seconds: float,
        by: str,
        reused: Mapping[str, int] | None = None,
    ) -> None:
        """Write a tile, then the sidecar that marks it as written.

        `computed` counts the points where the family exists, `reused` those of earlier atlases by what these are. Raises
        OSError if the tile reads back otherwise.
        """
        columns = {
            name: columns[name].astype(dtype, copy=False).reshape(self.tiling.shape_of(tile))
            for name, dtype in self.types.items()
        }
        contents = self._encoded(tile, columns, computed)
        for name, (storage, place) in self._objects(tile, self.types).items():
            storage.write(place, contents[name])
            if storage.read(place, MAX_OBJECT_BYTES) != contents[name]:
                raise OSError(errno.EIO, "read back otherwise than it was written", place)
        sidecar = {
            "key": self.key, "tile": tile, "points": self.tiling.size_of(tile), "computed": computed,
            "hash": {name: self._hash(tile, content, computed) for name, content in contents.items()},
            "tally": vars(Tally.of(columns)), "host": socket.gethostname(), "seconds": seconds, "by": by,
            "reused": dict(reused or {}),
        }  # fmt: skip
        self.storage.write(self.name(tile, ".json"), sealed(sidecar).encode())
        last, self._last = self._last, tile
        if last // self.per_folder != tile // self.per_folder:
            self.status(self._tiles_of(last // self.per_folder))

    def _encoded(self, tile: int, columns: Mapping[str, np.ndarray], computed: int) -> dict[str, bytes]:
        """What holds the values of a tile, by the names that the sidecar gives it."""
        small = self.tiling.size_of(tile) < MIN_COMPRESSED_POINTS
        kind: Literal["NETCDF3_64BIT_OFFSET", "NETCDF4"] = "NETCDF3_64BIT_OFFSET" if small else "NETCDF4"
        # Filled first, because the library leaves the bytes between variables as they are in memory otherwise.
        options = {"fill_value": None} if small else {"fill_value": False, **netcdf.COMPRESSION}
        with self.storage.temporary() as temporary:
            path = temporary.with_name(self.name(tile).rpartition("/")[2])
            try:
                # Made in memory and written when closed: such a file, unlike others, has no time stamp inside.
                with (
                    NETCDF_LOCK,
                    netCDF4.Dataset(temporary, "w", format=kind, diskless=True, persist=True) as file,
                ):
                    file.setncatts({"atlas_key": self.key, "atlas_tile": tile})
                    for name, length in zip(self.dims, self.tiling.shape_of(tile), strict=True):
                        file.createDimension(name, length)
                    for name, dtype in self.types.items():
                        file.createVariable(name, dtype, self.dims, **options)[:] = columns[name]
                contents = {"": temporary.read_bytes()}
                self._arrays(tile, contents, computed, ())
            except (RuntimeError, OSError) as error:
                raise disk_error(error, path) from None
            except DamagedTile as error:  # netCDF writes short files in NetCDF-3 without an error
                differs = RuntimeError(f"read back otherwise than it was computed: {error}")
                raise disk_error(differs, path) from None
        return contents

    @contextmanager
    def held(self, tile: int) -> Iterator[Callable[[], None]]:
        """Keep the claim of a tile while it is computed, by calls of what this gives, and release it."""
        name, renewed = self.name(tile, CLAIM), time.monotonic()

        def keep() -> None:
            nonlocal renewed
            if time.monotonic() - renewed > CLAIM_INTERVAL:
                renewed = time.monotonic()
                with suppress(OSError):
                    self.storage.write(name, process_name().encode(), durable=False)

        try:
            yield keep
        finally:
            with suppress(OSError):
                self.storage.remove(name)

    def claim(self, tile: int) -> bool:
        """Whether this process may compute a tile, which it claims: no other one that is at work does."""
        return claim(self.storage, self.name(tile, CLAIM))

    def remove_claims(self) -> None:
        """Remove the claims of processes that were killed."""
        for folder in map(self._folder, self._parts()):
            for name in self.storage.names(folder):
                if name.endswith(CLAIM) and not is_claimed(self.storage, folder + name):
                    with suppress(OSError):
                        self.storage.remove(folder + name)

    def read(
        self, tile: int, names: Iterable[str] | None = None, *, sidecar: Mapping[str, Any] | None = None
    ) -> dict[str, np.ndarray]:
        """Checked variables of a tile, default all; FileNotFoundError, DamagedTile if a check fails."""
        sidecar, names = sidecar or self._sidecar(tile), list(self.types if names is None else names)
        try:
            return self._arrays(tile, self._contents(tile, sidecar, names), sidecar["computed"], names)
        except DamagedTile:
            with suppress(OSError):  # so that the next run reads the tile
                self.storage.remove(self._pack_name(tile // self.per_folder))
            raise

    def read_all(self) -> Iterator[tuple[dict[str, Any], dict[str, np.ndarray]]]:
        """Sidecar, of a pack where there is one, and variables of one tile after the other; DamagedTile if one is not as written."""
        for part in self._parts():
            # Whatever the stamps are: the files must have the hashes.
            packed = {tile: sidecar for tile, _, sidecar in self._pack(part)}
            for tile in self._tiles_of(part):
                try:
                    sidecar = packed.get(tile) or self._sidecar(tile)
                    yield sidecar, self.read(tile, sidecar=sidecar)
                except (FileNotFoundError, DamagedTile) as error:
                    raise DamagedTile(f"tile {tile}: {error}") from None

    def _objects(self, tile: int, names: Iterable[str]) -> dict[str, tuple[Storage, str]]:
        """Where the values of a tile are, by the names in its sidecar."""
        return {"": (self.storage, self.name(tile))}

    def _contents(self, tile: int, sidecar: Mapping[str, Any], names: Iterable[str]) -> dict[str, bytes]:
        """What holds some variables of a tile, if it has the hashes of the sidecar; see `read` for what it raises."""
        contents = dict[str, bytes]()
        for name, (storage, place) in self._objects(tile, names).items():
            try:
                content = storage.read(place, MAX_OBJECT_BYTES)
            except (FileNotFoundError, ValueError):
                raise DamagedTile("its file is missing") from None
            if "hash" in sidecar:
                actual, expected = self._hash(tile, content, sidecar["computed"]), sidecar["hash"]
                expected = expected.get(name) if isinstance(expected, dict) else expected
            else:  # of version 0.1.0 before its sidecars had tallies
                actual, expected = hashlib.sha256(content).hexdigest(), sidecar.get("sha256")
            if actual != expected:
                raise DamagedTile("its hash differs")
            contents[name] = content
        return contents

    def _hash(self, tile: int, content: bytes, computed: int) -> str:
        """SHA-256 of a file together with its run, its place in the grid and the number of computed points."""
        digest = hashlib.sha256(f'["{self.key}", {tile}, {computed}]'.encode())
        digest.update(content)
        return digest.hexdigest()

    def _decoded(
        self, tile: int, contents: Mapping[str, bytes], names: Iterable[str]
    ) -> dict[str, np.ndarray]:
        """Variables in what holds them."""
        content, shape, head = contents[""], self.tiling.shape_of(tile), b""
        if content.startswith(b"CDF"):  # each tile opened by the library would take three times as long
            number, layout = content.find(b"atlas_tile") + 20, _layout(tuple(self.types.items()), shape)
            start = len(content) - layout.itemsize  # the file ends with the values
            values = np.frombuffer(content, layout, 1, start)[0]
            head = content[:number] + content[number + 4 : start]
            if head == self._heads.get(shape) and content[number : number + 4] == tile.to_bytes(4, "big"):
                return {name: values[name].astype(self.types[name]) for name in names}
        with NETCDF_LOCK, netCDF4.Dataset("tile.nc", memory=content) as file:
            if (file.getncattr("atlas_key"), file.getncattr("atlas_tile")) != (self.key, tile):
                raise DamagedTile("it is a tile of another run or place")
            file.set_auto_maskandscale(False)
            if any(file[name].shape != shape or file[name].dtype != self.types[name] for name in names):
                raise DamagedTile("its shape or type is wrong")
            if head and all(
                file[name].dtype == dtype and np.array_equal(file[name][...], values[name], equal_nan=True)
                for name, dtype in self.types.items()
            ):
                self._heads[shape] = head
            return {name: np.asarray(file[name][...]) for name in names}

    def _arrays(
        self, tile: int, contents: Mapping[str, bytes], computed: int, names: Iterable[str]
    ) -> dict[str, np.ndarray]:
        """Variables of a tile; DamagedTile unless key, shape and number of computed points are right."""
        try:
            arrays = self._decoded(tile, contents, {*names, *self._flags})
        except (OSError, RuntimeError, AttributeError, LookupError, ValueError) as error:
            raise DamagedTile(f"it does not open: {error}") from None
        if computed_counts(arrays) - {computed}:
            raise DamagedTile("it contains points that are not computed")
        return {name: arrays[name] for name in names}

    @property
    def _flags(self) -> list[str]:
        """Variables that show which points are computed."""
        return [name for name in MISSING if name in self.types]

    def missing(self) -> list[int]:
        """Tiles that are not written."""
        return [
            tile
            for part in self._parts()
            for tile in sorted({*self._tiles_of(part)} - _written(self.storage.names(self._folder(part))))
        ]

    def status(self, tiles: Iterable[int] | None = None) -> TileStatus:
        """Check tiles (default: all), reading the whole of every file that is in no pack."""
        status = TileStatus()
        chosen = range(self.tiling.count) if tiles is None else tiles
        for part, group in groupby(chosen, lambda tile: tile // self.per_folder):
            (stamps, packed), wanted, read = self._packed(part), list(group), dict[int, Any]()
            unread = [tile for tile in wanted if tile in stamps and tile not in packed]
            with ThreadPoolExecutor(4) as pool:
                # Threads that read small files take turns, at up to four times the processor time.
                each = map if self.tiling.size_of(0) < MIN_COMPRESSED_POINTS else pool.map
                for tile, result in zip(unread, each(self._checked, unread), strict=True):
                    if isinstance(result, DamagedTile):
                        status.damaged[tile] = str(result)
                    elif not isinstance(result, Exception):  # removed in the meantime
                        read[tile] = result
            packed |= read
            if len(read) >= MIN_PACK:
                content = json.dumps([[tile, stamps[tile], sidecar] for tile, sidecar in packed.items()])
                pack = f"{self._pack_hash(content.encode())}\n{content}".encode()
                with suppress(OSError):
                    self.storage.write(self._pack_name(part), pack, durable=False)
            status.done += [tile for tile in wanted if tile in packed]
            status.missing += [tile for tile in wanted if tile not in packed and tile not in status.damaged]
        return status

    def sidecars(self) -> Iterator[dict[str, Any]]:
        """Readable sidecars of all tiles that are written."""
        for part in self._parts():
            stamps, packed = self._packed(part)
            for tile in stamps:
                with suppress(FileNotFoundError, DamagedTile):
                    yield packed.get(tile) or self._sidecar(tile)

    def _parts(self) -> range:
        """Numbers of the folders of tiles."""
        return range(-(-self.tiling.count // self.per_folder))

    def _tiles_of(self, part: int) -> range:
        """Tiles of a folder."""
        return range(part * self.per_folder, min((part + 1) * self.per_folder, self.tiling.count))

    def _folder(self, part: int) -> str:
        """Where the files of a folder are."""
        return self.name(part * self.per_folder, "")[:-8]

    def _packed(self, part: int) -> tuple[dict[int, list[Stamp | None]], dict[int, dict[str, Any]]]:
        """Stamps of the files of each written tile of a folder; the sidecars of those that its pack has with these stamps."""
        files = self.storage.stamps(self._folder(part))
        stamps = {
            tile: [files[f"{tile:08d}.json"], files.get(f"{tile:08d}.nc")] for tile in sorted(_written(files))
        }
        return stamps, {
            tile: sidecar for tile, stamp, sidecar in self._pack(part) if stamps.get(tile) == stamp
        }

    def _pack(self, part: int) -> list[tuple[int, list[Stamp | None], dict[str, Any]]]:
        """Of each tile in the pack of a folder: its number, the stamps of its files, and its sidecar."""
        with suppress(OSError, ValueError):
            digest, _, content = self.storage.read(self._pack_name(part), MAX_OBJECT_BYTES).partition(b"\n")
            if self._pack_hash(content).encode() == digest:
                return list(json.loads(content))
        return []

    def _pack_hash(self, content: bytes) -> str:
        """Hash of a pack together with its run; packs of older versions, of another form, do not have it."""
        return hashlib.sha256(f"sidecars of {self.key}".encode() + content).hexdigest()

    def _pack_name(self, part: int) -> str:
        """Name of the pack of a folder."""
        return f"{part:05d}.pack"

    def _sidecar(self, tile: int) -> dict[str, Any]:
        """The sidecar of a tile; see `read` for what it raises."""
        try:
            sidecar = {"reused": {}} | unsealed(self.storage.read(self.name(tile, ".json")))
            check_types(sidecar, SIDECAR_TYPES)
            check_types(sidecar["reused"], dict.fromkeys(sidecar["reused"], int))
        except ValueError as error:
            raise DamagedTile(f"its sidecar cannot be read: {one_line(error)}") from None
        if sidecar.get("key") != self.key or sidecar.get("tile") != tile:
            raise DamagedTile("its sidecar is of another run or tile")
        if sidecar["points"] != self.tiling.size_of(tile):
            raise DamagedTile("it contains points that are not computed")
        return sidecar

    def _checked(self, tile: int) -> dict[str, Any] | Exception:
        """The sidecar of a tile, or the error on reading it; a file that has its hash was read back by `write`."""
        try:
            sidecar = self._sidecar(tile)
            contents = self._contents(tile, sidecar, self.types)
            if "hash" not in sidecar:
                self._arrays(tile, contents, sidecar["computed"], ())
        except (FileNotFoundError, DamagedTile) as error:
            return error
        return sidecar


def _written(names: Iterable[str]) -> set[int]:
    """Tiles whose sidecars are among the names in a folder."""
    return {int(name[:8]) for name in names if name.endswith(".json") and name[:8].isdigit()}


@lru_cache(maxsize=8)
def _layout(types: tuple[tuple[str, str], ...], shape: tuple[int, ...]) -> np.dtype[Any]:
    """Values of variables as a classic NetCDF file has them: big-endian, each from a whole number of 4 bytes on."""
    kinds = [np.dtype((np.dtype(kind).newbyteorder(">"), shape)) for _, kind in types]
    *offsets, end = accumulate([-(-kind.itemsize // 4) * 4 for kind in kinds], initial=0)
    names = [name for name, _ in types]
    return np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": end})


@dataclass(eq=False)
class TileShards(TileFiles):
    """The tiles of a run in a Zarr store: of each an object of every variable, then a sidecar."""

    root: Storage = field(kw_only=True)  # the whole store

    @property
    def layout(self) -> zarr_store.Layout:
        """Lengths of the grid, of its chunks and of its tiles."""
        return self.tiling.shape, self.tiling.chunk, self.tiling.tile

    def _objects(self, tile: int, names: Iterable[str]) -> dict[str, tuple[Storage, str]]:
        place = "/".join(map(str, np.unravel_index(tile, self.tiling.counts)))
        return {name: (self.root, f"{name}/c/{place}") for name in {*names, *self._flags}}

    def _encoded(self, tile: int, columns: Mapping[str, np.ndarray], computed: int) -> dict[str, bytes]:
        contents, box = dict[str, bytes](), self.tiling.slices(tile)
        for name in self.types:
            (contents[name],) = zarr_store.encode(name, columns[name], box, self.layout).values()
        return contents

    def _decoded(
        self, tile: int, contents: Mapping[str, bytes], names: Iterable[str]
    ) -> dict[str, np.ndarray]:
        box = self.tiling.slices(tile)
        return {
            name: zarr_store.decode(name, self.types[name], contents[name], box, self.layout)
            for name in names
        }

    def seal(self, ds: xr.Dataset) -> None:
        """Write what the store of a dataset has beside the tiles."""
        objects = {
            place: sidecar["hash"][name]
            for sidecar in self.sidecars()
            for name, (_, place) in self._objects(sidecar["tile"], self.types).items()
        }
        zarr_store.seal(self.root, ds, objects, self.dims, self.layout)

    def _hash(self, tile: int, content: bytes, computed: int) -> str:
        return hashlib.sha256(content).hexdigest()  # in the sidecar, with run, place and number


# Work of a tile, in points times steps: a few seconds of one processor at about 6 ns each.
TILE_POINT_STEPS = 5e8
# The same in a Zarr store, whose objects are to be large: two minutes, and as many chunks of the cheapest points.
SHARD_POINT_STEPS, SHARD_CHUNKS = 2e10, 8
# With fewer points the blocks of the kernel would not be full.
MIN_POINTS_PER_TILE = 512
# Limits of what a run folder may claim. The tiles of the largest grid, cut evenly, are half as many.
MAX_TILES, MAX_TILE_POINTS = 8_000_000, 1_000_000


@dataclass(frozen=True)
class Tiling:
    """A grid cut into boxes, each a contiguous range of flat C-order indices; the last may be shorter."""

    shape: tuple[int, ...]
    tile: tuple[int, ...]  # 1, ..., 1, some rows, then whole axes

    @classmethod
    def of(cls, shape: tuple[int, ...], max_points: int) -> Tiling:
        """Cut a grid evenly into tiles of at most so many points."""
        tile, remaining = [], max_points
        for count in reversed(shape):
            tile.append(math.ceil(count / math.ceil(count / min(count, max(remaining, 1)))))
            remaining //= count
        return cls(shape, tuple(reversed(tile)))

    def check(self) -> None:
        """Raise ValueError unless these are boxes as `of` makes them, and not too many or too large."""
        if len(self.tile) != len(self.shape) or not all(type(length) is int for length in self.tile):
            raise ValueError(
                f"tile = {shown(self.tile)}: must be a whole number for each of {len(self.shape)} axes"
            )
        cut = next((i for i, length in enumerate(self.tile) if length > 1), len(self.tile))
        if (
            not all(1 <= length <= count for length, count in zip(self.tile, self.shape, strict=True))
            or self.tile[cut + 1 :] != self.shape[cut + 1 :]
            or math.prod(self.tile) > MAX_TILE_POINTS
            or self.count > MAX_TILES
        ):
            raise ValueError(
                f"tile = {shown(self.tile)}: allowed: some rows of a grid of {shown(self.shape)}, at most"
                f" {MAX_TILE_POINTS} points in each and {MAX_TILES} tiles"
            )

    @property
    def chunk(self) -> tuple[int, ...]:
        """Lengths of the chunks of a joined file or store: as tiles of the cheapest scene, many small ones would be slow to read."""
        cheapest = Tiling.of(self.shape, grid.MAX_POINTS_PER_TILE).tile
        return tuple(map(min, cheapest, self.tile))

    def of_whole_chunks(self) -> Tiling:
        """Tiles of as many chunks as fit into these along an axis that is cut."""
        lengths = [
            length if length == count else length // part * part
            for length, count, part in zip(self.tile, self.shape, self.chunk, strict=True)
        ]
        return Tiling(self.shape, tuple(lengths))

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Number of tiles along each axis."""
        return tuple(-(-count // length) for count, length in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.counts)

    def __iter__(self) -> Iterator[tuple[slice, ...]]:
        return map(self.slices, range(self.count))

    def slices(self, tile: int) -> tuple[slice, ...]:
        """Slices of the grid that a tile covers."""
        first = [int(i) * n for i, n in zip(np.unravel_index(tile, self.counts), self.tile, strict=True)]
        bounds = zip(first, self.tile, self.shape, strict=True)
        return tuple(slice(start, min(start + length, count)) for start, length, count in bounds)

    def shape_of(self, tile: int) -> tuple[int, ...]:
        """Shape of one tile."""
        return tuple(s.stop - s.start for s in self.slices(tile))

    def size_of(self, tile: int) -> int:
        """Number of points of one tile."""
        return math.prod(self.shape_of(tile))

    def indices(self, tile: int) -> np.ndarray:
        """Flat indices of the points of a tile, int64 of shape (points,)."""
        first = int(np.ravel_multi_index(tuple(s.start for s in self.slices(tile)), self.shape))
        return np.arange(first, first + self.size_of(tile))
