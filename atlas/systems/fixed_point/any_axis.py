"""Regular precessions and permanent rotations of the gyrostat about other axes than the third and the vertical.

In a motion w = n nu + m s the axis s is at rest in the body, and the axis nu is at rest in space. The angle between s and nu is theta1.
The angle between nu and the vertical g is kappa, and N is the gradient of the field. The equations are linear in inertia I, rotor l
and weight Mg r_c, and are sums of harmonics of n t and m t. If n, m and sin theta1 are not 0, they allow four cases:

- kappa and N are not 0. The harmonic 2 n + 2 m and then 2 n + m (with -m for m if n and m differ in sign) leave a
  spherical body, on which the field has no effect. By the next case this body has no weight and belongs to `free_precession`.
- kappa is not 0, and N = 0. The harmonics n + m and n - m of a weight need |n| = |m| and theta1 = pi/2, which leaves
  `grioli`. A body without weight is symmetric about s and belongs to `free_precession`.
- kappa = 0 and N = n^2. The field and the centrifugal torque cancel, and s is normal to a circular section of the
  ellipsoid of inertia. The family is `balanced_field`.
- kappa = 0 and N is not n^2. The body is symmetric about s, and rotor and centre of mass are along s. The family is
  `conical`, or `other_axis` where s is not the third axis.

In a permanent rotation about an axis that is inclined to the vertical, the body is free (`free_rotation`) or symmetric about the axis
(`rest` or `other_axis`). Together with the families about the third axis, these families are therefore complete.
`tests/systems/test_any_axis_families.py` confirms each step.

In Lagrange's case s is an axis of symmetry other than the third. With C = s.I s, A the moment across s, and c = s.g,
(C - A)(n^2 - N) c + (C m + l.s) n + Mg r_c.s = 0.

In Grioli's precession a heavy body with a rotor turns at equal rates about s = Mg r_c / |Mg r_c| and about an axis nu normal
to s. With b = s.I s

    |Mg r_c| g = -(b n^2 + (l.s) n) nu + n^2 [(nu.(s x I s)) nu x s + (nu.I s) s].

In a balanced field w = n g + m s. If D is the part of I s across s, then

    l across s = -(m + 2 n s.g) D,   Mg r_c = -n (l + m (s.I s) s).

References
----------
G. Grioli, Ann. Mat. Pura Appl. 26 (1947) 271-281; with a rotor E. I. Kharlamova, Mekh. Tverd. Tela 2 (1970) 35-37.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..base import FAMILY_TOLERANCE, NEAR, Array, Family, Flags, Points, TwoAxes, motion_about_axes, numbered
from ..gyrostat import motions
from ..gyrostat.motions import NEUTRAL, about_axis, each, family_about_axes, linear, nearest_root
from ..jacobian import jacobian
from ..vectors import across, cross, dot, length, principal, unit
from . import equations, families
from .families import NO_DISSIPATION
from .initial import VECTORS, bodies, constants, initial_state, vertical

OFFSETS, ROTORS = ("x0", "y0", "z0"), ("l1", "l2", "l3")

# The last result of Grioli.initial_state, which six formulas share. The key consists of the shape and the bytes of the input arrays.
_LAST_START: dict[tuple[tuple[int, ...], bytes], Array] = {}


class Start(motions.Start):
    """Start of a body about a fixed point. Residuals divide torques by the body's least moment of inertia."""

    def __init__(self, points: Points):
        self.inertia, self.rotor, self.weight, self.N = bodies(points)
        state = initial_state(points)
        self.w, self.gamma, self.moment = state[:3], state[3:], self.inertia.min(0)
        gradient = np.abs(self.N) * (self.inertia.max(0) - self.moment)
        self.field_torque = np.maximum(length(self.weight), gradient)

    def field_residual(self) -> Array:
        """Return the residual of the condition that the field's gradient N is 0 or the body is spherical."""
        return self.residual(self.N * (self.inertia.max(0) - self.inertia.min(0)))

    def rotor_residual(self, s: Array) -> Array:
        """Return the residual of the condition that the rotor has no part normal to the unit vector `s`."""
        return self.residual(cross(self.rotor, s) * length(self.w))

    def axis_of_symmetry(self, candidates: tuple[int, ...], otherwise: Array) -> Array:
        """Return the principal axis nearest to an axis of symmetry, or `otherwise` for a spherical body."""
        inertia = self.inertia
        differences = np.array([np.abs(inertia[(i + 1) % 3] - inertia[(i + 2) % 3]) for i in candidates])
        axis = principal(np.array(candidates)[differences.argmin(0)])
        spherical = inertia.max(0) - inertia.min(0) <= FAMILY_TOLERANCE * inertia.max(0)
        return np.where(spherical, unit(otherwise, axis), axis)

    def section_difference(self, s: Array) -> Array:
        """Return the largest minus the least moment of inertia about axes normal to `s`, divided by the body's largest moment."""
        first = unit(cross(s, principal(np.abs(s).argmin(0))))
        second = cross(s, first)
        difference = dot(self.inertia * first, first) - dot(self.inertia * second, second)
        return np.hypot(difference, 2 * dot(self.inertia * first, second)) / self.inertia.max(0)

    @classmethod
    def solve_rotor(
        cls, line: Callable[[Any], tuple[Array | float, Array]], name: str, points: Points
    ) -> Array:
        """Return one component of a rotor on the line base + lambda direction. `line` returns base and direction for a start."""
        start = cls(points)
        return along(ROTORS.index(name), start.rotor, *line(start))

    @classmethod
    def floquet_stability(cls, points: Points) -> tuple[Flags, Array]:
        """From the multipliers over the period 2 pi / |m| of the closed form of the motion in the body."""
        from ..gyrostat.floquet import growth_of_periodic_motion

        two, gamma, values = cls(points).axes(), vertical(points), constants(points)

        def matrix(part: np.ndarray, t: Array) -> Array:
            members = TwoAxes(*(value[..., part] for value in two))
            state = np.concatenate(motion_about_axes(members, gamma[:, part], t)).reshape(6, -1)
            constants_at_times = np.tile(values[:, part], len(t))
            return jacobian(equations, state, constants_at_times).reshape(*t.shape, 6, 6)

        return growth_of_periodic_motion(matrix, 2 * np.pi / np.abs(two.spin_rate))


