"""Comparison with theory: agreement, confusion, and what the report says."""

import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp

import atlas
from atlas import load_scene
from atlas.analysis import compare
from atlas.flags import Agreement, Label
from atlas.label import theory

flags = hnp.arrays(np.int8, 30, elements={"min_value": 0, "max_value": len(Label) - 1})


@given(flags, flags)
def test_agreement_and_confusion_tell_the_same(label, predicted):
    table = compare.confusion(label, predicted)
    found = theory.agreement(label, predicted)
    assert table.sum() == label.size
    for i, p in enumerate(Label.meanings()):
        for j, m in enumerate(Label.meanings()):
            here = (predicted == i) & (label == j)
            assert table[i, j] == here.sum()
            if "not_computed" in (p, m) or m == "unresolved":
                expected = "not_compared"
            elif p == m:
                expected = "agree"
            elif m == "drifting":
                expected = "theory_only"
            elif p == "drifting":
                expected = "numerics_only"
            else:
                expected = "differ"
            assert (found[here] == list(Agreement.meanings()).index(expected)).all()


def test_off_the_families_the_satellite_drifts_and_a_free_body_is_not_judged():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start |= {
        "theta0": np.array([0.5, 0.5]),
        "Omega": np.array([1.0, 0.0]),
        "theta_dot0": np.array([0.1, 0.1]),
    }
    found = theory.predict(system, start, 1e-5, nudged=False)
    assert found["family"].tolist() == [0, 0]
    assert [list(Label.meanings())[i] for i in found["predicted"]] == ["drifting", "not_computed"]


def test_a_nudge_turns_the_prediction_by_stability():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start["C"] = np.array([1.2, 0.5])  # cylindrical: stable, unstable
    for nudged, expected in ((False, ["permanent_rotation"] * 2), (True, ["permanent_rotation", "drifting"])):
        found = theory.predict(system, start, 1e-5, nudged)
        assert [list(Label.meanings())[i] for i in found["predicted"]] == expected


def test_report_counts_and_names_the_worst(small_scene):
    ds = atlas.run(load_scene(small_scene), progress=False)
    text = compare.report(ds)
    assert f"of {ds.label.size} points" in text
    assert "linearly stable points that drift" in text
    assert "no time to grow" in text
    wrong = ds.copy()
    wrong["label"] = ds.label.copy()
    wrong.label[2, 3] = 3 if int(ds.predicted[2, 3]) == 2 else 2
    text = compare.report(wrong, worst=1)
    named = text.splitlines()[-1]
    assert f"sigma = {float(ds.sigma[2]):.9g}, theta0 = {float(ds.theta0[3]):.9g}" in compare.report(
        wrong, worst=99
    )
    assert "theory" in named
