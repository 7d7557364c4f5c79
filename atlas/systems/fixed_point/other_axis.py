"""Lagrange's case about another axis s of symmetry than the third.

With C = s.I s and c = s.g: (C - A)(n^2 - N) c + (C m + l.s) n + Mg r_c.s = 0.
"""

from __future__ import annotations

import numpy as np

from ..base import Array, Condition, Family, Flags, Points, TwoAxes
from ..vectors import across, cross, dot, length, ratio
from .stability import decide
from .two_axes import (
    Start,
    about,
    axis_of_symmetry,
    rotor_along,
    symmetric_about,
)


def lagrange_axes(points: Points) -> TwoAxes:
    start = Start.of(points)
    s = axis_of_symmetry(start.inertia, (0, 1), start.weight)
    normal = across(start.gamma, s)
    n = ratio(dot(start.w, normal), (normal**2).sum(0))
    return TwoAxes(s, dot(start.w - n * start.gamma, s), start.gamma, n)


def _lagrange_steady(points: Points) -> Array:
    """Rate of nutation: what w has beside n g + m s."""
    start, (s, m, g, n) = Start.of(points), lagrange_axes(points)
    return ratio(length(start.w - n * g - m * s), np.sqrt(start.squared_rate))


def _lagrange_weight(points: Points) -> Array:
    start = Start.of(points)
    return start.residual(cross(start.weight, lagrange_axes(points).spin_axis))


def _lagrange_torque(points: Points) -> tuple[Array, Array]:
    """Left side of the balance without the weight, and the weight along s."""
    start, (s, m, g, n) = Start.of(points), lagrange_axes(points)
    C = dot(start.inertia * s, s)
    A = 0.5 * (start.inertia.sum(0) - C)
    return (C - A) * (n**2 - start.N) * dot(s, g) + (C * m + dot(start.rotor, s)) * n, dot(start.weight, s)


def _lagrange_balance(points: Points) -> Array:
    start, (rest, weight) = Start.of(points), _lagrange_torque(points)
    tilt = length(cross(lagrange_axes(points).spin_axis, start.gamma))
    return start.residual((rest + weight) * tilt)


def _solve_lagrange_weight(points: Points) -> Array:
    weighed = {**points, "Mg": np.ones_like(points["A"])}
    rest, weight = _lagrange_torque(weighed)
    return -rest / weight


def _lagrange_stability(points: Points) -> tuple[Flags, Array]:
    """As the family conical: stable where the squared frequency of nutation is positive."""
    start, (s, m, g, n) = Start.of(points), lagrange_axes(points)
    C = dot(start.inertia * s, s)
    A, c = 0.5 * (start.inertia.sum(0) - C), dot(s, g)
    spin = (C * (m + n * c) + dot(start.rotor, s)) / A
    square = (n**2 + start.N * (C - A) / A) * (1 - c**2) + (spin - 2 * n * c) ** 2
    size = (n**2 + np.abs(start.N * (C - A) / A)) + spin**2 + 4 * n**2 * c**2
    return decide(square, size, np.sqrt(np.maximum(-square, 0.0)))


OTHER_AXIS = Family(
    name="other_axis",
    axes=lagrange_axes,
    motion=about(lagrange_axes),
    title="Lagrange's case about another axis of symmetry than the third, and turning about it at rest",
    equations="as conical and rest, about the first or second axis, or the axis of a spherical body",
    conditions=(
        Condition("B = C or C = A", lambda p: symmetric_about(p, lagrange_axes(p).spin_axis)),
        Condition("l along the axis s of symmetry", lambda p: rotor_along(p, lagrange_axes(p).spin_axis)),
        Condition("Mg r_c along s", _lagrange_weight),
        Condition("w = n g + m s", _lagrange_steady),
        Condition("(C - A)(n^2 - N) s.g + (C m + l.s) n + Mg r_c.s = 0, C = s.I s", _lagrange_balance),
    ),
    solve={"Mg": _solve_lagrange_weight},
    stability=_lagrange_stability,
    labels="regular precession (n, m) about the vertical; permanent rotation where one of the two rates is 0",
)  # fmt: skip
