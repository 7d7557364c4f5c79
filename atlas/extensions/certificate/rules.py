"""Every rule that may prove a label, and the labels that follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ...measure.instrument import Tolerances
from ...systems.base import Array, Flags, Mask, Points, shape_of, subset
from ...systems.gyrostat import Gyrostat
from . import energy
from .bounds import Bounds, label
from .proofs import Proof
from .top import top

_CHUNK = 4096  # points whose arrays stay in the cache


def proved(
    system: Gyrostat, points: Points, tolerances: Tolerances
) -> tuple[dict[str, Flags], dict[str, Flags], Array]:
    """Kinds of proof and labels by the variables of labels, and the limits of the deviation of a rate, (points,)."""
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
                    new = (found > 0) & (kinds[name][where] == Proof.NONE)
                    labels[name][where[new]], kinds[name][where[new]] = found[new], kind
                limit[where] = np.fmin(limit[where], deviation)
    return kinds, labels, limit


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
