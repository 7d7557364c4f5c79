"""The state of a run or finished atlas as text."""

from __future__ import annotations

import math
from pathlib import Path

from ..errors import MAX_MESSAGE, MAX_TEXT, printable
from ..files import check_name, remove_leftovers
from ..store import finished, progress
from ..store.place import located, place_at
from .backend import open_atlas
from .folder import folder_of
from .run import RunFolder


def status(path: str | Path, *, verify: bool = False) -> str:
    """Return the state of a run or finished atlas as text. `verify` reads all values. Raise BadInput if an atlas was changed."""
    place = located(path)
    if isinstance(place, Path):
        check_name(place)
    if not finished.is_finished(place):
        run = folder_of(place)  # the run folder, if the file or store does not exist yet
        return _status_of(RunFolder.open(run if place_at(run).names() else path), verify)
    with open_atlas(path) as ds:
        size = " x ".join(f"{name} {length}" for name, length in ds.sizes.items())
        lines = [f"{printable(str(ds.attrs.get('title', '')), MAX_TEXT)}: finished atlas, {size}"]
    if verify:
        finished.format_of(place).verify(place)
        lines.append("all of it is as it was written")
    return "\n".join(printable(line, MAX_MESSAGE) for line in lines)


def _status_of(run: RunFolder, verify: bool) -> str:
    """Return the state of the processes and tiles of a run as text, and remove the files of killed processes."""
    run.remove_leftovers()
    if isinstance(run.path, Path):
        remove_leftovers(run.path.parent)
    scene, is_refined, points_left = run.scene, run.scene.refine is not None, 0
    size = f"{scene.size} points in {run.tiling.count} tiles of at most {math.prod(run.tiling.tile)}"
    size = f"refined, {scene.size} points on the finest grid" if is_refined else size
    lines, sets = [f"{printable(scene.title, MAX_TEXT)}: {size}"], run.tile_sets()
    if is_refined and (run.tiles.written() or run.notes()[1]):
        sets["finest grid: "] = run.tiles
    for name, tiles in sets.items():
        missing = tiles.missing()
        damaged = tiles.check({*range(tiles.tiling.count)} - {*missing})[1] if verify else {}
        done = tiles.tiling.count - len(missing) - len(damaged)
        verified = f"damaged {len(damaged)}, " if verify else ""
        lines.append(f"{name or 'tiles: '}done {done}, {verified}missing {len(missing)}")
        lines += [f"{name}tile {tile} will be computed again: {why}" for tile, why in damaged.items()]
        points_left += sum(map(tiles.tiling.size_of, [*missing, *damaged]))
    total_speed, is_running = 0.0, False
    for _, content, state in run.processes():
        if state == progress.ENDED and (not points_left or content["done"] >= content["points"]):
            continue
        lines.append(
            f"shard {content['shard']} on {content['host']}: {content['done']} of {content['points']}"
            f" points, {content['points_per_second']:.4g} points/s, {state}; written {content['written']}"
        )
        if state == progress.AT_WORK:
            is_running, total_speed = True, total_speed + content["points_per_second"]
    if points_left and total_speed > 0:
        left = progress.clock(points_left / total_speed)
        lines.append(f"{points_left} points left, {left} at the speed of the processes at work")
    elif not is_running and (points_left or not run.is_complete):
        left = "left of the levels that have begun, and more levels may follow" if is_refined else "left"
        lines.append(
            f"{points_left} points {left}, no process is at work; `atlas run` with its scene continues"
        )
    return "\n".join(printable(line, MAX_MESSAGE) for line in lines)
