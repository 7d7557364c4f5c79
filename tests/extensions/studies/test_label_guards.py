"""Guards of the labels: a point has a label only where numerical errors cannot change it."""

import numpy as np
import pytest
from family_starts import STARTS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import (
    SATELLITE_SOLVED,
    evaluate,
    fixed_points_on_family,
    random_fixed_points,
    satellite_on_family,
    select,
    symmetric_fixed_points,
)

import atlas
from atlas.flags import Label, Stability, Status
from atlas.kernel.specialization import GENERIC
from atlas.kernel.stepsize import StepSizes
from atlas.kernel.tableaux import METHODS
from atlas.label import pipeline, theory
from atlas.label.theory import predict
from atlas.measure.instrument import could_change
from atlas.measure.rates import Rates, rule
from atlas.scene.model import Settings, Tolerances
from atlas.scene.tables import point_columns
from atlas.systems import SYSTEMS
from atlas.systems.base import families_of
from atlas.systems.steady import growth_about_vertical
from atlas.variables import variables

pytestmark = pytest.mark.usefixtures("whole_kernels")

SATELLITE = SYSTEMS["satellite"]


def unstable_point(**changes):
    """One point exactly on the unstable motion (24) with C/A = 1.2, or with other parameters."""
    values = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3} | changes
    points, _ = point_columns(SATELLITE, values)
    return points | {"k3": SATELLITE.families["perp_velocity"].solve["k3"](points)}


def run(system, points, duration, **options):
    """All variables by name, from the kernel that all tests of this file share."""
    points, size = point_columns(SYSTEMS[system], points)
    return evaluate(SYSTEMS[system], points, points, np.full(size, duration), Settings(**options), threads=1)


def test_unsure_where_the_error_reaches_a_threshold():
    steady = {
        "theta_dot_rms": 0.0, "psi_dot_mean": 0.5, "psi_dot_std": 0.0, "phi_dot_mean": 0.3, "phi_dot_std": 0.0,
        "normal_rate_std": 0.0, "theta_min": 1.0, "theta_max": 1.0, "sine_max": np.sin(1.0),
    }  # fmt: skip
    no_error = dict.fromkeys(steady, 0.0)

    def unsure(error, *frame_rate, **changes):
        measured = {name: np.array([value]) for name, value in (steady | changes).items()}
        errors = {name: np.array([value]) for name, value in (no_error | error).items()}
        return bool(could_change(rule(Tolerances(1e-5, 1e-5), *frame_rate), measured, errors)[0])

    for name in ("theta_dot_rms", "psi_dot_std", "phi_dot_std"):
        assert not unsure({name: 0.9e-5})
        assert unsure({name: 1.1e-5})
        assert unsure({name: 2e-5}, **{name: 2.9e-5})
        assert not unsure({name: 2e-5}, **{name: 3.1e-5})
    for name in ("psi_dot_mean", "phi_dot_mean"):
        assert unsure({name: 2e-6}, **{name: 0.9e-5})
        assert unsure({name: 2e-6}, **{name: -1.1e-5})
        assert not unsure({name: 2e-6}, **{name: -1.3e-5})
    assert unsure(
        {"sine_max": 2e-7}, sine_max=0.99e-5, theta_min=0.99e-5, theta_max=0.99e-5, psi_dot_mean=np.nan
    )
    # an error larger than the mean: zero lies within it
    for name in ("psi_dot_mean", "phi_dot_mean"):
        assert unsure({name: 5e-5}, **{name: 3e-5})
        assert unsure({name: 5e-5}, **{name: -3e-5})
    # the mean in the inertial frame counts
    assert unsure({"psi_dot_mean": 2e-6}, 1.0, psi_dot_mean=-1.0 + 0.9e-5)
    assert not unsure({"psi_dot_mean": 2e-6}, 1.0, psi_dot_mean=-1.0 + 1.3e-5)
    assert not unsure({"psi_dot_mean": 2e-6}, 1.0, psi_dot_mean=0.9e-5)
    # at the edge of the cylinder both ends of theta may lie further out: it then swings by more than the radius
    edge = {"theta_min": 0.9e-5, "theta_max": 1.8e-5, "sine_max": 1.8e-5}
    assert unsure({"theta_min": 6e-7, "theta_max": 6e-7}, **edge)
    assert not unsure({"theta_min": 4e-7, "theta_max": 4e-7}, **edge)
    # all errors at once: outside the cylinder the rate may be a precession, and inside it only a rotation
    edge = {"theta_min": 1.05e-5, "theta_max": 1.05e-5, "sine_max": 1.05e-5}
    assert unsure({"sine_max": 1e-6, "psi_dot_mean": 1e-6}, **edge, psi_dot_mean=0.95e-5)
    # it drifts with the errors added and with them taken away, for different reasons, yet not as measured
    assert unsure({"sine_max": 1e-6, "psi_dot_std": 1e-6}, **edge, normal_rate_std=0.5, psi_dot_std=0.95e-5)


