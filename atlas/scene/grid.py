"""The grid of a scene: axes, ties, family and nudge become labelled points, a range at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import BadInput
from ..systems.base import Array, Family, Points, System, on_family
from .model import Duration, Scene, check_range

# Points per tile: a constant, so that results never depend on how a run was cut.
MAX_POINTS_PER_TILE = 65536
# At most this many bodies, and starts on a family, are checked before a run; others when their tile comes.
CHECKED_BODIES, CHECKED_STARTS = 50_000, 10_000
# For complaints: points at which formulas are tried, and values tried where a formula has none.
CHECKED_FORMULAS = 100
TRIAL_VALUES = np.array([0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5])[
    :, None
]  # not 0: angles mean nothing there
# A solved point counts as on its family if its largest condition residual is below this.
ON_FAMILY = 1e-9


@dataclass(frozen=True)
class Grid:
    """A range of a scene's points, every array of shape (points,)."""

    base: dict[str, Array]  # before the nudge, where theory speaks
    points: dict[str, Array]  # the starts
    there: np.ndarray  # bool: does the family exist at the point?
    duration: Array  # time units


def parameter_values(scene: Scene, indices: np.ndarray) -> dict[str, np.ndarray]:
    """Value of every parameter, axis and tie at flat C-order indices, before the family is solved."""
    place = np.unravel_index(indices, scene.shape)
    known: dict[str, np.ndarray] = {
        name: np.full(indices.shape, p.default) for name, p in scene.system.parameters.items()
    }
    known |= {name: np.full(indices.shape, value) for name, value in scene.fixed.items()}
    for axis, where in zip(scene.axes.values(), place, strict=True):
        if not axis.offset_from_family:
            known[axis.name] = np.asarray(axis.values)[where]
    for name, tie in scene.ties.items():
        value = np.broadcast_to(tie.value(known), indices.shape).astype(np.float64)
        if not np.isfinite(value).all():
            raise BadInput(
                f"{tie.key} = {tie.text!r}: gives {value[~np.isfinite(value)][0]} at some point of the grid"
            )
        if name in scene.system.parameters:
            check_range(scene.system, f"{tie.key} = {tie.text!r}", name, value.min(), value.max())
        known[name] = value
    return known


def points_at_indices(scene: Scene, indices: np.ndarray) -> Grid:
    """The points at flat C-order indices of the scene's grid. Raises BadInput for impossible bodies."""
    system = scene.system
    known = parameter_values(scene, indices)
    base = {name: known[name] for name in system.parameters}
    system.check(base)
    there = np.ones(indices.shape, bool)
    if scene.family is not None:
        family = system.families[scene.family]
        with np.errstate(all="ignore"):
            base = _solved(family, scene.solve, base)
            there = on_family(family, base) < ON_FAMILY
        for name in scene.solve:
            there &= np.isfinite(base[name])
        place = np.unravel_index(indices, scene.shape)
        for axis, where in zip(scene.axes.values(), place, strict=True):
            if axis.offset_from_family:
                base[axis.name] = base[axis.name] + np.asarray(axis.values)[where]
        if there.any():
            system.check({name: values[there] for name, values in base.items()})
    start = system.as_euler_angles(base) if scene.nudges_angles else base
    points = {name: start[name] + scene.nudge.get(name, 0.0) for name in base}
    return Grid(base, points, there, durations(system, scene.duration, base))


def points_at(scene: Scene, places: Mapping[str, np.ndarray]) -> Grid:
    """The points of a scene at any places along its axes, not only those of its grid.

    places: name of each axis of the scene -> values, all of one shape (points,).
    """
    axes, where = {}, []
    for name, axis in scene.axes.items():
        values, index = np.unique(places[name], return_inverse=True)
        axes[name] = replace(axis, values=tuple(values.tolist()))
        where.append(index)
    moved = replace(scene, axes=axes)
    return points_at_indices(moved, np.ravel_multi_index(tuple(where), moved.shape))


