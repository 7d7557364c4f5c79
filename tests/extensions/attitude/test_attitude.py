"""Inertia tensors, attitudes and rates as starts, and back, against direction cosines in inertial space written here."""

import subprocess
import sys
from itertools import permutations, product

import numpy as np
import pytest
import xarray as xr
from plugins import registry
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import atlas
from atlas import systems

pytestmark = pytest.mark.usefixtures("whole_kernels")

ALMOST = 1e-12
OMEGA = 0.7
# Axes of the frames of a satellite at time 0, as columns, along radius, velocity and normal.
VELOCITY_NORMAL_NADIR = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
FRAMES = {"orbital": np.eye(3), "lvlh": VELOCITY_NORMAL_NADIR, "inertial": np.eye(3)}


def turn(angle, axis):
    """Matrices that turn vectors about a coordinate axis."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = {
        0: [[one, zero, zero], [zero, c, -s], [zero, s, c]],
        1: [[c, zero, s], [zero, one, zero], [-s, zero, c]],
        2: [[c, -s, zero], [s, c, zero], [zero, zero, one]],
    }
    return np.moveaxis(np.array(rows[axis]), (0, 1), (-2, -1))


def skew(w):
    """Matrices W with W v = w x v."""
    zero = np.zeros_like(w[..., 0])
    x, y, z = np.moveaxis(w, -1, 0)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))


def axial(matrix):
    """The vector of an antisymmetric matrix."""
    return np.stack([matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0]], axis=-1)


def body_in_space(rng, count, theta=None):
    """Matrices whose columns are the axes of bodies along inertial axes, and their time derivatives."""
    theta = np.arccos(rng.uniform(-1, 1, count)) if theta is None else theta
    psi, phi = rng.uniform(-np.pi, np.pi, (2, count))
    body = turn(psi, 2) @ turn(theta, 0) @ turn(phi, 2)
    return body, body @ skew(rng.normal(size=(count, 3)))


def given(body, derivative, frame, rates_in, relative_to):
    """Attitude and rates as arguments of `atlas.start`, by differentiating products of direction cosines at time 0."""
    attitude = FRAMES[frame].T @ body
    orbit = OMEGA * skew(np.array([0.0, 0.0, 1.0]))  # derivative of the orbital axes at time 0
    if relative_to == "orbit":
        derivative = orbit.T @ body + derivative
    rates = axial(np.swapaxes(body, -1, -2) @ derivative)
    return attitude, np.einsum("...ij,...j->...i", attitude, rates) if rates_in == "frame" else rates


def initial(start, **more):
    """Absolute rates, radius and normal in the body at the start, (points, 3) each."""
    system = systems.get("satellite")
    count = start["theta0"].size
    points = {name: np.full(count, each.default) for name, each in system.parameters.items()}
    state = system.initial_state(points | {"Omega": np.full(count, OMEGA)} | start | more)
    return state.T.reshape(count, 3, 3).swapaxes(0, 1)


@pytest.mark.usual("anywhere")
@pytest.mark.parametrize("relative_to", ["orbit", "inertial"])
@pytest.mark.parametrize("rates_in", ["body", "frame"])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("where", ["anywhere", "beside the vertical", "on the vertical"])
def test_a_start_has_the_attitude_and_the_rates_given(where, frame, rates_in, relative_to):
    rng = np.random.default_rng(1)
    count, theta = (1000, rng.choice([0.0, np.pi], 1000)) if where == "on the vertical" else (10_000, None)
    if where == "beside the vertical":
        tilt = 10 ** rng.uniform(-9.99, -1, count)
        theta = np.where(rng.random(count) < 0.5, tilt, np.pi - tilt)
    body, derivative = body_in_space(rng, count, theta)
    attitude, rates = given(body, derivative, frame, rates_in, relative_to)
    start = atlas.start(
        "satellite", attitude=attitude, rates=rates, frame=frame, rates_in=rates_in,
        relative_to=relative_to, Omega=OMEGA,
    )  # fmt: skip
    w, radius, normal = initial(start)
    sine = 1.0 if where == "on the vertical" else np.sin(start["theta0"])[:, None]
    assert np.abs((radius - body[:, 0]) * sine).max() < ALMOST
    assert np.abs((normal - body[:, 2]) * sine).max() < ALMOST
    assert np.abs((w - axial(body.swapaxes(1, 2) @ derivative)) * sine).max() < ALMOST
    if where == "on the vertical":
        assert set(start["theta0"]) == {0.0, np.pi}
        assert not start["n"].any()


def test_on_the_vertical_a_body_that_only_spins_has_no_other_angle_or_rate():
    for theta in (0.0, np.pi):
        body = turn(0.4, 2) @ turn(theta, 0)
        start = atlas.start("satellite", attitude=body, rates=(0, 0, 0.3), rates_in="frame", units="rpm")
        assert start["phi0"] == start["n"] == 0.0
        assert start["psi0"] == pytest.approx(0.4)
        assert start["theta_dot0"] == pytest.approx(0.0, abs=1e-16)
        assert start["m"] == pytest.approx(0.3 * np.cos(theta) * np.pi / 30)


def test_the_axes_of_a_tensor_and_units_count_in_a_start():
    rng = np.random.default_rng(2)
    body, derivative = body_in_space(rng, 500)
    mount = Rotation.random(
        500, rng=rng
    ).as_matrix()  # given axes of the body, as columns in the principal ones
    attitude, rates = given(body @ mount, derivative @ mount, "lvlh", "body", "inertial")
    start = atlas.start(
        "satellite", attitude=attitude, rates=np.degrees(rates), units="deg/s", frame="lvlh",
        relative_to="inertial", Omega=OMEGA, axes=mount,
    )  # fmt: skip
    w, radius, normal = initial(start)
    sine = np.sin(start["theta0"])[:, None]
    assert np.abs((radius - body[:, 0]) * sine).max() < ALMOST
    assert np.abs((normal - body[:, 2]) * sine).max() < ALMOST
    assert np.abs((w - axial(body.swapaxes(1, 2) @ derivative)) * sine).max() < ALMOST


def test_rotations_matrices_and_quaternions_are_the_same_attitude():
    turns = Rotation.random(4, rng=np.random.default_rng(3))
    starts = [
        atlas.start("fixed_point", attitude=attitude, rates=(0.1, 0.2, 0.3))
        for attitude in (turns, turns.as_matrix(), -3 * turns.as_quat())
    ]
    starts.append(
        {
            name: np.array([atlas.start("fixed_point", attitude=each, rates=(0.1, 0.2, 0.3))[name] for each in turns])
            for name in starts[0]
        }
    )  # fmt: skip
    for start in starts[1:]:
        for name, values in starts[0].items():
            np.testing.assert_allclose(start[name], values, atol=1e-13)
    ds = atlas.label_points("fixed_point", starts[0], duration=1.0)
    assert ds.sizes == {"point": 4}
    one = atlas.start("fixed_point", attitude=turns[0], rates=(0.1, 0.2, 0.3))
    assert all(type(value) is float for value in one.values())


def test_a_start_in_the_frame_of_engineers():
    """Attitude 1-2-3 (60, 50, 40) deg relative to LVLH, rates (0.6, 0.5, 1) deg/s relative to inertial space."""
    start = atlas.start(
        "satellite", attitude=Rotation.from_euler("XYZ", [60, 50, 40], degrees=True), rates=(0.6, 0.5, 1.0),
        units="deg/s", frame="lvlh", relative_to="inertial", Omega=1.1e-3,
    )  # fmt: skip
    known = {"theta0": 0.980424, "psi0": -2.744347, "phi0": -1.518515}
    known |= {"theta_dot0": 0.009262, "n": -0.013140, "m": 0.024155}
    assert start == pytest.approx(known, abs=1e-6)


def test_without_omega_the_orbit_of_the_satellite_turns_at_its_default():
    arguments = {"attitude": np.eye(3), "rates": (0.0, 0.0, 1.5), "relative_to": "inertial"}
    assert atlas.start("satellite", **arguments)["m"] == pytest.approx(0.5)
    assert atlas.start("satellite", **arguments, Omega=[0.2, 0.3])["m"] == pytest.approx([1.3, 1.2])


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, -0.3)])
def test_yaw_pitch_and_roll_of_a_body_with_axes_up_forward_and_left(angles):
    """Turns about down, right and forward, of the axes that a body has at theta = psi = phi = 0."""
    yaw, pitch, roll = angles
    body = turn(-yaw, 0) @ turn(-pitch, 2) @ turn(roll, 1)
    start = atlas.start("satellite", attitude=body, rates=(0, 0, 0))
    motion = atlas.trajectory("satellite", start, duration=1e-3, samples=2)
    ds = motion.atlas.attitude(frame="lvlh", euler="ZYX", axes=[[0, 0, -1], [1, 0, 0], [0, -1, 0]])
    np.testing.assert_allclose(ds.angles[0], angles, atol=1e-12)


def inertial_motion(kind, body, matrix, w, times):
    """Direction cosines and rates of a body in inertial space: Euler's equations with the torques of the text books."""
    moments = np.array([body["A"], body["B"], body["C"]])

    def slope(t, y):
        matrix, w = y[:9].reshape(3, 3), y[9:]
        if kind == "satellite":
            radius = matrix.T @ [np.cos(OMEGA * t), np.sin(OMEGA * t), 0.0]
            dipole = -np.array([body[f"mu{i}"] for i in (1, 2, 3)])  # as SI counts it: torque m x B
            rotor = np.array([body[f"k{i}"] for i in (1, 2, 3)])
            field = body["h1"] * radius + body["h3"] * matrix.T @ [0, 0, 1]
            torque = 3 * OMEGA**2 * np.cross(radius, moments * radius) + np.cross(dipole, field)
        else:
            down = matrix.T @ [0.0, 0.0, 1.0]
            rotor = np.array([body[f"l{i}"] for i in (1, 2, 3)])
            torque = np.cross([body["x0"], body["y0"], body["z0"]], body["Mg"] * down)
        w_dot = (torque - np.cross(w, moments * w + rotor)) / moments
        return np.concatenate([(matrix @ skew(w)).ravel(), w_dot])

    run = solve_ivp(slope, (0, times[-1]), np.r_[matrix.ravel(), w], "DOP853", times, rtol=1e-12, atol=1e-13)
    return run.y[:9].T.reshape(-1, 3, 3), run.y[9:].T