@pytest.mark.long
def test_a_tolerance_between_a_measured_and_the_true_deviation_is_unsure():
    """Free tops that pass close by the vertical, where phi' varies by more than they turn, and its error is larger as well."""
    n, options = np.array([20.0, 30.0, 40.0]), {"cylinder_tolerance": 1e-5, "check_half_step": "none"}
    tops = {"A": 1.0, "B": 1.0, "C": 0.5, "theta0": 1 / n, "n": n, "m": 1 - n * np.cos(1 / n)}
    true = run("fixed_point", tops, 5.0, method="rk8", tolerance=1e-13, **options)["phi_dot_std"]
    measured = run("fixed_point", tops, 5.0, step=0.05, **options)["phi_dot_std"]
    for i, between in enumerate(0.5 * (measured + true)):
        result = run("fixed_point", tops, 5.0, step=0.05, rate_tolerance=between, **options)
        assert result["status"][i] == Status.STEP_SENSITIVE


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("share", [0.2, 0.1, 0.05, 0.02])
def test_an_exact_fast_motion_is_never_labelled_drifting(method, share):
    """Dissipation makes psi' and phi' of a body that turns at 1e4 vary by more than the tolerance."""
    fast = unstable_point(C=0.7, m=1e4)
    step = share * METHODS[method].stability / float(SATELLITE.frequency_bound(fast)[0])
    result = run("satellite", fast, duration=0.1, step=step, method=method)
    assert result["label"][0] in (Label.PERMANENT_ROTATION, Label.UNRESOLVED)


def test_the_automatic_step_resolves_the_rate_tolerance():
    fast = unstable_point(C=0.7, m=1e4)
    for tolerance in (1e-2, 1e-5):
        result = run("satellite", fast, duration=0.1, tolerance=tolerance)
        assert result["label"][0] == Label.PERMANENT_ROTATION
    bound = SATELLITE.frequency_bound(fast)
    settings = Settings(tolerance=1e-2, max_steps=10**9, rate_tolerance=1e-5)
    step_sizes = StepSizes.of(settings, bound, np.array([0.1]))
    assert step_sizes.rate_error[0] < 0.5 * 1e-5


@pytest.mark.long
def test_an_exact_start_that_leaves_is_step_sensitive_before_rounding_is_expected_to_decide(monkeypatch):
    monkeypatch.setattr(theory, "rounding_limit", lambda *_: np.inf)
    results = set()
    for m in np.linspace(29.0, 30.0, 12):  # the last bits decide which of them leave
        for duration in (50.0, 90.0):
            result = run("satellite", unstable_point(m=m), duration=duration, tolerance=1e-2)
            results.add((result["label"][0], result["status"][0]))
    step_sensitive = (Label.UNRESOLVED, Status.STEP_SENSITIVE)
    assert results <= {step_sensitive, (Label.PERMANENT_ROTATION, Status.OK)}
    assert step_sensitive in results
    # a push that is larger than any error leaves because of physics
    unstable = unstable_point(m=30.0)
    pushed = unstable | {"theta0": unstable["theta0"] + 1e-4}
    assert run("satellite", pushed, duration=50.0)["label"][0] == Label.DRIFTING


