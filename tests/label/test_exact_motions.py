"""What theory says of exact motions and of runs: against samples of the motions by rotation matrices, and by numbers; no kernel."""

from types import SimpleNamespace

import numpy as np
import pytest
from family_starts import STARTS as STARTS_OF_FAMILIES
from scipy.spatial.transform import Rotation
from strategies import default_points, predictions, random_satellites, tile_of

from atlas.flags import Label, Stability
from atlas.label import theory
from atlas.label.any_axis import _circle, near_circle
from atlas.label.plan import Plan
from atlas.label.theory import Theory, departure_changes, exact_labels, forget_drifting, predict
from atlas.measure.instrument import Tolerances
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.systems.base import TwoAxes

TOP, SATELLITE = SYSTEMS["fixed_point"], SYSTEMS["satellite"]
DRIFTING, REGULAR, PERMANENT = Label.DRIFTING, Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
# Starts, and motions about axes of which none is the third or the vertical; the last passes near the vertical.
STARTS = {"theta0": np.array([0.4, 1.3, 2.6, 0.2]), "phi0": np.array([0.3, -3.0, 2.0, 0.0])}
DURATION = np.array([7.0, 11.0, 3.0, 20.0])
AXES = TwoAxes(
    np.array([[0.6, 0.0, 0.8], [0.1, -0.7, 0.7], [0.0, 0.28, 0.96], [0.0, 0.1, 1.0]]).T, np.array([1.1, -0.7, 2.3, 0.9]),
    np.array([[0.0, 0.6, 0.8], [0.5, 0.5, -0.7], [1.0, 0.1, 0.0], [0.0, -0.1, 1.0]]).T, np.array([0.8, 1.9, -0.6, -1.7]),
)  # fmt: skip
AXES = AXES._replace(**{
    name: getattr(AXES, name) / np.linalg.norm(getattr(AXES, name), axis=0) for name in ("spin_axis", "fixed_axis")
})  # fmt: skip


def motion(i, times):
    """Angular velocity and vertical of motion i in body axes, (times, 3): a turn about the fixed axis follows one of the body."""
    s, m, nu, n = (values[..., i] for values in AXES)
    theta, phi = (STARTS[name][i] for name in ("theta0", "phi0"))
    start = np.array([np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)])
    attitude = Rotation.from_rotvec(np.outer(n * times, nu)) * Rotation.from_rotvec(np.outer(m * times, s))
    return n * attitude.inv().apply(nu) + m * s, attitude.inv().apply(start)


def sampled(i, times):
    """theta, theta', psi', phi' and the rate about the vertical, theta' by differences of theta."""
    u, g = motion(i, times)
    step = 1e-5
    theta = np.arccos(g[:, 2])
    later, earlier = (np.arccos(motion(i, times + sign * step)[1][:, 2]) for sign in (1, -1))
    normal = (u * g).sum(1)
    psi_dot = (normal - u[:, 2] * g[:, 2]) / (1 - g[:, 2] ** 2)
    return theta, (later - earlier) / (2 * step), psi_dot, u[:, 2] - psi_dot * g[:, 2], normal


@pytest.fixture(scope="module")
def statistics():
    return theory._statistics(TOP, default_points("fixed_point", 4, **STARTS), AXES, DURATION, 0.2)


