"""Errors of the fast-spin solution of Amer et al. 2013 as variables of an atlas; the paper is loaded where they are wanted."""

from __future__ import annotations

from collections.abc import Callable, Collection
from importlib import import_module
from typing import Any

from ..base import Array, DerivedVariable, Points

PAPER = "atlas.papers.amer2013"
# Longest run that is integrated, in radians of its fastest frequency: some seconds for a chunk of points.
MAX_RADIANS = 1000.0
_COMMENT = (
    "against the full equations from the formula's own start, with r0 and gamma0'' of the point; over the"
    f" duration of the run; nan beyond {MAX_RADIANS:g} rad of the fastest frequency"
)


def _solution_errors() -> Any:
    return import_module(f"{PAPER}.solution_errors")


def _variables(form: str) -> list[DerivedVariable]:
    """Errors of the solution in one form, "true" or "printed"."""
    suffix = "" if form == "true" else f"_{form}"
    names = f"first_order_error{suffix}", f"first_order_rate_error{suffix}"

    def together(
        _: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, Array]:
        errors = _solution_errors()
        return dict(zip(names, errors.errors(points, duration, errors.SOLUTIONS[form], pause), strict=True))

    def check(points: Points, duration: Array) -> None:
        _solution_errors().check(points, duration, form)

    texts = (
        ("rad", f"largest error of gamma in the first-order solution (33), {form}"),
        (
            "1",
            f"largest error of p + i q in the first-order solution (33), {form}, over its largest magnitude",
        ),
    )
    return [
        DerivedVariable.of_group(together, name, unit, long_name, _COMMENT, check=check)
        for name, (unit, long_name) in zip(names, texts, strict=True)
    ]


DERIVED = {variable.name: variable for form in ("true", "printed") for variable in _variables(form)}
