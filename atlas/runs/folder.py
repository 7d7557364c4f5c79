"""Run folders: a scene in tiles, each a file with its hash, so that nothing whole is lost or done twice.

    NAME/manifest.json        what is computed, by which programs, in which tiles; created once
    NAME/tiles/00000012.nc    variables of one tile
    NAME/tiles/00000012.json  its hash and what is known of its making, written after it
    NAME/progress.json        how far the process got that wrote it last, for people and scripts

Nothing is locked: files appear whole by a move, and a tile made twice has the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import shutil
import socket
import tomllib
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends.locks import HDF5_LOCK, NETCDFC_LOCK, combine_locks

from .. import files
from ..errors import BadInput
from ..files import disk_error, move_into_place, temporary_path, write_text
from ..io import netcdf, provenance
from ..io.progress import clock
from ..label.pipeline import scene_kernel_hash
from ..scene import grid
from ..scene.model import Scene
from ..scene.read import load_scene
from ..variables import variables
from .identity import identity
from .tiling import Tiling, tiling

FORMAT = 1
MANIFEST = "manifest.json"
NOTES = "notes.json"  # attributes that are known in the end
# The libraries below netCDF4 are not made for threads; this is the lock that xarray reads under.
_NETCDF = combine_locks([NETCDFC_LOCK, HDF5_LOCK])


class DamagedTileError(Exception):
    """A tile that is there but cannot be used; the message says why."""


def tile_types(scene: Scene) -> dict[str, str]:
    """What a tile holds, name and type: its variables, and the parameters the family was solved for."""
    kinds = variables(scene.system)
    return {name: kinds[name].dtype for name in scene.outputs} | dict.fromkeys(scene.solve, "float64")


def _key(manifest: dict[str, Any]) -> str:
    kept = {name: manifest[name] for name in ("format", "scene", "identity", "tile")}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


@dataclass
class TileStatus:
    """State of some tiles of a run folder."""

    done: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    damaged: dict[int, str] = field(default_factory=dict)  # tile -> why
    unfinished: dict[int, list[Path]] = field(default_factory=dict)  # files that a stopped process left


class RunFolder:
    """One run on disk. Made by `prepare` (to compute) or `open` (to read); may be sent to other processes."""

    def __init__(self, path: Path, manifest: dict[str, Any]):
        self.path = path
        self.manifest = manifest
        self.key = str(manifest["key"])
        self.scene = load_scene(str(manifest["scene"]))
        self.tiling = Tiling(self.scene.shape, tuple(manifest["tile"]))
        self._tiles = path / "tiles"

    def __reduce__(self) -> Any:
        return RunFolder.open, (self.path,)

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """The run in a folder; BadInput if there is none, or one that this version cannot read."""
        path = Path(path).absolute()
        file = path / MANIFEST
        try:
            manifest = json.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise BadInput(f"{path}: not a run folder: there is no {MANIFEST} in it") from None
        except NotADirectoryError:
            raise BadInput(f"{path}: not a run folder but a file") from None
        except (OSError, ValueError) as error:
            raise BadInput(f"{file}: cannot be read: {error}") from None
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise BadInput(f"{file}: not a manifest of this version of atlas (format {FORMAT})")
        try:
            whole = manifest["key"] == _key(manifest)
            run = cls(path, manifest) if whole else None
        except BadInput as complaint:
            made = manifest["identity"].get("atlas")
            raise BadInput(f"{file}: its scene, of atlas {made}, cannot be read: {complaint}") from None
        except (KeyError, TypeError, ValueError, AttributeError):
            run = None
        if run is None:
            raise BadInput(f"{file}: damaged: its key does not fit what it holds")
        return run

    @classmethod
    def prepare(cls, scene: Scene, path: Path, sample: grid.Grid, remarks: list[str]) -> RunFolder:
        """The run folder of a scene at `path`: continued if it is there, else made.

        sample, remarks: points from `grid.check` and the system's warnings about them. Raises BadInput,
        touching nothing, if the folder holds another run (naming what differs) or anything else.
        """
        path = path.absolute()
        if not (path / MANIFEST).exists():
            if path.exists() and not path.is_dir():
                raise BadInput(f"{path}: this is a file, not a run folder")
            if path.exists() and any(not p.name.startswith(f".{MANIFEST}") for p in path.iterdir()):
                raise BadInput(f"{path}: this folder holds something else: there is no {MANIFEST} in it")
            files.check_folder(path if not path.exists() else path / MANIFEST)
            manifest = {
                "format": FORMAT,
                "scene": scene.toml(),
                "identity": identity(scene),
                "tile": tiling(scene, sample).tile,
                "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
                "provenance": _no_nan(
                    provenance.provenance(
                        scene.system, scene.settings, scene_kernel_hash(scene),
                        title=scene.title, scene=scene.toml(), seconds=0.0, points=scene.size, remarks=remarks,
                    )
                ),
            }  # fmt: skip
            path.mkdir(exist_ok=True)
            with suppress(FileExistsError):  # another process was first
                write_text(
                    path / MANIFEST, json.dumps(manifest | {"key": _key(manifest)}, indent=1), once=True
                )
        run = cls.open(path)
        run.check_same(scene)
        with suppress(OSError):
            run._tiles.mkdir(exist_ok=True)
        return run

    @classmethod
    def forget(cls, scene: Scene, path: Path) -> None:
        """Remove what an earlier run of another scene, or by another version, left in a folder of its own."""
        if (path / MANIFEST).exists():
            try:
                cls.open(path).check_same(scene)
            except BadInput:
                with suppress(BadInput):
                    cls.open(path).remove()

    def check_same(self, scene: Scene) -> None:
        """Raise BadInput, naming what differs, unless this process computes the same bits for the scene."""
        there = _flattened(tomllib.loads(self.manifest["scene"])) | self.manifest["identity"]
        here = _flattened(tomllib.loads(scene.toml())) | identity(scene)
        differ = [name for name in {**there, **here} if there.get(name) != here.get(name)]
        if differ:
            shown = ", ".join(
                f"{name} ({there.get(name, 'nothing')} there, {here.get(name, 'nothing')} here)"
                for name in differ
            )
            raise BadInput(
                f"{self.path}: holds another run; choose another name or remove it. It differs in {shown}"
            )

    def check_writable(self) -> None:
        """Raise BadInput unless tiles can be written here."""
        files.check_folder(self._tiles / "tile")

    def _file(self, tile: int, suffix: str) -> Path:
        return self._tiles / f"{tile:08d}{suffix}"

    def present(self, tile: int) -> bool:
        """Has someone finished writing this tile? It may be damaged."""
        return self._file(tile, ".json").exists()

    def write(self, tile: int, columns: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Write one tile: columns by name, (points of the tile,) each; the file first, then its sidecar.

        facts: kept in the sidecar; computed: points where the family exists, all others are
        not_computed for good; seconds: what the tile cost; by: who computed it.
        """
        extent, path = self.tiling.extent(tile), self._file(tile, ".nc")
        names, temporary = netcdf.dims(self.scene), temporary_path(path)
        try:
            # Made in memory and written when closed; unlike an image in memory it holds no time of day.
            with _NETCDF, netCDF4.Dataset(temporary, "w", diskless=True, persist=True) as file:
                file.setncatts({"atlas_key": self.key, "atlas_tile": tile})
                for name, length in zip(names, extent, strict=True):
                    file.createDimension(name, length)
                for name, dtype in tile_types(self.scene).items():
                    variable = file.createVariable(name, dtype, names, fill_value=False, **netcdf.COMPRESSION)
                    variable[:] = columns[name].astype(dtype, copy=False).reshape(extent)
            digest = hashlib.sha256(temporary.read_bytes()).hexdigest()
            move_into_place(temporary, path)
        except (RuntimeError, OSError) as error:
            raise disk_error(error, path) from None
        finally:
            temporary.unlink(missing_ok=True)
        side = {
            "key": self.key, "tile": tile, "sha256": digest,
            "points": math.prod(extent), "host": socket.gethostname(), **facts,
        }  # fmt: skip
        write_text(self._file(tile, ".json"), json.dumps(side))

    def sidecar(self, tile: int) -> dict[str, Any]:
        """What is known of a tile. Raises FileNotFoundError or Damaged."""
        try:
            side = json.loads(self._file(tile, ".json").read_bytes())
        except (ValueError, IsADirectoryError):
            raise DamagedTileError("its sidecar cannot be read") from None
        if not isinstance(side, dict) or side.get("key") != self.key or side.get("tile") != tile:
            raise DamagedTileError("its sidecar is of another run or tile")
        return side

    def read(self, tile: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """Variables of a tile (default: all), each of the tile's extent.

        Raises FileNotFoundError if the tile is not there, Damaged if it does not open, or has another
        hash, key, shape or number of computed points than it should.
        """
        side, extent, types = self.sidecar(tile), self.tiling.extent(tile), tile_types(self.scene)
        try:
            content = self._file(tile, ".nc").read_bytes()
        except (FileNotFoundError, IsADirectoryError):
            raise DamagedTileError("its file is missing") from None
        if hashlib.sha256(content).hexdigest() != side.get("sha256"):
            raise DamagedTileError("its hash differs")
        flags = [name for name in ("label", "status") if name in types]
        wanted = list(types if names is None else names)
        try:
            with _NETCDF, netCDF4.Dataset("tile.nc", memory=content) as file:
                file.set_auto_maskandscale(False)
                if (file.getncattr("atlas_key"), file.getncattr("atlas_tile")) != (self.key, tile):
                    raise DamagedTileError("it is a tile of another run or place")
                found = {name: np.asarray(file[name][...]) for name in {*wanted, *flags}}
        except (OSError, RuntimeError, AttributeError, IndexError) as error:
            raise DamagedTileError(f"it does not open: {error}") from None
        if any(found[name].shape != extent or found[name].dtype != types[name] for name in found):
            raise DamagedTileError("its shape or type is wrong")
        absent = math.prod(extent) - side.get("computed", -1)
        if side.get("points") != math.prod(extent) or any((found[f] == 0).sum() != absent for f in flags):
            raise DamagedTileError("it holds points that are not computed")
        return {name: found[name] for name in wanted}

    def check(self, tile: int) -> str | None:
        """None if a tile is done, "" if it is missing, else why it is damaged."""
        try:
            self.read(tile, ())
        except FileNotFoundError:
            return ""
        except DamagedTileError as damage:
            return str(damage)
        return None

    def survey(self, tiles: Iterable[int] | None = None) -> TileStatus:
        """Look at tiles (default: all), reading each file that is there from end to end."""
        names = {entry.name for entry in os.scandir(self._tiles)} if self._tiles.is_dir() else set()
        found = TileStatus()
        for name in names:
            if name.startswith(".") and name[1:9].isdigit():
                found.unfinished.setdefault(int(name[1:9]), []).append(self._tiles / name)
        there: list[int] = []
        for tile in range(self.tiling.count) if tiles is None else tiles:
            (there if f"{tile:08d}.json" in names else found.missing).append(tile)
        with ThreadPoolExecutor(4) as pool:
            for tile, why in zip(there, pool.map(self.check, there), strict=True):
                if why is None:
                    found.done.append(tile)
                elif why == "":
                    found.missing.append(tile)
                else:
                    found.damaged[tile] = why
        return found

    def status(self) -> str:
        """What is done, damaged and missing, and what the processes at work said last, as text."""
        survey, tiling = self.survey(), self.tiling
        lines = [
            f"{self.scene.title}: {self.scene.size} points in {tiling.count} tiles of at most {math.prod(tiling.tile)}",
            f"done {len(survey.done)}, damaged {len(survey.damaged)}, missing {len(survey.missing)}",
        ]
        lines += [
            f"tile {tile} will be computed again: {why}" for tile, why in sorted(survey.damaged.items())
        ]
        left = sum(math.prod(tiling.extent(tile)) for tile in [*survey.missing, *survey.damaged])
        speed = 0.0
        for path in sorted(self.path.glob("progress*.json")):
            with suppress(OSError, ValueError, KeyError, TypeError):
                said = json.loads(path.read_text())
                state = "at work" if said["running"] else "ended"
                lines.append(
                    f"shard {said['shard']} on {said['host']}: {said['done']} of {said['points']} points,"
                    f" {said['points_per_second']:.4g} points/s, {state} when it wrote at {said['written']}"
                )
                speed += said["points_per_second"] if said["running"] else 0.0
        if left and speed > 0:
            lines.append(f"{left} points left, {clock(left / speed)} at the speed of the processes at work")
        return "\n".join(lines)

    def dataset(self) -> xr.Dataset:
        """The atlas as far as it is computed: dask arrays with a block for each tile."""
        import dask.array as da

        chunks = da.core.normalize_chunks(self.tiling.tile, self.scene.shape)
        arrays = {
            name: da.map_blocks(
                _block, self, name, chunks=chunks, dtype=dtype, meta=np.empty((0,) * len(chunks), dtype)
            )
            for name, dtype in tile_types(self.scene).items()
        }
        ds = netcdf.dataset(
            self.scene,
            {name: arrays[name] for name in self.scene.outputs},
            {name: arrays[name] for name in self.scene.solve},
            self.tiling.tile,
        )
        return ds.assign_attrs(self._attributes() | self.notes())

    def _attributes(self) -> dict[str, Any]:
        """Provenance of what is there: seconds and points per second of all processes taken together."""
        points, seconds, by = 0, 0.0, Counter[str]()
        names = [e.name for e in os.scandir(self._tiles)] if self._tiles.is_dir() else []
        for name in names:
            if name.endswith(".json") and not name.startswith("."):
                with suppress(FileNotFoundError, DamagedTileError, KeyError):
                    side = self.sidecar(int(name[:8]))
                    points, seconds = points + side["points"], seconds + side["seconds"]
                    by[side["by"]] += 1
        provenance = self.manifest["provenance"].items()
        found = {name: math.nan if value is None else value for name, value in provenance}
        found["atlas_seconds"] = seconds
        found["atlas_points_per_second"] = points / seconds if seconds > 0 else math.nan
        done = sum(by.values())
        found["atlas_run"] = f"{done} of {self.tiling.count} tiles" + "".join(
            f"; {n} by {who}" for who, n in sorted(by.items())
        )
        return found

    def join(self, out: Path) -> None:
        """Write the whole atlas as one file, tile by tile: memory does not grow with its size.

        Raises BadInput if a tile is missing or damaged, OSError if the disk is full; `out` is then
        untouched.
        """
        lost = [tile for tile in range(self.tiling.count) if not self.present(tile)]
        if lost:
            raise BadInput(
                f"{self.path}: {len(lost)} of {self.tiling.count} tiles are missing; run its scene again first"
            )
        temporary = temporary_path(out)
        try:
            self._join(temporary)
            move_into_place(temporary, out)
        except DamagedTileError as damage:
            raise BadInput(f"{self.path}: {damage}; run its scene again first") from None
        except (RuntimeError, OSError) as error:
            raise disk_error(error, out) from None
        finally:
            temporary.unlink(missing_ok=True)

    def _join(self, path: Path) -> None:
        ds = self.dataset()
        # Chunks as long as tiles of the cheapest scene: many small tiles would make a slow file.
        chunk = dict(
            zip(
                netcdf.dims(self.scene),
                Tiling.of(self.scene.shape, grid.MAX_POINTS_PER_TILE).tile,
                strict=True,
            )
        )
        marked = " ".join(str(name) for name in ds.coords if name not in ds.dims)
        with _NETCDF:
            file = netCDF4.Dataset(path, "w", format="NETCDF4")
        try:
            with _NETCDF:
                file.setncatts(ds.attrs)
                for dim, length in ds.sizes.items():
                    file.createDimension(str(dim), length)
                for name, array in ds.variables.items():
                    options: dict[str, Any] = {"fill_value": False}
                    if name in ds.data_vars and array.dtype.kind == "f":
                        options["fill_value"] = np.nan
                    if array.ndim:
                        options |= netcdf.COMPRESSION
                        options["chunksizes"] = [chunk[str(d)] for d in array.dims]
                    along = [str(d) for d in array.dims]
                    made = file.createVariable(str(name), array.dtype, along, **options)
                    made.set_auto_maskandscale(False)
                    made.setncatts(array.attrs | ({"coordinates": marked} if name in ds.data_vars else {}))
                    if array.ndim:
                        size = 2 * math.prod(made.chunking()) * array.dtype.itemsize
                        made.set_var_chunk_cache(size=size)
                    if array.chunks is None:
                        made[...] = array.values
            for name, array in ds.coords.items():
                if array.chunks is None or name in self.scene.solve:
                    continue
                for place in np.ndindex(*array.data.numblocks):
                    block = array.data.blocks[place].compute(scheduler="synchronous")
                    first = [sum(lengths[:i]) for lengths, i in zip(array.chunks, place, strict=True)]
                    where = tuple(slice(i, i + n) for i, n in zip(first, block.shape, strict=True))
                    with _NETCDF:
                        file[str(name)][where] = block
            for tile in range(self.tiling.count):
                try:
                    found = self.read(tile)
                except (FileNotFoundError, DamagedTileError) as damage:
                    raise DamagedTileError(f"tile {tile}: {damage}") from None
                with _NETCDF:
                    for name, values in found.items():
                        file[name][self.tiling.place(tile)] = values
        finally:
            with _NETCDF:
                file.close()

    def note(self, attributes: dict[str, Any]) -> None:
        """Keep attributes that are known once all tiles are there; dataset() then has them."""
        write_text(self.path / NOTES, json.dumps(attributes, indent=1))

    def notes(self) -> dict[str, Any]:
        """What `note` kept, or nothing."""
        try:
            return dict(json.loads((self.path / NOTES).read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return {}

    def remove(self) -> None:
        """Remove the run, and its folder if nothing else lies in it; the manifest last."""
        shutil.rmtree(self._tiles, ignore_errors=True)
        for path in [
            *self.path.glob("progress*.json"),
            *self.path.glob(".*.tmp"),
            self.path / NOTES,
            self.path / MANIFEST,
        ]:
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.path.rmdir()


def _block(run: RunFolder, name: str, block_id: tuple[int, ...]) -> np.ndarray:
    """One tile of one variable; not_computed or nan where there is none."""
    tile = int(np.ravel_multi_index(block_id, run.tiling.blocks))
    try:
        return run.read(tile, (name,))[name]
    except FileNotFoundError:
        pass
    except DamagedTileError as damage:
        logging.getLogger("atlas").warning("%s: tile %d is damaged: %s", run.path, tile, damage)
    dtype = tile_types(run.scene)[name]
    return np.full(run.tiling.extent(tile), 0 if np.dtype(dtype).kind == "i" else np.nan, dtype)


def _no_nan(table: dict[str, Any]) -> dict[str, Any]:
    """JSON has no nan."""
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in table.items()
    }


def _flattened(table: dict[str, Any], above: str = "") -> dict[str, Any]:
    """A nested table as one level, with dotted names."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        found |= _flattened(value, f"{above}{name}.") if isinstance(value, dict) else {above + name: value}
    return found
