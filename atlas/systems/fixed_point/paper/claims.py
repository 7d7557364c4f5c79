"""Amplitudes and periods of the paper's figures, as true and as printed, and the paper's claims about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...base import Array
from . import published
from .fast_spin import (
    PAPER_BODIES,
    PAPER_ROTORS,
    FastSpin,
    dop853,
    integrate,
    paper_body,
    paper_start,
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
    gap_printed: float  # max |p2 of (20) - p2 of (15)| as printed, which the paper says agree
    gamma2_amplitude: float  # from the full equations
    gamma2_period: float  # from the full equations
    gamma2_change: float  # max |gamma2 - M3 cos tau|


def figure_table(rotors: Sequence[float] = PAPER_ROTORS) -> list[Row]:
    """Amplitudes and periods behind figures 1-20, measured from the full equations (1) with DOP853."""
    return [_figure_row(body, rotor) for body in PAPER_BODIES for rotor in rotors]


def _figure_row(body: str, rotor: float) -> Row:
    """One row of figure_table."""
    tau = np.linspace(0, 4 * np.pi, 2001)
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
    return Row(
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
        gamma2_amplitude=gamma2_amplitude,
        gamma2_period=gamma2_period,
        gamma2_change=float(np.abs(gamma2 - spin.M3 * np.cos(tau)).max()),
    )


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


class Claim(NamedTuple):
    """A statement of section VI, whether it holds, and the measured numbers."""

    text: str
    holds: bool
    measured: str


def claims(rows: Sequence[Row]) -> list[Claim]:
    """The paper's statements about figures 1-20, compared with the rows of `figure_table`."""
    body = {name: [row for row in rows if row.body == name] for name in PAPER_BODIES}
    small, large = body["A < C"], body["A > C"]

    def list_of(values: list[float]) -> str:
        return ", ".join(f"{value:.6g}" for value in values)

    def amplitudes(part: list[Row]) -> list[float]:
        return [row.amplitude for row in part]

    def waves(part: list[Row]) -> list[float]:
        return [row.waves for row in part if row.rotor]

    spread = max(max(waves(part)) / min(waves(part)) - 1 for part in body.values())
    change = max(row.gamma2_change for row in rows)
    gap, gap_scale = max((row.gap_printed, row.amplitude_printed) for row in rows)
    return [
        Claim(
            "A < C: the amplitude of p2 increases with l",
            bool(np.all(np.diff(amplitudes(small)) > 0)),
            f"amplitudes {list_of(amplitudes(small))}",
        ),
        Claim(
            "A > C: the amplitude of p2 decreases when l increases",
            bool(np.all(np.diff(amplitudes(large)) < 0)),
            f"amplitudes {list_of(amplitudes(large))}; only the signed start {list_of([r.start for r in large])}"
            " decreases",
        ),
        Claim(
            "the number of waves remains unchanged",
            spread < 0.01,
            f"waves of p2 in 4 pi: {list_of(waves(small))} (A < C), {list_of(waves(large))} (A > C);"
            f" relative spread {spread:.3g}",
        ),
        Claim(
            "gamma2 does not depend on l, A, B, C",
            change < 1e-2,
            f"amplitude {list_of([min(r.gamma2_amplitude for r in rows), max(r.gamma2_amplitude for r in rows)])}"
            f" (least, greatest); largest |gamma2 - M3 cos tau| = {change:.3g}: true to the lowest order only",
        ),
        Claim(
            "analytical and numerical p2 of (15) agree",
            gap < 1e-2 * gap_scale,
            f"they differ by up to {gap:.6g}, {gap / gap_scale:.3g} times the amplitude {gap_scale:.6g}:"
            " (19), (20) drop the forcing C A1 y1 / A that (15) and (18) contain",
        ),
    ]
