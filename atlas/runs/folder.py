"""Runs in a folder or bucket. Threads or dask workers compute the tiles of a run, and the tiles may be joined into one file."""

from __future__ import annotations

import logging
import math
import random
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..extension import not_loaded
from ..files import check_folder, check_name, exists_message
from ..interruption import explain_kept
from ..kernel import blocks
from ..kernel.compiling import Stopwatch
from ..label import half_step
from ..label.plan import Plan
from ..process import process_name
from ..scene.model import Scene
from ..store import finished
from ..store.finished import format_of
from ..store.place import Folder, located, place_at
from ..store.progress import AT_WORK, Progress
from ..store.tally import Totals
from ..store.tile import Tiles
from ..store.tiling import surely_fits
from . import claims
from .backend import open_atlas
from .memory import Advance, Execution, evaluate_at, for_each_tile
from .plan import ScenePlan, differences, identity
from .run import JOINING, LONGEST_NAME, MANIFEST, RESULT, RUN_SUFFIX, RunFolder, remove_empty, result_hash

if TYPE_CHECKING:
    from .levels import Part
    from .reuse import Earlier

MAX_DAMAGE_WARNINGS = 5
# A process that waits for tiles of other processes looks for them after pauses that grow from claims.POLL to this many seconds.
MAX_CLAIM_POLL = 10.0
# What a process needs to compute a tile.
Source: TypeAlias = "tuple[RunFolder, Tiles, Plan, list[Earlier]]"


def run_kept(
    scene: Scene,
    out: str | Path,
    reuse: str | Path | Sequence[str | Path],
    options: Mapping[str, Any],
    *,
    force: bool,
) -> xr.Dataset:
    """Compute a scene in a folder, a bucket or one file. The arguments are described in `execution.run`."""
    path, file = destination(out)
    if options["shard"] and file:
        raise BadInput(f"shard: {file} is one file; shards need a run folder, a name that ends in /")
    if file is not None and not force and format_of(file).stamp(file) is not None:
        left = folder_of(file)  # may remain if a process was killed while it removed the folder
        if MANIFEST not in place_at(left).names() and not (isinstance(left, Path) and left.exists()):
            raise BadInput(exists_message(file))
        return finished_atlas(ScenePlan.of(scene), file)
    if options["scheduler"]:
        from . import cluster

        cluster.check(options["scheduler"])
    execution = Execution.of(scene, reuse, options)
    if force:
        RunFolder.discard(execution.plan, path)
    if file is not None:
        return run_to_file(file, execution)
    folder = RunFolder.prepare(execution.plan, path, execution.check_time)
    with complete(folder, execution):
        explain_kept(None)
    return folder.dataset()


def destination(out: str | Path) -> tuple[Path | str, Path | str | None]:
    """Return the place of a run, and the file or store to write (None for a run folder). Raise BadInput if `out` cannot be written."""
    place = located(out)
    if isinstance(place, Path):
        check_name(place)
    if place_at(place).stamp(f"atlas/{MANIFEST}") is not None and format_of(place).stamp(place) is None:
        RunFolder.open(place)  # raises BadInput for an unfinished store of a version before 0.1.0
    is_run = str(out).endswith("/") or MANIFEST in place_at(place).names()
    if isinstance(place, str):
        if finished.is_store(place):
            return folder_of(place), format_of(place).writable(place, force=True)
        if is_run:
            return place, None
        raise BadInput(
            f"{place}: on object storage the name must end in /, for a run, or in {finished.STORE}, for a Zarr store"
        )
    path = place if str(out).startswith("file:") else Path(out)
    # A Path drops a final /, so a Path without suffix may mean a folder.
    may_be_folder = isinstance(out, Path) or (path.is_dir() and not finished.is_store(path))
    if is_run or (may_be_folder and not path.suffix):
        check_name(path, LONGEST_NAME)
        if not path.absolute().parent.is_dir():
            raise BadInput(f"{path}: there is no folder {path.parent}")
        return path, None
    suffixes = finished.suffixes()
    if path.suffix.lower() not in suffixes:
        ways = [f"in {suffix}, {atlases}" for suffix, atlases in suffixes.items()]
        ways.insert(1, "in /, for a run folder")
        raise BadInput(f"{path}: the name must end {', '.join(ways[:-1])}, or {ways[-1]}{not_loaded()}")
    check_name(Path(folder_of(path)), LONGEST_NAME)
    return folder_of(path), format_of(path).writable(path, force=True)


