"""Error against run time: orders against exact motions, the reference, the sample, the report and its limits."""

import math
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipj, ellipk
from scipy.stats import binom
from test_fixed_point_families import of_cases
from test_satellite_families import case_points

import atlas
from atlas.cli import main
from atlas.engine import blocks, measure, stepsize
from atlas.engine.tableaux import METHODS
from atlas.errors import BadInput
from atlas.flags import Label
from atlas.label.pipeline import RATES, evaluate, kernel
from atlas.scene import grid
from atlas.scene.model import Settings
from atlas.scene.read import load_scene
from atlas.systems import SYSTEMS
from atlas.validation import half_step, reference, work_precision


def points(system, size=1, **given):
    """Every parameter at its default but those given."""
    values = {name: p.default for name, p in SYSTEMS[system].parameters.items()} | given
    return {name: np.broadcast_to(np.asarray(value, float), (size,)).copy() for name, value in values.items()}


def ends(system, p, counts, duration, method):
    """Final states after `counts` steps to `duration`."""
    kind, size = SYSTEMS[system], p["A"].size
    state, constants = np.ascontiguousarray(kind.initial_state(p)), np.ascontiguousarray(kind.constants(p))
    scales = measure.scales(kind.equations, state, constants, dict(kind.integral_scales(p)))
    stepsize, length = np.full(size, counts), np.full(size, duration / counts)
    blocks.integrate(
        kernel(kind, method),
        blocks.pack_blocks(stepsize, np.ones_like(stepsize)),
        length,
        state,
        constants,
        scales,
        1e-5,
    )
    return state


def spin_of_free_gyrostat(A, B, C, rotor, p0, r0, t):
    """r(t) of a torque-free gyrostat with its rotor on the third axis, started with q = 0.

    Energy and |momentum|^2 give p^2 and q^2 as quadratics in r, so C r' = (A - B) p q has the quartic
    -kappa (r - a)(r - b)(r - c)(r - d); between a > b its solution is Byrd and Friedman's 256.00.
    """
    energy, momentum = A * p0**2 + C * r0**2, (A * p0) ** 2 + (C * r0 + rotor) ** 2
    square = np.polynomial.Polynomial([rotor, C]) ** 2
    left, up = np.polynomial.Polynomial([energy, 0, -C]), momentum - square
    p2, q2 = (B * left - up) / (A * (B - A)), (up - A * left) / (B * (B - A))
    quartic = p2 * q2 * ((A - B) / C) ** 2
    d, c, b, a = np.sort(quartic.roots().real)
    assert np.abs(quartic.roots().imag).max() < 1e-9
    kappa = -quartic.coef[4]
    assert kappa > 0
    assert min(abs(r0 - a), abs(r0 - b)) < 1e-12
    modulus = (a - b) * (c - d) / ((a - c) * (b - d))
    u = 0.5 * t * np.sqrt(kappa * (a - c) * (b - d)) + (ellipk(modulus) if abs(r0 - a) < 1e-12 else 0.0)
    sn2 = ellipj(u, modulus)[0] ** 2
    return (b * (a - c) - c * (a - b) * sn2) / ((a - c) - (a - b) * sn2)


# The order of every method, against motions known in closed form.

