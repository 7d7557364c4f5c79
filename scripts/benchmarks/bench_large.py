"""Questions to a large store, and the join of many small tiles: time, processor time and memory.

python scripts/benchmarks/bench_large.py [GIGABYTES] [TILES]      (default 100 50000)

All chunks of a variable in the store are hard links to one file, so that the store takes 0.1 GB of disk space. The tiles are
copies with numbers of their own, and the join is compared with `cp -r`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
from bench_scaling import SCENE

import atlas
from atlas import systems
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder
from atlas.scene import grid
from atlas.store import finished
from atlas.store.dataset import dims
from atlas.store.tally import Totals
from atlas.store.tile import encode
from atlas.store.tiling import Tiling
from atlas.variables import variables

FLAGS = ("label", "status", "family", "stable", "predicted")
NUMBERS = 20
QUESTIONS = {
    "open": "len(ds)",
    "nearest": "ds.atlas.nearest(C=1.0, theta0=0.7).theta_dot_rms.item()",
    "fractions": "ds.atlas.fractions().values",
    "fractions along an axis": "ds.atlas.fractions(along='theta0').shape",
    "select, no point": "dict(ds.atlas.select(label=0).sizes)",
    "select of two variables, a point of each tile": "dict(ds[['label', 'theta_dot_rms']].atlas.select(label=2).sizes)",
    "map of labels": "ds.atlas.map(boundary=False).savefig('map.png')",
    "map of numbers": "ds.atlas.map('theta_dot_rms', boundary=False).savefig('map.png')",
}


def measure(folder: Path, name: str, *command: str) -> None:
    """Print wall-clock time, processor time in s and memory in MB of a command."""
    began = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds, processor = time.perf_counter() - began, usage.ru_utime + usage.ru_stime
    print(f"{name}: {seconds:.1f} s, {processor:.1f} s, {usage.ru_maxrss / 1024:.0f} MB", flush=True)


def prepare(path: Path, names: list[str], rows: int, columns: int) -> tuple[RunFolder, dict[str, np.ndarray]]:
    """An empty run of a grid, and the values of its first tile."""
    text = SCENE.format(rows=rows, columns=columns, layers=1, duration=1.0)
    listed = ", ".join(f'"{name}"' for name in names)
    scene = atlas.load_scene(text.replace('"label", "status", "theta_dot_rms"', listed))
    run = RunFolder.prepare(ScenePlan.of(scene), path)
    rng, size = np.random.default_rng(0), run.tiling.size_of(0)
    values = {
        name: rng.random(size) if np.dtype(dtype).kind == "f" else np.ones(size, dtype)
        for name, dtype in run.tiles.types.items()
    }
    values["label"][: size // 3] = 4
    values["label"][size // 2] = 2
    run.tiles.write(0, values, computed=size, seconds=1.0, by="a script")
    return run, values


def large_store(path: Path, gigabytes: float) -> None:
    """Write a store with this size of numbers."""
    registry = variables(systems.get("satellite"))
    numbers = [n for n, v in registry.items() if v.dtype == "float64" and "equilibrium" not in n][:NUMBERS]
    names = [*FLAGS, *numbers]
    rows = max(round(gigabytes * 1e9 / (8 * NUMBERS + len(FLAGS)) / 1024), 1)
    run, values = prepare(path.with_suffix(".run"), names, rows, 1024)
    lengths = Tiling.of(run.scene.shape, grid.max_points_per_tile())
    chunk = dict(zip(dims(run.scene), lengths.tile, strict=True))
    first = {name: value.reshape(lengths.shape_of(0)) for name, value in values.items()}
    blocks = iter([(lengths.slices(0), first)])
    content = finished.Content(run.template(), names, chunk, blocks, lambda: run.attributes(Totals()))
    finished.format_of(path).write(content, path)
    objects = [
        "/".join(str(part.start // size) for part, size in zip(box, lengths.tile, strict=True))
        for box in lengths
    ]
    for place in objects[1:]:
        for name in names:
            target = path / f"{name}/c/{place}"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.hardlink_to(path / f"{name}/c/{objects[0]}")
    size = sum(file.stat().st_size for file in path.rglob("*"))
    print(f"{run.scene.size} points, {lengths.count} chunks, {len(names)} variables, {size / 1e9:.3g} GB")


def many_tiles(path: Path, count: int) -> None:
    """Write a run folder with `count` tiles of 8 points."""
    with patch.dict(os.environ, ATLAS_TILE_POINTS="8"):
        run, values = prepare(path, ["label", "status", "theta_dot_rms"], count, 8)
    header, columns = run.tiles.read(0)
    flat = {name: column.ravel() for name, column in columns.items()}
    for number in range(run.tiling.count):
        own = run.tiles.place.path / run.tiles.name(number)
        own.parent.mkdir(exist_ok=True)
        own.write_bytes(encode(header | {"tile": number}, flat))
    totals, _ = run.tiles.check(range(1))
    run.save_notes({"atlas_half_step_points": 0}, totals)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("gigabytes", type=float, nargs="?", default=100.0)
    parser.add_argument("tiles", type=int, nargs="?", default=50_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        large_store(folder / "large.zarr", options.gigabytes)
        for question, code in QUESTIONS.items():
            opened = f"import atlas; from atlas import accessor; ds = atlas.open_atlas('large.zarr'); print({code})"
            measure(folder, question, sys.executable, "-c", opened)
        many_tiles(folder / "many", options.tiles)
        command = (sys.executable, "-m", "atlas")
        measure(folder, "status", *command, "status", "many")
        measure(folder, "status --verify", *command, "status", "many", "--verify")
        measure(folder, "join", *command, "join", "many", "-o", "many.nc")
        measure(folder, "copy", "cp", "-r", "many", "copy")


if __name__ == "__main__":
    main()
