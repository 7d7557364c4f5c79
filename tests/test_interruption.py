"""Signals: commands end in order, soon, and with one exit code."""

import fcntl
import hashlib
import io
import os
import re
import signal
import socket
import subprocess
import sys
import termios
import threading
import time

import pytest

import atlas
from atlas import interruption
from atlas.cli import main
from atlas.errors import say
from atlas.interruption import HUNG_UP, INTERRUPTED, MESSAGE, STOPPED, TERMINATED, signals_as_interrupt
from atlas.runs import folder as folders
from atlas.store.place import Folder

EXIT_CODES = {signal.SIGINT: INTERRUPTED, signal.SIGTERM: TERMINATED, signal.SIGHUP: HUNG_UP}


@pytest.mark.parametrize("number", interruption.SIGNALS)
def test_a_signal_is_a_keyboard_interrupt_and_handlers_come_back(number):
    before = [signal.getsignal(s) for s in interruption.SIGNALS]
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        signal.raise_signal(number)
    assert [signal.getsignal(s) for s in interruption.SIGNALS] == before


def test_a_second_signal_ends_the_process(monkeypatch):
    ended = threading.Event()
    monkeypatch.setattr(interruption, "end_process", ended.set)
    with signals_as_interrupt():
        for expected in (False, True):
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            assert ended.is_set() == expected


# A command in a function of a library, which no exception leaves, and what is kept: a text, or a question without answer.
HANGING = """
import dataclasses, hashlib, sys
from atlas import cli, interruption

def endless(*_):
    print("at work", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)

def command(options):
    interruption.explain_kept({kept})
    endless()

cli.scenes.print_schema = dataclasses.replace(cli.scenes.print_schema, handler=command)
sys.argv = ["atlas", "schema"]
cli.command()
"""


def end_of(process, number):
    """Seconds from a signal to the end of a process, its exit code, and what it printed on stderr."""
    process.send_signal(number)
    began = time.monotonic()
    try:
        _, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    return time.monotonic() - began, process.returncode, errors


@pytest.mark.usual("endless")
@pytest.mark.parametrize(
    ("number", "kept"), [(signal.SIGINT, "endless"), (signal.SIGTERM, "lambda: '2 tiles are kept'")]
)
def test_a_command_in_a_library_ends_within_two_seconds(number, kept):
    """Under nohup, that is, where SIGINT is ignored, by SIGTERM alone."""
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING.format(kept=kept)], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        preexec_fn=lambda: number == signal.SIGTERM and signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    assert process.stdout.readline() == "at work\n"
    if number == signal.SIGTERM:
        process.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(interruption.GRACE_PERIOD + interruption.MESSAGE_PERIOD + 0.3)
    seconds, code, errors = end_of(process, number)
    assert seconds < 2
    assert code == EXIT_CODES[number]
    text = MESSAGE if kept == "endless" else r"2 tiles are kept; `\S*atlas schema` continues"
    assert re.fullmatch(f"atlas: interrupted; {text}\n", errors)


@pytest.mark.usual("15")
@pytest.mark.parametrize("number", EXIT_CODES)
def test_a_command_ends_while_a_server_is_silent(number):
    pytest.importorskip("obstore")
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"http://127.0.0.1:{server.getsockname()[1]}"
        keys = {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "us-east-1"}
        process = subprocess.Popen(
            [sys.executable, "-m", "atlas", "status", "s3://bucket/night.zarr"], text=True, stderr=subprocess.PIPE,
            env=os.environ | keys | {"AWS_ENDPOINT": address, "AWS_ALLOW_HTTP": "true"},
        )  # fmt: skip
        server.settimeout(60)  # where the command ends before it asks
        connection, _ = server.accept()
        with connection:
            connection.recv(1)
            seconds, code, errors = end_of(process, number)
    assert seconds < 2
    assert (code, errors) == (EXIT_CODES[number], f"atlas: interrupted; {MESSAGE}\n")


def test_a_run_in_another_program_raises_when_the_library_returns(small_scene, tmp_path, monkeypatch):
    """Also where the library returns an error of its own."""

    def slow(folder, name=""):
        began = time.monotonic()
        threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        while time.monotonic() < began + 0.2:
            hashlib.pbkdf2_hmac("sha256", b"", b"", 1_000_000)
        raise OSError("timeout")

    monkeypatch.setattr(interruption, "end_process", lambda *_: pytest.fail("ended"))
    monkeypatch.setattr(Folder, "names", slow)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(small_scene, f"{tmp_path}/run/", progress=False)


