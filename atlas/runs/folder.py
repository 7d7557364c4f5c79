"""Run folders: a scene computed in tiles, so that an interrupted run is continued.

    NAME/manifest.json        what is computed, by which programs, in which tiles; created once
    NAME/tiles/00000012.nc    variables of one tile
    NAME/tiles/00000012.json  its hash and cost, written after it
    NAME/progress.json        progress of the process that wrote it last, for people and scripts
    NAME/notes.json           attributes that only the finished run has

In a Zarr store they are in its group `atlas`, and of a tile the sidecar alone; see `io.zarr_store`.

Nothing is locked: files appear whole by a move, and a tile computed twice has the same bytes. Every file but
progress.json, which nothing computed depends on, carries a checksum.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import re
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from ..errors import MAX_MESSAGE, MAX_TEXT, BadInput, option, printable
from ..files import (
    PROCESS_NAME,
    atomic_folder,
    check_folder,
    check_types,
    exists_message,
    is_temporary,
    one_line,
    parsed,
    remove_leftovers,
    sealed,
    unsealed,
)
from ..io import netcdf, progress, zarr_store
from ..io.netcdf import Block, scene_provenance
from ..io.storage import Folder, Storage, claim, located, storage_at
from ..scene import grid
from ..scene.read import parse_scene
from ..variables import variables
from .plan import ScenePlan, differences, identity
from .tiles import (
    SHARD_CHUNKS,
    DamagedTile,
    TileFiles,
    TileShards,
    Tiling,
    Totals,
    computed_counts,
    tile_types,
)

FORMAT, OLDER_FORMAT = 3, 2  # with all tiles in one folder
MANIFEST = "manifest.json"
CREATION = "manifest.claim"  # of the process that creates it
CLAIM_POLL = 0.5  # seconds between two attempts to claim
FINAL_ATTRIBUTES = "notes.json"
# As long as the longest name in a run folder, so that a path that is too long is refused before anything is computed.
LONGEST_NAME = "tiles/" + 64 * "x"
PROGRESS = re.compile(r"progress(-\d+-of-\d+)?\.json")
PROGRESS_TYPES = dict.fromkeys(("shard", "host", "process", "written"), str) | dict.fromkeys(
    ("points", "done", "points_per_second"), int | float
)
ATTRIBUTE = str | int | float  # types of the attributes of an atlas
MANIFEST_TYPES = {"key": str, "scene": str, "identity": dict, "tile": list, "provenance": dict}
TALLY = "tally"  # entry of the encoding of a dataset of a whole run folder
RESULT = "atlas_result"  # attribute of an atlas with its `result_hash`
HISTORY = "atlas_history"  # attribute of an atlas with points of earlier ones: which these are
Blocks: TypeAlias = Callable[[tuple[int, ...]], Iterator[Block]]  # gives all points in boxes of these lengths


class RunFolder:
    """One run on disk, which other processes open themselves when it is sent to them."""

    content = "tiles"  # name of the folder with all that is computed
    more = ""  # what an unfinished run has beside the points that its status counts
    number: int | None = None  # of a level

    def __init__(self, path: Path | str, manifest: dict[str, Any]):
        self.path = path
        self.is_flat = manifest["format"] == OLDER_FORMAT
        self.root, self.storage = _storage(path)
        self.is_store = self.storage is not self.root
        self.manifest = manifest
        self.key = str(manifest["key"])  # hash of scene, programs and tiling; every tile carries it
        self.scene = parse_scene(str(manifest["scene"]))
        self.tiling = Tiling(self.scene.shape, tuple(manifest["tile"]))
        self.tiling.check()
        self.tiles = self.tiles_with(self.key)

    def __reduce__(self) -> Any:
        return RunFolder.open, (self.path,)

    def __dask_tokenize__(self) -> tuple[str, str]:
        # By default dask pickles and opens the folder for each of its arrays.
        return str(self.path), self.key

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Open a run folder; BadInput if it is none, its manifest is damaged, or another version wrote it."""
        path = located(path)
        storage = _storage(path)[1]
        file = f"{storage}/{MANIFEST}"
        try:
            manifest = unsealed(storage.read(MANIFEST))
        except FileNotFoundError:
            raise BadInput(f"{path}: not a run folder: there is no {MANIFEST} in it") from None
        except NotADirectoryError:
            raise BadInput(f"{path}: not a run folder but a file") from None
        except ValueError as error:
            raise BadInput(
                f"{file}: damaged, or not of this version of atlas (format {FORMAT}): {one_line(error)}"
            ) from None
        except OSError as error:
            raise BadInput(f"{file}: cannot be read: {error.strerror}") from None
        if manifest.get("format") not in (OLDER_FORMAT, FORMAT):
            raise BadInput(f"{file}: not a manifest of this version of atlas (format {FORMAT})")
        try:
            check_types(manifest, MANIFEST_TYPES)
            check_types(manifest["identity"], dict.fromkeys(manifest["identity"], str))
            check_types(manifest["provenance"], dict.fromkeys(manifest["provenance"], ATTRIBUTE | None))
            if manifest["key"] != _key(manifest):
                raise ValueError("its key does not match its content")
            run = cls(path, manifest)
            if run.scene.refine is None:
                return run
            from .levels import RefinedFolder  # imports this module

            return RefinedFolder(path, manifest)
        except BadInput as error:
            version = manifest["identity"].get("atlas")
            raise BadInput(f"{file}: its scene, of atlas {version}, cannot be read: {error}") from None
        except ValueError as error:
            raise BadInput(f"{file}: damaged: {one_line(error)}") from None

    @classmethod
    def prepare(cls, plan: ScenePlan, path: Path | str, warnings: list[str]) -> RunFolder:
        """Create the run folder or store of a scene, or open it to be continued; BadInput for anything else in it."""
        path = located(path)
        root, storage = _storage(path)
        if MANIFEST not in storage.names():
            if isinstance(path, Path):
                if path.exists() and not path.is_dir():
                    raise BadInput(f"{path}: this is a file, not a run folder")
                check_folder(path / MANIFEST if path.exists() else path)
            own = {CREATION, *([] if root is storage else [zarr_store.RUN])}
            if any(
                name not in own and not is_temporary(name) and not PROGRESS.fullmatch(name)
                for name in root.names() | storage.names()
            ):
                if zarr_store.is_whole(root):
                    raise BadInput(exists_message(path))
                raise BadInput(f"{path}: this folder contains something else: there is no {MANIFEST} in it")
            scene, kernel = plan.scene, plan.points.kernel_hash
            attributes = scene_provenance(scene, kernel, seconds=0.0, points=scene.size, warnings=warnings)
            manifest = {
                "format": FORMAT,
                "scene": scene.toml(),
                "identity": identity(plan.points),
                "tile": (plan.tiling if root is storage or scene.refine else plan.shards).tile,
                "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
                "provenance": {  # JSON has no nan
                    name: None if isinstance(value, float) and math.isnan(value) else value
                    for name, value in attributes.items()
                },
            }
            manifest["key"] = _key(manifest)
            root.make()
            storage.make()
            while MANIFEST not in storage.names():  # of several processes one creates it
                if not claim(storage, CREATION):
                    time.sleep(CLAIM_POLL)
                    continue
                if MANIFEST not in storage.names():
                    storage.write(MANIFEST, sealed(manifest).encode())
                storage.remove(CREATION)
        run = cls.open(path)
        run.check_same(plan)
        run.remove_leftovers()
        with suppress(OSError):
            storage.inside(run.content).make()
        return run

    @classmethod
    def discard(cls, plan: ScenePlan, path: Path | str) -> None:
        """Remove another scene's or version's run, or a joined store; BadInput if a process computes it."""
        root, storage = _storage(path)
        if MANIFEST not in storage.names():
            if root is not storage and zarr_store.is_whole(root):
                root.clear(zarr_store.METADATA)
            return  # `prepare` refuses anything else
        try:
            run = cls.open(path)
        except BadInput:
            return  # `prepare` refuses it
        try:
            run.check_same(plan)
        except BadInput:
            for content, state in run._processes():
                match = PROCESS_NAME.fullmatch(content["process"])
                if match is not None and state == progress.AT_WORK:
                    raise BadInput(
                        f"{run.path}: is computed by process {match[3]} on {content['host']}; wait for it, end it, or choose"
                        " another name"
                    ) from None
            run.remove()

    def check_same(self, plan: ScenePlan) -> None:
        """Raise BadInput, listing the differences, unless this process computes the same bits for the scene."""
        stored = _flattened(tomllib.loads(self.manifest["scene"])) | self.manifest["identity"]
        current = _flattened(tomllib.loads(plan.scene.toml())) | identity(plan.points)
        different = differences(stored, current, "in the folder", "now")
        if different:
            raise BadInput(
                f"{self.path}: holds another run; choose another name, or {option('force', True)} replaces it. It differs in"
                f" {different}"
            )

    def check_kept(self) -> None:
        """Raise OSError if another process has removed the run, or replaced it by another one."""
        try:
            kept = unsealed(self.storage.read(MANIFEST)).get("key") == self.key
        except (OSError, ValueError):
            kept = False
        if not kept:
            raise OSError(
                f"{self.path}: another process has removed this run while it was computed; run its scene again"
            )

    def _processes(self) -> Iterator[tuple[dict[str, Any], str]]:
        """Content of each progress file that can be read, and the state of its process."""
        for name in sorted(filter(PROGRESS.fullmatch, self.storage.names())):
            # KeyError and TypeError: no entry `running`, or a time without a zone
            with suppress(OSError, ValueError, KeyError, TypeError):
                content = parsed(self.storage.read(name))
                check_types(content, PROGRESS_TYPES)
                yield content, progress.state(content)

    def indices(self, tile: int) -> np.ndarray:
        """Flat indices of the points of a tile."""
        return self.tiling.indices(tile)

    def tile_sets(self) -> dict[str, TileFiles]:
        """The tiles by the name of their part of the run."""
        return {"": self.tiles}

    @property
    def run(self) -> RunFolder:
        """The folder of the whole run."""
        return self

    @property
    def is_complete(self) -> bool:
        """Whether the atlas can be read as a whole."""
        return zarr_store.is_sealed(self.root) if self.is_store else not self.tiles.missing()

    def key_with(self, identity: dict[str, str]) -> str:
        """Key of this run if programs and processors of another identity computed it."""
        return _key(self.manifest | {"identity": identity})

    def tiles_with(self, key: str) -> TileFiles:
        """The tiles of this run if it had this key."""
        rest = key, netcdf.dims(self.scene), tile_types(self.scene), self.tiling
        if self.is_store:
            return TileShards(self.storage.inside("tiles"), *rest, root=self.root)
        return TileFiles(self.storage.inside("tiles"), *rest, is_flat=self.is_flat)

    def remove_leftovers(self) -> None:
        """Remove temporary files and claims of processes that were killed."""
        self.root.remove_leftovers()
        for tiles in self.tile_sets().values():
            tiles.remove_claims()

    def progress_text(self) -> str:
        """Number of the tiles that are written, as text; empty if the folder has been removed."""
        path, sets = str(self.path), self.tile_sets().values()
        if isinstance(self.path, Path):
            if not self.path.is_dir():
                return ""
            path = os.path.relpath(self.path)
        written = sum(tiles.written_count() for tiles in sets)
        count = sum(tiles.tiling.count for tiles in sets)
        return f"{written} of {count} tiles are in {path if path[0] != '.' else self.path}/"

    def status(self) -> str:
        """State of processes and tiles, all of which are read; removes files of killed processes."""
        self.remove_leftovers()
        if isinstance(self.path, Path):
            remove_leftovers(self.path.parent)
        lines, points_left = [f"{printable(self.scene.title, MAX_TEXT)}: {self._size_text()}"], 0
        for name, tiles in self.tile_sets().items():
            status = tiles.status()
            lines.append(
                f"{name}done {len(status.done)}, damaged {len(status.damaged)}, missing {len(status.missing)}"
            )
            lines += [
                f"{name}tile {tile} will be computed again: {reason}"
                for tile, reason in sorted(status.damaged.items())
            ]
            points_left += sum(tiles.tiling.size_of(tile) for tile in [*status.missing, *status.damaged])
        total_speed, is_running = 0.0, False
        for content, state in self._processes():
            lines.append(
                f"shard {content['shard']} on {content['host']}: {content['done']} of {content['points']}"
                f" points, {content['points_per_second']:.4g} points/s, {state}; written {content['written']}"
            )
            if state == progress.AT_WORK:
                is_running, total_speed = True, total_speed + content["points_per_second"]
        if points_left and total_speed > 0:
            lines.append(
                f"{points_left} points left, {progress.clock(points_left / total_speed)} at the speed of the"
                " processes at work"
            )
        elif not is_running and (points_left or not self.is_complete):
            lines.append(
                f"{points_left} points left{self.more}, no process is at work; `atlas run` with its scene continues"
            )
        return "\n".join(printable(line, MAX_MESSAGE) for line in lines)

    def _size_text(self) -> str:
        """The numbers of its points and tiles."""
        return (
            f"{self.scene.size} points in {self.tiling.count} tiles of at most {math.prod(self.tiling.tile)}"
        )

    def dataset(self) -> xr.Dataset:
        """The atlas so far, with a dask chunk for each tile; missing points are `not_computed` and nan. A sealed store as it is."""
        totals = self.totals()
        if self.is_store and self.is_complete:
            ds = zarr_store.open_store(self.path)
        else:
            import dask.array as da

            chunks = da.core.normalize_chunks(self.tiling.tile, self.scene.shape)
            nothing = (0,) * len(chunks)
            arrays = {
                name: da.map_blocks(_read_chunk, self, name, chunks=chunks, meta=np.empty(nothing, kind))
                for name, kind in self.types.items()
            }
            ds = netcdf.dataset(self.scene, arrays, self.tiling.tile).assign_attrs(self.attributes(totals))
        if totals.tallied == self.scene.size:
            ds.encoding[TALLY] = totals.tally
        return ds

    @property
    def types(self) -> dict[str, str]:
        """Names and types of the variables of the atlas."""
        return tile_types(self.scene)

    def template(self) -> xr.Dataset:
        """The atlas with zeros, which take no memory, in place of its values."""
        shape, types = self.scene.shape, self.types.items()
        zeros = {name: np.broadcast_to(np.zeros((), kind), shape) for name, kind in types}
        return netcdf.dataset(self.scene, zeros, self.tiling.tile)

    def totals(self) -> Totals:
        """Sums over the tiles that are written."""
        totals = Totals()
        for sidecar in chain.from_iterable(tiles.sidecars() for tiles in self.tile_sets().values()):
            totals.add(sidecar)
        return totals

    def attributes(self, totals: Totals) -> dict[str, Any]:
        """Attributes of the atlas whose tiles have these sums."""
        attributes = {
            name: math.nan if value is None else value for name, value in self.manifest["provenance"].items()
        }
        attributes[RESULT] = result_hash(self.manifest["scene"], self.manifest["identity"])
        attributes["atlas_seconds"] = seconds = totals.seconds
        computed = totals.points - totals.reused.total()
        attributes["atlas_points_per_second"] = computed / seconds if seconds > 0 else math.nan
        attributes |= history_text(totals.reused)
        count = sum(tiles.tiling.count for tiles in self.tile_sets().values())
        attributes["atlas_run"] = f"{totals.tiles_by.total()} of {count} tiles" + "".join(
            f"; {count} by {by}" for by, count in sorted(totals.tiles_by.items())
        )
        return attributes | self.final_attributes()

    def save_final_attributes(self, attributes: dict[str, Any]) -> None:
        """Save attributes that only the finished run has; `dataset` then has them."""
        self.check_kept()
        self.storage.write(FINAL_ATTRIBUTES, sealed({"key": self.key, "attributes": attributes}).encode())
        if self.is_store:
            assert isinstance(self.tiles, TileShards)
            self.tiles.seal(self.template().assign_attrs(self.attributes(self.totals())))

    def final_attributes(self) -> dict[str, Any]:
        """Attributes saved by `save_final_attributes`, or none; BadInput if their file is damaged."""
        file = f"{self.storage}/{FINAL_ATTRIBUTES}"
        try:
            content = unsealed(self.storage.read(FINAL_ATTRIBUTES))
            check_types(content, {"key": str, "attributes": dict})
            check_types(content["attributes"], dict.fromkeys(content["attributes"], ATTRIBUTE))
            if content["key"] != self.key:
                raise ValueError("it belongs to another run")
            return dict(content["attributes"])
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise BadInput(f"{file}: cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise BadInput(
                f"{file}: damaged: {one_line(error)}; run the scene again, which writes it anew"
            ) from None

    def join(self, out: Path) -> None:
        """Write the atlas as a NetCDF file or .zarr store, tile by tile, in memory of constant size.

        `out` is replaced, or kept after BadInput (a tile or the package zarr is missing) and OSError.
        """
        if not self.is_complete:
            raise BadInput(f"{self.path}: unfinished, {self.progress_text()}; run its scene again first")
        ds = self.template().assign_attrs(self.final_attributes())  # damaged ones end it before it begins
        self.write(out, ds, partial(self._blocks, ds))

    def write(self, out: Path, ds: xr.Dataset, blocks: Blocks) -> None:
        """Write an atlas as a NetCDF file or .zarr store; see `join` for what is raised."""
        try:
            if zarr_store.is_store(out):
                zarr_store.zarr_package()
                with atomic_folder(out) as temporary:
                    self.write_store(Folder(temporary), ds, blocks)
            else:
                # Chunks as long as tiles of the cheapest scene: many small tiles would make a slow file.
                lengths = Tiling.of(self.scene.shape, grid.MAX_POINTS_PER_TILE).tile
                chunk = dict(zip(netcdf.dims(self.scene), lengths, strict=True))
                netcdf.write_blocks(ds, chunk, self.types, blocks(lengths), out)
        except DamagedTile as error:
            raise BadInput(f"{self.path}: {error}; run its scene again first") from None

    def write_store(self, root: Storage, ds: xr.Dataset, blocks: Blocks) -> None:
        """Write the atlas as a Zarr store, tile by tile."""
        tiling = Tiling.of(self.scene.shape, SHARD_CHUNKS * grid.MAX_POINTS_PER_TILE).of_whole_chunks()
        places = root.inside(zarr_store.RUN), root.inside(zarr_store.RUN).inside("tiles")
        shards = TileShards(places[1], self.key, netcdf.dims(self.scene), self.types, tiling, root=root)
        for storage in places:
            storage.make()
        for tile, (_, values) in enumerate(blocks(tiling.tile)):
            computed = next(iter(computed_counts(values)), tiling.size_of(tile))
            shards.write(tile, values, computed=computed, seconds=0.0, by="atlas join")
        shards.seal(ds)

    def _blocks(self, ds: xr.Dataset, lengths: tuple[int, ...]) -> Iterator[Block]:
        """All points in boxes of these lengths, with the values of the tiles; then the dataset gets its attributes."""
        boxes, types, tiles = Tiling(self.scene.shape, lengths), self.types, self.tiles.read_all()
        totals = Totals()
        parts = [{name: np.empty(0, dtype) for name, dtype in types.items()}]  # what was read beyond a box
        points = 0  # in the parts
        for box in range(boxes.count):
            size, shape = boxes.size_of(box), boxes.shape_of(box)
            while points < size:
                sidecar, values = next(tiles)
                totals.add(sidecar)
                parts.append(values)
                points += sidecar["points"]
            flat = {name: np.concatenate([values[name].ravel() for values in parts]) for name in types}
            yield boxes.slices(box), {name: values[:size].reshape(shape) for name, values in flat.items()}
            parts, points = [{name: values[size:] for name, values in flat.items()}], points - size
        ds.attrs |= self.attributes(totals)

    def remove(self) -> None:
        """Remove the run, and its folder if nothing else is in it; the manifest last.

        The tiles go by one move, so that a process which still computes some cannot leave any behind.
        """
        if self.is_store:
            if not zarr_store.are_own(self.root.walk()):
                raise BadInput(
                    f"{self.path}: holds something else than a run; remove it or choose another name"
                )
            self.root.remove(zarr_store.METADATA)
            self.root.clear(f"{zarr_store.RUN}/{MANIFEST}")
            return
        path = Path(self.path)
        with suppress(OSError):
            self.storage.inside(self.content).clear("")
        for file in [*path.glob("progress*.json"), path / CREATION, path / FINAL_ATTRIBUTES, path / MANIFEST]:
            file.unlink(missing_ok=True)
        remove_empty(path)


