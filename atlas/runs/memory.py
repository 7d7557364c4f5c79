"""The computation of a scene in memory and in threads, with refinement and with reuse of points of earlier atlases."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .. import interruption
from ..kernel import blocks
from ..kernel.blocks import ALL_THREADS, Threads
from ..kernel.compiling import Stopwatch, announced, say
from ..label import half_step
from ..label.pipeline import evaluate
from ..label.plan import Plan
from ..scene import grid
from ..scene.model import Scene
from ..store import dataset
from ..store.progress import Progress, clock
from ..store.tiling import Tiling, tile_types
from ..systems.base import derived_values
from ..variables import variables
from .plan import LONG, ScenePlan

if TYPE_CHECKING:
    from .levels import Part
    from .reuse import Earlier

MANY_POINTS = 10**6  # An atlas of this many points may not fit into memory.
# Seconds for a point and for a step on a slow processor. If a run would take more than LONG seconds there, a tile is timed.
SLOW_POINT, SLOW_STEP = 1e-4, 1e-7

Advance = Callable[[float], None]  # takes the number of points finished since the last call


@dataclass(frozen=True, eq=False)
class Execution:
    """A plan, the earlier atlases to reuse, and the options of `execution.run`."""

    plan: ScenePlan
    earlier: list[Earlier]
    threads: int | None = None
    shard: tuple[int, int] = (1, 1)
    scheduler: str | None = None
    workers: int | None = None
    stop_after: float | None = None
    progress: bool = True
    began: float = field(default_factory=time.monotonic)
    stack: ExitStack = field(default_factory=ExitStack)  # ends the dask workers when it is closed

    @classmethod
    def of(
        cls, scene: Scene, reuse: str | Path | Sequence[str | Path], options: Mapping[str, Any]
    ) -> Execution:
        """Return the execution of a scene. `reuse` has the paths of earlier atlases, and `options` has the options of `execution.run`."""
        from ..kernel.machine_code import check_compiler  # reading a run needs no compiler

        check_compiler()
        plan, paths = ScenePlan.of(scene), [reuse] if isinstance(reuse, str | Path) else reuse
        earlier = []
        if paths:
            from .reuse import Earlier

            earlier = [Earlier.of(each, scene) for each in paths]
        shard = options["shard"] or (1, 1)
        processors = options["workers"] or options["threads"] or blocks.available_threads()
        if scene.size * (SLOW_POINT + SLOW_STEP * plan.mean_work) > LONG * processors * shard[1]:
            from . import estimate

            unit = "processor" if options["scheduler"] else "processes" if options["workers"] else "threads"
            text = estimate.long_run(plan, 1 if options["scheduler"] else processors, 1 / shard[1], unit)
            dataset.log_warnings([text] if text else [])
        dataset.log_warnings(plan.warnings)
        return cls(plan, earlier, **{**options, "shard": shard})

    def name_cheaper_method(self) -> None:
        """If another method is cheaper than the scene's method, print the costs of all other methods above the progress."""
        costs = {} if self.plan.has_chaos or not self.progress else self.plan.relative_costs
        if min(costs.values(), default=1) < 1:
            with announced(True):
                say("\n".join(self.plan.method_lines()))

    @property
    def time_is_up(self) -> bool:
        """Whether `stop_after` has passed or a signal has asked the run to stop, so that no further tile begins."""
        is_late = self.stop_after is not None and time.monotonic() - self.began >= self.stop_after
        return is_late or bool(interruption.stopped_by)

    def check_time(self, state: str) -> None:
        """Raise Stopped if the time is up. The message ends with `state`, the state of the run as text."""
        if self.time_is_up:
            why = interruption.stopped_by or f"after {clock(self.stop_after or 0)}"
            raise interruption.Stopped(f"stopped {why}; {state}")

    @cached_property
    def client(self) -> Any:
        """The client of the dask workers. The first access starts the workers."""
        if self.workers:
            # One step at one point compiles the kernel here. Otherwise each new process would compile the kernel.
            sample = self.plan.sample
            points = replace(self.plan.runs.without_derived(), settings=self.plan.limited(1))
            if points.outputs:
                evaluate(points, sample.subset(np.flatnonzero(sample.exists)[:1]), threads=Threads(1))
        from . import cluster

        return self.stack.enter_context(cluster.connect(self.scheduler, self.workers))


