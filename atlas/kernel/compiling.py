"""Time that this process spends on compiling kernels, which measured speeds exclude. This module imports no compiler."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ANNOUNCEMENT = "compiling these equations to machine code, which later runs use again: about 10 s, more on a busy machine"

_lock = threading.Lock()
_finished = 0.0  # seconds of all finished compilations
_began: float | None = None  # start of the running compilation; there is only one at a time
_announcers = 0


@contextmanager
def compilation() -> Iterator[None]:
    """Context in which one kernel is compiled, which measures the time and announces it."""
    global _began, _finished
    with _lock:
        _began = time.perf_counter()
    say(ANNOUNCEMENT)
    try:
        yield
    finally:
        with _lock:
            _finished += time.perf_counter() - _began
            _began = None


def say(announcement: str) -> None:
    """Print a line on stderr if some part of the program asks for it."""
    if _announcers:
        clear_line = "\r\x1b[K" if sys.stderr.isatty() else ""
        print(f"{clear_line}{announcement}", file=sys.stderr, flush=True)


def announce(change: int) -> None:
    """Add 1 or -1 to the number of parts of the program that want a line on stderr when a kernel is compiled."""
    global _announcers
    with _lock:
        _announcers += change


@contextmanager
def announced(show: bool) -> Iterator[None]:
    """Context in which every kernel that is compiled is announced, if `show` is true."""
    announce(int(show))
    try:
        yield
    finally:
        announce(-int(show))


def _seconds(now: float) -> float:
    """Seconds of compilation in this process until now."""
    with _lock:
        return _finished + (now - _began if _began is not None else 0.0)


class Stopwatch:
    """Seconds since its start, without the time for compiling kernels."""

    def __init__(self) -> None:
        now = time.perf_counter()
        self._start = now - _seconds(now)

    def seconds(self) -> float:
        now = time.perf_counter()
        return now - _seconds(now) - self._start
