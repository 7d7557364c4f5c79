"""Borders on a plane of an atlas as data: of theory, and of measured regions."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import cast

import contourpy
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from .. import files, sources, systems
from ..errors import BadInput, attribute_text
from ..flags import Label, NonlinearStability, Stability
from ..kernel import compiling
from ..scene.model import Scene
from ..systems.base import (
    Array,
    DerivedVariable,
    Flags,
    Mask,
    Points,
    derived_values,
    derived_variables,
    possible_body,
)
from ..systems.gyrostat import Gyrostat
from ..systems.gyrostat.branches import Family, curves, on_segments
from ..systems.gyrostat.variables import FREQUENCIES, NONLINEAR, NORMAL_FORM
from . import plane as planes
from .metadata import axes_of, flag_values, is_logarithmic, resolved_scene, scene_of, system_of
from .plane import IN_SPACE, SAMPLES, Plane
from .select import plane_of

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
    plane, dims, panel_dims = plane_of(ds, x, y, select)
    if panel_dims or (label is not None and len(dims) != 2):
        raise BadInput(
            f"boundary: needs two axes, found {', '.join(map(str, plane.dims))}; use select for the others"
        )
    scene = scene_of(ds) if label is not None else resolved_scene(ds, plane)
    if label is None:
        if scene is None:
            raise BadInput(
                "boundary: these points come from no scene, so that theory has no plane; name a label for the border"
                " of its region"
            )
        lines = theory_lines(scene, plane, dims, variable)
    else:
        (flag,) = flag_values(ds, variable, label)
        inside = (plane[variable].transpose(dims[1], dims[0]) == flag).values.astype(float)
        log = np.array([is_logarithmic(scene, dim, plane[dim].values) for dim in dims])
        along, across = (
            np.log(plane[dim].values) if is_log else plane[dim].values
            for dim, is_log in zip(dims, log, strict=True)
        )
        generator = contourpy.contour_generator(along, across, inside, line_type="Separate")
        lines = {f"{variable} = {label}": [np.asarray(line) for line in generator.lines(0.5)]}
        for line in lines[f"{variable} = {label}"]:
            line[:, log] = np.exp(line[:, log])
    numbered = [(kind, line) for kind, group in lines.items() for line in group]
    vertices = np.concatenate([line for _, line in numbered]) if numbered else np.zeros((0, len(dims)))
    lengths = [len(line) for _, line in numbered]
    numbers = np.repeat(np.arange(len(numbered)), lengths)
    kinds = np.repeat(np.array([kind for kind, _ in numbered], str), lengths)
    return xr.Dataset(
        {
            **{dim: ("vertex", vertices[:, i], plane[dim].attrs) for i, dim in enumerate(dims)},
            "line": ("vertex", numbers, {"long_name": "number of the line to which the vertex belongs"}),
            "kind": ("vertex", kinds, {"long_name": "what changes at the line"}),
        },
        attrs={"title": f"borders in {attribute_text(plane.attrs, 'title', 'an atlas')!r}"},
    )


def theory_lines(scene: Scene, plane: xr.Dataset, dims: list[str], variable: str) -> Lines:
    """Borders of theory on a plane of an atlas by kind; BadInput if its dimensions are not the scene's."""
    for dim in dims:
        if dim not in axes_of(scene):
            raise BadInput(f"{dim}: not an axis of the atlas' scene; its axes: {', '.join(axes_of(scene))}")
        if any(axes_of(scene)[dim].name in getattr(tie, "drawn", ()) for tie in scene.ties.values()):
            raise BadInput(f"{dim}: its values number random draws, between which theory has no lines")
    derived = derived_variables(scene.system).get(variable)
    whole = Plane.of(scene, plane, dims)
    if derived is not None and derived.is_count and variable in plane:
        counts = plane[variable].transpose(*dims)
        values = [counts[dim].values.tobytes() for dim in dims]
        return _traced(
            lambda: count_borders(whole, counts, derived), whole, variable, counts.values.tobytes(), *values
        )
    borders = _traced(lambda: theory_borders(whole), whole)
    frame = IN_SPACE if variable.endswith("_inertial") else ""
    names = {kind: kind if kind in FRAMELESS else kind + frame for kind in KINDS}
    borders = {kind: borders[name] for kind, name in names.items() if name in borders}
    if variable in RESONANCE_VARIABLES and variable in derived_variables(scene.system) and len(dims) == 2:
        nonlinear = variable in (NONLINEAR, *NORMAL_FORM)
        traced = _traced(lambda: resonance_lines(whole, nonlinear=nonlinear), whole, "resonances", nonlinear)
        borders = borders | traced
    return borders


