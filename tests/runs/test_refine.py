"""Refined atlases: the same as the full grid at a share of its points, and honest about what is not computed."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import atlas
from atlas import BadInput, load_scene
from atlas.analysis import summary
from atlas.io import netcdf
from atlas.runs import refine
from atlas.scene.grid import Grid


def scene_of(small_scene, counts=(9, 7), more="", refined="[refine]\nlevels = 3\n"):
    text = small_scene.replace("count = 9", f"count = {counts[0]}").replace(
        "count = 7", f"count = {counts[1]}"
    )
    return load_scene(text.replace("[ties]", f"{more}{refined}[ties]"))


@pytest.fixture(scope="module")
def both():
    from conftest import SMALL_SCENE

    scene = scene_of(SMALL_SCENE)
    full = scene_of(SMALL_SCENE, counts=scene.shape, refined="")
    return refine.refined(scene, [], progress=False), atlas.run(full, progress=False)


def test_every_flag_is_that_of_the_full_grid(both):
    ds, full = both
    assert dict(ds.sizes) == {"sigma": 65, "theta0": 49}
    for name in full.data_vars:
        if full[name].dtype == np.int8:
            np.testing.assert_array_equal(ds[name], full[name], err_msg=name)
    for name in full.coords:
        np.testing.assert_array_equal(ds[name], full[name], err_msg=name)
    np.testing.assert_array_equal(ds.growth_rate, full.growth_rate)


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


def test_a_refined_atlas_is_written_read_mapped_and_asked_like_any_other(both, tmp_path):
    ds, full = both
    netcdf.write(ds, tmp_path / "a.nc")
    with atlas.open_atlas(tmp_path / "a.nc") as read:
        xr.testing.assert_equal(read.load(), ds)
        assert float(read.atlas.fractions()[3]) == float((full.label == 3).mean())
        assert len(read.atlas.select(computed="computed").point) == int(ds.computed.sum())
        assert read.atlas.map("computed").axes
    scene = load_scene(ds.attrs["atlas_scene"])
    assert scene.shape == (65, 49)
    assert load_scene(scene.toml()).toml() == scene.toml()


def test_axes_of_values_and_single_values_stay_as_they_are(small_scene):
    more = "[axes.k1]\nvalues = [0.0]\n[axes.h3]\nvalues = [0.0, 0.2]\n"
    scene = scene_of(small_scene, (5, 4), more, "[refine]\nlevels = 2\nprobe = 0.0\n")
    assert scene.shape == (17, 13, 1, 2)
    ds = refine.refined(scene, [], progress=False)
    assert ds.label.dims == ("sigma", "theta0", "k1", "h3")
    full = atlas.run(scene_of(small_scene, (17, 13), more, ""), progress=False)
    np.testing.assert_array_equal(ds.label, full.label)
    assert ds.attrs["atlas_probe_points"] == 0


def test_points_without_motion_are_not_computed_and_their_border_is_followed(small_scene):
    oblique = small_scene.replace('"perp_velocity"', '"oblique"').replace('["k3"]', '["psi0", "k3"]')
    oblique = oblique.replace('psi0 = "pi / 2"\n', "").replace("m = 0.5", "m = 0.5\nmu3 = 1.0\nh1 = 0.5")
    scene = scene_of(oblique, (5, 4), refined="[refine]\nlevels = 3\n")
    ds = refine.refined(scene, [], progress=False)
    full = atlas.run(scene_of(oblique, scene.shape, refined=""), progress=False)
    nowhere = full.label.values == 0
    assert 0 < nowhere.sum() < nowhere.size
    np.testing.assert_array_equal(ds.label, full.label)
    np.testing.assert_array_equal(ds.psi0, full.psi0)
    assert (ds.computed.values[nowhere] == 1).all()
    assert ds.attrs["atlas_computed_share"] <= 1


# Motions of an invented plane: label 2 inside the shape, 3 outside; without magnet the field is nothing to theory.
def pretend(monkeypatch, inside):
    def evaluate(scene, tile: Grid, *, threads=None):
        flag = np.where(inside(tile.base["h1"], tile.base["h3"]), 2, 3).astype(np.int8)
        return {"label": flag}

    monkeypatch.setattr(refine, "evaluate_tile", evaluate)


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


def truth(ds, inside):
    x, y = np.meshgrid(ds.h1, ds.h3, indexing="ij")
    return np.where(inside(x, y), 2, 3)


@settings(max_examples=25)
@given(
    st.floats(0, 1), st.floats(0, 1), st.floats(0.15, 0.6), st.floats(0.02, 1.0), st.floats(0, np.pi),
)  # fmt: skip
def test_any_ellipse_that_the_coarse_grid_meets_is_exact(x0, y0, long, ratio, turned):
    def inside(x, y):
        along = (x - x0) * np.cos(turned) + (y - y0) * np.sin(turned)
        across = (y - y0) * np.cos(turned) - (x - x0) * np.sin(turned)
        return (along / long) ** 2 + (across / (long * ratio)) ** 2 < 1

    with pytest.MonkeyPatch.context() as patch:
        pretend(patch, inside)
        ds = refine.refined(plane(9, 3, 0.0), [], progress=False)
    if (ds.label == 2).any():
        # needles thinner than the finest grid fall apart into islands
        if long * ratio > 2 / 64:
            np.testing.assert_array_equal(ds.label, truth(ds, inside))
    else:
        coarse = truth(ds, inside)[::8, ::8]
        assert (coarse == 3).all()


def test_what_the_probe_hits_is_mended_and_counted(monkeypatch):
    def islands(x, y):  # three fine points wide, between the points of the coarse grid
        return (abs((8 * x) % 1 - 0.5) < 0.2) & (abs((8 * y) % 1 - 0.5) < 0.2)

    pretend(monkeypatch, islands)
    blind = refine.refined(plane(9, 3, 0.0), [], progress=False)
    assert (blind.label == 3).all()
    assert blind.attrs["atlas_computed_share"] == 81 / 65**2
    ds = refine.refined(plane(9, 3, 0.1), [], progress=False)
    tried, missed = ds.attrs["atlas_probe_points"], ds.attrs["atlas_probe_missed"]
    assert tried == np.ceil(0.1 * (65**2 - 81))
    expected = truth(ds, islands)
    assert missed / tried == pytest.approx((expected == 2).mean(), abs=0.05)
    assert (ds.label == 2).sum() > 4 * missed  # the whole of every island that was hit
    computed = ds.computed.values == 1
    np.testing.assert_array_equal(ds.label.values[computed], expected[computed])
    again = refine.refined(plane(9, 3, 0.1), [], progress=False)
    np.testing.assert_array_equal(again.computed, ds.computed)


def test_progress_is_told(monkeypatch, capsys):
    pretend(monkeypatch, lambda x, y: x + y < 0.7)
    refine.refined(plane(5, 2, 0.01), [], progress=True)
    assert "level 2 of 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("levels = 3", "levels = 0", "refine.levels = 0"),
        ("levels = 3", "levels = 9", "refine.levels = 9"),
        ("levels = 3", "levels = 1.5", "refine.levels = 1.5"),
        ("levels = 3", "", "refine.levels = None"),
        ("levels = 3", "levels = 3\nprobe = 1.5", "refine.probe = 1.5"),
        ("levels = 3", "levels = 3\nprobe = -0.1", "refine.probe = -0.1"),
        ("levels = 3", "levels = 3\nprobe = 'few'", "refine.probe"),
        ("levels = 3", "levels = 3\nwidth = 3", "refine.width"),
        ("[refine]\nlevels = 3", "refine = 3", "unknown key"),
        ("count = 9", "count = 90000000", "axes.sigma.count"),
        ("from = 0.3\nto = 1.7\ncount = 9", "values = [1.0]", ""),
    ],
)  # fmt: skip
def test_bad_refinement_is_one_line_that_names_it(small_scene, old, new, named):
    text = small_scene.replace("[ties]", "[refine]\nlevels = 3\n[ties]")
    assert old in text
    text = text.replace(old, new, 1)
    if not named:
        text = text.replace("from = 0.2\nto = 1.4\ncount = 7", "values = [0.4]")
        named = "nothing to refine"
    with pytest.raises(BadInput) as complaint:
        load_scene(text)
    assert named in str(complaint.value)
    assert "\n" not in str(complaint.value)


def test_a_finest_grid_beyond_memory_is_refused(small_scene):
    with pytest.raises(BadInput, match="finest grid"):
        scene_of(small_scene, (3000, 3000))


def test_run_refines_into_memory_or_one_file(small_scene, tmp_path, both):
    scene = scene_of(small_scene)
    ds = atlas.run(scene, tmp_path / "a.nc", progress=False)
    xr.testing.assert_equal(ds.load(), both[0])
    assert "interpolated" in summary.summary(ds)
    xr.testing.assert_equal(atlas.run(scene, progress=False), both[0])
    for out, more in ((tmp_path / "folder", {}), (tmp_path / "b.nc", {"workers": 1})):
        with pytest.raises(BadInput, match="one process"):
            atlas.run(scene, out, progress=False, **more)
