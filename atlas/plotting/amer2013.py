"""Figures 1-20 of Amer, Abo Essa, Ibrahim & Amer from the paper's data: as printed beside what is true."""

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
from ..systems.fixed_point.paper import fast_spin, published
from ..systems.fixed_point.paper.fast_spin import FastSpin, Row
from .style import COLOURS, STYLE, WIDTHS

NUMBERS = range(1, 21)
# T of section VI: two turns about the third axis, in tau.
END = 4 * np.pi
INSTANTS = 2001
LINES = (COLOURS["regular_precession"], COLOURS["drifting"], "#8c4799")
SYMBOLS = {"p2": "p_2", "gamma2": r"\gamma_2"}
PLACE = {"p2": 0, "gamma2": 2}  # in (p2, p2', gamma2, gamma2')


@dataclass(frozen=True)
class PaperFigure:
    """What one figure of the paper shows."""

    number: int
    body: str  # name of perturbation.PAPER_BODIES
    quantity: str  # "p2" or "gamma2"
    phase_plane: bool
    numerical: bool
    rotors: tuple[float, ...]  # l1 = l2 = l3, N m s

    @property
    def caption(self) -> str:
        """As under the figure in the paper."""
        kind = "numerical" if self.numerical else "analytical"
        what = "phase plane of the" if self.phase_plane else "the"
        rotors = ", ".join(f"{l:g} sqrt(3)" if l else "0" for l in self.rotors)
        return f"{what} {kind} solution {self.quantity} for l = {rotors} N m s, A = B {self.body[2:]}"


def paper_figure(number: int) -> PaperFigure:
    """Figure 1 to 20 by its caption; BadInput for any other number."""
    if number not in NUMBERS:
        raise BadInput(f"figure {number}: the paper has figures {NUMBERS[0]} to {NUMBERS[-1]}")
    half, place = divmod(number - 1, 10)
    body, kind = divmod(place, 5)
    rotors = ((0.0, 10.0, 20.0), (30.0, 40.0, 50.0), (30.0, 40.0, 50.0), (50.0,), (10.0,))[kind]
    quantity = "p2" if kind in (0, 1, 3) else "gamma2"
    return PaperFigure(number, list(fast_spin.PAPER_BODIES)[body], quantity, kind > 2, half == 1, rotors)


