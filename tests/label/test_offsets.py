"""Starts near a steady motion: their predicted labels against closed forms and against measured labels."""

import numpy as np
import pytest
from strategies import (
    SATELLITE_FAMILIES,
    default_points,
    fixed_points_on_family,
    random_fixed_points,
    random_satellites,
    satellite_on_family,
    select,
    symmetric_fixed_points,
    tile_of,
)

import atlas
from atlas.flags import Agreement, Label, Status
from atlas.label import offsets, theory
from atlas.label.offsets import describes, off_family_labels
from atlas.label.plan import Plan
from atlas.scene.model import Settings, Tolerances
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

FIXED_POINT, SATELLITE = SYSTEMS["fixed_point"], SYSTEMS["satellite"]
TOLERANCES, SETTINGS = Tolerances(1e-5, 1e-5), Settings()
OFFSETS = {
    "satellite": ("theta0", "psi0", "phi0", "theta_dot0", "n", "m", "k1", "k3", "A", "h1", "h3", "mu1"),
    "fixed_point": ("theta0", "phi0", "theta_dot0", "n", "m", "l1", "l3", "A", "C", "x0", "z0", "N"),
}
# Below, at and above the tolerance of a rate.
SHARES = np.array([0.5, 0.85, 1.0, 1.15, 2.0])
REST, OPEN, DRIFTS = Label.PERMANENT_ROTATION, Label.NOT_COMPUTED, Label.DRIFTING


def pendulum(side: float, **offset):
    """A body that hangs (side 1) or stands upside down (-1), its centre of mass on the first axis; it swings in theta."""
    given = {"theta0": np.pi / 2 + offset.pop("theta0", 0.0), **offset}
    return default_points(
        "fixed_point",
        A=1.0,
        B=1.3,
        C=1.5,
        Mg=0.9,
        x0=side * 0.7,
        y0=0.0,
        z0=0.0,
        N=0.0,
        phi0=np.pi / 2,
        **given,
    )


def labels_of(points, duration):
    """Predicted labels of points of the fixed-point system, the start being its own motion before the nudge."""
    duration = np.broadcast_to(float(duration), points["A"].shape)
    prediction = theory.predict_runs(Plan(FIXED_POINT, SETTINGS), tile_of(points, points, duration))
    return list(prediction.variables["predicted"])


def test_a_swinging_pendulum_drifts_by_the_amplitude_of_its_rate():
    """theta' = e cos(w t), w^2 = Mg x0 / B: the root mean square over whole periods is e / sqrt 2."""
    frequency = np.sqrt(0.9 * 0.7 / 1.3)
    run = 3 * 2 * np.pi / frequency
    size = SHARES * np.sqrt(2) * TOLERANCES.rate
    expected = [REST, REST, OPEN, DRIFTS, DRIFTS]
    assert labels_of(pendulum(1.0, theta_dot0=size), run) == expected
    # let go at rest beside the lowest position, which is a residual and no rate
    assert labels_of(pendulum(1.0, theta0=size / frequency), run) == expected


@pytest.mark.parametrize("duration", [2.0, 15.0])
def test_an_offset_from_an_unstable_motion_drifts_once_it_has_grown(duration):
    """theta' = e cosh(w t): the mean square is e^2 (1 / 2 + sinh(2 w T) / (4 w T))."""
    growth = np.sqrt(0.9 * 0.7 / 1.3) * duration
    rms = np.sqrt(0.5 + np.sinh(2 * growth) / (4 * growth))
    size = SHARES * TOLERANCES.rate / rms
    assert labels_of(pendulum(-1.0, theta_dot0=size), duration) == [REST, REST, OPEN, DRIFTS, DRIFTS]