@pytest.mark.long
def test_growth_hidden_by_dissipation_is_flagged():
    """s < w^6 h^5 / 144: the spin is damped faster than the motion can leave."""
    hidden = unstable_point(m=60.0)
    hidden["theta0"] = hidden["theta0"] + 1e-4
    growth = float(run("satellite", unstable_point(m=60.0), duration=1.0)["growth_rate"][0])
    for step in (0.02, 0.01, 0.005):
        label = run("satellite", hidden, duration=40.0, step=step)["label"][0]
        dissipation = 60.0**6 * step**5 / 144
        if dissipation > growth:
            assert label == Label.UNRESOLVED
        assert label in (Label.DRIFTING, Label.UNRESOLVED)
    assert growth < 60.0**6 * 0.02**5 / 144
    assert run("satellite", hidden, duration=40.0)["label"][0] == Label.DRIFTING


def test_a_point_without_a_frequency_bound_is_unresolved():
    """At rest with a rotor of 1e200: nothing moves, but no bound shows that the step is short enough."""
    result = run("fixed_point", {"l1": 1e200, "theta0": 0.5}, duration=20.0)
    assert (result["label"][0], result["status"][0]) == (Label.UNRESOLVED, Status.UNDER_RESOLVED)
    assert result["step_ratio"][0] == np.inf


@pytest.mark.long
@pytest.mark.parametrize("check_half_step", ["none", "sample", "all"])
def test_half_step_checks_change_no_certain_label(check_half_step):
    points = {"theta0": np.linspace(0.1, 3.0, 200), "m": 0.5}
    unchecked = run("satellite", points, duration=5.0, tolerance=1e-6)
    checked = run("satellite", points, duration=5.0, tolerance=1e-6, check_half_step=check_half_step)
    np.testing.assert_array_equal(unchecked["label"], checked["label"])


def test_no_status_depends_on_the_points_whose_error_is_measured(monkeypatch):
    """Were all measured differences as large as a rate, they would decide where every point is measured, and not in a sample."""
    names = ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "psi_dot_mean", "phi_dot_mean", "normal_rate_std")
    angles = dict.fromkeys(("theta_min", "theta_max", "sine_max"), np.zeros(1))
    large = dict.fromkeys(names, np.full(1, 1e3)) | angles
    points = {"theta0": np.linspace(0.2, 2.9, 90), "m": 0.7, "psi0": 0.4}
    monkeypatch.setattr(Rates, "differences", lambda *_: large)
    monkeypatch.setattr(pipeline, "POINTS_PER_HALF_STEP", 3)
    results = {
        which: run("satellite", points, duration=8.0, tolerance=1e-6, check_half_step=which)
        for which in ("none", "sample", "all")
    }
    np.testing.assert_array_equal(results["sample"]["status"], results["none"]["status"])
    np.testing.assert_array_equal(results["sample"]["label"], results["none"]["label"])
    measured = results["sample"]["error_estimate"] != results["none"]["error_estimate"]
    assert 10 < measured.sum() < 80
    assert (results["all"]["status"] == Status.STEP_SENSITIVE).all()


@pytest.mark.parametrize("check_half_step", ["none", "all"])
@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_where_nothing_moves_the_error_is_finite(system, check_half_step):
    points = {"theta0": np.linspace(0.1, 3.0, 7)} | ({"Omega": 0.0} if system == "satellite" else {})
    for method in METHODS:
        result = run(system, points, duration=3.0, method=method, check_half_step=check_half_step)
        assert (result["status"] == Status.OK).all()
        assert (result["error_estimate"] < 1e-12).all()


