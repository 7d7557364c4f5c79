"""Indicators of chaos: mean MEGNO, the largest Lyapunov exponent, and whether a motion is regular or chaotic."""

from __future__ import annotations

from dataclasses import dataclass

from ..flags import Regularity
from ..systems.base import System
from .instrument import Instrument, Variable

_TANGENT = (
    "of one tangent vector: changes of the rates (in units of the orbital rate, or 1) and a rotation, for bodies about a fixed"
    " point the change of gamma, which begins as (5, -4, 6, 3, 4, -3), there gamma x (3, 4, -3), divided by its norm"
)
_TANGENT_OF_STATES = "of one tangent vector of all states in their units, which begins as (5, -4, 6, 3, 4, -3, ...), divided by its norm"


@dataclass(frozen=True)
class Chaos(Instrument):
    """Instrument of the indicators of chaos, for bodies and for systems with observables."""

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        tangent = _TANGENT_OF_STATES if system.observables else _TANGENT
        comment = (
            f"{tangent}; integrated by rk8 with at most 0.3 rad of the fastest frequency a step; nan where the status is not ok, and"
            " where the growth may come from one passage of an unstable motion or from rounding errors there"
        )
        return (
            Variable(
                "regularity", "int8", "1", "whether neighbouring motions separate exponentially", Regularity.meanings(),
                "chaos with an exponent below about 10 / duration reads as regular", optional=True,
            ),
            Variable("megno", "float64", "1", "mean exponential growth factor of nearby orbits, averaged over the run", comment=comment, optional=True),
            Variable("lyapunov", "float64", "s-1", "largest Lyapunov exponent, as measured at the end of the run", comment=comment, optional=True),
        )  # fmt: skip
