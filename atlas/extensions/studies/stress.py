"""Stress study, which runs stiff and extreme points at many step sizes and compares each label with the true label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import xarray as xr

from ... import systems
from ...errors import BadInput, text_table
from ...flags import Flag, Label, Status
from ...kernel import blocks, numeric_bound
from ...kernel.ensemble import Ensemble
from ...kernel.specialization import kernel
from ...kernel.stepsize import StepSizes
from ...kernel.tableaux import METHODS, Method
from ...label.pipeline import evaluate
from ...label.plan import Plan
from ...measure.instrument import RunSettings, Variable
from ...scene import model
from ...scene.grid import Grid, at_points
from ...scene.model import DEFAULTS, Settings
from ...scene.tables import point_columns
from ...systems.base import Array, Mask, Points, StressCase, System, stress_cases_of, subset
from ...variables import main_instrument, variables
from .reference import reference_where_possible
from .stress_truth import (
    EXACT_ACCURACY,
    EXACT_STATISTICS,
    CasePoints,
    TrueLabels,
    case_points,
    no_statistics,
    true_labels,
)

# The levels, coarse to fine, are fixed steps at these ratios to the stability limit, then automatic steps at these tolerances.
RATIOS = (1.5, 0.9, 0.49, 0.3, 0.15, 0.06, 0.025, 0.01)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)
# Largest rate tolerance. The default grows with the natural rate. With a fast rotor the default would label all slow motions steady.
RATE_TOLERANCE = 1e-5
LEVELS = tuple(f"ratio {ratio:g}" for ratio in RATIOS) + tuple(f"tolerance {tol:.0e}" for tol in TOLERANCES)
# A point that needs more steps than this at a level is left out at this level.
MAX_STEPS = 10_000_000
# The unsteadiness is accurate if its error is below this fraction of the larger of the true value and the tolerance.
ACCURATE = 0.01


class Verdict(Flag):
    """Result of comparing a label with the true label."""

    RIGHT = 0, "the label is true"
    UNRESOLVED = 1, "no label"
    WRONG = 2, "a label that is not true"
    LEFT_OUT = 3, "not run, because it takes too many steps"


def stress(
    system: System | str, cases: Sequence[StressCase] | None = None, *, threads: int | None = None
) -> xr.Dataset:
    """Run cases, by default those of the system, by every method at every level, and compare each label with the true label."""
    if isinstance(system, str):
        system = systems.get(system)
    own_cases = stress_cases_of(system) if cases is None else cases
    parts = [case_points(system, case) for case in own_cases]
    # The cases without a `truth` come first, because one call of `true_labels` finds the labels of all these cases.
    parts.sort(key=lambda part: part.truth != "")
    plain, truths = [part for part in parts if not part.truth], list[TrueLabels]()
    if plain:
        points, duration = _joined(system, plain)
        every = replace(plain[0], points=points, duration=duration)
        truths.append(true_labels(system, every, _settings(system, points)))
    truths += [true_labels(system, part, _settings(system, part.points)) for part in parts[len(plain) :]]
    if cases is None and not own_cases:
        generic = [case_points(system, case) for case in generic_cases(system)]
        points, duration = _joined(system, generic)
        truth, known = generic_true_labels(system, points, duration, _settings(system, points))
        truths.append(truth.subset(known))
        ends = np.cumsum([part.duration.size for part in generic])
        shares = zip(generic, np.split(known, ends[:-1]), strict=True)
        parts += [part.subset(share) for part, share in shares if share.any()]
    if not parts:
        raise BadInput(f"stress: the reference determines no label of the generic cases of {system.name}")
    points, duration = _joined(system, parts)
    results = _run_levels(system, points, duration, threads)
    return _dataset(system, parts, points, TrueLabels.join(truths), results)


def _settings(system: System, points: Points) -> RunSettings:
    """Return the default settings at the points, with rate tolerances of at most RATE_TOLERANCE."""
    return DEFAULTS.at(np.minimum(at_points(system, DEFAULTS.rate_tolerance, points), RATE_TOLERANCE))


def _joined(system: System, parts: Sequence[CasePoints]) -> tuple[dict[str, Array], Array]:
    """Return the points of all cases, and the durations of the points."""
    points = {name: np.concatenate([part.points[name] for part in parts]) for name in system.parameters}
    return points, np.concatenate([part.duration for part in parts])


def _run_levels(
    system: System, points: Points, duration: Array, threads: int | None
) -> dict[str, np.ndarray]:
    """Return label, status and measured values, each of shape (method, level, point)."""
    shape = len(METHODS), len(LEVELS), duration.size
    numbers = ("step_ratio", "error_estimate", "unsteadiness", *EXACT_STATISTICS)
    results: dict[str, np.ndarray] = {name: np.zeros(shape, np.int8) for name in ("label", "status")}
    results |= {name: np.full(shape, np.nan) for name in numbers}
    for name in METHODS:
        kernel(system, name)  # loads the kernel before the threads start
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
    rate_tolerance = np.asarray(_settings(system, points).rate_tolerance)
    grid = Grid(dict(points), dict(points), np.zeros(duration.size, np.int8), duration, rate_tolerance)

    def work(cell: tuple[int, int], settings: Settings, step: Array | None) -> None:
        """Run a method at a level for points that need at most MAX_STEPS steps or overflow. Points whose fixed step is 0 are left out."""
        where = np.arange(duration.size) if step is None else np.flatnonzero(step > 0)
        tile = replace(grid, step=step).subset(where)
        with np.errstate(all="ignore"):
            radians = bound[where] * tile.duration
            most = replace(settings, max_steps=model.MAX_STEPS).at(tile.rate_tolerance)
            unlimited = StepSizes.of(most, bound[where], tile.duration, tile.step)
        # A point that overflows would get too many automatic steps, and 1000 steps show the overflow.
        overflow = ~np.isfinite(bound[where]) | (radians > 1e12)
        runs = {MAX_STEPS: ~overflow & (unlimited.steps <= MAX_STEPS), 1000: overflow}
        for max_steps, mask in runs.items():
            if mask.any():
                plan = Plan(system, replace(settings, max_steps=max_steps))
                part = tile.subset(mask)
                values = evaluate(plan, part, threads=blocks.Threads(1))
                run_settings = settings.at(part.rate_tolerance)
                values["unsteadiness"] = main_instrument(system).unsteadiness(system, values, run_settings)
                values = dict.fromkeys(EXACT_STATISTICS, np.full(mask.sum(), np.nan)) | values
                for name, column in results.items():
                    column[(*cell, where[mask])] = values[name]

    # Threads run different levels, because one level seldom has work for two threads.
    with ThreadPoolExecutor(threads or blocks.available_threads()) as pool:
        jobs = []
        for i, method in enumerate(METHODS.values()):
            settings = Settings(method=method.name, max_steps=MAX_STEPS)
            for j, ratio in enumerate(RATIOS):
                with np.errstate(all="ignore"):
                    length = np.clip(ratio * method.stability / bound, 0.0, duration)
                jobs.append(pool.submit(work, (i, j), settings, length))
            for j, tolerance in enumerate(TOLERANCES, len(RATIOS)):
                jobs.append(pool.submit(work, (i, j), replace(settings, tolerance=tolerance), None))
        try:
            for job in jobs:
                job.result()
        finally:  # no job begins after an error or Ctrl-C
            pool.shutdown(wait=False, cancel_futures=True)
    return results


def _dataset(
    system: System,
    parts: Sequence[CasePoints],
    points: Points,
    truth: TrueLabels,
    results: Mapping[str, np.ndarray],
) -> xr.Dataset:
    """Return the results of `stress` as a dataset."""
    registry, dims, label = variables(system), ("method", "level", "point"), results["label"]
    verdict = np.select(
        [label == Label.NOT_COMPUTED, label == Label.UNRESOLVED, label == truth.label],
        [Verdict.LEFT_OUT, Verdict.UNRESOLVED, Verdict.RIGHT],
        Verdict.WRONG,
    )
    with np.errstate(invalid="ignore"):
        error = np.abs(results["unsteadiness"] - truth.unsteadiness)
        error /= np.maximum(
            truth.unsteadiness, main_instrument(system).steady_below(_settings(system, points))
        )
        errors = np.abs(np.stack([results[name] for name in EXACT_STATISTICS], axis=2) - truth.statistics)
    with np.errstate(all="ignore"):
        bound = system.frequency_bound(points)
        errors /= np.array([np.where(name.startswith("theta_m"), 1.0, bound) for name in EXACT_STATISTICS])
    names = [(part, name) for part in parts for name in part.names]
    ds = xr.Dataset(
        coords={
            "method": list(METHODS),
            "level": list(LEVELS),
            "statistic": list(EXACT_STATISTICS),
            "case": ("point", [part.name for part, _ in names]),
            "name": ("point", [name for _, name in names]),
            "known_from": ("point", truth.source),
            "may_stay_unresolved": ("point", [part.may_stay_unresolved for part, _ in names]),
        },
        attrs={"title": f"stiff and extreme cases of the {system.name}", "atlas_system": system.name},
    )
    for name in ("label", "status", "step_ratio", "error_estimate"):
        ds[name] = dims, results[name], registry[name].attributes()
    ds["statistic_error"] = (*dims[:2], "statistic", "point"), errors, {
        "long_name": "error of a statistic against the exact motion", "units": "1",
        "comment": "of a rate in units of the frequency bound, of an angle in rad; nan where the motion is not known exactly",
    }  # fmt: skip
    ds["error"] = dims, error, {
        "long_name": f"relative error of the {main_instrument(system).unsteadiness_text}", "units": "1",
        "comment": "relative to the tolerance where the true value is less; nan where it is unknown, because only a"
        " part of the run was integrated by the reference or numbers overflow",
    }  # fmt: skip
    variable = Variable("verdict", "int8", "1", "label compared with the true label", Verdict.meanings())
    ds["verdict"] = dims, verdict.astype(np.int8), variable.attributes()
    ds["truth"] = "point", truth.label, registry["label"].attributes() | {"long_name": "true label"}
    duration = np.concatenate([part.duration for part in parts])
    ds["duration"] = "point", duration, {"long_name": "length of the run", "units": "s"}
    return ds.assign({k: ("point", values) for k, values in points.items() if not np.isnan(values).all()})


def mislabelled(ds: xr.Dataset) -> Mask:
    """Return a mask over (method, level, point) of the labels that differ from the true label."""
    return np.asarray(ds["verdict"].values == Verdict.WRONG)


def unresolved(ds: xr.Dataset) -> Mask:
    """Return a mask over (method, level, point) of automatic steps that give no label although the case expects a label."""
    automatic = np.arange(len(LEVELS)) >= len(RATIOS)
    expected = (ds["may_stay_unresolved"].values == "") & (ds["truth"].values != Label.UNRESOLVED)
    return np.asarray((ds["verdict"].values == Verdict.UNRESOLVED) & automatic[:, None] & expected)


def beyond_estimate(ds: xr.Dataset) -> Mask:
    """Return a mask of resolved runs along exact motions. The mask is true if a statistic's error exceeds ten times `error_estimate`."""
    error = ds["statistic_error"].max("statistic").values
    return np.asarray(_has_estimate(ds) & (error > 10 * ds["error_estimate"].values + EXACT_ACCURACY))


