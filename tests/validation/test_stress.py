"""Stiff and extreme cases: no label that is not true, limits of the methods, any parameters at all."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import atlas
from atlas import cli
from atlas.engine import stepsize
from atlas.engine.tableaux import METHODS, RK4
from atlas.flags import Label, Status
from atlas.label import labels
from atlas.label.pipeline import GENERIC, evaluate
from atlas.scene.model import Settings
from atlas.scene.tables import point_columns
from atlas.systems import SYSTEMS
from atlas.validation import limits, stress, stress_cases
from atlas.variables import variables

NAMES, STATES = list(Label.meanings()), list(Status.meanings())
# Cases that take a fraction of a second each; `atlas stress` runs all of them.
QUICK = {
    "near 0", "near pi", "steep precession", "weak field", "separatrix", "unstable, short", "unstable, long",
    "unstable cone, short", "slower than the run", "at rest", "denormal", "overflow",
}  # fmt: skip


@pytest.fixture(scope="module")
def batteries():
    """Report of the quick cases, by system."""
    return {
        name: stress.stress(name, [case for case in make() if case.name in QUICK])
        for name, make in stress_cases.STRESS_CASES.items()
    }


@pytest.mark.parametrize("system", stress_cases.STRESS_CASES)
def test_no_label_of_the_battery_is_untrue(batteries, system):
    ds = batteries[system]
    assert not stress.mislabelled(ds).any(), stress.report(ds)
    assert not stress.unresolved(ds).any(), stress.report(ds)
    assert (ds.verdict == stress.RIGHT).sum() > 300
    # beyond the stability limit nothing that moves is labelled
    moving = ~np.isin(ds["case"], ["at rest", "slower than the run", "denormal"])
    assert (ds.verdict.sel(rung=["ratio 1.5", "ratio 0.9"]).values[..., moving] != stress.RIGHT).all()


def test_an_untrue_label_is_told_and_fails_the_command(batteries, monkeypatch, capsys):
    ds = batteries["satellite"].copy(deep=True)
    ds["verdict"][0, -1, 0] = stress.WRONG
    monkeypatch.setattr(stress, "stress", lambda name, **options: ds)
    monkeypatch.setattr(limits, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "satellite"]) == cli.FAILED
    told = capsys.readouterr().out
    assert "label not true: near 0, theta0 = 0.01; rk4, tolerance 1e-08" in told
    assert "labels that are not true: 1" in told
    assert cli.main(["stress", "pendulum"]) == cli.BAD_INPUT


def test_report_files(batteries, monkeypatch, tmp_path):
    monkeypatch.setattr(stress, "stress", lambda name, **options: batteries[name])
    monkeypatch.setattr(limits, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "-o", str(tmp_path / "out")]) == cli.DONE
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        f"{name}{suffix}" for name in stress_cases.STRESS_CASES for suffix in (".nc", ".png")
    }
    assert cli.main(["stress", "satellite", "-o", str(tmp_path / "out")]) == cli.BAD_INPUT


def test_a_battery_whose_truth_is_unknown_is_an_error():
    """A motion that stays steady for the part of the run that a reference can follow proves nothing."""
    points, _ = point_columns(SYSTEMS["satellite"], {"theta0": 1e-7, "m": 1.5, "C": 1.3})
    with pytest.raises(ValueError, match="cannot decide"):
        stress.reference_label(SYSTEMS["satellite"], points, np.array([1e4]), Settings())


def test_the_slow_twin_moves_its_axis_alike():
    points, _ = point_columns(SYSTEMS["satellite"], {"theta0": 1.2, "k3": -59.5, "m": 50.0, "psi0": 0.3})
    twin, excess = stress.despun_equivalent(SYSTEMS["satellite"], points)
    one, two = (run("satellite", p, 2.0, method="rk8", step=1e-3) for p in (points, twin))
    assert excess == pytest.approx(-59.5 / 1.2)
    for name in ("theta_dot_rms", "psi_dot_std", "psi_dot_mean", "theta_max"):
        np.testing.assert_allclose(one[name], two[name], rtol=1e-6)
    np.testing.assert_allclose(one["phi_dot_mean"], two["phi_dot_mean"] - excess, rtol=1e-7)


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda m: m.name)
def test_stability_limits_are_those_of_theory(method):
    for y in limits.observed_stability(method, steps=4000).values():
        assert y == pytest.approx(method.stability, rel=2e-4)


@pytest.mark.parametrize(("method", "y"), [("rk4", 0.05), ("rk4", 0.02), ("rk8", 0.2)])
def test_constraints_keep_to_their_bound(method, y):
    system, count = SYSTEMS["satellite"], 200_000
    turn, _ = point_columns(system, {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "m": 1.0})
    rng = np.random.default_rng(6)
    some = {name: rng.uniform(-1, 1, 16) for name in ("k1", "k3", "mu1", "h1", "n", "m", "theta_dot0")}
    tumbling, _ = point_columns(system, {"A": 0.9, "B": 1.1, "theta0": rng.uniform(0, 3, 16)} | some)
    bound = limits.constraint_bound(METHODS[method], y, count)
    free = limits.constraint_change(
        system, METHODS[method], turn, y * float(system.frequency_bound(turn)[0]), count
    )
    assert 0.9 * bound - 1e-10 < free[0] <= 1.01 * bound
    assert (limits.constraint_change(system, METHODS[method], tumbling, y, count) <= bound).all()


# Guards.


def point(**given):
    """One point exactly on the unstable motion (24) with C/A = 1.2, and what is given instead."""
    values = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3} | given
    points, _ = point_columns(SYSTEMS["satellite"], values)
    return points | {"k3": SYSTEMS["satellite"].families["perp_velocity"].solve["k3"](points)}


def run(system, points, duration, **options):
    """Everything that is measured, by name, in the kernel that all tests here share."""
    points, size = point_columns(SYSTEMS[system], points)
    times = np.full(size, duration)
    return evaluate(SYSTEMS[system], points, points, times, Settings(**options), threads=1)


def result(found, name="label"):
    return {"label": NAMES, "status": STATES}[name][found[name][0]]


def test_unsure_within_the_error_only():
    exact = {
        "theta_dot_rms": 0.0, "psi_dot_mean": 0.5, "psi_dot_std": 0.0, "phi_dot_mean": 0.3, "phi_dot_std": 0.0,
        "normal_rate_std": 0.0, "theta_min": 1.0, "theta_max": 1.0, "sine_max": np.sin(1.0),
    }  # fmt: skip
    none = {name: np.zeros(1) for name in exact}

    def unsure(error, **given):
        measured = {name: np.array([value]) for name, value in (exact | given).items()}
        return bool(
            labels.unsure(measured, none | {k: np.array([v]) for k, v in error.items()}, 1e-5, 1e-5)[0]
        )

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
def test_an_exact_fast_motion_is_never_called_drifting(method, share):
    """Damping makes psi' and phi' of a body that turns at 1e4 vary by more than the tolerance."""
    fast = point(C=0.7, m=1e4)
    step = share * METHODS[method].stability / float(SYSTEMS["satellite"].frequency_bound(fast)[0])
    ds = run("satellite", fast, duration=0.1, step=step, method=method)
    assert result(ds) in ("permanent_rotation", "unresolved")


def test_the_automatic_step_resolves_the_rate_tolerance():
    fast = point(C=0.7, m=1e4)
    for tolerance in (1e-2, 1e-5):
        ds = run("satellite", fast, duration=0.1, tolerance=tolerance)
        assert result(ds) == "permanent_rotation"
    bound = SYSTEMS["satellite"].frequency_bound(fast)
    chosen = stepsize.choose(
        RK4, bound, np.array([0.1]), tolerance=1e-2, step=None, max_steps=10**9, rate_tolerance=1e-5
    )
    assert chosen.rate_error[0] < 0.5 * 1e-5


def test_an_exact_start_that_leaves_by_the_methods_error_is_step_sensitive():
    found = []
    for m in np.linspace(29.0, 30.0, 12):  # which of them leave is up to the last bits
        ds = run("satellite", point(m=m), duration=50.0, tolerance=1e-2)
        assert ds["growth_rate"][0] * 50 < np.log(1e11)
        found.append((result(ds), result(ds, "status")))
    assert set(found) <= {("unresolved", "step_sensitive"), ("permanent_rotation", "ok")}
    assert ("unresolved", "step_sensitive") in found
    unstable = point(m=30.0)
    # a push that is larger than any error leaves by physics
    pushed = run("satellite", unstable | {"theta0": unstable["theta0"] + 1e-4}, duration=50.0)
    assert result(pushed) == "drifting"


def test_growth_hidden_by_damping_is_flagged():
    """s < w^6 h^5 / 144: the spin damps faster than the motion can leave."""
    hidden = point(m=60.0)
    hidden["theta0"] = hidden["theta0"] + 1e-4
    growth = float(run("satellite", point(m=60.0), duration=1.0)["growth_rate"][0])
    for step in (0.02, 0.01, 0.005):
        ds = run("satellite", hidden, duration=40.0, step=step)
        damping = 60.0**6 * step**5 / 144
        if damping > growth:
            assert result(ds) == "unresolved"
        assert result(ds) in ("drifting", "unresolved")
    assert growth < 60.0**6 * 0.02**5 / 144
    assert result(run("satellite", hidden, duration=40.0)) == "drifting"


def test_a_point_without_a_bound_of_its_frequency_is_unresolved():
    """At rest with a rotor of 1e200: nothing moves, but nothing vouches for it."""
    ds = run("fixed_point", {"l1": 1e200, "theta0": 0.5}, duration=20.0)
    assert (result(ds), result(ds, "status")) == ("unresolved", "under_resolved")
    assert ds["step_ratio"][0] == np.inf


@pytest.mark.parametrize("which", ["none", "sample", "all"])
def test_half_step_checks_change_no_sound_label(which):
    points = {"theta0": np.linspace(0.1, 3.0, 200), "m": 0.5}
    plain = run("satellite", points, duration=5.0, tolerance=1e-6)
    checked = run("satellite", points, duration=5.0, tolerance=1e-6, check_half_step=which)
    np.testing.assert_array_equal(plain["label"], checked["label"])


def test_half_step_option_is_checked(small_scene):
    with pytest.raises(atlas.BadInput, match="check_half_step = 'some': allowed: none, sample, all"):
        atlas.label_points("satellite", {}, check_half_step="some")
    with pytest.raises(atlas.BadInput, match="check_half_step"):
        atlas.load_scene(small_scene.replace("tolerance = 1e-5", "check_half_step = 1"))
    scene = atlas.load_scene(small_scene.replace("tolerance = 1e-5", 'check_half_step = "all"'))
    assert scene.settings.check_half_step == "all"
    assert atlas.load_scene(scene.toml()).settings.check_half_step == "all"


def test_labels_alone_are_those_of_whole_runs_at_coarse_steps():
    system = SYSTEMS["satellite"]
    columns = {"theta0": np.linspace(0.9, 1.1, 96), "psi0": np.pi / 2, "C": 1.2, "m": 30.0}
    points, size = point_columns(system, columns)
    points["k3"] = system.families["perp_velocity"].solve["k3"](points)
    exact = np.arange(size) % 3 == 0
    points["theta0"] = points["theta0"] + np.where(~exact, 10.0 ** -(np.arange(size) % 12), 0.0)
    for step in (0.02, 0.01, 0.003):
        options = Settings(step=step)
        whole, alone = (
            evaluate(system, points, points, np.full(size, 50.0), options, special=GENERIC, outputs=outputs)
            for outputs in (None, ("label", "status"))
        )
        # a run that ends early has no time to lose a first integral
        lost = whole["status"] == STATES.index("drift_exceeded")
        assert ((whole["status"] == alone["status"]) | lost).all()
        assert ((whole["label"] == alone["label"]) | lost).all()
        assert (alone["label"][exact] != NAMES.index("drifting")).all()


# Any parameters at all.

NUMBERS = st.one_of(
    st.sampled_from(
        [0.0, -0.0, 5e-324, -1e-310, 1e-300, 1e-160, 1e-12, 1.0, -1.0, 1e12, 1e160, -1e300, 1.7e308]
    ),
    st.floats(-10, 10),
    st.floats(allow_nan=False, allow_infinity=False),
)
# Statistics that the registry lets be nan: inside the cylinder, or where theory is silent.
MAY_BE_NAN = {
    "psi_dot_mean",
    "psi_dot_std",
    "phi_dot_mean",
    "phi_dot_std",
    "growth_rate",
    "condition_residual",
}


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


def hold(system, columns, method):
    """No exception, nothing not finite in an ok point, no label without evidence."""
    points, size = point_columns(SYSTEMS[system], columns)
    found = evaluate(
        SYSTEMS[system], points, points, np.full(size, 3.0), Settings(method=method, max_steps=400), threads=1
    )
    ok = found["status"] == STATES.index("ok")
    for name, variable in variables(SYSTEMS[system]).items():
        if variable.dtype == "float64" and name in found:
            inside = found["sine_max"] < 1e-5
            allowed = inside | (name in ("growth_rate", "condition_residual"))
            broken = ok & ~np.isfinite(found[name]) & ~(allowed & (name in MAY_BE_NAN))
            assert not broken.any(), (name, {k: v[broken] for k, v in points.items()})
    labelled = found["label"] != NAMES.index("unresolved")
    assert (labelled == ok).all()
    assert (found["step_ratio"][ok] <= 0.5).all()
    assert (found["integral_drift"][ok] <= 1e-5).all()


@given(any_points("satellite"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"k1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
@example({"Omega": [0.0, 4.6e-254, 5e-324, 1e-160], "theta0": [0, 1.0, 1.0, 1.0]}, "rk8")
@example({"B": [1.0, 5e-324, 1e-300, 1e-100]}, "rk4")  # no finite matrix to take exponents of
def test_any_satellite(columns, method):
    hold("satellite", columns, method)


@given(any_points("fixed_point"), st.sampled_from(["rk4", "rk8"]))
@settings(max_examples=60)
@example({"l1": [1e200, 0, 0, 1e-320], "m": [0, 1e300, 5e-324, 0]}, "rk4")
def test_any_gyrostat_about_a_fixed_point(columns, method):
    hold("fixed_point", columns, method)
