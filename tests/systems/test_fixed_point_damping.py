"""Viscous damping of the gyrostat about a fixed point: equations, balance of the integrals, families, ends."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from strategies import default_points, random_fixed_points
from truth import exponents_along_runs

import atlas
from atlas.flags import EnergyStability, Label, SettledBy, Stability, Status
from atlas.kernel.differentiate import simplify
from atlas.systems.arithmetic import functions
from atlas.systems.fixed_point import FIXED_POINT, equations
from atlas.systems.fixed_point.equations import rhs
from atlas.systems.fixed_point.initial import constants, frequency_bound, initial_state

PENDULUM = {
    "A": 1.0,
    "B": 1.3,
    "C": 0.7,
    "Mg": 1.0,
    "x0": 0.1,
    "y0": 0.2,
    "z0": 0.6,
    "l3": 0.3,
    "damping": 0.3,
}


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


def test_ends_are_those_of_dop853_and_every_loss_is_in_the_balance():
    rng, count = np.random.default_rng(6), 30
    starts = {"theta0": np.arccos(rng.uniform(-1, 1, count)), "phi0": rng.uniform(-3, 3, count)}
    starts |= {name: rng.uniform(-2, 2, count) for name in ("n", "m")}
    # a gradient that turns the body across: two minima
    body = PENDULUM | {"Mg": 0.1, "N": 3.0}
    names = [
        "label", "predicted", "status", "integral_drift", "end_equilibrium", "end_theta0", "end_phi0", "end_index",
        "settled_by", "settling_time",
    ]  # fmt: skip
    ds = atlas.label_points("fixed_point", body | starts, duration=120.0, method="rk8", variables=names)
    assert (ds["status"] == Status.OK).all()
    assert (ds["predicted"] == Label.DRIFTING).all()
    assert (ds["settled_by"] == SettledBy.PROVED).all()
    assert (ds["end_index"] == 0).all()
    assert ds["integral_drift"].max() < 1e-9
    assert ds["settling_time"].max() < 120
    points = default_points("fixed_point", **body | starts)
    state, values = initial_state(points), constants(points)
    run = solve_ivp(
        lambda _, y: np.array(rhs(y.reshape(state.shape), values)).ravel(), (0, 120), state.ravel(), "DOP853",
        rtol=1e-9, atol=1e-10,
    )  # fmt: skip
    gamma = run.y[:, -1].reshape(state.shape)[3:]
    every = atlas.equilibria("fixed_point", body)
    place = ds["end_equilibrium"].values
    assert np.unique(place).size == 2
    np.testing.assert_allclose(every["gamma"].values[place], gamma.T, atol=1e-4)
    np.testing.assert_allclose(np.cos(ds["end_theta0"]), gamma[2], atol=1e-4)
    np.testing.assert_allclose(np.sin(ds["end_phi0"]) * np.sin(ds["end_theta0"]), gamma[0], atol=1e-4)


def test_ends_of_a_symmetric_body_are_circles():
    """Its rotor does not act at rest; of W = (C - A) N c^2 / 2 - Mg z0 c, c = cos theta, the minimum is at Mg z0 / (C - A) / N."""
    body = {"A": 1.0, "B": 1.0, "C": 1.4, "N": 2.0, "l3": 0.4, "damping": 0.3, "theta0": 1.0, "m": 1.0}
    names = ["status", "end_equilibrium", "end_theta0", "end_phi0", "settled_by", "settling_time"]
    body |= {"Mg": [0.5, 0.0], "x0": 0.0, "y0": 0.0, "z0": 0.7, "phi0": 0.0, "n": 0.0}
    ds = atlas.label_points("fixed_point", body, duration=150.0, variables=names, method="rk8")
    assert ds["settled_by"].values.tolist() == [SettledBy.PROVED, SettledBy.PROVED]
    np.testing.assert_allclose(np.cos(ds["end_theta0"]), [0.35 / 0.8, 0.0], atol=1e-9)
    assert np.isnan(ds["end_phi0"]).all()
