"""On a map of regular and chaotic motion: chaotic cells by their Lyapunov exponent, undecided ones hatched."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm

from ..analysis.metadata import scene_of
from ..flags import Regularity
from .overlay import HATCHES, UNDECIDED, draw_hatching
from .scales import ColorScale

# From a weak orange to black: darker where neighbouring motions separate faster.
_COLOURS = LinearSegmentedColormap.from_list("exponents", ["#b86a1c", "#5e2205", "#160300"])
MAX_DECADES = 3  # of the colour scale


def exponent_scale(ds: xr.Dataset, name: str) -> ColorScale | None:
    """Colours of the exponents of the chaotic points of a map of regularity; None where there are none to draw."""
    if name != "regularity" or "lyapunov" not in ds or ds["lyapunov"].dims != ds[name].dims:
        return None
    values = ds["lyapunov"].values[ds[name].values == Regularity.CHAOTIC]
    values = values[values > 0]
    if not values.size or values.max() == values.min():
        return None
    low, high = max(float(values.min()), 10.0**-MAX_DECADES * float(values.max())), float(values.max())
    return ColorScale(_COLOURS, LogNorm(low, high), "min" if low > values.min() else "neither", (low, high))


def draw_exponents(
    ax: Axes, part: xr.Dataset, array: xr.DataArray, edges: list[np.ndarray], scale: ColorScale
) -> ScalarMappable:
    """Draw the exponents of the chaotic cells over the cells of the map; returns them for a colour bar."""
    exponents = part["lyapunov"].transpose(*array.dims).values
    chaotic = np.where(array.values == Regularity.CHAOTIC, exponents, np.nan)
    return ax.pcolormesh(
        *edges, np.atleast_2d(chaotic), cmap=scale.colormap, norm=scale.norm, rasterized=True, zorder=1.1
    )


def hatch_undecided(ax: Axes, array: xr.DataArray, edges: list[np.ndarray]) -> None:
    """Hatch the undecided cells of a map of regularity."""
    undecided = np.atleast_2d(array.values == Regularity.UNDECIDED)
    if undecided.any():
        draw_hatching(ax, undecided, edges, HATCHES[UNDECIDED])


def texts(ds: xr.Dataset) -> Mapping[str, str]:
    """Texts of the legend for "regular" and "chaotic", which state the length of the runs; empty without a scene."""
    scene = scene_of(ds)
    if scene is None:
        return {}
    return {name: f"{name} up to {scene.duration}" for name in ("regular", "chaotic")}
