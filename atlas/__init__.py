"""Precession Atlas: where in parameter space a gyrostat precesses regularly, rotates or drifts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import accessor as _accessor  # noqa: F401  (registers ds.atlas with xarray)

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .catalogue import equilibria as equilibria
    from .follow import trajectory as trajectory
    from .runner import label_points as label_points
    from .runner import run as run
    from .scene import load_scene as load_scene
    from .store import open_atlas as open_atlas
    from .systems.system import BadInput as BadInput

# name -> module: imported when first used, so that reading a scene loads no compiler
_FACE = {
    "load_scene": "scene",
    "run": "runner",
    "label_points": "runner",
    "open_atlas": "store",
    "trajectory": "follow",
    "equilibria": "catalogue",
    "BadInput": "systems.system",
}
__all__ = [*_FACE, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _FACE:
        from importlib import import_module

        value = getattr(import_module(f".{_FACE[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