def run_in_memory(execution: Execution) -> xr.Dataset:
    """Compute an atlas in memory, without a run folder."""
    plan, threads, progress = execution.plan, Threads(execution.threads), execution.progress
    scene, stopwatch, reused = plan.scene, Stopwatch(), Counter[str]()
    execution.name_cheaper_method()
    if scene.refine is None:
        with closing(Progress(scene.size, show=progress)) as bar:
            columns, reused = columns_of(plan, bar, execution.threads, execution.earlier)
        ds, points = dataset.dataset(scene, columns), scene.size
        attributes = half_step.half_step_sample(scene, plan.runs, threads=threads)
    else:
        from . import refine

        no_bar = Progress(scene.size, show=False)

        def integrate(indices: np.ndarray) -> Iterator[Part]:
            columns, counts = columns_of(plan, no_bar, execution.threads, execution.earlier, indices)
            reused.update(counts)
            yield indices, columns

        with announced(progress):
            fine, attributes = refine.refined(integrate, plan, None, threads, progress=progress)
        ds, points = dataset.dataset(scene, fine.values(())), fine.n_integrated
    provenance = dataset.provenance(
        scene.system, scene.settings, plan.runs.kernel_hash, scene=scene, warnings=plan.warnings,
        timing=(points, stopwatch.seconds()),
    )  # fmt: skip
    return ds.assign_attrs(provenance | attributes | dataset.history_text(reused))


def columns_of(
    plan: ScenePlan,
    bar: Progress,
    threads: int | None = None,
    earlier: Sequence[Earlier] = (),
    points: np.ndarray | None = None,
) -> tuple[dict[str, np.ndarray], Counter[str]]:
    """Return variables and solved parameters at flat indices `points` (None: all), and the number of points reused from each atlas."""
    scene, all_reused = plan.scene, Counter[str]()
    tiles = plan.tiling if points is None else Tiling.of(points.shape, grid.max_points_per_tile())
    # Refinement needs the label, even if the label is not in the outputs of the scene.
    types = ({} if points is None else {"label": "int8"}) | tile_types(scene)
    columns = {name: np.empty(math.prod(tiles.shape), kind) for name, kind in types.items()}

    def compute(tile: int, advance: Advance) -> None:
        part = tiles.indices(tile)
        indices = part if points is None else points[part]
        values, computed, reused = evaluate_at(plan.runs, scene, indices, earlier, Threads(threads, advance))
        for name, column in columns.items():
            column[part] = values[name]
        all_reused.update(reused)
        bar.skip(indices.size - computed + reused.total())

    for_each_tile(range(tiles.count), compute, bar.advance, plan.tiles_in_flight(threads), Event())
    return columns, all_reused


def evaluate_at(
    plan: Plan,
    scene: Scene,
    indices: np.ndarray,
    earlier: Sequence[Earlier] = (),
    threads: Threads = ALL_THREADS,
) -> tuple[dict[str, np.ndarray], int, Counter[str]]:
    """Return variables and parameters at flat indices, the number of points with a motion, and the number reused from each atlas."""
    points = grid.points_at_indices(scene, indices)
    reused, parts = Counter[str](), list[tuple[np.ndarray, Mapping[str, np.ndarray]]]()
    remaining = np.arange(indices.size)
    for atlas in earlier:
        mask, columns = atlas.take(scene, indices[remaining], points.subset(remaining))
        where, remaining = remaining[mask], remaining[~mask]
        if where.size:
            part = points.subset(where)
            missing = [name for name in scene.outputs if name not in columns]
            columns |= derived_values(scene.system, missing, part.base, part.duration, lambda: None)
            parts.append((where, columns))
            reused[atlas.history] += where.size
    if remaining.size:
        part = points.subset(remaining) if parts else points
        parts.append((remaining, evaluate(plan, part, threads=threads)))
    merged = dict(parts[0][1])
    if len(parts) > 1:
        registry = variables(scene.system)
        merged = {name: np.empty(indices.size, registry[name].dtype) for name in scene.outputs}
        for name, (where, some) in product(merged, parts):
            merged[name][where] = some[name]
    return merged | points.base, int(points.exists.sum()), reused


def for_each_tile(
    tiles: Iterable[int],
    compute: Callable[[int, Advance], None],
    advance: Advance,
    in_flight: int,
    stop: Event,
) -> None:
    """Call compute(tile, advance) for each tile in threads. An error or Ctrl-C sets `stop` and abandons the remaining tiles."""
    source, lock = iter(tiles), Lock()

    def advance_or_stop(points: float) -> None:
        if stop.is_set():
            raise CancelledError
        advance(points)

    def worker() -> None:
        with suppress(CancelledError):
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
