"""The grid of a scene: axes, ties, family and nudge become points, a range at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import BadInput, shown
from ..systems.base import Array, Family, Mask, Points, System, on_family, shape_of
from .checks import check_range
from .model import Duration, Scene

# Points per tile: a constant, so that results never depend on how a run was cut.
MAX_POINTS_PER_TILE = 65536
# Bodies, and starts on a family, that are checked before a run; the others are checked with their tile.
MAX_CHECKED_BODIES, MAX_CHECKED_STARTS = 50_000, 10_000
# Points at which the formulas of an impossible family are tried for an error message.
MAX_CHECKED_FORMULAS = 100
# Values tried for a parameter where its formula gives none; not 0, where angles have no meaning.
TRIAL_VALUES = np.array([0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5])[:, None]
# Changes of a solved parameter; a family that holds after each of them leaves the parameter free.
TRIAL_CHANGES = np.array([1.3, -0.6])[:, None]
# A solved point counts as on its family if its largest condition residual is below this.
ON_FAMILY = 1e-9


@dataclass(frozen=True)
class Grid:
    """Some points of a scene.

    Attributes
    ----------
    base : dict of str to ndarray
        Parameter -> values before the nudge, to which theory applies; float64 of shape (points,).
    points : dict of str to ndarray
        Parameter -> values of the starts, after the nudge; float64 of shape (points,).
    exists : ndarray
        bool of shape (points,): whether the scene's family exists at the point.
    duration : ndarray
        Length of the run in time units; float64 of shape (points,).
    """

    base: dict[str, Array]
    points: dict[str, Array]
    exists: Mask
    duration: Array

    def subset(self, where: np.ndarray) -> Grid:
        """Some of the points, by their indices or by a mask."""
        base, points = (
            {name: values[where] for name, values in columns.items()} for columns in (self.base, self.points)
        )
        return Grid(base, points, self.exists[where], self.duration[where])


def parameter_values(scene: Scene, indices: np.ndarray) -> dict[str, Array]:
    """Value of every parameter, axis and tie, before the family is solved.

    Parameters
    ----------
    scene : Scene
        The scene.
    indices : ndarray
        Flat indices of points in C order, integers of shape (points,).

    Returns
    -------
    dict of str to ndarray
        Name -> values, float64 of shape (points,).

    Raises
    ------
    BadInput
        For a tie without a finite value, or one that leaves the range of its parameter.
    """
    parameters = scene.system.parameters
    values: dict[str, Array] = {name: np.full(indices.shape, p.default) for name, p in parameters.items()}
    values |= {name: np.full(indices.shape, value) for name, value in scene.fixed.items()}
    for axis, index in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
        if not axis.offset_from_family:
            values[axis.name] = axis.values[index]
    for name, tie in scene.ties.items():
        value = np.broadcast_to(tie.value(values), indices.shape).astype(np.float64)
        finite = np.isfinite(value)
        if not finite.all():
            raise BadInput(
                f"{tie.key} = {shown(tie.text)}: gives {value[~finite][0]} at some point of the grid"
            )
        if name in parameters:
            check_range(parameters[name], f"{tie.key} = {shown(tie.text)}", value.min(), value.max())
        values[name] = value
    return values


def points_at_indices(scene: Scene, indices: np.ndarray) -> Grid:
    """Points of the scene's grid: ties evaluated, family solved, offsets and nudge added.

    Parameters
    ----------
    scene : Scene
        The scene.
    indices : ndarray
        Flat indices of points in C order, integers of shape (points,).

    Returns
    -------
    Grid
        The points in the order of the indices.

    Raises
    ------
    BadInput
        For an impossible body, a tie without a finite value, and a duration in turns of what rests.
    """
    system = scene.system
    values = parameter_values(scene, indices)
    base = {name: values[name] for name in system.parameters}
    system.check(base)
    exists = np.ones(indices.shape, bool)
    if scene.family is not None:
        family = system.families[scene.family]
        with np.errstate(all="ignore"):
            base = _solved(family, scene.solve, base)
            exists = on_family(family, base) < ON_FAMILY
        for name in scene.solve:
            exists &= np.isfinite(base[name])
        for axis, index in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
            if axis.offset_from_family:
                base[axis.name] = base[axis.name] + axis.values[index]
        if exists.any():
            system.check({name: column[exists] for name, column in base.items()})
    start = system.as_euler_angles(base) if scene.nudges_angles else base
    points = {name: start[name] + scene.nudge.get(name, 0.0) for name in base}
    return Grid(base, points, exists, durations(system, scene.duration, base))


def points_at(scene: Scene, places: Mapping[str, np.ndarray]) -> Grid:
    """Points of a scene at any places along its axes, not only those of its grid.

    Parameters
    ----------
    scene : Scene
        The scene.
    places : mapping of str to ndarray
        Name of each axis of the scene -> values of shape (points,).

    Returns
    -------
    Grid
        The points in the order of the places.

    Raises
    ------
    BadInput
        As `points_at_indices`.
    """
    axes, indices = {}, []
    for name, axis in scene.axes.items():
        values, index = np.unique(places[name], return_inverse=True)
        axes[name] = replace(axis, values=values)
        indices.append(index)
    scene = replace(scene, axes=axes)
    return points_at_indices(scene, np.ravel_multi_index(tuple(indices), scene.shape))


def durations(system: System, duration: Duration, points: Points) -> Array:
    """Length of each run in time units, float64 of shape (points,); BadInput for turns of what rests."""
    if duration.unit == "orbits":
        assert system.frame_rate is not None
        names, rate = f"the rate of the {system.frame} frame", np.abs(system.frame_rate(points))
    elif duration.unit == "turns":
        _, n, m = system.steady_rates(points)
        n, m = np.abs(n), np.abs(m)
        names, rate = "n and m", np.where(n == 0, m, np.where(m == 0, n, np.fmin(n, m)))
    else:
        return np.full(shape_of(points), duration.amount)
    at_rest = ~(rate > 0)
    if at_rest.any():
        raise BadInput(
            f"integration.duration = {shown(str(duration))}: {names} = 0 at {at_rest.sum()} points, which never turn"
        )
    with np.errstate(over="ignore"):
        lengths = duration.amount * 2 * np.pi / rate
    if not np.isfinite(lengths).all():
        raise BadInput(
            f"integration.duration = {shown(str(duration))}: too long at some points, whose rate is small"
        )
    return lengths


def check(scene: Scene) -> Grid:
    """Check a scene at points evenly spaced over its grid.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    Grid
        At most `MAX_CHECKED_STARTS` of the points.

    Raises
    ------
    BadInput
        For an impossible body, a tie without a finite value, a family that exists nowhere or leaves a
        solved parameter free, and a derived variable that has no meaning.
    """
    bodies = parameter_values(scene, _evenly_spaced(scene.size, MAX_CHECKED_BODIES))
    scene.system.check({name: bodies[name] for name in scene.system.parameters})
    indices = _evenly_spaced(scene.size, MAX_CHECKED_STARTS)
    grid = points_at_indices(scene, indices)
    if scene.family is not None:
        _check_family(scene, indices, grid.exists)
    on_grid = grid.subset(grid.exists)
    for name, derived in scene.system.derived.items():
        if name in scene.outputs:
            try:
                derived.check(on_grid.base, on_grid.duration)
            except BadInput as error:
                raise BadInput(f"outputs.variables: {name}: {error}") from None
    return grid


def _evenly_spaced(size: int, count: int) -> np.ndarray:
    """At most `count` of the indices 0 .. size - 1."""
    return np.unique(np.linspace(0, size - 1, min(size, count)).round().astype(np.int64))


def _solved(family: Family, solve: Sequence[str], points: Points) -> dict[str, Array]:
    """The points with the parameters of `solve` from the family's formulas, in that order."""
    solved = dict(points)
    for name in solve:
        solved[name] = np.asarray(family.solve[name](solved), np.float64)
    return solved


