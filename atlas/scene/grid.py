"""The grid of a scene. Points at any indices are computed from the scene's axes, ties, family and nudge."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from ..errors import BadInput, shown
from ..flags import LABELS, Status
from ..systems.base import (
    MAX_MAGNITUDE,
    NATURAL_RATE,
    NO_RIGID_BODY,
    Array,
    Flags,
    Mask,
    Points,
    SharedValues,
    System,
    check_possible,
    derived_variables,
    families_of,
    on_family,
    possible_body,
    shape_of,
    subset,
    within_range,
)
from ..systems.jacobian import changes_volume
from ..systems.steady import lacks_theory
from .checks import check_range
from .expressions import Expression
from .family import ON_FAMILY, check_solution, near_values, solution
from .model import Duration, Scene, Settings

# Default and upper limit of the environment variable ATLAS_TILE_POINTS.
MAX_POINTS_PER_TILE = 65536
# At most these numbers of bodies and starts are checked before a run. All others are checked when their tiles are computed.
MAX_CHECKED_BODIES, MAX_CHECKED_STARTS = 50_000, 10_000
# On a grid of at most this many points, the points with each `Reason` are counted before a run. This takes about 0.1 s.
MAX_COUNTED = 2**19
# For an error message, the formulas of a family are tried at no more than this many points.
MAX_CHECKED_FORMULAS = 100
# A warning is given if the ratio of the rate tolerance to the natural rate is above this number.
COARSE = 1e-2


def max_points_per_tile() -> int:
    """Return the largest number of points of a tile or chunk, from the environment variable ATLAS_TILE_POINTS if it is set."""
    text = os.environ.get("ATLAS_TILE_POINTS") or str(MAX_POINTS_PER_TILE)
    if text.isascii() and text.isdecimal() and 1 <= int(text[:6]) <= MAX_POINTS_PER_TILE and len(text) <= 6:
        return int(text)
    raise BadInput(
        f"ATLAS_TILE_POINTS = {shown(text)}: allowed: a whole number from 1 to {MAX_POINTS_PER_TILE}"
    )


class Reason(IntEnum):
    """The first reason why a point of a grid is not computed."""

    NONE = 0  # the point is computed
    NO_VALUE = 1  # a tie has no finite value
    IMPOSSIBLE_BODY = 2  # systems.base.possible_body is false
    IMPOSSIBLE_START = 3  # System.possible_start is false
    NO_MOTION = 4  # the family of the scene has no motion here
    NO_DURATION = 5  # the duration has no finite value above 0, or is in turns or orbits but nothing turns
    NO_TOLERANCE = 6  # the arithmetic of the rate tolerance gives no finite value above 0
    NO_TRANSIENT = 7  # the transient has no value, for the reasons of NO_DURATION


@dataclass(frozen=True)
class Grid:
    """Points of a scene, as columns of shape (points,)."""

    base: dict[str, Array]  # parameters without the scene's nudge, for theory
    points: dict[str, Array]  # parameters with the scene's nudge, for the starts of motions
    reason: Flags  # values of `Reason`, int8
    duration: Array  # in time units, nan where the duration has no value
    rate_tolerance: Array  # in rad per time unit, nan where the rate tolerance has no value
    step: Array | None = None  # step sizes in time units, which replace `settings.step`
    transient: Array | float = 0.0  # time before the run, in time units, of each point or of all points

    @property
    def until(self) -> Array:
        """Time from the start to the end of the run, in time units."""
        return self.transient + self.duration

    @property
    def exists(self) -> Mask:
        """Mask of the points that are computed."""
        return np.asarray(self.reason == Reason.NONE)

    def subset(self, where: np.ndarray | slice) -> Grid:
        """Return the points that indices, a mask or a slice select."""
        base, points = subset(self.base, where), subset(self.points, where)
        step = None if self.step is None else self.step[where]
        transient = self.transient if isinstance(self.transient, float) else self.transient[where]
        lengths = self.duration[where], self.rate_tolerance[where], step, transient
        return Grid(base, points, self.reason[where], *lengths)


def status_of(reason: Flags) -> Flags:
    """Return the `flags.Status` of points that are not computed for the given `Reason`."""
    status = np.where(reason == Reason.IMPOSSIBLE_BODY, Status.IMPOSSIBLE_BODY, Status.NOT_COMPUTED)
    return status.astype(np.int8)


def parameter_values(scene: Scene, indices: np.ndarray) -> dict[str, Array]:
    """Return the values of every parameter, axis and tie before the family is solved. A tie may be inf or nan."""
    parameters = scene.system.parameters
    constants = {**{name: p.default for name, p in parameters.items()}, **scene.fixed}
    # Constants are views of a number. Those in ties are full arrays, because NumPy rounds powers with a scalar exponent differently.
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
    """Return the points at flat indices in C order. Raise BadInput if a tie is out of range or a start is incomplete."""
    grid = _before_nudge(scene, indices)
    base = {name: np.ascontiguousarray(values) for name, values in grid.base.items()}
    with np.errstate(all="ignore"):
        start = scene.system.as_euler_angles(base) if scene.nudges_angles else base
    points = {name: start[name] + scene.nudge.get(name, 0.0) for name in base}
    return replace(grid, base=base, points=points)


def _before_nudge(scene: Scene, indices: np.ndarray) -> Grid:
    """Return the points at flat indices in C order. The amounts in `scene.nudge` are not yet added to the start values."""
    system = scene.system
    values = parameter_values(scene, indices)
    base = {name: values[name] for name in system.parameters}
    no_value = np.any(
        [np.zeros(indices.shape, bool), *(~np.isfinite(values[name]) for name in scene.ties)], axis=0
    )
    with np.errstate(all="ignore"):
        no_motion = no_value
        if scene.family is not None:
            family = families_of(system)[scene.family]
            near = near_values(system, family, scene.solve, scene.choice)
            base = solution(family, scene.solve, base, near)
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
        points, names = SharedValues(base), values | base
        duration = durations(system, scene.duration, points, names, "integration.duration")
        rate_tolerance = at_points(system, scene.settings.rate_tolerance, points, names)
        transient = durations(system, scene.transient, points, names, "labels.transient", zero=True)
        without_settings(reason, duration, rate_tolerance, transient)
        has_values = reason != Reason.NO_VALUE
        system.check(base if has_values.all() else subset(base, has_values))
    return Grid(base, base, reason, duration, rate_tolerance, transient=transient)


def without_settings(reason: Flags, *settings: Array) -> None:
    """Set the reason of points that would be computed if the duration, rate tolerance or transient had a value."""
    for value, no_value in zip(settings, list(Reason)[Reason.NO_DURATION :], strict=False):
        reason[(reason == Reason.NONE) & np.isnan(value)] = no_value


def reasons(
    system: System, points: Points, no_value: Mask | bool = False, no_motion: Mask | bool = False
) -> Flags:
    """Return the `Reason` of each point. Body, start, ties and family are checked, but not the settings."""
    conditions = {
        Reason.NO_VALUE: no_value,
        Reason.IMPOSSIBLE_BODY: ~possible_body(system, points),
        Reason.IMPOSSIBLE_START: ~system.possible_start(points),
        Reason.NO_MOTION: no_motion,
    }
    return np.select(list(conditions.values()), list(conditions), Reason.NONE).astype(np.int8)


def points_at(scene: Scene, coordinates: Mapping[str, np.ndarray]) -> Grid:
    """Return points of a scene at any values along the axes, on the grid or not. Raise BadInput as in `points_at_indices`."""
    axes, indices = {}, []
    for name, axis in scene.axes.items():
        values, index = np.unique(coordinates[name], return_inverse=True)
        axes[name] = replace(axis, values=values)
        indices.append(index)
    scene = replace(scene, axes=axes)
    return points_at_indices(scene, np.ravel_multi_index(tuple(indices), scene.shape))


def point_at(scene: Scene, places: Mapping[str, float], what: str) -> Grid:
    """Return the point with the values `places` along all axes. Raise BadInput if an axis is missing or unknown, or no motion exists."""
    for name in (*scene.axes, *places):
        if name not in places or name not in scene.axes:
            problem = "is no axis of the scene" if name in places else "has no value"
            raise BadInput(f"{name}: {problem}; {what} needs a value of every axis: {', '.join(scene.axes)}")
    located = points_at(scene, {name: np.array([value]) for name, value in places.items()})
    if not located.exists[0]:
        why = sentence(Reason(located.reason[0]), scene.system, scene.family, scene.duration)
        raise BadInput(f"no motion: {why}")
    return located


def of_points(
    system: System,
    settings: Settings,
    points: dict[str, Array],
    duration: Duration | Array,
    transient: Duration,
) -> Grid:
    """Return the grid of listed points. `duration` is a Duration, or an array of shape (points,) in time units."""
    values = SharedValues(points)
    lengths = durations(system, duration, values) if isinstance(duration, Duration) else duration
    rate_tolerance = at_points(system, settings.rate_tolerance, values)
    before = durations(system, transient, values, key="transient", zero=True)
    reason = reasons(system, values)
    without_settings(reason, lengths, rate_tolerance, before)
    return Grid(values, values, reason, lengths, rate_tolerance, transient=before)


def at_points(system: System, amount: float | str, points: Points, names: Points | None = None, zero: bool = False) -> Array:  # fmt: skip
    """Return the values of a number or of arithmetic at points, and nan for values that are not finite or not above 0.

    `names` are the values of the names in the arithmetic, by default the parameters. With `zero`, the value 0 is allowed.
    """
    if not isinstance(amount, str):
        return np.full(shape_of(points), amount)
    expression, names = Expression("", amount), dict(points if names is None else names)
    if NATURAL_RATE in expression.names:
        names[NATURAL_RATE] = system.natural_rate(points)
    values = np.broadcast_to(expression.value(names), shape_of(points))
    return np.where(np.isfinite(values) & ((values > 0) | (zero & (values == 0))), values, np.nan)


def durations(
    system: System, duration: Duration, points: Points, names: Points | None = None, key: str = "duration", *,
    zero: bool = False,
) -> Array:  # fmt: skip
    """Return durations in time units, or nan where `at_points` gives nan or nothing turns. Raise BadInput if a duration is infinite."""
    if isinstance(duration.amount, str) or not duration.unit:
        return at_points(system, duration.amount, points, names, zero=zero)
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
    """Check a scene, and return at most MAX_CHECKED_STARTS points, evenly spaced over the grid. At least one point can be computed.

    Raise BadInput if no point can be computed, if the family leaves a solved parameter free, or if an output does not apply.
    """
    try:
        bodies = _even_indices(scene.size, MAX_CHECKED_BODIES)
        # `parameter_values` also checks the ranges of ties.
        possible = bodies[possible_body(scene.system, parameter_values(scene, bodies))]
        indices = _even_indices(scene.size, MAX_CHECKED_STARTS)
        grid = points_at_indices(scene, indices)
        if not grid.exists.any() and possible.size:
            indices = possible[_even_indices(possible.size, MAX_CHECKED_STARTS)]
            grid = points_at_indices(scene, indices)
        defined = grid.reason != Reason.NO_VALUE
        if not defined.any():
            values = parameter_values(scene, indices[:1])
            name = next(name for name in scene.ties if not np.isfinite(values[name][0]))
            raise BadInput(
                f"{scene.ties[name].key} = {shown(scene.ties[name].text)}: gives {values[name][0]:g}, and no point has"
                " values of all ties"
            )
        check_possible(scene.system, subset(grid.base, defined))
        if scene.family is not None:
            exists = (grid.reason == Reason.NONE) | (grid.reason >= Reason.NO_DURATION)
            candidates = indices[exists if exists.any() else grid.reason == Reason.NO_MOTION]
            chosen = candidates[_even_indices(candidates.size, MAX_CHECKED_FORMULAS)]
            values = parameter_values(scene, chosen)
            base = {name: values[name] for name in scene.system.parameters}
            family = families_of(scene.system)[scene.family]
            near = near_values(scene.system, family, scene.solve, scene.choice)
            check_solution(family, scene.solve, base, near, exists=bool(exists.any()))
        if not grid.exists.any():
            raise BadInput(
                f"integration.duration = {shown(str(scene.duration))}: at every point {_NOTHING_TURNS[scene.duration.unit]};"
                " give a number of time units"
                if (grid.reason == Reason.NO_DURATION).any()
                else f"labels.rate_tolerance = {shown(str(scene.settings.rate_tolerance))}: at every point {_NO_NUMBER}"
                if (grid.reason == Reason.NO_TOLERANCE).any()
                else f"labels.transient = {shown(str(scene.transient))}: at no point a finite time of at least 0"
            )
        on_grid = grid.subset(grid.exists)
        for name, derived in derived_variables(scene.system).items():
            if name in scene.outputs:
                try:
                    if derived.from_start and scene.transient.amount:
                        raise BadInput("it is of the motion from its start, not after a transient")
                    derived.check(on_grid.base, on_grid.duration)
                except BadInput as error:
                    raise BadInput(f"outputs.variables: {name}: {error}") from None
        return grid
    except BadInput as error:
        raise error if scene.source is None else scene.source.located(error) from None


_NO_NUMBER = "it is no finite number above 0"
_NOTHING_TURNS = {
    "": _NO_NUMBER,
    "turns": "n and m are 0, and nothing turns",
    "orbits": "the frame does not turn",
}


def not_computed(scene: Scene, sample: Grid) -> list[str]:
    """Return a sentence for each reason why points are not computed. Above MAX_COUNTED points, the sample gives fractions."""
    if scene.size <= MAX_COUNTED:
        counts = np.zeros(len(Reason), np.int64)
        length = max_points_per_tile()
        for first in range(0, scene.size, length):
            indices = np.arange(first, min(first + length, scene.size))
            counts += np.bincount(_before_nudge(scene, indices).reason, minlength=len(Reason))
        return count_lines(counts, scene.system, scene.family, scene.duration)
    counts = np.bincount(sample.reason, minlength=len(Reason))
    shares = {Reason(i): 100 * count / counts.sum() for i, count in enumerate(counts) if i and count}
    return [
        f"about {share:.2g} % of the points: {sentence(reason, scene.system, scene.family, scene.duration)}"
        for reason, share in shares.items()
    ]


def count_lines(counts: np.ndarray, system: System, family: str | None, duration: Duration) -> list[str]:
    """Return a sentence for each reason that occurs. counts[i] is the number of points with the Reason i."""
    return [
        f"{count} of {counts.sum()} points: {sentence(Reason(i), system, family, duration)}"
        for i, count in enumerate(counts)
        if i and count
    ]


def sentence(reason: Reason, system: System, family: str | None, duration: Duration) -> str:
    """Return a text that says why a point is not computed. `family` and `duration` are those of the scene."""
    return {
        Reason.NONE: "computed",
        Reason.NO_VALUE: "a tie has no finite value",
        Reason.IMPOSSIBLE_BODY: NO_RIGID_BODY,
        Reason.IMPOSSIBLE_START: system.start_condition,
        Reason.NO_MOTION: f"the family {family} has no motion here",
        Reason.NO_DURATION: f"duration = {shown(str(duration))}, but {_NOTHING_TURNS[duration.unit]}",
        Reason.NO_TOLERANCE: "rate_tolerance is no finite number above 0",
        Reason.NO_TRANSIENT: "transient is no finite time of at least 0",
    }[reason]


def warnings(scene: Scene, sample: Grid) -> list[str]:
    """Return warnings about points that are not computed, and about unusual parameters or settings of all other points."""
    points = sample.subset(sample.exists)
    return [
        *not_computed(scene, sample),
        *system_warnings(scene.system, points.base),
        *unit_warnings(scene.system, scene.outputs, points, whole=sample.reason.size == scene.size),
        *([] if scene.nudge else settling_warnings(scene.system, points)),
    ]


def unit_warnings(system: System, outputs: Collection[str], points: Grid, *, whole: bool = True) -> list[str]:
    """Return warnings about rate tolerances and durations that are unusual for the natural rates of the points.

    `whole` is true if `points` contains every computed point of the scene, and false if `points` is a sample.
    """
    if type(system).natural_rate is System.natural_rate or set(LABELS).isdisjoint(outputs):
        return []
    with np.errstate(all="ignore"):
        rate, messages = system.natural_rate(points.base), list[str]()
        coarse = points.rate_tolerance > COARSE * rate
        short = points.duration * rate < 2 * np.pi
    for where, text in (
        (coarse, f"rate_tolerance is above {COARSE:g} * natural_rate, and slow motions count as none"),
        (short, "the duration is shorter than a period of natural_rate, and what is slower looks steady"),
    ):
        if where.any():
            share = f"{where.sum()} of {where.size}" if whole else f"about {100 * where.mean():.3g} % of the"
            low, high = rate[where].min(), rate[where].max()
            messages.append(
                f"{share} points: {text}; natural_rate is {_interval(low, high)} rad per time unit there"
            )
    return messages


def settling_warnings(system: System, points: Grid) -> list[str]:
    """Return a warning, in a list, about transients of motions that never settle, because they conserve phase volume."""
    if not np.any(points.transient):
        return []
    points = points.subset(_even_indices(points.duration.size, MAX_CHECKED_STARTS))
    state, constants = system.initial_state(points.points), system.constants(points.points)
    changes = [changes_volume(system.equations, factor * state, constants) for factor in (1.0, 1.1)]
    share = 100 * float(((points.transient > 0) & ~np.any(changes, axis=0)).mean())
    text = f"transient: nothing damps the motion at {share:.3g} % of the points, where it never settles"
    return [text] if share else []


def settings_lines(scene: Scene, sample: Grid) -> list[str]:
    """Return a list of one sentence with the ranges of a duration, rate tolerance and transient given as formulas, or an empty list."""
    settings = (
        ("duration", scene.duration.amount, sample.duration, "time units"),
        ("rate_tolerance", scene.settings.rate_tolerance, sample.rate_tolerance, "rad per time unit"),
        ("transient", scene.transient.amount, np.asarray(sample.transient), "time units"),
    )
    texts = [
        f'{name} = "{amount}" is {_interval(values[sample.exists].min(), values[sample.exists].max())} {unit}'
        for name, amount, values, unit in settings
        if isinstance(amount, str)
    ]
    return ["; ".join(texts)] if texts else []


def _interval(low: float, high: float) -> str:
    """Return the text of an interval, which is a single number if both ends print alike."""
    return f"{low:.4g}" if f"{low:.4g}" == f"{high:.4g}" else f"{low:.4g} to {high:.4g}"


def near_change(values: np.ndarray, window: Sequence[int]) -> Mask:
    """Return a mask of the grid points whose window contains different values. `window` has the number of points along each axis."""
    from scipy.ndimage import maximum_filter, minimum_filter  # a slow import that most runs do not need

    return np.asarray(maximum_filter(values, window) != minimum_filter(values, window))


def system_warnings(system: System, points: Points) -> list[str]:
    """Return the warnings of a system about points, and warnings about lacking theory, angles in degrees and extreme numbers."""
    messages = system.warnings(points)
    if lacks_theory(system, points).any():
        messages.append(
            "at some points the third axis stays on the vertical and the rate about it changes:"
            " no installed extension has the theory of such motions, and nothing is predicted there"
        )
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


def _even_indices(size: int, count: int) -> np.ndarray:
    """Return at most `count` evenly spaced indices from 0 to size - 1."""
    return np.linspace(0, size - 1, min(size, count)).round().astype(np.int64)
