"""Solution for parameters by the formulas of a scene's family, and error messages for scenes without a point on the family."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import BadInput, allowed_text, shown
from ..systems.base import NEAR, Array, Family, Points, System, on_family
from . import checks
from .expressions import Expression

# A point counts as on the family if the residuals of all conditions, which are dimensionless, are below this number.
ON_FAMILY = 1e-9
# If the formula of a parameter in `solve` has no solution, these values of the parameter are tried. An error message names the value
# with the smallest residual. The value 0 is left out, because Euler angles are singular at theta0 = 0.
TRIAL_VALUES = np.array([0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5])[:, None]
# These amounts are added to a solved parameter. If the conditions still hold, the family leaves the parameter free.
TRIAL_CHANGES = np.array([1.3, -0.6])[:, None]


def free_message(family: Family, name: str, where: str = "") -> str:
    """Return the error message for a parameter in `solve` that the family leaves free."""
    reason = f"the family {family.name} leaves it free{where}, every value is one"
    return f"family.solve = {shown(name)}: {reason}; give it in [fixed], [axes] or [ties]"


def solution(
    family: Family, solve: Sequence[str], points: Points, near: Mapping[str, float]
) -> dict[str, Array]:
    """Return points whose parameters in `solve` are computed by formulas of the family. `near` comes from `near_values`."""
    result = dict(points)
    for name, value in near.items():
        result[NEAR + name] = np.full_like(points[name], value)
        if name in solve:
            result[name] = result[NEAR + name]
    for name in solve:
        result[name] = np.asarray(family.solve[name](result), np.float64)
    return {name: result[name] for name in points}


def near_values(
    system: System, family: Family, solve: Sequence[str], table: Mapping[str, Any]
) -> dict[str, float]:
    """Return values from `branch` or `near` by parameter. Of several solutions, a parameter takes the solution nearest to its value."""
    key = next((key for key in ("branch", "near") if key in table), "")
    if "branch" in table and "near" in table:
        raise BadInput("family: branch and near are both given; a scene has one of them")
    if not key:
        return {}
    # Formulas for the start values p0 .. gamma30 use the rate of the motion, which may have several solutions.
    names = [name for name in family.several if name in solve or ("p0" in solve and name not in family.solve)]
    found = f"family.{key} = {shown(table[key])}: "
    if key == "branch":
        branch = checks.choice("family.branch", table["branch"], ("slow", "fast"))
        if not (rates := [name for name in names if system.parameters[name].unit.startswith("rad s")]):
            rest = f"use near for {', '.join(names)}" if names else "atlas conditions lists them by family"
            raise BadInput(f"{found}no rate with several solutions is solved; {rest}")
        return dict.fromkeys(rates, 0.0 if branch == "slow" else np.inf)
    value = table["near"]
    if not isinstance(value, Mapping):
        if len(names) != 1:
            several = f"must be a table with one of {', '.join(names)}"
            raise BadInput(found + (several if names else "no solved parameter has several solutions"))
        return {names[0]: _near("family.near", value, system.parameters[names[0]].unit)}
    for name in value:
        if name not in names:
            raise BadInput(
                f"family.near.{name}: no solved parameter with several solutions; {allowed_text(name, names)}"
            )
    return {
        name: _near(f"family.near.{name}", each, system.parameters[name].unit) for name, each in value.items()
    }


def _near(key: str, value: object, unit: str) -> float:
    """Return a value of the key `near` as a number. Raise BadInput for an angle above 2 pi, which is probably in degrees."""
    arithmetic = isinstance(value, str) and not Expression(key, value).names
    result = (checks.quantity if arithmetic else checks.number)(key, value)
    if unit == "rad" and abs(result) > 2 * np.pi:
        raise BadInput(f"{key} = {shown(value)}: in rad, at most a turn; of degrees give '{result:g} * deg'")
    return result


def check_solution(
    family: Family, solve: Sequence[str], base: Points, near: Mapping[str, float], *, exists: bool
) -> None:
    """Raise BadInput if the family leaves a solved parameter free at all points, or has no motion at any point."""
    with np.errstate(all="ignore"):
        points = solution(family, solve, base, near)
        for i, name in enumerate(solve):
            if np.isfinite(points[name]).any():
                values = points[name] + TRIAL_CHANGES
                _check_not_free(family, name, _with_values(family, solve[:i], points, name, values, near))
            else:
                values = np.zeros_like(base[name]) + TRIAL_VALUES
                trials = _with_values(family, solve[:i], base, name, values, near)
                trials = solution(family, solve[i + 1 :], trials, near)
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
    family: Family, solve: Sequence[str], points: Points, name: str, values: Array, near: Mapping[str, float]
) -> dict[str, Array]:
    """Return points of shape (trials, points) with the given values of a parameter. The parameters in `solve` are solved again."""
    repeated = {key: np.broadcast_to(column, values.shape) for key, column in points.items()}
    return solution(family, solve, repeated, near) | {name: values}


def _check_not_free(family: Family, name: str, points: Points) -> None:
    """Raise BadInput if all `points`, with trial values of a parameter, are on the family. Families of varying rates are skipped."""
    if family.rate_std is None and (on_family(family, points) < ON_FAMILY).all():
        raise BadInput(free_message(family, name, " here"))


def _failure_text(family: Family, points: Points) -> str:
    """Return a text on the condition that fails most at the point nearest to the family."""
    residual = on_family(family, points)
    nearest = np.unravel_index(np.argmin(residual), residual.shape)
    if not np.isfinite(residual[nearest]):
        return f"it needs {'; '.join(c.text for c in family.conditions)}, which have no value"
    amounts = [abs(float(condition.residual(points)[nearest])) for condition in family.conditions]
    worst = int(np.argmax(amounts))
    return f"it needs {family.conditions[worst].text}, which fails by {amounts[worst]:.3g} (relative)"
