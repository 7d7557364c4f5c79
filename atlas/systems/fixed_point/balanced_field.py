"""Regular precession about the vertical at n^2 = N, where the field and the centrifugal torque cancel.

w = n g + m s with s a normal of a circular section of the ellipsoid of inertia, and with D the part of I s across s

    l across s = -(m + 2 n s.g) D,   Mg r_c = -n (l + m (s.I s) s).
"""

from __future__ import annotations

import numpy as np

from ..base import Array, Condition, Family, Points, TwoAxes
from ..gyrostat.equation import each, linear
from ..vectors import across, dot, length, unit
from .initial import fields
from .two_axes import (
    OFFSETS,
    ROTORS,
    Start,
    about,
    along,
    floquet_stability,
    section_difference,
)


def balanced_axes(points: Points) -> TwoAxes:
    """With the sign of n of which the spin axis is nearer to a normal of a circular section."""
    start = Start.of(points)
    candidates = [_balanced_candidate(start, sign) for sign in (1.0, -1.0)]
    off = [
        np.nan_to_num(section_difference(start.inertia, axes.spin_axis), nan=np.inf) for axes in candidates
    ]
    first = off[0] <= off[1]
    return TwoAxes(*(np.where(first, a, b) for a, b in zip(*candidates, strict=True)))


def _balanced_candidate(start: Start, sign: float) -> TwoAxes:
    n = sign * np.sqrt(start.N)
    turn = start.w - n * start.gamma
    return TwoAxes(unit(turn), length(turn), start.gamma, n)


def _balanced_rotor_across(start: Start, axes: TwoAxes) -> Array:
    """What the part of the rotor across the spin axis must be."""
    s, m, g, n = axes
    return -(m + 2 * n * dot(s, g)) * across(start.inertia * s, s)


def _balanced_weight(start: Start, axes: TwoAxes) -> Array:
    """What Mg r_c must be."""
    s, m, _, n = axes
    return -n * (start.rotor + m * dot(start.inertia * s, s) * s)


def _no_attraction(points: Points) -> Array:
    return np.where(fields(points)[1] > 0, 0.0, np.inf)


def _off_normal(points: Points) -> Array:
    return section_difference(Start.of(points).inertia, balanced_axes(points).spin_axis)


def _rotor_off(points: Points) -> Array:
    start, axes = Start.of(points), balanced_axes(points)
    off = across(start.rotor, axes.spin_axis) - _balanced_rotor_across(start, axes)
    return start.residual(off * length(start.w))


def _weight(points: Points) -> Array:
    start = Start.of(points)
    return start.weight - _balanced_weight(start, balanced_axes(points))


def _rotor(name: str, points: Points) -> Array:
    """One component of the rotor: its part along the spin axis follows from another component."""
    start, axes = Start.of(points), balanced_axes(points)
    return along(ROTORS.index(name), start.rotor, _balanced_rotor_across(start, axes), axes.spin_axis)


BALANCED_FIELD = Family(
    name="balanced_field",
    axes=balanced_axes,
    motion=about(balanced_axes),
    title="regular precession about the vertical at n^2 = N, where field and centrifugal torque cancel",
    equations="derived from the equations of motion; not in the paper",
    conditions=(
        Condition("N > 0", _no_attraction),
        Condition("w = n g + m s, n^2 = N, s normal to a circular section of the ellipsoid of inertia", _off_normal),
        Condition("l across s = -(m + 2 n s.g) (I s across s)", _rotor_off),
        Condition("Mg r_c = -n (l + m (s.I s) s)", lambda p: Start.of(p).residual(_weight(p))),
    ),
    solve={
        **each(_rotor, *ROTORS),
        **linear(_weight, *OFFSETS),
    },
    stability=floquet_stability(balanced_axes),
    labels="regular precession (n, m) about the vertical, the spin axis is not principal",
)  # fmt: skip