@pytest.mark.parametrize("i", range(4))
def test_statistics_of_exact_motions_at_their_instants(statistics, i):
    """32 multiples of the golden section, modulo 1, and the parts of their spreads that count as errors."""
    measured, error = ({name: float(value[i]) for name, value in each.items()} for each in statistics)
    theta, theta_dot, psi_dot, phi_dot, normal = sampled(
        i, np.modf(np.arange(1, 33) * 0.6180339887498949)[0] * DURATION[i]
    )
    expected = {
        "theta_dot_rms": np.sqrt((theta_dot**2).mean()),
        "theta_min": theta.min(),
        "theta_max": theta.max(),
    }
    expected |= {"sine_max": np.sin(theta).max(), "outside": (np.sin(theta) >= 0.2).mean()}
    spread = {"theta_dot_rms": expected["theta_dot_rms"], "sine_max": np.ptp(np.sin(theta))}
    spread |= dict.fromkeys(("theta_min", "theta_max"), np.ptp(theta))
    spread["outside"] = expected["outside"] * (1 - expected["outside"])
    for name, values in (("psi_dot", psi_dot), ("phi_dot", phi_dot), ("normal_rate", normal)):
        expected |= {f"{name}_mean": values.mean(), f"{name}_std": values.std()}
        spread |= dict.fromkeys((f"{name}_mean", f"{name}_std"), values.std())
    assert measured == pytest.approx(expected, rel=1e-8)
    assert error == pytest.approx({name: 0.5 * value for name, value in spread.items()}, rel=1e-8)


@pytest.mark.parametrize("i", range(4))
def test_statistics_of_exact_motions_are_those_of_the_run_within_their_errors(statistics, i):
    measured, error = ({name: float(value[i]) for name, value in each.items()} for each in statistics)
    theta, theta_dot, psi_dot, phi_dot, normal = sampled(i, np.linspace(0, DURATION[i], 4001))
    fine = {
        "theta_dot_rms": np.sqrt((theta_dot**2).mean()),
        "theta_min": theta.min(),
        "theta_max": theta.max(),
    }
    fine |= {
        "sine_max": np.sin(theta).max(),
        "normal_rate_mean": normal.mean(),
        "normal_rate_std": normal.std(),
    }
    fine |= {
        "psi_dot_mean": psi_dot.mean(),
        "phi_dot_mean": phi_dot.mean(),
        "outside": (np.sin(theta) >= 0.2).mean(),
    }
    fine |= {"psi_dot_std": psi_dot.std(), "phi_dot_std": phi_dot.std()}
    for name, value in fine.items():
        assert abs(measured[name] - value) <= error[name], name


def labels_of(system, points, motion, elsewhere, tolerances, family=0):
    size = points["A"].size
    return exact_labels(
        system, points, np.full(size, family, np.int8), motion, np.full(size, elsewhere), np.full(size, 20.0), tolerances
    )  # fmt: skip


def test_labels_of_exact_motions_about_other_axes():
    """About nearly the third axis or nearly the vertical; what varies by about the tolerance has no label."""
    wide, narrow = 1e-2, 1e-5
    theta = 0.7
    third, vertical = np.array([0.0, 0.0, 1.0]), np.array([0.0, np.sin(theta), np.cos(theta)])
    beside = np.array([0.0, 1e-4, 1.0]) / np.hypot(1, 1e-4)
    axes = TwoAxes(
        np.array([third, beside, third, beside]).T, np.array([3.0, 3.0, 0.0, 3.0]),
        np.array([vertical, vertical, vertical, vertical]).T, np.array([2.0, 2.0, 2.0, 0.0]),
    )  # fmt: skip
    points = default_points("fixed_point", 4, theta0=theta)
    for rate, expected in (
        (wide, [REGULAR, REGULAR, PERMANENT, PERMANENT]),
        (2e-4, [REGULAR, Label.NOT_COMPUTED, PERMANENT, Label.NOT_COMPUTED]),
        (narrow, [REGULAR, DRIFTING, PERMANENT, DRIFTING]),
    ):
        assert labels_of(TOP, points, axes, True, Tolerances(rate, 1e-5))["predicted"].tolist() == expected
        each = Tolerances(np.full(4, rate), 1e-5)
        assert labels_of(TOP, points, axes, True, each)["predicted"].tolist() == expected
    assert labels_of(TOP, points, None, True, Tolerances(wide, 1e-5))["predicted"].tolist() == 4 * [DRIFTING]


