"""Draw the axes that the three labels are about.

python scripts/tools/draw_labels.py [-o docs/labels.svg]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from draw_angles import ANGLE, BODY, DOCS, FRAME, PALE, View, X, Y, Z
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from atlas.plotting.style import STYLE


def direction(tilt: float, azimuth: float) -> np.ndarray:
    """Unit vector at angles from Z and, about it, from X, in degrees."""
    t, a = np.radians([tilt, azimuth])
    return np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])


def turned(view: View, axis: np.ndarray, start: np.ndarray, to: float, text: str, offset: tuple) -> None:
    """Draw an arrow along the circle through `start` about an axis, by an angle in degrees, with a text."""
    centre = (start @ axis) * axis
    first = start - centre
    t = np.linspace(0.0, np.radians(to), 60)[:, None]
    points = centre + np.cos(t) * first + np.sin(t) * np.cross(axis, first)
    view.line(points[:-3], ANGLE, linewidth=1.1)
    view.arrow(points[-6], points[-1], ANGLE, 1.1)
    view.text(points[30], text, ANGLE, offset)


def circle(view: View, axis: np.ndarray, start: np.ndarray, colour: str) -> None:
    """Draw the circle through `start` about an axis."""
    centre = (start @ axis) * axis
    first = start - centre
    t = np.linspace(0.0, 2 * np.pi, 181)[:, None]
    view.line(centre + np.cos(t) * first + np.sin(t) * np.cross(axis, first), colour, linewidth=0.8)


def draw_third_axis(axes: Axes, inertial: bool) -> None:
    """The third axis about the vertical, in a frame that is at rest or turns."""
    view = View(axes, azimuth=22.0, elevation=22.0, centre=(0.0, 0.42), half=1.12)
    e3 = direction(38.0, 80.0)
    view.disc(X, Y, PALE)
    view.arrow(0 * Z, 1.35 * Z, FRAME, 1.4)
    view.text(1.35 * Z, r"vertical $\gamma$", FRAME, (0, 8))
    view.arrow(0 * Z, 1.35 * e3, BODY, 1.8)
    view.text(1.35 * e3, "third axis $e_3$", BODY, (22, 9))
    circle(view, Z, 1.0 * e3, PALE)
    turned(view, Z, direction(38.0, 185.0), 85.0, r"$n + \Omega$" if inertial else "$n$", (-12, 7))
    turned(view, e3, 0.72 * e3 + 0.16 * X, 300.0, "$m$", (11, -6))
    view.text(
        view.arc(Z, (e3 - e3[2] * Z) / np.linalg.norm(e3[:2]), np.radians(38.0), 0.55),
        r"$\theta$",
        ANGLE,
        (1, 8),
    )
    if inertial:
        turned(view, Z, 1.0 * X, 60.0, r"$\Omega$", (0, -9))
        axes.set_title("label_inertial: the same axes,\nseen from inertial space")
    else:
        axes.set_title("label: third axis of the body\nand vertical of the frame")


def draw_any_axis(axes: Axes) -> None:
    """An axis s at rest in the body, an axis z at rest in the frame, and the circle of the angular velocity."""
    view = View(axes, azimuth=22.0, elevation=22.0, centre=(0.0, 0.42), half=1.12)
    z, s, e3 = direction(34.0, -68.0), direction(52.0, 112.0), direction(25.0, 75.0)
    n, m = 0.62, 0.62
    omega = n * z + m * s
    view.disc(X, Y, PALE)
    view.arrow(0 * Z, 0.85 * Z, PALE)
    view.text(0.85 * Z, r"$\gamma$", PALE, (-8, 0))
    view.arrow(0 * Z, 1.2 * e3, PALE)
    view.text(1.2 * e3, "$e_3$", PALE, (7, 5))
    view.arrow(0 * Z, 1.35 * z, FRAME, 1.4)
    view.text(1.35 * z, "$z$, at rest\nin the frame", FRAME, (-12, 12))
    view.arrow(0 * Z, 1.3 * s, BODY, 1.8)
    view.text(1.3 * s, "$s$, at rest\nin the body", BODY, (8, 13))
    circle(view, s, omega, BODY)
    view.arrow(0 * Z, omega, ANGLE, 1.4)
    view.text(omega, r"$\omega = n z + m s$", ANGLE, (-14, 9))
    view.line(np.stack([n * z, omega]), ANGLE, linewidth=0.7, linestyle=(0, (3, 3)))
    view.line(np.stack([m * s, omega]), ANGLE, linewidth=0.7, linestyle=(0, (3, 3)))
    axes.set_title("label_any_axis: any axes; in the body\n$\\omega$ runs along a circle about $s$")


def drawing() -> Figure:
    """The three panels."""
    with rc_context({**STYLE, "axes.titlesize": 8}):
        figure = Figure(figsize=(7.6, 2.9), layout="constrained", facecolor="white")
        first, second, third = figure.subplots(1, 3)
        draw_third_axis(first, False)
        draw_third_axis(second, True)
        draw_any_axis(third)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=DOCS / "labels.svg")
    out = parser.parse_args().out
    with rc_context(STYLE):
        drawing().savefig(out, dpi=200, metadata={"Date": None} if out.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
