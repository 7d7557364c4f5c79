"""Moments and start values of bodies from inertia tensors, attitudes and angular velocities. Attitudes along motions."""

from __future__ import annotations

import warnings
from itertools import permutations, product
from math import pi
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ... import systems
from ...analysis.degrees import in_degrees, in_rad
from ...analysis.metadata import system_of
from ...errors import BadInput, one_line, shown
from ...kernel.augmented import frame_vectors
from ...label.trajectory import FRAME_AXIS
from ...scene.checks import check_range, choice, typed
from ...scene.tables import check_written, common_size
from ...systems.base import FAMILY_TOLERANCE, NO_RIGID_BODY, Array, Mask, System

Attitude: TypeAlias = "ArrayLike | Rotation"

STARTS = ("theta0", "psi0", "phi0", "theta_dot0", "n", "m")
UNITS = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30}
ORBITAL = "orbital"
LVLH = Rotation.from_matrix([[0, 0, -1], [1, 0, 0], [0, -1, 0]])  # x, y, z are velocity, -normal, nadir
# Rotation from each frame of a satellite to the orbital axes (radius, velocity and orbit normal), at the start.
FRAMES = {ORBITAL: Rotation.identity(), "lvlh": LVLH, "inertial": Rotation.identity()}
# Numbers count as equal up to these relative differences. ASYMMETRY is for elements T_ij and T_ji, EQUAL for moments, TIE for axes.
ASYMMETRY, EQUAL, TIE = 1e-9, 1e-12, 1e-9
ROUNDING = 1e-14  # relative rounding error of an angular velocity
NO_ROTATION = 1e-6  # products of the rows of a rotation matrix may differ from 0 and 1 by this


@typed
def principal(tensor: ArrayLike, order: str = "nearest") -> tuple[dict[str, Any], Array]:
    """Principal moments of inertia and principal axes of an inertia tensor.

    Parameters
    ----------
    tensor : array_like, shape (3, 3) or (points, 3, 3)
        Tensor about the centre of mass, or the fixed point of a top, in given axes of the body. The elements off the diagonal are minus
        the integrals of x y, y z and z x over the mass. If your products of inertia are these integrals themselves, change their
        signs, because a wrong sign cannot be detected.
    order : str, optional
        With "nearest", the smallest rotation takes the given axes to the principal axes of A, B and C, even if moments are
        equal. With "ascending", A <= B <= C.

    Returns
    -------
    moments : dict
        A, B and C, numbers or arrays (points,), for `label_points`. Moments that agree to rounding are made equal.
    axes : numpy.ndarray, shape (3, 3) or (points, 3, 3)
        The rows are right-handed principal axes as components along the given axes. ``axes @ v`` turns the components of a
        vector along the given axes, such as a rotor or a dipole, into components along the principal axes.
    """
    choice("order", order, ("nearest", "ascending"))
    array = _array("tensor", tensor, (3, 3))
    given, many = array.reshape(-1, 3, 3), array.ndim > 2
    difference = np.abs(given - given.swapaxes(1, 2)).max((1, 2))
    asymmetric = difference > ASYMMETRY * np.abs(given).max((1, 2))
    _refuse(asymmetric, many, "not symmetric, mirrored elements differ by {}", difference)
    moments, axes = _principal_axes(given / 2 + given.swapaxes(1, 2) / 2, order == "nearest")
    _refuse(moments.min(1) <= 0, many, "not positive, its least principal moment is {}", moments.min(1))
    for i, text in enumerate(
        ("B + C = {} is less than A", "C + A = {} is less than B", "A + B = {} is less than C")
    ):
        total, moment = moments[:, i - 2] + moments[:, i - 1], moments[:, i]
        _refuse(total < moment * (1 - EQUAL), many, f"{text} = {{}}: {NO_RIGID_BODY}", total, moment)
    columns = dict(zip("ABC", moments.T if many else moments[0].tolist(), strict=True))
    return columns, axes.reshape(array.shape) + 0.0


def _refuse(bad: Mask, many: bool, text: str, *values: Array) -> None:
    for k in np.flatnonzero(bad)[:1]:
        place = f"point {k} (counted from 0): " if many else ""
        raise BadInput(f"{place}tensor: {text.format(*(f'{value[k]:g}' for value in values))}")


