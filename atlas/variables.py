"""The one registry of dataset variables: writer, validator, labels, command line, docs and tests read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .engine.statistics import STATISTICS
from .flags import Agreement, Label, Regularity, Stability, Status
from .systems.base import System


@dataclass(frozen=True)
class Variable:
    """One variable of an atlas; every one has the dimensions of the atlas' points."""

    name: str
    dtype: str  # NumPy dtype in the file
    units: str  # UDUNITS
    long_name: str
    flags: dict[str, str] | None = None  # flag name -> sentence, values 0, 1, 2, ...
    comment: str = ""
    optional: bool = False  # only in the atlases of scenes that ask for it

    def attributes(self) -> dict[str, object]:
        """CF attributes: units or flags, long_name, comment."""
        attributes: dict[str, object] = {"long_name": self.long_name}
        if self.flags is None:
            attributes["units"] = self.units
        else:
            attributes["flag_values"] = np.arange(len(self.flags), dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(self.flags)
        if self.comment:
            attributes["comment"] = self.comment
        return attributes


# Dimension of points that come from no axes.
POINT = "point"
# Only in refined atlases, which are not integrated at every point.
COMPUTED = Variable(
    "computed", "int8", "1", "where the labels come from",
    {
        "interpolated": "labels of the points around, which are all the same",
        "computed": "integrated, or without motion of the family",
    },
)  # fmt: skip
_ERROR_ESTIMATE = (
    "differences of rates over the bound of the fastest frequency, of angles in rad; expected from phase error, dissipation,"
    " rounding and interpolation, the growth of an unstable family, the distance of the third axis from the vertical and the"
    " change of first integrals, or measured by a second run (check_half_step); at least 1 where the axis was in the"
    " cylinder for a part of the run"
)
_NO_MEANING = "nan where the third axis stays inside the cylinder: psi' and phi' have no meaning there"


# Variables that need a run with a tangent vector.
CHAOS = frozenset(("megno", "lyapunov", "regularity"))
_TANGENT = (
    "of one tangent vector: changes of the rates (in units of the orbital rate, or 1) and a rotation, for bodies about a fixed"
    " point the change of gamma, which begins as (5, -4, 6, 3, 4, -3), there gamma x (3, 4, -3), divided by its norm;"
    " integrated by rk8 with at most 0.3 rad of the fastest frequency a step; nan where the status is not ok"
)


def data_variables(system: System) -> dict[str, Variable]:
    """Every data variable that a dataset of the system may have: no coordinate can have such a name."""
    return variables(system) | {COMPUTED.name: COMPUTED}


def variables(system: System) -> dict[str, Variable]:
    """Every variable an atlas of the system can hold, by name, in the order of the file."""
    families = {"none": "no family of steady motions"} | {f.name: f.title for f in system.families.values()}
    flag = [
        Variable("label", "int8", "1", f"kind of motion in the {system.frame} frame", Label.meanings()),
        Variable("label_inertial", "int8", "1", "kind of motion in the inertial frame", Label.meanings()),
        Variable("geometry", "int8", "1", "geometry of the measured motion", dict(system.geometries)),
        Variable("status", "int8", "1", "how far the label can be trusted", Status.meanings()),
        Variable("family", "int8", "1", "family of exact steady motions the start belongs to", families),
        Variable("stable", "int8", "1", "linear stability of the steady motion, from theory", Stability.meanings()),
        Variable("predicted", "int8", "1", f"kind of motion in the {system.frame} frame, from theory alone", Label.meanings()),
        Variable("predicted_inertial", "int8", "1", "kind of motion in the inertial frame, from theory alone", Label.meanings()),
        Variable("agreement", "int8", "1", "measured label against theory", Agreement.meanings()),
    ]  # fmt: skip
    theory = [
        Variable("condition_residual", "float64", "1", "how far the start is from a steady motion, 0 on an exact one"),
        Variable(
            "growth_rate", "float64", "rad s-1",
            "largest real part of the characteristic exponents of the steady motion, from theory",
            comment="nan where theory has no steady motion or no exponent",
        ),
        Variable("end_time", "float64", "s", "time at which the integration ended"),
    ]  # fmt: skip
    numerics = [
        Variable("step", "float64", "s", "integration step"),
        Variable(
            "step_ratio", "float64", "1",
            "step times bound of the fastest frequency over the stability limit of the method",
        ),
        Variable(
            "error_estimate", "float64", "1", "estimated relative error of the final state and of every statistic",
            comment=_ERROR_ESTIMATE,
        ),
    ]  # fmt: skip
    measured = [
        Variable(s.name, "float64", s.unit, s.long_name, comment=_NO_MEANING if s.needs_psi else "")
        for s in STATISTICS
    ]
    chaos = [
        Variable(
            "regularity", "int8", "1", "whether neighbouring motions separate exponentially", Regularity.meanings(),
            "an exact start on an unstable periodic motion reads as chaotic, and chaos with an exponent below about"
            " 10 / duration as regular", optional=True,
        ),
        Variable("megno", "float64", "1", "mean exponential growth factor of nearby orbits, averaged over the run", comment=_TANGENT, optional=True),
        Variable("lyapunov", "float64", "s-1", "largest Lyapunov exponent, as measured at the end of the run", comment=_TANGENT, optional=True),
    ]  # fmt: skip
    derived = [
        Variable(d.name, "float64", d.unit, d.long_name, comment=d.comment, optional=True)
        for d in system.derived.values()
    ]
    registry = {v.name: v for v in (*flag, *measured, *numerics, *theory, *chaos, *derived)}
    missing: set[str] = set()
    if system.frame_rate is None:
        missing |= {"label_inertial", "predicted_inertial"}
    if not system.families:
        missing |= {"family", "stable", "growth_rate", "condition_residual", "predicted", "agreement"}
        missing |= {"predicted_inertial"}
    if not system.equations.INTEGRALS:
        missing |= {"integral_drift"}
    if len(system.geometries) < 2:
        missing |= {"geometry"}
    return {name: variable for name, variable in registry.items() if name not in missing}


def default_variables(system: System) -> list[str]:
    """Names of the variables that an atlas holds unless a scene lists others, in the order of the file."""
    return [name for name, variable in variables(system).items() if not variable.optional]
