"""Error against run time: some of a scene's points, by every method at many steps, beside a tight reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from scipy.integrate import DOP853
from scipy.stats import beta

from . import grid, labels, store
from .engine import lanes, measure, steps
from .engine.runge_kutta import METHODS
from .evaluate import RATES, Special, evaluate_tile, kernel, scene_kernel_hash
from .progress import Progress
from .scene import Scene, Settings
from .systems.system import Array, BadInput, Flags, Mask, Points, System
from .variables import variables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATISTICS = (*RATES, "theta_min", "theta_max")
# Relative tolerances of the reference and of a second run of it: SAFETY times their difference is what it knows.
REFERENCE, SECOND, SAFETY = 3e-14, 1e-13, 10.0
# Rounding alone leaves this much in a component of the state.
ROUNDING = 1e-15
# A start whose residual is rounding follows the closed form of its family.
EXACT = 1e-14
# The reference is followed in Python: more radians than this at the bound of the frequency take too long.
MOST_TURNS = 1e5
# Rungs of the ladder: decades of the tolerance around the scene's own, or halves of its step.
COARSEST, FINEST, HALVES = 1e-1, 1e-13, range(5, -7, -1)
# A rung that takes more point-steps than this for the sample is left out.
MOST_WORK = 5e8
TIMED = 6_000_000  # point-steps of one timing
CONFIDENCE = 0.95
COLOURS, MARKS = ("#1b6ca8", "#e0892b", "#262626", "#59a14f"), "os^D"
# Half-step sample: at least and at most so many points, and one in so many between (1 % of the cost).
LEAST_SAMPLE, MOST_SAMPLE, ONE_IN = 64, 1000, 300


def upper_bound(found: int, of: int, size: int | None = None) -> float:
    """Share that `found` of `of` random draws bound from above at 95 % (Clopper and Pearson), 0 to 1.

    size: how many there are to draw from; if all were drawn, the share itself.
    """
    if of == size:
        return found / of
    return 1.0 if found >= of else float(beta.ppf(CONFIDENCE, found + 1, of - found))


def spread(size: int, count: int) -> np.ndarray:
    """One flat index from each of `count` equal parts of range(size), int64: the same for the same size.

    The place in each part is a hash of the part's number, so that no period of the grid is met.
    """
    count = min(size, count)
    part = np.arange(count, dtype=np.uint64)
    mixed = (part + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    place = ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) / 2.0**53
    edges = [i * size // count for i in range(count + 1)]
    first, width = np.array(edges[:-1]), np.diff(edges)
    return np.asarray(first + np.minimum((place * width).astype(np.int64), width - 1), np.int64)


# Half-step sample of a run.


def half_step_sample(scene: Scene, *, threads: int | None = None) -> dict[str, Any]:
    """Integrate some of a scene's points at the scene's step and at half of it: what does it change?

    The points depend on the scene's size alone and cost about 1 % of a run; the engine gives them the
    same bits as the run. Returns attributes for the atlas: the number of points tried and how many have
    another label at half the step (a label given becomes another, or none); the bound "at most this
    many points of the atlas" at 95 % (all points tried: exactly); and, where the scene keeps means and
    spreads of the rates, the largest change of one at each point, rad per time unit: the median over all
    points, the largest where the point does not drift, and, where it keeps error_estimate, at how many
    points the change is more than that says.
    """
    indices = spread(scene.size, min(max(LEAST_SAMPLE, scene.size // ONE_IN), MOST_SAMPLE))
    part = grid.take(scene, indices)
    scene = replace(scene, outputs=tuple(name for name in scene.outputs if name not in scene.system.layers))
    own, again = (evaluate_tile(scene, part, halved=halved, threads=threads) for halved in (False, True))
    changed, drifting = np.zeros(indices.size, bool), own["label"] == labels.DRIFTING
    for name in ("label", "label_inertial"):
        if name in own:
            given = (own[name] != labels.NOT_COMPUTED) & (own[name] != labels.UNRESOLVED)
            changed |= given & (again[name] != own[name])
    found = int(changed.sum())
    values: dict[str, Any] = {
        "atlas_half_step_points": indices.size,
        "atlas_half_step_changed": found,
        "atlas_labels_may_change": math.ceil(
            upper_bound(found, indices.size, scene.size) * scene.size - 1e-9
        ),
        "atlas_points": scene.size,
    }
    kept = [np.abs(again[name] - own[name]) for name in RATES if name in scene.outputs]
    change = np.fmax.reduce([np.full(indices.size, np.nan), *kept])
    if np.isfinite(change).any():
        values["atlas_half_step_median"] = float(np.nanmedian(change))
        if "error_estimate" in scene.outputs:
            with np.errstate(all="ignore"):
                bound = scene.system.frequency_bound(part.points)
            values["atlas_half_step_beyond"] = int((change > own["error_estimate"] * bound).sum())
    # The rates of a drifting point may be those of a chaotic motion or a spike near the vertical.
    steady = change[part.there & ~changed & ~drifting & (own["label"] != labels.UNRESOLVED)]
    if np.isfinite(steady).any():
        values["atlas_half_step_difference"] = float(np.nanmax(steady))
    return values


def half_step_text(attributes: Mapping[str, Any]) -> str:
    """The line for the end of a run from the attributes that half_step_sample gave."""
    a = attributes
    text = (
        f"labels that may be wrong: at most {a['atlas_labels_may_change']} of {a['atlas_points']}"
        f" ({100 * CONFIDENCE:g} %); {a['atlas_half_step_changed']} of {a['atlas_half_step_points']}"
        " changed at half the step"
    )
    if "atlas_half_step_median" in a:
        text += f", means and spreads by {a['atlas_half_step_median']:.2g} (median)"
    if "atlas_half_step_difference" in a:
        text += f", those of steady points by at most {a['atlas_half_step_difference']:.2g}"
    if a.get("atlas_half_step_beyond"):
        text += f"; {a['atlas_half_step_beyond']} changed by more than their estimate"
    return text


# The reference.


Advance = Callable[[float], None]  # called with the points done since the last call


def _untold(points: float) -> None:
    """An Advance that nobody listens to."""


@dataclass(frozen=True)
class Reference:
    """What the motions are, and how well that is known; arrays over the points."""

    state: Array  # (state, points) at the end of the run
    statistics: dict[str, Array]  # by STATISTICS
    label: Flags
    label_inertial: Flags | None  # where the system has a second frame
    exact: Mask  # from the closed form of a family
    state_error: Array
    statistics_error: dict[str, Array]
    certain: Mask  # both determinations give these labels


def reference(
    system: System, points: Points, duration: Array, settings: Settings, advance: Advance = _untold
) -> Reference:
    """Final states and statistics, by closed form where a start is exactly on a family, else by DOP853.

    SciPy's DOP853 runs at the relative tolerances REFERENCE and SECOND, with the statistics as
    quadratures beside the states. The error of the reference is SAFETY times the difference of the two
    runs; where the closed form is taken, its difference from the first: on an unstable motion nobody knows
    where a start that is exact but for rounding goes. Raises BadInput that numbers the points (from 0) where
    a run fails. advance hears of two for each of the points in all.
    """
    tight, lost = _dop853(system, points, duration, settings.cylinder, REFERENCE, advance)
    if lost.any():
        raise _Failure(np.flatnonzero(lost))
    second, lost = _dop853(system, points, duration, settings.cylinder, SECOND, advance)
    if lost.any():
        raise _Failure(np.flatnonzero(lost))
    flags, _ = system.recognise(points)
    motions = {f.flag: f.motion for f in system.families.values() if f.motion is not None}
    exact = (system.condition_residual(points) <= EXACT) & np.isin(flags, list(motions))
    best, other = tight, second
    if exact.any():
        best, other = dict(tight), {k: np.where(exact, tight[k], second[k]) for k in tight}
        start = system.start(points)
        now = _rates(system.equations.frame_motion(start, system.constants(points)), settings.cylinder)
        closed = {name: np.zeros(exact.size) for name in RATES}
        closed |= {"psi_dot_mean": now[1], "phi_dot_mean": now[2], "normal_rate_mean": now[3]}
        closed |= {"theta_min": now[5], "theta_max": now[5], "sine_max": np.sin(now[5])}
        closed["state"] = np.empty_like(start)
        for flag in np.unique(flags[exact]):
            on = np.flatnonzero(exact & (flags == flag))
            moved = motions[flag]({name: values[on] for name, values in points.items()}, duration[on])
            closed["state"][:, on] = np.einsum("sii->si", moved)
        best |= {name: np.where(exact, values, tight[name]) for name, values in closed.items()}
    frames: list[Array | float] = [0.0] + ([] if system.frame_rate is None else [system.frame_rate(points)])
    with np.errstate(invalid="ignore"):
        called = [
            np.array([labels.label(run, settings.rate_tolerance, settings.cylinder, rate) for rate in frames])
            for run in (best, other)
        ]
    for run in (best, other):
        inside = labels.in_cylinder(run, settings.cylinder)
        for name in ("psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std"):
            run[name] = np.where(inside, np.nan, run[name])
    return Reference(
        best["state"],
        {name: best[name] for name in STATISTICS},
        called[0][0],
        called[0][1] if len(frames) > 1 else None,
        exact,
        np.maximum(
            SAFETY * _distance(best["state"], other["state"], system.frequency_bound(points)), ROUNDING
        ),
        {name: np.maximum(SAFETY * np.abs(best[name] - other[name]), ROUNDING) for name in STATISTICS},
        (called[0] == called[1]).all(0),
    )


class _Failure(BadInput):
    """The reference fails at these places of its points."""

    def __init__(self, places: np.ndarray):
        super().__init__(f"the reference fails at points {', '.join(map(str, places))}")
        self.places = places


def _distance(one: Array, two: Array, bound: Array) -> Array:
    """Largest difference of a component; the first three, angular velocities, in units of the bound."""
    difference = np.abs(one - two)
    difference[:3] /= bound
    return np.asarray(difference.max(0))


def _rates(motion: Sequence[Array], cylinder: float) -> tuple[Array, ...]:
    """theta', psi', phi', rate about the vertical, outside the cylinder? (1.0, 0.0), theta: see measure.sample."""
    u1, u2, u3, g1, g2, g3 = motion
    sine = np.hypot(g1, g2)
    outside = np.where(sine >= cylinder, 1.0, 0.0)
    guarded = np.where(sine == 0.0, 1.0, sine)
    normal_rate = u1 * g1 + u2 * g2 + u3 * g3
    psi_dot = (u1 * g1 + u2 * g2) / guarded**2 * outside
    theta_dot = (u1 * g2 - u2 * g1) / guarded
    return theta_dot, psi_dot, (u3 - psi_dot * g3) * outside, normal_rate, outside, np.arctan2(sine, g3)