def estimate_fails(ds: xr.Dataset) -> bool:
    """Whether `beyond_estimate` holds for more than 1 % of the resolved runs along exact motions."""
    return bool(beyond_estimate(ds).sum() > 0.01 * _has_estimate(ds).sum())


def _has_estimate(ds: xr.Dataset) -> Mask:
    """Return a mask over (method, level, point) of the resolved runs along exact motions."""
    known = ds["statistic_error"].notnull().any("statistic").values
    return np.asarray(known & (ds["status"].values == Status.OK))


LEGEND = (
    f"one sign for each level, {LEVELS[0]} to {LEVELS[len(RATIOS) - 1]} of the stability limit, then"
    f" {LEVELS[len(RATIOS)]} to {LEVELS[-1]}:\n  . every label true   u some unresolved   U all unresolved"
    "   - left out (too many steps)   X some label not true"
)


def report(ds: xr.Dataset) -> str:
    """Return the study as text, with a row for each case and a line for each point that failed."""
    counts = np.bincount(ds["verdict"].values.ravel(), minlength=len(Verdict))
    meanings = list(Label.meanings())
    rows = [("case", "points", "true label", "determined by", *ds["method"].values)]
    for case in dict.fromkeys(ds["case"].values):
        part = ds.isel(point=np.flatnonzero(ds["case"].values == case))
        truth = ", ".join(dict.fromkeys(meanings[i] for i in part["truth"].values))
        source = ", ".join(dict.fromkeys(part["known_from"].values))
        verdict = part["verdict"].values
        is_wrong, is_left_out = (verdict == Verdict.WRONG).any(-1), (verdict == Verdict.LEFT_OUT).all(-1)
        is_unresolved, is_right = ((verdict == v).any(-1) for v in (Verdict.UNRESOLVED, Verdict.RIGHT))
        conditions = [is_wrong, is_left_out, is_unresolved & is_right, is_unresolved]
        signs = np.select(conditions, ["X", "-", "u", "U"], ".")
        rows.append((str(case), str(part.sizes["point"]), truth, source, *map("".join, signs)))
    # At each level, count the right labels with an accurate unsteadiness, and the right labels whose unsteadiness is known.
    accuracy = []
    for name, verdict, error in zip(
        ds["method"].values, ds["verdict"].values, ds["error"].values, strict=True
    ):
        error = np.where(verdict == Verdict.RIGHT, error, np.nan)
        accurate, known = (error < ACCURATE).sum(1), np.isfinite(error).sum(1)
        accuracy.append(
            f"{name}: true labels with {ds['error'].attrs['long_name'].removeprefix('relative error of ')} within"
            f" {100 * ACCURATE:g} %, of those for which it is known, by level: "
            + " ".join(f"{n}/{k}" for n, k in zip(accurate, known, strict=True))
        )
    return "\n".join(
        [
            text_table(rows),
            LEGEND,
            *_point_lines(ds, "label not true", mislabelled(ds)),
            *_point_lines(ds, "unresolved at an automatic step", unresolved(ds)),
            ", ".join(f"{name} {count}" for name, count in zip(Verdict.meanings(), counts, strict=True)),
            *accuracy,
            *_statistics_table(ds),
        ]
    )


