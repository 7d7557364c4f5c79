"""System, scene, axes and flags of an atlas, as read from the attributes of its dataset."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, reduce
from operator import and_
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import systems
from ..errors import MAX_TEXT, BadInput, allowed_text, attribute_text, printable, shown
from ..flags import Label
from ..measure.instrument import Variable
from ..scene import checks, grid
from ..scene.model import Axis, Duration, Scene, Settings
from ..scene.read import parse_scene
from ..store.tiling import Tiling
from ..systems.base import Array, Mask, System
from ..variables import POINT, data_variables, proofs_of_labels

MAX_FLAGS = 128  # largest number of flags of a variable, because int8 has the numbers 0 to 127
TRUE_FALSE = ["false", "true"]  # flags of a Boolean variable
# Dimensions and a method, such as "time: mean", in the CF attribute cell_methods. Results of the listed methods are not flags.
_AVERAGED = re.compile(
    r"((?:[\w.+-]+[:,]\s*)+)(?:mean|sum|median|mid_range|range|standard_dev|variance|root)"
)
# Attribute of variables that hold positions in a list. If the attribute is "none end", the value -1 is named none, and 0 is named end_0.
POSITIONS = "atlas_positions"


def system_of(ds: xr.Dataset) -> System:
    """Return the system of an atlas. Raise BadInput if the dataset is no atlas, or has texts where an atlas has numbers."""
    if "atlas_system" not in ds.attrs:
        raise BadInput("not an atlas: the attribute atlas_system is missing")
    name, package = ds.attrs["atlas_system"], ds.attrs.get("atlas_system_package")
    if package is not None and name not in systems.names():
        raise BadInput(
            f"the atlas is of the system {shown(name)}, which is not installed here; its package was {shown(package)}"
        )
    system = systems.get(name)
    numbers = ds.data_vars.keys() & data_variables(system) | ds.variables.keys() & system.parameters.keys()
    for variable in numbers:
        if ds.variables[variable].dtype.kind not in "biuf":
            raise BadInput(f"{variable}: values of type {ds[variable].dtype}; an atlas has numbers there")
    return system


def number_attribute(ds: xr.Dataset, name: str) -> float:
    """Return a global attribute of an atlas as a number. Raise BadInput if the attribute is missing or is no number."""
    try:
        return float(ds.attrs[name])
    except (KeyError, TypeError, ValueError):
        raise BadInput(f"damaged: the attribute {name} is no number") from None


def scene_of(ds: xr.Dataset, *, needed: bool = False) -> Scene | None:
    """Return the scene of an atlas, or None for points without a scene. Raise BadInput if the scene is needed but was lost."""
    if "atlas_parts" in ds.attrs:
        from ..store.joined import part_of

        ds = part_of(ds, needed=True)
    text = ds.attrs.get("atlas_scene", "")
    if not isinstance(text, str):
        raise BadInput("not an atlas: the attribute atlas_scene is no text")
    if needed and not text and {"atlas_scene", "atlas_result"} <= ds.attrs.keys():
        raise BadInput("the scene of this atlas is lost: another program emptied its attribute atlas_scene")
    return parse_scene(text, of_atlas=True) if text else None


def without_run(ds: xr.Dataset) -> xr.DataArray | None:
    """Return which points were not integrated because proofs give their labels, or None if the scene does not use proofs."""
    proofs = [ds[proof] != 0 for label, proof in proofs_of_labels().items() if {label, proof} <= {*ds}]
    scene = scene_of(ds) if proofs else None
    if scene is None or not scene.settings.prove:
        return None
    return reduce(and_, proofs)


def with_measured_labels(ds: xr.Dataset) -> xr.Dataset:
    """Return the atlas with the label not_computed at points that were not integrated because their labels are proved."""
    if (proved := without_run(ds)) is None:
        return ds
    labels = [label for label in proofs_of_labels() if label in ds]
    return ds.assign({name: ds[name].where(~proved, Label.NOT_COMPUTED).astype(np.int8) for name in labels})


# Coordinates count as equal up to the relative difference COORDINATE_ROUNDING or SPACINGS machine epsilons, whichever is larger.
COORDINATE_ROUNDING, SPACINGS = 1e-9, 8
MAX_COMPARED = 400  # coordinates are compared with the scene at no more than about this many points
CHANGED = (
    "the datasets of several scenes were joined, or coordinates were changed; use an atlas as its run made it"
)


def resolved_scene(ds: xr.Dataset, part: xr.Dataset) -> Scene | None:
    """Return the scene from which a part of an atlas can be computed again, or None for points without a scene.

    Raise BadInput if a coordinate differs from the scene by more than rounding. All values of axes are compared. Other
    coordinates are compared at evenly spaced points, with at most three along each dimension if coordinates are lazy. An axis may
    lack values of the scene. If an axis has other values, as after a join, the axis must also have all values of the scene.
    """
    system, scene = system_of(ds), scene_of(ds, needed=True)
    axes = {} if scene is None else axes_of(scene)
    units = {name: parameter.unit for name, parameter in system.parameters.items()}
    units |= {dim: axis.units or units.get(axis.name, "1") for dim, axis in axes.items()}
    # `ds.variables` is read instead of `ds`, because making DataArrays with coordinates takes longer than the comparison.
    numbers = {n: v for n in units if n in ds.coords and (v := ds.variables[n]).dtype.kind in "iuf"}
    for name, variable in numbers.items():
        unit = attribute_text(variable.attrs, "units")
        if unit.lower().startswith(("deg", "\N{DEGREE SIGN}")) and not units[name].startswith("deg"):
            raise BadInput(f"{name}: units {unit} here, {units[name]} by the scene or system: {CHANGED}")
    if scene is None:
        return None
    if scene.system.name != system.name:
        raise BadInput(
            f"atlas_system = {shown(system.name)} here, {scene.system.name} by its scene: {CHANGED}"
        )
    for dim, axis in axes.items():
        if dim not in numbers:
            raise BadInput(
                f"{dim}: this axis of the scene is not in the dataset: it was renamed, dropped or averaged over"
            )
        values = axis_values(numbers[dim].values, axis)
        other = ~np.isin(values, axis.values)
        if other.any() and (scene.points is not None or not np.isin(axis.values, values).all()):
            value = f"{values[other][0]:.12g}"
            raise BadInput(f"{dim} = {value} here, no value of this axis of its scene: {CHANGED}")
    is_lazy = any(variable.chunks for variable in numbers.values())
    count = 3 if is_lazy else round(MAX_COMPARED ** (1 / max(len(part.dims), 1)))
    some = {dim: np.linspace(0, n - 1, min(n, count)).astype(int) for dim, n in part.sizes.items()}
    sizes, columns = {dim: index.size for dim, index in some.items()}, dict[str, np.ndarray]()
    for name in numbers:
        if (variable := part.variables[name]).dims:
            variable = variable.isel(some, missing_dims="ignore").set_dims(sizes)
        columns[name] = np.broadcast_to(variable.values.ravel(), math.prod(sizes.values()))
    places = {axis.name: axis_values(columns.pop(dim), axis) for dim, axis in axes.items()}
    base = grid.points_at(replace(scene, duration=Duration(1.0), nudge={}), places).base
    for name, here in columns.items():
        wrong = (here != base[name]) & ~np.isnan(here)
        wrong[wrong] = ~_close(here[wrong], base[name][wrong])
        if wrong.any():
            texts = (f"{each[wrong][0]:.12g}" for each in (here, base[name]))
            raise BadInput(f"{name} = {' here, '.join(texts)} by the scene of this dataset: {CHANGED}")
    return scene


def axis_values(here: np.ndarray, axis: Axis) -> Array:
    """Return the coordinate values `here`. A value that is `_close` to a value of the scene's axis is replaced by the value of the axis."""
    values = np.sort(axis.values)
    nearest = values[np.searchsorted(0.5 * (values[1:] + values[:-1]), here)]
    return np.where(_close(here, nearest), nearest, here)


