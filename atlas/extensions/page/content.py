"""What a page shows, as a table that JSON can hold."""

from __future__ import annotations

import base64
import math
import shlex
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rcParams
from matplotlib.colors import to_hex

from ...analysis.boundary import EXISTENCE, STABILITY, theory_lines
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
from ...plotting.cells import ColorScale, color_scale
from ...plotting.content import MOTIONS, NO_VALUE, NOT_YET, SLOW, MapOptions, Panel, panel_of, tiles_done
from ...plotting.maps import as_math, scatter_axes
from ...plotting.style import axis_label, caption, flag_colours, unit_text, variable_label
from ...scene.model import Scene
from ...systems.base import System, derived_variables
from ...variables import POINT, data_variables
from . import motion
from .text import plain, runs

THEORY = (
    "predicted", "predicted_inertial", "agreement", "stable", "growth_rate", "family", "condition_residual",
    "energy_stable", "frequency_1", "frequency_2", "frequency_3",
)  # fmt: skip
NUMERICS = ("status", "computed", "error_estimate", "step", "step_ratio", "integral_drift", "end_time")
# Theory is drawn for at most this many values of the further axes together: each takes some seconds.
MAX_SLICES = 24
SHADES = 256
HATCHED = {"slow": SLOW, "undecided": cells.UNDECIDED, "notYet": NOT_YET}  # regions that are hatched


