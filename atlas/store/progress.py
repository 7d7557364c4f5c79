"""The progress of a run, shown by a live line on a terminal, by plain lines elsewhere, and by a JSON file."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field
from datetime import UTC, datetime
from typing import Any

from ..files import is_recent
from ..kernel import compiling
from ..process import is_running, process_name

# Seconds between two plain lines, between two updates of the live line, and between two writes of the progress file.
PLAIN_INTERVAL = 10.0
LIVE_INTERVAL = 0.2
FILE_INTERVAL = 2.0
# A process on another machine counts as dead if it has written no progress for this many seconds.
SILENCE = 600.0
# The time left is shown after this fraction of the points, or after this many seconds of computing.
KNOWN_SHARE, KNOWN_TIME = 0.05, 60.0
AT_WORK, ENDED = "at work", "ended"


@dataclass(eq=False)
class Progress:
    """A counter of the points that all threads have finished. The reported speed leaves out the time for compilation of kernels."""

    points: int
    _: KW_ONLY
    show: bool = True
    save: Callable[[bytes], object] | None = None  # writes JSON for users, which no computation reads
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.stream, self.live = sys.stderr, sys.stderr.isatty()
        self.stopwatch, self._lock = compiling.Stopwatch(), threading.Lock()
        self._last_print = self._last_save = time.perf_counter()
        self._done_at_no_cost = self._done = 0.0
        if self.show:
            compiling.announce(+1)
        self._save(running=True)

    def add(self, points: int, done: int) -> None:
        """Add points to the total. Of these points, `done` are already finished."""
        self.points += points
        self.skip(done)
        self._save(running=True)

    def advance(self, points: float) -> None:
        """Count points as finished. `points` may be a fraction, because partly integrated points count in part."""
        with self._lock:
            self._done = min(
                self._done + float(points), self.points
            )  # Studies give numbers of NumPy, which `float` converts.
            now = time.perf_counter()
            if self.show and now - self._last_print >= (LIVE_INTERVAL if self.live else PLAIN_INTERVAL):
                self._last_print = now
                speed, seconds_left = self._speed()
                rest = f"{speed:.3g} points/s" if speed > 0 else "starting"
                if self._done >= KNOWN_SHARE * self.points or self.stopwatch.seconds() >= KNOWN_TIME:
                    rest += f"  {clock(seconds_left)} left" * (speed > 0)
                share = 100 * self._done / self.points
                text = f"{share:5.1f} %  {self._done:.0f} of {self.points} points  {rest}"
                self.stream.write(f"\r{text}\x1b[K" if self.live else f"{text}\n")
                self.stream.flush()
            if now - self._last_save >= FILE_INTERVAL:
                self._last_save = now
                self._save(running=True)

    def skip(self, points: float) -> None:
        """Raise the number of finished points by points that were not computed here. The speed leaves them out."""
        with self._lock:
            self._done_at_no_cost += points
            self._done += points

    def close(self) -> None:
        """Clear the live line, and save in the file that the process has ended."""
        if self.show:
            compiling.announce(-1)
            if self.live:
                self.stream.write("\r\x1b[K")
                self.stream.flush()
        self._save(running=False)
        self.show, self.save = False, None

    def _speed(self) -> tuple[float, float]:
        """Return the points per second, and the seconds left."""
        speed = (self._done - self._done_at_no_cost) / max(self.stopwatch.seconds(), 1e-9)
        return speed, (self.points - self._done) / speed if speed > 0 else 0.0

    def _save(self, *, running: bool) -> None:
        if self.save is None:
            return
        (speed, seconds_left), done = self._speed(), min(round(self._done), self.points)
        content = {
            **self.facts, "points": self.points, "done": done, "points_per_second": speed, "seconds_left": seconds_left,
            "running": running, "process": process_name(), "written": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        }  # fmt: skip
        # If the disk is full, writing a tile fails with a better message.
        with suppress(OSError):
            self.save(json.dumps(content, indent=1).encode())


def state(content: Mapping[str, Any], age: Callable[[], float]) -> str:
    """Return AT_WORK, or how the writer of a progress file ended. The age of the file decides for a writer on another machine."""
    if not content["running"]:
        return ENDED
    running = is_running(str(content["process"]))
    if running is None and not is_recent(age(), SILENCE):
        return f"no progress for more than {SILENCE / 60:.0f} minutes"
    return "died" if running is False else AT_WORK


def clock(seconds: float) -> str:
    """Return a time in seconds as a text such as 1:02:03 or 2:03. Times above 1e9 seconds are shown as 1e9 seconds."""
    minutes, rest = divmod(round(min(seconds, 1e9)), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}" if minutes >= 60 else f"{minutes}:{rest:02d}"
