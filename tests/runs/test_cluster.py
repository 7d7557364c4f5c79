"""Runs on dask schedulers and workers in processes of their own, some of which are killed."""

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import distributed
import psutil
import pytest
from dask.base import get_scheduler
from truth import assert_same_bytes, state, tile_path

import atlas
from atlas import cli
from atlas.runs import cluster
from atlas.runs.run import RunFolder


def dask(*arguments, cwd, **variables):
    """A process of the `dask` command, its own group so that it can be killed whole."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *map(str, arguments), "--no-dashboard"], cwd=cwd, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ | variables,
    )  # fmt: skip


def kill(process):
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def start_scheduler(folder):
    """A process of a scheduler, and its address."""
    file = folder / f"scheduler{len(list(folder.glob('scheduler*')))}.json"
    # One death under a task is enough for dask to give the task up.
    process = dask(
        "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file, cwd=folder,
        DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0",
    )  # fmt: skip
    while True:
        time.sleep(0.05)
        with suppress(OSError, ValueError):
            return process, json.loads(file.read_text())["address"]


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Address of a scheduler for all tests that do not kill it."""
    process, address = start_scheduler(tmp_path_factory.mktemp("scheduler"))
    yield address
    kill(process)


@pytest.fixture
def servers(tmp_path):
    """Functions that start a scheduler, and a one-thread worker of an address; all end with the test."""
    processes = []

    def scheduler():
        process, address = start_scheduler(tmp_path)
        processes.append(process)
        return process, address

    def start_worker(address, **variables):
        arguments = "worker", address, "--nthreads", "1", "--no-nanny"
        processes.append(dask(*arguments, cwd=tmp_path, **variables))
        return processes[-1]

    yield scheduler, start_worker
    for process in reversed(processes):
        kill(process)


