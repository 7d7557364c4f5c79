"""Questions to a large store, and the join of many small tiles: time, processor time and memory.

python scripts/benchmarks/bench_large.py [GIGABYTES] [TILES]      (default 100 50000)

Of the store one tile exists, to whose objects all others are hard links, so that it takes 0.1 GB of the disk; the tiles are copies with
numbers of their own, and the join is compared with `cp -r`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bench_scaling import SCENE

import atlas
from atlas import systems
from atlas.files import sealed, unsealed
from atlas.runs import tiles
from atlas.runs.folder import RunFolder
from atlas.runs.plan import ScenePlan
from atlas.scene import grid
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
    run = RunFolder.prepare(
        ScenePlan.of(atlas.load_scene(text.replace('"label", "status", "theta_dot_rms"', listed))), path, []
    )
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
    """A store with so many bytes of numbers."""
    registry = variables(systems.get("satellite"))
    numbers = [n for n, v in registry.items() if v.dtype == "float64" and "equilibrium" not in n][:NUMBERS]
    names = [*FLAGS, *numbers]
    rows = round(gigabytes * 1e9 / (8 * NUMBERS + len(FLAGS)) / 1024)
    rows = max(rows // 512 * 512 or rows, 1)  # whole tiles
    run, values = prepare(path, names, rows, 1024)
    sidecar = unsealed(run.tiles.path(0, ".json").read_bytes())
    for tile in range(1, run.tiling.count):
        for name in values:
            target = path / f"{name}/c/{tile}/0/0"
            target.parent.mkdir(parents=True)
            target.hardlink_to(path / f"{name}/c/0/0/0")
        own = run.tiles.path(tile, ".json")
        own.parent.mkdir(exist_ok=True)
        own.write_text(sealed(sidecar | {"tile": tile}))
    run.save_final_attributes({})
    size = sum(file.stat().st_size for file in path.rglob("*"))
    print(f"{run.scene.size} points, {run.tiling.count} tiles, {len(names)} variables, {size / 1e9:.3g} GB")


def many_tiles(path: Path, count: int) -> None:
    """A run folder of so many tiles of 8 points."""
    tiles.MIN_POINTS_PER_TILE, grid.MAX_POINTS_PER_TILE = 1, 8
    run, _ = prepare(path, ["label", "status", "theta_dot_rms"], count, 8)
    content, sidecar = run.tiles.path(0).read_bytes(), unsealed(run.tiles.path(0, ".json").read_bytes())
    number = content.find(b"atlas_tile") + 20
    for tile in range(run.tiling.count):
        own = run.tiles.path(tile)
        own.parent.mkdir(exist_ok=True)
        own.write_bytes(new := content[:number] + tile.to_bytes(4, "big") + content[number + 4 :])
        entries = {"tile": tile, "hash": {"": run.tiles._hash(tile, new, 8)}}
        run.tiles.path(tile, ".json").write_text(sealed(sidecar | entries))
    run.save_final_attributes({})


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
        measure(folder, "first status", *command, "status", "many")
        measure(folder, "second status", *command, "status", "many")
        measure(folder, "join", *command, "join", "many", "-o", "many.nc")
        measure(folder, "copy", "cp", "-r", "many", "copy")


if __name__ == "__main__":
    main()
