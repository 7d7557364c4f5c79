"""Final states and statistics by closed forms and by DOP853."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853

from ..engine import measure
from ..errors import BadInput
from ..label import labels
from ..label.pipeline import RATES
from ..scene.model import Settings
from ..systems.base import Array, Flags, Mask, Points, System

STATISTICS = (*RATES, "theta_min", "theta_max")
# Relative tolerances of the reference and of a second run of it: SAFETY times their difference is what it knows.
REFERENCE_RTOL, SECOND_RTOL, SAFETY = 3e-14, 1e-13, 10.0
# Rounding alone leaves this much in a component of the state.
ROUNDING = 1e-15
# A start whose residual is rounding follows the closed form of its family.
EXACT_RESIDUAL = 1e-14
# The reference is followed in Python: more radians than this at the bound of the frequency take too long.
MAX_RADIANS = 1e5
# The reference.


Advance = Callable[[float], None]  # called with the points done since the last call


def no_progress(points: float) -> None:
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
    system: System, points: Points, duration: Array, settings: Settings, advance: Advance = no_progress
) -> Reference:
    """Final states and statistics, by closed form where a start is exactly on a family, else by DOP853.

    SciPy's DOP853 runs at the relative tolerances REFERENCE and SECOND, with the statistics as
    quadratures beside the states. The error of the reference is SAFETY times the difference of the two
    runs; where the closed form is taken, its difference from the first: on an unstable motion nobody knows
    where a start that is exact but for rounding goes. Raises BadInput that numbers the points (from 0) where
    a run fails. advance hears of two for each of the points in all.
    """
    tight, lost = _dop853(system, points, duration, settings.cylinder, REFERENCE_RTOL, advance)
    if lost.any():
        raise ReferenceFailureError(np.flatnonzero(lost))
    second, lost = _dop853(system, points, duration, settings.cylinder, SECOND_RTOL, advance)
    if lost.any():
        raise ReferenceFailureError(np.flatnonzero(lost))
    flags, _ = system.identify_family(points)
    motions = {f.flag: f.motion for f in system.families.values() if f.motion is not None}
    exact = (system.condition_residual(points) <= EXACT_RESIDUAL) & np.isin(flags, list(motions))
    best, other = tight, second
    if exact.any():
        best, other = dict(tight), {k: np.where(exact, tight[k], second[k]) for k in tight}
        start = system.initial_state(points)
        now = euler_rates(system.equations.frame_motion(start, system.constants(points)), settings.cylinder)
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
            SAFETY * state_distance(best["state"], other["state"], system.frequency_bound(points)), ROUNDING
        ),
        {name: np.maximum(SAFETY * np.abs(best[name] - other[name]), ROUNDING) for name in STATISTICS},
        (called[0] == called[1]).all(0),
    )


class ReferenceFailureError(BadInput):
    """The reference fails at these places of its points."""

    def __init__(self, places: np.ndarray):
        super().__init__(f"the reference fails at points {', '.join(map(str, places))}")
        self.places = places


def state_distance(one: Array, two: Array, bound: Array) -> Array:
    """Largest difference of a component; the first three, angular velocities, in units of the bound."""
    difference = np.abs(one - two)
    difference[:3] /= bound
    return np.asarray(difference.max(0))


def euler_rates(motion: Sequence[Array], cylinder: float) -> tuple[Array, ...]:
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
    system: System,
    points: Points,
    duration: Array,
    cylinder: float,
    rtol: float,
    advance: Advance = no_progress,
) -> tuple[dict[str, Array], Mask]:
    """Statistics by name and the final "state" of every point; and where that failed."""
    with np.errstate(all="ignore"):
        turns = system.frequency_bound(points) * duration
        usable = np.isfinite(system.initial_state(points)).all(0) & (turns <= MAX_RADIANS)
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
        part = _integrate_group(system, some, duration[group], cylinder, rtol, advance)
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


def _integrate_group(
    system: System,
    points: Points,
    duration: Array,
    cylinder: float,
    rtol: float,
    advance: Advance = no_progress,
) -> dict[str, Array] | None:
    """The points as one system of equations in t / duration; None if a step fails."""
    equations, constants, start = system.equations, system.constants(points), system.initial_state(points)
    states, size = start.shape
    first = euler_rates(equations.frame_motion(start, constants), cylinder)

    def slope(time: float, flat: Array) -> Array:
        state = flat.reshape(-1, size)[:states]
        now = euler_rates(equations.frame_motion(state, constants), cylinder)
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
    rates = euler_rates(equations.frame_motion(path[: len(equations.STATE)], constants[:, :, None]), cylinder)
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