def _with_unit_weight(points: Points) -> Points:
    return {**points, "Mg": np.ones_like(points["A"])}


def section_normals(inertia: Array) -> Array:
    """Return the absolute components of normals of circular sections of the ellipsoid of inertia. The normals differ only in signs."""
    order = np.argsort(inertia, axis=0, kind="stable")
    low, middle, high = np.take_along_axis(inertia, order, 0)
    squares = np.array([middle - low, np.zeros_like(low), high - middle]) / (high - low)
    return np.take_along_axis(np.sqrt(squares), np.argsort(order, axis=0), 0)


def along(i: int, vector: Array, base: Array | float, direction: Array) -> Array:
    """Return component `i` of v = base + lambda direction. In another component, that of the largest |direction|, v equals `vector`."""
    magnitudes = np.abs(direction)
    magnitudes[i] = -1.0
    base = np.broadcast_to(base, direction.shape)
    vector, others, slope = (
        np.take_along_axis(v, magnitudes.argmax(0)[None], 0)[0] for v in (vector, base, direction)
    )
    return base[i] + (vector - others) / slope * direction[i]


class Lagrange(Start):
    """Lagrange's case about an axis of symmetry other than the third."""

    def axes(self) -> TwoAxes:
        return about_axis(self.axis_of_symmetry((0, 1), self.weight), self.w, self.gamma)

    def torque(self) -> tuple[Array, Array]:
        """Return two torques divided by sin(tilt): that of all but the weight, and that of the weight. On the family the torques cancel."""
        s, m, g, n = self.axes()
        C = dot(self.inertia * s, s)
        A = 0.5 * (self.inertia.sum(0) - C)
        return (C - A) * (n**2 - self.N) * dot(s, g) + (C * m + dot(self.rotor, s)) * n, dot(self.weight, s)

    def imbalance(self) -> Array:
        rest, weight = self.torque()
        return self.residual((rest + weight) * length(cross(self.axes().spin_axis, self.gamma)))

    @classmethod
    def solve_weight(cls, points: Points) -> Array:
        rest, weight = cls(_with_unit_weight(points)).torque()
        return -rest / weight


