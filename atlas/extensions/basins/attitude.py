"""Attitudes of equilibria as small drawings in legends: the axes of the body in the frame, the third one thick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerPatch
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from ...analysis.metadata import system_of
from ...systems.base import Array
from ...systems.gyrostat.equilibria import ANGLES, frames_of
from ...systems.gyrostat.motions import directions
from ...variables import data_variables
from .ends import END

# Radius (to the lower left), velocity (to the right) and normal (up) of the frame on paper.
_ON_PAPER = np.array([[-0.45, -0.35], [0.9, -0.1], [0.0, 0.9]])


class Attitude(Polygon):
    """Sample of a colour with the axes of a body; alpha, beta and gamma are the rows of a frame."""

    def __init__(self, frame: Array, colour: str):
        super().__init__(np.full((1, 2), np.nan), facecolor=colour, edgecolor="0.4", linewidth=0.4)
        self.axes_on_paper = frame.T @ _ON_PAPER


class _Handler(HandlerPatch):
    def create_artists(self, legend: Legend, orig_handle: Any, *sizes: Any) -> list[Artist]:
        x, y, width, height, _, transform = sizes
        centre = np.array([0.5 * width - x, 0.5 * height - y])
        artists = [*super().create_artists(legend, orig_handle, *sizes)]
        for axis, thickness in zip(orig_handle.axes_on_paper, (0.7, 0.7, 1.8), strict=True):
            ends = np.stack([centre, centre + 0.45 * min(width, height) * axis], 1)
            for colour, wider in (("white", 1.2), ("black", 0.0)):  # seen on light and dark grounds
                artists.append(Line2D(*ends, color=colour, linewidth=thickness + wider, transform=transform))
        return artists


Legend.update_default_handler_map({Attitude: _Handler()})


def samples(ds: xr.Dataset) -> Mapping[str, Callable[[str], Attitude]]:
    """Samples of legends by the flags of ends, with the attitude of an equilibrium where all points that end there have the same."""
    names = [f"end_{name}" for name in ANGLES if f"end_{name}" in data_variables(system_of(ds))]
    if not {END, *names} <= {*ds}:
        return {}
    angles = {name: ds.get(f"end_{name}", 0.0 * ds[END]) for name in ANGLES}
    result: dict[str, Callable[[str], Attitude]] = {}
    for i in np.unique(ds[END].values[ds[END].values >= 0]):
        own = {name: angle.where(ds[END] == i) for name, angle in angles.items()}
        if all(angle.max() - angle.min() < 1e-6 for angle in own.values()):
            alpha, gamma = directions({name: angle.max().values for name, angle in own.items()})
            result[f"equilibrium_{i}"] = partial(Attitude, frames_of(alpha, gamma))
    return result
