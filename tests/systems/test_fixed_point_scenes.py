"""Scenes of the fixed-point system: what they promise at small counts, its layers, nudges and complaints."""

import logging
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import atlas
from atlas.errors import BadInput
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.systems import get
from atlas.systems.fixed_point import initial
from atlas.systems.fixed_point.paper import errors, fast_spin, published

CONFIGS = Path(__file__).parents[2] / "configs"
PATHS = [p for p in sorted(CONFIGS.glob("*.toml")) if 'system = "fixed_point"' in p.read_text()]
SYSTEM = get("fixed_point")


@pytest.fixture(autouse=True)
def quiet(caplog):
    caplog.set_level(logging.ERROR, "atlas")  # the paper's bodies are warned about


def reduced(path, count=11, **integration):
    """A scene of configs/ with `count` points along each axis."""
    table = tomllib.loads(path.read_text())
    for axis in table["axes"].values():
        axis["count"] = count
    table["integration"] |= integration
    return scene_from(table, path.stem)


def points_of(count, **given_values):
    known = {name: np.full(count, parameter.default) for name, parameter in SYSTEM.parameters.items()}
    return known | {name: np.broadcast_to(np.asarray(v, float), count) for name, v in given_values.items()}


def paper_points(body, **given_values):
    A, C = fast_spin.PAPER_BODIES[body]
    d = fast_spin.PAPER_DATA
    rotor = np.array(fast_spin.PAPER_ROTORS)
    values = {"A": A, "B": A, "C": C, "l1": rotor, "l2": rotor, "l3": rotor, "m": d["r0"]}
    values |= {name: d[name] for name in ("M", "lambda", "R", "z0")} | {"theta0": np.arccos(d["gamma0"])}
    return points_of(rotor.size, **values | given_values)


# The scenes.


def test_there_is_a_scene_for_every_map_of_the_paper():
    assert len(PATHS) >= 8
    for path in PATHS:
        head = path.read_text().split("schema")[0]
        assert re.match(r"# What it shows: .*# Stands for: .*# Time: ", head, re.S), path.name


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_scenes_agree_with_theory_at_reduced_counts(path):
    scene = reduced(path)
    ds = atlas.run(scene, progress=False)
    assert set(ds.data_vars) == set(scene.outputs)
    assert (ds.status.values[ds.label.values > 0] == 1).all()
    if (
        path.stem == "fast_spin_survival"
    ):  # no steady motion exists: what survives does so within the tolerance
        assert (ds.predicted == 3).all()
        assert {1, 2, 3} == set(np.unique(ds.label))
    elif "agreement" in ds:
        assert np.isin(ds.agreement, (0, 1)).mean() > 0.98
    if scene.family is not None:
        assert {1, 2} <= set(np.unique(ds.stable))


def test_threshold_of_the_sleeping_top_over_spin_and_rotor():
    """Away from (C r0 + l3)^2 = 4 A [N (C - A) + Mg |z0|] the measured label is the formula's."""
    ds = atlas.run(reduced(CONFIGS / "sleeping_top_spin.toml", 30), progress=False)
    spin = ds.C * ds.r0 + ds.l3
    threshold = 4 * ds.A * (ds.N * (ds.C - ds.A) + ds.Mg * abs(ds.z0))
    clear = abs(spin**2 / threshold - 1) > 0.1
    survives = (ds.label == 2).transpose(*spin.dims)
    assert (survives == (spin**2 > threshold)).where(clear, True).all()


@pytest.mark.parametrize(("body", "name"), [("A < C", "oblate"), ("A > C", "prolate")])
def test_scenes_hold_the_data_of_the_paper(body, name):
    scene = reduced(CONFIGS / f"fixed_point_paper_{name}.toml", 6)
    found = grid.points_at_indices(scene, np.arange(6))
    spin = fast_spin.fast_spin(found.points)
    assert scene.axes["l"].values == fast_spin.PAPER_ROTORS
    for i, rotor in enumerate(fast_spin.PAPER_ROTORS):
        wanted = fast_spin.paper_body(body, rotor)
        for field in ("A", "C", "weight", "N", "l1", "l2", "l3", "r0", "gamma0"):
            assert np.broadcast_to(getattr(spin, field), 6)[i] == pytest.approx(float(getattr(wanted, field)))
        y = fast_spin.dimensionless(wanted, SYSTEM.initial_state(found.points)[:, i])
        # the scene leaves out the part of order eps of p0
        np.testing.assert_allclose(y, fast_spin.paper_start(wanted), rtol=1e-6, atol=1e-4)
    assert found.duration * spin.r0 == pytest.approx(np.full(6, 4 * np.pi))


def test_impossible_moments_are_a_warning_kept_in_the_file(tmp_path):
    scene = reduced(CONFIGS / "fixed_point_paper_oblate.toml", 2)
    atlas.run(scene, tmp_path / "paper.nc", progress=False)
    with atlas.open_atlas(tmp_path / "paper.nc") as ds:
        assert "A = 22.49 is below M (y0^2 + z0^2) = 750 (2 of 2 points)" in ds.attrs["atlas_warnings"]


# The layers.


