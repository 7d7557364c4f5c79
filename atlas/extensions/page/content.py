"""All that a page about an atlas shows, as a dictionary that is written as JSON."""

from __future__ import annotations

import base64
import math
import shlex
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rcParams
from matplotlib.colors import to_hex

from ...analysis.boundary import EXISTENCE, STABILITY, theory_lines
from ...analysis.degrees import DEGREE, RAD, factor, in_degrees, lines_in_degrees
from ...analysis.metadata import (
    axes_of,
    check_not_empty,
    flag_names,
    in_order,
    is_averaged,
    is_logarithmic,
    is_numeric_axis,
    map_variable,
    numeric_coordinates,
    scene_of,
    scene_problem,
    system_of,
)
from ...errors import MAX_MESSAGE, MAX_TEXT, BadInput, attribute_text, printable
from ...flags import Regularity
from ...kernel.tableaux import METHODS
from ...plotting import cells
from ...plotting.cells import ColorScale, color_scale, is_angle
from ...plotting.content import MOTIONS, NO_THEORY, NO_VALUE, NOT_YET, SLOW, Panel, panel_of, remarks
from ...plotting.maps import as_math, scatter_axes
from ...plotting.style import axis_label, caption, flag_colours, unit_text, variable_label
from ...scene.model import Scene
from ...systems.base import System, derived_variables, families_of
from ...variables import POINT, data_variables
from . import motion
from .text import Run, plain, text_runs

THEORY = (
    "predicted", "predicted_inertial", "agreement", "stable", "growth_rate", "family", "condition_residual",
    "energy_stable", "frequency_1", "frequency_2", "frequency_3",
)  # fmt: skip
NUMERICS = ("status", "computed", "error_estimate", "step", "step_ratio", "integral_drift", "end_time")
MAX_SLICES = 24  # largest number of maps with lines of theory, which take some seconds for each map
SHADES = 256
HATCHED = {"slow": SLOW, "undecided": cells.UNDECIDED, "notYet": NOT_YET}  # regions that are hatched


def page_table(layout: Layout, store: Store, motions: Mapping[str, Any], file: str) -> dict[str, Any]:
    """Return all that a page shows. `motions` is a result of `motion_table`, or {"fault": reason}. Commands on the page open `file`."""
    ds, system, attributes = layout.ds, layout.system, layout.ds.attrs
    notes = list(layout.notes)
    if "atlas_scene" not in attributes:
        notes.append("The scene of this atlas is missing: motions start without its nudge.")
    if layout.scene is not None and layout.n_maps > MAX_SLICES:
        notes.append(f"Lines of theory are left out: there are more than {MAX_SLICES} maps.")
    notes += remarks(ds, filled=not layout.points)
    axes, variables = axes_table(layout), variables_table(layout, store)
    theory = theory_table(layout, store)
    return {
        "title": attribute_text(attributes, "title", "Atlas"),
        "system": system.title,
        "frame": system.frame,
        "reference": attribute_text(attributes, "references", limit=MAX_MESSAGE),
        "caption": caption(layout.whole) if not layout.points else "",
        "notes": [text_runs(note) for note in notes],
        "points": layout.points,
        "shape": layout.shape,
        "axes": axes,
        "variable": map_variable(layout.whole),
        "map": [(layout.axes if layout.points else layout.dims).index(dim) for dim in layout.axes],
        "variables": variables,
        "shades": store.shades,
        "theory": theory,
        "motion": motions,
        "commands": _commands(layout, store, file),
        "arrays": store.packed(),
    }


