"""Figures 1-20 of Amer, Abo Essa, Ibrahim & Amer from the paper's data: as printed and corrected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ..errors import BadInput
from ..systems.base import Array
from ..systems.fixed_point.paper import claims, fast_spin, published
from ..systems.fixed_point.paper.claims import Row
from ..systems.fixed_point.paper.fast_spin import FastSpin
from .style import COLOURS, STYLE, WIDTHS

NUMBERS = range(1, 21)
# T of section VI: two turns about the third axis, in tau.
END = 4 * np.pi
TIMES = 2001
LINES = (COLOURS["regular_precession"], COLOURS["drifting"], "#8c4799")
SYMBOLS = {"p2": "p_2", "gamma2": r"\gamma_2"}
ROW = {"p2": 0, "gamma2": 2}  # in (p2, p2', gamma2, gamma2')


@dataclass(frozen=True)
class PaperFigure:
    """Quantity, body and rotors of one figure of the paper."""

    number: int
    body: str  # key of fast_spin.PAPER_BODIES
    quantity: str  # "p2" or "gamma2"
    phase_plane: bool
    numerical: bool
    rotors: tuple[float, ...]  # l1 = l2 = l3, N m s

    @property
    def caption(self) -> str:
        """The caption of the figure in the paper."""
        method = "numerical" if self.numerical else "analytical"
        article = "phase plane of the" if self.phase_plane else "the"
        rotors = ", ".join(f"{l:g} sqrt(3)" if l else "0" for l in self.rotors)
        return f"{article} {method} solution {self.quantity} for l = {rotors} N m s, A = B {self.body[2:]}"


def paper_figure(number: int) -> PaperFigure:
    """Figure 1 to 20 by its caption; BadInput for any other number."""
    if number not in NUMBERS:
        raise BadInput(f"figure {number}: the paper has figures {NUMBERS[0]} to {NUMBERS[-1]}")
    half, remainder = divmod(number - 1, 10)
    body, kind = divmod(remainder, 5)
    rotors = ((0.0, 10.0, 20.0), (30.0, 40.0, 50.0), (30.0, 40.0, 50.0), (50.0,), (10.0,))[kind]
    quantity = "p2" if kind in (0, 1, 3) else "gamma2"
    return PaperFigure(number, list(fast_spin.PAPER_BODIES)[body], quantity, kind > 2, half == 1, rotors)


def rk4(rate: Callable[[Array], Array], y0: Array, tau: Array) -> Array:
    """Classical Runge-Kutta method with one step between successive times.

    Parameters
    ----------
    rate : callable
        y -> dy/dtau, of the shape of y.
    y0 : ndarray
        Initial state, shape (state, ...).
    tau : ndarray
        Times, shape (k,).

    Returns
    -------
    ndarray
        States, shape (state, k, ...).
    """
    path = [y0]
    for h in np.diff(tau):
        y = path[-1]
        k1 = rate(y)
        k2 = rate(y + 0.5 * h * k1)
        k3 = rate(y + 0.5 * h * k2)
        k4 = rate(y + h * k3)
        path.append(y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.stack(path, 1)


def curves(figure: PaperFigure, tau: Array) -> dict[str, Array]:
    """The solutions that a figure compares.

    All but "(33), true" start at (18): p2 = C A1 y1 / A, p2' = gamma2' = 0.

    Parameters
    ----------
    figure : PaperFigure
        Its body and rotors.
    tau : ndarray
        Times, shape (k,).

    Returns
    -------
    dict
        Source -> (p2, p2', gamma2, gamma2') of shape (4, k, rotors). The sources of an analytical figure
        are (20) and (33) as printed, the two-frequency solution with the start (18), and (33) corrected;
        of a numerical one, by RK4, (15) as printed, the full equations (1), and (15) corrected.
    """
    spin = fast_spin.paper_body(figure.body, np.array(figure.rotors))
    y0 = fast_spin.paper_start(spin)
    x0 = fast_spin.to_quasilinear(spin, y0)
    if figure.numerical:
        full = rk4(lambda y: fast_spin.rhs(spin, y), y0, tau)
        return {
            "(15), printed": rk4(lambda x: published.quasilinear(spin, x, x0), x0, tau),
            "(1)": fast_spin.to_quasilinear(spin, full),
            "(15), true": rk4(lambda x: fast_spin.quasilinear(spin, x), x0, tau),
        }
    times = tau[:, None]
    return {
        "(20), printed": _generating(spin, x0[0], times),
        "(33), printed": _printed_first_order(spin, times),
        "general": fast_spin.to_quasilinear(spin, fast_spin.general(spin, y0, times)),
        "(33), true": fast_spin.to_quasilinear(spin, fast_spin.first_order(spin, times)),
    }


def _generating(spin: FastSpin, p0: Array, tau: Array) -> Array:
    """(20) with M1 and M3 from (18) and (30), M2 = 0."""
    slow = np.sqrt(published.frequency_squared(spin))
    return np.array(
        np.broadcast_arrays(
            p0 * np.cos(slow * tau), -slow * p0 * np.sin(slow * tau),
            spin.M3 * np.cos(tau), -spin.M3 * np.sin(tau),
        )
    )  # fmt: skip


def _printed_first_order(spin: FastSpin, tau: Array) -> Array:
    """(33) as printed in the variables (10) as printed; the derivatives by central differences."""
    p2, gamma2 = published.to_quasilinear(spin, published.first_order(spin, tau))
    step = tau[:, 0]
    return np.array([p2, np.gradient(p2, step, axis=0), gamma2, np.gradient(gamma2, step, axis=0)])


# Analytical and numerical figures -> for both columns: title, source of the full and of the dashed lines.
_PANELS = {
    False: (
        ("as printed: (20), dashed (33)", "(20), printed", "(33), printed"),
        ("true: from the start (18), dashed (33)", "general", "(33), true"),
    ),
    True: (
        ("as printed: (15) by RK4", "(15), printed", None),
        ("true: (1) by RK4, dashed (15)", "(1)", "(15), true"),
    ),
}


def draw(number: int) -> Figure:
    """One of the figures 1-20, 180 mm wide: on the left as printed, on the right corrected.

    Time is tau = r0 t, p2 is in units of c sqrt(gamma0''). Below gamma2 over time is its difference from
    M3 cos tau.

    Parameters
    ----------
    number : int
        1 to 20.

    Returns
    -------
    matplotlib.figure.Figure
        Two columns of panels.

    Raises
    ------
    BadInput
        For a number that the paper does not have.
    """
    figure = paper_figure(number)
    tau = np.linspace(0.0, END, TIMES)
    solutions = curves(figure, tau)
    gamma2 = figure.quantity == "gamma2"
    with_difference = gamma2 and not figure.phase_plane
    height = 105.0 if with_difference else 78.0 if gamma2 else 66.0
    with rc_context(STYLE):
        drawn = Figure(figsize=(WIDTHS["page"] / 25.4, height / 25.4), layout="constrained")
        axes = drawn.subplots(1 + with_difference, 2, sharex=True, sharey="row", squeeze=False)
        for (title, full, dashed), column in zip(_PANELS[figure.numerical], axes.T, strict=True):
            # stationary points of the phase plane are drawn as crosses
            crosses = figure.phase_plane and not gamma2 and not figure.numerical
            column[0].set_title(title.replace("dashed", "+") if crosses else title)
            _draw_column(column, figure, tau, solutions[full], "-")
            if dashed is not None:
                _draw_column(column, figure, tau, solutions[dashed], "--")
        _label_axes(axes, figure)
        handles = [Line2D([], [], color=colour) for colour in LINES[: len(figure.rotors)]]
        names = [rf"$\ell = {l:g}\sqrt{{3}}$ N m s" if l else r"$\ell = 0$" for l in figure.rotors]
        drawn.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
        drawn.suptitle(rf"Fig. {number}: $A = B {figure.body[2:]}$", fontsize=8, x=0.01, ha="left")
    return drawn


def _draw_column(
    column: np.ndarray, figure: PaperFigure, tau: Array, solution: Array, linestyle: str
) -> None:
    """Draw a solution in the phase plane or over time, and below its difference from M3 cos tau."""
    row, time = ROW[figure.quantity], tau[:, None]
    # Two numerical solutions coincide: the second one is black over the colours.
    black = figure.numerical and linestyle == "--"
    if figure.phase_plane:
        _draw_lines(column[0], solution[row], solution[row + 1], linestyle, black)
        return
    _draw_lines(column[0], time, solution[row], linestyle, black)
    if len(column) > 1:
        M3 = float(fast_spin.paper_body(figure.body, 0.0).M3)
        _draw_lines(column[1], time, solution[row] - M3 * np.cos(time), linestyle, black)


def _draw_lines(ax: Axes, x: Array, y: Array, linestyle: str, black: bool) -> None:
    """Draw a line for each rotor, (times, rotors)."""
    x = np.broadcast_to(x, y.shape)
    for i, colour in enumerate(LINES[: y.shape[1]]):
        style: dict[str, Any] = {"color": "black" if black else colour, "linestyle": linestyle}
        if black:
            style["linewidth"] = 0.8
        if np.ptp(x[:, i]) + np.ptp(y[:, i]) < 1e-3:  # a stationary point of the phase plane
            style |= {"marker": "+", "markersize": 5, "markevery": [0]}
        ax.plot(x[:, i], y[:, i], **style)


def _label_axes(axes: np.ndarray, figure: PaperFigure) -> None:
    """Ticks and labels of the panels, an array of shape (rows, 2)."""
    symbol = SYMBOLS[figure.quantity]
    for ax in axes.ravel():
        ax.tick_params(length=2.5)
        ax.yaxis.set_major_locator(MaxNLocator(5))
    if figure.phase_plane:
        axes[0, 0].set_ylabel(rf"$\dot {symbol}$" if figure.quantity == "p2" else r"$\dot\gamma_2$")
        for ax in axes[-1]:
            ax.set_xlabel(f"${symbol}$")
            if figure.quantity == "gamma2":
                ax.set_aspect("equal", adjustable="box")
        return
    axes[0, 0].set_ylabel(f"${symbol}$")
    for ax in axes[-1]:
        ax.set_xlabel(r"$\tau = r_0 t$")
        ax.set_xlim(0, END)
        ax.set_xticks(np.pi * np.arange(5), ["0", *(rf"${k or ''}\pi$" for k in ("", 2, 3, 4))])
    if len(axes) > 1:
        axes[1, 0].set_ylabel(r"$\gamma_2 - M_3 \cos\tau$")


def amplitude_table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Rows of `claims.figure_table` as text to six digits, below a heading."""
    heading = (
        "body", "l1 = l2 = l3", "p2(0), (18)", "centre", "amplitude", "period", "waves in 4 pi", "max |p2|",
        "mu1/Omega", "2 pi/Omega", "(15) printed: centre", "amplitude", "period",
        "gamma2 amplitude", "period", "max |gamma2 - M3 cos tau|", "unit of p2, rad/s",
    )  # fmt: skip
    table: list[tuple[str, ...]] = [heading]
    for r in rows:
        values = (
            r.start, r.centre, r.amplitude, r.period, r.waves, r.largest, r.centre_theory, r.period_theory,
            r.centre_printed, r.amplitude_printed, r.period_printed, r.gamma2_amplitude, r.gamma2_period,
        )  # fmt: skip
        change = f"{r.gamma2_change:.3g}" if r.gamma2_change > 1e-10 else "< 1e-10"  # below: rounding
        table.append((r.body, f"{r.rotor:g}", *map(_six, values), change, _six(r.unit)))
    return table


def _six(value: float) -> str:
    """A number to six digits; a dash for nan."""
    return "-" if np.isnan(value) else "0" if value == 0 else f"{value:#.6g}"


def amplitudes_and_claims() -> tuple[list[tuple[str, ...]], list[str]]:
    """`amplitude_table` of the paper's bodies, and the text of each of the paper's claims after its verdict."""
    rows = claims.figure_table()
    texts = [f"{claim.verdict}: {claim.text}\n  {claim.measured}" for claim in claims.claims(rows)]
    return amplitude_table(rows), texts
