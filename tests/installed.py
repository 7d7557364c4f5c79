"""Example scenes that can be read with the extensions that are installed."""

import tomllib
from pathlib import Path

from atlas.extension import extensions

CONFIGS = Path(__file__).parents[1] / "configs"


def example_scenes() -> list[Path]:
    """Paths of the example scenes, without scenes that list an extension that is not installed."""
    return [
        path
        for path in sorted(CONFIGS.glob("*.toml"))
        if set(tomllib.loads(path.read_text()).get("extensions", [])) <= extensions().keys()
    ]
