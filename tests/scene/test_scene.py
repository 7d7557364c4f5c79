"""Scenes: reading, the errors of bad input, the grid of points, and ties."""

import re
import sys
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from installed import example_scenes

import atlas
from atlas import BadInput, load_scene
from atlas.scene import grid
from atlas.scene.expressions import Expression, evaluation_order
from atlas.scene.model import Settings, Tolerances


def edit(text: str, old: str, new: str) -> str:
    """The text with the first occurrence of `old` replaced."""
    assert old in text
    return text.replace(old, new, 1)


def test_resolved_scene_reads_back_to_the_same_points(small_scene):
    scene = load_scene(small_scene)
    copy = load_scene(scene.toml())
    assert copy.toml() == scene.toml()
    points, copied = (grid.points_at_indices(s, np.arange(s.size)) for s in (scene, copy))
    for name, values in points.points.items():
        np.testing.assert_array_equal(values, copied.points[name])


def test_points_are_on_the_family_before_the_nudge(small_scene):
    scene = load_scene(small_scene)
    points = grid.points_at_indices(scene, np.arange(scene.size))
    assert points.exists.all()
    family, residual = scene.system.identify_family(points.base)
    assert (family == scene.system.families["perp_velocity"].flag).all()
    assert residual.max() < 1e-12
    np.testing.assert_allclose(points.points["theta0"] - points.base["theta0"], 1e-4, rtol=1e-10)
    np.testing.assert_array_equal(points.points["n"], points.base["n"])
    np.testing.assert_array_equal(points.base["C"].reshape(scene.shape)[:, 0], scene.axes["sigma"].values)


def test_offset_axis_passes_through_the_family(small_scene):
    text = edit(
        small_scene,
        "[ties]",
        "[axes.k3]\nfrom = -0.1\nto = 0.1\ncount = 3\noffset_from_family = true\n[ties]",
    )
    scene = load_scene(text)
    points = grid.points_at_indices(scene, np.arange(scene.size))
    family, _ = scene.system.identify_family(points.base)
    on_family = family.reshape(scene.shape) > 0
    assert on_family[:, :, 1].all()
    assert not on_family[:, :, [0, 2]].any()
    # (24) of the paper with A = Omega = 1, m = 1/2; the offset is added, not subtracted
    exact = 4 * np.cos(points.base["theta0"]) * (1 - points.base["C"]) - 0.5 * points.base["C"]
    offset = (points.base["k3"] - exact).reshape(scene.shape)
    np.testing.assert_allclose(offset, np.broadcast_to([-0.1, 0.0, 0.1], scene.shape), atol=1e-12)


@pytest.mark.parametrize(
    "duration", ['"1234567.25 turns"', '"0.1 orbits"', '"20 orbits"', "0.30000000000000004"]
)
def test_resolved_duration_keeps_every_digit(small_scene, duration):
    scene = load_scene(edit(small_scene, "duration = 30.0", f"duration = {duration}"))
    assert load_scene(scene.toml()).duration == scene.duration


def test_tolerance_of_the_angle_is_by_default_the_number_of_the_rate():
    assert Settings(rate_tolerance=1e-3).at(1e-3).tolerances == Tolerances(rate=1e-3, angle=1e-3)
    assert Settings(cylinder_tolerance=1e-2).at(1e-5).tolerances == Tolerances(rate=1e-5, angle=1e-2)
    assert Settings().at(1e-3).tolerances == Tolerances(rate=1e-3, angle=1e-5)


def test_scene_prints_as_a_few_lines(small_scene):
    text = repr(load_scene(small_scene))
    assert len(text.splitlines()) == 9
    for part in (
        "small: 63 points of the satellite",
        "sigma: 9 values from 0.3 to 1.7",
        "fixed: A = 1, Omega = 1, m = 0.5",
        "ties: B = A, C = sigma * A, psi0 = pi / 2",
        "family: perp_velocity, solved for k3",
        "nudge: theta0 = 0.0001, psi0 = 0.0001",
        "duration 30, rk4, tolerance 1e-05",
        "rate tolerance 0.001, cylinder tolerance 0.001",
    ):
        assert part in text
    one = edit(small_scene, "from = 0.3\nto = 1.7\ncount = 9", "values = [0.3]")
    assert "\n  sigma: 0.3\n" in repr(load_scene(one))


def test_a_long_scene_prints_as_a_few_lines(scene_text):
    ties = {f"ties.a{i}": " + ".join(["A"] * 30) for i in range(60)} | {
        "ties.k1": "+".join(f"a{i}" for i in range(60))
    }
    text = repr(load_scene(scene_text(ties)))
    assert len(text.splitlines()) == 9
    assert len(text) < 1200
    assert "and 56 more" in text
    columns = {f"c{i}": list(range(3)) for i in range(50)}
    points = {
        "points.values": columns,
        "axes": None,
        "ties": {"C": "1.2", "k1": "+".join(columns)},
        "family": None,
    }
    text = repr(load_scene(scene_text(points)))
    assert "columns: c0, c1, c2, c3, c4, c5, c6, c7, and 42 more" in text
    assert len(text.splitlines()) < 10
    axes = {f"b{i}": {"values": [1.0]} for i in range(30)}
    text = repr(load_scene(scene_text({"axes": axes, "ties": {"k1": "+".join(axes)}, "family": None})))
    assert "and 22 axes more" in text
    assert len(text.splitlines()) < 20


@pytest.mark.parametrize(
    ("duration", "expected"), [('"2 orbits"', 4 * np.pi), ('"3 turns"', 12 * np.pi), ("7", 7.0)]
)
def test_durations(small_scene, duration, expected):
    scene = load_scene(edit(small_scene, "duration = 30.0", f"duration = {duration}"))
    np.testing.assert_allclose(grid.points_at_indices(scene, np.arange(3)).duration, expected)


