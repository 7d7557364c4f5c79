"""The families of exact steady motions theta = theta0, psi' = n, phi' = m of the satellite.

Together they are all of them for Omega > 0. They follow from the equations of motion of (1)-(3) of
Yehia & El-kenani 2021 (doi 10.22055/JACM.2021.37913.3113) by asking that w' = n gamma + m e3 be a
solution for all t; `tests/systems/test_satellite_families.py` proves each from those equations. Short names:
c, s = cos, sin theta0; H = (h1 cos psi0, h3 s - h1 c sin psi0, h3 c + h1 s sin psi0) is the field in
the axes of the node, where e3 is the third; w3 = (n + Omega) c + m; K = k1 + i k2, U = mu1 + i mu2;
a = (A + B) / 2. With n = 0 and A = B the motion is steady if and only if (m not zero)

    w3 K = H3 U,   Omega s K = (H2 + i H1) U,   cos psi0 (3 Omega^2 s sin psi0 (a - C) - h1 mu3) = 0,
    Omega s (k3 + C m) = Omega^2 s c (a - C) (1 + 3 sin^2 psi0) + mu3 H2.                       (*)

The families overlap; a point belongs to the first that holds, in the order of FAMILIES. Residuals are
divided by natural scales: largest inertia J, rate w = Omega + |n| + |m| + |theta_dot0|, momentum
J w + |k|, torque w (J w + |k|) + |mu| |h|. With Omega = 0 every family below is still exact, but a free
or heavy body has more steady motions than these. With damping a steady motion keeps its Jacobi integral only
at rest in the orbital frame, w' = 0: these motions and no others are then left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...flags import Stability
from ..base import Array, Condition, Family, Flags, Points
from ..vectors import cross, length
from .equations import rhs
from .initial import constants, directions, initial_state

# Largest growth rate, relative to the rates of the point, that is taken as 0: double roots of the
# characteristic polynomial have the square root of the round-off, about 1e-8, as their error.
GROWTH_TOLERANCE = 1e-6
Residual = Callable[[Points], Array]


def _trig(angle: Array) -> tuple[Array, Array]:
    """sin and cos, zero where only the rounding of pi keeps them from it."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.where(np.abs(sine) < 1e-14, 0.0, sine), np.where(np.abs(cosine) < 1e-14, 0.0, cosine)


def _relative_to(value: Array, scale: Array) -> Array:
    """value / scale, 0 where value is 0, nan where only scale is."""
    safe = np.where(scale == 0, 1.0, scale)
    return np.where(value == 0, 0.0, np.where(scale == 0, np.nan, value / safe))


def _quotient(value: Array, by: Array) -> Array:
    """value / by, nan where by is 0: nothing to solve for."""
    return np.where(by == 0, np.nan, value / np.where(by == 0, 1.0, by))


def _inertia(p: Points) -> Array:
    return np.maximum(np.maximum(p["A"], p["B"]), p["C"])


def _rate(p: Points) -> Array:
    return np.abs(p["Omega"]) + np.abs(p["n"]) + np.abs(p["m"]) + np.abs(p["theta_dot0"])


def _momentum(p: Points) -> Array:
    return _inertia(p) * _rate(p) + np.sqrt(p["k1"] ** 2 + p["k2"] ** 2 + p["k3"] ** 2)


def _moment(p: Points) -> Array:
    return np.sqrt(p["mu1"] ** 2 + p["mu2"] ** 2 + p["mu3"] ** 2)


def _torque(p: Points) -> Array:
    return _rate(p) * _momentum(p) + _moment(p) * np.hypot(p["h1"], p["h3"])


def _field(p: Points) -> tuple[Array, Array, Array]:
    """H in the axes of the node: node, across it, third body axis."""
    s, c = _trig(p["theta0"])
    sp, cp = _trig(p["psi0"])
    return p["h1"] * cp, p["h3"] * s - p["h1"] * c * sp, p["h3"] * c + p["h1"] * s * sp


def _turn_rate(p: Points) -> Array:
    """|n gamma + m e3|, the rate of the rotation relative to the orbital frame."""
    s, c = _trig(p["theta0"])
    return np.hypot(p["n"] * s, p["n"] * c + p["m"])


def _w3(p: Points) -> Array:
    return (p["n"] + p["Omega"]) * _trig(p["theta0"])[1] + p["m"]


def _vectors(p: Points) -> tuple[Array, Array, Array]:
    """I, k, mu as arrays of shape (3, points)."""
    return tuple(  # type: ignore[return-value]
        np.array([p[name] for name in names])
        for names in (("A", "B", "C"), ("k1", "k2", "k3"), ("mu1", "mu2", "mu3"))
    )


# Conditions that several families share.


def _equal(a: str, b: str) -> Condition:
    return Condition(f"{a} = {b}", lambda p: _relative_to(p[a] - p[b], _inertia(p)))