class Rotation(Start):
    """A free body that turns about one axis."""

    def axes(self) -> TwoAxes:
        rate = length(self.w)
        axis = unit(self.w, principal(np.full(rate.shape, 2)))
        return TwoAxes(axis, rate, axis, np.zeros_like(rate))


class Precession(Start):
    """A free symmetric body that turns about the axis of symmetry and about the angular momentum."""

    def axes(self) -> TwoAxes:
        """Return the axis s with the rate ((A - C) w.s - l.s) / A, and the angular momentum G with the rate |G| / A."""
        s = self.axis_of_symmetry((2, 0, 1), self.rotor)
        momentum = self.inertia * self.w + self.rotor
        axial = dot(self.inertia * s, s)
        transverse = 0.5 * (self.inertia.sum(0) - axial)
        spin = ((transverse - axial) * dot(self.w, s) - dot(self.rotor, s)) / transverse
        return TwoAxes(s, spin, unit(momentum, s), length(momentum) / transverse)


class Grioli(Start):
    """Grioli's precession about an inclined axis."""

    def axes(self) -> TwoAxes:
        s = unit(self.weight)
        n = dot(self.w, s)
        return TwoAxes(s, n, across(self.w, s) / n, n)

    def vertical(self, axes: TwoAxes) -> Array:
        """Return Mg |r_c| times the vertical that a precession about these axes requires."""
        s, n, nu, _ = axes
        momentum = self.inertia * s
        along = dot(momentum, s) * n**2 + dot(self.rotor, s) * n
        turned = dot(nu, cross(s, momentum)) * cross(nu, s) + dot(nu, momentum) * s
        return -along * nu + n**2 * turned

    def unequal_rates(self) -> Array:
        axes = self.axes()
        transverse = length(across(self.w, axes.spin_axis))
        return (transverse - np.abs(axes.spin_rate)) / np.sqrt(self.squared_rate)

    @classmethod
    def solve_weight(cls, points: Points) -> Array:
        """Return Mg > 0 from the length Mg |r_c| of the vector `vertical(axes)`. r_c points to the centre of mass."""
        start = cls(_with_unit_weight(points))
        return length(start.vertical(start.axes())) / length(start.weight)

    @classmethod
    def solve_start(cls, name: str, points: Points) -> Array:
        """Return the start value `name`, one of p0 .. gamma30, from `initial_state`. All six values together start an exact motion."""
        start = cls(points)
        values = np.stack([*start.inertia, *start.rotor, *start.weight])
        near = points.get(f"{NEAR}n", np.full_like(points["A"], np.nan))
        body = values.shape, values.tobytes() + near.tobytes()
        state = _LAST_START.get(body)
        if state is None:
            _LAST_START.clear()
            state = _LAST_START[body] = start.initial_state(near)
        return state[VECTORS.index(name)].copy()

    def initial_state(self, near: Array) -> Array:
        """Return p0 .. gamma30 of a start whose precession axis nu is in the plane of the spin axis s and I s, or nan if no motion exists.

        With the inertia I, b = s.I s, d = |s x I s| and the rotor l along s, the rate n of precession is the root of
        (b n^2 + l n)^2 + d^2 n^4 = |Mg r_c|^2 that is nearest to `near`. Where `near` is nan, n is the largest positive root.
        """
        s = unit(self.weight)
        momentum = self.inertia * s
        b, d2, rotor = dot(momentum, s), (across(momentum, s) ** 2).sum(0), dot(self.rotor, s)
        square = (self.weight**2).sum(0)
        # The roots are eigenvalues of the companion matrix. The unit `scale` makes the last coefficient of the quartic -1.
        a4, a3, a2 = b**2 + d2, 2 * b * rotor, rotor**2
        scale = np.sqrt(np.sqrt(square / a4))
        matrix = np.zeros((*a4.shape, 4, 4))
        matrix[..., 1, 0] = matrix[..., 2, 1] = matrix[..., 3, 2] = 1.0
        matrix[..., 0, 3], matrix[..., 2, 3], matrix[..., 3, 3] = (
            1.0,
            -a2 / (a4 * scale**2),
            -a3 / (a4 * scale),
        )
        finite = np.asarray(np.isfinite(matrix).all((-2, -1)))
        roots = np.linalg.eigvals(np.where(finite[..., None, None], matrix, np.eye(4)))
        real = np.where(np.abs(roots.imag) <= 1e-7 * np.abs(roots), roots.real, -np.inf)
        nearest = nearest_root(np.moveaxis(np.sort(real)[..., ::-1], -1, 0) * scale, near)
        n = np.where(finite, np.where(np.isnan(near), real.max(-1) * scale, nearest), np.nan)
        for _ in range(2):  # Newton's steps remove the rounding errors of the eigenvalues
            turning = b * n**2 + rotor * n
            n = n - (turning**2 + d2 * n**4 - square) / (2 * turning * (2 * b * n + rotor) + 4 * d2 * n**3)
        n = np.where((n > 0) | ~np.isnan(near), n, np.nan)
        nu = unit(across(momentum, s))
        gamma = self.vertical(TwoAxes(s, n, nu, n))
        return np.concatenate([n * (nu + s), unit(gamma)])

    @classmethod
    def solve_offset(cls, name: str, points: Points) -> Array:
        """Return the coordinate `name`, with its sign, of a centre of mass on a normal to a circular section of the inertia ellipsoid."""
        offset = np.array([points[name] for name in OFFSETS])
        value = along(OFFSETS.index(name), offset, 0.0, section_normals(cls(points).inertia))
        return np.copysign(value, points[name])


