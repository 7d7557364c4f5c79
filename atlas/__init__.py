"""Precession Atlas: where in parameter space a gyrostat precesses regularly, rotates or drifts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import extension as _extension
from . import interruption as _interruption

if _interruption.is_command():
    _interruption.end_on_signal()

from . import sources as _sources  # noqa: F401  (before the modules that it hashes)

# isort: split
if not _interruption.is_command():  # commands that need no dataset start twice as fast without xarray
    from . import registration as _registration  # noqa: F401  (registers ds.atlas with xarray)
from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .errors import BadInput as BadInput
    from .faces import *  # noqa: F403
    from .label.points import label_points as label_points
    from .label.trajectory import trajectory as trajectory
    from .plotting.maps import figure as figure
    from .plotting.style import style as style
    from .runs.backend import open_atlas as open_atlas
    from .runs.execution import run as run
    from .scene.examples import example as example
    from .scene.read import load_scene as load_scene
    from .store.joined import concat as concat
    from .systems import register as register

# The module that defines each public name is imported when the name is first used, so that reading a scene loads no compiler.
_MODULES = {
    "load_scene": "scene.read",
    "example": "scene.examples",
    "run": "runs.execution",
    "label_points": "label.points",
    "open_atlas": "runs.backend",
    "trajectory": "label.trajectory",
    "concat": "store.joined",
    "figure": "plotting.maps",
    "style": "plotting.style",
    "register": "systems",
    "BadInput": "errors",
}


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return __dir__()
    if name in _MODULES or name in _extension.parts("functions"):
        from importlib import import_module

        import_module(".registration", __name__)  # registers ds.atlas, which equations of the user may use
        if name not in _MODULES:
            return _extension.load("functions", name)
        value = getattr(import_module(f".{_MODULES[name]}", __name__), name)
        globals()[name] = value
        return value
    missing = _extension.not_loaded() if name[0] != "_" else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{missing}")


def __dir__() -> list[str]:
    """Return the public names of the core, followed by the public names of the extensions."""
    return [*_MODULES, "__version__", *(name for name in _extension.parts("functions") if "." not in name)]