class Content:
    """The table of a page; `file` is the atlas in the commands that the page shows."""

    def __init__(self, layout: Layout, file: str):
        self.layout, self.file = layout, file
        self.ds, self.scene = layout.ds, layout.scene
        self.system: System = system_of(layout.ds)
        self.registry = data_variables(self.system)
        self.store = Store(layout.shape)
        self.notes = list(layout.notes)
        if "atlas_scene" not in self.ds.attrs:
            self.notes.append("The scene of this atlas is missing: motions start without its nudge.")
        self.shades: dict[str, list[str]] = {}

    def table(self, motions: Mapping[str, Any]) -> dict[str, Any]:
        """The whole table; motions: `motion_table`, or {"fault": why there is none}."""
        attributes = self.ds.attrs
        axes = self.coordinates() if self.layout.points else [self.axis(dim) for dim in self.layout.dims]
        variables = self.variables()
        theory = self.theory()
        if (tiles := tiles_done(self.ds)) is not None:
            self.notes.append(f"Unfinished: {tiles[0]} of {tiles[1]} tiles are computed.")
        if "computed" in self.ds and not self.layout.points:
            self.notes.append("Between the points that were integrated: the value of the nearest one.")
        return {
            "title": attribute_text(attributes, "title", "Atlas"),
            "system": self.system.title,
            "frame": self.system.frame,
            "reference": attribute_text(attributes, "references", limit=MAX_MESSAGE),
            "caption": caption(self.layout.whole) if not self.layout.points else "",
            "notes": [runs(note) for note in self.notes],
            "points": self.layout.points,
            "shape": self.layout.shape,
            "axes": axes,
            "variable": map_variable(self.layout.whole),
            "map": [self.layout.axes.index(dim) if self.layout.points else self.layout.dims.index(dim)
                    for dim in self.layout.axes],
            "variables": variables,
            "shades": self.shades,
            "theory": theory,
            "motion": motions,
            "commands": self.commands(),
            "arrays": self.store.packed(),
        }  # fmt: skip

    def axis(self, dim: str) -> dict[str, Any]:
        """An axis of the atlas."""
        label = axis_label(self.ds, dim)
        symbol = axis_label(self.ds, dim, unit=False)
        if dim in self.system.parameters:
            symbol = self.system.parameters[dim].symbol or dim
        attributes, symbol_runs = self.ds[dim].attrs, runs(symbol)
        for number, run in enumerate(symbol_runs):
            before, equals, _ = run["t"].partition(" = ")
            if equals:  # the name that a formula such as K1 = (C - A)/B defines
                name = [*symbol_runs[:number], {**run, "t": before}]
                if all(each["t"].isalnum() or not each["t"] for each in name):
                    symbol_runs = name
                break
        return {
            "name": dim,
            "label": runs(label),
            "plain": plain(label),
            "symbol": symbol_runs,
            "text": attribute_text(attributes, "long_name", dim),
            "unit": runs(unit_text(attribute_text(attributes, "units"))),
            # JSON has no nan.
            "values": [
                x if math.isfinite(x) else None for x in self.ds[dim].values.astype(np.float64).tolist()
            ],
            "log": is_logarithmic(self.scene, dim, self.ds[dim].values),
        }

    def coordinates(self) -> list[dict[str, Any]]:
        """Coordinates of single points that differ among them, axes of the map first."""
        columns = {name: self.ds[name].values for name in numeric_coordinates(self.ds, POINT)}
        names = self.layout.axes + [
            name
            for name, values in columns.items()
            if name not in (*self.layout.axes, POINT)
            and printable(name, MAX_TEXT) == name
            and np.unique(values[np.isfinite(values)]).size > 1
        ]
        return [self.axis(name) for name in names]

    def variables(self) -> list[dict[str, Any]]:
        """Variables of the atlas over its points, in the order of the file."""
        shown = []
        for name, array in self.ds.data_vars.items():
            usable = (
                set(array.dims) <= set(self.layout.dims)
                and array.dtype.kind in "biuf"
                and not is_averaged(array)
                and printable(str(name), MAX_TEXT) == name
            )
            if usable and array.dims:
                shown.append(self.variable(str(name)))
        if not shown:
            raise BadInput("page: this dataset has no variables over its axes")
        return shown

    def variable(self, name: str) -> dict[str, Any]:
        """One variable with its values, colours and texts."""
        array = self.ds[name]
        flags = flag_names(array)
        values = motion.over_points(self.filled(name), self.layout.sizes)
        label = variable_label(array)
        group = "numerics" if name in NUMERICS else "motion"
        if name in THEORY or name in derived_variables(self.system):
            group = "theory"
        lines = "inertial" if name.endswith("_inertial") else "frame"  # of theory, which belong on the map
        if name.removesuffix("_inertial") not in MOTIONS:
            lines = "limits"
        description: dict[str, Any] = {
            "name": name,
            "label": runs(label),
            "plain": plain(label),
            "text": attribute_text(array.attrs, "long_name"),
            "comment": attribute_text(array.attrs, "comment", limit=MAX_MESSAGE),
            "group": group,
            "lines": lines,
        }
        if flags:
            return description | self.flag_values(name, flags, values)
        scale = color_scale(array, MapOptions())
        return description | {"values": self.store.add(float_array(values)), "scale": self.scale(scale)}

    def flag_values(self, name: str, flags: list[str], values: np.ndarray) -> dict[str, Any]:
        """Values, colours and sentences of the flags of a variable."""
        registered = self.registry[name].flags if name in self.registry else None
        sentences = dict(registered) if registered is not None and list(registered) == flags else {}
        colours = flag_colours(flags)
        texts = cells.texts(self.scene) if name == "regularity" else {}
        table: dict[str, Any] = {
            "flags": [
                {
                    "name": flag,
                    "text": texts.get(flag, flag.replace("_", " ")),
                    "sentence": sentences.get(flag, ""),
                    "colour": to_hex(colours[flag]),
                    "hatched": flag == cells.UNDECIDED,
                }
                for flag in flags
            ],
            "values": self.store.add(values.astype(np.int8)),
        }
        scale = cells.exponent_scale(self.ds, name)
        if scale is not None:
            table["shaded"] = {"flag": int(Regularity.CHAOTIC), "by": "lyapunov", "scale": self.scale(scale)}
        return table

    def filled(self, name: str) -> xr.DataArray:
        """Values; where a refined atlas did not integrate, of the nearest point, as on maps."""
        array = self.ds[name]
        if "computed" not in self.ds or flag_names(array) or self.layout.points:
            return array
        values = np.array(array.transpose(*self.layout.dims).values)
        axes = [dim for dim in self.layout.dims if dim in self.layout.axes]
        for where, part in self.layout.slices():
            panel = panel_of(part, name, self.layout.axes, self.scene, False)
            values[where] = panel.array.transpose(*axes).values
        return xr.DataArray(values, dims=self.layout.dims)

    def scale(self, scale: ColorScale) -> dict[str, Any]:
        """A colour scale: its kind, ends and shades."""
        name = scale.colormap.name
        if name not in self.shades or scale.integers:
            count = scale.colormap.N if scale.integers else SHADES
            shades = [to_hex(colour)[1:] for colour in scale.colormap(np.linspace(0.0, 1.0, count))]
            name = f"{name} {len(self.shades)}" if scale.integers else name
            self.shades[name] = shades
        low, high = float(scale.norm.vmin or 0.0), float(1.0 if scale.norm.vmax is None else scale.norm.vmax)
        kind = "integers" if scale.integers else "log" if scale.log_range is not None else "linear"
        return {"kind": kind, "low": low, "high": high, "shades": name}

    def theory(self) -> dict[str, Any]:
        """Lines of theory, slow and white points; empty for single points."""
        if self.layout.points:
            return {"slices": [], "styles": {}, "white": [], "hatches": HATCHED}
        slices, panels = [], []
        count = math.prod(self.ds.sizes[dim] for dim in self.layout.further)
        name = "label" if "label" in self.ds else next(iter(map(str, self.ds.data_vars)))
        for _, part in self.layout.slices():
            panel = panel_of(part, name, self.layout.axes, self.scene, count <= MAX_SLICES)
            panels.append(panel)
            slices.append(self.lines(part, panel))
        if count > MAX_SLICES and self.scene is not None:
            self.notes.append(f"Lines of theory are left out: there are more than {MAX_SLICES} maps.")
        reasons = list(
            dict.fromkeys(reason for panel in panels for reason in panel.white if reason != NO_VALUE)
        )
        code = np.zeros(self.layout.shape, np.int8)
        for number, reason in enumerate(reasons, 1):
            code[self.over_slices([panel.white.get(reason) for panel in panels])] = number
        table = {"slices": slices, "styles": self.styles(slices), "white": reasons, "hatches": HATCHED}
        slow = self.over_slices([panel.slow for panel in panels])
        return table | {
            "reason": self.store.add(code),
            "slow": self.store.add(slow.astype(np.int8)),
            "slowText": SLOW,
        }

    def over_slices(self, masks: list[np.ndarray | None]) -> np.ndarray:
        """Masks of the panels, over all points."""
        whole = np.zeros(self.layout.shape, bool)
        order = self.layout.axes[::-1]  # a panel has its x axis last
        axes = [order.index(dim) for dim in self.layout.dims if dim in order]
        for (where, _), mask in zip(self.layout.slices(), masks, strict=True):
            if mask is not None:
                whole[where] = np.transpose(mask, axes)
        return whole

    def lines(self, part: xr.Dataset, panel: Panel) -> list[dict[str, Any]]:
        """Lines of theory of one panel: text, where they belong, vertices."""
        lines = [_line(kind, ["frame"], vertices) for kind, vertices in panel.borders.items()]
        for line in lines:
            if line["kind"] in (STABILITY, EXISTENCE):
                line["on"].append("limits")
        if panel.borders and self.scene is not None and "label_inertial" in self.ds:
            inertial = theory_lines(self.scene, part, self.layout.axes, "label_inertial")
            lines += [_line(kind, ["inertial"], vertices) for kind, vertices in inertial.items()]
        everywhere = ["frame", "inertial", "limits"]
        return lines + [
            _line(name, everywhere, vertices, "exact") for name, vertices in panel.families.items()
        ]

    def styles(self, slices: list[list[dict[str, Any]]]) -> dict[str, Any]:
        """Text, width and dashes of each kind of line."""
        families = list(self.system.families)
        named = {"-": (), ":": rcParams["lines.dotted_pattern"], "--": rcParams["lines.dashed_pattern"],
                 "-.": rcParams["lines.dashdot_pattern"]}  # fmt: skip
        styles: dict[str, Any] = {}
        for line in (line for each in slices for line in each):
            kind, exact = line["kind"], line["source"] == "exact"
            style = cells.family_style(families.index(kind)) if exact else cells.border_style(kind)
            dashes = style["linestyle"]  # a name, or a pattern in units of the width
            words = kind.replace("_", " ") if exact else as_math(kind)
            styles[kind] = {
                "text": runs(f"{words} ({line['source']})"),
                "width": style["linewidth"],
                "dashes": [float(x) for x in (named[dashes] if isinstance(dashes, str) else dashes[1])],
            }
        return styles

    def motion_table(self) -> dict[str, Any]:
        """Starts of all points, and what belongs to their equations."""
        if self.layout.problem:
            raise BadInput(self.layout.problem)
        starts = motion.motions(self.ds, self.system, self.scene, self.layout.dims)
        add = self.store.add
        parameters = [
            {
                "name": name,
                "symbol": runs(parameter.symbol or name),
                "text": parameter.meaning,
                "unit": runs(unit_text(parameter.unit)),
                "values": add(starts.parameters[name]),
            }
            for name, parameter in self.system.parameters.items()
            if not np.isnan(starts.parameters[name]).all()
        ]
        return {
            "parameters": parameters,
            "states": list(self.system.equations.STATE),
            "state": [add(row) for row in starts.state],
            "constants": [add(row) for row in starts.constants],
            "duration": add(starts.duration),
            "steps": add(starts.steps.astype(np.int32 if starts.steps.max() < 2**31 else np.float64)),
            "reason": add(starts.reason.astype(np.int8)),
            "sentences": starts.sentences,
            "samples": motion.SAMPLES,
            "method": starts.method,
            "stepUnit": METHODS[starts.method].kernel_step,
            "frameAxes": [runs(axis) for axis in self.system.frame_axes],
            "observables": self.observables(),
        }

    def observables(self) -> list[dict[str, Any]]:
        """Observables of a system without a body in a frame: a state, or a function of the equations."""
        states = list(self.system.equations.STATE)
        shown = []
        for observable in self.system.observables:
            unit = unit_text(observable.unit)
            label = f"{observable.symbol or observable.name}{f' ({unit})' if unit else ''}"
            state = states.index(observable.name) if observable.name in states else None
            shown.append({"name": observable.name, "label": runs(label), "state": state})
        return shown

    def commands(self) -> dict[str, Any]:
        """Beginnings of the command and of the Python line that integrate a point, and the values that name it."""
        names: dict[str, str] = {}
        if self.scene is not None:
            names = {dim: axis.name for dim, axis in axes_of(self.scene).items()}
        elif not self.layout.problem:
            names = {axis: axis for axis in map(str, self.ds.coords) if axis in self.system.parameters}
        coordinates = []
        for dim, name in names.items():
            values = np.asarray(self.ds[dim].values, np.float64)
            along = xr.DataArray(values, dims=self.ds[dim].dims)
            column = self.store.add(motion.over_points(along, self.layout.sizes))
            if self.scene is None and not column["over"]:
                continue  # the same at all points
            coordinates.append({"name": name, "dim": dim, "values": column})
        return {
            "shell": f"atlas trajectory {shlex.quote(self.file)} --at",
            "python": f"atlas.open_atlas({self.file!r}).atlas.trajectory",
            "places": coordinates,
        }


