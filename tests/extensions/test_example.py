"""The extension in docs/examples: one variable, one question, one line on a map."""

import numpy as np
import pytest

import atlas
from atlas import BadInput
from atlas.systems import SYSTEMS
from atlas.systems.base import derived_variables

pytestmark = pytest.mark.usefixtures("whole_kernels")
SCENE = """
schema = 1
system = "fixed_point"
fixed = { A = 1.0, B = 1.0, C = 0.5, theta0 = 0.7 }
axes.n = { from = 0.1, to = 2.0, count = 7 }
axes.m = { from = 0.1, to = 3.0, count = 9 }
integration = { duration = 1.0, tolerance = 1e-4 }
outputs = { variables = ["label", "start_energy"] }
"""


def test_variable_question_and_line(install_example):
    install_example("start_energy")
    ds = atlas.run(atlas.load_scene(SCENE), progress=False)
    theta, n, m = 0.7, ds.n, ds.m
    energy = 0.5 * ((n * np.sin(theta)) ** 2 + 0.5 * (m + n * np.cos(theta)) ** 2)
    np.testing.assert_allclose(ds.start_energy, energy.transpose(*ds.start_energy.dims), rtol=1e-14)
    assert ds.start_energy.attrs["units"] == "J"
    assert ds.atlas.energy_range() == (float(energy.min()), float(energy.max()))
    line = ds.atlas.boundary(variable="start_energy").sel(vertex=slice(None))
    line = line.where(line.kind == "energy = 1", drop=True)
    on_line = 0.5 * ((line.n * np.sin(theta)) ** 2 + 0.5 * (line.m + line.n * np.cos(theta)) ** 2)
    assert line.sizes["vertex"] > 50
    np.testing.assert_allclose(on_line, 1.0, atol=2e-4)
    assert "energy_range" in dir(ds.atlas)
    assert "ds.atlas.energy_range()" in repr(ds.atlas)
    with pytest.raises(BadInput, match="start_energy: not in this dataset"):
        ds.drop_vars("start_energy").atlas.energy_range()
    assert all("start_energy" in derived_variables(system) for system in SYSTEMS.values())


def test_without_the_extension_its_names_are_refused():
    with pytest.raises(BadInput, match="start_energy"):
        atlas.load_scene(SCENE)
    with pytest.raises(AttributeError, match="energy_range"):
        atlas.label_points("satellite", {"m": [0.5]}, duration=1.0, progress=False).atlas.energy_range()
