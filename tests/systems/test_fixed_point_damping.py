"""Viscous damping of the gyrostat about a fixed point: equations, balance of the integrals, families."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from strategies import default_points, random_fixed_points
from truth import exponents_along_runs

from atlas.flags import EnergyStability, Stability
from atlas.kernel.differentiate import simplify
from atlas.systems.arithmetic import functions
from atlas.systems.fixed_point import FIXED_POINT, equations
from atlas.systems.fixed_point.equations import rhs
from atlas.systems.fixed_point.initial import constants, frequency_bound, initial_state


def test_damping_takes_its_work_and_its_moments():
    """Identically: the torque is -D w, and the energy falls by D w.w."""
    names = ("A", "B", "C", "Mg", "x0", "y0", "z0", "N", "l1", "l2", "l3", "damping")
    A, B, C, Mg, x0, y0, z0, N, l1, l2, l3, D = sp.symbols(names)
    body = A, B, C, 1 / A, 1 / B, 1 / C, l1, l2, l3, Mg * x0, Mg * y0, Mg * z0, N * A, N * B, N * C
    state = sp.symbols(equations.STATE)
    slopes, without = rhs(state, (*body, D)), rhs(state, (*body, 0))
    for moment, rate, slope, other in zip((A, B, C), state, slopes, without, strict=False):
        assert sp.expand(moment * (slope - other) + D * rate) == 0
    total = sum(equations.energy(state, (*body, D)))
    change = sum(sp.diff(total, x) * slope for x, slope in zip(state, slopes, strict=True))
    assert sp.expand(change + D * sum(rate**2 for rate in state[:3])) == 0
    assert sp.expand(change + equations.energy_loss(state, (*body, D))) == 0


def test_without_damping_no_kernel_has_a_term_of_it():
    zero, _ = FIXED_POINT.specialization({"damping"}, set())
    assert zero == {"damping"}
    whole = functions(equations)["rhs"]
    assert whole.count("damping") == 4
    assert simplify(whole, zero, {}).count("damping") == 1  # the name of the constant
    scales = FIXED_POINT.integral_scales(default_points("fixed_point", C=0.5, damping=[0.0, 0.1]))
    for name in ("area", "lagrange", "clebsch", "kovalevskaya"):
        np.testing.assert_array_equal(np.isnan(scales[name]), [False, True])


@pytest.mark.parametrize(("strength", "symmetric"), [(0.3, False), (30.0, True)])
def test_frequency_bound_holds_along_damped_motions(strength, symmetric):
    points = random_fixed_points(np.random.default_rng(3), 6, damping=np.full(6, strength))
    if symmetric:
        points["B"] = points["A"]
        points |= {name: np.zeros(6) for name in ("l1", "l2", "x0", "y0")}
    bound, state, values = frequency_bound(points), initial_state(points), constants(points)
    for i, (path, exponents) in enumerate(exponents_along_runs(rhs, state, values, 4)):
        assert np.linalg.norm(path[:3], axis=0).max() <= bound[i]
        assert np.abs(exponents).max() <= bound[i]


def test_damped_tops_fall_and_rest_alone_is_steady():
    """Sleeping and conical motions are of no family; hanging rest is stable, upright rest is not."""
    top = {"A": 1.0, "B": 1.0, "C": 0.6, "Mg": 1.0, "z0": 1.0, "m": 8.0}
    damped = default_points("fixed_point", **top | {"damping": [0.0, 0.1], "theta0": np.pi})
    flags, residual = FIXED_POINT.identify_family(damped)
    assert flags[0] == FIXED_POINT.families["sleeping"].flag
    assert flags[1] == 0
    assert residual[1] > 1e-4
    rest = default_points("fixed_point", **top | {"m": 0.0, "damping": 0.1, "theta0": [0.0, np.pi]})
    flags, _ = FIXED_POINT.identify_family(rest)
    stable, growth = FIXED_POINT.linear_stability(rest, flags)
    assert stable.tolist() == [Stability.STABLE, Stability.UNSTABLE]
    # A theta'' = Mg z0 theta - D theta' upright
    np.testing.assert_allclose(growth[1], -0.05 + np.sqrt(0.05**2 + 1.0), rtol=1e-9)
    assert FIXED_POINT.energy_stability(rest, flags).tolist() == [EnergyStability.YES, EnergyStability.NO]
