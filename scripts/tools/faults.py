"""Run folders and atlas files under faults; prints the counts and ends with an error at the first wrong result.

python scripts/tools/faults.py                          (all parts, about half an hour on two processors)
python scripts/tools/faults.py --only "full disk" flips --scale 0.1

Every part ends with a byte-by-byte comparison of the atlas with one computed in memory by one process. Some parts
do more as root: small disks are mounted, and an ordinary user is a process without root's rights. Otherwise the
size of files is limited, and permissions are taken from the user who runs this.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import atlas
from atlas import BadInput, files
from atlas.process import name as process_name
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
        # One thread, because a process whose compiled code has started threads cannot be forked.
        self.whole = atlas.run(self.scene, threads=1, progress=False)

    def start(self, name: str) -> RunFolder:
        """Prepare a run folder of many small tiles, which its manifest lists for every process."""
        usual, grid.MAX_POINTS_PER_TILE = grid.MAX_POINTS_PER_TILE, TILE
        try:
            return RunFolder.prepare(self.scene, self.folder / name, grid.check(self.scene), [])
        finally:
            grid.MAX_POINTS_PER_TILE = usual

    def process(self, *arguments: str, **options: Any) -> subprocess.Popen[str]:
        """Start `atlas run` on the scene in a process of its own."""
        return self.command("run", "scene.toml", "--quiet", *arguments, **options)

    def command(self, *arguments: str, **options: Any) -> subprocess.Popen[str]:
        """Start an `atlas` command in a process of its own."""
        return subprocess.Popen(
            [sys.executable, "-m", "atlas", *arguments], cwd=self.folder, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **options,
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


def kills(trial: Trial, scale: float) -> str:
    """Kill runs with SIGKILL at random moments; finished tiles must not be computed again."""
    count = max(round(150 * scale), 1)
    killed = rounds = recomputed = compared = 0
    while killed < count:
        run = trial.start(f"kills{rounds}")
        rounds += 1
        before: dict[str, int] = {}
        while killed < count and len(before) < run.tiling.count - 4:
            child = os.fork()
            if child == 0:
                atlas.run(trial.scene, run.path, threads=1, progress=False)
                os._exit(0)
            while len(list((run.path / "tiles").glob("*.json"))) <= len(before):
                if os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None:
                    sys.exit("a run ended by itself")
                time.sleep(0.005)
            time.sleep(random.uniform(0, 0.15))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
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


def worker_kills(trial: Trial, scale: float) -> str:
    """Kill dask workers at work and replace them; the run must finish."""
    count = max(round(50 * scale), 1)
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


def damages(trial: Trial, scale: float) -> str:
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


def in_fork(action: Callable[[], object]) -> tuple[int, str]:
    """Call something in a fork of this process; its exit status (2 for BadInput, 1 for an OSError) and message."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        code = 3
        try:
            action()
            code = 0
        except (BadInput, OSError) as error:
            os.write(writer, str(error).encode())
            code = 2 if isinstance(error, BadInput) else 1
        except BaseException as error:
            os.write(writer, repr(error).encode())
        finally:
            os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as message:
        text = message.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


def dying(action: Callable[[], object], step: int | None, counts: Path) -> Callable[[], None]:
    """An action that is killed just before its change number `step` of a file or folder; it notes their number."""

    def act() -> None:
        steps = 0

        def counted(change: Callable[..., Any]) -> Callable[..., Any]:
            def change_or_die(*arguments: Any, **options: Any) -> Any:
                nonlocal steps
                steps += 1
                if steps == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                return change(*arguments, **options)

            return change_or_die

        for name in ("replace", "link", "rename", "unlink", "rmdir", "mkdir", "fsync", "open"):
            setattr(os, name, counted(getattr(os, name)))
        action()
        counts.write_text(str(steps))

    return act