_SYMMETRIC = _equal("A", "B")
_STEADY_TILT = Condition("theta_dot0 = 0", lambda p: _relative_to(p["theta_dot0"], _rate(p)))
_NO_PRECESSION = Condition("n = 0", lambda p: _relative_to(p["n"], _rate(p)))
_NO_SPIN = Condition("m = 0", lambda p: _relative_to(p["m"], _rate(p)))
_UPRIGHT = Condition("sin theta0 = 0", lambda p: _trig(p["theta0"])[0])
_NODE_ON_RADIUS = Condition("sin psi0 = 0", lambda p: _trig(p["psi0"])[0])
_NODE_ON_VELOCITY = Condition("cos psi0 = 0", lambda p: _trig(p["psi0"])[1])
_AXIAL_ROTOR = Condition("k1 = k2 = 0", lambda p: _relative_to(np.hypot(p["k1"], p["k2"]), _momentum(p)))
_AXIAL_MAGNET = Condition(
    "mu1 = mu2 = 0 (or h1 = h3 = 0)",
    lambda p: _relative_to(np.hypot(p["mu1"], p["mu2"]) * np.hypot(p["h1"], p["h3"]), _torque(p)),
)
_NO_RADIAL_TORQUE = Condition("h1 mu = 0", lambda p: _relative_to(p["h1"] * _moment(p), _torque(p)))
_NO_AXIAL_RADIAL_TORQUE = Condition("h1 mu3 = 0", lambda p: _relative_to(p["h1"] * p["mu3"], _torque(p)))


def _dissipation(p: Points) -> Array:
    """Torque of the damping, over the scale of torques."""
    return _relative_to(p["damping"] * _turn_rate(p), _torque(p) + p["damping"] * _rate(p))


def _pair(p: Points, factor: Array, real: Array, imaginary: Array) -> Array:
    """|factor K - (real + i imaginary) U| over the scale of torques."""
    first = factor * p["k1"] - real * p["mu1"] + imaginary * p["mu2"]
    second = factor * p["k2"] - real * p["mu2"] - imaginary * p["mu1"]
    return _relative_to(np.hypot(first, second), _torque(p))


def _spinning_pair(p: Points) -> Array:
    return _pair(p, _w3(p), _field(p)[2], np.zeros_like(p["A"]))


def _node_pair(p: Points) -> Array:
    H1, H2, _ = _field(p)
    return _pair(p, p["Omega"] * _trig(p["theta0"])[0], H2, H1)


_NO_DISSIPATION = Condition("damping (w - Omega gamma) = 0", _dissipation)
_SPINNING_PAIR = Condition("w3 k1,2 = H3 mu1,2", _spinning_pair)
_NODE_PAIR = Condition("Omega sin theta0 (k1 + i k2) = (H2 + i H1) (mu1 + i mu2)", _node_pair)


def _tilt_torque(p: Points) -> Array:
    """Right side of the last equation of (*): what gravity and magnet ask of Omega s (k3 + C m)."""
    s, c = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    return p["Omega"] ** 2 * s * c * flatness * (1 + 3 * sp**2) + p["mu3"] * _field(p)[1]


def _tilt_balance(p: Points) -> Array:
    lever = p["Omega"] * _trig(p["theta0"])[0]
    return _relative_to(lever * (p["k3"] + p["C"] * p["m"]) - _tilt_torque(p), _torque(p))


_TILT_BALANCE = Condition(
    "Omega s (k3 + C m) = Omega^2 s c ((A + B)/2 - C) (1 + 3 sin^2 psi0) + mu3 (h3 s - h1 c sin psi0)",
    _tilt_balance,
)


def _oblique_balance(p: Points) -> Array:
    s, _ = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    gravity = 3 * p["Omega"] ** 2 * s * sp * (0.5 * (p["A"] + p["B"]) - p["C"])
    return _relative_to(gravity - p["h1"] * p["mu3"], _torque(p))


def _despun_balance(p: Points) -> Array:
    return _trig(p["psi0"])[1] * _oblique_balance(p)


_OBLIQUE_BALANCE = Condition("3 Omega^2 s sin psi0 ((A + B)/2 - C) = h1 mu3", _oblique_balance)

# Formulas that several families share. Each keeps everything but its own parameter.


def _solve_psi_on_radius(p: Points) -> Array:
    """The nearest of 0 and pi (mod 2 pi)."""
    return np.pi * np.round(p["psi0"] / np.pi)


def _solve_psi_on_velocity(p: Points) -> Array:
    """pi/2 or -pi/2 (mod 2 pi), on the side of the given sin psi0; pi/2 for 0."""
    return np.pi * (np.floor(p["psi0"] / np.pi) + 0.5)


