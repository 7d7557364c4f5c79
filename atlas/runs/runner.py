"""A run: the tiles of a scene computed in memory or in a run folder, by threads or by dask workers."""

from __future__ import annotations

import logging
import random
import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from .. import systems
from ..compiling import Stopwatch, announced
from ..engine import blocks
from ..errors import BadInput, shown
from ..files import check_folder, check_name, exists_message
from ..interruption import explain_kept
from ..io import checksums, netcdf
from ..io.netcdf import log_warnings, scene_provenance
from ..io.progress import Progress
from ..label.pipeline import evaluate
from ..label.plan import Plan
from ..scene import grid
from ..scene.checks import MAX_THREADS, typed, whole_number
from ..scene.model import Scene
from ..scene.read import load_scene
from ..validation import half_step
from . import cluster, refine
from .backend import open_atlas
from .folder import LONGEST_NAME, MANIFEST, RESULT, RunFolder, remove_empty, result_hash
from .plan import ScenePlan, differences, identity
from .tiles import TileFiles, tile_types

MAX_DAMAGE_WARNINGS = 5
Advance = Callable[[float], None]  # takes a number of finished points


@dataclass(frozen=True)
class _Execution:
    """Processes and threads that compute the tiles, and the shard that they compute; see `run`."""

    threads: int | None
    shard: tuple[int, int] | None
    scheduler: str | None
    workers: int | None

    @property
    def on_cluster(self) -> bool:
        """Whether dask workers compute the tiles."""
        return bool(self.scheduler or self.workers)

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
) -> xr.Dataset:
    """Integrate every point of a scene, label it, and write the atlas if `out` is given.

    After an error or KeyboardInterrupt, finished tiles stay in the run folder, and the same call continues.
    A scene with [refine] runs in this process only, into memory or one file.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene from `load_scene`, or what `load_scene` reads.
    out : str or Path, optional
        NAME.nc for one file, which is computed in the run folder NAME.nc.run; the folder is joined and
        removed in the end. If a run was killed between the two, the same call finishes it. Or a run folder:
        a text that ends in /, or a Path without suffix. A run folder that exists is continued.
    threads : int, optional
        Default: all processors of this process. Results do not depend on it.
    progress : bool
        Print progress to stderr.
    force : bool
        Replace an existing file.
    shard : (int, int), optional
        (i, n) computes only the i-th of n parts, counted from 1; needs a run folder.
    scheduler : str, optional
        Address of a dask scheduler, whose workers compute the tiles.
    workers : int, optional
        Number of processes on this machine that compute the tiles.

    Returns
    -------
    xarray.Dataset
        The scene's axes as dimensions, the variables it asks for, every parameter as a coordinate, and
        provenance in the attributes. Opened lazily if `out` is given.

    Raises
    ------
    BadInput
        If no point can be computed, or if `out` cannot be written or contains something else. Nothing has then
        been computed.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    execution = _Execution(threads, shard, scheduler, workers)
    if out is None and (shard or execution.on_cluster):
        raise BadInput("shard, scheduler and workers need an out that ends in / or .nc")
    execution.check()
    origin = systems.origin(scene.system)
    if execution.on_cluster and origin is not None and not origin.package:
        raise BadInput(
            f"the system {scene.system.name} is registered in this process alone, where dask workers cannot find it; run it in"
            " threads, or install it as a package with an entry point in the group atlas.systems"
        )
    path, one_file = (None, False) if out is None else _destination(out)
    if shard and one_file:
        raise BadInput(f"shard: {path} is one file; shards need a run folder, a name that ends in /")
    if scene.refine is not None and (shard or execution.on_cluster or (path is not None and not one_file)):
        raise BadInput("refine: a refined scene runs in one process, into memory or one file, NAME.nc")
    if path is not None and one_file and path.exists() and not force:
        if not _folder_of(path).exists():
            raise BadInput(exists_message(path))
        return _finished(ScenePlan.of(scene), path)
    if scheduler:
        cluster.check(scheduler)
    plan = ScenePlan.of(scene)
    warnings = [*grid.warnings(scene, plan.sample), *plan.chaos_warnings()]
    log_warnings(warnings)
    if scene.refine is not None:
        with announced(progress):
            ds = refine.refined(plan, warnings, threads=threads, progress=progress)
        if path is None:
            return ds
        netcdf.write(ds.assign_attrs({RESULT: _own_result_hash(plan)}), path)
        return open_atlas(path)
    if path is None:
        return _run_in_memory(plan, warnings, threads, progress)
    if one_file:
        if force:
            RunFolder.discard(plan, _folder_of(path))
        return _run_to_file(plan, path, warnings, execution, progress)
    folder = RunFolder.prepare(plan, path, warnings)
    _complete(folder, plan, execution, progress).close()
    explain_kept(None)
    return folder.dataset()


def _destination(out: str | Path) -> tuple[Path, bool]:
    """Path of an atlas, and whether it is one file; BadInput if it cannot be written."""
    path = Path(out)
    check_name(path)
    may_be_folder = isinstance(out, Path) or path.is_dir()  # a Path cannot end in /
    is_folder = str(out).endswith("/") or (may_be_folder and not path.suffix) or (path / MANIFEST).exists()
    if not is_folder:
        if path.suffix.lower() != ".nc":
            raise BadInput(f"{path}: the name must end in .nc, for one file, or in /, for a run folder")
        check_name(_folder_of(path), LONGEST_NAME)
        return netcdf.writable(path, (".nc",), force=True), True
    check_name(path, LONGEST_NAME)
    checksums.check_path(path)
    if not path.absolute().parent.is_dir():
        raise BadInput(f"{path}: there is no folder {path.parent}")
    return path, False


def _folder_of(path: Path) -> Path:
    """Run folder in which an atlas of one file is computed."""
    return path.with_name(path.name + ".run")


def _complete(folder: RunFolder, plan: ScenePlan, execution: _Execution, progress: bool) -> Progress:
    """Compute the missing tiles of a folder or shard; the progress is at work until it is closed."""
    explain_kept(folder.progress_text)
    job = _Job(folder, execution.shard or (1, 1))
    logger = logging.getLogger("atlas")
    for tile, reason in list(job.status.damaged.items())[:MAX_DAMAGE_WARNINGS]:
        logger.warning("%s: tile %d is computed again: %s", folder.path, tile, reason)
    if len(job.status.damaged) > MAX_DAMAGE_WARNINGS:
        logger.warning("... and %d damaged tiles more", len(job.status.damaged) - MAX_DAMAGE_WARNINGS)
    if job.unfinished:
        check_folder(folder.tiles.folder / "tile")
    name = "progress.json" if job.parts == 1 else f"progress-{job.part}-of-{job.parts}.json"
    bar = Progress(
        sum(map(folder.tiling.size_of, job.tiles)),
        done=sum(map(folder.tiling.size_of, job.status.done)),
        show=progress and bool(job.unfinished),
        file=folder.path / name,
        facts={"shard": f"{job.part}/{job.parts}", "host": socket.gethostname()},
    )
    try:
        if job.unfinished:
            try:
                if execution.on_cluster:
                    _compute_on_cluster(job, bar, plan, execution)
                else:
                    _compute_in_threads(job, bar, plan, execution.threads)
            finally:
                folder.remove_leftovers()
        try:
            finished = bool(folder.final_attributes())
        except BadInput as error:
            logger.warning("%s", error)
            finished = False
        if not finished and not folder.tiles.missing():
            folder.save_final_attributes(
                half_step.half_step_sample(plan.scene, plan.points, threads=execution.threads)
            )
    except BaseException as error:
        bar.close()
        if isinstance(error, OSError):
            folder.check_kept()
        raise
    return bar


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


def _is_result(plan: ScenePlan, path: Path) -> bool:
    """Whether a file is the undamaged result of running this scene by these programs."""
    try:
        with open_atlas(path) as ds:
            result = ds.attrs.get(RESULT)
    except BadInput:
        return False
    # A dataset that a user derives from an atlas has its attributes but no checksums.
    return result is not None and checksums.are_in(path) and result == _own_result_hash(plan)


def _own_result_hash(plan: ScenePlan) -> str:
    """Hash of the result of a scene as computed by this process."""
    return result_hash(plan.scene.toml(), identity(plan.points))


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


def _run_in_memory(plan: ScenePlan, warnings: list[str], threads: int | None, progress: bool) -> xr.Dataset:
    """Compute an atlas without a run folder."""
    scene, tiles = plan.scene, plan.tiling
    columns = {name: np.empty(scene.size, dtype) for name, dtype in tile_types(scene).items()}
    bar = Progress(scene.size, show=progress)

    def compute(tile: int, advance: Advance) -> None:
        indices = tiles.indices(tile)
        points = grid.points_at_indices(scene, indices)
        values = evaluate(plan.points, points, threads=threads, progress=advance) | points.base
        for name, column in columns.items():
            column[indices] = values[name]
        bar.skip(indices.size - int(points.exists.sum()))

    try:
        for_each_tile(range(tiles.count), compute, bar.advance, plan.tiles_in_flight(threads))
    finally:
        bar.close()
    attributes = scene_provenance(
        scene, plan.points.kernel_hash, seconds=bar.stopwatch.seconds(), points=scene.size, warnings=warnings
    )
    attributes |= half_step.half_step_sample(plan.scene, plan.points, threads=threads)
    return netcdf.dataset(scene, columns).assign_attrs(attributes)


class _Stopped(Exception):
    """Ends a tile in flight after another one failed or the user pressed Ctrl-C."""


def for_each_tile(
    tiles: Iterable[int], compute: Callable[[int, Advance], None], advance: Advance, in_flight: int
) -> None:
    """Call compute(tile, advance) in threads; after an error or Ctrl-C abandon tiles and raise it."""
    source, lock, stop = iter(tiles), threading.Lock(), threading.Event()

    def advance_or_stop(points: float) -> None:
        if stop.is_set():
            raise _Stopped
        advance(points)

    def worker() -> None:
        with suppress(_Stopped):
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
    """The tiles of a run folder, or of one shard of it, that this process has to compute."""

    def __init__(self, folder: RunFolder, shard: tuple[int, int]):
        self.folder = folder
        self.part, self.parts = shard
        self.tiles = range(self.part - 1, folder.tiling.count, self.parts)
        self.status = folder.tiles.status(self.tiles)
        self.unfinished = sorted([*self.status.missing, *self.status.damaged])

    def remaining_tiles(self, bar: Progress) -> Iterator[int]:
        """Unfinished tiles one by one, from a random one on, so that parallel processes share the work."""
        first = random.randrange(len(self.unfinished))
        for tile in self.unfinished[first:] + self.unfinished[:first]:
            if tile not in self.status.damaged and self.folder.tiles.is_done(tile):
                bar.skip(self.folder.tiling.size_of(tile))
            else:
                yield tile


def _compute_in_threads(job: _Job, bar: Progress, plan: ScenePlan, threads: int | None) -> None:
    """Compute the tiles of a job in threads of this process."""
    folder = job.folder
    by = f"{threads or blocks.available_threads()} threads"
    by += f", shard {job.part}/{job.parts}" if job.parts > 1 else ""
    stopwatch, last_end, lock = Stopwatch(), 0.0, threading.Lock()

    def compute(tile: int, advance: Advance) -> None:
        nonlocal last_end
        columns, computed = _tile_columns(plan.points, folder, tile, threads, advance)
        with lock:  # tiles overlap: each takes the time since the one before it ended
            now = stopwatch.seconds()
            seconds, last_end = now - last_end, now
        folder.check_kept()
        folder.tiles.write(tile, columns, computed=computed, seconds=seconds, by=by)
        bar.skip(folder.tiling.size_of(tile) - computed)

    for_each_tile(job.remaining_tiles(bar), compute, bar.advance, plan.tiles_in_flight(threads))


def _tile_columns(
    plan: Plan, folder: RunFolder, tile: int, threads: int | None, progress: Advance | None
) -> tuple[dict[str, np.ndarray], int]:
    """Columns of a tile by name, and the number of its points where the family exists."""
    points = grid.points_at_indices(folder.scene, folder.tiling.indices(tile))
    values = evaluate(plan, points, threads=threads, progress=progress) | points.base
    return {name: values[name] for name in folder.tiles.types}, int(points.exists.sum())


def _compute_on_cluster(job: _Job, bar: Progress, plan: ScenePlan, execution: _Execution) -> None:
    """Compute the tiles of a job on dask workers."""
    folder = job.folder
    if execution.workers:
        # Compile the kernel by one step at one point: each new process would compile it otherwise.
        points = replace(plan.points.without_derived(), settings=plan.limited(1))
        if points.outputs:
            evaluate(points, plan.sample.subset(np.flatnonzero(plan.sample.exists)[:1]), threads=1)

    def on_result(tile: int) -> None:
        if not folder.tiles.is_written(tile):
            raise BadInput(
                f"a worker wrote tile {tile}, but it is not in {folder.path}: workers must see the same files"
            )
        bar.advance(folder.tiling.size_of(tile))

    run = str(folder.path), folder.key
    arguments = ((*run, tile) for tile in job.remaining_tiles(bar))
    with cluster.connect(execution.scheduler, execution.workers) as client:
        cluster.check_workers(client, check_worker, run)
        cluster.for_each(client, compute_tile, arguments, on_result)


def check_worker(path: str, key: str) -> None:
    """Raise BadInput unless this worker computes the same bits as the client of a run, which made the key."""
    _open_cached(path, key)


def compute_tile(path: str, key: str, tile: int) -> int:
    """Compute and write one tile with one thread, the task of a dask worker; BadInput as `check_worker`."""
    folder, tiles, plan = _open_cached(path, key)
    stopwatch = Stopwatch()
    columns, computed = _tile_columns(plan, folder, tile, 1, None)
    folder.check_kept()
    tiles.write(tile, columns, computed=computed, seconds=stopwatch.seconds(), by="dask workers")
    return tile


@lru_cache(maxsize=8)
def _open_cached(path: str, key: str) -> tuple[RunFolder, TileFiles, Plan]:
    """A run whose bits this process computes, its tiles with the key of what this process computes, and its plan."""
    folder = RunFolder.open(path)
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
    return folder, TileFiles(folder.tiles.folder, folder.key_with(own), folder.scene, folder.tiling), plan
