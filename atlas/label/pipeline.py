"""One set of points, from parameters to labels beside theory: what a tile and `label_points` share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Set
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from ..engine import blocks, jit, measure, stepsize, template
from ..engine.tableaux import METHODS
from ..flags import Label, Status
from ..scene.grid import Grid
from ..scene.model import Scene, Settings
from ..systems.base import Array, Mask, Points, System
from . import labels
from .theory import agreement, predict


@dataclass(frozen=True)
class Specialization:
    """What the kernels of a whole scene may leave out; each is compiled once and cached."""

    zero: frozenset[str] = frozenset()  # constants that are 0
    same: frozenset[tuple[str, str]] = frozenset()  # constants of which the first equals the second

    @classmethod
    def of(cls, system: System, zero: Set[str], symmetric: bool) -> Specialization:
        """Where these parameters are 0 (or absent) and A = B (or not) at every point."""
        gone, same = system.specialization(zero, symmetric)
        return cls(frozenset(gone), frozenset(same))

    @classmethod
    def of_points(cls, system: System, points: Points) -> Specialization:
        """For points that are all there is."""
        zero = {name for name, values in points.items() if ((values == 0) | np.isnan(values)).all()}
        return cls.of(system, zero, bool((points["A"] == points["B"]).all()))


GENERIC = Specialization()
RATES = (
    "theta_dot_rms", "theta_dot_std", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std",
    "normal_rate_mean", "normal_rate_std",
)  # fmt: skip
# What only a whole run can give; a scene that asks for none of these ends its points early.
STATISTICS = {*RATES, "theta_min", "theta_max", "integral_drift"}

# What a label is decided from.
LABEL_STATISTICS = (
    "theta_dot_rms", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std", "normal_rate_std",
    "theta_min", "theta_max", "sine_max",
)  # fmt: skip
# check_half_step = "sample" integrates one point in so many again.
POINTS_PER_HALF_STEP = 64
# A start beside an unstable motion leaves it by physics if it leaves alike at half the step.
HALF_STEP_RTOL = 0.05


@cache
def _source(system: System, method: str, special: Specialization) -> str:
    return template.source(system.equations, method, special.zero, dict(special.same))


@cache
def kernel(system: System, method: str, special: Specialization = GENERIC) -> ModuleType:
    """The compiled module that integrates a system; compiled or taken from the cache at its first call."""
    return jit.load(_source(system, method, special))


@cache
def kernel_hash(system: System, method: str, special: Specialization = GENERIC) -> str:
    """Hash of the kernel's source, compilers and processor type, recorded in every atlas."""
    return jit.digest(_source(system, method, special))


