"""What a page shows in degrees, and of what there is none."""

import json
import re

import numpy as np
import pytest

import atlas
from atlas import BadInput
from atlas.cli import main

pytestmark = pytest.mark.usefixtures("whole_kernels")


def data_of(page):
    """The data in a page."""
    return json.loads(
        re.search(r'<script[^>]*type="application/json"[^>]*>(.*?)</script>', page.html, re.S)[1]
    )


@pytest.mark.long
def test_a_page_in_degrees(small_atlas):
    rad, deg = data_of(small_atlas.atlas.page()), data_of(small_atlas.atlas.page(degrees=True))
    for before, after in zip(rad["axes"], deg["axes"], strict=True):
        factor = np.degrees(1.0) if before["name"] == "theta0" else 1.0
        np.testing.assert_allclose(after["values"], np.array(before["values"]) * factor)
    assert deg["axes"][1]["plain"] == rad["axes"][1]["plain"].replace("rad", "deg")
    assert (rad["motion"]["angle"]["unit"], deg["motion"]["angle"]["unit"]) == ("rad", "deg")
    vertices = [each["theory"]["slices"][0][0]["paths"][0][0] for each in (rad, deg)]
    np.testing.assert_allclose(vertices[1], np.array(vertices[0]) * [1.0, np.degrees(1.0)], rtol=1e-5)
    units = [{p["name"]: p["unit"] for p in each["motion"]["parameters"]}["theta0"] for each in (rad, deg)]
    assert units == [[{"t": "rad"}], [{"t": "deg"}]]
    assert rad["commands"] == deg["commands"]  # what is copied stays in rad


@pytest.mark.long
def test_a_scene_asks_for_pages_in_degrees(scene_text):
    ds = atlas.run(atlas.load_scene(scene_text({"axes.theta0.display_units": "deg"})), progress=False)
    theta0 = next(each for each in data_of(ds.atlas.page())["axes"] if each["name"] == "theta0")
    np.testing.assert_allclose(theta0["values"], np.degrees(ds.theta0.values))


def test_a_wrong_value_is_one_line(small_atlas):
    with pytest.raises(BadInput, match=r"^degrees = 'yes': must be true or false$"):
        small_atlas.atlas.page(degrees="yes")


def test_joined_atlases_have_no_page(small_atlas):
    joined = atlas.concat({"first": small_atlas, "second": small_atlas}, "kind")
    with pytest.raises(BadInput, match=r"^kind: joined atlases \(first, second\) .*\.sel\(kind="):
        joined.atlas.page()


@pytest.mark.long
def test_the_shell_makes_pages_in_degrees(scene_text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(scene_text({}))
    assert main(["run", "a.toml", "--quiet"]) == 0
    assert main(["page", "a.nc", "--degrees"]) == 0
