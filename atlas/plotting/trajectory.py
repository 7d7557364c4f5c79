"""Figures of trajectories."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from ..analysis.metadata import system_of
from ..errors import BadInput
from .style import COLOURS, STYLE, SYMBOLS, WIDTHS, Width, check_width
from .text import unit_text

RATES = ("theta_dot", "psi_dot", "phi_dot", "normal_rate")
LINE_COLOURS = (COLOURS["regular_precession"], COLOURS["drifting"], "black", "#7fb9d8")
# Rates larger than this many times their quantile 0.9 do not set the range of the panel, which then ends
# at a smaller multiple of it.
CLIP_ABOVE, CLIP_AT = 10, 3


def trajectory_figure(tr: xr.Dataset, *, width: Width = "page") -> Figure:
    """Angles and rates over time, and the path of the third body axis on the unit sphere of the frame.

    psi and phi are shown between -pi and pi. The path is dark on the near side of the sphere and pale on
    the far side, with a dot at its start. Rates that grow without bound near the vertical are clipped.

    Parameters
    ----------
    tr : Dataset
        As `atlas.trajectory` returns it.
    width : {"page", "column"}, optional
        180 mm or 88 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels over time, and the sphere.

    Raises
    ------
    BadInput
        If the dataset is no trajectory.
    """
    check_width(width)
    missing = [n for n in ("theta", "psi", "phi", *RATES, "axis_x", "axis_y", "axis_z") if n not in tr]
    if missing or "time" not in tr.dims:
        raise BadInput(f"not a trajectory: {missing[0] if missing else 'time'} is missing")
    page = width == "page"
    height = 85.0 if page else 165.0
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTHS[width] / 25.4, height / 25.4), layout="constrained")
        if page:
            subfigures = figure.subfigures(1, 2, width_ratios=(1.35, 1), squeeze=False)
        else:
            subfigures = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)
        left, right = subfigures.ravel()
        _draw_time_series(left, tr)
        path = np.stack([tr[f"axis_{name}"].values for name in "xyz"], -1)
        _draw_sphere(right.subplots(), path, system_of(tr).frame_axes)
    return figure


def _draw_time_series(figure: SubFigure, tr: xr.Dataset) -> None:
    """Draw theta, the other angles and the rates in three panels."""
    time = tr["time"].values
    theta_ax, angle_ax, rate_ax = figure.subplots(3, 1, sharex=True)
    theta_ax.plot(time, tr["theta"].values, color=LINE_COLOURS[0])
    theta_ax.set_ylabel(r"$\theta$ (rad)")
    for name, colour, dashes in zip(("psi", "phi"), LINE_COLOURS, ("-", "--"), strict=False):
        angle = _wrap_angle(tr[name].values)
        angle_ax.plot(time, angle, color=colour, linestyle=dashes, label=SYMBOLS[name])
    angle_ax.set_ylim(-np.pi, np.pi)
    angle_ax.set_yticks([-np.pi, 0, np.pi], [r"$-\pi$", "0", r"$\pi$"])
    angle_ax.set_ylabel(r"$\psi$, $\varphi$ (rad)")
    for name, colour, dashes in zip(RATES, LINE_COLOURS, ("-", "--", ":", "-."), strict=True):
        rate_ax.plot(time, tr[name].values, color=colour, linestyle=dashes, label=SYMBOLS[name])
    rate_ax.set_ylabel("rates (rad s$^{-1}$)")
    rate_ax.set_xlabel(f"time ({unit_text(str(tr['time'].attrs.get('units', 's')))})")
    rate_ax.set_xlim(time[0], time[-1])
    magnitude = np.abs(np.concatenate([tr[name].values for name in RATES]))
    quantile = float(np.nanquantile(magnitude, 0.9))
    if np.nanmax(magnitude) > CLIP_ABOVE * quantile > 0:
        rate_ax.set_ylim(-CLIP_AT * quantile, CLIP_AT * quantile)
    for ax in (angle_ax, rate_ax):
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.6)
    figure.align_ylabels()


def _wrap_angle(angle: np.ndarray) -> np.ndarray:
    """Angle between -pi and pi, with nan where it jumps so that no line is drawn there."""
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    wrapped[1:][np.abs(np.diff(wrapped)) > np.pi] = np.nan
    return wrapped


def _draw_sphere(ax: Axes, path: np.ndarray, names: Iterable[str]) -> None:
    """Orthographic picture of a path on the unit sphere, shape (times, 3), seen from above the x-y plane."""
    azimuth, elevation = np.radians(40.0), np.radians(25.0)
    toward_viewer = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(toward_viewer, right)

    def project(points: np.ndarray) -> np.ndarray:
        return np.stack([points @ right, points @ up], -1)

    def draw(points: np.ndarray, colour: str, linewidth: float, zorder: int) -> None:
        """Draw the far part of a line pale and its near part over it."""
        near = points @ toward_viewer >= 0
        for visible, alpha, level in ((~near, 0.35, zorder), (near, 1.0, zorder + 1)):
            line = project(points)
            line[~visible] = np.nan
            ax.plot(*line.T, color=colour, alpha=alpha, linewidth=linewidth, zorder=level)

    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    ax.plot(*circle[:, :2].T, color="0.3", linewidth=0.8)
    for latitude in np.radians((-60, -30, 0, 30, 60)):
        parallel = circle * np.cos(latitude) + [0, 0, np.sin(latitude)]
        draw(parallel, "0.7", 0.6 if latitude == 0 else 0.3, 1)
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8}
    for direction, name in zip(np.eye(3), names, strict=True):
        tip = project(direction)
        ax.plot(*np.transpose([tip, 1.2 * tip]), color="0.3", linewidth=0.8, zorder=2)
        ax.text(1.35 * tip[0], 1.35 * tip[1], name, ha="center", va="center", zorder=5, bbox=box)
    draw(path, COLOURS["regular_precession"], 1.1, 3)
    ax.plot(*project(path[0]), "o", color=COLOURS["drifting"], markersize=3.5, zorder=6)
    ax.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.15, 1.35))
    ax.set_axis_off()
