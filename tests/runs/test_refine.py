"""Refined atlases: equal to the full grid at a share of its points, and open about what is not computed."""

import os
import re
import tracemalloc
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import atlas
from atlas import BadInput, load_scene
from atlas.analysis.summary import summary
from atlas.flags import Label, Stability
from atlas.runs import estimate, memory, refine
from atlas.runs.plan import ScenePlan
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.store import netcdf

pytestmark = pytest.mark.usefixtures("whole_kernels")

OBLIQUE = {
    "family": {"name": "oblique", "solve": ["psi0", "k3"]},
    "ties.psi0": None,
    "fixed.mu3": 1.0,
    "fixed.h1": 0.5,
}


def full_scene(scene_text, counts, changes=None):
    """The small scene with so many values along its axes."""
    counts = dict(zip(("axes.sigma.count", "axes.theta0.count"), counts, strict=True))
    return load_scene(scene_text(counts | (changes or {})))


def refined_scene(scene_text, counts=(9, 7), changes=None, refine=None):
    """The small scene with a coarse grid of so many values along its axes."""
    return full_scene(scene_text, counts, (changes or {}) | {"refine": refine or {"levels": 3}})


@pytest.fixture(scope="module")
def both(scene_text):
    """A refined atlas, and the same on the full grid."""
    scene = refined_scene(scene_text)
    full = full_scene(scene_text, scene.shape)
    return atlas.run(scene, progress=False), atlas.run(full, progress=False)


@pytest.mark.long
def test_flags_and_parameters_are_those_of_the_full_grid(both):
    ds, full = both
    assert dict(ds.sizes) == {"sigma": 65, "theta0": 49}
    for name in full.data_vars:
        if full[name].dtype == np.int8:
            np.testing.assert_array_equal(ds[name], full[name], err_msg=name)
    for name in full.coords:
        np.testing.assert_array_equal(ds[name], full[name], err_msg=name)
    np.testing.assert_array_equal(ds.growth_rate, full.growth_rate)


@pytest.mark.long
def test_numbers_are_those_of_the_full_grid_or_nan(both):
    ds, full = both
    computed = ds.computed.values == 1
    assert ds.computed.attrs["flag_meanings"] == "interpolated computed"
    assert ds.computed.attrs["flag_values"].dtype == np.int8
    share = ds.attrs["atlas_computed_share"]
    assert share == computed.mean()
    assert 9 * 7 / computed.size < share < 0.6
    for name in ("theta_dot_rms", "psi_dot_std", "step", "condition_residual", "end_time"):
        np.testing.assert_array_equal(ds[name].values[computed], full[name].values[computed])
        assert np.isnan(ds[name].values[~computed]).all()
    assert ds.attrs["atlas_probe_points"] > 0
    assert ds.attrs["atlas_probe_missed"] == 0


@pytest.mark.long
def test_a_refined_atlas_can_be_written_read_mapped_and_queried(both, tmp_path):
    ds, full = both
    netcdf.write(ds, tmp_path / "a.nc")
    with atlas.open_atlas(tmp_path / "a.nc") as read:
        xr.testing.assert_equal(read.load(), ds)
        assert float(read.atlas.fractions()[Label.DRIFTING]) == float((full.label == Label.DRIFTING).mean())
        assert len(read.atlas.select(computed="computed").point) == int(ds.computed.sum())
        assert read.atlas.map("computed").axes
    scene = load_scene(ds.attrs["atlas_scene"])
    assert scene.shape == (65, 49)
    assert load_scene(scene.toml()).toml() == scene.toml()


def test_axes_given_by_values_are_not_refined(scene_text):
    axes = {"axes.k1.values": [0.0], "axes.h3.values": [0.0, 0.2]}
    scene = refined_scene(scene_text, (5, 4), axes, {"levels": 2, "probe": 0.0})
    assert scene.shape == (17, 13, 1, 2)
    ds = atlas.run(scene, progress=False)
    assert ds.label.dims == ("sigma", "theta0", "k1", "h3")
    full = atlas.run(full_scene(scene_text, (17, 13), axes), progress=False)
    np.testing.assert_array_equal(ds.label, full.label)
    assert ds.attrs["atlas_probe_points"] == 0


def test_points_without_motion_are_not_computed_and_their_boundary_is_traced(scene_text):
    scene = refined_scene(scene_text, (5, 4), OBLIQUE)
    ds = atlas.run(scene, progress=False)
    full = atlas.run(full_scene(scene_text, scene.shape, OBLIQUE), progress=False)
    without_motion = full.label.values == Label.NOT_COMPUTED
    assert 0 < without_motion.sum() < without_motion.size
    np.testing.assert_array_equal(ds.label, full.label)
    np.testing.assert_array_equal(ds.psi0, full.psi0)
    assert (ds.computed.values[without_motion] == 1).all()
    assert ds.attrs["atlas_computed_share"] <= 1


