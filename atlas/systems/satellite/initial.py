"""Parameters of the satellite, and the initial state from angles and rates."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from ..base import Array, Mask, Parameter, Points, shared
from ..gyrostat import Body, Direction
from ..gyrostat.body import gyration, perron_root
from ..gyrostat.motions import angular_velocity
from ..gyrostat.motions import directions as directions
from ..vectors import cross, length
from .equations import CONSTANTS, INTEGRALS

SIGN = "minus the dipole moment as SI counts it (the potential is + mu.H, as in the paper)"
DRAG = "arm of the centre of pressure times the force against the velocity (the potential is + drag.beta)"
_TABLE = (
    # name, unit, symbol, default, low, open_low, start, meaning
    ("A", "kg m2", "$A$", 1.0, 0.0, True, False, "principal moment of inertia about the first body axis"),
    ("B", "kg m2", "$B$", 1.0, 0.0, True, False, "principal moment of inertia about the second body axis"),
    ("C", "kg m2", "$C$", 1.2, 0.0, True, False, "principal moment of inertia about the third body axis"),
    ("Omega", "rad s-1", r"$\Omega$", 1.0, 0.0, False, False, "angular velocity of the circular orbit"),
    ("k1", "N m s", "$k_1$", 0.0, -np.inf, False, False, "gyrostatic momentum along the first body axis"),
    ("k2", "N m s", "$k_2$", 0.0, -np.inf, False, False, "gyrostatic momentum along the second body axis"),
    ("k3", "N m s", "$k_3$", 0.0, -np.inf, False, False, "gyrostatic momentum along the third body axis"),
    ("mu1", "A m2", r"$\mu_1$", 0.0, -np.inf, False, False, f"magnetic moment along the first body axis, {SIGN}"),
    ("mu2", "A m2", r"$\mu_2$", 0.0, -np.inf, False, False, f"magnetic moment along the second body axis, {SIGN}"),
    ("mu3", "A m2", r"$\mu_3$", 0.0, -np.inf, False, False, f"magnetic moment along the third body axis, {SIGN}"),
    ("h1", "T", "$h_1$", 0.0, -np.inf, False, False, f"magnetic field along the radius; mu is {SIGN}"),
    ("h3", "T", "$h_3$", 0.0, -np.inf, False, False, f"magnetic field along the orbit normal; mu is {SIGN}"),
    ("drag1", "N m", "$d_1$", 0.0, -np.inf, False, False, f"torque of drag, component along the first body axis: {DRAG}"),
    ("drag2", "N m", "$d_2$", 0.0, -np.inf, False, False, f"torque of drag, component along the second body axis: {DRAG}"),
    ("drag3", "N m", "$d_3$", 0.0, -np.inf, False, False, f"torque of drag, component along the third body axis: {DRAG}"),
    ("damping", "N m s", "$D$", 0.0, 0.0, False, False, "viscous damping, a torque of -D times the angular velocity relative to the orbital frame"),
    ("theta0", "rad", r"$\theta_0$", 0.0, -np.inf, False, True, "angle from the orbit normal to the third body axis at the start"),
    ("psi0", "rad", r"$\psi_0$", 0.0, -np.inf, False, True, "precession angle at the start, about the orbit normal from the radius"),
    ("phi0", "rad", r"$\varphi_0$", 0.0, -np.inf, False, True, "angle of proper rotation at the start"),
    ("theta_dot0", "rad s-1", r"$\dot\theta_0$", 0.0, -np.inf, False, True, "rate of the start about the line of nodes"),
    ("n", "rad s-1", "$n$", 0.0, -np.inf, False, True, "precession rate of the start, about the orbit normal in the orbital frame"),
    ("m", "rad s-1", "$m$", 0.0, -np.inf, False, True, "rate of proper rotation of the start, about the third body axis"),
)  # fmt: skip

PARAMETERS = {
    name: Parameter(name, unit, meaning, default, low, np.inf, open_low, initial_state, symbol)
    for name, unit, symbol, default, low, open_low, initial_state, meaning in _TABLE
}


def constants(points: Points) -> Array:
    """Return the constants of the equations, shape (constants, points), in the order of equations.CONSTANTS."""
    p = points
    A, B, C, Omega = p["A"], p["B"], p["C"], p["Omega"]
    k1, k2, k3, mu1, mu2, mu3 = (p[name] for name in ("k1", "k2", "k3", "mu1", "mu2", "mu3"))
    drag1, drag2, drag3 = p["drag1"], p["drag2"], p["drag3"]
    D = np.array([(B - C) / A, (C - A) / B, (A - B) / C])
    body = [A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, p["h1"], p["h3"]]
    rotor = [k2 / A, k3 / A, k3 / B, k1 / B, k1 / C, k2 / C]
    magnet = [mu3 / A, mu2 / A, mu1 / B, mu3 / B, mu2 / C, mu1 / C]
    drag = [drag3 / A, drag2 / A, drag1 / B, drag3 / B, drag2 / C, drag1 / C, drag1, drag2, drag3]
    damping = [p["damping"] / A, p["damping"] / B, p["damping"] / C]
    return np.array(
        [*body, *D, 3 * Omega**2, np.ones_like(A), np.ones_like(A), *rotor, *magnet, *drag, *damping]
    )


@shared
def body_vectors(points: Points) -> tuple[Array, Array, Array]:
    """Return I, k and mu as arrays of shape (3, points)."""
    return tuple(  # type: ignore[return-value]
        np.array([points[name] for name in names])
        for names in (("A", "B", "C"), ("k1", "k2", "k3"), ("mu1", "mu2", "mu3"))
    )


@shared
def drag_vector(points: Points) -> Array:
    """Return the torque of drag, which is arm times force, (3, points)."""
    return np.array([points["drag1"], points["drag2"], points["drag3"]])


def body(points: Points) -> Body:
    """Return the body. The potentials belong to the radius (gravity gradient and h1 mu), the velocity (drag) and the normal (h3 mu)."""
    vectors = *body_vectors(points), drag_vector(points)
    inertia, rotor, magnet, drag = (np.moveaxis(vector, 0, -1) for vector in vectors)
    Omega = points["Omega"]
    radius = Direction(3 * Omega**2, points["h1"][..., None] * magnet)
    velocity = Direction(np.zeros_like(Omega), drag)
    normal = Direction(np.zeros_like(Omega), points["h3"][..., None] * magnet)
    return Body(inertia, rotor, Omega, radius, velocity, normal, points["damping"])


@shared
def initial_state(points: Points) -> Array:
    """Return the state at t = 0, (9, points). The angular velocity is (n + Omega) gamma + m e3, plus theta_dot0 about the node."""
    alpha, gamma = directions(points)
    return np.concatenate([angular_velocity(points, points["n"] + points["Omega"], gamma), alpha, gamma])


def symmetric_about_third_axis(points: Points) -> Mask:
    """Return where A = B and neither rotor, magnet nor drag has a transverse part, bool (points,)."""
    symmetric = points["A"] == points["B"]
    for name in ("k1", "k2", "mu1", "mu2", "drag1", "drag2"):
        symmetric = symmetric & (points[name] == 0)
    return symmetric


def conserves_axial_momentum(points: Points) -> Mask:
    """Return where C w3 + k3 is conserved, bool (points,)."""
    return symmetric_about_third_axis(points) & (points["damping"] == 0)


def integral_scales(points: Points) -> dict[str, Array]:
    """Return a lower bound of the scale of each integral, or nan where the integral is not constant. See System.integral_scales."""
    axial = symmetric_about_third_axis(points)
    rates = sum(np.abs(points[name]) for name in ("Omega", "n", "m", "theta_dot0"))
    scales = dict.fromkeys(INTEGRALS, np.zeros_like(points["A"]))
    return scales | {"axial_momentum": np.where(axial, points["C"] * rates, np.nan)}


@shared
def frequency_bound(points: Points) -> Array:
    """Return an upper bound of the fastest frequency, rad per time unit, in the way of Body.frequency_bound.

    Damping D adds -D I^-1 y + D Omega I^(-1/2) gamma to the equations of y = sqrt(I) w. The norm of D I^-1 is D / least moment.
    """
    inertia, k, mu = body_vectors(points)
    (A, B, C), Omega = inertia, np.abs(points["Omega"])
    state = initial_state(points)
    w, alpha, gamma = state[:3], state[3:6], state[6:]
    u = w - points["Omega"] * gamma
    field = np.hypot(points["h1"], points["h3"])
    moment, rotor, drag = length(mu), length(k), drag_vector(points)

    # The kinetic energy grows by at most the sum of the falls of all terms of the potential from the start to their minima.
    kinetic = 0.5 * (inertia * u**2).sum(0)
    gravity = 1.5 * Omega**2 * ((inertia * alpha**2).sum(0) - inertia.min(0))
    centrifugal = 0.5 * Omega**2 * (inertia.max(0) - (inertia * gamma**2).sum(0))
    gyroscopic = Omega * rotor - points["Omega"] * (k * gamma).sum(0)
    H = points["h1"] * alpha + points["h3"] * gamma
    magnetic = moment * field + (mu * H).sum(0)
    dragging = length(drag) + (drag * cross(gamma, alpha)).sum(0)
    energy = kinetic + gravity + centrifugal + gyroscopic + magnetic + dragging
    energy = np.maximum(energy, 0.0)

    # If C w3 + k3 is conserved, w3 is constant. Torques then change only w1 and w2, and are divided by the moment A.
    symmetric = conserves_axial_momentum(points)
    min_inertia = np.where(symmetric, A, inertia.min(0))
    max_rates = np.sqrt(2 * energy / inertia) + Omega
    max_rates[2] = np.where(symmetric, np.abs(w[2]), max_rates[2])
    max_turn = np.where(
        symmetric, np.hypot(np.sqrt(2 * energy / A), np.abs(w[2]) + Omega), np.sqrt(2 * energy / min_inertia)
    )

    damping = points["damping"] / min_inertia
    differences = np.array([C - B, A - C, B - A])
    gradient = 3 * Omega**2 * np.sqrt((differences**2 / inertia).sum(0) / min_inertia)
    # beta = gamma x alpha changes by at most the sum of the changes of alpha and gamma.
    torque = moment * field + np.sqrt(2) * length(drag)
    stiffness = np.sqrt(2) * (gradient + torque / min_inertia + damping * Omega)
    return perron_root(gyration(inertia, k, max_rates, symmetric) + damping, max_turn + Omega, stiffness)


def specialization(zero: Set[str], equal: Set[tuple[str, str]]) -> tuple[set[str], set[tuple[str, str]]]:
    """Return constants that are 0 without magnet, rotor, orbit, drag or damping, and pairs that are equal by symmetry.

    Each distinct result needs a kernel. To save kernels, some constants stay although they are 0. The constant k3 costs 3 % of
    the time, and so does D3 of a symmetric body with damping and no magnet. k1 and k2 of an asymmetric body with a magnet cost 10 %.
    """
    magnet, drag = {"mu1", "mu2", "mu3", "h1", "h3"}, {"drag1", "drag2", "drag3"}
    rows = (
        ({"mu1", "mu2", "mu3"}, magnet), ({"h1", "h3"}, magnet),
        ({"Omega"}, {"Omega", "N"}), (drag, drag), ({"damping"}, {"damping_A", "damping_B", "damping_C"}),
    )  # fmt: skip
    zero_constants = {name for parameters, names in rows if zero >= parameters for name in names}
    equal_constants: set[tuple[str, str]] = set()
    if zero >= {"k1", "k2"} and zero | zero_constants >= {"mu1", "mu2"}:
        has_magnet = not zero_constants >= magnet
        if ("A", "B") in equal and zero >= {"drag1", "drag2"} and (has_magnet or "damping" in zero):
            zero_constants |= {"k1", "k2", "mu1", "mu2", "drag1", "drag2", "D3"}
            equal_constants = {
                ("B", "A"), ("k3_B", "k3_A"), ("mu3_B", "mu3_A"), ("drag3_B", "drag3_A"), ("damping_B", "damping_A")
            }  # fmt: skip
        elif not has_magnet:
            zero_constants |= {"k1", "k2"}
    # Quotients such as k2_A, which is k2 / A, vanish with the numerator.
    quotients = {name for name in CONSTANTS if name.split("_")[0] in zero_constants}
    return zero_constants | quotients, equal_constants


def steady_rates(points: Points) -> tuple[Array, Array, Array]:
    """Return sin theta, psi' = n and phi' = m of the steady motion that starts at each point."""
    return np.sin(points["theta0"]), points["n"], points["m"]
