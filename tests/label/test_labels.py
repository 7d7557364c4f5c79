"""Labels of points, from measurements written by hand and of published cases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import select
from truth import cases, fixed_point_cases, satellite_cases

import atlas
from atlas.flags import Agreement, Label, Status
from atlas.kernel.statistics import STATISTICS
from atlas.scene import grid
from atlas.scene.model import Tolerances

pytestmark = pytest.mark.usefixtures("whole_kernels")

TOLERANCES = Tolerances(1e-5, 1e-5)
NAMES = list(Label.meanings())


def named(ds, variable: str, point: int) -> str:
    """Flag name of a variable at one point."""
    return ds[variable].attrs["flag_meanings"].split()[int(ds[variable][point])]


def test_the_68_satellite_cases(monkeypatch):
    # The body of one case cannot exist; its equations have the expected motion all the same.
    monkeypatch.setattr(grid, "possible_body", lambda system, points: np.ones(68, bool))
    durations = [case["T"] for case in cases("satellite")]
    ds = atlas.label_points("satellite", satellite_cases(), duration=durations)
    for i, case in enumerate(cases("satellite")):
        expected = case["label_orbital"], case["label_inertial"], case["geometry"]
        result = named(ds, "label", i), named(ds, "label_inertial", i), named(ds, "geometry", i)
        assert result == expected, case["id"]
        if not case["valid"] and case["max_abs_dtheta"] == 0:
            continue  # the theory of motions in the plane is an extension, with tests of its own
        assert (named(ds, "predicted", i), named(ds, "predicted_inertial", i)) == expected[:2], case["id"]
        assert ds.agreement[i] == 1
        assert (ds.family[i] > 0) == case["valid"]
        if case["valid"]:
            assert ds.condition_residual[i] < 1e-12
    assert (ds.status == Status.OK).all()


def test_the_55_fixed_point_cases():
    durations = [case["T"] for case in cases("fixed_point")]
    ds = atlas.label_points("fixed_point", fixed_point_cases(), duration=durations, rate_tolerance=1e-5)
    for i, case in enumerate(cases("fixed_point")):
        assert (named(ds, "label", i), named(ds, "geometry", i)) == (case["label"], case["geometry"]), case[
            "id"
        ]
        assert named(ds, "predicted", i) == case["label"], case["id"]
    assert (ds.agreement == 1).all()


def test_nothing_grows_where_nothing_is_left_to_rounding():
    """An unstable sleeping top that is vertical to the last bit stays so: no matter how long."""
    i = next(i for i, case in enumerate(cases("fixed_point")) if case["id"] == 60)
    ds = atlas.label_points("fixed_point", select(fixed_point_cases(), i), duration=60.0, tolerance=1e-6)
    assert ds.growth_rate[0] * 60 > np.log(1e11)
    assert named(ds, "label", 0) == "permanent_rotation"


def test_a_blown_up_point_is_unresolved_with_its_reason():
    ds = atlas.label_points(
        "satellite", {"k1": [0.1, 1e200, 0.1], "theta0": 0.5}, duration=20.0, tolerance=1e-6, max_steps=4000
    )
    assert named(ds, "label", 1) == "unresolved"
    assert named(ds, "status", 1) in ("not_finite", "drift_exceeded")
    assert named(ds, "label", 0) == "drifting"
    assert np.isfinite(ds.theta_dot_rms[[0, 2]]).all()


def test_too_long_a_step_is_under_resolved_never_labelled():
    point = {"m": 40.0, "k3": 0.0, "theta0": 0.5, "C": 1.2}
    for step in (0.03, 0.05, 0.08, 0.2):
        ds = atlas.label_points("satellite", point, duration=20.0, step=step)
        assert named(ds, "label", 0) == "unresolved"
    assert named(atlas.label_points("satellite", point, duration=20.0), "label", 0) == "drifting"


@pytest.mark.usual("limit0")
@pytest.mark.parametrize("limit", [{"max_steps": 100_000_000}, {"step": 1e-6}])
def test_points_that_no_label_can_come_of_are_hardly_integrated(limit):
    """1e8 steps of a point, and 5e11 evaluations of the right-hand side, would take minutes."""
    points = {"m": [0.3, 1e9, 1e9], "k3": 0.0, "theta0": [0.5, 0.5, 0.6], "C": 1.2}
    ds = atlas.label_points("satellite", points, duration=[2.0, 90.0, 90.0], check_half_step="none", **limit)
    assert [named(ds, "status", i) for i in range(3)] == ["ok", "not_finite", "not_finite"]
    assert (ds.label[1:] == Label.UNRESOLVED).all()
    assert ds.end_time[0] == 2.0
    np.testing.assert_allclose(ds.end_time[1:], 64 * ds.step[1:])
    assert (ds.error_estimate[1:] == np.inf).all()
    for statistic in STATISTICS:
        if statistic.name != "integral_drift":
            assert np.isnan(ds[statistic.name][1:]).all()
            assert np.isfinite(ds[statistic.name][0])


def test_points_that_max_steps_cuts_are_integrated_where_the_steps_resolve_them():
    """Their error is larger than the tolerance, which the estimate shows."""
    point = {"m": 0.3, "k3": 0.0, "theta0": 0.5, "C": 1.2}
    cut, whole = (
        atlas.label_points("satellite", point, duration=20.0, max_steps=n, check_half_step="none")
        for n in (400, 10**8)
    )
    assert cut.step[0] > whole.step[0]
    assert named(cut, "status", 0) == "ok"
    assert cut.end_time[0] == 20.0
    assert cut.error_estimate[0] > 10 * whole.error_estimate[0]


def test_exact_start_on_an_unstable_motion_run_too_long_is_left_to_roundoff():
    point = {"A": 1.0, "B": 1.0, "C": 1.2, "theta0": 1.0, "psi0": np.pi / 2, "m": 0.3}
    point["k3"] = 4 * np.cos(1.0) * (1.0 - 1.2) - 1.2 * 0.3  # (24): perp_velocity, unstable for 1 < C/A < 4/3
    short = atlas.label_points("satellite", point, duration=5.0)
    long = atlas.label_points("satellite", point, duration=500.0, tolerance=1e-6)
    assert short.stable[0] == 2
    assert short.growth_rate[0] * 500 > np.log(1e11)
    assert named(short, "label", 0) == "permanent_rotation"
    assert named(long, "status", 0) == "roundoff_decided"
    assert named(long, "label", 0) == "unresolved"


def test_steady_turn_about_the_node_is_no_precession():
    """Theta' constant and not zero has standard deviation 0: the rms decides. Free spherical body, Omega = 0."""
    ds = atlas.label_points(
        "satellite", {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "theta_dot0": 0.2}, duration=3.0, tolerance=1e-10
    )
    assert ds.theta_dot_std[0] < 1e-6
    assert named(ds, "label", 0) == "drifting"