LINES_FOLDER, KEPT_PLANES = "lines", 200  # in the cache
WORTH_KEEPING = 0.1  # seconds of tracing


def _traced(trace: Callable[[], Lines], plane: Plane, *what: object) -> Lines:
    """Lines of a plane, kept in the cache: tracing takes seconds, and maps and pages show the same planes."""
    code = [Path(path).read_bytes() for path in (__file__, planes.__file__)], sources.code()
    scene = systems.origin(plane.scene.system), plane.scene.toml()
    of = repr((code, scene, plane.extent, plane.fixed, what))
    path = files.cache_folder() / LINES_FOLDER / f"{hashlib.sha256(of.encode()).hexdigest()[:32]}.json"
    with suppress(OSError, ValueError):
        kept = files.parsed(files.read_bytes(path), is_sealed=True)["lines"]
        return {kind: [np.array(line) for line in group] for kind, group in kept.items()}
    began = time.process_time()
    lines = trace()
    if time.process_time() - began > WORTH_KEEPING:
        with suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            content = {kind: [line.tolist() for line in group] for kind, group in lines.items()}
            with files.atomic_write(path, durable=False) as temporary:
                temporary.write_text(files.sealed({"lines": content}))
            files.remove_leftovers(path.parent)
            stored = sorted(path.parent.glob("*.json"), key=lambda file: file.stat().st_mtime)
            for old in stored[:-KEPT_PLANES]:
                old.unlink(missing_ok=True)
    return lines


# Samples along each axis before refinement: even, as SAMPLES.
COARSE_SAMPLES = 150
# Cells that a line crosses are divided into 3 x 3, so often. An odd number leaves the middle of an extent, where
# special values such as 0 often are, between two samples.
DIVISION, LEVELS = 3, 2
# Seconds of the first samples, from which the whole takes more than two.
ANNOUNCED = 0.3
TRACING = "tracing the lines of theory, which later maps of this plane use again: some seconds"
# Trisections of a vertex: on two axes to about 1e-5 of each, on one axis to less.
TRISECTIONS, LINE_TRISECTIONS = 3, 11
# Vertices of the stretches into which a line is first divided, and cells by which a straight one may differ from its chord.
STRETCH, FLATNESS = 16, 0.05

STABILITY = "stability limit"
LABEL = "precession limit"
EXISTENCE = "edge of existence"
ZERO_RATES = {"n": "permanent rotation: psi' = 0", "m": "permanent rotation: phi' = 0"}
KINDS = (STABILITY, LABEL, EXISTENCE, *ZERO_RATES.values())
FRAMELESS = (STABILITY, EXISTENCE)

# Classes of points: 1 and 2 on the two sides of a line, 0 where there is no line.
Classes = dict[str, Flags]
Codes = NDArray[np.int64]  # one number for the classes of all kinds


