"""Trust: uncertain cells of a grid against brute force, missed islands, and the exponent of a border."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scenes import labelled

from atlas import BadInput
from atlas.analysis import metadata
from atlas.flags import Label


def count_uncertain(label: np.ndarray, stride: int, step: int, inner: bool) -> tuple[int, int]:
    """Number of cells, and of cells whose points differ, by brute force."""
    coarse = label[(slice(None, None, stride),) * label.ndim]
    counts = [(n - 1) // step for n in coarse.shape]
    differ = 0
    for corner in itertools.product(*map(range, counts)):
        points = slice(None) if inner else slice(None, None, step)
        cell = coarse[tuple(slice(c * step, c * step + step + 1) for c in corner)][(points,) * label.ndim]
        differ += len(np.unique(cell)) > 1
    return int(np.prod(counts)), differ


@given(
    arrays(
        np.int8, array_shapes(min_dims=1, max_dims=2, min_side=5, max_side=12), elements=st.integers(2, 3)
    ),
    st.sampled_from([1, 7, 30, 1000]),
)
def test_trust_counts_cells(label, max_points):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metadata, "MAX_POINTS", max_points)
        trust = labelled(label).atlas.trust()
    for stride, share in zip(trust.stride.values, trust.uncertain.values, strict=True):
        cells, differ = count_uncertain(label, int(stride), 1, True)
        assert share == pytest.approx(differ / cells)
    cells, corners = count_uncertain(label, 1, 2, False)
    hidden = count_uncertain(label, 1, 2, True)[1] - corners
    if cells > corners:
        assert float(trust.missed) == pytest.approx(hidden / (cells - corners))
        assert float(trust.missed) <= float(trust.missed_bound) <= 1
    else:
        assert np.isnan(trust.missed)


def test_trust_distinguishes_smooth_from_random_borders():
    x, y = np.meshgrid(np.linspace(-1, 1, 301), np.linspace(-1, 1, 257), indexing="ij")
    smooth = labelled(np.where(x**2 + y**2 < 0.6, Label.PERMANENT_ROTATION, Label.DRIFTING)).atlas.trust()
    assert float(smooth.exponent) == pytest.approx(1.0, abs=0.1)
    assert float(smooth.uncertain[0]) < 0.02
    random = labelled(np.random.default_rng(1).integers(2, 4, (257, 257))).atlas.trust()
    assert float(random.exponent) == pytest.approx(0.0, abs=0.05)
    # binomial tail: at the bound, no miss among the cells has a probability of 5 %
    uniform = labelled(np.full((101, 101), Label.PERMANENT_ROTATION)).atlas.trust()
    assert float(uniform.missed) == 0
    assert (1 - float(uniform.missed_bound)) ** 2500 == pytest.approx(0.05)
    assert np.isnan(uniform.exponent)


def test_an_island_between_the_corners_is_counted_as_missed():
    label = np.full((9, 9), Label.PERMANENT_ROTATION)
    label[3, 5] = Label.DRIFTING
    trust = labelled(label).atlas.trust()
    assert float(trust.missed) == 1 / 16


def test_short_axes_are_separate_maps():
    label = np.full((9, 9, 2), Label.PERMANENT_ROTATION)
    label[..., 1] = Label.DRIFTING
    trust = labelled(label).atlas.trust()
    assert (trust.uncertain == 0).all()
    assert trust.attrs["axes"] == "x0, x1"
    with pytest.raises(BadInput, match="5 values or more"):
        labelled(label[:4, :4]).atlas.trust()
