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
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from threading import Event, Lock
from typing import Any, TypeAlias

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
from .tiles import Tiling, tile_types

MAX_DAMAGE_WARNINGS = 5
# Seconds between two checks whether tiles that other processes compute are done; between the first CLAIM_POLL.
MAX_CLAIM_POLL = 10.0
RUN_SUFFIX = ".run"  # of the folder in which an atlas of one file is computed
Advance = Callable[[float], None]  # takes a number of finished points
Source: TypeAlias = tuple[RunFolder | Level, Plan, list[Earlier]]  # what tiles are computed from


@dataclass
class _Execution:
    """Processes and threads that compute the tiles, and the shard that they compute; see `run`."""

    threads: int | None
    shard: tuple[int, int] | None
    scheduler: str | None
    workers: int | None
    stop_after: float | None
    began: float  # time.monotonic
    progress: bool = True
    plan: ScenePlan = field(init=False)
    earlier: list[Earlier] = field(default_factory=list)
    stack: ExitStack = field(default_factory=ExitStack)  # closes the client of dask

    @property
    def time_is_up(self) -> bool:
        """Whether no tile may begin any more."""
        return self.stop_after is not None and time.monotonic() - self.began >= self.stop_after

    @property
    def on_cluster(self) -> bool:
        """Whether dask workers compute the tiles."""
        return bool(self.scheduler or self.workers)

    @cached_property
    def client(self) -> Any:
        """The client of the dask workers."""
        if self.workers:
            # Compile the kernel by one step at one point: each new process would compile it otherwise.
            sample = self.plan.sample
            points = replace(self.plan.points.without_derived(), settings=self.plan.limited(1))
            if points.outputs:
                evaluate(points, sample.subset(np.flatnonzero(sample.exists)[:1]), threads=1)
        return self.stack.enter_context(cluster.connect(self.scheduler, self.workers))

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
    execution = _Execution(threads, shard, scheduler, workers, stop_after, time.monotonic(), progress)
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
    execution.plan = plan = ScenePlan.of(scene)
    for each in [reuse] if isinstance(reuse, str | Path) else reuse:
        execution.earlier.append(Earlier.of(each, scene))
    warnings = [*grid.warnings(scene, plan.sample), *plan.chaos_warnings()]
    log_warnings(warnings)
    if path is None:
        return _run_in_memory(warnings, execution)
    if force:
        RunFolder.discard(plan, path)
    if file is not None:
        return _run_to_file(file, warnings, execution)
    folder = RunFolder.prepare(plan, path, warnings)
    with _complete(folder, execution):
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


@contextmanager
def _complete(folder: RunFolder, execution: _Execution) -> Iterator[None]:
    """Compute what is missing in a folder or shard; this process counts as at work while the context is open."""
    explain_kept(folder.progress_text)
    job = None if isinstance(folder, RefinedFolder) else _Job(folder, execution)
    if isinstance(folder.storage, Folder) and (job.unfinished if job else not folder.is_complete):
        check_folder(folder.storage.path / folder.content / "tile")
    part, parts = execution.shard or (1, 1)
    name = "progress.json" if parts == 1 else f"progress-{part}-of-{parts}.json"
    facts = {"shard": f"{part}/{parts}", "host": socket.gethostname()}
    bar = Progress(0, show=execution.progress, save=partial(folder.storage.write, name), facts=facts)
    try:
        with execution.stack:
            if isinstance(folder, RefinedFolder):
                _compute_levels(folder, bar, execution)
            elif job is not None:
                job.compute(bar)
                _complete_notes(folder, execution)
        yield
    except (BadInput, OSError):
        folder.check_kept()
        raise
    finally:
        bar.close()