def step_kills(trial: Trial, scale: float) -> str:
    """Kill `run -o X.nc`, a finished one, at every change of a file or folder; the same call must finish."""
    trial.start("steps.nc.run")
    trial.finish("-o", "steps.nc.run/", "--threads", "1")
    shutil.move(trial.folder / "steps.nc.run", trial.folder / "steps")
    place = trial.folder / "place"
    place.mkdir()
    out, counts = place / "a.nc", trial.folder / "counts"

    def run() -> None:
        atlas.run(trial.scene, out, threads=1, progress=False).close()

    def prepare() -> None:
        out.unlink(missing_ok=True)
        shutil.copytree(trial.folder / "steps", place / "a.nc.run")
        (place / "a.nc.run" / "notes.json").unlink()

    prepare()
    if in_fork(dying(run, None, counts))[0]:
        sys.exit("the run that counts the steps failed")
    steps = int(counts.read_text())
    whole = half = compared = 0
    for step in range(1, steps + 1, max(round(1 / scale), 1)):
        prepare()
        if in_fork(dying(run, step, counts))[0] != -signal.SIGKILL:
            sys.exit(f"step {step} was not reached")
        whole += out.exists()
        half += out.exists() and (place / "a.nc.run").exists()
        code, message = in_fork(run)
        if code or [path.name for path in place.iterdir()] != ["a.nc"]:
            sys.exit(f"killed at step {step}: exit {code}, {message}, {sorted(place.iterdir())}")
        compared += trial.compared(out)
    return (
        f"killed at each of {steps} steps: {whole} times the file was in place, {half} times with some of its run"
        f" folder; the same call finished all, nothing else left, {compared} bytes equal"
    )


def join_kills(trial: Trial, scale: float) -> str:
    """Kill joins at random moments; the file must be whole or absent, and nothing must stay."""
    trial.start("joins")
    trial.finish("-o", "joins/")
    place = trial.folder / "joined"
    place.mkdir()
    run, out = RunFolder.open(trial.folder / "joins"), place / "a.nc"
    started = time.perf_counter()
    run.join(out)
    seconds = time.perf_counter() - started
    absent = leftovers = compared = 0
    count = max(round(40 * scale), 1)
    for _ in range(count):
        out.unlink(missing_ok=True)
        child = os.fork()
        if child == 0:
            run.join(out)
            os._exit(0)
        time.sleep(random.uniform(0, 1.2 * seconds))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        absent += not out.exists()
        leftovers += len(list(place.glob(".*")))
        if out.exists():
            compared += trial.compared(out)
        run.status()
        run.join(files.writable(out, (".nc",), force=True))
        compared += trial.compared(out)
        if [path.name for path in place.iterdir()] != ["a.nc"]:
            sys.exit(f"left beside the joined file: {sorted(place.iterdir())}")
    return f"{count} joins killed, {absent} without a file, {leftovers} leftovers, all removed, {compared} bytes equal"


def creation_kills(trial: Trial, scale: float) -> str:
    """Kill the creation of a run folder at random moments and at every step, with and without hard links."""
    place, counts = trial.folder / "created", trial.folder / "counts"
    sample = grid.check(trial.scene)
    link, count, leftovers, manifests = os.link, 0, 0, 0

    def no_link(*arguments: object) -> None:
        raise OSError(95, "Operation not supported")

    def create() -> None:
        RunFolder.prepare(trial.scene, place, sample, [])

    for os.link in (link, no_link):
        if in_fork(dying(create, None, counts))[0]:
            sys.exit("the creation that counts the steps failed")
        for step in range(1, int(counts.read_text()) + 1):
            shutil.rmtree(place, ignore_errors=True)
            if in_fork(dying(create, step, counts))[0] != -signal.SIGKILL:
                sys.exit(f"step {step} was not reached")
            leftovers += len(list(place.glob(".atlas-*")))
            manifests += (place / "manifest.json").exists()
            code, message = in_fork(create)
            if code or list(place.glob(".atlas-*")):
                sys.exit(f"creation killed at step {step}: exit {code}, {message}, {sorted(place.iterdir())}")
            count += 1
    os.link = link
    for _ in range(max(round(40 * scale), 1)):
        shutil.rmtree(place, ignore_errors=True)
        child = os.fork()
        if child == 0:
            create()
            os._exit(0)
        time.sleep(random.uniform(0, 0.05))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        leftovers += len(list(place.glob(".atlas-*"))) if place.exists() else 0
        manifests += (place / "manifest.json").exists()
        create()
        if list(place.glob(".atlas-*")):
            sys.exit(f"left in a new folder: {sorted(place.iterdir())}")
        count += 1
    trial.finish("-o", "created/")
    return (
        f"{count} creations killed, {manifests} after the manifest, {leftovers} leftovers, all removed,"
        f" {trial.compared(place)} bytes equal"
    )