def _line(kind: str, on: list[str], vertices: list[np.ndarray], source: str = "theory") -> dict[str, Any]:
    """Vertices of a line with six digits; nan cuts a curve."""
    paths = [
        [[float(f"{x:.6g}") if math.isfinite(x) else None for x in vertex] for vertex in line]
        for line in vertices
    ]
    return {"kind": kind, "on": on, "source": source, "paths": paths}


# Types of JavaScript's typed arrays, by their names there.
_TYPES = {"int8": "Int8Array", "int32": "Int32Array", "float32": "Float32Array", "float64": "Float64Array"}
_LEVEL = 9


class Store:
    """Arrays over the points of an atlas, each stored once; nbytes is their size before compression."""

    def __init__(self, shape: tuple[int, ...]):
        self.shape = shape
        self.nbytes = 0
        self._arrays: list[np.ndarray] = []
        self._numbers: dict[tuple[str, bytes], int] = {}

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Keep an array over the points: the number of its entry, and the axes along which it varies."""
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

    def packed(self) -> list[dict[str, Any]]:
        """Type in JavaScript, size and data of each array: in base64, by zlib, all first bytes first."""
        entries = []
        for array in self._arrays:
            little = array.astype(array.dtype.newbyteorder("<"))
            columns = little.view(np.uint8).reshape(array.size, array.itemsize).T
            compressed = zlib.compress(np.ascontiguousarray(columns).tobytes(), _LEVEL)
            data = base64.b64encode(compressed).decode("ascii")
            entries.append({"type": _TYPES[array.dtype.name], "size": array.size, "data": data})
        return entries


def float_array(values: np.ndarray) -> np.ndarray:
    """Numbers as float32, seven digits; as float64 where their magnitudes need it."""
    values = np.asarray(values, np.float64)
    size = np.abs(values[np.isfinite(values) & (values != 0.0)])
    fits = not size.size or bool(size.max() < 1e38 and size.min() > 1e-37)
    return values.astype(np.float32) if fits else values


MAX_POINTS = 120_000
# Bytes of numbers before compression: about as many in the page, because base64 loses what compression gains.
MAX_BYTES = 12_000_000


@dataclass(frozen=True)
class Layout:
    """Axes and points of a page."""

    whole: xr.Dataset  # the atlas
    ds: xr.Dataset  # the points that are shown, in memory, sorted along their axes
    scene: Scene | None  # scene of the atlas, from which theory and motions follow
    problem: str  # why there is none, of an atlas that names one
    dims: list[str]  # dimensions of the points, in the order of the atlas
    axes: list[str]  # one or two axes of the map, x first, or two coordinates of single points
    further: list[str]  # the other dimensions
    points: bool  # whether these are single points without axes
    notes: list[str]  # sentences about what is left out

    @property
    def sizes(self) -> dict[str, int]:
        """Number of values along each dimension of the points."""
        return {dim: self.ds.sizes[dim] for dim in self.dims}

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the points."""
        return tuple(self.sizes.values())

    def slices(self) -> Iterator[tuple[tuple[int | slice, ...], xr.Dataset]]:
        """Each map: the index of its points in an array over all points, and the part of the atlas that it shows."""
        for index in np.ndindex(*(self.ds.sizes[dim] for dim in self.further)):
            along = dict(zip(self.further, index, strict=True))
            yield tuple(along.get(dim, slice(None)) for dim in self.dims), self.ds.isel(along)


