"""Labels about the third axis and the vertical, and the errors of rates, by numbers of one point; no run."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from atlas.flags import Label, Status
from atlas.kernel.statistics import Row
from atlas.kernel.stepsize import INTERPOLATION_ERROR, StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.measure.instrument import RunSettings, Tolerances
from atlas.measure.rates import (
    Rates,
    geometry,
    in_cylinder,
    label,
    relative_error,
    rounding_error,
    rule,
    state_distance,
    steady_label,
    tolerated_error,
)
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS

DRIFTING, REGULAR, PERMANENT = Label.DRIFTING, Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
RATE, ANGLE = 0.1, 0.01
TOLERANCES, SMALL = Tolerances(RATE, ANGLE), Tolerances(1e-5, 1e-5)
NAMES = list(Label.meanings())


def steady(**changes):
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
    result = label(steady(**changes), SMALL)
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
    assert NAMES[label(steady(**changes), SMALL)[0]] == expected


def test_inertial_label_adds_the_rate_of_the_frame():
    still = steady(psi_dot_mean=0.0)
    assert NAMES[label(still, SMALL)[0]] == "permanent_rotation"
    assert NAMES[label(still, SMALL, 1.0)[0]] == "regular_precession"
    assert NAMES[label(steady(psi_dot_mean=-1.0), SMALL, 1.0)[0]] == "permanent_rotation"


def measured(**changes):
    """Statistics of one point that precesses at psi' = 2 and phi' = 3 with theta from 1 to 1.005, but for these."""
    zero = ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std")
    values = dict.fromkeys(zero, 0.0) | {"psi_dot_mean": 2.0, "phi_dot_mean": 3.0, "outside": 1.0}
    values |= {"theta_min": 1.0, "theta_max": 1.005} | changes
    both = values["theta_min"] <= np.pi / 2 <= values["theta_max"]
    sine = 1.0 if both else max(np.sin(values["theta_min"]), np.sin(values["theta_max"]))
    return {name: np.array([value]) for name, value in ({"sine_max": sine} | values).items()}


VARIES = {"psi_dot_std": 5.0, "phi_dot_std": 5.0, "theta_dot_rms": 5.0}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"psi_dot_mean": -0.1}, PERMANENT),
        ({"psi_dot_mean": -0.101}, REGULAR),
        ({"phi_dot_mean": -0.1}, PERMANENT),
        # Beside the vertical theta decides, and the rate about the vertical.
        ({"theta_min": 0.005, "theta_max": 0.011}, REGULAR),
        ({"theta_min": 0.005, "theta_max": 0.0151}, DRIFTING),
        ({"theta_min": 0.0101, "theta_max": 0.5}, REGULAR),
        ({"theta_min": 0.005, "theta_max": 0.011, "normal_rate_std": 0.101}, DRIFTING),
        ({"theta_min": 1.0, "theta_max": np.pi - 0.0099}, DRIFTING),
        ({"theta_min": np.pi - 0.011, "theta_max": np.pi - 0.005, "normal_rate_std": 0.101}, DRIFTING),
        # Inside the cylinder only the rate about the vertical counts.
        ({"theta_min": 0.001, "theta_max": 0.0099} | VARIES, PERMANENT),
        ({"theta_min": np.pi - 0.0099, "theta_max": np.pi - 0.001} | VARIES, PERMANENT),
        # At most of the nodes, where theta hardly changes.
        ({"theta_min": 0.008, "theta_max": 0.012, "outside": 0.5} | VARIES, PERMANENT),
        ({"theta_min": 0.008, "theta_max": 0.012, "outside": 0.51} | VARIES, DRIFTING),
        ({"theta_min": 0.008, "theta_max": 0.0181, "outside": 0.5} | VARIES, DRIFTING),
        ({"theta_min": 0.0101, "theta_max": 0.012, "outside": 0.5} | VARIES, DRIFTING),
    ],
)
def test_label_beside_the_vertical(changes, expected):
    assert label(measured(**changes), TOLERANCES) == [expected]
    assert rule(TOLERANCES).label(measured(**changes)) == [expected]
    each = Tolerances(np.array([RATE]), ANGLE)
    assert label(measured(**changes), each) == [expected]


@pytest.mark.parametrize(
    ("psi_dot", "frame_rate", "expected"),
    [(-2.0, 2.0, PERMANENT), (-2.0, 1.8, REGULAR), (0.06, 0.05, REGULAR), (0.06, -0.05, PERMANENT)],
)
def test_the_rate_of_the_frame_is_added(psi_dot, frame_rate, expected):
    values = measured(psi_dot_mean=psi_dot)
    assert label(values, TOLERANCES, frame_rate) == [expected]
    of_frame = rule(TOLERANCES, np.array([frame_rate]))
    assert of_frame.label(values) == [expected]
    assert of_frame.means == {"psi_dot_mean": frame_rate, "phi_dot_mean": 0.0}
    assert {"outside", "psi_dot_mean", "sine_max"} <= {*of_frame.statistics} <= values.keys()


def test_where_a_label_changes_the_cylinder_does():
    """Without the share of nodes outside, an axis counts as vertical by the largest sine alone."""
    inside, rim = measured(theta_min=0.001, theta_max=0.0099), measured(theta_min=0.008, theta_max=0.012)
    del rim["outside"]
    assert in_cylinder(inside, ANGLE)
    assert not in_cylinder(rim, ANGLE)
    assert in_cylinder(rim | {"outside": np.array([0.2])}, ANGLE)
    assert not in_cylinder(measured(sine_max=ANGLE), ANGLE)


def test_steady_label():
    n, m = np.array([1.0, 0.1, 1.0, -1.0, 0.0]), np.array([1.0, 1.0, -0.1, -1.0, 0.0])
    free, vertical = np.zeros(5, bool), np.ones(5, bool)
    kinds = [REGULAR, PERMANENT, PERMANENT, REGULAR, PERMANENT]
    assert steady_label(n, m, free, RATE).tolist() == kinds
    assert steady_label(n, m, vertical, RATE).tolist() == 5 * [PERMANENT]
    drifts = np.array([True, False, False, False, True])
    expected = [DRIFTING, *kinds[1:4], DRIFTING]
    assert steady_label(n, m, free, RATE, drifts).tolist() == expected


def test_geometries_of_steady_motions_alone():
    system = SYSTEMS["satellite"]
    values = {name: np.array([0.0, 0.0]) for name in (*measured(), "axis_1", "axis_2")}
    vertical, tolerances = np.array([True, True]), TOLERANCES
    flags = geometry(system, values, np.array([True, False]), vertical, tolerances)
    kinds = [k.holds(values, vertical, RATE, ANGLE)[0] for k in system.geometries.values()]
    assert flags.tolist() == [1 + kinds.index(True), 0]


# A run of one point whose numbers have simple powers: bound 2, nodes 0.5 apart, so that the angle between two nodes is 1.
STEPS = SimpleNamespace(
    dispersion_error=np.array([3e-4]), dissipation_error=np.array([2e-4]), rate_error=np.array([0.004]), step_ratio=np.array([0.1]),
    sample_spacing=np.array([0.5]), whole_steps=np.array([10_000]), steps=np.array([200]), intervals=np.array([100]),
)  # fmt: skip
SETTINGS = RunSettings("rk4", 1e-5, None, 10**6, TOLERANCES, 1e-6, None, "none")
ROUNDING = 1e-16


def run_of(values, *, log_growth=0.0, outside=100.0, first_theta=1.0, u=3.0, steps=STEPS, duration=8.0):
    """What the errors of rates read of a run of one point, with these measurements."""
    sums = np.zeros((len(Row), 1))
    sums[Row.OUTSIDE], sums[Row.FIRST_THETA] = outside, first_theta
    return SimpleNamespace(
        step_sizes=steps, bound=np.array([2.0]), settings=SETTINGS, measured=values, log_growth=np.array([log_growth]),
        system=SimpleNamespace(
            equations=SimpleNamespace(frame_motion=lambda state, constants: (u, 4.0, 0, 0, 0, 1), STATE=("x", "w")),
            rate_states=("w",),
        ),
        ensemble=SimpleNamespace(state=None, constants=None),
        integration=SimpleNamespace(
            sums=sums, intervals=np.array([100]), duration=np.array([duration]), finite=np.array([True]),
            final_state=np.array([[1.0], [5.0]]),
        ),
    )  # fmt: skip


def test_expected_errors_of_the_statistics():
    values = measured(theta_min=0.5, theta_max=0.7, theta_dot_rms=0.2, psi_dot_std=0.3, phi_dot_std=0.5)
    share = 5e-4 + INTERPOLATION_ERROR
    assert relative_error(STEPS, np.array([2.0])) == pytest.approx(share, rel=1e-12)
    errors = Rates().errors(run_of(values), np.zeros(1))
    assert errors["theta_dot_rms"] == pytest.approx(0.004 + share * 0.2, rel=1e-12)
    assert errors["psi_dot_std"] == pytest.approx(0.004 + share * 0.3, rel=1e-12)
    assert errors["phi_dot_std"] == pytest.approx(0.004 + share * 0.5, rel=1e-12)
    assert errors["psi_dot_mean"] == pytest.approx(0.004, rel=1e-9)
    angle = 0.2 * share + np.sin(0.7) * 0.002
    assert errors["theta_min"] == errors["theta_max"] == errors["sine_max"] == pytest.approx(angle)
    assert errors["outside"] == 0.0
    # Of the share of the nodes outside the cylinder: two nodes of 100, or one of each oscillation.
    partly = run_of(measured(theta_min=0.5, theta_max=0.7, outside=0.3))
    oscillations = 2.0 * STEPS.sample_spacing[0] / (2.0 * np.pi)
    assert Rates().errors(partly, np.zeros(1))["outside"] == pytest.approx(oscillations, rel=1e-15)
    partly.bound = np.array([0.2])
    assert Rates().errors(partly, np.zeros(1))["outside"] == 0.02
    # Rounding counts more beside the vertical: 2 times 1e-16 times 100 over the sine.
    beside = measured(theta_min=1e-9, theta_max=0.7)
    assert Rates().errors(run_of(beside), np.zeros(1))["psi_dot_mean"] == pytest.approx(0.004 + 2e-5)
    rest = run_of(values)
    rest.bound = np.array([0.0])
    with np.errstate(divide="ignore"):
        assert Rates().errors(rest, np.zeros(1))["sine_max"] == pytest.approx(0.2 * 5e-4)


def test_errors_of_exact_steps_are_those_of_rounding():
    none = dict.fromkeys(
        ("dispersion_error", "dissipation_error", "rate_error", "sample_spacing"), np.zeros(1)
    )
    exact, bound = SimpleNamespace(**vars(STEPS) | none), np.array([2.0])
    run = run_of(measured(theta_min=0.5, theta_max=0.7), outside=0.0, steps=exact)
    assert Rates().relative_error(run) == pytest.approx(4e-14, abs=0)
    assert tolerated_error(SimpleNamespace(step=0.1), exact, bound) == pytest.approx(4e-14, abs=0)
    assert Rates().errors(run, np.zeros(1))["psi_dot_mean"] == pytest.approx(2e-14 / np.sin(0.5), abs=0)
    dissipates = SimpleNamespace(**vars(exact) | {"dissipation_error": np.array([7e-4])})
    assert Rates().relative_error(run_of(run.measured, outside=0.0, steps=dissipates)) == pytest.approx(7e-4)


def test_rounding_of_rates_divides_by_the_sine_outside_the_cylinder():
    relative = np.array([1e-14])
    for theta, sine in ((0.5, np.sin(0.5)), (1e-9, ANGLE)):
        sizes = Rates().rounding(run_of(measured(theta_min=theta, theta_max=0.7)), relative)
        assert sizes["theta_dot_rms"] == sizes["normal_rate_std"] == 2e-14
        assert sizes["sine_max"] == 1e-14
        for name in ("psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"):
            assert sizes[name] == pytest.approx(2e-14 / sine)


ANGLES = 3e-4 + 4 * ROUNDING * 100 + INTERPOLATION_ERROR  # of a state and the interpolation of angles


@pytest.mark.parametrize(
    ("changes", "more", "expected"),
    [
        # psi' grows near the vertical: 2 + 6 spread over the sine; the spread is 0.25.
        ({"theta_min": 0.5, "theta_max": 0.7, "psi_dot_std": 0.2, "phi_dot_std": 0.5}, {}, ANGLES * (1 + 3.5 / np.sin(0.5))),
        ({"theta_min": 0.015, "theta_max": 0.7}, {"outside": 100.0}, 1.0),  # as near as twice the cylinder
        ({"theta_min": 0.021, "theta_max": 0.7}, {}, ANGLES * (1 + 2 / np.sin(0.021))),
        ({"theta_min": 0.001, "theta_max": 0.7, "psi_dot_std": 6.0}, {"outside": 60.0}, 3.0),
        ({"theta_min": 0.5, "theta_max": 0.7}, {"outside": 0.0}, ANGLES),  # none was outside: no psi'
        ({"theta_min": 0.001, "theta_max": 0.005}, {"outside": 60.0}, ANGLES),  # in the cylinder
        # It leaves from within: samples close to the start follow it, from a sine of 0.03 on, but for the turn of a slow axis.
        (
            {"theta_min": 0.001, "theta_max": 0.7, "phi_dot_std": 1.0},
            {"outside": 60.0, "first_theta": 0.001, "u": 3.0},
            ANGLES * (1 + 5 / 0.03) + 0.5 * (0.5 * 4 / 5 / 50) ** 3,
        ),
        # The peak of psi' of an axis that leaves at the bound: pi / 2 over 0.01 x 2 x 0.2, its root.
        ({"theta_min": 0.001, "theta_max": 0.7}, {"outside": 60.0, "duration": 0.2}, np.sqrt(np.pi / 2 / 0.004)),
    ],
)  # fmt: skip
def test_relative_error_beside_the_vertical(changes, more, expected):
    more = {"duration": 1e4} | more  # so long that a peak of psi' is no more than 1
    assert Rates().relative_error(run_of(measured(**changes), **more)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("growth", "factor"), [(-3.0, 1.0), (0.0, 1.0), (2.0, np.exp(2.0)), (800.0, None)])
def test_an_instability_amplifies_errors_to_1_at_most(growth, factor):
    """Outside all runs: the measurements have no psi', so that the error of the angles is left."""
    error = Rates().relative_error(
        run_of(measured(theta_min=0.5, theta_max=0.7), log_growth=growth, outside=0.0)
    )
    states = 3e-4 + 4 * ROUNDING * 100
    assert error - INTERPOLATION_ERROR == pytest.approx(1.0 if factor is None else factor * states, rel=1e-9)