def satellites(rng, each):
    """Some satellites on every family."""
    members = []
    for name in SATELLITE_FAMILIES:
        drawn = (satellite_on_family(name, rng) for _ in iter(int, 1))
        exist = (point for point in drawn if point is not None)
        members += [next(exist) for _ in range(each)]
    return {name: np.concatenate([np.ravel(point[name]) for point in members]) for name in members[0]}


def fixed_points(rng, each):
    """Some bodies on every family about the third axis or the vertical."""
    members = [
        fixed_points_on_family("conical", symmetric_fixed_points(rng, each), "l3"),
        fixed_points_on_family("sleeping", random_fixed_points(rng, each), "theta0", "l1", "l2"),
        fixed_points_on_family("sleeping", symmetric_fixed_points(rng, each), "theta0"),
        fixed_points_on_family(
            "staude", random_fixed_points(rng, each, m=0.0, theta_dot0=0.0), "theta0", "phi0"
        ),
        fixed_points_on_family("rest", symmetric_fixed_points(rng, 3 * each, n=0.0), "theta0"),
    ]
    return {name: np.concatenate([points[name] for points in members]) for name in members[0]}


def near_families(system, rng, each):
    """Points on every family, each with a parameter changed by 1e-9 to 1e-3."""
    points = {"satellite": satellites, "fixed_point": fixed_points}[system](rng, each)
    count = points["A"].size
    size = 10 ** rng.uniform(-9, -3, count) * rng.choice([-1, 1], count)
    for i, name in enumerate(rng.choice(OFFSETS[system], count)):
        points[name][i] += size[i]
    return points


@pytest.mark.parametrize(("system", "each"), [("satellite", 12), ("fixed_point", 25)])
@pytest.mark.filterwarnings("ignore:at some points A != B")
def test_random_offsets_have_the_predicted_label(system, each):
    points = near_families(system, np.random.default_rng(23), each)
    ds = atlas.label_points(system, points, duration=20.0)
    ds = ds.isel(point=np.flatnonzero((ds.family == 0) & (ds.status == Status.OK)))
    assert ds.sizes["point"] > 0.7 * points["A"].size
    assert np.isin(ds.agreement, (Agreement.AGREE, Agreement.NOT_COMPARED)).all()
    assert (ds.agreement == Agreement.NOT_COMPARED).mean() < 0.06
    # Neither label is rare: the agreement is no accident.
    assert 0.2 < (ds.predicted == Label.DRIFTING).mean() < 0.8


def test_starts_that_are_nearly_exact_drift_once_they_have_grown_and_have_the_cylinder_of_the_label():
    """Of the first three growth_rate x T is 49, 49 and 8; the others are on a family of spherical bodies to rounding."""
    body = {"A": [1.2] * 3 + [1.0] * 3, "B": 1.0, "C": [0.9] * 3 + [1.0] * 3}
    start = {"psi0": [1e-10, 1e-11, 1e-10, 0, 0, 0], "theta0": [0, 0, 0, 5e-6, 2e-5, np.pi - 5e-6]}
    spin = {"n": [0, 0, 0, 0.5, 0.5, 0.5], "m": [0, 0, 0, 1.0, 1.0, 1.0], "k3": [0, 0, 0, -1.0, -1.0, -1.0]}
    duration = [60.0, 60.0, 10.0] + [20.0] * 3
    ds = atlas.label_points("satellite", body | start | spin, duration=duration, tolerance=1e-6)
    assert (ds.status == Status.OK).all()
    assert (ds.family > 0).all()
    expected = [DRIFTS, DRIFTS, REST, REST, Label.REGULAR_PRECESSION, REST]
    for name in ("predicted", "label", "predicted_inertial", "label_inertial"):
        assert list(ds[name]) == expected, name


