"""Regular precessions about an axis normal to a circular section of the ellipsoid of inertia.

Grioli's of a heavy body with a rotor: the body turns at equal rates about s = w / |w|, w = Mg r_c, and about an axis nu normal
to it, which is at rest in space. With b = s.I s

    |Mg r_c| g = -(b n^2 + (l.s) n) nu + n^2 [(nu.(s x I s)) nu x s + (nu.I s) s].

About the vertical at n^2 = N the field and the centrifugal torque cancel: w = n g + m s, and with D the part of I s across s

    l across s = -(m + 2 n s.g) D,   Mg r_c = -n (l + m (s.I s) s).

References
----------
G. Grioli, Ann. Mat. Pura Appl. 26 (1947) 271-281; with a rotor E. I. Kharlamova, Mekh. Tverd. Tela 2 (1970) 35-37.
"""

from __future__ import annotations

import numpy as np

from ..base import Array, Condition, Family, Points, TwoAxes
from ..gyrostat.equation import each, linear
from ..vectors import across, cross, dot, length, unit
from .initial import VECTORS, fields
from .two_axes import (
    OFFSETS,
    ROTORS,
    Start,
    about,
    along,
    floquet_stability,
    no_field,
    section_difference,
    section_normals,
)  # fmt: skip


def grioli_axes(points: Points) -> TwoAxes:
    start = Start.of(points)
    s = unit(start.weight)
    n = dot(start.w, s)
    return TwoAxes(s, n, across(start.w, s) / n, n)


def _grioli_vertical(start: Start, s: Array, nu: Array, n: Array) -> Array:
    """Mg |r_c| times the vertical."""
    momentum = start.inertia * s
    along = dot(momentum, s) * n**2 + dot(start.rotor, s) * n
    turned = dot(nu, cross(s, momentum)) * cross(nu, s) + dot(nu, momentum) * s
    return -along * nu + n**2 * turned


def _weight_normal_to_section(points: Points) -> Array:
    start = Start.of(points)
    return section_difference(start.inertia, unit(start.weight))


def _rotor_along_weight(points: Points) -> Array:
    start = Start.of(points)
    return start.residual(cross(start.rotor, unit(start.weight)) * length(start.w))


def _equal_rates(points: Points) -> Array:
    start, axes = Start.of(points), grioli_axes(points)
    transverse = length(across(start.w, axes.spin_axis))
    return (transverse - np.abs(axes.spin_rate)) / np.sqrt(start.squared_rate)


def _grioli_torque(points: Points) -> Array:
    start, axes = Start.of(points), grioli_axes(points)
    vector = _grioli_vertical(start, axes.spin_axis, axes.fixed_axis, axes.spin_rate)
    return start.residual(vector - length(start.weight) * start.gamma)


def _grioli_rate(points: Points) -> Array:
    """Largest n > 0 with (b n^2 + l n)^2 + d^2 n^4 = |Mg r_c|^2, nan where the body has no such motion."""
    start = Start.of(points)
    s = unit(start.weight)
    momentum = start.inertia * s
    b, d2, rotor = dot(momentum, s), (across(momentum, s) ** 2).sum(0), dot(start.rotor, s)
    square = (start.weight**2).sum(0)
    n = _largest_root(b**2 + d2, 2 * b * rotor, rotor**2, -square)
    for _ in range(2):  # Newton's steps remove the rounding errors of the eigenvalues
        along = b * n**2 + rotor * n
        n = n - (along**2 + d2 * n**4 - square) / (2 * along * (2 * b * n + rotor) + 4 * d2 * n**3)
    return np.where(n > 0, n, np.nan)


def _largest_root(a4: Array, a3: Array, a2: Array, a0: Array) -> Array:
    """Largest real root of a4 x^4 + a3 x^3 + a2 x^2 + a0 with a0 < 0 < a4: an eigenvalue of the companion matrix."""
    scale = np.sqrt(np.sqrt(-a0 / a4))  # of x, which makes the last coefficient -1
    matrix = np.zeros((*a4.shape, 4, 4))
    matrix[..., 1, 0] = matrix[..., 2, 1] = matrix[..., 3, 2] = 1.0
    matrix[..., 0, 3], matrix[..., 2, 3], matrix[..., 3, 3] = 1.0, -a2 / (a4 * scale**2), -a3 / (a4 * scale)
    finite = np.asarray(np.isfinite(matrix).all((-2, -1)))
    roots = np.linalg.eigvals(np.where(finite[..., None, None], matrix, np.eye(4)))
    real = np.where(np.abs(roots.imag) <= 1e-7 * np.abs(roots), roots.real, -np.inf).max(-1)
    return np.where(finite, real * scale, np.nan)


