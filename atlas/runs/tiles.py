"""Tiles of a run on disk: for each a NetCDF file, and a JSON file (its sidecar) with its hash and cost."""

from __future__ import annotations

import hashlib
import math
import os
import socket
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from ..files import atomic_write, disk_error, one_line, sealed, unsealed
from ..flags import Label, Status
from ..io import netcdf
from ..io.checksums import NETCDF_LOCK
from ..scene.model import Scene
from ..variables import variables
from .tiling import Tiling


class DamagedTileError(Exception):
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


class TileFiles:
    """The tiles of one run, in one folder.

    Parameters
    ----------
    folder : Path
    key : str
        Key of the run, written into every file.
    scene : Scene
    tiling : Tiling
    """

    def __init__(self, folder: Path, key: str, scene: Scene, tiling: Tiling):
        self.folder = folder
        self.key = key
        self.dims = netcdf.dims(scene)
        self.types = tile_types(scene)
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
        self, tile: int, columns: dict[str, np.ndarray], *, computed: int, seconds: float, by: str
    ) -> None:
        """Write a tile and then its sidecar, which marks the tile as written.

        Parameters
        ----------
        tile : int
        columns : dict of str to array
            Everything that `tile_types` names, each of shape (points of the tile,).
        computed : int
            Points where the family exists; all others are `not_computed` for good.
        seconds : float
            Wall-clock time that the tile took.
        by : str
            What computed it, such as "16 threads".

        Raises
        ------
        OSError
            If the disk is full or cannot be written.
        """
        path, shape = self.path(tile), self.tiling.shape_of(tile)
        with atomic_write(path) as temporary:
            try:
                # Made in memory and written when closed: such a file, unlike others, has no time stamp inside.
                with NETCDF_LOCK, netCDF4.Dataset(temporary, "w", diskless=True, persist=True) as file:
                    file.setncatts({"atlas_key": self.key, "atlas_tile": tile})
                    for name, length in zip(self.dims, shape, strict=True):
                        file.createDimension(name, length)
                    for name, dtype in self.types.items():
                        variable = file.createVariable(
                            name, dtype, self.dims, fill_value=False, **netcdf.COMPRESSION
                        )
                        variable[:] = columns[name].astype(dtype, copy=False).reshape(shape)
                sha256 = hashlib.sha256(temporary.read_bytes()).hexdigest()
            except (RuntimeError, OSError) as error:
                raise disk_error(error, path) from None
        sidecar = {
            "key": self.key, "tile": tile, "sha256": sha256, "points": math.prod(shape),
            "host": socket.gethostname(), "computed": computed, "seconds": seconds, "by": by,
        }  # fmt: skip
        with atomic_write(self.path(tile, ".json")) as temporary:
            temporary.write_text(sealed(sidecar), encoding="utf-8")

    def read(self, tile: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """Read variables of a tile after checking its hash, key, shape and number of computed points.

        Parameters
        ----------
        tile : int
        names : iterable of str, optional
            Default: all variables.

        Returns
        -------
        dict of str to array
            Each of the shape of the tile.

        Raises
        ------
        FileNotFoundError
            If the tile is not written.
        DamagedTileError
            If it is, but fails a check.
        """
        sidecar, shape = self._sidecar(tile), self.tiling.shape_of(tile)
        try:
            content = self.path(tile).read_bytes()
        except (FileNotFoundError, IsADirectoryError):
            raise DamagedTileError("its file is missing") from None
        if hashlib.sha256(content).hexdigest() != sidecar.get("sha256"):
            raise DamagedTileError("its hash differs")
        flags = [name for name in ("label", "status") if name in self.types]
        selected = list(self.types if names is None else names)
        try:
            with NETCDF_LOCK, netCDF4.Dataset("tile.nc", memory=content) as file:
                file.set_auto_maskandscale(False)
                if (file.getncattr("atlas_key"), file.getncattr("atlas_tile")) != (self.key, tile):
                    raise DamagedTileError("it is a tile of another run or place")
                arrays = {name: np.asarray(file[name][...]) for name in {*selected, *flags}}
        except (OSError, RuntimeError, AttributeError, IndexError) as error:
            raise DamagedTileError(f"it does not open: {error}") from None
        if any(array.shape != shape or array.dtype != self.types[name] for name, array in arrays.items()):
            raise DamagedTileError("its shape or type is wrong")
        points = math.prod(shape)
        not_computed = points - sidecar.get("computed", -1)
        missing = {"label": (Label.NOT_COMPUTED,), "status": (Status.NOT_COMPUTED, Status.IMPOSSIBLE_BODY)}
        if sidecar.get("points") != points or any(
            np.isin(arrays[name], missing[name]).sum() != not_computed for name in flags
        ):
            raise DamagedTileError("it contains points that are not computed")
        return {name: arrays[name] for name in selected}

    def status(self, tiles: Iterable[int] | None = None) -> TileStatus:
        """Check tiles (default: all), reading the whole of every file."""
        names = self._file_names()
        status = TileStatus()
        written: list[int] = []
        for tile in range(self.tiling.count) if tiles is None else tiles:
            (written if f"{tile:08d}.json" in names else status.missing).append(tile)
        with ThreadPoolExecutor(4) as pool:
            for tile, error in zip(written, pool.map(self._error, written), strict=True):
                if error is None:
                    status.done.append(tile)
                elif isinstance(error, DamagedTileError):
                    status.damaged[tile] = str(error)
                else:  # removed in the meantime
                    status.missing.append(tile)
        return status

    def sidecars(self) -> Iterator[dict[str, Any]]:
        """Sidecars of all tiles that are written, those that cannot be read left out."""
        for name in self._file_names():
            if name.endswith(".json") and not name.startswith("."):
                with suppress(FileNotFoundError, DamagedTileError):
                    yield self._sidecar(int(name[:8]))

    def _file_names(self) -> set[str]:
        """Names of the files in the folder."""
        return {entry.name for entry in os.scandir(self.folder)} if self.folder.is_dir() else set()

    def _sidecar(self, tile: int) -> dict[str, Any]:
        """The sidecar of a tile; see `read` for what it raises."""
        try:
            sidecar = unsealed(self.path(tile, ".json").read_bytes())
        except (ValueError, IsADirectoryError) as error:
            raise DamagedTileError(f"its sidecar cannot be read: {one_line(error)}") from None
        if sidecar.get("key") != self.key or sidecar.get("tile") != tile:
            raise DamagedTileError("its sidecar is of another run or tile")
        return sidecar

    def _error(self, tile: int) -> Exception | None:
        """Error on reading a tile, if any."""
        try:
            self.read(tile, ())
        except (FileNotFoundError, DamagedTileError) as error:
            return error
        return None