def flipped(file: Path) -> None:
    """Flip one random bit of a file."""
    content = bytearray(file.read_bytes())
    content[random.randrange(len(content))] ^= 1 << random.randrange(8)
    file.write_bytes(content)


def flips(trial: Trial, scale: float) -> str:
    """Flip single bits of each kind of file; each flip must be found, or the data must be the same."""
    run = trial.start("flips")
    trial.finish("-o", "flips/")
    run.join(trial.folder / "flips.nc")
    attributes = repr(RunFolder.open(run.path).dataset().attrs)
    with atlas.open_atlas(trial.folder / "flips.nc") as ds:
        joined_attributes = repr(ds.attrs)

    def of_tile(suffix: str) -> Path:
        return run.tiles.path(random.randrange(run.tiling.count), suffix)

    def read_tiles(file: Path) -> bool:
        if not run.tiles.is_done(int(file.stem)):
            raise BadInput("found")
        return repr(run.dataset().attrs) == attributes

    def read_folder(file: Path) -> bool:
        return repr(RunFolder.open(run.path).dataset().attrs) == attributes

    def read_file(file: Path) -> bool:
        with atlas.open_atlas(file) as ds:
            return repr(ds.attrs) == joined_attributes and all(
                ds.variables[name].values.tobytes() == array.values.tobytes()
                and ds.variables[name].dims == array.dims
                and repr(ds.variables[name].attrs) == repr(array.attrs)
                for name, array in trial.whole.variables.items()
            )

    kinds: dict[str, tuple[int, Callable[[], Path], Callable[[Path], bool]]] = {
        "tiles": (200, lambda: of_tile(".nc"), read_tiles),
        "sidecars": (200, lambda: of_tile(".json"), read_tiles),
        "manifest": (400, lambda: run.path / "manifest.json", read_folder),
        "notes": (200, lambda: run.path / "notes.json", read_folder),
        "joined file": (400, lambda: trial.folder / "flips.nc", read_file),
    }
    report = []
    for kind, (number, choose, read) in kinds.items():
        found = same = other = 0
        for _ in range(max(round(number * scale), 1)):
            file = choose()
            whole = file.read_bytes()
            flipped(file)
            try:
                if read(file):
                    same += 1
                else:
                    other += 1
            except BadInput as error:
                found += 1
                if len(str(error).splitlines()) != 1:
                    sys.exit(f"{kind}: not one line: {error}")
            file.write_bytes(whole)
        report.append(f"{kind}: {found} found, {same} same data, {other} other data")
        if other:
            sys.exit("; ".join(report))
    return "; ".join(report) + f"; {trial.compared(run.path)} bytes equal"


def swaps(trial: Trial, scale: float) -> str:
    """Swap tiles with their sidecars; each must be found and computed again."""
    run = trial.start("swaps")
    trial.finish("-o", "swaps/")
    order = random.sample(range(run.tiling.count), 2 * max(round(15 * scale), 1))
    for suffix in (".nc", ".json"):
        for one, two in zip(order[::2], order[1::2], strict=True):
            first, second = run.tiles.path(one, suffix), run.tiles.path(two, suffix)
            between = first.with_suffix(".swap")
            first.rename(between)
            second.rename(first)
            between.rename(second)
    found = len(run.tiles.status().damaged)
    if found != len(order):
        sys.exit(f"{found} of {len(order)} swapped tiles found")
    trial.finish("-o", "swaps/")
    return f"{len(order) // 2} pairs of tiles swapped, all found, {trial.compared(run.path)} bytes equal"


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


