"""Scenes whose proved points are not integrated, and what maps, comparisons, dry runs and pages say of proofs."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import assert_refused
from scenes import SMALL

import atlas
from atlas.analysis import compare
from atlas.flags import Agreement, Label, Status
from atlas.plotting import content, maps
from atlas.runs.estimate import dry_run
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
    """The rest has the bits of a scene that integrates every point."""
    by_proof = (whole["label_proof"] != 0).values
    assert 8 < by_proof.sum() < 24
    assert (proved["status"].values[by_proof] == Status.OK).all()
    for name in ("label", "label_inertial", "agreement"):
        assert (proved[name].values[by_proof] == 0).all()
    assert np.isnan(proved["theta_dot_rms"].values[by_proof]).all()
    theory = [
        name for name in VARIABLES if name not in ("label", "label_inertial", "agreement", "theta_dot_rms")
    ]
    for name in VARIABLES:
        mine, every = proved[name].values, whole[name].values
        where = np.s_[:] if name in theory else ~by_proof
        np.testing.assert_array_equal(mine[where], every[where])
    assert (whole["agreement"].values[by_proof] == Agreement.AGREE).all()


@pytest.mark.parametrize(("theta0", "labels"), [((0.0, 1e-4), [0, 0]), ((0.1, 0.2), [Label.DRIFTING] * 2)])
def test_all_points_or_none_may_be_proved(theta0, labels):
    axes = {"axes": {"theta0": {"values": theta0}}, "outputs": {"variables": ["label", "stable"]}}
    ds = atlas.run(PROVE | axes, progress=False)
    assert [*ds["label"].values] == labels


def test_the_proofs_of_the_labels_are_in_the_atlas():
    """Also where the scene does not name them; a point is left out where every label of the scene is proved."""
    spin = {"fixed": {"A": 1.0, "B": 1.0, "C": 0.6, "psi0": np.pi / 2, "theta0": np.pi / 2},
            "axes": {"m": {"values": [0.0, 1e-3, 0.4]}}, "ties": {"k3": "-0.6 * m"}}  # fmt: skip
    for labels, integrated in ((["label"], [0, 0, 0]), (["label", "label_inertial"], [0, 2, 0])):
        ds = atlas.run(PROVE | spin | {"outputs": {"variables": labels}}, progress=False)
        assert {*ds} == {*labels, *(f"{name}_proof" for name in labels)}
        assert [*ds["label"].values] == integrated


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


def test_maps_outline_what_is_proved(whole, proved):
    outline = f"{content.PROVED} (theory)"
    assert outline in legend(maps.atlas_map(whole, "predicted_inertial"))
    assert outline not in legend(maps.atlas_map(whole, "theta_dot_rms"))
    assert outline not in legend(maps.atlas_map(whole.drop_vars("label_proof"), "label"))
    shown = legend(maps.atlas_map(proved, "label"))
    assert {outline, content.BY_PROOF} < {*shown}
    assert content.NO_MOTION not in shown
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
    assert line.format(0, 0) in compare.report(proved).splitlines()
    wrong = whole.copy(deep=True)
    wrong["label"][1, 2] = Label.DRIFTING
    lines = compare.report(wrong).splitlines()
    at = lines.index(line.format(count, 1))
    assert lines[at + 1] == "  a defect of proof or run, please report it: theta0 = 0.0003, C = 2"


def test_pages_show_the_bound(whole):
    page = whole.atlas.page().html
    assert "limit of the deviation of a rate for all time" in page
    assert "proof_bound" in page
