"""What the comments of the satellite's example scenes state, against linear theory derived here."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import atlas
from atlas.flags import Label
from atlas.scene.read import scene_from

pytestmark = pytest.mark.usefixtures("whole_kernels")

CONFIGS = Path(__file__).parents[2] / "configs"


def scene(name, axes, **nudge):
    """A scene of configs/ with other values of its axes."""
    table = tomllib.loads((CONFIGS / f"{name}.toml").read_text())
    for axis, values in axes.items():
        table["axes"][axis] = {"values": [float(value) for value in values]}
    table["nudge"] |= nudge
    return scene_from(table, name)


def linear(ratio, tilt):
    """Matrix of (x, y, x', y'), x = dtheta and y = sin(theta) dpsi, about the motion perpendicular to the velocity.

    From Routh's function of a symmetric body, A = Omega = 1, with the momentum P = C w3 + k3 of the spin:
    (theta'^2 + (psi' + 1)^2 sin^2 theta)/2 + P (psi' + 1) cos theta - 3 (C - 1) sin^2 theta sin^2 psi / 2.
    """
    gyroscopic = np.cos(tilt) * (3 * ratio - 2)
    xx, yy = np.sin(tilt) ** 2 * (4 - 3 * ratio), -3 * (ratio - 1)
    return np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-xx, 0, 0, gyroscopic], [0, -yy, -gyroscopic, 0]])


def growing_part(ratio, tilt, dpsi=1.0):
    """How much of the growing mode a displacement (1, dpsi) of theta and psi contains.

    The displacement of theta changes P, and so moves the steady motion by C / (4 - 3 C).
    """
    values, modes = np.linalg.eig(linear(ratio, tilt))
    row = np.linalg.inv(modes)[np.argmax(values.real)].real
    row = row / row[0]
    return float(row @ [1 - ratio / (4 - 3 * ratio), np.sin(tilt) * dpsi, 0, 0])


def test_growth_is_proportional_to_the_tilt():
    tilts = [0.05, 0.1, 0.4]
    ds = atlas.run(scene("stability_perp_velocity", {"sigma": [1.14], "theta0": tilts}), progress=False)
    growth = ds.growth_rate.values.ravel()
    np.testing.assert_allclose(
        growth, [np.linalg.eigvals(linear(1.14, t)).real.max() for t in tilts], rtol=1e-6
    )
    assert growth[1] / growth[0] == pytest.approx(np.sin(0.1) / np.sin(0.05), rel=0.01)


def test_the_nudge_contains_nothing_of_the_growing_mode_at_one_shape():
    tilt = 0.22
    ratio = brentq(lambda r: growing_part(r, tilt), 1.05, 1.3)
    assert ratio == pytest.approx(1.14, abs=0.005)
    around = [ratio - 0.04, ratio, ratio + 0.04]
    axes = {"sigma": around, "theta0": [tilt]}
    label = atlas.run(scene("stability_perp_velocity", axes), progress=False).label.values.ravel()
    assert label.tolist() == [Label.DRIFTING, Label.PERMANENT_ROTATION, Label.DRIFTING]
    # turned round in psi, the nudge contains the mode there as well
    assert abs(growing_part(ratio, tilt, dpsi=-1.0)) > 0.1
    turned = atlas.run(scene("stability_perp_velocity", axes, psi0=-1e-4), progress=False)
    assert (turned.label == Label.DRIFTING).all()


@pytest.mark.parametrize("ratio", [1.4, 1.6])
def test_the_nudge_moves_the_stable_motion(ratio):
    """theta oscillates, at the two frequencies of linear theory, about that of the moved motion."""
    tr = atlas.run(scene("stability_perp_velocity", {"sigma": [ratio], "theta0": [0.5]}), progress=False)
    tr = tr.atlas.trajectory(sigma=ratio, theta0=0.5, samples=2001)
    frequencies = np.unique(np.abs(np.linalg.eigvals(linear(ratio, 0.5)).imag).round(9))
    waves = [f(frequency * tr.time) for frequency in frequencies for f in (np.cos, np.sin)]
    fit, *_ = np.linalg.lstsq(np.stack([np.ones(2001), *waves], 1), tr.theta - 0.5)
    moved = fit[0]
    assert moved == pytest.approx(1e-4 * ratio / (4 - 3 * ratio), rel=0.01)
    assert 1e-4 - moved == pytest.approx(1e-4 * 4 * (ratio - 1) / (3 * ratio - 4), rel=0.01)


def test_oblique_motions_precess_in_inertial_space_only():
    table = tomllib.loads((CONFIGS / "oblique.toml").read_text())
    for axis in table["axes"].values():
        axis["count"] = 12
    table["outputs"] = {"variables": ["label", "label_inertial"]}
    ds = atlas.run(scene_from(table, "oblique"), progress=False)
    exists = abs(ds.h1) <= 0.9 * np.sin(ds.theta0)  # 3 Omega^2 |A - C| = 0.9
    assert (ds.label.where(exists, Label.PERMANENT_ROTATION) == Label.PERMANENT_ROTATION).all()
    assert (ds.label_inertial.where(exists, Label.REGULAR_PRECESSION) == Label.REGULAR_PRECESSION).all()
    assert (ds.label.where(~exists, Label.NOT_COMPUTED) == Label.NOT_COMPUTED).all()


@pytest.mark.extension("equilibria")
def test_a_small_region_of_sixteen_equilibria():
    body = {"A": 1.0, "B": 1.3, "C": 1.7, "Omega": 1.0, "k3": 0.1}

    def count(k1, k2):
        return atlas.equilibria("satellite", body | {"k1": k1, "k2": k2}).sizes["equilibrium"]

    assert [count(k1, 0.01) for k1 in (1.0, 1.1, 1.2)] == [12, 16, 12]
    assert count(1.1, 0.06) == 12
