"""Claims: what processes that share a run without a server tell each other, so that none computes what another one does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from ..process import is_running, process_name
from ..store.place import Place
from ..store.tile import Tiles

SUFFIX = ".claim"  # of the name of a tile that a process computes
POLL = 0.5  # seconds between two attempts to claim
# Seconds without a sign of life after which a claim expires, and between two signs of life of this process.
CLAIM_AGE, CLAIM_INTERVAL = 180.0, 20.0


def claim(place: Place, name: str) -> bool:
    """Whether this process may do what a content stands for: it creates the content, or takes over one that expired."""
    process = process_name().encode()
    if place.create(name, process):
        return True
    if claimant(place, name):
        return False
    place.write(name, process, durable=False)
    return True


def claimant(place: Place, name: str) -> str:
    """Another process that made a claim and is at work: as far as is known it runs, and it renewed the claim of late; or nothing."""
    with suppress(OSError, ValueError):  # it has been removed
        process = place.read(name).decode("ascii", "replace")
        if process != process_name() and is_running(process) is not False and place.age(name) <= CLAIM_AGE:
            return process or "a process that has just begun"
    return ""


@contextmanager
def held(tiles: Tiles, tile: int, advance: Callable[[float], None]) -> Iterator[Callable[[float], None]]:
    """Keep the claim of a tile while it is computed, by calls of what this gives in place of `advance`, and release it."""
    name, renewed = tiles.name(tile, SUFFIX), time.monotonic()

    def keep(points: float) -> None:
        nonlocal renewed
        if time.monotonic() - renewed > CLAIM_INTERVAL:
            renewed = time.monotonic()
            with suppress(OSError):
                tiles.place.write(name, process_name().encode(), durable=False)
        advance(points)

    try:
        yield keep
    finally:
        with suppress(OSError):
            tiles.place.remove(name)


def claimants(place: Place) -> dict[str, str]:
    """The process that made each claim of a place, also in folders inside, by the name of the claim; none if it is gone."""
    return {name: claimant(place, name) for name in place.walk() if name.endswith(SUFFIX)}
