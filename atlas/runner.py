"""Runs: a scene, or points of one's own, become a labelled dataset."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from . import grid, store, systems
from .evaluate import Special, evaluate, evaluate_tile, kernel_hash, scene_kernel_hash
from .progress import Progress
from .scene import Scene, Settings, check_range
from .systems.system import BadInput, System
from .variables import variables


def run(
    scene: Scene,
    out: str | Path | None = None,
    *,
    threads: int | None = None,
    progress: bool = True,
    force: bool = False,
) -> xr.Dataset:
    """Integrate every point of a scene and return the labelled atlas; write it if `out` is given.

    scene: from load_scene. out: a path ending in .nc; an existing file is kept unless force is true.
    threads: default all processors of this process; results do not depend on it. progress: print to
    stderr. Returns a Dataset with the scene's axes as dimensions, the variables the scene asks for,
    every parameter as a coordinate, and provenance in the attributes.

    Raises BadInput for what no body can be and for an `out` that cannot be written, before anything
    is computed. On KeyboardInterrupt nothing is written.
    """
    path = None if out is None else store.writable(out, force=force)
    checked = grid.check(scene)
    kinds = variables(scene.system)
    columns = {
        name: np.zeros(scene.size, kinds[name].dtype) if kinds[name].flags else np.full(scene.size, np.nan)
        for name in scene.outputs
    }
    solved = {name: np.empty(scene.size) for name in scene.solve}
    bar = Progress(scene.size) if progress else None
    began = time.perf_counter()
    remarks = scene.system.warnings(checked.base)
    _log(remarks)
    try:
        for indices, tile in _tiles(scene):
            values = evaluate_tile(
                scene, tile, threads=threads, progress=None if bar is None else bar.advance
            )
            for name, column in columns.items():
                column[indices] = values[name]
            for name, column in solved.items():
                column[indices] = tile.base[name]
    finally:
        if bar is not None:
            bar.close()
    seconds = time.perf_counter() - began
    ds = _dataset(scene, columns, solved)
    ds.attrs |= store.provenance(
        scene.system, scene.settings, scene_kernel_hash(scene),
        title=scene.title, scene=scene.toml(), seconds=seconds, points=scene.size, remarks=remarks,
    )  # fmt: skip
    if path is not None:
        store.write(ds, path)
    return ds


def _log(remarks: list[str]) -> None:
    for remark in remarks:
        logging.getLogger("atlas").warning(remark)


def _tiles(scene: Scene) -> Iterator[tuple[np.ndarray, grid.Grid]]:
    for first in range(0, scene.size, grid.TILE):
        indices = np.arange(first, min(first + grid.TILE, scene.size))
        yield indices, grid.take(scene, indices)


def _dataset(scene: Scene, columns: dict[str, np.ndarray], solved: dict[str, np.ndarray]) -> xr.Dataset:
    """Axes as dimensions; each parameter a coordinate along the axes that it depends on and no more."""
    dims = tuple(scene.axes)
    kinds, parameters = variables(scene.system), scene.system.parameters
    ds = xr.Dataset(
        {
            name: (dims, column.reshape(scene.shape), kinds[name].attributes())
            for name, column in columns.items()
        }
    )
    for axis in scene.axes.values():
        name = f"{axis.name}_offset" if axis.offset_from_family else axis.name
        attributes = _axis_attributes(scene.system, axis.name, axis.offset_from_family)
        attributes |= {k: v for k in ("long_name", "units") if (v := getattr(axis, k))}
        ds = ds.rename({axis.name: name}) if name != axis.name else ds
        ds = ds.assign_coords({name: (name, np.asarray(axis.values), attributes)})
    for name, parameter in parameters.items():
        attributes = _axis_attributes(scene.system, name, False)
        if name in solved:
            ds = ds.assign_coords({name: (tuple(ds.sizes), solved[name].reshape(scene.shape), attributes)})
        elif name not in scene.axes:
            used = _depends(scene, name)
            value = _along(scene, name, used)
            if not (np.isnan(parameter.default) and np.isnan(value).all()):
                ds = ds.assign_coords({name: (used, value, attributes)})
    return ds


def _axis_attributes(system: System, name: str, offset: bool) -> dict[str, str]:
    if name not in system.parameters:
        return {"long_name": name, "units": "1"}
    parameter = system.parameters[name]
    what = f"offset from the family in the {parameter.meaning}" if offset else parameter.meaning
    return {"long_name": what, "units": parameter.unit}


def _depends(scene: Scene, name: str) -> tuple[str, ...]:
    """Axes on which a fixed or tied parameter depends, in the order of the axes."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        one = waiting.pop()
        if one in scene.ties:
            waiting += scene.ties[one].names
        elif one in scene.axes:
            found.add(one)
    return tuple(axis for axis in scene.axes if axis in found)


