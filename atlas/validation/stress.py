"""Stiff and extreme cases: a battery of named points whose truth is known, run at a ladder of steps."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import xarray as xr

from .. import systems
from ..engine import blocks, stepsize
from ..engine.tableaux import METHODS
from ..flags import Label, Status
from ..label import labels
from ..label.pipeline import evaluate, kernel
from ..label.theory import predict
from ..scene.model import Settings
from ..systems.base import Array, Flags, Mask, Points, System
from ..variables import variables
from .reference import EXACT_RESIDUAL, reference
from .stress_cases import STRESS_CASES, StressCase

# The ladder, coarse to fine: fixed steps as a share of the stability limit at the frequency bound, then
# the automatic step at tolerances down to the default one.
RATIOS = (1.5, 0.9, 0.49, 0.3, 0.15, 0.06, 0.025, 0.01)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)
LEVELS = tuple(f"ratio {ratio:g}" for ratio in RATIOS) + tuple(f"tolerance {tol:.0e}" for tol in TOLERANCES)
# A rung that takes more steps than this for a point is left out.
MAX_STEPS = 10_000_000
# A reference follows a whole run of so many radians at the frequency bound, and this much of a longer one.
MAX_RADIANS_WHOLE, RADIANS_OF_PART = 170.0, 40.0
# A spread of the rates within this share of itself, or of the tolerance where that is more, is accurate.
ACCURATE = 0.01
RIGHT, UNRESOLVED, WRONG, LEFT_OUT = range(4)
VERDICTS = {
    "right": "the label is true",
    "unresolved": "no label",
    "wrong": "a label that is not true",
    "left_out": "more steps than the battery allows",
}


def despun_equivalent(system: System, points: Points) -> tuple[Points, Array]:
    """Points of the same motion of the axis without a rotor, and what their phi' exceeds the true one by.

    Where C w3 + rotor is conserved, the motion of the third axis depends on spin and rotor through that
    sum alone; where it is not, the points themselves.
    """
    rotor, axial = ("k3", "axial_momentum") if system.name == "satellite" else ("l3", "lagrange")
    free = ~np.isnan(system.integral_scales(points)[axial]) & np.isfinite(points[rotor])
    excess = np.where(free, points[rotor] / points["C"], 0.0)
    twin = dict(points)
    twin[rotor] = np.where(free, 0.0, points[rotor])
    twin["m"] = points["m"] + excess
    with np.errstate(all="ignore"):
        slower = system.frequency_bound(twin) < system.frequency_bound(points)
    twin = {name: np.where(slower, twin[name], points[name]) for name in points}
    return twin, np.where(slower, excess, 0.0)


def reference_label(
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
        theory = predict(system, points, settings.rate_tolerance, nudged=False)
        exact = (theory["family"] > 0) & (system.condition_residual(points) <= EXACT_RESIDUAL)
        twin, excess = despun_equivalent(system, points)
        turns = system.frequency_bound(twin) * duration
    sine = np.abs(system.steady_rates(points)[0])
    rounding = theory["growth_rate"] * duration > np.log(settings.rate_tolerance / labels.ROUNDOFF)
    label = np.where(rounding & (sine > 0), Label.UNRESOLVED, theory["predicted"]).astype(np.int8)
    unsteady = np.zeros(duration.shape)
    whence = ["theory"] * duration.size
    lost = ~exact & (~np.isfinite(turns) | (turns > 1e100))
    label[lost], unsteady[lost] = Label.UNRESOLVED, np.nan
    for i in np.flatnonzero(lost):
        whence[i] = "overflow"
    rest = np.flatnonzero(~exact & ~lost)
    if not rest.size:
        return label, unsteady, whence
    share = np.where(turns[rest] <= MAX_RADIANS_WHOLE, 1.0, RADIANS_OF_PART / np.maximum(turns[rest], 1e-300))
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
        undecided = labels.unsure(measured, error, *tolerances) | ((share < 1) & (called != Label.DRIFTING))
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
    system: System | str, cases: list[StressCase] | None = None, *, threads: int | None = None
) -> xr.Dataset:
    """Run a battery at every rung of the ladder by every method, and hold each label against the truth.

    Returns a Dataset over (method, rung, point): label, status, step_ratio and verdict; over point: the
    truth, whence it is known, case, name and why the battery lets the point stay unresolved. Rungs of
    more than MOST_STEPS steps are left out.
    """
    if isinstance(system, str):
        system = systems.get(system)
    cases = STRESS_CASES[system.name]() if cases is None else cases
    points = {name: np.concatenate([c.points[name] for c in cases]) for name in system.parameters}
    duration = np.concatenate([c.duration for c in cases])
    settings = Settings(max_steps=MAX_STEPS)
    true, unsteady, whence = reference_label(system, points, duration, settings)
    shape = (len(METHODS), len(LEVELS), duration.size)
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
    with ThreadPoolExecutor(threads or blocks.available_threads()) as pool:
        for _ in pool.map(work, jobs):
            pass
    with np.errstate(invalid="ignore"):
        error = np.abs(spread - unsteady) / np.maximum(unsteady, settings.rate_tolerance)
    verdict = np.select(
        [label == Label.NOT_COMPUTED, label == Label.UNRESOLVED, label == true],
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
        free = stepsize.choose(
            METHODS[settings.method], bound, duration[where], tolerance=settings.tolerance, step=settings.step,
            max_steps=2**50, rate_tolerance=settings.rate_tolerance,
        )  # fmt: skip
    # What overflows would take any number of steps: a few are enough to see it.
    endless = ~np.isfinite(bound) | (bound * duration[where] > 1e12)
    for chosen, kept in (
        (settings, ~endless & (free.count <= MAX_STEPS)),
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
    cases: list[StressCase],
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
            "rung": list(LEVELS),
            "case": ("point", [case.name for case, _ in named]),
            "name": ("point", [name for _, name in named]),
            "known_from": ("point", whence),
            "may_stay_unresolved": ("point", [case.may for case, _ in named]),
        },
        {"title": f"stiff and extreme cases of the {system.name}", "atlas_system": system.name},
    )  # fmt: skip
    return ds


def mislabelled(ds: xr.Dataset) -> Mask:
    """Where a label was given that is not true, bool over (method, rung, point)."""
    return np.asarray(ds["verdict"].values == WRONG)


def unresolved(ds: xr.Dataset) -> Mask:
    """Where an automatic step left a point without label that the battery does not name, bool as `silent`."""
    automatic = np.arange(len(LEVELS)) >= len(RATIOS)
    unnamed = (ds["may_stay_unresolved"].values == "") & (ds["truth"].values != Label.UNRESOLVED)
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
        f"one sign for each rung, {LEVELS[0]} to {LEVELS[len(RATIOS) - 1]} of the stability limit, then"
        f" {LEVELS[len(RATIOS)]} to {LEVELS[-1]}:\n  . every label true   u some unresolved   U all unresolved"
        "   - left out (too many steps)   X some label not true"
    )
    for text, found in (
        ("label not true", mislabelled(ds)),
        ("unresolved at an automatic step", unresolved(ds)),
    ):
        for place in zip(*np.nonzero(found), strict=True):
            at = ds.isel(dict(zip(ds["verdict"].dims, place, strict=True)))
            lines.append(
                f"{text}: {at['case'].item()}, {at['name'].item()}; {at['method'].item()}, {at['rung'].item()}:"
                f" {meanings[int(at['label'])]} ({list(Status.meanings())[int(at['status'])]}),"
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
