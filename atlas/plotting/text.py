"""Text of the figures: labels of axes and variables, captions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import xarray as xr
from matplotlib.font_manager import findfont, get_font
from matplotlib.mathtext import MathTextParser

from ..analysis.metadata import axes_of, number_attribute, scene_of, system_of
from ..errors import MAX_MESSAGE, attribute_text, printable
from ..scene.model import Scene
from ..systems.base import System
from .style import FONT, SYMBOLS

_PARSER = MathTextParser("path")
STATISTICS = {"mean": "mean", "rms": "rms", "std": "standard deviation of", "min": "least", "max": "largest"}


def axis_label(ds: xr.Dataset, dim: str, *, unit: bool = True) -> str:
    """Symbol and unit of an axis from the registry, or the long_name and units in the scene."""
    system, attributes = system_of(ds), ds[dim].attrs
    text = attribute_text(attributes, "long_name", dim)
    stem = dim.removesuffix("_offset")
    if dim in system.parameters and text == system.parameters[dim].meaning:
        text = _symbol(dim, system)
    elif dim != stem and stem in system.parameters and "offset from the family" in text:
        text = f"{_symbol(stem, system)}, offset from the family"
    else:
        text = math_text(text, {name: p.symbol for name, p in system.parameters.items()})
    units = unit_text(attribute_text(attributes, "units"))
    return drawable(f"{text} ({units})" if unit and units else text)


def drawable(text: str) -> str:
    """A text as a figure draws it; every text that is not the program's own passes this function.

    Lines are `printable` and of limited length, with dollar signs escaped where Matplotlib finds no formula.
    """
    return "\n".join(_drawable_line(printable(line, MAX_MESSAGE)) for line in text.split("\n"))


def _drawable_line(line: str) -> str:
    """One line of `drawable`: Matplotlib sets each line of a text by itself."""
    if "$" not in line:
        return line
    font = get_font(findfont(FONT))
    try:
        if all(font.get_char_index(ord(letter)) for letter in line):
            _PARSER.parse(line)
            return line
    except (ValueError, RecursionError):
        pass
    return line.replace("$", r"\$")


def math_text(text: str, symbols: Mapping[str, str]) -> str:
    """A text with its formulas and symbols in Matplotlib's mathematical notation.

    One formula if all words are names or symbols; else only names that can be no words: with a digit, Greek
    letters, and a parameter at the end. A text that has mathematics of its own is returned as it is.
    """
    if "$" in text:
        return text
    words = re.findall(_WORD, text)
    if words and all(_formula(word, symbols) for word in words):
        text = re.sub(_WORD, lambda word: _formula(word[0], symbols), text)
        text = re.sub(r"\*\*\s*(\w+)", r"^{\1}", text).replace(", ", r",\ ")
        text = re.sub(r"\s*\*\s*", r"\\,", text)
        return f"${re.sub(_PRODUCT, _THIN, text)}$"
    text = re.sub(_WORD, lambda word: _in_words(word[0], symbols), text)
    last = text.rpartition(" ")[2]  # "rate of precession n": a symbol after the words that name it
    return f"{text.removesuffix(last)}{symbols[last]}" if symbols.get(last) else text


_WORD = r"[A-Za-z_]\w*"
_PRODUCT, _THIN = r"(?<=[\w}]) (?=[\w\\])", r"\\,"
GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu",
    "xi", "pi", "rho", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda",
    "Xi", "Pi", "Sigma", "Upsilon", "Phi", "Psi", "Omega",
)  # fmt: skip
_LETTERS = {name: rf"\{name}" for name in GREEK} | {"eps": r"\epsilon", "phi": r"\varphi"}


def _formula(word: str, symbols: Mapping[str, str]) -> str:
    """A name in mathematical notation, empty for a word that is none."""
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


def _in_words(word: str, symbols: Mapping[str, str]) -> str:
    """A word of a text: a formula if it has a digit or is a Greek letter, else as it is."""
    formula = _formula(word, symbols)
    is_name = word in _LETTERS or any(c.isdigit() for c in word)
    return f"${formula}$" if formula and is_name else word


def variable_label(array: xr.DataArray) -> str:
    """Short name and unit of a variable: a statistic of a symbol, or the words of its name."""
    name, units = str(array.name), unit_text(attribute_text(array.attrs, "units"))
    stem, _, statistic = name.rpartition("_")
    text = f"{STATISTICS[statistic]} {SYMBOLS[stem]}" if stem in SYMBOLS else name.replace("_", " ")
    return drawable(f"{text} ({units})" if units else text)


def unit_text(unit: str) -> str:
    """A unit in UDUNITS spelling for print, with raised exponents; empty for pure numbers."""
    if unit in ("", "1"):
        return ""
    unit = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", unit)
    return drawable(re.sub(r"\bOmega\b", r"$\\Omega$", unit))


def _symbol(name: str, system: System) -> str:
    """Mathematical form of a parameter."""
    return system.parameters[name].symbol or name


def caption(ds: xr.Dataset) -> str:
    """What a figure of an atlas shows and how it was computed, in one line."""
    system, scene, attributes = system_of(ds), scene_of(ds), ds.attrs
    sentences = [
        f"{attribute_text(attributes, 'title', 'Atlas')}: {system.title}"
        + ("." if system.observables else f", motion in the {system.frame} frame.")
    ]
    if scene is not None:
        sentences += _scene_sentences(ds, scene)
    step = number_attribute(ds, "atlas_step")
    accuracy = (
        f"step {step:g}"
        if math.isfinite(step)
        else f"phase tolerance {number_attribute(ds, 'atlas_tolerance'):g} rad"
    )
    tolerances = (
        ""
        if system.observables
        else f"; rates count as constant within {number_attribute(ds, 'atlas_rate_tolerance'):g} rad per time unit, the third axis"
        f" as vertical within {number_attribute(ds, 'atlas_cylinder_tolerance'):g} rad"
    )
    sentences += [
        f"Integrated by {attribute_text(attributes, 'atlas_method')}, {accuracy}{tolerances}.",
        f"Computed with Precession Atlas {attribute_text(attributes, 'atlas_version')}"
        f" (kernel {attribute_text(attributes, 'atlas_kernel_hash')});"
        f" equations: {attribute_text(attributes, 'references', limit=MAX_MESSAGE)}.",
    ]
    return printable(" ".join(sentences))


def _scene_sentences(ds: xr.Dataset, scene: Scene) -> list[str]:
    """Axes, parameters, family, nudge and duration of the points shown."""
    dims = axes_of(scene)
    axes = [
        f"{dim} from {float(ds[dim].min()):.6g} to {float(ds[dim].max()):.6g} ({ds.sizes[dim]} values)"
        for dim in dims
        if dim in ds.dims
    ]
    parameters = [f"{name} = {value:.6g}" for name, value in scene.fixed.items()]
    parameters += [f"{name} = {tie.text}" for name, tie in scene.ties.items()]
    parameters += [f"{dim} = {float(ds[dim]):.6g}" for dim in dims if dim in ds.coords and ds[dim].ndim == 0]
    sentences = []
    if axes:
        sentences.append(f"Axes: {', '.join(axes)}.")
    if parameters:
        sentences.append(f"Parameters: {', '.join(parameters)}; the others have their defaults.")
    if scene.family is not None:
        family = scene.system.families[scene.family]
        solved = f", solved for {', '.join(scene.solve)}" if scene.solve else ""
        sentences.append(f"Starts on the family {family.name} [{family.equations}]{solved}.")
    if scene.nudge:
        nudge = ", ".join(f"{name} by {value:g}" for name, value in scene.nudge.items())
        sentences.append(f"Starts displaced from there: {nudge}.")
    unit = "" if scene.duration.unit else " time units"
    return [*sentences, f"Duration {scene.duration}{unit}."]