def _along(scene: Scene, name: str, used: tuple[str, ...]) -> np.ndarray:
    """Value of a parameter along the axes it depends on, the other axes held at their first value."""
    counts = [len(axis.values) if axis.name in used else 1 for axis in scene.axes.values()]
    places = np.indices(counts).reshape(len(counts), -1)
    values = grid.names(scene, np.asarray(np.ravel_multi_index(tuple(places), scene.shape)))[name]
    return values.reshape([len(scene.axes[axis].values) for axis in used])


def label_points(
    system: str,
    points: Mapping[str, Any] | xr.Dataset,
    *,
    duration: Any = 60.0,
    step: float | None = None,
    tolerance: float = 1e-8,
    method: str = "rk4",
    rate_tolerance: float = 1e-5,
    threads: int | None = None,
    progress: bool = False,
    **more: Any,
) -> xr.Dataset:
    """Label points of one's own: a Dataset with the dimension "point" and every variable of the registry.

    system: "satellite" or "fixed_point". points: parameter -> number or 1-D array (all arrays of one
    length), in the units of the registry; parameters left out take their defaults. duration: time
    units, a number or one per point. more: cylinder_tolerance, drift_tolerance, max_steps.

    Moments of inertia that no body can have are an error in a scene; here, where published numbers are
    looked up, the equations are solved all the same, and a logged warning and the attribute
    atlas_warnings say so. Raises BadInput for unknown names, wrong shapes and numbers out of range.
    """
    kind = systems.get(system)
    allowed = {"cylinder_tolerance", "drift_tolerance", "max_steps"}
    for key in set(more) - allowed:
        raise BadInput(f"{key}: unknown option of label_points; allowed: {', '.join(sorted(allowed))}")
    settings = Settings(
        method=method, tolerance=tolerance, step=step, rate_tolerance=rate_tolerance, **more
    )  # fmt: skip
    full, size = point_columns(kind, points)
    lengths = _column("duration", duration)
    if lengths.ndim and lengths.shape != (size,):
        raise BadInput(
            f"duration has shape {lengths.shape}; allowed: a number, or one for each of {size} points"
        )
    times = np.broadcast_to(lengths, (size,)).astype(np.float64)
    if not (np.isfinite(times) & (times > 0)).all():
        raise BadInput(
            f"duration = {times[~(np.isfinite(times) & (times > 0))][0]!r}: must be a finite number above 0"
        )
    remarks = kind.warnings(full)
    try:
        kind.check(full)
    except BadInput as complaint:
        remarks.append(str(complaint))
    _log(remarks)
    bar = Progress(size) if progress else None
    began = time.perf_counter()
    kinds = variables(kind)
    special = Special.of_points(kind, full)
    columns = {name: np.empty(size, v.dtype) for name, v in kinds.items() if name not in kind.layers}
    for first in range(0, size, grid.TILE):
        part = slice(first, first + grid.TILE)
        piece = {name: values[part] for name, values in full.items()}
        found = evaluate(
            kind, piece, piece, times[part], settings, special=special,
            threads=threads, progress=None if bar is None else bar.advance,
        )  # fmt: skip
        for name, column in columns.items():
            column[part] = found[name]
    if bar is not None:
        bar.close()
    ds = xr.Dataset({name: ("point", column, kinds[name].attributes()) for name, column in columns.items()})
    for name, values in full.items():
        if not (np.isnan(kind.parameters[name].default) and np.isnan(values).all()):
            ds = ds.assign_coords({name: ("point", values, _axis_attributes(kind, name, False))})
    ds.attrs |= store.provenance(
        kind, settings, kernel_hash(kind, method, special),
        title=f"points of the {system}", scene="", seconds=time.perf_counter() - began, points=size,
        remarks=remarks,
    )  # fmt: skip
    return ds


