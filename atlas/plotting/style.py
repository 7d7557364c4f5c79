"""Style of the figures (sizes, fonts, colours), and texts in the figures (labels, captions)."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.cbook import is_math_text
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.mathtext import MathTextParser
from matplotlib.textpath import text_to_path

from ..analysis.degrees import DEGREE
from ..analysis.latex import GREEK
from ..analysis.metadata import (
    axes_of,
    common_values,
    number_attribute,
    rate_tolerance_of,
    scene_of,
    scene_problem,
    system_of,
)
from ..errors import MAX_MESSAGE, attribute_text, printable
from ..files import FIGURES, atomic_write, writable
from ..scene.model import rate_text
from ..store.dataset import TRANSIENT
from ..systems.base import families_of
from .options import Width, width_mm

PRINT_DPI = 600
FONT = "DejaVu Sans"  # comes with Matplotlib, so that figures are the same everywhere
STYLE: dict[Any, Any] = {
    "font.family": [FONT],
    "mathtext.fontset": "dejavusans",
    "text.usetex": False,
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "figure.labelsize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,
    "savefig.dpi": PRINT_DPI,
    "svg.hashsalt": "atlas",
    "hatch.linewidth": 0.4,
}
# Flags with the same meaning have one colour. The colours of a variable differ for colour-blind readers and in grey prints too.
_FLAGS_OF_COLOUR = {
    "#ffffff": ("not_computed", "not_compared", "unknown"),
    "#a8d8f0": ("permanent_rotation", "stable", "gyroscopic", "arnold_moser", "false"),
    "#e0892b": ("drifting", "theory_only", "unstable", "linearly_unstable", "no"),
    "#1b6ca8": ("regular_precession", "numerics_only", "energy_stable", "energy", "yes", "true"),
    "#262626": ("unresolved", "differ"),
    "#b9e3cc": ("agree",),
    "#76b0d8": ("steady",),
    "#f2d49a": ("regular",),
    "#4e1b04": ("chaotic",),
    "#848484": ("undecided",),
    "#155a8e": ("hyperbolic",),
    "#1c0a02": ("marginal", "degenerate"),
    "#8fc4e4": ("resonance_stable",),
    "#8a2b0c": ("resonance_unstable",),
    "#1d513b": ("linearly_stable",),
    "#302251": ("energy_stable_axial",),
}
COLOURS = {flag: colour for colour, flags in _FLAGS_OF_COLOUR.items() for flag in flags}
# Colours of positions in a list. White is for no position, and the other colours, from Tol's scheme "muted", have no order.
QUALITATIVE = (
    "#ffffff", "#88ccee", "#cc6677", "#117733", "#ddcc77", "#332288", "#aa4499", "#44aa99", "#882255", "#999933",
)  # fmt: skip
# Largest number of flags for which Cividis, a colour map from blue to yellow, has enough shades.
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


def style(width: Width = "column") -> AbstractContextManager[None]:
    """Return a context in which Matplotlib makes and saves figures with the fonts, lines and sizes of this package.

    Parameters
    ----------
    width : {"column", "page"} or float, optional
        Width of new figures in mm, where "column" is 88 mm and "page" 180 mm (one or two columns of a journal).

    Returns
    -------
    contextlib.AbstractContextManager
        A context that changes the settings of Matplotlib and restores the settings at the end.

    Examples
    --------
    >>> with atlas.style("column"):
    ...     figure, ax = plt.subplots()
    ...     ax.plot(motion.time, motion.theta)
    ...     figure.savefig("theta.pdf")
    """
    size = width_mm(width) / 25.4
    return rc_context(STYLE | {"figure.figsize": (size, 0.72 * size), "figure.constrained_layout.use": True})


def flag_colours(meanings: Iterable[str]) -> dict[str, str]:
    """Return the colour of each flag. Numbered flags use QUALITATIVE if they are few. Other colours are chosen by name or luminance."""
    names = list(meanings)
    if names and len(names) <= len(QUALITATIVE) and all(name[-1].isdigit() for name in names[1:]):
        return dict(zip(names, QUALITATIVE, strict=False))
    # The first flag is white, so its shade may lie beyond the light end of the colour map. Magma has more distinct colours than cividis.
    few = len(names) <= MAX_EVEN_SHADES
    shades = colormaps["cividis" if few else "magma"](
        np.linspace(*((1.1, 0.0) if few else (1.06, 0.03)), len(names))
    )
    if len(names) > 12:  # no colour map has so many distinct luminances, so warm and cold greys alternate
        tint = 0.04 * (-1.0) ** np.arange(len(names))[:, None] * [1, 0, -1]
        shades = np.clip(np.linspace(1, 0.02, len(names))[:, None] + tint, 0, 1)
    return {
        name: COLOURS.get(name, "#ffffff" if i == 0 else to_hex(shades[i])) for i, name in enumerate(names)
    }


class PrintFigure(Figure):
    """Figure that `savefig` writes in the style of this module and at the resolution of the figure."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure as Matplotlib does. Letters that FONT does not have are drawn as boxes."""
        options = {"dpi": self.dpi} | options
        # Hinting would make letters at low resolutions wider than in the measured legend.
        hinting = (
            {} if options["dpi"] in (None, "figure") or options["dpi"] >= 300 else {"text.hinting": "none"}
        )
        with rc_context(STYLE | hinting), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from")
            super().savefig(fname, **options)