def test_labels_of_exact_motions_about_the_third_axis_and_the_vertical():
    """By n and m of the start, in the frame and, with the rate of the orbit 1.5, in space; upright by m + n."""
    points = default_points(
        "satellite", 5, Omega=1.5, theta0=[0.7, 0.7, 0.7, 0.7, 1e-4], n=[2.0, -1.5, 0.0, 2.0, 2.0], m=[3.0, 3.0, 3.0, 0.0, 0.0]
    )  # fmt: skip
    found = labels_of(SATELLITE, points, None, False, Tolerances(1e-3, 1e-3))
    assert found["predicted"].tolist() == [REGULAR, REGULAR, PERMANENT, PERMANENT, PERMANENT]
    assert found["predicted_inertial"].tolist() == [REGULAR, PERMANENT, REGULAR, PERMANENT, PERMANENT]
    assert labels_of(TOP, default_points("fixed_point"), None, False, Tolerances(1e-3, 1e-3)).keys() == {
        "predicted"
    }


def test_predictions_by_families_alone():
    """A top on the cone of its family and one beside it."""
    points = default_points("fixed_point", 2, C=0.7, Mg=1.0, z0=1.0, theta0=0.9, n=1.2, m=[2.0, 2.0])
    points["l3"] = TOP.families["conical"].solve["l3"](points) + np.array([0.0, 0.1])
    for rough in (False, True):
        found = predict(TOP, points, Tolerances(1e-5, 1e-5), rough=rough)
        assert found["family"].tolist() == [TOP.families["conical"].flag, 0]
        assert found["predicted"].tolist() == [REGULAR, Label.NOT_COMPUTED]


@pytest.mark.parametrize("i", range(4))
def test_circles_of_exact_motions(i):
    """In a frame at rest: the deviation of the angular velocity in the body, and its circle."""
    points = default_points("fixed_point", 4, **STARTS)
    found = {name: float(v[i]) for name, v in _circle(TOP, points, AXES, np.zeros(4), DURATION).items()}
    u, _ = motion(i, np.linspace(0, DURATION[i], 20001))
    weight = np.full(20001, 1 / 20000)
    weight[[0, -1]] /= 2
    deviation = np.sqrt((weight @ (u - weight @ u) ** 2).sum())
    s, m, nu, n = (values[..., i] for values in AXES)
    m = float(m)
    assert found == pytest.approx(
        {
            "spread": deviation, "height_std": 0.0, "radius_std": 0.0, "spin_std": 0.0, "spin": m, "precession": abs(n),
            "sine": np.linalg.norm(np.cross(s, nu)),
        }, rel=1e-6,
    )  # fmt: skip


def test_circles_in_a_turning_frame():
    """About the vertical the rates add; a single rotation is about one axis of the body; a third rate leaves no circle."""
    points = default_points("satellite", 5, theta0=0.9)
    vertical, other = np.array([0.0, np.sin(0.9), np.cos(0.9)]), np.array([1.0, 0.0, 0.0])
    lean = np.array([0.6, 0.0, 0.8])
    axes = TwoAxes(
        np.array([lean, lean, lean, lean, lean]).T, np.array([3.0, 3.0, 3.0, 0.0, 3.0]),
        np.array([vertical, other, other, other, vertical]).T, np.array([2.0, 2.0, 0.0, 2.0, -1.5]),
    )  # fmt: skip
    found = _circle(SATELLITE, points, axes, np.full(5, 1.5), np.full(5, 1e9))
    np.testing.assert_allclose(found["precession"], [3.5, np.nan, 1.5, 1.5, 0.0])
    np.testing.assert_allclose(found["spin"], [3.0, np.nan, 3.0, 2.0, 3.0])
    of_vertical, of_other = (np.linalg.norm(np.cross(axis, vertical)) for axis in (lean, other))
    np.testing.assert_allclose(found["sine"][[0, 2, 3, 4]], [of_vertical, of_vertical, of_other, of_vertical])
    np.testing.assert_allclose(found["spread"][[0, 2]], [3.5 * of_vertical, 1.5 * of_vertical], rtol=1e-6)
    at_rest = _circle(SATELLITE, points, axes, np.zeros(5), np.full(5, 1e9))
    np.testing.assert_allclose(at_rest["precession"], [2.0, 2.0, 0.0, 0.0, 1.5])
    np.testing.assert_allclose(at_rest["spin"], [3.0, 3.0, 3.0, 2.0, 3.0])