def _storage(path: Path | str) -> tuple[Storage, Storage]:
    """Where a run is kept, and the part of it without the values of a Zarr store."""
    root = storage_at(path)
    return root, root.inside(zarr_store.RUN) if zarr_store.is_store(path) else root


def remove_empty(path: Path) -> None:
    """Remove the folder of a run that was removed, if it contains nothing but temporary files."""
    remove_leftovers(path)
    with suppress(OSError):
        path.rmdir()


def result_hash(scene: str, programs: dict[str, str]) -> str:
    """Hash of everything on which the bits of an atlas depend: the text of its scene, and its `identity`."""
    return hash_of({"scene": scene, "identity": programs})


def history_text(reused: Mapping[str, int]) -> dict[str, str]:
    """The attribute with the numbers of points from earlier atlases, by what these are; none without such points."""
    lines = [f"{count} points of: {earlier}" for earlier, count in sorted(reused.items())]
    return {HISTORY: "\n".join(lines)} if lines else {}


def hash_of(content: dict[str, Any]) -> str:
    """Hash of the entries of a table."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _key(manifest: dict[str, Any]) -> str:
    """Hash of the scene, the programs and the tiling of a manifest."""
    return hash_of({name: manifest[name] for name in ("format", "scene", "identity", "tile")})


def _read_chunk(run: RunFolder, name: str, block_id: tuple[int, ...]) -> np.ndarray:
    """One tile of one variable; not_computed or nan where the tile is missing or damaged."""
    tile = int(np.ravel_multi_index(block_id, run.tiling.counts))
    try:
        return run.tiles.read(tile, (name,))[name]
    except FileNotFoundError:
        pass
    except DamagedTile as error:
        logging.getLogger("atlas").warning("%s: tile %d is damaged: %s", run.path, tile, error)
    dtype = np.dtype(run.types[name])
    missing = variables(run.scene.system)[name].missing if dtype.kind == "i" else np.nan
    return np.full(run.tiling.shape_of(tile), missing, dtype)


def _flattened(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested table as one level, with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        flat |= _flattened(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
