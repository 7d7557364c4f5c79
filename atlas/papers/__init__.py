"""Papers held against the equations of motion: equations as printed and as true, with residuals.

A folder here is a paper. Its `equations.toml` contains the texts and, where it can, both readings as
expressions; `published.PUBLISHED` has the rows of the catalogue. `System.paper` names it: no run loads one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from ..scene.expressions import Expression
from ..systems.base import PublishedEquation

Measure = Callable[[np.random.Generator], float]
# measures of a row as printed and as true
Readings = tuple[Measure | None, Measure | None]

TEXTS = ("number", "family", "printed", "true", "verdict", "measure", "effect")
expression = cache(Expression)  # the same few are evaluated at many random points


def load(folder: str) -> dict[str, Any]:
    """The content of the equations.toml of a paper."""
    return tomllib.loads(
        resources.files(f"{__name__}.{folder}").joinpath("equations.toml").read_text("utf-8")
    )


def row(entry: Mapping[str, Any], readings: Readings, measure: str = "") -> PublishedEquation:
    """The row of the catalogue of an equation of a paper, with the description of its measure if it has none."""
    texts = {"family": "", "measure": measure} | {key: entry[key] for key in TEXTS if key in entry}
    return PublishedEquation(**texts, residual_printed=readings[0], residual_true=readings[1])