@pytest.mark.parametrize("inertial", [False, True])
@pytest.mark.parametrize("duration", [50.0, 0.01])
def test_circles_that_a_start_leaves(inertial, duration):
    """By derivatives of the angular velocity from differences, in a radian of the bound at most: ten tolerances decide."""
    points = random_satellites(np.random.default_rng(11), 24)
    bound, state = SATELLITE.frequency_bound(points), SATELLITE.initial_state(points)
    constants, h = SATELLITE.constants(points), 1e-3 / bound
    frame_rate = points["Omega"] * inertial

    def rate(state):
        motion = np.array(SATELLITE.equations.frame_motion(state, constants))
        return motion[:3] + frame_rate * motion[3:]

    def after(state, h):
        def slope(state):
            return np.array(SATELLITE.equations.rhs(state, constants))

        a = slope(state)
        b = slope(state + h / 2 * a)
        c = slope(state + h / 2 * b)
        return state + h / 6 * (a + 2 * b + 2 * c + slope(state + h * c))

    u = [rate(after(state, k * h)) for k in range(-3, 4)]
    v = (-u[0] + 9 * u[1] - 45 * u[2] + 45 * u[4] - 9 * u[5] + u[6]) / (60 * h)
    first = (2 * u[0] - 27 * u[1] + 270 * u[2] - 490 * u[3] + 270 * u[4] - 27 * u[5] + 2 * u[6]) / (
        180 * h**2
    )
    second = (u[0] - 8 * u[1] + 13 * u[2] - 13 * u[4] + 8 * u[5] - u[6]) / (8 * h**3)
    time = np.minimum(1 / bound, duration)
    size, turn = np.linalg.norm(v, axis=0), np.linalg.norm(first, axis=0)
    rest = size * time + turn * time**2 / 2
    speed = np.abs((v * first).sum(0)) / size * time**2 / 2
    bend = np.linalg.norm(second + (turn / size) ** 2 * v, axis=0) * time**3 / 6
    limit = np.minimum(rest, np.maximum(speed, bend)) / 10
    for share, near in ((0.99, False), (1.01, True)):
        found = near_circle(SATELLITE, points, np.full(24, duration), share * limit, frame_rate)
        assert found.tolist() == 24 * [near]


def test_a_nudge_off_a_motion_about_other_axes_is_weighed_by_the_conditions_of_its_family():
    """Grioli's motions, whose conditions an angle of 1e-4 breaks: their own residual counts where labels about any axes do."""
    base = STARTS_OF_FAMILIES["fixed_point"]["grioli"](np.random.default_rng(4), 3)
    size = base["A"].size
    for change in (None, 1e-4):
        points = base | {"B": base["B"] * (1.0 + (change or 0.0))}
        tile = tile_of(TOP, base, points, np.full(size, 20.0), Settings())
        residual = TOP.identify_family(points)[1]
        for outputs, about_other in ((["label_any_axis"], True), (["label"], False)):
            plan = Plan(TOP, Settings(), outputs, nudged=change is not None)
            prediction = theory.predict_runs(plan, tile)
            assert (prediction.about_other_axes == about_other).all()
            assert (prediction.family_residual <= 1e-13).all()
            expected = residual if about_other else prediction.test.residual
            np.testing.assert_array_equal(prediction.start_residual, expected)
            if about_other:
                assert (prediction.pushed == (change is not None)).all()
                assert (prediction.start_residual > 1e-6).all() == (change is not None)