def _check_family(scene: Scene, indices: np.ndarray, exists: Mask) -> None:
    """Raise BadInput if the family exists at none of the points, or leaves a solved parameter free."""
    assert scene.family is not None
    family = scene.system.families[scene.family]
    candidates = indices[exists] if exists.any() else indices
    values = parameter_values(scene, candidates[_evenly_spaced(candidates.size, MAX_CHECKED_FORMULAS)])
    base = {name: values[name] for name in scene.system.parameters}
    with np.errstate(all="ignore"):
        solved = _solved(family, scene.solve, base)
        for i, name in enumerate(scene.solve):
            if np.isfinite(solved[name]).any():
                changed = _with_values(family, scene.solve[:i], solved, name, solved[name] + TRIAL_CHANGES)
                _check_not_free(family, name, changed)
            else:
                tried = _with_values(
                    family, scene.solve[:i], base, name, np.zeros_like(base[name]) + TRIAL_VALUES
                )
                tried = _solved(family, scene.solve[i + 1 :], tried)
                _check_not_free(family, name, tried)
                raise BadInput(_no_value_text(family, name, tried))
        if not exists.any():
            raise BadInput(
                f"family.name = {shown(family.name)}: {_failure_text(family, solved)} at the nearest point of the scene"
            )


def _with_values(
    family: Family, solve: Sequence[str], points: Points, name: str, values: Array
) -> dict[str, Array]:
    """The points with values of shape (trials, points) for one parameter, those of `solve` solved again."""
    repeated = {key: np.broadcast_to(column, values.shape) for key, column in points.items()}
    return _solved(family, solve, repeated) | {name: values}


def _check_not_free(family: Family, name: str, points: Points) -> None:
    """Raise BadInput if the points, which differ in one parameter, are all on the family."""
    if (on_family(family, points) < ON_FAMILY).all():
        raise BadInput(
            f"family.solve = {shown(name)}: the family {family.name} leaves it free here, every value is one;"
            " give it in [fixed], [axes] or [ties]"
        )


def _no_value_text(family: Family, name: str, points: Points) -> str:
    """Error for a parameter whose formula gives no value: what fails at the best of the values tried."""
    best = points[name].flat[np.argmin(on_family(family, points))]
    limits = f"; its limits: {family.exists}" if family.exists else ""
    return (
        f"family.name = {shown(family.name)}: no {name} puts any point of the scene on it;"
        f" {_failure_text(family, points)} at {name} = {best:g}, the best of some values tried{limits}"
    )


def _failure_text(family: Family, points: Points) -> str:
    """Which condition fails by how much at the point nearest to the family."""
    residual = on_family(family, points)
    nearest = np.unravel_index(np.argmin(residual), residual.shape)
    if not np.isfinite(residual[nearest]):
        return f"it needs {'; '.join(c.text for c in family.conditions)}, which have no value"
    amounts = [abs(float(condition.residual(points)[nearest])) for condition in family.conditions]
    worst = int(np.argmax(amounts))
    return f"it needs {family.conditions[worst].text}, which fails by {amounts[worst]:.3g} (relative)"
