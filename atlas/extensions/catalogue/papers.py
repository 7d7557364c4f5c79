"""Equations of papers in two readings, printed and true, with the residuals of both readings in the equations of motion.

Each paper is an extension. The file `equations.toml` contains the texts of the equations and, where possible, both readings as
expressions. `MEASURES` maps the number of an equation, or a key of an entry in this file, to the function that measures residuals.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from importlib import resources
from typing import Any

import numpy as np

from ... import extension
from ...scene.expressions import Expression
from ...systems.base import PublishedEquation, System

Measure = Callable[[np.random.Generator], float]
Entry = Mapping[str, Any]
# An EntryMeasure maps (entry, reading, generator) to the residual of the equation in the reading "printed" or "true".
EntryMeasure = Callable[[Entry, str, np.random.Generator], float]

TEXTS = ("number", "family", "printed", "true", "verdict", "measure", "effect")
expression = cache(Expression)  # The same expressions are evaluated at many random points.


def published_equations(system: System) -> Sequence[PublishedEquation]:
    """Return the equations about a system from the papers of all extensions."""
    return [row for rows in extension.of_each("published", system.name) for row in rows]


def published_numbers(system: System) -> list[dict[str, str]]:
    """Return rows from all extensions. Each row compares a published number with the number of this package."""
    functions = extension.of_each("published_numbers", system.name)
    return [row for function in functions for row in function(system.name)]


def load(package: str) -> tuple[dict[str, Any], dict[str, Entry]]:
    """Return the content of `equations.toml` in the package of a paper, and the entries of its equations by number."""
    content = tomllib.loads(resources.files(package).joinpath("equations.toml").read_text("utf-8"))
    return content, {entry["number"]: entry for entry in content["equation"]}


def side(entry: Entry, reading: str, entries: Mapping[str, Entry], value: Callable[[str], Any]) -> Any:
    """Return the sum of `value` over the terms of a reading. If an entry names another equation, the true terms of that equation count."""
    terms = entry.get(f"terms_{reading}") or entry["terms_true"]
    return sum(map(value, entries[terms]["terms_true"] if isinstance(terms, str) else terms))


def rows(
    content: Mapping[str, Any], measures: Mapping[str, EntryMeasure | None]
) -> tuple[PublishedEquation, ...]:
    """Return a paper's catalogue. `measures` maps an entry's number or key to a function, or to None if the key's extension is missing."""
    made = []
    for entry in content["equation"]:
        key = next((key for key in measures if key == entry["number"] or key in entry), "")
        texts = {"family": "", "measure": content.get("measures", {}).get(key, "").format(**entry)}
        texts |= {name: entry[name] for name in TEXTS if name in entry}
        measure = measures.get(key)
        if key and not measure:
            texts["measure"] = f"not measured: the extension {key} is not installed"
        printed, true = (measure and partial(measure, entry, reading) for reading in ("printed", "true"))
        made.append(PublishedEquation(**texts, residual_printed=printed, residual_true=true))
    return tuple(made)
