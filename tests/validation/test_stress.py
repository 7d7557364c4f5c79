"""The stress study: no label that is not true, report and command."""

import numpy as np
import pytest
from strategies import default_points

from atlas import cli
from atlas.label.pipeline import evaluate
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS
from atlas.validation import limits, stress

# Cases that take a fraction of a second each; `atlas stress` runs all of them.
QUICK = {
    "near 0", "near pi", "steep precession", "weak field", "separatrix", "unstable, short", "unstable, long",
    "unstable cone, short", "slower than the run", "at rest", "denormal", "overflow",
}  # fmt: skip


@pytest.fixture(scope="module")
def studies():
    """Study of the quick cases, by system."""
    return {
        name: stress.stress(name, [case for case in system.stress_cases() if case.name in QUICK])
        for name, system in SYSTEMS.items()
    }


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_label_differs_from_the_true_one(studies, system):
    ds = studies[system]
    assert not stress.mislabelled(ds).any(), stress.report(ds)
    assert not stress.unresolved(ds).any(), stress.report(ds)
    assert (ds.verdict == stress.Verdict.RIGHT).sum() > 300
    # beyond the stability limit nothing that moves has a label
    moving = ~np.isin(ds["case"], ["at rest", "slower than the run", "denormal"])
    unstable = ds.verdict.sel(level=["ratio 1.5", "ratio 0.9"]).values[..., moving]
    assert (unstable != stress.Verdict.RIGHT).all()


def test_a_wrong_label_is_reported_and_fails_the_command(studies, monkeypatch, capsys):
    ds = studies["satellite"].copy(deep=True)
    ds["verdict"][0, -1, 0] = stress.Verdict.WRONG
    monkeypatch.setattr(stress, "stress", lambda name, **options: ds)
    monkeypatch.setattr(limits, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "satellite"]) == cli.FAILED
    output = capsys.readouterr().out
    assert "label not true: near 0, theta0 = 0.01; rk4, tolerance 1e-08" in output
    assert "labels that are not true: 1" in output
    assert cli.main(["stress", "pendulum"]) == cli.BAD_INPUT


def test_files_of_the_command(studies, monkeypatch, tmp_path):
    monkeypatch.setattr(stress, "stress", lambda name, **options: studies[name])
    monkeypatch.setattr(limits, "limits", lambda: [("method",), ("rk4",)])
    assert cli.main(["stress", "-o", str(tmp_path / "out")]) == cli.DONE
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        f"{name}{suffix}" for name in SYSTEMS for suffix in (".nc", ".png")
    }
    assert cli.main(["stress", "satellite", "-o", str(tmp_path / "out")]) == cli.BAD_INPUT


def test_a_case_whose_true_label_is_unknown_is_an_error():
    """A motion that stays steady for the part of the run that the reference integrates proves nothing."""
    points = default_points("satellite", theta0=1e-7, m=1.5, C=1.3)
    with pytest.raises(ValueError, match="cannot decide"):
        stress.true_labels(SYSTEMS["satellite"], points, np.array([1e4]), Settings())


def test_the_despun_equivalent_moves_its_axis_alike():
    system = SYSTEMS["satellite"]
    points = default_points("satellite", theta0=1.2, k3=-59.5, m=50.0, psi0=0.3, C=1.2)
    despun, excess = system.despun_equivalent(points)
    settings = Settings(method="rk8", step=1e-3)
    spun_result, despun_result = (evaluate(system, p, p, np.full(1, 2.0), settings) for p in (points, despun))
    assert excess == pytest.approx(-59.5 / 1.2)
    for name in ("theta_dot_rms", "psi_dot_std", "psi_dot_mean", "theta_max"):
        np.testing.assert_allclose(spun_result[name], despun_result[name], rtol=1e-6)
    np.testing.assert_allclose(spun_result["phi_dot_mean"], despun_result["phi_dot_mean"] - excess, rtol=1e-7)