def save(figure: Figure, path: str | Path, dpi: float | None = None) -> None:
    """Write a figure, whole or not at all, as PNG, PDF or SVG with reproducible bytes. Other suffixes raise BadInput."""
    path = writable(path, FIGURES, force=True)
    kind = path.suffix.lower()[1:]
    # The file has no date, so that the same atlas gives the same bytes.
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    content = io.BytesIO()  # Matplotlib would raise odd errors for a file that cannot be written
    with rc_context(STYLE):
        figure.savefig(content, format=kind, metadata=undated, dpi=dpi or STYLE["savefig.dpi"])
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())


_PARSER = MathTextParser("path")
STATISTICS = {
    "mean": "mean", "rms": "rms", "std": "standard deviation of", "min": "least", "max": "largest", "drift": "drift of",
}  # fmt: skip

WORDS = {
    "lower": "lower 95 % limit of probability", "upper": "upper 95 % limit of probability",
    "lyapunov": "Lyapunov exponent", "megno": "MEGNO",
}  # fmt: skip


def axis_label(ds: xr.Dataset, dim: str, *, unit: bool = True) -> str:
    """Return the label of an axis, with the symbol from the registry or else the long_name of the axis, and the unit."""
    system, attributes = system_of(ds), ds[dim].attrs
    text = attribute_text(attributes, "long_name", dim)
    stem = dim.removesuffix("_offset")
    if dim in system.parameters and text == system.parameters[dim].meaning:
        text = system.parameters[dim].symbol or dim
    elif dim != stem and stem in system.parameters and "offset from the family" in text:
        text = f"{system.parameters[stem].symbol or stem}, offset from the family"
    else:
        text = math_text(text, {name: p.symbol for name, p in system.parameters.items()})
    units = unit_text(attribute_text(attributes, "units"))
    return drawable(f"{text} ({units})" if unit and units else text)


def drawable(text: str) -> str:
    """Return a text that is safe to draw, with `printable` lines of limited length.

    Dollar signs are escaped in lines that Matplotlib cannot read as formulas. Every text from outside passes through this function.
    """
    lines = [printable(line, MAX_MESSAGE) for line in text.split("\n")]
    for i, line in enumerate(lines):  # Matplotlib sets each line of a text by itself
        if "$" in line:
            font = get_font(findfont(FONT))
            try:
                if not all(font.get_char_index(ord(letter)) for letter in line):
                    raise ValueError("a letter is not in the font")
                _PARSER.parse(line)
            except (ValueError, RecursionError):
                lines[i] = line.replace("$", r"\$")
    return "\n".join(lines)


