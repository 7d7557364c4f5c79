"""Runs that are killed at random moments or at every step, and runs by several processes."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import time

from fault_trial import Trial, change_times, dying, in_fork

import atlas
from atlas import files
from atlas.runs.folder import RunFolder
from atlas.runs.plan import ScenePlan


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
    plan = ScenePlan.of(trial.scene)
    link, count, leftovers, manifests = os.link, 0, 0, 0

    def no_link(*arguments: object) -> None:
        raise OSError(95, "Operation not supported")

    def create() -> None:
        RunFolder.prepare(plan, place, [])

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


def shifted_shards(trial: Trial, scale: float) -> str:
    """Kill a job array of 5 and submit only the missing parts, which the queue counts anew: shards shift."""
    run = trial.start("shards5")
    killed = 0
    for shard in (1, 3, 5, 2, 4):
        process = trial.process("-o", "shards5/", "--shard", f"{shard}/5")
        if shard in (2, 4):
            while (
                len(run.tiles.status().done) < 3 * run.tiling.count // 5 + killed and process.poll() is None
            ):
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
