"""The points of a stress case: every parameter of the system as a column."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene.tables import point_columns
from ..systems.base import Array, Mask, Points, StressCase, System


@dataclass(frozen=True)
class CasePoints:
    """A stress case as arrays of shape (points,)."""

    name: str  # of the case
    points: Points
    base: Points  # before the additions of the case
    duration: Array  # time units
    names: tuple[
        str, ...
    ]  # of the points: values of the parameters, and of the duration, that vary within the case
    may_stay_unresolved: str
    truth: str  # as in StressCase

    def subset(self, where: Mask) -> CasePoints:
        """The points where a mask is true."""
        return replace(
            self,
            points={name: values[where] for name, values in self.points.items()},
            base={name: values[where] for name, values in self.base.items()},
            duration=self.duration[where],
            names=tuple(name for name, kept in zip(self.names, where, strict=True) if kept),
        )


def case_points(system: System, case: StressCase) -> CasePoints:
    """Points of a case: columns and defaults, the parameter of the family solved, then the additions."""
    varying = {k: np.asarray(v, float) for k, v in {**case.columns, **case.additions}.items() if np.ndim(v)}
    size = max((values.size for values in varying.values()), default=1)
    points, _ = point_columns(
        system, {name: np.broadcast_to(values, (size,)) for name, values in case.columns.items()}
    )
    if case.solve is not None:
        family, parameter = case.solve
        points[parameter] = system.families[family].solve[parameter](points)
    base = dict(points)
    for name, amount in case.additions.items():
        points[name] = points[name] + np.asarray(amount, float)
    varying |= {"duration": np.asarray(case.duration, float)} if np.ndim(case.duration) else {}
    names = [", ".join(f"{k} = {v[i]:.4g}" for k, v in varying.items() if v.any()) for i in range(size)]
    duration = np.broadcast_to(np.asarray(case.duration, float), (size,)).copy()
    return CasePoints(case.name, points, base, duration, tuple(names), case.may_stay_unresolved, case.truth)
