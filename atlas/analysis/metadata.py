"""System, scene, axes and flags of an atlas dataset, from its attributes."""

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

MAX_FLAGS = 128  # of a variable, as many as int8 has numbers from 0 on
TRUE_FALSE = ["false", "true"]  # flags of a variable of Booleans
# In CF's attribute cell_methods: names of dimensions and a method whose results are other numbers than flags.
_AVERAGED = re.compile(
    r"((?:[\w.+-]+[:,]\s*)+)(?:mean|sum|median|mid_range|range|standard_dev|variance|root)"
)


POSITIONS = "atlas_positions"  # attribute of a variable of positions in a list: words for -1 and for a member


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
    numbers = ds.data_vars.keys() & data_variables(system) | ds.variables.keys() & system.parameters.keys()
    for variable in numbers:
        if ds.variables[variable].dtype.kind not in "biuf":
            raise BadInput(f"{variable}: values of type {ds[variable].dtype}; an atlas has numbers there")
    return system


def number_attribute(ds: xr.Dataset, name: str) -> float:
    """A global attribute of an atlas that is a number; BadInput if it is missing or no number."""
    try:
        return float(ds.attrs[name])
    except (KeyError, TypeError, ValueError):
        raise BadInput(f"damaged: the attribute {name} is no number") from None


def scene_of(ds: xr.Dataset, *, needed: bool = False) -> Scene | None:
    """The scene of an atlas, None for points that come from no scene; BadInput if it is needed and lost."""
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
    """Where labels are those of proofs, because the scene integrates no such point; None of other scenes."""
    proofs = [ds[proof] != 0 for label, proof in proofs_of_labels().items() if {label, proof} <= {*ds}]
    scene = scene_of(ds) if proofs else None
    if scene is None or not scene.settings.prove:
        return None
    return reduce(and_, proofs)


def with_measured_labels(ds: xr.Dataset) -> xr.Dataset:
    """The atlas with labels of runs alone: those of proofs are not_computed."""
    if (proved := without_run(ds)) is None:
        return ds
    labels = [label for label in proofs_of_labels() if label in ds]
    return ds.assign({name: ds[name].where(~proved, Label.NOT_COMPUTED).astype(np.int8) for name in labels})


# Coordinates count as equal within this relative difference, or within so many spacings of their type of float.
COORDINATE_ROUNDING, SPACINGS = 1e-9, 8
MAX_COMPARED = 400  # points at which coordinates are compared
CHANGED = (
    "the datasets of several scenes were joined, or coordinates were changed; use an atlas as its run made it"
)


def resolved_scene(ds: xr.Dataset, part: xr.Dataset) -> Scene | None:
    """The scene by which a part of an atlas can be computed again, None for points that come from no scene.

    BadInput unless the coordinates of evenly chosen points, in a lazy part its corners and middles, equal to rounding what the
    scene gives. An axis has some of the scene's values or, where atlases of scenes that agree otherwise were joined, all and more.
    """
    system, scene = system_of(ds), scene_of(ds, needed=True)
    axes = {} if scene is None else axes_of(scene)
    units = {name: parameter.unit for name, parameter in system.parameters.items()}
    units |= {dim: axis.units or units.get(axis.name, "1") for dim, axis in axes.items()}
    # Variables of xarray: DataArrays would take longer, with their coordinates, than all that is computed here.
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
    """Values of a coordinate, each replaced by the value of the scene's axis that it equals to rounding, if there is one."""
    values = np.sort(axis.values)
    nearest = values[np.searchsorted(0.5 * (values[1:] + values[:-1]), here)]
    return np.where(_close(here, nearest), nearest, here)


def _close(here: np.ndarray, own: Array) -> Mask:
    """Whether values of a coordinate equal others to rounding; near 0 to the rounding of differences of numbers of about 1."""
    spacing = np.finfo(here.dtype).eps if here.dtype.kind == "f" else 0.0
    return np.asarray(np.isclose(here, own, max(COORDINATE_ROUNDING, SPACINGS * float(spacing)), 1e-15))


def scene_problem(ds: xr.Dataset, part: xr.Dataset | None = None) -> str:
    """Why an atlas cannot be computed again by the scene that it names; empty if it can or names none."""
    if not ds.attrs.keys().isdisjoint({"atlas_scene", "atlas_parts"}):
        try:
            resolved_scene(ds, ds if part is None else part)
        except BadInput as error:
            return str(error)
    return ""


def settings_of(ds: xr.Dataset) -> Settings:
    """Settings of points that come from no scene, from the attributes of their dataset."""
    method, step = attribute_text(ds.attrs, "atlas_method"), number_attribute(ds, "atlas_step")
    settings = Settings(method=method, rate_tolerance=rate_tolerance_of(ds))
    if math.isfinite(step):
        return replace(settings, step=step)
    return replace(settings, tolerance=number_attribute(ds, "atlas_tolerance"))


def rate_tolerance_of(ds: xr.Dataset) -> float | str:
    """The rate tolerance of a dataset: a number, or arithmetic of its points."""
    if isinstance(value := ds.attrs.get("atlas_rate_tolerance"), str):
        return checks.positive_at_points("atlas_rate_tolerance", value)
    return number_attribute(ds, "atlas_rate_tolerance")


def axes_of(scene: Scene) -> dict[str, Axis]:
    """The axes of a scene by the name of their dimension in the atlas."""
    return {axis.dim: axis for axis in scene.axes.values()}


