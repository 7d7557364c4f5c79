"""Run folders under faults: killed processes, damaged files, full disks, two processes; prints the counts.

python scripts/tools/faults.py [--kills 50] [--worker-kills 10]      (some minutes)

Every part ends with a byte-by-byte comparison of the atlas with one computed in memory by one process.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import atlas
from atlas.runs.folder import RunFolder
from atlas.scene import grid
from atlas.scene.read import scene_from

SMALL_SCENE = Path(__file__).parents[2] / "tests" / "small.toml"
TILE = 64


class Trial:
    """A scene in a folder of its own, the atlas expected of it, and empty run folders for it."""

    def __init__(self, folder: Path):
        self.folder = folder
        table = tomllib.loads(SMALL_SCENE.read_text())
        table["axes"]["sigma"]["count"], table["axes"]["theta0"]["count"] = 60, 64
        table["integration"]["tolerance"] = 1e-10
        (folder / "scene.toml").write_text(scene_from(table).toml())
        self.scene = atlas.load_scene(folder / "scene.toml")
        self.whole = atlas.run(self.scene, progress=False)

    def start(self, name: str) -> RunFolder:
        """Prepare a run folder of many small tiles, which its manifest lists for every process."""
        usual, grid.MAX_POINTS_PER_TILE = grid.MAX_POINTS_PER_TILE, TILE
        try:
            return RunFolder.prepare(self.scene, self.folder / name, grid.check(self.scene), [])
        finally:
            grid.MAX_POINTS_PER_TILE = usual

    def process(self, *arguments: str) -> subprocess.Popen[str]:
        """Start `atlas run` on the scene in a process of its own."""
        return subprocess.Popen(
            [sys.executable, "-m", "atlas", "run", "scene.toml", "--quiet", *arguments],
            cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def finish(self, *arguments: str) -> None:
        """Run the scene to its end; an error ends this script."""
        process = self.process(*arguments)
        _, error = process.communicate()
        if process.returncode:
            sys.exit(f"{' '.join(arguments)}: exit {process.returncode}: {error}")

    def compared(self, path: Path) -> int:
        """Compare all variables with those expected, byte by byte; returns the number of bytes."""
        total = 0
        with atlas.open_atlas(path) as ds:
            if set(ds.variables) != set(self.whole.variables):
                sys.exit(f"{path}: the variables differ")
            for name, array in self.whole.variables.items():
                if array.values.tobytes() != ds.variables[name].values.tobytes():
                    sys.exit(f"{path}: {name} differs")
                total += array.nbytes
        return total


def change_times(run: RunFolder) -> dict[str, int]:
    """Times of the last change of the files of finished tiles, by name."""
    names = [f"{tile:08d}.nc" for tile in run.tiles.status().done]
    return {name: (run.path / "tiles" / name).stat().st_mtime_ns for name in names}


def kills(trial: Trial, count: int) -> str:
    """Kill runs with SIGKILL at random moments; finished tiles must not be computed again."""
    killed = rounds = recomputed = compared = 0
    while killed < count:
        run = trial.start(f"kills{rounds}")
        rounds += 1
        before: dict[str, int] = {}
        while killed < count and len(before) < run.tiling.count - 4:
            process = trial.process("-o", f"{run.path.name}/")
            while len(os.listdir(run.path / "tiles")) < 2 * len(before) + 3 and process.poll() is None:
                time.sleep(0.01)
            time.sleep(random.uniform(0, 0.15))
            process.send_signal(signal.SIGKILL)
            process.communicate()
            killed += 1
            status, after = run.tiles.status(), change_times(run)
            if status.damaged:
                sys.exit(f"kill -9 left a damaged tile: {status.damaged}")
            recomputed += sum(after[name] != stamp for name, stamp in before.items())
            before = after
        trial.finish("-o", f"{run.path.name}/")
        recomputed += sum(change_times(run)[name] != stamp for name, stamp in before.items())
        compared += trial.compared(run.path)
    return f"{killed} kills in {rounds} runs survived, {recomputed} finished tiles computed again, {compared} bytes equal"


def dask(*arguments: str) -> subprocess.Popen[str]:
    """Start a scheduler or a worker of dask in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], start_new_session=True, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def worker_kills(trial: Trial, count: int) -> str:
    """Kill dask workers at work and replace them; the run must finish."""
    scheduler = dask("scheduler", "--port", "0", "--no-dashboard")
    assert scheduler.stderr is not None
    address = ""
    while not address:
        match = re.search(r"Scheduler at:\s+(tcp://\S+)", scheduler.stderr.readline())
        address = match[1] if match else ""
    workers = [dask("worker", address, "--nthreads", "1", "--no-dashboard") for _ in range(2)]
    killed = rounds = compared = 0
    try:
        while killed < count:
            run = trial.start(f"workers{rounds}")
            rounds += 1
            process = trial.process("-o", f"{run.path.name}/", "--scheduler", address)
            done = 0
            while process.poll() is None and killed < count:
                now = len(list((run.path / "tiles").glob("*.json")))
                if now > done:
                    done = now + 3
                    victim = workers.pop(0)
                    os.killpg(victim.pid, signal.SIGKILL)
                    victim.communicate()
                    killed += 1
                    workers.append(dask("worker", address, "--nthreads", "1", "--no-dashboard"))
                time.sleep(0.05)
            _, error = process.communicate()
            if process.returncode:
                sys.exit(f"a run on dask failed: {error}")
            compared += trial.compared(run.path)
    finally:
        for each in [*workers, scheduler]:
            os.killpg(each.pid, signal.SIGKILL)
            each.communicate()
    return f"{killed} dask workers killed in {rounds} runs, {compared} bytes equal"


