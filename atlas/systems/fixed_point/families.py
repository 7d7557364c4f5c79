"""Steady motions of the gyrostat about a fixed point: conditions, and solutions of them for one parameter each.

A steady motion keeps theta, psi' = n and phi' = m constant, so w = n g + m e3 with e3 the third body axis.
Put into the equations of motion with g = (s sin phi, s cos phi, c), s = sin theta, c = cos theta,
K = n^2 - N and b = n l + Mg r_c it needs, at every phi = phi0 + m t,

    K (B - C) g2 c + n m (B - A - C) g2 + b2 c - b3 g2 + m l2 = 0
    K (C - A) g1 c + n m (B - A + C) g1 + b3 g1 - b1 c - m l1 = 0
    K (A - B) g1 g2 + b1 g2 - b2 g1 = 0

s = 0 leaves b1 = b2 = 0 with n = r c: `sleeping`. m = 0 leaves K I g + b parallel to g at one phi: `staude`
(n != 0) and `rest`. If m and s are not zero, phi takes every value and the coefficients of 1, sin phi,
cos phi and sin 2 phi vanish one by one: b1 = b2 = 0, then l1 = l2 = 0, then Mg x0 = Mg y0 = 0,
K (A - B) = 0, K (B - C) c + n m (B - A - C) = b3 and K (C - A) c + n m (B - A + C) = -b3. With A = B both
are the one equation of `conical`; with A != B they need K = n = 0, that is N = 0, and then Mg z0 = 0:
a free body that turns about its third axis, in `rest`. So these four families are complete.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..base import FAMILY_TOLERANCE, Array, Condition, Family, Flags, Points, identify
from ..gyrostat import secular
from ..vectors import cross, length, ratio
from . import equations
from .initial import bodies, body, constants, fields, initial_state, rates, symmetric, vertical
from .stability import conical_stability, rest_stability, sleeping_stability, staude_stability


def steady_rates(points: Points) -> tuple[Array, Array, Array]:
    """sin theta, psi' = n and phi' = m of the steady motion that the start would belong to."""
    gamma = vertical(points)
    _, n, m = rates(points)
    return np.hypot(gamma[0], gamma[1]), n, m


def squared_rate(points: Points) -> Array:
    """Largest squared rate of the start: |w0|^2, n^2, m^2, and the torques of fields and rotor over the least moment.

    n and m count because they may cancel in w0, near theta = pi, down to their rounding.
    """
    inertia, rotor, weight, N = bodies(points)
    _, n, m = rates(points)
    turn = np.maximum((initial_state(points)[:3] ** 2).sum(0), np.maximum(n**2, m**2))
    least = inertia.min(0)
    torque = np.maximum(length(weight), np.abs(N) * (inertia.max(0) - least))
    return np.maximum(turn, np.maximum(torque, length(rotor) * np.sqrt(turn)) / least)


def condition_residual(points: Points) -> Array:
    """How far the start is from a steady motion, dimensionless, shape (points,); 0 on an exact motion.

    |w'-dot minus what theta' = 0 and constant n and m need| over the largest squared rate, and theta'
    over its root, whichever is larger.
    """
    state = initial_state(points)
    gamma = state[3:]
    theta_dot, n, m = rates(points)
    rate = np.array(equations.rhs(state, constants(points))[:3])
    rate -= n * m * np.array([gamma[1], -gamma[0], np.zeros_like(n)])
    scale = squared_rate(points)
    return np.maximum(ratio(length(rate), scale), ratio(np.abs(theta_dot), np.sqrt(scale)))


# Conditions. Each residual is an angular acceleration or rate over that of the start, or a relative difference.


def _difference(points: Points) -> Array:
    return (points["A"] - points["B"]) / points["A"]


def _acceleration(points: Points, torque: Array) -> Array:
    """A torque as a residual: over the least moment and the largest squared rate."""
    least = np.minimum(np.minimum(points["A"], points["B"]), points["C"])
    return ratio(torque / least, squared_rate(points))


def _transverse_rotor(points: Points) -> Array:
    turn = length(initial_state(points)[:3])
    return _acceleration(points, np.hypot(points["l1"], points["l2"]) * turn)


def _transverse_weight(points: Points) -> Array:
    return _acceleration(points, fields(points)[0] * np.hypot(points["x0"], points["y0"]))


def _nutation_rate(points: Points) -> Array:
    return ratio(np.abs(rates(points)[0]), np.sqrt(squared_rate(points)))


def _rest_of_precession(points: Points) -> Array:
    return ratio(np.abs(rates(points)[1]), np.sqrt(squared_rate(points)))


def _rest_of_spin(points: Points) -> Array:
    return ratio(np.abs(rates(points)[2]), np.sqrt(squared_rate(points)))


def _spinning(points: Points) -> Array:
    """0 where m counts as 0, inf elsewhere."""
    return np.where(_rest_of_spin(points) <= FAMILY_TOLERANCE, 0.0, np.inf)


def _transverse_rate(points: Points) -> Array:
    return ratio(length(initial_state(points)[:2]), np.sqrt(squared_rate(points)))


def _on_vertical(points: Points) -> Array:
    gamma = vertical(points)
    return np.hypot(gamma[0], gamma[1])


def precession(points: Points, **replaced: Array | float) -> Array:
    """(C - A)(n^2 - N) cos theta + (C m + l3) n + Mg z0, the torque that vanishes on a conical motion.

    Any of A, C, N, Mg, z0, l3, n, m and cosine may be replaced.
    """
    Mg, N = fields(points)
    _, n, m = rates(points)
    value: dict[str, Array | float] = {
        "A": points["A"], "C": points["C"], "N": N, "Mg": Mg, "z0": points["z0"], "l3": points["l3"],
        "n": n, "m": m, "cosine": vertical(points)[2],
    }  # fmt: skip
    A, C, N, Mg, z0, l3, n, m, c = (np.asarray(replaced.get(name, value[name])) for name in value)
    return (C - A) * (n**2 - N) * c + (C * m + l3) * n + Mg * z0


def _conical(points: Points) -> Array:
    return _acceleration(points, precession(points))


def permanent_torque(points: Points, n: Array | None = None) -> Array:
    """((n^2 - N) I g + n l + Mg r_c) x g, zero on a permanent rotation about the vertical, shape (3, points)."""
    inertia, rotor, weight, N = bodies(points)
    gamma = vertical(points)
    n = rates(points)[1] if n is None else n
    return cross((n**2 - N) * inertia * gamma + n * rotor + weight, gamma)


def _permanent(points: Points) -> Array:
    return _acceleration(points, length(permanent_torque(points)))


def _upright(points: Points) -> Array:
    """Transverse torque of rotor and weight on the body that stands on the vertical."""
    _, rotor, weight, _ = bodies(points)
    state = initial_state(points)
    transverse = state[2] * rotor[:2] + np.sign(state[5]) * weight[:2]
    return _acceleration(points, np.hypot(*transverse))


def _resting(points: Points) -> Array:
    return _acceleration(points, length(permanent_torque(points, np.zeros_like(points["A"]))))


def _resting_while_turning(points: Points) -> Array:
    """Torques that disturb the resting third axis as phi takes every value; 0 if m = 0."""
    inertia, rotor, weight, N = bodies(points)
    _, _, m = rates(points)
    gradient = N * np.abs(inertia[0] - inertia[1])
    torque = np.abs(gradient) + np.hypot(*weight[:2]) + np.abs(m) * np.hypot(*rotor[:2])
    return np.where(m == 0, 0.0, _acceleration(points, torque))


# Solutions for one parameter each.


def _linear(slope: Array, offset: Array, current: Array) -> Array:
    """The x of slope x + offset = 0; where both vanish, any x is a solution and the current one is kept."""
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -offset / slope
    return np.where(slope == 0, np.where(offset == 0, current, np.nan), x)


def _solve_precession(name: str, resting: bool = False) -> Callable[[Points], Array]:
    """Solver of precession = 0 for a parameter in which it is linear; resting: with n = 0 in place of the given n."""

    def solve(points: Points) -> Array:
        Mg, N = fields(points)
        _, n, m = rates(points)
        n = np.zeros_like(n) if resting else n
        A, C, c = points["A"], points["C"], vertical(points)[2]
        K = n**2 - N
        slope = {
            "A": -K * c, "C": K * c + m * n, "m": C * n, "l3": n, "N": (A - C) * c, "Mg": points["z0"], "z0": Mg,
        }[name]  # fmt: skip
        x = _linear(slope, precession(points, n=n, **{name: np.zeros_like(n)}), points[name])
        if name in ("A", "C"):
            A, C = (x, C) if name == "A" else (A, x)
            x = np.where((x > 0) & (C <= 2 * A), x, np.nan)
        return x

    return solve


def _solve_theta(resting: bool) -> Callable[[Points], Array]:
    """Solver of precession = 0 for theta0, in [0, pi]."""

    def solve(points: Points) -> Array:
        n = np.zeros_like(points["A"]) if resting else rates(points)[1]
        offset = precession(points, n=n, cosine=0.0)
        slope = (points["C"] - points["A"]) * (n**2 - fields(points)[1])
        cosine = _linear(slope, offset, np.cos(points["theta0"]))
        with np.errstate(invalid="ignore"):
            return np.arccos(cosine)

    return solve


def _solve_n(points: Points) -> Array:
    """The root n of the quadratic that is nearer to the n given; n = 0 (the default) gives the slow one."""
    a = (points["C"] - points["A"]) * vertical(points)[2]
    b = points["C"] * rates(points)[2] + points["l3"]
    c = precession(points, n=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b**2 - 4 * a * c), b))
        roots = np.array([q / a, np.where(c == 0, 0.0, c / q)])
    distance = np.where(np.isfinite(roots), np.abs(roots - points["n"]), np.inf)
    nearer = np.take_along_axis(roots, distance.argmin(0)[None], 0)[0]
    return np.where(np.isfinite(nearer), nearer, np.nan)


def _solve_upright(name: str, axis: int) -> Callable[[Points], Array]:
    """Solver of r l_i + cos(theta) Mg r_i = 0 for one component of the rotor or of the centre of mass."""

    def solve(points: Points) -> Array:
        Mg = fields(points)[0]
        w, sign = initial_state(points)[2], np.sign(vertical(points)[2])
        rotor, offset = (("l1", "x0"), ("l2", "y0"))[axis]
        if name == rotor:
            return _linear(w, sign * Mg * points[offset], points[name])
        return _linear(sign * Mg, w * points[rotor], points[name])

    return solve


def _solve_permanent(name: str) -> Callable[[Points], Array]:
    """Solver of the permanent rotation for one parameter.

    l1, x0 and l2, y0 are taken from the second and the first component of the torque, so that one of
    each pair may be solved together (the third component then vanishes if cos theta0 does not); the
    others from all three, nan where these contradict each other.
    """
    component = {"l1": 1, "x0": 1, "l2": 0, "y0": 0}.get(name)

    def solve(points: Points) -> Array:
        offset = permanent_torque({**points, name: np.zeros_like(points[name])})
        slope = permanent_torque({**points, name: np.ones_like(points[name])}) - offset
        if component is not None:
            return _linear(slope[component], offset[component], points[name])
        x = _linear((slope**2).sum(0), (slope * offset).sum(0), points[name])
        rest = _permanent({**points, name: x})
        return np.where(rest <= 1e-9, x, np.nan)

    return solve


def _solve_direction(angle: str, resting: bool) -> Callable[[Points], Array]:
    """theta0 or phi0 of the permanent rotation nearest to the start, by the angle between the verticals.

    phi0 prefers the rotations whose theta is theta0 already, so that theta0 and phi0 may be solved
    together, and is nan where there is none.
    """

    def solve(points: Points) -> Array:
        gamma = vertical(points)
        n = np.zeros_like(points["A"]) if resting else rates(points)[1]
        rotations, _ = secular.directions(body(points)._replace(turn=n), gamma)
        distance = np.where(np.isnan(rotations[0]), np.inf, -(rotations * gamma[:, None]).sum(0))
        if angle == "phi0":
            distance = np.where(np.abs(rotations[2] - gamma[2]) <= 1e-9, distance, np.inf)
        best = np.take_along_axis(rotations, distance.argmin(0)[None, None], 1)[:, 0]
        value = (
            np.arctan2(np.hypot(best[0], best[1]), best[2])
            if angle == "theta0"
            else np.arctan2(best[0], best[1])
        )
        return np.where(np.isfinite(distance.min(0)), value, np.nan)

    return solve


def _solve_rest(angle: str) -> Callable[[Points], Array]:
    """theta0 or phi0 of a resting third axis: closed form if the body is symmetric about it, else the nearest."""
    nearest, inclined = _solve_direction(angle, True), _solve_theta(True)

    def solve(points: Points) -> Array:
        closed = inclined(points) if angle == "theta0" else points["phi0"]
        closed = np.where(symmetric(points), closed, np.nan)
        general = ~symmetric(points) & (rates(points)[2] == 0)
        return np.where(general, nearest(points), closed)

    return solve


def motion(points: Points, t: Array) -> Array:
    """Closed form of every steady motion: g turns about the third axis at -m, w = n g + m e3.

    t: any shape, time units; returns the state, shape (6, *t.shape, *points.shape).
    """
    gamma = vertical(points)
    _, n, m = rates(points)
    angle = np.asarray(t, float)[..., None] * m
    cosine, sine = np.cos(angle), np.sin(angle)
    g = np.array(
        [
            gamma[0] * cosine + gamma[1] * sine,
            gamma[1] * cosine - gamma[0] * sine,
            np.broadcast_to(gamma[2], angle.shape),
        ]
    )
    w = n * g
    w[2] += m
    return np.concatenate([w, g])


_STILL = Condition("theta' = 0", _nutation_rate)
_PRECESSION = "(C - A)(n^2 - N) cos theta0 + (C m + l3) n + Mg z0 = 0"
FAMILIES = {
    family.name: family
    for family in (
        Family(
            name="conical",
            flag=1,
            title="regular precession about the vertical, or turning about a resting inclined axis (n = 0)",
            equations="from (1) of the paper with A = B, l = (0, 0, l3)",
            conditions=(
                Condition("A = B", _difference),
                Condition("l1 = l2 = 0", _transverse_rotor),
                Condition("Mg x0 = Mg y0 = 0", _transverse_weight),
                _STILL,
                Condition(_PRECESSION, _conical),
            ),
            solve={
                **{name: _solve_precession(name) for name in ("m", "l3", "Mg", "z0", "N", "C", "A")},
                "B": lambda points: points["A"].copy(),
                "theta0": _solve_theta(False),
                "n": _solve_n,
            },
            stability=conical_stability,
            motion=motion,
            geometry="conical",
            paper_wording="Lagrange's case",
            labels="regular precession (n, m); permanent rotation where one of the two rates is 0",
            exists="for given m and theta0: (C m + l3)^2 >= 4 (C - A) cos theta0 (Mg z0 - N (C - A) cos theta0)",
            free=("psi0", "phi0"),
        ),
        Family(
            name="sleeping",
            flag=2,
            title="the third axis stands on the vertical and the body turns about it",
            equations="from the equations of motion",
            conditions=(
                Condition("sin theta0 = 0", _on_vertical),
                Condition("p = q = 0", _transverse_rate),
                Condition("r l1 + cos(theta0) Mg x0 = r l2 + cos(theta0) Mg y0 = 0", _upright),
            ),
            solve={
                "theta0": lambda points: np.where(np.cos(points["theta0"]) < 0, np.pi, 0.0),
                **{
                    name: _solve_upright(name, axis)
                    for name, axis in (("l1", 0), ("l2", 1), ("x0", 0), ("y0", 1))
                },
            },
            stability=sleeping_stability,
            motion=motion,
            geometry="sleeping",
            paper_wording="permanent rotation with spin r0 about the z axis",
            labels="permanent rotation about the vertical at n +- m",
            free=("A", "B", "C", "N", "l3", "psi0"),
        ),
        Family(
            name="staude",
            flag=3,
            title="permanent rotation of any body about the vertical",
            equations="from the equations of motion: (n^2 - N) I g + n l + Mg r_c parallel to g",
            conditions=(
                Condition("m = 0", _rest_of_spin),
                _STILL,
                Condition("((n^2 - N) I g + n l + Mg r_c) x g = 0", _permanent),
            ),
            solve={
                "theta0": _solve_direction("theta0", False),
                "phi0": _solve_direction("phi0", False),
                **{name: _solve_permanent(name) for name in ("l1", "l2", "x0", "y0", "l3", "z0", "Mg", "N")},
            },
            stability=staude_stability,
            motion=motion,
            geometry="staude",
            labels="permanent rotation about the vertical at n",
            exists="2, 4 or 6 directions of a body off special ones, and sets of them for these;"
            " atlas.equilibria finds them all",
            free=("psi0",),
        ),
        Family(
            name="rest",
            flag=4,
            title="the third axis is at rest (n = 0); if the body turns about it, it is symmetric or free",
            equations="from the equations of motion",
            conditions=(
                Condition("n = 0", _rest_of_precession),
                _STILL,
                Condition("(Mg r_c - N I g) x g = 0", _resting),
                Condition("m = 0, or N (A - B) = Mg x0 = Mg y0 = l1 = l2 = 0", _resting_while_turning),
            ),
            solve={
                "theta0": _solve_rest("theta0"),
                "phi0": _solve_rest("phi0"),
                **{name: _solve_precession(name, True) for name in ("N", "Mg", "z0", "C")},
            },
            stability=rest_stability,
            motion=motion,
            labels="permanent rotation: at rest, or turning at m about the resting third axis",
            free=("psi0",),
        ),
    )
}

_REST = FAMILIES["rest"]
# Order in which the families are tested. They overlap: the motions of `rest` with m = 0 come before those of `staude`,
# the others after those of `conical`.
ORDER = (
    FAMILIES["sleeping"],
    replace(_REST, conditions=(*_REST.conditions, Condition("m = 0", _spinning))),
    FAMILIES["staude"],
    FAMILIES["conical"],
    _REST,
)


def identify_family(points: Points) -> tuple[Flags, Array]:
    """Family about the third axis or the vertical of the motion that starts at each point, and its residual."""
    return identify(points, ORDER)