def wrapped(text: str, width: float, size: float, dpi: float) -> str:
    """Return a drawable text in lines of at most `width` mm, in letters of `size` pt, without breaks in formulas.

    Hinting changes the widths of letters with the resolution. Therefore lines fit at `dpi`, in print, and without hinting.
    """
    font, lines = FontProperties(family=FONT, size=size), list[str]()
    measures: list[tuple[Any, float]] = [(text_to_path, 72.0)]
    measures += [(RendererAgg(1, 1, each), each) for each in {dpi, PRINT_DPI}]

    @cache
    def widths(part: str) -> np.ndarray:
        """Return the widths of a part of a line in inches, one for each way of measuring."""
        is_math = is_math_text(part)
        return np.array(
            [m.get_text_width_height_descent(part, font, is_math)[0] / each for m, each in measures]
        )

    def fits(line: str) -> bool:
        """Whether a line fits by every way of measuring. The widths of words outside formulas are summed."""
        is_math = is_math_text(line)
        if is_math and 25.4 * len(line) * size / 72 <= width:
            return True  # The line fits, because formulas draw fewer letters than their texts have. Measuring would be slow.
        parts = [line] if is_math else re.findall(r" ?[^ ]+", line)
        return bool(25.4 * np.sum([widths(part) for part in parts], axis=0).max() <= width)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        for line in text.split("\n"):
            words = re.findall(r"(?:\\\$|\$[^$]*\$|[^\s$])+", line)
            lines.append(words.pop(0) if words else "")
            for word in words:
                longer = f"{lines[-1]} {word}"
                if fits(longer):
                    lines[-1] = longer
                else:
                    lines.append(word)
    return "\n".join(lines)


def math_text(text: str, symbols: Mapping[str, str]) -> str:
    """Return `text` with formulas and symbols in Matplotlib's mathematical notation.

    The whole text is one formula if all words are names or symbols. Formulas in other texts are names with a digit, Greek letters,
    and a parameter at the end of the text. A text with dollar signs is returned unchanged.
    """
    if "$" in text:
        return text

    def in_words(word: re.Match[str]) -> str:
        """Return a word as a formula if the word has a digit or is a Greek letter, and unchanged otherwise."""
        formula = _formula(word[0], symbols)
        is_name = word[0] in _LETTERS or any(c.isdigit() for c in word[0])
        return f"${formula}$" if formula and is_name else word[0]

    words = re.findall(_WORD, text)
    if words and all(_formula(word, symbols) for word in words):
        text = re.sub(_WORD, lambda word: _formula(word[0], symbols), text)
        text = re.sub(r"\*\*\s*(\w+)", r"^{\1}", text).replace(", ", r",\ ")
        text = re.sub(r"\s*\*\s*", r"\\,", text)
        return f"${re.sub(_PRODUCT, _THIN, text)}$"
    text = re.sub(_WORD, in_words, text)
    last = text.rpartition(" ")[2]  # a symbol may follow the words, as in "rate of precession n"
    return f"{text.removesuffix(last)}{symbols[last]}" if symbols.get(last) else text


_WORD = r"[A-Za-z_]\w*"
_PRODUCT, _THIN = r"(?<=[\w}]) (?=[\w\\])", r"\\,"
_LETTERS = {name: rf"\{name}" for name in GREEK} | {"eps": r"\epsilon", "phi": r"\varphi"}


def _formula(word: str, symbols: Mapping[str, str]) -> str:
    """Return a name in mathematical notation, or an empty text for a word that is no name."""
    if symbols.get(word):
        return symbols[word].strip("$")
    match = re.fullmatch(r"([A-Za-z]+?)_?(\d*)(_dot)?(\d*)", word)
    if match is None:
        return ""
    stem, index = match[1], match[2] or match[4]
    letter = _LETTERS.get(stem, stem if len(stem) == 1 else "")
    if not letter:
        return ""
    if match[3]:
        letter = rf"\dot{{{letter}}}"
    return f"{letter}_{{{index}}}" if index else letter


