"""The one registry of dataset variables: writer, validator, labels, command line, docs and tests read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .systems.base import System

LABELS = {
    "not_computed": "not computed",
    "regular_precession": "theta, psi' and phi' are constant, psi' and phi' are not zero",
    "permanent_rotation": "theta, psi' and phi' are constant and psi' or phi' is zero, or the third axis stays on the vertical",
    "drifting": "theta, psi' or phi' varies",
    "unresolved": "the numbers cannot tell: see status",
}
STATUS = {
    "not_computed": "not computed: the family asked for has no motion here",
    "ok": "integrated and resolved",
    "not_finite": "the state or a statistic overflowed or became NaN",
    "drift_exceeded": "a first integral changed by more than drift_tolerance",
    "under_resolved": "the step is too long for the fastest frequency of the point",
    "step_sensitive": "the label changes when the step is halved, or could by as much as the measurements did",
    "roundoff_decided": "an exact start on an unstable motion, run until rounding errors decide",
}
AGREEMENT = {
    "not_compared": "nothing to compare: unresolved, or theory is silent",
    "agree": "measured label and theory agree",
    "theory_only": "theory says steady, the measured motion drifts",
    "numerics_only": "theory says drifting, the measured motion is steady",
    "differ": "both steady, with different labels",
}
STABLE = {
    "unknown": "linear stability unknown, or no steady motion",
    "stable": "no characteristic exponent has a positive real part",
    "unstable": "some characteristic exponent has a positive real part",
}


@dataclass(frozen=True)
class Variable:
    """One variable of an atlas; every one has the dimensions of the atlas' points."""

    name: str
    dtype: str  # NumPy dtype in the file
    units: str  # UDUNITS
    long_name: str
    flags: dict[str, str] | None = None  # flag name -> sentence, values 0, 1, 2, ...
    comment: str = ""

    def attributes(self) -> dict[str, object]:
        """CF attributes: units or flags, long_name, comment."""
        found: dict[str, object] = {"long_name": self.long_name}
        if self.flags is None:
            found["units"] = self.units
        else:
            found["flag_values"] = np.arange(len(self.flags), dtype=self.dtype)
            found["flag_meanings"] = " ".join(self.flags)
        if self.comment:
            found["comment"] = self.comment
        return found


# Only in refined atlases, which are not integrated at every point.
COMPUTED = Variable(
    "computed", "int8", "1", "where the labels come from",
    {
        "interpolated": "labels of the points around, which are all the same",
        "computed": "integrated, or without motion of the family",
    },
)  # fmt: skip
_NO_MEANING = "nan where the third axis stays inside the cylinder: psi' and phi' have no meaning there"


def variables(system: System) -> dict[str, Variable]:
    """Every variable an atlas of the system can hold, by name, in the order of the file."""
    families = {"none": "no family of steady motions"} | {f.name: f.title for f in system.families.values()}
    flag = [
        Variable("label", "int8", "1", f"kind of motion in the {system.frame} frame", LABELS),
        Variable("label_inertial", "int8", "1", "kind of motion in the inertial frame", LABELS),
        Variable("geometry", "int8", "1", "geometry of the measured motion", dict(system.geometries)),
        Variable("status", "int8", "1", "how far the label can be trusted", STATUS),
        Variable("family", "int8", "1", "family of exact steady motions the start belongs to", families),
        Variable("stable", "int8", "1", "linear stability of the steady motion, from theory", STABLE),
        Variable("predicted", "int8", "1", f"kind of motion in the {system.frame} frame, from theory alone", LABELS),
        Variable("predicted_inertial", "int8", "1", "kind of motion in the inertial frame, from theory alone", LABELS),
        Variable("agreement", "int8", "1", "measured label against theory", AGREEMENT),
    ]  # fmt: skip
    rate, pure = "rad s-1", "1"
    real = [
        ("theta_dot_rms", rate, "root mean square of the nutation rate", ""),
        ("theta_dot_std", rate, "standard deviation of the nutation rate", ""),
        ("psi_dot_mean", rate, "mean precession rate", _NO_MEANING),
        ("psi_dot_std", rate, "standard deviation of the precession rate", _NO_MEANING),
        ("phi_dot_mean", rate, "mean rate of proper rotation", _NO_MEANING),
        ("phi_dot_std", rate, "standard deviation of the rate of proper rotation", _NO_MEANING),
        ("normal_rate_mean", rate, "mean rate about the vertical of the frame", ""),
        ("normal_rate_std", rate, "standard deviation of the rate about the vertical of the frame", ""),
        ("theta_min", "rad", "least angle between third axis and vertical", ""),
        ("theta_max", "rad", "largest angle between third axis and vertical", ""),
        ("integral_drift", pure, "largest relative change of a first integral", ""),
        ("step", "s", "integration step", ""),
        ("step_ratio", pure, "step times bound of the fastest frequency over the stability limit of the method", ""),
        ("error_estimate", pure, "estimated relative error of states and rates at the end of the run",
         "the largest of: phase error and damping of an oscillation at the bound of the fastest frequency, times"
         " the growth of an unstable family (to 1 at most); change of a first integral; where the axis was in the"
         " cylinder for a part of the run, the share of one sample; and where the point was integrated again at"
         " half the step, the change of a mean or spread of a rate over that bound"),
        ("condition_residual", pure, "how far the start is from a steady motion, 0 on an exact one", ""),
        ("growth_rate", rate, "largest real part of the characteristic exponents of the steady motion, from theory",
         "nan where theory has no steady motion or no exponent"),
        ("end_time", "s", "time at which the integration ended", ""),
    ]  # fmt: skip
    floats = [
        Variable(name, "float64", units, long_name, None, note) for name, units, long_name, note in real
    ]
    layers = [
        Variable(y.name, "float64", y.unit, y.long_name, None, y.comment) for y in system.layers.values()
    ]
    every = {v.name: v for v in flag + floats + layers}
    if system.frame_rate is None:
        del every["label_inertial"], every["predicted_inertial"]
    return every