def test_half_step_option_is_checked(scene_text):
    with pytest.raises(
        atlas.BadInput, match=r"check_half_step = 'some': did you mean 'sample'\? allowed: none, sample, all"
    ):
        atlas.label_points("satellite", {}, check_half_step="some")
    with pytest.raises(atlas.BadInput, match="check_half_step"):
        atlas.load_scene(scene_text({"integration.check_half_step": 1}))
    scene = atlas.load_scene(scene_text({"integration.check_half_step": "all"}))
    assert scene.settings.check_half_step == "all"
    assert atlas.load_scene(scene.toml()).settings.check_half_step == "all"


def test_labels_alone_are_those_of_whole_runs_at_coarse_steps():
    columns = {"theta0": np.linspace(0.9, 1.1, 96), "psi0": np.pi / 2, "C": 1.2, "m": 30.0}
    points, size = point_columns(SATELLITE, columns)
    points["k3"] = SATELLITE.families["perp_velocity"].solve["k3"](points)
    exact = np.arange(size) % 3 == 0
    points["theta0"] = points["theta0"] + np.where(~exact, 10.0 ** -(np.arange(size) % 12), 0.0)
    for step in (0.02, 0.01, 0.003):
        whole, alone = (
            evaluate(
                SATELLITE, points, points, np.full(size, 50.0), Settings(step=step), specialization=GENERIC, outputs=outputs
            )
            for outputs in (None, ("label", "status"))
        )  # fmt: skip
        # a run that ends early has no time for its first integrals to drift
        drifted = whole["status"] == Status.DRIFT_EXCEEDED
        assert ((whole["status"] == alone["status"]) | drifted).all()
        assert ((whole["label"] == alone["label"]) | drifted).all()
        assert (alone["label"][exact] != Label.DRIFTING).all()


# Starts that rounding decides.

PERIODIC = ("cylindrical", "transverse_magnet", "despun_transverse", "asymmetric_tilt", "other_axis")


def satellites_on_families(rng, count, families=tuple(SATELLITE_SOLVED), slower=1.0):
    """Random satellites on the families in turn, as one set of points."""
    points = []
    while len(points) < count:
        point = satellite_on_family(families[len(points) % len(families)], rng, slower)
        if point is not None:
            points.append(point)
    return {name: np.concatenate([point[name] for point in points]) for name in points[0]}


def fixed_points_on_families(rng, count):
    """Random gyrostats on the four families, as one set of points."""
    still = {"theta_dot0": 0.0}
    weightless = dict.fromkeys(("Mg", "N", "n", "l1", "l2"), 0.0)
    parts = [
        fixed_points_on_family("conical", symmetric_fixed_points(rng, count), "l3"),
        fixed_points_on_family("staude", random_fixed_points(rng, count, m=0.0, **still), "l1", "l2"),
        fixed_points_on_family(
            "sleeping", random_fixed_points(rng, count, n=0.0, **still), "theta0", "l1", "l2"
        ),
        random_fixed_points(rng, count, **weightless, **still),
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def in_other_units(name, points, rate):
    """The same points in a unit of time in which every rate is `rate` times as large."""
    powers = {
        "satellite": {1: ("Omega", "n", "m", "theta_dot0", "k1", "k2", "k3"), 2: ("h1", "h3")},
        "fixed_point": {1: ("n", "m", "theta_dot0", "l1", "l2", "l3", "p0", "q0", "r0"), 2: ("Mg", "N")},
    }[name]
    scaled = {key: points[key] * rate**power for power, keys in powers.items() for key in keys}
    return points | scaled


def unstable(system, points):
    """The unstable ones of the points that do not grow too slowly for a short run, and their growth rates."""
    stable, growth = system.linear_stability(points, system.identify_family(points)[0])
    chosen = (stable == Stability.UNSTABLE) & (growth > 0.02 * system.frequency_bound(points))
    return select(points, chosen), growth[chosen]


@pytest.mark.usual("1.0")
@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    ("name", "draw"), [("satellite", satellites_on_families), ("fixed_point", fixed_points_on_families)]
)
def test_an_exact_start_never_drifts_in_any_unit_of_time(name, draw, rate):
    rng, system = np.random.default_rng(8), SYSTEMS[name]
    points, growth = unstable(system, in_other_units(name, draw(rng, 120), rate))
    assert growth.size > 30
    log_growth = rng.uniform(15.0, 45.0, growth.size)
    result = evaluate(system, points, points, log_growth / growth, Settings(method="rk8"))
    assert (result["label"] != Label.DRIFTING).all()
    decided = result["status"] == Status.ROUNDOFF_DECIDED
    on_vertical = np.sin(points["theta0"]) == 0.0
    assert decided[(log_growth > np.log(1e11)) & ~on_vertical].all()
    assert not decided[log_growth < 0.5 * np.log(1e11)].any()


