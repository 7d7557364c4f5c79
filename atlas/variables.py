"""The one registry of dataset variables: writer, validator, labels, command line, docs and tests read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .flags import Agreement, Label, Stability, Status
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
        Variable(y.name, "float64", y.unit, y.long_name, None, y.comment) for y in system.derived.values()
    ]
    every = {v.name: v for v in flag + floats + layers}
    if system.frame_rate is None:
        del every["label_inertial"], every["predicted_inertial"]
    return every