@pytest.mark.parametrize("theta0", [0.0, np.pi])
def test_a_start_on_the_pole_that_leaves_it_drifts_without_nan(theta0):
    ds = atlas.label_points("satellite", {"theta0": theta0, "k1": 0.3}, duration=10.0, tolerance=1e-6)
    assert named(ds, "label", 0) == "drifting"
    assert np.isfinite(ds.psi_dot_mean[0])


def test_theta_zero_exactly_with_varying_spin_drifts():
    ds = atlas.label_points("satellite", {"B": 1.1, "theta0": 0.0, "m": 0.7}, duration=30.0, tolerance=1e-6)
    assert ds.theta_max[0] == 0.0
    assert named(ds, "label", 0) == "drifting"
    assert np.isnan(ds.psi_dot_mean[0])


@pytest.mark.long
@given(st.floats(-20, 20), st.floats(0.02, 3.1), st.floats(-3, 3), st.floats(-3, 3))
def test_label_does_not_depend_on_where_psi_and_phi_start(angle, theta0, n, m):
    """A symmetric body with axial rotor: the motion about the axis is free, phi0 must not matter."""
    base = {"theta0": theta0, "n": n, "m": m, "k3": 0.3}
    ds = atlas.label_points("satellite", base | {"phi0": [0.0, angle]}, duration=5.0, tolerance=1e-6)
    assert ds.label[0] == ds.label[1]
    np.testing.assert_allclose(ds.theta_dot_rms[0], ds.theta_dot_rms[1], rtol=1e-6, atol=1e-9)


def test_a_label_within_the_error_of_the_method_is_step_sensitive():
    """The tolerance lies between what a step and half of it give for the rms of theta' of a pendulum that rises."""
    speed = np.sqrt(2.0 * (1.0 + np.cos(0.3)))  # it would be upright after an infinite time
    pendulum = {"Mg": 1.0, "z0": 1.0, "C": 1.0, "theta0": 0.3, "theta_dot0": speed}
    options = {"duration": 8.0, "check_half_step": "none", "drift_tolerance": 1.0, "cylinder_tolerance": 1e-6}
    coarse, fine = (
        float(atlas.label_points("fixed_point", pendulum, step=step, **options).theta_dot_rms[0])
        for step in (0.1, 0.05)
    )
    assert 1e-7 < abs(coarse - fine) / fine < 1e-3
    for variables in (None, ["label", "status"]):
        ds = atlas.label_points(
            "fixed_point",
            pendulum,
            step=0.1,
            rate_tolerance=0.5 * (coarse + fine),
            variables=variables,
            **options,
        )
        assert (named(ds, "label", 0), named(ds, "status", 0)) == ("unresolved", "step_sensitive")
        ds = atlas.label_points(
            "fixed_point", pendulum, step=0.1, rate_tolerance=0.9 * coarse, variables=variables, **options
        )
        assert (named(ds, "label", 0), named(ds, "status", 0)) == ("drifting", "ok")


def test_a_distance_that_rounding_hides_and_that_grows_decides_nothing():
    """An unstable precession that is exact to the rounding of its equations, pushed by 7e-13 rad per time unit."""
    start = {
        "A": 6.860088846939467e-05, "B": 6.860088846939467e-05, "C": 0.00010628256889798502, "Mg": 5.388572049520962e-05,
        "z0": -0.6194765340543725, "N": -2.0987943034901937, "l3": 2.3463619553077605e-05, "theta0": 1.356320175605972,
        "phi0": 1.2673138015218413, "theta_dot0": 7.024387897735427e-13, "n": -0.8512325047018677, "m": -0.3394487572443839,
    }  # fmt: skip
    names = ["label", "predicted", "label_any_axis", "predicted_any_axis", "agreement"]
    ds = atlas.label_points(
        "fixed_point", start, duration=[5.0, 50.0], rate_tolerance=1e-5, method="rk8", variables=names
    )
    precession, drifting, unknown = Label.REGULAR_PRECESSION, Label.DRIFTING, Label.NOT_COMPUTED
    for axes in ("", "_any_axis"):
        assert list(ds[f"label{axes}"].values) == [precession, drifting]
        assert list(ds[f"predicted{axes}"].values) == [precession, unknown]
    assert list(ds.agreement.values) == [Agreement.AGREE, Agreement.NOT_COMPARED]
