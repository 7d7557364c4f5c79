"""Resonance lines of the gravity-gradient diagram against the formulas of its frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from atlas.analysis import boundary
from atlas.analysis.plane import Plane
from atlas.scene.read import scene_from
from atlas.systems.base import derived_values

SCENE = {
    "schema": 1, "title": "gravity gradient", "system": "satellite", "fixed": {"B": 1.0},
    "axes": {"K1": {"from": -0.98, "to": 0.98, "count": 5}, "K3": {"from": -0.98, "to": 0.98, "count": 5}},
    "ties": {"A": "B * (1 - K1) / (1 - K3)", "C": "A + K1 * B"}, "family": {"name": "equilibrium", "solve": []},
    "integration": {"duration": 0.1},
}  # fmt: skip


def frequencies(k1, k3):
    """Pitch, and the two of roll and yaw: Hughes (1986), with B = 1; arrays (vertices, 3)."""
    A = (1 - k1) / (1 - k3)
    P, Q = 1 + 3 * k1 + k1 * k3, 4 * k1 * k3
    root = np.sqrt(np.maximum(P**2 - 4 * Q, 0))
    squares = np.stack([3 * (1 - A) / (A + k1), (P + root) / 2, (P - root) / 2], -1)
    return np.sqrt(squares)


@pytest.fixture(scope="module")
def lines():
    plane = Plane(scene_from(SCENE), {"K1": (-0.9, 0.9), "K3": (-0.9, 0.9)}, {})
    return boundary.resonance_lines(plane)


@pytest.mark.parametrize("ratio", boundary.RESONANCE_RATIOS)
def test_frequencies_on_the_lines_have_the_ratio(lines, ratio):
    vertices = np.concatenate(lines[f"resonance {ratio}:1"])
    # Near the limits of stability, where a frequency vanishes, one cell changes it by more than a few per cent.
    k1, k3 = vertices[(np.abs(vertices) > 0.07).all(1) & (np.abs(vertices[:, 0] - vertices[:, 1]) > 0.07)].T
    measured = frequencies(k1, k3)
    pairs = [(0, 1), (1, 0), (0, 2), (2, 0), (1, 2)]
    misses = np.abs(np.stack([measured[:, i] / (ratio * measured[:, j]) - 1 for i, j in pairs])).min(0)
    assert k1.size > 50
    assert np.median(misses) < 3e-4
    # Vertices are linear interpolations; a cell, 0.009 wide, changes frequencies near a limit of stability by per cents.
    assert misses.max() < 0.03


def test_the_line_1_to_1_is_where_pitch_crosses(lines):
    """Pitch is not coupled to roll and yaw, so that the frequencies cross inside Lagrange's triangle."""
    vertices = np.concatenate(lines["resonance 1:1"])
    triangle = vertices[(vertices[:, 0] > vertices[:, 1]) & (vertices[:, 1] > 0)]
    columns = np.linspace(0.4, 0.85, 10)
    for k1 in columns:
        k3 = np.linspace(0.05, k1 - 0.02, 2000)
        pitch, large, small = frequencies(np.full(2000, k1), k3).T
        (changes,) = np.nonzero(np.diff(np.sign((pitch - large) * (pitch - small))) != 0)
        distance = np.abs(triangle - [k1, k3[changes[0]]]).max(1).min()
        assert distance < 0.01


def test_lines_are_inside_the_stable_regions(lines):
    for kind in boundary.RESONANCES:
        k1, k3 = np.concatenate(lines[kind]).T
        assert ((k1 > k3 - 0.01) & (k1 * k3 > -0.01)).all()


# Lines of nonlinear stability.


def nonlinear_lines(monkeypatch, family, axes, ties, extent):
    """Lines on a plane of symmetric satellites, and a function of positions on it: derived variables."""
    monkeypatch.setattr(boundary, "RESONANCE_SAMPLES", 80)
    scene = SCENE | {
        "fixed": {"A": 1.0}, "ties": {"B": "A"} | ties, "family": {"name": family, "solve": list(axes[2:])},
        "axes": {name: {"from": low, "to": high, "count": 5} for name, (low, high) in zip(axes[:2], extent, strict=True)},
    }  # fmt: skip
    plane = Plane(scene_from(scene), dict(zip(axes[:2], extent, strict=True)), {})

    def values(vertices, *names):
        points = plane.points(dict(zip(axes[:2], np.transpose(vertices), strict=True)))
        return derived_values(plane.scene.system, names, points.base, points.duration, lambda: None)

    return boundary.resonance_lines(plane, nonlinear=True), values


def test_lines_of_the_cylindrical_motion_are_where_the_energy_does_not_decide(monkeypatch):
    lines, values = nonlinear_lines(
        monkeypatch, "cylindrical", ("C", "b"), {"m": "b / C - 1"}, ((0.1, 1.9), (-4.0, 2.0))
    )
    assert set(lines) == {"resonance 2:1", "resonance 3:1", boundary.DEGENERATE}
    for ratio in (2, 3):
        C, b = np.concatenate(lines[f"resonance {ratio}:1"]).T
        P, Q = b**2 - 2 * b + 3 * C - 1, (b - 1) * (b + 3 * C - 4)
        # f^4 - P f^2 + Q = 0 with two frequencies of this ratio; the lines are linear interpolations
        assert np.median(np.abs(P**2 / Q - (1 + ratio**2) ** 2 / ratio**2)) < 0.03
        assert ((b < 1) | (b + 3 * C < 4)).all()
    segments = np.concatenate(
        [np.stack([line[:-1], np.diff(line, axis=0)], 1) for line in lines[boundary.DEGENERATE]]
    )
    for C, b, distance in (
        (1.1, -2.67857617122667776, 0.005),
        (1.1, 0.456098125122197657, 0.005),
        (1.25, 0.196190976289975999, 0.03),  # beside the resonance 2:1, where the line has a gap of a sample
    ):
        start, along = segments[:, 0] - [C, b], segments[:, 1]
        nearest = np.clip(-(start * along).sum(1) / (along**2).sum(1), 0, 1)
        assert np.linalg.norm(start + nearest[:, np.newaxis] * along, axis=1).min() < distance
    vertices = np.concatenate(lines[boundary.DEGENERATE])
    signs = [
        np.sign(values(vertices + np.array(shift), "birkhoff_determinant")["birkhoff_determinant"])
        for shift in ((-0.004, 0.0), (0.004, 0.0), (0.0, -0.008), (0.0, 0.008))
    ]
    assert ((signs[0] != signs[1]) | (signs[2] != signs[3])).mean() > 0.95


def test_zeros_of_the_determinant_are_no_poles(monkeypatch):
    """Of a tilted satellite D changes its sign through infinity at the resonance 2:1."""
    lines, values = nonlinear_lines(
        monkeypatch, "perp_velocity", ("C", "theta0", "k3"), {"psi0": "pi / 2"}, ((1.35, 1.95), (0.1, 0.8))
    )
    (resonance,) = (line for line in lines["resonance 2:1"] if len(line) > 20)
    name = "birkhoff_determinant"
    beside = [values(resonance + np.array([0, shift]), name)[name] for shift in (-0.003, 0.003)]
    assert (np.sign(beside[0]) != np.sign(beside[1])).mean() > 0.9
    for line in lines.get(boundary.DEGENERATE, []):
        on, off = (np.abs(values(line + np.array([0, shift]), name)[name]) for shift in (0.0, 0.01))
        assert (on < 0.2 * off).mean() > 0.9
