"""TODO"""

from __future__ import annotations

import math

from ..engine import blocks
from ..scene import grid
from ..scene.model import Scene
from .tiling import Tiling, mean_steps


def tiles_in_flight(scene: Scene, sample: grid.Grid, cut: Tiling, threads: int | None) -> int:
    """Tiles in flight: two, or as many as it takes to give every thread a call of the kernel."""
    threads = threads or blocks.available_threads()
    if threads == 1:  # one processor is one processor: no tile is prepared beside another
        return 1
    calls = math.prod(cut.tile) * mean_steps(scene, sample) / blocks.CHUNK
    return min(1 + math.ceil(threads / max(calls, 1.0)), threads + 1, cut.count)
