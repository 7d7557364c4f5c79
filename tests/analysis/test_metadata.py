"""What the attributes and variables of a dataset tell its users."""

import numpy as np
import pytest
import xarray as xr

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
    assert metadata.map_variable(ds) == "status"
