"""Curves of exact motions on planes, also where ties use an axis, and as data."""

import numpy as np
import pytest

import atlas
from atlas.errors import BadInput

THETA, TOP = 2.2, {"A": 1.0, "B": 1.0, "C": 0.4, "Mg": 1.0, "z0": 0.3, "theta0": 2.2}
AXES = {
    "m": {"from": 0.5, "to": 9.0, "count": 3},
    "n": {"from": -3.0, "to": 3.0, "count": 3},
}
TIED = {"w3": AXES["m"], "n": AXES["n"]}
SCENE = {"schema": 1, "system": "fixed_point", "fixed": TOP, "integration": {"duration": 20.0}}


def condition(m, n):
    """Of a heavy symmetric top: the moment of the weight turns the momentum."""
    return (TOP["C"] - TOP["A"]) * n**2 * np.cos(THETA) + TOP["C"] * m * n + TOP["Mg"] * TOP["z0"]


@pytest.mark.parametrize("is_tied", [False, True])
def test_slow_and_fast_precession_are_one_curve(is_tied):
    changes = {"axes": TIED, "ties": {"m": "w3 - n * cos(theta0)"}} if is_tied else {"axes": AXES}
    ds = atlas.run(SCENE | changes, progress=False)
    (curve,) = ds.atlas.families()["conical"]
    first, n = curve.T
    m = first - n * np.cos(THETA) if is_tied else first
    np.testing.assert_allclose(condition(m, n), 0, atol=1e-9)
    assert n.min() < -3  # the fast branch ends at the frame, the slow one near n = 0
    assert -0.2 < n.max() < 0
    middle = 0.5 * (curve[1:] + curve[:-1])
    m = middle[:, 0] - middle[:, 1] * np.cos(THETA) * is_tied
    assert np.abs(condition(m, middle[:, 1])).max() < 1e-3  # nothing is joined across the plane
    lines = ds.atlas.boundary()
    exact = lines.isel(vertex=lines.kind.values == "conical (exact)")
    assert np.unique(exact.line).size == 1
    m = exact.w3 - exact.n * np.cos(THETA) if is_tied else exact.m
    np.testing.assert_allclose(condition(m, exact.n), 0, atol=1e-3)  # cut at the ends of the axes
    assert exact.n.min() == -3
    legend = [text.get_text() for text in ds.atlas.map().legends[0].get_texts()]
    assert "conical (exact)" in legend


def test_a_region_of_exact_motions_has_no_curve_of_rounding():
    """Ties put every point of the quickstart that has a motion onto the family."""
    axes = {
        "l3": {"from": -2.5, "to": 2.5, "count": 3},
        "n": {"from": -2.0, "to": 2.0, "count": 3},
    }
    scene = atlas.example("quickstart")
    assert atlas.run(scene | {"axes": axes}, progress=False).atlas.families() == {}


def test_single_points_have_no_plane():
    points = {"sample": "sobol", "count": 4, "seed": 1, "ranges": {"theta0": {"from": 0.1, "to": 0.2}}}
    ds = atlas.run(SCENE | {"points": points, "fixed": {"Mg": 1.0}}, progress=False)
    with pytest.raises(BadInput, match="families: these are single points"):
        ds.atlas.families()
