"""One set of points, from parameters to labels beside theory: what a tile and `label_points` share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Set
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from . import compare, labels
from .engine import jit, lanes, measure, steps
from .engine.runge_kutta import METHODS
from .grid import Grid
from .scene import Scene, Settings
from .systems.system import Array, Points, System


@dataclass(frozen=True)
class Special:
    """What the kernels of a whole scene may leave out; each is compiled once and cached."""

    zero: frozenset[str] = frozenset()  # constants that are 0
    same: frozenset[tuple[str, str]] = frozenset()  # constants of which the first equals the second

    @classmethod
    def of(cls, system: System, zero: Set[str], symmetric: bool) -> Special:
        """Where these parameters are 0 (or absent) and A = B (or not) at every point."""
        gone, same = system.special(zero, symmetric)
        return cls(frozenset(gone), frozenset(same))

    @classmethod
    def of_points(cls, system: System, points: Points) -> Special:
        """For points that are all there is."""
        zero = {name for name, values in points.items() if ((values == 0) | np.isnan(values)).all()}
        return cls.of(system, zero, bool((points["A"] == points["B"]).all()))


FULL = Special()
# What only a whole run can give; a scene that asks for none of these ends its points early.
STATISTICS = {
    "theta_dot_rms", "theta_dot_std", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std",
    "normal_rate_mean", "normal_rate_std", "theta_min", "theta_max", "integral_drift",
}  # fmt: skip


@cache
def _source(system: System, method: str, special: Special) -> str:
    return lanes.source(system.equations, method, special.zero, dict(special.same))


@cache
def kernel(system: System, method: str, special: Special = FULL) -> ModuleType:
    """The compiled module that integrates a system; compiled or taken from the cache at its first call."""
    return jit.load(_source(system, method, special))


@cache
def kernel_hash(system: System, method: str, special: Special = FULL) -> str:
    """Hash of the kernel's source, compilers and processor type, recorded in every atlas."""
    return jit.digest(_source(system, method, special))


def evaluate_tile(
    scene: Scene,
    tile: Grid,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """`evaluate` for some points of a scene, as the scene asks for it; only its outputs are sure to be there."""
    return evaluate(
        scene.system, tile.base, tile.points, tile.duration, scene.settings,
        special=Special.of(scene.system, *scene.vanishing()), outputs=scene.outputs,
        nudged=bool(scene.nudge), there=tile.there, threads=threads, progress=progress,
    )  # fmt: skip


def scene_kernel_hash(scene: Scene) -> str:
    """Hash of the kernel that the points of a scene are integrated with."""
    return kernel_hash(scene.system, scene.settings.method, Special.of(scene.system, *scene.vanishing()))


def evaluate(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    *,
    special: Special = FULL,
    outputs: Collection[str] | None = None,
    nudged: bool = False,
    there: np.ndarray | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """Integrate, measure, label and compare: every variable of the registry, each of shape (points,).

    base: the points before the nudge, for theory; points: the starts to integrate; there: bool, the
    others are not computed (their flags are 0, their numbers nan). duration: (points,), time units.
    special: what the kernel leaves out, the same for all points of a scene. outputs: names of the
    variables that are wanted, None: every one but the system's layers. Statistics that are not wanted
    may be missing or cover a part of the run: without them a point ends when its label is certain.
    """
    if there is not None and not there.all():
        where = np.flatnonzero(there)
        part = evaluate(
            system, _take(base, where), _take(points, where), duration[where], settings,
            special=special, outputs=outputs, nudged=nudged, threads=threads, progress=progress,
        )  # fmt: skip
        return {name: _spread(values, there) for name, values in part.items()}

    method = METHODS[settings.method]
    constants, state = system.constants(points), np.ascontiguousarray(system.start(points))
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
        plan = steps.choose(
            method, bound, duration,
            tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
        )  # fmt: skip
        scales = measure.scales(system.equations, state, constants, dict(system.conserved(points)))
    module, total = kernel(system, settings.method, special), int(plan.count.sum())

    def advance(point_steps: int) -> None:
        if progress is not None:
            progress(duration.size * point_steps / total)

    constants = np.ascontiguousarray(constants)
    intervals = plan.count // plan.stride
    if outputs is not None and not set(outputs) & STATISTICS:
        out, done = lanes.integrate_labels(
            module, plan.count, plan.stride, plan.length, state, constants, scales,
            settings.cylinder, settings.rate_tolerance, threads=threads, progress=advance,
        )  # fmt: skip
    else:
        out, done = lanes.integrate(
            module, lanes.plan(plan.count, plan.stride), plan.length, state, constants, scales,
            settings.cylinder, threads=threads, progress=advance,
        ), intervals  # fmt: skip
    certain = done < intervals
    result = measure.finish(out, done)
    cylinder = labels.in_cylinder(result, settings.cylinder)
    finite = np.asarray(np.isfinite(state).all(0) & np.isfinite(out).all(0))

    with np.errstate(all="ignore"):
        theory = compare.theory(system, base, settings.rate_tolerance, nudged)
        residual = system.condition_residual(points)
    # Rounding has nothing to grow from where the third axis never left the vertical by a bit.
    growing = np.nan_to_num(theory["growth_rate"] * duration, nan=0.0)
    exact = np.where(nudged | (result["sine_max"] == 0.0), 0.0, growing)
    status = labels.status(
        finite, result["integral_drift"], settings.drift_tolerance, plan.step_ratio, plan.hidden_damping,
        exact, settings.rate_tolerance,
    )  # fmt: skip
    trusted = status == labels.STATUS_VALUE["ok"]

    with np.errstate(invalid="ignore"):
        frames: dict[str, Array | float] = {"label": 0.0}
        if system.frame_rate is not None:
            frames["label_inertial"] = system.frame_rate(points)
        for name, rate in frames.items():
            found = labels.label(result, settings.rate_tolerance, settings.cylinder, rate)
            found[certain] = labels.DRIFTING
            result[name] = np.where(trusted, found, labels.UNRESOLVED).astype(np.int8)
        steady = trusted & (result["label"] != labels.DRIFTING)
        result["geometry"] = system.geometry(
            result, steady, cylinder, settings.rate_tolerance, settings.cylinder
        )
    for name in ("psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"):
        result[name] = np.where(cylinder, np.nan, result[name])
    result |= theory
    result |= {
        "status": status,
        "step": plan.length,
        "step_ratio": plan.step_ratio,
        "error_estimate": plan.phase_error,
        "condition_residual": residual,
        "end_time": np.where(certain, done * plan.stride * plan.length, duration),
        "agreement": compare.agreement(result["label"], theory["predicted"]),
    }
    for name, layer in system.layers.items():
        if outputs is not None and name in outputs:
            result[name] = layer.values(base, duration)
    return result


def _take(points: Points, keep: np.ndarray) -> dict[str, Array]:
    return {name: values[keep] for name, values in points.items()}


def _spread(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    full = np.full(there.shape, np.nan if values.dtype.kind == "f" else 0, values.dtype)
    full[there] = values
    return full