SATELLITE = {"A": 1.0, "B": 1.4, "C": 1.7, "k1": 0.1, "k2": -0.2, "k3": 0.3}
SATELLITE |= {"mu1": 0.2, "mu2": 0.1, "mu3": -0.3, "h1": 0.4, "h3": 0.6}
TOP = {
    "A": 1.0,
    "B": 1.4,
    "C": 1.7,
    "Mg": 0.8,
    "x0": 0.1,
    "y0": 0.2,
    "z0": 0.3,
    "l1": 0.1,
    "l2": 0.2,
    "l3": 0.3,
}


@pytest.mark.long
@pytest.mark.parametrize("frame", FRAMES)
def test_the_attitude_of_a_satellite_is_that_in_inertial_space(frame):
    rng = np.random.default_rng(4)
    body, derivative = (each[0] for each in body_in_space(rng, 1))
    mount = Rotation.random(rng=rng).as_matrix()
    attitude, rates = given(body @ mount, derivative @ mount, frame, "body", "orbit")
    start = atlas.start("satellite", attitude=attitude, rates=rates, frame=frame, axes=mount)
    point = SATELLITE | {"Omega": OMEGA} | start
    motion = atlas.trajectory("satellite", point, duration=20.0, samples=201, method="rk8", tolerance=1e-10)
    ds = motion.atlas.attitude(frame=frame, euler="ZYX", axes=mount)
    time = motion.time.values
    bodies, w = inertial_motion("satellite", SATELLITE, body, axial(body.T @ derivative), time)
    orbit = turn(OMEGA * time, 2)
    in_frame = bodies @ mount
    if frame != "inertial":
        in_frame = FRAMES[frame].T @ orbit.swapaxes(1, 2) @ in_frame
    assert np.abs(Rotation.from_quat(ds.quaternion.values).as_matrix() - in_frame).max() < 1e-8
    assert (np.abs(np.diff(ds.quaternion, axis=0)) < 0.5).all()  # no jumps
    relative = np.einsum("ij,tj->ti", mount.T, w - OMEGA * bodies[:, 2])
    np.testing.assert_allclose(ds.rates, relative, atol=1e-8)
    yaw, pitch, roll = ds.angles.values.T
    np.testing.assert_allclose(turn(yaw, 2) @ turn(pitch, 1) @ turn(roll, 0), in_frame, atol=1e-8)
    again = atlas.start("satellite", attitude=ds.quaternion[0], rates=ds.rates[0], frame=frame, axes=mount)
    assert again == pytest.approx(start, abs=1e-12)