def _axial_momentum(p: Points) -> Array:
    """k3 + C m that the tilt asks for; at s = 0 its limit, which exists if h1 mu3 sin psi0 = 0."""
    s, c = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    radial = p["mu3"] * p["h1"] * c * sp
    singular = np.where(radial == 0, 0.0, _quotient(radial, p["Omega"] * s))
    gravity = p["Omega"] * c * flatness * (1 + 3 * sp**2)
    return gravity + _relative_to(p["mu3"] * p["h3"], p["Omega"]) - singular


def _solve_k3(p: Points) -> Array:
    return _axial_momentum(p) - p["C"] * p["m"]


def _solve_m(p: Points) -> Array:
    return (_axial_momentum(p) - p["k3"]) / p["C"]


def _solve_h3(p: Points) -> Array:
    rest = _axial_momentum({**p, "h3": np.zeros_like(p["h3"])})
    return _quotient(p["Omega"] * (p["k3"] + p["C"] * p["m"] - rest), p["mu3"])


def _solve_h1(p: Points) -> Array:
    s, c = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    rest = _axial_momentum({**p, "h1": np.zeros_like(p["h1"])})
    return _quotient(p["Omega"] * s * (rest - p["k3"] - p["C"] * p["m"]), p["mu3"] * c * sp)


