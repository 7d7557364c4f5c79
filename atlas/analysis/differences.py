"""Comparison of two atlases on the same grid by changes of flags and differences of numbers."""

from __future__ import annotations

import difflib
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from ..errors import MAX_MESSAGE, BadInput, attribute_text, printable, shown, text_table
from ..kernel.statistics import RATES
from ..kernel.tableaux import METHODS
from ..measure import circle
from ..measure.instrument import Variable
from ..scene.checks import choice, whole_number
from ..store.joined import part_of
from ..variables import main_instrument
from .compare import confusion, place
from .degrees import factor, in_degrees
from .metadata import flag_names, flags_of, has_flags, numeric_coordinates, scene_of, system_of

# The errors of these variables are relative to the bound of the fastest frequency.
OVER_BOUND = (*RATES, *circle.AXIS_RATES)


def report(first: xr.Dataset, second: xr.Dataset, worst: int = 5, degrees: bool | None = None) -> str:
    """Return a text that says how the second atlas differs from the first; see `Atlas.compare`."""
    whole_number("worst", worst, 0)
    flags, numbers = _common_variables(first, second)
    shown = in_degrees(first.coords.to_dataset(), degrees)
    second = part_of(second)
    lines = [f"{w}: {attribute_text(ds.attrs, 'title')}" for w, ds in (("first", first), ("second", second))]
    scenes = [scene_of(ds) for ds in (first, second)]
    texts = [[] if scene is None else scene.toml().split("\n") for scene in scenes]
    changes = difflib.unified_diff(texts[0], texts[1], n=0, lineterm="")
    lines += [f"  {line}" for line in changes if line[:2] not in ("--", "++", "@@")]
    unchanged, rows = [], [["variable", "largest difference", "over error_estimate", "place"]]
    for name in flags:
        names, dims = flag_names(first[name]), [*map(str, first[name].dims)]
        a, b = (flags_of(ds.transpose(..., *dims), name, len(names)) for ds in (first, second))
        places = np.argwhere(a != b)
        if not len(places):
            unchanged.append(name)
            continue
        lines.append(f"{name}: {len(places)} of {a.size} points change ({100 * len(places) / a.size:.3g} %)")
        if name.startswith("label"):
            lines += [f"  {row}" for row in confusion("first \\ second", a, b, names)]
            for i in map(tuple, places[:worst]):
                where = place(shown, dict(zip(dims, i, strict=True)))
                lines.append(f"  {where}: {names[a[i]]} to {names[b[i]]}")
    for name in numbers:
        ours, theirs = first[name].variable, second[name].variable
        # A difference is infinite if only one atlas has a value. The difference inf - inf is nan, which counts as 0.
        difference = abs(ours - theirs).where(ours.isnull() == theirs.isnull(), np.inf).fillna(0.0)
        if not difference.any():
            unchanged.append(name)
            continue
        estimate = _estimate(first, second, name)
        ratio = (difference / (1.0 if estimate is None else estimate)).fillna(0.0)  # 0 / 0 is nan
        where = place(shown, {str(dim): int(index) for dim, index in ratio.argmax(ratio.dims).items()})
        over = "-" if estimate is None else f"{float(ratio.max()):.3g}"
        largest = float(difference.max()) * factor(first[name].attrs, degrees)
        rows.append([name, f"{largest:.3g}", over, where])
    lines += text_table(rows).split("\n") if len(rows) > 1 else []
    lines += [f"the same at every point: {', '.join(unchanged)}"] if unchanged else []
    return "\n".join(printable(line, MAX_MESSAGE) for line in lines)


def differences(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Return changes of flags and numbers from `first` to `second`. Numbers change by `second` minus `first`; see `Atlas.differences`."""
    flags, numbers = _common_variables(first, second)
    result: dict[str, xr.Variable] = {}
    for name in flags:
        ours, theirs = first[name].variable, second[name].variable
        meanings = dict.fromkeys(["unchanged", *(f"to_{flag}" for flag in flag_names(first[name]))], "")
        result[f"{name}_change"] = changed = (theirs + 1).where(ours != theirs, 0).astype(np.int8)
        changed.attrs = Variable(name, "int8", "1", f"change of {name}", meanings).attributes()
    for name in numbers:
        result[f"{name}_difference"] = difference = second[name].variable - first[name].variable
        units = attribute_text(first[name].attrs, "units", "1")
        difference.attrs = {"long_name": f"difference of {name}", "units": units}
    return xr.Dataset(result, first.coords, first.attrs)


def _common_variables(first: xr.Dataset, second: xr.Dataset) -> tuple[list[str], list[str]]:
    """Return the names of flags and of numbers that both atlases have. Raise BadInput unless both have the same system and grid."""
    if not isinstance(second, xr.Dataset):
        raise BadInput(f"other = {shown(second)}: must be the dataset of an atlas")
    systems, problems = [system_of(ds).name for ds in (first, second)], []
    if systems[0] != systems[1]:
        problems.append(f"the systems are {systems[0]} and {systems[1]}")
    for dim in map(str, dict.fromkeys([*first.dims, *second.dims])):
        sizes = [ds.sizes.get(dim, 0) for ds in (first, second)]
        names = [dim] if dim in first.indexes else numeric_coordinates(first, dim)
        if sizes[0] != sizes[1]:
            problems.append(f"{dim} has {sizes[0]} and {sizes[1]} values")
        elif not all(n in second.coords and first[n].variable.equals(second[n].variable) for n in names):
            problems.append(f"{dim} has other values")
    if problems:
        raise BadInput(f"these atlases are not on the same grid: {'; '.join(problems)}")
    flags, numbers = [], []
    for name in (str(n) for n in first.data_vars if n in second and {*first[n].dims} == {*second[n].dims}):
        a, b = first[name], second[name]
        if all(map(has_flags, (a, b))):
            flags += [name] if flag_names(a) == flag_names(b) else []
        elif a.dtype.kind in "iuf" and b.dtype.kind in "iuf":
            numbers.append(name)
    return flags, numbers


def _estimate(first: xr.Dataset, second: xr.Dataset, name: str) -> Any:
    """Return the larger error estimate of a variable in two atlases, in the unit of the variable, or None if no estimate is known."""
    system, stem = system_of(first), name.rpartition("_")[0]
    if name not in (*main_instrument(system).statistics(system), *OVER_BOUND, *circle.ANGLES):
        return None
    with suppress(KeyError):
        error = np.fmax(first["error_estimate"].variable, second["error_estimate"].variable)
        if system.observables:
            low, high = (abs(first[f"{stem}_{end}"].variable) for end in ("min", "max"))
            return error * np.fmax(low, high)
        if name in OVER_BOUND:
            method = METHODS[choice("atlas_method", attribute_text(first.attrs, "atlas_method"), METHODS)]
            return error * first["step_ratio"].variable * method.stability / first["step"].variable
        return error
    return None
