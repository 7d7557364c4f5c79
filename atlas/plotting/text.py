"""Text of the figures: labels of axes and variables, captions."""

from __future__ import annotations

import math
import re

import xarray as xr

from ..analysis.metadata import axes_of, scene_of, system_of
from ..errors import MAX_TEXT, printable
from ..scene.model import Scene
from ..systems.base import System
from .style import SYMBOLS

STATISTICS = {"mean": "mean", "rms": "rms", "std": "standard deviation of", "min": "least", "max": "largest"}


def axis_label(ds: xr.Dataset, dim: str, *, unit: bool = True) -> str:
    """Symbol and unit of an axis: those of the registry, or the long_name and units that the scene gave."""
    system, attributes = system_of(ds), ds[dim].attrs
    text = str(attributes.get("long_name", dim))
    stem = dim.removesuffix("_offset")
    if dim in system.parameters and text == system.parameters[dim].meaning:
        text = _symbol(dim, system)
    elif dim != stem and stem in system.parameters and "offset from the family" in text:
        text = f"{_symbol(stem, system)}, offset from the family"
    else:
        words = re.findall(r"[A-Za-z_]\w*", text)
        if words and all(word in system.parameters for word in words):
            text = re.sub(r"[A-Za-z_]\w*", lambda word: _symbol(word[0], system).strip("$"), text)
            text = f"${text.replace('*', ' ')}$"
    units = unit_text(str(attributes.get("units", "")))
    return f"{text} ({units})" if unit and units else text


def variable_label(array: xr.DataArray) -> str:
    """Short name and unit of a variable: a statistic of a symbol, or the words of its name."""
    name, units = str(array.name), unit_text(str(array.attrs.get("units", "")))
    stem, _, statistic = name.rpartition("_")
    text = f"{STATISTICS[statistic]} {SYMBOLS[stem]}" if stem in SYMBOLS else name.replace("_", " ")
    return f"{text} ({units})" if units else text


def unit_text(unit: str) -> str:
    """A unit in UDUNITS spelling for print, with raised exponents; empty for pure numbers."""
    if unit in ("", "1"):
        return ""
    return re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", unit)


def _symbol(name: str, system: System) -> str:
    """Mathematical form of a parameter."""
    return system.parameters[name].symbol or name


def caption(ds: xr.Dataset) -> str:
    """What a figure of an atlas shows and how it was computed.

    Parameters
    ----------
    ds : Dataset
        An atlas, or the part of it that the figure shows.

    Returns
    -------
    str
        System, parameters, duration, tolerances, nudge, program, in one line.
    """
    system, scene, attributes = system_of(ds), scene_of(ds), ds.attrs
    sentences = [
        f"{printable(str(attributes.get('title', 'Atlas')), MAX_TEXT)}: {system.title}, motion in the {system.frame} frame."
    ]
    if scene is not None:
        sentences += _scene_sentences(ds, scene)
    step = attributes.get("atlas_step", math.nan)
    accuracy = (
        f"step {step:g}"
        if math.isfinite(step)
        else f"phase tolerance {attributes.get('atlas_tolerance'):g} rad"
    )
    sentences += [
        f"Integrated by {attributes.get('atlas_method')}, {accuracy}; rates count as constant within"
        f" {attributes.get('atlas_rate_tolerance'):g} rad per time unit, the third axis as vertical within"
        f" {attributes.get('atlas_cylinder_tolerance'):g} rad.",
        f"Computed with Precession Atlas {attributes.get('atlas_version')}"
        f" (kernel {attributes.get('atlas_kernel_hash')}); equations: {attributes.get('references')}.",
    ]
    return " ".join(sentences)


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
