"""Runs: a scene, or points of one's own, become a labelled dataset."""

from __future__ import annotations

import logging
import math
import random
import resource
import socket
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from . import accuracy, cluster, grid, refine, store, systems
from . import points as own_points
from .engine import lanes
from .evaluate import Special, evaluate, evaluate_tile, kernel_hash, scene_kernel_hash
from .folder import RunFolder, Tiling, mean_steps, step_plan, tile_types, tiling
from .progress import Progress, clock
from .scene import Scene, Settings, check_range
from .systems.system import BadInput, System
from .variables import variables

# Points read at a time where a whole atlas is gone through.
SLAB = 4_000_000
# A dry run times so many points over so many steps for each thread, a fraction of a second.
CALIBRATION_POINTS, CALIBRATION_STEPS = 4096, 5e7


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
    _log(remarks)
    if scene.refine is not None:
        ds = refine.refined(scene, remarks, threads=threads, progress=progress)
        if path is not None:
            store.write(ds, path)
            ds = store.open_atlas(path)
        return ds
    if path is None:
        return _in_memory(scene, checked, remarks, threads, progress)
    there = path.with_name(path.name + ".run") if one_file else path
    if one_file and force:
        RunFolder.forget(scene, there)
    folder = RunFolder.prepare(scene, there, checked, remarks)
    _compute(folder, checked, threads, progress, shard or (1, 1), scheduler, workers)
    if not folder.notes() and all(folder.present(tile) for tile in range(folder.tiling.count)):
        folder.note(accuracy.half_step_sample(scene, threads=threads))
    if not one_file:
        return folder.dataset()
    folder.join(path)
    folder.remove()
    return store.open_atlas(path)


def dry_run(scene: Scene, *, threads: int | None = None, workers: int | None = None) -> str:
    """What running a scene will take, as text; some of its points are run for a short while to tell.

    threads, workers: as for `run`. Raises BadInput as `run` does.
    """
    checked = grid.check(scene)
    cut, plan = tiling(scene, checked), step_plan(scene, checked)
    threads = workers or threads or lanes.available_threads()
    there = np.flatnonzero(checked.there)
    points = scene.size * there.size / checked.there.size
    mean, point_bytes = (
        mean_steps(scene, checked),
        sum(np.dtype(t).itemsize for t in tile_types(scene).values()),
    )
    some = there[np.linspace(0, there.size - 1, min(there.size, CALIBRATION_POINTS)).astype(np.int64)]
    short = min(1.0, CALIBRATION_STEPS * threads / (some.size * mean))
    part = grid.Grid(
        {name: values[some] for name, values in checked.base.items()},
        {name: values[some] for name, values in checked.points.items()},
        checked.there[some],
        checked.duration[some] * short,
    )
    began = time.perf_counter()
    evaluate_tile(scene, part, threads=threads)
    first = time.perf_counter() - began
    began = time.perf_counter()
    evaluate_tile(scene, part, threads=threads)
    second = time.perf_counter() - began
    tracemalloc.start()
    evaluate_tile(scene, part, threads=threads)
    peak = tracemalloc.get_traced_memory()[1] / some.size
    tracemalloc.stop()
    per_step = second / step_plan(scene, part).count.sum()
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    if workers:
        memory, who = workers * (resident + peak * math.prod(cut.tile)), f"{workers} processes"
    else:
        tiles = _at_once(scene, checked, cut, threads)
        memory, who = resident + tiles * peak * math.prod(cut.tile), f"{threads} threads"
    free = replace(scene, settings=replace(scene.settings, max_steps=2**50))
    capped = (plan.count < step_plan(free, checked).count)[there].mean()
    lines = [
        f"{scene.size} points, about {points:.0f} to integrate, {cut.count} tiles of at most {math.prod(cut.tile)}",
        f"file: at most {scene.size * point_bytes / 1e6:.4g} MB before compression",
        f"time: about {clock(points * mean * per_step)} on {who} ({mean:.4g} steps a point,"
        f" {1e9 * per_step * threads:.3g} ns a step and processor)",
        f"first call of the kernel: {max(first - second, 0.0):.1f} s (compiling, if it was not in the cache)",
        f"memory: about {memory / 1e6:.0f} MB",
        f"expected phase error of the fastest frequency: at most {plan.phase_error[there].max():.2g} rad",
    ]
    if capped > 0:
        lines.append(f"max_steps = {scene.settings.max_steps} cuts short {100 * capped:.3g} % of the points")
    return "\n".join(lines)


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
    return store.writable(path, force=force), True


def _log(remarks: list[str]) -> None:
    for remark in remarks:
        logging.getLogger("atlas").warning(remark)


