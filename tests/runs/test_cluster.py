"""Many machines: real dask schedulers and workers in processes of their own, killed in mid-tile."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_folder import same

import atlas
from atlas.runs import cluster
from atlas.runs.folder import RunFolder


def dask(*arguments, cwd):
    """A process of the `dask` command, its own group so that it can be killed whole."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *map(str, arguments)], cwd=cwd, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.fixture
def scheduler(tmp_path):
    """Address of a scheduler, and a function that starts one-thread workers; all end with the test."""
    process = dask("scheduler", "--port", "0", "--no-dashboard", cwd=tmp_path)
    for line in process.stderr:
        if found := re.search(r"Scheduler at:\s+(tcp://\S+)", line):
            break
    started = [process]

    def worker():
        started.append(dask("worker", found[1], "--nthreads", "1", "--no-dashboard", cwd=tmp_path))
        return started[-1]

    yield found[1], worker
    for each in reversed(started):
        if each.poll() is None:
            os.killpg(each.pid, signal.SIGKILL)
        each.communicate()


def test_a_scheduler_whose_workers_are_killed_in_mid_tile(longer, scheduler):
    path, run, whole = longer
    address, worker = scheduler
    workers = [worker(), worker()]
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "run/", "--quiet", "--scheduler", address],
        cwd=path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not run.survey().done and process.poll() is None:
        time.sleep(0.05)
    os.killpg(workers[0].pid, signal.SIGKILL)
    worker()
    out, complaint = process.communicate(timeout=90)
    assert process.returncode == 0, complaint
    assert "wrote run/" in out
    assert len(run.survey().done) == run.tiling.count
    same(whole, atlas.open_atlas(path / "run"))


def test_processes_on_this_machine_make_the_same_file(longer):
    path, _, whole = longer
    done = subprocess.run(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "run/", "--workers", "2", "--quiet"],
        cwd=path, capture_output=True, text=True, check=False, timeout=90,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    ds = atlas.open_atlas(path / "run")
    same(whole, ds)
    assert "by dask workers" in ds.attrs["atlas_run"]
    RunFolder.open(path / "run").join(path / "joined.nc")
    with atlas.open_atlas(path / "joined.nc") as joined:
        same(whole, joined)


def test_something_else_at_the_address_is_told_within_seconds(monkeypatch):
    import socket

    monkeypatch.setattr(cluster, "CONNECT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        began = time.monotonic()
        with pytest.raises(atlas.BadInput, match="no scheduler answers"):
            cluster.check(f"tcp://127.0.0.1:{silent.getsockname()[1]}")
        assert time.monotonic() - began < 5


def test_the_examples_that_no_test_can_run_are_at_least_sound():
    text = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text()
    scripts = re.findall(r"^```bash\n(.*?)^```", text, re.M | re.S)
    assert len(scripts) == 2
    for script in scripts:
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
    (example,) = re.findall(r"^```py\n(.*?)^```", text, re.M | re.S)
    compile(example, "example", "exec")
