"""A run: the tiles of a scene computed in memory or in a run folder, by threads or by dask workers."""

from __future__ import annotations

import logging
import random
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..compiling import Stopwatch, announced
from ..engine import blocks
from ..errors import BadInput, shown
from ..files import check_folder, check_name, exists_message
from ..interruption import Stopped, explain_kept
from ..io import checksums, netcdf, zarr_store
from ..io.netcdf import log_warnings, scene_provenance
from ..io.progress import Progress, clock
from ..io.storage import Folder, located, storage_at
from ..label.pipeline import evaluate
from ..label.plan import Plan
from ..scene import grid
from ..scene.checks import MAX_THREADS, typed, whole_number
from ..scene.model import Scene
from ..scene.read import load_scene
from ..validation import half_step
from . import cluster, estimate, refine
from .backend import open_atlas
from .earlier import Earlier, evaluate_at
from .folder import (
    CLAIM_POLL,
    LONGEST_NAME,
    MANIFEST,
    RESULT,
    RunFolder,
    history_text,
    remove_empty,
    result_hash,
)
from .levels import Level, Part, RefinedFolder
from .plan import ScenePlan, differences, identity
from .tiles import TileFiles, Tiling, tile_types

MAX_DAMAGE_WARNINGS = 5
# Seconds between two checks whether tiles that other processes compute are done; between the first CLAIM_POLL.
MAX_CLAIM_POLL = 10.0
RUN_SUFFIX = ".run"  # of the folder in which an atlas of one file is computed
Advance = Callable[[float], None]  # takes a number of finished points


@dataclass(frozen=True)
class _Execution:
    """Processes and threads that compute the tiles, and the shard that they compute; see `run`."""

    threads: int | None
    shard: tuple[int, int] | None
    scheduler: str | None
    workers: int | None
    stop_after: float | None
    began: float  # time.monotonic
    earlier: list[Earlier] = field(default_factory=list)
    clients: list[Any] = field(default_factory=list)  # the client of dask, when it is connected

    @property
    def time_is_up(self) -> bool:
        """Whether no tile may begin any more."""
        return self.stop_after is not None and time.monotonic() - self.began >= self.stop_after

    @property
    def on_cluster(self) -> bool:
        """Whether dask workers compute the tiles."""
        return bool(self.scheduler or self.workers)

    def client(self, plan: ScenePlan, stack: ExitStack) -> Any:
        """The client of dask workers, which is connected once and closed with the stack."""
        if not self.clients:
            if self.workers:
                # Compile the kernel by one step at one point: each new process would compile it otherwise.
                points = replace(plan.points.without_derived(), settings=plan.limited(1))
                if points.outputs:
                    evaluate(points, plan.sample.subset(np.flatnonzero(plan.sample.exists)[:1]), threads=1)
            self.clients.append(stack.enter_context(cluster.connect(self.scheduler, self.workers)))
        return self.clients[0]

    def check(self) -> None:
        """Raise BadInput for values and combinations that are not allowed."""
        if self.on_cluster and self.threads:
            raise BadInput("threads are for a run without scheduler and workers, which run one thread each")
        if self.scheduler and self.workers:
            raise BadInput("scheduler and workers are both given; a run has one of them")
        for name, value in (("threads", self.threads), ("workers", self.workers)):
            if value is not None:
                whole_number(name, value, 1, MAX_THREADS)
        if self.shard is not None:
            if len(self.shard) != 2:
                raise BadInput(f"shard = {shown(self.shard)}: must be (i, n)")
            whole_number("shard: i", self.shard[0], 1, whole_number("shard: n", self.shard[1], 1))
        if self.stop_after is not None and not self.stop_after > 0:
            raise BadInput(f"stop_after = {shown(self.stop_after)}: must be a number of seconds above 0")