def theory_borders(plane: Plane) -> dict[str, list[np.ndarray]]:
    """Polylines, by KINDS, at which theory predicts a change in a plane, in the units of its axes.

    The kinds that depend on the frame are also those in space, with IN_SPACE at the end.

    They separate linearly stable from unstable motions, regular precession from permanent rotation, and
    points with a motion from points without; and a regular precession has psi' = 0 or phi' = 0 on them, so
    that it is a permanent rotation on the line alone. Samples on COARSE_SAMPLES values along each axis are
    refined where a line crosses a cell, and around it as far as the line continues, so that a region wider
    than 1 / (COARSE_SAMPLES * DIVISION**LEVELS) of an axis is followed to its ends if one sample is inside
    it. Vertices are then trisected.
    """

    def classes(positions: Array) -> Classes:
        """Classes at positions (points, axes)."""
        theory = plane.theory(plane.coordinates(positions))
        columns = {
            STABILITY: np.where(theory.exists, theory.stable, Stability.UNKNOWN),
            EXISTENCE: np.where(theory.exists, 1, 2),
        }
        # A nudged unstable motion has no label of its own, so that no line divides such points.
        lasts = (theory.stable != Stability.UNSTABLE) | (not plane.scene.nudge)
        for frame, (label, rates) in theory.frames.items():
            regular = theory.exists & (label == Label.REGULAR_PRECESSION)
            permanent = theory.exists & (label == Label.PERMANENT_ROTATION)
            columns[LABEL + frame] = np.select([regular, permanent], [1, 2], 0)
            for name, kind in ZERO_RATES.items():
                if name not in plane.extent:  # the zero of an axis needs no line
                    columns[kind + frame] = np.where(regular & lasts, np.where(rates[name] < 0, 1, 2), 0)
        return {kind: column.astype(np.int8) for kind, column in columns.items()}

    if len(plane.extent) == 1:
        samples, trisections = classes(np.linspace(0, 1, SAMPLES)[:, np.newaxis]), LINE_TRISECTIONS
    else:
        samples, trisections = _refined_samples(classes), TRISECTIONS
    result = {}
    for kind, column in samples.items():
        if not ((column == 1).any() and (column == 2).any()):
            continue
        cells = len(column) - 1

        def is_above(positions: Array, kind: str = kind, cells: int = cells) -> Mask:
            return np.asarray(classes(positions / cells)[kind] > 1)

        lines, edges = _narrowed_lines(np.where(column > 0, column, np.nan), 1.5, is_above, trisections)
        rate = next((name for name, zero_kind in ZERO_RATES.items() if kind.startswith(zero_kind)), None)
        if rate is not None:

            def size(positions: Array, kind: str = kind, rate: str = rate, cells: int = cells) -> Array:
                frames = plane.theory(plane.coordinates(positions / cells)).frames
                return np.abs(frames[kind.removeprefix(ZERO_RATES[rate])][1][rate])

            lines = _without_poles(size, edges, lines)
        if lines:
            result[kind] = [np.stack(list(plane.coordinates(line / cells).values()), -1) for line in lines]
    return result