@pytest.mark.parametrize(("rate", "expected"), [(1e-9, Label.NOT_COMPUTED), (1e-5, REGULAR)])
def test_rates_that_rounding_hides_have_no_prediction_about_any_axes(rate, expected):
    """A free top whose precession and spin are 6e4: rounding of their squares, 1e-4, is the change of a rate of 1e-9."""
    spin = 1e5
    points = default_points(
        "fixed_point", 1, A=1.0, B=1.0, C=0.4, Mg=0.0, p0=spin * np.sqrt(0.2), q0=0.0, r0=spin, gamma10=0.0, gamma20=0.6, gamma30=0.8
    )  # fmt: skip
    prediction, labels = predictions(TOP, points, duration=1.0, tolerances=(rate, 1e-5))
    assert prediction.test.elsewhere.tolist() == [True]
    np.testing.assert_allclose(np.abs([prediction.motion.spin_rate, prediction.motion.precession_rate]), 6e4)
    assert labels["predicted_any_axis"].tolist() == [expected]


def theory_of(
    log_growth=0.0, residual=0.0, about_vertical=9.0, rounding_growth=3.0, unknown=False, pushed=False, **more
):
    """Theory of one start."""
    prediction = SimpleNamespace(
        log_growth=np.array([log_growth]), pushed=np.array([pushed]), start_residual=np.array([residual]),
        about_other_axes=np.array([False]),
    )  # fmt: skip
    for name, value in more.items():
        setattr(prediction, name, value)
    return Theory(
        prediction, np.array([rounding_growth]), np.array([about_vertical]), np.array([False]), {}, np.array([unknown])
    )  # fmt: skip


def test_errors_that_an_unstable_motion_amplifies():
    """0.01 times e^3 is 0.2; after a nudge the departure is no error."""
    steps = SimpleNamespace(rate_error=np.array([0.01]))
    for growth, tolerance, pushed, expected in (
        (3.0, 0.19, False, True), (3.0, 0.21, False, False), (3.0, 0.19, True, False), (-3.0, 1e-9, False, False),
        (0.0, 1e-9, False, False),
    ):  # fmt: skip
        settings = SimpleNamespace(rate_tolerance=tolerance)
        assert theory_of(growth, pushed=pushed).error_amplified(steps, settings).tolist() == [expected]


def test_rounding_of_a_run():
    """No tilt grows where the axis never left the vertical; without theory the tilt itself tells."""
    tolerances = Tolerances(1e-4, 1e-3)

    def rounding(sine, **given):
        run = SimpleNamespace(
            ensemble=SimpleNamespace(size=1), measured={"sine_max": np.array([sine])}, bound=np.array([2.0]), settings=SimpleNamespace(tolerances=tolerances)
        )  # fmt: skip
        with np.errstate(divide="ignore"):
            growth, limit = theory_of(**given).rounding(run)
        return growth[0], limit[0]

    assert rounding(0.5) == (3.0, pytest.approx(np.log(5e-5 / 1e-16)))
    assert rounding(0.0)[0] == 3.0
    assert rounding(0.0, about_vertical=1.0)[0] == 1.0
    assert rounding(0.5, about_vertical=1.0)[0] == 3.0
    growth, limit = rounding(0.5, unknown=True, residual=1e-12)
    assert (growth, limit) == (pytest.approx(np.log(0.5 / 1e-12)), pytest.approx(np.log(5e-5 / 1e-12)))
    assert rounding(0.5, unknown=True)[0] == pytest.approx(np.log(0.5 / 1e-16))


def test_motions_that_integration_errors_may_have_carried_away():
    def departed(sine=0.1, label=DRIFTING, other=REGULAR, about_other=False, rate_error=0.01):
        run = SimpleNamespace(
            labels=lambda: {"label": np.array([label]), "label_any_axis": np.array([other])},
            ensemble=SimpleNamespace(size=1), measured={"sine_max": np.array([sine])}, settings=SimpleNamespace(rate_tolerance=0.19),
            step_sizes=SimpleNamespace(rate_error=np.array([rate_error])),
        )  # fmt: skip
        return bool(theory_of(3.0, about_other_axes=np.array([about_other])).departed(run)[0])

    assert departed()
    assert not departed(sine=0.0)
    assert not departed(label=REGULAR)
    assert not departed(rate_error=0.001)
    assert not departed(about_other=True)
    assert departed(about_other=True, label=REGULAR, other=DRIFTING)
    for fine, expected in ((1.04, False), (1.06, True), (0.96, False), (0.94, True)):
        runs = (SimpleNamespace(measured={"theta_dot_rms": np.array([rms])}) for rms in (1.0, fine))
        assert departure_changes(*runs).tolist() == [expected]


