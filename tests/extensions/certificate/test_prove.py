"""Scenes whose proved points are not integrated, and what maps, comparisons, dry runs and pages say of proofs."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from family_starts import STARTS
from refusals import assert_refused
from scenes import SMALL
from strategies import select

import atlas
from atlas import label_points
from atlas.analysis import compare
from atlas.analysis.summary import summary
from atlas.flags import Agreement, Label, Status
from atlas.plotting import content, maps
from atlas.runs.estimate import dry_run
from atlas.runs.plan import ScenePlan
from atlas.runs.reuse import Earlier

pytestmark = pytest.mark.usefixtures("coarse_lines", "whole_kernels")

VARIABLES = [
    "label", "label_inertial", "status", "family", "stable", "predicted", "predicted_inertial", "agreement",
    "theta_dot_rms", "growth_rate", "condition_residual", "label_proof", "label_inertial_proof", "frequency_1", "proof_bound",
]  # fmt: skip
SCENE = {
    "schema": 1,
    "system": "satellite",
    "fixed": {"A": 1.0, "B": 1.3, "k3": 0.3},
    "axes": {"theta0": {"from": 0.0, "to": 2.4e-3, "count": 9}, "C": {"values": [1.2, 1.6, 2.0, 2.4]}},
    "integration": {"duration": 30.0, "tolerance": 1e-5},
    "labels": {"rate_tolerance": 1e-3},
    "outputs": {"variables": VARIABLES},
}
PROVE = SCENE | {"integration": SCENE["integration"] | {"prove": True}}


@pytest.fixture(scope="module")
def whole():
    return atlas.run(SCENE, progress=False)


@pytest.fixture(scope="module")
def proved():
    return atlas.run(PROVE, progress=False)


def test_proved_points_are_not_integrated(whole, proved):
    """Their labels are those of the proofs, nothing is compared; the rest has the bits of a scene that integrates every point."""
    by_proof = (whole["label_proof"] != 0).values
    assert 8 < by_proof.sum() < 24
    assert (proved["status"].values[by_proof] == Status.OK).all()
    assert (proved["agreement"].values[by_proof] == Agreement.NOT_COMPARED).all()
    assert np.isnan(proved["theta_dot_rms"].values[by_proof]).all()
    assert proved["theta_dot_rms"].attrs["comment"] == "nan where a proof gives the label"
    assert not {name for name in VARIABLES if "proof gives" in whole[name].attrs.get("comment", "")}
    assert [name for name in VARIABLES if "proof gives" in proved[name].attrs.get("comment", "")] == [
        "theta_dot_rms"
    ]
    theory = [name for name in VARIABLES if name not in ("agreement", "theta_dot_rms")]
    for name in VARIABLES:
        mine, every = proved[name].values, whole[name].values
        where = np.s_[:] if name in theory else ~by_proof
        np.testing.assert_array_equal(mine[where], every[where])
    assert (whole["agreement"].values[by_proof] == Agreement.AGREE).all()


@pytest.mark.parametrize(
    ("theta0", "labels"), [((0.0, 1e-4), [Label.PERMANENT_ROTATION] * 2), ((0.1, 0.2), [Label.DRIFTING] * 2)]
)
def test_all_points_or_none_may_be_proved(theta0, labels):
    axes = {"axes": {"theta0": {"values": theta0}}, "outputs": {"variables": ["label", "stable"]}}
    ds = atlas.run(PROVE | axes, progress=False)
    assert [*ds["label"].values] == labels


def test_the_proofs_of_the_labels_are_in_the_atlas():
    """Also where the scene does not name them; no point is integrated of which every label of the scene is proved."""
    spin = {"fixed": {"A": 1.0, "B": 1.0, "C": 0.6, "psi0": np.pi / 2, "theta0": np.pi / 2},
            "axes": {"m": {"values": [0.0, 1e-3, 0.4]}}, "ties": {"k3": "-0.6 * m"}}  # fmt: skip
    for labels, integrated in ((["label"], [0, 0, 0]), (["label", "label_inertial"], [0, 1, 0])):
        names = [*labels, "end_time"]
        ds = atlas.run(PROVE | spin | {"outputs": {"variables": names}}, progress=False)
        assert {*ds} == {*names, *(f"{name}_proof" for name in labels)}
        assert [*np.isfinite(ds["end_time"].values)] == integrated
        assert (ds["label"] == Label.PERMANENT_ROTATION).all()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"outputs": {"variables": ["status"]}}, "integration.prove = true: no label of the satellite can be proved here; name label or label_inertial in outputs.variables"),
        ({"refine": {"levels": 1}}, "integration.prove = true: not together with refine, whose borders are those of measured labels"),
        ({"integration": {"prove": "yes"}}, "integration.prove = 'yes': must be true or false"),
    ],
)  # fmt: skip
def test_scenes_that_cannot_be_proved_are_refused(changes, sentence):
    assert_refused(lambda: atlas.load_scene(PROVE | changes), sentence)


def test_an_atlas_of_other_labels_gives_no_points(tmp_path):
    """There a point is left out where both labels are proved."""
    both, one = ({"outputs": {"variables": names}} for names in (["label", "label_inertial"], ["label"]))
    atlas.run(PROVE | both, tmp_path / "a.nc", progress=False)
    sentence = "...a.nc: its points have other bits than those of the scene: it differs in proved (label, label_inertial in ..., label in the scene)"
    assert_refused(lambda: Earlier.of(tmp_path / "a.nc", atlas.load_scene(PROVE | one)), sentence)


def test_without_the_extension_nothing_is_proved(without_extension):
    without_extension("certificate")
    scene = PROVE | {"outputs": {"variables": ["label"]}}
    sentence = "integration.prove = true: no label of the satellite can be proved here; no installed extension proves its labels"
    assert_refused(lambda: atlas.load_scene(scene), sentence)
    atlas.load_scene(SMALL)


def test_a_scene_that_is_written_out_is_the_same():
    scene = atlas.load_scene(PROVE | {"outputs": {"variables": ["label"]}})
    assert "prove = true" in scene.toml()
    assert scene.extensions == ["certificate"]
    assert atlas.load_scene(scene.toml()).toml() == scene.toml()


def test_a_dry_run_counts_the_proved_points(whole):
    count = int((whole[["label_proof", "label_inertial_proof"]].to_dataarray() != 0).all("variable").sum())
    first, second, *_ = dry_run(atlas.load_scene(PROVE)).splitlines()
    possible = int((whole["status"] != Status.IMPOSSIBLE_BODY).sum())
    assert first.startswith(f"36 points, about {possible - count} to integrate")
    assert second == f"about {count} points are proved and not integrated"


def legend(figure):
    return [entry.get_text() for each in figure.legends for entry in each.get_texts()]


@pytest.mark.long
def test_maps_outline_what_is_proved(whole, proved):
    outline = f"{content.PROVED} (theory)"
    assert content.PROVED in legend(maps.atlas_map(whole, "predicted_inertial"))  # a map of theory
    assert outline not in legend(maps.atlas_map(whole, "theta_dot_rms"))
    assert outline not in legend(maps.atlas_map(whole.drop_vars("label_proof"), "label"))
    shown = legend(maps.atlas_map(proved, "label"))
    assert outline in shown
    assert not {content.BY_PROOF, content.NO_MOTION} & {*shown}
    assert content.BY_PROOF in legend(maps.atlas_map(proved, "theta_dot_rms"))
    panel = content.panel_of(whole, "label", ["theta0", "C"], atlas.load_scene(SCENE), boundary=True)
    (line,) = panel.borders[content.PROVED]
    row = whole["label_proof"].sel(C=1.6).values
    edge = whole["theta0"].values[row != 0].max() + 0.15e-3
    np.testing.assert_allclose(line[line[:, 1] <= 2.0, 0], edge, rtol=1e-9)


def test_a_contradiction_is_counted_and_placed(whole, proved):
    count = int((whole["label_proof"] != 0).sum())
    line = (
        f"label proved for every duration: {count} of 36 points, {{}} of these measured, {{}} contradictions"
    )
    assert line.format(count, 0) in compare.report(whole).splitlines()
    report, compared = (
        compare.report(proved).splitlines(),
        int((whole["agreement"] != Agreement.NOT_COMPARED).sum()),
    )
    assert line.format(0, 0) in report
    left_out = int((whole[["label_proof", "label_inertial_proof"]].to_dataarray() != 0).all("variable").sum())
    assert any(each.startswith(f"compared: {compared - left_out} of 36 points, ") for each in report)
    wrong = whole.copy(deep=True)
    wrong["label"][1, 2] = Label.DRIFTING
    lines = compare.report(wrong).splitlines()
    at = lines.index(line.format(count, 1))
    assert lines[at + 1] == "  a defect of proof or run, please report it: theta0 = 0.0003, C = 2"


@pytest.mark.long
def test_pages_show_the_bound(whole):
    page = whole.atlas.page().html
    assert "limit of the deviation of a rate for all time" in page
    assert "proof_bound" in page


def test_the_summary_and_fractions_count_proved_labels(whole, proved):
    left_out = int((whole[["label_proof", "label_inertial_proof"]].to_dataarray() != 0).all("variable").sum())
    line = f"proved, not integrated: {left_out} points, whose labels are those of the proof"
    assert line in summary(proved).splitlines()
    assert "proved, not integrated" not in summary(whole)
    fractions, of_runs = proved.atlas.fractions(), whole.atlas.fractions()
    xr.testing.assert_allclose(fractions, of_runs)
    assert fractions.attrs == of_runs.attrs | {
        "comment": f"{left_out} of the points have the label of a proof and no run"
    }


@pytest.mark.parametrize("name", ["satellite", "fixed_point"])
def test_labels_of_proofs_are_those_of_runs(name):
    """Of starts beside steady motions of every family, seed 11; where a run is in doubt nothing is compared."""
    rng = np.random.default_rng(11)
    parts = [select(draw(rng, 12), slice(0, 12)) for draw in STARTS[name].values()]
    points = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    points["theta0"] = points["theta0"] + 10.0 ** rng.uniform(-9, -3, points["A"].size)
    labels = ["label", "label_inertial"][: 2 if name == "satellite" else 1]
    proofs = [f"{label}_proof" for label in labels]
    predicted = [label.replace("label", "predicted") for label in labels]
    names = [*labels, *proofs, *predicted, "status"]
    ds = label_points(name, points, duration=40.0, method="rk8", rate_tolerance=1e-3, variables=names)
    for label, proof, own in zip(labels, proofs, predicted, strict=True):
        proved = (ds[proof] != 0) & (ds.status == Status.OK)
        assert proved.sum() > 10
        assert (ds[label] == ds[own])[proved].all()


def test_runs_for_labels_say_what_proofs_would_save(whole):
    """The share of the points, of which the others are integrated; not of runs that need statistics, or leave points out already."""
    labels = {"outputs": {"variables": ["label", "label_inertial", "status"]}}
    possible = whole["status"] != Status.IMPOSSIBLE_BODY
    proved = (whole[["label_proof", "label_inertial_proof"]].to_dataarray() != 0).all("variable")
    share = 100 * int(proved.sum()) / int(possible.sum())
    line = f"prove: the labels of {share:.3g} % of the points are proved for every duration; with prove = true these need no run"
    (found,) = ScenePlan.of(atlas.load_scene(SCENE | labels)).proof_lines()
    assert found.startswith(line)
    assert line in dry_run(atlas.load_scene(SCENE | labels))
    for scene in (SCENE, PROVE | labels):
        assert ScenePlan.of(atlas.load_scene(scene)).proof_lines() == []
