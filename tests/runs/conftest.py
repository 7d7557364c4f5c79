"""Fixtures of the tests of runs; a module has its own `scene`, and its own tiles where these do not fit."""

import pytest

import atlas


@pytest.fixture(scope="module")
def whole(scene):
    """The atlas of the scene, computed in memory."""
    return atlas.run(scene, progress=False)


@pytest.fixture
def small_tiles(monkeypatch):
    """Tiles of at most 7 points."""
    monkeypatch.setenv("ATLAS_TILE_POINTS", "7")
