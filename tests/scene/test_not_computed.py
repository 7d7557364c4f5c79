"""Points that are not computed: impossible bodies and starts, ties without a value, and durations in turns of what rests."""

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.analysis.summary import summary
from atlas.flags import Agreement, Label, Status
from atlas.runs.estimate import dry_run
from atlas.scene import grid
from atlas.scene.read import scene_from

pytestmark = pytest.mark.usefixtures("whole_kernels")

INTEGRATION = {"duration": 6.0, "tolerance": 1e-4}
RECTANGLE = {
    "schema": 1,
    "system": "satellite",
    "title": "rectangle",
    "fixed": {"A": 1.0, "k3": 0.5, "theta0": 0.4, "m": 0.3},
    "axes": {"b": {"from": 0.1, "to": 2.1, "count": 21}, "c": {"from": 0.1, "to": 2.1, "count": 11}},
    "ties": {"B": "b * A", "C": "c * A"},
    "integration": INTEGRATION,
}


def rectangle(**changes):
    return scene_from(RECTANGLE | changes)


def possible(ds):
    """The triangle inequality, written down again; equality is a flat body."""
    moments = np.sort(np.stack(np.broadcast_arrays(ds.A, *xr.broadcast(ds.B, ds.C))), 0)
    return moments[0] + moments[1] >= moments[2] * (1 - 1e-12)


@pytest.fixture(scope="module")
def computed():
    return atlas.run(rectangle(), progress=False)


def test_impossible_bodies_are_masked_and_counted(computed, caplog):
    mask = ~possible(computed)
    assert 0 < mask.sum() < mask.size
    np.testing.assert_array_equal(computed.status.values == Status.IMPOSSIBLE_BODY, mask)
    np.testing.assert_array_equal(computed.label.values == Label.NOT_COMPUTED, mask)
    for name in (
        "label_inertial",
        "predicted",
        "predicted_inertial",
        "stable",
        "family",
        "agreement",
        "geometry",
    ):
        assert (computed[name].values[mask] == 0).all(), name
    for name, values in computed.data_vars.items():
        if values.dtype == float:
            assert np.isnan(values.values[mask]).all(), name
    sentence = f"{mask.sum()} of {mask.size} points: no rigid body has these moments of inertia"
    assert sentence in computed.attrs["atlas_warnings"]
    assert sentence in summary(computed)
    assert sentence in dry_run(rectangle(), threads=1)
    assert sentence in grid.not_computed(rectangle(), grid.check(rectangle()))


def test_the_other_points_have_the_bits_of_a_scene_without_impossible_bodies(computed):
    mask = possible(computed)
    values = {name: np.broadcast_to(computed[name], mask.shape)[mask] for name in ("A", "k3", "theta0", "m")}
    for name in ("B", "C"):
        values[name] = computed[name].broadcast_like(computed.label).values[mask]
    points = {"values": {name: column.tolist() for name, column in values.items()}}
    scene = {key: RECTANGLE[key] for key in ("schema", "system", "integration")}
    alone = atlas.run(scene_from(scene | {"points": points}), progress=False)
    for name in alone.data_vars:
        np.testing.assert_array_equal(computed[name].values[mask], alone[name].values, err_msg=name)


def test_a_flat_body_is_possible_and_a_body_beyond_it_is_not():
    ds = atlas.label_points("satellite", {"C": [2.0, np.nextafter(2.0, 3.0), 2.001]}, duration=1.0)
    assert ds.status.values.tolist() == [Status.OK, Status.OK, Status.IMPOSSIBLE_BODY]


