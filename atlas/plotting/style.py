"""Style of the figures: sizes, fonts, colours, saving."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ..errors import BadInput
from ..files import check_folder

Width = Literal["column", "page"]
WIDTHS = {"column": 88.0, "page": 180.0}  # mm, one and two columns of a journal
FORMATS = (".png", ".pdf", ".svg")
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same everywhere
    "mathtext.fontset": "dejavusans",
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,
    "savefig.dpi": 600,
    "svg.hashsalt": "atlas",
}
# Safe for colour-blind readers and, by their luminance, readable in grey: one colour per meaning.
COLOURS = {
    "not_computed": "#ffffff",
    "permanent_rotation": "#a8d8f0",
    "drifting": "#e0892b",
    "regular_precession": "#1b6ca8",
    "unresolved": "#262626",
    "not_compared": "#ffffff",
    "agree": "#b9e3cc",
    "theory_only": "#e0892b",
    "numerics_only": "#1b6ca8",
    "differ": "#262626",
    "unknown": "#ffffff",
    "stable": "#a8d8f0",
    "unstable": "#e0892b",
}
SYMBOLS = {
    "theta": r"$\theta$",
    "psi": r"$\psi$",
    "phi": r"$\varphi$",
    "theta_dot": r"$\dot\theta$",
    "psi_dot": r"$\dot\psi$",
    "phi_dot": r"$\dot\varphi$",
    "normal_rate": r"$\omega'\cdot\gamma$",
}


def flag_colours(meanings: Iterable[str]) -> dict[str, str]:
    """A colour for each flag of a variable, the same in every figure: the first is white."""
    names = list(meanings)
    # even steps of luminance from white, which continues the map beyond its light end
    shades = colormaps["cividis"](np.linspace(1.1, 0.0, len(names)))
    return {
        name: COLOURS.get(name, "#ffffff" if i == 0 else to_hex(shades[i])) for i, name in enumerate(names)
    }


def unit_text(unit: str) -> str:
    """A unit in UDUNITS spelling for print, with raised exponents; empty for pure numbers."""
    if unit in ("", "1"):
        return ""
    return re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", unit)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG (600 dpi), PDF or SVG by the suffix of its name, and move it into place.

    Raises BadInput for another suffix and for a place that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise BadInput(f"{path}: a figure's name ends in {', '.join(FORMATS)}")
    check_folder(path)
    kind = path.suffix.lower()[1:]
    # no date, so that the same atlas gives the same file
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with rc_context(STYLE):
            figure.savefig(temporary, format=kind, metadata=undated)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
