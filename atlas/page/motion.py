"""What a page needs to integrate the points of an atlas: equations, start values, constants, steps."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ..analysis.metadata import axes_of, number_attribute
from ..engine import assemble
from ..engine.ensemble import Ensemble
from ..engine.losses import with_frame_vector
from ..engine.simplify import simplify
from ..engine.stepsize import StepSizes
from ..engine.tableaux import METHODS
from ..errors import BadInput, attribute_text
from ..label.trajectory import frame_vector
from ..scene import grid
from ..scene.model import DEFAULTS, Duration, Scene, Settings
from ..systems import arithmetic
from ..systems.base import Array, System

SAMPLES = 1001  # instants of a motion, as atlas.trajectory keeps by default
# Functions of the kernel, and optional ones in the caller's units that show a body.
_KERNEL = ("rhs", "scaled", "unscaled")
_OF_BODY = ("frame_motion", "axis_in_frame")


@dataclass(frozen=True)
class Motions:
    """Start values of the points of an atlas, each array of shape (..., *points)."""

    parameters: dict[str, Array]  # parameter -> value at the start, nan where it is not given
    # As in `engine.ensemble.Ensemble`; of a body whose equations have no `axis_in_frame` the state is
    # followed by the first axis of the frame
    state: Array
    # As in `engine.ensemble.Ensemble`; of a body whose equations have no `axis_in_frame` the state is
    # followed by the first axis of the frame
    constants: Array
    duration: Array  # length of the run in time units
    steps: np.ndarray  # steps from one instant of the trajectory to the next
    reason: np.ndarray  # why there is no motion, an index of `sentences`; 0 where there is one
    sentences: list[str]  # the reasons
    method: str  # a key of tableaux.METHODS


def sources(system: System, method: str) -> dict[str, str]:
    """Sources of the Python functions that integrate a point and show its motion; states as in `Motions`."""
    equations = _equations(system)
    texts = arithmetic.functions(equations)
    observables = [observable.name for observable in system.observables]
    chosen = {name: texts[name] for name in (*_KERNEL, *_OF_BODY, *observables) if name in texts}
    queue = list(chosen.values())
    while queue:
        for node in ast.walk(ast.parse(queue.pop())):
            if isinstance(node, ast.Name) and node.id in texts and node.id not in chosen:
                chosen[node.id] = texts[node.id]
                queue.append(texts[node.id])
    for name in ("rhs", "unscaled"):
        chosen[name] = simplify(chosen[name], (), {}, equations.ONES)
    lines = assemble.step_lines(METHODS[method], len(equations.STATE))
    chosen["step"] = "\n    ".join(["def step(state, slope, constants):", *lines])
    return chosen


def _equations(system: System) -> Any:
    """The equations with what shows a body in its frame."""
    return system.equations if system.observables else with_frame_vector(system.equations)


def motions(ds: xr.Dataset, system: System, scene: Scene | None, dims: list[str]) -> Motions:
    """Starts of all points, as `ds.atlas.trajectory` integrates them; BadInput where a value is missing."""
    shape = tuple(ds.sizes[dim] for dim in dims)
    if scene is None:
        parameters, duration, settings = _single_points(ds, system, dims)
        reason, family, unit = grid.reasons(system, parameters), None, Duration()
    else:
        located = _points_of_scene(ds, scene, dims)
        parameters, duration, settings = located.points, located.duration, scene.settings
        reason = located.reason
        family, unit = scene.family, scene.duration
    sentences = [grid.sentence(each, system, family, unit) if each else "" for each in grid.Reason]
    ensemble = Ensemble.of(system, parameters)
    state = ensemble.state
    if _equations(system) is not system.equations:
        state = np.concatenate([state, frame_vector(system, parameters, state, ensemble.constants)])
    with np.errstate(all="ignore"):
        sizes = StepSizes.of(
            settings, ensemble.frequency_bound, np.where(np.isfinite(duration), duration, 0.0)
        )
    count = _recorded_steps(ds, dims, duration, sizes.steps) if system.has_numeric_bound else sizes.steps
    # As label.trajectory: whole steps between the instants, never longer than in the atlas.
    steps = -(-count // (SAMPLES - 1))

    def over_points(values: np.ndarray) -> np.ndarray:
        """An array with the points along its last axis, over their dimensions."""
        return values.reshape(*values.shape[:-1], *shape)

    return Motions(
        {name: over_points(values) for name, values in parameters.items()},
        over_points(state), over_points(ensemble.constants), over_points(duration), over_points(steps),
        over_points(reason), sentences, settings.method,
    )  # fmt: skip


def _recorded_steps(ds: xr.Dataset, dims: list[str], duration: Array, default: np.ndarray) -> np.ndarray:
    """Numbers of steps in the atlas, which follow from a frequency bound along each motion, or `default`."""
    if "step" not in ds:
        raise BadInput(
            "step: not in this dataset; the frequency bound of this system is numeric, and its steps are those recorded"
        )
    step = _over_points(ds, "step", dims)
    with np.errstate(all="ignore"):
        recorded = np.rint(duration / step)
    return np.where(np.isfinite(recorded) & (recorded >= 1), recorded, default).astype(np.int64)


def _points_of_scene(ds: xr.Dataset, scene: Scene, dims: list[str]) -> grid.Grid:
    """The points of a scene at the coordinates of an atlas, in C order of its dimensions."""
    coordinates = {}
    for dim, axis in axes_of(scene).items():
        if dim not in ds.coords or not set(ds[dim].dims) <= set(dims):
            raise BadInput(f"{dim}: this axis of the scene is not in the dataset")
        coordinates[axis.name] = _over_points(ds, dim, dims)
    return grid.points_at(scene, coordinates)


def _over_points(ds: xr.Dataset, name: str, dims: list[str]) -> Array:
    """Values of a variable at every point, in C order of the dimensions of the points."""
    array = ds[name]
    whole = array.expand_dims({dim: ds.sizes[dim] for dim in dims if dim not in array.dims})
    return np.asarray(whole.transpose(*dims).values, np.float64).ravel()


def _single_points(
    ds: xr.Dataset, system: System, dims: list[str]
) -> tuple[Mapping[str, Array], Array, Settings]:
    """Parameters, durations and settings of points that come from no scene; see analysis.rerun."""
    if "end_time" not in ds:
        raise BadInput("end_time: not in this dataset; a trajectory needs it to end where the point did")
    parameters = {}
    for name, parameter in system.parameters.items():
        if name in ds.coords:
            parameters[name] = _over_points(ds, name, dims)
        elif math.isnan(parameter.default):
            parameters[name] = np.full(math.prod(ds.sizes[dim] for dim in dims), math.nan)
        else:
            raise BadInput(f"{name}: this parameter of the points is not in the dataset")
    step = number_attribute(ds, "atlas_step")
    settings = Settings(
        method=attribute_text(ds.attrs, "atlas_method"),
        step=step if math.isfinite(step) else None,
        tolerance=DEFAULTS.tolerance if math.isfinite(step) else number_attribute(ds, "atlas_tolerance"),
        rate_tolerance=number_attribute(ds, "atlas_rate_tolerance"),
    )
    return parameters, _over_points(ds, "end_time", dims), settings
