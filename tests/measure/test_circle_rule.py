"""Labels, axes and errors about any axes, by numbers of one circle of the angular velocity; no run."""

from types import SimpleNamespace

import numpy as np
import pytest

from atlas.flags import Label, Status
from atlas.measure import circle as any_axis
from atlas.measure.circle import ANGLES, AXIS_RATES, CIRCLES, Circle, label, values
from atlas.measure.instrument import Rule, RunSettings, Tolerances
from atlas.systems import SYSTEMS

DRIFTING, REGULAR, PERMANENT = Label.DRIFTING, Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
TOLERANCES = Tolerances(0.1, 0.01)
NAME = "label_any_axis"
NAMES = list(Label.meanings())


def one(**numbers):
    return {name: np.array([value]) for name, value in numbers.items()}


def circle_of(**given):
    """Statistics of a circle on which a body spins at 3 and precesses at 2, but for these."""
    exact = {
        "spread": 0.5,
        "height_std": 0.0,
        "radius_std": 0.0,
        "spin_std": 0.0,
        "spin": 3.0,
        "precession": 2.0,
        "sine": 0.4,
    }
    return one(**exact | given)  # fmt: skip


def circle(**changes):
    """A circle on which u turns at 0.3 about its axis, of radius 0.4 and nutation 1, but for the values given."""
    values = {
        "spread": 0.4, "height_std": 0.0, "radius_std": 0.0, "spin_std": 0.0, "spin": 0.3, "precession": 0.4 / np.sin(1.0),
        "sine": np.sin(1.0),
    } | changes  # fmt: skip
    return {name: np.array([value]) for name, value in values.items()}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "regular_precession"),
        ({"spread": 1e-5, "spin_std": np.nan, "spin": np.nan}, "permanent_rotation"),
        ({"spread": 1e-5, "radius_std": 1.0}, "permanent_rotation"),
        ({"spread": 1.1e-5, "radius_std": 1.1e-5}, "drifting"),
        ({"height_std": 1e-5}, "regular_precession"), ({"height_std": 1.1e-5}, "drifting"),
        ({"radius_std": 1e-5}, "regular_precession"), ({"radius_std": 1.1e-5}, "drifting"),
        ({"spin_std": 1e-5}, "regular_precession"), ({"spin_std": 1.1e-5}, "drifting"),
        ({"spin": -1e-5}, "permanent_rotation"), ({"spin": -1.1e-5}, "regular_precession"),
        ({"precession": 1e-5}, "permanent_rotation"), ({"sine": 0.9e-5}, "permanent_rotation"),
        ({"sine": 1e-5}, "regular_precession"),
    ],
)  # fmt: skip
def test_label_at_every_threshold(changes, expected):
    drifting = np.array([Label.DRIFTING], np.int8)
    found = label(circle(**changes), drifting, Tolerances(1e-5, 1e-5))
    assert found.dtype == np.int8
    assert NAMES[found[0]] == expected
    for steady in (Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION):
        own_label = np.array([steady], np.int8)
        assert label(circle(**changes), own_label, Tolerances(1e-5, 1e-5)) == own_label


def test_parallel_axes_excuse_no_variation():
    own = np.array([DRIFTING])
    for given, expected in (
        ({}, PERMANENT),
        ({"radius_std": 0.101}, DRIFTING),
        ({"height_std": 0.101}, DRIFTING),
    ):
        assert label(circle_of(sine=0.0, **given), own, TOLERANCES).tolist() == [expected]
    assert label(circle_of(precession=0.101), own, TOLERANCES).tolist() == [REGULAR]
    assert any_axis.is_steady(np.array([*Label])).tolist() == [each in (REGULAR, PERMANENT) for each in Label]


THIRD = one(
    theta_dot_rms=0.0, psi_dot_std=0.0, phi_dot_std=0.0, normal_rate_std=0.0, psi_dot_mean=2.0, phi_dot_mean=3.0,
    theta_min=1.0, theta_max=1.0, sine_max=np.sin(1.0),
)  # fmt: skip
# z = (0, 0, 1), s leans by 0.5; the body spins at -3 about s and precesses at 2.
LEAN = 0.5
OTHER = circle_of(spin=-3.0, sine=np.sin(LEAN)) | one(
    radius=2 * np.sin(LEAN), height=-3.0 + 2 * np.cos(LEAN), tilt=0.3, precession_inclination=0.7, rotation_inclination=0.9,
    spin_axis_1=0.6, spin_axis_2=0.0, spin_axis_3=0.8, rate_1=0.0, rate_2=-3.0, rate_3=4.0,
)  # fmt: skip


def values_of(own, *, of_circle=OTHER, **third):
    """AXIS_RATES and ANGLES; own: whether the motion is steady about the third axis."""
    measured = THIRD | one(**third) | ({} if own else one(theta_dot_rms=1.0))
    result = values(of_circle, measured, TOLERANCES)
    assert result.keys() == {*AXIS_RATES, *ANGLES}
    return {name: float(value[0]) for name, value in result.items()}