def layout(ds: xr.Dataset, max_points: int = MAX_POINTS) -> Layout:
    """What a page shows: every k-th value of the longest axes, at most max_points; BadInput without axes."""
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
    shown = ds.isel({POINT: slice(None, None, stride[POINT])}) if single else in_order(ds, stride)
    shown = shown.load()
    problem = scene_problem(ds, shown)
    scene = None if problem else scene_of(ds)
    longest_two = sorted(dims, key=lambda dim: -shown.sizes[dim])[:2]
    axes = scatter_axes(shown, None, None) if single else [dim for dim in dims if dim in longest_two]
    further = [] if single else [dim for dim in dims if dim not in axes]
    left_out: list[str] = []
    for dim, k in stride.items():
        if k > 1:
            ending = "th" if k % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(k % 10, "th")
            what = "point" if dim == POINT else f"value of {axis_label(ds, dim, unit=False)}"
            left_out.append(f"{k}{ending} {what}")
    counts = f"{math.prod(shown.sizes[dim] for dim in dims)} of {math.prod(size.values())} points"
    notes = [f"This page shows every {' and '.join(left_out)}: {counts}."] if left_out else []
    notes += [f"No theory in this page: {problem}"] if problem else []
    return Layout(ds, shown, scene, problem, dims, axes, further, single, notes)
