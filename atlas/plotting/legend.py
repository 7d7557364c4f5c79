"""Legend of a map: the regions and lines that are visible; a note lists the others."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..systems.base import Mask
from .content import NOT_YET, SLOW, Panel, visible
from .options import MapOptions
from .overlay import HATCHES, UNDECIDED, border_style, family_style
from .style import SYMBOLS

Entries = dict[str, Artist]


def map_legend(
    panels: Sequence[Panel], flags: Mapping[str, str], options: MapOptions, families: Sequence[str]
) -> tuple[Entries, list[str]]:
    """Entries of a legend, and notes about regions that are too small to be visible.

    panels: content of the map; flags: flags of the variable, in the order of their values, and their colours;
    options: choices of the caller; families: all families of the system, in order. Returns entries, text ->
    sample of the colour, hatching or line; notes, sentences.
    """
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
