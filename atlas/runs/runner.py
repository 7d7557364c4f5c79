"""A run: the tiles of a scene, in memory or in a run folder."""

from __future__ import annotations

import logging
import math
import random
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from ..engine import blocks
from ..errors import BadInput
from ..io import netcdf, provenance
from ..io.progress import Progress
from ..io.provenance import log_warnings
from ..label.pipeline import evaluate_tile, scene_kernel_hash
from ..scene import grid
from ..scene.model import Scene
from ..validation import half_step
from ..variables import variables
from . import cluster, open, refine
from .concurrency import tiles_in_flight
from .folder import RunFolder
from .tiling import tiling


def run(
    scene: Scene,
    out: str | Path | None = None,
    *,
    threads: int | None = None,
    progress: bool = True,
    force: bool = False,
    shard: tuple[int, int] | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Integrate every point of a scene and return the labelled atlas; write it if `out` is given.

    scene: from load_scene. out: NAME.nc, one file (made in the run folder NAME.nc.run, which is joined
    and removed in the end; an existing file is kept unless force is true), or a run folder: a name that
    ends in / or has no suffix. Where the run folder is there already, it is continued. threads: default
    all processors of this process; results do not depend on it. progress: print to stderr. shard:
    (i, n), compute only the i-th of n parts, counted from 1; needs a run folder. scheduler, workers:
    the address of a dask scheduler, or a number of processes on this machine, compute the tiles.
    A scene with [refine] runs without these, into memory or one file; see `refine.refined`.

    Returns a Dataset with the scene's axes as dimensions, the variables the scene asks for, every
    parameter as a coordinate, and provenance in the attributes; opened lazily if `out` is given.

    Raises BadInput for what no body can be and for an `out` that cannot be written or holds something
    else, before anything is computed. On KeyboardInterrupt and errors finished tiles are kept.
    """
    if out is None and (shard or scheduler or workers):
        raise BadInput("shard, scheduler and workers need an out that ends in / or .nc")
    if (scheduler or workers) and threads:
        raise BadInput("threads are for a run without scheduler and workers, which run one thread each")
    if scheduler and workers:
        raise BadInput("scheduler and workers are both given; a run has one of them")
    if workers is not None and workers < 1:
        raise BadInput(f"workers = {workers}: must be at least 1")
    if shard is not None and not (1 <= shard[0] <= shard[1]):
        raise BadInput(
            f"shard {shard[0]}/{shard[1]}: allowed: 1/{max(shard[1], 1)} to {max(shard[1], 1)}/{max(shard[1], 1)}"
        )
    path, one_file = (None, False) if out is None else _destination(out, force)
    if shard and one_file:
        raise BadInput(f"shard: {path} is one file; shards need a run folder, a name that ends in /")
    if scene.refine is not None and (shard or scheduler or workers or (path is not None and not one_file)):
        raise BadInput("refine: a refined scene runs in one process, into memory or one file, NAME.nc")
    if scheduler:
        cluster.check(scheduler)
    checked = grid.check(scene)
    remarks = scene.system.warnings(checked.base)
    log_warnings(remarks)
    if scene.refine is not None:
        ds = refine.refined(scene, remarks, threads=threads, progress=progress)
        if path is not None:
            netcdf.write(ds, path)
            ds = open.open_atlas(path)
        return ds
    if path is None:
        return _in_memory(scene, checked, remarks, threads, progress)
    there = path.with_name(path.name + ".run") if one_file else path
    if one_file and force:
        RunFolder.forget(scene, there)
    folder = RunFolder.prepare(scene, there, checked, remarks)
    _compute(folder, checked, threads, progress, shard or (1, 1), scheduler, workers)
    if not folder.notes() and all(folder.present(tile) for tile in range(folder.tiling.count)):
        folder.note(half_step.half_step_sample(scene, threads=threads))
    if not one_file:
        return folder.dataset()
    folder.join(path)
    folder.remove()
    return open.open_atlas(path)


def _destination(out: str | Path, force: bool) -> tuple[Path, bool]:
    """Path of an atlas and whether it is one file. Raises BadInput if it cannot be written."""
    path = Path(out)
    if (
        str(out).endswith("/")
        or (not path.suffix and not path.is_file())
        or (path / "manifest.json").exists()
    ):
        if not path.absolute().parent.is_dir():
            raise BadInput(f"{path}: there is no folder {path.parent}")
        return path, False
    return netcdf.writable(path, force=force), True


def _tile(
    scene: Scene, indices: np.ndarray, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[dict[str, np.ndarray], int]:
    """One tile in every mode of running: its columns by name, and at how many points the family exists."""
    tile = grid.points_at_indices(scene, indices)
    values = evaluate_tile(scene, tile, threads=threads, progress=progress)
    columns = {name: values[name] for name in scene.outputs} | {name: tile.base[name] for name in scene.solve}
    return columns, int(tile.there.sum())


class _StoppedError(Exception):
    """Ends a tile in flight when another one failed or the user pressed Ctrl-C."""


def _in_threads(
    tiles: Iterable[int], work: Callable[[int, Callable[[float], None]], None], bar: Progress, at_once: int
) -> None:
    """Call work(tile, advance) for each tile, several at a time; on an error or Ctrl-C drop those in flight.

    Tiles overlap so that the processors stay busy while one is prepared or written.
    """
    source, lock, stop = iter(tiles), threading.Lock(), threading.Event()

    def advance(points: float) -> None:
        if stop.is_set():
            raise _StoppedError
        bar.advance(points)

    def worker() -> None:
        with suppress(_StoppedError):
            while not stop.is_set():
                with lock:
                    tile = next(source, None)
                if tile is None:
                    return
                work(tile, advance)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            for job in as_completed([pool.submit(worker) for _ in range(at_once)]):
                job.result()
        finally:
            stop.set()


def _in_memory(
    scene: Scene, sample: grid.Grid, remarks: list[str], threads: int | None, progress: bool
) -> xr.Dataset:
    kinds = variables(scene.system)
    columns = {name: np.zeros(scene.size, kinds[name].dtype) for name in scene.outputs}
    solved = {name: np.empty(scene.size) for name in scene.solve}
    cut = tiling(scene, sample)
    bar = Progress(scene.size, show=progress)

    def work(tile: int, advance: Callable[[float], None]) -> None:
        indices = cut.indices(tile)
        found, computed = _tile(scene, indices, threads, advance)
        for name, column in (columns | solved).items():
            column[indices] = found[name]
        bar.skip(indices.size - computed)

    try:
        _in_threads(range(cut.count), work, bar, tiles_in_flight(scene, sample, cut, threads))
    finally:
        bar.close()
    seconds = time.perf_counter() - bar.began
    ds = netcdf.dataset(
        scene,
        {name: column.reshape(scene.shape) for name, column in columns.items()},
        {name: column.reshape(scene.shape) for name, column in solved.items()},
    )
    return ds.assign_attrs(
        provenance.provenance(
            scene.system, scene.settings, scene_kernel_hash(scene),
            title=scene.title, scene=scene.toml(), seconds=seconds, points=scene.size, remarks=remarks,
        ) | half_step.half_step_sample(scene, threads=threads)
    )  # fmt: skip


def _compute(
    folder: RunFolder,
    sample: grid.Grid,
    threads: int | None,
    progress: bool,
    shard: tuple[int, int],
    scheduler: str | None,
    workers: int | None,
) -> None:
    """Compute the tiles of a run folder (or of a shard of it) that are not done."""
    part, parts = shard
    mine = range(part - 1, folder.tiling.count, parts)
    survey = folder.survey(mine)
    for tile, why in list(survey.damaged.items())[:5]:
        logging.getLogger("atlas").warning("%s: tile %d is computed again: %s", folder.path, tile, why)
    if len(survey.damaged) > 5:
        logging.getLogger("atlas").warning("... and %d damaged tiles more", len(survey.damaged) - 5)
    todo = sorted([*survey.missing, *survey.damaged])
    if not todo:
        return
    folder.check_writable()
    # Someone else may be at work on the same tiles: begin at different places, so as to share them.
    first = random.randrange(len(todo))
    todo = todo[first:] + todo[:first]

    size = {tile: math.prod(folder.tiling.extent(tile)) for tile in mine}
    name = "progress.json" if parts == 1 else f"progress-{part}-of-{parts}.json"
    bar = Progress(
        sum(size.values()),
        done=sum(size[tile] for tile in survey.done),
        show=progress,
        file=folder.path / name,
        facts={"shard": f"{part}/{parts}", "host": socket.gethostname()},
    )

    def finished(tile: int) -> None:
        for left in survey.unfinished.get(tile, ()):
            left.unlink(missing_ok=True)

    def open_tiles() -> Iterator[int]:
        for tile in todo:
            if tile not in survey.damaged and folder.present(tile) and folder.check(tile) is None:
                bar.skip(size[tile])  # another process was faster
            else:
                yield tile

    try:
        if scheduler or workers:

            def done(tile: int) -> None:
                if not folder.present(tile):
                    raise BadInput(
                        f"a worker wrote tile {tile}, but it is not in {folder.path}: workers must see the same files"
                    )
                bar.advance(size[tile])
                finished(tile)

            arguments = ((str(folder.path), folder.key, tile) for tile in open_tiles())
            with cluster.client(scheduler, workers) as client:
                cluster.each(client, compute_tile, arguments, done)
        else:
            last, lock = [time.perf_counter()], threading.Lock()
            by = f"{threads or blocks.available_threads()} threads" + (
                f", shard {part}/{parts}" if parts > 1 else ""
            )

            def work(tile: int, advance: Callable[[float], None]) -> None:
                columns, computed = _tile(folder.scene, folder.tiling.indices(tile), threads, advance)
                with lock:
                    now = time.perf_counter()
                    seconds, last[0] = now - last[0], now
                folder.write(tile, columns, {"computed": computed, "seconds": seconds, "by": by})
                finished(tile)
                bar.skip(size[tile] - computed)

            at_once = tiles_in_flight(folder.scene, sample, folder.tiling, threads)
            _in_threads(open_tiles(), work, bar, at_once)
    finally:
        bar.close()


def compute_tile(path: str, key: str, tile: int) -> int:
    """Compute and write one tile of a run folder with one thread; what a dask worker is asked to do.

    Raises BadInput if the folder holds another run or this machine would give other bits.
    """
    folder = _open_cached(path, key)
    began = time.perf_counter()
    columns, computed = _tile(folder.scene, folder.tiling.indices(tile), 1, None)
    seconds = time.perf_counter() - began
    folder.write(tile, columns, {"computed": computed, "seconds": seconds, "by": "dask workers"})
    return tile


@lru_cache(maxsize=8)
def _open_cached(path: str, key: str) -> RunFolder:
    folder = RunFolder.open(path)
    if folder.key != key:
        raise BadInput(f"{path}: holds another run on the machine of this worker")
    folder.check_same(folder.scene)
    return folder
