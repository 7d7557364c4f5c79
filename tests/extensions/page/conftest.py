"""One browser and a few small pages for all tests of this folder."""

import pytest
from extensions.page import browser as chromium

import atlas
from atlas.extensions.page import content, page
from atlas.extensions.page.page import atlas_page


@pytest.fixture(scope="session")
def browser():
    """A headless browser, shared by all tests."""
    if chromium.program() is None:
        pytest.skip("no Chromium is installed")
    with chromium.launched() as tab:
        yield tab


@pytest.fixture(scope="module")
def small_atlas(scene_text, tmp_path_factory):
    """Atlas of 63 points over two axes."""
    return _run(scene_text({}), tmp_path_factory)


@pytest.fixture(scope="module")
def cube_atlas(scene_text, tmp_path_factory):
    """Atlas over three axes, the last of two values."""
    changes = {
        "fixed.m": None,
        "axes.m": {"from": -0.5, "to": 0.5, "count": 2},
        "outputs.variables": ["label", "status"],
    }
    return _run(scene_text(changes), tmp_path_factory)


@pytest.fixture(scope="module")
def sampled_atlas(scene_text, tmp_path_factory):
    """Atlas of 32 sampled points."""
    ranges = {"sigma": {"from": 0.3, "to": 1.7}, "theta0": {"from": 0.2, "to": 1.4}}
    points = {"sample": "sobol", "count": 32, "ranges": ranges}
    return _run(scene_text({"axes": None, "points": points}), tmp_path_factory)


@pytest.fixture(scope="module")
def small_page(small_atlas):
    """Page of the small atlas."""
    return atlas_page(small_atlas, file="small.nc")


@pytest.fixture(scope="module")
def address(small_page, tmp_path_factory):
    """Address of that page."""
    path = tmp_path_factory.mktemp("page") / "small.html"
    small_page.save(path)
    return path.as_uri()


def _run(text, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(text)
    return atlas.run(path, progress=False)


@pytest.fixture
def quick_page(monkeypatch):
    """Leave out the lines of theory and the picture for readers without scripts, which take seconds."""
    monkeypatch.setattr(content, "MAX_SLICES", 0)
    monkeypatch.setattr(page, "_fallback", lambda shown: "")
