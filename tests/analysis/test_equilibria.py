"""Equilibria of many bodies as a dataset."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import atlas
from atlas.flags import Completeness

BODY = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.1}
TOP = {"A": 1.0, "B": 1.5, "C": 2.0, "Mg": 2.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l1": 0.4}
COUNTS = ("equilibrium_count", "equilibrium_stable_count", "equilibrium_energy_stable_count")


def rotor_map():
    k1 = xr.DataArray(np.linspace(0.01, 2.0, 4), dims="k1")
    k2 = xr.DataArray(np.linspace(0.02, 1.0, 3), dims="k2")
    return atlas.equilibria("satellite", BODY | {"k1": k1, "k2": k2})


@pytest.mark.parametrize(
    ("system", "body", "dim", "values", "order"),
    [
        ("satellite", BODY | {"k2": 0.02}, "k1", [0.01, 0.7, 1.5], "potential"),
        ("fixed_point", TOP, "n", [0.0, 1.0, 2.5, 4.0], "theta0"),
        ("fixed_point", {"Mg": 1.0, "z0": 1.0}, "l3", [0.0, 3.0], "theta0"),
    ],
)
def test_each_body_has_the_equilibria_of_a_call_of_its_own(system, body, dim, values, order):
    ds = atlas.equilibria(system, body | {dim: xr.DataArray(values, dims=dim)})
    for value in values:
        own, one = ds.sel({dim: value}), atlas.equilibria(system, body | {dim: value})
        count = one.sizes["equilibrium"]
        assert own.equilibrium_count == count
        used = own.isel(equilibrium=slice(count))
        assert (own["index"][count:] == -1).all()
        for name in (order, "growth_rate"):
            np.testing.assert_allclose(used[name], one[name], rtol=0, atol=1e-7)
        for name in ("stable", "index", "circle"):
            np.testing.assert_array_equal(used[name], one[name])
        assert own.equilibrium_stable_count == (one.stable == 1).sum()
        assert own.equilibrium_energy_stable_count == (one["index"] == 0).sum()


def test_dimensions_and_coordinates_are_those_of_the_arrays():
    ds = rotor_map()
    assert dict(ds.sizes) == {"k1": 4, "k2": 3, "equilibrium": 24, "body_axis": 3}
    assert ds.equilibrium_count.dims == ("k1", "k2")
    assert ds.gamma.dims == ("k1", "k2", "equilibrium", "body_axis")
    assert ds.k1.attrs["units"] == "N m s"
    assert ds.A == 1.0
    assert "theta0" not in ds.coords
    orbits = xr.DataArray([1.0, 2.0], dims="orbit", coords={"orbit": ["low", "high"]})
    ds = atlas.equilibria("satellite", BODY | {"Omega": orbits})
    assert ds.Omega.dims == ("orbit",)
    assert ds.orbit.values.tolist() == ["low", "high"]
    # the counts do not depend on the units
    doubled = atlas.equilibria(
        "satellite", {"A": 2.0, "B": 2.6, "C": 3.4, "k3": [0.2, 0.4], "Omega": [1.0, 2.0]}
    )
    assert doubled.equilibrium_count.dims == ("point",)
    assert doubled.equilibrium_count[0] == doubled.equilibrium_count[1] == ds.equilibrium_count[0]


def test_tables_of_bodies():
    columns = {"A": [1.0, 1.0], "B": [1.3, 1.2], "C": [1.7, 1.5]}
    ds = atlas.equilibria("satellite", columns)
    assert ds.equilibrium_count.values.tolist() == [24, 24]
    xr.testing.assert_identical(atlas.equilibria("satellite", pd.DataFrame(columns)), ds)
    of_dataset = atlas.equilibria("satellite", xr.Dataset({k: ("point", v) for k, v in columns.items()}))
    xr.testing.assert_identical(of_dataset, ds)


def test_equilibria_of_many_bodies_survive_a_file(tmp_path):
    ds = rotor_map()
    ds.to_netcdf(tmp_path / "e.nc")
    with xr.open_dataset(tmp_path / "e.nc") as read:
        xr.testing.assert_identical(read.load(), ds)


def test_bodies_that_cannot_exist_or_have_no_isolated_equilibria():
    ds = atlas.equilibria("satellite", {"A": 1.0, "B": 1.0, "C": [1.5, 1.0, 9.0]})
    assert ds.completeness.values.tolist() == [
        Completeness.NOT_ISOLATED, Completeness.NOT_LISTED, Completeness.IMPOSSIBLE_BODY,
    ]  # fmt: skip
    for name in COUNTS:
        assert ds[name].isnull().all()
    assert ds.circle.sum("equilibrium").values.tolist() == [6, 0, 0]
    assert (ds["index"][2] == -1).all()
    sphere = atlas.equilibria("fixed_point", {"A": 1.0, "B": 1.0, "C": 1.0, "n": [1.0, 2.0]})
    assert (sphere.completeness == Completeness.NOT_ISOLATED).all()


def test_lazy_equilibria_have_the_bits_of_eager_ones():
    k1 = xr.DataArray([0.01, 0.7, 2.0, 3.0], dims="k1")
    C = xr.DataArray([1.7, 9.0], dims="C")  # in the second chunk along C no body is possible
    eager = atlas.equilibria("satellite", BODY | {"k1": k1, "C": C})
    chunked = BODY | {"k1": k1.chunk(k1=3), "C": C.chunk(C=1)}
    lazy = atlas.equilibria("satellite", chunked, max_equilibria=24)
    assert all(array.chunks is not None for array in lazy.data_vars.values())
    xr.testing.assert_identical(lazy.compute(), eager)
    few = atlas.equilibria("satellite", chunked, max_equilibria=int(eager.equilibrium_count.max()))
    assert (few["index"].sel(C=1.7).values >= 0).sum() == eager.equilibrium_count.sum()
    with pytest.raises(atlas.BadInput, match="max_equilibria: needed"):
        atlas.equilibria("satellite", chunked)
    with pytest.raises(atlas.BadInput, match=r"max_equilibria = 2: a body has \d+ equilibria"):
        atlas.equilibria("satellite", chunked, max_equilibria=2).compute()
    with pytest.raises(atlas.BadInput, match="max_equilibria = 0"):
        atlas.equilibria("satellite", BODY, max_equilibria=0)
    assert atlas.equilibria("satellite", BODY, max_equilibria=30)["index"].shape == (30,)


@pytest.mark.parametrize("has_coordinate", [True, False])
def test_a_coordinate_of_the_bodies_is_kept(has_coordinate):
    """A dimension without one takes the values of the only parameter along it."""
    coords = {"case": [30, 10, 20]} if has_coordinate else None
    ds = atlas.equilibria(
        "satellite", BODY | {"C": xr.DataArray([1.5, 1.6, 1.7], dims="case", coords=coords)}
    )
    np.testing.assert_array_equal(ds.case, [30, 10, 20] if has_coordinate else [1.5, 1.6, 1.7])
    np.testing.assert_array_equal(ds.C, [1.5, 1.6, 1.7])