def _column(name: str, values: Any) -> np.ndarray:
    try:
        column = np.asarray(values.values if isinstance(values, xr.DataArray) else values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {values!r}: must be a number or a 1-D array of numbers") from None
    if column.ndim > 1:
        raise BadInput(f"{name} has shape {column.shape}: must be a number or a 1-D array of numbers")
    return column


def point_columns(
    system: System, points: Mapping[str, Any] | xr.Dataset
) -> tuple[dict[str, np.ndarray], int]:
    """Every parameter of the system as a float64 column, checked, and their length; see label_points."""
    given = {str(k): points[k] for k in points.variables} if isinstance(points, xr.Dataset) else dict(points)
    if isinstance(points, xr.Dataset):
        given = {k: v for k, v in given.items() if k not in points.indexes or k in system.parameters}
    columns = {}
    for name, values in given.items():
        if name not in system.parameters:
            raise BadInput(
                f"{name}: not a parameter of the {system.name}; allowed: {', '.join(system.parameters)}"
            )
        columns[name] = _column(name, values)
    sizes = {c.size for c in columns.values() if c.ndim}
    if len(sizes) > 1:
        shown = ", ".join(f"{k}: {c.size}" for k, c in columns.items() if c.ndim)
        raise BadInput(f"points: columns of different lengths ({shown})")
    size = sizes.pop() if sizes else 1
    if size == 0:
        raise BadInput("points: there are none")
    full: dict[str, np.ndarray] = {}
    for name, parameter in system.parameters.items():
        column = columns.get(name, np.asarray(parameter.default))
        optional = np.isnan(parameter.default) & np.isnan(column)
        if not (np.isfinite(column) | optional).all():
            raise BadInput(f"{name}: must be finite numbers, found {column[~np.isfinite(column)].ravel()[0]}")
        if column.size and not np.all(optional):
            check_range(system, name, name, np.nanmin(column), np.nanmax(column))
        full[name] = np.broadcast_to(column, (size,)).astype(np.float64)
    return full, size


def summary(ds: xr.Dataset) -> str:
    """Counts of labels and status, agreement with theory, expected error, time and speed, as text."""
    lines = []
    for name in ("label", "label_inertial", "status", "agreement"):
        if name in ds:
            meanings = ds[name].attrs["flag_meanings"].split()
            counts = np.bincount(ds[name].values.ravel(), minlength=len(meanings))
            shown = ", ".join(f"{m} {n}" for m, n in zip(meanings, counts, strict=True) if n)
            lines.append(f"{name}: {shown}")
    if "error_estimate" in ds:
        lines.append(
            f"expected phase error of the fastest frequency: at most {float(ds['error_estimate'].max()):.2g} rad"
        )
    if "integral_drift" in ds:
        lines.append(f"drift of first integrals: at most {float(ds['integral_drift'].max()):.2g}")
    lines.append(f"{ds.attrs['atlas_seconds']:.1f} s, {ds.attrs['atlas_points_per_second']:.4g} points/s")
    return "\n".join(lines)
