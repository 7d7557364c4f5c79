"""Borders on a plane of an atlas as datasets. Theory predicts some borders; others surround measured regions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from typing import NamedTuple

import contourpy
import numpy as np
import xarray as xr

from .. import extension
from ..errors import BadInput, attribute_text
from ..flags import Label, Stability
from ..scene.model import Scene
from ..systems.base import Array, Mask, derived_variables
from ..systems.gyrostat.system import FREQUENCIES
from ..variables import variables
from .degrees import in_degrees
from .exact_curves import family_curves
from .metadata import axes_of, common_values, flag_values, is_logarithmic, resolved_scene, scene_of, system_of
from .plane import IN_SPACE, Plane, Predictions
from .select import plane_of
from .tracer import (
    Classes,
    Lines,
    cached_lines,
    class_borders,
    contours,
    crossings,
    on_axes,
    values_at,
    within,
)


def boundary(
    ds: xr.Dataset,
    label: str | int | None,
    variable: str,
    x: str | None,
    y: str | None,
    select: Mapping[str, float],
    degrees: bool = False,
) -> xr.Dataset:
    """Return the lines that theory predicts or, if a label is given, the border of the region with this flag; see `Atlas.boundary`."""
    system_of(ds)
    plane, dims, panel_dims = plane_of(ds, x, y, select, degrees=degrees)
    if panel_dims or (label is not None and len(dims) != 2):
        raise BadInput(
            f"boundary: needs two axes, found {', '.join(map(str, plane.dims))}; use select for the others"
        )
    scene = scene_of(ds) if label is not None else resolved_scene(ds, plane)
    log = np.array([is_logarithmic(scene, dim, plane[dim].values) for dim in dims])
    columns = [
        np.log(plane[d].values) if is_log else plane[d].values for d, is_log in zip(dims, log, strict=True)
    ]
    if label is None:
        if scene is None:
            raise BadInput(
                "boundary: these points come from no scene, so that theory has no plane; name a label for the border"
                " of its region"
            )
        low, high = (np.array([extreme(column) for column in columns]) for extreme in (np.min, np.max))
        theory = theory_lines(scene, plane, dims, variable)
        if variable not in extension.parts("lines"):
            exact = family_curves(Plane.of(scene, plane, dims))
            theory |= {f"{name.replace('_', ' ')} (exact)": curves for name, curves in exact.items()}
        lines = {
            kind: [
                part for line in group for part in within(np.log(line, out=line.copy(), where=log), low, high)
            ]
            for kind, group in theory.items()
        }
    else:
        (flag,) = flag_values(ds, variable, label)
        inside = (plane[variable].transpose(dims[1], dims[0]) == flag).values.astype(float)
        generator = contourpy.contour_generator(columns[0], columns[1], inside, line_type="Separate")
        lines = {f"{variable} = {label}": [np.asarray(line) for line in generator.lines(0.5)]}
    numbered = [(kind, line) for kind, group in lines.items() for line in group]
    vertices = np.concatenate([np.zeros((0, len(dims))), *(line for _, line in numbered)])
    vertices[:, log] = np.exp(vertices[:, log])
    lengths = [len(line) for _, line in numbered]
    numbers = np.repeat(np.arange(len(numbered)), lengths)
    kinds = np.repeat(np.array([kind for kind, _ in numbered], str), lengths)
    result = xr.Dataset(
        {
            **{dim: ("vertex", vertices[:, i], plane[dim].attrs) for i, dim in enumerate(dims)},
            "line": ("vertex", numbers, {"long_name": "number of the line to which the vertex belongs"}),
            "kind": ("vertex", kinds, {"long_name": "what changes at the line"}),
        },
        attrs={"title": f"borders in {attribute_text(plane.attrs, 'title', 'an atlas')!r}"}
        | ({} if scene is None else common_values(plane, scene)),
    )
    return in_degrees(result, degrees)


def theory_lines(scene: Scene, plane: xr.Dataset, dims: list[str], variable: str) -> Lines:
    """Return the lines, by kind, that theory predicts on a plane of an atlas. Raise BadInput if `dims` are not axes of the scene."""
    for dim in dims:
        if dim not in axes_of(scene):
            raise BadInput(f"{dim}: not an axis of the atlas' scene; its axes: {', '.join(axes_of(scene))}")
        if any(axes_of(scene)[dim].name in getattr(tie, "drawn", ()) for tie in scene.ties.values()):
            raise BadInput(f"{dim}: its values number random draws, between which theory has no lines")
    whole = Plane.of(scene, plane, dims)
    if variable in extension.parts("lines") and variable in variables(scene.system):
        lines: Lines = extension.load("lines", variable)(whole, plane)
        return lines
    if variable in RESONANCE_VARIABLES and variable in derived_variables(scene.system) and len(dims) == 2:
        return borders(whole, variable) | cached_lines(lambda: resonances(whole), whole, "resonances")
    return borders(whole, variable)


def borders(plane: Plane, variable: str = "label") -> Lines:
    """Return the lines of theory on a plane, by the names in KINDS. Lines that depend on the frame are those in the frame of `variable`."""
    lines = cached_lines(lambda: theory_borders(plane), plane)
    frame = IN_SPACE if variable.endswith("_inertial") else ""
    names = {name: name + frame * kind.of_frame for name, kind in KINDS.items()}
    return {name: lines[in_frame] for name, in_frame in names.items() if in_frame in lines}


class Kind(NamedTuple):
    """A kind of border."""

    # The function takes predictions, a frame and whether motions are nudged, and returns the class of each point. Lines separate
    # points of class 1 from points of class 2, and stop at points of class 0.
    classes: Callable[[Predictions, str, bool], np.ndarray]
    of_frame: bool = True  # whether the line depends on the frame
    rate: str = ""  # the rate that is 0 on the line, "n" or "m"


def _labels(theory: Predictions, frame: str, nudged: bool) -> np.ndarray:
    sides = Label.REGULAR_PRECESSION, Label.PERMANENT_ROTATION
    return np.select([theory.exists & (theory.frames[frame][0] == side) for side in sides], [1, 2], 0)


def _signs(rate: str, theory: Predictions, frame: str, nudged: bool) -> np.ndarray:
    """Return 1 for regular precessions with a negative `rate`, 2 for other regular precessions, else 0. Nudged unstable motions have 0."""
    regular = (_labels(theory, frame, nudged) == 1) & ~(nudged & (theory.stable == Stability.UNSTABLE))
    return np.where(regular, np.where(theory.frames[frame][1][rate] < 0, 1, 2), 0)


STABILITY = "stability limit"
LABEL = "precession limit"
EXISTENCE = "edge of existence"
ZERO_RATES = {"n": "permanent rotation: psi' = 0", "m": "permanent rotation: phi' = 0"}
KINDS: Mapping[str, Kind] = {
    STABILITY: Kind(lambda theory, *_: np.where(theory.exists, theory.stable, 0), of_frame=False),
    LABEL: Kind(_labels),
    EXISTENCE: Kind(lambda theory, *_: np.where(theory.exists, 1, 2), of_frame=False),
    **{kind: Kind(partial(_signs, rate), rate=rate) for rate, kind in ZERO_RATES.items()},
}


def theory_borders(plane: Plane) -> Lines:
    """Return lines, by kind, at which a prediction of theory changes on a plane. Lines are polylines in the units of the axes.

    Lines separate linearly stable from unstable motions, regular precessions from permanent rotations, and points with a motion
    from points without a motion. A line on which psi' or phi' is 0 lies between regular precessions, and motions on the line are
    permanent rotations. Kinds that depend on the frame have a second entry, with IN_SPACE after the name, for inertial space.
    """
    frames, nudged = ("", IN_SPACE), bool(plane.scene.nudge)
    kinds = {
        name + frame: (kind, frame)
        for name, kind in KINDS.items()
        for frame in frames[: 1 + kind.of_frame]
        if kind.rate not in plane.extent  # if a rate is an axis, the line on which the rate is 0 is trivial
    }

    def classes(positions: Array) -> Classes:
        theory = plane.theory(plane.coordinates(positions))
        present = {name: each for name, each in kinds.items() if each[1] in theory.frames}
        return {
            name: kind.classes(theory, frame, nudged).astype(np.int8)
            for name, (kind, frame) in present.items()
        }

    def magnitude(rate: str, frame: str, positions: Array) -> Array:
        return np.abs(plane.theory(plane.coordinates(positions)).frames[frame][1][rate])

    zeros = {name: partial(magnitude, kind.rate, frame) for name, (kind, frame) in kinds.items() if kind.rate}
    return class_borders(plane, classes, zeros)


RESONANCE_RATIOS = (1, 2, 3)
RESONANCES = tuple(f"resonance {ratio}:1" for ratio in RESONANCE_RATIOS)
RESONANCE_VARIABLES = (*FREQUENCIES, "stability_kind")
RESONANCE_SAMPLES = 200  # number of samples along each axis


def resonances(plane: Plane) -> Lines:
    """Return the parts of the lines of RESONANCES on which motions exist and are not unstable."""
    axes, coordinates = plane.lattice(RESONANCE_SAMPLES)
    return resonance_lines(plane, axes, coordinates, not_unstable(plane, coordinates))


def not_unstable(plane: Plane, coordinates: Mapping[str, Array]) -> Mask:
    """Whether each point has a motion that is not unstable."""
    theory = plane.theory(coordinates)
    return theory.exists & (theory.stable != Stability.UNSTABLE)


def resonance_lines(plane: Plane, axes: list[Array], coordinates: Mapping[str, Array], shown: Mask) -> Lines:
    """Return lines, by the names in RESONANCES, on which two frequencies have the ratio 1, 2 or 3.

    Lines are drawn only through points of the lattice in the mask `shown`. A resonance 1:1 at which stability ends is left out,
    because it is a stability limit.
    """
    columns = plane.derived(coordinates, FREQUENCIES)
    frequencies = [on_axes(columns[name], shown, axes) for name in FREQUENCIES]
    result = {}
    for ratio, kind in zip(RESONANCE_RATIOS, RESONANCES, strict=True):
        differences = [large - ratio * small for large, small in combinations(frequencies, 2)]
        traced = [crossings(each) if ratio == 1 else contours(each, 0.0) for each in differences]
        if lines := [values_at(line, axes) for each in traced for line in each]:
            result[kind] = lines
    return result
