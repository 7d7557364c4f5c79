"""A statistic is one instrument: that of docs/examples against a reference, and in no kernel that is not asked for it."""

from pathlib import Path

import numpy as np
import pytest
from plain_kernel import plain_module
from scipy.integrate import solve_ivp
from strategies import default_points, evaluate

from atlas import variables
from atlas.flags import Status
from atlas.label.plan import Plan
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS

EXAMPLE = Path(__file__).parents[2] / "docs/examples/largest_nutation_rate/largest_nutation_rate/rate.py"
FIXED_POINT = SYSTEMS["fixed_point"]


@pytest.fixture
def instrument(install_example):
    install_example("largest_nutation_rate")
    return variables.instruments()[-1]


def test_the_largest_nutation_rate(instrument, monkeypatch):
    """Of spinning tops, by the interpreted kernel, against DOP853 at many instants."""
    assert len(EXAMPLE.read_text().splitlines()) <= 45
    assert type(instrument).__name__ == "LargestNutationRate"
    assert "theta_dot_max" in variables.variables(FIXED_POINT)
    assert Plan(FIXED_POINT, Settings(), ["label"]).plugs == ()
    kernel = plain_module(FIXED_POINT.equations, "rk8", plugs=(instrument,))
    monkeypatch.setattr(Plan, "kernel", kernel)
    points = default_points(
        "fixed_point",
        A=1.0,
        B=1.3,
        C=0.7,
        Mg=1.0,
        z0=0.4,
        x0=0.2,
        theta0=[0.4, 1.2, 2.0],
        m=[3.0, 1.0, 0.2],
        n=0.1,
    )
    values = evaluate(
        FIXED_POINT,
        points,
        points,
        np.full(3, 4.0),
        Settings(method="rk8", tolerance=1e-4),
        outputs=["theta_dot_max"],
    )
    assert (values["status"] == Status.OK).all()
    for i in range(3):
        constants = FIXED_POINT.constants(points)[:, i]
        t = np.linspace(0.0, 4.0, 20001)
        y = solve_ivp(
            lambda t, y, c=constants: FIXED_POINT.equations.rhs(y, c), (0, 4), FIXED_POINT.initial_state(points)[:, i],
            "DOP853", t, rtol=1e-10, atol=1e-11,
        ).y  # fmt: skip
        u1, u2, _, g1, g2, _ = FIXED_POINT.equations.frame_motion(y, constants)
        largest = np.abs((u1 * g2 - u2 * g1) / np.hypot(g1, g2)).max()
        error = abs(values["theta_dot_max"][i] / largest - 1)
        assert error < values["error_estimate"][i] < 0.02
