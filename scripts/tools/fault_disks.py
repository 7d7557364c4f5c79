"""Disks that are full or cannot be written, files of other users, and a clock that goes backwards."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fault_trial import Trial, change_times, in_fork

import atlas
from atlas import files
from atlas.files import process_name
from atlas.runs.folder import RunFolder


class SmallDisk:
    """A disk of a size that can be changed, for root; or a limit of the size of each file, for anybody else."""

    def __init__(self, path: Path):
        self.path = path
        self.kilobytes = 0
        path.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", str(path)]
        self.mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
        self.kind = "a small disk" if self.mounted else "a limit of the size of files"
        self.message = "No space left" if self.mounted else "File too large"

    def resize(self, kilobytes: int) -> None:
        self.kilobytes = kilobytes
        if self.mounted:
            subprocess.run(["mount", "-o", f"remount,size={kilobytes}k", str(self.path)], check=True)

    def options(self) -> dict[str, Any]:
        """Options of a process that uses the disk."""
        limit = (self.kilobytes * 1024, resource.RLIM_INFINITY)
        return (
            {} if self.mounted else {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit)}
        )

    def remove(self) -> None:
        if self.mounted:
            subprocess.run(["umount", str(self.path)], check=True)


def full_disk(trial: Trial, scale: float) -> str:
    """Fill the disk while the manifest, tiles and the joined file are written; each stop must be one clear line."""
    disk = SmallDisk(trial.folder / "disk")
    stops = dict.fromkeys(("manifest", "tiles", "join"), 0)

    def stopped(process: subprocess.Popen[str], what: str) -> bool:
        _, error = process.communicate()
        if process.returncode == 0:
            return False
        lines = error.strip().splitlines()
        if process.returncode != 1 or len(lines) != 1 or disk.message not in lines[0]:
            sys.exit(f"a full disk gave exit {process.returncode}: {error}")
        if list(disk.path.rglob(".atlas-*")):
            sys.exit(f"a full disk left {sorted(disk.path.rglob('.atlas-*'))}")
        stops[what] += 1
        return True

    try:
        disk.resize(4)
        stopped(trial.process("-o", "disk/run/", **disk.options()), "manifest")
        disk.resize(64)
        shutil.rmtree(disk.path / "run", ignore_errors=True)
        run = trial.start("disk/run")
        for size in range(64, 1000, max(round(60 / scale), 30)) if disk.mounted else (1, 4, 8, 16):
            disk.resize(size)
            if not stopped(trial.process("-o", "disk/run/", **disk.options()), "tiles"):
                break
            if run.tiles.status().damaged:
                sys.exit("a full disk left a damaged tile")
        disk.resize(20_000)
        if stopped(trial.process("-o", "disk/run/", **disk.options()), "tiles"):
            sys.exit("the run did not finish on a disk that is large enough")
        run.join(trial.folder / "size.nc")
        used = sum(path.stat().st_blocks // 2 for path in disk.path.rglob("*")) if disk.mounted else 0
        needed = (trial.folder / "size.nc").stat().st_size // 1024
        for share in (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95):
            disk.resize(used + round(share * needed))
            stopped(trial.command("join", "disk/run", "-o", "disk/a.nc", **disk.options()), "join")
            if len(run.tiles.status().done) != run.tiling.count:
                sys.exit("a join on a full disk lost tiles")
        disk.resize(20_000)
        if stopped(trial.command("join", "disk/run", "-o", "disk/a.nc"), "join"):
            sys.exit("the join did not finish on a disk that is large enough")
        compared = trial.compared(disk.path / "a.nc")
        return f"{disk.kind}: stops {stops}, then finished, {compared} bytes equal"
    finally:
        disk.remove()


def read_only(trial: Trial, scale: float) -> str:
    """Run on a disk that cannot be written: the command must refuse with exit status 2."""
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


def permissions(trial: Trial, scale: float) -> str:
    """Work as an ordinary user among files of somebody else: one line, exit 2 or 1, and nothing changed."""
    place = trial.folder / "others"
    place.mkdir()
    trial.start("others/run")
    trial.finish("-o", "others/run/")
    RunFolder.open(place / "run").join(place / "a.nc")
    (place / "run" / "tiles" / "00000005.nc").unlink()
    closed = place / "closed"
    closed.mkdir()

    def as_user(action: Callable[[], object]) -> Callable[[], None]:
        def act() -> None:
            if os.getuid() == 0:
                os.setgroups([])
                os.setgid(65534)
                os.setuid(65534)
            action()

        return act

    def run(out: str, **options: Any) -> Callable[[], object]:
        return lambda: atlas.run(trial.scene, f"{place}/{out}", threads=1, progress=False, **options)

    modes = {path: 0o555 if path.is_dir() else 0o444 for path in [place, *place.rglob("*")]}
    modes |= {closed: 0o000, place / "run" / "tiles" / "00000006.nc": 0o000}
    before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
    actions: dict[str, Callable[[], object]] = {
        "a new folder": run("new/"),
        "a new file": run("new.nc"),
        "a file to replace": run("a.nc", force=True),
        "a folder to continue": run("run/"),
        "a closed folder": run("closed/new/"),
        "a joined file": lambda: RunFolder.open(place / "run").join(files.writable(place / "b.nc", (".nc",), force=False)),
    }  # fmt: skip
    answers = []
    trial.folder.chmod(0o755)
    for path, mode in modes.items():
        path.chmod(mode)
    try:
        for name, action in actions.items():
            code, message = in_fork(as_user(action))
            if code not in (1, 2) or len(message.splitlines()) != 1:
                sys.exit(f"{name}: exit {code}: {message}")
            answers.append(f"{name}: exit {code}")
    finally:
        for path in modes:
            path.chmod(0o755)
    if {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} != before:
        sys.exit("an ordinary user changed files of somebody else")
    trial.finish("-o", "others/run/")
    return f"{', '.join(answers)}; nothing changed, {trial.compared(place / 'run')} bytes equal"


def clock_back(trial: Trial, scale: float) -> str:
    """Continue a run whose files are of the future with a clock that goes backwards."""
    run, now = trial.start("clock"), time.time()

    def earlier() -> float:
        nonlocal now
        now -= 3600.0
        return now

    def run_shard(shard: int) -> Callable[[], None]:
        def act() -> None:
            time.time = earlier
            atlas.run(trial.scene, run.path, threads=1, progress=False, shard=(shard, 4)).close()

        return act

    stopped = run.path / f".atlas-{process_name()}0-01234567.tmp"  # of a process that has never been
    for shard in (1, 2, 3):
        code, message = in_fork(run_shard(shard))
        if code:
            sys.exit(f"a clock set back: exit {code}: {message}")
        stopped.write_text("half a file")
        for path in run.path.rglob("*"):
            os.utime(path, (time.time() + 1e8 * shard, time.time() + 1e8 * shard))
    before = change_times(run)
    trial.finish("-o", "clock/")
    if any(change_times(run)[name] != stamp for name, stamp in before.items()):
        sys.exit("a finished tile was computed again")
    if stopped.exists():
        sys.exit("a leftover of the future was not removed")
    return f"{len(before)} tiles of the future kept, {trial.compared(run.path)} bytes equal"