@pytest.mark.usual("1.0")
@pytest.mark.parametrize("slower", [1.0, 0.1, 0.01])
def test_exact_starts_with_a_periodic_linear_system_never_drift(slower):
    points = satellites_on_families(np.random.default_rng(9), 100, PERIODIC, slower)
    result = evaluate(SATELLITE, points, points, np.full(100, 100.0), Settings(method="rk8"))
    assert (result["label"] != Label.DRIFTING).all()
    unknown = (result["stable"] == Stability.UNKNOWN).sum()
    assert unknown <= {1.0: 0, 0.1: 2, 0.01: 15}[slower]


# Angles of which each family's motions are free, so that nudging them leads to another motion of the family.
FREE_ANGLES = {
    "satellite": {
        "perp_radius": ("phi0",),
        "perp_velocity": ("phi0",),
        "oblique": ("phi0",),
        "other_axis": ("psi0",),
    },
    "fixed_point": {
        "conical": ("psi0", "phi0"),
        "sleeping": ("psi0",),
        "staude": ("psi0",),
        "rest": ("psi0",),
    },
}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "draw"), [("satellite", satellites_on_families), ("fixed_point", fixed_points_on_families)]
)
def test_a_nudge_along_the_family_is_no_push(name, draw):
    system = SYSTEMS[name]
    flags = {families_of(system)[family].flag: angles for family, angles in FREE_ANGLES[name].items()}
    points, growth = unstable(system, draw(np.random.default_rng(10), 200))
    family = system.identify_family(points)[0]
    chosen = np.isin(family, list(flags))
    points, growth, family = select(points, chosen), growth[chosen], family[chosen]
    assert growth.size > 20
    nudged = dict(points)
    for flag, angles in flags.items():
        for angle in angles:
            nudged[angle] = nudged[angle] + np.where(family == flag, 1e-4, 0.0)
    tolerances = {"rate_tolerance": 1e-3, "cylinder_tolerance": 1e-3}
    for log_growth in (5.0, 60.0):
        result = evaluate(system, points, nudged, log_growth / growth, Settings(**tolerances), nudged=True)
        exact = evaluate(system, points, points, log_growth / growth, Settings(**tolerances))
        np.testing.assert_array_equal(result["predicted"], exact["predicted"])
        np.testing.assert_array_equal(result["status"], exact["status"])
        np.testing.assert_array_equal(result["label"], exact["label"])
    assert (result["status"] == Status.ROUNDOFF_DECIDED).sum() > 0.9 * growth.size
    # across the family
    pushed = points | {"theta_dot0": points["theta_dot0"] + 1e-4}
    result = evaluate(system, points, pushed, 30 / growth, Settings(**tolerances), nudged=True)
    assert (result["predicted"] == Label.DRIFTING).all()
    assert (result["status"] != Status.ROUNDOFF_DECIDED).all()


def test_a_free_body_about_its_middle_axis_is_not_pushed_by_a_nudge_of_the_vertical():
    points, _ = point_columns(SYSTEMS["fixed_point"], {"A": 1.0, "B": 1.8, "C": 1.4, "m": 1.0})
    nudged = points | {"theta0": points["theta0"] + 1e-4, "psi0": points["psi0"] + 1e-4}
    settings = Settings(rate_tolerance=1e-3)
    for duration, status in ((20.0, Status.OK), (200.0, Status.ROUNDOFF_DECIDED)):
        result = evaluate(SYSTEMS["fixed_point"], points, nudged, np.array([duration]), settings, nudged=True)
        assert result["predicted"][0] == Label.PERMANENT_ROTATION
        assert result["status"][0] == status


