"""Formulas that put a point on a family of steady motions of the satellite.

Each keeps everything but its own parameter. Short names and the equations (*) are those of `families`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..base import Array, Points
from ..vectors import cross
from .initial import directions
from .quantities import axial_rate, body_vectors, node_field, quotient, relative_to, rest_torque, sine_cosine


def solve_psi_on_radius(p: Points) -> Array:
    """The nearest of 0 and pi (mod 2 pi)."""
    return np.pi * np.round(p["psi0"] / np.pi)


def solve_psi_on_velocity(p: Points) -> Array:
    """pi/2 or -pi/2 (mod 2 pi), on the side of the given sin psi0; pi/2 for 0."""
    return np.pi * (np.floor(p["psi0"] / np.pi) + 0.5)


def _axial_momentum(p: Points) -> Array:
    """k3 + C m of a steady tilt; at s = 0 its limit, which exists if h1 mu3 sin psi0 = 0."""
    s, c = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    radial = p["mu3"] * p["h1"] * c * sp
    singular = np.where(radial == 0, 0.0, quotient(radial, p["Omega"] * s))
    gravity = p["Omega"] * c * flatness * (1 + 3 * sp**2)
    return gravity + relative_to(p["mu3"] * p["h3"], p["Omega"]) - singular


def solve_k3(p: Points) -> Array:
    """From the balance of the tilt."""
    return _axial_momentum(p) - p["C"] * p["m"]


def solve_m(p: Points) -> Array:
    """From the balance of the tilt."""
    return (_axial_momentum(p) - p["k3"]) / p["C"]


def solve_h3(p: Points) -> Array:
    """From the balance of the tilt, which is linear in h3."""
    rest = _axial_momentum({**p, "h3": np.zeros_like(p["h3"])})
    return quotient(p["Omega"] * (p["k3"] + p["C"] * p["m"] - rest), p["mu3"])


def solve_h1(p: Points) -> Array:
    """From the balance of the tilt, which is linear in h1."""
    s, c = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    rest = _axial_momentum({**p, "h1": np.zeros_like(p["h1"])})
    return quotient(p["Omega"] * s * (rest - p["k3"] - p["C"] * p["m"]), p["mu3"] * c * sp)


def solve_theta(p: Points) -> Array:
    """Tilt in [0, pi] from k3 and m; nan if h1 mu3 sin psi0 is not 0, where there are several."""
    sp, _ = sine_cosine(p["psi0"])
    flatness = 0.5 * (p["A"] + p["B"]) - p["C"]
    momentum = p["k3"] + p["C"] * p["m"] - relative_to(p["mu3"] * p["h3"], p["Omega"])
    cosine = quotient(momentum, p["Omega"] * flatness * (1 + 3 * sp**2))
    exists = (np.abs(cosine) <= 1) & (p["h1"] * p["mu3"] * sp == 0)
    return np.where(exists, np.arccos(np.clip(cosine, -1, 1)), np.nan)


def solve_node_pair(name: str, p: Points) -> Array:
    """k1 or k2 of Omega s K = (H2 + i H1) U."""
    H1, H2, _ = node_field(p)
    torque = H2 * p["mu1"] - H1 * p["mu2"] if name == "k1" else H2 * p["mu2"] + H1 * p["mu1"]
    return quotient(torque, p["Omega"] * sine_cosine(p["theta0"])[0])


def formulas(solver: Callable[[str, Points], Array], *names: str) -> dict[str, Callable[[Points], Array]]:
    """The formula of each of these parameters, of a solver that takes its name."""
    return {name: lambda p, name=name: solver(name, p) for name in names}  # type: ignore[misc]


def solve_cylindrical(name: str, p: Points) -> Array:
    """k1,2 = H3 mu1,2 / w3, or mu1,2 from k1,2."""
    rotor, magnet = axial_rate(p), node_field(p)[2]
    if name.startswith("k"):
        return quotient(magnet * p["mu" + name[1]], rotor)
    return quotient(rotor * p["k" + name[2]], magnet)


def solve_theta_upright(p: Points) -> Array:
    """The nearest of 0 and pi (mod 2 pi)."""
    return np.pi * np.round(p["theta0"] / np.pi)


def _k_along(name: str, p: Points, base: Array, gamma: Array) -> Array:
    """Component of k = base + lambda gamma: k3 with lambda from k1 and k2, k1 and k2 with lambda from k3.

    Where gamma3 = 0 lambda does not enter k3, and k1 and k2 determine each other.
    """
    i, k = int(name[1]) - 1, np.array([p["k1"], p["k2"], p["k3"]])
    gamma = np.where(np.abs(gamma) < 1e-14, 0.0, gamma)
    free = (k - base) * gamma
    if i == 2:
        along = quotient(free[0] + free[1], gamma[0] ** 2 + gamma[1] ** 2)
    else:
        along = np.where(
            gamma[2] == 0, quotient(free[1 - i], gamma[1 - i] ** 2), quotient(free[2], gamma[2] ** 2)
        )
    return base[i] + along * gamma[i]


def solve_k_equilibrium(name: str, p: Points) -> Array:
    """Component of a rotor that leaves no torque across the normal."""
    torque, _, gamma = rest_torque(p, with_rotor=False)
    return _k_along(name, p, quotient(cross(torque, gamma), np.broadcast_to(p["Omega"], torque.shape)), gamma)


def solve_h1_equilibrium(p: Points) -> Array:
    """From the torque about the normal: beta.(3 Omega^2 I alpha + h1 mu) = 0."""
    inertia, _, mu = body_vectors(p)
    alpha, gamma = directions(p)
    beta = cross(gamma, alpha)
    return quotient(-3 * p["Omega"] ** 2 * (beta * inertia * alpha).sum(0), (beta * mu).sum(0))


def solve_m_equilibrium(p: Points) -> Array:
    """-n cos theta0 on the normal; elsewhere 0, and only if n = 0."""
    s, c = sine_cosine(p["theta0"])
    return np.where((s == 0) | (p["n"] == 0), -p["n"] * c, np.nan)


def solve_psi_oblique(p: Points) -> Array:
    """sin psi0 = h1 mu3 / (3 Omega^2 s ((A + B)/2 - C)), on the side of the given cos psi0."""
    s, _ = sine_cosine(p["theta0"])
    gravity = 3 * p["Omega"] ** 2 * s * (0.5 * (p["A"] + p["B"]) - p["C"])
    sine = quotient(p["h1"] * p["mu3"], gravity)
    angle = np.arcsin(np.where(np.abs(sine) <= 1, sine, np.nan))
    return np.where(np.cos(p["psi0"]) < 0, np.pi - angle, angle)


def solve_oblique(name: str, p: Points) -> Array:
    """h1 or mu3 from their product 3 Omega^2 s sin psi0 ((A + B)/2 - C)."""
    s, _ = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    product = 3 * p["Omega"] ** 2 * s * sp * (0.5 * (p["A"] + p["B"]) - p["C"])
    return quotient(product, p["mu3" if name == "h1" else "h1"])


def solve_transverse(name: str, p: Points) -> Array:
    """m, h1 or h3 of sin psi0 h1 (Omega + m c) = m s h3, with sin psi0 = +-1."""
    s, c = sine_cosine(p["theta0"])
    side = sine_cosine(p["psi0"])[0]
    if name == "m":
        return quotient(side * p["h1"] * p["Omega"], p["h3"] * s - side * p["h1"] * c)
    if name == "h1":
        return quotient(p["m"] * s * p["h3"], side * (p["Omega"] + p["m"] * c))
    return quotient(side * p["h1"] * (p["Omega"] + p["m"] * c), p["m"] * s)


def solve_despun(name: str, p: Points) -> Array:
    """m = -Omega c; h1 or h3 of h3 c + h1 s sin psi0 = 0."""
    s, c = sine_cosine(p["theta0"])
    sp, _ = sine_cosine(p["psi0"])
    if name == "m":
        return -p["Omega"] * c
    if name == "h1":
        return quotient(-p["h3"] * c, s * sp)
    return quotient(-p["h1"] * s * sp, c)


def solve_mu3_despun(p: Points) -> Array:
    """The oblique relation; free, and kept, where cos psi0 = 0."""
    return np.where(sine_cosine(p["psi0"])[1] == 0, p["mu3"], solve_oblique("mu3", p))


def solve_theta_tilt(p: Points) -> Array:
    """pi/3 or 2 pi/3, on the side of the given cos theta0."""
    return np.where(np.cos(p["theta0"]) < 0, 2 * np.pi / 3, np.pi / 3)


def solve_h1_tilt(p: Points) -> Array:
    """h1 = -sin psi0 sgn(c) sqrt(3) h3, needed if mu1 or mu2 is not 0."""
    s, c = sine_cosine(p["theta0"])
    return -sine_cosine(p["psi0"])[0] * np.sign(c) * np.sign(s) * np.sqrt(3) * p["h3"]


def solve_spherical(name: str, p: Points) -> Array:
    """k3, m, n or h3 of (n + Omega)(C m + k3) = h3 mu3."""
    N, axial = p["n"] + p["Omega"], p["C"] * p["m"] + p["k3"]
    if name == "n":
        return quotient(p["h3"] * p["mu3"], axial) - p["Omega"]
    if name == "h3":
        return quotient(N * axial, p["mu3"])
    needed = quotient(p["h3"] * p["mu3"], N)
    return needed - p["C"] * p["m"] if name == "k3" else (needed - p["k3"]) / p["C"]


def solve_k_other_axis(name: str, p: Points) -> Array:
    """Component of a rotor of which (n + Omega) k - h3 mu is along the normal."""
    _, _, mu = body_vectors(p)
    _, gamma = directions(p)
    N = np.broadcast_to(p["n"] + p["Omega"], mu.shape)
    return _k_along(name, p, quotient(p["h3"] * mu, N), gamma)
