"""The grid of a scene: axes, ties, family and nudge become points, a range at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from ..errors import BadInput, shown
from ..flags import Status
from ..systems.base import (
    MAX_MAGNITUDE,
    NO_RIGID_BODY,
    Array,
    Family,
    Flags,
    Mask,
    Points,
    System,
    check_possible,
    derived_variables,
    on_family,
    possible_body,
    shape_of,
    within_range,
)
from .checks import check_range
from .model import Duration, Scene

# Points of a tile: a constant, so that results never depend on the tiles.
MAX_POINTS_PER_TILE = 65536
# Bodies, and starts on a family, that are checked before a run; the others are checked with their tile.
MAX_CHECKED_BODIES, MAX_CHECKED_STARTS = 50_000, 10_000
# Points checked one by one before a run, in about a tenth of a second, to count the ones not computed.
MAX_COUNTED = 2**19
# Points at which the formulas of an impossible family are tried for an error message.
MAX_CHECKED_FORMULAS = 100
# Values tried for a parameter where its formula gives none; not 0, where angles have no meaning.
TRIAL_VALUES = np.array([0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 2.5, -2.5])[:, None]
# Changes of a solved parameter; a family that holds after each of them leaves the parameter free.
TRIAL_CHANGES = np.array([1.3, -0.6])[:, None]
# A solved point counts as on its family if its largest condition residual is below this.
ON_FAMILY = 1e-9


class Reason(IntEnum):
    """Why a point of a grid is not computed: the first that applies."""

    NONE = 0  # it is computed
    NO_VALUE = 1  # a tie has no finite value
    IMPOSSIBLE_BODY = 2  # see systems.base.possible_body
    IMPOSSIBLE_START = 3  # see System.possible_start
    NO_MOTION = 4  # the scene's family does not exist
    NO_TURN = 5  # the duration is a number of turns or orbits, and nothing turns


@dataclass(frozen=True)
class Grid:
    """Some points of a scene."""

    # Parameter -> values before the nudge, to which theory applies; float64 of shape (points,)
    base: dict[str, Array]
    points: dict[str, Array]  # parameter -> values of the starts, after the nudge; float64 of shape (points,)
    reason: Flags  # int8 of shape (points,), values of `Reason`: why a point is not computed
    duration: Array  # length of the run in time units; float64 of shape (points,), nan where nothing turns
    step: Array | None = (
        None  # length of a step in time units instead of that of the settings; float64 of shape (points,)
    )

    @property
    def exists(self) -> Mask:
        """Which points are computed, bool of shape (points,)."""
        return np.asarray(self.reason == Reason.NONE)

    def subset(self, where: np.ndarray | slice) -> Grid:
        """Some of the points, by their indices, a mask or a slice."""
        base, points = (
            {name: values[where] for name, values in columns.items()} for columns in (self.base, self.points)
        )
        step = None if self.step is None else self.step[where]
        return Grid(base, points, self.reason[where], self.duration[where], step)


def status_of(reason: Flags) -> Flags:
    """Status of points that are not computed for these reasons, values of flags.Status."""
    status = np.where(reason == Reason.IMPOSSIBLE_BODY, Status.IMPOSSIBLE_BODY, Status.NOT_COMPUTED)
    return status.astype(np.int8)


def parameter_values(scene: Scene, indices: np.ndarray) -> dict[str, Array]:
    """Values of every parameter, axis and tie, before the family is solved; a tie may be inf or nan."""
    parameters = scene.system.parameters
    constants = {**{name: p.default for name, p in parameters.items()}, **scene.fixed}
    # One number in memory for all points, except for ties: NumPy rounds some powers with such an exponent otherwise.
    values: dict[str, Array] = {
        name: np.broadcast_to(np.float64(value), indices.shape) for name, value in constants.items()
    }
    values |= {name: values[name].copy() for tie in scene.ties.values() for name in tie.names & values.keys()}
    for axis, index in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
        if not axis.offset_from_family:
            values[axis.name] = axis.values[index]
    for name, tie in scene.ties.items():
        value = np.broadcast_to(tie.value(values), indices.shape).astype(np.float64)
        finite = value[np.isfinite(value)]
        if name in parameters and finite.size:
            check_range(parameters[name], f"{tie.key} = {shown(tie.text)}", finite.min(), finite.max())
        values[name] = value
    return values


def points_at_indices(scene: Scene, indices: np.ndarray) -> Grid:
    """Points at flat C-order indices of the grid: ties evaluated, family solved, offsets and nudge added.

    Raises BadInput for ties out of range, and for starts or fields given incompletely or twice.
    """
    base, reason, duration = _before_nudge(scene, indices)
    base = {name: np.ascontiguousarray(values) for name, values in base.items()}
    with np.errstate(all="ignore"):
        start = scene.system.as_euler_angles(base) if scene.nudges_angles else base
    points = {name: start[name] + scene.nudge.get(name, 0.0) for name in base}
    return Grid(base, points, reason, duration)


def _before_nudge(scene: Scene, indices: np.ndarray) -> tuple[dict[str, Array], Flags, Array]:
    """Points before the nudge, why they are not computed, and their durations, as in `Grid`."""
    system = scene.system
    values = parameter_values(scene, indices)
    base = {name: values[name] for name in system.parameters}
    no_value = np.any(
        [np.zeros(indices.shape, bool), *(~np.isfinite(values[name]) for name in scene.ties)], axis=0
    )
    with np.errstate(all="ignore"):
        no_motion = no_value
        if scene.family is not None:
            family = system.families[scene.family]
            base = _solved(family, scene.solve, base)
            exists = on_family(family, base) < ON_FAMILY
            possible = possible_body(system, base)
            for name in scene.solve:
                exists &= np.isfinite(base[name])
                base[name] = np.where(possible, base[name], np.nan)
            for axis, index in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
                if axis.offset_from_family:
                    base[axis.name] = base[axis.name] + axis.values[index]
            no_motion = ~exists
        reason = reasons(system, base, no_value, no_motion)
        duration = durations(system, scene.duration, base, "integration.duration")
        reason[(reason == Reason.NONE) & np.isnan(duration)] = Reason.NO_TURN
        has_values = reason != Reason.NO_VALUE
        system.check(
            base if has_values.all() else {name: column[has_values] for name, column in base.items()}
        )
    return base, reason, duration


def reasons(
    system: System, points: Points, no_value: Mask | bool = False, no_motion: Mask | bool = False
) -> Flags:
    """Why points are not computed, their durations apart: values of `Reason`."""
    conditions = {
        Reason.NO_VALUE: no_value,
        Reason.IMPOSSIBLE_BODY: ~possible_body(system, points),
        Reason.IMPOSSIBLE_START: ~system.possible_start(points),
        Reason.NO_MOTION: no_motion,
    }
    return np.select(list(conditions.values()), list(conditions), Reason.NONE).astype(np.int8)


def points_at(scene: Scene, coordinates: Mapping[str, np.ndarray]) -> Grid:
    """Points of a scene at any values along its axes, also off its grid; BadInput as `points_at_indices`."""
    axes, indices = {}, []
    for name, axis in scene.axes.items():
        values, index = np.unique(coordinates[name], return_inverse=True)
        axes[name] = replace(axis, values=values)
        indices.append(index)
    scene = replace(scene, axes=axes)
    return points_at_indices(scene, np.ravel_multi_index(tuple(indices), scene.shape))


def durations(system: System, duration: Duration, points: Points, key: str = "duration") -> Array:
    """Lengths of runs, in time units; nan for turns where nothing turns. BadInput where they overflow."""
    if not duration.unit:
        return np.full(shape_of(points), duration.amount)
    with np.errstate(all="ignore"):
        if duration.unit == "orbits":
            assert system.frame_rate is not None
            rate = np.abs(system.frame_rate(points))
        else:
            _, n, m = system.steady_rates(points)
            n, m = np.abs(n), np.abs(m)
            rate = np.where(n == 0, m, np.where(m == 0, n, np.fmin(n, m)))
        lengths = np.where(rate > 0, duration.amount * 2 * np.pi / rate, np.nan)
    if np.isinf(lengths).any():
        raise BadInput(f"{key} = {shown(str(duration))}: too long at some points, whose rate is small")
    return lengths


def check(scene: Scene) -> Grid:
    """At most MAX_CHECKED_STARTS points, evenly spaced over the grid, at least one of which is computed.

    Raises BadInput if no body, start, tie, family or duration makes sense at any point, for a solved
    parameter that the family leaves free, and for a derived variable without meaning.
    """
    try:
        bodies = _evenly_spaced(scene.size, MAX_CHECKED_BODIES)
        # The ranges of all ties are checked with the values.
        possible = bodies[possible_body(scene.system, parameter_values(scene, bodies))]
        indices = _evenly_spaced(scene.size, MAX_CHECKED_STARTS)
        grid = points_at_indices(scene, indices)
        if not grid.exists.any() and possible.size:
            indices = possible[_evenly_spaced(possible.size, MAX_CHECKED_STARTS)]
            grid = points_at_indices(scene, indices)
        defined = grid.reason != Reason.NO_VALUE
        if not defined.any():
            values = parameter_values(scene, indices[:1])
            name = next(name for name in scene.ties if not np.isfinite(values[name][0]))
            raise BadInput(
                f"{scene.ties[name].key} = {shown(scene.ties[name].text)}: gives {values[name][0]:g}, and no point has"
                " values of all ties"
            )
        check_possible(scene.system, {name: column[defined] for name, column in grid.base.items()})
        if scene.family is not None:
            _check_family(scene, indices, grid.reason)
        if not grid.exists.any():
            raise BadInput(
                f"integration.duration = {shown(str(scene.duration))}: at every point {_NOTHING_TURNS[scene.duration.unit]};"
                " give a number of time units"
            )
        on_grid = grid.subset(grid.exists)
        for name, derived in derived_variables(scene.system).items():
            if name in scene.outputs:
                try:
                    derived.check(on_grid.base, on_grid.duration)
                except BadInput as error:
                    raise BadInput(f"outputs.variables: {name}: {error}") from None
        return grid
    except BadInput as error:
        raise error if scene.source is None else scene.source.located(error) from None


_NOTHING_TURNS = {"turns": "n and m are 0, and nothing turns", "orbits": "the frame does not turn"}


def not_computed(scene: Scene, sample: Grid) -> list[str]:
    """Sentences on the points not computed, by reason, counted or (beyond MAX_COUNTED) from the sample."""
    if scene.size <= MAX_COUNTED:
        counts = np.zeros(len(Reason), np.int64)
        for first in range(0, scene.size, MAX_POINTS_PER_TILE):
            indices = np.arange(first, min(first + MAX_POINTS_PER_TILE, scene.size))
            counts += np.bincount(_before_nudge(scene, indices)[1], minlength=len(Reason))
        return count_lines(counts, scene.system, scene.family, scene.duration)
    counts = np.bincount(sample.reason, minlength=len(Reason))
    shares = {Reason(i): 100 * count / counts.sum() for i, count in enumerate(counts) if i and count}
    return [
        f"about {share:.2g} % of the points: {sentence(reason, scene.system, scene.family, scene.duration)}"
        for reason, share in shares.items()
    ]


def count_lines(counts: np.ndarray, system: System, family: str | None, duration: Duration) -> list[str]:
    """A sentence for each reason that occurs; counts: number of points by `Reason`, shape (len(Reason),)."""
    return [
        f"{count} of {counts.sum()} points: {sentence(Reason(i), system, family, duration)}"
        for i, count in enumerate(counts)
        if i and count
    ]


def sentence(reason: Reason, system: System, family: str | None, duration: Duration) -> str:
    """Why a point of a scene with this family and duration is not computed."""
    return {
        Reason.NONE: "computed",
        Reason.NO_VALUE: "a tie has no finite value",
        Reason.IMPOSSIBLE_BODY: NO_RIGID_BODY,
        Reason.IMPOSSIBLE_START: system.start_condition,
        Reason.NO_MOTION: f"the family {family} has no motion here",
        Reason.NO_TURN: f"duration = {shown(str(duration))}, but {_NOTHING_TURNS.get(duration.unit)}",
    }[reason]


def warnings(scene: Scene, sample: Grid) -> list[str]:
    """Warnings about a scene: points that are `not_computed`, and `system_warnings` of the others."""
    return not_computed(scene, sample) + system_warnings(scene.system, sample.subset(sample.exists).base)


def near_change(values: np.ndarray, window: Sequence[int]) -> Mask:
    """Points of a grid that have another value than one of those within a window around them, of this size along each axis."""
    from scipy.ndimage import maximum_filter, minimum_filter  # slow to import, and most runs do not need it

    return np.asarray(maximum_filter(values, window) != minimum_filter(values, window))


def system_warnings(system: System, points: Points) -> list[str]:
    """Warnings of the system about points that are computed, and some about numbers that are hardly meant."""
    messages = system.warnings(points)
    for name, parameter in system.parameters.items():
        largest = np.abs(points[name]).max(initial=0.0, where=np.isfinite(points[name]))
        if parameter.unit == "rad" and largest > 2 * np.pi:
            messages.append(
                f"{name} reaches {largest:.6g} rad = {float(largest) * 180 / np.pi:.6g} degrees: angles are in rad; in a scene"
                f' {name} = "{largest:.6g} * deg" is one in degrees'
            )
    if not within_range(system, points).all():
        messages.append(
            f"at some points a number is larger than {MAX_MAGNITUDE:g}, or one that must be positive is less than"
            f" {1 / MAX_MAGNITUDE:g}: theory predicts nothing there, and results may overflow"
        )
    return messages


def _evenly_spaced(size: int, count: int) -> np.ndarray:
    """At most `count` of the indices 0 .. size - 1."""
    return np.linspace(0, size - 1, min(size, count)).round().astype(np.int64)


def _solved(family: Family, solve: Sequence[str], points: Points) -> dict[str, Array]:
    """The points with the parameters of `solve` from the family's formulas, in that order."""
    solved = dict(points)
    for name in solve:
        solved[name] = np.asarray(family.solve[name](solved), np.float64)
    return solved