def labels_of_region(inside, x, y):
    """Invented labels of the (h1, h3) plane: permanent rotation inside a region, drifting outside."""
    return np.where(inside(x, y), Label.PERMANENT_ROTATION, Label.DRIFTING).astype(np.int8)


def replace_integration(monkeypatch, inside):
    def evaluate_at(plan, scene, indices, earlier, threads):
        points = grid.points_at_indices(scene, indices)
        labels = labels_of_region(inside, points.base["h1"], points.base["h3"])
        return dict.fromkeys(scene.outputs, 0) | {"label": labels}, indices.size, Counter()

    monkeypatch.setattr(memory, "evaluate_at", evaluate_at)


def plane(count, levels, probe):
    return load_scene(
        f"""
        schema = 1
        system = "satellite"
        outputs = {{variables = ["label"]}}
        refine = {{levels = {levels}, probe = {probe}}}
        [axes.h1]
        from = 0.0
        to = 1.0
        count = {count}
        [axes.h3]
        from = 0.0
        to = 1.0
        count = {count}
        """
    )


def expected_labels(ds, inside):
    return labels_of_region(inside, *np.meshgrid(ds.h1, ds.h3, indexing="ij"))


@pytest.mark.long
@settings(max_examples=25)
@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.15, 0.6), st.floats(0.02, 1.0), st.floats(0, np.pi))
def test_any_ellipse_that_contains_a_coarse_point_is_exact(x0, y0, semi_axis, ratio, angle):
    def inside(x, y):
        along = (x - x0) * np.cos(angle) + (y - y0) * np.sin(angle)
        across = (y - y0) * np.cos(angle) - (x - x0) * np.sin(angle)
        return (along / semi_axis) ** 2 + (across / (semi_axis * ratio)) ** 2 < 1

    with pytest.MonkeyPatch.context() as patch:
        replace_integration(patch, inside)
        ds = atlas.run(plane(9, 3, 0.0), progress=False)
    if (ds.label == Label.PERMANENT_ROTATION).any():
        # on the finest grid a thinner ellipse is a row of separate islands
        if semi_axis * ratio > 2 / 64:
            np.testing.assert_array_equal(ds.label, expected_labels(ds, inside))
    else:
        coarse = expected_labels(ds, inside)[::8, ::8]
        assert (coarse == Label.DRIFTING).all()


@pytest.mark.long
def test_islands_that_the_probe_hits_are_traced_and_counted(monkeypatch):
    def islands(x, y):  # three fine points wide, between the points of the coarse grid
        return (abs((8 * x) % 1 - 0.5) < 0.2) & (abs((8 * y) % 1 - 0.5) < 0.2)

    replace_integration(monkeypatch, islands)
    without_probe = atlas.run(plane(9, 3, 0.0), progress=False)
    assert (without_probe.label == Label.DRIFTING).all()
    assert without_probe.attrs["atlas_computed_share"] == 81 / 65**2
    ds = atlas.run(plane(9, 3, 0.1), progress=False)
    probed, missed = ds.attrs["atlas_probe_points"], ds.attrs["atlas_probe_missed"]
    assert probed == np.ceil(0.1 * (65**2 - 81))
    expected = expected_labels(ds, islands)
    assert missed / probed == pytest.approx((expected == Label.PERMANENT_ROTATION).mean(), abs=0.05)
    # every island that was hit is traced as a whole
    assert (ds.label == Label.PERMANENT_ROTATION).sum() > 4 * missed
    computed = ds.computed.values == 1
    np.testing.assert_array_equal(ds.label.values[computed], expected[computed])
    repeated = atlas.run(plane(9, 3, 0.1), progress=False)
    np.testing.assert_array_equal(repeated.computed, ds.computed)


def test_progress_is_printed(monkeypatch, capsys):
    replace_integration(monkeypatch, lambda x, y: x + y < 0.7)
    atlas.run(plane(5, 2, 0.01), progress=True)
    assert "level 2 of 2" in capsys.readouterr().err


def test_a_finest_grid_beyond_memory_is_refused(scene_text):
    with pytest.raises(BadInput, match="finest grid"):
        refined_scene(scene_text, (3000, 3000))


def test_run_refines_into_memory_or_one_file(scene_text, tmp_path, both):
    scene = refined_scene(scene_text)
    ds = atlas.run(scene, tmp_path / "a.nc", progress=False)
    xr.testing.assert_equal(ds.load(), both[0])
    assert "interpolated" in summary(ds)
    xr.testing.assert_equal(atlas.run(scene, progress=False), both[0])


