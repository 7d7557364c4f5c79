"""The catalogue of a system as tables: families and published equations."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from ..errors import BadInput, allowed_text
from ..systems.base import PublishedEquation, System, families_of
from ..systems.wording import unknown_family
from .published import Measure, published_equations

N_SAMPLES = 5  # random parameters behind each residual, from the seeds 0, 1, ...


def families(system: System, name: str | None = None) -> list[dict[str, Any]]:
    """Rows on the families of exact steady motions, with the largest residuals of published equations."""
    every = families_of(system)
    if name is not None and name not in every:
        raise BadInput(f"family {name}: unknown; {unknown_family(name, every)}")
    rows = []
    for family in every.values():
        if name not in (None, family.name):
            continue
        stability = family.stability_text or (
            "No closed form: eigenvalues of the linear equations at an equilibrium, else Floquet multipliers over"
            " the period of the rotation."
        )
        if family.stability is not None:
            stability = " ".join((inspect.getdoc(family.stability) or "").split())
        description = {
            "family": family.name,
            "equations": family.equations,
            "motion": family.title,
            "conditions": [condition.text for condition in family.conditions],
            "exists": family.exists,
            "solves_for": list(family.solve),
            "of_several_solutions": [f"{name}: {text}" for name, text in family.several.items()],
            "leaves_free": list(family.free),
            "geometry": family.geometry or "depends on the point",
            "labels": family.labels,
            "paper_wording": family.paper_wording,
            "stability": stability,
        }
        equations = [row for row in published_equations(system) if row.family == family.name]
        rows.append(description | _max_residuals(equations))
    return rows


def published(
    system: System, family: str | None = None, errata: bool = False, number: str | None = None
) -> list[dict[str, Any]]:
    """Rows on the published equations of the system's paper, as printed and as true; errata: only on these, number: on that equation."""
    every = equations = published_equations(system)
    if number is not None:
        every = [row for row in equations if re.search(rf"(?<![\w']){re.escape(number)}(?!\d)", row.number)]
        if not every:
            numbers = dict.fromkeys(n for row in equations for n in re.findall(r"\((\d+)", row.number))
            raise BadInput(f"--errata {number}: no equation of this number; {allowed_text(None, numbers)}")
    return [
        {
            "equation": row.number,
            "family": row.family,
            "verdict": row.verdict,
            "printed": row.printed,
            "true": row.true,
            "measure": row.measure,
            **_max_residuals([row]),
            "effect": row.effect,
        }
        for row in every
        if family in (None, row.family) and not (errata and row.verdict == "true")
    ]


def _max_residuals(rows: Iterable[PublishedEquation]) -> dict[str, float | None]:
    """Largest residuals of some equations as printed and as true, None where nothing is measured."""
    maxima = {}
    for key in ("residual_printed", "residual_true"):
        residuals = [measure for row in rows if (measure := getattr(row, key)) is not None]
        seeds = range(N_SAMPLES)
        maxima[key] = max((residual(f, seed) for f in residuals for seed in seeds), default=None)
    return maxima


@cache  # tables of families, of all equations and of the wrong ones share rows
def residual(measure: Measure, seed: int) -> float:
    """The residual of an equation at the random parameters of a seed."""
    return measure(np.random.default_rng(seed))
