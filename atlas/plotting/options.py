"""Options of a map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, is_color_like

from ..analysis.metadata import flag_names
from ..errors import BadInput, shown
from .style import WIDTHS, Width, check_width, flag_colours
from .text import drawable

MIN_SIZE, MAX_SIZE = 20.0, 2000.0  # mm
MIN_DPI, MAX_DPI = 10.0, 2400.0


@dataclass(frozen=True)
class MapOptions:
    """Options of a map, see `atlas.accessor.Atlas.map`; BadInput for a value that suits no variable."""

    x: str | None = None
    y: str | None = None
    select: Mapping[str, float] | None = None
    ax: Axes | None = None
    title: str | None = None
    cmap: str | Colormap | None = None
    colors: Mapping[str, str] | None = None
    labels: Mapping[str, str] | None = None
    boundary: bool = True
    legend: bool = True
    width: Width = "column"
    size: tuple[float, float] | None = None
    dpi: float = 300
    caption: bool = False

    def __post_init__(self) -> None:
        check_width(self.width)
        if self.ax is not None and not isinstance(self.ax, Axes):
            raise BadInput(f"ax = {shown(self.ax)}: must be Axes of Matplotlib")
        if not _is_number(self.dpi, MIN_DPI, MAX_DPI):
            raise BadInput(f"dpi = {shown(self.dpi)}: must be a number from {MIN_DPI:g} to {MAX_DPI:g}")
        if self.size is not None:
            try:
                valid = [_is_number(s, MIN_SIZE, MAX_SIZE) for s in self.size] == [True, True]
            except TypeError:
                valid = False
            if not valid:
                raise BadInput(
                    f"size = {shown(self.size)}: must be width and height in mm, each from {MIN_SIZE:g} to {MAX_SIZE:g}"
                )
        if isinstance(self.cmap, str) and self.cmap not in colormaps:
            raise BadInput(f"cmap = {shown(self.cmap)}: Matplotlib has no such colour map")
        if self.cmap is not None and not isinstance(self.cmap, str | Colormap):
            raise BadInput(f"cmap = {shown(self.cmap)}: must be a colour map of Matplotlib or its name")
        for name in ("colors", "labels"):
            if not isinstance(getattr(self, name) or {}, Mapping):
                raise BadInput(f"{name} = {shown(getattr(self, name))}: must be a mapping")
        for flag, colour in (self.colors or {}).items():
            if not is_color_like(colour):
                raise BadInput(f"colors: {shown(flag)} = {shown(colour)}: not a colour of Matplotlib")

    @property
    def size_mm(self) -> tuple[float, float | None]:
        """Width of the figure in mm, and its height if the caller chose one."""
        return self.size if self.size is not None else (WIDTHS[self.width], None)

    def check_for(self, array: xr.DataArray, axes: Iterable[str]) -> None:
        """Raise BadInput for options that a variable over some axes does not have."""
        flags = flag_names(array)
        if flags and self.cmap is not None:
            raise BadInput(
                f"cmap: {array.name} has flags, each with a colour of its own; choose them by colors"
            )
        if self.colors and not flags:
            raise BadInput(f"colors: {array.name} has no flags; choose its colours by cmap")
        for option, names, allowed in (
            ("colors", self.colors, flags),
            ("labels", self.labels, [*flags, *axes, str(array.name)]),
        ):
            for name in names or {}:
                if name not in allowed:
                    raise BadInput(f"{option}: {shown(name)}: allowed: {', '.join(allowed)}")

    def text(self, name: str, default: str) -> str:
        """Text for a flag, an axis or a variable: the caller's, or the default."""
        return drawable(str((self.labels or {}).get(name, default)))

    def flag_colours(self, array: xr.DataArray) -> dict[str, str]:
        """Colours of the flags of a variable in the order of their values; empty for a variable of numbers."""
        return flag_colours(flag_names(array)) | dict(self.colors or {})


def _is_number(value: object, low: float, high: float) -> bool:
    """Whether a value is a number between two limits."""
    return (
        isinstance(value, int | float | np.integer | np.floating)
        and not isinstance(value, bool)
        and bool(low <= value <= high)
    )
