"""Errors of borders: cells, distances from closed forms of theory, points that half the step changes, and the sentence."""

import numpy as np
import pytest
from scipy.optimize import brentq

import atlas
from atlas import BadInput
from atlas.flags import Status

pytestmark = pytest.mark.usefixtures("whole_kernels")

AXES = {"sigma": {"from": 1.05, "to": 1.95, "count": 19}, "m": {"from": -1.5, "to": 0.5, "count": 21}}


@pytest.fixture(scope="module")
def ds():
    """Of flat satellites about the normal, which are unstable between two limits."""
    return atlas.run(atlas.example("stability_cylindrical", axes=AXES), progress=False)


def limits(sigma, m):
    """Factors that change their sign at the two limits of stability of a flat body, A = Omega = 1: U1 and U2."""
    second = sigma * (1 + m) - 1
    return second + 3 * (sigma - 1), second


def roots(dim, other):
    """Places of the limits along an axis, at a value of the other one."""
    along = {"sigma": lambda v: limits(v, other), "m": lambda v: limits(other, v)}[dim]
    low, high = {"sigma": (0.9, 2.1), "m": (-2.0, 1.0)}[dim]
    signs = np.array(along(low)) * np.array(along(high)) < 0
    return [brentq(lambda v, k=k: along(v)[k], low, high) for k in np.flatnonzero(signs)]


def changes(ds, dim):
    """Pairs of neighbours along an axis with different labels: the other coordinate, both values."""
    (other,) = [each for each in ds.label.dims if each != dim]
    at = ds[dim].values
    for row in range(ds.sizes[other]):
        flags = ds.label.isel({other: row}).values
        for j in np.flatnonzero(np.diff(flags)):
            yield float(ds[other][row]), at[j], at[j + 1]


def test_distances_are_those_from_the_roots_of_closed_forms(ds):
    """Of every pair of neighbours, by Brent's method along its row or column."""
    result = ds.atlas.border_error()
    assert result.sizes == {"border": 1, "axis": 2}
    border = result.isel(border=0)
    names = ("permanent_rotation", "drifting", "stability limit")
    assert tuple(border[name].item() for name in ("first", "second", "curve")) == names
    for i, dim in enumerate(("sigma", "m")):
        distances = [
            min(abs(root - (low + high) / 2) for root in roots(dim, other))
            for other, low, high in changes(ds, dim)
        ]
        assert border.pairs[i] == len(distances) > 10
        spacing = float(np.diff(ds[dim]).max())
        assert border.half_cell[i] == pytest.approx(spacing / 2)
        assert border.distance_median[i] == pytest.approx(np.median(distances), abs=1e-4)
        assert border.distance_largest[i] == pytest.approx(max(distances), abs=1e-4)
    assert [int(result[f"points_{name}"]) for name in ("changed", "checked")] == [
        ds.attrs["atlas_half_step_changed"],
        ds.attrs["atlas_half_step_points"],
    ]


def test_the_sentence_has_the_numbers_of_the_dataset(ds):
    result = ds.atlas.border_error()
    border = result.isel(border=0)
    half, median, largest = (
        f"{float(border[name][0]):.2g} in C/A and {float(border[name][1]):.2g} in m"
        for name in ("half_cell", "distance_median", "distance_largest")
    )
    first = (
        f"The border between permanent rotation and drifting is known to half a cell, {half}, and differs from theory's"
        f" stability limit by {median} in the median and at most {largest}"
    )
    whole = f"; 0 of {int(result.points_checked)} points of the whole run checked at half the step changed their label."
    assert str(result) == str(border) == first + whole
    assert "\n" not in str(result)
    assert repr(result) != str(result)
    uniform = ds.isel(m=slice(-3, None))
    assert str(uniform.atlas.border_error()) == "There is no border; " + whole[2:]


@pytest.mark.long
def test_points_beside_a_border_are_counted_that_are_sensitive_to_the_step(ds):
    """The ends of its pairs along both axes, each once; only where every point was checked."""
    assert "checked" not in ds.atlas.border_error()
    scene = atlas.example("stability_cylindrical", axes=AXES, integration={"check_half_step": "all"})
    every = ds.copy(deep=True).assign_attrs(atlas_scene=atlas.load_scene(scene).toml())
    label = ds.label.transpose("sigma", "m").values
    ends = np.zeros(label.shape, bool)
    for i, j in np.argwhere(np.diff(label, axis=0)):
        ends[i : i + 2, j] = True
    for i, j in np.argwhere(np.diff(label, axis=1)):
        ends[i, j : j + 2] = True
    for i, j in (*np.argwhere(ends)[:3], np.argwhere(~ends)[0]):
        every.status[i, j] = Status.STEP_SENSITIVE
    result = every.atlas.border_error()
    assert (result.checked.item(), result.sensitive.item()) == (ends.sum(), 3)
    assert f", where 3 of {ends.sum()} points are sensitive to the step; 0 of " in str(result)


@pytest.mark.long
def test_degrees_a_single_axis_and_numbers_of_equilibria(ds):
    axes = {"sigma": {"count": 12}, "theta0": {"count": 20}}
    tilted = atlas.run(atlas.example("stability_perp_velocity", axes=axes), progress=False)
    rad, deg = (tilted.atlas.border_error(degrees=degrees) for degrees in (False, True))
    assert list(deg.unit) == ["1", "degree"]
    for name in ("half_cell", "distance_median", "distance_largest"):
        np.testing.assert_allclose(deg[name], rad[name] * [1, 180 / np.pi])
    np.testing.assert_array_equal(deg.pairs, rad.pairs)
    row = ds.isel(sigma=[7])
    own = row.atlas.border_error()
    sigma = float(ds.sigma[7])
    middle = [(low + high) / 2 for other, low, high in changes(ds, "m") if other == sigma]
    expected = [min(abs(each - root) for root in roots("m", sigma)) for each in middle]
    assert own.distance_largest == pytest.approx(max(expected), abs=1e-4)
    assert list(own.axis) == ["m"]
    others = ds.assign(words=ds.label.astype(str)).assign_coords(m=np.arange(ds.sizes["m"]))
    for variable in ("theta_max", "words", "m"):
        with pytest.raises(BadInput, match=f"{variable}: not a flag variable of this atlas"):
            others.atlas.border_error(variable)


@pytest.mark.long
def test_numbers_of_equilibria_change_at_their_borders_within_half_a_cell():
    scene = atlas.example("equilibrium_count", axes={"k1": {"count": 16}, "k2": {"count": 16}})
    counts = atlas.run(scene, progress=False).atlas.border_error("equilibrium_count")
    assert set(counts.curve.values) == {"change of the number"}
    assert {(int(a), int(b)) for a, b in zip(counts["first"], counts["second"], strict=True)} <= {
        (low, low + 4) for low in range(8, 24, 4)
    } | {(8, 16), (12, 20), (16, 24), (8, 20), (12, 24)}
    assert (counts.distance_largest <= counts.half_cell * 1.001).where(counts.pairs > 0, True).all()
