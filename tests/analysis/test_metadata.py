"""What the attributes and variables of a dataset tell its users."""

import numpy as np
import pytest
import xarray as xr

from atlas import BadInput
from atlas.analysis import metadata


@pytest.mark.parametrize("points", [metadata.MAX_POINTS, 3])
def test_a_map_shows_the_first_flags_that_differ_wherever_they_do(points, monkeypatch):
    """In the last part that is read as well."""
    monkeypatch.setattr(metadata, "MAX_POINTS", points)
    columns = {"label": np.ones(12), "status": np.r_[np.ones(11), 2], "family": np.arange(12) % 3}
    flags = {"flag_meanings": "a b c", "flag_values": [0, 1, 2]}
    ds = xr.Dataset(
        {name: (("x", "y"), np.int8(values).reshape(4, 3), flags) for name, values in columns.items()}
    )
    assert metadata.map_variable(ds) == "label"
    assert metadata.map_variable(ds.drop_vars("label")) == "status"


@pytest.mark.parametrize("values", [[0.0, 1.0], [0, 3], [-1, 0], [True, False]])
def test_values_that_are_no_flags_of_an_atlas_are_refused(values):
    ds = xr.Dataset({"label": ("x", np.array([0, 1, 2], np.int8)), "bad": ("y", np.array(values))})
    np.testing.assert_array_equal(metadata.flags_of(ds, "label", 3), [0, 1, 2])
    with pytest.raises(BadInput, match="bad: damaged: not the flags of an atlas, 0 to 2"):
        metadata.flags_of(ds, "bad", 3)
