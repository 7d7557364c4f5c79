"""System, scene, axes and flags of an atlas dataset, from its attributes."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import systems
from ..errors import MAX_TEXT, BadInput, allowed_text, attribute_text, printable, shown
from ..measure.ends import END, NO_END
from ..runs.tiles import Tiling
from ..scene.model import Axis, Scene, Settings
from ..scene.read import parse_scene
from ..systems.base import System
from ..variables import data_variables

MAX_FLAGS = 128  # of a variable, as many as int8 has numbers from 0 on
TRUE_FALSE = ["false", "true"]  # flags of a variable of Booleans


def system_of(ds: xr.Dataset) -> System:
    """The system of an atlas; BadInput if the dataset is none, or has texts where an atlas has numbers."""
    if "atlas_system" not in ds.attrs:
        raise BadInput("not an atlas: the attribute atlas_system is missing")
    name, package = ds.attrs["atlas_system"], ds.attrs.get("atlas_system_package")
    if package is not None and name not in systems.names():
        raise BadInput(
            f"the atlas is of the system {shown(name)}, which is not installed here; its package was {shown(package)}"
        )
    system = systems.get(name)
    for variable in ds.data_vars.keys() & data_variables(system):
        if ds[variable].dtype.kind not in "biuf":
            raise BadInput(f"{variable}: values of type {ds[variable].dtype}; an atlas has numbers there")
    return system


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


def settings_of(ds: xr.Dataset) -> Settings:
    """Settings of points that come from no scene, from the attributes of their dataset."""
    method, step = attribute_text(ds.attrs, "atlas_method"), number_attribute(ds, "atlas_step")
    settings = Settings(method=method, rate_tolerance=number_attribute(ds, "atlas_rate_tolerance"))
    if math.isfinite(step):
        return replace(settings, step=step)
    return replace(settings, tolerance=number_attribute(ds, "atlas_tolerance"))


def axes_of(scene: Scene) -> dict[str, Axis]:
    """The axes of a scene by the name of their dimension in the atlas."""
    return {axis.dim: axis for axis in scene.axes.values()}


def is_logarithmic(scene: Scene | None, dim: str, values: ArrayLike) -> bool:
    """Whether the scene spaces this axis logarithmically and all values are positive; maps do the same."""
    axis = None if scene is None else axes_of(scene).get(dim)
    return axis is not None and axis.table.get("spacing") == "log" and bool(np.min(np.asarray(values)) > 0)


def check_not_empty(ds: xr.Dataset) -> None:
    """Raise BadInput for a dataset without points."""
    for dim, size in ds.sizes.items():
        if size == 0:
            raise BadInput(f"{dim}: has no values here: the dataset is empty")


def is_numeric_axis(ds: xr.Dataset, dim: object) -> bool:
    """Whether a name is a dimension with a coordinate of numbers."""
    return dim in ds.dims and dim in ds.coords and ds[dim].dtype.kind in "iuf"


def numeric_coordinates(ds: xr.Dataset, dim: str) -> list[str]:
    """Names of the coordinates of numbers along a dimension alone."""
    return [str(name) for name, c in ds.coords.items() if c.dims == (dim,) and c.dtype.kind in "iuf"]


@lru_cache
def _registered_flags(system: System) -> dict[str, str]:
    """Names of the flag variables of a system with their long_name; none of a system that can have no atlas."""
    with suppress(BadInput):
        return {name: v.long_name for name, v in data_variables(system).items() if v.flags is not None}
    return {}


def has_flags(array: xr.DataArray) -> bool:
    """Whether a variable is one of flags: Booleans, or flags by their name or by a long_name of their own.

    Differences of flags inherit their attributes: a flag's long_name under another name means numbers.
    """
    if array.dtype.kind == "b":
        return True
    registered = [_registered_flags(system) for system in systems.SYSTEMS.values()]
    known, text = any(array.name in flags for flags in registered), str(array.attrs.get("long_name"))
    own = "long_name" in array.attrs and not any(text in flags.values() for flags in registered)
    return "flag_meanings" in array.attrs and (known or own)


def flag_names(array: xr.DataArray) -> list[str]:
    """Names of the values 0, 1, 2, ... of a flag variable, else empty; BadInput for averages of flags."""
    if array.dtype.kind == "b":
        return TRUE_FALSE
    if not has_flags(array):
        return []
    if is_averaged(array):
        raise BadInput(
            f"{array.name}: values of type {array.dtype} are no flags: they were averaged, interpolated or masked with"
            " nan; choose points by select, sel or isel, or mask with where(condition, 0)"
        )
    names = [printable(name, MAX_TEXT) for name in str(array.attrs["flag_meanings"]).split()]
    values = array.attrs.get("flag_values", range(len(names)))
    if len(names) > MAX_FLAGS or not np.array_equal(values, range(len(names))):
        raise BadInput(
            f"{array.name}: its flag_values are not 0 to {len(names) - 1}, as those of an atlas are, of which there are"
            f" at most {MAX_FLAGS}"
        )
    return names


def is_averaged(array: xr.DataArray) -> bool:
    """Whether a variable has the names of flags, but values that are none, such as averages of them."""
    return has_flags(array) and array.dtype.kind not in "biu"


def positions_as_flags(ds: xr.Dataset, variable: str) -> xr.Dataset:
    """With the positions of equilibria, if that is the variable, as flags: not settled, then every position."""
    if variable != END or END not in ds or "flag_meanings" in ds[END].attrs:
        return ds
    last = int(ds[END].max()) if ds[END].size else NO_END
    names = ["not_settled", *(f"equilibrium_{i}" for i in range(last + 1))]
    flags = ds[END] - NO_END
    return ds.assign({END: flags.assign_attrs(ds[END].attrs | {"flag_meanings": " ".join(names)})})


def flag_variable(ds: xr.Dataset, variable: str) -> xr.DataArray:
    """The flag variable of this name, positions of equilibria as flags; BadInput if the dataset has none."""
    ds = positions_as_flags(ds, variable)
    flags = [str(name) for name, array in ds.data_vars.items() if has_flags(array)]
    if variable not in flags:
        if not flags:
            raise BadInput(
                f"{variable}: no variable here has flag_meanings: the dataset is no atlas, or has lost its attributes"
            )
        raise BadInput(f"{variable}: not a flag variable of this atlas; {allowed_text(variable, flags)}")
    flag_names(ds[variable])  # raises BadInput for averages
    return ds[variable]


def map_variable(ds: xr.Dataset) -> str:
    """What a map shows unless a variable is named: what the scene names, else the first flags that differ, else the label."""
    scene = scene_of(ds)
    if scene is not None and scene.map in ds.data_vars:
        return scene.map
    rank = max((array.ndim for array in ds.data_vars.values()), default=0)
    for name, array in ds.data_vars.items():
        if array.ndim == rank and has_flags(array) and not is_averaged(array):
            # Read in chunks, to the first difference.
            values = (array.isel(box).values.ravel() for box in chunks(array.sizes, array.dims))
            first = next(values)
            if (first != first[:1]).any() or any((each != first[:1]).any() for each in values):
                return str(name)
    return "label" if "label" in ds.data_vars or not ds.data_vars else str(next(iter(ds.data_vars)))


def flag_values(ds: xr.Dataset, variable: str, flags: str | int | Sequence[str | int]) -> list[int]:
    """Values of one or several flags of a variable by their names or numbers; BadInput for unknown ones."""
    allowed = flag_names(flag_variable(ds, variable))
    first = NO_END if variable == END else 0
    is_list = isinstance(flags, Iterable) and not isinstance(flags, str) and getattr(flags, "ndim", 1) != 0
    numbers = []
    for flag in flags if is_list else [flags]:  # type: ignore[union-attr]
        number = np.asarray(
            first + allowed.index(flag) if isinstance(flag, str) and flag in allowed else flag
        )
        if number.ndim or number.dtype.kind not in "iu" or not 0 <= number - first < len(allowed):
            choice, last = allowed_text(flag, allowed), first + len(allowed) - 1
            raise BadInput(f"{variable} = {shown(flag)}: {choice}, or their numbers {first} to {last}")
        numbers.append(int(number))
    return numbers


# Points read at a time.
MAX_POINTS = 4_000_000


def chunks(
    sizes: Mapping[Any, int], dims: Sequence[Hashable], cell_side: int = 0
) -> Iterator[dict[Hashable, slice]]:
    """Slices that cut `dims` into boxes of about MAX_POINTS points, in C order.

    With a cell_side boxes consist of whole cells and share the points on their borders; points at the end of
    an axis that do not fill a cell are in no box.
    """
    step = max(cell_side, 1)
    counts = [(sizes[dim] - 1) // step if cell_side else max(sizes[dim], 1) for dim in dims]
    points_per_count = step ** len(dims) * math.prod(n for dim, n in sizes.items() if dim not in dims)
    tiling = Tiling.of(tuple(counts), MAX_POINTS // points_per_count)
    for box in tiling:
        yield {
            dim: slice(step * part.start, step * part.stop + (cell_side > 0))
            for dim, part in zip(dims, box, strict=True)
        }
