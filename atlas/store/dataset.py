"""The atlas as a Dataset of variables and parameters, with the provenance in attributes."""

from __future__ import annotations

import logging
import math
import platform
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from .. import systems
from .._version import __version__
from ..errors import BadInput
from ..measure.observables import std_tolerances
from ..scene import grid
from ..scene.model import About, Duration, Scene, Settings
from ..systems.base import System, extensions_of
from ..variables import COMPUTED, data_variables, is_measured

# Names of attributes of an atlas.
HISTORY = "atlas_history"  # numbers of points taken from each earlier atlas
HASH = "atlas_sha256"  # hash of the content, added when the atlas is finished
VERSION = "atlas_version"
TRANSIENT = "atlas_transient"  # missing if there is no transient
EARLIER_HASHES = {"atlas_seal", "atlas_checksum", "atlas_chunks"}  # in stores of versions before 0.1.0
# A parameter with more values than this is a dask array, computed chunk by chunk on use.
MAX_EAGER_VALUES = 4_000_000
Box: TypeAlias = tuple[slice, ...]
# A box of the grid, and the values of the variables in the box by name.
Block: TypeAlias = tuple[Box, Mapping[str, np.ndarray]]


def dims(scene: Scene) -> tuple[str, ...]:
    """Return the names of the dimensions of the atlas of a scene."""
    return tuple(axis.dim for axis in scene.axes.values())


def dataset(scene: Scene, columns: Mapping[str, Any], chunks: Sequence[int] | None = None) -> xr.Dataset:
    """Return the atlas of a scene, made of outputs and solved parameters. With `chunks`, large parameters are dask arrays."""
    dimensions, system = dims(scene), scene.system
    variables, coordinates = dict[str, Any](), dict[str, Any]()
    for name in (*scene.outputs, *({COMPUTED.name} & columns.keys())):
        values = columns[name].reshape(scene.shape)
        variables[name] = dimensions, values, variable_attributes(system, name, scene.outputs)
        if scene.settings.prove and is_measured(system, name):
            comments = variables[name][2].get("comment"), "nan where a proof gives the label"
            variables[name][2]["comment"] = "; ".join(filter(None, comments))
    for name, axis in zip(dimensions, scene.axes.values(), strict=True):
        attributes = parameter_attributes(scene.system, axis.name, axis.offset_from_family)
        attributes |= {k: v for k in ("long_name", "units", "display_units") if (v := getattr(axis, k))}
        coordinates[name] = name, np.asarray(axis.values), attributes
    for name, parameter in scene.system.parameters.items():
        attributes = parameter_attributes(scene.system, name, False)
        has_default = not np.isnan(parameter.default)
        if name in scene.solve:
            coordinates[name] = dimensions, columns[name].reshape(scene.shape), attributes
        elif name not in scene.axes and (has_default or name in scene.fixed or name in scene.ties):
            axes, values = _parameter_along_axes(scene, name, chunks)
            coordinates[name] = [dimensions[i] for i in axes], values, attributes
    return without_fill_values(xr.Dataset(variables, coordinates))


def variable_attributes(system: System, name: str, present: Collection[str]) -> dict[str, object]:
    """Return the attributes of a data variable. A label names the variables status and error_estimate if they are `present`."""
    attributes = data_variables(system)[name].attributes()
    if name.startswith("label"):
        ancillary = [other for other in ("status", "error_estimate") if other in present]
        attributes |= {"ancillary_variables": " ".join(ancillary)} if ancillary else {}
    return attributes


def parameter_attributes(system: System, name: str, offset: bool) -> dict[str, str]:
    """Return long_name and units of a parameter, or of an offset. For any other axis, long_name is the name and units are 1."""
    if name not in system.parameters:
        return {"long_name": name, "units": "1"}
    parameter = system.parameters[name]
    long_name = f"offset from the family in the {parameter.meaning}" if offset else parameter.meaning
    return {"long_name": long_name, "units": parameter.unit}


def with_parameters(
    ds: xr.Dataset, system: System, arrays: Mapping[str, xr.DataArray], leave_out: Collection[str] = ()
) -> xr.Dataset:
    """Add the parameters of a system to a dataset as coordinates. Raise BadInput if an index of the same name has other values."""
    coordinates = dict[str, Any]()  # All are assigned together, because each assignment copies the dataset.
    for name, parameter in system.parameters.items():
        if name in leave_out:
            continue
        array = arrays.get(name, xr.DataArray(parameter.default))
        attributes = parameter_attributes(system, name, False)
        if name in ds.indexes:
            if array.dims != ds[name].dims or not np.array_equal(array.values, ds[name].values):
                raise BadInput(
                    f"{name}: an index of the points has the name of this parameter and other values"
                )
            ds[name].attrs = attributes
        elif array.chunks is not None or not np.isnan(array).all():
            coordinates[name] = array.dims, array.data, attributes
    ds = ds.assign_coords(coordinates)
    # If a single parameter lies along a dimension without coordinate, and is in memory, its values become the coordinate.
    for dim in [dim for dim in ds.sizes if dim != "point" and dim not in ds.coords]:
        match [ds[name] for name, array in arrays.items() if dim in array.dims and name in ds.coords]:
            case [array] if array.ndim == 1 and array.chunks is None and array.to_index().is_unique:
                ds = ds.assign_coords(
                    {dim: (dim, array.values, array.attrs | {"long_name": str(array.name)})}
                )
    return without_fill_values(ds)


