"""The small scene with points of its own in the place of its axes: a sample, and a file; planes, and datasets of labels."""

from pathlib import Path

import numpy as np
import xarray as xr

from atlas import load_scene
from atlas.analysis import metadata
from atlas.analysis.plane import Plane

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

MEANINGS = {
    "flag_values": np.arange(5, dtype=np.int8),
    "flag_meanings": "not_computed regular permanent drifting unresolved",
}


def labelled(label: np.ndarray) -> xr.Dataset:
    """A dataset with axes and a label alone."""
    dims = [f"x{i}" for i in range(label.ndim)]
    return xr.Dataset(
        {"label": (dims, label.astype(np.int8), MEANINGS)},
        coords={d: (d, np.linspace(0, 1, n)) for d, n in zip(dims, label.shape, strict=True)},
    )


def plane(text: str, **fixed: float) -> Plane:
    """The plane of a scene in the ranges of its axes, but those with a value."""
    scene = load_scene(text)
    axes = metadata.axes_of(scene)
    extent = {d: (min(a.values), max(a.values)) for d, a in axes.items() if d not in fixed}
    return Plane(scene, extent, fixed)