def variable_label(array: xr.DataArray, *, theory: bool = False) -> str:
    """Return the label of a variable. The label has words or a symbol, "theory" if `theory` is true, the unit, and texts of coordinates."""
    name, units = str(array.name), unit_text(attribute_text(array.attrs, "units"))
    stem, _, statistic = name.rpartition("_")
    text = WORDS.get(name, name.replace("_", " "))
    if stem in SYMBOLS and statistic in STATISTICS:
        text = f"{STATISTICS[statistic]} {SYMBOLS[stem]}"
    chosen = [
        f"{dim} = {c.item()}" for dim, c in array.coords.items() if not c.ndim and c.dtype.kind in "OSTU"
    ]
    brackets = ", ".join(filter(None, ["theory" * theory, units]))
    return drawable(", ".join([f"{text} ({brackets})" if brackets else text, *chosen]))


def unit_text(unit: str) -> str:
    """Convert a unit in UDUNITS spelling to a text for print with raised exponents. The text is empty for pure numbers."""
    if unit in ("", "1"):
        return ""
    if unit == DEGREE:
        return "deg"
    unit = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", unit)
    return drawable(re.sub(r"\bOmega\b", r"$\\Omega$", unit))


def caption(ds: xr.Dataset) -> str:
    """Return a caption in one line, which says what a figure of an atlas shows and how the atlas was computed."""
    system, attributes = system_of(ds), ds.attrs
    scene = None if scene_problem(ds) else scene_of(ds)
    sentences = [
        f"{attribute_text(attributes, 'title', 'Atlas')}: {system.title}"
        + (f", motion in the {system.frame} frame." if system.frame else ".")
    ]
    if scene is not None:
        dims = axes_of(scene)
        axes = [
            f"{dim} from {float(ds[dim].values.min()):.6g} to {float(ds[dim].values.max()):.6g} ({ds.sizes[dim]} values)"
            for dim in dims
            if dim in ds.dims
        ]
        parameters = [
            f"{name} = {value if isinstance(value, str) else f'{value:.6g}'}"
            for name, value in common_values(ds, scene).items()
        ]
        if axes:
            sentences.append(f"Axes: {', '.join(axes)}.")
        if parameters:
            sentences.append(f"Parameters: {', '.join(parameters)}; the others have their defaults.")
        if scene.family is not None:
            family = families_of(system)[scene.family]
            solved = f", {scene.solved_text}" if scene.solve else ""
            sentences.append(f"Starts on the family {family.name} [{family.equations}]{solved}.")
        if scene.nudge:
            nudge = ", ".join(f"{name} by {value:g}" for name, value in scene.nudge.items())
            sentences.append(f"Starts displaced from there: {nudge}.")
        sentences.append(f"Duration {scene.duration}{'' if scene.duration.unit else ' time units'}.")
    if TRANSIENT in attributes:
        sentences.append(f"After a transient of {attribute_text(attributes, TRANSIENT)}.")
    step = number_attribute(ds, "atlas_step")
    accuracy, tolerances = f"step {step:g}", ""
    if not math.isfinite(step):
        accuracy = f"phase tolerance {number_attribute(ds, 'atlas_tolerance'):g} rad"
    if system.frame:
        tolerances = f"; rates count as constant within {rate_text(rate_tolerance_of(ds))} rad per time unit, the third axis"
        tolerances += f" as vertical within {number_attribute(ds, 'atlas_cylinder_tolerance'):g} rad"
    sentences += [
        f"Integrated by {attribute_text(attributes, 'atlas_method')}, {accuracy}{tolerances}.",
        f"Computed with Precession Atlas {attribute_text(attributes, 'atlas_version')}"
        f" (kernel {attribute_text(attributes, 'atlas_kernel_hash')});"
        f" equations: {attribute_text(attributes, 'references', limit=MAX_MESSAGE)}.",
    ]
    return printable(" ".join(sentences))
