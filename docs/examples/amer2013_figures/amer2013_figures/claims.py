"""Amplitudes and periods of the paper's figures, as true and as printed, and the paper's claims about them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from atlas.extensions.amer2013 import periodic, published
from atlas.extensions.amer2013.fast_spin import (
    PAPER_BODIES,
    PAPER_DATA,
    PAPER_ROTORS,
    FastSpin,
    dop853,
    first_order,
    integrate,
    paper_body,
    paper_start,
    period_correction,
    rate_of,
    to_quasilinear,
)
from atlas.flags import PeriodicSolution
from atlas.systems.base import Array


class Row(NamedTuple):
    """One curve of the paper's figures; dimensionless, times in tau. nan where p2 is constant."""

    body: str
    rotor: float  # l1 = l2 = l3, N m s
    unit: float  # c sqrt(gamma0''), rad s-1: times p2 it is the angular velocity
    start: float  # p2 at tau = 0, (18)
    centre: float  # of p2, from the full equations
    amplitude: float  # of p2, from the full equations
    period: float  # of p2, from the full equations
    waves: float  # of p2 in [0, 4 pi]
    largest: float  # max |p2| on [0, 4 pi], from the full equations
    centre_theory: float  # mu1 / Omega
    amplitude_theory: float
    period_theory: float  # 2 pi / Omega
    centre_printed: float  # (15) as printed, with its forcing
    amplitude_printed: float
    period_printed: float
    gap_printed: float  # max |p2 of (20) - p2 of (15)| as printed, which agree according to the paper
    p2_33: float  # max |p2| that (33) as printed leaves by (10)
    gamma2_amplitude: float  # from the full equations
    gamma2_period: float  # from the full equations
    gamma2_change: float  # max |gamma2 - M3 cos tau|


def figure_table(rotors: Sequence[float] = PAPER_ROTORS) -> list[Row]:
    """Amplitudes and periods behind figures 1-20, measured from the full equations (1) with DOP853."""
    tau, rows = np.linspace(0, 4 * np.pi, 2001), list[Row]()
    for body, rotor in product(PAPER_BODIES, rotors):
        spin = paper_body(body, rotor)
        y0 = paper_start(spin)
        p2, _, gamma2, _ = to_quasilinear(spin, integrate(spin, y0, tau))
        at_rest = (0.0, 0.0, 0.0, np.nan)
        start, centre, amplitude, period = _oscillation(spin, y0, "p2") if rotor else at_rest
        _, _, gamma2_amplitude, gamma2_period = _oscillation(spin, y0, "gamma2")
        forcing, squared = spin.A1 * spin.mu.real, published.frequency_squared(spin)
        frequency = np.sqrt(squared)
        rest = forcing / squared
        printed = rest + (forcing - rest) * np.cos(frequency * tau)
        rows.append(
            Row(
                body=body,
                rotor=rotor,
                unit=float(spin.scale),
                start=start,
                centre=centre,
                amplitude=amplitude,
                period=period,
                waves=4 * np.pi / period,
                largest=float(np.abs(p2).max()) if rotor else 0.0,
                centre_theory=float(spin.forced.real),
                amplitude_theory=float(np.abs(forcing - spin.forced.real)),
                period_theory=float(2 * np.pi / np.abs(spin.Omega)),
                centre_printed=float(rest),
                amplitude_printed=float(np.abs(forcing - rest)),
                period_printed=float(2 * np.pi / frequency),
                gap_printed=float(np.abs(forcing * np.cos(frequency * tau) - printed).max()),
                p2_33=float(
                    np.abs(published.to_quasilinear(spin, published.first_order(spin, tau))[0]).max()
                ),
                gamma2_amplitude=gamma2_amplitude,
                gamma2_period=gamma2_period,
                gamma2_change=float(np.abs(gamma2 - spin.M3 * np.cos(tau)).max()),
            )
        )
    return rows


def _oscillation(spin: FastSpin, y0: Array, name: str) -> tuple[float, float, float, float]:
    """Initial value, centre, amplitude and period of p2 or gamma2, from the extrema of the full motion."""
    row, frequency = {"p2": (0, spin.Omega), "gamma2": (2, np.ones(()))}[name]

    def speed(_: float, y: Array) -> float:
        return float(to_quasilinear(spin, y)[row + 1])

    span = (0.0, 2.5 * np.pi / float(np.abs(frequency)))
    solution = dop853(rate_of(spin), span, y0, events=speed)
    # The start is an extremum too; whether it is reported as an event depends on rounding errors.
    after_start = solution.t_events[0] > 1e-3
    times, states = solution.t_events[0][after_start], solution.y_events[0][after_start]
    start = float(to_quasilinear(spin, y0)[row])
    extremum = to_quasilinear(spin, states.T)[row][0]
    return start, 0.5 * (start + extremum), 0.5 * abs(start - extremum), float(times[1])


