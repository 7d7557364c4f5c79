"""Labels of points given one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..compiling import Stopwatch
from ..engine.specialization import Specialization
from ..errors import BadInput, allowed_text, shown
from ..io import netcdf
from ..io.netcdf import log_warnings
from ..io.progress import Progress
from ..scene import grid
from ..scene.checks import MAX_THREADS, texts, typed, whole_number
from ..scene.model import DEFAULTS, Duration, Settings
from ..scene.read import check_std_tolerance, check_unit, parse_duration
from ..scene.tables import kept_columns, number_column, point_columns, table
from ..systems.base import Array, Points, System, subset
from ..variables import default_variables
from ..variables import variables as variable_registry
from .pipeline import evaluate
from .plan import Plan

MORE_SETTINGS = ("cylinder_tolerance", "std_tolerance", "drift_tolerance", "max_steps", "check_half_step")


@typed
def label_points(
    system: str,
    points: Any,
    *,
    duration: Any = Duration.amount,
    step: float | None = None,
    tolerance: float = DEFAULTS.tolerance,
    method: str = DEFAULTS.method,
    rate_tolerance: float = DEFAULTS.rate_tolerance,
    variables: Sequence[str] | None = None,
    threads: int | None = None,
    progress: bool = False,
    keep: Sequence[str] = (),
    **more: Any,
) -> xr.Dataset:
    """Label points given one by one.

    Parameters
    ----------
    system : str
        Name of a system, such as "satellite" or "fixed_point".
    points : mapping, list of mappings, Dataset, DataFrame or path
        Parameter -> number or 1-D array, all arrays of one length, in the units of the registry; parameters that are
        left out take their defaults. A path names a .csv or .nc file.
    duration : float, array_like of float, shape (points,), or str
        In time units, or a text as in a scene, such as "20 orbits" or "50 turns".
    step : float, optional
        Largest step in time units, instead of `tolerance`.
    tolerance : float
        Phase error of the fastest frequency at the end of the run, rad.
    method : str
        "rk4" or "rk8".
    rate_tolerance : float
        Variation of a rate that counts as none, rad per time unit.
    variables : sequence of str, optional
        Names of the variables wanted; default: every one that is measured or predicted.
    threads : int, optional
        Default: all processors.
    progress : bool
        Print progress on the standard error stream.
    keep : sequence of str, optional
        Columns of `points` that are no parameters, to be coordinates of the result. Columns of text, and those named
        id, index, name, number or point, are kept anyhow.
    **more
        cylinder_tolerance, std_tolerance, drift_tolerance, max_steps, check_half_step: as in a scene.

    Returns
    -------
    xarray.Dataset
        Over the dimension "point"; the parameters are coordinates.

    Raises
    ------
    BadInput
        For unknown names, wrong shapes and numbers out of range.

    Notes
    -----
    Points with moments of inertia that no body can have, and those of which nothing turns where the duration is a
    number of turns, are not computed: their label is not_computed, and the status of the former impossible_body. A
    logged warning, which the attribute `atlas_warnings` repeats, counts them. It is an error if no point is computed.
    """
    description = systems.get(system)
    for key in set(more) - set(MORE_SETTINGS):
        raise BadInput(f"{key}: unknown option of label_points; {allowed_text(key, MORE_SETTINGS)}")
    settings = Settings(method=method, tolerance=tolerance, step=step, rate_tolerance=rate_tolerance, **more)
    check_std_tolerance(description, settings.std_tolerance)
    whole_number("threads", 1 if threads is None else threads, 1, MAX_THREADS)
    registry = variable_registry(description)
    outputs = default_variables(description)
    if variables is not None:
        for name in (variables := texts("variables", variables)):
            if name not in registry:
                raise BadInput(f"variables: {shown(name)} is unknown; {allowed_text(name, registry)}")
        outputs = [name for name in registry if name in variables]
    keep = texts("keep", keep)
    source = table(points, {*description.parameters, *keep})
    kept = kept_columns(description, source, keep)
    for name in kept:
        if name in outputs:
            raise BadInput(f"points: the column {name} has the name of a variable of the result; rename it")
    full, size = point_columns(description, source, kept)
    durations, unit = _durations(description, duration, full, size)
    description.check_possible(full)
    reason = grid.reasons(description, full)
    reason[(reason == grid.Reason.NONE) & np.isnan(durations)] = grid.Reason.NO_TURN
    if (reason != grid.Reason.NONE).all():
        raise BadInput(
            f"{grid.sentence(grid.Reason.NO_TURN, description, None, unit)}; give a number of time units"
        )
    computed = subset(full, reason == grid.Reason.NONE)
    counts = np.bincount(reason, minlength=len(grid.Reason))
    warnings = grid.count_lines(counts, description, None, unit) + grid.system_warnings(description, computed)
    try:
        description.check(full)
    except BadInput as error:  # of incomplete points
        warnings.append(str(error))
    log_warnings(warnings)
    stopwatch = Stopwatch()
    specialization = Specialization.of_points(description, computed)
    plan = Plan(description, settings, None if variables is None else outputs, specialization)
    columns = _evaluate_in_tiles(plan, grid.Grid(full, full, reason, durations), outputs, threads, progress)
    ds = _dataset(description, columns, full, kept)
    ds.attrs |= netcdf.provenance(
        description, settings, plan.kernel_hash, title=f"points of the {system}", seconds=stopwatch.seconds(),
        points=size, warnings=warnings,
    )  # fmt: skip
    return ds


def _durations(system: System, duration: Any, points: Points, size: int) -> tuple[Array, Duration]:
    """Duration of each point, checked, and the text that was given; nan for turns of what rests."""
    if isinstance(duration, str):
        text = parse_duration(duration)
        check_unit(system, text)
        return grid.durations(system, text, points), text
    given = number_column("duration", duration)
    if given.ndim and given.shape != (size,):
        raise BadInput(
            f"duration has shape {given.shape}; allowed: a number, or one for each of {size} points"
        )
    durations = np.broadcast_to(given, (size,)).astype(np.float64)
    bad = ~(np.isfinite(durations) & (durations > 0))
    if bad.any():
        raise BadInput(f"duration = {durations[bad][0]:g}: must be a finite number above 0")
    return durations, Duration()


def _evaluate_in_tiles(
    plan: Plan, points: grid.Grid, names: Sequence[str], threads: int | None, progress: bool
) -> dict[str, np.ndarray]:
    """The named variables of all points."""
    size, registry = points.duration.size, variable_registry(plan.system)
    columns = {name: np.empty(size, registry[name].dtype) for name in names}
    bar = Progress(size, show=progress)
    for first in range(0, size, grid.MAX_POINTS_PER_TILE):
        tile = slice(first, first + grid.MAX_POINTS_PER_TILE)
        part = points.subset(tile)
        values = evaluate(plan, part, threads=threads, progress=bar.advance)
        bar.skip(part.reason.size - int(part.exists.sum()))
        for name, column in columns.items():
            column[tile] = values[name]
    bar.close()
    return columns


def _dataset(
    system: System, columns: dict[str, np.ndarray], points: Points, kept: dict[str, np.ndarray]
) -> xr.Dataset:
    """Variables, parameters and kept columns along the dimension "point"."""
    ds = xr.Dataset(
        {
            name: ("point", column, netcdf.variable_attributes(system, name, columns))
            for name, column in columns.items()
        },
        coords={name: ("point", column) for name, column in kept.items()},
    )
    for name, values in points.items():
        absent = np.isnan(system.parameters[name].default) and np.isnan(values).all()
        if not absent:
            attributes = netcdf.parameter_attributes(system, name, False)
            ds = ds.assign_coords({name: ("point", values, attributes)})
    return ds
