"""Tiles computed by threads of this process, several at a time."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress

from ..engine import blocks
from .plan import ScenePlan

Advance = Callable[[float], None]  # takes a number of finished points


def tiles_in_flight(plan: ScenePlan, threads: int | None) -> int:
    """Number of tiles to compute at a time.

    Usually two, so that the processors stay busy while one tile is prepared or written; more where a tile is
    too small to give every thread a call of the kernel; one on a single processor.
    """
    threads = threads or blocks.available_threads()
    if threads == 1:
        return 1
    calls_per_tile = math.prod(plan.tiling.tile) * plan.mean_steps / blocks.CHUNK
    return min(1 + math.ceil(threads / max(calls_per_tile, 1.0)), threads + 1, plan.tiling.count)


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