class PeriodicRow(NamedTuple):
    """The periodic solution of a body with a rotor, each as printed, corrected to first order, and exact; times in tau."""

    body: str
    rotor: float  # l1 = l2 = l3, N m s
    p1: Array  # at tau = 0
    period: Array  # less 2 pi
    trace: Array  # sum of the multipliers rho and 1/rho
    defect: Array  # |w - w(0)| after a period of the full equations, over |mu / Omega|; w = p1 + i q1
    stability: str  # stability of the exact solution, a name of PeriodicSolution
    stable_printed: bool  # omega'^2 > 0: (20) is an ellipse


@cache
def periodic_table(rotors: tuple[float, ...] = PAPER_ROTORS) -> list[PeriodicRow]:
    """Periodic solutions of the bodies of figures 1-20."""
    rows, begin = list[PeriodicRow](), np.zeros(len(rotors))
    for body in PAPER_BODIES:
        spin = paper_body(body, np.array(rotors, float)).of_shape(begin.shape)
        exact, squared = periodic.solutions(spin), published.frequency_squared(spin)
        starts = [published.first_order(spin, begin), first_order(spin, begin), exact.start]
        periods = [published.period_correction(spin), period_correction(spin), exact.period - 2 * np.pi]
        traces = [2 * np.cos(2 * np.pi * np.sqrt(squared)), 2 * np.cos(2 * np.pi * spin.Omega), exact.trace]
        for i, rotor in enumerate(rotors):
            one = paper_body(body, rotor)
            size = float(np.abs(one.forced)) or 1.0
            defects = [
                np.hypot(*np.ptp(integrate(one, y[:, i], np.array([0, 2 * np.pi + a[i]]))[:2], axis=1)) / size
                for y, a in zip(starts, periods, strict=True)
            ]
            p1, period, trace = (
                np.array([column[i] for column in group])
                for group in ([y[0] for y in starts], periods, traces)
            )
            stability = list(PeriodicSolution.meanings())[exact.stability[i]]
            ellipse = bool(squared[i] > 0)
            rows.append(PeriodicRow(body, rotor, p1, period, trace, np.array(defects), stability, ellipse))
    return rows


HOLDS, FAILS = "holds", "does not hold"


class Claim(NamedTuple):
    """A statement of the paper, whether it holds, and the measured numbers."""

    text: str
    verdict: str  # "holds", "does not hold" or how far it holds
    measured: str

    @property
    def holds(self) -> bool:
        """Does it hold without restriction?"""
        return self.verdict == HOLDS


def _verdict(holds: bool) -> str:
    return HOLDS if holds else FAILS


def _list(values: Iterable[float], digits: int = 6) -> str:
    """Numbers with commas between them."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


Judgement = tuple[str, dict[str, Any]]  # verdict, and the values in the template of what is measured


def claims(rows: Sequence[Row]) -> list[Claim]:
    """Verdicts on the paper's statements about figures 1-20 and its solution, measured from the rows of `figure_table`."""
    judged = []
    for name, entry in tomllib.loads(files(__package__).joinpath("claims.toml").read_text("utf-8")).items():
        verdict, values = MEASURES[name](rows)
        judged.append(Claim(entry["text"], verdict, re.sub(r"\s+", " ", entry["measured"]).format(**values)))
    return judged


