"""The dataset of a trajectory: its angles against another integration; units, parameters, provenance."""

from functools import cache

import matplotlib
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from strategies import BySystem

import atlas
from atlas.label.trajectory import trajectory_of_scene
from atlas.systems import SYSTEMS

pytestmark = pytest.mark.usefixtures("whole_kernels")

POINTS = BySystem(
    {
        "satellite": {"theta0": 0.7, "k3": 0.3, "m": 0.4},
        "fixed_point": {"theta0": 0.7, "l3": 0.3, "n": 0.2, "Mg": 1.0},
    }
)
# Motions that pass near the vertical: of a smooth motion, a sum over a few samples may be near the truth by chance.
MOTIONS = BySystem({
    "satellite": {
        "theta0": 1.0, "psi0": 1.0, "phi0": 4.0, "theta_dot0": -1.0, "n": 0.01, "m": 5.0, "k3": -7.0, "B": 1.1
    },
    "fixed_point": {
        "theta0": 1.0, "psi0": -4.0, "phi0": 1.0, "theta_dot0": -1.0, "n": 0.01, "m": 0.1, "Mg": 1.0, "z0": 1.0
    },
})  # fmt: skip
DURATION = 12.0


@cache
def euler_angles(name):
    """theta, psi and phi of the motion of a system over time, by DOP853 in these angles and the angular velocity."""
    system = SYSTEMS[name]
    given = MOTIONS[name]
    points = {key: np.array([given.get(key, each.default)]) for key, each in system.parameters.items()}
    constants, start = system.constants(points)[:, 0], system.initial_state(points)[:, 0]

    def slope(time, y):
        theta, psi, phi = y[3:]
        attitude = Rotation.from_euler("ZXZ", [psi, theta, phi]).as_matrix()
        state = [*y[:3], *attitude[[0, 2] if len(start) == 9 else [2]].ravel()]
        u1, u2, u3, *_ = system.equations.frame_motion(state, constants)
        psi_dot = (u1 * np.sin(phi) + u2 * np.cos(phi)) / np.sin(theta)
        theta_dot = u1 * np.cos(phi) - u2 * np.sin(phi)
        rates = system.equations.rhs(state, constants)[:3]
        return [*rates, theta_dot, psi_dot, u3 - psi_dot * np.cos(theta)]

    angles = [given[key] for key in ("theta0", "psi0", "phi0")]
    return solve_ivp(
        slope, (0, DURATION), [*start[:3], *angles], "DOP853", rtol=1e-9, atol=1e-10, dense_output=True
    ).sol


@pytest.mark.usual("7")
@pytest.mark.parametrize("samples", [2, 7, 301])
@pytest.mark.parametrize("system", SYSTEMS)
def test_angles_are_those_of_another_integration_for_any_number_of_samples(system, samples):
    tr = atlas.trajectory(
        system, MOTIONS[system], duration=DURATION, samples=samples, method="rk8", tolerance=1e-9
    )
    theta, psi, phi = euler_angles(system)(tr.time.values)[3:]
    assert np.sin(theta).min() < 0.05 or samples < 300
    for name in ("psi", "phi"):
        assert float(tr[name][0]) == pytest.approx(MOTIONS[system][f"{name}0"], abs=1e-14)
    for name, expected in (("theta", theta), ("psi", psi), ("phi", phi)):
        np.testing.assert_allclose(tr[name], expected, atol=1e-6)
    attitude = Rotation.from_euler("ZXZ", np.stack([psi, theta, phi], -1)).as_matrix()
    np.testing.assert_allclose(np.stack([tr[f"axis_{i}"] for i in "xyz"], -1), attitude[:, :, 2], atol=1e-6)
    np.testing.assert_allclose(np.stack([tr[f"g{i}"] for i in "123"], -1), attitude[:, 2], atol=1e-6)


