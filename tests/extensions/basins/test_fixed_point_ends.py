"""Where damped bodies about a fixed point end: against another integrator and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import default_points

import atlas
from atlas.flags import Label, SettledBy, Status
from atlas.systems.fixed_point.equations import rhs
from atlas.systems.fixed_point.initial import constants, initial_state

pytestmark = pytest.mark.usefixtures("whole_kernels")

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


@pytest.mark.long
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
