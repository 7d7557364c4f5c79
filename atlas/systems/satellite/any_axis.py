"""Motions of spherical satellites about any axis of the body and about the normal. The gravity gradient does not turn such bodies.

Let the rotor k and the magnet mu be along an axis s of the body, without drag and without a field along the radius. The body is
then a spherical top in the field h3 along the normal g, with w = N g + m s and N (C m + k.s) = h3 mu.s. In the orbital frame the
rate about the normal is N - Omega. Without rotor and magnet every rotation is permanent in space, with N = 0 and s along w. With
a rotor alone, other starts precess about the angular momentum, which is at rest in space but not in the orbital frame.
"""

from __future__ import annotations

import numpy as np

from ..base import Array, Points, TwoAxes, numbered
from ..gyrostat import motions
from ..gyrostat.motions import NEUTRAL, about_axis, family_about_axes
from ..vectors import cross, dot, length, ratio, unit
from . import families
from .conditions import field_torque, magnetic_moment
from .initial import body_vectors, directions, drag_vector, initial_state


class Start(motions.Start):
    """Start of a spherical satellite. In residuals, torques are divided by the moment C."""

    def __init__(self, points: Points):
        state = initial_state(points)
        self.points, self.w, self.gamma = points, state[:3], state[6:]
        self.inertia, self.rotor, magnetic = body_vectors(points)
        self.magnet, self.turn, self.moment = points["h3"] * magnetic, points["Omega"], points["C"]
        self.field_torque = field_torque(points)

    def axes(self) -> TwoAxes:
        """Return axes and rates. The axis s is along the rotor, or along the magnet if the rotor is 0, or along w if both are 0."""
        s = np.where(length(self.magnet) > 0, self.magnet, self.w)
        s = unit(np.where(length(self.rotor) > 0, self.rotor, s), self.gamma)
        axes = about_axis(s, self.w, self.gamma)
        return axes._replace(precession_rate=axes.precession_rate - self.turn)

    def across_axis(self) -> Array:
        """Return a bound of the torque from those components of rotor and magnet that are normal to s."""
        s = self.axes().spin_axis
        return length(cross(self.rotor, s)) * length(self.w) + length(cross(self.magnet, s))

    def imbalance(self) -> Array:
        """Return the magnitude of the torque that is normal to s and to the vertical."""
        s, m, _, n = self.axes()
        balance = (n + self.turn) * (self.moment * m + dot(self.rotor, s)) - dot(self.magnet, s)
        return np.abs(balance) * length(cross(s, self.gamma))

    def dissipation(self) -> Array:
        """Return the residual of the damping torque, which opposes the rotation relative to the orbital frame."""
        damping, rate = self.points["damping"], np.sqrt(self.squared_rate)
        turning = length(self.w - self.turn * self.gamma)
        return ratio(damping * turning, rate * (self.moment * rate + damping))


_SPHERICAL = family_about_axes(
    Start,
    conditions=(
        ("A = B = C", lambda b: (b.inertia.max(0) - b.inertia.min(0)) / b.inertia.max(0)),
        ("h1 mu = 0", lambda b: b.residual(np.abs(b.points["h1"]) * magnetic_moment(b.points))),
        ("drag = 0", lambda b: b.residual(drag_vector(b.points))),
        (
            "k and h3 mu along one axis s of the body, or both 0 and s along w",
            lambda b: b.residual(b.across_axis()),
        ),
        ("w = (n + Omega) gamma + m s", Start.nutation),
        ("(n + Omega) (C m + k.s) = h3 mu.s", lambda b: b.residual(b.imbalance())),
        ("damping (w - Omega gamma) = 0", Start.dissipation),
    ),
    directions=directions,
    turn=lambda points: points["Omega"],
    name="spherical_any_axis",
    title="spherical body turning about any axis of its own, which precesses about the normal",
    equations="derived from (1)-(3); not in the paper",
    solve={name: lambda points: points["A"].copy() for name in ("B", "C")},
    stability_text=NEUTRAL,
    labels="regular precession about the normal in the orbital frame at n, in space at n + Omega; permanent rotation"
    " where that rate or m is 0",
    exists="every start without rotor, magnet and damping: n = -Omega, a permanent rotation in space",
)
FAMILIES = numbered([_SPHERICAL], after=families.FAMILIES)