def client(folder, address, out="run/", **variables):
    """`atlas run` on a scheduler, in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "atlas", "run", "scene.toml", "-o", out, "--quiet", "--scheduler", address],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | variables,
    )  # fmt: skip


def run_here(address):
    """`atlas run` on a scheduler in this process and its working folder, which spares the imports; returns the exit code."""
    return cli.main(["run", "scene.toml", "-o", "run/", "--quiet", "--scheduler", address])


def wait_for_a_tile(run, process):
    while not len(run.tiles.written()) and process.poll() is None:
        time.sleep(0.02)


@pytest.mark.long
def test_a_run_survives_a_worker_that_is_killed_in_mid_tile(longer, servers, address, monkeypatch, capsys):
    """dask gives up what the worker had, and the tiles are sent again."""
    path, run, whole = longer
    monkeypatch.chdir(path)
    _, start_worker = servers
    first_worker = start_worker(address)

    def replace_worker():
        wait_for_a_tile(run, first_worker)
        kill(first_worker)
        start_worker(address)

    with ThreadPoolExecutor(1) as pool:
        replaced = pool.submit(replace_worker)
        assert run_here(address) == cli.DONE
        replaced.result()
    assert first_worker.returncode == -signal.SIGKILL
    assert "wrote run/" in capsys.readouterr().out
    assert len(state(run.tiles).done) == run.tiling.count
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


def kill_own_worker():
    """Wait for a process that `--workers` has started here, and kill it."""
    while True:
        for process in psutil.Process().children():
            with suppress(psutil.Error):
                if "spawn_main" in " ".join(process.cmdline()):
                    process.kill()
                    return
        time.sleep(0.02)


@pytest.mark.long
def test_a_nanny_replaces_a_worker_that_is_killed(longer, monkeypatch, capsys):
    path, run, whole = longer
    monkeypatch.chdir(path)

    def kill_after_a_tile():
        while not len(run.tiles.written()):
            time.sleep(0.02)
        kill_own_worker()

    with ThreadPoolExecutor(1) as pool:
        killed = pool.submit(kill_after_a_tile)
        assert cli.main(["run", "scene.toml", "-o", "run/", "--quiet", "--workers", "1"]) == cli.DONE
        killed.result()
    assert "wrote run/" in capsys.readouterr().out
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


def test_a_worker_that_ends_before_it_has_started_is_an_error_in_one_line(longer, monkeypatch, capsys):
    monkeypatch.chdir(longer[0])
    with ThreadPoolExecutor(1) as pool:
        killed = pool.submit(kill_own_worker)
        assert cli.main(["run", "scene.toml", "-o", "run/", "--quiet", "--workers", "1"]) == cli.FAILED
        killed.result()
    assert (
        capsys.readouterr().err == "atlas: failed: the dask workers did not start (Nanny failed to start.)\n"
    )


@pytest.mark.long
def test_a_run_that_loses_its_scheduler_fails_with_one_line_and_goes_on_with_another(
    longer, servers, address, monkeypatch
):
    path, run, whole = longer
    monkeypatch.chdir(path)
    start_scheduler, start_worker = servers
    scheduler, lost = start_scheduler()
    start_worker(lost)
    process = client(path, lost)
    wait_for_a_tile(run, process)
    kill(scheduler)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 1, errors
    assert errors == (
        "atlas: failed: the dask scheduler was lost; finished tiles are kept, and the same command continues with"
        " another scheduler\n"
    )
    kept = state(run.tiles)
    assert kept.done
    assert not kept.damaged
    start_worker(address)
    assert run_here(address) == cli.DONE
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


@pytest.mark.faults
def test_a_run_goes_on_after_kills_of_schedulers_clients_and_workers(longer, servers, fault_rounds):
    path, run, whole = longer
    start_scheduler, start_worker = servers
    rng = random.Random(4)
    scheduler, address = start_scheduler()
    worker = start_worker(address)
    for i in range(fault_rounds):
        tile_path(run.tiles, rng.randrange(18)).unlink(missing_ok=True)  # so that the run is never finished
        process = client(path, address)
        wait_for_a_tile(run, process)
        time.sleep(rng.uniform(0.0, 4.0))  # while it starts, connects or computes
        victim = ("scheduler", "client", "worker")[i % 3]
        if victim == "client":
            process.kill()
        else:
            kill(worker)
            if victim == "scheduler":
                kill(scheduler)
                scheduler, address = start_scheduler()
            worker = start_worker(address)
        _, errors = process.communicate(timeout=300)
        allowed = {"scheduler": (0, 1, 2), "client": (0, -signal.SIGKILL), "worker": (0,)}[victim]
        assert process.returncode in allowed, errors
        assert process.returncode <= 0 or (errors.startswith("atlas: ") and len(errors.splitlines()) == 1)
        assert not state(run.tiles).damaged
    process = client(path, address)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


@pytest.mark.faults
@pytest.mark.parametrize("lost", [False, True])
def test_two_clusters_finish_one_folder_even_where_one_loses_its_scheduler(longer, servers, lost):
    path, run, whole = longer
    start_scheduler, start_worker = servers
    clusters = [start_scheduler() for _ in range(2)]
    processes = []
    for _, address in clusters:
        start_worker(address)
        processes.append(client(path, address))
    if lost:
        wait_for_a_tile(run, processes[0])
        kill(clusters[0][0])
    for process in processes:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0 or (lost and "scheduler was lost" in errors), errors
    assert processes[1].returncode == 0
    assert_same_bytes(whole, atlas.open_atlas(path / "run"))


def swap_labels(package):
    """Exchange two labels in the code; the size of the file stays."""
    file = package / "measure" / "rates.py"
    names = {"REGULAR_PRECESSION": "PERMANENT_ROTATION", "PERMANENT_ROTATION": "REGULAR_PRECESSION"}
    text = file.read_text()
    swapped = re.sub("|".join(names), lambda match: names[match[0]], text)
    assert swapped != text
    file.write_text(swapped)


@pytest.mark.long
def test_a_worker_that_started_before_an_edit_is_refused(
    copied_package, servers, address, tmp_path, small_scene, monkeypatch
):
    folder, (package, variables) = tmp_path, copied_package
    (folder / "scene.toml").write_text(small_scene)
    monkeypatch.chdir(folder)
    _, start_worker = servers
    worker = start_worker(address, **variables)
    assert run_here(address) == cli.DONE  # the code here is still that of the copy
    swap_labels(package)
    second = client(folder, address, "second/", **variables)
    _, errors = second.communicate(timeout=300)
    assert second.returncode == 2, errors
    assert len(errors.splitlines()) == 1
    assert "rates.py was written after this process" in errors
    assert list((folder / "second" / "tiles").iterdir()) == []
    kill(worker)
    start_worker(address, **variables)
    third = client(folder, address, "second/", **variables)
    _, errors = third.communicate(timeout=300)
    assert third.returncode == 0, errors


@pytest.mark.long
def test_a_worker_of_another_copy_of_the_package_is_refused(
    copied_package, longer, servers, address, monkeypatch, capsys
):
    (folder, run, _), (package, variables) = longer, copied_package
    monkeypatch.chdir(folder)
    swap_labels(package)
    _, start_worker = servers
    start_worker(address, **variables)
    # The worker may come after the client has compared those that there are; its first tile is then refused.
    assert run_here(address) == cli.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(
        r"would compute other bits; .* It differs in code \([0-9a-f]{16} in the run, [0-9a-f]{16} in the worker\)$",
        line,
    )
    assert list(run.tiles.place.path.iterdir()) == []


def test_a_scheduler_with_tls_without_a_key_is_bad_input():
    with (
        pytest.raises(atlas.BadInput, match="the dask scheduler cannot be used: TLS expects"),
        cluster.connect("tls://127.0.0.1:1", None),
    ):
        pass
    assert get_scheduler() is None  # else the next computation would wait for it


def versions(scheduler="1.0", worker="1.0"):
    """As `Client.get_versions()` returns them."""

    def packages(version):
        return {"packages": {"python": "3.12.1", "dask": version, "distributed": version}}

    return {
        "client": packages("1.0"), "scheduler": packages(scheduler), "workers": {"tcp://w": packages(worker)},
    }  # fmt: skip


def a_client(reported_versions, answers=()):
    return SimpleNamespace(get_versions=lambda: reported_versions, run=lambda check, on_error: dict(answers))


def test_versions_of_dask_and_answers_of_workers_are_compared_when_a_run_connects():
    cluster.check_workers(a_client(versions(), {"tcp://w": None}), print, ())
    with pytest.raises(
        atlas.BadInput, match=r"the scheduler has dask 2\.0 and this process 1\.0, the scheduler has d"
    ):
        cluster.check_workers(a_client(versions(scheduler="2.0")), print, ())
    with pytest.raises(atlas.BadInput, match=r"worker tcp://w has dask 0\.9 and this process 1\.0"):
        cluster.check_workers(a_client(versions(worker="0.9")), print, ())
    with pytest.raises(atlas.BadInput, match=r"^differs$"):
        cluster.check_workers(a_client(versions(), {"tcp://w": atlas.BadInput("differs")}), print, ())
    with pytest.raises(atlas.BadInput, match="worker tcp://w: ModuleNotFoundError: No module"):
        cluster.check_workers(
            a_client(versions(), {"tcp://w": ModuleNotFoundError("No module named 'atlas'")}), print, ()
        )
    died = {"tcp://w": OSError("its connection is closed")}  # whatever it had is sent to the others
    cluster.check_workers(a_client(versions(), died), print, ())


LISTENING = """
import os