def folder_of(path: Path | str) -> Path | str:
    """Return the run folder in which the atlas for the file or store `path` is computed."""
    return path.with_name(path.name + RUN_SUFFIX) if isinstance(path, Path) else path + RUN_SUFFIX


@contextmanager
def complete(folder: RunFolder, execution: Execution) -> Iterator[Progress]:
    """Compute the missing tiles of a run or shard. The progress file says "at work" until the context is closed."""
    explain_kept(folder.progress_text)
    part, parts = execution.shard
    is_missing = any(tile % parts == part - 1 for tile in folder.tiles.missing())
    if isinstance(folder.place, Folder) and is_missing:
        check_folder(folder.place.path / "tiles" / "tile")
    facts = {"shard": f"{part}/{parts}", "host": socket.gethostname()}
    for name, content, state in folder.processes():
        if content["shard"] == facts["shard"] and state != AT_WORK:
            with suppress(OSError):
                folder.place.remove(name)
    save = partial(folder.place.write, f"progress-{process_name()}.json", durable=False)
    if is_missing:
        execution.name_cheaper_method()
    bar = Progress(0, show=execution.progress, save=save, facts=facts)
    try:
        with execution.stack:
            if folder.scene.refine is not None:
                _compute_levels(folder, bar, execution)
            else:
                own = range(part - 1, folder.tiling.count, parts)
                totals = _Job(folder, folder.tiles, own, execution).compute(bar)
                _complete_notes(folder, execution, totals if parts == 1 else None)
        yield bar
    except (BadInput, OSError):
        folder.check_kept()
        raise
    finally:
        bar.close()


def _complete_notes(folder: RunFolder, execution: Execution, totals: Totals | None) -> None:
    """Write the notes of a run if no tile is missing. `totals` are the Totals of all tiles, or None if a single shard was run."""
    if folder.tiles.missing():
        return
    if totals is None:
        totals, damaged = folder.tiles.check(range(folder.tiling.count))
        if damaged:
            return
    try:
        attributes, saved = folder.notes()
    except BadInput as error:
        logging.getLogger("atlas").warning("%s", error)
        attributes, saved = {}, None
    if not attributes:
        plan = execution.plan
        attributes = half_step.half_step_sample(
            plan.scene, plan.runs, threads=blocks.Threads(execution.threads)
        )
    elif saved and saved.table() == totals.table():
        return
    folder.save_notes(attributes, totals)


