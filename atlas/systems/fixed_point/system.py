"""The gyrostat about a fixed point in a central Newtonian field (Amer, Abo Essa, Ibrahim & Amer 2013)."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from ..base import Array, Flags, Geometry, Points, identify, other_families, shared
from ..gyrostat import Gyrostat
from . import any_axis, equations, families, initial


class FixedPoint(Gyrostat):
    """Heavy gyrostat that turns about a fixed point and is attracted by a distant centre."""

    name = "fixed_point"
    title = "gyrostat about a fixed point in a central Newtonian field"
    frame = "space"
    # gamma points to the attracting centre
    frame_axes = ("$x$", "$y$", "down (\N{GREEK SMALL LETTER GAMMA})")
    frame_text = "the vertical, its third axis, points down: a top with z0 > 0 stands upright at theta0 = pi"
    reference = (
        "T. S. Amer, Y. M. Abo Essa, I. A. Ibrahim, W. S. Amer, Int. J. Engineering Research and Applications"
        " 3(5) (2013) 655-671"
    )
    bibtex = """@article{amer2013,
  author = {Amer, T. S. and Abo Essa, Y. M. and Ibrahim, I. A. and Amer, W. S.},
  title = {The Spinning Motion of a Gyrostat under the Influence of {Newtonian} Force Field and a Gyrostatic Moment
           Vector},
  journal = {International Journal of Engineering Research and Applications},
  volume = {3},
  number = {5},
  pages = {655--671},
  year = {2013},
}
"""

    equations = equations
    parameters = initial.PARAMETERS
    rate_states = ("p", "q", "r")
    constants = staticmethod(initial.constants)
    integral_scales = staticmethod(initial.integral_scales)
    frequency_bound = staticmethod(initial.frequency_bound)
    specialization = staticmethod(initial.specialization)

    initial_state = staticmethod(initial.initial_state)
    steady_rates = staticmethod(families.steady_rates)
    as_euler_angles = staticmethod(initial.as_euler_angles)
    check = staticmethod(initial.check)
    possible_start = staticmethod(initial.possible_start)
    start_condition = initial.START_CONDITION
    warnings = staticmethod(initial.warnings)

    squared_unit = staticmethod(families.squared_rate)
    families = families.FAMILIES | any_axis.FAMILIES
    geometries = MappingProxyType(
        {
            "sleeping": Geometry("the third axis stays on the vertical", lambda _, cylinder, *__: cylinder),
            "conical": Geometry(
                "the body turns about its third axis, which precesses about the vertical or is at rest",
                lambda measured, _, rate, __: ~(np.abs(measured["phi_dot_mean"]) <= rate),
            ),
            "staude": Geometry(
                "the body turns about the vertical alone (phi' = 0) or is at rest",
                lambda measured, *_: np.isfinite(measured["phi_dot_mean"]),
            ),
        }
    )
    body = staticmethod(initial.body)
    axial_rotor = "l3"
    conserves_axial_momentum = staticmethod(initial.conserves_axial_momentum)
    frequency_comment = (
        "nan for exponents that are 0 or have a real part, and off conical, sleeping, staude and rest; of a permanent rotation"
        " relative to the body, of a symmetric body on the vertical in space"
    )
    energy_comment = (
        "on the level of the momentum about the vertical, without a field of the angular momentum; energy_stable_axial also of that"
        " about the axis of symmetry; unknown off conical, sleeping, staude and rest"
    )

    def identify_family(self, points: Points) -> tuple[Flags, Array]:
        """Return flag and residual of the family of each start. Families about the third axis and the vertical come before all others."""
        return identify(points, families.ORDER, other_families(self))

    @shared
    def oscillation_families(self, points: Points) -> Flags:
        """Return the flags of the families of motions about the third axis and the vertical."""
        return families.identify_family(points)[0]


FIXED_POINT = FixedPoint()
