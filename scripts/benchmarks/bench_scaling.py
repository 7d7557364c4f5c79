"""Time and memory of runs against the numbers of points, tiles and workers; overhead of a tile, speed of join, 10^9 points.

python scripts/benchmarks/bench_scaling.py [MAX_POINTS] [--only points tiles workers billion]      (default 3e7, all)

Points take only a few hundred steps of rk4, so that costs other than integration are visible.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

import atlas
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.scene import grid
from atlas.scene.model import Scene

SCENE = """
schema = 1
title = "scaling"
system = "satellite"
[axes.C]
from = 0.4
to = 1.8
count = {rows}
[axes.theta0]
from = 0.1
to = 1.5
count = {columns}
[axes.m]
from = 0.1
to = 1.0
count = {layers}
[integration]
duration = {duration}
tolerance = 1e-3
[outputs]
variables = ["label", "status", "theta_dot_rms"]
"""


def scene(folder: Path, count: int, layers: int = 1, duration: float = 10.0) -> Scene:
    """The scene with about `count` points in each layer, saved in the folder."""
    columns = min(count // 10, 1000)
    text = SCENE.format(rows=count // columns, columns=columns, layers=layers, duration=duration)
    (folder / "scene.toml").write_text(text)
    return atlas.load_scene(folder / "scene.toml")


def command(folder: Path, *arguments: str) -> tuple[float, float]:
    """Wall time in s and largest memory in MB of one atlas command."""
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", *arguments], cwd=folder, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"atlas {' '.join(arguments)}: exit {process.returncode}")
    return time.perf_counter() - began, usage.ru_maxrss / 1024


def points(folder: Path, max_points: int) -> None:
    """Time and memory of a run and of its join, from 10^4 points (or max_points, if fewer) to max_points."""
    print("points, tiles, run s, points/s, MB of memory, join s, MB/s joined, MB of memory")
    count = min(10_000, max_points)
    while count <= max_points:
        case = scene(folder, count)
        name = f"points{count}"
        run = RunFolder.prepare(ScenePlan.of(case), folder / name)
        seconds, memory = command(folder, "run", "scene.toml", "-o", f"{name}/", "--quiet")
        joined, join_memory = command(folder, "join", name, "-o", f"{name}.nc")
        size = (folder / f"{name}.nc").stat().st_size / 1e6
        print(
            f"{count}, {run.tiling.count}, {seconds:.2f}, {count / seconds:.4g}, {memory:.0f},"
            f" {joined:.2f}, {size / joined:.3g}, {join_memory:.0f}",
            flush=True,
        )
        run.remove()
        (folder / f"{name}.nc").unlink()
        count *= 10 if count * 10 <= max_points else max(2, max_points // count)


def tiles(folder: Path, max_points: int) -> None:
    """Overhead of a tile: the same points in more and more tiles."""
    count = min(1_000_000, max_points)
    print(f"tiles for {count} points, run s, ms for each tile beyond the fewest")
    case, fewest = scene(folder, count), None
    for points in (grid.MAX_POINTS_PER_TILE, 8192, 1024):
        with patch.dict(os.environ, ATLAS_TILE_POINTS=str(points)):
            run = RunFolder.prepare(ScenePlan.of(case), folder / f"tiles{points}")
        seconds, _ = command(folder, "run", "scene.toml", "-o", f"tiles{points}/", "--quiet")
        fewest = fewest or (run.tiling.count, seconds)
        more = run.tiling.count - fewest[0]
        print(
            f"{run.tiling.count}, {seconds:.2f}, {1e3 * (seconds - fewest[1]) / more if more else 0.0:.2f}",
            flush=True,
        )
        run.remove()


def workers(folder: Path, max_points: int) -> None:
    """Time of the same run with threads and with dask workers."""
    count = min(2_000_000, max_points)
    print(f"workers for {count} points, run s")
    scene(folder, count)
    for options in (["--threads", "1"], ["--threads", "2"], ["--workers", "1"], ["--workers", "2"]):
        seconds, _ = command(folder, "run", "scene.toml", "-o", "workers/", "--quiet", *options)
        print(f"{' '.join(options)}, {seconds:.2f}", flush=True)
        RunFolder.open(folder / "workers").remove()


def billion(folder: Path, max_points: int, seconds: float = 30.0) -> None:
    """Start a run of 10^9 points, interrupt it, open it, and extrapolate its time and size."""
    case = scene(folder, 1_000_000, 1000)
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "billion/"],
        cwd=folder,
        stderr=subprocess.DEVNULL,
    )
    began, first = time.perf_counter(), 0.0
    while time.perf_counter() - began < seconds:
        if not first and list((folder / "billion" / "tiles").glob("*.tile")):
            first = time.perf_counter() - began
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 130
    run = RunFolder.open(folder / "billion")
    began = time.perf_counter()
    ds = atlas.open_atlas(folder / "billion")
    opened = time.perf_counter() - began
    done = run.tiles.written()
    size = sum(file.stat().st_size for file in (run.path / "tiles").iterdir()) / max(len(done), 1)
    rate = ds.attrs["atlas_points_per_second"]
    print(
        f"10^9 points: {run.tiling.count} tiles, the first after {first:.1f} s; {len(done)} in {seconds:.0f} s,"
        f" {usage.ru_maxrss / 1024:.0f} MB of memory; opens in {opened:.2f} s"
    )
    for total in (case.size, 10 * case.size):
        print(
            f"  all {total:.0e}: {total / rate / 3600:.1f} h here, {run.tiling.count * total // case.size} tiles,"
            f" {run.tiling.count * total / case.size * size / 1e9:.1f} GB at {ScenePlan.of(case).mean_steps:.0f} steps"
            " a point and three variables"
        )
    run.remove()


PARTS = {"points": points, "tiles": tiles, "workers": workers, "billion": billion}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("max_points", nargs="?", type=lambda text: int(float(text)), default=30_000_000)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="atlas-scaling-") as name:
        for part in options.only:
            PARTS[part](Path(name), options.max_points)


if __name__ == "__main__":
    main()
