"""Rest of any body; rotation of a symmetric one about its third axis, at rest on the line of the two fields' resultant, and its
regular precession about the resultant: where the magnet is along the centre of mass, two fields act as one, and what is known of
one field holds about the resultant.
"""

import numpy as np

from atlas.flags import Stability
from atlas.systems.base import Family, TwoAxes, numbered
from atlas.systems.gyrostat import Equation, about_third_axis, angular_velocity, directions, motion_of

from .parameters import vectors


def stable_precession(points):
    """Its squared frequency of nutation is never negative: stable, without growth."""
    shape = points["A"].shape
    return np.full(shape, Stability.STABLE, np.int8), np.zeros(shape)


def torque(points):
    _, _, weight, magnet = vectors(points)
    alpha, gamma = directions(points)
    return np.cross(weight, gamma, axis=0) + np.cross(magnet, alpha, axis=0)


def torque_unit(points):
    """The largest torque of the fields, and the least moment times the squared rates."""
    inertia, rotor, weight, magnet = (np.abs(v).max(0) for v in vectors(points))
    rate = rate_unit(points)
    return weight + magnet + rotor * rate + inertia * rate**2


def rate_unit(points):
    return np.abs(points["n"]) + np.abs(points["m"]) + np.abs(points["theta_dot0"])


def across(*names):
    return lambda points: np.array([points[name] for name in names])


NO_TORQUE = Equation("Mg r x g + mu x a = 0", torque, torque_unit)
STILL = Equation("n = theta_dot0 = 0", across("n", "theta_dot0"), rate_unit)
BALANCE = Equation(
    "Mg x3 sin theta0 = mu3 cos theta0 sin psi0, mu3 cos psi0 = 0",
    lambda p: np.array([
        p["Mg"] * p["x3"] * np.sin(p["theta0"]) - p["mu3"] * np.cos(p["theta0"]) * np.sin(p["psi0"]),
        p["mu3"] * np.where(np.abs(np.cos(p["psi0"])) < 1e-14, 0.0, np.cos(p["psi0"])),
    ]),
    torque_unit,
)  # fmt: skip
SYMMETRIC = (
    Equation("A = B", lambda p: p["A"] - p["B"], lambda p: p["A"]),
    Equation("l1 = l2 = x1 = x2 = mu1 = mu2 = 0", across("l1", "l2", "x1", "x2", "mu1", "mu2")),
)


def about_resultant(points):
    """The axes and rates of a start w = N f + m e3, with the unit vector f along the resultant F = Mg x3 g + mu3 a, and |F|."""
    alpha, gamma = directions(points)
    force = points["Mg"] * points["x3"] * gamma + points["mu3"] * alpha
    size = np.sqrt((force**2).sum(0))
    with np.errstate(all="ignore"):
        f = force / size
        w = angular_velocity(points, points["n"], gamma)
        rate = (w[0] * f[0] + w[1] * f[1]) / (f[0] ** 2 + f[1] ** 2)
    third = np.zeros_like(f)
    third[2] = 1.0
    return TwoAxes(third, w[2] - rate * f[2], f, rate), size


def sideways(points):
    axes, size = about_resultant(points)
    w = angular_velocity(points, points["n"], directions(points)[1])
    return w[0] * axes.fixed_axis[1] - w[1] * axes.fixed_axis[0]


def gyroscopic_balance(points):
    axes, size = about_resultant(points)
    f3 = axes.fixed_axis[2]
    spin = points["C"] * (axes.spin_rate + axes.precession_rate * f3) + points["l3"]
    return axes.precession_rate * spin - points["A"] * axes.precession_rate**2 * f3 + size


PRECESSION = Equation("N (C w3 + l3) - A N^2 f3 + |F| = 0", gyroscopic_balance, torque_unit)
CLOSED_FORM = motion_of(about_third_axis, directions)
FAMILIES = numbered(
    (
        Family(
            name="rest",
            title="any body at rest",
            equations="from the equations of motion",
            conditions=(STILL, Equation("m = 0", lambda p: p["m"], rate_unit), NO_TORQUE),
            solve=NO_TORQUE.solve("Mg"),
            motion=CLOSED_FORM,
            labels="permanent rotation: at rest",
        ),
        Family(
            name="axial",
            title="rotation about the third axis, which rests on the line of the fields' resultant",
            equations="from the equations of motion",
            conditions=(STILL, *SYMMETRIC, BALANCE),
            solve=BALANCE.solve("Mg", "x3", "mu3"),
            motion=CLOSED_FORM,
            labels="permanent rotation at m about the resting third axis",
        ),
        Family(
            name="precession",
            title="regular precession at N about the fields' resultant f = F/|F|, F = Mg x3 g + mu3 a",
            equations="from the equations of motion",
            conditions=(*SYMMETRIC, Equation("(w, f x e3) = 0", sideways, rate_unit), PRECESSION),
            solve=PRECESSION.solve("l3"),
            axes=lambda points: about_resultant(points)[0],
            motion=motion_of(lambda points: about_resultant(points)[0], directions),
            stability=stable_precession,
            labels="regular precession about the resultant, and drifting about the vertical",
        ),
    )
)
