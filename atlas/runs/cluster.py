"""Tasks on many machines by dask.distributed. Few tasks are submitted at a time. A task is repeated if its worker dies."""

from __future__ import annotations

import logging
import math
import socket
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, nullcontext, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any

from ..errors import BadInput, one_line

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_TIMEOUT = 5.0  # seconds to wait for a scheduler
POLL_INTERVAL = 5.0  # seconds between two counts of the workers
NO_WORKER_WARNING = 60.0  # a warning is logged after this number of seconds without a worker
TASKS_PER_THREAD = 2  # submitted tasks for each thread, enough that no thread waits for a task
# Workers of `connect` keep freed memory for reuse. With dask's default, 65536 bytes, every large temporary array is mapped anew.
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": 2**28, "MALLOC_MMAP_THRESHOLD_": 2**25}
MAX_ATTEMPTS = 3  # number of times that a task is submitted if dask gives up because workers died
SCHEDULER_LOST = "the dask scheduler was lost; finished tiles are kept, and the same command continues with another scheduler"


def check(scheduler: str) -> None:
    """Raise BadInput unless a dask scheduler answers at the address."""
    from distributed.comm.addressing import parse_address, parse_host_port

    try:
        scheme, address = parse_address(scheduler)
        with socket.create_connection(parse_host_port(address), CONNECT_TIMEOUT) as connection:
            # A dask server sends first. The client of dask would wait for ever for another kind of server.
            if scheme == "tcp" and not connection.recv(1):
                raise OSError("this is no dask server")
    except (OSError, ValueError) as error:
        reason = one_line(error) or type(error).__name__
        raise BadInput(f"--scheduler {scheduler}: no scheduler answers at this address ({reason})") from None


@contextmanager
def connect(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """Connect to a scheduler, or to local one-thread processes. Raise OSError if the scheduler is lost, BadInput for wrong TLS settings."""
    import dask
    import distributed
    from distributed.comm.core import CommClosedError
    from distributed.utils import silence_logging_cmgr
    from distributed.versions import VersionMismatchWarning

    environment = {f"distributed.nanny.pre-spawn-environ.{name}": size for name, size in ALLOCATOR.items()}
    try:
        with dask.config.set(environment):
            cluster: Any = nullcontext(scheduler) if scheduler else distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, memory_limit=None,
                host="127.0.0.1", dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )  # fmt: skip
    except RuntimeError as error:  # a process ended during its start
        raise OSError(f"the dask workers did not start ({one_line(error)})") from None
    with cluster as server, silence_logging_cmgr(logging.CRITICAL):  # dask logs the errors raised here
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", VersionMismatchWarning)  # see `check_workers`
                # If this client were the default of the session, it would stay the default after a failure.
                client = distributed.Client(server, set_as_default=False)
        except (TypeError, RuntimeError) as error:  # wrong settings of TLS
            raise BadInput(f"the dask scheduler cannot be used: {one_line(error)}") from None
        except OSError:
            raise OSError(SCHEDULER_LOST) from None
        try:
            with client, client.as_current():
                try:
                    yield client
                except OSError:
                    if client.status == "running":  # a task raised the error
                        raise
                    raise OSError(SCHEDULER_LOST) from None
        except (CancelledError, CommClosedError):
            raise OSError(SCHEDULER_LOST) from None


def check_workers(client: Client, check: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Raise BadInput if a worker has another version of dask or fails `check`."""
    versions: Any = client.get_versions()
    servers = {"the scheduler": versions["scheduler"]}
    servers |= {f"worker {address}": info for address, info in versions["workers"].items()}
    expected = versions["client"]["packages"]
    different = ", ".join(
        f"{server} has {name} {info['packages'][name]} and this process {expected[name]}"
        for server, info in servers.items()
        for name in ("dask", "distributed")
        if info["packages"][name] != expected[name]
    )
    if different:
        raise BadInput(f"versions of dask must be the same everywhere: {different}")
    for worker, result in client.run(check, *arguments, on_error="return").items():
        if isinstance(result, BadInput):
            raise result
        if isinstance(result, Exception) and not isinstance(result, OSError):  # dead workers give OSError
            raise BadInput(f"worker {worker}: {type(result).__name__}: {one_line(result)}")


def for_each(
    client: Client,
    task: Callable[..., Any],
    arguments: Iterable[tuple[Any, ...]],
    on_result: Callable[[Any], None],
) -> None:
    """Call `task` on workers, perhaps repeatedly, for each tuple of arguments, and call `on_result` here with each result."""
    from distributed import wait

    source = iter(arguments)
    in_flight: dict[Future[Any], tuple[tuple[Any, ...], int]] = {}

    def submit(task_arguments: tuple[Any, ...], attempt: int) -> None:
        future = client.submit(task, *task_arguments, key=f"atlas-{uuid.uuid4().hex}", pure=False)
        in_flight[future] = task_arguments, attempt

    try:
        last_worker = time.monotonic()
        while True:
            threads = sum(client.nthreads().values())
            if threads:
                last_worker = time.monotonic()
            elif time.monotonic() - last_worker > NO_WORKER_WARNING:
                logging.getLogger("atlas").warning(
                    "no dask worker for %.0f s: still waiting", NO_WORKER_WARNING
                )
                last_worker = math.inf  # no second warning before a worker appears
            free = max(TASKS_PER_THREAD * threads, 1) - len(in_flight)
            for task_arguments in islice(source, max(free, 0)):
                submit(task_arguments, 1)
            if not in_flight:
                return
            ended: Iterable[Future[Any]] = []
            with suppress(TimeoutError):  # no task has ended within POLL_INTERVAL
                ended = wait(list(in_flight), timeout=POLL_INTERVAL, return_when="FIRST_COMPLETED").done
            for future in ended:
                task_arguments, attempt = in_flight.pop(future)
                if _has_result(future, attempt):
                    on_result(future.result())
                else:
                    submit(task_arguments, attempt + 1)
    finally:
        for future in in_flight:
            future.cancel()


def _has_result(future: Future[Any], attempt: int) -> bool:
    """Return whether a task has a result. Otherwise the task must be submitted again. Raise the error of a failed task."""
    from distributed import KilledWorker

    if future.status == "finished":
        return True
    if future.status == "lost":  # the worker died with the result
        return False
    if future.status != "error":
        raise OSError(f"the dask scheduler lost a task ({future.status})")
    error = future.exception()
    if not isinstance(error, KilledWorker):
        raise error
    if attempt == MAX_ATTEMPTS:
        raise OSError(f"dask workers died while they computed the same tile, {attempt} times in a row")
    return False
