"""Stability limits and constraint errors of the methods, measured in the kernels."""

import numpy as np
import pytest
from strategies import default_points

from atlas.extensions.studies import stress
from atlas.kernel.tableaux import METHODS
from atlas.systems import SYSTEMS


@pytest.mark.usual("rk4")
@pytest.mark.parametrize("method", METHODS.values(), ids=lambda method: method.name)
def test_observed_stability_limits_are_those_of_theory(method):
    for y in stress.observed_stability(method, steps=4000).values():
        assert y == pytest.approx(method.stability, rel=2e-4)


@pytest.mark.usual("rk4-0.02")
@pytest.mark.parametrize(("name", "y"), [("rk4", 0.05), ("rk4", 0.02), ("rk8", 0.2)])
def test_constraint_errors_stay_below_their_bound(name, y):
    system, method, steps = SYSTEMS["satellite"], METHODS[name], 200_000
    bound = stress.constraint_bound(method, y, steps)
    turning = default_points("satellite", C=1.0, Omega=0.0, theta0=1.0, m=1.0)
    # the body turns at rate 1, which is less than its frequency bound
    y_at_bound = y * float(system.frequency_bound(turning)[0])
    change = stress.constraint_change(system, method, turning, y_at_bound, steps)
    assert 0.9 * bound - 1e-10 < change[0] <= 1.01 * bound
    rng = np.random.default_rng(6)
    varied = {name: rng.uniform(-1, 1, 16) for name in ("k1", "k3", "mu1", "h1", "n", "m", "theta_dot0")}
    tumbling = default_points("satellite", A=0.9, B=1.1, theta0=rng.uniform(0, 3, 16), **varied)
    assert (stress.constraint_change(system, method, tumbling, y, steps) <= bound).all()
