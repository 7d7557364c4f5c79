"""`label_points` of arrays with named dimensions, in memory and of dask."""

import pickle

import dask.array
import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput
from atlas.flags import Label, Status
from atlas.label.plan import Plan
from atlas.scene.model import Settings
from atlas.systems import SYSTEMS

SATELLITE = SYSTEMS["satellite"]
# Every call gives these and k3, so that the same terms vanish as in the small scene and all share its kernel.
START = {"theta0": 0.3, "psi0": 1.2}
SETTINGS = {"duration": 5.0, "tolerance": 1e-5}


def random_points(count=48):
    """Some with terms that vanish, and some in the middle without a rigid body."""
    rng = np.random.default_rng(4)
    C = rng.uniform(0.6, 1.5, count)
    C[16:24] = 3.0
    k3 = np.where(np.arange(count) < 20, 0.0, rng.uniform(-1.0, 1.0, count))
    start = {name: rng.uniform(0.0, 3.0, count) for name in START}
    columns = {"C": C, "k3": k3, "m": rng.uniform(-1.0, 1.0, count), **start}
    return {name: xr.DataArray(values, dims="body") for name, values in columns.items()}


def assert_same_variables(one, other):
    assert list(one.data_vars) == list(other.data_vars)
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=name)
        assert one[name].dtype == other[name].dtype


@pytest.fixture(scope="module")
def grid():
    shape = xr.DataArray([0.8, 1.2, 1.7], dims="shape")
    spin = xr.DataArray([0.1, 0.5], dims="spin", coords={"spin": ["slow", "fast"], "rpm": ("spin", [1, 5])})
    return {"C": shape, "m": spin, "k3": 0.2, **START}


def test_a_column_of_names_gives_the_points_of_a_single_motion():
    ds = atlas.label_points(
        "satellite", {"run": ["first", "second"], "C": 1.2, "k3": 0.2, **START}, **SETTINGS
    )
    assert ds.label.dims == ("point",)
    assert ds.run.values.tolist() == ["first", "second"]
    assert ds.theta_dot_rms[0] == ds.theta_dot_rms[1]


def test_the_result_has_the_dimensions_and_coordinates_of_the_arrays(grid):
    ds = atlas.label_points("satellite", grid, **SETTINGS)
    assert ds.label.dims == ("shape", "spin")
    assert ds.spin.values.tolist() == ["slow", "fast"]
    assert ds.rpm.dims == ("spin",)
    assert ds.C.dims == ("shape",)
    assert ds.theta0.dims == ()
    np.testing.assert_array_equal(ds["shape"], grid["C"])  # of a dimension without coordinate
    C, m = np.broadcast_arrays(grid["C"].values[:, None], grid["m"].values)
    flat = atlas.label_points("satellite", grid | {"C": C.ravel(), "m": m.ravel()}, **SETTINGS)
    for name in ds.data_vars:
        np.testing.assert_array_equal(ds[name].values.ravel(), flat[name].values, err_msg=name)


@pytest.mark.parametrize(
    "C",
    [
        xr.DataArray([0.8, 0.8, 1.2], dims="shape"),
        xr.DataArray([[0.8, 1.2], [1.0, 1.4]], dims=("shape", "column")),
    ],
)
def test_a_dimension_has_no_coordinate_unless_one_parameter_tells_its_values_apart(C, grid):
    ds = atlas.label_points("satellite", grid | {"C": C, "m": 0.1}, **SETTINGS)
    assert ds.C.dims == ds.label.dims == C.dims
    assert not ds.indexes


def test_maps_and_questions_work_at_once(grid):
    spin = xr.DataArray([0.1, 0.5], dims="m")
    ds = atlas.label_points("satellite", grid | {"m": spin}, **SETTINGS)
    assert set(ds.indexes) == {"m", "shape"}
    axes = ds.atlas.map().axes[0]
    assert {axes.get_xlabel(), axes.get_ylabel()} == {"$C$ (kg m$^{2}$)", "$m$ (rad s$^{-1}$)"}
    np.testing.assert_array_equal(ds.atlas.nearest(m=0.5, shape=1.2).label, ds.label[1, 1])
    # a list of bodies under any name of a dimension is one of single points
    bodies = atlas.label_points("satellite", random_points(), **SETTINGS)
    assert bodies.label.dims == ("body",)
    assert bodies.atlas.map().axes
    assert bodies.atlas.select(status="impossible_body").sizes["point"] == 8


