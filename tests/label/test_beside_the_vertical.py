"""Starts beside the vertical, where n and m are known from rounding alone: theory against full runs."""

import numpy as np
import pytest
from truth import assert_at_points

import atlas
from atlas.flags import Agreement, Label, Status
from atlas.systems.fixed_point import FIXED_POINT

pytestmark = pytest.mark.usefixtures("whole_kernels")

COUNT = 250


def bodies(rng, names):
    """Symmetric, asymmetric and spherical bodies; each of the named parameters is 0 at half of them."""
    A, kind = rng.uniform(0.6, 1.4, COUNT), rng.integers(0, 3, COUNT)
    B = np.where(kind == 0, rng.uniform(0.6, 1.4, COUNT), A)
    C = np.where(kind == 2, A, rng.uniform(np.abs(A - B) + 0.05, A + B - 0.02))
    normal = {name: rng.normal(size=COUNT) * (rng.random(COUNT) < 0.5) for name in names}
    return {"A": A, "B": B, "C": C} | normal


def tilts(rng):
    """Tilts, whether towards the other pole, and small rates along the third axis."""
    small = 10 ** rng.uniform(-18, -2, COUNT)
    tilt = np.where(rng.random(COUNT) < 0.8, small, 10 ** rng.uniform(-300, -2, COUNT))
    axial = rng.normal(size=COUNT) * 10 ** rng.uniform(-8, 0.5, COUNT) * (rng.random(COUNT) < 0.7)
    return tilt, rng.random(COUNT) < 0.5, axial


def by_angles(rng):
    """n and m up to 1e9, which cancel but for a rate of order 1."""
    tilt, down, axial = tilts(rng)
    theta = np.where(down, np.pi - tilt, tilt)
    n = 10 ** rng.uniform(-3, 9, COUNT) * rng.choice([-1, 1], COUNT)
    n = np.clip(n, -3 / np.sin(theta + 1e-300), 3 / np.sin(theta + 1e-300))
    return {"theta0": theta, "n": n, "m": axial - n * np.sign(np.cos(theta))}


def by_vectors(rng):
    tilt, down, axial = tilts(rng)
    first, second = rng.uniform(0, 2 * np.pi, (2, COUNT))
    across = 10 ** rng.uniform(-16, 0, COUNT) * (rng.random(COUNT) < 0.8)
    return {
        "p0": across * np.sin(first), "q0": across * np.cos(first), "r0": axial, "gamma10": tilt * np.sin(second),
        "gamma20": tilt * np.cos(second), "gamma30": np.where(down, -1.0, 1.0) * np.sqrt(1 - tilt**2),
    }  # fmt: skip


FIELDS = {"satellite": ("k3", "mu3", "h3", "mu1", "h1"), "fixed_point": ("Mg", "x0", "z0", "N", "l1", "l3")}


@pytest.mark.parametrize(
    ("system", "starts"), [("satellite", by_angles), ("fixed_point", by_angles), ("fixed_point", by_vectors)]
)
def test_theory_predicts_the_measured_labels_beside_the_vertical(system, starts):
    rng = np.random.default_rng(53)
    points = bodies(rng, FIELDS[system]) | starts(rng)
    variables = ["label", "predicted", "agreement", "status"]
    ds = atlas.label_points(system, points, duration=5.0, variables=variables)
    agree = ds.agreement.isin((Agreement.AGREE, Agreement.NOT_COMPARED))
    where = ds.status.values == Status.OK
    assert_at_points(
        agree, True, points, 53, where=where, label=ds.label.values, predicted=ds.predicted.values
    )
    assert min(np.bincount(ds.predicted, minlength=4)[[Label.PERMANENT_ROTATION, Label.DRIFTING]]) > 30


@pytest.mark.parametrize("across", [0.0, 1e-12, 1e-9, 1e-6])
def test_torque_on_an_upright_body_is_seen_however_its_vertical_is_rounded(across):
    points = {"A": 1.1, "B": 1.4, "C": 1.9, "y0": 0.7, "Mg": 2.0, "q0": across, "p0": 0.0, "r0": 0.8}
    points |= {"gamma10": 0.0, "gamma20": np.sin(np.pi), "gamma30": np.array([-1.0])}
    ds = atlas.label_points(
        "fixed_point", points, duration=3.0, variables=["family", "predicted", "condition_residual"]
    )
    assert (ds.family[0], ds.predicted[0]) == (0, Label.DRIFTING)
    # the torque over the least moment and the largest squared rate, that of the weight
    assert ds.condition_residual[0] == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(("n", "m"), [(1.0, 1.0), (0.3, -2.0), (1e3, 1e3)])
@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_rounding_of_pi_leaves_a_body_upright(system, n, m):
    ds = atlas.label_points(
        system, {"theta0": np.pi, "n": n, "m": np.array([m])}, duration=1.0, variables=["family", "predicted"]
    )
    assert ds.predicted[0] == Label.PERMANENT_ROTATION
    assert ds.family[0] > 0


def test_vectors_beside_the_vertical_have_angles_without_large_rates():
    start = {"p0": 1e-6, "q0": 2e-7, "r0": 1.3, "gamma10": 6e-17, "gamma20": 0.0, "gamma30": 1.0}
    given = FIXED_POINT.with_defaults(start)
    points = FIXED_POINT.as_euler_angles(given)
    np.testing.assert_allclose(
        FIXED_POINT.initial_state(points), FIXED_POINT.initial_state(given), atol=1e-16, rtol=1e-15
    )
    assert np.abs([points["n"], points["m"]]).max() < 2
