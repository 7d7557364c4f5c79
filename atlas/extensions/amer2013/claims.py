"""Amplitudes and periods of the paper's figures, as true and as printed, and the paper's claims about them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ...flags import PeriodicSolution
from ...systems.base import Array
from . import periodic, published
from .fast_spin import (
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
    rhs,
    to_quasilinear,
)


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
    solution = dop853(lambda _, y: rhs(spin, y), span, y0, events=speed)
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
    stability: str  # of the exact one, name of PeriodicSolution
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


def claims(rows: Sequence[Row]) -> list[Claim]:
    """The paper's statements about figures 1-20 and its solution, by the rows of `figure_table` and the motion."""
    small, large = ([row for row in rows if row.body == name] for name in PAPER_BODIES)
    moving = [row for row in rows if row.rotor]
    growing, falling = ([row.amplitude for row in part] for part in (small, large))
    starts = _list(row.start for row in large)
    change, amplitudes = max(row.gamma2_change for row in rows), [row.gamma2_amplitude for row in rows]
    of_gamma2 = "holds to lowest order only" if change < 1e-2 * max(amplitudes) else FAILS
    gap, scale = max((row.gap_printed, row.amplitude_printed) for row in rows)
    left = max(row.p2_33 for row in rows)
    relative_gap = max(row.gap_printed / row.amplitude_printed for row in moving)
    relative_change = max(row.gamma2_change / row.gamma2_amplitude for row in rows)
    small_deviations = [
        name for name, value in (("p2", relative_gap), ("gamma2", relative_change)) if value < 1e-2
    ]
    of_deviations = {0: FAILS, 2: HOLDS}.get(len(small_deviations))
    return [
        Claim(
            "A < C: the amplitude of p2 increases with l",
            _verdict(bool(np.all(np.diff(growing) > 0))),
            f"amplitudes {_list(growing)}",
        ),
        Claim(
            "A > C: the amplitude of p2 decreases when l increases",
            _verdict(bool(np.all(np.diff(falling) < 0))),
            f"amplitudes {_list(falling)}; only the signed start {starts} decreases",
        ),
        _wave_claim(small, large),
        Claim(
            "gamma2 remains unchanged for different l, because it does not contain l, A, B, C",
            HOLDS if change < 1e-10 else of_gamma2,
            f"amplitude {_list([min(amplitudes), max(amplitudes)])} (least, greatest); |gamma2 - M3 cos tau| up to"
            f" {_list((row.gamma2_change for row in moving), 3)} for the rotors that are not 0, in proportion to"
            " l: the equation of gamma2 is forced by eps mu1 / (1 + Omega)",
        ),
        Claim(
            "analytical and numerical p2 of (15) agree",
            _verdict(gap < 1e-2 * scale),
            f"they differ by up to {gap:.6g}, {gap / scale:.3g} times the amplitude {scale:.6g}: (19), (20) drop the"
            " forcing C A1 y1 / A that (15) and (18) contain. (33) drops p2 as well: by (10) its p1 and g1 leave"
            f" |p2| {'< 1e-10' if left < 1e-10 else f'= {left:.3g}'}",
        ),
        Claim(
            "the deviations between analytical and numerical solutions are very small",
            of_deviations or f"holds for {small_deviations[0]} only",
            f"(20) deviates by up to {relative_gap:.3g} of the amplitude of p2 (from (15) as printed) and"
            f" {relative_change:.2g} of that of gamma2 (from the full equations)",
        ),
        _phase_plane_claim(rows),
        _singularity_claim(),
        _limit_claim(),
        _periodic_claim(),
        _effect_claim(rows),
    ]


def _periodic_claim() -> Claim:
    """How far the motions from the starts of (33) are from returning, and the exact periodic solution."""
    of_33, *corrected = np.max([row.defect for row in periodic_table() if row.rotor], axis=0)
    first, exact = ("< 1e-9" if defect < 1e-9 else f"{defect:.2g}" for defect in corrected)
    return Claim(
        "(33) is a periodic solution",
        _verdict(of_33 < 1e-2),
        f"after its period p1 + i q1 of the full equations is off its start by {of_33:.3g} |mu/Omega| at most as printed,"
        f" {first} where (33) is corrected, and {exact} in the exact solution, found by shooting",
    )