def test_the_pitch_about_the_normal_leaves_as_its_exact_motion_does():
    """B = 1: psi'' = g^2 sin psi cos psi of the unstable pitch, psi = offset cosh(g t) while it is small."""
    rng, size = np.random.default_rng(6), 160
    A, C, log_growth = rng.uniform(1.02, 1.6, size), rng.uniform(0.7, 1.5, size), rng.uniform(18, 26, size)
    growth, offset = np.sqrt(3 * (A - 1) / C), 10 ** rng.uniform(-16, -10.5, size)
    theta0 = np.where(np.arange(size) % 2 == 0, 0.0, np.pi)
    points, _ = point_columns(SATELLITE, {"A": A, "B": 1.0, "C": C, "psi0": offset, "theta0": theta0})
    np.testing.assert_allclose(growth_about_vertical(SATELLITE, points), growth, rtol=1e-6)
    result = evaluate(SATELLITE, points, points, log_growth / growth, Settings(method="rk8"))
    t = np.linspace(0, log_growth / growth, 4001)
    spread = np.std(offset * growth * np.sinh(growth * t), axis=0)
    clear = (result["status"] == Status.OK) & (np.abs(np.log(spread / 1e-5)) > 0.1)
    assert clear.sum() > 40
    expected = np.where(spread > 1e-5, Label.DRIFTING, Label.PERMANENT_ROTATION)
    np.testing.assert_array_equal(result["label"][clear], expected[clear])
    assert set(expected[clear]) == {Label.DRIFTING, Label.PERMANENT_ROTATION}
    # The largest of 8000 such offsets that rounding decides is 3.7e-12.
    assert ((result["status"] == Status.ROUNDOFF_DECIDED) <= (offset < 1e-11)).all()


def test_an_exact_sleeping_start_cannot_tilt():
    """The third axis stays on the vertical to the bit, and nothing accelerates the rotation about it."""
    result = run("fixed_point", {"Mg": 1.0, "z0": -1.0, "m": 0.1}, duration=200.0)
    assert result["growth_rate"][0] * 200 > 100
    assert (result["label"][0], result["status"][0]) == (Label.PERMANENT_ROTATION, Status.OK)
    # the pitch is stable, roll and yaw are not
    result = run("satellite", {"A": 1.0, "B": 1.2, "C": 0.5}, duration=200.0)
    assert result["growth_rate"][0] * 200 > 50
    assert (result["label"][0], result["status"][0]) == (Label.PERMANENT_ROTATION, Status.OK)
    # the pitch is not
    result = run("satellite", {"A": 1.2, "B": 1.0, "C": 0.9}, duration=200.0)
    assert result["status"][0] == Status.ROUNDOFF_DECIDED


@pytest.mark.long
@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
@given(exponent=st.floats(-17, -10), n=st.floats(-2, 2), m=st.floats(-2, 2), upside_down=st.booleans())
@settings(max_examples=40)
def test_whatever_counts_as_upright_is_predicted_to_rotate_about_the_vertical(
    name, exponent, n, m, upside_down
):
    tilt = 10.0**exponent
    upright = {"theta0": np.pi - tilt if upside_down else tilt, "n": n, "m": m}
    points, _ = point_columns(SYSTEMS[name], upright | ({"l3": 6.0} if name == "fixed_point" else {}))
    flag = SYSTEMS[name].identify_family(points)[0]
    predicted = predict(SYSTEMS[name], points, Tolerances(1e-5, 1e-5))
    upright_flags = [family.flag for family in families_of(SYSTEMS[name]).values() if family.axes is None]
    if flag[0] in upright_flags:
        assert predicted["predicted"][0] == Label.PERMANENT_ROTATION


