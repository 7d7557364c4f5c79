"""Lines between classes of points on a plane, traced on samples that are refined where the class changes."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from itertools import chain, pairwise, product
from pathlib import Path
from typing import cast

import contourpy
import numpy as np
from numpy.typing import NDArray

from .. import extension, files, sources, systems
from ..kernel import compiling
from ..systems.base import Array, Flags, Mask
from .plane import SAMPLES, Plane

Lines = dict[str, list[np.ndarray]]  # lines, (vertices, axes), by kind

LINES_FOLDER, KEPT_PLANES = "lines", 200  # folder in the cache, and number of planes kept there
WORTH_KEEPING = 0.1  # lines are kept if tracing takes more seconds than this
TRACING_ANEW = "tracing lines of theory anew"  # messages say this if the cache is not used


def cached_lines(trace: Callable[[], Lines], plane: Plane, *what: object) -> Lines:
    """Return the lines of a plane from the cache, or trace and store lines. Tracing takes seconds, and planes are shown repeatedly."""
    extensions = extension.extensions().values()
    theory = [each.code for each in extensions if each.families or each.variables or each.lines]
    code = sources.code(), sources.code(sources.of_folder(Path(__file__).parent)), theory
    scene = systems.origin(plane.scene.system), plane.scene.toml()
    of = repr((code, scene, plane.extent, plane.fixed, what))
    path = files.cache_folder() / LINES_FOLDER / f"{hashlib.sha256(of.encode()).hexdigest()[:32]}.json"
    with suppress(OSError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError):
        if files.is_private(path.parent, TRACING_ANEW):
            kept = files.parsed(files.read_private(path), is_sealed=True)["lines"]
            lines = {kind: [np.array(line, float) for line in group] for kind, group in kept.items()}
            points = np.concatenate([np.empty((0, len(plane.extent))), *chain(*lines.values())])
            if np.isfinite(points).all():
                return lines
    began = time.process_time()
    lines = trace()
    if time.process_time() - began > WORTH_KEEPING:
        with suppress(OSError):
            for folder in (path.parent.parent, path.parent):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not files.is_private(path.parent, TRACING_ANEW):
                return lines
            content = {kind: [line.tolist() for line in group] for kind, group in lines.items()}
            with files.atomic_write(path, durable=False) as temporary:
                temporary.chmod(0o600)
                temporary.write_text(files.sealed({"lines": content}))
            files.remove_leftovers(path.parent)
            stored = sorted(path.parent.glob("*.json"), key=lambda file: file.stat().st_mtime)
            for old in stored[:-KEPT_PLANES]:
                old.unlink(missing_ok=True)
    return lines


# Number of samples along each axis before refinement. The number is even for the same reason as SAMPLES.
COARSE_SAMPLES = 150
# Each cell that a line crosses is divided LEVELS times into DIVISION x DIVISION cells. An odd DIVISION keeps the middle of an
# extent, where special values such as 0 often are, between two samples.
DIVISION, LEVELS = 3, 2
# If the first samples take more seconds than this, tracing takes more than two seconds and is announced.
ANNOUNCED = 0.3
TRACING = "tracing the lines of theory, which later maps of this plane use again: some seconds"
# A vertex is found by TRISECTIONS steps on two axes, to about 1e-5 of each axis, and by LINE_TRISECTIONS steps on a single axis.
TRISECTIONS, LINE_TRISECTIONS = 3, 11
# A line is first cut into stretches of about STRETCH vertices. A stretch within FLATNESS cells of its chord is straight.
STRETCH, FLATNESS = 16, 0.05

# Kind of line -> class of each point. Lines separate points of class 1 from points of class 2, and stop at points of class 0.
Classes = Mapping[str, Flags]
Codes = NDArray[np.int64]  # one number for each point, which encodes the point's class for every kind of line


def class_borders(
    plane: Plane, classes: Callable[[Array], Classes], zeros: Mapping[str, Callable[[Array], Array]]
) -> Lines:
    """Return polylines by kind between points of class 1 and points of class 2, in the units of the axes.

    `classes` is a function of positions (points, axes), which are fractions of the extent of each axis. If a quantity changes
    sign on the lines of a kind, `zeros` has the magnitude of the quantity as a function of positions. Parts of lines on which the
    quantity has a pole instead of a zero are removed.

    On two axes, cells that a line crosses are refined, and the line is followed into neighbouring cells. A region wider than
    1 / (COARSE_SAMPLES * DIVISION**LEVELS) of an axis is thus followed to its ends if the region contains at least one sample.
    """
    if len(plane.extent) == 1:
        samples, trisections = classes(np.linspace(0, 1, SAMPLES)[:, np.newaxis]), LINE_TRISECTIONS
    else:
        samples, trisections = _refined_samples(classes), TRISECTIONS
    cells, result = len(next(iter(samples.values()))) - 1, {}

    def is_above(positions: Array, kind: str) -> Mask:
        return np.asarray(classes(positions / cells)[kind] > 1)

    def magnitude(positions: Array, kind: str) -> Array:
        return zeros[kind](positions / cells)

    for kind, column in samples.items():
        values = np.where(column > 0, column, np.nan)
        lines, edges = narrowed_lines(values, 1.5, partial(is_above, kind=kind), trisections)
        if kind in zeros:
            lines = without_poles(partial(magnitude, kind=kind), edges, lines)
        if lines:
            result[kind] = [np.stack(list(plane.coordinates(line / cells).values()), -1) for line in lines]
    return result


def narrowed_lines(
    values: Array, level: float, is_above: Callable[[Array], Mask], trisections: int
) -> tuple[list[Array], list[tuple[Array, Array]]]:
    """Return lines between samples above a level and other samples. Return also the two samples beside each vertex.

    Lines and samples are indices (vertices, axes). Trisection finds each vertex. A stretch of a line that is not straight within
    FLATNESS is halved. Only the ends of the final stretches become vertices.
    """
    lines = lines_at(values, level)
    if not lines:
        return [], []
    halfway, starts = np.concatenate(lines), np.cumsum([0, *map(len, lines)])
    low, high = np.floor(halfway + 0.25), np.ceil(halfway - 0.25)
    at_low = values[tuple(low.astype(int).T)] > level
    vertices = np.full(halfway.shape, np.nan)
    # A line has at least two stretches, because a single stretch of a closed line would begin and end at the same place.
    knots = [np.unique(np.linspace(i, j - 1, 3 + (j - i) // STRETCH, dtype=int)) for i, j in pairwise(starts)]
    first, last = (np.concatenate([line[part] for line in knots]) for part in (np.s_[:-1], np.s_[1:]))
    new = np.concatenate(knots)
    while new.size:
        vertices[new] = narrow(is_above, at_low[new], low[new], high[new], trisections)
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


def narrow(is_above: Callable[[Array], Mask], at_low: Mask, low: Array, high: Array, count: int) -> Array:
    """Find by `count` trisections the places between `low` and `high`, (vertices, axes), where `is_above` first differs from `at_low`."""
    for _ in range(count):
        third = (high - low) / 3
        inner = np.concatenate([low + third, low + 2 * third])
        is_low = is_above(inner).reshape(2, -1) == at_low
        low = low + third * np.logical_and.accumulate(is_low).sum(0)[:, np.newaxis]
        high = low + third
    return 0.5 * (low + high)


def _refined_samples(classes: Callable[[Array], Classes]) -> Classes:
    """Return the classes on a fine grid over two axes, (samples, samples), evaluated only where classes change."""
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
        samples, evaluated = _divide(codes, samples, evaluated)
    of_code = (np.arange(3**digits.size)[:, np.newaxis] // digits % 3).astype(np.int8)
    return {kind: of_code[:, i][samples] for i, kind in enumerate(columns)}


def _divide(codes: Callable[[Array], Codes], samples: Codes, evaluated: Mask) -> tuple[Codes, Mask]:
    """Divide each cell into DIVISION x DIVISION smaller cells. Return the samples at all corners, and a mask of the evaluated samples.

    In each cell that a line crosses, all samples are evaluated. The line is followed into neighbouring cells. Any other sample is a
    copy of the nearest of the given `samples`.
    """
    count, along = DIVISION * (len(samples) - 1) + 1, np.arange(DIVISION + 1)
    nearest = np.rint(np.arange(count) / DIVISION).astype(int)
    fine, known = samples[np.ix_(nearest, nearest)].ravel(), np.zeros(count**2, bool)
    known.reshape(count, count)[::DIVISION, ::DIVISION] = evaluated

    def places(cells: Mask) -> NDArray[np.int64]:
        """Return the flat indices of the samples of cells, (cells, DIVISION + 1, DIVISION + 1)."""
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


def without_poles(
    size: Callable[[Array], Array], edges: list[tuple[Array, Array]], lines: list[Array]
) -> list[Array]:
    """Return the parts of `lines` at zeros of a quantity, without parts at poles. `size` gives the quantity's magnitude at positions."""
    return [
        part
        for (low, high), line in zip(edges, lines, strict=True)
        for part in shown_parts(line, size(line) < 0.5 * np.maximum(size(low), size(high)))
    ]


