"""Time that this process spends on compiling kernels. Measured speeds exclude this time. The module imports no compiler."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ANNOUNCEMENT = "compiling these equations to machine code, which later runs use again: about 10 s, more on a busy machine"

_lock = threading.Lock()
_finished = 0.0  # seconds of all finished compilations
_began: float | None = None  # start of the running compilation; only one runs at a time
_announcers = 0


@contextmanager
def compilation() -> Iterator[None]:
    """Announce the compilation that runs in this context, and measure the time."""
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
    """Print a line on stderr if some part of the program wants announcements."""
    if _announcers:
        clear_line = "\r\x1b[K" if sys.stderr.isatty() else ""
        print(f"{clear_line}{announcement}", file=sys.stderr, flush=True)


def announce(change: int) -> None:
    """Add `change`, 1 or -1, to the number of parts of the program that want announcements."""
    global _announcers
    with _lock:
        _announcers += change


@contextmanager
def announced(show: bool) -> Iterator[None]:
    """Announce every compilation that runs in this context if `show` is true."""
    announce(int(show))
    try:
        yield
    finally:
        announce(-int(show))


def _seconds(now: float) -> float:
    """Return the seconds that this process has spent on compilations until `now`."""
    with _lock:
        return _finished + (now - _began if _began is not None else 0.0)


class Stopwatch:
    """Stopwatch that stands still while a kernel is compiled."""

    def __init__(self) -> None:
        now = time.perf_counter()
        self._start = now - _seconds(now)

    def seconds(self) -> float:
        now = time.perf_counter()
        return now - _seconds(now) - self._start