def _grioli_start(points: Points) -> Array:
    """State (6, points) at the time at which nu lies in the plane of s and I s."""
    start, n = Start.of(points), _grioli_rate(points)
    s = unit(start.weight)
    nu = unit(across(start.inertia * s, s))
    gamma = _grioli_vertical(start, s, nu, n)
    return np.concatenate([n * (nu + s), unit(gamma)])


def _start(name: str, points: Points) -> Array:
    """One of p0 .. gamma30 of Grioli's start; with all six of them solved, the start is exact."""
    return _grioli_start(points)[VECTORS.index(name)]


def _offset(name: str, points: Points) -> Array:
    """One coordinate of the centre of mass from the largest other one; the sign given, or +, is kept."""
    offset = np.array([points[name] for name in OFFSETS])
    value = along(OFFSETS.index(name), offset, 0.0, section_normals(Start.of(points).inertia))
    return np.copysign(value, points[name])


def _rotor_along(name: str, points: Points) -> Array:
    """One component of the rotor from the largest other component of the centre of mass."""
    start = Start.of(points)
    return along(ROTORS.index(name), start.rotor, 0.0, start.weight)


def _solve_grioli_weight(points: Points) -> Array:
    """Mg > 0 from the start and the offset: Mg |r_c| is the length of the vector in the condition of the vertical."""
    weighed = {**points, "Mg": np.ones_like(points["A"])}
    start, axes = Start.of(weighed), grioli_axes(weighed)
    vector = _grioli_vertical(start, axes.spin_axis, axes.fixed_axis, axes.spin_rate)
    return length(vector) / length(start.weight)


GRIOLI = Family(
    name="grioli",
    axes=grioli_axes,
    motion=about(grioli_axes),
    title="Grioli's regular precession of an asymmetric body about an axis inclined to the vertical",
    equations="Grioli 1947; with a rotor Kharlamova 1970",
    conditions=(
        Condition("N = 0", no_field),
        Condition("r_c normal to a circular section of the ellipsoid of inertia", _weight_normal_to_section),
        Condition("l parallel to r_c", _rotor_along_weight),
        Condition("w = n (nu + s): equal rates about s = Mg r_c / |Mg r_c| and an axis nu normal to it", _equal_rates),
        Condition(
            "|Mg r_c| g = -(b n^2 + l.s n) nu + n^2 [(nu.(s x I s)) nu x s + (nu.I s) s], b = s.I s",
            _grioli_torque,
        ),
    ),
    solve={
        **each(_offset, *OFFSETS),
        **each(_rotor_along, *ROTORS),
        "Mg": _solve_grioli_weight,
        **each(_start, *VECTORS),
    },
    stability=floquet_stability(grioli_axes),
    labels="regular precession about an inclined axis; drifting about the third axis and the vertical",
    exists="(b n^2 + l.s n)^2 + d^2 n^4 = |Mg r_c|^2, d = |s x I s|, for any body with three different moments;"
    " p0 .. gamma30 together start the motion of the largest n",
)  # fmt: skip


# The precession about the vertical.


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


def _no_attraction(points: Points) -> Array:
    return np.where(fields(points)[1] > 0, 0.0, np.inf)


def _off_normal(points: Points) -> Array:
    return section_difference(Start.of(points).inertia, balanced_axes(points).spin_axis)


def _rotor_off(points: Points) -> Array:
    start, axes = Start.of(points), balanced_axes(points)
    off = across(start.rotor, axes.spin_axis) - _balanced_rotor_across(start, axes)
    return start.residual(off * length(start.w))


def _weight(points: Points) -> Array:
    """Mg r_c less what it must be."""
    start, (s, m, _, n) = Start.of(points), balanced_axes(points)
    return start.weight + n * (start.rotor + m * dot(start.inertia * s, s) * s)


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
