"""Example scenes of the fixed-point system, its derived variables, nudges and their errors."""

import logging
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import default_points

import atlas
from atlas.errors import BadInput
from atlas.extensions.amer2013 import EXTENSION, fast_spin, published
from atlas.flags import Agreement, Label, Stability, Status
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.systems import get
from atlas.systems.fixed_point import initial

pytestmark = pytest.mark.usefixtures("whole_kernels")

CONFIGS = Path(__file__).parents[2] / "configs"
PATHS = [p for p in sorted(CONFIGS.glob("*.toml")) if 'system = "fixed_point"' in p.read_text()]
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


def paper_points(body, **given_values):
    """The paper's starts of a body with each of its rotors."""
    A, C = fast_spin.PAPER_BODIES[body]
    d = fast_spin.PAPER_DATA
    rotor = np.array(fast_spin.PAPER_ROTORS)
    values = {"A": A, "B": A, "C": C, "l1": rotor, "l2": rotor, "l3": rotor, "m": d["r0"]}
    values |= {name: d[name] for name in ("M", "lambda", "R", "z0")} | {"theta0": np.arccos(d["gamma0"])}
    return default_points("fixed_point", rotor.size, **values | given_values)


# The scenes.


def test_example_scenes_state_what_they_show_and_how_long_they_take():
    assert len(PATHS) >= 8
    for path in PATHS:
        head = path.read_text().split("schema")[0]
        assert re.match(r"# What it shows: .*# Stands for: .*# Time: ", head, re.S), path.name


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
def test_scenes_agree_with_theory_at_reduced_counts(path):
    scene = reduced(path)
    ds = atlas.run(scene, progress=False)
    assert set(ds.data_vars) == set(scene.outputs)
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


@pytest.mark.parametrize(("body", "name"), [("A < C", "oblate"), ("A > C", "prolate")])
def test_scenes_contain_the_data_of_the_paper(body, name):
    scene = reduced(CONFIGS / f"fixed_point_paper_{name}.toml", 6)
    starts = grid.points_at_indices(scene, np.arange(6))
    spin = fast_spin.fast_spin(starts.points)
    assert tuple(scene.axes["l"].values) == fast_spin.PAPER_ROTORS
    for i, rotor in enumerate(fast_spin.PAPER_ROTORS):
        expected = fast_spin.paper_body(body, rotor)
        for field in ("A", "C", "weight", "N", "l1", "l2", "l3", "r0", "gamma0"):
            assert np.broadcast_to(getattr(spin, field), 6)[i] == pytest.approx(
                float(getattr(expected, field))
            )
        y = fast_spin.dimensionless(expected, SYSTEM.initial_state(starts.points)[:, i])
        # the scene omits the part of p0 of order eps
        np.testing.assert_allclose(y, fast_spin.paper_start(expected), rtol=1e-6, atol=1e-4)
    assert starts.duration * spin.r0 == pytest.approx(np.full(6, 4 * np.pi))


def test_warning_about_impossible_moments_is_written_to_the_file(tmp_path):
    scene = reduced(CONFIGS / "fixed_point_paper_oblate.toml", 2)
    atlas.run(scene, tmp_path / "paper.nc", progress=False)
    with atlas.open_atlas(tmp_path / "paper.nc") as ds:
        assert "A = 22.49 is below M (y0^2 + z0^2) = 750 (2 of 2 points)" in ds.attrs["atlas_warnings"]


# The derived variables.


@pytest.mark.parametrize("body", fast_spin.PAPER_BODIES)
@pytest.mark.parametrize("module", [fast_spin, published], ids=["true", "printed"])
def test_errors_are_those_of_single_integrations(body, module):
    points = paper_points(body)
    angle, rate = fast_spin.errors(points, np.full(6, 4 * np.pi / 1000), module.first_order)
    tau = np.linspace(0, 4 * np.pi, fast_spin.SAMPLES)
    for i, rotor in enumerate(fast_spin.PAPER_ROTORS):
        spin = fast_spin.paper_body(body, rotor)
        claimed = module.first_order(spin, tau)
        exact = fast_spin.integrate(spin, claimed[:, 0], tau)
        error = claimed - exact
        angle_error = float(spin.gamma0) * np.sqrt((error[3:] ** 2).sum(0)).max()
        assert angle[i] == pytest.approx(angle_error, rel=1e-3, abs=1e-12)
        if rotor:
            rate_error = np.hypot(*error[:2]).max() / np.hypot(*exact[:2]).max()
            assert rate[i] == pytest.approx(rate_error, rel=1e-3, abs=3e-12)


