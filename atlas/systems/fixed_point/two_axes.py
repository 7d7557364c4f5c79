"""What the families of motions about any axes share: vectors of a start, its axes, closed form and stability."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..base import FAMILY_TOLERANCE, Array, Flags, Points, TwoAxes, motion_about_axes
from ..gyrostat.floquet import growth_of_periodic_motion
from ..gyrostat.motions import motion_of
from ..jacobian import jacobian
from ..vectors import cross, dot, length, principal, ratio, unit
from . import equations
from .initial import bodies, constants, initial_state, vertical

OFFSETS, ROTORS = ("x0", "y0", "z0"), ("l1", "l2", "l3")


class Start(NamedTuple):
    """Body, fields and state at t = 0; vectors of shape (3, points) in body axes."""

    inertia: Array
    rotor: Array
    weight: Array
    N: Array
    w: Array
    gamma: Array

    @classmethod
    def of(cls, points: Points) -> Start:
        state = initial_state(points)
        return cls(*bodies(points), state[:3], state[3:])

    @property
    def squared_rate(self) -> Array:
        """Largest squared rate: |w|^2, and the torques of fields and rotor over the least moment."""
        square, least = (self.w**2).sum(0), self.inertia.min(0)
        gradient = np.abs(self.N) * (self.inertia.max(0) - least)
        torque = np.maximum(length(self.weight), np.maximum(gradient, length(self.rotor) * np.sqrt(square)))
        return np.maximum(square, torque / least)

    def residual(self, torque: Array) -> Array:
        """A torque, vector or magnitude, over the least moment and the largest squared rate."""
        size = np.abs(torque) if torque.ndim == self.N.ndim else length(torque)
        return ratio(size / self.inertia.min(0), self.squared_rate)


def section_difference(inertia: Array, s: Array) -> Array:
    """How far the section of the ellipsoid of inertia normal to s is from a circle, relative to the largest moment."""
    first = unit(cross(s, principal(np.abs(s).argmin(0))))
    second = cross(s, first)
    difference = dot(inertia * first, first) - dot(inertia * second, second)
    return np.hypot(difference, 2 * dot(inertia * first, second)) / inertia.max(0)


def section_normals(inertia: Array) -> Array:
    """Magnitudes of the components of the normals of the circular sections of the ellipsoid of inertia."""
    order = np.argsort(inertia, axis=0, kind="stable")
    low, middle, high = np.take_along_axis(inertia, order, 0)
    squares = np.array([middle - low, np.zeros_like(low), high - middle]) / (high - low)
    return np.take_along_axis(np.sqrt(squares), np.argsort(order, axis=0), 0)


def axis_of_symmetry(inertia: Array, candidates: tuple[int, ...], otherwise: Array) -> Array:
    """The principal axis about which the body is nearest to symmetry; a given vector for a spherical body."""
    differences = np.array([np.abs(inertia[(i + 1) % 3] - inertia[(i + 2) % 3]) for i in candidates])
    best = np.array(candidates)[differences.argmin(0)]
    axis = principal(best)
    spherical = inertia.max(0) - inertia.min(0) <= FAMILY_TOLERANCE * inertia.max(0)
    return np.where(spherical, unit(otherwise, axis), axis)


# Conditions of several families.


def no_field(points: Points) -> Array:
    start = Start.of(points)
    return start.residual(start.N * (start.inertia.max(0) - start.inertia.min(0)))


def symmetric_about(points: Points, s: Array) -> Array:
    return section_difference(Start.of(points).inertia, s)


def rotor_along(points: Points, s: Array) -> Array:
    start = Start.of(points)
    return start.residual(cross(start.rotor, s) * length(start.w))


# Closed form and stability.


def along(i: int, vector: Array, base: Array | float, direction: Array) -> Array:
    """Component i of a vector = base + lambda direction, lambda from the component of the largest other one of direction."""
    magnitudes = np.abs(direction)
    magnitudes[i] = -1.0
    base = np.broadcast_to(base, direction.shape)
    vector, others, slope = (
        np.take_along_axis(v, magnitudes.argmax(0)[None], 0)[0] for v in (vector, base, direction)
    )
    return base[i] + (vector - others) / slope * direction[i]


def about(axes: Callable[[Points], TwoAxes]) -> Callable[[Points, Array], Array]:
    """Closed form of a family, as Family.motion."""
    return motion_of(axes, lambda points: (vertical(points),))


def floquet_stability(axes: Callable[[Points], TwoAxes]) -> Callable[[Points], tuple[Flags, Array]]:
    """Formula of Family.stability from the closed form of the motion."""

    def stability(points: Points) -> tuple[Flags, Array]:
        """Floquet multipliers over the period 2 pi / |m| of the motion in the body: mu + 1/mu is the trace of the
        monodromy matrix less 4, for four multipliers are 1; stable where |mu + 1/mu| <= 2.
        """
        two, gamma, values = axes(points), vertical(points), constants(points)

        def matrix(part: np.ndarray, t: Array) -> Array:
            members = TwoAxes(*(value[..., part] for value in two))
            state = np.concatenate(motion_about_axes(members, gamma[:, part], t)).reshape(6, -1)
            constants_at_times = np.tile(values[:, part], len(t))
            return jacobian(equations, state, constants_at_times).reshape(*t.shape, 6, 6)

        return growth_of_periodic_motion(matrix, 2 * np.pi / np.abs(two.spin_rate))

    return stability