def shown_parts(line: Array, shown: Mask) -> list[Array]:
    """Return the parts of a line whose vertices are all shown."""
    parts = np.split(np.arange(len(line)), np.flatnonzero(np.diff(shown)) + 1)
    return [line[part] for part in parts if shown[part[0]]]


def within(line: Array, low: Array, high: Array) -> list[Array]:
    """Return the parts of a line inside a box. Where the line leaves the box, a part ends on a side of the box."""
    for axis, side in product(range(line.shape[1]), (low, high)):
        beyond = line[:, axis] - side[axis]
        i = np.flatnonzero(beyond[:-1] * beyond[1:] < 0)
        share = (beyond[i] / (beyond[i] - beyond[i + 1]))[:, np.newaxis]
        crossing = line[i] + share * (line[i + 1] - line[i])
        crossing[:, axis] = side[axis]
        line = np.insert(line, i + 1, crossing, axis=0)
    shown = np.all((line >= low) & (line <= high), axis=1)
    parts = shown_parts(line, shown)
    if len(parts) > 1 and shown[0] and (line[0] == line[-1]).all():  # a closed line that starts in the box
        parts[0] = np.concatenate([parts.pop(), parts[0][1:]])
    return [part for part in parts if len(part) > 1 or line.shape[1] == 1]