def test_a_dataset_is_a_grid_and_a_stacked_one_is_unstacked_again(grid):
    ds = xr.Dataset({"k3": 0.2, **START}, coords={"C": [0.8, 1.2, 1.7], "m": [0.1, 0.5]})
    table = atlas.label_points("satellite", ds, **SETTINGS)
    assert table.label.dims == ("C", "m")
    stacked = xr.Dataset(grid).drop_vars("rpm").stack(case=("shape", "spin"))
    labels = atlas.label_points("satellite", stacked, **SETTINGS).unstack("point")
    assert labels.label.dims == ("shape", "spin")
    np.testing.assert_array_equal(labels.theta_dot_rms.sel(spin=["slow", "fast"]), table.theta_dot_rms)


@pytest.mark.parametrize(
    ("chunk", "settings"),
    [
        (8, {"duration": 5.0}),
        (5, {"duration": "2 turns", "variables": ["label", "theta_dot_rms"]}),
        (48, {"duration": 5.0, "variables": ["theta_dot_rms"]}),
    ],
)  # fmt: skip
def test_lazy_results_have_the_bits_of_eager_ones(chunk, settings):
    points, settings = random_points(), {"tolerance": 1e-5, **settings}
    eager = atlas.label_points("satellite", points, **settings)
    lazy = atlas.label_points("satellite", {k: v.chunk(body=chunk) for k, v in points.items()}, **settings)
    assert all(array.chunks is not None for array in lazy.data_vars.values())
    assert_same_variables(lazy.compute(scheduler="threads", num_workers=2), eager)
    left_out = {"atlas_seconds", "atlas_points_per_second", "atlas_warnings"}
    assert eager.attrs.keys() - lazy.attrs.keys() == left_out
    assert lazy.attrs["atlas_kernel_hash"] == eager.attrs["atlas_kernel_hash"]


def test_a_lazy_result_is_broadcast_and_can_be_sent_to_other_processes(grid):
    lengths = xr.DataArray([2.0, 3.0], dims="run")
    eager = atlas.label_points("satellite", grid, duration=lengths, tolerance=1e-5)
    points = grid | {"C": grid["C"].chunk(shape=2), "m": grid["m"].chunk(spin=1)}
    lazy = atlas.label_points("satellite", points, duration=lengths.chunk(run=1), tolerance=1e-5)
    assert lazy.label.chunks == ((2, 1), (1, 1), (1, 1))
    assert_same_variables(pickle.loads(pickle.dumps(lazy)).compute(scheduler="synchronous"), eager)
    assert eager.end_time.sel(run=1).values.tolist() == 3 * [2 * [3.0]]


def test_a_chunk_without_a_possible_body_has_flags():
    points = {name: array.chunk(body=8) for name, array in random_points().items()}
    lazy = atlas.label_points("satellite", points, **SETTINGS)
    chunk = lazy.isel(body=slice(16, 24)).compute()
    assert (chunk.status == Status.IMPOSSIBLE_BODY).all()
    assert (chunk.label == Label.NOT_COMPUTED).all()
    assert chunk.theta_max.isnull().all()
    with pytest.raises(BadInput, match="none of 8 points is possible"):
        atlas.label_points("satellite", {k: v[16:24] for k, v in random_points().items()}, **SETTINGS)


def test_values_of_chunks_are_checked_when_they_are_computed():
    bad = dask.array.from_array(np.array([0.8, -1.0]), chunks=1)
    lazy = atlas.label_points("satellite", {"C": bad, "k3": 0.2, "m": 0.1, **START}, **SETTINGS)
    assert lazy.label.isel(point=[0]).compute().size == 1
    with pytest.raises(BadInput, match=r"^C = -1: allowed: C > 0"):
        lazy.compute()
    with pytest.raises(BadInput, match=r"^k3 = inf"):  # a number, at once
        atlas.label_points("satellite", {"C": bad, "k3": np.inf}, **SETTINGS)


def test_the_kernel_depends_on_the_names_of_the_parameters_given():
    def terms(*given):
        return Plan.of_points(SATELLITE, Settings(), None, given).specialization

    assert terms("C", "m") == terms("C", "theta0")
    assert "damping_A" in terms("C", "m").zero
    assert "damping_A" not in terms("C", "damping").zero
    assert ("B", "A") in terms("C", "m").equal
    assert not terms("A", "B", "C").equal
