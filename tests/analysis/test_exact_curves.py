"""Curves of exact motions on planes, also where ties use an axis, and as data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane

import atlas
from atlas.analysis import exact_curves
from atlas.analysis import plane as planes
from atlas.errors import BadInput
from atlas.theory.motions import condition_residual

pytestmark = pytest.mark.usefixtures("whole_kernels")

THETA, TOP = 2.2, {"A": 1.0, "B": 1.0, "C": 0.4, "Mg": 1.0, "z0": 0.3, "theta0": 2.2}
AXES = {"m": {"from": 0.5, "to": 9.0, "count": 3}, "n": {"from": -3.0, "to": 3.0, "count": 3}}
TIED = {"w3": AXES["m"], "n": AXES["n"]}
SCENE = {"schema": 1, "system": "fixed_point", "fixed": TOP, "integration": {"duration": 20.0}}


def condition(m, n):
    """Of a heavy symmetric top: the moment of the weight turns the momentum."""
    return (TOP["C"] - TOP["A"]) * n**2 * np.cos(THETA) + TOP["C"] * m * n + TOP["Mg"] * TOP["z0"]


@pytest.mark.long
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
    axes = {"l3": {"from": -2.5, "to": 2.5, "count": 3}, "n": {"from": -2.0, "to": 2.0, "count": 3}}
    scene = atlas.example("quickstart")
    assert atlas.run(scene | {"axes": axes}, progress=False).atlas.families() == {}


def test_single_points_have_no_plane():
    points = {"sample": "sobol", "count": 4, "seed": 1, "ranges": {"theta0": {"from": 0.1, "to": 0.2}}}
    ds = atlas.run(SCENE | {"points": points, "fixed": {"Mg": 1.0}}, progress=False)
    with pytest.raises(BadInput, match="families: these are single points"):
        ds.atlas.families()


CURVE_SCENE = """
schema = 1
system = "satellite"
[fixed]
m = {m}
C = {C}
psi0 = 1.5707963267948966
mu3 = {mu3}
h3 = 0.4
[axes.theta0]
from = 0.1
to = 1.5
count = 4
[axes.k3]
from = -4.0
to = 4.0
count = 3
"""


@pytest.mark.long
@settings(max_examples=10)
@given(
    m=st.floats(-2, 2).filter(lambda m: abs(m) > 1e-6), C=st.floats(0.3, 1.9), mu3=st.sampled_from([0.0, 0.5])
)
def test_family_curves_are_exact_motions(m, C, mu3):
    view = plane(CURVE_SCENE.format(m=m, C=C, mu3=mu3))
    curves = exact_curves.family_curves(view)
    assert "perp_velocity" in curves
    for lines in curves.values():
        for line in lines:
            theta, k3 = line[np.isfinite(line).all(1)].T
            points = view.points({"theta0": theta, "k3": k3}).points
            residual = condition_residual(view.scene.system, points)
            assert residual.max() < 1e-7


@pytest.mark.long
def test_family_curves_for_either_axis(scene_text, without_family):
    view = plane(scene_text(without_family))
    (curve,) = exact_curves.family_curves(view)["perp_velocity"]  # only theta0 can be solved for
    sigma, theta = curve[np.isfinite(curve).all(1)].T
    assert sigma.size > 100
    # k3 = 0: 4 Omega c (A - C) = C m
    np.testing.assert_allclose(4 * np.cos(theta) * (1 - sigma), 0.5 * sigma, atol=1e-9)
    transposed = planes.Plane(view.scene, dict(reversed(view.extent.items())), {})
    (transposed_curve,) = exact_curves.family_curves(transposed)["perp_velocity"]
    np.testing.assert_array_equal(transposed_curve[:, ::-1], curve)


def test_a_family_on_one_axis_is_a_point(scene_text, without_family):
    (point,) = exact_curves.family_curves(plane(scene_text(without_family), sigma=0.8))["perp_velocity"]
    np.testing.assert_allclose(point, [[np.pi / 3]], atol=1e-9)  # 4 Omega c (A - C) = C m


def test_a_plane_that_lies_on_a_family_has_no_curve(small_scene):
    assert exact_curves.family_curves(plane(small_scene)) == {}


@pytest.mark.long
def test_an_offset_axis_has_its_family_at_zero():
    scene = CURVE_SCENE.format(m=0.5, C=0.7, mu3=0.0).replace(
        "from = -4.0\nto = 4.0\ncount = 3", "from = -0.1\nto = 0.2\ncount = 4\noffset_from_family = true"
    )
    view = plane(scene + '[family]\nname = "perp_velocity"\nsolve = ["k3"]\n')
    assert list(view.extent) == ["theta0", "k3_offset"]
    (line,) = exact_curves.family_curves(view)["perp_velocity"]
    np.testing.assert_array_equal(line, [[0.1, 0.0], [1.5, 0.0]])
    away = planes.Plane(view.scene, view.extent | {"k3_offset": (0.1, 0.2)}, {})
    assert exact_curves.family_curves(away) == {}
    figure = atlas.run(view.scene, progress=False).atlas.map()
    assert figure.axes[0].get_ylabel() == "$k_3$, offset from the family (N m s)"
    assert "perp velocity (exact)" in [text.get_text() for text in figure.legends[0].get_texts()]
