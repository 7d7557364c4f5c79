"""Runs on dask under faults: schedulers, clients and workers killed at random; two clusters on one folder."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path

from fault_trial import Trial

from atlas.runs.folder import RunFolder


class Server:
    """A scheduler or a worker of dask in a process group of its own, which ends with the `with` statement."""

    def __init__(self, *arguments: str):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
            start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def kill(self) -> None:
        """End the server and what it has started with SIGKILL."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


class Scheduler(Server):
    """A scheduler that listens to this machine only."""

    def __init__(self, folder: Path):
        file = folder / f"scheduler-{uuid.uuid4().hex}.json"
        super().__init__("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        self.address = ""
        while not self.address:
            time.sleep(0.05)
            with suppress(OSError, ValueError):
                self.address = json.loads(file.read_text())["address"]


class Worker(Server):
    """A worker of one thread."""

    def __init__(self, address: str):
        super().__init__("worker", address, "--nthreads", "1")


def client(trial: Trial, run: RunFolder, address: str) -> subprocess.Popen[str]:
    """Start `atlas run` on a scheduler."""
    return trial.process("-o", f"{run.path.name}/", "--scheduler", address)


def done(run: RunFolder) -> int:
    """Number of finished tiles; a damaged one ends this script."""
    status = run.tiles.status()
    if status.damaged:
        sys.exit(f"{run.path}: damaged tiles: {status.damaged}")
    return len(status.done)


def written(run: RunFolder) -> int:
    """Number of tiles that are written."""
    return len(list((run.path / "tiles").glob("[0-9]*.json")))


def wait_for_tiles(run: RunFolder, process: subprocess.Popen[str], count: int) -> None:
    """Wait until a client has got so many more tiles or has ended, and then for a random time."""
    before = written(run)
    while written(run) < before + count and process.poll() is None:
        time.sleep(0.02)
    time.sleep(random.uniform(0.0, 1.0))


def schedulers(trial: Trial, scale: float) -> str:
    """Kill schedulers at random; the run must end with exit 1 and one line, and go on with another scheduler."""
    killed, rounds, compared, count = 0, 0, 0, max(round(50 * scale), 1)
    exits = Counter[str]()
    while killed < count:
        run = trial.start(f"schedulers{rounds}")
        rounds += 1
        while killed < count and done(run) < run.tiling.count - 4:
            with Scheduler(trial.folder) as scheduler, Worker(scheduler.address):
                process = client(trial, run, scheduler.address)
                if random.random() < 0.2:  # while the run starts and connects
                    time.sleep(random.uniform(0.5, 5.0))
                else:
                    wait_for_tiles(run, process, random.randint(1, 3))
                scheduler.kill()
                _, error = process.communicate()
            if process.returncode == 0:  # the run ended before
                continue
            lines = error.strip().splitlines()
            if process.returncode not in (1, 2) or len(lines) != 1 or not lines[0].startswith("atlas: "):
                sys.exit(f"killed scheduler: exit {process.returncode}: {error}")
            killed += 1
            exits[f"exit {process.returncode}, {re.sub('[0-9]+', 'N', lines[0])[:90]}"] += 1
        with Scheduler(trial.folder) as scheduler, Worker(scheduler.address):
            trial.finish("-o", f"{run.path.name}/", "--scheduler", scheduler.address)
        compared += trial.compared(run.path)
    texts = "".join(f"\n    {number} times {text}" for text, number in exits.most_common())
    return f"{killed} schedulers killed in {rounds} runs, {compared} bytes equal{texts}"


def clients(trial: Trial, scale: float) -> str:
    """Kill clients at random; the same command, on the same scheduler and workers, must finish the run."""
    killed, rounds, compared, count = 0, 0, 0, max(round(50 * scale), 1)
    with Scheduler(trial.folder) as scheduler, Worker(scheduler.address), Worker(scheduler.address):
        while killed < count:
            run = trial.start(f"clients{rounds}")
            rounds += 1
            while killed < count and done(run) < run.tiling.count - 4:
                process = client(trial, run, scheduler.address)
                if random.random() < 0.2:  # while it starts and connects
                    time.sleep(random.uniform(0.0, 4.0))
                else:
                    wait_for_tiles(run, process, random.randint(1, 3))
                killed += process.poll() is None
                process.kill()
                process.communicate()
            trial.finish("-o", f"{run.path.name}/", "--scheduler", scheduler.address)
            done(run)
            compared += trial.compared(run.path)
    return f"{killed} clients killed in {rounds} runs, {compared} bytes equal"


def workers(trial: Trial, scale: float) -> str:
    """Kill workers at work and replace them; the run must finish."""
    killed, rounds, compared, count = 0, 0, 0, max(round(50 * scale), 1)
    with ExitStack() as stack:
        scheduler = stack.enter_context(Scheduler(trial.folder))
        at_work = [stack.enter_context(Worker(scheduler.address)) for _ in range(2)]
        while killed < count:
            run = trial.start(f"workers{rounds}")
            rounds += 1
            process = client(trial, run, scheduler.address)
            while process.poll() is None and killed < count:
                wait_for_tiles(run, process, random.randint(1, 3))
                at_work.pop(0).kill()
                killed += 1
                at_work.append(stack.enter_context(Worker(scheduler.address)))
            _, error = process.communicate()
            if process.returncode:
                sys.exit(f"killed worker: exit {process.returncode}: {error}")
            done(run)
            compared += trial.compared(run.path)
    return f"{killed} workers killed in {rounds} runs, {compared} bytes equal"


def clusters(trial: Trial, scale: float) -> str:
    """Let two clusters compute one folder; in every second round one loses its scheduler."""
    compared, lost, rounds = 0, 0, max(round(10 * scale), 1)
    for i in range(rounds):
        run = trial.start(f"clusters{i}")
        with (
            Scheduler(trial.folder) as one,
            Scheduler(trial.folder) as two,
            Worker(one.address),
            Worker(two.address),
        ):
            processes = [client(trial, run, scheduler.address) for scheduler in (one, two)]
            if i % 2:
                while not done(run) and processes[0].poll() is None:
                    time.sleep(0.05)
                one.kill()
            for process in processes:
                _, error = process.communicate()
                if process.returncode and (process is processes[1] or "scheduler was lost" not in error):
                    sys.exit(f"two clusters on one folder: exit {process.returncode}: {error}")
                lost += process.returncode != 0
        if done(run) != run.tiling.count:
            sys.exit("two clusters on one folder: tiles are missing")
        compared += trial.compared(run.path)
    return f"{rounds} folders finished by two clusters, {lost} of them by one after the other's scheduler was killed, {compared} bytes equal"
