"""Progress of a run as people see it."""

import re
from contextlib import closing

import numpy as np

from atlas.store import progress


def test_the_time_left_is_said_once_it_is_known(monkeypatch, capsys):
    """After a twentieth of the points, or a minute."""
    monkeypatch.setattr(progress, "PLAIN_INTERVAL", 0.0)
    seconds, text = [1.0], ""
    monkeypatch.setattr(progress.compiling.Stopwatch, "seconds", lambda _: seconds[0])
    for done, elapsed in ((49, 1.0), (50, 1.0), (49, 59.0), (1, 60.0)):
        seconds[0] = elapsed
        with closing(progress.Progress(1000)) as bar:
            bar.advance(done)
            text += capsys.readouterr().err
        capsys.readouterr()
    lines = re.split(r"[\n\r]", text.replace("\x1b[K", ""))
    lines = [line.strip() for line in lines if line.strip()]
    assert [line.endswith(" left") for line in lines] == [False, True, False, True]
    assert lines[0] == "4.9 %  49 of 1000 points  49 points/s"
    assert lines[1] == "5.0 %  50 of 1000 points  50 points/s  0:19 left"


def test_points_may_be_numbers_of_numpy(monkeypatch, capsys):
    monkeypatch.setattr(progress, "PLAIN_INTERVAL", 0.0)
    with closing(progress.Progress(1000)) as bar:
        bar.advance(np.float64(500.5))
    assert capsys.readouterr().err.rstrip().endswith(" left")
