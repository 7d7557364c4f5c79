"""Figures of trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from ..analysis.degrees import in_degrees
from ..analysis.metadata import system_of
from ..errors import BadInput, attribute_text, shown
from ..files import atomic_write, writable
from ..scene.checks import boolean, positive
from ..systems.base import Observable
from .options import WIDTHS, Width, width_mm
from .style import COLOURS, STYLE, SYMBOLS, unit_text

View: TypeAlias = tuple[float, float]
VIEW: View = (40.0, 25.0)  # azimuth and elevation of the viewer of the sphere, degrees
MIN_BESIDE = 140.0  # on figures at least this wide (mm) the sphere is beside the panels over time
FAR_OPACITY = 0.35  # opacity of paths on the far side of the sphere
START_MARKER: dict[str, Any] = {
    "marker": "o",
    "color": COLOURS["drifting"],
    "markersize": 3.5,
    "linestyle": "",
}
PLOTTED_RATES = ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
LINES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS["regular_precession"], "linestyle": "-"},
    {"color": COLOURS["drifting"], "linestyle": "--"},
    {"color": "black", "linestyle": ":"},
    {"color": "#7fb9d8", "linestyle": "-."},
)
MAX_PANELS = 8  # largest number of panels for a system with observables
# If a rate exceeds CLIP_ABOVE times the 0.9 quantile of all rates, the panel ends at CLIP_AT times the quantile.
CLIP_ABOVE, CLIP_AT = 10, 3
# A path within SMALL (rad) of the mean direction is also drawn enlarged. A path within AT_REST (rad) consists of rounding errors.
SMALL, AT_REST = 0.1, 1e-12
ANIMATIONS: dict[str, Any] = {".gif": PillowWriter, ".mp4": FFMpegWriter}
FRAMES_PER_SECOND, FILM_DPI = 25, 150
NOTE = SYMBOLS["normal_rate"] + ": angular velocity relative to the frame along its vertical"


def trajectory_figure(
    tr: xr.Dataset, *, ax: Axes | None = None, view: View = VIEW, degrees: bool = False, width: Width = "page"
) -> Figure:
    """Draw angles, rates and the path of the third body axis, or observables. On `ax` draw the path alone. See `Atlas.plot`."""
    boolean("degrees", degrees)
    size = width_mm(width) / 25.4
    if ax is not None:
        if not isinstance(ax, Axes):
            raise BadInput(f"ax = {shown(ax)}: must be Axes of Matplotlib")
        _draw_sphere(ax, _path(tr), system_of(tr).frame_axes, view)
        return ax.get_figure(root=True)  # type: ignore[return-value]
    if "time" in tr.dims and "atlas_system" in tr.attrs and (observables := system_of(tr).observables):
        return _figure_of_observables(in_degrees(tr, degrees), observables[:MAX_PANELS], size)
    path, tr = _path(tr), in_degrees(tr, degrees)
    is_wide = size * 25.4 >= MIN_BESIDE
    with rc_context(STYLE):
        figure = Figure(figsize=(size, (85 if is_wide else 165) / 25.4), layout="constrained")
        ratios: dict[str, Any] = {f"{'width' if is_wide else 'height'}_ratios": (1.35, 1)}
        left, right = figure.subfigures(1 + (not is_wide), 1 + is_wide, **ratios)
        _draw_time_series(left, tr)
        mean = path.mean(axis=0)
        mean /= np.linalg.norm(mean) or 1.0
        distance = float(np.linalg.norm(path - mean, axis=1).max())
        if AT_REST < distance < SMALL:
            sphere, plane = right.subplots(2, 1, height_ratios=(1.25, 1))
            _draw_enlarged(plane, path - mean, mean, system_of(tr).frame_axes)
        else:
            sphere = right.subplots()
        _draw_sphere(sphere, path, system_of(tr).frame_axes, view)
        if distance <= AT_REST:
            sphere.set_title(f"third axis at rest within {max(distance, 1e-16):.0e} rad")
        colour = COLOURS["regular_precession"]
        handles = [
            Line2D([], [], color=colour),
            Line2D([], [], color=colour, alpha=FAR_OPACITY),
            Line2D([], [], **START_MARKER),
        ]
        right.legend(
            handles, ["third axis, near side", "far side", "start"], loc="outside lower center", ncols=3,
            frameon=False, handlelength=1.6, columnspacing=1.2,
        )  # fmt: skip
    return figure


def _path(tr: xr.Dataset) -> np.ndarray:
    """Return the third body axis in the frame, (times, 3), or raise BadInput unless `tr` is the trajectory of a body."""
    missing = [
        n for n in ("theta", "psi", "phi", *PLOTTED_RATES, "axis_x", "axis_y", "axis_z") if n not in tr
    ]
    if missing or "time" not in tr.dims:
        raise BadInput(f"not a trajectory: {missing[0] if missing else 'time'} is missing")
    return np.stack([tr[f"axis_{name}"].values for name in "xyz"], -1)


class Film(FuncAnimation):
    """Animation that notebooks show with buttons."""

    def _repr_html_(self) -> str:
        with rc_context(STYLE | {"savefig.dpi": FILM_DPI}):
            return str(self.to_jshtml())


def animate(tr: xr.Dataset, path: str | Path | None, seconds: float, view: View = VIEW) -> Film | None:
    """Return an animation of the third body axis and its trace, or write the animation to `path`. See `Atlas.animate`."""
    axis, names, time = _path(tr), system_of(tr).frame_axes, tr["time"].values
    unit, side = unit_text(attribute_text(tr["time"].attrs, "units", "s")), WIDTHS["column"] / 25.4
    count = int(max(2, min(positive("seconds", seconds) * FRAMES_PER_SECOND, len(axis))))
    suffix = "" if path is None else (path := writable(path, (*ANIMATIONS,), force=True)).suffix.lower()
    if path is not None and not ANIMATIONS[suffix].isAvailable():
        raise BadInput(f"{path}: needs the program ffmpeg, which is not on the path; a .gif needs nothing")

    def draw(k: int) -> None:
        ax.clear()
        _draw_sphere(ax, axis[: k + 1], names, view, pointer=True)
        ax.set_title(f"{time[k]:.4g} {unit}")

    with rc_context(STYLE):
        figure = Figure(figsize=(side, side))
        ax = figure.add_axes((0.0, 0.0, 1.0, 0.93))
        frames = np.linspace(0, len(axis) - 1, count).astype(int)
        film = Film(figure, draw, frames=frames, interval=1000 * seconds / count, cache_frame_data=False)
        if path is None:
            return film
        with TemporaryDirectory() as folder, atomic_write(Path(path)) as temporary:
            whole = Path(folder) / f"film{suffix}"  # Matplotlib needs the suffix
            film.save(whole, ANIMATIONS[suffix](fps=count / seconds), dpi=FILM_DPI)
            temporary.write_bytes(whole.read_bytes())
    return None


def _figure_of_observables(tr: xr.Dataset, observables: Sequence[Observable], width: float) -> Figure:
    """Draw a panel over time for each observable."""
    panels = {}
    for observable in observables:
        if observable.name not in tr:
            raise BadInput(f"not a trajectory: {observable.name} is missing")
        name, unit = observable.name, unit_text(attribute_text(tr[observable.name].attrs, "units"))
        panels[f"{observable.symbol or name}{f' ({unit})' if unit else ''}"] = {name: tr[name].values}
    with rc_context(STYLE):
        figure = Figure(figsize=(width, (14 + 26 * len(observables)) / 25.4), layout="constrained")
        _draw_over_time(figure, tr, panels)
    return figure


def _draw_over_time(
    figure: Figure | SubFigure, tr: xr.Dataset, panels: Mapping[str, Mapping[str, np.ndarray]]
) -> list[Axes]:
    """Draw panels one below the other. `panels` maps a label to curves, and the name of a curve to values over time."""
    axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
    time = tr["time"]
    for ax, (label, curves) in zip(axes, panels.items(), strict=True):
        for (name, values), style in zip(curves.items(), LINES, strict=False):
            ax.plot(time.values, values, label=SYMBOLS.get(name), **style)
        ax.set_ylabel(label)
        ax.yaxis.set_major_formatter(_Formatter(useMathText=True))
        ax.ticklabel_format(axis="y", scilimits=(-2, 4))
        ax.tick_params(length=2.5)
        if len(curves) > 1:
            ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.6)
    axes[-1].set_xlabel(f"time ({unit_text(attribute_text(time.attrs, 'units', 's'))})")
    axes[-1].set_xlim(time.values[0], time.values[-1])
    figure.align_ylabels()
    return axes


def _draw_time_series(figure: SubFigure, tr: xr.Dataset) -> None:
    """Draw theta, the other angles and the rates in three panels."""
    unit = unit_text(attribute_text(tr["theta"].attrs, "units"))
    half = np.pi if unit == "rad" else 180.0
    angles = {name: (tr[name].values + half) % (2 * half) - half for name in ("psi", "phi")}
    for angle in angles.values():
        angle[1:][np.abs(np.diff(angle)) > half] = np.nan  # no line is drawn across a jump
    rates = {name: tr[name].values for name in PLOTTED_RATES}
    panels = {rf"$\theta$ ({unit})": {"theta": tr["theta"].values}, rf"$\psi$, $\varphi$ ({unit})": angles}
    _, angle_ax, rate_ax = _draw_over_time(figure, tr, panels | {"rates (rad s$^{-1}$)": rates})
    angle_ax.set_ylim(-half, half)
    texts = [r"$-\pi$", "0", r"$\pi$"] if unit == "rad" else [r"$-180$", "0", "180"]
    angle_ax.set_yticks([-half, 0, half], texts)
    magnitude = np.abs(list(rates.values()))
    quantile = float(np.nanquantile(magnitude, 0.9))
    if np.nanmax(magnitude) > CLIP_ABOVE * quantile > 0:
        rate_ax.set_ylim(-CLIP_AT * quantile, CLIP_AT * quantile)
        text = f"clipped at $\\pm${CLIP_AT * quantile:.2g}; largest magnitude {np.nanmax(magnitude):.2g}"
        rate_ax.set_title(text, loc="right", fontsize=6.5, pad=2)
    figure.supxlabel(NOTE, fontsize=6.5)


class _Formatter(ScalarFormatter):
    """Formatter of tick labels with powers of ten, but with offsets such as 0.9 instead of 9 x 10^-1."""

    def format_data(self, value: float) -> str:
        """Return the text of the offset of an axis, without a power of ten if the offset is of moderate size."""
        plain = 1e-3 <= abs(value) < 1e5
        return f"{value:.9g}".replace("-", "\N{MINUS SIGN}") if plain else str(super().format_data(value))


def _draw_enlarged(ax: Axes, offset: np.ndarray, direction: np.ndarray, names: Sequence[str]) -> None:
    """Draw the offset of a path from `direction`, projected onto the plane perpendicular to `direction`."""
    sine = np.hypot(direction[0], direction[1])
    if sine < SMALL:
        first, second, labels = np.eye(3)[0], np.eye(3)[1], [f"along {name}" for name in names[:2]]
    else:
        first = np.array([-direction[1], direction[0], 0.0]) / sine
        second = np.cross(direction, first)
        labels = ["sideways", "downward" if names[2].startswith("down") else "upward"]
    x, y = offset @ first, offset @ second
    half = 0.6 * max(np.ptp(x), np.ptp(y))
    exponent = int(np.floor(np.log10(half)))
    x, y, half = x / 10.0**exponent, y / 10.0**exponent, half / 10.0**exponent
    ax.plot(x, y, color=COLOURS["regular_precession"], linewidth=0.9)
    ax.plot(x[0], y[0], **START_MARKER)
    middle = [0.5 * (v.min() + v.max()) for v in (x, y)]
    ax.set(box_aspect=1, title="offset from the mean direction")
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.tick_params(length=2.5)
    for axis, label in zip((ax.xaxis, ax.yaxis), labels, strict=True):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_label_text(rf"{label} ($10^{{{exponent}}}$ rad)")


class Sphere:
    """Orthographic picture of the unit sphere with named axes. A third axis whose name begins with "down" points down."""

    def __init__(self, ax: Axes, names: Sequence[str], view: View = VIEW):
        try:
            azimuth, elevation = np.radians(np.array(view, np.float64))
        except (TypeError, ValueError):
            azimuth = elevation = np.nan
        if not (np.isfinite(azimuth) and abs(elevation) <= np.pi / 2):
            raise BadInput(f"view = {shown(view)}: must be azimuth and elevation in degrees, from -90 to 90")
        # If the third axis points down, components get these signs by half a turn about the first axis.
        self.upright = np.array([1.0, -1.0, -1.0] if names[2].startswith("down") else [1.0, 1.0, 1.0])
        horizontal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        self.ax, self.toward_viewer = ax, np.cos(elevation) * horizontal + [0.0, 0.0, np.sin(elevation)]
        self.right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        angle = np.linspace(0, 2 * np.pi, 181)
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
        ax.plot(*circle[:, :2].T, color="0.3", linewidth=0.8)
        for latitude in np.radians((-60, -30, 0, 30, 60)):
            parallel = circle * np.cos(latitude) + [0, 0, np.sin(latitude)]
            self.draw(parallel * self.upright, 1, color="0.7", linewidth=0.6 if latitude == 0 else 0.3)
        for direction, name in zip(np.eye(3), names, strict=True):
            tip = self.project(direction)
            outside = tip / max(np.linalg.norm(tip), 1e-9)  # the label is outside the disc, where no path is
            ax.plot(*np.transpose([tip, 1.1 * outside]), color="0.3", linewidth=0.8, zorder=2)
            x, y = 1.14 * outside
            side = "center" if abs(x) < 0.3 else "left" if x > 0 else "right"
            ax.text(x, y, name, ha=side, va="center" if abs(x) > 0.3 else "bottom" if y > 0 else "top")
        low, high = (-1.35, 1.1) if self.upright[2] < 0 else (-1.1, 1.35)
        ax.set(aspect="equal", xlim=(-1.5, 1.5), ylim=(low, high))
        ax.set_axis_off()

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3) onto the page, (..., 2)."""
        points = points * self.upright
        return np.stack([points @ self.right, points @ np.cross(self.toward_viewer, self.right)], -1)

    def draw(self, points: np.ndarray, zorder: int, **style: Any) -> None:
        """Draw the far part of a line on the sphere pale, and draw the near part over the far part."""
        near = points * self.upright @ self.toward_viewer >= 0
        for visible, alpha, level in ((~near, FAR_OPACITY, zorder), (near, 1.0, zorder + 1)):
            line = self.project(points)
            line[~visible] = np.nan
            self.ax.plot(*line.T, alpha=alpha, zorder=level, **style)


def _draw_sphere(
    ax: Axes, path: np.ndarray, names: Sequence[str], view: View, *, pointer: bool = False
) -> None:
    """Draw a path (times, 3) on the unit sphere and, if `pointer` is true, a pointer from the centre to the end of the path."""
    sphere = Sphere(ax, names, view)
    sphere.draw(path, 3, color=COLOURS["regular_precession"], linewidth=1.1)
    ax.plot(*sphere.project(path[0]), zorder=6, **START_MARKER)
    if pointer:
        sphere.draw(np.outer([1e-9, 1.0], path[-1]), 5, color="black", linewidth=2.0)