def _compute_levels(folder: RunFolder, bar: Progress, execution: Execution) -> None:
    """Compute the levels of a refined scene one by one, then write the tiles of the finest grid from the levels."""
    from . import refine
    from .levels import Level

    plan, tiles, levels, totals = execution.plan, folder.tiles, list[Level](), Totals()
    _warn_and_remove(tiles, tiles.check(tiles.written())[1])
    with suppress(BadInput):  # damaged notes raise BadInput and are written again below
        if folder.is_complete:
            bar.add(plan.scene.size, done=plan.scene.size)
            return

    def integrate(indices: np.ndarray) -> Iterator[Part]:
        before, most = levels[-1].key if levels else "", math.prod(plan.tiling.tile)
        folder.check_kept()
        level = Level.of(folder, len(levels), before, indices, most)
        levels.append(level)
        job = _Job(folder, level.tiles, range(level.tiles.tiling.count), execution, level.number)
        totals.add(job.compute(bar).table())
        yield from level.read(indices)

    scratch = folder.place.path if isinstance(folder.place, Folder) else Path(tempfile.gettempdir())
    fine, attributes = refine.refined(
        integrate, plan, scratch, blocks.Threads(execution.threads), progress=execution.progress
    )
    folder.check_kept()
    for tile in tiles.missing():
        columns, indices = fine.values(folder.tiling.slices(tile)), tiles.indices(tile)
        numbers = folder.types.keys() - columns
        columns |= {name: np.full(folder.tiling.shape_of(tile), np.nan) for name in numbers}
        for level in levels:
            level.fill({name: columns[name] for name in numbers}, indices)
        tiles.write(tile, columns, computed=int(columns["computed"].sum()), seconds=0.0, by="refinement")
    result, damaged = tiles.check(range(folder.tiling.count))
    if damaged:
        raise OSError(f"{folder.path}: tile {min(damaged)}: {damaged[min(damaged)]}; run the scene again")
    folder.save_notes(attributes, replace(totals, tally=result.tally))


def run_to_file(path: Path | str, execution: Execution) -> xr.Dataset:
    """Compute an atlas in a run folder, join the tiles and remove the folder. If another process is faster, open its atlas."""
    before, plan, is_joined = format_of(path).stamp(path), execution.plan, False

    def is_open() -> bool:
        """Whether no other process has written the atlas."""
        return format_of(path).stamp(path) in (before, None)

    try:
        folder = RunFolder.prepare(plan, folder_of(path), execution.check_time)
        if is_open():
            with complete(folder, execution) as bar:
                wait = claims.Wait(folder.place, folder.hosts)
                # Only one process may join, because on an object store a second process would remove the objects of the first.
                while not is_joined and is_open():
                    if not claims.claim(folder.place, JOINING):
                        execution.check_time(folder.progress_text())
                        wait.announce(JOINING)
                        time.sleep(claims.POLL)
                        continue
                    with claims.held(folder.place, JOINING):
                        if is_open():
                            folder.join(path)
                            is_joined = True
                if is_joined:
                    bar.close()  # otherwise the bar would write progress into the removed folder
                    folder.remove()
                    explain_kept(None)
    except (BadInput, OSError):
        if is_open() or not _is_result(plan, path):
            raise
    return open_atlas(path) if is_joined else finished_atlas(plan, path)


def _is_result(plan: ScenePlan, path: Path | str) -> bool:
    """Whether a file or store is the result of this scene and the current programs. The values may be damaged."""
    expected = result_hash(plan.scene.toml(), identity(plan.runs))
    with suppress(BadInput), open_atlas(path) as ds:
        # A dataset that a user derived from an atlas may keep the attribute RESULT, but it has no hash.
        return format_of(path).has_hash(path) and ds.attrs.get(RESULT) == expected
    return False


def finished_atlas(plan: ScenePlan, path: Path | str) -> xr.Dataset:
    """Open a finished atlas and remove the rest of its run folder. Raise BadInput if the atlas is the result of another run."""
    if not _is_result(plan, path):
        raise BadInput(exists_message(path))
    try:  # a process that was killed after it wrote the atlas has left a run folder
        folder = RunFolder.open(folder_of(path))
        folder.check_same(plan)
    except BadInput:
        remove_empty(folder_of(path))
    else:
        format_of(path).verify(path)
        folder.remove()
    return open_atlas(path)


