"""Equilibria of bodies as datasets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput
from ..flags import Completeness, Stability
from ..measure.instrument import Variable
from ..scene.tables import point_columns, table
from ..systems.base import System

_UNITS = {
    "theta0": ("rad", "angle from the vertical to the third body axis"),
    "psi0": ("rad", "precession angle; 0 where only its sum or difference with phi0 is defined"),
    "phi0": ("rad", "angle of proper rotation"),
    "alpha": ("1", "unit vector along the radius, in body axes"),
    "gamma": ("1", "unit vector along the vertical, in body axes"),
    "potential": ("J", "amended potential"),
    "index": ("1", "Morse index: number of directions in which the amended potential falls"),
    "circle": ("1", "whether the solution represents a circle of equilibria"),
    "axis": ("1", "unit axis in the body about which the body may be turned; nan where isolated"),
    "degenerate": ("1", "isolated, with a zero eigenvalue: on the bifurcation set"),
    "dimension": ("1", "dimension of the set of solutions: 0 isolated, 1 a circle, 2 every direction"),
    "growth_rate": ("rad s-1", "largest real part of the characteristic exponents"),
    "frequency_1": ("rad s-1", "largest frequency of small oscillations"),
    "frequency_2": ("rad s-1", "second frequency of small oscillations"),
    "frequency_3": ("rad s-1", "third frequency of small oscillations"),
    "stable": ("1", "linear stability"),
    "completeness": ("1", "whether the equilibria of a body are all listed"),
    "equilibrium_count": ("1", "number of equilibria"),
    "equilibrium_stable_count": ("1", "number of linearly stable equilibria"),
    "equilibrium_energy_stable_count": ("1", "number of minima of the amended potential"),
}
_FLAGS = {"stable": Stability.meanings(), "completeness": Completeness.meanings()}
_NOT_COUNTED = "nan where some are not isolated or not listed"
# Values of variables, 0 or nan of the others, for a body that cannot exist and an equilibrium that a body does not have.
_UNUSED = {"completeness": Completeness.IMPOSSIBLE_BODY, "index": -1, "dimension": -1}
_DIMS = ("equilibrium", "body_axis")


def equilibria(system: str, body: Any) -> xr.Dataset:
    """All relative equilibria of a satellite, or permanent rotations of a heavy gyrostat about the vertical.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float, array_like or DataArray
        Parameter -> number; those left out take their defaults. Start values have no effect, except n
        of the fixed_point, the rate of rotation in rad per time unit (default 0: rest). For many bodies, DataArrays of
        any dimensions, which are broadcast against each other, or 1-D arrays of one length; or a table of bodies, as
        `label_points` takes one of points.

    Returns
    -------
    Dataset
        Dimension "equilibrium"; a circle of equilibria is listed once, by one of its members. Variables:
        theta0, phi0 and, for the satellite, psi0 (rad), gamma (equilibrium, body_axis), index, circle,
        stable (flags), growth_rate and frequency_1 to frequency_3 (rad per time unit). For the satellite also alpha, axis, degenerate,
        potential, in the order of the potential; for the fixed_point dimension, in the order of theta0.

        Of many bodies: the same over the dimensions of the DataArrays, or the dimension "point" of 1-D arrays, and
        "equilibrium", of which each body uses the first places; in the others index is -1 and what is no flag is nan.
        completeness (flags) states for each body whether all are listed; equilibrium_count,
        equilibrium_stable_count (linearly stable) and equilibrium_energy_stable_count (minima of the amended
        potential) are nan where they are not isolated.

    Raises
    ------
    BadInput
        For bodies that cannot exist, and where every orientation is an equilibrium; of many bodies only if none can
        exist.

    Notes
    -----
    10 000 satellites take about five seconds of one processor. Those with circles of equilibria, on a bifurcation, or without an orbit
    are computed one by one, in about 70 ms each.
    """
    description = systems.get(system)
    if isinstance(body, xr.Dataset):
        names = [name for name in body.variables if name not in body.dims or name in description.parameters]
        body = {str(name): body[name] for name in names}
    else:
        body = table(body, description.parameters)
    if any(np.ndim(value) for value in body.values()):
        return _equilibria_of_bodies(description, body)
    columns, _ = point_columns(description, body)
    description.check(columns)
    description.check_possible(columns)
    solutions = description.equilibria({k: float(v[0]) for k, v in columns.items()})
    return _dataset(
        description,
        "equilibria of one body",
        {name: xr.DataArray(values, dims=_DIMS[: values.ndim]) for name, values in solutions.items()},
        {name: xr.DataArray(column[0]) for name, column in columns.items()},
    )


def _equilibria_of_bodies(description: System, body: Mapping[str, Any]) -> xr.Dataset:
    """Equilibria of the bodies that arrays give."""
    arrays = _broadcast(body)
    template = next(array for array in arrays.values() if array.ndim)
    columns, size = point_columns(
        description,
        {name: array.values.ravel() if array.ndim else array.item() for name, array in arrays.items()},
    )
    description.check(columns)
    description.check_possible(columns)
    possible = np.flatnonzero(description.possible_body(columns))
    equilibria = description.equilibria_of_bodies({k: v[possible] for k, v in columns.items()}, lambda: None)
    isolated = equilibria["completeness"] <= Completeness.NEAR_BIFURCATION
    degenerate = equilibria.get("degenerate", np.zeros(equilibria["index"].shape, bool))
    masks = {
        "equilibrium_count": equilibria["index"] >= 0,
        "equilibrium_stable_count": equilibria["stable"] == Stability.STABLE,
        "equilibrium_energy_stable_count": (equilibria["index"] == 0) & ~degenerate,
    }
    counts = {name: np.where(isolated, mask.sum(1), np.nan) for name, mask in masks.items()}
    variables = {}
    for name, values in (dict(equilibria) | counts).items():
        unused = _UNUSED.get(name, np.nan if values.dtype.kind == "f" else 0)
        full = np.full((size, *values.shape[1:]), unused, values.dtype)
        full[possible] = values
        dims = (*template.dims, *_DIMS[: values.ndim - 1])
        variables[name] = xr.DataArray(
            full.reshape(*template.shape, *values.shape[1:]), template.coords, dims
        )
    constants = {k: arrays.get(k, xr.DataArray(v[0])) for k, v in columns.items()}
    return _dataset(description, f"equilibria of {size} bodies", variables, constants)


def _broadcast(body: Mapping[str, Any]) -> dict[str, xr.DataArray]:
    """Parameters as numbers and as arrays of one shape; an array over a dimension with its own name is its coordinate."""
    arrays: dict[str, xr.DataArray] = {}
    for name, value in body.items():
        if isinstance(value, xr.DataArray):
            arrays[name] = value.drop_vars([c for c in value.coords if c not in value.dims])
            if value.dims == (name,):
                arrays[name] = arrays[name].assign_coords({name: value.values})
        elif np.ndim(value) < 2:
            arrays[name] = xr.DataArray(np.asarray(value), dims=["point"][: np.ndim(value)])
        else:
            raise BadInput(
                f"{name}: an array of {np.ndim(value)} dimensions; give a DataArray, whose dimensions have names"
            )
    reserved = {str(dim) for array in arrays.values() for dim in array.dims} & {*_DIMS}
    if reserved:
        raise BadInput(f"body: the dimension {min(reserved)} is one of the result; rename it")
    try:
        names = [name for name, array in arrays.items() if array.ndim]
        full = xr.broadcast(*xr.align(*(arrays[name] for name in names), join="exact"))
    except ValueError as error:
        raise BadInput(f"body: arrays of different bodies: {' '.join(str(error).split())}") from None
    return arrays | dict(zip(names, full, strict=True))


def _dataset(
    description: System,
    title: str,
    variables: Mapping[str, xr.DataArray],
    constants: Mapping[str, xr.DataArray],
) -> xr.Dataset:
    """Dataset of equilibria with CF attributes, and with the parameters of the bodies as coordinates."""
    ds = xr.Dataset(attrs={"title": f"{title}: {description.title}", "references": description.reference})
    for name, array in variables.items():
        units, long_name = _UNITS.get(name, ("1", name))
        comment = _NOT_COUNTED if name.endswith("_count") else ""
        variable = Variable(name, "int8", units, long_name, _FLAGS.get(name), comment)
        ds[name] = array.assign_attrs(variable.attributes())
    for name, parameter in description.parameters.items():
        if parameter.start and not (constants[name].ndim and np.isfinite(constants[name]).all()):
            continue
        attributes = {"units": parameter.unit, "long_name": parameter.meaning}
        if name in ds.dims:
            ds[name].attrs = attributes
        else:
            values = constants[name]
            ds = ds.assign_coords({name: (values.dims, values.values.astype(float), attributes)})
    return ds
