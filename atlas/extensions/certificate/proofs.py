"""The instrument that proves labels for every duration, from starts and tolerances alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from ...measure.instrument import Instrument, Tolerances, Variable
from ...systems.base import Points, System
from ...systems.gyrostat import Gyrostat
from .bounds import BOUND, PROOFS_OF
from .bounds import Proof as Proof

_COMMENT = (
    "of theta', and of psi' and phi' from the middle of their ranges, or in the cylinder of the rate about the vertical; nan where"
    " no limit is known"
)


@dataclass(frozen=True)
class Proofs(Instrument):
    """Labels of gyrostats that hold for every duration."""

    proofs_of = PROOFS_OF

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        frames = {"label": system.frame} | (
            {} if system.frame_rate is None else {"label_inertial": "inertial"}
        )
        return (
            *(
                Variable(
                    self.proofs_of[name], "int8", "1", f"proof of the kind of motion in the {frame} frame",
                    Proof.meanings(), optional=True,
                )
                for name, frame in frames.items()
            ),
            Variable(BOUND, "float64", "rad s-1", "limit of the deviation of a rate for all time", None, _COMMENT, True),
        )  # fmt: skip

    def variables(self, system: System) -> tuple[Variable, ...]:
        return self.every_variable(system) if isinstance(system, Gyrostat) else ()

    def proofs(
        self, system: System, points: Points, tolerances: Tolerances, in_machine_code: bool = False
    ) -> dict[str, NDArray[Any]]:
        from .rules import prove_points  # Only scenes that ask for proofs need this module.

        assert isinstance(system, Gyrostat)
        return prove_points(system, points, tolerances, in_machine_code)


PROOFS = Proofs()
