"""Settings shared by all tests: a kernel cache of their own, and hypothesis without deadlines."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("ATLAS_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "kernels"))
settings.register_profile("atlas", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("atlas")

SMALL_SCENE = """
schema = 1
title = "small"
system = "satellite"

[fixed]
A = 1.0
Omega = 1.0
m = 0.5

[axes.sigma]
from = 0.3
to = 1.7
count = 9
long_name = "C/A"

[axes.theta0]
from = 0.2
to = 1.4
count = 7

[ties]
B = "A"
C = "sigma * A"
psi0 = "pi / 2"

[family]
name = "perp_velocity"
solve = ["k3"]

[nudge]
theta0 = 1e-4
psi0 = 1e-4

[integration]
duration = 30.0
tolerance = 1e-5

[labels]
rate_tolerance = 1e-3
"""


@pytest.fixture
def small_scene() -> str:
    """Text of a scene of 63 points that runs in milliseconds."""
    return SMALL_SCENE


@pytest.fixture
def longer(tmp_path, small_scene, monkeypatch):
    """A scene of about a second in 18 tiles, in memory as it should be, and its empty run folder."""
    import atlas
    from atlas import load_scene
    from atlas.runs.folder import RunFolder
    from atlas.scene import grid

    text = small_scene.replace("count = 9", "count = 18").replace("count = 7", "count = 48")
    (tmp_path / "scene.toml").write_text(text.replace("tolerance = 1e-5", "tolerance = 1e-9"))
    scene = load_scene(tmp_path / "scene.toml")
    whole = atlas.run(scene, progress=False)
    with monkeypatch.context() as patched:
        patched.setattr(grid, "MAX_POINTS_PER_TILE", 64)
        run = RunFolder.prepare(scene, tmp_path / "run", grid.check(scene), [])
    assert run.tiling.count == 18
    return tmp_path, run, whole
