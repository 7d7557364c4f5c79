"""Lines of theory: their places, what their cache depends on, and lines of an extension of one's own on a map."""

import os
import stat

import numpy as np
import pytest

import atlas
from atlas import files, sources
from atlas.analysis import tracer
from atlas.analysis.plane import Plane
from atlas.extension import Extension, extensions
from atlas.plotting import cells

SCENE = """
schema = 1
title = "lines"
system = "fixed_point"
[axes.n]
from = 0.1
to = 2.0
count = 6
[axes.m]
from = 0.1
to = 2.0
count = 5
[integration]
duration = 1.0
[outputs]
variables = ["label", "theta_max"]
"""
LINES = """
import numpy as np

STYLE = {"color": "tab:cyan", "linestyle": "--", "linewidth": 0.7}


def diagonal(plane, ds):
    return {"equal rates": [np.array([[0.5, 0.5], [1.5, 1.5]])], "other": [np.array([[0.5, 0.6], [1.5, 0.6]])]}
"""


@pytest.fixture
def own(tmp_path, monkeypatch, installed_extensions):
    """Record of an extension that is installed for one test; its modules are in tmp_path / "own_lines"."""
    package = tmp_path / "own_lines"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "lines.py").write_text(LINES)
    monkeypatch.syspath_prepend(tmp_path)
    record = Extension(
        "own_lines",
        "own_lines",
        "lines of equal rates",
        lines={"theta_max": "lines:diagonal"},
        line_styles={"equal rates": "lines:STYLE"},
    )
    installed_extensions(extensions() | {"own_lines": record})
    yield package
    sources.OF_FOLDERS.clear()


