"""SIGINT (Ctrl-C) and SIGTERM: the command ends in order, and soon."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from pathlib import Path
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130  # exit code
MESSAGE = "atlas: interrupted; finished work is kept, and no file is half written"
# Seconds after a signal when the process ends, in order or not: compilers do not react to exceptions.
PATIENCE = 1.2
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_process(*_: object) -> None:
    """End the process at once with the exit code of an interruption. Files appear whole by a move, so none is harmed."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(INTERRUPTED)


def is_command() -> bool:
    """Whether this process is the command `atlas`, and no process that it started."""
    if parent_process() is not None:
        return False
    name = Path(sys.argv[0]).stem if getattr(sys, "argv", None) else ""
    return name in ("atlas", "precession-atlas") or sys.orig_argv[1:3] == ["-m", "atlas"]


def end_on_signal() -> None:
    """Let a signal end the process while it imports: there is nothing to keep, and a traceback would help nobody."""
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, end_process)


def exit_process(code: int) -> NoReturn:
    """Exit with the code of a command that has ended: no signal that comes now changes it.

    After a KeyboardInterrupt, also one that was handled, Python may end itself with SIGINT instead.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if code == INTERRUPTED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


@contextmanager
def signals_as_interrupt() -> Iterator[None]:
    """Make SIGINT and SIGTERM raise KeyboardInterrupt, and end the process if it goes on for PATIENCE or at a second one.

    A signal that the process was started to ignore stays ignored. Does nothing outside the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    timers: list[threading.Timer] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        if timers:
            end_process()
        else:
            timer = threading.Timer(PATIENCE, end_process)
            timer.daemon = True
            timer.start()
            timers.append(timer)
        raise KeyboardInterrupt

    previous = {number: signal.getsignal(number) for number in SIGNALS}
    replaced = [number for number, handler in previous.items() if handler is not signal.SIG_IGN]
    for number in replaced:
        signal.signal(number, interrupt)
    try:
        yield
    except Exception:  # libraries turn a KeyboardInterrupt into errors of their own
        if timers:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number in replaced:
            signal.signal(number, previous[number])
        for timer in timers:
            timer.cancel()
