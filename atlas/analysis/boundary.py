"""Borders on a plane of an atlas as data: those of theory, and those of a measured region."""

from __future__ import annotations

from collections.abc import Mapping

import contourpy
import numpy as np
import xarray as xr

from ..errors import BadInput, attribute_text
from ..scene.model import Scene
from . import resonances
from .count_borders import count_borders
from .metadata import axes_of, flag_values, is_logarithmic, scene_of, system_of
from .plane import Plane
from .select import plane_of
from .theory_borders import theory_borders

Lines = dict[str, list[np.ndarray]]


def boundary(
    ds: xr.Dataset,
    label: str | int | None,
    variable: str,
    x: str | None,
    y: str | None,
    select: Mapping[str, float],
) -> xr.Dataset:
    """Borders of theory, or of the region where a variable has one flag; see `Atlas.boundary`."""
    system_of(ds)
    plane, dims, panel_dim = plane_of(ds, x, y, select)
    if panel_dim is not None or (label is not None and len(dims) != 2):
        raise BadInput(
            f"boundary: needs two axes, found {', '.join(map(str, plane.dims))}; use select for the others"
        )
    scene = scene_of(ds)
    if label is None:
        if scene is None:
            raise BadInput(
                "boundary: these points come from no scene, so that theory has no plane; name a label for the border"
                " of its region"
            )
        return _dataset(theory_lines(scene, plane, dims, variable), plane, dims)
    (flag,) = flag_values(ds, variable, label)
    inside = (plane[variable].transpose(dims[1], dims[0]) == flag).values.astype(float)
    log = np.array([is_logarithmic(scene, dim, plane[dim].values) for dim in dims])
    along, across = (
        np.log(plane[dim].values) if is_log else plane[dim].values
        for dim, is_log in zip(dims, log, strict=True)
    )
    generator = contourpy.contour_generator(along, across, inside, line_type="Separate")
    lines = [np.asarray(line) for line in generator.lines(0.5)]
    for line in lines:
        line[:, log] = np.exp(line[:, log])
    return _dataset({f"{variable} = {label}": lines}, plane, dims)


def theory_lines(scene: Scene, plane: xr.Dataset, dims: list[str], variable: str) -> Lines:
    """Borders of theory on a plane of an atlas: kind -> polylines, see `theory_borders`, `count_borders`, `resonances`.

    Raises BadInput where the dimensions are not those of the scene.
    """
    for dim in dims:
        if dim not in axes_of(scene):
            raise BadInput(f"{dim}: not an axis of the atlas' scene; its axes: {', '.join(axes_of(scene))}")
    derived = scene.system.derived.get(variable)
    if derived is not None and derived.is_count and variable in plane:
        return count_borders(Plane.of(scene, plane, dims), plane[variable], derived)
    whole = Plane.of(scene, plane, dims)
    borders = theory_borders(whole, inertial=variable.endswith("_inertial"))
    if variable in resonances.VARIABLES and variable in scene.system.derived and len(dims) == 2:
        borders |= resonances.resonance_lines(whole)
    return borders


def _dataset(lines: Lines, plane: xr.Dataset, dims: list[str]) -> xr.Dataset:
    """Lines as a dataset over their vertices."""
    numbered = [(kind, line) for kind, group in lines.items() for line in group]
    vertices = np.concatenate([line for _, line in numbered]) if numbered else np.zeros((0, len(dims)))
    lengths = [len(line) for _, line in numbered]
    columns = {dim: ("vertex", vertices[:, i], plane[dim].attrs) for i, dim in enumerate(dims)}
    return xr.Dataset(
        {
            **columns,
            "line": (
                "vertex",
                np.repeat(np.arange(len(numbered)), lengths),
                {"long_name": "number of the line to which the vertex belongs"},
            ),
            "kind": (
                "vertex",
                np.repeat(np.array([kind for kind, _ in numbered], str), lengths),
                {"long_name": "what changes at the line"},
            ),
        },
        attrs={"title": f"borders in {attribute_text(plane.attrs, 'title', 'an atlas')!r}"},
    )
