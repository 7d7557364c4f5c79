"""Stress cases of a system that has none of its own: large, small and stiff values of every parameter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..engine import numeric_bound
from ..flags import Label
from ..scene.model import Settings
from ..systems.base import Array, Mask, Parameter, Points, StressCase, System
from ..variables import main_instrument
from .reference import ReferenceFailureError, reference
from .stress_points import CasePoints, case_points
from .stress_truth import TrueLabels, no_statistics

# Powers of 10 by which a parameter is multiplied, and a start value is.
POWERS, POWERS_OF_STARTS = np.array([-6, -4, -2, -1, 1, 2, 4, 6]), np.array([-12, -6, -3, -1, 0])
HUGE = 1e200
# Value of the other start values whose default is 0, so that the state changes.
START = 0.1
# Length of a run in radians of its frequency at the start, and its limit in time units.
RADIANS, MAX_DURATION = 60.0, 1e3


def generic_cases(system: System) -> list[StressCase]:
    """A case for each parameter: its default times powers of 10, its range, and a huge value.

    Values outside the range of a parameter are left out. The length of each run follows from its frequency at the
    start, so that stiff runs are short.
    """
    moderate = {name: _moderate_value(p) for name, p in system.parameters.items() if np.isfinite(p.default)}
    cases = [_case(system, name, moderate | {name: _values(system.parameters[name])}) for name in moderate]
    return [_case(system, "defaults", {}), _case(system, "beside the defaults", moderate), *cases]


def _moderate_value(parameter: Parameter) -> float:
    """The default, or START for a start value whose default is 0, so that the state changes."""
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
    """A case of some columns, each run with a duration that follows from its frequency at the start."""
    meaning = system.parameters[name].meaning if name in system.parameters else "one motion"
    case = StressCase(name, meaning, 1.0, columns)
    points = case_points(system, case).points
    with np.errstate(all="ignore"):
        frequency = numeric_bound.before_run(
            system, points, np.full_like(next(iter(points.values())), MAX_DURATION)
        )
        duration = np.fmin(RADIANS / frequency, MAX_DURATION)
    usable = np.isfinite(duration) & (duration > 1e-300)
    return StressCase(name, meaning, np.where(usable, duration, 1.0), columns)


def true_labels(system: System, part: CasePoints, settings: Settings) -> tuple[TrueLabels, Mask]:
    """True labels of the points of a generic case by the reference integrator, and a mask of those that are known.

    Points whose state or frequency is not finite at the start have no label.

    settings: only the tolerances of the labels are used.
    """
    size = part.duration.size
    label, largest = np.full(size, Label.UNRESOLVED, np.int8), np.full(size, np.nan)
    source, known = np.full(size, "overflow", "<U15"), np.ones(size, bool)
    with np.errstate(all="ignore"):
        start, frequency = system.initial_state(part.points), system.frequency_bound(part.points)
    usable = np.isfinite(start).all(0) & np.isfinite(frequency)
    indices = np.flatnonzero(usable)
    while indices.size:
        points: Points = {name: values[indices] for name, values in part.points.items()}
        try:
            solution = reference(system, points, part.duration[indices], settings)
        except ReferenceFailureError as failure:
            known[indices[failure.indices]] = False
            indices = np.delete(indices, failure.indices)
            continue
        label[indices], source[indices], known[indices] = solution.label, "reference", solution.label_certain
        largest[indices] = main_instrument(system).unsteadiness(system, solution.statistics, settings)
        break
    return TrueLabels(label, largest, source, no_statistics(size)), known