def test_measured_errors_by_a_second_run_with_half_the_steps():
    """States by the order of rk4: a difference over 2^4 - 1; statistics by their differences."""
    values = measured(theta_min=0.5, theta_max=0.7, theta_dot_rms=0.2) | {
        f"{name}_{kind}": np.array([0.0])
        for name in ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
        for kind in ("std", "mean")
    }
    run = run_of(values, outside=0.0)
    half = SimpleNamespace(**vars(STEPS) | {"steps": np.array([100]), "step_ratio": np.array([0.2])})

    def coarse(state=(1.0, 5.0), step_ratio=0.2, **given):
        steps = SimpleNamespace(**vars(half) | {"step_ratio": np.array([step_ratio])})
        other = run_of(values | {k: np.array([v]) for k, v in given.items()}, steps=steps, outside=0.0)
        other.integration.final_state = np.array([[each] for each in state])
        return other

    def error(other, expected=0.0):
        return Rates().pair_error(run, other, np.array([expected]))[0]

    rounding = 4 * ROUNDING * 100
    assert error(coarse()) == pytest.approx(0.3 * (rounding + INTERPOLATION_ERROR))
    assert error(coarse((1.6, 5.0))) == pytest.approx(0.6 / 15)
    assert error(coarse((1.0, 8.0))) == pytest.approx(1.5 / 15)  # angular velocities in units of the bound
    assert error(coarse(theta_dot_rms=0.26)) == pytest.approx(0.03)
    assert error(coarse(theta_max=0.65)) == pytest.approx(0.05)
    assert error(coarse(theta_max=0.65), expected=1.0) == pytest.approx(0.05)
    assert error(coarse(theta_max=0.65, step_ratio=0.5), expected=1.0) == 1.0
    assert Rates().rate_change(run, coarse(theta_dot_rms=0.26, theta_max=0.1)) == pytest.approx(0.03)


