"""Reactions to signals. SIGNALS end the command within two seconds and leave whole files; STOPS end a run between two tiles."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path
from types import FrameType
from typing import NoReturn

from .errors import printable

# These exit codes are 128 plus the number of the signal, as shells and batch systems expect.
INTERRUPTED, TERMINATED, HUNG_UP = 130, 143, 129
STOPPED = 75  # exit code of a run whose time is over: "try again later" in sysexits.h
MESSAGE = "finished work is kept, and no file is half written"
# GRACE_PERIOD s after a signal, a busy process prints a message and ends. Composing and printing the text may each take MESSAGE_PERIOD.
GRACE_PERIOD, MESSAGE_PERIOD = 1.0, 0.4
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
STOPS = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU)  # batch systems send these before the end of a job

_received = signal.SIGINT  # the signal of SIGNALS that was received last
stopped_by = ""  # set to "by SIGUSR1", for example, after a signal of STOPS; then no tile begins
_kept: Callable[[], object] = str  # function that returns the text about finished work


class Stopped(Exception):
    """Raised when the time allowed for a run is over. Finished work is kept, and the same call continues the run."""


def end_process(number: int | None = None, *_: object) -> None:
    """End the process at once with the exit code of an interruption. No file is harmed, because files are moved into place whole."""
    code, text = outcome(number)
    _in_time(lambda: os.write(2, f"{text}\n".encode()))
    os._exit(code)


def outcome(number: int | None = None) -> tuple[int, str]:
    """Return exit code and message of a process that a signal ends. The default is the signal received last."""
    code = 128 + (number or _received)
    kept = _in_time(_kept)
    command = f"{called_as()} {shlex.join(sys.argv[1:])}"
    return code, printable(f"atlas: interrupted; {f'{kept}; `{command}` continues' if kept else MESSAGE}")


def _in_time(function: Callable[[], object]) -> object:
    """Return the result of a function, or None if the function fails or takes longer than MESSAGE_PERIOD."""
    results: list[object] = [None]

    def call() -> None:
        with suppress(Exception):
            results.append(function())

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(MESSAGE_PERIOD)
    return results[-1]


def explain_kept(text: Callable[[], str] | None) -> None:
    """Set a function that returns a text about finished work. The message of an interruption contains this text."""
    global _kept
    _kept = text or str


def called_as() -> str:
    """Return the name by which this program is called, or the path if the shell does not find the name."""
    path = Path(sys.argv[0])
    if path.name == "__main__.py":
        return "python -m atlas"
    in_shell = shutil.which(path.name)
    return path.name if in_shell and path.exists() and path.samefile(in_shell) else shlex.quote(str(path))


def is_command() -> bool:
    """Whether this process is the command `atlas` itself, not a child process."""
    if parent_process() is not None:
        return False
    name = Path(sys.argv[0]).stem if getattr(sys, "argv", None) else ""
    return name in ("atlas", "precession-atlas") or sys.orig_argv[1:3] == ["-m", "atlas"]


def end_on_signal() -> None:
    """Let a signal that arrives during the imports end the process at once, without a traceback."""
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, end_process)


def start_deadline() -> None:
    """Start a thread that ends the process GRACE_PERIOD after a signal, even if a library keeps the main thread busy."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    # Otherwise a signal to a child process would start the deadline of this process.
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))

    def wait() -> None:
        while (number := os.read(reading, 1)[0]) not in SIGNALS:
            pass
        time.sleep(GRACE_PERIOD)
        end_process(number)

    threading.Thread(target=wait, daemon=True).start()


def exit_process(code: int) -> NoReturn:
    """Exit with the code of a finished command, and ignore later signals."""
    for number in (*SIGNALS, *STOPS):
        signal.signal(number, signal.SIG_IGN)
    if code > 128:  # Python may end itself with SIGINT after a KeyboardInterrupt
        os._exit(code)
    sys.exit(code)


@contextmanager
def signals_as_interrupt() -> Iterator[None]:
    """Turn SIGINT, SIGTERM and SIGHUP into KeyboardInterrupt in the main thread; a second signal ends the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        global _received
        nonlocal received
        _received = signal.Signals(number)
        if received:
            end_process()
        received = True
        raise KeyboardInterrupt

    previous = {number: signal.getsignal(number) for number in SIGNALS}
    # A signal that was ignored from the start stays ignored, and a handler of SIGHUP that another part of the program set stays.
    replaced = [number for number, handler in previous.items() if handler is not signal.SIG_IGN]
    if previous[signal.SIGHUP] not in (signal.SIG_IGN, signal.SIG_DFL, end_process):
        replaced.remove(signal.SIGHUP)
    for number in replaced:
        signal.signal(number, interrupt)
    try:
        yield
    except Exception:  # a library may turn a KeyboardInterrupt into another error
        if received:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number in replaced:
            signal.signal(number, previous[number])


@contextmanager
def signals_as_stop() -> Iterator[None]:
    """Let the signals of STOPS end a run as `stop_after` does. In other threads, or if a signal has a handler, nothing changes."""

    def stop(number: int, frame: FrameType | None) -> None:
        global stopped_by
        stopped_by = f"by {signal.Signals(number).name}"

    global stopped_by
    in_main = threading.current_thread() is threading.main_thread()
    replaced = [number for number in STOPS if in_main and signal.getsignal(number) is signal.SIG_DFL]
    for number in replaced:
        signal.signal(number, stop)
    try:
        yield
    finally:
        stopped_by = ""
        for number in replaced:
            signal.signal(number, signal.SIG_DFL)