class Balanced(Start):
    """Precession about the vertical where field and centrifugal torque cancel."""

    def axes(self) -> TwoAxes:
        """Return axes and rates. The sign of n is the sign that gives the smaller `section_difference` of the spin axis."""
        candidates, off = [], []
        for sign in (1.0, -1.0):
            n = sign * np.sqrt(self.N)
            turn = self.w - n * self.gamma
            candidates.append(TwoAxes(unit(turn), length(turn), self.gamma, n))
            difference = self.section_difference(candidates[-1].spin_axis)
            off.append(np.nan_to_num(difference, nan=np.inf))
        first = off[0] <= off[1]
        return TwoAxes(*(np.where(first, a, b) for a, b in zip(*candidates, strict=True)))

    def needed_rotor(self) -> tuple[Array, Array]:
        """Return the part of the rotor across the spin axis that balances the motion, and the spin axis."""
        s, m, g, n = self.axes()
        return -(m + 2 * n * dot(s, g)) * across(self.inertia * s, s), s

    def rotor_off(self) -> Array:
        needed, s = self.needed_rotor()
        return self.residual((across(self.rotor, s) - needed) * length(self.w))

    def excess_weight(self) -> Array:
        """Return Mg r_c minus the value that balances the motion."""
        s, m, _, n = self.axes()
        return self.weight + n * (self.rotor + m * dot(self.inertia * s, s) * s)


def _family(kind: Any, **attributes: Any) -> Family:
    family = family_about_axes(kind, directions=lambda p: (vertical(p),), **attributes)
    return replace(family, conditions=(*family.conditions, NO_DISSIPATION))


