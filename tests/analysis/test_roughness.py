"""Second differences of the range of theta over a grid."""

import numpy as np
import pytest
import xarray as xr

import atlas

pytestmark = pytest.mark.usefixtures("whole_kernels")


def grid_of(span):
    dims = ("m", "theta0")[: span.ndim]
    coords = {dim: np.arange(length) for dim, length in zip(dims, span.shape, strict=True)}
    return xr.Dataset({"theta_min": (dims, 0 * span), "theta_max": (dims, span)}, coords)


def test_second_differences():
    i, j = np.mgrid[:6, :5].astype(float)
    ds = grid_of(0.5 * i * i + 0.1 * j * j + i * j)
    rough = ds.atlas.roughness()
    assert rough.dims == ("m", "theta0")
    np.testing.assert_allclose(rough[1:-1, 1:-1], 1.2)
    assert np.isnan(rough[0]).all()
    np.testing.assert_allclose(ds.atlas.roughness("theta0")[:, 1:-1], 0.2)


def test_smooth_motions_are_less_rough_than_chaotic_ones():
    points = {"A": 1.0, "B": 1.3, "C": 1.6, "theta0": 0.1}
    span = []
    for psi0 in (0.3, 1.2):  # regular and chaotic librations
        ds = atlas.label_points(
            "satellite", points | {"psi0": psi0 + 1e-3 * np.arange(7)}, duration=400.0, method="rk8", progress=False,
            tolerance=1e-6,
        )  # fmt: skip
        span.append((ds.theta_max - ds.theta_min).values)
    rough = [float(grid_of(each).atlas.roughness().median()) for each in span]
    assert rough[1] > 30 * rough[0]


@pytest.mark.parametrize(
    ("ds", "problem"),
    [
        (xr.Dataset(), "theta_min: not in this dataset"),
        (grid_of(np.ones(2)), "needs an axis of at least 3 values"),
        (grid_of(np.ones((4, 2))), "theta0: not an axis of at least 3 values; allowed: m"),
    ],
)
def test_what_has_no_roughness(ds, problem):
    axes = ("theta0",) if "allowed" in problem else ()
    with pytest.raises(atlas.BadInput, match=problem):
        ds.atlas.roughness(*axes)
