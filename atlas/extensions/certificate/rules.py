"""Every rule that may prove a label, and the labels that follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...measure.instrument import Tolerances
from ...systems.base import Mask, Points, shape_of, subset
from ...systems.gyrostat import Gyrostat
from . import energy
from .bounds import Bounds, label
from .proofs import BOUND, PROOFS, Proof
from .top import top

_CHUNK = 4096  # points whose arrays stay in the cache


def proved(system: Gyrostat, points: Points, tolerances: Tolerances) -> dict[str, NDArray[Any]]:
    """The variables of the instrument, and by predicted names the labels that are proved, else 0, (points,)."""
    (size,) = shape_of(points)
    frames = {"label": np.zeros(size)}
    if system.frame_rate is not None:
        frames["label_inertial"] = system.frame_rate(points)
    columns: dict[str, NDArray[Any]] = {BOUND: np.full(size, np.nan)}
    for name in frames:
        for column in (PROOFS.proofs_of[name], name.replace("label", "predicted")):
            columns[column] = np.zeros(size, np.int8)
    with np.errstate(all="ignore"):
        for first in range(0, size, _CHUNK):
            chunk = slice(first, first + _CHUNK)
            for kind, members, bounds in _bounds(system, subset(points, chunk), tolerances.subset(chunk)):
                where = first + members
                for name, frame_rate in frames.items():
                    kinds, labels = (
                        columns[PROOFS.proofs_of[name]],
                        columns[name.replace("label", "predicted")],
                    )
                    flags, deviation = label(bounds, tolerances.subset(where), frame_rate[where])
                    new = (flags > 0) & (kinds[where] == Proof.NONE)
                    labels[where[new]], kinds[where[new]] = flags[new], kind
                columns[BOUND][where] = np.fmin(columns[BOUND][where], deviation)
    return columns


def _bounds(
    system: Gyrostat, points: Points, tolerances: Tolerances
) -> Iterator[tuple[Proof, NDArray[np.intp], Bounds]]:
    """Kinds of proof, points and their bounds, by every rule that may apply."""
    body, start = system.body(points), system.start(points)
    (w, _, gamma), single, n = start, len(system.equations.FRAME_VECTORS) == 1, body.turn
    if single:
        n = (body.inertia * w * gamma).sum(-1) / (body.inertia * gamma**2).sum(-1)
    # What the rates are at the start their limits cannot be below.
    square = (body.inertia * (w - n[:, None] * gamma) ** 2).sum(-1)
    slow, axial = square <= body.inertia.max(-1) * tolerances.rate**2, system.conserves_axial_momentum(points)
    rules: list[tuple[Callable[..., Bounds], Proof, Mask]]
    if single:
        at_rest = body.turn == 0
        rules = [(energy.in_space, Proof.ENERGY, slow & at_rest), (top, Proof.MOMENTA, axial & at_rest)]
    else:
        # No rotation of a symmetric body about its axis changes the energy, whose minima the other rules would seek in vain.
        others = slow & ~axial & (body.damping >= 0)
        near = others & (np.hypot(gamma[:, 0], gamma[:, 1]) < tolerances.angle)
        every = (energy.symmetric, axial), (energy.upright, near), (energy.attitude, others)
        rules = [(rule, Proof.ENERGY, applies) for rule, applies in every]
    for rule, kind, applies in rules:
        if (where := np.flatnonzero(applies)).size:
            given = (w, gamma) if single else start
            yield kind, where, rule(body.subset(where), *(vector[where] for vector in given))