@pytest.mark.parametrize("sleeping", [False, True])
def test_the_attitude_of_a_top_is_that_in_space_also_on_the_vertical(sleeping):
    rng = np.random.default_rng(5)
    body, derivative = (each[0] for each in body_in_space(rng, 1, np.zeros(1) if sleeping else None))
    w = np.array([0.0, 0.0, 0.9]) if sleeping else axial(body.T @ derivative)
    top = TOP | ({"x0": 0.0, "y0": 0.0, "l1": 0.0, "l2": 0.0} if sleeping else {})
    start = atlas.start("fixed_point", attitude=body, rates=w)
    motion = atlas.trajectory(
        "fixed_point", top | start, duration=20.0, samples=201, method="rk8", tolerance=1e-10
    )
    ds = motion.atlas.attitude(euler="zxz", degrees=True)
    bodies, w = inertial_motion("fixed_point", top, body, w, motion.time.values)
    assert np.abs(Rotation.from_quat(ds.quaternion.values).as_matrix() - bodies).max() < 1e-8
    np.testing.assert_allclose(ds.rates, w, atol=1e-8)
    assert bool(np.isnan(motion.psi).all()) is sleeping
    assert ds.angles.attrs["units"] == "degree"
    phi, theta, psi = np.radians(ds.angles.values.T)  # about axes at rest: in the other order
    np.testing.assert_allclose(turn(psi, 2) @ turn(theta, 0) @ turn(phi, 2), bodies, atol=1e-8)


