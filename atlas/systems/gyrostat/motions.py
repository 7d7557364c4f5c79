"""Starts from angles and rates, and closed forms of motions about two axes, which all steady motions are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..base import Array, Points, TwoAxes, motion_about_axes
from ..vectors import principal


def directions(points: Points) -> tuple[Array, Array]:
    """alpha and gamma in body axes at the start, each of shape (3, points), from theta0, psi0 and phi0."""
    st, ct = np.sin(points["theta0"]), np.cos(points["theta0"])
    sp, cp = np.sin(points["psi0"]), np.cos(points["psi0"])
    sf, cf = np.sin(points["phi0"]), np.cos(points["phi0"])
    alpha = np.array([cp * cf - ct * sf * sp, -cp * sf - ct * cf * sp, st * sp])
    return alpha, np.array([st * sf, st * cf, ct])


def angular_velocity(points: Points, rate: Array, gamma: Array) -> Array:
    """A rate about the vertical, m about e3 and theta_dot0 about the node, (3, points)."""
    w = rate * gamma
    w[0] += points["theta_dot0"] * np.cos(points["phi0"])
    w[1] -= points["theta_dot0"] * np.sin(points["phi0"])
    w[2] += points["m"]
    return w


def about_third_axis(points: Points) -> TwoAxes:
    """e3 and the vertical, of starts by angles and rates."""
    gamma = directions(points)[1]
    return TwoAxes(principal(np.full(gamma.shape[1:], 2)), points["m"], gamma, points["n"])


def motion_of(
    axes: Callable[[Points], TwoAxes],
    directions: Callable[[Points], tuple[Array, ...]],
    turn: Callable[[Points], Array] | None = None,
) -> Callable[[Points, Array], Array]:
    """Closed form of a family, as Family.motion, of a system whose state is w and the directions at rest in its frame.

    directions: points -> these at the start, each (3, points), the vertical as the last; turn: rate of the frame about it.
    """

    def motion(points: Points, t: Array) -> Array:
        two, vectors = axes(points), directions(points)
        times = np.reshape(np.asarray(t, float), (*np.shape(t), *(1,) * (vectors[0].ndim - 1)))
        rate = np.empty(0)
        moved = []
        for vector in vectors:
            rate, turned = motion_about_axes(two, vector, times)
            moved.append(turned)
        return np.concatenate([rate if turn is None else rate + turn(points) * moved[-1], *moved])

    return motion