@pytest.mark.parametrize("body", fast_spin.PAPER_BODIES)
@pytest.mark.parametrize("module", [fast_spin, published], ids=["true", "printed"])
def test_errors_are_those_of_single_integrations(body, module):
    points = paper_points(body)
    angle, rate = errors.errors(points, np.full(6, 4 * np.pi / 1000), module.first_order)
    tau = np.linspace(0, 4 * np.pi, errors.SAMPLES)
    for i, rotor in enumerate(fast_spin.PAPER_ROTORS):
        spin = fast_spin.paper_body(body, rotor)
        claimed = module.first_order(spin, tau)
        away = claimed - fast_spin.integrate(spin, claimed[:, 0], tau)
        wanted = float(spin.gamma0) * np.sqrt((away[3:] ** 2).sum(0)).max()
        assert angle[i] == pytest.approx(wanted, rel=1e-3, abs=1e-12)
        if rotor:
            size = np.hypot(*(claimed - away)[:2]).max()
            assert rate[i] == pytest.approx(np.hypot(*away[:2]).max() / size, rel=1e-3, abs=3e-12)


def test_layers_show_the_order_of_the_true_solution_and_the_failure_of_the_printed_one():
    """eps and the rotor halved together: the true error falls by 4, the printed one by 2 or not at all."""
    table = tomllib.loads((CONFIGS / "first_order_error.toml").read_text())
    measured = {}
    for size in (0.02, 0.01):
        table["axes"] = {"eps": {"values": [size]}, "rotor": {"values": [0.5 * size]}}
        ds = atlas.run(scene_from(table), progress=False)
        for name in errors.DERIVED:
            measured.setdefault(name, []).append(float(ds[name].values[0, 0]))
    ratio = {name: big / small for name, (big, small) in measured.items()}
    assert ratio["first_order_error"] == pytest.approx(4, rel=0.1)
    assert ratio["first_order_rate_error"] > 3.5
    assert ratio["first_order_error_printed"] == pytest.approx(2, rel=0.1)
    assert ratio["first_order_rate_error_printed"] == pytest.approx(1, rel=0.1)
    assert measured["first_order_rate_error_printed"][1] > 0.3


def test_errors_do_not_depend_on_the_block(monkeypatch):
    points, duration = paper_points("A < C", m=np.geomspace(30, 3000, 6)), np.full(6, 0.05)
    whole = errors.errors(points, duration, fast_spin.first_order)
    monkeypatch.setattr(errors, "BLOCK", 4)
    np.testing.assert_allclose(
        errors.errors(points, duration, fast_spin.first_order), whole, rtol=1e-6, atol=1e-11
    )


@pytest.mark.parametrize(
    ("changes", "layer", "message"),
    [
        ({"m": 0.0}, "first_order_error", "r0 = 0: the small parameter eps"),
        ({"theta0": np.pi / 2 + 0.1}, "first_order_error", "outside (0, 1): the scaling (4) divides"),
        ({"theta0": 0.0}, "first_order_rate_error", "psi' in (34) divides by sin theta0"),
        ({"C": 22.49, "l3": 0.0}, "first_order_error", "forced part mu / Omega of p1, q1 is resonant"),
        ({"C": 22.49, "l3": 1.0}, "first_order_error_printed", "A1 = 0 (A = C): X of (11) divides by A1"),
        ({"l3": -35.6}, "first_order_error", "C r0 + l3 = 0: chi1 and nu of (10) divide by 1 + Omega"),
        ({"z0": 0.0}, "first_order_error", "Mg z0 = 0: the unit c sqrt(gamma0'')"),
        ({"B": 25.0}, "first_order_rate_error_printed", "A != B: the paper's (5)"),
    ],
)
def test_scenes_say_which_formula_loses_its_meaning(changes, layer, message):
    fixed = {"A": 22.49, "B": 22.49, "C": 35.6, "Mg": 1.0, "z0": 1.0, "l1": 0.1, "theta0": 1.2, "m": 1.0}
    table = {
        "schema": 1, "system": "fixed_point", "fixed": fixed | changes, "axes": {"l2": {"values": [0.1]}},
        "integration": {"duration": 1.0}, "outputs": {"variables": ["label", layer]},
    }  # fmt: skip
    with pytest.raises(BadInput, match=re.escape(message)) as complaint:
        atlas.run(scene_from(table), progress=False)
    assert str(complaint.value).startswith(f"outputs.variables: {layer}: ")
    assert "\n" not in str(complaint.value)
    table["outputs"]["variables"] = ["label"]
    assert atlas.run(scene_from(table), progress=False).label.size == 1


# Nudges of starts given by vectors.

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
def test_vector_starts_by_angles_are_the_same_starts(w, theta, phi):
    s = np.sin(theta) if 0 < theta < np.pi else 0.0
    vector = dict(zip(("p0", "q0", "r0"), w, strict=True))
    vector |= {"gamma10": s * np.sin(phi), "gamma20": s * np.cos(phi), "gamma30": np.cos(theta)}
    points = points_of(1, **vector)
    turned = initial.as_euler_angles(points)
    assert np.isnan(turned["p0"]).all()
    size = 1 + np.abs(w).max() / max(s, 1e-2)
    np.testing.assert_allclose(
        initial.initial_state(turned), initial.initial_state(points), atol=1e-14 * size
    )
    same = initial.as_euler_angles(turned)
    assert all(np.array_equal(same[name], turned[name], equal_nan=True) for name in same)


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
def test_nudges_that_mean_nothing_are_refused(changes, message):
    with pytest.raises(BadInput, match=re.escape(message)):
        scene_from(NUDGED | changes)