def _complete_notes(folder: RunFolder, execution: _Execution) -> None:
    """Write the attributes that only the finished run has, if all tiles are there."""
    try:
        finished = bool(folder.final_attributes()) and (folder.is_complete or not folder.is_store)
    except BadInput as error:
        logging.getLogger("atlas").warning("%s", error)
        finished = False
    if not finished and not folder.tiles.missing():
        plan, threads = execution.plan, execution.threads
        folder.save_final_attributes(half_step.half_step_sample(plan.scene, plan.points, threads=threads))


def _compute_levels(folder: RefinedFolder, bar: Progress, execution: _Execution) -> None:
    """Compute the levels of a refined scene one after the other, and write its atlas."""
    plan, levels = execution.plan, list[Level]()
    if folder.is_complete and _is_result(plan, folder.result):
        bar.add(plan.scene.size, done=plan.scene.size)
        return

    def integrate(indices: np.ndarray) -> Iterator[Part]:
        level = Level(folder, len(levels), levels[-1].key if levels else "", indices)
        levels.append(level)
        level.prepare()
        _Job(level, execution).compute(bar)
        yield from level.read(indices)

    path = folder.storage.path if isinstance(folder.storage, Folder) else Path(tempfile.gettempdir())
    fine, attributes = refine.refined(
        integrate, plan, path, threads=execution.threads, progress=execution.progress
    )
    folder.save_result(attributes, fine.values, levels)


