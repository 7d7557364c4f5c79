"""The grid of a scene: axes, ties, family and nudge become labelled points, a range at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import Duration, Scene, check_range
from .systems.system import Array, BadInput, Points, System, on_family

# Points per tile: a constant, so that results never depend on how a run was cut.
TILE = 65536
# At most this many bodies, and starts on a family, are checked before a run; others when their tile comes.
CHECKED_BODIES, CHECKED_STARTS = 50_000, 10_000
# A solved point counts as on its family if its largest condition residual is below this.
ON_FAMILY = 1e-9


@dataclass(frozen=True)
class Grid:
    """A range of a scene's points, every array of shape (points,)."""

    base: dict[str, Array]  # before the nudge, where theory speaks
    points: dict[str, Array]  # the starts
    there: np.ndarray  # bool: does the family exist at the point?
    duration: Array  # time units


def names(scene: Scene, indices: np.ndarray) -> dict[str, np.ndarray]:
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


def take(scene: Scene, indices: np.ndarray) -> Grid:
    """The points at flat C-order indices of the scene's grid. Raises BadInput for impossible bodies."""
    system = scene.system
    known = names(scene, indices)
    base = {name: known[name] for name in system.parameters}
    system.check(base)
    there = np.ones(indices.shape, bool)
    if scene.family is not None:
        family = system.families[scene.family]
        with np.errstate(all="ignore"):
            for name in scene.solve:
                base[name] = np.asarray(family.solve[name](base), np.float64)
            there = on_family(family, base) < ON_FAMILY
        for name in scene.solve:
            there &= np.isfinite(base[name])
        place = np.unravel_index(indices, scene.shape)
        for axis, where in zip(scene.axes.values(), place, strict=True):
            if axis.offset_from_family:
                base[axis.name] = base[axis.name] + np.asarray(axis.values)[where]
        if there.any():
            system.check({name: values[there] for name, values in base.items()})
    start = system.by_angles(base) if scene.nudges_angles else base
    points = {name: start[name] + scene.nudge.get(name, 0.0) for name in base}
    return Grid(base, points, there, durations(system, scene.duration, base))


def durations(system: System, duration: Duration, points: Points) -> Array:
    """Length of each run in time units."""
    shape = np.shape(points["n"])
    if duration.unit == "orbits":
        assert system.frame_rate is not None
        rate = np.abs(system.frame_rate(points))
    elif duration.unit == "turns":
        _, n, m = system.steady(points)
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
    scene.system.check({k: v for k, v in names(scene, bodies).items() if k in scene.system.parameters})
    grid = take(scene, indices)
    if not grid.there.any():
        raise BadInput(f"family.name = {scene.family!r}: {_why_not(scene, indices)}")
    some = {name: values[grid.there] for name, values in grid.base.items()}
    for name, layer in scene.system.layers.items():
        if name in scene.outputs:
            try:
                layer.check(some)
            except BadInput as complaint:
                raise BadInput(f"outputs.variables: {name}: {complaint}") from None
    return grid


def _why_not(scene: Scene, indices: np.ndarray) -> str:
    """Which condition of the family fails, and by how much at best."""
    assert scene.family is not None
    family = scene.system.families[scene.family]
    base = {name: values for name, values in names(scene, indices).items() if name in scene.system.parameters}
    with np.errstate(all="ignore"):
        for name in scene.solve:
            base[name] = np.asarray(family.solve[name](base), np.float64)
        for name in scene.solve:
            if not np.isfinite(base[name]).any():
                return f"no {name} puts any point of the scene on it; it needs {_conditions(family)}"
        best = int(np.argmin(on_family(family, base)))
        residuals = [abs(float(c.residual(base)[best])) for c in family.conditions]
    worst = int(np.nanargmax(residuals)) if not np.isnan(residuals).all() else 0
    return (
        f"it needs {family.conditions[worst].text}, which fails by {residuals[worst]:.3g}"
        " (relative) at the nearest point of the scene"
    )


def _conditions(family) -> str:
    return "; ".join(c.text for c in family.conditions)
