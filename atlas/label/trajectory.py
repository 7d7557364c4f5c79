"""The motion of one point in time, by the kernel and the steps that label it in an atlas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.integrate import cumulative_simpson

from .. import systems
from ..engine import blocks, numeric_bound
from ..engine.ensemble import Ensemble
from ..engine.specialization import kernel, kernel_hash
from ..engine.stepsize import StepSizes
from ..engine.tableaux import METHODS
from ..errors import BadInput
from ..io import provenance
from ..scene import checks, grid
from ..scene.model import DEFAULTS, Duration, Scene, Settings
from ..scene.tables import point_columns
from ..systems.base import Array, Points, System

# Instants of a trajectory: some gigabytes.
MAX_SAMPLES = 10**7
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
    "integral_drift": ("change of a first integral", "1"),
}


def trajectory(
    system: str,
    point: Mapping[str, Any],
    *,
    duration: float = Duration.amount,
    samples: int = 1001,
    step: float | None = None,
    method: str = DEFAULTS.method,
    tolerance: float = DEFAULTS.tolerance,
    rate_tolerance: float = DEFAULTS.rate_tolerance,
) -> xr.Dataset:
    """Motion of one point.

    Parameters
    ----------
    system : str
        Name of a system, such as "satellite" or "fixed_point".
    point : mapping of str to float
        Parameters; those that are left out take their defaults.
    duration : float
        In time units.
    samples : int
        Instants from 0 to `duration`, evenly spaced, at least 2.
    step : float, optional
        As for `label_points`, as are the next three; steps are never longer than there.
    method : str
        "rk4" or "rk8".
    tolerance : float
        Phase error of the fastest frequency at the end of the run, rad.
    rate_tolerance : float
        Variation of a rate that counts as none, rad per time unit.

    Returns
    -------
    xarray.Dataset
        Over the dimension "time", float64: the state by the names of the equations; theta, psi, phi (rad; psi and phi
        unwrapped, nan on the vertical, where they do not exist); theta_dot, psi_dot, phi_dot, normal_rate (rad per time
        unit); axis_x, axis_y, axis_z (the third body axis in the frame: for the satellite along radius, velocity and
        normal); integral_drift. Of a system with observables: the states, the observables and integral_drift. Without
        a dimension: `step`, and the parameters (a start value that has the name of one of the variables has the suffix
        _start). The attributes are those of an atlas.

    Raises
    ------
    BadInput
        As `label_points`.
    """
    settings = Settings(method=method, step=step, tolerance=tolerance, rate_tolerance=rate_tolerance)
    return _trajectory(systems.get(system), point, duration, samples, settings, "")


def _trajectory(
    system: System, point: Mapping[str, Any], duration: float, samples: int, settings: Settings, title: str
) -> xr.Dataset:
    """As `trajectory`, with a title."""
    checks.whole_number("samples", samples, 2, MAX_SAMPLES)
    duration = checks.positive("duration", duration)
    points, size = point_columns(system, point)
    if size != 1:
        raise BadInput(f"point: {size} points given; a trajectory is that of one")
    system.check_possible(points)
    ensemble = Ensemble.of(system, points)
    module = kernel(system, settings.method)
    durations = np.array([duration])
    with np.errstate(all="ignore"):  # numbers may overflow: the motion is then not finite
        bound = ensemble.frequency_bound
        if system.has_numeric_bound:
            bound, _ = numeric_bound.along_runs(
                system, module, METHODS[settings.method], ensemble, durations, settings.max_steps, threads=1
            )
        step_sizes = StepSizes.of(settings, bound, durations)
    # Whole steps between samples, never longer than those of the atlas.
    steps_per_sample = -(-int(step_sizes.steps[0]) // (samples - 1))
    step_size = np.array([duration / (steps_per_sample * (samples - 1))])
    states, lost = _states(system, module, ensemble, steps_per_sample, step_size, samples)
    ds = _dataset(system, ensemble, states, lost, np.linspace(0.0, duration, samples))
    _add_parameters(ds, system, points, float(step_size[0]))
    ds.attrs = provenance.provenance(
        system, settings, kernel_hash(system, settings.method), title=title or f"trajectory of the {system.title}",
        scene="", seconds=0.0, points=1, warnings=system.warnings(points),
    )  # fmt: skip
    for name in ("atlas_seconds", "atlas_points_per_second"):
        del ds.attrs[name]
    return ds


def trajectory_of_scene(scene: Scene, places: Mapping[str, float], *, samples: int = 1001) -> xr.Dataset:
    """Motion of one point of a scene, with the scene's start, nudge, duration and step.

    Parameters
    ----------
    scene : Scene
    places : mapping of str to float
        A value of every axis, on the grid or off it.
    samples : int
        As for `trajectory`.

    Returns
    -------
    xarray.Dataset
        As `trajectory`.

    Raises
    ------
    BadInput
        For an axis that is missing or unknown, and where the scene's family has no motion.
    """
    for name in (*scene.axes, *places):
        if name not in places or name not in scene.axes:
            problem = "is no axis of the scene" if name in places else "has no value"
            raise BadInput(
                f"{name}: {problem}; a trajectory needs a value of every axis: {', '.join(scene.axes)}"
            )
    located = grid.points_at(scene, {name: np.array([value]) for name, value in places.items()})
    if not located.exists[0]:
        reason = grid.Reason(located.reason[0])
        raise BadInput(f"no motion: {grid.sentence(reason, scene.system, scene.family, scene.duration)}")
    point = {name: values[0] for name, values in located.points.items() if not np.isnan(values[0])}
    place = ", ".join(f"{name} = {value:g}" for name, value in places.items())
    title = f"{scene.title}: trajectory at {place}"
    return _trajectory(scene.system, point, float(located.duration[0]), samples, scene.settings, title)


def _states(
    system: System, module: Any, ensemble: Ensemble, steps_per_sample: int, step_size: Array, samples: int
) -> tuple[Array, dict[str, Array]]:
    """States at evenly spaced instants, shape (samples, states), and what was lost of first integrals until then."""
    steps, count = np.array([steps_per_sample]), len(ensemble.state)
    ensemble = replace(ensemble, state=blocks.start_state(module, ensemble.state))
    states = np.empty((samples, len(ensemble.state)))
    states[0] = ensemble.state[:, 0]
    for i in range(1, samples):
        state = numeric_bound.advanced(system, module, ensemble, steps, step_size, 1)
        ensemble = replace(ensemble, state=state)
        states[i] = state[:, 0]
    lost = getattr(module, "LOSSES", ())
    return states[:, :count], dict(zip(lost, states[:, count:].T, strict=True))


def _dataset(
    system: System, ensemble: Ensemble, states: Array, lost: Mapping[str, Array], time: Array
) -> xr.Dataset:
    """The trajectory with angles, rates and the drift of the first integrals."""
    equations, constants = system.equations, ensemble.constants
    columns = {name: states[:, i] for i, name in enumerate(equations.STATE)}
    if system.observables:
        columns |= _observables(system, states, constants)
    else:
        columns |= _angles(equations, states, constants, time)
    drift = np.zeros(len(time))
    with np.errstate(all="ignore"):
        for name, scale in zip(equations.INTEGRALS, ensemble.scales, strict=True):
            total = sum(getattr(equations, name)(states.T, constants)) + lost.get(name, 0.0)
            drift = np.maximum(drift, np.abs(total - total[0]) * scale)
    columns["integral_drift"] = drift
    attributes = _attributes_of_observables(system) if system.observables else _attributes(system)
    return xr.Dataset(
        {name: ("time", np.asarray(values), attributes[name]) for name, values in columns.items()},
        coords={"time": ("time", time, {"long_name": "time", "units": "s"})},
    )


def _attributes(system: System) -> dict[str, dict[str, str]]:
    """long_name and units of every variable over time; of a state that is no rate the units are unknown."""
    attributes = {name: {"long_name": f"state {name}"} for name in system.equations.STATE}
    for name in system.rate_states:
        attributes[name]["units"] = _RATE
    for name, axis in zip(("axis_x", "axis_y", "axis_z"), system.frame_axes, strict=True):
        attributes[name] = {"long_name": f"third axis along {axis.strip('$')}", "units": "1"}
    for name, (long_name, units) in _VARIABLES.items():
        attributes[name] = {"long_name": long_name, "units": units}
    for name in ("psi", "phi", "theta_dot", "psi_dot", "phi_dot"):
        attributes[name]["comment"] = "nan where the third axis is exactly on the vertical"
    return attributes


def _attributes_of_observables(system: System) -> dict[str, dict[str, str]]:
    """long_name and units of every variable over time of a system with observables."""
    attributes = {name: {"long_name": f"state {name}"} for name in system.equations.STATE}
    for o in system.observables:
        attributes[o.name] = {"long_name": o.long_name, "units": o.unit}
    long_name, units = _VARIABLES["integral_drift"]
    return attributes | {"integral_drift": {"long_name": long_name, "units": units}}


def _observables(system: System, states: Array, constants: Array) -> dict[str, Array]:
    """Every observable that is not a state, at every instant."""
    names = [o.name for o in system.observables if o.name not in system.equations.STATE]
    with np.errstate(all="ignore"):
        return {
            name: np.broadcast_to(getattr(system.equations, name)(states.T, constants), len(states))
            for name in names
        }


def _add_parameters(ds: xr.Dataset, system: System, points: Points, step: float) -> None:
    """Add the step and the parameters, as variables without a dimension.

    They are no coordinates, because xarray prints scalar coordinates over every plot.
    """
    ds["step"] = ((), step, {"long_name": "integration step", "units": "s"})
    for name, parameter in system.parameters.items():
        value = float(points[name][0])
        if not np.isnan(value):
            attributes = {"long_name": parameter.meaning, "units": parameter.unit}
            ds[f"{name}_start" if name in ds else name] = ((), value, attributes)


def _angles(equations: Any, states: Array, constants: Array, time: Array) -> dict[str, Array]:
    """Euler angles, their rates and the third body axis in the frame, at every instant."""
    u1, u2, u3, g1, g2, g3 = equations.frame_motion(states.T, constants)
    with np.errstate(all="ignore"):
        sine = np.hypot(g1, g2)
        psi_dot = (u1 * g1 + u2 * g2) / sine**2
        phi = np.unwrap(np.arctan2(g1, g2))
        if hasattr(equations, "axis_in_frame"):
            x, y = equations.axis_in_frame(states.T, constants)
            psi = np.unwrap(np.arctan2(x, -y))
        else:
            psi = np.r_[0.0, cumulative_simpson(psi_dot, x=time)]
            x, y = sine * np.sin(psi), -sine * np.cos(psi)
        on_vertical = sine == 0.0
        return {
            "theta": np.arctan2(sine, g3),
            "phi": np.where(on_vertical, np.nan, phi),
            "theta_dot": (u1 * g2 - u2 * g1) / sine,
            "psi_dot": psi_dot,
            "phi_dot": u3 - psi_dot * g3,
            "normal_rate": u1 * g1 + u2 * g2 + u3 * g3,
            "psi": np.where(on_vertical, np.nan, psi),
            "axis_x": x,
            "axis_y": y,
            "axis_z": g3,
        }
