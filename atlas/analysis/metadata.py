"""System, scene, axes and flags of an atlas dataset, from its attributes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
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
    name, package = ds.attrs["atlas_system"], ds.attrs.get("atlas_system_package")
    if package is not None and name not in systems.names():
        raise BadInput(
            f"the atlas is of the system {shown(name)}, which is not installed here; its package was {shown(package)}"
        )
    return systems.get(name)


def number_attribute(ds: xr.Dataset, name: str) -> float:
    """A global attribute of an atlas that is a number; BadInput if it is missing or no number."""
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
    """Whether the axis of this dimension is spaced evenly in its logarithm; false for a dimension not of the scene."""
    axis = axes_of(scene).get(dim)
    return axis is not None and axis.table.get("spacing") == "log"


def check_not_empty(ds: xr.Dataset) -> None:
    """Raise BadInput for a dataset without points."""
    for dim, size in ds.sizes.items():
        if size == 0:
            raise BadInput(f"{dim}: has no values here: the dataset is empty")


def is_numeric_axis(ds: xr.Dataset, dim: object) -> bool:
    """Whether a name is a dimension with a coordinate of numbers."""
    return dim in ds.dims and dim in ds.coords and ds[dim].dtype.kind in "iuf"


def flag_names(array: xr.DataArray) -> list[str]:
    """Names of the values 0, 1, 2, ... of a flag variable; empty for any other variable.

    Raises BadInput for flags whose values are no longer flags, such as averages of them.
    """
    names = [printable(name, MAX_TEXT) for name in str(array.attrs.get("flag_meanings", "")).split()]
    if is_averaged(array):
        raise BadInput(
            f"{array.name}: values of type {array.dtype} are no flags: they were averaged, interpolated or masked with"
            " nan; choose points by select, sel or isel, or mask with where(condition, 0)"
        )
    if names and not np.array_equal(array.attrs.get("flag_values", range(len(names))), range(len(names))):
        raise BadInput(
            f"{array.name}: its flag_values are not 0 to {len(names) - 1}, as those of an atlas are"
        )
    return names


def is_averaged(array: xr.DataArray) -> bool:
    """Whether a variable has the names of flags, but values that are none, such as averages of them."""
    return "flag_meanings" in array.attrs and array.dtype.kind not in "iu"


def flag_variable(ds: xr.Dataset, variable: str) -> xr.DataArray:
    """The flag variable of this name; BadInput if the dataset has none."""
    if variable not in ds.data_vars or "flag_meanings" not in ds[variable].attrs:
        flags = [str(name) for name, array in ds.data_vars.items() if "flag_meanings" in array.attrs]
        if not flags:
            raise BadInput(
                f"{variable}: no variable here has flag_meanings: the dataset is no atlas, or has lost its attributes"
            )
        raise BadInput(f"{variable}: not a flag variable of this atlas; allowed: {', '.join(flags)}")
    flag_names(ds[variable])  # raises BadInput for averages
    return ds[variable]


def flag_values(ds: xr.Dataset, variable: str, flags: str | int | Sequence[str | int]) -> list[int]:
    """Values of one or several flags of a variable by their names or numbers; BadInput for unknown ones."""
    allowed = flag_names(flag_variable(ds, variable))
    is_list = isinstance(flags, Iterable) and not isinstance(flags, str) and getattr(flags, "ndim", 1) != 0
    return [_flag_value(variable, flag, allowed) for flag in (flags if is_list else [flags])]  # type: ignore[union-attr]


def _flag_value(variable: str, flag: Any, allowed: list[str]) -> int:
    """Value of one flag by its name or number."""
    if isinstance(flag, str) and flag in allowed:
        return allowed.index(flag)
    number = np.asarray(flag)
    if number.ndim == 0 and number.dtype.kind in "iu" and 0 <= number < len(allowed):
        return int(number)
    raise BadInput(
        f"{variable} = {shown(flag)}: allowed: {', '.join(allowed)}, or their numbers 0 to {len(allowed) - 1}"
    )
