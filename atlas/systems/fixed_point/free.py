"""Free bodies: no weight, and no field unless the body is spherical."""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Condition, Family, Flags, Points, TwoAxes
from ..gyrostat.equation import each
from ..vectors import cross, dot, length, principal, unit
from .stability import decide
from .two_axes import (
    ROTORS,
    Start,
    about,
    along,
    axis_of_symmetry,
    no_field,
    rotor_along,
    symmetric_about,
)


def _no_weight(points: Points) -> Array:
    start = Start.of(points)
    return start.residual(start.weight)


def _free_turning(points: Points) -> Array:
    start = Start.of(points)
    return start.residual(cross(start.inertia * start.w + start.rotor, start.w))


def rotation_axes(points: Points) -> TwoAxes:
    w = Start.of(points).w
    rate = length(w)
    axis = unit(w, principal(np.full(rate.shape, 2)))
    return TwoAxes(axis, rate, axis, np.zeros_like(rate))


def _turning_rotor(name: str, points: Points) -> Array:
    """One component of the rotor: I w + l along w."""
    start = Start.of(points)
    return along(ROTORS.index(name), start.rotor, -start.inertia * start.w, start.w)


def _turning_stability(points: Points) -> tuple[Flags, Array]:
    """Euler's equations linearised: I x' = (I x) x w + (I w + l) x x has exponents 0 and +-sqrt(-P).

    P is the sum of the principal minors of the matrix of the system; stable where it is positive. Where it is 0 by
    the symmetry of the body, distances grow like t at most, which counts as stable.
    """
    start = Start.of(points)
    momentum = start.inertia * start.w + start.rotor
    columns = []
    for j in range(3):
        axis = principal(np.full(momentum.shape[1:], j))
        turn = cross(start.inertia * axis, start.w) + cross(momentum, axis)
        columns.append(turn / start.inertia)
    products = np.array([columns[i][i] * columns[j][j] - columns[i][j] * columns[j][i] for i, j in _PAIRS])
    size = np.array([np.abs(columns[i][j] * columns[j][i]) for i, j in _PAIRS]).sum(0)
    P = products.sum(0)
    return decide(P, size, np.sqrt(np.maximum(-P, 0.0)))


_PAIRS = ((0, 1), (0, 2), (1, 2))


def precession_axes(points: Points) -> TwoAxes:
    """G / A is the angular velocity about the angular momentum G, ((A - C) w.s - l.s) / A that about s."""
    start = Start.of(points)
    s = axis_of_symmetry(start.inertia, (2, 0, 1), start.rotor)
    momentum = start.inertia * start.w + start.rotor
    axial = dot(start.inertia * s, s)
    transverse = 0.5 * (start.inertia.sum(0) - axial)
    spin = ((transverse - axial) * dot(start.w, s) - dot(start.rotor, s)) / transverse
    return TwoAxes(s, spin, unit(momentum, s), length(momentum) / transverse)


def _always_stable(points: Points) -> tuple[Flags, Array]:
    """Neighbours of a free precession are free precessions: distances grow like t at most."""
    shape = np.shape(points["A"])
    return np.full(shape, Stability.STABLE, np.int8), np.zeros(shape)


_FREE = (
    Condition("Mg r_c = 0", _no_weight),
    Condition("N = 0, or A = B = C", no_field),
)
FREE_ROTATION = Family(
    name="free_rotation",
    axes=rotation_axes,
    motion=about(rotation_axes),
    title="permanent rotation of a free body about an inclined axis",
    equations="from the equations of motion",
    conditions=(*_FREE, Condition("(I w + l) x w = 0", _free_turning)),
    solve=each(_turning_rotor, *ROTORS),
    stability=_turning_stability,
    labels="permanent rotation",
    exists="about each principal axis of a body without rotor",
)  # fmt: skip
FREE_PRECESSION = Family(
    name="free_precession",
    axes=precession_axes,
    motion=about(precession_axes),
    title="regular precession of a free symmetric or spherical body about its angular momentum",
    equations="from the equations of motion",
    conditions=(
        *_FREE,
        Condition("two equal moments", lambda p: symmetric_about(p, precession_axes(p).spin_axis)),
        Condition("l along the axis of symmetry", lambda p: rotor_along(p, precession_axes(p).spin_axis)),
    ),
    solve={"B": lambda points: points["A"].copy()},
    stability=_always_stable,
    labels="regular precession (|G|/A, ((A - C) w.s - l.s)/A) about G = I w + l; permanent rotation where that"
    " is along s or m = 0",
)  # fmt: skip
