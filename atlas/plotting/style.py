"""Style of the figures: sizes, fonts, colours, saving."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ..files import atomic_write, writable
from ..scene.checks import choice

Width = Literal["column", "page"]
WIDTHS = {"column": 88.0, "page": 180.0}  # mm, one and two columns of a journal
FORMATS = (".png", ".pdf", ".svg")
FONT = "DejaVu Sans"  # comes with Matplotlib: the same everywhere
STYLE: dict[Any, Any] = {
    "font.family": [FONT],
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
    "hatch.linewidth": 0.4,
}
# One colour per meaning; colour-blind readers and prints in grey keep them apart.
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
    "steady": "#76b0d8",
    "regular": "#f2d49a",
    "chaotic": "#4e1b04",
    "undecided": "#848484",
    "hyperbolic": "#155a8e",
    "unknown": "#ffffff",
    "stable": "#a8d8f0",
    "unstable": "#e0892b",
    "energy_stable": "#1b6ca8",
    "gyroscopic": "#a8d8f0",
    "marginal": "#1c0a02",
    "linearly_stable": "#1f4a36",
    "yes": "#1b6ca8",
    "no": "#e0892b",
    "false": "#a8d8f0",
    "true": "#1b6ca8",
}
# Flags for which one colour map from blue to yellow has enough shades.
MAX_EVEN_SHADES = 11
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
    """Colours of flags, in order of value: COLOURS, then even steps of luminance from white."""
    names = list(meanings)
    # Both begin with white, beyond the light end of the colour map; the second map has more distinct colours.
    few = len(names) <= MAX_EVEN_SHADES
    shades = colormaps["cividis" if few else "magma"](
        np.linspace(*((1.1, 0.0) if few else (1.06, 0.03)), len(names))
    )
    return {
        name: COLOURS.get(name, "#ffffff" if i == 0 else to_hex(shades[i])) for i, name in enumerate(names)
    }


class PrintFigure(Figure):
    """A figure that `savefig` writes in the style of this module and at the resolution of the figure."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure as Matplotlib does; letters that FONT does not have are drawn as boxes."""
        with rc_context(STYLE), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from")
            super().savefig(fname, **{"dpi": self.dpi} | options)


def check_width(width: str) -> None:
    """Raise BadInput unless the width is one of WIDTHS."""
    choice("width", width, WIDTHS)


def save(figure: Figure, path: str | Path, dpi: float | None = None) -> None:
    """Write a figure as PNG, PDF or SVG (else BadInput), with reproducible bytes, all of it or nothing."""
    path = writable(path, FORMATS, force=True)
    kind = path.suffix.lower()[1:]
    # No date in the file, so that the same atlas gives the same bytes.
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    content = io.BytesIO()  # Matplotlib raises odd errors where it cannot write a file
    with rc_context(STYLE):
        figure.savefig(content, format=kind, metadata=undated, dpi=dpi or STYLE["savefig.dpi"])
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())
