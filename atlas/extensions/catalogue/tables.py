"""The catalogue of a system as tables of families and of published equations."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import systems
from ...errors import BadInput, allowed_text
from ...scene.checks import typed
from ...systems.base import PublishedEquation, System, families_of
from ...systems.wording import unknown_family
from .papers import Measure, published_equations

if TYPE_CHECKING:
    import pandas as pd

TRUE = "true"  # verdict on an equation that is printed without error
N_SAMPLES = 5  # Residuals are maxima over this number of random parameter sets, with the seeds 0, 1, ...


@typed
def conditions(system: str, family: str | None = None, errata: bool = False) -> pd.DataFrame:
    """Families of exact steady motions with their conditions, or errata of papers, as a table.

    Parameters
    ----------
    system : str
        Name of the system.
    family : str, optional
        Name of the only family in the table.
    errata : bool, optional
        Whether the table lists the misprinted equations of papers instead of families.

    Returns
    -------
    pandas.DataFrame
        Table with the columns of ``atlas conditions SYSTEM --csv``. Families are indexed by `family`, and the column `errata` lists
        the numbers of misprinted equations. Errata are indexed by these numbers. A cell with several texts is a list.
        The columns `residual_printed` and `residual_true` contain the largest residuals of the printed and of the corrected
        equations in the equations of motion, at random parameters.

    Raises
    ------
    BadInput
        For an unknown system or family.
    """
    import pandas as pd  # Pandas is slow to import.

    described, key = systems.get(system), "equation" if errata else "family"
    rows = published(described, family, True) if errata else families(described, family)
    return pd.DataFrame(rows or {key: []}).set_index(key)


def families(system: System, name: str | None = None) -> list[dict[str, Any]]:
    """Return rows about families of exact steady motions, with the largest residuals of published equations."""
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
        wrong = [row.number for row in equations if row.verdict != TRUE]
        rows.append(description | _max_residuals(equations) | {"errata": wrong})
    return rows


def published(
    system: System, family: str | None = None, errata: bool = False, number: str | None = None
) -> list[dict[str, Any]]:
    """Return rows about published equations. `errata` keeps only equations with an error, and `number` only equations of this number."""
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
        if family in (None, row.family) and not (errata and row.verdict == TRUE)
    ]


def _max_residuals(rows: Iterable[PublishedEquation]) -> dict[str, float | None]:
    """Return the largest residuals of the printed and of the true equations, or None if no residual is measured."""
    maxima = {}
    for key in ("residual_printed", "residual_true"):
        residuals = [measure for row in rows if (measure := getattr(row, key)) is not None]
        seeds = range(N_SAMPLES)
        maxima[key] = max((residual(f, seed) for f in residuals for seed in seeds), default=None)
    return maxima


@cache  # Several tables contain the same residual.
def residual(measure: Measure, seed: int) -> float:
    """Return the residual of an equation at random parameters from a seed."""
    return measure(np.random.default_rng(seed))
