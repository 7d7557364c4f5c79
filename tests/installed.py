"""Example scenes, without those of extensions that are missing here."""

import tomllib
from pathlib import Path

from atlas import extension
from atlas.scene.read import scene_from

CONFIGS = Path(__file__).parents[1] / "configs"


def example_scenes(system=None):
    """Paths of the scenes of configs/, or of those of a system, whose extensions are installed."""
    scenes = {path: tomllib.loads(path.read_text()) for path in sorted(CONFIGS.glob("*.toml"))}
    return [
        path
        for path, table in scenes.items()
        if system in (None, table["system"])
        and set(table.get("extensions", [])) <= extension.extensions().keys()
    ]


def reduced(path, count=11, **integration):
    """An example scene with `count` points along each axis."""
    table = tomllib.loads(path.read_text())
    for axis in table["axes"].values():
        axis["count"] = count
    table["integration"] |= integration
    return scene_from(table, path.stem)
