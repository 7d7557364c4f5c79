"""Written by scripts/tools/make_faces.py; do not edit."""
from atlas.extensions.page.page import Page
from atlas.extensions.page.widget import PageWidget
from atlas.plotting.options import Width
from collections.abc import Mapping
from collections.abc import Sequence
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import xarray as xr

__all__ = ['borders', 'branches']

def borders(system: 'str', body: 'Mapping[str, float]', ranges: 'Mapping[str, Sequence[float]]', *, ties: 'Mapping[str, str] | None' = None) -> 'xr.Dataset': ...
def branches(system: 'str', body: 'Mapping[str, float]', *, along: 'Mapping[str, Sequence[float]]', ties: 'Mapping[str, str] | None' = None) -> 'xr.Dataset': ...

class Questions:
    _ds: xr.Dataset
    def basin_fractions(self, over: 'str | Sequence[str] | None' = None) -> 'xr.Dataset': ...
    def diagram(self, variable: 'str' = 'theta0', *, ax: 'Axes | None' = None, title: 'str | None' = None, legend: 'bool' = True, width: 'Width' = 'column') -> 'Figure': ...
    def page(self, *, degrees: 'bool | None' = None) -> 'Page': ...
    def widget(self, *, degrees: 'bool | None' = None) -> 'PageWidget': ...
