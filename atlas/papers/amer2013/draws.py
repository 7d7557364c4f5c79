"""Random bodies at which the paper's formulas are compared with the equations of motion."""

from __future__ import annotations

import numpy as np

from ...systems.base import Array
from ...systems.fixed_point import equations, initial
from . import fast_spin
from .fast_spin import FastSpin


def random_spin(rng: np.random.Generator, **given: float) -> FastSpin:
    """A random body with strong fields and a moderate spin; given: fields of FastSpin."""
    values = {
        "A": 1.0, "C": rng.uniform(1.2, 1.8), "weight": rng.uniform(1, 2), "N": rng.uniform(2, 4),
        "l1": rng.uniform(0.5, 1), "l2": rng.uniform(0.5, 1), "l3": rng.uniform(0.5, 1),
        "r0": rng.uniform(4, 8), "gamma0": rng.uniform(0.3, 0.7),
    }  # fmt: skip
    return FastSpin(*(np.asarray(value) for value in (values | given).values()))


def paper_spin(rng: np.random.Generator) -> FastSpin:
    """One of the two bodies of section VI with a rotor of 10 to 25 N m s, for which eps |mu / Omega| is below 5e-3."""
    return fast_spin.paper_body(str(rng.choice(list(fast_spin.PAPER_BODIES))), rng.uniform(10, 25))


def true_rate(spin: FastSpin, y: Array) -> Array:
    """dy/dtau from the equations of motion themselves; y of shape (6,), real or complex."""
    points = {name: np.full(1, parameter.default) for name, parameter in initial.PARAMETERS.items()}
    given = {
        "A": spin.A, "B": spin.A, "C": spin.C, "Mg": np.abs(spin.weight), "z0": spin.z, "N": spin.N,
        "l1": spin.l1, "l2": spin.l2, "l3": spin.l3,
    }  # fmt: skip
    points |= {name: np.full(1, float(value)) for name, value in given.items()}
    state = fast_spin.dimensional(spin, y)
    rate = equations.rhs(state, initial.constants(points)[:, 0])
    return fast_spin.dimensionless(spin, np.array(rate)) / spin.r0


def true_acceleration(spin: FastSpin, y: Array) -> Array:
    """d^2 y/dtau^2 from the equations of motion, by a complex step, exact to rounding errors; shape (6,)."""
    return true_rate(spin, y + 1e-30j * true_rate(spin, y)).imag / 1e-30
