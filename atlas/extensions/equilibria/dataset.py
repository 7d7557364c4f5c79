"""Equilibria of bodies as datasets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import xarray as xr

from ... import systems
from ...errors import BadInput
from ...flags import Completeness, EnergyStability, Stability, StabilityKind
from ...measure.instrument import Variable
from ...scene.checks import typed, whole_number
from ...scene.tables import Table, flat_columns, parameter_arrays, table
from ...store import dataset
from ...systems.base import Array, Points, System, check_possible, possible_body, subset
from .algebra import numbers

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
    "energy_stable": ("1", "stability by the energy"),
    "stability_kind": ("1", "linear stability and stability by the energy"),
    "completeness": ("1", "whether the equilibria of a body are all listed"),
    "equilibrium_count": ("1", "number of equilibria"),
    "equilibrium_stable_count": ("1", "number of linearly stable equilibria"),
    "equilibrium_energy_stable_count": ("1", "number of minima of the amended potential"),
}
_FLAGS = {
    "stable": Stability.meanings(), "energy_stable": EnergyStability.meanings(),
    "stability_kind": StabilityKind.meanings(), "completeness": Completeness.meanings(),
}  # fmt: skip
_NOT_COUNTED = "nan where completeness is not complete"
# Impossible bodies and unused places have these values. Other variables have nan or 0 there.
UNUSED = {"completeness": Completeness.IMPOSSIBLE_BODY, "index": -1, "dimension": -1}
_DIMS = ("equilibrium", "body_axis")


@typed
def equilibria(system: str, body: Table, *, max_equilibria: int | None = None) -> xr.Dataset:
    """All relative equilibria of a satellite, or permanent rotations of a heavy gyrostat about the vertical.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float, array_like or DataArray
        Parameter -> number. Parameters that are left out take their defaults. Start values have no effect, except n of the
        fixed_point, which is the rate of rotation in rad per time unit (default 0, at rest). Many bodies are given by DataArrays of
        any dimensions, which are broadcast against each other, by 1-D arrays of one length, or by a table in one of the forms of
        points in `label_points`.
    max_equilibria : int, optional
        Length of the dimension "equilibrium". The default is the number of equilibria of one body. For many bodies it is 24 (satellite)
        or 12 (fixed_point). Arrays of dask need a length, and give a lazy result. Without circles a satellite has at most 24 equilibria.

    Returns
    -------
    Dataset
        Dimension "equilibrium"; a circle of equilibria is listed once, by one of its members. Variables:
        theta0, phi0 and, for the satellite, psi0 (rad), gamma (equilibrium, body_axis), index, circle,
        stable, energy_stable, stability_kind (flags), growth_rate and frequency_1 to frequency_3 (rad per time unit). For the
        satellite also alpha, axis, degenerate and potential; for the fixed_point also dimension. Equilibria of the satellite are
        ordered by the potential, then by the components of alpha and gamma (for a circle, by the means of these components).
        Rotations of the fixed_point are ordered by theta0.

        For many bodies the variables have the dimensions of the DataArrays, or the dimension "point" of 1-D arrays, and
        "equilibrium". Each body uses the first places. In unused places index is -1, and variables other than flags are nan.
        completeness (flags) states for each body whether all equilibria are listed. equilibrium_count,
        equilibrium_stable_count (linearly stable) and equilibrium_energy_stable_count (minima of the amended potential) are
        nan where equilibria are not isolated or not certain. Solutions that merge are then listed once, as degenerate.

    Raises
    ------
    BadInput
        If a single body cannot exist, if every orientation of this body is an equilibrium, or if the number of equilibria or
        an index is not certain. If none of many bodies can exist; a lazy result marks such bodies instead. If there
        are more equilibria than `max_equilibria`.

    Notes
    -----
    Equilibria form circles where, to the last bit, two moments are equal and rotor, magnet and drag have no component across the
    axis of symmetry. Near such a body all isolated equilibria are listed if moments differ by at least about 1e-12 (relative). With equal
    moments, components across the axis must be at least about 1e-7. Nearer to such a body the number of equilibria is not certain.
    The same holds within about 1e-10 of a bifurcation, where solutions are closer than 1e-5.

    10 000 satellites take about seven seconds of one processor, less with an axis of symmetry. A single satellite near a symmetry
    or a bifurcation takes up to 0.2 seconds.
    """
    description = systems.get(system)
    if max_equilibria is not None:
        whole_number("max_equilibria", max_equilibria, 1)
    source = table(body, description.parameters)
    names, arrays, _ = parameter_arrays(description, source)
    by_name = dict(zip(names, arrays, strict=True))
    if max_equilibria is None and not any(array.ndim for array in arrays):
        columns = flat_columns(description, names, [array.values for array in arrays], (), source)
        description.check(columns)
        check_possible(description, columns)
        solutions = description.equilibria({k: float(v[0]) for k, v in columns.items()})
        ds = xr.Dataset({name: (_DIMS[: values.ndim], values) for name, values in solutions.items()})
        return _dataset(description, "equilibria of one body", ds, by_name)
    for dim in _DIMS:
        if any(dim in array.dims for array in arrays):
            raise BadInput(f"body: the dimension {dim} is one of the result; rename it")
    if (lazy := any(array.chunks is not None for array in arrays)) and max_equilibria is None:
        raise BadInput(
            "max_equilibria: needed for arrays of dask, as the length of the dimension equilibrium"
        )
    kinds = _kinds(description)
    results = xr.apply_ufunc(
        partial(_equilibria_of_bodies, system, names, max_equilibria, None if lazy else source), *arrays or [xr.DataArray(0.0)],
        dask="parallelized", output_dtypes=[values.dtype for values in kinds.values()],
        output_core_dims=[_DIMS[: values.ndim] for values in kinds.values()],
        dask_gufunc_kwargs={"output_sizes": {"equilibrium": max_equilibria, "body_axis": 3}} if lazy else None,
    )  # fmt: skip
    ds = xr.Dataset(dict(zip(kinds, results, strict=True)))
    return _dataset(description, f"equilibria of {ds['completeness'].size} bodies", ds, by_name)


def attributes(name: str) -> dict[str, object]:
    """Return the CF attributes of a variable of equilibria."""
    units, long_name = _UNITS.get(name, ("1", name))
    comment = _NOT_COUNTED if name.endswith("_count") else ""
    return Variable(name, "int8", units, long_name, _FLAGS.get(name), comment).attributes()


@cache
def _kinds(system: System) -> dict[str, np.ndarray]:
    """Return the variables of the default body, as examples of types and shapes."""
    body = flat_columns(system, (), (), (), None)
    return {name: values[0] for name, values in _with_counts(system, body).items()}


def _with_counts(system: System, bodies: Points) -> dict[str, np.ndarray]:
    """Return the equilibria of possible bodies, with counts."""
    every = system.equilibria_of_bodies(bodies, lambda: None)
    return {**every, **numbers(every)}


def _equilibria_of_bodies(
    system_name: str, names: Sequence[str], places: int | None, source: Any, *arrays: Array
) -> tuple[np.ndarray, ...]:
    """Return the variables of the equilibria of bodies. `xr.apply_ufunc` calls this function, with dask for each chunk.

    The dimension equilibrium has the length `places`. If `places` is None, the length is 24 (satellite) or 12 (fixed_point). Messages
    name rows of the table `source`. If all bodies are impossible, BadInput is raised, unless `source` is None.
    """
    system, shape = systems.get(system_name), np.broadcast_shapes(*(array.shape for array in arrays))
    columns = flat_columns(system, names, arrays[: len(names)], shape, source)
    system.check(columns)
    if source is not None:
        check_possible(system, columns)
    possible = np.flatnonzero(possible_body(system, columns))
    some = {name: values[np.newaxis][:0] for name, values in _kinds(system).items()}
    if possible.size:
        some = _with_counts(system, subset(columns, possible))
    needed = int((some["index"] >= 0).sum(1).max(initial=0))
    places = places or some["index"].shape[1]
    if needed > places:
        raise BadInput(f"max_equilibria = {places}: a body has {needed} equilibria")
    results = []
    for name, values in some.items():
        unused = UNUSED.get(name, np.nan if values.dtype.kind == "f" else 0)
        rows = values[:, :places] if values.ndim > 1 else values
        inner = (places, *rows.shape[2:])[: rows.ndim - 1]
        full = np.full((math.prod(shape), *inner), unused, values.dtype)
        full[possible if values.ndim == 1 else (possible, slice(rows.shape[1]))] = rows
        results.append(full.reshape((*shape, *inner)))
    return tuple(results)


def _dataset(
    description: System, title: str, ds: xr.Dataset, arrays: Mapping[str, xr.DataArray]
) -> xr.Dataset:
    """Return a dataset of equilibria with CF attributes. The parameters of the bodies are coordinates."""
    for name in map(str, ds.data_vars):
        ds[name].attrs = attributes(name)
    starts = {name for name, parameter in description.parameters.items() if parameter.start}
    varying = {name for name, array in arrays.items() if array.ndim}
    ds = dataset.with_parameters(ds, description, arrays, leave_out=starts - varying)
    ds.attrs = {"title": f"{title}: {description.title}", "references": description.reference}
    return ds
