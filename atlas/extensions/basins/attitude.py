"""Attitudes of the equilibria in which motions end, in words for legends."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from ...analysis.metadata import system_of
from ...flags import SettledBy
from ...systems.gyrostat.motions import directions
from ...variables import data_variables
from ..equilibria.algebra import ANGLES, frames_of
from .ends import END

MINUS = "\N{MINUS SIGN}"


def texts(ds: xr.Dataset) -> Mapping[str, str]:
    """Return the texts of legends by the names of flags.

    An equilibrium has a text if all points that end there have the same attitude. The first axis is named too if the third axis does
    not tell two equilibria apart. The text of points without an end gives the fraction of undecided points among all points.
    """
    undecided = float((ds["settled_by"] == SettledBy.UNDECIDED).mean()) if "settled_by" in ds else 0.0
    without = {"not_settled": f"not settled ({100 * undecided:.2g} % undecided)"} if undecided else {}
    names = [f"end_{name}" for name in ANGLES if f"end_{name}" in data_variables(system_of(ds))]
    if not {END, *names} <= {*ds}:
        return without
    angles = {name: ds.get(f"end_{name}", 0.0 * ds[END]) for name in ANGLES}
    directed: dict[int, list[str]] = {}
    # About a fixed point only the vertical has a name, because all horizontal directions are alike.
    frame_axes = system_of(ds).frame_axes if len(names) == len(ANGLES) else ("", "", "down")
    for i in np.unique(ds[END].values[ds[END].values >= 0]):
        own = [angle.where(ds[END] == i) for angle in angles.values()]
        if own[0].notnull().any() and not any(angle.max() - angle.min() > 1e-6 for angle in own):
            attitude = zip(ANGLES, (np.nan_to_num(angle.max().values) for angle in own), strict=True)
            frame = frames_of(*directions(dict(attitude)))
            nearest = np.where([name != "" for name in frame_axes], abs(frame.T), -1.0).argmax(1)
            third, first = (
                f"{'+' if frame[nearest[axis], axis] > 0 else MINUS}{frame_axes[nearest[axis]]}"
                for axis in (2, 0)
            )
            angle = np.degrees(np.arccos(min(abs(frame[nearest[2], 2]), 1.0)))
            at_saddle = "end_index" in ds and bool((ds["end_index"].where(ds[END] == i) > 0).any())
            saddle = ", perhaps passing a saddle" * at_saddle
            directed[i] = [third + f", {angle:.0f} deg" * bool(angle >= 0.5), first, saddle]
    thirds = [third for third, *_ in directed.values()]
    return without | {
        f"equilibrium_{i}": f"{i}: axis 3 {third}" + f", 1 {first}" * (thirds.count(third) > 1) + saddle
        for i, (third, first, saddle) in directed.items()
    }
