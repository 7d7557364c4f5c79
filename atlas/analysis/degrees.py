"""Conversion of angles. Only arguments and results may be in degrees, and no other module converts angles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from ..errors import attribute_text

Data = TypeVar("Data", xr.Dataset, xr.DataArray)
RAD, DEGREE = "rad", "degree"  # values of the attribute units


def factor(attributes: Mapping[Any, Any], degrees: bool | None = True) -> float:
    """Return the factor from the values of a variable to the values shown: 180 / pi for an angle in rad, otherwise 1.

    If `degrees` is None, the attribute display_units decides.
    """
    if degrees is None:
        degrees = attribute_text(attributes, "display_units") == "deg"
    return math.degrees(1.0) if degrees and attribute_text(attributes, "units") == RAD else 1.0


def in_degrees(data: Data, degrees: bool | None = True) -> Data:
    """Return the data with angles in degrees; see `factor` for `degrees`."""
    return _scale(
        data, {n: f for n, v in _variables(data).items() if (f := factor(v.attrs, degrees)) != 1}, DEGREE
    )


def in_rad(data: Data) -> Data:
    """Return the data with angles in rad."""
    units = {name: attribute_text(variable.attrs, "units") for name, variable in _variables(data).items()}
    return _scale(data, {name: math.radians(1.0) for name, unit in units.items() if unit == DEGREE}, RAD)


def _variables(data: Data) -> Mapping[str, xr.DataArray]:
    """Return the coordinates and variables of a dataset by name. An array is returned under the name "", after its coordinates."""
    if isinstance(data, xr.DataArray):
        return {**{str(name): each for name, each in data.coords.items()}, "": data}
    return {str(name): data[name] for name in data.variables}


def _scale(data: Data, factors: Mapping[str, float], units: str) -> Data:
    """Return data with some variables multiplied by factors, in new units. A multi-index with such a variable becomes plain coordinates."""
    levels = [str(data[name].dims[0]) for name in factors if name in data.indexes and name not in data.dims]
    data = data.reset_index(list(set(levels))) if levels else data
    variables, new = _variables(data), dict[str, xr.Variable]()
    for name, number in factors.items():
        old = variables[name].variable
        new[name] = xr.Variable(old.dims, old.data * number, old.attrs | {"units": units})
    if isinstance(data, xr.DataArray):
        data = data.copy(data=new[""].data).assign_attrs(units=units) if "" in new else data
        return data.assign_coords({name: each for name, each in new.items() if name})
    coordinates = {name: each for name, each in new.items() if name in data.coords}
    return data.assign_coords(coordinates).assign({n: v for n, v in new.items() if n not in coordinates})


def lines_in_degrees(
    lines: Mapping[str, list[np.ndarray]], axes: list[xr.DataArray], degrees: bool | None
) -> dict[str, list[np.ndarray]]:
    """Return lines over the given axes with angles in degrees; see `factor` for `degrees`."""
    factors = [factor(axis.attrs, degrees) for axis in axes]
    return {kind: [line * factors for line in group] for kind, group in lines.items()}