def _close(here: np.ndarray, own: Array) -> Mask:
    """Whether |here - own| is at most 1e-15 + r |own|, where r is the larger of COORDINATE_ROUNDING and SPACINGS machine epsilons."""
    spacing = np.finfo(here.dtype).eps if here.dtype.kind == "f" else 0.0
    return np.asarray(np.isclose(here, own, max(COORDINATE_ROUNDING, SPACINGS * float(spacing)), 1e-15))


def scene_problem(ds: xr.Dataset, part: xr.Dataset | None = None) -> str:
    """Return the reason why an atlas cannot be computed again from its scene. The text is empty if there is no reason or no scene."""
    if not ds.attrs.keys().isdisjoint({"atlas_scene", "atlas_parts"}):
        try:
            resolved_scene(ds, ds if part is None else part)
        except BadInput as error:
            return str(error)
    return ""


def settings_of(ds: xr.Dataset) -> Settings:
    """Return the settings of points without a scene, from the attributes of their dataset."""
    method, step = attribute_text(ds.attrs, "atlas_method"), number_attribute(ds, "atlas_step")
    settings = Settings(method=method, rate_tolerance=rate_tolerance_of(ds))
    if math.isfinite(step):
        return replace(settings, step=step)
    return replace(settings, tolerance=number_attribute(ds, "atlas_tolerance"))


