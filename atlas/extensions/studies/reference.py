"""Reference solutions, computed from closed forms and by SciPy's DOP853."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import DOP853, solve_ivp

from ...errors import BadInput
from ...kernel.quadratures import euler_rates
from ...kernel.specialization import slope_kernel
from ...kernel.statistics import NEEDS_PSI, RATES, Row, finish
from ...measure import observables, rates
from ...measure.instrument import RunSettings
from ...measure.rates import state_distance
from ...systems.base import Array, Flags, Mask, Points, System, families_of, subset
from ...theory.motions import condition_residual
from ...variables import main_instrument

# Rows of the sums that are integrated together with the states, in the order of `kernel.quadratures`.
RATE_SUMS = (
    Row.THETA_DOT_SQUARED, Row.THETA_DOT_CHANGE, Row.THETA_DOT_CHANGE_SQUARED, Row.OUTSIDE, Row.PSI_DOT, Row.PSI_DOT_SQUARED,
    Row.PHI_DOT, Row.PHI_DOT_SQUARED, Row.NORMAL_RATE, Row.NORMAL_RATE_SQUARED,
)  # fmt: skip
# Relative tolerances of the reference run and of a second run. The uncertainty is SAFETY times the difference of both runs.
REFERENCE_RTOL, SECOND_RTOL, SAFETY = 3e-14, 1e-13, 10.0
# Rounding alone makes a component of the state uncertain by this much.
LEAST_UNCERTAINTY = 1e-15
# A start whose residual is at most this large is exactly on its family, because rounding explains the residual.
EXACT_RESIDUAL = 1e-14
# A run whose duration times frequency bound, in rad, exceeds this value would take DOP853 too long.
MAX_RADIANS = 1e5
# Points are integrated as one system if the products of duration and frequency bound differ by at most this factor.
GROUP_FACTOR = 2.0

Advance = Callable[[float], None]  # called with the number of points finished since the last call
Run = dict[str, Array]  # "state" of shape (states, points), the others of shape (points,)


def no_progress(points: float) -> None:
    """Report no progress."""


@dataclass(frozen=True)
class Reference:
    """Reference solution of some points, with the uncertainty of the solution."""

    state: Array  # state at the end of the run, (states, points)
    # Statistics of the main instrument by name. "sine_max" is the largest sine of theta. "outside" is the fraction of time outside the
    # cylinder about the vertical. Statistics of psi' and phi' are NaN if the axis stays inside the cylinder.
    statistics: dict[str, Array]
    label: Flags
    label_inertial: Flags | None  # None for a system with one frame
    exact: Mask  # true where the closed form of a family is used
    state_error: Array  # uncertainty of the state, measured by `state_distance`
    statistics_error: dict[str, Array]  # uncertainty of each statistic, in the units of the statistic
    label_certain: Mask  # whether a second solution gives the same labels


class ReferenceFailure(BadInput):
    """Error for points whose reference solution cannot be computed."""

    def __init__(self, indices: np.ndarray):
        super().__init__(f"the reference fails at points {', '.join(map(str, indices))}")
        self.indices = indices


def reference(
    system: System, points: Points, duration: Array, settings: RunSettings, advance: Advance = no_progress
) -> Reference:
    """Return final states, statistics and labels, or raise ReferenceFailure.

    SciPy's DOP853 integrates every point twice, at the relative tolerances REFERENCE_RTOL and SECOND_RTOL. The result is the
    first run, or the closed form where a start is exactly on a family. The uncertainty is SAFETY times the difference between
    the two runs, or between the closed form and the first run. The closed form is no more certain than a run, because the
    rounding error of an exact start grows along an unstable motion.
    """
    runs = []
    for rtol in (REFERENCE_RTOL, SECOND_RTOL):
        run, failed = _dop853(system, points, duration, settings.cylinder, rtol, advance, settings.transient)
        if failed.any():
            raise ReferenceFailure(np.flatnonzero(failed))
        runs.append(run)
    best, other = runs
    exact = np.zeros(duration.shape, bool)
    main = main_instrument(system)
    if main.has_theory:
        closed, exact = _closed_forms(system, points, settings.transient + duration, settings.cylinder)
        best = {name: np.where(exact, closed[name], runs[0][name]) for name in runs[0]}
        other = {name: np.where(exact, runs[0][name], runs[1][name]) for name in runs[0]}
    frame_rates: list[Array | float] = [0.0]
    if system.frame_rate is not None:
        frame_rates.append(system.frame_rate(points))
    labels = []
    for run in (best, other):
        if main.has_theory:
            with np.errstate(invalid="ignore"):
                labels.append(np.array([rates.label(run, settings.tolerances, rate) for rate in frame_rates]))
            inside = rates.in_cylinder(run, settings.cylinder)  # where psi' and phi' are undefined
            run |= {name: np.where(inside, np.nan, run[name]) for name in NEEDS_PSI}
        else:
            limits = observables.std_tolerances(system, settings.std_tolerance, settings.rate_tolerance)
            labels.append(observables.label(run, limits)[None])
    label, other_label = labels
    distance = state_distance(system, best["state"], other["state"], system.frequency_bound(points))
    return Reference(
        state=best.pop("state"),
        statistics=best,
        label=label[0],
        label_inertial=label[1] if len(label) > 1 else None,
        exact=exact,
        state_error=np.maximum(SAFETY * distance, LEAST_UNCERTAINTY),
        statistics_error={
            name: np.maximum(SAFETY * np.abs(best[name] - other[name]), LEAST_UNCERTAINTY) for name in best
        },
        label_certain=(label == other_label).all(0),
    )


def reference_where_possible(
    system: System, points: Points, duration: Array, settings: RunSettings, advance: Advance = no_progress
) -> tuple[Reference | None, np.ndarray]:
    """Return the reference solution of the points that do not fail, or None if all fail, and the indices of these points."""
    indices = np.arange(duration.size)
    while indices.size:
        try:
            part = subset(points, indices), duration[indices], settings.subset(indices)
            solution = reference(system, *part, advance)
        except ReferenceFailure as failure:
            indices = np.delete(indices, failure.indices)
        else:
            return solution, indices
    return None, indices


def largest_sine(theta_min: Array, theta_max: Array) -> Array:
    """Return the largest sin(theta) for theta between two angles in rad."""
    contains_right_angle = (theta_min <= np.pi / 2) & (theta_max >= np.pi / 2)
    return np.where(contains_right_angle, 1.0, np.maximum(np.sin(theta_min), np.sin(theta_max)))


def _closed_forms(system: System, points: Points, duration: Array, cylinder: float) -> tuple[Run, Mask]:
    """Return the steady motions in closed form, and a mask of the points that start exactly on a family."""
    flags, _ = system.identify_family(points)
    motions = {f.flag: f.motion for f in families_of(system).values() if f.motion is not None}
    exact = (condition_residual(system, points) <= EXACT_RESIDUAL) & np.isin(flags, list(motions))
    start = system.initial_state(points)
    motion = system.equations.frame_motion(start, system.constants(points))
    _, psi_dot, phi_dot, normal_rate, _, theta = euler_rates(motion, cylinder)
    run = {name: np.zeros(exact.size) for name in RATES} | {
        "psi_dot_mean": psi_dot, "phi_dot_mean": phi_dot, "normal_rate_mean": normal_rate, "theta_min": theta,
        "theta_max": theta, "sine_max": np.sin(theta), "outside": np.where(np.sin(theta) < cylinder, 0.0, 1.0),
        "state": np.full_like(start, np.nan),
    }  # fmt: skip
    for flag in np.unique(flags[exact]):
        members = np.flatnonzero(exact & (flags == flag))
        states = motions[flag](subset(points, members), duration[members])
        run["state"][:, members] = np.einsum("sii->si", states)  # each point at the end of its run
    return run, exact


def _dop853(
    system: System, points: Points, duration: Array, cylinder: float, rtol: float, advance: Advance,
    transient: Array | float = 0.0,
) -> tuple[Run, Mask]:  # fmt: skip
    """Integrate the points by DOP853; return the runs and a mask of the points that failed, whose values are NaN."""
    with np.errstate(all="ignore"):
        radians = system.frequency_bound(points) * (transient + duration)
        usable = np.isfinite(system.initial_state(points)).all(0) & (radians <= MAX_RADIANS)
    failed = ~usable
    run: Run = {}
    # The points of a group need about the same number of steps.
    groups = []
    indices = np.flatnonzero(usable)
    indices = indices[np.argsort(radians[indices], kind="stable")]
    while indices.size:
        similar = radians[indices] <= GROUP_FACTOR * radians[indices[0]]
        groups.append(indices[similar])
        indices = indices[~similar]
    while groups:
        group = groups.pop()
        members = subset(points, group)
        start = _after_transient(system, members, np.broadcast_to(transient, duration.shape)[group], rtol)
        if main_instrument(system).has_theory:
            part = _integrate_group(system, members, duration[group], cylinder, rtol, advance, start)
        else:
            part = integrate_observed_group(system, members, duration[group], rtol, advance, start)
        if part is None and group.size == 1:
            failed[group] = True
        elif part is None:  # halve the group until the point that fails is alone
            groups += [group[: group.size // 2], group[group.size // 2 :]]
        else:
            for name, values in part.items():
                whole = run.setdefault(name, np.full((*values.shape[:-1], radians.size), np.nan))
                whole[..., group] = values
    return run, failed


def _after_transient(system: System, points: Points, transient: Array | float, rtol: float) -> Array:
    """Return the states after the transients, or NaN if the integration fails. All points form one system of equations."""
    start, constants, rhs = system.initial_state(points), system.constants(points), system.equations.rhs

    def slope(_: float, flat: Array) -> Array:
        return np.concatenate([transient * rate for rate in rhs(flat.reshape(start.shape), constants)])

    if not np.any(transient):
        return start
    run = solve_ivp(slope, (0.0, 1.0), start.ravel(), "DOP853", rtol=rtol, atol=rtol)
    return run.y[:, -1].reshape(start.shape) if run.success else np.full_like(start, np.nan)


def _integrate_group(
    system: System,
    points: Points,
    duration: Array,
    cylinder: float,
    rtol: float,
    advance: Advance = no_progress,
    start: Array | None = None,
) -> Run | None:
    """Integrate the points as one system of equations in the time t / duration. Return None if a step fails."""
    equations, constants = system.equations, system.constants(points)
    start = system.initial_state(points) if start is None else start
    states, size = start.shape
    *first, _, theta0 = euler_rates(equations.frame_motion(start, constants), cylinder)
    rates0, wide, write_slopes = np.array(first), tuple(constants[:, :, None]), slope_kernel(system).integrate

    def slope(time: float, flat: Array) -> Array:
        """Return the derivatives of the states, then those of the sums in the order of RATE_SUMS."""
        slopes = np.empty_like(flat)
        path = flat.reshape(-1, size)
        write_slopes(path, constants, duration, rates0, cylinder, slopes.reshape(path.shape))
        return slopes

    def theta_along(path: Array) -> tuple[Array, Array]:
        theta_dot, *_, theta = euler_rates(equations.frame_motion(path, wide), cylinder)
        return theta, theta_dot

    end = _final_and_range(slope, start, len(RATE_SUMS), rtol, theta_along, theta0, duration, advance)
    if end is None:
        return None
    final, theta_min, theta_max = end
    *_, theta = euler_rates(equations.frame_motion(final[:states], constants), cylinder)
    out = np.zeros((len(Row), size))
    out[list(RATE_SUMS)] = final[states:]
    references = list(range(Row.THETA_DOT_REFERENCE, Row.NORMAL_RATE_REFERENCE + 1))
    out[[*references, Row.FIRST_THETA, Row.LAST_THETA]] = *rates0, theta0, theta
    result = finish(out, np.ones(size, np.int64), duration)
    return {name: result[name] for name in (*RATES, "outside")} | {
        "theta_min": theta_min, "theta_max": theta_max, "sine_max": largest_sine(theta_min, theta_max),
        "state": final[:states],
    }  # fmt: skip


def _final_and_range(
    slope: Callable[[float, Array], Array],
    start: Array,
    sums: int,
    rtol: float,
    values_along: Callable[[Array], tuple[Array, Array]],
    at_start: Array,
    duration: Array,
    advance: Advance,
) -> tuple[Array, Array, Array] | None:
    """Integrate to the time 1; return the states and sums there, and the extremes of some values along the way.

    `values_along` returns the values and the time derivatives at states (states, points, instants). If a step fails, return None.
    """
    states, size = start.shape
    # The sums have a looser tolerance than the states, so that the sums shorten the steps only where a rate has a peak.
    tolerance = np.repeat([rtol, 1e2 * rtol], [states * size, sums * size])
    initial = np.concatenate([start.ravel(), np.zeros(sums * size)])
    lowest = highest = at_start
    with np.errstate(all="ignore"):
        solver = DOP853(slope, 0.0, initial, 1.0, rtol=tolerance, atol=tolerance)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                return None
            times = np.linspace(solver.t_old, solver.t, 5)
            value, rate = values_along(solver.dense_output()(times).reshape(-1, size, times.size)[:states])
            low, high = range_of_cubics(value, rate * (duration * (times[1] - times[0]))[:, None])
            lowest, highest = np.minimum(lowest, low), np.maximum(highest, high)
            advance(size * (solver.t - solver.t_old))
    return solver.y.reshape(-1, size), lowest, highest


# Length of the complex step with which an observable is differentiated along the motion.
COMPLEX_STEP = 1e-30


def observe(system: System, state: Array, constants: Array) -> Array:
    """Return the values of the observables, of shape (observables, *points)."""
    equations = system.equations
    rows = [
        getattr(equations, o.name)(state, constants)
        if hasattr(equations, o.name)
        else state[equations.STATE.index(o.name)]
        for o in system.observables
    ]
    return np.array([row + 0.0 * state[0] for row in rows])


def integrate_observed_group(
    system: System, points: Points, duration: Array, rtol: float, advance: Advance, start: Array
) -> dict[str, Array] | None:
    """Integrate the points as one system of equations in the time t / duration. Return None if a step fails."""
    equations, constants, (states, size) = system.equations, system.constants(points), start.shape
    first = observe(system, start, constants)
    periods, duration = observables.whole_periods(system, constants, duration)

    def slope(time: float, flat: Array) -> Array:
        """Return the derivatives of the states and of the integrals of g, g^2 and u g (see `kernel.observe`)."""
        state = flat.reshape(-1, size)[:states]
        change = observe(system, state, constants) - first
        rows = [duration * rate for rate in equations.rhs(state, constants)]
        return np.concatenate([*rows, *change, *change**2, *((time - 0.5) * change)])

    def observables_along(path: Array) -> tuple[Array, Array]:
        wide = constants[:, :, None]
        rate = np.array([row + 0.0 * path[0] for row in equations.rhs(path, wide)])
        stepped: Any = path + 1j * COMPLEX_STEP * rate
        return observe(system, path, wide), observe(system, stepped, wide).imag / COMPLEX_STEP

    count = len(first)
    end = _final_and_range(slope, start, 3 * count, rtol, observables_along, first, duration, advance)
    if end is None:
        return None
    final, lowest, highest = end
    total, square, trend = final[states:].reshape(3, count, size)
    deviation = np.sqrt(np.maximum(square - total**2, 0.0))
    columns = np.stack([first + total, deviation, lowest, highest, 12.0 * trend], axis=1)
    if periods is not None:  # observables measured once a period have values only at the ends of periods
        times = np.unique(np.concatenate([np.arange(n + 1) / n for n in np.unique(periods)]))
        place = times * periods[:, None]
        path = solve_ivp(
            lambda time, flat: slope(time, flat)[: flat.size],
            (0.0, 1.0), start.ravel(), "DOP853", times, rtol=rtol, atol=rtol,
        ).y.reshape(states, size, -1)  # fmt: skip
        values = observe(system, path, constants[:, :, None]) - first[:, :, None]
        values[:, np.abs(place - np.rint(place)) > 1e-9] = np.nan
        trend = 12 * periods / (periods + 1) / (periods + 2) * np.nansum((times - 0.5) * values, axis=-1)
        kinds = [summary(values, axis=-1) for summary in (np.nanmean, np.nanstd, np.nanmin, np.nanmax)]
        strobed = [observables.is_strobed(o) for o in system.observables]
        added = np.stack([first, 0 * first, first, first, 0 * first], axis=1)
        columns[strobed] = (np.stack([*kinds, trend], axis=1) + added)[strobed]
    names = main_instrument(system).statistics(system)
    return dict(zip(names, columns.reshape(-1, size), strict=True)) | {"state": final[:states]}


def range_of_cubics(value: Array, slope: Array) -> tuple[Array, Array]:
    """Return the extremes, along the last axis, of the cubics with these values and slopes at instants at unit distance."""
    left, right, rise = slope[..., :-1], slope[..., 1:], np.diff(value, axis=-1)
    # On 0 <= x <= 1 the cubic is value + left x + b x^2 + c x^3. It has an extremum inside if the end slopes left and right differ in sign.
    b, c = 3 * rise - 2 * left - right, left + right - 2 * rise
    root = np.sqrt(np.maximum(b**2 - 3 * left * c, 0.0))
    x = -left / (b + np.where(left > 0, -root, root))
    turning = value[..., :-1] + x * (left + x * (b + x * c))
    turning = np.where((left * right < 0) & (x >= 0) & (x <= 1), turning, value[..., :-1])
    candidates = np.concatenate([value, turning], axis=-1)
    return candidates.min(-1), candidates.max(-1)
