"""Errors of the paper's solution as variables, and the example scenes with its data."""

import logging
import re
import tomllib

import numpy as np
import pytest
from installed import CONFIGS
from strategies import default_points

import atlas
from atlas.errors import BadInput
from atlas.extensions.amer2013 import EXTENSION, MAX_RADIANS, fast_spin, published
from atlas.scene import grid
from atlas.scene.read import scene_from
from atlas.systems import get

pytestmark = pytest.mark.usefixtures("whole_kernels")

SYSTEM = get("fixed_point")


@pytest.fixture(autouse=True)
def no_warnings(caplog):
    """Warnings about the impossible moments of the paper's bodies are not shown."""
    caplog.set_level(logging.ERROR, "atlas")


def small(name, count):
    """A scene of configs/ with `count` points along each axis."""
    table = tomllib.loads((CONFIGS / f"{name}.toml").read_text())
    for axis in table["axes"].values():
        axis["count"] = count
    return scene_from(table, name)


def paper_points(body, **given_values):
    """The paper's starts of a body with each of its rotors."""
    A, C = fast_spin.PAPER_BODIES[body]
    d = fast_spin.PAPER_DATA
    rotor = np.array(fast_spin.PAPER_ROTORS)
    values = {"A": A, "B": A, "C": C, "l1": rotor, "l2": rotor, "l3": rotor, "m": d["r0"]}
    values |= {name: d[name] for name in ("M", "lambda", "R", "z0")} | {"theta0": np.arccos(d["gamma0"])}
    return default_points("fixed_point", rotor.size, **values | given_values)


@pytest.mark.parametrize(("body", "name"), [("A < C", "oblate"), ("A > C", "prolate")])
def test_scenes_contain_the_data_of_the_paper(body, name):
    scene = small(f"fixed_point_paper_{name}", 6)
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
    scene = small("fixed_point_paper_oblate", 2)
    atlas.run(scene, tmp_path / "paper.nc", progress=False)
    with atlas.open_atlas(tmp_path / "paper.nc") as ds:
        assert "A = 22.49 is below M (y0^2 + z0^2) = 750 (2 of 2 points)" in ds.attrs["atlas_warnings"]


@pytest.mark.usual("printed-A < C", "true-A > C")
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


def test_after_a_transient_the_errors_are_refused():
    table = tomllib.loads((CONFIGS / "first_order_error.toml").read_text())
    table["labels"] = {**table.get("labels", {}), "transient": 2.0}
    sentence = "it is of the motion from its start, not after a transient$"
    with pytest.raises(atlas.BadInput, match=f"^outputs.variables: first_order_\\w+: {sentence}"):
        grid.check(atlas.load_scene(table))
    with pytest.raises(atlas.BadInput, match=f"^variables: first_order_error: {sentence}"):
        atlas.label_points("fixed_point", {"m": 1.0}, transient=2.0, variables=["first_order_error"])


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


@pytest.mark.long
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


def test_the_page_of_limits_has_the_longest_run_of_the_errors():
    page = (CONFIGS.parent / "docs" / "security.md").read_text()
    limit = f"{int(MAX_RADIANS):,}".replace(",", " ")
    assert f"errors of the fast-spin solution are integrated | {limit} |" in page
