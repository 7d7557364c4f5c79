"""Write elliptic_orbit/satellite_equations.py: python write_equations.py

With the true anomaly nu as the time, w = 1 + e cos nu, and the unit of time in which nu' = w^2, the action is the integral of
w^2 (I u, u) / 2 - 3 w (I r, r) / 2 over nu: u is the angular velocity per nu, r the direction of the radius.
"""

from pathlib import Path

import sympy as sp

from atlas.systems import from_lagrangian

A, B, C, e = parameters = sp.symbols("A B C e")
pitch, roll, yaw, nu = coordinates = sp.symbols("pitch roll yaw nu")
velocities = sp.symbols("pitch_rate roll_rate yaw_rate nu_rate")


def turn(axis, angle):
    """The matrix that takes components into those along axes turned by an angle about one of them."""
    return sp.Matrix(
        sp.rot_axis1(angle) if axis == 1 else sp.rot_axis2(angle) if axis == 2 else sp.rot_axis3(angle)
    )


to_body = turn(2, yaw) * turn(1, roll) * turn(3, pitch)
radius, normal = to_body[:, 0], to_body[:, 2]
u = (1 + velocities[0]) * normal + velocities[1] * turn(2, yaw)[:, 0] + velocities[2] * sp.Matrix([0, 1, 0])
w = 1 + e * sp.cos(nu)
inertia = sp.diag(A, B, C)
lagrangian = w**2 * (u.T * inertia * u)[0] / 2 - 3 * w * (radius.T * inertia * radius)[0] / 2


def equations(path=None):
    return from_lagrangian(
        lagrangian + velocities[3] ** 2 / 2,
        coordinates,
        velocities,
        parameters,
        forces={nu: -lagrangian.diff(nu)},  # nu_rate is 1: what the orbit does is given
        functions={
            "pitch_at_pericentre": pitch,
            "roll_at_pericentre": roll,
            "yaw_at_pericentre": yaw,
            "cos_tilt": normal[2],
        },
        title="Attitude of a satellite on an elliptic orbit, over the true anomaly",
        path=path,
    )


if __name__ == "__main__":
    equations(Path(__file__).with_name("elliptic_orbit") / "satellite_equations.py")