def test_distance_of_states_counts_angular_velocities_in_units_of_the_bound():
    system = run_of(measured()).system
    state, other = np.array([[1.0, 1.0], [5.0, 5.0]]), np.array([[1.5, 1.1], [4.0, 6.0]])
    distance = state_distance(system, state, other, np.array([4.0, 2.0]))
    np.testing.assert_allclose(distance, [0.5, 0.5])


def test_tolerated_error_is_the_tolerance_or_what_is_expected():
    expected = 5e-4 + INTERPOLATION_ERROR + rounding_error(STEPS)
    assert rounding_error(STEPS) == pytest.approx(4e-14)
    for step, tolerance, error in ((None, 1e-3, 1e-3), (None, 1e-9, expected), (0.1, 1e-3, expected)):
        settings = SimpleNamespace(step=step, tolerance=tolerance)
        assert tolerated_error(settings, STEPS, np.array([2.0])) == pytest.approx(error)


def test_rate_beyond_which_a_run_may_stop():
    """(tolerance + its error and rounding over the sine of the cylinder) / (1 - relative error)."""
    rate = Rates().early_stop_rate(np.array([2.0]), STEPS, TOLERANCES)
    rounding = 2 * ROUNDING * 100 / ANGLE
    assert rate == pytest.approx((RATE + 0.004 + rounding) / (1 - 5e-4 - INTERPOLATION_ERROR), rel=1e-12)
    coarse = SimpleNamespace(**vars(STEPS) | {"dispersion_error": np.array([2.0])})
    with np.errstate(divide="ignore"):
        assert Rates().early_stop_rate(np.array([2.0]), coarse, TOLERANCES) == np.inf


