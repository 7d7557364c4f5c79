"""SIGINT (Ctrl-C) and SIGTERM: the command ends within GRACE_PERIOD, with its files whole."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path
from types import FrameType
from typing import NoReturn

from .errors import printable

# Exit codes, 128 and the number of the signal, as shells and batch systems expect them.
INTERRUPTED, TERMINATED = 130, 143
STOPPED = 75  # of a run whose time is over: "try again later" in sysexits.h
MESSAGE = "finished work is kept, and no file is half written"
# Seconds from a signal to the end of the process, also where it does not react to exceptions, as in a compiler.
GRACE_PERIOD = 1.2
SIGNALS = (signal.SIGINT, signal.SIGTERM)

_received = signal.SIGINT  # the last signal
_kept: Callable[[], str] | None = None


class Stopped(Exception):
    """The time given to a run is over; what is finished is kept, and the same call continues."""


def end_process(number: int | None = None, *_: object) -> None:
    """End the process at once with the exit code of an interruption. Files appear whole by a move, so none is harmed."""
    code, text = outcome(number)
    os.write(2, f"{text}\n".encode())
    os._exit(code)


def outcome(number: int | None = None) -> tuple[int, str]:
    """Exit code and message of a process that a signal ends; by default the last one that it got."""
    code = TERMINATED if (number or _received) == signal.SIGTERM else INTERRUPTED
    kept = ""
    if _kept is not None:
        with suppress(Exception):  # such as a folder that has been removed
            kept = _kept()
    command = f"{called_as()} {shlex.join(sys.argv[1:])}"
    return code, printable(f"atlas: interrupted; {f'{kept}; `{command}` continues' if kept else MESSAGE}")


def explain_kept(kept: Callable[[], str] | None) -> None:
    """Make the message of an interruption state what `kept` returns: the work that would be continued."""
    global _kept
    _kept = kept


def called_as() -> str:
    """The program as this process was called, to be typed again: `atlas`, or its path where no shell finds it."""
    path = Path(sys.argv[0])
    if path.name == "__main__.py":
        return "python -m atlas"
    in_shell = shutil.which(path.name)
    return path.name if in_shell and path.exists() and path.samefile(in_shell) else shlex.quote(str(path))


def is_command() -> bool:
    """Whether this process is the command `atlas`, and no process that it started."""
    if parent_process() is not None:
        return False
    name = Path(sys.argv[0]).stem if getattr(sys, "argv", None) else ""
    return name in ("atlas", "precession-atlas") or sys.orig_argv[1:3] == ["-m", "atlas"]


def end_on_signal() -> None:
    """Make a signal end the process at once, without a traceback: for the time of its imports."""
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, end_process)


def exit_process(code: int) -> NoReturn:
    """Exit with the code of a command that has ended; later signals do not change it.

    After a KeyboardInterrupt, also one that was handled, Python may end itself with SIGINT instead.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if code in (INTERRUPTED, TERMINATED):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


@contextmanager
def signals_as_interrupt() -> Iterator[None]:
    """Turn SIGINT and SIGTERM into KeyboardInterrupt; a second one, or GRACE_PERIOD, ends the process.

    A signal that the process was started to ignore stays ignored. Does nothing outside the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    timers: list[threading.Timer] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        global _received
        _received = signal.Signals(number)
        if timers:
            end_process()
        else:
            timer = threading.Timer(GRACE_PERIOD, end_process)
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
