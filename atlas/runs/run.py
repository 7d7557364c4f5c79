"""Runs in a folder or on an object store. A run computes a scene in tiles, and can be interrupted and continued.

    NAME/manifest.json               scene, programs and tiles; created once
    NAME/tiles/00000012.tile         variables of tile 12
    NAME/tiles/00012/00012345.tile   variables of tile 12345 in a run of more than 1000 tiles
    NAME/levels/                     levels of a refined run, described in `levels`
    NAME/progress-PROCESS.json       progress of a process, for people and scripts
    NAME/notes.json                  attributes of a finished run, and the Totals of its tiles

Nothing is locked, because files appear whole, and a tile that is computed twice has the same values. All files contain a hash
except the progress files, which no computation reads.
"""

from __future__ import annotations

import logging
import math
import os
import re
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .. import files
from ..errors import BadInput, one_line, option, shown
from ..scene import grid
from ..scene.read import parse_scene
from ..store import dataset, finished, progress
from ..store.dataset import Block
from ..store.place import CLOCK, located, place_at
from ..store.tally import Totals
from ..store.tile import LEVEL, DamagedTile, Tiles
from ..store.tiling import Tiling, tile_types
from ..variables import COMPUTED, variables
from . import claims
from .plan import ScenePlan, differences, identity

if TYPE_CHECKING:
    from .levels import Level

FORMAT = 4
MANIFEST, NOTES = "manifest.json", "notes.json"
TILES = "tiles"
CREATION, JOINING = "manifest.claim", "joining.claim"  # claims to create the manifest and to join the tiles
# This name is as long as the longest name in a run folder. A path that is too long is thus refused before the run.
LONGEST_NAME = "tiles/" + 64 * "x"
PROGRESS = re.compile(r"progress-[0-9a-f-]+\.json")
# Files with these names may remain when a run is removed, and may exist before a run is created.
REMNANT = re.compile("|".join([PROGRESS.pattern, *map(re.escape, (CREATION, JOINING, CLOCK))]))
PROGRESS_TYPES = dict.fromkeys(("shard", "host", "process", "written"), str) | dict.fromkeys(
    ("points", "done", "points_per_second"), int | float
)
ATTRIBUTE = str | int | float  # types that an attribute of an atlas may have
MANIFEST_TYPES = {"key": str, "scene": str, "identity": dict, "tile": list, "provenance": dict}
RUN_SUFFIX = ".run"  # suffix of the folder in which the atlas for a file or store is computed
TALLY = "tally"  # key of the tally in the encoding of the dataset of a complete run
RESULT = "atlas_result"  # the attribute of an atlas that contains the `result_hash`