@pytest.mark.parametrize("along", ["radius", "normal"])
def test_a_dipole_along_the_field_is_stable_and_one_against_it_is_not(along):
    """The dipole as SI counts it, of energy -m.B, is minus mu; in space at rest nothing else acts."""
    dipole, sign = np.array([0.02, -0.01, 0.03]), np.array([1.0, -1.0])
    axis = {"radius": [1.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0]}[along]
    attitude, _ = Rotation.align_vectors(axis, dipole)
    point = atlas.start("satellite", attitude=attitude, rates=(0, 0, 0))
    point |= dict(zip(("mu1", "mu2", "mu3"), np.outer(-dipole, sign), strict=True))
    point |= {"A": 0.03, "B": 0.03, "C": 0.03, "Omega": 1e-9, {"radius": "h1", "normal": "h3"}[along]: 3e-5}
    point["theta_dot0"] = point["theta_dot0"] + 1e-6
    ds = atlas.label_points(
        "satellite", point, duration=5e4, method="rk8", variables=["label", "theta_min", "theta_max"]
    )
    moved = (ds.theta_max - ds.theta_min).values
    assert moved[0] < 1e-2
    assert moved[1] > 1.0


def tensors(rng, count):
    """Tensors of possible bodies, with three, two or one different moments, and their axes."""
    moments = rng.uniform(1.0, 1.9, (count, 3))
    kind = rng.integers(0, 4, count)
    moments[kind == 1, 0] = moments[kind == 1, 1]
    moments[kind == 2, 2] = moments[kind == 2, 1]
    moments[kind == 3] = moments[kind == 3, :1]
    axes = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    tensor = axes.swapaxes(1, 2) @ (moments[:, :, None] * axes)
    return (tensor + tensor.swapaxes(1, 2)) / 2, np.sort(moments, axis=1)


