"""Variables that a scene may ask for. They are periodic solutions, and errors of the fast-spin solution."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...flags import PeriodicSolution
from ...systems.base import Array, DerivedVariable, Points, System
from . import MAX_RADIANS


def solution_errors(system: System) -> dict[str, DerivedVariable]:
    """Return the errors of the fast-spin solution, in the true and in the printed form."""
    return _errors("true") | _errors("printed") if system.name == "fixed_point" else {}


def _errors(form: str) -> dict[str, DerivedVariable]:
    """Return the errors of one form of the fast-spin solution."""
    suffix = "" if form == "true" else f"_{form}"
    names = f"first_order_error{suffix}", f"first_order_rate_error{suffix}"

    def compute_group(
        _: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, Array]:
        from . import fast_spin, published

        solution = (fast_spin if form == "true" else published).first_order
        errors = fast_spin.errors(points, duration, solution, pause)
        return dict(zip(names, errors, strict=True))

    def check(points: Points, duration: Array) -> None:
        from . import fast_spin, published

        (fast_spin if form == "true" else published).check(points, duration)

    comment = (
        "against the full equations from the formula's own start, with r0 and gamma0'' of the point; over the"
        f" duration of the run; nan beyond {MAX_RADIANS:g} rad of the fastest frequency"
    )
    text = f"in the first-order solution (33), {form}"
    rows = (
        (names[0], "rad", f"largest error of gamma {text}"),
        (names[1], "1", f"largest error of p + i q {text}, over its largest magnitude"),
    )
    kept: dict[str, Any] = {"check": check, "from_start": True}
    return {row[0]: DerivedVariable.of_group(compute_group, *row, comment, **kept) for row in rows}


def periodic_solutions(system: System) -> dict[str, DerivedVariable]:
    """Return the stability, period and trace of the exact periodic solution near (33)."""
    if system.name != "fixed_point":
        return {}
    names = "periodic_stability", "periodic_period", "periodic_trace"

    def compute_group(
        _: Collection[str], points: Points, duration: Array, pause: Callable[[], None]
    ) -> dict[str, NDArray[Any]]:
        from .periodic import of_points

        return dict(zip(names, of_points(points, pause), strict=True))

    def check(points: Points, duration: Array) -> None:
        from .fast_spin import fast_spin

        with np.errstate(all="ignore"):
            fast_spin(points)

    comment = (
        "of the full equations (1) with r0 and gamma0'' of the point, followed from eps = 0 at constant l / (A r0); not of the"
        " motion that is integrated; nan where none is reached"
    )
    text = "of the exact periodic solution near (33)"
    flags = {names[0]: PeriodicSolution.meanings()}
    rows = (
        (names[0], "1", f"Floquet stability {text}"),
        (names[1], "s", f"period {text}"),
        (names[2], "1", f"rho + 1/rho {text}, rho the multiplier that is not 1"),
    )
    return {
        row[0]: DerivedVariable.of_group(compute_group, *row, comment, check=check, flags=flags.get(row[0]))
        for row in rows
    }