class RunFolder:
    """A run in a folder or on an object store. A process that unpickles a run opens the run again."""

    def __init__(self, path: Path | str, manifest: dict[str, Any]):
        self.path, self.place, self.manifest = path, place_at(path), manifest
        self.key = str(manifest["key"])  # hash of scene, programs and tiling; every tile contains the hash
        self.scene = parse_scene(str(manifest["scene"]))
        self.tiling = Tiling(self.scene.shape, tuple(manifest["tile"]))
        self.tiling.check()
        computed = {} if self.scene.refine is None else {COMPUTED.name: COMPUTED.dtype}
        self.types = tile_types(self.scene) | computed
        # Tiles that will be joined are compressed only on an object store, because the network is slower than the compression.
        level = 0 if isinstance(path, Path) and path.suffix == RUN_SUFFIX else LEVEL
        self.levels_place = self.place.inside("levels")
        self.tiles = Tiles(self.place.inside(TILES), self.key, self.types, self.tiling, level=level)

    def __reduce__(self) -> Any:
        return RunFolder.open, (self.path,)

    def __dask_tokenize__(self) -> tuple[str, str]:
        # Without this method dask would pickle and open the folder for each array.
        return str(self.path), self.key

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Open a run. Raise BadInput if the path is no run, the manifest is damaged, or another version of atlas wrote the run."""
        path = located(path)
        place = place_at(path)
        file = f"{place}/{MANIFEST}"
        try:
            try:
                manifest = files.parsed(place.read(MANIFEST), is_sealed=True)
            except FileNotFoundError:  # Versions before 0.1.0 wrote the run into the group `atlas`.
                manifest = files.parsed(place.read(f"atlas/{MANIFEST}"), is_sealed=True)
        except FileNotFoundError:
            if ".zgroup" in place.names():
                raise BadInput(f"{path}: a Zarr store of format 2; atlases have format 3") from None
            raise BadInput(f"{path}: not a run folder: there is no {MANIFEST} in it") from None
        except NotADirectoryError:
            raise BadInput(f"{path}: not a run folder but a file") from None
        except ValueError as error:
            raise BadInput(
                f"{file}: damaged, or not of this version of atlas (format {FORMAT}): {one_line(error)}"
            ) from None
        except OSError as error:
            raise BadInput(f"{file}: cannot be read: {error.strerror}") from None
        if manifest.get("format") != FORMAT:
            programs = manifest.get("identity")
            version = shown(programs.get("atlas") if isinstance(programs, dict) else None)
            raise BadInput(
                f"{path}: not a run of this version of atlas (format {FORMAT}), which does not continue it;"
                f" finish it with the version that began it, {version}, or remove it"
            )
        try:
            files.check_types(manifest, MANIFEST_TYPES)
            files.check_types(manifest["identity"], dict.fromkeys(manifest["identity"], str))
            files.check_types(manifest["provenance"], dict.fromkeys(manifest["provenance"], ATTRIBUTE | None))
            if manifest["key"] != _key(manifest):
                raise ValueError("its key does not match its content")
            return cls(path, manifest)
        except BadInput as error:
            version = manifest["identity"].get("atlas")
            raise BadInput(f"{file}: its scene, of atlas {version}, cannot be read: {error}") from None
        except ValueError as error:
            raise BadInput(f"{file}: damaged: {one_line(error)}") from None

    @classmethod
    def prepare(cls, plan: ScenePlan, path: Path | str, check: Callable[[str], object] = str) -> RunFolder:
        """Create or open a scene's run. Raise BadInput if `path` has other content. Call `check` while another process creates the run."""
        path = located(path)
        place = place_at(path)
        if MANIFEST not in (names := place.names()):
            if isinstance(path, Path):
                if path.exists() and not path.is_dir():
                    raise BadInput(f"{path}: this is a file, not a run folder")
                files.check_folder(path / MANIFEST if path.exists() else path)
            if not all(REMNANT.fullmatch(name) or files.TEMPORARY.fullmatch(name) for name in names):
                raise BadInput(f"{path}: this folder contains something else: there is no {MANIFEST} in it")
            manifest = _new_manifest(plan)
            place.make()
            wait = claims.Wait(place)
            while MANIFEST not in place.names():  # Only the process that has the claim creates the manifest.
                if not claims.claim(place, CREATION):
                    check(f"another process begins {place}")
                    wait.announce(CREATION)
                    time.sleep(claims.POLL)
                    continue
                if MANIFEST not in place.names():
                    place.write(MANIFEST, files.sealed(manifest).encode())
                place.remove(CREATION)
        run = cls.open(path)
        run.check_same(plan)
        run.remove_leftovers()
        with suppress(OSError):
            run.tiles.place.make()
        return run

    @classmethod
    def discard(cls, plan: ScenePlan, path: Path | str) -> None:
        """Remove the run at a path unless `check_same` accepts the run. Raise BadInput if a process is computing the run."""
        run = None
        with suppress(BadInput):
            if MANIFEST in place_at(path).names():
                run = cls.open(path)
                run.check_same(plan)
                return
        if run is None:
            return  # If the path holds something other than a run, `prepare` refuses the path later.
        processes = (process for _, process in claims.claimants(run.place) if process)
        if at_work := [*processes, *run.hosts()]:
            process = claims.named(at_work[-1], run.hosts())
            raise BadInput(
                f"{run.path}: is computed by {process}; wait for it, end it, or choose another name"
            )
        run.remove()

    def check_same(self, plan: ScenePlan) -> None:
        """Raise BadInput if the run has another scene than `plan`, or other versions, hashes or processor properties than this process."""
        stored = _flatten(tomllib.loads(self.manifest["scene"])) | self.manifest["identity"]
        current = _flatten(tomllib.loads(plan.scene.toml())) | identity(plan.runs)
        different = differences(stored, current, "in the folder", "now")
        if different:
            raise BadInput(
                f"{self.path}: holds another run; choose another name, or {option('force', True)} replaces it. It differs in"
                f" {different}"
            )

    def check_kept(self) -> None:
        """Raise OSError if another process has removed or replaced the run."""
        with suppress(FileNotFoundError, NotADirectoryError, ValueError):
            if files.parsed(self.place.read(MANIFEST), is_sealed=True).get("key") == self.key:
                return
        raise OSError(
            f"{self.path}: another process has removed this run while it was computed; run its scene again"
        )

    def processes(self) -> Iterator[tuple[str, dict[str, Any], str]]:
        """Yield the name and content of each readable progress file, and the state of the process."""
        for name in sorted(filter(PROGRESS.fullmatch, self.place.names())):
            # A file without the entry `running` gives KeyError, and a time without a zone gives TypeError.
            with suppress(OSError, ValueError, KeyError, TypeError):
                content = files.parsed(self.place.read(name))
                files.check_types(content, PROGRESS_TYPES)
                yield name, content, progress.state(content, partial(self.place.age, name))

    def hosts(self) -> dict[str, str]:
        """Return the hosts, by process, of the processes that are at work according to the progress files."""
        return {c["process"]: c["host"] for _, c, state in self.processes() if state == progress.AT_WORK}

    def levels(self) -> Iterator[Level]:
        """Yield the levels before the first missing level. A damaged level is logged and left out. A run writes it again."""
        from .levels import Level  # only refined runs need this module

        for number in count():
            try:
                yield Level.open(self, number)
            except FileNotFoundError:
                return
            except BadInput as error:
                logging.getLogger("atlas").warning("%s", error)

    def tile_sets(self) -> dict[str, Tiles]:
        """Return the integrated tiles, by level for a refined run, otherwise under an empty name."""
        if self.scene.refine is None:
            return {"": self.tiles}
        return {f"level {level.number}: ": level.tiles for level in self.levels()}

    @property
    def is_complete(self) -> bool:
        """Whether all tiles are written, and the notes too if the run is refined."""
        return not self.tiles.missing() and (self.scene.refine is None or self.notes()[1] is not None)

    def remove_leftovers(self) -> None:
        """Remove temporary files and claims of processes that were killed."""
        self.place.remove_leftovers()
        for name, process in claims.claimants(self.place):
            if not process:
                with suppress(OSError):
                    self.place.remove(name)

    def progress_text(self) -> str:
        """Return a text with the number of finished tiles, or an empty text if the folder of the run has been removed."""
        path, sets = str(self.path), self.tile_sets().values()
        if isinstance(self.path, Path):
            if not self.path.is_dir():
                return ""
            path = os.path.relpath(self.path)
        total = sum(tiles.tiling.count for tiles in sets)
        missing = sum(len(tiles.missing()) for tiles in sets)
        return f"{total - missing} of {total} tiles are in {path if path[0] != '.' else self.path}/"

    def dataset(self) -> xr.Dataset:
        """Return the atlas with a dask chunk for each tile. Values in missing tiles are `not_computed` or nan."""
        import dask.array as da

        totals, is_complete = self.notes()[1], self.is_complete
        if self.scene.refine is not None and not is_complete:
            raise BadInput(
                f"{self.path}: {self.progress_text()}, and more levels may follow; run its scene again first"
            )
        if totals is None or not is_complete:
            totals = self.tiles.check(self.tiles.written())[0]
        chunks = da.core.normalize_chunks(self.tiling.tile, self.scene.shape)
        read = partial(da.map_blocks, _read_chunk, self, chunks=chunks)
        arrays = {
            name: read(name, meta=np.empty([0] * len(chunks), kind)) for name, kind in self.types.items()
        }
        ds = dataset.dataset(self.scene, arrays, self.tiling.tile).assign_attrs(self.attributes(totals))
        if is_complete and totals.tally.counts:
            ds.encoding[TALLY] = totals.tally
        return ds

    def template(self) -> xr.Dataset:
        """Return the atlas with zeros in place of the values, in arrays that take no memory."""
        shape, types = self.scene.shape, self.types.items()
        zeros = {name: np.broadcast_to(np.zeros((), kind), shape) for name, kind in types}
        return dataset.dataset(self.scene, zeros, self.tiling.tile)

    def attributes(self, totals: Totals) -> dict[str, Any]:
        """Return the attributes of the atlas. `totals` has the numbers of points and tiles, and the seconds, summed over all tiles."""
        attributes = {
            name: math.nan if value is None else value for name, value in self.manifest["provenance"].items()
        }
        attributes["atlas_cpu"] = ", ".join(sorted(totals.cpu)) or attributes["atlas_cpu"]
        attributes[RESULT] = result_hash(self.manifest["scene"], self.manifest["identity"])
        attributes["atlas_seconds"] = seconds = totals.seconds
        computed = totals.points - totals.reused.total()
        attributes["atlas_points_per_second"] = computed / seconds if seconds > 0 else math.nan
        attributes |= dataset.history_text(totals.reused)
        # A refined run can be read only when all levels are complete, so that `totals` counts every tile.
        tiles = self.tiling.count if self.scene.refine is None else totals.by.total()
        shares = [f"{number} by {by}" for by, number in sorted(totals.by.items())]
        attributes["atlas_run"] = "; ".join([f"{totals.by.total()} of {tiles} tiles", *shares])
        return attributes | self.notes()[0]

    def save_notes(self, attributes: dict[str, Any], totals: Totals) -> None:
        """Save the attributes of a finished run, and the Totals of the run's tiles."""
        self.check_kept()
        content = {"key": self.key, "attributes": attributes, "totals": totals.table()}
        self.place.write(NOTES, files.sealed(content).encode())

    def notes(self) -> tuple[dict[str, Any], Totals | None]:
        """Return what `save_notes` saved, or ({}, None) if there are no notes. Raise BadInput if the notes are damaged."""
        file = f"{self.place}/{NOTES}"
        try:
            content = files.parsed(self.place.read(NOTES), is_sealed=True)
            files.check_types(content, {"key": str, "attributes": dict, "totals": dict})
            files.check_types(content["attributes"], dict.fromkeys(content["attributes"], ATTRIBUTE))
            if content["key"] != self.key:
                raise ValueError("it belongs to another run")
            totals = Totals()
            totals.add(content["totals"])
            return content["attributes"], totals
        except FileNotFoundError:
            return {}, None
        except OSError as error:
            raise BadInput(f"{file}: cannot be read: {error.strerror}") from None
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise BadInput(files.damaged_message(file, error)) from None

    def join(self, out: Path | str) -> None:
        """Write the atlas as a file or store, box by box in constant memory. An error leaves an earlier file as it was."""
        if not self.is_complete:
            raise BadInput(f"{self.path}: unfinished, {self.progress_text()}; run its scene again first")
        ds, (notes, saved), totals = self.template(), self.notes(), Totals()

        def attributes() -> dict[str, Any]:
            # The notes of a refined atlas contain the cost of the levels, which the tiles do not contain.
            return notes | self.attributes(totals if self.scene.refine is None else saved or totals)

        # Chunks have up to `max_points_per_tile` points, even if tiles are smaller, because a file with many small chunks is slow.
        lengths = Tiling.of(self.scene.shape, grid.max_points_per_tile()).tile
        chunk = dict(zip(dataset.dims(self.scene), lengths, strict=True))
        blocks = self._blocks(lengths, totals)
        finished.format_of(out).write(finished.Content(ds, self.types, chunk, blocks, attributes), out)

    def _blocks(self, lengths: tuple[int, ...], totals: Totals) -> Iterator[Block]:
        """Yield the values of all points in boxes of the given lengths, and add the tiles that are read to `totals`."""
        boxes, types, tiles = Tiling(self.scene.shape, lengths), self.types, count()
        parts = [{name: np.empty(0, dtype) for name, dtype in types.items()}]  # values read but not yielded
        points = 0  # number of points in `parts`
        for box in range(boxes.count):
            size, shape = boxes.size_of(box), boxes.shape_of(box)
            while points < size:
                tile = next(tiles)
                try:
                    header, values = self.tiles.read(tile)
                except (FileNotFoundError, DamagedTile) as error:
                    raise BadInput(f"{self.path}: tile {tile}: {error}; run its scene again first") from None
                totals.add(header)
                parts.append(values)
                points += header["points"]
            flat = {name: np.concatenate([values[name].ravel() for values in parts]) for name in types}
            yield boxes.slices(box), {name: values[:size].reshape(shape) for name, values in flat.items()}
            parts, points = [{name: values[size:] for name, values in flat.items()}], points - size

    def remove(self) -> None:
        """Remove the run, with the manifest last, and then the folder if it is empty."""
        # All tiles are removed in one move, so that a process at work cannot leave tiles behind.
        for part in (self.tiles.place, self.levels_place):
            with suppress(OSError):
                part.clear()
        for name in [*filter(REMNANT.fullmatch, self.place.names()), NOTES, MANIFEST]:
            self.place.remove(name)
        remove_empty(self.path)


