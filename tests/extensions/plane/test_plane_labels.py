"""Labels, predictions and indicators of chaos of motions in the plane of the orbit."""

import json

import numpy as np
import pytest
from strategies import select
from truth import REFERENCE, cases, columns_of, satellite_cases

import atlas
from atlas.flags import Agreement, Label, Regularity, Status
from atlas.systems.base import unsteady
from atlas.systems.satellite import SATELLITE

pytestmark = pytest.mark.usefixtures("whole_kernels")


def test_verified_motions_in_the_plane_are_predicted():
    in_plane = [not case["valid"] and case["max_abs_dtheta"] == 0 for case in cases("satellite")]
    durations = np.array([case["T"] for case in cases("satellite")])[in_plane]
    names = ["label", "predicted", "predicted_inertial", "agreement", "status", "family"]
    ds = atlas.label_points(
        "satellite", select(satellite_cases(), np.flatnonzero(in_plane)), duration=durations, variables=names
    )
    assert ds.sizes["point"] == 1
    assert (ds.status == Status.OK).all()
    for name in ("label", "predicted", "predicted_inertial"):
        assert (ds[name] == Label.DRIFTING).all()
    assert (ds.agreement == Agreement.AGREE).all()
    assert unsteady(SATELLITE, ds.family.values).all()


@pytest.mark.long
def test_verified_unstable_periodic_motions_are_hyperbolic():
    content = json.loads((REFERENCE / "chaos_cases.json").read_text())["cases"]
    of_plane = [
        case for case in content if case["system"] == "satellite" and case["class"] == "unstable_periodic"
    ]
    points = columns_of("satellite", [case["points"] for case in of_plane])
    for duration in (500.0, 2000.0):
        ds = atlas.label_points(
            "satellite", points, duration=duration, method="rk8", variables=["status", "regularity"]
        )
        assert (ds.status == Status.OK).all()
        assert (ds.regularity == Regularity.HYPERBOLIC).all()


def test_starts_on_unstable_motions_are_hyperbolic_and_nudged_ones_chaotic():
    """Whatever variables are asked for."""
    points = {"A": 1.0, "B": 1.3, "C": 1.6, "psi0": [0.6, 0.3, 0.6, 0.6], "k3": [-1.2, 1.8, -1.2, -1.2]}
    points |= {"theta0": [0.0, 0.0, 1e-4, 0.0], "theta_dot0": [0.0, 0.0, 0.0, 1e-9]}
    every = ["label", "status", "megno", "lyapunov", "regularity", "family", "stable"]
    for variables in (["regularity"], every):
        ds = atlas.label_points("satellite", points, duration=900.0, variables=variables, method="rk8")
        expected = [Regularity[name] for name in ("HYPERBOLIC", "REGULAR", "CHAOTIC", "CHAOTIC")]
        np.testing.assert_array_equal(ds.regularity, expected)


def test_rounding_decides_of_motions_in_the_plane_as_of_steady_ones():
    """Upside down the rounding of pi is a tilt. Librations that vary by less than the tolerance are permanent rotations at first."""
    points = {"A": 1.0, "B": 1.3, "C": 1.6, "theta0": np.pi, "psi0": [0.0, 1e-9, 1e-4, 0.5], "k3": 1.2}
    ds = atlas.label_points(
        "satellite", points, duration=900.0, method="rk8", rate_tolerance=1e-3,
        variables=["label", "status", "megno", "lyapunov", "regularity"],
    )  # fmt: skip
    np.testing.assert_array_equal(ds.status, 3 * [Status.ROUNDOFF_DECIDED] + [Status.OK])
    np.testing.assert_array_equal(ds.regularity, 3 * [Regularity.NOT_COMPUTED] + [Regularity.HYPERBOLIC])