def _principal_axes(tensor: Array, nearest: bool) -> tuple[Array, Array]:
    """Return moments, and axes as rows. The axes' signs, and their order if `nearest`, minimise the turn from the axes of `tensor`."""
    moments, vectors = np.linalg.eigh(tensor)
    rows, point = vectors.swapaxes(1, 2), np.arange(len(tensor))
    # The largest component of each axis (the first of equal ones) is made positive, so that the signs from the solver do not matter.
    main = (np.abs(rows) >= np.abs(rows).max(2, keepdims=True) - TIE).argmax(2)
    rows = rows * np.sign(np.take_along_axis(rows, main[..., None], 2))
    orders = np.array([*permutations(range(3))] if nearest else [range(3)])
    signs = np.array([*product((1.0, -1.0), repeat=3)])
    axes = rows[:, orders]
    cosines = np.diagonal(axes, axis1=2, axis2=3) @ signs.T  # traces of rotation matrices, 1 + 2 cos(angle)
    right_handed = np.linalg.det(axes)[..., None] * signs.prod(1) > 0
    score = np.where(right_handed, cosines, -np.inf).reshape(len(tensor), -1)
    order, sign = np.divmod((score >= score.max(1, keepdims=True) - TIE).argmax(1), len(signs))
    axes = axes[point, order] * signs[sign][..., None]
    ordered = np.take_along_axis(moments, orders[order], 1)

    equal = np.diff(moments) <= EQUAL * np.abs(moments[:, 2:])
    k = np.flatnonzero(equal[:, 0] != equal[:, 1])
    if k.size:  # if two moments are equal, use the smallest turn of a given axis to the axis of symmetry
        single = np.where(equal[k, 0], 2, 0)
        axis = main[k, single] if nearest else single
        given, symmetry = np.eye(3)[axis], rows[k, single]
        symmetry = symmetry * np.where((given * symmetry).sum(1) < -TIE, -1.0, 1.0)[:, None]
        real = 1 + (given * symmetry).sum(1)
        axes[k] = Rotation.from_quat(np.column_stack([np.cross(symmetry, given), real])).as_matrix()
        ordered[k] = (moments[k].sum(1) - moments[k, single])[:, None] / 2
        ordered[k, axis] = moments[k, single]
    sphere = equal.all(1)
    axes[sphere], ordered[sphere] = np.eye(3), moments[sphere].mean(1, keepdims=True)
    return ordered, axes


@typed
def start(
    system: str,
    *,
    attitude: Attitude,
    rates: ArrayLike,
    frame: str | None = None,
    rates_in: str = "body",
    relative_to: str | None = None,
    units: str = "rad/s",
    Omega: ArrayLike | None = None,
    axes: Attitude | None = None,
) -> dict[str, Any]:
    """Start values of a body from its attitude and angular velocity.

    Parameters
    ----------
    system : str
        "satellite", "fixed_point", or a system with the same start values.
    attitude : scipy.spatial.transform.Rotation or array_like
        Rotation from body to `frame`: ``attitude.apply(v)`` turns components along body axes into components in the frame. An
        array is a matrix whose columns are the body axes in the frame, (3, 3) or (points, 3, 3), or a quaternion, scalar last,
        (4,) or (points, 4).
    rates : array_like, shape (3,) or (points, 3)
        Components of the angular velocity.
    frame : str, optional
        For a satellite "orbital" (radius, velocity, orbit normal; the default), "lvlh" (velocity, minus the normal, nadir) or
        "inertial" (the orbital axes at the start); about a fixed point "space", whose third axis is the downward vertical.
    rates_in : str, optional
        Axes of the components of `rates`: "body" or "frame".
    relative_to : str, optional
        With "orbit", the default of satellites, rates are relative to the turning orbital frame, whatever `frame` is.
        "inertial" is the only choice about a fixed point.
    units : str, optional
        "rad/s" (rad per time unit), "deg/s" or "rpm".
    Omega : float or array_like (points,), optional
        Angular velocity of the orbit, needed for inertial rates. Pass the same Omega to `label_points`. Default: 1, as for the satellite.
    axes : array_like, optional
        Principal axes from `principal`, if attitude and rates refer to the axes given to `principal`.

    Returns
    -------
    dict
        theta0, psi0, phi0, theta_dot0, n and m, numbers or arrays (points,), for `label_points`.

    Notes
    -----
    If sin(theta0) <= 1e-10, the third axis counts as vertical and only psi0 + phi0 (psi0 - phi0 at theta0 = pi) has a meaning.
    Then n is 0, and m is the rate about the axis. If the axis leaves the vertical, phi0 is such that theta_dot0 is the rate of the
    axis; otherwise phi0 is 0.
    """
    description = systems.get(system)
    frame, to_own = _frame(description, frame)
    references = ("orbit", "inertial") if description.frame == ORBITAL else ("inertial",)
    relative_to = choice("relative_to", references[0] if relative_to is None else relative_to, references)
    choice("rates_in", rates_in, ("body", "frame"))
    turn, body = _rotation("attitude", attitude), _rotation("axes", np.eye(3) if axes is None else axes)
    w, orbit = _array("rates", rates, (3,)) * UNITS[choice("units", units, UNITS)], np.zeros(())
    if description.frame == ORBITAL:
        parameter = description.parameters["Omega"]
        orbit = _array("Omega", parameter.default if Omega is None else Omega, ())
        check_range(parameter, "Omega", orbit.min(), orbit.max())
    elif Omega is not None:
        raise BadInput(f"Omega: the frame of the system {system} does not turn; leave it out")
    sizes = {"attitude": turn.as_quat().shape[:-1], "rates": w.shape[:-1], "axes": body.as_quat().shape[:-1]}
    common_size({name: shape[0] for name, shape in (sizes | {"Omega": orbit.shape}).items() if shape})
    w = body.apply(turn.inv().apply(w) if rates_in == "frame" else w)
    turning = orbit if relative_to == "inertial" else np.zeros(())
    values = np.broadcast_arrays(*_start_values(to_own * turn * body.inv(), w, turning))
    return {name: np.array(v) if v.ndim else float(v) for name, v in zip(STARTS, values, strict=True)}


