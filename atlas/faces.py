"""Names that extensions add to `atlas` and to `ds.atlas`.

Type checkers read `faces.pyi`, which `scripts/tools/make_faces.py` writes from the extensions of this package.
"""

from __future__ import annotations

from types import MethodType
from typing import Any

import xarray as xr

from . import extension
from .scene.checks import typed


class Questions:
    """Methods of `ds.atlas` that extensions add."""

    _ds: xr.Dataset

    def __getattr__(self, name: str) -> Any:
        question = extension.load("questions", name)
        if question is None:
            raise AttributeError(f"'Atlas' object has no attribute {name!r}{extension.not_loaded()}")
        return MethodType(typed(question), self._ds)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *extension.parts("questions")})
