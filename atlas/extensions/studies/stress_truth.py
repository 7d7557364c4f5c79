"""True labels of stress cases from theory, exact motions, departures from equilibria, or the reference integrator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from ...flags import Label
from ...label.theory import predict
from ...measure.instrument import RunSettings, could_change
from ...measure.rates import LABEL_STATISTICS, rule
from ...scene.tables import point_columns
from ...systems.base import Array, Flags, Mask, Points, StressCase, System, families_of, subset
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.system import log_growth
from ...theory.motions import condition_residual
from ...theory.prediction import rounding_limit
from ...variables import main_instrument
from . import exact
from .reference import EXACT_RESIDUAL, largest_sine, reference

# Runs of up to MAX_RADIANS_WHOLE rad at the frequency bound are integrated whole, longer runs only for RADIANS_OF_PART rad.
MAX_RADIANS_WHOLE, RADIANS_OF_PART = 170.0, 40.0
# Statistics that exact motions give. EXACT_ACCURACY is the error of an angle, or of a rate divided by the frequency bound.
EXACT_STATISTICS = (
    "theta_dot_rms", "theta_dot_std", "psi_dot_mean", "psi_dot_std", "phi_dot_mean", "phi_dot_std",
    "normal_rate_mean", "normal_rate_std", "theta_min", "theta_max",
)  # fmt: skip
EXACT_ACCURACY = 1e-12
# The fraction of a run outside the cylinder has this error, because a node or two may lie on the wrong side of the rim.
SHARE_ACCURACY = 0.05
# An offset from an equilibrium is uncertain by the rounding of the state.
STATE_ROUNDING = 3e-16


@dataclass(frozen=True)
class TrueLabels:
    """True labels of some points, in arrays of shape (points,)."""

    label: Flags  # `Label.UNRESOLVED` where rounding decides or numbers overflow
    unsteadiness: (
        Array  # largest rms or standard deviation of the rates, rad per time unit; NaN where unknown
    )
    source: np.ndarray  # "theory", "exact motion", "departure", "reference", "part of the run" or "overflow"
    statistics: Array  # EXACT_STATISTICS, (statistics, points); NaN unless the source is an exact motion

    @classmethod
    def join(cls, parts: Sequence[TrueLabels]) -> TrueLabels:
        """Concatenate the labels of several sets of points."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*(np.concatenate(each, axis=-1) for each in columns))

    def subset(self, where: Mask) -> TrueLabels:
        """Return the labels of the points where a mask is true."""
        return TrueLabels(*(each[..., where] for each in vars(self).values()))


@dataclass(frozen=True)
class CasePoints:
    """A stress case as arrays of shape (points,)."""

    name: str
    points: Points
    base: Points  # the points before `StressCase.additions` are added
    duration: Array  # time units
    names: np.ndarray  # names of the points, made of the values that vary within the case
    may_stay_unresolved: str
    truth: str | Callable[[Points], Any]  # as in StressCase

    def subset(self, where: Mask) -> CasePoints:
        """Return the case with only the points where a mask is true."""
        return replace(
            self,
            points=subset(self.points, where),
            base=subset(self.base, where),
            duration=self.duration[where],
            names=self.names[where],
        )


def case_points(system: System, case: StressCase) -> CasePoints:
    """Return the points of a case. `case.solve` puts the points on a family, and then `case.additions` are added."""
    varying = {k: np.asarray(v, float) for k, v in {**case.columns, **case.additions}.items() if np.ndim(v)}
    size = max((values.size for values in varying.values()), default=1)
    points, _ = point_columns(
        system, {name: np.broadcast_to(values, (size,)) for name, values in case.columns.items()}
    )
    if case.solve is not None:
        family, parameter = case.solve
        points[parameter] = families_of(system)[family].solve[parameter](points)
    base = dict(points)
    for name, amount in case.additions.items():
        points[name] = points[name] + np.asarray(amount, float)
    varying |= {"duration": np.asarray(case.duration, float)} if np.ndim(case.duration) else {}
    names = [", ".join(f"{k} = {v[i]:.4g}" for k, v in varying.items() if v.any()) for i in range(size)]
    duration = np.broadcast_to(np.asarray(case.duration, float), (size,)).copy()
    return CasePoints(
        case.name, points, base, duration, np.array(names), case.may_stay_unresolved, case.truth
    )