def axes_table(layout: Layout) -> list[dict[str, Any]]:
    """Return the axes of the atlas. For single points, return the axes of the map, then other coordinates that are not constant."""
    ds, system, names = layout.shown, layout.system, layout.dims
    if layout.points:
        columns = {name: ds[name].values for name in numeric_coordinates(ds, POINT)}
        names = layout.axes + [
            name
            for name, values in columns.items()
            if name not in (*layout.axes, POINT)
            and printable(name, MAX_TEXT) == name
            and np.unique(values[np.isfinite(values)]).size > 1
        ]
    axes = []
    for dim in names:
        parameter, label = system.parameters.get(dim), axis_label(ds, dim)
        symbol = axis_label(ds, dim, unit=False) if parameter is None else parameter.symbol or dim
        axes.append(
            {
                "name": dim,
                "label": text_runs(label),
                "plain": plain(label),
                "symbol": _defined_name(text_runs(symbol)),
                "text": attribute_text(ds[dim].attrs, "long_name", dim),
                "unit": text_runs(unit_text(attribute_text(ds[dim].attrs, "units"))),
                # JSON has no nan.
                "values": [x if math.isfinite(x) else None for x in ds[dim].values.astype(float).tolist()],
                "log": is_logarithmic(layout.scene, dim, ds[dim].values),
            }
        )
    return axes


def _defined_name(symbol: list[Run]) -> list[Run]:
    """Return the name that a formula such as K1 = (C - A)/B defines. Other symbols stay unchanged."""
    for number, run in enumerate(symbol):
        before, equals, _ = run["t"].partition(" = ")
        if equals:
            name = [*symbol[:number], {**run, "t": before}]
            return name if all(each["t"].isalnum() or not each["t"] for each in name) else symbol
    return symbol


def variables_table(layout: Layout, store: Store) -> list[dict[str, Any]]:
    """Return the variables of the atlas over its points, in the order of the file, with values, colours and texts."""
    variables = []
    for name, array in layout.shown.data_vars.items():
        usable = (
            array.dims
            and set(array.dims) <= set(layout.dims)
            and array.dtype.kind in "biuf"
            and not is_averaged(array)
            and printable(str(name), MAX_TEXT) == name
        )
        if usable:
            name, label = str(name), variable_label(array)
            group = "numerics" if name in NUMERICS else "motion"
            if name in THEORY or name in derived_variables(layout.system):
                group = "theory"
            lines = "inertial" if name.endswith("_inertial") else "frame"
            texts = {
                "name": name,
                "label": text_runs(label),
                "plain": plain(label),
                "text": attribute_text(array.attrs, "long_name"),
                "comment": attribute_text(array.attrs, "comment", limit=MAX_MESSAGE),
                "group": group,
                "lines": lines if name.removesuffix("_inertial") in MOTIONS else "limits",
            }
            variables.append(texts | _values(layout, store, name))
    if not variables:
        raise BadInput("page: this dataset has no variables over its axes")
    return variables


def _values(layout: Layout, store: Store, name: str) -> dict[str, Any]:
    """Return a variable's values and colour scale. For flags, return the values and each flag's text, sentence and colour."""
    array = layout.shown[name]
    values, flags = motion.over_points(_nearest_values(layout, name), layout.sizes), flag_names(array)
    if not flags:
        added = store.add(float_array(values))
        return {"values": added, "scale": store.add_scale(color_scale(array.values, angle=is_angle(array)))}
    variable = data_variables(layout.system).get(name)
    registered = {} if variable is None or variable.flags is None else dict(variable.flags)
    sentences = registered if list(registered) == flags else {}
    texts = cells.regularity_texts(layout.ds) if name == "regularity" else {}
    table: dict[str, Any] = {
        "flags": [
            {
                "name": flag,
                "text": texts.get(flag, flag.replace("_", " ")),
                "sentence": sentences.get(flag, ""),
                "colour": to_hex(colour),
                "hatched": flag == cells.UNDECIDED,
            }
            for flag, colour in flag_colours(flags).items()
        ],
        "values": store.add(values.astype(np.int8)),
    }
    scale = cells.exponent_scale([cells.chaotic_exponents(layout.ds, array)])
    if scale is not None:
        shaded = {"flag": int(Regularity.CHAOTIC), "by": "lyapunov", "scale": store.add_scale(scale)}
        table["shaded"] = shaded
    return table