@typed
def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    threads: int | None = None,
    progress: bool = True,
    force: bool = False,
    shard: tuple[int, int] | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    stop_after: float | None = None,
    reuse: str | Path | Sequence[str | Path] = (),
) -> xr.Dataset:
    """Integrate every point of a scene, label it, and write the atlas if `out` is given.

    After an error or KeyboardInterrupt, finished tiles stay in the run folder, and the same call continues.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene from `load_scene`, or what `load_scene` reads.
    out : str or Path, optional
        NAME.zarr, or an address such as s3://BUCKET/NAME.zarr, for a Zarr store, which is continued if it exists. NAME.nc for
        one file, which is computed in the run folder NAME.nc.run; the folder is joined and
        removed in the end. If a run was killed between the two, the same call finishes it. Or a run folder:
        a text that ends in /, or a Path without suffix. A run folder that exists is continued.
    threads : int, optional
        Default: all processors of this process. Results do not depend on it.
    progress : bool
        Print progress to stderr.
    force : bool
        Replace an existing file, or another run in the folder or store that no process computes. The run of this scene is
        continued, because its values are the same.
    shard : (int, int), optional
        (i, n) computes only the i-th of n parts, counted from 1; needs a run folder. Of a refined scene a shard computes
        its part of each level first and then what others have not.
    scheduler : str, optional
        Address of a dask scheduler, whose workers compute the tiles.
    workers : int, optional
        Number of processes on this machine that compute the tiles.
    stop_after : float, optional
        Seconds after which no tile begins; those that are being computed are finished. Needs `out`.
    reuse : str, Path or sequence of them, optional
        Earlier atlases, also unfinished run folders, on the same processor by the same programs: points that they share
        with the scene are not computed again. The result is the same to the bit; its attribute `atlas_history` states
        which points were taken from where.

    Returns
    -------
    xarray.Dataset
        The scene's axes as dimensions, the variables it asks for, every parameter as a coordinate, and
        provenance in the attributes. Opened lazily if `out` is given.

    Raises
    ------
    BadInput
        If no point can be computed, or if `out` cannot be written or contains something else, or if an atlas to be
        reused shares no point with the scene. Nothing has then been computed.
    interruption.Stopped
        If `stop_after` is over before the run is; the same call continues it.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    execution = _Execution(threads, shard, scheduler, workers, stop_after, time.monotonic())
    if out is None and (shard or execution.on_cluster or stop_after is not None):
        raise BadInput("shard, scheduler, workers and stop_after need an out that ends in /, .zarr or .nc")
    execution.check()
    origin = systems.origin(scene.system)
    if execution.on_cluster and origin is not None and not origin.package:
        raise BadInput(
            f"the system {scene.system.name} is registered in this process alone, where dask workers cannot find it; run it in"
            " threads, or install it as a package with an entry point in the group atlas.systems"
        )
    path, file = (None, None) if out is None else _destination(out)
    if shard and file:
        raise BadInput(f"shard: {file} is one file; shards need a run folder, a name that ends in / or .zarr")
    if file is not None and file.exists() and not force:
        if not _folder_of(file).exists():
            raise BadInput(exists_message(file))
        return _finished(ScenePlan.of(scene), file)
    if scheduler:
        cluster.check(scheduler)
    plan = ScenePlan.of(scene)
    for each in [reuse] if isinstance(reuse, str | Path) else reuse:
        execution.earlier.append(Earlier.of(each, scene))
    warnings = [*grid.warnings(scene, plan.sample), *plan.chaos_warnings()]
    log_warnings(warnings)
    if path is None:
        return _run_in_memory(plan, warnings, threads, progress, execution.earlier)
    if force:
        RunFolder.discard(plan, path)
    if file is not None:
        return _run_to_file(plan, file, warnings, execution, progress)
    folder = RunFolder.prepare(plan, path, warnings)
    _complete(folder, plan, execution, progress).close()
    explain_kept(None)
    return folder.dataset()


def _destination(out: str | Path) -> tuple[Path | str, Path | None]:
    """Where a run is kept, and the path of an atlas that is one file; BadInput if it cannot be written."""
    place = located(out)
    is_store = zarr_store.is_store(place)
    if is_store:
        zarr_store.zarr_package()
    if isinstance(place, str):
        if not is_store:
            raise BadInput(f"{place}: on object storage the name must end in {zarr_store.SUFFIX}")
        return place, None
    path = place if str(out).startswith("file:") else Path(out)
    check_name(path)
    may_be_folder = isinstance(out, Path) or path.is_dir()  # a Path cannot end in /
    is_folder = str(out).endswith("/") or (may_be_folder and not path.suffix) or (path / MANIFEST).exists()
    if not is_store and not is_folder:
        if path.suffix.lower() != ".nc":
            raise BadInput(
                f"{path}: the name must end in .nc, for one file, in /, for a run folder, or in .zarr, for a Zarr store"
            )
        check_name(_folder_of(path), LONGEST_NAME)
        return _folder_of(path), netcdf.writable(path, (".nc",), force=True)
    check_name(path, LONGEST_NAME)
    checksums.check_path(path)
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: there is no folder {path.parent}")
    return path, None


def _folder_of(path: Path) -> Path:
    """Run folder in which an atlas of one file is computed."""
    return path.with_name(path.name + RUN_SUFFIX)


def _complete(folder: RunFolder, plan: ScenePlan, execution: _Execution, progress: bool) -> Progress:
    """Compute what is missing in a folder or shard; the progress is at work until it is closed."""
    explain_kept(folder.progress_text)
    job = None if isinstance(folder, RefinedFolder) else _Job(folder, execution)
    if isinstance(folder.storage, Folder) and (job.unfinished if job else not folder.is_complete):
        check_folder(folder.storage.path / folder.content / "tile")
    part, parts = execution.shard or (1, 1)
    name = "progress.json" if parts == 1 else f"progress-{part}-of-{parts}.json"
    bar = Progress(
        0,
        show=progress,
        save=partial(folder.storage.write, name),
        facts={"shard": f"{part}/{parts}", "host": socket.gethostname()},
    )
    try:
        with ExitStack() as stack:
            if isinstance(folder, RefinedFolder):
                _compute_levels(folder, bar, plan, execution, stack, progress)
            elif job is not None:
                _compute(job, bar, plan, stack)
                _complete_notes(folder, plan, execution)
    except BaseException as error:
        bar.close()
        if isinstance(error, OSError):
            folder.check_kept()
        raise
    return bar


def _complete_notes(folder: RunFolder, plan: ScenePlan, execution: _Execution) -> None:
    """Write the attributes that only the finished run has, if all tiles are there."""
    try:
        finished = bool(folder.final_attributes()) and (folder.is_complete or not folder.is_store)
    except BadInput as error:
        logging.getLogger("atlas").warning("%s", error)
        finished = False
    if not finished and not folder.tiles.missing():
        folder.save_final_attributes(
            half_step.half_step_sample(plan.scene, plan.points, threads=execution.threads)
        )


def _compute_levels(
    folder: RefinedFolder,
    bar: Progress,
    plan: ScenePlan,
    execution: _Execution,
    stack: ExitStack,
    progress: bool,
) -> None:
    """Compute the levels of a refined scene one after the other, and write its atlas."""
    if folder.is_complete and _is_result(plan, folder.result):
        bar.add(plan.scene.size, done=plan.scene.size)
        return
    levels = list[Level]()

    def integrate(indices: np.ndarray) -> Iterator[Part]:
        level = Level(folder, len(levels), levels[-1].key if levels else "", indices)
        levels.append(level)
        level.prepare()
        _compute(_Job(level, execution), bar, plan, stack)
        yield from level.read(indices)

    path = folder.storage.path if isinstance(folder.storage, Folder) else Path(tempfile.gettempdir())
    fine, attributes = refine.refined(integrate, plan, path, threads=execution.threads, progress=progress)
    folder.save_result(attributes, fine.values, levels)


def _compute(job: _Job, bar: Progress, plan: ScenePlan, stack: ExitStack) -> None:
    """Compute the tiles of a job; a client of dask workers is closed with the stack."""
    folder, execution, logger = job.folder, job.execution, logging.getLogger("atlas")
    for tile, reason in list(job.status.damaged.items())[:MAX_DAMAGE_WARNINGS]:
        logger.warning("%s: tile %d is computed again: %s", folder.storage, tile, reason)
    if len(job.status.damaged) > MAX_DAMAGE_WARNINGS:
        logger.warning("... and %d damaged tiles more", len(job.status.damaged) - MAX_DAMAGE_WARNINGS)
    missing = sum(map(folder.tiling.size_of, job.unfinished))
    bar.add(sum(map(folder.tiling.size_of, job.tiles)), done=sum(map(folder.tiling.size_of, job.status.done)))
    if not job.unfinished:
        return
    if isinstance(folder.storage, Folder):
        path = folder.storage.path
        estimate.check_disk(plan, path, missing, is_joined=path.suffix == RUN_SUFFIX)
    try:
        if execution.on_cluster:
            _compute_on_cluster(job, bar, execution.client(plan, stack))
        else:
            _compute_in_threads(job, bar, plan)
    finally:
        folder.remove_leftovers()
    if job.is_stopped:
        raise Stopped(f"stopped after {clock(execution.stop_after or 0)}; {folder.run.progress_text()}")


def _run_to_file(
    plan: ScenePlan, path: Path, warnings: list[str], execution: _Execution, progress: bool
) -> xr.Dataset:
    """Compute an atlas in its run folder, join it, and remove the folder.

    If another process did the same, it may have removed the folder; the error then means a finished file.
    """
    before, bar, folder = _stamp(path), None, None
    try:
        folder = RunFolder.prepare(plan, _folder_of(path), warnings)
        if _stamp(path) == before:
            bar = _complete(folder, plan, execution, progress)
        if _stamp(path) == before:
            folder.join(path)
            folder.remove()
            explain_kept(None)
            return open_atlas(path)
    except (BadInput, OSError):
        if _stamp(path) == before or not _is_result(plan, path):
            if folder is not None:
                folder.check_kept()
            raise
    finally:
        if bar is not None:
            bar.close()
    return _finished(plan, path)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Number and time of a file, which change when it is replaced; None if there is no file."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns


def _is_result(plan: ScenePlan, path: Path | str) -> bool:
    """Whether a file or a sealed store is the undamaged result of running this scene by these programs."""
    try:
        with open_atlas(path) as ds:
            result = ds.attrs.get(RESULT)
    except BadInput:
        return False
    # A dataset that a user derives from an atlas has its attributes but no checksums.
    whole = zarr_store.is_sealed(storage_at(located(path))) or checksums.are_in(Path(path))
    return whole and result == result_hash(plan.scene.toml(), identity(plan.points))


def _finished(plan: ScenePlan, path: Path) -> xr.Dataset:
    """Open a file that holds the result already, after removing its run folder; BadInput if it does not.

    A run that is killed after it moved the file into place ends here when it is started again.
    """
    if not _is_result(plan, path):
        raise BadInput(exists_message(path))
    folder_path = _folder_of(path)
    try:
        folder = RunFolder.open(folder_path)
        folder.check_same(plan)
    except BadInput:
        remove_empty(folder_path)  # unless it holds something else
    else:
        checksums.verify(path)
        folder.remove()
    return open_atlas(path)


def _run_in_memory(
    plan: ScenePlan, warnings: list[str], threads: int | None, progress: bool, earlier: Sequence[Earlier]
) -> xr.Dataset:
    """Compute an atlas without a run folder."""
    scene, points, stopwatch, reused = plan.scene, 0, Stopwatch(), Counter[str]()

    def integrate(indices: np.ndarray) -> Iterator[Part]:
        nonlocal points
        for (chunk,) in Tiling.of(indices.shape, grid.MAX_POINTS_PER_TILE):
            values, computed, taken = evaluate_at(
                plan.points, scene, indices[chunk], earlier, threads=threads
            )
            points += computed
            reused.update(taken)
            yield indices[chunk], values

    if scene.refine is not None:
        with announced(progress):
            fine, attributes = refine.refined(integrate, plan, None, threads=threads, progress=progress)
        ds = netcdf.dataset(scene, fine.values(())).assign_attrs(attributes)
    else:
        bar = Progress(scene.size, show=progress)
        try:
            columns, reused = columns_of(plan, bar, threads, earlier)
        finally:
            bar.close()
        ds, points = netcdf.dataset(scene, columns), scene.size
    attributes = scene_provenance(
        scene, plan.points.kernel_hash, seconds=stopwatch.seconds(), points=points, warnings=warnings
    )
    if scene.refine is None:
        attributes |= half_step.half_step_sample(scene, plan.points, threads=threads)
    return ds.assign_attrs(attributes | ds.attrs | history_text(reused))


def columns_of(
    plan: ScenePlan, bar: Progress, threads: int | None = None, earlier: Sequence[Earlier] = ()
) -> tuple[dict[str, np.ndarray], Counter[str]]:
    """Variables and solved parameters of all points of a scene, tile by tile; the numbers of points of earlier atlases."""
    scene, tiles, all_reused = plan.scene, plan.tiling, Counter[str]()
    columns = {name: np.empty(scene.size, dtype) for name, dtype in tile_types(scene).items()}

    def compute(tile: int, advance: Advance) -> None:
        indices = tiles.indices(tile)
        values, computed, reused = evaluate_at(
            plan.points, scene, indices, earlier, threads=threads, progress=advance
        )
        for name, column in columns.items():
            column[indices] = values[name]
        all_reused.update(reused)
        bar.skip(indices.size - computed + reused.total())

    in_flight = plan.tiles_in_flight(threads)
    for_each_tile(range(tiles.count), compute, bar.advance, in_flight, Event())
    return columns, all_reused


class _Abandoned(Exception):
    """Ends a tile in flight after another one failed or the user pressed Ctrl-C."""


def for_each_tile(
    tiles: Iterable[int],
    compute: Callable[[int, Advance], None],
    advance: Advance,
    in_flight: int,
    stop: Event,
) -> None:
    """Call compute(tile, advance) in threads; after an error or Ctrl-C, which set `stop`, abandon tiles and raise it."""
    source, lock = iter(tiles), Lock()

    def advance_or_stop(points: float) -> None:
        if stop.is_set():
            raise _Abandoned
        advance(points)

    def worker() -> None:
        with suppress(_Abandoned):
            while not stop.is_set():
                with lock:
                    tile = next(source, None)
                if tile is None:
                    return
                compute(tile, advance_or_stop)

    with ThreadPoolExecutor(in_flight) as pool:
        try:
            for future in as_completed([pool.submit(worker) for _ in range(in_flight)]):
                future.result()
        finally:
            stop.set()


class _Job:
    """The tiles of a run folder, or of one shard of it, that this process has to compute.

    No shard goes on to the next level before this one is complete, so that it computes the tiles of the others too, after its own.
    """

    def __init__(self, folder: RunFolder | Level, execution: _Execution):
        self.folder, self.execution = folder, execution
        self.part, self.parts = execution.shard or (1, 1)
        self.is_stopped = False  # whether the time was over before the tiles were done
        self.stop = Event()  # set when an error or Ctrl-C ends the job
        own = range(self.part - 1, folder.tiling.count, self.parts)
        self.tiles = range(folder.tiling.count) if isinstance(folder, Level) else own
        self.status = folder.tiles.status(self.tiles)
        self.unfinished = sorted([*self.status.missing, *self.status.damaged])

    def remaining_tiles(self, bar: Progress) -> Iterator[int]:
        """Unfinished tiles one by one, from a random one on, so that parallel processes share the work."""
        first = random.randrange(len(self.unfinished))
        tiles, files = self.unfinished[first:] + self.unfinished[:first], self.folder.tiles
        tiles.sort(key=lambda tile: tile % self.parts != self.part - 1)
        pause = CLAIM_POLL
        while tiles:
            claimed, files.listed = [], None
            for tile in tiles:
                if tile not in self.status.damaged and files.was_written(tile):
                    bar.skip(self.folder.tiling.size_of(tile))
                elif self.execution.time_is_up:
                    self.is_stopped = True
                    return
                elif files.claim(tile):
                    if self.status.damaged.pop(tile, None) is None and files.is_written(tile):
                        with files.held(tile):  # written since the folder was listed, perhaps with others
                            bar.skip(self.folder.tiling.size_of(tile))
                        files.listed = None
                    else:
                        yield tile
                else:
                    claimed.append(tile)
            if len(claimed) == len(tiles):
                if self.stop.wait(pause):
                    return
                pause = min(2 * pause, MAX_CLAIM_POLL)
            tiles = claimed


def _compute_in_threads(job: _Job, bar: Progress, plan: ScenePlan) -> None:
    """Compute the tiles of a job in threads of this process."""
    folder, threads, earlier = job.folder, job.execution.threads, job.execution.earlier
    by = f"{threads or blocks.available_threads()} threads"
    by += f", shard {job.part}/{job.parts}" if job.parts > 1 else ""
    stopwatch, last_end, lock = Stopwatch(), 0.0, Lock()

    def compute(tile: int, advance: Advance) -> None:
        nonlocal last_end
        with folder.tiles.held(tile) as keep:

            def report(points: float) -> None:
                keep()
                advance(points)

            columns, computed, reused = evaluate_at(
                plan.points, folder.scene, folder.indices(tile), earlier, threads=threads, progress=report
            )
            with lock:  # tiles overlap: each takes the time since the one before it ended
                now = stopwatch.seconds()
                seconds, last_end = now - last_end, now
            folder.run.check_kept()
            folder.tiles.write(tile, columns, computed=computed, seconds=seconds, by=by, reused=reused)
        bar.skip(folder.tiling.size_of(tile) - computed + reused.total())

    in_flight = plan.tiles_in_flight(threads)
    for_each_tile(job.remaining_tiles(bar), compute, bar.advance, in_flight, job.stop)


def _compute_on_cluster(job: _Job, bar: Progress, client: Any) -> None:
    """Compute the tiles of a job on dask workers."""
    folder = job.folder

    def on_result(tile: int) -> None:
        if not folder.tiles.is_written(tile):
            raise BadInput(
                f"a worker wrote tile {tile}, but it is not in {folder.storage}: workers must see the same files"
            )
        bar.advance(folder.tiling.size_of(tile))

    run = str(folder.run.path), folder.number, folder.key
    reuse = tuple(str(each.path) for each in job.execution.earlier)
    arguments = ((*run, tile, reuse) for tile in job.remaining_tiles(bar))
    cluster.check_workers(client, check_worker, (*run, reuse))
    cluster.for_each(client, compute_tile, arguments, on_result)


def check_worker(path: str, number: int | None, key: str, reuse: tuple[str, ...] = ()) -> None:
    """Raise BadInput unless this worker computes the same bits as the client of a run, which made the key."""
    _open_cached(path, number, key, reuse)


def compute_tile(path: str, number: int | None, key: str, tile: int, reuse: tuple[str, ...] = ()) -> int:
    """Compute and write one tile with one thread, the task of a dask worker; BadInput as `check_worker`."""
    folder, tiles, plan, earlier = _open_cached(path, number, key, reuse)
    stopwatch = Stopwatch()
    with tiles.held(tile) as keep:
        columns, computed, reused = evaluate_at(
            plan, folder.scene, folder.indices(tile), earlier, threads=1, progress=lambda points: keep()
        )
        folder.run.check_kept()
        tiles.write(
            tile, columns, computed=computed, seconds=stopwatch.seconds(), by="dask workers", reused=reused
        )
    return tile


@lru_cache(maxsize=8)
def _open_cached(
    path: str, number: int | None, key: str, reuse: tuple[str, ...]
) -> tuple[RunFolder | Level, TileFiles, Plan, list[Earlier]]:
    """A run whose bits this process computes, its tiles with the key of what this process computes, plan, earlier atlases."""
    run = RunFolder.open(path)
    folder = run if number is None else Level.open(run, number)
    if folder.key != key:
        raise BadInput(f"{path}: holds another run on the machine of this worker ({socket.gethostname()})")
    plan = Plan.of(folder.scene)
    own = identity(plan)
    different = differences(folder.manifest["identity"], own, "in the run", "in the worker")
    if different:
        raise BadInput(
            f"{path}: a dask worker on {socket.gethostname()} would compute other bits; start it again with the"
            f" same programs. It differs in {different}"
        )
    earlier = [Earlier.of(each, folder.scene) for each in reuse]
    return folder, folder.tiles_with(folder.key_with(own)), plan, earlier
