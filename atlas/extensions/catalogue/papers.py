"""Equations of papers, as printed and as true, with their residuals in the equations of motion.

Each paper is an extension. Its `equations.toml` contains the texts and, where possible, both readings as expressions. Its
`MEASURES` map the number of an equation, or a key in its entry, to the function that measures the residual.
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
# (entry, reading, random generator) -> residual of the equation in the reading, "printed" or "true"
EntryMeasure = Callable[[Entry, str, np.random.Generator], float]

TEXTS = ("number", "family", "printed", "true", "verdict", "measure", "effect")
expression = cache(Expression)  # a few expressions are evaluated at many random points


def published_equations(system: System) -> Sequence[PublishedEquation]:
    """Equations about a system from the papers of all extensions."""
    return [row for rows in extension.of_each("published", system.name) for row in rows]


def published_numbers(system: System) -> list[dict[str, str]]:
    """Rows of published numbers beside ours, from all extensions."""
    functions = extension.of_each("published_numbers", system.name)
    return [row for function in functions for row in function(system.name)]


def load(package: str) -> tuple[dict[str, Any], dict[str, Entry]]:
    """Content of the equations.toml in the package of a paper, and its equations by number."""
    content = tomllib.loads(resources.files(package).joinpath("equations.toml").read_text("utf-8"))
    return content, {entry["number"]: entry for entry in content["equation"]}


def side(entry: Entry, reading: str, entries: Mapping[str, Entry], value: Callable[[str], Any]) -> Any:
    """Sum of `value` over the terms of an equation in a reading; for terms given as an equation's number, over its true terms."""
    terms = entry.get(f"terms_{reading}") or entry["terms_true"]
    return sum(map(value, entries[terms]["terms_true"] if isinstance(terms, str) else terms))


def rows(
    content: Mapping[str, Any], measures: Mapping[str, EntryMeasure | None]
) -> tuple[PublishedEquation, ...]:
    """Rows of the catalogue of a paper; measures: equation or key -> function, None if the extension named by the key is missing."""
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
