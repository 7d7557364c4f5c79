"""The magnetised satellite-gyrostat on a circular orbit (Yehia & El-kenani 2021)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ...flags import SATELLITE_RESERVED_FAMILIES
from ..base import Array, Flags, Mask, Points, StressCase, shape_of
from ..gyrostat import Gyrostat
from . import any_axis, equations, families, initial


class Satellite(Gyrostat):
    """Gyrostat with a magnet on a circular orbit, under the gravity gradient and a magnetic field."""

    name = "satellite"
    title = "magnetised satellite-gyrostat on a circular orbit"
    frame = "orbital"
    frame_axes = ("radius", "velocity", "normal")
    reference = "H. M. Yehia, H. N. El-kenani, J. Appl. Comput. Mech. 7(4) (2021) 2120-2128"
    doi = "10.22055/JACM.2021.37913.3113"

    equations = equations
    parameters = initial.PARAMETERS
    rate_states = ("w1", "w2", "w3")
    equal_parameters = (("A", "B"),)
    constants = staticmethod(initial.constants)
    integral_scales = staticmethod(initial.integral_scales)
    frequency_bound = staticmethod(initial.frequency_bound)
    specialization = staticmethod(initial.specialization)

    initial_state = staticmethod(initial.initial_state)
    steady_rates = staticmethod(initial.steady_rates)

    squared_rate = staticmethod(families.squared_rate)
    growth_about_vertical = staticmethod(initial.growth_about_vertical)
    families = families.FAMILIES | any_axis.FAMILIES
    reserved_families = SATELLITE_RESERVED_FAMILIES
    geometries = MappingProxyType(
        {
            "none": "drifting or unresolved",
            "cylindrical": "the third axis stays on the orbit normal",
            "perp_radius": "the third axis is at rest in the orbital frame, perpendicular to the radius",
            "perp_velocity": "the third axis is at rest in the orbital frame, perpendicular to the velocity",
            "oblique": "the third axis is at rest in the orbital frame in another direction",
            "general": "the third axis precesses in the orbital frame",
        }
    )
    body = staticmethod(initial.body)
    axial_rotor = "k3"
    conserves_axial_momentum = staticmethod(initial.conserves_axial_momentum)
    frequency_comment = (
        "without damping; nan for exponents that are 0 or have a real part, off every family, and where the linear equations are"
        " periodic"
    )
    energy_comment = (
        "on the level of the momentum about an axis of symmetry, where there is one; unknown where the linear equations are"
        " periodic"
    )

    def possible_start(self, points: Points) -> Mask:
        """Everywhere: numbers that overflow get the status not_finite."""
        return np.ones(shape_of(points), bool)

    def warnings(self, points: Points) -> list[str]:
        A, B, C = points["A"], points["B"], points["C"]
        symmetric = (A != B) & ((B == C) | (A == C))
        if not symmetric.any():
            return []
        return [
            "at some points A != B but B = C or A = C: label describes the motion of the third axis, so that a"
            " steady motion about the axis of symmetry of the body is labelled as drifting; label_any_axis, a variable"
            " for [outputs], describes motions about any axis"
        ]

    def rate_unit(self, points: Points) -> Array:
        """The orbital rate, or 1 without an orbit."""
        return np.where(points["Omega"] != 0, np.abs(points["Omega"]), 1.0)

    def frame_rate(self, points: Points) -> Array:
        """Angular velocity Omega of the orbit."""
        return points["Omega"]

    def geometry(
        self,
        measured: Mapping[str, Array],
        steady: Mask,
        cylinder: Mask,
        rate_tolerance: float,
        angle_tolerance: float,
    ) -> Flags:
        tests = {
            "none": ~steady,
            "cylindrical": cylinder,
            "general": np.abs(measured["psi_dot_mean"]) > rate_tolerance,
            "perp_radius": np.abs(measured["axis_1"]) <= angle_tolerance,
            "perp_velocity": np.abs(measured["axis_2"]) <= angle_tolerance,
        }
        return self.first_geometry(tests, "oblique")

    def stress_cases(self) -> Sequence[StressCase]:
        """Stiff and extreme satellites."""
        from ..gyrostat.stress_cases import satellite_cases

        return satellite_cases(self)


SATELLITE = Satellite()