def _solve_theta(p: Points) -> Array:
    """Tilt in [0, pi] from k3 and m; nan if h1 mu3 sin psi0 is not 0, where there are several."""
    sp, _ = _trig(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    momentum = p["k3"] + p["C"] * p["m"] - _relative_to(p["mu3"] * p["h3"], p["Omega"])
    cosine = _quotient(momentum, p["Omega"] * flatness * (1 + 3 * sp**2))
    exists = (np.abs(cosine) <= 1) & (p["h1"] * p["mu3"] * sp == 0)
    return np.where(exists, np.arccos(np.clip(cosine, -1, 1)), np.nan)


def _solve_node_pair(name: str, p: Points) -> Array:
    """k1 or k2 of Omega s K = (H2 + i H1) U."""
    H1, H2, _ = _field(p)
    torque = H2 * p["mu1"] - H1 * p["mu2"] if name == "k1" else H2 * p["mu2"] + H1 * p["mu1"]
    return _quotient(torque, p["Omega"] * _trig(p["theta0"])[0])


def _formulas(solver: Callable[[str, Points], Array], *names: str) -> dict[str, Residual]:
    return {name: lambda p, name=name: solver(name, p) for name in names}  # type: ignore[misc]


# Linear stability in closed form.


def _quartic(P: Array, Q: Array, scale: Array) -> tuple[Flags, Array]:
    """Stability and growth of lambda^4 + P lambda^2 + Q = 0; unknown where P or Q is nan.

    Marginal roots (lambda = 0, or a double imaginary pair) count as stable: they grow like a power
    of t at most. Growth up to GROWTH_TOLERANCE * scale is round-off and counts as none.
    """
    return classify_growth(quartic_growth(P, Q), scale)


def quartic_growth(P: Array, Q: Array) -> Array:
    """Largest real part of the roots of lambda^4 + P lambda^2 + Q = 0."""
    root = np.sqrt(np.maximum(P * P - 4 * Q, 0.0))
    # -P + root without cancellation where P > 0
    real = np.where(P > 0, -2 * _relative_to(Q, P + root), 0.5 * (root - P))
    spiral = np.sqrt(np.maximum(Q, 0.0)) - 0.5 * P
    return np.where(P * P < 4 * Q, np.sqrt(np.maximum(0.5 * spiral, 0)), np.sqrt(np.maximum(real, 0)))


def classify_growth(growth: Array, scale: Array) -> tuple[Flags, Array]:
    """Stability and growth rate: stable with growth exactly 0 where it is round-off, unknown where it is nan."""
    none = growth <= GROWTH_TOLERANCE * scale
    stable = np.where(none, Stability.STABLE, Stability.UNSTABLE)
    stable = np.where(np.isnan(growth), Stability.UNKNOWN, stable).astype(np.int8)
    return stable, np.where(none, 0.0, growth)


def _stability_tilted(p: Points) -> tuple[Flags, Array]:
    """Symmetric body, k and mu along the axis, n = 0: lambda^4 + P lambda^2 + Q = 0.

    With the axial momentum p = (C w3 + k3) / a conserved, the axis moves like a charge on the sphere:
    U = -Omega^2 s^2/2 - Omega p c + (3/2) D Omega^2 s^2 sin^2 psi + mu3 (h1 s sin psi + h3 c) / a,
    D = C/a - 1, P = U_tt + U_pp / s^2 + (2 Omega c - p)^2 and Q = (U_tt U_pp - U_tp^2) / s^2.
    """
    s, c = _trig(p["theta0"])
    sp, cp = _trig(p["psi0"])
    a, square = 0.5 * (p["A"] + p["B"]), p["Omega"] ** 2
    momentum = (p["C"] * _w3(p) + p["k3"]) / a
    D = p["C"] / a - 1
    radial, normal = p["mu3"] * p["h1"] / a, p["mu3"] * p["h3"] / a
    tt = (
        (c**2 - s**2) * square * (3 * D * sp**2 - 1)
        + p["Omega"] * momentum * c
        - radial * s * sp
        - normal * c
    )
    tp = _quotient(6 * D * square * s * c * sp * cp + radial * c * cp, s)
    pp = 3 * D * square * (cp**2 - sp**2) - _quotient(radial * sp, s)
    P = tt + pp + (2 * p["Omega"] * c - momentum) ** 2
    return _quartic(P, tt * pp - tp**2, np.abs(p["Omega"]) + np.abs(momentum))


def _stability_about_normal(p: Points) -> tuple[Flags, Array]:
    """Rotation about the orbit's normal and an axis of symmetry along it, with k and mu along it too.

    With J the moment about that axis, T across it, nu the rate in the orbital frame:
    p = (J (Omega + nu) + k.gamma) / T, U_2 = Omega p - Omega^2 - h3 mu.gamma / T,
    U_1 = U_2 + 3 Omega^2 (J/T - 1), lambda^4 + (U_1 + U_2 + (2 Omega - p)^2) lambda^2 + U_1 U_2 = 0.
    Unknown where k or h3 mu has a part across the axis: the linear system is then periodic in time.
    """
    inertia, k, mu = _vectors(p)
    _, gamma = directions(p)
    nu = p["n"] + p["m"] * gamma[2]
    along = (inertia * gamma**2).sum(0)
    across = 0.5 * (inertia.sum(0) - along)
    momentum = (along * (p["Omega"] + nu) + (k * gamma).sum(0)) / across
    second = p["Omega"] * momentum - p["Omega"] ** 2 - p["h3"] * (mu * gamma).sum(0) / across
    first = second + 3 * p["Omega"] ** 2 * (along / across - 1)
    oblique = _relative_to(length(cross(k, gamma)), _momentum(p))
    oblique = oblique + _relative_to(p["h3"] * length(cross(mu, gamma)), _torque(p))
    P = np.where(np.abs(oblique) < 1e-12, first + second + (2 * p["Omega"] - momentum) ** 2, np.nan)
    return _quartic(P, first * second, np.abs(p["Omega"]) + np.abs(momentum))


def _stability_spherical(p: Points) -> tuple[Flags, Array]:
    """Seen from axes that turn with n + Omega, lambda^2 = 0 twice and -((N s)^2 + (2 N c - p)^2): stable."""
    return np.full(np.shape(p["A"]), Stability.STABLE, np.int8), np.zeros(np.shape(p["A"]))


# Cylindrical.


def _solve_cylindrical(name: str, p: Points) -> Array:
    """k1,2 = H3 mu1,2 / w3, or mu1,2 from k1,2."""
    rotor, magnet = _w3(p), _field(p)[2]
    if name.startswith("k"):
        return _quotient(magnet * p["mu" + name[1]], rotor)
    return _quotient(rotor * p["k" + name[2]], magnet)


def _solve_theta_upright(p: Points) -> Array:
    """The nearest of 0 and pi (mod 2 pi)."""
    return np.pi * np.round(p["theta0"] / np.pi)


# Equilibrium.


def _no_rotation(p: Points) -> Array:
    return _relative_to(_turn_rate(p), _rate(p))


def _rest_torque(p: Points, with_rotor: bool = True) -> tuple[Array, Array, Array]:
    """Torque on the body at rest in the orbital frame, and alpha, gamma; shape (3, points) each."""
    inertia, k, mu = _vectors(p)
    alpha, gamma = directions(p)
    square = p["Omega"] ** 2
    momentum = square * inertia * gamma + (p["Omega"] * k if with_rotor else 0.0)
    H = p["h1"] * alpha + p["h3"] * gamma
    return cross(momentum, gamma) + 3 * square * cross(alpha, inertia * alpha) + cross(H, mu), alpha, gamma


def _normal_torque(p: Points) -> Array:
    torque, _, gamma = _rest_torque(p)
    return _relative_to((torque * gamma).sum(0), _torque(p))


def _plane_torque(p: Points) -> Array:
    torque, alpha, gamma = _rest_torque(p)
    beta = cross(gamma, alpha)
    return _relative_to(np.hypot((torque * alpha).sum(0), (torque * beta).sum(0)), _torque(p))


def _k_along(name: str, p: Points, base: Array, gamma: Array) -> Array:
    """Component of k = base + lambda gamma: k3 with lambda from k1 and k2, k1 and k2 with lambda from k3.

    Where gamma3 = 0 lambda does not enter k3, and k1 and k2 determine each other.
    """
    i, k = int(name[1]) - 1, np.array([p["k1"], p["k2"], p["k3"]])
    gamma = np.where(np.abs(gamma) < 1e-14, 0.0, gamma)
    free = (k - base) * gamma
    if i == 2:
        along = _quotient(free[0] + free[1], gamma[0] ** 2 + gamma[1] ** 2)
    else:
        along = np.where(
            gamma[2] == 0, _quotient(free[1 - i], gamma[1 - i] ** 2), _quotient(free[2], gamma[2] ** 2)
        )
    return base[i] + along * gamma[i]


def _solve_k_equilibrium(name: str, p: Points) -> Array:
    torque, _, gamma = _rest_torque(p, with_rotor=False)
    return _k_along(
        name, p, _quotient(cross(torque, gamma), np.broadcast_to(p["Omega"], torque.shape)), gamma
    )


def _solve_h1_equilibrium(p: Points) -> Array:
    """From the torque about the normal: beta.(3 Omega^2 I alpha + h1 mu) = 0."""
    inertia, _, mu = _vectors(p)
    alpha, gamma = directions(p)
    beta = cross(gamma, alpha)
    return _quotient(-3 * p["Omega"] ** 2 * (beta * inertia * alpha).sum(0), (beta * mu).sum(0))


def _solve_m_equilibrium(p: Points) -> Array:
    """-n cos theta0 on the normal; elsewhere 0, and only if n = 0."""
    s, c = _trig(p["theta0"])
    return np.where((s == 0) | (p["n"] == 0), -p["n"] * c, np.nan)


# Oblique and the transverse magnets.


def _solve_psi_oblique(p: Points) -> Array:
    """sin psi0 = h1 mu3 / (3 Omega^2 s ((A + B)/2 - C)), on the side of the given cos psi0."""
    s, _ = _trig(p["theta0"])
    gravity = 3 * p["Omega"] ** 2 * s * (0.5 * (p["A"] + p["B"]) - p["C"])
    sine = _quotient(p["h1"] * p["mu3"], gravity)
    angle = np.arcsin(np.where(np.abs(sine) <= 1, sine, np.nan))
    return np.where(np.cos(p["psi0"]) < 0, np.pi - angle, angle)


def _solve_oblique(name: str, p: Points) -> Array:
    """h1 or mu3 from their product 3 Omega^2 s sin psi0 ((A + B)/2 - C)."""
    s, _ = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    product = 3 * p["Omega"] ** 2 * s * sp * (0.5 * (p["A"] + p["B"]) - p["C"])
    return _quotient(product, p["mu3" if name == "h1" else "h1"])


def _solve_transverse(name: str, p: Points) -> Array:
    """m, h1 or h3 of sin psi0 h1 (Omega + m c) = m s h3, with sin psi0 = +-1."""
    s, c = _trig(p["theta0"])
    side = _trig(p["psi0"])[0]
    if name == "m":
        return _quotient(side * p["h1"] * p["Omega"], p["h3"] * s - side * p["h1"] * c)
    if name == "h1":
        return _quotient(p["m"] * s * p["h3"], side * (p["Omega"] + p["m"] * c))
    return _quotient(side * p["h1"] * (p["Omega"] + p["m"] * c), p["m"] * s)


def _solve_despun(name: str, p: Points) -> Array:
    """m = -Omega c; h1 or h3 of h3 c + h1 s sin psi0 = 0."""
    s, c = _trig(p["theta0"])
    sp, _ = _trig(p["psi0"])
    if name == "m":
        return -p["Omega"] * c
    if name == "h1":
        return _quotient(-p["h3"] * c, s * sp)
    return _quotient(-p["h1"] * s * sp, c)


def _solve_mu3_despun(p: Points) -> Array:
    """The oblique relation; free, and kept, where cos psi0 = 0."""
    return np.where(_trig(p["psi0"])[1] == 0, p["mu3"], _solve_oblique("mu3", p))


_DESPUN = Condition("m = -Omega cos theta0", lambda p: _relative_to(_w3(p), _rate(p)))
_FIELD_ACROSS = Condition(
    "h3 c = -h1 s sin psi0 (or mu1 = mu2 = 0)",
    lambda p: _relative_to(_field(p)[2] * np.hypot(p["mu1"], p["mu2"]), _torque(p)),
)
_DESPUN_BALANCE = Condition(
    "cos psi0 (3 Omega^2 s sin psi0 ((A + B)/2 - C) - h1 mu3) = 0",
    _despun_balance,
)

# Asymmetric tilt.


def _tilt_angle(p: Points) -> Array:
    return 4 * _trig(p["theta0"])[1] ** 2 - 1


def _tilt_spin(p: Points) -> Array:
    return _relative_to(p["m"] + 2 * p["Omega"] * _trig(p["theta0"])[1], _rate(p))


def _solve_theta_tilt(p: Points) -> Array:
    """pi/3 or 2 pi/3, on the side of the given cos theta0."""
    return np.where(np.cos(p["theta0"]) < 0, 2 * np.pi / 3, np.pi / 3)


def _solve_h1_tilt(p: Points) -> Array:
    """h1 = -sin psi0 sgn(c) sqrt(3) h3, needed if mu1 or mu2 is not 0."""
    s, c = _trig(p["theta0"])
    return -_trig(p["psi0"])[0] * np.sign(c) * np.sign(s) * np.sqrt(3) * p["h3"]


# Spherical body.


def _spherical_balance(p: Points) -> Array:
    torque = (p["n"] + p["Omega"]) * (p["C"] * p["m"] + p["k3"]) - p["h3"] * p["mu3"]
    return _relative_to(torque, _torque(p))


def _solve_spherical(name: str, p: Points) -> Array:
    """k3, m, n or h3 of (n + Omega)(C m + k3) = h3 mu3."""
    N, axial = p["n"] + p["Omega"], p["C"] * p["m"] + p["k3"]
    if name == "n":
        return _quotient(p["h3"] * p["mu3"], axial) - p["Omega"]
    if name == "h3":
        return _quotient(N * axial, p["mu3"])
    needed = _quotient(p["h3"] * p["mu3"], N)
    return needed - p["C"] * p["m"] if name == "k3" else (needed - p["k3"]) / p["C"]


# Rotation about another axis.


def _symmetry_about_normal(p: Points) -> Array:
    """Deviation of gamma from an axis across which every direction has the same moment of inertia."""
    inertia, _, _ = _vectors(p)
    alpha, gamma = directions(p)
    beta = cross(gamma, alpha)
    parts = (
        length(cross(inertia * gamma, gamma)),
        (inertia * (alpha**2 - beta**2)).sum(0),
        (inertia * 2 * alpha * beta).sum(0),
    )
    return _relative_to(length(np.array(parts)), _inertia(p))


def _normal_rotor(p: Points) -> Array:
    _, k, mu = _vectors(p)
    _, gamma = directions(p)
    return _relative_to(length(cross(gamma, (p["n"] + p["Omega"]) * k - p["h3"] * mu)), _torque(p))


def _solve_k_other_axis(name: str, p: Points) -> Array:
    _, _, mu = _vectors(p)
    _, gamma = directions(p)
    N = np.broadcast_to(p["n"] + p["Omega"], mu.shape)
    return _k_along(name, p, _quotient(p["h3"] * mu, N), gamma)


def steady_motion(points: Points, t: Array) -> Array:
    """State of the steady motion theta = theta0, psi = n t + psi0, phi = m t + phi0.

    Shape (9, *t.shape, *points.shape), in the order of equations.STATE; theta_dot0 is taken as 0. It
    solves the equations of motion where the point is on a family.
    """
    t = np.asarray(t, float)
    times = t.reshape(t.shape + (1,) * np.ndim(points["A"]))
    moved = {name: np.broadcast_to(value, np.broadcast_shapes(times.shape, np.shape(value)))
             for name, value in points.items()}  # fmt: skip
    return initial_state(
        {
            **moved,
            "psi0": points["psi0"] + points["n"] * times,
            "phi0": points["phi0"] + points["m"] * times,
            "theta_dot0": np.zeros_like(moved["theta_dot0"]),
        }
    )


_SYMMETRIC_TILT = (_STEADY_TILT, _NO_PRECESSION, _SYMMETRIC, _AXIAL_ROTOR, _AXIAL_MAGNET)
_TILT_LABELS = (
    "permanent rotation about the third axis in the orbital frame; in space regular precession (Omega, m),"
    " permanent rotation where m = 0"
)

_TABLE = (
    Family(
        name="cylindrical",
        flag=1,
        title="third axis along the orbit's normal, symmetric body turning about it at n +- m",
        equations="(14)-(16), (21)-(23), (29)-(31), (44), (45)",
        conditions=(_STEADY_TILT, _UPRIGHT, _SYMMETRIC, _NO_RADIAL_TORQUE, _SPINNING_PAIR),
        solve={"theta0": _solve_theta_upright, **_formulas(_solve_cylindrical, "mu1", "mu2", "k1", "k2")},
        stability=_stability_about_normal,
        geometry="cylindrical",
        paper_wording="n = 0: cylindrical permanent rotation (orbital), cylindrical regular precession "
        "(inertial); n != 0: cylindrical regular precession in both",
        labels="permanent rotation in both frames, about the normal at n +- m and in space at n + Omega +- m",
        exists="w3 = 0 only with H3 mu1 = H3 mu2 = 0; k1 and k2 are then free",
        free=("C", "k3", "psi0", "phi0"),
    ),
    Family(
        name="equilibrium",
        flag=2,
        title="any body at rest in the orbital frame",
        equations="(27), (28) at theta0 = pi; otherwise derived from (1)-(3)",
        conditions=(
            _STEADY_TILT,
            Condition("n sin theta0 = 0 and n cos theta0 + m = 0", _no_rotation),
            Condition("beta.(3 Omega^2 I alpha + h1 mu) = 0", _normal_torque),
            Condition(
                "Omega gamma x k = Omega^2 I gamma x gamma + 3 Omega^2 alpha x I alpha + (h1 alpha + h3 gamma) x mu"
                " across gamma",
                _plane_torque,
            ),
        ),
        solve={
            "m": _solve_m_equilibrium,
            "h1": _solve_h1_equilibrium,
            **_formulas(_solve_k_equilibrium, "k3", "k1", "k2"),
        },
        paper_wording="equilibrium position (orbital), cylindrical regular precession (inertial)",
        labels="at rest in the orbital frame, turning with it in space: permanent rotation in both",
        exists="every orientation without torque about the normal has such a rotor, k is free along the normal;"
        " atlas.equilibria finds all orientations of a given body",
        free=("damping",),
    ),
    Family(
        name="perp_radius",
        flag=3,
        title="third axis at rest in the plane of normal and velocity, symmetric body spinning at m",
        equations="(17), (18)",
        conditions=(*_SYMMETRIC_TILT, _NODE_ON_RADIUS, _NO_AXIAL_RADIAL_TORQUE, _TILT_BALANCE),
        solve={
            "psi0": _solve_psi_on_radius,
            "theta0": _solve_theta,
            "m": _solve_m,
            "h3": _solve_h3,
            "k3": _solve_k3,
        },
        stability=_stability_tilted,
        geometry="perp_radius",
        paper_wording="conical permanent rotation (orbital), conical regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="every theta0; for given k3 and m: |k3 + C m - mu3 h3 / Omega| <= Omega |A - C|",
        free=("phi0",),
    ),
    Family(
        name="perp_velocity",
        flag=4,
        title="third axis at rest in the plane of normal and radius, symmetric body spinning at m",
        equations="(24), (25)",
        conditions=(*_SYMMETRIC_TILT, _NODE_ON_VELOCITY, _TILT_BALANCE),
        solve={
            "psi0": _solve_psi_on_velocity,
            "theta0": _solve_theta,
            "m": _solve_m,
            "h1": _solve_h1,
            "h3": _solve_h3,
            "k3": _solve_k3,
        },
        stability=_stability_tilted,
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="every theta0, but sin theta0 = 0 only if h1 mu3 = 0; for given k3 and m without h1 mu3:"
        " |k3 + C m - mu3 h3 / Omega| <= 4 Omega |A - C|",
        free=("phi0",),
    ),
    Family(
        name="oblique",
        flag=5,
        title="third axis at rest in an oblique plane through the normal, symmetric body with axial magnet",
        equations="derived from (1)-(3); not in the paper",
        conditions=(*_SYMMETRIC_TILT, _OBLIQUE_BALANCE, _TILT_BALANCE),
        solve={
            "psi0": _solve_psi_oblique,
            **_formulas(_solve_oblique, "h1", "mu3"),
            "m": _solve_m,
            "h3": _solve_h3,
            "k3": _solve_k3,
        },
        stability=_stability_tilted,
        geometry="oblique",
        labels=_TILT_LABELS,
        exists="|h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|: from perp_radius at h1 mu3 = 0 to perp_velocity at equality",
        free=("phi0",),
    ),
    Family(
        name="transverse_magnet",
        flag=6,
        title="as perp_velocity, with rotor and magnet across the third axis",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            _STEADY_TILT, _NO_PRECESSION, _SYMMETRIC, _NODE_ON_VELOCITY, _SPINNING_PAIR, _NODE_PAIR,
            _TILT_BALANCE,
        ),
        solve={
            "psi0": _solve_psi_on_velocity,
            **_formulas(_solve_transverse, "m", "h1", "h3"),
            **_formulas(_solve_node_pair, "k1", "k2"),
            "k3": _solve_k3,
        },
        geometry="perp_velocity",
        labels=_TILT_LABELS,
        exists="where mu1 or mu2 is not 0: sin psi0 h1 (Omega + m cos theta0) = m sin theta0 h3",
        free=("phi0",),
    ),
    Family(
        name="despun_transverse",
        flag=7,
        title="symmetric body without rotation about its axis (w3 = 0), rotor and magnet across it",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            _STEADY_TILT, _NO_PRECESSION, _SYMMETRIC, _DESPUN, _FIELD_ACROSS, _NODE_PAIR, _DESPUN_BALANCE,
            _TILT_BALANCE,
        ),
        solve={
            **_formulas(_solve_despun, "m", "h1", "h3"),
            "mu3": _solve_mu3_despun,
            **_formulas(_solve_node_pair, "k1", "k2"),
            "k3": _solve_k3,
        },
        labels=_TILT_LABELS,
        exists="cos psi0 = 0, or |h1 mu3| <= 3 Omega^2 |sin theta0 (A - C)|",
        free=("phi0",),
    ),
    Family(
        name="asymmetric_tilt",
        flag=8,
        title="any body, third axis at 60 or 120 degrees in the plane of normal and radius, m = -+Omega",
        equations="(19), (20); 120 degrees and psi0 = -pi/2 derived from (1)-(3)",
        conditions=(
            _STEADY_TILT,
            _NO_PRECESSION,
            Condition("cos theta0 = +-1/2", _tilt_angle),
            Condition("m = -2 Omega cos theta0", _tilt_spin),
            _NODE_ON_VELOCITY,
            _SPINNING_PAIR,
            _NODE_PAIR,
            _TILT_BALANCE,
        ),
        solve={
            "theta0": _solve_theta_tilt,
            "psi0": _solve_psi_on_velocity,
            "m": lambda p: -2 * p["Omega"] * np.cos(p["theta0"]),
            "h1": _solve_h1_tilt,
            **_formulas(_solve_node_pair, "k1", "k2"),
            "k3": _solve_k3,
        },
        geometry="perp_velocity",
        paper_wording="hyperboloidal permanent rotation (orbital), hyperboloidal regular precession (inertial)",
        labels=_TILT_LABELS,
        exists="mu1 = mu2 = 0, or h1 = -sin psi0 sgn(cos theta0) sqrt(3) h3",
        free=("phi0",),
    ),
    Family(
        name="spherical",
        flag=9,
        title="spherical body, any tilt, precession and spin",
        equations="remarks after (31) and (45), completed from (1)-(3)",
        conditions=(
            _STEADY_TILT,
            _SYMMETRIC,
            _equal("B", "C"),
            _AXIAL_ROTOR,
            _NO_RADIAL_TORQUE,
            Condition(
                "h3 mu1 = h3 mu2 = 0",
                lambda p: _relative_to(p["h3"] * np.hypot(p["mu1"], p["mu2"]), _torque(p)),
            ),
            Condition("(n + Omega) (C m + k3) = h3 mu3", _spherical_balance),
        ),
        solve=_formulas(_solve_spherical, "n", "m", "h3", "k3"),
        stability=_stability_spherical,
        geometry="general",
        paper_wording="spherical symmetry: regular precession",
        labels="regular precession (n, m) in the orbital frame and (n + Omega, m) in space; permanent rotation where"
        " one of the two rates is 0",
        exists="n = -Omega only with h3 mu3 = 0; k3 and m are then free",
        free=("theta0", "psi0", "phi0"),
    ),
    Family(
        name="other_axis",
        flag=10,
        title="rotation at n about an axis of symmetry other than the third, which lies along the normal",
        equations="derived from (1)-(3); not in the paper",
        conditions=(
            _STEADY_TILT,
            _NO_SPIN,
            Condition("gamma an axis of equal moments: (A = C, gamma = +-e2), (B = C, gamma = +-e1) or A = B = C",
                      _symmetry_about_normal),
            _NO_RADIAL_TORQUE,
            Condition("gamma x ((n + Omega) k - h3 mu) = 0", _normal_rotor),
        ),
        solve=_formulas(_solve_k_other_axis, "k3", "k1", "k2"),
        stability=_stability_about_normal,
        geometry="general",
        labels="permanent rotation in both frames, about the normal at n and in space at n + Omega",
        exists="n = -Omega only with h3 mu along the normal; k is then free",
        free=("psi0",),
    ),
)  # fmt: skip

