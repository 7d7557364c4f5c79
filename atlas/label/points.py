"""Labels of points given one by one."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput
from ..io import netcdf, provenance
from ..io.progress import Progress
from ..io.provenance import log_warnings
from ..scene import grid
from ..scene.model import Settings
from ..scene.tables import number_column, point_columns
from ..variables import variables
from .pipeline import Specialization, evaluate, kernel_hash


def label_points(
    system: str,
    points: Any,
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
    length), or any other table that `points.table` reads, such as a DataFrame or the name of a CSV file;
    in the units of the registry; parameters left out take their defaults. duration: time
    units, a number or one per point. more: cylinder_tolerance, drift_tolerance, max_steps, check_half_step.

    Moments of inertia that no body can have are an error in a scene; here, where published numbers are
    looked up, the equations are solved all the same, and a logged warning and the attribute
    atlas_warnings say so. Raises BadInput for unknown names, wrong shapes and numbers out of range.
    """
    kind = systems.get(system)
    allowed = {"cylinder_tolerance", "drift_tolerance", "max_steps", "check_half_step"}
    for key in set(more) - allowed:
        raise BadInput(f"{key}: unknown option of label_points; allowed: {', '.join(sorted(allowed))}")
    settings = Settings(
        method=method, tolerance=tolerance, step=step, rate_tolerance=rate_tolerance, **more
    )  # fmt: skip
    full, size = point_columns(kind, points)
    lengths = number_column("duration", duration)
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
    log_warnings(remarks)
    bar = Progress(size) if progress else None
    began = time.perf_counter()
    kinds = variables(kind)
    special = Specialization.of_points(kind, full)
    columns = {name: np.empty(size, v.dtype) for name, v in kinds.items() if name not in kind.derived}
    for first in range(0, size, grid.MAX_POINTS_PER_TILE):
        part = slice(first, first + grid.MAX_POINTS_PER_TILE)
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
            ds = ds.assign_coords({name: ("point", values, netcdf.parameter_attributes(kind, name, False))})
    ds.attrs |= provenance.provenance(
        kind, settings, kernel_hash(kind, method, special),
        title=f"points of the {system}", scene="", seconds=time.perf_counter() - began, points=size,
        remarks=remarks,
    )  # fmt: skip
    return ds