def _nearest_values(layout: Layout, name: str) -> xr.DataArray:
    """Return the values of a variable. As on maps, a point that was not integrated has the value of the nearest integrated point."""
    array = layout.shown[name]
    if "computed" not in layout.ds or flag_names(array) or layout.points:
        return array
    values = np.array(array.transpose(*layout.dims).values)
    axes = [dim for dim in layout.dims if dim in layout.axes]
    for where, part in layout.slices():
        panel = panel_of(part, name, layout.axes, layout.scene, False).in_degrees(layout.degrees)
        values[where] = panel.array.transpose(*axes).values
    return xr.DataArray(values, dims=layout.dims)


def theory_table(layout: Layout, store: Store) -> dict[str, Any]:
    """Return lines of theory, unstable points whose runs ended before a drift, and reasons for white points, if the atlas has axes."""
    if layout.points:
        return {"slices": [], "styles": {}, "white": [], "hatches": HATCHED}
    name = "label" if "label" in layout.ds else next(iter(map(str, layout.ds.data_vars)))
    has_lines = layout.n_maps <= MAX_SLICES
    parts = [part for _, part in layout.slices()]
    panels = [panel_of(part, name, layout.axes, layout.scene, has_lines) for part in parts]
    slices = [_lines(layout, part, panel) for part, panel in zip(parts, panels, strict=True)]
    reasons = [reason for panel in panels for reason in panel.white if reason not in (NO_THEORY, NO_VALUE)]
    reasons = list(dict.fromkeys(reasons))
    code = np.zeros(layout.shape, np.int8)
    for number, reason in enumerate(reasons, 1):
        code[layout.over_slices([panel.white.get(reason) for panel in panels])] = number
    slow = layout.over_slices([panel.slow for panel in panels])
    return {
        "slices": slices,
        "styles": _styles(layout.system, slices),
        "white": reasons,
        "hatches": HATCHED,
        "reason": store.add(code),
        "slow": store.add(slow.astype(np.int8)),
        "slowText": SLOW,
    }


def _lines(layout: Layout, part: xr.Dataset, panel: Panel) -> list[dict[str, Any]]:
    """Return the lines of theory of one panel, each with a kind, vertices, and the groups of maps that show the line."""
    limits, axes = (STABILITY, EXISTENCE), [part[dim] for dim in layout.axes]
    panel = panel.in_degrees(layout.degrees)
    lines = [
        _line(kind, ["frame", "limits"] if kind in limits else ["frame"], vertices)
        for kind, vertices in panel.borders.items()
    ]
    if panel.borders and layout.scene is not None and "label_inertial" in layout.ds:
        inertial = theory_lines(layout.scene, part, layout.axes, "label_inertial")
        inertial = lines_in_degrees(inertial, axes, layout.degrees)
        lines += [_line(kind, ["inertial"], vertices) for kind, vertices in inertial.items()]
    everywhere = ["frame", "inertial", "limits"]
    return lines + [_line(name, everywhere, each, "exact") for name, each in panel.families.items()]


def _styles(system: System, slices: list[list[dict[str, Any]]]) -> dict[str, Any]:
    """Return the text, width and dashes of each kind of line."""
    families = list(families_of(system))
    named = {"-": (), ":": rcParams["lines.dotted_pattern"], "--": rcParams["lines.dashed_pattern"],
             "-.": rcParams["lines.dashdot_pattern"]}  # fmt: skip
    styles: dict[str, Any] = {}
    for line in (line for each in slices for line in each):
        kind, exact = line["kind"], line["source"] == "exact"
        style = cells.family_style(families.index(kind)) if exact else cells.border_style(kind)
        dashes = style["linestyle"]  # a name, or a pattern in units of the line's width
        words = kind.replace("_", " ") if exact else as_math(kind)
        styles[kind] = {
            "text": text_runs(f"{words} ({line['source']})"),
            "width": style["linewidth"],
            "dashes": [float(x) for x in (named[dashes] if isinstance(dashes, str) else dashes[1])],
        }
    return styles