def _narrowed_lines(
    values: Array, level: float, is_above: Callable[[Array], Mask], trisections: int
) -> tuple[list[Array], list[tuple[Array, Array]]]:
    """Lines between samples on both sides of a level, trisected, and the samples on either side; all as indices (vertices, axes).

    Only the ends of straight stretches are vertices: a stretch that is not straight within FLATNESS is halved.
    """
    lines = _lines_at(values, level)
    if not lines:
        return [], []
    halfway, starts = np.concatenate(lines), np.cumsum([0, *map(len, lines)])
    low, high = np.floor(halfway + 0.25), np.ceil(halfway - 0.25)
    at_low = values[tuple(low.astype(int).T)] > level
    vertices = np.full(halfway.shape, np.nan)
    # At least two stretches, since a ring ends where it begins.
    knots = [np.unique(np.linspace(i, j - 1, 3 + (j - i) // STRETCH, dtype=int)) for i, j in pairwise(starts)]
    first, last = (np.concatenate([line[part] for line in knots]) for part in (np.s_[:-1], np.s_[1:]))
    new = np.concatenate(knots)
    while new.size:
        vertices[new] = _narrowed(is_above, at_low[new], low[new], high[new], trisections)
        long = last - first > 1
        first, last = first[long], last[long]
        if first.size:
            start, chord = vertices[first], vertices[last] - vertices[first]
            normal = chord[:, ::-1] * [-1, 1] / np.maximum(np.hypot(*chord.T), FLATNESS)[:, np.newaxis]
            places = product((0.25, 0.5, 0.75), (-FLATNESS, FLATNESS))
            beside = np.concatenate([start + along * chord + across * normal for along, across in places])
            above = is_above(np.clip(beside, 0, np.array(values.shape) - 1)).reshape(3, 2, -1)
            bent = (above[:, 0] == above[:, 1]).any(0)
            first, last = first[bent], last[bent]
        new = (first + last) // 2
        first, last = np.append(first, new), np.append(new, last)
    kept = np.isfinite(vertices[:, 0])
    ends = np.cumsum(kept)[starts[1:-1] - 1]
    edges = zip(np.split(low[kept], ends), np.split(high[kept], ends), strict=True)
    return np.split(vertices[kept], ends), list(edges)


def _narrowed(is_above: Callable[[Array], Mask], at_low: Mask, low: Array, high: Array, count: int) -> Array:
    """Positions between low and high (vertices, axes), up to which a level is exceeded as it is at low."""
    for _ in range(count):
        third = (high - low) / 3
        inner = np.concatenate([low + third, low + 2 * third])
        is_low = is_above(inner).reshape(2, -1) == at_low
        low = low + third * np.logical_and.accumulate(is_low).sum(0)[:, np.newaxis]
        high = low + third
    return 0.5 * (low + high)


def _refined_samples(classes: Callable[[Array], Classes]) -> Classes:
    """Classes on a fine grid over two axes, (samples, samples), evaluated only where they change."""
    steps = np.linspace(0, 1, COARSE_SAMPLES)
    positions = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    began = time.process_time()
    columns = classes(positions)
    if time.process_time() - began > ANNOUNCED:
        compiling.say(TRACING)
    digits = 3 ** np.arange(len(columns))

    def codes(positions: Array) -> Codes:
        return np.asarray(digits @ np.array(list(classes(positions).values())))

    samples = (digits @ np.array(list(columns.values()))).reshape(steps.size, steps.size)
    evaluated = np.ones(samples.shape, bool)
    for _ in range(LEVELS):
        samples, evaluated = _divided(codes, samples, evaluated)
    of_code = (np.arange(3**digits.size)[:, np.newaxis] // digits % 3).astype(np.int8)
    return {kind: of_code[:, i][samples] for i, kind in enumerate(columns)}


def _divided(codes: Callable[[Array], Codes], samples: Codes, evaluated: Mask) -> tuple[Codes, Mask]:
    """Samples of the cells divided into DIVISION x DIVISION, and where they were evaluated; elsewhere they are the nearest's.

    All samples of cells with a change are evaluated, and of those beside them as far as a line continues.
    """
    count, along = DIVISION * (len(samples) - 1) + 1, np.arange(DIVISION + 1)
    nearest = np.rint(np.arange(count) / DIVISION).astype(int)
    fine, known = samples[np.ix_(nearest, nearest)].ravel(), np.zeros(count**2, bool)
    known.reshape(count, count)[::DIVISION, ::DIVISION] = evaluated

    def places(cells: Mask) -> NDArray[np.int64]:
        """Flat indices of the samples of cells, (cells, DIVISION + 1, DIVISION + 1)."""
        i, j = DIVISION * np.argwhere(cells).T[:, :, np.newaxis, np.newaxis]
        return (i + along[:, np.newaxis]) * count + j + along

    corners = np.lib.stride_tricks.sliding_window_view(samples, (2, 2))
    divided = pending = (corners != corners[..., :1, :1]).any((2, 3))
    while pending.any():
        new = places(pending)
        new = np.unique(new[~known[new]])
        fine[new], known[new] = codes(np.stack(np.divmod(new, count), -1) / (count - 1)), True
        near = np.pad(pending, 1)
        pending = (near[2:, 1:-1] | near[:-2, 1:-1] | near[1:-1, 2:] | near[1:-1, :-2]) & ~divided
        cells = fine[places(pending)]
        pending[pending] = (cells != cells[:, :1, :1]).any((1, 2))
        divided = divided | pending
    return fine.reshape(count, count), known.reshape(count, count)


def _without_poles(
    size: Callable[[Array], Array], edges: list[tuple[Array, Array]], lines: list[Array]
) -> list[Array]:
    """The parts of lines on which a quantity of this magnitude changes its sign through zero, not through infinity."""
    return [
        part
        for (low, high), line in zip(edges, lines, strict=True)
        for part in _parts(line, size(line) < 0.5 * np.maximum(size(low), size(high)))
    ]


def _parts(line: Array, shown: Mask) -> list[Array]:
    """The parts of a line of which every vertex is shown."""
    parts = np.split(np.arange(len(line)), np.flatnonzero(np.diff(shown)) + 1)
    return [line[part] for part in parts if shown[part[0]]]


CHANGE = "change of the number"
COUNT_TRISECTIONS = 4  # of the distance between two neighbouring points of the atlas
# Counts that change only where equilibria merge.
MERGING_COUNTS = ("equilibrium_count", "equilibrium_energy_stable_count")
MANY_COUNTS = 300  # vertices, which take more than a second
SLICES, SLICE_VALUES = 7, 9  # along each axis, on which curves begin
MAX_SEARCHES = 8  # of further points on curves
MAX_SEGMENTS = 64  # changes of a count between neighbours in each search
TOGETHER = 4  # curves that are followed at once
SAME_CURVE = 1e-3  # distance over the extent of the axes: further than the chords of a curve are from it


def count_borders(plane: Plane, counts: xr.DataArray, derived: DerivedVariable) -> dict[str, list[Array]]:
    """Lines, under CHANGE, between the regions of a plane where a count has different values.

    Regions narrower than a cell are missed, but for MERGING_COUNTS; each change of a count that skips values gives its own line.
    """
    values = counts.transpose(*plane.extent).values
    axes = [counts[dim].values for dim in plane.extent]
    levels = [0.5 * (a + b) for a, b in pairwise(np.unique(values[np.isfinite(values)]))]
    changes = np.concatenate(
        [np.zeros((0, len(axes))), *(line for level in levels for line in _lines_at(values, level))]
    )
    if len(changes) > MANY_COUNTS:
        compiling.say(TRACING)
    if derived.name in MERGING_COUNTS and isinstance(plane.scene.system, Gyrostat):
        lines = _merging_lines(plane, plane.scene.system, axes, changes, derived.name)
        return {CHANGE: lines} if lines else {}

    def is_above(positions: Array, level: float) -> Mask:
        """Whether the count at positions (vertices, axes) is above a level."""
        points = plane.points(dict(zip(plane.extent, _interpolated(positions, axes).T, strict=True)))
        return np.asarray(derived.values(points.base, points.duration, lambda: None) > level)

    classes = [(level, partial(is_above, level=level), COUNT_TRISECTIONS) for level in levels]
    lines = [_interpolated(line, axes) for each in classes for line in _narrowed_lines(values, *each)[0]]
    return {CHANGE: lines} if lines else {}


def _merging_lines(
    plane: Plane, system: Gyrostat, axes: list[Array], changes: Array, count: str
) -> list[Array]:
    """Curves on which equilibria merge, exact but for rounding.

    They are followed from points on SLICES of the plane, then from changes of the count between neighbours, the indices halfway
    (N, axes), that none of them explains. Those on which no minimum merges are followed and left out where minima are counted.
    """
    minima = count == MERGING_COUNTS[1]
    extent = {dim: (axis.min(), axis.max()) for dim, axis in zip(plane.extent, axes, strict=True)}
    plane = replace(plane, extent=extent)
    places = [plane.positions(dim, axis) for dim, axis in zip(extent, axes, strict=True)]

    def points(positions: Array) -> Points:
        return plane.points(plane.coordinates(positions)).base

    def in_units(positions: Array) -> Array:
        return np.stack(list(plane.coordinates(positions).values()), -1)

    family = Family.of(system, points, np.array(list(product((0.0, 0.4, 1.0), repeat=len(axes)))))
    if len(axes) == 1:
        where, _, number = on_segments(family, np.zeros((1, 1)), np.ones((1, 1)), axes[0].size)
        where = where[(number == 0) | (not minima)]
        return list(in_units(where[np.unique(where.round(9), return_index=True)[1]])[:, None])
    across, ends = (np.arange(SLICES) + 0.38) / SLICES, np.repeat([[0.0], [1.0]], SLICES, 1)
    sides = np.stack([np.broadcast_to(across, ends.shape), ends], -1)
    (low, high), size = np.concatenate([sides, sides[..., ::-1]], 1), SLICE_VALUES
    indices = np.stack([np.floor(changes + 0.25), np.ceil(changes - 0.25)])
    unexplained = np.stack([_interpolated(each, places) for each in indices], 1)
    lines: list[tuple[Array, NDArray[np.int64]]] = []
    for _ in range(MAX_SEARCHES):
        where, frames, _ = on_segments(family, low, high, size)
        remaining = np.unique(where.round(9), axis=0, return_index=True)[1]
        for vertices, _ in lines:
            remaining = remaining[_distances(vertices, where[remaining]) > SAME_CURVE]
        while remaining.size:
            some = remaining[:TOGETHER]
            for i, line in zip(some, curves(family, where[some], frames[some]), strict=True):
                if i in remaining:
                    lines.append(line)
                    remaining = remaining[_distances(line[0], where[remaining]) > SAME_CURVE]
            remaining = np.setdiff1d(remaining, some)
        for vertices, number in lines:
            cells = np.array([axis.size - 1 for axis in axes])
            far = _distances(vertices * cells, unexplained.mean(1) * cells) > 1
            unexplained = unexplained[far | bool(minima and number.any())]
        if not len(unexplained):
            break
        (low, high), size = np.moveaxis(unexplained[:MAX_SEGMENTS], 1, 0), 2
        unexplained = unexplained[MAX_SEGMENTS:]
    shown = [possible_body(system, points(line)) & ((number == 0) | (not minima)) for line, number in lines]
    parts = [part for (line, _), mask in zip(lines, shown, strict=True) for part in _parts(line, mask)]
    return [in_units(part) for part in parts if len(part) > 1]


def _distances(line: Array, points: Array) -> Array:
    """Distances of points (N, axes) from a polyline."""
    start, chord = line[:-1], np.diff(line, axis=0)
    offset = points[:, None] - start
    fraction = np.clip((offset * chord).sum(-1) / np.maximum((chord**2).sum(-1), 1e-300), 0, 1)
    return np.sqrt(((offset - fraction[..., None] * chord) ** 2).sum(-1)).min(1, initial=np.inf)


def _interpolated(positions: Array, axes: list[Array]) -> Array:
    """Axis values at positions (vertices, axes) that are indices of values, or fractions between them."""
    columns = [np.interp(p, np.arange(axis.size), axis) for p, axis in zip(positions.T, axes, strict=True)]
    return np.stack(columns, -1)


def _lines_at(values: Array, level: float) -> list[Array]:
    """Lines halfway between neighbours on both sides of a level, as indices (vertices, axes); not at nan."""
    above = np.where(np.isfinite(values), np.where(values > level, 1.0, 0.0), np.nan)
    if not ((above == 0).any() and (above == 1).any()):
        return []
    if values.ndim == 1:
        return [np.array([[index + 0.5]]) for index in np.flatnonzero(np.abs(np.diff(above)) == 1)]
    # A ring of up to six vertices contains one or two points, as many of a region narrower than the cells do.
    return [line for line in _contours(above, 0.5) if len(line) > 7 or (line[0] != line[-1]).any()]


def _contours(values: Array, level: float) -> list[Array]:
    """Contour lines of values on two axes, as indices (vertices, 2); nan where there are none."""
    generator = contourpy.contour_generator(
        z=np.ma.masked_invalid(values.T), corner_mask=False, line_type="Separate"
    )
    return cast("list[Array]", generator.lines(level))


RESONANCE_RATIOS = (1, 2, 3)
RESONANCES = tuple(f"resonance {ratio}:1" for ratio in RESONANCE_RATIOS)
DEGENERATE = "D = 0 of the normal form"
# Variables on whose maps the lines are drawn.
RESONANCE_VARIABLES = (*FREQUENCIES, "stability_kind", NONLINEAR, *NORMAL_FORM)
RESONANCE_SAMPLES = 200  # along each axis
# By how much the difference of two frequencies, continued linearly from two samples, may miss the third where they cross.
_CURVATURE = 0.5


def resonance_lines(plane: Plane, *, nonlinear: bool = False) -> dict[str, list[Array]]:
    """Lines, by RESONANCES, where two frequencies of a motion that is not unstable have the ratio 1, 2 or 3.

    A resonance 1:1 at which stability ends is a stability limit and is left out. nonlinear: only where the energy does not
    decide, with the lines DEGENERATE on which the normal form does not either.
    """
    axes = [plane.samples(dim, RESONANCE_SAMPLES) for dim in plane.extent]
    grids = np.meshgrid(*axes, indexing="ij")
    names = (*FREQUENCIES, NONLINEAR, NORMAL_FORM[-1]) if nonlinear else FREQUENCIES

    def derived(coordinates: Mapping[str, Array], names: Collection[str]) -> dict[str, np.ndarray]:
        """Derived variables at some coordinates."""
        points = plane.points(coordinates)
        return derived_values(plane.scene.system, names, points.base, points.duration, lambda: None)

    coordinates = dict(zip(plane.extent, (grid.ravel() for grid in grids), strict=True))
    theory, columns = plane.theory(coordinates), derived(coordinates, names)
    shown = theory.exists & (theory.stable != Stability.UNSTABLE)
    if nonlinear:
        shown &= columns.pop(NONLINEAR) != NonlinearStability.ENERGY
    shape = 2 * (RESONANCE_SAMPLES,)
    values = {name: np.where(shown, column, np.nan).reshape(shape) for name, column in columns.items()}
    frequencies = [values[name] for name in FREQUENCIES]
    result = {}
    for ratio, kind in zip(RESONANCE_RATIOS, RESONANCES, strict=True):
        differences = [large - ratio * small for large, small in combinations(frequencies, 2)]
        traced = [_crossings(each) if ratio == 1 else _contours(each, 0.0) for each in differences]
        if lines := [_interpolated(line, axes) for each in traced for line in each]:
            result[kind] = lines
    if nonlinear:

        def determinant(positions: Array) -> Array:
            """D at positions that are indices."""
            columns = dict(zip(plane.extent, _interpolated(positions, axes).T, strict=True))
            return derived(columns, NORMAL_FORM[-1:])[NORMAL_FORM[-1]]

        lines, edges = _narrowed_lines(
            values[NORMAL_FORM[-1]], 0.0, lambda positions: determinant(positions) > 0, TRISECTIONS
        )
        if lines := _without_poles(lambda positions: np.abs(determinant(positions)), edges, lines):
            result[DEGENERATE] = [_interpolated(line, axes) for line in lines if len(line) > 1]
    return result


def _crossings(difference: Array) -> list[Array]:
    """Segments on which two frequencies cross: their difference, larger less smaller, has a kink at 0.

    There its continuation from one side is the negative of its value on the other.
    """
    along_x = _crossed_edges(difference)
    along_y = _crossed_edges(difference.T).T
    lines = []
    count = difference.shape[0] - 1
    marked = np.isfinite(along_x)[:, :-1] | np.isfinite(along_x)[:, 1:]
    marked = marked | np.isfinite(along_y)[:-1] | np.isfinite(along_y)[1:]
    for i, j in np.argwhere(marked[:count, :count]):
        ends = [(i + along_x[i, j + side], j + side) for side in (0, 1)]
        ends += [(i + side, j + along_y[i + side, j]) for side in (0, 1)]
        ends = [end for end in ends if np.isfinite(end).all()]
        if len(ends) == 2:
            lines.append(np.array(ends, float))
    return lines


def _crossed_edges(difference: Array) -> Array:
    """Fraction at which the difference vanishes between samples i and i + 1 of the first axis; nan where it does not."""
    fraction = np.full((difference.shape[0] - 1, difference.shape[1]), np.nan)
    before, low, high, after = difference[:-3], difference[1:-2], difference[2:-1], difference[3:]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = low + high
        crossed = (np.abs(2 * low - before + high) < _CURVATURE * size) & (low < before)
        crossed &= (np.abs(2 * high - after + low) < _CURVATURE * size) & (high < after)
        fraction[1:-1] = np.where(crossed, low / size, np.nan)
    return fraction
