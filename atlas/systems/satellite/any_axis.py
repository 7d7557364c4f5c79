"""Spherical satellites, which the gravity gradient does not turn: motions about any axis of the body and the normal.

With the rotor and the magnet along an axis s of the body and without a field along the radius the body is a spherical
top in the field along the normal: w = N g + m s with N (C m + k.s) = h3 mu.s, relative to the orbit N - Omega about the
normal g. Without rotor and magnet every rotation is of this kind, with N = 0 and s along w: it is a permanent rotation in
space. A rotor and any other start precess about the angular momentum, which is at rest in space but not in the orbital frame.
"""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Condition, Family, Flags, Points, TwoAxes, numbered
from ..gyrostat.motions import motion_of
from ..vectors import across, cross, dot, length, ratio, unit
from . import families
from .conditions import largest_inertia, magnetic_moment
from .initial import directions, initial_state


def _vectors(points: Points) -> tuple[Array, Array, Array, Array]:
    """w and gamma at the start, rotor and h3 mu, each (3, points)."""
    state = initial_state(points)
    rotor = np.array([points["k1"], points["k2"], points["k3"]])
    magnet = points["h3"] * np.array([points["mu1"], points["mu2"], points["mu3"]])
    return state[:3], state[6:], rotor, magnet


def _axes(points: Points) -> TwoAxes:
    """s is along the rotor, else the magnet, else the angular velocity."""
    w, gamma, rotor, magnet = _vectors(points)
    s = np.where(length(magnet) > 0, magnet, w)
    s = unit(np.where(length(rotor) > 0, rotor, s), gamma)
    normal = across(gamma, s)
    rate = ratio(dot(w, normal), (normal**2).sum(0))
    return TwoAxes(s, dot(w - rate * gamma, s), gamma, rate - points["Omega"])


def _scale(points: Points) -> Array:
    """Largest squared rate of the start."""
    w, _, rotor, _ = _vectors(points)
    field = magnetic_moment(points) * np.hypot(points["h1"], points["h3"])
    square = np.maximum((w**2).sum(0), points["Omega"] ** 2)
    torque = np.maximum(field, length(rotor) * np.sqrt(square)) / points["C"]
    return np.maximum(square, torque)


def _unequal(points: Points) -> Array:
    largest = largest_inertia(points)
    least = np.minimum(points["A"], np.minimum(points["B"], points["C"]))
    return (largest - least) / largest


def _radial_torque(points: Points) -> Array:
    torque = np.abs(points["h1"]) * magnetic_moment(points)
    return ratio(torque / points["C"], _scale(points))


def _not_along(points: Points) -> Array:
    w, _, rotor, magnet = _vectors(points)
    s, rate = _axes(points).spin_axis, length(w)
    torque = length(cross(rotor, s)) * rate + length(cross(magnet, s))
    return ratio(torque / points["C"], _scale(points))


def _unsteady(points: Points) -> Array:
    w, gamma, _, _ = _vectors(points)
    s, m, _, n = _axes(points)
    return ratio(length(w - (n + points["Omega"]) * gamma - m * s), np.sqrt(_scale(points)))


def _torque(points: Points) -> Array:
    _, gamma, rotor, magnet = _vectors(points)
    s, m, _, n = _axes(points)
    balance = (n + points["Omega"]) * (points["C"] * m + dot(rotor, s)) - dot(magnet, s)
    return ratio(np.abs(balance) * length(cross(s, gamma)) / points["C"], _scale(points))


def _damped(points: Points) -> Array:
    w, gamma, _, _ = _vectors(points)
    scale = np.sqrt(_scale(points))
    turn = length(w - points["Omega"] * gamma)
    return ratio(points["damping"] * turn, scale * (points["C"] * scale + points["damping"]))


def _stability(points: Points) -> tuple[Flags, Array]:
    """The squared frequency of nutation, (N sin)^2 + ((C w.s + k.s)/C - 2 N cos)^2, is never negative: always stable."""
    shape = np.shape(points["A"])
    return np.full(shape, Stability.STABLE, np.int8), np.zeros(shape)


SPHERICAL_ANY_AXIS = Family(
    name="spherical_any_axis",
    axes=_axes,
    motion=motion_of(_axes, directions, lambda points: points["Omega"]),
    title="spherical body turning about any axis of its own, which precesses about the normal",
    equations="derived from (1)-(3); not in the paper",
    conditions=(
        Condition("A = B = C", _unequal),
        Condition("h1 mu = 0", _radial_torque),
        Condition("k and h3 mu along one axis s of the body, or both 0 and s along w", _not_along),
        Condition("w = (n + Omega) gamma + m s", _unsteady),
        Condition("(n + Omega) (C m + k.s) = h3 mu.s", _torque),
        Condition("damping (w - Omega gamma) = 0", _damped),
    ),
    solve={name: lambda points: points["A"].copy() for name in ("B", "C")},
    stability=_stability,
    labels="regular precession about the normal in the orbital frame at n, in space at n + Omega; permanent rotation"
    " where that rate or m is 0",
    exists="every start without rotor, magnet and damping: n = -Omega, a permanent rotation in space",
)
FAMILIES = numbered([SPHERICAL_ANY_AXIS], after=families.FAMILIES)