@pytest.mark.long
def test_a_run_folder_its_join_and_its_comparison_with_theory(computed, tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_TILE_POINTS", "64")
    folder = atlas.run(rectangle(), tmp_path / "run/", progress=False)
    with atlas.run(rectangle(), tmp_path / "one.nc", progress=False) as one, folder:
        for ds in (folder, one):
            for name in computed.data_vars:
                np.testing.assert_array_equal(ds[name].values, computed[name].values, err_msg=name)
        assert "not_computed" in one.atlas.compare()
        assert np.isfinite(one.atlas.trust().missed_bound)
        assert int(one.atlas.select(status="impossible_body").sizes["point"]) == (~possible(one)).sum()


@pytest.mark.long
def test_a_refined_scene_has_the_flags_of_the_full_grid():
    fine = {name: axis | {"count": 8 * axis["count"] - 7} for name, axis in RECTANGLE["axes"].items()}
    outputs = {"variables": ["label", "status", "predicted", "theta_dot_rms"]}
    refined = atlas.run(rectangle(refine={"levels": 3}, outputs=outputs), progress=False)
    full = atlas.run(rectangle(axes=fine, outputs=outputs), progress=False)
    for name in ("label", "status", "predicted"):
        np.testing.assert_array_equal(refined[name], full[name], err_msg=name)
    assert refined.computed.values[full.status.values == Status.IMPOSSIBLE_BODY].all()


def test_a_sample_that_crosses_the_limit():
    ranges = {"B": {"from": 0.1, "to": 2.0}, "C": {"from": 0.1, "to": 2.0}}
    points = {"sample": "sobol", "count": 64, "ranges": ranges}
    scene = {key: RECTANGLE[key] for key in ("schema", "system", "integration")}
    ds = atlas.run(scene_from(scene | {"points": points, "fixed": {"A": 1.0}}), progress=False)
    np.testing.assert_array_equal(ds.status.values == Status.IMPOSSIBLE_BODY, ~possible(ds))


def test_parameters_are_solved_for_possible_bodies_alone(scene_text):
    scene = load_scene(scene_text({"axes.sigma.to": 2.7}))
    ds = atlas.run(scene, progress=False)
    impossible = ds.C.broadcast_like(ds.label).values > 2
    np.testing.assert_array_equal(ds.status.values == Status.IMPOSSIBLE_BODY, impossible)
    np.testing.assert_array_equal(np.isnan(ds.k3.values), impossible)
    # The family solves the moments of other scenes: where it gives none there is no motion, and no impossible body.
    conical = {"fixed": {"A": 1.0, "m": 3.0, "n": 0.4, "Mg": -2.4, "z0": 1.0, "l3": 0.1}, "ties": {"B": "A"}}
    scene = {"schema": 1, "system": "fixed_point", "axes": {"theta0": {"from": 0.0, "to": 3.0, "count": 40}}}
    scene |= {"family": {"name": "conical", "solve": ["C"]}, "integration": INTEGRATION}
    ds = atlas.run(scene_from(scene | conical), progress=False)
    beyond = ds.C.values > 2
    np.testing.assert_array_equal(ds.status.values[beyond], Status.IMPOSSIBLE_BODY)
    assert (ds.status.values[~beyond] != Status.IMPOSSIBLE_BODY).all()


def test_a_trajectory_of_an_impossible_body_is_bad_input(computed):
    with pytest.raises(BadInput, match=r"no motion: no rigid body"):
        computed.atlas.trajectory(b=0.1, c=2.1)


TOP = {
    "schema": 1,
    "system": "fixed_point",
    "fixed": {"C": 1.2, "Mg": 1.0, "z0": 1.0, "theta0": 0.5},
    "axes": {"m": {"from": -2.0, "to": 2.0, "count": 5}, "n": {"from": -1.0, "to": 1.0, "count": 3}},
    "integration": {"duration": "1 turn", "tolerance": 1e-4},
}


def test_a_point_where_nothing_turns_is_not_computed():
    ds = atlas.run(scene_from(TOP), progress=False)
    rest = (ds.m == 0) & (ds.n == 0)
    assert rest.sum() == 1
    np.testing.assert_array_equal((ds.status == Status.NOT_COMPUTED).values, rest.transpose(*ds.label.dims))
    assert (ds.end_time.where(~rest) > 0).sum() == 14
    assert "1 of 15 points: duration = '1 turn', but n and m are 0" in ds.attrs["atlas_warnings"]
    axes = {"m": {"values": [0.0]}, "n": {"values": [0.0]}}
    with pytest.raises(BadInput, match=r"'1 turn': at every point n and m are 0"):
        atlas.run(scene_from(TOP | {"axes": axes}), progress=False)


def test_durations_in_turns_and_orbits_of_points():
    points = {"n": [0.0, 0.5, 0.0], "m": [0.0, 0.0, 2.0], "theta0": 0.4}
    ds = atlas.label_points("satellite", points, duration="2 turns", tolerance=1e-4)
    assert ds.status.values[0] == Status.NOT_COMPUTED
    np.testing.assert_allclose(ds.end_time.values[1:], [8 * np.pi, 2 * np.pi])
    ds = atlas.label_points("satellite", {"Omega": [0.5, 1.0]}, duration="1 orbit", tolerance=1e-4)
    np.testing.assert_allclose(ds.end_time.values, [4 * np.pi, 2 * np.pi])


def test_starts_off_the_unit_sphere_are_not_computed():
    """gamma30 is tied to the others: a part of the square has no such point, and another factor leaves the sphere."""
    scene = {
        "schema": 1,
        "system": "fixed_point",
        "fixed": {"p0": 0.1, "q0": 0.2, "r0": 3.0},
        "axes": {"gamma10": {"from": -1.0, "to": 1.0, "count": 9}, "gamma20": {"values": [0.0, 0.6]}},
        "ties": {"gamma30": "sqrt(1 - gamma10**2 - gamma20**2)"},
        "integration": INTEGRATION,
    }
    ds = atlas.run(scene_from(scene), progress=False)
    outside = (ds.gamma10**2 + ds.gamma20**2 > 1).transpose(*ds.label.dims)
    assert outside.sum() == 2
    np.testing.assert_array_equal(ds.status.values == Status.NOT_COMPUTED, outside)
    assert "2 of 18 points: a tie has no finite value" in ds.attrs["atlas_warnings"]
    ds = atlas.run(scene_from(scene | {"ties": {"gamma30": "0.8"}}), progress=False)
    on_sphere = (abs(ds.gamma10**2 + ds.gamma20**2 - 0.36) < 1e-9).transpose(*ds.label.dims)
    assert on_sphere.sum() == 1
    np.testing.assert_array_equal(ds.status.values != Status.NOT_COMPUTED, on_sphere)
    assert "17 of 18 points: (gamma10, gamma20, gamma30) must be a unit vector" in ds.attrs["atlas_warnings"]
    with pytest.raises(BadInput, match=r"must be a unit vector within 1e-09, and none of 18 points"):
        atlas.run(scene_from(scene | {"ties": {"gamma30": "7"}}), progress=False)


def test_points_may_have_starts_of_either_kind():
    """Those without p0 to gamma30 start from the angles; the parameters of the others are coordinates all the same."""
    starts = {"p0": 0.1, "q0": 0.0, "r0": 0.3, "gamma10": 0.0, "gamma20": 0.0, "gamma30": 1.0}
    either = {name: [np.nan, value] for name, value in starts.items()}
    ds = atlas.label_points("fixed_point", {"C": 0.5, "m": [1.0, 0.0], **either}, duration=1.0)
    np.testing.assert_array_equal(ds.coords["p0"], either["p0"])
    assert ds.label.values.tolist() == [Label.PERMANENT_ROTATION, Label.DRIFTING]


def test_a_few_possible_bodies_among_many_points_are_found():
    """The points that are checked first miss them."""
    count = 3 * grid.MAX_CHECKED_STARTS
    C = np.full(count, 3.0)
    C[[1, 20_000]] = 1.5
    scene = {key: RECTANGLE[key] for key in ("schema", "system", "integration")}
    sample = grid.check(scene_from(scene | {"points": {"values": {"C": C.tolist()}}}))
    assert sample.base["C"].tolist() == [1.5, 1.5]
    assert sample.exists.all()


def test_points_where_the_family_does_not_exist_are_not_computed(scene_text):
    oblique = {"family": {"name": "oblique", "solve": ["psi0", "k3"]}, "ties.psi0": None}
    ds = atlas.run(load_scene(scene_text(oblique | {"fixed.mu3": 1.0, "fixed.h1": 0.5})), progress=False)
    not_computed = ds.label.values == Label.NOT_COMPUTED
    assert 0 < not_computed.sum() < not_computed.size
    assert (ds.status.values[not_computed] == Status.NOT_COMPUTED).all()
    assert np.isnan(ds.theta_dot_rms.values[not_computed]).all()
    assert (ds.agreement.values[not_computed] == Agreement.NOT_COMPARED).all()
    assert (ds.label.values[~not_computed] != Label.NOT_COMPUTED).all()


def test_impossible_moments_of_inertia_give_a_warning(caplog):
    ds = atlas.label_points("satellite", {"A": 1.0, "B": 1.0, "C": [2.5, 1.5]}, duration=1.0)
    assert "1 of 2 points: no rigid body has these moments of inertia" in ds.attrs["atlas_warnings"]
    assert "no rigid body" in caplog.text