def values_at(positions: Array, axes: list[Array]) -> Array:
    """Return axis values at `positions` (vertices, axes), which are fractional indices of the values."""
    columns = [np.interp(p, np.arange(axis.size), axis) for p, axis in zip(positions.T, axes, strict=True)]
    return np.stack(columns, -1)


def on_axes(column: Array, shown: Mask, axes: list[Array]) -> Array:
    """Return `column`, which has a value for each point of a lattice, as an array over `axes`. Points that are not shown get nan."""
    return np.where(shown, column, np.nan).reshape([axis.size for axis in axes])


def lines_at(values: Array, level: float) -> list[Array]:
    """Return lines midway between neighbouring values above and below a level, as indices (vertices, axes). Lines stop at nan."""
    above = np.where(np.isfinite(values), np.where(values > level, 1.0, 0.0), np.nan)
    if not ((above == 0).any() and (above == 1).any()):
        return []
    if values.ndim == 1:
        return [np.array([[index + 0.5]]) for index in np.flatnonzero(np.abs(np.diff(above)) == 1)]
    # Closed lines of up to six vertices are dropped. They enclose one or two points, for example if a region is narrower than a cell.
    return [line for line in contours(above, 0.5) if len(line) > 7 or (line[0] != line[-1]).any()]


def contours(values: Array, level: float) -> list[Array]:
    """Return contour lines of values on two axes, as fractional indices (vertices, 2). Cells with nan have no lines."""
    generator = contourpy.contour_generator(
        z=np.ma.masked_invalid(values.T), corner_mask=False, line_type="Separate"
    )
    return cast("list[Array]", generator.lines(level))


# A frequency difference extrapolated across a crossing may err by this fraction of the sum of the differences beside the crossing.
_CURVATURE = 0.5


def crossings(difference: Array) -> list[Array]:
    """Return segments on which two frequencies cross. `difference`, the larger minus the smaller frequency, has a kink at 0 there.

    At a kink, the difference extrapolated from one side is the negative of the difference on the other side.
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
    """Return the place between samples i and i + 1 of the first axis, from 0 to 1, at which `difference` touches 0, or nan."""
    fraction = np.full((difference.shape[0] - 1, difference.shape[1]), np.nan)
    before, low, high, after = difference[:-3], difference[1:-2], difference[2:-1], difference[3:]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = low + high
        crossed = (np.abs(2 * low - before + high) < _CURVATURE * size) & (low < before)
        crossed &= (np.abs(2 * high - after + low) < _CURVATURE * size) & (high < after)
        fraction[1:-1] = np.where(crossed, low / size, np.nan)
    return fraction