def durations(system: System, duration: Duration, points: Points) -> Array:
    """Length of each run in time units."""
    shape = np.shape(points["n"])
    if duration.unit == "orbits":
        assert system.frame_rate is not None
        rate = np.abs(system.frame_rate(points))
    elif duration.unit == "turns":
        _, n, m = system.steady_rates(points)
        n, m = np.abs(n), np.abs(m)
        rate = np.where(n == 0, m, np.where(m == 0, n, np.fmin(n, m)))
    else:
        return np.full(shape, duration.amount)
    still = ~(rate > 0)
    if still.any():
        what = "Omega" if duration.unit == "orbits" else "n and m"
        raise BadInput(
            f"integration.duration = {str(duration)!r}: {what} = 0 at {still.sum()} points, which never turn"
        )
    return duration.amount * 2 * np.pi / rate


def check(scene: Scene) -> Grid:
    """Check the scene at points evenly spread over its grid and return some of them.

    Raises BadInput for impossible bodies, ties without value, and a family that exists nowhere.
    """
    bodies, indices = (
        np.unique(np.linspace(0, scene.size - 1, min(scene.size, most)).round().astype(np.int64))
        for most in (CHECKED_BODIES, CHECKED_STARTS)
    )
    scene.system.check(
        {k: v for k, v in parameter_values(scene, bodies).items() if k in scene.system.parameters}
    )
    grid = points_at_indices(scene, indices)
    if scene.family is not None:
        _check_family(scene, indices, grid.there)
    some = {name: values[grid.there] for name, values in grid.base.items()}
    for name, layer in scene.system.derived.items():
        if name in scene.outputs:
            try:
                layer.check(some)
            except BadInput as complaint:
                raise BadInput(f"outputs.variables: {name}: {complaint}") from None
    return grid


def _solved(family: Family, solve: Sequence[str], base: Points) -> dict[str, Array]:
    """The points with the parameters of `solve` from the family's formulas, in that order."""
    found = dict(base)
    for name in solve:
        found[name] = np.asarray(family.solve[name](found), np.float64)
    return found


def _check_family(scene: Scene, indices: np.ndarray, there: np.ndarray) -> None:
    """Raise BadInput if the family exists at none of the points, or leaves a solved parameter free at all."""
    assert scene.family is not None
    family = scene.system.families[scene.family]
    where = indices[there] if there.any() else indices
    where = where[np.linspace(0, where.size - 1, min(where.size, CHECKED_FORMULAS)).astype(np.int64)]
    base = {
        name: values
        for name, values in parameter_values(scene, where).items()
        if name in scene.system.parameters
    }
    with np.errstate(all="ignore"):
        solved = _solved(family, scene.solve, base)
        for i, name in enumerate(scene.solve):
            # a formula that gives nothing, or any other value being as good: what do values do to the family?
            finite = np.isfinite(solved[name]).any()
            tried = (TRIAL_VALUES if not finite else np.array([[1.3], [-0.6]])) + np.where(
                finite, solved[name], 0.0
            )
            moved = {k: np.broadcast_to(v, tried.shape) for k, v in (base if not finite else solved).items()}
            moved = _solved(family, scene.solve[:i], moved) | {name: tried}
            if not finite:
                moved = _solved(family, scene.solve[i + 1 :], moved)
            residual = on_family(family, moved)
            if (residual < ON_FAMILY).all():
                raise BadInput(
                    f"family.solve = {name!r}: the family {family.name} leaves it free here, every value is one;"
                    " give it in [fixed], [axes] or [ties]"
                )
            if not finite:
                best = float(tried[np.unravel_index(np.argmin(residual), residual.shape)])
                limits = f"; its limits: {family.exists}" if family.exists else ""
                raise BadInput(
                    f"family.name = {family.name!r}: no {name} puts any point of the scene on it;"
                    f" {_failure_text(family, moved, residual)} at {name} = {best:g}, the best of some values tried{limits}"
                )
        if not there.any():
            why = _failure_text(family, solved, on_family(family, solved))
            raise BadInput(f"family.name = {family.name!r}: {why} at the nearest point of the scene")


def _failure_text(family: Family, points: Points, residual: Array) -> str:
    """Which condition fails by how much where the residual is least."""
    best = np.unravel_index(np.argmin(residual), residual.shape)
    amounts = [abs(float(condition.residual(points)[best])) for condition in family.conditions]
    if not np.isfinite(residual[best]):
        return f"it needs {'; '.join(c.text for c in family.conditions)}, which have no value"
    worst = int(np.argmax(amounts))
    return f"it needs {family.conditions[worst].text}, which fails by {amounts[worst]:.3g} (relative)"
