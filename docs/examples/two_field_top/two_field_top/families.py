"""Rest of any body, and rotation of a symmetric one about its third axis, at rest on the line of the two fields' resultant."""

import numpy as np

from atlas.systems.base import Family, numbered
from atlas.systems.gyrostat import Equation, about_third_axis, directions, motion_of

from .parameters import vectors


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
            conditions=(
                STILL,
                Equation("A = B", lambda p: p["A"] - p["B"], lambda p: p["A"]),
                Equation("l1 = l2 = x1 = x2 = mu1 = mu2 = 0", across("l1", "l2", "x1", "x2", "mu1", "mu2")),
                BALANCE,
            ),
            solve=BALANCE.solve("Mg", "x3", "mu3"),
            motion=CLOSED_FORM,
            labels="permanent rotation at m about the resting third axis",
        ),
    )
)
