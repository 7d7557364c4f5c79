"""Figures of trajectories."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..analysis.select import system_of
from ..errors import BadInput
from .style import COLOURS, STYLE, SYMBOLS, WIDTHS, Width, unit_text

RATES = ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
FRAME_AXES = {"orbital": ("radius", "velocity", "normal"), "space": ("$x$", "$y$", "vertical")}


# Trajectories.


def trajectory_figure(tr: xr.Dataset, *, width: Width = "page") -> Figure:
    """Angles and rates over time, and the path of the third body axis on the unit sphere of the frame.

    tr: as `atlas.trajectory` returns it. psi and phi are shown between -pi and pi; the path is dark on
    the near side of the sphere and pale on the far side, with a dot at its start. Where a passage near
    the vertical makes rates more than ten times their 90 % quantile, the panel ends at three times that.
    """
    if width not in WIDTHS:
        raise BadInput(f"width = {width!r}: allowed: {', '.join(WIDTHS)}")
    missing = [n for n in ("theta", "psi", "phi", *RATES, "axis_x", "axis_y", "axis_z") if n not in tr]
    if missing or "time" not in tr.dims:
        raise BadInput(f"not a trajectory: {missing[0] if missing else 'time'} is missing")
    time = tr["time"].values
    colours = [COLOURS["regular_precession"], COLOURS["drifting"], "black", "#7fb9d8"]
    with rc_context(STYLE):
        wide = WIDTHS[width]
        page = width == "page"
        size = (wide, 85.0) if page else (wide, 165.0)
        figure = Figure(figsize=(size[0] / 25.4, size[1] / 25.4), layout="constrained")
        if page:
            parts = figure.subfigures(1, 2, width_ratios=(1.35, 1), squeeze=False)
        else:
            parts = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)
        left, right = parts.ravel()
        tilt, turn, rate = left.subplots(3, 1, sharex=True)
        tilt.plot(time, tr["theta"].values, color=colours[0])
        tilt.set_ylabel(r"$\theta$ (rad)")
        for name, colour, dashes in (("psi", colours[0], "-"), ("phi", colours[1], "--")):
            turn.plot(time, _wrap_angle(tr[name].values), color=colour, linestyle=dashes, label=SYMBOLS[name])
        turn.set_ylim(-np.pi, np.pi)
        turn.set_yticks([-np.pi, 0, np.pi], [r"$-\pi$", "0", r"$\pi$"])
        turn.set_ylabel(r"$\psi$, $\varphi$ (rad)")
        for name, colour, dashes in zip(RATES, colours, ("-", "--", ":", "-."), strict=True):
            rate.plot(time, tr[name].values, color=colour, linestyle=dashes, label=SYMBOLS[name])
        rate.set_ylabel("rates (rad s$^{-1}$)")
        rate.set_xlabel(f"time ({unit_text(str(tr['time'].attrs.get('units', 's')))})")
        rate.set_xlim(time[0], time[-1])
        magnitude = np.abs(np.concatenate([tr[name].values for name in RATES]))
        usual = float(np.nanquantile(magnitude, 0.9))
        if np.nanmax(magnitude) > 10 * usual > 0:
            rate.set_ylim(-3 * usual, 3 * usual)
        for ax in (turn, rate):
            ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.6)
        left.align_ylabels()
        names = FRAME_AXES[system_of(tr).frame]
        _sphere(right.subplots(), np.stack([tr[f"axis_{n}"].values for n in "xyz"], -1), names)
    return figure


def _wrap_angle(angle: np.ndarray) -> np.ndarray:
    """Angle between -pi and pi, with nan where it jumps so that no line is drawn there."""
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    wrapped[1:][np.abs(np.diff(wrapped)) > np.pi] = np.nan
    return wrapped


def _sphere(ax: Axes, path: np.ndarray, names: Iterable[str]) -> None:
    """Orthographic picture of a path on the unit sphere, shape (times, 3), seen from above the x-y plane."""
    turn, lift = np.radians(40.0), np.radians(25.0)
    toward = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.cross(toward, right)

    def draw(points: np.ndarray, colour: str, thickness: float, order: int) -> None:
        for near, shade, level in ((False, 0.35, order), (True, 1.0, order + 1)):
            hidden = (points @ toward >= 0) != near
            flat = np.stack([points @ right, points @ up], -1)
            flat[hidden] = np.nan
            ax.plot(flat[:, 0], flat[:, 1], color=colour, alpha=shade, linewidth=thickness, zorder=level)

    around = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], -1)
    ax.plot(circle[:, 0], circle[:, 1], color="0.3", linewidth=0.8)
    for latitude in np.radians((-60, -30, 0, 30, 60)):
        draw(circle * np.cos(latitude) + [0, 0, np.sin(latitude)], "0.7", 0.6 if latitude == 0 else 0.3, 1)
    for direction, name in zip(np.eye(3), names, strict=True):
        tip = np.array([direction @ right, direction @ up])
        ax.plot(*np.transpose([tip, 1.2 * tip]), color="0.3", linewidth=0.8, zorder=2)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8}
        ax.text(1.35 * tip[0], 1.35 * tip[1], name, ha="center", va="center", zorder=5, bbox=box)
    draw(path, COLOURS["regular_precession"], 1.1, 3)
    ax.plot(path[0] @ right, path[0] @ up, "o", color=COLOURS["drifting"], markersize=3.5, zorder=6)
    ax.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.15, 1.35))
    ax.set_axis_off()
