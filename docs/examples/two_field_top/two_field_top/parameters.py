"""Parameters, the start, and the body as the theory of the gyrostat sees it."""

import numpy as np

from atlas.systems import Parameter
from atlas.systems.gyrostat import Body, Direction, angular_velocity, directions

MOMENTS = ((f"{name}", "kg m2", f"moment of inertia about axis {i}") for i, name in enumerate("ABC", 1))
VECTORS = (("l", "N m s", "rotor"), ("x", "m", "centre of mass"), ("mu", "N m", "magnet times field"))
STARTS = (
    ("theta0", "rad", "angle from the downward vertical to the third axis"),
    ("psi0", "rad", "angle of precession, from the second field"),
    ("phi0", "rad", "angle of proper rotation"),
    ("theta_dot0", "rad s-1", "rate about the line of nodes"),
    ("n", "rad s-1", "rate of precession"),
    ("m", "rad s-1", "rate of proper rotation"),
)
PARAMETERS = {
    name: Parameter(name, unit, meaning, 1.0, 0.0, open_low=True) for name, unit, meaning in MOMENTS
}
PARAMETERS["Mg"] = Parameter("Mg", "N", "weight")
for vector, unit, meaning in VECTORS:
    for name in (f"{vector}{i}" for i in (1, 2, 3)):
        PARAMETERS[name] = Parameter(name, unit, f"{meaning} along axis {name[-1]}")
PARAMETERS |= {name: Parameter(name, unit, meaning, start=True) for name, unit, meaning in STARTS}


def vectors(points):
    """Inertia, rotor, weight Mg r and magnet, each (3, points)."""
    names = (("A", "B", "C"), ("l1", "l2", "l3"), ("x1", "x2", "x3"), ("mu1", "mu2", "mu3"))
    inertia, rotor, offset, magnet = (np.array([points[name] for name in each]) for each in names)
    return inertia, rotor, points["Mg"] * offset, magnet


def body(points):
    inertia, rotor, weight, magnet = (np.moveaxis(v, 0, -1) for v in vectors(points))
    zero = np.zeros_like(points["Mg"])
    fields = (Direction(zero, field) for field in (-magnet, 0 * magnet, -weight))
    return Body(inertia, rotor, zero, *fields, zero)


def initial_state(points):
    alpha, gamma = directions(points)
    return np.concatenate([angular_velocity(points, points["n"], gamma), alpha, gamma])
