"""Variables that a scene may ask for: stability by the normal form, and the coefficients of the form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import NonlinearStability
from ...systems.base import DerivedVariable, Points, System
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.system import conservative, energy_stable, kinds_of_stability, steady_families
from . import RESONANCE_BAND

NORMAL_FORM = ("birkhoff_c20", "birkhoff_c11", "birkhoff_c02", "birkhoff_determinant")
NONLINEAR = "nonlinear_stability"

_BANDS = f"within {RESONANCE_BAND:g} of l1/l2 = -1, -2 and -3 that of the resonance; with three degrees of freedom undecided"
_FORM = "of H = l1 J1 + l2 J2 + c20 J1^2 + c11 J1 J2 + c02 J2^2; nan without two degrees of freedom and two frequencies"


def normal_form(system: System) -> dict[str, DerivedVariable]:
    """Return the verdict and the coefficients of the normal form of a gyrostat as variables."""
    if not isinstance(system, Gyrostat):
        return {}

    def group(_: Any, points: Points, __: Any, pause: Callable[[], None]) -> dict[str, NDArray[Any]]:
        from .nonlinear import of_points

        with np.errstate(all="ignore"):
            for linear in (steady_families, energy_stable, conservative, kinds_of_stability):
                pause()
                linear(system, points)
            pause()
            verdicts, values = of_points(system, points)
        return {NONLINEAR: verdicts, **dict(zip(NORMAL_FORM, values, strict=True))}

    form, flags = "of the normal form of degree 4", {NONLINEAR: NonlinearStability.meanings()}
    rows = (
        (NONLINEAR, "1", "stability of the steady motion in the full equations, from theory", _BANDS),
        ("birkhoff_c20", "kg-1 m-2", f"coefficient of the squared action of the larger frequency {form}", _FORM),
        ("birkhoff_c11", "kg-1 m-2", f"coefficient of the product of the actions {form}", _FORM),
        ("birkhoff_c02", "kg-1 m-2", f"coefficient of the squared action of the smaller frequency {form}", _FORM),
        ("birkhoff_determinant", "kg-1 m-2 s-2", f"determinant D = c20 l2^2 - c11 l1 l2 + c02 l1^2 {form}", _FORM),
    )  # fmt: skip
    return {row[0]: DerivedVariable.of_group(group, *row, flags=flags.get(row[0])) for row in rows}
