"""What is drawn over the cells of a map: hatching, and lines of theory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from ..analysis import resonances
from ..analysis.count_borders import CHANGE
from ..analysis.theory_borders import EXISTENCE, KINDS, LABEL, STABILITY
from ..systems.base import Mask
from .content import NOT_YET, SLOW, Panel

# Dashes of borders and of families, in the order of their names.
BORDERS: dict[str, dict[str, Any]] = {
    STABILITY: {"linestyle": "-", "linewidth": 1.2},
    LABEL: {"linestyle": (0, (5, 1.5)), "linewidth": 1.0},
    EXISTENCE: {"linestyle": "-", "linewidth": 0.6},
    CHANGE: {"linestyle": "-", "linewidth": 0.6},
    **{
        kind: {"linestyle": "-", "linewidth": 0.8, "color": colour}
        for kind, colour in zip(resonances.KINDS, ("#d62728", "#2ca02c", "#9467bd"), strict=True)
    },
}
ZERO_RATE: dict[str, Any] = {"linestyle": (0, (1.5, 1.2)), "linewidth": 1.0}
DASHES: tuple[Any, ...] = ((0, (8, 2)), ":", "-.", "--", (0, (6, 1, 1, 1, 1, 1)))
# The halo keeps lines visible on dark colours; it must not hide a strip of cells beside the line.
HALO = 0.35  # points on each side


@dataclass(frozen=True)
class Hatch:
    """Hatching of a region."""

    pattern: str
    colour: str
    background: str


UNDECIDED = "undecided"
HATCHES = {
    UNDECIDED: Hatch("\\\\\\\\\\\\", "0.9", "none"),
    SLOW: Hatch("//////", "#262626", "none"),
    NOT_YET: Hatch("xxxxx", "0.65", "0.92"),
}


def border_style(kind: str) -> dict[str, Any]:
    """Line of a kind of border, one of `atlas.analysis.theory_borders.KINDS`."""
    return {"color": "black"} | BORDERS.get(kind, ZERO_RATE)


def family_style(number: int) -> dict[str, Any]:
    """Line of the family with this number among those of the system."""
    return {"color": "black", "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.0}


def draw_overlay(ax: Axes, panel: Panel, edges: list[np.ndarray], families: Sequence[str]) -> None:
    """Draw hatching and theory over the cells of a panel."""
    for what, mask in ((NOT_YET, panel.white.get(NOT_YET)), (SLOW, panel.slow)):
        if mask is not None and mask.any():
            draw_hatching(ax, np.atleast_2d(mask), edges, HATCHES[what])
    for kind in (CHANGE, *resonances.KINDS, *KINDS[::-1]):
        _draw_lines(ax, panel.borders.get(kind, []), border_style(kind))
    for name, lines in panel.families.items():
        _draw_lines(ax, lines, family_style(families.index(name)))


def draw_hatching(ax: Axes, mask: Mask, edges: list[np.ndarray], hatch: Hatch) -> None:
    """Hatch the marked cells, one rectangle for each run of them along x."""
    x, y = edges[0], edges[1]
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(steps == 1)
    stop = np.nonzero(steps == -1)[1]
    left, right, bottom, top = x[start], x[stop], y[row], y[row + 1]
    corners = np.stack([left, bottom, right, bottom, right, top, left, top], -1).reshape(-1, 4, 2)
    ax.add_collection(
        PolyCollection(
            list(corners), facecolors=hatch.background, edgecolors=hatch.colour, hatch=hatch.pattern,
            linewidths=0, zorder=1.5, rasterized=True,
        ),
        autolim=False,
    )  # fmt: skip


def _draw_lines(ax: Axes, lines: list[np.ndarray], line: dict[str, Any]) -> None:
    """Draw lines over dark and bright colours alike.

    The halo is white: beside the line, in the gaps of a dashed one, and below every line so that none is cut where
    they cross.
    """
    halo = line | {"color": "white", "linestyle": "-", "linewidth": line["linewidth"] + 2 * HALO}
    for vertices in lines:
        for zorder, style in ((2.0, halo), (2.1, line)):
            if vertices.shape[1] == 1:
                ax.axvline(float(vertices[0, 0]), zorder=zorder, **style)
            else:
                ax.plot(vertices[:, 0], vertices[:, 1], zorder=zorder, scalex=False, scaley=False, **style)
