"""Figures 1-20 of Amer, Abo Essa, Ibrahim & Amer from the paper's data: as printed, corrected and exact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from atlas.errors import BadInput
from atlas.extensions.amer2013 import fast_spin, periodic, published
from atlas.plotting.options import WIDTHS
from atlas.plotting.style import COLOURS, STYLE
from atlas.systems.base import Array

from .claims import PeriodicRow, Row

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
    def M3(self) -> float:
        """Amplitude of gamma2 without a rotor."""
        return float(fast_spin.paper_body(self.body, 0.0).M3)

    @property
    def caption(self) -> str:
        """The caption of the figure in the paper."""
        method = "numerical" if self.numerical else "analytical"
        article = "phase plane of the" if self.phase_plane else "the"
        rotors = ", ".join(f"{l:g} sqrt(3)" if l else "0" for l in self.rotors)
        return f"{article} {method} solution {self.quantity} for l = {rotors} N m s, A = B {self.body[2:]}"


def paper_figure(number: int) -> PaperFigure:
    """Content of a figure of the paper, by its caption; BadInput for a number that is not in 1 to 20."""
    if number not in NUMBERS:
        raise BadInput(f"figure {number}: the paper has figures {NUMBERS[0]} to {NUMBERS[-1]}")
    half, remainder = divmod(number - 1, 10)
    body, kind = divmod(remainder, 5)
    rotors = ((0.0, 10.0, 20.0), (30.0, 40.0, 50.0), (30.0, 40.0, 50.0), (50.0,), (10.0,))[kind]
    quantity = "p2" if kind in (0, 1, 3) else "gamma2"
    return PaperFigure(number, list(fast_spin.PAPER_BODIES)[body], quantity, kind > 2, half == 1, rotors)


def _motion(rate: Callable[[Array], Array], y0: Array, tau: Array) -> Array:
    """States (state, times, ...) at the times, from y0 (state, ...) at the first of them."""
    solution = fast_spin.dop853(
        lambda _, y: rate(y.reshape(y0.shape)).ravel(), (tau[0], tau[-1]), y0.ravel(), t_eval=tau
    )
    return np.moveaxis(solution.y.reshape(*y0.shape, tau.size), -1, 1)


@cache
def _exact(body: str, rotors: tuple[float, ...], tau: tuple[float, ...]) -> tuple[Any, Array, Array]:
    """Body, start (18), and the exact solutions of `curves`, from (18) and periodic; up to four figures share them."""
    spin = fast_spin.paper_body(body, np.array(rotors))
    y0 = fast_spin.paper_start(spin)
    starts = np.stack([y0, periodic.solutions(spin.of_shape(y0.shape[1:])).start], 1)
    path = _motion(lambda y: fast_spin.rhs(spin, y), starts, np.array(tau))
    return spin, y0, np.moveaxis(fast_spin.to_quasilinear(spin, path), 2, 0)


def curves(figure: PaperFigure, tau: Array) -> dict[str, Array]:
    """Solutions (p2, p2', gamma2, gamma2') by source, (4, times, rotors); "(33), true" and "periodic" do not start at (18)."""
    spin, y0, paths = _exact(figure.body, figure.rotors, tuple(tau))
    x0, exact = fast_spin.to_quasilinear(spin, y0), dict(zip(("(1)", "periodic"), paths, strict=True))
    if figure.numerical:
        return {
            "(15), printed": _motion(lambda x: published.quasilinear(spin, x, x0), x0, tau),
            "(15), true": _motion(lambda x: fast_spin.quasilinear(spin, x), x0, tau),
            **exact,
        }
    times, h, p0 = tau[:, None], 1e-3, x0[0]

    def printed(tau: Array) -> Array:
        """(33) as printed in the variables (10) as printed."""
        return np.array(published.to_quasilinear(spin, published.first_order(spin, tau)))

    near, far = (printed(times + k * h) - printed(times - k * h) for k in (1, 2))
    (p2, gamma2), (p2_dot, gamma2_dot) = printed(times), (8 * near - far) / (12 * h)  # of order four
    slow = np.sqrt(published.frequency_squared(spin))
    ellipse = p0 * np.cos(slow * times), -slow * p0 * np.sin(slow * times)
    circle = spin.M3 * np.cos(times), -spin.M3 * np.sin(times)
    return {
        "(20), printed": np.array(np.broadcast_arrays(*ellipse, *circle)),
        "(33), printed": np.array([p2, p2_dot, gamma2, gamma2_dot]),
        "general": fast_spin.to_quasilinear(spin, fast_spin.general(spin, y0, times)),
        "(33), true": fast_spin.to_quasilinear(spin, fast_spin.first_order(spin, times)),
        **exact,
    }


# Whether a figure is numerical -> three columns, each with its title and the label of each source in `curves`.
_EXACT = ("exact", {"(1)": "(1) from (18)", "periodic": "periodic"})
_COLUMNS = {
    False: (
        ("as printed", {"(20), printed": "(20)", "(33), printed": "(33)"}),
        ("first order, corrected", {"general": "from (18)", "(33), true": "(33)"}),
        _EXACT,
    ),
    True: (
        ("as printed", {"(15), printed": "(15)"}),
        ("first order, corrected", {"(15), true": "(15)"}),
        _EXACT,
    ),
}
# Line width, dash and gap in points, and share of white, for a panel with a single source and for the two sources of one. The
# second is dashed and narrower, so that both are visible where they coincide.
_SINGLE, _FIRST, _SECOND = (1.0, 8.0, 0.0, 0.0), (2.6, 8.0, 0.0, 0.55), (0.9, 3.5, 2.5, 0.0)
# Curves closer than this share of the range of their panels are drawn as one line of alternating colours.
COINCIDE = 3e-3
NOTE = "Curves of different rotors that coincide are drawn as one line of alternating colours."


def draw(number: int) -> Figure:
    """One of the figures 1-20, 180 mm wide: as printed, corrected to first order, and exact."""
    figure = paper_figure(number)
    tau = np.linspace(0.0, END, TIMES)
    solutions = curves(figure, tau)
    with rc_context(STYLE):
        if figure.phase_plane and figure.quantity == "gamma2":
            fig, coincide = _gamma2_plane(figure, tau, solutions), False
        else:
            fig, coincide = _two_columns(figure, tau, solutions)
        handles = [Line2D([], [], color=colour) for colour in LINES[: len(figure.rotors)]]
        names = [rf"$\ell = {l:g}\sqrt{{3}}$ N m s" if l else r"$\ell = 0$" for l in figure.rotors]
        fig.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
        fig.suptitle(rf"Fig. {number}: $A = B {figure.body[2:]}$", fontsize=8, x=0.01, ha="left")
        if coincide:
            fig.supxlabel(NOTE, fontsize=7)
        engine = fig.get_layout_engine()
        assert engine is not None
        engine.set(wspace=0.07)  # type: ignore[call-arg]  # the last tick of a panel is near the next
    return fig


def _two_columns(figure: PaperFigure, tau: Array, solutions: dict[str, Array]) -> tuple[Figure, bool]:
    """Printed, corrected and exact solutions side by side, and whether any of their curves coincide."""
    row, time = ROW[figure.quantity], tau[:, None]
    if figure.phase_plane:
        rows = {"plane": {name: (path[row], path[row + 1]) for name, path in solutions.items()}}
    else:
        rows = {"value": {name: (time, path[row]) for name, path in solutions.items()}}
    if figure.quantity == "gamma2":
        harmonic = figure.M3 * np.cos(time)
        rows["difference"] = {name: (time, path[row] - harmonic) for name, path in solutions.items()}
    fig = Figure(figsize=(WIDTHS["page"] / 25.4, (30.0 + 44.0 * len(rows)) / 25.4), layout="constrained")
    axes = fig.subplots(len(rows), 3, sharex=True, sharey="row", squeeze=False)
    coincide = False
    for number, (panels, lines) in enumerate(zip(axes, rows.values(), strict=True)):
        resolution = COINCIDE * np.ptp(np.concatenate([y.ravel() for _, y in lines.values()]))
        for ax, (title, sources) in zip(panels, _COLUMNS[figure.numerical], strict=True):
            handles, overlap = _draw_sources(ax, [lines[name] for name in sources], resolution)
            coincide |= overlap
            if number == 0:
                _add_legend(ax, title, handles, list(sources.values()))
    for ax in axes.ravel():
        ax.tick_params(length=2.5)
        ax.yaxis.set_major_locator(MaxNLocator(5))
    unit = r" (units of $c\sqrt{\gamma_0''}$)" if figure.quantity == "p2" else ""
    label = f"${SYMBOLS[figure.quantity]}${unit}"
    if figure.phase_plane:
        axes[0, 0].set_ylabel(rf"$\dot {SYMBOLS[figure.quantity]}${unit}")
        for ax in axes[-1]:
            ax.set_xlabel(label)
            ax.xaxis.set_major_locator(MaxNLocator(5))
        return fig, coincide
    axes[0, 0].set_ylabel(label)
    for ax in axes[-1]:
        ax.set_xlabel(r"$\tau = r_0 t$")
        ax.set_xlim(0, END)
        ax.set_xticks(np.pi * np.arange(5), ["0", *(rf"${k or ''}\pi$" for k in ("", 2, 3, 4))])
    if len(axes) > 1:
        axes[1, 0].set_ylabel(r"$\gamma_2 - M_3 \cos\tau$")
    return fig, coincide


def _gamma2_plane(figure: PaperFigure, tau: Array, solutions: dict[str, Array]) -> Figure:
    """The phase plane of gamma2 once, and in the first turn the differences of the solutions from a circle."""
    M3, time = figure.M3, tau[:, None]
    circle, turn = M3 * np.array([np.cos(time), -np.sin(time)]), tau <= 2 * np.pi
    fig = Figure(figsize=(WIDTHS["page"] / 25.4, 66.0 / 25.4), layout="constrained")
    plane, *panels = fig.subplots(1, 4)
    columns = _COLUMNS[figure.numerical]
    differences = {name: 1e3 * (path[2:] - circle)[:, turn] for name, path in solutions.items()}
    true = next(iter(columns[1][1]))
    _draw_sources(plane, [tuple(solutions[true][2:, turn])], 0.0)
    distance = max(float(np.abs(path[2:] - circle).max()) for path in solutions.values())
    plane.set_title(f"all solutions: within {100 * distance / M3:.2g} % of\na circle of radius $M_3$")
    plane.set(xlabel=r"$\gamma_2$", ylabel=r"$\dot\gamma_2$")
    low, high = (np.array([f(path, axis=(1, 2)) for path in differences.values()]) for f in (np.min, np.max))
    middle, half = 0.5 * (low.min(0) + high.max(0)), 0.6 * (high.max(0) - low.min(0)).max()
    for ax, (title, sources) in zip(panels, columns, strict=True):
        handles, _ = _draw_sources(ax, [tuple(differences[name]) for name in sources], 0.0)
        _add_legend(ax, title, handles, list(sources.values()), columns=1)
        ax.set(xlabel=r"$10^3\,(\gamma_2 - M_3 \cos\tau)$", ylabel=r"$10^3\,(\dot\gamma_2 + M_3 \sin\tau)$")
        ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    for ax in (plane, *panels):
        ax.set_box_aspect(1)
        ax.tick_params(length=2.5)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(4))
    return fig


def _draw_sources(
    ax: Axes, lines: Sequence[tuple[Array, ...]], resolution: float
) -> tuple[list[Line2D], bool]:
    """Draw one or two sources; grey legend entries, and whether curves of different rotors coincide."""
    styles = (_SINGLE,) if len(lines) == 1 else (_FIRST, _SECOND)
    handles, coincide = [], False
    for (x, y), style, level in zip(lines, styles, (2.0, 3.0), strict=False):
        x = np.broadcast_to(x, y.shape)
        point = bool((np.ptp(x, axis=0) + np.ptp(y, axis=0) < 1e-6).all())  # at rest in a phase plane
        symbol = {"linestyle": "", "marker": "o" if style is _FIRST else "+", "markersize": 6}
        marker = symbol if point else {}
        for i in range(y.shape[1]):
            group = [k for k in range(y.shape[1]) if np.abs(y[:, k] - y[:, i]).max() < resolution] or [i]
            coincide |= len(group) > 1
            times = slice(0, 1 if point else None)
            line = _line(LINES[i], group.index(i), len(group), style) | marker
            ax.plot(x[times, i], y[times, i], zorder=level, **line)
        handles.append(Line2D([], [], **_line("0.2", 0, 1, style) | marker))
    return handles, coincide


def _line(colour: str, place: int, size: int, style: tuple[float, float, float, float]) -> dict[str, Any]:
    """Colour, width and dashes of a curve; the dashes of `size` coinciding curves fill each other's gaps, by `place`."""
    width, dash, gap, white = style
    line: dict[str, Any] = {"color": (1 - white) * np.array(to_rgb(colour)) + white, "linewidth": width}
    if gap or size > 1:
        period = size * (dash + gap)
        # Matplotlib multiplies the dashes by the width of the line.
        line["linestyle"] = ((period - place * (dash + gap)) / width, (dash / width, (period - dash) / width))
    return line


