"""Attitudes of equilibria as small drawings in legends: the axes of the body in the frame, the third one thick."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerBase
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from ..analysis.metadata import system_of
from ..measure.ends import END
from ..systems.base import Array
from ..systems.gyrostat.equilibria import ANGLES
from ..systems.gyrostat.motions import directions
from ..variables import data_variables

SIZE = 2.6  # of a drawing, in sizes of the font
# Radius (to the lower left), velocity (to the right) and normal (up) of the frame on paper.
_ON_PAPER = np.array([[-0.45, -0.35], [0.9, -0.1], [0.0, 0.9]])


class Attitude(Polygon):
    """Sample of a colour with the axes of a body, alpha, beta and gamma being the rows of a frame."""

    def __init__(self, frame: Array, colour: str):
        super().__init__(np.full((1, 2), np.nan), facecolor=colour)
        self.frame = frame


class _Handler(HandlerBase):
    def create_artists(self, legend: Legend, orig_handle: Artist, *sizes: Any) -> list[Artist]:
        assert isinstance(orig_handle, Attitude)
        x, y, width, height, _, transform = sizes
        half = 0.5 * min(width, height)
        box = Rectangle(
            (-x, -y), width, height, facecolor=orig_handle.get_facecolor(), edgecolor="0.4", linewidth=0.4
        )
        centre = np.array([0.5 * width - x, 0.5 * height - y])
        artists: list[Artist] = [box]
        for axis, thickness in zip(orig_handle.frame.T @ _ON_PAPER, (0.7, 0.7, 1.8), strict=True):
            tip = centre + 0.9 * half * axis
            for colour, wider in (("white", 1.2), ("black", 0.0)):  # seen on light and dark grounds
                artists.append(
                    Line2D(*zip(centre, tip, strict=True), color=colour, linewidth=thickness + wider)
                )
        for artist in artists:
            artist.set_transform(transform)
        return artists


Legend.update_default_handler_map({Attitude: _Handler()})


def attitudes(ds: xr.Dataset) -> dict[str, Array]:
    """Frames of the equilibria in which motions end by their flags, where all points that end there have the same."""
    names = [f"end_{name}" for name in ANGLES if f"end_{name}" in data_variables(system_of(ds))]
    if END not in ds or not {*names} <= {*ds}:
        return {}
    columns = ds[[END, *names]].load()
    place = columns[END].values.ravel()
    zero, result = np.zeros(place.size), dict[str, Array]()
    angles = [columns[f"end_{name}"].values.ravel() if f"end_{name}" in columns else zero for name in ANGLES]
    for i in np.unique(place[place >= 0]):
        own = np.array(angles)[:, place == i]
        if np.ptp(own, axis=1).max() < 1e-6:
            points = {name: own[k, :1] for k, name in enumerate(ANGLES)}
            alpha, gamma = (vector[:, 0] for vector in directions(points))
            result[f"equilibrium_{i}"] = np.stack([alpha, np.cross(gamma, alpha), gamma])
    return result
