"""The atlas: its layout and provenance, writing in one move, opening with every complaint in one line."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import BadInput
from ..files import check_folder, umask
from ..scene import grid
from ..scene.model import Scene
from ..systems.base import System
from ..variables import variables

COMPRESSION: dict[str, Any] = {"zlib": True, "complevel": 4, "shuffle": True}
SUFFIX = ".nc"
# Parameters with more values than this are computed when they are looked at, a block at a time.
MAX_EAGER_VALUES = 4_000_000


def dims(scene: Scene) -> tuple[str, ...]:
    """Dimensions of the atlas: its axes, an axis of distances from a family with "_offset" appended."""
    return tuple(f"{a.name}_offset" if a.offset_from_family else a.name for a in scene.axes.values())


def dataset(
    scene: Scene, columns: Mapping[str, Any], solved: Mapping[str, Any], blocks: Sequence[int] | None = None
) -> xr.Dataset:
    """The atlas without provenance: axes as dimensions, each parameter along the axes it depends on.

    columns, solved: arrays of the scene's shape (NumPy or dask), the variables of the atlas and the
    parameters that its family was solved for. blocks: a block of the grid by its length along each
    axis; with it, parameters of more than MOST_EAGER values become dask arrays of such blocks.
    """
    names, kinds = dims(scene), variables(scene.system)
    ds = xr.Dataset({name: (names, values, kinds[name].attributes()) for name, values in columns.items()})
    for name, axis in zip(names, scene.axes.values(), strict=True):
        attributes = parameter_attributes(scene.system, axis.name, axis.offset_from_family)
        attributes |= {k: v for k in ("long_name", "units") if (v := getattr(axis, k))}
        ds = ds.assign_coords({name: (name, np.asarray(axis.values), attributes)})
    for name, parameter in scene.system.parameters.items():
        attributes = parameter_attributes(scene.system, name, False)
        if name in solved:
            ds = ds.assign_coords({name: (names, solved[name], attributes)})
        elif name not in scene.axes:
            used = _depends(scene, name)
            value = _along(scene, name, used, blocks)
            if not (np.isnan(parameter.default) and name not in scene.fixed and name not in scene.ties):
                ds = ds.assign_coords({name: ([names[i] for i in used], value, attributes)})
    return ds


def parameter_attributes(system: System, name: str, offset: bool) -> dict[str, str]:
    """long_name and units of a parameter, or of its distance from a family; of any other name, the name."""
    if name not in system.parameters:
        return {"long_name": name, "units": "1"}
    parameter = system.parameters[name]
    what = f"offset from the family in the {parameter.meaning}" if offset else parameter.meaning
    return {"long_name": what, "units": parameter.unit}


def _depends(scene: Scene, name: str) -> tuple[int, ...]:
    """Axes, by number, on which a fixed or tied parameter depends."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        one = waiting.pop()
        if one in scene.ties:
            waiting += scene.ties[one].names
        elif one in scene.axes:
            found.add(one)
    return tuple(i for i, axis in enumerate(scene.axes) if axis in found)


def _along(scene: Scene, name: str, used: tuple[int, ...], blocks: Sequence[int] | None) -> Any:
    """Value of a parameter along the axes it depends on, the other axes held at their first value."""

    def values(places: Sequence[np.ndarray]) -> np.ndarray:
        full = [np.zeros(1, np.int64)] * len(scene.shape)
        for i, place in zip(used, places, strict=True):
            full[i] = place
        flat = np.ravel_multi_index(tuple(np.meshgrid(*full, indexing="ij")), scene.shape)
        return grid.parameter_values(scene, flat.ravel())[name].reshape([len(place) for place in places])

    shape = [scene.shape[i] for i in used]
    if blocks is None or np.prod(shape, dtype=float) <= MAX_EAGER_VALUES:
        return values([np.arange(count) for count in shape])
    import dask.array as da

    def block(block_info: Any = None) -> np.ndarray:
        return values([np.arange(*ends) for ends in block_info[None]["array-location"]])

    chunks = da.core.normalize_chunks([blocks[i] for i in used], shape)
    return da.map_blocks(block, chunks=chunks, dtype=float, meta=np.empty([0] * len(shape)))


def writable(out: str | Path, *, force: bool) -> Path:
    """The path of an atlas to be written; BadInput if it cannot be, or exists and force is false."""
    path = Path(out)
    if path.suffix != SUFFIX:
        raise BadInput(f"{path}: the name of an atlas ends in {SUFFIX}")
    check_folder(path)
    if path.exists() and not force:
        raise BadInput(f"{path}: this file exists; --force (force=True) replaces it")
    return path


def write(ds: xr.Dataset, path: Path) -> None:
    """Write under a temporary name beside `path`, sync, and move into place: never half a file."""
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in ds.variables.items():
        encoding[str(name)] = {"_FillValue": None}
        if variable.dtype.kind == "f":
            encoding[str(name)] = {"_FillValue": np.nan if name in ds.data_vars else None}
        if variable.ndim:
            encoding[str(name)] |= COMPRESSION
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    os.close(handle)
    try:
        ds.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=encoding)
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
