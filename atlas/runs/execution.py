"""The function `atlas.run`, which checks its options and computes a scene in memory or in a folder."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from .. import systems
from ..errors import BadInput, shown
from ..files import either
from ..scene.checks import MAX_THREADS, typed, whole_number
from ..scene.model import Scene
from ..scene.read import load_scene
from .memory import MANY_POINTS, Execution, run_in_memory


@typed
def run(
    scene: Scene | str | Path | Mapping[str, Any],
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
    """Integrate and label every point of a scene, and write the atlas if `out` is given.

    After an error or KeyboardInterrupt, finished tiles stay in the run folder, and the same call continues the run.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        A scene from `load_scene`, or an argument of `load_scene`.
    out : str or Path, optional
        NAME.nc stands for a file and NAME.zarr for a Zarr store, also at an address such as s3://BUCKET/NAME.zarr. Extensions may
        add suffixes. The atlas is computed in the run folder NAME.nc.run or NAME.zarr.run, which is then joined and removed. A
        text that ends in /, such as s3://BUCKET/NAME/, or a Path without suffix names a run folder that is kept. An existing run
        folder is continued.
    threads : int, optional
        Number of threads, by default the number of processors of this process. Results do not depend on the number.
    progress : bool
        Print progress to stderr.
    force : bool
        Replace an existing file or store, or the run of another scene in the folder. A run that a process is computing is not
        replaced, and an unfinished run of this scene is continued.
    shard : (int, int), optional
        (i, n) computes only the i-th of n parts, counted from 1. `out` must be a run folder. In each level of a refined scene a
        shard first computes its own part, then tiles that the other shards have left.
    scheduler : str, optional
        Address of a dask scheduler, whose workers compute the tiles.
    workers : int, optional
        Number of processes on this machine that compute the tiles.
    stop_after : float, optional
        Seconds after which no new tile begins; tiles that have begun are finished. Needs `out`.
    reuse : str, Path or sequence of str or Path, optional
        Earlier atlases or unfinished run folders, computed by the same programs on the same kind of processor. Points that they
        share with the scene are not computed again. The result is the same to the bit as without `reuse`. The attribute
        `atlas_history` states how many points come from which atlas.

    Returns
    -------
    xarray.Dataset
        The dimensions are the axes of the scene, the variables are the [outputs] of the scene, and every parameter is a
        coordinate. The attributes state the provenance. With `out`, the atlas is opened lazily.

    Raises
    ------
    BadInput
        If no point can be computed, if `out` cannot be written or contains something else, or if an atlas in `reuse` shares no
        point with the scene. BadInput is raised before the first point is computed.
    interruption.Stopped
        If the run takes longer than `stop_after`. The same call continues the run.
    """
    scene = load_scene(scene)
    began, on_cluster = time.monotonic(), bool(scheduler or workers)
    if out is None and (shard or on_cluster or stop_after is not None):
        from ..store.finished import suffixes

        ends = either(["/", *reversed(suffixes())])
        raise BadInput(f"shard, scheduler, workers and stop_after need an out that ends in {ends}")
    if on_cluster and threads:
        raise BadInput("threads are for a run without scheduler and workers, which run one thread each")
    if scheduler and workers:
        raise BadInput("scheduler and workers are both given; a run has one of them")
    for name, value in (("threads", threads), ("workers", workers)):
        if value is not None:
            whole_number(name, value, 1, MAX_THREADS)
    if shard is not None:
        if len(shard) != 2:
            raise BadInput(f"shard = {shown(shard)}: must be (i, n)")
        whole_number("shard: i", shard[0], 1, whole_number("shard: n", shard[1], 1))
    if stop_after is not None and not stop_after > 0:
        raise BadInput(f"stop_after = {shown(stop_after)}: must be a number of seconds above 0")
    origin = systems.origin(scene.system)
    if on_cluster and origin is not None and not origin.package:
        raise BadInput(
            f"the system {scene.system.name} is registered in this process alone, where dask workers cannot find it; run it in"
            " threads, or install it as a package with an entry point in the group atlas.systems"
        )
    options = dict(threads=threads, shard=shard, scheduler=scheduler, workers=workers, stop_after=stop_after)
    options |= {"progress": progress, "began": began}
    if out is None:
        if scene.size > MANY_POINTS:
            from .estimate import check_memory

            check_memory(scene)
        return run_in_memory(Execution.of(scene, reuse, options))
    from .folder import run_kept  # a run in memory does not need this module

    return run_kept(scene, out, reuse, options, force=force)
