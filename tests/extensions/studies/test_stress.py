"""The stress study: no label that is not true, report and command."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import BySystem, default_points, evaluate

from atlas import cli
from atlas.extensions.studies import exact, stress, stress_truth
from atlas.extensions.studies.stress import case_points
from atlas.flags import Label, Status
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.systems.base import StressCase, stress_cases_of

# Cases that take a fraction of a second each; `atlas stress` runs all of them.
QUICK = {
    "near 0", "near pi", "steep precession", "weak field", "separatrix", "unstable, short", "unstable, long",
    "unstable cone, short", "slower than the run", "at rest", "denormal", "overflow",
    "heavy top passes", "free gyrostat ends", "free sphere starts", "magnetic sphere ends", "magnetic top starts",
}  # fmt: skip
# Unstable motions of which rounding decides when they are left.
BY_ROUNDING = {
    "unstable rest, offset", "unstable rotation, offset", "slow spin, unstable",
}  # fmt: skip


def selected(system, names):
    """The cases of a system with these names."""
    return [case for case in stress_cases_of(system) if case.name in names]


def sample(system, share):
    """The quick cases of a system with a share of their points, evenly over all of them."""
    cases, first, step = [], 0, round(1 / share)
    for case in selected(system, QUICK):
        size = case_points(system, case).duration.size
        where = np.arange(-first % step, size, step)
        first += size
        rows = {"columns": case.columns, "additions": case.additions}
        parts = {
            key: {name: np.asarray(v)[where] if np.ndim(v) else v for name, v in row.items()} for key, row in rows.items()
        }  # fmt: skip
        duration = np.asarray(case.duration)[where] if np.ndim(case.duration) else case.duration
        if where.size:
            cases.append(replace(case, duration=duration, **parts))
    return cases


@pytest.fixture(scope="module", params=[0.02, pytest.param(1.0, marks=pytest.mark.long)])
def share(request):
    """Share of the sample that is studied."""
    return request.param


@pytest.fixture(scope="module")
def studies(share):
    """Study of the quick cases, by system.

    The satellite comes last: a second process begins with tests that compile its kernels, see conftest.py.
    """
    return BySystem(
        {name: stress.stress(name, sample(SYSTEMS[name], share)) for name in ("fixed_point", "satellite")}
    )


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_label_differs_from_the_true_one(studies, share, system):
    ds = studies[system]
    assert not stress.mislabelled(ds).any(), stress.report(ds)
    assert not stress.unresolved(ds).any(), stress.report(ds)
    assert (ds.verdict == stress.Verdict.RIGHT).sum() > 300 * share
    # beyond the stability limit nothing that moves has a label
    moving = ~np.isin(ds["case"], ["at rest", "slower than the run", "denormal"]) & (
        ds["known_from"] != "exact motion"
    )
    coarse = ds.sel(level=["ratio 1.5", "ratio 0.9"])
    unstable = (coarse.step_ratio.values > 0.5) & moving.values  # a run takes three steps at least
    assert unstable.sum() > 50 * share
    assert (coarse.verdict.values[unstable] != stress.Verdict.RIGHT).all()


@pytest.mark.long
@pytest.mark.parametrize("system", SYSTEMS)
def test_no_label_where_rounding_decides(system):
    if not stress_cases_of(SYSTEMS[system]):
        pytest.skip(f"the system {system} has no cases")
    ds = stress.stress(system, selected(SYSTEMS[system], BY_ROUNDING))
    assert not stress.mislabelled(ds).any(), stress.report(ds)


@pytest.mark.long
@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_the_label_of_the_fastest_rotor_is_known_from_a_part_of_its_run(system):
    """In its own natural rate nothing that it does in so short a time would be a motion."""
    (case,) = selected(SYSTEMS[system], {"stiff rotor"})
    fastest = {name: value[-1] if np.ndim(value) else value for name, value in case.columns.items()}
    ds = stress.stress(system, [replace(case, columns=fastest, duration=np.asarray(case.duration)[-1])])
    assert (ds["truth"] == Label.DRIFTING).all()
    assert not stress.mislabelled(ds).any()
    assert (ds["verdict"][:, -1] == stress.Verdict.RIGHT).all()


@pytest.mark.parametrize("system", SYSTEMS)
def test_statistics_are_as_accurate_as_the_estimate(studies, share, system):
    ds = studies[system]
    known = ds["statistic_error"].notnull().any("statistic") & (ds["status"] == Status.OK)
    beyond = stress.beyond_estimate(ds)
    for i, method in enumerate(ds["method"].values):
        compared, worse = int(known[i].sum()), int(beyond[i].sum())
        assert compared > (60 if system == "satellite" else 100) * share
        assert worse <= 0.01 * compared, f"{method}\n{stress.report(ds)}"


def test_statistics_table_of_the_report(studies):
    ds = studies["satellite"].copy(deep=True)
    ds["error_estimate"][:] = np.inf
    assert not stress.beyond_estimate(ds).any()
    assert "error_estimate: rk4: 0 of" in stress.report(ds)
    ds["error_estimate"][:] = 0.0
    ds["statistic_error"][..., ds["known_from"].values == "exact motion"] = 1e-3
    resolved = (ds["status"] == Status.OK).values & (ds["known_from"] == "exact motion").values
    assert (stress.beyond_estimate(ds) == resolved).all()
    assert f"rk8: {resolved[1].sum()} of {resolved[1].sum()}" in stress.report(ds)
    none = ds.isel(point=ds["known_from"].values == "theory")
    assert "exact motions" not in stress.report(none)


@pytest.mark.long
@pytest.mark.parametrize("system", SYSTEMS)
def test_exact_cases_pass_beside_the_vertical(system):
    """Each of these runs comes as near the vertical as its case states."""
    for case in stress_cases_of(SYSTEMS[system]):
        if case.name.endswith(" passes"):
            part = case_points(SYSTEMS[system], case)
            for i, sine in enumerate((1e-4, 1e-3, 1e-2, 1e-1)):
                motion = exact.motion_of(SYSTEMS[system], case.truth, part.points, i)
                theta = exact.statistics(motion, part.duration[i])["theta_min"]
                assert theta == pytest.approx(sine, rel=1e-6)


@pytest.mark.long
def test_departures_of_large_offsets_agree_with_the_reference():
    """Offsets large enough for the reference integrator, which adds them to the state."""
    system = SYSTEMS["satellite"]
    (case,) = selected(system, {"unstable rest, offset"})
    part = case_points(system, case)
    points = part.base | {"theta0": part.base["theta0"] + 1e-3}
    part = replace(part, points=points, duration=0.25 * part.duration)
    departure = stress_truth.true_labels(system, part, Settings().at(1e-5))
    whole = stress_truth.true_labels(system, replace(part, truth=""), Settings().at(1e-5))
    np.testing.assert_array_equal(departure.label, whole.label)
    np.testing.assert_allclose(departure.unsteadiness, whole.unsteadiness, rtol=1e-5)


@pytest.mark.usual("symmetric top")
@pytest.mark.parametrize("truth", ["", "symmetric top"])
def test_truth_at_the_rim_of_the_cylinder(truth):
    """A hanging top between 0.0086 and 0.02 rad from the vertical: beyond half of its run in the cylinder it counts as inside."""
    system = SYSTEMS["fixed_point"]
    columns = {"C": 0.7, "z0": 1.0, "Mg": 1.0, "theta0": 0.02, "m": 0.3, "n": -0.5, "theta_dot0": 0.0}
    part = case_points(system, StressCase("rim", "at the rim", 60.0, columns, truth=truth))
    labels = []
    for cylinder in (0.008, 0.0199, 0.021):
        settings = replace(Settings(), rate_tolerance=0.05, cylinder_tolerance=cylinder).at(0.05)
        labels += stress_truth.true_labels(system, part, settings).label.tolist()
    assert labels == [Label.DRIFTING, Label.PERMANENT_ROTATION, Label.PERMANENT_ROTATION]


def test_departures_grow_at_the_rate_of_theory():
    """As long as a departure is small, its rates at ten times the offset are ten times as large."""
    system = SYSTEMS["fixed_point"]
    (case,) = selected(system, {"unstable rotation, offset"})
    part = case_points(system, case)
    tiny = [
        stress_truth.true_labels(
            system,
            replace(
                part,
                points=part.base | {"theta0": part.base["theta0"] + offset},
                duration=0.5 * part.duration,
            ),
            Settings().at(1e-5),
        ).unsteadiness
        for offset in (2.0**-30, 2.0**-33)
    ]
    np.testing.assert_allclose(tiny[0] / tiny[1], 8, rtol=1e-3)


@pytest.mark.long
def test_growth_of_a_disturbance_over_a_run():
    """Where theory gives the growth rate, the fundamental matrix grows as it predicts."""
    system = SYSTEMS["satellite"]
    (case,) = selected(system, {"slow spin, unstable"})
    part = case_points(system, case)
    part = part.subset(part.points["m"] == 0.05)
    flags, _ = system.identify_family(part.points)
    _, rate = system.linear_stability(part.points, flags)
    growth = stress_truth.linear_growth(system, part.points, flags, part.duration)
    np.testing.assert_allclose(growth, rate * part.duration, atol=2)


def test_points_without_an_exact_motion():
    for system, kind, given in (
        ("fixed_point", "symmetric top", {"B": 1.1}),
        ("fixed_point", "symmetric top", {"N": 0.1}),
        ("fixed_point", "free gyrostat", {"Mg": 1.0, "x0": 1.0}),
        ("satellite", "symmetric top", {}),  # gravity has a torque on a body that is not a sphere
        ("satellite", "pendulum", {}),
    ):
        points = default_points(system, **given)
        with pytest.raises(ValueError, match="no exact motion"):
            exact.motion_of(SYSTEMS[system], kind, points, 0)


def test_a_wrong_label_is_reported_and_fails_the_command(studies, monkeypatch, capsys):
    ds = studies["satellite"].copy(deep=True)
    ds["verdict"][:] = stress.Verdict.RIGHT
    ds["verdict"][0, -1, 0] = stress.Verdict.WRONG
    monkeypatch.setattr(stress, "stress", lambda name, **options: ds)
    monkeypatch.setattr(stress, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "satellite"]) == cli.FAILED
    output = capsys.readouterr().out
    assert "label not true: near 0, theta0 = 0.01; rk4, tolerance 1e-08" in output
    assert "labels that are not true: 1" in output
    assert cli.main(["stress", "pendulum"]) == cli.BAD_INPUT


def test_estimates_beyond_ten_times_fail_the_command(studies, monkeypatch):
    """More than 1 % of the compared runs, with every label true."""
    ds = studies["fixed_point"].copy(deep=True)
    ds["verdict"][:] = stress.Verdict.RIGHT
    monkeypatch.setattr(stress, "stress", lambda name, **options: ds)
    monkeypatch.setattr(stress, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "fixed_point"]) == cli.DONE
    ds["error_estimate"][:] = 1e-30
    assert stress.estimate_fails(ds)
    assert cli.main(["stress", "fixed_point"]) == cli.FAILED


@pytest.mark.usefixtures("coarse_lines")
def test_files_of_the_command(studies, monkeypatch, tmp_path):
    monkeypatch.setattr(stress, "stress", lambda name, **options: studies[name])
    monkeypatch.setattr(stress, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "-o", str(tmp_path / "out")]) == cli.DONE
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        f"{name}{suffix}" for name in SYSTEMS for suffix in (".nc", ".png")
    }
    assert cli.main(["stress", "satellite", "-o", str(tmp_path / "out")]) == cli.BAD_INPUT


def test_a_case_whose_true_label_is_unknown_is_an_error():
    """A motion that stays steady for the part of the run that the reference integrates proves nothing; one that drifts does."""
    case = StressCase("", "", 1e4, {"theta0": [0.5, 1e-7], "m": 1.5, "C": 1.3})
    with pytest.raises(ValueError, match=r"cannot decide the labels of points \[1\]$"):
        stress_truth.true_labels(
            SYSTEMS["satellite"], case_points(SYSTEMS["satellite"], case), Settings().at(1e-5)
        )


def test_the_despun_equivalent_moves_its_axis_alike():
    system = SYSTEMS["satellite"]
    points = default_points("satellite", theta0=1.2, k3=-59.5, m=50.0, psi0=0.3, C=1.2)
    despun, excess = system.despun(points)
    settings = Settings(method="rk8", step=1e-3)
    spun_result, despun_result = (evaluate(system, p, p, np.full(1, 2.0), settings) for p in (points, despun))
    assert excess == pytest.approx(-59.5 / 1.2)
    for name in ("theta_dot_rms", "psi_dot_std", "psi_dot_mean", "theta_max"):
        np.testing.assert_allclose(spun_result[name], despun_result[name], rtol=1e-6)
    np.testing.assert_allclose(spun_result["phi_dot_mean"], despun_result["phi_dot_mean"] - excess, rtol=1e-7)