def true_labels(system: System, part: CasePoints, settings: RunSettings) -> TrueLabels:
    """Return the true label and unsteadiness of each point, or raise ValueError if no source in docs/stress.md decides."""
    points, duration, truth = part.points, part.duration, part.truth
    if truth == "departure":
        rest, constants = system.initial_state(part.base), system.constants(points)
        offset = system.initial_state(points) - rest
        runs = _departures(system, rest, offset, constants, duration, settings.cylinder)
        return _labels_of_runs(
            system, runs, settings, "departure", 1e-3 + STATE_ROUNDING / np.abs(offset).max(0)
        )
    if truth:
        motions = (exact.motion_of(system, truth, points, i) for i in range(duration.size))
        runs = [
            exact.statistics(motion, T, settings.cylinder)
            for motion, T in zip(motions, duration, strict=True)
        ]
        return _labels_of_runs(system, runs, settings, "exact motion")
    with np.errstate(all="ignore"):
        theory = predict(system, points, settings.tolerances, duration)
        residual, bound = condition_residual(system, points), system.frequency_bound(points)
        is_exact = (theory["family"] > 0) & (residual <= EXACT_RESIDUAL)
        growth = log_growth(system, points, theory["family"], theory["growth_rate"], duration)
        limit = rounding_limit(residual, bound, settings.tolerances.rate, settings.tolerances.angle)
        despun, excess = (
            system.despun(points) if isinstance(system, Gyrostat) else (points, np.zeros(duration.shape))
        )
        radians = system.frequency_bound(despun) * duration
    tilted = np.abs(system.steady_rates(points)[0]) > 0
    unknown = is_exact & tilted & np.isnan(theory["growth_rate"])
    growth[unknown] = linear_growth(
        system, subset(points, unknown), theory["family"][unknown], duration[unknown]
    )
    by_rounding = tilted & (growth > 0) & (growth > limit)
    label = np.where(by_rounding, Label.UNRESOLVED, theory["predicted"]).astype(np.int8)
    unsteadiness, source = np.zeros(duration.shape), np.full(duration.shape, "theory", "<U15")
    overflow = ~is_exact & (~np.isfinite(radians) | (radians > 1e100))
    label[overflow], unsteadiness[overflow], source[overflow] = Label.UNRESOLVED, np.nan, "overflow"
    others = np.flatnonzero(~is_exact & ~overflow)
    if others.size:
        despun_part = subset(despun, others), excess[others], duration[others], radians[others]
        solved, undecided = _labels_by_reference(system, *despun_part, settings.subset(others))
        if undecided.any():
            raise ValueError(f"the reference cannot decide the labels of points {others[undecided]}")
        label[others], unsteadiness[others] = solved.label, solved.unsteadiness
        source[others] = solved.source
    return TrueLabels(label, unsteadiness, source, no_statistics(duration.size))


def no_statistics(size: int) -> Array:
    """Return NaN for every statistic of `size` points, which follow no exact motion."""
    return np.full((len(EXACT_STATISTICS), size), np.nan)


def _labels_of_runs(
    system: System,
    runs: Sequence[Mapping[str, float]],
    settings: RunSettings,
    source: str,
    departure_error: Array | None = None,
) -> TrueLabels:
    """Return labels from statistics. For departures from equilibria, rms and std have the relative error `departure_error`, (points,)."""
    measured = {name: np.array([run[name] for run in runs]) for name in (*EXACT_STATISTICS, "outside")}
    measured["sine_max"] = largest_sine(measured["theta_min"], measured["theta_max"])
    if departure_error is None:
        error = {name: np.full(len(runs), EXACT_ACCURACY) for name in LABEL_STATISTICS}
    else:
        error = {
            name: np.abs(measured[name]) * np.where(name.endswith(("rms", "std")), departure_error, 1e-12)
            for name in LABEL_STATISTICS
        }
    error["outside"] = np.where(np.abs(measured["outside"] - 0.5) < 0.5, SHARE_ACCURACY, 0.0)
    with np.errstate(invalid="ignore"):
        undecided = could_change(rule(settings.tolerances), measured, error)
        label = rule(settings.tolerances).label(measured)
    if undecided.any():
        raise ValueError(f"the {source} cannot decide the labels of points {np.flatnonzero(undecided)}")
    unsteadiness = main_instrument(system).unsteadiness(system, measured, settings)
    statistics = np.array([measured[name] for name in EXACT_STATISTICS])
    return TrueLabels(
        label,
        unsteadiness,
        np.full(len(runs), source, "<U15"),
        statistics if departure_error is None else no_statistics(len(runs)),
    )


