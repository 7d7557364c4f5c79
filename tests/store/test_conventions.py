"""Attributes of the variables by the CF conventions."""

import numpy as np
import pytest

import atlas
from atlas import load_scene
from atlas.scene.read import scene_from
from atlas.store.dataset import dataset

pytestmark = pytest.mark.usefixtures("whole_kernels")


def test_variables_are_described(small_scene):
    ds = atlas.run(load_scene(small_scene), progress=False)
    for name, variable in ds.variables.items():
        assert variable.attrs["long_name"], name
        if "flag_meanings" in variable.attrs:
            values, meanings = variable.attrs["flag_values"], variable.attrs["flag_meanings"].split()
            assert values.dtype == variable.dtype == np.int8
            assert values.tolist() == list(range(len(meanings)))
        else:
            assert variable.attrs["units"], name


def test_parameters_without_a_default_are_coordinates_where_a_scene_gives_them():
    """Fixed or tied; of the others, as here gamma10, a column would hold nan alone."""
    scene = scene_from({
        "schema": 1, "system": "fixed_point", "fixed": {"q0": 0.2, "m": 0.0, "n": 0.0},
        "axes": {"r0": {"from": 1.0, "to": 2.0, "count": 3}}, "ties": {"p0": "r0 + q0"},
        "integration": {"duration": 1.0}, "outputs": {"variables": ["label"]},
    })  # fmt: skip
    ds = dataset(scene, {"label": np.zeros(3, np.int8)})
    np.testing.assert_array_equal(ds.p0, ds.r0 + 0.2)
    assert ds.p0.dims == ("r0",)
    assert ds.q0 == 0.2
    assert "gamma10" not in ds.coords


def test_labels_name_what_qualifies_them(scene_text):
    ds = atlas.run(load_scene(scene_text({})), progress=False)
    for name in ("label", "label_inertial"):
        assert ds[name].attrs["ancillary_variables"] == "status error_estimate"
    assert [name for name in ds.variables if "ancillary_variables" in ds[name].attrs] == [
        "label",
        "label_inertial",
    ]
    some = scene_text({"outputs.variables": ["label", "status", "step"]})
    assert atlas.run(load_scene(some), progress=False).label.attrs["ancillary_variables"] == "status"


def test_points_have_the_attributes_of_an_atlas():
    for variables, expected in ((None, "status error_estimate"), (["label", "step"], None)):
        ds = atlas.label_points(
            "satellite", {"theta0": [0.4, 0.9]}, duration=1.0, step=0.1, variables=variables
        )
        assert ds.label.attrs.get("ancillary_variables") == expected
