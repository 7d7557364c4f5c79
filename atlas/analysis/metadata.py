"""System, scene, axes and flags of an atlas dataset, from its attributes."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from .. import systems
from ..errors import MAX_TEXT, BadInput, printable, shown
from ..scene.model import Axis, Scene
from ..scene.read import parse_scene
from ..systems.base import System


def system_of(ds: xr.Dataset) -> System:
    """The system of an atlas; BadInput if the dataset is none."""
    if "atlas_system" not in ds.attrs:
        raise BadInput("not an atlas: the attribute atlas_system is missing")
    return systems.get(ds.attrs["atlas_system"])


def number_attribute(ds: xr.Dataset, name: str) -> float:
    """A global attribute of an atlas that is a number; BadInput if it is not there or none."""
    try:
        return float(ds.attrs[name])
    except (KeyError, TypeError, ValueError):
        raise BadInput(f"damaged: the attribute {name} is no number") from None


def scene_of(ds: xr.Dataset) -> Scene | None:
    """The scene of an atlas, None for points that come from no scene."""
    text = ds.attrs.get("atlas_scene", "")
    if not isinstance(text, str):
        raise BadInput("not an atlas: the attribute atlas_scene is no text")
    return parse_scene(text) if text else None


def axes_of(scene: Scene) -> dict[str, Axis]:
    """The axes of a scene by the name of their dimension in the atlas."""
    return {axis.dim: axis for axis in scene.axes.values()}


def is_logarithmic(scene: Scene, dim: str) -> bool:
    """Is the axis of this dimension spaced evenly in its logarithm?"""
    return axes_of(scene)[dim].table.get("spacing") == "log"


def flag_names(array: xr.DataArray) -> list[str]:
    """Names of the values 0, 1, 2, ... of a flag variable; empty for any other variable."""
    return [printable(name, MAX_TEXT) for name in str(array.attrs.get("flag_meanings", "")).split()]


def flag_variable(ds: xr.Dataset, variable: str) -> xr.DataArray:
    """The flag variable of this name; BadInput if the dataset has none."""
    if variable not in ds.data_vars or "flag_meanings" not in ds[variable].attrs:
        flags = [str(name) for name, array in ds.data_vars.items() if "flag_meanings" in array.attrs]
        raise BadInput(
            f"{variable}: not a flag variable of this atlas; allowed: {', '.join(flags) or 'none'}"
        )
    return ds[variable]


def flag_values(ds: xr.Dataset, variable: str, names: str | Sequence[str]) -> list[int]:
    """Values of one or several flags of a variable by their names; BadInput for an unknown name."""
    allowed = flag_names(flag_variable(ds, variable))
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in allowed:
            raise BadInput(f"{variable} = {shown(name)}: allowed: {', '.join(allowed)}")
    return [allowed.index(name) for name in names]
