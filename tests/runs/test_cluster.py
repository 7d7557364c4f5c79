"""Runs on dask schedulers and workers in processes of their own, some of which are killed."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from truth import assert_same_bytes

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
        if match := re.search(r"Scheduler at:\s+(tcp://\S+)", line):
            address = match[1]
            break
    processes = [process]

    def start_worker():
        processes.append(dask("worker", address, "--nthreads", "1", "--no-dashboard", cwd=tmp_path))
        return processes[-1]

    yield address, start_worker
    for process in reversed(processes):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_a_run_survives_a_worker_that_is_killed_in_mid_tile(longer, scheduler):
    path, run, whole = longer
    address, start_worker = scheduler
    first_worker, _ = start_worker(), start_worker()
    process = subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "run/", "--quiet", "--scheduler", address],
        cwd=path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not run.tiles.status().done and process.poll() is None:
        time.sleep(0.05)
    os.killpg(first_worker.pid, signal.SIGKILL)
    start_worker()
    printed, errors = process.communicate(timeout=90)
    assert process.returncode == 0, errors
    assert "wrote run/" in printed
    assert len(run.tiles.status().done) == run.tiling.count
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


def test_a_result_that_died_with_its_worker_is_computed_again_and_a_lost_scheduler_is_an_error():
    assert cluster._succeeded(SimpleNamespace(status="finished"), 1)
    assert not cluster._succeeded(SimpleNamespace(status="lost"), cluster.MAX_ATTEMPTS)
    with pytest.raises(OSError, match="scheduler lost a task"):
        cluster._succeeded(SimpleNamespace(status="cancelled"), 1)


def test_worker_processes_on_this_machine_give_the_same_atlas(longer):
    path, _, whole = longer
    done = subprocess.run(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", "run/", "--workers", "2", "--quiet"],
        cwd=path, capture_output=True, text=True, check=False, timeout=90,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    ds = atlas.open_atlas(path / "run")
    assert_same_bytes(whole, ds)
    assert "by dask workers" in ds.attrs["atlas_run"]
    RunFolder.open(path / "run").join(path / "joined.nc")
    with atlas.open_atlas(path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)


def test_a_server_that_is_no_scheduler_is_refused_after_the_timeout(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    with (
        socket.create_server(("127.0.0.1", 0)) as other_server,
        pytest.raises(atlas.BadInput, match="no scheduler answers"),
    ):
        cluster.check(f"tcp://127.0.0.1:{other_server.getsockname()[1]}")


def test_examples_of_the_documentation_that_need_a_cluster_have_valid_syntax():
    text = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text()
    scripts = re.findall(r"^```bash\n(.*?)^```", text, re.M | re.S)
    assert len(scripts) == 2
    for script in scripts:
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
    (example,) = re.findall(r"^```py\n(.*?)^```", text, re.M | re.S)
    compile(example, "example", "exec")