def _tile(
    scene: Scene, indices: np.ndarray, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[dict[str, np.ndarray], int]:
    """One tile in every mode of running: its columns by name, and at how many points the family exists."""
    tile = grid.take(scene, indices)
    values = evaluate_tile(scene, tile, threads=threads, progress=progress)
    columns = {name: values[name] for name in scene.outputs} | {name: tile.base[name] for name in scene.solve}
    return columns, int(tile.there.sum())


class _Stopped(Exception):
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
            raise _Stopped
        bar.advance(points)

    def worker() -> None:
        with suppress(_Stopped):
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


def _at_once(scene: Scene, sample: grid.Grid, cut: Tiling, threads: int | None) -> int:
    """Tiles in flight: two, or as many as it takes to give every thread a call of the kernel."""
    threads = threads or lanes.available_threads()
    if threads == 1:  # one processor is one processor: no tile is prepared beside another
        return 1
    calls = math.prod(cut.tile) * mean_steps(scene, sample) / lanes.CHUNK
    return min(1 + math.ceil(threads / max(calls, 1.0)), threads + 1, cut.count)


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
        _in_threads(range(cut.count), work, bar, _at_once(scene, sample, cut, threads))
    finally:
        bar.close()
    seconds = time.perf_counter() - bar.began
    ds = store.dataset(
        scene,
        {name: column.reshape(scene.shape) for name, column in columns.items()},
        {name: column.reshape(scene.shape) for name, column in solved.items()},
    )
    return ds.assign_attrs(
        store.provenance(
            scene.system, scene.settings, scene_kernel_hash(scene),
            title=scene.title, scene=scene.toml(), seconds=seconds, points=scene.size, remarks=remarks,
        ) | accuracy.half_step_sample(scene, threads=threads)
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
            by = f"{threads or lanes.available_threads()} threads" + (
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

            at_once = _at_once(folder.scene, sample, folder.tiling, threads)
            _in_threads(open_tiles(), work, bar, at_once)
    finally:
        bar.close()


def compute_tile(path: str, key: str, tile: int) -> int:
    """Compute and write one tile of a run folder with one thread; what a dask worker is asked to do.

    Raises BadInput if the folder holds another run or this machine would give other bits.
    """
    folder = _here(path, key)
    began = time.perf_counter()
    columns, computed = _tile(folder.scene, folder.tiling.indices(tile), 1, None)
    seconds = time.perf_counter() - began
    folder.write(tile, columns, {"computed": computed, "seconds": seconds, "by": "dask workers"})
    return tile


@lru_cache(maxsize=8)
def _here(path: str, key: str) -> RunFolder:
    folder = RunFolder.open(path)
    if folder.key != key:
        raise BadInput(f"{path}: holds another run on the machine of this worker")
    folder.check_same(folder.scene)
    return folder


def label_points(
    system: str,
    points: Any,
    *,
    duration: Any = 60.0,
    step: float | None = None,
    tolerance: float = 1e-8,
    method: str = "rk4",
    rate_tolerance: float = 1e-5,
    threads: int | None = None,
    progress: bool = False,
    **more: Any,
) -> xr.Dataset:
    """Label points of one's own: a Dataset with the dimension "point" and every variable of the registry.

    system: "satellite" or "fixed_point". points: parameter -> number or 1-D array (all arrays of one
    length), or any other table that `points.table` reads, such as a DataFrame or the name of a CSV file;
    in the units of the registry; parameters left out take their defaults. duration: time
    units, a number or one per point. more: cylinder_tolerance, drift_tolerance, max_steps, check_half_step.

    Moments of inertia that no body can have are an error in a scene; here, where published numbers are
    looked up, the equations are solved all the same, and a logged warning and the attribute
    atlas_warnings say so. Raises BadInput for unknown names, wrong shapes and numbers out of range.
    """
    kind = systems.get(system)
    allowed = {"cylinder_tolerance", "drift_tolerance", "max_steps", "check_half_step"}
    for key in set(more) - allowed:
        raise BadInput(f"{key}: unknown option of label_points; allowed: {', '.join(sorted(allowed))}")
    settings = Settings(
        method=method, tolerance=tolerance, step=step, rate_tolerance=rate_tolerance, **more
    )  # fmt: skip
    full, size = point_columns(kind, points)
    lengths = _column("duration", duration)
    if lengths.ndim and lengths.shape != (size,):
        raise BadInput(
            f"duration has shape {lengths.shape}; allowed: a number, or one for each of {size} points"
        )
    times = np.broadcast_to(lengths, (size,)).astype(np.float64)
    if not (np.isfinite(times) & (times > 0)).all():
        raise BadInput(
            f"duration = {times[~(np.isfinite(times) & (times > 0))][0]!r}: must be a finite number above 0"
        )
    remarks = kind.warnings(full)
    try:
        kind.check(full)
    except BadInput as complaint:
        remarks.append(str(complaint))
    _log(remarks)
    bar = Progress(size) if progress else None
    began = time.perf_counter()
    kinds = variables(kind)
    special = Special.of_points(kind, full)
    columns = {name: np.empty(size, v.dtype) for name, v in kinds.items() if name not in kind.layers}
    for first in range(0, size, grid.TILE):
        part = slice(first, first + grid.TILE)
        piece = {name: values[part] for name, values in full.items()}
        found = evaluate(
            kind, piece, piece, times[part], settings, special=special,
            threads=threads, progress=None if bar is None else bar.advance,
        )  # fmt: skip
        for name, column in columns.items():
            column[part] = found[name]
    if bar is not None:
        bar.close()
    ds = xr.Dataset({name: ("point", column, kinds[name].attributes()) for name, column in columns.items()})
    for name, values in full.items():
        if not (np.isnan(kind.parameters[name].default) and np.isnan(values).all()):
            ds = ds.assign_coords({name: ("point", values, store.parameter_attributes(kind, name, False))})
    ds.attrs |= store.provenance(
        kind, settings, kernel_hash(kind, method, special),
        title=f"points of the {system}", scene="", seconds=time.perf_counter() - began, points=size,
        remarks=remarks,
    )  # fmt: skip
    return ds


def _column(name: str, values: Any) -> np.ndarray:
    try:
        column = np.asarray(values.values if isinstance(values, xr.DataArray) else values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {values!r}: must be a number or a 1-D array of numbers") from None
    if column.ndim > 1:
        raise BadInput(f"{name} has shape {column.shape}: must be a number or a 1-D array of numbers")
    return column


def point_columns(system: System, points: Any) -> tuple[dict[str, np.ndarray], int]:
    """Every parameter of the system as a float64 column, checked, and their length; see label_points."""
    columns = {}
    for name, values in own_points.table(points, system.parameters).items():
        if name not in system.parameters:
            raise BadInput(
                f"{name}: not a parameter of the {system.name}; allowed: {', '.join(system.parameters)}"
            )
        columns[name] = _column(name, values)
    sizes = {c.size for c in columns.values() if c.ndim}
    if len(sizes) > 1:
        shown = ", ".join(f"{k}: {c.size}" for k, c in columns.items() if c.ndim)
        raise BadInput(f"points: columns of different lengths ({shown})")
    size = sizes.pop() if sizes else 1
    if size == 0:
        raise BadInput("points: there are none")
    full: dict[str, np.ndarray] = {}
    for name, parameter in system.parameters.items():
        column = columns.get(name, np.asarray(parameter.default))
        optional = np.isnan(parameter.default) & np.isnan(column)
        if not (np.isfinite(column) | optional).all():
            raise BadInput(f"{name}: must be finite numbers, found {column[~np.isfinite(column)].ravel()[0]}")
        if column.size and not np.all(optional):
            check_range(system, name, name, np.nanmin(column), np.nanmax(column))
        full[name] = np.broadcast_to(column, (size,)).astype(np.float64)
    return full, size


def summary(ds: xr.Dataset) -> str:
    """Counts of labels and status, agreement with theory, expected error, time and speed, as text."""
    flags = [name for name in ("label", "label_inertial", "status", "agreement", "computed") if name in ds]
    largest = {
        "error_estimate": "relative error of states and rates, by the estimate of each point: at most {:.2g}",
        "integral_drift": "drift of first integrals: at most {:.2g}",
    }
    # Quarters of a decade from 1e-20 on: enough to tell the median without keeping every point.
    quarters = {name: np.zeros(161, np.int64) for name in largest if name in ds}
    meanings = {name: ds[name].attrs["flag_meanings"].split() for name in flags}
    counts = {name: np.zeros(len(meanings[name]), np.int64) for name in flags}
    most = {name: math.nan for name in largest if name in ds}
    cut = Tiling.of(tuple(ds.sizes.values()), SLAB)
    for slab in range(cut.count):
        part = ds[[*flags, *most]].isel(dict(zip(ds.sizes, cut.place(slab), strict=True)))
        for name in flags:
            counts[name] += np.bincount(part[name].values.ravel(), minlength=len(meanings[name]))
        for name in most:
            values = part[name].values.ravel()
            most[name] = float(np.fmax(most[name], np.fmax.reduce(values)))
            with np.errstate(divide="ignore", invalid="ignore"):
                place = np.ceil(4 * (np.log10(values[~np.isnan(values)]) + 20))
            quarters[name] += np.bincount(np.clip(place, 0, 160).astype(np.int64), minlength=161)
    lines = []
    for name in flags:
        shown = ", ".join(f"{m} {n}" for m, n in zip(meanings[name], counts[name], strict=True) if n)
        lines.append(f"{name}: {shown}")
    for name, value in most.items():
        total = np.cumsum(quarters[name])
        half = 10.0 ** (np.searchsorted(total, (total[-1] + 1) // 2) / 4 - 20)
        text = largest[name].format(value)
        lines.append(f"{text}, {min(half, value):.0e} at half of them" if value > 10 * half else text)
    if "atlas_half_step_points" in ds.attrs:
        lines.append(accuracy.half_step_text(ds.attrs))
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    return "\n".join(lines)
