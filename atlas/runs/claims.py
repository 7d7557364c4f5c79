"""Claims on tiles, with which processes divide the work of a run without a server."""

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

SUFFIX = ".claim"
POLL = 0.5  # seconds between two attempts to claim
# A claim expires CLAIM_AGE seconds after the last sign of life. A process gives a sign of life every CLAIM_INTERVAL seconds.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0
NAMELESS_AGE = 10.0  # seconds until a claim without a process name, written on a full disk, expires
NAMED_AFTER = 5.0  # after a wait of this number of seconds, a message names the process with the claim
TAKEOVER = 0.2  # seconds that processes wait to see which of them took over an expired claim last


def claim(place: Place, name: str) -> bool:
    """Make a claim or take over an expired claim, and return whether this process now holds the claim."""
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
    """Return the name of another process that holds a claim, or "" if the process has ended or the claim has expired."""
    with suppress(OSError, ValueError):  # the claim may have been removed
        process = place.read(name).decode("ascii", "replace")
        if process != process_name() and is_running(process) is not False:
            is_named = PROCESS_NAME.fullmatch(process)
            if is_recent(place.age(name), CLAIM_AGE if is_named else NAMELESS_AGE):
                return process if is_named else "a process that has just begun"
    return ""


@contextmanager
def held(place: Place, name: str) -> Iterator[None]:
    """Renew a claim while the context is open, and release the claim at the end."""
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
    """Yield the name and the `claimant` of each claim in a place and its folders."""
    for name in place.walk():
        if name.endswith(SUFFIX):
            yield name, claimant(place, name)


def named(process: str, hosts: Mapping[str, str]) -> str:
    """Return the text for a process in messages, with the host if `hosts` contains the process."""
    match = PROCESS_NAME.fullmatch(process)
    return f"{f'process {match[3]}' if match else process} on {hosts.get(process, 'this or another machine')}"


class Wait:
    """A wait for a claim, with one log message if the wait is long. `hosts` returns the known hosts by process."""

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
