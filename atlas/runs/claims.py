"""Claims on tiles, by which processes that share a run divide its work without a server."""

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

SUFFIX = ".claim"  # suffix of the name of a claim
POLL = 0.5  # seconds between two attempts to claim
# Seconds without a sign of life after which a claim expires; seconds between two signs of life.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0
NAMELESS_AGE = 10.0  # seconds after which a claim expires that names no process, because the disk was full
NAMED_AFTER = 5.0  # seconds of waiting after which a message names the process that is waited for
TAKEOVER = 0.2  # seconds after which the last of the processes that took over an expired claim holds it


def claim(place: Place, name: str) -> bool:
    """Make a claim, or take over an expired one, and return whether this process now holds it."""
    process = process_name().encode()
    if place.create(name, process):
        return True
    if claimant(place, name):
        return False
    place.write(name, process, durable=False)
    time.sleep(TAKEOVER)
    with suppress(OSError):  # the process that wrote last may have released the claim
        return place.read(name) == process
    return False


def claimant(place: Place, name: str) -> str:
    """Name of another process that holds a claim; empty if it has ended, or has not renewed the claim for CLAIM_AGE."""
    with suppress(OSError, ValueError):  # the claim has been removed
        process = place.read(name).decode("ascii", "replace")
        if process != process_name() and is_running(process) is not False:
            is_named = PROCESS_NAME.fullmatch(process)
            if is_recent(place.age(name), CLAIM_AGE if is_named else NAMELESS_AGE):
                return process if is_named else "a process that has just begun"
    return ""


@contextmanager
def held(place: Place, name: str) -> Iterator[None]:
    """Renew a claim while the context is open, and release it at the end."""
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
    """Names of all claims in a place and its folders, each with its `claimant`."""
    for name in place.walk():
        if name.endswith(SUFFIX):
            yield name, claimant(place, name)


def named(process: str, hosts: Mapping[str, str]) -> str:
    """Text for a process in messages, with its host if `hosts` has it."""
    match = PROCESS_NAME.fullmatch(process)
    return f"{f'process {match[3]}' if match else process} on {hosts.get(process, 'this or another machine')}"


class Wait:
    """A wait for a claim, with one log message if it is long; hosts: gives the known hosts, process -> host."""

    def __init__(self, place: Place, hosts: Callable[[], Mapping[str, str]] = dict):
        self.place, self.hosts, self.due = place, hosts, time.monotonic() + NAMED_AFTER

    def announce(self, name: str) -> None:
        """Log once, after NAMED_AFTER seconds, which process holds the claim."""
        if time.monotonic() >= self.due and (process := claimant(self.place, name)):
            self.due = math.inf
            logging.getLogger("atlas").warning(
                "%s: waits for %s, which holds %s; this claim expires %.0f s after its last sign of life",
                self.place, named(process, self.hosts()), name, CLAIM_AGE,
            )  # fmt: skip