@pytest.mark.usual("False-10")
@pytest.mark.parametrize("number", interruption.STOPS)
@pytest.mark.parametrize("is_ignored", [False, True])
def test_a_signal_of_a_batch_system_ends_a_run_between_two_tiles(
    number, is_ignored, small_scene, tmp_path, monkeypatch, capsys
):
    """Of the command alone, and unless it is ignored or another program has its own use of it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
    (tmp_path / "s.toml").write_text(small_scene)
    evaluate_at, tiles = folders.evaluate_at, []

    def signalled(*arguments, **options):
        tiles.append(1)
        if len(tiles) == 3:
            os.kill(os.getpid(), number)
            ended = time.monotonic() + 10
            while not (is_ignored or interruption.stopped_by) and time.monotonic() < ended:
                time.sleep(0.01)
        return evaluate_at(*arguments, **options)

    monkeypatch.setattr(folders, "evaluate_at", signalled)
    command = ["run", "s.toml", "-o", "night.nc", "--threads", "1", "--quiet"]
    before = signal.signal(number, signal.SIG_IGN if is_ignored else signal.SIG_DFL)
    try:
        code = main(command)
        assert signal.getsignal(number) is (signal.SIG_IGN if is_ignored else signal.SIG_DFL)
    finally:
        signal.signal(number, before)
    printed = capsys.readouterr()
    if not is_ignored:
        assert (code, printed.out) == (STOPPED, "")
        assert printed.err.splitlines()[-1] == (
            f"atlas: stopped by {number.name}; 3 of 9 tiles are in night.nc.run/; the same command continues"
        )
        code = main(command)
    assert code == 0
    assert len(tiles) == 9
    with signals_as_interrupt():  # in the library nothing is set for it
        assert signal.getsignal(number) is before


def test_a_command_whose_terminal_hangs_up_ends_without_a_traceback():
    code = HANGING.format(kept="endless").replace("hashlib.pbkdf2_hmac(", "import time; time.sleep(60), (")
    ours, theirs = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=theirs, stdout=theirs, stderr=theirs,
        preexec_fn=lambda: (os.setsid(), fcntl.ioctl(0, termios.TIOCSCTTY, 0)),
    )  # fmt: skip
    os.close(theirs)
    assert b"at work" in os.read(ours, 100)
    os.close(ours)
    assert process.wait(30) == HUNG_UP


@pytest.mark.long
def test_a_signal_of_a_forked_child_is_none_of_its_parent():
    code = (
        "import os, signal, time\n"
        "from atlas import interruption\n"
        "interruption.GRACE_PERIOD = 0.0\n"
        "signal.signal(signal.SIGTERM, lambda *_: os._exit(7))\n"
        "interruption.start_deadline()\n"
        "ready, say_ready = os.pipe()\n"
        "child = os.fork()\n"
        "if not child: os.write(say_ready, b'1'), time.sleep(60)\n"
        "os.read(ready, 1)\n"
        "os.kill(child, signal.SIGTERM)\n"
        "time.sleep(0.3)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (result.returncode, result.stdout, result.stderr) == (0, "7\n", "")


def test_what_a_command_prints_is_written_while_signals_still_end_it():
    """A process that ends ignores signals; nobody might read what it has still to write."""
    stream = io.TextIOWrapper(io.BytesIO(), line_buffering=False)
    say("one", "two", file=stream)
    assert stream.buffer.getvalue() == b"one\ntwo\n"


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


@pytest.mark.long
def test_no_signal_changes_the_exit_code_of_a_command_that_has_ended():
    """Not even a KeyboardInterrupt inside exec, after which Python would end itself with SIGINT."""
    codes = [0, 2, INTERRUPTED, TERMINATED, HUNG_UP]
    program = (
        "import os, signal\n"
        "from atlas.interruption import exit_process\n"
        "class Late:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGTERM)\n"
        f"for code in {[int(code) for code in codes]}:\n"
        "    if process := os.fork():\n"
        "        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)\n"
        "        continue\n"
        "    try: exec('raise KeyboardInterrupt')\n"
        "    except KeyboardInterrupt: pass\n"
        "    late = Late()\n"
        "    exit_process(code)\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (result.stdout.split(), result.stderr) == ([str(int(code)) for code in codes], "")
