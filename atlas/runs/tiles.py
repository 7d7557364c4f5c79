"""Tiles of a run on disk: for each a NetCDF file, and a JSON file (its sidecar) with its hash and cost."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np

from ..errors import shown
from ..files import (
    CLAIM_INTERVAL,
    atomic_write,
    check_types,
    claim,
    disk_error,
    is_claimed,
    one_line,
    read_bytes,
    remove_leftovers,
    sealed,
    unsealed,
)
from ..flags import Label, Status
from ..io import netcdf
from ..io.checksums import NETCDF_LOCK
from ..scene.model import Scene
from ..variables import variables

# Below this number of points the tables of a NetCDF-4 file take more room and time than its compression saves.
MIN_COMPRESSED_POINTS = 4096
# Bytes of a sidecar, and of the tables of one variable in a NetCDF-4 file.
SIDECAR_BYTES, TABLE_BYTES = 1200, 3600
CLAIM = ".claim"  # suffix of the file of a tile that a process computes
STATUS_BATCH = 64  # tiles that a thread checks at a time
SIDECAR_TYPES = {"points": int, "computed": int, "seconds": (int, float), "by": str, "reused": dict}

COUNTED = (
    "label", "label_inertial", "label_any_axis", "label_any_axis_inertial", "regularity", "status", "agreement", "computed",
)  # fmt: skip
# Groups of points whose expected errors are printed apart: drifting motions amplify errors, steady ones do not.
GROUPS = {"steady": (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION), "drifting": (Label.DRIFTING,)}
# Histogram of errors: quarters of a decade from 1e-20 on.
BINS_PER_DECADE, LOWEST_DECADE, BINS = 4, -20, 161


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


class Tally:
    """What the summary of a run prints of its points: numbers that are added or compared, tile by tile."""

    def __init__(self, entries: Mapping[str, Any] | None = None):
        entries = entries or {"counts": {}, "largest": {}}
        self.counts = {  # points by flag variable and flag, or by group of GROUPS and bin of errors
            str(name): Counter({str(value): int(count) for value, count in counts.items()})
            for name, counts in entries["counts"].items()
        }
        self.largest = {str(name): float(value) for name, value in entries["largest"].items()}

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray]) -> Tally:
        """Tally of some points, whose variables are of the same shape; other variables are ignored."""
        tally = cls()
        for name in COUNTED:
            if name in columns:
                tally._count(name, columns[name])
        if "error_estimate" in columns and "label" in columns:
            for name, labels in GROUPS.items():
                values = columns["error_estimate"][np.isin(columns["label"], labels)]
                values = values[~np.isnan(values)]
                if values.size:
                    with np.errstate(divide="ignore"):
                        bins = np.ceil(BINS_PER_DECADE * (np.log10(np.fmax(values, 0.0)) - LOWEST_DECADE))
                    tally._count(name, np.clip(bins, 0, BINS - 1).astype(np.int64))
                    tally.largest[name] = float(values.max())
        if "integral_drift" in columns:
            tally.largest["integral_drift"] = float(np.nanmax(columns["integral_drift"], initial=0.0))
        return tally

    def _count(self, name: str, values: np.ndarray) -> None:
        """Count values."""
        unique, counts = np.unique(values, return_counts=True)
        self.counts[name] = Counter(dict(zip(map(str, unique.tolist()), counts.tolist(), strict=True)))

    def add(self, other: Tally) -> None:
        """Add the tally of other points."""
        for name, counts in other.counts.items():
            self.counts.setdefault(name, Counter()).update(counts)
        for name, value in other.largest.items():
            self.largest[name] = max(self.largest.get(name, value), value)


class TileFiles:
    """The tiles of one run, in one folder."""

    def __init__(
        self, folder: Path, key: str, dims: tuple[str, ...], types: Mapping[str, str], tiling: Tiling
    ):
        self.folder = folder
        self.key = key
        self.dims = dims
        self.types = types
        self.tiling = tiling

    def path(self, tile: int, suffix: str = ".nc") -> Path:
        """File of a tile, or with suffix ".json" its sidecar."""
        return self.folder / f"{tile:08d}{suffix}"

    def is_written(self, tile: int) -> bool:
        """Whether some process has finished writing a tile; the tile may be damaged."""
        return self.path(tile, ".json").exists()

    def written_count(self) -> int:
        """Number of the tiles that are written; some may be damaged."""
        return sum(name.endswith(".json") and not name.startswith(".") for name in self._file_names())

    def is_done(self, tile: int) -> bool:
        """Whether a tile is written and not damaged; reads all of it."""
        return self._error(tile) is None

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
        path, shape = self.path(tile), self.tiling.shape_of(tile)
        columns = {name: columns[name] for name in self.types}
        points = math.prod(shape)
        small = points < MIN_COMPRESSED_POINTS
        kind: Literal["NETCDF3_64BIT_OFFSET", "NETCDF4"] = "NETCDF3_64BIT_OFFSET" if small else "NETCDF4"
        # Filled first, because the library leaves the bytes between variables as they are in memory otherwise.
        options = {"fill_value": None} if small else {"fill_value": False, **netcdf.COMPRESSION}
        with atomic_write(path) as temporary:
            try:
                # Made in memory and written when closed: such a file, unlike others, has no time stamp inside.
                with (
                    NETCDF_LOCK,
                    netCDF4.Dataset(temporary, "w", format=kind, diskless=True, persist=True) as file,
                ):
                    file.setncatts({"atlas_key": self.key, "atlas_tile": tile})
                    for name, length in zip(self.dims, shape, strict=True):
                        file.createDimension(name, length)
                    for name, dtype in self.types.items():
                        variable = file.createVariable(name, dtype, self.dims, **options)
                        variable[:] = columns[name].astype(dtype, copy=False).reshape(shape)
                content = temporary.read_bytes()
            except (RuntimeError, OSError) as error:
                raise disk_error(error, path) from None
            try:
                self._arrays(tile, content, computed, ())
            except DamagedTile as error:  # netCDF writes short files in NetCDF-3 without an error
                differs = OSError(errno.EIO, f"read back otherwise than it was computed: {error}", str(path))
                raise disk_error(differs, path) from None
        sidecar = {
            "key": self.key, "tile": tile, "points": points, "computed": computed,
            "hash": self._hash(tile, content, computed), "tally": vars(Tally.of(columns)),
            "host": socket.gethostname(), "seconds": seconds, "by": by, "reused": dict(reused or {}),
        }  # fmt: skip
        with atomic_write(self.path(tile, ".json")) as temporary:
            temporary.write_text(sealed(sidecar), encoding="utf-8")

    @contextmanager
    def held(self, tile: int) -> Iterator[Callable[[], None]]:
        """Keep the claim of a tile while it is computed, by calls of what this gives, and release it."""
        path, touched = self.path(tile, CLAIM), time.monotonic()

        def keep() -> None:
            nonlocal touched
            if time.monotonic() - touched > CLAIM_INTERVAL:
                touched = time.monotonic()
                with suppress(OSError):
                    os.utime(path)

        try:
            yield keep
        finally:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def claim(self, tile: int) -> bool:
        """Whether this process may compute a tile, which it claims: no other one that is at work does."""
        return claim(self.path(tile, CLAIM))

    def remove_leftovers(self) -> None:
        """Remove temporary files and claims of processes that were killed."""
        remove_leftovers(self.folder)
        for path in self.folder.glob(f"*{CLAIM}"):
            if not is_claimed(path):
                with suppress(OSError):
                    path.unlink(missing_ok=True)

    def read(self, tile: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """Checked variables of a tile, default all; FileNotFoundError, DamagedTile if a check fails."""
        sidecar = self._sidecar(tile)
        content = self._content(tile, sidecar)
        return self._arrays(tile, content, sidecar["computed"], self.types if names is None else names)

    def _content(self, tile: int, sidecar: Mapping[str, Any]) -> bytes:
        """Content of the file of a tile, if it has the hash of the sidecar; see `read` for what it raises."""
        try:
            content = self.path(tile).read_bytes()
        except (FileNotFoundError, IsADirectoryError):
            raise DamagedTile("its file is missing") from None
        if "hash" in sidecar:
            differs = sidecar["hash"] != self._hash(tile, content, sidecar["computed"])
        else:  # of version 0.1.0 before its sidecars had tallies
            differs = sidecar.get("sha256") != hashlib.sha256(content).hexdigest()
        if differs:
            raise DamagedTile("its hash differs")
        return content

    def _hash(self, tile: int, content: bytes, computed: int) -> str:
        """SHA-256 of a file together with its run, its place in the grid and the number of computed points."""
        digest = hashlib.sha256(json.dumps([self.key, tile, computed]).encode())
        digest.update(content)
        return digest.hexdigest()

    def _arrays(
        self, tile: int, content: bytes, computed: int, names: Iterable[str]
    ) -> dict[str, np.ndarray]:
        """Variables of the file of a tile; DamagedTile unless key, shape and number of computed points are right."""
        shape, selected = self.tiling.shape_of(tile), list(names)
        flags = [name for name in ("label", "status") if name in self.types]
        try:
            with NETCDF_LOCK, netCDF4.Dataset("tile.nc", memory=content) as file:
                if (file.getncattr("atlas_key"), file.getncattr("atlas_tile")) != (self.key, tile):
                    raise DamagedTile("it is a tile of another run or place")
                variables = {name: file.variables[name] for name in {*selected, *flags}}
                if any(variable.shape != shape for variable in variables.values()):
                    raise DamagedTile("its shape or type is wrong")
                file.set_auto_maskandscale(False)
                arrays = {name: np.asarray(variable[...]) for name, variable in variables.items()}
        except (OSError, RuntimeError, AttributeError, LookupError) as error:
            raise DamagedTile(f"it does not open: {error}") from None
        if any(array.dtype != self.types[name] for name, array in arrays.items()):
            raise DamagedTile("its shape or type is wrong")
        not_computed = math.prod(shape) - computed
        missing = {"label": (Label.NOT_COMPUTED,), "status": (Status.NOT_COMPUTED, Status.IMPOSSIBLE_BODY)}
        if any(np.isin(arrays[name], missing[name]).sum() != not_computed for name in flags):
            raise DamagedTile("it contains points that are not computed")
        return {name: arrays[name] for name in selected}

    def missing(self) -> list[int]:
        """Tiles that are not written."""
        names = self._file_names()
        return [tile for tile in range(self.tiling.count) if f"{tile:08d}.json" not in names]

    def status(self, tiles: Iterable[int] | None = None) -> TileStatus:
        """Check tiles (default: all), reading the whole of every file."""
        names = self._file_names()
        status = TileStatus()
        written: list[int] = []
        for tile in range(self.tiling.count) if tiles is None else tiles:
            (written if f"{tile:08d}.json" in names else status.missing).append(tile)
        batches = [written[first : first + STATUS_BATCH] for first in range(0, len(written), STATUS_BATCH)]
        # Threads that read small files take turns, at up to four times the processor time.
        small = self.tiling.size_of(0) < MIN_COMPRESSED_POINTS
        with ThreadPoolExecutor(1 if small else 4) as pool:
            errors = chain.from_iterable(pool.map(self._errors, batches))
            for tile, error in zip(written, errors, strict=True):
                if error is None:
                    status.done.append(tile)
                elif isinstance(error, DamagedTile):
                    status.damaged[tile] = str(error)
                else:  # removed in the meantime
                    status.missing.append(tile)
        return status

    def sidecars(self) -> Iterator[dict[str, Any]]:
        """Readable sidecars of all tiles that are written."""
        for name in self._file_names():
            if name.endswith(".json") and not name.startswith("."):
                with suppress(FileNotFoundError, DamagedTile):
                    yield self._sidecar(int(name[:8]))

    def _file_names(self) -> set[str]:
        """Names of the files in the folder."""
        return {entry.name for entry in os.scandir(self.folder)} if self.folder.is_dir() else set()

    def _sidecar(self, tile: int) -> dict[str, Any]:
        """The sidecar of a tile; see `read` for what it raises."""
        try:
            sidecar = {"reused": {}} | unsealed(read_bytes(self.path(tile, ".json")))
            check_types(sidecar, SIDECAR_TYPES)
            check_types(sidecar["reused"], dict.fromkeys(sidecar["reused"], int))
        except ValueError as error:
            raise DamagedTile(f"its sidecar cannot be read: {one_line(error)}") from None
        if sidecar.get("key") != self.key or sidecar.get("tile") != tile:
            raise DamagedTile("its sidecar is of another run or tile")
        if sidecar["points"] != self.tiling.size_of(tile):
            raise DamagedTile("it contains points that are not computed")
        return sidecar

    def _errors(self, tiles: Iterable[int]) -> list[Exception | None]:
        """Error on reading each of some tiles, if any."""
        return [self._error(tile) for tile in tiles]

    def _error(self, tile: int) -> Exception | None:
        """Error on reading a tile, if any; a file that has its hash was read back by `write`."""
        try:
            sidecar = self._sidecar(tile)
            content = self._content(tile, sidecar)
            if "hash" not in sidecar:
                self._arrays(tile, content, sidecar["computed"], ())
        except (FileNotFoundError, DamagedTile) as error:
            return error
        return None


# Work of a tile, in points times steps: a few seconds of one processor at about 6 ns each.
TILE_POINT_STEPS = 5e8
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
    def counts(self) -> tuple[int, ...]:
        """Number of tiles along each axis."""
        return tuple(-(-count // length) for count, length in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.counts)

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