def test_first_order_errors_are_of_second_order_and_of_lower_order_as_printed():
    """With eps and the rotor halved, the true error falls by 4, the printed one by 2 or not at all."""
    table = tomllib.loads((CONFIGS / "first_order_error.toml").read_text())
    measured = {}
    for size in (0.02, 0.01):
        table["axes"] = {"eps": {"values": [size]}, "rotor": {"values": [0.5 * size]}}
        ds = atlas.run(scene_from(table), progress=False)
        for name in (name for name in EXTENSION.variables if name.startswith("first_order")):
            measured.setdefault(name, []).append(float(ds[name].values[0, 0]))
    ratio = {name: coarse / fine for name, (coarse, fine) in measured.items()}
    assert ratio["first_order_error"] == pytest.approx(4, rel=0.1)
    assert ratio["first_order_rate_error"] > 3.5
    assert ratio["first_order_error_printed"] == pytest.approx(2, rel=0.1)
    assert ratio["first_order_rate_error_printed"] == pytest.approx(1, rel=0.1)
    assert measured["first_order_rate_error_printed"][1] > 0.3


def test_errors_do_not_depend_on_the_chunk(monkeypatch):
    points, duration = paper_points("A < C", m=np.geomspace(30, 3000, 6)), np.full(6, 0.05)
    expected = fast_spin.errors(points, duration, fast_spin.first_order)
    monkeypatch.setattr(fast_spin, "CHUNK", 4)
    in_chunks = fast_spin.errors(points, duration, fast_spin.first_order)
    np.testing.assert_allclose(in_chunks, expected, rtol=1e-6, atol=1e-11)


def test_runs_too_long_for_the_errors_are_refused_and_never_integrated(monkeypatch):
    table = tomllib.loads((CONFIGS / "first_order_error.toml").read_text())
    table["axes"] = {"eps": {"values": [0.01]}, "rotor": {"values": [0.005]}}
    scene = scene_from(table)
    points = grid.check(scene)
    long = points.duration * 2 * fast_spin.MAX_RADIANS / fast_spin.radians(points.base, points.duration)

    def no_integration(*arguments, **options):
        raise AssertionError("integrated")

    with monkeypatch.context() as patched:
        patched.setattr(fast_spin, "dop853", no_integration)
        assert np.isnan(fast_spin.errors(points.base, long, fast_spin.first_order)).all()
    table["integration"]["duration"] = "1000 turns"
    with pytest.raises(atlas.BadInput, match=r"first_order_error: .* at most 1000 rad .* 1 of 1 points"):
        grid.check(scene_from(table))
    monkeypatch.setattr(fast_spin, "MAX_EVALUATIONS", 100)
    assert np.isnan(fast_spin.errors(points.base, points.duration, fast_spin.first_order)).all()


def test_an_interruption_ends_the_integration_for_the_errors():
    class Interruption(Exception):
        pass

    def pause():
        nonlocal calls
        calls += 1
        if calls == 50:
            raise Interruption

    calls, points = 0, paper_points("A < C")
    with pytest.raises(Interruption):
        fast_spin.errors(points, np.full(6, 4 * np.pi / 1000), fast_spin.first_order, pause)
    assert calls == 50


@pytest.mark.parametrize(
    ("changes", "variable", "message"),
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
def test_error_names_the_formula_that_has_no_meaning(changes, variable, message):
    fixed = {"A": 22.49, "B": 22.49, "C": 35.6, "Mg": 1.0, "z0": 1.0, "l1": 0.1, "theta0": 1.2, "m": 1.0}
    table = {
        "schema": 1, "system": "fixed_point", "fixed": fixed | changes, "axes": {"l2": {"values": [0.1]}},
        "integration": {"duration": 1.0}, "outputs": {"variables": ["label", variable]},
    }  # fmt: skip
    with pytest.raises(BadInput, match=re.escape(message)) as error:
        atlas.run(scene_from(table), progress=False)
    assert str(error.value).startswith(f"outputs.variables: {variable}: ")
    assert "\n" not in str(error.value)
    table["outputs"]["variables"] = ["label"]
    assert atlas.run(scene_from(table), progress=False).label.size == 1


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