_FREE = (("Mg r_c = 0", lambda b: b.residual(b.weight)), ("N = 0, or A = B = C", Start.field_residual))
FAMILIES = numbered(
    (
        _family(
            Grioli,
            name="grioli",
            title="Grioli's regular precession of an asymmetric body about an axis inclined to the vertical",
            equations="Grioli 1947; with a rotor Kharlamova 1970",
            conditions=(
                ("N = 0", Start.field_residual),
                ("r_c normal to a circular section of the ellipsoid of inertia",
                 lambda b: b.section_difference(unit(b.weight))),
                ("l parallel to r_c", lambda b: b.rotor_residual(unit(b.weight))),
                ("w = n (nu + s): equal rates about s = Mg r_c / |Mg r_c| and an axis nu normal to it", Grioli.unequal_rates),
                ("|Mg r_c| g = -(b n^2 + l.s n) nu + n^2 [(nu.(s x I s)) nu x s + (nu.I s) s], b = s.I s",
                 lambda b: b.residual(b.vertical(b.axes()) - length(b.weight) * b.gamma)),
            ),
            solve={
                **each(Grioli.solve_offset, *OFFSETS),
                **each(partial(Grioli.solve_rotor, lambda b: (0.0, b.weight)), *ROTORS),
                "Mg": Grioli.solve_weight,
                **each(Grioli.solve_start, *VECTORS),
            },
            several=dict.fromkeys(OFFSETS, "the positive one") | {"n": "that of the largest n"},
            stability=Grioli.floquet_stability,
            labels="regular precession about an inclined axis; drifting about the third axis and the vertical",
            exists="(b n^2 + l.s n)^2 + d^2 n^4 = |Mg r_c|^2, d = |s x I s|, for any body with three different moments;"
            " p0 .. gamma30 together start the motion of the largest n",
        ),
        _family(
            Balanced,
            name="balanced_field",
            title="regular precession about the vertical at n^2 = N, where field and centrifugal torque cancel",
            equations="derived from the equations of motion; not in the paper",
            conditions=(
                ("N > 0", lambda b: np.where(b.N > 0, 0.0, np.inf)),
                ("w = n g + m s, n^2 = N, s normal to a circular section of the ellipsoid of inertia",
                 lambda b: b.section_difference(b.axes().spin_axis)),
                ("l across s = -(m + 2 n s.g) (I s across s)", Balanced.rotor_off),
                ("Mg r_c = -n (l + m (s.I s) s)", lambda b: b.residual(b.excess_weight())),
            ),
            solve={
                **each(partial(Balanced.solve_rotor, Balanced.needed_rotor), *ROTORS),
                **linear(lambda p: Balanced(p).excess_weight(), *OFFSETS),
            },
            stability=Balanced.floquet_stability,
            labels="regular precession (n, m) about the vertical, the spin axis is not principal",
        ),
        _family(
            Rotation,
            name="free_rotation",
            title="permanent rotation of a free body about an inclined axis",
            equations="from the equations of motion",
            conditions=(
                *_FREE,
                ("(I w + l) x w = 0", lambda b: b.residual(cross(b.inertia * b.w + b.rotor, b.w))),
            ),
            solve=each(partial(Rotation.solve_rotor, lambda b: (-b.inertia * b.w, b.w)), *ROTORS),
            stability_text="Euler's equations linearised: I x' = (I x) x w + (I w + l) x x has exponents 0 and +-sqrt(-P). P is the"
            " sum of the principal minors of the matrix of the system; stable where it is positive. Where it is 0 by the symmetry"
            " of the body, distances grow like t at most, which counts as stable.",
            labels="permanent rotation",
            exists="about each principal axis of a body without rotor",
        ),
        _family(
            Precession,
            name="free_precession",
            title="regular precession of a free symmetric or spherical body about its angular momentum",
            equations="from the equations of motion",
            conditions=(
                *_FREE,
                ("two equal moments", lambda b: b.section_difference(b.axes().spin_axis)),
                ("l along the axis of symmetry", lambda b: b.rotor_residual(b.axes().spin_axis)),
            ),
            solve={"B": lambda points: points["A"].copy()},
            stability_text=NEUTRAL,
            labels="regular precession (|G|/A, ((A - C) w.s - l.s)/A) about G = I w + l; permanent rotation where that"
            " is along s or m = 0",
        ),
        _family(
            Lagrange,
            name="other_axis",
            title="Lagrange's case about another axis of symmetry than the third, and turning about it at rest",
            equations="as conical and rest, about the first or second axis, or the axis of a spherical body",
            conditions=(
                ("B = C or C = A", lambda b: b.section_difference(b.axes().spin_axis)),
                ("l along the axis s of symmetry", lambda b: b.rotor_residual(b.axes().spin_axis)),
                ("Mg r_c along s", lambda b: b.residual(cross(b.weight, b.axes().spin_axis))),
                ("w = n g + m s", Lagrange.nutation),
                ("(C - A)(n^2 - N) s.g + (C m + l.s) n + Mg r_c.s = 0, C = s.I s", Lagrange.imbalance),
            ),
            solve={"Mg": Lagrange.solve_weight},
            stability_text="As the family conical: stable where the squared frequency of nutation is positive.",
            labels="regular precession (n, m) about the vertical; permanent rotation where one of the two rates is 0",
        ),
    ),
    after=families.FAMILIES,
)  # fmt: skip