DAMAGES = ("truncated", "zeroed", "one flipped bit", "empty", "foreign key", "not NetCDF")


def damage(kind: str, file: Path, record: Path) -> None:
    """Damage the file of a tile, or the JSON record beside it, in one of the ways of DAMAGES."""
    content = file.read_bytes()
    position = random.randrange(1, len(content))
    if kind == "foreign key":
        record.write_text(json.dumps(json.loads(record.read_text()) | {"key": "0" * 64}))
    else:
        flipped = bytes([content[position] ^ 16])
        damaged = {
            "truncated": content[:position],
            "zeroed": bytes(len(content)),
            "one flipped bit": content[:position] + flipped + content[position + 1 :],
            "empty": b"",
            "not NetCDF": b"not NetCDF",
        }
        file.write_bytes(damaged[kind])


def damages(trial: Trial) -> str:
    """Damage every tile of a finished run; each must be detected and computed again with the same bytes."""
    run = trial.start("damages")
    trial.finish("-o", "damages/")
    tiles = run.path / "tiles"
    whole = {path: path.read_bytes() for path in tiles.glob("*.nc")}
    for tile in range(run.tiling.count):
        kind = DAMAGES[tile % len(DAMAGES)]
        damage(kind, tiles / f"{tile:08d}.nc", tiles / f"{tile:08d}.json")
        if run.tiles.is_done(tile):
            sys.exit(f"tile {tile}, {kind}: not detected")
    trial.finish("-o", "damages/")
    if {path: path.read_bytes() for path in whole} != whole:
        sys.exit("a tile computed again differs from the first one")
    return (
        f"{run.tiling.count} tiles damaged ({', '.join(DAMAGES)}), each detected and computed again,"
        f" {trial.compared(run.path)} bytes equal"
    )


def full_disk(trial: Trial) -> str:
    """Run on a disk that is too small and grows: each stop must be one clear line, and the last run finishes."""
    disk = trial.folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        return "skipped: only root can mount a small disk"
    try:
        run = trial.start("disk/run")
        stops = 0
        for size in (600, 1200, 2400, 20_000):
            subprocess.run(["mount", "-o", f"remount,size={size}k", str(disk)], check=True)
            process = trial.process("-o", "disk/run/")
            _, error = process.communicate()
            if process.returncode == 0:
                break
            lines = error.strip().splitlines()
            if process.returncode != 1 or len(lines) != 1 or "No space left" not in lines[0]:
                sys.exit(f"a full disk gave exit {process.returncode}: {error}")
            if run.tiles.status().damaged:
                sys.exit("a full disk left a damaged tile")
            stops += 1
        return f"{stops} stops on a full disk, then finished, {trial.compared(run.path)} bytes equal"
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def read_only(trial: Trial) -> str:
    """Run in a folder that cannot be written: the command must refuse with exit status 2."""
    folder = trial.folder / "fixed"
    folder.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(folder)], capture_output=True, check=False)
    if mount.returncode:
        return "skipped: only root can mount a disk"
    try:
        trial.start("fixed/run")
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        process = trial.process("-o", "fixed/run/")
        _, error = process.communicate()
        if process.returncode != 2 or "cannot be written" not in error:
            sys.exit(f"a read-only folder gave exit {process.returncode}: {error}")
        return f"refused with exit 2: {error.strip().split(': ', 2)[-1]}"
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def two_processes(trial: Trial, rounds: int = 3) -> str:
    """Let two processes work in one run folder at the same time."""
    compared = 0
    for i in range(rounds):
        run = trial.start(f"two{i}")
        both = [trial.process("-o", f"two{i}/") for _ in range(2)]
        for process in both:
            _, error = process.communicate()
            if process.returncode:
                sys.exit(f"two processes on one folder: {error}")
        compared += trial.compared(run.path)
    return f"{rounds} times two processes finished one folder, {compared} bytes equal"


def modes(trial: Trial) -> str:
    """Run with one thread, two threads, dask workers and shards; all must give the same bytes."""
    trial.finish("-o", "one.nc", "--threads", "1")
    trial.finish("-o", "two.nc", "--threads", "2")
    trial.finish("-o", "dask.nc", "--workers", "2")
    for shard in (3, 1, 2):
        trial.finish("-o", "shards/", "--shard", f"{shard}/3")
    names = ("one.nc", "two.nc", "dask.nc", "shards")
    return f"{', '.join(names)}: {sum(trial.compared(trial.folder / name) for name in names)} bytes equal"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--worker-kills", type=int, default=10)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="atlas-faults-"))
    try:
        trial = Trial(folder)
        print(
            f"{trial.scene.size} points in {trial.start('cut').tiling.count} tiles, {trial.whole.nbytes} bytes"
        )
        for name, part in {
            "modes": lambda: modes(trial),
            "kill -9": lambda: kills(trial, options.kills),
            "kill -9 of dask workers": lambda: worker_kills(trial, options.worker_kills),
            "damage": lambda: damages(trial),
            "full disk": lambda: full_disk(trial),
            "read-only folder": lambda: read_only(trial),
            "two processes": lambda: two_processes(trial),
        }.items():
            print(f"{name}: {part()}", flush=True)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
