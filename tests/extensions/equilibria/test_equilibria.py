"""Equilibria of many bodies as a dataset."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from refusals import assert_refused

import atlas
from atlas.flags import Completeness, Stability
from atlas.systems import SYSTEMS
from atlas.systems.satellite import equations, initial
from atlas.theory.motions import condition_residual

BODY = {"A": 1.0, "B": 1.3, "C": 1.7, "k3": 0.1}
TOP = {"A": 1.0, "B": 1.5, "C": 2.0, "Mg": 2.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l1": 0.4}
SATELLITE, FIXED_POINT = SYSTEMS["satellite"], SYSTEMS["fixed_point"]
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


@pytest.mark.long
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


@pytest.mark.parametrize("function", [atlas.equilibria, atlas.label_points])
def test_masked_bodies_are_refused(function):
    masked = np.ma.array([0.1, 0.2, 0.3], mask=[0, 0, 1])
    sentence = "point 2 (counted from 0): k1 is masked or was never written; must be a finite number"
    assert_refused(lambda: function("satellite", BODY | {"k1": masked}), sentence)


@pytest.mark.parametrize("has_coordinate", [True, False])
def test_a_coordinate_of_the_bodies_is_kept(has_coordinate):
    """A dimension without one takes the values of the only parameter along it."""
    coords = {"case": [30, 10, 20]} if has_coordinate else None
    ds = atlas.equilibria(
        "satellite", BODY | {"C": xr.DataArray([1.5, 1.6, 1.7], dims="case", coords=coords)}
    )
    np.testing.assert_array_equal(ds.case, [30, 10, 20] if has_coordinate else [1.5, 1.6, 1.7])
    np.testing.assert_array_equal(ds.C, [1.5, 1.6, 1.7])


def test_equilibria_of_a_gyrostat_are_at_rest_and_counted():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "k1": 0.1, "k2": 0.2, "k3": -0.05}
    equilibria = atlas.equilibria("satellite", body)
    assert 8 <= equilibria.sizes["equilibrium"] <= 24
    assert not equilibria.circle.any()
    assert ((-1) ** equilibria["index"].astype(int)).sum() == 0
    assert set(equilibria) >= {
        "theta0",
        "psi0",
        "phi0",
        "index",
        "circle",
        "stable",
        "growth_rate",
        "potential",
    }
    assert equilibria.stable.attrs["flag_meanings"] == "unknown stable unstable"
    assert ((equilibria.stable == Stability.STABLE) == (equilibria.growth_rate == 0)).all()
    assert (
        equilibria.stable.where(equilibria["index"] == 0, Stability.STABLE) == Stability.STABLE
    ).all()  # minima
    points = {
        p.name: np.full(equilibria.sizes["equilibrium"], body.get(p.name, p.default))
        for p in SATELLITE.parameters.values()
    }
    points |= {name: equilibria[name].values for name in ("theta0", "psi0", "phi0")}
    rates = np.array(equations.rhs(initial.initial_state(points), initial.constants(points)))
    assert np.abs(rates).max() < 1e-9
    flags, _ = SATELLITE.identify_family(points)
    assert (flags == SATELLITE.families["equilibrium"].flag).all()
    np.testing.assert_allclose(initial.directions(points)[1], equilibria.gamma.values.T, atol=1e-12)


def test_circles_and_surfaces_of_equilibria():
    equilibria = atlas.equilibria("satellite", {"A": 1.0, "B": 1.0, "C": 1.5})
    assert equilibria.circle.all()
    assert np.isfinite(equilibria.axis.values).all()


def test_permanent_rotations_of_a_heavy_gyrostat():
    body = {"A": 1.0, "B": 1.5, "C": 2.0, "Mg": 2.0, "x0": 0.3, "y0": 0.2, "z0": 0.5, "l1": 0.4, "n": 1.2}
    equilibria = atlas.equilibria("fixed_point", body)
    assert equilibria.sizes["equilibrium"] in (2, 4, 6)
    assert set(equilibria) >= {"theta0", "phi0", "gamma", "index", "circle", "stable", "growth_rate"}
    points = {
        p.name: np.full(equilibria.sizes["equilibrium"], body.get(p.name, p.default))
        for p in FIXED_POINT.parameters.values()
    }
    points |= {name: equilibria[name].values for name in ("theta0", "phi0")}
    assert condition_residual(FIXED_POINT, points).max() < 1e-9
    assert ((-1) ** equilibria["index"].astype(int)).sum() == 2  # Euler characteristic of the sphere
    resting = atlas.equilibria("fixed_point", {"Mg": 1.0, "z0": 1.0})
    assert list(resting.stable.values) == [Stability.STABLE, Stability.UNSTABLE]
    assert list(resting.theta0.values) == [0.0, np.pi]


def test_equilibria_survive_a_file(tmp_path):
    equilibria = atlas.equilibria("satellite", {"A": 1.0, "B": 1.3, "C": 1.7})
    equilibria.to_netcdf(tmp_path / "e.nc")
    with xr.open_dataset(tmp_path / "e.nc") as read:
        xr.testing.assert_identical(read.load(), equilibria)


ON_X = xr.DataArray([1.0, 2.0], dims="x", coords={"x": [0, 1]})
REFUSED = [
    ({"A": [1.0, 2.0], "B": [1.0, 2.0, 3.0]}, "points: columns of different lengths (A: 2, B: 3)"),
    ({"A": np.ones((2, 2))}, "A: an array of 2 dimensions; give a DataArray, whose dimensions have names (its shape: (2, 2))"),
    ({"A": xr.DataArray([1.0, 2.0], dims="equilibrium")}, "body: the dimension equilibrium is one of the result; rename it"),
    ({"A": ON_X, "B": ON_X.assign_coords(x=[0, 2])}, "arrays of different points: cannot ..."),
    ({"A": [1.0, np.nan]}, "point 1 (counted from 0): A = nan: must be a finite number"),
    ({"A": [1.0, -2.0]}, "point 1 (counted from 0): A = -2: allowed: A > 0 (principal moment of inertia about the first body axis)"),
    ({"C": [9.0, 8.0]}, "A + B = 2 is less than C = 9: no rigid body has these moments of inertia, and none of 2 points is possible"),
    ({"mass": [1.0, 2.0]}, "mass: not a parameter of the satellite; allowed: ..."),
    ({"A": 1.0, "B": 1.0, "C": 9.0}, "A + B = 2 is less than C = 9: no rigid body has these moments of inertia"),
    ({"A": np.nan}, "A = nan: must be a finite number"),
    ({"A": -1.0}, "A = -1: allowed: A > 0 (principal moment of inertia about the first body axis)"),
    ({"mass": 1.0}, "mass: not a parameter of the satellite; allowed: ..."),
    ({"Omega": 0.0}, "equilibria: without orbit and field the body can rest in any orientation"),
    ({"A": 1.0, "B": 1.0, "C": 1.0}, "equilibria: this body has a surface of equilibria, not single ones or circles of them"),
    ({"A": 1.0, "B": 1.0, "C": 1.0, "k2": 5e-324}, "equilibria: this body has a surface of equilibria, not single ones or circles of them"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "sentence"), REFUSED, ids=[sentence[:40] for _, sentence in REFUSED])
def test_a_mistake_in_a_body(body, sentence):
    assert_refused(lambda: atlas.equilibria("satellite", body), sentence)


def test_a_mistake_in_the_name_of_a_system():
    sentence = "system = 'sputnik': there is no such system; allowed: satellite, fixed_point"
    assert_refused(lambda: atlas.equilibria("sputnik", {}), sentence)