def test_kept_lines_depend_on_the_code_of_extensions(own, without_extension, tmp_path, monkeypatch):
    monkeypatch.setenv("ATLAS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tracer, "WORTH_KEEPING", -1.0)
    plane = Plane(atlas.load_scene(SCENE), {"n": (0.1, 2.0), "m": (0.1, 2.0)}, {})
    traced = []

    def is_traced(what="own"):
        count = len(traced)
        lines = tracer.cached_lines(lambda: traced.append(1) or {"kind": [np.eye(2)]}, plane, what)
        np.testing.assert_array_equal(lines["kind"], [np.eye(2)])
        return len(traced) > count

    assert is_traced()
    assert not is_traced()
    assert is_traced("other")
    sources.OF_FOLDERS.clear()  # as in another process
    assert not is_traced()
    (own / "helper.py").write_text("FACTOR = 2")
    assert not is_traced()
    sources.OF_FOLDERS.clear()
    assert is_traced()
    assert not is_traced()
    without_extension("own_lines")
    assert is_traced()


PLANE = {"n": (0.1, 2.0), "m": (0.1, 2.0)}
FALSE_LINE = {"kind": [[[-5.0, -5.0], [5.0, 5.0]]]}
# Contents of the cache that are no lines of finite points on two axes; the first is whole.
NO_LINES = [
    FALSE_LINE, [1, 2], "text", 3, None, {"kind": 1.0}, {"kind": [1.0]}, {"kind": [[1.0, 2.0]]}, {"kind": [["a"]]},
    {"kind": [[[1.0, 2.0, 3.0]]]}, {"kind": [[[1.0, 2.0], [3.0]]]}, {"kind": [[[1.0, float("nan")]]]}, {"kind": [[[1.0, None]]]},
    {"kind": [[[10**400, 1]]]}, {"kind": [[[[1.0, 2.0]]]]}, {"kind": [[]]},
]  # fmt: skip


@pytest.mark.parametrize(
    "danger", ["none", "folder 777", "cache 770", "file 606", "another owner", "link", "no cache"]
)
def test_lines_of_strangers_are_traced_anew(danger, tmp_path, monkeypatch, caplog):
    """As machine code: nobody else may have written them; and whatever is no list of finite points."""
    cache = tmp_path / "cache"
    monkeypatch.setenv("ATLAS_CACHE", str(cache))
    monkeypatch.setattr(tracer, "WORTH_KEEPING", -1.0)
    plane = Plane(atlas.load_scene(SCENE), PLANE, {})

    def drawn():
        return tracer.cached_lines(lambda: {"kind": [np.eye(2)]}, plane)["kind"][0].tolist()

    if danger == "no cache":
        cache.write_text("")
        assert drawn() == np.eye(2).tolist()
        return
    previous = os.umask(0o002)  # of systems where each user has a group
    try:
        assert drawn() == np.eye(2).tolist()
    finally:
        os.umask(previous)
    (file,) = (cache / "lines").iterdir()
    assert [stat.S_IMODE(path.stat().st_mode) for path in (cache, cache / "lines", file)] == [
        0o700,
        0o700,
        0o600,
    ]
    file.write_text(files.sealed({"lines": FALSE_LINE}))
    assert drawn() == FALSE_LINE["kind"][0]
    if danger == "none":
        for content in NO_LINES[1:]:
            file.write_text(files.sealed({"lines": content}))
            assert drawn() == np.eye(2).tolist(), content
        file.write_text(files.sealed({"other": FALSE_LINE}))
    elif danger == "link":
        (cache / "lines").rename(tmp_path / "real")
        (cache / "lines").symlink_to(tmp_path / "real")
    elif danger == "another owner":
        owner = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    else:
        name, mode = danger.split()
        {"folder": cache / "lines", "cache": cache, "file": file}[name].chmod(int(mode, 8))
    for _ in range(2):
        assert drawn() == np.eye(2).tolist()
    messages = [each for each in caplog.messages if "the cache" in each]
    assert len(messages) == (danger not in ("none", "file 606"))
    assert all(
        "nothing in it is used, tracing lines of theory anew; remove it, or set ATLAS_CACHE" in each
        for each in messages
    )


@pytest.mark.long
@pytest.mark.usefixtures("whole_kernels")
def test_maps_draw_the_lines_of_an_extension_alone(own):
    ds = atlas.run(atlas.load_scene(SCENE), progress=False)
    assert list(dict.fromkeys(ds.atlas.boundary(variable="theta_max").kind.values)) == [
        "equal rates",
        "other",
    ]
    figure = ds.atlas.map("theta_max")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "equal rates (theory)",
        "other (theory)",
    ]
    drawn = {
        line.get_color(): line.get_xydata()[:2] for line in figure.axes[0].lines if len(line.get_xydata()) > 1
    }
    np.testing.assert_array_equal(drawn["tab:cyan"], [[0.5, 0.5], [1.5, 1.5]])
    np.testing.assert_array_equal(drawn["black"], [[0.5, 0.6], [1.5, 0.6]])
    assert cells.border_style("other") == {"color": "black", "linestyle": "-", "linewidth": 0.6}
    assert "equal rates" not in ds.atlas.boundary(variable="label").kind.values


def test_the_edge_of_existence_is_where_the_formula_of_the_family_ends():
    """theta0 of perp_radius exists where |k3 + C m| < |1 - C| Omega: two straight lines over k3 and m."""
    scene = {
        "schema": 1,
        "system": "satellite",
        "fixed": {"A": 1.0, "B": 1.0, "C": 0.4},
        "axes": {"k3": {"from": -1.5, "to": 1.5, "count": 9}, "m": {"from": -1.0, "to": 1.0, "count": 7}},
        "family": {"name": "perp_radius", "solve": ["theta0"]},
        "integration": {"duration": 1.0},
    }
    lines = atlas.run(scene, progress=False).atlas.boundary()
    edge = lines.isel(vertex=lines.kind.values == "edge of existence")
    momentum = edge.k3 + 0.4 * edge.m
    np.testing.assert_allclose(np.abs(momentum), 0.6, atol=1e-4)
    for side in (-1, 1):
        assert np.ptp(edge.m.values[side * momentum.values > 0]) > 1.9
