"""Signals: commands end in order, soon, and with one exit code."""

import signal
import subprocess
import sys
import threading

import pytest

from atlas import interruption
from atlas.interruption import INTERRUPTED, MESSAGE, TERMINATED, signals_as_interrupt

EXIT_CODES = {signal.SIGINT: INTERRUPTED, signal.SIGTERM: TERMINATED}


@pytest.mark.parametrize("number", interruption.SIGNALS)
def test_a_signal_is_a_keyboard_interrupt_and_handlers_come_back(number):
    before = [signal.getsignal(s) for s in interruption.SIGNALS]
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        signal.raise_signal(number)
    assert [signal.getsignal(s) for s in interruption.SIGNALS] == before
    timers = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert all(timer.finished.is_set() for timer in timers)  # cancelled


def test_a_process_that_does_not_end_is_ended(monkeypatch):
    """By the timer, or by a second signal."""
    ended = threading.Event()
    monkeypatch.setattr(interruption, "end_process", ended.set)
    monkeypatch.setattr(interruption, "GRACE_PERIOD", 0.0)
    with signals_as_interrupt():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert ended.wait(60)
    monkeypatch.setattr(interruption, "GRACE_PERIOD", 1e6)
    ended.clear()
    with signals_as_interrupt():
        for expected in (False, True):
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            assert ended.is_set() == expected


@pytest.mark.parametrize("number", EXIT_CODES)
def test_the_last_signal_decides_the_exit_code_and_what_is_kept_is_told(number, monkeypatch):
    monkeypatch.setattr(sys, "argv", [".venv/bin/precession-atlas", "run", "my scene.toml"])
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        signal.raise_signal(number)
    code = 128 + number
    interruption.explain_kept(None)
    assert interruption.outcome() == (code, f"atlas: interrupted; {MESSAGE}")
    try:
        interruption.explain_kept(lambda: "2 of 3 tiles are in run/")
        assert interruption.outcome() == (
            code, "atlas: interrupted; 2 of 3 tiles are in run/; `.venv/bin/precession-atlas run 'my scene.toml'` continues",
        )  # fmt: skip
        for nothing in (lambda: "", lambda: 1 / 0):
            interruption.explain_kept(nothing)
            assert interruption.outcome() == (code, f"atlas: interrupted; {MESSAGE}")
    finally:
        interruption.explain_kept(None)


def test_a_program_on_the_path_is_called_by_its_name(tmp_path, monkeypatch):
    program = tmp_path / "atlas"
    program.touch(mode=0o700)
    monkeypatch.setattr(sys, "argv", [str(program)])
    monkeypatch.setenv("PATH", "")
    assert interruption.called_as() == str(program)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert interruption.called_as() == "atlas"
    monkeypatch.setattr(sys, "argv", ["/site-packages/atlas/__main__.py"])
    assert interruption.called_as() == "python -m atlas"


def test_an_error_after_a_signal_is_an_interruption():
    """Extension modules whose import is interrupted raise ImportError."""

    def interrupted_import():
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        interrupted_import()
    with pytest.raises(ImportError), signals_as_interrupt():
        raise ImportError("no signal")


def test_an_ignored_signal_stays_ignored():
    """As under nohup."""
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with signals_as_interrupt():
            signal.raise_signal(signal.SIGINT)
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, previous)


def test_outside_the_main_thread_nothing_changes():
    def inside():
        with signals_as_interrupt():
            handlers.append(signal.getsignal(signal.SIGTERM))

    handlers = []
    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]


@pytest.mark.parametrize("number", EXIT_CODES)
def test_during_imports_the_command_ends_without_a_traceback(number):
    """A finder of modules sends the signal when NumPy is about to be imported."""
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == 'numpy': os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.argv = ['atlas', '--version']\n"
        "import atlas.cli\n"
        "print('imported')\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (result.returncode, result.stdout, result.stderr) == (
        EXIT_CODES[number], "", f"atlas: interrupted; {MESSAGE}\n",
    )  # fmt: skip


def test_no_signal_changes_the_exit_code_of_a_command_that_has_ended():
    """Not even a KeyboardInterrupt inside exec, after which Python would end itself with SIGINT."""
    code = (
        "import os, signal\n"
        "from atlas.interruption import exit_process\n"
        "try: exec('raise KeyboardInterrupt')\n"
        "except KeyboardInterrupt: pass\n"
        "class Late:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGTERM)\n"
        "late = Late()\n"
        "exit_process({})\n"
    )
    for exit_code in (0, 2, INTERRUPTED, TERMINATED):
        result = subprocess.run(
            [sys.executable, "-c", code.format(exit_code)], capture_output=True, text=True
        )
        assert (result.returncode, result.stderr) == (exit_code, "")