def rk4(rate: Callable[[Array], Array], y0: Array, tau: Array) -> Array:
    """Classical Runge-Kutta with one step between each two of the instants tau (k,): (state, k, ...)."""
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
    """(p2, p2', gamma2, gamma2') at the instants tau by source, each of shape (4, instants, rotors).

    All but "(33), true" start at (18): p2 = C A1 y1 / A, p2' = gamma2' = 0. The sources of an analytical
    figure are (20) and (33) as printed, the two-frequency solution with that start and (33) as true; of
    a numerical one, by RK4, (15) as printed, the full equations (1) and (15) as true.
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
    chi, chi1, nu, *_ = published.coefficients(spin)
    p1, _, _, g1, _, _ = published.first_order(spin, tau)
    gamma2 = (g1 - spin.eps * nu * (p1 - spin.eps * chi)) / (1 - spin.eps**2 * nu * chi1)
    p2 = p1 - spin.eps * chi - spin.eps * chi1 * gamma2
    step = tau[:, 0]
    return np.array([p2, np.gradient(p2, step, axis=0), gamma2, np.gradient(gamma2, step, axis=0)])


# Panels: title, its full lines, its dashed lines over them.
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
    """One of the figures 1-20, 180 mm wide: on the left as printed, on the right what is true.

    Time is tau = r0 t, p2 is in units of c sqrt(gamma0''). Under gamma2 over time stands what differs
    from M3 cos tau. Raises BadInput for a number the paper does not have.
    """
    figure = paper_figure(number)
    tau = np.linspace(0.0, END, INSTANTS)
    motion = curves(figure, tau)
    place = PLACE[figure.quantity]
    difference = figure.quantity == "gamma2" and not figure.phase_plane
    M3 = float(fast_spin.paper_body(figure.body, 0.0).M3)
    circle = figure.quantity == "gamma2" and figure.phase_plane
    high = 105.0 if difference else (78.0 if circle else 66.0)
    with rc_context(STYLE):
        drawn = Figure(figsize=(WIDTHS["page"] / 25.4, high / 25.4), layout="constrained")
        rows = drawn.subplots(1 + difference, 2, sharex=True, sharey="row", squeeze=False)
        for (title, full, dashed), column in zip(_PANELS[figure.numerical], rows.T, strict=True):
            points = figure.phase_plane and figure.quantity == "p2" and not figure.numerical
            column[0].set_title(title.replace("dashed", "+") if points else title)
            for source, style in ((full, "-"), (dashed, "--")):
                if source is None:
                    continue
                path = motion[source]
                # Two numerical solutions lie on each other: the second one in black over the colours.
                black = figure.numerical and style == "--"
                if figure.phase_plane:
                    _lines(column[0], path[place], path[place + 1], style, black)
                    continue
                _lines(column[0], tau[:, None], path[place], style, black)
                if difference:
                    _lines(column[1], tau[:, None], path[place] - M3 * np.cos(tau)[:, None], style, black)
        _label(rows, figure)
        handles = [Line2D([], [], color=colour) for colour in LINES[: len(figure.rotors)]]
        names = [rf"$\ell = {l:g}\sqrt{{3}}$ N m s" if l else r"$\ell = 0$" for l in figure.rotors]
        drawn.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
        drawn.suptitle(rf"Fig. {number}: $A = B {figure.body[2:]}$", fontsize=8, x=0.01, ha="left")
    return drawn


def _lines(ax: Axes, x: Array, y: Array, style: str, black: bool) -> None:
    x = np.broadcast_to(x, y.shape)
    for i, colour in enumerate(LINES[: y.shape[1]]):
        look: dict[str, Any] = {"color": "black" if black else colour, "linestyle": style}
        look |= {"linewidth": 0.8} if black else {}
        if np.ptp(x[:, i]) + np.ptp(y[:, i]) < 1e-3:  # what stands still is a point of the phase plane
            look |= {"marker": "+", "markersize": 5, "markevery": [0]}
        ax.plot(x[:, i], y[:, i], **look)


def _label(rows: np.ndarray, figure: PaperFigure) -> None:
    symbol = SYMBOLS[figure.quantity]
    for ax in rows.ravel():
        ax.tick_params(length=2.5)
        ax.yaxis.set_major_locator(MaxNLocator(5))
    if figure.phase_plane:
        rows[0, 0].set_ylabel(rf"$\dot {symbol}$" if figure.quantity == "p2" else r"$\dot\gamma_2$")
        for ax in rows[-1]:
            ax.set_xlabel(f"${symbol}$")
            if figure.quantity == "gamma2":
                ax.set_aspect("equal", adjustable="box")
        return
    rows[0, 0].set_ylabel(f"${symbol}$")
    for ax in rows[-1]:
        ax.set_xlabel(r"$\tau = r_0 t$")
        ax.set_xlim(0, END)
        ax.set_xticks(np.pi * np.arange(5), ["0", *(rf"${k or ''}\pi$" for k in ("", 2, 3, 4))])
    if len(rows) > 1:
        rows[1, 0].set_ylabel(r"$\gamma_2 - M_3 \cos\tau$")


def amplitude_table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """`perturbation.figure_table` as text to six digits, the first row the heading."""
    heading = (
        "body", "l1 = l2 = l3", "p2(0), (18)", "centre", "amplitude", "period", "waves in 4 pi", "max |p2|",
        "mu1/Omega", "2 pi/Omega", "(15) printed: centre", "amplitude", "period",
        "gamma2 amplitude", "period", "max |gamma2 - M3 cos tau|", "unit of p2, rad/s",
    )  # fmt: skip
    found: list[tuple[str, ...]] = [heading]
    for r in rows:
        values = (
            r.start, r.centre, r.amplitude, r.period, r.waves, r.largest, r.centre_theory, r.period_theory,
            r.centre_printed, r.amplitude_printed, r.period_printed, r.gamma2_amplitude, r.gamma2_period,
        )  # fmt: skip
        change = f"{r.gamma2_change:.3g}" if r.gamma2_change > 1e-10 else "< 1e-10"  # below: rounding
        found.append((r.body, f"{r.rotor:g}", *map(_six, values), change, _six(r.unit)))
    return found


def _six(value: float) -> str:
    """Six digits; a dash for what does not exist."""
    return "-" if np.isnan(value) else "0" if value == 0 else f"{value:#.6g}"
