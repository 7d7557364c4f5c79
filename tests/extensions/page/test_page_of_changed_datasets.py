"""Pages of atlases that plain xarray has reordered or changed."""

import numpy as np
import pytest
import xarray as xr
from test_changed_datasets import REORDERED, changed_atlas

from atlas.analysis import select
from atlas.extensions.page.content import page_layout
from atlas.extensions.page.page import atlas_page

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_lines")


def test_pages_show_the_same_values_of_a_reordered_axis(monkeypatch):
    whole = changed_atlas("cylindrical")
    monkeypatch.setattr(select, "MAX_CELLS", 5)
    shuffled = REORDERED["shuffled"](whole, np.random.default_rng(6))
    xr.testing.assert_identical(page_layout(shuffled, 20).ds, page_layout(whole, 20).ds)


def test_pages_of_changed_coordinates_have_no_theory():
    whole = changed_atlas("solved")
    ds = whole.assign_coords(theta0=np.rad2deg(whole.theta0).assign_attrs(whole.theta0.attrs))
    page = atlas_page(ds).html
    assert "No motions in this page: theta0 = 5.7" in page
    assert "No theory in this page: theta0 = 5.7" in page
