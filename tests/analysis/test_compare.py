"""Comparison with theory: agreement, confusion table and report."""

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
def test_agreement_and_confusion_table_are_consistent(label, predicted):
    table = compare.confusion(label, predicted)
    result = theory.agreement(label, predicted)
    assert table.sum() == label.size
    for p in Label:
        for m in Label:
            points = (predicted == p) & (label == m)
            assert table[p, m] == points.sum()
            if Label.NOT_COMPUTED in (p, m) or m == Label.UNRESOLVED:
                expected = Agreement.NOT_COMPARED
            elif p == m:
                expected = Agreement.AGREE
            elif m == Label.DRIFTING:
                expected = Agreement.THEORY_ONLY
            elif p == Label.DRIFTING:
                expected = Agreement.NUMERICS_ONLY
            else:
                expected = Agreement.DIFFER
            assert (result[points] == expected).all()


def test_off_the_families_a_satellite_drifts_and_a_free_body_has_no_prediction():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start |= {
        "theta0": np.array([0.5, 0.5]),
        "Omega": np.array([1.0, 0.0]),
        "theta_dot0": np.array([0.1, 0.1]),
    }
    predicted = theory.predict(system, start, 1e-5, nudged=False)
    assert predicted["family"].tolist() == [0, 0]
    assert predicted["predicted"].tolist() == [Label.DRIFTING, Label.NOT_COMPUTED]


def test_the_prediction_for_a_nudged_start_depends_on_stability():
    system = load_scene('schema = 1\nsystem = "satellite"\n[axes.theta0]\nvalues = [0.5]\n').system
    start = {name: np.array([p.default, p.default]) for name, p in system.parameters.items()}
    start["C"] = np.array([1.2, 0.5])  # cylindrical: stable, unstable
    for nudged, unstable in ((False, Label.PERMANENT_ROTATION), (True, Label.DRIFTING)):
        predicted = theory.predict(system, start, 1e-5, nudged)["predicted"]
        assert predicted.tolist() == [Label.PERMANENT_ROTATION, unstable]


def test_the_report_counts_and_lists_the_worst_disagreements(small_scene):
    ds = atlas.run(load_scene(small_scene), progress=False)
    text = compare.report(ds)
    assert f"of {ds.label.size} points" in text
    assert "linearly stable points that drift" in text
    assert "no time to grow" in text
    wrong = ds.copy()
    wrong["label"] = ds.label.copy()
    steady = int(ds.predicted[2, 3]) == Label.PERMANENT_ROTATION
    wrong.label[2, 3] = Label.DRIFTING if steady else Label.PERMANENT_ROTATION
    coordinates = f"sigma = {float(ds.sigma[2]):.9g}, theta0 = {float(ds.theta0[3]):.9g}: theory"
    assert coordinates in compare.report(wrong, worst=99)
    assert "theory" in compare.report(wrong, worst=1).splitlines()[-1]
