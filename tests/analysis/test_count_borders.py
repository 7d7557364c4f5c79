"""Lines at which the number of equilibria changes."""

from __future__ import annotations

import numpy as np
import pytest

import atlas
from atlas.analysis.boundary import CHANGE
from atlas.analysis.metadata import scene_of
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


def test_lines_on_one_axis():
    ds = atlas.run(rotor_scene({"k3": {"from": 0.05, "to": 4.0, "count": 33}}), progress=False)
    panel = panel_of(ds, "equilibrium_count", ["k3"], scene_of(ds), True)
    places = np.sort([float(line[0, 0]) for line in panel.borders[CHANGE]])
    np.testing.assert_allclose(places, CRITICAL, rtol=1e-12)
    assert not panel.families


def test_maps_draw_the_lines(rotor_map):
    figure = rotor_map.atlas.map("equilibrium_count")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"{CHANGE} (theory)"]
    constant = rotor_map.isel(k3=slice(0, 2))
    assert not constant.atlas.map("equilibrium_count").legends
