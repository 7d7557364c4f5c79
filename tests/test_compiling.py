"""Compilation is announced once for each kernel, and only where somebody asks; its time is left out."""

import threading

from atlas.kernel import compiling
from atlas.kernel.compiling import ANNOUNCEMENT, Stopwatch, announced, compilation


class Clock:
    """Time that passes only when a test lets it."""

    now = 100.0

    def perf_counter(self):
        return self.now


def test_the_time_of_compilations_is_left_out(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(compiling, "time", clock)
    monkeypatch.setattr(compiling, "_finished", 0.0)
    stopwatch = Stopwatch()
    clock.now += 2.0
    with compilation():
        clock.now += 20.0
        assert stopwatch.seconds() == 2.0  # also while it lasts
        late = Stopwatch()
        clock.now += 5.0
    clock.now += 1.0
    assert stopwatch.seconds() == 3.0
    assert late.seconds() == 1.0


def test_a_compilation_that_fails_ends(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(compiling, "time", clock)
    stopwatch = Stopwatch()
    try:
        with compilation():
            clock.now += 3.0
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        pass
    clock.now += 1.0
    assert stopwatch.seconds() == 1.0


def test_a_compilation_is_announced_once_if_anybody_asks(capsys):
    def compile_one():
        with compilation():
            pass

    compile_one()
    assert capsys.readouterr().err == ""
    with announced(True), announced(True), announced(False):
        thread = threading.Thread(target=compile_one)
        thread.start()
        thread.join()
    assert capsys.readouterr().err == f"{ANNOUNCEMENT}\n"
    compile_one()
    assert capsys.readouterr().err == ""