def remove_empty(path: Path | str) -> None:
    """Remove the remains of a removed run, except temporary files of processes at work."""
    place = place_at(path)
    names = [name for name in place.names() if not files.TEMPORARY.fullmatch(name)]
    if all(map(REMNANT.fullmatch, names)):
        for name in names:
            place.remove(name)
    if isinstance(path, Path):
        files.remove_leftovers(path)
        with suppress(OSError):
            path.rmdir()


def result_hash(scene: str, programs: dict[str, str]) -> str:
    """Return a hash of the text of a scene and the `identity` of the programs, which determine the bits of an atlas."""
    return files.hash_of({"scene": scene, "identity": programs})


def _new_manifest(plan: ScenePlan) -> dict[str, Any]:
    """Return the manifest of a new run of a scene."""
    scene, kernel = plan.scene, plan.runs.kernel_hash
    attributes = dataset.provenance(
        scene.system, scene.settings, kernel, scene=scene, warnings=plan.warnings, timing=(scene.size, 0.0)
    )  # fmt: skip
    # Tiles of a refined atlas are copied from its levels and take no time, so they may be large.
    finest = Tiling.of(scene.shape, grid.max_points_per_tile())
    manifest = {
        "format": FORMAT,
        "scene": scene.toml(),
        "identity": identity(plan.runs),
        "tile": (plan.tiling if scene.refine is None else finest).tile,
        "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "provenance": {  # None replaces nan, which JSON lacks
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in attributes.items()
        },
    }
    return manifest | {"key": _key(manifest)}


def _key(manifest: dict[str, Any]) -> str:
    """Return the hash of the scene, the programs and the tiling of a manifest."""
    return files.hash_of({name: manifest[name] for name in ("format", "scene", "identity", "tile")})


def _read_chunk(run: RunFolder, name: str, block_id: tuple[int, ...]) -> np.ndarray:
    """Return the values of a variable in a tile, or `not_computed` or nan if the tile is missing or damaged."""
    tile = int(np.ravel_multi_index(block_id, run.tiling.counts))
    try:
        return run.tiles.read(tile, (name,))[1][name]
    except FileNotFoundError:
        pass
    except DamagedTile as error:
        logging.getLogger("atlas").warning("%s: tile %d is damaged: %s", run.path, tile, error)
    dtype = np.dtype(run.types[name])
    missing = variables(run.scene.system)[name].missing if dtype.kind == "i" else np.nan
    return np.full(run.tiling.shape_of(tile), missing, dtype)


def _flatten(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested table as a flat table with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        flat |= _flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
