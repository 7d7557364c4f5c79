"""Spherical satellites that turn about any axis of their own: conditions, closed form, predictions."""

import numpy as np
import pytest
from family_starts import spheres
from strategies import predictions, random_satellites, select

from atlas.flags import Agreement, Label
from atlas.label.points import label_points
from atlas.label.theory import predict
from atlas.measure.instrument import Tolerances
from atlas.systems.base import on_family
from atlas.systems.satellite import SATELLITE, any_axis, families

pytestmark = pytest.mark.usefixtures("whole_kernels")

FAMILY = any_axis.FAMILIES["spherical_any_axis"]


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


@pytest.mark.long
def test_measured_labels_about_any_axes_agree():
    points = spheres(np.random.default_rng(4), 12)
    names = [
        "label", "label_any_axis", "label_any_axis_inertial", "predicted_any_axis", "predicted_any_axis_inertial",
        "agreement_any_axis", "status",
    ]  # fmt: skip
    ds = label_points("satellite", points, duration=40.0, variables=names)
    assert (ds["status"] == 1).all()
    assert (ds["agreement_any_axis"] == Agreement.AGREE).all()
    np.testing.assert_array_equal(ds["label_any_axis_inertial"], ds["predicted_any_axis_inertial"])
    unloaded = np.arange(12) % 3 == 0
    assert (ds["label_any_axis_inertial"].values[unloaded] == Label.PERMANENT_ROTATION).all()
    assert (ds["label_any_axis"].values[unloaded] == Label.REGULAR_PRECESSION).all()


def test_predictions_are_those_of_the_equations_where_the_catalogue_is_incomplete():
    points = random_satellites(np.random.default_rng(5), 9)
    by_families = predict(SATELLITE, points, Tolerances(1e-5, 1e-5))
    prediction, about_any = predictions(SATELLITE, points)
    for name in ("predicted", "predicted_inertial"):
        assert (by_families[name] == Label.NOT_COMPUTED).all()
        assert (prediction.variables[name] == Label.DRIFTING).all()
        assert (about_any[name.replace("predicted", "predicted_any_axis")] == Label.DRIFTING).all()
