"""Motion of one point in time, computed with the kernel and the steps that label the point in an atlas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from .. import systems
from ..errors import BadInput
from ..kernel import blocks, numeric_bound
from ..kernel.augmented import with_frame_vector
from ..kernel.ensemble import Ensemble
from ..kernel.stepsize import StepSizes, steps_between_instants
from ..kernel.tableaux import METHODS, Method
from ..scene import checks, grid
from ..scene.model import DEFAULTS, Duration, Scene, Settings
from ..scene.read import check_at_points, check_unit, parse_duration
from ..scene.tables import point_columns, table
from ..store import dataset
from ..systems.base import Array, Points, System, check_possible, time_units
from ..variables import main_instrument
from .plan import Plan

# Largest number of instants of a trajectory. A trajectory of this length takes some gigabytes.
MAX_SAMPLES = 10**7
# psi and phi are continued from node to node, for SIDE_BY_SIDE nodes at a time. Every instant of the trajectory is a node. If there
# are fewer than NODES instants, further nodes are added, which are at least STEPS_PER_NODE steps apart.
NODES, STEPS_PER_NODE, SIDE_BY_SIDE = 1000, 64, 4096
# Let d be the sum of the distances between the vertical and the third axis at the two ends of a step. psi and phi are continued over
# the step if the body turns by less than LARGEST_TURN (rad) and the vertical moves in the body by less than d / MARGIN. Any other
# step is halved, unless d is only a rounding error (d < AT_VERTICAL).
AT_VERTICAL, LARGEST_TURN, MARGIN = 1e-13, 1.5, 1.5
MAX_HALVINGS = 60
# Components of the first axis of the frame along the body axes.
FRAME_AXIS = ("frame_axis_1", "frame_axis_2", "frame_axis_3")
_RATE = "rad s-1"
# Variable -> long_name and units.
_VARIABLES = {
    "theta": ("nutation angle theta", "rad"),
    "psi": ("precession angle psi", "rad"),
    "phi": ("proper rotation phi", "rad"),
    "theta_dot": ("nutation rate theta'", _RATE),
    "psi_dot": ("precession rate psi'", _RATE),
    "phi_dot": ("proper rotation rate phi'", _RATE),
    "normal_rate": ("rate about the vertical", _RATE),
}


def trajectory(
    system: str,
    point: Mapping[str, Any],
    *,
    duration: float | str = Duration.amount,
    samples: int = 1001,
    step: float | None = None,
    method: str = DEFAULTS.method,
    tolerance: float = DEFAULTS.tolerance,
    rate_tolerance: float | str = DEFAULTS.rate_tolerance,
) -> xr.Dataset:
    """Motion of one point.

    Parameters
    ----------
    system : str
        Name of a system, such as "satellite" or "fixed_point".
    point : mapping of str to float, or Series
        Parameters; omitted parameters take their defaults. A row of a DataFrame for `label_points` may be given.
    duration : float or str
        Duration in time units, or a text as in `label_points`.
    samples : int
        Number of evenly spaced instants from 0 to `duration`, at least 2.
    step : float, optional
        Largest step in time units. By default steps are as long as in `label_points`, or shorter to end at the instants.
    method : str
        "rk4" or "rk8".
    tolerance : float
        Phase error of the fastest frequency at the end of the run, rad.
    rate_tolerance : float or str
        Largest variation of a rate that counts as constant, rad per time unit, or arithmetic as in `label_points`.

    Returns
    -------
    xarray.Dataset
        Variables over the dimension "time", float64. For a body they are the states by their names in the equations; theta,
        psi, phi (rad); theta_dot, psi_dot, phi_dot, normal_rate (rad per time unit); axis_x, axis_y, axis_z (components of the
        third body axis in the frame, for the satellite along radius, velocity and normal); frame_axis_1, _2, _3 (components of
        the first frame axis along the body axes, unless the state contains this axis); integral_drift. A system with
        observables has the states, the observables and integral_drift. `step` and the parameters have no dimension. The name
        of a parameter ends in _start if a variable over "time" has the same name. Attributes are as in an atlas.

    Raises
    ------
    BadInput
        For the same reasons as in `label_points`.

    Notes
    -----
    psi and phi begin at psi0 and phi0 (psi at 0 if the system has no psi0). Both angles are unwrapped along the steps of the
    integration, so that neither the angles nor axis_x, axis_y, axis_z depend on `samples`. These components follow from a vector
    at rest in the frame. The vector is integrated with the motion, and stays smooth where the third axis is vertical. There psi
    and phi do not exist and are nan. If the third axis passes close to the vertical, psi and phi both change by half a turn, so
    that psi + phi is continuous (psi - phi at theta = pi). If the third axis passes exactly through the vertical, phi turns forward.
    """
    settings = Settings(method=method, step=step, tolerance=tolerance, rate_tolerance=rate_tolerance)
    description = systems.get(system)
    length = parse_duration(duration, names=description.parameters)
    source = table(point, description.parameters)
    # `label_points` uses the same kernel for the same parameters.
    plan = Plan.of_points(description, settings, None, source)
    return trajectory_of_point(plan, source, length, samples)


def trajectory_of_point(
    plan: Plan, point: Mapping[str, Any], duration: Duration, samples: int, title: str = ""
) -> xr.Dataset:
    """Return the motion of one point, computed with the kernel of `plan`. See `trajectory`."""
    system, settings = plan.system, plan.settings
    checks.whole_number("samples", samples, 2, MAX_SAMPLES)
    points, size = point_columns(system, point)
    if size != 1:
        raise BadInput(f"point: {size} points given; a trajectory is that of one")
    check_possible(system, points)
    check_unit(system, duration)
    check_at_points("rate_tolerance", settings.rate_tolerance, points)
    durations = grid.durations(system, duration, points)
    rate_tolerance = grid.at_points(system, settings.rate_tolerance, points)
    for value, reason in ((durations, grid.Reason.NO_DURATION), (rate_tolerance, grid.Reason.NO_TOLERANCE)):
        if np.isnan(value[0]):
            raise BadInput(f"no motion: {grid.sentence(reason, system, None, duration)}")
    settings = settings.with_number(float(rate_tolerance[0]))
    at_point, ensemble = settings.at(rate_tolerance), Ensemble.of(system, points)
    method = METHODS[settings.method]
    with np.errstate(all="ignore"):  # the motion is not finite if numbers overflow
        bound, _ = numeric_bound.along_runs(
            system, plan.kernel, method, ensemble, durations, settings.max_steps, blocks.Threads(1)
        )
        whole = StepSizes.of(at_point, bound, durations).steps
    steps = int(steps_between_instants(at_point, whole, durations, samples - 1)[0])
    has_angles = main_instrument(system).has_theory
    parts = max(1, min(steps // STEPS_PER_NODE, NODES // (samples - 1))) if has_angles else 1
    # The last part before a sample may be shorter than the others.
    ends = np.append(np.arange(-(-steps // parts), steps, -(-steps // parts)), steps)
    parts, steps_of_parts = ends.size, np.tile(np.diff(ends, prepend=0), samples - 1)
    step_size = durations / (steps * (samples - 1))
    states, lost = _states(plan.kernel, ensemble, steps_of_parts, step_size)
    path = {}
    if has_angles:
        with np.errstate(all="ignore"):
            equations = with_frame_vector(system.equations)
            motion = _Motion(equations, method, ensemble.constants, float(step_size[0]))
            path = _path(system, points, motion, states, steps_of_parts)
    at_samples = slice(None, None, parts)
    path, lost = ({name: values[at_samples] for name, values in each.items()} for each in (path, lost))
    ds = _dataset(system, ensemble, states[at_samples], lost, path, np.linspace(0.0, durations[0], samples))
    # Numbers are stored as variables, because xarray prints scalar coordinates over every plot.
    ds["step"] = (
        (),
        float(step_size[0]),
        {"long_name": "integration step", "units": time_units(system, "s")},
    )
    for name, parameter in system.parameters.items():
        start = float(points[name][0])
        if not np.isnan(start):
            attributes = {"long_name": parameter.meaning, "units": parameter.unit}
            ds[f"{name}_start" if name in ds else name] = ((), start, attributes)
    ds.attrs = dataset.provenance(
        system, settings, plan.kernel_hash, title=title or f"trajectory of the {system.title}",
        warnings=system.warnings(points),
    )  # fmt: skip
    return dataset.without_fill_values(ds)


def trajectory_of_scene(scene: Scene, places: Mapping[str, float], *, samples: int = 1001) -> xr.Dataset:
    """Return the motion at `places`, a value for each axis. Raise BadInput for a wrong axis or a point without motion."""
    located = grid.point_at(scene, places, "a trajectory")
    point = {name: values[0] for name, values in located.points.items() if not np.isnan(values[0])}
    place = ", ".join(f"{name} = {value:g}" for name, value in places.items())
    title = f"{scene.title}: trajectory at {place}"
    duration, settings = Duration(float(located.until[0])), scene.settings
    settings = settings.with_number(float(located.rate_tolerance[0]))
    plan = replace(Plan.of(scene), settings=settings, outputs=None)
    return trajectory_of_point(plan, point, duration, samples, title)


def _states(
    module: Any, ensemble: Ensemble, steps: NDArray[np.int64], step_size: Array
) -> tuple[Array, dict[str, Array]]:
    """Return the states at the nodes, which are `steps` apart, (nodes, states), and the losses of first integrals at each node."""
    count, arrays = len(ensemble.state), ensemble.arrays(module, step_size)
    schedules = {n: blocks.pack_blocks(np.array([n]), np.array([n])) for n in set(steps.tolist())}
    states = np.empty((steps.size + 1, len(arrays.state)))
    states[0] = arrays.state[:, 0]
    for i, n in enumerate(steps.tolist(), 1):
        blocks.integrate(module, schedules[n], arrays, threads=blocks.Threads(0))
        states[i] = arrays.state[:, 0]
    lost = getattr(module, "LOSSES", ())
    return states[:, :count], dict(zip(lost, states[:, count:].T, strict=True))


def _dataset(
    system: System,
    ensemble: Ensemble,
    states: Array,
    lost: Mapping[str, Array],
    path: Mapping[str, Array],
    time: Array,
) -> xr.Dataset:
    """Return the trajectory with angles, rates and the drift of the first integrals."""
    equations, constants = system.equations, ensemble.constants
    columns = {name: states[:, i] for i, name in enumerate(equations.STATE)}
    if path:
        u1, u2, u3, g1, g2, g3 = equations.frame_motion(states.T, constants)
        with np.errstate(all="ignore"):
            sine = np.hypot(g1, g2)
            psi_dot = (u1 * g1 + u2 * g2) / sine**2
            columns |= {
                **path,
                "theta": np.arctan2(sine, g3),
                "phi": np.where(sine == 0.0, np.nan, path["phi"]),
                "theta_dot": (u1 * g2 - u2 * g1) / sine,
                "psi_dot": psi_dot,
                "phi_dot": u3 - psi_dot * g3,
                "normal_rate": u1 * g1 + u2 * g2 + u3 * g3,
                "psi": np.where(sine == 0.0, np.nan, path["psi"]),
                "axis_z": g3,
            }
    for name in (o.name for o in system.observables if o.name not in columns):
        with np.errstate(all="ignore"):
            columns[name] = np.broadcast_to(getattr(equations, name)(states.T, constants), len(states))
    drift = np.zeros(len(time))
    with np.errstate(all="ignore"):
        for name, scale in zip(equations.INTEGRALS, ensemble.scales, strict=True):
            total = sum(getattr(equations, name)(states.T, constants)) + lost.get(name, 0.0)
            drift = np.maximum(drift, np.abs(total - total[0]) * scale)
    columns["integral_drift"] = drift
    of_frame = {"long_name": "first axis of the frame, along a body axis", "units": "1"}
    attributes = attributes_of(system) | dict.fromkeys(FRAME_AXIS, of_frame)
    for name in ("psi", "phi", "theta_dot", "psi_dot", "phi_dot") if path else ():
        attributes[name]["comment"] = "nan where the third axis is exactly on the vertical"
    return xr.Dataset(
        {name: ("time", np.asarray(values), attributes[name]) for name, values in columns.items()},
        coords={"time": ("time", time, {"long_name": "time", "units": time_units(system, "s")})},
    )


def attributes_of(system: System) -> dict[str, dict[str, str]]:
    """Return the attributes of each quantity of a motion, by name. Only states that are rates have known units."""
    attributes = {name: {"long_name": f"state {name}"} for name in system.equations.STATE}
    for name in system.rate_states:
        attributes[name]["units"] = _RATE
    texts = {"integral_drift": ("change of a first integral", "1")}
    if main_instrument(system).has_theory:
        texts |= _VARIABLES
        for name, axis in zip(("axis_x", "axis_y", "axis_z"), system.frame_axes, strict=True):
            texts[name] = f"third axis along {axis.strip('$')}", "1"
    texts |= {o.name: (o.long_name, o.unit) for o in system.observables}
    return attributes | {name: {"long_name": text, "units": units} for name, (text, units) in texts.items()}


def _path(
    system: System, points: Points, motion: _Motion, states: Array, steps: NDArray[np.int64]
) -> dict[str, Array]:
    """Return the unwrapped psi and phi and the third axis in the frame at the nodes. `states` has shape (nodes, states)."""
    state = states.T
    vertical = np.array(system.equations.frame_motion(state, motion.constants)[3:])
    if motion.equations is system.equations:
        turns, _ = motion.turns(state[:, :-1], steps)
    else:
        # The motions between nodes are computed side by side, each with three known vectors in place of the frame's first axis. The
        # equation of this axis is linear, so that the axis is a fixed combination of the vectors. The first vector is horizontal.
        unit = vertical / np.linalg.norm(vertical, axis=0)
        body_axis = np.argmin(np.abs(unit), axis=0)
        first = np.eye(3)[:, body_axis] - unit * np.take_along_axis(unit, body_axis[None], 0)
        first /= np.linalg.norm(first, axis=0)
        basis = [first, np.cross(unit, first, axis=0), unit]
        runs = [motion.turns(np.concatenate([state, vector])[:, :-1], steps) for vector in basis]
        turns, ends = runs[0][0], [end[-3:] for _, end in runs]
        maps = sum(end.T[:, :, None] * vector.T[:-1, None] for end, vector in zip(ends, basis, strict=True))
        vectors = [frame_vector(system, points, states[:1].T, motion.constants)[:, 0]]
        for each in maps:
            vectors.append(each @ vectors[-1])
        state = np.concatenate([state, np.array(vectors).T])
    axis, *_ = motion.axis_and_vertical(state)
    result = {"axis_x": axis.real, "axis_y": axis.imag}
    if motion.equations is not system.equations:
        result |= dict(zip(FRAME_AXIS, state[-3:], strict=True))
    angles = np.array([np.arctan2(axis.real, -axis.imag), np.arctan2(vertical[0], vertical[1])])
    for name, angle, turn in zip(("psi", "phi"), angles, turns, strict=True):
        start = _branch(angle[0], float(np.ravel(points.get(f"{name}0", 0.0))[0]))
        result[name] = _branch(angle, np.cumsum(np.r_[start, turn]))
    return result


def frame_vector(system: System, points: Points, state: Array, constants: Array) -> Array:
    """Return the body components of the first frame axis at the start, from psi0 and, if the third axis is vertical, from phi0."""
    g1, g2, g3 = system.equations.frame_motion(state, constants)[3:]
    theta0, psi, phi0 = (points.get(name, np.zeros_like(g3)) for name in ("theta0", "psi0", "phi0"))
    psi = psi + np.where(np.sin(theta0) < 0.0, np.pi, 0.0)  # so that theta is positive
    sine = np.hypot(g1, g2)
    with np.errstate(invalid="ignore"):
        sf, cf = np.where(sine == 0.0, [np.sin(phi0), np.cos(phi0)], np.array([g1, g2]) / sine)
    return np.array([
        np.cos(psi) * cf - g3 * sf * np.sin(psi), -np.cos(psi) * sf - g3 * cf * np.sin(psi), sine * np.sin(psi)
    ])  # fmt: skip


def _branch(angle: Any, near: Any) -> Any:
    """Return `angle` plus the number of whole turns for which the sum is nearest to `near`."""
    return angle + 2 * np.pi * np.rint((near - angle) / (2 * np.pi))


@dataclass(frozen=True)
class _Motion:
    """Integrator of many motions of one body. `equations` must have `axis_in_frame`. `constants` has shape (constants, 1)."""

    equations: Any
    method: Method
    constants: Array
    step_size: float

    def axis_and_vertical(self, state: Array) -> tuple[Array, Array, Array, Array]:
        """Return sin(theta) e^(i psi) / i, sin(theta) e^(i phi), cos(theta), and [speed of the vertical in the body, angular speed]."""
        u1, u2, u3, g1, g2, g3 = self.equations.frame_motion(state, self.constants)
        x, y = self.equations.axis_in_frame(state, self.constants)
        speed = np.hypot(g2 * u3 - g3 * u2, g3 * u1 - g1 * u3)
        return x + 1j * y, g2 + 1j * g1, g3, np.array([speed, np.sqrt(u1 * u1 + u2 * u2 + u3 * u3)])

    def step(self, state: Array) -> Array:
        """Return the states, (states, motions), after one step."""

        def slope(state: Array) -> Array:
            return np.array(np.broadcast_arrays(*self.equations.rhs(state, self.constants)))

        return np.asarray(self.method.step(slope, state, self.step_size))

    def turns(self, state: Array, steps: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the changes of psi and phi, (2, motions), in `steps` steps of each motion, and the final states."""
        numbers = [np.flatnonzero(steps == number) for number in np.unique(steps)]
        groups = [group for each in numbers for group in np.array_split(each, -(-each.size // SIDE_BY_SIDE))]
        if len(groups) > 1:
            turns, ends = np.empty((2, steps.size)), np.empty_like(state)
            for group in groups:
                turns[:, group], ends[:, group] = self.turns(state[:, group], steps[group])
            return turns, ends
        turns, pending = np.zeros((2, state.shape[1])), []
        for _ in range(steps[0]):
            new = self.step(state)
            pending.append(self._add_turns(turns, state, new, np.arange(state.shape[1])))
            state = new
        before, after, motions = (np.concatenate(each, axis=-1) for each in zip(*pending, strict=True))
        part = self
        for _ in range(MAX_HALVINGS):
            if not motions.size:
                break
            part = replace(part, step_size=0.5 * part.step_size)
            middle = part.step(before)
            halves = np.concatenate([before, middle], axis=1), np.concatenate([middle, after], axis=1)
            before, after, motions = part._add_turns(turns, *halves, np.tile(motions, 2))
        return turns, state

    def _add_turns(
        self, turns: Array, before: Array, after: Array, motions: NDArray[np.int64]
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        """Add changes of psi and phi over short steps to `turns`. Return states before and after long steps, and the motions' indices."""
        w0, z0, g3, rates0 = self.axis_and_vertical(before)
        w1, z1, _, rates1 = self.axis_and_vertical(after)
        distance, (path, angle) = np.abs(z0) + np.abs(z1), self.step_size * np.maximum(rates0, rates1)
        too_long = ((distance <= MARGIN * path) | (angle >= LARGEST_TURN)) & (distance >= AT_VERTICAL)
        turn = z1 * z0.conj()
        phi = np.angle(turn)
        # If the axis passes exactly through the vertical, phi changes by half a turn. The turn is forward, whatever the rounding.
        phi = np.where(phi < 0.1 - np.pi, phi + 2 * np.pi, phi)
        # psi + phi is continuous near theta = 0, and psi - phi is continuous near theta = pi.
        regular = np.angle(w1 * w0.conj() * np.where(g3 > 0.0, turn, turn.conj()))
        psi = np.where(g3 > 0.0, regular - phi, regular + phi)
        for total, change in zip(turns, (psi, phi), strict=True):
            np.add.at(total, motions[~too_long], change[~too_long])
        return before[:, too_long], after[:, too_long], motions[too_long]