@pytest.mark.long
def test_passages_of_the_vertical():
    """A top that falls through it turns by the same in both directions beside it, and half a turn exactly through it."""
    top = {"A": 1.0, "B": 1.0, "C": 0.6, "Mg": 1.0, "z0": 1.0, "theta0": 1.0, "theta_dot0": 1.0}
    for samples in (5, 61):
        one, other, through = (
            atlas.trajectory("fixed_point", top | {"n": n}, duration=30.0, samples=samples)
            for n in (1e-4, -1e-4, 0.0)
        )
        np.testing.assert_allclose(one.psi, -other.psi, atol=1e-8)
        np.testing.assert_allclose(one.phi, -other.phi, atol=1e-8)
        assert float(one.psi[-1]) == pytest.approx(8 * np.pi, abs=2e-3)
        assert float(through.psi[-1]) == pytest.approx(-8 * np.pi, abs=1e-12)
        np.testing.assert_allclose(through.psi + through.phi, 0.0, atol=1e-12)


@pytest.mark.parametrize("system", SYSTEMS)
def test_rates_are_the_derivatives_of_the_angles(system):
    point = POINTS[system] | {"theta_dot0": 0.2, "n": 0.3, "m": 0.4}
    tr = atlas.trajectory(system, point, duration=1.0, samples=101)
    for name in ("theta", "psi", "phi"):
        assert np.abs(tr[f"{name}_dot"]).max() > 0.1
        derivative = np.gradient(tr[name], tr.time, edge_order=2)
        np.testing.assert_allclose(derivative, tr[f"{name}_dot"], atol=2e-3)


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_rate_about_the_vertical_and_the_drift_of_integrals(system, damping):
    """The rate follows from the angles; the drift is that of the atlas with the same steps, losses by damping included."""
    point = POINTS[system] | {"B": 1.2, "C": 0.8, "theta_dot0": 0.2, "n": 0.3, "m": 0.4, "damping": damping}
    tr = atlas.trajectory(system, point, duration=6.0, samples=241, step=0.025)
    ds = atlas.label_points(system, point, duration=6.0, step=0.025, progress=False)
    np.testing.assert_allclose(tr.normal_rate, tr.psi_dot + tr.phi_dot * np.cos(tr.theta), atol=1e-7)
    assert tr.integral_drift[0] == 0.0
    assert 1e-12 < tr.integral_drift.max().item() == pytest.approx(ds.integral_drift.item(), rel=0.3)


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
    atlas_attributes = atlas.label_points(system, POINTS[system], duration=20.0, progress=False).attrs
    assert set(atlas_attributes) - set(attributes) <= {"atlas_seconds", "atlas_points_per_second"}
    assert atlas_attributes["atlas_points_per_second"] * atlas_attributes["atlas_seconds"] == pytest.approx(1)
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


@pytest.mark.usual("satellite-0.02-19.98-2", "fixed_point-0.25-90.0-2")
@pytest.mark.parametrize(
    ("step", "duration", "samples", "steps"),
    [
        (0.25, 90.0, 2, 360),
        (0.25, 90.0, 46, 360),
        (0.25, 90.0, 8, 364),
        (0.07, 20.0, 2, 286),
        (0.07, 20.0, 3, 286),
        (0.02, 19.98, 2, 999),
    ],
)
@pytest.mark.parametrize("system", POINTS)
def test_a_step_that_divides_the_distance_of_two_samples_is_taken_as_it_is(
    system, step, duration, samples, steps
):
    """Else the next shorter one; states and angles at common instants are those of any other number of samples."""
    point = POINTS[system]
    tr = atlas.trajectory(system, point, step=step, duration=duration, samples=samples)
    assert duration / float(tr["step"]) == pytest.approx(steps, rel=1e-12)
    every_step = atlas.trajectory(system, point, step=float(tr["step"]), duration=duration, samples=steps + 1)
    for name, values in tr.data_vars.items():
        if values.dims:
            at_samples = every_step[name].values[:: steps // (samples - 1)]
            np.testing.assert_allclose(values, at_samples, rtol=0, atol=1e-9, err_msg=name)