def test_a_strong_rotor_holds_bodies_far_from_equilibrium():
    """theta' and psi' of the nutation are s Mg z0 A / h and Mg z0 / h, at the frequency h / A."""
    weight = np.array([0.01, 0.1, 1.0])
    points = {"theta0": 1.0, "l3": 1e3, "z0": 1.0, "Mg": weight}
    ds = atlas.label_points("fixed_point", points, duration=2.0, tolerance=1e-5, rate_tolerance=1e-4)
    assert (ds.condition_residual > 0.5).all()
    np.testing.assert_allclose(ds.psi_dot_std, weight / 1e3 / np.sqrt(2), rtol=1e-2)
    assert list(ds.predicted) == list(ds.label) == [REST, REST, DRIFTS]


def test_rounding_errors_predict_no_drift():
    """The offset is in the stable turn about the radius, and rounding of the angle in the unstable one about the normal."""
    point = {"A": [0.97] * 2, "B": 1.31, "C": 1.45, "theta0": np.pi, "phi0": np.pi / 2, "k1": 4e-10}
    ds = atlas.label_points("satellite", point, duration=[20.0, 400.0], tolerance=1e-6)
    assert list(ds.predicted) == [REST, OPEN]


@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_a_prediction_does_not_depend_on_the_other_points(system):
    points = near_families(system, np.random.default_rng(5), 3)
    count = points["A"].size
    duration, frames = np.full(count, 9.0), {"predicted": np.zeros(count)}
    together = off_family_labels(SYSTEMS[system], points, duration, TOLERANCES, frames)["predicted"]
    for i in range(0, count, 4):
        alone = off_family_labels(
            SYSTEMS[system], select(points, i), duration[:1], TOLERANCES, {"predicted": np.zeros(1)}
        )
        assert alone["predicted"] == together[i]


def test_starts_far_from_every_family_need_no_linear_equations(monkeypatch):
    """They drift, and cost nothing."""
    monkeypatch.setattr(offsets, "_integrate", None)
    points = random_satellites(np.random.default_rng(2), 200)
    prediction = theory.predict_runs(Plan(SATELLITE, SETTINGS), tile_of(points, points, np.full(200, 9.0)))
    assert (prediction.variables["predicted"] == Label.DRIFTING).all()
    assert (prediction.variables["predicted_inertial"] == Label.DRIFTING).all()


def test_a_run_that_is_too_long_for_the_linear_equations_has_no_prediction():
    points = pendulum(1.0, theta_dot0=1e-9)
    assert labels_of(points, 1e3) == [REST]
    assert labels_of(points, 1e7) == [OPEN]


def test_an_incomplete_catalogue_predicts_nothing_near_its_families():
    points = satellite_on_family("spherical", np.random.default_rng(4))
    points = points | {"Omega": np.zeros(1), "k3": points["k3"] + 1e-8}
    prediction = theory.predict_runs(Plan(SATELLITE, SETTINGS), tile_of(points, points, np.full(1, 9.0)))
    assert prediction.variables["predicted"] == Label.NOT_COMPUTED


def test_labels_about_any_axes_are_those_about_the_third_near_its_families():
    """Where these are steady. What swings by about the tolerance may be as steady about other axes, by twenty it is not."""
    points = pendulum(1.0, theta_dot0=np.append(SHARES, 20.0) * np.sqrt(2) * TOLERANCES.rate)
    duration = np.full(SHARES.size + 1, 3 * 2 * np.pi / np.sqrt(0.9 * 0.7 / 1.3))
    variables = theory.predict_runs(Plan(FIXED_POINT, SETTINGS), tile_of(points, points, duration)).variables
    assert list(variables["predicted"]) == [REST, REST, OPEN, DRIFTS, DRIFTS, DRIFTS]
    about_any = theory.predict_any_axis(FIXED_POINT, points, points, variables, TOLERANCES.rate, nudged=False)
    assert list(about_any["predicted_any_axis"]) == [REST, REST, OPEN, OPEN, OPEN, DRIFTS]


def test_both_systems_are_described_by_an_angular_velocity_and_vectors_at_rest():
    assert describes(SATELLITE)
    assert describes(FIXED_POINT)