def common_values(ds: xr.Dataset, scene: Scene) -> dict[str, float | str]:
    """What a scene gives all points of a part of its atlas: parameters, ties as texts, and axes of one value."""
    single = {dim: float(ds[dim]) for dim in axes_of(scene) if dim in ds.coords and ds[dim].ndim == 0}
    return {**scene.fixed, **{name: tie.text for name, tie in scene.ties.items()}, **single}


def is_logarithmic(scene: Scene | None, dim: str, values: ArrayLike) -> bool:
    """Whether the scene spaces this axis logarithmically and all values are positive; maps do the same."""
    axis = None if scene is None else axes_of(scene).get(dim)
    return axis is not None and axis.table.get("spacing") == "log" and bool(np.min(np.asarray(values)) > 0)


def neighbour_axes(ds: xr.Dataset) -> list[str]:
    """Axes along which points have neighbours, as in the scene: not axes of one point, of repeated values or of random draws."""
    scene = scene_of(ds)
    axes, ties = ({}, {}) if scene is None else (axes_of(scene), scene.ties)
    others = {POINT, *(name for tie in ties.values() for name in getattr(tie, "drawn", ()))}
    names = [name for name in dict.fromkeys([*axes, *map(str, ds.coords)]) if name not in others]
    return [name for name in names if is_numeric_axis(ds, name) and ds.indexes[name].is_unique]


def in_order(ds: xr.Dataset, stride: Mapping[str, int]) -> xr.Dataset:
    """An atlas sorted along some axes, with every k-th value of each, from the lowest."""
    order = {dim: np.argsort(ds[dim].values, kind="stable")[::step] for dim, step in stride.items()}
    return ds.isel({dim: i for dim, i in order.items() if not np.array_equal(i, range(ds.sizes[dim]))})


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
def _registry(system: System) -> Mapping[str, Variable]:
    """Variables of the atlases of a system; none of a system that can have no atlas."""
    with suppress(BadInput):
        return data_variables(system)
    return {}


def _positions(ds: xr.Dataset, name: str) -> Sequence[str] | None:
    """`Variable.positions` of the variable of this name, or what its attribute POSITIONS says."""
    own = (attribute_text(ds[name].attrs, POSITIONS) if name in ds else "").split()
    registered = (_registry(system).get(name) for system in systems.SYSTEMS.values())
    named = (variable.positions for variable in registered if variable and variable.positions)
    return own if len(own) == 2 else next(named, None)


def has_flags(array: xr.DataArray) -> bool:
    """Whether a variable is one of flags: Booleans, or flags by their name or by a long_name of their own.

    Differences of flags inherit their attributes: a flag's long_name under another name means numbers. Averages of flags
    may have lost theirs.
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
    """Names of the values 0, 1, 2, ... of a flag variable, else empty; BadInput for averages of flags."""
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
    """Whether a variable has the names of flags but other values, such as averages, of other types or along fewer dimensions."""
    if not has_flags(array):
        return False
    texts = _AVERAGED.findall(attribute_text(array.attrs, "cell_methods"))
    names = re.findall(r"[\w.+-]+", " ".join(texts))
    # NCO writes a method on data that it only joined, whose dimensions are still there.
    gone = any(n not in {*array.dims, *array.coords} or array[n].size < 2 for n in names)
    return gone or array.dtype.kind not in "biu"


def positions_as_flags(ds: xr.Dataset, variable: str) -> xr.Dataset:
    """The dataset with a variable of positions in a list, if this is one, as flags: none, then every position."""
    names = _positions(ds, variable)
    if names is None or variable not in ds or "flag_meanings" in ds[variable].attrs:
        return ds
    flags = ds[variable] + 1
    meanings = [names[0], *(f"{names[1]}_{i}" for i in range(int(flags.max()) if flags.size else 0))]
    return ds.assign(
        {variable: flags.assign_attrs(ds[variable].attrs | {"flag_meanings": " ".join(meanings)})}
    )


def flag_variable(ds: xr.Dataset, variable: str) -> xr.DataArray:
    """The flag variable of this name, positions as flags; BadInput if the dataset has none."""
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
    """Values of a variable of flags from 0 to count - 1; for others BadInput, whose message begins with `words`."""
    values = ds[name].values
    if values.dtype.kind not in "iu" or is_averaged(ds[name]) or not ((values >= 0) & (values < count)).all():
        raise BadInput(f"{name}: {words}: not the flags of an atlas, 0 to {count - 1}")
    return values


def map_variable(ds: xr.Dataset) -> str:
    """Variable of a map by default: the scene's choice, else the label, else the first flags that differ between points."""
    scene = scene_of(ds)
    if scene is not None and scene.map in ds.data_vars:
        return scene.map
    if "label" in ds.data_vars or not ds.data_vars:
        return "label"
    rank = max((array.ndim for array in ds.data_vars.values()), default=0)
    for name, array in ds.data_vars.items():
        if array.ndim == rank and has_flags(array) and not is_averaged(array):
            # Read in chunks, to the first difference.
            values = (array.isel(box).values.ravel() for box in chunks(array.sizes, array.dims))
            first = next(values)
            if (first != first[:1]).any() or any((each != first[:1]).any() for each in values):
                return str(name)
    return str(next(iter(ds.data_vars)))


def flag_values(ds: xr.Dataset, variable: str, flags: str | int | Sequence[str | int]) -> list[int]:
    """Values of one or several flags of a variable by their names or numbers; BadInput for unknown ones."""
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
