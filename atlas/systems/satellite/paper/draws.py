"""Random points of order 1, at which the equations of the paper are compared with those of the motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...base import Array
from ..initial import PARAMETERS

Point = dict[str, Array]
Draw = Callable[[np.random.Generator], Point]
Measure = Callable[[np.random.Generator], float]


def random_point(rng: np.random.Generator, **given: float | str) -> Point:
    """A random point of order 1 with given parameters; a name as value copies that parameter."""
    names = [name for name in PARAMETERS if name != "damping"]
    point = {name: rng.uniform(0.4, 1.2, 1) * rng.choice([-1, 1], 1) for name in names}
    point["damping"] = np.zeros(1)  # not of the paper
    point |= {name: rng.uniform(0.7, 1.3, 1) for name in ("A", "B", "C")}
    point |= {"Omega": np.ones(1), "theta0": rng.uniform(0.4, 1.2, 1), "theta_dot0": np.zeros(1)}
    point["phi0"] = np.zeros(1)
    for name, value in given.items():
        point[name] = point[value] if isinstance(value, str) else np.full(1, float(value))
    return point


def euler_state(point: Point) -> list[Array]:
    """psi, theta, phi and their rates at the start, in the order of lagrange.STATE."""
    return [point[name] for name in ("psi0", "theta0", "phi0", "n", "theta_dot0", "m")]
