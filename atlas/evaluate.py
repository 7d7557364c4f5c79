"""One set of points, from parameters to labels beside theory: what a tile and `label_points` share."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cache
from types import ModuleType

import numpy as np

from . import compare, labels
from .engine import jit, lanes, measure, steps
from .engine.runge_kutta import METHODS
from .scene import Settings
from .systems.system import Array, Points, System


@cache
def kernel(system: System, method: str) -> ModuleType:
    """The compiled module that integrates a system; compiled or taken from the cache at its first call."""
    return jit.load(lanes.source(system.equations, method))


@cache
def kernel_hash(system: System, method: str) -> str:
    """Hash of the kernel's source, compilers and processor type, recorded in every atlas."""
    return jit.digest(lanes.source(system.equations, method))


def evaluate(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    *,
    outputs: Collection[str] = (),
    nudged: bool = False,
    there: np.ndarray | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """Integrate, measure, label and compare: every variable of the registry, each of shape (points,).

    base: the points before the nudge, for theory; points: the starts to integrate; there: bool, the
    others are not computed (their flags are 0, their numbers nan). duration: (points,), time units.
    outputs: the system's layers to compute as well are those named here.
    """
    if there is not None and not there.all():
        where = np.flatnonzero(there)
        part = evaluate(
            system, _take(base, where), _take(points, where), duration[where], settings,
            outputs=outputs, nudged=nudged, threads=threads, progress=progress,
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
    blocks = lanes.plan(plan.count, plan.stride)

    def advance(point_steps: int) -> None:
        if progress is not None:
            progress(duration.size * point_steps / blocks.point_steps)

    out = lanes.integrate(
        kernel(system, settings.method), blocks, plan.length, state, np.ascontiguousarray(constants),
        scales, settings.cylinder, threads=threads, progress=advance,
    )  # fmt: skip
    intervals = plan.count // plan.stride
    result = measure.finish(out, intervals)
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

    def keep(label: np.ndarray) -> np.ndarray:
        return np.where(trusted, label, labels.UNRESOLVED).astype(np.int8)

    with np.errstate(invalid="ignore"):
        own = labels.label(result, settings.rate_tolerance, settings.cylinder)
        result["label"] = keep(own)
        if system.frame_rate is not None:
            rate = system.frame_rate(points)
            result["label_inertial"] = keep(
                labels.label(result, settings.rate_tolerance, settings.cylinder, rate)
            )
        steady = trusted & (own != labels.DRIFTING)
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
        "end_time": duration.copy(),
        "agreement": compare.agreement(result["label"], theory["predicted"]),
    }
    for name, layer in system.layers.items():
        if name in outputs:
            result[name] = layer.values(base, duration)
    return result


def _take(points: Points, keep: np.ndarray) -> dict[str, Array]:
    return {name: values[keep] for name, values in points.items()}


def _spread(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    full = np.full(there.shape, np.nan if values.dtype.kind == "f" else 0, values.dtype)
    full[there] = values
    return full
