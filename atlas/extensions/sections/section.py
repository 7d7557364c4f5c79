"""Poincaré sections as datasets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from ... import systems
from ...errors import BadInput, shown
from ...flags import Status
from ...kernel import nodes, numeric_bound, specialization
from ...kernel.ensemble import Ensemble
from ...kernel.stepsize import ROUNDING, StepSizes
from ...kernel.tableaux import METHODS
from ...label.pipeline import after_transient
from ...label.plan import Plan
from ...label.points import warnings_of
from ...label.trajectory import attributes_of
from ...scene import grid
from ...scene.checks import texts, typed, whole_number
from ...scene.expressions import Expression
from ...scene.model import Settings
from ...scene.read import check_unit, parse_duration, parse_transient
from ...scene.tables import Table, flat_columns, parameter_arrays, table
from ...store import dataset
from ...systems.base import NATURAL_RATE, System
from .crossings import crossings
from .surface import JUMPING, Surface

DURATION = f"6000 / {NATURAL_RATE}"
OF_BODY = ("theta", "phi", "theta_dot", "psi_dot")  # what a section of a body keeps by default
DIMS = ("point", "crossing")
AT, LENGTH = "atlas_section", "atlas_duration"  # names of attributes of a section
MAX_VALUES = 10**8  # largest number of values of each kept quantity
# The error of a run is estimated as this fraction of the difference from a run with longer steps. Errors of the steps are at most a
# sixth of the difference (rk4). Rounding errors may be a larger fraction of the difference.
SHARE = 0.2
SPREAD = 1e-6  # A warning follows if first integrals of the points differ by a larger fraction of their size.


@typed
def section(
    system: str,
    points: Table,
    *,
    at: str,
    keep: Sequence[str] | None = None,
    count: int = 500,
    duration: float | str | None = None,
    transient: float | str = 0,
    tolerance: float = 1e-10,
    method: str = "rk8",
) -> xr.Dataset:
    """Poincaré section: where motions cross a surface, with an error for each crossing.

    Parameters
    ----------
    system : str
        Name of a system, such as "satellite" or "fixed_point".
    points : mapping, list of mappings, Dataset, DataFrame or path
        As in `label_points`, with numbers, 1-D arrays or arrays along "point" as values.
    at : str
        Two expressions with = between them, then "rising" (default), "falling" or "either". The surface "psi_dot = 0 rising" is
        crossed where left minus right becomes positive. Names are states, constants and observables of the system. For a body the
        names include theta, theta_dot, psi_dot, phi_dot, normal_rate, axis_x, axis_y and axis_z. psi and phi must stand alone on the left.
    keep : sequence of str, optional
        Expressions whose values at the crossings are kept. The default is the observables, or for a body theta, phi,
        theta_dot and psi_dot.
    count : int
        Number of crossings after which a motion ends.
    duration : float or str, optional
        Longest time of a motion, in time units or a text as in `label_points`; default "6000 / natural_rate".
    transient : float or str
        Time from the start in which crossings are not counted, in the forms of `duration`.
    tolerance : float
        Phase error of the fastest frequency after transient and duration, rad.
    method : str
        "rk4" or "rk8".

    Returns
    -------
    xarray.Dataset
        Variables over "point" and "crossing" are time from the start, error, and the kept expressions under their texts. They are nan
        after a point's last crossing. The error is the largest error of expressions and time, from a second run with longer steps.
        Variables over "point" are crossings (their number) and status, which is ok, not_finite, under_resolved, or step_sensitive
        where the two runs have different numbers of crossings. The parameters are coordinates.

    Raises
    ------
    BadInput
        As `label_points`, and for texts that are no surface.

    Notes
    -----
    A start on the surface is no crossing. Crossings may be lost where the third axis passes near the vertical, but only if `at`
    has products or powers of psi_dot and phi_dot. Errors of chaotic motions grow exponentially. A single crossing with an error
    above 1e-3 means nothing, but the distribution of crossings remains meaningful.
    """
    description, every = systems.get(system), systems.get(system).parameters
    surface, settings = Surface(description, at), Settings(method=method, tolerance=tolerance)
    if keep is None:
        keep = OF_BODY if description.frame else [each.name for each in description.observables]
    keep = list(dict.fromkeys(texts("keep", keep)))
    kept = [surface.checked("keep", Expression("keep", text)) for text in keep]
    for text in keep:
        if text in every or text in ("time", "error", "crossings", "status", *DIMS):
            raise BadInput(f"keep: {shown(text)} is part of every section")
    length = parse_duration(DURATION if duration is None else duration, names=every)
    check_unit(description, length)
    before = parse_transient(description, transient, "transient", every)
    source = table(points, every)
    names, arrays, name_columns = parameter_arrays(description, source)
    for dim in {str(dim) for array in arrays for dim in array.dims} - {"point"}:
        raise BadInput(
            f"points: an array along {shown(dim)}; a section is that of points along one dimension, point"
        )
    size = max((array.size for array in (*arrays, *name_columns.values())), default=1)
    whole_number("count", count, 1, MAX_VALUES // size)
    columns = flat_columns(description, names, [array.values for array in arrays], (size,), source)
    part = grid.of_points(description, settings, columns, length, before)
    warnings, status = warnings_of(description, (), part, length), grid.status_of(part.reason)
    plan, runner = Plan.of_points(description, settings, None, names), METHODS[method]
    part = part.subset(where := np.flatnonzero(part.exists))
    ensemble = Ensemble.of(description, part.points)
    bound, settled = numeric_bound.along_runs(
        description, plan.kernel, runner, ensemble, part.until, settings.max_steps
    )
    ensemble = replace(ensemble, frequency_bound=np.where(settled, bound, np.inf))
    with np.errstate(all="ignore"):
        sizes = StepSizes.of(settings.at(part.rate_tolerance), ensemble.frequency_bound, part.until)
        sizes = sizes.after(part.transient + 0.0 * part.duration, part.duration)
    status[where] = Status.UNDER_RESOLVED
    resolved = np.flatnonzero(sizes.resolved)
    part, ensemble, sizes = part.subset(resolved), ensemble.subset(resolved), sizes.subset(resolved)
    where, coarse = where[resolved], sizes.incommensurate(runner)
    kernel = specialization.node_kernel(description, method, plan.specialization)
    starts = (after_transient(plan, part.points, ensemble, each) for each in (sizes, coarse))
    (rows, number, finite), (others, other_number, _) = (
        crossings(surface, kept, kernel, start, each, part.duration, count)
        for start, each in zip(starts, (sizes, coarse), strict=True)
    )
    status[where] = np.select(
        [~finite, number != other_number], [Status.NOT_FINITE, Status.STEP_SENSITIVE], Status.OK
    )
    error = np.abs(rows - others)
    rows[-1] += sizes.transient[:, None]
    for i, text in enumerate(keep):
        if description.frame and text in JUMPING:
            error[i] = np.abs((error[i] + np.pi) % (2 * np.pi) - np.pi)
    error = SHARE * error + np.spacing(np.abs(rows)) + (ROUNDING * np.sqrt(sizes.whole_steps))[:, None]
    values = np.full((len(keep) + 2, size, number.max(initial=0)), np.nan)
    values[:, where] = np.array([*rows, error.max(0)])[..., : values.shape[2]]
    crossed = np.zeros(size, np.int32)
    crossed[where] = number
    known = attributes_of(description) | {
        "time": {"long_name": "time of the crossing", "units": "s"},
        "error": {"long_name": "largest error of what is kept and of the time", "units": "1"},
    }
    ds = xr.Dataset(
        {name: (DIMS, each, known.get(name, {"long_name": name})) for name, each in zip([*keep, "time", "error"], values, strict=True)}
        | {"crossings": ("point", crossed, {"long_name": "number of crossings", "units": "1"})}
        | {"status": ("point", status, dataset.variable_attributes(description, "status", ()))},
        coords=name_columns,
    )  # fmt: skip
    ds = dataset.with_parameters(ds, description, dict(zip(names, arrays, strict=True)))
    spread = _spread(description, ensemble)
    warnings += [
        f"the first integral {name} of the points differs by {value:.2g} of its size: motions of different ones share no section"
        for name, value in spread.items() if value > SPREAD
    ]  # fmt: skip
    dataset.log_warnings(warnings)
    text = specialization.source(description, method, plan.specialization, of=nodes)
    ds.attrs = dataset.provenance(
        description, settings, specialization.kernel_hash(text), title=f"section of the {system} at {at}", warnings=warnings, transient=before
    )  # fmt: skip
    ds.attrs |= {AT: at, LENGTH: str(length), "atlas_integral_spread": max(spread.values(), default=0.0)}
    return ds


def _spread(system: System, ensemble: Ensemble) -> dict[str, float]:
    """Return the range of each constant first integral over the starts, divided by the integral's largest size (1 / `ensemble.scales`)."""
    equations, at, result = system.equations, (ensemble.origin, ensemble.constants), dict[str, float]()
    for name, scale in zip(equations.INTEGRALS, ensemble.scales, strict=True):
        loss = getattr(equations, "LOSSES", {}).get(name)
        if (scale > 0).all() and scale.size and not (loss and np.any(getattr(equations, loss)(*at))):
            result[name] = float(np.ptp(sum(getattr(equations, name)(*at))) * scale.min())
    return result