def test_values_of_a_regular_precession_about_the_third_axis():
    found = values_of(True)
    assert found == {
        "precession_rate": 2.0, "spin_rate": 3.0, "nutation": 0.3, "precession_inclination": 0.0,
        "spin_axis_1": 0.0, "spin_axis_2": 0.0, "spin_axis_3": 1.0,
    }  # fmt: skip
    back = values_of(True, psi_dot_mean=-2.0)
    assert (back["precession_rate"], back["precession_inclination"]) == (2.0, np.pi)
    assert back["nutation"] == pytest.approx(np.pi - 0.3)


def test_values_of_a_regular_precession_about_other_axes():
    found = values_of(False)
    assert found["precession_rate"] == 2.0
    assert found["spin_rate"] == -3.0
    assert found["nutation"] == pytest.approx(LEAN)
    assert found["precession_inclination"] == 0.7
    assert [found[f"spin_axis_{i}"] for i in (1, 2, 3)] == [0.6, 0.0, 0.8]


@pytest.mark.parametrize("last", [3, 2, 1])
def test_the_last_component_of_the_spin_axis_is_positive(last):
    """Components up to the tolerance of angles do not count; the spin and the height turn with the axis."""
    axis = (
        np.array([0.5, 0.3, 0.2])
        if last == 3
        else np.array([0.5, 0.3, 0.0])
        if last == 2
        else np.array([0.5, 0.0, 0.0])
    )
    axis[last:] = 0.0099
    turned = {f"spin_axis_{i + 1}": np.array([-x]) for i, x in enumerate(axis)}
    turned |= {"spin": np.array([3.0]), "height": -OTHER["height"]}
    found = values_of(False, of_circle=OTHER | turned)
    assert [found[f"spin_axis_{i}"] for i in (1, 2, 3)] == axis.tolist()
    assert found["spin_rate"] == -3.0
    assert found["nutation"] == pytest.approx(LEAN)


def test_values_of_a_permanent_rotation():
    """About the mean angular velocity (0, -3, 4); a body at rest has no axis, a drifting one nothing."""
    found = values_of(False, of_circle=OTHER | one(spread=0.0))
    assert found == {
        "precession_rate": 0.0, "spin_rate": 5.0, "nutation": 0.0, "precession_inclination": 0.9,
        "spin_axis_1": 0.0, "spin_axis_2": -0.6, "spin_axis_3": 0.8,
    }  # fmt: skip
    rest = OTHER | one(spread=0.0, rate_1=0.0, rate_2=0.06, rate_3=0.08)
    assert {name for name, value in values_of(False, of_circle=rest).items() if np.isnan(value)} == {*ANGLES}
    assert np.isnan([*values_of(False, of_circle=OTHER | one(spin_std=0.2)).values()]).all()


STEPS = SimpleNamespace(
    dispersion_error=np.array([3e-4]), dissipation_error=np.array([2e-4]), rate_error=np.array([0.004]),
    sample_spacing=np.array([1e-6]), whole_steps=np.array([10_000]),
)  # fmt: skip
SETTINGS = RunSettings("rk4", 1e-5, None, 10**6, TOLERANCES, 1e-6, None, "none")
OF_CIRCLE = OTHER | one(extent=0.25, height=-0.5, radius=0.2, spin_std=0.7, height_std=0.3, radius_std=0.1)


def run_of(of_circle=OF_CIRCLE, own=DRIFTING, growth=0.0, name=NAME, **measured):
    """What the instrument reads of a run of one point, whose bound is 4."""
    rules = {"label": Rule(lambda measured: np.array([own]), ())}
    run = SimpleNamespace(
        step_sizes=STEPS, bound=np.array([4.0]), settings=SETTINGS, log_growth=np.array([growth]), rules=rules,
        measured={f"{name}:{key}": value for key, value in of_circle.items()} | one(**measured),
    )  # fmt: skip
    rules |= Circle(name).rules(run, {"label": rules["label"], "label_inertial": rules["label"]})
    return run


AMPLIFIED = (1 + 0.5 / 0.2) * 4 / 0.25  # of errors of rates by the axis of the circle


def test_expected_errors_of_the_circle():
    errors = {name.partition(":")[2]: float(value[0]) for name, value in Circle().errors(run_of(), 0).items()}
    rate, share = 0.004, 5e-4
    spin = rate + 4 * 1e-16 * 100 * AMPLIFIED
    assert errors == pytest.approx(
        {
            "spread": rate + share * 0.5, "height_std": rate + share * 0.3, "radius_std": rate + share * 0.1,
            "spin_std": spin + share * 0.7, "spin": spin, "precession": spin, "sine": spin / 2,
        }, rel=1e-9,
    )  # fmt: skip
    exact = SimpleNamespace(**vars(STEPS) | {"rate_error": np.array([0.0])})
    run = run_of()
    run.step_sizes = exact
    spin = Circle().errors(run, 0)[f"{NAME}:spin"]
    assert spin == pytest.approx(4 * 1e-16 * 100 * AMPLIFIED, rel=1e-12)