def test_drifting_is_unknown_where_volumes_change():
    """Of a damped satellite that may settle, by its state before or after a nudge; not its other labels."""
    points = default_points("satellite", 4, damping=[0.1, 0.1, 0.0, 0.1], m=0.3)
    labels = {
        name: np.array([DRIFTING, REGULAR, DRIFTING, DRIFTING], np.int8)
        for name in ("predicted_any_axis", "label")
    }
    where = np.array([True, True, True, False])
    forget_drifting(SATELLITE, labels, where, SATELLITE.constants(points), SATELLITE.initial_state(points))
    assert labels["predicted_any_axis"].tolist() == [Label.NOT_COMPUTED, REGULAR, DRIFTING, DRIFTING]
    assert labels["label"].tolist() == [DRIFTING, REGULAR, DRIFTING, DRIFTING]


def of_plan(points, nudge=None, step=0.01, transient=0.0, settings=None):
    """Theory of runs of 50 time units by steps of one size; nudge: added to theta0."""
    settings = settings or Settings()
    after = points if nudge is None else points | {"theta0": points["theta0"] + nudge}
    size = points["A"].size
    tile = tile_of(TOP, points, after, np.full(size, 50.0), settings)
    tile = type(tile)(**vars(tile) | {"transient": np.full(size, transient)})
    plan = Plan(TOP, settings, nudged=nudge is not None)
    with np.errstate(all="ignore"):
        return Theory.of(
            plan, tile, SimpleNamespace(size=size), SimpleNamespace(step_size=np.full(size, step))
        )


def test_theory_of_a_sleeping_top_that_falls():
    """Upright with the centre of mass above: A = 1, C = 0.5, weight 1, so that m below 4 is unstable; its growth is known."""
    spins = np.array([0.2, 6.0])
    top = default_points("fixed_point", 2, A=1.0, B=1.0, C=0.5, Mg=1.0, z0=-1.0, m=spins, n=0.0, theta0=0.0)
    rate = np.sqrt(1.0 - (0.5 * 0.2 / 2) ** 2)  # of theta'' = (Mg - (C m / 2)^2) theta
    found = of_plan(top)
    assert found.prediction.variables["stable"].tolist() == [Stability.UNSTABLE, Stability.STABLE]
    assert found.unstable.tolist() == [True, False]
    assert found.rounding_growth[0] == pytest.approx(50 * rate)
    assert found.growth_about_vertical[1] == 0.0
    assert found.frame_rates.keys() == {"label"}
    assert not found.unknown_growth.any()
    assert not found.prediction.may_settle.any()
    nudged = of_plan(top, 1e-4)
    assert nudged.prediction.pushed.all()
    assert not nudged.unstable.any()
    assert (nudged.rounding_growth == 0.0).all()
    assert nudged.prediction.log_growth[0] == pytest.approx(50 * rate)
    assert not of_plan(top, transient=5.0).prediction.may_settle.any()  # exact starts stay
    assert of_plan(top, 1e-4, transient=5.0).prediction.may_settle.all()
    assert of_plan(top, transient=5.0).rounding_growth[0] == pytest.approx(55 * rate)
    # A start beside the motion: rounding decides its growth where a step adds less than a per cent of its own rounding.
    beside = top | {"theta0": np.full(2, 3e-12)}
    assert of_plan(beside).rounding_growth[0] == 0.0
    assert (
        of_plan(beside, step=1e-3).rounding_growth[0]
        == pytest.approx(50 * rate)
        == of_plan(beside).prediction.log_growth[0]
    )
