"""Stress cases of a system that has none of its own: large, small and stiff values of every parameter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..engine import numeric_bound
from ..flags import Label
from ..scene.model import Settings
from ..systems.base import Array, Mask, Parameter, Points, StressCase, System
from .reference import ReferenceFailureError, reference
from .stress_points import CasePoints, case_points
from .stress_truth import TrueLabels, no_statistics, unsteadiness

# Powers of 10 by which a parameter is multiplied, and a start value is.
POWERS, POWERS_OF_STARTS = np.array([-6, -4, -2, -1, 1, 2, 4, 6]), np.array([-12, -6, -3, -1, 0])
HUGE = 1e200
# Start values whose default is 0 have this value beside the one that varies, so that something moves.
START = 0.1
# A run lasts for so many radians of its frequency at the start, and no longer than this, in time units.
RADIANS, LONGEST = 60.0, 1e3


def generic_cases(system: System) -> list[StressCase]:
    """A case for each parameter: its default times powers of 10, its range, and a huge value.

    Values outside the range of a parameter are left out. The length of each run follows from its frequency at the
    start, so that stiff runs are short.

    Parameters
    ----------
    system : System
    """
    usual = {name: _usual(p) for name, p in system.parameters.items() if np.isfinite(p.default)}
    cases = [_case(system, name, usual | {name: _values(system.parameters[name])}) for name in usual]
    return [_case(system, "defaults", {}), _case(system, "beside the defaults", usual), *cases]


def _usual(parameter: Parameter) -> float:
    """A value at which something moves: the default, and of a start value that is 0 a small one."""
    if not parameter.start or parameter.default != 0:
        return parameter.default
    return START if parameter.low <= START <= parameter.high else parameter.default


def _values(parameter: Parameter) -> Array:
    """Small, large and huge values of a parameter within its range."""
    scale = parameter.default if parameter.default != 0 else 1.0
    values = scale * 10.0 ** (POWERS_OF_STARTS if parameter.start else POWERS)
    values = np.concatenate([values, -values, [HUGE, -HUGE]])
    if np.isfinite(parameter.low) and np.isfinite(parameter.high):
        values = np.concatenate([values, np.linspace(parameter.low, parameter.high, 5)])
    inside = (values >= parameter.low) & (values <= parameter.high)
    inside &= (values > parameter.low) | (not parameter.open_low)
    return np.unique(values[inside])


def _case(system: System, name: str, columns: Mapping[str, float | Array]) -> StressCase:
    meaning = system.parameters[name].meaning if name in system.parameters else "one motion"
    case = StressCase(name, meaning, 1.0, columns)
    points = case_points(system, case).points
    with np.errstate(all="ignore"):
        frequency = numeric_bound.before_run(
            system, points, np.full_like(next(iter(points.values())), LONGEST)
        )
        duration = np.fmin(RADIANS / frequency, LONGEST)
    usable = np.isfinite(duration) & (duration > 1e-300)
    return StressCase(name, meaning, np.where(usable, duration, 1.0), columns)


def true_labels(system: System, part: CasePoints, settings: Settings) -> tuple[TrueLabels, Mask]:
    """True labels of the points of a generic case by the reference integrator, and where they are known.

    Points whose state or frequency is not finite at the start have no label.

    Parameters
    ----------
    system : System
    part : CasePoints
    settings : Settings
        Only the tolerances of the labels are used.
    """
    size = part.duration.size
    label, spread = np.full(size, Label.UNRESOLVED, np.int8), np.full(size, np.nan)
    source, known = np.full(size, "overflow", "<U15"), np.ones(size, bool)
    with np.errstate(all="ignore"):
        start, frequency = system.initial_state(part.points), system.frequency_bound(part.points)
    usable = np.isfinite(start).all(0) & np.isfinite(frequency)
    where = np.flatnonzero(usable)
    while where.size:
        points: Points = {name: values[where] for name, values in part.points.items()}
        try:
            solution = reference(system, points, part.duration[where], settings)
        except ReferenceFailureError as failure:
            known[where[failure.indices]] = False
            where = np.delete(where, failure.indices)
            continue
        label[where], source[where], known[where] = solution.label, "reference", solution.label_certain
        spread[where] = unsteadiness(system, solution.statistics, settings)
        break
    return TrueLabels(label, spread, source, no_statistics(size)), known
