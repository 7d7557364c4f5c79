"""Colours of the values of a variable, and their colour bar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from .options import MapOptions

MAX_DECADES = 10  # of a logarithmic colour scale
MIN_LOG_RATIO = 100  # positive numbers that span more get a logarithmic colour scale
MAX_INTEGERS = 40  # integers in a range up to this get one colour each


@dataclass(frozen=True)
class ColorScale:
    """Colours of a variable."""

    colormap: Colormap  # as Matplotlib uses them
    norm: Normalize  # as Matplotlib uses them
    extend: str = "neither"  # ends of the colour bar beyond which there are values: "neither" or "min"
    log_range: tuple[float, float] | None = None  # lowest and highest value of a logarithmic scale
    integers: bool = False  # whether each integer has a colour of its own

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Values as they are drawn: zero, which has no logarithm, has the colour below a logarithmic scale."""
        if self.log_range is None:
            return values
        return np.where(values <= 0, 0.5 * self.log_range[0], values)


def color_scale(array: xr.DataArray, options: MapOptions) -> ColorScale:
    """Colour scale of a variable by its values, with the colours that the caller chose."""
    if colours := list(options.flag_colours(array).values()):
        edges = np.arange(len(colours) + 1) - 0.5
        return ColorScale(ListedColormap(colours), BoundaryNorm(edges, len(colours)))
    colormap = colormaps.get_cmap("viridis" if options.cmap is None else options.cmap)
    finite = array.values[np.isfinite(array.values)]
    if not finite.size:
        return ColorScale(colormap, Normalize(0, 1))
    low, high = float(finite.min()), float(finite.max())
    if high - low <= MAX_INTEGERS and (finite == np.rint(finite)).all() and (high > low or low != 0):
        edges = np.arange(low, high + 2) - 0.5
        shades = colormap(np.linspace(0, 1, max(len(edges) - 1, 2)))[: len(edges) - 1]
        return ColorScale(ListedColormap(shades), BoundaryNorm(edges, len(edges) - 1), integers=True)
    if low < 0 < high:
        # Cividis is blue below, grey at and yellow above its middle, and its luminance shows the sign.
        bound = max(-low, high)
        signed = colormaps["cividis"] if options.cmap is None else colormap
        return ColorScale(signed, Normalize(-bound, bound))
    if high > 0:
        min_positive = float(finite[finite > 0].min())
        if high > MIN_LOG_RATIO * min_positive:
            floor = max(min_positive, high * 10.0**-MAX_DECADES)
            extend = "min" if low < floor else "neither"
            return ColorScale(colormap, LogNorm(floor, high), extend, (floor, high))
    if low == high:
        low, high = low - 0.5, high + 0.5
    return ColorScale(colormap, Normalize(low, high))


def add_color_bar(
    figure: Figure, axes: list[Axes], image: ScalarMappable, scale: ColorScale, label: str
) -> None:
    """Colour bar to the right of the panels."""
    bar = figure.colorbar(image, ax=axes, pad=0.02, extend=scale.extend, aspect=25)
    bar.set_label(label)
    if scale.integers:
        assert isinstance(scale.norm, BoundaryNorm)
        low, high = scale.norm.boundaries[0] + 0.5, scale.norm.boundaries[-1] - 0.5
        ticks = MaxNLocator(10, integer=True, steps=[1, 2, 5, 10]).tick_values(low, high)
        bar.locator = FixedLocator([tick for tick in ticks if low <= tick <= high and tick == round(tick)])
        bar.minorlocator = NullLocator()
        bar.update_ticks()
    bar.ax.tick_params(length=2.5)
    bar.outline.set_linewidth(0.6)