def _start_values(attitude: Rotation, rates: Array, turning: Array) -> tuple[Array, ...]:
    """Return the values of STARTS from attitude and rates of the principal axes. The rates include the rate `turning` of the frame."""
    x, y, z, s = np.moveaxis(attitude.as_quat(), -1, 0)
    theta = 2 * np.arctan2(np.hypot(x, y), np.hypot(z, s))
    total, difference = 2 * np.arctan2(z, s), 2 * np.arctan2(y, x)  # psi + phi and psi - phi
    phi, sine, cosine = (total - difference) / 2, np.sin(theta), np.cos(theta)
    vertical = sine <= FAMILY_TOLERANCE
    theta, sine = np.where(vertical, np.where(cosine > 0, 0.0, pi), theta), np.where(vertical, 0.0, sine)
    p, q, r = np.moveaxis(rates, -1, 0)
    rounding = ROUNDING * np.sqrt(p**2 + q**2 + r**2 + turning**2)
    p, q = p - turning * sine * np.sin(phi), q - turning * sine * np.cos(phi)
    # If the third axis is vertical, phi is chosen so that the axis moves at the rate theta' alone. Then n = psi' is 0.
    leaving = np.where(np.hypot(p, q) > rounding, np.arctan2(-q, p), 0.0)
    phi = np.where(vertical, leaving, phi)
    psi = np.where(cosine > 0, total - phi, difference + phi)
    across = np.where(vertical, 0.0, p * np.sin(phi) + q * np.cos(phi))
    n = across / np.where(vertical, 1.0, sine)
    psi, phi = (angle - 2 * pi * np.rint(angle / (2 * pi)) for angle in (psi, phi))
    return theta, psi, phi, p * np.cos(phi) - q * np.sin(phi), n, r - (turning + n) * cosine