def rate_tolerance_of(ds: xr.Dataset) -> float | str:
    """Return the rate tolerance of a dataset, as a number or as arithmetic in the parameters of the points."""
    if isinstance(value := ds.attrs.get("atlas_rate_tolerance"), str):
        return checks.positive_at_points("atlas_rate_tolerance", value)
    return number_attribute(ds, "atlas_rate_tolerance")


def axes_of(scene: Scene) -> dict[str, Axis]:
    """Return the axes of a scene by the names of their dimensions in the atlas."""
    return {axis.dim: axis for axis in scene.axes.values()}


def common_values(ds: xr.Dataset, scene: Scene) -> dict[str, float | str]:
    """Return, by name, the values of parameters that do not vary over a part of an atlas, and the texts of tied parameters."""
    single = {dim: float(ds[dim]) for dim in axes_of(scene) if dim in ds.coords and ds[dim].ndim == 0}
    return {**scene.fixed, **{name: tie.text for name, tie in scene.ties.items()}, **single}


def is_logarithmic(scene: Scene | None, dim: str, values: ArrayLike) -> bool:
    """Whether the scene spaces an axis logarithmically and all values are positive, as a map with a logarithmic axis needs."""
    axis = None if scene is None else axes_of(scene).get(dim)
    return axis is not None and axis.table.get("spacing") == "log" and bool(np.min(np.asarray(values)) > 0)


def neighbour_axes(ds: xr.Dataset) -> list[str]:
    """Return the axes with distinct numbers, except axes that count listed points or random draws. Points and draws have no neighbours."""
    scene = scene_of(ds)
    axes, ties = ({}, {}) if scene is None else (axes_of(scene), scene.ties)
    others = {POINT, *(name for tie in ties.values() for name in getattr(tie, "drawn", ()))}
    names = [name for name in dict.fromkeys([*axes, *map(str, ds.coords)]) if name not in others]
    return [name for name in names if is_numeric_axis(ds, name) and ds.indexes[name].is_unique]


def in_order(ds: xr.Dataset, stride: Mapping[str, int]) -> xr.Dataset:
    """Return an atlas sorted along the axes in `stride`. A stride of k keeps every k-th value, from the lowest."""
    order = {dim: np.argsort(ds[dim].values, kind="stable")[::step] for dim, step in stride.items()}
    return ds.isel({dim: i for dim, i in order.items() if not np.array_equal(i, range(ds.sizes[dim]))})


def check_not_empty(ds: xr.Dataset) -> None:
    """Raise BadInput for a dataset without points."""
    for dim, size in ds.sizes.items():
        if size == 0:
            raise BadInput(f"{dim}: has no values here: the dataset is empty")


def is_numeric_axis(ds: xr.Dataset, dim: object) -> bool:
    """Whether `dim` is a dimension with a numeric coordinate."""
    return dim in ds.dims and dim in ds.coords and ds[dim].dtype.kind in "iuf"


def numeric_coordinates(ds: xr.Dataset, dim: str) -> list[str]:
    """Return the names of the numeric coordinates whose only dimension is `dim`."""
    return [str(name) for name, c in ds.coords.items() if c.dims == (dim,) and c.dtype.kind in "iuf"]


@lru_cache
def _registry(system: System) -> Mapping[str, Variable]:
    """Return the variables of the atlases of a system, or no variables if the system can have no atlas."""
    with suppress(BadInput):
        return data_variables(system)
    return {}


def _positions(ds: xr.Dataset, name: str) -> Sequence[str] | None:
    """Return the name of the value -1 and the stem of the names of other values, or None if a variable holds no positions in a list."""
    own = (attribute_text(ds[name].attrs, POSITIONS) if name in ds else "").split()
    registered = (_registry(system).get(name) for system in systems.SYSTEMS.values())
    named = (variable.positions for variable in registered if variable and variable.positions)
    return own if len(own) == 2 else next(named, None)


def has_flags(array: xr.DataArray) -> bool:
    """Whether a variable has flags.

    A Boolean variable has flags. Another variable has flags if it has flag_meanings, and either the name of a flag variable or a
    long_name that no flag variable has. A variable with only the long_name of a flag variable is a difference of flags, and has
    none. Floats under the name of a flag variable are averages of flags. Averages count as flags, even without attributes.
    """
    if array.dtype.kind == "b":
        return True
    registered = [v for system in systems.SYSTEMS.values() for v in _registry(system).values() if v.flags]
    known, text = any(array.name == v.name for v in registered), str(array.attrs.get("long_name"))
    if known and array.dtype.kind == "f":
        return True
    own = "long_name" in array.attrs and not any(text == v.long_name for v in registered)
    return "flag_meanings" in array.attrs and (known or own)