@pytest.mark.parametrize("order", ["nearest", "ascending"])
def test_principal_axes_are_right_handed_and_diagonalise(order):
    tensor, expected = tensors(np.random.default_rng(6), 2000)
    moments, axes = atlas.principal(tensor, order)
    values = np.stack([moments[name] for name in "ABC"], axis=1)
    assert np.abs(axes @ tensor @ axes.swapaxes(1, 2) - values[:, :, None] * np.eye(3)).max() < 2e-14
    assert np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).max() < 1e-14
    assert (np.linalg.det(axes) > 0).all()
    np.testing.assert_allclose(values if order == "ascending" else np.sort(values), expected, rtol=1e-14)
    same = (np.diff(expected) == 0).any(1)
    assert same.sum() > 1000
    assert (np.diff(np.sort(values)) == 0).any(1)[same].all()  # equal to the bit
    one, matrix = atlas.principal(tensor[0], order)
    assert one == {name: moments[name][0] for name in "ABC"}
    np.testing.assert_array_equal(matrix, axes[0])


def test_the_nearest_axes_are_a_least_turn_away():
    """Against all orders and signs and, where two moments are equal, turns about the axis of symmetry."""
    tensor, moments = tensors(np.random.default_rng(7), 300)
    _, axes = atlas.principal(tensor)
    angles = np.radians(np.arange(0, 360, 0.5))
    for each, (a, b, c), found in zip(tensor, moments, axes, strict=True):
        rows = np.linalg.eigh(each)[1].T
        if a == b == c:
            np.testing.assert_array_equal(found, np.eye(3))
            continue
        candidates = rows[None]
        if a == b or b == c:
            turns = turn(angles, 2 if a == b else 0)
            candidates = turns @ rows
        traces = [
            np.trace(signs[:, None] * candidates[:, order], axis1=1, axis2=2)
            for order in map(list, permutations(range(3)))
            for signs in map(np.array, product((1, -1), repeat=3))
            if np.linalg.det(signs[:, None] * rows[order]) > 0
        ]
        assert np.trace(found) >= np.max(traces) - 1e-12
        assert np.trace(found) <= np.max(traces) + 1e-4  # by the steps of the angles


@pytest.mark.parametrize(
    ("tensor", "axes"),
    [
        (np.diag([3.0, 2.0, 4.0]), np.eye(3)),
        (np.diag([3.0, 2.0, 3.0]), np.eye(3)),
        (np.diag([2.0, 2.0, 2.0]), np.eye(3)),
        # Two orders are equally near: the smaller moment goes to the first axis.
        ([[3.0, 0.5, 0.0], [0.5, 3.0, 0.0], [0.0, 0.0, 4.0]], [[1, -1, 0], [1, 1, 0], [0, 0, 2**0.5]]),
        ([[3.0, -0.5, 0.0], [-0.5, 3.0, 0.0], [0.0, 0.0, 4.0]], [[1, 1, 0], [-1, 1, 0], [0, 0, 2**0.5]]),
        # So are the first and the second axis to that of symmetry.
        ([[1.5, -0.5, 0.0], [-0.5, 1.5, 0.0], [0.0, 0.0, 2.0]], [[1, 1, 0], [-1, 1, 0], [0, 0, 2**0.5]]),
    ],
)
def test_axes_that_are_equally_near_are_chosen_the_same_every_time(tensor, axes):
    rng = np.random.default_rng(8)
    expected = np.array(axes) / np.linalg.norm(axes, axis=1, keepdims=True)
    for scale in (1.0, 1e-3, 1e5):
        noise = rng.uniform(-2e-16, 2e-16, (50, 3, 3)) * scale
        _, found = atlas.principal(scale * np.array(tensor) + noise + noise.swapaxes(1, 2))
        assert np.abs(found - expected).max() < 1e-9


