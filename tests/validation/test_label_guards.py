"""Guards of the labels: a point has a label only where numerical errors cannot change it."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import atlas
from atlas.engine.specialization import GENERIC
from atlas.engine.stepsize import StepSizes
from atlas.engine.tableaux import METHODS
from atlas.flags import Label, Status
from atlas.label import labels
from atlas.label.pipeline import evaluate
from atlas.scene.model import Settings, Tolerances
from atlas.scene.tables import point_columns
from atlas.systems import SYSTEMS
from atlas.variables import variables

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

    def unsure(error, **changes):
        measured = {name: np.array([value]) for name, value in (steady | changes).items()}
        errors = {name: np.array([value]) for name, value in (no_error | error).items()}
        return bool(labels.unsure(measured, errors, Tolerances(1e-5, 1e-5))[0])

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


def test_an_exact_start_that_leaves_because_of_the_methods_error_is_step_sensitive():
    results = set()
    for m in np.linspace(29.0, 30.0, 12):  # the last bits decide which of them leave
        result = run("satellite", unstable_point(m=m), duration=50.0, tolerance=1e-2)
        assert result["growth_rate"][0] * 50 < np.log(1e11)
        results.add((result["label"][0], result["status"][0]))
    step_sensitive = (Label.UNRESOLVED, Status.STEP_SENSITIVE)
    assert results <= {step_sensitive, (Label.PERMANENT_ROTATION, Status.OK)}
    assert step_sensitive in results
    # a push that is larger than any error leaves because of physics
    unstable = unstable_point(m=30.0)
    pushed = unstable | {"theta0": unstable["theta0"] + 1e-4}
    assert run("satellite", pushed, duration=50.0)["label"][0] == Label.DRIFTING


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


@pytest.mark.parametrize("check_half_step", ["none", "sample", "all"])
def test_half_step_checks_change_no_certain_label(check_half_step):
    points = {"theta0": np.linspace(0.1, 3.0, 200), "m": 0.5}
    unchecked = run("satellite", points, duration=5.0, tolerance=1e-6)
    checked = run("satellite", points, duration=5.0, tolerance=1e-6, check_half_step=check_half_step)
    np.testing.assert_array_equal(unchecked["label"], checked["label"])


def test_half_step_option_is_checked(scene_text):
    with pytest.raises(atlas.BadInput, match="check_half_step = 'some': allowed: none, sample, all"):
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


@given(any_points("satellite"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"k1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
@example({"Omega": [0.0, 4.6e-254, 5e-324, 1e-160], "theta0": [0, 1.0, 1.0, 1.0]}, "rk8")
@example({"B": [1.0, 5e-324, 1e-300, 1e-100]}, "rk4")  # the matrix of the exponents is not finite
def test_any_satellite(columns, method):
    check_results("satellite", columns, method)


@given(any_points("fixed_point"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"l1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
def test_any_gyrostat_about_a_fixed_point(columns, method):
    check_results("fixed_point", columns, method)
