"""Options of maps, for `ds.atlas.map`, the command `map` and pages. Only methods import Matplotlib."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import BadInput, allowed_text, shown, similar_text
from ..scene.checks import boolean, whole_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize

Width = Literal["column", "page"] | float
WIDTHS = {"column": 88.0, "page": 180.0}  # widths of one and of two columns of a journal, mm
MIN_SIZE, MAX_SIZE = 20.0, 2000.0  # mm
MIN_DPI, MAX_DPI = 10.0, 2400.0
NORMS = ("linear", "log", "symlog", "asinh")


def option(default: Any, text: str, /, **settings: Any) -> Any:
    """Return a field of `MapOptions` that is also an option of the command `map`, with the help `text` and `argparse` settings."""
    return field(default=default, metadata={"help": text} | settings)


@dataclass(frozen=True)
class MapOptions:
    """Options of a map. A value that suits no variable raises BadInput.

    Parameters
    ----------
    x, y : str, optional
        Axes of the map. The default is the two longest axes, of which x comes first in the atlas. The axes of single points are
        parameters or other coordinates of the points. The default is then the two coordinates with the most values.
    row, col : str, optional
        Axes with a panel for each value, from top to bottom (row) or left to right (col). A dimension of `atlas.concat` is allowed too.
        There are at most `atlas.analysis.select.MAX_PANELS` panels. By default one axis besides x and y gives panels row by row.
    select : mapping of str to float, optional
        Values of axes that the map does not show, by the name of the axis. The nearest value of the axis is taken.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into, which keep their fonts and size. The default is a new figure. ``ax.get_legend_handles_labels()``
        returns the entries of the legend, even if the legend is not drawn.
    title : str, optional
        Title of the figure.
    cmap : str or Colormap, optional
        Colour map of a variable of numbers.
    vmin, vmax : float, optional
        Ends of the colour scale of numbers, in the unit shown. Over a single axis they are the ends of the vertical axis. If both
        are given, the scale is not centred on zero.
    norm : str or matplotlib.colors.Normalize, optional
        "linear", "log", "symlog", "asinh", or a norm of Matplotlib, for a variable of numbers.
    colors : mapping of str to str, optional
        Colours by the names of flags, for a variable of flags.
    labels : mapping of str to str, optional
        Mapping from the name of a flag, of an axis or of the variable to the text that replaces the name.
    boundary : bool, optional
        Draw the borders and the curves of exact steady motions that theory predicts from the scene of the
        atlas, and hatch unstable motions that had no time to drift.
    legend : bool, optional
        Draw the legend.
    columns : int, optional
        Number of panels in a row. The default is 2, or 4 on wide figures, or 1 if only `row` is given.
    width : {"column", "page"} or float, optional
        Width of the figure in mm, where "column" is 88 mm and "page" 180 mm.
    size : (float, float), optional
        Width and height in mm, instead of `width`.
    dpi : float, optional
        Resolution at which `savefig` writes the figure.
    caption : bool, optional
        Print under the map what it shows and how it was computed.
    degrees : bool, optional
        Show angles, and take angles in `select`, in degrees. By default an axis is shown in degrees if the scene has
        display_units = "deg" for this axis.
    """

    x: str | None = option(None, "horizontal axis (default: the first)", metavar="AXIS")
    y: str | None = option(None, "vertical axis (default: the second)", metavar="AXIS")
    row: str | None = option(None, "axis of panels from top to bottom", metavar="AXIS")
    col: str | None = option(None, "axis of panels from left to right", metavar="AXIS")
    select: Mapping[str, float] | None = option(
        None, "values of the other axes, one or several", metavar="AXIS=VALUE"
    )
    ax: Axes | None = None
    title: str | None = option(None, "title of the figure", metavar="TEXT")
    cmap: str | Colormap | None = option(  # noqa: RUF009 - a field
        None, "Matplotlib's colour map for a variable of numbers", metavar="NAME"
    )
    vmin: float | None = option(None, "lower end of the colours of numbers", type=float, metavar="X")
    vmax: float | None = option(None, "upper end of the colours of numbers", type=float, metavar="X")
    norm: str | Normalize | None = option(  # noqa: RUF009 - a field
        None, "scale of the colours of numbers", choices=NORMS
    )
    colors: Mapping[str, str] | None = option(None, "colours of flags, one or several", metavar="FLAG=COLOUR")
    labels: Mapping[str, str] | None = option(
        None, "texts for flags, axes and the variable, one or several", metavar="NAME=TEXT"
    )
    boundary: bool = option(True, "draw no theory")
    legend: bool = option(True, "draw no legend")
    columns: int | None = option(None, "panels in a row", type=int, metavar="N")
    width: Width = option("column", "journal width", choices=tuple(WIDTHS))  # noqa: RUF009 - a field
    size: tuple[float, float] | None = option(None, "size in mm, such as 120x90", metavar="WIDTHxHEIGHT")
    dpi: float = option(300, "resolution (default: 600)", default=None, type=float, metavar="N")
    caption: bool = option(False, "print a caption for the figure")
    degrees: bool | None = option(None, "angles in degrees", action="store_true")

    def __post_init__(self) -> None:
        from matplotlib import colormaps
        from matplotlib.axes import Axes
        from matplotlib.colors import Colormap, Normalize, is_color_like

        width_mm(self.width)
        if self.columns is not None:
            whole_number("columns", self.columns, 1, 12)
            if self.row is not None:
                raise BadInput("columns: not together with row, whose panels are below each other")
        if self.degrees is not None:
            boolean("degrees", self.degrees)
        if self.ax is not None and not isinstance(self.ax, Axes):
            raise BadInput(f"ax = {shown(self.ax)}: must be Axes of Matplotlib")
        if not _is_number(self.dpi, MIN_DPI, MAX_DPI):
            raise BadInput(f"dpi = {shown(self.dpi)}: must be a number from {MIN_DPI:g} to {MAX_DPI:g}")
        sizes = self.size if isinstance(self.size, Iterable) else [self.size]
        if self.size is not None and [_is_number(each, MIN_SIZE, MAX_SIZE) for each in sizes] != [True, True]:
            raise BadInput(
                f"size = {shown(self.size)}: must be width and height in mm, each from {MIN_SIZE:g} to {MAX_SIZE:g}"
            )
        if isinstance(self.cmap, str) and self.cmap not in colormaps:
            question = similar_text(self.cmap, colormaps).rstrip()
            raise BadInput(
                f"cmap = {shown(self.cmap)}: Matplotlib has no such colour map{question and f'; {question}'}"
            )
        if self.cmap is not None and not isinstance(self.cmap, str | Colormap):
            raise BadInput(f"cmap = {shown(self.cmap)}: must be a colour map of Matplotlib or its name")
        for name in ("vmin", "vmax"):
            if getattr(self, name) is not None and not _is_number(getattr(self, name), -np.inf, np.inf):
                raise BadInput(f"{name} = {shown(getattr(self, name))}: must be a finite number")
        if self.vmin is not None and self.vmax is not None and not self.vmin < self.vmax:
            raise BadInput(f"vmin = {self.vmin:g}: must be below vmax = {self.vmax:g}")
        if isinstance(self.norm, Normalize):
            if self.vmin is not None or self.vmax is not None:
                raise BadInput("norm: a norm of Matplotlib has vmin and vmax of its own")
        elif self.norm is not None and self.norm not in NORMS:
            raise BadInput(
                f"norm = {shown(self.norm)}: {allowed_text(self.norm, NORMS)}, or a norm of Matplotlib"
            )
        for name in ("colors", "labels"):
            if not isinstance(getattr(self, name) or {}, Mapping):
                raise BadInput(f"{name} = {shown(getattr(self, name))}: must be a mapping")
        for flag, colour in (self.colors or {}).items():
            if not is_color_like(colour):
                raise BadInput(f"colors: {shown(flag)} = {shown(colour)}: not a colour of Matplotlib")

    @property
    def size_mm(self) -> tuple[float, float | None]:
        """Width of the figure in mm, and the height or None if the caller chose no height."""
        return self.size if self.size is not None else (width_mm(self.width), None)


def width_mm(width: Width) -> float:
    """Return the width of a figure in mm, or raise BadInput if `width` is not valid."""
    if isinstance(width, str) and width in WIDTHS:
        return WIDTHS[width]
    if not _is_number(width, MIN_SIZE, MAX_SIZE):
        raise BadInput(
            f"width = {shown(width)}: allowed: {', '.join(WIDTHS)}, or {MIN_SIZE:g} to {MAX_SIZE:g} mm"
        )
    return float(width)


def _is_number(value: object, low: float, high: float) -> bool:
    return (
        isinstance(value, int | float | np.integer | np.floating)
        and not isinstance(value, bool)
        and bool(low <= value <= high)
        and bool(np.isfinite(value))
    )


def takes_map_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a function with **options the signature and the documented parameters of `MapOptions`."""
    signature = inspect.signature(function)
    own = [each for each in signature.parameters.values() if each.kind is not each.VAR_KEYWORD]
    keyword = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    further = [keyword(each.name, default=each.default, annotation=each.type) for each in fields(MapOptions)]
    function.__signature__ = signature.replace(parameters=[*own, *further])  # type: ignore[attr-defined]
    documented = (inspect.getdoc(MapOptions) or "").partition("----------\n")[2]
    function.__doc__ = (inspect.getdoc(function) or "").replace("**options", documented)
    return function
