"""Written by scripts/tools/make_faces.py; do not edit."""
from atlas.extensions.page.page import Page
from collections.abc import Sequence
import xarray as xr

__all__ = []


class Questions:
    _ds: xr.Dataset
    def basin_fractions(self, over: 'str | Sequence[str] | None' = None) -> 'xr.Dataset': ...
    def page(self) -> 'Page': ...
