"""Starts of runs that pass the vertical at a given distance and a given moment, for stress cases."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .base import Array, System


def earlier_start(system: System, columns: dict[str, ArrayLike], before: Array) -> dict[str, ArrayLike]:
    """Columns of the same motions from a moment `before` the given start (negative: after it).

    columns: parameters and start values by name; the others take their
    defaults. psi0 has no effect on the motion. before: in time units. Returns the columns with other theta0,
    phi0, theta_dot0, n and m.
    """
    from scipy.integrate import solve_ivp  # here, because every command imports the systems

    points = {
        name: np.broadcast_to(np.asarray(columns.get(name, parameter.default), float), before.shape)
        for name, parameter in system.parameters.items()
    }
    constants, start = system.constants(points), system.initial_state(points)

    def slope(_: float, flat: Array) -> Array:
        return (-before * np.array(system.equations.rhs(flat.reshape(start.shape), constants))).ravel()

    run = solve_ivp(slope, (0.0, 1.0), start.ravel(), "DOP853", rtol=1e-13, atol=1e-15)
    state = run.y[:, -1].reshape(start.shape)
    u1, u2, u3, g1, g2, g3 = system.equations.frame_motion(state, constants)
    sine = np.hypot(g1, g2)
    n = (u1 * g1 + u2 * g2) / sine**2
    return columns | {
        "theta0": np.arctan2(sine, g3),
        "phi0": np.arctan2(g1, g2),
        "theta_dot0": (u1 * g2 - u2 * g1) / sine,
        "n": n,
        "m": u3 - n * g3,
    }
