"""The example scenes that come with the package."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from ..errors import BadInput, allowed_text


def example(name: str, **changes: Any) -> dict[str, Any]:
    """Return an example scene as a dictionary, which can be changed and given to `run`.

    Parameters
    ----------
    name : str
        Name of the example, as ``atlas new`` lists it.
    **changes
        Keys of the scene with new values. A mapping changes single keys of a table, to any depth; None removes a key.

    Returns
    -------
    dict
        Nested dictionaries with the keys of scene files.

    Raises
    ------
    BadInput
        If there is no such example. Keys and values are checked where the dictionary is used.

    Examples
    --------
    >>> scene = atlas.example("quickstart", axes={"l3": {"count": 20}, "n": {"count": 16}})
    >>> scene["integration"]["method"] = "rk8"
    >>> ds = atlas.run(scene)
    """
    scenes = examples()
    if name not in scenes:
        raise BadInput(f"{name}: no such example; {allowed_text(name, scenes)}")
    return _with_changes(tomllib.loads(scenes[name].read_text("utf-8")), changes)


def _with_changes(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a table with changes. Nested tables are merged key by key."""
    values = dict(table)
    for key, change in changes.items():
        if isinstance(change, Mapping):
            old = values.get(key)
            values[key] = _with_changes(old if isinstance(old, Mapping) else {}, change)
        elif change is None:
            values.pop(key, None)
        else:
            values[key] = change
    return values


def examples() -> dict[str, Traversable]:
    """Return the example scenes by name, from the installed package or from the folder configs/ of the repository."""
    folder: Traversable = files("atlas") / "examples"
    if not folder.is_dir():
        folder = Path(__file__).parents[2] / "configs"
    scenes = {
        path.name.removesuffix(".toml"): path for path in folder.iterdir() if path.name.endswith(".toml")
    }
    return dict(sorted(scenes.items()))
