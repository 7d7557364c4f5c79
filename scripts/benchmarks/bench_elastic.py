"""Three jobs on one run, each killed several times at random moments and started again, in a folder and on an S3 server.

python scripts/benchmarks/bench_elastic.py [POINTS] [--kills 10] [--places folder s3] [--refined | --scene FILE]

Prints the time, the largest memory of a job, and whether all values equal those of an undisturbed run. Needs moto[s3], flask and
flask-cors.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np
import xarray as xr
from bench_scaling import scene

import atlas


def server() -> str:
    """Start an S3 server with a bucket, for this process and its children; returns the address of the server."""
    code = (
        "import sys; from moto.server import ThreadedMotoServer as S; s = S('127.0.0.1', 0, verbose=False); s.start();"
        "print('http://%s:%d' % s.get_host_and_port(), flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    address = next(line.strip() for line in process.stdout if line.startswith("http"))
    urllib.request.urlopen(urllib.request.Request(f"{address}/bucket", method="PUT")).close()
    names = {"ENDPOINT": address, "ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b", "REGION": "us-east-1"}
    os.environ |= {f"AWS_{name}": value for name, value in names.items()} | {"AWS_ALLOW_HTTP": "true"}
    return address


def run_with_kills(folder: Path, out: str, kills: int, jobs: int, pause: float) -> tuple[float, int, float]:
    """Time, number of kills and largest memory in MB of jobs that are killed about every `pause` seconds."""
    command = [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", out, "--threads", "1", "--quiet"]
    began, killed, memory, rng = time.perf_counter(), 0, 0.0, random.Random(0)
    remaining = dict.fromkeys(range(jobs), kills)
    running = dict[int, tuple[subprocess.Popen[bytes], float]]()
    while remaining:
        for job in remaining:
            if job not in running:
                process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
                running[job] = process, time.perf_counter() + rng.uniform(0.5, 1.5) * pause
        time.sleep(0.05)
        for job, (process, end) in list(running.items()):
            if remaining[job] and time.perf_counter() > end:
                os.kill(process.pid, signal.SIGKILL)
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if not pid:
                continue
            memory = max(memory, usage.ru_maxrss / 1024)
            process.returncode = os.waitstatus_to_exitcode(status)
            del running[job]
            if process.returncode == -9:
                killed, remaining[job] = killed + 1, remaining[job] - 1
            elif process.returncode == 0 or (out.endswith(".zarr") and process.returncode == 2):
                # 2: the job began after the store was finished
                del remaining[job]
            else:
                sys.exit(f"exit {process.returncode}")
    return time.perf_counter() - began, killed, memory


def equal(one: xr.Dataset, other: xr.Dataset) -> bool:
    """Whether all variables have the same bytes."""
    if one.variables.keys() != other.variables.keys():
        return False
    rows = 4_000_000 // max(one.label.size // one.label.shape[0], 1) + 1
    first = str(one.label.dims[0])
    for start in range(0, one.sizes[first], rows):
        parts = [ds.isel({first: slice(start, start + rows)}) for ds in (one, other)]
        for name in one.variables:
            a, b = (np.ascontiguousarray(part[name].values) for part in parts)
            if a.tobytes() != b.tobytes():
                return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("points", type=float, nargs="?", default=3e7)
    parser.add_argument("--kills", type=int, default=10, help="of each job")
    parser.add_argument("--jobs", type=int, default=3)
    parser.add_argument("--pause", type=float, default=10.0, help="mean seconds of a job before it is killed")
    parser.add_argument("--places", nargs="+", choices=("folder", "store", "s3"), default=("folder", "s3"))
    parser.add_argument("--refined", action="store_true")
    parser.add_argument("--scene", type=Path, help="of its own, instead of so many POINTS (default 3e7)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        size = int(options.points)
        case = scene(folder, size, duration=1.0)  # short, so that the cost is in points, not in steps
        if options.scene:
            (folder / "scene.toml").write_text(options.scene.read_text())
        elif options.refined:
            side = int(size**0.5) // 16 + 1  # of the coarse grid, before four levels
            text = (
                (folder / "scene.toml").read_text().replace(f"count = {case.shape[0]}", f"count = {side}", 1)
            )
            text = text.replace(f"count = {case.shape[1]}", f"count = {side}", 1) + "[refine]\nlevels = 4\n"
            (folder / "scene.toml").write_text(text)
        began = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "whole/", "--quiet"],
            cwd=folder, check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        print(f"whole run: {time.perf_counter() - began:.0f} s", flush=True)
        if "s3" in options.places:
            server()
        outs = {"folder": "night/", "store": "night.zarr", "s3": "s3://bucket/night/"}
        for place in options.places:
            seconds, killed, memory = run_with_kills(
                folder, outs[place], options.kills, options.jobs, options.pause
            )
            path = outs[place] if place == "s3" else folder / outs[place]
            with atlas.open_atlas(folder / "whole") as one, atlas.open_atlas(path) as other:
                verdict = "equal" if equal(one, other) else "DIFFERENT"
                print(
                    f"{place}: {other.label.size} points, {seconds:.0f} s, {killed} kills, {memory:.0f} MB, {verdict}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
