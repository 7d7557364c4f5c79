"""The variable, the question and the line of the extension; imported when one of them is asked for."""

from __future__ import annotations

import contourpy
import numpy as np
import xarray as xr

from atlas.analysis.plane import Plane
from atlas.errors import BadInput
from atlas.systems.base import Array, DerivedVariable, Points, System

NAME, LEVEL = "start_energy", 1.0


def energy(system: System, points: Points) -> Array:
    """Kinetic energy in space of a rigid body, J, (points,)."""
    state = dict(zip(system.equations.STATE, system.initial_state(points), strict=True))
    moments = [points[name] for name in system.moments_of_inertia]
    return 0.5 * sum(
        moment * state[rate] ** 2 for moment, rate in zip(moments, system.rate_states, strict=True)
    )


def variables(system: System) -> dict[str, DerivedVariable]:
    """The variable, of systems that are rigid bodies."""
    if system.moments_of_inertia is None:
        return {}
    text = "kinetic energy in space at the start"
    return {NAME: DerivedVariable(NAME, "J", text, lambda points, duration, pause: energy(system, points))}


def energy_range(ds: xr.Dataset) -> tuple[float, float]:
    """Least and largest energy at the start of an atlas that holds `start_energy`."""
    if NAME not in ds:
        raise BadInput(f"{NAME}: not in this dataset; list it in outputs.variables")
    return float(ds[NAME].min()), float(ds[NAME].max())


def lines(plane: Plane, ds: xr.Dataset) -> dict[str, list[np.ndarray]]:
    """The line on which the energy is LEVEL, in the units of the two axes."""
    if len(plane.extent) != 2:
        return {}
    steps = np.linspace(0.0, 1.0, 200)
    positions = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    points = plane.points(plane.coordinates(positions)).base
    values = energy(plane.scene.system, points).reshape(steps.size, steps.size)
    polylines = contourpy.contour_generator(steps, steps, values.T).lines(LEVEL)
    return {
        f"energy = {LEVEL:g}": [np.stack(list(plane.coordinates(line).values()), -1) for line in polylines]
    }
