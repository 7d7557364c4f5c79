"""The instrument of labels that are proved for every duration, from starts and tolerances alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import Flag
from ...measure.instrument import Instrument, Tolerances, Variable
from ...systems.base import Mask, Points, System, shape_of, subset
from ...systems.gyrostat import Gyrostat
from . import energy
from .bounds import Bounds, label
from .top import top

BOUND = "proof_bound"
_CHUNK = 4096  # points whose arrays stay in the cache
_COMMENT = (
    "of theta', and of psi' and phi' from the middle of their ranges, or in the cylinder of the rate about the vertical; nan where"
    " no limit is known"
)


class Proof(Flag):
    """How a label is proved."""

    NONE = 0, "no proof"
    ENERGY = 1, "for every duration the motion has the predicted label: the energy keeps it near a minimum"
    MOMENTA = (
        2,
        "for every duration the motion has the predicted label: two momenta limit the nutation of a top",
    )


@dataclass(frozen=True)
class Proofs(Instrument):
    """Labels of gyrostats that hold for every duration."""

    proofs_of = {"label": "label_proof", "label_inertial": "label_inertial_proof"}  # noqa: RUF012

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

    def proofs(self, system: System, points: Points, tolerances: Tolerances) -> dict[str, NDArray[Any]]:
        assert isinstance(system, Gyrostat)
        (size,) = shape_of(points)
        frames = {"label": np.zeros(size)}
        if system.frame_rate is not None:
            frames["label_inertial"] = system.frame_rate(points)
        kinds, labels = ({name: np.zeros(size, np.int8) for name in frames} for _ in range(2))
        limit = np.full(size, np.nan)
        with np.errstate(all="ignore"):
            for first in range(0, size, _CHUNK):
                part = slice(first, first + _CHUNK)
                for kind, members, bounds in _bounds(system, subset(points, part), tolerances):
                    where = first + members
                    for name, frame_rate in frames.items():
                        found, deviation = label(bounds, tolerances, frame_rate[where])
                        new = where[(found > 0) & (kinds[name][where] == Proof.NONE)]
                        labels[name][new] = found[np.searchsorted(where, new)]
                        kinds[name][new] = kind
                    limit[where] = np.fmin(limit[where], deviation)
        proved = {self.proofs_of[name]: values for name, values in kinds.items()}
        predicted = {name.replace("label", "predicted"): values for name, values in labels.items()}
        return proved | predicted | {BOUND: limit}


def _bounds(
    system: Gyrostat, points: Points, tolerances: Tolerances
) -> Iterator[tuple[Proof, NDArray[np.intp], Bounds]]:
    """Kinds of proof, points and their bounds, by every rule that may apply."""
    body, start = system.body(points), system.start(points)
    axial = system.conserves_axial_momentum(points)
    w, _, gamma = start
    n, inertia = body.turn, body.inertia
    if single := len(system.equations.FRAME_VECTORS) == 1:
        n = (inertia * w * gamma).sum(-1) / (inertia * gamma**2).sum(-1)
    # What the rates have now, their limits cannot be below.
    u = w - n[:, None] * gamma
    slow = (inertia * u**2).sum(-1) <= inertia.max(-1) * tolerances.rate**2
    rules: list[tuple[Callable[..., Bounds], Mask]]
    if single:
        rules = [(energy.in_space, slow & (body.turn == 0))]
    else:
        others = slow & ~axial & (body.damping >= 0)
        near = np.hypot(gamma[:, 0], gamma[:, 1]) < tolerances.angle
        rules = [(energy.symmetric, axial), (energy.upright, others & near), (energy.attitude, others)]
    for rule, applies in rules:
        if (where := np.flatnonzero(applies)).size:
            given = (w, gamma) if single else start
            yield Proof.ENERGY, where, rule(body.subset(where), *(vector[where] for vector in given))
    if single and (where := np.flatnonzero(axial & (body.turn == 0))).size:
        yield Proof.MOMENTA, where, top(body.subset(where), w[where], gamma[where])


PROOFS = Proofs()
