"""Labels of points, from measurements written by hand and of published cases."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import select
from truth import cases, fixed_point_cases, satellite_cases

import atlas
from atlas.flags import Agreement, Label, Status
from atlas.kernel.statistics import STATISTICS
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.label import pipeline, theory
from atlas.measure import rates
from atlas.scene import grid
from atlas.scene.model import Settings, Tolerances

pytestmark = pytest.mark.usefixtures("whole_kernels")

TOLERANCES = Tolerances(1e-5, 1e-5)
NAMES = list(Label.meanings())


def named(ds, variable: str, point: int) -> str:
    """Flag name of a variable at one point."""
    return ds[variable].attrs["flag_meanings"].split()[int(ds[variable][point])]


def measured(**changes):
    """One steady motion at theta = 1 with psi' = 0.5, phi' = 0.3, but for the values given."""
    values = {
        "theta_dot_rms": 0.0, "psi_dot_mean": 0.5, "psi_dot_std": 0.0, "phi_dot_mean": 0.3, "phi_dot_std": 0.0,
        "normal_rate_std": 0.0, "theta_min": 1.0, "theta_max": 1.0, "sine_max": np.sin(1.0),
    } | changes  # fmt: skip
    return {name: np.array([value]) for name, value in values.items()}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "regular_precession"),
        ({"psi_dot_mean": 0.0}, "permanent_rotation"),
        ({"phi_dot_mean": 0.9e-5}, "permanent_rotation"),
        ({"phi_dot_mean": 1.1e-5}, "regular_precession"),
        ({"psi_dot_mean": 0.0, "phi_dot_mean": 0.0}, "permanent_rotation"),
        ({"theta_dot_rms": 1.1e-5}, "drifting"),
        ({"theta_dot_rms": 0.9e-5}, "regular_precession"),
        ({"psi_dot_std": 1.1e-5}, "drifting"),
        ({"phi_dot_std": 1.1e-5}, "drifting"),
        # a varying rate about the vertical counts inside the cylinder only
        ({"normal_rate_std": 1.0}, "regular_precession"),
        ({"sine_max": 0.9e-5, "theta_max": 0.9e-5, "theta_min": 0.0, "psi_dot_mean": np.nan, "psi_dot_std": np.nan,
          "phi_dot_mean": np.nan, "phi_dot_std": np.nan}, "permanent_rotation"),
        ({"sine_max": 0.9e-5, "theta_max": 0.9e-5, "theta_min": 0.0, "psi_dot_mean": np.nan, "psi_dot_std": np.nan,
          "phi_dot_mean": np.nan, "phi_dot_std": np.nan, "normal_rate_std": 1e-4}, "drifting"),
        # slowly out of the cylinder: psi' has no meaning on the way, theta decides
        ({"sine_max": 3e-5, "theta_min": 0.0, "theta_max": 3e-5, "theta_dot_rms": 1e-7}, "drifting"),
        # on the edge of the cylinder: psi' is that of the sliver outside, the rate about the vertical decides
        ({"sine_max": 1.01e-5, "theta_min": 0.99e-5, "theta_max": 1.01e-5, "normal_rate_std": 0.5}, "drifting"),
        # on the edge of the cylinder, moving less than its radius: still itself
        ({"sine_max": 1.01e-5, "theta_min": 0.99e-5, "theta_max": 1.01e-5}, "regular_precession"),
    ],
)  # fmt: skip
def test_label_at_every_threshold(changes, expected):
    result = rates.label(measured(**changes), TOLERANCES)
    assert NAMES[result[0]] == expected
    assert result.dtype == np.int8


@pytest.mark.parametrize(
    ("changes", "expected"),
    [({name: 1e-5}, "regular_precession") for name in ("theta_dot_rms", "psi_dot_std", "phi_dot_std")]
    + [({name: 1e-5}, "permanent_rotation") for name in ("psi_dot_mean", "phi_dot_mean")]
    + [({"sine_max": 0.9e-5, "normal_rate_std": 1e-5}, "permanent_rotation")]
    + [({"sine_max": 1e-5}, "regular_precession")],
)
def test_a_rate_as_large_as_its_tolerance_counts_as_none(changes, expected):
    """And sin theta must stay below the cylinder tolerance to be inside."""
    assert NAMES[rates.label(measured(**changes), TOLERANCES)[0]] == expected


def test_inertial_label_adds_the_rate_of_the_frame():
    still = measured(psi_dot_mean=0.0)
    assert NAMES[rates.label(still, TOLERANCES)[0]] == "permanent_rotation"
    assert NAMES[rates.label(still, TOLERANCES, 1.0)[0]] == "regular_precession"
    assert NAMES[rates.label(measured(psi_dot_mean=-1.0), TOLERANCES, 1.0)[0]] == "permanent_rotation"


@given(
    st.booleans(), st.sampled_from([0.0, 1e-3]), st.booleans(), st.sampled_from([0.0, 30.0])
)  # fmt: skip
def test_status_is_the_first_that_applies(finite, drift, resolved, growth):
    result = pipeline.label_status(
        np.array([finite]),
        np.array([drift]),
        1e-5,
        np.array([resolved]),
        np.array([growth]),
        25.0,
    )[0]
    order = [
        (not finite, "not_finite"), (drift > 1e-5, "drift_exceeded"),
        (not resolved, "under_resolved"), (growth > 25.0, "roundoff_decided"), (True, "ok"),
    ]  # fmt: skip
    assert list(Status.meanings())[result] == next(name for applies, name in order if applies)


def test_status_at_its_limits():
    """A drift equal to the tolerance is within it; growth counts above its limit, whatever its sign, but not none."""
    yes = np.ones(5, bool)
    drift, growth = np.array([1e-5, 0, 0, 0, 0]), np.array([0.0, 0.5, 0.0, 0.5, 0.5])
    result = pipeline.label_status(yes, drift, 1e-5, yes, growth, np.array([25.0, 0.4, -1.0, 0.5, -1.0]))
    decided = Status.ROUNDOFF_DECIDED
    assert result.tolist() == [Status.OK, decided, Status.OK, Status.OK, decided]


def test_rounding_limit_is_the_growth_that_brings_rounding_errors_to_a_tolerance():
    """Of a rate, relative to the frequency bound, or of the angle: whichever is reached first."""
    residual = np.array([0.0, np.nan, 1e-10, 1e-10])
    bound, tolerances = np.array([2.0, 2.0, 2.0, 1e-3]), Tolerances(1e-5, 1e-3)
    limit = theory.rounding_limit(residual, bound, tolerances.rate, tolerances.angle)
    error = np.array([1e-16, 1e-16, 1e-10, 1e-10]) * np.exp(limit)
    np.testing.assert_allclose(error[:3] * bound[:3], tolerances.rate)
    assert (error[:3] < tolerances.angle).all()
    assert error[3] == pytest.approx(tolerances.angle)
    assert error[3] * bound[3] < tolerances.rate


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


@given(st.floats(1e-6, 1e-1), st.floats(0.1, 100.0), st.floats(1.0, 1e4), st.floats(1e-4, 0.4))
def test_a_run_that_ends_early_has_a_label_beyond_all_expected_errors(tolerance, bound, duration, ratio):
    """At the rate where it ends, less the error that the measurement may have, it still drifts."""
    step = ratio * METHODS["rk4"].stability / bound
    settings = Settings(step=step, rate_tolerance=tolerance, max_steps=10**9)
    sizes = StepSizes.of(settings, np.array([bound]), np.array([duration]))
    with np.errstate(divide="ignore"):
        rate = rates.Rates().early_stop_rate(np.array([bound]), sizes, settings.at(tolerance).tolerances)
    assume(np.isfinite(rate).all())  # no run ends early where the error is as large as the rate
    at_rate = measured(theta_dot_rms=rate) | {"sine_max": np.ones(1)}
    run = SimpleNamespace(step_sizes=sizes, bound=np.array([bound]), measured=at_rate)
    error = rates.Rates().errors(run, np.zeros(1))["theta_dot_rms"]
    assert (error > 0).all()
    assert (rate - error >= tolerance * (1 - 1e-9)).all()


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
