"""Overnight jobs under fault: kills, damage, full disks, company, in full counts; prints what was survived.

python scripts/faults.py [--kills 50] [--worker-kills 10]      (some minutes)

Every part ends with the atlas compared, byte by byte, with one computed in memory in one go.
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
from pathlib import Path

import atlas
from atlas.runs.folder import RunFolder
from atlas.scene import grid

SCENE = """
schema = 1
title = "faults"
system = "satellite"
[fixed]
A = 1.0
m = 0.5
[axes.sigma]
from = 0.3
to = 1.7
count = 60
[axes.theta0]
from = 0.2
to = 1.4
count = 64
[ties]
B = "A"
C = "sigma * A"
psi0 = "pi / 2"
[family]
name = "perp_velocity"
solve = ["k3"]
[nudge]
theta0 = 1e-4
psi0 = 1e-4
[integration]
duration = 30.0
tolerance = 1e-10
[labels]
rate_tolerance = 1e-3
"""
TILE = 64


class Trial:
    """A scene in a folder of its own, the atlas it should give, and empty run folders for it."""

    def __init__(self, folder: Path):
        self.folder = folder
        (folder / "scene.toml").write_text(SCENE)
        self.scene = atlas.load_scene(folder / "scene.toml")
        self.whole = atlas.run(self.scene, progress=False)

    def start(self, name: str) -> RunFolder:
        """A run folder of many small tiles: its manifest decides how every process cuts the scene."""
        usual, grid.MAX_POINTS_PER_TILE = grid.MAX_POINTS_PER_TILE, TILE
        try:
            return RunFolder.prepare(self.scene, self.folder / name, grid.check(self.scene), [])
        finally:
            grid.MAX_POINTS_PER_TILE = usual

    def process(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "atlas", "run", "scene.toml", "--quiet", *arguments],
            cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def finish(self, *arguments: str) -> None:
        process = self.process(*arguments)
        _, complaint = process.communicate()
        if process.returncode:
            sys.exit(f"{' '.join(arguments)}: exit {process.returncode}: {complaint}")

    def compared(self, path: Path) -> int:
        """Bytes of all variables, which must be equal."""
        total = 0
        with atlas.open_atlas(path) as ds:
            if set(ds.variables) != set(self.whole.variables):
                sys.exit(f"{path}: other variables")
            for name, array in self.whole.variables.items():
                if array.values.tobytes() != ds.variables[name].values.tobytes():
                    sys.exit(f"{path}: {name} differs")
                total += array.nbytes
        return total


def stamps(run: RunFolder) -> dict[str, int]:
    """Times of the last change of the files of tiles that are done, by name."""
    names = [f"{tile:08d}.nc" for tile in run.survey().done]
    return {name: (run.path / "tiles" / name).stat().st_mtime_ns for name in names}


def kills(trial: Trial, count: int) -> str:
    killed = rounds = again = compared = 0
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
            survey, after = run.survey(), stamps(run)
            if survey.damaged:
                sys.exit(f"kill -9 left a damaged tile: {survey.damaged}")
            again += sum(after[name] != stamp for name, stamp in before.items())
            before = after
        trial.finish("-o", f"{run.path.name}/")
        again += sum(stamps(run)[name] != stamp for name, stamp in before.items())
        compared += trial.compared(run.path)
    return f"{killed} kills in {rounds} runs survived, {again} whole tiles computed again, {compared} bytes equal"


def dask(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], start_new_session=True, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def worker_kills(trial: Trial, count: int) -> str:
    scheduler = dask("scheduler", "--port", "0", "--no-dashboard")
    assert scheduler.stderr is not None
    address = ""
    while not address:
        found = re.search(r"Scheduler at:\s+(tcp://\S+)", scheduler.stderr.readline())
        address = found[1] if found else ""
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
            _, complaint = process.communicate()
            if process.returncode:
                sys.exit(f"a run on dask failed: {complaint}")
            compared += trial.compared(run.path)
    finally:
        for each in [*workers, scheduler]:
            os.killpg(each.pid, signal.SIGKILL)
            each.communicate()
    return f"{killed} dask workers killed in {rounds} runs, {compared} bytes equal"


KINDS = ("truncated", "zeroed", "one flipped bit", "empty", "foreign key", "not NetCDF")


def damage(kind: str, file: Path, side: Path) -> None:
    content = file.read_bytes()
    place = random.randrange(1, len(content))
    if kind == "foreign key":
        side.write_text(json.dumps(json.loads(side.read_text()) | {"key": "0" * 64}))
    else:
        flipped = bytes([content[place] ^ 16])
        damaged = {
            "truncated": content[:place],
            "zeroed": bytes(len(content)),
            "one flipped bit": content[:place] + flipped + content[place + 1 :],
            "empty": b"",
            "not NetCDF": b"not NetCDF",
        }
        file.write_bytes(damaged[kind])


def damages(trial: Trial) -> str:
    run = trial.start("damages")
    trial.finish("-o", "damages/")
    tiles = run.path / "tiles"
    whole = {path: path.read_bytes() for path in tiles.glob("*.nc")}
    for tile in range(run.tiling.count):
        kind = KINDS[tile % len(KINDS)]
        damage(kind, tiles / f"{tile:08d}.nc", tiles / f"{tile:08d}.json")
        if not run.check(tile):
            sys.exit(f"tile {tile}, {kind}: not found")
    trial.finish("-o", "damages/")
    if {path: path.read_bytes() for path in whole} != whole:
        sys.exit("a tile computed again has other bytes")
    return (
        f"{run.tiling.count} tiles damaged ({', '.join(KINDS)}), each found and computed again,"
        f" {trial.compared(run.path)} bytes equal"
    )


def full_disk(trial: Trial) -> str:
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
            _, complaint = process.communicate()
            if process.returncode == 0:
                break
            lines = complaint.strip().splitlines()
            if process.returncode != 1 or len(lines) != 1 or "No space left" not in lines[0]:
                sys.exit(f"a full disk gave exit {process.returncode}: {complaint}")
            if run.survey().damaged:
                sys.exit("a full disk left a damaged tile")
            stops += 1
        return f"{stops} stops on a full disk, then finished, {trial.compared(run.path)} bytes equal"
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def read_only(trial: Trial) -> str:
    folder = trial.folder / "fixed"
    folder.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(folder)], capture_output=True, check=False)
    if mount.returncode:
        return "skipped: only root can mount a disk"
    try:
        trial.start("fixed/run")
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        process = trial.process("-o", "fixed/run/")
        _, complaint = process.communicate()
        if process.returncode != 2 or "cannot be written" not in complaint:
            sys.exit(f"a read-only folder gave exit {process.returncode}: {complaint}")
        return f"refused with exit 2: {complaint.strip().split(': ', 2)[-1]}"
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def company(trial: Trial, rounds: int = 3) -> str:
    compared = 0
    for i in range(rounds):
        run = trial.start(f"company{i}")
        both = [trial.process("-o", f"company{i}/") for _ in range(2)]
        for process in both:
            _, complaint = process.communicate()
            if process.returncode:
                sys.exit(f"two processes on one folder: {complaint}")
        compared += trial.compared(run.path)
    return f"{rounds} times two processes finished one folder, {compared} bytes equal"


def modes(trial: Trial) -> str:
    trial.finish("-o", "one.nc", "--threads", "1")
    trial.finish("-o", "two.nc", "--threads", "2")
    trial.finish("-o", "dask.nc", "--workers", "2")
    for part in (3, 1, 2):
        trial.finish("-o", "shards/", "--shard", f"{part}/3")
    names = ("one.nc", "two.nc", "dask.nc", "shards")
    return f"{', '.join(names)}: {sum(trial.compared(trial.folder / name) for name in names)} bytes equal"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--kills", type=int, default=50)
    options.add_argument("--worker-kills", type=int, default=10)
    given = options.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="atlas-faults-"))
    try:
        trial = Trial(folder)
        print(
            f"{trial.scene.size} points in {trial.start('cut').tiling.count} tiles, {trial.whole.nbytes} bytes"
        )
        for name, part in {
            "modes": lambda: modes(trial),
            "kill -9": lambda: kills(trial, given.kills),
            "kill -9 of dask workers": lambda: worker_kills(trial, given.worker_kills),
            "damage": lambda: damages(trial),
            "full disk": lambda: full_disk(trial),
            "read-only folder": lambda: read_only(trial),
            "two processes": lambda: company(trial),
        }.items():
            print(f"{name}: {part()}", flush=True)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