def _point_lines(ds: xr.Dataset, text: str, selected: Mask) -> list[str]:
    """Return a line for each selected point, method and level."""
    label, status, lines = list(Label.meanings()), list(Status.meanings()), []
    for index in np.argwhere(selected):
        run = ds.isel(dict(zip(ds["verdict"].dims, index, strict=True)))
        lines.append(
            f"{text}: {run['case'].item()}, {run['name'].item()}; {run['method'].item()}, {run['level'].item()}:"
            f" {label[int(run['label'])]} ({status[int(run['status'])]}), true {label[int(run['truth'])]}"
        )
    return lines


def _statistics_table(ds: xr.Dataset) -> list[str]:
    """Return a table of the largest errors at the finest tolerance, with a row for each case of exact motions."""
    known = ds["statistic_error"].notnull().any(("method", "level", "statistic")).values
    if not known.any():
        return []
    heading = ["exact motions", "points"]
    for method in ds["method"].values:
        heading += [f"{method} largest error", "of", "over estimate", "beyond 10 x"]
    rows, beyond, estimated = [heading], beyond_estimate(ds), _has_estimate(ds)
    for case in dict.fromkeys(ds["case"].values[known]):
        members = np.flatnonzero(known & (ds["case"].values == case))
        row = [str(case), str(members.size)]
        for i in range(ds.sizes["method"]):
            part = ds.isel(method=i, level=-1, point=members)
            resolved = part["status"].values == Status.OK
            error = np.where(resolved, part["statistic_error"].values, np.nan)
            if np.isnan(error).all():
                row += ["-", "-", "-"]
            else:
                worst = np.nanmax(error, axis=1, initial=0.0)
                estimate = np.maximum(part["error_estimate"].values, EXACT_ACCURACY)
                ratio = np.nanmax(error, axis=0, initial=0.0) / estimate
                largest = str(part["statistic"].values[worst.argmax()])
                row += [f"{worst.max():.1e}", largest, f"{np.nanmax(np.where(resolved, ratio, np.nan)):.2g}"]
            row.append(f"{beyond[i][:, members].sum()}/{estimated[i][:, members].sum()}")
        rows.append(row)
    total = [
        f"{name}: {failed.sum()} of {compared.sum()}"
        for name, failed, compared in zip(ds["method"].values, beyond, estimated, strict=True)
    ]
    return [
        "errors of the statistics against exact motions: of a rate in units of the frequency bound, of an angle in rad",
        text_table(rows),
        f"runs with a statistic off by more than ten times error_estimate: {', '.join(total)}",
    ]


