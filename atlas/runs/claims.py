"""Claims, by which processes that share a run without a server divide its work."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Event, Thread

from ..files import is_recent
from ..process import PROCESS_NAME, is_running, process_name
from ..store.place import Place

SUFFIX = ".claim"  # of the name of a claimed tile
POLL = 0.5  # seconds between two attempts to claim
# Seconds without a sign of life after which a claim expires, and between two signs of life of this process.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0
NAMELESS_AGE = 10.0  # seconds after which a claim that names no process, as a full disk left it, expires
NAMED_AFTER = 5.0  # seconds of waiting after which a line says for whom
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
        if process != process_name() and is_running(process) is not False:
            is_named = PROCESS_NAME.fullmatch(process)
            if is_recent(place.age(name), CLAIM_AGE if is_named else NAMELESS_AGE):
                return process if is_named else "a process that has just begun"
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


def named(process: str, hosts: Mapping[str, str]) -> str:
    """A process as messages name it, with its host where that is known."""
    match = PROCESS_NAME.fullmatch(process)
    return f"{f'process {match[3]}' if match else process} on {hosts.get(process, 'this or another machine')}"


class Wait:
    """The wait for a claim, about which a line is logged once it has been long; `hosts`: of processes, as far as they are known."""

    def __init__(self, place: Place, hosts: Callable[[], Mapping[str, str]] = dict):
        self.place, self.hosts, self.due = place, hosts, time.monotonic() + NAMED_AFTER

    def announce(self, name: str) -> None:
        """Say once, after NAMED_AFTER, for whom."""
        if time.monotonic() >= self.due and (process := claimant(self.place, name)):
            self.due = math.inf
            logging.getLogger("atlas").warning(
                "%s: waits for %s, which holds %s; this claim expires %.0f s after its last sign of life",
                self.place, named(process, self.hosts()), name, CLAIM_AGE,
            )  # fmt: skip
