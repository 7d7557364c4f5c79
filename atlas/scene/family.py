"""The family of a scene: its solution for parameters, and the reason why no point is on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import BadInput, shown
from ..systems.base import Array, Family, Points, on_family

# A solved point counts as on its family if its largest condition residual is below this.
ON_FAMILY = 1e-9
# Values tried for a parameter where its formula gives none; not 0, where angles have no meaning.
TRIAL_VALUES = np.array([0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5])[:, None]
# Changes of a solved parameter; a family that holds after each of them leaves the parameter free.
TRIAL_CHANGES = np.array([1.3, -0.6])[:, None]


def free_message(family: Family, name: str, where: str = "") -> str:
    """Message about a parameter that is to be solved, and that the family leaves free."""
    reason = f"the family {family.name} leaves it free{where}, every value is one"
    return f"family.solve = {shown(name)}: {reason}; give it in [fixed], [axes] or [ties]"


def solution(family: Family, solve: Sequence[str], points: Points) -> dict[str, Array]:
    """The points with the parameters of `solve` from the family's formulas, in that order."""
    result = dict(points)
    for name in solve:
        result[name] = np.asarray(family.solve[name](result), np.float64)
    return result


def check_solution(family: Family, solve: Sequence[str], base: Points, *, exists: bool) -> None:
    """Raise BadInput if the family leaves a solved parameter free at some points, or does not exist at any of them."""
    with np.errstate(all="ignore"):
        points = solution(family, solve, base)
        for i, name in enumerate(solve):
            if np.isfinite(points[name]).any():
                values = points[name] + TRIAL_CHANGES
                _check_not_free(family, name, _with_values(family, solve[:i], points, name, values))
            else:
                values = np.zeros_like(base[name]) + TRIAL_VALUES
                trials = _with_values(family, solve[:i], base, name, values)
                trials = solution(family, solve[i + 1 :], trials)
                _check_not_free(family, name, trials)
                best = trials[name].flat[np.argmin(on_family(family, trials))]
                limits = f"; its limits: {family.exists}" if family.exists else ""
                raise BadInput(
                    f"family.name = {shown(family.name)}: no {name} puts any point of the scene on it;"
                    f" {_failure_text(family, trials)} at {name} = {best:g}, the best of some values tried{limits}"
                )
        if not exists:
            raise BadInput(
                f"family.name = {shown(family.name)}: {_failure_text(family, points)} at the nearest point of the scene"
            )


def _with_values(
    family: Family, solve: Sequence[str], points: Points, name: str, values: Array
) -> dict[str, Array]:
    """Points with values (trials, points) of one parameter, for which `solve` is solved again."""
    repeated = {key: np.broadcast_to(column, values.shape) for key, column in points.items()}
    return solution(family, solve, repeated) | {name: values}


def _check_not_free(family: Family, name: str, points: Points) -> None:
    """Raise BadInput if the points, which differ in one parameter, are all on the family, unless its motions fill regions."""
    if family.rate_std is None and (on_family(family, points) < ON_FAMILY).all():
        raise BadInput(free_message(family, name, " here"))


def _failure_text(family: Family, points: Points) -> str:
    """The condition that fails most at the point nearest to the family, and by how much."""
    residual = on_family(family, points)
    nearest = np.unravel_index(np.argmin(residual), residual.shape)
    if not np.isfinite(residual[nearest]):
        return f"it needs {'; '.join(c.text for c in family.conditions)}, which have no value"
    amounts = [abs(float(condition.residual(points)[nearest])) for condition in family.conditions]
    worst = int(np.argmax(amounts))
    return f"it needs {family.conditions[worst].text}, which fails by {amounts[worst]:.3g} (relative)"