@dataclass(eq=False)
class _Job:
    """The computation of some tiles of a run. Other processes may compute some of these tiles."""

    run: RunFolder
    tiles: Tiles
    share: range  # tiles of the shard; of a refined run all tiles of a level, as the next level needs them
    execution: Execution
    level: int | None = None
    stop: Event = field(default_factory=Event)  # set when an error or Ctrl-C ends the job
    own: set[int] = field(default_factory=set)  # tiles that this process wrote and read back
    totals: Totals = field(default_factory=Totals)  # sums over the tiles in `own`

    def remaining_tiles(self, unfinished: Sequence[int], bar: Progress) -> Iterator[int]:
        """Claim and yield unfinished tiles. The first tile is random, so that parallel processes rarely meet at a tile."""
        first, (part, parts) = random.randrange(len(unfinished)), self.execution.shard
        files, size_of = self.tiles, self.tiles.tiling.size_of
        tiles = sorted([*unfinished[first:], *unfinished[:first]], key=lambda tile: tile % parts != part - 1)
        pause, wait = claims.POLL, claims.Wait(files.place, self.run.hosts)
        while tiles:
            claimed, files.listing = [], None
            for tile in tiles:
                if files.was_written(tile):
                    bar.skip(size_of(tile))
                elif self.execution.time_is_up:
                    return
                elif claims.claim(files.place, files.name(tile, claims.SUFFIX)):
                    if files.is_written(tile):
                        # The listing of the folder is out of date, since another process has written the tile.
                        files.place.remove(files.name(tile, claims.SUFFIX))
                        bar.skip(size_of(tile))
                        files.listing = None
                    else:
                        yield tile
                else:
                    claimed.append(tile)
            if len(claimed) == len(tiles):
                wait.announce(files.name(claimed[0], claims.SUFFIX))
                if self.stop.wait(pause):
                    return
                pause = min(2 * pause, MAX_CLAIM_POLL)
            tiles = claimed

    def compute(self, bar: Progress) -> Totals:
        """Compute missing and damaged tiles, and return the Totals of `share`. Raise Stopped if the time is up before the last tile."""
        size_of, written = self.tiles.tiling.size_of, self.tiles.written()
        unfinished = [tile for tile in self.share if tile not in written]
        done = sum(size_of(tile) for tile in self.share if tile in written)
        bar.add(sum(map(size_of, self.share)), done=done)
        while True:
            if unfinished:
                self._compute(unfinished, bar)
            totals, damaged = self.tiles.check(tile for tile in self.share if tile not in self.own)
            if not damaged:
                totals.add(self.totals.table())
                return totals
            _warn_and_remove(self.tiles, damaged)
            unfinished = sorted(damaged)
            bar.skip(-sum(map(size_of, unfinished)))

    def _compute(self, unfinished: Sequence[int], bar: Progress) -> None:
        """Compute the tiles `unfinished`, and skip tiles that other processes finish first."""
        execution, run = self.execution, self.run
        if isinstance(run.place, Folder) and not surely_fits(run.scene, run.place.path):
            from . import estimate

            path, points = run.place.path, sum(map(self.tiles.tiling.size_of, unfinished))
            estimate.check_disk(execution.plan, path, points, is_joined=path.suffix == RUN_SUFFIX)
        self.stop = Event()
        remaining = self.remaining_tiles(unfinished, bar)
        try:
            if execution.scheduler or execution.workers:
                self._compute_on_cluster(remaining, bar)
            else:
                self._compute_in_threads(remaining, bar)
        finally:
            run.remove_leftovers()
        if execution.time_is_up and not all(map(self.tiles.is_written, unfinished)):
            execution.check_time(run.progress_text())

    def _compute_in_threads(self, tiles: Iterator[int], bar: Progress) -> None:
        plan, threads, (part, parts) = self.execution.plan, self.execution.threads, self.execution.shard
        source = self.run, self.tiles, plan.runs, self.execution.earlier
        by = f"{threads or blocks.available_threads()} threads" + f", shard {part}/{parts}" * (parts > 1)
        stopwatch, last_end, lock = Stopwatch(), 0.0, Lock()

        def seconds() -> float:
            """Return the seconds since the last tile ended. Durations of tiles overlap, so their sum would be too long."""
            nonlocal last_end
            with lock:
                before, last_end = last_end, stopwatch.seconds()
                return last_end - before

        def compute(tile: int, advance: Advance) -> None:
            header = _compute_tile(source, tile, blocks.Threads(threads, advance), by, seconds)
            bar.skip(header["points"] - header["computed"] + sum(header["reused"].values()))
            with lock:
                self.own.add(tile)
                self.totals.add(header)

        for_each_tile(tiles, compute, bar.advance, plan.tiles_in_flight(threads), self.stop)

    def _compute_on_cluster(self, tiles: Iterator[int], bar: Progress) -> None:
        def on_result(tile: int) -> None:
            if not self.tiles.is_written(tile):
                raise BadInput(
                    f"a worker wrote tile {tile}, but it is not in {self.tiles.place}: workers must see the same files"
                )
            bar.advance(self.tiles.tiling.size_of(tile))

        from . import cluster

        client, place = self.execution.client, (str(self.run.path), self.level, self.tiles.key)
        reuse = tuple(str(each.path) for each in self.execution.earlier)
        cluster.check_workers(client, check_worker, (*place, reuse))
        cluster.for_each(client, compute_tile, ((*place, tile, reuse) for tile in tiles), on_result)


