"""Scenes: what is read, what is refused, and the one line that says so."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atlas import BadInput, load_scene
from atlas.scene import grid
from atlas.scene.expressions import Expression, evaluation_order


def edit(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


BAD = [
    # what is replaced, by what, what the complaint must name
    ("schema = 1", "schema = 2", "schema = 2"),
    ("schema = 1", "schema = true", "schema = True"),
    ("schema = 1\n", "", "schema is missing"),
    ('system = "satellite"', 'system = "sputnik"', "sputnik"),
    ('system = "satellite"', "system = 3", "system = 3"),
    ('system = "satellite"\n', "", "system is missing"),
    ('title = "small"', "colour = 3", "colour"),
    ("A = 1.0", 'A = "one"', "fixed.A"),
    ("A = 1.0", "A = true", "fixed.A"),
    ("A = 1.0", "A = nan", "fixed.A"),
    ("A = 1.0", "A = inf", "fixed.A"),
    ("A = 1.0", "A = -1.0", "fixed.A"),
    ("A = 1.0", "A = 0.0", "fixed.A"),
    ("Omega = 1.0", "Omega = -1.0", "fixed.Omega"),
    ("m = 0.5", "mass = 0.5", "fixed.mass"),
    ("count = 9", "count = 0", "axes.sigma.count"),
    ("count = 9", "count = 2.5", "axes.sigma.count"),
    ("count = 9", "count = -3", "axes.sigma.count"),
    ("count = 9\n", "", "axes.sigma.count is missing"),
    ("from = 0.3", "from = nan", "axes.sigma.from"),
    ("from = 0.3", "from = 1.7", "axes.sigma"),
    ("from = 0.3", "from = -0.3\nspacing = 'log'", "axes.sigma.spacing"),
    ("from = 0.3", "from = 0.3\nspacing = 'cubic'", "cubic"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = []", "axes.sigma.values"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = [1.0, 1.0]", "axes.sigma.values"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = [1.0, 'two']", "axes.sigma.values"),
    ("from = 0.3", "from = 0.3\nvalues = [1.0]", "not together with values"),
    ("from = 0.3", "from = 0.3\nstride = 2", "axes.sigma.stride"),
    ("to = 1.7", "to = 2.5", "no rigid body"),
    ("from = 0.3", "from = -0.3", "C > 0"),
    ('B = "A"', 'B = "3 * A"', "no rigid body"),
    ('B = "A"', 'B = "A +"', "ties.B"),
    ('B = "A"', 'B = "Q"', "'Q' is neither"),
    ('B = "A"', 'B = "k3"', "ties.B"),
    ('B = "A"', "B = 3", "ties.B"),
    ('B = "A"', "B = \"__import__('os')\"", "not arithmetic"),
    ('B = "A"', 'B = "A.real"', "not arithmetic"),
    ('B = "A"', 'B = "1 / (A - A)"', "ties.B"),
    ('B = "A"\n', 'B = "u"\nu = "v"\nv = "u + 1"\n', "circle"),
    ('C = "sigma * A"\n', "", "axes.sigma"),
    ('name = "perp_velocity"', 'name = "banana"', "banana"),
    ('name = "perp_velocity"\n', "", "family.name"),
    ('solve = ["k3"]', 'solve = ["Omega"]', "cannot be solved"),
    ('solve = ["k3"]', 'solve = "k3"', "family.solve"),
    ('solve = ["k3"]', 'solve = ["k3", "k3"]', "twice"),
    ("m = 0.5", "m = 0.5\nk3 = 1.0", "k3 is given in fixed and in solve"),
    ("m = 0.5", "m = 0.5\nk1 = 0.3", "perp_velocity"),
    ("[nudge]\ntheta0", "[nudge]\nA", "nudge.A"),
    ("duration = 30.0", "duration = 0.0", "integration.duration"),
    ("duration = 30.0", "duration = -2", "integration.duration"),
    ("duration = 30.0", 'duration = "20 days"', "integration.duration"),
    ("duration = 30.0", 'duration = "many orbits"', "integration.duration"),
    ("tolerance = 1e-5", "tolerance = 0", "tolerance"),
    ("tolerance = 1e-5", "step = 0.0", "step"),
    ("tolerance = 1e-5", "step = -0.1", "step"),
    ("tolerance = 1e-5", "step = 0.1\ntolerance = 1e-6", "both given"),
    ("tolerance = 1e-5", 'method = "euler"', "euler"),
    ("tolerance = 1e-5", "max_steps = 0", "max_steps"),
    ("rate_tolerance = 1e-3", "rate_tolerance = -1e-3", "rate_tolerance"),
    ("rate_tolerance = 1e-3", "rate_tolerance = nan", "rate_tolerance"),
    ("rate_tolerance = 1e-3", 'rate_tolerance = 1e-3\n[outputs]\nvariables = ["colour"]', "colour"),
    ("rate_tolerance = 1e-3", "rate_tolerance = 1e-3\n[outputs]\nvariables = []", "outputs.variables"),
    ("schema = 1", "schema = = 1", "not valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "named"), BAD, ids=[b[1][:40] or b[0] for b in BAD])
def test_bad_input_is_one_line_that_names_it(small_scene, old, new, named):
    with pytest.raises(BadInput) as complaint:
        grid.check(load_scene(edit(small_scene, old, new)))
    assert "\n" not in str(complaint.value)
    assert named in str(complaint.value)


def test_a_scene_without_axes_is_refused():
    with pytest.raises(BadInput, match="axes"):
        load_scene('schema = 1\nsystem = "satellite"\n[axes]\n')


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        load_scene(tmp_path / "none.toml")
    with pytest.raises(BadInput, match="folder"):
        load_scene(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="UTF-8"):
        load_scene(tmp_path / "binary.toml")


def test_resolved_scene_reads_back_to_the_same_points(small_scene):
    scene = load_scene(small_scene)
    again = load_scene(scene.toml())
    assert again.toml() == scene.toml()
    one, two = (grid.points_at_indices(s, np.arange(s.size)) for s in (scene, again))
    for name, values in one.points.items():
        np.testing.assert_array_equal(values, two.points[name])


def test_points_are_on_the_family_and_nudged(small_scene):
    scene = load_scene(small_scene)
    found = grid.points_at_indices(scene, np.arange(scene.size))
    assert found.there.all()
    family, residual = scene.system.identify_family(found.base)
    assert (family == scene.system.families["perp_velocity"].flag).all()
    assert residual.max() < 1e-12
    np.testing.assert_allclose(found.points["theta0"] - found.base["theta0"], 1e-4, rtol=1e-10)
    np.testing.assert_array_equal(found.points["n"], found.base["n"])
    np.testing.assert_array_equal(found.base["C"].reshape(scene.shape)[:, 0], scene.axes["sigma"].values)


def test_offset_axis_passes_through_the_family(small_scene):
    text = edit(
        small_scene,
        "[ties]",
        "[axes.k3]\nfrom = -0.1\nto = 0.1\ncount = 3\noffset_from_family = true\n[ties]",
    )
    scene = load_scene(text)
    found = grid.points_at_indices(scene, np.arange(scene.size))
    family, _ = scene.system.identify_family(found.base)
    on = family.reshape(scene.shape) > 0
    assert on[:, :, 1].all()
    assert not on[:, :, [0, 2]].any()


@pytest.mark.parametrize(
    ("duration", "expected"), [('"2 orbits"', 4 * np.pi), ('"3 turns"', 12 * np.pi), ("7", 7.0)]
)
def test_durations(small_scene, duration, expected):
    scene = load_scene(edit(small_scene, "duration = 30.0", f"duration = {duration}"))
    np.testing.assert_allclose(grid.points_at_indices(scene, np.arange(3)).duration, expected)


def test_every_config_is_a_scene(pytestconfig):
    configs = sorted((pytestconfig.rootpath / "configs").glob("*.toml"))
    assert configs
    for path in configs:
        text = path.read_text()
        assert text.startswith("# What it shows:"), path
        assert re.search(r"^# Stands for:", text, re.M), path
        assert re.search(r"^# Time:", text, re.M), path
        grid.check(load_scene(path))


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
    found = Expression("t", text).value({"x": np.asarray(x), "y": np.asarray(y)})
    np.testing.assert_array_equal(found, expected)


@given(st.text(max_size=40))
def test_ties_never_do_anything_else(text):
    try:
        names = Expression("t", text).names
    except BadInput:
        names = frozenset()
    assert all(name.isidentifier() for name in names)


def test_ties_are_ordered():
    ties = {k: Expression(k, v) for k, v in {"a": "b + 1", "b": "c * 2", "c": "x"}.items()}
    assert evaluation_order(ties, {"x"}) == ["c", "b", "a"]
