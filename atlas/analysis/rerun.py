"""Points of an atlas integrated again."""

from __future__ import annotations

import math
from collections.abc import Mapping

import xarray as xr

from ..errors import BadInput, attribute_text
from ..label.trajectory import trajectory, trajectory_of_scene
from .metadata import axes_of, number_attribute, scene_of, system_of
from .select import nearest


def nearest_trajectory(ds: xr.Dataset, coordinates: Mapping[str, float], samples: int) -> xr.Dataset:
    """Motion of the point of an atlas nearest to some values, integrated as the atlas was.

    See `Atlas.trajectory`.
    """
    system, scene = system_of(ds), scene_of(ds)
    point = nearest(ds, coordinates).squeeze()
    if scene is not None:
        for dim in axes_of(scene):
            if dim not in point.coords:
                raise BadInput(
                    f"{dim}: this axis of the scene is not in the dataset: it was renamed, dropped or averaged over"
                )
        values = {
            axis.name: float(point[dim])
            for dim, axis in axes_of(scene).items()
            if dim in point.coords and point[dim].ndim == 0
        }
        return trajectory_of_scene(scene, values, samples=samples)
    if point.dims:
        raise BadInput("trajectory: these are several points; name the point by values of its parameters")
    if "end_time" not in point:
        raise BadInput("end_time: not in this dataset; a trajectory needs it to end where the point did")
    for name, parameter in system.parameters.items():
        if name not in point.coords and not math.isnan(parameter.default):
            raise BadInput(f"{name}: this parameter of the point is not in the dataset")
    start = {name: float(point[name]) for name in system.parameters if name in point.coords}
    step = number_attribute(ds, "atlas_step")
    return trajectory(
        system.name,
        {name: value for name, value in start.items() if not math.isnan(value)},
        duration=float(point["end_time"]),
        samples=samples,
        method=attribute_text(ds.attrs, "atlas_method"),
        rate_tolerance=number_attribute(ds, "atlas_rate_tolerance"),
        **({"step": step} if math.isfinite(step) else {"tolerance": number_attribute(ds, "atlas_tolerance")}),
    )