# Default values are multiplied by 10 to these powers; start values have powers of their own.
POWERS, POWERS_OF_STARTS = np.array([-6, -4, -2, -1, 1, 2, 4, 6]), np.array([-12, -6, -3, -1, 0])
HUGE = 1e200
# A start value whose default is 0 is set to START, so that the state changes.
START = 0.1
# A run lasts RADIANS divided by the frequency at the start, but at most MAX_DURATION time units.
RADIANS, MAX_DURATION = 60.0, 1e3


def generic_cases(system: System) -> list[StressCase]:
    """Return two cases of one motion each, and a case for each parameter with +- default x powers of 10, +- HUGE and values in bounds."""
    moderate = {name: p.default for name, p in system.parameters.items() if np.isfinite(p.default)}
    for name, p in system.parameters.items():
        if p.start and p.default == 0 and p.low <= START <= p.high:
            moderate[name] = START
    cases = [_case(system, "defaults", {}), _case(system, "beside the defaults", moderate)]
    for name in moderate:
        p = system.parameters[name]
        scale = p.default if p.default != 0 else 1.0
        values = scale * 10.0 ** (POWERS_OF_STARTS if p.start else POWERS)
        values = np.concatenate([values, -values, [HUGE, -HUGE]])
        if np.isfinite(p.low) and np.isfinite(p.high):
            values = np.concatenate([values, np.linspace(p.low, p.high, 5)])
        inside = (values >= p.low) & (values <= p.high) & ((values > p.low) | (not p.open_low))
        cases.append(_case(system, name, moderate | {name: np.unique(values[inside])}))
    return cases


