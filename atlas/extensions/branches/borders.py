"""Borders over two parameters at which relative equilibria merge or change stability, as datasets of vertices and special points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from ...analysis.metadata import is_logarithmic, resolved_scene
from ...analysis.plane import Plane
from ...analysis.select import plane_of
from ...analysis.tracer import shown_parts
from ...errors import BadInput
from ...flags import Flag
from ...measure.instrument import Variable
from ...scene.checks import typed
from ...scene.model import Duration, Scene
from ...systems.base import Array, Mask, Points, check_possible, possible_body
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.body import length
from ..equilibria.algebra import attitudes, frames_of
from ..equilibria.dataset import attributes
from .branches import empty_dataset, scene_of
from .continuation import Curve, Segments, lengths, with_zeros, without_repeats
from .singular import BorderKind, Degenerate, Potential
from .starts import Cell, all_curves, cells_of, sides

_MEETS_AT_0 = 1e-6  # squared exponents at an end of a limit of stability count as 0 below this
# At a cusp the derivatives of the parameters by arc length are below this. At a fold on a circle of equilibria the derivatives are larger.
_TURNS = 1e-6


class SpecialKind(Flag):
    """Kinds of special points of borders. The value 0 does not occur."""

    NONE = 0, "no special point"
    CUSP = 1, "two folds, or two limits of stability, meet and end: the parameters turn back"
    MEETING = 2, "a pitchfork meets a fold, or another pitchfork"
    ZERO_AND_PAIR = 3, "a limit of stability ends: the two pairs of exponents, or the third, become 0"


_OWN = Variable.table(
    Variable("curve", "int16", "1", "number of the curve to which the vertex belongs"),
    Variable("kind", "int8", "1", "kind of border", BorderKind.meanings()),
    Variable(
        "arc", "float64", "1", "length of the curve in attitude and parameters, these over their ranges"
    ),
    Variable("index_below", "int8", "1", "Morse index of the solutions on one side of the border"),
    Variable(
        "index_above", "int8", "1", "Morse index on the other side, larger by 1 but at limits of stability"
    ),
    Variable(
        "count_change", "int8", "1", "number of solutions to the left of the curve less that to the right"
    ),
    Variable(
        "stable_change",
        "int8",
        "1",
        "number of linearly stable solutions to the left of the curve less that to the right",
    ),
    Variable("residual", "float64", "1", "largest residual of the equations, over the size of the potential"),
    Variable("condition", "float64", "1", "condition number of the equations with the tangent"),
    Variable("special_curve", "int16", "1", "curve on which the special point lies"),
    Variable("special_kind", "int8", "1", "kind of special point", SpecialKind.meanings()),
    Variable("cells", "int8", "1", "whether the curves explain the numbers of equilibria", Cell.meanings()),
)


class Borders(NamedTuple):
    """All borders on a plane of parameters. Positions on the plane are fractions of its sides."""

    plane: Plane
    potential: Potential
    lines: list[Curve]
    # Each side of a curve has a Morse index. This is the lower index of the two, on the segment after each vertex, (vertices,).
    morse_index: NDArray[np.int64]
    changes: Array  # numbers of solutions and of stable solutions left of the curve, minus those on the right, (2, vertices)
    axis: Array  # positions along each side of the grid on which equilibria are counted
    cells: NDArray[np.int8]

    @classmethod
    def of(cls, plane: Plane, stability: bool = False) -> Borders:
        """Return the borders on a plane, with limits of stability if `stability`. Raise BadInput if borders cannot be computed."""
        system = plane.scene.system
        if not isinstance(system, Gyrostat):
            raise BadInput(f"borders: of the {system.name} no relative equilibria are known")

        def points(positions: Array) -> Points:
            return plane.points(plane.coordinates(positions)).base

        check_possible(system, points(np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 9)]), -1).reshape(-1, 2)))
        corners = points(np.array([[0.0, 0.0], [0.5, 0.5], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]))
        if corners["damping"].any():
            raise BadInput(
                f"borders: damping = {corners['damping'].max():g}; the body has to be without damping"
            )
        potential = Potential.of(system, points)
        for name, changes in zip(plane.extent, np.split(potential.terms, 3, -1)[1:], strict=True):
            if not changes.any():
                raise BadInput(f"borders: {name} changes no equilibria; take a parameter of body or field")
        lines, axis, cells = all_curves(system, potential, points, stability)

        def shown(at: Degenerate) -> Mask:
            """Whether points have a possible body and, at limits of stability, only imaginary exponents."""
            return np.asarray(possible_body(system, points(at.parts[4])) & (at.largest_square() < 0))

        lines = without_repeats(_possible(lines, shown)) if lines else []
        kept = [line.sound() for line in lines]
        for line, own in zip(lines, kept, strict=True):
            gaps = np.flatnonzero(~own)
            beside = np.clip(gaps[:, None] + [-1, 0, 1], 0, len(line.tangents) - 1).ravel()
            where = cells_of(line.points.parts[4][beside], axis)
            cells[where] = np.where(cells[where] == Cell.COUNTED, Cell.UNEXPLAINED, cells[where])
        lines = [part for line, own in zip(lines, kept, strict=True) for part in line.runs(own)]
        index, changes = sides(Segments.of(lines)) if lines else (np.zeros(0, int), np.zeros((2, 0)))
        ends = np.cumsum([len(line.tangents) - 1 for line in lines], dtype=int)
        index = np.insert(index, ends, index[ends - 1])
        changes = np.insert(changes, ends, changes[:, ends - 1], 1)
        return cls(plane, potential, lines, index, changes, axis, cells)

    def values(self, positions: Array) -> Array:
        """Return the values of the parameters, (N, 2), at positions."""
        return np.stack(list(self.plane.coordinates(positions).values()), -1)

    def slopes(self, positions: Array, rates: Array) -> Array:
        """Return the derivatives of the parameters by arc length, (N, 2). `rates` are the derivatives of the positions by arc length."""
        values = self.values(positions)
        for i, (dim, (low, high)) in enumerate(self.plane.extent.items()):
            is_log = is_logarithmic(self.plane.scene, dim, (low, high))
            values[:, i] = rates[:, i] * (values[:, i] * np.log(high / low) if is_log else high - low)
        return values

    def polylines(self, divisions: int, chosen: Mask) -> list[Array]:
        """Return polylines from each chosen vertex to the next vertex, in axis units. Each cubic becomes `divisions` straight parts."""
        lines, ends = [], np.cumsum([len(line.tangents) for line in self.lines], dtype=int)
        for line, own in zip(self.lines, np.split(chosen, ends), strict=False):
            parts = Segments.of([line])
            at = [parts.cubic(np.full(parts.curve.size, i / divisions)).parts[4] for i in range(divisions)]
            positions = np.concatenate([np.stack(at, 1).reshape(-1, 2), line.points.parts[4][-1:]])
            shown = np.repeat(own, divisions)[: len(positions)]
            shown[1:] |= shown[:-1]
            lines += [part for part in shown_parts(self.values(positions), shown) if len(part) > 1]
        return lines


def _possible(lines: Sequence[Curve], possible: Callable[[Degenerate], Mask]) -> list[Curve]:
    """Return the parts of curves on which bodies are possible, cut at the limits of possible bodies."""
    inside = [possible(line.points) for line in lines]
    changes = [np.r_[each[1:] != each[:-1], False] for each in inside]
    parts = Segments.of(lines, changes)
    first = np.concatenate([each[where] for each, where in zip(inside, changes, strict=True)])
    low, high = np.zeros(first.size), np.ones(first.size)
    for _ in range(50 if first.size else 0):
        middle = 0.5 * (low + high)
        same = possible(parts.at(middle)[0]) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    lines = parts.inserted(lines, np.where(first, low, high))
    kept = [np.insert(each, parts.vertex[parts.curve == i] + 1, True) for i, each in enumerate(inside)]
    return [part for line, own in zip(lines, kept, strict=True) for part in line.runs(own)]


@typed
def borders(
    system: str,
    body: Mapping[str, float],
    ranges: Mapping[str, Sequence[float]],
    *,
    ties: Mapping[str, str] | None = None,
    stability: bool = False,
) -> xr.Dataset:
    """Borders between regions of different relative equilibria, or permanent rotations, over two parameters, as curves.

    At a border equilibria merge or change their stability by the energy. Borders are continued by arc length in attitude and
    both parameters, so that cusps are regular points.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float
        Parameter -> number; omitted parameters take their defaults. Of the start values only n of the fixed_point, the rate of
        rotation, has an effect.
    ranges : mapping of str to sequence of float
        Lowest and highest value of two parameters, or of two other names that `ties` refer to.
    ties : mapping of str to str, optional
        Parameter -> arithmetic in the other names, such as ``{"B": "1 + 0.5 * A"}``, as in a scene.
    stability : bool, optional
        Also follow limits of linear stability, which takes up to ten times as long. At a limit two pairs of imaginary exponents
        meet and leave the axis. For permanent rotations and bodies with an axis of symmetry, one pair vanishes.

    Returns
    -------
    Dataset
        The dimension "vertex" lists the vertices curve by curve. Variables are both parameters; curve; kind (flags); arc, the
        length of the curve; ``tangent_<parameter>``, derivatives by arc; theta0, psi0, phi0, alpha and gamma of the solution;
        index_below and index_above, the Morse indices on both sides (0 for a minimum); count_change and stable_change, the
        numbers of all and of stable solutions to the left of the curve minus those to the right; residual and condition of the
        equations. Indices and changes hold from the vertex to the next one. Lengths are measured in attitude (rad), parameters
        (in units of their ranges) and, on limits of stability, the squared double exponent (in units of a squared rate). The
        dimension "special" has parameters and angles of cusps and meetings as ``special_<name>``, special_curve and special_kind
        (flags). cells (flags), over a coarse grid with the middles ``cell_<parameter>``, states where the curves explain the
        numbers of equilibria.

    Raises
    ------
    BadInput
        For names, values and ties that a scene does not allow, for empty ranges, for a parameter that changes no equilibria, for
        damping, and where no body is possible.

    Notes
    -----
    Between two vertices a curve is the cubic whose derivatives at both vertices are the tangents times the difference of arc. If
    nothing acts along alpha, equilibria with alpha and -alpha share one curve; other symmetries repeat curves. A closed curve of a
    satellite may be missed inside a cell that counts as explained. Where two curves are less than 1e-6 of the ranges
    apart, or 1e-5 beside bodies whose equilibria are not isolated, their order and the changes between them are not certain.
    """
    if len(ranges) != 2:
        raise BadInput(
            f"borders: needs two parameters with a range each, found {', '.join(ranges) or 'none'}"
        )
    for name, values in ranges.items():
        if len(values) != 2 or not values[0] < values[1]:
            raise BadInput(f"ranges.{name} = {list(values)}: must be a lowest and a higher value")
    return borders_of_scene(scene_of("borders", system, body, ranges, ties), stability)


def borders_of_scene(scene: Scene, stability: bool = False) -> xr.Dataset:
    """Return the borders of the bodies of a scene over its two axes, in the form that `borders` returns."""
    if len(scene.axes) != 2:
        raise BadInput(f"borders: needs two axes, found {', '.join(scene.axes)}")
    extent = {axis.dim: (float(axis.values.min()), float(axis.values.max())) for axis in scene.axes.values()}
    return borders_of_plane(Plane(replace(scene, duration=Duration(1.0), nudge={}), extent, {}), stability)


def borders_of_plane(plane: Plane, stability: bool = False) -> xr.Dataset:
    """Return the borders on a plane whose sides are axes of a scene, in the form that `borders` returns."""
    curves = Borders.of(plane, stability)
    parts = ("vertex", _vertices(curves)), ("special", _special(curves))
    columns = {
        name: ((dim, "body_axis")[: column.ndim], column)
        for dim, part in parts
        for name, column in part.items()
    }
    centres = curves.values(np.stack([0.5 * (curves.axis[1:] + curves.axis[:-1])] * 2, -1)).T
    coordinates = {f"cell_{name}": centre for name, centre in zip(plane.extent, centres, strict=True)}
    ds = empty_dataset(plane.scene)
    own = {name: ds[name].attrs for name in plane.extent}
    ds = ds.drop_vars([name for name in ds.coords if ds[name].ndim]).assign_coords(plane.fixed)
    ds = ds.assign(columns).assign(cells=(tuple(coordinates), curves.cells)).assign_coords(coordinates)
    for name in [*columns, *coordinates, "cells"]:
        base = name.removeprefix("special_").removeprefix("tangent_").removeprefix("cell_")
        ds[name].attrs = _OWN.get(name) or own.get(base) or attributes(base)
    return ds


def borders_of_atlas(
    ds: xr.Dataset, *, x: str | None = None, y: str | None = None, select: Mapping[str, float] | None = None
) -> xr.Dataset:
    """Borders of the relative equilibria of the bodies on the plane of two axes, as curves; see `atlas.borders`.

    Parameters
    ----------
    x, y : str, optional
        Axes, as in `map`.
    select : mapping of str to float, optional
        Axis -> value, for the other axes.

    Returns
    -------
    Dataset
        The dataset of `atlas.borders`. The plane reaches half a cell beyond the outermost points, as a map does.
    """
    part, dims, panels = plane_of(ds, x, y, select or {})
    scene = resolved_scene(ds, part)
    if scene is None or panels or len(dims) != 2:
        raise BadInput("borders: needs an atlas of a scene with two axes; use select for the others")
    return borders_of_plane(Plane.of(scene, part, dims))


def table(ds: xr.Dataset) -> pd.DataFrame:
    """Return the vertices of borders as a table, which has a column for each component of a vector."""
    columns = {}
    for name, array in ds.data_vars.items():
        if array.dims == ("vertex",):
            columns[name] = array.values
        elif array.dims == ("vertex", "body_axis"):
            columns |= {f"{name}_{i + 1}": array.values[:, i] for i in range(3)}
    return pd.DataFrame(columns)


def _vertices(curves: Borders) -> dict[str, np.ndarray]:
    points = Degenerate.joined([curves.potential.none(), *(line.points for line in curves.lines)])
    rows = np.concatenate([points.unknowns[:0], *(line.tangents for line in curves.lines)])
    sizes = [len(line.tangents) for line in curves.lines]
    columns = _attitudes(curves, points) | {
        "curve": np.repeat(np.arange(len(sizes), dtype=np.int16), sizes),
        "kind": points.kind,
        "arc": np.concatenate([np.zeros(0), *(lengths(line) for line in curves.lines)]),
        "index_below": curves.morse_index.astype(np.int8),
        "index_above": (curves.morse_index + ~points.limit).astype(np.int8),
        "count_change": curves.changes[0].astype(np.int8),
        "stable_change": curves.changes[1].astype(np.int8),
        "residual": np.abs(points.equations()[0]).max(1), "condition": points.condition(rows),
    }  # fmt: skip
    slopes = curves.slopes(points.parts[4], rows[:, -3:-1])
    columns |= {f"tangent_{name}": slope for name, slope in zip(curves.plane.extent, slopes.T, strict=True)}
    return columns


def _special(curves: Borders) -> dict[str, np.ndarray]:
    points, curve, kind = curves.potential.none(), [], []
    for column in (0, 1):

        def test(points: Degenerate, column: int = column) -> Array:
            """Return function `column` in `character`, which is 0 at special points. On limits of stability function 1 is not used."""
            return np.where(points.limit & (column == 1), 1.0, points.character()[1][column])

        for n, (line, zero) in enumerate(zip(*with_zeros(curves.lines, test), strict=True)):
            own = np.flatnonzero(zero[: zero.size - line.closed])
            at, rates = line.points.take(own), length(line.tangents[own, -3:-1])
            at = at.take(at.solves() & (at.pitchfork | (rates < _TURNS)))
            points = Degenerate.joined([points, at])
            curve += [n] * len(at.kind)
            kind += list(np.where(at.pitchfork, SpecialKind.MEETING, SpecialKind.CUSP))
    for n, line in enumerate(curves.lines):
        if line.points.limit[0] and not line.closed:
            ends = line.points.take([0, -1])
            ends = ends.take(np.abs(ends.largest_square()) < _MEETS_AT_0)
            points = Degenerate.joined([points, ends])
            curve += [n] * len(ends.kind)
            kind += [SpecialKind.ZERO_AND_PAIR] * len(ends.kind)
    columns = _attitudes(curves, points) | {
        "curve": np.array(curve, np.int16),
        "kind": np.array(kind, np.int8),
    }
    return {f"special_{name}": column for name, column in columns.items()}


def _attitudes(curves: Borders, points: Degenerate) -> dict[str, np.ndarray]:
    low, high = np.transpose(list(curves.plane.extent.values()))
    values = np.clip(curves.values(points.parts[4]), low, high)  # rounding may lead outside of the limits
    frames = frames_of(*curves.potential.attitudes(points.parts[0]))
    return dict(zip(curves.plane.extent, values.T, strict=True)) | attitudes(frames)