def _departures(
    system: System, rest: Array, offset: Array, constants: Array, duration: Array, cylinder: float
) -> list[dict[str, float]]:
    """Return statistics of runs that start at tiny offsets from equilibria.

    The runs are integrated as one system in the time t / duration. The state is x + e d, where x is the equilibrium and e the
    size of the offset. The right-hand side is quadratic in the state and vanishes at x, so that d' = J d + e Q(d) with the
    Jacobian J and the quadratic part Q. This equation loses no digits, however small e is.
    """
    rhs, size, wide = system.equations.rhs, np.abs(offset).max(0), tuple(constants[:, None])

    def slope(_: float, flat: Array) -> Array:
        """Return the derivative of the departure d by t / duration."""
        d = flat.reshape(rest.shape)
        states = np.stack([rest + 1e-30j * d, d, -d], axis=1)  # one call is cheaper than three
        tangent, ahead, behind = np.moveaxis(np.array(rhs(states, wide)), 1, 0)
        return (duration * (tangent.imag / 1e-30 + 0.5 * size * (ahead.real + behind.real))).ravel()

    first = (offset / size).ravel()
    run = solve_ivp(slope, (0.0, 1.0), first, "DOP853", rtol=1e-11, atol=1e-11, dense_output=True)
    if not run.success:
        raise ValueError("the departures from equilibria cannot be integrated")
    length = np.diff(run.t)[:, None]
    time = (run.t[:-1, None] + 0.5 * length * (1 + exact.GAUSS_NODES)).ravel()
    weight = (0.5 * length * exact.GAUSS_WEIGHTS).ravel()
    states = rest[..., None] + size[:, None] * run.sol(time).reshape(*rest.shape, -1)
    result = []
    for i in range(duration.size):
        u1, u2, u3, g1, g2, g3 = system.equations.frame_motion(states[:, i], constants[:, i, None])
        motion = exact.euler_motion(np.array([u1, u2, u3]), np.array([g1, g2, g3]))
        ends = {"theta_min": float(motion.theta.min()), "theta_max": float(motion.theta.max())}
        result.append(exact.moments(motion, weight, cylinder) | ends)
    return result


def linear_growth(system: System, points: Points, flags: Flags, duration: Array) -> Array:
    """Return the logarithm of the growth of a disturbance along each steady motion; `flags` name the families."""
    motions = {family.flag: family.motion for family in families_of(system).values()}
    starts = [subset(points, slice(i, i + 1)) for i in range(duration.size)]
    runs = zip(flags, starts, duration, strict=True)
    return np.array([_growth_along(system, motions[flag], start, time) for flag, start, time in runs])


def _growth_along(system: System, motion: Any, point: Points, duration: float) -> float:
    """Return the logarithm of the norm of the fundamental matrix at the end of a steady motion."""
    size, constants = len(system.equations.STATE), tuple(system.constants(point))

    def slope(time: float, flat: Array) -> Array:
        """Return the time derivatives of the columns of the fundamental matrix."""
        state = motion(point, np.array([time])).reshape(size, 1)
        columns = system.equations.rhs(state + 1e-30j * flat.reshape(size, size), constants)
        return (np.array(columns).imag / 1e-30).ravel()

    run = solve_ivp(slope, (0.0, duration), np.eye(size).ravel(), "DOP853", rtol=1e-7, atol=1e-7)
    return float(np.log(np.linalg.norm(run.y[:, -1].reshape(size, size), 2)))


def _labels_by_reference(
    system: System, despun: Points, excess: Array, duration: Array, radians: Array, settings: RunSettings
) -> tuple[TrueLabels, Mask]:
    """Return labels by the reference integrator, and a mask of the points that remain undecided.

    phi' of the despun points exceeds the true phi' by `excess`. Only a part of a long run is integrated. If an rms or
    standard deviation over the part exceeds the tolerance by the factor sqrt(whole / part), the whole run drifts.
    """
    whole = radians <= MAX_RADIANS_WHOLE
    share = np.where(whole, 1.0, RADIANS_OF_PART / np.maximum(radians, 1e-300))
    solution = reference(system, despun, duration * share, settings)
    measured, error = dict(solution.statistics), solution.statistics_error
    measured["phi_dot_mean"] = measured["phi_dot_mean"] - excess
    for name in ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std"):
        measured[name] = measured[name] * np.sqrt(share)
    tolerances = settings.tolerances
    with np.errstate(invalid="ignore"):
        label = rule(tolerances).label(measured)
        undecided = could_change(rule(tolerances), measured, error) | (~whole & (label != Label.DRIFTING))
    source = np.where(whole, "reference", "part of the run")
    unsteady = np.where(whole, main_instrument(system).unsteadiness(system, measured, settings), np.nan)
    return TrueLabels(label, unsteady, source, no_statistics(duration.size)), undecided