def _check_family(scene: Scene, indices: np.ndarray, reason: Flags) -> None:
    """Raise BadInput if the family exists at none of the points, or leaves a solved parameter free."""
    assert scene.family is not None
    family = scene.system.families[scene.family]
    exists = (reason == Reason.NONE) | (reason == Reason.NO_TURN)
    candidates = indices[exists if exists.any() else reason == Reason.NO_MOTION]
    values = parameter_values(scene, candidates[_evenly_spaced(candidates.size, MAX_CHECKED_FORMULAS)])
    base = {name: values[name] for name in scene.system.parameters}
    with np.errstate(all="ignore"):
        solved = _solved(family, scene.solve, base)
        for i, name in enumerate(scene.solve):
            if np.isfinite(solved[name]).any():
                changed = _with_values(family, scene.solve[:i], solved, name, solved[name] + TRIAL_CHANGES)
                _check_not_free(family, name, changed)
            else:
                trials = _with_values(
                    family, scene.solve[:i], base, name, np.zeros_like(base[name]) + TRIAL_VALUES
                )
                trials = _solved(family, scene.solve[i + 1 :], trials)
                _check_not_free(family, name, trials)
                best = trials[name].flat[np.argmin(on_family(family, trials))]
                limits = f"; its limits: {family.exists}" if family.exists else ""
                raise BadInput(
                    f"family.name = {shown(family.name)}: no {name} puts any point of the scene on it;"
                    f" {_failure_text(family, trials)} at {name} = {best:g}, the best of some values tried{limits}"
                )
        if not exists.any():
            raise BadInput(
                f"family.name = {shown(family.name)}: {_failure_text(family, solved)} at the nearest point of the scene"
            )