def _parameter_along_axes(scene: Scene, name: str, chunks: Sequence[int] | None) -> tuple[list[int], Any]:
    """Return the indices of the axes on which a fixed or tied parameter depends, and the values along these axes."""
    names, pending = {name}, {name}
    while pending:
        sources = set[str]().union(*(scene.ties[each].names for each in pending & scene.ties.keys()))
        names, pending = names | sources, sources - names
    axes = [i for i, axis in enumerate(scene.axes) if axis in names - scene.ties.keys()]

    def evaluate(indices: Sequence[np.ndarray]) -> np.ndarray:
        """Return the parameter at the given indices along `axes`. The indices along all other axes of the scene are 0."""
        all_indices = [np.zeros(1, np.int64)] * len(scene.shape)
        for i, index in zip(axes, indices, strict=True):
            all_indices[i] = index
        flat = np.ravel_multi_index(tuple(np.meshgrid(*all_indices, indexing="ij")), scene.shape)
        return grid.parameter_values(scene, flat.ravel())[name].reshape([len(index) for index in indices])

    shape = [scene.shape[i] for i in axes]
    if chunks is None or np.prod(shape, dtype=float) <= MAX_EAGER_VALUES:
        return axes, evaluate([np.arange(count) for count in shape])
    import dask.array as da

    lengths = da.core.normalize_chunks([chunks[i] for i in axes], shape)
    edges = [np.cumsum([0, *along]) for along in lengths]

    def chunk(block_id: Any = None) -> np.ndarray:  # With block_info, dask would describe all blocks at once.
        return evaluate([np.arange(*e[i : i + 2]) for e, i in zip(edges, block_id, strict=True)])

    return axes, da.map_blocks(chunk, chunks=lengths, dtype=float, meta=np.empty([0] * len(shape)))


def without_fill_values(ds: xr.Dataset) -> xr.Dataset:
    """Change a dataset so that `to_netcdf` writes coordinates without _FillValue, as CF demands, and return the dataset."""
    for name in ds.coords:
        ds.variables[name].encoding["_FillValue"] = None
    return ds


def classic(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes that classic NetCDF and R can read, with integers of 32 bits, and floats for larger integers."""
    values = {name: np.asarray(value) for name, value in attributes.items()}
    large = {name: value for name, value in values.items() if value.dtype == np.int64}
    kinds = {name: np.int32 if (abs(v) < 2**31).all() else np.float64 for name, v in large.items()}
    return {**attributes, **{name: value.astype(kinds[name]) for name, value in large.items()}}


def log_warnings(warnings: list[str]) -> None:
    """Log warnings about the input with the logger "atlas"."""
    for warning in warnings:
        logging.getLogger("atlas").warning(warning)


def history_text(reused: Mapping[str, int]) -> dict[str, str]:
    """Return the attribute HISTORY, or no attribute if `reused` is empty. `reused` counts points taken from each earlier atlas."""
    lines = [f"{count} points of: {earlier}" for earlier, count in sorted(reused.items())]
    return {HISTORY: "\n".join(lines)} if lines else {}


def provenance(
    system: System, settings: Settings, kernel_hash: str, *, warnings: list[str], timing: tuple[int, float] | None = None,
    title: str = "", outputs: Sequence[str] = (), scene: Scene | None = None, transient: Duration | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the attributes of CF, ACDD-1.3 and this package for an atlas. `title` and `outputs` count only without a `scene`.

    `timing` is the number of points and the wall-clock time in seconds, if known.
    """
    from ..kernel.machine_code import cpu

    about = About() if scene is None else scene.about
    packages = ("numpy", "numba", "llvmlite", "xarray", "netCDF4", "scipy")
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    reference = system.reference + (f", https://doi.org/{system.doi}" if system.doi else "")
    attributes: dict[str, Any] = {
        "Conventions": "CF-1.12, ACDD-1.3",
        "title": title if scene is None else scene.title,
        "source": f"Precession Atlas {__version__}: {system.title}, fixed-step {settings.method}",
        "references": "; ".join([*about.references, reference]),
        "date_created": now,
        "history": f"{now} computed by atlas {__version__}",
        **about.attributes(),
        VERSION: __version__,
        "atlas_system": system.name,
        "atlas_scene": "" if scene is None else scene.toml(),
        "atlas_method": settings.method,
        "atlas_rate_tolerance": settings.rate_tolerance,
        "atlas_cylinder_tolerance": settings.cylinder,
        "atlas_drift_tolerance": settings.drift_tolerance,
        "atlas_tolerance": settings.tolerance if settings.step is None else math.nan,
        "atlas_step": math.nan if settings.step is None else settings.step,
        "atlas_kernel_hash": kernel_hash,
        "atlas_cpu": cpu(),
        "atlas_platform": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "atlas_versions": ", ".join(f"{name} {import_module(name).__version__}" for name in packages),
    }
    if extensions := extensions_of(system, outputs if scene is None else scene.outputs):
        attributes["atlas_extensions"] = ", ".join(f"{each.name} {each.code}" for each in extensions)
    if timing is not None:
        points, seconds = timing
        attributes["atlas_seconds"] = seconds
        attributes["atlas_points_per_second"] = points / seconds if seconds > 0 else math.nan
    origin = systems.origin(system)
    if origin is not None:
        package = origin.package or "registered in the process that computed the atlas"
        attributes |= {"atlas_system_package": package, "atlas_system_code": origin.code}
    if system.has_numeric_bound:
        attributes["atlas_frequency_bound"] = "numeric"
    if limits := std_tolerances(system, settings.std_tolerance, settings.rate_tolerance):
        attributes["atlas_std_tolerance"] = ", ".join(f"{name} {limit}" for name, limit in limits.items())
    transient = transient if scene is None else scene.transient
    if transient is not None and transient.amount:
        attributes[TRANSIENT] = str(transient)
    if warnings:
        attributes["atlas_warnings"] = "; ".join(warnings)
    return attributes
