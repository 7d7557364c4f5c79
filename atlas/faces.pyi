"""Written by scripts/tools/make_faces.py; do not edit."""
from atlas.extensions.page.page import Page
import xarray as xr

__all__ = []


class Questions:
    _ds: xr.Dataset
    def page(self) -> 'Page': ...