def _add_legend(ax: Axes, title: str, handles: list[Line2D], labels: list[str], columns: int = 2) -> None:
    """Title of a column, and its sources."""
    ax.legend(
        handles, labels, title=title, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns,
        frameon=False, borderaxespad=0.2, handlelength=2.4, columnspacing=1.4,
    )  # fmt: skip


def amplitude_table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Rows of `claims.figure_table` as text to six digits, below a heading."""
    heading = (
        "body", "l1 = l2 = l3", "p2(0), (18)", "centre", "amplitude", "period", "waves in 4 pi", "max |p2|",
        "mu1/Omega", "2 pi/Omega", "centre, (15) printed", "amplitude, (15) printed", "period, (15) printed",
        "amplitude of gamma2", "period of gamma2", "max |gamma2 - M3 cos tau|", "unit of p2, rad/s",
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


def periodic_solutions(rows: Sequence[PeriodicRow]) -> list[tuple[str, ...]]:
    """Rows of `claims.periodic_table` as text, below a heading: as printed, corrected to first order, exact."""
    readings = ("printed", "first order", "exact")
    quantities = [
        (name, reading) for name in ("p1(0)", "period - 2 pi", "rho + 1/rho") for reading in readings
    ]
    heading = ("body", "l1 = l2 = l3", *(f"{name}, {reading}" for name, reading in quantities))
    table: list[tuple[str, ...]] = [(*heading, "stable, printed", "stable, exact")]
    for r in rows:
        periods = ("< 1e-10" if abs(value) < 1e-10 else f"{value:.6g}" for value in r.period)
        stable = "yes" if r.stable_printed else "no", r.stability
        starts = (_six(p1) if abs(p1) > 1e-3 else f"{p1:.2g}" for p1 in r.p1)
        table.append((r.body, f"{r.rotor:g}", *starts, *periods, *map(_six, r.trace), *stable))
    return table
