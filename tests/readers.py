"""Functions that read a figure as a person does: entry of the legend at a place, number at a place, lines of an entry."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch


def entries(figure: Figure) -> dict[str, Artist]:
    """Handles of the legends of a figure, by their texts."""
    legends = [*figure.legends, *(legend for sub in figure.subfigs for legend in sub.legends)]
    legends += [legend for ax in figure.axes if (legend := ax.get_legend())]
    return {
        text.get_text(): sample
        for legend in legends
        for text, sample in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }


def heading(figure: Figure) -> str:
    """Title of the only legend."""
    (legend,) = figure.legends
    return legend.get_title().get_text()


def colours(figure: Figure) -> dict[str, str]:
    """Colour of an area in the legend -> its text; areas of hatching alone are left out."""
    areas = {text: sample for text, sample in entries(figure).items() if isinstance(sample, Patch)}
    return {to_hex(s.get_facecolor()): text for text, s in areas.items() if s.get_facecolor()[3] > 0}


def mesh_of(ax: Axes) -> QuadMesh:
    """The cells of a map; of several layers the lowest one."""
    return next(each for each in ax.collections if isinstance(each, QuadMesh))


def cell(ax: Axes, x: float, y: float) -> tuple[int, int]:
    """Row and column of the cell of a map at a place."""
    corners = mesh_of(ax).get_coordinates()
    column, row = (np.searchsorted(edge, v) - 1 for edge, v in ((corners[0, :, 0], x), (corners[:, 0, 1], y)))
    return int(row), int(column)


def number_at(ax: Axes, x: float, y: float) -> float:
    """Number at a place of a map."""
    return float(np.ma.filled(mesh_of(ax).get_array(), np.nan)[cell(ax, x, y)])


def colour_at(ax: Axes, x: float, y: float) -> str:
    """Colour at a place of a map."""
    mesh = mesh_of(ax)
    return to_hex(mesh.cmap(mesh.norm(number_at(ax, x, y))))


def hatched(ax: Axes, x: float, y: float) -> str:
    """Hatching at a place of a map, "" for none."""
    regions = [each for each in ax.collections if isinstance(each, PathCollection) and each.get_hatch()]
    inside = [r.get_hatch() for r in regions if any(p.contains_point((x, y)) for p in r.get_paths())]
    return "".join(inside)


def dashes(line: Line2D | Patch) -> list[float]:
    """Lengths of the dashes and gaps of a line, in units of its width; empty for none."""
    return [round(length, 3) for length in line._unscaled_dash_pattern[1] or []]


def look(line: Line2D) -> tuple[object, ...]:
    """Colour, dashes and marker of a line, by which a legend names it."""
    marker = line.get_marker()
    drawn = None if line.get_linestyle() == "None" else dashes(line)
    face = "" if marker in ("None", None) else to_hex(line.get_markerfacecolor())
    return to_hex(line.get_color()), drawn, marker, face


def lines_of(figure: Figure, ax: Axes, text: str) -> list[np.ndarray]:
    """Vertices of the lines with the look of the legend entry whose text begins with `text`."""
    (sample,) = (sample for entry, sample in entries(figure).items() if entry.startswith(text))
    assert isinstance(sample, Line2D)
    return [line.get_xydata() for line in ax.lines if look(line) == look(sample) and line.get_xydata().size]