def test_unsteadiness_is_that_of_the_axis_or_of_the_vertical():
    values = {name: np.array(row) for name, row in {
        "theta_dot_rms": [0.1, 0.4], "psi_dot_std": [0.3, np.nan], "phi_dot_std": [0.2, np.nan], "normal_rate_std": [9.0, 0.7],
    }.items()}  # fmt: skip
    assert Rates().unsteadiness(SYSTEMS["satellite"], values, SETTINGS).tolist() == [0.3, 0.7]


def test_columns_have_no_psi_on_the_vertical():
    values = {name: np.repeat(value, 2) for name, value in measured().items()}
    values["sine_max"][1] = values["theta_min"][1] = values["theta_max"][1] = 0.001
    columns = {
        "status": np.array([Status.OK, Status.OK]), "label": np.array([DRIFTING, PERMANENT]),
        **{f"{name}_{kind}": np.ones(2) for name in ("psi_dot", "phi_dot") for kind in ("mean", "std")},
    }  # fmt: skip
    run = SimpleNamespace(settings=SETTINGS, measured=values, system=SYSTEMS["fixed_point"])
    changed = Rates().columns(run, columns)
    assert changed["geometry"][0] == 0
    assert {name for name in changed if np.isnan(changed[name][1])} == {
        "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"
    }  # fmt: skip
    assert not any(np.isnan(each[0]) for each in changed.values())


@given(st.floats(1e-6, 1e-1), st.floats(0.1, 100.0), st.floats(1.0, 1e4), st.floats(1e-4, 0.4))
def test_a_run_that_ends_early_has_a_label_beyond_all_expected_errors(tolerance, bound, duration, ratio):
    """At the rate where it ends, less the error that the measurement may have, it still drifts."""
    step = ratio * METHODS["rk4"].stability / bound
    settings = Settings(step=step, rate_tolerance=tolerance, max_steps=10**9)
    sizes = StepSizes.of(settings, np.array([bound]), np.array([duration]))
    with np.errstate(divide="ignore"):
        rate = Rates().early_stop_rate(np.array([bound]), sizes, settings.at(tolerance).tolerances)
    assume(np.isfinite(rate).all())  # no run ends early where the error is as large as the rate
    at_rate = steady(theta_dot_rms=rate) | {"sine_max": np.ones(1)}
    run = SimpleNamespace(step_sizes=sizes, bound=np.array([bound]), measured=at_rate)
    error = Rates().errors(run, np.zeros(1))["theta_dot_rms"]
    assert (error > 0).all()
    assert (rate - error >= tolerance * (1 - 1e-9)).all()
