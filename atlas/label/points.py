"""Labels of points that are given one by one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from inspect import signature
from math import prod
from typing import Any

import numpy as np
import xarray as xr

from .. import systems
from ..errors import BadInput, allowed_text, shown
from ..extension import available_text
from ..kernel import numeric_bound
from ..kernel.blocks import Threads
from ..kernel.compiling import Stopwatch
from ..kernel.stepsize import StepSizes
from ..kernel.tableaux import METHODS
from ..scene import grid
from ..scene.checks import MAX_THREADS, texts, typed, whole_number
from ..scene.model import DEFAULTS, Duration, Settings
from ..scene.read import check_at_points, check_std_tolerance, check_unit, parse_duration, parse_transient
from ..scene.tables import Table, Values, flat_columns, parameter_arrays, table
from ..store import dataset
from ..store.dataset import log_warnings
from ..store.progress import Progress
from ..systems.base import Array, System, check_possible, derived_variables
from ..variables import POINT, default_variables, listed_variables
from ..variables import variables as variable_registry
from .pipeline import evaluate
from .plan import Plan, method_lines

# A call with at least MANY_POINTS points that costs more than MANY_STEPS steps of rk4 (about a second) logs which method is faster.
MANY_POINTS, MANY_STEPS = 100, 1e8
_advised = False  # whether a call of this process has logged the advice
OTHER_SETTINGS = ("cylinder_tolerance", "std_tolerance", "drift_tolerance", "max_steps", "check_half_step")


@typed
def label_points(
    system: str,
    points: Table,
    *,
    duration: str | Values = Duration.amount,
    step: float | None = None,
    tolerance: float = DEFAULTS.tolerance,
    method: str = DEFAULTS.method,
    rate_tolerance: float | str = DEFAULTS.rate_tolerance,
    transient: float | str = 0.0,
    variables: Sequence[str] | None = None,
    threads: int | None = None,
    progress: bool = False,
    keep: Sequence[str] = (),
    **other_settings: Any,
) -> xr.Dataset:
    """Label points given one by one, or as arrays that are broadcast against each other.

    Parameters
    ----------
    system : str
        Name of a system, such as "satellite" or "fixed_point".
    points : mapping, list of mappings, Dataset, DataFrame or path
        Mapping from a parameter to a number, a 1-D array or a DataArray, in the units of the registry. Omitted parameters take
        their defaults. DataArrays are broadcast as xarray does; other arrays lie along the dimension "point", and so do the
        variables of a Dataset whose only dimension is not a parameter. The index of a DataFrame becomes the coordinate of "point",
        or a parameter if it is named like one. A path names a .csv or .nc file. DataFrames of polars (also lazy) and tables of
        pyarrow are read like those of pandas.
    duration : float, array_like, DataArray or str
        Duration in time units, or a text as in a scene, such as "20 orbits", "50 turns", or arithmetic in parameters and
        natural_rate, whose value may differ from point to point.
    step : float, optional
        Largest step in time units, instead of `tolerance`.
    tolerance : float
        Phase error of the fastest frequency at the end of the run, rad.
    method : str
        "rk4" or "rk8".
    rate_tolerance : float or str
        Largest variation of a rate that counts as constant, rad per time unit: a number, or arithmetic as in `duration`.
    transient : float or str
        Time before the run in which motions may settle. Statistics, labels and indicators of chaos begin after this time.
    variables : sequence of str, optional
        Names of the wanted variables. The default is all measured and predicted variables that are not optional.
    threads : int, optional
        Number of threads. The default is all processors, or one thread for each chunk of a lazy result.
    progress : bool
        Print progress on the standard error stream.
    keep : sequence of str, optional
        Columns of `points`, other than parameters, that become coordinates of the result. Columns of text, and columns named
        id, index, name, number or point, are always kept.
    **other_settings
        Settings as in a scene: cylinder_tolerance, std_tolerance, drift_tolerance, max_steps, check_half_step.

    Returns
    -------
    xarray.Dataset
        Variables over the dimensions of the given arrays, or over "point" if only numbers were given. Parameters are
        coordinates along their own dimensions. If a single parameter was given along a dimension without a coordinate, its
        values become the coordinate of this dimension.

    Raises
    ------
    BadInput
        For unknown names, wrong shapes and numbers out of range.

    Notes
    -----
    Three kinds of points are not computed (label not_computed): moments of inertia that no body can have (status
    impossible_body), points at rest if the duration is a number of turns, and points at which arithmetic gives no value above
    0. A logged warning, repeated in the attribute `atlas_warnings`, counts them. It is an error if no point is computed.

    If an array is a dask array, the result is lazy: it is computed chunk by chunk, bit for bit as in memory. Values out of range
    are then found only in the computation, and there are no warnings and no attributes that depend on values.

    The kernel leaves out terms that vanish or are equal because omitted parameters have their defaults. A parameter that is given as
    0 is computed, so results may differ by rounding. Points never affect each other.
    """
    description = systems.get(system)
    for key in set(other_settings) - set(OTHER_SETTINGS):
        options = [*[*signature(label_points).parameters][2:-1], *OTHER_SETTINGS]
        raise BadInput(f"{key}: unknown option of label_points; {allowed_text(key, options)}")
    settings = Settings(
        method=method, tolerance=tolerance, step=step, rate_tolerance=rate_tolerance, **other_settings
    )
    check_std_tolerance(description, settings.std_tolerance)
    whole_number("threads", 1 if threads is None else threads, 1, MAX_THREADS)
    registry = variable_registry(description)
    outputs = default_variables(description)
    if variables is not None:
        for name in (variables := texts("variables", variables)):
            if name not in registry:
                raise BadInput(f"variables: {shown(name)} is unknown; {available_text(name, registry)}")
        outputs = listed_variables(description, variables)
    source = table(points, description.parameters, keep := texts("keep", keep))
    text = parse_duration(duration, names=description.parameters) if isinstance(duration, str) else None
    before = parse_transient(description, transient, "transient", description.parameters)
    check_at_points("rate_tolerance", settings.rate_tolerance, description.parameters)
    if text is not None:
        check_unit(description, text)
    for name, derived in derived_variables(description).items():
        if derived.from_start and before.amount and name in outputs:
            raise BadInput(f"variables: {name}: it is of the motion from its start, not after a transient")
    names, (*arrays, lengths), name_columns = parameter_arrays(
        description, source, keep, duration=1.0 if text is not None else duration
    )
    dims = {dim for array in (*arrays, lengths) for dim in array.dims}
    new_sizes = {
        str(dim): n for array in name_columns.values() for dim, n in array.sizes.items() if dim not in dims
    }
    lengths = lengths.expand_dims(new_sizes if dims or new_sizes else {POINT: 1})
    for name in {
        str(each) for array in (*arrays, *name_columns.values()) for each in array.coords
    } | name_columns.keys():
        if name in outputs:
            raise BadInput(f"points: the column {name} has the name of a variable of the result; rename it")
    lazy = any(array.chunks is not None for array in (*arrays, lengths))
    if lazy:  # values of dask arrays are not known yet, so only single numbers are checked
        single = {name: array.values for name, array in zip(names, arrays, strict=True) if not array.ndim}
        flat_columns(description, [*single], [*single.values()], (), source)
    sizes = {dim: n for array in (*arrays, lengths) for dim, n in array.sizes.items()}
    size = prod(sizes.values())
    plan = Plan.of_points(description, settings, None if variables is None else outputs, names, size)
    warnings, stopwatch = list[str](), Stopwatch()
    labels = _Labels(
        system, settings, plan.outputs, outputs, names, size, text, before, 1 if lazy and threads is None else threads,
        progress and not lazy, *((None, None) if lazy else (source, warnings)),
    )  # fmt: skip
    results = xr.apply_ufunc(
        labels, *arrays, lengths, dask="parallelized", output_core_dims=[()] * len(outputs),
        output_dtypes=[registry[name].dtype for name in outputs],
    )  # fmt: skip
    ds = xr.Dataset(dict(zip(outputs, results if len(outputs) > 1 else [results], strict=True)), name_columns)
    for name in outputs:
        ds[name].attrs = dataset.variable_attributes(description, name, outputs)
    ds = dataset.with_parameters(ds, description, dict(zip(names, arrays, strict=True)))
    ds.attrs = dataset.provenance(
        description, settings, plan.kernel_hash, title=f"points of the {system}", outputs=outputs, warnings=warnings,
        transient=before, timing=None if lazy else (ds[outputs[0]].size, stopwatch.seconds()),
    )  # fmt: skip
    return ds


@dataclass(frozen=True)
class _Labels:
    """Function that labels points. The arguments are arrays of parameters, then the durations. Dask may send it to another process."""

    system: str
    settings: Settings
    variables: Collection[str] | None  # see `Plan.outputs`
    outputs: Sequence[str]  # names of the returned variables
    names: Sequence[str]  # names of the parameters
    size: int  # number of points in all chunks
    duration: Duration | None  # duration from a text, or None if the durations in the arguments are used
    transient: Duration
    threads: int | None
    progress: bool
    source: Any  # table of the points; messages name a line of the table
    warnings: list[str] | None  # list to which warnings about the points are added

    def __call__(self, *arrays: Array) -> tuple[np.ndarray, ...] | np.ndarray:
        """Return the outputs at the points, in the shape of the arrays."""
        system, shape = systems.get(self.system), np.broadcast_shapes(*(array.shape for array in arrays))
        points = flat_columns(system, self.names, arrays[:-1], shape, self.source)
        durations = np.broadcast_to(arrays[-1], shape).ravel()
        if (bad := ~(np.isfinite(durations) & (durations > 0))).any():
            raise BadInput(f"duration = {durations[bad][0]:g}: must be a finite number above 0")
        tile = grid.of_points(system, self.settings, points, self.duration or durations, self.transient)
        if self.warnings is not None:
            self.warnings.extend(warnings_of(system, self.outputs, tile, self.duration or Duration()))
            log_warnings(self.warnings)
        plan = Plan.of_points(system, self.settings, self.variables, self.names, self.size)
        if self.warnings is not None:
            _advise(plan, tile)
        columns = _evaluate_in_tiles(plan, tile, self.outputs, self.threads, self.progress)
        results = tuple(columns[name].reshape(shape) for name in self.outputs)
        return results if len(results) > 1 else results[0]


def warnings_of(system: System, outputs: Sequence[str], points: grid.Grid, duration: Duration) -> list[str]:
    """Return warnings about points, or raise BadInput if no point can be computed."""
    check_possible(system, points.base)
    if not points.exists.any():
        reason = grid.Reason(points.reason[points.reason >= grid.Reason.NO_DURATION].min())
        remedy = "; give a number of time units" if reason == grid.Reason.NO_DURATION else ""
        raise BadInput(f"{grid.sentence(reason, system, None, duration)}{remedy}")
    counts = np.bincount(points.reason, minlength=len(grid.Reason))
    warnings = grid.count_lines(counts, system, None, duration)
    computed = points if points.exists.all() else points.subset(points.exists)
    warnings += grid.system_warnings(system, computed.base)
    warnings += grid.unit_warnings(system, outputs, computed) + grid.settling_warnings(system, computed)
    try:
        system.check(points.base)
    except BadInput as error:  # the points are incomplete or contradictory
        warnings.append(str(error))
    return warnings


def _advise(plan: Plan, points: grid.Grid) -> None:
    """If a call is long, log the methods that would save time. Each process logs this advice only once."""
    global _advised
    exists = np.flatnonzero(points.exists)
    if _advised or exists.size < MANY_POINTS:
        return
    some = points.subset(exists[:: exists.size // MANY_POINTS])
    with np.errstate(all="ignore"):
        bound = numeric_bound.before_run(plan.system, some.points, some.until)
        settings = plan.settings.at(some.rate_tolerance)
        steps = StepSizes.of(settings, bound, some.until).steps.mean() * exists.size
    if steps * METHODS[plan.settings.method].step_cost > MANY_STEPS:
        costs = {name: cost for name, cost in plan.relative_costs(bound, some).items() if cost < 1}
        log_warnings(method_lines(plan.settings.method, costs))
        _advised = True


def _evaluate_in_tiles(
    plan: Plan, points: grid.Grid, names: Sequence[str], threads: int | None, progress: bool
) -> dict[str, np.ndarray]:
    """Evaluate the points in tiles and return the variables `names` of all points."""
    size, registry = points.duration.size, variable_registry(plan.system)
    columns = {name: np.empty(size, registry[name].dtype) for name in names}
    bar = Progress(size, show=progress)
    length = grid.max_points_per_tile()
    for first in range(0, size, length):
        tile = slice(first, first + length)
        part = points.subset(tile)
        values = evaluate(plan, part, threads=Threads(threads, bar.advance))
        bar.skip(part.reason.size - int(part.exists.sum()))
        for name, column in columns.items():
            column[tile] = values[name]
    bar.close()
    return columns
