"""Regular precessions and permanent rotations of the gyrostat about other axes than the third and the vertical.

A motion w = n nu + m s has an axis s at rest in the body and an axis nu at rest in space; theta1 is the angle between
them and kappa that from nu to the vertical g. Its equations are linear in the body, that is in I, l and w = Mg r_c.
Written as harmonics of the angles n t and m t they allow, with n, m, sin theta1 not 0:

- kappa not 0 and N not 0: the harmonic 2 n + 2 m and then 2 n + m (n - m in place of n + m if their signs differ)
  leave a spherical body, of which the field has no effect, and so no weight (next item). `free_precession`;
- kappa not 0, N = 0 and w not 0: the harmonics n + m and n - m of the weight need |n| = |m| and theta1 = pi/2; what
  remains is `grioli`. Without weight the body is symmetric about s: `free_precession`;
- kappa = 0 and N = n^2: the field and the centrifugal torque cancel, and s is normal to a circular section of the
  ellipsoid of inertia: `balanced_field`;
- kappa = 0 otherwise: the body is symmetric about s, which carries rotor and centre of mass: `conical`, or
  `other_axis` where s is not the third axis.

A permanent rotation that is inclined to the vertical needs a free body, `free_rotation`, or it is a rotation about a
resting axis of symmetry, `rest` or `other_axis`. So together with the families about the third axis these are all.
`tests/systems/test_any_axis_families.py` confirms each step.

In Lagrange's case about another axis s of symmetry than the third, with C = s.I s and c = s.g:
(C - A)(n^2 - N) c + (C m + l.s) n + Mg r_c.s = 0.

References
----------
G. Grioli, Ann. Mat. Pura Appl. 26 (1947) 271-281; with a rotor E. I. Kharlamova, Mekh. Tverd. Tela 2 (1970) 35-37.
"""

from __future__ import annotations

import numpy as np

from ...flags import Stability
from ..base import Array, Condition, Family, Flags, Points, TwoAxes, numbered
from ..gyrostat.equation import each
from ..vectors import across, cross, dot, length, principal, ratio, unit
from . import families
from .circular_sections import BALANCED_FIELD, GRIOLI
from .stability import decide
from .two_axes import ROTORS, Start, about, along, axis_of_symmetry, no_field, rotor_along, symmetric_about

# Lagrange's case about another axis than the third.


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


# Free bodies: no weight, and no field unless the body is spherical.


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
FAMILIES = numbered(
    (GRIOLI, BALANCED_FIELD, FREE_ROTATION, FREE_PRECESSION, OTHER_AXIS), after=families.FAMILIES
)
