"""Example scenes of the fixed-point system, and nudges of its starts."""

import logging
import re
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from installed import CONFIGS, example_scenes
from strategies import default_points

import atlas
from atlas.errors import BadInput
from atlas.flags import Agreement, Label, Stability, Status
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.systems import get
from atlas.systems.fixed_point import initial

pytestmark = pytest.mark.usefixtures("whole_kernels")

PATHS = [p for p in example_scenes() if 'system = "fixed_point"' in p.read_text()]
SYSTEM = get("fixed_point")


@pytest.fixture(autouse=True)
def no_warnings(caplog):
    """Warnings about the impossible moments of the paper's bodies are not shown."""
    caplog.set_level(logging.ERROR, "atlas")


def reduced(path, count=11, **integration):
    """A scene of configs/ with `count` points along each axis."""
    table = tomllib.loads(path.read_text())
    for axis in table["axes"].values():
        axis["count"] = count
    table["integration"] |= integration
    return scene_from(table, path.stem)


# The scenes.


def test_example_scenes_state_what_they_show_and_how_long_they_take():
    assert len(PATHS) >= 8
    for path in PATHS:
        head = path.read_text().split("schema")[0]
        assert re.match(r"# What it shows: .*# Stands for: .*# Time: ", head, re.S), path.name


@pytest.mark.usual("quickstart", "sleeping_top_spin", "sleeping_top_field", "conical_precession_spin")
@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_scenes_agree_with_theory_at_reduced_counts(path):
    scene = reduced(path)
    ds = atlas.run(scene, progress=False)
    refined = {"computed"} if scene.refine else set()
    assert set(ds.data_vars) == set(scene.outputs) | refined
    assert (ds.status.values[ds.label.values != Label.NOT_COMPUTED] == Status.OK).all()
    if "agreement_any_axis" in ds:
        compared = ds.agreement_any_axis.values[ds.agreement_any_axis.values != Agreement.NOT_COMPARED]
        assert (compared == Agreement.AGREE).mean() > (0.9 if scene.nudge else 0.999)
        assert (ds.label_any_axis == Label.REGULAR_PRECESSION).sum() > 20
    if path.stem == "fast_spin_survival":  # no steady motion exists, but some motions are steady to tolerance
        near, steady = ds.predicted.values == Label.NOT_COMPUTED, ds.label.values != Label.DRIFTING
        assert (ds.predicted.values[~near] == Label.DRIFTING).all()
        assert 0.5 < near.sum() / steady.sum() < 2
        assert ((ds.agreement.values == Agreement.NOT_COMPARED) == near).all()
        assert not steady[~near].any()
        assert set(np.unique(ds.label)) == {
            Label.DRIFTING,
            Label.REGULAR_PRECESSION,
            Label.PERMANENT_ROTATION,
        }
    elif "agreement" in ds:
        assert np.isin(ds.agreement, (Agreement.NOT_COMPARED, Agreement.AGREE)).mean() > 0.98
    if scene.family is not None:
        assert set(np.unique(ds.stable)) >= {Stability.STABLE, Stability.UNSTABLE}


def test_threshold_of_the_sleeping_top_over_spin_and_rotor():
    """The measured label agrees with (C r0 + l3)^2 > 4 A [N (C - A) + Mg |z0|] away from equality."""
    ds = atlas.run(reduced(CONFIGS / "sleeping_top_spin.toml", 30), progress=False)
    spin = ds.C * ds.r0 + ds.l3
    threshold = 4 * ds.A * (ds.N * (ds.C - ds.A) + ds.Mg * abs(ds.z0))
    off_threshold = abs(spin**2 / threshold - 1) > 0.1
    survives = (ds.label == Label.PERMANENT_ROTATION).transpose(*spin.dims)
    assert (survives == (spin**2 > threshold)).where(off_threshold, True).all()


@pytest.mark.long
def test_upright_tops_are_mirror_images_of_tops_hung_upside_down():
    """The body turned by half a turn about its first axis: theta from pi to 0, and z0, l3, r0 and m with the other sign."""
    turned = {"z0": -1.0, "gamma30": 1.0, "m": -2.0}
    for name in ("sleeping_top_spin", "sleeping_top_field"):
        axes = ("r0", "l3") if name.endswith("spin") else ("l3", "N")
        scene = atlas.example(name, axes={axis: {"count": 16} for axis in axes})
        upright = atlas.run(scene, progress=False)
        assert (upright.z0 == 1).all()
        assert upright.theta_max.min() > 3.14
        scene["fixed"] |= {key: value for key, value in turned.items() if key in scene["fixed"]}
        scene["nudge"]["theta0"] *= -1
        scene.pop("ties", None)
        for axis in {"r0", "l3"} & scene["axes"].keys():
            scene["axes"][axis] |= {"from": -scene["axes"][axis]["to"], "to": -scene["axes"][axis]["from"]}
        hung = atlas.run(scene, progress=False)
        assert hung.theta_min.max() < 1e-3
        hung = hung.isel({axis: slice(None, None, -1) for axis in ("r0", "l3") if axis in hung.dims})
        for variable in ("label", "predicted", "stable"):
            np.testing.assert_array_equal(upright[variable], hung[variable])


