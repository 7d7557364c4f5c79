"""Pages of atlases that plain xarray has reordered or changed: the same values, and no theory of another scene."""

import numpy as np
import pytest
import xarray as xr
from test_changed_datasets import REORDERED, changed_atlas

from atlas.extensions.page.content import page_layout
from atlas.extensions.page.page import atlas_page

pytestmark = pytest.mark.usefixtures("whole_kernels", "coarse_figures")


def test_a_reordered_axis_gives_the_same_values():
    whole = changed_atlas("cylindrical")
    shuffled = REORDERED["shuffled"](whole, np.random.default_rng(6))
    xr.testing.assert_identical(page_layout(shuffled, 20).ds, page_layout(whole, 20).ds)


def test_changed_coordinates_have_no_theory():
    whole = changed_atlas("solved")
    ds = whole.assign_coords(theta0=np.rad2deg(whole.theta0).assign_attrs(whole.theta0.attrs))
    page = atlas_page(ds).html
    assert "No motions in this page: theta0 = 5.7" in page
    assert "No theory in this page: theta0 = 5.7" in page