def motion_table(layout: Layout, store: Store) -> dict[str, Any]:
    """Return the starts of all points, with parameters, constants and observables of the equations."""
    if layout.problem:
        raise BadInput(layout.problem)
    system, add = layout.system, store.add
    starts = motion.motions(layout.ds, system, layout.scene, layout.dims)
    angle = factor({"units": RAD}, layout.degrees)
    parameters = [
        {
            "name": name,
            "symbol": text_runs(parameter.symbol or name),
            "text": parameter.meaning,
            "unit": text_runs(unit_text(DEGREE if angle != 1 and parameter.unit == RAD else parameter.unit)),
            "values": add(starts.parameters[name] * (angle if parameter.unit == RAD else 1.0)),
        }
        for name, parameter in system.parameters.items()
        if not np.isnan(starts.parameters[name]).all()
    ]
    states = list(system.equations.STATE)
    observables = []  # states or functions of the equations, for systems without a body in a frame
    for observable in system.observables:
        unit = unit_text(observable.unit)
        label = f"{observable.symbol or observable.name}{f' ({unit})' if unit else ''}"
        state = states.index(observable.name) if observable.name in states else None
        observables.append({"name": observable.name, "label": text_runs(label), "state": state})
    return {
        "parameters": parameters,
        "angle": {"factor": angle, "unit": RAD if angle == 1 else unit_text(DEGREE)},
        "states": states,
        "state": [add(row) for row in starts.state],
        "constants": [add(row) for row in starts.constants],
        "duration": add(starts.duration),
        "steps": add(starts.steps.astype(np.int32 if starts.steps.max() < 2**31 else np.float64)),
        "reason": add(starts.reason.astype(np.int8)),
        "sentences": starts.sentences,
        "samples": motion.SAMPLES,
        "method": starts.method,
        "stepUnit": METHODS[starts.method].kernel_step,
        "frameAxes": [text_runs(axis) for axis in system.frame_axes],
        "observables": observables,
    }


def _commands(layout: Layout, store: Store, file: str) -> dict[str, Any]:
    """Return templates of the shell and Python commands that integrate a point, and the coordinates to fill in."""
    ds, names = layout.ds, dict[str, str]()
    if layout.scene is not None:
        names = {dim: axis.name for dim, axis in axes_of(layout.scene).items()}
    elif not layout.problem:
        names = {axis: axis for axis in map(str, ds.coords) if axis in layout.system.parameters}
    coordinates = []
    for dim, name in names.items():
        column = store.add(
            motion.over_points(xr.DataArray(ds[dim].variable.astype(np.float64)), layout.sizes)
        )
        if layout.scene is not None or column["over"]:  # without a scene, commands omit constant coordinates
            coordinates.append({"name": name, "dim": dim, "values": column})
    return {
        "shell": f"atlas trajectory {shlex.quote(file)} --at",
        "python": f"atlas.open_atlas({file!r}).atlas.trajectory",
        "places": coordinates,
    }


def _line(kind: str, on: list[str], vertices: list[np.ndarray], source: str = "theory") -> dict[str, Any]:
    """Return the entry of a line of theory. Coordinates of vertices have six digits, and are None where the line is cut."""
    paths = [
        [[float(f"{x:.6g}") if math.isfinite(x) else None for x in vertex] for vertex in line]
        for line in vertices
    ]
    return {"kind": kind, "on": on, "source": source, "paths": paths}


_TYPES = {"int8": "Int8Array", "int32": "Int32Array", "float32": "Float32Array", "float64": "Float64Array"}
_LEVEL = 9