def _warn_and_remove(tiles: Tiles, damaged: dict[int, str]) -> None:
    """Log warnings about damaged tiles, and remove the tiles so that they are computed again."""
    warn = logging.getLogger("atlas").warning
    for tile, reason in list(damaged.items())[:MAX_DAMAGE_WARNINGS]:
        warn("%s: tile %d is computed again: %s", tiles.place, tile, reason)
    if len(damaged) > MAX_DAMAGE_WARNINGS:
        warn("... and %d damaged tiles more", len(damaged) - MAX_DAMAGE_WARNINGS)
    for tile in damaged:
        tiles.place.remove(tiles.name(tile))


def _compute_tile(
    source: Source, tile: int, threads: blocks.Threads, by: str, seconds: Callable[[], float]
) -> dict[str, Any]:
    """Compute and write a tile, and return the header of the tile."""
    run, tiles, plan, earlier = source
    with claims.held(tiles.place, tiles.name(tile, claims.SUFFIX)):
        columns, computed, reused = evaluate_at(plan, run.scene, tiles.indices(tile), earlier, threads)
        run.check_kept()
        return tiles.write(tile, columns, computed=computed, seconds=seconds(), by=by, reused=reused)


def check_worker(path: str, level: int | None, key: str, reuse: tuple[str, ...] = ()) -> None:
    """Raise BadInput unless the run at `path` has this key, and this worker would compute the same bits as the run's other processes."""
    _open_cached(path, level, key, reuse)


def compute_tile(path: str, level: int | None, key: str, tile: int, reuse: tuple[str, ...] = ()) -> int:
    """Compute and write a tile with one thread, as the task of a dask worker. Raise BadInput as `check_worker` does."""
    source = _open_cached(path, level, key, reuse)
    _compute_tile(source, tile, blocks.Threads(1), "dask workers", Stopwatch().seconds)
    return tile


@lru_cache(maxsize=8)
def _open_cached(path: str, level: int | None, key: str, reuse: tuple[str, ...]) -> Source:
    """Return the source of the tiles of a run or level. Raise BadInput as `check_worker` does."""
    run = RunFolder.open(path)
    tiles = run.tiles
    if level is not None:
        from .levels import Level

        try:
            tiles = Level.open(run, level).tiles
        except FileNotFoundError:
            raise BadInput(f"{path}: level {level} is not there: workers must see the same files") from None
    if tiles.key != key:
        raise BadInput(f"{path}: holds another run on the machine of this worker ({socket.gethostname()})")
    plan = Plan.of(run.scene)
    if different := differences(run.manifest["identity"], identity(plan), "in the run", "in the worker"):
        raise BadInput(
            f"{path}: a dask worker on {socket.gethostname()} would compute other bits; start it again with the"
            f" same programs. It differs in {different}"
        )
    return run, tiles, plan, [Earlier.of(each, run.scene) for each in reuse]