def shifted_shards(trial: Trial, scale: float) -> str:
    """Kill a job array of 5 and submit only the missing parts, which the queue counts anew: shards shift."""
    run = trial.start("shards5")
    killed = 0
    for shard in (1, 3, 5, 2, 4):
        process = trial.process("-o", "shards5/", "--shard", f"{shard}/5")
        if shard in (2, 4):
            while len(run.tiles.status().done) < 36 + killed and process.poll() is None:
                time.sleep(0.01)
            process.send_signal(signal.SIGKILL)
            killed += 1
        process.communicate()
    before = change_times(run)
    trial.finish("-o", "shards5/", "--shard", "1/2")
    between = len(run.tiles.status().done)
    trial.finish("-o", "shards5/", "--shard", "2/2")
    if any(change_times(run)[name] != stamp for name, stamp in before.items()):
        sys.exit("a finished tile was computed again")
    return (
        f"{killed} of 5 shards killed with {len(before)} tiles done, shards 1/2 and 2/2 made them {between} and"
        f" {len(run.tiles.status().done)} of {run.tiling.count}, none again, {trial.compared(run.path)} bytes equal"
    )


def two_processes(trial: Trial, scale: float) -> str:
    """Let two processes work in one run folder, and on one file, at the same time."""
    compared = 0
    rounds = max(round(5 * scale), 1)
    for i in range(rounds):
        for out in (f"two{i}/", f"two{i}.nc"):
            trial.start(out[:-1] if out.endswith("/") else f"{out}.run")
            both = [trial.process("-o", out) for _ in range(2)]
            for process in both:
                _, error = process.communicate()
                if process.returncode:
                    sys.exit(f"two processes on {out}: exit {process.returncode}: {error}")
            compared += trial.compared(trial.folder / out)
            if (trial.folder / f"{out}.run").exists():
                sys.exit(f"{out}.run is left")
    return (
        f"{rounds} times two processes finished one folder and one file, all exit 0, {compared} bytes equal"
    )


def modes(trial: Trial, scale: float) -> str:
    """Run with one thread, two threads, dask workers and shards; all must give the same bytes."""
    trial.finish("-o", "one.nc", "--threads", "1")
    trial.finish("-o", "two.nc", "--threads", "2")
    trial.finish("-o", "dask.nc", "--workers", "2")
    for shard in (3, 1, 2):
        trial.finish("-o", "shards/", "--shard", f"{shard}/3")
    names = ("one.nc", "two.nc", "dask.nc", "shards")
    return f"{', '.join(names)}: {sum(trial.compared(trial.folder / name) for name in names)} bytes equal"


PARTS: dict[str, Callable[[Trial, float], str]] = {
    "modes": modes,
    "kills": kills,
    "step kills": step_kills,
    "join kills": join_kills,
    "creation kills": creation_kills,
    "worker kills": worker_kills,
    "damage": damages,
    "flips": flips,
    "swaps": swaps,
    "full disk": full_disk,
    "read-only disk": read_only,
    "permissions": permissions,
    "clock back": clock_back,
    "shifted shards": shifted_shards,
    "two processes": two_processes,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS)
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="share of the usual number of faults (default: 1)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers (default: 1)")
    options = parser.parse_args()
    random.seed(options.seed)
    logging.disable(logging.WARNING)  # damage is counted here
    folder = Path(tempfile.mkdtemp(prefix="atlas-faults-"))
    try:
        trial = Trial(folder)
        tiles = trial.start("cut").tiling.count
        print(f"{trial.scene.size} points in {tiles} tiles, {trial.whole.nbytes} bytes", flush=True)
        for name in options.only:
            print(f"{name}: {PARTS[name](trial, options.scale)}", flush=True)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
