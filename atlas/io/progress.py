"""Progress of a run: one live line on a terminal, a plain line now and then elsewhere, and a file."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

PLAIN_EVERY = 10.0  # seconds between two plain lines
LIVE_EVERY = 0.2
FILE_EVERY = 2.0


class Progress:
    """Counts points from any thread; tells points per second and the time left.

    points: all there are; done: those of earlier runs. show: print to `stream` (default stderr). file:
    a JSON file kept up to date, which holds `facts` as well; losing it loses nothing.
    """

    def __init__(
        self,
        points: int,
        stream: TextIO | None = None,
        *,
        done: int = 0,
        show: bool = True,
        file: Path | None = None,
        facts: Mapping[str, Any] | None = None,
    ):
        self.points = points
        self.show = show
        self.stream = sys.stderr if stream is None else stream
        self.live = self.stream.isatty()
        self.file = file
        self.facts = dict(facts or {})
        self.began = time.perf_counter()
        self._printed = self._filed = self.began
        self._before = self._done = float(done)
        self._lock = threading.Lock()
        if file is not None:
            self._write(self.began, running=True)

    def advance(self, points: float) -> None:
        """Add finished points (fractions too: a tile reports as its blocks end)."""
        with self._lock:
            self._done = min(self._done + points, self.points)
            now = time.perf_counter()
            if self.show and now - self._printed >= (LIVE_EVERY if self.live else PLAIN_EVERY):
                self._printed = now
                self._print(now)
            if self.file is not None and now - self._filed >= FILE_EVERY:
                self._filed = now
                self._write(now, running=True)

    def skip(self, points: float) -> None:
        """Take points as done that cost this process nothing."""
        with self._lock:
            self._before += points
            self._done += points

    def _speed(self, now: float) -> tuple[float, float]:
        """Points per second, seconds left."""
        speed = (self._done - self._before) / max(now - self.began, 1e-9)
        return speed, (self.points - self._done) / speed if speed > 0 else 0.0

    def _print(self, now: float) -> None:
        speed, left = self._speed(now)
        text = (
            f"{100 * self._done / self.points:5.1f} %  {self._done:.0f} of {self.points} points"
            f"  {speed:.3g} points/s  {clock(left)} left"
        )
        self.stream.write(f"\r{text}\x1b[K" if self.live else f"{text}\n")
        self.stream.flush()

    def _write(self, now: float, running: bool) -> None:
        assert self.file is not None
        speed, left = self._speed(now)
        found = self.facts | {
            "points": self.points,
            "done": round(self._done),
            "points_per_second": speed,
            "seconds_left": left,
            "running": running,
            "written": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        }
        temporary = self.file.with_name(f".{self.file.name}.{os.getpid()}.tmp")
        with suppress(OSError):  # a full disk is the business of who writes the tiles
            try:
                temporary.write_text(json.dumps(found, indent=1))
                os.replace(temporary, self.file)
            finally:
                temporary.unlink(missing_ok=True)

    def close(self) -> None:
        """Clear the live line and say in the file that this process has ended."""
        if self.show and self.live:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
        if self.file is not None:
            self._write(time.perf_counter(), running=False)


def clock(seconds: float) -> str:
    """Seconds as 1:02:03 or 2:03."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{secs:02d}" if hours else f"{minutes}:{secs:02d}"
