"""One point followed in time, by the kernel and the steps that label it in an atlas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from scipy.integrate import cumulative_simpson

from .. import systems
from ..engine import blocks, measure, stepsize
from ..engine.tableaux import METHODS
from ..errors import BadInput
from ..scene import grid
from ..scene.model import Scene, Settings
from ..scene.tables import point_columns
from .pipeline import kernel


def trajectory(
    system: str,
    point: Mapping[str, Any],
    *,
    duration: float = 60.0,
    samples: int = 1001,
    step: float | None = None,
    method: str = "rk4",
    tolerance: float = 1e-8,
    rate_tolerance: float = 1e-5,
) -> xr.Dataset:
    """Motion of one point: a Dataset over the dimension "time".

    point: parameter -> number; step, method, tolerance, rate_tolerance (rad per time unit): as for
    label_points, and the steps are never longer than there. samples: instants from 0 to duration, evenly
    spaced; at least 2. Variables, float64: the state by the names of the equations, theta, psi, phi
    (rad, psi and phi unwrapped; nan on the vertical, where they do not exist), theta_dot, psi_dot,
    phi_dot, normal_rate (rad per time unit), axis_x, axis_y, axis_z (the third body axis in the frame:
    for the satellite along radius, velocity, normal), integral_drift. Raises BadInput as label_points.
    """
    kind = systems.get(system)
    settings = Settings(method=method, step=step, tolerance=tolerance, rate_tolerance=rate_tolerance)
    if not isinstance(samples, int) or samples < 2:
        raise BadInput(f"samples = {samples!r}: must be a whole number, at least 2")
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration = {duration!r}: must be a finite number above 0")
    points, size = point_columns(kind, point)
    if size != 1:
        raise BadInput(f"point: {size} points given; a trajectory follows one")
    state, constants = (
        np.ascontiguousarray(kind.initial_state(points)),
        np.ascontiguousarray(kind.constants(points)),
    )
    plan = stepsize.choose(
        METHODS[method], kind.frequency_bound(points), np.array([duration]),
        tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
        rate_tolerance=settings.rate_tolerance,
    )  # fmt: skip
    # Whole steps between samples, never longer than the atlas' own.
    each = -(-int(plan.count[0]) // (samples - 1))
    length = np.array([duration / (each * (samples - 1))])
    schedule = blocks.pack_blocks(np.array([each]), np.array([each]))
    scales = measure.scales(kind.equations, state, constants, dict(kind.integral_scales(points)))
    states = np.empty((samples, len(state)))
    states[0] = state[:, 0]
    for i in range(1, samples):
        blocks.integrate(kernel(kind, method), schedule, length, state, constants, scales, 0.0, threads=1)
        states[i] = state[:, 0]
    return _dataset(kind, states, constants, scales, np.linspace(0.0, duration, samples))


def trajectory_of_scene(scene: Scene, places: Mapping[str, float], *, samples: int = 1001) -> xr.Dataset:
    """Motion of one point of a scene, at any values of its axes: started, nudged and stepped as the scene says.

    places: name of every axis -> value. Raises BadInput for an axis that is missing or unknown, and where
    the scene's family has no motion. Otherwise as `trajectory`.
    """
    for name in (*scene.axes, *places):
        if name not in places or name not in scene.axes:
            what = "is no axis of the scene" if name in places else "has no value"
            raise BadInput(
                f"{name}: {what}; a trajectory needs a value of every axis: {', '.join(scene.axes)}"
            )
    found = grid.points_at(scene, {name: np.array([value]) for name, value in places.items()})
    if not found.there[0]:
        raise BadInput(f"the family {scene.family} has no motion at this point")
    point = {name: values[0] for name, values in found.points.items() if not np.isnan(values[0])}
    return trajectory(
        scene.system.name, point, duration=float(found.duration[0]), samples=samples,
        step=scene.settings.step, method=scene.settings.method, tolerance=scene.settings.tolerance,
        rate_tolerance=scene.settings.rate_tolerance,
    )  # fmt: skip


def _dataset(kind: systems.System, states, constants, scales, time) -> xr.Dataset:
    columns = {name: states[:, i] for i, name in enumerate(kind.equations.STATE)}
    motion = kind.equations.frame_motion(states.T, constants)
    u1, u2, u3, g1, g2, g3 = motion
    with np.errstate(all="ignore"):
        sine = np.hypot(g1, g2)
        psi_dot = (u1 * g1 + u2 * g2) / sine**2
        columns |= {
            "theta": np.arctan2(sine, g3),
            "phi": np.unwrap(np.arctan2(g1, g2)),
            "theta_dot": (u1 * g2 - u2 * g1) / sine,
            "psi_dot": psi_dot,
            "phi_dot": u3 - psi_dot * g3,
            "normal_rate": u1 * g1 + u2 * g2 + u3 * g3,
        }
        if hasattr(kind.equations, "axis_in_frame"):
            x, y = kind.equations.axis_in_frame(states.T, constants)
            psi = np.unwrap(np.arctan2(x, -y))
        else:
            psi = np.r_[0.0, cumulative_simpson(psi_dot, x=time)]
            x, y = sine * np.sin(psi), -sine * np.cos(psi)
    on_vertical = sine == 0.0
    for name, values in (("psi", psi), ("phi", columns["phi"])):
        columns[name] = np.where(on_vertical, np.nan, values)
    columns |= {"axis_x": x, "axis_y": y, "axis_z": g3}
    drift = np.zeros(len(time))
    for name, scale in zip(kind.equations.INTEGRALS, scales, strict=True):
        total = sum(getattr(kind.equations, name)(states.T, constants))
        drift = np.maximum(drift, np.abs(total - total[0]) * scale)
    columns["integral_drift"] = drift
    return xr.Dataset(
        {name: ("time", np.asarray(values)) for name, values in columns.items()},
        coords={"time": ("time", time, {"long_name": "time", "units": "s"})},
        attrs={"atlas_system": kind.name},
    )