def _effect_claim(rows: Sequence[Row]) -> Claim:
    """What changes from no rotor to the largest one, each relative to its own size."""
    largest = max(row.rotor for row in rows)
    changes = []
    for body in PAPER_BODIES:
        spin, row = paper_body(body, largest), next(r for r in rows if (r.body, r.rotor) == (body, largest))
        without = paper_body(body, 0.0)
        swing = 2 * spin.eps * np.abs(spin.forced) / np.arccos(spin.gamma0)
        frequency = np.abs(spin.Omega / without.Omega - 1)
        changes.append(
            [row.largest * row.unit / spin.r0, swing, frequency, row.gamma2_change / row.gamma2_amplitude]
        )
    body_rate, *others = np.max(np.array(changes, float), axis=0)
    return Claim(
        "the great effect of the gyrostatic moment l is shown obviously",
        HOLDS if max(others) > 0.1 else "holds for p2 only",
        f"l = {largest:g} sqrt(3) makes |p2| {body_rate:.2g} of the spin r0, swings theta by {others[0]:.2g} of itself, changes"
        f" the frequency of p2 by {others[1]:.2g} and gamma2 by {others[2]:.2g}: l is {largest / (PAPER_DATA['r0'] * 22.49):.2g}"
        " of A r0. Without l there is no p2 at all, so that its curves show l alone",
    )


def _wave_claim(small: Sequence[Row], large: Sequence[Row]) -> Claim:
    """The number of waves of p2, and the sign of what little it changes."""
    waves, changes, printed = [], [], []
    for part in (small, large):
        moving = [row for row in part if row.rotor]
        waves.append([row.waves for row in moving])
        changes.append(waves[-1][-1] - waves[-1][0])
        printed.append(4 * np.pi * (1 / moving[-1].period_printed - 1 / moving[0].period_printed))
    spread = max(max(part) / min(part) - 1 for part in waves)
    opposite = all(true * wrong < 0 for true, wrong in zip(changes, printed, strict=True))
    return Claim(
        "the number of waves remains unchanged",
        _verdict(spread < 0.01),
        f"waves of p2 in 4 pi: {_list(waves[0])} (A < C), {_list(waves[1])} (A > C); relative spread {spread:.3g}."
        f" From the smallest to the largest rotor they change by {changes[0]:+.2g} and {changes[1]:+.2g}, by omega'"
        f" as printed by {printed[0]:+.2g} and {printed[1]:+.2g}: the true shift has the"
        f" {'opposite' if opposite else 'same'} sign",
    )


def _phase_plane_claim(rows: Sequence[Row]) -> Claim:
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
    largest = [row for row in rows if row.rotor == max(other.rotor for other in rows)]
    offsets = [abs(row.centre) / row.amplitude for row in largest]
    # A fast body with a rotor, l1 = l2 = l3 = A r0 / 10, whose multipliers are real
    band = FastSpin.of(1.0, 0.8, 0.8 / 0.352, 0.0, 10.0, 10.0, 10.0, 100.0, 0.352).of_shape((1,))
    exact, by_paper = periodic.solutions(band), periodic_table()
    real = exact.stability[0] == PeriodicSolution.UNSTABLE
    same &= bool(published.frequency_squared(band)[0] > 0)
    stable = all(row.stability == "stable" for row in by_paper)
    return Claim(
        "the phase planes describe the stability of the solutions",
        _verdict(not (same and growth > 0 and real)),
        f"(20) is an ellipse for every A, C, l with omega'^2 > 0: neither r0 nor the field is in it. At z0' = -1 and"
        f" r0 = {float(slow.r0):.3g} it is the one of A < C, l = 0, where the upright body is unstable (growth rate"
        f" {growth:.3g} per unit of tau). For the largest rotor the motion turns about mu1/Omega, {offsets[0]:.3g}"
        f" (A < C) and {offsets[1]:.3g} (A > C) amplitudes from 0, the centre of the ellipses drawn. By its Floquet multipliers"
        f" the exact periodic solution is {'stable' if stable else 'not always stable'} with the paper's data; at C/A = 0.8,"
        f" l = A r0 / 10, eps = 0.01 it is unstable (rho + 1/rho = {exact.trace[0]:.4g}), where (20) is an ellipse too",
    )


