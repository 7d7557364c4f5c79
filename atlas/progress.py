"""Progress of a run: one live line on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from typing import TextIO

PLAIN_EVERY = 10.0  # seconds between two plain lines
LIVE_EVERY = 0.2


class Progress:
    """Counts point-steps from any thread and prints points per second and the time left."""

    def __init__(self, points: int, stream: TextIO | None = None):
        self.points = points
        self.stream = sys.stderr if stream is None else stream
        self.live = self.stream.isatty()
        self.began = time.perf_counter()
        self._printed = self.began
        self._done = 0.0
        self._lock = threading.Lock()

    def advance(self, points: float) -> None:
        """Add finished points (fractions too: a tile reports as its blocks end)."""
        with self._lock:
            self._done += points
            now = time.perf_counter()
            if now - self._printed >= (LIVE_EVERY if self.live else PLAIN_EVERY):
                self._printed = now
                self._print(now)

    def _print(self, now: float) -> None:
        speed = self._done / (now - self.began)
        left = (self.points - self._done) / speed if speed > 0 else 0.0
        text = (
            f"{100 * self._done / self.points:5.1f} %  {self._done:.0f} of {self.points} points"
            f"  {speed:.3g} points/s  {clock(left)} left"
        )
        self.stream.write(f"\r{text}\x1b[K" if self.live else f"{text}\n")
        self.stream.flush()

    def close(self) -> None:
        """Clear the live line."""
        if self.live:
            self.stream.write("\r\x1b[K")
            self.stream.flush()


def clock(seconds: float) -> str:
    """Seconds as 1:02:03 or 2:03."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{secs:02d}" if hours else f"{minutes}:{secs:02d}"