def _bodies(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows of the bodies A < C and A > C."""
    return [[row for row in rows if row.body == name] for name in PAPER_BODIES]


def _growing_amplitude(rows: Sequence[Row]) -> Judgement:
    amplitudes = [row.amplitude for row in _bodies(rows)[0]]
    return _verdict(bool(np.all(np.diff(amplitudes) > 0))), {"amplitudes": _list(amplitudes)}


def _falling_amplitude(rows: Sequence[Row]) -> Judgement:
    large = _bodies(rows)[1]
    amplitudes = [row.amplitude for row in large]
    values = {"amplitudes": _list(amplitudes), "starts": _list(row.start for row in large)}
    return _verdict(bool(np.all(np.diff(amplitudes) < 0))), values


def _waves(rows: Sequence[Row]) -> Judgement:
    """The number of waves of p2, and the sign of its small change."""
    moving = [[row for row in part if row.rotor] for part in _bodies(rows)]
    small, large = waves = [[row.waves for row in part] for part in moving]
    true = [part[-1] - part[0] for part in waves]
    printed = [4 * np.pi * (1 / part[-1].period_printed - 1 / part[0].period_printed) for part in moving]
    spread = max(max(part) / min(part) - 1 for part in waves)
    opposite = all(a * b < 0 for a, b in zip(true, printed, strict=True))
    values = {"true": true, "printed": printed, "spread": spread, "sign": "opposite" if opposite else "same"}
    return _verdict(spread < 0.01), values | {"small": _list(small), "large": _list(large)}


def _gamma2(rows: Sequence[Row]) -> Judgement:
    change, amplitudes = max(row.gamma2_change for row in rows), [row.gamma2_amplitude for row in rows]
    verdict = "holds to lowest order only" if change < 1e-2 * max(amplitudes) else FAILS
    changes = _list((row.gamma2_change for row in rows if row.rotor), 3)
    values = {"range": _list([min(amplitudes), max(amplitudes)]), "changes": changes}
    return HOLDS if change < 1e-10 else verdict, values


def _agreement(rows: Sequence[Row]) -> Judgement:
    gap, amplitude = max((row.gap_printed, row.amplitude_printed) for row in rows)
    rest = max(row.p2_33 for row in rows)
    values = {"rest": "< 1e-10" if rest < 1e-10 else f"= {rest:.3g}", "share": gap / amplitude}
    return _verdict(gap < 1e-2 * amplitude), values | {"gap": gap, "amplitude": amplitude}


def _deviations(rows: Sequence[Row]) -> Judgement:
    relative = {
        "p2": max(row.gap_printed / row.amplitude_printed for row in rows if row.rotor),
        "gamma2": max(row.gamma2_change / row.gamma2_amplitude for row in rows),
    }
    small = [name for name, value in relative.items() if value < 1e-2]
    return {0: FAILS, 2: HOLDS}.get(len(small)) or f"holds for {small[0]} only", relative


def _periodic(rows: Sequence[Row]) -> Judgement:
    """Whether motions that start at (33) return to their start after a period; the distance that the exact solution leaves."""
    printed, *corrected = np.max([row.defect for row in periodic_table() if row.rotor], axis=0)
    first, exact = ("< 1e-9" if defect < 1e-9 else f"{defect:.2g}" for defect in corrected)
    return _verdict(printed < 1e-2), {"printed": printed, "first": first, "exact": exact}


def _effect(rows: Sequence[Row]) -> Judgement:
    """What changes from no rotor to the largest one, each relative to its own size."""
    rotor, changes = max(row.rotor for row in rows), []
    for row in (row for row in rows if row.rotor == rotor):
        spin, without = paper_body(row.body, rotor), paper_body(row.body, 0.0)
        swing = 2 * spin.eps * np.abs(spin.forced) / np.arccos(spin.gamma0)
        frequency = np.abs(spin.Omega / without.Omega - 1)
        gamma2 = row.gamma2_change / row.gamma2_amplitude
        changes.append([row.largest * row.unit / spin.r0, swing, frequency, gamma2])
    p2, swing, frequency, gamma2 = np.max(np.array(changes, float), axis=0)
    values = {"rotor": rotor, "p2": p2, "swing": swing, "frequency": frequency, "gamma2": gamma2}
    share = rotor / (PAPER_DATA["r0"] * PAPER_BODIES["A < C"][0])
    return HOLDS if max(swing, frequency, gamma2) > 0.1 else "holds for p2 only", values | {"share": share}


def _phase_planes(rows: Sequence[Row]) -> Judgement:
    """An ellipse of (20) contains nothing about stability, because r0 and the field are not in it."""
    spin = paper_body("A < C", 0.0)
    upright = 1 / spin.gamma0  # g1'' of the upright body, whose stability is known in closed form
    inverted = replace(spin, weight=-spin.weight)
    # w and G turn with x: x^2 + (1 - A1) x - A1 - eps^2 (z/a - k A1 g1'') g1'' = 0
    pull = (inverted.z / inverted.a - inverted.k * inverted.A1 * upright) * upright
    critical = 2 * inverted.scale * np.sqrt(-pull) / (1 + inverted.A1)
    slow = replace(inverted, r0=0.5 * critical)
    growth = float(np.sqrt(np.maximum(0, -((1 + slow.A1) ** 2) - 4 * slow.eps**2 * pull)) / 2)
    same = abs(float(published.frequency_squared(slow) / published.frequency_squared(spin)) - 1) < 1e-14
    # A fast body with a rotor, l1 = l2 = l3 = A r0 / 10, whose multipliers are real
    band = FastSpin(1.0, 0.8, 0.8 / 0.352, 0.0, 10.0, 10.0, 10.0, 100.0, 0.352).of_shape((1,))
    exact = periodic.solutions(band)
    same &= bool(published.frequency_squared(band)[0] > 0)
    stable = all(row.stability == "stable" for row in periodic_table())
    rotor = max(row.rotor for row in rows)
    return _verdict(not (same and growth > 0 and exact.stability[0] == PeriodicSolution.UNSTABLE)), {
        "r0": float(slow.r0),
        "growth": growth,
        "offsets": [abs(row.centre) / row.amplitude for row in rows if row.rotor == rotor],
        "stable": "stable" if stable else "not always stable",
        "trace": exact.trace[0],
    }


def _singularity(rows: Sequence[Row]) -> Judgement:
    """chi1 of (10) near omega' = 1, and the true solution at rational frequencies."""
    A, A1, r0 = 1.0, 0.9, 1000.0
    printed, true, errors = list[float](), list[float](), list[float]()
    for distance in (1e-2, 1e-4, 1e-6):
        l3 = A * r0 * (A1**2 - 1 + distance) / (2 * A1)  # omega'^2 = 1 - distance
        spin = FastSpin(A, A * (1 + A1), 1.0, 1.0, 0.0, 0.0, l3, r0, 0.5)
        printed.append(float(published.coefficients(spin)["chi1"] / spin.G0))
        true.append(float(spin.chi1 / spin.G0))
    tau = np.linspace(0, 2 * np.pi, 41)
    for Omega in (1 / 3, 0.5, 1.0, 2.0, 3.0):
        spin = FastSpin(A, 1.5, 1.0, 1.0, 0.5, 0.5, A * r0 * (Omega - 0.5), r0, 0.5)
        y = first_order(spin, tau)
        errors.append(float(np.abs(y - integrate(spin, y[:, 0], tau)).max() / spin.eps**2))
    values = {"printed": _list(printed, 3), "true": _list(true, 3), "error": max(errors)}
    return _verdict(max(map(abs, printed)) < 100), values


def _limiting_case(N: float, l3: float, r0: float) -> FastSpin:
    """The body A < C with l1 = l2 = 0, at its weight on the ground: with the paper's, rounding hides the errors."""
    A, C = PAPER_BODIES["A < C"]
    weight = PAPER_DATA["M"] * PAPER_DATA["z0"] * 9.81
    return FastSpin(A, C, weight, N, 0.0, 0.0, l3, r0, PAPER_DATA["gamma0"])


def _errors_of_33(spin: FastSpin) -> Array:
    """Largest error over 2 pi of p1 + i q1, over its size, and of gamma, in (33) as printed."""
    tau = np.linspace(0, 2 * np.pi, 41)
    y = published.first_order(spin, tau)
    exact = integrate(spin, y[:, 0], tau)
    off = np.abs(y - exact)
    return np.array([np.hypot(off[0], off[1]).max() / np.hypot(exact[0], exact[1]).max(), off[3:].max()])


def _limits(rows: Sequence[Row]) -> Judgement:
    """(33) as printed without rotor and Newtonian field, without rotor, and with l3 alone, against the full equations."""
    N = 3 * 9.81 / PAPER_DATA["R"]
    orders, periods = [], []
    for case in ((0.0, 0.0), (N, 0.0), (N, 10.0)):
        fast, slow = (_limiting_case(*case, r0) for r0 in (1000.0, 100.0))
        orders.append(np.log(_errors_of_33(slow) / _errors_of_33(fast)) / np.log(slow.eps / fast.eps))
        measured = published.measured_period_correction(fast)
        periods.append(float(published.period_correction(fast)) / measured)
    relative, gamma = np.array(orders).T
    solutions, period = min(*relative, *(gamma - 1)) > 0.9, max(np.abs(np.array(periods) - 1)) < 0.1
    verdict = (HOLDS if period else "holds to lowest order, but not for the period") if solutions else FAILS
    return verdict, {
        "relative": _list(relative, 2),
        "gamma": _list(gamma, 2),
        "strong": _errors_of_33(_limiting_case(N, 0.25 * PAPER_BODIES["A < C"][0] * 1000.0, 1000.0))[0],
        "periods": _list(periods, 3),
        "inverse": 1 / float(fast.eps),
    }


# By the names of the claims in claims.toml.
MEASURES: dict[str, Callable[[Sequence[Row]], Judgement]] = {
    measure.__name__.removeprefix("_"): measure
    for measure in (
        _growing_amplitude, _falling_amplitude, _waves, _gamma2, _agreement, _deviations, _phase_planes, _singularity,
        _limits, _periodic, _effect,
    )
}  # fmt: skip