COARSE = {4: 240, 8: 30}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rotor", [0.0, 0.25])  # 0: Euler's top
@pytest.mark.parametrize("system", SYSTEMS)
def test_order_on_the_free_gyrostat(system, rotor, method):
    A, B, C, p0, r0, duration = 1.0, 1.2, 1.6, 1.5, 0.9, 20.0
    body = {"satellite": {"Omega": 0.0, "k3": rotor}, "fixed_point": {"l3": rotor}}[system]
    # w = n gamma + m e3 with the vertical at 90 degrees on the first axis
    start = {"theta0": np.pi / 2, "phi0": np.pi / 2, "n": p0, "m": r0}
    p = points(system, A=A, B=B, C=C, **start, **body)
    exact = spin_of_free_gyrostat(A, B, C, rotor, p0, r0, duration)
    coarse = COARSE[METHODS[method].order]
    errors = [abs(ends(system, p, k * coarse, duration, method)[2, 0] - exact) for k in (1, 2)]
    assert errors[0] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(METHODS[method].order, abs=0.7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_order_on_every_steady_family(system, method):
    kind = SYSTEMS[system]
    p = {"satellite": case_points, "fixed_point": of_cases}[system]()
    flags, _ = kind.identify_family(p)
    on = np.flatnonzero(flags)
    p, flags = {name: values[on] for name, values in p.items()}, flags[on]
    duration = 20.0 / kind.frequency_bound(p)
    exact = np.empty((len(kind.equations.STATE), on.size))
    for family in kind.families.values():
        its = np.flatnonzero(flags == family.flag)
        for i in its:
            exact[:, i] = family.motion({k: v[i : i + 1] for k, v in p.items()}, duration[i])[:, 0]
    order = METHODS[method].order
    coarse = {4: 96, 8: 8}[order]
    errors = [np.abs(ends(system, p, k * coarse, duration, method) - exact).max(0) for k in (1, 2)]
    assert errors[1].max() < 1e-4
    told = errors[1] > 1e-13  # at rest there is no error, and none below rounding shows an order
    assert told.sum() > 5
    assert np.median(np.log2(errors[0][told] / errors[1][told])) == pytest.approx(order, abs=0.4)


# The reference.


def test_the_reference_knows_what_it_says(small_scene):
    """Two runs of DOP853 against the closed form of a family, and the statistics of a steady motion."""
    scene = load_scene(small_scene.split("[nudge]")[0] + "[integration]\nduration = 10.0\n")
    part = grid.points_at_indices(scene, np.arange(0, 63, 9))
    found = reference.reference(scene.system, part.points, part.duration, scene.settings)
    assert found.exact.all()
    assert found.certain.all()
    assert found.state_error.max() < 1e-11 * reference.SAFETY
    np.testing.assert_allclose(found.statistics["phi_dot_mean"], part.points["m"], atol=1e-13)
    np.testing.assert_allclose(found.statistics["theta_max"], part.points["theta0"], atol=1e-14)
    assert all(error.max() < 1e-7 for error in found.statistics_error.values())
    np.testing.assert_array_equal(
        found.label, Label.PERMANENT_ROTATION
    )  # n = 0: the axis rests in the orbital frame


def test_the_reference_measures_a_libration():
    """theta' = rate cn, so the mean square of a planar motion and its turning points are elliptic too."""
    A, B, C, rate = 1.0, 1.2, 1.1, 0.3
    # about the velocity's axis: the third axis librates in the plane of normal and radius about pi/2
    p = points("satellite", A=A, B=B, C=C, theta0=np.pi / 2, psi0=np.pi / 2, theta_dot0=rate)
    duration = np.array([7.0])
    found = reference.reference(SYSTEMS["satellite"], p, duration, Settings())
    state = reference._integrate_group(SYSTEMS["satellite"], p, duration, 1e-5, 1e-10)
    assert found.statistics["theta_dot_rms"][0] == pytest.approx(state["theta_dot_rms"][0], rel=1e-8)
    run = atlas.label_points(
        "satellite", {name: values for name, values in p.items()}, duration=7.0, tolerance=1e-11
    )
    for name in RATES:
        assert run[name].item() == pytest.approx(found.statistics[name][0], abs=1e-9), name
    assert run["theta_max"].item() == pytest.approx(found.statistics["theta_max"][0], abs=5e-9)


def test_extremes_are_those_of_the_path():
    p = points("satellite", A=1.0, B=1.2, C=0.8, theta0=0.4, psi0=0.3, n=0.3, m=0.5)
    settings = Settings()
    found = reference.reference(SYSTEMS["satellite"], p, np.array([6.0]), settings)
    path = atlas.trajectory("satellite", {k: v[0] for k, v in p.items()}, duration=6.0, samples=3001)
    for name, extreme in (("theta_min", path.theta.min()), ("theta_max", path.theta.max())):
        assert found.statistics[name][0] == pytest.approx(extreme.item(), abs=1e-5)


# The samples.


@given(st.integers(1, 10**12), st.integers(1, 300))
def test_spread_takes_one_of_each_part(size, count):
    found = half_step.stratified_indices(size, count)
    assert found.size == min(size, count)
    np.testing.assert_array_equal(found, half_step.stratified_indices(size, count))
    for i, place in enumerate(found):
        assert i * size // found.size <= place < (i + 1) * size // found.size


@given(st.integers(0, 50), st.integers(1, 2000))
def test_upper_bound_is_exact(found, of):
    bound = half_step.upper_bound(found, of)
    if found >= of:
        assert bound == 1.0
    else:
        assert binom.cdf(found, of, bound) == pytest.approx(0.05, rel=1e-6)


def test_half_step_counts_what_changes(small_scene, monkeypatch):
    """A made-up engine whose labels and rates depend on the step."""
    scene = load_scene(small_scene.replace("tolerance = 1e-5", "step = 0.1"))

    def made_up(scene, tile, *, halved, threads):
        label = np.full(tile.duration.size, Label.PERMANENT_ROTATION, np.int8)
        label[0], label[1] = Label.NOT_COMPUTED, Label.UNRESOLVED
        if halved:
            label[:5] = Label.DRIFTING
        rates = {name: np.full(label.size, 0.05 if halved else 0.1) for name in RATES}
        estimate = np.where(np.arange(label.size) < 7, 0.0, 1.0)
        return {"label": label, "label_inertial": label.copy(), "error_estimate": estimate, **rates}

    monkeypatch.setattr(half_step, "evaluate_tile", made_up)
    told = half_step.half_step_sample(scene)
    # every point was tried: the bound is the count; without a label there is none to change
    assert told["atlas_half_step_points"] == told["atlas_points"] == 63
    assert told["atlas_labels_may_change"] == told["atlas_half_step_changed"] == 3
    assert told["atlas_half_step_difference"] == pytest.approx(0.05)
    assert "at most 3 of 63 (95 %)" in half_step.half_step_text(told)
    assert half_step.half_step_text(told).endswith("; 7 changed by more than their estimate")
    large = load_scene(
        small_scene.replace("tolerance = 1e-5", "step = 0.1").replace("count = 9", "count = 900")
    )
    told = half_step.half_step_sample(large)
    assert told["atlas_half_step_points"] == 64
    assert told["atlas_labels_may_change"] == math.ceil(half_step.upper_bound(3, 64) * 6300)


def test_half_step_of_a_good_scene_changes_nothing(small_scene):
    scene = load_scene(small_scene)
    told = half_step.half_step_sample(scene)
    assert told["atlas_half_step_changed"] == told["atlas_labels_may_change"] == 0
    assert 0 < told["atlas_half_step_difference"] < 1e-6
    assert told == half_step.half_step_sample(scene, threads=1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limit", [{}, {"max_steps": 200}, {"step": 0.01}, {"rate_tolerance": 1e-9}])
def test_half_step_halves_the_step(method, limit):
    """Whatever it is that limits the step; the errors foreseen fall with the method's order."""
    kind, limited = METHODS[method], Settings(method=method, **limit)
    p = points("satellite", 3, theta0=[0.3, 0.9, 1.2], m=[0.5, 2.0, 9.0])
    one = work_precision._step_sizes(SYSTEMS["satellite"], p, np.array([30.0, 40.0, 50.0]), limited)
    two = one.halved(kind)
    np.testing.assert_array_equal(two.count, 2 * one.count)
    np.testing.assert_allclose(two.length * two.count, one.length * one.count, rtol=1e-15)
    np.testing.assert_array_equal(two.intervals, 2 * one.intervals)
    exact = stepsize.choose(
        kind, SYSTEMS["satellite"].frequency_bound(p), np.array([30.0, 40.0, 50.0]),
        tolerance=1.0, step=two.length.max(), max_steps=10**9,
    )  # fmt: skip
    i = int(two.length.argmax())
    assert exact.phase_error[i] == pytest.approx(two.phase_error[i], rel=0.5)
    assert exact.hidden_damping[i] == pytest.approx(two.hidden_damping[i], rel=0.5)


# The report.


@pytest.fixture(scope="module")
def report():
    from conftest import SMALL_SCENE

    scene = load_scene(SMALL_SCENE.replace("30.0", "12.0").replace("1e-5\n", "1e-6\n", 1))
    return work_precision.work_precision(scene, 10)


def test_rows_stay_above_the_reference(report):
    assert report.sizes["sample"] == 10
    ran = np.isfinite(report.seconds_per_point)
    assert (report.error_state.where(ran) >= report.reference_error).where(ran, True).all()
    rows = work_precision.summary(report)
    assert {row["method"] for row in rows} == set(METHODS)
    (own,) = [row for row in rows if row["own_setting"]]
    assert (own["method"], own["tolerance"]) == ("rk4", pytest.approx(1e-6))
    assert all(row["labels_wrong"] == 0 and row["seconds_per_point"] > 0 for row in rows)
    assert own["labels_wrong_at_most"] == pytest.approx(1 - 0.05 ** (1 / own["labels_compared"]))


def test_the_text_ends_with_the_cheapest_setting(report):
    text = work_precision.report(report)
    rows = work_precision.summary(report)
    assert len([line for line in text.splitlines() if line.lstrip().startswith("rk")]) == len(rows)
    advice = text.splitlines()[-1]
    assert advice == work_precision.advice(report)
    cheapest = min(
        (r for r in rows if max(r["error_state"], r["error_rates"]) <= 1e-6 and not r["labels_unresolved"]),
        key=lambda r: r["seconds_per_point"],
    )
    assert f"{cheapest['method']} with tolerance = {cheapest['tolerance']:.3g}" in advice


def test_wrong_labels_are_counted_and_bounded(report):
    flipped = report.copy(deep=True)
    flipped["label_wrong"][0, :, :3] = 1
    row = work_precision.summary(flipped)[0]
    assert row["labels_wrong"] == 3
    assert row["labels_wrong_at_most"] == half_step.upper_bound(3, row["labels_compared"])


def test_a_tolerance_that_no_step_reaches_is_said(small_scene):
    scene = load_scene(small_scene.replace("30.0", "5.0").replace("tolerance = 1e-5", "tolerance = 1e-17"))
    ds = work_precision.work_precision(scene, 3)
    advice = work_precision.advice(ds)
    assert advice.startswith("Out of reach: a median error of 1e-17")
    assert "sigma = " in advice
    assert float(ds.error_state.min()) >= reference.ROUNDING


def test_a_step_instead_of_a_tolerance_and_the_orders(small_scene):
    text = small_scene.replace("30.0", "5.0").replace("tolerance = 1e-5", "step = 0.05")
    ds = work_precision.work_precision(load_scene(text), 4)
    for method in METHODS.values():
        orders = ds.order.sel({"method": method.name})
        assert orders.notnull().any()
        assert float(orders.median()) == pytest.approx(method.order, abs=0.6)
    (own,) = [row for row in work_precision.summary(ds) if row["own_setting"]]
    assert own["step"] == pytest.approx(0.05)
    assert "own median error" in work_precision.advice(ds)


def test_a_reference_that_fails_names_its_points(small_scene):
    """One point of three turns too fast to be followed; its neighbours do not hide it."""
    text = small_scene.split("[family]")[0].replace("m = 0.5\n", "")
    text += "[axes.m]\nvalues = [0.5, 0.7, 1e9]\n[integration]\nduration = 5.0\nmax_steps = 1000\n"
    text = text.replace("count = 9", "count = 1").replace("count = 7", "count = 1")
    text = text.replace("to = 1.7", "to = 0.3").replace("to = 1.4", "to = 0.2")
    ds = work_precision.work_precision(load_scene(text), 3)
    (line,) = [line for line in work_precision.report(ds).splitlines() if line.startswith("left out: ")]
    assert "fails at 1 of 3 points" in line
    assert "m = 1e+09" in line
    assert "0.5" not in line
    assert ds.sizes["sample"] == 2
    with pytest.raises(
        BadInput, match=r"fails at 2 of 3 points, where .* turns more than 100000 rad.*m = 1e\+09"
    ):
        work_precision.work_precision(load_scene(text.replace("0.5, 0.7", "0.5, 1e8")), 3)


def test_a_failing_step_is_told_from_its_neighbours(monkeypatch):
    """DOP853 gives up on one of three points that share their steps."""
    follow, system = reference._integrate_group, SYSTEMS["satellite"]

    def failing(kind, p, *more):
        return None if (p["m"] == 0.6).any() else follow(kind, p, *more)

    monkeypatch.setattr(reference, "_integrate_group", failing)
    p = points("satellite", 3, theta0=0.3, m=[0.5, 0.6, 0.7])
    found, lost = reference._dop853(system, p, np.full(3, 2.0), 1e-5, 1e-10)
    np.testing.assert_array_equal(lost, [False, True, False])
    np.testing.assert_array_equal(np.isfinite(found["state"]).all(0), ~lost)


@pytest.mark.parametrize("count", [1, 0, -3])
def test_too_few_points(small_scene, count):
    with pytest.raises(BadInput, match="at least 2"):
        work_precision.work_precision(load_scene(small_scene), count)


def test_command_writes_what_it_printed(tmp_path, monkeypatch, small_scene, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(small_scene.replace("30.0", "4.0"))
    command = ["accuracy", "small.toml", "--points", "3", "-o", "a.nc", "-o", "a.csv", "-o", "a.png"]
    assert main(command) == 0
    text = capsys.readouterr().out
    with xr.open_dataset("a.nc") as ds:
        assert work_precision.report(ds) in text
    table = (tmp_path / "a.csv").read_text().splitlines()
    assert table[0].startswith("method,tolerance,own_setting,steps,seconds_per_point,error_state")
    assert {len(line.split(",")) for line in table} == {len(table[0].split(","))}
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["accuracy", "small.toml", "-o", "a.txt"]) == 2
    assert ".csv" in capsys.readouterr().err
    assert main(["accuracy", "small.toml", "--points", "1"]) == 2
    assert "at least 2" in capsys.readouterr().err


@settings(max_examples=8)
@given(st.floats(1e-13, 1e-1), st.booleans())
def test_the_ladder_holds_the_scenes_own_setting(value, step):
    chosen = Settings(step=value) if step else Settings(tolerance=value)
    kind, rungs = work_precision.levels(chosen)
    assert kind == ("step" if step else "tolerance")
    assert rungs[work_precision.own_level(chosen)] == pytest.approx(value, rel=1e-12)
    assert all(math.log(a / b) > 0 for a, b in pairwise(rungs))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_no_passage_of_the_vertical_spoils_a_statistic(system, method):
    """Spikes of psi' a hundred times as high as it is elsewhere, and narrower than the distance of two samples.

    Without the correction of the sums the largest errors are 0.2 (satellite, rk4) to 6 (fixed_point).
    """
    kind, rng = SYSTEMS[system], np.random.default_rng(4)
    given = {
        "satellite": {"mu1": 0.2, "h3": 0.4, "k3": 0.3},
        "fixed_point": {"Mg": 1.0, "z0": 0.6, "l3": 0.3},
    }
    p = points(system, 24, A=1.0, B=1.2, C=0.8, theta0=0.7, theta_dot0=-1.0, **given[system])
    p |= {"m": rng.uniform(-1.0, 1.0, 24), "n": rng.uniform(-0.02, 0.02, 24), "phi0": rng.uniform(0, 6, 24)}
    duration, options = np.full(24, 8.0), Settings(tolerance=1e-9, cylinder_tolerance=1e-7, method=method)
    truth = reference.reference(kind, p, duration, options)
    found = evaluate(kind, p, p, duration, options)
    assert truth.statistics["theta_min"].min() < 0.01
    assert truth.statistics["psi_dot_std"].max() > 5.0
    for name in RATES:
        error = np.abs(found[name] - truth.statistics[name])
        assert error.max() < 1e-4, name
        assert np.median(error) < 2e-6, name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("where", ["beginning", "end"])
def test_no_passage_of_the_vertical_at_an_end_of_the_run_spoils_a_statistic(where, method):
    """In the first and last few samples, and just before and after them, where the weights are not 1."""
    kind, rng, count = SYSTEMS["satellite"], np.random.default_rng(4), 48
    p = points("satellite", count, A=1.0, B=1.2, C=0.8, theta_dot0=-1.0, mu1=0.2, h3=0.4, k3=0.3)
    p |= {
        "m": rng.uniform(-1.0, 1.0, count),
        "n": rng.uniform(-0.02, 0.02, count),
        "phi0": rng.uniform(0, 6, count),
    }
    early = where == "beginning"
    p["theta0"] = np.linspace(-0.1, 0.2, count) if early else np.full(count, 0.7)
    duration = np.full(count, 4.0) if early else np.linspace(0.5, 0.95, count)
    options = Settings(tolerance=1e-8, cylinder_tolerance=1e-7, method=method)
    truth = reference.reference(kind, p, duration, options)
    found = evaluate(kind, p, p, duration, options)
    worst = np.max([np.abs(found[name] - truth.statistics[name]) for name in RATES], axis=0)
    assert truth.statistics["psi_dot_std"].max() > 5.0
    # Without the correction: medians from 1e-6 to 1, the largest from 0.7 to 700.
    assert np.median(worst) < 1e-6
    assert np.quantile(worst, 0.9) < 1e-4
    assert worst.max() < 0.02


def test_error_estimate_holds_the_drift_and_what_half_the_step_changed():
    kind, rng = SYSTEMS["satellite"], np.random.default_rng(8)
    p = points("satellite", 24, A=1.0, B=1.2, C=0.8, k3=0.5, mu1=0.2, h3=0.4)
    p |= {"m": rng.uniform(-1, 1, 24), "psi0": rng.uniform(0, 6, 24)}
    # half of them fall across the vertical, where psi' has spikes
    p["theta0"] = np.r_[rng.uniform(0.8, 2.2, 12), np.full(12, 0.5)]
    p["theta_dot0"] = np.r_[np.zeros(12), np.full(12, -1.0)]

    def run(tolerance, which):
        settings = Settings(tolerance=tolerance, cylinder_tolerance=1e-5, check_half_step=which)
        return evaluate(kind, p, p, np.full(24, 8.0), settings)

    rough, once, fine = run(1e-5, "none"), run(1e-5, "all"), run(1e-10, "none")
    assert (rough["error_estimate"] >= rough["integral_drift"]).all()
    assert (once["error_estimate"] >= rough["error_estimate"]).all()
    assert (once["error_estimate"] > 1.5 * rough["error_estimate"]).any()
    bound = kind.frequency_bound(p)
    true = np.max([np.abs(once[name] - fine[name]) / bound for name in RATES], axis=0)
    assert (true > 2 * rough["error_estimate"]).any()
    assert (true <= 1.1 * once["error_estimate"]).mean() > 0.9
