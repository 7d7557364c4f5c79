"""Nudged starts on stable motions: a prediction where the nudge itself moves the rates beyond the tolerance."""

import numpy as np
import pytest
from family_starts import STARTS
from strategies import DRAG, default_points, evaluate

from atlas import systems
from atlas.flags import Label, Status
from atlas.scene.model import Settings

pytestmark = pytest.mark.usefixtures("whole_kernels")
NUDGE = 1e-5
SETTINGS = Settings(rate_tolerance=10 * NUDGE, cylinder_tolerance=10 * NUDGE, tolerance=1e-6, method="rk8")
STEADY = (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION)


def nudged(system, base, **nudge):
    points = base | {name: base[name] + value for name, value in nudge.items()}
    duration = np.fmin(60.0, 2000 / system.frequency_bound(points))
    columns = evaluate(system, base, points, duration, SETTINGS, nudged=True)
    ok = columns["status"] == Status.OK
    return columns["predicted"][ok], columns["label"][ok]


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("fixed_point", {"A": 1.1, "B": 0.9, "C": 0.7, "Mg": 1.0, "z0": 0.8, "N": 0.1}),
        ("satellite", {"A": 0.9, "B": 1.1, "C": 0.7, "k3": -3.0}),
    ],
)
def test_rest_on_the_vertical_with_opposite_rates(name, body):
    """A tilt d of n = -m makes a rate n d."""
    n = np.geomspace(1, 300, 30) * np.tile([-1, 1], 15)
    base = default_points(name, n.size, **body, n=n, m=-n)
    predicted, label = nudged(systems.get(name), base, theta0=NUDGE)
    assert (predicted[np.abs(n) < 3] == Label.PERMANENT_ROTATION).all()
    assert not np.isin(predicted[label == Label.DRIFTING], STEADY).any()
    assert (label == Label.DRIFTING).any()
    assert (predicted[np.abs(n) > 100] != Label.PERMANENT_ROTATION).all()


KINDS = {
    "fixed_point": ("conical", "conical, slow", "conical, fast", "sleeping", "staude", "rest"),
    "satellite": ("perp_radius", "perp_velocity", "oblique", "cylindrical", "spherical", "equilibrium"),
}


@pytest.mark.usual("fixed_point")
@pytest.mark.parametrize("name", KINDS)
def test_nudges_of_fast_motions(name):
    """In units in which the motions are up to 100 times as fast; slow oscillations may be larger than the nudge."""
    system, rng = systems.get(name), np.random.default_rng(8)
    steady = wrong = 0
    for kind in KINDS[name]:
        base = STARTS[name][kind](rng, 30)
        speed = 10 ** rng.uniform(0, 2)
        powers = dict.fromkeys(("Omega", "n", "m", "k1", "k2", "k3", "l1", "l2", "l3"), 1)
        powers |= dict.fromkeys((*DRAG, "mu1", "mu2", "mu3", "Mg", "N"), 2)
        base = {key: values * speed ** powers.get(key, 0) for key, values in base.items()}
        predicted, label = nudged(system, base, theta0=NUDGE, psi0=-NUDGE)
        known = np.isin(predicted, STEADY)
        steady, wrong = steady + known.sum(), wrong + (known & (label == Label.DRIFTING)).sum()
    assert steady > 40
    assert wrong <= 0.05 * steady