def evaluate_tile(
    scene: Scene,
    tile: Grid,
    *,
    halved: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """`evaluate` for some points of a scene, as the scene asks for it; only its outputs are sure to be there."""
    return evaluate(
        scene.system, tile.base, tile.points, tile.duration, scene.settings,
        special=Specialization.of(scene.system, *scene.vanishing()), outputs=scene.outputs,
        nudged=bool(scene.nudge), there=tile.there, halved=halved, threads=threads, progress=progress,
    )  # fmt: skip


def scene_kernel_hash(scene: Scene) -> str:
    """Hash of the kernel that the points of a scene are integrated with."""
    return kernel_hash(
        scene.system, scene.settings.method, Specialization.of(scene.system, *scene.vanishing())
    )


def evaluate(
    system: System,
    base: Points,
    points: Points,
    duration: Array,
    settings: Settings,
    *,
    special: Specialization = GENERIC,
    outputs: Collection[str] | None = None,
    nudged: bool = False,
    there: np.ndarray | None = None,
    halved: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray]:
    """Integrate, measure, label and compare: every variable of the registry, each of shape (points,).

    base: the points before the nudge, for theory; points: the starts to integrate; there: bool, the
    others are not computed (their flags are 0, their numbers nan). duration: (points,), time units.
    special: what the kernel leaves out, the same for all points of a scene. outputs: names of the
    variables that are wanted, None: every one but the system's layers. Statistics that are not wanted
    may be missing or cover a part of the run: without them a point ends when its label is certain.
    halved: at half the step that the settings give.
    """
    if there is not None and not there.all():
        where = np.flatnonzero(there)
        part = evaluate(
            system, _subset(base, where), _subset(points, where), duration[where], settings,
            special=special, outputs=outputs, nudged=nudged, halved=halved, threads=threads, progress=progress,
        )  # fmt: skip
        return {name: _scatter(values, there) for name, values in part.items()}

    method = METHODS[settings.method]
    with np.errstate(all="ignore"):  # parameters may overflow: such points end up unresolved
        constants, state = system.constants(points), np.ascontiguousarray(system.initial_state(points))
        bound = system.frequency_bound(points)
        plan = stepsize.choose(
            method, bound, duration,
            tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
            rate_tolerance=settings.rate_tolerance,
        )  # fmt: skip
        plan = plan.halved(method) if halved else plan
        theory = predict(system, base, settings.rate_tolerance, nudged)
        residual = system.condition_residual(points)
        growth = np.minimum(np.nan_to_num(theory["growth_rate"] * duration, nan=0.0), 700.0)
        growing = np.zeros_like(bound) if nudged else growth
        # Beside an unstable motion the method's own error grows, too.
        seeded = plan.rate_error * np.exp(growing) > settings.rate_tolerance
        seeded &= growing > 0
        certain_rate = np.where(seeded, np.inf, _early_stop_rate(plan, bound, settings))
        scales = measure.scales(system.equations, state, constants, dict(system.integral_scales(points)))
    module, total = kernel(system, settings.method, special), int(plan.count.sum())

    def advance(point_steps: int) -> None:
        if progress is not None:
            progress(duration.size * point_steps / total)

    constants = np.ascontiguousarray(constants)
    first = state.copy()
    looks = plan.count // plan.stride
    if outputs is not None and not set(outputs) & STATISTICS:
        out, done = blocks.integrate_labels(
            module, plan.count, plan.stride, plan.parts, plan.length, state, constants, scales,
            settings.cylinder, certain_rate, threads=threads, progress=advance,
        )  # fmt: skip
    else:
        out, done = blocks.integrate(
            module, blocks.pack_blocks(plan.count, plan.stride, plan.parts), plan.length, state, constants, scales,
            settings.cylinder, threads=threads, progress=advance,
        ), looks  # fmt: skip
    certain = done < looks
    time = np.where(certain, done * plan.stride * plan.length, duration)
    samples = done * plan.parts
    result = measure.finish(out, samples, plan.parts)
    cylinder = labels.in_cylinder(result, settings.cylinder)
    finite = np.asarray(np.isfinite(state).all(0) & np.isfinite(out).all(0))

    # Rounding has nothing to grow from where the third axis never left the vertical by a bit.
    exact = np.where(result["sine_max"] == 0.0, 0.0, growing)

    def status(sensitive: np.ndarray | bool) -> np.ndarray:
        return labels.status(
            finite, result["integral_drift"], settings.drift_tolerance, plan.step_ratio, plan.hidden_damping,
            exact, settings.rate_tolerance, sensitive,
        )  # fmt: skip

    frames = {"label": np.zeros_like(duration)}
    if system.frame_rate is not None:
        frames["label_inertial"] = system.frame_rate(points)
    with np.errstate(all="ignore"):
        called = labels.label(result, settings.rate_tolerance, settings.cylinder)
        resolved = status(False) == Status.OK
        # What leaves may not have been sent by physics; where the start is exact to rounding it was not.
        left = resolved & (exact > 0) & seeded & (called == Label.DRIFTING)
        sensitive = left & (residual <= stepsize.ROUNDING * np.sqrt(plan.count))
        doubtful = _half_step_sample(first, constants, settings.check_half_step)
        doubtful |= _unsure(result, _expected_error(plan, bound, result), settings, frames)
        doubtful = resolved & ~sensitive & ~certain & (doubtful | left)
    error = np.maximum(_error_estimate(plan, growth, out, samples, duration), result["integral_drift"])
    if doubtful.any():
        where, half = np.flatnonzero(doubtful), plan.halved(method)
        again = blocks.integrate(
            module, blocks.pack_blocks(half.count[where], half.stride[where], half.parts[where]), half.length[where],
            first[:, where].copy(), constants[:, where].copy(), scales[:, where].copy(),
            settings.cylinder, threads=threads,
        )  # fmt: skip
        twice = measure.finish(again, half.intervals[where], half.parts[where])
        once = _subset(result, where)
        sensitive[where] = _changed(once, twice, settings, _subset(frames, where))
        apart = (
            np.abs(once["theta_dot_rms"] - twice["theta_dot_rms"]) > HALF_STEP_RTOL * twice["theta_dot_rms"]
        )
        sensitive[where] |= left[where] & apart
        changes = [np.abs(twice[name] - once[name]) for name in RATES]
        error[where] = np.fmax(error[where], np.fmax.reduce(changes) / bound[where])
    status_value = status(sensitive)
    trusted = status_value == Status.OK

    with np.errstate(invalid="ignore"):
        for name, rate in frames.items():
            found = labels.label(result, settings.rate_tolerance, settings.cylinder, rate)
            found[certain] = Label.DRIFTING
            result[name] = np.where(trusted, found, Label.UNRESOLVED).astype(np.int8)
        steady = trusted & (result["label"] != Label.DRIFTING)
        result["geometry"] = system.geometry(
            result, steady, cylinder, settings.rate_tolerance, settings.cylinder
        )
    for name in ("psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"):
        result[name] = np.where(cylinder, np.nan, result[name])
    result |= theory
    result |= {
        "status": status_value,
        "step": plan.length,
        "step_ratio": plan.step_ratio,
        "error_estimate": error,
        "condition_residual": residual,
        "end_time": time,
        "agreement": agreement(result["label"], theory["predicted"]),
    }
    for name, layer in system.derived.items():
        if outputs is not None and name in outputs:
            result[name] = layer.values(base, duration)
    return result


def _error_estimate(
    plan: stepsize.StepSizes, growth: Array, out: Array, samples: np.ndarray, duration: Array
) -> Array:
    """Relative error of states and rates that can be foreseen, (points,): of an oscillation at the bound, grown
    as the motion's instability does (to 1 at most); and, where the axis was in the cylinder for a part of the run,
    the sample more or less that is outside."""
    error = np.maximum(plan.phase_error, plan.hidden_damping)
    with np.errstate(over="ignore"):
        error = np.where(growth > 0, np.minimum(error * np.exp(growth), np.maximum(error, 1.0)), error)
    outside, least = out[measure.OUTPUTS.index("outside")], measure.WEIGHTS.min()
    crossed = (outside > 0.0) & (outside < samples - 0.5 * least)
    return np.asarray(np.where(crossed, np.maximum(error, plan.distance / duration), error))


def _early_stop_rate(plan: stepsize.StepSizes, bound: Array, settings: Settings) -> Array:
    """Rate above which no expected error can take a drifting point back, (points,), rad per time unit."""
    near = plan.rate_error + bound * stepsize.ROUNDING * np.sqrt(plan.count) / settings.cylinder
    return (settings.rate_tolerance + near) / (1.0 - np.minimum(_relative_error(plan, bound), 1.0))


def _relative_error(plan: stepsize.StepSizes, bound: Array) -> Array:
    """Of the spread of a rate: phase and amplitude of what oscillates, and the rule that sums the samples."""
    rule = np.where(
        plan.intervals < measure.MIN_INTERVALS,
        1.0,
        (0.5 * bound * plan.distance) ** 8,
    )
    return plan.phase_error + plan.hidden_damping + rule


def _expected_error(
    plan: stepsize.StepSizes, bound: Array, measured: Mapping[str, Array]
) -> dict[str, Array]:
    """What can be expected beforehand of the error of each measurement that decides a label."""
    relative = np.minimum(_relative_error(plan, bound), 1.0)
    # psi' and phi' divide by sin theta: rounding counts the more, the nearer the vertical.
    sine = np.minimum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"]))
    near = plan.rate_error + bound * stepsize.ROUNDING * np.sqrt(plan.count) / np.maximum(sine, 1e-300)
    swing = measured["theta_max"] - measured["theta_min"]
    # A cubic between two samples misses the extreme of a swing by the fourth power of their distance.
    missed = (bound * plan.distance) ** 4 / 384
    angle = swing * np.minimum(relative + missed, 1.0)
    angle += measured["sine_max"] * np.where(bound > 0, plan.rate_error / bound, 0.0)
    found = {"theta_dot_rms": plan.rate_error, "normal_rate_std": plan.rate_error}
    found |= {"psi_dot_std": near, "phi_dot_std": near}
    found = {name: size + relative * measured[name] for name, size in found.items()}
    found |= {"psi_dot_mean": near, "phi_dot_mean": near}
    return found | {"theta_min": angle, "theta_max": angle, "sine_max": angle}


def _unsure(
    measured: Mapping[str, Array],
    error: Mapping[str, Array],
    settings: Settings,
    frames: Mapping[str, Array],
) -> Mask:
    """Could a label in one of the frames (name -> rate added to psi') be another one within the errors? bool."""
    tolerances = settings.rate_tolerance, settings.cylinder
    return np.logical_or.reduce(
        [labels.unsure(measured, error, *tolerances, rate) for rate in frames.values()]
    )


def _changed(
    once: Mapping[str, Array], twice: Mapping[str, Array], settings: Settings, frames: Mapping[str, Array]
) -> Mask:
    """Does a label of the run at half the step differ, or could it by as much as the measurements did? bool."""
    tolerances = settings.rate_tolerance, settings.cylinder
    with np.errstate(all="ignore"):
        difference = {name: np.abs(twice[name] - once[name]) for name in LABEL_STATISTICS}
        changed = _unsure(twice, difference, settings, frames)
        for rate in frames.values():
            changed |= labels.label(once, *tolerances, rate) != labels.label(twice, *tolerances, rate)
    return changed


def _half_step_sample(state: Array, constants: Array, which: str) -> Mask:
    """Points to integrate again in any case: none, all, or one in ONE_IN, by a hash of start and constants."""
    if which != "sample":
        return np.full(state.shape[1], which == "all")
    mixed = np.zeros(state.shape[1], np.uint64)
    for bits in np.concatenate([state, constants]).view(np.uint64):
        mixed = (mixed ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return mixed % np.uint64(POINTS_PER_HALF_STEP) == 0


def _subset(points: Points, keep: np.ndarray) -> dict[str, Array]:
    return {name: values[keep] for name, values in points.items()}


def _scatter(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    full = np.full(there.shape, np.nan if values.dtype.kind == "f" else 0, values.dtype)
    full[there] = values
    return full