class Store:
    """Arrays over the points of an atlas, and shades of colours, each stored once. `nbytes` is the size before compression."""

    def __init__(self, shape: tuple[int, ...]):
        self.shape = shape
        self.shades: dict[str, list[str]] = {}
        self.nbytes = 0
        self._arrays: list[np.ndarray] = []
        self._numbers: dict[tuple[str, bytes], int] = {}

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Store an array over the points. Return the number of its entry, and the axes along which the array varies."""
        over = []
        bits = np.broadcast_to(values, self.shape)
        bits = np.ascontiguousarray(bits).view(f"u{values.dtype.itemsize}")
        for axis in range(len(self.shape)):
            first = bits.take([0], axis)
            if bits.shape[axis] > 1 and (bits == first).all():
                bits = first
            elif bits.shape[axis] > 1:
                over.append(axis)
        bits = np.ascontiguousarray(bits).ravel()
        key = values.dtype.name, bits.tobytes()
        if key not in self._numbers:
            self._numbers[key] = len(self._arrays)
            self._arrays.append(bits.view(values.dtype))
            self.nbytes += bits.nbytes
        return {"array": self._numbers[key], "over": over}

    def add_scale(self, scale: ColorScale) -> dict[str, Any]:
        """Store the shades of a colour scale. Return the kind and the ends of the scale, and the name of the shades."""
        name = scale.colormap.name
        if name not in self.shades or scale.integers:
            count = scale.colormap.N if scale.integers else SHADES
            name = f"{name} {len(self.shades)}" if scale.integers else name
            shades = scale.colormap(np.linspace(0.0, 1.0, count))
            self.shades[name] = [to_hex(colour)[1:] for colour in shades]
        low, high = float(scale.norm.vmin or 0.0), float(1.0 if scale.norm.vmax is None else scale.norm.vmax)
        kind = "integers" if scale.integers else "log" if scale.log_range is not None else "linear"
        return {"kind": kind, "low": low, "high": high, "shades": name}

    def packed(self) -> list[dict[str, Any]]:
        """Return each array's type, size and data. Data are all numbers' first bytes, then second bytes and so on, as compressed base64."""
        entries = []
        for array in self._arrays:
            little = array.astype(array.dtype.newbyteorder("<"))
            columns = little.view(np.uint8).reshape(array.size, array.itemsize).T
            compressed = zlib.compress(np.ascontiguousarray(columns).tobytes(), _LEVEL)
            data = base64.b64encode(compressed).decode("ascii")
            entries.append({"type": _TYPES[array.dtype.name], "size": array.size, "data": data})
        return entries


def float_array(values: np.ndarray) -> np.ndarray:
    """Return numbers as float32 (seven digits), or as float64 if some magnitudes are outside the range of float32."""
    values = np.asarray(values, np.float64)
    size = np.abs(values[np.isfinite(values) & (values != 0.0)])
    fits = not size.size or bool(size.max() < 1e38 and size.min() > 1e-37)
    return values.astype(np.float32) if fits else values


MAX_POINTS = 120_000
# Largest size of the numbers before compression. The size in the page is nearly the same: base64 adds what compression removes.
MAX_BYTES = 12_000_000


@dataclass(frozen=True)
class Layout:
    """Axes and points of a page."""

    whole: xr.Dataset  # the atlas
    ds: xr.Dataset  # the points that are shown, in memory, sorted along their axes
    scene: Scene | None  # scene of the atlas, from which theory and motions come
    problem: str  # reason why the scene of the atlas cannot be used, or empty
    dims: list[str]  # dimensions of the points, in the order of the atlas
    axes: list[str]  # one or two axes of the map, x first, or two coordinates of single points
    panel_dims: list[str]  # dimensions that are not axes of the map
    points: bool  # whether the atlas has single points, without axes
    notes: list[str]  # sentences about omitted parts
    degrees: bool | None  # whether angles are shown in degrees, see `analysis.degrees`

    @cached_property
    def shown(self) -> xr.Dataset:
        """The points, with angles in the unit that a reader sees."""
        return in_degrees(self.ds, self.degrees)

    @property
    def system(self) -> System:
        return system_of(self.ds)

    @property
    def n_maps(self) -> int:
        """Number of maps, which is one for each value of the further dimensions."""
        return math.prod(self.ds.sizes[dim] for dim in self.panel_dims)

    @property
    def sizes(self) -> dict[str, int]:
        """Number of values along each dimension of the points."""
        return {dim: self.ds.sizes[dim] for dim in self.dims}

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an array over all points."""
        return tuple(self.sizes.values())

    def slices(self) -> Iterator[tuple[tuple[int | slice, ...], xr.Dataset]]:
        """Yield for each map the index of its points in an array over all points, and the part of the atlas that the map shows."""
        for index in np.ndindex(*(self.ds.sizes[dim] for dim in self.panel_dims)):
            along = dict(zip(self.panel_dims, index, strict=True))
            yield tuple(along.get(dim, slice(None)) for dim in self.dims), self.ds.isel(along)

    def over_slices(self, masks: list[np.ndarray | None]) -> np.ndarray:
        """Join masks over the cells of each map into one mask over all points. None stands for a mask that is false everywhere."""
        whole = np.zeros(self.shape, bool)
        order = self.axes[::-1]  # x is the last dimension of a panel
        axes = [order.index(dim) for dim in self.dims if dim in order]
        for (where, _), mask in zip(self.slices(), masks, strict=True):
            if mask is not None:
                whole[where] = np.transpose(mask, axes)
        return whole