def _case(system: System, name: str, columns: Mapping[str, float | Array]) -> StressCase:
    """Return a case with these columns, in which a run is shorter if the motion is faster at the start."""
    meaning = system.parameters[name].meaning if name in system.parameters else "one motion"
    case = StressCase(name, meaning, 1.0, columns)
    points = case_points(system, case).points
    with np.errstate(all="ignore"):
        frequency = numeric_bound.before_run(
            system, points, np.full_like(next(iter(points.values())), MAX_DURATION)
        )
        duration = np.fmin(RADIANS / frequency, MAX_DURATION)
    usable = np.isfinite(duration) & (duration > 1e-300)
    return StressCase(name, meaning, np.where(usable, duration, 1.0), columns)


def generic_true_labels(
    system: System, points: Points, duration: Array, settings: RunSettings
) -> tuple[TrueLabels, Mask]:
    """Return labels by the reference, or UNRESOLVED after an overflow. Also return a mask of the points with a known label."""
    size = duration.size
    label, largest = np.full(size, Label.UNRESOLVED, np.int8), np.full(size, np.nan)
    source, known = np.full(size, "overflow", "<U15"), np.ones(size, bool)
    with np.errstate(all="ignore"):
        start, frequency = system.initial_state(points), system.frequency_bound(points)
    usable = np.flatnonzero(np.isfinite(start).all(0) & np.isfinite(frequency))
    part = subset(points, usable), duration[usable], settings.subset(usable)
    solution, computed = reference_where_possible(system, *part)
    known[usable] = False
    computed = usable[computed]
    if solution is not None:
        label[computed], source[computed] = solution.label, "reference"
        known[computed] = solution.label_certain
        largest[computed] = main_instrument(system).unsteadiness(
            system, solution.statistics, settings.subset(computed)
        )
    return TrueLabels(label, largest, source, no_statistics(size)), known


