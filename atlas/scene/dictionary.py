"""Conversion of scenes from dictionaries into TOML text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ..errors import BadInput, shown


def text_of(table: Mapping[str, Any]) -> str:
    """Return the TOML text of a scene that is given as nested mappings. The text is read and checked like a file."""
    try:
        return tomli_w.dumps(_plain(table))
    except RecursionError:
        raise BadInput("scene: nested too deeply") from None


def _plain(value: Any, key: str = "") -> Any:
    """Return a value of a scene as a type that TOML has. Raise BadInput if no type fits."""
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise BadInput(f"{key or 'scene'}: the key {shown(name)} must be a text")
        return {name: _plain(value[name], f"{key}.{name}" if key else name) for name in value}
    if isinstance(value, np.ndarray | np.generic):
        from .tables import check_written  # imported here, because few dictionaries have arrays

        check_written(key, value)
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each, key) for each in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, str | bool | int | float):
        return value
    raise BadInput(f"{key} = {shown(value)}: must be a text, a number, true or false, a list or a mapping")