def page_layout(ds: xr.Dataset, max_points: int = MAX_POINTS, degrees: bool | None = None) -> Layout:
    """Return the layout of a page, thinned to at most `max_points` points along the longest axes. Raise BadInput if `ds` has no axes."""
    check_not_empty(ds)
    single = POINT in ds.dims
    dims = (
        [POINT] if single else [str(dim) for dim in ds.dims if ds.sizes[dim] > 1 and is_numeric_axis(ds, dim)]
    )
    ds = ds.isel({dim: 0 for dim in ds.dims if ds.sizes[dim] == 1 and str(dim) not in dims})
    if not dims or set(map(str, ds.dims)) - set(dims):
        raise BadInput("page: this dataset has no axes to draw a map over")
    size = {dim: ds.sizes[dim] for dim in dims}
    stride = dict.fromkeys(dims, 1)
    while np.prod([-(-size[dim] // stride[dim]) for dim in dims]) > max_points:
        longest = max(dims, key=lambda dim: -(-size[dim] // stride[dim]))
        stride[longest] += 1
    part = (ds.isel({POINT: slice(None, None, stride[POINT])}) if single else in_order(ds, stride)).load()
    problem = scene_problem(ds, part)
    scene = None if problem else scene_of(ds)
    longest_two = sorted(dims, key=lambda dim: -part.sizes[dim])[:2]
    axes = scatter_axes(part, None, None) if single else [dim for dim in dims if dim in longest_two]
    panel_dims = [] if single else [dim for dim in dims if dim not in axes]
    left_out: list[str] = []
    for dim, k in stride.items():
        if k > 1:
            ending = "th" if k % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(k % 10, "th")
            what = "point" if dim == POINT else f"value of {axis_label(ds, dim, unit=False)}"
            left_out.append(f"{k}{ending} {what}")
    counts = f"{math.prod(part.sizes[dim] for dim in dims)} of {math.prod(size.values())} points"
    notes = [f"This page shows every {' and '.join(left_out)}: {counts}."] if left_out else []
    notes += [f"No theory in this page: {problem}"] if problem else []
    return Layout(ds, part, scene, problem, dims, axes, panel_dims, single, notes, degrees)
