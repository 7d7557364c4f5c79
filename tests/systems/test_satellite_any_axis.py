"""Spherical satellites that turn about any axis of their own: conditions, closed form, predictions."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import default_points, random_satellites, select

from atlas.flags import Agreement, Label
from atlas.label import theory
from atlas.label.points import label_points
from atlas.systems.base import on_family
from atlas.systems.satellite import SATELLITE, any_axis, equations, families, initial

pytestmark = pytest.mark.usefixtures("whole_kernels")

FAMILY = any_axis.FAMILIES["spherical_any_axis"]


def start(points, w, alpha, gamma):
    """Points with these vectors at the start, (3, points) each in body axes, as Euler angles and rates."""
    sine = np.hypot(gamma[0], gamma[1])
    beta = np.cross(gamma, alpha, axis=0)
    theta, phi, psi = (
        np.arctan2(sine, gamma[2]),
        np.arctan2(gamma[0], gamma[1]),
        np.arctan2(alpha[2], -beta[2]),
    )
    u = w - points["Omega"] * gamma
    n = (u[0] * gamma[0] + u[1] * gamma[1]) / sine**2
    theta_dot = u[0] * np.cos(phi) - u[1] * np.sin(phi)
    angles = {"theta0": theta, "phi0": phi, "psi0": psi, "n": n, "m": u[2] - n * gamma[2]}
    return points | angles | {"theta_dot0": theta_dot}


def spheres(rng, count):
    """Rotor and magnet along one random axis of each body, or neither."""
    axis, alpha = rng.normal(size=(2, 3, count))
    axis /= np.sqrt((axis**2).sum(0))
    gamma = np.cross(alpha, rng.normal(size=(3, count)), axis=0)
    alpha, gamma = (v / np.sqrt((v**2).sum(0)) for v in (alpha, gamma))
    loaded = np.arange(count) % 3 > 0
    rotor, moment = rng.normal(size=(2, count)) * loaded
    C, h3 = rng.uniform(0.5, 2, count), rng.normal(size=count)
    rate = np.where(loaded, rng.normal(size=count), 0.0)
    spin = np.where(loaded, (h3 * moment / np.where(loaded, rate, 1.0) - rotor) / C, rng.normal(size=count))
    vectors = {f"k{i + 1}": rotor * axis[i] for i in range(3)} | {
        f"mu{i + 1}": moment * axis[i] for i in range(3)
    }
    points = default_points(
        "satellite", count, A=C, B=C, C=C, h3=h3, Omega=rng.uniform(0.3, 1.5, count), **vectors
    )
    return start(points, rate * gamma + spin * axis, alpha, gamma)


def test_the_start_is_on_the_family_and_follows_its_closed_form():
    points = spheres(np.random.default_rng(1), 30)
    assert (on_family(FAMILY, points) < 1e-12).all()
    flags, residual = SATELLITE.identify_family(points)
    assert (flags == FAMILY.flag).all()
    assert (residual < 1e-12).all()
    for i in range(3):
        point, times = select(points, i), np.linspace(0, 10, 5)
        values, first = initial.constants(point)[:, 0], initial.initial_state(point)[:, 0]
        exact = solve_ivp(
            lambda _, y, values=values: equations.rhs(y, values), (0, 10), first, "DOP853",
            t_eval=times, rtol=1e-12, atol=1e-13,
        ).y  # fmt: skip
        np.testing.assert_allclose(FAMILY.motion(point, times)[..., 0], exact, atol=1e-9)


@pytest.mark.parametrize("changes", [{"C": 0.1}, {"k1": 0.1}, {"n": 0.1}, {"h1": 0.1}, {"theta_dot0": 0.1}])
def test_a_changed_start_is_on_no_family(changes):
    points = spheres(np.random.default_rng(2), 30)
    loaded = select(points, np.arange(30) % 3 > 0)
    moved = loaded | {name: loaded[name] + change for name, change in changes.items()}
    assert (on_family(FAMILY, moved) > 1e-4).all()


def test_other_satellites_keep_their_families():
    points = random_satellites(np.random.default_rng(3), 200)
    points["B"], points["C"] = points["A"], np.where(np.arange(200) < 100, points["A"], points["C"])
    flags, residual = SATELLITE.identify_family(points)
    assert (flags == 0).all()
    assert (residual > 1e-9).all()
    assert max(family.flag for family in families.FAMILIES.values()) + 1 == FAMILY.flag


def test_measured_labels_about_any_axes_agree():
    points = spheres(np.random.default_rng(4), 12)
    names = [
        "label", "label_any_axis", "label_any_axis_inertial", "predicted_any_axis", "predicted_any_axis_inertial",
        "agreement_any_axis", "status",
    ]  # fmt: skip
    ds = label_points("satellite", points, duration=40.0, variables=names, method="rk8")
    assert (ds["status"] == 1).all()
    assert (ds["agreement_any_axis"] == Agreement.AGREE).all()
    np.testing.assert_array_equal(ds["label_any_axis_inertial"], ds["predicted_any_axis_inertial"])
    unloaded = np.arange(12) % 3 == 0
    assert (ds["label_any_axis_inertial"].values[unloaded] == Label.PERMANENT_ROTATION).all()
    assert (ds["label_any_axis"].values[unloaded] == Label.REGULAR_PRECESSION).all()


def test_predictions_are_missing_where_the_catalogue_is_incomplete():
    points = random_satellites(np.random.default_rng(5), 9)
    result = theory.predict(SATELLITE, points, 1e-5, False)
    about_any = theory.predict_any_axis(SATELLITE, points, points, result, 1e-5, nudged=False)
    assert (about_any["predicted_any_axis"] == Label.NOT_COMPUTED).all()
    assert (about_any["predicted_any_axis_inertial"] == Label.NOT_COMPUTED).all()