def flag_names(array: xr.DataArray) -> list[str]:
    """Return the names of the flags 0, 1, 2, ..., or an empty list if the variable has no flags. Raise BadInput for averages of flags."""
    if array.dtype.kind == "b":
        return TRUE_FALSE
    if not has_flags(array):
        return []
    if is_averaged(array):
        what, remedy = f"values of type {array.dtype}", "mask with where(condition, 0)"
        if array.dtype.kind in "biu":
            what = f"values with cell_methods = {shown(array.attrs['cell_methods'])}"
            remedy = "remove this attribute from data that were only joined"
        elif "flag_meanings" in array.attrs and not any(
            (array.isel(box) % 1).any() for box in chunks(array.sizes, array.dims)
        ):
            raise BadInput(
                f"{array.name}: {what} are no flags: they were averaged, or written as floats;"
                ' as all are whole numbers here, .astype("int8") makes flags of them'
            )
        raise BadInput(
            f"{array.name}: {what} are no flags: they were averaged, interpolated or masked with nan;"
            f" choose points by select, sel or isel, or {remedy}"
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
    """Whether a flag variable holds averages or other numbers that are no flags, according to its type or its cell_methods."""
    if not has_flags(array):
        return False
    texts = _AVERAGED.findall(attribute_text(array.attrs, "cell_methods"))
    names = re.findall(r"[\w.+-]+", " ".join(texts))
    # NCO writes cell_methods even for data that were only joined. The dimensions of such data still exist.
    gone = any(n not in {*array.dims, *array.coords} or array[n].size < 2 for n in names)
    return gone or array.dtype.kind not in "biu"


def positions_as_flags(ds: xr.Dataset, variable: str) -> xr.Dataset:
    """Return the dataset. If the variable holds positions in a list, flag i + 1 replaces position i, and flag 0 means no position."""
    names = _positions(ds, variable)
    if names is None or variable not in ds or "flag_meanings" in ds[variable].attrs:
        return ds
    flags = ds[variable] + 1
    meanings = [names[0], *(f"{names[1]}_{i}" for i in range(int(flags.max()) if flags.size else 0))]
    return ds.assign(
        {variable: flags.assign_attrs(ds[variable].attrs | {"flag_meanings": " ".join(meanings)})}
    )


def flag_variable(ds: xr.Dataset, variable: str) -> xr.DataArray:
    """Return the flag variable of a name, with flags for positions in a list. Raise BadInput for averages and variables without flags."""
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


def flags_of(ds: xr.Dataset, name: str, count: int, words: str = "damaged") -> np.ndarray:
    """Return the values of a flag variable. Raise BadInput, with `words` in the message, unless all are integers from 0 to `count` - 1."""
    values = ds[name].values
    if values.dtype.kind not in "iu" or is_averaged(ds[name]) or not ((values >= 0) & (values < count)).all():
        raise BadInput(f"{name}: {words}: not the flags of an atlas, 0 to {count - 1}")
    return values


def map_variable(ds: xr.Dataset) -> str:
    """Return the default variable of a map, which is the scene's choice, else the label, else the first flag that is not constant."""
    scene = scene_of(ds)
    if scene is not None and scene.map in ds.data_vars:
        return scene.map
    if "label" in ds.data_vars or not ds.data_vars:
        return "label"
    rank = max((array.ndim for array in ds.data_vars.values()), default=0)
    for name, array in ds.data_vars.items():
        if array.ndim == rank and has_flags(array) and not is_averaged(array):
            # Chunks are read only up to the first difference.
            values = (array.isel(box).values.ravel() for box in chunks(array.sizes, array.dims))
            first = next(values)
            if (first != first[:1]).any() or any((each != first[:1]).any() for each in values):
                return str(name)
    return str(next(iter(ds.data_vars)))


def flag_values(ds: xr.Dataset, variable: str, flags: str | int | Sequence[str | int]) -> list[int]:
    """Return the values of one or several flags of a variable, given by names or numbers. Raise BadInput for unknown flags."""
    allowed = flag_names(flag_variable(ds, variable))
    first = -1 if _positions(ds, variable) else 0
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


# Largest number of points read at a time.
MAX_POINTS = 4_000_000


def chunks(
    sizes: Mapping[Any, int], dims: Sequence[Hashable], cell_side: int = 0
) -> Iterator[dict[Hashable, slice]]:
    """Return slices that cut `dims` into boxes of about MAX_POINTS points, in C order.

    If `cell_side` is given (in points), boxes consist of whole cells and share the points on their borders. Points at the end of
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
