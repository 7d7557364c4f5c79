"""Tasks on many machines by dask.distributed: bounded in flight, tried again when a worker dies."""

from __future__ import annotations

import logging
import socket
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import BadInput

CONNECT = 5.0  # seconds to wait for a scheduler
PATIENCE = 60.0  # seconds without a worker before saying so
# Tasks in flight for each thread of the workers: the next is there when one ends.
TASKS_PER_THREAD = 2
# dask gives a task up when four workers died under it; it is then sent again so many times.
ATTEMPTS = 3


def check(scheduler: str) -> None:
    """Raise BadInput unless a dask scheduler answers at the address."""
    from distributed.comm.addressing import parse_address, parse_host_port

    try:
        scheme, place = parse_address(scheduler)
        with socket.create_connection(parse_host_port(place), CONNECT) as found:
            # A dask server speaks first; its own client would wait for ever for another one to do so.
            if scheme == "tcp" and not found.recv(1):
                raise OSError("something else is there")
    except (OSError, ValueError) as error:
        raise BadInput(f"--scheduler {scheduler}: no scheduler answers there ({_one_line(error)})") from None


@contextmanager
def client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of so many one-thread processes on this machine."""
    import distributed

    if scheduler is not None:
        with distributed.Client(scheduler) as found:
            yield found
        return
    cluster = distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, memory_limit=None,
        dashboard_address=":0", silence_logs=logging.CRITICAL,
    )  # fmt: skip
    with cluster, distributed.Client(cluster) as found:
        yield found


def each(
    found: Any, task: Callable[..., Any], arguments: Iterable[tuple[Any, ...]], done: Callable[[Any], None]
) -> None:
    """Call task(*a) on the workers for each of the arguments, and done(result) here as they end.

    The task must be harmless to run twice. Raises what a task raised, KilledWorker if workers kept
    dying under one, OSError if the scheduler is lost.
    """
    from distributed import KilledWorker, wait

    source = iter(arguments)
    waiting: dict[Any, tuple[tuple[Any, ...], int]] = {}
    exhausted, seen, told = False, time.monotonic(), False

    def submit(some: tuple[Any, ...], attempt: int) -> None:
        future = found.submit(task, *some, key=f"atlas-{uuid.uuid4().hex}", pure=False)
        waiting[future] = some, attempt

    try:
        while not exhausted or waiting:
            threads = sum(found.nthreads().values())
            if threads:
                seen, told = time.monotonic(), False
            elif time.monotonic() - seen > PATIENCE and not told:
                told = True
                logging.getLogger("atlas").warning("no dask worker for %.0f s: still waiting", PATIENCE)
            while not exhausted and len(waiting) < max(TASKS_PER_THREAD * threads, 1):
                some = next(source, None)
                if some is None:
                    exhausted = True
                else:
                    submit(some, 1)
            if not waiting:
                break
            try:
                ended = wait(list(waiting), timeout=5.0, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                continue
            for future in ended:
                some, attempt = waiting.pop(future)
                if future.status == "finished":
                    done(future.result())
                elif future.status == "error":
                    error = future.exception()
                    if not isinstance(error, KilledWorker) or attempt == ATTEMPTS:
                        raise error
                    submit(some, attempt + 1)
                else:
                    raise OSError(f"the dask scheduler lost a task ({future.status})")
    finally:
        for future in waiting:
            future.cancel()


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
