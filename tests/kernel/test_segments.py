"""Runs that are interrupted early where the label is certain."""

import numpy as np
import pytest

import atlas
from atlas.kernel import ensemble

pytestmark = pytest.mark.usefixtures("whole_kernels")


class _Dirty:
    """NumPy whose new arrays of floats are full of infinities, as unused memory may be."""

    def __getattr__(self, name):
        return getattr(np, name)

    @staticmethod
    def empty(shape, dtype=float):
        return np.full(shape, np.inf if dtype is float else 0, dtype)


@pytest.mark.long
def test_sums_of_points_that_have_not_begun_decide_nothing(monkeypatch):
    """The first point has few steps and begins later than the second; what its sums hold before gives no warning."""
    points = {"theta0": [0.5, 0.6], "m": [1.0, 100.0], "Mg": 1.0}
    run = {"duration": 100.0, "variables": ["label"], "progress": False}
    expected = atlas.label_points("fixed_point", points, **run)
    monkeypatch.setattr(ensemble, "np", _Dirty())
    label = atlas.label_points("fixed_point", points, **run).label
    np.testing.assert_array_equal(label, expected.label)