def test_a_grid_that_does_not_fit_into_memory_is_refused(scene_text, monkeypatch):
    monkeypatch.setattr(refine.os, "sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 10}.get)
    with pytest.raises(BadInput, match=r"points needs .* GB, this machine has 4.1e-05 GB"):
        atlas.run(refined_scene(scene_text), progress=False)


def test_a_grid_that_does_not_fit_onto_the_disk_is_refused(scene_text, tmp_path, monkeypatch):
    """Of each point a run into a folder holds two codes of two bytes, two masks, the growth rate and k3: 22 bytes."""
    scene = refined_scene(scene_text)

    def leave(free):
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr(refine.shutil, "disk_usage", lambda folder: usage)

    leave(22 * scene.size)
    refine.FineGrid(ScenePlan.of(scene), None, tmp_path)
    leave(22 * scene.size - 1)
    message = rf"3185 points needs 7.01e-05 GB, free on the disk of {tmp_path}/night are 7.01e-05 GB"
    with pytest.raises(BadInput, match=message):
        atlas.run(scene, f"{tmp_path}/night/", progress=False)


@pytest.mark.long
def test_boxes_of_any_size_give_the_same_atlas(scene_text, both, monkeypatch):
    monkeypatch.setattr(refine, "MAX_BOX_POINTS", 60)
    monkeypatch.setenv("ATLAS_TILE_POINTS", "100")
    xr.testing.assert_identical(
        *(ds.drop_attrs(deep=False) for ds in (both[0], atlas.run(refined_scene(scene_text), progress=False)))
    )


@pytest.mark.long
def test_memory_does_not_grow_with_the_grid(tmp_path, monkeypatch):
    """What the grid holds is in a folder; of the memory that Python allocates, points near the boundary take a little."""
    monkeypatch.setattr(refine, "MAX_BOX_POINTS", 4096)

    def inside(x, y):
        return x + y < 0.7

    def peak(count):
        def integrate(indices):
            x, y = (
                axis.values[i]
                for axis, i in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True)
            )
            yield indices, {"label": labels_of_region(inside, x, y)}

        scene = plane(count, 3, 0.0)
        plan = ScenePlan.of(scene)
        tracemalloc.start()
        fine = refine.FineGrid(plan, integrate, tmp_path)
        tracemalloc.reset_peak()  # theory is evaluated tile by tile
        fine.trace(3, progress=False)
        fine.probe(0.001)
        bytes_used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        box = np.s_[: scene.shape[0] // 3]
        x, y = np.meshgrid(*(axis.values for axis in scene.axes.values()), indexing="ij")
        np.testing.assert_array_equal(fine.values(box)["label"], labels_of_region(inside, x, y)[box])
        assert not os.listdir(tmp_path)
        return bytes_used, scene.size

    peak(9)  # imports the filters of SciPy
    (few, some), (more, many) = peak(17), peak(65)
    assert many > 15 * some
    assert more - few < 0.5 * (many - some)


def test_a_nudge_along_a_family_is_predicted_as_on_the_full_grid():
    """Turning the vertical about which a free body rotates leads to another exact start."""
    table = {
        "schema": 1, "title": "Free body about its middle axis", "system": "fixed_point",
        "fixed": {"A": 1.0, "B": 1.8, "m": 1.0},
        "axes": {"C": {"from": 1.1, "to": 2.5, "count": 5}, "theta0": {"from": 0.0, "to": 1.0, "count": 3}},
        "nudge": {"theta0": 1e-4, "psi0": 1e-4},
        "integration": {"duration": 12.0, "tolerance": 1e-6}, "labels": {"rate_tolerance": 1e-3},
    }  # fmt: skip
    ds = atlas.run(scene_from(table | {"refine": {"levels": 2}}), progress=False)
    table["axes"]["C"]["count"], table["axes"]["theta0"]["count"] = 17, 9
    full = atlas.run(scene_from(table), progress=False)
    unstable = (full.stable == Stability.UNSTABLE).values
    assert unstable.any()
    assert (full.predicted.values[unstable] == Label.PERMANENT_ROTATION).all()
    for name in ("predicted", "label", "status", "agreement"):
        np.testing.assert_array_equal(ds[name], full[name], err_msg=name)


def test_the_expected_number_of_points_is_that_of_a_run(scene_text, both, monkeypatch):
    """Within a tenth where theory is evaluated on the whole grid, within a third where it is extrapolated."""
    ds, _ = both
    integrated = ds.attrs["atlas_computed_share"] * ds.label.size
    scene = refined_scene(scene_text)
    assert refine.expected_points(ScenePlan.of(scene)) == pytest.approx(integrated, rel=0.1)
    monkeypatch.setattr(refine, "MAX_PREDICTED", 1000)
    assert refine.expected_points(ScenePlan.of(scene)) == pytest.approx(integrated, rel=1 / 3)
    monkeypatch.setattr(refine, "MAX_PREDICTED", 40)  # less than the coarse grid
    assert refine.expected_points(ScenePlan.of(scene)) == pytest.approx(integrated, rel=0.7)


def test_a_dry_run_prices_the_points_that_are_integrated(scene_text, both):
    ds, _ = both
    text = estimate.dry_run(refined_scene(scene_text), threads=1)
    number = int(re.search(r"3185 points, about (\d+) to integrate, near", text)[1])
    assert number == pytest.approx(ds.attrs["atlas_computed_share"] * 3185, rel=0.1)
    assert "tiles" not in text