def _dop853(
    system: System, points: Points, duration: Array, cylinder: float, rtol: float, advance: Advance = _untold
) -> tuple[dict[str, Array], Mask]:
    """Statistics by name and the final "state" of every point; and where that failed."""
    with np.errstate(all="ignore"):
        turns = system.frequency_bound(points) * duration
        usable = np.isfinite(system.start(points)).all(0) & (turns <= MOST_TURNS)
    lost = ~usable
    found: dict[str, Array] = {}
    waiting, order = [], np.flatnonzero(usable)[np.argsort(turns[usable], kind="stable")]
    while order.size:  # points that need about the same steps share them
        alike = turns[order] <= 1.5 * turns[order[0]]
        waiting.append(order[alike])
        order = order[~alike]
    while waiting:
        group = waiting.pop()
        some = {name: values[group] for name, values in points.items()}
        part = _follow(system, some, duration[group], cylinder, rtol, advance)
        if part is None:
            if group.size == 1:
                lost[group] = True
            else:  # one bad point must not take its neighbours along
                waiting += [group[: group.size // 2], group[group.size // 2 :]]
            continue
        for name, values in part.items():
            whole = found.setdefault(name, np.full((*values.shape[:-1], turns.size), np.nan))
            whole[..., group] = values
    return found, lost


def _follow(
    system: System, points: Points, duration: Array, cylinder: float, rtol: float, advance: Advance = _untold
) -> dict[str, Array] | None:
    """The points as one system of equations in t / duration; None if a step fails."""
    equations, constants, start = system.equations, system.constants(points), system.start(points)
    states, size = start.shape
    first = _rates(equations.frame_motion(start, constants), cylinder)

    def slope(time: float, flat: Array) -> Array:
        state = flat.reshape(-1, size)[:states]
        now = _rates(equations.frame_motion(state, constants), cylinder)
        theta_dot, outside, normal_rate = now[0], now[4], now[3] - first[3]
        psi_dot, phi_dot = (now[1] - first[1]) * outside, (now[2] - first[2]) * outside
        rows = [duration * rate for rate in equations.rhs(state, constants)]
        rows += [theta_dot, theta_dot**2, outside, psi_dot, psi_dot**2, phi_dot, phi_dot**2]
        return np.concatenate([*rows, normal_rate, normal_rate**2])

    sums = len(measure.SUMS)  # the first rows of measure.OUTPUTS, in that order
    # The quadratures follow the states' steps; they ask for shorter ones only where a rate leaps.
    tolerance = np.repeat([rtol, 1e2 * rtol], [states * size, sums * size])
    low, high = first[5].copy(), first[5].copy()
    with np.errstate(all="ignore"):
        solver = DOP853(
            slope, 0.0, np.concatenate([start.ravel(), np.zeros(sums * size)]), 1.0,
            rtol=tolerance, atol=tolerance,
        )  # fmt: skip
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                return None
            _extremes(solver, equations, constants, duration, cylinder, low, high)
            advance(size * (solver.t - solver.t_old))
    final = solver.y.reshape(-1, size)
    out = np.zeros((len(measure.OUTPUTS), size))
    out[:sums] = final[states:]
    for name, values in zip(measure.REFERENCES, first[1:4], strict=True):
        out[measure.OUTPUTS.index(name)] = values
    result = measure.finish(out, np.ones(size, np.int64))
    over = (low <= np.pi / 2) & (high >= np.pi / 2)
    return {name: result[name] for name in RATES} | {
        "theta_min": low,
        "theta_max": high,
        "sine_max": np.where(over, 1.0, np.maximum(np.sin(low), np.sin(high))),
        "state": final[:states],
    }


def _extremes(solver, equations, constants, duration, cylinder, low, high) -> None:
    """Widen low and high, in place, to the range of theta in the last step: cubic between five instants."""
    times = np.linspace(solver.t_old, solver.t, 5)
    path = solver.dense_output()(times).reshape(-1, duration.size, times.size)
    rates = _rates(equations.frame_motion(path[: len(equations.STATE)], constants[:, :, None]), cylinder)
    theta, slope = rates[5], rates[0] * (duration * (times[1] - times[0]))[:, None]
    before, after, rise = slope[:, :-1], slope[:, 1:], np.diff(theta, axis=1)
    # theta(x) = theta + before x + b x^2 + c x^3 on 0..1, where its slope changes sign
    b, c = 3 * rise - 2 * before - after, before + after - 2 * rise
    root = np.sqrt(np.maximum(b**2 - 3 * before * c, 0.0))
    x = -before / (b + np.where(before > 0, -root, root))
    turning = theta[:, :-1] + x * (before + x * (b + x * c))
    turning = np.where((before * after < 0) & (x >= 0) & (x <= 1), turning, theta[:, :-1])
    every = np.concatenate([theta, turning], axis=1)
    np.minimum(low, every.min(1), out=low)
    np.maximum(high, every.max(1), out=high)


# The report.


def ladder(settings: Settings) -> tuple[str, list[float]]:
    """Tolerances (decades around the scene's own), or steps (halves and doubles), coarse to fine."""
    if settings.step is not None:
        return "step", [settings.step * 2.0**k for k in HALVES]
    above = math.floor(math.log10(COARSEST) - math.log10(settings.tolerance) + 1e-9)
    below = math.floor(math.log10(settings.tolerance) - math.log10(FINEST) + 1e-9)
    decades = range(max(above, 0), -max(below, 0) - 1, -1)
    return "tolerance", [settings.tolerance * 10.0**k for k in decades if k == 0 or k >= -below]


def own_rung(settings: Settings) -> int:
    """Place of the scene's own setting on the ladder."""
    kind, rungs = ladder(settings)
    own = settings.step if settings.step is not None else settings.tolerance
    return int(np.abs(np.log(np.array(rungs) / own)).argmin())


def accuracy(scene: Scene, count: int = 64, *, progress: bool = False) -> xr.Dataset:
    """Errors and run times of `count` points of a scene, over the dimensions (method, rung, sample).

    Every method of the engine runs at a ladder of tolerances (or steps, if the scene gives one). State
    errors are the largest difference of a component at the end of the run, angular velocities in units
    of the point's frequency bound; `error_rates` is that of the least accurate mean or spread of a rate
    in the same units, `error_NAME` that of one statistic; inf where a run is not finite. No error is
    below what the reference knows, `reference_error` and `reference_error_NAME`. seconds_per_point: one
    processor, full blocks of points, to the end of the run, from the measured time of a point-step.
    Rungs are nan that take too many steps, the same steps as a finer one (or as the scene's own), or that
    are finer than rounding lets errors fall. Points where the reference fails are left out and named in the
    attribute `left_out`. progress: say on stderr what is done. Raises BadInput for a count below 2, and where
    the reference leaves fewer than 2 points.
    """
    if count < 2:
        raise BadInput(f"points = {count}: must be at least 2")
    began = perf_counter()
    grid.check(scene)
    system, settings = scene.system, scene.settings
    indices = spread(scene.size, 16 * count)
    there = np.flatnonzero(grid.take(scene, indices).there)
    if not there.size:
        raise BadInput(f"family.name = {scene.family!r}: exists at none of the points tried")
    indices = indices[there[spread(there.size, count)]]
    bar = Progress((2 + len(METHODS)) * indices.size, show=progress)
    try:
        indices, part, truth, left_out = _followed(scene, indices, bar.advance)
        (kind, rungs), methods = ladder(settings), list(METHODS)
        shape = (len(methods), len(rungs), indices.size)
        columns = {f"error_{name}": np.full(shape, np.nan) for name in STATISTICS}
        columns |= {
            name: np.full(shape, np.nan)
            for name in ("error_state", "error_rates", "integral_drift", "step_length")
        }
        counts = np.zeros(shape, np.int64)
        called, wrong = np.zeros(shape, np.int8), np.zeros(shape, bool)
        seconds = np.full(shape[:2], np.nan)
        bound, own = system.frequency_bound(part.points), own_rung(settings)
        known = max(_median(truth.state_error), _median(_rates_error(truth, bound)))
        for i, method in enumerate(methods):
            runner, least, stale = _Runner(scene, part.points, method), math.inf, 0
            settled = [
                replace(settings, method=method, **{kind: rung})  # type: ignore[arg-type]
                for rung in rungs
            ]
            plans = [_plan(system, part.points, part.duration, chosen) for chosen in settled]
            for j, (chosen, plan) in enumerate(zip(settled, plans, strict=True)):
                alike = [k for k, other in enumerate(plans) if (other.count == plan.count).all()]
                last = own if own in alike else alike[-1]
                bar.advance(indices.size / len(rungs))
                if j != last or (j and plan.count.sum() > MOST_WORK):
                    continue
                found = evaluate_tile(
                    replace(scene, settings=chosen, outputs=(*STATISTICS, "integral_drift", "label")), part
                )
                state = runner.end(lanes.plan(plan.count, plan.count), plan.length)
                with np.errstate(invalid="ignore"):
                    lost = ~np.isfinite(state).all(0)
                    error = np.where(lost, np.inf, _distance(state, truth.state, bound))
                    columns["error_state"][i, j] = np.maximum(error, truth.state_error)
                    for name in STATISTICS:
                        columns[f"error_{name}"][i, j] = np.maximum(
                            np.abs(found[name] - truth.statistics[name]), truth.statistics_error[name]
                        )
                    worst = np.fmax.reduce([columns[f"error_{name}"][i, j] for name in RATES])
                    columns["error_rates"][i, j] = np.where(lost, np.inf, worst / bound)
                columns["integral_drift"][i, j], columns["step_length"][i, j] = (
                    found["integral_drift"],
                    plan.length,
                )
                counts[i, j], called[i, j] = plan.count, found["label"]
                wrong[i, j] = found["label"] != truth.label
                if truth.label_inertial is not None:
                    wrong[i, j] |= found["label_inertial"] != truth.label_inertial
                looks = list(zip(plan.stride.tolist(), plan.parts.tolist(), strict=True))
                # At every rung: passages of the vertical cost the more, the longer the steps.
                paces = {look: _pace(scene, part.points, plan, method, *look) for look in set(looks)}
                pace = np.array([paces[look] for look in looks])
                seconds[i, j] = (pace * plan.count).mean()
                reached = _median(columns["error_state"][i, j])
                typical = max(reached, _median(columns["error_rates"][i, j]))
                stale = stale + 1 if typical > 0.5 * least else 0
                if j > own and stale >= (1 if typical < 3 * known else 3):
                    break  # rounding, or what the reference knows: finer steps show no less
                least = min(least, typical)
    finally:
        bar.close()
    ds = _dataset(scene, indices, truth, bound, columns, counts, called, wrong, seconds)
    ds.attrs = store.provenance(
        system, settings, scene_kernel_hash(scene), title=scene.title, scene=scene.toml(),
        seconds=perf_counter() - began, points=indices.size, remarks=[],
    ) | ds.attrs | ({"left_out": left_out} if left_out else {})  # fmt: skip
    return ds


def _followed(
    scene: Scene, indices: np.ndarray, advance: Advance
) -> tuple[np.ndarray, grid.Grid, Reference, str]:
    """Those points that the reference can follow, and which it cannot, in words; BadInput for less than 2."""
    left_out = ""
    while True:
        part = grid.take(scene, indices)
        try:
            truth = reference(scene.system, part.points, part.duration, scene.settings, advance)
            return indices, part, truth, left_out
        except _Failure as failure:
            left_out = (
                f"the reference fails at {failure.places.size} of {indices.size} points, where the motion is"
                f" not finite or turns more than {MOST_TURNS:g} rad: {_named(scene, indices[failure.places])}"
            )
            indices = np.delete(indices, failure.places)
            if indices.size < 2:
                raise BadInput(left_out) from None


def _plan(system: System, points: Points, duration: Array, settings: Settings) -> steps.Steps:
    return steps.choose(
        METHODS[settings.method], system.frequency_bound(points), duration,
        tolerance=settings.tolerance, step=settings.step, max_steps=settings.max_steps,
        rate_tolerance=settings.rate_tolerance,
    )  # fmt: skip


class _Runner:
    """Points of a scene in the kernel that the scene gets."""

    def __init__(self, scene: Scene, points: Points, method: str):
        system = scene.system
        self.kernel = kernel(system, method, Special.of(system, *scene.vanishing()))
        self.cylinder = scene.settings.cylinder
        self.start = np.ascontiguousarray(system.start(points))
        self.constants = np.ascontiguousarray(system.constants(points))
        conserved = dict(system.conserved(points))
        self.scales = measure.scales(system.equations, self.start, self.constants, conserved)

    def end(self, blocks: lanes.Plan, length: Array, threads: int | None = None) -> Array:
        """Final states, (state, points)."""
        state = self.start.copy()
        lanes.integrate(
            self.kernel, blocks, length, state, self.constants, self.scales, self.cylinder, threads=threads
        )
        return state


def _pace(scene: Scene, points: Points, plan: steps.Steps, method: str, stride: int, parts: int) -> float:
    """Seconds per point-step on one processor in full blocks; stride, parts: as in steps.Steps."""
    blocks = -(-plan.count.size // lanes.WIDTH)
    many = np.resize(np.arange(plan.count.size), blocks * lanes.WIDTH)
    runner = _Runner(scene, {name: values[many] for name, values in points.items()}, method)
    each = np.full(many.size, max(TIMED // many.size // stride, 1) * stride)
    work, times = lanes.plan(each, np.full(many.size, stride), np.full(many.size, parts)), []
    for _ in range(6):  # the first may load or compile the kernel
        began = process_time()
        runner.end(work, plan.length[many], threads=1)
        times.append(process_time() - began)
    return median(times[1:]) / work.point_steps


def _named(scene: Scene, indices: np.ndarray, most: int = 5) -> str:
    """Points by the values on their axes."""
    shown = []
    for place in np.transpose(np.unravel_index(indices[:most], scene.shape)):
        values = zip(scene.axes.values(), place, strict=True)
        shown.append(", ".join(f"{axis.name} = {axis.values[i]:.6g}" for axis, i in values))
    return "; ".join(shown) + (f" and {indices.size - most} more" if indices.size > most else "")


def _rates_error(truth: Reference, bound: Array) -> Array:
    """What the reference knows of the least certain mean or spread of a rate, over the bound."""
    return np.asarray(np.fmax.reduce([truth.statistics_error[name] for name in RATES]) / bound)


LONG_NAMES = {
    "error_state": "largest error of a component of the final state, angular velocities over the frequency bound",
    "error_rates": "error of the least accurate mean or spread of a rate, over the frequency bound",
    "integral_drift": "largest relative change of a first integral",
    "step_length": "length of a step",
}


def _dataset(scene, indices, truth: Reference, bound, columns, counts, called, wrong, seconds) -> xr.Dataset:
    settings, dims, registry = scene.settings, ("method", "rung", "sample"), variables(scene.system)
    compared = truth.certain & (called != labels.UNRESOLVED) & (called != labels.NOT_COMPUTED)
    ds = xr.Dataset()
    for name, values in columns.items():
        statistic = name.removeprefix("error_")
        units = registry[statistic].units if statistic in STATISTICS else "1"
        long_name = LONG_NAMES.get(name) or f"error of {statistic}"
        ds[name] = dims, values, {"long_name": long_name, "units": units}
    ds["step_length"].attrs["units"] = "s"
    ds["steps"] = dims, counts, {"long_name": "steps to the end of the run", "units": "1"}
    ds["label_compared"] = dims, compared.astype(np.int8), {"long_name": "both label and reference are sure"}
    ds["label_wrong"] = (
        dims,
        (compared & wrong).astype(np.int8),
        {"long_name": "a label is not the reference's"},
    )
    unresolved = (called == labels.UNRESOLVED).astype(np.int8)
    ds["label_unresolved"] = dims, unresolved, {"long_name": "the method gives no label"}
    ds["seconds_per_point"] = (
        dims[:2], seconds, {"long_name": "processor time to the end of the run", "units": "s"}
    )  # fmt: skip
    ds["order"] = dims[:2], _orders(columns, truth), {"long_name": "observed order from the rung before"}
    known = {"": ("state", truth.state_error), "_rates": ("rates", _rates_error(truth, bound))}
    known |= {f"_{name}": (name, values) for name, values in truth.statistics_error.items()}
    for suffix, (name, values) in known.items():
        attributes = {"long_name": f"uncertainty of the reference: error_{name} is never less"}
        ds[f"reference_error{suffix}"] = "sample", values, attributes | {"units": ds[f"error_{name}"].units}
    ds["reference_exact"] = "sample", truth.exact.astype(np.int8), {"long_name": "closed form of a family"}
    kind, rungs = ladder(settings)
    ds = ds.assign_coords(
        {
            "method": ("method", list(METHODS)),
            "index": ("sample", indices, {"long_name": "flat index in the scene's grid"}),
            kind: ("rung", rungs, {"long_name": f"{kind} of the scene's [integration]"}),
        }
    )
    for axis, place in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True):
        ds = ds.assign_coords({f"axis_{axis.name}": ("sample", np.asarray(axis.values)[place])})
    ds.attrs = {
        "atlas_points": scene.size,
        "ladder": kind,
        "own_method": settings.method,
        "own_rung": own_rung(settings),
    }
    return ds


def _orders(columns: Mapping[str, Array], truth: Reference) -> Array:
    """Median over the points of log(error ratio) / log(step ratio), where the reference can tell; else nan."""
    error, step = columns["error_state"], columns["step_length"]
    order = np.full(error.shape[:2], np.nan)
    with np.errstate(all="ignore"):
        each = np.log(error[:, :-1] / error[:, 1:]) / np.log(step[:, :-1] / step[:, 1:])
    # Errors near the reference's own, and those of a run that is nowhere near converged, show no order.
    told = (error[:, 1:] > 10 * truth.state_error) & (error[:, :-1] < 1e-2) & np.isfinite(each)
    for place in np.argwhere(told.sum(2) >= max(2, error.shape[2] / 2)):
        i, j = place
        order[i, j + 1] = np.median(each[i, j][told[i, j]])
    return order


def summary(ds: xr.Dataset) -> list[dict[str, Any]]:
    """One row per method and rung that ran: medians and largest values over the points."""
    rows: list[dict[str, Any]] = []
    kind = ds.attrs["ladder"]
    for method in ds["method"].values:
        for j in range(ds.sizes["rung"]):
            at = ds.sel({"method": method}).isel(rung=j)
            if not np.isfinite(at["seconds_per_point"]):
                continue
            compared, wrong = int(at["label_compared"].sum()), int(at["label_wrong"].sum())
            error = at["error_state"].values
            row = {
                "method": str(method),
                kind: float(ds[kind][j]),
                "own_setting": method == ds.attrs["own_method"] and j == ds.attrs["own_rung"],
                "steps": float(at["steps"].mean()),
                "seconds_per_point": float(at["seconds_per_point"]),
                "error_state": _median(error),
                "error_state_largest": _largest(error),
                "error_rates": _median(at["error_rates"].values),
                "error_rates_largest": _largest(at["error_rates"].values),
                "labels_unresolved": int(at["label_unresolved"].sum()),
                "labels_compared": compared,
                "labels_wrong": wrong,
                "labels_wrong_at_most": upper_bound(wrong, compared, ds.attrs["atlas_points"]),
                "integral_drift_largest": _largest(at["integral_drift"].values),
                "order": float(at["order"]),
            }
            for name in STATISTICS:
                values = at[f"error_{name}"].values
                row |= {f"error_{name}": _median(values), f"error_{name}_largest": _largest(values)}
            rows.append(row)
    return rows


def _median(values: Array) -> float:
    """Median of what has a meaning; nan if nothing has."""
    values = values[~np.isnan(values)]
    return float(np.median(values)) if values.size else math.nan


def _largest(values: Array) -> float:
    values = values[~np.isnan(values)]
    return float(values.max()) if values.size else math.nan


def _at(ds: xr.Dataset, row: Mapping[str, Any]) -> xr.Dataset:
    """The method and rung that a row of the summary is made from."""
    kind = ds.attrs["ladder"]
    return ds.sel({"method": row["method"]}).isel(rung=int(np.abs(ds[kind].values - row[kind]).argmin()))


def _shown(ds: xr.Dataset, at: xr.Dataset, name: str) -> tuple[str, str]:
    """Median and largest error_NAME at a rung; with <= where the reference knows no better."""
    known = ds[f"reference_error{'' if name == 'state' else '_' + name}"].values
    values = at[f"error_{name}"].values
    return tuple(
        ("" if of(values) > 3 * of(np.where(np.isnan(values), np.nan, known)) else "<= ")
        + f"{of(values):.1e}"
        for of in (_median, _largest)
    )  # type: ignore[return-value]


def report(ds: xr.Dataset) -> str:
    """The work and what it buys as plain text, ending with one sentence of advice."""
    kind, rows = ds.attrs["ladder"], summary(ds)
    exact, own = int(ds["reference_exact"].sum()), ds["reference_error"].values
    lines = [
        f"{ds.attrs['title']}: {ds.sizes['sample']} of {ds.attrs['atlas_points']} points;"
        f" processor {ds.attrs['atlas_cpu']}, atlas {ds.attrs['atlas_version']}",
        f"reference: closed form at {exact} points, DOP853 at {ds.sizes['sample'] - exact};"
        f" it knows final states to {_median(own):.1e} (median), {own.max():.1e} (worst point)",
    ]
    lines += [f"left out: {ds.attrs['left_out']}"] if "left_out" in ds.attrs else []
    lines.append("")
    cells: list[tuple[str, ...]] = [
        ("method", kind, "steps", "us/point", "state error", "worst", "rates", "labels wrong", "drift", "order")
    ]  # fmt: skip
    marked = None
    for row in rows:
        at = _at(ds, row)
        marked = at if row["own_setting"] else marked
        cells.append(
            (
                row["method"],
                f"{row[kind]:.3g}" + (" *" if row["own_setting"] else ""),
                f"{row['steps']:.0f}",
                f"{1e6 * row['seconds_per_point']:.3g}",
                *_shown(ds, at, "state"),
                _shown(ds, at, "rates")[0],
                f"{row['labels_wrong']}/{row['labels_compared']} (<= {100 * row['labels_wrong_at_most']:.3g} %)",
                f"{row['integral_drift_largest']:.1e}",
                "-" if np.isnan(row["order"]) else f"{row['order']:.2f}",
            )
        )
    lines += [_columns(cells), ""]
    lines += [
        "us/point: one processor, to the end of the run; errors: median over the points; <=: the reference knows",
        "no better; rates: the least accurate mean or spread, over the frequency bound; labels wrong: beside the",
        "reference, share at most (95 %); * the scene's setting.",
        "",
    ]
    if marked is not None:
        cells = [("at the scene's setting", "median error", "worst", "points that have it")]
        for name in STATISTICS:
            there = int(marked[f"error_{name}"].notnull().sum())
            if there:
                cells.append((name, *_shown(ds, marked, name), str(there)))
        lines += [_columns(cells), ""]
    return "\n".join([*lines, advice(ds)])


def _columns(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)


def advice(ds: xr.Dataset) -> str:
    """Which method and step reach the scene's tolerance most cheaply, in one sentence.

    A scene with a step has no tolerance: what counts there is the median error of its own setting.
    """
    kind, rows = ds.attrs["ladder"], summary(ds)
    own = next((row for row in rows if row["own_setting"]), None)
    if kind == "tolerance":
        target = float(ds["tolerance"][ds.attrs["own_rung"]])
        what = f"a median error of {target:.3g} in states and rates"
    elif own is None:
        return "The scene's own step takes too many steps for a sample: no advice."
    else:
        target = max(own["error_state"], own["error_rates"])
        what = f"the scene's own median error in states and rates, {target:.2g}"
    states, rates = ds["reference_error"].values, ds["reference_error_rates"].values
    unsure = np.fmax(states, rates) > target
    # A setting must not lose a label, nor get one wrong, that another gives.
    lost = [(row["labels_unresolved"], row["labels_wrong"]) for row in rows]
    fewest = tuple(min(numbers) for numbers in zip(*lost, strict=True))
    reach = [
        row
        for row in rows
        if max(row["error_state"], row["error_rates"]) <= target
        and (row["labels_unresolved"], row["labels_wrong"]) == fewest
    ]
    if not reach:
        best = min(rows, key=lambda row: max(row["error_state"], row["error_rates"]))
        known = max(_median(states), _median(rates))
        text = (
            f"Out of reach: {what}; the best of the ladder, {best['method']} with {kind} = {best[kind]:.3g}, has"
            f" {best['error_state']:.1e} in states and {best['error_rates']:.1e} in rates"
        )
        if known > target:
            text += f", and the reference cannot tell errors that small (states {_median(states):.1e}, rates {_median(rates):.1e})"
        names = _beyond(ds, best, target)[1]
        return f"{text}, first of all at {names}."
    cheap = min(reach, key=lambda row: row["seconds_per_point"])
    text = (
        f"Cheapest for {what}: {cheap['method']} with {kind} = {cheap[kind]:.3g},"
        f" {1e6 * cheap['seconds_per_point']:.3g} us a point"
    )
    if cheap["own_setting"]:
        text += ", the scene's own setting"
    elif own is not None:
        text += (
            f" (the scene's {own['method']} with {kind} = {own[kind]:.3g}: {1e6 * own['seconds_per_point']:.3g} us,"
            f" error {max(own['error_state'], own['error_rates']):.1e})"
        )
    angles = max(cheap["error_theta_min"], cheap["error_theta_max"])
    if angles > target:
        text += f"; theta_min and theta_max then have a median error of {angles:.1e}"
    above, names = _beyond(ds, cheap, target)
    if above and kind == "tolerance":  # half of the points are above the median of a setting
        text += f"; {above} of {unsure.size} points stay above it, first of all {names}"
        if unsure.any():
            text += f" ({int(unsure.sum())} where the reference itself does not know)"
    return text + "."


def _beyond(ds: xr.Dataset, row: Mapping[str, Any], target: float) -> tuple[int, str]:
    """How many points have a larger error in states or rates than the target at a row's setting, and the worst."""
    at = _at(ds, row)
    error = np.fmax(at["error_state"].values, at["error_rates"].values)
    beyond = np.flatnonzero(error > target)
    return beyond.size, _named_points(ds, beyond[np.argsort(-error[beyond])])


def _named_points(ds: xr.Dataset, places: np.ndarray, most: int = 3) -> str:
    axes = [str(name) for name in ds.coords if str(name).startswith("axis_")]
    shown = [
        ", ".join(f"{name.removeprefix('axis_')} = {float(ds[name][i]):.6g}" for name in axes)
        for i in places[:most]
    ]
    return "; ".join(shown) + (f" and {places.size - most} more" if places.size > most else "")


def figure(ds: xr.Dataset) -> Figure:
    """Work-precision figure: median errors against time per point, a line and a dotted one per method."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    rows = summary(ds)
    with rc_context({"font.size": 8, "legend.fontsize": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(3.5, 2.8), layout="constrained")
        ax = drawn.add_subplot()
        for method, colour, mark in zip(ds["method"].values, COLOURS, MARKS, strict=False):
            # A run that is nowhere near the motion has no error worth drawing.
            sane = [r for r in rows if r["method"] == method and r["error_state"] < 3.0] or rows[-1:]
            line = [(1e6 * r["seconds_per_point"], r["error_state"]) for r in sane]
            ax.plot(
                *np.transpose(line), mark + "-", color=colour, markersize=3, label=f"{method}, final state"
            )
            line = [(1e6 * r["seconds_per_point"], r["error_rates"]) for r in sane]
            ax.plot(*np.transpose(line), ":", color=colour, label=f"{method}, means and spreads")
        for row in rows:
            if row["own_setting"] and row["error_state"] < 3.0:
                place = 1e6 * row["seconds_per_point"], row["error_state"]
                ax.plot(*place, "o", mfc="none", mec="black", ms=8, label="the scene's setting")
        ax.set(xscale="log", yscale="log")
        ax.set(xlabel="time per point and processor (µs)", ylabel="median error")
        known = _median(ds["reference_error"].values)
        floor = min(ax.get_ylim()[0], known / 2)
        ax.set_ylim(bottom=floor)
        ax.axhspan(floor, known, color="0.9", zorder=0, label="reference unsure of states")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.tick_params(axis="x", labelrotation=0)
        drawn.legend(loc="outside lower center", ncols=2, frameon=False)
    return drawn


def table(ds: xr.Dataset) -> str:
    """`summary` as CSV."""
    rows = summary(ds)
    lines = [",".join(rows[0])]
    lines += [",".join(v if isinstance(v, str) else repr(v) for v in row.values()) for row in rows]
    return "\n".join(lines) + "\n"
