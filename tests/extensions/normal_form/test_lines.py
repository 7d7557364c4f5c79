"""Lines of nonlinear stability of symmetric satellites: formulas of the resonances, verified zeros of the determinant."""

from __future__ import annotations

import numpy as np

from atlas.analysis.boundary import KINDS, RESONANCES
from atlas.analysis.plane import Plane
from atlas.extensions.normal_form import lines as module
from atlas.extensions.normal_form.lines import DETERMINANT_ZERO, nonlinear_lines
from atlas.plotting import cells
from atlas.scene.read import scene_from


def lines_and_values(monkeypatch, family, axes, ties, extent):
    """Lines on a plane of symmetric satellites, and a function of positions on it: derived variables."""
    monkeypatch.setattr(module, "RESONANCE_SAMPLES", 80)
    scene = {
        "schema": 1, "title": "nonlinear", "system": "satellite", "fixed": {"A": 1.0}, "ties": {"B": "A"} | ties,
        "axes": {name: {"from": low, "to": high, "count": 5} for name, (low, high) in zip(axes[:2], extent, strict=True)},
        "family": {"name": family, "solve": list(axes[2:])}, "integration": {"duration": 0.1},
    }  # fmt: skip
    plane = Plane(scene_from(scene), dict(zip(axes[:2], extent, strict=True)), {})

    def values(vertices, *names):
        return plane.derived(dict(zip(axes[:2], np.transpose(vertices), strict=True)), names)

    return nonlinear_lines(plane), values


def test_lines_of_the_cylindrical_motion_are_where_the_energy_does_not_decide(monkeypatch):
    lines, values = lines_and_values(
        monkeypatch, "cylindrical", ("C", "b"), {"m": "b / C - 1"}, ((0.1, 1.9), (-4.0, 2.0))
    )
    assert set(lines) == {"resonance 2:1", "resonance 3:1", DETERMINANT_ZERO}
    for ratio in (2, 3):
        C, b = np.concatenate(lines[f"resonance {ratio}:1"]).T
        P, Q = b**2 - 2 * b + 3 * C - 1, (b - 1) * (b + 3 * C - 4)
        # f^4 - P f^2 + Q = 0 with two frequencies of this ratio; the lines are linear interpolations
        assert np.median(np.abs(P**2 / Q - (1 + ratio**2) ** 2 / ratio**2)) < 0.03
        assert ((b < 1) | (b + 3 * C < 4)).all()
    segments = np.concatenate(
        [np.stack([line[:-1], np.diff(line, axis=0)], 1) for line in lines[DETERMINANT_ZERO]]
    )
    for C, b, distance in (
        (1.1, -2.67857617122667776, 0.005),
        (1.1, 0.456098125122197657, 0.005),
        (1.25, 0.196190976289975999, 0.03),  # beside the resonance 2:1, where the line has a gap of a sample
    ):
        start, along = segments[:, 0] - [C, b], segments[:, 1]
        nearest = np.clip(-(start * along).sum(1) / (along**2).sum(1), 0, 1)
        assert np.linalg.norm(start + nearest[:, np.newaxis] * along, axis=1).min() < distance
    vertices = np.concatenate(lines[DETERMINANT_ZERO])
    signs = [
        np.sign(values(vertices + np.array(shift), "birkhoff_determinant")["birkhoff_determinant"])
        for shift in ((-0.004, 0.0), (0.004, 0.0), (0.0, -0.008), (0.0, 0.008))
    ]
    assert ((signs[0] != signs[1]) | (signs[2] != signs[3])).mean() > 0.95


def test_zeros_of_the_determinant_are_no_poles(monkeypatch):
    """Of a tilted satellite D changes its sign through infinity at the resonance 2:1."""
    lines, values = lines_and_values(
        monkeypatch, "perp_velocity", ("C", "theta0", "k3"), {"psi0": "pi / 2"}, ((1.35, 1.95), (0.1, 0.8))
    )
    (resonance,) = (line for line in lines["resonance 2:1"] if len(line) > 20)
    name = "birkhoff_determinant"
    beside = [values(resonance + np.array([0, shift]), name)[name] for shift in (-0.003, 0.003)]
    assert (np.sign(beside[0]) != np.sign(beside[1])).mean() > 0.9
    for line in lines.get(DETERMINANT_ZERO, []):
        on, off = (np.abs(values(line + np.array([0, shift]), name)[name]) for shift in (0.0, 0.01))
        assert (on < 0.2 * off).mean() > 0.9


def test_the_zeros_have_a_colour_of_their_own():
    colours = [cells.border_style(kind)["color"] for kind in (*KINDS, *RESONANCES, DETERMINANT_ZERO)]
    assert colours.count(colours[-1]) == 1
