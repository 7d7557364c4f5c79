"""Messages about scenes: file and line, the name that was meant, and the spelling of options."""

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, load_scene
from atlas.errors import allowed_text, messages_for_shell, option, shown
from atlas.files import exists_message
from atlas.scene import grid
from atlas.scene.read import parse_duration
from atlas.scene.text import line_of


def test_lines_of_keys():
    text = '# a = 1\nb.c = 1\n\n[ x . "y" ] # d\n  k=2\n"q" = [\n  1,\n]\n[z]\nt = {u = 1}\n[p.q.r]\n'
    lines = {"b.c": 2, "b": 2, "x.y": 4, "x": 4, "x.y.k": 5, "x.y.q": 6, "z.t.u": 10, "p": 11, "p.q.s": 11}
    assert {key: line_of(text, key) for key in lines} == lines
    assert line_of(text, "a") is None
    assert line_of("", "a.b") is None
    assert line_of("[" + " " * 10**6, "a") is None  # at once


def test_a_scene_with_another_end_of_line_or_a_byte_order_mark(small_scene, tmp_path):
    expected = load_scene(small_scene).toml()
    for content in (
        b"\xef\xbb\xbf" + small_scene.encode(),
        small_scene.replace("\n", "\r").encode(),
        small_scene.replace("\n", "\r\n").encode(),
    ):
        (tmp_path / "a.toml").write_bytes(content)
        assert load_scene(tmp_path / "a.toml").toml() == expected
        assert load_scene(content.decode()).toml() == expected
    (tmp_path / "a.toml").write_bytes(small_scene.encode("utf-16"))
    with pytest.raises(BadInput, match=r"a.toml: not text in UTF-8"):
        load_scene(tmp_path / "a.toml")


def test_what_is_no_scene(small_scene, tmp_path):
    scene = load_scene(small_scene)
    assert load_scene(scene) is scene
    xr.Dataset({"label": ("m", np.zeros(2, np.int8))}).to_netcdf(tmp_path / "a.nc")
    xr.Dataset({"label": ("m", np.zeros(2))}).to_netcdf(tmp_path / "b.nc", format="NETCDF3_CLASSIC")
    atlas.run(scene, tmp_path / "run/", progress=False)
    for name in ("a.nc", "b.nc", "run"):
        with pytest.raises(BadInput, match=rf"{name}: this is an atlas, not a scene"):
            load_scene(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "amount", "unit"),
    [
        ("1 orbit", 1, "orbits"),
        ("1 turn", 1, "turns"),
        ("20 orbits", 20, "orbits"),
        (" 1.5e-3  Turns ", 1.5e-3, "turns"),
        ("2orbits", 2, "orbits"),
        ("60", 60, ""),
        ("2.", 2, ""),
        (60, 60, ""),
    ],
)
def test_durations_are_read(text, amount, unit):
    duration = parse_duration(text)
    assert (duration.amount, duration.unit) == (amount, unit)
    assert parse_duration(str(duration)) == duration


@pytest.mark.parametrize(
    "text", ["", "orbits", "1 day", "-1 turn", "0 turns", "nan", "1e999 turns", "1 2 turns", "5e", True, None]
)
def test_durations_that_are_none(text):
    with pytest.raises(BadInput, match=r"^key = "):
        parse_duration(text, "key")


def test_options_are_spelled_as_their_reader_writes_them(tmp_path):
    python = option("force", True), option("rate_tolerance", 1e-3), option("select", {"k3": 0.2})
    assert python == ("force=True", "rate_tolerance=0.001", "select={'k3': 0.2}")
    assert "force=True replaces it" in exists_message(tmp_path)
    with messages_for_shell():
        shell = option("force", True), option("rate_tolerance", 1e-3), option("select", {"k3": 0.2})
        assert shell == ("--force", "--rate-tolerance 0.001", "--select k3=0.2")
        assert "--force replaces it" in exists_message(tmp_path)
    assert option("force", True) == "force=True"


def test_names_that_are_similar_are_suggested():
    names = ["tolerance", "step", "max_steps"]
    assert allowed_text("Tolerence", names) == "did you mean 'tolerance'? allowed: tolerance, step, max_steps"
    for given in ("colour", 3, None, "x" * 10**6):
        assert allowed_text(given, names) == "allowed: tolerance, step, max_steps"
    assert allowed_text("a", []) == "allowed: none"


def test_numbers_of_numpy_are_shown_as_numbers():
    assert shown(np.float64(-1.0)) == "-1.0"
    assert shown([np.float64(0.5), np.int64(3)]) == "[0.5, 3]"


def test_angles_in_degrees(small_scene):
    text = small_scene.replace("to = 1.4", 'to = "80 * deg"').replace("pi / 2", "90 * deg")
    scene = load_scene(text.replace("m = 0.5", 'm = "sqrt(0.25)"'))
    assert scene.fixed["m"] == 0.5
    assert scene.axes["theta0"].values[-1] == pytest.approx(np.radians(80), abs=1e-15)
    assert load_scene(scene.toml()).axes["theta0"].values.tolist() == scene.axes["theta0"].values.tolist()
    points = grid.check(scene)
    assert points.base["psi0"] == pytest.approx(np.pi / 2)
    assert not grid.warnings(scene, points)
    scene = load_scene(small_scene.replace("to = 1.4", "to = 90"))
    (warning,) = grid.warnings(scene, grid.check(scene))
    assert warning.startswith("theta0 reaches 90 rad = 5156.62 degrees: angles are in rad")


def test_numbers_of_extreme_size_give_a_warning(small_scene):
    scene = load_scene(small_scene.replace("A = 1.0", "A = 1e-320"))
    warnings = grid.warnings(scene, grid.check(scene))
    assert any("less than 1e-60: theory predicts nothing there" in warning for warning in warnings)
