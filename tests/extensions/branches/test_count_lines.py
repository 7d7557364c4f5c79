"""Lines at which the number of equilibria changes."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from refusals import assert_refused
from truth import REFERENCE

import atlas
from atlas.analysis.metadata import scene_of
from atlas.analysis.plane import Plane
from atlas.extensions.branches.lines import CHANGE, MINIMA_COUNT, STABLE_COUNT, count_borders
from atlas.plotting.content import panel_of
from atlas.scene.read import scene_from

pytestmark = pytest.mark.usefixtures("whole_kernels")

# A rotor along the third axis of a body with A, B, C = 1, 1.3, 1.7: four equilibria vanish at each of these k3 / Omega,
# |C - B|, |C - A| and four times these (see tests/systems/test_satellite_equilibria.py).
CRITICAL = np.array([0.4, 0.7, 1.6, 2.8])


def rotor_scene(axes):
    return scene_from(
        {
            "schema": 1, "title": "counts", "system": "satellite", "fixed": {"A": 1.0, "B": 1.3, "C": 1.7},
            "axes": axes, "integration": {"duration": 0.1}, "outputs": {"variables": ["equilibrium_count"]},
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def rotor_map():
    axes = {"k3": {"from": 0.05, "to": 4.0, "count": 33}, "Omega": {"from": 0.5, "to": 1.5, "count": 5}}
    return atlas.run(rotor_scene(axes), progress=False)


def test_lines_are_where_equilibria_vanish(rotor_map):
    lines = rotor_map.atlas.boundary(variable="equilibrium_count")
    assert set(lines.kind.values) == {CHANGE}
    ratio = (lines.k3 / lines.Omega).values
    nearest = CRITICAL[np.abs(ratio[:, None] - CRITICAL).argmin(1)]
    np.testing.assert_allclose(ratio, nearest, rtol=1e-12)
    for value in CRITICAL:
        omega = lines.Omega.values[nearest == value]
        assert omega.min() < 0.55
        assert omega.max() > min(1.45, 4.0 / value - 0.05)


def test_borders_of_an_atlas(rotor_map):
    """Half a cell beyond the points, as on a map; four values of k3 / Omega are pitchforks, no others are borders."""
    ds = rotor_map.atlas.borders()
    ratio = (ds.k3 / ds.Omega).values
    np.testing.assert_allclose(np.abs(ratio[:, None] - CRITICAL).min(1), 0, atol=1e-12)
    assert float(ds.k3.max()) == pytest.approx(4.0 + 0.5 * (4.0 - 0.05) / 32)
    assert float(ds.A) == 1.0
    sentence = "borders: needs an atlas of a scene with two axes; use select for the others"
    assert_refused(rotor_map.isel(k3=0).atlas.borders, sentence)


@pytest.mark.long
def test_lines_on_one_axis():
    ds = atlas.run(rotor_scene({"k3": {"from": 0.05, "to": 4.0, "count": 33}}), progress=False)
    panel = panel_of(ds, "equilibrium_count", ["k3"], scene_of(ds), True)
    places = np.sort([float(line[0, 0]) for line in panel.borders[CHANGE]])
    np.testing.assert_allclose(places, CRITICAL, rtol=1e-12)
    assert not panel.families


def test_curve_around_a_region_that_no_point_meets():
    """Four more equilibria, two of them minima, within a closed curve with four cusps; the atlas sees 12 and 2 everywhere."""
    variable = MINIMA_COUNT
    axes = {"k1": np.linspace(0.85, 1.45, 4), "k2": np.linspace(-0.3, 0.3, 4)}
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}
    counts = atlas.equilibria("satellite", body | {k: xr.DataArray(v, dims=k) for k, v in axes.items()})[
        variable
    ]
    assert len(np.unique(counts)) == 1
    scene = scene_from(
        {
            "schema": 1, "title": "counts", "system": "satellite", "fixed": body,
            "axes": {name: {"values": values.tolist()} for name, values in axes.items()}, "integration": {"duration": 0.1},
        }
    )  # fmt: skip
    plane = Plane(scene, {name: (values[0], values[-1]) for name, values in axes.items()}, {})
    tip, line = sorted(count_borders(plane, counts)[CHANGE], key=len)
    assert tip[:, 0].max() == pytest.approx(0.852218, abs=1e-6)  # a cusp, 0.0005 wide where the plane begins
    np.testing.assert_allclose(line[0], line[-1], rtol=0, atol=1e-12)
    (i,) = np.nonzero(np.diff(np.sign(line[:, 1] - 0.02)))
    share = (0.02 - line[i, 1]) / (line[i + 1, 1] - line[i, 1])
    crossings = np.sort(line[i, 0] + share * (line[i + 1, 0] - line[i, 0]))
    verified = json.loads((REFERENCE / "branches.json").read_text())["satellite"][0]["folds"][3:5]
    folds = np.array([float(fold["k1"]) for fold in verified])  # at k2 = 0.02
    assert np.abs(crossings[:, None] - folds).min(0).max() < 1e-3
    assert np.abs(crossings[:, None] - folds).min(1).max() < 1e-3


@pytest.mark.long
def test_lines_between_numbers_of_stable_equilibria():
    """On both sides of each part of a line other numbers are stable, and sample points see no others than the lines separate."""
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.05}
    axes = {"k1": np.linspace(-3.0, -0.5, 12), "k2": np.linspace(0.8, 2.2, 12)}
    scene = scene_from(
        {
            "schema": 1, "title": "counts", "system": "satellite", "fixed": body,
            "axes": {name: {"values": values.tolist()} for name, values in axes.items()}, "integration": {"duration": 0.1},
            "outputs": {"variables": [STABLE_COUNT]},
        }
    )  # fmt: skip
    ds = atlas.run(scene, progress=False)
    lines = ds.atlas.boundary(variable=STABLE_COUNT)
    line, at = lines.line.values, np.stack([lines.k1, lines.k2], -1)
    cusp = [-1.29313360, 1.53621419]  # all three frequencies are the same
    far = np.abs(at - cusp).max(1) > 0.05  # elsewhere the line is near itself
    parts = np.flatnonzero((np.diff(line) == 0) & far[1:])[3::20]
    middle, along = 0.5 * (at[parts] + at[parts + 1]), at[parts + 1] - at[parts]
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.linalg.norm(along, axis=1)[:, None]
    sides = []
    for distance in (-3e-5, 3e-5):
        k1, k2 = (middle + distance * normal).T
        sides.append(
            (atlas.equilibria("satellite", body | {"k1": k1, "k2": k2}).stable == 1).sum("equilibrium")
        )
    assert len(parts) > 20
    assert (sides[0] != sides[1]).all()
    np.testing.assert_allclose(at[np.abs(at - cusp).max(1).argmin()], cusp, atol=1e-5)


def test_maps_draw_the_lines(rotor_map):
    figure = rotor_map.atlas.map("equilibrium_count")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [CHANGE]
    constant = rotor_map.isel(k3=slice(0, 2), Omega=slice(2, None))
    assert not constant.atlas.map("equilibrium_count").legends
