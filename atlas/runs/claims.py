"""Claims, by which processes that share a run without a server divide its work."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread

from ..process import is_running, process_name
from ..store.place import Place

SUFFIX = ".claim"  # of the name of a claimed tile
POLL = 0.5  # seconds between two attempts to claim
# Seconds without a sign of life after which a claim expires, and between two signs of life of this process.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0
TAKEOVER = 0.2  # seconds until it is decided which of several processes has taken over an expired claim


def claim(place: Place, name: str) -> bool:
    """Whether this process has made a claim, or taken over an expired one."""
    process = process_name().encode()
    if place.create(name, process):
        return True
    if claimant(place, name):
        return False
    place.write(name, process, durable=False)
    time.sleep(TAKEOVER)
    with suppress(OSError):  # the process that wrote last may have released it
        return place.read(name) == process
    return False


def claimant(place: Place, name: str) -> str:
    """The process that holds a claim, unless it is this one, has ended, or has not renewed it for CLAIM_AGE: then an empty text."""
    with suppress(OSError, ValueError):  # it has been removed
        process = place.read(name).decode("ascii", "replace")
        if process != process_name() and is_running(process) is not False and place.age(name) <= CLAIM_AGE:
            return process or "a process that has just begun"
    return ""


@contextmanager
def held(place: Place, name: str) -> Iterator[None]:
    """Give signs of life for a claim while the context is open, and release it."""
    ended = Event()

    def keep() -> None:
        while not ended.wait(CLAIM_INTERVAL):
            with suppress(OSError):
                place.write(name, process_name().encode(), durable=False)

    thread = Thread(target=keep, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        with suppress(OSError):
            place.remove(name)


def claimants(place: Place) -> Iterator[tuple[str, str]]:
    """Names of the claims of a place and of its folders, each with its process, or with an empty text if the process has ended."""
    for name in place.walk():
        if name.endswith(SUFFIX):
            yield name, claimant(place, name)