import psutil
from atlas.runs import cluster

if __name__ == "__main__":
    with cluster.connect(None, 1) as client:
        client.submit(int, 1).result()
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        sockets = [c for each in processes for c in each.net_connections("inet") if c.status == "LISTEN"]
        ports = {each.laddr.port for each in sockets}
        print(*sorted({each.laddr.ip for each in sockets}), len(ports) >= 2, 8787 in ports)
        print(*(client.submit(os.environ.get, name).result() for name in (*cluster.ALLOCATOR, "OMP_NUM_THREADS")))
"""


@pytest.mark.long
def test_worker_processes_on_this_machine_listen_to_this_machine_only_and_keep_freed_memory(tmp_path):
    (tmp_path / "listening.py").write_text(LISTENING)
    done = subprocess.run(
        [sys.executable, "listening.py"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300,
        env=os.environ | {"PYTHONPATH": str(Path(atlas.__file__).parents[1])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["127.0.0.1 True False", "268435456 33554432 1"]
    assert done.stderr == ""


def test_a_task_under_which_workers_die_is_sent_again_a_few_times():
    killed = SimpleNamespace(status="error", exception=lambda: distributed.KilledWorker("task", None, 0))
    for attempt in range(1, cluster.MAX_ATTEMPTS):
        assert not cluster._has_result(killed, attempt)
    with pytest.raises(OSError, match="workers died while they computed the same tile, 3 times"):
        cluster._has_result(killed, cluster.MAX_ATTEMPTS)
    failed = SimpleNamespace(status="error", exception=lambda: atlas.BadInput("a task's own error"))
    with pytest.raises(atlas.BadInput, match="own error"):
        cluster._has_result(failed, 1)


def test_worker_processes_on_this_machine_give_the_same_atlas(longer, monkeypatch, capfd):
    path, _, whole = longer
    monkeypatch.chdir(path)
    assert cli.main(["run", "scene.toml", "-o", "run/", "--workers", "2", "--quiet"]) == cli.DONE
    assert capfd.readouterr().err == ""
    ds = atlas.open_atlas(path / "run")
    assert_same_bytes(whole, ds)
    assert "by dask workers" in ds.attrs["atlas_run"]
    RunFolder.open(path / "run").join(path / "joined.nc")
    with atlas.open_atlas(path / "joined.nc") as joined:
        assert_same_bytes(whole, joined)
    monkeypatch.setattr(cluster, "connect", None)  # no worker starts where no tile is missing
    assert cli.main(["run", "scene.toml", "-o", "run/", "--workers", "2", "--quiet"]) == cli.DONE


def test_a_server_that_is_no_scheduler_is_refused_after_the_timeout(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    with (
        socket.create_server(("127.0.0.1", 0)) as other_server,
        pytest.raises(atlas.BadInput, match=r"no scheduler answers at this address \(timed out\)"),
    ):
        cluster.check(f"tcp://127.0.0.1:{other_server.getsockname()[1]}")


def test_examples_of_the_documentation_that_need_a_cluster_have_valid_syntax():
    text = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text()
    scripts = re.findall(r"^```bash\n(.*?)^```", text, re.M | re.S)
    assert len(scripts) == 4
    for script in scripts:
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
    (example,) = re.findall(r"^```py\n(.*?)^```", text, re.M | re.S)
    compile(example, "example", "exec")
