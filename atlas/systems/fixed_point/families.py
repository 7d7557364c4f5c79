"""Steady motions of the gyrostat about a fixed point, with conditions and with formulas that each solve for one parameter.

A steady motion keeps theta, psi' = n and phi' = m constant, so that w = n g + m e3 with the vertical g and the third body axis e3.
Let l be the rotor, N the gradient of the field, I = diag(A, B, C), K = n^2 - N, b = n l + Mg r_c, s = sin theta and c = cos theta.
With g = (s sin phi, s cos phi, c) the equations of motion require at every phi = phi0 + m t

    K (B - C) g2 c + n m (B - A - C) g2 + b2 c - b3 g2 + m l2 = 0
    K (C - A) g1 c + n m (B - A + C) g1 + b3 g1 - b1 c - m l1 = 0
    K (A - B) g1 g2 + b1 g2 - b2 g1 = 0

If s = 0 and r is the rate about e3, they reduce to b1 = b2 = 0 with n = r c, the family `sleeping`. If m = 0, K I g + b is parallel
to g at one phi, in the families `staude` (n != 0) and `rest`. If m and s are not 0, phi takes every value, and the coefficients
of 1, sin phi, cos phi and sin 2 phi vanish one by one. They give b1 = b2 = 0, then l1 = l2 = 0, then Mg x0 = Mg y0 = 0,
K (A - B) = 0, K (B - C) c + n m (B - A - C) = b3 and K (C - A) c + n m (B - A + C) = -b3. With A = B the last two are
the one equation of `conical`. With A != B they require K = n = 0, that is N = 0, and then Mg z0 = 0. Such a body is free
and turns about its third axis, in the family `rest`. The four families are therefore complete.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..base import (
    FAMILY_TOLERANCE,
    NEAR,
    Array,
    Condition,
    Family,
    Flags,
    Points,
    TwoAxes,
    identify,
    numbered,
)
from ..gyrostat.motions import Equation, each, linear, motion_of, nearest_root
from ..vectors import cross, length, principal
from .initial import bodies, body, fields, initial_state, rates, symmetric, vertical


def steady_rates(points: Points) -> tuple[Array, Array, Array]:
    """Return sin theta, psi' = n and phi' = m of the steady motion that starts at each point."""
    gamma = vertical(points)
    _, n, m = rates(points)
    return np.hypot(gamma[0], gamma[1]), n, m


def squared_rate(points: Points) -> Array:
    """Return |w0|^2, or the largest torque of fields or rotor divided by the least moment if this quotient is larger."""
    inertia, rotor, weight, N = bodies(points)
    turn, least = (initial_state(points)[:3] ** 2).sum(0), inertia.min(0)
    torque = np.maximum(length(weight), np.abs(N) * (inertia.max(0) - least))
    return np.maximum(turn, np.maximum(torque, length(rotor) * np.sqrt(turn)) / least)


# Functions that vanish on families, and their units.


def _squared_unit(points: Points) -> Array:
    """Return the squared unit of rates. It is infinite where `squared_rate` is 0, so that residuals vanish."""
    square = squared_rate(points)
    return np.where(square == 0, np.inf, square)


def _rate(points: Points) -> Array:
    """Return the unit of rates."""
    return np.sqrt(_squared_unit(points))


def _torque(points: Points) -> Array:
    """Return the unit of torques, which is the least moment times the squared unit of rates."""
    return np.minimum(np.minimum(points["A"], points["B"]), points["C"]) * _squared_unit(points)


def _fast_torque(points: Points) -> Array:
    """Return a unit of torques, at least A n^2 and A m^2. If the third axis is nearly vertical, large n and m may nearly cancel in w."""
    return np.fmax(_torque(points), points["A"] * np.square(rates(points)[1:]).max(0))


def precession(points: Points, n: Array | float | None = None, cosine: Array | float | None = None) -> Array:
    """Return (C - A)(n^2 - N) cos theta + (C m + l3) n + Mg z0. `n` and `cosine` may replace the values of the points."""
    Mg, N = fields(points)
    _, own, m = rates(points)
    n, c = own if n is None else n, vertical(points)[2] if cosine is None else cosine
    A, C = points["A"], points["C"]
    return (C - A) * (n**2 - N) * c + (C * m + points["l3"]) * n + Mg * points["z0"]


def permanent_torque(points: Points, n: Array | None = None) -> Array:
    """Return ((n^2 - N) I g + n l + Mg r_c) x g, (3, points), which is 0 on a permanent rotation about the vertical."""
    inertia, rotor, weight, N = bodies(points)
    gamma = vertical(points)
    n = rates(points)[1] if n is None else n
    return cross((n**2 - N) * inertia * gamma + n * rotor + weight, gamma)


def _upright(points: Points) -> Array:
    """Return the transverse torque of rotor and weight on a body whose third axis is vertical, (2, points)."""
    _, rotor, weight, _ = bodies(points)
    state = initial_state(points)
    return state[2] * rotor[:2] + np.sign(state[5]) * weight[:2]


def _turning_torque(points: Points) -> Array:
    """Return an upper bound of the torque that tilts the third axis while the body turns about this axis, or 0 where m = 0."""
    inertia, rotor, weight, N = bodies(points)
    _, _, m = rates(points)
    gradient = N * np.abs(inertia[0] - inertia[1])
    torque = np.abs(gradient) + np.hypot(*weight[:2]) + np.abs(m) * np.hypot(*rotor[:2])
    return np.where(m == 0, 0.0, torque)


# Solvers for one parameter each.


def _possible_moment(balance: Callable[[Points], Array], name: str, points: Points) -> Array:
    """Return the moment of inertia for which `balance` vanishes, or nan if no symmetric body has this moment."""
    x = linear(balance, name, keep=True)[name](points)
    body = {**points, name: x}
    return np.where((x > 0) & (body["C"] <= 2 * body["A"]), x, np.nan)


def _solve_theta(points: Points, n: float | None = None) -> Array:
    """Return theta0 in [0, pi] for which `precession` is 0. If given, `n` replaces the rate of the points."""
    rate = rates(points)[1] if n is None else n
    offset = precession(points, rate, 0.0)
    slope = (points["C"] - points["A"]) * (rate**2 - fields(points)[1])
    held = np.where(offset == 0, np.cos(points["theta0"]), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.arccos(np.where(slope == 0, held, -offset / slope))


def _solve_n(points: Points) -> Array:
    """Return the root of `precession`, a quadratic in n, nearest to the given n. 0 gives the slow root, inf the fast one."""
    a = (points["C"] - points["A"]) * vertical(points)[2]
    b = points["C"] * rates(points)[2] + points["l3"]
    c = precession(points, n=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b**2 - 4 * a * c), b))
        roots = np.array([q / a, np.where(c == 0, 0.0, c / q)])
    return nearest_root(roots, points["n"])


def _solve_permanent(name: str, points: Points) -> Array:
    """Return one parameter of a permanent rotation, or nan where the components of the torque contradict each other.

    The second component alone gives l1 or x0, and the first gives l2 or y0, so that two parameters may be solved together.
    The third component then vanishes too, unless cos theta0 = 0.
    """
    component = {"l1": 1, "x0": 1, "l2": 0, "y0": 0}.get(name)
    if component is not None:
        return linear(lambda p: permanent_torque(p)[component], name, keep=True)[name](points)
    x = linear(permanent_torque, name, keep=True)[name](points)
    return np.where(PERMANENT.residual({**points, name: x}) <= 1e-9, x, np.nan)


def _solve_direction(angle: str, points: Points, resting: bool = False) -> Array:
    """Return theta0 or phi0 of the permanent rotation whose vertical in the body is nearest to the vertical at the start.

    The search for phi0 keeps theta0, so that a scene can solve for theta0 and then for phi0. The result is nan where no rotation exists.
    """
    gamma = vertical(points)
    n = np.zeros_like(points["A"]) if resting else rates(points)[1]
    from ..gyrostat import secular  # imported here, because few scenes need it

    rotations, _ = secular.directions(body(points)._replace(turn=n), gamma)
    distance = np.where(np.isnan(rotations[0]), np.inf, -(rotations * gamma[:, None]).sum(0))
    if angle == "phi0":
        distance = np.where(np.abs(rotations[2] - gamma[2]) <= 1e-9, distance, np.inf)
    x, y, z = np.take_along_axis(rotations, distance.argmin(0)[None, None], 1)[:, 0]
    value = np.arctan2(np.hypot(x, y), z) if angle == "theta0" else np.arctan2(x, y)
    return np.where(np.isfinite(distance.min(0)), value, np.nan)


def _solve_rest(angle: str, points: Points) -> Array:
    """Return theta0 or phi0 of a resting third axis. A closed form exists if the body is symmetric about this axis."""
    closed = _solve_theta(points, 0.0) if angle == "theta0" else points["phi0"]
    if angle == "theta0" and f"{NEAR}theta0" in points:  # theta0 = 0 and pi are solutions as well
        poles = np.broadcast_to(np.array([0.0, np.pi]).reshape(2, *(1,) * closed.ndim), (2, *closed.shape))
        closed = nearest_root(np.array([closed, *poles]), points["theta0"])
    closed = np.where(symmetric(points), closed, np.nan)
    general = ~symmetric(points) & (rates(points)[2] == 0)
    return np.where(general, _solve_direction(angle, points, resting=True), closed)


def third_axis(points: Points) -> TwoAxes:
    """Return the motion about e3 at the rate m and about the vertical at the rate n."""
    gamma = vertical(points)
    _, n, m = rates(points)
    return TwoAxes(principal(np.full(m.shape, 2)), m, gamma, n)


_MOTION = motion_of(third_axis, lambda points: (vertical(points),))
_RESTING = partial(precession, n=0.0)
_DIRECTIONS = dict.fromkeys(("theta0", "phi0"), "that nearest to 0, by the angle between the verticals")
_STILL = Equation("theta' = 0", lambda p: rates(p)[0], _rate)
_NO_SPIN = Equation("m = 0", lambda p: rates(p)[2], _rate)
NO_DISSIPATION = Equation(
    "damping w = 0",
    lambda p: p["damping"] * initial_state(p)[:3],
    lambda p: _torque(p) + p["damping"] * np.sqrt(squared_rate(p)),
)
PERMANENT = Equation("((n^2 - N) I g + n l + Mg r_c) x g = 0", permanent_torque, _torque)
FAMILIES = numbered(
    replace(family, motion=_MOTION, conditions=(*family.conditions, NO_DISSIPATION))
    for family in (
        Family(
            name="conical",
            title="regular precession about the vertical, or turning about a resting inclined axis (n = 0)",
            equations="from (1) of the paper with A = B, l = (0, 0, l3)",
            conditions=(
                Equation("A = B", lambda p: p["A"] - p["B"], lambda p: p["A"]),
                Equation("l1 = l2 = 0", lambda p: bodies(p)[1][:2] * length(initial_state(p)[:3]), _torque),
                Equation("Mg x0 = Mg y0 = 0", lambda p: bodies(p)[2][:2], _torque),
                _STILL,
                Equation("(C - A)(n^2 - N) cos theta0 + (C m + l3) n + Mg z0 = 0", precession, _fast_torque),
            ),
            solve={
                **linear(precession, "m", "l3", "Mg", "z0", "N", keep=True),
                **each(partial(_possible_moment, precession), "C", "A"),
                "B": lambda points: points["A"].copy(),
                "theta0": _solve_theta,
                "n": _solve_n,
            },
            several={"n": "the slow one"},
            stability_text="Stable where the squared frequency of nutation is positive; else the tilt grows at the root of its size.",
            geometry="conical",
            paper_wording="Lagrange's case",
            labels="regular precession (n, m); permanent rotation where one of the two rates is 0",
            exists="for given m and theta0: (C m + l3)^2 >= 4 (C - A) cos theta0 (Mg z0 - N (C - A) cos theta0)",
            free=("psi0", "phi0"),
        ),
        Family(
            name="sleeping",
            title="the third axis stands on the vertical and the body turns about it",
            equations="from the equations of motion",
            conditions=(
                Equation("sin theta0 = 0", lambda p: vertical(p)[:2]),
                Equation("p = q = 0", lambda p: initial_state(p)[:2], _rate),
                Equation("r l1 + cos(theta0) Mg x0 = r l2 + cos(theta0) Mg y0 = 0", _upright, _torque),
            ),
            solve={
                "theta0": lambda points: np.where(np.cos(points["theta0"]) < 0, np.pi, 0.0),
                **linear(lambda p: _upright(p)[0], "l1", keep=True),
                **linear(lambda p: _upright(p)[1], "l2", keep=True),
                **linear(lambda p: _upright(p)[0], "x0", keep=True),
                **linear(lambda p: _upright(p)[1], "y0", keep=True),
            },
            several={"theta0": "0"},
            stability_text="A = B, rotor and weight along the axis: stable where (C r + l3)^2 > 4 A (N (C - A) - s Mg z0),"
            " s = cos theta.",
            geometry="sleeping",
            paper_wording="permanent rotation with spin r0 about the z axis",
            labels="permanent rotation about the vertical at n +- m",
            free=("A", "B", "C", "N", "l3", "psi0"),
        ),
        Family(
            name="staude",
            title="permanent rotation of any body about the vertical",
            equations="from the equations of motion: (n^2 - N) I g + n l + Mg r_c parallel to g",
            conditions=(_NO_SPIN, _STILL, PERMANENT),
            solve={
                **each(_solve_direction, "theta0", "phi0"),
                **each(_solve_permanent, "l1", "l2", "x0", "y0", "l3", "z0", "Mg", "N"),
            },
            several=_DIRECTIONS,
            stability_text="A = B, rotor and weight along the axis: as conical with m = 0.",
            geometry="staude",
            labels="permanent rotation about the vertical at n",
            exists="2, 4 or 6 directions of a body off special ones, and sets of them for these;"
            " atlas.equilibria finds them all",
            free=("psi0",),
        ),
        Family(
            name="rest",
            title="the third axis is at rest (n = 0); if the body turns about it, it is symmetric or free",
            equations="from the equations of motion",
            conditions=(
                Equation("n = 0", lambda p: rates(p)[1], _rate),
                _STILL,
                Equation(
                    "(Mg r_c - N I g) x g = 0", lambda p: permanent_torque(p, np.zeros_like(p["A"])), _torque
                ),
                Equation("m = 0, or N (A - B) = Mg x0 = Mg y0 = l1 = l2 = 0", _turning_torque, _torque),
            ),
            solve={
                **each(_solve_rest, "theta0", "phi0"),
                **linear(_RESTING, "N", "Mg", "z0", keep=True),
                **each(partial(_possible_moment, _RESTING), "C"),
            },
            several=_DIRECTIONS,
            stability_text="At rest: as staude with n = 0. A free body that turns about its third axis: stable where"
            " ((C - A) m + l3) ((C - B) m + l3) > 0.",
            labels="permanent rotation: at rest, or turning at m about the resting third axis",
            free=("psi0",),
        ),
    )
)

_REST = FAMILIES["rest"]
# 0 where m counts as 0, inf elsewhere
_EXACTLY_NO_SPIN = Condition(
    "m = 0", lambda p: np.where(np.abs(_NO_SPIN.residual(p)) <= FAMILY_TOLERANCE, 0.0, np.inf)
)
# Families in the order in which they are tested. They overlap. Motions of `rest` with m = 0 are tested before `staude`, and
# other motions of `rest` after `conical`.
ORDER = (
    FAMILIES["sleeping"],
    replace(_REST, conditions=(*_REST.conditions, _EXACTLY_NO_SPIN)),
    FAMILIES["staude"],
    FAMILIES["conical"],
    _REST,
)


def identify_family(points: Points) -> tuple[Flags, Array]:
    """Return flag and residual of each start's family. Only families of motions about the third body axis and the vertical count."""
    return identify(points, ORDER)