def _singularity_claim() -> Claim:
    """chi1 of (10) near omega' = 1, and the true solution at rational frequencies."""
    A, A1, r0 = 1.0, 0.9, 1000.0
    printed, true = [], []
    for distance in (1e-2, 1e-4, 1e-6):
        l3 = A * r0 * (A1**2 - 1 + distance) / (2 * A1)  # omega'^2 = 1 - distance
        spin = FastSpin.of(A, A * (1 + A1), 1.0, 1.0, 0.0, 0.0, l3, r0, 0.5)
        printed.append(float(published.coefficients(spin)["chi1"] / spin.G0))
        true.append(float(spin.chi1 / spin.G0))
    errors = []
    tau = np.linspace(0, 2 * np.pi, 41)
    for Omega in (1 / 3, 0.5, 1.0, 2.0, 3.0):
        spin = FastSpin.of(A, 1.5, 1.0, 1.0, 0.5, 0.5, A * r0 * (Omega - 0.5), r0, 0.5)
        y = first_order(spin, tau)
        errors.append(float(np.abs(y - integrate(spin, y[:, 0], tau)).max() / spin.eps**2))
    return Claim(
        "with omega' there are no singular points at all, for all rational omega'",
        _verdict(max(map(abs, printed)) < 100),
        f"chi1 of (10) over G0 = {_list(printed, 3)} at omega'^2 = 1 - 1e-2, 1 - 1e-4, 1 - 1e-6: a pole at omega' = 1."
        f" With Omega in place of omega' it is {_list(true, 3)}, and the only pole is C r0 + l3 = 0; at Omega ="
        f" 1/3, 1/2, 1, 2, 3 the true (33) is in error by at most {max(errors):.2g} eps^2",
    )


def _limiting_case(N: float, l3: float, r0: float) -> FastSpin:
    """The body A < C with l1 = l2 = 0, at its weight on the ground: with the paper's, rounding hides the errors."""
    A, C = PAPER_BODIES["A < C"]
    weight = PAPER_DATA["M"] * PAPER_DATA["z0"] * 9.81
    return FastSpin.of(A, C, weight, N, 0.0, 0.0, l3, r0, PAPER_DATA["gamma0"])


def _errors_of_33(spin: FastSpin) -> Array:
    """Largest error over 2 pi of p1 + i q1, over its size, and of gamma, in (33) as printed."""
    tau = np.linspace(0, 2 * np.pi, 41)
    y = published.first_order(spin, tau)
    exact = integrate(spin, y[:, 0], tau)
    off = np.abs(y - exact)
    return np.array([np.hypot(off[0], off[1]).max() / np.hypot(exact[0], exact[1]).max(), off[3:].max()])


def _limit_claim() -> Claim:
    """(33) as printed without rotor and Newtonian field, without rotor, and with l3 alone, against the full equations."""
    N = 3 * 9.81 / PAPER_DATA["R"]
    orders, periods = [], []
    for case in ((0.0, 0.0), (N, 0.0), (N, 10.0)):
        spins = [_limiting_case(*case, r0) for r0 in (1000.0, 100.0)]
        orders.append(
            np.log(_errors_of_33(spins[1]) / _errors_of_33(spins[0])) / np.log(spins[1].eps / spins[0].eps)
        )
        measured = published.measured_period_correction(spins[0])
        periods.append(float(published.period_correction(spins[0])) / measured)
    relative, gamma = np.array(orders).T
    strong = _limiting_case(N, 0.25 * PAPER_BODIES["A < C"][0] * 1000.0, 1000.0)
    solutions, period = min(*relative, *(gamma - 1)) > 0.9, max(np.abs(np.array(periods) - 1)) < 0.1
    verdicts = {(True, False): "holds to lowest order, but not for the period", (True, True): HOLDS}
    return Claim(
        "(33) gives the solutions and periods of [21] (l = k = 0), [22] (l = 0) and [23] (l3 alone) as limiting cases",
        verdicts.get((bool(solutions), bool(period)), FAILS),
        f"compared with the motion in these limits, A < C: the relative error of p1 + i q1 is of order eps^n, n ="
        f" {_list(relative, 2)} (the field by the k of (4), l3 by omega'), that of gamma n = {_list(gamma, 2)}; with l3 / (A r0) = 1/4, p1 + i q1 is in error"
        f" by {_errors_of_33(strong)[0]:.2g} of its size, by omega' and X. alpha is {_list(periods, 3)} times the"
        f" change of the period, and 1/eps = {1 / float(spins[0].eps):.3g}: its factor is eps for eps^2",
    )
