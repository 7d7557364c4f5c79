"""The figure of a map: its size, panels, legend, title and notes."""

from __future__ import annotations

import logging
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..systems.base import Mask
from .cells import HATCHES, UNDECIDED, border_style, family_style
from .content import NOT_YET, SLOW, Panel, visible
from .options import MapOptions
from .style import SYMBOLS, PrintFigure
from .text import drawable

LEGEND_ROW, TEXT_ROW = 4.0, 2.8  # height in mm


@dataclass(frozen=True)
class Sheet:
    """A figure with panels in rows, or the Axes of the caller."""

    options: MapOptions  # choices of the caller
    panels: int  # how many panels
    flat: bool = False  # whether the panels are strips, with one axis
    line: bool = False  # whether they are lines over one axis

    @property
    def columns(self) -> int:
        """Panels in a row."""
        return min(self.panels, 2 if self.options.size_mm[0] < 130 else 4)

    def figure(self, legend: Entries, notes: Sequence[str]) -> tuple[Figure, list[Axes]]:
        """The figure with empty panels, legend, title and notes; notes on the caller's Axes are logged."""
        options = self.options
        legend = legend if options.legend else {}
        if options.ax is not None:
            return self._of_caller(options.ax, legend, notes)
        width, height = options.size_mm
        text = drawable(textwrap.fill(" ".join(notes), int(0.78 * width))) if notes else ""
        foot = TEXT_ROW * (text.count("\n") + 1) + 2.0 if text else 0.0
        rows = -(-self.panels // self.columns)
        if height is None:
            height = rows * self._panel_height() + foot + 9.0
            height += LEGEND_ROW * legend_rows(legend, width) + (5.0 if options.title else 0.0)
        figure = PrintFigure(
            figsize=(width / 25.4, height / 25.4), layout="constrained", dpi=float(options.dpi)
        )
        engine = figure.get_layout_engine()
        assert engine is not None
        engine.set(rect=(0, foot / height, 1, 1 - foot / height), w_pad=0.02, h_pad=0.02)  # type: ignore[call-arg]
        if text:
            figure.text(1.5 / width, 1.0 / height, text, fontsize=6.5, va="bottom", ha="left")
        axes = list(figure.subplots(rows, self.columns, sharex=True, sharey=True, squeeze=False).ravel())
        for unused in axes[self.panels :]:
            unused.remove()
        if legend:
            draw_legend(figure, legend, width, options.title)
        elif options.title:
            figure.suptitle(options.title, fontsize=9)
        return figure, axes[: self.panels]

    def _of_caller(self, ax: Axes, legend: Entries, notes: Sequence[str]) -> tuple[Figure, list[Axes]]:
        """The caller's Axes, with a legend inside and a title above them."""
        figure = ax.get_figure(root=True)
        assert figure is not None
        if legend:
            draw_legend(ax, legend, 0.0)
        if self.options.title:
            ax.set_title(self.options.title)
        for note in notes:
            logging.getLogger("atlas").info("%s", note)
        return figure, [ax]

    def _panel_height(self) -> float:
        """Height of a row of panels in mm."""
        width = self.options.size_mm[0]
        if self.line:
            return 0.6 * width / self.columns
        if self.flat:
            return 18.0
        if self.panels == 1:
            return (0.5 if width >= 130 else 0.72) * width
        return 0.72 * width / self.columns + 6.0  # with a title above each panel

    def label_axes(self, axes: list[Axes], labels: list[str]) -> None:
        """Label the axes: of a single panel its own, of several panels once for all of them."""
        figure = axes[0].get_figure(root=True)
        if self.panels == 1:
            axes[0].set_xlabel(labels[0])
            if len(labels) == 2:
                axes[0].set_ylabel(labels[1])
        elif figure is not None:
            figure.supxlabel(labels[0], fontsize=8)
            if len(labels) == 2:
                figure.supylabel(labels[1], fontsize=8)
        for ax in axes[-self.columns :]:  # nothing is below them
            ax.tick_params(labelbottom=True)


Entries = dict[str, Artist]


def map_legend(
    panels: Sequence[Panel], flags: Mapping[str, str], options: MapOptions, families: Sequence[str]
) -> tuple[Entries, list[str]]:
    """Legend (text -> sample of colour, hatching or line), and notes about regions too small to see."""
    entries, too_small = _regions(panels, flags, options)
    for kind in dict.fromkeys(kind for panel in panels for kind in panel.borders):
        entries[f"{as_math(kind)} (theory)"] = Line2D([], [], **border_style(kind))
    for name in dict.fromkeys(name for panel in panels for name in panel.families):
        entries[f"{name.replace('_', ' ')} (exact)"] = Line2D([], [], **family_style(families.index(name)))
    return entries, [f"Too few to be seen: {'; '.join(too_small)}."] if too_small else []


def _regions(
    panels: Sequence[Panel], flags: Mapping[str, str], options: MapOptions
) -> tuple[Entries, list[str]]:
    """Entries of the visible regions, and sentences with the number of points of the others."""
    total = sum(panel.array.size for panel in panels)
    entries: Entries = {}
    too_small = []
    for text, masks, sample in _candidates(panels, flags, options):
        count = sum(int(mask.sum()) for mask in masks)
        if any(visible(mask) for mask in masks):
            entries[text] = sample
        elif count and text != SLOW:
            too_small.append(f"{text}, {count} of {total} points")
    return entries, too_small


def _candidates(
    panels: Sequence[Panel], flags: Mapping[str, str], options: MapOptions
) -> Iterable[tuple[str, list[Mask], Artist]]:
    """Text, cells in each panel and sample of every region that a map may have."""
    reasons = list(dict.fromkeys(reason for panel in panels for reason in panel.white))
    empty = [np.zeros(panel.array.shape, bool) for panel in panels]
    white = [
        np.any([*panel.white.values(), nothing], axis=0) for panel, nothing in zip(panels, empty, strict=True)
    ]
    for value, (name, colour) in enumerate(flags.items()):
        masks = [(panel.array.values == value) & ~mask for panel, mask in zip(panels, white, strict=True)]
        sample = _hatched(name, colour) if name == UNDECIDED else _patch(colour)
        yield options.text(name, name.replace("_", " ")), masks, sample
    for reason in reasons:
        masks = [panel.white.get(reason, nothing) for panel, nothing in zip(panels, empty, strict=True)]
        yield reason, masks, _hatched(NOT_YET) if reason == NOT_YET else _patch("#ffffff")
    yield SLOW, [panel.slow for panel in panels], _hatched(SLOW)


def as_math(kind: str) -> str:
    """A kind of border with its rates as symbols."""
    for name, symbol in (("psi'", SYMBOLS["psi_dot"]), ("phi'", SYMBOLS["phi_dot"])):
        kind = kind.replace(f"{name} = 0", f"{symbol} = 0")
    return kind


def _patch(colour: str) -> Patch:
    """Sample of a colour."""
    return Patch(facecolor=colour, edgecolor="0.4", linewidth=0.4)


def _hatched(region: str, background: str | None = None) -> Patch:
    """Sample of the hatching of a region, a key of HATCHES."""
    hatch = HATCHES[region]
    return Patch(
        facecolor=background or hatch.background, edgecolor=hatch.colour, hatch=hatch.pattern, linewidth=0.4
    )


def draw_legend(target: Figure | Axes, entries: Entries, width: float, title: str | None = None) -> None:
    """Draw a legend above the panels of a figure, within a width in mm and below a title, or inside Axes."""
    handles, texts = list(entries.values()), list(entries)
    if isinstance(target, Figure):
        target.legend(
            handles, texts, loc="outside upper center", ncols=legend_columns(entries, width), frameon=False,
            handlelength=1.8, columnspacing=1.4, borderaxespad=0.2, title=title, title_fontsize=9,
        )  # fmt: skip
    else:  # there may be no room around the Axes of the caller
        target.legend(handles, texts, loc="upper right", fontsize="small", framealpha=0.85)


def legend_columns(entries: Iterable[str], width: float) -> int:
    """The most columns of a legend that fit a width in mm; entries fill one column after the other."""
    names = list(entries)
    for columns in range(len(names), 1, -1):
        longest = [max(map(_length, column)) for column in np.array_split(np.array(names, object), columns)]
        if sum(10.0 + 1.15 * length for length in longest) < width:
            return columns
    return 1


def _length(text: str) -> int:
    """Number of characters of a text as printed, a formula counting as one."""
    return len(re.sub(r"\$[^$]*\$", "x", text))


def legend_rows(entries: Iterable[str], width: float) -> int:
    """Rows of a legend within a width in mm."""
    names = list(entries)
    return -(-len(names) // legend_columns(names, width)) if names else 0
