"""The small scene with points of its own in the place of its axes: a sample, and a file."""

from pathlib import Path

SMALL = (Path(__file__).parent / "small.toml").read_text()
_SHORT = SMALL.replace("duration = 30.0", 'duration = "3 orbits"').replace(
    "tolerance = 1e-5", "tolerance = 1e-4"
)
_HEAD, _TAIL = _SHORT[: _SHORT.index("[axes")], _SHORT[_SHORT.index("[ties]") :]
SAMPLE = """\
[points]
sample = "sobol"
count = 48
seed = 3

[points.ranges.sigma]
from = 0.3
to = 1.7

[points.ranges.theta0]
from = 0.02
to = 1.4
spacing = "log"

"""
SAMPLED = _HEAD + SAMPLE + _TAIL
GIVEN = _HEAD + '[points]\nfile = "mine.csv"\n' + _TAIL