def test_rounding_of_a_small_circle_is_that_of_the_components_that_its_axis_mixes():
    sizes = Circle().rounding(run_of(), np.array([1e-14]))
    assert sizes[f"{NAME}:spread"] == sizes[f"{NAME}:height_std"] == 4e-14
    for key in ("radius_std", "spin_std", "spin", "precession"):  # 0.6 x 0.8 twice, over 0.2 / 4
        assert sizes[f"{NAME}:{key}"] == pytest.approx(4e-14 * (1 + 0.96 * 20))


@pytest.mark.parametrize(
    ("of_circle", "own", "growth", "rates", "expected"),
    [
        (OF_CIRCLE, DRIFTING, 0.0, (2.0, 9.0), 0.004 * AMPLIFIED / 2),
        (OF_CIRCLE, DRIFTING, 0.0, (5.0, 9.0), 0.004 * AMPLIFIED / 4),
        (OF_CIRCLE, DRIFTING, 9.0, (2.0, 9.0), 1.0),
        (OF_CIRCLE, DRIFTING, 1.0, (2.0, 9.0), np.e * 0.004 * AMPLIFIED / 2),
        (OF_CIRCLE, REGULAR, 0.0, (2.0, 9.0), 0.0),  # measured about the third axis
        (OF_CIRCLE | one(spread=0.0), DRIFTING, 0.0, (0.0, 0.5), 0.008),
        (OF_CIRCLE | one(spin_std=0.2, spread=0.5, height_std=0.2), DRIFTING, 0.0, (2.0, 0.5), 0.0),
    ],
)
def test_relative_error_of_rates_and_angles(of_circle, own, growth, rates, expected):
    clean = of_circle if of_circle["spin_std"] == 0.2 else of_circle | one(spin_std=0.0, height_std=0.0)
    run = run_of(clean | one(radius_std=0.0), own, growth, precession_rate=rates[0], spin_rate=rates[1])
    assert Circle().relative_error(run) == pytest.approx(expected)
    assert CIRCLES[1].relative_error(run) == 0.0


def test_differences_of_two_runs():
    run, other = (SimpleNamespace(bound=np.array([4.0]), measured=one(**each)) for each in (
        dict.fromkeys((*AXIS_RATES, *ANGLES), 1.0),
        dict.fromkeys((*AXIS_RATES, *ANGLES), 1.0) | {"spin_rate": 1.6, "precession_rate": np.nan, "nutation": 0.9},
    ))  # fmt: skip
    assert Circle().rate_change(run, other) == pytest.approx(0.15)
    assert Circle().pair_error(run, other, None) == pytest.approx(0.15)
    other.measured["nutation"] = np.array([0.8])
    assert Circle().pair_error(run, other, None) == pytest.approx(0.2)
    assert CIRCLES[1].pair_error(run, other, None) == 0.0


def test_the_rule_reads_the_circle_of_its_frame():
    run = run_of(OTHER, name="label_any_axis_inertial")
    rule = run.rules["label_any_axis_inertial"]
    assert rule.label(run.measured) == [REGULAR]
    assert rule.means == {"label_any_axis_inertial:spin": 0.0}
    assert {*rule.statistics} <= run.measured.keys()
    assert run_of(OTHER, own=PERMANENT).rules[NAME].label(run_of(OTHER).measured) == [PERMANENT]


def test_who_wants_a_circle():
    satellite, top = SYSTEMS["satellite"], SYSTEMS["fixed_point"]
    own, inertial = CIRCLES
    assert own.wanted(top, ["nutation"])
    assert own.wanted(satellite, ["label_any_axis_inertial"])
    assert inertial.wanted(satellite, ["label_any_axis_inertial"])
    assert not inertial.wanted(satellite, ["label_any_axis"])
    assert not inertial.wanted(top, ["label_any_axis_inertial"])
    assert not own.wanted(satellite, ["label", "psi_dot_mean"])


def test_columns_are_those_of_labelled_points():
    columns = {name: np.array([1.0, 2.0]) for name in (*AXIS_RATES, *ANGLES)}
    columns["status"] = np.array([Status.STEP_SENSITIVE, Status.OK])
    own = Circle().columns(None, columns)
    assert own.keys() == {*AXIS_RATES, *ANGLES}
    assert all(np.isnan(value[0]) and value[1] == 2.0 for value in own.values())
    assert CIRCLES[1].columns(None, columns) == {}