# Any parameters at all.

NUMBERS = st.one_of(
    st.sampled_from(
        [0.0, -0.0, 5e-324, -1e-310, 1e-300, 1e-160, 1e-12, 1.0, -1.0, 1e12, 1e160, -1e300, 1.7e308]
    ),
    st.floats(-10, 10),
    st.floats(allow_nan=False, allow_infinity=False),
)
# Variables that may be nan: in the polar cap, or where theory gives no value.
NAN_IN_POLAR_CAP = {"psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"}
NAN_IN_THEORY = {"growth_rate", "condition_residual"}


def any_points(system: str):
    """Columns of four points with every parameter in its whole range."""
    columns = {}
    for name, parameter in SYSTEMS[system].parameters.items():
        if not np.isnan(parameter.default):
            number = NUMBERS
            if parameter.low == 0:
                number = NUMBERS.map(lambda v: abs(v) or 1.0) if parameter.open_low else NUMBERS.map(abs)
            columns[name] = st.one_of(
                st.just([parameter.default] * 4), st.lists(number, min_size=4, max_size=4)
            )
    return st.fixed_dictionaries(columns)


def check_results(name, columns, method):
    """No exception, no variable that is not finite at an ok point, no label without status ok."""
    system = SYSTEMS[name]
    points, size = point_columns(system, columns)
    options = Settings(method=method, max_steps=400)
    result = evaluate(system, points, points, np.full(size, 3.0), options, threads=1)
    ok = result["status"] == Status.OK
    in_polar_cap = result["sine_max"] < 1e-5
    for variable, description in variables(system).items():
        if description.dtype == "float64" and variable in result and variable not in NAN_IN_THEORY:
            allowed = in_polar_cap & (variable in NAN_IN_POLAR_CAP)
            wrong = ok & ~np.isfinite(result[variable]) & ~allowed
            assert not wrong.any(), (variable, {k: v[wrong] for k, v in points.items()})
    assert ((result["label"] != Label.UNRESOLVED) == ok).all()
    assert (result["step_ratio"][ok] <= 0.5).all()
    assert (result["integral_drift"][ok] <= 1e-5).all()


@pytest.mark.long
@given(any_points("satellite"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"k1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
@example({"Omega": [0.0, 4.6e-254, 5e-324, 1e-160], "theta0": [0, 1.0, 1.0, 1.0]}, "rk8")
@example({"Omega": [0.0, 0.0, 1e-110, 5e-324], "theta0": [0.7, 2.0, 0.7, 1.0]}, "rk4")
@example({"B": [1.0, 5e-324, 1e-300, 1e-100]}, "rk4")  # the matrix of the exponents is not finite
def test_any_satellite(columns, method):
    check_results("satellite", columns, method)


@pytest.mark.long
@given(any_points("fixed_point"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"l1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
def test_any_gyrostat_about_a_fixed_point(columns, method):
    check_results("fixed_point", columns, method)


@pytest.mark.long
@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_nudged_motions_are_as_predicted_for_ten_thousand_time_units(system):
    """The rates that the nudge itself causes are far below the tolerance."""
    rng = np.random.default_rng(4)
    kinds = {"satellite": ("perp_velocity", "oblique"), "fixed_point": ("staude", "rest")}[system]
    draws = [STARTS[system][kind](rng, 4) for kind in kinds]
    base = {name: np.concatenate([draw[name] for draw in draws]) for name in draws[0]}
    points = {
        name: values + (1e-6 if name in ("theta0", "theta_dot0") else 0.0) for name, values in base.items()
    }
    settings = Settings(method="rk8", tolerance=1e-5, rate_tolerance=1e-3)
    result = evaluate(SYSTEMS[system], base, points, np.full(len(points["A"]), 1e4), settings, nudged=True)
    assert (result["status"] == Status.OK).all()
    np.testing.assert_array_equal(result["label"], result["predicted"])
    assert {Stability.STABLE, Stability.UNSTABLE} == set(result["stable"])
