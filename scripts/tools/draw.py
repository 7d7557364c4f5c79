"""Draw the angles of the glossary, docs/angles.svg, the axes of the labels, docs/labels.svg, and the steps of theory, docs/theory.svg.

python scripts/tools/draw.py [--out docs]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from atlas.plotting.style import COLOURS, STYLE
from atlas.systems.satellite.initial import directions

DOCS = Path(__file__).parents[2] / "docs"
FRAME, BODY, ANGLE, PALE = "#262626", COLOURS["regular_precession"], "#b35806", "#9a9a9a"
PSI, THETA, PHI = np.radians([52.0, 42.0, 48.0])  # angles of the drawn body, rad
X, Y, Z = np.eye(3)


class View:
    """A drawing of points in space on the plane of an Axes, seen from far away without perspective."""

    def __init__(
        self, axes: Axes, azimuth: float, elevation: float, centre: tuple[float, float], half: float
    ) -> None:
        a, e = np.radians([azimuth, elevation])
        self.axes = axes
        self.right = np.array([-np.sin(a), np.cos(a), 0.0])
        self.up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
        axes.set_aspect("equal")
        axes.set_xlim(centre[0] - half, centre[0] + half)
        axes.set_ylim(centre[1] - half, centre[1] + half)
        axes.axis("off")

    def flat(self, points: np.ndarray) -> np.ndarray:
        """Coordinates on the page of points of shape (..., 3)."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)

    def line(self, points: np.ndarray, colour: str, **style: object) -> None:
        """Draw a line through points in space."""
        self.axes.plot(*self.flat(points).T, color=colour, solid_capstyle="round", **style)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: str, width: float = 1.0) -> None:
        """Draw an arrow between two points in space."""
        style = {"arrowstyle": "-|>,head_length=0.45,head_width=0.18", "color": colour, "linewidth": width}
        style |= {"shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", self.flat(end), self.flat(start), arrowprops=style, annotation_clip=False)

    def text(self, point: np.ndarray, text: str, colour: str, offset: tuple[float, float]) -> None:
        """Write text at a point in space, moved by an offset in pt."""
        style = {"color": colour, "ha": "center", "va": "center", "annotation_clip": False}
        self.axes.annotate(text, self.flat(point), offset, textcoords="offset points", **style)

    def arc(self, first: np.ndarray, second: np.ndarray, to: float, radius: float) -> np.ndarray:
        """Draw an arrow along an arc from `first` by the angle `to` towards `second`; returns its middle."""
        t = np.linspace(0.0, to, 60)[:, None]
        points = radius * (np.cos(t) * first + np.sin(t) * second)
        self.line(points[:-3], ANGLE, linewidth=1.1)
        self.arrow(points[-6], points[-1], ANGLE, 1.1)
        return points[len(points) // 2]

    def disc(self, first: np.ndarray, second: np.ndarray, colour: str, radius: float = 1.0) -> None:
        """Draw the disc that two unit vectors span, shaded."""
        t = np.linspace(0.0, 2 * np.pi, 181)[:, None]
        edge = radius * (np.cos(t) * first + np.sin(t) * second)
        self.axes.add_patch(Polygon(self.flat(edge), facecolor=colour, alpha=0.12, edgecolor="none"))
        self.line(edge, colour, linewidth=0.6, alpha=0.6)


def body_axes(theta: float, psi: float, phi: float) -> np.ndarray:
    """Unit vectors of the body axes in the frame, one in each row, from the package's own convention."""
    alpha, gamma = directions({"theta0": np.array(theta), "psi0": np.array(psi), "phi0": np.array(phi)})
    return np.stack([alpha, np.cross(gamma, alpha), gamma], axis=1)


def draw_angles(axes: Axes) -> None:
    """The frame, the body axes and the three angles."""
    view = View(axes, azimuth=22.0, elevation=22.0, centre=(0.0, 0.25), half=1.35)
    e1, _, e3 = body_axes(THETA, PSI, PHI)
    node = body_axes(0.0, PSI, 0.0)[0]
    across = np.cross(e3, node)
    view.disc(X, Y, PALE)
    view.disc(node, across, BODY)
    for axis, text, offset in ((X, "$x$", (-6, -4)), (Y, "$y$", (8, 0))):
        view.arrow(0 * Z, 1.35 * axis, FRAME)
        view.text(1.35 * axis, text, FRAME, offset)
    view.arrow(0 * Z, 1.35 * Z, FRAME, 1.4)
    view.text(1.35 * Z, r"$\gamma$, the vertical", FRAME, (0, 8))
    view.line(np.stack([-1.05 * node, 1.25 * node]), FRAME, linewidth=0.8, linestyle=(0, (4, 3)))
    view.text(1.25 * node, "line of\nnodes", FRAME, (2, -11))
    view.arrow(0 * Z, 1.4 * e3, BODY, 1.8)
    view.text(1.4 * e3, "third axis $e_3$", BODY, (6, 8))
    view.arrow(0 * Z, 1.25 * e1, BODY)
    view.text(1.25 * e1, "$e_1$", BODY, (9, 2))
    view.text(view.arc(X, Y, PSI, 0.62), r"$\psi$", ANGLE, (0, -8))
    view.text(view.arc(Z, (e3 - e3[2] * Z) / np.sin(THETA), THETA, 0.75), r"$\theta$", ANGLE, (2, 8))
    view.text(view.arc(node, across, PHI, 0.8), r"$\varphi$", ANGLE, (10, 7))
    axes.set_title("the angles and their rates:\n" r"$\psi' = n$ about $\gamma$, $\varphi' = m$ about $e_3$")


def draw_orbit(axes: Axes) -> None:
    """The orbital frame of the satellite at two places of its orbit."""
    view = View(axes, azimuth=-60.0, elevation=28.0, centre=(0.2, 0.1), half=1.45)
    t = np.linspace(0.0, 2 * np.pi, 181)[:, None]
    view.line(np.cos(t) * X + np.sin(t) * Y, PALE, linewidth=0.8)
    axes.add_patch(Circle((0, 0), 0.16, facecolor="#dce9f2", edgecolor=FRAME, linewidth=0.8))
    view.text(0 * Z, "Earth", FRAME, (0, -17))
    names = ((r"$\alpha$, radius", (18, -7)), (r"$\beta$, velocity", (22, 5)), (r"$\gamma$, normal", (0, 7)))
    for place, labelled in ((np.radians(-10.0), True), (np.radians(128.0), False)):
        radius = np.cos(place) * X + np.sin(place) * Y
        for axis, (text, offset) in zip((radius, np.cross(Z, radius), Z), names, strict=True):
            view.arrow(radius, radius + 0.55 * axis, FRAME, 1.1)
            if labelled:
                view.text(radius + 0.55 * axis, text, FRAME, offset)
        axes.plot(*view.flat(radius), "o", color=BODY, markersize=4.5)
    middle = view.arc(X, Y, np.radians(95.0), 0.5)
    view.text(middle, r"$\Omega$", ANGLE, (8, -3))
    axes.set_title("satellite: the orbital frame\nturns with the orbit")


def draw_top(axes: Axes) -> None:
    """A top about its fixed point, with the vertical towards the attracting centre."""
    view = View(axes, azimuth=-60.0, elevation=10.0, centre=(0.1, 0.2), half=1.35)
    tilt = np.radians(155.0)
    e3 = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    gamma = -Z  # gamma points down on the page; theta is measured from gamma
    axis = np.array([e3[0], 0.0, -e3[2]])
    first, second = np.cross(axis, Y), Y
    for height, radius in ((0.62, 0.40), (0.70, 0.40)):
        t = np.linspace(0.0, 2 * np.pi, 121)[:, None]
        rim = height * axis + radius * (np.cos(t) * first + np.sin(t) * second)
        axes.add_patch(Polygon(view.flat(rim), facecolor="#dce9f2", edgecolor=BODY, linewidth=0.8))
    view.line(np.stack([0 * Z, 0.62 * axis]), BODY, linewidth=1.8, zorder=0.5)
    view.arrow(0.70 * axis, 1.25 * axis, BODY, 1.8)
    view.text(1.25 * axis, "third axis $e_3$", BODY, (6, 8))
    view.arrow(0 * Z, 0.8 * gamma, FRAME, 1.4)
    view.text(0.8 * gamma, r"$\gamma$, towards the" "\nattracting centre", FRAME, (0, -12))
    axes.plot(0, 0, "o", color=FRAME, markersize=4)
    view.text(0 * Z, "fixed point", FRAME, (-30, 0))
    view.text(view.arc(gamma, X, tilt, 0.3), r"$\theta$", ANGLE, (9, -2))
    axes.set_title("gyrostat about a fixed point:\n" r"$\gamma$ points down")


def direction(tilt: float, azimuth: float) -> np.ndarray:
    """Unit vector at a tilt from Z and an azimuth about Z from X, in degrees."""
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


BOXES = {
    # name: (x, y, text, colour)
    "equations": (0.09, 0.5, "equations\nand start", FRAME),
    "steady": (0.31, 0.5, "steady motion?\nresidual of the\nequations along it", BODY),
    "drifting": (0.55, 0.08, "drifting", FRAME),
    "none": (0.55, 0.37, "no prediction", FRAME),
    "label": (0.55, 0.8, "label of the\nexact motion", BODY),
    "stable": (0.76, 0.66, "stable?\nexponents", BODY),
    "predicted": (0.93, 0.37, "predicted", ANGLE),
}
ARROWS = (
    # from, to, text, place of the text
    ("equations", "steady", "", (0.0, 0.0)),
    ("steady", "label", "exactly", (0.42, 0.72)),
    ("steady", "none", "nearly", (0.445, 0.46)),
    ("steady", "drifting", "far", (0.43, 0.22)),
    ("label", "stable", "nudged", (0.67, 0.78)),
    ("label", "predicted", "not nudged", (0.84, 0.86)),
    ("stable", "predicted", "yes: that label\nno: drifting", (0.775, 0.475)),
    ("none", "predicted", "not_computed", (0.7, 0.33)),
    ("drifting", "predicted", "", (0.0, 0.0)),
)


def draw_theory(axes: Axes) -> None:
    """The steps from the equations to the label that theory predicts."""
    axes.set_xlim(0.0, 1.02)
    axes.set_ylim(0.0, 1.0)
    axes.axis("off")
    boxes = {}
    for name, (x, y, text, colour) in BOXES.items():
        frame = {"boxstyle": "round,pad=0.45", "edgecolor": colour, "facecolor": "white", "linewidth": 1.1}
        boxes[name] = axes.text(
            x, y, text, ha="center", va="center", color=colour, bbox=frame, fontsize=7.5, zorder=3
        )
    for first, second, text, place in ARROWS:
        x, y, *_ = BOXES[first]
        to_x, to_y, *_ = BOXES[second]
        curve = "arc3,rad=-0.3" if (first, second) == ("label", "predicted") else "arc3,rad=0"
        style = {
            "arrowstyle": "-|>,head_length=0.45,head_width=0.18",
            "color": PALE,
            "connectionstyle": curve,
        }
        style |= {
            "patchA": boxes[first].get_bbox_patch(),
            "patchB": boxes[second].get_bbox_patch(),
            "shrinkB": 2,
        }
        axes.annotate("", (to_x, to_y), (x, y), arrowprops=style, zorder=2)
        axes.text(*place, text, ha="center", va="center", color=FRAME, fontsize=6.5, zorder=4)


def drawing(height: float, *panels: Callable[[Axes], None]) -> Figure:
    """A figure of panels side by side."""
    with rc_context({**STYLE, "axes.titlesize": 8}):
        figure = Figure(figsize=(7.6, height), layout="constrained", facecolor="white")
        for axes, draw in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            draw(axes)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS, help="folder (default: docs)")
    out = parser.parse_args().out
    figures = {
        "angles": drawing(3.0, draw_angles, draw_orbit, draw_top),
        "labels": drawing(
            2.9,
            partial(draw_third_axis, inertial=False),
            partial(draw_third_axis, inertial=True),
            draw_any_axis,
        ),
        "theory": drawing(2.3, draw_theory),
    }
    with rc_context(STYLE):
        for name, figure in figures.items():
            figure.savefig(out / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