# Damping leaves the motions at rest in the orbital frame, which the family "equilibrium" demands anyway.
_UNDAMPED = {family.name: () if family.name == "equilibrium" else (_NO_DISSIPATION,) for family in _TABLE}
FAMILIES: dict[str, Family] = {
    family.name: replace(family, motion=steady_motion, conditions=family.conditions + _UNDAMPED[family.name])
    for family in _TABLE
}


def condition_residual(points: Points) -> Array:
    """|w'-dot - n m gamma x e3| at the start over the largest squared rate; 0 on an exact motion.

    w'-dot is the relative angular acceleration of the start, n m gamma x e3 that of the steady motion
    w' = n gamma + m e3. The rates are Omega, |w| and sqrt(|h| |mu| / smallest moment of inertia).
    Shape of the points, dimensionless.
    """
    state = initial_state(points)
    w, gamma = state[:3], state[6:]
    rates = np.array(rhs(state, constants(points)))
    needed = np.array([gamma[1], -gamma[0], np.zeros_like(gamma[0])]) * (points["n"] * points["m"])
    residual = rates[:3] - points["Omega"] * rates[6:] - needed
    min_inertia = np.minimum(np.minimum(points["A"], points["B"]), points["C"])
    field = _moment(points) * np.hypot(points["h1"], points["h3"]) / min_inertia
    square = np.maximum(np.maximum(points["Omega"] ** 2, (w**2).sum(0)), field)
    return _relative_to(length(residual), square)