def _with_values(
    family: Family, solve: Sequence[str], points: Points, name: str, values: Array
) -> dict[str, Array]:
    """Points with values (trials, points) of one parameter, for which `solve` is solved again."""
    repeated = {key: np.broadcast_to(column, values.shape) for key, column in points.items()}
    return _solved(family, solve, repeated) | {name: values}


def _check_not_free(family: Family, name: str, points: Points) -> None:
    """Raise BadInput if the points, which differ in one parameter, are all on the family, unless its motions fill regions."""
    if family.rate_std is None and (on_family(family, points) < ON_FAMILY).all():
        raise BadInput(
            f"family.solve = {shown(name)}: the family {family.name} leaves it free here, every value is one;"
            " give it in [fixed], [axes] or [ties]"
        )


def _failure_text(family: Family, points: Points) -> str:
    """The condition that fails most at the point nearest to the family, and by how much."""
    residual = on_family(family, points)
    nearest = np.unravel_index(np.argmin(residual), residual.shape)
    if not np.isfinite(residual[nearest]):
        return f"it needs {'; '.join(c.text for c in family.conditions)}, which have no value"
    amounts = [abs(float(condition.residual(points)[nearest])) for condition in family.conditions]
    worst = int(np.argmax(amounts))
    return f"it needs {family.conditions[worst].text}, which fails by {amounts[worst]:.3g} (relative)"