def _run_to_file(path: Path, warnings: list[str], execution: _Execution) -> xr.Dataset:
    """Compute an atlas in its run folder, join it, and remove the folder.

    If another process did the same, it may have removed the folder; the error then means a finished file.
    """
    before, plan = _stamp(path), execution.plan
    try:
        folder = RunFolder.prepare(plan, _folder_of(path), warnings)
        if _stamp(path) == before:
            with _complete(folder, execution):
                if _stamp(path) == before:
                    folder.join(path)
                    folder.remove()
                    explain_kept(None)
                    return open_atlas(path)
    except (BadInput, OSError):
        if _stamp(path) == before or not _is_result(plan, path):
            raise
    return _finished(plan, path)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Number and time of a file, which change when it is replaced; None if there is no file."""
    with suppress(FileNotFoundError):
        status = path.stat()
        return status.st_ino, status.st_mtime_ns
    return None


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


def _run_in_memory(warnings: list[str], execution: _Execution) -> xr.Dataset:
    """Compute an atlas without a run folder."""
    plan, threads, earlier = execution.plan, execution.threads, execution.earlier
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
        with announced(execution.progress):
            fine, attributes = refine.refined(
                integrate, plan, None, threads=threads, progress=execution.progress
            )
        ds = netcdf.dataset(scene, fine.values(())).assign_attrs(attributes)
    else:
        with closing(Progress(scene.size, show=execution.progress)) as bar:
            columns, reused = columns_of(plan, bar, threads, earlier)
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

    def compute(self, bar: Progress) -> None:
        """Compute the unfinished tiles; Stopped if the time is over before."""
        folder, execution, damaged = self.folder, self.execution, self.status.damaged
        warn, size_of = logging.getLogger("atlas").warning, folder.tiling.size_of
        for tile, reason in list(damaged.items())[:MAX_DAMAGE_WARNINGS]:
            warn("%s: tile %d is computed again: %s", folder.storage, tile, reason)
        if len(damaged) > MAX_DAMAGE_WARNINGS:
            warn("... and %d damaged tiles more", len(damaged) - MAX_DAMAGE_WARNINGS)
        bar.add(sum(map(size_of, self.tiles)), done=sum(map(size_of, self.status.done)))
        if not self.unfinished:
            return
        if isinstance(folder.storage, Folder):
            path, missing = folder.storage.path, sum(map(size_of, self.unfinished))
            estimate.check_disk(execution.plan, path, missing, is_joined=path.suffix == RUN_SUFFIX)
        try:
            if execution.on_cluster:
                self._compute_on_cluster(bar)
            else:
                self._compute_in_threads(bar)
        finally:
            folder.remove_leftovers()
        if self.is_stopped:
            raise Stopped(f"stopped after {clock(execution.stop_after or 0)}; {folder.run.progress_text()}")

    def _compute_in_threads(self, bar: Progress) -> None:
        plan, threads = self.execution.plan, self.execution.threads
        source = self.folder, plan.points, self.execution.earlier
        by = f"{threads or blocks.available_threads()} threads"
        by += f", shard {self.part}/{self.parts}" if self.parts > 1 else ""
        stopwatch, last_end, lock = Stopwatch(), 0.0, Lock()

        def seconds() -> float:
            """Since the tile before this one ended, because tiles overlap."""
            nonlocal last_end
            with lock:
                before, last_end = last_end, stopwatch.seconds()
                return last_end - before

        def compute(tile: int, advance: Advance) -> None:
            bar.skip(_compute_tile(source, tile, threads, by, seconds, advance))

        in_flight = plan.tiles_in_flight(threads)
        for_each_tile(self.remaining_tiles(bar), compute, bar.advance, in_flight, self.stop)

    def _compute_on_cluster(self, bar: Progress) -> None:
        folder, client = self.folder, self.execution.client

        def on_result(tile: int) -> None:
            if not folder.tiles.is_written(tile):
                raise BadInput(
                    f"a worker wrote tile {tile}, but it is not in {folder.storage}: workers must see the same files"
                )
            bar.advance(folder.tiling.size_of(tile))

        run = str(folder.run.path), folder.number, folder.key
        reuse = tuple(str(each.path) for each in self.execution.earlier)
        arguments = ((*run, tile, reuse) for tile in self.remaining_tiles(bar))
        cluster.check_workers(client, check_worker, (*run, reuse))
        cluster.for_each(client, compute_tile, arguments, on_result)


def _compute_tile(
    source: Source, tile: int, threads: int | None, by: str, seconds: Callable[[], float], advance: Advance
) -> int:
    """Compute and write a tile; the number of its points that were not integrated."""
    folder, plan, earlier = source
    with folder.tiles.held(tile) as keep:

        def report(points: float) -> None:
            keep()
            advance(points)

        columns, computed, reused = evaluate_at(
            plan, folder.scene, folder.indices(tile), earlier, threads=threads, progress=report
        )
        folder.run.check_kept()
        folder.tiles.write(tile, columns, computed=computed, seconds=seconds(), by=by, reused=reused)
    return folder.tiling.size_of(tile) - computed + reused.total()


def check_worker(path: str, number: int | None, key: str, reuse: tuple[str, ...] = ()) -> None:
    """Raise BadInput unless this worker computes the same bits as the client of a run, which made the key."""
    _open_cached(path, number, key, reuse)


def compute_tile(path: str, number: int | None, key: str, tile: int, reuse: tuple[str, ...] = ()) -> int:
    """Compute and write one tile with one thread, the task of a dask worker; BadInput as `check_worker`."""
    source = _open_cached(path, number, key, reuse)
    _compute_tile(source, tile, 1, "dask workers", Stopwatch().seconds, lambda points: None)
    return tile


@lru_cache(maxsize=8)
def _open_cached(path: str, number: int | None, key: str, reuse: tuple[str, ...]) -> Source:
    """The source of the tiles of a run or level whose bits this process computes."""
    run = RunFolder.open(path)
    folder = run if number is None else Level.open(run, number)
    if folder.key != key:
        raise BadInput(f"{path}: holds another run on the machine of this worker ({socket.gethostname()})")
    plan = Plan.of(folder.scene)
    own = identity(plan)
    if different := differences(folder.manifest["identity"], own, "in the run", "in the worker"):
        raise BadInput(
            f"{path}: a dask worker on {socket.gethostname()} would compute other bits; start it again with the"
            f" same programs. It differs in {different}"
        )
    folder.tiles = folder.tiles_with(folder.key_with(own))  # with the key of what this process computes
    return folder, plan, [Earlier.of(each, folder.scene) for each in reuse]
