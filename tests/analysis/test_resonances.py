"""Resonance lines of the gravity-gradient diagram against the formulas of its frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from atlas.analysis import boundary
from atlas.analysis.plane import Plane
from atlas.scene.read import scene_from

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
    return boundary.resonances(plane)


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
