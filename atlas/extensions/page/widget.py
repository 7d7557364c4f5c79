"""The page of an atlas as a widget of a notebook, from which Python reads the clicked point."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING

from ...errors import BadInput
from .page import atlas_page

try:
    import anywidget
    import traitlets
except ImportError:
    raise BadInput("widgets need the package anywidget: python -m pip install anywidget") from None

if TYPE_CHECKING:
    import xarray as xr


class PageWidget(anywidget.AnyWidget):
    """A page in a notebook.

    Attributes
    ----------
    point : dict
        Coordinates of the last clicked point, for ``ds.atlas.trajectory(**widget.point)`` and ``ds.sel(widget.point)``. The dict is
        empty before the first click. `observe` calls a function after each click.
    """

    _esm = files(__package__).joinpath("widget.js").read_text(encoding="utf-8")
    frame = traitlets.Unicode().tag(sync=True)
    point = traitlets.Dict(value_trait=traitlets.CFloat(), key_trait=traitlets.Unicode()).tag(sync=True)


def widget(ds: xr.Dataset, *, degrees: bool | None = None) -> PageWidget:
    """The page of the atlas as a widget of a notebook: a click sets its `point`.

    Parameters
    ----------
    degrees : bool, optional
        Show angles in degrees, as `page` does. `point` is in rad.

    Returns
    -------
    PageWidget
        Jupyter shows it in the cell. It needs the package anywidget (the extra ``widget``).
    """
    return PageWidget(frame=atlas_page(ds, degrees=degrees)._repr_html_())