def test_every_config_is_a_scene():
    configs = example_scenes()
    assert len(configs) >= 30
    for path in configs:
        text = path.read_text()
        assert text.startswith("# What it shows:"), path
        assert re.search(r"^# Stands for:", text, re.M), path
        assert re.search(r"^# Time:", text, re.M), path
        scene = load_scene(path)
        assert scene.extensions == tomllib.loads(text).get("extensions", []), path
        grid.check(scene)


numbers = st.floats(-10, 10).map(lambda x: round(x, 3))
expressions = st.recursive(
    st.one_of(numbers.map(lambda x: f"({x})"), st.sampled_from(["x", "y", "pi"])),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/"]), inner).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        st.tuples(st.sampled_from(["sin", "cos", "abs"]), inner).map(lambda t: f"{t[0]}({t[1]})"),
    ),
    max_leaves=8,
)


@given(expressions, numbers, numbers)
def test_ties_compute_what_python_computes(text, x, y):
    names = {"sin": np.sin, "cos": np.cos, "abs": np.abs, "pi": np.pi, "x": np.float64(x), "y": np.float64(y)}
    with np.errstate(all="ignore"):
        try:
            expected = eval(text, {"__builtins__": {}}, names)
        except ZeroDivisionError:
            return
    value = Expression("t", text).value({"x": np.asarray(x), "y": np.asarray(y)})
    np.testing.assert_array_equal(value, expected)


def test_a_tie_is_evaluated_by_one_call_of_the_package():
    """Parsing, matching and looking up are done once."""
    tie, calls = Expression("t", "2 * sin(x) ** 2 + sqrt(abs(y)) - pi"), []

    def count(frame, event, argument):
        if event == "call" and "atlas" in frame.f_code.co_filename:
            calls.append(frame.f_code.co_name)

    sys.setprofile(count)
    try:
        value = tie.value({"x": np.array([0.5, 1.0]), "y": np.array([-4.0, 9.0])})
    finally:
        sys.setprofile(None)
    assert calls == ["value"]
    np.testing.assert_array_equal(value, 2 * np.sin([0.5, 1.0]) ** 2 + [2.0, 3.0] - np.pi)


def test_a_number_beyond_the_largest_float_is_infinite():
    for text in ("9" * 400, "1e400", "0x" + "f" * 300):
        assert Expression("t", text).value({}) == np.inf
    assert Expression("t", "-" + "9" * 308).value({}) == -float("9" * 308)


@pytest.mark.long
@given(st.text(max_size=40))
def test_ties_accept_only_arithmetic_in_names(text):
    try:
        names = Expression("t", text).names
    except BadInput:
        names = frozenset()
    assert all(name.isidentifier() for name in names)


def test_ties_are_ordered():
    """Each tie follows those it uses; otherwise the order of the scene decides."""
    texts = {"a": "b + 1", "p": "d", "q": "c", "b": "c * 2", "c": "x", "d": "1"}
    ties = {name: Expression(name, text) for name, text in texts.items()}
    assert evaluation_order(ties, {"x"}) == ["c", "d", "p", "q", "b", "a"]


# The table [about].

ABOUT = {
    "about.summary": "Where a regular precession survives",
    "about.licence": "CC-BY-4.0",
    "about.keywords": ["gyrostat", "precession"],
    "about.references": "A paper, 2026",
    "about.creator": {
        "name": "A. Author",
        "email": "a@example.org",
        "url": "https://example.org",
        "institution": "I",
    },
}


@pytest.mark.long
def test_the_table_about_becomes_attributes_of_acdd(scene_text, tmp_path):
    scene = load_scene(scene_text(ABOUT))
    assert load_scene(scene.toml()).about == scene.about
    expected = {
        "summary": "Where a regular precession survives",
        "license": "CC-BY-4.0",
        "keywords": "gyrostat, precession",
        "creator_name": "A. Author",
        "creator_email": "a@example.org",
        "creator_url": "https://example.org",
        "creator_institution": "I",
        "title": "small",
    }
    outs = [None, tmp_path / "a.nc", tmp_path / "run/"]
    for ds in (atlas.run(scene, out, progress=False) for out in outs):
        with ds:
            assert {name: ds.attrs[name] for name in expected} == expected
            assert ds.attrs["references"].startswith("A paper, 2026; H. M. Yehia")
            assert "ACDD-1.3" in ds.attrs["Conventions"]
            assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", ds.attrs["date_created"])
            assert load_scene(ds.attrs["atlas_scene"]).about == scene.about


def test_an_atlas_of_a_scene_without_about_has_none_of_its_attributes(small_scene):
    scene = load_scene(small_scene)
    assert "about" not in scene.toml()
    ds = atlas.run(scene, progress=False)
    assert not {"summary", "license", "keywords", "creator_name"} & set(ds.attrs)


def test_points_at_the_coordinates_of_the_grid_are_those_of_the_grid(small_scene):
    scene = load_scene(small_scene)
    expected = grid.points_at_indices(scene, np.arange(scene.size))
    indices = np.array([5, 17, 17, 40, 62])
    coordinates = {
        axis.name: np.asarray(axis.values)[i]
        for axis, i in zip(scene.axes.values(), np.unravel_index(indices, scene.shape), strict=True)
    }
    points = grid.points_at(scene, coordinates)
    for name, values in points.points.items():
        np.testing.assert_array_equal(values, expected.points[name][indices])
    np.testing.assert_array_equal(points.duration, expected.duration[indices])
