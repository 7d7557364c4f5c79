"""Papers held against the equations of motion: equations as printed and as true, with residuals.

An extension is a paper. Its `equations.toml` contains the texts and, where it can, both readings as expressions.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from .. import extension
from ..scene.expressions import Expression
from ..systems.base import PublishedEquation, System

Measure = Callable[[np.random.Generator], float]
# measures of a row as printed and as true
Readings = tuple[Measure | None, Measure | None]

TEXTS = ("number", "family", "printed", "true", "verdict", "measure", "effect")
expression = cache(Expression)  # the same few are evaluated at many random points


def published_equations(system: System) -> Sequence[PublishedEquation]:
    """Equations of papers on a system, of all extensions."""
    return [row for rows in extension.of_each("published", system.name) for row in rows]


def published_numbers(system: System) -> list[dict[str, str]]:
    """Rows on numbers that others have printed, beside ours, of all extensions."""
    functions = extension.of_each("published_numbers", system.name)
    return [row for function in functions for row in function(system.name)]


def load(package: str) -> dict[str, Any]:
    """The content of the equations.toml in the package of a paper."""
    return tomllib.loads(resources.files(package).joinpath("equations.toml").read_text("utf-8"))


def row(entry: Mapping[str, Any], readings: Readings, measure: str = "") -> PublishedEquation:
    """The row of the catalogue of an equation of a paper, with the description of its measure if it has none."""
    texts = {"family": "", "measure": measure} | {key: entry[key] for key in TEXTS if key in entry}
    return PublishedEquation(**texts, residual_printed=readings[0], residual_true=readings[1])
