"""The magnetised satellite-gyrostat on a circular orbit (Yehia & El-kenani 2021)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from ..base import Array, Geometry, Mask, Points, shape_of
from ..gyrostat import Gyrostat
from . import any_axis, equations, families, initial


def _rests(measured: Mapping[str, Array], rate: Array | float) -> Mask:
    """Return where the third axis does not precess."""
    return ~(np.abs(measured["psi_dot_mean"]) > rate)


class Satellite(Gyrostat):
    """Gyrostat with a magnet on a circular orbit, under the gravity gradient and a magnetic field."""

    name = "satellite"
    title = "magnetised satellite-gyrostat on a circular orbit"
    frame = "orbital"
    frame_axes = ("radius", "velocity", "normal")
    frame_text = (
        "along radius, velocity and orbit normal, the vertical, lie the three body axes at theta0 = psi0 = phi0 = 0; nadir is"
        " minus the radius; roll, pitch and yaw are about velocity, minus the normal and nadir"
    )
    reference = "H. M. Yehia, H. N. El-kenani, J. Appl. Comput. Mech. 7(4) (2021) 2120-2128"
    doi = "10.22055/JACM.2021.37913.3113"
    bibtex = """@article{yehia2021,
  author = {Yehia, H. M. and El-kenani, H. N.},
  title = {Effect of the Gravity and Magnetic Field to Find Regular Precessions of a Satellite-gyrostat with Principal
           Axes on a Circular Orbit},
  journal = {Journal of Applied and Computational Mechanics},
  volume = {7},
  number = {4},
  pages = {2120--2128},
  year = {2021},
  doi = {10.22055/JACM.2021.37913.3113},
}
"""

    equations = equations
    parameters = initial.PARAMETERS
    rate_states = ("w1", "w2", "w3")
    constants = staticmethod(initial.constants)
    integral_scales = staticmethod(initial.integral_scales)
    frequency_bound = staticmethod(initial.frequency_bound)
    specialization = staticmethod(initial.specialization)

    initial_state = staticmethod(initial.initial_state)
    steady_rates = staticmethod(initial.steady_rates)

    squared_unit = staticmethod(families.squared_rate)
    families = families.FAMILIES | any_axis.FAMILIES
    geometries = MappingProxyType(
        {
            "cylindrical": Geometry(
                "the third axis stays on the orbit normal", lambda _, cylinder, *__: cylinder
            ),
            "perp_radius": Geometry(
                "the third axis is at rest in the orbital frame, perpendicular to the radius",
                lambda measured, _, rate, angle: (
                    _rests(measured, rate) & (np.abs(measured["axis_1"]) <= angle)
                ),
            ),
            "perp_velocity": Geometry(
                "the third axis is at rest in the orbital frame, perpendicular to the velocity",
                lambda measured, _, rate, angle: (
                    _rests(measured, rate) & (np.abs(measured["axis_2"]) <= angle)
                ),
            ),
            "oblique": Geometry(
                "the third axis is at rest in the orbital frame in another direction",
                lambda measured, _, rate, __: _rests(measured, rate),
            ),
            "general": Geometry(
                "the third axis precesses in the orbital frame",
                lambda measured, _, rate, __: ~_rests(measured, rate),
            ),
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
        "of the Jacobi integral; energy_stable_axial on the level of the momentum about an axis of symmetry; unknown where the linear"
        " equations are periodic"
    )

    def possible_start(self, points: Points) -> Mask:
        """Return True everywhere. Points whose numbers overflow get the status not_finite."""
        return np.ones(shape_of(points), bool)

    def frame_rate(self, points: Points) -> Array:
        """Return the angular velocity Omega of the orbit."""
        return points["Omega"]


SATELLITE = Satellite()