def _final_states(system: System, method: str, points: Points, step_size: Array, steps: int) -> Array:
    """Return the states after `steps` steps, of shape (states, points)."""
    count = np.full(step_size.size, steps)
    return Ensemble.of(system, points).final_states(kernel(system, method), count, step_size)


def observed_stability(method: Method, steps: int = 16_000) -> dict[str, float]:
    """Return the largest angular frequency times step, to 1e-4, at which an amplitude does not grow.

    In theory the result is `method.stability`. It is observed on two motions that have one frequency each. In "turning", gamma
    of a free sphere turns at |w|. In "nutation", a small w of a sphere with a rotor turns about the rotor at l3 / A.
    """
    system = systems.get("fixed_point")
    y = method.stability * np.linspace(0.95, 1.05, 1025)
    body = {"A": 1.0, "B": 1.0, "C": 1.0, "theta0": 1.0, "phi0": np.zeros(y.size)}
    starts = {
        # parameters, rows of the state with the vector that turns (gamma or w), and amplitude of this vector
        "turning": ({"m": 1.0}, slice(3, None), 1.0),
        "nutation": ({"l3": 1.0, "theta_dot0": 1e-9}, slice(2), 1e-9),
    }
    largest = {}
    for name, (start, rows, amplitude) in starts.items():
        points, _ = point_columns(system, body | start)
        with np.errstate(all="ignore"):
            vector = _final_states(system, method.name, points, y, steps)[rows] / amplitude
            stable = (vector**2).sum(0) <= 1.0
        largest[name] = float(y[stable].max())
    return largest


def constraint_bound(method: Method, y: float, steps: int) -> float:
    """Return the largest expected change of |gamma| in a run of a body that turns by y radians a step.

    Each step multiplies the part of gamma normal to the axis by |R(i y)|, where R is the stability function of the method. To
    leading order this factor is 1 - dissipation y^p with p = `method.dissipation_order`. Rounding adds at most one ulp.
    """
    return steps * (method.dissipation * y**method.dissipation_order + 2.0**-53)


def constraint_change(system: System, method: Method, points: Points, y: float, steps: int) -> Array:
    """Return the largest change of |gamma| (and |alpha| and alpha.gamma of a satellite) in `steps` steps of length y / frequency bound."""
    state = _final_states(system, method.name, points, y / system.frequency_bound(points), steps)
    unit = state[3:].reshape(-1, 3, state.shape[1])
    changes = [np.abs(np.sqrt((vector**2).sum(0)) - 1) for vector in unit]
    if len(unit) == 2:
        changes.append(np.abs((unit[0] * unit[1]).sum(0)))
    return np.asarray(np.max(changes, axis=0))


def limits(*, steps: int = 10_000_000) -> list[tuple[str, ...]]:
    """Return a table of every method's limit of stability and loss of |gamma| in `steps` steps, in theory and as observed."""
    satellite = systems.get("satellite")
    tumbling, _ = point_columns(satellite, {"A": 0.9, "B": 1.1, "k1": 0.2, "theta0": 0.7, "n": 0.5, "m": 0.9})
    turning, _ = point_columns(satellite, {"C": 1.0, "Omega": 0.0, "theta0": 1.0, "m": 1.0})
    turning_bound = float(satellite.frequency_bound(turning)[0])  # the body turns at rate 1
    rows: list[tuple[str, ...]] = [
        ("method", "largest stable y, theory", "turning", "nutation", f"loss of |gamma| in {steps:.0e} steps of",
         "theory", "free turn", "tumbling satellite")
    ]  # fmt: skip
    for method in METHODS.values():
        observed = observed_stability(method)
        y = 0.02 if method.order == 4 else 0.2
        rows.append((
            method.name, f"{method.stability:.5f}", f"{observed['turning']:.4f}", f"{observed['nutation']:.4f}",
            f"y = {y:g}", f"{constraint_bound(method, y, steps):.1e}",
            f"{constraint_change(satellite, method, turning, y * turning_bound, steps)[0]:.1e}",
            f"{constraint_change(satellite, method, tumbling, y, steps)[0]:.1e}",
        ))  # fmt: skip
    return rows