def attitude(
    ds: xr.Dataset,
    *,
    frame: str | None = None,
    euler: str | None = None,
    axes: Attitude | None = None,
    degrees: bool = False,
) -> xr.Dataset:
    """Attitude and angular velocity along a motion from `atlas.trajectory`, as `atlas.start` takes them.

    Parameters
    ----------
    frame : str, optional
        As in `atlas.start`; "inertial" is the frame of the orbital axes at time 0.
    euler : str, optional
        Three axes of rotation, in SciPy's letters. In the frame "lvlh", "ZYX" gives yaw, pitch and roll. These are rotations
        about the third, then the second, then the first axis of a body whose axes are forward, right and down. "xyz" gives the
        same angles, with roll first.
    axes : array_like, optional
        As in `atlas.start`. Use ``[[0, 0, -1], [1, 0, 0], [0, -1, 0]]`` if the axes of A, B and C point up, forward and left in
        the body. Then the angles in "lvlh" are yaw, pitch and roll, which are 0 at theta = psi = phi = 0.
    degrees : bool, optional
        Angles in degrees.

    Returns
    -------
    Dataset
        `quaternion` (time, component), scalar last, is the rotation from components along body axes to components in the
        frame. `rates` (time, axis) are along body axes, and relative to the orbital frame for a satellite. With `euler` there
        are also `angles` (time, angle). The third angle is 0 if the first and the third rotation have the same axis.
    """
    system, motion = system_of(ds), in_rad(ds)
    (frame, to_own), body = _frame(system, frame), _rotation("axes", np.eye(3) if axes is None else axes)
    if body.as_quat().ndim > 1:
        raise BadInput("axes: those of one body; allowed: one rotation")
    vectors = frame_vectors(system.equations)
    first = vectors[:-1][:1] if hasattr(system.equations, "axis_in_frame") else (FRAME_AXIS,)
    names = [*system.rate_states, *sum((*first, *vectors[-1:]), ())]
    names += ["Omega"] * (system.frame == ORBITAL)
    if len(names) < 9 or "time" not in motion.dims or any(name not in motion for name in names):
        raise BadInput(f"not the trajectory of a body: it needs time, {', '.join(names)}")
    w, x, vertical = np.array([motion[name].values for name in names[:9]]).reshape(3, 3, -1).swapaxes(1, 2)
    orbit = float(motion["Omega"]) if system.frame == ORBITAL else 0.0
    if not np.isfinite(matrix := np.stack([x, np.cross(vertical, x), vertical], axis=1)).all():
        raise BadInput("attitude: the motion does not stay finite")
    turn = to_own.inv() * Rotation.from_matrix(matrix) * body
    if frame == "inertial" and frame != system.frame:
        turn = Rotation.from_rotvec(np.outer(orbit * motion["time"].values, [0, 0, 1])) * turn
    quaternion = turn.as_quat()
    jumps = (quaternion[1:] * quaternion[:-1]).sum(1) < 0  # q and -q are the same rotation
    quaternion[1:] *= np.where(np.cumsum(jumps) % 2, -1.0, 1.0)[:, None]
    words = f"rotation from the body to the {frame} frame"
    relative = ", relative to the orbital frame" if system.frame == ORBITAL else ""
    attributes = {"long_name": f"angular velocity along body axes{relative}", "units": "rad s-1"}
    result = xr.Dataset(
        {
            "quaternion": (("time", "component"), quaternion, {"long_name": f"{words}, scalar last", "units": "1"}),
            "rates": (("time", "axis"), body.inv().apply(w - orbit * vertical), attributes),
        },
        coords={"time": motion["time"], "component": [*"xyzw"], "axis": [1, 2, 3]},
    )  # fmt: skip
    if euler is not None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # SciPy warns in gimbal lock
                angles = turn.as_euler(euler)
        except ValueError as error:
            raise BadInput(f"euler = {shown(euler)}: {one_line(error)}") from None
        attributes = {"long_name": f"angles {euler!r} of the {words}", "units": "rad"}
        result = result.assign(angles=(("time", "angle"), angles, attributes)).assign_coords(angle=[*euler])
    return in_degrees(result, degrees)


def _frame(system: System, frame: str | None) -> tuple[str, Rotation]:
    """Return the name of a frame, by default the system's own, and the rotation from the frame to the system's own frame."""
    needed = [*STARTS, *["Omega"] * (system.frame == ORBITAL)]
    if not system.frame or not system.parameters.keys() >= {*needed}:
        raise BadInput(f"attitude: the system {system.name} has no start by {', '.join(needed)}")
    frames = FRAMES if system.frame == ORBITAL else {system.frame: Rotation.identity()}
    frame = choice("frame", system.frame if frame is None else frame, frames)
    return frame, frames[frame]


def _rotation(key: str, value: Attitude) -> Rotation:
    """Return one rotation, or one for each point, from a SciPy rotation, matrices or quaternions."""
    array = _array(key, value.as_matrix() if isinstance(value, Rotation) else value, (3, 3), (4,))
    if array.shape[-2:] != (3, 3):
        size = np.abs(array).max(-1, keepdims=True)
        if (size == 0).any():
            raise BadInput(f"{key}: a quaternion of length 0 is no rotation")
        return Rotation.from_quat(array / size)
    with np.errstate(all="ignore"):
        error = np.abs(array @ array.swapaxes(-1, -2) - np.eye(3)).max()
    if not error <= NO_ROTATION:
        raise BadInput(f"{key}: no rotation, products of its rows differ from 0 and 1 by {error:g}")
    if (np.linalg.det(array) < 0).any():
        raise BadInput(f"{key}: a reflection, no rotation: its determinant is -1, the axes are left-handed")
    return Rotation.from_matrix(array)


def _array(key: str, value: object, *shapes: tuple[int, ...]) -> Array:
    """Return finite numbers as floats, in one of the shapes or, for several points, in the shape (points, *shape)."""
    check_written(key, value)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise TypeError
    except (TypeError, ValueError):  # rows of different lengths
        raise BadInput(f"{key} = {shown(value)}: must be numbers") from None
    if not array.size or (array.shape not in shapes and array.shape[1:] not in shapes):
        forms = " or ".join(f"{shape}" for shape in shapes)
        raise BadInput(f"{key}: its shape is {array.shape}; allowed: {forms}, or (points, ...) of these")
    if not np.isfinite(array := array.astype(np.float64)).all():
        raise BadInput(f"{key} = {shown(value)}: must be finite numbers")
    return array
