"""The figure of a map: its size, panels, legend, title and notes."""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .legend import Entries, draw_legend, legend_rows
from .options import MapOptions
from .style import PrintFigure
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
        """The figure with empty panels, and with its legend, title and notes.

        legend: entries of the legend. notes: sentences at the foot of the figure; where the Axes are the
        caller's they go to the log. Returns axes, one for each panel.
        """
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