def test_ascending_axes_are_turned_least_among_theirs():
    moments, axes = atlas.principal(np.diag([3.0, 2.0, 3.0]), "ascending")
    assert moments == {"A": 2.0, "B": 3.0, "C": 3.0}
    np.testing.assert_allclose(axes[0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(axes[2], [0, 0, 1], atol=1e-15)


def test_axes_take_vectors_and_equations_to_the_principal_axes():
    """Euler's equations with the tensor in the given axes and with its principal moments."""
    tensor = np.array([[1.3, 0.2, -0.1], [0.2, 1.1, 0.15], [-0.1, 0.15, 1.6]])
    rotor, w = np.array([0.3, 0.1, 0.2]), np.array([0.5, -0.4, 0.7])
    moments, axes = atlas.principal(tensor)
    w_dot = np.linalg.solve(tensor, np.cross(tensor @ w + rotor, w))
    inertia = np.array([moments[name] for name in "ABC"])
    principal = np.cross(inertia * (axes @ w) + axes @ rotor, axes @ w) / inertia
    np.testing.assert_allclose(axes @ w_dot, principal, atol=1e-14)


@pytest.mark.long
def test_neither_import_of_the_package_nor_the_two_functions_load_the_compiler():
    code = (
        "import sys, atlas\n"
        "if 'scipy' in sys.modules: sys.exit(1)\n"
        "atlas.start('fixed_point', attitude=(0, 0, 0, 1), rates=(0, 0, 1)); atlas.principal([[1, 0, 0], [0, 1, 0], [0, 0, 1]])\n"
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_motion_that_lacks_what_an_attitude_needs_is_refused():
    motion = atlas.trajectory("satellite", {"theta0": 0.3}, duration=1.0, samples=3)
    for broken in (motion.drop_vars("a1"), motion.drop_vars("Omega"), motion.isel(time=1)):
        with pytest.raises(
            atlas.BadInput, match="not the trajectory of a body: it needs time, w1, w2, w3, a1, "
        ):
            broken.atlas.attitude()
    for axes in (Rotation.random(2), Rotation.random(3), Rotation.random(3).as_matrix(), [[0, 0, 0, 1]]):
        with pytest.raises(atlas.BadInput, match="axes: those of one body; allowed: one rotation"):
            motion.atlas.attitude(axes=axes)
    with pytest.raises(atlas.BadInput, match="the motion does not stay finite"):
        motion.assign(w1=motion.w1, a1=motion.a1 * np.nan).atlas.attitude()
    degrees = motion.assign(theta=xr.Variable("time", np.degrees(motion.theta), {"units": "degree"}))
    xr.testing.assert_equal(degrees.atlas.attitude(), motion.atlas.attitude())


@pytest.mark.long
def test_systems_of_other_packages_have_attitudes_if_they_have_the_start_values(install_example):
    with registry():
        for name in ("two_field_top", "henon_heiles"):
            install_example(name)
        turns = Rotation.random(rng=np.random.default_rng(9))
        start = atlas.start("two_field_top", attitude=turns, rates=(0.1, 0.2, 0.3), frame="space")
        motion = atlas.trajectory(
            "two_field_top", start | {"mu1": 0.3, "Mg": 0.2, "x3": 0.7}, duration=5.0, samples=11
        )
        ds = motion.atlas.attitude()
        matrices = Rotation.from_quat(ds.quaternion.values).as_matrix()
        assert np.abs(matrices[0] - turns.as_matrix()).max() < 1e-12
        for i, row in ((0, ("a1", "a2", "a3")), (2, ("g1", "g2", "g3"))):
            vector = np.stack([motion[name] for name in row], axis=1)
            np.testing.assert_allclose(matrices[:, i], vector, atol=1e-8)
        np.testing.assert_allclose(ds.rates, np.stack([motion[each] for each in ("w1", "w2", "w3")], 1))
        with pytest.raises(atlas.BadInput, match="the system henon_heiles has no start by theta0, psi0, "):
            atlas.start("henon_heiles", attitude=turns, rates=(0, 0, 1))
