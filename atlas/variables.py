"""The one registry of dataset variables: writer, validator, labels, command line, docs and tests read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .engine.observation import STATISTICS as OBSERVABLE_STATISTICS
from .engine.statistics import STATISTICS
from .errors import BadInput
from .flags import Agreement, Label, Regularity, Stability, Status, Steadiness
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
    " change of first integrals, or measured by a second run (check_half_step; always where the bound is numeric); at least 1 where the axis was in the"
    " cylinder for a part of the run"
)
_NO_MEANING = "nan where the third axis stays inside the cylinder: psi' and phi' have no meaning there"


_NUMERIC_BOUND = (
    "the bound is numeric: |J^64|^(1/64) of the Jacobian J at the start and at instants of a preliminary run, or half of"
    " what a derivative of a state by time is over the one before"
)
_INTEGRAL_DRIFT = next(
    Variable(s.name, "float64", s.unit, s.long_name) for s in STATISTICS if s.name == "integral_drift"
)
# Variables that need the sums about the circle of the angular velocity in the body, in the frame and in inertial space.
ANY_AXIS = (
    "label_any_axis", "label_any_axis_inertial", "precession_rate", "spin_rate", "nutation",
    "spin_axis_1", "spin_axis_2", "spin_axis_3", "precession_inclination", "agreement_any_axis",
)  # fmt: skip
_NOT_STEADY = "nan where label_any_axis is neither regular_precession nor permanent_rotation"
_SPIN_AXIS = (
    "direction of the angular velocity of a permanent rotation; of a regular precession the last component above"
    " cylinder_tolerance is positive; nan elsewhere and for a body at rest"
)
# Variables about any axes that follow from theory, the last from the measured label as well.
ANY_AXIS_THEORY = ("predicted_any_axis", "predicted_any_axis_inertial", "agreement_any_axis")
# Variables that need a run with a tangent vector.
CHAOS = frozenset(("megno", "lyapunov", "regularity"))
_TANGENT = (
    "of one tangent vector: changes of the rates (in units of the orbital rate, or 1) and a rotation, for bodies about a fixed"
    " point the change of gamma, which begins as (5, -4, 6, 3, 4, -3), there gamma x (3, 4, -3), divided by its norm"
)


def data_variables(system: System) -> dict[str, Variable]:
    """Every data variable that a dataset of the system may have: no coordinate can have such a name."""
    return variables(system) | {COMPUTED.name: COMPUTED}


def variables(system: System) -> dict[str, Variable]:
    """Variables that an atlas of the system can hold, in the order of the file; BadInput if names clash."""
    registry = _variables_of_observables(system) if system.observables else _variables_of_body(system)
    reserved = {*registry, *_every_variable_of_body(system), COMPUTED.name, POINT, "time"}
    for kind, names in (
        ("parameter", system.parameters),
        ("observable", [o.name for o in system.observables]),
    ):
        for name in names:
            if name in reserved:
                raise BadInput(
                    f"the system {system.name}: its {kind} {name} has the name of a variable of the atlas; choose another name"
                )
    return registry


def _every_variable_of_body(system: System) -> dict[str, Variable]:
    """The variables of the motion of a body in a frame, whether or not the system has them."""
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
        *_steps(system),
        Variable(
            "error_estimate", "float64", "1", "estimated relative error of the final state and of every statistic",
            comment=_ERROR_ESTIMATE,
        ),
    ]  # fmt: skip
    measured = [
        Variable(s.name, "float64", s.unit, s.long_name, comment=_NO_MEANING if s.needs_psi else "")
        for s in STATISTICS
    ]
    return {
        v.name: v
        for v in (
            *flag,
            *measured,
            *numerics,
            *theory,
            *_any_axis(system),
            *_chaos(_TANGENT),
            *_derived(system),
        )
    }


def _any_axis(system: System) -> list[Variable]:
    """The motion about any axes of body and frame."""
    return [
        Variable(
            "label_any_axis", "int8", "1", f"kind of motion in the {system.frame} frame, about any axes of body and frame",
            Label.meanings(), "the same as label where that is steady", optional=True,
        ),
        Variable(
            "label_any_axis_inertial", "int8", "1", "kind of motion in the inertial frame, about any axes of body and space",
            Label.meanings(), "the same as label_inertial where that is steady", optional=True,
        ),
        *(
            Variable(name, "float64", units, long_name, comment=comment, optional=True)
            for name, units, long_name, comment in (
                ("precession_rate", "rad s-1", f"rate of precession about an axis at rest in the {system.frame} frame, not negative",
                 f"0 for a permanent rotation; {_NOT_STEADY}"),
                ("spin_rate", "rad s-1", "rate of the body about the axis at rest in it",
                 f"for a permanent rotation the length of the angular velocity; {_NOT_STEADY}"),
                ("nutation", "rad", "angle between the axes at rest in the body and in the frame",
                 f"0 for a permanent rotation; {_NOT_STEADY}, and for a body at rest"),
                *((f"spin_axis_{i}", "1", f"component of the axis at rest in the body along the {axis} body axis", _SPIN_AXIS)
                  for i, axis in enumerate(("first", "second", "third"), 1)),
                ("precession_inclination", "rad", f"angle between the axis at rest in the {system.frame} frame and the vertical",
                 f"for a permanent rotation of the angular velocity; {_NOT_STEADY}, and for a body at rest"),
            )
        ),
        Variable(
            "predicted_any_axis", "int8", "1", f"kind of motion in the {system.frame} frame about any axes, from theory alone",
            Label.meanings(), "the same as predicted where that is steady", optional=True,
        ),
        Variable(
            "predicted_any_axis_inertial", "int8", "1", "kind of motion in the inertial frame about any axes, from theory alone",
            Label.meanings(), "the same as predicted_inertial where that is steady", optional=True,
        ),
        Variable(
            "agreement_any_axis", "int8", "1", "measured label about any axes against theory", Agreement.meanings(), optional=True,
        ),
    ]  # fmt: skip


def _variables_of_body(system: System) -> dict[str, Variable]:
    """The variables of a system that describes the motion of a body in a frame."""
    missing: set[str] = set()
    if system.frame_rate is None:
        missing |= {
            "label_inertial",
            "label_any_axis_inertial",
            "predicted_inertial",
            "predicted_any_axis_inertial",
        }
    if not system.families:
        missing |= {"family", "stable", "growth_rate", "condition_residual", "predicted", "agreement"}
        missing |= {"predicted_inertial", *ANY_AXIS_THEORY}
    if not system.equations.INTEGRALS:
        missing |= {"integral_drift"}
    if len(system.geometries) < 2:
        missing |= {"geometry"}
    registry = _every_variable_of_body(system)
    return {name: variable for name, variable in registry.items() if name not in missing}


def _steps(system: System) -> list[Variable]:
    """The variables of the steps."""
    bound = "numeric bound" if system.has_numeric_bound else "bound"
    comment = _NUMERIC_BOUND if system.has_numeric_bound else ""
    return [
        Variable("step", "float64", "s", "integration step", comment=comment),
        Variable(
            "step_ratio", "float64", "1",
            f"step times {bound} of the fastest frequency over the stability limit of the method", comment=comment,
        ),
    ]  # fmt: skip


def _chaos(tangent: str) -> list[Variable]:
    """The variables of CHAOS. tangent: what the tangent vector is."""
    comment = (
        f"{tangent}; integrated by rk8 with at most 0.3 rad of the fastest frequency a step; nan where the status is not ok, and"
        " where the growth may come from one passage of an unstable motion or from rounding errors there"
    )
    return [
        Variable(
            "regularity", "int8", "1", "whether neighbouring motions separate exponentially", Regularity.meanings(),
            "an exact start on an unstable periodic motion reads as chaotic, and chaos with an exponent below about"
            " 10 / duration as regular", optional=True,
        ),
        Variable("megno", "float64", "1", "mean exponential growth factor of nearby orbits, averaged over the run", comment=comment, optional=True),
        Variable("lyapunov", "float64", "s-1", "largest Lyapunov exponent, as measured at the end of the run", comment=comment, optional=True),
    ]  # fmt: skip


def _derived(system: System) -> list[Variable]:
    """The quantities from theory that a scene may ask for."""
    return [
        Variable(
            d.name, "int8" if d.flags else "float64", d.unit, d.long_name, dict(d.flags) if d.flags else None,
            comment=d.comment, optional=True,
        )
        for d in system.derived.values()
    ]  # fmt: skip


def _variables_of_observables(system: System) -> dict[str, Variable]:
    """The variables of a system with observables."""
    flag = [
        Variable("label", "int8", "1", "whether the observables are constant", Steadiness.meanings()),
        Variable("status", "int8", "1", "how far the label can be trusted", Status.meanings()),
    ]
    measured = [
        Variable(f"{o.name}_{suffix}", "float64", o.unit, text.format(o.long_name))
        for o in system.observables
        for suffix, text in OBSERVABLE_STATISTICS.items()
    ]
    if system.equations.INTEGRALS:
        measured.append(_INTEGRAL_DRIFT)
    error = Variable(
        "error_estimate", "float64", "1", "estimated relative error of the final state and of every statistic",
        comment="of the statistics over the largest magnitude of their observable; expected from phase error, dissipation,"
        " rounding and the change of first integrals, or measured by a second run (check_half_step; always where the bound is numeric)",
    )  # fmt: skip
    end_time = Variable("end_time", "float64", "s", "time at which the integration ended")
    tangent = "of one tangent vector of all states in their units, which begins as (5, -4, 6, 3, 4, -3, ...), divided by its norm"
    everything = (*flag, *measured, *_steps(system), error, end_time, *_chaos(tangent), *_derived(system))
    registry = {variable.name: variable for variable in everything}
    if len(registry) < len(everything):
        names = [variable.name for variable in everything]
        repeated = next(name for name in names if names.count(name) > 1)
        raise BadInput(
            f"the system {system.name}: two variables of its atlases would be called {repeated}; rename an observable"
        )
    return registry


def default_variables(system: System) -> list[str]:
    """Names of the variables that an atlas holds unless a scene lists others, in the order of the file."""
    return [name for name, variable in variables(system).items() if not variable.optional]