# Nudges of starts that are given by vectors.

NUDGED = {
    "schema": 1,
    "system": "fixed_point",
    "fixed": {"C": 0.6, "Mg": 1.0, "z0": 0.3, "p0": 0.1, "q0": 0.2, "gamma10": 0.6, "gamma20": 0.0, "gamma30": 0.8},
    "axes": {"r0": {"values": [1.0, 2.0]}},
}  # fmt: skip


@given(
    w=st.tuples(*[st.floats(-5, 5)] * 3),
    theta=st.one_of(st.floats(0.01, 3.13), st.sampled_from([0.0, np.pi])),
    phi=st.floats(-3, 3),
)
@settings(max_examples=60, deadline=None)
def test_starts_by_vectors_converted_to_angles_are_the_same(w, theta, phi):
    s = np.sin(theta) if 0 < theta < np.pi else 0.0
    vector = dict(zip(("p0", "q0", "r0"), w, strict=True))
    vector |= {"gamma10": s * np.sin(phi), "gamma20": s * np.cos(phi), "gamma30": np.cos(theta)}
    points = default_points("fixed_point", 1, **vector)
    by_angles = initial.as_euler_angles(points)
    assert np.isnan(by_angles["p0"]).all()
    scale = 1 + np.abs(w).max() / max(s, 1e-2)
    state, expected = initial.initial_state(by_angles), initial.initial_state(points)
    np.testing.assert_allclose(state, expected, atol=1e-14 * scale)
    unchanged = initial.as_euler_angles(by_angles)
    assert all(np.array_equal(unchanged[name], by_angles[name], equal_nan=True) for name in unchanged)


def test_angles_nudge_a_start_given_by_vectors():
    plain = grid.points_at_indices(scene_from(NUDGED), np.arange(2))
    nudge = {"theta0": 0.1, "n": 0.2}
    nudged = grid.points_at_indices(scene_from(NUDGED | {"nudge": nudge}), np.arange(2))
    assert all(np.array_equal(plain.base[k], nudged.base[k], equal_nan=True) for k in plain.base)
    (theta_dot, n, m), (theta_dot_0, n_0, m_0) = initial.rates(nudged.points), initial.rates(plain.points)
    tilt, tilt_0 = (np.arccos(initial.vertical(g.points)[2]) for g in (nudged, plain))
    np.testing.assert_allclose(tilt - tilt_0, 0.1)
    np.testing.assert_allclose([theta_dot - theta_dot_0, n - n_0 - 0.2, m - m_0], 0, atol=1e-14)


def test_vectors_nudge_a_start_given_by_vectors():
    nudged = grid.points_at_indices(
        scene_from(NUDGED | {"nudge": {"p0": 0.01, "gamma20": 0.01}}), np.arange(2)
    )
    state = SYSTEM.initial_state(nudged.points)
    np.testing.assert_allclose(state[0], 0.11)
    np.testing.assert_allclose((state[3:] ** 2).sum(0), 1, rtol=1e-14)


def test_vectors_nudge_a_start_listed_among_points():
    table = {name: values for name, values in NUDGED.items() if name != "axes"}
    table |= {"points": {"values": {"r0": [1.0, 2.0]}}, "nudge": {"r0": 0.5}}
    nudged = grid.points_at_indices(scene_from(table), np.arange(2))
    np.testing.assert_allclose(SYSTEM.initial_state(nudged.points)[2], [1.5, 2.5])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nudge": {"theta0": 0.1, "p0": 0.1}}, "nudge: theta0, p0 together: allowed: angles and their rates"),
        ({"fixed": {"theta0": 1.0}, "axes": {"m": {"values": [1.0]}}, "nudge": {"gamma10": 0.1}},
         "nudge.gamma10: the scene gives no gamma10"),
    ],
)  # fmt: skip
def test_nudges_without_meaning_are_refused(changes, message):
    with pytest.raises(BadInput, match=re.escape(message)):
        scene_from(NUDGED | changes)
