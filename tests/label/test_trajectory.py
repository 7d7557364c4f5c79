"""The dataset of a trajectory explains itself: units, parameters, provenance."""

import matplotlib
import numpy as np
import pytest
import xarray as xr

import atlas
from atlas.label.trajectory import trajectory_of_scene
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

POINTS = {
    "satellite": {"theta0": 0.7, "k3": 0.3, "m": 0.4},
    "fixed_point": {"theta0": 0.7, "l3": 0.3, "n": 0.2, "Mg": 1.0},
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_variable_has_a_name_and_a_unit(system):
    tr = atlas.trajectory(system, POINTS[system], duration=2.0, samples=11)
    for name, variable in tr.variables.items():
        assert variable.attrs["long_name"]
        if name not in SYSTEMS[system].equations.STATE or name in SYSTEMS[system].rate_states:
            assert variable.attrs["units"]
    assert tr.theta.attrs["units"] == "rad"
    assert tr.psi_dot.attrs["units"] == "rad s-1"
    assert tr.axis_z.attrs["long_name"].endswith(SYSTEMS[system].frame_axes[2])


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_parameters_and_the_attributes_repeat_the_motion(system, tmp_path):
    tr = atlas.trajectory(system, POINTS[system], duration=2.0, samples=11, method="rk8")
    tr.to_netcdf(tmp_path / "motion.nc")
    read = xr.load_dataset(tmp_path / "motion.nc")
    point = {name: float(read[name]) for name in SYSTEMS[system].parameters if name in read}
    assert point.items() >= POINTS[system].items()
    attributes = read.attrs
    repeated = atlas.trajectory(
        attributes["atlas_system"], point, duration=float(read.time[-1]), samples=read.sizes["time"],
        method=attributes["atlas_method"], tolerance=attributes["atlas_tolerance"],
    )  # fmt: skip
    xr.testing.assert_equal(repeated, tr)
    assert 0 < float(read.step) <= 0.2
    atlas_attributes = atlas.label_points(system, POINTS[system], duration=2.0, progress=False).attrs
    assert set(atlas_attributes) - set(attributes) <= {"atlas_seconds", "atlas_points_per_second"}
    assert SYSTEMS[system].title in attributes["title"]


def test_the_title_names_scene_and_place():
    scene = atlas.load_scene(
        'schema = 1\ntitle = "Two spins"\nsystem = "satellite"\n[axes.m]\nvalues = [0.1, 0.2]\n[integration]\nduration = 1.0\n'
    )
    tr = trajectory_of_scene(scene, {"m": 0.15}, samples=3)
    assert tr.attrs["title"] == "Two spins: trajectory at m = 0.15"
    assert float(tr["m"]) == 0.15


def test_plots_of_xarray_are_readable():
    """Short labels with units, and no title of parameters."""
    with matplotlib.rc_context({"backend": "agg"}):
        tr = atlas.trajectory("satellite", POINTS["satellite"], duration=2.0, samples=11)
        for name in ("theta", "psi_dot", "w1", "axis_x"):
            (line,) = tr[name].plot()
            assert line.axes.get_title() == ""
            assert line.axes.get_xlabel() == "time [s]"
            assert len(line.axes.get_ylabel()) <= 40
            line.axes.figure.clear()
    np.testing.assert_array_equal(line.get_ydata(), tr.axis_x)
