"""Stiff and extreme cases: a battery of named points whose truth is known, run at a ladder of steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from . import compare, labels, systems
from .accuracy import EXACT, reference
from .engine import lanes, steps
from .engine.runge_kutta import METHODS, Method
from .evaluate import evaluate, kernel
from .runner import point_columns
from .scene import Settings
from .systems.system import Array, Flags, Mask, Points, System
from .variables import STATUS, variables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The ladder, coarse to fine: fixed steps as a share of the stability limit at the frequency bound, then
# the automatic step at tolerances down to the default one.
RATIOS = (1.5, 0.9, 0.49, 0.3, 0.15, 0.06, 0.025, 0.01)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)
RUNGS = tuple(f"ratio {ratio:g}" for ratio in RATIOS) + tuple(f"tolerance {tol:.0e}" for tol in TOLERANCES)
# A rung that takes more steps than this for a point is left out.
MOST_STEPS = 10_000_000
# A reference follows a whole run of so many radians at the frequency bound, and this much of a longer one.
WHOLE, PART = 170.0, 40.0
# A spread of the rates within this share of itself, or of the tolerance where that is more, is accurate.
ACCURATE = 0.01
RIGHT, UNRESOLVED, WRONG, LEFT_OUT = range(4)
VERDICTS = {
    "right": "the label is true",
    "unresolved": "no label",
    "wrong": "a label that is not true",
    "left_out": "more steps than the battery allows",
}


@dataclass(frozen=True)
class Case:
    """Points of one kind."""

    name: str
    text: str
    points: Points
    duration: Array  # (points,), time units
    names: tuple[str, ...]  # of the points, within the case
    may: str = ""  # why an automatic step, too, may leave a point unresolved


class _Maker:
    def __init__(self, system: System):
        self.system = system

    def __call__(
        self,
        name: str,
        text: str,
        duration: Any = 20.0,
        *,
        solve: tuple[str, str] | None = None,
        add: Mapping[str, Any] | None = None,
        may: str = "",
        **columns: Any,
    ) -> Case:
        """A case: parameters as numbers or columns, solve = (family, parameter), then add to parameters."""
        varying = {k: np.asarray(v, float) for k, v in ({**columns, **(add or {})}).items() if np.ndim(v)}
        size = max((v.size for v in varying.values()), default=1)
        columns.setdefault("phi0", np.zeros(size))
        points, size = point_columns(self.system, columns)
        if solve is not None:
            points[solve[1]] = self.system.families[solve[0]].solve[solve[1]](points)
        for key, value in (add or {}).items():
            points[key] = points[key] + value
        names = [", ".join(f"{k} = {v[i]:.4g}" for k, v in varying.items() if v.any()) for i in range(size)]
        times = np.broadcast_to(np.asarray(duration, float), (size,)).copy()
        return Case(name, text, points, times, tuple(names), may)


OVERFLOW = "the numbers overflow"
GROWN = "the method's own error grows with the motion before rounding does"


def _decades(first: int, last: int, every: int = 1) -> Array:
    return np.asarray(10.0 ** np.arange(first, last + every / abs(every), every))


def satellite_battery() -> list[Case]:
    """The cases of the satellite; Omega = 1 but where it is said."""
    case = _Maker(systems.get("satellite"))
    tilted: dict[str, Any] = {"theta0": 0.6, "psi0": 0.3, "m": 0.5}
    hyperbola: dict[str, Any] = {"theta0": 0.8, "psi0": np.pi / 2, "C": 0.7}  # a stable perp_velocity motion
    unstable: dict[str, Any] = {"theta0": 1.0, "psi0": np.pi / 2, "C": 1.2, "m": 0.3}
    fast, up = _decades(0, 6), _decades(-2, -12, -2)
    spins, fields = _decades(-6, 4, 2), _decades(-8, 6, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip: dict[str, Any] = {"A": 1.0, "B": 2.0, "C": 1.5, "Omega": 0.0, "m": 1.0}
    return [
        case("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast), k3=fast,
             theta_dot0=0.1, **tilted),
        case("stiff spin", "fast spin with the rotor against it: the axis moves slowly", np.minimum(20, 2e3 / fast),
             k3=0.3 - 1.2 * fast, theta0=0.6, psi0=0.3, m=fast),
        case("stiff steady", "the same on an exact steady motion", np.minimum(20, 2e3 / fast),
             solve=("perp_velocity", "k3"), m=fast, **hyperbola),
        case("spin", "exact regular precession of a spherical body, slow to fast spin", np.minimum(20, 2e3 / spins),
             solve=("spherical", "k3"), C=1.0, n=0.5, theta0=1.0, m=spins),
        case("needle", "C towards 0", 20.0, C=_decades(-1, -6, -1), **tilted),
        case("flat body", "A + B = C", 20.0, A=np.array([1.0, 0.3, 1e-3]), B=np.array([1.0, 0.7, 1.0]),
             C=np.array([2.0, 1.0, 1.001]), **tilted),
        case("needle across", "A towards 0", np.array([20.0, 5.0, 1.0]), A=_decades(-2, -6, -2), C=1.0, **tilted),
        case("near 0", "tilts of a stable cylindrical motion", 20.0, theta0=tilts, C=1.3, m=1.5),
        case("near pi", "the same upside down", 20.0, theta0=np.pi - tilts, C=1.3, m=-3.5),
        case("steep precession", "exact regular precession close to the vertical", 20.0,
             solve=("spherical", "k3"), C=1.0, n=0.5, m=0.7, theta0=np.array([1e-1, 1e-2, 1e-3, 1e-4])),
        case("through the pole", "great circles through the vertical", 5.0,
             Omega=np.array([0.0, 1.0, 1.0]), theta0=0.5, theta_dot0=-3.0, k3=np.array([0.0, 0.0, 0.2])),
        case("field", "magnet in weak to strong fields", np.minimum(20, 30 / np.sqrt(fields)),
             mu3=1.0, mu1=0.2, h1=fields, h3=0.3 * fields, **tilted),
        case("weak field", "a steady motion that a field disturbs", 20.0, solve=("perp_velocity", "k3"),
             add={"h1": _decades(-12, -4, 2)}, mu1=1.0, m=0.4, **hyperbola),
        case("separatrix", "beside an unstable motion", 30.0, solve=("perp_velocity", "k3"), add={"theta0": up},
             **unstable),
        case("racket", "free body about its middle axis, pushed a little", 60.0, theta_dot0=up, **flip),
        case("unstable, short", "exactly on an unstable motion", 20.0, solve=("perp_velocity", "k3"),
             **unstable | {"m": np.array([0.3, 3.0, 30.0])}),
        case("unstable, middle", "the same, longer", 50.0, solve=("perp_velocity", "k3"), may=GROWN,
             **unstable | {"m": np.array([0.3, 3.0, 30.0])}),
        case("unstable, long", "the same, until rounding decides", 500.0, solve=("perp_velocity", "k3"), **unstable),
        case("hidden growth", "fast spin on top of slow growth", 40.0, solve=("perp_velocity", "k3"),
             add={"theta0": np.array([1e-4, 1e-5, 1e-6])}, **unstable | {"m": 60.0}),
        case("slower than the run", "a weak gravity gradient", 4.0, C=1.0 + _decades(-2, -8, -2), **tilted | {"m": -1.0}),
        case("10 000 orbits", "exactly steady, and drifting", 2e4 * np.pi, solve=("perp_velocity", "k3"),
             add={"theta0": np.array([0.0, 0.3])}, m=0.4, **hyperbola),
        case("Omega = 0", "free and heavy bodies that orbit nothing", 20.0, Omega=0.0, theta0=np.array([0.0, 0.7, 0.7]),
             m=0.5, n=np.array([0.0, 0.0, 0.4]), h3=np.array([0.0, 0.0, 1.0]), mu3=1.0),
        case("at rest", "nothing turns at all", 20.0, Omega=0.0, theta0=np.array([0.0, 0.5])),
        case("denormal", "parameters of 1e-300 and less", 20.0, theta0=np.array([1e-310, 0.5, 0.5]),
             k1=np.array([1e-310, 0.0, 1e-320]), m=np.array([0.5, 1e-300, 1e-310]), h1=1e-310, mu2=1e-310),
        case("overflow", "products of parameters overflow", 20.0, may=OVERFLOW, theta0=0.5,
             k1=np.array([1e200, 0.0, 0.0, 0.0]), m=np.array([0.0, 1e300, 0.0, 0.0]),
             mu1=np.array([0.0, 0.0, 1e300, 0.0]), h1=np.array([0.0, 0.0, 1e300, 0.0]),
             n=np.array([0.0, 0.0, 0.0, 1e160])),
    ]  # fmt: skip


def fixed_point_battery() -> list[Case]:
    """The cases of the gyrostat about a fixed point."""
    case = _Maker(systems.get("fixed_point"))
    heavy: dict[str, Any] = {"Mg": 1.0, "z0": 0.5, "N": 0.1}
    tilted: dict[str, Any] = {"theta0": 0.6, "m": 0.5, "n": 0.2} | heavy
    cone: dict[str, Any] = {"theta0": 0.8, "n": 0.5, "C": 0.7} | heavy
    fast, up = _decades(0, 6), _decades(-2, -12, -2)
    spins, fields = _decades(-6, 4, 2), _decades(-8, 6, 2)
    tilts = np.array([1e-2, 1e-3, 1e-4, 3e-5, 1e-6, 1e-8, 1e-12, 0.0])
    flip: dict[str, Any] = {"A": 1.0, "B": 2.0, "C": 1.5, "m": 1.0}
    middle: dict[str, Any] = {"A": 1.0, "B": 1.5, "C": 2.0, "theta0": np.pi / 2, "n": 1.0}
    # conical motions are unstable where N (A - C) > A n^2 only, at small C r + l3
    steep: dict[str, Any] = {"A": 1.0, "C": 0.4, "N": 3.0, "n": 0.5, "theta0": 1.0, "Mg": 1.0}
    paper: dict[str, Any] = {
        "A": np.array([22.49, 50.32]),
        "B": np.array([22.49, 50.32]),
        "C": np.array([35.6, 33.4]),
    }
    return [
        case("stiff rotor", "rotor frequency over the slow one", np.minimum(20, 2e3 / fast), l3=fast,
             theta_dot0=0.1, **tilted),
        case("stiff spin", "fast spin with the rotor against it: the axis moves slowly", np.minimum(20, 2e3 / fast),
             l3=0.6 - 1.2 * fast, **tilted | {"m": fast}),
        case("stiff steady", "the same on an exact regular precession", np.minimum(20, 2e3 / fast),
             solve=("conical", "l3"), m=fast, **cone),
        case("spin", "exact regular precession, slow to fast spin", np.minimum(20, 2e3 / spins),
             solve=("conical", "l3"), m=spins, **cone),
        case("r0 = 1000", "the paper's bodies and spin", 2.0, Mg=294.3, z0=5.0, theta0=0.5, m=1000.0,
             l3=np.array([0.0, 50.0]), **paper),
        case("needle", "C towards 0", 20.0, C=_decades(-1, -6, -1), **tilted),
        case("flat body", "A + B = C", 20.0, A=np.array([1.0, 0.3, 1e-3]), B=np.array([1.0, 0.7, 1.0]),
             C=np.array([2.0, 1.0, 1.001]), **tilted),
        case("needle across", "A towards 0", np.array([20.0, 5.0, 1.0]), A=_decades(-2, -6, -2), C=1.0, **tilted),
        case("near 0", "tilts of a stable sleeping top", 20.0, theta0=tilts, m=1.5, **heavy),
        case("near pi", "the same upside down", 20.0, theta0=np.pi - tilts, m=3.5, **heavy),
        case("steep precession", "exact regular precession close to the vertical", 20.0,
             solve=("conical", "l3"), m=0.7, **cone | {"theta0": np.array([1e-1, 1e-2, 1e-3, 1e-4])}),
        case("through the pole", "planar pendulum and fast tops through the vertical", 5.0,
             theta0=0.5, theta_dot0=-3.0, l3=np.array([0.0, 0.2]), **heavy),
        case("field", "weak to strong weight and gradient", np.minimum(20, 30 / np.sqrt(fields)),
             Mg=fields, N=0.3 * fields, x0=0.2, z0=0.5, theta0=0.6, m=0.5),
        case("weak field", "a steady motion that an offset disturbs", 20.0, solve=("conical", "l3"),
             add={"x0": _decades(-12, -4, 2)}, m=0.4, **cone),
        case("separatrix", "a pendulum beside its upper rest", 15.0, theta0=np.pi - up, **heavy),
        case("racket", "free body about its middle axis, pushed a little", 60.0, theta_dot0=up, **flip),
        case("unstable, short", "exactly on an unstable motion", 12.0, **middle | {"n": np.array([1.0, 0.3])}),
        case("unstable cone, short", "exactly on an unstable regular precession", 8.0, solve=("conical", "z0"),
             **steep | {"m": np.array([0.3, 3.0])}),
        case("unstable cone, middle", "the same, longer", 20.0, solve=("conical", "z0"), may=GROWN,
             **steep | {"m": np.array([0.3, 3.0])}),
        case("unstable, long", "until rounding decides", 200.0, **middle),
        case("hidden growth", "fast spin on top of slow growth", 15.0, m=60.0, l3=0.4 * (0.3 - 60.0),
             solve=("conical", "z0"), add={"theta0": np.array([1e-4, 1e-5, 1e-6])}, **steep),
        case("slower than the run", "weak weight", 4.0, Mg=_decades(-2, -8, -2), z0=1.0, theta0=0.6),
        case("long", "exactly steady, and drifting, for 10 000 turns", 4e4 * np.pi, solve=("conical", "l3"),
             add={"theta0": np.array([0.0, 0.3])}, m=0.4, **cone),
        case("at rest", "nothing turns at all", 20.0, theta0=np.array([0.0, 0.5])),
        case("denormal", "parameters of 1e-300 and less", 20.0, theta0=np.array([1e-310, 0.5, 0.5]),
             l1=np.array([1e-310, 0.0, 1e-320]), m=np.array([0.5, 1e-300, 1e-310]), Mg=1e-310, x0=1e-310),
        case("overflow", "products of parameters overflow", 20.0, may=OVERFLOW, theta0=0.5,
             l1=np.array([1e200, 0.0, 0.0, 0.0]), theta_dot0=0.1, m=np.array([0.0, 1e300, 0.0, 0.0]),
             Mg=np.array([0.0, 0.0, 1e300, 0.0]), x0=np.array([0.0, 0.0, 1e300, 0.0]),
             n=np.array([0.0, 0.0, 0.0, 1e160])),
    ]  # fmt: skip


BATTERIES: dict[str, Callable[[], list[Case]]] = {
    "satellite": satellite_battery,
    "fixed_point": fixed_point_battery,
}


def slow_twin(system: System, points: Points) -> tuple[Points, Array]:
    """Points of the same motion of the axis without a rotor, and what their phi' exceeds the true one by.

    Where C w3 + rotor is conserved, the motion of the third axis depends on spin and rotor through that
    sum alone; where it is not, the points themselves.
    """
    rotor, axial = ("k3", "axial_momentum") if system.name == "satellite" else ("l3", "lagrange")
    free = ~np.isnan(system.conserved(points)[axial]) & np.isfinite(points[rotor])
    excess = np.where(free, points[rotor] / points["C"], 0.0)
    twin = dict(points)
    twin[rotor] = np.where(free, 0.0, points[rotor])
    twin["m"] = points["m"] + excess
    with np.errstate(all="ignore"):
        slower = system.frequency_bound(twin) < system.frequency_bound(points)
    twin = {name: np.where(slower, twin[name], points[name]) for name in points}
    return twin, np.where(slower, excess, 0.0)


def truth(
    system: System, points: Points, duration: Array, settings: Settings
) -> tuple[Flags, Array, list[str]]:
    """Label of each point, its unsteadiness (largest rms or std of the rates, nan where unknown), and whence.

    Exact starts: theory, or unresolved where growth_rate x duration lets rounding decide. Others: the
    reference of `accuracy` on the slow twin; where that would take more than WHOLE radians, over the
    first part of the run: what drifts there by sqrt(whole / part) times the tolerance drifts in all of
    it, because a mean square over the run is at least the part's times part / whole. Points that the
    reference cannot decide are an error of the battery, ValueError; where numbers overflow, unresolved.
    """
    with np.errstate(all="ignore"):
        theory = compare.theory(system, points, settings.rate_tolerance, nudged=False)
        exact = (theory["family"] > 0) & (system.condition_residual(points) <= EXACT)
        twin, excess = slow_twin(system, points)
        turns = system.frequency_bound(twin) * duration
    sine = np.abs(system.steady(points)[0])
    rounding = theory["growth_rate"] * duration > np.log(settings.rate_tolerance / labels.ROUNDOFF)
    label = np.where(rounding & (sine > 0), labels.UNRESOLVED, theory["predicted"]).astype(np.int8)
    unsteady = np.zeros(duration.shape)
    whence = ["theory"] * duration.size
    lost = ~exact & (~np.isfinite(turns) | (turns > 1e100))
    label[lost], unsteady[lost] = labels.UNRESOLVED, np.nan
    for i in np.flatnonzero(lost):
        whence[i] = "overflow"
    rest = np.flatnonzero(~exact & ~lost)
    if not rest.size:
        return label, unsteady, whence
    share = np.where(turns[rest] <= WHOLE, 1.0, PART / np.maximum(turns[rest], 1e-300))
    part = {name: values[rest] for name, values in twin.items()}
    known = reference(system, part, duration[rest] * share, settings)
    measured = dict(known.statistics)
    over = (measured["theta_min"] <= np.pi / 2) & (measured["theta_max"] >= np.pi / 2)
    sides = np.maximum(np.sin(measured["theta_min"]), np.sin(measured["theta_max"]))
    measured["sine_max"] = np.where(over, 1.0, sides)
    measured["phi_dot_mean"] = measured["phi_dot_mean"] - excess[rest]
    for name in ("theta_dot_rms", "psi_dot_std", "phi_dot_std", "normal_rate_std"):
        measured[name] = measured[name] * np.sqrt(share)
    error = {name: known.statistics_error.get(name, np.zeros(rest.size)) for name in measured}
    error["sine_max"] = error["theta_max"]
    tolerances = settings.rate_tolerance, settings.cylinder
    with np.errstate(invalid="ignore"):
        called = labels.label(measured, *tolerances)
        undecided = labels.unsure(measured, error, *tolerances) | ((share < 1) & (called != labels.DRIFTING))
    if undecided.any():
        raise ValueError(f"the reference cannot decide points {rest[undecided]}")
    label[rest] = called
    for i, whole in zip(rest, share == 1, strict=True):
        whence[i] = "reference" if whole else "part of the run"
    unsteady[rest] = np.where(share == 1, _unsteadiness(measured), np.nan)
    return label, unsteady, whence


def _unsteadiness(measured: Mapping[str, Array]) -> Array:
    """The largest of the measurements that make a point drift, rad per time unit."""
    rates = [measured["theta_dot_rms"], measured["psi_dot_std"], measured["phi_dot_std"]]
    inside = np.isnan(rates[1])
    return np.where(inside, measured["normal_rate_std"], np.fmax.reduce(rates))


def stress(
    system: System | str, cases: list[Case] | None = None, *, threads: int | None = None
) -> xr.Dataset:
    """Run a battery at every rung of the ladder by every method, and hold each label against the truth.

    Returns a Dataset over (method, rung, point): label, status, step_ratio and verdict; over point: the
    truth, whence it is known, case, name and why the battery lets the point stay unresolved. Rungs of
    more than MOST_STEPS steps are left out.
    """
    if isinstance(system, str):
        system = systems.get(system)
    cases = BATTERIES[system.name]() if cases is None else cases
    points = {name: np.concatenate([c.points[name] for c in cases]) for name in system.parameters}
    duration = np.concatenate([c.duration for c in cases])
    settings = Settings(max_steps=MOST_STEPS)
    true, unsteady, whence = truth(system, points, duration, settings)
    shape = (len(METHODS), len(RUNGS), duration.size)
    label, status = np.zeros(shape, np.int8), np.zeros(shape, np.int8)
    ratio, spread = np.full(shape, np.nan), np.full(shape, np.nan)
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
    jobs = []
    for i, method in enumerate(METHODS.values()):
        own = replace(settings, method=method.name)
        for j, rung in enumerate([*RATIOS, *TOLERANCES]):
            if j < len(RATIOS):
                with np.errstate(all="ignore"):
                    length = np.clip(rung * method.stability / bound, 0.0, duration)
                # each point has a step of its own: one call each
                for k in np.flatnonzero(length > 0):
                    jobs.append((replace(own, step=float(length[k])), np.array([k]), (i, j)))
            else:
                jobs.append((replace(own, tolerance=rung), np.arange(duration.size), (i, j)))
        kernel(system, method.name)  # loaded before threads ask for it

    def work(job: tuple[Settings, np.ndarray, tuple[int, int]]) -> None:
        _run(system, points, duration, job[0], job[1], (label, status, ratio, spread), job[2])

    # The kernel lets other threads run; one call seldom has work for two of them.
    with ThreadPoolExecutor(threads or lanes.available_threads()) as pool:
        for _ in pool.map(work, jobs):
            pass
    with np.errstate(invalid="ignore"):
        error = np.abs(spread - unsteady) / np.maximum(unsteady, settings.rate_tolerance)
    verdict = np.select(
        [label == labels.NOT_COMPUTED, label == labels.UNRESOLVED, label == true],
        [LEFT_OUT, UNRESOLVED, RIGHT],
        WRONG,
    )
    return _dataset(system, cases, points, duration, true, whence, label, status, ratio, error, verdict)


def _run(
    system: System,
    points: Points,
    duration: Array,
    settings: Settings,
    where: np.ndarray,
    columns: tuple[np.ndarray, ...],
    place: tuple[int, int],
) -> None:
    """Evaluate the points that take no more than MOST_STEPS, and put what they gave into the columns."""
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)[where]
        free = steps.choose(
            METHODS[settings.method], bound, duration[where], tolerance=settings.tolerance, step=settings.step,
            max_steps=2**50, rate_tolerance=settings.rate_tolerance,
        )  # fmt: skip
    # What overflows would take any number of steps: a few are enough to see it.
    endless = ~np.isfinite(bound) | (bound * duration[where] > 1e12)
    for chosen, kept in (
        (settings, ~endless & (free.count <= MOST_STEPS)),
        (replace(settings, max_steps=1000), endless),
    ):
        some = where[kept]
        if some.size:
            part = {name: values[some] for name, values in points.items()}
            found = evaluate(system, part, part, duration[some], chosen, threads=1)
            values = (found["label"], found["status"], found["step_ratio"], _unsteadiness(found))
            for column, value in zip(columns, values, strict=True):
                column[(*place, some)] = value


def _dataset(
    system: System,
    cases: list[Case],
    points: Points,
    duration: Array,
    true: Flags,
    whence: list[str],
    label: Flags,
    status: Flags,
    ratio: Array,
    error: Array,
    verdict: np.ndarray,
) -> xr.Dataset:
    kinds, ladder = variables(system), ("method", "rung", "point")
    flags = {"flag_values": np.arange(len(VERDICTS), dtype=np.int8), "flag_meanings": " ".join(VERDICTS)}
    named = [(case, name) for case in cases for name in case.names]
    ds = xr.Dataset(
        {
            "label": (ladder, label, kinds["label"].attributes()),
            "status": (ladder, status, kinds["status"].attributes()),
            "step_ratio": (ladder, ratio, kinds["step_ratio"].attributes()),
            "error": (ladder, error, {
                "long_name": "relative error of the largest rms or standard deviation of the rates", "units": "1",
                "comment": "held against rate_tolerance where the true value is less; nan where only a part of the run"
                " is known or the numbers overflow",
            }),
            "verdict": (ladder, verdict.astype(np.int8), {"long_name": "label against the truth", **flags}),
            "truth": ("point", true, kinds["label"].attributes() | {"long_name": "true label"}),
            "duration": ("point", duration, {"long_name": "length of the run", "units": "s"}),
            **{name: ("point", values) for name, values in points.items() if not np.isnan(values).all()},
        },
        {
            "method": list(METHODS),
            "rung": list(RUNGS),
            "case": ("point", [case.name for case, _ in named]),
            "name": ("point", [name for _, name in named]),
            "known_from": ("point", whence),
            "may_stay_unresolved": ("point", [case.may for case, _ in named]),
        },
        {"title": f"stiff and extreme cases of the {system.name}", "atlas_system": system.name},
    )  # fmt: skip
    return ds


def silent(ds: xr.Dataset) -> Mask:
    """Where a label was given that is not true, bool over (method, rung, point)."""
    return np.asarray(ds["verdict"].values == WRONG)


def unresolved(ds: xr.Dataset) -> Mask:
    """Where an automatic step left a point without label that the battery does not name, bool as `silent`."""
    automatic = np.arange(len(RUNGS)) >= len(RATIOS)
    unnamed = (ds["may_stay_unresolved"].values == "") & (ds["truth"].values != labels.UNRESOLVED)
    return np.asarray((ds["verdict"].values == UNRESOLVED) & automatic[:, None] & unnamed)


def report(ds: xr.Dataset) -> str:
    """The battery as text: a row for each case, a sign for each rung; then what went wrong, by name."""
    meanings = list(ds["label"].attrs["flag_meanings"].split())
    rows = [("case", "points", "truth", "known from", *ds["method"].values)]
    for case in dict.fromkeys(ds["case"].values):
        part = ds.isel(point=np.flatnonzero(ds["case"].values == case))
        true = ", ".join(dict.fromkeys(meanings[i] for i in part["truth"].values))
        signs = [
            "".join(_sign(verdict) for verdict in part["verdict"].values[i]) for i in range(len(METHODS))
        ]
        whence = ", ".join(dict.fromkeys(part["known_from"].values))
        rows.append((str(case), str(part.sizes["point"]), true, whence, *signs))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    lines.append(
        f"one sign for each rung, {RUNGS[0]} to {RUNGS[len(RATIOS) - 1]} of the stability limit, then"
        f" {RUNGS[len(RATIOS)]} to {RUNGS[-1]}:\n  . every label true   u some unresolved   U all unresolved"
        "   - left out (too many steps)   X some label not true"
    )
    for text, found in (("label not true", silent(ds)), ("unresolved at an automatic step", unresolved(ds))):
        for place in zip(*np.nonzero(found), strict=True):
            at = ds.isel(dict(zip(ds["verdict"].dims, place, strict=True)))
            lines.append(
                f"{text}: {at['case'].item()}, {at['name'].item()}; {at['method'].item()}, {at['rung'].item()}:"
                f" {meanings[int(at['label'])]} ({list(STATUS)[int(at['status'])]}),"
                f" true {meanings[int(at['truth'])]}"
            )
    counts = np.bincount(ds["verdict"].values.ravel(), minlength=len(VERDICTS))
    lines.append(", ".join(f"{name} {count}" for name, count in zip(VERDICTS, counts, strict=True)))
    for i, method in enumerate(ds["method"].values):
        error = np.where(ds["verdict"].values[i] == RIGHT, ds["error"].values[i], np.nan)
        known = np.isfinite(error).sum(1)
        shown = " ".join(f"{n}/{k}" for n, k in zip((error < ACCURATE).sum(1), known, strict=True))
        lines.append(
            f"{method}: true labels with a spread within {100 * ACCURATE:g} %, of those known: {shown}"
        )
    return "\n".join(lines)


def _sign(verdict: Array) -> str:
    if (verdict == WRONG).any():
        return "X"
    if (verdict == LEFT_OUT).all():
        return "-"
    if (verdict == UNRESOLVED).any():
        return "u" if (verdict == RIGHT).any() else "U"
    return "."


# Limits of the methods, measured in the kernels.


def _end(system: System, method: str, points: Points, length: Array, count: int) -> Array:
    """States after `count` steps, (state, points)."""
    state = np.ascontiguousarray(system.start(points))
    constants = np.ascontiguousarray(system.constants(points))
    scales = np.zeros((len(system.equations.INTEGRALS), length.size))
    each, stride = np.full(length.size, count), np.full(length.size, min(count, 16))
    lanes.integrate(kernel(system, method), lanes.plan(each, stride), length, state, constants, scales, 1e-5)
    return state


def observed_stability(method: Method, steps: int = 16_000) -> dict[str, float]:
    """Largest stable y = w h of the body's turning and of nutation, each in a motion that has it alone.

    Turning: a free spherical body, gamma turns in it at |w|. Nutation: a spherical body with a rotor,
    its small w turns about the rotor at l3 / A. Found on a grid of relative distance 1e-4 or less.
    """
    system = systems.get("fixed_point")
    y = method.stability * np.linspace(0.95, 1.05, 1025)
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "theta0": 1.0, "phi0": np.zeros(y.size)}
    found = {}
    for name, start in (("turning", {"m": 1.0}), ("nutation", {"l3": 1.0, "theta_dot0": 1e-9})):
        points, _ = point_columns(system, body | start)
        with np.errstate(all="ignore"):
            state = _end(system, method.name, points, y, steps)
            size = (state[3:] if name == "turning" else state[:2]) / (1.0 if name == "turning" else 1e-9)
            stable = (size**2).sum(0) <= 1.0
        found[name] = float(y[stable].max())
    return found


def constraint_bound(method: Method, y: float, steps: int) -> float:
    """Largest expected change of |gamma| over a run of a body that turns by y radians a step.

    A turn at constant rate multiplies the turning part by |R(i y)| each step, 1 - damping y^p to
    leading order (rk4: y^6 / 144); rounding adds at most one unit of the last place a step.
    """
    return steps * (method.damping * y**method.damping_order + 2.0**-53)


def constraint_change(system: System, method: Method, points: Points, y: float, steps: int) -> Array:
    """Largest change of |gamma| (and |alpha|, alpha.gamma of the satellite) after so many steps, (points,).

    Steps of y over the frequency bound of each point.
    """
    state = _end(system, method.name, points, y / system.frequency_bound(points), steps)
    unit = state[3:].reshape(-1, 3, state.shape[1])
    changes = [np.abs(np.sqrt((vector**2).sum(0)) - 1) for vector in unit]
    if len(unit) == 2:
        changes.append(np.abs((unit[0] * unit[1]).sum(0)))
    return np.asarray(np.max(changes, axis=0))


def limits(*, steps: int = 10_000_000) -> list[tuple[str, ...]]:
    """Table of limits as text, the first row the heading: theory, what was observed, long runs of `steps`."""
    satellite = systems.get("satellite")
    tumbling, _ = point_columns(satellite, {"A": 0.9, "B": 1.1, "k1": 0.2, "theta0": 0.7, "n": 0.5, "m": 0.9})
    rows: list[tuple[str, ...]] = [
        ("method", "largest stable y, theory", "turning", "nutation", f"loss of |gamma| in {steps:.0e} steps of",
         "theory", "free turn", "tumbling satellite")
    ]  # fmt: skip
    turn, _ = point_columns(satellite, {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "m": 1.0})
    for method in METHODS.values():
        observed = observed_stability(method)
        y = 0.02 if method.order == 4 else 0.2
        rows.append((
            method.name, f"{method.stability:.5f}", f"{observed['turning']:.4f}", f"{observed['nutation']:.4f}",
            f"y = {y:g}", f"{constraint_bound(method, y, steps):.1e}",
            f"{_free_turn(satellite, method, turn, y, steps):.1e}",
            f"{constraint_change(satellite, method, tumbling, y, steps)[0]:.1e}",
        ))  # fmt: skip
    return rows


def _free_turn(system: System, method: Method, turn: Points, y: float, steps: int) -> float:
    """The same of a body that turns at rate 1 exactly: its bound is larger, so its step is given."""
    return float(
        constraint_change(system, method, turn, y * float(system.frequency_bound(turn)[0]), steps)[0]
    )


def figure(ds: xr.Dataset) -> Figure:
    """Verdict of every point at every rung, a panel for each method; a dot where the label is accurate, too."""
    from matplotlib import rc_context
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = ["#59a14f", "#e6e6e6", "#d62728", "#ffffff"]
    cases = ds["case"].values
    first = np.flatnonzero(np.r_[True, cases[1:] != cases[:-1]])
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        drawn = Figure(figsize=(7.0, 8.2), layout="constrained")
        axes = drawn.subplots(1, len(METHODS), sharey=True)
        for i, (ax, method) in enumerate(zip(axes, ds["method"].values, strict=True)):
            verdict = ds["verdict"].values[i].T
            ax.pcolormesh(verdict, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(colours) - 0.5)
            close = (verdict == RIGHT) & (ds["error"].values[i].T < ACCURATE)
            rows, columns = np.nonzero(close)
            ax.plot(columns + 0.5, rows + 0.5, ".", color="black", markersize=1.5)
            ax.hlines(first, 0, len(RUNGS), color="0.5", linewidth=0.4)
            ax.axvline(len(RATIOS), color="black", linewidth=0.8)
            ax.set_xticks(np.arange(len(RUNGS)) + 0.5, [rung.split()[1] for rung in RUNGS], rotation=90)
            ax.set(title=method, xlabel="step over stability limit | tolerance of automatic step")
        axes[0].set_yticks(np.r_[first[1:], cases.size] * 0.5 + first * 0.5, cases[first])
        axes[0].set_ylim(cases.size, 0)
        entries = [
            Patch(facecolor=colour, edgecolor="0.5", label=f"{name.replace('_', ' ')}: {text}")
            for colour, (name, text) in zip(colours, VERDICTS.items(), strict=True)
        ]
        drawn.legend(handles=entries, loc="outside lower center", ncols=2, frameon=False)
    return drawn
